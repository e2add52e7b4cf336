"""Messages as a C3D file (through ezc3d), which has one rate of frames, one rate of analog values, and no gaps.

Markers are written as `Subject:Marker` in millimetres, z up, in 32-bit floats; those without a label as `*12`. C3D has 8 bits
for a residual: steps of 0.01 mm, or of a 255th of the largest. A residual that is not known is written
as 0, which C3D calls filled in or unknown.
"""

from __future__ import annotations

import errno
import os
import shutil
import struct
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cabinpose.core import MocapError
from cabinpose.signals import F64, Channels, Facts, JointAngles, Markers, Sample
from cabinpose.store.convert.c3d import ANGLES, check_size, ezc3d, read_c3d
from cabinpose.store.convert.c3d_up import WORLD_FROM_UP, Axis
from cabinpose.store.convert.format import RecordingFormat
from cabinpose.store.convert.rows import Entry, Row, begun_ns, new_file, rows_of
from cabinpose.store.convert.table import Table, TableExport, chosen_subject, told_rate

_MM = 1e3
_BLOCK, _HEADER_SCALE = 512, 12  # bytes
_RESIDUAL_STEP_MM = 0.01
_RESIDUAL_STEPS = 255
_NAMES_A_PARAMETER = 255
_FRAME_LIMIT = 0xFFFF  # 16 bits count the frames
_OURS = ("POINT", "ANALOG", "EVENT", "EZC3D")  # written from the messages, or by the library
# SUBJECTS stays out: it holds the names that codes stand for
_KEPT = ("FORCE_PLATFORM", "MANUFACTURER", "SEG", "PROCESSING", "TRIAL")
_OF_SPAN_AND_AXES = ("ACTUAL_", "X_", "Y_", "Z_")  # of the trial; what is written has its own
_INTEGER = 2  # C3D's number of a type
_POINT_LIMIT = 16_000  # four values a point and 16 bits to count a frame's


