"""Predictions held against references: errors of every joint, pooled; metrics with their units, denominators and intervals."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
