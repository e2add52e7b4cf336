"""Joints that are not those of their images are told; the generated ones beside them are not."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from cabinpose.app.cli import main
from cabinpose.core import CABINPOSE, ITOP, NTU_JOINTS, Camera, Visibility
from cabinpose.store import label_warnings, open_dataset

Change = Callable[[xr.Dataset], None]
FEW = slice(3, 4)  # of eight frames
COCO = tuple(f"{side}_{name}" for name in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for side in ("left", "right"))
ARMS = ("shoulder", "elbow", "wrist", "hand")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight frames of a driver and a passenger; read only."""
    folder = tmp_path_factory.mktemp("labels") / "data"
    scene = ["scene.cars=[suv]", "scene.occupancy={driver: 1, front_passenger: 1}", "output.skeletons=[itop]"]
    subjects = ["people.subjects=[S01, S07]", "camera.sensor=evk75023", "camera.views={front_row: 1.0}"]
    assert main(["synth", "--frames", "8", "--seed", "3", "--out", str(folder), *scene, *subjects, "people.outfits=1"]) == 0
    return folder


@pytest.fixture(scope="module")
def dataset(folder: Path) -> xr.Dataset:
    return open_dataset(folder).load()


def scale(name: str, factor: float | tuple[float, ...], person: int | slice = slice(None)) -> Change:
    return lambda data: data[name].values[:, person].__imul__(np.asarray(factor, np.float32))


def exchange(frames: slice, joints: Sequence[str] | None = None) -> Change:
    """Left and right, of some joints without their side."""

    def change(data: xr.Dataset) -> None:
        for skeleton, names in ((CABINPOSE, ("joints_2d", "joints_3d", "visibility")), (ITOP, ("itop_joints_3d",))):
            other = [
                m if joints is None or name[1:] in joints else i
                for i, (name, m) in enumerate(zip(skeleton.joints, skeleton.mirror, strict=True))
            ]
            for name in names:
                data[name].values[frames] = data[name].values[frames][:, :, other]

    return change


def roll(*names: str) -> Change:
    """Those of the frame before."""

    def change(data: xr.Dataset) -> None:
        for name in names:
            data[name].values[...] = np.roll(data[name].values, 1, axis=0)

    return change


def without(*names: str) -> Change:
    """As a source that has no metres, or no clean depth: NaN throughout."""

    def change(data: xr.Dataset) -> None:
        for name in names:
            data[name].values[...] = np.nan

    return change


def both(first: Change, second: Change) -> Change:
    def change(data: xr.Dataset) -> None:
        first(data)
        second(data)

    return change


FLAT = without("joints_3d", "itop_joints_3d")


def normalise(data: xr.Dataset) -> None:
    uv = data["joints_2d"].values
    uv /= (data.sizes["x"], data.sizes["y"])
    uv[np.abs(uv).max(axis=-1) > 1] = np.nan


def exchange_uv(data: xr.Dataset) -> None:
    data["joints_2d"].values[...] = data["joints_2d"].values[..., ::-1]


def breathe(data: xr.Dataset) -> None:
    """Each frame in a scale of its own."""
    data["joints_3d"].values[...] *= np.linspace(0.6, 1.4, data.sizes["frame"], dtype=np.float32)[:, None, None, None]


def scatter(data: xr.Dataset) -> None:
    """Joints 6 cm off each way, of people who are not known."""
    data["subject"].values[...] = np.where(data["subject"].values == "", "", "unknown")
    data["joints_3d"].values[...] += np.random.default_rng(5).normal(0, 0.06, data["joints_3d"].shape).astype(np.float32)


def range_over_depth(data: xr.Dataset) -> np.ndarray:
    (fx, _, cx), (_, fy, cy), _ = data["camera_k"].values[0].tolist()
    return Camera(data.sizes["x"], data.sizes["y"], fx, fy, cx, cy, tuple(data["camera_dist"].values[0])).range_over_depth


def empty(name: str) -> Change:
    """Depth of frames in which nobody is there: each pixel's farthest."""

    def change(data: xr.Dataset) -> None:
        data[name].values[...] = data[name].max("frame").values

    return change


def depth_along_the_ray(data: xr.Dataset) -> None:
    data["depth_clean"].values[...] *= range_over_depth(data)


def z_along_the_ray(data: xr.Dataset) -> None:
    data["joints_3d"].values[..., 2] = np.linalg.norm(data["joints_3d"].values, axis=-1)


