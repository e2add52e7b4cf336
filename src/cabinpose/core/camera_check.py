"""Whether the numbers of a camera can be those of the images that they come with: the one check, wherever a camera comes in.

What cannot be is an error; what hardly can is a doubt, told once as a warning. The limits are set by all presets, calibrations of
real devices in the tests' data, and what images cut out of others may have.
"""

from __future__ import annotations

import math
import warnings
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cabinpose.core import reproducible as rp
from cabinpose.core.camera import Camera
from cabinpose.core.errors import CabinposeError, ConfigError

# What cannot be. Last in its line the extreme of the cameras that are known.
NARROWEST_DEG, WIDEST_DEG = 1.0, 170.0  # the larger field of view of the two axes; 46 and 105, a cut-out of 20 px 11
FARTHEST_DEG: Final = 80.0  # off the axis, of a pixel of an image beside it: cut-outs lie anywhere in what a lens sees; 52
NEAREST_FOLD: Final = 0.85  # of the way to the nearest border: the image circle may end there; Azure Kinect's wide field 0.97
FEWEST_RAYS: Final = 1 / 3  # share of the points looked at that have a ray; 0.71 there
NEAREST_RAY, FARTHEST_RAY = 1 / 3, 8.0  # how far distortion moves a ray, as a factor; 2.2
MOST_SKEW_PX: Final = 0.1  # moved by a skew, which `Camera` does not have, at the border; 0, fitted lenses err by as much
# What hardly can be.
OFF_CENTRE: Final = 0.15  # of the principal point from the middle, over the image; Azure Kinect's narrow field 0.106
SWAPPED: Final = 0.5  # so much nearer is the principal point to the middle if cx and cy are exchanged, where it is off by
SWAPPED_OFF: Final = 0.03  # so much of the image; 0.024 in images that are not square
ANISOTROPY: Final = 1.12  # the larger focal length over the other; 1.0003, PAL's pixels 1.09
USUAL_DEG: Final = (10.0, 150.0)  # field of view; 46 and 105
DARK: Final = 0.4  # share of the points looked at that have no ray; 0.32 of a square around its image circle
TANGENTIAL: Final = 0.02  # p1, p2; 0.0011
RAYLESS: Final = 0.02  # share of an image's depths that lie where the lens has no ray; 0

_GRID = 17  # points a side that are looked at
_ALIKE = 0.1  # two factors that differ by less are one
_NORMALISED = 3.0  # focal lengths in widths of the image are below this, in millimetres above the half of it
_BINNINGS = (0.125, 0.25, 0.5, 2.0, 4.0, 8.0)  # factors between the images of one camera
_ROWS = "its rows are fx 0 cx, 0 fy cy, 0 0 1, in pixels"


def camera_from(
    k: ArrayLike, dist: ArrayLike, width: int, height: int, *, whose: str = "camera_k", error: type[CabinposeError] = ConfigError
) -> Camera:
    """The checked camera of a matrix and its distortion; the same object for the same numbers.

    Parameters
    ----------
    k
        (3, 3) matrix of intrinsics, px; an integer pixel is a pixel's centre.
    dist
        (5,) OpenCV's k1 k2 p1 p2 k3.
    width, height
        Of the images, px.
    whose
        What messages call the camera.
    error
        What is raised.

    Raises
    ------
    CabinposeError
        Of the kind `error`, where no camera of such images has these numbers. A `UserWarning` says once what hardly can be.
    """
    camera = _camera_or_fault(k, dist, (width, height))
    if isinstance(camera, Camera):
        return check_camera(camera, whose, error=error)
    raise error(f"{whose}: {camera.said}", hint=camera.hint)


def camera_objections(k: ArrayLike, dist: ArrayLike, width: int, height: int) -> tuple[Camera | None, tuple[str, ...]]:
    """The camera that a device states, None where it is none, and what speaks against it, in words; nothing is raised or warned.

    k, dist, width, height: as for `camera_from`.
    """
    camera = _camera_or_fault(k, dist, (width, height))
    if isinstance(camera, _Fault):
        return None, (f"{camera.said} ({camera.hint})",)
    return camera, camera_doubts(camera)


def known_camera(
    k: ArrayLike, dist: ArrayLike, width: int, height: int, *, whose: str, error: type[CabinposeError]
) -> Camera | None:
    """The camera as `camera_from` checks it; None where the matrix is NaN throughout, which stands for one that is not known."""
    if np.isnan(np.asarray(k, np.float64)).all():
        return None
    return camera_from(k, dist, width, height, whose=whose, error=error)


