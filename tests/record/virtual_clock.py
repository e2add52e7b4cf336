"""Time that passes only while everybody waits: tests of what takes seconds take milliseconds, and go the same way each time."""

from __future__ import annotations

import selectors
import socket
import threading
import time
from collections.abc import Callable

from cabinpose.signals.clock import HostClock

_LOOK_S = 0.001  # real time between looks at what others do without this clock: events that they set, bytes that they send
_NEW_S = 0.1  # real time in which a new thread may come to ask this clock for the first time


class VirtualClock(HostClock):
    """A `HostClock` that leaps to the next deadline once nobody has anything to do: its maker and all threads that use it wait.

    A thread that is busy, or blocked by something else than this clock, holds time up.
    """

    def __init__(self, start_ns: int = 1_700_000_000_000_000_000) -> None:
        self._time_ns = start_ns
        self._changed = threading.Condition()
        self._users = {threading.current_thread()}
        self._others = dict.fromkeys(threading.enumerate(), float("-inf"))  # when they were first seen
        self._waiting: dict[threading.Thread, tuple[float, Callable[[], bool]]] = {}

    def now_ns(self) -> int:
        with self._changed:
            self._users.add(threading.current_thread())
            return self._time_ns

    def sleep(self, seconds: float) -> None:
        self._until(lambda: False, seconds)

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        return self._until(event.is_set, timeout_s)

    def join(self, thread: threading.Thread, timeout_s: float) -> bool:
        return self._until(lambda: not thread.is_alive(), timeout_s)

    def readable(self, connection: socket.socket, timeout_s: float) -> bool:
        return self._until(lambda: HostClock.readable(self, connection, 0.0), timeout_s)

    def select(self, selector: selectors.BaseSelector, timeout_s: float) -> list[tuple[selectors.SelectorKey, int]]:
        self._until(lambda: bool(selector.select(0)), timeout_s)
        return selector.select(0)

    def _until(self, holds: Callable[[], bool], timeout_s: float) -> bool:
        me = threading.current_thread()
        with self._changed:
            self._users.add(me)
            deadline = self._time_ns + max(timeout_s, 0.0) * 1e9
            self._waiting[me] = deadline, holds
            while not holds() and self._time_ns < deadline:
                self._leap()
                if self._time_ns < deadline:
                    self._changed.wait(_LOOK_S)
            del self._waiting[me]
        return holds()

    def _leap(self) -> None:
        now = time.monotonic()
        for thread in threading.enumerate():
            self._others.setdefault(thread, now)
        new = any(
            thread not in self._users and now - since < _NEW_S for thread, since in self._others.items() if thread.is_alive()
        )
        busy = new or any(user.is_alive() and user not in self._waiting for user in self._users)
        if not busy and not any(holds() for _, holds in self._waiting.values()):
            following = min(deadline for deadline, _ in self._waiting.values())
            if following < float("inf"):
                self._time_ns = max(self._time_ns, int(-(-following // 1)))
                self._changed.notify_all()
