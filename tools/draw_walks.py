"""Random tree walks over depth: the first person of a dataset's frames, how far off joints are, and a picture of three frames.

    python tools/draw_walks.py MODEL.npz DATASET --picture docs/images/walks.webp

Dots are steps that count for a joint, lines the ways there, in a colour for each limb; crosses are the true joints.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from cabinpose.estimate.array_model import ArrayModel
from cabinpose.estimate.onnx_model import cameras_of, view_inputs
from cabinpose.estimate.walks.find import walks
from cabinpose.evaluate.offline import frame_batch
from cabinpose.store import joints_variable, open_dataset

ZOOM = 3
CROP = 200, 216  # width and height around the person, px
COLOURS = {"l": (230, 159, 0), "r": (86, 180, 233), "": (240, 228, 66)}  # left, right, trunk and head


def panel(depth: np.ndarray, places: np.ndarray, truth: np.ndarray, model: ArrayModel, title: str) -> Image.Image:
    """One person. depth: (h, w) m · places: (J, steps, 3) · truth: (J, 3) m."""
    near, far = np.percentile(depth[depth > 0], (1, 99))
    grey = np.where(depth > 0, 40 + 180 * np.clip((far - depth) / (far - near), 0, 1), 0).astype(np.uint8)
    image = Image.fromarray(grey).convert("RGB").resize((ZOOM * grey.shape[1], ZOOM * grey.shape[0]), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(image)
    project = model.config.view.camera.project
    for name, walk in zip(model.joints, places, strict=True):
        colour = COLOURS[name[0] if name[0] in "lr" else ""]
        uv = [tuple(point) for point in ZOOM * (project(walk.astype(np.float64)) + 0.5)]
        draw.line(uv, fill=tuple(c // 2 for c in colour))
        for u, v in uv[model.config.skipped :]:
            draw.ellipse((u - 1, v - 1, u + 1, v + 1), fill=colour)
    for u, v in ZOOM * (project(truth) + 0.5):
        for slope in (-1, 1):
            draw.line((u - 5, v - 5 * slope, u + 5, v + 5 * slope), fill=(255, 255, 255), width=2)
    centre = ZOOM * project(truth.mean(axis=0))
    left, top = (int(np.clip(c - ZOOM * s / 2, 0, full - ZOOM * s)) for c, s, full in zip(centre, CROP, image.size, strict=True))
    image = image.crop((left, top, left + ZOOM * CROP[0], top + ZOOM * CROP[1]))
    ImageDraw.Draw(image).text((8, 6), title, fill=(255, 255, 255), font_size=22)
    return image


def main() -> None:
    """Walk in all frames, and draw three of them."""
    parser = argparse.ArgumentParser(description="Random tree walks over depth.")
    parser.add_argument("model", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--picture", type=Path, required=True)
    arguments = parser.parse_args()
    model, dataset = ArrayModel(arguments.model), open_dataset(arguments.dataset)
    every = slice(0, dataset.sizes["frame"])
    frames = frame_batch(dataset, every)
    depth = view_inputs(frames, every, cameras_of(frames, every), model.config.view, amplitude=False)["depth"]
    places, joints = walks(model.arrays, model.config, depth)
    truth = dataset[joints_variable(model.skeleton)].values[:, 0].astype(np.float64)
    errors = np.linalg.norm(joints[:, 0] - truth, axis=-1)
    hit, mean, median = errors <= 0.1, 100 * errors.mean(), 100 * np.median(errors)
    print(
        f"{len(hit)} frames: {100 * hit.mean():.1f} % of joints within 10 cm, error {mean:.2f} cm on average, median {median:.2f}"
    )
    print("within 10 cm, %:", ", ".join(map("{} {:.0f}".format, model.joints, 100 * hit.mean(axis=0))))
    error = errors.mean(axis=-1)
    ranked = np.argsort(error)
    chosen = {"best": 0.0, "median": 0.5, "95th percentile": 0.95}
    panels = [
        panel(depth[n], places[n, 0], truth[n], model, f"{title}: mean error {100 * error[n]:.1f} cm")
        for title, n in ((title, ranked[int(share * len(ranked))]) for title, share in chosen.items())
    ]
    sheet = Image.new("RGB", (sum(p.width for p in panels), panels[0].height))
    for i, each in enumerate(panels):
        sheet.paste(each, (i * each.width, 0))
    sheet.save(arguments.picture, quality=80)


if __name__ == "__main__":
    main()
