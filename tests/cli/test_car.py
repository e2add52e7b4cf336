"""`cabinpose car init` and `car check`: an unknown mesh becomes a car, and what is wrong with one is said and drawn."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from car_meshes import write_car
from PIL import Image

from cabinpose.app.car_check import _rule, check_car, open_directions
from cabinpose.app.cli.car import _rows
from cabinpose.app.view.car import draw_car
from cabinpose.scene.cabin import CabinFile, Rule, ViewAnchor, build_cabin
from cabinpose.scene.cabin.car_draft import _scalar, draft_car_file
from cabinpose.scene.cabin.car_file import SeatSpec
from cabinpose.scene.sensor import sensor_by_name

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The SUV in one mesh, and what is drafted of it; read only."""
    made = tmp_path_factory.mktemp("cars")
    mesh = write_car(build_cabin("suv"), made / "suv.glb", fused=True, factor=100.0)
    (made / "suv.yaml").write_text(draft_car_file(mesh, made / "suv.yaml").text, encoding="utf-8")
    return made


@pytest.fixture
def car(folder: Path, tmp_path: Path) -> Path:
    """A copy of the draft that may be changed."""
    path = tmp_path / "suv.yaml"
    path.write_text((folder / "suv.yaml").read_text("utf-8").replace("mesh: suv.glb", f"mesh: {folder / 'suv.glb'}"), "utf-8")
    return path


def changed(path: Path, **keys: Any) -> Path:
    content = yaml.safe_load(path.read_text("utf-8")) | keys
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_first_yaml_holds_people(car: Path, run: Run) -> None:
    code, out, err = run("car", "check", car, "--out", car.parent / "check", "--json")
    assert (code, err) == (0, "")
    data = json.loads(out)
    assert set(data["poses"]) == {"driver", "front_passenger", "rear_left", "rear_center", "rear_right"}
    held = {name: seat["held"] for name, seat in data["poses"].items()}
    assert held.pop("driver") >= 6  # of 12: hands close around a rim that is found in a fused mesh to some millimetres alone
    assert min(held.values()) >= 9
    assert data["rules"] == []
    with Image.open(data["picture"]) as picture:
        assert picture.width == 1300
        assert len(picture.getcolors(maxcolors=1 << 24)) > 1000


def test_init_says_what_it_found(folder: Path, tmp_path: Path, run: Run) -> None:
    code, out, err = run("car", "init", folder / "suv.glb", "--out", tmp_path / "suv.yaml")
    assert code == 0
    assert out.splitlines() == [
        f"file   {tmp_path / 'suv.yaml'}",
        "found  up axis y: glTF says so",
        "found  front axis z: glTF assets face +z",
        "found  unit cm: only so are its extents 163 x 134.2 x 299.6 those of a car",
        "seat   driver, H-point [-0.80, 0.39, 0.33] m",
        "seat   front_passenger, H-point [-0.80, -0.39, 0.33] m",
        "seat   rear_left, H-point [-1.66, 0.39, 0.34] m",
        "seat   rear_center, H-point [-1.67, 0.00, 0.34] m",
        "seat   rear_right, H-point [-1.66, -0.39, 0.34] m",
        "wheel  [-0.40, 0.39, 0.70] m, by its shape, a ring",
    ]
    assert err.startswith("look at it with: cabinpose car check ")


def test_nothing_is_overwritten(car: Path, folder: Path, run: Run) -> None:
    code, out, err = run("car", "init", folder / "suv.glb", "--out", car)
    assert (code, out) == (2, "")
    assert err == f"error: {car} exists\nhint: --overwrite replaces it\n"
    assert run("car", "init", folder / "suv.glb", "--out", car, "--overwrite")[0] == 0
    (car.parent / "check").mkdir()
    (car.parent / "check" / "car.png").touch()
    assert run("car", "check", car, "--out", car.parent / "check")[0] == 2


def test_a_mesh_is_not_replaced_by_its_yaml(folder: Path, run: Run) -> None:
    mesh = (folder / "suv.glb").read_bytes()
    code, out, err = run("car", "init", folder / "suv.glb", "--out", folder / "suv.glb", "--overwrite")
    assert (code, out) == (2, "")
    assert err.endswith("hint: let --out end in .yaml\n")
    assert (folder / "suv.glb").read_bytes() == mesh


