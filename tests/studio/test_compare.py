"""The Compare tab's chart of joints over frames, and skeletons in its cloud."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="needs the extra `studio`")

from cabinpose.app.studio.joint_chart import column, joint_chart
from cabinpose.app.studio.view3d import skeleton_lines
from cabinpose.evaluate import FrameDistances

NONE, MISSED = np.nan, np.inf
DISTANCES = FrameDistances(
    "3d", ("head", "lhand", "rhand", "neck"), np.array([4, 5, 9]),
    np.array([[1.0, NONE, 3, 2], [12, MISSED, 3, 2], [30, 4, 3, 2]]), np.zeros(3), 10.0,
)  # fmt: skip


def test_chart_has_every_joint_in_every_frame() -> None:
    chart = joint_chart(DISTANCES, {})
    heat, *lines, ghost = chart["series"]
    cells = {(frame, joint): d for frame, joint, d in heat["data"]}
    assert len(cells) == 11  # one does not count
    assert (cells[0, 0], cells[1, 0], cells[2, 1]) == (1, 12, 4)

    def told(value: float) -> str:
        tests = {"lt": value.__lt__, "lte": value.__le__, "gt": value.__gt__, "gte": value.__ge__}
        (piece,) = [p for p in chart["visualMap"]["pieces"] if all(tests[k](p[k]) for k in tests if k in p)]
        return str(piece["label"])

    assert [told(float(cells[at])) for at in ((0, 0), (2, 1), (1, 0), (2, 0), (1, 1))] == [
        "up to half of Γt", "up to half of Γt", "above", "above twice Γt", "not found",
    ]  # fmt: skip
    assert [line["data"] for line in lines] == [[1, 12, 30], [None, None, 4], [3, 3, 3], [2, 2, 2]]
    assert chart["legend"]["selected"] == {"head": True, "lhand": True, "rhand": True, "neck": False}
    assert ghost["markLine"]["data"][0]["yAxis"] == 10
    assert [axis["data"] for axis in chart["xAxis"]] == [[4, 5, 9]] * 2


def test_a_click_is_that_of_a_column() -> None:
    assert column(SimpleNamespace(value=[7, 2, 3.1], data_index=40)) == 7
    assert column(SimpleNamespace(value=3.1, data_index=40)) == 40


def test_skeletons_have_the_limbs_whose_ends_are_there() -> None:
    person = np.array([[0.0, 0, 1], [0, 1, 1], [np.nan, 0, 0]])
    drawn = skeleton_lines(person, [(0, 1), (1, 2)], "#abcdef")
    assert drawn == {"colour": "#abcdef", "lines": [[[0, 0, 1], [0, 1, 1]]], "joints": [[0, 0, 1], [0, 1, 1]]}
