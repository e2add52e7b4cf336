"""MVN played: the real bytes of the network streamer from a motion, through a network that can be made as bad as one likes.

`mvn_streamer.Streamer` makes datagrams, `Network` loses, delays and doubles them, `MvnEmulator` sends them at their time; the
first two need no socket. What became of every datagram is told (`Sent`), so that a receiver's account can be proved.
"""

from __future__ import annotations

import contextlib
import socket
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cabinpose.core import RecordingError
from cabinpose.record.emulate.base import Emulator
from cabinpose.record.emulate.mvn_motion import SuitMotion
from cabinpose.record.emulate.mvn_streamer import Datagram, MvnEmulatorSettings, Streamer
from cabinpose.signals import HostClock

_TCP_TIMEOUT_S = 5.0


class Sent(NamedTuple):
    """One datagram that was sent, of `pieces` of its sample, and its fate: `copies` of it arrived (0 = lost), perhaps `late`.

    sampled_ns and sent_ns: host clock, when the sample was taken and when the datagram left · time_ms: what it says of its time.
    """

    kind: int
    character: int
    counter: int
    piece: int
    pieces: int
    time_ms: int
    sampled_ns: int
    sent_ns: int
    copies: int
    late: bool


@dataclass
class _Held:
    left: int  # datagrams that still overtake it
    datagram: Datagram
    copies: int


class Network:
    """Loses, doubles and delays datagrams; what it does depends on the seed and the order of what it is given alone."""

    def __init__(self, settings: MvnEmulatorSettings) -> None:
        self._settings = settings
        self._rng = np.random.Generator(np.random.Philox(key=(settings.seed, 0)))
        self._held: deque[_Held] = deque()

    def carry(self, datagram: Datagram) -> Iterator[tuple[Datagram, int, bool]]:
        """What arrives now, as (datagram, copies, late): this one, unless it is lost (0 copies) or late, and what waited."""
        settings = self._settings
        lost, twice, late = self._rng.random(3) < (settings.loss, settings.duplicate, settings.reorder)
        copies = 0 if lost else 2 if twice else 1
        if late and copies:
            self._held.append(_Held(settings.reorder_by + 1, datagram, copies))
        else:
            yield datagram, copies, False
        for held in self._held:
            held.left -= 1
        while self._held and self._held[0].left == 0:
            held = self._held.popleft()
            yield held.datagram, held.copies, True

    def rest(self, *, lost: bool = False) -> Iterator[tuple[Datagram, int, bool]]:
        """What is still under way: it arrives, or is lost where the network dies."""
        while self._held:
            held = self._held.popleft()
            yield held.datagram, 0 if lost else held.copies, True


class MvnEmulator(Emulator):
    """Sends a motion. `run` does so in this thread; `start` and `stop` in another.

    samples: how many are sent; None: until `stop` · log: called with every datagram in the order in which its fate is known,
    from the thread that sends.
    """

    def __init__(
        self,
        settings: MvnEmulatorSettings,
        motion: SuitMotion,
        *,
        samples: int | None = None,
        log: Callable[[Sent], None] = lambda _: None,
        clock: HostClock | None = None,
    ) -> None:
        super().__init__(clock)
        self.settings, self._most = settings, samples
        self._streamer, self._network = Streamer(settings, motion), Network(settings)
        self._log = log
        self._socket: socket.socket | None = None
        self._listener: socket.socket | None = None
        self.samples = 0

    @property
    def address(self) -> tuple[str, int]:
        """Where it sends to, or is reached."""
        if self._listener is not None:
            host, port = self._listener.getsockname()[:2]
            return (host, port)
        return (self.settings.host, self.settings.port)

    def open(self) -> None:
        """Make ready to send; `listen`: be reachable. Raises RecordingError."""
        settings = self.settings
        where = (settings.host, settings.port)
        try:
            if settings.transport == "udp":
                family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
                self._socket = socket.socket(family, socket.SOCK_DGRAM)
                self._socket.connect(where)
            elif settings.transport == "tcp":
                self._socket = socket.create_connection(where, timeout=_TCP_TIMEOUT_S)
            elif self._listener is None:
                self._listener = socket.create_server(where, backlog=1)
                self._listener.settimeout(0.1)
        except OSError as error:
            self.close()
            hint = "start the receiver first" if settings.transport == "tcp" else "check address and port"
            raise RecordingError(f"cannot stream to {where[0]}:{where[1]} ({error.strerror or error})", hint=hint) from error

    def close(self) -> None:
        """Close what `open` opened."""
        for each in (self._socket, self._listener):
            if each is not None:
                each.close()
        self._socket = self._listener = None

    def run(self) -> None:
        """Send all samples, or until `stop`; over tcp, a receiver that goes away raises RecordingError."""
        try:
            if self._accepted():
                self._send_all()
        finally:
            self.close()

    def _run(self) -> None:
        with contextlib.suppress(RecordingError):  # the receiver left; there is no caller to raise to
            self.run()

    def _accepted(self) -> bool:
        """Wait for a receiver to connect, where it has to."""
        while self._socket is None and not self._stopping.is_set():
            assert self._listener is not None
            with contextlib.suppress(TimeoutError):
                self._socket, _ = self._listener.accept()
                self._socket.settimeout(_TCP_TIMEOUT_S)
        return self._socket is not None

    def _send_all(self) -> None:
        period_ns = 1e9 / self.settings.rate_hz
        sampled_ns = began_ns = self._clock.now_ns()
        while (self._most is None or self.samples < self._most) and not self._stopping.is_set():
            sampled_ns = began_ns + round(self.samples * period_ns)
            wait_s = (sampled_ns - self._clock.now_ns()) / 1e9 + self.settings.latency_s
            if wait_s > 0 and self._clock.wait(self._stopping, wait_s):
                break
            for datagram in self._streamer.sample(self.samples):
                for each in self._network.carry(datagram):
                    self._send(*each, sampled_ns)
            self.samples += 1
        for each in self._network.rest():
            self._send(*each, sampled_ns)

    def _send(self, datagram: Datagram, copies: int, late: bool, sampled_ns: int) -> None:
        assert self._socket is not None
        sent_ns = self._clock.now_ns()
        for _ in range(copies):
            try:
                self._socket.sendall(datagram.data)
            except ConnectionRefusedError:  # udp on loopback, without a receiver
                continue
            except OSError as error:
                raise RecordingError(f"the receiver went away ({error.strerror or error})", hint="start it again") from error
        d = datagram
        self._log(Sent(d.kind, d.character, d.counter, d.piece, d.pieces, d.time_ms, sampled_ns, sent_ns, copies, late))
