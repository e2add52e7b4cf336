"""Pictures of frames before and after the correction of ITOP's labels, to see what it did."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from cabinpose.core import ITOP, Camera, DatasetError
from cabinpose.store.convert.itop_correct import Corrected
from cabinpose.store.frames import write_png

_SIDE_PX = 640  # least width of one of the two, so that frames of 100 px can be looked at
_PERSON = np.array([70, 120, 220])  # the person that was found
_LABEL, _MOVED = (255, 255, 255), (255, 140, 0)


class CorrectionPictures:
    """Writes a PNG of each frame in which a label is moved: the labels before at its left, after at its right."""

    def __init__(self, folder: Path) -> None:
        """Raises DatasetError where the folder is there and not empty, or is no folder."""
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise DatasetError(f"{folder} is not empty", hint="give another folder with --pictures")
        self._folder = folder

    def __call__(
        self, name: str, depth: NDArray[np.floating], before: NDArray[np.floating], after: Corrected, camera: Camera
    ) -> None:
        """depth: (H, W) m · before: (15, 3) m, camera frame · after: what the correction made of it."""
        if not after.moved_m.any():
            return
        self._folder.mkdir(parents=True, exist_ok=True)
        both = [_drawn(depth, None, before, before, camera), _drawn(depth, after.mask, before, after.joints_3d, camera)]
        write_png(self._folder / f"{name}.png", np.concatenate(both, axis=1))


def _drawn(
    depth: NDArray[np.floating], mask: NDArray[np.bool_] | None, before: NDArray[np.floating], joints: NDArray[np.floating],
    camera: Camera,
) -> NDArray[np.uint8]:  # fmt: skip
    """A frame (h, w, 3), the nearer the brighter; the person blue, its labels white, those that moved orange."""
    z = np.nan_to_num(depth)
    near, far = np.quantile(z[z > 0], (0.01, 0.99)) if (z > 0).any() else (0.0, 1.0)
    grey = np.where(z > 0, 220 - 180 * np.clip((z - near) / max(far - near, 1e-6), 0, 1), 0)[..., None].repeat(3, axis=-1)
    if mask is not None:
        grey = np.where(mask[..., None], 0.5 * grey + 0.5 * _PERSON, grey)
    scale = max(1, -(-_SIDE_PX // depth.shape[1]))
    image = Image.fromarray(grey.astype(np.uint8).repeat(scale, axis=0).repeat(scale, axis=1))
    draw = ImageDraw.Draw(image)
    was, at = (scale * (camera.project(points) + 0.5) for points in (before, joints))
    for a, b in ITOP.limbs:
        if np.isfinite(at[[a, b]]).all():
            draw.line([*at[a], *at[b]], fill=(150, 150, 150), width=2)
    for old, new in zip(was.tolist(), at.tolist(), strict=True):
        if np.isfinite([old, new]).all():
            moved = old != new
            draw.line([*old, *new], fill=_MOVED, width=3)
            draw.circle(new, 5, fill=_MOVED if moved else _LABEL, outline=(0, 0, 0))
    return np.asarray(image)
