"""Other formats, a module each, which is imported when it is asked for.

Of datasets, a module has `export(dataset, folder, report)`, `read(path, options)` for imports, or both; those of `IMAGE_KINDS`
have `export(parts, folder, report, images)`, with the frames of each split by its name. Of recordings, `RECORDING_FORMATS` has
the functions, which `recordings` calls. What is written appears under its name when it is whole.
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from cabinpose.core import ConfigError, DatasetError, unknown_name
from cabinpose.store.schema import MANIFEST_NAME
from cabinpose.store.source import Report, whole_folder
from cabinpose.store.split import Splits, held_out, split_dataset

if TYPE_CHECKING:
    import xarray as xr

    from cabinpose.store.convert.reading import ImportOptions
    from cabinpose.store.source import Source

FORMATS = MappingProxyType({"png-json": "png_json", "coco": "coco", "yolo": "yolo", "itop": "itop", "ntu": "ntu", "ply": "ply"})
IMPORTS = MappingProxyType({"png-json": "png_json", "coco": "coco_import", "itop": "itop_import", "ntu": "ntu", "ticam": "ticam"})
# What the images of a format can be (see `pictures`), its default first; the other formats have but one kind.
IMAGE_KINDS = MappingProxyType({"coco": ("depth8", "amplitude8", "rgb", "depth16"), "yolo": ("depth8", "amplitude8", "rgb")})


class RecordingFormat(NamedTuple):
    """A format of recordings: which of its functions, as "module.function", read and write it, and with which options.

    reads: gives rows of one source, or entries of several; "" where the format is not read · source: name of the one source ·
    read_options: fields of `RecordingOptions` · writes: takes rows of one source, or samples of several; "" where it is not
    written · topics: one of these a source must have to be written; clocks of devices differ, so there may be only one such
    source (none: any number of any) · write_options: fields of `Selection`.
    """

    reads: str = ""
    source: str = ""
    read_options: tuple[str, ...] = ()
    writes: str = ""
    topics: tuple[str, ...] = ()
    write_options: tuple[str, ...] = ()


RECORDING_FORMATS = MappingProxyType(
    {
        "mvnx": RecordingFormat("mvnx.read_mvnx", "suit", ("subjects", "name")),
        "c3d": RecordingFormat(
            "c3d.read_c3d", "optical", ("subjects", "name", "start_ns", "up", "whole_frames"),
            "c3d_write.write_c3d", ("markers",), ("subject", "rate_hz"),
        ),
        "bvh": RecordingFormat(
            "bvh.read_bvh_rows", "motion", ("subjects", "name", "start_ns", "unit_m", "up"),
            "bvh_write.write_bvh", ("poses",), ("subject",),
        ),
        "adtfdat": RecordingFormat("adtfdat.read_adtfdat"),
        "xdf": RecordingFormat("xdf.read_xdf"),
        "azure-mkv": RecordingFormat("azure_mkv.read_azure_mkv", "tof", ("name",)),
        "rosbag2": RecordingFormat("rosbag2.read_rosbag2", "tof", ("name", "topics")),
        "trc": RecordingFormat(writes="opensim.write_trc", topics=("markers",), write_options=("subject", "rate_hz")),
        "sto": RecordingFormat(writes="opensim.write_sto", topics=("poses",), write_options=("subject", "rate_hz", "angles")),
        "csv": RecordingFormat(writes="csv_.write_csv"),
    }
)  # fmt: skip
RECORDING_IMPORTS = tuple(name for name, form in RECORDING_FORMATS.items() if form.reads)
RECORDING_EXPORTS = tuple(name for name, form in RECORDING_FORMATS.items() if form.writes)


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
    return write_parts(parts, name, out, images=images, overwrite=overwrite, report=report)


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


def write_parts(
    parts: dict[str, xr.Dataset],
    name: str,
    out: Path | str,
    *,
    images: str | None = None,
    overwrite: bool = False,
    report: Report | None = None,
) -> Path:
    """Write what `export_parts` gave in the format `name`; everything else as in `export_dataset`."""
    folder = Path(out)
    if (folder / MANIFEST_NAME).exists():
        raise DatasetError(f"{folder} holds a dataset, which an export never replaces", hint="give another folder with --out")
    module: Any = import_module(f"{__package__}.{FORMATS[name]}")
    with whole_folder(folder, "export", overwrite=overwrite) as temporary:
        temporary.mkdir(parents=True)
        tell = report or (lambda _: None)
        if name in IMAGE_KINDS:
            module.export(parts, temporary, tell, images or IMAGE_KINDS[name][0])
        else:
            module.export(parts[""], temporary, tell)
    return folder


def open_source(path: Path | str, name: str, options: ImportOptions) -> Source:
    """Open a dataset in another format; `store.source.import_source` writes it as one of the standard.

    Parameters
    ----------
    path
        The file or folder.
    name
        Its format, one of `IMPORTS`.
    options
        What the user says of it.

    Returns
    -------
    Source
        The manifest, and the frames to come: no image has been read yet.

    Raises
    ------
    ConfigError
        For an unknown format.
    DatasetError
        For a source that is not there, lacks what the format has, or contradicts itself.
    """
    if name not in IMPORTS:
        raise unknown_name("format", name, list(IMPORTS))
    source = Path(path)
    if not source.exists():
        raise DatasetError(f"{source} does not exist", hint="give the file or folder to import")
    module: Any = import_module(f"{__package__}.{IMPORTS[name]}")
    found: Source = module.read(source, options)
    return found
