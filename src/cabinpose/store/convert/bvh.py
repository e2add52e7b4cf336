"""Biovision Hierarchy (BVH) files: reading, forward kinematics, and a recording's messages. `bvh_write` writes such files.

A BVH file gives a hierarchy of joints with offsets, and for every frame the value of each channel. Rotations are
intrinsic, in the order in which the channels are listed (Meredith and Maddock, "Motion Capture File Formats
Explained", 2001). Files come y up with the person facing +z; everything here leaves as metres in a world with z up
and x forward (the vehicle frame's axes).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from cabinpose.core import ConfigError, MocapError
from cabinpose.signals import BodyTrack, Facts, SegmentPoses, body_size, recognised_unit
from cabinpose.store.convert.rows import Row

UpAxis = Literal["y", "z"]

# world_from_file: rows are the world's x (forward), y (left), z (up). Both are proper rotations.
WORLD_FROM_FILE: dict[str, NDArray[np.float64]] = {
    "y": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),  # faces +z, +x to its left
    "z": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),  # faces -y, +x to its left
}
_DEEPEST = 200  # joints below each other
_FRAMES = 32  # that are looked at to recognise the unit
_CHANNELS = {f"{axis}{kind}": (axis, kind) for axis in "XYZ" for kind in ("position", "rotation")}


@dataclass(frozen=True)
class BvhJoint:
    """A joint of a BVH hierarchy: its parent's index (-1 for the root), offset from it (file axes, m), channels.

    An end site is a joint without channels, named after its parent with `_end`.
    """

    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[str, ...]


@dataclass(frozen=True)
class Bvh:
    """A parsed BVH file: the hierarchy, and motion (F, C) as it stands in the file but positions in metres.

    unit_m: metres of the file's unit of length · unit_because: what told it.
    """

    joints: tuple[BvhJoint, ...]
    motion: NDArray[np.float64]
    frame_s: float
    up: UpAxis
    unit_m: float = 1.0
    unit_because: str = "given"

    def in_metres(self, unit_m: float, because: str) -> Bvh:
        """The file with lengths in metres, of one with lengths in its own unit."""
        joints = tuple(replace(j, offset=(j.offset[0] * unit_m, j.offset[1] * unit_m, j.offset[2] * unit_m)) for j in self.joints)
        scale = [unit_m if channel.endswith("position") else 1.0 for joint in joints for channel in joint.channels]
        return replace(self, joints=joints, motion=self.motion * scale, unit_m=unit_m, unit_because=because)

    def kinematics(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Forward kinematics: world_from_joint rotations (F, J, 3, 3), positions (F, J, 3) m, and those at rest (J, 3) m.

        A joint's position channels replace its offset (as in the root), its rotation channels turn its children. At rest all
        rotations are zero and the root lies in the origin. The world has z up.
        """
        frames, count = len(self.motion), len(self.joints)
        axes = WORLD_FROM_FILE[self.up]
        rotations = np.empty((frames, count, 3, 3))
        positions = np.empty((frames, count, 3))
        rest = np.empty((count, 3))
        column = 0
        for j, joint in enumerate(self.joints):
            local = np.broadcast_to(np.eye(3), (frames, 3, 3))
            offset = np.broadcast_to(np.asarray(joint.offset), (frames, 3)).copy()
            values = self.motion[:, column : column + len(joint.channels)]
            column += len(joint.channels)
            kinds = [_CHANNELS[c] for c in joint.channels]
            turns = [(axis, k) for k, (axis, kind) in enumerate(kinds) if kind == "rotation"]
            if turns:
                order = "".join(axis for axis, _ in turns)  # upper case: intrinsic
                angles = values[:, [k for _, k in turns]]
                local = scipy.spatial.transform.Rotation.from_euler(order, angles, degrees=True).as_matrix()
            for k, (axis, kind) in enumerate(kinds):
                if kind == "position":
                    offset[:, "XYZ".index(axis)] = values[:, k]
            if joint.parent < 0:
                rotations[:, j], positions[:, j], rest[j] = local, offset, 0.0
            else:
                parent = rotations[:, joint.parent]
                rotations[:, j] = parent @ local
                positions[:, j] = positions[:, joint.parent] + (parent @ offset[:, :, None])[:, :, 0]
                rest[j] = rest[joint.parent] + np.asarray(joint.offset)
        return axes @ rotations @ axes.T, positions @ axes.T, rest @ axes.T


