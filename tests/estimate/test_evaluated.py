"""`cabinpose evaluate --model`: on datasets as if its predictions had come from a file, and on ITOP frames."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import small
import sphere_people
import torch

from cabinpose.app.cli import main
from cabinpose.core.camera import Camera
from cabinpose.core.skeleton import ITOP
from cabinpose.estimate.export import export_onnx
from cabinpose.estimate.predictor import load_model
from cabinpose.estimate.training import Detector, TrainConfig
from cabinpose.evaluate.offline import frame_batch
from cabinpose.store import open_dataset
from cabinpose.store.itop import (
    NOMINAL_SCALE_M,
    as_labelled,
    project,
    read_itop_frames,
    read_itop_reference,
    recovered_scale,
)
from cabinpose.store.predictions import Predictions, write_predictions


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    manifest = sphere_people.manifest(
        frames=6, frames_per_part=6, width=small.SIZE[0], height=small.SIZE[1], persons=small.PERSONS
    )
    return sphere_people.write(tmp_path_factory.mktemp("data") / "spheres", manifest)


def numbers(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, object]:
    assert main(["evaluate", *arguments, "--json"]) == 0
    result: dict[str, object] = json.loads(capsys.readouterr().out)
    return result


def test_a_model_scores_as_its_predictions_do(
    data: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, dataset = load_model(trained["compact"]), open_dataset(data)
    found = model.predict(frame_batch(dataset, slice(0, 6)))
    file = tmp_path / "predictions.jsonl"
    write_predictions(
        file,
        Predictions(
            found.joints_2d, found.joints_3d, found.score, found.presence, frame=dataset["frame"].values, model="same",
            persons=model.persons, joints=model.joints, skeleton="cabinpose", dataset=None,
        ),
    )  # fmt: skip
    options = (str(data), "--presence", "0.0", "--resamples", "0")
    ran = numbers(capsys, *options, "--model", str(trained["compact"]), "--out", str(tmp_path / "page"))
    read = numbers(capsys, *options, "--predictions", str(file))
    first, second = (r["models"][0] for r in (ran, read))  # type: ignore[index]
    assert json.dumps(first["values"], sort_keys=True) == json.dumps(second["values"], sort_keys=True)
    assert (tmp_path / "page" / "index.html").stat().st_size > 1000
    one = numbers(capsys, *options, "--model", str(trained["compact"]), "--persons", "driver")
    assert one["models"][0]["people"] < first["people"]  # type: ignore[index]


@pytest.fixture(scope="module")
def itop_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An untrained network for ITOP's joints."""
    folder = tmp_path_factory.mktemp("itop")
    settings = {
        **small.TINY["compact"],
        "slots": ("standing",),
        "skeleton": "itop",
        "amplitude": False,
        "width": 96,
        "height": 96,
    }
    config = TrainConfig(settings={**settings, "focal": 114.3, "max_depth_m": 6.0})
    torch.manual_seed(0)
    state = Detector(config).state_dict()
    torch.save({"hyper_parameters": {"config": config.model_dump(mode="json")}, "state_dict": state}, folder / "best.ckpt")
    export_onnx(folder / "best.ckpt", folder / "itop.onnx", name="itop", card={})
    return folder / "itop.onnx"


def itop_file(path: Path, frames: int = 3) -> Path:
    rng = np.random.default_rng(0)
    joints = np.concatenate((rng.uniform(-0.5, 0.5, (frames, 15, 2)), rng.uniform(2.5, 3.0, (frames, 15, 1))), axis=-1)
    depth = np.kron(rng.uniform(0, 1, (frames, 10, 10)), np.ones((1, 10, 10))).astype(np.float32)  # noise would have nobody
    np.savez(path, depth01=depth, joints_3d=joints, frame=np.arange(frames))
    return path


