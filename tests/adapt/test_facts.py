"""Facts about frames against closed forms, on frames that are made for it."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from cabinpose.app.adapt.differences import AnswerFacts, differences, fields_deg
from cabinpose.app.adapt.facts import BINS_M, CameraFacts, facts_of, mixed_pixels, still_noise
from cabinpose.core import Camera, DatasetError
from cabinpose.estimate import load_model

SHAPE = (120, 160)
A_M, B = 1e-3, 4e-3  # sigma = A + B z


def rng(number: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(number))


def frames(depth: np.ndarray, amplitude: np.ndarray | None = None) -> xr.Dataset:
    """A dataset of depths (F, H, W) of one camera."""
    count, height, width = depth.shape
    k = np.array([[100.0, 0, (width - 1) / 2], [0, 100.0, (height - 1) / 2], [0, 0, 1]])
    variables = {
        "depth": (("frame", "y", "x"), depth.astype(np.float32)),
        "camera_k": (("frame", "r", "c"), np.repeat(k[None], count, 0)),
        "camera_dist": (("frame", "d"), np.zeros((count, 5))),
    }
    if amplitude is not None:
        variables["amplitude"] = (("frame", "y", "x"), amplitude)
    return xr.Dataset(variables, {"frame": np.arange(count)})


def test_noise_over_time_of_what_stands_still() -> None:
    """A slope from 0.5 m to 2 m whose noise grows with the distance; a quarter of the image moves by 3 cm a frame."""
    true = np.broadcast_to(np.linspace(0.5, 2.0, SHAPE[1]), SHAPE)
    moves = np.zeros(SHAPE, bool)
    moves[:, :40] = True
    noise = rng()
    images = [true + 0.03 * n * moves + (A_M + B * true) * noise.standard_normal(SHAPE) for n in range(8)]
    found = still_noise([(images[n], images[n + 1]) for n in range(7)])
    assert len(found) == 8
    assert np.abs(found[:, 1] / (A_M + B * found[:, 0]) - 1).max() < 0.05
    assert found[0, 0] > true[0, 40]  # nothing of what moves


def test_rounding_is_taken_off() -> None:
    """Depths in whole millimetres, with noise of one."""
    step, sigma = 1e-3, 1e-3
    pair = [np.round((1.0 + sigma * rng(n).standard_normal(SHAPE)) / step) * step for n in range(6)]
    found = still_noise(list(zip(pair[::2], pair[1::2], strict=True)), step)
    assert found[:, 1].mean() == pytest.approx(sigma, rel=0.03)
    assert still_noise(list(zip(pair[::2], pair[1::2], strict=True)))[:, 1].mean() == pytest.approx(
        np.sqrt(sigma**2 + step**2 / 12), rel=0.03
    )


def test_a_camera_that_moves_tells_no_noise() -> None:
    pairs = [(1.0 + 0.001 * rng(n).standard_normal(SHAPE), 1.02 + 0.001 * rng(n + 9).standard_normal(SHAPE)) for n in range(3)]
    assert still_noise(pairs).shape == (0, 2)


def test_mixed_pixels_to_a_pixel_of_silhouette() -> None:
    """A plate at 1 m before a wall at 2 m: 40 pixels of upright edge, at half of which one pixel lies between."""
    whole = np.full((60, 80), 2.0)
    whole[10:50, :40] = 1.0
    region = np.zeros_like(whole, bool)
    region[15:45] = True
    depth = whole.copy()
    depth[15:45:2, 40] = 1.5
    assert mixed_pixels(depth, whole, region) == pytest.approx(15 / 30)
    assert mixed_pixels(whole, whole, region) == 0
    assert np.isnan(mixed_pixels(whole, np.full_like(whole, 2.0), region))


def test_quantiles_holes_light_and_image_circle() -> None:
    v, u = np.indices(SHAPE)
    radius = np.hypot(u - (SHAPE[1] - 1) / 2, v - (SHAPE[0] - 1) / 2)
    ramp = np.linspace(0.2, 2.2, np.prod(SHAPE)).reshape(SHAPE)
    lens = np.where(radius < 70, ramp, np.nan)
    told = facts_of(frames(np.stack([lens] * 3), np.full((3, *SHAPE), 80, np.uint16)))
    inside = ramp[radius < 70]
    assert told.depth_m == pytest.approx(np.quantile(inside, (0.05, 0.5, 0.95)).tolist(), abs=1e-4)  # float32 where it lies
    assert told.invalid == pytest.approx(np.mean(radius >= 70))
    assert told.light == pytest.approx(80 * np.median(inside) ** 2, rel=1e-5)
    assert told.field_px == pytest.approx(70, abs=0.6)
    assert told.histogram.sum() == pytest.approx(1)
    assert told.histogram[int(1.05 / 0.1)] == pytest.approx(np.mean((inside >= 1.0) & (inside < 1.1)), abs=1e-3)
    assert len(told.histogram) == len(BINS_M) - 1
    assert len(told.still_m) == 0


def test_what_has_no_depth_is_told() -> None:
    with pytest.raises(DatasetError, match="no pixel"):
        facts_of(frames(np.full((2, *SHAPE), np.nan)))
    with pytest.raises(DatasetError, match="no depth"):
        facts_of(frames(np.ones((2, *SHAPE))).drop_vars("depth"))


def test_field_of_view() -> None:
    straight = Camera.from_fov(320, 240, np.radians(90.0))
    assert fields_deg(straight) == pytest.approx(straight.fields_deg)
    barrel = Camera(320, 240, 160.8, 160.8, 159.5, 119.5, (-0.155, 0.0273, 0.0, 0.0, 0.0))
    assert fields_deg(barrel)[0] == pytest.approx(100, abs=0.5)  # as the data sheet of the EVK75123 has it


def test_what_stands_out_has_a_note() -> None:
    model = load_model("in_car")
    camera = Camera.from_fov(352, 287, np.radians(100.0))
    histogram = np.full(len(BINS_M) - 1, 0.025)
    usual = CameraFacts(9, camera, (0.3, 0.6, 1.4), histogram, 200.0, 0.2, 150.0, 1.4, 0.004, np.zeros((0, 2)))
    fine = AnswerFacts(0.0, 15.0, 0.01, 0.01)
    still = {row.what for row in differences(model, usual, usual, fine) if row.note}
    assert still <= {"noise over time, mm"}
    other = CameraFacts(9, camera, (1.0, 2.0, 3.0), histogram, 200.0, 0.6, 3.0, 0.2, 0.05, np.array([[1.0, 0.01]]))
    loud = {row.what: row.note for row in differences(model, other, usual, AnswerFacts(0.5, 5.0, 0.05, 0.01)) if row.note}
    assert "3.3 times as far" in loud["depth: median (5 to 95 %), m"]
    assert "scale the amplitudes by 50" in loud["amplitude × depth², median"]
    assert "40 %" in loud["pixels without a depth"]
    assert "takes mixed pixels out" in loud["mixed pixels to a px of silhouette"]
    assert "50 %" in loud["frames in which nobody is found"]
    assert "5.0 times" in loud["expected error, median"]
