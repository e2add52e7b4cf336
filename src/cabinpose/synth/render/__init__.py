"""What a camera sees of a scene: a z-buffer, and the visibility of joints.

`Rasteriser` renders depth, labels, instances and the buffers of the sensor model, and states for every joint how it is seen.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
