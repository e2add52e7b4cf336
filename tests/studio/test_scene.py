"""The Scene tab without a browser: fields, changes, undo, files, and the same bytes as `cabinpose synth`."""

from __future__ import annotations

import asyncio
import dataclasses
import math
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import trimesh
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel
from scipy.spatial import cKDTree

from cabinpose.app.studio.scene_bodies import _outermost
from cabinpose.app.studio.scene_dimensions import dimension_lines
from cabinpose.app.studio.scene_edit import SceneEditor, State, read_state
from cabinpose.app.studio.scene_form import Field, axis_words, form, with_changed_preset
from cabinpose.app.studio.scene_preview import Preview, Shown, camera_of
from cabinpose.app.studio.scene_session import SceneRoom
from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import apply, is_rigid
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene import Surface
from cabinpose.scene.body import DOFS
from cabinpose.scene.body.rig import BONE_INDEX, LOWER, UPPER
from cabinpose.scene.cabin import PRESET_DIMENSIONS, CabinDimensions, build_cabin
from cabinpose.scene.cabin.car_draft import draft_car_file
from cabinpose.scene.sensor import SENSORS
from cabinpose.store import open_dataset
from cabinpose.store.part import PartWriter
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.variables import build_manifest

SEED, INDEX = 3, 1
SUV: dict[str, Any] = {"scene": {"kind": "cabin", "cars": ["suv"]}, "noise": {"kind": "physical"}}
MINE = {"preset": "suv", "name": "my_suv"}


def draw(preview: Preview, editor: SceneEditor) -> Shown:
    return preview.draw(editor.config, editor.state.seed, editor.state.index)


@pytest.fixture(scope="module")
def preview() -> Preview:
    return Preview()


@pytest.fixture
def editor(tmp_path: Path) -> SceneEditor:
    return SceneEditor(tmp_path, State(SUV, SEED, INDEX))


@pytest.fixture
def accepted(editor: SceneEditor, preview: Preview) -> tuple[SceneEditor, Shown]:
    """A drawn scene that was accepted, and as it is shown then."""
    editor.accept(draw(preview, editor))
    return editor, draw(preview, editor)


def by_path(data: dict[str, Any]) -> dict[str, Field]:
    return {".".join(map(str, field.path)): field for field in form(data).walk()}


# ------------------------------------------------------------------------------------------------------------- fields


def keys_of(value: Any, path: str = "") -> set[str]:
    """The keys of a model and of the models within, found by walking over the models themselves, not their schema."""
    if isinstance(value, BaseModel):
        items = [(name, getattr(value, name)) for name in type(value).model_fields]
    elif dataclasses.is_dataclass(value):
        items = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
    elif isinstance(value, dict):
        items = list(value.items())
    elif isinstance(value, tuple) and any(isinstance(each, BaseModel) for each in value):
        items = [(str(i), each) for i, each in enumerate(value) if isinstance(each, BaseModel)]
    else:
        return {path}
    return {path, *(key for name, each in items for key in keys_of(each, f"{path}.{name}".lstrip(".")))}


def test_every_key_is_a_field() -> None:
    data = {
        "scene": {
            "kind": "cabin",
            "cars": ["suv", {"preset": "van", "name": "mine"}],
            "occupants": {"driver": {"profile": {"kind": "gaussian", "axes": {"lelbow.flexion": {"sigma_deg": 3}}}}},
            "occupancy": {"rear_left": 0.5},
            "factorial": {"poses": 2, "seat": "rear_left"},
            "motion": {"driver": {"drive": 1.0}},
        },
        "people": {"own": {"anna": {"stature_cm": 168}}, "random": {"count": 3, "ranges": {"years": {"min": 20, "max": 30}}}},
        "camera": {"views": {"mine": {"position_m": [1, 0, 1], "look_at_m": [0, 0, 1]}}},
        "noise": {"kind": "empirical"},
    }
    config = SynthConfig.parse(data)
    # An outfit knows its place in a list, which is no key.
    no_keys = "kind", ".layout", ".outfit.number"
    expected = {key for key in keys_of(config) if not key.endswith(no_keys) and key != "version"}
    assert "scene.cars.1.w3_mm" in expected
    shown = set(by_path(data))
    assert expected - shown == {"noise.effects"}  # which no installed package offers


@pytest.mark.parametrize(
    ("key", "unit", "low", "high"),
    [
        ("camera.jitter_deg", "°", 0.0, 45.0),
        ("camera.sensor.integration_s", "s", 0, None),
        ("camera.sensor.camera.fx", "px", None, None),
        ("scene.people_jitter_m", "m", 0.0, 0.1),
        ("scene.cars.0.w3_mm", "mm", 1200, 1900),
        ("scene.cars.0.a40_2_deg", "°", 8, 35),
        ("scene.occupants.driver.initial_pose_deg.lelbow.flexion", "°", 0.0, 150.0),
        ("scene.occupants.driver.initial_pose_deg.lhand.grip", "", 0.0, 1.0),
    ],
)
def test_fields_have_units_and_ranges(key: str, unit: str, low: float | None, high: float | None) -> None:
    sensor = SynthConfig.parse({"camera": {"sensor": "pico_monstar_105/5"}}).camera.sensor_model
    own = SynthConfig.parse({"camera": {"sensor": dataclasses.asdict(sensor) if dataclasses.is_dataclass(sensor) else sensor}})
    data = {**SUV, "camera": own.camera.model_dump(mode="json")}
    data["scene"] = {
        **SUV["scene"],
        "cars": [MINE],
        "occupants": {"driver": {"initial_pose_deg": {"lelbow.flexion": 40, "lhand.grip": 1}}},
    }
    field = by_path(data)[key]
    assert (field.unit, field.low, field.high) == (unit, low, pytest.approx(high) if high is not None else None)


