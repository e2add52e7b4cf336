"""What MVN's samples mean: payloads become the messages of `signals.recorded`, in metres, radians and a right-handed world, z up.

Axes. A person in MVN's neutral pose faces +x with +y to the left and +z up (types 02, 13, 20 to 24). Types 01 and 03 have y up:
x left, y up, z forward. Type 05 is Unity's left-handed frame: x right, y up, z forward, every segment relative to its parent.
`Z_UP_FROM_Y_UP` and `Z_UP_FROM_UNITY` take both to ours. Euler angles of type 01 are turns about x, then y, then z of the fixed
frame, as in the vendor's reader.

Units. Types 01 and 03 are in centimetres. For the others the specification says centimetres, the user manual and the vendor's
reader metres: metres are taken, unless a body turns out to be of the size of one in centimetres (`PositionUnit`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import MVN_JOINTS, MVN_SEGMENTS
from cabinpose.record.sources import mvn_protocol as mvn
from cabinpose.record.sources.mvn_protocol import Header
from cabinpose.signals import (
    F64,
    Channels,
    Facts,
    JointAngles,
    Markers,
    Message,
    SegmentKinematics,
    SegmentPoses,
    SensorReadings,
    product,
)

PositionUnit: TypeAlias = Literal["auto", "m", "cm"]
Ids: TypeAlias = NDArray[np.integer]
Fields: TypeAlias = Mapping[str, F64]

Z_UP_FROM_Y_UP: F64 = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
Z_UP_FROM_UNITY: F64 = np.array([[0.0, 0, 1], [-1, 0, 0], [0, 1, 0]])  # a mirror: its determinant is -1
GRAVITY: F64 = np.array([0.0, 0.0, 9.80665])  # what an accelerometer at rest shows in the world frame, m/s²
CM = 0.01
# A body whose segments reach further from its pelvis than this is given in centimetres: nobody has 8 m, or only 8 cm. The
# pelvis' height alone does not tell: MVN's upper-body configurations put it at 0.
SPAN_LIMIT = 8.0

UNITY_SEGMENTS: tuple[str, ...] = (
    "Pelvis", "RightUpperLeg", "RightLowerLeg", "RightFoot", "RightToe", "LeftUpperLeg", "LeftLowerLeg", "LeftFoot", "LeftToe",
    "L5", "L3", "T12", "T8", "LeftShoulder", "LeftUpperArm", "LeftForearm", "LeftHand", "RightShoulder", "RightUpperArm",
    "RightForearm", "RightHand", "Neck", "Head",
)  # fmt: skip
_FINGER_BONES = (
    "Carpus", "FirstMetacarpal", "FirstProximalPhalange", "FirstDistalPhalange",
    *(f"{finger}{bone}" for finger in ("Second", "Third", "Fourth", "Fifth")
      for bone in ("Metacarpal", "ProximalPhalange", "MiddlePhalange", "DistalPhalange")),
)  # fmt: skip
FINGER_SEGMENTS: tuple[str, ...] = tuple(side + bone for side in ("Left", "Right") for bone in _FINGER_BONES)

_PARENT = {child: parent for _, parent, child in MVN_JOINTS}
_JOINT_NAMES = {(parent, child): name for name, parent, child in MVN_JOINTS}
_NONE3: F64 = np.empty((0, 3))
_NAMES_KEPT = 256  # lists of names remembered; a sender has a handful, an attacker any number


def segment_name(number: int) -> str:
    """The name of the segment with this id."""
    return MVN_SEGMENTS[number - 1] if 1 <= number <= len(MVN_SEGMENTS) else f"Segment{number}"


def item_names(header: Header, ids: NDArray[np.integer]) -> tuple[str, ...]:
    """Names of a whole sample's items: body segments, props, fingers left and right, as the header counts them.

    Ids decide where the header does not fit the items (releases before 2019, or a sender that leaves some out). A tracked
    object is a character of one segment.
    """
    if header.body == 1 and len(ids) == 1:
        return ("Object",)
    if header.fingers > len(FINGER_SEGMENTS) or header.body > len(MVN_SEGMENTS):
        return tuple(segment_name(int(number)) for number in ids)
    props = tuple(f"Prop{i + 1}" for i in range(header.props))
    named = MVN_SEGMENTS[: header.body] + props + FINGER_SEGMENTS[: header.fingers]
    return named if len(named) == len(ids) else tuple(segment_name(int(number)) for number in ids)


def rotated_frame_wxyz(orientation_wxyz: F64, to_from: F64) -> F64:
    """Orientations (N, 4) in another world frame, whose axes the segments' own frames follow: M R Mᵀ, M may be a mirror."""
    vector = np.linalg.det(to_from) * (orientation_wxyz[:, 1:] @ to_from.T)
    return np.concatenate([orientation_wxyz[:, :1], vector], axis=1)


