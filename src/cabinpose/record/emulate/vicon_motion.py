"""What an emulated Vicon system sees: subjects whose segments and markers move, a period that repeats."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from cabinpose.core import MocapError
from cabinpose.signals import F64, Facts, Markers
from cabinpose.store.convert import motion_rows


@dataclass(frozen=True)
class SubjectMotion:
    """A subject over F frames, in the world (m, z up): S segments, and M markers, NaN where they are not seen.

    parents: the index of each segment's parent, -1 = none · position_m (F, S, 3) · rotation (F, S, 3, 3), from the segment's
    frame to the world · marker_m (F, M, 3) · attached: the index of the segment that each marker sits on.
    """

    name: str
    segments: tuple[str, ...]
    parents: tuple[int, ...]
    position_m: F64
    rotation: F64
    markers: tuple[str, ...]
    marker_m: F64
    attached: tuple[int, ...]


@dataclass(frozen=True)
class MarkerMotion:
    """F frames at `rate_hz`, which repeat: subjects, and markers without a label, loose_m (F, U, 3), NaN = not seen."""

    rate_hz: float
    subjects: tuple[SubjectMotion, ...]
    loose_m: F64

    @property
    def frames(self) -> int:
        """F."""
        return len(self.loose_m)


# Segments of a kinematic fit, parents first: name, parent, offset from the parent in its frame (m; x forward, y left, z up).
_CENTRE = (
    ("LowerBack", "", (0.0, 0.0, 1.0)),
    ("LowerBack_L_Collar", "LowerBack", (0.0, 0.0, 0.3)),
    ("Head", "LowerBack_L_Collar", (0.0, 0.0, 0.2)),
    ("Head_End", "Head", (0.0, 0.0, 0.1)),
)
_SIDED = (
    ("{}_Humerus", "LowerBack_L_Collar", (0.0, 0.18, 0.12)),
    ("{}_Elbow", "{}_Humerus", (0.0, 0.0, -0.29)),
    ("{}_Wrist", "{}_Elbow", (0.0, 0.0, -0.25)),
    ("{}_Wrist_End", "{}_Wrist", (0.0, 0.0, -0.08)),
    ("{}_Femur", "LowerBack", (0.0, 0.09, -0.08)),
    ("{}_Tibia", "{}_Femur", (0.0, 0.0, -0.42)),
    ("{}_Foot", "{}_Tibia", (0.0, 0.0, -0.41)),
    ("{}_Toe", "{}_Foot", (0.14, 0.0, -0.05)),
)
_MARKERS_PER_SEGMENT = 2


def generated_motion(
    *,
    rng: np.random.Generator,
    rate_hz: float = 100.0,
    seconds: float = 4.0,
    subjects: tuple[str, ...] = ("S01",),
    loose: int = 2,
) -> MarkerMotion:
    """People whose joints swing on sines that fit the period, each 1 m beside the last, markers fixed to their segments."""
    frames = max(1, round(rate_hz * seconds))
    phase = np.arange(frames) / frames * 2 * np.pi  # (F,)
    chain = [*_CENTRE, *(_on_side(row, side) for side in ("L", "R") for row in _SIDED)]
    people = tuple(_person(name, place, chain, phase, rng) for place, name in enumerate(subjects))
    sway = 0.2 * np.stack([np.cos(phase), np.sin(phase), np.zeros(frames)], axis=1)  # (F, 3)
    return MarkerMotion(rate_hz, people, rng.uniform(0, 2, (loose, 3)) + sway[:, None])


def _on_side(row: tuple[str, str, tuple[float, float, float]], side: str) -> tuple[str, str, tuple[float, float, float]]:
    name, parent, (x, y, z) = row
    return name.format(side), parent.format(side), (x, y if side == "L" else -y, z)


def _person(
    name: str, place: int, chain: list[tuple[str, str, tuple[float, float, float]]], phase: F64, rng: np.random.Generator
) -> SubjectMotion:
    names = tuple(row[0] for row in chain)
    parents = tuple(names.index(parent) if parent else -1 for _, parent, _ in chain)
    position, rotation = np.zeros((len(phase), len(chain), 3)), np.zeros((len(phase), len(chain), 3, 3))
    for i, ((_, _, offset), parent) in enumerate(zip(chain, parents, strict=True)):
        axis = rng.normal(size=3)
        swing = rng.uniform(0.1, 0.4) * np.sin(rng.integers(1, 4) * phase + rng.uniform(0, 2 * np.pi))  # (F,) rad
        local = scipy.spatial.transform.Rotation.from_rotvec(swing[:, None] * axis / np.linalg.norm(axis)).as_matrix()
        if parent < 0:
            rotation[:, i] = local
            position[:, i] = np.add(offset, (0.0, 1.0 * place, 0.0)) + 0.1 * np.sin(phase)[:, None] * (1.0, 0.0, 0.2)
        else:
            rotation[:, i] = rotation[:, parent] @ local
            position[:, i] = position[:, parent] + rotation[:, parent] @ np.array(offset)
    attached = tuple(i for i in range(len(chain)) for _ in range(_MARKERS_PER_SEGMENT))
    on_segment = rng.uniform(-0.05, 0.05, (len(attached), 3))
    marker_m = position[:, attached] + (rotation[:, attached] @ on_segment[..., None])[..., 0]
    markers = tuple(f"{names[i]}{k % _MARKERS_PER_SEGMENT + 1}" for k, i in enumerate(attached))
    return SubjectMotion(name, names, parents, position, rotation, markers, marker_m, attached)


def motion_of_c3d(path: Path) -> MarkerMotion:
    """The markers of a C3D file, by subject; each subject has one segment, `Root`: its markers' common motion.

    Root's frame is the world's, moved to the middle of the markers of the frame that shows most of them. Where less than
    three of them are seen it is not seen. Raises MocapError for a file without markers.
    """
    rows: dict[str, list[Markers]] = {}
    rate = 0.0
    for _, _, message in motion_rows(path):
        if isinstance(message, Markers):
            rows.setdefault(message.subject, []).append(message)
        elif isinstance(message, Facts) and message.about == "points":
            rate = float(str(message.values["rate_hz"]))
    loose = rows.pop("", [])
    if not rows and not loose:
        raise MocapError(f"{path} has no markers", hint="give a C3D file with labelled markers, or leave the motion out")
    frames = len(next(iter(rows.values()), loose))
    subjects = tuple(_of_markers(name, messages) for name, messages in rows.items())
    loose_m = np.array([message.position_m for message in loose]) if loose else np.zeros((frames, 0, 3))
    return MarkerMotion(rate, subjects, loose_m)


def _of_markers(name: str, messages: list[Markers]) -> SubjectMotion:
    marker_m = np.array([message.position_m for message in messages])  # (F, M, 3)
    seen = np.isfinite(marker_m).all(axis=2)
    first = int(seen.sum(axis=1).argmax())
    origin = marker_m[first][seen[first]].mean(axis=0)
    position, rotation = np.full((len(marker_m), 1, 3), np.nan), np.full((len(marker_m), 1, 3, 3), np.nan)
    for k, points in enumerate(marker_m):
        both = seen[k] & seen[first]
        if both.sum() < 3:
            continue
        was, now = marker_m[first][both], points[both]
        turn, _ = scipy.spatial.transform.Rotation.align_vectors(now - now.mean(axis=0), was - was.mean(axis=0))
        rotation[k, 0] = turn.as_matrix()
        position[k, 0] = now.mean(axis=0) + turn.apply(origin - was.mean(axis=0))
    return SubjectMotion(name, ("Root",), (-1,), position, rotation, messages[0].names, marker_m, (0,) * len(messages[0].names))
