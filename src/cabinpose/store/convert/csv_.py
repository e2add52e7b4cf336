"""A recording as CSV tables, one a source and kind of message, for spreadsheets and statistics; and back.

`<source>.<kind>.csv`, with `-2`, `-3` ... before the suffix where a source has several subjects or its names change. What the
name of a file cannot hold is percent-encoded: `lab%2Fsuit` is the source `lab/suit`.

Columns: `host_ns`, `device_ns`, `sequence` (empty = unknown), `subject`, then the values, named `<segment>.<quantity>`; markers,
which come and go, have a row each. SI units; quaternions w x y z; empty cells are NaN. Facts keep their values as JSON. Images
stay in the recording: of a camera's frames, the table tells the intrinsics and how many pixels are valid, and is not read back.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from cabinpose.core.errors import RecordingError
from cabinpose.core.ports import Sample
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
from cabinpose.store.convert.rows import whole_file

_MOST_TABLES = 400  # open at the same time
_HEAD = ("host_ns", "device_ns", "sequence", "subject")
_XYZ, _WXYZ = ("x", "y", "z"), ("w", "x", "y", "z")


@dataclass(frozen=True)
class _Wide:
    """A kind of message with one row of arrays (S, n) a message: its fields with the columns of each."""

    kind: type[Any]
    fields: tuple[tuple[str, tuple[str, ...]], ...]


def _quantities(field: str, axes: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    return field, tuple(f"{field}_{axis}" for axis in axes)


_WIDE: Mapping[str, _Wide] = {
    "poses": _Wide(SegmentPoses, (_quantities("position_m", _XYZ), _quantities("orientation_wxyz", _WXYZ))),
    "kinematics": _Wide(
        SegmentKinematics,
        tuple(_quantities(n, _XYZ) for n in ("velocity", "acceleration", "angular_velocity", "angular_acceleration")),
    ),
    "sensors": _Wide(
        SensorReadings,
        (
            _quantities("orientation_wxyz", _WXYZ),
            *(_quantities(n, _XYZ) for n in ("acceleration", "angular_velocity", "magnetic_field")),
        ),
    ),
    "joint_angles": _Wide(JointAngles, (_quantities("angles", "123"),)),
}
_FRAME_COLUMNS = ("width", "height", "depth_unit_m", "valid_share", "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
_MARKER_COLUMNS = ("marker", "position_m_x", "position_m_y", "position_m_z", "residual_m")


class _Tables:
    """The tables that are being written, by what decides their columns."""

    def __init__(self, folder: Path, files: ExitStack, overwrite: bool) -> None:
        self._folder, self._files, self._overwrite = folder, files, overwrite
        self._writers: dict[tuple[Any, ...], Any] = {}
        self._numbers: dict[tuple[str, str], int] = {}
        self.paths: list[Path] = []

    def row(
        self, source: str, kind: str, key: tuple[Any, ...], columns: Callable[[], Sequence[str]], values: Sequence[Any]
    ) -> None:
        """Write a row to the table of a source, kind and key, which begins with its columns."""
        writer = self._writers.get((source, kind, *key))
        if writer is None:
            if len(self._writers) >= _MOST_TABLES:
                raise RecordingError(f"more than {_MOST_TABLES} tables", hint="names change again and again; choose sources")
            number = self._numbers[source, kind] = self._numbers.get((source, kind), 0) + 1
            name = f"{quote(source, safe=' ')}.{kind}{f'-{number}' if number > 1 else ''}.csv"
            path = self._folder / name
            writer = csv.writer(self._files.enter_context(whole_file(path, overwrite=self._overwrite)), lineterminator="\n")
            writer.writerow((*_HEAD, *columns()))
            self._writers[source, kind, *key] = writer
            self.paths.append(path)
        writer.writerow(values)


def write_csv(folder: Path, samples: Iterable[tuple[str, Sample]], *, overwrite: bool = False) -> list[Path]:
    """Write the samples of a recording (`Recording.samples()`) as tables; they appear when all are whole.

    Raises RecordingError where a table exists or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError(f"cannot write to {folder}: {error.strerror}", hint="give another folder") from error
    with ExitStack() as files:
        tables = _Tables(folder, files, overwrite)
        for source, sample in samples:
            head = (sample.host_ns, _cell(sample.device_ns), _cell(sample.sequence))
            for message in sample.messages:
                _write(tables, source, head, message)
    return tables.paths


