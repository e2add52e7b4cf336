"""Seats told by place: where the wheel is on the other side, the driver is still the driver, whoever says so."""

from __future__ import annotations

import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
import small
import sphere_people
from test_paf import CONFIG, J, drawn, person

from cabinpose.app.cli import main
from cabinpose.core import CABINPOSE, FrameBatch
from cabinpose.estimate.compact.config import CompactConfig
from cabinpose.estimate.found import Found, mirrored
from cabinpose.estimate.joint_predictor import JointPredictor
from cabinpose.estimate.paf.decode import decode
from cabinpose.estimate.predictor import describe_model
from cabinpose.scene.cabin import build_cabin
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.variables import TABLE, FrameFacts

DRIVER_M, PASSENGER_M = 0.8, 1.2  # who is who, by depth
VIEW = CONFIG.view


class Drawing:
    """A trained paf whose network draws its maps about two surfaces that it sees, the nearest at the left and the right half."""

    name, config, drive_side, expected_error, answers = "drawing", CONFIG, "", {}, ()
    persons, joints, skeleton, learnt = CONFIG.slots, CONFIG.joints, "cabinpose", CABINPOSE
    trained_on: ClassVar[dict[str, str]] = {}

    def run(self, seen: dict[str, np.ndarray]) -> Found:
        maps = []
        for depth in seen["depth"]:
            columns = np.flatnonzero((depth > 0).any(axis=0))
            groups = np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1)
            maps.append(drawn([person(float(group.mean()), 40.0) for group in groups]))
        outputs = {name: np.concatenate([m[name] for m in maps]) for name in maps[0]}
        return decode(outputs, CONFIG, seen)


@pytest.fixture(autouse=True)
def strips_are_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """The two strips below stand for people, and nothing is seen in them."""
    monkeypatch.setattr("cabinpose.estimate.joint_predictor.unseen", lambda _, filled: [("", "")] * len(filled))


def frames(driver_u: float, passenger_u: float, count: int = 1, **more: Any) -> FrameBatch:
    """Two upright surfaces about those columns of the view, through the view's own camera."""
    depth = np.zeros((count, VIEW.height, VIEW.width), np.float32)
    for u, metres in ((driver_u, DRIVER_M), (passenger_u, PASSENGER_M)):
        depth[:, :, round(u) - 30 : round(u) + 31] = metres
    return FrameBatch(depth=depth, camera_k=VIEW.camera.k, camera_dist=np.zeros(5), **more)


def driver_depth(predictor: JointPredictor, batch: FrameBatch) -> list[float]:
    """Where the driver's neck is measured in each frame, less its offset from the skin."""
    neck = CONFIG.joints.index("neck")
    return (predictor.predict(batch).joints_3d[:, 0, neck, 2] - CONFIG.offsets_m[neck]).round(2).tolist()


def predictor() -> JointPredictor:
    return JointPredictor(Drawing())  # type: ignore[arg-type]


def test_the_driver_of_a_right_hand_drive_is_known_where_it_is_said() -> None:
    left, right = frames(120, 50), frames(50, 120)
    assert driver_depth(predictor(), left) == [pytest.approx(DRIVER_M)]
    assert driver_depth(predictor(), right) == [pytest.approx(PASSENGER_M)]  # nothing says it: as before
    assert driver_depth(predictor(), right | {"drive_side": np.array(["right"])}) == [pytest.approx(DRIVER_M)]
    told = predictor()
    told.drive_side = "right"
    assert driver_depth(told, right) == [pytest.approx(DRIVER_M)]
    told.drive_side = "left"  # what is told counts, not what the frames say
    assert driver_depth(told, right | {"drive_side": np.array(["right"])}) == [pytest.approx(PASSENGER_M)]
    of_file = predictor()
    of_file.model.drive_side = "right"
    assert driver_depth(of_file, right) == [pytest.approx(DRIVER_M)]
    assert driver_depth(of_file, left | {"drive_side": np.array(["left"])}) == [pytest.approx(DRIVER_M)]  # frames before the file


