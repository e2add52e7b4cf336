"""A small dataset whose every pixel has a closed form: people made of spheres before a wall.

Used where a test needs a dataset but not a generator. Nothing here calls the package's camera or renderer.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.core.skeleton import JOINTS
from cabinpose.store import Manifest, PartWriter, create_dataset

WALL_M = 2.5
LABELS = [
    {"id": 0, "name": "background", "rgb": 0x000000},
    {"id": 14, "name": "torso_left", "rgb": 0x00FAAA},
    {"id": 29, "name": "head_left", "rgb": 0xAA55AA},
    {"id": 71, "name": "wall", "rgb": 0xA0A8A0},
]
CARS, POVS, ACTIONS = ("sedan", "van", "coupe"), ("driver", "front_row"), ("gaussian", "mocap")
SUBJECTS = ("S01", "S02", "S03", "S04")


def camera_k(width: int, height: int) -> np.ndarray:
    return np.array([[0.8 * width, 0, (width - 1) / 2], [0, 0.8 * width, (height - 1) / 2], [0, 0, 1.0]])


def manifest(*, frames: int = 5, frames_per_part: int = 2, width: int = 64, height: int = 48, **changes: Any) -> Manifest:
    values: dict[str, Any] = {
        "generator": "spheres", "generator_version": "1.0", "seed": 7, "licence": "CC0-1.0", "frames": frames,
        "frames_per_part": frames_per_part, "width": width, "height": height, "labels": LABELS,
        "config": {"scene": {"wall_m": WALL_M, "cars": list(CARS)}, "small": 1e-5},
    }  # fmt: skip
    return Manifest(**(values | changes))


def frame(index: int, manifest: Manifest) -> dict[str, Any]:
    """Frame `index`: up to three people of a head and a torso sphere, noise from Philox(seed, index)."""
    rng = np.random.Generator(np.random.Philox(key=(manifest.seed, index)))
    width, height, persons = manifest.width, manifest.height, len(manifest.persons)
    k = camera_k(width, height)
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack(((u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u, float)), -1)
    depth = np.full((height, width), WALL_M)
    labels = np.full((height, width), 71, np.uint8)
    instance = np.zeros((height, width), np.uint8)
    joints = np.full((persons, len(JOINTS), 3), np.nan, np.float32)
    visibility = np.zeros((persons, len(JOINTS)), np.uint8)
    subject = [""] * persons
    for person in range(min(persons, 1 + index % 3)):
        subject[person] = SUBJECTS[(index + person) % len(SUBJECTS)]
        centre = np.array([-0.5 + 0.5 * person + rng.normal(0, 0.02), 0.1, 1.2 + 0.2 * person])
        for radius, offset, label in ((0.25, 0.0, 14), (0.12, -0.38, 29)):
            c = centre + (0, offset, 0)
            b, norm2 = rays @ c, (rays**2).sum(-1)
            root = b * b - norm2 * (c @ c - radius * radius)
            hit = root > 0
            t = np.where(hit, (b - np.sqrt(np.where(hit, root, 0))) / norm2, np.inf)
            nearer = t < depth
            depth[nearer], labels[nearer], instance[nearer] = t[nearer], label, person + 1
        joints[person] = centre + np.stack([np.linspace(-0.1, 0.1, 20), np.linspace(-0.38, 0.2, 20), np.zeros(20)], -1)
        visibility[person] = np.tile([4, 4, 3, 2, 4], 4)
    uvw = joints @ k.T
    with np.errstate(invalid="ignore"):
        uv = uvw[..., :2] / uvw[..., 2:]
    outside = ~((uv >= -0.5) & (uv < (width - 0.5, height - 0.5))).all(-1) & (visibility > 0)
    visibility[outside] = 1
    noisy = depth + rng.normal(0, 0.004, depth.shape)
    noisy[rng.random(depth.shape) < 0.02] = np.nan
    amplitude = np.clip(3000 / depth**2 + rng.normal(0, 20, depth.shape), 0, 65535).astype(np.uint16)
    return {
        "depth": noisy.astype(np.float32), "depth_clean": depth.astype(np.float32), "amplitude": amplitude,
        "confidence": np.clip(amplitude // 12, 0, 255).astype(np.uint8), "labels": labels, "instance": instance,
        "joints_3d": joints, "joints_2d": uv.astype(np.float32), "visibility": visibility,
        "camera_k": k, "camera_dist": np.zeros(5), "vehicle_from_camera": np.eye(4),
        "sync_ns": index * 66_666_667, "sequence": index // 10, "seed": manifest.seed, "subject": subject,
        "action": [ACTIONS[index % 2] if name else "" for name in subject], "car": CARS[index % 3], "pov": POVS[index // 2 % 2],
    }  # fmt: skip


def write(folder: Path, manifest: Manifest, *, resume: bool = False) -> Path:
    """The whole dataset, or what is missing of it."""
    with create_dataset(folder, manifest, resume=resume) as writer:
        for plan in writer.missing():
            with PartWriter(folder, plan, manifest) as part:
                for index in range(plan.first, plan.first + plan.frames):
                    part.append(frame(index, manifest))
                part.attrs |= {"proposals": plan.frames + 3, "rejections": {"car": 2, "self": 1}}
    return folder


PERSONS = OCCUPANT_SLOTS
