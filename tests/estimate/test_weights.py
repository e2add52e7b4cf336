"""The weights of an exported model answer as it does, and training normalises from where inference stands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
import small
import torch
from torch import nn

from cabinpose.core.errors import ModelError
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.compact.model import Mirrored
from cabinpose.estimate.data import StoredFrames, collate
from cabinpose.estimate.export import export_onnx
from cabinpose.estimate.half import widen
from cabinpose.estimate.onnx_model import OnnxModel, packaged_models
from cabinpose.estimate.train_config import Machines, Start, TrainConfig
from cabinpose.estimate.training import Detector, begin_with, fit, frame_spec, load_detector
from cabinpose.estimate.weights import read_weights

FRAMES = 4
ONE = Machines(1)


def config(**settings: object) -> TrainConfig:
    return TrainConfig(method="compact", settings={**small.TINY["compact"], **settings}, epochs=1, batch=3, average=0.0)


def frames(run: TrainConfig) -> StoredFrames:
    return StoredFrames(small.dataset(FRAMES), frame_spec(run))


def answers(model: nn.Module, batch: Batch) -> dict[str, np.ndarray]:
    with torch.no_grad():
        votes = model(batch.depth, batch.amplitude)
    return {name: getattr(votes, name).numpy() for name in ("joints", "inside", "visible", "present")}


@pytest.mark.slow
@pytest.mark.parametrize("mirrored", [False, True])
def test_torch_answers_as_the_file_that_it_is_read_from(checkpoints: dict[str, Path], tmp_path: Path, mirrored: bool) -> None:
    path = tmp_path / "model.onnx"
    export_onnx(checkpoints["compact"], path, name="small", card={}, mirrored=mirrored)
    detector = Detector(config())
    begin_with(detector, path, list(frames(config())))
    batch = collate(list(frames(config())))
    network = Mirrored(detector.network) if mirrored else detector.network
    wanted = OnnxModel(path, threads=1).outputs({"depth": batch.depth.numpy(), "amplitude": batch.amplitude.numpy()})
    for name, got in answers(network.eval(), batch).items():
        np.testing.assert_allclose(got, wanted[name], atol=1e-4)
    arrays = [i.raw_data for i in onnx.load(str(path)).graph.initializer if i.name.startswith("onnx::")]
    assert len(arrays) == len(set(arrays)) > 10  # a mirrored model does not hold its weights twice
    original = load_detector(checkpoints["compact"]).network.state_dict()
    for name, value in detector.network.state_dict().items():
        if "looks." in name or "depthwise" in name or "votes" in name:  # what no norm was folded into
            torch.testing.assert_close(value, original[name])


def test_the_packaged_model_can_be_begun_with_in_another_view() -> None:
    settings = OnnxModel(packaged_models()["in_car"], threads=1).config.model_dump()
    run = TrainConfig(method="compact", settings={**settings, "width": 64, "height": 48, "looks_px": (4.0, 2.0, 1.5, 1.0, 0.5)})
    detector = Detector(run)
    some = list(frames(run))
    begin_with(detector, Path("in_car"), some)
    batch = collate(some)
    votes = detector.network.eval()(batch.depth, batch.amplitude)
    torch.testing.assert_close(votes.joints, votes.earlier[-1], rtol=0, atol=0)  # a look that is new changes nothing


@pytest.mark.parametrize("mirrored", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_halved_weights_are_the_nearest_of_half_precision(checkpoints: dict[str, Path], tmp_path: Path, mirrored: bool) -> None:
    paths = {half: tmp_path / f"{half}.onnx" for half in (False, True)}
    for half, path in paths.items():
        export_onnx(checkpoints["compact"], path, name="small", card={}, mirrored=mirrored, half=half)
    assert paths[True].stat().st_size < 0.75 * paths[False].stat().st_size
    whole, halved = (read_weights(path) for path in (paths[False], paths[True]))
    assert list(halved.state) == list(whole.state)
    rounded = 0
    for name, value in whole.state.items():
        if not torch.equal(halved.state[name], value):
            torch.testing.assert_close(halved.state[name], value.half().float(), rtol=0, atol=0)
            rounded += value.numel()
    assert rounded > 0.8 * sum(value.numel() for value in whole.state.values())
    files = [onnx.load(str(path)) for path in paths.values()]
    widen(files[1])
    assert [n.op_type for n in files[0].graph.node] == [n.op_type for n in files[1].graph.node]
    onnx.save(files[1], str(tmp_path / "widened.onnx"))
    batch = collate(list(frames(config())))
    seen = {"depth": batch.depth.numpy(), "amplitude": batch.amplitude.numpy()}
    one, other = (OnnxModel(path, threads=1).outputs(seen) for path in (paths[True], tmp_path / "widened.onnx"))
    for name, wanted in other.items():
        np.testing.assert_allclose(one[name], wanted, atol=1e-6)


def test_norms_have_the_statistics_of_what_they_see(trained: dict[str, Path]) -> None:
    """Fed the very frames that they were measured on, layers in training mode normalise as in eval mode."""
    detector = Detector(config())
    batch = collate(list(frames(config())))
    seen: dict[str, torch.Tensor] = {}
    norms = {name: m for name, m in detector.network.named_modules() if isinstance(m, nn.BatchNorm2d) and name != "deep.1.norm"}
    for name, norm in norms.items():
        norm.register_forward_pre_hook(lambda _, inputs, name=name: seen.update({name: inputs[0].clone()}))
    begin_with(detector, trained["compact"], list(frames(config())))
    assert detector.network.training
    answers(detector.network.eval(), batch)
    assert len(norms) > 10
    for name, norm in norms.items():
        torch.testing.assert_close(norm.running_mean, seen[name].mean((0, 2, 3)), atol=1e-5, rtol=1e-4)
        torch.testing.assert_close(norm.running_var, seen[name].var((0, 2, 3), unbiased=False), atol=1e-6, rtol=1e-3)
        torch.testing.assert_close(norm.train()(seen[name]), norm.eval()(seen[name]), atol=1e-4, rtol=1e-3)


def test_a_run_goes_on_from_a_file(checkpoints: dict[str, Path], trained: dict[str, Path], tmp_path: Path) -> None:
    """With a rate that moves nothing, the run ends with the weights of the file."""
    run = config().model_copy(update={"learning_rate": 1e-12, "weight_decay": 0.0})
    begun = load_detector(fit(run, frames(run), frames(run), tmp_path, start=Start(init=trained["compact"]), machines=ONE))
    wanted = load_detector(checkpoints["compact"]).network.votes.weight
    torch.testing.assert_close(begun.network.votes.weight, wanted, atol=1e-8, rtol=0)


@pytest.mark.parametrize("change", [{"channels": (4, 4, 8, 16)}, {"channels": (4, 4, 8, 16), "slots": ("driver",)}])
def test_other_networks_are_refused_by_what_differs(trained: dict[str, Path], change: dict[str, object]) -> None:
    with pytest.raises(ModelError, match=f"another network: {next(iter(change))}"):
        begin_with(Detector(config(**change)), trained["compact"], [])


def test_what_holds_no_float_weights_of_compact_is_refused(trained: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="is a model of paf"):
        begin_with(Detector(config()), trained["paf"], [])
    model = onnx.load(str(trained["compact"]))
    model.graph.node.append(onnx.helper.make_node("DequantizeLinear", ["small", "scale"], ["unused"]))
    model.graph.initializer.extend(
        onnx.numpy_helper.from_array(value, name)
        for value, name in ((np.zeros(3, np.int8), "small"), (np.array(0.5, np.float32), "scale"))
    )
    onnx.save(model, str(tmp_path / "int8.onnx"))
    with pytest.raises(ModelError, match="is quantised"):
        begin_with(Detector(config()), tmp_path / "int8.onnx", [])
