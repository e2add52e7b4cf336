"""`cabinpose emulate`: emulate a device: a server that sends the real bytes."""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from cabinpose.app.cli.arguments import Maybe, PrintsJson, one_of
from cabinpose.app.cli.output import print_json, print_rows
from cabinpose.core import ConfigError, RecordingError, unknown_name

if TYPE_CHECKING:
    from pydantic import BaseModel

    from cabinpose.record.emulate import MarkerMotion, Sent, SuitMotion

_Settings = TypeVar("_Settings", bound="BaseModel")


@dataclass(frozen=True, kw_only=True)
class EmulateMvn(PrintsJson):
    """Stream a motion as Xsens MVN's network streamer does, with losses, delays and reordering on request. Ctrl-C ends it."""

    motion: str = "seated"
    """seated, walk, or an MVNX file to repeat."""
    host: str = "127.0.0.1"
    """Address to stream to (listen: address to listen on)."""
    port: int = 9763
    """Port of that address."""
    transport: Literal["udp", "tcp", "listen"] = "udp"
    """udp; tcp: connect to a receiver; listen: wait for a receiver to connect."""
    types: tuple[int, ...] = (2,)
    """Types of datagrams: 1 2 3 5 20 21 22 23 24 25. Names and scales (12, 13) come every second."""
    rate: float = 60.0
    """Samples a second."""
    capture_rate: Maybe[float] = None
    """Samples a second by the sample counter; default: the rate."""
    characters: int = 1
    """Number of people, side by side."""
    props: int = 0
    """Props per person."""
    fingers: bool = False
    """Send 40 finger segments too."""
    items_per_datagram: Maybe[int] = None
    """Largest number of items per datagram; default: samples are not split."""
    latency: float = 0.0
    """Delay from sample to sending, s."""
    clock_offset: float = 0.0
    """The sender's clock at the start, s."""
    clock_drift: float = 0.0
    """How fast the sender's clock runs, parts per million."""
    loss: float = 0.0
    """Share of datagrams that are lost."""
    duplicate: float = 0.0
    """Share of datagrams that arrive twice."""
    reorder: float = 0.0
    """Share of datagrams that arrive late, after later ones."""
    seconds: Maybe[float] = None
    """Duration, s; default: until Ctrl-C."""
    log: Maybe[Path] = None
    """File for one line of JSON per datagram: what was sent, lost or delayed."""
    seed: int = 0
    """Seed of the losses, duplicates and delays."""


@dataclass(frozen=True, kw_only=True)
class EmulateVicon(PrintsJson):
    """Serve a motion as Vicon's DataStream does, to any number of clients. Ctrl-C ends it."""

    motion: str = "generated"
    """generated, or a C3D file to repeat."""
    host: str = "127.0.0.1"
    """Address to listen on."""
    port: int = 8801
    """Port to listen on; 0 takes a free one. Vicon's own is 801, which most systems keep for the administrator."""
    rate: Maybe[float] = None
    """Frames a second; default: the motion's (generated: 100)."""
    subjects: int = 1
    """People of a generated motion, side by side."""
    first_frame: int = 1
    """Number of the first frame, as the vendor's SDK reports it."""
    latency: float = 0.0
    """Delay from capture to sending that the server reports, s."""
    clock_drift: float = 0.0
    """How fast the server's clock runs, parts per million."""
    drop: float = 0.0
    """Share of frames that are never sent."""
    occlude_markers: float = 0.0
    """Share of markers that are occluded."""
    occlude_segments: float = 0.0
    """Share of segments that are not solved."""
    up: Literal["z", "y"] = "z"
    """The server's vertical axis."""
    die_after: Maybe[float] = None
    """Stop the server after so many seconds, then start it again."""
    dead_for: float = 2.0
    """Seconds until the server starts again."""
    anew: bool = False
    """After a restart, number frames from the first again."""
    seconds: Maybe[float] = None
    """Duration, s; default: until Ctrl-C."""
    log: Maybe[Path] = None
    """File for one line of JSON per frame and client: sent, dropped or refused."""
    seed: int = 0
    """Seed of the motion, and of what is dropped and occluded."""


