"""Suit and optical system of a take on one clock, segment by segment or joint by joint, plane by plane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cabinpose.app.mocap.inputs import PointTracks, pairs_of, read_motion, read_sensors, windows
from cabinpose.app.mocap.settings import OpticalSettings, RotationSettings
from cabinpose.core import AlignmentError, RecordingError
from cabinpose.evaluate.mocap import (
    JOINT_PAIRS,
    PELVIS,
    SEGMENT_PAIRS,
    DfeRun,
    DseRun,
    Pair,
    Window,
    dfe_run,
    dse_run,
    missing,
    pelvis_frames,
    present,
    replaced,
)
from cabinpose.signals import DelaySearch, angular_speed, common_clock, estimate_delay, resample_positions, resample_rotations

F64 = NDArray[np.float64]
MAX_LAG_S = 2.0
_SMOOTHING_S = 0.1  # sigma: a model's segments are noisy, and one filter on both shifts neither against the other
_MOSTLY = 0.5  # part of the samples in which a segment has to be known
_JOINTS_NEEDED = 3
What = Literal["position", "orientation"]
_TABLES: Mapping[What, tuple[Pair, ...]] = {"position": JOINT_PAIRS, "orientation": SEGMENT_PAIRS}


@dataclass(frozen=True)
class _Both:
    """Both systems' motions, the pairs that both have, a clock of both (A,) s, and what is to be said about them."""

    motions: tuple[PointTracks, PointTracks]  # suit, optical system
    pairs: tuple[Pair, ...]
    time_s: F64
    max_gap_s: float
    notes: list[str]

    @property
    def names(self) -> list[str]:
        """Ours, of the pairs."""
        return [p.name for p in self.pairs]

    def positions(self) -> list[F64]:
        """(A, N, 3) m of the pairs, suit and optical system."""
        return [
            resample_positions(m.time_s, m.position_m[:, at], self.time_s, max_gap_s=self.max_gap_s) for m, at in self._columns()
        ]

    def orientations(self) -> list[F64]:
        """(A, N, 4) wxyz of the pairs, suit and optical system."""
        return [
            resample_rotations(m.time_s, m.orientations()[:, at], self.time_s, max_gap_s=self.max_gap_s)
            for m, at in self._columns()
        ]

    def _columns(self) -> list[tuple[PointTracks, list[int]]]:
        suit, optical = self.motions
        return [
            (suit, [suit.names.index(p.suit) for p in self.pairs]),
            (optical, [optical.names.index(p.optical) for p in self.pairs]),
        ]

    def runs(self, label: str, windows: Sequence[Window]) -> list[tuple[str, NDArray[np.bool_]]]:
        """Name and frames (A,) of each window; without windows the whole take under its label, action or file name."""
        suit = self.motions[0]
        if not windows:
            return [(label or suit.action or suit.path.stem, np.ones(len(self.time_s), bool))]
        return [(window.name, window.frames(self.time_s)) for window in windows]


def dse_runs(take: Path, label: str, settings: RotationSettings) -> tuple[list[DseRun], list[str]]:
    """The runs of a take, one a window (without windows: one), and what is to be said about them.

    take: a recording, or the files of both systems with a comma between them.
    """
    both = _both(take, settings, "orientation")
    heading_rad = None if settings.heading_deg is None else float(np.radians(settings.heading_deg))
    suit, optical = both.orientations()
    runs = [
        dse_run(both.time_s[rows], suit[rows], optical[rows], both.names, condition=plane, heading_rad=heading_rad)
        for plane, rows in both.runs(label, windows(settings.windows))
    ]
    return runs, both.notes


def dfe_runs(take: Path, label: str, settings: OpticalSettings) -> tuple[list[DfeRun], list[str]]:
    """As `dse_runs`, of joints."""
    both = _both(take, settings, "position")
    suit, optical = both.positions()
    pelvises = _turned_pelvises(both, suit, optical) if any(m.points for m in both.motions) else {}
    runs = []
    for plane, rows in both.runs(label, windows(settings.windows)):
        given = {system: frames[rows] for system, frames in pelvises.items()}
        runs.append(dfe_run(both.time_s[rows], suit[rows], optical[rows], both.names, condition=plane, **given))
    return runs, both.notes


def _turned_pelvises(both: _Both, suit: F64, optical: F64) -> dict[str, F64]:
    """(A, 4, 4) world_from_pelvis of both by the turns of their pelvis since a first frame, in which z is the vertical.

    For points of files: what their models call the upper end of the pelvis lies in different places. Nothing where a pelvis or a
    femur head is not known.
    """
    segments = [(m, m.names.index(name)) for m, name in zip(both.motions, ("Pelvis", "Root"), strict=True) if name in m.names]
    hips = [both.names.index(PELVIS[side]) for side in ("left", "right") if PELVIS[side] in both.names]
    if len(segments) < 2 or len(hips) < 2:
        return {}
    turns = [resample_rotations(m.time_s, m.orientations()[:, at], both.time_s, max_gap_s=both.max_gap_s) for m, at in segments]
    values = np.concatenate((*turns, *(p[:, hips].reshape(len(p), -1) for p in (suit, optical))), axis=1)
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    if not len(known):
        return {}
    frames = {}
    for system, turn, position in zip(("suit_pelvis", "optical_pelvis"), turns, (suit, optical), strict=True):
        left, right = position[known][:, hips[0]], position[known][:, hips[1]]
        start = pelvis_frames(left[:1], right[:1], (left[:1] + right[:1]) / 2 + (0.0, 0.0, 1.0))[0]
        turned = Rotation.from_quat(turn[known], scalar_first=True)
        world_from_pelvis = np.full((len(values), 4, 4), np.nan)
        world_from_pelvis[known] = start
        world_from_pelvis[known, :3, :3] = (turned * turned[0].inv()).as_matrix() @ start[:3, :3]
        world_from_pelvis[known, :3, 3] = (left + right) / 2
        frames[system] = world_from_pelvis
    return frames


