"""The joints of a layout: who is in a frame, and where their joints are.

They are of rows (CSV, JSON) or of arrays (NPY, NPZ, MAT, JSON).
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Camera, ConfigError, DatasetError, Visibility
from cabinpose.store.convert.depth_images import step_m
from cabinpose.store.convert.layout import FolderLayout, JointFiles, RowValues, state_of, turned
from cabinpose.store.convert.layout_files import Finder, FoundFile, Key, array, as_number, of_frame, within
from cabinpose.store.convert.reading import read_json

F64 = NDArray[np.float64]
_ROW_HINT = "`values` of the layout says where a row has its values"
_MISSING = ("", "nan", "none", "null", "na")


@dataclass
class LaidPerson:
    """Somebody in a frame.

    place, subject, action: "" where the files do not say · xyz: (J, 3) positions as they stand in the files, of the joints that
    the layout names; NaN = not known · said: of each joint what the files say of its state, empty where they do not · states:
    (J,) what that is.
    """

    place: str
    subject: str
    action: str
    xyz: F64
    said: list[str] = field(default_factory=list)
    states: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, np.uint8))


class JointReader:
    """Reads who is in each frame.

    joints: (J,) positions of the joints in `spec.skeleton`, in the order of `LaidPerson`.
    """

    def __init__(self, root: Path, layout: FolderLayout, spec: JointFiles) -> None:
        self._spec, self._finder = spec, Finder(root, spec, "joints", several="place")
        self.joints = np.array(spec.skeleton.indices(list(spec.called)), np.int64)
        self._states = {_text(text): state_of(name) for text, name in spec.states.items()}
        told_of_rows = [name for name in RowValues.model_fields if spec.values is not None and getattr(spec.values, name)]
        both = [name for name in layout.frame_fields if name in told_of_rows and name not in spec.fields]
        self._match = tuple(both if spec.match is None else spec.match)
        for name in self._match:
            if name not in layout.frame_fields or name not in told_of_rows:
                raise ConfigError(
                    f"joints.match: {name} is not both in values and in depth.files",
                    hint=f"both have: {', '.join(both) or 'none'}",
                )
        self._rows = lru_cache(maxsize=4)(partial(_rows_by_frame, spec, self._match))  # frames of one file follow each other
        self.unmatched = 0  # frames without a row
        self._known_of = np.zeros(len(self.joints), np.int64)  # people whose joint is known, by joint

    def people(self, key: Key) -> list[LaidPerson]:
        """Everybody in a frame. Raises DatasetError for a file that is missing or damaged."""
        files = self._finder.of(key)
        if not files and not self._spec.may_lack:
            self._finder.one(key)
        found = [person for file in files for person in self._of_file(file, key)]
        if files and not found:
            self.unmatched += 1
        for person in found:
            self._known_of += person.states != Visibility.ABSENT
        return found

    @property
    def never_known(self) -> list[str]:
        """What the files call joints that nobody's were of."""
        return [str(theirs) for theirs, known in zip(self._spec.called.values(), self._known_of, strict=True) if not known]

    def _of_file(self, file: FoundFile, key: Key) -> Iterator[LaidPerson]:
        if self._spec.values is None:
            people = self._of_array(file.path, int(key["frame"]))
        else:
            people = iter(self._rows(file.path).get(tuple(_alike(key[name]) for name in self._match), []))
        for each in people:
            place = each.place or str(file.key.get("place", ""))
            xyz = each.xyz.copy()
            if self._spec.zero_is_missing:
                xyz[(np.nan_to_num(xyz) == 0).all(axis=1)] = np.nan
            yield replace(each, place=place, xyz=xyz, states=self._known(xyz, each.said, file.path))

    def _known(self, xyz: F64, said: Sequence[str], path: Path) -> NDArray[np.uint8]:
        """(J,) the states of somebody's joints: as the files say, else visible where they are known."""
        known = np.isfinite(xyz[:, : 2 if self._spec.space == "image" else 3]).all(axis=1)
        states = np.full(len(xyz), Visibility.VISIBLE, np.uint8)
        for joint, text in enumerate(said):
            if text not in self._states and text.lower() not in _MISSING:
                raise DatasetError(
                    f"{path}: the state {text!r} of a joint is not in the layout",
                    hint=f"joints.states says what states are; it has: {', '.join(self._states) or 'none'}",
                )
            states[joint] = self._states.get(text, Visibility.ABSENT)
        return np.where(known, states, Visibility.ABSENT).astype(np.uint8)

    def _of_array(self, path: Path, frame: int) -> Iterator[LaidPerson]:
        spec = self._spec
        values = of_frame(array(path, spec.variable), spec, ("person", "joint", "axis"), path, frame).astype(np.float64)
        at = _positions(path, spec, values.shape[1])
        states = None
        if spec.visibility:
            flat = spec.model_copy(update={"dims": tuple(name for name in spec.axes_there if name != "axis")})
            states = of_frame(array(path, spec.visibility), flat, ("person", "joint"), path, frame)[:, at]
        for person, xyz in enumerate(values[:, at]):
            there = np.isfinite(xyz[:, :2]) & ~(spec.zero_is_missing & (xyz[:, :2] == 0))
            if there.any():
                said = [_text(value) for value in states[person].tolist()] if states is not None else []
                yield LaidPerson(str(person), "", "", _of_three(xyz), said)


