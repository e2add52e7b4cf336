"""Random tree walks against scikit-learn, brute force and closed forms; what a forest finds; damaged forests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small
from numpy.typing import NDArray

from cabinpose._native import walks as native
from cabinpose.core.errors import DatasetError, ModelError
from cabinpose.core.skeleton import CABINPOSE, ITOP, JOINTS
from cabinpose.estimate.array_model import ArrayModel, write_arrays
from cabinpose.estimate.data import Kept, StoredFrames
from cabinpose.estimate.predictor import load_model
from cabinpose.estimate.training import TrainConfig, frame_spec
from cabinpose.estimate.training import fit as train
from cabinpose.estimate.walks.config import WalksConfig
from cabinpose.estimate.walks.find import check, find, walks
from cabinpose.estimate.walks.fit import feature_pool, fit
from cabinpose.evaluate.offline import frame_batch

BINS, REACH = 256, 0.6
VIEW = np.array((50.0, 31.5, 23.5), np.float32)  # focal length, principal point of 64 x 48


def rng(key: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=key))


def feature(depth_m: NDArray[np.float64], point: NDArray[Any], split: NDArray[Any], mirrored: bool = False) -> int:
    """The feature as its definition says it, by numpy."""
    image = depth_m[:, ::-1] if mirrored else depth_m

    def beyond(offset: NDArray[Any]) -> float:
        u, v = np.floor(VIEW[0] * (point[:2] + offset) / point[2] + VIEW[1:] + np.float32(0.5)).astype(int)
        inside = 0 <= v < image.shape[0] and 0 <= u < image.shape[1]
        return float(np.clip(image[v, u] - point[2], -REACH, REACH)) if inside and image[v, u] > 0 else REACH

    first, second = split[:2], split[2:]
    difference = beyond(first) - (0.0 if np.array_equal(first, second) else beyond(second))
    return int(np.clip(np.floor((difference + 2 * REACH) * BINS / (4 * REACH)), 0, BINS - 1))


@pytest.fixture(scope="module")
def problem() -> dict[str, Any]:
    """Samples in three frames of random surfaces, half of them in mirror images, whose targets depend on what is around."""
    random = rng(4)
    depth = random.integers(15000, 25000, (3, 12, 16)).repeat(4, 1).repeat(4, 2).astype(np.uint16)
    depth[random.uniform(size=depth.shape) < 0.1] = 0
    count = 400
    points = np.stack((random.uniform(-1, 1, count), random.uniform(-0.8, 0.8, count), random.uniform(1.5, 2.5, count)), axis=1)
    frame = random.integers(0, 6, count).astype(np.int32)
    pool = feature_pool(24, rng=rng(5))
    points = points.astype(np.float32)
    table = np.array(
        [[feature(depth[f % 3] * 1e-4, p, s, mirrored=f >= 3) for s in pool] for f, p in zip(frame, points, strict=True)]
    )
    targets = np.sign(table[:, [3, 7, 11]] - 128) + random.normal(0.0, 0.3, (count, 3))
    targets = (targets / np.linalg.norm(targets, axis=1, keepdims=True)).astype(np.float32)
    return {"depth": depth, "frame": frame, "points": points, "pool": pool, "table": table, "targets": targets}


def grown(problem: dict[str, Any], *, least: int, deepest: int, most: int = 10_000) -> Any:
    p = problem
    return native.grow(
        p["depth"], VIEW, p["frame"], points=p["points"], targets=p["targets"], pool=p["pool"],
        tried=len(p["pool"]), most=most, least=least, deepest=deepest,
    )  # fmt: skip


def variance_left(targets: NDArray[Any], leaf: NDArray[Any]) -> float:
    return sum(float(((targets[leaf == n] - targets[leaf == n].mean(0)) ** 2).sum()) for n in np.unique(leaf))


def best_split_left(problem: dict[str, Any], least: int) -> float:
    """The variance that the best single split leaves, by trying all."""
    table, targets = problem["table"], problem["targets"]
    sides = [table[:, k] < t for k in range(table.shape[1]) for t in np.unique(table[:, k])]
    return min(variance_left(targets, side) for side in sides if least <= side.sum() <= len(side) - least)


# DecisionTreeRegressor(max_depth, min_samples_leaf, random_state=0) of scikit-learn 1.9 on the same features.
@pytest.mark.parametrize(
    ("least", "deepest", "expected"), [(1, 1, 263.1397), (20, 1, 263.1397), (20, 3, 46.69048), (5, 6, 21.19740)]
)
def test_a_tree_leaves_the_variance_of_scikit_learns(problem: dict[str, Any], least: int, deepest: int, expected: float) -> None:
    *_, leaf = grown(problem, least=least, deepest=deepest)
    assert np.bincount(leaf).min() >= least
    left = variance_left(problem["targets"], leaf)
    assert left == pytest.approx(expected, rel=1e-6)
    if (least, deepest) == (20, 1):
        assert left == pytest.approx(best_split_left(problem, least), rel=1e-6)


def test_a_trees_nodes_lead_its_samples_to_their_leaves(problem: dict[str, Any]) -> None:
    offsets, thresholds, children, leaf = grown(problem, least=5, deepest=8)
    rows = {tuple(split): n for n, split in enumerate(problem["pool"].tolist())}
    for sample in range(len(leaf)):
        node = 0
        while children[node] >= 0:
            right = problem["table"][sample, rows[tuple(offsets[node].tolist())]] >= thresholds[node]
            node = children[node] + int(right)
        assert -1 - children[node] == leaf[sample]
    assert len(np.unique(leaf)) == leaf.max() + 1 == (children < 0).sum()


def test_few_samples_of_a_node_choose_nearly_as_well(problem: dict[str, Any]) -> None:
    *_, all_ = grown(problem, least=20, deepest=3)
    *_, some = grown(problem, least=20, deepest=3, most=150)
    whole = variance_left(problem["targets"], np.zeros(400))
    left, left_some = variance_left(problem["targets"], all_), variance_left(problem["targets"], some)
    assert left != left_some < left + 0.35 * (whole - left)


def clustered() -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Unit directions in a few bunches, and the leaf of each."""
    random, count = rng(6), 300
    targets = np.eye(3)[random.integers(0, 3, count)] * random.choice((-1.0, 1.0), (count, 1)) + random.normal(
        0.0, 0.25, (count, 3)
    )
    return (targets / np.linalg.norm(targets, axis=1, keepdims=True)).astype(np.float32), random.integers(0, 2, count)


