"""The picture of a training run: both losses where they belong, the best epoch and the stop."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cabinpose.app.report.html import Html
from cabinpose.app.report.raster import curves_chart, write_curves, write_svg

ROWS = [{"train_loss": 9.5 - i, "val_loss": v} for i, v in enumerate([9.0, 6.0, math.nan, 8.0])]


def lines(chart: Html) -> dict[str, np.ndarray]:
    """The points (px) of each line by its name."""
    return {
        str(path.findtext("title")): np.array([list(map(float, p)) for p in re.findall(r"([\d.]+),([\d.]+)", path.attrib["d"])])
        for path in ET.fromstring(chart).iter("path")
    }


def words(chart: Html) -> list[str]:
    return [text.text or "" for text in ET.fromstring(chart).iter("text")]


def test_losses_best_epoch_and_stop() -> None:
    chart = curves_chart(ROWS, 1, "val_loss", True)
    drawn = lines(chart)
    training, validation = drawn["training loss"], drawn["validation loss"]
    assert len(validation) == 3  # a gap
    np.testing.assert_allclose(np.diff(training[:, 0]), np.diff(training[:, 0])[0], atol=0.11)
    slope = np.diff(training[:, 1])
    np.testing.assert_allclose(slope, slope[0], atol=0.11)
    assert slope[0] > 0  # it fell: down is greater
    np.testing.assert_allclose((validation[1] - validation[0])[1] / slope[0], 3, atol=0.02)
    assert {"best: val_loss 6", "stop", "epoch"} <= set(words(chart))
    upright = {line.attrib["x1"] for line in ET.fromstring(chart).iter("line") if line.attrib["x1"] == line.attrib["x2"]}
    assert {f"{training[1, 0]:.1f}", f"{training[3, 0]:.1f}"} <= upright
    assert "stop" not in words(curves_chart(ROWS, None, "val_loss", False))


def test_wide_losses_are_logarithmic() -> None:
    chart = curves_chart([{"train_loss": loss} for loss in (100.0, 10.0, 1.0)], None, "val_auc", False)
    heights = lines(chart)["training loss"][:, 1]
    assert np.diff(heights) == pytest.approx(np.diff(heights)[0], abs=0.11)
    assert {"1", "2", "5", "10", "20", "50", "100"} <= set(words(chart))


@pytest.mark.parametrize("rows", [ROWS[:1], [{}]])
def test_short_runs_have_a_picture(rows: list[dict[str, float]], tmp_path: Path) -> None:
    write_curves(tmp_path / "curves.png", rows, None, "val_loss", True)
    assert Image.open(tmp_path / "curves.png").size == (960, 2 * (260 + 28))
    assert [path.name for path in tmp_path.iterdir()] == ["curves.png"]


def test_every_line_has_its_name_and_its_own_colour_also_of_many(tmp_path: Path) -> None:
    names = [f"without part {number}" for number in range(16)]
    write_svg(tmp_path / "a.svg", curves_chart(ROWS, None, "", False), names)
    strip = next(iter(ET.parse(tmp_path / "a.svg").getroot().iter("{http://www.w3.org/2000/svg}svg")))[1][0]
    assert [text.text for text in strip if text.tag.endswith("text")] == names
    boxes = [part.attrib for part in strip if part.tag.endswith("rect")]
    assert len({box["fill"] for box in boxes}) == len({(box["x"], box["y"]) for box in boxes}) == len(names)
    assert float(strip.attrib["viewBox"].split()[2]) < 800
