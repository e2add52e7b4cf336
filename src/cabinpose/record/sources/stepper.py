"""A stepper motor behind a controller that reads G-code (GRBL or Marlin), on a serial line: it turns a sensor in known steps.

The motor leads the take: it begins when all sources of the rig are open, and the take ends when it has made its last step or
fails. Only one move is under way at a time, so that a motor that nobody can reach any more ends at most one step further.

References
----------
GRBL 1.1, "Interface" and "Commands" (gnea/grbl, doc/markdown): `?`, `!` and Ctrl-X act at once, lines are answered by `ok`,
`error:N` or `ALARM:N`. Marlin, "G-code index": G28, G92, M92, M114, M400, M410. The protocol of steps is that of the thesis,
3.1.1.1 and 3.2.1: a full turn in steps of 11.25°, 5 s each.
"""

from __future__ import annotations

import re
from collections.abc import Generator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import ClassVar, Literal, Self, TypeAlias, TypeVar, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cabinpose.core import RecordingError, SourceEndedError
from cabinpose.record.sources.serial_line import SerialLine
from cabinpose.signals import MOTOR_CHANNELS, Channels, Counts, HostClock, Sample

AXES = "XYZABC"
_LOOK_S = 0.02  # for one look at the line
_BEAT_S = 0.1  # between two questions for the angle
_HOMING_S = 120.0
_SPARE_S = 5.0  # that a move may take beyond twice its length at full speed: ramps, and a controller that is slow to begin
_STRAY_DEG = 0.2  # between the angle asked for and the one reported; whole steps of the motor are finer
_ANGLE = r"-?\d+(?:\.\d+)?"
_GRBL = re.compile(rf"<(\w+)[^|]*\|[MW]Pos:({_ANGLE}(?:,{_ANGLE})*)")
_STOPS = {"grbl": (b"!", b"\x18"), "marlin": (b"M410\n",)}  # feed hold, then reset · quick stop
_FAILURES = ("error", "alarm", "!!")

T = TypeVar("T")
Steps: TypeAlias = Generator[Sample | None, None, None]  # None: still waiting


