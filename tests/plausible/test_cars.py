"""Cars with a wrong unit, axis, origin or point are refused or told, with the cause; the packaged ones and right ones are not."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cabinpose.core import ConfigError, MeshError
from cabinpose.scene.cabin import PRESETS, build_cabin, draft_car_file, judged, load_cabin, measured, places_of, random_dimensions

sys.path.append(str(Path(__file__).parents[1] / "cabin"))
from car_meshes import write_car

Change = Callable[[dict[str, Any]], Any]


@pytest.fixture(scope="module")
def suv(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The SUV in one mesh in cm, with its draft; read only."""
    mesh = write_car(build_cabin("suv"), tmp_path_factory.mktemp("cars") / "suv.glb", fused=True, factor=100.0)
    draft = draft_car_file(mesh, mesh.with_suffix(".yaml"))
    assert not draft.warnings
    mesh.with_suffix(".yaml").write_text(draft.text, "utf-8")
    return mesh


def changed(suv: Path, folder: Path, change: Change | None) -> Path:
    """The draft with a change, without rules."""
    content = yaml.safe_load(suv.with_suffix(".yaml").read_text("utf-8")) | {"mesh": str(suv), "rules": []}
    if change is not None:
        change(content)
    path = folder / "car.yaml"
    path.write_text(yaml.safe_dump(content), "utf-8")
    return path


@pytest.mark.parametrize(
    ("wrong", "said", "cause"),
    [
        ({"unit": "inch"}, "the height is 3.41 m", "all sizes fit if the mesh is in cm: unit cm"),
        ({"unit": "mm"}, "0.2996 m long", "unit cm would fit"),
        ({"front_axis": "x"}, "the width is 3.00 m", "another axis is up or to the front"),
        ({"front_axis": "-z"}, "the driver looks backward, and has a steering wheel", "the seats face backwards: front axis z"),
    ],
    ids=("inch", "mm", "across", "backwards"),
)
def test_a_draft_with_a_wrong_option_is_refused(suv: Path, wrong: dict[str, str], said: str, cause: str) -> None:
    with pytest.raises(MeshError) as error:
        draft_car_file(suv, suv.with_suffix(".yaml"), **wrong)
    assert said in str(error.value)
    assert cause in str(error.value.hint)


def every_seat(content: dict[str, Any], change: Callable[[dict[str, Any]], object]) -> None:
    for seat in content["seats"].values():
        change(seat)


def scaled(content: dict[str, Any], factor: float) -> None:
    every_seat(content, lambda seat: seat.update(h_point=[factor * x for x in seat["h_point"]]))


@pytest.mark.parametrize(
    ("change", "said", "cause"),
    [
        (lambda c: c.update(unit="inch"), "the width is 4.14 m", "all sizes fit if the mesh is in cm"),
        (lambda c: c.update(front_axis="-z"), "outside the mesh", "turned round: front axis z"),
        (lambda c: scaled(c, 1000), "outside the mesh", "the YAML's points are in mm: give them in metres"),
        (lambda c: scaled(c, 100), "outside the mesh", "the YAML's points are in cm: give them in metres"),
        (lambda c: every_seat(c, lambda s: s.update(facing="backward")), "looks backward", "the seats face backwards"),
        (lambda c: c["seats"]["driver"]["heel_point"].__setitem__(0, -1.6), "before the H-point is -0.80 m", "face backwards"),
        (lambda c: c["seats"]["driver"]["heel_point"].__setitem__(2, -0.6), "H-point over the heel is 0.93 m", "on the road"),
        (lambda c: c["steering_wheel"]["centre"].__setitem__(0, -1.2), "before the driver's H-point is -0.40 m", "backwards"),
        (lambda c: c["steering_wheel"]["centre"].__setitem__(1, -0.39), "beside the driver's H-point", "docs/own-car.md"),
        (lambda c: c["steering_wheel"]["centre"].__setitem__(2, 1.2), "above the driver's H-point is 0.87", "docs/own-car.md"),
        (lambda c: c["seats"]["rear_left"]["h_point"].__setitem__(1, 0.1), "beside it is 0.10 m", "docs/own-car.md"),
    ],
    ids=(
        "inch", "turned", "points-mm", "points-cm", "facing", "heel-behind", "heel-low", "wheel-behind", "wheel-aside",
        "wheel-high", "seats-in-one",
    ),
)  # fmt: skip
def test_a_car_with_sizes_that_none_has_is_refused(suv: Path, tmp_path: Path, change: Change, said: str, cause: str) -> None:
    with pytest.raises(ConfigError) as error:
        load_cabin(changed(suv, tmp_path, change))
    assert said in str(error.value)
    assert cause in str(error.value.hint)


def test_what_a_car_hardly_has_is_told_once(suv: Path, tmp_path: Path) -> None:
    right = load_cabin(changed(suv, tmp_path, None))
    low = load_cabin(changed(suv, tmp_path, lambda c: c["seats"]["driver"]["heel_point"].__setitem__(2, -0.3)))
    (said,) = set(low.warnings) - set(right.warnings)
    assert said.startswith("the driver's H-point over the heel is 0.63 m, in a car 0.12 to 0.54 m")
    assert "(the origin is on the road" in said
    assert not [w for w in right.warnings if "in a car" in w]


@pytest.mark.slow
def test_the_picture_shows_why_a_car_is_refused(suv: Path, tmp_path: Path, run: Callable[..., Any]) -> None:
    path = changed(suv, tmp_path, lambda c: c.update(unit="inch"))
    code, out, err = run("car", "check", path, "--out", tmp_path / "check")
    assert (code, out) == (2, f"{tmp_path / 'check' / 'car.png'}\n")
    assert err.endswith("hint: all sizes fit if the mesh is in cm: unit cm\n")
    assert (tmp_path / "check" / "car.png").stat().st_size > 10_000


def test_a_program_reads_the_sizes(suv: Path, tmp_path: Path, run: Callable[..., Any]) -> None:
    code, out, _ = run("car", "init", suv, "--out", tmp_path / "car.yaml", "--json")
    assert code == 0
    sizes = {(each["size"], each["slot"]): each["m"] for each in json.loads(out)["sizes"]}
    assert np.isclose(sizes["length", None], 3.0, atol=0.01)
    assert np.isclose(sizes["h_point_over_heel", "driver"], 0.325, atol=0.02)


@pytest.mark.parametrize("count", [6, pytest.param(60, marks=pytest.mark.slow)])
def test_nothing_is_said_of_packaged_and_random_cars(count: int) -> None:
    rng = np.random.Generator(np.random.Philox(5))
    cars = [*(PRESETS if count > 6 else PRESETS[::3]), *(random_dimensions(f"C{i:04d}", rng=rng) for i in range(count))]
    for car in cars:
        cabin = build_cabin(car)
        steered = cabin.steering_wheel is not None
        said = judged(measured(cabin), places_of(cabin), steered=steered, unit="m", front="x")
        assert said.errors + said.warnings == (), cabin.name
