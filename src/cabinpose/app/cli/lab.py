"""`cabinpose lab`: a session of the virtual laboratory."""

from __future__ import annotations

import sys

from pydantic import ValidationError

from cabinpose.app.cli.align_commands import Lab
from cabinpose.app.cli.output import print_json, progress
from cabinpose.app.extras import require
from cabinpose.core.errors import ConfigError


def run(command: Lab) -> None:
    """Record the session, and say what to do with it."""
    require("mcap", "mcap_protobuf", "foxglove_schemas_protobuf", "cv2", extra="record")
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
