"""Contact between bodies, and between bodies and the cabin: what yields, by how much, and what collides."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