def check_camera(camera: Camera, whose: str, *, error: type[CabinposeError] = ConfigError) -> Camera:
    """The camera itself; raises `error` where no camera is like this, and warns once of what hardly can be.

    whose: what messages call it.
    """
    fault = _fault(camera)
    if fault is not None:
        raise error(f"{whose}: {fault.said}", hint=fault.hint)
    if doubts := camera_doubts(camera):
        _tell(f"{whose}: {'; '.join(doubts)}")
    return camera


def check_image_circle(camera: Camera, whose: str, circle_px: float | None) -> None:
    """Warn once of a lens that folds within its image, where no image circle is stated that ends before.

    whose: what messages call the camera · circle_px: radius of the image circle about the principal point; None: not stated.
    """
    if not camera.is_distorted or math.isinf(fold := _fold_px(camera)) or (circle_px is not None and circle_px <= fold):
        return
    dark = 1.0 - np.isfinite(_factors(camera)).mean()
    if 0 < dark <= DARK:  # of more it is told as a doubt of the camera
        _tell(
            f"{whose}: {_folds(camera)}, and {100 * dark:.0f} % of the pixels lie beyond and see nothing: right only where the"
            f" image circle of the lens ends there, which field_radius_px={fold:.0f} says; else fit dist to the whole image"
        )


def depth_doubt(camera: Camera, depth_m: NDArray[np.floating]) -> str:
    """What a lens that sees nothing where its images (..., height, width) have depths means, in words; "" where it sees all."""
    if math.isinf(camera.monotonic_radius):
        return ""
    seen = np.isfinite(depth_m) & (depth_m > 0)
    share = np.count_nonzero(seen[..., np.isnan(camera.rays[..., 0])]) / max(int(np.count_nonzero(seen)), 1)
    if share <= RAYLESS:
        return ""
    return (
        f"{100 * share:.0f} % of the depths lie where the lens sees nothing: {_folds(camera)}. Fit dist to the whole image; these"
        " pixels are no points, and joints there are outside the image"
    )


@lru_cache(maxsize=1024)
def camera_doubts(camera: Camera) -> tuple[str, ...]:
    """What speaks against a camera that can be, in words: what was seen, why it hardly can be, the likely cause."""
    fx, fy, fov = camera.fx, camera.fy, camera.fields_deg
    told = [_off_centre(camera)]
    apart = max(fx, fy) / min(fx, fy)
    if apart > ANISOTROPY:
        told.append(
            f"fx {fx:.4g} and fy {fy:.4g} px differ by a factor of {apart:.3g}, and pixels are square: right only for images"
            " whose width and height were scaled apart"
        )
    if not USUAL_DEG[0] <= max(fov) <= USUAL_DEG[1]:
        told.append(
            f"fx {fx:.4g} and fy {fy:.4g} px are a field of view of {fov[0]:.3g}° x {fov[1]:.3g}° of"
            f" {camera.width}x{camera.height} pixels, and lenses have {USUAL_DEG[0]:g}° to {USUAL_DEG[1]:g}°: are they pixels of"
            " these images?"
        )
    if camera.is_distorted:
        dark = 1.0 - np.isfinite(_factors(camera)).mean()
        if dark > DARK:
            told.append(
                f"with distortion {_numbers(camera.dist)} {100 * dark:.0f} % of the pixels have no ray: right only where the"
                " image circle of the lens ends in the image"
            )
        if max(map(abs, camera.dist[2:4])) > TANGENTIAL:
            told.append(
                f"tangential distortion {_numbers(camera.dist[2:4])} is more than a lens has, {TANGENTIAL:g}: the order is"
                " k1 k2 p1 p2 k3"
            )
    return tuple(filter(None, told))


def forget_told_cameras() -> None:
    """Let warnings of cameras come again, as for another run."""
    _tell.cache_clear()


class _Fault(NamedTuple):
    """What is wrong with a camera, and the remedy."""

    said: str
    hint: str


def _camera_or_fault(k: ArrayLike, dist: ArrayLike, size: tuple[int, int]) -> Camera | _Fault:
    """The camera of a matrix and its distortion, or what is wrong with it."""
    matrix, five = (np.ascontiguousarray(values, np.float64) for values in (k, dist))
    camera = _of_bytes((matrix.tobytes(), matrix.shape), (five.tobytes(), five.shape), size)
    return camera if isinstance(camera, _Fault) else _fault(camera) or camera


@lru_cache(maxsize=1024)
def _tell(words: str) -> None:
    """Warn of what hardly can be, once for each camera and who has it."""
    warnings.warn(words, stacklevel=5)


