from .rasteriser import Rasteriser as Rasteriser
from .rasteriser import RenderedFrame as RenderedFrame
