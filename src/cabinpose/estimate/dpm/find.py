"""From what a view sees to people in their slots; numpy and the compiled core, without torch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.estimate.dpm.config import DpmConfig
from cabinpose.estimate.dpm.hog import F32, Level, features, levels
from cabinpose.estimate.dpm.parts import Beliefs, Parts, Placement, downward, unary, upward
from cabinpose.estimate.found import Found, sigmoid

APART_M = 0.3  # two people's roots
_SHARE = 0.25  # of the root's cell that has a surface near the level
NEAR_M = 0.5  # how far that surface may be from the level
OWN_M = 0.35  # a surface that far from where a part is thought to be belongs to something else
_ROOT_M = 0.05  # standard deviation of the root's depth, as the median of what its parts say
_GATE = 2.5  # standard deviations within which a surface is the part's own
_WINDOW = 2  # the surface of a part is read within so many pixels of the view
_SURE = 4.0  # the score of ±1, which training asks for, is a probability of 0.98 and 0.02


class Person(NamedTuple):
    """A placement on a level, and its positions between cells (P, 2)."""

    placement: Placement
    level: Level
    exact: NDArray[np.float64]


def find(arrays: Mapping[str, NDArray[Any]], settings: DpmConfig, seen: Mapping[str, NDArray[Any]]) -> Found:
    """Joints of the people in N frames, see `estimate.methods.ArrayMethod`."""
    parts = Parts.of(arrays, settings)
    frames, slots, joints = len(seen["depth"]), len(settings.slots), len(settings.joints)
    uv, points = np.full((frames, slots, joints, 2), np.nan), np.full((frames, slots, joints, 3), np.nan)
    score, presence = np.zeros((frames, slots, joints)), np.zeros((frames, slots, joints))
    own = settings.tree.joints
    for n, depth in enumerate(seen["depth"]):
        people = detect(parts, settings, depth, seen["amplitude"][n] if "amplitude" in seen else None)
        uvz = [located(parts, settings, person, depth) for person in people]
        in_camera = settings.view.from_view(np.array(uvz).reshape(len(people), len(settings.tree.parent), 3))
        for k, slot in slots_of(in_camera[:, :1].reshape(-1, 3), parts.slots):
            uv[n, slot], points[n, slot] = uvz[k][own, :2], in_camera[k, own]
            sure = float(sigmoid(np.array(_SURE * people[k].placement.score)))
            score[n, slot] = sure
            presence[n, slot] = sure * settings.view.camera.contains(uv[n, slot])
    return Found(uv, points, score, presence)


def check(arrays: Mapping[str, NDArray[Any]], settings: DpmConfig) -> None:
    """KeyError for an array that lacks, ValueError for one that does not fit."""
    Parts.of(arrays, settings)


def at_roots(config: DpmConfig, cells: F32, belief: F32) -> F32:
    """The root's belief (T, rows, columns), −∞ where no surface is near the level's depth."""
    b = config.filter_cells // 2
    inner = cells[b : cells.shape[0] - b, b : cells.shape[1] - b]
    share, distance = inner[..., -3], inner[..., -2]
    return np.where((share >= _SHARE) & (np.abs(distance) <= NEAR_M * share), belief, np.float32(-np.inf))


def detect(parts: Parts, config: DpmConfig, depth: F32, amplitude: F32 | None = None) -> list[Person]:
    """People in a frame, the best first; roots nearer to each other than 0.3 m are one person's. At most two more than slots."""
    parent = config.tree.parent
    candidates: list[tuple[Level, Beliefs, F32]] = []
    for level in levels(config, parts.levels):
        cells = features(config, level, depth, amplitude)
        beliefs = upward(parts, parent, unary(parts, config, cells))
        candidates.append((level, beliefs, at_roots(config, cells, beliefs.belief[0])))
    people: list[Person] = []
    while len(people) < (1 if len(config.slots) == 1 else len(config.slots) + 2):
        level, beliefs, roots = max(candidates, key=lambda c: c[2].max())
        at = np.unravel_index(np.argmax(roots), roots.shape)
        if not np.isfinite(roots[at]) or (people and roots[at] <= 0):
            break
        placement = downward(beliefs, parent, (int(at[0]), int(at[1]), int(at[2])))
        people.append(Person(placement, level, refined(parts, parent, beliefs, placement)))
        for other, _, maps in candidates:
            x, y = other.cells(level.pixels(people[-1].exact[0]))
            away = np.hypot(np.arange(other.rows)[:, None] - y, np.arange(other.columns) - x)
            maps[:, away * config.pixel_m * config.cell_px < APART_M] = -np.inf
    return people


