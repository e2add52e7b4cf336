"""From a style frame and a generated dataset to a model that styles frames, with what it does to frames it has not seen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy import ndimage

from cabinpose.core import Bools, ConfigError, DatasetError, Floats32
from cabinpose.synth.streams import check_seed
from cabinpose.synth.style.encoder import DETAIL_PX, Loss, StyleLoss, encoder_of
from cabinpose.synth.style.frame import REGIONS, StyleFrame, guides_of
from cabinpose.synth.style.settings import Style
from cabinpose.synth.style.stage import FrameStyler, inputs_of
from cabinpose.synth.style.transfer import Content, style_loss, train, write_network

_NEEDED = ("depth", "depth_clean", "labels", "instance")
_HELD_OUT = 8  # frames, or a fifth of the dataset


class Noise(NamedTuple):
    """Of a region. sigma_mm: of the deviations from the local mean · grain: their correlation from pixel to pixel in a row."""

    sigma_mm: float
    grain: float


@dataclass(frozen=True)
class StyleReport:
    """What a model does to frames that it was not trained on.

    noise: by region that the style has: of the style frame, the frames and the frames styled · style_loss: before and after ·
    edge_px, part_mm: the farthest in any frame, as `LabelShift` has them · lost: share of the valid pixels, over all frames.
    """

    frames: int
    noise: Mapping[str, tuple[Noise, Noise, Noise]]
    style_loss: tuple[float, float]
    edge_px: float
    part_mm: float
    lost: float


def fit_style(
    style: StyleFrame,
    dataset: xr.Dataset,
    out: Path,
    *,
    steps: int,
    seed: int,
    vgg19: str | None,
    report: Callable[[int, Loss], None],
) -> StyleReport:
    """Train a model and write it as ONNX.

    Parameters
    ----------
    style
        The real frame.
    dataset
        Of `cabinpose synth`: `depth` is what is styled, `depth_clean` and `labels` say where silhouettes and regions are.
    out
        The file.
    steps
        Frames that training looks at, one each.
    seed
        Of everything drawn.
    vgg19
        torchvision's weights; None for the package's own encoder.
    report
        Called after each step.

    Raises
    ------
    ConfigError, DatasetError, ModelError
        For too few frames or steps, for a seed that is none, for a dataset without these images, or other weights.
    """
    lacking = [name for name in _NEEDED if name not in dataset]
    if lacking:
        raise DatasetError(f"the dataset has no {' and no '.join(lacking)}", hint="train on a dataset of `cabinpose synth`")
    count = dataset.sizes["frame"]
    held_out = min(_HELD_OUT, count // 5)
    if held_out < 1 or steps < 1:
        raise ConfigError(f"cannot train {steps} steps on {count} frames", hint="give 5 frames or more, and a step or more")
    check_seed(seed)
    loss = style_loss(style, encoder_of(vgg19))
    rng = np.random.Generator(np.random.Philox(key=seed))
    network = train(_drawn(dataset, count - held_out, steps, rng=rng), steps, loss, seed=seed, report=report)
    write_network(network, out, {"style": style.name, "steps": steps, "seed": seed, "frames": count - held_out})
    return _judged(style, dataset, range(count - held_out, count), out, loss, rng=rng)


def _drawn(dataset: xr.Dataset, count: int, steps: int, *, rng: np.random.Generator) -> Iterator[Content]:
    """Frames in random order, half of them mirrored."""
    for _ in range(steps):
        inputs = _inputs(_frame(dataset, int(rng.integers(count))), rng=rng)
        yield Content.of({n: np.ascontiguousarray(a[..., ::-1]) for n, a in inputs.items()} if rng.random() < 0.5 else inputs)


def _frame(dataset: xr.Dataset, index: int) -> dict[str, Any]:
    return {name: dataset[name][index].values for name in _NEEDED}


def _inputs(frame: Mapping[str, Any], *, rng: np.random.Generator) -> dict[str, Floats32]:
    return inputs_of(frame["depth"], guides_of(frame["labels"], frame["depth_clean"]), rng=rng)


def _judged(
    style: StyleFrame, dataset: xr.Dataset, indices: range, model: Path, loss: StyleLoss, *, rng: np.random.Generator
) -> StyleReport:
    styler = FrameStyler(Style(by=str(model), most_edge_px=1e9, most_part_mm=1e9))
    losses, noise, shifts = [], [], []
    for index in indices:
        frame = _frame(dataset, index)
        found = styler.take(**frame, rng=rng)
        guides = guides_of(frame["labels"], frame["depth_clean"])
        pair = [Content.of(inputs_of(depth, guides, rng=rng)) for depth in (frame["depth"], found["depth_styled"])]
        regions = pair[0].regions()
        losses.append([float(loss(c.shown(), regions, loss.content(c.shown())).style) for c in pair])
        noise.append([[noise_of(depth, guide > 0) for depth in (frame["depth"], found["depth_styled"])] for guide in guides[:-1]])
        shifts.append((found["style_edge_px"], found["style_part_mm"], found["style_lost"]))
    theirs = np.where(style.valid, style.depth_m, np.nan)
    mean = np.ma.masked_invalid(noise).mean(axis=0).filled(np.nan)  # (region, before and after, 2)
    return StyleReport(
        frames=len(indices),
        noise={
            name: (noise_of(theirs, style.guides[r] > 0), Noise(*mean[r, 0].tolist()), Noise(*mean[r, 1].tolist()))
            for r, name in enumerate(REGIONS)
            if style.guides[r].any()
        },
        style_loss=tuple(np.mean(losses, axis=0).tolist()),
        edge_px=max(shift[0] for shift in shifts),
        part_mm=max(shift[1] for shift in shifts),
        lost=float(np.mean([shift[2] for shift in shifts])),
    )


def noise_of(depth_m: Floats32, where: Bools) -> Noise:
    """The noise of a depth (H, W), NaN where invalid, in some pixels; NaN where there are none."""
    valid = np.isfinite(depth_m)
    share = ndimage.uniform_filter(valid.astype(np.float64), DETAIL_PX)
    mean = ndimage.uniform_filter(np.nan_to_num(depth_m).astype(np.float64), DETAIL_PX) / np.maximum(share, 1e-3)
    detail = np.where(valid & where & (share > 0.9), depth_m - mean, np.nan)
    pairs = np.stack([detail[:, :-1], detail[:, 1:]])[:, np.isfinite(detail[:, :-1] + detail[:, 1:])]
    if not pairs.size:
        return Noise(np.nan, np.nan)
    sigma = 1.4826 * float(np.median(np.abs(pairs)))
    pairs = np.clip(pairs, -3 * sigma, 3 * sigma)  # creases and what is left of edges are not noise
    return Noise(1e3 * sigma, float(np.corrcoef(pairs)[0, 1]))
