"""The formats on disk: the dataset standard, its splits and its converters. Knows nothing of scenes."""

from cabinpose.store.dataset import DatasetWriter, create_dataset, open_dataset
from cabinpose.store.lazy import points_m
from cabinpose.store.part import PartWriter
from cabinpose.store.schema import Manifest, PartPlan, read_manifest

__all__ = ["DatasetWriter", "Manifest", "PartPlan", "PartWriter", "create_dataset", "open_dataset", "points_m", "read_manifest"]
