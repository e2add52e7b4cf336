"""The parts of all pages: what is text stays text, and places in charts are those of the values."""

from __future__ import annotations

import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cabinpose.app.report.charts import Axis, Margins, Plot, nice_step, series_chart
from cabinpose.app.report.html import Html, document, el, join, section, table, tiles, with_small

TEXT = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=30)


@given(TEXT, TEXT)
def test_text_comes_back_from_an_element(words: str, value: str) -> None:
    found = ET.fromstring(el("text", words, el("b", words), class_=value, stroke_width=1.25, x=None))
    assert (found.text or "") == words
    assert (found[0].text or "") == words
    assert found.attrib == {"class": value, "stroke-width": "1.2"}


def test_text_is_escaped_in_every_part() -> None:
    hostile = '</td><script>alert(1)</script>&"'
    parts = [
        document(hostile, hostile, hostile, [section(hostile, Html("<i></i>"), hostile)]),
        table([[hostile, hostile], [hostile, with_small(hostile, hostile)]]),
        tiles([(hostile, hostile, hostile, (hostile,), "")]),
        series_chart(hostile, hostile, {hostile: ([0, 1], [0, 1])}),
        join((hostile, Html("<b>"))),
    ]
    assert not any("<script" in part for part in parts)
    assert parts[-1].endswith("<b>")


def test_nothing_is_drawn_of_nothing() -> None:
    assert section("title", table([["", "a"]])) == ""
    assert "<svg" in series_chart("empty", "s", {"a": ([], [])})


@pytest.mark.parametrize("log", [False, True])
def test_a_value_is_at_its_place(log: bool) -> None:
    plot = Plot("", (200, 100), Axis(0, 10), Axis(1, 100, log), Margins(left=20, right=10, bottom=15))
    assert plot.at(0, 1) == pytest.approx((20, 85))
    assert plot.at(10, 100) == pytest.approx((190, 4))
    across, down = plot.at(5, 10 if log else 50.5)
    assert (across, down) == pytest.approx((105, (85 + 4) / 2))


def test_a_line_breaks_where_a_value_is_missing() -> None:
    chart = series_chart("", "s", {"a": ([0, 1, 2, 3], [1, np.nan, 2, 3])})
    path = re.search(r'd="([^"]*)"', chart)
    assert path is not None
    assert re.findall("[ML]", path[1]) == ["M", "M", "L"]


@pytest.mark.parametrize(("step", "nice"), [(0.9, 1), (1.0, 1), (1.1, 2), (2.5, 5), (6, 10), (0.031, 0.05)])
def test_steps_are_round(step: float, nice: float) -> None:
    assert nice_step(step) == pytest.approx(nice)
