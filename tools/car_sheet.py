"""One generated scene in each of the seven cars, on one picture: what the camera sees, and the people from three sides.

    python tools/car_sheet.py --occupants 1 --out docs/baseline/one-occupant.png
    python tools/car_sheet.py --occupants 5 --out docs/baseline/five-occupants.png

The scenes are frames of datasets that `cabinpose synth` makes of docs/examples/demo.yaml with one car and these seats taken;
cars that seat fewer people have as many as they seat. Beside the camera's image, people, seats, wheel and pedals are drawn as
nothing in the car sees them, from 12 m away with doors and roof left out: hands, feet and neighbours can be judged.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from cabinpose.app.view.draw import INVALID, amplitude_image, draw_skeleton
from cabinpose.core.camera import Camera
from cabinpose.core.frames import invert, look_at
from cabinpose.scene.cabin import PRESETS
from cabinpose.scene.labels import LABEL_ID, LAST_BODY_ID
from cabinpose.store import PERSON_COLOUR, Image, text
from cabinpose.synth import FrameMaker
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.scene import Scene

SEATS = ("driver", "front_passenger", "rear_left", "rear_right", "rear_center")  # the order in which --occupants fills a car
SIDES = {"from the left": (0.0, 1.0, 0.15), "from the front": (1.0, 0.0, 0.4), "from above": (-0.05, 0.0, 1.0)}  # vehicle frame
WIDTH, HEIGHT, GAP, CAPTION, MARGIN = 270, 220, 8, 22, 16
_AWAY_M = 12.0
_LIGHT = np.array((0.45, 0.35, 0.82))  # from the front, the left and above
_APART = 50  # frames: each car shows other people


def outside_view(scene: Scene, side: tuple[float, float, float]) -> Image:
    """People, seats, wheel, belts and pedals seen from a side, lit and coloured by person."""
    whole = scene.surface()
    furniture = [LABEL_ID[name] for name in ("seat", "steering_wheel", "pedal", "seat_belt")]
    shown = ((whole.label > 0) & (whole.label <= LAST_BODY_ID)) | np.isin(whole.label, furniture)
    kept = {name: getattr(whole, name)[shown] for name in ("faces", "label", "material", "instance")}
    joints = np.concatenate([p.posed.joints for p in scene.people])
    low, high = joints.min(axis=0) - (0.25, 0.3, 0.15), joints.max(axis=0) + (0.25, 0.3, 0.25)
    middle = (low + high) / 2
    vehicle_from_camera = look_at(middle + _AWAY_M * np.array(side) / np.linalg.norm(side), middle)
    extent = np.abs(vehicle_from_camera[:3, :2].T) @ (high - low)  # to the right and down, m
    focal = _AWAY_M * min(WIDTH / extent[0], HEIGHT / extent[1])
    camera = Camera(WIDTH, HEIGHT, focal, focal, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    face = Rasteriser(camera, supersample=1).render(replace(whole, **kept), invert(vehicle_from_camera)).face_id
    a, b, c = (whole.vertices[kept["faces"][:, k]].astype(np.float64) for k in range(3))
    normal = np.cross(b - a, c - a)
    light = 0.35 + 0.65 * np.abs(normal @ _LIGHT) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    colours = np.array([(150, 156, 166), *PERSON_COLOUR], np.float64)[kept["instance"]] * light[:, None]
    colours = np.where((kept["label"] == LABEL_ID["seat_belt"])[:, None], (224, 48, 48), colours)
    return np.where((face >= 0)[..., None], colours[face], INVALID).astype(np.uint8)


def row(config: SynthConfig, seed: int, index: int) -> tuple[str, list[Image]]:
    """Caption and pictures of one frame."""
    frame, scene = FrameMaker(config, seed).make(index)
    camera = amplitude_image(frame["amplitude"], float(np.quantile(frame["amplitude"], 0.995)))
    for joints, visibility in zip(frame["joints_2d"], frame["visibility"], strict=True):
        if np.isfinite(joints).any():
            draw_skeleton(camera, joints, visibility)
    small = cv2.resize(camera, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.uint8)
    who = "; ".join(f"{p.slot.replace('_', ' ')} {p.subject}, {p.action.replace('_', ' ')}" for p in scene.people)
    return f"{scene.place}   {who}", [small, *(outside_view(scene, side) for side in SIDES.values())]


def main() -> None:
    """Draw the sheet."""
    parser = argparse.ArgumentParser(description="One generated scene in each of the seven cars, on one picture.")
    parser.add_argument("--config", type=Path, default=Path("docs/examples/demo.yaml"), help="mix of scenes; %(default)s")
    parser.add_argument("--occupants", type=int, choices=range(1, 6), required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True, help="the picture (PNG)")
    arguments = parser.parse_args()
    config = SynthConfig.load(arguments.config)
    columns = ("camera, skeletons", *SIDES)
    shape = (MARGIN + CAPTION + len(PRESETS) * (HEIGHT + CAPTION + GAP) + MARGIN, 2 * MARGIN + len(columns) * (WIDTH + GAP) - GAP)
    sheet = np.full((*shape, 3), 248, np.uint8)
    for column, name in enumerate(columns):
        text(sheet, name, (MARGIN + column * (WIDTH + GAP), MARGIN + 10), size=15, weight=600)
    with threadpool_limits(1):
        for number, car in enumerate(PRESETS):
            taken = dict.fromkeys(SEATS[: arguments.occupants], 1.0)
            scene = config.scene.model_copy(update={"cars": (car,), "occupancy": taken})
            caption, pictures = row(config.model_copy(update={"scene": scene}), arguments.seed, _APART * number)
            top = MARGIN + CAPTION + number * (HEIGHT + CAPTION + GAP)
            text(sheet, caption, (MARGIN, top + 15), size=14)
            for column, picture in enumerate(pictures):
                left = MARGIN + column * (WIDTH + GAP)
                sheet[top + CAPTION : top + CAPTION + HEIGHT, left : left + WIDTH] = picture
    coarse = sheet[..., ::-1] & 0xF0  # 16 steps a colour: a third of the bytes of 256
    cv2.imwrite(str(arguments.out), coarse, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
