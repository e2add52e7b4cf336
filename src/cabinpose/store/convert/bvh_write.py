"""Poses of one subject as a Biovision Hierarchy (BVH) file, which `bvh.read_bvh` and animation programs read.

BVH turns rigid bones at a constant rate. A segment whose place in its parent's frame moves gets position channels, as the root
has them, so that nothing is lost; poses that did not come at a constant rate are interpolated (positions linearly, rotations by
SLERP). Files are in centimetres, y up.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import IO

import numpy as np
import scipy

from cabinpose.core import MVN_JOINTS, MVN_SEGMENTS, RecordingError
from cabinpose.signals import F64, Facts, Sample, SegmentPoses, resample_positions, resample_rotations
from cabinpose.store.convert.bvh import WORLD_FROM_FILE, UpAxis, read_bvh_rows
from cabinpose.store.convert.format import RecordingFormat
from cabinpose.store.convert.rows import Entry, Row, begun_ns, check_rotations, new_file, rows_of
from cabinpose.store.convert.table import newest_ns, period_ns

_UNIT_M = 0.01
_UP = "y"
_RIGID_M = 1e-4  # a bone's end that moves less in its parent's frame is an offset of the skeleton
_STILL = 1e-6  # of a rotation matrix: an end site turns with its joint
_EULER = "ZYX"  # intrinsic, the order in which most files list rotations
_MOST_VALUES = 1 << 28  # of the poses in memory: an hour of 60 segments at 240 Hz


@dataclass(frozen=True, kw_only=True)
class BvhImport:
    """How a BVH file is read."""

    name: str = "motion"
    """Name of the source."""
    begun: str | None = None
    """When it was recorded (2026-11-21T14:30:00+01:00); default: 1970, since the file does not tell."""
    unit_m: float | None = None
    """Metres of the unit of length; default: the one that makes a person of the body."""
    up: UpAxis | None = None
    """The axis that points up; default: y."""


@dataclass(frozen=True, kw_only=True)
class BvhExport:
    """How a BVH file is written."""

    subject: str | None = None
    """The subject to export; default: the first."""


class BvhFormat(RecordingFormat):
    """Biovision Hierarchy: poses for animation programs."""

    import_options, export_options = BvhImport, BvhExport

    def read(self, path: Path, options: BvhImport, subjects: Sequence[str]) -> Iterator[Entry]:
        """As `read_bvh_rows`."""
        start_ns = begun_ns(options.begun)
        rows = read_bvh_rows(path, unit_m=options.unit_m, up=options.up, subjects=subjects, start_ns=start_ns)
        return ((options.name, *row) for row in rows)

    def topics(self, _: BvhExport) -> tuple[str, ...]:
        """Segments' poses."""
        return ("poses",)

    def write(self, out: Path, samples: Iterable[tuple[str, Sample]], options: BvhExport, *, overwrite: bool) -> list[Path]:
        """As `write_bvh`."""
        return [write_bvh(out, rows_of(samples), subject=options.subject, overwrite=overwrite)]


BVH = BvhFormat()


@dataclass(frozen=True)
class _Skeleton:
    """Segments with parents before children; `parents` are indices, -1 for the root."""

    names: tuple[str, ...]
    parents: tuple[int, ...]


