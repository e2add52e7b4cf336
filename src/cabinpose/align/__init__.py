"""From a recording to a dataset: its sources in one time and one space. See docs/alignment.md."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
