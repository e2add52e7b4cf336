"""Generated room frames beside real ITOP frames: a picture and a table.

    python tools/compare_itop.py FRAMES.npz --picture docs/images/itop.png
    python tools/compare_itop.py FRAMES.npz --scenes docs/models/room-top-scenes.yaml --picture docs/images/itop-top.png

FRAMES.npz holds real frames as `depth01` (N, 100, 100): columns 40 to 279 of 320x240, nearest neighbour, each frame
scaled by its own minimum and maximum (0 = hole), with `joints_3d` (N, 15, 3) in metres, y up. Generated frames are put
through the same crop, resize and scaling before anything is compared.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from cabinpose.core.skeleton import ITOP
from cabinpose.synth import FrameMaker
from cabinpose.synth.config import SynthConfig

SIZE = 100
BONES = (
    ("head", "neck"), ("neck", "rshoulder"), ("rshoulder", "relbow"), ("relbow", "rhand"), ("neck", "torso"),
    ("torso", "rhip"), ("rhip", "lhip"), ("rhip", "rknee"), ("rknee", "rfoot"),
)  # fmt: skip


def shrink(depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """(240, 320) metres, NaN invalid, or (100, 100) of its middle, to (100, 100) as the real frames are stored."""
    crop = np.nan_to_num(depth_m[:, 40:280] if depth_m.shape == (240, 320) else depth_m)
    small = cv2.resize(crop, (SIZE, SIZE), interpolation=cv2.INTER_NEAREST)
    return ((small - small.min()) / (small.max() - small.min())).astype(np.float32)


def statistics(depth01: NDArray[np.float32], joints_m: NDArray[np.float64]) -> dict[str, tuple[float, float, float]]:
    """Quartiles over frames of what a detector notices: holes, edges, grain, place and size of the body."""
    rows: dict[str, list[float]] = {}

    def add(name: str, value: float) -> None:
        rows.setdefault(name, []).append(value)

    for image, joints in zip(depth01, joints_m, strict=True):
        valid = image > 0
        both = valid[:, 1:] & valid[:, :-1]
        step = np.abs(np.diff(image, axis=1))[both] / image[valid].max()
        add("holes, % of pixels", 100 * (~valid).mean())
        add("edges (step > 3 % of range), % of pairs", 100 * (step > 0.03).mean())
        add("grain (median step), per mille of range", 1000 * float(np.median(step[step < 0.01])))
        add("background (median), % of range", 100 * float(np.median(image[valid])))
        add("distance of the torso, m", joints[ITOP.joints.index("torso"), 2])
        add("height of the feet, m from the axis", joints[-2:, 1].mean())
        for a, b in BONES:
            add(f"{a} to {b}, cm", 100 * float(np.linalg.norm(joints[ITOP.joints.index(a)] - joints[ITOP.joints.index(b)])))
    return {name: tuple(float(v) for v in np.percentile(values, (25, 50, 75))) for name, values in rows.items()}


def picture(real: NDArray[np.float32], ours: NDArray[np.float32], columns: int = 8) -> NDArray[np.uint8]:
    """Two rows of real frames above two rows of generated ones."""

    def strip(frames: NDArray[np.float32]) -> NDArray[np.uint8]:
        tiles = []
        for frame in frames:
            image = cv2.applyColorMap((255 * (1 - frame)).astype(np.uint8), cv2.COLORMAP_TURBO)
            image[frame == 0] = 0
            tiles.append(cv2.copyMakeBorder(cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST), 2, 2, 2, 2, 0))
        rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
        return np.asarray(np.vstack(rows), dtype=np.uint8)

    gap = np.full((24, columns * (2 * SIZE + 4), 3), 255, np.uint8)
    titles = [gap.copy(), gap.copy()]
    for title, text in zip(titles, ("real (ITOP)", "generated (cabinpose)"), strict=True):
        cv2.putText(title, text, (6, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
    return np.asarray(np.vstack((titles[0], strip(real), titles[1], strip(ours))), dtype=np.uint8)


def main() -> None:
    """Compare, print the table as Markdown and write the picture."""
    parser = argparse.ArgumentParser(description="Generated room frames beside real ITOP frames.")
    parser.add_argument("frames", type=Path, help="the .npz of real frames")
    parser.add_argument("--picture", type=Path, required=True)
    scenes = Path("docs/models/room-refined-scenes.yaml")
    parser.add_argument("--scenes", type=Path, default=scenes, help="the recipe of the generated frames")
    parser.add_argument("--count", type=int, default=64, help="generated frames")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    with np.load(arguments.frames) as data:
        real, real_joints = data["depth01"], data["joints_3d"].astype(np.float64)
    maker = FrameMaker(SynthConfig.load(arguments.scenes), arguments.seed)
    ours, joints = [], []
    for index in range(arguments.count):
        frame, _ = maker.make(index)
        ours.append(shrink(frame["depth"]))
        joints.append(frame["itop_joints_3d"][0] * (1, -1, 1))
    table = statistics(real, real_joints), statistics(np.stack(ours), np.stack(joints))
    print("| quartiles over frames | real | generated |\n|---|---|---|")
    for name in table[0]:
        cells = (" / ".join(f"{value:.3g}" for value in side[name]) for side in table)
        print(f"| {name} | {' | '.join(cells)} |")
    arguments.picture.parent.mkdir(parents=True, exist_ok=True)
    shown = np.linspace(0, len(real) - 1, 16).astype(int)
    cv2.imwrite(str(arguments.picture), picture(real[shown], np.stack(ours[:16])))


if __name__ == "__main__":
    main()
