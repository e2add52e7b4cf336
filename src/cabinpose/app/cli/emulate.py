"""`cabinpose emulate`: devices played. A device's runner is named in `_RUNNERS` and says what it sent."""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from cabinpose.app.cli.commands import Emulate, EmulateMvn, EmulateVicon
from cabinpose.app.cli.output import print_json, print_rows
from cabinpose.app.cli.record_commands import EmulateStepper
from cabinpose.core.errors import ConfigError, RecordingError, unknown_name
from cabinpose.record.emulate.base import log_line
from cabinpose.record.emulate.mvn import MvnEmulator, Sent
from cabinpose.record.emulate.mvn_motion import Motion, generated, recorded
from cabinpose.record.emulate.mvn_streamer import MvnEmulatorSettings
from cabinpose.record.emulate.stepper import StepperEmulator, StepperEmulatorSettings
from cabinpose.record.emulate.vicon import ViconEmulator
from cabinpose.record.emulate.vicon_content import ViconEmulatorSettings
from cabinpose.record.emulate.vicon_motion import Motion as ViconMotion
from cabinpose.record.emulate.vicon_motion import generated_motion, motion_of_c3d
from cabinpose.store.convert.mvnx import read_mvnx

_Settings = TypeVar("_Settings", bound=BaseModel)


def run(command: Emulate) -> None:
    """Play a device until it is over or interrupted, then print what was sent."""
    summary = _RUNNERS[type(command.device)](command.device)
    if command.device.as_json:
        print_json(summary)
    else:
        print_rows((name.replace("_", " "), str(value)) for name, value in summary.items())


def _mvn(command: EmulateMvn) -> dict[str, Any]:
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


def _motion(name: str) -> Motion:
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
    with file:
        yield lambda sent: print(log_line(sent), end="", file=file)


def _vicon(command: EmulateVicon) -> dict[str, Any]:
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


def _vicon_motion(command: EmulateVicon) -> ViconMotion:
    path = Path(command.motion)
    if path.suffix.lower() == ".c3d":
        return motion_of_c3d(path)
    if command.motion != "generated":
        raise unknown_name("motion", command.motion, ["generated", "a C3D file"])
    people = tuple(f"S{i + 1:02d}" for i in range(command.subjects))
    rng = np.random.Generator(np.random.Philox(key=(command.seed, 0)))
    return generated_motion(rng=rng, rate_hz=command.rate or 100.0, subjects=people)


def _checked(model: type[_Settings], device: str, values: dict[str, Any]) -> _Settings:
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "settings"
        raise ConfigError(f"{where}: {first['msg']}", hint=f"see cabinpose emulate {device} --help") from error


_RUNNERS: Mapping[type, Callable[[Any], dict[str, Any]]] = {EmulateMvn: _mvn, EmulateVicon: _vicon, EmulateStepper: _stepper}
