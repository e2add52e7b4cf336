"""An algorithm elsewhere is given the images that the user chooses: what arrives is what the dataset holds, byte for byte.

The server here reads its requests with numpy alone, and shared memory as a file of /dev/shm: nothing of the package's readers.
"""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "store"))

import sphere_people
import zarr
from somebodys_server import good_answer, response_of
from tritonclient.grpc import service_pb2

import cabinpose
from cabinpose.app.live.feed import EveryFrame
from cabinpose.app.live.run import Live
from cabinpose.app.serve import start_server
from cabinpose.core import IMAGES, FrameBatch, PoseBatch
from cabinpose.core.errors import ConfigError, DatasetError, RemoteError, SourceEndedError
from cabinpose.estimate.remote import open_predictor
from cabinpose.evaluate import predict_dataset
from cabinpose.signals import Counts, HostClock, Sample, ToFFrame
from cabinpose.store import PartWriter, create_dataset, empty_batch, open_dataset

Run = Callable[..., Any]
Start = Callable[..., tuple[Any, str]]
NUMPY = {"FP32": "<f4", "FP64": "<f8", "UINT16": "<u2", "UINT8": "u1"}
SIX = ("depth", "amplitude", "noise", "depth_styled", "labels", "rgb")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames with all images that a detector can be given; read only."""
    path = tmp_path_factory.mktemp("images") / "dataset"
    more = ("noise", "depth_styled", "rgb", "nir")
    manifest = sphere_people.manifest(frames=3)
    manifest = manifest.model_copy(update={"variables": (*manifest.variables, *more)})
    with create_dataset(path, manifest) as writer:
        for plan in writer.missing():
            with PartWriter(path, plan, manifest) as part:
                for index in range(plan.first, plan.first + plan.frames):
                    rng = np.random.default_rng(index)
                    frame = sphere_people.frame(index, manifest)
                    size = frame["depth"].shape
                    part.append(
                        frame
                        | {
                            "noise": rng.integers(0, 60_000, size).astype(np.uint16),
                            "depth_styled": np.float32(frame["depth"] + 0.01),
                            "rgb": rng.integers(0, 256, (*size, 3)).astype(np.uint8),
                            "nir": rng.integers(0, 60_000, size).astype(np.uint16),
                        }
                    )
    return path


def arrays_of(request: Any, keys: dict[str, str]) -> dict[str, np.ndarray]:
    """The tensors of a request, read with numpy alone; keys: of the regions that were registered, by name."""
    raw, found = iter(request.raw_input_contents), {}
    for tensor in request.inputs:
        if "shared_memory_region" in tensor.parameters:
            data = keys[tensor.parameters["shared_memory_region"].string_param]
            offset = tensor.parameters["shared_memory_offset"].int64_param
            bytes_ = data[offset : offset + tensor.parameters["shared_memory_byte_size"].int64_param]
        else:
            bytes_ = next(raw)
        found[tensor.name] = np.frombuffer(bytes_, NUMPY[tensor.datatype]).reshape(tensor.shape)
    return found


class Keeper:
    """What a server keeps of its requests: the arrays at the time of the call, since a region is written anew for each frame."""

    def __init__(self, algorithm: Start, inputs: list[str], *, shared: bool = False) -> None:
        self.seen: list[dict[str, np.ndarray]] = []
        self._regions: dict[str, np.memmap[Any, Any]] = {}
        self.by_memory = 0
        offer = service_pb2.ServerMetadataResponse(extensions=["system_shared_memory"] if shared else [])
        _, self.address = algorithm(
            inputs=inputs, ServerMetadata=lambda *_: offer, SystemSharedMemoryRegister=self._register,
            SystemSharedMemoryUnregister=lambda *_: service_pb2.SystemSharedMemoryUnregisterResponse(), ModelInfer=self._infer,
        )  # fmt: skip

    def _register(self, request: Any, context: Any) -> Any:
        self._regions[request.name] = np.memmap(f"/dev/shm{request.key}", np.uint8, "r", shape=(request.byte_size,))
        return service_pb2.SystemSharedMemoryRegisterResponse()

    def _infer(self, request: Any, context: Any) -> Any:
        self.by_memory += any("shared_memory_region" in tensor.parameters for tensor in request.inputs)
        regions = {name: bytes(region) for name, region in self._regions.items()}
        found = arrays_of(request, regions)
        if request.id != "empty":
            self.seen.append(found)
        return response_of(request, good_answer(request))


def of_the_dataset(folder: Path, name: str, row: int) -> np.ndarray:
    """An image as the files hold it, by zarr's own decoding: depths in ticks of 0.1 mm, 0 = invalid, become float32 metres."""
    arrays = [np.asarray(zarr.open_array(part / name)[:]) for part in sorted(folder.glob("part-*.zarr"))]
    values = np.concatenate(arrays)[row]
    if name.startswith("depth"):
        metres = values * np.float32(1e-4)
        metres[values == 0] = np.nan
        return metres
    return values


