"""What serves recordings alone: messages of devices, clocks, resampling, delays between sources, registration."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
