"""Truth and inference in the cloud: where the views of a page draw a joint, against the sphere people's closed form."""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from cabinpose.app.report.cloud_views import cloud_views
from cabinpose.app.report.frames import drawing
from cabinpose.app.report.raster import write_grid
from cabinpose.core import skeleton_with

_SIDE, _GAP = 200, 4


@pytest.mark.parametrize("placed", [False, True])
def test_a_joint_is_drawn_where_its_part_of_the_cloud_is(dataset: xr.Dataset, placed: bool) -> None:
    """One joint before the torso of the driver, as the camera sees it: by hand, in each of four views."""
    frame = dataset.isel(frame=0).load()
    joint = np.array([[[-0.5, 0.1, 0.95]]])  # x right, y down, z forward
    if placed:  # a camera at the windscreen that looks back
        frame = frame.copy()
        frame["vehicle_from_camera"] = frame["vehicle_from_camera"].copy()
        frame["vehicle_from_camera"].values[:] = [[0, 0, -1, 2], [1, 0, 0, 0], [0, -1, 0, 1], [0, 0, 0, 1]]
    drawn = str(cloud_views(frame, (), [(joint, "#ffffff")]))
    dots = [tuple(map(float, m)) for m in re.findall(r'<circle cx="([^"]+)" cy="([^"]+)"', drawn)]
    middles = [(x + _SIDE / 2, y + _SIDE / 2) for y in (0, _SIDE + _GAP) for x in (0, _SIDE + _GAP)]
    np.testing.assert_allclose(dots, middles, atol=0.1)  # the views are about the joints
    assert re.findall(r'class="view">([^<]+)', drawn) == ["from the front", "from the right", "from the left", "from above"]
    images = [np.array(Image.open(io.BytesIO(base64.b64decode(m)))) for m in re.findall(r"base64,([^\"]+)", drawn)]
    assert len(images) == 4
    lit = [(image.max(axis=-1) > 60) for image in images]
    # The torso, a sphere of 25 cm about z = 1.2 m, stands right behind the joint: from above, nothing is nearer to the camera.
    above = lit[3]
    towards, away = above[:95], above[105:]
    assert away.mean() > 3 * towards.mean()


def test_two_joints_are_as_far_apart_as_they_are(dataset: xr.Dataset) -> None:
    """0.3 m to the right, 0.2 m down and 0.4 m away: by the scale of the views, 0.9 m in 200 px."""
    frame = dataset.isel(frame=0).load()
    true, found = np.array([[[0.0, 0, 1]]]), np.array([[[0.3, 0.2, 1.4]]])
    drawn = str(cloud_views(frame, (), [(true, "#ffffff"), (found, "#ff9f1c")]))
    dots = np.array([tuple(map(float, m)) for m in re.findall(r'<circle cx="([^"]+)" cy="([^"]+)"', drawn)]).reshape(4, 2, 2)
    x, y, z = np.array([0.3, 0.2, 0.4]) * _SIDE / 0.9  # right, down, away; the person faces a level camera
    np.testing.assert_allclose(dots[:, 1] - dots[:, 0], [(x, y), (-z, y), (z, y), (-x, z)], atol=0.11)


def test_truth_is_seen_beside_the_image_as_well(dataset: xr.Dataset, tmp_path: Path) -> None:
    """Which is white, on a contact sheet that is: joints seen from the side stand before what has no depth."""
    frame = dataset.isel(frame=0).load()
    skeleton = skeleton_with([str(name) for name in frame["joint"].values])
    points = frame["joints_3d"].values + np.float32(0.05)
    nothing = np.full((*points.shape[:2], 2), np.nan, np.float32)
    drawn = drawing(frame, skeleton, nothing, [str(name) for name in frame["person"].values], True, points)
    write_grid(tmp_path / "sheet.png", [drawn], 1)
    beside = np.array(Image.open(tmp_path / "sheet.png"))[:, frame.sizes["x"] + 1 :]
    share = [(beside == colour).all(axis=-1).mean() for colour in ((38, 40, 46), (255, 255, 255))]
    assert share[0] > 0.8
    assert 0.001 < share[1] < 0.1
