"""The page of `cabinpose align`: how well suit and optical system agree on the head, over each take and in pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cabinpose.app.report.charts import legend, series_chart
from cabinpose.app.report.frames import drawing
from cabinpose.app.report.html import document, el, figure, section
from cabinpose.app.view.sheet import caption
from cabinpose.core import CABINPOSE, make_folder, write_whole
from cabinpose.store import open_dataset

_SHOWN = 2  # best and worst frames of each take
_NONE = np.zeros((0, len(CABINPOSE.joints), 2), np.float32)


def write_head_page(folder: Path, takes: Sequence[tuple[int, str, str, str]], out: Path) -> None:
    """Write one HTML file of an aligned dataset.

    Parameters
    ----------
    folder
        The dataset, with `head_residual`.
    takes
        Sequence, recording, subject and place (the person coordinate) of each person in each of its takes.
    out
        The file; one that is there is replaced.
    """
    dataset = open_dataset(folder)
    lines, pictures = {}, []
    for sequence, recording, subject, place in takes:
        frames = np.flatnonzero(dataset["sequence"].values == sequence)
        apart = np.degrees(dataset["head_residual"].sel(person=place).values[frames])
        seconds = (dataset["sync_ns"].values[frames] - dataset["sync_ns"].values[frames[0]]) / 1e9
        name = f"{recording}, {subject}"
        lines[name] = seconds.tolist(), apart.tolist()
        order = np.argsort(apart)
        for what, some in (("best", order[:_SHOWN]), ("worst", order[: -_SHOWN - 1 : -1])):
            for k in some:
                frame, title = dataset.isel(frame=int(frames[k])).load(), f"{name}: {what}, {apart[k]:.2f} deg"
                pictures.append(figure(drawing(frame, CABINPOSE, _NONE, (), False), f"{title}; {caption(frame)}"))
    chart = series_chart("angle between the two systems' heads, deg", "s", lines, size=(1240, 300))
    note = "One rotation for the whole take aligns the worlds of suit and optical system: a drift of the heading shows."
    count = len({sequence for sequence, *_ in takes})
    summary = f"{count} {'take' if count == 1 else 'takes'}, {dataset.sizes['frame']} frames"
    sections = [
        section("Over the takes", chart + legend(lines), note),
        section("Best and worst frames", el("div", *pictures, class_="frames")),
    ]
    make_folder(out.parent)
    write_whole(out, document(f"Heads: {folder.name}", "Agreement of the heads", summary, sections))
