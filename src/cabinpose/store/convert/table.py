"""Messages laid out as tables of one rate, for formats without gaps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cabinpose.core import ConfigError, MocapError, RecordingError
from cabinpose.signals import F64, LATEST_NS

_CELL_LIMIT = 200_000_000  # numbers: 1.6 GB
_SHORT = 20  # frames of a gap that can be counted by rounded stamps


@dataclass(frozen=True, kw_only=True)
class TableExport:
    """How frames at one rate are written."""

    subject: str | None = None
    """The subject to export; default: the only one (c3d: everybody)."""
    rate_hz: float | None = None
    """Frames a second; default: the rate that the device reported, or the median."""

    def __post_init__(self) -> None:
        if self.rate_hz is not None and not self.rate_hz > 0:
            raise ConfigError(f"{self.rate_hz:g} frames a second are none", hint="give --rate-hz more than 0")


def newest_ns(newest: int | None, time_ns: int) -> int:
    """The newest of the times that came, and this one. Raises RecordingError where it falls as of a device started anew."""
    newest = time_ns if newest is None else max(newest, time_ns)
    if newest - time_ns > LATEST_NS:
        raise RecordingError("the device was started anew within the recording", hint="export its parts, each by --span FROM TO")
    return newest


def period_ns(times_ns: Iterable[int]) -> float:
    """The time from frame to frame, 0 for none: the mean, since stamps may be rounded, by the frames that steps are long.

    Long gaps, of which it is not known how many frames they are, count for nothing.
    """
    steps = np.diff(np.unique(np.fromiter(times_ns, np.int64))).astype(np.float64)
    usual = float(np.median(steps)) if len(steps) else 0.0
    if usual <= 0:
        return 0.0
    near = float(steps[np.abs(steps - usual) <= 0.5 * usual].mean())
    short = steps[(steps > 0.5 * near) & (steps <= _SHORT * near)]
    return float(short.sum() / np.round(short / near).sum())


@dataclass
class Table:
    """Values of named columns at times: of `width` numbers each, NaN where there are none."""

    width: int
    columns: dict[str, int] = field(default_factory=dict)
    rows: dict[int, list[tuple[list[int], F64]]] = field(default_factory=dict)  # time -> columns and their values
    _newest_ns: int | None = None

    def add(self, time_ns: int, names: Sequence[str], values: F64) -> None:
        """Values (names, width) at a time; of equal times the first counts.

        MocapError where two names are the same; RecordingError as `newest_ns` has it.
        """
        self._newest_ns = newest_ns(self._newest_ns, time_ns)
        if len(set(names)) != len(names):
            raise MocapError(f"two of {', '.join(names)} have one name", hint="rename one: they are told apart by their names")
        at = [self.columns.setdefault(name, len(self.columns)) for name in names]
        if any(set(at) & set(columns) for columns, _ in self.rows.get(time_ns, ())):
            return
        self.rows.setdefault(time_ns, []).append((at, values.reshape(len(at), self.width)))

    def rate_hz(self) -> float | None:
        """From the times."""
        step = period_ns(self.rows)
        return 1e9 / step if step > 0 else None

    def frames(self, rate_hz: float) -> tuple[int, F64]:
        """The first time, and (F, columns, width) from there to the last."""
        first_ns = min(self.rows)
        return first_ns, self.at(first_ns, rate_hz, round((max(self.rows) - first_ns) * 1e-9 * rate_hz) + 1)

    def at(self, first_ns: int, rate_hz: float, count: int) -> F64:
        """(count, columns, width); the rows in the frames nearest to them.

        MocapError where two fall into one, or where the times lie so far apart that the table does not fit into memory.
        """
        if count * len(self.columns) * self.width > _CELL_LIMIT:
            raise MocapError(f"there are {count} frames from the first time to the last", hint="export the recording in parts")
        result, taken = np.full((count, len(self.columns), self.width), np.nan), np.full((count, len(self.columns)), False)
        for time_ns, parts in self.rows.items():
            k = round((time_ns - first_ns) * 1e-9 * rate_hz)
            for columns, values in parts:
                if taken[k, columns].any():
                    name = list(self.columns)[columns[0]]
                    raise MocapError(
                        f"two values of {name} fall into the frame of 1/{rate_hz:g} s at {time_ns * 1e-9:.4f} s",
                        hint="give the rate of the frames; a recording in which a device began anew is exported in parts",
                    )
                result[k, columns], taken[k, columns] = values, True
        return result


def told_rate(facts: Mapping[str, Mapping[str, Any]]) -> float | None:
    """The rate of frames by what facts (about -> values) of C3D or Vicon say, Hz."""
    for about, key in (("points", "rate_hz"), ("stream", "frame_rate_hz")):
        rate = facts.get(about, {}).get(key)
        if isinstance(rate, (int, float)) and np.isfinite(rate) and rate > 0:
            return float(rate)
    return None


def chosen_subject(subjects: Iterable[str], wanted: str | None, what: str) -> str:
    """The subject to write: the wanted one, or the only one that has a name. MocapError where that is none, or several."""
    there = list(subjects)
    known = [subject for subject in there if subject] or there
    if wanted is None and len(known) == 1:
        return known[0]
    if wanted in known:
        return wanted
    if not known:
        raise MocapError(f"there are no {what} to write", hint="export a recording that has some")
    if known == [""]:
        raise MocapError(
            f"there are no {what} of {wanted}: nobody is named in the recording",
            hint="leave out --subject, or import the file again with --subject CODE",
        )
    if wanted is None:
        raise MocapError(f"there are {what} of {', '.join(known)}", hint="say whose are to be written (--subject)")
    raise MocapError(f"there are no {what} of {wanted or 'a subject without a name'}", hint=f"there are of: {', '.join(known)}")