def test_every_choice_of_a_union_starts_from_something_that_can_be_edited(editor: SceneEditor) -> None:
    for field in form(editor.state.data, starts=editor.starts(None)).walk():
        for option in field.options:
            assert field.fresh is not None
            again = {**editor.state.data}
            at: Any = again
            for part in field.path[:-1]:
                at[part] = dict(at.get(part) or {})
                at = at[part]
            at[field.path[-1]] = field.fresh[option]
            found = by_path(again)[".".join(map(str, field.path))]
            assert found.option == option, field.path


def test_names_that_exist_are_offered() -> None:
    fields = by_path({**SUV, "scene": {"kind": "cabin", "occupants": {"driver": {}}}})
    assert set(fields["camera.sensor"].choices) == set(SENSORS.names())
    assert "suv" in fields["scene.cars"].choices
    assert fields["scene.occupants.driver.initial_pose_deg"].choices == tuple(dof.name for dof in DOFS)


def test_fields_of_a_changed_preset_show_what_the_preset_has() -> None:
    cars = ["sedan", {"preset": "van", "name": "mine", "w3_mm": 1500}]
    fields = by_path({"scene": {"kind": "cabin", "cars": cars}})
    shown = {
        name: fields[f"scene.cars.1.{name}"].value for name in ("preset", "name", "w3_mm", "l50_mm", "rear_places", "clutch")
    }
    assert shown == {"preset": "van", "name": "mine", "w3_mm": 1500, "l50_mm": 1000.0, "rear_places": 3, "clutch": True}
    assert (fields["scene.cars.1"].name, fields["scene.cars"].kind) == ("mine", "names")
    assert fields["scene.cars.1.dash_style"].choices[:2] == ("simple", "wave")


@pytest.mark.parametrize(
    ("cars", "expected", "at"),
    [
        (["sedan", "suv"], ["sedan", MINE], 1),  # in its place
        (["sedan"], ["sedan", MINE], 1),
        ([MINE, "suv"], [MINE, MINE | {"name": "my_suv_2"}], 1),
        ([{"preset": "suv"}, 3], [{"preset": "suv"}, 3, MINE], 2),  # what is wrong stays, and is told
    ],
)
def test_preset_is_made_a_car_of_ones_own(cars: list[Any], expected: list[Any], at: int) -> None:
    assert with_changed_preset(cars, "suv") == (expected, at)


# ------------------------------------------------------------------------------------------------------------ changes


def test_what_is_wrong_is_told_at_its_key_and_the_last_valid_stays(editor: SceneEditor) -> None:
    editor.set(("scene", "belted"), 0.5)
    editor.set(("scene", "belted"), 3)
    assert list(editor.errors) == [("scene", "belted")]
    assert editor.config.scene.belted == 0.5  # type: ignore[union-attr]
    editor.set(("camera", "sensor"), "no_such_sensor")
    assert ("scene", "belted") in editor.errors or ("camera", "sensor") in editor.errors
    editor.undo()
    editor.undo()
    assert editor.errors == {}


def test_undo_and_redo_go_through_all_states(editor: SceneEditor) -> None:
    states = [editor.state]
    for change in (
        lambda: editor.set(("scene", "belted"), 0.1),
        lambda: editor.set(("noise", "blur"), 0.2),
        editor.sample_again,
        lambda: editor.set(("noise",), {"kind": "empirical"}),
    ):
        change()
        states.append(editor.state)
    for state in reversed(states[:-1]):
        assert editor.undo()
        assert editor.state == state
    assert not editor.undo()
    for state in states[1:]:
        assert editor.redo()
        assert editor.state == state
    assert not editor.redo()
    editor.undo()
    editor.set(("scene", "belted"), 0.9)
    assert not editor.redo()  # that future is gone


