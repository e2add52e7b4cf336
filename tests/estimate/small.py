"""Small data for the tests of the estimation: frames of sphere people in memory, and settings of tiny networks."""

from __future__ import annotations

from typing import Any

import numpy as np
import sphere_people
import xarray as xr

from cabinpose.core.skeleton import JOINTS
from cabinpose.estimate.methods import METHODS, NetworkMethod

PERSONS = ("driver", "front_passenger", "rear_left")
SIZE = (64, 48)
NETWORKS = sorted(name for name in METHODS.names(own=True) if isinstance(METHODS[name], NetworkMethod))
TINY: dict[str, dict[str, Any]] = {
    "compact": {"width": 64, "height": 48, "focal": 51.2, "channels": (4, 4, 8, 8), "blocks": (1, 1, 1), "slots": PERSONS},
    "paf": {"width": 64, "height": 48, "focal": 51.2, "channels": 0.05, "slots": PERSONS},
    "lifting": {"width": 16, "blocks": 1, "dropout": 0.1, "slots": PERSONS},
    "yolo": {"width": 64, "height": 48, "focal": 51.2, "channels": (4, 4, 8, 8), "blocks": (1, 1, 1), "slots": PERSONS},
    "unet": {"width": 64, "height": 48, "focal": 51.2, "channels": 2, "levels": 2, "slots": PERSONS},
}


def manifest(frames: int) -> Any:
    return sphere_people.manifest(frames=frames, frames_per_part=frames, width=SIZE[0], height=SIZE[1], persons=PERSONS)


def frame(index: int) -> dict[str, Any]:
    """Frame `index` as it is stored; each shows other people than the next, so that subjects can be held out."""
    made = sphere_people.frame(index, manifest(index + 1))
    made["subject"] = [f"{'AB'[index % 4 == 3]}{person}" if name else "" for person, name in enumerate(made["subject"])]
    return made


def dataset(frames: int = 8) -> xr.Dataset:
    """The frames with the variables and coordinates of the dataset standard, in memory."""
    made = [frame(i) for i in range(frames)]
    dims = {
        "depth": ("frame", "y", "x"), "amplitude": ("frame", "y", "x"), "labels": ("frame", "y", "x"),
        "joints_3d": ("frame", "person", "joint", "xyz"), "joints_2d": ("frame", "person", "joint", "uv"),
        "visibility": ("frame", "person", "joint"), "camera_k": ("frame", "k_row", "k_column"),
        "camera_dist": ("frame", "dist_coefficient"), "subject": ("frame", "person"), "seed": ("frame",),
    }  # fmt: skip
    variables = {name: (d, np.stack([np.asarray(f[name]) for f in made])) for name, d in dims.items()}
    coordinates = {"frame": np.arange(frames), "person": list(PERSONS), "joint": list(JOINTS)}
    return xr.Dataset(variables, coordinates).set_coords(["subject", "seed"])
