"""Any stream of the Lab Streaming Layer, through `pylsl`: numbers as channels, strings (markers) as facts.

A stream of seven channels x, y, z, qx, qy, qz, qw, as mobile trackers send them, or of seven that the rig names, is a pose too:
it stands beside the channels as the segment that `align` takes for the head.

Time stamps are the sender's clock, as they come; how that clock lies to this computer's is measured again and again and said
in facts, so that alignment can use all of it. LSL does not count samples: they are numbered as they come, and a stream that
broke off and came back counts as a restart.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cabinpose.core import RecordingError, metres_of, optional_module
from cabinpose.record.sources.base import DeviceSource
from cabinpose.signals import F64, Channels, Facts, HostClock, Message, Sample, SegmentPoses, product

_MOST_CHANNELS = 4096
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_UNIT_OFF = 0.01  # by which a quaternion's length may be off 1: single precision and rounded text are far below
_Z_FROM_Y_UP: F64 = np.array([0.5**0.5, 0.5**0.5, 0.0, 0.0])  # a quarter turn about x
_LONGEST_DESCRIPTION = 1 << 20
_ANSWER_S, _RETRY_S = 0.02, 0.25  # LSL measures the sender's clock on a thread of its own, for about a second at first


class LslSettings(BaseModel):
    """Which stream: by name, type or source id; the first that fits all that are given."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    stream: str | None = Field(None, min_length=1, description="the stream's name")
    type: str | None = Field(None, min_length=1, description="its type, such as EEG, Markers, MoCap")
    source_id: str | None = Field(None, min_length=1, description="its source id")
    resolve_s: float = Field(5.0, gt=0, le=300, description="seconds to look for it when it is opened")
    buffer_s: int = Field(60, ge=1, le=3600, description="seconds of samples that LSL keeps for a reader that is late")
    correct_every_s: float = Field(5.0, gt=0, description="seconds between measurements of the sender's clock")
    pose: tuple[str, str, str, str, str, str, str] | None = Field(
        None, description="channels of x, y, z and the quaternion's x, y, z, w, where they are called otherwise"
    )
    pose_unit_m: float | None = Field(None, gt=0, description="unit of x, y, z in metres; left out: what the stream says, else 1")
    pose_up: Literal["y", "z"] = Field("z", description="axis of the tracker's world that points up")
    subject: str = Field("head", min_length=1, description="whose pose it is; its segment has the same name")
    reconnect_s: float = Field(2.0, gt=0, description="seconds between attempts to find a stream that went away")

    @model_validator(mode="after")
    def _named(self) -> LslSettings:
        if self.stream is None and self.type is None and self.source_id is None:
            raise ValueError("say which stream: give stream, type or source_id")
        return self


