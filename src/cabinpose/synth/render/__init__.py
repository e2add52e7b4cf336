"""What a camera sees of a scene: a z-buffer, and the visibility of joints.

`Rasteriser` renders depth, labels, instances and the buffers of the sensor model; `joint_visibility` states for
every joint how it is seen.
"""

from cabinpose.synth.render.projection import NEAR_M
from cabinpose.synth.render.rasteriser import Rasteriser, RenderedFrame
from cabinpose.synth.render.visibility import OWN_PARTS, joint_visibility

__all__ = ["NEAR_M", "OWN_PARTS", "Rasteriser", "RenderedFrame", "joint_visibility"]
