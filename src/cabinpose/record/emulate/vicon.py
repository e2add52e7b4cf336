"""A DataStream server that plays a motion, on loopback unless told otherwise, and keeps account of what it sent.

It greets, answers and numbers as the vendor's server does by the facts in `vicon_protocol`, so that the vendor's SDK client
should be satisfied too; that client is not at hand, and has not been tried.

What can go wrong with a real one can be asked for: latency, a clock that is off or drifts, occluded markers and segments, frames
that never come, a server that dies and returns with its count going on or beginning anew. The content of a frame follows from
the motion, the seed and its number alone: `frame` says what was in it.
"""

from __future__ import annotations

import json
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core.clock import HostClock
from cabinpose.core.errors import RecordingError
from cabinpose.record.emulate.vicon_content import OFFERED, ViconContent
from cabinpose.record.emulate.vicon_motion import Motion
from cabinpose.record.sources import vicon_protocol as vicon
from cabinpose.record.sources.vicon_protocol import Packet, PacketSplitter

_OUTBOX = 4 << 20  # bytes that may wait for a client; then it loses frames
_IDLE_S = 0.05
_FLUSH_S = 2.0


class Outage(NamedTuple):
    """The server is dead from `after_s` after its start, for `for_s`; `anew`: it then counts frames from the first again."""

    after_s: float
    for_s: float
    anew: bool = False


class ViconEmulatorSettings(BaseModel):
    """How the emulated server behaves."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = "127.0.0.1"
    """Address to listen on; loopback, unless others shall connect."""
    port: Annotated[int, Field(ge=0, le=65535)] = 0
    """Port to listen on; 0 takes a free one. The vendor's is 801, which most systems keep for the administrator."""
    rate_hz: Annotated[float | None, Field(gt=0, le=20_000)] = None
    """Frames a second; None: the motion's."""
    first_frame: Annotated[int, Field(ge=1, lt=vicon.FRAME_COUNTER)] = 1
    """Number of the first frame, as the SDK tells it: how far the server's frame clock was when we came."""
    drift_ppm: Annotated[float, Field(ge=-100_000, le=100_000)] = 0.0
    """By how much the server's clock runs fast, in millionths."""
    latency_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    """From a frame's capture to its sending, as the server reports it too."""
    drop: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of frames that are never sent."""
    occlude_markers: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of markers not seen, each frame anew."""
    occlude_segments: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of segments not solved, each frame anew."""
    up: Literal["z", "y"] = "z"
    """The server's vertical axis."""
    outages: tuple[Outage, ...] = ()
    """When it dies and returns."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of what is dropped and occluded."""


@dataclass(frozen=True, slots=True)
class Sent:
    """What became of a frame for one client: sent, dropped (on purpose), or refused (the client read too slowly).

    captured_ns, sent_ns: the emulator's `HostClock`.
    """

    client: int
    frame: int
    fate: Literal["sent", "dropped", "refused"]
    captured_ns: int
    sent_ns: int

    def line(self) -> str:
        """As a line of JSON."""
        return json.dumps(asdict(self))


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


