"""OpenSim's text files: markers of one subject as .trc, its segments' orientations (for OpenSense) or joint angles as .sto.

OpenSim's world has y up: x forward, y up, z to the right. In a .trc, an occluded marker is three empty cells; residuals have no
place. In a .sto, orientations (`DataType=Quaternion`, cells `w,x,y,z`) turn from the segment's own frame to OpenSim's world, so
that OpenSense's `sensor_to_opensim_rotations` stays zero; joint angles are three columns a joint, `name_1` to `name_3`, in
radians.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import scipy

from cabinpose.core import ZUP_FROM_YUP, MocapError
from cabinpose.signals import F64, Facts, JointAngles, Markers, Sample, SegmentPoses
from cabinpose.store.convert.format import RecordingFormat
from cabinpose.store.convert.rows import Row, check_rotations, new_file, rows_of
from cabinpose.store.convert.table import Table, TableExport, chosen_subject, told_rate

_MM = 1e3
_Message = Markers | SegmentPoses | JointAngles


def write_trc(
    path: Path, rows: Iterable[Row], *, subject: str | None = None, rate_hz: float | None = None, overwrite: bool = False
) -> Path:
    """Write the markers of one subject in millimetres; the file appears when it is whole.

    Parameters
    ----------
    path
        The file to write.
    rows
        The messages of one source. A frame's time is its device time, or its host time where there is none.
    subject
        Whose markers; None: those of the only subject.
    rate_hz
        Frames a second; None: as the source's facts say, else from the median of the differences of the times.
    overwrite
        Replace the file.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MocapError
        Where there are no markers, or of several subjects, or times that do not fit the rate.
    RecordingError
        Where the file exists or cannot be written.
    """
    table, rate = _table(rows, Markers, "position_m", "markers", subject, rate_hz)
    first_ns, values = table.frames(rate)
    position_mm = values @ ZUP_FROM_YUP * _MM  # row vectors: times the matrix is the inverse rotation, to y up
    names = list(table.columns)
    with _text_file(path, names, overwrite=overwrite) as file:
        file.write(f"PathFileType\t4\t(X/Y/Z)\t{path.name}\n")
        file.write("DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n")
        file.write(f"{rate:.6f}\t{rate:.6f}\t{len(values)}\t{len(names)}\tmm\t{rate:.6f}\t1\t{len(values)}\n")
        file.write("Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t\n")
        file.write("\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(len(names)) for axis in "XYZ") + "\n\n")
        for k, frame in enumerate(position_mm):
            cells = ["\t\t" if np.isnan(point).any() else "\t".join(f"{x:.6f}" for x in point) for point in frame.tolist()]
            file.write(f"{k + 1}\t{first_ns * 1e-9 + k / rate:.9f}\t" + "\t".join(cells) + "\n")
    return path


def write_sto(
    path: Path,
    rows: Iterable[Row],
    *,
    angles: bool = False,
    subject: str | None = None,
    rate_hz: float | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the orientations of the segments of one subject, or its joint `angles`; what is missing is nan.

    Everything else as in `write_trc`; RecordingError also where orientations are no rotations.
    """
    if angles:
        table, rate = _table(rows, JointAngles, "angles", "joint angles", subject, rate_hz)
        first_ns, values = table.frames(rate)
        names = [f"{name}_{i}" for name in table.columns for i in (1, 2, 3)]
        cells = [[f"{value:.12g}" for value in frame] for frame in values.reshape(len(values), -1).tolist()]
        head = f"joint angles\nversion=1\nnRows={len(values)}\nnColumns={len(names) + 1}\ninDegrees=no\n"
    else:
        table, rate = _table(rows, SegmentPoses, "orientation_wxyz", "segments", subject, rate_hz)
        first_ns, values = table.frames(rate)
        check_rotations("the segments", values)
        names = list(table.columns)
        cells = [[",".join(f"{part:.12g}" for part in quaternion) for quaternion in frame] for frame in _y_up(values).tolist()]
        head = f"DataRate={rate:.6f}\nDataType=Quaternion\nversion=3\nOpenSimVersion=4.5\n"
    with _text_file(path, table.columns, overwrite=overwrite) as file:
        file.write(head + "endheader\n" + "\t".join(["time", *names]) + "\n")
        for k, frame in enumerate(cells):
            file.write("\t".join([f"{first_ns * 1e-9 + k / rate:.9f}", *frame]) + "\n")
    return path


@dataclass(frozen=True, kw_only=True)
class StoExport(TableExport):
    """How a .sto file is written."""

    angles: bool = False
    """Joint angles in place of orientations."""


class TrcFormat(RecordingFormat):
    """Markers for OpenSim."""

    export_options = TableExport

    def topics(self, _: TableExport) -> tuple[str, ...]:
        """Markers."""
        return ("markers",)

    def write(self, out: Path, samples: Iterable[tuple[str, Sample]], options: TableExport, *, overwrite: bool) -> list[Path]:
        """As `write_trc`."""
        return [write_trc(out, rows_of(samples), subject=options.subject, rate_hz=options.rate_hz, overwrite=overwrite)]


class StoFormat(RecordingFormat):
    """Orientations or joint angles for OpenSim."""

    export_options = StoExport

    def topics(self, options: StoExport) -> tuple[str, ...]:
        """Segments' poses or joint angles."""
        return ("joint_angles",) if options.angles else ("poses",)

    def write(self, out: Path, samples: Iterable[tuple[str, Sample]], options: StoExport, *, overwrite: bool) -> list[Path]:
        """As `write_sto`."""
        return [write_sto(out, rows_of(samples), **vars(options), overwrite=overwrite)]


TRC = TrcFormat()
STO = StoFormat()


def _table(
    rows: Iterable[Row], kind: type[_Message], array: str, what: str, subject: str | None, rate_hz: float | None
) -> tuple[Table, float]:
    """An array of one subject's messages of a kind, and the rate of its frames in Hz."""
    tables: dict[str, Table] = {}
    facts: dict[str, Mapping[str, Any]] = {}
    for host_ns, device_ns, message in rows:
        if isinstance(message, kind):
            values = getattr(message, array)
            table = tables.setdefault(message.subject, Table(values.shape[1]))
            table.add(host_ns if device_ns is None else device_ns, message.names, values)
        elif isinstance(message, Facts):
            facts[message.about] = message.values
    table = tables[chosen_subject(tables, subject, what)]
    return table, rate_hz or told_rate(facts) or table.rate_hz() or 100.0


@contextmanager
def _text_file(path: Path, names: Iterable[str], *, overwrite: bool) -> Iterator[IO[str]]:
    """The file to write to. Raises MocapError for a name that cannot be a cell of tab-separated text."""
    for name in names:
        if "\t" in name or name.splitlines() != [name]:
            raise MocapError(
                f"{name!r} is no name for tab-separated text: it is empty, or holds a tab or the end of a line",
                hint="rename it where it was recorded, or export to csv",
            )
    with new_file(path, overwrite=overwrite) as file:
        yield file


def _y_up(orientation_wxyz: F64) -> F64:
    """(F, S, 4) orientations in OpenSim's world; NaN where they are not known."""
    result = np.full(orientation_wxyz.shape, np.nan)
    valid = np.isfinite(orientation_wxyz).all(axis=2)
    if valid.any():
        upright = scipy.spatial.transform.Rotation.from_matrix(ZUP_FROM_YUP.T)
        turned = scipy.spatial.transform.Rotation.from_quat(orientation_wxyz[valid], scalar_first=True)
        result[valid] = (upright * turned).as_quat(scalar_first=True)
    return result
