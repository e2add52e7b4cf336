"""Xsens MVNX (XML, versions 3 and 4): a recording of MVN as messages with time stamps.

The file is read as a stream, one frame at a time. A document that declares entities is refused, since a small file could grow
large in memory by them, and the content of a single element is bounded.

Units of the file: metres, degrees, m/s², rad/s, milliseconds. World: x forward, y left, z up, right-handed, as ours. Sensors:
files of version 4 give the acceleration without gravity in the world, from which the acceleration that the sensor felt in its
own frame is computed (`signals.recorded.SensorReadings`); older files give the latter.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np
import scipy

from cabinpose.core import MVN_JOINTS, MVN_SEGMENTS, RecordingError
from cabinpose.signals import F64, Channels, Facts, JointAngles, Message, SegmentKinematics, SegmentPoses, SensorReadings
from cabinpose.store.convert.format import RecordingFormat
from cabinpose.store.convert.rows import Entry, Row

_CHUNK = 1 << 16
_ELEMENT_LIMIT = 1 << 20  # characters of one element's text; a frame's largest array has about 2000
_DEPTH_LIMIT = 32
_FRAME_LIMIT = 256  # elements of a frame
_HEADER_LIMIT = 100_000  # elements of a subject before its frames
_MS = 1_000_000  # ns

# Elements of a frame that become messages; the others are named in a Facts (`not_read`).
_READ = frozenset(
    {
        "orientation", "position", "velocity", "acceleration", "angularVelocity", "angularAcceleration", "footContacts",
        "sensorFreeAcceleration", "sensorAcceleration", "sensorAngularVelocity", "sensorMagneticField", "sensorOrientation",
        "jointAngle", "jointAngleXZY", "jointAngleErgo", "centerOfMass",
    }
)  # fmt: skip
CENTRE = ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az")
GRAVITY: F64 = np.array([0.0, 0.0, 9.80665])  # what an accelerometer at rest shows in the world
_OURS = {name.replace("Forearm", "ForeArm"): name for name in MVN_SEGMENTS}


@dataclass
class _Element:
    name: str
    attributes: dict[str, str]
    text: str = ""
    children: list[_Element] = field(default_factory=list)

    def all(self, *path: str) -> Iterator[_Element]:
        """Descendants along a path of names."""
        for child in self.children:
            if child.name == path[0]:
                if len(path) == 1:
                    yield child
                else:
                    yield from child.all(*path[1:])


class _Parser:
    """Cuts the file into the header of each subject, its frames, and the element `mvn` on the program.

    `ElementTree.iterparse` would do the same, but it expands entities and bounds nothing.
    """

    def __init__(self) -> None:
        self._expat = expat.ParserCreate()
        self._expat.buffer_text = True
        self._expat.StartElementHandler = self._start
        self._expat.EndElementHandler = self._end
        self._expat.CharacterDataHandler = self._characters
        self._expat.EntityDeclHandler = self._entity
        self._path: list[_Element] = []
        self._elements = 0
        self.cut: list[_Element] = []

    def feed(self, data: bytes, *, final: bool = False) -> list[_Element]:
        """What has become whole with `data`."""
        self.cut = []
        self._expat.Parse(data, final)
        return self.cut

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        element = _Element(name.rpartition(":")[2], attributes)
        if not self._path and element.name != "mvnx":
            raise _NotMvnxError(f"the document is <{element.name}>, not <mvnx>")
        if len(self._path) >= _DEPTH_LIMIT:
            raise _NotMvnxError(f"elements are nested more than {_DEPTH_LIMIT} deep")
        if element.name in ("subject", "frame"):
            self._elements = 0
        if element.name == "frames":  # the header of its subject is whole
            self.cut.append(self._path[-1])
        self._elements += 1
        in_frame = any(above.name == "frame" for above in self._path)
        if self._elements > (_FRAME_LIMIT if in_frame else _HEADER_LIMIT):
            raise _NotMvnxError(f"more than {self._elements - 1} elements in a {'frame' if in_frame else 'subject'}")
        if self._path and element.name not in ("frame", "frames", "subject"):
            self._path[-1].children.append(element)
        self._path.append(element)

    def _end(self, _: str) -> None:
        element = self._path.pop()
        if element.name == "frame" or (len(self._path) == 1 and element.name == "mvn"):
            self.cut.append(element)

    def _characters(self, text: str) -> None:
        element = self._path[-1]
        if element.children and not text.strip():
            return
        if len(element.text) + len(text) > _ELEMENT_LIMIT:
            raise _NotMvnxError(f"an element <{element.name}> of more than {_ELEMENT_LIMIT} characters")
        element.text += text

    def _entity(self, name: str, *_: object) -> None:
        raise _NotMvnxError(f"the document declares an entity ({name})")


class _NotMvnxError(Exception):
    pass


def read_mvnx(path: Path, *, subjects: Sequence[str] = ()) -> Iterator[Row]:
    """The messages of an MVNX file in its order: facts on each subject, its calibration poses, then frame by frame.

    Parameters
    ----------
    path
        The file.
    subjects
        Codes of the subjects in the file's order; without them they are character0, character1, and so on. MVN's labels, which
        may be people's names, are in the facts alone.

    Yields
    ------
    Row
        host_ns is the clock of the computer that recorded, since the Unix epoch; device_ns counts from the beginning of the
        recording. Facts have the time of the first frame that follows them.

    Raises
    ------
    RecordingError
        Where the file is no MVNX or is damaged, after the frames that precede the damage.
    """
    parser = _Parser()
    reader: _SubjectReader | None = None
    program: dict[str, str] = {}
    number, line = 0, "its start"
    try:
        with path.open("rb") as file:
            while True:
                data = file.read(_CHUNK)
                for element in parser.feed(data, final=not data):
                    if element.name == "mvn":
                        program = element.attributes
                    elif element.name == "frame":
                        if reader is None:
                            raise _NotMvnxError("a frame outside a subject")
                        line = f"frame {element.attributes.get('index') or element.attributes.get('type')}"
                        yield from reader.frame(element)
                    elif element.name == "subject":
                        code = subjects[number] if number < len(subjects) else f"character{number}"
                        reader = _SubjectReader(code, element, program)
                        number += 1
                if not data:
                    break
    except OSError as error:
        raise RecordingError(f"cannot read {path} ({error.strerror or error})", hint="check the path") from error
    except (expat.ExpatError, _NotMvnxError, ValueError, OverflowError, LookupError) as error:  # the last: no known encoding
        hint = "export it from MVN again, as MVNX; what precedes the damage was read"
        raise RecordingError(f"{path} is no whole MVNX file, after {line}: {error}", hint=hint) from error
    if reader is None:
        raise RecordingError(f"{path} holds no subject", hint="export it from MVN with its frames")


@dataclass(frozen=True, kw_only=True)
class MvnxImport:
    """How an MVNX file is read."""

    name: str = "suit"
    """Name of the source."""


class MvnxFormat(RecordingFormat):
    """MVNX files of Xsens MVN."""

    import_options = MvnxImport

    def read(self, path: Path, options: MvnxImport, subjects: Sequence[str]) -> Iterator[Entry]:
        """As `read_mvnx`."""
        return ((options.name, *row) for row in read_mvnx(path, subjects=subjects))


MVNX = MvnxFormat()


class _SubjectReader:
    """Reads the frames of one subject, whose header is known."""

    def __init__(self, code: str, subject: _Element, program: Mapping[str, str]) -> None:
        self.code = code
        labels = [e.attributes["label"] for e in subject.all("segments", "segment") if "label" in e.attributes]
        self.segments = tuple(_OURS.get(label, label) for label in labels) or MVN_SEGMENTS
        self.sensors = tuple(_OURS.get(label, label) for label in _labels(subject, "sensors", "sensor"))
        self.joints = _labels(subject, "joints", "joint") or tuple(name for name, _, _ in MVN_JOINTS)
        self.ergonomic = _labels(subject, "ergonomicJointAngles", "ergonomicJointAngle")
        self.contacts = _labels(subject, "footContactDefinition", "contactDefinition")
        self.rate_hz = _number(subject.attributes.get("frameRate"), 0.0)
        about: dict[str, object] = {"mvn": dict(program), "mvnx_subject": dict(subject.attributes)}
        about |= {"frame_rate_hz": self.rate_hz, "sensors": list(self.sensors)}
        about |= {"unit_m": 1.0, "unit_because": "m: as MVNX has it", "up": "z"}
        points = [point for segment in subject.all("segments", "segment") for point in _points(segment)]
        self._facts: list[dict[str, object]] = [about, {"points": points}]
        self._unread: set[str] = set()

    def frame(self, frame: _Element) -> Iterator[Row]:
        """The messages of one frame, and the facts that precede it."""
        kind = frame.attributes.get("type", "normal")
        device_ns = self._device_ns(frame.attributes)
        host_ns = int(_number(frame.attributes.get("ms"), 0.0)) * _MS or device_ns
        if kind != "normal":
            self._facts.append(self._calibration(kind, frame))
            return
        values = {child.name: _numbers(child) for child in frame.children if child.name in _READ}
        if unread := {child.name for child in frame.children} - _READ - self._unread:
            self._unread |= unread
            self._facts.append({"not_read": sorted(unread)})
        facts, self._facts = self._facts, []
        for each in facts:
            yield host_ns, device_ns, Facts(self.code, each)
        for message in self._messages(values):
            yield host_ns, device_ns, message

    def _device_ns(self, attributes: Mapping[str, str]) -> int:
        """The time of a frame by its index and the frame rate, of which the file's milliseconds are rounded (seen: 1 ms off)."""
        given_ns = round(_number(attributes.get("time"), 0.0) * _MS)
        index = attributes.get("index", "")
        if self.rate_hz > 0 and index.isascii() and index.isdigit():
            exact_ns = round(int(index) * 1e9 / self.rate_hz)
            if abs(exact_ns - given_ns) <= 2 * _MS:
                return exact_ns
        return given_ns

    def _calibration(self, kind: str, frame: _Element) -> dict[str, object]:
        values = {child.name: _numbers(child) for child in frame.children if child.name in ("position", "orientation")}
        return {
            "calibration": kind,
            "segments": list(self.segments),
            "position": _rows(values, "position", len(self.segments), 3).tolist(),
            "orientation_wxyz": _rows(values, "orientation", len(self.segments), 4).tolist(),
        }

    def _messages(self, values: Mapping[str, F64]) -> Iterator[Message]:
        count = len(self.segments)
        position, orientation = _rows(values, "position", count, 3), _rows(values, "orientation", count, 4)
        if len(position) or len(orientation):
            blank = np.full((count, 4), np.nan)
            at, turn = (position if len(position) else blank[:, :3]), (orientation if len(orientation) else blank)
            yield SegmentPoses(self.code, self.segments, at, turn)
        moved = [_rows(values, n, count, 3) for n in ("velocity", "acceleration", "angularVelocity", "angularAcceleration")]
        if any(map(len, moved)):
            yield SegmentKinematics(self.code, self.segments, *moved)
        yield from self._sensors(values)
        xzy = tuple(f"{name}.xzy" for name in self.joints)
        kinds = (("jointAngle", self.joints), ("jointAngleXZY", xzy), ("jointAngleErgo", self.ergonomic))
        given = [(names, rows) for key, names in kinds if len(rows := _rows(values, key, len(names), 3))]
        if given:
            names = tuple(name for some, _ in given for name in some)
            yield JointAngles(self.code, names, np.radians(np.concatenate([rows for _, rows in given])))
        yield from self._channels(values)

    def _sensors(self, values: Mapping[str, F64]) -> Iterator[Message]:
        count = len(self.sensors)
        orientation = _rows(values, "sensorOrientation", count, 4)
        acceleration = _rows(values, "sensorAcceleration", count, 3)
        free = _rows(values, "sensorFreeAcceleration", count, 3)
        if not len(acceleration) and len(free) and len(orientation):
            acceleration = turned(orientation, free + GRAVITY, inverse=True)
        gyro, field_ = _rows(values, "sensorAngularVelocity", count, 3), _rows(values, "sensorMagneticField", count, 3)
        if any(map(len, (orientation, acceleration, gyro, field_))):
            yield SensorReadings(self.code, self.sensors, orientation, acceleration, gyro, field_)

    def _channels(self, values: Mapping[str, F64]) -> Iterator[Message]:
        names: list[str] = []
        numbers: list[float] = []
        contacts = values.get("footContacts")
        if contacts is not None:
            labels = self.contacts if len(self.contacts) == len(contacts) else tuple(map(str, range(len(contacts))))
            names += [f"{self.code}.foot_contact.{label}" for label in labels]
            numbers += contacts.tolist()
        centre = values.get("centerOfMass")
        if centre is not None:
            if len(centre) not in (3, 9):
                raise _NotMvnxError(f"a centerOfMass of {len(centre)} numbers")
            names += [f"{self.code}.centre_of_mass.{axis}" for axis in CENTRE[: len(centre)]]
            numbers += centre.tolist()
        if names:
            yield Channels(tuple(names), np.array(numbers))


