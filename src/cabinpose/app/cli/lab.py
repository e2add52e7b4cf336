"""`cabinpose lab`: a session of the virtual laboratory."""

from __future__ import annotations

import sys

from cabinpose.app.cli.align_commands import Lab
from cabinpose.app.cli.output import print_json, progress
from cabinpose.app.extras import require


def run(command: Lab) -> None:
    """Record the session, and say what to do with it."""
    require("mcap", "mcap_protobuf", "foxglove_schemas_protobuf", extra="record")
    from cabinpose.app.lab.laboratory import ACTION, EXERCISES, SESSION, STEPS, Plan, load_rig, record_session
    from cabinpose.app.lab.rig import Rig

    rig = load_rig(command.rig) if command.rig is not None else Rig()
    if command.only is not None:
        rig = rig.noise_free() if command.only == "exact" else rig.only(command.only)
    plan = Plan(
        views=command.views,
        seconds=command.seconds,
        rate_hz=command.rate,
        car=command.car,
        subject=command.subject,
        exercises=command.exercises,
        seed=command.seed,
    )
    with progress(STEPS, "takes") as report:
        truth = record_session(command.out, rig, plan, report)
    if command.as_json:
        print_json({"out": str(command.out), "frames": len(truth.tof_ns), "session": str(command.out / SESSION)})
        return
    out = command.out
    print(f"{out}: calibration takes and {len(truth.tof_ns)} frames of a driver, with their truth")
    print(f"calibrate with: cabinpose calibrate {out / SESSION} --out {out / 'calibration.yaml'}", file=sys.stderr)
    print(
        f"align with: cabinpose align {out / ACTION} --calibration {out / 'calibration.yaml'} --out {out / 'dataset'}",
        file=sys.stderr,
    )
    if command.exercises:
        print(f"judge the suit with: cabinpose evaluate-mocap dfe {out / EXERCISES} --out {out / 'dfe'}", file=sys.stderr)
