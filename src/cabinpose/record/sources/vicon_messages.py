"""What Vicon's packets mean: metres, quaternions, z up, NaN for what is occluded; and the account of its frame numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cabinpose.core import ZUP_FROM_YUP
from cabinpose.record.sources.vicon_protocol import FRAME_COUNTER, TICKS_PER_SECOND, Packet, Rows, SubjectInfo, Type
from cabinpose.signals import F64, Channels, Counts, Facts, Markers, Message, SegmentPoses

_MM = 1e-3
_NOT_A_ROTATION = 1e-3  # largest deviation of an element from the nearest rotation's; a server's deviate by 1e-7
_LATE_S = 60.0  # no frame waits longer on its way
_RATE_UNKNOWN_HZ = 1000.0


def _quaternion_maps() -> tuple[F64, F64]:
    """From (1, the 9 elements of R) to the 16 of 4 q qᵀ, q = wxyz; and from those of q qᵀ to the 9 of R. Both linear."""
    forward, back = np.zeros((10, 4, 4)), np.zeros((4, 4, 9))
    signs = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))  # of the diagonal of R: ww, xx, yy, zz
    for i, row in enumerate(signs):
        forward[0, i, i] = 1.0
        for k, sign in enumerate(row):
            forward[1 + 4 * k, i, i] = back[i, i, 4 * k] = sign
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        lower, upper = 3 * c + b, 3 * b + c  # R[c, b] − R[b, c] = 4 w q_a, and their sum is 4 q_b q_c
        forward[1 + lower, 0, 1 + a], forward[1 + upper, 0, 1 + a] = 1.0, -1.0
        forward[1 + lower, 1 + b, 1 + c] = forward[1 + upper, 1 + b, 1 + c] = 1.0
        back[0, 1 + a, lower], back[0, 1 + a, upper] = 2.0, -2.0
        back[1 + b, 1 + c, lower] = back[1 + b, 1 + c, upper] = 2.0
        forward[:, 1 + a, 0], forward[:, 1 + c, 1 + b] = forward[:, 0, 1 + a], forward[:, 1 + b, 1 + c]
    return forward.reshape(10, 16), back.reshape(16, 9)


_PRODUCTS_FROM_MATRIX, _MATRIX_FROM_PRODUCTS = _quaternion_maps()


class _Table:
    """Where the values go of things that a subject's id and an id of the subject's own name: one row each, subjects in order."""

    def __init__(self, subjects: Sequence[tuple[int, str, Sequence[tuple[int, str]]]] = ()) -> None:
        keys = np.array([subject << 32 | identity for subject, _, things in subjects for identity, _ in things], np.uint64)
        self.size = len(keys)
        self._rows = np.argsort(keys, kind="stable")
        self._keys = keys[self._rows]
        self.parts: list[tuple[str, tuple[str, ...], slice]] = []  # of each subject that has some: its name, theirs, their rows
        start = 0
        for _, subject, things in subjects:
            if things:
                self.parts.append((subject, tuple(name for _, name in things), slice(start, start + len(things))))
            start += len(things)

    def find(self, subjects: Rows, identities: Rows) -> tuple[Rows, Rows]:
        """Which of these it has, and the rows of those that it has."""
        if self.size == 0:
            return np.zeros(len(identities), bool), np.empty(0, np.intp)
        wanted = subjects.astype(np.uint64) << np.uint64(32) | identities
        at = np.minimum(np.searchsorted(self._keys, wanted), self.size - 1)
        known = self._keys[at] == wanted
        return known, self._rows[at[known]]


class PacketDecoder:
    """Turns packets into messages; remembers what the server says once: subjects, axes, frame period.

    up: the server's vertical axis, "z" or "y"; None believes what the server says of itself (z, if nothing) · codes: what
    subjects are called, by their names on the server.
    """

    def __init__(self, *, up: str | None = None, codes: Mapping[str, str] | None = None) -> None:
        self._up, self._codes = up, codes or {}
        self._subjects: tuple[SubjectInfo, ...] = ()
        self.told: tuple[str, ...] = ()  # names of the subjects on the server
        self._segments, self._markers = _Table(), _Table()
        self._y_up = False
        self.period = 0
        self.rates: dict[str, float] = {}
        self.neutral: dict[int, Rows] = {}

    @property
    def subjects(self) -> tuple[str, ...]:
        """Names of the subjects that the server tracks, or their codes."""
        return tuple(subject.name for subject in self._subjects)

    @property
    def rate_hz(self) -> float | None:
        """Frames a second; None where the server has not said, or says that there are none."""
        return TICKS_PER_SECOND / self.period if self.period > 0 else None

    def device_ns(self, frame: int) -> int | None:
        """The time of a frame on the server's frame clock, which begins with the first, number 1; None if that is no int64."""
        time_ns = (frame - 1) * self.period * 1_000_000_000 // TICKS_PER_SECOND
        return time_ns if self.period > 0 and time_ns < 1 << 63 else None

    def statics(self, packet: Packet) -> list[Message]:
        """Take note of what holds until said otherwise, and say it as facts where the packet does."""
        facts: list[Message] = []
        if packet.neutral:
            self.neutral = dict(packet.neutral)
        if packet.rates is not None:
            self.rates = {name: rate for name, rate in packet.rates.items() if math.isfinite(rate)}
        if packet.y_up is not None:
            self._y_up = packet.y_up
        if packet.period is not None:
            self.period = packet.period
        if packet.period is not None or packet.y_up is not None:
            facts.append(self._stream_facts())
        contents = packet.contents
        gone = (
            contents is not None and contents.counts.get(Type.SUBJECT_INFO) == 0 and Type.SUBJECT_INFO not in contents.unchanged
        )
        if packet.subjects or gone:
            self._learn(packet.subjects)
            facts += [self._subject_facts(subject) for subject in self._subjects]
        return facts

    def poses(self, packet: Packet) -> list[Message]:
        """The segments of every subject that has some, in the world; NaN where the packet has none."""
        table = self._segments
        position, orientation = np.full((table.size, 3), np.nan), np.full((table.size, 4), np.nan)
        found = [(identity, rows) for identity, rows in packet.global_segments.items() if len(rows)]
        if found:
            rows = np.concatenate([rows for _, rows in found])
            subjects = np.repeat(np.array([identity for identity, _ in found], np.uint64), [len(rows) for _, rows in found])
            known, at = table.find(subjects, rows["segment"])
            if len(at):
                position[at] = self._points(rows["translation"][known])
                orientation[at] = quaternion_wxyz(self._rotations(rows["rotation"][known].reshape(-1, 3, 3)))
        return [SegmentPoses(name, names, position[part], orientation[part]) for name, names, part in table.parts]

    def labeled(self, packet: Packet) -> list[Message]:
        """The markers of every subject that has some; NaN where the packet has none.

        Markers whose subject or label the server has not told are among those without a label, as subject/marker (ids).
        """
        rows, table = packet.labeled, self._markers
        position = np.full((table.size, 3), np.nan)
        messages: list[Message] = []
        if rows is not None and len(rows):
            known, at = table.find(rows["subject"], rows["marker"])
            position[at] = self._points(rows["position"][known])
            if not known.all():
                strange = rows[~known]
                names = tuple(f"{row['subject']}/{row['marker']}" for row in strange)
                messages.append(_markers("", names, self._points(strange["position"])))
        return messages + [_markers(name, names, position[part]) for name, names, part in table.parts]

    def unlabeled(self, packet: Packet) -> list[Message]:
        """The markers without a label, named by the numbers of their trajectories."""
        rows = packet.unlabeled
        if rows is None:
            return []
        return [_markers("", tuple(str(number) for number in rows["trajectory"].tolist()), self._points(rows["position"]))]

    @property
    def _turn(self) -> bool:
        return self._y_up if self._up is None else self._up == "y"

    def _points(self, position_mm: F64) -> F64:
        with np.errstate(all="ignore"):  # what is not finite becomes NaN
            points = position_mm * _MM
            if self._turn:
                points = points @ ZUP_FROM_YUP.T
        points[~np.isfinite(points).all(axis=1)] = np.nan
        return points

    def _rotations(self, matrix: F64) -> F64:
        """Of segments' frames whose axes follow the world's, as in the vendor's SDK: M R Mᵀ."""
        with np.errstate(all="ignore"):
            return ZUP_FROM_YUP @ matrix @ ZUP_FROM_YUP.T if self._turn else matrix

    def _learn(self, infos: Sequence[SubjectInfo]) -> None:
        self.told = tuple(info.name for info in infos)
        named = (replace(info, name=self._codes.get(info.name, info.name)) for info in infos)
        self._subjects = tuple({info.subject: info for info in named}.values())
        self._segments = _Table([(s.subject, s.name, [(part.segment, part.name) for part in s.segments]) for s in self._subjects])
        self._markers = _Table([(s.subject, s.name, s.markers) for s in self._subjects])

    def _stream_facts(self) -> Facts:
        told = {
            "frame_rate_hz": self.rate_hz, "frame_period_ticks": self.period, "ticks_per_second": TICKS_PER_SECOND,
            "server_up": "y" if self._y_up else "z", "rates_hz": dict(self.rates),
        }  # fmt: skip
        return Facts("stream", told)

    def _subject_facts(self, info: SubjectInfo) -> Facts:
        names = {segment.segment: segment.name for segment in info.segments}
        attached = dict(info.attachments)
        values: dict[str, object] = {
            "id": info.subject,
            "segments": [{"name": s.name, "parent": names.get(s.parent)} for s in info.segments],
            "markers": [{"name": name, "segment": names.get(attached.get(marker, 0))} for marker, name in info.markers],
        }
        rows = self.neutral.get(info.subject)
        if rows is not None:
            numbers = np.isfinite(rows["translation"]).all(axis=1) & np.isfinite(rows["rotation"]).all(axis=1)
            rows = rows[numbers]
            rotation = self._rotations(rows["rotation"].reshape(-1, 3, 3)).reshape(-1, 9)
            values["neutral_pose"] = [  # in the parent's frame, whose axes are turned as the world's are
                {"name": names.get(segment), "position_m": position, "rotation_row_major": turned}
                for segment, position, turned in zip(
                    rows["segment"].tolist(), self._points(rows["translation"]).tolist(), rotation.tolist(), strict=True
                )
            ]
        return Facts(f"subject {info.name}", values)