def test_slider_is_one_step_of_undo(editor: SceneEditor, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    before = editor.state
    for value in (0.1, 0.2, 0.3):
        editor.set(("scene", "belted"), value)
        now[0] += 0.1
    now[0] += 10
    editor.set(("scene", "belted"), 0.4)
    editor.undo()
    assert editor.config.scene.belted == 0.3  # type: ignore[union-attr]
    editor.undo()
    assert editor.state == before


def test_an_occupant_does_not_take_the_others_out(editor: SceneEditor) -> None:
    """Left out, `occupancy` means another thing beside `occupants`; a change of one key changes no other."""
    before = editor.config.scene.occupancy  # type: ignore[union-attr]
    editor.set(("scene", "occupants", "driver"), {})
    editor.set(("scene", "occupants", "driver", "subject"), "S03")
    assert editor.config.scene.occupancy == before  # type: ignore[union-attr]
    assert editor.config.scene.occupants["driver"].subject == "S03"  # type: ignore[union-attr]


def test_changed_dimension_is_shown_and_undone(editor: SceneEditor, preview: Preview) -> None:
    editor.set(("scene", "cars"), [MINE])
    before = draw(preview, editor)
    editor.set(("scene", "cars", 0, "w20_mm"), 440)
    after = draw(preview, editor)
    assert after.scene.cabin is not None
    assert abs(after.scene.cabin.seats["driver"].design_h_point[1]) == 0.44
    editor.undo()
    np.testing.assert_array_equal(draw(preview, editor).frame["depth"], before.frame["depth"])
    editor.set(("scene", "cars", 0, "w20_mm"), 900)
    editor.set(("scene", "cars", 0, "h30_mm"), 3)
    assert set(editor.errors) == {("scene", "cars", 0, "w20_mm"), ("scene", "cars", 0, "h30_mm")}
    editor.remove(("scene", "cars", 0, "h30_mm"))
    editor.set(("scene", "cars", 0, "w20_mm"), 480)
    editor.set(("scene", "cars", 0, "w3_mm"), 1200)
    assert "two seats" in editor.errors[("scene", "cars", 0, "w3_mm")]


def test_accepted_scene_is_the_same_frame(editor: SceneEditor, preview: Preview) -> None:
    drawn = draw(preview, editor)
    editor.accept(drawn)
    given = draw(preview, editor)
    assert given.verdicts == ()
    assert set(editor.given) == {person.slot for person in drawn.scene.people}
    for name, value in drawn.frame.items():
        np.testing.assert_array_equal(given.frame[name], value, err_msg=name)


def test_collision_is_shown_where_it_is(accepted: tuple[SceneEditor, Shown], preview: Preview) -> None:
    """A driver's hand brought into the other thigh."""
    editor, shown = accepted
    driver = next(person for person in shown.scene.people if person.slot == "driver")
    hip, knee = (driver.posed.joints[i] for i in (_joint("rpelvis"), _joint("rknee")))
    thigh = (hip + knee) / 2
    editor.move_hand(shown, "driver", "r", thigh)
    after = draw(preview, editor)
    (verdict,) = after.verdicts
    assert verdict.rejection is not None
    assert verdict.rejection.slot == "driver"
    assert verdict.where is not None
    assert np.linalg.norm(verdict.where - thigh) < 0.25
    assert np.isfinite(after.frame["depth_clean"]).any()


def _joint(name: str) -> int:
    return CABINPOSE.index[name]


@pytest.mark.parametrize("side", ["l", "r"])
def test_dragged_hand_arrives_within_the_limits(accepted: tuple[SceneEditor, Shown], preview: Preview, side: str) -> None:
    editor, shown = accepted
    driver = next(person for person in shown.scene.people if person.slot == "driver")
    chest = driver.posed.joints[_joint("chest")]
    goal = chest + (0.35, 0.1 if side == "l" else -0.1, 0.05)
    assert editor.move_hand(shown, "driver", side, goal) < 0.01
    after = next(person for person in draw(preview, editor).scene.people if person.slot == "driver")
    np.testing.assert_allclose(after.posed.palms[side][:3, 3], goal, atol=0.01)
    changed = {DOFS[i].name.split(".")[0] for i in np.flatnonzero(after.posed.q != driver.posed.q)}
    assert changed <= {side + name for name in ("shoulder", "elbow", "wrist")}
    assert (after.posed.q >= LOWER - 1e-9).all()
    assert (after.posed.q <= UPPER + 1e-9).all()
    far = editor.move_hand(shown, "driver", side, chest + (3.0, 0.0, 0.0))
    assert 1.5 < far < 3.0  # nobody is as long as that
    assert editor.errors == {}


@pytest.mark.parametrize("side", ["l", "r"])
def test_trunk_follows_a_hand_beyond_the_arm(accepted: tuple[SceneEditor, Shown], preview: Preview, side: str) -> None:
    """From the shoulder to the place it is 15 cm more than the arm is long; the other hand, the gaze and the pelvis stay."""
    editor, shown = accepted
    driver = next(person for person in shown.scene.people if person.slot == "driver")
    at = {name: driver.posed.joints[_joint(side + name)] for name in ("shoulder", "elbow", "wrist")}
    palm = driver.posed.palms[side][:3, 3]
    arm = sum(
        np.linalg.norm(np.subtract(*pair))
        for pair in ((at["shoulder"], at["elbow"]), (at["elbow"], at["wrist"]), (at["wrist"], palm))
    )
    ahead = np.array((0.9, 0.0, 0.1)) / np.linalg.norm((0.9, 0.0, 0.1))
    goal = at["shoulder"] + (arm + 0.15) * ahead
    assert editor.move_hand(shown, "driver", side, goal) < 0.01
    after = next(person for person in draw(preview, editor).scene.people if person.slot == "driver")
    np.testing.assert_allclose(after.posed.palms[side][:3, 3], goal, atol=0.01)
    other = "rl"["lr".index(side)]
    np.testing.assert_allclose(after.posed.palms[other][:3, 3], driver.posed.palms[other][:3, 3], atol=0.005)
    turned = after.posed.bones[BONE_INDEX["head"], :3, :3].T @ driver.posed.bones[BONE_INDEX["head"], :3, :3]
    assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) < 15
    np.testing.assert_array_equal(after.posed.vehicle_from_root, driver.posed.vehicle_from_root)
    assert (after.posed.q >= LOWER - 1e-9).all()
    assert (after.posed.q <= UPPER + 1e-9).all()


def test_seat_takes_its_person_along(accepted: tuple[SceneEditor, Shown], preview: Preview) -> None:
    editor, shown = accepted
    before = next(person for person in shown.scene.people if person.slot == "driver").posed.joints
    editor.set_seat(shown, "driver", "fore_aft_m", shown.scene.settings["driver"].fore_aft_m - 0.03)
    moved = draw(preview, editor)
    after = next(person for person in moved.scene.people if person.slot == "driver").posed.joints
    np.testing.assert_allclose(after - before, np.tile((-0.03, 0.0, 0.0), (len(before), 1)), atol=1e-9)
    editor.set_seat(moved, "driver", "torso_angle_rad", moved.scene.settings["driver"].torso_angle + 0.1)
    pose = editor.config.scene.occupants["driver"].pose  # type: ignore[union-attr]
    assert pose is not None
    assert is_rigid(np.array(pose.vehicle_from_root))
    with pytest.raises(ConfigError, match="outside"):
        editor.set_seat(moved, "driver", "fore_aft_m", 2.0)


