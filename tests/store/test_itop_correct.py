"""The correction of ITOP's labels: a drawn person with labels beside it, against a flood fill and distances by hand."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from cabinpose.core.camera import Camera
from cabinpose.core.skeleton import ITOP
from cabinpose.store import open_dataset, read_manifest
from cabinpose.store.convert import open_source
from cabinpose.store.convert.itop_correct import REACH_M, corrected, grown, person_mask
from cabinpose.store.itop import K
from cabinpose.store.source import import_source

CAMERA = Camera(320, 240, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
HEAD, TORSO, RHAND, LHAND, RFOOT = (ITOP.joints.index(n) for n in ("head", "torso", "rhand", "lhand", "rfoot"))
# Columns and rows of the joints of `drawn`, on the person but for the two hands: one 12 px beside it, one 5 px above the fist.
UV = np.array(
    [[160, 40], [160, 65], [145, 70], [175, 70], [140, 95], [180, 95], [118, 120], [205, 85], [160, 100], [150, 130], [170, 130],
     [150, 170], [170, 170], [150, 225], [170, 214]], float,
)  # fmt: skip


def drawn() -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """A frame (240, 320) and its labels: a person 3 m away before a wall at 4.5 m, on a floor that meets a post and both."""
    depth = np.full((240, 320), 4.5, np.float32)
    depth[218:] = np.linspace(4.4, 3.0, 22)[:, None]
    for rows, columns, z in (
        ((30, 60), (150, 170), 3.0), ((60, 140), (130, 190), 3.0), ((140, 240), (140, 180), 3.0), ((90, 100), (190, 215), 2.5),
    ):  # fmt: skip
        depth[slice(*rows), slice(*columns)] = z
    depth[100:240, 250:256] = 3.2
    z = np.full(15, 3.0)
    z[LHAND] = 2.5
    rays = np.concatenate((CAMERA.undistort((UV - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy)), np.ones((15, 1))), axis=1)
    return depth, rays * z[:, None]


def flooded(depth: NDArray[Any], start: tuple[int, int]) -> NDArray[np.bool_]:
    """Region growing pixel by pixel."""
    mask, queue = np.zeros(depth.shape, bool), deque([start])
    mask[start] = True
    while queue:
        r, c = queue.popleft()
        for at in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
            inside = 0 <= at[0] < depth.shape[0] and 0 <= at[1] < depth.shape[1]
            if inside and not mask[at] and depth[at] > 0 and abs(float(depth[at]) - float(depth[start])) < REACH_M:
                mask[at] = True
                queue.append(at)
    return mask


@pytest.mark.parametrize("seed", ["head", "torso"])
def test_joints_beside_the_person_go_to_its_nearest_pixel(seed: Any) -> None:
    depth, joints = drawn()
    result = corrected(depth, joints, CAMERA, seed)
    after = CAMERA.project(result.joints_3d)
    expected = UV.copy()
    expected[RHAND] = (130, 120)  # 12 px to the left edge of the trunk
    expected[LHAND] = (205, 90)  # 5 px down to the arm
    np.testing.assert_allclose(after, expected, atol=1e-9)
    np.testing.assert_array_equal(result.joints_3d[:, 2], joints[:, 2])
    np.testing.assert_array_equal(np.flatnonzero(result.moved_m), [RHAND, LHAND])
    np.testing.assert_allclose(result.moved_m[[RHAND, LHAND]], (12 * 3 * 0.0035, 5 * 2.5 * 0.0035))
    assert result.mask is not None
    assert not result.mask[220:].any()  # the floor, and the foot whose label is there stays
    assert not result.mask[:, 240:].any()  # the post, which only the floor ties to the person


def test_the_region_is_a_flood_fill() -> None:
    rng = np.random.default_rng(3)
    depth = np.where(rng.random((40, 50)) < 0.1, 0, rng.choice([2.0, 2.7, 2.9, 4.0], (40, 50))).astype(np.float32)
    depth[20, 25] = 2.5
    np.testing.assert_array_equal(grown(depth, (20, 25)), flooded(depth, (20, 25)))
    assert 50 < flooded(depth, (20, 25)).sum() < 1500


def test_the_seed_decides_where_the_head_is_apart() -> None:
    """A head that is a metre in front: from the torso the head is not reached, so that nothing is known."""
    depth, joints = drawn()
    depth[30:60, 150:170] = 1.9
    joints[HEAD] *= 1.9 / 3
    assert person_mask(depth, UV[TORSO], UV[HEAD]) is None
    untouched = corrected(depth, joints, CAMERA, "torso")
    assert untouched.mask is None
    np.testing.assert_array_equal(untouched.joints_3d, joints)
    from_head = corrected(depth, joints, CAMERA, "head")
    assert from_head.mask is not None
    assert from_head.mask.sum() == 30 * 20


def test_a_hole_at_the_seed_is_stepped_over_and_an_empty_image_is_left() -> None:
    depth, joints = drawn()
    depth[38:43, 158:163] = 0
    assert corrected(depth, joints, CAMERA, "head").moved_m[LHAND] > 0
    assert corrected(np.full_like(depth, np.nan), joints, CAMERA, "head").mask is None


def test_an_import_records_and_tells_it(tmp_path: Path) -> None:
    depth, joints = drawn()
    up = joints * (1, -1, 1)
    folder = tmp_path / "itop"
    folder.mkdir()
    ids = np.array([b"00_00000", b"00_00001", b"01_00002"])
    images = np.stack((depth, depth, np.zeros_like(depth)))
    with h5py.File(folder / "a_depth_map.h5", "w") as file:
        file["id"], file["data"] = ids, images.astype(np.float16)
    with h5py.File(folder / "a_labels.h5", "w") as file:
        file["id"], file["is_valid"], file["visible_joints"] = ids, np.ones(3), np.ones((3, 15))
        file["real_world_coordinates"] = np.stack((up, up, up)).astype(np.float16)
    source = open_source(folder, "itop", correct="head")
    out = import_source(source, tmp_path / "out")
    assert source.outcome() == (
        "4 of 45 joints were moved, by 8.5 cm in the median and 12.6 cm at most; "
        "frames that show nobody where their labels are, and keep them: 1"
    )
    assert read_manifest(out).config["correct"] == "head"
    after, plain = open_dataset(out), open_source(folder, "itop")
    moved = np.flatnonzero(np.linalg.norm(after.itop_joints_3d.values[0, 0] - joints, axis=1) > 0.01)
    np.testing.assert_array_equal(moved, [RHAND, LHAND])
    np.testing.assert_allclose(after.joints_2d.sel(joint="rhand")[0, 0], (130, 120), atol=0.3)
    assert plain.outcome() == ""
    assert "correct" not in plain.manifest.config
