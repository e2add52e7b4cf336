"""Does realistic noise help? Detectors trained on frames of one kind, tested on frames of another: `noise_study.py FOLDER`.

The scenes of the training sets are the same, and so are the network, its first weights and the order of frames: what
differs is the noise. Nobody in the tests, and no car of theirs, was trained on. `--style MODEL` adds a detector that learnt from
styled depth. `--traced N` adds N test frames whose indirect light is path traced: the first call writes their scenes to
FOLDER/traced and stops, `tools/multipath_reference.py trace FOLDER/traced --paths 128` traces them, and the next call goes on.
A step whose folder is there is not done again. It prints a table.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from multipath_reference import FOV, SIZE, SPEED_OF_LIGHT
from scipy import ndimage

SCENES: Mapping[str, Any] = {
    "scene": {
        "cars": ["city_car", "sedan", "suv", "van", "shuttle"], "right_hand_drive": 0.3, "belted": 0.85,
        "occupancy": {"driver": 1.0, "front_passenger": 0.6, "rear_left": 0.15, "rear_center": 0.05, "rear_right": 0.15},
    },
    "people": {"subjects": [], "random": {"count": 150}},
    "camera": {
        "sensor": "pico_monstar_105/4", "views": {"driver": 1.0}, "jitter_m": 0.03, "jitter_deg": 3.0,
    },
}  # fmt: skip
UNSEEN = {"scene": SCENES["scene"] | {"cars": ["hatchback", "coupe"]}, "people": {}}
NONE = {"a_mm": 0, "b_mm_per_m": 0, "c_mm_per_m2": 0, "edge_sigma_mm": 0, "remove_spikes": False}
TRAINED: Mapping[str, dict[str, Any]] = {
    "clean": {"noise": {"kind": "empirical", **NONE}},
    "empirical": {"noise": {"kind": "empirical"}},
    "physical": {},
    "multipath": {"noise": {"multipath": True}},
}
# What docs/real-cameras.md found in real frames: edges taken out, speckled loss, a shadow of the light source, a fixed pattern;
# and some scattered light.
REAL = {"remove_edges": True, "low_amplitude_spread": 0.37, "light_offset_m": 0.03, "fixed_pattern_mm": 1.6, "lens_scatter": 0.02}
TESTS: Mapping[str, dict[str, Any]] = {
    "physical": {},
    "motion": {"scene": UNSEEN["scene"] | {"sequence": {"frames": 10, "rate_hz": 10, "exposure_motion": True}}},
    "real": {"noise": REAL | {"multipath": True}},
}
RECIPE: Mapping[str, Any] = {
    "method": "compact",
    "settings": {"slots": ["driver"], "looks_px": [], "width": 128, "height": 112, "focal": 58.2},
    # no depth noise and no lost pixels, which would stand in for a sensor's
    "augment": {"shift": 0.6, "shift_m": 0.06, "rotate_deg": 3.0, "noise_m": 0.0, "lost": 0.0, "occluder": 0.0},
    "batch": 16,
}
FIGURES = (("PCK", "3d", 10.0), ("PCK", "3d", 5.0), ("PCKh", "2d", 0.5))


def run(*words: str) -> str:
    """The output of a command of cabinpose."""
    done = subprocess.run([sys.executable, "-m", "cabinpose", *words], stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout


def dataset(folder: Path, config: Mapping[str, Any], frames: int, seed: int) -> Path:
    """The folder of a generated dataset."""
    if not folder.exists():
        file = folder.with_suffix(".yaml")
        file.write_text(yaml.safe_dump(dict(config)))
        run("synth", "--config", str(file), "--frames", str(frames), "--seed", str(seed), "--out", str(folder))
    return folder


def detector(folder: Path, data: Path, recipe: Mapping[str, Any]) -> Path:
    """The ONNX model of a detector trained on a dataset."""
    model = folder.with_suffix(".onnx")
    if not model.exists():
        file = folder.with_suffix(".yaml")
        file.write_text(yaml.safe_dump(dict(recipe)))
        run("train", str(data), "--config", str(file), "--out", str(folder))
        run("export", "onnx", str(folder / "best.ckpt"), "--out", str(model))
    return model


def traced(folder: Path, frames: int) -> Path | None:
    """The folder of a dataset with path-traced indirect light; None where that is still to be traced."""
    from cabinpose.scene.sensor import physical
    from cabinpose.scene.sensor.optics import material_table
    from cabinpose.synth import FrameMaker
    from cabinpose.synth.config import SynthConfig
    from cabinpose.synth.generate import generate

    config = SynthConfig.parse(dict(SCENES) | UNSEEN | {"noise": {"multipath": True}})
    lights = [folder / "traced" / f"light_{i:03d}.npz" for i in range(frames)]
    if not all(light.exists() for light in lights):
        maker, reflectance = FrameMaker(config, 901), material_table(True, True, 0.0, 0.0)[:, 0]
        (folder / "traced").mkdir(exist_ok=True)
        for i in range(frames):
            scene = maker.make(i)[1]
            surface = scene.surface()
            np.savez(
                folder / "traced" / f"scene_{i:03d}.npz", vertices=surface.vertices, normals=surface.normals, faces=surface.faces,
                reflectance=reflectance[surface.material], world_from_camera=scene.world_from_camera,
            )  # fmt: skip
        return None
    data = folder / "test-traced"
    if not data.exists():
        waiting = iter(lights)

        def from_file(buffers: Any, sensor: Any, table: Any, frequencies: Any, **_: Any) -> Any:
            return indirect(np.load(next(waiting)), buffers, sensor, table, frequencies)

        physical.indirect_light = from_file
        generate(config, frames, data, seed=901, workers=1)
    return data


def indirect(light: Mapping[str, Any], buffers: Any, sensor: Any, table: Any, frequencies: Any) -> Any:
    """Traced indirect light as `indirect_light` gives its own: its ratio to the direct light, by the medians of 4 x 4 pixels."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = light["all"] / light["direct"] - 1.0  # (h, w, F)
    height, width = ratio.shape[0] // 4, ratio.shape[1] // 4
    parts = ratio.reshape(height, 4, width, 4, -1).swapaxes(1, 2).reshape(height, width, 16, -1)
    ratio = np.nanmedian(parts.real, axis=2) + 1j * np.nanmedian(parts.imag, axis=2)
    lost = ~np.isfinite(ratio).all(axis=-1)
    ratio = ratio[tuple(ndimage.distance_transform_edt(lost, return_distances=False, return_indices=True))]
    rays = sensor.camera.rays
    focal = 0.5 * SIZE[0] / np.tan(FOV / 2)
    at = [(focal * rays[..., axis] + 0.5 * (size - 1)) / 4 - 0.375 for axis, size in ((1, SIZE[1]), (0, SIZE[0]))]
    ranges = buffers.depth_m * sensor.camera.range_over_depth
    energy = np.nan_to_num(table[buffers.material, 0] * buffers.cos_incidence / ranges**2, posinf=0.0)
    result = np.zeros((ranges.shape[0], 1 + 2 * len(frequencies), ranges.shape[1]), np.float32)
    for k, frequency in enumerate(frequencies):
        here = sum(
            unit * ndimage.map_coordinates(part, at, order=1, mode="nearest")
            for unit, part in ((1.0, ratio[..., k].real), (1j, ratio[..., k].imag))
        )
        phasor = here * energy * np.exp(4j * np.pi * frequency / SPEED_OF_LIGHT * np.nan_to_num(ranges, posinf=0.0))
        result[:, 0] += np.abs(phasor) / len(frequencies)
        result[:, 1 + 2 * k], result[:, 2 + 2 * k] = phasor.real, phasor.imag
    return result


