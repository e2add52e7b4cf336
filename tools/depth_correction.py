"""What `cabinpose align --correct-depth` is worth: people of the laboratory's sessions, before and after.

    cabinpose lab --out s7 --seed 7 --subjects S02 S04 S07 --rate-hz 2 --no-exercises --views 16 --frames-per-view 1
    python tools/depth_correction.py s7

prints, for suits as worn and with the initial pose corrected by the N-pose, by group of joints: the mean distance from the truth
(cm) before and after, the mean of the paired differences over people with its 95 % interval (Student's t), and how many people
are worse off.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy import stats

from cabinpose.align import Session, align_take, calibrate, correct_by_depth
from cabinpose.app.lab.laboratory import load_rig, load_truth
from cabinpose.app.lab.plan import PAIR, RIG, SESSION, drive_take
from cabinpose.app.lab.score import joint_error
from cabinpose.core import JOINTS
from cabinpose.store.recording import Recording

GROUPS = {
    "neck, chest": ("neck", "chest"), "shoulders": ("lshoulder", "rshoulder"), "elbows": ("lelbow", "relbow"),
    "wrists": ("lwrist", "rwrist"), "hands": ("lhand", "rhand"), "hip, pelvis": ("hip", "lpelvis", "rpelvis"),
    "knees": ("lknee", "rknee"), "ankles, feet": ("lankle", "rankle", "lfoot", "rfoot"), "all": JOINTS,
}  # fmt: skip
WORN = {"as worn": False, "N-pose": True}


def errors(folder: Path, *, together: bool) -> dict[str, list[tuple[list[float], list[float]]]]:
    """By how the suit is worn, of each person: mean distance of `GROUPS`, cm, before and after.

    together: in the take of two people in one car, which are fitted by the same frames, instead of their drives.
    """
    rig = load_rig(folder / RIG)
    session = Session.load(folder / SESSION)
    calibration = calibrate(session).calibration
    found: dict[str, list[tuple[list[float], list[float]]]] = {how: [] for how in WORN}
    people = list(session.subjects)
    for take, subjects in {PAIR: people[:2]}.items() if together else {drive_take(each): [each] for each in people}.items():
        with Recording(folder / take) as recording:
            for how, corrected in WORN.items():
                worn = [align_take(recording, calibration, subject, correct_pose=corrected) for subject in subjects]
                fitted = correct_by_depth(recording, worn, calibration)
                for subject, before, after in zip(subjects, worn, fitted, strict=True):
                    truth = load_truth(folder, subject, together=together)
                    by_joint = [joint_error(each, rig, truth).by_joint() for each in (before, after)]
                    first, second = (
                        [float(np.mean([of[joint] for joint in group])) for group in GROUPS.values()] for of in by_joint
                    )
                    found[how].append((first, second))
                    print(f"{folder.name} {subject} {how}: {first[-1]:.2f} to {second[-1]:.2f} cm", flush=True)
    return found


def main() -> None:
    """Measure the sessions that are named, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", nargs="+", type=Path)
    parser.add_argument("--together", action="store_true", help="the takes of two people in one car instead of the drives")
    asked = parser.parse_args()
    measured = [errors(folder, together=asked.together) for folder in asked.sessions]
    for how in WORN:
        before, after = np.array([person for each in measured for person in each[how]]).transpose(1, 2, 0)  # (groups, people)
        step = after - before
        people = step.shape[1]
        half = stats.t.ppf(0.975, people - 1) * stats.sem(step, axis=1) if people > 1 else np.full(len(GROUPS), np.nan)
        print(f"\n{how}, {people} people\n")
        print("| joints | before cm | after cm | difference cm | % | worse |\n|---|---|---|---|---|---|")
        for name, was, now, by, wide, worse in zip(
            GROUPS, before.mean(axis=1), after.mean(axis=1), step.mean(axis=1), half, (step > 0).sum(axis=1), strict=True
        ):
            interval = f"{by:+.2f} ({by - wide:+.2f} to {by + wide:+.2f})"
            print(f"| {name} | {was:.2f} | {now:.2f} | {interval} | {100 * (now / was - 1):+.0f} | {worse} of {people} |")


if __name__ == "__main__":
    main()