@lru_cache(maxsize=1024)
def _of_bytes(k: tuple[bytes, tuple[int, ...]], dist: tuple[bytes, tuple[int, ...]], size: tuple[int, int]) -> Camera | _Fault:
    """The camera of the bytes and shapes of matrix and distortion, or what is wrong with them and the remedy."""
    if k[1] != (3, 3):
        return _Fault(f"a matrix of shape {k[1]} is none of a camera", f"give (3, 3): {_ROWS}")
    matrix, five = np.frombuffer(k[0]).reshape(3, 3), np.frombuffer(dist[0])
    if np.isnan(matrix).all():
        return _Fault("the camera's intrinsics are not known", "give them: `import --intrinsics FX FY CX CY`, or a calibration")
    fault = _matrix_fault(matrix, size)
    if fault is not None:
        return fault
    if dist[1] != (5,):
        return _Fault(
            f"distortion of shape {dist[1]} is no lens'",
            "give OpenCV's five coefficients k1 k2 p1 p2 k3, 0 for those not known",
        )
    if not np.isfinite(five).all():
        return _Fault(
            f"distortion is {_numbers(five)}, not finite", "give OpenCV's k1 k2 p1 p2 k3; 0 0 0 0 0 where the lens has none"
        )
    k1, k2, p1, p2, k3 = five.tolist()
    (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    return Camera(*size, fx, fy, cx, cy, (k1, k2, p1, p2, k3))


def _matrix_fault(k: NDArray[np.float64], size: tuple[int, int]) -> _Fault | None:
    """What is wrong with a matrix (3, 3) that no camera's is, and the remedy."""
    if not np.isfinite(k).all():
        return _Fault(f"the matrix has {_numbers(k[~np.isfinite(k)])}, not finite", _ROWS)
    last = k[2]
    if tuple(last) != (0.0, 0.0, 1.0):
        if tuple(k[:, 2]) == (0.0, 0.0, 1.0):
            return _Fault(
                f"the matrix' last row is {_numbers(last)} and its last column 0 0 1: it is transposed", f"give K.T: {_ROWS}"
            )
        if last[2] not in (0.0, 1.0) and not last[:2].any():
            return _Fault(
                f"the matrix' last row is {_numbers(last)}, not 0 0 1: the whole matrix was scaled, or its last element changed",
                f"divide the matrix by K[2,2], or set that to 1: {_ROWS}",
            )
        return _Fault(f"the matrix' last row is {_numbers(last)}, not 0 0 1", _ROWS)
    if k[1, 0]:
        return _Fault(f"the matrix' element [1,0] is {k[1, 0]:g}, and below the diagonal all are 0", _ROWS)
    for name, focal in (("fx", k[0, 0]), ("fy", k[1, 1])):
        if focal <= 0:
            cause = "is an axis of the images reversed, as in OpenGL? Give both above 0" if focal < 0 else _ROWS
            return _Fault(f"{name} is {focal:g} px, and focal lengths are above 0", cause)
    moved = abs(k[0, 1]) * size[1] / (2 * k[1, 1])
    if moved > MOST_SKEW_PX:
        return _Fault(
            f"the skew, element [0,1], is {k[0, 1]:g}: it moves pixels by {moved:.2g} px, and the camera model has none",
            "calibrate without skew, as OpenCV does",
        )
    return None


@lru_cache(maxsize=1024)
def _fault(camera: Camera) -> _Fault | None:
    """Why no camera is like this, and the remedy."""
    size, size_text = (camera.width, camera.height), f"{camera.width}x{camera.height} image"
    fov = camera.fields_deg
    if max(fov) < NARROWEST_DEG or max(fov) > WIDEST_DEG:
        return _Fault(
            f"fx {camera.fx:g} px, fy {camera.fy:g} px are a field of view of {fov[0]:.3g} x {fov[1]:.3g} degrees"
            f" of a {size_text}{_unit(camera) if max(fov) > WIDEST_DEG else ''}",
            f"give fx and fy in pixels of the {size_text}",
        )
    beside = [
        max(n - c, c) / f for n, c, f in zip(size, (camera.cx, camera.cy), (camera.fx, camera.fy), strict=True) if not 0 <= c < n
    ]
    away = math.degrees(rp.arctan(max(beside, default=0.0)))
    if away > FARTHEST_DEG:
        return _Fault(
            f"the principal point {camera.cx:g}, {camera.cy:g} is far outside the {size_text}: its pixels would be {away:.0f}"
            " degrees off the axis",
            "give cx and cy in pixels; an integer is a pixel's centre",
        )
    if not camera.is_distorted:
        return None
    factor = _factors(camera)
    seen, fold = np.isfinite(factor), _fold(camera)
    if fold < NEAREST_FOLD or seen.mean() < FEWEST_RAYS:
        return _Fault(
            f"with distortion {_numbers(camera.dist)} only {100 * seen.mean():.0f} % of the pixels have a ray: it folds back"
            f" {100 * fold:.0f} % of the way from the principal point to the nearest border",
            "give dist as OpenCV's k1 k2 p1 p2 k3, fitted to this image and its focal length",
        )
    if not ((factor[seen] > NEAREST_RAY) & (factor[seen] < FARTHEST_RAY)).all():
        return _Fault(
            f"distortion {_numbers(camera.dist)} moves rays to {factor[seen].min():.2g} to {factor[seen].max():.2g} times their"
            " distance from the axis",
            "give dist as OpenCV's k1 k2 p1 p2 k3, of coordinates in focal lengths, not pixels",
        )
    return None


def _unit(camera: Camera) -> str:
    """What focal lengths far too small may be."""
    if (camera.fx, camera.fy, camera.cx, camera.cy) == (1.0, 1.0, 0.0, 0.0):
        return ": this is the identity matrix, which says nothing of a camera"
    if camera.fx < _NORMALISED and 0 < camera.cx < 1:
        return ": they are in widths of the image; multiply by its width and height"
    return ": are they millimetres? Divide by the size of a pixel" if camera.cx > 1 else ""


def _factors(camera: Camera) -> NDArray[np.float64]:
    """How far distortion moves the rays of points spread over the image, as a factor; NaN where there is no ray."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, _GRID), np.linspace(0, camera.height - 1, _GRID))
    bent = np.stack(((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy), axis=-1)
    off = np.linalg.norm(bent, axis=-1)
    factors: NDArray[np.float64] = np.linalg.norm(camera.undistort(bent), axis=-1)[off > 0] / off[off > 0]
    return factors


def _fold(camera: Camera) -> float:
    """Where the radial polynomial folds, over the distance from the principal point to the image's nearest border; inf: nowhere.

    Infinite too where the principal point lies outside the image.
    """
    edge = min(camera.cx / camera.fx, (camera.width - 1 - camera.cx) / camera.fx,
               camera.cy / camera.fy, (camera.height - 1 - camera.cy) / camera.fy)  # fmt: skip
    return math.inf if edge <= 0 else _fold_px(camera) / camera.fx / edge


def _fold_px(camera: Camera) -> float:
    """Where the radial polynomial folds: px from the principal point along a row; infinite: nowhere."""
    r, (k1, k2, _, _, k3) = camera.monotonic_radius, camera.dist
    if math.isinf(r):
        return math.inf
    r2 = r * r
    return r * (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) * camera.fx


def _folds(camera: Camera) -> str:
    return (
        f"distortion {_numbers(camera.dist)} folds {_fold_px(camera):.0f} px from the principal point,"
        f" {math.degrees(rp.arctan(camera.monotonic_radius)):.1f}° off the axis"
    )


def _off_centre(camera: Camera) -> str:
    """What a principal point means that is not near the middle of the image; "" where it is."""
    size, centre = np.array((camera.width, camera.height), float), np.array((camera.cx, camera.cy)) + 0.5
    off = np.abs(centre / size - 0.5)
    seen = (
        f"cx {camera.cx:.4g} of {camera.width} columns and cy {camera.cy:.4g} of {camera.height} rows,"
        f" where the middle is {(camera.width - 1) / 2:g}, {(camera.height - 1) / 2:g}"
    )
    exchanged = np.abs(centre[::-1] / size - 0.5)
    if off.min() > SWAPPED_OFF and camera.width != camera.height and exchanged.max() < SWAPPED * off.max():
        return f"{seen}: cx and cy are exchanged, or the image was turned by 90° and its camera was not"
    if off.max() <= OFF_CENTRE:
        return ""
    if off.min() > OFF_CENTRE:
        if np.abs(centre - 0.5).max() < 1.0:
            return f"{seen}: are pixels counted from the middle? They count from the first, whose centre is 0, 0"
        of = centre / (size / 2)  # times the image whose middle it is
        if of.min() > 0 and abs(of[0] / of[1] - 1) < _ALIKE:
            found = float(of.mean())
            factor = next((whole for whole in _BINNINGS if abs(found / whole - 1) < _ALIKE), found)
            fov, true = camera.fields_deg[0], 2 * math.degrees(rp.arctan(camera.width * factor / (2 * camera.fx)))
            width, height = factor * size
            return (
                f"{seen}: this is the matrix of an image of about {width:.0f}x{height:.0f} pixels, whose field of view is"
                f" {true:.0f}°, not {fov:.0f}°; divide fx fy cx cy by {factor:.2g}"
            )
    return f"{seen}: right only for images cut out of larger ones"


def _numbers(values: ArrayLike) -> str:
    return " ".join(f"{value:g}" for value in np.ravel(values))
