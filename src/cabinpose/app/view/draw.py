"""Pictures of one frame: depth in colours, amplitude, labels, skeletons, point clouds from two sides. RGB uint8."""

from __future__ import annotations

import io
from functools import lru_cache
from types import MappingProxyType

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from PIL import Image as PilImage

from cabinpose.core import CABINPOSE, FORWARD_FROM_CAMERA, DatasetError, Visibility, transform
from cabinpose.store import PERSON_COLOUR, Colour, Image, Strokes

VISIBILITY_COLOUR: MappingProxyType[Visibility, Colour] = MappingProxyType(
    {
        Visibility.VISIBLE: (46, 204, 113),
        Visibility.SELF_OCCLUDED: (255, 196, 61),
        Visibility.OCCLUDED: (255, 94, 87),
        Visibility.OUTSIDE_IMAGE: (150, 156, 166),
    }
)
INVALID: Colour = (38, 40, 46)
_GAMMA = 0.5
_VIRIDIS = (
    (68, 1, 84), (72, 23, 105), (71, 42, 122), (67, 61, 132), (61, 78, 138), (53, 94, 141),
    (46, 109, 142), (41, 123, 142), (35, 137, 142), (31, 151, 139), (33, 165, 133), (46, 179, 124),
    (70, 192, 111), (101, 203, 94), (137, 213, 72), (176, 221, 47), (216, 226, 25), (253, 231, 37),
)  # fmt: skip


def completed(dataset: xr.Dataset) -> xr.Dataset:
    """The dataset with all that its pictures show: background and nobody where it has no classes or instances, and a level
    camera where its extrinsics are not known (the cloud is then seen from beside and above that camera).

    Raises `DatasetError` where there is no depth to show, or no intrinsics to make a cloud of it.
    """
    if "depth" not in dataset:
        raise DatasetError("the dataset has no depth to show", hint="it holds joints only; `cabinpose info` says what of them")
    if not np.isfinite(dataset["camera_k"].values).all():
        raise DatasetError("the dataset does not know its camera's intrinsics", hint="import it again with --intrinsics")
    depth = dataset["depth"]
    missing = [name for name in ("labels", "instance") if name not in dataset]
    empty = xr.Variable(depth.dims, np.broadcast_to(np.uint8(0), depth.shape))  # no memory, however many frames
    poses = dataset["vehicle_from_camera"].values
    known = np.isfinite(poses).all(axis=(1, 2), keepdims=True)
    level = xr.Variable(dataset["vehicle_from_camera"].dims, np.where(known, poses, transform(FORWARD_FROM_CAMERA)))
    return dataset.assign(dict.fromkeys(missing, empty) | {"vehicle_from_camera": level})


@lru_cache
def colour_map() -> NDArray[np.uint8]:
    """(256, 3) viridis (van der Walt and Smith 2015, CC0) between `_VIRIDIS`, even in lightness, bright = near."""
    ends = np.linspace(0, 255, len(_VIRIDIS)).round()
    channels = [np.interp(np.arange(255, -1, -1), ends, channel) for channel in np.array(_VIRIDIS, float).T]
    return np.stack(channels, axis=1).round().astype(np.uint8)


def depth_range(depth_m: NDArray[np.float32]) -> tuple[float, float]:
    """The depths (m) for the ends of the colours: the 1 and 99 % quantiles of the valid pixels."""
    valid = depth_m[np.isfinite(depth_m)]
    near, far = np.quantile(valid, (0.01, 0.99)).tolist() if valid.size else (0.0, 1.0)
    return near, far


def depth_image(depth_m: NDArray[np.float32], near_m: float, far_m: float) -> Image:
    """Depth (H, W) in the colours of `colour_map`, dark grey where invalid."""
    share = (depth_m - near_m) / max(far_m - near_m, 1e-6)
    image = colour_map()[(np.clip(np.nan_to_num(share), 0, 1) * 255).astype(np.uint8)]
    image[np.isnan(depth_m)] = INVALID
    return image


