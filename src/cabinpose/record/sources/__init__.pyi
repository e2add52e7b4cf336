from .base import DeviceSource as DeviceSource
from .base import PlayedSettings as PlayedSettings
from .base import PlayedSource as PlayedSource
from .mvn import MvnSettings as MvnSettings
from .mvn import MvnSource as MvnSource
