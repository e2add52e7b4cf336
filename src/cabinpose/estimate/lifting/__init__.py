"""Lifting: 2D joints of one person to 3D with a residual fully connected network."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
