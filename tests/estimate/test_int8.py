"""A model in eight bits: what is quantised and what is not, by how much, and that it is a model as any other."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
import pytest
import small
from onnx import numpy_helper

from cabinpose.app.cli import main
from cabinpose.core import ConfigError, ModelError
from cabinpose.estimate import load_model
from cabinpose.estimate.export import export_onnx
from cabinpose.estimate.int8 import write_int8
from cabinpose.estimate.onnx_model import METADATA_KEY, OnnxModel
from cabinpose.evaluate import predict_dataset


@pytest.fixture(scope="module")
def mirrored(checkpoints: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A mirrored compact model with its weights in half precision, and in eight bits."""
    folder = tmp_path_factory.mktemp("int8")
    export_onnx(checkpoints["compact"], folder / "float.onnx", name="tiny", card={"data": "spheres"}, mirrored=True, half=True)
    write_int8(OnnxModel(folder / "float.onnx"), small.dataset(8), folder / "int8.onnx", frames=6)
    return {"float": folder / "float.onnx", "int8": folder / "int8.onnx"}


@pytest.mark.slow
def test_it_is_the_same_model_with_nearly_the_same_answers(mirrored: dict[str, Path]) -> None:
    said = [json.loads({p.key: p.value for p in onnx.load(str(path)).metadata_props}[METADATA_KEY]) for path in mirrored.values()]
    assert said[0] == said[1]
    one, other = (predict_dataset(small.dataset(8), load_model(path)) for path in mirrored.values())
    apart = np.abs(one.joints_2d - other.joints_2d)
    assert 0 < np.nanmedian(apart) < 0.5  # px of 64 x 48


def test_every_convolution_but_the_precise_ones_has_eight_bits_of_its_own(mirrored: dict[str, Path]) -> None:
    graph = onnx.load(str(mirrored["int8"])).graph
    arrays = {array.name: numpy_helper.to_array(array) for array in graph.initializer}
    feeds = {output: node for node in graph.node for output in node.output}
    kinds: dict[bool, set[bool]] = {True: set(), False: set()}
    weights = []
    for node in (node for node in graph.node if node.op_type == "Conv"):
        precise = any(f"/{name}" in node.name for name in ("votes", "looks", "present"))
        made = feeds.get(node.input[1])
        eight = made is not None and made.op_type == "DequantizeLinear"
        kinds[precise].add(eight)
        if eight:
            assert made is not None
            weights.append(made.input[0])
            assert arrays[made.input[0]].dtype == np.int8
    assert kinds == {True: {False}, False: {True}}
    assert len(set(weights)) == len(weights) > 20  # both passes of the mirrored network, which shared theirs


def test_weights_are_rounded_by_channel(mirrored: dict[str, Path]) -> None:
    """Against the float weights: each channel's greatest is 127 steps, and no weight is off by more than half a step."""
    floats = {
        numpy_helper.to_array(a).shape: numpy_helper.to_array(a) for a in onnx.load(str(mirrored["float"])).graph.initializer
    }
    graph = onnx.load(str(mirrored["int8"])).graph
    arrays = {array.name: numpy_helper.to_array(array) for array in graph.initializer}
    stem = next(node for node in graph.node if node.op_type == "Conv" and node.name.endswith("stem.0/Conv"))
    made = next(node for node in graph.node if stem.input[1] in node.output)
    quantised, scale = (arrays[name] for name in made.input[:2])
    true = floats[quantised.shape].astype(np.float64)
    step = np.abs(true).reshape(len(true), -1).max(axis=1) / 127
    np.testing.assert_allclose(scale, step, rtol=1e-3)
    assert (np.abs(quantised * step[:, None, None, None] - true) <= 0.51 * step[:, None, None, None]).all()


def test_what_cannot_be_is_refused(mirrored: dict[str, Path], trained: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "out.onnx"
    with pytest.raises(ConfigError, match="in eight bits already"):
        write_int8(OnnxModel(mirrored["int8"]), small.dataset(2), out)
    with pytest.raises(ConfigError, match="reads no images"):
        write_int8(OnnxModel(trained["lifting"]), small.dataset(2), out)
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [([], "is exported already"), (["--int8", "nowhere"], "nowhere"), (["--whole", "m", "--mirrored"], "without --mirrored")],
)
def test_an_exported_model_becomes_another_by_int8_or_whole_alone(
    mirrored: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    out = tmp_path / "out.onnx"
    assert main(["export", "onnx", str(mirrored["float"]), "--out", str(out), *options]) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()


def test_a_checkpoint_becomes_a_whole_graph_in_one_go(checkpoints: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "whole.onnx"
    assert main(["export", "onnx", str(checkpoints["compact"]), "--whole", "mm", "--name", "tiny", "--out", str(out)]) == 0
    with pytest.raises(ModelError, match="whole graph"):
        load_model(out)
    assert main(["export", "onnx", str(checkpoints["compact"]), "--whole", "mm", "--out", str(out)]) == 2  # it is there
