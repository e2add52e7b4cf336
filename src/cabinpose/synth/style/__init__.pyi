from .encoder import Loss as Loss
from .fit import fit_style as fit_style
from .frame import StyleFrame as StyleFrame