def euler_to_wxyz(euler_deg: F64) -> F64:
    """Quaternions (N, 4) of turns (N, 3) about the fixed x, then y, then z axis: Rz Ry Rx."""
    half = np.radians(euler_deg) / 2
    (sx, sy, sz), (cx, cy, cz) = np.sin(half).T, np.cos(half).T
    return np.stack(
        [cx * cy * cz + sx * sy * sz, sx * cy * cz - cx * sy * sz, cx * sy * cz + sx * cy * sz, cx * cy * sz - sx * sy * cz],
        axis=1,
    )


def wxyz_to_euler(orientation_wxyz: F64) -> F64:
    """The inverse of `euler_to_wxyz`, degrees (N, 3)."""
    w, x, y, z = orientation_wxyz.T
    about_x = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    about_y = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    about_z = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.degrees(np.stack([about_x, about_y, about_z], axis=1))


def rotate_wxyz(orientation_wxyz: F64, vectors: F64, *, inverse: bool = False) -> F64:
    """Vectors (N, 3) turned by unit quaternions (N, 4), or back."""
    w, v = orientation_wxyz[:, :1], orientation_wxyz[:, 1:]
    t = 2 * np.cross(-v if inverse else v, vectors)
    return vectors + w * t + np.cross(-v if inverse else v, t)


def composed(names: tuple[str, ...], position: F64, orientation_wxyz: F64) -> tuple[F64, F64]:
    """Global poses of segments given relative to their parents, which stand before them; those without a parent are global."""
    at, turn = position.copy(), orientation_wxyz.copy()
    index = {name: i for i, name in enumerate(names)}
    for i, name in enumerate(names):
        parent = index.get(_PARENT.get(name, ""))
        if parent is not None and parent < i:
            one, up = slice(i, i + 1), slice(parent, parent + 1)
            at[one] = at[up] + rotate_wxyz(turn[up], position[one])
            turn[one] = product(turn[up], orientation_wxyz[one])
    return at, turn


