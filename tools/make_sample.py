"""The dataset that comes with the package (`cabinpose.sample()`): 20 frames of drivers and front passengers.

    python tools/make_sample.py src/cabinpose/app/sample

The named people in the two cars that training of the packaged models never saw, from both views. The sensor is a Monstar whose
pixels are added up two by two: a quarter of the bytes, and still as many pixels as the packaged models look at.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from cabinpose.scene.sensor import Sensor
from cabinpose.synth import SynthConfig, generate

FRAMES, SEED = 20, 34
SCENE = Path(__file__).parents[1] / "docs" / "models" / "in-car-test-scenes.yaml"
OVERRIDES = (
    "scene.occupancy={driver: 1, front_passenger: 1}",
    "output.drive_side=true",
    f"output.frames_per_part={FRAMES}",
)


def binned(sensor: Sensor) -> Sensor:
    """A sensor that adds up its pixels two by two: charges of four taps, read as often, in one."""
    lens = sensor.camera
    camera = replace(
        lens, width=lens.width // 2, height=lens.height // 2, fx=lens.fx / 2, fy=lens.fy / 2,
        cx=(lens.cx + 0.5) / 2 - 0.5, cy=(lens.cy + 0.5) / 2 - 0.5,
    )  # fmt: skip
    return sensor.model_copy(
        update={
            "name": f"{sensor.name}, binned 2x2",
            "camera": camera,
            "signal_e_per_s": 4 * sensor.signal_e_per_s,
            "full_well_e": 4 * sensor.full_well_e,
            "read_noise_e": 2 * sensor.read_noise_e,
            "min_amplitude_e": 2 * sensor.min_amplitude_e,
            "field_radius_px": None if sensor.field_radius_px is None else sensor.field_radius_px / 2,
        }
    )


def sample_config() -> SynthConfig:
    """What the frames are made by."""
    config = SynthConfig.load(SCENE, OVERRIDES)
    camera = config.camera.model_copy(update={"sensor": binned(config.camera.sensor_model)})
    return config.model_copy(update={"camera": camera})


def main() -> None:
    """Write the dataset, over the one that is there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    generate(sample_config(), FRAMES, parser.parse_args().out, seed=SEED, existing="overwrite")


if __name__ == "__main__":
    main()
