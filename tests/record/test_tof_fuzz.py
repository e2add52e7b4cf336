"""What cameras deliver, damaged: counted as malformed or recorded, never raised, no memory for what a header claims."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import test_tof_bta
import test_tof_genicam
import test_tof_royale
from test_tof_bta import library  # noqa: F401 - fixtures
from test_tof_genicam import rig  # noqa: F401
from test_tof_royale import roypy  # noqa: F401

from cabinpose.record.sources.tof import bta_library as bta
from cabinpose.signals.recorded import Sample, ToFFrame
from cabinpose.store.recording import Chunking, RecordingWriter

Rng = np.random.Generator
SIZES = (0, 1, -1, 2, 31, 32, 64, 65535, 65536, 1 << 24, (1 << 31) - 1, 1 << 31, 1 << 40)
FEW, MANY = 300, 3000
_MOST_MB = 400


def number(rng: Rng) -> int:
    return SIZES[int(rng.integers(len(SIZES)))]


def odd(values: np.ndarray, rng: Rng) -> Any:
    """An array that is not what was promised."""
    kind = int(rng.integers(9))
    if kind == 0:
        return values[: int(rng.integers(len(values) + 1))]
    if kind == 1:
        return np.concatenate((values, values[:3]))
    if kind == 2:
        return values.astype(rng.choice(("float16", "float64", "int8", "object", "uint64", "bool")))
    if kind == 3:
        return None
    if kind == 4:
        return values.reshape(-1)[::-1]
    if kind == 5:
        return [["x"], [1.0, None]]
    if kind == 6:
        return np.zeros((0, 4))
    strange = np.array(values, dtype=np.float64)
    strange[rng.random(strange.shape) < 0.2] = rng.choice((np.nan, np.inf, -np.inf, 1e308, -1.0, 65536.0, 2.0**70))
    with np.errstate(over="ignore"):
        return strange if kind == 7 else strange.astype(np.float32)


def sound(samples: list[Sample], folder: Path) -> int:
    """Frames whose images fit each other, which a recording takes as they are."""
    found = 0
    with RecordingWriter(folder / "take.mcap", chunking=Chunking(sync_s=0)) as writer:
        for sample in samples:
            assert writer.write("tof", sample) == []
            for frame in (m for m in sample.messages if isinstance(m, ToFFrame)):
                found += 1
                shapes = {image.shape for image in (frame.depth, frame.amplitude, frame.confidence)} - {(0, 0)}
                assert len(shapes) == 1
    return found


def bears(source: Any, send: Callable[[], None], count: int, folder: Path) -> None:
    """Each thing sent is a frame, or malformed; the source goes on."""
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    samples: list[Sample] = []
    for _ in range(count):
        send()
        samples += source.read(0.0)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e3
    assert grown < _MOST_MB
    assert time.process_time() - began < 0.1 * count
    frames = sound(samples, folder)
    assert frames > 0
    assert source.counts.malformed > 0
    assert frames + source.counts.malformed >= count - source.counts.lost


def test_royale(roypy: Any, tmp_path: Path) -> None:  # noqa: F811
    mutate_royale(roypy, tmp_path, FEW)


@pytest.mark.slow
def test_royale_many(roypy: Any, tmp_path: Path) -> None:  # noqa: F811
    mutate_royale(roypy, tmp_path, MANY)


def mutate_royale(roypy: Any, folder: Path, count: int) -> None:  # noqa: F811
    rng = np.random.default_rng(0)
    source = test_tof_royale.make()
    source.open()
    listener = roypy.cameras["0007-1"].listener
    index = 0

    def send() -> None:
        nonlocal index
        index += 1
        if rng.random() < 0.5:
            data: Any = test_tof_royale.new_layout(index)
        else:
            points = test_tof_royale.OldLayout(index).npoints().reshape(-1, 6)
            data = SimpleNamespace(timeStamp=index * 100_000, width=64, height=48, values=points)
            data.npoints = lambda: data.values
            data.points = lambda: [SimpleNamespace(x=1.0)]
        for name in ("coordinates", "amplitudes", "values"):
            if hasattr(data, name) and rng.random() < 0.3:
                setattr(data, name, odd(np.asarray(getattr(data, name)), rng))
        for name in ("width", "height", "timeStamp"):
            if rng.random() < 0.1:
                setattr(data, name, [number(rng), float("nan"), None, "12"][int(rng.integers(4))])
        if rng.random() < 0.05:
            del data.timeStamp
        listener.onNewData(data)

    bears(source, send, count, folder)
    source.close()


def test_bluetechnix(library: Any, tmp_path: Path) -> None:  # noqa: F811
    mutate_bta(library, tmp_path, FEW)


@pytest.mark.slow
def test_bluetechnix_many(library: Any, tmp_path: Path) -> None:  # noqa: F811
    mutate_bta(library, tmp_path, MANY)


def mutate_bta(library: Any, folder: Path, count: int) -> None:  # noqa: F811
    """Sizes and formats that do not fit the bytes that are there. Where all of them agree, the library is to be believed."""
    rng = np.random.default_rng(0)
    source = test_tof_bta.make()
    source.open()
    points = test_tof_bta.points_mm()
    counter = 0

    def send() -> None:
        nonlocal counter
        counter += 1
        dtype = rng.choice(("float32", "int16", "uint16", "uint8"))
        channels = test_tof_bta.xyz(np.nan_to_num(np.clip(points, 0, 255)), dtype)
        channels[bta.AMPLITUDE] = (test_tof_bta.AMPLITUDE, 0)
        for key in list(channels):
            values, unit = channels[key]
            if rng.random() < 0.15:
                cut = values[: int(rng.integers(1, 31)), : int(rng.integers(1, 41))]
                channels[key] = np.ascontiguousarray(cut), unit
            if rng.random() < 0.1:
                del channels[key]
            elif rng.random() < 0.1:
                channels[key] = channels[key][0], int(rng.integers(0, 9))
        wrong = {}
        if rng.random() < 0.3:
            wrong[str(rng.choice(("x_res", "y_res", "data_len")))] = int(number(rng) % (1 << 16))
        if rng.random() < 0.1:
            wrong["data_format"] = int(rng.integers(256))
        if wrong.get("data_format") is not None and len(wrong) > 1:
            del wrong["data_format"]  # two wrongs may agree on bytes that are not there
        library.send(counter, counter * 1000 if rng.random() < 0.9 else int(rng.integers(1 << 32)), channels, **wrong)

    bears(source, send, count, folder)
    source.close()


def test_genicam(rig: Any, tmp_path: Path) -> None:  # noqa: F811
    mutate_genicam(rig, tmp_path, FEW)


@pytest.mark.slow
def test_genicam_many(rig: Any, tmp_path: Path) -> None:  # noqa: F811
    mutate_genicam(rig, tmp_path, MANY)


def mutate_genicam(rig: Any, folder: Path, count: int) -> None:  # noqa: F811
    rng = np.random.default_rng(0)
    source = test_tof_genicam.make(rig)
    source.open()
    index = 0
    formats = ("Coord3D_C16", "Mono16", "Confidence16", "Coord3D_ABC32f", "Mono8", "Confidence8", "BayerRG8", "", None, 17)

    def send() -> None:
        nonlocal index
        index += 1
        depth = test_tof_genicam.component("Coord3D_C16", test_tof_genicam.DEPTH)
        parts: list[Any] = [depth, test_tof_genicam.component("Mono16", test_tof_genicam.INTENSITY)]
        for part in parts:
            if rng.random() < 0.3:
                part.data = odd(part.data, rng)
                part.data = part.data if isinstance(part.data, np.ndarray) else None
            for name in ("width", "height"):
                if rng.random() < 0.1:
                    setattr(part, name, [number(rng), None, float("nan")][int(rng.integers(3))])
            if rng.random() < 0.1:
                part.data_format = formats[int(rng.integers(len(formats)))]
        if rng.random() < 0.1:
            parts.append(None)
        if rng.random() < 0.1:
            parts.reverse()
        if rng.random() < 0.1:
            parts.pop()
        stamp = index * 1000 if rng.random() < 0.9 else number(rng)
        rig.acquirer.fill(index if rng.random() < 0.9 else number(rng), stamp, *parts, incomplete=rng.random() < 0.1)

    bears(source, send, count, folder)
    assert rig.acquirer.out == 0  # every buffer was given back
    source.close()