def write_bvh(path: Path, rows: Iterable[Row], *, subject: str | None = None, overwrite: bool = False) -> Path:
    """Write a subject's poses; the file appears when it is whole.

    Parameters
    ----------
    path
        The file to write.
    rows
        The messages of one source. Parents of segments are those that facts on the subject state, or those of MVN's segments.
    subject
        Whose poses; None: those of the first.
    overwrite
        Replace the file.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    RecordingError
        Where there are no poses, the hierarchy is not known or not one tree, segments were not seen, their orientations are no
        rotations, or the file exists.
    """
    stated: dict[str, Mapping[str, str]] = {}
    names: tuple[str, ...] = ()
    times: list[int] = []
    positions: list[F64] = []
    orientations: list[F64] = []
    for host_ns, device_ns, message in rows:
        if isinstance(message, Facts) and (found := _stated_parents(message.values)):
            stated[message.about.removeprefix("subject ")] = found
        if not isinstance(message, SegmentPoses) or (subject is not None and message.subject != subject):
            continue
        if not times:
            subject, names = message.subject, message.names
        if message.names != names:
            raise RecordingError(f"the segments of {subject} change", hint="cut the recording where they do")
        times.append(host_ns if device_ns is None else device_ns)
        positions.append(message.position_m)
        orientations.append(message.orientation_wxyz)
        if len(times) * len(names) * 7 > _MOST_VALUES:
            raise RecordingError("the recording is too long for one BVH file", hint="cut it")
    if not times:
        raise RecordingError(f"no poses{'' if subject is None else f' of {subject}'} to write", hint="BVH needs segments' poses")
    skeleton, order = _skeleton(names, stated.get(subject or "") or _mvn_parents(names))
    check_rotations(subject or "the subject", np.array(orientations))
    moved = _regular(times, np.array(positions)[:, order], np.array(orientations)[:, order])
    with new_file(path, overwrite=overwrite) as file:
        _write(file, skeleton, *moved)
    return path


def _stated_parents(values: Mapping[str, object]) -> Mapping[str, str]:
    """Parents from the facts on a subject, as Vicon's and BVH's are; nothing where there are none."""
    segments = values.get("segments")
    if not isinstance(segments, Sequence):
        return {}
    pairs = [(s.get("name"), s.get("parent")) for s in segments if isinstance(s, Mapping)]
    return {str(name): str(parent) for name, parent in pairs if parent}


def _mvn_parents(names: Sequence[str]) -> Mapping[str, str]:
    known = set(MVN_SEGMENTS)
    if not set(names) <= known:
        raise RecordingError("the hierarchy of these segments is not known", hint="give the parent of each segment")
    return {child: parent for _, parent, child in MVN_JOINTS}


def _skeleton(names: tuple[str, ...], parents: Mapping[str, str]) -> tuple[_Skeleton, list[int]]:
    """The tree with parents first, and where each of its segments stands among `names`."""
    roots = [name for name in names if parents.get(name, "") not in names]
    if len(roots) != 1:
        raise RecordingError(f"{len(roots)} segments have no parent: {', '.join(roots[:5])}", hint="BVH holds one tree")
    ordered: list[str] = []
    waiting = [roots[0]]
    while waiting:
        ordered.append(waiting.pop())
        waiting += [name for name in reversed(names) if parents.get(name) == ordered[-1]]
    if len(ordered) != len(names):
        raise RecordingError("the segments form a ring", hint="check their parents")
    indices = tuple(ordered.index(parents[name]) if name != roots[0] else -1 for name in ordered)
    return _Skeleton(tuple(ordered), indices), [names.index(name) for name in ordered]


def _regular(times_ns: Sequence[int], positions: F64, orientations: F64) -> tuple[F64, F64, float]:
    """Positions, rotation matrices and seconds a frame at a constant rate."""
    unseen = int((~np.isfinite(positions).all(axis=(1, 2)) | ~np.isfinite(orientations).all(axis=(1, 2))).sum())
    if unseen:
        raise RecordingError(
            f"{unseen} of {len(times_ns)} frames have segments that were not seen", hint="BVH cannot say that; cut"
        )
    reduce(newest_ns, times_ns, None)  # of one start of the device
    time, first = np.unique(np.asarray(times_ns, dtype=np.int64), return_index=True)
    positions, orientations = positions[first], orientations[first]
    frame_s = 1 / 60
    if len(time) > 1:
        seconds = (time - time[0]) / 1e9
        frame_s = period_ns(times_ns) / 1e9
        even = np.arange(round(seconds[-1] / frame_s) + 1) * frame_s
        if len(even) == len(time) and np.abs(even - seconds).max() < 0.01 * frame_s:
            frame_s = float(seconds[-1] / (len(time) - 1))
        else:
            even = even[even <= seconds[-1]]
            positions = resample_positions(seconds, positions, even, max_gap_s=math.inf)
            orientations = resample_rotations(seconds, orientations, even, max_gap_s=math.inf)
    rotations = scipy.spatial.transform.Rotation.from_quat(orientations.reshape(-1, 4), scalar_first=True).as_matrix()
    return positions, rotations.reshape(*orientations.shape[:2], 3, 3), frame_s


