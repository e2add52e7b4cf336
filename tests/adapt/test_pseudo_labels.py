"""Which answers stand for labels, on tracks that are made with jumps in them; and what the rule says of two models."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import small
import torch
import xarray as xr

from cabinpose.app.adapt import stages
from cabinpose.app.adapt.decision import compared_errors, decide, floating, found_only, limb_spread, unsteadiness
from cabinpose.app.adapt.pseudo_labels import Course, Rules, choose, course_of, inconsistent, labelled
from cabinpose.app.adapt.stages import learning, some_rows
from cabinpose.core import CABINPOSE, ConfigError, Visibility
from cabinpose.estimate.augment import move
from cabinpose.estimate.batch import Batch, ray_tensor
from cabinpose.estimate.data import StoredFrames
from cabinpose.estimate.joint_predictor import JointPredictor
from cabinpose.estimate.settings import ViewSettings
from cabinpose.estimate.train_config import TrainConfig
from cabinpose.estimate.training import frame_spec
from cabinpose.store import Predictions

PEOPLE = ("driver", "front_passenger", "rear_left")
J = len(CABINPOSE.joints)
LIMBS = np.array(CABINPOSE.limbs)


def track(count: int, speed_m_s: float = 0.5, rate_hz: float = 10.0) -> tuple[Predictions, Course]:
    """A driver who moves evenly to the right, all joints of whom are surely seen; nobody beside."""
    body = np.stack((np.linspace(-0.3, 0.3, J), np.linspace(-0.2, 0.2, J), np.full(J, 1.0)), axis=-1)
    xyz = np.full((count, len(PEOPLE), J, 3), np.nan, np.float32)
    xyz[:, 0] = body + np.arange(count)[:, None, None] * (speed_m_s / rate_hz, 0, 0)
    presence = np.zeros(xyz.shape[:-1], np.float32)
    presence[:, 0] = 0.99
    error = np.where(presence > 0, 0.01, np.nan).astype(np.float32)
    found = Predictions(
        xyz[..., :2] * 100, xyz, presence, presence, frame=np.arange(count), persons=PEOPLE, joints=CABINPOSE.joints,
        model="made", expected_error_m=error,
    )  # fmt: skip
    return found, Course(np.arange(count) / rate_hz, np.zeros(count, np.int64))


def test_a_jump_is_no_label_and_neither_are_its_neighbours() -> None:
    found, course = track(12)
    xyz = found.joints_3d.copy()
    xyz[6, 0, 3] += (0.0, 0.6, 0.0)  # 6 m/s at 10 Hz, beyond 4 m/s and 2 cm
    chosen = choose(replace(found, joints_3d=xyz), course, Rules())
    expected = np.zeros((12, len(PEOPLE), J), bool)
    expected[:, 0] = True
    expected[5:8, 0, 3] = False
    assert (chosen.joints == expected).all()
    assert chosen.frames.all()


def test_what_a_body_can_do_is_no_jump() -> None:
    found, course = track(5, speed_m_s=3.9)
    assert not inconsistent(found.joints_3d, course, 4.0, np.zeros(found.presence.shape)).any()
    faster, _ = track(5, speed_m_s=4.1)
    assert inconsistent(faster.joints_3d, course, 4.0, np.zeros(found.presence.shape))[:, 0].all()
    slack = np.full(found.presence.shape, 0.01)  # of each of both: 2 cm are 0.2 m/s
    assert not inconsistent(faster.joints_3d, course, 4.0, slack).any()


def test_the_border_of_a_row_is_no_jump() -> None:
    found, course = track(6)
    xyz = found.joints_3d + np.where(np.arange(6) < 3, 0, 1)[:, None, None, None].astype(np.float32)
    apart = Course(course.time_s, np.array([0, 0, 0, 1, 1, 1]))
    assert not inconsistent(xyz, apart, 4.0, np.zeros(found.presence.shape)).any()
    assert inconsistent(xyz, course, 4.0, np.zeros(found.presence.shape))[2:4, 0].all()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"presence": (2, 0, slice(None), 0.8)}, "too few joints are sure"),
        ({"expected_error_m": (2, 0, slice(0, 15), 0.05)}, "too few joints are sure"),
        ({"presence": (2, 1, 4, 0.4)}, "somebody may or may not be there"),
        ({"presence": (2, 0, slice(None), 0.1)}, "nobody is found"),
        ({"joints_3d": (2, 0, slice(0, 16), 9.0)}, "joints jump"),
    ],
)
def test_frames_are_left_out_for_a_reason(change: dict[str, tuple[object, ...]], why: str) -> None:
    found, course = track(5)
    [(name, (*at, value))] = change.items()
    values = getattr(found, name).copy()
    values[tuple(at)] = value
    chosen = choose(replace(found, **{name: values}), course, Rules())
    wrong = {1, 2, 3} if name == "joints_3d" else {2}  # a jump is one from the frames beside it as well
    assert set(np.flatnonzero(~chosen.frames)) == wrong
    assert chosen.left_out == dict.fromkeys(chosen.left_out, 0) | {why: len(wrong)}


def test_frames_follow_each_other_by_time_and_sequence() -> None:
    coordinates = {"frame": np.arange(6), "sequence": ("frame", [0, 0, 0, 1, 1, 1])}
    stamps = np.array([1, 101, 2101, 2201, 2301, 2401]) * 1_000_000
    dataset = xr.Dataset(coords=coordinates | {"sync_ns": ("frame", stamps)})
    assert course_of(dataset).group.tolist() == [0, 0, 1, 2, 2, 2]
    untimed = dataset.assign_coords(sync_ns=("frame", np.zeros(6, np.int64)))
    assert len(set(course_of(untimed).group)) == 6
    with pytest.raises(ConfigError, match="frames that have times"):
        course_of(dataset, 10.0)
    assert course_of(untimed, 10.0).group.tolist() == [0, 0, 0, 1, 1, 1]
    assert np.diff(course_of(untimed, 10.0).time_s) == pytest.approx(0.1)


def test_the_last_quarter_judges_from_the_border_of_a_row_on() -> None:
    assert learning(Course(np.zeros(40), np.zeros(40, np.int64))) == 30
    assert learning(Course(np.zeros(40), np.repeat(np.arange(5), 8))) == 32
    assert some_rows(xr.Dataset(coords={"frame": np.arange(50)}), 60).tolist() == list(range(50))
    rows = some_rows(xr.Dataset(coords={"frame": np.arange(1000)}), 90)
    assert len(rows) == 90
    assert np.flatnonzero(np.diff(rows) > 1).tolist() == [29, 59]


# ------------------------------------------------------------------------------------------------- as a network learns it


def test_joints_that_did_not_pass_are_there_at_an_unknown_place() -> None:
    """Through training's own reader and its variation: the state stays, and the place is unknown."""
    found, course = track(5)
    presence = found.presence.copy()
    presence[:, 0, 5] = 0.7  # found, not sure
    presence[:, 0, 6] = 0.2  # not found
    found = replace(found, presence=presence)
    chosen = choose(found, course, Rules())
    assert chosen.frames.all()
    made = labelled(small.dataset(5).assign_attrs(width=64, height=48), found, chosen, np.zeros(5, bool))
    assert made["visibility"].values[:, 0, :5].tolist() == [[Visibility.VISIBLE] * 5] * 5
    assert (made["visibility"].values[:, 0, 5:7] == [Visibility.VISIBLE, Visibility.OUTSIDE_IMAGE]).all()
    assert (made["visibility"].values[:, 1:] == Visibility.ABSENT).all()
    assert (made["subject"].values == [["somebody", "", ""]] * 5).all()
    spec = frame_spec(TrainConfig(method="compact", settings=small.TINY["compact"]))
    kept = StoredFrames(made, spec)[0]
    assert kept.present.tolist() == [True, False, False]
    assert np.isnan(kept.joints[0, 5]).all()
    assert kept.visibility[0, 5] == Visibility.VISIBLE
    assert np.isfinite(kept.joints[0, 0]).all()