def latency(packet: Packet, network_s: float) -> list[Message]:
    """What lies between a frame's capture and its arrival, s: the sum of what the server tells, the network's, each part."""
    if packet.latency is None:
        return []
    names = ("latency_s", "network_s", *(f"latency {name}" for name, _ in packet.latency))
    parts = [seconds for _, seconds in packet.latency]
    return [Channels(names, np.array([sum(parts), network_s, *parts], np.float64))]


def quaternion_wxyz(matrix: F64) -> F64:
    """(S, 4) unit quaternions of (S, 3, 3) matrices; NaN where a matrix is no rotation.

    q is the largest of the rows of q qᵀ, which are linear in R (Markley 2008, Unit quaternion from rotation matrix), and R
    was a rotation if q gives it back. A third of the time of scipy's.
    """
    count = len(matrix)
    flat = np.empty((count, 10))
    flat[:, 0], flat[:, 1:] = 1.0, matrix.reshape(count, 9)
    with np.errstate(all="ignore"):
        products = (flat @ _PRODUCTS_FROM_MATRIX).reshape(count, 4, 4)
        largest = products.diagonal(axis1=1, axis2=2).argmax(axis=1)
        result = products[np.arange(count), largest]
        result /= np.sqrt((result * result).sum(axis=1, keepdims=True))
        back = (result[:, :, None] * result[:, None, :]).reshape(count, 16) @ _MATRIX_FROM_PRODUCTS
        proper = np.abs(back - flat[:, 1:]).max(axis=1) < _NOT_A_ROTATION  # False for NaN
    result[~proper] = np.nan
    return result