def refined(parts: Parts, parent: NDArray[np.int64], beliefs: Beliefs, placement: Placement) -> NDArray[np.float64]:
    """Positions (P, 2) between cells: the tops of parabolas through the scores beside each part, its parent where it is."""
    exact = placement.positions.astype(np.float64)
    for part, (t, (x, y)) in enumerate(zip(placement.types, placement.positions, strict=True)):
        belief = beliefs.belief[part][t]
        spring = parts.springs(part)[0][t] if part else np.zeros(4)
        from_parent = exact[parent[part]] if part else exact[0]
        for axis, (at, size) in enumerate(((x, belief.shape[1]), (y, belief.shape[0]))):
            if not 0 < at < size - 1:
                continue
            line = belief[y, x - 1 : x + 2] if axis == 0 else belief[y - 1 : y + 2, x]
            away = np.arange(at - 1, at + 2) - from_parent[axis] - spring[2 * axis + 1]
            before, here, after = line - spring[2 * axis] * away**2
            bend = before - 2 * here + after
            if bend < 0:
                exact[part, axis] += np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
    return exact


def pixels_of(parts: Parts, person: Person) -> NDArray[np.float64]:
    """Pixels of the view (P, 2) that a person's parts lie at."""
    types = person.placement.types
    return person.level.pixels(person.exact + parts.shift[np.arange(len(types)), types])


def located(parts: Parts, config: DpmConfig, person: Person, depth: F32) -> NDArray[np.float64]:
    """Parts (P, 3) in the view: u, v (px), and z (m) by the surface at each and by where its type lies from its parent.

    The root's depth is the median of what all parts say of it: an arm may hide the chest. From there outwards the expectation of
    the parent and the surface are weighted by their variances, as in a Kalman filter. A surface that is too far from what is
    expected belongs to another body, an arm before this one or the room, and does not count.
    """
    types, parent, uv = person.placement.types, config.tree.parent, pixels_of(parts, person)
    here = np.arange(len(parent))
    ahead, spread = parts.ahead[here, types].T
    skin, off = parts.skin[here, types].T
    from_root = np.zeros(len(parent))
    for part in here[1:]:
        from_root[part] = from_root[parent[part]] + ahead[part]
    surface = [surface_near(depth, at, z, NEAR_M) for at, z in zip(uv, person.level.z + from_root - skin, strict=True)]
    says = np.array(surface) + skin - from_root
    made, variance = np.full(len(parent), person.level.z), np.zeros(len(parent))
    if np.isfinite(says).any():
        made[0] = np.nanmedian(says)
    variance[0] = _ROOT_M**2
    for part in here:
        if part:
            made[part] = made[parent[part]] + ahead[part]
            variance[part] = variance[parent[part]] + spread[part] ** 2
        reach = _GATE * np.sqrt(variance[part] + off[part] ** 2)
        seen = surface_near(depth, uv[part], made[part] - skin[part], min(reach, OWN_M))
        if np.isfinite(seen):
            gain = variance[part] / (variance[part] + off[part] ** 2)
            made[part] += gain * (seen + skin[part] - made[part])
            variance[part] *= 1.0 - gain
    return np.column_stack((uv, made))


def surface_near(depth: F32, uv: NDArray[np.float64], expected: float, reach: float) -> float:
    """Median (m) of the depths (h, w) around a pixel that are within `reach` of what is expected; NaN where there are none."""
    u, v = np.round(uv).astype(int)
    window = depth[max(v - _WINDOW, 0) : max(v + _WINDOW + 1, 0), max(u - _WINDOW, 0) : max(u + _WINDOW + 1, 0)]
    own = window[(window > 0) & (np.abs(window - expected) <= reach)]
    return float(np.median(own)) if own.size else np.nan


def slots_of(roots: NDArray[np.float64], anchors: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Pairs (person, slot) with the least sum of distances between roots (N, 3) and the slots' anchors (S, 3), NaN = never so."""
    taken = np.flatnonzero(np.isfinite(anchors).all(axis=1))
    if len(anchors) == 1 or not len(roots):
        return [(0, 0)] if len(roots) else []
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - takes longer to import than all else here

    people, columns = linear_sum_assignment(np.linalg.norm(roots[:, None] - anchors[taken], axis=-1))
    return [(int(p), int(taken[c])) for p, c in zip(people, columns, strict=True)]