class Decoder:
    """Turns the whole samples of one sender into messages; it knows what the sender said before of names and units.

    `subjects` names the characters by their ids; the others are `character0`, `character1`, and so on, never what MVN calls
    them, which may be a person's name.
    """

    def __init__(self, *, position_unit: PositionUnit = "auto", subjects: Mapping[int, str] | None = None) -> None:
        self._setting: PositionUnit = position_unit
        self._subjects = dict(subjects or {})
        self._scale_m: dict[int, float] = {}  # character -> metres to the sender's unit, once known
        self._names: dict[tuple[bytes, int, int, int], tuple[str, ...]] = {}
        self._points: dict[tuple[int, int], str] = {}  # (character, point id) -> name

    def subject(self, character: int) -> str:
        """What messages call a character."""
        return self._subjects.get(character) or self._subjects.setdefault(character, f"character{character}")

    def restart(self) -> None:
        """The sender has restarted: it may have another unit, other people and other points."""
        self._scale_m.clear()
        self._points.clear()

    def __call__(self, header: Header, payload: bytes) -> tuple[Message, ...]:
        """The messages of a whole sample, whose `header.items` counts the items of all its pieces. Raises MalformedError.

        A sender's infinities and NaN stay what they are; `np.errstate` tells whether numpy warns of them.
        """
        decode = _DECODERS[header.kind]
        if header.kind not in mvn.ITEMS:
            return decode(self, header, payload)
        items = mvn.read_items(header.kind, header.items, payload)
        return decode(self, header, items["id"], {name: items[name].astype(np.float64) for name in items.dtype.names or ()})

    def _quaternion(self, header: Header, ids: Ids, of: Fields) -> tuple[Message, ...]:
        return self._poses(header, self._named(header, ids), of["position"], of["orientation_wxyz"])

    def _euler(self, header: Header, ids: Ids, of: Fields) -> tuple[Message, ...]:
        orientation = rotated_frame_wxyz(euler_to_wxyz(of["euler_deg"]), Z_UP_FROM_Y_UP)
        position = of["position"] @ Z_UP_FROM_Y_UP.T * CM
        return (SegmentPoses(self.subject(header.character), self._named(header, ids), position, orientation),)

    def _unity(self, header: Header, ids: Ids, of: Fields) -> tuple[Message, ...]:
        body = len(UNITY_SEGMENTS)
        names = tuple(UNITY_SEGMENTS[n - 1] if 1 <= n <= body else f"Prop{n - body - 1}" for n in ids.tolist())
        orientation = rotated_frame_wxyz(of["orientation_wxyz"], Z_UP_FROM_UNITY)
        return self._poses(header, names, *composed(names, of["position"] @ Z_UP_FROM_UNITY.T, orientation))

    def _poses(self, header: Header, names: tuple[str, ...], position: F64, orientation: F64) -> tuple[Message, ...]:
        """Poses in the world, of a unit that has to be settled with the first of them."""
        facts = () if header.character in self._scale_m else self._decide_unit(header.character, names, position)
        position = position * self._metres(header.character)
        return (*facts, SegmentPoses(self.subject(header.character), names, position, orientation))

    def _points_of(self, header: Header, ids: Ids, of: Fields) -> tuple[Message, ...]:
        names = tuple(self._point_name(header.character, number) for number in ids.tolist())
        position = of["position"] @ Z_UP_FROM_Y_UP.T * CM
        return (Markers(self.subject(header.character), names, position, np.full(len(names), np.nan)),)

    def _joint_angles(self, header: Header, ids: Ids, of: Fields) -> tuple[Message, ...]:
        ends = (ids // mvn.SEGMENT_STRIDE, of["child"].astype(np.int64) // mvn.SEGMENT_STRIDE)
        pairs = [(segment_name(a), segment_name(b)) for a, b in zip(*(end.tolist() for end in ends), strict=True)]
        names = tuple(_JOINT_NAMES.get(pair, "_".join(pair)) for pair in pairs)  # MVNX calls its ergonomic angles so: T8_Head
        return (JointAngles(self.subject(header.character), names, np.radians(of["angles_deg"])),)

    def _linear(self, header: Header, ids: Ids, of: Fields) -> tuple[Message, ...]:
        scale, names = self._metres(header.character), self._named(header, ids)
        velocity, acceleration = of["velocity"] * scale, of["acceleration"] * scale
        return (SegmentKinematics(self.subject(header.character), names, velocity, acceleration, _NONE3, _NONE3),)

    def _angular(self, header: Header, ids: Ids, of: Fields) -> tuple[Message, ...]:
        speed, change = of["angular_velocity"], of["angular_acceleration"]
        return (SegmentKinematics(self.subject(header.character), self._named(header, ids), _NONE3, _NONE3, speed, change),)

    def _trackers(self, header: Header, ids: Ids, of: Fields) -> tuple[Message, ...]:
        orientation, gyro = of["orientation_wxyz"], of.get("angular_velocity", _NONE3)
        acceleration = of.get("acceleration")
        if acceleration is None:  # what accelerometers show, from their acceleration in the world without gravity
            acceleration = rotate_wxyz(orientation, of["free_acceleration"] + GRAVITY, inverse=True)
        names = tuple(map(segment_name, ids.tolist()))
        return (SensorReadings(self.subject(header.character), names, orientation, acceleration, gyro, of["magnetic_field"]),)

    def _centre_of_mass(self, header: Header, payload: bytes) -> tuple[Message, ...]:
        position = mvn.read_centre_of_mass(payload)[:3] * self._metres(header.character)
        names = tuple(f"{self.subject(header.character)}.centre_of_mass.{axis}" for axis in "xyz")
        return (Channels(names, position),)

    def _time_code(self, header: Header, payload: bytes) -> tuple[Message, ...]:
        return (Facts(self.subject(header.character), {"time_code": mvn.read_time_code(payload)}),)

    def _meta(self, header: Header, payload: bytes) -> tuple[Message, ...]:
        return (Facts(self.subject(header.character), dict(mvn.read_meta(payload))),)

    def _scale(self, header: Header, payload: bytes) -> tuple[Message, ...]:
        scale = mvn.read_scale(payload)
        if len(self._points) < _NAMES_KEPT * mvn.MAX_PIECES:
            for p in scale.points:
                self._points[header.character, p.segment * mvn.SEGMENT_STRIDE + p.point] = p.name
        values: dict[str, object] = {}
        if scale.segments:
            values["segment_origins"] = {name: list(at) for name, at in scale.segments.items()}
        if scale.points:
            values["points"] = [
                {"segment": segment_name(p.segment), "point": p.point, "name": p.name, "flags": p.flags, "offset": list(p.offset)}
                for p in scale.points
            ]
        return (Facts(self.subject(header.character), values),)

    def _metres(self, character: int) -> float:
        """Metres to the unit of a character's positions; while it is not known, what the setting says, or metres."""
        return self._scale_m.get(character, CM if self._setting == "cm" else 1.0)

    def _named(self, header: Header, ids: NDArray[np.integer]) -> tuple[str, ...]:
        key = (ids.tobytes(), header.body, header.props, header.fingers)
        names = self._names.get(key)
        if names is None:
            if len(self._names) >= _NAMES_KEPT:
                self._names.clear()
            names = self._names[key] = item_names(header, ids)
        return names

    def _point_name(self, character: int, number: int) -> str:
        segment, point = divmod(number, mvn.SEGMENT_STRIDE)
        return self._points.get((character, number)) or f"{segment_name(segment)}.{point}"

    def _decide_unit(self, character: int, names: tuple[str, ...], position: F64) -> tuple[Message, ...]:
        """Settle the unit of a character's positions, once; an object has no size to tell by and takes the others' unit."""
        if self._setting != "auto":
            unit, why = self._setting, "setting"
        elif "Pelvis" in names and len(names) > 1:
            span = np.linalg.norm(position - position[names.index("Pelvis")], axis=1)
            span = span[[name in _PARENT for name in names]]
            if not (np.isfinite(span).any() and np.nanmax(span) > 0):
                return ()
            unit, why = ("cm" if np.nanmax(span) > SPAN_LIMIT else "m"), "size of the body"
        elif self._scale_m:
            unit, why = ("cm" if CM in self._scale_m.values() else "m"), "unit of the others"
        else:
            return ()
        self._scale_m[character] = CM if unit == "cm" else 1.0
        return (Facts(self.subject(character), {"position_unit": unit, "position_unit_from": why}),)


# Decoders of `mvn.ITEMS` take header, ids (N,) and the fields of the items by name, in float64; the others header and payload.
_DECODERS: Mapping[int, Callable[..., tuple[Message, ...]]] = {
    mvn.EULER: Decoder._euler,
    mvn.QUATERNION: Decoder._quaternion,
    mvn.POINTS: Decoder._points_of,
    mvn.UNITY: Decoder._unity,
    mvn.META: Decoder._meta,
    mvn.SCALE: Decoder._scale,
    mvn.JOINT_ANGLES: Decoder._joint_angles,
    mvn.LINEAR: Decoder._linear,
    mvn.ANGULAR: Decoder._angular,
    mvn.TRACKERS: Decoder._trackers,
    mvn.CENTRE_OF_MASS: Decoder._centre_of_mass,
    mvn.TIME_CODE: Decoder._time_code,
}
