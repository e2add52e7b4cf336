"""Body pose of people in cars, seen by a Time-of-Flight camera: data, detectors, metrics."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("cabinpose")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "0.0.0"

__all__ = ["__version__"]