class LslSource(DeviceSource[LslSettings]):
    """A `FrameSource` of one stream; LSL does not tell what was lost."""

    Settings: ClassVar = LslSettings

    def __init__(self, name: str, settings: LslSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        self._inlet: Any = None
        self._labels: tuple[str, ...] = ()
        self._pose: list[int] = []  # the channels of a pose
        self._unit_m = 1.0
        self._text = False
        self._about = ""
        self._sequence = 0
        self._pending: list[Facts] = []
        self._next_correction_s = 0.0
        self._look_s = settings.resolve_s  # for how long the stream is looked for

    def _missing(self) -> Sequence[str]:
        self._find(_load(), self.settings.resolve_s)
        return []

    def _connect(self) -> None:
        self._subscribe(self._look_s)

    def _disconnect(self) -> None:
        inlet, self._inlet = self._inlet, None
        if inlet is not None:
            inlet.close_stream()

    def _read(self, timeout_s: float) -> Sequence[Sample]:
        """The samples since the last call; looks for a stream that went away."""
        until = self._clock.now_s() + timeout_s
        if self._inlet is None and self._attempt(self.settings.reconnect_s):
            self._look_s = max(min(timeout_s, self.settings.resolve_s), 0.1)
            self._reconnect()
        rows: Sequence[Any] = ()
        stamps: Sequence[float] = ()
        if self._inlet is None:
            self._clock.sleep(until - self._clock.now_s())
        else:
            wait_s = 0.0 if self._pending else max(until - self._clock.now_s(), 0.0)
            try:
                rows, stamps = self._inlet.pull_chunk(timeout=wait_s, max_samples=1024)
                self._correct()
            except RuntimeError:  # pylsl's LostError is one
                self._disconnect()
        host_ns = self._clock.now_ns()
        samples = [Sample(None, host_ns, None, b"", (facts,)) for facts in self._pending]
        self._pending.clear()
        return samples + [self._sample(row, stamp, host_ns) for row, stamp in zip(rows or (), stamps or (), strict=True)]

    def _find(self, pylsl: Any, timeout_s: float) -> Any:
        """The stream's announcement; RecordingError where there is none in the time."""
        settings = self.settings
        wanted = {"name": settings.stream, "type": settings.type, "source_id": settings.source_id}
        given = {key: value for key, value in wanted.items() if value is not None}
        if any("'" in value for value in given.values()):
            raise RecordingError(f"a stream cannot be named {given}", hint="names with apostrophes cannot be looked for")
        found = pylsl.resolve_bypred(" and ".join(f"{key}='{value}'" for key, value in given.items()), 1, timeout_s)
        if not found:
            wish = ", ".join(f"{key} {value}" for key, value in given.items())
            hint = "start it, on a network that passes multicast, or tell LSL where to look (LSLAPICFG)"
            raise RecordingError(f"no LSL stream of {wish} answers", hint=hint)
        return found[0]

    def _subscribe(self, timeout_s: float) -> None:
        self._pylsl = pylsl = _load()
        announced = self._find(pylsl, timeout_s)
        inlet = pylsl.StreamInlet(announced, max_buflen=self.settings.buffer_s, recover=False)
        try:
            info = inlet.info(timeout=timeout_s)
            inlet.open_stream(timeout=timeout_s)
        except RuntimeError as error:  # LostError, TimeoutError of pylsl
            message = f"the LSL stream {announced.name()} does not answer: {error}"
            raise RecordingError(message, hint="is it still there?") from error
        count = int(info.channel_count())
        if not 0 < count <= _MOST_CHANNELS:
            raise RecordingError(f"the LSL stream {info.name()} has {count} channels", hint=f"1 to {_MOST_CHANNELS} can be read")
        self._labels = _labels(info, count)
        self._text = info.channel_format() == pylsl.cf_string
        self._pose = [] if self._text else _pose_channels(self._labels, self.settings.pose)
        self._unit_m = self.settings.pose_unit_m or (_stated_unit(info, self._pose) if self._pose else 1.0)
        self._about = info.name() or self.name
        self._inlet = inlet
        self._next_correction_s = 0.0
        about: dict[str, object] = {"name": info.name(), "type": info.type(), "source_id": info.source_id()}
        about |= {"rate_hz": float(info.nominal_srate()), "format": "string" if self._text else "number"}
        if self._pose:
            about["pose"] = {
                "channels": [self._labels[i] for i in self._pose],
                "unit_m": self._unit_m,
                "up": self.settings.pose_up,
            }
        description = info.as_xml()
        about |= {"channels": list(self._labels), "description": description if len(description) <= _LONGEST_DESCRIPTION else ""}
        self._pending.append(Facts("stream", about))

    def _correct(self) -> None:
        """Measure the sender's clock, if it is time."""
        now = self._clock.now_s()
        if now < self._next_correction_s:
            return
        self._next_correction_s = now + _RETRY_S
        try:
            offset_s = float(self._inlet.time_correction(timeout=_ANSWER_S))
        except RuntimeError:  # no answer in time; a lost stream is told by the next pull
            return
        self._next_correction_s = now + self.settings.correct_every_s
        host_minus_lsl_s = self._clock.now_ns() / 1e9 - float(self._pylsl.local_clock())
        self._pending.append(
            Facts("time_correction", {"sender_to_lsl_clock_s": offset_s, "lsl_clock_to_host_ns": round(host_minus_lsl_s * 1e9)})
        )

    def _sample(self, row: Sequence[Any], stamp: float, host_ns: int) -> Sample:
        self.counts.received += 1
        sequence, self._sequence = self._sequence, self._sequence + 1
        messages: tuple[Message, ...] = ()
        if len(row) != len(self._labels) or not np.isfinite(stamp):
            self.counts.malformed += 1
        elif self._text:
            messages = (Facts(self._about, dict(zip(self._labels, (str(v) for v in row), strict=True))),)
        else:
            values = np.array(row, dtype=np.float64)
            messages = (Channels(self._labels, values),)
            if self._pose:
                messages += (self._posed(values[self._pose]),)
        device_ns = round(stamp * 1e9) if np.isfinite(stamp) else None
        return Sample(sequence, host_ns, device_ns, b"", messages)

    def _posed(self, values: F64) -> SegmentPoses:
        """The pose in seven values; all NaN where the tracker has lost itself."""
        position, turn = values[:3] * self._unit_m, values[[6, 3, 4, 5]]
        length = float(np.linalg.norm(turn))
        if not (np.isfinite(values).all() and abs(length - 1) < _UNIT_OFF):
            position, turn = np.full(3, np.nan), np.full(4, np.nan)
        else:
            turn = turn / length
            if self.settings.pose_up == "y":
                position, turn = position[[0, 2, 1]] * (1, -1, 1), product(_Z_FROM_Y_UP, turn)
        return SegmentPoses(self.settings.subject, (self.settings.subject,), position[None], turn[None])


def _pose_channels(labels: Sequence[str], named: Sequence[str] | None) -> list[int]:
    """Where a pose stands among the channels, in the order x y z qx qy qz qw; nothing where there is none.

    Raises RecordingError where a named channel is not there.
    """
    if named is not None:
        if lacking := [name for name in named if name not in labels]:
            raise RecordingError(f"the LSL stream has no channel {', '.join(lacking)}", hint=f"it has: {', '.join(labels)}")
        return [labels.index(name) for name in named]
    lower = [label.lower() for label in labels]
    return [lower.index(name) for name in _POSE] if sorted(lower) == sorted(_POSE) else []


def _stated_unit(info: Any, pose: Sequence[int]) -> float:
    """The unit of a pose's x in the stream's description, m. Raises RecordingError for one that is not known."""
    channel = info.desc().child("channels").child("channel")
    for _ in range(pose[0]):
        channel = channel.next_sibling("channel")
    unit = "" if channel.empty() else str(channel.child_value("unit"))
    metres = metres_of(unit or "m")
    if metres is None:
        raise RecordingError(f"positions of the LSL stream are in '{unit}'", hint="say how long that is with pose_unit_m")
    return metres


def _load() -> Any:
    hint = "pip install pylsl; where it brings no liblsl for this system, install that too"
    return optional_module("pylsl", purpose="a Lab Streaming Layer stream", hint=hint)


def _labels(info: Any, count: int) -> tuple[str, ...]:
    """The channels' labels from the description, each once; numbers where there are none."""
    labels: list[str] = []
    channel = info.desc().child("channels").child("channel")
    while not channel.empty() and len(labels) < count:
        labels.append(str(channel.child_value("label")))
        channel = channel.next_sibling("channel")
    labels += [""] * (count - len(labels))
    result: list[str] = []
    for i, label in enumerate(labels):
        name = label or f"channel{i}"
        result.append(name if name not in result else f"{name}_{i}")
    return tuple(result)
