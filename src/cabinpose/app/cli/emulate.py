"""`cabinpose emulate`: devices played. A device's runner is named in `_RUNNERS` and says what it sent."""

from __future__ import annotations

import sys
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from cabinpose.app.cli.commands import Emulate, EmulateMvn
from cabinpose.app.cli.output import print_json, print_rows
from cabinpose.core.errors import ConfigError, RecordingError
from cabinpose.record.emulate.mvn import MvnEmulator, Sent
from cabinpose.record.emulate.mvn_motion import Motion, generated, recorded
from cabinpose.record.emulate.mvn_streamer import MvnEmulatorSettings
from cabinpose.store.convert.mvnx import read_mvnx


def run(command: Emulate) -> None:
    """Play a device until it is over or interrupted, then print what was sent."""
    summary: dict[str, Any] = _RUNNERS[type(command.device)](command.device)
    if command.device.as_json:
        print_json(summary)
    else:
        print_rows((name.replace("_", " "), str(value)) for name, value in summary.items())


def _mvn(command: EmulateMvn) -> dict[str, Any]:
    try:
        settings = MvnEmulatorSettings.model_validate(
            {
                "host": command.host, "port": command.port, "transport": command.transport, "rate_hz": command.rate,
                "capture_rate_hz": command.capture_rate, "kinds": command.types, "characters": command.characters,
                "props": command.props, "fingers": command.fingers, "items_per_datagram": command.items_per_datagram,
                "latency_s": command.latency, "clock_offset_s": command.clock_offset, "clock_drift_ppm": command.clock_drift,
                "loss": command.loss, "duplicate": command.duplicate, "reorder": command.reorder, "seed": command.seed,
            }
        )  # fmt: skip
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "settings"
        raise ConfigError(f"{where}: {first['msg']}", hint="see cabinpose emulate mvn --help") from error
    sent = {"samples": 0, "datagrams": 0, "lost": 0, "duplicate": 0, "late": 0}
    with _log_file(command.log) as file:

        def note(datagram: Sent) -> None:
            sent["datagrams"] += 1
            sent["lost"] += datagram.copies == 0
            sent["duplicate"] += max(0, datagram.copies - 1)
            sent["late"] += datagram.late
            if file is not None:
                file.write(datagram.line() + "\n")

        emulator = MvnEmulator(settings, _motion(command.motion), log=note)
        emulator.open()
        host, port = emulator.address
        print(f"streaming {command.motion} at {command.rate:g} Hz, {settings.transport} {host}:{port}", file=sys.stderr)
        with suppress(KeyboardInterrupt):  # the way to end it, and no failure
            emulator.run(None if command.seconds is None else round(command.seconds * command.rate))
    return sent | {"samples": emulator.samples}


def _motion(name: str) -> Motion:
    path = Path(name)
    return recorded(read_mvnx(path)) if path.suffix.lower() == ".mvnx" else generated(name)


def _log_file(path: Path | None) -> Any:
    if path is None:
        return nullcontext()
    try:
        return path.open("x", encoding="utf-8", newline="\n")
    except OSError as error:
        raise RecordingError(f"cannot write {path} ({error.strerror or error})", hint="give a new file with --log") from error


_RUNNERS = {EmulateMvn: _mvn}