def _markers(subject: str, names: tuple[str, ...], position_m: F64) -> Markers:
    # DataStream gives a marker's radius and covariance, no residual.
    return Markers(subject, names, position_m, np.full(len(names), np.nan))


class FrameArrival(NamedTuple):
    """What a frame number says: its sequence (None: it came before) and itself continuous over wraps; whether frames were lost
    just before it, and whether the numbers restarted with it.
    """

    sequence: int | None
    frame: int
    lost: int = 0
    anew: bool = False


class FrameAccount:
    """Keeps `lost` and `duplicate` in `counts` by the numbers of the frames.

    TCP keeps the order, so a number that falls is a restart, and so is one that leaps by more than the time that went by
    explains; what was sent before such a beginning and never came cannot be known.
    """

    def __init__(self, counts: Counts) -> None:
        self._counts = counts
        self._last: FrameArrival | None = None
        self._number = self._last_ns = 0

    def arrive(self, number: int, now_ns: int, rate_hz: float | None) -> FrameArrival:
        """A frame of this number has come."""
        last = self._last
        if last is None:
            arrival = FrameArrival(number, number)
        elif (rise := (number - self._number) % FRAME_COUNTER) == 0:
            self._counts.duplicate += 1
            return last._replace(sequence=None, lost=0, anew=False)
        elif rise <= min(FRAME_COUNTER // 2, (_LATE_S + 1.1e-9 * (now_ns - self._last_ns)) * (rate_hz or _RATE_UNKNOWN_HZ)):
            self._counts.lost += rise - 1
            arrival = FrameArrival(_sequence(last) + rise, last.frame + rise, lost=rise - 1)
        else:
            arrival = FrameArrival(_sequence(last) + 1, number, anew=True)
        self._last, self._number, self._last_ns = arrival, number, now_ns
        return arrival


def _sequence(arrival: FrameArrival) -> int:
    assert arrival.sequence is not None  # of what came before, only duplicates have none, and they are not kept
    return arrival.sequence
