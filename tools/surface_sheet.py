"""Colour, amplitude and depth of generated frames in which the first two disagree: `surface_sheet.py OUT.webp [--frames N]`.

Of the first N frames those in which a plain top is black to the eye and bright in near infrared, or is dark there alone;
nobody twice. With `--sun` one scene in place of them: sunlight from three sides, amplitude, and depth without and with it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from cabinpose.app.view.draw import depth_image
from cabinpose.core import OCCUPANT_SLOTS, Bytes, Floats32
from cabinpose.scene.sensor import GeometryBuffers, NoiseEffect, Sensor, SensorFrame
from cabinpose.store import AXES
from cabinpose.synth import FrameMaker, SynthConfig
from cabinpose.synth.person_look import look_of
from cabinpose.synth.sunlight import Sunlight

SEED, EACH = 22, 2
ASKED = {
    "scene": {"occupancy": {"driver": 1.0, "front_passenger": 1.0}},
    "people": {"subjects": (), "random": {"count": 200}},
    "camera": {"sensor": "pico_monstar_105/4", "views": {"front_row": 1.0}},
    "images": {"variables": ["rgb"], "renderer": "raster", "light": "day"},
}
SUN_SEED, SUN_FRAME, SUNS = 3, 1, ((90, 30), (45, 30), (0, 20))  # degrees to the left of ahead, and high
BRIGHTEST = 20.0  # of sunlight in the sheet, in the camera's own light at 1 m
BLACK, COLOURED, BRIGHT, DARK = 0.025, 0.04, 0.45, 0.12  # luminances; reflectances in near infrared


def grey(amplitude: np.ndarray) -> Bytes:
    """(H, W, 3): the root of an amplitude, so that what is dark is seen."""
    level = np.sqrt(np.clip(amplitude / np.percentile(amplitude, 97), 0, 1))
    return np.repeat((255 * level).astype(np.uint8)[..., None], 3, axis=-1)


class _Light(NoiseEffect):
    """Keeps the sunlight of the views that it is shown."""

    kind: str = "light"

    def apply(self, frame: SensorFrame, buffers: GeometryBuffers, sensor: Sensor, *, rng: np.random.Generator) -> None:
        """Leaves the frame as it is."""
        del frame, sensor, rng
        if buffers.sunlight is not None:
            KEPT.append(buffers.sunlight)


KEPT: list[Floats32] = []


def sunlit_rows() -> list[Bytes]:
    """Sunlight, amplitude, depth without and depth with it, a row for each of `SUNS`."""
    plain = SynthConfig.load(None, ["scene.cars=[sedan]"])
    without, _ = FrameMaker(plain, SUN_SEED).make(SUN_FRAME)
    rows = []
    for towards in SUNS:
        lit = plain.model_copy(
            update={
                "sunlight": Sunlight(towards_deg=towards, clear=1.0),
                "noise": plain.noise.model_copy(update={"effects": (_Light(),)}),
            }
        )
        frame, _ = FrameMaker(lit, SUN_SEED).make(SUN_FRAME)
        level = np.clip(255 * KEPT.pop() / BRIGHTEST, 0, 255).astype(np.uint8)
        depths = (depth_image(f["depth"], 0.3, 2.0) for f in (without, frame))
        rows.append(np.concatenate((np.repeat(level[..., None], 3, axis=-1), grey(frame["amplitude"]), *depths), axis=1))
    return rows


def main() -> None:
    """Draw the sheet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--sun", action="store_true")
    told = parser.parse_args()
    if told.sun:
        Image.fromarray(np.concatenate(sunlit_rows())).save(told.out, quality=70)
        return
    config = SynthConfig.parse(ASKED)
    maker, drawn = FrameMaker(config, SEED), FrameMaker(config, SEED, pictures=False)
    shown: dict[str, list[Bytes]] = {"black to the eye and bright": [], "dark alone in near infrared": []}
    known: set[str] = set()
    for index in range(told.frames):
        frame, scene = drawn.make(index)
        for who in scene.people:
            near = float(frame["reflectance"][OCCUPANT_SLOTS.index(who.slot), AXES["worn"].index("top")])
            look = look_of(who.person, SEED, who.subject)
            seen, kinds = float(look.colours["top"] @ (0.2126, 0.7152, 0.0722)), [*shown]
            kind = kinds[0] if seen < BLACK and near > BRIGHT else kinds[1] if seen > COLOURED and near < DARK else ""
            if kind and len(shown[kind]) < EACH and not look.patterns["top"] and who.subject not in known:
                known.add(who.subject)
                print(f"frame {index}: top of {who.slot} {kind}: {seen:.2f} to the eye, {near:.2f} in near infrared")
                pictured, _ = maker.make(index)
                images = pictured["rgb"], grey(pictured["amplitude"]), depth_image(pictured["depth"], 0.3, 2.0)
                shown[kind].append(np.concatenate(images, axis=1))
                break
    Image.fromarray(np.concatenate([row for rows in shown.values() for row in rows])).save(told.out, quality=70)


if __name__ == "__main__":
    main()
