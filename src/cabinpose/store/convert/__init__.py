"""Other formats: a module each. Of datasets, with `export(dataset, folder, report)`, `read(path, options)` for imports, or both;
of recordings, see `recordings`.

A format's module is imported when it is asked for. A folder appears under its name when the export or import is whole.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from cabinpose.core.errors import DatasetError, unknown_name
from cabinpose.store.dataset import create_dataset
from cabinpose.store.part import PartWriter, disk_errors
from cabinpose.store.schema import MANIFEST_NAME

if TYPE_CHECKING:
    import xarray as xr

    from cabinpose.store.convert.source import ImportOptions, Source

FORMATS = MappingProxyType({"png-json": "png_json", "coco": "coco", "itop": "itop", "ntu": "ntu", "ply": "ply"})
IMPORTS = MappingProxyType({"png-json": "png_json", "coco": "coco_import", "itop": "itop_import", "ntu": "ntu"})
# Formats of recordings, which `recordings` reads and writes: names alone, since that module needs the extra `record`.
RECORDING_EXPORTS = ("c3d", "bvh", "trc", "sto", "mvnx", "csv", "adtfdat", "xdf")
RECORDING_IMPORTS = ("mvnx", "c3d", "bvh", "adtfdat", "xdf", "azure-mkv", "trc", "sto", "csv")

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
    if (folder / MANIFEST_NAME).exists():
        raise DatasetError(f"{folder} holds a dataset, which an export never replaces", hint="give another folder with --out")
    module: Any = import_module(f"{__name__}.{FORMATS[name]}")
    with _whole_folder(folder, "export", overwrite=overwrite) as temporary:
        temporary.mkdir(parents=True)
        module.export(dataset, temporary, report or (lambda _: None))
    return folder


def open_source(path: Path | str, name: str, options: ImportOptions) -> Source:
    """What there is to import from `path`, a file or folder of the format `name`: its manifest, and its frames to come.

    Reads what the manifest needs, no image. Raises `ConfigError` for an unknown format, `DatasetError` for a source that
    is not there, lacks what the format has, or contradicts itself.
    """
    if name not in IMPORTS:
        raise unknown_name("format", name, list(IMPORTS))
    source = Path(path)
    if not source.exists():
        raise DatasetError(f"{source} does not exist", hint="give the file or folder to import")
    module: Any = import_module(f"{__name__}.{IMPORTS[name]}")
    found: Source = module.read(source, options)
    return found


def import_source(source: Source, out: Path | str, *, overwrite: bool = False, report: Report | None = None) -> Path:
    """Write a source as a dataset into the folder `out`, one frame in memory at a time, and return that folder.

    Raises `DatasetError` where `out` exists and is no dataset to overwrite, where a frame cannot be read, or where the
    disk is full; then nothing is left behind, and what was in `out` stays.
    """
    folder = Path(out)
    check_new_dataset(folder, overwrite=overwrite)
    if source.path.resolve().is_relative_to(folder.resolve()):
        raise DatasetError(f"{folder} holds the source, {source.path}", hint="give another folder with --out")
    manifest, frames, done = source.manifest, source.frames(), 0
    with _whole_folder(folder, "import", overwrite=overwrite) as temporary, create_dataset(temporary, manifest):
        for plan in manifest.parts:
            with PartWriter(temporary, plan, manifest) as part:
                for _ in range(plan.frames):
                    frame = next(frames, None)
                    if frame is None:
                        raise DatasetError(f"{source.path} ended after {done} frames", hint="it changed while it was read")
                    part.append(frame)
                    done += 1
                    if report is not None:
                        report(done)
    return folder


def check_new_dataset(folder: Path, *, overwrite: bool) -> None:
    """Raise `DatasetError` unless a dataset may be written to `folder`: `overwrite` replaces a dataset and nothing else."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    if not (folder / MANIFEST_NAME).exists():
        raise DatasetError(f"{folder} exists and is no dataset", hint="give a new or empty folder with --out")
    if not overwrite:
        raise DatasetError(f"{folder} already holds a dataset", hint="--overwrite replaces it, or give another folder with --out")


@contextmanager
def _whole_folder(folder: Path, what: str, *, overwrite: bool) -> Iterator[Path]:
    """The name of a folder to make, which takes the place of `folder` when the block ends in peace, else is removed."""
    if folder.exists() and not overwrite and (not folder.is_dir() or any(folder.iterdir())):
        raise DatasetError(f"{folder} exists and is not empty", hint="--overwrite replaces it, or give another folder with --out")
    temporary = folder.parent / f".{folder.name}.{what}.tmp"
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        with disk_errors(folder):
            yield temporary
            if folder.exists():
                shutil.rmtree(folder)
            temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