def test_tongue_of_a_belt_goes_along_with_the_hand_that_draws_it(accepted: tuple[SceneEditor, Shown], preview: Preview) -> None:
    editor, shown = accepted
    driver = next(person for person in shown.scene.people if person.slot == "driver")
    palm = driver.posed.palms["r"]
    occupant = editor.state.data["scene"]["occupants"]["driver"]
    tongue = {"at_m": apply(palm, np.array((0.0, 0.0, 0.03))).tolist(), "how": "drawn"}
    editor.set(("scene", "occupants", "driver"), {**occupant, "belted": False, "pose": {**occupant["pose"], "tongue": tongue}})
    assert editor.errors == {}
    editor.move_hand(draw(preview, editor), "driver", "r", palm[:3, 3] + (0.02, 0.03, 0.05))
    after = next(person for person in draw(preview, editor).scene.people if person.slot == "driver")
    assert after.tongue is not None
    assert np.linalg.norm(after.tongue.at - tongue["at_m"]) > 0.03
    np.testing.assert_allclose(after.tongue.at, apply(after.posed.palms["r"], np.array((0.0, 0.0, 0.03))), atol=2e-3)


def test_camera_is_moved(editor: SceneEditor, preview: Preview) -> None:
    shown = draw(preview, editor)
    editor.move_camera(shown, position=(0.9, 0.1, 1.3))
    moved = draw(preview, editor)
    np.testing.assert_allclose(moved.scene.world_from_camera[:3, 3], (0.9, 0.1, 1.3), atol=1e-9)
    eye, target, _ = camera_of(moved)
    forward = np.array(target) - eye
    np.testing.assert_allclose(moved.scene.world_from_camera[:3, 2], forward / np.linalg.norm(forward), atol=1e-6)
    editor.move_camera(moved, target=(0.0, 0.0, 1.0))
    assert camera_of(draw(preview, editor))[0] == [0.9, 0.1, 1.3]


def test_a_place_from_which_little_is_seen_is_told(editor: SceneEditor, preview: Preview) -> None:
    shown = draw(preview, editor)
    assert shown.doubts == ()
    editor.move_camera(shown, position=(0.4, 0.0, 1.1), target=(-1.0, 0.0, 0.6))
    assert "it looks at the seats through glass" in "; ".join(draw(preview, editor).doubts)


def test_camera_before_a_face_is_told(accepted: tuple[SceneEditor, Shown], preview: Preview) -> None:
    editor, shown = accepted
    driver = next(person for person in shown.scene.people if person.slot == "driver")
    editor.move_camera(shown, position=driver.posed.eyes_m + (0.03, 0.0, 0.0))
    assert [str(verdict.rejection) for verdict in draw(preview, editor).verdicts] == ["somebody is right before the camera"]


def test_scene_that_cannot_be_keeps_the_last_one(editor: SceneEditor, preview: Preview) -> None:
    shown = draw(preview, editor)
    editor.set(("scene", "occupants", "driver"), {"initial_pose_deg": {"lhip.flexion": -20, "rhip.flexion": -20}})
    editor.set(("limits",), {"scenes_per_frame": 2, "poses_per_person": 1})
    after = draw(preview, editor)
    assert "made a valid scene" in after.error
    assert after.scene is shown.scene


def test_room_is_shown_and_not_accepted(tmp_path: Path, preview: Preview) -> None:
    editor = SceneEditor(tmp_path, State({"scene": {"kind": "room"}, "camera": {"views": {"room": 1.0}}}))
    shown = draw(preview, editor)
    assert shown.scene.place.startswith("room")
    with pytest.raises(ConfigError, match="only scenes in cars"):
        editor.accept(shown)


def test_accept_tells_what_it_lets_go(editor: SceneEditor, preview: Preview) -> None:
    """Every key that somebody gave and that the accepted scene has no more, and nothing else."""
    editor.set(("scene", "occupants", "driver"), {"subject": "S03", "profile": {"kind": "gaussian", "axes": {}}})
    for key, value in (("in_hand", 0.5), ("belted", 0.25)):
        editor.set(("scene", key), value)
    editor.set(("limits", "poses_per_person"), 77)
    editor.set(("noise", "blur"), 0.2)
    editor.set(("camera", "jitter_m"), 0.01)
    shown = draw(preview, editor)
    told = editor.let_go(shown)
    assert {"scene.in_hand: 0.5", "scene.belted: 0.25", "camera.jitter_m: 0.01"} <= set(told)
    assert any(words.startswith("scene.occupants.driver.profile") for words in told)
    assert not any(words.startswith(("limits", "noise", "scene.cars", "scene.occupants.driver.subject")) for words in told)
    before = editor.state
    editor.accept(shown)
    kept = editor.config
    assert (kept.limits.poses_per_person, kept.noise.blur) == (77, 0.2)  # type: ignore[union-attr]
    assert editor.let_go(draw(preview, editor)) == []
    editor.undo()
    assert editor.state == before


def test_conflicts_stand_at_their_keys(accepted: tuple[SceneEditor, Shown], preview: Preview) -> None:
    editor, shown = accepted
    assert editor.conflicts(shown, "") == []
    driver = next(person for person in shown.scene.people if person.slot == "driver")
    editor.move_hand(shown, "driver", "r", driver.posed.joints[[_joint("rpelvis"), _joint("rknee")]].mean(axis=0))
    colliding = draw(preview, editor)
    editor.set(("noise", "blur"), 3.0)
    editor.move_camera(colliding, position=(0.4, 0.0, 1.1), target=(-1.0, 0.0, 0.6))
    told = editor.conflicts(draw(preview, editor), "no scene was found")
    assert [key for key, _ in told][:3] == [("noise", "blur"), ("scene",), ("scene", "occupants", "driver")]
    assert "mm deep" in dict(told)["scene", "occupants", "driver"]
    editor.set(("noise", "blur"), 0.1)
    assert ("camera", "views") in dict(editor.conflicts(draw(preview, editor), ""))