def amplitude_image(amplitude: NDArray[np.uint16], white: float) -> Image:
    """Amplitude (H, W) in grey, with gamma 1/2 so that what is dark can be seen; `white` is the amplitude of white."""
    grey = (np.clip(amplitude / max(white, 1.0), 0, 1) ** _GAMMA * 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


def infrared_image(electrons: NDArray[np.uint16]) -> Image:
    """A near-infrared picture (H, W) in grey, with the gamma of amplitudes; its brightest fiftieth is white."""
    return amplitude_image(electrons, float(np.quantile(electrons, 0.98)))


def draw_skeleton(image: Image, uv: NDArray[np.float32], visibility: NDArray[np.uint8], scale: float = 1.0) -> None:
    """Draw one person's limbs, and the joints in the colours of their visibility, into `image`, which is `scale` x the frame."""
    points = (uv.astype(np.float64) + 0.5) * scale - 0.5
    usable = np.isfinite(points).all(axis=1) & (np.abs(points) < 8 * max(image.shape)).all(axis=1)
    if not usable.any():
        return
    with Strokes(image) as strokes:
        for colour, width in (((16, 18, 22), round(3 * scale)), ((235, 238, 242), max(round(1.3 * scale), 1))):
            for i, j in CABINPOSE.limbs:
                if usable[i] and usable[j]:
                    strokes.line(points[i], points[j], colour, width)
        for i in np.flatnonzero(usable).tolist():
            state = Visibility(int(visibility[i]))
            if state in VISIBILITY_COLOUR:
                strokes.dot(points[i], 2.6 * scale + 1.0, (16, 18, 22))
                strokes.dot(points[i], 2.6 * scale, VISIBILITY_COLOUR[state])


def cloud_colours(instance: NDArray[np.uint8], amplitude: NDArray[np.uint16], white: float) -> NDArray[np.uint8]:
    """(H, W, 3) colours for a point cloud: the world in grey by amplitude, each person in a colour, shaded by it."""
    shade = np.clip(amplitude / max(white, 1.0), 0, 1) ** _GAMMA
    palette = np.array([(170, 178, 190), *PERSON_COLOUR], np.float64)
    index = np.where(instance == 0, 0, 1 + (instance.astype(int) - 1) % len(PERSON_COLOUR))
    floor = np.where(instance == 0, 0.35, 0.55)
    return (palette[index] * (floor + (1 - floor) * shade)[..., None]).astype(np.uint8)


def orthographic(
    points: NDArray[np.float64], colours: NDArray[np.uint8], axes: NDArray[np.float64],
    bounds: tuple[NDArray[np.float64], NDArray[np.float64]], size: tuple[int, int],
) -> Image:  # fmt: skip
    """Points (n, 3) seen along the third of `axes` (3, 3: right, up, towards the eye), nearest on top.

    bounds: lowest and highest corner (3,) of the box of points that fills the image of `size` (width, height).
    """
    width, height = size
    image = np.full((height, width, 3), (24, 26, 31), np.uint8)
    inside = ((points >= bounds[0]) & (points <= bounds[1])).all(axis=1)
    seen, tints = points[inside], colours[inside]
    u, v = to_view(seen, axes, bounds, size).astype(int).T
    order = np.argsort(seen @ axes[2], kind="stable")
    for du, dv in ((0, 0), (1, 0), (0, 1), (1, 1), (-1, 0), (0, -1)):  # wider than a pixel: points thin out with distance
        x, y = u[order] + du, v[order] + dv
        ok = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        image[y[ok], x[ok]] = tints[order][ok]
    return image


def to_view(
    points: NDArray[np.float64], axes: NDArray[np.float64], bounds: tuple[NDArray[np.float64], NDArray[np.float64]],
    size: tuple[int, int],
) -> NDArray[np.float64]:  # fmt: skip
    """Pixels (n, 2) of points (n, 3) in the picture that `orthographic` draws."""
    width, height = size
    corners = np.array(bounds) @ axes.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    scale = min(width / (high[0] - low[0]), height / (high[1] - low[1]))
    seen, middle = points @ axes.T, (low + high) / 2
    return np.stack((width / 2 + (seen[:, 0] - middle[0]) * scale, height / 2 - (seen[:, 1] - middle[1]) * scale), axis=-1)


def resized(image: Image, size: tuple[int, int]) -> Image:
    """An image of another size (width, height), by the mean over what a pixel covers."""
    return np.asarray(PilImage.fromarray(image).resize(size, PilImage.Resampling.BOX))


def jpeg(image: Image, quality: int) -> bytes:
    """An image as JPEG."""
    buffer = io.BytesIO()
    PilImage.fromarray(np.ascontiguousarray(image)).save(buffer, "jpeg", quality=quality)
    return buffer.getvalue()
