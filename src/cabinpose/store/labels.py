"""Corrected labels beside a dataset: a journal of every joint that a person set, which no crash can lose.

JSON lines. The first line says what the labels are of (`format`, `version`, `dataset`, `persons`, `joints`). Each other line is a
change: `time` (UTC), `role` of who made it, `how`, `frame`, `person`, `joint`, `visibility` (`core.pose.Visibility`, or null: the
label was taken away), `u`, `v` (px, or null) and `x`, `y`, `z` (m, camera frame, or null). The last change of a joint holds.
An undo is another change, so the history stays. A change is on the disk before `set` returns. What is changed at once has one
time, which nothing else has; `session` (the window) and `undoes` (the time of what an undo takes back) may be missing.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cabinpose.core import DatasetError, Visibility

if TYPE_CHECKING:
    import xarray as xr

FORMAT: Final = "cabinpose-labels"
VERSION: Final = 1


@dataclass(frozen=True)
class JointLabel:
    """Where a joint is: uv (px) and xyz (m, camera frame), NaN where unknown, and how well it is seen."""

    uv: tuple[float, float]
    xyz: tuple[float, float, float]
    visibility: Visibility


Key = tuple[int, str, str]  # number of the frame, person, joint


class Labels:
    """The journal of one dataset, open for changes by one process at a time."""

    def __init__(self, path: Path, dataset_id: str, persons: Iterable[str], joints: Iterable[str]) -> None:
        """Open, or make, the journal of a dataset (`store.schema.dataset_id`).

        A last line that a crash cut short is dropped. Raises DatasetError where the journal is of another dataset, damaged
        elsewhere, or open in another process.
        """
        self.path = path
        self.persons, self.joints = tuple(persons), tuple(joints)
        header = {
            "format": FORMAT, "version": VERSION, "dataset": dataset_id, "persons": self.persons, "joints": self.joints,
        }  # fmt: skip
        self._file = _locked(path)
        try:
            text = self._file.readall()
            whole = text[: text.rfind(b"\n") + 1]
            if not whole:
                whole = json.dumps(header).encode() + b"\n"
                self._file.truncate(0)
                self._append(whole)
            elif len(whole) < len(text):
                self._file.truncate(len(whole))
            _, self.history = _parsed(path, whole, header)
            self._size, self.begun = len(whole), len(self.history)  # begun: how many changes are from before
        except BaseException:
            self._file.close()
            raise
        self._now: dict[Key, JointLabel] = {}
        _apply(self._now, self.history)

    def __contains__(self, key: object) -> bool:
        return key in self._now

    def get(self, frame: int, person: str, joint: str) -> JointLabel | None:
        """What holds for a joint; None where nobody set it."""
        return self._now.get((frame, person, joint))

    @property
    def now(self) -> dict[Key, JointLabel]:
        """What holds for every joint that was set."""
        return self._now

    def set(
        self, changes: Iterable[tuple[Key, JointLabel | None]], *, role: str, how: str, session: str = "", undoes: str = ""
    ) -> None:
        """Set joints, all or none of them, or take their labels away (None); returns when that is on the disk.

        Raises DatasetError where the disk refuses, for a person or joint that the dataset does not have, and see `check`.
        """
        self.check()
        time = self._time()
        made = [Change(time, role, how, *key, label, session, undoes) for key, label in changes]
        for change in made:
            if change.person not in self.persons or change.joint not in self.joints:
                raise DatasetError(
                    f"{self.path} has no {change.joint} of {change.person}", hint=f"its joints: {', '.join(self.joints)}"
                )
        self._append("".join(change.line() for change in made).encode())
        self.history += made
        _apply(self._now, made)

    def _time(self) -> str:
        """Now, or just after the last change where the clock has not gone on since."""
        now = datetime.now(UTC)
        with suppress(IndexError, ValueError, TypeError, OverflowError):  # nothing is changed yet, or by others
            now = max(now, datetime.fromisoformat(self.history[-1].time) + timedelta(microseconds=1))
        return now.isoformat(timespec="microseconds")

    def check(self) -> None:
        """Raise DatasetError where the journal is no longer the file of its name, or holds what is not from here."""
        if self._file.closed:
            raise DatasetError(f"{self.path} is no longer open here", hint="load the page again")
        ours = os.fstat(self._file.fileno())
        try:
            there: os.stat_result | None = self.path.stat()
        except OSError:
            there = None
        if there is None or not os.path.samestat(ours, there):
            words = "was deleted or renamed" if there is None else "was replaced by another file"
            raise DatasetError(
                f"{self.path} {words}", hint="bring it back to go on, or end the studio and open the dataset again"
            )
        if ours.st_size != self._size:
            raise DatasetError(f"{self.path} was changed by another program", hint="end the studio and open the dataset again")

    def close(self) -> None:
        """Let others open the journal."""
        self._file.close()

    def _append(self, lines: bytes) -> None:
        end = self._file.seek(0, os.SEEK_END)
        try:
            written = self._file.write(lines)
            if written != len(lines):
                raise OSError(28, "no space left on device")
            os.fsync(self._file.fileno())
            self._size = end + written
        except OSError as error:
            self._file.truncate(end)
            raise DatasetError(
                f"{self.path} cannot be written ({error.strerror})", hint="make room on the disk; what was set before is kept"
            ) from error


@dataclass(frozen=True)
class Change:
    """One line of the journal."""

    time: str
    role: str
    how: str
    frame: int
    person: str
    joint: str
    label: JointLabel | None
    session: str = ""
    undoes: str = ""

    @property
    def key(self) -> Key:
        """What was changed."""
        return self.frame, self.person, self.joint

    def line(self) -> str:
        """As it stands in the file."""
        row: dict[str, Any] = {
            "time": self.time, "role": self.role, "how": self.how, "frame": int(self.frame), "person": self.person,
            "joint": self.joint, "visibility": None,
        }  # fmt: skip
        if self.label is not None:
            row["visibility"] = int(self.label.visibility)
            values = (*self.label.uv, *self.label.xyz)
            row |= {name: float(x) if np.isfinite(x) else None for name, x in zip("uvxyz", values, strict=True)}
        row |= {name: word for name, word in (("session", self.session), ("undoes", self.undoes)) if word}
        return json.dumps(row, allow_nan=False) + "\n"


def read_history(path: Path) -> tuple[dict[str, Any], list[Change]]:
    """The header of a journal and all its changes, read without locking it. Raises DatasetError."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise DatasetError(f"cannot read {path} ({error.strerror})", hint="give the labels that the studio wrote") from error
    return _parsed(path, text[: text.rfind(b"\n") + 1], None)


