"""Lifting: poses from joints, the network's geometry, and a predictor that is lifted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import small
import torch

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError
from cabinpose.core.ports import FrameBatch, PoseBatch, Predictor
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.estimate.augment import AugmentConfig, Mirror
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.data import StoredFrames, collate, mirrored_labels
from cabinpose.estimate.found import mirrored_slots
from cabinpose.estimate.lifter import LiftedPredictor
from cabinpose.estimate.lifting import fit
from cabinpose.estimate.lifting.config import ROOT, LiftingConfig
from cabinpose.estimate.lifting.method import METHOD
from cabinpose.estimate.lifting.model import Lifting
from cabinpose.estimate.predictor import open_model
from cabinpose.estimate.tasks import people_of, vary_people
from cabinpose.estimate.training import TrainConfig, frame_spec

CONFIG = LiftingConfig(**small.TINY["lifting"])
MIRROR = Mirror(
    CABINPOSE.subset(CABINPOSE.sets["upper body"]).mirror,
    mirrored_slots(small.PERSONS),
    torch.from_numpy(mirrored_labels()),
)
STILL = AugmentConfig(shift=0, flip=0)
J = len(CABINPOSE.sets["upper body"])


@pytest.fixture(scope="module")
def batch() -> Batch:
    """Twelve frames, read without an image."""
    bare = small.dataset(12).drop_vars(["depth", "amplitude", "labels"])
    frames = StoredFrames(bare, frame_spec(TrainConfig(method="lifting", settings=small.TINY["lifting"])))
    return collate([frames[i] for i in range(12)])


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def quiet(**changes: float) -> LiftingConfig:
    return CONFIG.model_copy(update={"noise": 0.0, "drop": 0.0, **changes})


def test_people_are_the_datasets_joints(batch: Batch) -> None:
    people = people_of(batch, CONFIG.view)
    data = small.dataset(12).sel(joint=list(CABINPOSE.sets["upper body"]))
    there = data["subject"].values != ""
    joints = data["joints_3d"].values[there]
    np.testing.assert_allclose(people.joints.numpy(), joints, atol=1e-5)
    given = data["visibility"].values[there] > 1
    assert np.array_equal(people.pose[..., 2].numpy() > 0, given)
    expected = joints[..., :2] / joints[..., 2:]
    np.testing.assert_allclose(people.pose[..., :2].numpy()[given], expected[given], atol=1e-5)
    assert (people.pose.numpy()[~given] == 0).all()


def test_nothing_drawn_changes_nothing(batch: Batch) -> None:
    for before, after in zip(
        people_of(batch, CONFIG.view), vary_people(batch, STILL, quiet(), MIRROR, generator=generator()), strict=True
    ):
        torch.testing.assert_close(before, after, atol=2e-5, rtol=1e-5)


def test_moved_people_keep_their_shape_and_their_projection(batch: Batch) -> None:
    before = people_of(batch, CONFIG.view)
    after = vary_people(batch, AugmentConfig(shift=1, flip=0), quiet(), MIRROR, generator=generator())
    torch.testing.assert_close(
        torch.cdist(after.joints, after.joints), torch.cdist(before.joints, before.joints), atol=1e-3, rtol=0
    )
    assert (after.joints - before.joints).norm(dim=-1).max() > 0.05
    xy = after.joints[..., :2] / after.joints[..., 2:]
    given = after.pose[..., 2] > 0
    torch.testing.assert_close(after.pose[..., :2][given], xy[given], atol=1e-5, rtol=1e-5)


def test_a_mirrored_person_is_mirrored_in_space(batch: Batch) -> None:
    before = people_of(batch, CONFIG.view)
    after = vary_people(batch, AugmentConfig(shift=0, flip=1), quiet(), MIRROR, generator=generator())
    places = torch.zeros_like(batch.present, dtype=torch.long) + torch.tensor(mirrored_slots(small.PERSONS))
    whose = torch.arange(len(before.joints)).new_zeros(batch.present.shape)
    whose[batch.present] = torch.arange(len(before.joints))  # of each person who is there, the row
    order = whose.gather(1, places)[batch.present.gather(1, places)]  # in the order of the places in the mirror image
    expected = before.joints[order][:, CABINPOSE.subset(CABINPOSE.sets["upper body"]).mirror] * torch.tensor([-1.0, 1.0, 1.0])
    torch.testing.assert_close(after.joints, expected, atol=2e-5, rtol=1e-5)


def test_noise_and_missing_joints_touch_the_input_alone(batch: Batch) -> None:
    before = people_of(batch, CONFIG.view)
    config = CONFIG.model_copy(update={"noise": 0.02, "drop": 0.6})
    after = vary_people(batch, STILL, config, MIRROR, generator=generator())
    torch.testing.assert_close(after.joints, before.joints, atol=2e-5, rtol=1e-5)
    given, left = before.pose[..., 2] > 0, after.pose[..., 2] > 0
    assert not (left & ~given).any()
    assert 0.15 < 1 - left.sum() / given.sum() < 0.45  # 0.3 are expected
    off = (after.pose[..., :2] - before.pose[..., :2])[left]
    assert 0.004 < off.std() < 0.02  # 0.02 times the root of a third
    assert (after.pose[~left] == 0).all()


def test_the_root_is_at_zero_and_seen_where_it_was_seen() -> None:
    torch.manual_seed(0)
    network = Lifting(CONFIG).eval()
    root = CABINPOSE.sets["upper body"].index(ROOT)
    pose = torch.cat((torch.rand(4, J, 2) - 0.5, torch.ones(4, J, 1)), -1)
    lifted = network(pose)
    assert (lifted.relative[:, root] == 0).all()
    torch.testing.assert_close(lifted.root[:, :2], pose[:, root, :2])
    pose[:, root] = 0
    hidden = network(pose)
    assert (hidden.root[:, :2] - pose[:, root, :2]).abs().min() > 1e-4
    # What a missing joint says must not matter.
    pose[:, root, :2] = 7.0
    torch.testing.assert_close(network(pose).relative, hidden.relative)


def test_decoding_puts_the_body_at_its_root() -> None:
    rng = np.random.default_rng(0)
    relative, root = rng.normal(size=(3, J, 3)), np.array([[0.1, -0.2, 1.5], [0, 0, 1], [0.3, 0.3, 2]])
    pose = np.ones((3, J, 3))
    pose[2, 2:, 2] = 0  # two joints are too few
    joints = METHOD.decode({"relative": relative, "root": root}, CONFIG, {"pose": pose})
    np.testing.assert_allclose(joints[0], relative[0] + (0.15, -0.3, 1.5))
    np.testing.assert_allclose(joints[1], relative[1] + (0, 0, 1))
    assert np.isnan(joints[2]).all()


def test_a_perfect_answer_costs_nothing_and_a_wrong_one_its_square(batch: Batch) -> None:
    people = people_of(batch, CONFIG.view)
    root = CABINPOSE.sets["upper body"].index(ROOT)
    use = people.known[:, root] & (people.pose[..., 2].sum(-1) >= 3)
    joints = people.joints[use]

    class Fixed(torch.nn.Module):
        config, root = CONFIG, CABINPOSE.sets["upper body"].index(ROOT)
        off = 0.0

        def forward(self, pose: torch.Tensor) -> fit.Lifted:
            at = joints[:, root]
            relative = joints - joints[:, root : root + 1] + torch.tensor([self.off, 0, 0])
            return fit.Lifted(relative, torch.cat((at[:, :2] / at[:, 2:], at[:, 2:]), -1))

    network = Fixed()
    assert fit.loss(network, people)["loss"].item() == pytest.approx(0, abs=1e-8)  # type: ignore[arg-type]
    network.off = 0.1
    assert fit.loss(network, people)["relative"].item() == pytest.approx(1.0, rel=1e-4)  # type: ignore[arg-type]


def test_nobody_to_learn_from_costs_nothing(batch: Batch) -> None:
    people = people_of(batch._replace(present=torch.zeros_like(batch.present)), CONFIG.view)
    network = Lifting(CONFIG)
    terms = fit.loss(network, people)
    terms["loss"].backward()
    assert terms["loss"].item() == 0


def test_it_learns(batch: Batch) -> None:
    torch.manual_seed(0)
    network = Lifting(CONFIG.model_copy(update={"width": 48, "dropout": 0.0}))
    optimiser = torch.optim.Adam(network.parameters(), 0.01)
    people = people_of(batch, CONFIG.view)
    first = fit.loss(network, people)["loss"].item()
    for _ in range(80):
        optimiser.zero_grad()
        terms = fit.loss(network, people)
        terms["loss"].backward()
        optimiser.step()
    assert terms["loss"].item() < 0.02 * first


class Base:
    """A predictor that answers with given joints."""

    def __init__(self, found: PoseBatch, joints: tuple[str, ...]) -> None:
        self._found = found
        self.name, self.persons, self.joints = "base", ("driver", "rear_left"), joints

    def predict(self, frames: FrameBatch) -> PoseBatch:
        return self._found


def test_a_lifted_predictor_replaces_3d_joints(trained: dict[str, Path]) -> None:
    lifting = open_model(trained["lifting"], threads=1)
    camera = Camera(64, 48, 51.2, 50.0, 30.0, 25.0, (-0.2, 0.05, 0.0, 0.0, 0.0))
    names = ("lknee", *CABINPOSE.sets["upper body"][::-1])  # another order, and a joint that is not lifted
    rng = np.random.default_rng(4)
    points = rng.uniform((-0.4, -0.3, 1.0), (0.4, 0.3, 1.4), (2, 2, len(names), 3))
    uv = camera.project(points).astype(np.float32)
    presence = np.full(uv.shape[:-1], 0.9, np.float32)
    uv[0, 0, 3] = np.nan
    presence[0, 0, 3] = 0
    presence[1, 0, 5] = 0.2  # not believed, but answered
    presence[1, 1, 2:] = 0.1  # too few are left
    own = points.astype(np.float32)
    base = Base(PoseBatch(uv, own, presence, presence), names)
    predictor = LiftedPredictor(base, lifting)
    assert isinstance(predictor, Predictor)
    frames: FrameBatch = {"depth": np.zeros((2, 48, 64), np.float32), "camera_k": camera.k, "camera_dist": np.array(camera.dist)}
    found = predictor.predict(frames)
    np.testing.assert_array_equal(found.joints_2d, uv)
    np.testing.assert_array_equal(found.joints_3d[:, :, 0], own[:, :, 0])
    directions = points[..., :2] / points[..., 2:]
    directions[presence < 0.5] = np.nan
    ours = [names.index(name) for name in CABINPOSE.sets["upper body"]]
    expected = lifting.lift(directions[:, :, ours].reshape(4, J, 2)).reshape(2, 2, J, 3)
    expected[0, 0, ours.index(3)] = np.nan
    np.testing.assert_allclose(found.joints_3d[:, :, ours], expected, atol=1e-4)
    assert np.isnan(found.joints_3d[1, 1, 1:]).all()
    assert np.isfinite(found.joints_3d[1, 0, 5]).all()
    assert predictor.name == "base+lifting"


def test_nobody_is_lifted_from_nothing(trained: dict[str, Path]) -> None:
    lifting = open_model(trained["lifting"], threads=1)
    assert lifting.lift(np.zeros((0, J, 2))).shape == (0, J, 3)
    assert np.isnan(lifting.lift(np.full((2, J, 2), np.nan))).all()


def test_a_base_without_common_joints_is_refused(trained: dict[str, Path]) -> None:
    empty = np.zeros((0, 2, 1), np.float32)
    base = Base(PoseBatch(empty, empty, empty, empty), ("lknee",))
    with pytest.raises(ConfigError, match="none of the joints"):
        LiftedPredictor(base, open_model(trained["lifting"], threads=1))