def fold(data: xr.Dataset) -> None:
    """A lens that sees nothing in the corners, where there is depth."""
    data["camera_dist"].values[...] = (-0.2, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (normalise, "normalised to the image's size?"),
        (scale("joints_2d", 2.0), "lie outside of the image"),
        (scale("joints_2d", 0.5), "from where joints_3d and camera_k have it"),
        (roll("joints_2d", "visibility"), "from where joints_3d and camera_k have it"),
        (both(FLAT, roll("joints_2d", "visibility")), "of the visible joints lie on pixels of their person"),
        (both(FLAT, exchange_uv), "of the visible joints lie on pixels of their person"),
        (both(FLAT, exchange(FEW, ARMS)), "in 12 % of the people (2 of 16) the shoulders are crossed against the hips"),
        (both(FLAT, exchange(FEW)), "12 % of the people (2 of 16) face another way than the others in their seat"),
        (scale("joints_3d", 1000.0), "4 of 4 people are"),
        (scale("joints_3d", 1000.0), "m tall by their bones in joints_3d: joints_3d fits in mm"),
        (scale("joints_3d", 100.0), "joints_3d fits in cm"),
        (scale("joints_3d", 1 / 0.0254), "joints_3d fits in inch"),
        (scale("joints_3d", 1.8, person=0), "2 of 4 people are"),
        (scale("joints_3d", 0.2), "another unit or scale?; newborn"),
        (scale("joints_3d", (1.0, 1.0, -1.0)), "lie behind the camera"),
        (scale("itop_joints_3d", (1.0, 1.0, -1.0)), "of itop_joints_3d lie behind the camera"),
        (scale("itop_joints_3d", 1000.0), "itop_joints_3d fits in mm"),
        (breathe, "of the limbs in joints_3d are a quarter longer or shorter than the same person's in other frames"),
        (scatter, "of the limbs in joints_3d are a quarter longer or shorter than that of the other side"),
        (exchange(slice(None)), "in 100 % of the people (16 of 16) left and right of joints_3d contradict"),
        (exchange(FEW), "in 12 % of the people (2 of 16) left and right of joints_3d contradict"),
        (exchange(FEW), "in 12 % of the people (2 of 16) left and right of itop_joints_3d contradict"),
        (empty("depth_clean"), "m before the surface in depth_clean: depth_clean of other frames?"),
        (scale("depth_clean", 0.1), "behind the surface in depth_clean: it is 0.0"),
        (depth_along_the_ray, "if depth_clean is the distance from the lens"),
        (z_along_the_ray, "if z of joints_3d is the distance from the lens"),
        (fold, "of the depths lie where the lens sees nothing: distortion -0.2 0 0 0 0 folds"),
    ],
    ids=(
        "normalised", "twice", "half", "shifted", "shifted-2d", "uv", "crossed", "seats", "all-people", "mm", "cm",
        "inch", "one-person", "short", "negated", "negated-itop", "mm-itop", "breathing", "scattered", "sides",
        "sides-few", "sides-itop", "depth-empty", "depth-unit", "depth-along", "z-along",
        "fold",
    ),
)  # fmt: skip
def test_a_wrong_label_is_told(dataset: xr.Dataset, change: Change, said: str) -> None:
    wrong = dataset.copy(deep=True)
    change(wrong)
    assert label_warnings(dataset) == ()
    assert any(said in warning for warning in label_warnings(wrong)), label_warnings(wrong)


def stand_up(data: xr.Dataset, *, bent: bool) -> None:
    """Thighs straight below the hips; knees that are bent, or else feet that point to the front."""
    at, xyz = CABINPOSE.index, data["joints_3d"].values
    up = (
        xyz[..., at["lshoulder"], :] + xyz[..., at["rshoulder"], :] - xyz[..., at["lpelvis"], :] - xyz[..., at["rpelvis"], :]
    ) / 2
    front = np.cross(xyz[..., at["lshoulder"], :] - xyz[..., at["rshoulder"], :], up)
    front *= 0.2 / np.linalg.norm(front, axis=-1, keepdims=True)
    for side in "lr":
        hip = xyz[..., at[f"{side}pelvis"], :]
        xyz[..., at[f"{side}knee"], :] = hip - up + front * bent
        xyz[..., at[f"{side}ankle"], :] = hip - 2 * up
        xyz[..., at[f"{side}foot"], :] = np.nan if bent else hip - 2 * up + front


@pytest.mark.parametrize("bent", [False, True], ids=("feet", "knees"))
def test_feet_and_bent_knees_tell_the_front_of_people_who_stand(dataset: xr.Dataset, bent: bool) -> None:
    right = dataset.copy(deep=True)
    stand_up(right, bent=bent)
    wrong = right.copy(deep=True)
    exchange(FEW)(wrong)
    said = "in 12 % of the people (2 of 16) left and right of joints_3d contradict"
    assert not any("joints_3d contradict" in warning for warning in label_warnings(right.drop_vars("itop_joints_3d")))
    assert any(said in warning for warning in label_warnings(wrong))


def test_depth_as_delivered_is_asked_where_there_is_no_other(dataset: xr.Dataset) -> None:
    recorded = dataset.drop_vars("depth_clean")
    wrong = recorded.copy(deep=True)
    empty("depth")(wrong)
    assert label_warnings(recorded) == ()
    assert any("before the surface in depth: " in warning for warning in label_warnings(wrong))