@dataclass(frozen=True, kw_only=True)
class EmulateStepper(PrintsJson):
    """Play the controller of a stepper motor (GRBL or Marlin) on a pseudo-terminal, whose name it prints. Ctrl-C ends it."""

    dialect: Literal["grbl", "marlin"] = "grbl"
    """What it speaks."""
    link: Maybe[Path] = None
    """Name that leads to the pseudo-terminal, for a rig's `port`."""
    backlash: float = 0.0
    """Degrees by which the shaft stays behind where the motor turns back."""
    miss_every: int = 0
    """Every so many moves the motor misses steps; 0: never."""
    miss: float = 0.9
    """Degrees that it misses then."""
    fault: Literal["none", "error", "alarm", "hang", "drop", "garbage"] = "none"
    """What goes wrong: a refusal, an alarm, silence, the line, or what comes over it."""
    fault_at: int = 1
    """At which move; 0: from the start."""
    seconds: Maybe[float] = None
    """How long; default: until Ctrl-C."""


COMMAND = one_of(mvn=EmulateMvn, vicon=EmulateVicon, stepper=EmulateStepper)


def run(command: EmulateMvn | EmulateVicon | EmulateStepper) -> None:
    """Emulate a device until its end or Ctrl-C, then print what was sent."""
    summary = _RUNNERS[type(command)](command)
    if command.as_json:
        print_json(summary)
    else:
        print_rows((name.replace("_", " "), str(value)) for name, value in summary.items())


def _mvn(command: EmulateMvn) -> dict[str, Any]:
    from cabinpose.record.emulate import MvnEmulator, MvnEmulatorSettings

    settings = _checked(
        MvnEmulatorSettings,
        "mvn",
        {
            "host": command.host, "port": command.port, "transport": command.transport, "rate_hz": command.rate,
            "capture_rate_hz": command.capture_rate, "kinds": command.types, "characters": command.characters,
            "props": command.props, "fingers": command.fingers, "items_per_datagram": command.items_per_datagram,
            "latency_s": command.latency, "clock_offset_s": command.clock_offset, "clock_drift_ppm": command.clock_drift,
            "loss": command.loss, "duplicate": command.duplicate, "reorder": command.reorder, "seed": command.seed,
        },
    )  # fmt: skip
    sent = {"samples": 0, "datagrams": 0, "lost": 0, "duplicate": 0, "late": 0}
    with _log_file(command.log) as write:

        def note(datagram: Sent) -> None:
            write(datagram)
            sent["datagrams"] += 1
            sent["lost"] += datagram.copies == 0
            sent["duplicate"] += max(0, datagram.copies - 1)
            sent["late"] += datagram.late

        samples = None if command.seconds is None else round(command.seconds * command.rate)
        emulator = MvnEmulator(settings, _motion(command.motion), samples=samples, log=note)
        emulator.open()
        host, port = emulator.address
        print(f"streaming {command.motion} at {command.rate:g} Hz, {settings.transport} {host}:{port}", file=sys.stderr)
        with suppress(KeyboardInterrupt):  # the way to end it, and no failure
            emulator.run()
    return sent | {"samples": emulator.samples}


def _motion(name: str) -> SuitMotion:
    from cabinpose.record.emulate import generated, recorded
    from cabinpose.store.convert import read_mvnx

    path = Path(name)
    return recorded(read_mvnx(path)) if path.suffix.lower() == ".mvnx" else generated(name)


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

    outages = [] if command.die_after is None else [(command.die_after, command.dead_for, command.anew)]
    settings = _checked(
        ViconEmulatorSettings,
        "vicon",
        {
            "host": command.host, "port": command.port, "rate_hz": command.rate, "first_frame": command.first_frame,
            "drift_ppm": command.clock_drift, "latency_s": command.latency, "drop": command.drop, "up": command.up,
            "occlude_markers": command.occlude_markers, "occlude_segments": command.occlude_segments, "outages": outages,
            "seed": command.seed,
        },
    )  # fmt: skip
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


def _stepper(command: EmulateStepper) -> dict[str, Any]:
    from cabinpose.record.emulate import StepperEmulator, StepperEmulatorSettings

    settings = _checked(
        StepperEmulatorSettings,
        "stepper",
        {
            "dialect": command.dialect, "backlash_deg": command.backlash, "miss_every": command.miss_every,
            "miss_deg": command.miss, "fault": command.fault, "fault_at": command.fault_at,
        },
    )  # fmt: skip
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
    rng = np.random.Generator(np.random.Philox(key=(command.seed, 0)))
    return generated_motion(rng=rng, rate_hz=command.rate or 100.0, subjects=people)


def _checked(model: type[_Settings], device: str, values: dict[str, Any]) -> _Settings:
    from pydantic import ValidationError

    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "settings"
        raise ConfigError(f"{where}: {first['msg']}", hint=f"see cabinpose emulate {device} --help") from error


_RUNNERS: Mapping[type, Callable[[Any], dict[str, Any]]] = {EmulateMvn: _mvn, EmulateVicon: _vicon, EmulateStepper: _stepper}
