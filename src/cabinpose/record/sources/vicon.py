"""Vicon (Nexus, Tracker, Shogun, Evoke) as a source: a client of its DataStream over TCP, in pure Python.

Time. `host_ns` is when the packet arrived. `device_ns` is the frames since the first, number 1, times the frame period: as
regular as the cameras, on the server's frame clock. Between capture and arrival lies what the server tells (cameras,
reconstruction, labelling: the channel `latency_s`) and the network (half of a ping's round trip, median of the last ones:
`network_s`, NaN without pings). Both come with every frame as `Channels`, so that nothing measured is overwritten: a frame was
captured at `host_ns − (latency_s + network_s)`. Alignment measures the delays between sources itself.

Loss. The server counts its frames: a gap in the numbers is what was lost, on the way, while the connection was away, or
since this computer read too slowly. In pull mode a frame that is never asked for is lost as well. A packet with a malformed
block counts as malformed, not as received; its frame, if it can still be read, is not lost. A counter that restarts is
a restart, as is a connection made again; a fact `restart` in the stream says which, and how much was lost.
"""

from __future__ import annotations

import contextlib
import math
import socket
import statistics
from collections import deque
from collections.abc import Callable, Sequence
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from cabinpose.core import RecordingError
from cabinpose.record.sources import vicon_protocol as vicon
from cabinpose.record.sources.base import DeviceSource, apart
from cabinpose.record.sources.vicon_messages import FrameAccount, PacketDecoder, latency
from cabinpose.record.sources.vicon_protocol import Packet, PacketSplitter, Type
from cabinpose.signals import Facts, HostClock, Message, Sample

_RETRY_S = 0.25
_PING_S = 1.0
_PINGS_KEPT = 16
_ASK_AGAIN_S = 1.0  # pull mode: an answer that does not come is asked for again
_SLICE_S = 0.1  # the longest wait before timers are looked at
_RECEIVE = 1 << 18
_THIS_COMPUTER = ("127.0.0.1", "localhost", "::1")
_BASE = frozenset(
    {
        Type.STREAM_INFO, Type.SUBJECT_INFO, Type.SUBJECT_TOPOLOGY, Type.APPLICATION_INFO, Type.FRAME_INFO, Type.LATENCY_INFO,
        Type.FRAME_RATE_INFO, Type.CONTENTS, Type.PING,
    }
)  # fmt: skip


class _Part(NamedTuple):
    """What a client may ask for: the setting, the type of block, how it is decoded, what users call it."""

    setting: str
    kind: Type
    decode: Callable[[PacketDecoder, Packet], list[Message]]
    name: str


_PARTS = (
    _Part("segments", Type.GLOBAL_SEGMENTS, PacketDecoder.poses, "segments"),
    _Part("labeled_markers", Type.LABELED_RECONS, PacketDecoder.labeled, "labelled markers"),
    _Part("unlabeled_markers", Type.UNLABELED_RECONS, PacketDecoder.unlabeled, "unlabelled markers"),
)


class ViconSettings(BaseModel):
    """Where the DataStream server is, and what it is asked for."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = "127.0.0.1"
    """Address of the computer that runs Vicon's software."""
    port: Annotated[int, Field(ge=1, le=65535)] = vicon.DEFAULT_PORT
    """Port of its DataStream."""
    mode: Literal["push", "pull"] = "push"
    """push: the server sends every frame. pull: each is asked for; for links too slow for all frames."""
    segments: bool = True
    """Segments of the subjects, in the world."""
    labeled_markers: bool = True
    """Markers of the subjects."""
    unlabeled_markers: bool = True
    """Markers without a label."""
    up: Literal["server", "z", "y"] = "server"
    """The server's vertical axis: what it says itself, or what is known better."""
    subjects: Annotated[dict[str, str], AfterValidator(apart)] = {}
    """Subject codes for the names of subjects in Vicon's software. The packets themselves, which are kept, hold the names."""
    connect_timeout_s: Annotated[float, Field(gt=0, le=60)] = 3.0
    """How long a connection and its greeting may take."""
    silence_s: Annotated[float, Field(ge=2, le=600)] = 5.0
    """A connection on which nothing came for so long, not even an answer to a ping, is taken for dead and made again."""


