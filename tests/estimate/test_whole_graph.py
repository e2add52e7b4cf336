"""The graph from a camera's images to joints gives the predictor's joints, also in C++; no other model has one."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from PIL import Image

from cabinpose.app.cli import main
from cabinpose.core import Camera, ConfigError, FrameBatch, ModelError
from cabinpose.estimate import load_model, whole_graph
from cabinpose.estimate.onnx_model import WHOLE, OnnxModel
from cabinpose.estimate.predictor import packaged_models

BUILD = Path(__file__).resolve().parents[2] / "examples" / "cpp" / "build.sh"
CAMERAS = {
    "pinhole": Camera(211, 167, 88.0, 91.5, 101.3, 84.9),
    "of a lens": Camera(352, 287, 155.0, 154.0, 171.2, 140.8, (-0.21, 0.05, 0.002, -0.001, -0.006)),
    # The radius grows up to the tangent 1.05 and falls from there on, back into the image; the view looks at up to 1.64.
    "whose lens folds": Camera(352, 287, 325.0, 325.0, 175.5, 143.0, (-0.3, 0.0, 0.0, 0.0, 0.0)),
}


def frame(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Depth (mm) and amplitude of a made-up scene: a wall, a body before it, a head, an arm, and holes."""
    v, u = np.mgrid[: camera.height, : camera.width]
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    depth = np.full(u.shape, 1500.0) + 200 * x
    depth[(np.abs(x - 0.2) < 0.25) & (y > 0.0)] = 900
    depth[np.hypot(x - 0.2, y + 0.15) < 0.14] = 850
    depth[(np.abs(y - 0.1 - 0.2 * x) < 0.05) & (x > -0.4) & (x < 0.2)] = 700
    depth[::7, ::5] = 0
    lit = np.where(depth > 0, 150e6 / np.maximum(depth, 300) ** 2, 0)
    return depth.round().astype(np.uint16), lit.round().astype(np.uint16)


def found(model: str, camera: Camera) -> np.ndarray:
    """(P, J, 3) m, the predictor's joints."""
    depth, light = frame(camera)
    predictor = load_model(model)
    frames = FrameBatch(
        depth=depth[None].astype(np.float32) / np.float32(1000), camera_k=camera.k, camera_dist=np.array(camera.dist),
        amplitude=light[None],
    )  # fmt: skip
    joints = predictor.predict(frames).joints_3d[0]
    assert np.isfinite(joints).all()
    return joints


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("whole")
    for unit in ("m", "mm"):
        assert main(["export", "onnx", "in_car", "--whole", unit, "--out", str(folder / f"{unit}.onnx")]) == 0
    return {unit: folder / f"{unit}.onnx" for unit in ("m", "mm")}


@pytest.mark.filterwarnings("ignore:.*polynomial.*|.*folds.*|.*distortion.*")
@pytest.mark.parametrize("unit", ["m", "mm"])
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_the_graph_gives_the_joints_of_the_predictor(whole: dict[str, Path], camera: Camera, unit: str) -> None:
    depth, light = frame(camera)
    given: dict[str, Any] = {"camera_k": camera.k, "camera_dist": np.array(camera.dist)}
    given |= {"depth": depth[None], "amplitude": light[None]}
    if unit == "m":
        metres = np.where(depth > 0, depth.astype(np.float32) / np.float32(1000), np.nan)
        given |= {"depth": metres[None].astype(np.float32), "amplitude": light[None].astype(np.float32)}
    session = onnxruntime.InferenceSession(str(whole[unit]), providers=["CPUExecutionProvider"])
    joints, pixels, presence = session.run(["joints_3d", "joints_2d", "presence"], given)
    np.testing.assert_allclose(joints[0], found("in_car", camera), atol=1e-4)
    # Independent of both: a joint in space is seen where the joint in the image is, as all weights of a joint add up to 1.
    assert presence.shape == joints.shape[:3] == (1, 2, 20)
    own = [i for i, name in enumerate(load_model("in_car").joints) if name in ("lelbow", "relbow", "lwrist", "rwrist")]
    np.testing.assert_allclose(camera.project(joints[0][:, own], folded=True), pixels[0][:, own], atol=1e-2)


