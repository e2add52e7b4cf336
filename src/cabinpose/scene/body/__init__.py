"""Parametric people: shape, skeleton with anatomical joints, clothing and part labels."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
