"""The pre-flight check: everything that a take needs, looked at before the subject is in the suit."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cabinpose.core.clock import HostClock
from cabinpose.core.errors import CabinposeError
from cabinpose.record.config import Rig, SourcePlan

_PATIENCE_S = 20.0  # for one source; they are asked at the same time


@dataclass(frozen=True)
class Finding:
    """One thing looked at: its name and what is wrong with it, one line each; nothing = ready."""

    subject: str
    problems: tuple[str, ...]


def check(rig: Rig, out: Path | None, clock: HostClock) -> list[Finding]:
    """What is missing, of the disk and of each source; nothing is recorded and nothing left open."""
    findings = [_take(rig)]
    if out is not None:
        findings.append(Finding("disk", tuple(_disk(out, rig.storage.min_free_mb * 1e6))))
    asked = [(plan, _ask(plan, clock)) for plan in rig.sources]
    return findings + [Finding(plan.name, wait()) for plan, wait in asked]


def _take(rig: Rig) -> Finding:
    missing = [] if rig.take.subjects else ["no subject is named: whose recording it is cannot be found later"]
    missing += [f"{s.code}: no consent reference" for s in rig.take.subjects if not s.consent]
    return Finding("take", tuple(missing))


def _disk(out: Path, min_free: float) -> list[str]:
    if out.exists():
        return [f"{out} exists: recordings are never overwritten"]
    folder = out.parent
    if not folder.is_dir():
        return [f"there is no folder {folder}"]
    if not os.access(folder, os.W_OK):
        return [f"{folder} cannot be written to"]
    free = shutil.disk_usage(folder).free
    return [] if free > min_free else [f"{free / 1e6:.0f} MB free in {folder}, a take needs more than {min_free / 1e6:.0f} MB"]


def _ask(plan: SourcePlan, clock: HostClock) -> Callable[[], tuple[str, ...]]:
    """Begin to ask a source; what is returned waits for its answer. A source that hangs is left behind."""
    answer: list[tuple[str, ...]] = []

    def ask() -> None:
        try:
            answer.append(tuple(plan.build(clock).check()))
        except CabinposeError as error:
            answer.append((f"{error}; {error.hint}" if error.hint else str(error),))
        except Exception as error:  # noqa: BLE001 - a source is anybody's code; its defect is a finding
            answer.append((f"its check failed: {error!r}",))

    thread = threading.Thread(target=ask, name=f"check-{plan.name}", daemon=True)
    thread.start()

    def wait() -> tuple[str, ...]:
        thread.join(_PATIENCE_S)
        return answer[0] if answer else (f"did not answer within {_PATIENCE_S:.0f} s",)

    return wait
