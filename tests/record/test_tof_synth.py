"""The generator as a camera: its frames are those of the dataset with the same seed."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from cabinpose.app.live_camera import SynthCameraSettings, SynthCameraSource
from cabinpose.core.errors import CabinposeError
from cabinpose.record.emulate.tof import TofFaults
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import ToFFrame
from cabinpose.synth import FrameMaker
from cabinpose.synth.config import SynthConfig

SCENES = {
    "scene": {"kind": "room", "rooms": 1},
    "people": {"subjects": ["S01"]},
    "camera": {"sensor": "pico_monstar_105/5", "views": {"room": 1.0}},
}


@pytest.mark.slow
def test_the_camera_sees_what_the_generator_makes(tmp_path: Path) -> None:
    path = tmp_path / "room.yaml"
    path.write_text(yaml.safe_dump(SCENES))
    settings = SynthCameraSettings(scenes=path, seed=3, faults=TofFaults(rate_hz=20))
    source = SynthCameraSource("tof", settings, HostClock())
    assert source.check() == []
    source.open()
    frames: list[ToFFrame] = []
    end = time.monotonic() + 200
    while len(frames) < 2:
        assert time.monotonic() < end
        frames += [m for s in source.read(0.5) for m in s.messages if isinstance(m, ToFFrame)]
    source.close()
    maker = FrameMaker(SynthConfig.load(path), 3)
    for index, frame in enumerate(frames[:2]):
        true = maker.make(index)[0]
        np.testing.assert_allclose(frame.depth * frame.depth_unit_m, np.nan_to_num(true["depth"]), atol=6e-5)
        np.testing.assert_array_equal(frame.amplitude, true["amplitude"])
        np.testing.assert_array_equal(frame.camera_k, true["camera_k"])


def test_scenes_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    source = SynthCameraSource("tof", SynthCameraSettings(scenes=tmp_path / "nowhere.yaml"), HostClock())
    assert "nowhere.yaml" in source.check()[0]
    with pytest.raises(CabinposeError):
        source.open()
