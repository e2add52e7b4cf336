"""The page on segmentations: IoU by part, the confusion matrix, and frames with truth and answer side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.report.charts import COLOURS
from cabinpose.app.report.html import Html, document, el, figure, picture_uri, section, table, tiles, with_small
from cabinpose.app.view.draw import depth_image, depth_range
from cabinpose.app.view.sheet import caption
from cabinpose.core import Part, Segmenter, write_whole
from cabinpose.evaluate import PartsReport, PartsValue, pairs, trained_words
from cabinpose.store import Image, png, text

_BACKGROUND = (38, 40, 46)
_PAPER = (247, 248, 250)
_SHARE = 0.85  # of a class' colour, the rest is the depth image
_GAP, _HEAD = 8, 30
_GOLDEN = 0.618  # steps around the colour circle by which neighbours in a long list of parts differ
_PANELS = "depth, truth, answer"

Pictures = Sequence[tuple[str, Image]]  # captions, and pictures of depth, truth and answer side by side


def parts_page(reports: Sequence[PartsReport], typical: Mapping[str, Pictures], worst: Mapping[str, Pictures]) -> str:
    """The page on one or more segmentations of the same dataset; typical, worst: pictures of such frames by model."""
    sections = []
    for report in reports:
        title = f"{report.model}: " if len(reports) > 1 else ""
        sections += [
            section(
                f"{title}At a glance",
                tiles(_tile(v) for v in report.values if v.metric != "IoU" or v.classes == "people"),
                trained_words(report.trained_on, report.frames),
            ),
            section(f"{title}IoU by class, %", _iou_table(report), "Over all pixels of all frames. Small: 95 % interval."),
            section(
                f"{title}Confusion, % of the pixels of a true class", _confusion_table(report), "Rows: truth; columns: answer."
            ),
            section(f"{title}Typical frames ({_PANELS})", _figures(typical[report.model])),
            section(f"{title}Worst frames ({_PANELS})", _figures(worst[report.model])),
        ]
    names = ", ".join(r.model for r in reports)
    first = reports[0]
    return document(f"{names} on {first.dataset}", names, f"on {first.dataset}: {first.frames} frames", sections)


def pictures(dataset: xr.Dataset, model: Segmenter, numbers: Sequence[int]) -> Pictures:
    """Depth, truth and answer side by side, of the frames of these numbers."""
    colours = part_colours(model.parts)
    made = []
    for number in numbers:
        frame = dataset.sel(frame=[number])
        [(truth, answer)] = pairs(frame, model)
        shown = frame.isel(frame=0).load()
        depth = depth_image(shown["depth"].values, *depth_range(shown["depth"].values))
        made.append((caption(shown), _beside(depth, truth[0], answer[0], colours)))
    return made


def write_sheet(path: Path, parts: Sequence[Part], shown: Pictures) -> None:
    """A PNG of pictures below each other, with the colours of the parts above."""
    width = shown[0][1].shape[1]
    rows = [_legend(parts, width)]
    for words, picture in shown:
        strip = np.full((_HEAD, width, 3), _PAPER, np.uint8)
        text(strip, words, (4, _HEAD - 10))
        rows += [strip, picture]
    write_whole(path, png(np.concatenate(rows)))


def part_colours(parts: Sequence[Part]) -> NDArray[np.uint8]:
    """(1 + P, 3) RGB by number in a label image: those of the charts where they suffice, else spread over the colour circle."""
    if len(parts) < len(COLOURS):
        tints = [tuple(int(c[i : i + 2], 16) for i in (1, 3, 5)) for c in COLOURS[: len(parts)]]
    else:
        hue = np.arange(len(parts))[:, None] * _GOLDEN + np.array([0.0, 1 / 3, 2 / 3])
        tints = [tuple(row) for row in (140 + 100 * np.cos(2 * np.pi * hue)).astype(int).tolist()]
    return np.array([_BACKGROUND, *tints], np.uint8)


def _beside(depth: Image, truth: NDArray[np.uint8], answer: NDArray[np.uint8], colours: NDArray[np.uint8]) -> Image:
    grey = depth.mean(axis=-1, keepdims=True)
    gap = np.full((depth.shape[0], _GAP, 3), _PAPER, np.uint8)
    panels = [depth]
    for labels in (truth, answer):
        share = np.where(labels > 0, _SHARE, 0.0)[..., None]
        panels += [gap, (share * colours[labels] + (1 - share) * 0.5 * grey).astype(np.uint8)]
    return np.concatenate(panels, axis=1)


def _legend(parts: Sequence[Part], width: int) -> Image:
    colours = part_colours(parts)
    columns = max(width // 150, 1)
    strip = np.full((24 * -(-len(parts) // columns) + 8, width, 3), _PAPER, np.uint8)
    for i, part in enumerate(parts):
        x, y = 4 + 150 * (i % columns), 8 + 24 * (i // columns)
        strip[y : y + 12, x : x + 12] = colours[i + 1]
        text(strip, part.name.replace("_", " "), (x + 18, y + 11))
    return strip


def _tile(v: PartsValue) -> tuple[str, str, str, Sequence[str], str]:
    return f"{v.value:.1f}", "%", f"{v.metric}, {v.classes}", (_interval(v),), ""


def _interval(v: PartsValue) -> str:
    return f"{v.low:.1f} to {v.high:.1f}" if np.isfinite(v.low) else ""


def _iou_table(report: PartsReport) -> Html:
    shown = [v for v in report.values if v.metric == "IoU"]
    names = ["", *(v.classes.replace("_", " ") for v in shown)]
    return table([names, ["IoU", *(with_small(f"{v.value:.1f}", _interval(v)) for v in shown)]])


def _confusion_table(report: PartsReport) -> Html:
    counts = np.array(report.confusion, np.float64)
    shares = 100 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    names = [name.replace("_", " ") for name in report.classes]
    rows = [[name, *(_shaded(share) for share in row)] for name, row in zip(names, shares.tolist(), strict=True)]
    return table([["", *names, "pixels"], *([*row, int(n)] for row, n in zip(rows, counts.sum(axis=1), strict=True))])


def _shaded(share: float) -> Html:
    strength = min(share / 100, 1.0) ** 0.5
    return el("span", f"{share:.1f}", style=f"background: rgb(0 114 178 / {0.6 * strength:.2f}); padding: 2px 6px")


def _figures(shown: Pictures) -> str:
    return "".join(figure(el("img", src=picture_uri(picture), style="width: 100%"), words) for words, picture in shown)
