"""Any stream of the Lab Streaming Layer, through `pylsl`: numbers as channels, strings (markers) as facts.

Time stamps are the sender's clock, as they come; how that clock lies to this computer's is measured again and again and said
in facts, so that alignment can use all of it. LSL does not count samples: they are numbered as they come, and a stream that
broke off and came back counts as a restart.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cabinpose.core import RecordingError, optional_module
from cabinpose.record.sources.base import DeviceSource
from cabinpose.signals import Channels, Facts, HostClock, Message, Sample

_MOST_CHANNELS = 4096
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
        self._about = info.name() or self.name
        self._inlet = inlet
        self._next_correction_s = 0.0
        about: dict[str, object] = {"name": info.name(), "type": info.type(), "source_id": info.source_id()}
        about |= {"rate_hz": float(info.nominal_srate()), "format": "string" if self._text else "number"}
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
            messages = (Channels(self._labels, np.array(row, dtype=np.float64)),)
        device_ns = round(stamp * 1e9) if np.isfinite(stamp) else None
        return Sample(sequence, host_ns, device_ns, b"", messages)


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
