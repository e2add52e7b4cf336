"""Tables of measurements with two rows of headings, the name and the quantity, as pandas writes them and gaitmap ships them.

One row a sample at a constant rate, the first column an index. Quantities x y z are a marker's place; acc_x .. acc_z and
gyr_x .. gyr_z a sensor's readings, with mag_x .. mag_z where there are any; all else is channels, `<name>.<quantity>`.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from cabinpose.core.errors import RecordingError
from cabinpose.core.recorded import F64, Channels, Markers, SensorReadings
from cabinpose.store.convert.rows import Row

_MARKER = ("x", "y", "z")
_SENSOR = {"acceleration": "acc", "angular_velocity": "gyr", "magnetic_field": "mag"}
_MOST_COLUMNS = 100_000
_AT_ONCE = 4096  # rows


def read_csv_table(
    path: Path, *, rate_hz: float, unit_m: float = 0.001, gyroscope_unit: float = float(np.pi / 180), start_ns: int = 0
) -> Iterator[Row]:
    """The messages of a table, row by row. device_ns counts from the first row, host_ns from `start_ns`.

    unit_m: metres of a marker's unit, the millimetre unless stated · gyroscope_unit: rad/s of a gyroscope's, the degree per
    second unless stated. Accelerations are m/s². Empty cells are NaN. Raises RecordingError where the file is no such table.
    """
    if not rate_hz > 0:
        raise RecordingError(f"{rate_hz} samples a second make no time", hint="give the rate at which the table was recorded")
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.reader(file)
            names, quantities = next(reader, []), next(reader, [])
            if len(names) != len(quantities) or not 2 <= len(names) <= _MOST_COLUMNS:
                raise ValueError("it has no two rows of headings")
            layout = _Layout(names[1:], quantities[1:], unit_m, gyroscope_unit)
            number = 0
            while rows := list(islice(reader, _AT_ONCE)):
                values = np.array([[float(cell) if cell else np.nan for cell in row[1:]] for row in rows], dtype=np.float64)
                for row_values in values:
                    time_ns = round(number * 1e9 / rate_hz)
                    for message in layout.messages(row_values):
                        yield start_ns + time_ns, time_ns, message
                    number += 1
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror}", hint="check the path") from error
    except (ValueError, csv.Error) as error:
        hint = "two rows of headings, name and quantity, then an index and numbers in each row"
        raise RecordingError(f"{path} is no table of measurements: {error}", hint=hint) from error


class _Layout:
    """Which columns make which message."""

    def __init__(self, names: Sequence[str], quantities: Sequence[str], unit_m: float, gyroscope_unit: float) -> None:
        at = {pair: i for i, pair in enumerate(zip(names, quantities, strict=True))}
        if len(at) != len(names):
            raise ValueError("a column is there twice")
        self._unit_m, self._gyroscope_unit, self._width = unit_m, gyroscope_unit, len(names)
        each = list(dict.fromkeys(names))
        self._markers = [n for n in each if all((n, q) in at for q in _MARKER)]
        self._marker_columns = [at[n, q] for n in self._markers for q in _MARKER]
        self._sensors = [n for n in each if any((n, f"{q}_x") in at for q in _SENSOR.values())]
        self._sensor_columns: dict[str, list[int]] = {}
        for field, prefix in _SENSOR.items():
            wanted = [(n, f"{prefix}_{axis}") for n in self._sensors for axis in "xyz"]
            if all(pair in at for pair in wanted):
                self._sensor_columns[field] = [at[pair] for pair in wanted]
        used = {*self._marker_columns, *(i for columns in self._sensor_columns.values() for i in columns)}
        self._other = [i for i in range(len(names)) if i not in used]
        self._other_names = tuple(f"{names[i]}.{quantities[i]}" for i in self._other)
        if not self._sensor_columns:
            self._sensors = []

    def messages(self, values: F64) -> Iterator[Markers | SensorReadings | Channels]:
        """The messages of one row; ValueError where it has another number of columns."""
        if len(values) != self._width:
            raise ValueError(f"a row of {len(values)} values under {self._width} headings")
        if self._markers:
            place = values[self._marker_columns].reshape(-1, 3) * self._unit_m
            yield Markers("", tuple(self._markers), place, np.full(len(place), np.nan))
        if self._sensors:
            found = {field: values[columns].reshape(-1, 3) for field, columns in self._sensor_columns.items()}
            none = np.zeros((0, 3))
            rate = found.get("angular_velocity", none) * self._gyroscope_unit
            acceleration, field = found.get("acceleration", none), found.get("magnetic_field", none)
            yield SensorReadings("", tuple(self._sensors), np.zeros((0, 4)), acceleration, rate, field)
        if self._other:
            yield Channels(self._other_names, values[self._other])
