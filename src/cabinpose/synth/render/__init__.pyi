from .rasteriser import Rasteriser as Rasteriser
from .rasteriser import RenderedFrame as RenderedFrame
from .rasteriser import normals_at as normals_at
