"""Does realistic noise help? Detectors trained on frames of one kind, tested on frames of another: `noise_study.py FOLDER`.

The scenes of the training sets are the same, and so are the network, its first weights and the order of frames: what
differs is the noise. Nobody in the tests, and no car of theirs, was trained on. `--reference DATASET` adds frames whose
indirect light was path traced (`tools/multipath_reference.py`), `--style MODEL` a detector that learnt from styled depth.
A step whose folder is there is not done again. It prints the table of docs/does-it-help.md.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

SCENES: Mapping[str, Any] = {
    "scene": {
        "cars": ["city_car", "sedan", "suv", "van", "shuttle"], "right_hand_drive": 0.3, "belted": 0.85,
        "occupancy": {"driver": 0.92, "front_passenger": 0.6, "rear_left": 0.15, "rear_center": 0.05, "rear_right": 0.15},
    },
    "people": {"subjects": [], "random": {"count": 150}},
    "camera": {
        "sensor": "pico_monstar_105/4", "views": {"driver": 0.5, "front_row": 0.5}, "jitter_m": 0.03, "jitter_deg": 3.0,
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
# What docs/real-cameras.md found in real frames: edges taken out, speckled loss, a shadow of the light source, a fixed pattern.
REAL = {"remove_edges": True, "low_amplitude_spread": 0.37, "light_offset_m": 0.03, "fixed_pattern_mm": 1.6, "lens_scatter": 0.02}
TESTS: Mapping[str, dict[str, Any]] = {
    "physical": {},
    "motion": {"scene": UNSEEN["scene"] | {"sequence": {"frames": 10, "rate_hz": 10, "exposure_motion": True}}},
    "real": {"noise": REAL | {"multipath": True}},
}
RECIPE: Mapping[str, Any] = {
    "method": "compact",
    "settings": {"slots": ["driver", "front_passenger"], "looks_px": []},
    # no depth noise and no lost pixels, which would stand in for a sensor's
    "augment": {"shift": 0.6, "shift_m": 0.06, "rotate_deg": 3.0, "noise_m": 0.0, "lost": 0.0, "occluder": 0.0},
    "batch": 32,
    "seed": 1,
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
        run("export", "--onnx", str(folder / "best.ckpt"), "--out", str(model))
    return model


def figures(data: Path, model: Path) -> list[str]:
    """PCK at 10 and 5 cm and PCKh@0.5, with the half width of the 95 % interval of the first."""
    told = json.loads(run("evaluate", str(data), "--model", str(model), "--persons", "driver", "front_passenger", "--json"))
    found = []
    for metric, space, threshold in FIGURES:
        (value,) = (
            v for v in told["models"][0]["values"]
            if (v["metric"], v["space"], v["threshold"], v["joints"], v["visibility"]) == (metric, space, threshold, "All", "any")
        )  # fmt: skip
        half = f" ± {(value['high'] - value['low']) / 2:.1f}" if not found else ""
        found.append(f"{value['value']:.1f}{half}")
    return found


def main() -> None:
    """Make what is not there, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=1500)
    parser.add_argument("--tests", type=int, default=300)
    parser.add_argument("--epochs", type=int, default=12)
    parser.add_argument("--reference", type=Path)
    parser.add_argument("--style", type=Path)
    options = parser.parse_args()
    folder: Path = options.folder
    folder.mkdir(parents=True, exist_ok=True)
    recipe = dict(RECIPE) | {"epochs": options.epochs}
    trained, models = dict(TRAINED), {}
    if options.style is not None:
        trained["styled"] = {"style": {"by": str(options.style.resolve())}}
    for name, change in trained.items():
        data = dataset(folder / f"train-{name}", dict(SCENES) | change, options.frames, 601)
        own = recipe | ({"depth": "depth_styled"} if name == "styled" else {})
        models[name] = detector(folder / f"detector-{name}", data, own)
    tests = {n: dataset(folder / f"test-{n}", dict(SCENES) | UNSEEN | c, options.tests, 901) for n, c in TESTS.items()}
    if options.reference is not None:
        tests["reference"] = options.reference
    print("| trained on | " + " | ".join(tests) + " |\n|---|" + "---|" * len(tests))
    for name, model in models.items():
        print(f"| {name} | " + " | ".join(", ".join(figures(data, model)) for data in tests.values()) + " |", flush=True)


if __name__ == "__main__":
    main()
