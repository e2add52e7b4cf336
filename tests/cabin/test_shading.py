"""Vertex normals: smooth within the crease angle, split beyond it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cabinpose.core import Floats
from cabinpose.scene.cabin import Solid, slab
from cabinpose.scene.cabin.shading import CREASE, to_surface
from cabinpose.scene.cabin.shapes import rounded_box


def _wavy() -> Solid:
    """A sheet with thin rims: smooth within, creased around."""
    s, t = np.meshgrid(np.linspace(0.0, 1.0, 9), np.linspace(0.0, 1.0, 11), indexing="ij")
    low = 0.12 * np.sin(9.0 * s) * np.cos(7.0 * t)
    return slab(np.stack((s, t, low), axis=-1), np.stack((s, t, low + 0.01), axis=-1))


def _by_hand(solid: Solid) -> Floats:
    """(F, 3, 3) normals of all corners, one corner after the other."""
    points = solid.vertices.astype(np.float32).astype(np.float64)[solid.faces]
    normal = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    result = np.zeros((len(points), 3, 3))
    for face, corner in np.ndindex(len(points), 3):
        for other, place in zip(*np.nonzero(solid.faces == solid.faces[face, corner]), strict=True):
            if float(normal[face] @ normal[other]) > math.cos(CREASE):
                here, following, before = points[other][[place, (place + 1) % 3, (place + 2) % 3]]
                one, two = following - here, before - here
                angle = math.acos(float(one @ two) / float(np.linalg.norm(one) * np.linalg.norm(two)))
                result[face, corner] += angle * normal[other]
    return result / np.linalg.norm(result, axis=2, keepdims=True)


@pytest.mark.parametrize(
    ("solid", "split"),
    [(_wavy(), True), (rounded_box((0.3, 0.2, 0.1), 0.03, (2, 2, 1), corner=2), False)],
    ids=["sheet", "box"],
)
def test_corners_take_the_mean_normal_of_faces_that_bend_away_by_less_than_the_crease(solid: Solid, *, split: bool) -> None:
    """Against a loop over corners; corners that agree share a vertex, so some are a step of its grid off."""
    surface = to_surface(solid, "blanket", "wool")
    assert np.abs(surface.normals[surface.faces] - _by_hand(solid)).max() < 0.003
    assert (len(surface.vertices) > len(solid.vertices)) == split
