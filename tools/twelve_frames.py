"""Twelve frames of a seed that was fixed beforehand, to be looked at with twenty questions: `twelve_frames.py OUT.webp`.

Questions and what is asked of each frame were written before the frames were drawn; everything else the seed decides. Depth and
amplitude lie beside each other at the sensor's own size. The answers are in docs/believability.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

import cabinpose
from cabinpose.app.view.draw import amplitude_image, depth_image
from cabinpose.store import text

SEED, COLUMNS, CAPTION, GAP = 37, 2, 22, 6
CARS = "scene.cars=[hatchback, sedan, suv, van]"
SENSOR = "camera.sensor=pico_monstar_105/4"  # 352 x 287 pixels
FRONT, REAR = "camera.views={front_row: 1}", "camera.views={rear: 1}"
PAIR = "scene.occupancy={driver: 1, front_passenger: 1}"
FULL = "scene.occupancy={driver: 1, front_passenger: 1, rear_left: 1, rear_center: 1, rear_right: 1}"
CHILDREN, THINGS = "scene.children=1", "scene.objects={rear_center: {bag: 1}, rear_right: {box: 1}}"


class Asked(NamedTuple):
    """A frame: what stands above it, and the keys of its configuration."""

    caption: str
    keys: tuple[str, ...]


def pair(driver: str, passenger: str, *more: str) -> tuple[str, ...]:
    """Two people in the front row who do this."""
    acts = f"scene.motion={{driver: {{{driver}: 1}}, front_passenger: {{{passenger}: 1}}}}"
    return (PAIR, FRONT, "scene.in_hand=1", acts, *more)


FRAMES = (
    Asked("drives; telephones", pair("drive", "phone_ear")),
    Asked("drives with one hand; drinks", pair("drive_one_hand", "drink")),
    Asked("gear; screen", pair("gear", "reach_infotainment")),
    Asked("mirror; sun visor", pair("adjust_mirror", "sun_visor")),
    Asked("telephones; reads", pair("phone_ear", "read")),
    Asked("drinks; belt", pair("drink", "belt")),
    Asked("anything", (PAIR, FRONT)),
    Asked("anything", (PAIR, FRONT)),
    Asked("anybody, five people", (FULL, FRONT)),
    Asked("anybody, from the rear", (FULL, REAR)),
    Asked("children in the rear", (PAIR, REAR, CHILDREN, "scene.child_seats={rear_left: toddler, rear_right: booster}")),
    Asked("infant in the rear, things", (PAIR, REAR, CHILDREN, "scene.child_seats={rear_left: infant}", THINGS)),
)
QUESTIONS = (
    "Is every hand that drives on the rim, with fingers round it?",
    "Is each telephone that is heard at ear and cheek, in a hand that holds it?",
    "Do fingers close round cups and bottles, and are their openings at the lips?",
    "Is the hand at the gear on its knob?",
    "Do fingers end at screen, mirror and visor, neither before nor in them?",
    "Do hands at belts and books touch them?",
    "Do feet that are seen stand on the floor or a pedal?",
    "Do the legs of passengers differ left and right in some frame, and does nobody's leg go through something?",
    "Do belts run over shoulder, breast and pelvis without a gap or a cut?",
    "Do straps hold the child in its seat over both shoulders?",
    "Does the belt of the child on the booster lie on the thighs?",
    "Is cloth that loses depth or is dark in amplitude dark by its label, and other cloth bright?",
    "Is hair darker than the face in amplitude where its label says so?",
    "Do three people wear something that is not the silhouette of a shirt?",
    "Are hems and prints free of jags?",
    "Are there folds where elbows, hips and knees bend?",
    "Are the backs of seats closed, and nothing seen through them?",
    "Does everything that lies in the car rest on something, and is none of it in a person?",
    "Are mixed pixels no more than a thin rim at silhouettes, and noise larger where amplitude is small?",
    "Would a stranger say of all twelve that people sit in a car?",
)


def drawn(number: int, asked: Asked) -> Image.Image:
    """Caption, depth between its own 1st and 99th percentile, amplitude."""
    frame = next(cabinpose.generate(*asked.keys, CARS, SENSOR, frames=1, seed=SEED + number))
    near, far = np.nanquantile(frame["depth"], (0.01, 0.99))
    bright = float(np.quantile(frame["amplitude"], 0.97))
    pictures = depth_image(frame["depth"], float(near), float(far)), amplitude_image(frame["amplitude"], bright)
    sheet = np.full((CAPTION + len(pictures[0]), 2 * pictures[0].shape[1], 3), 255, np.uint8)
    sheet[CAPTION:] = np.concatenate(pictures, axis=1)
    text(sheet, asked.caption, (2, CAPTION - 6))
    return Image.fromarray(sheet)


def main() -> None:
    """Draw the sheet, and print the questions."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    cells = [drawn(number, asked) for number, asked in enumerate(FRAMES)]
    width, height = cells[0].width + GAP, cells[0].height + GAP
    sheet = Image.new("RGB", (COLUMNS * width - GAP, -(-len(cells) // COLUMNS) * height - GAP), (255, 255, 255))
    for n, cell in enumerate(cells):
        sheet.paste(cell, (n % COLUMNS * width, n // COLUMNS * height))
    sheet.save(out, quality=70, method=6)
    for n, question in enumerate(QUESTIONS, 1):
        print(f"{n}. {question}")


if __name__ == "__main__":
    main()
