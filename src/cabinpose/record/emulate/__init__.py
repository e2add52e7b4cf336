"""Devices played: servers that send the real bytes, on loopback unless told otherwise."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
