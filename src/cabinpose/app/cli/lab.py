"""`cabinpose lab`: record a session in a virtual laboratory, with its truth."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from cabinpose.app.cli.arguments import Maybe, PrintsJson
from cabinpose.app.cli.output import print_json, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError


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
    seconds: float = 20.0
    """Length of the driver's take, s."""
    rate: Maybe[float] = None
    """Frames per second of the camera in the driver's take; default: the rig's."""
    views: int = 50
    """Poses of the checkerboard."""
    car: str = "sedan"
    """Name of a preset car."""
    subjects: tuple[str, ...] = ("S01",)
    """People of the package who are recorded, one after the other."""
    together: bool = False
    """Record the first two of them in one car as well, driver and front passenger, each in a suit of their own."""
    exercises: bool = True
    """Record movements in each anatomical plane outside the car as well, for `evaluate-mocap`."""
    seed: int = 0
    """Seed of all random numbers."""


COMMAND = Lab


def run(command: Lab) -> None:
    """Record the session, and say what to do with it."""
    require("record")
    from pydantic import ValidationError

    from cabinpose.app.lab.laboratory import PAIR, SESSION, Plan, drive_take, exercise_take, load_rig, record_session
    from cabinpose.app.lab.rig import VirtualRig

    rig = load_rig(command.rig) if command.rig is not None else VirtualRig()
    if command.only is not None:
        rig = rig.noise_free() if command.only == "exact" else rig.only(command.only)
    try:
        plan = Plan(
            views=command.views,
            seconds=command.seconds,
            rate_hz=command.rate,
            car=command.car,
            subjects=command.subjects,
            together=command.together,
            exercises=command.exercises,
            seed=command.seed,
        )
    except ValidationError as error:
        first = error.errors()[0]
        flag = str(first["loc"][0]).removesuffix("_hz") if first["loc"] else "together"
        reason = first["msg"][0].lower() + first["msg"][1:]
        raise ConfigError(
            f"--{flag}: {reason}, not {first['input']}", hint="`cabinpose lab --help` says what each flag takes"
        ) from error
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
    if command.together:
        print(f"and both in one car: {out / PAIR}", file=sys.stderr)
    if command.exercises:
        exercises = out / exercise_take(command.subjects[0])
        print(f"judge the suit with: cabinpose evaluate-mocap dfe {exercises} --out {out / 'dfe'}", file=sys.stderr)
