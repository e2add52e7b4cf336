"""C3D (optical motion capture, through ezc3d): a file as messages with time stamps. `c3d_write` writes such files.

Points are markers of their subjects (`Subject:Marker`, or SUBJECTS:LABEL_PREFIXES), in metres by POINT:UNITS, turned upright as
`c3d_up` finds. A point whose residual is negative is occluded: NaN. A residual of 0 says that the point was filled in, or that
its residual is not known. Points without a label (`*12`) have the subject "".
What models add to the points is recognised by POINT:ANGLES (joint angles, rad) and POINT:FORCES, MOMENTS, POWERS, SCALARS
(channels, in the file's units). Analog channels come at their own rate. All parameters of the file are facts.
"""

from __future__ import annotations

import math
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from cabinpose.core import LENGTHS_M, MocapError, metres_of, optional_module
from cabinpose.signals import F64, BodyTrack, Channels, Facts, JointAngles, Markers, recognised_unit
from cabinpose.store.convert.apart import CrashedError, items_apart
from cabinpose.store.convert.c3d_up import WORLD_FROM_UP, Axis, vertical_axis
from cabinpose.store.convert.rows import Row

ANGLES, OTHERS = "ANGLES", ("FORCES", "MOMENTS", "POWERS", "SCALARS")
_BLOCK = 512
_FRAMES = 64  # that are looked at to recognise the unit
_MOST_CLAIMED = 4  # numbers for each byte of a file
_REFUSALS = (OSError, RuntimeError, ValueError, TypeError, AttributeError, LookupError, MemoryError, OverflowError)


def ezc3d() -> Any:
    """The module ezc3d."""
    return optional_module("ezc3d", purpose="C3D", hint="pip install 'cabinpose[record]'")


_Points: TypeAlias = dict[int, str]
"""The points of one subject, or of one kind that a model added: their names by their columns in the file."""


def read_c3d(
    path: Path, *, subjects: Sequence[str] = (), start_ns: int = 0, up: Axis | None = None, whole_frames: bool = False
) -> Iterator[Row]:
    """The messages of a C3D file, by time: facts, then each frame's markers and the analog values until the next.

    Parameters
    ----------
    path
        The file.
    subjects
        Codes of the subjects, in the file's order; where the file names none, the code of the only one. The facts on parameters
        keep the file's names.
    start_ns
        Host time of the beginning, since C3D knows no time of day. device_ns is since the beginning of the trial, whose first
        frame need not be in the file.
    up
        The axis that points up, in place of what `c3d_up` finds.
    whole_frames
        Take the whole frames of a file that is cut off.

    Warns
    -----
    UserWarning
        Where the markers contradict the axis that the file names, nothing tells the axis, the file does not say its unit, or
        frames are missing at the end.

    Raises
    ------
    MocapError
        Where the file is no C3D, is damaged or cut off, has an unknown unit, or names no subjects while several are given.
    """
    claimed, there = _frames(path)
    if there < claimed and not (whole_frames and there):
        raise _cut_off(
            path, claimed, there, hint="copy or export it again, or import the frames that are whole with --keep-whole-frames"
        )
    ezc3d()  # an error of its own where it is missing
    _check_parameters(path)
    try:
        (content,) = items_apart(_load, path)
        trial = _Trial(path, content, subjects, up, lost=claimed - there)
    except (CrashedError, *_REFUSALS) as error:
        raise MocapError(f"{path} cannot be read: {error}", hint="export it again; it contradicts itself") from error
    for note in trial.notes:
        warnings.warn(f"{path} {note}", stacklevel=2)
    return trial.rows(start_ns)


def _load(path: Path) -> Iterator[_Content]:
    """What the library finds in a file, which it trusts: to be called in a process of its own."""
    file = ezc3d().c3d(str(path))
    data, header = file["data"], file["header"]["points"]
    yield _Content(
        points=data["points"][:3].transpose(2, 1, 0),
        residual=data["meta_points"]["residuals"][0].T,
        analogs=data["analogs"][0].T,
        rate=float(header["frame_rate"]),
        first=int(header["first_frame"]),
        parameters=_plain_parameters(file["parameters"]),
    )


