"""What exists in a scene and how a Time-of-Flight camera sees it: bodies, cabins, sensors, contact."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
