from .simulated import SimulatedSettings as SimulatedSettings
from .simulated import SimulatedSource as SimulatedSource
from .simulated import tof_frame as tof_frame
