"""The picture of docs/believability.md: twelve outfits on seated people, without the sensor's noise.

    python tools/make_clothes.py --out docs/images/clothes.webp

Of each outfit colour, lit from the camera, and below it depth (bright is near).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from cabinpose.core import Camera, axis_rotation, invert, look_at
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import DOF_INDEX, DOFS, SUBJECTS, BodyModel, Outfit
from cabinpose.synth.person_look import look_of
from cabinpose.synth.pictures.look import person_colours
from cabinpose.synth.render import Rasteriser

WIDTH, HEIGHT, AWAY_M, GAP = 220, 250, 1.5, 4
MIDDLE = (0.12, 0.0, 0.36)
SEATED_DEG = {
    "hip.flexion": 82, "knee.flexion": 78, "hip.abduction": 9, "shoulder.flexion": 15, "shoulder.abduction": 12,
    "elbow.flexion": 55,
}  # fmt: skip
OUTFITS = (
    ("S01", Outfit("open_jacket", "jeans", hair="short")),
    ("S02", Outfit("shirt", "skirt", "leather", "long")),
    ("S13", Outfit("hoodie", "jeans", hair="short", beard=True, headwear="hood")),
    ("S14", Outfit("long_sleeve", "long_skirt", headwear="headscarf")),
    ("S04", Outfit("coat", "trousers", "leather", "short", headwear="beanie", scarf=True, gloves=True)),
    ("S18", Outfit("t_shirt", "dress", "leather", "bun", glasses="sun")),
    ("S07", Outfit("shirt", "trousers", "leather", "bald", glasses="clear")),
    ("S09", Outfit("turtleneck", "jeans", hair="medium", mask=True)),
    ("S10", Outfit("hoodie", "shorts", hair="short", headwear="cap")),
    ("S06", Outfit("coat", "long_skirt", "leather", "bun")),
    ("S08", Outfit("t_shirt", "shorts", hair="short", headwear="hat", glasses="sun")),
    ("S11", Outfit("jumper", "skirt", "leather", "medium", scarf=True)),
)


def seated() -> np.ndarray:
    """(D,) rad."""
    q = np.zeros(len(DOFS))
    for axis, degrees in SEATED_DEG.items():
        q[[DOF_INDEX[side + axis] for side in "lr"]] = np.radians(degrees)
    return q


def tiles() -> list[np.ndarray]:
    """(2 * HEIGHT, WIDTH, 3) uint8 of each outfit: colour and depth."""
    eye = Rasteriser(Camera.from_fov(WIDTH, HEIGHT, 0.66), supersample=1, see_through=())
    result = []
    for number, (name, outfit) in enumerate(OUTFITS):
        person = BodyModel.load().person(SUBJECTS[name].phenotype, outfit)
        surface = person.pose(seated(), np.eye(4)).surface(1)
        turned = axis_rotation("z", 0.5 if number % 2 else -0.15)
        start = MIDDLE + rp.matmul(turned, np.array((AWAY_M, 0.0, 0.55)))
        frame = eye.render(surface, invert(look_at(start, np.array(MIDDLE))), closed=True)
        seen, cosine = frame.face_id >= 0, np.nan_to_num(frame.buffers.cos_incidence)
        colours = person_colours(person, look_of(person, number, name), rng=np.random.Generator(np.random.Philox(key=number)))
        lit = np.where(seen[..., None], colours[frame.face_id] * (0.2 + 0.8 * cosine[..., None]), 0.35)
        depth = np.where(seen, 1.0 - (frame.depth_clean - frame.depth_clean[seen].min()) / 0.9, 0.0)
        colour = rp.power(np.clip(lit, 0.0, 1.0), 1.0 / 2.2)
        both = np.concatenate([colour, np.repeat(np.clip(depth, 0.0, 1.0)[..., None], 3, axis=2)])
        result.append(np.rint(255.0 * np.pad(both, ((0, GAP), (0, GAP), (0, 0)), constant_values=1.0)).astype(np.uint8))
    return result


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/images/clothes.webp"))
    args = parser.parse_args()
    made = tiles()
    rows = [np.concatenate(made[k : k + 6], axis=1) for k in (0, 6)]
    Image.fromarray(np.concatenate(rows)[:-GAP, :-GAP]).save(args.out, quality=80)


if __name__ == "__main__":
    main()
