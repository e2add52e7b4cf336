"""Parts of an own car: boxes of a mesh, pieces that stay solid, open meshes that are told of, automatic views that are free."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from car_meshes import write_car

from cabinpose.scene.cabin import PRESETS, Cabin, build_cabin, load_cabin
from cabinpose.scene.cabin.default_views import CLEAR_OF_CAMERA
from cabinpose.scene.cabin.mesh_parts import faces_within, open_warning, openness
from cabinpose.scene.contact import ContactField

SEAT_BOX = [[-1.15, 0.05, 0.03], [-0.35, 0.7, 0.36]]  # the cushion of the sedan's driver, vehicle frame, m


def describe(folder: Path, cabin: Cabin, mesh: str, **extra: Any) -> Path:
    seats = {slot: {"h_point": seat.design_h_point.round(4).tolist()} for slot, seat in cabin.seats.items()}
    path = folder / "car.yaml"
    path.write_text(yaml.safe_dump({"mesh": mesh, "seats": seats, **extra}), encoding="utf-8")
    return path


def without(mesh: trimesh.Trimesh, keep: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[np.sort(keep)], process=False)


def lattice(parts: int = 24) -> trimesh.Trimesh:
    """A sphere of some thousand triangles."""
    return trimesh.creation.icosphere(subdivisions=parts // 6)


def test_a_box_takes_whole_pieces_and_leaves_them_solid(tmp_path: Path) -> None:
    cabin = build_cabin("sedan")
    write_car(cabin, tmp_path / "car.glb", fused=True)
    rule = {"pattern": "*", "within": SEAT_BOX, "label": "seat", "give_mm": 55, "group": "seat:driver/base"}
    loaded = load_cabin(describe(tmp_path, cabin, "car.glb", rules=[rule]))
    seat = [part for part in loaded.parts if part.group == "seat:driver/base"]
    assert [part.solid for part in seat] == [True]
    cushion = next(part for part in cabin.parts if part.name == "driver cushion")
    assert len(seat[0].surface.faces) >= len(cushion.surface.faces)
    assert seat[0].give_m == 0.055
    others = [part for part in loaded.parts if part.group == "body"]
    assert sum(len(part.surface.faces) for part in (*seat, *others)) == sum(len(p.surface.faces) for p in cabin.parts)
    assert all(part.give_m == 0 for part in others)
    assert seat[0].mesh == others[0].name
    assert not any(part.mesh for part in others)


def test_a_box_in_the_meshs_own_frame(tmp_path: Path) -> None:
    cabin = build_cabin("sedan")
    write_car(cabin, tmp_path / "car.glb", fused=True, factor=100.0)
    corners = [[100 * y, 100 * z, 100 * x] for x, y, z in SEAT_BOX]
    seats = {"driver": {"h_point": [100 * float(cabin.seats["driver"].design_h_point[i]) for i in (1, 2, 0)]}}
    rule = {"pattern": "*", "within": corners, "group": "seat:driver/base"}
    loaded = load_cabin(describe(tmp_path, cabin, "car.glb", rules=[rule], points="mesh", seats=seats))
    assert any(part.group == "seat:driver/base" for part in loaded.parts)


def test_a_box_cuts_a_piece_that_is_larger() -> None:
    plate = trimesh.creation.box((2.0, 2.0, 0.1)).subdivide().subdivide().subdivide().subdivide()
    (cut,) = faces_within([(plate.vertices, plate.faces)], np.array((-1.1, -1.1, -1.0)), np.array((-0.1, 1.1, 1.0)))
    assert 0.4 < cut.mean() < 0.6
    (whole,) = faces_within([(plate.vertices, plate.faces)], np.array((-1.1, -1.1, -1.0)), np.array((0.6, 1.1, 1.0)))
    assert whole.all()
    (nothing,) = faces_within([(plate.vertices, plate.faces)], np.full(3, 5.0), np.full(3, 6.0))
    assert not nothing.any()


@pytest.mark.parametrize("missing", [0.1, 0.4])
def test_the_share_of_missing_triangles_is_told(missing: float) -> None:
    mesh = lattice()
    rng = np.random.Generator(np.random.Philox(0))
    kept = without(mesh, rng.permutation(len(mesh.faces))[: round((1 - missing) * len(mesh.faces))])
    assert openness(kept.vertices, kept.faces).missing == pytest.approx(missing, abs=0.02)


def test_closed_meshes_panels_and_shells_with_windows_are_no_matter() -> None:
    sphere = lattice()
    windows = without(sphere, np.flatnonzero(np.abs(sphere.triangles_center[:, 1]) < 0.85))
    pane = trimesh.creation.box((1.0, 0.6, 0.01))
    for mesh in (sphere, windows, without(pane, np.arange(2)), without(pane.subdivide().subdivide(), np.arange(64))):
        assert open_warning("car", openness(mesh.vertices, mesh.faces), is_seat=False) == ""


def broken(folder: Path, names: tuple[str, ...], how: str) -> Cabin:
    """The SUV with 40 % of the triangles of some parts gone: at random, or all on one side."""
    cabin = build_cabin("suv")
    scene = trimesh.load_scene(write_car(cabin, folder / "whole.glb", fused=False), process=False)
    rng = np.random.Generator(np.random.Philox(0))
    for name in names:
        mesh = scene.geometry[name]
        order = rng.permutation(len(mesh.faces)) if how == "at random" else np.argsort(mesh.triangles_center[:, 1])
        mesh.update_faces(np.isin(np.arange(len(mesh.faces)), order[: round(0.6 * len(mesh.faces))]))
    scene.export(folder / "car.glb")
    return load_cabin(describe(folder, cabin, "car.glb", rules=[{"pattern": "*cushion*", "label": "seat", "give_mm": 55}]))


@pytest.mark.parametrize(
    ("names", "how", "words"),
    [
        (("driver_cushion",), "at random", r"5\d % of its edges are open, as if (3[89]|4[012]) % of its triangles were missing"),
        (
            ("floor", "headlining", "front_door_trim"),
            "at random",
            r"5\d % of its edges are open, as if (3[89]|4[012]) % of its triangles",
        ),
        (("driver_cushion",), "on one side", r"a seat with holes of \d+ % of its surface counts as a sheet"),
    ],
)
def test_missing_triangles_are_told(names: tuple[str, ...], how: str, words: str, tmp_path: Path) -> None:
    warnings = broken(tmp_path, names, how).warnings
    assert len(warnings) == len(names)
    assert all(any(warning.startswith(name) for warning in warnings) for name in names)
    assert all(re.search(words, warning) for warning in warnings)


@pytest.mark.parametrize(
    ("name", "fused"),
    [
        pytest.param(name, fused, marks=[pytest.mark.slow] if fused and name != "van" else [])
        for name in PRESETS
        for fused in (False, True)
    ],
)
def test_whole_cars_give_no_warning_and_views_are_free(name: str, fused: bool, tmp_path: Path) -> None:
    cabin = build_cabin(name)
    write_car(cabin, tmp_path / "car.glb", fused=fused)
    loaded = load_cabin(describe(tmp_path, cabin, "car.glb"))
    assert loaded.warnings == ()
    assert set(loaded.views) == {"driver", "front_row", "rear"}
    settings = {slot: seat.default for slot, seat in loaded.seats.items()}
    eyes = np.array([view.eye for view in loaded.views.values()])
    assert ContactField(loaded).clearance(eyes, settings).min() >= CLEAR_OF_CAMERA


def test_a_view_is_not_put_inside_a_closed_part(tmp_path: Path) -> None:
    """A block about all the places that are tried: none of them is near its surface."""
    cabin = build_cabin("sedan")
    scene = trimesh.load_scene(write_car(cabin, tmp_path / "whole.glb", fused=False), process=False)
    block = trimesh.creation.box((1.2, 0.9, 0.55)).apply_translation((0.0, 1.0, -0.25))  # y up: before both front seats
    scene.add_geometry(block, geom_name="block", node_name="block")
    scene.export(tmp_path / "car.glb")
    loaded = load_cabin(describe(tmp_path, cabin, "car.glb"))
    assert "front_row" not in loaded.views
    assert "view front_row: none of 75 places before its seats is free; give one under `views`" in loaded.notes
