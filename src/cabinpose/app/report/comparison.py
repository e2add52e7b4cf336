"""The page of `experiment compare`: Table 6.1 for each test, the joints one by one, speed and size of each model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cabinpose.app.report.html import Html, document, el, section, table
from cabinpose.evaluate import ALL, Report, Value

# Equations 6.3 to 6.6 of the thesis as printed, then the reading of the last two that its published numbers fit.
METRICS = (
    ("mAD cm", "mAD", None), ("mAD10cm cm", "mAD@d", None), ("mAP10cm %", "mAP@d (literal)", None),
    ("mAR %", "mAR@d (literal)", None), ("mAP10cm %, among detected", "mAP@d (among detected)", None),
    ("mAR %, detected", "mAR (detected)", None), ("all joints within 10 cm, %", "PCK", 10.0),
)  # fmt: skip
_NOTE = (
    "mAD, mAD10cm, mAP10cm and mAR by equations 6.3 to 6.6 as printed: a joint that is found farther than 10 cm is no false "
    "positive but a false negative. Among detected, and detected: the readings that the thesis' own numbers fit. Means over "
    "the joints."
)


def table_rows(reports: Mapping[str, Report], facts: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Table 6.1 with the methods as columns; facts: of each method `poses_per_s` and `bytes`."""
    rows = [["", *reports]]
    rows += [[title, *(_number(r.value(metric, threshold=at)) for r in reports.values())] for title, metric, at in METRICS]
    rows.append(["poses/s of CPU time", *(f"{facts[name]['poses_per_s']:.0f}" for name in reports)])
    return [*rows, ["size, MB", *(f"{facts[name]['bytes'] / 1e6:.2f}" for name in reports)]]


def joint_rows(reports: Mapping[str, Report]) -> list[list[str]]:
    """mAD (cm) and mAR (%) of each joint, as printed, with the methods as columns."""
    rows = [["mAD cm, mAR %", *reports]]
    for joint in next(iter(reports.values())).joint_sets[ALL]:
        pairs = ([r.value(metric, joints=joint) for metric in ("mAD", "mAR@d (literal)")] for r in reports.values())
        rows.append([joint, *(", ".join(map(_number, pair)) for pair in pairs)])
    return rows


def comparison_html(tests: Mapping[str, Mapping[str, Report]], facts: Mapping[str, Any], notes: Sequence[str]) -> str:
    """The page over all tests; the one of each test, with boxes by joint, is in the folder of its name."""
    sections = []
    for name, reports in tests.items():
        link = el("p", el("a", "curves, boxes by joint, all numbers", href=f"{name}/index.html"))
        body = table(table_rows(reports, facts[name])) + link + el("h3", "Joint by joint") + table(joint_rows(reports))
        sections.append(section(f"{name}: {next(iter(reports.values())).frames} frames", Html(body), _NOTE))
    sections.append(section("Models", "".join(el("p", note) for note in notes)))
    methods = ", ".join(next(iter(tests.values())))
    return document("Methods compared", "Methods compared", methods, sections)


def _number(value: Value | None) -> str:
    return "–" if value is None or not np.isfinite(value.value) else f"{value.value:.2f}"