def test_names_are_words_with_the_codes_of_the_standard() -> None:
    """The codes are those that the dimensions' own table has."""
    fields = by_path({**SUV, "scene": {"kind": "cabin", "cars": [MINE], "occupants": {"driver": {"initial_pose_deg": {}}}}})
    schema = CabinDimensions.model_json_schema()["properties"]
    for name, part in schema.items():
        if "code" in part:
            assert fields[f"scene.cars.0.{name}"].words.endswith(f" ({part['code']})")
    assert fields["scene.cars.0.h30_mm"].words == "seat height (H30-1)"
    assert (fields["scene.people_jitter_m"].words, fields["scene.cars.0"].words) == ("people jitter", "my_suv")
    assert [axis_words(name) for name in ("lelbow.flexion", "rhand.grip", "lumbar.flexion", "head.rotation")] == [
        "left elbow flexion", "right hand grip", "lumbar flexion", "head rotation",
    ]  # fmt: skip


@pytest.mark.parametrize("car", ["sedan", "van", "coupe"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_dimension_lines_are_as_long_as_the_dimension_and_end_at_the_car(car: str, side: Literal["left", "right"]) -> None:
    cabin, d = build_cabin(car, drive_side=side), PRESET_DIMENSIONS[car].model_dump()
    driver, wheel = cabin.seats["driver"], cabin.steering_wheel
    behind = cabin.seats["rear_left"]
    assert wheel is not None
    lines = {name: dimension_lines(cabin, name, d[name]) for name in d if isinstance(d[name], float)}
    for name, found in lines.items():
        if len(found) == 1:
            assert np.linalg.norm(np.subtract(*found[0])) == pytest.approx(d[name] / 1000), name
        elif found:
            (at, one), (_, other) = found
            cosine = (one - at) @ (other - at) / np.linalg.norm(one - at) / np.linalg.norm(other - at)
            assert math.degrees(math.acos(cosine)) == pytest.approx(d[name], abs=0.01), name
    ends = {
        "h30_mm": driver.design_h_point, "l53_mm": driver.design_h_point * (1, 1, 0), "w20_mm": driver.design_h_point,
        "h30_2_mm": behind.design_h_point, "w20_2_mm": behind.design_h_point, "h17_mm": wheel.vehicle_from_wheel[:3, 3],
    }  # fmt: skip
    for name, end in ends.items():
        np.testing.assert_allclose(lines[name][0][1], end, atol=1e-6, err_msg=name)
    np.testing.assert_allclose(lines["l50_mm"][0][1][0], behind.design_h_point[0], atol=1e-6)
    assert len([name for name, found in lines.items() if found]) == 22
    assert dimension_lines(build_cabin("shuttle"), "h30_mm", 300.0) == []


# -------------------------------------------------------------------------------------------------------------- files


@pytest.mark.parametrize("given", [False, True])
def test_saved_scene_is_generated_with_the_same_bytes(
    editor: SceneEditor, preview: Preview, run: Callable[..., Any], given: bool
) -> None:
    """What `cabinpose synth` stores of the saved file is, bit by bit, the frame that the studio shows."""
    editor.set(("scene", "occupants", "driver"), {"subject": "S03"})
    editor.set(("noise", "blur"), 0.2)
    editor.set(("scene", "cars"), [MINE])
    editor.set(("scene", "cars", 0, "w3_mm"), 1650)
    if given:
        shown = draw(preview, editor)
        editor.accept(shown)
        editor.turn_joint(shown, "driver", "head.rotation", 0.1 + 0.2)
        editor.move_camera(draw(preview, editor), target=(-1.0, 0.1, 0.6))
    path = editor.save("mine.yaml")
    outcome = run("synth", "--config", path, "--out", editor.folder / "made", "--frames", INDEX + 1, "--seed", SEED)
    assert outcome.code == 0, outcome.err
    manifest = build_manifest(editor.config, INDEX + 1, SEED)
    (plan,) = manifest.parts
    (editor.folder / "shown").mkdir()
    with PartWriter(editor.folder / "shown", plan, manifest) as part:
        for index in range(INDEX + 1):
            shown = preview.draw(editor.config, SEED, index)
            assert shown.verdicts == ()
            part.append(shown.frame)
    made, own = (
        {p.relative_to(root): p.read_bytes() for p in root.rglob("*") if p.is_file()}
        for root in (editor.folder / "made" / plan.name, editor.folder / "shown" / plan.name)
    )
    different = {str(name) for name in made if made[name] != own.get(name)}
    assert different <= {"zarr.json"}  # the attributes count the poses that were tried
    assert len(made) == len(own) > 20


def test_file_remembers_seed_and_frame(editor: SceneEditor) -> None:
    editor.look_at(7, 12)
    editor.set(("scene", "occupants", "driver"), {"subject": "S03"})
    path = editor.save("mine.yaml")
    assert read_state(path) == editor.state
    other = SceneEditor(editor.folder)
    other.load("mine.yaml")
    assert (other.state, other.config) == (editor.state, editor.config)
    assert SynthConfig.load(path) == editor.config
    other.undo()
    assert other.config == SynthConfig()


def test_nothing_is_overwritten_unasked(editor: SceneEditor) -> None:
    path = editor.save("mine.yaml")
    before = path.read_bytes()
    editor.sample_again()
    with pytest.raises(ConfigError, match="exists"):
        editor.save("mine.yaml")
    assert path.read_bytes() == before
    editor.save("mine.yaml", overwrite=True)
    assert path.read_bytes() != before


_ELSEWHERE = ["../up.yaml", "/x.yaml", "sub/x.yaml", "x.txt", "", ".hidden.yaml", "..", "a\\b.yaml", "a\0.yaml"]


@pytest.mark.parametrize("name", _ELSEWHERE)
def test_only_files_of_the_folder(editor: SceneEditor, name: str) -> None:
    with pytest.raises(ConfigError, match="is no name in"):
        editor.save(name)
    with pytest.raises(ConfigError, match="is no name in"):
        editor.load(name)


def test_link_out_of_the_folder_is_refused(editor: SceneEditor, tmp_path_factory: pytest.TempPathFactory) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "x.yaml"
    elsewhere.write_text("{}")
    (editor.folder / "link.yaml").symlink_to(elsewhere)
    with pytest.raises(ConfigError, match="is no name in"):
        editor.save("link.yaml", overwrite=True)
    with pytest.raises(ConfigError, match="is no name in"):
        editor.load("link.yaml")


def test_wrong_scene_is_not_saved(editor: SceneEditor) -> None:
    editor.set(("scene", "belted"), 3)
    with pytest.raises(ConfigError, match="not saved"):
        editor.save("mine.yaml")
    assert not list(editor.folder.iterdir())


@pytest.mark.parametrize("text", ["[1, 2]", "scene: [", "scene: {kind: cabin, carz: [suv]}"])
def test_broken_file_changes_nothing(editor: SceneEditor, text: str) -> None:
    (editor.folder / "broken.yaml").write_text(text)
    before = editor.state
    with pytest.raises(ConfigError):
        editor.load("broken.yaml")
    assert editor.state is before
    assert not editor.undo()


@pytest.mark.parametrize(
    ("text", "comments"),
    [
        ("# mine\nscene: {cars: [suv]}\n", True),
        ("scene:\n  cars: [suv]  # the big one\n", True),
        ("# seed 3, frame 1\nscene: {cars: [suv]}\n", False),
        ("people:\n  own: {'a # b': {years: 30}, c: {years: 3}}\n", False),
        ("scene: [", False),
    ],
)
def test_comments_that_would_be_lost_are_known(editor: SceneEditor, text: str, comments: bool) -> None:
    (editor.folder / "mine.yaml").write_text(text)
    assert editor.has_comments("mine.yaml") == comments
    assert not editor.has_comments("other.yaml")
    assert not editor.has_comments("../mine.yaml")


# ----------------------------------------------------------------------------------------------------------- own cars


@pytest.fixture(scope="module")
def own_car(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the SUV as a user's own mesh, `mine.yaml`; read only."""
    folder = tmp_path_factory.mktemp("cars")
    surface = build_cabin("suv").surface()
    trimesh.Trimesh(surface.vertices[:, (1, 2, 0)], surface.faces, process=False).export(folder / "mine.glb")
    (folder / "mine.yaml").write_text(draft_car_file(folder / "mine.glb", folder / "mine.yaml").text, encoding="utf-8")
    return folder


@pytest.fixture
def room(own_car: Path, tmp_path: Path) -> Iterator[SceneRoom]:
    """A scene in a folder with that car, which may be changed."""
    folder = Path(shutil.copytree(own_car, tmp_path / "scenes"))
    (folder / "scene.yaml").write_text("scene: {cars: [suv], occupants: {driver: {subject: S03}}}\n")
    made = SceneRoom(folder / "scene.yaml")
    yield made
    made.stop()


@pytest.mark.slow
def test_own_car_is_offered_shown_and_loaded_anew(room: SceneRoom) -> None:
    editor = room.editor
    assert editor.car_files() == ["mine.yaml"]
    assert "mine.yaml" in next(f for f in form(editor.state.data, cars=editor.car_files()).walk() if f.name == "cars").choices
    editor.set(("scene", "cars"), ["mine.yaml"])
    asyncio.run(room.redraw())
    assert (editor.errors, room.error) == ({}, "")
    assert room.shown is not None
    assert room.shown.scene.place == "mine"
    triangles = len(room.shown.scene.backdrop.faces)
    assert triangles > 10_000
    before = room.bodies(room.shown)["cabin"]["shape"]
    car = editor.folder / "mine.yaml"
    car.write_text(car.read_text("utf-8") + "rules: [{pattern: '*', within: [[-0.3, -2, -1], [2, 2, 3]], hide: true}]\n", "utf-8")
    os.utime(car, ns=(1, 1))
    asyncio.run(room.redraw())
    assert len(room.shown.scene.backdrop.faces) < triangles
    assert room.bodies(room.shown)["cabin"]["shape"] != before


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("none.yaml", None, "cannot read"),
        ("wrong.yaml", "mesh: mine.glb\nseats: {driver: {h_pint: [0, 0, 0]}}\n", "seats.driver"),
        ("wrong.yaml", "mesh: none.glb\nseats: {driver: {h_point: [0, 0, 0]}}\n", "none.glb"),
        ("wrong.yaml", "mesh: mine.glb\nseats: {driver: {h_point: [0, 0, 9]}}\n", "outside the mesh"),
        ("../mine.yaml", None, "is outside of"),
        ("/mine.yaml", None, "is outside of"),
        ("link.yaml", None, "is outside of"),
    ],
)
def test_what_is_wrong_with_an_own_car_is_told_at_its_field(room: SceneRoom, name: str, text: str | None, words: str) -> None:
    editor = room.editor
    asyncio.run(room.redraw())
    before = room.shown
    (editor.folder.parent / "mine.yaml").write_text((editor.folder / "mine.yaml").read_text("utf-8"))
    (editor.folder / "link.yaml").symlink_to(editor.folder.parent / "mine.yaml")
    if text is not None:
        (editor.folder / name).write_text(text)
    editor.set(("scene", "cars"), ["suv", name])
    editor.set(("scene", "cars"), [name])
    asyncio.run(room.redraw())
    assert words in editor.errors[("scene", "cars")]
    assert room.error == ""
    assert before is not None
    assert room.shown is not None
    assert room.shown.scene.place == before.scene.place
    editor.set(("scene", "cars"), [name, "../other.yaml"])
    asyncio.run(room.redraw())
    assert "outside" in editor.errors[("scene", "cars")]  # the newest is told
    editor.undo()
    editor.undo()
    asyncio.run(room.redraw())
    assert editor.errors == {}


def test_recordings_of_a_browser_are_in_the_folder(room: SceneRoom) -> None:
    editor = room.editor
    for owner in (("scene",), ("scene", "occupants", "driver")):
        editor.set((*owner, "profile"), {"kind": "mocap", "path": "../secret.bvh"})
        assert "is outside of" in editor.errors[(*owner, "profile", "path")]
        editor.set((*owner, "profile"), {"kind": "mocap", "path": "walk.bvh"})
        assert editor.errors == {}


def test_file_on_the_disk_may_name_a_car_elsewhere(own_car: Path, tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(f"scene: {{cars: [{own_car / 'mine.yaml'}]}}\n")
    editor = SceneEditor(tmp_path, read_state(tmp_path / "scene.yaml"))
    assert editor.errors == {}
    other = SceneEditor(tmp_path)
    other.load("scene.yaml")
    assert other.errors == {}
    other.set(("scene", "belted"), 0.5)
    assert other.config.scene.belted == 0.5  # type: ignore[union-attr]


def test_relative_paths_stay_as_they_are(editor: SceneEditor) -> None:
    """A configuration with a car of the user's own can be moved with its folder."""
    (editor.folder / "mine").mkdir()
    (editor.folder / "mine" / "car.yaml").write_text("mesh: car.glb\nseats: {driver: {h_point: [0, 0, 0]}}\n")
    editor.set(("scene", "cars"), ["mine/car.yaml"])
    assert editor.config.scene.cars == (str(editor.folder / "mine" / "car.yaml"),)  # type: ignore[union-attr]
    assert yaml.safe_load(editor.save("mine.yaml").read_text())["scene"]["cars"] == ["mine/car.yaml"]


# --------------------------------------------------------------------------------------------------------- generation


def until(what: Callable[[], Any], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.slow
def test_nothing_is_generated_of_what_is_wrong_or_beside_another(tmp_path: Path) -> None:
    """The configuration of before the mistake would be made, and the first run ended without a word."""
    room = SceneRoom(None)
    room.editor.folder = tmp_path
    room.editor.set(("scene", "cars"), ["no_car"])
    with pytest.raises(ConfigError, match="nothing is made of what is wrong: "):
        room.generate("made", 4)
    assert room.generation is None
    room.editor.undo()
    room.generate("made", 40)
    with pytest.raises(ConfigError, match="made is being made"):
        room.generate("other", 4)
    room.stop()
    assert not (tmp_path / "other").exists()


@pytest.mark.slow
def test_generation_is_cancelled_and_resumed(tmp_path: Path, run: Callable[..., Any]) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("scene: {cars: [suv]}\noutput: {frames_per_part: 2}\n")
    room = SceneRoom(scene)
    room.generate("made", 40)
    generation = room.generation
    assert generation is not None
    until(lambda: generation.done >= 3)
    generation.cancel()
    until(lambda: not generation.running)
    assert "cancelled" in generation.words
    assert 3 <= generation.done < 40
    outcome = run("synth", "--config", scene, "--out", tmp_path / "made", "--frames", 40, "--resume")
    assert outcome.code == 0, outcome.err
    assert open_dataset(tmp_path / "made").sizes["frame"] == 40
    room.generate("made", 40)
    again = room.generation
    assert again is not None
    until(lambda: not again.running)
    assert "made" in again.error  # it exists
    for name in ("../made", "", ".", "a/b"):
        with pytest.raises(ConfigError, match="is no name in"):
            room.generate(name, 4)
    room.stop()


def fetched(room: SceneRoom, url: str) -> bytes:
    return bytes(room.body(url.rsplit("/", 1)[1]).body)


def corners(room: SceneRoom, body: dict[str, Any]) -> NDArray[np.float64]:
    """The corners (n, 3) of the triangles of a body, read as the page reads them."""
    shape, points = np.frombuffer(fetched(room, body["shape"]), "<u4"), fetched(room, body["points"])
    groups = int(shape[0])
    fine = int(shape[1 : 1 + min(groups, len(body["looks"]))].sum())
    x, y, z, step = np.frombuffer(points, "<f4", 4).astype(np.float64)
    count = (len(points) - 16) // 9
    steps = np.frombuffer(points, "<i2", 3 * count, 16).reshape(-1, 3)
    return (np.array([x, y, z]) + step * steps)[shape[1 + groups :][:fine]]


@pytest.fixture
def with_things(editor: SceneEditor, preview: Preview) -> tuple[SceneEditor, Shown]:
    """An accepted scene of three people with a child seat and things in hands."""
    scene = {
        "kind": "cabin", "cars": ["suv"], "occupancy": {}, "child_seats": {"rear_left": "infant"}, "in_hand": 1.0,
        "attachments": {"belt": 1.0},
        "occupants": {
            "driver": {"subject": "S03"}, "front_passenger": {"subject": "S05", "action": "phone_text"},
            "rear_right": {"subject": "S11", "action": "drink"},
        },
    }  # fmt: skip
    editor.set(("scene",), scene)
    editor.accept(draw(preview, editor))
    return editor, draw(preview, editor)  # with a cup, as this seed has it


def test_everything_that_the_camera_sees_is_drawn(with_things: tuple[SceneEditor, Shown]) -> None:
    """Triangle by triangle what the generator renders: cabin, people, belts, child seat with its belt, telephone and cup."""
    _, shown = with_things
    room = SceneRoom(None)
    drawn = {name: corners(room, body) for name, body in room.bodies(shown).items()}
    assert {name.split(":")[0] for name in drawn} == {
        "cabin", "driver", "front_passenger", "rear_right", "infant", "phone", "cup", "fastenings",
    }  # fmt: skip
    rendered = shown.scene.surface()
    np.testing.assert_allclose(
        np.sort(np.concatenate(list(drawn.values())), axis=0),
        np.sort(rendered.vertices[rendered.faces.ravel()], axis=0),
        atol=1e-4,
    )
    room.stop()


def test_cabin_far_away_is_coarser_and_the_same(with_things: tuple[SceneEditor, Shown]) -> None:
    """Every corner is a vertex of the fine form, and none of these is farther from one than a cell is wide."""
    _, shown = with_things
    room = SceneRoom(None)
    body = room.bodies(shown)["cabin"]
    shape = np.frombuffer(fetched(room, body["shape"]), "<u4")
    groups, looks = int(shape[0]), len(body["looks"])
    assert groups == 2 * looks
    lengths = shape[1 : 1 + groups].reshape(2, looks).sum(axis=1)
    assert lengths[0] == 3 * len(shown.scene.backdrop.faces)
    assert 1000 < lengths[1] < 0.6 * lengths[0]
    coarse = shown.scene.backdrop.vertices[shape[1 + groups + lengths[0] :]]
    fine = cKDTree(shown.scene.backdrop.vertices)
    np.testing.assert_allclose(coarse.min(axis=0), shown.scene.backdrop.vertices.min(axis=0), atol=0.06)
    assert cKDTree(coarse).query(fine.data)[0].max() < 0.06 * math.sqrt(3)
    room.stop()


def test_what_has_not_changed_is_not_sent_again(with_things: tuple[SceneEditor, Shown], preview: Preview) -> None:
    editor, shown = with_things
    room = SceneRoom(None)
    first = dict(room.bodies(shown))
    editor.turn_joint(shown, "rear_right", "head.rotation", 0.2)
    second = room.bodies(draw(preview, editor))
    assert {name for name in first if first[name]["points"] != second[name]["points"]} == {"rear_right"}
    assert {name for name in first if first[name]["shape"] != second[name]["shape"]} == set()
    assert len(fetched(room, second["rear_right"]["points"])) < 200_000
    room.stop()


def cup_of(shown: Shown) -> NDArray[np.float64]:
    return next(each for each in shown.scene.things if each.thing.kind == "cup").vehicle_from_thing


def test_what_is_held_follows_the_hand(with_things: tuple[SceneEditor, Shown], preview: Preview) -> None:
    """In the palm's frame the cup stays where it was, however the arm, the hand or the seat is moved."""
    editor, shown = with_things

    def held(now: Shown) -> NDArray[np.float64]:
        person = next(each for each in now.scene.people if each.slot == "rear_right")
        return np.linalg.inv(person.posed.palms[side]) @ cup_of(now)

    person = next(each for each in shown.scene.people if each.slot == "rear_right")
    away = {each: np.linalg.norm(person.posed.palms[each][:3, 3] - cup_of(shown)[:3, 3]) for each in "lr"}
    side = min(away, key=away.__getitem__)
    assert away[side] < 0.15
    before = held(shown)
    editor.turn_joint(shown, "rear_right", f"{side}elbow.flexion", 1.2)
    editor.turn_joint(shown, "rear_right", f"{side}wrist.flexion", 0.1)
    turned = draw(preview, editor)
    np.testing.assert_allclose(held(turned), before, atol=1e-6)
    assert np.linalg.norm(cup_of(turned) - cup_of(shown)) > 0.05
    editor.set_seat(turned, "rear_right", "fore_aft_m", turned.scene.settings["rear_right"].fore_aft_m)
    editor.move_hand(turned, "rear_right", side, person.posed.palms[side][:3, 3] + (0.05, 0.0, 0.05))
    np.testing.assert_allclose(held(draw(preview, editor)), before, atol=1e-6)


def test_outermost_of_a_box_is_looked_through_and_what_is_in_it_is_not() -> None:
    box, inside = trimesh.creation.box((2, 2, 2)), trimesh.creation.box((0.5, 0.5, 0.5))
    both = trimesh.util.concatenate([box, inside])
    kinds = np.zeros(len(both.faces), np.uint8)
    surface = Surface(
        both.vertices.astype(np.float32), both.vertex_normals.astype(np.float32), both.faces.astype(np.int32), kinds, kinds, kinds
    )
    assert _outermost(surface, np.arange(24)).tolist() == [True] * 12 + [False] * 12


def test_things_and_actions_of_extensions_are_offered(extension: Callable[..., None]) -> None:
    code = (
        "from dataclasses import replace\n"
        "from cabinpose.scene.things import CHILD_SEATS, OBJECTS\n"
        "from cabinpose.synth.posture import ACTIONS\n"
        "PARCEL, CARRIER = replace(OBJECTS['box']), replace(CHILD_SEATS['toddler'])\n"
        "WAVE = replace(ACTIONS['window'], name='wave')\n"
    )
    offers = {"things": {"parcel": "PARCEL", "carrier": "CARRIER"}, "actions": {"wave": "WAVE"}}
    extension("acme", offers, code)
    data = SynthConfig().model_dump(mode="json")
    data["scene"] |= {
        "child_seats": {"rear_left": "any"}, "objects": {"driver": {"box": 0.5}}, "occupants": {"driver": {"subject": "S01"}},
    }  # fmt: skip
    fields = {field.path: field for field in form(data).walk()}
    assert fields["scene", "child_seats", "rear_left"].choices[-2:] == ("booster_cushion", "carrier")
    assert fields["scene", "objects", "driver"].choices[-1] == "parcel"
    assert fields["scene", "occupants", "driver", "action"].choices[-1] == "wave"