def _labels(subject: _Element, *path: str) -> tuple[str, ...]:
    return tuple(element.attributes.get("label", str(i)) for i, element in enumerate(subject.all(*path)))


def _points(segment: _Element) -> Iterator[dict[str, object]]:
    """Points of a segment, as `record.sources.mvn` tells them of a scale datagram; numbered from 1 in the file's order."""
    label = segment.attributes.get("label", "")
    for i, point in enumerate(segment.all("points", "point"), 1):
        for at in point.all("pos_b"):
            offset = _numbers(at).tolist()
            yield {"segment": _OURS.get(label, label), "point": i, "name": point.attributes.get("label", ""), "offset": offset}


def _number(text: str | None, default: float) -> float:
    value = float(text) if text else default
    if not np.isfinite(value):
        raise _NotMvnxError(f"{text} where a number is needed")
    return value


def _numbers(element: _Element) -> F64:
    return np.array(element.text.split(), dtype=np.float64)


def _rows(values: Mapping[str, F64], name: str, count: int, width: int) -> F64:
    numbers = values.get(name)
    if numbers is None or len(numbers) == 0:
        return np.empty((0, width))
    if len(numbers) != count * width:
        raise _NotMvnxError(f"<{name}> has {len(numbers)} numbers for {count} things")
    return numbers.reshape(count, width)


def turned(orientation_wxyz: F64, vectors: F64, *, inverse: bool = False) -> F64:
    """Vectors (N, 3) turned by quaternions; NaN where a sensor has none."""
    known = np.linalg.norm(orientation_wxyz, axis=1) > 0  # False for NaN
    result = np.full(vectors.shape, np.nan)
    if known.any():
        turn = scipy.spatial.transform.Rotation.from_quat(orientation_wxyz[known], scalar_first=True)
        result[known] = turn.apply(vectors[known], inverse=inverse)
    return result
