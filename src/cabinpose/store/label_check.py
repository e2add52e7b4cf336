"""Whether the joints of a dataset can be those of its images: pixels, metres, sides and depth, on a sample of its frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cabinpose.core import CABINPOSE, Bools, Camera, Floats, Visibility

if TYPE_CHECKING:
    import xarray as xr

FRAMES: Final = 64  # that are looked at, evenly over the dataset
_LEAST: Final = 20  # joints on which a share is worth something

# What is told beyond which value, each with its reason.
LIMITS: Mapping[str, tuple[float, str]] = MappingProxyType({
    "unit_px": (2.0, "joints of a person nearer than 10 m are more than 2 px apart"),
    "outside": (0.2, "a joint that is marked as visible lies in the image"),
    "projection_px": (3.0, "joints_2d is the projection of joints_3d; float32 and labels by hand are within 3 px"),
    "behind": (0.5, "what a camera sees has z > 0"),
    "arm_m": (0.45, "an upper arm is 0.15 m (three years old) to 0.40 m long"),
    "arm_short_m": (0.05, "an upper arm is 0.15 m (three years old) to 0.40 m long"),
    "knees": (0.8, "seated people have their knees before their hips"),
})  # fmt: skip


def label_warnings(dataset: xr.Dataset) -> tuple[str, ...]:
    """What is hardly right about the joints of a dataset, in words; empty where nothing is, or where it has none.

    Parameters
    ----------
    dataset
        An opened one (`open_dataset`), of F frames, of which 64 at most are looked at.
    """
    if "joints_3d" not in dataset or "joints_2d" not in dataset or tuple(dataset["joint"].values) != CABINPOSE.joints:
        return ()
    frames = dataset.sizes["frame"]
    some = dataset.isel(frame=np.unique(np.linspace(0, frames - 1, min(frames, FRAMES)).astype(int)))
    names = ("joints_2d", "joints_3d", "visibility", "camera_k", "camera_dist")
    found: dict[str, Any] = {name: some[name].values for name in names if name in some}
    size = (dataset.sizes["x"], dataset.sizes["y"]) if "x" in dataset.sizes else None
    uv, xyz = found["joints_2d"].astype(np.float64), found["joints_3d"].astype(np.float64)
    seen = found["visibility"] == Visibility.VISIBLE if "visibility" in found else np.isfinite(uv).all(axis=-1)
    return (*_pixels(uv, seen, size), *_metres(xyz), *_projection(found, seen, size))


def _pixels(uv: Floats, seen: Bools, size: tuple[int, int] | None) -> Iterator[str]:
    two = np.isfinite(uv).all(axis=-1)
    if two.sum() < _LEAST:
        return
    if np.abs(uv[two]).max() <= LIMITS["unit_px"][0]:
        span = f"{uv[two].min():.2f} to {uv[two].max():.2f} px"
        yield f"joints_2d is from {span}: normalised to the image's size? {LIMITS['unit_px'][1]}"
    elif size is not None and (two & seen).sum() >= _LEAST:
        at = uv[two & seen]
        share = float(1 - ((at >= -1) & (at <= np.array(size))).all(axis=-1).mean())
        if share > LIMITS["outside"][0]:
            where = f"outside of the image ({size[0]} x {size[1]} px)"
            yield f"{100 * share:.0f} % of the visible joints lie {where}: pixels of another size? {LIMITS['outside'][1]}"


def _metres(xyz: Floats) -> Iterator[str]:
    index = CABINPOSE.index
    three = np.isfinite(xyz).all(axis=-1)
    if three.sum() >= _LEAST and (share := float((xyz[three][:, 2] <= 0).mean())) > LIMITS["behind"][0]:
        yield f"{100 * share:.0f} % of joints_3d lie behind the camera: another frame, or z negated? {LIMITS['behind'][1]}"
    arms = np.concatenate([(xyz[..., index[f"{s}shoulder"], :] - xyz[..., index[f"{s}elbow"], :]).reshape(-1, 3) for s in "lr"])
    lengths = np.linalg.norm(arms[np.isfinite(arms).all(axis=-1)], axis=-1)
    if len(lengths) and not LIMITS["arm_short_m"][0] <= (arm := float(np.median(lengths))) <= LIMITS["arm_m"][0]:
        units = [name for name, metres in (("mm", 0.001), ("cm", 0.01), ("inch", 0.0254)) if 0.15 <= arm * metres <= 0.40]
        cause = f": joints_3d fits in {units[0]}" if units else ""
        yield f"upper arms are {arm:.3g} m long (the median){cause}; {LIMITS['arm_m'][1]}"
    if (turned := _backward(xyz)) is not None and turned > LIMITS["knees"][0]:
        yield (
            f"in {100 * turned:.0f} % of the people left and right contradict the knees: exchanged, or an image mirrored?"
            f" {LIMITS['knees'][1]}"
        )


def _backward(xyz: Floats) -> float | None:
    """The share of clearly seated people whose knees are behind what their hips and spine call their front."""
    index = CABINPOSE.index

    def of(name: str) -> Floats:
        return np.asarray(xyz[..., index[name], :])

    left = of("lpelvis") - of("rpelvis") + of("lshoulder") - of("rshoulder")
    up = of("neck") - of("hip")
    front = np.cross(left, up)
    thighs = of("lknee") - of("lpelvis") + of("rknee") - of("rpelvis")
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = (front * thighs).sum(axis=-1) / (np.linalg.norm(front, axis=-1) * np.linalg.norm(thighs, axis=-1))
    sure = np.abs(ahead) > 0.6
    return float((ahead[sure] < 0).mean()) if sure.sum() >= 3 else None


def _projection(found: Mapping[str, Any], seen: Bools, size: tuple[int, int] | None) -> Iterator[str]:
    """joints_2d beside the projection of joints_3d, of the joints that are seen."""
    k, dist = found.get("camera_k"), found.get("camera_dist")
    if k is None or dist is None or size is None or not (np.isfinite(k).all() and np.isfinite(dist).all()):
        return
    cameras = (
        Camera(*size, fx=m[0, 0], fy=m[1, 1], cx=m[0, 2], cy=m[1, 2], dist=tuple(d.tolist()))
        for m, d in zip(k, dist, strict=True)
    )
    with np.errstate(all="ignore"):
        should = np.stack([camera.project(xyz) for camera, xyz in zip(cameras, found["joints_3d"], strict=True)])
        off = np.linalg.norm(should - found["joints_2d"], axis=-1)[seen]
    off = off[np.isfinite(off)]
    if len(off) >= _LEAST and (median := float(np.median(off))) > LIMITS["projection_px"][0]:
        yield f"joints_2d is {median:.3g} px (the median) from where joints_3d and camera_k have it: {LIMITS['projection_px'][1]}"