def test_a_mesh_without_seats_fails_in_words(tmp_path: Path, run: Run) -> None:
    trimesh.creation.box((3.0, 1.6, 1.2)).export(tmp_path / "box.ply")
    code, out, err = run("car", "init", tmp_path / "box.ply", "--out", tmp_path / "box.yaml")
    assert (code, out) == (2, "")
    assert "nothing in it is shaped like a seat" in err
    assert err.splitlines()[-1] == (
        "hint: check --up-axis, --front-axis and --unit, and take out figures that sit there;"
        " or write the YAML by hand: docs/own-car.md"
    )
    assert not (tmp_path / "box.yaml").exists()


@pytest.mark.slow
def test_the_give_of_a_fused_seat_is_measured_and_cures_it(car: Path, run: Run) -> None:
    seats = yaml.safe_load(car.read_text("utf-8"))["seats"]
    changed(car, rules=[], seats={slot: seats[slot] for slot in ("driver", "rear_left")})
    code, out, _ = run("car", "check", car)
    assert code == 0
    assert "pushed up to" in out
    before, _, after = out.partition("with them:")
    printed = before[before.index("\nrules:\n") :]
    rules = yaml.safe_load(printed)["rules"]
    assert {rule["group"] for rule in rules} >= {"seat:driver/base", "seat:rear_left/base"}
    assert all(15 <= rule["give_mm"] <= 80 and rule["give_mm"] % 5 == 0 for rule in rules)
    assert "\nrear_left  " in after
    changed(car, rules=rules)
    mended = check_car(car).trials
    assert sum(trial.held - len(trial.pushed_m) for trial in mended.values()) >= 18  # of 24


