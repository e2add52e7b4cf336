"""What a mirror image swaps."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from cabinpose.estimate.augment import mirrored_labels, mirrored_slots
from cabinpose.estimate.compact.config import CompactConfig
from cabinpose.estimate.compact.model import Mirrored, Votes
from cabinpose.scene.labels import LABELS


def test_places_swap_where_both_are_known() -> None:
    assert mirrored_slots(("driver", "rear_right", "rear_left")) == [0, 2, 1]
    assert mirrored_slots(("driver", "rear_left")) == [0, 1]
    assert mirrored_slots(("driver", "front_passenger", "rear_left"), facing=True) == [1, 0, 2]


class _Drawn(nn.Module):
    """Answers with who sits where in frames that say it in their corners: 1 for a car, 2 for a bench that looks backwards."""

    config = CompactConfig(width=96, height=96, focal=100.0, slots=("driver", "front_passenger"))
    u = torch.tensor([20.0, 61.0])

    def forward(self, depth: Tensor, amplitude: Tensor | None = None) -> Votes:
        code, there = depth[:, 0, 0], depth[:, 1, :2]  # the mirror image has them at the other end
        mirror = code == 0
        code, there = torch.where(mirror, depth[:, 0, -1], code), torch.where(mirror[:, None], depth[:, 1, -2:].flip(-1), there)
        u = torch.where(mirror[:, None], 95 - self.u, self.u)
        swapped = (mirror & (code == 2))[:, None]
        u, there = torch.where(swapped, u.flip(-1), u), torch.where(swapped, there.flip(-1), there)
        uvz = torch.stack((u, torch.full_like(u, 40.0), torch.ones_like(u)), -1)[:, :, None].expand(-1, -1, 20, -1)
        some = torch.zeros(uvz.shape[:3])
        return Votes(uvz, some, some, 8 * there - 4, torch.zeros(*some.shape, 1), torch.zeros(1), ())


def test_a_mirror_image_of_a_bench_that_looks_backwards_changes_the_front_places() -> None:
    depth = torch.zeros(6, 96, 96)
    depth[:, 0, 0] = torch.tensor([1.0, 2.0]).repeat(3)
    depth[:, 1, :2] = torch.tensor([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]).repeat_interleave(2, 0)
    network = _Drawn()
    alone, both = network(depth), Mirrored(network)(depth)  # type: ignore[arg-type]
    torch.testing.assert_close(both.joints, alone.joints)
    torch.testing.assert_close(both.present, alone.present)
    assert both.spreads[..., -1].abs().max() < 1e-4


def test_where_nobody_sits_rounding_decides_nothing() -> None:
    """Places whose order fits as badly as the other by less than what rounding may do stay as they are."""
    network, slots = _Drawn(), torch.zeros(1, 2)
    some = torch.zeros(1, 2, 20)

    def votes(present: list[float]) -> Votes:
        return Votes(torch.zeros(1, 2, 20, 3), some, some, slots + torch.tensor(present), some[..., None], some, ())

    mirrored = Mirrored(network)  # type: ignore[arg-type]
    assert not mirrored._turned(votes([-9.0, -6.0]), votes([-6.0, -9.0])).item()  # 0.002 and 0.0001
    assert mirrored._turned(votes([-9.0, 6.0]), votes([6.0, -9.0])).item()


def test_classes_swap_sides_and_the_world_stays() -> None:
    table = mirrored_labels()
    assert np.array_equal(table[table], np.arange(256))
    name = {label.id: label.name for label in LABELS}
    for number, own in name.items():
        swapped = own.replace("_left", "_?").replace("_right", "_left").replace("_?", "_right")
        assert name[int(table[number])] == swapped
