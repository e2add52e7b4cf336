"""Other formats of datasets and recordings, a module each. See docs/formats.md."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
