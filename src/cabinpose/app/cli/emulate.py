"""`cabinpose emulate`: emulate a device: a server that sends the real bytes."""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Suppress

from cabinpose.app.cli.arguments import Maybe, PrintsJson, renamed
from cabinpose.app.cli.commands import Choices, with_settings
from cabinpose.app.cli.output import print_json, print_rows
from cabinpose.core import RecordingError, unknown_name

if TYPE_CHECKING:
    from pydantic import BaseModel

    from cabinpose.record.emulate import MarkerMotion, Sent, SuitMotion


@dataclass(frozen=True, kw_only=True)
class _Emulate(PrintsJson):
    """Flags of every device."""

    device: ClassVar[str]
    seconds: Maybe[float] = None
    """Duration, s; default: until Ctrl-C."""
    settings: Annotated[Any, Suppress] = None


@dataclass(frozen=True, kw_only=True)
class EmulateMvn(_Emulate):
    """Stream a motion as Xsens MVN's network streamer does, with losses, delays and reordering on request. Ctrl-C ends it."""

    motion: str = "seated"
    """seated, walk, or an MVNX file to repeat."""
    log: Maybe[Path] = None
    """File for one line of JSON per datagram: what was sent, lost or delayed."""


@dataclass(frozen=True, kw_only=True)
class EmulateVicon(_Emulate):
    """Serve a motion as Vicon's DataStream does, to any number of clients. Ctrl-C ends it."""

    motion: str = "generated"
    """generated, or a C3D file to repeat."""
    subjects: int = 1
    """People of a generated motion, side by side."""
    die_after: Maybe[float] = None
    """Stop the server after so many seconds, then start it again."""
    dead_for: float = 2.0
    """Seconds until the server starts again."""
    anew: bool = False
    """After a restart, number frames from the first again."""
    log: Maybe[Path] = None
    """File for one line of JSON per frame and client: sent, dropped or refused."""


@dataclass(frozen=True, kw_only=True)
class EmulateMt(_Emulate):
    """Play single Xsens trackers (MTi, MTw) on a pseudo-terminal, whose name it prints. Ctrl-C ends it."""

    motion: str = "seated"
    """seated, walk, or an MVNX file to repeat."""
    link: Maybe[Path] = None
    """Name that leads to the pseudo-terminal, for a rig's `port`."""


@dataclass(frozen=True, kw_only=True)
class EmulateStepper(_Emulate):
    """Play the controller of a stepper motor (GRBL or Marlin) on a pseudo-terminal, whose name it prints. Ctrl-C ends it."""

    link: Maybe[Path] = None
    """Name that leads to the pseudo-terminal, for a rig's `port`."""


_COMMANDS: Mapping[str, type[_Emulate]] = {
    "mvn": EmulateMvn, "vicon": EmulateVicon, "mt": EmulateMt, "stepper": EmulateStepper,
}  # fmt: skip
_VICON_PORT = 8801  # the vendor's own is 801, which most systems keep for the administrator
_RENAMED: Mapping[str, Mapping[str, str]] = {
    "mvn": {
        "--rate": "--rate-hz", "--capture-rate": "--capture-rate-hz", "--types": "--kinds", "--latency": "--latency-s",
        "--clock-offset": "--clock-offset-s", "--clock-drift": "--clock-drift-ppm",
    },
    "vicon": {"--rate": "--rate-hz", "--latency": "--latency-s", "--clock-drift": "--drift-ppm"},
    "stepper": {"--backlash": "--backlash-deg", "--miss": "--miss-deg"},
}  # fmt: skip


def _listed() -> dict[str, dict[str, str]]:
    return {"devices": {name: (command.__doc__ or "").partition(". ")[0] for name, command in _COMMANDS.items()}}


def _command(name: str) -> type:
    """The command of a device, with the fields of its emulator's settings as flags."""
    if name not in _COMMANDS:
        raise unknown_name("device", name, list(_COMMANDS))
    command, default = _COMMANDS[name], _default(name)
    return with_settings(command, name, type(default), default, device=name, __doc__=command.__doc__)


def _default(name: str) -> BaseModel:
    """The settings of a device's emulator; only its own modules are imported."""
    if name == "mvn":
        from cabinpose.record.emulate import MvnEmulatorSettings

        return MvnEmulatorSettings()
    if name == "vicon":
        from cabinpose.record.emulate import ViconEmulatorSettings

        return ViconEmulatorSettings(port=_VICON_PORT)
    if name == "mt":
        from cabinpose.record.emulate import MtEmulatorSettings

        return MtEmulatorSettings()
    from cabinpose.record.emulate import StepperEmulatorSettings

    return StepperEmulatorSettings()


COMMAND = Choices("device", _listed, _command)


def modernised(words: Sequence[str]) -> list[str]:
    """The words with flags by their names of today."""
    old = _RENAMED.get(words[0], {}) if words else {}
    return renamed(words, {flag: (new, str) for flag, new in old.items()})


def run(command: EmulateMvn | EmulateVicon | EmulateMt | EmulateStepper) -> None:
    """Emulate a device until its end or Ctrl-C, then print what was sent."""
    summary = _RUNNERS[command.device](command)
    if command.as_json:
        print_json(summary)
    else:
        print_rows((name.replace("_", " "), str(value)) for name, value in summary.items())


