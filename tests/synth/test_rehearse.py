"""Rehearsals go through every kernel and change nothing."""

from __future__ import annotations

import numpy as np
import pytest

from cabinpose.scene.sensor.continuous_wave import collect_phasors
from cabinpose.synth.config import CabinScene, RoomScene, SynthConfig
from cabinpose.synth.rehearse import SHARES, rehearse
from cabinpose.synth.write import frame_maker


@pytest.mark.parametrize("scene", [CabinScene(cars=("sedan",)), RoomScene(rooms=1)], ids=["cabin", "room"])
def test_a_frame_is_the_same_after_a_rehearsal(scene: CabinScene | RoomScene) -> None:
    config = SynthConfig(scene=scene)
    before, _ = frame_maker(config, 3).make(1)
    for share in range(SHARES):
        rehearse(config, 3, share)
    after, _ = frame_maker(config, 3).make(1)
    assert collect_phasors.signatures  # compiled or loaded
    for name, values in before.items():
        np.testing.assert_array_equal(values, after[name], err_msg=name)


def test_what_is_wrong_with_a_configuration_is_left_to_the_frames() -> None:
    config = SynthConfig(scene=CabinScene(cars=("no_such_car.yaml",)))
    for share in range(SHARES):
        rehearse(config, 0, share)
