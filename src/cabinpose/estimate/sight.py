"""Whether a frame can be a picture of people at all: what a model's view sees of it, judged before its joints are believed.

A network answers whatever it is shown. These are the frames in which there is nothing for it to find; an empty car is none of
them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import estimate

F32 = NDArray[np.float32]

# Each limit, and last in its line the extreme of 10 000 generated frames: of all sensors, views and packaged scenes.
FEWEST_VALID: Final = 0.003  # share of the pixels that the camera fills; 0.0048 where a range from 1 m leaves hands alone
COVERED_M: Final = 0.2  # half of the depths are nearer: something lies on the lens; the nearest median is 0.35 m
TOUCHING_M, PARTLY = 0.1, 0.05  # so many depths are so near: a part of the lens is covered; 0.000
CLOSED_M: Final = 0.5  # all depths are nearer: no torso fits into a picture; 0.76 of them with a range of 0.1 to 1.0 m
ALL: Final = 0.97  # so much is all: the rest may be flying pixels
MANY: Final = 0.5  # of the pixels: only a picture that is as full is judged by its shape; one person alone is nearly one surface
FEWEST_PIXELS: Final = 200  # and those that are looked at: a small view of one standing person is nearly one surface
OFF_SURFACE, FLAT = 0.05, 0.12  # so few means of 4 x 4 pixels are so far (share of their distance) off one surface; 0.157
EDGE, FEWEST_EDGES = 0.08, 0.005  # so few of these means differ from the next by so much: no silhouette; 0.013
STEP, ROUGH = 0.15, 0.6  # so many neighbours differ by so much: noise; 0.30, and 0.45 of a few real pixels
FEWEST_JOINED: Final = 0.4  # share of the pixels with a depth beside which is another, where they are few; 0.79
LEAST_LIT: Final = 0.8  # share of the pixels with a depth that have an amplitude; 1.00
DARKEST: Final = -1.0  # amplitude x depth² (m); no light is negative, and the usual median is 150

_EVERY, _FEWEST_ROWS = 4, 24  # a pixel in so many a side is looked at, and so many rows at least
_NONE: Final = np.zeros((0, 0), np.float32)


class _Limits(NamedTuple):
    """What the kernel counts by, see src/native/estimate/sight.cpp."""

    every: int
    touching: float = TOUCHING_M
    near: float = COVERED_M
    nearer: float = CLOSED_M
    edge: float = EDGE
    step: float = STEP
    off: float = OFF_SURFACE
    darkest: float = DARKEST


class _Seen(NamedTuple):
    """What the kernel counts, in its order."""

    valid: int
    touching: int
    near: int
    nearer: int
    pairs: int
    steps: int
    lit: int
    all_valid: int
    joined: int
    odd: int
    blocks: int
    block_pairs: int
    edges: int
    off: int


def looked_at_every(height: int) -> int:
    """Of a view of so many rows a pixel in so many a side is looked at."""
    return max(1, min(_EVERY, height // _FEWEST_ROWS))


def unseen(seen: Mapping[str, F32], filled: Sequence[float]) -> list[tuple[str, str]]:
    """For each frame why nobody can be seen in it, and what else stands out; "" = somebody might, and nothing does.

    Parameters
    ----------
    seen
        What the view sees, by name: depth (N, h, w) m, 0 = invalid; amplitude (N, h, w) where the model reads it.
    filled
        Share of the view's pixels, of each frame, that the camera sees.

    Returns
    -------
    list of (str, str)
        N reasons and N remarks, each with what was measured and what it is the mark of.
    """
    depth, amplitude = seen["depth"], seen.get("amplitude")
    limits = _Limits(looked_at_every(depth.shape[1]))
    return [
        _why(depth[i], None if amplitude is None else amplitude[i], float(share), limits)
        for i, share in zip(range(len(depth)), filled, strict=True)
    ]


def _why(depth: F32, amplitude: F32 | None, filled: float, limits: _Limits) -> tuple[str, str]:
    """The reason and the remark of one frame: of reasons the first check that fails."""
    seen = _Seen(*estimate.see(depth, amplitude=_NONE if amplitude is None else amplitude, limits=limits))
    looked_at = -(-depth.shape[0] // limits.every) * -(-depth.shape[1] // limits.every)
    reason = _depth_reason(seen, seen.valid / max(looked_at * filled, 1.0))
    if not reason and amplitude is not None:
        reason = _light_reason(seen, amplitude)
    if not reason and seen.touching > PARTLY * seen.valid:
        share = _said(seen.touching / seen.valid, f"of the depths are nearer than {TOUCHING_M:g} m")
        return "", f"{share}: something lies on a part of the lens, and hides who is behind"
    return reason, ""


def _depth_reason(seen: _Seen, share: float) -> str:
    """Why nobody can be seen in a frame of whose pixels a share has a depth."""
    found, pairs = seen.valid, max(seen.pairs, 1)
    if share < FEWEST_VALID:
        return _said(share, f"of the pixels have a depth that the model uses, and {FEWEST_VALID:.1%} are needed")
    if seen.near > 0.5 * found:
        told = f"of the depths are nearer than {COVERED_M:g} m: the lens is covered, or they are not in metres"
        return _said(seen.near / found, told)
    if seen.nearer > ALL * found:
        return _said(seen.nearer / found, f"of the depths are nearer than {CLOSED_M:g} m, where nobody fits into the picture")
    if seen.steps > ROUGH * pairs:
        return _said(seen.steps / pairs, f"of neighbouring depths differ by {STEP:.0%}: this is noise")
    if share > MANY and found > FEWEST_PIXELS:
        if seen.edges < FEWEST_EDGES * seen.block_pairs:
            return _said(
                seen.edges / seen.block_pairs, f"of neighbouring depths differ by {EDGE:.0%}: no silhouette, only bare walls"
            )
        if seen.off < FLAT * seen.blocks:
            return _said(
                1 - seen.off / seen.blocks, f"of the depths lie within {OFF_SURFACE:.0%} of one surface: a wall or a cover"
            )
    elif seen.joined < FEWEST_JOINED * seen.all_valid:
        told = "of the pixels with a depth have a neighbour with one: scattered points, no picture"
        return _said(seen.joined / seen.all_valid, told)
    return ""


def _light_reason(seen: _Seen, amplitude: F32) -> str:
    """Why amplitudes are none."""
    if seen.odd:
        if strange := np.count_nonzero(~np.isfinite(amplitude)):
            return _said(strange / amplitude.size, "of the amplitudes are not finite: 0 stands for none")
        return _said(np.count_nonzero(amplitude < 0) / amplitude.size, "of the amplitudes are negative, as no light is")
    if seen.lit < LEAST_LIT * seen.valid:
        lit = seen.lit / seen.valid
        return _said(lit, f"of the pixels with a depth have an amplitude above 0, and {LEAST_LIT:.0%} are needed")
    return ""


def _said(figure: float, words: str) -> str:
    return f"{figure:.1%} {words}".replace("%", " %")
