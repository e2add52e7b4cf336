"""The picture of docs/populations.md: eight heads, as a sensor would see them from near by, without its noise.

    python tools/make_faces.py --out docs/images/faces.webp

From top to bottom: amplitude (reflectance at 850 nm times the cosine of incidence), depth (bright is near), and colour, lit
from the camera. A head at the distance of a camera in a car has a tenth of these pixels.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from cabinpose.core import Camera, axis_rotation, invert, look_at
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import DOFS, SUBJECTS, BodyModel, Face
from cabinpose.scene.sensor.optics import material_table
from cabinpose.synth.person_look import look_of
from cabinpose.synth.pictures.look import near_infrared, person_colours
from cabinpose.synth.render import Rasteriser

WIDTH, HEIGHT, AWAY_M, GAP = 168, 208, 0.9, 4
BOTH = ("Left", "Right")
SMILE = tuple((f"{unit}{side}", share) for unit, share in (("mouthSmile", 0.7), ("cheekSquint", 0.4)) for side in BOTH)
AROUND = 0.45  # rad, by which the camera stands aside of every second one
HEADS = (
    ("S01", Face()),
    ("S02", Face(expression="smiling", units=SMILE)),
    ("S10", Face(gaze=(0.8, 0.6, 0.0))),
    ("S11", Face(expression="laughing", units=(*SMILE, ("jawOpen", 0.3)))),
    ("S14", Face(expression="yawning", lids=(0.7, 0.7), units=(("jawOpen", 0.9), ("browInnerUp", 0.3)))),
    ("S15", Face(lids=(0.45, 0.45), gaze=(0.96, 0.0, -0.28))),
    ("S16", Face(lids=(0.0, 0.0))),
    ("S05", Face(gaze=(0.9, -0.3, 0.316))),
)


def columns() -> list[np.ndarray]:
    """(3 * HEIGHT + 2 * GAP, WIDTH, 3) uint8 of each head."""
    camera = Camera.from_fov(WIDTH, HEIGHT, 0.27)
    eye = Rasteriser(camera, supersample=1, see_through=())
    result = []
    for number, (name, face) in enumerate(HEADS):
        phenotype, outfit = SUBJECTS[name]
        person = BodyModel.load().person(phenotype, outfit)
        posed = person.pose(np.zeros(len(DOFS)), np.eye(4))
        middle = posed.eyes_m - (0.06, 0.0, 0.03)
        start = middle + AWAY_M * axis_rotation("z", AROUND * (number % 2))[:, 0]
        surface = posed.surface(1, face)
        frame = eye.render(surface, invert(look_at(start, middle)))
        seen, cosine = frame.face_id >= 0, np.nan_to_num(frame.buffers.cos_incidence)
        colours = person_colours(person, look_of(person, number, name), rng=np.random.Generator(np.random.Philox(key=number)))
        tints = near_infrared(surface, material_table(True, True, 0.0, 0.0)) / 0.8, colours
        shaded = [np.where(seen[..., None], tint[frame.face_id] * cosine[..., None], 0.0) for tint in tints]
        depth = np.where(seen, (AWAY_M + 0.08 - frame.depth_clean) / 0.2, 0.0)
        amplitude, colour = (rp.power(np.clip(image, 0.0, 1.0), 1.0 / 2.2) for image in shaded)
        rows = amplitude, np.repeat(np.clip(depth, 0.0, 1.0)[..., None], 3, axis=2), colour
        column = np.concatenate([np.pad(row, ((0, GAP), (0, GAP), (0, 0)), constant_values=1.0) for row in rows])
        result.append(np.rint(255.0 * column).astype(np.uint8)[:-GAP])
    return result


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/images/faces.webp"))
    args = parser.parse_args()
    Image.fromarray(np.concatenate(columns(), axis=1)[:, :-GAP]).save(args.out, quality=80)


if __name__ == "__main__":
    main()
