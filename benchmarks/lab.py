"""`cabinpose bench lab`: what a rig's errors do to calibration and joints, all together and each alone."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from benchmarks import Say
from cabinpose.align.calibration import Calibration, PoseCorrection
from cabinpose.align.project import align_take
from cabinpose.align.session import Session, calibrate, correct_pose
from cabinpose.app.lab.laboratory import record_session
from cabinpose.app.lab.plan import SESSION, Plan, drive_take
from cabinpose.app.lab.rig import ERRORS, TRACKER_ERRORS, Tracker, VirtualRig
from cabinpose.app.lab.score import calibration_error, joint_error
from cabinpose.core import explained
from cabinpose.store.recording import Recording

EXACT, ALL, WITH_TRACKER = "none", "all", "all, the head by the tracker"
_TAKE_HZ = 5.0  # of the camera: the joints need the stamps of its frames, not their images
_RARE = ("optical_swaps",)  # what no rig has always: not among "all"


def run(*, errors: tuple[str, ...], views: int, seconds: float, seed: int, say: Say, pendulum_s: float = 20.0) -> dict[str, Any]:
    """Record, calibrate and align a session without errors, with all errors of a rig, and with each alone.

    Parameters
    ----------
    errors
        Errors to look at alone; none: all of `app.lab.rig.ERRORS`.
    views, seconds, pendulum_s
        Poses of the board, and lengths of the takes, s.
    seed
        Of all random numbers, the same in every session.
    say
        Called with the result of each session.

    Returns
    -------
    dict
        Found minus true values: of the calibration as in `app.lab.score.CalibrationError`, of the joints mean and median
        distance (cm, px), the mean of each joint (cm), and the suit's delay (ms). budget_cm: the mean distance that each error
        adds, and the root of the sum of their squares, to compare with that of all together.
    """
    rig = VirtualRig()
    rigs = {EXACT: rig.noise_free(), ALL: rig}
    rigs |= {name: rig.only(name) for name in errors or [*(name for name in ERRORS if name not in _RARE), *TRACKER_ERRORS]}
    if set(TRACKER_ERRORS) & set(rigs):
        rigs[WITH_TRACKER] = rig.model_copy(update={"tracker": Tracker()})
    asked = {"views": views, "pendulum_s": pendulum_s, "seconds": seconds, "seed": seed}
    try:
        plan = Plan(**asked, rate_hz=_TAKE_HZ, exercises=False)
    except ValidationError as error:
        raise explained(error, Plan, asked, lists="`cabinpose bench lab --help` lists them") from None
    sessions: dict[str, dict[str, Any]] = {}
    for name, each in rigs.items():
        with tempfile.TemporaryDirectory(prefix="cabinpose-lab-") as folder:
            sessions[name] = _session(Path(folder) / "session", each, plan)
        say(f"{name}: joints {sessions[name]['joints']['mean_cm']:.2f} cm, camera {sessions[name]['camera_mm']:.2f} mm")
    alone = {
        name: s["joints"]["mean_cm"] for name, s in sessions.items() if name not in (EXACT, ALL, WITH_TRACKER, *TRACKER_ERRORS)
    }
    root = float(np.sqrt(sum(value**2 for value in alone.values())))
    budget = {**alone, "root_of_squares": root, ALL: sessions[ALL]["joints"]["mean_cm"]}
    budget |= {name: s["joints"]["mean_cm"] for name, s in sessions.items() if name in (WITH_TRACKER, *TRACKER_ERRORS)}
    return {"plan": plan.model_dump(mode="json"), "budget_cm": budget, "sessions": sessions}


def _session(folder: Path, rig: VirtualRig, plan: Plan) -> dict[str, Any]:
    ((subject, truth),) = record_session(folder, rig, plan).items()
    found = calibrate(Session.load(folder / SESSION))
    with Recording(folder / drive_take(subject)) as recording:
        poses = {"as_worn": None, **_corrections(folder, found.calibration, subject)}
        errors = {
            how: joint_error(align_take(recording, _with_pose(found.calibration, subject, pose), subject), rig, truth)
            for how, pose in poses.items()
        }
        aligned = align_take(recording, found.calibration, subject)
    joints = errors["as_worn"]
    return {
        **asdict(calibration_error(found.calibration, rig, truth, subject)),
        "joints": {
            "frames": int(aligned.kept.sum()),
            "left_out": aligned.left_out,
            "mean_cm": joints.mean_cm,
            "median_cm": joints.median_cm,
            "mean_px": float(np.nanmean(joints.error_px)),
            "suit_delay_ms": joints.suit_delay_ms,
            "by_joint_cm": joints.by_joint(),
        },
        "pose_corrected": {
            how: {"mean_cm": each.mean_cm, "by_joint_cm": each.by_joint()} for how, each in errors.items() if how != "as_worn"
        },
    }


def _corrections(folder: Path, calibration: Calibration, subject: str) -> dict[str, PoseCorrection | None]:
    """The correction of the initial pose by each truth that it can be known by."""
    session = Session.load(folder / SESSION)
    asked = {truth: session.subjects[subject].model_copy(update={"pose_truth": truth}) for truth in ("n-pose", "optical")}
    return {truth: correct_pose(session.names, subject, each, calibration.head(subject).matrix) for truth, each in asked.items()}


def _with_pose(calibration: Calibration, subject: str, pose: PoseCorrection | None) -> Calibration:
    head = calibration.heads[subject].model_copy(update={"pose_correction": pose})
    return calibration.model_copy(update={"heads": calibration.heads | {subject: head}})