@pytest.mark.parametrize("way", ["the server lists them", "the address", "an option", "shared memory"])
def test_six_images_into_one_foreign_algorithm(way: str, algorithm: Start, run: Run, folder: Path, tmp_path: Path) -> None:
    """Each of three frames arrives byte for byte, over the wire and in shared memory, whoever chose the images."""
    told = way in ("the server lists them", "shared memory")
    images = [*SIX, "cloud"]
    server = Keeper(algorithm, [*images, "camera_k"] if told else [], shared=way == "shared memory")
    address = server.address + (f"?images={','.join(images)}" if way == "the address" else "")
    option = ["--images", *images] if way == "an option" else []
    done = run("predict", folder, "--model", address, *option, "--out", tmp_path / "a.jsonl")
    assert done.code == 0, done.err
    assert server.by_memory == (4 if way == "shared memory" else 0)  # with the empty one, from which names are learnt
    assert len(server.seen) == 3
    dataset = open_dataset(folder)
    for row, seen in enumerate(server.seen):
        assert set(seen) - {"camera_dist"} == {*images, "camera_k"}
        for name in SIX:
            held = of_the_dataset(folder, name, row)
            assert seen[name].dtype == held.dtype
            assert seen[name].tobytes() == held[None].tobytes(), name
            assert seen[name].tobytes() == dataset[name][row].values.tobytes(), name
        depth, k = of_the_dataset(folder, "depth", row).astype(float), seen["camera_k"][0]
        v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
        points = np.stack([(u - k[0, 2]) / k[0, 0] * depth, (v - k[1, 2]) / k[1, 1] * depth, depth], axis=-1)
        assert seen["cloud"].dtype == np.float32
        np.testing.assert_allclose(seen["cloud"][0], points, rtol=1e-6, atol=1e-7)


@pytest.mark.slow
def test_what_synth_makes_goes_to_a_foreign_algorithm(algorithm: Start, run: Run, tmp_path: Path) -> None:
    """A dataset from the command line: colour, the camera's noise and styled depth beside depth, amplitude and labels."""
    rng = np.random.default_rng(3)
    depth_m = (1.5 + rng.normal(0.0, 0.01, (96, 128))).astype(np.float32)
    np.savez(tmp_path / "style.npz", depth_m=depth_m, regions=np.zeros(depth_m.shape, np.uint8))
    made = run(
        "synth", "--frames", 4, "--out", tmp_path / "made", "--style", tmp_path / "style.npz", "--workers", 1,
        "images={renderer: raster}", "output.noise=true", "style.steps=2",
    )  # fmt: skip
    assert made.code == 0, made.err
    server = Keeper(algorithm, [*SIX, "cloud", "camera_k"])
    done = run("predict", tmp_path / "made", "--model", server.address, "--out", tmp_path / "a.jsonl")
    assert done.code == 0, done.err
    assert len(server.seen) == 4
    for row, seen in enumerate(server.seen):
        for name in SIX:
            held = of_the_dataset(tmp_path / "made", name, row)
            assert len(np.unique(held)) > 10
            assert seen[name].tobytes() == held[None].tobytes(), name
        assert seen["depth"].tobytes() != seen["depth_styled"].tobytes()
        np.testing.assert_array_equal(seen["cloud"][0, ..., 2], seen["depth"][0])


