"""The pre-flight check: everything that a take needs, looked at before the subject is in the suit."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from cabinpose.core import CabinposeError, SourceEndedError
from cabinpose.record.config import Rig, SourcePlan, Storage
from cabinpose.record.lane import is_data
from cabinpose.signals import FrameSource, HostClock, LiveCheck
from cabinpose.store.recording import parts_beside

_PATIENCE_S = 25.0  # for one source; they are asked at the same time
_LISTEN_S = 5.0  # to a source that is ready: the longest wait for its first data
_READ_S = 0.1


@dataclass(frozen=True)
class Finding:
    """One thing looked at: its name and what is wrong with it, one line each; nothing = ready. required: a take needs it."""

    subject: str
    problems: tuple[str, ...]
    required: bool = True


def check(rig: Rig, out: Path | None, clock: HostClock) -> list[Finding]:
    """Look at everything that a take needs; nothing is recorded and nothing left open.

    Parameters
    ----------
    rig
        The checked rig.
    out
        The file that the take will be written to; None: the disk is not looked at.
    clock
        What the sources and the waiting go by.

    Returns
    -------
    list of Finding
        Of the take, the disk and each source, in this order.
    """
    findings = [_take(rig)]
    if out is not None:
        findings.append(Finding("disk", tuple(_disk(out, rig.storage))))
    asked = [(plan, _ask(plan, clock)) for plan in rig.sources]
    return findings + [Finding(plan.name, wait(), plan.required) for plan, wait in asked]


def _take(rig: Rig) -> Finding:
    missing = [] if rig.take.subjects else ["no subject is named: whose recording it is cannot be found later"]
    missing += [f"{s.code}: no consent reference" for s in rig.take.subjects if not s.consent]
    return Finding("take", tuple(missing))


def _disk(out: Path, storage: Storage) -> list[str]:
    there = [out] if out.exists() else sorted(parts_beside(out).values()) if storage.split_every else []
    if there:
        return [f"{there[0]} exists: recordings are never overwritten"]
    folder = out.parent
    if not folder.is_dir():
        return [f"there is no folder {folder}"]
    if not os.access(folder, os.W_OK):
        return [f"{folder} cannot be written to"]
    free, min_free = shutil.disk_usage(folder).free, storage.min_free_mb * 1e6
    return [] if free > min_free else [f"{free / 1e6:.0f} MB free in {folder}, a take needs more than {min_free / 1e6:.0f} MB"]


def _without_log(plan: SourcePlan) -> SourcePlan:
    """A simulated camera's log is of the take, and is never overwritten: the check must not begin one."""
    if "log" not in type(plan.settings).model_fields:
        return plan
    return replace(plan, settings=plan.settings.model_copy(update={"log": None}))


def _listen(source: FrameSource, clock: HostClock) -> list[str]:
    """What there is to say of a source that is there and sends nothing, or of the camera that its first frame states."""
    until, check = clock.now_s() + _LISTEN_S, LiveCheck()
    try:
        source.open()
        while clock.now_s() < until:
            samples = source.read(_READ_S)
            if any(map(is_data, samples)):
                return [words for sample in samples for words in check.look(sample)]
    except SourceEndedError:
        return []
    finally:
        source.close()
    return [f"it is there and sends no data for {_LISTEN_S:.0f} s; let it send, or say `required: false` in the rig"]


def _ask(plan: SourcePlan, clock: HostClock) -> Callable[[], tuple[str, ...]]:
    """Begin to ask a source; what is returned waits for its answer. A source that hangs is left behind."""
    answer: list[tuple[str, ...]] = []

    def ask() -> None:
        try:
            answer.append(tuple(plan.build(clock).check() or _listen(_without_log(plan).build(clock), clock)))
        except CabinposeError as error:
            answer.append((f"{error}; {error.hint}" if error.hint else str(error),))
        except Exception as error:  # noqa: BLE001 - a source may be code of another package; its defect is a finding
            answer.append((f"its check failed: {error!r}",))

    thread = threading.Thread(target=ask, name=f"check-{plan.name}", daemon=True)
    thread.start()

    def wait() -> tuple[str, ...]:
        clock.join(thread, _PATIENCE_S)
        return answer[0] if answer else (f"did not answer within {_PATIENCE_S:.0f} s",)

    return wait
