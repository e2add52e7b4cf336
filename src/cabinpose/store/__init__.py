"""The formats on disk: the dataset standard, its splits and its converters. Knows nothing of scenes.

`open_dataset` and `points_m` load xarray when they are first asked for: a generator needs neither.
"""

from typing import TYPE_CHECKING, Any

from cabinpose.store.dataset import DatasetWriter, create_dataset
from cabinpose.store.part import PartWriter
from cabinpose.store.schema import Manifest, PartPlan, read_manifest

if TYPE_CHECKING:
    from cabinpose.store.lazy import open_dataset, points_m

__all__ = ["DatasetWriter", "Manifest", "PartPlan", "PartWriter", "create_dataset", "open_dataset", "points_m", "read_manifest"]


def __getattr__(name: str) -> Any:
    if name not in {"open_dataset", "points_m"}:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from cabinpose.store import lazy  # noqa: PLC0415 - xarray, for readers alone

    return getattr(lazy, name)
