"""Frames in which nobody can be seen: no joints and a reason; pictures of people are answered."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cabinpose import _native
from cabinpose._native import estimate
from cabinpose.core import Camera, FrameBatch, PoseBatch, joined
from cabinpose.estimate import JointPredictor, PartSegmenter, load_model, open_model
from cabinpose.estimate.sight import _Limits, _Seen, unseen
from cabinpose.scene.sensor import SENSORS
from cabinpose.store.itop import read_itop_frames

SIDE = np.random.default_rng(3)
LIMITS = _Limits(4)
BUILDS = [p.name.split(".")[0] for p in Path(str(_native._baseline.__file__)).parent.glob("_*.so")]
Image = np.ndarray[Any, np.dtype[np.float64]]


def smooth(depth: Image) -> Image:
    """A corner of two bare walls."""
    return np.broadcast_to(1.5 / (1 + np.abs(np.linspace(-1, 1, depth.shape[1]))), depth.shape)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda d: np.full_like(d, np.nan), "0.0 % of the pixels have a depth"),
        (np.zeros_like, "0.0 % of the pixels have a depth"),
        (np.negative, "0.0 % of the pixels have a depth"),
        (lambda d: np.full_like(d, np.inf), "0.0 % of the pixels have a depth"),
        (lambda d: d * 10, "0.0 % of the pixels have a depth"),
        (lambda d: np.full_like(d, 0.05), "100.0 % of the depths are nearer than 0.2 m"),
        (lambda d: d / 1000, "100.0 % of the depths are nearer than 0.2 m"),
        (lambda d: np.full_like(d, 0.3) + 0.01 * SIDE.normal(size=d.shape), "nearer than 0.5 m"),
        (np.ones_like, "no silhouette"),
        (lambda d: 1 + 0.05 * SIDE.normal(size=d.shape), "no silhouette"),
        (lambda d: smooth(d) * (1 + 0.03 * SIDE.normal(size=d.shape)), "no silhouette"),
        (lambda d: np.where(np.arange(d.shape[1]) % 80 < 12, 0, 1 + 0.1 * SIDE.normal(size=d.shape)), "one surface"),
        (smooth, "no silhouette"),
        (lambda d: SIDE.uniform(0.3, 2.5, d.shape), "this is noise"),
        (lambda d: np.where(SIDE.random(d.shape) < 0.05, 1.0, np.nan), "scattered points"),
    ],
    ids=(
        "nan", "zero", "negative", "infinite", "decimetres", "hand", "kilometres", "near", "wall", "noisy", "noisy corner",
        "bars", "corner", "noise", "scattered",
    ),
)  # fmt: skip
def test_what_is_no_picture_has_nobody_and_a_reason(
    model: JointPredictor, frame: dict[str, Any], wrong: Callable[[Image], Image], said: str
) -> None:
    found = model(wrong(frame["depth"].astype(float)), frame["camera_k"], frame["amplitude"], camera_dist=frame["camera_dist"])
    assert said in str(found.reason)
    assert np.isnan(found.joints_3d).all()
    assert np.isnan(found.joints_2d).all()
    assert not found.presence.any()
    assert not found.score.any()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (np.zeros_like, "0.0 % of the pixels with a depth have an amplitude"),
        (lambda a: -a, "of the amplitudes are negative"),
        (lambda a: np.where(np.arange(a.shape[1]) == 170, np.nan, a), "of the amplitudes are not finite"),
        (lambda a: np.where(np.arange(a.shape[1]) == 170, np.inf, a), "of the amplitudes are not finite"),
        (lambda a: np.where(np.arange(a.shape[1]) % 2, 0, a), "have an amplitude above 0"),
    ],
    ids=["zero", "negative", "nan", "infinite", "every other column"],
)
def test_amplitudes_that_are_none_have_nobody_and_a_reason(
    model: JointPredictor, frame: dict[str, Any], wrong: Callable[[Image], Image], said: str
) -> None:
    light = wrong(frame["amplitude"].astype(float))
    found = model(frame["depth"], frame["camera_k"], light, camera_dist=frame["camera_dist"])
    assert said in str(found.reason)
    assert np.isnan(found.joints_3d).all()


def test_people_are_answered_without_a_reason_beside_frames_that_have_one(model: JointPredictor, frame: dict[str, Any]) -> None:
    found = model(frame["depth"], frame["camera_k"], frame["amplitude"], camera_dist=frame["camera_dist"])
    assert str(found.reason) == ""
    assert np.isfinite(found.joints_3d).all()
    assert found.remarks == ()
    # Of two frames the wrong one alone loses its joints.
    blind = np.stack((np.full_like(frame["depth"], np.nan), frame["depth"]))
    both = model(blind, frame["camera_k"], np.stack([frame["amplitude"]] * 2), camera_dist=frame["camera_dist"])
    assert [bool(reason) for reason in both.reason] == [True, False]
    assert np.isnan(both.joints_3d[0]).all()
    assert np.isfinite(both.joints_3d[1]).all()


def test_half_a_hand_on_the_lens_is_told_and_the_rest_answered(frame: dict[str, Any]) -> None:
    model = load_model("in_car", threads=1)
    half = np.where(np.arange(frame["depth"].shape[1]) < 0.35 * frame["depth"].shape[1], np.float32(0.05), frame["depth"])
    with pytest.warns(UserWarning, match="something lies on a part of the lens"):
        found = model(half, frame["camera_k"], frame["amplitude"], camera_dist=frame["camera_dist"])
    assert [remark.split(" % ")[1] for remark in found.remarks] == [
        "of the depths are nearer than 0.1 m: something lies on a part of the lens, and hides who is behind"
    ]
    assert str(found.reason) == ""
    assert np.isfinite(found.joints_3d).any()


def test_the_kernel_counts_what_numpy_counts_and_either_build_the_same(frame: dict[str, Any]) -> None:
    depth = np.nan_to_num(frame["depth"]).astype(np.float32)
    light = frame["amplitude"].astype(np.float32)
    light[5, 7:9] = -9, np.nan
    seen = [
        importlib.import_module(f"cabinpose._native.{name}").estimate.see(depth, amplitude=light, limits=LIMITS)
        for name in BUILDS
    ]
    assert all(each == seen[0] for each in seen)
    told = _Seen(*seen[0])
    some, valid = depth[::4, ::4], depth > 0
    pairs = (some[:, 1:] > 0) & (some[:, :-1] > 0)
    step = np.abs(np.diff(some, axis=1)) > np.float32(LIMITS.step) * some[:, :-1]
    wanted = ((some > 0).sum(), ((some > 0) & (some < LIMITS.nearer)).sum(), pairs.sum(), (pairs & step).sum(), valid.sum())
    assert (told.valid, told.nearer, told.pairs, told.steps, told.all_valid) == wanted
    assert told.joined == (valid[:, 1:] & valid[:, :-1]).sum()
    assert told.odd == (depth[5, 7] > 1 / 3) + 1
    # One surface has nothing off it, whatever its holes; half of another has.
    v, u = np.mgrid[:160, :192] / 192
    surface = (1 / (0.7 + 0.5 * u - 0.2 * v + 0.6 * u * u + 0.1 * u * v - 0.3 * v * v)).astype(np.float32)
    surface[40:60, 30:90] = 0
    assert _Seen(*estimate.see(surface, amplitude=light[:0, :0], limits=LIMITS))[-4::3] == (1920 - 70, 0)
    surface[:, 96:] *= 1.5
    assert _Seen(*estimate.see(surface, amplitude=light[:0, :0], limits=LIMITS)).off > 500


def test_who_stands_before_what_is_out_of_range_is_no_bare_wall() -> None:
    """In a doorway: all around the person nothing is measured, and the wall beside it is another surface."""
    wall = 3.8 + 0.002 * np.arange(96) + np.zeros((96, 1))
    doorway = np.where((np.arange(96) > 34) & (np.arange(96) < 84) & (np.arange(96)[:, None] > 22), 0.0, wall)
    person = doorway.copy()
    person[34:, 48:66] = 2.4 + 0.1 * np.abs(np.linspace(-1, 1, 18))
    (alone, _), (there, _) = unseen({"depth": np.stack((doorway, person)).astype(np.float32)}, [1.0, 1.0])
    assert "no silhouette" in alone
    assert there == ""


@pytest.mark.real_data
@pytest.mark.slow
def test_real_frames_of_people_are_answered(real_data: Callable[[str], Path]) -> None:
    k = np.array([[285.714, 0, 160.0], [0, 285.714, 120], [0, 0, 1]])
    with np.load(real_data("itop/itop_train_full_2.npz")) as file:
        frames = [(file["depth_mm"] / 1000, k)]
    with np.load(real_data("tof/kinect_v2_panoptic.npz")) as file:
        frames.append((file["depth_m"][None], file["camera_k"]))
    for view in ("front", "top"):
        itop = read_itop_frames(real_data(f"itop/itop_{view}_64.npz"))
        frames.append((itop["depth"], itop["camera_k"]))
    for name in ("room", "room_top", "paf"):  # paf sees a few pixels of them, which are not judged by their shape
        model = load_model(name, threads=1)
        for depth, camera_k in frames:
            assert not model(depth, camera_k).reason.any()


def test_reasons_go_with_their_frames() -> None:
    shape, reasons = (3, 2, 4), np.array(["", "covered", "a wall"], object)
    batch = PoseBatch(np.zeros((*shape, 2)), np.zeros((*shape, 3)), np.zeros(shape), np.zeros(shape), reason=reasons)
    assert batch.map(lambda a: a[[2, 0]]).reason.tolist() == ["a wall", ""]
    assert batch.map(lambda a: a[:, [1]][:, :, [0, 2]]).reason.tolist() == reasons.tolist()
    assert str(batch.map(lambda a: a[1]).reason) == "covered"
    assert joined([batch, batch]).reason.tolist() == [*reasons, *reasons]
    with pytest.raises(ValueError, match="reasons of shape"):
        PoseBatch(batch.joints_2d, batch.joints_3d, batch.score, batch.presence, reason=reasons[:2])


def test_a_field_of_view_that_the_model_does_not_know_is_told_once() -> None:
    narrow, usual, wide = (Camera.from_fov(320, 240, np.radians(fov)) for fov in (30, 90, 140))
    room, car = load_model("room", threads=1), load_model("in_car", threads=1)
    for name in SENSORS:  # of these and of frames cut out of them, nothing is said
        camera = SENSORS[name].camera
        cut = replace(camera, width=camera.width * 3 // 4, cx=camera.cx - camera.width / 8)
        assert not any(model.config.view.doubts(each) for model in (room, car) for each in (camera, cut))
    depth = np.ones((240, 320))
    with pytest.warns(UserWarning, match="in_car: images of 30° x 23° fill 3.9 % of the 103° x 93°"):
        (remark,) = car(depth, narrow.k, depth).remarks
    assert "fill" in remark
    with pytest.warns(UserWarning, match="room: the model looks at 46° x 46° about the axis, 3 % of images of 140° x 128°"):
        (remark,) = room(depth, wide.k).remarks
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*(fill|looks at)")
        assert car(depth, narrow.k, depth).remarks  # told before
        assert car(depth, usual.k, depth).remarks == room(depth, usual.k).remarks == ()


def test_a_segmentation_tells_its_field_of_view_once() -> None:
    parts = open_model("parts", threads=1)
    assert isinstance(parts, PartSegmenter)
    for fov, told in ((90, 0), (30, 1), (30, 0)):
        frames = FrameBatch(
            depth=np.ones((1, 240, 320), np.float32),
            camera_k=Camera.from_fov(320, 240, np.radians(fov)).k,
            camera_dist=np.zeros(5),
        )
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UserWarning)
            parts.segment(frames)
        assert len([each for each in caught if "parts: images of 30°" in str(each.message)]) == told
