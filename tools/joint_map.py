"""How joints of other definitions are told as ours, and ours as theirs: `python tools/joint_map.py rig|plug_in_gait [COUNT]`.

Of the rig COUNT (1500) frames are generated with both, 200 random people in cars; of Plug-in Gait COUNT (200) adults of ANSUR
II sit with its markers on, in five postures each (`plug_in_gait.seated`). For each joint the weights of a few joints are found,
which sum to 1, by least squares with 8 mm of noise on each, as detectors have: so no weight makes much of a small distance.
Joints of the right side are the mirror image. Printed behind each joint: mean distance (mm) without and with the table, on other
people than it was fitted on.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from plug_in_gait import Wearer, joint_centres, seated

from cabinpose.app.cli import main
from cabinpose.core import CABINPOSE, JOINTS
from cabinpose.scene.body import BodyModel, Phenotype, load_population
from cabinpose.store import open_dataset

NOISE_M = 0.008
NEIGHBOURS = {
    "head": ("head", "neck", "chest"), "neck": ("neck", "head", "chest", "lshoulder", "rshoulder"),
    "chest": ("chest", "neck", "hip", "lshoulder", "rshoulder"), "hip": ("hip", "chest", "lpelvis", "rpelvis", "lknee", "rknee"),
    "lshoulder": ("lshoulder", "rshoulder", "neck", "chest", "lelbow"), "lhand": ("lhand", "lwrist", "lelbow"),
    "lpelvis": ("lpelvis", "rpelvis", "hip", "lknee"), "lknee": ("lknee", "lpelvis", "lankle"),
    "lankle": ("lankle", "lknee", "lfoot"), "lfoot": ("lfoot", "lankle"),
}  # fmt: skip
_ALIKE = {
    "lshoulder": ("lshoulder", "rshoulder", "lelbow"), "lelbow": ("lelbow", "lshoulder", "lwrist"),
    "lwrist": ("lwrist", "lelbow", "lshoulder"), "lhand": ("lhand", "lwrist", "lelbow"), "lknee": ("lknee", "lpelvis", "lankle"),
    "lankle": ("lankle", "lknee", "lfoot"), "lfoot": ("lfoot", "lankle", "lknee"),
}  # fmt: skip
_SHOULDERS, _THIGHS = ("lshoulder", "rshoulder"), ("lpelvis", "rpelvis", "lknee", "rknee")
OF_GAIT = _ALIKE | {
    "head": ("head", "chest", *_SHOULDERS, "hip"), "neck": ("head", "chest", *_SHOULDERS, "hip"),
    "chest": ("chest", "head", *_SHOULDERS, *_THIGHS), "hip": ("chest", *_SHOULDERS, *_THIGHS),
    "lpelvis": ("lpelvis", "rpelvis", "lshoulder", "chest", "lknee"),
}  # fmt: skip
TO_GAIT = _ALIKE | {
    "head": ("head", "neck", "chest", *_SHOULDERS), "chest": ("chest", "neck", "head", *_SHOULDERS, "hip"),
    "hip": ("hip", *_THIGHS), "lpelvis": ("lpelvis", "rpelvis", "hip", "lknee"),
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


def wearers(people: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.str_]]:
    """Joints (N, 20, 3) as ours and as Plug-in Gait's, whose `neck` is NaN, and who they are of."""
    rng, model, population = np.random.Generator(np.random.Philox(36)), BodyModel.load(), load_population("ansur")
    ours, theirs, who = [], [], []
    for number in range(people):
        size = population.draw(rng=rng, sex="male" if number % 4 < 2 else "female")
        person = model.person(Phenotype.of_size(size, rng=rng))
        wearer = Wearer(person)
        for _ in range(5):
            body = seated(person, rng=rng)
            found = joint_centres(wearer.markers(body), wearer.size)
            ours.append(body.joints)
            theirs.append([found.get(joint, np.full(3, np.nan)) for joint in JOINTS])
            who.append(f"{number:04d}")
    return np.array(ours), np.array(theirs), np.array(who)


def fitted(names: Sequence[str], joint: str, source: NDArray[np.float64], target: NDArray[np.float64]) -> dict[str, float]:
    """Weights of a joint's neighbours in the source (N, 20, 3), the first what is left to 1."""
    first, *others = (source[:, CABINPOSE.index[name]] for name in names)
    a = np.stack([(each - first).ravel() for each in others], axis=1)
    b = (target[:, CABINPOSE.index[joint]] - first).ravel()
    normal = a.T @ a + len(a) * NOISE_M**2 * (np.eye(a.shape[1]) + 1.0)  # of each other joint, and of the first in all columns
    weight = np.linalg.solve(normal, a.T @ b + len(a) * NOISE_M**2)
    return {names[0]: float(1 - weight.sum())} | dict(zip(names[1:], map(float, weight), strict=True))


def table(
    neighbours: Mapping[str, Sequence[str]], source: NDArray[np.float64], target: NDArray[np.float64], who: NDArray[np.str_]
) -> None:
    """Print the weights and what they are worth."""
    learnt = np.isin(who, sorted(set(who))[::2])
    for joint, names in neighbours.items():
        truth = target[~learnt, CABINPOSE.index[joint]]
        if not np.isfinite(truth).all():
            continue
        weights = fitted(names, joint, source[learnt], target[learnt])
        if joint[0] not in "lr":  # of the middle: the same on both sides
            weights = {name: (value + weights[other(name)]) / 2 for name, value in weights.items()}
        weights = {
            name: round(value, 4 if other(name) != name and joint[0] not in "lr" else 3) for name, value in weights.items()
        }
        weights[names[0]] = round(1.0 - sum(value for name, value in weights.items() if name != names[0]), 4)
        found = sum(value * source[~learnt, CABINPOSE.index[name]] for name, value in weights.items())
        before = np.linalg.norm(source[~learnt, CABINPOSE.index[joint]] - truth, axis=1).mean()
        after = np.linalg.norm(found - truth, axis=1).mean()
        sys.stdout.write(f'    "{joint}": {weights},  # {1e3 * before:.0f} -> {1e3 * after:.0f}\n')


def other(joint: str) -> str:
    """The joint of the other side; of the middle itself."""
    swapped = {"l": "r", "r": "l"}.get(joint[0], "") + joint[1:]
    return swapped if swapped in CABINPOSE.index else joint


if __name__ == "__main__":
    of, count = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else None
    ours, theirs, who = people(count or 1500) if of == "rig" else wearers(count or 200)
    sys.stdout.write(f"{len(who)} people, {len(set(who))} different\nfrom {of} to ours\n")
    table(NEIGHBOURS if of == "rig" else OF_GAIT, theirs, ours, who)
    sys.stdout.write(f"from ours to {of}\n")
    table(NEIGHBOURS if of == "rig" else TO_GAIT, ours, theirs, who)
