"""Xsens MVN's network streamer as a source, over UDP or TCP.

In MVN: Options > Network Streamer, add this computer's address and the port, tick "Position + Orientation (Quaternion)" and
whatever else is wanted (tracker kinematics for the single sensors). Every datagram becomes one `Sample`, with its bytes; the
one that makes a sample whole carries the messages and the sequence.

What was lost is told in `counts` by the gaps in MVN's sample counter (`mvn_sequence`). The part of it that the kernel dropped,
because its buffer was full, is `kernel_drops`; the part of which some pieces came is `incomplete`.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import sys
import time
from collections.abc import Hashable, Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from cabinpose.core import RecordingError
from cabinpose.record.sources import mvn_protocol as mvn
from cabinpose.record.sources.base import DeviceSource, apart
from cabinpose.record.sources.mvn_messages import Decoder, PositionUnit
from cabinpose.record.sources.mvn_protocol import Header, MalformedError
from cabinpose.record.sources.mvn_sequence import SequenceTracker
from cabinpose.signals import LATEST_NS, HostClock, Sample, Unwrapper

_BATCH = 512  # datagrams of one read: what waits longer is read by the next
_DATAGRAM = 1 << 16
_STREAM_LIMIT = 1 << 18  # bytes of a stream that may wait for the rest of a datagram
_CLOCK_BACK_MS = 1000  # a device clock that falls by more has restarted
_CLOCKS = 1024  # of characters of senders, more than a rig has
_RETRY_S = 0.5
_LINUX = sys.platform.startswith("linux")
# asm-generic/socket.h; the socket module does not name them
_SO_TIMESTAMPNS, _SO_RXQ_OVFL = 35, 40
_TIMESPEC, _DROPS = struct.Struct("@qq"), struct.Struct("@I")
_ANCILLARY = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_DROPS.size) if _LINUX else 0
_OLDEST_STAMP_NS = 10_000_000_000  # an older arrival stamp of the kernel is not believed


class MvnSettings(BaseModel):
    """Where MVN streams to, and what its numbers mean."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    host: str = "127.0.0.1"
    """Address of this computer to listen on (`connect`: of the other one); 0.0.0.0 listens to the whole network."""
    port: Annotated[int, Field(ge=0, le=65535)] = mvn.DEFAULT_PORT
    """Port; 0 takes a free one."""
    transport: Literal["udp", "tcp", "connect"] = "udp"
    """udp, or tcp with MVN connecting to us, or tcp with us connecting to MVN."""
    position_unit: PositionUnit = "auto"
    """Unit of positions of types 02, 05, 21 and 24: m, cm, or told by the size of the body."""
    counter_step: Annotated[float | None, Field(ge=1)] = None
    """Rise of the sample counter from one sample sent to the next: capture rate / streaming rate. None finds it out."""
    reorder_window_s: Annotated[float, Field(gt=0, le=LATEST_NS / 1e9)] = 1.0
    """How long a late datagram or a missing piece of one is waited for; what is later looks like a new start of the device."""
    receive_buffer: Annotated[int, Field(ge=4096, le=1 << 30)] = 1 << 22
    """Bytes of the kernel's buffer: 4 MiB hold about a minute of one person at 60 Hz."""
    subjects: Annotated[dict[Annotated[int, Field(ge=0, le=255)], str], AfterValidator(apart)] = {}
    """Subject codes of characters by their ids; the others are character0, character1, and so on."""