class StepperSettings(BaseModel):
    """Where the controller is, and how the motor turns."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: Path = Field(description="serial line of the controller, such as /dev/ttyUSB0")
    baud: int = Field(115200, gt=0, description="bits a second of the line")
    dialect: Literal["grbl", "marlin"] = Field("grbl", description="what the controller speaks")
    axis: Literal["X", "Y", "Z", "A", "B", "C"] = Field("X", description="axis that turns the sensor; its unit is the degree")
    steps_per_deg: float | None = Field(None, gt=0, description="set in the controller before it turns; left out: as it is set")
    home: bool = Field(False, description="look for the switch first; false: where the motor stands is 0")
    step_deg: float = Field(11.25, description="turn of a step, degrees; its sign is the direction")
    steps: int = Field(32, ge=1, le=10_000, description="steps from 0 on")
    back: bool = Field(False, description="make the same steps back as well, which shows the play of a gear")
    dwell_s: float = Field(5.0, gt=0, description="standstill that is sampled, s")
    settle_s: float = Field(0.5, ge=0, description="standstill before it, s")
    speed_deg_s: float = Field(30.0, gt=0, description="speed of a move, degrees a second")
    limits_deg: tuple[float, float] = Field((-400.0, 400.0), description="angles beyond which the motor is never sent")
    answer_s: float = Field(5.0, gt=0, description="how long the controller may take for an answer, s")

    @property
    def angles_deg(self) -> tuple[float, ...]:
        """The angle of each standstill."""
        there = tuple(i * self.step_deg for i in range(self.steps + 1))
        return there + there[-2::-1] if self.back else there

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        low, high = self.limits_deg
        if beyond := [angle for angle in self.angles_deg if not low <= angle <= high]:
            raise ValueError(f"{self.steps} steps of {self.step_deg:g}° lead to {beyond[0]:g}°, beyond limits_deg")
        return self


class StepperSource:
    """A `FrameSource` of `MOTOR_CHANNELS`: the angle that the controller reports, and the number of the standstill, else -1."""

    Settings: ClassVar = StepperSettings
    is_camera: ClassVar = False
    leads_take: ClassVar = True

    def __init__(self, name: str, settings: StepperSettings, clock: HostClock) -> None:
        self.name, self.settings, self._clock = name, settings, clock
        self.counts = Counts()
        hint = "the motor ends the step that it was at: look at it, then at the cable"
        self._line = SerialLine(settings.port, settings.baud, lost=("controller", hint))
        self._text = b""
        self._garbled = self._may_turn = False
        self._said = ""  # the last status
        self._run: Steps = self._protocol()

    def check(self) -> Sequence[str]:
        """Whether the controller answers; nothing turns."""
        try:
            self.open()
        except RecordingError as error:
            return [error.in_one_line()]
        finally:
            self.close()
        return []

    def open(self) -> None:
        """Open the line and wait for the controller, which opening may have reset. Nothing turns."""
        self._line.open()
        self._text, self._garbled, self._may_turn = b"", False, False
        until = self._clock.now_s() + self.settings.answer_s
        state = ""
        while not state:
            with suppress(_NoAnswerError):
                state, _ = _finish(self._ask(within_s=1.0, locked=self.settings.home))
            if not state and self._clock.now_s() > until:
                raise self._no_answer("a question for its state", self.settings.answer_s)
        _finish(self._listen(2 * _BEAT_S))  # answers to questions that were asked too early
        self._run = self._protocol()

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """The angle, several times a second, while the motor goes on. Raises SourceEndedError after the last step."""
        until = self._clock.now_s() + timeout_s
        while self._clock.now_s() < until:
            try:
                sample = next(self._run)
            except StopIteration:
                raise SourceEndedError(f"{self.name} has made its {self.settings.steps} steps") from None
            if sample is not None:
                self.counts.received += 1
                return [sample]
        return []

    def close(self) -> None:
        """Stop the motor, if it was sent anywhere, and close the line."""
        if not self._line.is_open:
            return
        with suppress(RecordingError):  # the line may be what failed
            for piece in _STOPS[self.settings.dialect] if self._may_turn else ():
                self._line.send(piece)
                self._clock.sleep(2 * _BEAT_S)  # GRBL slows down before the reset, so that it keeps its position
        self._line.close()
        self._may_turn = False

    def _protocol(self) -> Steps:
        settings, axis = self.settings, self.settings.axis
        yield self._sample(np.nan, -1)  # what the check before a take waits for: nothing has turned
        self._may_turn = True
        grbl = settings.dialect == "grbl"
        if settings.home:
            yield from self._command("$H" if grbl else f"G28 {axis}", _HOMING_S)
        if settings.steps_per_deg is not None:
            number = f"{settings.steps_per_deg:.4f}"
            yield from self._command(f"${100 + AXES.index(axis)}={number}" if grbl else f"M92 {axis}{number}")
        for line in ("G21", "G90", f"G92 {axis}0"):  # millimetres, that is degrees here; absolute; this is 0
            yield from self._command(line)
        (_, origin), at = (yield from self._ask()), 0.0
        for step, angle in enumerate(settings.angles_deg):
            yield from self._turn(origin, at, angle)
            at = angle
            until = self._clock.now_s() + settings.settle_s
            while self._clock.now_s() < until + settings.dwell_s:
                _, angle_deg = yield from self._ask()
                yield self._sample(angle_deg - origin, step if self._clock.now_s() > until else -1)
                yield from self._listen(_BEAT_S)
        yield from self._turn(origin, at, 0.0)  # so that a cable is not wound up by one run after another
        self._may_turn = False

    def _turn(self, origin: float, start: float, end: float) -> Steps:
        """One move, until the controller says that it is over and at its end."""
        settings = self.settings
        yield self._sample(start, -1)
        if end == start:
            return
        limit_s = 2 * abs(end - start) / settings.speed_deg_s + _SPARE_S
        yield from self._command(f"G1 {settings.axis}{end:.4f} F{60 * settings.speed_deg_s:.2f}")
        if settings.dialect == "marlin":
            yield from self._command("M400", limit_s)
        until = self._clock.now_s() + limit_s
        while True:
            yield from self._listen(_BEAT_S)
            state, angle_deg = yield from self._ask()
            yield self._sample(angle_deg - origin, -1)
            if state == "Idle" and abs(angle_deg - origin - end) < _STRAY_DEG:
                return
            if self._clock.now_s() > until:
                raise RecordingError(
                    f"{settings.port}: after {limit_s:.0f} s the motor is at {angle_deg - origin:.2f}°, not {end:.2f}° ({state})",
                    hint="look at the axis, its speed limit and its steps per degree in the controller",
                )

    def _ask(self, within_s: float | None = None, *, locked: bool = False) -> Generator[None, None, tuple[str, float]]:
        """The state and the angle, degrees. Raises RecordingError for a controller that is locked, unless it may be."""
        axis, within_s = self.settings.axis, within_s or self.settings.answer_s
        if self.settings.dialect == "grbl":
            lines = yield from self._answer(b"?", "<", within_s)
            place = _GRBL.match(lines[-1])
            state, angles = (place[1], place[2].split(",")[AXES.index(axis) :]) if place else ("", [])
        else:
            lines = yield from self._answer(b"M114\n", "ok", within_s)
            state, angles = "Idle", re.findall(rf"\b{axis}:\s*({_ANGLE})", " ".join(lines))
        self._said = " ".join(lines)
        if not angles:
            raise RecordingError(f"{self.settings.port}: '{self._said}' tells no angle of {axis}", hint="check axis and dialect")
        if state in ("Alarm", "Door", "Sleep") and not locked:
            raise RecordingError(
                f"{self.settings.port}: the controller is in the state {state.upper()}",
                hint="look at the motor; unlock it ($X), or `home: true` in the rig",
            )
        return state, float(angles[0])

    def _command(self, line: str, within_s: float | None = None) -> Generator[None, None, None]:
        """Send a line and wait for its `ok`."""
        yield from self._answer(f"{line}\n".encode(), "ok", within_s or self.settings.answer_s)

    def _answer(self, question: bytes, end: str, within_s: float) -> Generator[None, None, list[str]]:
        """What comes up to a line that begins with `end`. Raises RecordingError for a refusal, _NoAnswerError for none."""
        self._line.send(question)
        told, lines = question.decode().strip(), []
        until = self._clock.now_s() + within_s
        while self._clock.now_s() < until:
            for line in self._lines(told):
                lines.append(line)
                if line.startswith(end):
                    return lines
            yield None
        raise self._no_answer(f"'{told}'", within_s)

    def _listen(self, seconds: float) -> Generator[None, None, None]:
        """Wait, with an ear to alarms that nobody asked for."""
        until = self._clock.now_s() + seconds
        while self._clock.now_s() < until:
            self._lines("nothing")
            yield None

    def _lines(self, told: str) -> list[str]:
        """The whole lines that have come since, after a short wait."""
        self._text += self._line.receive(_LOOK_S)
        *whole, self._text = self._text.split(b"\n")
        self._text = self._text[-4096:]
        lines = [line.decode("latin-1").strip("\r\0 ") for line in whole]
        self._garbled = self._garbled or any(not (line.isascii() and line.isprintable()) for line in lines)
        self._garbled = self._garbled or any(byte > 126 for byte in self._text)
        for line in lines:
            if line.lower().startswith(_FAILURES):
                raise RecordingError(
                    f"{self.settings.port}: the controller answers '{line}' to {told}",
                    hint="its manual has the number; after an ALARM unlock it ($X) or home it, and check the axis' limits",
                )
        return [line for line in lines if line]

    def _no_answer(self, told: str, within_s: float) -> _NoAnswerError:
        if self._garbled:
            what, hint = "what comes is no text", "check `baud`: 115200 with most controllers, 250000 with some"
        else:
            what, hint = "no answer", "check its power, the port, `baud` and `dialect`"
        return _NoAnswerError(f"{self.settings.port}: {what} within {within_s:g} s to {told}", hint=hint)

    def _sample(self, degrees: float, step: int) -> Sample:
        message = Channels(MOTOR_CHANNELS, np.array([degrees, step], np.float64))
        return Sample(None, self._clock.now_ns(), None, self._said.encode(), (message,))


class _NoAnswerError(RecordingError):
    """The controller is silent, or nobody understands it."""


def _finish(steps: Generator[None, None, T]) -> T:
    """What a generator returns in the end."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return cast(T, end.value)