@pytest.mark.parametrize(
    ("where", "key", "value", "words"),
    [
        (("seats", "driver"), "h_point", [-0.8, 0.39, 0.45], "move the h_point by"),
        pytest.param(
            ("seats", "driver"),
            "h_point",
            [-0.8, 0.39, 0.75],
            "there is no cushion within 300 mm below its H-point",
            marks=pytest.mark.slow,
        ),
        (("seats", "driver"), "heel_point", [0.0, 0.39, 0.12], "the floor is -1"),
        pytest.param(
            ("seats", "driver"),
            "heel_point",
            [2.0, 0.39, 0.0],
            "there is no floor under the heels at [2.00, 0.39, 0.00]",
            marks=pytest.mark.slow,
        ),
        (("steering_wheel",), "centre", [0.2, 0.39, 0.7], "out of reach"),
        pytest.param(("steering_wheel",), "axis", [0.9, 0.0, -0.43], "turn it round", marks=pytest.mark.slow),
    ],
)
def test_points_that_the_mesh_contradicts_are_told(
    where: tuple[str, ...], key: str, value: list[float], words: str, car: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = yaml.safe_load(car.read_text("utf-8"))
    at = content
    for name in where:
        at = at[name]
    at[key] = value
    car.write_text(yaml.safe_dump(content), encoding="utf-8")
    monkeypatch.setattr("cabinpose.app.car_check.POSES", 0)
    assert [w for w in check_car(car).warnings if words in w]


def test_a_view_that_looks_straight_down_is_drawn() -> None:
    below = ViewAnchor(np.array((-0.6, 0.0, 1.0)), np.array((-0.6, 0.0, 0.0)))
    cabin = replace(build_cabin("suv"), views={"driver": below})
    drawn = draw_car(cabin, (), sensor_by_name("pico_monstar_105/5").camera, {}, (), None)
    assert len(np.unique(drawn.reshape(-1, 3), axis=0)) > 10


@pytest.mark.parametrize("mesh", ["Seat (2)/cushion/Leather (black)", "seat/cushion/leather"])
def test_a_rule_for_a_mesh_with_a_number_in_brackets(mesh: str) -> None:
    """What a rule cut out of a mesh is told apart by what it says of itself, not by brackets in its name."""
    cabin = build_cabin("suv")
    seat, group = cabin.seats["driver"], "seat:driver/base"
    part = replace(next(p for p in cabin.parts if p.group == group), name=mesh)
    spec = CabinFile(mesh="suv.glb", seats={"driver": SeatSpec(h_point=(0.0, 0.0, 0.0))})
    assert _rule(spec, cabin, seat, part, "base", 30.0, np.eye(4)).names(mesh)
    box = ((-1.0, -1.0, 0.0), (0.0, 1.0, 1.0))
    cut = spec.model_copy(update={"rules": (Rule(pattern="*cushion*", within=box, group=group),)})
    rule = _rule(cut, cabin, seat, replace(part, name=f"{mesh} ({group})", mesh=mesh), "base", 30.0, np.eye(4))
    assert (rule.within, rule.give_mm) == (box, 30.0)


def test_meshes_are_told_without_what_was_cut_out_of_them(car: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cabinpose.app.car_check.POSES", 0)
    report = check_car(car)
    mesh = next(part.mesh for part in report.cabin.parts if part.mesh)
    told = [words for what, words in _rows(report) if what == "meshes"]
    assert any(part.name.startswith(f"{mesh} (seat:") for part in report.cabin.parts)
    assert told
    assert not any("(seat:" in words for words in told)


def test_a_mesh_of_any_name_is_found_again(folder: Path, tmp_path: Path) -> None:
    for name in ("my car #1.glb", "a: b.glb", "- car.glb", "[x].glb", "'x'.glb", "übersicht.glb"):
        assert yaml.safe_load(f"mesh: {_scalar(name)}") == {"mesh": name}
    (tmp_path / "my car #1.glb").symlink_to(folder / "suv.glb")
    text = draft_car_file(tmp_path / "my car #1.glb", tmp_path / "car.yaml").text
    assert yaml.safe_load(text)["mesh"] == "my car #1.glb"


def test_a_shell_that_is_not_there_is_told() -> None:
    surface = build_cabin("suv").surface()
    corners = surface.vertices.astype(float)[surface.faces]
    eye = np.array((-0.9, 0.38, 0.95))
    assert open_directions(corners, eye) == 0.0
    assert open_directions(corners[corners[:, :, 2].max(axis=1) < 0.8], eye) > 0.4


@pytest.mark.slow
def test_synth_and_config_check_warn_of_open_meshes(folder: Path, car: Path, tmp_path: Path, run: Run) -> None:
    mesh = trimesh.load_scene(folder / "suv.glb", process=False).to_mesh()
    keep = np.random.Generator(np.random.Philox(0)).permutation(len(mesh.faces))[: round(0.6 * len(mesh.faces))]
    trimesh.Trimesh(mesh.vertices, mesh.faces[np.sort(keep)], process=False).export(tmp_path / "open.glb")
    changed(car, mesh=str(tmp_path / "open.glb"))
    (tmp_path / "scene.yaml").write_text("scene: {cars: [suv.yaml]}", encoding="utf-8")
    for command in (
        ("synth", "--config", tmp_path / "scene.yaml", "--frames", "1", "--out", tmp_path / "data"),
        ("config", "check", tmp_path / "scene.yaml"),
        ("car", "check", car),
    ):
        err = run(*command)[2]
        assert "% of its edges are open, as if 40 % of its triangles were missing: people pass through the holes" in err, command
        assert all(line.startswith("warning: ") for line in err.splitlines() if "edges are open" in line)


@pytest.mark.slow
def test_an_own_car_that_holds_nobody_points_to_the_check(car: Path, tmp_path: Path, run: Run) -> None:
    content = yaml.safe_load(car.read_text("utf-8"))
    for seat in content["seats"].values():
        seat["h_point"][2] -= 0.12
    car.write_text(yaml.safe_dump(content | {"rules": []}), encoding="utf-8")
    code, _, err = run("synth", "--frames", "1", "--out", tmp_path / "data", f"scene.cars=[{car}]", "limits.scenes_per_frame=5")
    assert code == 2
    assert (
        err.splitlines()[-1]
        == f"hint: people sink into what they sit on: `cabinpose car check {car}` says which give_mm it needs"
    )


def test_an_automatic_view_without_a_place_says_so(folder: Path, tmp_path: Path, car: Path, run: Run) -> None:
    scene = trimesh.load_scene(folder / "suv.glb", process=False)
    block = trimesh.creation.box((140.0, 90.0, 60.0)).apply_translation((0.0, 95.0, -20.0))  # y up, cm: before both front seats
    scene.add_geometry(block, geom_name="block", node_name="block")
    scene.export(tmp_path / "blocked.glb")
    changed(car, mesh=str(tmp_path / "blocked.glb"))
    code, _, err = run("synth", "--frames", "1", "--out", tmp_path / "data", f"scene.cars=[{car}]", "camera.views={front_row: 1}")
    assert code == 2
    assert err.splitlines()[-2:] == [
        f"error: {car}: no free place was found for the automatic view 'front_row'",
        "hint: give one in that file, as views: {front_row: {eye: [x, y, z], target: [x, y, z]}}",
    ]
