"""Every reader of foreign files with sound files for it, and faults that know where a format has its lengths.

    python tests/faults/foreign.py 1000 xdf c3d        # so many damaged files of each of the named readers (none: of all)

prints what came of them. Each reader works in a child process that may take 2 GB more than it has, and 20 s a file.
"""

from __future__ import annotations

import io
import json
import re
import shutil
import struct
import sys
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from types import MappingProxyType
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "store"))
sys.path.insert(0, str(Path(__file__).parents[1] / "cli"))

import numpy as np
import sphere_people
import trimesh
import yaml
from mutations import NUMBERS, Read, Survived, mutated, survive
from test_fuzz import READ, ending, originals, rows
from test_import import coco_file, itop_folder

from cabinpose.core.errors import ModelError
from cabinpose.estimate import packaged_models
from cabinpose.estimate.array_model import ArrayModel
from cabinpose.estimate.onnx_model import OnnxModel
from cabinpose.record.config import load_rig, load_take
from cabinpose.scene.cabin.car_file import read_car_file
from cabinpose.scene.cabin.meshfile import read_mesh
from cabinpose.signals import Channels, Facts, Sample, SegmentPoses
from cabinpose.store import open_dataset, read_itop_frames, read_itop_reference, read_predictions
from cabinpose.store.convert import import_recording, open_source
from cabinpose.store.predictions import Predictions, write_predictions
from cabinpose.store.recording import Chunking, Recording, RecordingWriter, Take, recover, survey
from cabinpose.store.schema import checksum, with_checksum_line
from cabinpose.store.shard import with_checksum
from cabinpose.store.split import read_splits
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.style.frame import StyleFrame

Places = list[tuple[int, int]]  # of numbers in a file: where they begin, and how many bytes they have


Repack = Callable[[bytes, np.random.Generator], bytes]


@dataclass(frozen=True)
class Foreign:
    """A reader: a sound file in a folder, its reading, where its lengths are, and how its content is packed anew."""

    suffix: str
    make: Callable[[Path], bytes]
    read: Callable[[Path], Read]
    lengths: Callable[[bytes], Places] = lambda _: []
    repack: Repack | None = None


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


# ------------------------------------------------------------------------------------------------------------- lengths


def of_c3d(data: bytes) -> Places:
    """The counts of the header, and of each parameter its offset and dimensions."""
    places = [(at, 2) for at in range(2, 20, 2)]
    at = 512 * (data[0] - 1) + 4
    while length := abs(struct.unpack_from("b", data, at)[0]):
        offset = at + 2 + length
        places += [(at, 1), (offset, 2)]
        if data[at + 1] < 128:
            places += [(offset + 2 + i, 1) for i in range(2 + data[offset + 3])]
            places += [(offset + 4 + data[offset + 3], 2)]
        step = int.from_bytes(data[offset : offset + 2], "little")
        if not step:
            break
        at = offset + step
    return places


def of_xdf(data: bytes) -> Places:
    """The length of each chunk, its kind and stream, and what follows: the number of samples."""
    places, at = [], 4
    while at < len(data):
        places += [(at, 1), (at + 1, 4), (at + 5, 2), (at + 7, 4), (at + 11, 1), (at + 12, 4)]
        at += 5 + int.from_bytes(data[at + 1 : at + 5], "little")
    return places


def of_mcap(data: bytes) -> Places:
    """The length of each record, and the numbers that chunks, messages and the footer begin with."""
    places, at = [], 8
    while at + 9 <= len(data) - 8:
        size = int.from_bytes(data[at + 1 : at + 9], "little")
        places += [(at, 1), (at + 1, 8), *((at + 9 + i, 8) for i in range(0, min(size, 48), 8))]
        at += 9 + size
    return places


def of_mkv(data: bytes) -> Places:
    """The sizes of elements, by the identities that Azure's files have."""
    found = []
    for identity in (
        "18538067",
        "1f43b675",
        "1654ae6b",
        "ae",
        "1941a469",
        "61a7",
        "465c",
        "a3",
        "1254c367",
        "7373",
        "67c8",
        "63a2",
    ):
        code, at = bytes.fromhex(identity), data.find(bytes.fromhex(identity))
        while at >= 0 and len(found) < 300:
            found += [(at + len(code), 1), (at + len(code) + 1, 2)]
            at = data.find(code, at + 1) if len(code) > 1 else -1
    return [(at, size) for at, size in found if at + size <= len(data)]