def test_clusters_are_about_as_tight_as_scikit_learns() -> None:
    targets, leaf = clustered()
    order = np.argsort(leaf, kind="stable")
    directions, shares = np.zeros((2, 4, 3), np.float32), np.zeros((2, 4), np.float32)
    starts = np.searchsorted(leaf[order], (0, 1, 2))
    native.cluster(targets, order=order, starts=starts, rounds=30, directions=directions, shares=shares)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, atol=1e-5)
    np.testing.assert_allclose(shares[:, -1], 1.0)
    for n, best in enumerate((59.16314, 52.48086)):  # inertia_ of KMeans(4, n_init=20, random_state=0), scikit-learn 1.9
        own = targets[leaf == n]
        nearest = np.linalg.norm(own[:, None] - directions[n], axis=-1).argmin(1)
        tight = sum(((own[nearest == k] - own[nearest == k].mean(0)) ** 2).sum() for k in range(4))
        assert best * 0.999 <= tight < 1.15 * best
        np.testing.assert_allclose(np.diff(shares[n], prepend=0.0) * len(own), np.bincount(nearest, minlength=4), atol=3)


def test_equal_targets_make_one_cluster() -> None:
    targets = np.tile(np.float32((0, 0.6, 0.8)), (5, 1))
    directions, shares = np.zeros((1, 3, 3), np.float32), np.zeros((1, 3), np.float32)
    native.cluster(targets, order=np.arange(5), starts=np.array((0, 5)), rounds=4, directions=directions, shares=shares)
    (one,) = np.flatnonzero(np.diff(shares[0], prepend=0.0))
    np.testing.assert_allclose(directions[0, one], (0, 0.6, 0.8), atol=1e-6)
    assert shares[0, one] == shares[0, -1] == 1.0