def test_a_side_that_nothing_says_is_told_once() -> None:
    left, told = frames(120, 50), predictor()
    with pytest.warns(UserWarning, match="takes it to be on the left. Say it with --drive-side left or right"):
        driver_depth(told, left)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        driver_depth(told, left)
        driver_depth(predictor(), left | {"drive_side": np.array([""])})  # which has no wheel
        of_file = predictor()
        of_file.model.drive_side = "right"
        driver_depth(of_file, left)


class Seeing(Drawing):
    """A trained compact, which answers by place whatever the frames are, the nearer at the left, and where the wheel seems."""

    config, answers = CompactConfig(width=96, height=96, focal=100.0, slots=("driver", "front_passenger")), ("joints", "wheel")
    persons, joints = config.slots, config.joints

    def __init__(self, wheel: list[float] | None) -> None:
        self.wheel = wheel

    def run(self, seen: dict[str, np.ndarray]) -> Found:
        shape = len(seen["depth"]), 2, len(self.joints)
        uvz = np.zeros((*shape, 3)) + np.array([DRIVER_M, PASSENGER_M]).reshape(1, 2, 1, 1)
        some = np.ones(shape)
        return Found(uvz[..., :2], uvz, some, some, None, None if self.wheel is None else np.array(self.wheel))