def of_glb(data: bytes) -> Places:
    """The lengths of the file and of its chunks."""
    length = int.from_bytes(data[12:16], "little")
    return [(8, 4), (12, 4), (16, 4), (20 + length, 4), (24 + length, 4)]


def of_zip(data: bytes) -> Places:
    """The sizes of the entries in both directories."""
    places = []
    for mark, fields in (
        (b"PK\x03\x04", (8, 18, 22, 26, 28)),
        (b"PK\x01\x02", (10, 20, 24, 28, 42)),
        (b"PK\x05\x06", (8, 12, 16)),
    ):
        at = data.find(mark)
        while at >= 0:
            places += [(at + field, 2 if field in (8, 10, 26, 28) else 4) for field in fields if at + field + 4 <= len(data)]
            at = data.find(mark, at + 1)
    return places


def of_onnx(data: bytes) -> Places:
    """Bytes near the beginning of messages, which are their kinds and lengths."""
    kinds = [data.find(mark) for mark in (b"\x3a", b"\x0a", b"\x12", b"\x22", b"\x2a", b"Conv", b"Gemm", b"Reshape", b"weight")]
    return [(at + i, 1) for at in kinds if at >= 0 for i in range(-8, 8) if 0 <= at + i < len(data)]


# ------------------------------------------------------------------------------------- damage under right checksums


def in_zip(data: bytes, rng: np.random.Generator) -> bytes:
    """One entry damaged, all checksums right."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = {info.filename: archive.read(info) for info in archive.infolist()}
    chosen = list(entries)[int(rng.integers(len(entries)))]
    head, tail = entries[chosen][:128], entries[chosen][128:]
    entries[chosen] = mutated(head, rng) + tail if rng.random() < 0.7 else mutated(entries[chosen], rng)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return file.getvalue()


def in_glb(data: bytes, rng: np.random.Generator) -> bytes:
    """The JSON damaged, the lengths right."""
    length = int.from_bytes(data[12:16], "little")
    text = mutated(data[20 : 20 + length], rng)
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    return data[:8] + struct.pack("<II4s", 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def in_chunk(data: bytes, rng: np.random.Generator) -> bytes:
    """The records of an MCAP file's first chunk damaged in place, under the right checksum."""
    at = next(at for at, size in of_mcap(data) if size == 1 and data[at] == 6)
    size, _, name = struct.unpack_from("<QII", data, at + 25)
    begin = at + 41 + name + 8
    records = mutated(data[begin : begin + size], rng)[:size].ljust(size, b"\0")
    return data[: at + 33] + struct.pack("<I", zlib.crc32(records)) + data[at + 37 : begin] + records + data[begin + size :]


def in_manifest(data: bytes, rng: np.random.Generator) -> bytes:
    """`dataset.yaml` damaged, its checksum right."""
    content = mutated(data[: data.rindex(b"checksum: ")], rng).decode("utf-8", "replace")
    return with_checksum_line(content if content.endswith("\n") else content + "\n").encode()


def in_group(data: bytes, rng: np.random.Generator) -> bytes:
    """A part's `zarr.json` damaged, its checksum right."""
    content = mutated(re.sub(rb'"checksum": "[^"]*"', b'"checksum": ""', data), rng).decode("utf-8", "replace")
    return content.replace('"checksum": ""', f'"checksum": "{checksum(content)}"', 1).encode()


def in_checked(data: bytes, rng: np.random.Generator) -> bytes:
    """A chunk damaged, or the index of a shard, their checksums right."""
    return with_checksum(mutated(data[:-4], rng))


# -------------------------------------------------------------------------------------------------------- sound files


def mesh(path: Path) -> None:
    read_mesh(path, up_axis="y", front_axis="z", unit="m")


def load(folder: Path) -> None:
    open_dataset(folder, missing="ignore").load()