class ViconSource(DeviceSource[ViconSettings]):
    """A `signals.FrameSource` that asks a DataStream server.

    `counts` are of the server's frames; `duplicate`: answers in pull mode that were no new frame.
    """

    Settings: ClassVar = ViconSettings

    def __init__(self, name: str, settings: ViconSettings | None = None, clock: HostClock | None = None) -> None:
        super().__init__(name, settings, clock)
        self._parts = [part for part in _PARTS if getattr(self.settings, part.setting)]
        self._reset()

    def _reset(self) -> None:
        self._decoder = PacketDecoder(up=None if self.settings.up == "server" else self.settings.up, codes=self.settings.subjects)
        self._account = FrameAccount(self.counts)
        self._socket: socket.socket | None = None
        self._greeted = False  # the server speaks first
        self._splitter = PacketSplitter()
        self._failure = ""
        self._began = self._heard = self._retry_at = self._ping_at = self._ask_at = 0.0
        self._offered: frozenset[int] = frozenset()
        self._pings: dict[int, int] = {}
        self._ping = 0
        self._trips_s: deque[float] = deque(maxlen=_PINGS_KEPT)
        self._streamed_before = self._reconnected = False
        self._waiting: list[Sample] = []

    @property
    def network_s(self) -> float:
        """Half of a ping's round trip, median of the last ones; NaN before the first."""
        return statistics.median(self._trips_s) / 2 if self._trips_s else math.nan

    @property
    def _address(self) -> dict[str, str]:
        """Where the server is, by which it is known again; nothing of one on this computer."""
        host, port = self.settings.host, self.settings.port
        return {} if host in _THIS_COMPUTER else {"address": f"{host}:{port}"}

    def _missing(self) -> Sequence[str]:
        return self._listened(2.0)

    def _complaints(self) -> list[str]:
        where = f"{self.settings.host}:{self.settings.port}"
        if not self._greeted:
            return [f"no connection to {where}: {self._failure}"]
        if self.counts.received == 0:
            return [f"{where} sends no frames: in Vicon's software go live, or play a trial"]
        complaints = []
        if not self._decoder.subjects and (self.settings.segments or self.settings.labeled_markers):
            complaints.append(f"{where} tracks no subject: tick the subjects in Vicon's software")
        elif strange := [name for name in self.settings.subjects if name not in self._decoder.told]:
            known = ", ".join(self._decoder.told)
            complaints.append(
                f"{where} tracks no {', '.join(strange)} of `subjects`, and others keep their names; it has: {known}"
            )
        return complaints + [
            f"{where} has no {part.name}: do not ask for them, or enable them in Vicon's software"
            for part in self._parts
            if part.kind not in self._offered
        ]

    def _connect(self) -> None:
        """Connect, and wait for the greeting. Raises RecordingError where nobody answers, or not as a DataStream server."""
        self._reset()
        self._dial(self.settings.connect_timeout_s)
        while not self._greeted:
            if self._socket is None:
                raise RecordingError(
                    f"{self.name}: cannot connect to {self.settings.host}:{self.settings.port}: {self._failure}",
                    hint="start Vicon's software there, and check address and port (801 unless changed) and the firewall",
                )
            self._waiting += self._step(_SLICE_S)

    def _read(self, timeout_s: float) -> Sequence[Sample]:
        """Packets that have arrived: those of frames have a sequence, greetings, facts and pings have none."""
        samples, self._waiting = self._waiting, []
        until = self._clock.now_s() + timeout_s
        while not samples:
            left = until - self._clock.now_s()
            samples = self._step(max(left, 0.0))
            if left <= 0:
                break
        return samples

    def _disconnect(self) -> None:
        self._lose("closed")

    # ------------------------------------------------------------------------------------------------- connection

    def _step(self, wait_s: float) -> list[Sample]:
        """One wait for one event, of at most `wait_s` s, and what it brought."""
        now = self._clock.now_s()
        wait_s = min(wait_s, _SLICE_S)
        if self._socket is None:
            if now < self._retry_at:
                self._clock.sleep(min(wait_s, self._retry_at - now))
            else:
                self._dial(max(wait_s, _SLICE_S))
            return []
        if self._greeted and self.settings.mode == "pull":
            wait_s = min(wait_s, self._ask_at - now)
        samples = self._receive(self._socket) if self._clock.readable(self._socket, wait_s) else []
        self._timers()
        return samples

    def _dial(self, timeout_s: float) -> None:
        self._failure, self._splitter = "", PacketSplitter()
        self._began = self._heard = self._clock.now_s()
        try:
            self._socket = socket.create_connection((self.settings.host, self.settings.port), timeout_s)
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            if hasattr(socket, "TCP_KEEPIDLE"):  # else a pulled cable is noticed after two hours, where there are no pings
                for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL):
                    self._socket.setsockopt(socket.IPPROTO_TCP, option, max(1, int(self.settings.silence_s)))
        except TimeoutError:
            self._lose("no answer")
        except (OSError, UnicodeError) as error:
            self._lose(str(error))

    def _receive(self, connection: socket.socket) -> list[Sample]:
        try:
            data = connection.recv(_RECEIVE)
        except BlockingIOError:
            return []
        except OSError as error:
            self._lose(str(error))
            return []
        host_ns = self._clock.now_ns()
        if not data:
            self._lose("the server closed the connection")
            return []
        self._heard = self._clock.now_s()
        malformed = self._splitter.malformed
        packets = self._splitter.feed(data)
        self.counts.malformed += self._splitter.malformed - malformed
        return [self._sample(packet, host_ns) for packet in packets]

    def _timers(self) -> None:
        """What is due: pings, requests, the end of patience."""
        if self._socket is None:
            return
        now = self._clock.now_s()
        if not self._greeted:
            if now - self._began > self.settings.connect_timeout_s:
                self._lose("it does not greet as a DataStream server")
            return
        if Type.PING in self._offered:
            if now - self._heard > self.settings.silence_s:
                self._lose(f"silent for {self.settings.silence_s} s")
                return
            if now >= self._ping_at:
                self._ping_at = now + _PING_S
                self._ping += 1
                self._pings[self._ping] = self._clock.now_ns()
                self._pings.pop(self._ping - _PINGS_KEPT, None)
                self._send(Packet(ping=self._ping))
        if self.settings.mode == "pull" and now >= self._ask_at:
            self._ask_at = now + _ASK_AGAIN_S
            self._send(Packet(streaming=False))

    def _send(self, packet: Packet) -> None:
        if self._socket is None:
            return
        try:
            self._socket.sendall(vicon.encode(packet))
        except OSError as error:  # BlockingIOError too: the server reads nothing
            self._lose(str(error))

    def _lose(self, failure: str) -> None:
        """The connection is gone; what it had sent of a packet goes with it, and shows as a gap."""
        self._failure = failure
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
        self._socket, self._greeted = None, False
        self._retry_at = self._clock.now_s() + _RETRY_S
        self._pings.clear()

    # --------------------------------------------------------------------------------------------------- packets

    def _sample(self, raw: bytes, host_ns: int) -> Sample:
        packet = vicon.decode(vicon.payload(raw))
        messages: list[Message] = []
        if packet.enums is not None:
            self._answer(packet.enums)
            messages.append(Facts("server", {"types": sorted(packet.enums), **self._address}))
        sent_ns = self._pings.pop(packet.ping, None) if packet.ping is not None else None
        if sent_ns is not None:
            self._trips_s.append((self._clock.now_ns() - sent_ns) * 1e-9)
        messages += self._decoder.statics(packet)
        if packet.faults:
            self.counts.malformed += 1
        if packet.frame is None:
            return Sample(None, host_ns, None, raw, tuple(messages))
        arrival = self._account.arrive(packet.frame, host_ns, self._decoder.rate_hz)
        now = self._clock.now_s()
        if arrival.sequence is None:
            self._ask_at = now + 0.25 / (self._decoder.rate_hz or 100.0)
            return Sample(None, host_ns, None, raw, tuple(messages))
        self._ask_at = now
        if arrival.anew and not self._reconnected:
            self.counts.restarts += 1
        if arrival.anew or self._reconnected:
            numbers = "anew" if arrival.anew else "continued"
            restart = {"reconnected": self._reconnected, "numbers": numbers, "frame": arrival.frame, "lost": arrival.lost}
            messages.append(Facts("restart", restart))
            self._reconnected = False
        if not packet.faults:
            self.counts.received += 1
            messages += self._frame(packet)
        return Sample(arrival.sequence, host_ns, self._decoder.device_ns(arrival.frame), raw, tuple(messages))

    def _frame(self, packet: Packet) -> list[Message]:
        messages = [message for part in self._parts for message in part.decode(self._decoder, packet)]
        return messages + latency(packet, self.network_s)

    def _answer(self, offered: frozenset[int]) -> None:
        """The server greets, with what it has: ask for what we want of it."""
        self._offered = offered
        self._send(Packet(enums=offered & _BASE.union(part.kind for part in self._parts)))
        self._send(Packet(streaming=self.settings.mode == "push"))
        if self._greeted or self._socket is None:
            return
        self._greeted = True
        now = self._clock.now_s()
        self._heard, self._ping_at, self._ask_at = now, now, now + _ASK_AGAIN_S
        if self._streamed_before:
            self.counts.restarts += 1
            self._reconnected = True
        self._streamed_before = True