def _mvn(command: EmulateMvn) -> dict[str, Any]:
    from cabinpose.record.emulate import MvnEmulator, MvnEmulatorSettings

    settings: MvnEmulatorSettings = command.settings
    sent = {"samples": 0, "datagrams": 0, "lost": 0, "duplicate": 0, "late": 0}
    with _log_file(command.log) as write:

        def note(datagram: Sent) -> None:
            write(datagram)
            sent["datagrams"] += 1
            sent["lost"] += datagram.copies == 0
            sent["duplicate"] += max(0, datagram.copies - 1)
            sent["late"] += datagram.late

        samples = None if command.seconds is None else round(command.seconds * settings.rate_hz)
        emulator = MvnEmulator(settings, _motion(command.motion), samples=samples, log=note)
        emulator.open()
        host, port = emulator.address
        print(f"streaming {command.motion} at {settings.rate_hz:g} Hz, {settings.transport} {host}:{port}", file=sys.stderr)
        with suppress(KeyboardInterrupt):  # the way to end it, and no failure
            emulator.run()
    return sent | {"samples": emulator.samples}


def _motion(name: str) -> SuitMotion:
    from cabinpose.record.emulate import generated, recorded
    from cabinpose.store.convert import motion_rows

    path = Path(name)
    return recorded(motion_rows(path)) if path.suffix.lower() == ".mvnx" else generated(name)


@contextmanager
def _log_file(path: Path | None) -> Iterator[Callable[[Any], None]]:
    """What writes lines about what was sent, to a new file or nowhere."""
    if path is None:
        yield lambda _: None
        return
    try:
        # Line by line: what was sent is known even of an emulator that was killed.
        file = path.open("x", encoding="utf-8", newline="\n", buffering=1)
    except OSError as error:
        raise RecordingError(f"cannot write {path} ({error.strerror or error})", hint="give a new file with --log") from error
    from cabinpose.record.emulate import log_line

    with file:
        yield lambda sent: print(log_line(sent), end="", file=file)


def _vicon(command: EmulateVicon) -> dict[str, Any]:
    from cabinpose.record.emulate import ViconEmulator, ViconEmulatorSettings

    settings: ViconEmulatorSettings = command.settings
    if command.die_after is not None:
        outage = (command.die_after, command.dead_for, command.anew)
        settings = settings.model_validate(settings.model_dump() | {"outages": [outage]})
    motion = _vicon_motion(command)
    with _log_file(command.log) as write:
        emulator = ViconEmulator(motion, settings, tell=write)
        with emulator, suppress(KeyboardInterrupt):
            host, port = emulator.address
            print(f"streaming {command.motion} at {emulator.rate_hz:g} Hz, tcp {host}:{port}", file=sys.stderr)
            emulator.join(math.inf if command.seconds is None else command.seconds)
    fates = Counter(sent.fate for sent in emulator.log)
    clients = {"clients": len({sent.client for sent in emulator.log})}
    return clients | {fate: fates[fate] for fate in ("sent", "dropped", "refused")}


def _wait(seconds: float | None) -> None:
    until = math.inf if seconds is None else time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        time.sleep(min(left, 0.5))


def _mt(command: EmulateMt) -> dict[str, Any]:
    from cabinpose.record.emulate import MtEmulator, MtEmulatorSettings

    settings: MtEmulatorSettings = command.settings
    with MtEmulator(settings, _motion(command.motion)) as emulator:
        print(f"{', '.join(settings.devices)} on {emulator.port}", file=sys.stderr)
        with _linked(command.link, emulator.port), suppress(KeyboardInterrupt):
            _wait(command.seconds)
    return {"sent": emulator.sent, "lost": emulator.lost, "damaged": emulator.damaged}


def _stepper(command: EmulateStepper) -> dict[str, Any]:
    from cabinpose.record.emulate import StepperEmulator, StepperEmulatorSettings

    settings: StepperEmulatorSettings = command.settings
    with StepperEmulator(settings) as emulator:
        print(f"{settings.dialect} listens on {emulator.port}", file=sys.stderr)
        with _linked(command.link, emulator.port), suppress(KeyboardInterrupt):
            _wait(command.seconds)
        return {"moves": emulator.moves, "stops": emulator.stops, "shaft_deg": round(emulator.true_deg, 4)}


@contextmanager
def _linked(link: Path | None, port: str) -> Iterator[None]:
    """A symbolic link to the pseudo-terminal, for as long as it is there."""
    if link is None:
        yield
        return
    try:
        link.symlink_to(port)
    except OSError as error:
        raise RecordingError(f"cannot make {link} ({error.strerror or error})", hint="give a new name with --link") from error
    try:
        yield
    finally:
        link.unlink(missing_ok=True)


def _vicon_motion(command: EmulateVicon) -> MarkerMotion:
    import numpy as np

    from cabinpose.record.emulate import generated_motion, motion_of_c3d

    path = Path(command.motion)
    if path.suffix.lower() == ".c3d":
        return motion_of_c3d(path)
    if command.motion != "generated":
        raise unknown_name("motion", command.motion, ["generated", "a C3D file"])
    people = tuple(f"S{i + 1:02d}" for i in range(command.subjects))
    rng = np.random.Generator(np.random.Philox(key=(command.settings.seed, 0)))
    return generated_motion(rng=rng, rate_hz=command.settings.rate_hz or 100.0, subjects=people)


_RUNNERS: Mapping[str, Callable[[Any], dict[str, Any]]] = {"mvn": _mvn, "vicon": _vicon, "mt": _mt, "stepper": _stepper}