def write_c3d(
    path: Path,
    rows: Iterable[Row],
    *,
    subject: str | None = None,
    rate_hz: float | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the markers, joint angles and channels of a recording; the file appears when it is whole.

    A frame's time is its device time (host time where there is none). A frame that is missing is one in which all markers are
    occluded. Channels must come at a multiple of the rate of frames; those that come more slowly than others are repeated. Events
    are taken from facts named `events`, as `read_c3d` gives them. The number of the first frame is kept if it fits into C3D's 16
    bits, else it is 1. Segments, single sensors and images have no place here and are left out.

    Of the parameters of an imported C3D file, which are facts, those of manufacturer, processing, trial and force platforms are
    written again: of platforms if lengths are millimetres and the analog channels the same.

    Parameters
    ----------
    path
        The file to write.
    rows
        The messages of one source.
    subject
        Whose markers and angles, beside all channels; None: everybody's.
    rate_hz
        The rate of the markers; None: as facts (of C3D or Vicon) say, or from the median of the differences of the times.
    overwrite
        Replace the file.

    Returns
    -------
    Path
        The file.

    Warns
    -----
    UserWarning
        Names the groups of parameters that are left out.

    Raises
    ------
    MocapError
        Where there are no markers, or more frames than C3D counts, or rates and times that do not fit each other.
    RecordingError
        Where the file exists or cannot be written.
    """
    module = ezc3d()
    points, angles = Table(3), Table(3)
    residuals = Table(1)
    channels: dict[tuple[str, ...], Table] = {}
    facts: dict[str, Mapping[str, Any]] = {}
    subjects: dict[str, None] = {}  # whose markers there are, in their order
    for host_ns, device_ns, message in rows:
        time_ns = host_ns if device_ns is None else device_ns
        if isinstance(message, Markers):
            subjects[message.subject] = None
        if subject is not None and isinstance(message, Markers | JointAngles) and message.subject != subject:
            continue
        if isinstance(message, Markers):
            names = [_label(message.subject, name) for name in message.names]
            points.add(time_ns, names, message.position_m)
            residuals.add(time_ns, names, message.residual_m)
        elif isinstance(message, JointAngles):
            angles.add(time_ns, [_label(message.subject, name) for name in message.names], message.angles)
        elif isinstance(message, Channels):
            channels.setdefault(message.names, Table(1)).add(time_ns, message.names, message.values)
        elif isinstance(message, Facts):
            facts[message.about] = message.values
    if subject is not None:
        chosen_subject(subjects, subject, "markers")
    if not points.rows:
        raise MocapError("there are no markers to write", hint="export a recording of an optical system")
    if len(points.columns) + len(angles.columns) > _POINT_LIMIT:
        raise MocapError(f"{len(points.columns)} markers are more than C3D holds", hint="leave out those without a label")
    rate = rate_hz or told_rate(facts) or points.rate_hz() or 100.0
    first_ns = min(points.rows)
    count = round((max(points.rows) - first_ns) * 1e-9 * rate) + 1
    if count > _FRAME_LIMIT:
        raise MocapError(f"{count} frames are more than C3D counts ({_FRAME_LIMIT})", hint="export the recording in parts")
    file = module.c3d()
    _put_points(file, points.at(first_ns, rate, count), residuals.at(first_ns, rate, count)[..., 0], points, angles)
    if angles.rows:
        values = angles.at(first_ns, rate, count)
        file["data"]["points"][:3, len(points.columns) :] = np.degrees(values).transpose(2, 1, 0)
        file.add_parameter("POINT", ANGLES, list(angles.columns))
        file.add_parameter("POINT", "ANGLE_UNITS", ["deg"])
    file["parameters"]["POINT"]["RATE"]["value"] = [rate]
    first = round(first_ns * 1e-9 * rate)
    file["header"]["points"]["first_frame"] = first if 0 <= first <= _FRAME_LIMIT - count else 0
    _put_analogs(file, list(channels.values()), first_ns, rate, count, facts.get("analog", {}))
    _put_events(file, facts.get("events", {}))
    _put_groups(file, facts)
    with new_file(path, overwrite=overwrite, binary=True) as out, TemporaryDirectory(dir=Path(out.name).parent) as folder:
        made = Path(folder) / "made.c3d"  # the library wants this ending
        file.write(str(made))
        try:
            check_size(made)
        except MocapError as error:  # a full disk is none to the library
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from error
        with made.open("rb") as source:
            header = bytearray(source.read(_BLOCK))
            # The library leaves the header's scale at -1, whatever the parameter says.
            struct.pack_into("<f", header, _HEADER_SCALE, file["parameters"]["POINT"]["SCALE"]["value"][0])
            out.write(header)
            shutil.copyfileobj(source, out)
    return path


@dataclass(frozen=True, kw_only=True)
class C3dImport:
    """How a C3D file is read."""

    name: str = "optical"
    """Name of the source."""
    begun: str | None = None
    """When it was recorded (2026-11-21T14:30:00+01:00); default: 1970, since the file does not tell."""
    up: Axis | None = None
    """The axis that points up; default: found from markers or file."""
    keep_whole_frames: bool = False
    """Of a truncated file, import the complete frames, and report how many are lost."""


class C3dFormat(RecordingFormat):
    """C3D: markers, joint angles and analog channels."""

    import_options, export_options = C3dImport, TableExport

    def read(self, path: Path, options: C3dImport, subjects: Sequence[str]) -> Iterator[Entry]:
        """As `read_c3d`."""
        start_ns, whole_frames = begun_ns(options.begun), options.keep_whole_frames
        rows = read_c3d(path, subjects=subjects, start_ns=start_ns, up=options.up, whole_frames=whole_frames)
        return ((options.name, *row) for row in rows)

    def topics(self, _: TableExport) -> tuple[str, ...]:
        """Markers."""
        return ("markers",)

    def write(self, out: Path, samples: Iterable[tuple[str, Sample]], options: TableExport, *, overwrite: bool) -> list[Path]:
        """As `write_c3d`."""
        return [write_c3d(out, rows_of(samples), **vars(options), overwrite=overwrite)]


C3D = C3dFormat()


def _label(subject: str, name: str) -> str:
    if subject:
        return f"{subject}:{name}"
    return f"*{name}" if name.isdigit() else name


def _put_points(file: Any, position_m: F64, residual_m: F64, points: Table, angles: Table) -> None:
    count, total = len(position_m), len(points.columns) + len(angles.columns)
    values = np.ones((4, total, count))
    values[:3, : len(points.columns)] = position_m.transpose(2, 1, 0) * _MM
    occluded = ~np.isfinite(position_m).all(axis=2)
    residual_mm = np.where(np.isfinite(residual_m), np.maximum(residual_m, 0.0) * _MM, 0.0)
    residual_mm[occluded] = 0.0
    step = max(_RESIDUAL_STEP_MM, float(residual_mm.max(initial=0.0)) / _RESIDUAL_STEPS)
    residuals = np.zeros((1, total, count))
    residuals[0, : len(points.columns)] = np.where(occluded, -1.0, np.round(residual_mm / step) * step).T
    file["data"]["points"] = values
    file["data"]["meta_points"]["residuals"] = residuals
    file["data"]["meta_points"]["camera_masks"] = np.zeros((7, total, count), bool)
    names = [*points.columns, *angles.columns]
    _put_names(file, "POINT", {"LABELS": names, "DESCRIPTIONS": [""] * len(names)})
    point = file["parameters"]["POINT"]
    point["UNITS"]["value"], point["SCALE"]["value"] = ["mm"], [-step]
    file.add_parameter("POINT", "X_SCREEN", ["+X"])
    file.add_parameter("POINT", "Y_SCREEN", ["+Z"])


def _put_analogs(file: Any, tables: list[Table], first_ns: int, rate: float, count: int, told: Mapping[str, Any]) -> None:
    """All channels at the highest of their rates, each value held until the next."""
    if not tables:
        return
    ratios = []
    for table in tables:
        ratio = (table.rate_hz() or rate) / rate
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 0.02 * ratio:
            raise MocapError(
                f"the channels {', '.join(list(table.columns)[:3])} come {ratio:.3f} times a frame, not a whole number",
                hint="export them to CSV, and leave channels out here",
            )
        ratios.append(round(ratio))
    highest = max(ratios)
    columns = []
    for table, ratio in zip(tables, ratios, strict=True):
        if highest % ratio:
            raise MocapError(f"channels that come {ratio} and {highest} times a frame do not fit", hint="leave channels out")
        inside = {t: parts for t, parts in table.rows.items() if 0 <= round((t - first_ns) * 1e-9 * rate * ratio) < count * ratio}
        values = Table(1, table.columns, inside).at(first_ns, rate * ratio, count * ratio)[..., 0]
        columns.append(np.repeat(values, highest // ratio, axis=0))
    names = [name for table in tables for name in table.columns]
    units_of = dict(zip(told.get("labels") or [], told.get("units") or [], strict=False))
    units = [str(units_of.get(name, "")) for name in names]
    file["data"]["analogs"] = np.concatenate(columns, axis=1).T[None]
    file["parameters"]["ANALOG"]["RATE"]["value"] = [rate * highest]
    _put_names(file, "ANALOG", {"LABELS": names, "UNITS": units})


def _put_names(file: Any, group: str, lists: Mapping[str, Sequence[str]]) -> None:
    """A parameter holds 255 values: the next ones go to LABELS2, and so on."""
    for parameter, values in lists.items():
        for i in range(0, len(values), _NAMES_A_PARAMETER):
            suffix = str(i // _NAMES_A_PARAMETER + 1) if i else ""
            file.add_parameter(group, f"{parameter}{suffix}", list(values[i : i + _NAMES_A_PARAMETER]))


def _put_events(file: Any, told: Mapping[str, Any]) -> None:
    events = [event for event in told.get("events") or [] if isinstance(event, Mapping)]
    if not events:
        return
    minutes, seconds = zip(*(divmod(float(event.get("time_s") or 0.0), 60.0) for event in events), strict=True)
    file.add_parameter("EVENT", "USED", [len(events)])
    file.add_parameter("EVENT", "TIMES", np.array([minutes, seconds]))
    for key in ("label", "context", "subject", "description"):
        file.add_parameter("EVENT", f"{key.upper()}S", [str(event.get(key) or "") for event in events])


def _put_groups(file: Any, facts: Mapping[str, Mapping[str, Any]]) -> None:
    """The parameters of an imported C3D file that still hold, with a warning that names the groups that are left out."""
    up = str(facts.get("points", {}).get("up"))
    left = []
    for group, members in facts.get("parameters", {}).items():
        if group in _OURS or members.get("USED") == [0]:
            continue
        if group not in _KEPT or (group == "FORCE_PLATFORM" and not _same_channels(file, facts)):
            left.append(group)
            continue
        for name, value in members.items():
            if group != "TRIAL" or not name.startswith(_OF_SPAN_AND_AXES):
                _put_value(file, group, name, np.array(value), up)
    if left:
        warnings.warn(f"parameters of the C3D file that are left out: {', '.join(left)}", stacklevel=3)


def _put_value(file: Any, group: str, name: str, value: Any, up: str) -> None:
    if value.dtype == object:  # NaN, which JSON has not, came as null
        return
    if (group, name) == ("FORCE_PLATFORM", "CORNERS"):
        value = np.einsum("ij,jkp->ikp", WORLD_FROM_UP[up], value)
    if value.dtype.kind != "i":
        file.add_parameter(group, name, value.tolist() if value.dtype.kind == "U" else value)
        return
    file.add_parameter(group, name, value.astype(np.float64))
    parameter = file["parameters"][group][name]  # the library makes floats of integers; platforms name channels by integers
    parameter["type"], parameter["value"] = _INTEGER, value


def _same_channels(file: Any, facts: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether a force platform, which names analog channels by their numbers, finds its own, and its lengths in millimetres."""
    points, analog = facts.get("points", {}), facts.get("analog", {})
    written = file["parameters"]["ANALOG"]["LABELS"]["value"]
    same_length = [str(unit).strip().lower() for unit in points.get("units") or []] == ["mm"]
    return same_length and str(points.get("up")) in WORLD_FROM_UP and list(written) == analog.get("labels")
