"""OpenSim's .sto (tab-separated text): orientations of one subject for OpenSense, or joint angles. OpenSim's world has y up.

Orientations (`DataType=Quaternion`, cells `w,x,y,z`) turn from the segment's own frame to OpenSim's world, so that OpenSense's
`sensor_to_opensim_rotations` stays zero. Joint angles are three columns a joint, `name_1` to `name_3`, in radians.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import MocapError
from cabinpose.core.frames import ZUP_FROM_YUP
from cabinpose.core.recorded import F64, Channels, Facts, JointAngles, Message, SegmentPoses
from cabinpose.store.convert.rows import Row, whole_file
from cabinpose.store.convert.table import Table, check_tabbed, chosen_subject, told_rate

_LINE_LIMIT = 1 << 22
_HEADER_LIMIT = 1000  # lines


def write_sto(
    path: Path,
    rows: Iterable[Row],
    *,
    angles: bool = False,
    subject: str | None = None,
    rate_hz: float | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the orientations of the segments of one subject (None: the only one), or its joint `angles`.

    Times and rate as in `write_trc`; what is missing is nan. Raises MocapError where there is nothing to write, several
    subjects, or times that do not fit the rate.
    """
    tables: dict[str, Table] = {}
    facts: dict[str, Mapping[str, Any]] = {}
    for host_ns, device_ns, message in rows:
        time_ns = host_ns if device_ns is None else device_ns
        if angles and isinstance(message, JointAngles):
            tables.setdefault(message.subject, Table(3)).add(time_ns, message.names, message.angles)
        elif not angles and isinstance(message, SegmentPoses):
            tables.setdefault(message.subject, Table(4)).add(time_ns, message.names, message.orientation_wxyz)
        elif isinstance(message, Facts):
            facts[message.about] = message.values
    table = tables[chosen_subject(tables, subject, "joint angles" if angles else "segments")]
    rate = rate_hz or told_rate(facts) or table.rate_hz() or 100.0
    first_ns, values = table.frames(rate)
    names = list(table.columns)
    check_tabbed(names)
    if angles:
        names = [f"{name}_{i}" for name in names for i in (1, 2, 3)]
        cells = [[f"{value:.12g}" for value in frame] for frame in values.reshape(len(values), -1).tolist()]
        head = f"joint angles\nversion=1\nnRows={len(values)}\nnColumns={len(names) + 1}\ninDegrees=no\n"
    else:
        turned = _turned(values, ZUP_FROM_YUP.T)
        cells = [[",".join(f"{part:.12g}" for part in quaternion) for quaternion in frame] for frame in turned.tolist()]
        head = f"DataRate={rate:.6f}\nDataType=Quaternion\nversion=3\nOpenSimVersion=4.5\n"
    with whole_file(path, overwrite=overwrite) as file:
        file.write(head + "endheader\n" + "\t".join(["time", *names]) + "\n")
        for k, frame in enumerate(cells):
            file.write("\t".join([f"{first_ns * 1e-9 + k / rate:.9f}", *frame]) + "\n")
    return path


def read_sto(path: Path, *, subject: str = "", start_ns: int = 0) -> Iterator[Row]:
    """The rows of a .sto or .mot file, after facts with its header.

    Quaternions give poses whose positions are NaN; columns in threes as written here give joint angles (radians, whatever the
    file has); all else gives channels in the file's units. Times as in `read_trc`. Raises MocapError where the file is
    none, or is damaged, after the rows that precede the damage.
    """
    number = 0
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            lines = iter(lambda: file.readline(_LINE_LIMIT), "")
            about: dict[str, object] = {}
            for line in lines:
                number += 1
                if line.strip().lower() == "endheader":
                    break
                if number > _HEADER_LIMIT:
                    raise ValueError("there is no endheader")
                key, _, value = line.strip().partition("=")
                about[key.strip()] = value.strip()
            else:
                raise ValueError("there is no endheader")
            names = tuple(name.strip() for name in next(lines, "").rstrip("\r\n").split("\t"))
            if names[0] != "time" or len(names) < 2:
                raise ValueError("the first column is not `time`")
            yield start_ns, 0, Facts("sto", about)
            number += 1
            for line in lines:
                number += 1
                cells = line.rstrip("\r\n").split("\t")
                if not "".join(cells).strip():
                    continue
                if len(cells) != len(names):
                    raise ValueError(f"{len(cells)} cells under {len(names)} names")
                device_ns = round(float(cells[0]) * 1e9)
                yield start_ns + device_ns, device_ns, _message(subject, names[1:], cells[1:], about)
    except OSError as error:
        raise MocapError(f"cannot read {path} ({error.strerror or error})", hint="check the path") from error
    except (ValueError, OverflowError) as error:
        raise MocapError(f"{path}, line {number}: {error}", hint="give a .sto file of OpenSim") from error


def _message(subject: str, names: tuple[str, ...], cells: list[str], about: Mapping[str, object]) -> Message:
    if about.get("DataType") == "Quaternion":
        quaternions = np.array([[float(part) for part in cell.split(",")] for cell in cells], np.float64)
        if quaternions.shape != (len(names), 4):
            raise ValueError("a cell is no quaternion w,x,y,z")
        return SegmentPoses(subject, names, np.full((len(names), 3), np.nan), _turned(quaternions[None], ZUP_FROM_YUP)[0])
    values = np.array([float(cell) for cell in cells], np.float64)
    joints = tuple(name[:-2] for name in names[::3])
    if names == tuple(f"{joint}_{i}" for joint in joints for i in (1, 2, 3)):
        degrees = str(about.get("inDegrees", "no")).lower() == "yes"
        return JointAngles(subject, joints, (np.radians(values) if degrees else values).reshape(-1, 3))
    return Channels(names, values)


def _turned(quaternions: F64, matrix: F64) -> F64:
    """(F, S, 4) wxyz, turned by a matrix; NaN where they are no rotations."""
    result = np.full(quaternions.shape, np.nan)
    with np.errstate(all="ignore"):
        valid = np.isfinite(quaternions).all(axis=2) & (np.linalg.norm(quaternions, axis=2) > 1e-9)
    if valid.any():
        turned = Rotation.from_matrix(matrix) * Rotation.from_quat(quaternions[valid], scalar_first=True)
        result[valid] = turned.as_quat(scalar_first=True)
    return result
