"""A recording as CSV tables, one a source and kind of message, for spreadsheets and statistics.

`<source>.<kind>.csv`, with `-2`, `-3` ... before the suffix where a source has several subjects or its names change. What the
name of a file cannot hold is percent-encoded: `lab%2Fsuit` is the source `lab/suit`.

Columns: `host_ns`, `device_ns`, `sequence` (empty = unknown), `subject`, then the values, named `<segment>.<quantity>`; markers,
which come and go, have a row each. SI units; quaternions w x y z; empty cells are NaN. Facts keep their values as JSON. Images
stay in the recording: of a camera's frames, the table has the intrinsics and the share of valid pixels.
"""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from cabinpose.core import RecordingError, make_folder
from cabinpose.signals import ARRAYS, TOPICS, Channels, Facts, Markers, Message, Sample, ToFFrame
from cabinpose.store.convert.format import NoOptions, RecordingFormat
from cabinpose.store.convert.rows import new_file

_MOST_TABLES = 400  # open at the same time
_HEAD = ("host_ns", "device_ns", "sequence", "subject")
_FRAME_COLUMNS = ("width", "height", "depth_unit_m", "valid_share", "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
_MARKER_COLUMNS = ("marker", "position_m_x", "position_m_y", "position_m_z", "residual_m")


def write_csv(folder: Path, samples: Iterable[tuple[str, Sample]], *, overwrite: bool = False) -> list[Path]:
    """Write the samples of a recording as tables; they appear when all of them are whole.

    Parameters
    ----------
    folder
        The folder of the tables; it is made where it is not there.
    samples
        Names of sources and their samples, as `Recording.samples()` gives them.
    overwrite
        Replace tables that are in the folder.

    Returns
    -------
    list of Path
        The tables.

    Raises
    ------
    RecordingError
        Where the folder is not empty and `overwrite` is not given, it cannot be written, or there are too many tables.
    """
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise RecordingError(
            f"{folder} is not empty", hint="--overwrite replaces tables in it, or give another folder with --out"
        )
    new = not folder.exists()
    make_folder(folder, RecordingError)
    try:
        with ExitStack() as files:
            tables = _Tables(folder, files, overwrite)
            for source, sample in samples:
                head = (sample.host_ns, _cell(sample.device_ns), _cell(sample.sequence))
                for message in sample.messages:
                    _write(tables, source, head, message)
        return tables.paths
    finally:
        if new and not any(folder.iterdir()):
            folder.rmdir()


class CsvFormat(RecordingFormat):
    """CSV tables, one a source and kind of message."""

    def write(self, out: Path, samples: Iterable[tuple[str, Sample]], _: NoOptions, *, overwrite: bool) -> list[Path]:
        """As `write_csv`."""
        return write_csv(out, samples, overwrite=overwrite)


CSV = CsvFormat()


class _Tables:
    """The tables that are being written, by what decides their columns."""

    def __init__(self, folder: Path, files: ExitStack, overwrite: bool) -> None:
        self._folder, self._files, self._overwrite = folder, files, overwrite
        self._writers: dict[tuple[Any, ...], Any] = {}
        self._numbers: Counter[tuple[str, str]] = Counter()
        self.paths: list[Path] = []

    def row(
        self, source: str, kind: str, key: tuple[Any, ...], columns: Callable[[], Sequence[str]], values: Sequence[Any]
    ) -> None:
        """Write a row to the table of a source, kind and key, which begins with its columns."""
        writer = self._writers.get((source, kind, *key))
        if writer is None:
            if len(self._writers) >= _MOST_TABLES:
                raise RecordingError(f"more than {_MOST_TABLES} tables", hint="names change again and again; choose sources")
            self._numbers[source, kind] += 1
            number = self._numbers[source, kind]
            path = self._folder / f"{quote(source, safe=' ')}.{kind}{f'-{number}' if number > 1 else ''}.csv"
            writer = csv.writer(self._files.enter_context(new_file(path, overwrite=self._overwrite)), lineterminator="\n")
            writer.writerow((*_HEAD, *columns()))
            self._writers[source, kind, *key] = writer
            self.paths.append(path)
        writer.writerow(values)


def _write(tables: _Tables, source: str, head: tuple[Any, ...], message: Message) -> None:
    """Write the rows of one message; head: its times and its number."""
    if isinstance(message, ToFFrame):
        tables.row(source, "frames", (), lambda: _FRAME_COLUMNS, (*head, "", *_frame(message)))
        return
    kind = TOPICS[type(message)]
    if isinstance(message, Markers):
        for name, at, residual in zip(message.names, message.position_m, message.residual_m, strict=True):
            values = (*head, message.subject, name, *map(_number, at), _number(residual))
            tables.row(source, kind, (), lambda: _MARKER_COLUMNS, values)
    elif isinstance(message, Channels):
        names = message.names
        tables.row(source, kind, names, lambda: names, (*head, "", *map(_number, message.values)))
    elif isinstance(message, Facts):
        text = json.dumps(message.values, ensure_ascii=False)
        tables.row(source, kind, (), lambda: ("about", "values"), (*head, "", message.about, text))
    else:
        names = message.names
        arrays = [(_columns(name, width), getattr(message, name)) for name, width in ARRAYS[type(message)].items()]
        given = [(columns, array) for columns, array in arrays if len(array)]
        quantities = tuple(column for columns, _ in given for column in columns)
        cells = [_number(value) for i in range(len(names)) for _, array in given for value in array[i]]
        key = (message.subject, names, quantities)
        values = (*head, message.subject, *cells)
        tables.row(source, kind, key, lambda: [f"{name}.{quantity}" for name in names for quantity in quantities], values)


def _columns(array: str, width: int) -> list[str]:
    """The columns of an array of a message: vectors by x y z, quaternions by w x y z, angles by their axes' numbers."""
    axes = "123" if array == "angles" else "wxyz"[-width:]
    return [f"{array}_{axis}" for axis in axes]


def _frame(frame: ToFFrame) -> tuple[Any, ...]:
    """The cells of a camera's frame."""
    height, width = frame.depth.shape
    share = np.count_nonzero(frame.depth) / frame.depth.size if frame.depth.size else 0.0
    k = frame.camera_k
    lens = (k[0, 0], k[1, 1], k[0, 2], k[1, 2], *frame.camera_dist)
    return width, height, frame.depth_unit_m, round(share, 6), *map(_number, lens)


def _cell(value: int | None) -> int | str:
    return "" if value is None else value


def _number(value: float) -> str:
    """The shortest text that is the same number; empty for NaN."""
    return "" if np.isnan(value) else repr(float(value))
