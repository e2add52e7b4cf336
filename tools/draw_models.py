"""What packaged models find, beside the truth.

    python tools/draw_models.py models IN_CAR_TEST FIVE_SEATS_TEST ITOP.npz --picture docs/images/models.png
    python tools/draw_models.py top ITOP_TOP.npz --picture docs/images/room-top.webp
    python tools/draw_models.py parts EVERYONE_TEST --picture docs/images/parts.webp

The frames are evenly spread over each test, whatever the errors; of parts the last one is the worst by mean IoU. Truth white,
found orange, both where they are in the image.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from cabinpose.app.view.draw import depth_image, depth_range
from cabinpose.core import Visibility, class_table, skeleton_of
from cabinpose.estimate import PartSegmenter, load_model, open_model
from cabinpose.evaluate import evaluate_parts, frame_batch
from cabinpose.store import as_labelled, open_dataset, read_itop_frames, read_itop_reference

WIDTH = 1320
TRUTH, FOUND, NOBODY = (255, 255, 255), (255, 143, 28), (38, 40, 44)


def drawn(depth: NDArray[np.float32], skeletons: list[tuple[Any, Any, Any]], width: int) -> Image.Image:
    """A depth image (H, W) in m, `width` px wide. skeletons: points (P, J, 2) px, NaN = none, limbs and colour of each."""
    depth = np.where(depth > 0, depth, np.nan).astype(np.float32)
    zoom = width / depth.shape[1]
    image = Image.fromarray(depth_image(depth, *depth_range(depth))).resize(
        (width, round(zoom * depth.shape[0])), Image.Resampling.NEAREST
    )
    draw = ImageDraw.Draw(image)
    for people, limbs, colour in skeletons:
        for uv in zoom * (people + 0.5):
            for a, b in limbs:
                if np.isfinite(uv[[a, b]]).all():
                    draw.line((*uv[a], *uv[b]), fill=colour, width=2)
            for u, v in uv[np.isfinite(uv).all(axis=-1)]:
                draw.ellipse((u - 2.5, v - 2.5, u + 2.5, v + 2.5), fill=colour)
    return image


def in_cars(folder: Path, name: str, count: int) -> list[Image.Image]:
    """Frames of a dataset with what a model finds of the places that it knows."""
    model, dataset = load_model(name), open_dataset(folder)
    chosen = dataset.isel(frame=np.linspace(0, dataset.sizes["frame"] - 1, count).astype(int)).sel(person=list(model.persons))
    found, limbs = model.predict(frame_batch(chosen, slice(None))), skeleton_of(model).limbs
    true = np.where(chosen["visibility"].values[..., None] > Visibility.OUTSIDE_IMAGE, chosen["joints_2d"].values, np.nan)
    sure = np.where(found.presence[..., None] >= 0.5, found.joints_2d, np.nan)
    depths = chosen["depth"].values
    return [drawn(d, [(t, limbs, TRUTH), (s, limbs, FOUND)], WIDTH // count) for d, t, s in zip(depths, true, sure, strict=True)]


def in_a_room(file: Path, name: str, count: int, *, view: Literal["side", "top"] | None = None) -> list[Image.Image]:
    """Real frames of ITOP with its labels and what a model finds, not moved, or to where the labels of a view are."""
    frames, reference, model = read_itop_frames(file), read_itop_reference(file), load_model(name)
    which = np.linspace(0, len(reference.joints_3d) - 1, count).astype(int)
    found = model.predict(frames).joints_3d if view is None else as_labelled(model.predict(frames).joints_3d, view)
    limbs = skeleton_of(model).limbs

    def shown(joints_3d: NDArray[Any]) -> NDArray[Any]:
        return np.asarray((joints_3d / joints_3d[..., 2:] @ np.swapaxes(frames["camera_k"], -1, -2))[..., :2])

    true, seen = shown(reference.joints_3d[:, None]), shown(found)
    return [drawn(frames["depth"][n], [(true[n], limbs, TRUTH), (seen[n], limbs, FOUND)], WIDTH // count) for n in which]


def of_parts(folder: Path, count: int) -> list[list[Image.Image]]:
    """Three rows: the depth of frames, their parts, and what `parts` answers."""
    model, dataset = open_model("parts"), open_dataset(folder)
    assert isinstance(model, PartSegmenter)
    report = evaluate_parts(dataset, model, resamples=0)
    which = [*np.linspace(0, dataset.sizes["frame"], count + 1).astype(int)[1:-1], report.worst[0]]
    chosen = dataset.isel(frame=which)
    depth, true = chosen["depth"].values, class_table(model.parts)[chosen["labels"].values]
    colours = (255 * colormaps["tab10"](np.arange(len(model.parts) + 1))[:, :3]).astype(np.uint8)
    colours[0] = NOBODY
    rows = [[depth_image(d, *depth_range(d)) for d in np.where(depth > 0, depth, np.nan).astype(np.float32)]]
    rows += [list(colours[classes]) for classes in (true, model.segment(frame_batch(chosen, slice(None))))]
    size = (WIDTH // count, round(WIDTH / count * depth.shape[1] / depth.shape[2]))
    return [[Image.fromarray(image).resize(size, Image.Resampling.NEAREST) for image in row] for row in rows]


def main() -> None:
    """Draw the rows of one picture."""
    parser = argparse.ArgumentParser(description="What packaged models find, beside the truth.")
    kinds = parser.add_subparsers(dest="kind", required=True)
    for kind, names in {"models": ("in_car", "five_seats", "itop"), "top": ("itop",), "parts": ("everyone",)}.items():
        one = kinds.add_parser(kind)
        for name in names:
            one.add_argument(name, type=Path)
        one.add_argument("--picture", type=Path, required=True)
    given = parser.parse_args()
    if given.kind == "models":
        rows = [in_cars(given.in_car, "in_car", 4), in_cars(given.five_seats, "five_seats", 4), in_a_room(given.itop, "room", 5)]
    elif given.kind == "top":
        rows = [in_a_room(given.itop, "room_top", 6), in_a_room(given.itop, "room_top", 6, view="top")]
    else:
        rows = of_parts(given.everyone, 4)
    sheet = Image.new("RGB", (WIDTH, sum(row[0].height for row in rows)))
    top = 0
    for row in rows:
        for i, image in enumerate(row):
            sheet.paste(image, (i * image.width, top))
        top += row[0].height
    sheet.save(given.picture, **({"optimize": True} if given.picture.suffix == ".png" else {"quality": 90}))


if __name__ == "__main__":
    main()
