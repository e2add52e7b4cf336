"""What a camera sees of a scene: a z-buffer, and the visibility of joints.

`Rasteriser` renders depth, labels, instances and the buffers of the sensor model, and states for every joint how it is seen.
"""

from cabinpose.synth.render.rasteriser import Rasteriser, RenderedFrame
from cabinpose.synth.render.visibility import OWN_PARTS

__all__ = ["OWN_PARTS", "Rasteriser", "RenderedFrame"]
