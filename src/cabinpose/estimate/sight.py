"""Whether a frame can be a picture of people at all: what a model's view sees of it, judged before its joints are believed.

A network answers whatever it is shown. These are the frames in which there is nothing for it to find, told by numbers that cost a
hundredth of its time; an empty car is none of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

# Each limit with the extreme of 1 560 generated frames of all sensors and views, and of the real ones (docs/limits.md).
FEWEST_VALID: Final = 0.015  # share of the pixels that the camera fills; 0.039 where a range from 1 m leaves a back seat alone
COVERED_M: Final = 0.2  # half of the depths are nearer: something lies on the lens; the nearest median is 0.35 m
CLOSED_M: Final = 0.5  # all depths are nearer: no torso fits into a picture; 0.76 of them with a range of 0.1 to 1.0 m
ALL: Final = 0.97  # so much is all: the rest may be flying pixels
MANY: Final = 0.25  # of the pixels: a surface is judged from so many on; with fewer a back seat may be all that is in range
OFF_SURFACE, FLAT = 0.05, 0.15  # so few pixels are so far (share of their distance) off one surface fitted to all; 0.23
EDGE, FEWEST_EDGES = 0.08, 0.005  # so few neighbours differ by so much: no silhouette, as between bare walls; 0.022
STEP, ROUGH = 0.15, 0.5  # so many neighbours differ by so much: noise; 0.23
FEWEST_JOINED: Final = 0.4  # share of the pixels with a depth beside which, and below which, is another; 0.78
LEAST_LIT: Final = 0.8  # share of the pixels with a depth that have an amplitude; 1.00
DARKEST: Final = -1.0  # amplitude x depth² (m); no light is negative, and the usual median is 150

_EVERY, _FEWEST_ROWS = 4, 24  # a pixel in so many a side is looked at, and so many rows at least
_DEGREES = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))  # of the surface: the first three are a plane


def unseen(seen: Mapping[str, F32], filled: NDArray[np.float64]) -> list[str]:
    """For each frame why nobody can be seen in it; "" = somebody might.

    Parameters
    ----------
    seen
        What the view sees, by name: depth (N, h, w) m, 0 = invalid; amplitude (N, h, w) where the model reads it.
    filled
        (N,) share of the view's pixels that the camera sees.

    Returns
    -------
    list of str
        N reasons, each with what was measured and what it is the mark of.
    """
    whole = seen["depth"] > 0
    every = max(1, min(_EVERY, whole.shape[1] // _FEWEST_ROWS))
    depth, valid = seen["depth"][:, ::every, ::every], whole[:, ::every, ::every]
    counts = _count(valid)
    some = np.maximum(counts, 1)
    share = counts / (valid[0].size * np.maximum(filled, 1 / valid[0].size))
    near, closed = (_count((depth < limit) & valid) / some for limit in (COVERED_M, CLOSED_M))
    pairs = valid[..., :-1] & valid[..., 1:]
    change = np.where(pairs, np.abs(depth[..., 1:] - depth[..., :-1]) / np.maximum(depth[..., :-1], 1e-3), 0.0)
    edges, steps = (_count(change > limit) / np.maximum(_count(pairs), 1) for limit in (EDGE, STEP))
    beside, below = whole[..., 1:] & whole[..., :-1], whole[:, 1:] & whole[:, :-1]
    joined = np.minimum(_count(beside), _count(below)) / np.maximum(_count(whole), 1)
    many = share > MANY
    off = _off_surface(depth, valid) / some if many.any() else np.ones(len(depth))
    # What was seen, by frame, where it cannot be; the figure; the words for it. The first that holds is told.
    checks: list[tuple[NDArray[np.bool_], NDArray[np.float64], str]] = [
        (share < FEWEST_VALID, share, f"of the pixels have a depth that the model uses, and {FEWEST_VALID:.1%} are needed"),
        (near > 0.5, near, f"of the depths are nearer than {COVERED_M:g} m: the lens is covered, or they are not in metres"),
        (closed > ALL, closed, f"of the depths are nearer than {CLOSED_M:g} m, where nobody fits into the picture"),
        (many & (off < FLAT), 1 - off, f"of the depths lie within {OFF_SURFACE:.0%} of one surface: a wall or a cover"),
        (many & (edges < FEWEST_EDGES), edges, f"of neighbouring depths differ by {EDGE:.0%}: no silhouette, only bare walls"),
        (steps > ROUGH, steps, f"of neighbouring depths differ by {STEP:.0%}: this is noise"),
        (joined < FEWEST_JOINED, joined, "of the pixels with a depth have a neighbour with one: scattered points, no picture"),
    ]
    if "amplitude" in seen:
        amplitude = seen["amplitude"]
        light = amplitude * seen["depth"] * seen["depth"]
        strange = ~np.isfinite(light.sum(axis=(1, 2)))
        lit = _count(valid & (amplitude[:, ::every, ::every] > 0)) / some
        checks += [
            (strange, _count(~np.isfinite(amplitude)) / amplitude[0].size, "of the amplitudes are not finite: 0 stands for none"),
            (light.min(axis=(1, 2)) <= DARKEST, _count(amplitude < 0) / amplitude[0].size, "of the amplitudes are negative, as no light is"),
            (lit < LEAST_LIT, lit, f"of the pixels with a depth have an amplitude above 0, and {LEAST_LIT:.0%} are needed"),
        ]
    told = [""] * len(depth)
    for wrong, figure, words in checks:
        for i in np.flatnonzero(wrong).tolist():
            told[i] = told[i] or f"{figure[i]:.1%} {words}".replace("%", " %")
    return told


def _count(where: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(N,) how many pixels of each frame (N, h, w) are so."""
    return np.asarray(np.count_nonzero(where, axis=(1, 2)))


def _off_surface(depth: F32, valid: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(N,) how many pixels lie off the surface 1/z = a + bu + cv + du² + euv + fv² that is nearest to all; a plane is one."""
    n, h, w = depth.shape
    basis, products, where = _surface(h, w)
    flat, inside = depth.reshape(n, -1), valid.reshape(n, -1).astype(np.float32)
    inverse = inside / np.maximum(flat, 1e-3)
    normal = (inside @ products)[:, where] + 1e-6 * np.eye(len(basis), dtype=np.float32)
    surface = np.linalg.solve(normal.astype(np.float64), (inverse @ basis.T)[..., None].astype(np.float64))[..., 0]
    missed = np.abs(surface.astype(np.float32) @ basis * flat - inside) > OFF_SURFACE
    return np.asarray(np.count_nonzero(missed, axis=1))


@cache
def _surface(h: int, w: int) -> tuple[F32, F32, NDArray[np.int64]]:
    """basis: (6, h w) the surface's terms · products: (h w, K) their products, each once · where: (6, 6) which product is whose."""
    v, u = np.mgrid[:h, :w] / max(h, w) - 0.5
    basis = np.stack([(u**a * v**b).ravel() for a, b in _DEGREES])
    sums = [[(a + c, b + d) for c, d in _DEGREES] for a, b in _DEGREES]
    each = sorted({pair for row in sums for pair in row})
    products = np.stack([(u**a * v**b).ravel() for a, b in each], axis=1)
    where = np.array([[each.index(pair) for pair in row] for row in sums])
    return basis.astype(np.float32), products.astype(np.float32), where
