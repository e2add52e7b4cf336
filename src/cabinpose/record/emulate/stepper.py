"""A controller of a stepper motor played on a pseudo-terminal: GRBL or Marlin, with the play of a gear, lost steps and failures.

`true_deg` is what the shaft does, which no controller knows: what an evaluation finds can be held against it.
"""

from __future__ import annotations

import os
import re
import select
import threading
import time
import tty
from types import TracebackType
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field

_LOOK_S = 0.005
_WORD = re.compile(r"([A-Z])(-?\d+(?:\.\d+)?)")


class StepperEmulatorSettings(BaseModel):
    """What is played."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    dialect: Literal["grbl", "marlin"] = "grbl"
    """What it speaks."""
    axis: Literal["X", "Y", "Z"] = "X"
    """Which axis turns the shaft."""
    backlash_deg: float = Field(0.0, ge=0)
    """Degrees by which the shaft stays behind where the motor turns back."""
    miss_every: int = Field(0, ge=0)
    """Every so many moves the motor misses steps; 0: never."""
    miss_deg: float = 0.9
    """Degrees that it misses then."""
    fault: Literal["none", "error", "alarm", "hang", "drop", "garbage"] = "none"
    """What goes wrong: a refusal, an alarm, silence, the line, or what comes over it."""
    fault_at: int = Field(1, ge=0)
    """At which move, counted from 1; 0: from the start."""


class StepperEmulator:
    """Answers on `port` while it is entered. The shaft has turned by `true_deg`; `moves` counts what it was sent.

    Play b (backlash): forwards the shaft is where the motor is; backwards it stays until the motor has turned by b. Every
    `miss_every`-th move ends `miss_deg` short of what the controller believes. fault: what happens at the move `fault_at`,
    counted from 1; 0: from the start.
    """

    def __init__(self, settings: StepperEmulatorSettings) -> None:
        self.settings = settings
        self.moves = self.stops = 0
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._from = self._to = self._offset = self._missed = self._missing = self._shaft = 0.0
        self._began = self._lasts = 0.0
        self._waiting = False  # for the end of a move, to answer M400
        self._line = b""

    def __enter__(self) -> Self:
        self._controller, self._client = os.openpty()
        tty.setraw(self._client)
        self.port = os.ttyname(self._client)
        self._thread = threading.Thread(target=self._serve, name="stepper-emulator", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._end.set()
        self._thread.join()
        os.close(self._client)

    @property
    def true_deg(self) -> float:
        """How far the shaft has turned, degrees."""
        with self._lock:
            self._follow()
            return self._shaft

    def _share(self) -> float:
        """How much of the move is done, from 0 to 1."""
        return min((time.monotonic() - self._began) / self._lasts, 1.0) if self._lasts else 1.0

    def _angle(self) -> float:
        """Where the controller believes the motor to be."""
        return self._from + self._share() * (self._to - self._from)

    def _follow(self) -> None:
        motor = self._angle() - self._missed - self._share() * self._missing
        self._shaft = min(max(self._shaft, motor), motor + self.settings.backlash_deg)

    def _move(self, end: float, speed_deg_s: float) -> None:
        with self._lock:
            self._follow()
            self._missed, self._missing = self._missed + self._share() * self._missing, 0.0
            self._from, self._to, self._began = self._angle(), end, time.monotonic()
            self._lasts = abs(self._to - self._from) / speed_deg_s
            if self._lasts:
                self.moves += 1
                if self.settings.miss_every and self.moves % self.settings.miss_every == 0:
                    self._missing = self.settings.miss_deg if self._to > self._from else -self.settings.miss_deg

    def _stop(self) -> None:
        self.stops += 1
        with self._lock:
            self._follow()
            self._missed, self._missing = self._missed + self._share() * self._missing, 0.0
            self._from = self._to = self._angle()
            self._lasts = 0.0

    def _serve(self) -> None:
        settings = self.settings
        self._tell("Grbl 1.1h ['$' for help]" if settings.dialect == "grbl" else "start")
        while not self._end.wait(0):
            if self._broken("drop"):
                break
            ready = select.select([self._controller], [], [], _LOOK_S)[0]
            with self._lock:
                self._follow()
            if self._waiting and self._share() == 1.0:
                self._waiting = False
                self._tell("ok")
            for byte in os.read(self._controller, 4096) if ready else b"":
                self._take(bytes([byte]))
        os.close(self._controller)

    def _broken(self, fault: str) -> bool:
        return self.settings.fault == fault and self.moves >= self.settings.fault_at

    def _take(self, byte: bytes) -> None:
        grbl = self.settings.dialect == "grbl"
        if grbl and byte == b"?":
            state = "Idle" if self._share() == 1.0 else "Run"
            places = ",".join(f"{self._angle() if axis == self.settings.axis else 0:.3f}" for axis in "XYZ")
            self._tell(f"<{state}|MPos:{places}|FS:0,0>")
        elif grbl and byte in b"!\x18":
            self._stop()
        elif byte == b"\n":
            line, self._line = self._line.decode("latin-1").strip(), b""
            self._obey(line)
        else:
            self._line += byte

    def _obey(self, line: str) -> None:
        words = dict(_WORD.findall(line))
        axis, settings = self.settings.axis, self.settings
        if line.startswith(("G0 ", "G1 ")):
            end = float(words[axis]) + self._offset if axis in words else self._to
            self._move(end, float(words.get("F", 1800.0)) / 60)
            if settings.fault in ("error", "alarm") and self.moves == settings.fault_at:
                self._stop()
                return self._tell("error:9" if settings.fault == "error" else "ALARM:1")
        elif line.startswith(("$H", "G28")):
            self._move(0.0, 1e6)
            self._missed = self._missing = self._offset = 0.0
        elif line.startswith("G92"):
            self._offset = self._angle()
        elif line == "M114":
            believed = self._angle() - self._offset
            places = " ".join(f"{a}:{believed if a == axis else 0:.2f}" for a in "XYZ")
            self._tell(f"{places} E:0.00 Count X:0 Y:0 Z:0")
        elif line == "M400":
            self._waiting = True
            return None
        elif line == "M410":
            self._stop()
        return self._tell("ok")

    def _tell(self, line: str) -> None:
        if self._broken("garbage"):
            os.write(self._controller, bytes(0x80 | (ord(c) * 5 & 0x7F) for c in line))
        elif not self._broken("hang"):
            os.write(self._controller, f"{line}\r\n".encode())