def test_every_image_has_a_tensor_of_the_datasets_type(folder: Path, algorithm: Start) -> None:
    server = Keeper(algorithm, list(IMAGES))
    dataset = open_dataset(folder)
    remote = open_predictor(server.address)
    assert remote.images == tuple(name for name in IMAGES if name != "amplitude")  # which is sent where a camera has it
    predict_dataset(dataset, remote)
    for name in IMAGES[:-1]:
        assert server.seen[2][name][0].tobytes() == dataset[name][2].values.tobytes(), name


def test_a_choice_of_the_user_leaves_out_the_rest(algorithm: Start, run: Run, folder: Path) -> None:
    server = Keeper(algorithm, [*SIX, "camera_k", "camera_dist"])
    assert run("evaluate", folder, "--model", server.address, "--images", "rgb", "labels", "--resamples", 0).code == 0
    assert [list(seen) for seen in server.seen] == [["camera_k", "camera_dist", "labels", "rgb"]] * 3


def test_evaluate_and_live_of_a_dataset_send_the_same(algorithm: Start, run: Run, folder: Path) -> None:
    server = Keeper(algorithm, [])
    for command in (("evaluate", folder, "--resamples", 0), ("live", "--source", folder)):
        done = run(*command, "--model", server.address, "--images", *SIX, "cloud")
        assert done.code == 0, done.err
    assert len(server.seen) == 6
    for first, second in zip(server.seen[:3], server.seen[3:], strict=True):
        assert {n: a.tobytes() for n, a in first.items()} == {n: a.tobytes() for n, a in second.items()}


# ----------------------------------------------------------------------------------------------------------- refused


def test_what_the_source_lacks_is_refused_before_the_first_frame(algorithm: Start, run: Run, tmp_path: Path) -> None:
    plain = sphere_people.write(tmp_path / "plain", sphere_people.manifest(frames=2))
    server = Keeper(algorithm, ["depth", "rgb", "noise"])
    for command in (("predict", plain, "--out", tmp_path / "a.jsonl"), ("evaluate", plain), ("live", "--source", plain)):
        done = run(*command, "--model", server.address)
        assert done.code == 2
        assert "has no noise, rgb for theirs to see" in done.err
        assert "hint: it has depth, amplitude, confidence, labels, cloud" in done.err
    assert not server.seen
    assert not (tmp_path / "a.jsonl").exists()


def test_a_camera_has_no_colour(algorithm: Start, run: Run, folder: Path) -> None:
    server = Keeper(algorithm, [])
    done = run("live", "--source", "simulated", "--set", f"dataset={folder}", "--model", f"{server.address}?images=depth,rgb")
    assert done.code == 2
    assert "error: simulated has no rgb for theirs to see" in done.err
    assert "hint: it has depth, amplitude, confidence, noise, cloud" in done.err
    assert not server.seen


def test_an_image_that_the_server_does_not_take(algorithm: Start) -> None:
    server = Keeper(algorithm, ["depth", "camera_k"])
    with pytest.raises(RemoteError, match="the model takes no labels, rgb") as caught:
        open_predictor(server.address, ["depth", "rgb", "labels"])
    assert caught.value.hint == "its inputs are depth, camera_k"


def test_names_that_are_none(run: Run, folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="unknown image 'color'"):
        open_predictor("grpc://127.0.0.1:1/m?images=color")
    with pytest.raises(ConfigError, match="the image rgb is named twice"):
        open_predictor("grpc://127.0.0.1:1/m", ["rgb", "rgb"])
    done = run("predict", folder, "--model", "in_car", "--images", "rgb", "--out", tmp_path / "a.jsonl")
    assert done.code == 2
    assert "--images rgb is for models on servers: ours read what they were trained on" in done.err


# ------------------------------------------------------------------------------------------------------ other ways in


