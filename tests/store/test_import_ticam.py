"""TICaM: folders made by hand in its layout, which is described in `store.convert.ticam`."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from PIL import Image
from ticam_folder import PEOPLE, frame, save, ticam_folder

from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.scene.labels import LABEL_ID, LABELS, RGB, ticam_class
from cabinpose.store import open_dataset, read_manifest
from cabinpose.store.convert import open_source, ticam
from cabinpose.store.convert.reading import SequenceOptions
from cabinpose.store.source import import_source


def imported(path: Path, out: Path, **options: Any) -> xr.Dataset:
    return open_dataset(import_source(open_source(path, "ticam", **options), out))


def where(image: np.ndarray, who: str) -> np.ndarray:
    left, top, right, bottom = PEOPLE[who]
    return image[top : bottom + 1, left : right + 1]


def test_by_hand(tmp_path: Path) -> None:
    ds = imported(ticam_folder(tmp_path / "ticam"), tmp_path / "out")
    assert ds.sizes["frame"] == 5
    assert ds.person.values.tolist() == ["driver", "front_passenger"]
    assert ds.sequence.values.tolist() == [0, 0, 0, 1, 1]
    assert ds.sync_ns.values.tolist() == [333333333, 366666667, 400000000, 166666667, 200000000]  # frame 10 at 30 a second
    depth = ds.depth[0].values
    assert np.isnan(depth[:2]).all()  # no answer, and clipped
    np.testing.assert_allclose(depth[2:6], 1.8, atol=1e-6)
    np.testing.assert_allclose(where(depth, "passenger"), 0.91, atol=1e-6)
    assert set(where(ds.amplitude[0].values, "driver").ravel()) == {97}
    # nobody's joints are known
    assert np.isnan(ds.joints_3d.values).all()
    assert not ds.visibility.values.any()
    # the edge of a 105 degree field is half a pixel outside the middle of the outermost pixel
    k = ds.camera_k[0].values
    assert np.degrees(np.arctan((k[0, 2] + 0.5) / k[0, 0])) == pytest.approx(52.5)
    assert k[0, 2] == k[1, 2] == 15.5
    assert np.isnan(ds.vehicle_from_camera.values).all()


def test_classes(tmp_path: Path) -> None:
    root = ticam_folder(tmp_path / "ticam")
    mask = next((root / "Train_labels").rglob("one-p01_000010_x_DEPTH_classes.png"))
    every = np.arange(32 * 32, dtype=np.uint8).reshape(32, 32) % 17
    save(mask, np.repeat(every[..., None], 3, axis=2))  # as tools save grey in colours
    labels = imported(root, tmp_path / "out").labels[0]
    names = dict(zip(labels.attrs["flag_values"], labels.attrs["flag_meanings"].split(), strict=True))
    expected = (
        "background", "person", "backpack", "jacket", "box", "bottle", "phone", "blanket", "accessory", "book", "laptop", "bag",
        "person", "bag", "child_seat", "infant_seat", "person",
    )  # fmt: skip
    assert [[names[i] for i in row] for row in labels.values] == [[expected[i] for i in row] for row in every.tolist()]


def test_classes_are_those_of_generated_datasets() -> None:
    """`store` cannot see `scene`: the table is held against it here, and the way there against the way back."""
    for row in ticam.LABELS:
        if row.name in ("person", "accessory"):
            assert row.id not in {label.id for label in LABELS}
        else:
            assert (row.id, row.rgb) == (LABEL_ID[row.name], RGB[row.id])
            assert row.ticam == ticam_class(next(label for label in LABELS if label.id == row.id))
            assert ticam.CLASSES[row.ticam][1] == row.name
    assert len({row.rgb for row in ticam.LABELS} | {label.rgb for label in LABELS}) == len(LABELS) + 2


def test_people(tmp_path: Path) -> None:
    ds = imported(ticam_folder(tmp_path / "ticam"), tmp_path / "out")
    assert ds.subject.values.tolist() == [["3", "8"]] * 3 + [["7", "unknown"]] * 2
    reading = ["looking left", "reading"], ["turning wheel", "reading"], ["turning wheel", "reading"]
    assert ds.action.values.tolist() == [*reading, ["unknown", "unknown"], ["talk to passenger", "unknown"]]
    for row in range(5):
        instance = ds.instance[row].values
        assert (where(instance, "driver") == 1).all()
        assert (where(instance, "passenger") == 2).all()
        assert ((instance > 0) == (ds.labels[row].values == 34)).all()
    assert ds.occupancy.values.tolist() == [["adult", "adult"]] * 3 + [["adult", "child_in_child_seat"]] * 2
    assert ds.things.values.tolist() == [["", ""], ["", "bag"], ["", ""]] + [["", "child_seat"]] * 2


def test_who_leans_over_stays_the_driver(tmp_path: Path) -> None:
    """Of two adults the right one is the driver; one alone, who the activities are of."""
    root = ticam_folder(tmp_path / "ticam")
    labels = root / "Train_labels/Train_Labels"
    both = "frame,class,l,t,r,b,low\n10,person,2,8,9,31,0\n10,person,7,8,15,31,0\n"
    (labels / "one/p01/boxes_2d_depth.csv").write_text(both)
    (labels / "two/p07/boxes_2d_depth.csv").write_text("frame,class,l,t,r,b,low\n5,person,2,8,9,31,0\n")
    ds = imported(root, tmp_path / "out")
    assert ds.instance[0].values[20, 4] == 2
    assert ds.instance[0].values[20, 12] == 1
    assert ds.instance[3].values[20, 4] == 1
    assert ds.subject.values[3].tolist() == ["7", ""]


def test_a_part_of_it(tmp_path: Path) -> None:
    root = ticam_folder(tmp_path / "ticam")
    ds = imported(root / "Train_images", tmp_path / "a", every=2)
    assert ds.sync_ns.values.tolist() == [333333333, 400000000, 166666667]
    for pattern in ("p07", "two/*", "*07"):
        assert open_source(root, "ticam", sequences=(pattern,)).manifest.frames == 2
    imported(root, tmp_path / "c", sequences=("p0*",), intrinsics=(20, 21, 15, 16))
    config = read_manifest(tmp_path / "c").config
    assert config.pop("content").startswith("sha256:")
    assert config == {
        "format": "ticam", "source": "ticam", "intrinsics_px": [20, 21, 15, 16], "sequences": ["one/p01", "two/p07"], "every": 1,
    }  # fmt: skip
    with pytest.raises(ConfigError, match="every 0th"):
        SequenceOptions(every=0)
    with pytest.raises(DatasetError, match="has no sequence p9") as error:
        open_source(root, "ticam", sequences=("p01", "p9*"))
    assert error.value.hint == "it has one/p01, two/p07"


def test_without_labels(tmp_path: Path) -> None:
    root = ticam_folder(tmp_path / "ticam", "Test", labelled=False)
    source = open_source(root, "ticam")
    assert source.manifest.variables == ("depth", "amplitude")
    assert source.note == "Test_images has no labels beside it: depth and infrared alone"
    ds = imported(root, tmp_path / "out")
    assert set(ds.subject.values.ravel()) == {""}
    shutil.rmtree(root / "Test_images/IR")
    assert open_source(root, "ticam").manifest.variables == ("depth",)


def damage(root: Path) -> dict[str, tuple[Callable[[], Any], str]]:
    images, labels = root / "Train_images", root / "Train_labels/Train_Labels"
    depth, masks = images / "Depth/one/p01", labels / "one/p01/masks_depth"

    def remove(folder: Path, pattern: str) -> None:
        next(folder.glob(pattern)).unlink()

    def write(name: str, text: str) -> None:
        (labels / "one/p01" / name).write_text(f"header\n{text}\n")

    def put(folder: Path, name: str, value: int, dtype: type, height: int = 32) -> None:
        save(next(folder.glob(f"*{name}*"), folder / name), np.full((height, 32), value, dtype))

    return {
        "no infrared": (lambda: remove(images / "IR/one/p01", "*011*"), "IR/one/p01 lacks frame 11, which Depth has"),
        "no depth": (lambda: remove(depth, "*011*"), "has frame 11, which Depth lacks"),
        "no mask": (lambda: remove(masks, "*012*"), "masks_depth lacks frame 12, which Depth has"),
        "no sequence": (lambda: shutil.rmtree(labels / "two"), "two/p07/masks_depth does not exist"),
        "empty": (lambda: [file.unlink() for file in depth.iterdir()], r"p01 holds no \*_DEPTH.png"),
        "no boxes": (lambda: remove(labels, "one/p01/boxes_2d_depth.csv"), "cannot read .*boxes_2d_depth.csv"),
        "size": (lambda: put(depth, "011", 900, np.uint16, 40), "011_x_DEPTH.png has 32x40 pixels, not 32x32"),
        "mask's size": (lambda: put(masks, "010", 1, np.uint8, 30), "DEPTH_classes.png has 32x30 pixels, not 32x32"),
        "classes": (lambda: put(masks, "010", 17, np.uint8), "has the class 17"),
        "8 bits": (lambda: put(depth, "010", 9, np.uint8), "no grey image of 16 bits"),
        "cut": (lambda: next(depth.glob("*010*")).write_bytes(b"\x89PNG"), "no whole image"),
        "number": (lambda: put(depth, "a_b_DEPTH.png", 900, np.uint16), "has no number of a frame"),
        "twice": (lambda: put(depth, "a_11_DEPTH.png", 900, np.uint16), "has the number of a frame that a_11_DEPTH.png has"),
        "box": (lambda: write("boxes_2d_depth.csv", "10,cat,1,2,3,4,0"), "boxes_2d_depth.csv:2: 10, cat, 1, 2, 3, 4, 0 is no"),
        "short box": (lambda: write("boxes_2d_depth.csv", "10,person,1,2"), "is no box"),
        "activity": (lambda: write("activities.csv", "1,sleep,3,pilot,1,2,2"), "activities.csv:2: .*pilot.* is no activity"),
        "several": (lambda: ticam_folder(root, "Test"), "Test_images and Train_images, of which one makes a dataset"),
        "none": (lambda: shutil.rmtree(images), "holds no images of TICaM"),
        "no frames": (lambda: [shutil.rmtree(images / "Depth" / name) for name in ("one", "two")], "holds no frame"),
    }


@pytest.mark.parametrize("name", damage(Path()))
def test_damaged(tmp_path: Path, name: str) -> None:
    root = ticam_folder(tmp_path / "ticam")
    harm, message = damage(root)[name]
    harm()
    with pytest.raises(DatasetError, match=message) as error:
        imported(root, tmp_path / "out")
    assert error.value.hint
    assert not (tmp_path / "out").exists()


def test_file_is_16_bits(tmp_path: Path) -> None:
    """What the tests read is what TICaM has: PNGs of 16 bits."""
    with Image.open(next(ticam_folder(tmp_path / "ticam").rglob("*_DEPTH.png"))) as image:
        assert image.mode == "I;16"


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ((0, 1, 2, 3), None),
        ((1, 0, 3, 2), "as top, left, bottom, right"),
        ((0, 1, 4, 5), "as x, y, width, height"),
    ],
    ids=("right", "y before x", "sizes"),
)
def test_boxes_in_another_order(tmp_path: Path, order: tuple[int, ...], said: str | None) -> None:
    """Six frames of a driver alone, whose pixels are known."""
    root = ticam_folder(tmp_path / "ticam")
    labels = root / "Train_labels" / "Train_Labels"
    rows = [row for number in range(30, 36) for row in frame(root / "Train_images", labels, "one/p01", number, {"driver": 1})]
    left, top, right, bottom = PEOPLE["driver"]
    edges = [(left, top, right, bottom, right - left, bottom - top)[i] for i in order]
    file = labels / "one/p01/boxes_2d_depth.csv"
    written = [",".join([*row.split(",")[:2], *map(str, edges), "0"]) for row in rows]
    file.write_text(file.read_text() + "\n".join(written) + "\n")
    if said is None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            imported(root, tmp_path / "out")
    else:
        with pytest.warns(UserWarning, match=f"boxes as left, top, right, bottom overlap .* {said}"):
            imported(root, tmp_path / "out")
