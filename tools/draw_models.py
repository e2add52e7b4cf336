"""What packaged models find, beside the truth.

    python tools/draw_models.py IN_CAR_TEST FIVE_SEATS_TEST ITOP.npz --picture docs/images/models.png

The frames are evenly spread over each test, whatever the errors. Truth white, found orange, both where they are in the image.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from cabinpose.app.view.draw import depth_image, depth_range
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import skeleton_of
from cabinpose.estimate.predictor import load_model
from cabinpose.evaluate.offline import frame_batch
from cabinpose.store import open_dataset
from cabinpose.store.itop import read_itop_frames, read_itop_reference

WIDTH = 1320
TRUTH, FOUND = (255, 255, 255), (255, 143, 28)


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


def in_a_room(file: Path, name: str, count: int) -> list[Image.Image]:
    """Real frames of ITOP with its labels and what a model finds, not moved."""
    frames, reference, model = read_itop_frames(file), read_itop_reference(file), load_model(name)
    rays = reference.joints_3d / reference.joints_3d[..., 2:]
    true = (rays @ np.swapaxes(frames["camera_k"], -1, -2))[..., :2]
    found, limbs = model.predict(frames).joints_2d, skeleton_of(model).limbs
    which = np.linspace(0, len(true) - 1, count).astype(int)
    return [drawn(frames["depth"][n], [(true[n, None], limbs, TRUTH), (found[n], limbs, FOUND)], WIDTH // count) for n in which]


def main() -> None:
    """Draw a row for each of three models."""
    parser = argparse.ArgumentParser(description="What packaged models find, beside the truth.")
    for name in ("in_car_test", "five_seats_test", "itop"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--picture", type=Path, required=True)
    given = parser.parse_args()
    rows = [in_cars(given.in_car_test, "in_car", 4), in_cars(given.five_seats_test, "five_seats", 4)]
    rows.append(in_a_room(given.itop, "room", 5))
    sheet = Image.new("RGB", (WIDTH, sum(row[0].height for row in rows)))
    top = 0
    for row in rows:
        for i, image in enumerate(row):
            sheet.paste(image, (i * image.width, top))
        top += row[0].height
    sheet.save(given.picture, optimize=True)


if __name__ == "__main__":
    main()
