"""Binary PLY point clouds, one file a frame: position (m, camera frame), colour of the class, label, instance, amplitude."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from cabinpose.store.convert.format import DatasetFormat
from cabinpose.store.frames import file_stem, frames, label_colours, require_variables
from cabinpose.store.lazy import points_m
from cabinpose.store.source import Report

if TYPE_CHECKING:
    import xarray as xr

_PLY_TYPE = {"<f4": "float", "|u1": "uchar", "<u2": "ushort"}


@dataclass(frozen=True, kw_only=True)
class PlyExport:
    """How point clouds are written."""

    depth: Literal["depth", "depth_clean", "depth_styled"] = "depth"
    """The depth whose points are written."""


class PlyFormat(DatasetFormat):
    """Point clouds, one file a frame."""

    export_options = PlyExport

    def write(self, parts: Mapping[str, xr.Dataset], folder: Path, options: PlyExport, report: Report) -> None:
        """Write the points of every frame into `folder`; invalid pixels have no point.

        Raises `DatasetError` without that depth, or without classes.
        """
        (dataset,) = parts.values()
        require_variables(dataset, "PLY", (options.depth, "labels"))
        colours = label_colours(dataset)
        dataset = dataset.assign(depth=dataset[options.depth])
        for done, frame in enumerate(frames(dataset, ("depth", "labels", "instance", "amplitude")), 1):
            write_ply(folder / f"{file_stem(frame)}.ply", cloud(frame, colours))
            report(done)


PLY = PlyFormat()


def cloud(frame: xr.Dataset, colours: NDArray[np.uint8]) -> NDArray[Any]:
    """(n,) structured array of the valid pixels of a frame, row by row."""
    points = points_m(frame).values
    valid = np.isfinite(points[..., 2])
    fields = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "|u1"), ("green", "|u1"), ("blue", "|u1"), ("label", "|u1")]
    extra = [(name, kind) for name, kind in (("instance", "|u1"), ("amplitude", "<u2")) if name in frame]
    rows = np.empty(int(valid.sum()), fields + extra)
    labels = frame["labels"].values[valid]
    rows["x"], rows["y"], rows["z"] = points[valid].T
    rows["red"], rows["green"], rows["blue"] = colours[labels].T
    rows["label"] = labels
    for name, _ in extra:
        rows[name] = frame[name].values[valid]
    return rows


def write_ply(path: Path, rows: NDArray[Any]) -> None:
    """One PLY file of vertices whose properties are the fields of `rows`."""
    properties = "".join(f"property {_PLY_TYPE[rows.dtype[name].str]} {name}\n" for name in rows.dtype.names or ())
    header = "ply\nformat binary_little_endian 1.0\ncomment camera frame: x right, y down, z forward, metres\n"
    header += f"element vertex {len(rows)}\n{properties}end_header\n"
    path.write_bytes(header.encode("ascii") + rows.tobytes())
