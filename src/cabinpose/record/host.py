"""What a computer's clock and network are while it records: the delays of a calibration hold as long as these stay."""

from __future__ import annotations

import hashlib
import platform
from pathlib import Path

_CLOCK = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
_INTERFACES = Path("/sys/class/net")


def host_facts(clock: Path = _CLOCK, interfaces: Path = _INTERFACES) -> dict[str, str]:
    """The computer (a hash of its name), its kernel, its clock source, and each network interface that is up.

    clock, interfaces: where Linux states them. Where another system does not, they are left out.
    """
    facts = {
        "computer": hashlib.sha256(platform.node().encode()).hexdigest()[:12],
        "kernel": f"{platform.system()} {platform.release()}",
    }
    if found := _read(clock):
        facts["clock source"] = found
    for interface in sorted(interfaces.glob("*")):
        if _read(interface / "operstate") == "up":
            speed = _read(interface / "speed")  # -1 where the interface has none, as a wireless one
            rate = f", {speed} Mb/s" if speed and int(speed) > 0 else ""
            facts[f"network {interface.name}"] = f"MTU {_read(interface / 'mtu')}{rate}"
    return facts


def _read(path: Path) -> str:
    """The one line of a file of the kernel, "" where it has none."""
    try:
        return path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""
