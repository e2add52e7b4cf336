"""The correction of ITOP's labels: a drawn person with labels beside it, against a flood fill and distances by hand."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from cabinpose.core.camera import Camera
from cabinpose.core.errors import DatasetError
from cabinpose.core.skeleton import ITOP
from cabinpose.store import open_dataset, read_manifest
from cabinpose.store.convert import open_source
from cabinpose.store.convert.itop_correct import REACH_M, corrected, grown, person_mask
from cabinpose.store.itop import NOMINAL_SCALE_M, K
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


def of_npz(path: Path, count: int = 3) -> Path:
    """Frames of `drawn` as .npz: columns 40 to 279 at 2.4 px each, scaled to 0 .. 1; in the last one nothing is to be moved."""
    depth, joints = drawn()
    rows, columns = (np.arange(100) + 0.5) * 2.4 - 0.5, 40 + (np.arange(100) + 0.5) * 2.4 - 0.5
    small = depth[np.round(rows).astype(int)[:, None], np.round(columns).astype(int)] / NOMINAL_SCALE_M
    still = joints.copy()
    still[[RHAND, LHAND]] = joints[TORSO]
    np.savez(path, depth01=np.stack([small] * count), joints_3d=np.stack([joints] * (count - 1) + [still]) * (1, -1, 1),
             frame=np.arange(count))  # fmt: skip
    return path


def test_frames_of_an_npz_are_corrected_and_pictured_before_and_after(tmp_path: Path) -> None:
    path, pictures = of_npz(tmp_path / "itop_side.npz"), tmp_path / "pictures"
    source = open_source(path, "itop", correct="head", pictures=pictures)
    out = import_source(source, tmp_path / "out")
    assert source.outcome().startswith("4 of 45 joints were moved")
    assert "hidden" in source.note
    after, depth = open_dataset(out), drawn()[0]
    assert after.attrs["width"] == after.attrs["height"] == 100
    assert set(after.pov.values.tolist()) == {"side"}
    np.testing.assert_allclose(after.depth[0, 50, 50], depth[120, 160], atol=0.02)  # the scale is found again
    plain = open_dataset(import_source(open_source(path, "itop"), tmp_path / "plain"))
    moved = np.linalg.norm((after.itop_joints_3d - plain.itop_joints_3d).values, axis=-1)[:, 0] > 0.01
    np.testing.assert_array_equal(np.flatnonzero(moved[0]), [RHAND, LHAND])
    assert sorted(file.name for file in pictures.iterdir()) == ["00000000.png", "00000001.png"]  # nothing moves in the third
    image = np.asarray(Image.open(pictures / "00000000.png")).astype(int)
    scale = image.shape[0] // 100
    assert image.shape == (100 * scale, 2 * 100 * scale, 3)
    left, right = np.split(image, 2, axis=1)

    def dot(picture: NDArray[Any], xyz: NDArray[Any]) -> list[int]:
        k = after.camera_k.values[0]
        u, v = (xyz[:2] / xyz[2] * k[[0, 1], [0, 1]] + k[:2, 2] + 0.5) * scale
        return picture[round(float(v)), round(float(u))].tolist()

    for joint in (RHAND, LHAND):
        assert dot(left, plain.itop_joints_3d.values[0, 0, joint]) == [255, 255, 255]
        assert dot(right, after.itop_joints_3d.values[0, 0, joint]) == [255, 140, 0]
    assert dot(right, after.itop_joints_3d.values[0, 0, HEAD]) == [255, 255, 255]
    trunk = round(45 * scale), round(57 * scale)
    assert right[trunk][2] > right[trunk][0] + 30  # the person is blue, after alone
    assert left[trunk][2] == left[trunk][0]


def test_pictures_without_a_correction_and_into_a_folder_in_use_are_refused(tmp_path: Path) -> None:
    path = of_npz(tmp_path / "a.npz")
    with pytest.raises(DatasetError, match="--pictures shows what --correct does") as caught:
        open_source(path, "itop", pictures=tmp_path / "pictures")
    assert "--correct head" in caught.value.hint
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    with pytest.raises(DatasetError, match="is not empty"):
        open_source(path, "itop", correct="head", pictures=tmp_path / "mine")
    np.savez(tmp_path / "b.npz", depth01=np.zeros((2, 100, 100)), joints_3d=np.zeros((1, 15, 3)), frame=np.arange(1))
    with pytest.raises(DatasetError, match="2 frames and joints of 1"):
        open_source(tmp_path / "b.npz", "itop")
