"""Depth images and a recording's frames as datasets, and calibration files of other tools; OpenCV writes its own here."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import xarray as xr
import yaml
from PIL import Image

from cabinpose.core import Camera, ConfigError, DatasetError, camera_from
from cabinpose.signals import Sample, ToFFrame
from cabinpose.store import open_dataset
from cabinpose.store.convert import open_source
from cabinpose.store.convert.camera_file import read_camera
from cabinpose.store.recording import RecordingWriter, Take
from cabinpose.store.source import import_source

SIZE = (16, 12)
SIDES = {"width": 16, "height": 12}
K = np.array([[12.5, 0, 7.4], [0, 12.5, 5.6], [0, 0, 1]])
DIST = np.array([-0.1, 0.02, 0.001, -0.002, 0.003])
DEPTH_M = np.linspace(0.5, 2.0, 192, dtype=np.float32).reshape(12, 16).round(3)


def imported(path: Path, out: Path, form: str = "depth-images", **options: Any) -> xr.Dataset:
    return open_dataset(import_source(open_source(path, form, **options), out))


def save(path: Path, depth: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, depth)
    else:
        Image.fromarray(depth).save(path)


MM, TICKS = (DEPTH_M * 1000).round().astype(np.uint16), (DEPTH_M * 4000).round().astype(np.uint16)


@pytest.mark.parametrize(
    ("name", "pixels", "unit", "told"),
    [
        pytest.param("a.png", MM, None, "in mm: its median is 1250", id="16-bit PNG"),
        pytest.param("a.tif", MM, None, "in mm: its median is 1250", id="16-bit TIFF"),
        pytest.param("a.tiff", DEPTH_M, None, "in m: its median is 1.25", id="TIFF of floats"),
        pytest.param("a.npy", DEPTH_M.astype(float) * 1000, None, "in mm: its median is 1250", id="NPY of floats in mm"),
        pytest.param("a.npy", DEPTH_M[None], None, "in m", id="a stack"),
        pytest.param("a.png", TICKS, "0.00025", "", id="steps of a quarter of a mm"),
        pytest.param("a.npy", DEPTH_M * 100, "cm", "", id="cm"),
    ],
)
def test_depth_comes_in_whatever_holds_it(tmp_path: Path, name: str, pixels: np.ndarray, unit: str | None, told: str) -> None:
    save(tmp_path / name, pixels)
    source = open_source(tmp_path / name, "depth-images", fov_deg=60.0, unit=unit)
    assert told in source.note
    assert bool(source.note) == (unit is None)
    found = open_dataset(import_source(source, tmp_path / "out"))
    np.testing.assert_allclose(found.depth[0].values, DEPTH_M, atol=1e-4)
    assert not found.visibility.values.any()


def test_frames_go_by_the_numbers_of_their_names_with_the_amplitudes_beside(tmp_path: Path) -> None:
    for number in (10, 2, 1):
        save(tmp_path / "own" / "depth" / f"f{number}.png", MM + np.uint16(number))
        save(tmp_path / "own" / "ir" / f"f{number}.png", np.full((12, 16), number, np.uint16))
    found = imported(tmp_path / "own", tmp_path / "out", intrinsics=(12.5, 12.5, 7.4, 5.6))
    assert found.amplitude[:, 0, 0].values.tolist() == [1, 2, 10]
    np.testing.assert_allclose(found.depth[:, 0, 0].values, [0.501, 0.502, 0.510], atol=1e-6)
    np.testing.assert_array_equal(found.camera_k[2].values, K)


def test_amplitudes_may_have_8_bits_and_integers_of_32_do_not_wrap(tmp_path: Path) -> None:
    save(tmp_path / "own" / "depth" / "1.png", MM)
    save(tmp_path / "own" / "ir" / "1.png", np.full((12, 16), 200, np.uint8))
    assert set(imported(tmp_path / "own", tmp_path / "out", fov_deg=60.0).amplitude.values.ravel()) == {200}
    for value, said in ((70000, "from 1250 to 70000"), (-1, "from -1 to 1250")):
        save(tmp_path / "a.tif", np.where(np.arange(192).reshape(12, 16) == 0, value, 1250).astype(np.int32))
        with pytest.raises(DatasetError, match=said):
            imported(tmp_path / "a.tif", tmp_path / "none", fov_deg=60.0)


def test_what_is_no_depth_is_invalid(tmp_path: Path) -> None:
    pixels = MM.copy()
    pixels[0, :2] = 0, 65535
    floats = DEPTH_M.copy()
    floats[0, :4] = np.nan, np.inf, -1.0, 0.0
    for name, values, invalid in (("a.png", pixels, 2), ("b.npy", floats, 4)):
        save(tmp_path / name, values)
        depth = imported(tmp_path / name, tmp_path / f"{name}-out", fov_deg=60.0).depth[0].values
        assert np.isnan(depth[0, :invalid]).all()
        assert np.isfinite(depth).sum() == depth.size - invalid


@pytest.mark.parametrize(
    ("name", "pixels", "options", "said"),
    [
        pytest.param("a.png", MM, {}, "do not say what camera", id="no camera"),
        pytest.param("a.png", TICKS * 4, {"fov_deg": 60.0}, "from its size: the median is 2e", id="unit not to tell"),
        pytest.param("a.png", np.ones((12, 16), np.uint16), {"fov_deg": 60.0}, "cannot be told", id="counts"),
        pytest.param("a.png", np.zeros((12, 16), np.uint16), {"fov_deg": 60.0}, "no pixel", id="all invalid"),
        pytest.param("a.png", np.ones((12, 16), np.uint8), {"fov_deg": 60.0}, "8 bits of grey, which is no depth", id="8 bits"),
        pytest.param("a.png", np.ones((12, 16, 3), np.uint8), {"fov_deg": 60.0}, "colours, which is no depth", id="colours"),
        pytest.param("a.npy", np.ones((12, 16), complex), {"fov_deg": 60.0}, "complex128", id="complex"),
        pytest.param("a.npy", np.array([["a"]], object), {"fov_deg": 60.0}, "no whole NPY", id="objects"),
        pytest.param("a.png", MM, {"fov_deg": 60.0, "unit": "inch"}, "no unit of depth: inch", id="unit unknown"),
        pytest.param("a.png", MM, {"fov_deg": 60.0, "intrinsics": (1, 1, 1, 1)}, "say the same", id="two cameras"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, name: str, pixels: np.ndarray, options: dict[str, Any], said: str) -> None:
    save(tmp_path / name, pixels)
    with pytest.raises((ConfigError, DatasetError), match=said):
        imported(tmp_path / name, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_sizes_and_missing_amplitudes(tmp_path: Path) -> None:
    for number, pixels in enumerate((MM, MM[:6])):
        save(tmp_path / "sizes" / f"{number}.png", pixels)
        save(tmp_path / "own" / "depth" / f"{number}.png", MM)
    save(tmp_path / "own" / "ir" / "0.png", MM)
    for folder, said in (("sizes", "has 16x6 pixels, not 16x12"), ("own", "ir has no image 1")):
        with pytest.raises(DatasetError, match=said):
            imported(tmp_path / folder, tmp_path / "out", fov_deg=60.0)


def opencv(path: Path) -> None:
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", SIZE[0])
    file.write("image_height", SIZE[1])
    file.write("camera_matrix", K)
    file.write("distortion_coefficients", DIST[None])
    file.release()


def as_text(data: Any) -> Callable[[Path], None]:
    return lambda path: path.write_text(json.dumps(data) if path.suffix == ".json" else yaml.safe_dump(data)) and None


FLAT = SIDES | {"fx": 12.5, "fy": 12.5}
ROS = {
    "image_width": 16, "image_height": 12, "camera_name": "tof", "distortion_model": "plumb_bob",
    "camera_matrix": {"rows": 3, "cols": 3, "data": K.ravel().tolist()},
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": DIST.tolist()},
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "write", "distorted"),
    [
        pytest.param("c.yml", opencv, True, id="OpenCV, YAML"),
        pytest.param("c.json", opencv, True, id="OpenCV, JSON"),
        pytest.param("c.yaml", as_text(ROS), True, id="ROS, camera_calibration"),
        pytest.param("c.yaml", as_text(SIDES | {"k": K.ravel().tolist(), "d": DIST.tolist()}), True, id="camera_info"),
        pytest.param("c.json", as_text(SIDES | {"intrinsic_matrix": K.T.ravel().tolist()}), False, id="Open3D"),
        pytest.param("c.json", as_text(FLAT | {"ppx": 7.4, "ppy": 5.6, "coeffs": DIST.tolist()}), True, id="RealSense"),
        pytest.param("c.yaml", as_text({"camera": FLAT | {"cx": 7.4, "cy": 5.6, "dist": DIST.tolist()}}), True, id="a sensor"),
        pytest.param("c.yaml", as_text({"intrinsics": FLAT | {"cx": 7.4, "cy": 5.6}}), False, id="a calibration of ours"),
        pytest.param("c.yaml", as_text({"K": K.tolist()}), False, id="rows"),
    ],
)
def test_calibrations_of_other_tools(tmp_path: Path, name: str, write: Callable[[Path], None], distorted: bool) -> None:
    write(tmp_path / name)
    assert read_camera(tmp_path / name, SIZE) == camera_from(K, DIST if distorted else np.zeros(5), *SIZE)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (None, "cannot read the camera"),
        ({"a": 1}, "says nothing of a camera"),
        (ROS | {"image_width": 32}, "is of images of 32x12 pixels, and these have 16x12"),
        (ROS | {"distortion_model": "equidistant"}, "the lens model is equidistant"),
        (ROS | {"distortion_coefficients": {"data": [0.1] * 8}}, "distortion_coefficients has 8 coefficients"),
        (ROS | {"camera_matrix": {"data": [1.0] * 4}}, "camera_matrix has 4 numbers, not 9"),
        (ROS | {"camera_matrix": {"data": "x"}}, "camera_matrix holds no numbers"),
        (ROS | {"camera_matrix": {"data": K.T.ravel().tolist()}}, "last column"),
        (FLAT, "does not say cx"),
    ],
)
def test_calibrations_that_cannot_be(tmp_path: Path, data: Any, said: str) -> None:
    if data is not None:
        as_text(data)(tmp_path / "c.yaml")
    with pytest.raises(ConfigError, match=said):
        read_camera(tmp_path / "c.yaml", SIZE)


def test_a_calibration_of_any_importer(tmp_path: Path) -> None:
    save(tmp_path / "a.png", MM)
    opencv(tmp_path / "c.yml")
    found = imported(tmp_path / "a.png", tmp_path / "out", camera=tmp_path / "c.yml")
    np.testing.assert_array_equal(found.camera_k[0].values, K)
    np.testing.assert_array_equal(found.camera_dist[0].values, DIST)


def film(path: Path, *names: str, take: Take | None = None) -> None:
    with RecordingWriter(path, take or Take(), started_ns=1000) as writer:
        for i in range(3):
            for name in names:
                frame = ToFFrame(MM + np.uint16(i), 0.001, MM, np.zeros((0, 0), np.uint8), K, DIST, DIST)
                assert not writer.write(name, Sample(i, 1000 + 100 * i, 100 * i, b"raw", (frame,)))


def test_frames_of_a_recording(tmp_path: Path) -> None:
    film(tmp_path / "a.mcap", "tof", take=Take.model_validate({"car": "sedan", "drive_side": "right"}))
    found = imported(tmp_path / "a.mcap", tmp_path / "out", "recording")
    np.testing.assert_allclose(
        found.depth.values - DEPTH_M, np.array([0, 0.001, 0.002])[:, None, None] * np.ones((3, 12, 16)), atol=1e-6
    )
    assert found.sync_ns.values.tolist() == [0, 100, 200]
    assert "confidence" not in found
    assert found.person.values.tolist()[0] == "driver"
    assert found.drive_side.values.tolist() == ["right"] * 3
    assert found.car.values.tolist() == ["sedan"] * 3
    np.testing.assert_array_equal(found.camera_dist[2].values, DIST)


def test_of_two_cameras_one_is_chosen(tmp_path: Path) -> None:
    film(tmp_path / "a.mcap", "left", "right")
    with pytest.raises(ConfigError, match="several cameras"):
        open_source(tmp_path / "a.mcap", "recording")
    assert imported(tmp_path / "a.mcap", tmp_path / "out", "recording", source="right").sizes["frame"] == 3
    with pytest.raises(DatasetError, match="no camera 'middle'"):
        open_source(tmp_path / "a.mcap", "recording", source="middle")


def test_a_centred_camera_of_a_field_of_view(tmp_path: Path) -> None:
    save(tmp_path / "a.png", MM)
    k = imported(tmp_path / "a.png", tmp_path / "out", fov_deg=60.0).camera_k[0].values
    np.testing.assert_array_equal(k, Camera.from_fov(*SIZE, np.pi / 3).k)
