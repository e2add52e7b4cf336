"""What a user sets of a ToF camera before its frames count: keys that the kinds share, sent, read back, told where they differ.

A kind of camera gives a `Control` for each value that its SDK can set or tell; everything else is here.
"""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import Field, ValidationInfo, field_validator

from cabinpose.core import RecordingError
from cabinpose.record.sources.tof.camera import CameraSettings, CameraSource
from cabinpose.signals import SETUP, HostClock

_SAME = 1e-3  # of a value: what is read back is the same up to this, since cameras have clocks and registers of few bits
_REFUSED = "refused"

FilterValue = bool | int | float | str
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class RefusedError(Exception):
    """The camera, or its SDK, does not take a value; the text says why."""


class CameraSetup(CameraSettings):
    """What may be set of a camera. `cannot`: keys that a kind of camera does not have, and what takes their place."""

    cannot: ClassVar[Mapping[str, str]] = {}
    frame_rate_hz: Positive | None = Field(None, description="frames a second; left out: as the camera has it")
    integration_us: Positive | None = Field(None, description="how long a phase is exposed, µs; left out: as the camera has it")
    modulation_hz: Positive | None = Field(None, description="modulation frequency, Hz; left out: as the camera has it")
    filters: dict[str, FilterValue] = Field(
        default_factory=dict, description="the camera's own filters, by the names it has for them"
    )

    @field_validator("frame_rate_hz", "integration_us", "modulation_hz", "filters")
    @classmethod
    def _can_be_set(cls, value: Any, info: ValidationInfo) -> Any:
        if value and (why := cls.cannot.get(str(info.field_name))):
            raise ValueError(why)
        return value


SETUP_KEYS = ("integration_us", "frame_rate_hz", "modulation_hz")


@dataclass(frozen=True)
class Control:
    """A value of a camera.

    name: the key, `filters.NAME` for one of several · asked: what the user wants, None: it stays · put: sends it, raises
    RefusedError · get: reads it back, None where the camera does not tell.
    """

    name: str
    asked: FilterValue | None
    put: Callable[[Any], None]
    get: Callable[[], FilterValue | None]


SetupT = TypeVar("SetupT", bound=CameraSetup)


class AdjustableSource(CameraSource[SetupT]):
    """A camera whose values are set. `_connect` of a subclass calls `_set_up` before its frames count."""

    def __init__(self, name: str, settings: SetupT, clock: HostClock | None = None) -> None:
        super().__init__(name, settings, clock)
        self._values: dict[str, dict[str, Any]] = {}
        self._was_set_up = False

    @abstractmethod
    def _controls(self) -> Iterator[Control]:
        """The values that can be set or read, in the order in which they are sent."""

    def _set_up(self) -> None:
        """Send what is asked, read all back, and say it in the next sample.

        Raises
        ------
        RecordingError
            Where a value is refused. Only the first time: in a take that runs, frames of a camera that came back with another
            value are worth more than none, and a warning says so.
        """
        controls = list(self._controls())
        refused: dict[str, str] = {}
        waiting = [control for control in controls if control.asked is not None]
        for _ in range(2):  # a rate may be too high for the exposure before, and the other way round: when all are sent, again
            for control in waiting:
                refused.pop(control.name, None)
                try:
                    control.put(control.asked)
                except RefusedError as error:
                    refused[control.name] = str(error)
            waiting = [control for control in waiting if control.name in refused or not same(control.asked, control.get())]
        asked = {control.name: control.asked for control in controls}
        if refused and not self._was_set_up:
            words = "; ".join(f"{name} {_word(asked[name])}: {why}" for name, why in refused.items())
            raise RecordingError(f"{self.name}: the camera refuses {words}", hint=self._remedy(tuple(refused)))
        self._was_set_up = True
        values = {control.name: _pair(control.asked, control.get()) for control in controls}
        self._tell(
            {name: value | ({_REFUSED: refused[name]} if name in refused else {}) for name, value in values.items() if value}
        )

    def _remedy(self, names: Sequence[str]) -> str:
        """The hint of what was refused."""
        return f"give another value, or leave {' and '.join(names)} out: the camera then keeps its own"

    def _has(self, name: str, actual: FilterValue) -> None:
        """What a frame shows a value to be that the SDK does not tell."""
        if name in self._values:
            self._tell(self._values | {name: self._values[name] | {"actual": actual}})

    def _tell(self, values: dict[str, dict[str, Any]]) -> None:
        """State the values, and warn of each that is not what was asked; nothing where that was said before."""
        before, self._values = self._values, values
        if not values or values == before:
            return
        self._state(SETUP, **values)
        for name, value in values.items():
            if value != before.get(name) and (differs := _difference(value)):
                warnings.warn(f"{self.name}: {name} is not as asked: {differs}", stacklevel=2)


def same(asked: FilterValue | None, actual: FilterValue | None) -> bool:
    """Whether a value that was read back is the one that was asked for; one that the camera does not tell counts as it."""
    if asked is None or actual is None:
        return True
    if isinstance(asked, float) or isinstance(actual, float):
        try:
            return abs(float(asked) - float(actual)) <= _SAME * abs(float(asked))
        except ValueError:
            return False
    return asked == actual


def described(values: Mapping[str, Any]) -> list[str]:
    """Each value of a camera's set-up in words, from its facts: as it is, and as it was asked for where that differs."""
    pairs = ((name, value) for name, value in values.items() if isinstance(value, Mapping))  # a file may say anything
    return [f"{name} {_difference(value) or _word(value.get('actual', value.get('asked')))}" for name, value in pairs]


def _difference(value: Mapping[str, Any]) -> str:
    asked, actual = value.get("asked"), value.get("actual")
    if why := value.get(_REFUSED):
        return f"{'unknown' if actual is None else _word(actual)} (asked {_word(asked)}, refused: {why})"
    return "" if same(asked, actual) else f"{_word(actual)} (asked {_word(asked)})"


def _pair(asked: FilterValue | None, actual: FilterValue | None) -> dict[str, Any]:
    return {key: value for key, value in (("asked", asked), ("actual", actual)) if value is not None}


def _word(value: FilterValue | None) -> str:
    """A value as a person writes it: floats to six digits, and whole numbers as such."""
    if isinstance(value, float):
        return f"{value:.0f}" if value.is_integer() else f"{value:.6g}"
    return str(value)


def adjustable(kind: type) -> tuple[str, ...]:
    """The keys among `SETUP_KEYS` that cameras of a kind have; none where its settings are no `CameraSetup`."""
    settings = getattr(kind, "Settings", None)
    if not (isinstance(settings, type) and issubclass(settings, CameraSetup)):
        return ()
    return tuple(key for key in SETUP_KEYS if key not in settings.cannot)