def figures(data: Path, model: Path) -> list[float]:
    """PCK at 10 and 5 cm, PCKh@0.5, and the half width of the first one's 95 % interval over the frames."""
    told = json.loads(run("evaluate", str(data), "--model", str(model), "--persons", "driver", "--json"))
    wanted = [
        value
        for metric, space, threshold in FIGURES
        for value in told["models"][0]["values"]
        if (value["metric"], value["space"], value["threshold"]) == (metric, space, threshold)
        and (value["joints"], value["visibility"]) == ("All", "any")
    ]
    return [v["value"] for v in wanted] + [(wanted[0]["high"] - wanted[0]["low"]) / 2]


def cell(data: Path, models: Sequence[Path]) -> str:
    """The figures of one kind of detector on one test: means over its runs, the first with their least and greatest."""
    found = np.array([figures(data, model) for model in models])
    first, (fine, image, half) = found[:, 0], found[:, 1:].mean(axis=0)
    runs = f" ({first.min():.1f} to {first.max():.1f})" if len(models) > 1 else ""
    return f"{first.mean():.1f}{runs} ± {half:.1f}, {fine:.1f}, {image:.1f}"


def main() -> None:
    """Make what is not there, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=1500)
    parser.add_argument("--tests", type=int, default=300)
    parser.add_argument("--epochs", type=int, default=12)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--traced", type=int, default=0)
    parser.add_argument("--style", type=Path)
    options = parser.parse_args()
    folder: Path = options.folder
    folder.mkdir(parents=True, exist_ok=True)
    trained, models = dict(TRAINED), {}
    if options.style is not None:
        trained["styled"] = {"style": {"by": str(options.style.resolve())}}
    for name, change in trained.items():
        data = dataset(folder / f"train-{name}", dict(SCENES) | change, options.frames, 601)
        recipe = dict(RECIPE) | {"epochs": options.epochs} | ({"depth": "depth_styled"} if name == "styled" else {})
        models[name] = [
            detector(folder / f"detector-{name}-{seed}", data, recipe | {"seed": seed}) for seed in range(1, options.repeats + 1)
        ]
    tests = {n: dataset(folder / f"test-{n}", dict(SCENES) | UNSEEN | c, options.tests, 901) for n, c in TESTS.items()}
    if options.traced:
        data = traced(folder, options.traced)
        if data is None:
            sys.exit(f"trace {folder / 'traced'} with tools/multipath_reference.py, then call this again")
        tests["traced"] = data
    print("| trained on | " + " | ".join(tests) + " |\n|---|" + "---|" * len(tests))
    for name, runs in models.items():
        print(f"| {name} | " + " | ".join(cell(data, runs) for data in tests.values()) + " |", flush=True)


if __name__ == "__main__":
    main()
