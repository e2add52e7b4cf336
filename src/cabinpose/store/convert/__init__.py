"""Export to other formats: one module a format, each with `export(dataset, folder, report)`.

A format's module is imported when it is asked for. The folder appears under its name when the export is whole.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import MappingProxyType

import xarray as xr

from cabinpose.core.errors import DatasetError, unknown_name
from cabinpose.store.part import disk_errors

FORMATS = MappingProxyType({"png-json": "png_json", "coco": "coco", "itop": "itop", "ply": "ply"})

Report = Callable[[int], None]  # called with the number of frames done


def export_dataset(
    dataset: xr.Dataset, name: str, out: Path | str, *, overwrite: bool = False, report: Report | None = None
) -> Path:
    """Write a dataset (or a selection of it) in the format `name` into the folder `out`, and return that folder.

    Raises `ConfigError` for an unknown format, `DatasetError` where `out` exists and `overwrite` is not given, where the
    format cannot hold the dataset, or where the disk is full; then nothing is left behind.
    """
    if name not in FORMATS:
        raise unknown_name("format", name, list(FORMATS))
    folder = Path(out)
    if folder.exists() and not overwrite and (not folder.is_dir() or any(folder.iterdir())):
        raise DatasetError(f"{folder} exists and is not empty", hint="--overwrite replaces it, or give another folder with --out")
    if (folder / "dataset.yaml").exists():
        raise DatasetError(f"{folder} holds a dataset, which an export never replaces", hint="give another folder with --out")
    module = import_module(f"{__name__}.{FORMATS[name]}")
    temporary = folder.parent / f".{folder.name}.export.tmp"
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        with disk_errors(folder):
            temporary.mkdir(parents=True)
            module.export(dataset, temporary, report or (lambda _: None))
            if folder.exists():
                shutil.rmtree(folder)
            temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return folder
