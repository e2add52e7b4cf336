"""Seats and steering wheels of unknown meshes: the presets', part by part and all in one, and what is no seat."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from car_meshes import GLTF_FROM_VEHICLE, write_car

from cabinpose.core.frames import apply
from cabinpose.scene.cabin import PRESETS, Cabin, build_cabin, load_cabin
from cabinpose.scene.cabin.car_draft import draft_car_file
from cabinpose.scene.cabin.car_file import read_car_file
from cabinpose.scene.cabin.find_seats import find_seats
from cabinpose.scene.cabin.imported import file_from_vehicle

FRONT = ("driver", "front_passenger")
TOLERANCE_M = 0.06


def drafted(cabin: Cabin, folder: Path, *, fused: bool) -> tuple[Cabin, dict[str, float]]:
    """The car as it comes back from a mesh by way of a draft, and by how much each H-point is off in the mesh's frame, m."""
    mesh = write_car(cabin, folder / "car.glb", fused=fused, factor=100.0)
    path = folder / "car.yaml"
    path.write_text(draft_car_file(mesh, path).text, encoding="utf-8")
    found = load_cabin(path)
    to_file = file_from_vehicle(path, read_car_file(path).model_copy(update={"points": "mesh"}))
    off = {
        slot: np.linalg.norm(apply(to_file, found.seats[slot].design_h_point) / 100 - GLTF_FROM_VEHICLE @ seat.design_h_point)
        for slot, seat in cabin.seats.items()
        if slot in found.seats
    }
    return found, off


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fused"),
    [(name, fused) for name in PRESETS if name != "shuttle" for fused in (True, False)],
)
def test_seats_and_wheel_of_the_presets_are_found(name: str, fused: bool, tmp_path: Path) -> None:
    cabin = build_cabin(name)
    found, off = drafted(cabin, tmp_path, fused=fused)
    assert set(found.seats) == set(cabin.seats)
    assert max(off.values()) < TOLERANCE_M
    assert found.steering_wheel is not None
    assert cabin.steering_wheel is not None
    assert found.steering_wheel.vehicle_from_wheel[:3, 2] @ cabin.steering_wheel.vehicle_from_wheel[:3, 2] > 0.999
    assert np.isclose(found.steering_wheel.rim_radius_m, cabin.steering_wheel.rim_radius_m, atol=0.01)
    assert found.drive_side == "left"
    assert not found.warnings


@pytest.mark.slow
def test_right_hand_drive_is_told_by_the_wheel(tmp_path: Path) -> None:
    found, off = drafted(build_cabin("sedan", drive_side="right"), tmp_path, fused=True)
    assert found.drive_side == "right"
    assert found.seats["driver"].design_h_point[1] < 0
    assert max(off[slot] for slot in FRONT) < TOLERANCE_M


@pytest.mark.slow
def test_facing_benches_are_found_without_a_wheel(tmp_path: Path) -> None:
    found, off = drafted(build_cabin("shuttle"), tmp_path, fused=True)
    assert found.steering_wheel is None
    assert [seat.facing_yaw > 3 for seat in found.seats.values()] == [True, True, False, False, False]
    assert off["rear_center"] < TOLERANCE_M  # nobody can tell how many sit on a bench of 1.7 m, and where


@pytest.mark.slow
def test_a_car_that_looks_backward_is_turned(tmp_path: Path) -> None:
    surface = build_cabin("sedan").surface()
    turned = surface.vertices * (-1.0, -1.0, 1.0)
    trimesh.Trimesh(turned, surface.faces, process=False).export(tmp_path / "car.ply")
    draft = draft_car_file(tmp_path / "car.ply", tmp_path / "car.yaml")
    assert "front axis -x: the seats look that way, not to x" in draft.notes
    assert "front_axis: -x  # the seats look that way, not to x" in draft.text
    assert not any(seat.backward for seat in draft.seats.values())


def test_a_box_has_no_seats() -> None:
    """How a draft says so is in `tests/cli/test_car.py`."""
    assert find_seats(np.asarray(trimesh.creation.box((3.0, 1.6, 1.2)).triangles)) == []


@pytest.mark.slow
def test_what_was_not_found_stands_there_as_an_example(tmp_path: Path) -> None:
    mesh = write_car(build_cabin("shuttle"), tmp_path / "car.glb", fused=True)
    lines = draft_car_file(mesh, tmp_path / "car.yaml").text.splitlines()
    assert "# steering_wheel:  # not found: an example for this driver" in lines
    examples = [line.removeprefix("# ") for line in lines if line.startswith(("# steering_wheel", "#   centre", "#   axis"))]
    assert len(examples) == 3
