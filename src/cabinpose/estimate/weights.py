"""The weights of an exported compact network, to go on training from them.

The exporter folds a norm into the convolution before it and keeps the product alone. Here such a norm begins as the identity
with the folded bias; `measure_norms` then gives it the statistics of what it is fed, and the scale and shift that undo them, so
that the network answers as before and training normalises from where inference stands.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple, cast

import onnx
import torch
from torch import Tensor, nn

from cabinpose.core import ModelError
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.half import widen
from cabinpose.estimate.onnx_model import OnnxModel

_EPS = 1e-5  # of nn.BatchNorm2d


class Exported(NamedTuple):
    """The settings of an exported network, its parameters and statistics by torch's names, the names of its folded norms, and
    ranges of the frames that it was trained on by dataset.
    """

    settings: Any
    state: dict[str, Tensor]
    folded: tuple[str, ...]
    trained_on: dict[str, str]


def read_weights(path: Path) -> Exported:
    """The weights in an ONNX file of `cabinpose export`. Raises ModelError for another method, and for a quantised file."""
    model = OnnxModel(path, threads=1)
    if not model.method.reads_onnx:
        raise ModelError(f"{path} is a model of {model.method.name}", hint="begin with a checkpoint of it")
    file = onnx.load(str(path))
    widen(file)
    graph = file.graph
    if any(node.op_type == "DequantizeLinear" for node in graph.node):
        raise ModelError(f"{path} is quantised", hint="begin with the float32 model that it was made of")
    arrays = {i.name: torch.from_numpy(onnx.numpy_helper.to_array(i).copy()) for i in graph.initializer}
    state = {re.sub(r"^(_network\.)+", "", name): value for name, value in arrays.items() if not name.startswith("onnx::")}
    folded = []
    for node in graph.node:
        module, given = _module(node.name), [arrays[name] for name in node.input if name.startswith("onnx::") and name in arrays]
        if not given or f"{module}.weight" in state:  # the second time in a mirrored model's graph
            continue
        if node.op_type == "MatMul":
            state[f"{module}.weight"] = given[0].T.contiguous()
        elif node.op_type == "Conv" and (before := re.fullmatch(r"(.+\.)(\d+)", module)):
            weight, bias = given
            norm = f"{before[1]}{int(before[2]) + 1}"
            values = weight, torch.ones_like(bias), bias, torch.zeros_like(bias), torch.full_like(bias, 1 - _EPS)
            names = (f"{module}.weight", *(f"{norm}.{n}" for n in ("weight", "bias", "running_mean", "running_var")))
            state |= dict(zip(names, values, strict=True))
            folded.append(norm)
    return Exported(model.config, state, tuple(folded), model.trained_on)


def _module(node: str) -> str:
    """The torch module of a node: stem.3.mix.0 of /_network/_network/stem/stem.3/mix/mix.0/Conv, also where it runs again."""
    path: list[str] = []
    for part in node.removeprefix("/").split("/")[:-1]:
        if path and part.startswith(f"{path[-1]}."):  # a child of a sequence carries its name
            path.pop()
        path.append(part)
    return re.sub(r"_\d+$", "", ".".join(part for part in path if part != "_network"))


@torch.no_grad()
def measure_norms(network: nn.Module, names: Iterable[str], batches: Iterable[Batch]) -> None:
    """Give identity norms the mean and variance of their inputs over some batches; the network in eval mode answers the same.

    Raises ValueError without batches.
    """
    norms = {name: cast(nn.BatchNorm2d, network.get_submodule(name)) for name in names}
    sums = dict.fromkeys(norms, (torch.zeros(()), torch.zeros(()), 0))

    def adder(name: str) -> Callable[[nn.Module, tuple[Tensor, ...]], None]:
        def add(_: nn.Module, inputs: tuple[Tensor, ...]) -> None:
            one, two, count = sums[name]
            x = inputs[0].double()
            sums[name] = one + x.sum((0, 2, 3)), two + (x * x).sum((0, 2, 3)), count + x[:, 0].numel()

        return add

    hooks = [norm.register_forward_pre_hook(adder(name)) for name, norm in norms.items()]
    training = network.training
    network.eval()
    for batch in batches:
        network(*batch.images(cast(Any, network).config.inputs))
    network.train(training)
    for hook in hooks:
        hook.remove()
    for name, (one, two, count) in sums.items():
        if not count:
            raise ValueError("norms are measured on frames")
        norm, mean = norms[name], one / count
        variance = (two / count - mean * mean).clamp(min=0)
        cast(Tensor, norm.running_mean).copy_(mean)
        cast(Tensor, norm.running_var).copy_(variance)
        norm.weight.copy_(torch.sqrt(variance + norm.eps))
        norm.bias.add_(mean)
