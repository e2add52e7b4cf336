"""Training of the deformable parts: what is measured on the frames, then the structured support vector machine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import DatasetError
from cabinpose.estimate.dpm.config import DpmConfig
from cabinpose.estimate.dpm.find import APART_M, OWN_M, Person, at_roots, detect, pixels_of, surface_near
from cabinpose.estimate.dpm.hog import F32, Level, features, levels
from cabinpose.estimate.dpm.learn import Answer, StructuredSvm, nobody
from cabinpose.estimate.dpm.parts import SPRING, Parts, downward, row_length, rows, unary, upward
from cabinpose.estimate.inputs import TICK_M, Kept
from cabinpose.estimate.methods import Progress

_STIFFNESS = 0.02  # score that a displacement by one spread costs before training
_LEAST_SPREAD = 0.7  # cells
_LEAST_M = 0.01  # of the depths' standard deviations
_ENOUGH = 8  # people, for a type of a part to be measured by itself
_SWEEPS = 10  # over the answers that are known, after each round of searching
_CUT_M = 0.3  # what lies that near to a limb goes where a frame is to show nobody
_ANSWERS = 8  # of each frame that are kept from round to round


class People(NamedTuple):
    """N people of the training frames.

    frame, slot: (N,) · uvz: (N, P, 3) parts in the view, px and m · point: (N, P, 3) the same in the camera frame, m.
    """

    frame: NDArray[np.int64]
    slot: NDArray[np.int64]
    uvz: NDArray[np.float64]
    point: NDArray[np.float64]


class Examples(NamedTuple):
    """The people to learn from, the types (N, P) of their parts, and the levels (N,) of the pyramid that they are on."""

    people: People
    types: NDArray[np.int64]
    level: NDArray[np.int64]


def fit(settings: DpmConfig, frames: Sequence[Kept], progress: Progress, *, seed: int) -> dict[str, NDArray[Any]]:
    """Arrays of a model from frames, see `estimate.methods.ArrayMethod`. Raises DatasetError where nobody is seen."""
    rng = np.random.Generator(np.random.Philox(key=(seed, 0)))
    people = people_of(settings, frames)
    depths = level_depths(settings, people.uvz[:, 0, 2])
    grids = levels(settings, depths)
    level = np.abs(np.log(people.uvz[:, 0, 2, None] / depths)).argmin(axis=1)
    scales = np.array([grid.scale for grid in grids])
    types, anchor, spread = mixtures(settings, people, scales[level], rng=rng)
    slots = np.full((len(settings.slots), 3), np.nan)
    for slot in np.unique(people.slot):
        slots[slot] = people.point[people.slot == slot, 0].mean(axis=0)
    weights = np.zeros((len(anchor), settings.mixtures, row_length(settings)), np.float32)
    weights[1:, :, -settings.mixtures - 4 : -settings.mixtures : 2] = _STIFFNESS / SPRING
    none = np.zeros_like(anchor)
    parts = Parts(weights, anchor, spread, none, none, none, depths, slots)
    trained = _train(parts, settings, frames, Examples(people, types, level), progress, rng=rng)
    trained = measured(trained, settings, frames, people)
    return {name: np.asarray(value, np.float32) for name, value in trained._asdict().items()}


def people_of(settings: DpmConfig, frames: Sequence[Kept]) -> People:
    """The people whose joints are all known and whose root is in the view."""
    frame, slot, points = [], [], []
    for n, kept in enumerate(frames):
        joints = settings.view.from_view(kept.joints)
        for s in np.flatnonzero(kept.present & np.isfinite(joints).all(axis=(1, 2))).tolist():
            frame.append(n)
            slot.append(s)
            points.append(joints[s][settings.tree.ends].mean(axis=1))
    point = np.array(points).reshape(len(points), len(settings.tree.parent), 3)
    uvz = settings.view.to_view(point)
    here = settings.view.camera.contains(uvz[:, 0, :2]) & (uvz[..., 2] > 0).all(axis=1)
    if here.sum() < settings.mixtures:
        raise DatasetError(
            f"{here.sum()} people are seen whole in the training frames", hint="choose other slots, or frames with more people"
        )
    return People(np.array(frame)[here], np.array(slot)[here], uvz[here], point[here])


def level_depths(settings: DpmConfig, z: NDArray[np.float64]) -> NDArray[np.float64]:
    """(L,) m: depths in equal ratios, at most `level_step`, over those of people (N,)."""
    low, high = np.log(np.percentile(z, (0.5, 99.5)))
    count = max(int(np.ceil((high - low) / np.log(settings.level_step))), 1)
    return np.exp(low + (np.arange(count) + 0.5) * (high - low) / count)


def mixtures(
    settings: DpmConfig, people: People, scale: NDArray[np.float64], *, rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Types of the parts: clusters of where they lie from their parents, in space; of the root, of where the trunk's joints do.

    Returns types (N, P), anchor and spread (P, T, 2), see `Parts`; scale: (N,) cells for a pixel of the view.
    """
    from scipy.cluster.vq import kmeans2  # noqa: PLC0415 - takes long to import

    parent = settings.tree.parent
    cell_m = settings.pixel_m * settings.cell_px
    types = np.zeros(people.uvz.shape[:2], np.int64)
    anchor = np.zeros((len(parent), settings.mixtures, 2))
    spread = np.ones((len(parent), settings.mixtures, 2))
    trunk = [p for p, j in zip(settings.tree.joints, settings.joints, strict=True) if j[1:] in ("shoulder", "hip", "pelvis")]
    for part, before in enumerate(parent.tolist()):
        away = (people.uvz[:, part] - people.uvz[:, before]) * np.column_stack((scale, scale, np.ones_like(scale)))
        facing = people.point[:, trunk] - people.point[:, :1]
        space = away * (cell_m, cell_m, 1.0) if part else facing.reshape(len(away), -1)
        types[:, part] = kmeans2(space, settings.mixtures, minit="++", rng=rng, missing="warn")[1]
        if not part:
            continue
        for t in range(settings.mixtures):
            own = away[types[:, part] == t] if (types[:, part] == t).any() else away
            anchor[part, t] = own[:, :2].mean(axis=0)
            spread[part, t] = np.maximum(own[:, :2].std(axis=0), _LEAST_SPREAD)
    return types, anchor, spread