def read_labels(path: Path) -> tuple[dict[str, Any], dict[Key, JointLabel]]:
    """The header of a journal and what holds for each joint, read without locking it. Raises DatasetError."""
    header, changes = read_history(path)
    labels: dict[Key, JointLabel] = {}
    _apply(labels, changes)
    return header, labels


def labels_of(path: Path, dataset_ids: Sequence[str]) -> dict[Key, JointLabel]:
    """What holds for each joint of a dataset that goes by one of these ids. Raises DatasetError for labels of another one."""
    header, labels = read_labels(path)
    if header.get("dataset") not in dataset_ids:
        raise DatasetError(f"{path} holds the labels of another dataset", hint="give the dataset that was labelled")
    return labels


def with_labels(dataset: xr.Dataset, labels: dict[Key, JointLabel]) -> xr.Dataset:
    """The dataset with the joints that were set: `joints_2d`, `joints_3d` and `visibility` in memory, everything else as it was.

    Frames that the dataset does not hold are passed over.
    """
    rows = {int(number): row for row, number in enumerate(dataset["frame"].values)}
    persons = {str(name): i for i, name in enumerate(dataset["person"].values)}
    joints = {str(name): i for i, name in enumerate(dataset["joint"].values)}
    changed = {name: dataset[name].copy(data=np.array(dataset[name].values)) for name in ("joints_2d", "joints_3d", "visibility")}
    for (frame, person, joint), label in labels.items():
        if frame not in rows or person not in persons or joint not in joints:
            continue
        at = rows[frame], persons[person], joints[joint]
        changed["joints_2d"].values[at] = label.uv
        changed["joints_3d"].values[at] = label.xyz
        changed["visibility"].values[at] = label.visibility
    return dataset.assign(changed)


def _locked(path: Path) -> FileIO:
    try:
        file = FileIO(path, "a+")
    except OSError as error:
        raise DatasetError(f"{path} cannot be written ({error.strerror})", hint="name another file for the labels") from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        file.close()
        raise DatasetError(
            f"{path} is open in another studio", hint="close that one, or name another file with --labels"
        ) from error
    except OSError:
        pass  # a file system without locks: `Labels.check` notices what another studio writes
    file.seek(0)
    return file


def _parsed(path: Path, text: bytes, expected: dict[str, Any] | None) -> tuple[dict[str, Any], list[Change]]:
    lines = _lines(path, text)
    try:
        header = next(lines)
    except StopIteration:
        raise DatasetError(f"{path} is empty", hint="give the labels that the studio wrote") from None
    if header.get("format") != FORMAT or header.get("version") != VERSION:
        raise DatasetError(f"{path} holds no labels of this version", hint="name another file for the labels")
    if expected is not None and header.get("dataset") != expected["dataset"]:
        raise DatasetError(f"{path} holds the labels of another dataset", hint="name another file with --labels")
    changes = []
    for number, row in enumerate(lines, 2):
        try:
            label = _label(row)
            time, role, how, person, joint = (str(row[key]) for key in ("time", "role", "how", "person", "joint"))
            session, undoes = (str(row.get(key, "")) for key in ("session", "undoes"))
            changes.append(Change(time, role, how, int(row["frame"]), person, joint, label, session, undoes))
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise DatasetError(f"{path}:{number}: no label ({error!r})", hint="mend or remove the line") from error
    return header, changes


def _lines(path: Path, text: bytes) -> Iterator[dict[str, Any]]:
    for number, line in enumerate(text.splitlines(), 1):
        try:
            row = json.loads(line)
            if not isinstance(row, dict):
                raise ValueError("not an object")
        except (ValueError, RecursionError) as error:
            raise DatasetError(f"{path}:{number}: not a line of JSON", hint="mend or remove the line") from error
        yield row


def _label(row: dict[str, Any]) -> JointLabel | None:
    if row["visibility"] is None:
        return None
    u, v, x, y, z = (_number(row[name]) for name in "uvxyz")
    return JointLabel((u, v), (x, y, z), Visibility(row["visibility"]))


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _apply(labels: dict[Key, JointLabel], changes: Iterable[Change]) -> None:
    """Let changes take effect, in their order."""
    for change in changes:
        if change.label is None:
            labels.pop(change.key, None)
        else:
            labels[change.key] = change.label