def itop_arrays(path: Path) -> None:
    read_itop_frames(path)
    read_itop_reference(path)


def exported(kind: str) -> Callable[[Path], bytes]:
    def make(folder: Path) -> bytes:
        path = folder / f"sound.{kind}"
        trimesh.creation.box((1.8, 1.3, 4.2)).export(path)
        return path.read_bytes()

    return make


def recording(folder: Path) -> bytes:
    path = folder / "sound.mcap"
    path.unlink(missing_ok=True)
    take = Take.model_validate({"action": "sit", "subjects": [{"code": "S01"}]})
    with RecordingWriter(path, take, started_ns=1000, chunking=Chunking(sync_s=0, flush_s=1e9, definitions_s=1e9)) as writer:
        for host_ns, device_ns, message in rows(SegmentPoses, Channels, Facts, frames=4):
            writer.write("suit", Sample(None, host_ns + 1000, device_ns, b"raw", (message,)))
    return path.read_bytes()


def read_recording(path: Path) -> None:
    survey(path)
    with Recording(path, damaged="skip") as opened:
        for _ in opened.samples():
            pass
    out = path.with_name("recovered.mcap")
    out.unlink(missing_ok=True)
    recover(path, out)


def imported(name: str) -> Read:
    def read(path: Path) -> None:
        import_recording(path, name, path.with_name("imported.mcap"), overwrite=True)

    return read


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


def dataset(folder: Path) -> Path:
    manifest = sphere_people.manifest(frames=2, frames_per_part=2, width=16, height=12)
    shutil.rmtree(folder, ignore_errors=True)
    return Path(sphere_people.write(folder, manifest))


def frames_of(kind: str, **options: Any) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        source = open_source(path, kind, **options)
        for _ in source.frames():
            pass

    return read


