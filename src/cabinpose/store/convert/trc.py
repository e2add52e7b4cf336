"""OpenSim's .trc (tab-separated text): the markers of one subject. OpenSim's world has y up: x forward, y up, z to the right.

An occluded marker is three empty cells. Residuals have no place.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cabinpose.core.errors import MocapError
from cabinpose.core.frames import ZUP_FROM_YUP
from cabinpose.core.recorded import F64, Facts, Markers
from cabinpose.store.convert.c3d import METRES
from cabinpose.store.convert.rows import Row, whole_file
from cabinpose.store.convert.table import Table, check_tabbed, chosen_subject, told_rate

_MM = 1e3
_LINE_LIMIT = 1 << 22  # characters; a marker needs about 30


def write_trc(
    path: Path, rows: Iterable[Row], *, subject: str | None = None, rate_hz: float | None = None, overwrite: bool = False
) -> Path:
    """Write the markers of one subject (None: the only one) in millimetres; the file appears when it is whole.

    A frame's time is its device time (host time where there is none), at one rate: given, told by facts, or the median of
    the differences. Raises MocapError where there are no markers, several subjects, or times that do not fit the rate.
    """
    tables: dict[str, Table] = {}
    facts: dict[str, Mapping[str, Any]] = {}
    for host_ns, device_ns, message in rows:
        if isinstance(message, Markers):
            time_ns = host_ns if device_ns is None else device_ns
            tables.setdefault(message.subject, Table(3)).add(time_ns, message.names, message.position_m)
        elif isinstance(message, Facts):
            facts[message.about] = message.values
    table = tables[chosen_subject(tables, subject, "markers")]
    rate = rate_hz or told_rate(facts) or table.rate_hz() or 100.0
    first_ns, values = table.frames(rate)
    position_mm = values @ ZUP_FROM_YUP * _MM  # the inverse of what reads them
    names = list(table.columns)
    check_tabbed(names)
    with whole_file(path, overwrite=overwrite) as file:
        file.write(f"PathFileType\t4\t(X/Y/Z)\t{path.name}\n")
        file.write("DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n")
        file.write(f"{rate:.6f}\t{rate:.6f}\t{len(values)}\t{len(names)}\tmm\t{rate:.6f}\t1\t{len(values)}\n")
        file.write("Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t\n")
        file.write("\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(len(names)) for axis in "XYZ") + "\n\n")
        for k, frame in enumerate(position_mm):
            cells = [
                "\t\t" if np.isnan(point).any() else "\t".join(f"{value:.6f}" for value in point) for point in frame.tolist()
            ]
            file.write(f"{k + 1}\t{first_ns * 1e-9 + k / rate:.9f}\t" + "\t".join(cells) + "\n")
    return path


def read_trc(path: Path, *, subject: str = "", y_up: bool = True, start_ns: int = 0) -> Iterator[Row]:
    """The markers of a .trc file, frame by frame, after facts on them.

    y_up: the file has OpenSim's axes, else z up. device_ns: the file's times · host_ns: `start_ns` later. Residuals are unknown.
    Raises MocapError where the file is no .trc, or is damaged, after the frames that precede the damage.
    """
    number = 0
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            lines = iter(lambda: file.readline(_LINE_LIMIT), "")
            head = [next(lines, "").rstrip("\r\n") for _ in range(5)]
            number, world = 5, ZUP_FROM_YUP if y_up else np.eye(3)
            names, metres, facts = _head(head)
            yield start_ns, 0, facts
            for line in lines:
                number += 1
                cells = line.rstrip("\r\n").split("\t")
                if not "".join(cells).strip():
                    continue
                device_ns = round(float(cells[1]) * 1e9)
                position = _cells(cells[2:], len(names)) * metres @ world.T
                yield start_ns + device_ns, device_ns, Markers(subject, names, position, np.full(len(names), np.nan))
    except OSError as error:
        raise MocapError(f"cannot read {path} ({error.strerror or error})", hint="check the path") from error
    except (ValueError, IndexError, OverflowError) as error:
        raise MocapError(f"{path}, line {number}: {error}", hint="give a .trc file of tab-separated positions") from error


def _head(lines: list[str]) -> tuple[tuple[str, ...], float, Facts]:
    if not lines[0].startswith("PathFileType"):
        raise ValueError("the file does not begin with PathFileType")
    about = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    unit = about.get("Units", "mm").strip().lower()
    if unit not in METRES:
        raise ValueError(f"positions in '{unit}', not one of {', '.join(METRES)}")
    names = tuple(name.strip() for name in lines[3].split("\t")[2:] if name.strip())
    if not names or int(about.get("NumMarkers", len(names))) != len(names):
        raise ValueError(f"{len(names)} names of {about.get('NumMarkers')} markers")
    rate = float(about.get("DataRate", "nan"))
    values: dict[str, object] = {"rate_hz": rate if np.isfinite(rate) else None, "units": [unit]}
    return names, METRES[unit], Facts("points", values)


def _cells(cells: list[str], count: int) -> F64:
    numbers = [float(cell) if cell.strip() else np.nan for cell in cells[: 3 * count]]
    numbers += [np.nan] * (3 * count - len(numbers))  # cells that are empty to the end of the line may be left out
    position = np.array(numbers, np.float64).reshape(count, 3)
    position[~np.isfinite(position).all(axis=1)] = np.nan
    return position