class MvnSource(DeviceSource[MvnSettings]):
    """A `signals.FrameSource` that listens to MVN.

    `counts`: samples received and lost, datagrams reordered, duplicate and malformed.
    """

    Settings: ClassVar = MvnSettings

    def __init__(self, name: str, settings: MvnSettings | None = None, clock: HostClock | None = None) -> None:
        super().__init__(name, settings, clock)
        self._tracker = SequenceTracker(self.counts, step=self.settings.counter_step, window_s=self.settings.reorder_window_s)
        self._decoder = Decoder(position_unit=self.settings.position_unit, subjects=self.settings.subjects)
        self._clocks: dict[tuple[Hashable, int], Unwrapper] = {}
        self._socket: socket.socket | None = None  # UDP, or what listens for TCP
        self._stream: socket.socket | None = None  # the connection of TCP
        self._waiting = b""
        self._connected_before = False
        self._buffer = memoryview(bytearray(_DATAGRAM))
        self._drops_seen = 0
        self.kernel_drops = 0
        self.buffer_granted = 0

    @property
    def incomplete(self) -> int:
        """Samples among the lost of which some pieces came."""
        return self._tracker.incomplete

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens, or connects to."""
        if self._socket is None:
            return (self.settings.host, self.settings.port)
        host, port = self._socket.getsockname()[:2]
        return (host, port)

    def _missing(self) -> Sequence[str]:
        return self._listened(1.0)

    def _complaints(self) -> list[str]:
        settings, where = self.settings, f"{self.settings.host}:{self.settings.port}"
        complaints = []
        if self.buffer_granted < (asked := settings.receive_buffer):
            remedy = f"raise its limit (Linux: sysctl -w net.core.rmem_max={asked})"
            complaints.append(f"{self.name}: the system grants {self.buffer_granted} of {asked} bytes of buffer; {remedy}")
        if not self.counts.received + self.counts.malformed:
            if settings.transport == "connect":
                complaints.append(f"{self.name}: {where} says nothing; start the streamer in MVN")
            else:
                complaints.append(
                    f"{self.name}: nothing arrives on {where}; in MVN, Options > Network Streamer, add this computer's address "
                    f"and port ({settings.transport.upper()}), and listen on an address that MVN can reach"
                )
        return complaints

    def _connect(self) -> None:
        """Listen, or connect. Raises RecordingError where the address is taken, not ours, or refuses."""
        doing, hint = "connect to", "start MVN's streamer, or check its address"
        if self.settings.transport != "connect":
            doing = "listen on"
            hint = "another program may use the port (MVN's own network monitor does), or the address is not this computer's"
        try:
            if self.settings.transport == "connect":
                self._dial(3.0)
            else:
                self._listen()
        except OSError as error:
            self._disconnect()
            where = f"{self.settings.host}:{self.settings.port}"
            raise RecordingError(f"cannot {doing} {where} ({error.strerror or error})", hint=hint) from error

    def _listen(self) -> None:
        family = socket.AF_INET6 if ":" in self.settings.host else socket.AF_INET
        stream = self.settings.transport == "tcp"
        self._socket = socket.socket(family, socket.SOCK_STREAM if stream else socket.SOCK_DGRAM)
        if stream:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._tune(self._socket)
        self._socket.bind((self.settings.host, self.settings.port))
        if stream:
            self._socket.listen(1)
        self._socket.setblocking(False)

    def _disconnect(self) -> None:
        """Stop listening; samples that lack pieces are lost now."""
        self._drop_stream()
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        self._tracker.settle()

    def _read(self, timeout_s: float) -> Sequence[Sample]:
        with np.errstate(invalid="ignore", over="ignore"):  # a sender's infinities and NaN need no warning
            return self._read_datagrams(timeout_s) if self.settings.transport == "udp" else self._read_stream(timeout_s)

    # ---------------------------------------------------------------------------------------------------------- UDP
    def _read_datagrams(self, timeout_s: float) -> list[Sample]:
        assert self._socket is not None
        if not self._clock.readable(self._socket, timeout_s):
            return []
        samples = []
        for _ in range(_BATCH):
            try:
                size, ancillary, _, sender = self._socket.recvmsg_into([self._buffer], _ANCILLARY)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # an ICMP error of a socket that only listens says nothing
                continue
            host_ns = self._clock.now_ns()
            if ancillary:
                host_ns -= self._kernel_notes(ancillary)
            samples.append(self.take(bytes(self._buffer[:size]), host_ns, sender))
        return samples

    def _kernel_notes(self, ancillary: Sequence[tuple[int, int, bytes]]) -> int:
        """How long ago the kernel took the datagram, ns; counts those that it dropped."""
        age_ns = 0
        for level, kind, data in ancillary:
            if level != socket.SOL_SOCKET:
                continue
            if kind == _SO_TIMESTAMPNS and len(data) >= _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack_from(data)  # of the system's clock, whatever clock we were given
                age_ns = time.time_ns() - seconds * 1_000_000_000 - nanoseconds
            elif kind == _SO_RXQ_OVFL and len(data) >= _DROPS.size:
                (drops,) = _DROPS.unpack_from(data)
                self.kernel_drops += (drops - self._drops_seen) % (1 << 32)
                self._drops_seen = drops
        return age_ns if 0 <= age_ns <= _OLDEST_STAMP_NS else 0  # the system's time was set meanwhile

    # ---------------------------------------------------------------------------------------------------------- TCP
    def _read_stream(self, timeout_s: float) -> list[Sample]:
        until = self._clock.now_s() + timeout_s
        if self._stream is None and not self._reach(until):
            return []
        assert self._stream is not None
        if not self._clock.readable(self._stream, until - self._clock.now_s()):
            return []
        try:
            data = self._stream.recv(_DATAGRAM)
        except (BlockingIOError, InterruptedError):
            return []
        except OSError:
            data = b""
        if not data:
            self._drop_stream()
            return []
        host_ns = self._clock.now_ns()
        return [self.take(datagram, host_ns) for datagram in self._cut(data)]

    def _reach(self, until: float) -> bool:
        """Wait for MVN to connect, or connect to it, until then."""
        left = until - self._clock.now_s()
        try:
            if self._socket is not None:
                if not self._clock.readable(self._socket, left):
                    return False
                self._stream, _ = self._socket.accept()
                self._greet(self._stream)
            elif self._attempt(_RETRY_S):
                self._dial(max(0.05, left))
            else:
                self._clock.sleep(min(left, _RETRY_S))
                return False
        except OSError:
            return False
        return True

    def _dial(self, timeout_s: float) -> None:
        self._stream = socket.create_connection((self.settings.host, self.settings.port), timeout=timeout_s)
        self._tune(self._stream)
        self._greet(self._stream)

    def _greet(self, stream: socket.socket) -> None:
        stream.setblocking(False)
        if self._connected_before:
            self._tracker.reconnected(self._clock.now_ns())
            self._restart()
        self._connected_before = True

    def _cut(self, data: bytes) -> list[bytes]:
        """The whole datagrams of the stream so far; bytes that are none are skipped up to the next magic."""
        waiting = self._waiting + data
        cut, at = [], 0
        while len(waiting) - at >= mvn.HEADER.size:
            try:
                length = mvn.stream_length(mvn.read_header(memoryview(waiting)[at:]))
            except MalformedError:
                length = None
            if length is None:
                following = waiting.find(mvn.MAGIC, at + 1)
                end = following if following >= 0 else len(waiting) - len(mvn.MAGIC) + 1
                cut.append(waiting[at:end])
                at = end
            elif len(waiting) - at < length:
                break
            else:
                cut.append(waiting[at : at + length])
                at += length
        self._waiting = waiting[at : at + _STREAM_LIMIT]
        return cut

    def _drop_stream(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None
        self._waiting = b""

    # ---------------------------------------------------------------------------------------------------- datagrams
    def take(self, data: bytes, host_ns: int, sender: Hashable = None) -> Sample:
        """What one datagram that arrived at `host_ns` is; malformed ones and duplicates carry no messages.

        sender: its address, where several may send (UDP); each counts by itself.
        """
        try:
            header, payload = mvn.read_datagram(data)
            if header.kind not in mvn.COUNTED:
                return Sample(None, host_ns, self._device_ns(header, host_ns, sender), data, self._decoder(header, payload))
            arrival = self._tracker.arrive(header, payload, hash(data), host_ns, sender)
            if arrival.restarted:
                self._restart()
            device_ns = self._device_ns(header, host_ns, sender)
            if arrival.payload is None:
                return Sample(None, host_ns, device_ns, data)
            if header.items != arrival.items:
                header = header._replace(items=arrival.items)
            return Sample(arrival.sequence, host_ns, device_ns, data, self._decoder(header, arrival.payload))
        except MalformedError:
            self.counts.malformed += 1
            return Sample(None, host_ns, None, data)

    def _restart(self) -> None:
        self._clocks.clear()
        self._decoder.restart()

    def _device_ns(self, header: Header, host_ns: int, sender: Hashable) -> int:
        """The sender's time of a sample; a new recording in MVN starts it again, which is a new beginning."""
        clock = self._clocks.get((sender, header.character))
        if clock is None:
            if len(self._clocks) >= _CLOCKS:
                self._clocks.clear()
            clock = self._clocks[sender, header.character] = Unwrapper(1 << 32)
        elif clock.last is not None and _CLOCK_BACK_MS < (clock.last - header.time_ms) % (1 << 32) < 1 << 31:
            clock.restart()
            self._tracker.restarted(host_ns)
        return clock(header.time_ms) * 1_000_000

    # ------------------------------------------------------------------------------------------------------- socket
    def _tune(self, sock: socket.socket) -> None:
        """Ask for the buffer, and for the kernel's own arrival stamps and drop counts where it gives them."""
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self.settings.receive_buffer)
        granted = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        self.buffer_granted = granted // 2 if _LINUX else granted  # Linux reports twice what was asked for, for its own needs
        if _LINUX and sock.type == socket.SOCK_DGRAM:
            self._drops_seen = 0
            for option in (_SO_TIMESTAMPNS, _SO_RXQ_OVFL):
                with contextlib.suppress(OSError):
                    sock.setsockopt(socket.SOL_SOCKET, option, 1)
