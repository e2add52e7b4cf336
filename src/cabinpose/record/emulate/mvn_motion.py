"""Motions that the MVN emulator streams: poses of MVN's 23 segments over time, from a recording or made here."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from cabinpose.core import MVN_JOINTS, MVN_SEGMENTS, RecordingError, unknown_name
from cabinpose.signals import F64, Message, SegmentPoses

_COUNT = len(MVN_SEGMENTS)
_PARENT = {child: parent for _, parent, child in MVN_JOINTS}
# Origins in the parent's frame, in MVN's neutral pose (standing, arms to the sides, all orientations identity), of a person of
# 1.75 m, m; the right side's are given, the left's mirror them.
_OFFSETS = {
    "Pelvis": (0.0, 0.0, 0.95), "L5": (0.0, 0.0, 0.10), "L3": (0.0, 0.0, 0.10), "T12": (0.0, 0.0, 0.09), "T8": (0.0, 0.0, 0.09),
    "Neck": (0.0, 0.0, 0.13), "Head": (0.0, 0.0, 0.09), "Shoulder": (0.0, -0.03, 0.07), "UpperArm": (0.0, -0.14, 0.0),
    "Forearm": (0.0, -0.29, 0.0), "Hand": (0.0, -0.25, 0.0), "UpperLeg": (0.0, -0.09, 0.0), "LowerLeg": (0.0, 0.0, -0.43),
    "Foot": (0.0, 0.0, -0.43), "Toe": (0.14, 0.0, -0.07),
}  # fmt: skip
_PERIOD_S = 2.0


@dataclass(frozen=True)
class SuitMotion:
    """Poses in the world (z up) at `rate_hz`: position_m (F, 23, 3), orientation_wxyz (F, 23, 4). It repeats from its start."""

    rate_hz: float
    position_m: F64
    orientation_wxyz: F64

    def __len__(self) -> int:
        return len(self.position_m)

    def frame(self, time_s: float) -> int:
        """The frame that is current at a time."""
        return int(time_s * self.rate_hz + 1e-6) % len(self)

    @cached_property
    def velocity(self) -> F64:
        """(F, 23, 3) m/s; like those below by central differences, across the repetition too."""
        return self._rate(self.position_m)

    @cached_property
    def acceleration(self) -> F64:
        """(F, 23, 3) m/s²."""
        return self._rate(self.velocity)

    @cached_property
    def angular_velocity(self) -> F64:
        """(F, 23, 3) rad/s, in the world."""
        before = _rotations(np.roll(self.orientation_wxyz, 1, axis=0))
        after = _rotations(np.roll(self.orientation_wxyz, -1, axis=0))
        return ((after * before.inv()).as_rotvec() * self.rate_hz / 2).reshape(self.position_m.shape)

    @cached_property
    def angular_acceleration(self) -> F64:
        """(F, 23, 3) rad/s², in the world."""
        return self._rate(self.angular_velocity)

    @cached_property
    def joint_angles(self) -> F64:
        """(F, 22, 3) rad about x, y and z of `MVN_JOINTS`, of the child in the parent, by the sequence z, x, y."""
        index = {name: i for i, name in enumerate(MVN_SEGMENTS)}
        parents = _rotations(self.orientation_wxyz[:, [index[parent] for _, parent, _ in MVN_JOINTS]])
        children = _rotations(self.orientation_wxyz[:, [index[child] for _, _, child in MVN_JOINTS]])
        with warnings.catch_warnings():  # at the singularity one of its angles is as good as another
            warnings.simplefilter("ignore", UserWarning)
            zxy = (parents.inv() * children).as_euler("ZXY")
        return zxy[:, [1, 2, 0]].reshape(len(self), -1, 3)

    def _rate(self, values: F64) -> F64:
        return (np.roll(values, -1, axis=0) - np.roll(values, 1, axis=0)) * self.rate_hz / 2


def _rotations(orientation_wxyz: F64) -> scipy.spatial.transform.Rotation:
    return scipy.spatial.transform.Rotation.from_quat(orientation_wxyz.reshape(-1, 4), scalar_first=True)


def recorded(rows: Iterable[tuple[int, int | None, Message]]) -> SuitMotion:
    """The motion of the first subject of a recording (`store.convert`: MVNX and others) whose segments are MVN's.

    Raises RecordingError where there are fewer than three frames of it.
    """
    times, positions, orientations, subject = [], [], [], None
    for host_ns, device_ns, message in rows:
        if isinstance(message, SegmentPoses) and message.names[:_COUNT] == MVN_SEGMENTS:
            subject = subject or message.subject
            if message.subject == subject:
                times.append(host_ns if device_ns is None else device_ns)
                positions.append(message.position_m[:_COUNT])
                orientations.append(message.orientation_wxyz[:_COUNT])
    if len(times) < 3 or times[-1] <= times[0]:
        raise RecordingError("fewer than three poses of MVN's segments", hint="give a recording of MVN, such as an MVNX file")
    rate_hz = 1e9 * (len(times) - 1) / (times[-1] - times[0])
    return SuitMotion(rate_hz, np.stack(positions), np.stack(orientations))


def generated(name: str = "seated", *, rate_hz: float = 240.0) -> SuitMotion:
    """A motion of two seconds, made from sines: `walk` in place, or `seated` at a steering wheel."""
    if name not in _MADE:
        raise unknown_name("motion", name, list(_MADE))
    frames = round(_PERIOD_S * rate_hz)
    phase = 2 * np.pi * np.arange(frames) / frames
    turns = {segment: np.zeros((frames, 3)) for segment in MVN_SEGMENTS}
    root = np.tile(_OFFSETS["Pelvis"], (frames, 1))
    _MADE[name](phase, turns, root)
    return _forward(turns, root, rate_hz)


def _walk(phase: F64, turns: dict[str, F64], root: F64) -> None:
    root[:, 2] -= 0.02 * (1 - np.cos(2 * phase))
    turns["T8"][:, 2] = 0.08 * np.sin(phase)
    for side, sign, start in (("Right", 1.0, 0.0), ("Left", -1.0, np.pi)):
        lift = np.clip(np.sin(phase + start), 0, None) ** 2
        turns[f"{side}UpperLeg"][:, 1] = -0.9 * lift
        turns[f"{side}LowerLeg"][:, 1] = 1.3 * lift
        turns[f"{side}UpperArm"][:, 0] = sign * 1.3  # hanging, a little apart
        turns[f"{side}UpperArm"][:, 1] = 0.3 * np.sin(phase + start)
        turns[f"{side}Forearm"][:, 2] = sign * 0.3


def _seated(phase: F64, turns: dict[str, F64], root: F64) -> None:
    root[:, 2] = 0.45
    turns["Pelvis"][:, 1] = -0.35  # reclined
    turns["Head"][:, 1] = 0.25
    turns["Head"][:, 2] = 0.5 * np.sin(phase)
    for side, sign in (("Right", 1.0), ("Left", -1.0)):
        turns[f"{side}UpperLeg"][:, 1] = -1.15
        turns[f"{side}LowerLeg"][:, 1] = 1.0
        turns[f"{side}UpperArm"][:, 0] = sign * (0.9 + 0.2 * sign * np.sin(phase))
        turns[f"{side}UpperArm"][:, 2] = sign * 1.1
        turns[f"{side}Forearm"][:, 2] = sign * (0.6 + 0.1 * sign * np.sin(phase))


_MADE = {"walk": _walk, "seated": _seated}


def offset_m(segment: str) -> tuple[float, float, float]:
    """Where a segment of the generated person begins in its parent's frame (the pelvis: in the world), m."""
    side = next((side for side in ("Right", "Left") if segment.startswith(side)), "")
    x, y, z = _OFFSETS[segment.removeprefix(side)]
    return (x, -y, z) if side == "Left" else (x, y, z)


def _forward(turns: dict[str, F64], root: F64, rate_hz: float) -> SuitMotion:
    """Poses from each segment's turn in its parent, as rotation vectors (F, 3): forward kinematics."""
    at: dict[str, F64] = {"Pelvis": root}
    turned = {"Pelvis": scipy.spatial.transform.Rotation.from_rotvec(turns["Pelvis"])}
    for name in MVN_SEGMENTS[1:]:
        parent = _PARENT[name]
        at[name] = at[parent] + turned[parent].apply(offset_m(name))
        turned[name] = turned[parent] * scipy.spatial.transform.Rotation.from_rotvec(turns[name])
    position = np.stack([at[name] for name in MVN_SEGMENTS], axis=1)
    orientation = np.stack([turned[name].as_quat(scalar_first=True) for name in MVN_SEGMENTS], axis=1)
    return SuitMotion(rate_hz, position, orientation)
