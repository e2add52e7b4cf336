"""Xsens' motion trackers played on a pseudo-terminal: one alone, or several behind a master, each on a segment of a motion.

The bytes are those of `sources.mt_protocol`; real trackers have not been at hand. What can go wrong can be asked for: packets
that are lost or damaged, a tracker that stops, a line that is silent.
"""

from __future__ import annotations

import os
import select
import struct
import tty
from contextlib import suppress
from typing import Annotated, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cabinpose.core import MVN_SEGMENTS
from cabinpose.record.emulate.base import Emulator
from cabinpose.record.emulate.mvn_motion import SuitMotion
from cabinpose.record.emulate.mvn_streamer import NORTH
from cabinpose.record.sources import mt_protocol as mt
from cabinpose.record.sources.mt_protocol import XbusMessage, XbusSplitter
from cabinpose.record.sources.mvn_messages import GRAVITY, rotate_wxyz
from cabinpose.signals import HostClock

Probability = Annotated[float, Field(ge=0, le=1)]
_LOOK_S = 0.002
_MASTER_ID = "00200001"
_UNREAD = 1 << 16  # bytes that wait for a reader, as in a driver; what comes then is lost
_READY = 3  # status: self-test passed, filter valid


class MtEmulatorSettings(BaseModel):
    """Which trackers are played, and what goes wrong."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    devices: Annotated[tuple[str, ...], Field(min_length=1, max_length=32)] = ("03880C2A",)
    """Device ids, 8 hexadecimal digits each; several are behind a master."""
    segments: tuple[str, ...] = ("Head",)
    """The segment that each is strapped to; the last for all that follow."""
    greatest_rate_hz: Annotated[int, Field(ge=1)] = 2000
    """Samples a second that a tracker has at most; more is refused down to it."""
    start_counter: Annotated[int, Field(ge=0, lt=mt.COUNTER_VALUES)] = 0
    """Packet counter at the start; it wraps after 16 bits."""
    clock_drift_ppm: Annotated[float, Field(gt=-1e6)] = 0.0
    """How much faster than true time the trackers' clock runs, millionths."""
    loss: Probability = 0.0
    """Share of packets that never arrive."""
    damage: Probability = 0.0
    """Share of packets with a wrong byte."""
    stop_after_s: Annotated[float | None, Field(gt=0)] = None
    """The last tracker stops after so many seconds."""
    mute: bool = False
    """Nothing answers."""
    seed: int = 0
    """Seed of what is lost and damaged."""

    @model_validator(mode="after")
    def _known(self) -> Self:
        if unknown := [name for name in self.segments if name not in MVN_SEGMENTS] or not self.segments:
            raise ValueError(f"no segments of MVN: {unknown}; such as Head, RightHand")
        if any(len(device) != 8 or not set(device.upper()) <= set("0123456789ABCDEF") for device in self.devices):
            raise ValueError("a device id has 8 hexadecimal digits")
        return self


