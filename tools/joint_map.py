"""How the joints of `core.RIG` are told as ours, and ours as the rig's: `python tools/joint_map.py [FRAMES]` prints both tables.

Generates FRAMES (1500) with both, 200 random people in cars, and finds for each joint the weights of a few joints, which
sum to 1, by least squares with 8 mm of noise on each, as detectors have: so no weight makes much of a small distance. Joints of
the right side are the mirror image. Printed behind each joint: mean distance (mm) without and with the table, on frames of other
people than it was fitted on.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.cli import main
from cabinpose.core import CABINPOSE
from cabinpose.store import open_dataset

NOISE_M = 0.008
NEIGHBOURS = {
    "head": ("head", "neck", "chest"), "neck": ("neck", "head", "chest", "lshoulder", "rshoulder"),
    "chest": ("chest", "neck", "hip", "lshoulder", "rshoulder"), "hip": ("hip", "chest", "lpelvis", "rpelvis", "lknee", "rknee"),
    "lshoulder": ("lshoulder", "rshoulder", "neck", "chest", "lelbow"), "lhand": ("lhand", "lwrist", "lelbow"),
    "lpelvis": ("lpelvis", "rpelvis", "hip", "lknee"), "lknee": ("lknee", "lpelvis", "lankle"),
    "lankle": ("lankle", "lknee", "lfoot"), "lfoot": ("lfoot", "lankle"),
}  # fmt: skip


def people(frames: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.str_]]:
    """Joints (N, 20, 3) as ours and as the rig's, and who they are of."""
    with tempfile.TemporaryDirectory() as name:
        out = Path(name) / "data"
        main(["synth", "--frames", str(frames), "--seed", "36", "--workers", "2", "--out", str(out),
              "output.skeletons=[rig]", "people={subjects: [], random: {count: 200}}"])  # fmt: skip
        dataset = open_dataset(out)[["joints_3d", "rig_joints_3d", "subject"]].load()
    ours, rig = dataset["joints_3d"].values, dataset["rig_joints_3d"].values
    there = np.isfinite(ours).all(axis=(2, 3))
    return ours[there].astype(float), rig[there].astype(float), dataset["subject"].values[there].astype(str)


def fitted(joint: str, source: NDArray[np.float64], target: NDArray[np.float64]) -> dict[str, float]:
    """Weights of a joint's neighbours in the source (N, 20, 3), the first what is left to 1."""
    names = NEIGHBOURS[joint]
    first, *others = (source[:, CABINPOSE.index[name]] for name in names)
    a = np.stack([(each - first).ravel() for each in others], axis=1)
    b = (target[:, CABINPOSE.index[joint]] - first).ravel()
    normal = a.T @ a + len(a) * NOISE_M**2 * (np.eye(a.shape[1]) + 1.0)  # of each other joint, and of the first in all columns
    weight = np.linalg.solve(normal, a.T @ b + len(a) * NOISE_M**2)
    return {names[0]: float(1 - weight.sum())} | dict(zip(names[1:], map(float, weight), strict=True))


def table(source: NDArray[np.float64], target: NDArray[np.float64], who: NDArray[np.str_]) -> None:
    """Print the weights and what they are worth."""
    learnt = np.isin(who, sorted(set(who))[::2])
    for joint in NEIGHBOURS:
        weights = {name: round(value, 3) for name, value in fitted(joint, source[learnt], target[learnt]).items()}
        weights[joint] = round(1.0 - sum(value for name, value in weights.items() if name != joint), 3)
        found = sum(value * source[~learnt, CABINPOSE.index[name]] for name, value in weights.items())
        truth = target[~learnt, CABINPOSE.index[joint]]
        before = np.linalg.norm(source[~learnt, CABINPOSE.index[joint]] - truth, axis=1).mean()
        after = np.linalg.norm(found - truth, axis=1).mean()
        sys.stdout.write(f'    "{joint}": {weights},  # {1e3 * before:.0f} -> {1e3 * after:.0f}\n')


if __name__ == "__main__":
    ours, rig, who = people(int(sys.argv[1]) if len(sys.argv) > 1 else 1500)
    sys.stdout.write(f"{len(who)} people in frames, {len(set(who))} different\nfrom the rig's to ours\n")
    table(rig, ours, who)
    sys.stdout.write("from ours to the rig's\n")
    table(ours, rig, who)
