from .rasteriser import Rasteriser as Rasteriser
from .rasteriser import RenderedFrame as RenderedFrame
from .visibility import OWN_PARTS as OWN_PARTS
