"""The Compare tab's chart of joints over frames, and skeletons in its cloud."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

pytest.importorskip("nicegui", reason="needs the extra `studio`")

from cabinpose.app.studio.joint_chart import column, joint_chart, places_chart
from cabinpose.app.studio.models import joint_places
from cabinpose.app.studio.view3d import skeleton_lines
from cabinpose.evaluate import EvaluationOptions, FrameDistances
from cabinpose.store import Predictions

NONE, MISSED = np.nan, np.inf
DISTANCES = FrameDistances(
    "3d", ("head", "lhand", "rhand", "neck"), np.array([4, 5, 9]),
    np.array([[1.0, NONE, 3, 2], [12, MISSED, 3, 2], [30, 4, 3, 2]]), np.zeros(3), 10.0,
)  # fmt: skip


def test_chart_has_every_joint_in_every_frame() -> None:
    chart = joint_chart(DISTANCES, "d")
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


def test_a_joint_is_shown_where_it_was_with_the_error_there() -> None:
    """Three frames of two seats, the camera 1 m before the vehicle's origin and turned: frame 1 finds nobody, one is hidden."""
    turned = np.eye(4)
    turned[:3, :3], turned[:3, 3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], (1, 0, 0)
    true = np.array([[[[0.1, 0.2, 1.0]], [[0.3, 0.2, 1.1]]]] * 3)  # (F, P, J, 3)
    dataset = xr.Dataset(
        {
            "joints_3d": (("frame", "person", "joint", "xyz"), true),
            "joints_2d": (("frame", "person", "joint", "uv"), 100 * true[..., :2]),
            "visibility": (("frame", "person", "joint"), np.array([[[4], [4]], [[4], [4]], [[4], [1]]], np.uint8)),
            "vehicle_from_camera": (("frame", "i", "k"), np.stack([turned] * 3)),
        },
        coords={"frame": [4, 5, 9], "person": ["driver", "front_passenger"], "joint": ["head"]},
    )  # fmt: skip
    given = true + (0.03, 0.04, 0)
    found = np.array([[[1.0], [1.0]], [[0.2], [0.2]], [[1.0], [1.0]]], np.float32)
    model = Predictions(
        (100 * given[..., :2]).astype(np.float32), given.astype(np.float32), found, found, frame=np.array([4, 5, 9]),
        persons=("driver", "front_passenger"), joints=("head",), model="m",
    )  # fmt: skip
    places = joint_places(dataset, model, "head", ("driver", "front_passenger"), EvaluationOptions())
    assert (places.axes, places.rows.tolist()) == ("xyz", [0, 0, 1, 1, 2])
    np.testing.assert_allclose(places.where[:2], [(2.0, -0.1, -0.2), (2.1, -0.3, -0.2)])
    np.testing.assert_allclose(places.error, [5, 5, np.inf, np.inf, 5], rtol=1e-5)
    chart = places_chart(places, "head", 10.0)
    assert [[row[:2] for row in series["data"]][1] for series in chart["series"]] == [[2.1, -0.3], [2.1, -0.2]]
    flat = joint_places(dataset, replace(model, joints_3d=np.full_like(given, np.nan)), "head", ("driver",), EvaluationOptions())
    assert (flat.axes, len(flat.rows)) == ("uv", 3)
    np.testing.assert_allclose(flat.error, [5, np.inf, 5], rtol=1e-5)


def test_skeletons_have_the_limbs_whose_ends_are_there() -> None:
    person = np.array([[0.0, 0, 1], [0, 1, 1], [np.nan, 0, 0]])
    drawn = skeleton_lines(person, [(0, 1), (1, 2)], "#abcdef")
    assert drawn == {"colour": "#abcdef", "lines": [[[0, 0, 1], [0, 1, 1]]], "joints": [[0, 0, 1], [0, 1, 1]]}