class ViconEmulator:
    """One server, in a thread of its own between `start` and `stop`; a context manager."""

    def __init__(
        self,
        motion: Motion,
        settings: ViconEmulatorSettings | None = None,
        clock: HostClock | None = None,
        *,
        tell: Callable[[Sent], None] | None = None,
    ) -> None:
        """tell: called with each entry of `log` as it is made, from the thread that sends."""
        self.motion = motion
        self.settings = settings or ViconEmulatorSettings()
        self.rate_hz = self.settings.rate_hz or motion.rate_hz
        self.log: list[Sent] = []
        self._tell = tell or (lambda _: None)
        self.malformed = 0
        self._clock = clock or HostClock()
        self._content = ViconContent(
            motion,
            rate_hz=self.rate_hz,
            latency_s=self.settings.latency_s,
            drop=self.settings.drop,
            occlude_markers=self.settings.occlude_markers,
            occlude_segments=self.settings.occlude_segments,
            y_up=self.settings.up == "y",
            seed=self.settings.seed,
        )
        self._clients: dict[socket.socket, _Client] = {}
        self._accepted = 0
        self._selector = selectors.DefaultSelector()
        self._listener: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._dead = threading.Event()
        self._anew = False
        self._port = self.settings.port
        self._first, self._began = self.settings.first_frame, 0.0
        self._newest: tuple[int, int] | None = None  # number and capture of the newest frame

    # ------------------------------------------------------------------------------------------------------- life

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens; the port stays the same when it dies and returns."""
        return (self.settings.host, self._port)

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._clients)

    def start(self) -> None:
        """Listen and count frames. Raises RecordingError where the address is taken or not ours."""
        self._listen()
        self._stopping.clear()
        self._thread = threading.Thread(target=self._run, name="vicon-emulator", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Send what was due, and close."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(timeout=2 * _FLUSH_S)
            self._thread = None

    def die(self) -> None:
        """Cut all connections, as a process does that is killed; frames are counted on."""
        self._dead.set()

    def revive(self, *, anew: bool = False) -> None:
        """Listen again, at the same port; `anew`: frames are numbered from the first."""
        self._anew = anew
        self._dead.clear()

    def __enter__(self) -> ViconEmulator:
        """Start."""
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop."""
        self.stop()

    def _listen(self) -> None:
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((self.settings.host, self._port))
            listener.listen(8)
            listener.setblocking(False)
        except OSError as error:
            listener.close()
            hint = "give another port or address, or 0 for a free port; ports below 1024 need rights"
            raise RecordingError(f"cannot listen on {self.settings.host}:{self._port}: {error}", hint=hint) from error
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
        started = self._began = time.monotonic()
        outages = sorted(self.settings.outages)
        back_at: tuple[float, bool] | None = None
        count = 0
        try:
            while not self._stopping.is_set():
                now = time.monotonic()
                if outages and now >= started + outages[0].after_s:
                    outage = outages.pop(0)
                    back_at = (started + outage.after_s + outage.for_s, outage.anew)
                    self.die()
                if back_at is not None and now >= back_at[0]:
                    self.revive(anew=back_at[1])
                    back_at = None
                count = self._live_or_die(count)
                wait = self._captured(count) + self.settings.latency_s - time.monotonic()
                if wait <= 0:
                    self._tick(count)
                    count += 1
                self._serve(min(_IDLE_S, max(0.0, wait)))
            self._flush()
        finally:
            self._cut()
            self._selector.close()

    def _live_or_die(self, count: int) -> int:
        """Follow `die` and `revive`; the count of frames, which may begin anew."""
        listening = self._listener is not None
        if self._dead.is_set() and listening:
            self._cut()
        if self._dead.is_set() or listening:
            return count
        try:
            self._listen()
        except RecordingError:  # the port is still held: the next turn tries again
            return count
        if not self._anew:
            return count
        self._began, self._anew, self._newest = time.monotonic(), False, None
        return 0

    def _captured(self, count: int) -> float:
        """The monotonic time at which the frame `count` is captured."""
        return self._began + count / (self.rate_hz * (1 + self.settings.drift_ppm * 1e-6))

    def _serve(self, wait_s: float) -> None:
        for key, events in self._selector.select(wait_s):
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
        number = (self._first + count) % vicon.FRAME_COUNTER
        captured_ns = self._clock.from_monotonic_ns(round(self._captured(count) * 1e9))
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
        limit = time.monotonic() + _FLUSH_S
        while any(client.outbox for client in self._clients.values()) and time.monotonic() < limit:
            self._serve(_IDLE_S)
        for client in list(self._clients.values()):
            if not client.outbox:  # an orderly end, after which the client has all
                self._close(client)

    def frame(self, number: int) -> Packet:
        """Everything that the frame `number` says, without statics: the truth that a recording is held against."""
        return self._content.frame(number)
