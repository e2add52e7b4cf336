"""Devices, one module each: a `signals.FrameSource`, and beside it the bytes of its protocol."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
