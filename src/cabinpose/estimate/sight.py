"""Whether a frame can be a picture of people at all: what a model's view sees of it, judged before its joints are believed.

A network answers whatever it is shown. These are the frames in which there is nothing for it to find; an empty car is none of
them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

# Each limit, and last in its line the extreme of 1 230 generated frames: all sensors, views and packaged scenes, and empty cars.
FEWEST_VALID: Final = 0.015  # share of the pixels that the camera fills; 0.039 where a range from 1 m leaves a back seat alone
COVERED_M: Final = 0.2  # half of the depths are nearer: something lies on the lens; the nearest median is 0.35 m
CLOSED_M: Final = 0.5  # all depths are nearer: no torso fits into a picture; 0.76 of them with a range of 0.1 to 1.0 m
ALL: Final = 0.97  # so much is all: the rest may be flying pixels
MANY: Final = 0.5  # of the pixels: only a picture that is as full is judged by its shape; one person alone is nearly one surface
FEWEST_PIXELS: Final = 200  # and those that are looked at: a small view of one standing person is nearly one surface
OFF_SURFACE, FLAT = 0.05, 0.15  # so few pixels are so far (share of their distance) off one surface fitted to all; 0.23
EDGE, FEWEST_EDGES = 0.08, 0.005  # so few neighbours differ by so much: no silhouette, as between bare walls; 0.022
STEP, ROUGH = 0.15, 0.5  # so many neighbours differ by so much: noise; 0.23
FEWEST_JOINED: Final = 0.4  # share of the pixels with a depth beside which is another, where they are few; 0.79
LEAST_LIT: Final = 0.8  # share of the pixels with a depth that have an amplitude; 1.00
DARKEST: Final = -1.0  # amplitude x depth² (m); no light is negative, and the usual median is 150

_EVERY, _FEWEST_ROWS = 4, 24  # a pixel in so many a side is looked at, and so many rows at least
_DEGREES = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))  # of the surface: the first three are a plane


def unseen(seen: Mapping[str, F32], filled: Sequence[float]) -> list[str]:
    """For each frame why nobody can be seen in it; "" = somebody might.

    Parameters
    ----------
    seen
        What the view sees, by name: depth (N, h, w) m, 0 = invalid; amplitude (N, h, w) where the model reads it.
    filled
        Share of the view's pixels, of each frame, that the camera sees.

    Returns
    -------
    list of str
        N reasons, each with what was measured and what it is the mark of.
    """
    every = max(1, min(_EVERY, seen["depth"].shape[1] // _FEWEST_ROWS))
    return [
        _why(depth[::every, ::every], float(share), every, depth, seen["amplitude"][i] if "amplitude" in seen else None)
        for i, (depth, share) in enumerate(zip(seen["depth"], filled, strict=True))
    ]


def _why(depth: F32, filled: float, every: int, whole: F32, amplitude: F32 | None) -> str:
    """Why nobody can be seen in one frame, of which `depth` are the pixels that are looked at; the first check that fails.

    One frame at a time: counting in one image takes a tenth of the time of counting along an axis of many.
    """
    count: Callable[[NDArray[Any]], int] = np.count_nonzero
    valid = depth > 0
    found = count(valid)
    share = found / max(depth.size * filled, 1.0)
    if share < FEWEST_VALID:
        return _said(share, f"of the pixels have a depth that the model uses, and {FEWEST_VALID:.1%} are needed")
    invalid = depth.size - found  # 0 m
    if (near := (count(depth < COVERED_M) - invalid) / found) > 0.5:
        return _said(near, f"of the depths are nearer than {COVERED_M:g} m: the lens is covered, or they are not in metres")
    if (near := (count(depth < CLOSED_M) - invalid) / found) > ALL:
        return _said(near, f"of the depths are nearer than {CLOSED_M:g} m, where nobody fits into the picture")
    left, pairs = depth[:, :-1], valid[:, 1:] & valid[:, :-1]
    change, of = np.abs(depth[:, 1:] - left), max(count(pairs), 1)
    if (steps := count((change > STEP * left) & pairs) / of) > ROUGH:
        return _said(steps, f"of neighbouring depths differ by {STEP:.0%}: this is noise")
    if share > MANY and found > FEWEST_PIXELS:
        if (edges := count((change > EDGE * left) & pairs) / of) < FEWEST_EDGES:
            return _said(edges, f"of neighbouring depths differ by {EDGE:.0%}: no silhouette, only bare walls")
        if (off := _off_surface(depth)) < FLAT:
            return _said(1 - off, f"of the depths lie within {OFF_SURFACE:.0%} of one surface: a wall or a cover")
    elif (joined := count((whole[:, 1:] > 0) & (whole[:, :-1] > 0)) / count(whole)) < FEWEST_JOINED:
        return _said(joined, "of the pixels with a depth have a neighbour with one: scattered points, no picture")
    if amplitude is None:
        return ""
    with np.errstate(invalid="ignore"):
        least = (amplitude * whole * whole).min()  # NaN where one is
    if not (least > DARKEST and amplitude.max() < np.inf):
        negative, strange = count(amplitude < 0) / amplitude.size, count(~np.isfinite(amplitude)) / amplitude.size
        if strange:
            return _said(strange, "of the amplitudes are not finite: 0 stands for none")
        return _said(negative, "of the amplitudes are negative, as no light is")
    if (lit := count((amplitude[::every, ::every] > 0) & valid) / found) < LEAST_LIT:
        return _said(lit, f"of the pixels with a depth have an amplitude above 0, and {LEAST_LIT:.0%} are needed")
    return ""


def _said(figure: float, words: str) -> str:
    return f"{figure:.1%} {words}".replace("%", " %")


def _off_surface(depth: F32) -> float:
    """The share of depths (h, w) off the surface 1/z = a + b u + c v + d u² + e u v + f v² nearest to all; a plane is one."""
    basis, products, where = _surface(*depth.shape)
    flat = depth.ravel()
    inside = (flat > 0).astype(np.float32)
    found = float(inside.sum())
    inverse = inside / np.maximum(flat, 1e-3)
    normal = (inside @ products)[where].astype(np.float64) + 1e-6 * np.eye(len(basis))
    surface = np.linalg.solve(normal, (basis @ inverse).astype(np.float64)).astype(np.float32)
    missed = np.abs(surface @ basis * flat - inside) > OFF_SURFACE
    return np.count_nonzero(missed) / max(found, 1.0)


@cache
def _surface(h: int, w: int) -> tuple[F32, F32, NDArray[np.int64]]:
    """basis: (6, h w) the terms · products: (h w, K) of two terms, each once · where: (6, 6) which product is whose."""
    v, u = np.mgrid[:h, :w] / max(h, w) - 0.5
    basis = np.stack([(u**a * v**b).ravel() for a, b in _DEGREES])
    sums = [[(a + c, b + d) for c, d in _DEGREES] for a, b in _DEGREES]
    each = sorted({pair for row in sums for pair in row})
    products = np.stack([(u**a * v**b).ravel() for a, b in each], axis=1)
    where = np.array([[each.index(pair) for pair in row] for row in sums])
    return basis.astype(np.float32), products.astype(np.float32), where
