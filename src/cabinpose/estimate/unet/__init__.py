"""Body parts of every pixel, by two networks in a row: who is a person, and which part of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