@dataclass(frozen=True)
class _Content:
    """points (F, P, 3), residual (F, P), analogs (F * n, C) in the file's units · rate Hz · number of the first frame."""

    points: F64
    residual: F64
    analogs: F64
    rate: float
    first: int
    parameters: dict[str, dict[str, Any]]


class _Trial:
    """A file whose parameters have been understood."""

    def __init__(self, path: Path, content: _Content, codes: Sequence[str], up: Axis | None, *, lost: int) -> None:
        self.rate, self.first = content.rate, content.first
        self.notes: list[str] = []
        self.points, self.residual, self.analogs = content.points, content.residual, content.analogs
        if len(self.points) and not (np.isfinite(self.rate) and self.rate > 0):
            raise MocapError(f"{path} has a frame rate of {self.rate}", hint="set POINT:RATE to the rate of the cameras")
        parameters = content.parameters
        point, analog = parameters.get("POINT", {}), parameters.get("ANALOG", {})
        if lost:
            self.notes.append(f"is cut off: {len(self.points)} of {len(self.points) + lost} frames are taken, {lost} are lost")
        else:
            _check_frames(path, parameters.get("TRIAL", {}), len(self.points))
        self.degrees = str((point.get("ANGLE_UNITS") or ["deg"])[0]).strip().lower() != "rad"
        self.channels = _names(analog, "LABELS", self.analogs.shape[1], "analog")
        self.markers, self.models, named = _groups(path, parameters, self.points.shape[1], codes)
        if codes and named[len(codes) :]:
            self.notes.append(f"has no code for {', '.join(named[len(codes) :])}, who keep their names; give one for each")
        if codes[len(named) :]:
            self.notes.append(f"has {len(named)} subjects: of {', '.join(codes[len(named) :])} there is nothing")
        self.scale, unit_because = self._metres(path, point)
        self.up, because = (up, "given") if up is not None else self._upright(_screen_axis(path, point))
        about = {
            "rate_hz": self.rate, "frames": len(self.points), "first_frame": self.first, "frames_lost": lost,
            "up": self.up, "up_because": because, "unit_m": self.scale, "unit_because": unit_because,
        }  # fmt: skip
        self.facts = list(_facts(parameters, point, analog, about))

    def _metres(self, path: Path, point: Mapping[str, Any]) -> tuple[float, str]:
        """Metres of the file's unit of length, and what tells it; with a note where the file does not."""
        unit = str((point.get("UNITS") or [""])[0]).strip()
        if unit:
            metres = metres_of(unit)
            if metres is None:
                raise MocapError(f"{path} has points in '{unit}'", hint=f"set POINT:UNITS to one of {', '.join(LENGTHS_M)}")
            return metres, f"{unit}: POINT:UNITS"
        some = self.points[:: max(1, len(self.points) // _FRAMES)]
        bodies = (BodyTrack(tuple(part.values()), some[:, list(part)]) for part in self.markers.values())
        found = next(filter(None, map(recognised_unit, bodies)), None) or (LENGTHS_M["mm"], "mm: assumed, as nothing tells it")
        self.notes.append(f"does not say its unit of length, which is taken as {found[1]}; if that is wrong, set POINT:UNITS")
        return found

    def _upright(self, hint: Axis | None) -> tuple[Axis, str]:
        """The axis that points up and what tells it, with a note where the file's hint says something else, or nothing."""
        columns = sorted(column for part in self.markers.values() for column in part)
        subjects = ({name: column for column, name in part.items()} for part in self.markers.values())
        position = np.full(self.points.shape, np.nan)  # angles and forces stay out
        position[:, columns] = self.points[:, columns] * self.scale
        up, because = vertical_axis(hint, position, subjects)
        remedy = "if that is wrong, import it with --up AXIS"
        if hint is None and because.startswith("assumed"):
            self.notes.append(f"does not say which axis is up: {up} is assumed; {remedy}")
        elif up != (hint or "z"):
            says = f"POINT:Y_SCREEN says {hint}" if hint else "there is no POINT:Y_SCREEN"
            self.notes.append(f"is read with {up} up, which has {because}, though {says}; {remedy}")
        return up, because

    def time_ns(self, frame: float) -> int:
        """Since the beginning of the trial."""
        return round(frame * 1e9 / self.rate) if len(self.points) else 0

    def rows(self, start_ns: int) -> Iterator[Row]:
        """Everything, by time."""
        points = self.points
        occluded = ~np.isfinite(points).all(axis=2)  # the library gives NaN where a residual is negative
        with np.errstate(all="ignore"):
            position = points * self.scale @ WORLD_FROM_UP[self.up].T
        position[occluded] = np.nan
        residual_m = np.where(occluded, np.nan, self.residual * self.scale)
        ratio = len(self.analogs) // max(1, len(points)) if self.channels else 0
        first_ns = self.time_ns(self.first)
        for facts in self.facts:
            yield start_ns + first_ns, first_ns, facts
        for k in range(len(points)):
            frame_ns = self.time_ns(self.first + k)
            for subject, part in self.markers.items():
                columns, names = list(part), tuple(part.values())
                yield start_ns + frame_ns, frame_ns, Markers(subject, names, position[k, columns], residual_m[k, columns])
            for (kind, subject), part in self.models.items():
                message = _modelled(kind, subject, tuple(part.values()), points[k, list(part)], degrees=self.degrees)
                yield start_ns + frame_ns, frame_ns, message
            for i in range(ratio):
                analog_ns = self.time_ns(self.first + k + i / ratio)
                yield start_ns + analog_ns, analog_ns, Channels(self.channels, self.analogs[k * ratio + i].copy())


def _modelled(kind: str, subject: str, names: tuple[str, ...], values: F64, *, degrees: bool) -> JointAngles | Channels:
    """The message of what a model added, (names, 3)."""
    if kind == ANGLES:
        return JointAngles(subject, names, np.radians(values) if degrees else values)
    prefix = f"{subject}:" if subject else ""
    return Channels(tuple(f"{prefix}{name}.{axis}" for name in names for axis in "xyz"), values.ravel())


def check_size(path: Path) -> None:
    """Raise MocapError unless a file is as large as its header claims: the library leaves out what is missing, in silence."""
    claimed, there = _frames(path)
    if there < claimed:
        raise _cut_off(path, claimed, there, hint="check the space on the disk")


def _cut_off(path: Path, claimed: int, there: int, *, hint: str) -> MocapError:
    return MocapError(f"{path} is cut off: of {claimed} frames that its header claims, {there} are whole", hint=hint)


def _frames(path: Path) -> tuple[int, int]:
    """The number of frames that a file's header claims, and of those that are in the file."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(_BLOCK)
            file.seek(_BLOCK * (max(1, head[0]) - 1) if head else 0)
            parameters = file.read(4)
    except OSError as error:
        raise MocapError(f"cannot read {path} ({error.strerror or error})", hint="check the path") from error
    if len(head) < _BLOCK or head[1] != 0x50 or len(parameters) < 4:
        raise MocapError(f"{path} is no C3D file", hint="give a C3D file")
    order = ">" if parameters[3] == 86 else "<"  # MIPS; Intel is 84, DEC 85
    points, analogs, first, last = struct.unpack_from(f"{order}4H", head, 2)
    start = struct.unpack_from(f"{order}H", head, 16)[0]
    negative = head[12 if order == ">" else 15 if parameters[3] == 84 else 13] & 0x80  # the scale's sign: floats
    claimed, frame_bytes = max(0, last - first + 1), (4 * points + analogs) * (4 if negative else 2)
    room = size - max(0, start - 1) * _BLOCK
    if room < 0:
        raise MocapError(f"{path} is cut off before its first frame", hint="copy or export it again")
    return claimed, min(claimed, room // frame_bytes) if frame_bytes else claimed


def _check_parameters(path: Path) -> None:
    """Raise MocapError where a parameter is larger than its place, or the counts of the parameters than the file.

    The library asks for memory by both before it looks at the file's size.
    """
    data = path.read_bytes()[: _BLOCK * 512]  # one byte counts the blocks of the section, one where it begins
    start = _BLOCK * (max(1, data[0]) - 1)
    order = ">" if data[start + 3] == 86 else "<"
    groups: dict[int, str] = {}
    counts: dict[str, int] = {}
    at, again = start + 4, ""
    try:
        while length := abs(struct.unpack_from("b", data, at)[0]):
            group, name = struct.unpack_from("b", data, at + 1)[0], data[at + 2 : at + 2 + length].decode("latin-1").upper()
            at += 2 + length
            (offset,) = struct.unpack_from(f"{order}H", data, at)
            if group < 0:
                groups[-group] = name
            else:
                kind, dimensions = struct.unpack_from("bB", data, at + 2)
                size = abs(kind) * math.prod(data[at + 4 : at + 4 + dimensions])
                place = at + 4 + dimensions
                if place + size > (at + offset if offset else len(data)):
                    again = f"its parameter {name} has {size} bytes, more than there is place for"
                    break
                if abs(kind) == 2 and size == 2:
                    counts[f"{groups.get(group, '')}:{name}"] = struct.unpack_from(f"{order}H", data, place)[0]
            if not offset:
                break
            at += offset
    except struct.error:
        again = "its parameters have no end"
    frames, points, analogs = (counts.get(name, 0) for name in ("POINT:FRAMES", "POINT:USED", "ANALOG:USED"))
    if not again and frames * (4 * points + analogs) > _MOST_CLAIMED * path.stat().st_size:
        again = f"its parameters claim {frames} frames of {points} points and {analogs} channels"
    if again:
        raise MocapError(f"{path} is damaged: {again}", hint="copy or export it again")


def _check_frames(path: Path, trial: Mapping[str, Any], frames: int) -> None:
    """Vicon's 32-bit numbers of the first and the last frame, where 16 bits do not hold them."""
    start, end = ([int(word) & 0xFFFF for word in trial.get(f"ACTUAL_{which}_FIELD") or []] for which in ("START", "END"))
    if len(start) == len(end) == 2:
        claimed = end[0] - start[0] + 1 + ((end[1] - start[1]) << 16)
        if claimed > frames:
            raise MocapError(f"{path} has {claimed} frames, of which {frames} can be read", hint="export it in shorter parts")


def _plain_parameters(groups: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Groups of parameters as plain data: lists of text and numbers; NaN and infinities, which JSON has not, as None."""
    plain: dict[str, dict[str, Any]] = {}
    for group, members in groups.items():
        values = {name: _plain(member["value"]) for name, member in members.items() if name != "__METADATA__"}
        plain[_word(group)] = {_word(name): value for name, value in values.items()}
    return plain


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return _word(value) if isinstance(value, str) else value


def _word(text: str) -> str:
    return text.encode("utf-8", "replace").decode("utf-8")


def _screen_axis(path: Path, point: Mapping[str, Any]) -> Axis | None:
    """What POINT:Y_SCREEN says."""
    word = str((point.get("Y_SCREEN") or [""])[0]).strip().lower().removeprefix("+")
    if word and word not in WORLD_FROM_UP:
        raise MocapError(f"{path} has the vertical axis '{word}'", hint=f"give it with --up: {', '.join(WORLD_FROM_UP)}")
    return word or None  # type: ignore[return-value]  # a key of the table


def _names(group: Mapping[str, Any], parameter: str, count: int, fallback: str) -> tuple[str, ...]:
    """LABELS, LABELS2, and so on: a parameter holds no more than 255; what has no name is numbered."""
    names: list[str] = []
    for suffix in ("", *map(str, range(2, 2 + count // 255 + 1))):
        names += [str(name).strip() for name in group.get(f"{parameter}{suffix}") or []]
    return tuple(names[i] if i < len(names) and names[i] else f"{fallback} {i + 1}" for i in range(count))


def _groups(
    path: Path, parameters: Mapping[str, Mapping[str, Any]], count: int, codes: Sequence[str]
) -> tuple[dict[str, _Points], dict[tuple[str, str], _Points], list[str]]:
    """The points of each subject, those that models added by (parameter, subject), and the subjects' names in the file."""
    point, about = parameters.get("POINT", {}), parameters.get("SUBJECTS", {})
    prefixes = [str(prefix) for prefix in about.get("LABEL_PREFIXES") or []]
    people = [str(name).strip() for name in about.get("NAMES") or []]
    of_prefix = {prefix: name for prefix, name in zip(prefixes, people, strict=False) if prefix.strip()}
    labels = _names(point, "LABELS", count, "point")
    only = people[0] if len(people) == 1 else ""
    if codes and not (only or of_prefix or any(":" in label for label in labels if not label.startswith("*"))):
        if len(codes) > 1:
            raise MocapError(f"{path} does not say whose its markers are, and {len(codes)} subjects are given", hint="give one")
        only = codes[0]
    kinds = {str(label).strip(): kind for kind in (ANGLES, *OTHERS) for label in point.get(kind) or []}
    markers: dict[str, _Points] = {}
    models: dict[tuple[str, str], _Points] = {}
    for column, label in enumerate(labels):
        prefix = max((prefix for prefix in of_prefix if label.startswith(prefix)), key=len, default=None)
        if prefix is not None:
            subject, name = of_prefix[prefix], label[len(prefix) :]
        elif label.startswith("*"):
            subject, name = "", label[1:] or label
        else:
            subject, _, name = label.rpartition(":")
            subject = subject or only
        kind = kinds.get(label) or kinds.get(name)
        (markers.setdefault(subject, {}) if kind is None else models.setdefault((kind, subject), {}))[column] = name
    subjects = dict.fromkeys(filter(None, [*markers, *(subject for _, subject in models)]))
    code = dict(zip(subjects, codes, strict=False))
    return (
        {code.get(subject, subject): part for subject, part in markers.items()},
        {(kind, code.get(subject, subject)): part for (kind, subject), part in models.items()},
        list(subjects),
    )


def _facts(
    parameters: Mapping[str, Any], point: Mapping[str, Any], analog: Mapping[str, Any], about: Mapping[str, Any]
) -> Iterator[Facts]:
    yield Facts("parameters", dict(parameters))
    yield Facts("points", {**about, "units": point.get("UNITS"), "scale": point.get("SCALE")})
    if analog.get("LABELS"):
        yield Facts("analog", {key.lower(): analog.get(key) for key in ("LABELS", "UNITS", "DESCRIPTIONS", "RATE")})
    event = parameters.get("EVENT", {})
    used = int((event.get("USED") or [0])[0])
    if used:
        times = np.array(event.get("TIMES") or [], np.float64).reshape(2, -1)  # minutes, seconds
        columns = {key: event.get(key) or [] for key in ("LABELS", "CONTEXTS", "SUBJECTS", "DESCRIPTIONS")}
        events = []
        for i in range(min(used, times.shape[1])):
            words = {key[:-1].lower(): str(values[i]).strip() if i < len(values) else "" for key, values in columns.items()}
            events.append({**words, "time_s": float(60 * times[0, i] + times[1, i])})
        yield Facts("events", {"events": events})
