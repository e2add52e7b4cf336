"""Depth cameras: presets, placement, and the noise models that turn rendered geometry into what a camera delivers."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
