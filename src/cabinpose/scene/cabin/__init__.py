"""Parametric car interiors from SAE J1100 dimensions, and the user's own car meshes in their place."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
