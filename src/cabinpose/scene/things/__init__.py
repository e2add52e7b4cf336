"""Things that people bring into a car: child seats, and what lies on seats and laps or is held in a hand."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