def _both(take: Path, settings: OpticalSettings, what: What) -> _Both:
    suit, optical, note = _streams(take, settings)
    table, pairs = _TABLES[what], _pairs(what, suit, optical, settings)
    if what == "orientation":  # positions need the turns' pairs too, for the delay, and turns no others
        replaced(table, pairs_of(settings.pairs))
    rate = settings.rate if settings.rate is not None else round(min(suit.rate_hz, optical.rate_hz), 3)
    time = common_clock([suit.time_s, optical.time_s], rate)
    notes = [note, missing(table, pairs)]
    return _Both((suit, optical), pairs, time, settings.max_gap_s, [note for note in notes if note])


def _streams(take: Path, settings: OpticalSettings) -> tuple[PointTracks, PointTracks, str]:
    """Suit and optical system, the suit's times brought onto the optical system's, and what is to be said of that."""
    first, comma, second = str(take).partition(",")
    read_suit = read_sensors if isinstance(settings, RotationSettings) and settings.sensors else read_motion
    given_s = None if settings.delay_ms is None else settings.delay_ms / 1e3
    if comma and not take.exists():  # two files, whose times begin at one trigger
        suit = read_suit(Path(first), source=None, subject=settings.subject, origin_ns=0)
        optical = read_motion(Path(second), subject=settings.optical_subject, origin_ns=0)
        delay_s = given_s or 0.0
        note = f"{suit.path.name}, {optical.path.name}: suit {1e3 * delay_s:+.1f} ms after the optical system, as given"
        with suppress(AlignmentError):  # the trigger's check, without which the evaluation does as well
            note += "; measured: " + _delay(suit, optical, settings)[1]
    else:
        suit = read_suit(take, source=settings.suit, subject=settings.subject)
        wanted = settings.optical_subject
        try:
            optical = read_motion(take, source=settings.optical, subject=wanted or suit.subject, origin_ns=suit.origin_ns)
        except RecordingError:
            optical = read_motion(take, source=settings.optical, subject=wanted, origin_ns=suit.origin_ns)
        if given_s is None:
            delay_s, note = _delay(suit, optical, settings)
        else:
            delay_s, note = given_s, f"suit {1e3 * given_s:+.1f} ms after the optical system, as given"
        note = f"{take.name}: {note}"
    return replace(suit, time_s=suit.time_s - delay_s), optical, note


def _delay(suit: PointTracks, optical: PointTracks, settings: OpticalSettings) -> tuple[float, str]:
    """By how much the suit's stamps are late: from the angular speeds of all segments that both systems see, together."""
    pairs = _pairs("orientation", suit, optical, settings)
    turned = [
        [motion.orientations()[:, motion.names.index(name)] for name in names]
        for motion, names in ((optical, [p.optical for p in pairs]), (suit, [p.suit for p in pairs]))
    ]
    seen = [i for i in range(len(pairs)) if all(np.isfinite(q[i]).all(axis=1).mean() > _MOSTLY for q in turned)]
    if not seen:
        raise AlignmentError(
            f"{suit.path.name}: no segment is seen by both most of the time", hint="give the delay with --delay-ms"
        )
    speeds = [
        np.stack([angular_speed(motion.time_s, q[i]) for i in seen], axis=1)
        for motion, q in zip((optical, suit), turned, strict=True)
    ]
    try:
        search = DelaySearch(max_lag_s=MAX_LAG_S, smoothing_s=_SMOOTHING_S)
        found = estimate_delay(optical.time_s, speeds[0], suit.time_s, speeds[1], search)
    except AlignmentError as error:
        raise AlignmentError(
            f"{suit.path.name}: {error}", hint=f"{error.hint or 'both must see it turn'}; or give --delay-ms"
        ) from None
    low, high = (1e3 * x for x in found.interval_s)
    return found.offset_s, (
        f"suit {1e3 * found.offset_s:+.1f} ms after the optical system ({low:+.1f} to {high:+.1f}), "
        f"r = {found.correlation:.3f}, from the turning of {len(seen)} segments"
    )


def _pairs(what: What, suit: PointTracks, optical: PointTracks, settings: OpticalSettings) -> tuple[Pair, ...]:
    table = _TABLES[what]
    named = {k: v for k, v in pairs_of(settings.pairs).items() if any(k in (p.name, p.suit) for p in table)}
    least = 1 if what == "orientation" else _JOINTS_NEEDED
    if suit.points or optical.points:
        least = max(least, 2)  # one is the head, which has one name in both models: two files of one system have it too
    return present(replaced(table, named), suit.known(what), optical.known(what), least=least)