def _positions(path: Path, spec: JointFiles, count: int) -> list[int]:
    """Where the layout's joints are along an array's."""
    found = []
    for ours, theirs in spec.called.items():
        if isinstance(theirs, str) and theirs not in spec.there:
            raise ConfigError(
                f"joints.names.{ours}: nothing says where {theirs} is in arrays",
                hint="give joints.order, the names along the joints, or positions from 0 in joints.names",
            )
        at = spec.there.index(theirs) if isinstance(theirs, str) else theirs
        if not 0 <= at < count or (isinstance(theirs, str) and len(spec.there) != count):
            raise DatasetError(
                f"{path} has {count} joints, and the layout {len(spec.there) if isinstance(theirs, str) else f'one at {at}'}",
                hint="joints.order names all of them in their order; `dims` says which dimension they are",
            )
        found.append(at)
    return found


def _of_three(values: F64) -> F64:
    """(J, 3) positions of (J, 2 or 3)."""
    return np.pad(values.astype(np.float64), ((0, 0), (0, 3 - values.shape[1])), constant_values=np.nan)


def _text(value: Any) -> str:
    """A word of a file: 2 for 2.0, which is how tables keep integers."""
    text = str(value).strip()
    return text.removesuffix(".0") if text.removesuffix(".0").isdecimal() else text


# ------------------------------------------------------------------------------------------------------------- rows


class _TableRow:
    """A row of CSV by its columns, or an object of JSON by names between /; errors name the file and the row."""

    def __init__(self, where: str, data: Any, *, columns: bool) -> None:
        self._where, self._data, self._columns = where, data, columns

    def has(self, name: str) -> bool:
        try:
            self._value(name)
        except (KeyError, IndexError, TypeError, ValueError):
            return False
        return True

    def get(self, name: str) -> Any:
        try:
            return self._value(name)
        except (KeyError, IndexError, TypeError, ValueError) as error:
            known = ", ".join(map(str, self._data)) if isinstance(self._data, Mapping) else f"a {type(self._data).__name__}"
            raise DatasetError(f"{self._where} has no {name!r}", hint=f"{_ROW_HINT}; it has: {known[:300]}") from error

    def _value(self, name: str) -> Any:
        return self._data[name] if self._columns else within(self._data, name)

    def number(self, name: str) -> float:
        """A number; NaN for an empty cell and null."""
        value = self.get(name)
        if value is None or str(value).strip().lower() in _MISSING:
            return np.nan
        try:
            return float(value)
        except (TypeError, ValueError) as error:
            raise self.error(name, value) from error

    def numbers(self, name: str) -> F64:
        """Numbers of a list, or of lists; of null a NaN."""
        value = self.get(name)
        try:
            return np.array(np.nan if value is None else value, np.float64)
        except (TypeError, ValueError) as error:
            raise self.error(name, value) from error

    def field(self, name: str, what: str) -> str | int:
        value = self.get(name)
        try:
            return as_number(value) if what == "frame" else _text(value)
        except (TypeError, ValueError, OverflowError) as error:
            raise self.error(name, value) from error

    def twice(self, joint: str) -> DatasetError:
        return DatasetError(
            f"{self._where}: {joint} of one person comes a second time",
            hint="values.place or values.subject tells people apart, and joints.match says which rows are of a frame",
        )

    def error(self, name: str, value: Any) -> DatasetError:
        return DatasetError(f"{self._where}: {name} is {str(value)[:40]!r}", hint=_ROW_HINT)


def _rows(path: Path, spec: JointFiles) -> Iterator[_TableRow]:
    if path.suffix.lower() == ".json":
        try:
            data = within(read_json(path), spec.rows)
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise DatasetError(
                f"{path} has nothing under '{spec.rows}'", hint="`rows` of the layout names the list of rows"
            ) from error
        for number, row in enumerate(data if isinstance(data, list) else [data]):
            yield _TableRow(f"{path}, row {number}", row, columns=False)
        return
    if path.suffix.lower() not in (".csv", ".txt", ".tsv"):
        raise DatasetError(f"{path} holds no rows", hint="rows are of CSV or JSON; of an array leave out joints.values")
    try:
        text = path.read_text(encoding="utf-8-sig")
        dialect = csv.Sniffer().sniff(text.partition("\n")[0], delimiters=",;\t")
        for row in csv.DictReader(text.splitlines(), dialect=dialect, strict=True):
            yield _TableRow(f"{path}, row {','.join(map(str, [*row.values()][:2]))}", row, columns=True)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DatasetError(
            f"cannot read the table {path}: {error}", hint="columns are divided by , ; or tabs, names first"
        ) from error