def blind_frames(camera: Camera) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Depth (mm) and amplitude of frames in which nobody can be seen, one for each check, by what stands in its reason."""
    rng = np.random.Generator(np.random.Philox(key=3))
    size = (camera.height, camera.width)
    column = np.arange(camera.width)
    steps = np.where(column // 16 % 4 == 0, 1400, 1500) + np.zeros(size)  # edges of 7 % alone
    slope = 600.0 + 3 * column + np.where((column // 20 % 9 == 0), 400, 0) + np.zeros(size)  # one surface but for a ninth
    depths = {
        "and 0.3 % are needed": np.zeros(size), "the lens is covered": np.full(size, 90.0) + 40 * (column % 3),
        "nobody fits": rng.choice([250.0, 480.0], (camera.height // 16 + 1, camera.width // 16 + 1)).repeat(16, 0).repeat(16, 1),
        "this is noise": rng.uniform(600, 2500, size), "no silhouette": steps, "one surface": slope,
        "scattered points": np.where(rng.random(size) < 0.1, 1000.0 + column, 0.0),
    }  # fmt: skip
    lit = {
        name: (d[: size[0], : size[1]], np.where(d > 0, 150e6 / np.maximum(d, 1) ** 2, 0)[: size[0], : size[1]])
        for name, d in depths.items()
    }
    depth, light = frame(camera)
    lit["have an amplitude above 0"] = depth, np.where(np.arange(camera.width) % 3 > 0, light, 0)
    return {name: (d.round().astype(np.uint16), a.clip(0, 65535).round().astype(np.uint16)) for name, (d, a) in lit.items()}


@pytest.mark.filterwarnings("ignore")
def test_the_graph_expects_the_errors_of_the_predictor_and_is_blind_where_it_is(whole: dict[str, Path]) -> None:
    camera = CAMERAS["of a lens"]
    depth, light = frame(camera)
    blind = blind_frames(camera)
    closer = np.where(depth > 0, depth - 300, 0).astype(np.uint16)
    holes = np.where(np.arange(camera.width) % 5 < 3, depth, 0).astype(np.uint16)
    shown = [(depth, light), (closer, light), (holes, light), (depth[:, ::-1], light[:, ::-1]), *blind.values()]
    images = [np.ascontiguousarray(np.stack(each)) for each in zip(*shown, strict=True)]
    frames = FrameBatch(
        depth=images[0].astype(np.float32) / np.float32(1000), camera_k=camera.k, camera_dist=np.array(camera.dist),
        amplitude=images[1],
    )  # fmt: skip
    told = load_model("in_car").predict(frames)
    assert [*told.reason[:4]] == [""] * 4
    assert all(words in reason for words, reason in zip(blind, told.reason[4:], strict=True)), told.reason[4:]
    session = onnxruntime.InferenceSession(str(whole["mm"]), providers=["CPUExecutionProvider"])
    given = {"camera_k": camera.k, "camera_dist": np.array(camera.dist), "depth": images[0], "amplitude": images[1]}
    answers = dict(zip(whole_graph.OUTPUTS, session.run(list(whole_graph.OUTPUTS), given), strict=True))
    assert np.isfinite(told.expected_error_m[:4]).any()
    np.testing.assert_allclose(answers["expected_error"], told.expected_error_m, atol=1e-5)
    np.testing.assert_allclose(answers["joints_3d"], told.joints_3d, atol=1e-4)
    there = np.isfinite(told.joints_2d)  # not beyond where the lens folds: there the graph goes on by the polynomial
    assert there[:4].mean() > 0.5
    np.testing.assert_allclose(answers["joints_2d"][there], told.joints_2d[there], atol=1e-2)
    assert np.isnan(answers["joints_2d"][4:]).all()
    for name in ("presence", "score"):
        np.testing.assert_allclose(answers[name], getattr(told, name), atol=1e-4)
        assert not answers[name][4:].any()


@pytest.mark.slow
def test_a_graph_for_cars_with_the_wheel_on_the_right_names_the_front_row_so(tmp_path: Path) -> None:
    """Whatever the network sees; and so does the model itself."""
    camera = CAMERAS["pinhole"]
    depth, light = frame(camera)
    given = {"camera_k": camera.k, "camera_dist": np.array(camera.dist), "depth": depth[None], "amplitude": light[None]}
    joints, told = {}, {}
    for side in ("left", "right"):
        model, whole = tmp_path / f"{side}.onnx", tmp_path / f"whole-{side}.onnx"
        for out, more in ((model, []), (whole, ["--whole", "mm"])):
            assert main(["export", "onnx", "in_car", "--drive-side", side, "--out", str(out), *more]) == 0
        session = onnxruntime.InferenceSession(str(whole), providers=["CPUExecutionProvider"])
        (joints[side],) = session.run(["joints_3d"], given)
        told[side] = found(str(model), camera)
        np.testing.assert_allclose(joints[side][0], told[side], atol=1e-4)
    np.testing.assert_array_equal(joints["right"], joints["left"][:, ::-1])


def test_it_says_what_it_is_and_is_no_model_for_the_package(whole: dict[str, Path]) -> None:
    said = json.loads({p.key: p.value for p in onnx.load(str(whole["mm"])).metadata_props}[WHOLE])
    assert (said["name"], said["unit"], said["persons"]) == ("in_car", "mm", ["driver", "front_passenger"])
    assert said["joints"] == list(load_model("in_car").joints)
    with pytest.raises(ModelError, match="whole graph for other programs"):
        load_model(whole["mm"])


@pytest.mark.parametrize("name", ["paf", "lift", "parts"])
def test_other_models_have_none(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="has no whole graph"):
        whole_graph.write_whole_graph(OnnxModel(packaged_models()[name]), tmp_path / "whole.onnx", "m")
    assert not list(tmp_path.iterdir())


def test_a_graph_that_answers_something_else_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(whole_graph, "_centre", lambda k: k[:2, 2] + 0.7)
    with pytest.raises(ModelError, match=r"joints differ by .* m"):
        whole_graph.write_whole_graph(OnnxModel(packaged_models()["room"]), tmp_path / "whole.onnx", "m")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*lens sees nothing")
@pytest.mark.skipif("ONNXRUNTIME_ROOT" not in os.environ, reason="ONNXRUNTIME_ROOT names no release archive of ONNX Runtime")
def test_the_example_in_cpp_gives_the_joints_of_the_predictor(whole: dict[str, Path], tmp_path: Path) -> None:
    program, camera = tmp_path / "joints", CAMERAS["of a lens"]
    subprocess.run([str(BUILD), os.environ["ONNXRUNTIME_ROOT"], str(program)], check=True)
    for name, image in zip(("depth", "amplitude"), frame(camera), strict=True):
        head = f"P5 {camera.width} {camera.height} 65535\n".encode()
        (tmp_path / f"{name}.pgm").write_bytes(head + image.astype(">u2").tobytes())
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / f"{name}.pgm")), image)
    numbers = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.dist]
    command = [program, whole["mm"], tmp_path / "depth.pgm", tmp_path / "amplitude.pgm", *numbers]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=True)
    lines = np.array([line.split() for line in done.stdout.splitlines()], float)
    np.testing.assert_array_equal(lines[:, :2], np.argwhere(np.ones((2, 20))))
    np.testing.assert_allclose(lines[:, 2:5].reshape(2, 20, 3), found("in_car", camera), atol=1e-4)
    wrong = subprocess.run(
        [str(part) for part in [*command[:2], whole["mm"], *command[3:]]], capture_output=True, text=True, check=False
    )
    assert wrong.returncode == 1
    assert "is no binary PGM file" in wrong.stderr
