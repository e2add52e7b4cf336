"""Cloth, hair and beard as a layer off the skin: the same mesh, every vertex moved outwards.

A garment lies where its mask is 1, feathered at the hems. It bridges hollows (between the breasts, the small of the
back): where a smoothed skin lies outside the skin, the cloth follows the smoothed one. On top come its thickness, its
looseness (more on belly, thighs and shins than on shoulders) and folds: ridged band-limited noise, strongest about
elbows, knees, armpits, waist and crotch. Cloth is never below the skin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cabinpose.scene.body.chart import face_mean, load_chart
from cabinpose.scene.body.outfit import Outfit
from cabinpose.scene.body.shape import load_shape_space
from cabinpose.scene.body.skinning import vertex_normals

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
_SMOOTHING_STEPS = 20  # for what has no garment's own: hair, caps, bare skin


@dataclass(frozen=True)
class _Cut:
    """A garment: ends of its regions (chart units), thickness, looseness at fit 1 and depth of folds (m), material.

    bridge: steps of smoothing, more for cloth that spans wider hollows.
    """

    thickness: float
    loose: float
    folds: float
    material: str
    sleeve: float = 0.0  # along_arm
    hem: float = 0.0  # up
    collar: float = 0.0  # share of the neck's weights that stays free
    leg: float = 0.0  # along_leg
    bridge: int = 20


TOPS = {
    "t_shirt": _Cut(0.002, 0.030, 0.011, "cotton", sleeve=0.62, hem=-0.06, collar=0.25, bridge=25),
    "long_sleeve": _Cut(0.002, 0.026, 0.010, "cotton", sleeve=1.93, hem=-0.05, collar=0.35, bridge=25),
    "jumper": _Cut(0.006, 0.032, 0.012, "wool", sleeve=1.96, hem=-0.02, collar=0.45, bridge=50),
    "jacket": _Cut(0.010, 0.034, 0.014, "synthetic_fabric", sleeve=2.0, hem=-0.10, collar=0.75, bridge=80),
}
BOTTOMS = {
    "trousers": _Cut(0.002, 0.030, 0.010, "cotton", leg=1.99),
    "jeans": _Cut(0.003, 0.020, 0.008, "denim", leg=1.99),
    "shorts": _Cut(0.002, 0.036, 0.010, "cotton", leg=0.78),
}
HAIR_DEPTH_M = {"bald": 0.0, "short": 0.009, "medium": 0.022, "long": 0.018, "bun": 0.010}
CAP_DEPTH_M, BEARD_DEPTH_M = 0.014, 0.009


@dataclass(frozen=True)
class Layer:
    """The dressed skin at rest (V, 3) m, and the faces that things cover, inner ones first.

    regions: (faces (F,) bool, material, label or None where the body part's own stays).
    """

    vertices: Array32
    regions: tuple[tuple[NDArray[np.bool_], str, str | None], ...]


def _step(x: Array, edge: float, width: float) -> Array:
    """Smooth step from 0 to 1 about `edge`."""
    t = np.clip((x - edge) / width + 0.5, 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))


def _bump(x: Array, centre: float, width: float) -> Array:
    return np.asarray(np.exp(-(((x - centre) / width) ** 2)))


@cache
def _neighbours() -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Rows of the vertex graph: (V + 1,) starts and the neighbours."""
    faces = load_shape_space().faces
    edges = np.unique(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=0)
    edges = np.unique(np.concatenate([edges, edges[:, ::-1]]), axis=0)
    count = load_shape_space().vertex_count
    return np.searchsorted(edges[:, 0], np.arange(count + 1)).astype(np.int32), edges[:, 1].astype(np.int32)


@njit(cache=True, nogil=True)
def _smoothed(points: Array32, start: NDArray[np.int32], near: NDArray[np.int32], mask: Array32, steps: int) -> Array32:
    """Laplacian smoothing of the masked vertices."""
    now, then = points.copy(), points.copy()
    for _ in range(steps):
        for v in range(len(points)):
            if mask[v] <= 0:
                continue
            x = y = z = np.float32(0)
            for k in range(start[v], start[v + 1]):
                x += now[near[k], 0]
                y += now[near[k], 1]
                z += now[near[k], 2]
            n = np.float32(0.7) * mask[v] / (start[v + 1] - start[v])
            keep = np.float32(1) - np.float32(0.7) * mask[v]
            then[v, 0] = keep * now[v, 0] + n * x
            then[v, 1] = keep * now[v, 1] + n * y
            then[v, 2] = keep * now[v, 2] + n * z
        now, then = then, now
    return now


@njit(cache=True, nogil=True)
def _ridges(points: Array, mask: Array, waves: Array, bends: Array, phases: Array, out: Array) -> None:
    for v in range(len(points)):
        if mask[v] <= 0:
            continue
        x, y, z = points[v, 0], points[v, 1], points[v, 2]
        total = 0.0
        for k in range(len(waves)):
            bend = np.sin(x * bends[k, 0] + y * bends[k, 1] + z * bends[k, 2] + phases[k, 0])
            total += np.sin(x * waves[k, 0] + y * waves[k, 1] + z * waves[k, 2] + phases[k, 1] + 1.3 * bend)
        out[v] = (1 - min(abs(total) / 2.2, 1.0)) ** 2


def fold_noise(points: Array, mask: Array, seed: int, wavelength: tuple[float, float]) -> Array:
    """Ridged band-limited noise (N,) from 0 to 1 at points (N, 3) m where mask > 0, else 0: long creases, fixed by the seed."""
    rng = np.random.Generator(np.random.Philox(key=seed))
    direction = rng.standard_normal((5, 3)) * (0.8, 0.8, 1.0)
    waves = direction / np.linalg.norm(direction, axis=1)[:, None] * 2 * np.pi / rng.uniform(*wavelength, (5, 1))
    bends = rng.standard_normal((5, 3)) * 2 * np.pi / (3 * wavelength[1])
    out = np.zeros(len(points))
    _ridges(points, mask, waves, bends, rng.uniform(0, 2 * np.pi, (5, 2)), out)
    return out


@cache
def _crease() -> Array:
    """(V,) where cloth creases most, 0..1: elbows, knees, armpits, waist and crotch."""
    c = load_chart()
    on_leg = c.leg * (
        0.9 * _bump(c.along_leg, 1.0, 0.22) + 0.5 * _bump(c.along_leg, 0.05, 0.15) + 0.6 * _bump(c.along_leg, 1.85, 0.2)
    )
    on_arm = c.arm * (
        0.9 * _bump(c.along_arm, 1.0, 0.25) + 0.6 * _bump(c.along_arm, 0.1, 0.2) + 0.5 * _bump(c.along_arm, 1.8, 0.2)
    )
    on_trunk = (1 - c.arm) * (1 - c.leg) * (0.8 * _bump(c.up, 0.22, 0.16) + 0.3 * _bump(c.up, 0.75, 0.15))
    return np.asarray(np.clip(0.25 + on_leg + on_arm + on_trunk, 0, 1))


@cache
def _top_mask(name: str) -> Array:
    c, cut = load_chart(), TOPS[name]
    trunk = _step(c.up, cut.hem, 0.03) * (1 - _step(c.neck + c.head, cut.collar, 0.2))
    sleeve = np.where(c.arm > 0.5, 1 - _step(c.along_arm, cut.sleeve, 0.06), 1.0)
    return np.asarray(trunk * sleeve * (1 - _step(c.leg * c.along_leg, 0.3, 0.1)))


@cache
def _bottom_mask(name: str) -> Array:
    c, cut = load_chart(), BOTTOMS[name]
    below_waist = 1 - _step(c.up, 0.27, 0.03)
    return np.asarray(below_waist * (c.arm < 0.3) * np.where(c.leg > 0.5, 1 - _step(c.along_leg, cut.leg, 0.04), 1.0))


@cache
def _socks_mask() -> Array:
    c = load_chart()
    return np.asarray((c.leg > 0.5) * _step(c.along_leg, 1.72, 0.03))


@cache
def _covered(mask: Callable[..., Array], *key: object) -> NDArray[np.bool_]:
    """(F,) faces of a mask."""
    return np.asarray(face_mean(mask(*key)) > 0.5)


@cache
def _looseness(*, top: bool) -> Array:
    """(V,) share of a garment's looseness: none where it hangs from, most where it hangs free."""
    c = load_chart()
    trunk = 0.12 + 0.88 * (1 - _step(c.up, 0.72, 0.35))
    arm = 0.35 + 0.5 * _step(c.along_arm, 0.45, 0.5) - 0.55 * _step(c.along_arm, 1.75, 0.3)
    leg = 0.55 + 0.15 * _bump(c.along_leg, 0.4, 0.4) + 0.25 * _step(c.along_leg, 1.4, 0.5)
    waist = 1.0 if top else 1 - 0.8 * _bump(c.up, 0.25, 0.08)
    return np.asarray((c.arm * arm + c.leg * leg + (1 - c.arm - c.leg).clip(0) * trunk) * waist)


@cache
def _head_coordinates() -> tuple[Array, Array, Array]:
    """(V,) forward and up from the point between the eyes of the average adult, and sideways, m."""
    c = load_chart()
    eyes = (c.heads["leye"] + c.heads["reye"]) / 2
    p = c.rest - eyes
    return p[:, 0], p[:, 2], np.abs(p[:, 1])


@cache
def scalp_mask(over_ears: bool) -> Array:
    """(V,) where hair grows: behind a hairline from the forehead over the temples, round the ears, to the nape."""
    c = load_chart()
    x, z, _ = _head_coordinates()
    hairline = np.interp(x, (-0.16, -0.105, -0.085, -0.06, -0.035, -0.01, 0.02), (-0.085, -0.075, -0.02, 0.0, 0.03, 0.062, 0.068))
    mask = _step(z - hairline, 0.0, 0.012) * _step(c.head + c.neck, 0.5, 0.3)
    return np.where(ear_mask(), 1.0 if over_ears else 0.0, mask)


@cache
def ear_mask() -> NDArray[np.bool_]:
    """(V,) the ears, as they stand off the head."""
    c = load_chart()
    x, z, y = _head_coordinates()
    return np.asarray((np.abs(x + 0.085) < 0.034) & (y > 0.066) & (z < 0.022) & (z > -0.06) & (c.head > 0.5))


@cache
def _cap_mask() -> Array:
    c = load_chart()
    x, z, _ = _head_coordinates()
    return np.asarray(_step(z - np.interp(x, (-0.16, -0.06, 0.02), (0.0, 0.03, 0.040)), 0.0, 0.008) * (c.head > 0.5))


@cache
def _beard_mask() -> Array:
    c = load_chart()
    x, z, y = _head_coordinates()
    jaw = _step(-z, 0.062, 0.02) * _step(x, -0.075, 0.02) * (c.head > 0.5) * (z > -0.135)
    sideburn = _bump(x, -0.055, 0.014) * _step(y, 0.055, 0.01) * (z < 0.0) * (c.head > 0.5)
    mouth = (z < -0.055) & (z > -0.082) & (y < 0.026) & (x > 0.0)
    return np.asarray(np.where(mouth, 0.0, np.maximum(jaw, sideburn)))


def layer(skin: Array32, outfit: Outfit, size: float) -> Layer:
    """The skin (V, 3) at rest, dressed. size: stature over that of the average adult, scales the folds' pattern."""
    c = load_chart()
    start, near = _neighbours()
    offset, bridged = np.zeros(len(skin)), np.zeros(len(skin))
    regions: list[tuple[NDArray[np.bool_], str, str | None]] = []
    if outfit.shoes != "none":
        regions.append((_covered(_socks_mask), "cotton", None))
    for name, cuts, masks in ((outfit.bottom, BOTTOMS, _bottom_mask), (outfit.top, TOPS, _top_mask)):
        if name not in cuts:
            continue
        cut, mask, top = cuts[name], masks(name), cuts is TOPS
        noise = fold_noise(c.rest * size, mask, 2 * outfit.folds + top, (0.08, 0.16))
        depth = cut.thickness + cut.loose * (0.25 + 0.75 * outfit.fit) * _looseness(top=top)
        depth += cut.folds * (0.5 + 0.5 * outfit.fit) * _crease() * noise
        offset = np.maximum(offset + 0.002 * mask, mask * depth)
        bridged = np.maximum(bridged, mask)
        regions.append((_covered(masks, name), cut.material, None))
    if outfit.hair != "bald":
        covers_ears = outfit.hair in ("medium", "long")
        scalp = scalp_mask(covers_ears)
        strands = 0.75 + 0.5 * fold_noise(c.rest, scalp, outfit.folds + 977, (0.04, 0.09))
        offset += HAIR_DEPTH_M[outfit.hair] * scalp * strands
        bridged = np.maximum(bridged, scalp)
        regions.append((_covered(scalp_mask, covers_ears), "hair", "hair"))
    if outfit.beard:
        offset += BEARD_DEPTH_M * _beard_mask()
        regions.append((_covered(_beard_mask), "hair", None))
    if outfit.cap:
        mask = _cap_mask()
        offset = np.where(mask > 0, CAP_DEPTH_M * mask, offset)
        bridged = np.maximum(bridged, mask)
        regions.append((_covered(_cap_mask), "cotton", "headwear"))
    steps = TOPS[outfit.top].bridge if outfit.top in TOPS else _SMOOTHING_STEPS
    smooth = _smoothed(skin, start, near, bridged.astype(np.float32), steps)
    faces = load_shape_space().faces
    skin_normals, normals = np.empty_like(skin), np.empty_like(skin)
    vertex_normals(skin, faces, skin_normals)
    vertex_normals(smooth, faces, normals)
    outwards = np.maximum(np.einsum("ij,ij->i", smooth - skin, normals), 0.0) * bridged
    moved = skin + normals * (outwards + offset).astype(np.float32)[:, None]
    if outfit.hair in ("medium", "long"):  # ears vanish under the hair
        flat = _smoothed(smooth, start, near, ear_mask().astype(np.float32), 5 * _SMOOTHING_STEPS)
        moved = np.where(ear_mask()[:, None], flat + normals * np.float32(0.4 * HAIR_DEPTH_M[outfit.hair]), moved)
    # Where smoothed and bare normals part, keep at least half the depth off the skin.
    lack = 0.5 * offset.astype(np.float32) - np.einsum("ij,ij->i", moved - skin, skin_normals)
    if outfit.hair in ("medium", "long"):
        lack[ear_mask()] = 0
    moved += skin_normals * np.maximum(lack, 0.0)[:, None]
    return Layer(moved.astype(np.float32), tuple(regions))