def test_itop_frames_are_scored(itop_model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = itop_file(tmp_path / "frames.npz")
    result = numbers(capsys, "--itop-npz", str(file), "--model", str(itop_model))
    found = load_model(itop_model).predict(read_itop_frames(file)).joints_3d[:, 0]
    errors, anatomical = (
        np.linalg.norm(joints - read_itop_reference(file).joints_3d, axis=-1) for joints in (as_labelled(found), found)
    )
    assert result["frames"] == 3
    assert result["mean_cm"] == pytest.approx(100 * errors.mean(), rel=1e-5)
    assert result["within_10cm"] == pytest.approx(100 * (errors <= 0.1).mean(), rel=1e-5)
    assert result["within_10cm_anatomical"] == pytest.approx(100 * (anatomical <= 0.1).mean(), rel=1e-5)
    assert "pck_2d_26px" in result


def test_itop_frames_need_an_itop_model(trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = itop_file(tmp_path / "frames.npz")
    assert main(["evaluate", "--itop-npz", str(file), "--model", str(trained["compact"])]) == 2
    assert "hint: take the model `room` or `room_top`" in capsys.readouterr().err
    (tmp_path / "broken.npz").write_bytes(file.read_bytes()[:500])
    assert main(["evaluate", "--itop-npz", str(tmp_path / "broken.npz"), "--model", str(trained["compact"])]) == 2


@pytest.mark.real_data
def test_the_crop_looks_where_itop_looked(real_data: Callable[[str], Path]) -> None:
    """The surface at a joint's pixel lies just before the joint, which only holds with the right intrinsics and scale."""
    file = real_data("itop/itop_front_64.npz")
    frames, reference = read_itop_frames(file), read_itop_reference(file)
    k = frames["camera_k"]
    camera = Camera(100, 100, k[0, 0], k[1, 1], k[0, 2], k[1, 2])
    torso = reference.joints_3d[:, ITOP.joints.index("torso")]
    u, v = np.round(camera.project(torso)).astype(int).T
    before = torso[:, 2] - frames["depth"][np.arange(len(torso)), v, u]
    assert np.median(before) == pytest.approx(0.08, abs=0.02)
    np.testing.assert_allclose(camera.project(torso) * 2.4 + (40, 0), project(torso), atol=1e-9)


@pytest.mark.real_data
def test_most_real_frames_have_the_nominal_scale(real_data: Callable[[str], Path]) -> None:
    """The figure of their source, "about 4.24 m", is found again from the steps of the disparity alone."""
    with np.load(real_data("itop/itop_front_64.npz")) as arrays:
        scales = np.array([recovered_scale(frame) for frame in arrays["depth01"]])
    assert np.median(scales) == pytest.approx(NOMINAL_SCALE_M, rel=0.003)
    # One frame sees a point far behind the wall. Scaled by it, the wall has the level that it has in the others.
    with np.load(real_data("itop/itop_front_64.npz")) as arrays:
        far = arrays["depth01"][scales.argmax()]
    assert np.unique(far)[-2] * scales.max() == pytest.approx(np.median(scales), rel=0.003)


@pytest.mark.parametrize("farthest", [3.1, 4.24, 6.0])
def test_the_scale_follows_from_the_steps(farthest: float) -> None:
    rng = np.random.default_rng(3)
    pixels = 2 * 285.714 * 0.075 / rng.uniform(0.5 * farthest, farthest, (60, 80))  # disparity at 640 px, projector at 75 mm
    depth = 2 * 285.714 * 0.075 / (np.ceil(8 * pixels) / 8)
    depth[:5] = 0.0
    assert recovered_scale((depth / depth.max()).astype(np.float32)) == pytest.approx(depth.max(), rel=2e-3)


def test_smooth_depths_have_the_nominal_scale() -> None:
    assert recovered_scale(np.random.default_rng(3).uniform(0.5, 1, (60, 80))) == NOMINAL_SCALE_M
    assert recovered_scale(np.zeros((60, 80))) == NOMINAL_SCALE_M


def test_labels_lie_nearer_on_the_same_ray() -> None:
    joints = np.random.default_rng(1).uniform((-1, -1, 2), (1, 1, 4), (3, 15, 3))
    labelled = as_labelled(joints)
    np.testing.assert_allclose(project(labelled), project(joints), atol=1e-9)
    nearer = np.linalg.norm(joints, axis=-1) - np.linalg.norm(labelled, axis=-1)
    by_name = dict(zip(ITOP.joints, nearer.T, strict=True))
    for name, distance in (
        ("head", 0.0),
        ("lhand", 0.04),
        ("rfoot", 0.04),
        ("torso", 0.08),
        ("lshoulder", 0.08),
        ("rknee", 0.04),
    ):
        np.testing.assert_allclose(by_name[name], distance, atol=1e-9)


def test_labels_of_the_top_view_are_those_of_the_side_view_turned() -> None:
    """Two cameras see the same people: one level at their side, whose scale is too large, and one tilted on the ceiling."""
    people = np.random.default_rng(1).uniform((-0.5, -1.0, 2.5), (0.5, 1.0, 3.5), (6, 15, 3))  # m, axes of the camera at the side
    people[0] = (0.0, 0.0, 3.0)  # on its axis, where its rays are parallel to it
    top_from_side, tilt = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), np.radians(3.3)
    tilted = np.array([[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]]) @ top_from_side
    labels = as_labelled(1.147 * people) @ top_from_side.T
    shift = as_labelled(people @ tilted.T + (0.1, 0.3, 2.6), "top") - labels
    head = ITOP.joints.index("head")  # its label is not moved
    np.testing.assert_allclose(shift[:, head], np.broadcast_to(shift[0, head], (6, 3)), atol=1e-9)
    np.testing.assert_allclose(shift[0], np.broadcast_to(shift[0, head], (15, 3)), atol=1e-9)
