"""The weights of another network to begin with: those that mean the same, and those of an exported compact network.

The exporter folds a norm into the convolution before it and keeps the product alone. Here such a norm begins as the identity
with the folded bias; `measure_norms` then gives it the statistics of what it is fed, and the scale and shift that undo them, so
that the network answers as before and training normalises from where inference stands.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import onnx
import torch
from torch import Tensor, nn

from cabinpose.core import ModelError
from cabinpose.estimate.batch import Batch
from cabinpose.estimate.half import widen
from cabinpose.estimate.methods import Layout
from cabinpose.estimate.onnx_model import OnnxModel

Axes = Mapping[int, Sequence[Hashable]]
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


class Taken(NamedTuple):
    """What a network has of another one: the share of its parameters, and in words what begins at random."""

    share: float
    fresh: tuple[str, ...]


@torch.no_grad()
def take_weights(network: nn.Module, state: Mapping[str, Tensor], mine: Layout, theirs: Layout) -> Taken:
    """Give a network the weights of another one, rows by what they stand for; the rest keeps its own.

    Parameters
    ----------
    network
        The network, whose rows `mine` tells.
    state
        Parameters and statistics of the other one, whose rows `theirs` tells.

    Raises
    ------
    ValueError
        For a tensor that the network does not have, or that has another size along an axis whose rows nobody tells.
    """
    own = network.state_dict()
    if unknown := [name for name in state if name not in own]:
        raise ValueError(f"there is no {unknown[0]}")
    parameters, lacking, took = dict(network.named_parameters()), [], 0
    for name, value in own.items():
        if name not in state:
            lacking += re.findall(r"^\w+(?:\.\d+)?", name) if name in parameters else []
            continue
        at = _shared_rows(name, value.shape, state[name].shape, mine.get(name, {}), theirs.get(name, {}))
        value[at.here] = state[name][at.there].to(value)
        took += value[at.here].numel() if name in parameters else 0
    known = {word for axes in theirs.values() for labels in axes.values() for word in _words(labels)}
    told = (word for axes in mine.values() for labels in axes.values() for word in _words(labels))
    fresh = dict.fromkeys((*(word for word in told if word not in known), *lacking))
    return Taken(took / sum(each.numel() for each in parameters.values()), tuple(fresh))


class _Rows(NamedTuple):
    """Where rows that stand for the same are in either tensor, as indices of all axes."""

    here: tuple[Tensor, ...]
    there: tuple[Tensor, ...]


def _shared_rows(name: str, here: Sequence[int], there: Sequence[int], mine: Axes, theirs: Axes) -> _Rows:
    if len(here) != len(there) or any(a != b for i, (a, b) in enumerate(zip(here, there, strict=True)) if i not in mine):
        raise ValueError(f"{name} is of another size")
    rows = []
    for axis, size in enumerate(here):
        labels, others = mine.get(axis, range(size)), theirs.get(axis, range(there[axis]))
        at = {label: i for i, label in enumerate(others)}
        rows.append([(i, at[label]) for i, label in enumerate(labels) if label in at])
    pairs = [torch.tensor(each, dtype=torch.long).reshape(-1, 2) for each in rows]
    shapes = [[-1 if i == axis else 1 for i in range(len(here))] for axis in range(len(here))]
    return _Rows(*(tuple(pair[:, k].reshape(shape) for pair, shape in zip(pairs, shapes, strict=True)) for k in (0, 1)))


def _words(label: object) -> Iterator[str]:
    """The names in what rows stand for."""
    if isinstance(label, str):
        yield label
    elif isinstance(label, Iterable):
        for each in label:
            yield from _words(each)


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
