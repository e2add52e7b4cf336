"""From a checkpoint to an ONNX file that runs without torch and answers the same."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor, nn

from cabinpose.core import ModelError, make_folder, whole_file
from cabinpose.estimate.array_model import ArrayModel, rewrite
from cabinpose.estimate.half import halve
from cabinpose.estimate.onnx_model import JOINT_DEFINITION, METADATA_KEY, TRAINED_ON, TrainedModel, open_session
from cabinpose.estimate.tasks import TASKS
from cabinpose.estimate.training import Detector, load_detector

TOLERANCE = 1e-4  # greatest difference between torch and ONNX Runtime: px, m or logits; of values above 1 their share
_OPSET = 18
# Of ONNX Runtime's optimisers those that make other layers of the network's, whose names `read_weights` goes by.
_FUSIONS = (
    "ConvAddFusion", "ConvBNFusion", "ConvMulFusion", "GemmSumFusion", "GemmTransposeFusion", "MatMulAddFusion", "MatmulBNFusion",
    "PadFusion", "TransposeOptimizer",
)  # fmt: skip


class _Named(nn.Module):
    """A network that returns only the outputs that are exported, in their order."""

    def __init__(self, network: nn.Module, outputs: tuple[str, ...]) -> None:
        super().__init__()
        self._network, self._outputs = network, outputs

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """The exported outputs."""
        values = self._network(*inputs)
        return tuple(getattr(values, name) for name in self._outputs)


def export_onnx(
    checkpoint: Path,
    out: Path,
    *,
    name: str,
    card: Mapping[str, Any],
    mirrored: bool = False,
    half: bool = False,
    overwrite: bool = False,
) -> float:
    """Write a checkpoint as ONNX.

    Parameters
    ----------
    checkpoint
        Of `cabinpose train`.
    out
        The file to write.
    name, card
        Go into the file's metadata, beside the method and its settings.
    mirrored
        The model answers with the mean over a frame and its mirror image.
    half
        Store the weights in half precision, once the float32 model has been compared with torch.
    overwrite
        Replace `out`.

    Returns
    -------
    float
        The greatest difference between torch and ONNX Runtime on a test batch, before weights are halved.

    Raises
    ------
    ModelError
        Where `out` exists, or where the two differ by more than `TOLERANCE`.
    ConfigError
        For a method that has no mirrored form.
    """
    if out.exists() and not overwrite:
        raise ModelError(f"{out} exists", hint="--overwrite replaces it")
    return write_onnx(load_detector(checkpoint), out, name=name, card=card, mirrored=mirrored, half=half)


def write_onnx(
    detector: Detector, out: Path, *, name: str, card: Mapping[str, Any], mirrored: bool = False, half: bool = False
) -> float:
    """As `export_onnx`, of a detector in memory; replaces `out`."""
    method, config = detector.method, detector.method_config
    answering = method.mirrored(detector.network) if mirrored else detector.network
    network = _Named(answering, method.outputs).eval()
    examples = TASKS[method.task].examples(config, torch.Generator().manual_seed(0))
    make_folder(out.parent)
    with whole_file(out, kind=ModelError) as partial:
        write_graph(network, examples, method.outputs, partial)
        model = onnx.load(str(partial))
        _share(model.graph)
        model = folded(model)
        settings = config.model_dump(mode="json")
        metadata = {"name": name, "method": method.name, "config": settings, "mirrored": mirrored, "card": dict(card)}
        metadata |= {TRAINED_ON: detector.trained_on, JOINT_DEFINITION: detector.joint_definition}
        onnx.helper.set_model_props(model, {METADATA_KEY: json.dumps(metadata)})
        onnx.save(model, str(partial))
        difference = _difference(network, partial, examples, method.outputs)
        if not difference <= TOLERANCE:
            raise ModelError(
                f"the exported model differs from torch by {difference:.2g}", hint="try another version of torch or onnxruntime"
            )
        if half:
            halve(model)
            onnx.save(model, str(partial))
    return difference


def write_copy(model: TrainedModel, out: Path, **more: Any) -> None:
    """Write the file of a trained model again with `more` in its metadata; it gets its name when it is whole."""
    metadata = model.metadata | more
    if isinstance(model, ArrayModel):
        rewrite(out, metadata, model.arrays)
        return
    copy = onnx.load(str(model.path))
    onnx.helper.set_model_props(copy, {METADATA_KEY: json.dumps(metadata)})
    with whole_file(out, kind=ModelError) as partial:
        onnx.save(copy, str(partial))


def write_graph(network: nn.Module, examples: Mapping[str, Tensor], outputs: Sequence[str], path: Path) -> None:
    """Trace a network with named example inputs (N, ...) to an ONNX file that takes any number of frames N."""
    with warnings.catch_warnings():
        # The exporter that traces is deprecated, and needs nothing beside torch and onnx; the newer one does.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network, tuple(examples.values()), str(path), input_names=list(examples), output_names=list(outputs),
            dynamo=False, opset_version=_OPSET, dynamic_axes={n: {0: "frames"} for n in (*examples, *outputs)},
        )  # fmt: skip


def _share(graph: onnx.GraphProto) -> None:
    """Keep once what the exporter has folded anew for each pass of a mirrored network."""
    first: dict[tuple[Any, ...], str] = {}
    other = {}
    for array in [i for i in graph.initializer if i.name.startswith("onnx::")]:
        name = first.setdefault((array.data_type, *array.dims, array.raw_data), array.name)
        if name != array.name:
            other[array.name] = name
            graph.initializer.remove(array)
    for node in graph.node:
        node.input[:] = [other.get(name, name) for name in node.input]


def folded(model: onnx.ModelProto) -> onnx.ModelProto:
    """A float32 model with what depends on no input worked out, so that it opens in three quarters of the time.

    It answers the same bytes. Its layers and weights keep their names, and what was worked out becomes `Constant` nodes:
    initialisers are weights, to `halve` and `read_weights`.
    """
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
    with TemporaryDirectory() as folder:
        options.optimized_model_filepath = str(Path(folder) / "folded.onnx")
        onnxruntime.InferenceSession(
            model.SerializeToString(), options, providers=["CPUExecutionProvider"], disabled_optimizers=_FUSIONS
        )
        result = onnx.load(options.optimized_model_filepath)
    result.ir_version = model.ir_version
    del result.opset_import[:]  # the runtime's own operators are listed as well, and none is used
    result.opset_import.extend(model.opset_import)
    graph, weights = result.graph, {array.name for array in model.graph.initializer}
    arrays, nodes = list(graph.initializer), list(graph.node)
    known = [onnx.helper.make_node("Constant", [], [array.name], value=array) for array in arrays if array.name not in weights]
    del graph.initializer[:], graph.node[:]
    graph.initializer.extend(array for array in arrays if array.name in weights)
    graph.node.extend([*known, *nodes])
    return result


@torch.no_grad()
def _difference(network: nn.Module, path: Path, examples: Mapping[str, Tensor], outputs: Sequence[str]) -> float:
    """The greatest difference between torch and ONNX Runtime over all outputs, for all examples and for the first alone.

    Of values above 1 it is their share: a joint at 150 px in float32 is known to no more than 1e-5 px, less what sums lose.
    """
    session = open_session(path)
    greatest = 0.0
    for count in (None, 1):  # a network that has only learnt its example's size fails here
        some = {name: value[:count] for name, value in examples.items()}
        theirs = session.run(list(outputs), {name: value.numpy() for name, value in some.items()})
        ours = network(*some.values())
        apart = [np.abs(a.numpy() - b) / np.maximum(np.abs(b), 1.0) for a, b in zip(ours, theirs, strict=True)]
        greatest = max(greatest, *(float(a.max()) for a in apart))
    return greatest
