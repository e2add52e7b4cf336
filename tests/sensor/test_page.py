"""docs/sensor-model.md: its tables are what the sensors and their model give."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from cabinpose.scene import DYES, GLAZING, HAIR, MATERIAL_ID, MATERIALS, SKIN
from cabinpose.scene.sensor import SENSORS, GeometryBuffers, PhysicalNoise, simulate

DOCS = Path(__file__).resolve().parents[2] / "docs"
SPEED_OF_LIGHT = 299_792_458.0
*_, MONSTAR, OTHERS = (
    table["rows"] for table in json.loads((DOCS / "figures" / "sensor-model.json").read_text("utf-8"))["tables"]
)


def sigma_mm(name: str, z_m: float, frames: int = 25) -> tuple[float, float]:
    """Mean over a wall's image, and over its middle of 40 x 40 px, of each pixel's deviation over frames."""
    sensor = SENSORS[name]
    oblique = sensor.camera.scaled(2).range_over_depth
    paint = np.full(oblique.shape, MATERIAL_ID["painted_wall"], np.uint8)
    wall = GeometryBuffers.dense(2, np.full(oblique.shape, z_m, np.float32), (1 / oblique).astype(np.float32), paint)
    noise = PhysicalNoise(range_window=False)
    depth = np.stack(
        [simulate(wall, sensor, noise, rng=np.random.Generator(np.random.Philox(key=(0, k)))).depth_m for k in range(frames)]
    )
    enough = np.isfinite(depth).mean(axis=0) >= 0.9
    spread = 1e3 * np.nanstd(np.where(enough, depth, 0.0), axis=0, ddof=1)
    middle = tuple(slice(n // 2 - 20, n // 2 + 20) for n in spread.shape)
    return float(spread[enough].mean()), float(spread[middle][enough[middle]].mean())


def test_presets_are_those_of_the_table() -> None:
    text = (DOCS / "sensor-model.md").read_text("utf-8")
    lines = text[text.index("| name | pixels") :].split("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert {row[0].strip("`") for row in rows} == set(SENSORS.names(own=True)) - {"pico_monstar_105"}
    for name, pixels, _, near_far, fps, integration_us, modulation, unambiguous in rows:
        sensor = SENSORS[name.strip("`")]
        if pixels != '"':
            assert pixels == f"{sensor.camera.width}×{sensor.camera.height}"
        assert tuple(map(float, near_far.split("–"))) == sensor.range_m
        assert float(fps) == sensor.fps
        if sensor.frequencies_hz:
            assert float(integration_us) == pytest.approx(1e6 * sensor.integration_s)
            assert tuple(map(float, modulation.split(", "))) == tuple(f / 1e6 for f in sensor.frequencies_hz)
            common = np.gcd.reduce([round(f) for f in sensor.frequencies_hz])
            assert float(unambiguous) == pytest.approx(SPEED_OF_LIGHT / (2 * common), abs=0.006)


def test_the_monstars_noise_is_that_of_the_table() -> None:
    distances, measured, whole, difference, centre = ([*row[1:]] for row in MONSTAR)
    for z, law, of_image, off, of_middle in zip(distances, measured, whole, difference, centre, strict=True):
        assert float(law) == pytest.approx(1 + 5 * float(z) + float(z) ** 2, abs=0.006)
        image, middle = sigma_mm("pico_monstar_105/3", float(z))
        assert float(of_image) == pytest.approx(image, rel=0.01)
        assert float(of_middle) == pytest.approx(middle, rel=0.02)
        told = float(re.sub(r"[ %]", "", off.replace("−", "-")))
        assert told == pytest.approx(100 * (image / float(law) - 1), abs=0.6)


@pytest.mark.slow
def test_other_cameras_noise_is_that_of_the_table() -> None:
    for name, *cells in OTHERS[1:]:
        preset = name.replace("use case ", "pico_monstar_105/").strip("`")
        for heading, cell in zip(OTHERS[0][1:], cells, strict=True):
            if cell:
                assert float(cell) == pytest.approx(sigma_mm(preset, float(heading.removesuffix(" m")))[1], rel=0.02), (
                    name,
                    heading,
                )


def test_glazing_is_that_of_the_table() -> None:
    """What panes let through, row by row."""
    text = (DOCS / "sensor-model.md").read_text("utf-8")
    lines = text[text.index("| place | glass") :].split("\n\n")[0].splitlines()[2:]
    assert [[cell.strip() for cell in line.strip("|").split("|")] for line in lines] == [
        [place, g.name, f"{g.share:.2f}", *("{:.2f} to {:.2f}".format(*at) for at in (g.at_850, g.at_940))]
        for place, kinds in GLAZING.items()
        for g in kinds
    ]


def test_reflectances_are_those_of_the_tables() -> None:
    """Each row of the page is a row of the code, and has a source or the word that there is none."""
    tables = json.loads((DOCS / "figures" / "sensor-model.json").read_text("utf-8"))["tables"]
    materials, dyes, hair, skin = (table["rows"][1:] for table in tables if table["section"] == "Reflectance")
    assert [(row[0].strip("`"), *map(float, row[1:3]), row[3]) for row in materials] == [
        (m.name, m.reflectance, m.reflectance_940, f"{m.roughness:.2f}" if m.roughness else "") for m in MATERIALS[1:]
    ]
    assert [(name.strip("`"), dye, share, band, longer, eye) for name, dye, share, band, longer, eye, _ in dyes] == [
        (name, d.name, f"{d.share:.2f}", f"{d.low:.2f} to {d.high:.2f}", f"{d.longer:.2f}", "yes" if d.to_the_eye else "")
        for name, of in DYES.items()
        for d in of
    ]
    assert [(row[0].replace(" ", "_"), row[1]) for row in hair] == [(n, f"{a:.2f} to {b:.2f}") for n, (a, b) in HAIR.items()]
    assert [(float(row[0]), *row[1:3]) for row in skin] == [
        (s.tone, *("{:.3f} ± {:.3f}".format(*at) for at in (s.at_850, s.at_940))) for s in SKIN
    ]
    for row in (*materials, *dyes, *hair):
        assert "assumed" in row[-1] or re.search(r"\[[123]\]", row[-1]), row
    for shares in DYES.values():
        assert sum(dye.share for dye in shares) == pytest.approx(1.0)