def measured(parts: Parts, settings: DpmConfig, frames: Sequence[Kept], people: People) -> Parts:
    """The model with `shift`, `ahead` and `skin` as they are where it finds the people of the training frames."""
    parent = settings.tree.parent
    found: list[tuple[int, Person]] = []
    for frame in np.unique(people.frame).tolist():
        persons = detect(parts, settings, *_images(frames[frame]))
        roots = np.array([person.level.pixels(person.exact[0]) for person in persons]).reshape(-1, 2)
        for n in np.flatnonzero(people.frame == frame).tolist():
            u, v, z = people.uvz[n, 0]
            away = np.linalg.norm(roots - (u, v), axis=1) * z / settings.view.focal
            if len(away) and away.min() < APART_M:
                found.append((n, persons[int(away.argmin())]))
    if not found:
        raise DatasetError("nobody was learnt from the training frames", hint="train on more frames, or raise `cost` or `rounds`")
    uvz = people.uvz[[n for n, _ in found]]
    types = np.array([person.placement.types for _, person in found])
    shift = np.array([person.level.cells(truth[:, :2]) - person.exact for (_, person), truth in zip(found, uvz, strict=True)])
    across, down = (_by_type(shift[..., axis], types, settings.mixtures)[..., 0] for axis in (0, 1))
    parts = parts._replace(shift=np.stack((across, down), axis=-1))
    surface = np.empty(types.shape)
    for k, (n, person) in enumerate(found):
        depth, _ = _images(frames[int(people.frame[n])])
        surface[k] = [surface_near(depth, uv, z, OWN_M) for uv, z in zip(pixels_of(parts, person), uvz[k, :, 2], strict=True)]
    ahead = uvz[..., 2] - np.where(parent < 0, uvz[..., 2], uvz[:, parent, 2])
    return parts._replace(
        ahead=_by_type(ahead, types, settings.mixtures), skin=_by_type(uvz[..., 2] - surface, types, settings.mixtures)
    )


def _by_type(values: NDArray[np.float64], types: NDArray[np.int64], mixtures: int) -> NDArray[np.float64]:
    """(P, T, 2): median of values (N, P), NaN = unknown, by type (N, P), and standard deviation by the median deviation."""
    made = np.empty((types.shape[1], mixtures, 2))
    for part, t in np.ndindex(made.shape[:2]):
        known = np.isfinite(values[:, part])
        own = values[known & (types[:, part] == t), part]
        own = own if len(own) >= _ENOUGH else values[known, part]
        middle = np.median(own) if len(own) else 0.0
        off = 1.4826 * np.median(np.abs(own - middle)) if len(own) else OWN_M
        made[part, t] = middle, max(off, _LEAST_M)
    return made


def _images(kept: Kept) -> tuple[F32, F32 | None]:
    """Depth (m) and, where there is one, amplitude of a frame."""
    return kept.depth * np.float32(TICK_M), kept.amplitude.astype(np.float32) if kept.amplitude.size else None


def without_people(settings: DpmConfig, depth: F32, point: NDArray[np.float64]) -> F32:
    """A depth image (h, w) with holes where it shows what is near to the limbs of people, parts (N, P, 3) in the camera frame."""
    v, u = np.nonzero(depth)
    seen = settings.view.from_view(np.column_stack((u, v, depth[v, u])))
    near = np.zeros(len(seen), bool)
    for body in point:
        for end, limb in zip(body[settings.tree.parent[1:]], body[1:] - body[settings.tree.parent[1:]], strict=True):
            share = np.clip((seen - end) @ limb / max(limb @ limb, 1e-9), 0.0, 1.0)
            near |= np.square(seen - end - share[:, None] * limb).sum(-1) < _CUT_M**2
    made = depth.copy()
    made[v[near], u[near]] = 0.0
    return made


