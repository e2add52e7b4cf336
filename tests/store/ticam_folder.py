"""TICaM's layout, made by hand: two sequences of a driver with and without a passenger, 32x32 pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

SIZE = 32
PEOPLE = {"driver": (18, 6, 29, 31), "passenger": (3, 8, 13, 31)}  # left, top, right, bottom of their pixels


def save(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def frame(images: Path, labels: Path | None, name: str, number: int, people: dict[str, int]) -> list[str]:
    """The images and the mask of a frame; people: their class by their place. Gives the rows of their boxes."""
    depth, mask = np.full((SIZE, SIZE), 1800, np.uint16), np.zeros((SIZE, SIZE), np.uint8)
    depth[0], depth[1] = 0, 2550  # no answer; clipped
    rows = []
    for i, (who, number_of_class) in enumerate(people.items()):
        left, top, right, bottom = PEOPLE[who]
        depth[top : bottom + 1, left : right + 1], mask[top : bottom + 1, left : right + 1] = 900 + 10 * i, number_of_class
        rows.append(f"{number},{({1: 'person', 12: 'infant', 16: 'child'})[number_of_class]},{left},{top},{right},{bottom},0")
    stem = f"{name.replace('/', '-')}_{number:06d}_x"
    save(images / "Depth" / name / f"{stem}_DEPTH.png", depth)
    save(images / "IR" / name / f"{stem}_IR.png", (depth // 10 + 7).astype(np.uint16))
    if labels is not None:
        save(labels / name / "masks_depth" / f"{stem}_DEPTH_classes.png", mask)
    return rows


def ticam_folder(root: Path, split: str = "Train", *, labelled: bool = True) -> Path:
    """`one/p01` has frames 10, 11 and 12 of both, `two/p07` the frames 5 and 6 of a driver beside a child in its seat."""
    images, labels = root / f"{split}_images", root / f"{split}_labels" / f"{split}_Labels" if labelled else None
    boxes: dict[str, list[str]] = {"one/p01": [], "two/p07": []}
    for number in (10, 11, 12):
        boxes["one/p01"] += frame(images, labels, "one/p01", number, {"driver": 1, "passenger": 1})
    boxes["one/p01"].append("11,laptop bag,4,20,10,25,1")
    for number in (5, 6):
        boxes["two/p07"] += frame(images, labels, "two/p07", number, {"driver": 1, "passenger": 16})
        boxes["two/p07"].append(f"{number},ff,3,6,14,31,0")
    if labels is not None:
        for name, rows in boxes.items():
            (labels / name / "boxes_2d_depth.csv").write_text(
                "\n".join(["frame,class,xmin,ymin,xmax,ymax,low_remission", *rows]) + "\n"
            )
        (labels / "one/p01/activities.csv").write_text(
            "id,activity,person,status,start,end,duration\n0,looking left,3,driver,10,11,2\n1,reading,8,passenger,0,12,13\n"
            "2,turning wheel,3,driver,11,30,20\n"
        )
        (labels / "two/p07/activities.csv").write_text(
            "id activity person status start end duration\n4 talk to passenger 7 driver 6 9 4\n"
        )
    return root