def _alike(value: str | int) -> str | int:
    """What is equal where a field is: 007 is 7."""
    return int(value) if str(value).isdecimal() else value


def _rows_by_frame(spec: JointFiles, match: tuple[str, ...], path: Path) -> dict[tuple[str | int, ...], list[LaidPerson]]:
    """The people of a file by the fields that tie them to a frame."""
    values, joints = spec.values, tuple(spec.called.items())
    assert values is not None
    single: dict[tuple[Any, ...], LaidPerson] = {}
    found: dict[tuple[str | int, ...], list[LaidPerson]] = {}
    number_of = {str(theirs): number for number, (_, theirs) in enumerate(joints)}
    told: set[tuple[Any, ...]] = set()
    for row in _rows(path, spec):
        key = tuple(_alike(row.field(getattr(values, name), name)) for name in match)
        place, subject, action = (
            str(row.field(name, "place")) if name else "" for name in (values.place, values.subject, values.action)
        )
        if not values.joint:
            found.setdefault(key, []).append(LaidPerson(place, subject, action, *_whole(row, values, spec, joints)))
            continue
        person = single.get((key, place, subject))
        if person is None:
            person = LaidPerson(
                place, subject, action, np.full((len(joints), 3), np.nan), [""] * len(joints) if values.visibility else []
            )
            single[key, place, subject] = person
            found.setdefault(key, []).append(person)
        number = number_of.get(str(row.get(values.joint)))
        if number is not None:
            if (this := (key, place, subject, number)) in told:
                raise row.twice(str(joints[number][1]))
            told.add(this)
            person.xyz[number] = _position(row, values, "")
            if values.visibility:
                person.said[number] = _text(row.get(values.visibility))
    return found


def _whole(row: _TableRow, values: RowValues, spec: JointFiles, joints: Sequence[tuple[str, str | int]]) -> tuple[F64, list[str]]:
    """(J, 3) positions and (J,) states of a row that has all of somebody's joints.

    Joints that it lacks are not known, unless the layout names them.
    """
    if values.xyz and "{joint}" not in values.xyz:
        count = len(spec.there) or 1 + max(at for _, at in joints if isinstance(at, int))
        numbers = row.numbers(values.xyz)
        if numbers.size % count or numbers.size // count not in (2, 3):
            raise row.error(values.xyz, f"{numbers.size} numbers of {count} joints")
        xyz = _of_three(numbers.reshape(count, -1))[_positions(Path(values.xyz), spec, count)]
        return xyz, []
    xyz, states = np.full((len(joints), 3), np.nan), [""] * len(joints)
    some = False
    for number, (_, theirs) in enumerate(joints):
        name = (values.xyz or values.x).replace("{joint}", str(theirs))
        if not row.has(name) and not spec.names:
            continue
        some = True
        xyz[number] = _position(row, values, str(theirs))
        if values.visibility:
            states[number] = _text(row.get(values.visibility.replace("{joint}", str(theirs))))
    if not some:
        row.get(name)
    return xyz, states if values.visibility else []


def _position(row: _TableRow, values: RowValues, joint: str) -> F64:
    """(3,) a joint's numbers; z NaN where there is none."""
    if values.xyz:
        numbers = row.numbers(values.xyz.replace("{joint}", joint)).ravel()
        if numbers.size == 1 and np.isnan(numbers).all():
            return np.full(3, np.nan)
        if numbers.size not in (2, 3):
            raise row.error(values.xyz.replace("{joint}", joint), numbers.tolist())
        return _of_three(numbers[None])[0]
    names = (name.replace("{joint}", joint) for name in (values.x, values.y, values.z))
    return np.array([row.number(name) if name else np.nan for name in names])


# ------------------------------------------------------------------------------------------------------------ space


def in_camera(spec: JointFiles, xyz: F64, camera: Camera | None, camera_from_world: NDArray[np.floating] | None) -> F64:
    """(J, 3) m in our camera frame of positions as they stand in the files; NaN of pixels without depth."""
    if spec.space == "image":
        uv, z = xyz[:, :2] - spec.first_pixel, xyz[:, 2] * step_m(str(spec.unit))
        z = np.where(z > 0, z, np.nan)  # 0 is no depth, as in images
        if camera is None or not np.isfinite(z).any():
            return np.full_like(xyz, np.nan)
        return np.asarray(camera.unproject(uv, z))
    points = xyz * step_m(str(spec.unit)) @ turned(spec.axes).T
    if spec.space == "camera":
        return np.asarray(points)
    if camera_from_world is None:
        raise ConfigError(
            "joints.space: positions are in a world, and nothing says where the camera is in it",
            hint="give camera.world_from_camera or camera_from_world",
        )
    return np.asarray(points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3])
