"""Made by tools/make_stubs.py from the extension.

Arrays are C-contiguous. A struct is read from the attributes of any object that has them.
"""

from . import align as align
from . import body as body
from . import cabin as cabin
from . import contact as contact
from . import core as core
from . import dpm as dpm
from . import estimate as estimate
from . import lab as lab
from . import pose as pose
from . import raster as raster
from . import sensor as sensor
from . import walks as walks

SIMD: str