@pytest.mark.parametrize(
    ("wheel", "said", "nearer"),
    [
        ([2.0, -2.0, -0.5], None, [True, False, True]),  # as it is seen; where there seems to be none, as they were learnt
        ([2.0, -2.0, -0.5], ["right", "left", ""], [False, True, True]),  # who says it knows
        ([-2.0, -2.0, -2.0], ["", "left", "right"], [False, True, False]),
        (None, ["right", "left", ""], [True, True, True]),  # an older model tells by itself who drives
    ],
)
def test_a_model_that_sees_the_wheel_is_told_where_it_is(
    wheel: list[float] | None, said: list[str] | None, nearer: list[bool]
) -> None:
    batch = FrameBatch(
        depth=np.full((3, 96, 96), 1.0, np.float32), amplitude=np.full((3, 96, 96), 150, np.uint16), camera_k=np.array(
            Seeing.config.view.camera.k), camera_dist=np.zeros(5), **({} if said is None else {"drive_side": np.array(said)}),
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = JointPredictor(Seeing(wheel)).predict(batch)  # type: ignore[arg-type]
    assert (found.joints_3d[:, 0, 0, 2] < found.joints_3d[:, 1, 0, 2]).tolist() == nearer


def test_frames_of_both_kinds_go_together() -> None:
    left, right = frames(120, 50), frames(50, 120)
    depth = np.concatenate([left["depth"], right["depth"], right["depth"]])
    batch = FrameBatch(
        depth=depth, camera_k=left["camera_k"], camera_dist=np.zeros(5), drive_side=np.array(["left", "right", ""])
    )
    assert driver_depth(predictor(), batch) == pytest.approx([DRIVER_M, DRIVER_M, PASSENGER_M])


def test_the_answer_is_that_of_the_mirrored_frame_mirrored() -> None:
    right = frames(50, 120, drive_side=np.array(["right"]))
    found = predictor().predict(right)
    other = predictor().predict(frames(VIEW.width - 1 - 50, VIEW.width - 1 - 120))
    names = list(CONFIG.joints)
    pairs = {name: {"l": "r", "r": "l"}.get(name[0], "") + name[1:] for name in names}
    swap = [names.index(pairs[name] if pairs[name] in names else name) for name in names]
    np.testing.assert_allclose(found.joints_2d[..., 0], VIEW.width - 1 - other.joints_2d[:, :, swap, 0], atol=1e-4)
    np.testing.assert_allclose(found.joints_3d * (-1, 1, 1), other.joints_3d[:, :, swap], atol=1e-6)
    # Left stays left: a person in front of the camera has the left shoulder at the right in the image.
    assert (found.joints_2d[0, :, names.index("lshoulder"), 0] > found.joints_2d[0, :, names.index("rshoulder"), 0]).all()


def test_a_mirror_image_twice_is_the_answer_itself() -> None:
    rng = np.random.Generator(np.random.Philox(1))
    config = CONFIG.model_copy(update={"slots": ("driver", "rear_left", "rear_right")})
    uv, z = rng.uniform(0, 100, (2, 3, J, 2)), rng.uniform(0.5, 2, (2, 3, J, 1))
    found = Found(uv, VIEW.from_view(np.concatenate((uv, z), axis=-1)), rng.random((2, 3, J)), rng.random((2, 3, J)))
    once = mirrored(found, config)
    np.testing.assert_allclose(once.joints_3d, VIEW.from_view(np.concatenate((once.uv, once.joints_3d[..., 2:]), axis=-1)))
    assert np.array_equal(once.score[:, 1, 0], found.score[:, 2, 0])  # the head of whoever sits at the other side behind
    assert once.spreads is None
    for one, two in zip(found[:4], mirrored(once, config)[:4], strict=True):
        np.testing.assert_allclose(one, two)


@pytest.mark.parametrize(("cabin", "side"), [("sedan", "left"), ("sedan", "right"), ("shuttle", "")])
def test_a_dataset_says_where_the_wheel_is_where_it_is_asked_to(cabin: str, side: str) -> None:
    (row,) = [row for row in TABLE if "drive_side" in row.names(SynthConfig.parse({"output": {"drive_side": True}}))]
    assert not [row for row in TABLE if "drive_side" in row.names(SynthConfig())]
    car = build_cabin(cabin, drive_side=side or "right")  # type: ignore[arg-type]
    scene: Any = SimpleNamespace(cabin=car)
    nothing: Any = None
    facts = FrameFacts(SynthConfig(), 1, (), scene, *[nothing] * 6)
    assert row.make(facts) == {"drive_side": side}
    if car.steering_wheel is not None:  # the vehicle's y points to the left
        assert (car.steering_wheel.vehicle_from_wheel[1, 3] > 0) == (side == "left")


def test_the_commands_pass_on_what_they_are_told(
    checkpoints: dict[str, Path], trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    size = {"width": small.SIZE[0], "height": small.SIZE[1], "persons": small.PERSONS}
    data = str(sphere_people.write(tmp_path / "spheres", sphere_people.manifest(frames=4, frames_per_part=4, **size)))
    exported, plain = str(tmp_path / "right.onnx"), str(trained["paf"])
    assert main(["export", "onnx", str(checkpoints["paf"]), "--out", exported, "--drive-side", "right"]) == 0
    assert (describe_model(exported)["drive_side"], describe_model(plain)["drive_side"]) == ("right", "")
    turned: list[bool] = []
    told_of = JointPredictor._told

    def spied(self: JointPredictor, *of: Any) -> np.ndarray:
        told = told_of(self, *of)
        turned.extend((told == "right").tolist())
        return told

    monkeypatch.setattr(JointPredictor, "_told", spied)
    told = ["--drive-side", "right"]
    for words, mirrors in (
        (["predict", data, "--model", plain, "--out", str(tmp_path / "1.jsonl")], False),
        (["predict", data, "--model", plain, "--out", str(tmp_path / "2.jsonl"), *told], True),
        (["predict", data, "--model", exported, "--out", str(tmp_path / "3.jsonl")], True),
        (["predict", data, "--model", exported, "--out", str(tmp_path / "4.jsonl"), "--drive-side", "left"], False),
        (["evaluate", data, "--model", plain, "--resamples", "0", *told], True),
        (["live", "--source", data, "--model", plain, *told], True),
    ):
        turned.clear()
        assert main(words) == 0, capsys.readouterr().err
        assert turned == [mirrors] * 4, words


def test_a_model_without_seats_is_not_told_where_the_wheel_is(
    trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest = sphere_people.manifest(
        frames=2, frames_per_part=2, width=small.SIZE[0], height=small.SIZE[1], persons=small.PERSONS
    )
    data = sphere_people.write(tmp_path / "spheres", manifest)
    out = tmp_path / "found.jsonl"
    assert main(["predict", str(data), "--model", str(trained["unet"]), "--out", str(out), "--drive-side", "right"]) == 2
    error = capsys.readouterr().err
    assert "says nothing to unet" in error
    assert "hint:" in error
    assert not out.exists()
