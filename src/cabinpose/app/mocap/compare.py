"""Suit and optical system of a take on one clock, segment by segment or joint by joint, plane by plane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.mocap.inputs import PointTracks, read_motion, read_sensors
from cabinpose.core.angular import angular_speed
from cabinpose.core.delay import estimate_delay
from cabinpose.core.errors import AlignmentError, RecordingError
from cabinpose.core.resample import common_clock, resample_positions, resample_rotations
from cabinpose.evaluate.mocap.dfe import DfeRun, dfe_run
from cabinpose.evaluate.mocap.dse import DseRun, dse_run
from cabinpose.evaluate.mocap.pairs import JOINT_PAIRS, SEGMENT_PAIRS, Pair, missing, present, replaced
from cabinpose.evaluate.mocap.stillness import Window

F64 = NDArray[np.float64]
MAX_LAG_S = 2.0
_SMOOTHING_S = 0.1  # sigma: a model's segments are noisy, and the same filter on both delays neither
_MOSTLY = 0.5  # part of the samples in which a segment has to be known
_JOINTS_NEEDED = 3


@dataclass(frozen=True)
class Setup:
    """Which streams of a take are compared and how; see `cabinpose evaluate-mocap dse --help`. Times in s, heading in rad."""

    suit: str = "suit"
    optical: str = "optical"
    subject: str | None = None
    optical_subject: str | None = None
    windows: tuple[Window, ...] = ()
    pairs: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float | None = None
    max_gap_s: float = 0.1
    delay_s: float | None = None
    sensors: bool = False
    heading_rad: float | None = None


def dse_runs(path: Path, label: str, setup: Setup) -> tuple[list[DseRun], list[str]]:
    """The runs of a recording, one a window (without windows: one), and what is to be said about them."""
    suit, optical, notes = _streams(path, setup)
    if suit.orientation_wxyz is None or optical.orientation_wxyz is None:
        raise AlignmentError(f"{path} has markers alone of one system", hint="DSE needs segments' orientations of both")
    pairs, note = _pairs(SEGMENT_PAIRS, suit, optical, setup, least=1)
    time = _clock(suit, optical, setup)
    turned = [
        resample_rotations(m.time_s, q[:, [m.names.index(n) for n in names]], time, max_gap_s=setup.max_gap_s)
        for m, q, names in (
            (suit, suit.orientation_wxyz, [p.suit for p in pairs]),
            (optical, optical.orientation_wxyz, [p.optical for p in pairs]),
        )
    ]
    names = [p.name for p in pairs]
    runs = [
        dse_run(time[rows], turned[0][rows], turned[1][rows], names, condition=plane, heading_rad=setup.heading_rad)
        for plane, rows in _windows(time, label or _action(suit), setup)
    ]
    return runs, [*notes, *note]


def dfe_runs(path: Path, label: str, setup: Setup) -> tuple[list[DfeRun], list[str]]:
    """As `dse_runs`, of joints."""
    suit, optical, notes = _streams(path, setup)
    pairs, note = _pairs(JOINT_PAIRS, suit, optical, setup, least=_JOINTS_NEEDED)
    time = _clock(suit, optical, setup)
    placed = [
        resample_positions(m.time_s, m.position_m[:, [m.names.index(n) for n in names]], time, max_gap_s=setup.max_gap_s)
        for m, names in ((suit, [p.suit for p in pairs]), (optical, [p.optical for p in pairs]))
    ]
    names = [p.name for p in pairs]
    runs = [
        dfe_run(time[rows], placed[0][rows], placed[1][rows], names, condition=plane)
        for plane, rows in _windows(time, label or _action(suit), setup)
    ]
    return runs, [*notes, *note]


def _streams(path: Path, setup: Setup) -> tuple[PointTracks, PointTracks, list[str]]:
    """Suit and optical system, the suit's times brought onto the optical system's."""
    suit = (read_sensors if setup.sensors else read_motion)(path, source=setup.suit, subject=setup.subject)
    wanted = setup.optical_subject
    if wanted is None:
        try:
            optical = read_motion(path, source=setup.optical, subject=suit.subject, origin_ns=suit.origin_ns)
        except RecordingError:
            optical = read_motion(path, source=setup.optical, subject=None, origin_ns=suit.origin_ns)
    else:
        optical = read_motion(path, source=setup.optical, subject=wanted, origin_ns=suit.origin_ns)
    if setup.delay_s is not None:
        delay_s, note = setup.delay_s, f"{path.name}: suit {1e3 * setup.delay_s:+.1f} ms after the optical system, as given"
    else:
        delay_s, note = _delay(path, suit, optical, setup)
    return replace(suit, time_s=suit.time_s - delay_s), optical, [note]


def _delay(path: Path, suit: PointTracks, optical: PointTracks, setup: Setup) -> tuple[float, str]:
    """By how much the suit's stamps are late: from the angular speeds of all segments that both systems see, together."""
    pairs, _ = _pairs(SEGMENT_PAIRS, suit, optical, setup, least=1)
    if suit.orientation_wxyz is None or optical.orientation_wxyz is None:
        raise AlignmentError(f"{path.name}: no delay can be told from markers alone", hint="give it with --delay-ms")
    turned = [
        [motion.orientation_wxyz[:, motion.names.index(name)] for name in names]
        for motion, names in ((optical, [p.optical for p in pairs]), (suit, [p.suit for p in pairs]))
        if motion.orientation_wxyz is not None
    ]
    seen = [i for i in range(len(pairs)) if all(np.isfinite(q[i]).all(axis=1).mean() > _MOSTLY for q in turned)]
    if not seen:
        raise AlignmentError(f"{path.name}: no segment is seen by both most of the time", hint="give the delay with --delay-ms")
    speeds = [
        np.stack([angular_speed(motion.time_s, q[i]) for i in seen], axis=1)
        for motion, q in zip((optical, suit), turned, strict=True)
    ]
    try:
        found = estimate_delay(optical.time_s, speeds[0], suit.time_s, speeds[1], max_lag_s=MAX_LAG_S, smoothing_s=_SMOOTHING_S)
    except AlignmentError as error:
        raise AlignmentError(
            f"{path.name}: {error}", hint=f"{error.hint or 'both must see it turn'}; or give --delay-ms"
        ) from None
    low, high = (1e3 * x for x in found.interval_s)
    return found.offset_s, (
        f"{path.name}: suit {1e3 * found.offset_s:+.1f} ms after the optical system ({low:+.1f} to {high:+.1f}), "
        f"r = {found.correlation:.3f}, from the turning of {len(seen)} segments"
    )


def _pairs(
    table: Sequence[Pair], suit: PointTracks, optical: PointTracks, setup: Setup, *, least: int
) -> tuple[tuple[Pair, ...], list[str]]:
    wanted = replaced(table, {k: v for k, v in setup.pairs.items() if any(k in (p.name, p.suit) for p in table)})
    found = present(wanted, suit.names, optical.names, least=least)
    note = missing(wanted, found)
    return found, [note] if note else []


def _clock(suit: PointTracks, optical: PointTracks, setup: Setup) -> F64:
    rate = setup.rate_hz if setup.rate_hz is not None else round(min(suit.rate_hz, optical.rate_hz), 3)
    return common_clock([suit.time_s, optical.time_s], rate)


def _windows(time: F64, label: str, setup: Setup) -> list[tuple[str, NDArray[np.bool_]]]:
    if not setup.windows:
        return [(label, np.ones(len(time), bool))]
    return [(window.name, window.frames(time)) for window in setup.windows]


def _action(motion: PointTracks) -> str:
    return motion.action or motion.path.stem
