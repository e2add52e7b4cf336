"""Exported models: the same answers as torch, and files that are no models."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import small
import torch
from numpy.typing import NDArray

from cabinpose.core.errors import ConfigError, ModelError
from cabinpose.core.ports import FrameBatch, Predictor
from cabinpose.core.skeleton import JOINTS
from cabinpose.estimate.export import TOLERANCE, export_onnx
from cabinpose.estimate.onnx_model import METADATA_KEY, OnnxModel
from cabinpose.estimate.predictor import load_model
from cabinpose.estimate.training import load_detector


def frame_batch(count: int = 3, *, amplitude: bool = True) -> FrameBatch:
    made = [small.frame(i) for i in range(count)]
    frames: FrameBatch = {
        "depth": np.array([f["depth"] for f in made]).reshape(count, 48, 64),
        "camera_k": np.array([f["camera_k"] for f in made]).reshape(count, 3, 3),
        "camera_dist": np.zeros(5),
    }
    if amplitude:
        frames["amplitude"] = np.array([f["amplitude"] for f in made]).reshape(count, 48, 64)
    return frames


@pytest.mark.parametrize("method", small.NETWORKS)
def test_onnx_says_what_torch_says(method: str, checkpoints: dict[str, Path], tmp_path: Path) -> None:
    path = tmp_path / "deep" / "model.onnx"
    difference = export_onnx(checkpoints[method], path, name="mine", card={"seeds": [1]})
    assert 0 <= difference <= TOLERANCE == 1e-4
    meta = json.loads({p.key: p.value for p in onnx.load(path).metadata_props}[METADATA_KEY])
    assert (meta["name"], meta["method"], meta["card"]) == ("mine", method, {"seeds": [1]})
    assert [p.name for p in path.parent.iterdir()] == ["model.onnx"]
    with pytest.raises(ModelError, match="exists"):
        export_onnx(checkpoints[method], path, name="mine", card={})
    export_onnx(checkpoints[method], path, name="other", card={}, overwrite=True)


def test_a_mirrored_model_knows_no_side(checkpoints: dict[str, Path], trained: dict[str, Path], tmp_path: Path) -> None:
    """It says of the mirror image what it says of the frame, sides swapped, and that is the mean of what the plain one says."""
    assert export_onnx(checkpoints["compact"], tmp_path / "m.onnx", name="m", card={}, mirrored=True) <= TOLERANCE
    model, plain = OnnxModel(tmp_path / "m.onnx", threads=1), OnnxModel(trained["compact"], threads=1)
    rng = np.random.default_rng(4)
    view = model.config.view
    frame = {name: rng.uniform(0.5, 2, (1, view.height, view.width)).astype(np.float32) for name in ("depth", "amplitude")}
    image = {name: np.ascontiguousarray(array[..., ::-1]) for name, array in frame.items()}
    other_side = {name: ("r" if name[0] == "l" else "l") + name[1:] for name in JOINTS}
    swap = [JOINTS.index(other_side[name]) if other_side[name] in JOINTS else i for i, name in enumerate(JOINTS)]

    def reflected(uvz: NDArray[np.float32], slots: list[int]) -> NDArray[np.float32]:
        uvz = uvz[:, slots][:, :, swap]
        uvz[..., 0] = view.width - 1 - uvz[..., 0]
        return uvz

    def mean(slots: list[int]) -> NDArray[np.float32]:
        return (plain.outputs(frame)["joints"] + reflected(plain.outputs(image)["joints"], slots)) / 2

    one, other = model.outputs(frame)["joints"], model.outputs(image)["joints"]
    # Noise shows no wheel: it may be taken for a front row or for a bench that looks backwards, whose places change sides.
    (slots,) = (slots for slots in ([0, 1, 2], [1, 0, 2]) if np.allclose(one, mean(slots), atol=1e-3))
    np.testing.assert_allclose(one, reflected(other, slots), atol=1e-3)
    assert np.abs(one - plain.outputs(frame)["joints"]).max() > 0.1
    with pytest.raises(ConfigError, match="mirrored form"):
        export_onnx(checkpoints["paf"], tmp_path / "p.onnx", name="p", card={}, mirrored=True)


def test_a_model_that_differs_is_not_kept(checkpoints: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cabinpose.estimate.export.TOLERANCE", -1.0)
    with pytest.raises(ModelError, match="differs from torch"):
        export_onnx(checkpoints["lifting"], tmp_path / "m.onnx", name="m", card={})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("method", ["compact", "paf"])
def test_a_predictor_answers_as_the_network_does(method: str, checkpoints: dict[str, Path], trained: dict[str, Path]) -> None:
    predictor = load_model(trained[method], threads=1)
    assert isinstance(predictor, Predictor)
    assert predictor.name == method
    assert predictor.persons == small.PERSONS
    frames = frame_batch(19)  # more than one batch
    poses = predictor.predict(frames)
    shape = (19, 3, len(predictor.joints))
    assert poses.joints_2d.shape == (*shape, 2)
    assert poses.joints_3d.shape == (*shape, 3)
    assert poses.score.shape == poses.presence.shape == shape
    assert all(a.dtype == np.float32 for a in (poses.joints_2d, poses.joints_3d, poses.score, poses.presence))
    detector = load_detector(checkpoints[method])
    seen = {"depth": np.nan_to_num(frames["depth"]), "amplitude": frames["amplitude"].astype(np.float32)}
    with torch.no_grad():
        values = detector.network(*(torch.from_numpy(seen[name]) for name in predictor.config.inputs))
    outputs = {name: getattr(values, name).numpy() for name in detector.method.outputs}
    found = detector.method.decode(outputs, detector.method_config, seen)
    np.testing.assert_allclose(poses.joints_2d, found.uv, atol=2e-3)  # the camera is the view
    np.testing.assert_allclose(poses.joints_3d, found.joints_3d, atol=1e-3)
    np.testing.assert_allclose(poses.presence, found.presence, atol=1e-4)


def test_one_camera_serves_all_frames(trained: dict[str, Path]) -> None:
    predictor = load_model(trained["compact"], threads=1)
    frames = frame_batch()
    each = predictor.predict(frames)
    shared = predictor.predict({**frames, "camera_k": frames["camera_k"][0]})
    np.testing.assert_array_equal(each.joints_3d, shared.joints_3d)


@pytest.mark.parametrize("method", ["compact", "paf"])
def test_no_frames_give_no_joints(method: str, trained: dict[str, Path]) -> None:
    poses = load_model(trained[method], threads=1).predict(frame_batch(0))
    assert poses.joints_3d.shape[:2] == (0, 3)


def test_missing_amplitudes_are_named(trained: dict[str, Path]) -> None:
    with pytest.raises(ConfigError, match="amplitudes") as caught:
        load_model(trained["compact"], threads=1).predict(frame_batch(amplitude=False))
    assert caught.value.hint
    assert len(load_model(trained["paf"], threads=1).predict(frame_batch(amplitude=False)).score) == 3


def test_a_truncated_file_is_a_model_error(trained: dict[str, Path], tmp_path: Path) -> None:
    torn = tmp_path / "torn.onnx"
    torn.write_bytes(trained["compact"].read_bytes()[:2000])
    with pytest.raises(ModelError, match="cannot be read") as caught:
        load_model(torn)
    assert "again" in caught.value.hint


def changed(source: Path, target: Path, change: Any) -> Path:
    model = onnx.load(source)
    metadata = json.loads({p.key: p.value for p in model.metadata_props}[METADATA_KEY])
    onnx.helper.set_model_props(model, change(metadata))
    onnx.save(model, target)
    return target


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: {}, "another program"),
        (lambda m: {METADATA_KEY: "{"}, "does not say"),
        (lambda m: {METADATA_KEY: json.dumps(m | {"method": "nobody"})}, "method 'nobody', which is not installed"),
        (lambda m: {METADATA_KEY: json.dumps(m | {"config": {"width": -1}})}, "width"),
    ],
)
def test_foreign_files_are_model_errors(change: Any, words: str, trained: dict[str, Path], tmp_path: Path) -> None:
    path = changed(trained["compact"], tmp_path / "foreign.onnx", change)
    with pytest.raises(ModelError, match=words) as caught:
        load_model(path)
    assert caught.value.hint


def test_a_missing_file_is_a_model_error(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no model") as caught:
        load_model(tmp_path / "none.onnx")
    assert caught.value.hint