def read_bvh(path: str | Path, *, unit_m: float | None = None, up: UpAxis = "y") -> Bvh:
    """Read a BVH file.

    Parameters
    ----------
    path
        The file.
    unit_m
        Metres of its unit of length, which the file does not state; None: the one that makes a person of its body.
    up
        Its vertical axis.

    Raises
    ------
    MocapError
        Where the file is missing, damaged, truncated or contradicts itself, and where no unit, or no single one, makes a person.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as e:
        raise MocapError(f"motion file {path} does not exist", hint="check the path") from e
    except (OSError, UnicodeDecodeError) as e:
        raise MocapError(f"motion file {path} cannot be read as text: {e}", hint="a BVH file is plain text") from e
    if unit_m is not None and not (math.isfinite(unit_m) and unit_m > 0):
        raise MocapError(f"unit_m must be a positive length in metres, not {unit_m}", hint="0.01 for centimetres")
    head, separator, tail = text.partition("MOTION")
    if not separator:
        raise MocapError(f"{path.name}: no MOTION section", hint="the file is truncated or not BVH")
    joints = _Hierarchy(path.name, head).parse()
    motion, frame_s = _read_motion(path.name, tail, sum(len(j.channels) for j in joints))
    bvh = Bvh(joints, motion, frame_s, up)
    because = "given"
    if unit_m is None:
        unit_m, because = _recognised(path.name, bvh)
    return bvh.in_metres(unit_m, because)


def read_bvh_rows(
    path: str | Path, *, unit_m: float | None = None, up: str | None = None, subjects: Sequence[str] = (), start_ns: int = 0
) -> Iterator[Row]:
    """The messages of a file: its skeleton as facts, then the pose of every frame; end sites turn with their joint.

    Parameters
    ----------
    path
        The file.
    unit_m
        Metres of its unit of length; None: as `read_bvh` recognises it.
    up
        Its vertical axis, y or z; None: y.
    subjects
        The code of its subject, "subject" where there is none.
    start_ns
        Host time of the first frame: BVH has no clock. device_ns counts from the first frame.

    Raises
    ------
    ConfigError
        For another axis.
    MocapError
        As `read_bvh` does.
    """
    if up not in (None, "y", "z"):
        raise ConfigError(f"a BVH file has y or z up, not {up}", hint="give --up y or --up z")
    subject = (*subjects, "subject")[0]
    bvh = read_bvh(path, unit_m=unit_m, up="z" if up == "z" else "y")
    rotations, positions, rests = bvh.kinematics()
    names = tuple(joint.name for joint in bvh.joints)
    segments = [
        {"name": joint.name, "parent": names[joint.parent] if joint.parent >= 0 else None, "rest_m": [float(x) for x in rest]}
        for joint, rest in zip(bvh.joints, rests, strict=True)
    ]
    about = {"unit_m": bvh.unit_m, "unit_because": bvh.unit_because, "up": bvh.up, "up_because": "given" if up else "assumed"}
    yield start_ns, 0, Facts(f"subject {subject}", {"segments": segments, "frame_rate_hz": 1 / bvh.frame_s, **about})
    turned = scipy.spatial.transform.Rotation.from_matrix(rotations.reshape(-1, 3, 3))
    quaternions = turned.as_quat(scalar_first=True, canonical=True)
    poses = zip(positions, quaternions.reshape(len(positions), -1, 4), strict=True)
    for i, (position, orientation) in enumerate(poses):
        time_ns = round(i * bvh.frame_s * 1e9)
        yield start_ns + time_ns, time_ns, SegmentPoses(subject, names, position, orientation)


def _recognised(name: str, bvh: Bvh) -> tuple[float, str]:
    """Metres of the unit that makes a person of a body in the file's unit, and what told it; MocapError where none does."""
    some = replace(bvh, motion=bvh.motion[:: max(1, len(bvh.motion) // _FRAMES)])
    track = BodyTrack(tuple(joint.name for joint in bvh.joints), some.kinematics()[1])
    found = recognised_unit(track)
    if found is None:
        size = body_size(track)
        seen = f"a stature of {size.stature:.3g}" if np.isfinite(size.stature) else f"a size of {size.size:.3g}"
        raise MocapError(
            f"{name}: BVH states no unit of length, and {seen} tells none: no single unit makes a person of it",
            hint="give it: --unit-m 0.01 for centimetres, 0.0254 for inches",
        )
    return found


class _Hierarchy:
    """A recursive-descent parser of the HIERARCHY section."""

    def __init__(self, name: str, text: str) -> None:
        self._name = name
        self._tokens = text.split()
        self._next = 0
        self._joints: list[BvhJoint] = []

    def parse(self) -> tuple[BvhJoint, ...]:
        self._expect("HIERARCHY")
        self._expect("ROOT")
        self._joint(self._take(), -1)
        if self._next != len(self._tokens):
            raise self._error(f"unexpected '{self._tokens[self._next]}' after the root joint", "one ROOT is supported")
        names = [j.name for j in self._joints]
        doubled = sorted({n for n in names if names.count(n) > 1})
        if doubled:
            raise self._error(f"joint names given twice: {', '.join(doubled)}", "every joint needs a name of its own")
        return tuple(self._joints)

    def _joint(self, name: str, parent: int, depth: int = 0) -> None:
        self._expect("{")
        self._expect("OFFSET")
        offset = self._vector()
        self._expect("CHANNELS")
        channels = self._channels(name)
        index = len(self._joints)
        self._joints.append(BvhJoint(name, parent, offset, channels))
        if depth > _DEEPEST:
            raise self._error(f"joint {name} lies {depth} joints deep", "no body has such a limb")
        while (token := self._take()) != "}":
            if token == "JOINT":
                self._joint(self._take(), index, depth + 1)
            elif token == "End":
                self._expect("Site")
                self._expect("{")
                self._expect("OFFSET")
                self._joints.append(BvhJoint(f"{name}_end", index, self._vector(), ()))
                self._expect("}")
            else:
                raise self._error(f"unexpected '{token}' in joint {name}", "expected JOINT, End Site or }")

    def _channels(self, name: str) -> tuple[str, ...]:
        token = self._take()
        if not re.fullmatch(r"[0-9]{1,2}", token):
            raise self._error(f"joint {name}: '{token[:20]}' is no number of channels", "as in 'CHANNELS 3 Zrotation ...'")
        channels = tuple(self._take() for _ in range(int(token)))
        for channel in channels:
            if channel not in _CHANNELS:
                raise self._error(
                    f"joint {name}: unknown channel '{channel}' (of {token} stated)", f"known: {', '.join(_CHANNELS)}"
                )
        if len(set(channels)) != len(channels):
            raise self._error(f"joint {name} lists a channel twice", "every channel may stand once in a joint")
        return channels

    def _vector(self) -> tuple[float, float, float]:
        tokens = [self._take() for _ in range(3)]
        try:
            x, y, z = map(float, tokens)
        except ValueError as e:
            raise self._error(f"OFFSET needs three numbers, not '{' '.join(tokens)}'", "the file is damaged") from e
        return x, y, z

    def _take(self) -> str:
        if self._next == len(self._tokens):
            raise self._error("the hierarchy ends early", "the file is truncated")
        self._next += 1
        return self._tokens[self._next - 1]

    def _expect(self, word: str) -> None:
        token = self._take()
        if token != word:
            raise self._error(f"expected '{word}', found '{token}'", "the hierarchy is damaged or not BVH")

    def _error(self, message: str, hint: str) -> MocapError:
        return MocapError(f"{self._name}: {message}", hint=hint)


def _read_motion(name: str, text: str, channels: int) -> tuple[NDArray[np.float64], float]:
    """The (F, C) channel values and the seconds between frames of a MOTION section."""
    header = re.match(r"\s*Frames:\s*([0-9]{1,12})\s+Frame Time:\s*(\S+)[^\S\n]*(?:\n|$)", text)
    if header is None:
        raise MocapError(f"{name}: no 'Frames:' and 'Frame Time:' after MOTION", hint="the file is truncated or damaged")
    frames = int(header[1])
    try:
        frame_s = float(header[2])
    except ValueError:
        frame_s = math.nan
    if not (math.isfinite(frame_s) and frame_s > 0):
        raise MocapError(f"{name}: the frame time '{header[2]}' is no positive number", hint="seconds from frame to frame")
    rows = [line.split() for line in text[header.end() :].splitlines() if line.strip()]
    if len(rows) != frames:
        raise MocapError(f"{name}: states {frames} frames and holds {len(rows)}", hint="the file is truncated or damaged")
    if frames == 0:
        raise MocapError(f"{name}: holds no frame", hint="a recording needs at least one")
    for i, row in enumerate(rows):
        if len(row) != channels:
            raise MocapError(f"{name}: frame {i} has {len(row)} values for {channels} channels", hint="the file is damaged")
    try:
        motion = np.array(rows, dtype=np.float64)
    except ValueError as e:
        raise MocapError(f"{name}: a value of the motion is no number: {e}", hint="the file is damaged") from e
    if not np.isfinite(motion).all():
        raise MocapError(f"{name}: the motion holds values that are not finite", hint="the file is damaged")
    return motion, frame_s
