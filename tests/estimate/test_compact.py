"""The compact detector's second looks: where they sample, that they begin as nothing, and that they learn to mend."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates
from small import PERSONS, TINY

from cabinpose.core.errors import ModelError
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.compact.config import CompactConfig
from cabinpose.estimate.compact.fit import loss
from cabinpose.estimate.compact.model import Compact
from cabinpose.estimate.compact.refine import Refine, sampled
from cabinpose.estimate.training import Detector, TrainConfig, begin_with, read_checkpoint

VIEW = torch.tensor((64.0, 48.0))


@pytest.mark.parametrize("stride", [1, 4])
def test_samples_lie_where_scipy_finds_them(stride: int) -> None:
    """A map of every `stride`-th pixel covers the view: its first cell's middle lies between the pixels it stands for."""
    rng = np.random.default_rng(0)
    image = rng.random((3, 48 // stride, 64 // stride), dtype=np.float32)
    uv = rng.uniform((8, 8), (56, 40), size=(5, 7, 2)).astype(np.float32)
    got = sampled(torch.from_numpy(image)[None], torch.from_numpy(uv)[None], VIEW)[0].numpy()
    at = (uv + 0.5) / stride - 0.5
    wanted = [map_coordinates(channel, (at[..., 1], at[..., 0]), order=1) for channel in image]
    np.testing.assert_allclose(got, wanted, atol=1e-4)


def test_depths_are_those_of_the_nearest_pixel() -> None:
    image = torch.arange(48 * 64, dtype=torch.float32).reshape(1, 1, 48, 64)
    uv = torch.tensor([[[[10.4, 20.3], [9.6, 19.8], [0.0, 0.0], [63.0, 47.0], [-3.0, 5.0], [64.2, 5.0]]]])
    got = sampled(image, uv, VIEW, mode="nearest").flatten().tolist()
    assert got == [20 * 64 + 10, 20 * 64 + 10, 0, 47 * 64 + 63, 0, 0]


def network(**values: Any) -> Compact:
    torch.manual_seed(0)
    return Compact(CompactConfig.model_validate({**TINY["compact"], **values})).eval()


def test_looks_that_have_learnt_nothing_change_nothing() -> None:
    compact = network()
    assert len(compact.looks) == 2
    depth = 0.5 + torch.rand((2, 48, 64))
    votes = compact(depth, 100 * torch.rand((2, 48, 64)))
    assert len(votes.earlier) == 2
    for earlier in votes.earlier:
        torch.testing.assert_close(votes.joints, earlier, rtol=0, atol=0)


def test_a_network_may_do_without_looks() -> None:
    compact = network(looks_px=())
    votes = compact(0.5 + torch.rand((2, 48, 64)), 100 * torch.rand((2, 48, 64)))
    assert not votes.earlier
    terms = loss(compact, batch_of(2))
    assert "earlier_image" not in terms
    assert torch.isfinite(terms["loss"])


def batch_of(n: int) -> Batch:
    generator = torch.Generator().manual_seed(1)
    joints = torch.rand((n, len(PERSONS), 20, 3), generator=generator) * torch.tensor((64.0, 48.0, 1.0)) + 0.3
    return Batch(
        0.5 + torch.rand((n, 48, 64), generator=generator), joints, torch.full((n, len(PERSONS), 20), 4),
        torch.ones((n, len(PERSONS)), dtype=torch.bool), 100 * torch.rand((n, 48, 64), generator=generator), None,
    )  # fmt: skip


def test_the_votes_learn_from_where_they_fell_alone() -> None:
    """What the looks say of the joints does not reach the backbone's votes; the looks learn from the last joints."""
    compact = network().train()
    terms = loss(compact, batch_of(4))
    terms["image"].backward(retain_graph=True)
    assert compact.looks[1].say.grad is not None
    assert compact.looks[1].say.grad.abs().sum() > 0
    assert compact.looks[0].say.grad is None  # each mends what the one before has left
    assert compact.votes.weight.grad is None
    terms["earlier_image"].backward()
    assert compact.looks[0].say.grad is not None
    assert compact.votes.weight.grad is not None


@pytest.mark.slow
def test_a_look_learns_to_find_the_spike_beside_the_vote() -> None:
    """A joint is a near spot in a far wall, and the vote up to 6 px beside it: depths alone have to show where."""
    torch.manual_seed(0)
    size, pitch = (64, 48), 3.0
    look = Refine(size, 1, 1, 2, 2, pitch)
    optimiser = torch.optim.Adam(look.parameters(), 3e-3)
    rows, columns = torch.meshgrid(torch.arange(48), torch.arange(64), indexing="ij")
    errors = []
    for _ in range(250):
        true = torch.rand((64, 1, 1, 2)) * torch.tensor((40.0, 24.0)) + 12
        square = (columns - true[:, 0, 0, 0, None, None]) ** 2 + (rows - true[:, 0, 0, 1, None, None]) ** 2
        depth = torch.where(square < 16, 1.0, 1.2).unsqueeze(1)
        vote = true + 6 * (2 * torch.rand(true.shape) - 1)
        uvz = torch.cat((vote, torch.full_like(vote[..., :1], 1.05)), dim=-1)
        nothing = torch.zeros((64, 2, 12, 16))
        more = look(depth, nothing, nothing, uvz, torch.zeros((64, 1, 1)), torch.zeros((64, 1, 1)))
        error = (uvz + more.joints)[..., :2] - true
        depth_error = (uvz + more.joints)[..., 2] - 1.1  # the middle of the body lies behind its skin
        value = error.abs().mean() + 10 * depth_error.abs().mean()
        optimiser.zero_grad()
        value.backward()
        optimiser.step()
        errors.append((error.norm(dim=-1).mean().item(), depth_error.abs().mean().item()))
    first, last = np.array(errors[0]), np.mean(errors[-10:], axis=0)
    assert first[0] > 4.0
    assert last[0] < 1.3
    assert last[1] < 0.25 * first[1]


def test_a_run_with_looks_begins_with_a_checkpoint_without(checkpoints: dict[str, Path], tmp_path: Path) -> None:
    """The parts that are new keep their own weights; the other way round is another network."""
    data = torch.load(checkpoints["compact"], map_location="cpu", weights_only=False)
    plain = tmp_path / "plain.ckpt"
    settings = {**data["hyper_parameters"]["config"]["settings"], "looks_px": ()}
    data["hyper_parameters"]["config"]["settings"] = settings
    data["state_dict"] = {name: value for name, value in data["state_dict"].items() if ".looks." not in name}
    torch.save(data, plain)
    detector = Detector(TrainConfig.model_validate(read_checkpoint(checkpoints["compact"])["config"]))
    fresh = detector.network.looks[0].embed.detach().clone()
    begin_with(detector, plain, [])
    torch.testing.assert_close(detector.network.looks[0].embed, fresh)
    torch.testing.assert_close(detector.network.votes.weight, data["state_dict"]["network.votes.weight"])
    with pytest.raises(ModelError, match="another network"):
        begin_with(Detector(TrainConfig.model_validate(read_checkpoint(plain)["config"])), checkpoints["compact"], [])
