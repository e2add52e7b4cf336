"""Other formats: a module each. Of datasets, with `export(dataset, folder, report)`, `read(path, options)` for imports, or both
(those of `IMAGE_KINDS` have `export(parts, folder, report, images)`, with the frames of each split by its name); of recordings,
see `recordings`.

A format's module is imported when it is asked for. A folder appears under its name when the export or import is whole.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from cabinpose.core.errors import ConfigError, DatasetError, unknown_name
from cabinpose.store.dataset import create_dataset
from cabinpose.store.part import PartWriter, disk_errors
from cabinpose.store.schema import MANIFEST_NAME
from cabinpose.store.split import Splits, held_out, split_dataset

if TYPE_CHECKING:
    import xarray as xr

    from cabinpose.store.convert.source import ImportOptions, Source

FORMATS = MappingProxyType({"png-json": "png_json", "coco": "coco", "yolo": "yolo", "itop": "itop", "ntu": "ntu", "ply": "ply"})
IMPORTS = MappingProxyType({"png-json": "png_json", "coco": "coco_import", "itop": "itop_import", "ntu": "ntu"})
# What the images of a format can be (see `pictures`), its default first; the other formats have but one kind.
IMAGE_KINDS = MappingProxyType({"coco": ("depth8", "amplitude8", "depth16"), "yolo": ("depth8", "amplitude8")})
# Formats of recordings, which `recordings` reads and writes: names alone, since that module needs the extra `record`.
RECORDING_EXPORTS = ("c3d", "bvh", "trc", "sto", "mvnx", "csv", "adtfdat", "xdf")
RECORDING_IMPORTS = ("mvnx", "c3d", "bvh", "adtfdat", "xdf", "azure-mkv", "trc", "sto", "csv")

Report = Callable[[int], None]  # called with the number of frames done


def export_dataset(
    dataset: xr.Dataset,
    name: str,
    out: Path | str,
    *,
    images: str | None = None,
    splits: Splits | None = None,
    overwrite: bool = False,
    report: Report | None = None,
) -> Path:
    """Write a dataset (or a selection of it) in another format.

    Parameters
    ----------
    dataset
        The frames to write.
    name
        The format, one of `FORMATS`.
    out
        The folder to write; it appears when the export is whole.
    images
        What the images are, one of the format's `IMAGE_KINDS`; default: the first of them.
    splits
        Splits to write apart, for the formats of `IMAGE_KINDS`; see `export_parts`.
    overwrite
        Replace what is in the folder.
    report
        Called with the number of frames done.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ConfigError
        For an unknown format, or images or splits that it does not have.
    DatasetError
        Where `out` exists and `overwrite` is not given, where the format cannot hold the dataset, or where the disk is full;
        then nothing is left behind.
    """
    check_export(name, images)
    parts = export_parts(dataset, name, splits or {})
    folder = Path(out)
    if (folder / MANIFEST_NAME).exists():
        raise DatasetError(f"{folder} holds a dataset, which an export never replaces", hint="give another folder with --out")
    module: Any = import_module(f"{__name__}.{FORMATS[name]}")
    with _whole_folder(folder, "export", overwrite=overwrite) as temporary:
        temporary.mkdir(parents=True)
        tell = report or (lambda _: None)
        if name in IMAGE_KINDS:
            module.export(parts, temporary, tell, images or IMAGE_KINDS[name][0])
        else:
            module.export(parts[""], temporary, tell)
    return folder


def check_export(name: str, images: str | None) -> None:
    """Raise `ConfigError` unless `name` is a format of datasets and can have such images."""
    if name not in FORMATS:
        raise unknown_name("format", name, (*FORMATS, *RECORDING_EXPORTS))
    kinds = IMAGE_KINDS.get(name, ())
    if images is not None and images not in kinds:
        hint = f"choose one of {', '.join(kinds)}" if kinds else f"leave out --images, which is of {', '.join(IMAGE_KINDS)}"
        raise ConfigError(f"{name} has no images of the kind {images}", hint=hint)


def export_parts(dataset: xr.Dataset, name: str, splits: Splits) -> dict[str, xr.Dataset]:
    """The frames that an export writes, by the name of their split; "" is all of them, where there are no splits.

    For yolo, which always has the splits train and val, some of the subjects are held out as in training. Raises `ConfigError`
    for a format that tells no splits apart and for the name of a split that is no name of a folder, `DatasetError` where a split
    is empty.
    """
    if splits and name not in IMAGE_KINDS:
        raise ConfigError(f"{name} tells no splits apart", hint="export them one by one")
    if not splits:
        return dict(zip(("train", "val"), held_out(dataset, "train", "val"), strict=True)) if name == "yolo" else {"": dataset}
    for split in splits:
        if not re.fullmatch(r"\w[\w.-]*", split):
            raise ConfigError(f"the split '{split}' cannot name a folder", hint="name it by letters, digits, _ and -")
    return split_dataset(dataset, splits)


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
    """The name of a folder to make, which takes the place of `folder` when the block ends without an error, else is removed."""
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
