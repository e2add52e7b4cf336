"""Training of random tree walks: a regression tree a joint, grown on points along the ways that walks will take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import walks as native
from cabinpose.core import DatasetError
from cabinpose.estimate.inputs import Kept
from cabinpose.estimate.methods import Progress
from cabinpose.estimate.walks.config import WalksConfig
from cabinpose.estimate.walks.find import view_of

_POOL = 1 << 16  # features that trees choose from
_FARTHEST_M = 0.6  # greatest offset of a feature
_NEAREST = 0.2  # m: no point of a walk lies nearer to the camera
_ROUNDS = 8  # of k-means


class Grown(NamedTuple):
    """A tree: see `Tree` and `cluster` in `src/native/walks/forest.hpp`."""

    offsets: NDArray[np.float32]
    thresholds: NDArray[np.int32]
    children: NDArray[np.int32]
    directions: NDArray[np.float32]
    shares: NDArray[np.float32]


def fit(
    settings: WalksConfig, frames: Sequence[Kept], progress: Progress, *, seed: int, mirrored: bool
) -> dict[str, NDArray[Any]]:
    """The arrays of a forest, see `find.check`, from training frames in the view; the same frames and seed give the same bits.

    Parameters
    ----------
    settings
        Of the method.
    frames
        To learn from.
    progress
        Called after each tree.
    seed
        Of all randomness.
    mirrored
        Learn from the frames' mirror images, too.

    Raises
    ------
    DatasetError
        Where a place or a joint is never seen.
    """
    kept = [frames[i] for i in range(len(frames))]
    depth = np.stack([frame.depth for frame in kept])
    joints = settings.view.from_view(np.stack([f.joints for f in kept]))
    joints[~(np.stack([f.present for f in kept])[..., None] & (np.stack([f.visibility for f in kept]) > 0))] = np.nan
    lacking = [settings.joints[j] for j in np.flatnonzero(~np.isfinite(joints).any((0, 1, 3)))]
    if 0 < len(lacking) < len(settings.joints):
        raise DatasetError(
            f"nobody's {', '.join(lacking)} is known, and walks go by every joint",
            hint="add frames that show it, set skeleton, or choose another method",
        )
    root = settings.order[0][0]
    for s, slot in enumerate(settings.slots):
        if not np.isfinite(joints[:, s, root]).any():
            raise DatasetError(f"nobody is seen on the place {slot}", hint="choose other slots, or frames with people on them")
    starts = np.nanmean(joints[:, :, root], axis=0)
    begin = np.broadcast_to(starts, (len(kept), *starts.shape))
    if mirrored:
        mirror = np.array([-1.0, 1.0, 1.0])
        # Whose place is whose in a mirror image does not matter here: each person keeps the start of their own.
        joints = np.concatenate((joints, joints[:, :, list(settings.joint_set.mirror)] * mirror))
        begin = np.concatenate((begin, begin * mirror))
    trees: dict[int, Grown] = {}
    for turn, (joint, parent) in enumerate(settings.order):
        rng = np.random.Generator(np.random.Philox(key=(seed, joint)))
        neighbours = [begin if parent < 0 else joints[:, :, parent]]
        neighbours += [joints[:, :, child] for child, its_parent in settings.order if its_parent == joint]
        trees[joint] = _tree(settings, depth, joints[:, :, joint], np.stack(neighbours), rng=rng)
        progress(turn + 1, len(settings.order), f"tree of {settings.joints[joint]}")
    presence = np.mean([frame.present for frame in kept], axis=0)
    forest = _forest([trees[joint] for joint in range(len(settings.joints))])
    return {"starts": starts.astype(np.float32), "presence": presence.astype(np.float32)} | forest


def _tree(
    settings: WalksConfig,
    depth: NDArray[np.uint16],
    joint: NDArray[np.float64],
    neighbours: NDArray[np.float64],
    *,
    rng: np.random.Generator,
) -> Grown:
    """A joint's tree. joint: (N, P, 3) m · neighbours: (K, N, P, 3), before and after it on the walks; 2 N if mirrored too."""
    known = np.isfinite(joint).all(-1) & np.isfinite(neighbours).all((0, -1))
    frame, person = (np.repeat(index, settings.samples) for index in np.nonzero(known))
    count = len(frame), 1
    # Half of the points lie on the ways to neighbours, the others all around: a walk that oversteps the joint has to come back.
    aim, other = joint[frame, person], neighbours[rng.integers(len(neighbours), size=len(frame)), frame, person]
    along = rng.uniform(size=count) * (rng.uniform(size=count) < 0.5)
    spread = settings.spread_m * rng.uniform(size=count) * np.where(along > 0, 0.5, 1.0)
    points = aim + along * (other - aim) + spread * rng.standard_normal((len(frame), 3))
    points[:, 2] = np.maximum(points[:, 2], _NEAREST)
    way = aim - points
    targets = (way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-6)).astype(np.float32)
    offsets, thresholds, children, leaf = native.grow(
        depth, view_of(settings), frame.astype(np.int32),
        points=points.astype(np.float32), targets=targets, pool=feature_pool(_POOL, rng=rng),
        tried=settings.features, most=settings.node_samples, least=settings.leaf_samples, deepest=settings.depth,
    )  # fmt: skip
    order = np.argsort(leaf, kind="stable")
    leaves = int(leaf.max()) + 1
    directions = np.zeros((leaves, settings.clusters, 3), np.float32)
    shares = np.zeros((leaves, settings.clusters), np.float32)
    starts = np.searchsorted(leaf[order], np.arange(leaves + 1))
    native.cluster(targets, order=order, starts=starts, rounds=_ROUNDS, directions=directions, shares=shares)
    return Grown(offsets, thresholds, children, directions, shares)


def feature_pool(count: int, *, rng: np.random.Generator) -> NDArray[np.float32]:
    """(count, 4) two offsets (m) each, evenly spread over directions and lengths; of one in three both are the same."""
    angle, length = rng.uniform(0.0, 2 * np.pi, (count, 2)), rng.uniform(0.0, _FARTHEST_M, (count, 2))
    pool = np.stack((length * np.cos(angle), length * np.sin(angle)), axis=-1)
    pool[::3, 1] = pool[::3, 0]
    return pool.reshape(count, 4).astype(np.float32)


def _forest(trees: Sequence[Grown]) -> dict[str, NDArray[Any]]:
    """The trees of all joints as one: their nodes and leaves numbered through."""
    nodes = np.cumsum([0, *(len(tree.children) for tree in trees)])
    leaves = np.cumsum([0, *(len(tree.shares) for tree in trees)])
    children = [
        np.where(tree.children >= 0, tree.children + node, tree.children - leaf)
        for tree, node, leaf in zip(trees, nodes, leaves, strict=False)
    ]
    return {
        "roots": nodes[:-1].astype(np.int32),
        "children": np.concatenate(children).astype(np.int32),
        **{name: np.concatenate([getattr(t, name) for t in trees]) for name in ("offsets", "thresholds", "directions", "shares")},
    }
