"""The bench of the detectors times what it says, on frames and peers that are what it says. Nothing here looks at a clock."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from torch import nn

from benchmarks import detect
from benchmarks.fresh import fresh_detector, rendered_maps
from benchmarks.opening import opened
from benchmarks.peers import PEERS, Peer, RtmPose, parameters_of
from benchmarks.subjects import WARM, OurDetector, Run, Subject, figures, frame_batch, timed_run
from cabinpose.core.errors import ConfigError
from cabinpose.core.pose import OCCUPANT_SLOTS
from cabinpose.core.skeleton import JOINTS
from cabinpose.estimate import predictor as predictor_module
from cabinpose.estimate.data import FrameSpec, collate, view_frame
from cabinpose.estimate.paf.config import PafConfig
from cabinpose.estimate.paf.decode import decode
from cabinpose.estimate.paf.measure import measured
from cabinpose.estimate.predictor import load_model

SHOWN = 2


def bench(model: Sequence[str] = (), **flags: Any) -> dict[str, Any]:
    """A bench of one frame, but for what the flags say."""
    default = {"frames": 1, "repeats": 1, "threads": 1, "peer": (), "skip": (), "say": lambda _: None}
    return detect.run(model=model, **(default | flags))


@pytest.fixture(scope="module")
def frames() -> tuple[Any, ...]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(detect, "_SHOWN", SHOWN)
        return detect.bench_frames.__wrapped__("cabinpose")


@pytest.fixture(scope="module")
def model(frames: tuple[Any, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fresh_detector("compact", frames, tmp_path_factory.mktemp("fresh")).path


@pytest.fixture
def small_bench(frames: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """One method and one peer, on the frames that are there."""
    tiny = Peer(lambda: RtmPose(0.125, 0.167, size=(64, 64)), (64, 64), "a crop", 3.34, 0.36)
    monkeypatch.setattr(detect, "AIMS", {"compact": 60.0})
    monkeypatch.setattr("benchmarks.peers.PEERS", {"tiny": tiny})
    monkeypatch.setattr(detect, "bench_frames", lambda skeleton, view="": frames)
    monkeypatch.setattr(detect, "packaged_detectors", dict)


def macs(network: nn.Module, size: tuple[int, int]) -> float:
    """Multiplications of the convolutions and linear layers for one image, by the shapes that come out of them."""
    total = 0

    def count(layer: nn.Module, _: Any, out: torch.Tensor) -> None:
        nonlocal total
        weight: Any = layer.weight
        total += out.numel() * weight[0].numel()

    for layer in network.modules():
        if isinstance(layer, nn.Conv2d | nn.Linear):
            layer.register_forward_hook(count)
    with torch.no_grad():
        network.eval()(torch.zeros(1, 3, *size[::-1], device="meta"))
    return float(total)


def without_numbers(peer: Peer) -> nn.Module:
    """The network of shapes alone, which count as those of weights do, in no time."""
    with torch.device("meta"):
        return peer.network()


@pytest.mark.parametrize("name", sorted(PEERS))
def test_peers_have_the_published_size(name: str) -> None:
    peer = PEERS[name]
    network = without_numbers(peer)
    assert parameters_of(network) / 1e6 == pytest.approx(peer.parameters_m, rel=0.005)
    assert macs(network, peer.size) / 1e9 == pytest.approx(peer.macs_g, rel=0.02)


def test_the_papers_figures_of_lightweight_openpose() -> None:
    network = without_numbers(PEERS["lightweight_openpose"])
    assert round(parameters_of(network) / 1e6, 1) == 4.1
    assert round(macs(network, (368, 368)) / 1e9) == 9


def test_a_peer_runs_in_onnx_as_in_torch(tmp_path: Path) -> None:
    peer = PEERS["rtmpose_t"]
    peer.export(tmp_path / "peer.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "peer.onnx", providers=["CPUExecutionProvider"])
    image = np.random.default_rng(0).standard_normal((1, 3, 256, 192)).astype(np.float32)
    x, y = session.run(None, {"image": image})
    assert (x.shape, y.shape) == ((1, 17, 2 * 192), (1, 17, 2 * 256))
    torch.manual_seed(0)
    with torch.no_grad():
        ours = peer.network().eval()(torch.from_numpy(image))
    np.testing.assert_allclose(x, ours[0].numpy(), atol=1e-3)
    np.testing.assert_allclose(y, ours[1].numpy(), atol=1e-3)


def test_the_frames_show_two_people_at_the_sensors_resolution(frames: tuple[Any, ...]) -> None:
    assert len(frames) == SHOWN
    for frame in frames:
        assert frame["depth"].shape == frame["amplitude"].shape == (287, 352)
        assert [slot for slot, name in zip(OCCUPANT_SLOTS, frame["subject"], strict=True) if name] == [
            "driver",
            "front_passenger",
        ]
        assert frame["pov"] == "front_row"
    assert not np.array_equal(frames[0]["depth"], frames[1]["depth"])


def test_rendered_maps_are_assembled_to_the_people_of_the_frame(frames: tuple[Any, ...]) -> None:
    base = PafConfig()
    spec = FrameSpec(base.view, base.slots, base.joint_set.name, base.joints, amplitude=False)
    kept = [view_frame(frame, spec, range(len(OCCUPANT_SLOTS))) for frame in frames]
    config = measured(base, kept)
    for frame, k in zip(frames, kept, strict=True):
        found = decode(rendered_maps(collate([k]), config), config, {"depth": k.depth[None] * 1e-4})
        seen = k.present[:, None] & (k.visibility > 1)
        answered = np.isfinite(found.uv[0]).all(axis=-1)
        assert answered.sum() >= 0.9 * seen.sum() >= 18
        assert not answered[2:].any()
        error = np.linalg.norm(found.uv[0] - k.joints[..., :2], axis=-1)[answered]
        assert np.median(error) < 0.5
        columns = [JOINTS.index(name) for name in config.joints]
        apart = np.linalg.norm(found.joints_3d[0] - frame["joints_3d"][:, columns], axis=-1)
        assert np.nanmedian(apart[answered]) < 0.1


def test_what_is_timed_is_what_predict_does(frames: tuple[Any, ...], model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    predictor = load_model(model, threads=1)
    poses, made = predictor.poses, []
    monkeypatch.setattr(predictor, "poses", lambda *given: made.append(poses(*given)) or made[-1])
    subject = OurDetector(predictor, frames)
    for number in range(SHOWN + 1):
        assert len(subject.frame(number)) == len(subject.stages) == 4
    subject.batch()
    monkeypatch.undo()
    for number in range(SHOWN + 1):
        expected = predictor.predict(frame_batch([frames[number % SHOWN]]))
        np.testing.assert_array_equal(made[number].joints_3d, expected.joints_3d)
        np.testing.assert_array_equal(made[number].joints_2d, expected.joints_2d)
    assert made[-1].joints_3d.shape[0] == 16
    np.testing.assert_allclose(made[-1].joints_3d[SHOWN + 1], made[1].joints_3d[0], atol=1e-4)


def test_given_answers_are_decoded_in_place_of_the_networks(frames: tuple[Any, ...], model: Path) -> None:
    predictor = load_model(model, threads=1)
    given: list[Any] = []
    fake: Any = SimpleNamespace(
        seen=predictor.seen, poses=lambda *_: None, believed=lambda *_: None,
        model=SimpleNamespace(
            session=predictor.model.session, outputs=predictor.model.outputs, config=None,
            method=SimpleNamespace(decode=lambda outputs, *_: given.append(outputs)),
        ),
    )  # fmt: skip
    answers = [{"heat": np.full((1, 2), i)} for i in range(SHOWN)]
    subject = OurDetector(fake, frames, answers)
    subject.frame(SHOWN + 1)
    subject.batch()
    assert given[0] is answers[1]
    assert given[1]["heat"][:, 0].tolist() == [i % SHOWN for i in range(16)]


def test_warm_up_is_not_counted_and_figures_are_medians_of_runs() -> None:
    calls: list[int] = []

    class Clockwork(Subject):
        def __init__(self) -> None:
            super().__init__(None, ("input", "network"), {})

        def frame(self, number: int) -> tuple[float, ...]:
            calls.append(number)
            return (0.001, 100.0 if len(calls) <= WARM else 0.001 * (number + 1))

        def batch(self) -> float:
            return 0.002

    run = timed_run(Clockwork(), 3)
    assert calls == [*range(WARM), 0, 1, 2]
    np.testing.assert_allclose(run.seconds, [[0.001, 0.001], [0.001, 0.002], [0.001, 0.003]])
    slow = Run(run.seconds * 3, 0.006)
    slower = Run(run.seconds * 100, 0.2)
    result = figures(Clockwork(), [run, slower, slow])
    assert result["p50_ms"] == pytest.approx(9.0)
    assert result["p95_ms"] == pytest.approx(3 * (3 + 0.9))
    assert result["frames_per_s"] == pytest.approx(1 / 0.009)
    assert result["stages_ms"] == pytest.approx({"input": 3.0, "network": 6.0})
    assert result["frames_per_s_batch"] == pytest.approx(1 / 0.006)
    assert result["runs"] == pytest.approx([1 / 0.003, 1 / 0.3, 1 / 0.009])
    assert "frames_per_s_batch" not in figures(Clockwork(), [run._replace(batch_s=None)])


@pytest.mark.slow
@pytest.mark.usefixtures("small_bench")
def test_a_small_bench_has_every_figure(model: Path) -> None:
    said: list[str] = []
    result = bench([str(model)], frames=2, repeats=2, say=said.append)
    assert json.loads(json.dumps(result)) == result
    assert list(result["models"]) == ["compact", "compact_fresh"]
    assert list(result["peers"]) == ["tiny"]
    for name, weights in (("compact", "file"), ("compact_fresh", "fresh")):
        figures_ = result["models"][name]
        assert figures_["weights"] == weights
        assert (figures_["method"], figures_["aim"], figures_["people"], figures_["decodes"]) == ("compact", 60.0, 2, "own")
        assert (figures_["camera"], figures_["view"]) == ([352, 287], [176, 144])
        assert set(figures_["stages_ms"]) == {"input", "network", "decode", "checks"}
        assert 0 < figures_["p50_ms"] <= figures_["p95_ms"]
        assert len(figures_["runs"]) == 2
        assert figures_["frames_per_s_batch"] > 0
        assert figures_["peers_take"] == {"tiny": result["peers"]["tiny"]["p50_ms"] / figures_["p50_ms"]}
    assert result["models"]["compact_fresh"]["parameters"] > 100_000
    assert result["peers"]["tiny"]["parameters_m"] == 3.34
    assert result["runtime"]["intra_op_num_threads"] == 1
    assert result["runtime"]["providers"] == ["CPUExecutionProvider"]
    assert result["left_out"] == []
    assert set(result["load_average"]) == {"before", "after"}
    turns = [words.partition(": ")[2] for words in said if words.startswith("run ")]
    assert turns == ["compact", "compact_fresh", "tiny"] * 2


@pytest.mark.slow
@pytest.mark.usefixtures("small_bench")
def test_networks_in_files_are_peers_without_torch_as_well(model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detect, "find_spec", lambda name: None if name == "torch" else SimpleNamespace())
    file = tmp_path / "theirs.onnx"
    export = Peer(lambda: RtmPose(0.125, 0.167, size=(64, 96)), (64, 96), "a crop", 3.34, 0.36).export
    export(file)
    result = bench([str(model)], peer=[f"theirs={file}"], repeats=2)
    theirs = result["peers"]["theirs"]
    assert (theirs["input"], theirs["weights"]) == ([64, 96], "file")
    assert result["models"]["compact"]["peers_take"] == {"theirs": theirs["p50_ms"] / result["models"]["compact"]["p50_ms"]}
    for each in (theirs, result["models"]["compact"]):
        assert 0 < each["load_s"] < 60
        assert 1 < each["above_runtime_mb"] < 1000
    assert result["models"]["compact"]["import_s"] > 0
    for words in ("theirs", f"={file}", "theirs="):
        with pytest.raises(ConfigError, match="names no network of others"):
            bench([str(model)], peer=[words])
    with pytest.raises(ConfigError, match="takes inputs of shapes"):  # ours takes depth and amplitude of any number of frames
        bench([str(model)], peer=[f"ours={model}"])
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no graph")
    with pytest.raises(ConfigError, match="cannot be opened by itself"):
        opened("peer", broken, threads=1)


@pytest.mark.usefixtures("small_bench")
def test_without_torch_models_in_files_are_measured(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detect, "find_spec", lambda name: None if name == "torch" else SimpleNamespace())
    said: list[str] = []
    result = bench([str(model)], say=said.append)
    assert list(result["models"]) == ["compact"]
    assert result["peers"] == result["models"]["compact"]["peers_take"] == {}
    assert result["left_out"] == ["fresh", "peers"]
    assert "torch not installed" in said[0]
    assert bench([str(model)], skip=("fresh", "peers"))["left_out"] == []
    with pytest.raises(ConfigError, match="nothing to measure") as caught:
        bench()
    assert caught.value.hint


@pytest.mark.usefixtures("small_bench")
def test_the_packaged_models_are_measured(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detect, "packaged_detectors", lambda: {"in_car": model})
    monkeypatch.setattr(predictor_module, "packaged_models", lambda: {"in_car": model})
    result = bench(["in_car"], skip=("fresh", "peers"))
    assert list(result["models"]) == ["compact"]  # once, by the name in the file


@pytest.mark.usefixtures("small_bench")
def test_models_that_share_a_name_are_told_apart(model: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.onnx"
    copy.write_bytes(model.read_bytes())
    result = bench([str(model), str(copy)], skip=("fresh", "peers"))
    assert list(result["models"]) == [str(model), str(copy)]


def test_no_frames_no_runs_or_no_threads_are_refused() -> None:
    for nothing in ({"frames": 0}, {"repeats": 0}, {"threads": 0}):
        with pytest.raises(ConfigError, match="needs frames"):
            bench(**nothing)