class MtEmulator(Emulator):
    """Answers and measures on `port` between `start` and `stop`; `sent`, `lost`, `damaged` count packets."""

    def __init__(self, settings: MtEmulatorSettings, motion: SuitMotion, clock: HostClock | None = None) -> None:
        super().__init__(clock)
        self.settings, self.motion = settings, motion
        self.sent = self.lost = self.damaged = 0
        self._rng = np.random.Generator(np.random.Philox(key=(settings.seed, 0)))
        self._rate_hz = {self._bus(k): 100 for k in range(len(settings.devices))}

    def open(self) -> None:
        """Take a pseudo-terminal."""
        self._device, self._client = os.openpty()
        os.set_blocking(self._device, False)
        tty.setraw(self._client)
        self._unread = bytearray()
        self.port = os.ttyname(self._client)

    def stop(self) -> None:
        super().stop()
        os.close(self._device)
        os.close(self._client)

    def reading(self, tracker: int, number: int) -> bytes:
        """The data of sample `number` of a tracker, from 0: what is true of its segment, in its own frame."""
        settings = self.settings
        time_s = number / self._rate_hz[self._bus(tracker)]
        frame = self.motion.frame(time_s)
        segment = [MVN_SEGMENTS.index(settings.segments[min(tracker, len(settings.segments) - 1)])]
        turned = self.motion.orientation_wxyz[frame][segment]
        ticks = round(time_s * (1 + settings.clock_drift_ppm * 1e-6) * 1e9 / mt.TICK_NS) % (1 << 32)
        counter = (settings.start_counter + number) % mt.COUNTER_VALUES
        in_world = {
            mt.ACCELERATION: self.motion.acceleration[frame][segment] + GRAVITY,
            mt.TURN_RATE: self.motion.angular_velocity[frame][segment],
            mt.MAGNETIC_FIELD: NORTH[None],
        }
        parts = [(mt.PACKET_COUNTER, struct.pack(">H", counter)), (mt.TIME_FINE, struct.pack(">I", ticks))]
        parts += [(mt.QUATERNION, turned.astype(">f4").tobytes())]
        parts += [(kind, rotate_wxyz(turned, v, inverse=True).astype(">f4").tobytes()) for kind, v in in_world.items()]
        parts += [(mt.STATUS, struct.pack(">I", _READY))]
        return b"".join(struct.pack(">HB", kind, len(data)) + data for kind, data in parts)

    def _bus(self, tracker: int) -> int:
        return mt.MASTER if len(self.settings.devices) == 1 else tracker + 1

    def _run(self) -> None:
        splitter, measures, began, numbers = XbusSplitter(), False, 0.0, [0] * len(self.settings.devices)
        while not self._stopping.is_set():
            if select.select([self._device], [], [], _LOOK_S)[0]:
                for message in splitter.feed(os.read(self._device, 4096)):
                    if message.kind == mt.TO_MEASUREMENT and not measures:  # asked again, it measures on
                        measures, began = True, self._clock.now_s()
                        numbers = [0] * len(numbers)
                    elif message.kind == mt.TO_CONFIG:
                        measures = False
                        self._unread.clear()
                    if not self.settings.mute:
                        self._write(mt.encode(self._answer(message)))
            self._write(b"")
            if measures:
                now_s = self._clock.now_s() - began
                due = True
                while due:  # in turn, as trackers that measure at once share the line
                    due = sum(self._measure(tracker, numbers, now_s) for tracker in range(len(numbers))) > 0

    def _measure(self, tracker: int, numbers: list[int], now_s: float) -> bool:
        """Send the next sample of a tracker, if it is due; whether it was."""
        settings, bus = self.settings, self._bus(tracker)
        stops = settings.stop_after_s if tracker == len(numbers) - 1 else None
        if stops is not None:
            now_s = min(now_s, stops)
        if numbers[tracker] / self._rate_hz[bus] > now_s:
            return False
        data = bytearray(mt.encode(XbusMessage(bus, mt.DATA, self.reading(tracker, numbers[tracker]))))
        numbers[tracker] += 1
        lost, damaged = self._rng.random(2) < (settings.loss, settings.damage)
        damaged &= not lost
        if damaged:
            data[len(data) // 2] ^= 0x55
        self.lost, self.damaged, self.sent = self.lost + int(lost), self.damaged + int(damaged), self.sent + int(not lost)
        if not lost:
            self._write(bytes(data))
        return True

    def _answer(self, question: XbusMessage) -> XbusMessage:
        devices = self.settings.devices
        several = len(devices) > 1
        if question.kind == mt.REQUEST_ID:
            data = bytes.fromhex(_MASTER_ID if several else devices[0])
        elif question.kind == mt.INIT_BUS and several:
            data = bytes.fromhex("".join(devices))
        elif question.kind == mt.OUTPUTS and question.bus in self._rate_hz:
            rows = [struct.unpack_from(">HH", question.data, k) for k in range(0, len(question.data), 4)]
            kept = [(kind, rate if rate == mt.EACH_SAMPLE else min(rate, self.settings.greatest_rate_hz)) for kind, rate in rows]
            self._rate_hz[question.bus] = dict(kept)[mt.QUATERNION]
            data = b"".join(struct.pack(">HH", *row) for row in kept)
        elif question.kind in (mt.TO_MEASUREMENT, mt.TO_CONFIG):
            data = b""
        else:
            return XbusMessage(question.bus, mt.ERROR, b"\x04")
        return XbusMessage(question.bus, question.kind + 1, data)

    def _write(self, data: bytes) -> None:
        """Send what waits and this, as far as the line takes it."""
        if len(self._unread) + len(data) <= _UNREAD:
            self._unread += data
        with suppress(BlockingIOError):
            while self._unread:
                del self._unread[: os.write(self._device, self._unread)]
