"""MVNX files (version 4) for the tests: messages of one subject of MVN as `mvnx.read_mvnx` gives them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain, groupby
from pathlib import Path
from typing import IO, Any
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from cabinpose.core.skeleton import MVN_JOINTS, MVN_SEGMENTS
from cabinpose.signals.recorded import (
    F64,
    Channels,
    Facts,
    JointAngles,
    Message,
    SegmentKinematics,
    SegmentPoses,
    SensorReadings,
)
from cabinpose.store.convert.mvnx import CENTRE, GRAVITY, turned
from cabinpose.store.convert.rows import Row

# Where joints lie in the segment that they hang on, of a person of 1.75 m: x to the front, y to the left, z up; m.
_LEFT = {
    "LeftShoulder": (0.0, 0.03, 0.10), "LeftUpperArm": (0.0, 0.16, 0.0), "LeftForearm": (0.0, 0.32, 0.0),
    "LeftHand": (0.0, 0.26, 0.0), "LeftUpperLeg": (0.0, 0.09, 0.0), "LeftLowerLeg": (0.0, 0.0, -0.43),
    "LeftFoot": (0.0, 0.0, -0.43), "LeftToe": (0.16, 0.0, -0.06),
}  # fmt: skip
PERSON_M = _LEFT | {name.replace("Left", "Right"): (x, -y, z) for name, (x, y, z) in _LEFT.items()}
PERSON_M |= {"L5": (0.0, 0.0, 0.1), "L3": (0.0, 0.0, 0.1), "T12": (0.0, 0.0, 0.1), "T8": (0.0, 0.0, 0.1)}
PERSON_M |= {"Neck": (0.0, 0.0, 0.14), "Head": (0.0, 0.0, 0.1)}


def moving_person(frames: int, rate_hz: float = 60.0, swing_rad: float = 0.3) -> list[tuple[F64, F64]]:
    """Positions (23, 3) m and orientations (23, 4) wxyz of MVN's segments, by forward kinematics: of a person whose joints swing,
    each in its own way, and who turns once in 6 s.
    """
    rng = np.random.default_rng(1)
    axes, phases = rng.normal(size=(23, 3)), rng.uniform(0, 2 * np.pi, 23)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    parents = {child: parent for _, parent, child in MVN_JOINTS}
    result = []
    for i in range(frames):
        at = i / rate_hz
        swing = Rotation.from_rotvec(axes * swing_rad * np.sin(2 * np.pi * at + phases)[:, None])
        turn = {"Pelvis": Rotation.from_euler("z", 60 * at, degrees=True) * swing[0]}
        place = {"Pelvis": np.array([0.2 * at, 0.0, 0.93])}
        while len(turn) < len(MVN_SEGMENTS):
            for k, name in enumerate(MVN_SEGMENTS):
                if name not in turn and parents[name] in turn:
                    place[name] = place[parents[name]] + turn[parents[name]].apply(PERSON_M[name])
                    turn[name] = turn[parents[name]] * swing[k]
        wxyz = np.stack([turn[name].as_quat(scalar_first=True, canonical=True) for name in MVN_SEGMENTS])
        result.append((np.stack([place[name] for name in MVN_SEGMENTS]), wxyz))
    return result


THEIRS = {name: name.replace("Forearm", "ForeArm") for name in MVN_SEGMENTS}
_NAMESPACE = "http://www.xsens.com/mvn/mvnx"
_MS = 1_000_000


def write_mvnx(path: Path, rows: Iterable[Row]) -> Path:
    """Write the messages of one subject, in their order of time, and return the path.

    A frame is what has one device time (host time where there is none). The first frame tells which segments, sensors and joints
    there are, facts the frame rate.
    """
    with path.open("w", encoding="utf-8") as file:
        _write(file, rows)
    return path


def _write(file: IO[str], rows: Iterable[Row]) -> None:
    facts: list[Mapping[str, object]] = []
    frames = _frames(rows, facts)
    first = next(frames)
    header = _Header(facts, first[2])
    file.write(header.text())
    for index, frame in enumerate(chain([first], frames)):
        file.write(header.frame(index, *frame))
    file.write("</frames>\n</subject>\n</mvnx>\n")


def _frames(rows: Iterable[Row], facts: list[Mapping[str, object]]) -> Iterator[tuple[int, int, list[Message]]]:
    """Frames as (host_ns, device_ns, messages); facts before the first are collected in `facts`."""
    for device_ns, group in groupby(rows, key=lambda row: row[0] if row[1] is None else row[1]):
        host_ns: int | None = None
        messages: list[Message] = []
        for host, _, message in group:
            host_ns = host if host_ns is None else host_ns
            if isinstance(message, Facts):
                facts.append(message.values)
            else:
                messages.append(message)
        if messages and host_ns is not None:
            yield host_ns, device_ns, messages


def _channel(name: str) -> tuple[str, str, str]:
    """A channel's subject, kind and label; the kind is empty where it is none of MVN's."""
    for kind in ("foot_contact", "centre_of_mass"):
        subject, found, label = name.partition(f".{kind}.")
        if found:
            return subject, kind, label
    return name, "", ""


class _Header:
    """What precedes the frames, and decides what they hold."""

    def __init__(self, facts: list[Mapping[str, object]], messages: list[Message]) -> None:
        known: dict[str, Any] = {}
        for each in facts:
            known |= {key: value for key, value in each.items() if key != "calibration"}
        self._program: Mapping[str, str] = known.get("mvn", {})
        self._subject: Mapping[str, str] = known.get("mvnx_subject", {})
        self._points: list[Mapping[str, Any]] = known.get("points", [])
        self._calibrations: list[Mapping[str, Any]] = [each for each in facts if "calibration" in each]
        self._rate_hz = float(known["frame_rate_hz"])
        self.sensors: tuple[str, ...] = ()
        self.angles: tuple[str, ...] = ()
        self.contacts: tuple[str, ...] = ()
        for message in messages:
            if isinstance(message, SensorReadings):
                self.sensors = message.names
            elif isinstance(message, JointAngles):
                self.angles = message.names
            elif isinstance(message, Channels):
                channels = map(_channel, message.names)
                self.contacts = tuple(label for _, kind, label in channels if kind == "foot_contact")
        joints = tuple(name for name, _, _ in MVN_JOINTS)
        self.ergonomic = tuple(a for a in self.angles if a not in joints and not a.endswith(".xzy"))

    def text(self) -> str:
        """The file up to the first normal frame."""
        attributes = dict(self._subject) or {"label": "MVN"}
        attributes |= {"frameRate": f"{self._rate_hz:g}", "segmentCount": str(len(MVN_SEGMENTS))}
        lines = ['<?xml version="1.0" encoding="UTF-8"?>', f'<mvnx xmlns="{_NAMESPACE}" version="4">']
        if self._program:
            lines.append(_tag("mvn", self._program, empty=True))
        lines += [_tag("subject", attributes), "<segments>"]
        for number, segment in enumerate(MVN_SEGMENTS, 1):
            lines += [_tag("segment", {"label": THEIRS[segment], "id": str(number)}), "<points>"]
            for point in self._points:
                if point["segment"] == segment:
                    lines.append(f"{_tag('point', {'label': point['name']})}<pos_b>{_text(point['offset'])}</pos_b></point>")
            lines += ["</points>", "</segment>"]
        lines.append("</segments>")
        lines += _list("sensors", "sensor", [THEIRS.get(name, name) for name in self.sensors])
        lines.append("<joints>")
        for name, parent, child in MVN_JOINTS:
            ends = f"<connector1>{THEIRS[parent]}/{name}</connector1><connector2>{THEIRS[child]}/{name}</connector2>"
            lines.append(f"{_tag('joint', {'label': name})}{ends}</joint>")
        lines.append("</joints>")
        lines += _list("ergonomicJointAngles", "ergonomicJointAngle", self.ergonomic)
        lines += _list("footContactDefinition", "contactDefinition", self.contacts)
        lines.append("<frames>")
        for each in self._calibrations:
            lines.append(_tag("frame", {"time": "0", "tc": "00:00:00:00", "ms": "0", "type": each["calibration"]}))
            lines += [_array("orientation", each["orientation_wxyz"]), _array("position", each["position"]), "</frame>"]
        return "\n".join(lines) + "\n"

    def frame(self, index: int, host_ns: int, device_ns: int, messages: list[Message]) -> str:
        """One normal frame; its index is that of its time at the frame rate, where it lies on one, so that gaps stay gaps."""
        at = device_ns * self._rate_hz / 1e9
        index = round(at) if abs(at - round(at)) < 0.1 else index
        milliseconds = {"time": str(round(device_ns / _MS)), "index": str(index), "ms": str(round(host_ns / _MS))}
        attributes = milliseconds | {"type": "normal"}
        arrays = [line for message in messages for line in self._arrays(message) if line]
        return "\n".join([_tag("frame", attributes), *arrays, "</frame>"]) + "\n"

    def _arrays(self, message: Message) -> Iterator[str]:
        if isinstance(message, SegmentPoses):
            yield _array("orientation", message.orientation_wxyz)
            yield _array("position", message.position_m)
        elif isinstance(message, SegmentKinematics):
            yield _array("velocity", message.velocity)
            yield _array("acceleration", message.acceleration)
            yield _array("angularVelocity", message.angular_velocity)
            yield _array("angularAcceleration", message.angular_acceleration)
        elif isinstance(message, SensorReadings):
            if len(message.acceleration) and len(message.orientation_wxyz):
                yield _array("sensorFreeAcceleration", turned(message.orientation_wxyz, message.acceleration) - GRAVITY)
            else:
                yield _array("sensorAcceleration", message.acceleration)
            yield _array("sensorAngularVelocity", message.angular_velocity)
            yield _array("sensorMagneticField", message.magnetic_field)
            yield _array("sensorOrientation", message.orientation_wxyz)
        elif isinstance(message, JointAngles):
            degrees, joints = dict(zip(message.names, np.degrees(message.angles), strict=True)), [j for j, _, _ in MVN_JOINTS]
            for name, these in (("jointAngle", joints), ("jointAngleXZY", [f"{joint}.xzy" for joint in joints])):
                if all(joint in degrees for joint in these):
                    yield _array(name, np.array([degrees[joint] for joint in these]))
            yield _array("jointAngleErgo", np.array([degrees[joint] for joint in self.ergonomic]))
        elif isinstance(message, Channels):
            values = {_channel(name)[1:]: value for name, value in zip(message.names, message.values, strict=True)}
            contacts, centre = [("foot_contact", label) for label in self.contacts], [("centre_of_mass", axis) for axis in CENTRE]
            yield _array("footContacts", [values[key] for key in contacts if key in values])
            yield _array("centerOfMass", [values[key] for key in centre if key in values])


def _tag(name: str, attributes: Mapping[str, str], *, empty: bool = False) -> str:
    return f"<{name}{''.join(f' {key}={quoteattr(str(value))}' for key, value in attributes.items())}{'/' if empty else ''}>"


def _list(name: str, item: str, labels: Iterable[str]) -> list[str]:
    listed = list(labels)
    if not listed:
        return []
    return [
        f"<{name}>",
        *(_tag(item, {"label": label, "index": str(i)}, empty=True) for i, label in enumerate(listed)),
        f"</{name}>",
    ]


def _text(numbers: F64 | list[float]) -> str:
    return " ".join(map(repr, np.asarray(numbers, dtype=np.float64).ravel().tolist()))


def _array(name: str, numbers: F64 | list[Any]) -> str:
    """An element, or nothing for an array that the device does not give."""
    text = _text(numbers)
    return f"<{name}>{text}</{name}>" if text else ""
