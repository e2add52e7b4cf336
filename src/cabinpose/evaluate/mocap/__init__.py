"""How good a motion capture suit's ground truth is: the four evaluations of the thesis' chapter 3, on arrays.

sse: a sensor turned in known steps · sfe: the first N-pose against the last · dse: segments' turns against an optical system ·
dfe: joints' positions against an optical system · orientation: an orientation filter against optical truth, as BROAD does it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
