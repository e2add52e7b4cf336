"""What a mirror image swaps."""

from __future__ import annotations

import numpy as np

from cabinpose.core.skeleton import ITOP_JOINTS, JOINTS, UPPER_BODY, mirrored
from cabinpose.estimate.mirror import mirrored_joints, mirrored_labels, mirrored_slots
from cabinpose.scene.labels import LABELS


def test_joints_swap_sides() -> None:
    assert mirrored_joints(JOINTS) == mirrored()
    for names in (UPPER_BODY, ITOP_JOINTS):
        other = [names[i] for i in mirrored_joints(names)]
        assert all(a == b or ({a[0], b[0]} == {"l", "r"} and a[1:] == b[1:]) for a, b in zip(names, other, strict=True))
        assert sum(a != b for a, b in zip(names, other, strict=True)) >= 10


def test_places_swap_where_both_are_known() -> None:
    assert mirrored_slots(("driver", "rear_right", "rear_left")) == [0, 2, 1]
    assert mirrored_slots(("driver", "rear_left")) == [0, 1]


def test_classes_swap_sides_and_the_world_stays() -> None:
    table = mirrored_labels()
    assert np.array_equal(table[table], np.arange(256))
    name = {label.id: label.name for label in LABELS}
    for number, own in name.items():
        swapped = own.replace("_left", "_?").replace("_right", "_left").replace("_?", "_right")
        assert name[int(table[number])] == swapped
