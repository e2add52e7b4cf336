"""Open a dataset, take one frame, and draw depth and labels with the skeleton over them.

Reads what 01_generate_dataset.py has written; writes frame.png.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import xarray as xr

from cabinpose.core import CABINPOSE, Visibility
from cabinpose.scene import RGB
from cabinpose.store import open_dataset, points_m

DATASET = Path("my-dataset")
SCALE = 2


def main() -> None:
    ds = open_dataset(DATASET)
    frame = ds.isel(frame=0)
    depth = frame.depth.values  # (287, 352) m, NaN where the sensor delivered nothing
    print(f"{frame.car.item()}, {frame.pov.item()}: {np.isfinite(depth).mean():.0%} of the pixels valid")

    points = points_m(ds).isel(frame=0).values  # (287, 352, 3) m, camera frame
    print(f"median distance of the driver: {np.nanmedian(points[frame.instance.values == 1, 2]):.2f} m")

    seen = frame.sel(person="driver").visibility
    for state in Visibility:
        names = seen.joint[seen == state].values
        print(f"{state.name.lower():>14}: {', '.join(names) or '-'}")

    grey = cv2.convertScaleAbs(np.nan_to_num(depth), alpha=255 / np.nanmax(depth))
    colours = np.zeros((256, 3), np.uint8)
    for label, rgb in RGB.items():
        colours[label] = (rgb & 255, rgb >> 8 & 255, rgb >> 16)  # OpenCV is blue, green, red
    pictures = (cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS), colours[frame.labels.values])
    cv2.imwrite("frame.png", np.hstack([with_skeletons(picture, frame) for picture in pictures]))


def with_skeletons(picture: np.ndarray, frame: xr.Dataset) -> np.ndarray:
    """A larger copy of a picture (height, width, 3) with the limbs of everybody: white where both ends are seen, else grey."""
    large = cv2.resize(picture, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_NEAREST)
    for uv, states in zip(frame.joints_2d.values, frame.visibility.values, strict=True):
        for limb in CABINPOSE.limbs:
            ends = list(limb)
            if states[ends].min() <= Visibility.OUTSIDE_IMAGE:
                continue
            colour = (255, 255, 255) if states[ends].min() == Visibility.VISIBLE else (128, 128, 128)
            start, end = (((uv[i] + 0.5) * SCALE - 0.5).round().astype(int).tolist() for i in ends)
            cv2.line(large, start, end, colour, 2, cv2.LINE_AA)
    return large


if __name__ == "__main__":
    main()
