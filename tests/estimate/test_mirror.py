"""What a mirror image swaps."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from cabinpose.estimate.compact.config import CompactConfig
from cabinpose.estimate.compact.model import Mirrored, Votes
from cabinpose.estimate.data import mirrored_labels
from cabinpose.estimate.found import front_exchanged, mirrored_slots
from cabinpose.scene.labels import LABELS


def test_places_swap_where_both_are_known() -> None:
    assert mirrored_slots(("driver", "rear_right", "rear_left")) == [0, 2, 1]
    assert mirrored_slots(("driver", "rear_left")) == [0, 1]
    assert mirrored_slots(("driver", "front_passenger", "rear_left")) == [1, 0, 2]
    assert mirrored_slots(("driver", "front_passenger", "rear_left", "rear_right"), at_wheel=True) == [0, 1, 3, 2]


def test_the_front_row_is_exchanged_where_both_are_known() -> None:
    assert front_exchanged(("rear_left", "front_passenger", "driver")) == [0, 2, 1]
    assert front_exchanged(("driver", "rear_left", "rear_right")) == [0, 1, 2]
    assert front_exchanged(("standing",)) == [0]


class _Drawn(nn.Module):
    """Answers with who sits where in frames that say it in their corners, and with the wheel on the side of the brighter one."""

    config = CompactConfig(width=96, height=96, focal=100.0, slots=("driver", "front_passenger"))
    u = torch.tensor([20.0, 61.0])

    def forward(self, depth: Tensor, amplitude: Tensor | None = None) -> Votes:
        mirror = depth[:, 0, 0] == 0  # the mirror image has them at the other end
        there = torch.where(mirror[:, None], depth[:, 1, -2:], depth[:, 1, :2])  # the one at the left comes first
        u = torch.where(mirror[:, None], 95 - self.u.flip(-1), self.u)
        uvz = torch.stack((u, torch.full_like(u, 40.0), torch.ones_like(u)), -1)[:, :, None].expand(-1, -1, 20, -1)
        some = torch.zeros(uvz.shape[:3])
        wheel = 3 * depth[:, 2, 0] - 3 * depth[:, 2, -1]
        return Votes(uvz, some, some, 8 * there - 4, wheel, torch.zeros(*some.shape, 1), torch.zeros(1), ())


def test_a_mirror_image_changes_places_and_the_side_of_the_wheel() -> None:
    depth = torch.zeros(6, 96, 96)
    depth[:, 0, 0] = 1.0
    depth[:, 1, :2] = torch.tensor([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]).repeat_interleave(2, 0)
    depth[:, 2, 0], depth[:, 2, -1] = torch.tensor([1.0, 0.0]).repeat(3), torch.tensor([0.0, 1.0]).repeat(3)
    network = _Drawn()
    alone, both = network(depth), Mirrored(network)(depth)  # type: ignore[arg-type]
    torch.testing.assert_close(both.joints, alone.joints)
    torch.testing.assert_close(both.present, alone.present)
    torch.testing.assert_close(both.wheel, alone.wheel)
    assert both.wheel.tolist() == [3.0, -3.0] * 3
    assert both.spreads[..., -1].abs().max() < 1e-4


def test_classes_swap_sides_and_the_world_stays() -> None:
    table = mirrored_labels()
    assert np.array_equal(table[table], np.arange(256))
    name = {label.id: label.name for label in LABELS}
    for number, own in name.items():
        swapped = own.replace("_left", "_?").replace("_right", "_left").replace("_?", "_right")
        assert name[int(table[number])] == swapped
