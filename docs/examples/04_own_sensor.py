"""A camera of your own, and the effects of the physical noise model one by one, on the same scene.

A sensor is intrinsics, ranges, timing and the figures of its pixels. The scene is rendered once; the sensor is simulated
with and without each effect, and the depth is held against the geometry.
"""

from __future__ import annotations

from math import radians

import numpy as np

from cabinpose.core import Camera, invert
from cabinpose.scene.sensor import NO_EFFECTS, PhysicalNoise, Sensor, simulate
from cabinpose.synth import CabinScene, SceneSampler, SynthConfig, frame_rng
from cabinpose.synth.render import Rasteriser

SEED = 3
OWN = Sensor(
    name="my_camera",
    camera=Camera.from_fov(240, 180, radians(95)),
    range_m=(0.2, 2.0),
    integration_s=500e-6,
    fps=30,
    frequencies_hz=(60e6,),
)


def main() -> None:
    config = SynthConfig(scene=CabinScene(cars=("hatchback",)))
    rng = frame_rng(SEED, 0)
    scene = SceneSampler(config, SEED).sample(0, rng=rng)
    rendered = Rasteriser(OWN.camera, supersample=3).render(scene.surface(), invert(scene.world_from_camera))

    truth = np.where(rendered.depth_clean > 0, rendered.depth_clean, np.nan)
    for name, noise in (("no effects", NO_EFFECTS), ("all effects", PhysicalNoise())):
        frame = simulate(rendered.buffers, OWN, noise, rng=frame_rng(SEED, 1))
        error_mm = 1000 * (frame.depth_m - truth)
        middle = np.nanmedian(np.abs(error_mm))
        print(f"{name:>12}: {np.isfinite(frame.depth_m).mean():4.0%} valid, median error {middle:5.2f} mm")


if __name__ == "__main__":
    main()