def test_frames_whose_front_row_was_exchanged_are_learnt_from_as_their_mirror_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing says where the wheel is; the model has seen it on the right in frame 1, and so named who sits there the driver."""
    found, course = track(3)
    model = SimpleNamespace(drive_side="")
    by_place = replace(found, joints_3d=found.joints_3d.copy())
    by_place.joints_3d[1] = by_place.joints_3d[1, [1, 0, 2]]
    monkeypatch.setattr(stages, "predict_dataset", lambda _, told: {"left": by_place, "": found}[told.drive_side])
    dataset = small.dataset(3).assign_attrs(width=64, height=48)
    turned = stages.exchanged(cast(JointPredictor, model), dataset, found)
    assert turned.tolist() == [False, True, False]
    assert model.drive_side == ""
    made = labelled(dataset, found, choose(found, course, Rules()), turned)
    spec = frame_spec(TrainConfig(method="compact", settings=small.TINY["compact"]))
    learnt, plain = (StoredFrames(each, spec) for each in (made, dataset))
    assert [int(learnt[i].wheel) for i in range(3)] == [0, 1, 0]
    for i in range(3):
        seen = plain[i].depth
        np.testing.assert_array_equal(learnt[i].depth, seen[:, ::-1] if i == 1 else seen)


def test_too_few_rows_of_frames_decide_nothing() -> None:
    """Ten frames in a row are one block, of which every resample is the same."""
    for count, told in ((10, "no difference"), (20, "no difference"), (30, "better")):
        clean, course = track(count, speed_m_s=0.0)
        decision = decide(wall(count, 0.95), noisy(clean, 0.01), clean, course)
        each = decision.measures["unsteadiness"]
        assert each.said == told
        assert np.isnan((each.low, each.high)).all() == (count < 30)
        assert decision.adopt == (count == 30)


def test_a_motion_leaves_the_state_of_what_has_no_place() -> None:
    """Two joints out of the image by a shift of 3 m: the one whose place is known has left, of the other nothing is known."""
    view = ViewSettings(width=64, height=48, focal=51.2).view
    joints = torch.full((1, 1, 2, 3), torch.nan)
    joints[0, 0, 0] = torch.tensor((32.0, 24.0, 1.0))
    states, there = torch.full((1, 1, 2), 4, dtype=torch.uint8), torch.ones(1, 1, dtype=torch.bool)
    batch = Batch(torch.ones(1, 48, 64), joints, states, there, None, None, torch.zeros(1, dtype=torch.bool))
    moved = move(batch, torch.eye(3)[None], torch.tensor([[3.0, 0, 0]]), ray_tensor(view), view.focal)
    assert moved.visibility.tolist() == [[[1, 4]]]


# ------------------------------------------------------------------------------------------------------------- the rule


def noisy(found: Predictions, sigma_m: float) -> Predictions:
    noise = np.random.Generator(np.random.Philox(5)).standard_normal(found.joints_3d.shape)
    return replace(found, joints_3d=(found.joints_3d + sigma_m * noise).astype(np.float32))


def test_measures_of_noise_are_those_of_its_law() -> None:
    """Second differences of noise s have 1.5 s² in each coordinate, and the mean length of such a vector is 4 s sqrt(0.75/π)."""
    found, course = track(200)
    assert np.nanmax(unsteadiness(found_only(found), course)) < 1e-6
    assert np.nanmax(limb_spread(found_only(found), LIMBS, course)) < 1e-5
    told = unsteadiness(found_only(noisy(found, 0.01)), course)
    assert np.isnan(told[[0, -1]]).all()
    assert np.nanmean(told) == pytest.approx(4 * 0.01 * np.sqrt(0.75 / np.pi), rel=0.03)
    assert np.nanmean(limb_spread(found_only(noisy(found, 0.001)), LIMBS, course)) > 0.001
    alone = Course(course.time_s, np.arange(200))
    assert np.isnan(unsteadiness(found_only(found), alone)).all()
    assert np.isnan(limb_spread(found_only(found), LIMBS, alone)).all()


def wall(count: int, depth_m: float) -> xr.Dataset:
    k = np.array([[100.0, 0, 31.5], [0, 100.0, 23.5], [0, 0, 1]])
    variables = {
        "depth": (("frame", "y", "x"), np.full((count, 48, 64), depth_m, np.float32)),
        "camera_k": (("frame", "r", "c"), np.repeat(k[None], count, 0)),
        "camera_dist": (("frame", "d"), np.zeros((count, 5))),
    }
    return xr.Dataset(variables, {"frame": np.arange(count)}, {"width": 64, "height": 48})


def test_joints_before_the_surface_float() -> None:
    found, _ = track(3, speed_m_s=0.0)  # at 1 m
    inside = [wall(3, 0.95), wall(3, 1.01)]
    assert [floating(each, found_only(found)).tolist() for each in inside] == [[0, 0, 0]] * 2
    assert floating(wall(3, 1.2), found_only(found)).tolist() == [1, 1, 1]
    assert np.isnan(floating(wall(3, np.nan), found_only(found))).all()


def test_the_rule_takes_what_is_better_and_leaves_what_is_not() -> None:
    clean, course = track(80, speed_m_s=0.0)
    dataset = wall(80, 0.95)
    worse = noisy(clean, 0.01)
    taken = decide(dataset, worse, clean, course)
    assert taken.adopt
    assert taken.words.startswith("take the adapted model: better by unsteadiness and limbs")
    left = decide(dataset, clean, worse, course)
    assert not left.adopt
    assert "it is worse by unsteadiness and limbs" in left.words
    same = decide(dataset, clean, clean, course)
    assert not same.adopt
    assert "better by nothing" in same.words
    assert same.moved_m == 0


def test_leaving_out_what_is_hard_gains_nothing() -> None:
    """Half of the joints are noisy; a model that no longer finds these is the same on all others."""
    clean, course = track(80, speed_m_s=0.0)
    mixed = noisy(clean, 0.01)
    mixed.joints_3d[:, :, ::2] = clean.joints_3d[:, :, ::2]
    presence = mixed.presence.copy()
    presence[:, :, 1::2] = 0
    told = decide(wall(80, 0.95), mixed, replace(mixed, presence=presence), course)
    assert {each.said for each in told.measures.values()} == {"no difference"}


def test_errors_on_generated_frames_count_those_in_the_image_alone() -> None:
    clean, course = track(40)
    states = np.full(clean.presence.shape, Visibility.VISIBLE, np.uint8)
    states[:, :, 0] = Visibility.OUTSIDE_IMAGE
    arrays = {
        "joints_3d": (("frame", "person", "joint", "xyz"), clean.joints_3d),
        "visibility": (("frame", "person", "joint"), states),
    }
    truth = xr.Dataset(arrays, {"person": list(PEOPLE), "joint": list(CABINPOSE.joints)})
    off = clean.joints_3d + np.float32((0.03, 0.04, 0.0))
    off[:, :, 0] += 1.0
    told = compared_errors(truth, replace(clean, joints_3d=off), clean)
    assert (told.before, told.after) == pytest.approx((5.0, 0.0), abs=1e-3)
    assert told.said == "better"
    assert decide(wall(40, 0.95), clean, clean, course, generated=told).adopt


def test_who_is_lost_is_no_gain() -> None:
    """A model that answers on the easy frames alone is steadier on them, and is left."""
    clean, course = track(80, speed_m_s=0.0)
    presence = clean.presence.copy()
    presence[::4] = 0
    lost = decide(wall(80, 0.95), noisy(clean, 0.01), replace(clean, presence=presence), course)
    assert not lost.adopt
    assert "people are found in 75 % of the frames instead of 100 %" in lost.words
