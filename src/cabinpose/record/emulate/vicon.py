"""A DataStream server that plays a motion, on loopback unless told otherwise, and logs what it sent.

It greets, answers and numbers as the vendor's server does by the facts in `vicon_protocol`, so that the vendor's SDK client
should be satisfied too; that client is not at hand, and has not been tried.

What can go wrong with a real one can be asked for: latency, a clock that is off or drifts, occluded markers and segments, frames
that never come, a server that dies and returns with its count going on or restarting. The content of a frame follows from
the motion, the seed and its number alone: `frame` says what was in it.
"""

from __future__ import annotations

import selectors
import socket
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from cabinpose.core import RecordingError
from cabinpose.record.emulate.base import Emulator
from cabinpose.record.emulate.vicon_content import OFFERED, ViconContent, ViconEmulatorSettings
from cabinpose.record.emulate.vicon_motion import MarkerMotion
from cabinpose.record.sources import vicon_protocol as vicon
from cabinpose.record.sources.vicon_protocol import Packet, PacketSplitter
from cabinpose.signals import HostClock

_OUTBOX = 4 << 20  # bytes that may wait for a client; then it loses frames
_IDLE_S = 0.05
_FLUSH_S = 2.0


class Sent(NamedTuple):
    """What became of a frame for one client: sent, dropped (on purpose), or refused (the client read too slowly).

    captured_ns, sent_ns: the emulator's `HostClock`.
    """

    client: int
    frame: int
    fate: Literal["sent", "dropped", "refused"]
    captured_ns: int
    sent_ns: int


@dataclass
class _Client:
    number: int
    connection: socket.socket
    splitter: PacketSplitter = field(default_factory=PacketSplitter)
    outbox: bytearray = field(default_factory=bytearray)
    wanted: frozenset[int] | None = None
    statics_due: bool = True
    streaming: bool = False
    asked: bool = False  # for the newest frame, if it has not had it
    next_frames: int = 0  # that it asked for and that are still to be captured
    last: int | None = None


