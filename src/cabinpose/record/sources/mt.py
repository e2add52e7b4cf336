"""Single inertial sensors of Xsens (MTi, MTw) by their device ids, on a serial line.

A line has one tracker, or a master that speaks for several (an Xbus master, a wireless station), each by a bus id. What is
wanted is named by device id, and anything else on the line is left alone.

Each packet of a tracker is a sample. Trackers on one line share a packet counter, so that the count of the source goes through
them in turn: a gap is a packet that was lost, whichever tracker's it was. `device_ns` is the fine sample time.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator

from cabinpose.core import RecordingError
from cabinpose.record.sources import mt_protocol as mt
from cabinpose.record.sources.base import DeviceSource
from cabinpose.record.sources.counting import DeviceClock, FrameNumbers
from cabinpose.record.sources.mt_protocol import XbusMessage, XbusSplitter
from cabinpose.record.sources.serial_line import SerialLine
from cabinpose.signals import Facts, HostClock, Message, Sample, SensorReadings

_ASK_AGAIN_S = 0.3
_SILENT_S = 1.0  # a tracker that sends nothing for so long while others do is told
_OUTPUTS = (mt.QUATERNION, mt.ACCELERATION, mt.TURN_RATE, mt.MAGNETIC_FIELD)
_WIDTH = {mt.QUATERNION: 4, mt.ACCELERATION: 3, mt.TURN_RATE: 3, mt.MAGNETIC_FIELD: 3}


def _device_id(text: str) -> str:
    if not re.fullmatch(r"(?:[0-9A-Fa-f]{8}){1,2}", text):
        raise ValueError(f"'{text}' is no device id: 8 or 16 digits of 0-9 and A-F, as on the tracker's label (in quotes)")
    return text.upper()


class MtSettings(BaseModel):
    """Which trackers, on which line, and how often they measure."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: Path = Field(description="serial line of the tracker or the master, such as /dev/ttyUSB0")
    baud: int = Field(115200, gt=0, description="bits a second of the line")
    sensors: dict[str, Annotated[str, AfterValidator(_device_id)]] = Field(
        min_length=1, description="device ids by the name that the recording shall use"
    )
    rate_hz: int = Field(100, ge=1, le=2000, description="samples a second of each")
    answer_s: float = Field(3.0, gt=0, description="how long a tracker may take for an answer, s")

    @field_validator("sensors")
    @classmethod
    def _distinct(cls, sensors: dict[str, str]) -> dict[str, str]:
        if len(set(sensors.values())) < len(sensors):
            raise ValueError("a device id stands twice")
        return sensors


