"""`cabinpose lab`: record a session in a virtual laboratory, with its truth."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Suppress

from cabinpose.app.cli.arguments import Maybe, PrintsJson, renamed
from cabinpose.app.cli.commands import with_settings
from cabinpose.app.cli.output import print_json, progress
from cabinpose.app.extras import require


@dataclass(frozen=True, kw_only=True)
class Lab(PrintsJson):
    """Record a session in a virtual laboratory: suit, optical system and ToF camera with realistic errors, and the truth.

    Writes calibration takes, a take of a driver, the files that `calibrate` and `align` need, and the truth of all of them.
    """

    out: Path
    """Folder of the session; new or empty."""
    rig: Maybe[Path] = None
    """Rig of the laboratory (YAML): camera, clocks, errors; default: one with the errors of real devices."""
    only: Maybe[str] = None
    """Switch on this error alone; `exact`: no error."""
    settings: Annotated[Any, Suppress] = None


def COMMAND() -> type:  # noqa: N802 - in place of the class, which is made when it is asked for
    """The command, with a plan's fields as flags."""
    from cabinpose.app.lab.plan import Plan

    return with_settings(Lab, "plan", Plan, __doc__=Lab.__doc__)


modernised = partial(renamed, old={"--rate": ("--rate-hz", str)})


def run(command: Lab) -> None:
    """Record the session, and say what to do with it."""
    require("record")
    from cabinpose.app.lab.laboratory import load_rig, record_session
    from cabinpose.app.lab.plan import PAIR, SESSION, Plan, drive_take, exercise_take
    from cabinpose.app.lab.rig import VirtualRig

    plan: Plan = command.settings
    rig = load_rig(command.rig) if command.rig is not None else VirtualRig()
    if command.only is not None:
        rig = rig.noise_free() if command.only == "exact" else rig.only(command.only)
    with progress(plan.steps, "takes") as report:
        truths = record_session(command.out, rig, plan, report)
    out, frames = command.out, sum(len(truth.tof_ns) for truth in truths.values())
    if command.as_json:
        print_json({"out": str(out), "frames": frames, "session": str(out / SESSION), "takes": [drive_take(s) for s in truths]})
        return
    calibration, takes = out / "calibration.yaml", " ".join(str(out / drive_take(subject)) for subject in truths)
    print(f"{out}: calibration takes and {frames} frames of {', '.join(truths)} at the wheel, with their truth")
    print(f"calibrate with: cabinpose calibrate {out / SESSION} --out {calibration}", file=sys.stderr)
    print(f"align with: cabinpose align {takes} --calibration {calibration} --out {out / 'dataset'}", file=sys.stderr)
    if plan.together:
        print(f"and both in one car: {out / PAIR}", file=sys.stderr)
    if plan.exercises:
        exercises = out / exercise_take(plan.subjects[0])
        print(f"judge the suit with: cabinpose evaluate-mocap dfe {exercises} --out {out / 'dfe'}", file=sys.stderr)