def _train(
    parts: Parts, settings: DpmConfig, frames: Sequence[Kept], examples: Examples, progress: Progress, *, rng: np.random.Generator
) -> Parts:
    """The model with weights from rounds of searching each frame for the worst answer, and learning from all of them."""
    people, types, level = examples
    grids = levels(settings, parts.levels)
    count = len(people.frame)
    # Examples beyond the people are frames without anybody. With one slot its people are cut out of them. With more, a second
    # person must not be found on the first: people stay, and their own roots do not count.
    empty = rng.permutation(np.unique(people.frame))[: round(settings.negatives * count)]
    frame_of = np.concatenate((people.frame, empty))
    cut = len(settings.slots) == 1

    def images(example: int) -> tuple[F32, F32 | None]:
        depth, amplitude = _images(frames[int(frame_of[example])])
        if cut and example >= count:
            depth = without_people(settings, depth, people.point[people.frame == frame_of[example]])
            amplitude = None if amplitude is None else np.where(depth > 0, amplitude, np.float32(0))
        return depth, amplitude

    def others(example: int) -> NDArray[np.float64]:
        there = (people.frame == frame_of[example]) & (np.arange(count) != example)
        return people.uvz[there & (not cut), 0]

    def truth(example: int) -> Answer:
        grid = grids[level[example]]
        positions = _on_grid(grid, people.uvz[example])
        cells = features(settings, grid, *images(example))
        return Answer(types[example], rows(parts, settings, cells, positions, types[example]).astype(np.float16), 0.0)

    truths = [truth(n) for n in range(count)] + [nobody(0.0)] * len(empty)
    svm = StructuredSvm(parts.weights, truths, settings.cost / len(truths))
    done, total = 0, settings.rounds * len(truths)
    for round_ in range(settings.rounds):
        for example in rng.permutation(len(truths)).tolist():
            parts = parts._replace(weights=svm.weights.astype(np.float32))
            person = people.uvz[example] if example < count else None
            svm.add(example, _worst(parts, settings, *images(example), person, others(example)))
            done += 1
            progress(done, total, f"round {round_ + 1} of {settings.rounds}")
        for _ in range(_SWEEPS):
            svm.sweep(rng.permutation(len(truths)))
        svm.forget(_ANSWERS)
    return parts._replace(weights=svm.weights.astype(np.float32))


def _on_grid(grid: Level, uvz: NDArray[np.float64]) -> NDArray[np.int64]:
    """The cells (P, 2) nearest to parts, of those that the grid has."""
    return np.clip(np.round(grid.cells(uvz[:, :2])).astype(np.int64), 0, (grid.columns - 1, grid.rows - 1))


def _worst(
    parts: Parts, settings: DpmConfig, depth: F32, amplitude: F32 | None,
    person: NDArray[np.float64] | None, others: NDArray[np.float64],
) -> Answer:  # fmt: skip
    """The answer to a frame with the greatest sum of loss and score, none with a root beside one of `others` (N, 3)."""
    cell_m = settings.pixel_m * settings.cell_px
    parent = settings.tree.parent
    worst, value = nobody(0.0 if person is None else 1.0), 0.0 if person is None else 1.0
    for grid in levels(settings, parts.levels):
        if person is not None and abs(np.log(grid.z / person[0, 2])) > 1.5 * np.log(settings.level_step):
            continue  # the surface is nowhere near
        cells = features(settings, grid, depth, amplitude)
        scores = unary(parts, settings, cells)
        losses = np.full((len(parent), grid.rows, grid.columns), 1.0 / len(parent), np.float32)
        if person is not None:
            for part, (x, y) in enumerate(_on_grid(grid, person)):
                away = np.hypot(np.arange(grid.rows)[:, None] - y, np.arange(grid.columns) - x) * cell_m
                losses[part] *= np.minimum(away / settings.loss_m, 1.0)
        beliefs = upward(parts, parent, scores + losses[:, None])
        roots = at_roots(settings, cells, beliefs.belief[0])
        for x, y in grid.cells(others[:, :2]):
            away = np.hypot(np.arange(grid.rows)[:, None] - y, np.arange(grid.columns) - x) * cell_m
            roots[:, away < APART_M] = -np.inf
        at = np.unravel_index(np.argmax(roots), roots.shape)
        if roots[at] > value:
            value = float(roots[at])
            placed = downward(beliefs, parent, (int(at[0]), int(at[1]), int(at[2])))
            loss = float(losses[np.arange(len(parent)), placed.positions[:, 1], placed.positions[:, 0]].sum())
            worst = Answer(placed.types, rows(parts, settings, cells, placed.positions, placed.types), loss)
    return worst
