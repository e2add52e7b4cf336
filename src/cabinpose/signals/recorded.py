"""Devices and what they say: their interface, samples, decoded messages. SI units, frames as stated.

Rotations are quaternions (w, x, y, z), active, from the segment's frame to the frame that positions are in. World frames
have z up. Names are the device's own; `core.skeleton` maps them to joints of ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class SegmentPoses:
    """Positions (S, 3) m and orientations (S, 4) wxyz of the named segments of a subject or object in the world (z up).

    NaN where a segment was not seen.
    """

    subject: str
    names: tuple[str, ...]
    position_m: F64
    orientation_wxyz: F64


@dataclass(frozen=True)
class SegmentKinematics:
    """Of the named segments of a subject, in the world: what a device streams beside the poses; (0, 3) where it does not.

    velocity (S, 3) m/s · acceleration (S, 3) m/s² · angular_velocity (S, 3) rad/s · angular_acceleration (S, 3) rad/s².
    """

    subject: str
    names: tuple[str, ...]
    velocity: F64
    acceleration: F64
    angular_velocity: F64
    angular_acceleration: F64


@dataclass(frozen=True)
class SensorReadings:
    """Single inertial sensors of a subject: orientation_wxyz (S, 4), acceleration (S, 3) m/s², angular_velocity (S, 3) rad/s,
    magnetic_field (S, 3), arbitrary unit. Arrays that a device does not give are (0, n).
    """

    subject: str
    names: tuple[str, ...]
    orientation_wxyz: F64
    acceleration: F64
    angular_velocity: F64
    magnetic_field: F64


@dataclass(frozen=True)
class JointAngles:
    """Angles (J, 3) rad about the three axes that the device defines for each named joint."""

    subject: str
    names: tuple[str, ...]
    angles: F64


@dataclass(frozen=True)
class Markers:
    """Optical markers: position_m (M, 3) in the world (z up), NaN = occluded; residual_m (M,), NaN = unknown.

    Markers without a label are named by their number, and have the subject "".
    """

    subject: str
    names: tuple[str, ...]
    position_m: F64
    residual_m: F64


@dataclass(frozen=True)
class ToFFrame:
    """One frame of a ToF camera; images (H, W), (0, 0) where the camera gives none.

    depth: uint16, `depth_unit_m` a step, 0 = invalid, along the optical axis · amplitude: uint16 · confidence: uint8 ·
    camera_k (3, 3) px, camera_dist (5,) OpenCV's k1 k2 p1 p2 k3 of the depth image · amplitude_dist (5,): of the amplitude
    image, which some cameras deliver distorted beside undistorted points · noise: uint16, the camera's own sigma of its depth in
    micrometres, 0 = unknown · balance: uint16, the balance image of Bluetechnix' kits, in the camera's unit.
    """

    depth: NDArray[np.uint16]
    depth_unit_m: float
    amplitude: NDArray[np.uint16]
    confidence: NDArray[np.uint8]
    camera_k: F64
    camera_dist: F64
    amplitude_dist: F64
    noise: NDArray[np.uint16] = field(default_factory=lambda: np.zeros((0, 0), np.uint16))
    balance: NDArray[np.uint16] = field(default_factory=lambda: np.zeros((0, 0), np.uint16))

    def depth_m(self) -> NDArray[np.float32]:
        """(H, W) depth along the optical axis, m, NaN = invalid: the same numbers as a dataset of the frame holds."""
        depth = self.depth * np.float32(self.depth_unit_m)
        with np.errstate(invalid="ignore"):
            depth /= self.depth != 0  # 0 / 0 is NaN; takes half as long as setting it where a mask says so
        return depth


FRAME_IMAGES = ("amplitude", "confidence", "noise", "balance")  # of a `ToFFrame`, beside its depth


@dataclass(frozen=True)
class Channels:
    """Values (C,) of the named channels of a generic stream (Lab Streaming Layer, a force plate)."""

    names: tuple[str, ...]
    values: F64


MOTOR_CHANNELS = ("motor_deg", "motor_step")  # of a motor that turns a sensor: its angle, and which standstill is sampled, or -1


@dataclass(frozen=True)
class Facts:
    """What a device says of itself or its subject: name, scale, calibration, frame rate, as plain JSON data."""

    about: str
    values: Mapping[str, object] = field(default_factory=dict)


SETUP: Final = "setup"
"""Facts on a camera's values are about it: by the name of each what was `asked`, what it is (`actual`), why it was `refused`."""

DOUBTS: Final = "doubts"
"""Facts on what the recorder doubted of a source while it ran are about it: `words`, a list."""

# What a recording holds.
Message: TypeAlias = SegmentPoses | SegmentKinematics | SensorReadings | JointAngles | Markers | ToFFrame | Channels | Facts

ARRAYS: Final[Mapping[type[Any], Mapping[str, int]]] = MappingProxyType(
    {
        SegmentPoses: {"position_m": 3, "orientation_wxyz": 4},
        SegmentKinematics: {"velocity": 3, "acceleration": 3, "angular_velocity": 3, "angular_acceleration": 3},
        SensorReadings: {"orientation_wxyz": 4, "acceleration": 3, "angular_velocity": 3, "magnetic_field": 3},
        JointAngles: {"angles": 3},
        Markers: {"position_m": 3, "residual_m": 0},
        Channels: {"values": 0},
    }
)
"""Messages with one row of numbers a name: their arrays and the width of each; 0 = one number a name."""
TOPICS: Final[Mapping[type[Any], str]] = MappingProxyType(
    {
        SegmentPoses: "poses", SegmentKinematics: "kinematics", SensorReadings: "sensors", JointAngles: "joint_angles",
        Markers: "markers", Channels: "channels", Facts: "facts",
    }
)  # fmt: skip
"""The name of each kind of message in recordings and tables; a `ToFFrame` has several."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One thing that a device sent: the bytes as they came, and what they mean.

    sequence: the source's own count of what was sent, without gaps where nothing was lost, rising, starting anywhere; None
    where the device does not count (or for bytes that are not part of the count) · host_ns: when it arrived, `HostClock` ·
    device_ns: the device's time stamp, its own clock, unwrapped; None where it gives none · raw: a datagram, packet or
    vendor frame as it came, b"" where the vendor's library gives arrays only · messages: decoded; empty for bytes that
    make no whole message yet, or none at all.
    """

    sequence: int | None
    host_ns: int
    device_ns: int | None
    raw: bytes
    messages: tuple[Message, ...] = ()


@dataclass
class Counts:
    """What became of what a device sent, so far. `lost` is known from gaps in the device's own count."""

    received: int = 0
    lost: int = 0
    reordered: int = 0
    duplicate: int = 0
    malformed: int = 0
    restarts: int = 0


class FrameSource(Protocol):
    """A device, or something that plays one. One thread uses it: open, read again and again, close."""

    @property
    def name(self) -> str:
        """What the rig's configuration calls it; the first part of its topics."""

    @property
    def counts(self) -> Counts:
        """What became of what was sent; may be read by other threads."""

    def check(self) -> Sequence[str]:
        """What keeps it from working now, one line each, with the remedy; nothing = ready. Leaves it as it was."""

    def open(self) -> None:
        """Connect. Raises RecordingError with a hint where this fails."""

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """What has arrived, in the order of arrival; waits at most `timeout_s` for the first. Empty = nothing came.

        A device that went away is waited for: `read` tries to reach it again and counts a restart. Raises
        SourceEndedError where nothing will ever come again (a file played to its end).
        """

    def close(self) -> None:
        """Disconnect; harmless if it is not open."""
