"""Distances over many frames: stretches of them for charts, and what a heat map shows of each."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
import xarray as xr
from PIL import Image

from cabinpose.app.report.over_frames import over_frames_html
from cabinpose.evaluate import EvaluationOptions, FrameDistances, frame_distances, samples_of
from cabinpose.store.predictions import Predictions


def distances(by_joint: list[list[float]], mean: list[float]) -> FrameDistances:
    return FrameDistances("3d", ("head", "lhand"), 10 * np.arange(len(mean)), np.array(by_joint), np.array(mean), 10.0)


NONE, MISSED = np.nan, np.inf
FIVE = distances([[1, NONE], [3, NONE], [2, MISSED], [NONE, 8], [25, 4]], [1, 3, 2, 8, MISSED])


def test_stretches_keep_the_worst_and_what_was_missed() -> None:
    assert FIVE.binned(5) is FIVE
    two = FIVE.binned(3)
    assert two.frames.tolist() == [0, 20, 40]
    np.testing.assert_array_equal(two.by_joint, [[3, NONE], [2, MISSED], [25, 4]])
    np.testing.assert_array_equal(two.mean, [2, 5, MISSED])


def pixels(page: str) -> np.ndarray:
    """(J, F, 4) of the first heat map."""
    found = re.search(r'href="data:image/png;base64,([^"]+)"', page)
    assert found is not None
    return np.array(Image.open(io.BytesIO(base64.b64decode(found[1]))))


def test_a_heat_map_tells_hits_misses_and_gaps_apart() -> None:
    image = pixels(over_frames_html({"m": {"3d": FIVE}})).astype(int)
    assert image.shape == (2, 5, 4)
    assert image[..., 3].tolist() == [[255, 255, 255, 0, 255], [0, 0, 255, 255, 255]]  # clear where nothing counts
    red, blue = image[..., 0], image[..., 2]
    assert (blue > red)[0, :3].all()  # hits
    assert (red > blue)[0, 4]  # 25 cm, beyond twice the threshold
    assert image[1, 2, :3].max() < 0x20  # not found


def test_lines_break_where_a_joint_was_not_found() -> None:
    """The hand: nothing in the first frames, missed in the third, then a line of two points."""
    page = over_frames_html({"m": {"3d": FIVE}})
    (hand,) = re.findall(r'<g class="line2"><title>lhand</title><path d="([^"]*)"', page)
    assert re.fullmatch(r"M[\d.,]+L[\d.,]+", hand)
    (head,) = re.findall(r'<g class="line1"><title>head</title><path d="([^"]*)"', page)
    assert head.count("M") == 3  # three in a row, and one alone, which gets a dot
    assert head.endswith("l0.01,0")
    assert over_frames_html({}) == ""


def test_joints_whose_place_in_space_is_not_known_are_not_missed(dataset: xr.Dataset, predictions: Predictions) -> None:
    """As of labels in an image that depth did not lift."""
    truth = dataset.copy()
    truth["joints_3d"] = truth["joints_3d"].where(truth["joint"] != "neck")
    samples, _ = samples_of(truth, predictions, EvaluationOptions(resamples=0))
    neck = frame_distances(samples, "3d", EvaluationOptions()).joints.index("neck")
    assert np.isnan(frame_distances(samples, "3d", EvaluationOptions()).by_joint[:, neck]).all()
    assert np.isfinite(frame_distances(samples, "2d", EvaluationOptions()).by_joint[:, neck]).any()