def of_set(dataset: xr.Dataset, theirs: Sequence[str], table: str) -> xr.Dataset:
    """A dataset whose own joints have the names and the order of another set; those that are none of ours are absent."""
    here, there = CABINPOSE.counterparts(table, theirs)
    place = np.full(len(theirs), -1)
    place[there] = here
    own = dataset.drop_vars("itop_joints_3d").isel(joint=place).assign_coords(joint=list(theirs)).copy(deep=True)
    own["joints_3d"].values[:, :, place < 0] = np.nan
    own["joints_2d"].values[:, :, place < 0] = np.nan
    own["visibility"].values[:, :, place < 0] = Visibility.ABSENT
    return own


@pytest.mark.parametrize(
    ("theirs", "table"),
    [(ITOP.joints, "itop"), (("nose", *COCO), "coco"), (NTU_JOINTS, "kinect_v2")],
    ids=("itop", "coco", "ntu"),
)
def test_joints_of_other_sets_are_looked_at(dataset: xr.Dataset, theirs: Sequence[str], table: str) -> None:
    mm, turned = dataset.copy(deep=True), dataset.copy(deep=True)
    scale("joints_3d", 1000.0)(mm)
    exchange(FEW)(turned)
    assert label_warnings(of_set(dataset, theirs, table)) == ()
    assert any("fits in mm" in warning for warning in label_warnings(of_set(mm, theirs, table)))
    assert any("2 of 16) left and right of joints_3d" in warning for warning in label_warnings(of_set(turned, theirs, table)))


def test_joints_that_are_of_no_set_are_looked_at_as_pixels(dataset: xr.Dataset) -> None:
    unknown = dataset.drop_vars("itop_joints_3d").assign_coords(joint=[f"p{i}" for i in range(20)])
    wrong = unknown.copy(deep=True)
    scale("joints_2d", 2.0)(wrong)
    assert label_warnings(unknown) == ()
    assert any("outside of the image" in warning for warning in label_warnings(wrong))


def coco_file(path: Path, scale: tuple[float, float] = (1.0, 1.0), order: str = "xywh") -> Path:
    """Keypoints of six standing people in images of 160x120 pixels, divided by a scale, and boxes in an order."""
    standing = np.array([(60 + 40 * i, 20 + 15 * j) for j in range(6) for i in (1, 0)], float)  # left is on the image's right
    people = []
    for n in range(6):
        points = standing + (3 * n - 9, n)
        (x, y), (right, bottom) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        known = {
            "x": x,
            "y": y,
            "w": right - x,
            "h": bottom - y,
            "r": right,
            "b": bottom,
            "m": (x + right) / 2,
            "n": (y + bottom) / 2,
        }
        flat = [float(number) for u, v in points / scale for number in (u, v, 2)]
        box = [known[letter] for letter in order]
        people.append({"id": n, "image_id": n, "category_id": 1, "bbox": box, "keypoints": flat})
    images = [{"id": n, "file_name": f"{n}.png", "width": 160, "height": 120} for n in range(6)]
    names = [{"id": 1, "name": "person", "keypoints": list(COCO)}]
    path.write_text(json.dumps({"images": images, "annotations": people, "categories": names}))
    return path


@pytest.mark.parametrize("wrong", [False, True], ids=("pixels", "normalised"))
def test_import_and_info_say_it(run: Callable[..., Any], tmp_path: Path, wrong: bool) -> None:
    """COCO keypoints, as text and in --json; true pixels beside. Boxes are right in pixels."""
    file, out = coco_file(tmp_path / "coco.json", (160, 120) if wrong else (1, 1)), tmp_path / "out"
    said = "normalised to the image's size?"
    imported = run("import", "coco", file, "--out", out)
    as_json = run("import", "coco", file, "--out", tmp_path / "again", "--json")
    text, data = run("info", out), run("info", out, "--json")
    assert [each.code for each in (imported, as_json, text, data)] == [0] * 4
    for each in (imported, text):
        assert each.err.count(said) == wrong
        assert each.err.count("warning: ") == wrong
    for each in (as_json, data):
        told = json.loads(each.out).get("warnings", [])
        assert [said in line for line in told] == [True] * wrong


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ("xywh", ""),
        ("xyrb", "as left, top, right, bottom"),
        ("yxhw", "as y, x, height, width"),
        ("yxbr", "as top, left, bottom, right"),
        ("mnwh", "as middle x, middle y, width, height"),
    ],
)
def test_boxes_in_another_order_are_told(run: Callable[..., Any], tmp_path: Path, order: str, said: str) -> None:
    done = run("import", "coco", coco_file(tmp_path / "coco.json", order=order), "--out", tmp_path / "out")
    assert done.code == 0
    assert done.err.count("boxes as x, y, width, height overlap with their people by") == bool(said)
    assert said in done.err
