"""Datasets to other formats and back. What is written appears under its name when it is whole."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cabinpose.core import DatasetError
from cabinpose.store.convert.format import DatasetFormat, format_of, made_options
from cabinpose.store.schema import MANIFEST_NAME, read_manifest
from cabinpose.store.source import Report, new_folder

if TYPE_CHECKING:
    import xarray as xr

    from cabinpose.store.source import Source
    from cabinpose.store.split import Splits


def export_dataset(
    dataset: xr.Dataset,
    name: str,
    out: Path | str,
    /,
    *,
    splits: Splits | None = None,
    overwrite: bool = False,
    report: Report | None = None,
    **options: Any,
) -> Path:
    """Write a dataset (or a selection of it) in another format.

    Parameters
    ----------
    dataset
        The frames to write.
    name
        The format, one of `FORMATS` that writes datasets.
    out
        The folder to write; it appears when the export is whole.
    splits
        Splits to write apart, for the formats that tell them apart.
    overwrite
        Replace what is in the folder.
    report
        Called with the number of frames done.
    **options
        The format's own, such as `images="depth16"` of coco.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ConfigError
        For an unknown format, or options or splits that it does not have.
    DatasetError
        Where `out` exists and `overwrite` is not given or it holds a dataset, where the format cannot hold the dataset, or where
        the disk is full; then nothing is left behind.
    """
    form = format_of(name, DatasetFormat, "write")
    chosen = made_options(name, form.options("write"), options)
    return write_parts(form, form.parts(dataset, splits or {}), Path(out), chosen, overwrite=overwrite, report=report)


def write_parts(
    form: DatasetFormat,
    parts: Mapping[str, xr.Dataset],
    folder: Path,
    options: Any,
    *,
    overwrite: bool = False,
    report: Report | None = None,
) -> Path:
    """Write what `form.parts` gave; everything else as in `export_dataset`."""
    read = (Path(part.encoding["source"]).resolve() for part in parts.values() if "source" in part.encoding)
    below = (not _is_chosen(manifest.parent) for manifest in folder.glob(f"*/{MANIFEST_NAME}"))
    if (folder / MANIFEST_NAME).exists() or any(below) or any(each.is_relative_to(folder.resolve()) for each in read):
        raise DatasetError(f"{folder} holds a dataset, which an export never replaces", hint="give another folder with --out")
    with new_folder(folder, overwrite=overwrite) as temporary:
        temporary.mkdir(parents=True)
        form.write(parts, temporary, options, report or (lambda _: None))
        kinds = {each.suffix or each.name for each in temporary.iterdir()}
        for each in sorted(folder.iterdir()) if folder.is_dir() else ():
            if (each.suffix or each.name) not in kinds:
                raise DatasetError(
                    f"{folder} holds {each.name}, which this export has not", hint="move it away, or give another --out"
                )
    return folder


def _is_chosen(folder: Path) -> bool:
    """Whether a dataset is of frames that were chosen of another one, as a split that was exported is."""
    with suppress(DatasetError):
        return bool(read_manifest(folder).selection)
    return False


def open_source(path: Path | str, name: str, /, **options: Any) -> Source:
    """Open a dataset in another format; `store.source.import_source` writes it as one of the standard.

    Parameters
    ----------
    path
        The file or folder.
    name
        Its format, one of `FORMATS` that reads datasets.
    **options
        What the user says of it: `intrinsics`, `licence` and the format's own, such as `correct="head"` of itop.

    Returns
    -------
    Source
        The manifest, and the frames to come: no image has been read yet.

    Raises
    ------
    ConfigError
        For an unknown format, or an option that it does not have.
    DatasetError
        For a source that is not there, lacks what the format has, or contradicts itself.
    """
    form = format_of(name, DatasetFormat, "read")
    source, chosen = Path(path), made_options(name, form.options("read"), options)
    if not source.exists():
        raise DatasetError(f"{source} does not exist", hint="give the file or folder to import")
    return form.read(source, chosen)
