"""Messages of one subject of MVN as an MVNX file (version 4), which `mvnx.read_mvnx` and others' readers read."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain, groupby
from pathlib import Path
from typing import IO, Any
from xml.sax.saxutils import quoteattr

import numpy as np

from cabinpose.core.errors import RecordingError
from cabinpose.core.recorded import (
    F64,
    Channels,
    Facts,
    JointAngles,
    Markers,
    Message,
    SegmentKinematics,
    SegmentPoses,
    SensorReadings,
    ToFFrame,
)
from cabinpose.core.skeleton import MVN_JOINTS, MVN_SEGMENTS
from cabinpose.store.convert.mvnx import CENTRE, GRAVITY, THEIRS, turned
from cabinpose.store.convert.rows import Row, whole_file

_NAMESPACE = "http://www.xsens.com/mvn/mvnx"
_MS = 1_000_000
_LATE_NS = 2_000_000_000  # device time by which a message may be late


def write_mvnx(path: Path, rows: Iterable[Row], *, frame_rate_hz: float | None = None, overwrite: bool = False) -> Path:
    """Write the messages of one subject, in their order of time; the file appears when it is whole.

    A frame is what has one device time (host time where there is none). The first frame tells which segments, sensors and joints
    there are. The frame rate is the facts', unless it is given. What MVNX has no place for (other subjects' and optical
    markers, other channels) raises RecordingError, as do segments that are not MVN's.
    """
    with whole_file(path, overwrite=overwrite) as file:
        _write(file, rows, frame_rate_hz)
    return path


def of_one_subject(rows: Iterable[Row], subject: str | None = None) -> Iterator[Row]:
    """What MVNX holds of a subject (None: the only one with poses), by its device's time, late messages in their place.

    Props, fingers and other channels are left out. Raises RecordingError where there are poses of several and none was named.
    """
    chosen = subject
    waiting: list[tuple[int, int, Row]] = []
    newest: int | None = None
    for number, row in enumerate(rows):
        time_ns, message = row[0] if row[1] is None else row[1], row[2]
        if isinstance(message, SegmentPoses) and message.names == MVN_SEGMENTS and message.subject != chosen:
            if subject is None and chosen is not None:
                raise RecordingError(f"poses of {chosen} and {message.subject}", hint="say whose are to be written (--subject)")
            chosen = chosen or message.subject
        if newest is not None and newest - time_ns > _LATE_NS:  # the device's clock began anew
            yield from (each for _, _, each in sorted(waiting) if _has_place(each[2], chosen))
            waiting, newest = [], None
        newest = time_ns if newest is None else max(newest, time_ns)
        heapq.heappush(waiting, (time_ns, number, row))
        while newest - waiting[0][0] > _LATE_NS:
            _, _, each = heapq.heappop(waiting)
            if _has_place(each[2], chosen):
                yield each
    yield from (each for _, _, each in sorted(waiting) if _has_place(each[2], chosen))


def _has_place(message: Message, subject: str | None) -> bool:
    if isinstance(message, SegmentPoses | SegmentKinematics) and message.names != MVN_SEGMENTS:
        return False
    if isinstance(message, Channels) and not any(_channel(name)[1] for name in message.names):
        return False
    return not isinstance(message, Markers | ToFFrame) and _subject(message) == subject


def _write(file: IO[str], rows: Iterable[Row], frame_rate_hz: float | None) -> None:
    facts: list[Mapping[str, object]] = []
    frames = _frames(rows, facts)
    first = next(frames, None)
    if first is None:
        raise RecordingError("there is no frame to write", hint="MVNX needs poses of MVN's segments")
    header = _Header(facts, first[2], frame_rate_hz)
    file.write(header.text())
    for index, frame in enumerate(chain([first], frames)):
        file.write(header.frame(index, *frame))
    file.write("</frames>\n</subject>\n</mvnx>\n")


def _frames(rows: Iterable[Row], facts: list[Mapping[str, object]]) -> Iterator[tuple[int, int, list[Message]]]:
    """Frames as (host_ns, device_ns, messages); facts before the first are collected in `facts`."""
    subject = None
    for device_ns, group in groupby(rows, key=lambda row: row[0] if row[1] is None else row[1]):
        host_ns: int | None = None
        messages: list[Message] = []
        for host, _, message in group:
            about = _subject(message)
            subject = subject or about
            if about != subject:
                raise RecordingError(f"subjects {subject} and {about} in one MVNX file", hint="write them to a file each")
            host_ns = host if host_ns is None else host_ns
            if isinstance(message, Facts):
                facts.append(message.values)
            else:
                messages.append(message)
        if messages and host_ns is not None:
            yield host_ns, device_ns, messages


def _subject(message: Message) -> str:
    if isinstance(message, Facts):
        return message.about
    if isinstance(message, SegmentPoses | SegmentKinematics | SensorReadings | JointAngles):
        return message.subject
    if isinstance(message, Channels) and message.names:
        subject, kind, _ = _channel(message.names[0])
        if kind:
            return subject
    raise RecordingError(f"MVNX has no place for {type(message).__name__}", hint="leave it out, or write another format")


def _channel(name: str) -> tuple[str, str, str]:
    """A channel's subject, kind and label; the kind is empty where it is none of MVN's."""
    for kind in ("foot_contact", "centre_of_mass"):
        subject, found, label = name.partition(f".{kind}.")
        if found:
            return subject, kind, label
    return name, "", ""


class _Header:
    """What precedes the frames, and decides what they hold."""

    def __init__(self, facts: list[Mapping[str, object]], messages: list[Message], frame_rate_hz: float | None) -> None:
        known: dict[str, Any] = {}
        for each in facts:
            known |= {key: value for key, value in each.items() if key != "calibration"}
        self._program: Mapping[str, str] = known.get("mvn", {})
        self._subject: Mapping[str, str] = known.get("mvnx_subject", {})
        self._points: list[Mapping[str, Any]] = known.get("points", [])
        self._calibrations: list[Mapping[str, Any]] = [each for each in facts if "calibration" in each]
        rate_hz = frame_rate_hz or known.get("frame_rate_hz")
        if not rate_hz:
            raise RecordingError("the frame rate is not known", hint="give it: frame_rate_hz (--rate)")
        self._rate_hz = float(rate_hz)
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
        if isinstance(message, SegmentPoses | SegmentKinematics) and message.names != MVN_SEGMENTS:
            raise RecordingError("MVNX holds MVN's 23 segments, in their order", hint="write another format")
        if isinstance(message, SegmentPoses):
            yield _array("orientation", message.orientation_wxyz)
            yield _array("position", message.position_m)
        elif isinstance(message, SegmentKinematics):
            yield _array("velocity", message.velocity)
            yield _array("acceleration", message.acceleration)
            yield _array("angularVelocity", message.angular_velocity)
            yield _array("angularAcceleration", message.angular_acceleration)
        elif isinstance(message, SensorReadings):
            self._same(message.names, self.sensors, "sensors")
            if len(message.acceleration) and len(message.orientation_wxyz):
                yield _array("sensorFreeAcceleration", turned(message.orientation_wxyz, message.acceleration) - GRAVITY)
            else:
                yield _array("sensorAcceleration", message.acceleration)
            yield _array("sensorAngularVelocity", message.angular_velocity)
            yield _array("sensorMagneticField", message.magnetic_field)
            yield _array("sensorOrientation", message.orientation_wxyz)
        elif isinstance(message, JointAngles):
            self._same(message.names, self.angles, "joints")
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

    @staticmethod
    def _same(names: tuple[str, ...], first: tuple[str, ...], what: str) -> None:
        if names != first:
            raise RecordingError(f"the {what} change within the recording", hint="cut it where they change")


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
