"""Seat-specific postures: inverse kinematics, seat fit, actions and profiles of seated people."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
