"""Your own car: a mesh as a modelling tool exports it, and the YAML that says where its seats and its wheel are.

A preset stands in for your mesh here: it is written as glTF, y up and in centimetres, as such files come. Axes and unit are
detected; `Cabin.notes` says what was found. The YAML then takes the place of a preset's name in a configuration.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
import yaml

from cabinpose.core import apply
from cabinpose.scene.cabin import Cabin, build_cabin, load_cabin
from cabinpose.synth import SynthConfig, generate

GLTF_FROM_VEHICLE = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])  # glTF: y up, z forward
CENTIMETRES = 100


def write_mesh(cabin: Cabin, path: Path) -> None:
    """What your modelling tool does."""
    vehicle_from_group = cabin.group_transforms({})
    scene = trimesh.Scene()
    for part in cabin.parts:
        vertices = apply(vehicle_from_group[part.group], part.surface.vertices) @ GLTF_FROM_VEHICLE.T * CENTIMETRES
        scene.add_geometry(trimesh.Trimesh(vertices, part.surface.faces, process=False), node_name=part.name)
    scene.export(path)


def describe(cabin: Cabin, mesh: Path) -> dict[str, object]:
    """What you measure in your car: points in the vehicle frame (m), travel in mm, and which mesh belongs to what."""
    driver = cabin.seats["driver"]
    low, high = driver.ranges
    wheel = cabin.steering_wheel
    assert wheel is not None
    return {
        "mesh": mesh.name,
        "seats": {
            "driver": {
                "h_point": driver.design_h_point.round(4).tolist(),
                "fore_aft_mm": [1000 * low.fore_aft_m, 1000 * high.fore_aft_m],
                "height_mm": [1000 * low.height_m, 1000 * high.height_m],
                "torso_angle_deg": float(np.degrees(driver.default.torso_angle)),
                "torso_angle_range_deg": np.degrees([low.torso_angle, high.torso_angle]).tolist(),
            }
        },
        "steering_wheel": {
            "centre": wheel.vehicle_from_wheel[:3, 3].tolist(),
            "axis": wheel.vehicle_from_wheel[:3, 2].tolist(),
            "diameter_mm": 2000 * (wheel.rim_radius_m + wheel.rim_section_m),
        },
        "pedals": {name: {"point": pad[:3, 3].tolist()} for name, pad in cabin.pedals.items()},
        "rules": [
            {
                "pattern": "*driver*cushion*",
                "group": "seat:driver/base",
                "label": "seat",
                "material": "seat_fabric",
                "give_mm": 55,
            },
            {
                "pattern": "*driver*backrest*",
                "group": "seat:driver/back",
                "label": "seat",
                "material": "seat_fabric",
                "give_mm": 50,
            },
            {"pattern": "*driver*headrest*", "group": "seat:driver/headrest", "label": "seat", "material": "seat_fabric"},
            {"pattern": "*wheel*", "group": "wheel", "label": "steering_wheel", "material": "steering_leather"},
        ],
    }


def main() -> None:
    stand_in = build_cabin("hatchback")
    mesh, description = Path("my_car.glb"), Path("my_car.yaml")
    write_mesh(stand_in, mesh)
    description.write_text(yaml.safe_dump(describe(stand_in, mesh), sort_keys=False), encoding="utf-8")

    cabin = load_cabin(description)
    print(f"{cabin.name}: {len(cabin.parts)} parts, seats {', '.join(cabin.seats)}, views {', '.join(cabin.views)}")
    print(*cabin.notes, sep="\n")

    config = SynthConfig.parse(
        {
            "scene": {"kind": "cabin", "cars": [str(description)], "occupancy": {"driver": 1.0}},
            "camera": {"views": {"driver": 1.0}},
        }
    )
    report = generate(config, 5, Path("my-car-dataset"), seed=1, workers=1, existing="overwrite")
    print(f"{report.frames} frames, {100 * report.acceptance:.0f} % of {report.proposals} poses accepted")


if __name__ == "__main__":
    main()