class MtSource(DeviceSource[MtSettings]):
    """A `FrameSource` of `SensorReadings`: of one tracker a sample, its name being subject and sensor."""

    Settings: ClassVar = MtSettings

    def __init__(self, name: str, settings: MtSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        self._line = SerialLine(settings.port, settings.baud, lost=("tracker", "look at cable and power"))
        self._numbers = FrameNumbers(self.counts, mt.COUNTER_VALUES * len(settings.sensors), late=16 * len(settings.sensors))
        self._device_clock = DeviceClock(mt.TICK_NS, 1 << 32)
        self._names: dict[int, str] = {}  # by bus id
        self._heard: dict[str, float] = {}  # when each sent last
        self._silent: set[str] = set()
        self._status: dict[str, int] = {}
        self._pending: list[Facts] = []

    def _missing(self) -> Sequence[str]:
        return self._listened(1.0)

    def _complaints(self) -> list[str]:
        if self.counts.received:
            return []
        return [f"{self.settings.port}: the trackers are there and measure nothing (look at rate_hz)"]

    def _connect(self) -> None:
        """Find the trackers, set what they send, and let them measure."""
        self._line.open()
        try:
            self._splitter = XbusSplitter()
            self._names = self._found()
            self._pending = [self._configured(bus, name) for bus, name in self._names.items()]
            self._ask(XbusMessage(mt.MASTER, mt.TO_MEASUREMENT, b""))
        except RecordingError:
            self._disconnect()
            raise
        self._splitter.malformed = 0
        self._numbers.reached_again()
        self._device_clock.restart()
        self._heard = dict.fromkeys(self.settings.sensors, self._clock.now_s())
        self._silent.clear()
        self._status.clear()

    def _disconnect(self) -> None:
        if self._line.is_open:
            with suppress(RecordingError):  # the line may be what failed
                self._line.send(mt.encode(XbusMessage(mt.MASTER, mt.TO_CONFIG, b"")))
            self._line.close()

    def _read(self, timeout_s: float) -> Sequence[Sample]:
        """The packets that have come, and what is to be told of the trackers."""
        until = self._clock.now_s() + timeout_s
        samples: list[Sample] = []
        while not samples:
            left = until - self._clock.now_s()
            messages = self._splitter.feed(self._line.receive(max(left, 0.0)))
            host_ns = self._clock.now_ns()
            self.counts.malformed, self._splitter.malformed = self.counts.malformed + self._splitter.malformed, 0
            for message in messages:
                samples += self._samples(message, host_ns)
            self._look_for_silence()
            samples += [Sample(None, host_ns, None, b"", (facts,)) for facts in self._pending]
            self._pending.clear()
            if left <= 0:
                break
        return samples

    def _samples(self, message: XbusMessage, host_ns: int) -> Iterator[Sample]:
        name = self._names.get(message.bus)
        if message.kind == mt.ERROR:
            raise RecordingError(
                f"{self.settings.port}: {name or 'a tracker'} reports {_error(message)}",
                hint="power it off and on; lower rate_hz",
            )
        if message.kind != mt.DATA or name is None:
            return
        raw = mt.encode(message)
        try:
            of = mt.packets(message.data)
            values = [mt.numbers(of, kind, width) for kind, width in _WIDTH.items()]
        except ValueError:
            self.counts.malformed += 1
            return
        self.counts.received += 1
        self._heard[name] = self._clock.now_s()
        if name in self._silent:
            self._silent.discard(name)
            self._pending.append(Facts(name, {"silent": False}))
        status, counter, ticks = (mt.whole_number(of, kind) for kind in (mt.STATUS, mt.PACKET_COUNTER, mt.TIME_FINE))
        if status is not None and status != self._status.get(name):
            self._status[name] = status
            self._pending.append(Facts(name, {"status_word": status}))
        among = list(self.settings.sensors)
        number = None if counter is None else self._numbers.number(counter * len(among) + among.index(name))
        device_ns = None if ticks is None else self._device_clock.device_ns(ticks, host_ns)
        messages: tuple[Message, ...] = (SensorReadings(name, (name,), *values),)
        yield Sample(number, host_ns, device_ns, raw, messages)

    def _look_for_silence(self) -> None:
        """Tell, once, of a tracker that has stopped while another goes on; of all, the recorder tells."""
        latest = max(self._heard.values())
        for name, heard in self._heard.items():
            if name not in self._silent and latest - heard > _SILENT_S:
                self._silent.add(name)
                self._pending.append(Facts(name, {"silent": True}))

    # ------------------------------------------------------------------------------------------------- questions

    def _found(self) -> dict[int, str]:
        """The names of the wanted trackers by bus id. Raises RecordingError, naming what is there, where one is not."""
        self._ask(XbusMessage(mt.MASTER, mt.TO_CONFIG, b""))
        own = self._ask(XbusMessage(mt.MASTER, mt.REQUEST_ID, b"")).data.hex().upper()
        there = {mt.MASTER: own}
        wanted = {device: name for name, device in self.settings.sensors.items()}
        if set(wanted) != {own}:
            with suppress(RecordingError):  # a tracker alone is master of nothing
                ids = self._ask(XbusMessage(mt.MASTER, mt.INIT_BUS, b"")).data.hex().upper()
                there = {bus: ids[k : k + 8] for bus, k in enumerate(range(0, len(ids), 8), 1)} or there
        short = {device[-8:]: name for device, name in wanted.items()}  # a bus tells the lower half of a long id
        found = {bus: wanted.get(device) or short.get(device, "") for bus, device in there.items()}
        found = {bus: name for bus, name in found.items() if name}
        if lacking := [f"{device} ({name})" for device, name in wanted.items() if name not in found.values()]:
            raise RecordingError(
                f"{self.settings.port} has no tracker {', '.join(lacking)}",
                hint=f"there: {', '.join(there.values())}; the id is on the tracker's label",
            )
        return found

    def _configured(self, bus: int, name: str) -> Facts:
        """Set what a tracker sends; what it then says that it sends, which may be less."""
        rates = dict.fromkeys((mt.PACKET_COUNTER, mt.TIME_FINE, mt.STATUS), mt.EACH_SAMPLE)
        rates |= dict.fromkeys(_OUTPUTS, self.settings.rate_hz)
        asked = b"".join(kind.to_bytes(2, "big") + rate.to_bytes(2, "big") for kind, rate in sorted(rates.items()))
        told = self._ask(XbusMessage(bus, mt.OUTPUTS, asked)).data
        rows = [told[k : k + 4] for k in range(0, len(told) - 3, 4)]
        outputs = {f"0x{row[:2].hex().upper()}": int.from_bytes(row[2:], "big") for row in rows}
        own = f"0x{mt.QUATERNION:04X}"
        if outputs.get(own) != self.settings.rate_hz:
            raise RecordingError(
                f"{self.settings.port}: {name} sends orientations at {outputs.get(own, 0)} Hz, not {self.settings.rate_hz}",
                hint="give a rate_hz that it has; trackers without orientation (MTi-1, MTi-10) cannot be used",
            )
        return Facts(name, {"device_id": self.settings.sensors[name], "bus_id": bus, "outputs_hz": outputs})

    def _ask(self, question: XbusMessage) -> XbusMessage:
        """The answer, asked for again and again. Raises RecordingError where none comes, or an error does."""
        until = self._clock.now_s() + self.settings.answer_s
        while self._clock.now_s() < until:
            self._line.send(mt.encode(question))
            again = min(self._clock.now_s() + _ASK_AGAIN_S, until)
            while (left := again - self._clock.now_s()) > 0:
                for message in self._splitter.feed(self._line.receive(left)):
                    if message.kind == mt.ERROR:
                        raise RecordingError(
                            f"{self.settings.port}: a tracker refuses message 0x{question.kind:02X}: {_error(message)}",
                            hint="look at rate_hz, and at baud: a line has no room for every rate",
                        )
                    # A second answer to an earlier question may come late.
                    if message.kind == question.kind + 1 and question.bus in (mt.MASTER, message.bus):
                        return message
        what = "what comes is no Xbus message" if self._splitter.malformed else "no answer"
        raise RecordingError(
            f"{self.settings.port}: {what} within {self.settings.answer_s:g} s to message 0x{question.kind:02X}",
            hint="check power, port and baud (115200 unless changed), and that no other program holds the line",
        )


def _error(message: XbusMessage) -> str:
    code = message.data[0] if message.data else 0
    return f"error {code} ({mt.ERRORS.get(code, 'see its manual')})"