def _write(file: IO[str], skeleton: _Skeleton, positions: F64, rotations: F64, frame_s: float) -> None:
    """Write the hierarchy and the motion of segments whose poses in the world are given."""
    world_from_file = WORLD_FROM_FILE[_UP]
    places = positions @ world_from_file / _UNIT_M
    turns = world_from_file.T @ rotations @ world_from_file
    columns: list[F64] = []
    offsets: list[F64] = []
    moving: list[bool] = []
    ends: set[int] = set()
    for s, parent in enumerate(skeleton.parents):
        local, turn = places[:, s], turns[:, s]
        if parent >= 0:
            back = turns[:, parent].transpose(0, 2, 1)
            local, turn = (back @ (local - places[:, parent])[:, :, None])[:, :, 0], back @ turn
        offset = np.median(local, axis=0) if parent >= 0 else np.zeros(3)
        moves = parent < 0 or bool(np.linalg.norm(local - offset, axis=1).max() > _RIGID_M / _UNIT_M)
        offsets.append(offset)
        moving.append(moves)
        if not moves and _is_end(skeleton, s) and np.abs(turn - np.eye(3)).max() < _STILL:
            ends.add(s)
            continue
        if moves:
            columns.append(local)
        columns.append(scipy.spatial.transform.Rotation.from_matrix(turn).as_euler(_EULER, degrees=True, suppress_warnings=True))
    file.write("HIERARCHY\n")
    _joint(file, skeleton, 0, offsets, moving, ends, "")
    motion = np.concatenate(columns, axis=1)
    file.write(f"MOTION\nFrames: {len(motion)}\nFrame Time: {frame_s:.9f}\n")
    np.savetxt(file, motion, fmt="%.6f")


def _is_end(skeleton: _Skeleton, s: int) -> bool:
    """Whether a segment is called as `bvh.read_bvh` calls the end site of its parent, and nothing follows it."""
    parent = skeleton.parents[s]
    return parent >= 0 and s not in skeleton.parents and skeleton.names[s] == f"{skeleton.names[parent]}_end"


def _joint(
    file: IO[str], skeleton: _Skeleton, s: int, offsets: Sequence[F64], moving: Sequence[bool], ends: Collection[int], indent: str
) -> None:
    """A segment and those below it. A leaf without an end site gets one of no length, which the format demands."""
    inner = indent + "\t"
    file.write(f"{indent}{'JOINT' if s else 'ROOT'} {_name(skeleton.names[s])}\n{indent}{{\n")
    file.write(f"{inner}OFFSET {' '.join(f'{x:.6f}' for x in offsets[s])}\n")
    channels = [*(f"{axis}position" for axis in "XYZ" if moving[s]), *(f"{axis}rotation" for axis in _EULER)]
    file.write(f"{inner}CHANNELS {len(channels)} {' '.join(channels)}\n")
    children = [child for child, parent in enumerate(skeleton.parents) if parent == s]
    for child in children:
        if child not in ends:
            _joint(file, skeleton, child, offsets, moving, ends, inner)
    for end in [offsets[child] for child in children if child in ends] or ([] if children else [np.zeros(3)]):
        file.write(f"{inner}End Site\n{inner}{{\n{inner}\tOFFSET {' '.join(f'{x:.6f}' for x in end)}\n{inner}}}\n")
    file.write(f"{indent}}}\n")


def _name(name: str) -> str:
    """A name without blanks and braces, which would end it."""
    return "".join("_" if c.isspace() or c in "{}" else c for c in name) or "_"