def by_hand(**changes: Any) -> dict[str, NDArray[Any]]:
    """Each joint's tree has one node: where the surface is before the point, the walk goes right, else down or up evenly."""
    joints = len(ITOP.joints)
    nodes = 3 * np.arange(joints, dtype=np.int32)
    children = np.stack((nodes + 1, -1 - 2 * np.arange(joints), -2 - 2 * np.arange(joints)), axis=1).ravel().astype(np.int32)
    leaves = np.zeros((2 * joints, 2, 3), np.float32)
    leaves[::2, 0] = leaves[::2, 1] = 1, 0, 0
    leaves[1::2, 0], leaves[1::2, 1] = (0, 1, 0), (0, -1, 0)
    return {
        "starts": np.float32([[0.0, 0.0, 2.0]]), "roots": nodes, "offsets": np.zeros((3 * joints, 4), np.float32),
        "thresholds": np.full(3 * joints, BINS // 2, np.int32), "children": children, "directions": leaves,
        "presence": np.float32([0.75]), "shares": np.tile(np.float32([[0.5, 1.0]]), (2 * joints, 1)),
    } | changes  # fmt: skip


HAND = WalksConfig(
    width=64, height=48, focal=50.0, skeleton="itop", slots=("standing",), clusters=2, steps=8, skipped=2, step_m=0.02
)  # fmt: skip


def test_walks_of_a_tree_made_by_hand() -> None:
    near, far = np.full((48, 64), 1.9, np.float32), np.full((48, 64), 2.1, np.float32)
    far[:] = np.where(np.arange(64) < 40, 1.9, 2.1)  # x is (u - 31.5) z / 50, the step's feature that of pixel round(u)
    places, joints = walks(by_hand(), HAND, np.stack((near, far)))
    steps = 0.02 * np.arange(1, 9)
    assert sorted(j for j, _ in HAND.order) == list(range(15))
    for j, parent in HAND.order:
        begin = 0.0 if parent < 0 else joints[0, 0, parent, 0]
        np.testing.assert_allclose(places[0, 0, j, :, 0], begin + steps, atol=1e-6)
        np.testing.assert_allclose(joints[0, 0, j], (begin + steps[2:].mean(), 0.0, 2.0), atol=1e-6)
    # Beyond the edge walks go up and down, a step at a time, and no farther to the side.
    hand = places[1, 0, ITOP.joints.index("rhand")]
    edge = (40 - 0.5 - 31.5) * 2.0 / 50
    assert hand[-1, 0] < edge + 0.02 + 1e-6
    np.testing.assert_allclose(np.abs(np.diff(hand, axis=0)).sum(1), 0.02, atol=1e-6)
    assert len(np.unique(np.sign(np.diff(hand[:, 1])))) > 1
    again = walks(by_hand(), HAND, np.stack((far, near)))[0]
    np.testing.assert_array_equal(again[::-1], places)  # whatever else is in the batch


def test_walks_follow_the_skeleton() -> None:
    named = {ITOP.joints[j]: ITOP.joints[parent] if parent >= 0 else None for j, parent in WalksConfig(skeleton="itop").order}
    assert list(named)[:4] == ["torso", "neck", "rhip", "lhip"]
    assert named == {
        "torso": None, "neck": "torso", "head": "neck", "rshoulder": "neck", "lshoulder": "neck", "relbow": "rshoulder",
        "lelbow": "lshoulder", "rhand": "relbow", "lhand": "lelbow", "rhip": "torso", "lhip": "torso", "rknee": "rhip",
        "lknee": "lhip", "rfoot": "rknee", "lfoot": "lknee",
    }  # fmt: skip
    ours = WalksConfig().order
    assert {JOINTS[j]: JOINTS[parent] for j, parent in ours if parent >= 0} == CABINPOSE.parent
    for turn, (_, parent) in enumerate(ours):
        assert parent in (-1, *(j for j, _ in ours[:turn]))


def blobs(frames: int, key: int) -> list[Kept]:
    """A ball for each joint of one person, hung one above the other by depth, before a wall; the person moves about."""
    random, settings = rng(key), HAND
    made = []
    v, u = np.mgrid[:48, :64]
    at = np.stack((np.linspace(-0.5, 0.5, 15), 0.3 * np.cos(np.arange(15.0)), 2.0 + 0.15 * np.sin(2.0 * np.arange(15.0))), axis=1)
    for _ in range(frames):
        joints = at + (*random.uniform(-0.2, 0.2, 2), random.uniform(-0.1, 0.1))
        uvz = settings.view.to_view(joints)
        depth = np.full((48, 64), 2.6)
        for x, y, z in uvz:
            depth = np.where((u - x) ** 2 + (v - y) ** 2 < 9, np.minimum(depth, z), depth)
        ticks, none = np.round(depth * 1e4).astype(np.uint16), np.zeros((0, 0), np.uint16)
        visible = np.full((1, 15), 4, np.uint8)
        made.append(Kept(ticks, uvz[None].astype(np.float32), visible, np.array([True]), none, none.astype(np.uint8)))
    return made


LEARNT = HAND.model_copy(
    update={"samples": 20, "features": 60, "leaf_samples": 10, "clusters": 4, "steps": 40, "skipped": 16, "spread_m": 0.2}
)  # fmt: skip
RUN = TrainConfig(method="walks", settings=LEARNT.model_dump(mode="json"), augment={"flip": 0.0})


@pytest.fixture(scope="module")
def forest() -> dict[str, NDArray[Any]]:
    return fit(LEARNT, blobs(60, 1), lambda *_: None, seed=RUN.seed, mirrored=False)


def test_a_forest_finds_people_it_has_not_seen(forest: dict[str, NDArray[Any]]) -> None:
    check(forest, LEARNT)
    unseen = blobs(30, 2)
    depth = np.stack([frame.depth for frame in unseen]).astype(np.float32) * np.float32(1e-4)
    found = find(forest, LEARNT, {"depth": depth})
    truth = LEARNT.view.from_view(np.stack([frame.joints for frame in unseen]))
    error = np.linalg.norm(found.joints_3d - truth, axis=-1)
    still = np.linalg.norm(truth - truth.mean(0), axis=-1)  # of the mean pose
    assert np.median(error) < 0.05 < 0.1 < np.median(still)
    np.testing.assert_allclose(found.uv, LEARNT.view.to_view(found.joints_3d)[..., :2])


def test_the_same_frames_and_seed_give_the_same_bits(forest: dict[str, NDArray[Any]]) -> None:
    few = LEARNT.model_copy(update={"samples": 4})
    one, two = (fit(few, blobs(20, 1), lambda *_: None, seed=RUN.seed, mirrored=False) for _ in range(2))
    other = fit(few, blobs(20, 1), lambda *_: None, seed=2, mirrored=False)
    assert sorted(one) == sorted(forest)
    assert all(one[name].tobytes() == two[name].tobytes() for name in one)
    assert one["offsets"].tobytes() != other["offsets"].tobytes()


def test_mirror_images_teach_the_other_side(forest: dict[str, NDArray[Any]]) -> None:
    both = fit(LEARNT, blobs(60, 1), lambda *_: None, seed=RUN.seed, mirrored=True)
    unseen = blobs(30, 2)
    depth = np.stack([frame.depth for frame in unseen])[:, :, ::-1].astype(np.float32) * np.float32(1e-4)
    truth = LEARNT.view.from_view(np.stack([frame.joints for frame in unseen])) * (-1, 1, 1)
    truth = truth[:, :, ITOP.mirror]
    taught, not_taught = (
        np.median(np.linalg.norm(find(arrays, LEARNT, {"depth": depth}).joints_3d - truth, axis=-1)) for arrays in (both, forest)
    )
    assert taught < 0.06 < 0.12 < not_taught


def test_people_on_several_places(tmp_path: Path) -> None:
    settings = {
        "width": 64,
        "height": 48,
        "focal": 51.2,
        "slots": small.PERSONS,
        "samples": 3,
        "features": 8,
        "steps": 8,
        "skipped": 2,
    }
    config = TrainConfig(method="walks", settings=settings)
    frames = StoredFrames(small.dataset(8), frame_spec(config))
    model = load_model(train(config, frames, frames, tmp_path / "run"))
    found = model.predict(frame_batch(small.dataset(2), slice(None)))
    assert found.joints_3d.shape == (2, 3, 20, 3)
    there = np.mean([[name != "" for name in small.frame(i)["subject"]] for i in range(8)], axis=0)
    inside = model.config.view.camera.contains(model.config.view.camera.project(found.joints_3d.astype(np.float64)))
    np.testing.assert_allclose(found.presence, np.where(inside, there[:, None], 0.0), rtol=1e-6)
    assert inside.any()


def test_nobody_to_learn_from_is_told() -> None:
    nobody = [frame._replace(present=np.array([False])) for frame in blobs(2, 1)]
    with pytest.raises(DatasetError, match="nobody is seen on the place standing") as caught:
        fit(LEARNT, nobody, lambda *_: None, seed=RUN.seed, mirrored=False)
    assert caught.value.hint


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: {"roots": a["roots"][:-1]}, r"roots is int32 \(14,\), not int32 \(15,\)"),
        (lambda a: {"shares": a["shares"][:-1]}, "directions is"),
        (lambda a: {"offsets": a["offsets"].astype(np.float64)}, "offsets is float64"),
        (lambda a: {"starts": a["starts"] * np.nan}, "starts has numbers that are none"),
        (lambda a: {"presence": a["presence"] + 1}, "no probabilities"),
        (lambda a: {"starts": -a["starts"]}, "begin behind the camera"),
        (lambda a: {"children": np.where(a["children"] >= 0, 0, a["children"])}, "lead nowhere"),  # round and round
        (lambda a: {"children": a["children"] * 1000}, "lead nowhere"),
        (lambda a: {"roots": a["roots"] - 1}, "lead nowhere"),
    ],
)
def test_a_damaged_forest_is_told(change: Any, words: str, forest: dict[str, NDArray[Any]], tmp_path: Path) -> None:
    write_arrays(tmp_path / "good.npz", "walks", LEARNT, forest, name="good", card={})
    assert isinstance(load_model(tmp_path / "good.npz").model, ArrayModel)
    write_arrays(tmp_path / "bad.npz", "walks", LEARNT, forest | change(forest), name="bad", card={})
    with pytest.raises(ModelError, match=words) as caught:
        load_model(tmp_path / "bad.npz")
    assert "train it again" in caught.value.hint


def test_steps_that_do_not_count_are_fewer_than_all() -> None:
    with pytest.raises(ValueError, match="skipped has to be less than steps"):
        WalksConfig(steps=10, skipped=10)