def itop(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(exist_ok=True, parents=True)
    return itop_folder(folder)


def coco(folder: Path) -> Path:
    folder.mkdir(exist_ok=True, parents=True)
    coco_file(folder / "people.json")
    return folder


def saved(**arrays: Any) -> Callable[[Path], bytes]:
    def make(_: Path) -> bytes:
        file = io.BytesIO()
        np.savez_compressed(file, **arrays)
        return file.getvalue()

    return make


def predictions(folder: Path) -> bytes:
    shape = (3, 1, 2)
    found = Predictions(
        frame=np.arange(3), persons=("driver",), joints=("head", "neck"), model="m", joints_2d=np.ones((*shape, 2), np.float32),
        joints_3d=np.ones((*shape, 3), np.float32), score=np.ones(shape, np.float32), presence=np.ones(shape, np.float32),
        expected_error_m=np.full(shape, np.nan, np.float32),
    )  # fmt: skip
    path = folder / "sound.jsonl"
    write_predictions(path, found, overwrite=True)
    return path.read_bytes()


def text(value: Any) -> Callable[[Path], bytes]:
    return lambda _: yaml.safe_dump(value).encode()


def always(read: Read) -> Callable[[Path], Read]:
    return lambda _: read


RIG = {"take": {"action": "reach", "subjects": [{"code": "S07"}]}, "sources": {"suit": {"kind": "simulated"}}}
CAR = {"mesh": "car.glb", "up_axis": "y", "unit": "m", "seats": {"driver": {"h_point": [0.0, 0.4, 0.5], "torso_angle_deg": 22}}}
DEPTH = np.where(np.arange(10_000).reshape(1, 100, 100) % 7, 0.5, 0).astype(np.float32)
CONFIG = SynthConfig().model_dump(mode="json")
OF_NO_METHOD = {"cabinpose": np.frombuffer(b"{}", np.uint8), "a": np.eye(3)}
STYLE = {"depth_m": np.ones((64, 64), np.float32), "regions": np.zeros((64, 64), np.uint8)}
WHOLE = {"depth01": DEPTH, "joints_3d": np.ones((1, 15, 3)), "frame": np.arange(1)}

LENGTHS = {"c3d": of_c3d, "xdf": of_xdf, "azure-mkv": of_mkv, "rosbag2": of_mcap}


def _recordings() -> Iterator[tuple[str, Foreign]]:
    for name in READ:

        def make(folder: Path, name: str = name) -> bytes:
            shutil.rmtree(folder / "made", ignore_errors=True)
            (folder / "made").mkdir(parents=True)
            (content,) = originals(name, folder / "made").values()
            return content

        yield name, Foreign(ending(name), make, always(imported(name)), LENGTHS.get(name, lambda _: []))


READERS: Mapping[str, Foreign] = MappingProxyType(
    dict(_recordings())
    | {
        "mcap": Foreign(".mcap", recording, always(read_recording), of_mcap, in_chunk),
        "glb": Foreign(".glb", exported("glb"), always(mesh), of_glb, in_glb),
        **{kind: Foreign(f".{kind}", exported(kind), always(mesh)) for kind in ("ply", "stl", "obj")},
        "onnx": Foreign(".onnx", lambda _: packaged_models()["lift"].read_bytes(), always(OnnxModel), of_onnx),
        "npz model": Foreign(".npz", saved(**OF_NO_METHOD), always(ArrayModel), of_zip, in_zip),
        "npz frames": Foreign(".npz", saved(**WHOLE), always(itop_arrays), of_zip, in_zip),
        "npz style": Foreign(".npz", saved(**STYLE), always(StyleFrame.read), of_zip, in_zip),
        "h5 labels": of_folder(itop, "ITOP_side_train_labels.h5", frames_of("itop")),
        "h5 depth": of_folder(itop, "ITOP_side_train_depth_map.h5", frames_of("itop")),
        "coco": of_folder(coco, "people.json", lambda folder: frames_of("coco")(folder / "people.json")),
        "dataset.yaml": of_folder(dataset, "dataset.yaml", load, in_manifest),
        "zarr.json": of_folder(dataset, "part-00000.zarr/zarr.json", load, in_group),
        "zarr depth": of_folder(dataset, "part-00000.zarr/depth/c/0/0/0", load, in_checked),
        "zarr names": of_folder(dataset, "part-00000.zarr/joint/c/0", load, in_checked),
        "predictions": Foreign(".jsonl", predictions, always(read_predictions)),
        "rig": Foreign(".yaml", text(RIG), always(load_rig)),
        "take": Foreign(".yaml", text(RIG["take"]), always(load_take)),
        "car": Foreign(".yaml", text(CAR), always(read_car_file)),
        "configuration": Foreign(".yaml", text(CONFIG), always(SynthConfig.load)),
        "splits": Foreign(".yaml", text({"train": {"subject": ["S1"]}, "test": {"subject": ["S2"]}}), always(read_splits)),
    }
)  # fmt: skip


def borne(name: str, folder: Path, *, count: int, seed: int) -> Survived:
    """What comes of so many damaged files; AssertionError where one of them is not borne, which is kept in the folder."""
    foreign = READERS[name]
    folder.mkdir(parents=True, exist_ok=True)
    data = foreign.make(folder)
    places = foreign.lengths(data)
    read = foreign.read(folder)
    sound = folder / f"sound{foreign.suffix}"
    sound.write_bytes(data)
    with suppress(ModelError) if name == "npz model" else nullcontext():  # of no method
        read(sound)
    return survive(
        read, data, folder / "damaged", foreign.suffix, count=count, seed=seed, most_mb=2000,
        fault=lambda sound, rng: damaged(sound, rng, foreign, places),
    )  # fmt: skip


def main() -> None:
    """Print what came of damaged files."""
    count, names = int(sys.argv[1]), sys.argv[2:] or list(READERS)
    seed = 33
    for name in names:
        began = time.monotonic()
        with TemporaryDirectory() as folder:
            try:
                found: Any = vars(borne(name, Path(folder), count=count, seed=seed))
            except AssertionError as problem:
                kept = Path(gettempdir()) / f"not-borne-{name.replace(' ', '-')}{READERS[name].suffix}"
                shutil.copyfile(Path(folder) / "damaged" / f"damaged{READERS[name].suffix}", kept)
                found = {"not borne": str(problem), "kept": str(kept)}
        sys.stdout.write(json.dumps({"reader": name, "files": count, "seed": seed, "s": time.monotonic() - began} | found) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