def _write(tables: _Tables, source: str, head: tuple[Any, ...], message: Message) -> None:
    if isinstance(message, Markers):
        for name, at, residual in zip(message.names, message.position_m, message.residual_m, strict=True):
            values = (*head, message.subject, name, *map(_number, at), _number(residual))
            tables.row(source, "markers", (), lambda: _MARKER_COLUMNS, values)
    elif isinstance(message, Channels):
        names = message.names
        tables.row(source, "channels", names, lambda: names, (*head, "", *map(_number, message.values)))
    elif isinstance(message, Facts):
        text = json.dumps(message.values, ensure_ascii=False)
        tables.row(source, "facts", (), lambda: ("about", "values"), (*head, "", message.about, text))
    elif isinstance(message, ToFFrame):
        tables.row(source, "frames", (), lambda: _FRAME_COLUMNS, (*head, "", *_frame(message)))
    else:
        kind, wide = next((k, w) for k, w in _WIDE.items() if isinstance(message, w.kind))
        arrays = [(columns, np.asarray(getattr(message, field))) for field, columns in wide.fields]
        given = [(columns, array) for columns, array in arrays if len(array)]
        names = message.names
        key = (message.subject, names, tuple(columns for columns, _ in given))
        cells = [_number(v) for i in range(len(names)) for _, array in given for v in array[i]]
        tables.row(
            source, kind, key, lambda: [f"{n}.{c}" for n in names for columns, _ in given for c in columns],
            (*head, message.subject, *cells),
        )  # fmt: skip


def _frame(frame: ToFFrame) -> tuple[Any, ...]:
    height, width = frame.depth.shape
    share = np.count_nonzero(frame.depth) / frame.depth.size if frame.depth.size else 0.0
    k = frame.camera_k
    lens = (k[0, 0], k[1, 1], k[0, 2], k[1, 2], *frame.camera_dist)
    return width, height, frame.depth_unit_m, round(share, 6), *map(_number, lens)


def read_csv(path: Path) -> Iterator[tuple[int, int | None, int | None, Message]]:
    """(host_ns, device_ns, sequence, message) of a table that `write_csv` wrote, in its order.

    Raises RecordingError where the file is no such table; a camera's frames have no table to be read from.
    """
    kind = path.stem.rpartition(".")[2].partition("-")[0]
    if kind not in {*_WIDE, "markers", "channels", "facts"}:
        raise RecordingError(f"{path.name} is no table of messages", hint="as in suit.poses.csv, written by cabinpose")
    line = 1
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.reader(file)
            header = tuple(next(reader, ()))
            if header[: len(_HEAD)] != _HEAD:
                raise ValueError("its columns are not those of a table")
            for message_rows in _grouped(kind, reader):
                line = reader.line_num
                yield _message(kind, header[len(_HEAD) :], message_rows)
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror}", hint="check the path") from error
    except (ValueError, IndexError, KeyError, csv.Error) as error:
        raise RecordingError(f"{path} is damaged near line {line}: {error}", hint="write the tables again") from error


def _grouped(kind: str, rows: Iterable[list[str]]) -> Iterator[list[list[str]]]:
    """One row a message, but for markers: the rows of one sample and subject."""
    group: list[list[str]] = []
    for row in rows:
        if group and (kind != "markers" or row[: len(_HEAD)] != group[0][: len(_HEAD)] or row[4] in {r[4] for r in group}):
            yield group
            group = []
        group.append(row)
    if group:
        yield group


def _message(kind: str, columns: tuple[str, ...], rows: list[list[str]]) -> tuple[int, int | None, int | None, Message]:
    host, device, sequence, subject = rows[0][: len(_HEAD)]
    stamps = int(host), int(device) if device else None, int(sequence) if sequence else None
    cells = [row[len(_HEAD) :] for row in rows]
    if any(len(row) != len(columns) for row in cells):
        raise ValueError(f"{len(columns)} columns and {len(cells[0])} values")
    message: Message
    if kind == "facts":
        message = Facts(cells[0][0], json.loads(cells[0][1]))
    elif kind == "channels":
        message = Channels(columns, _numbers(cells[0]))
    elif kind == "markers":
        values = np.array([_numbers(row[1:]) for row in cells])
        message = Markers(subject, tuple(row[0] for row in cells), values[:, :3], values[:, 3])
    else:
        message = _wide_message(_WIDE[kind], subject, columns, _numbers(cells[0]))
    return *stamps, message


def _wide_message(wide: _Wide, subject: str, columns: tuple[str, ...], values: F64) -> Message:
    pairs = [column.rpartition(".")[::2] for column in columns]
    names = tuple(dict.fromkeys(name for name, _ in pairs))
    quantities = dict.fromkeys(quantity for _, quantity in pairs)
    if len(columns) != len(names) * len(quantities):
        raise ValueError("the segments have different columns")
    table = dict(zip(quantities, values.reshape(len(names), len(quantities)).T, strict=True))
    arrays = {
        field: np.stack([table[c] for c in cols], axis=-1) if cols[0] in table else np.zeros((0, len(cols)))
        for field, cols in wide.fields
    }
    return wide.kind(subject=subject, names=names, **arrays)


def _cell(value: int | None) -> int | str:
    return "" if value is None else value


def _number(value: float) -> str:
    """The shortest text that is the same number; empty for NaN."""
    return "" if np.isnan(value) else repr(float(value))


def _numbers(cells: Sequence[str]) -> F64:
    return np.array([float(cell) if cell else np.nan for cell in cells], dtype=np.float64)
