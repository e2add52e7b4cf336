"""What the correction of suits' chains by depth is worth: people of the laboratory, before and after.

    python tests/lab/depth_correction.py --seed 7 S02 S04

prints, for suits as worn and with the initial pose corrected by the N-pose, the mean distance of joints from the truth (cm)
before and after, the mean of the paired differences over people with its 95 % interval (Student's t), and how many people are
worse off.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from scipy import stats

from cabinpose.align.project import align_take, correct_by_depth
from cabinpose.align.session import Session, calibrate
from cabinpose.app.lab.laboratory import record_session
from cabinpose.app.lab.plan import SESSION, Plan, drive_take
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.app.lab.score import joint_error
from cabinpose.store.recording import Recording

GROUPS = {
    "neck, chest": ("neck", "chest"), "shoulders": ("lshoulder", "rshoulder"), "elbows": ("lelbow", "relbow"),
    "wrists": ("lwrist", "rwrist"), "hands": ("lhand", "rhand"), "hip, pelvis": ("hip", "lpelvis", "rpelvis"),
    "knees": ("lknee", "rknee"), "ankles, feet": ("lankle", "rankle", "lfoot", "rfoot"),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("subjects", nargs="+")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=20.0)
    asked = parser.parse_args()
    plan = Plan(
        views=16, frames_per_view=1, pendulum_s=15, seconds=asked.seconds, rate_hz=2, exercises=False, seed=asked.seed,
        subjects=tuple(asked.subjects),
    )  # fmt: skip
    errors: dict[str, list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory(prefix="cabinpose-lab-") as made:
        folder, rig = Path(made) / "session", VirtualRig()
        truths = record_session(folder, rig, plan)
        calibration = calibrate(Session.load(folder / SESSION)).calibration
        for subject, truth in truths.items():
            with Recording(folder / drive_take(subject)) as recording:
                for corrected, how in ((False, "as worn"), (True, "N-pose")):
                    before = align_take(recording, calibration, subject, correct_pose=corrected)
                    (after,) = correct_by_depth(recording, [before], calibration)
                    for when, each in (("before", before), ("after", after)):
                        by_joint = joint_error(each, rig, truth).by_joint()
                        means = {name: float(np.mean([by_joint[joint] for joint in of])) for name, of in GROUPS.items()}
                        errors.setdefault(f"{how}, {when}", []).append(means | {"all": float(np.mean(list(by_joint.values())))})
    for how in ("as worn", "N-pose"):
        print(f"{how}, {len(truths)} people\njoints | before cm | after cm | difference cm | % | worse")
        for name in (*GROUPS, "all"):
            before, after = (np.array([each[name] for each in errors[f"{how}, {when}"]]) for when in ("before", "after"))
            step = after - before
            half = stats.t.ppf(0.975, len(step) - 1) * step.std(ddof=1) / np.sqrt(len(step)) if len(step) > 1 else np.nan
            share = 100 * (after.mean() / before.mean() - 1)
            print(
                f"{name} | {before.mean():.2f} | {after.mean():.2f} | {step.mean():+.2f} ({step.mean() - half:+.2f} to"
                f" {step.mean() + half:+.2f}) | {share:+.0f} | {(step > 0).sum()} of {len(step)}"
            )


if __name__ == "__main__":
    main()