class Camera:
    """A camera of two frames, the second without the camera's own noise; it ends by itself."""

    name = "camera"

    def __init__(self) -> None:
        self.counts, self.numbers = Counts(), itertools.count()
        self.frames = [
            ToFFrame(
                np.full((4, 6), 5000 + number, np.uint16), 1e-4, np.full((4, 6), 70 + number, np.uint16),
                np.full((4, 6), 9, np.uint8), np.array([[5.0, 0, 2.5], [0, 5, 1.5], [0, 0, 1]]), np.zeros(5), np.zeros(5),
                noise=np.full((4, 6), 1200, np.uint16) if number == 0 else np.zeros((0, 0), np.uint16),
            )
            for number in range(2)
        ]  # fmt: skip

    def check(self) -> list[str]:
        return []

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass

    def read(self, timeout_s: float) -> list[Sample]:
        if (number := next(self.numbers)) == len(self.frames):
            raise SourceEndedError("over", hint="")
        return [Sample(number, HostClock().now_ns(), None, b"", (self.frames[number],))]


def test_live_frames_of_a_camera_go_with_their_cloud(algorithm: Start) -> None:
    server = Keeper(algorithm, ["depth", "amplitude", "cloud", "confidence"])
    camera = Camera()
    list(Live(EveryFrame(camera, HostClock()), [open_predictor(server.address)]).run())
    for seen, frame in zip(server.seen, camera.frames, strict=True):
        assert seen["amplitude"].tobytes() == frame.amplitude.tobytes()
        assert seen["confidence"].tobytes() == frame.confidence.tobytes()
        np.testing.assert_array_equal(seen["depth"][0], np.float32(1e-4) * frame.depth)
        np.testing.assert_allclose(seen["cloud"][0, 3, 5], np.array([0.5, 0.3, 1.0]) * seen["depth"][0, 3, 5], rtol=1e-6)


def test_a_frame_without_an_image_that_others_have_is_told(algorithm: Start) -> None:
    server = Keeper(algorithm, ["noise"])
    live = Live(EveryFrame(Camera(), HostClock()), [open_predictor(server.address)]).run()
    next(live)
    assert np.unique(server.seen[0]["noise"]).tolist() == [1200]
    with pytest.raises(RemoteError, match="it has no noise"):
        next(live)


class Coloured:
    """A detector of somebody's in Python that reads colour and cloud."""

    name, persons, joints, images = "coloured", ("driver",), ("head",), ("rgb", "cloud")

    def __init__(self) -> None:
        self.seen: list[FrameBatch] = []

    def predict(self, frames: FrameBatch) -> PoseBatch:
        self.seen.append(frames)
        return empty_batch(len(frames["rgb"]), 1, 1)


def test_a_detector_in_python_says_what_it_reads(folder: Path) -> None:
    """In this process, live, and served to others, whose client learns it from the metadata."""
    dataset, model = open_dataset(folder), Coloured()
    predict_dataset(dataset, model)
    here = model.seen.pop()
    list(Live(EveryFrame(Camera(), HostClock()), []).run())
    with pytest.raises(DatasetError, match="camera has no rgb for coloured to see"):
        Live(EveryFrame(Camera(), HostClock()), [model])
    running = start_server(model)
    try:
        remote = open_predictor(running.address)
        assert remote.images == ("depth", "rgb", "cloud")
        model.seen.clear()
        predict_dataset(dataset, remote)
    finally:
        running.stop()
    for row, frames in enumerate(model.seen):
        for name in ("rgb", "cloud", "depth"):
            assert frames[name].tobytes() == here[name][row].tobytes()


def test_a_report_of_python_takes_the_address(folder: Path, algorithm: Start) -> None:
    server = Keeper(algorithm, [])
    report = cabinpose.evaluate_predictions(folder, f"{server.address}?images=rgb")
    assert json.dumps(report.to_dict(), default=float)
    assert [sorted(seen) for seen in server.seen] == [["camera_dist", "camera_k", "rgb"]] * 3
