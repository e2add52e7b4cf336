"""Every reader of foreign files with sound files for it, and how many damaged ones are borne.

    python tests/faults/foreign.py 1000 xdf c3d            # so many damaged files of each of the named readers (none: of all)
    python tests/faults/foreign.py 1000 xdf --seed 34      # others

prints what came of them. Each reader works in a child process that may take 2 GB more than it has, and 20 s a file.

The first word of a reader's name is that of its format (`cabinpose.formats`) or of what it is; `source KIND` plays a file.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from types import MappingProxyType
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "store"))

import numpy as np
import sound as made
from damage import (
    Places,
    in_checked,
    in_chunk,
    in_glb,
    in_group,
    in_manifest,
    in_png,
    in_zip,
    of_c3d,
    of_glb,
    of_mcap,
    of_mkv,
    of_onnx,
    of_xdf,
    of_zip,
)  # fmt: skip
from mutations import NUMBERS, Read, Survived, mutated, survive
from test_fuzz import READ, ending, originals
from test_import_ntu import NAME as CLIP

from cabinpose.align.calibration import Calibration
from cabinpose.align.session import Session
from cabinpose.app.lab.laboratory import load_rig as load_laboratory
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.app.lab.takes import Truth
from cabinpose.core.errors import ModelError
from cabinpose.estimate import packaged_models
from cabinpose.estimate.array_model import ArrayModel
from cabinpose.estimate.onnx_model import OnnxModel
from cabinpose.record.config import load_rig, load_take
from cabinpose.scene.cabin.car_file import read_car_file
from cabinpose.store import read_predictions
from cabinpose.store.convert.adtf_layout import AdtfLayout
from cabinpose.store.convert.camera_file import read_camera
from cabinpose.store.split import read_splits
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.style.frame import StyleFrame
from cabinpose.synth.style.stage import open_network

Repack = Callable[[bytes, np.random.Generator], bytes]


@dataclass(frozen=True)
class Foreign:
    """A reader: a sound file in a folder, its reading, where its lengths are, and how its content is packed anew."""

    suffix: str
    make: Callable[[Path], bytes]
    read: Callable[[Path], Read]
    lengths: Callable[[bytes], Places] = lambda _: []
    repack: Repack | None = None
    refused: bool = False  # in its sound state too, by what comes after the reading


def damaged(data: bytes, rng: np.random.Generator, foreign: Foreign, places: Places) -> bytes:
    """A sound file with a length changed, its content damaged under right checksums, or faults of any kind."""
    kind = rng.random()
    if foreign.repack is not None and kind < 0.5:
        return foreign.repack(data, rng)
    if places and kind < 0.75:
        changed = bytearray(data)
        for _ in range(int(rng.integers(1, 3))):
            at, size = places[int(rng.integers(len(places)))]
            old = int.from_bytes(changed[at : at + size], "little")
            choices = (old + 1, old - 1, 2 * old, old // 2, *NUMBERS)
            new = choices[int(rng.integers(len(choices)))] & ((1 << 8 * size) - 1)
            changed[at : at + size] = new.to_bytes(size, "little")
        return bytes(changed)
    return mutated(data, rng)


def of_folder(make: Callable[[Path], Path], name: str, read: Callable[[Path], object], repack: Repack | None = None) -> Foreign:
    """A file of a folder, which is read with it in its place."""

    def sound(folder: Path) -> bytes:
        return (make(folder / "sound") / name).read_bytes()

    def reading(folder: Path) -> Read:
        place = make(folder / "reading")

        def once(path: Path) -> None:
            shutil.copyfile(path, place / name)
            read(place)

        return once

    return Foreign(Path(name).suffix or ".bin", sound, reading, repack=repack)


def always(read: Read) -> Callable[[Path], Read]:
    return lambda _: read


RIG = {"take": {"action": "reach", "subjects": [{"code": "S07"}]}, "sources": {"suit": {"kind": "simulated"}}}
CAR = {"mesh": "car.glb", "up_axis": "y", "unit": "m", "seats": {"driver": {"h_point": [0.0, 0.4, 0.5], "torso_angle_deg": 22}}}
DEPTH = np.where(np.arange(10_000).reshape(1, 100, 100) % 7, 0.5, 0).astype(np.float32)
CONFIG = SynthConfig().model_dump(mode="json")
OF_NO_METHOD = {"cabinpose": np.frombuffer(b"{}", np.uint8), "a": np.eye(3)}
STYLE = {"depth_m": np.ones((64, 64), np.float32), "regions": np.zeros((64, 64), np.uint8)}
WHOLE = {"depth01": DEPTH, "joints_3d": np.ones((1, 15, 3)), "frame": np.arange(1)}

LENS = {"width": 16, "height": 12, "fx": 12.0, "fy": 12.0, "cx": 7.5, "cy": 5.5}
CALIBRATION = {
    "intrinsics": LENS, "extrinsics": {"camera_from_world": np.eye(4).tolist()}, "tof_to_optical": {"offset_s": 0.1},
    "heads": {"S01": {"object_from_head": np.eye(4).tolist(), "suit_to_optical": {"offset_s": 0.0, "interval_s": [0.0, 0.1]}}},
}  # fmt: skip
SESSION = {
    "board": {"columns": 9, "rows": 6, "square_m": 0.06}, "board_take": "a.mcap", "pendulum_take": "b.mcap",
    "subjects": {"S01": {"take": "c.mcap", "head_offset_m": [0.0, 0.1, 0.2]}}, "vehicle_from_world": np.eye(4).tolist(),
}  # fmt: skip
LAYOUT = {
    "streams": [
        {
            "stream": "tof", "camera": {name: LENS[name] for name in ("fx", "fy", "cx", "cy")},
            "fields": [
                {"field": "t", "type": "tUInt64", "gives": "time", "unit": "us"},
                {"field": "d", "type": "tUInt16", "size": [12, 16], "gives": "depth", "unit": "mm"},
            ],
        }
    ]
}  # fmt: skip
PARTS = {"pixel_m": 0.04, "cell_px": 2, "filter_cells": 3, "mixtures": 2, "limb_parts": False, "rounds": 1, "negatives": 1.0}
WALKS = {"samples": 3, "features": 8, "steps": 8, "skipped": 2}

LENGTHS = {"c3d": of_c3d, "xdf": of_xdf, "azure-mkv": of_mkv, "rosbag2": of_mcap}

TICAM = "../Train_labels/Train_Labels/one/p01"


def _recordings() -> Iterator[tuple[str, Foreign]]:
    for name in READ:

        def make(folder: Path, name: str = name) -> bytes:
            shutil.rmtree(folder / "made", ignore_errors=True)
            (folder / "made").mkdir(parents=True)
            (content,) = originals(name, folder / "made").values()
            return content

        yield name, Foreign(ending(name), make, always(made.imported(name)), LENGTHS.get(name, lambda _: []))


def ticam(name: str, repack: Repack | None = None) -> Foreign:
    return of_folder(made.ticam, name, made.frames_of("ticam"), repack)


def png_json(name: str, repack: Repack | None = None) -> Foreign:
    return of_folder(made.shown_as("png-json"), name, made.frames_of("png-json"), repack)


def yaml_file(value: Any, read: Read) -> Foreign:
    return Foreign(".yaml", made.text(value), always(read))


def arrays(make: Callable[[Path], bytes], read: Read, *, refused: bool = False) -> Foreign:
    return Foreign(".npz", make, always(read), of_zip, in_zip, refused)


def packaged(name: str, read: Read, *, refused: bool = False) -> Foreign:
    return Foreign(".onnx", lambda _: packaged_models()[name].read_bytes(), always(read), of_onnx, refused=refused)


READERS: Mapping[str, Foreign] = MappingProxyType(
    dict(_recordings())
    | {
        "mcap": Foreign(".mcap", made.recording, always(made.read_recording), of_mcap, in_chunk),
        "glb": Foreign(".glb", made.exported("glb"), always(made.mesh), of_glb, in_glb),
        "gltf": Foreign(".gltf", made.gltf, always(made.mesh)),
        **{kind: Foreign(f".{kind}", made.exported(kind), always(made.mesh)) for kind in ("ply", "stl", "obj")},
        "clip mvnx": Foreign(".mvnx", lambda folder: originals("mvnx", folder)["file"], always(made.clip)),
        "clip bvh": Foreign(".bvh", lambda folder: originals("bvh", folder)["file"], always(made.clip)),
        "source replay": Foreign(".mcap", made.filmed, always(made.played("replay")), of_mcap, in_chunk),
        "source azure_mkv": Foreign(
            ".mkv", lambda folder: originals("azure-mkv", folder)["frames"], always(made.played("azure_mkv")), of_mkv
        ),
        "onnx": packaged("lift", OnnxModel),
        "onnx style": packaged("lift", open_network, refused=True),
        "onnx weights": packaged("lift", made.exported_weights, refused=True),
        "checkpoint": Foreign(".ckpt", made.checkpoint, always(made.read_weights_of), of_zip, in_zip),
        "vgg19": Foreign(".pth", made.checkpoint, always(made.of_vgg), of_zip, in_zip, refused=True),
        "npz model": arrays(made.saved(**OF_NO_METHOD), ArrayModel, refused=True),
        "npz walks": arrays(made.fitted("walks", **WALKS), made.find),
        "npz dpm": arrays(made.fitted("dpm", **PARTS), made.find),
        "npz frames": arrays(made.saved(**WHOLE), made.itop_arrays),
        "npz style": arrays(made.saved(**STYLE), StyleFrame.read),
        "npz truth": arrays(made.truth, Truth.load),
        "itop labels": of_folder(made.itop, "ITOP_side_train_labels.h5", made.frames_of("itop")),
        "itop depth": of_folder(made.itop, "ITOP_side_train_depth_map.h5", made.frames_of("itop")),
        "coco": of_folder(made.coco, "people.json", lambda folder: made.frames_of("coco")(folder / "people.json")),
        "coco pictures": of_folder(made.pictures, "2.png", made.of_pictures),
        "coco masks": of_folder(made.shown_as("coco", images="depth16"), made.ANNOTATIONS, made.frames_of("coco")),
        "coco-labels": Foreign(".json", made.labelled, made.corrected),
        "ntu": of_folder(made.ntu, f"{CLIP}.skeleton", made.frames_of("ntu")),
        "ntu depth": of_folder(made.ntu, f"{CLIP}/Depth-00000002.png", made.frames_of("ntu"), in_png),
        "ticam depth": ticam("Depth/one/p01/one-p01_000011_x_DEPTH.png", in_png),
        "ticam mask": ticam(f"{TICAM}/masks_depth/one-p01_000011_x_DEPTH_classes.png", in_png),
        "ticam boxes": ticam(f"{TICAM}/boxes_2d_depth.csv"),
        "ticam activities": ticam(f"{TICAM}/activities.csv"),
        "png-json": png_json("dataset.json"),
        "png-json classes": png_json("labels.json"),
        "png-json pose": png_json("pose/00000001.json"),
        "png-json labels": png_json("labels/00000001.png", in_png),
        "depth-images": Foreign(".png", made.depth_image(".png"), always(made.depth_images), repack=in_png),
        "depth-images tiff": Foreign(".tiff", made.depth_image(".tiff"), always(made.depth_images)),
        "depth-images npy": Foreign(".npy", made.depth_image(".npy"), always(made.depth_images)),
        "folder layout": of_folder(made.laid_out, "layout.yaml", made.frames_of_layout),
        "folder rows": of_folder(made.laid_out, "rows.csv", made.frames_of_layout),
        "folder mat": of_folder(made.laid_out_by_arrays, "all.mat", made.frames_of_layout),
        "recording": Foreign(".mcap", made.filmed, always(made.frames_of("recording")), of_mcap, in_chunk),
        "camera": yaml_file(made.OPENCV, lambda path: read_camera(path, (16, 12))),
        "dataset.yaml": of_folder(made.dataset, "dataset.yaml", made.load, in_manifest),
        "zarr.json": of_folder(made.dataset, "part-00000.zarr/zarr.json", made.load, in_group),
        "zarr depth": of_folder(made.dataset, "part-00000.zarr/depth/c/0/0/0", made.load, in_checked),
        "zarr names": of_folder(made.dataset, "part-00000.zarr/joint/c/0", made.load, in_checked),
        "journal": Foreign(".jsonl", made.journal, always(made.read_journal)),
        "predictions": Foreign(".jsonl", made.predictions, always(read_predictions)),
        "predictions parquet": Foreign(".parquet", made.parquet, always(read_predictions)),
        "classes zarr.json": of_folder(made.class_images, "zarr.json", made.read_classes),
        "classes labels": of_folder(made.class_images, "labels/zarr.json", made.read_classes),
        "classes chunk": of_folder(made.class_images, "labels/c/0/0/0", made.read_classes),
        "rig": yaml_file(RIG, load_rig),
        "take": yaml_file(RIG["take"], load_take),
        "car": yaml_file(CAR, read_car_file),
        "configuration": yaml_file(CONFIG, SynthConfig.load),
        "training": Foreign(".yaml", made.training, always(made.read_training)),
        "splits": yaml_file({"train": {"subject": ["S1"]}, "test": {"subject": ["S2"]}}, read_splits),
        "calibration": yaml_file(CALIBRATION, Calibration.load),
        "session": yaml_file(SESSION, Session.load),
        "laboratory": yaml_file(VirtualRig().model_dump(mode="json"), load_laboratory),
        "layout": yaml_file(LAYOUT, AdtfLayout.load),
    }
)


def borne(name: str, folder: Path, *, count: int, seed: int) -> Survived:
    """What comes of so many damaged files; AssertionError where one of them is not borne, which is kept in the folder."""
    foreign = READERS[name]
    folder.mkdir(parents=True, exist_ok=True)
    data = foreign.make(folder)
    places = foreign.lengths(data)
    read = foreign.read(folder)
    sound = folder / f"sound{foreign.suffix}"
    sound.write_bytes(data)
    with suppress(ModelError) if foreign.refused else nullcontext():
        read(sound)
    return survive(
        read, data, folder / "damaged", foreign.suffix, count=count, seed=seed, most_mb=2000,
        fault=lambda sound, rng: damaged(sound, rng, foreign, places),
    )  # fmt: skip


def main() -> None:
    """Print what came of damaged files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int)
    parser.add_argument("names", nargs="*", default=list(READERS))
    parser.add_argument("--seed", type=int, default=33)
    given = parser.parse_args()
    for name in given.names:
        began = time.monotonic()
        with TemporaryDirectory() as folder:
            try:
                found: Any = vars(borne(name, Path(folder), count=given.count, seed=given.seed))
            except AssertionError as problem:
                kept = Path(gettempdir()) / f"not-borne-{name.replace(' ', '-')}{READERS[name].suffix}"
                shutil.copyfile(Path(folder) / "damaged" / f"damaged{READERS[name].suffix}", kept)
                found = {"not borne": str(problem), "kept": str(kept)}
        row = {"reader": name, "files": given.count, "seed": given.seed, "s": time.monotonic() - began} | found
        sys.stdout.write(json.dumps(row) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