class ViconEmulator(Emulator):
    """One server. tell: called with each entry of `log` as it is made, from the thread that sends."""

    def __init__(
        self,
        motion: MarkerMotion,
        settings: ViconEmulatorSettings | None = None,
        clock: HostClock | None = None,
        *,
        tell: Callable[[Sent], None] = lambda _: None,
    ) -> None:
        super().__init__(clock)
        self.settings = settings or ViconEmulatorSettings()
        self.rate_hz = self.settings.rate_hz or motion.rate_hz
        self.log: list[Sent] = []
        self.malformed = 0
        self._tell = tell
        self._content = ViconContent(motion, self.settings)
        self._clients: dict[socket.socket, _Client] = {}
        self._accepted = 0
        self._selector = selectors.DefaultSelector()
        self._listener: socket.socket | None = None
        self._dead = threading.Event()
        self._anew = False
        self._port = self.settings.port
        self._began = 0.0
        self._newest: tuple[int, int] | None = None  # number and capture of the newest frame

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens; the port stays the same when it dies and returns."""
        return (self.settings.host, self._port)

    def die(self) -> None:
        """Cut all connections, as a process does that is killed; frames are counted on."""
        self._dead.set()

    def revive(self, *, anew: bool = False) -> None:
        """Listen again, at the same port; `anew`: frames are numbered from the first."""
        self._anew = anew
        self._dead.clear()

    def open(self) -> None:
        """Listen. Raises RecordingError where the address is taken or not ours."""
        try:
            listener = socket.create_server((self.settings.host, self._port), backlog=8)
        except OSError as error:
            hint = "give another port or address, or 0 for a free port; ports below 1024 need rights"
            raise RecordingError(f"cannot listen on {self.settings.host}:{self._port}: {error}", hint=hint) from error
        listener.setblocking(False)
        self._listener, self._port = listener, listener.getsockname()[1]
        self._selector.register(listener, selectors.EVENT_READ)

    def _cut(self) -> None:
        """Close the listener and every connection at once: what waits in either is lost."""
        for client in list(self._clients.values()):
            client.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self._close(client)
        if self._listener is not None:
            self._selector.unregister(self._listener)
            self._listener.close()
            self._listener = None

    # ------------------------------------------------------------------------------------------------------- loop

    def _run(self) -> None:
        started = self._began = self._clock.now_s()
        outages = sorted(self.settings.outages)
        back_at: tuple[float, bool] | None = None
        count = 0
        try:
            while not self._stopping.is_set():
                now = self._clock.now_s()
                if outages and now >= started + outages[0].after_s:
                    outage = outages.pop(0)
                    back_at = (started + outage.after_s + outage.for_s, outage.anew)
                    self.die()
                if back_at is not None and now >= back_at[0]:
                    self.revive(anew=back_at[1])
                    back_at = None
                count = self._live_or_die(count)
                wait = self._captured(count) + self.settings.latency_s - self._clock.now_s()
                if wait <= 0:
                    self._tick(count)
                    count += 1
                self._serve(min(_IDLE_S, max(0.0, wait)))
            self._flush()
        finally:
            self._cut()
            self._selector.close()

    def _live_or_die(self, count: int) -> int:
        """Follow `die` and `revive`; the count of frames, which may restart."""
        listening = self._listener is not None
        if self._dead.is_set() and listening:
            self._cut()
        if self._dead.is_set() or listening:
            return count
        try:
            self.open()
        except RecordingError:  # the port is still held: the next turn tries again
            return count
        if not self._anew:
            return count
        self._began, self._anew, self._newest = self._clock.now_s(), False, None
        return 0

    def _captured(self, count: int) -> float:
        """The time at which the frame `count` is captured, s."""
        return self._began + count / (self.rate_hz * (1 + self.settings.drift_ppm * 1e-6))

    def _serve(self, wait_s: float) -> None:
        for key, events in self._clock.select(self._selector, wait_s):
            if key.fileobj is self._listener:
                self._accept()
                continue
            client = self._clients.get(key.fileobj)  # type: ignore[call-overload]
            if client is None:
                continue
            if events & selectors.EVENT_READ:
                self._hear(client)
            if events & selectors.EVENT_WRITE:
                self._write(client)

    def _accept(self) -> None:
        assert self._listener is not None
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = self._clients[connection] = _Client(self._accepted, connection)
        self._accepted += 1
        self._selector.register(connection, selectors.EVENT_READ)
        self._post(client, Packet(enums=OFFERED))

    def _close(self, client: _Client) -> None:
        if self._clients.pop(client.connection, None) is not None:
            self._selector.unregister(client.connection)
            client.connection.close()

    def _hear(self, client: _Client) -> None:
        try:
            data = client.connection.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._close(client)
            return
        malformed = client.splitter.malformed
        for raw in client.splitter.feed(data):
            packet = vicon.decode(vicon.payload(raw))
            self.malformed += packet.faults
            if packet.enums is not None:
                client.wanted, client.statics_due = packet.enums, True
            if packet.ping is not None:
                self._post(client, Packet(ping=packet.ping))
            if packet.streaming is not None:
                client.streaming, client.asked = packet.streaming, not packet.streaming
            if packet.next_frames is not None:
                client.next_frames += packet.next_frames
            if client.asked and self._newest is not None and self._newest[0] != client.last:
                self._give(client, *self._newest)
        self.malformed += client.splitter.malformed - malformed

    def _tick(self, count: int) -> None:
        """The frame `count` is due: give it to those who want it."""
        number = (self.settings.first_frame + count) % vicon.FRAME_COUNTER
        captured_ns = round(self._captured(count) * 1e9)
        if self._content.dropped(number):
            now_ns = self._clock.now_ns()
            streaming = [each.number for each in self._clients.values() if each.streaming and each.wanted is not None]
            for addressee in streaming:
                self._note(Sent(addressee, number, "dropped", captured_ns, now_ns))
            return
        self._newest = (number, captured_ns)
        for client in list(self._clients.values()):
            if client.streaming or client.asked or client.next_frames:
                self._give(client, number, captured_ns)
                if client.last == number:
                    client.next_frames = max(client.next_frames - 1, 0)

    def _give(self, client: _Client, number: int, captured_ns: int) -> None:
        if client.wanted is None:  # asked before it said what for
            return
        refused = len(client.outbox) > _OUTBOX
        # Before it is sent: who has received a frame finds it in the log.
        self._note(Sent(client.number, number, "refused" if refused else "sent", captured_ns, self._clock.now_ns()))
        if refused:
            return
        packet = self._content.packet(number, client.wanted, statics=client.statics_due)
        client.asked, client.last, client.statics_due = False, number, False
        self._post(client, packet)

    def _note(self, sent: Sent) -> None:
        self.log.append(sent)
        self._tell(sent)

    def _post(self, client: _Client, packet: Packet) -> None:
        client.outbox += vicon.encode(packet)
        self._write(client)

    def _write(self, client: _Client) -> None:
        try:
            sent = client.connection.send(client.outbox) if client.outbox else 0
        except BlockingIOError:
            sent = 0
        except OSError:
            self._close(client)
            return
        del client.outbox[:sent]
        if client.connection in self._clients:
            waiting = selectors.EVENT_WRITE if client.outbox else 0
            self._selector.modify(client.connection, selectors.EVENT_READ | waiting)

    def _flush(self) -> None:
        limit = self._clock.now_s() + _FLUSH_S
        while any(client.outbox for client in self._clients.values()) and self._clock.now_s() < limit:
            self._serve(_IDLE_S)
        for client in list(self._clients.values()):
            if not client.outbox:  # an orderly end, after which the client has all
                self._close(client)

    def frame(self, number: int) -> Packet:
        """Everything that the frame `number` says, without statics: the truth that a recording is held against."""
        return self._content.frame(number)
