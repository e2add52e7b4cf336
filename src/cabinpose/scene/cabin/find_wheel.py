"""Finds the steering wheel of an unknown car mesh: a ring before a front seat, by its shape or by its name."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats
from cabinpose.scene.cabin.find_seats import FoundSeat
from cabinpose.scene.cabin.mesh_parts import piece_of_face
from cabinpose.scene.cabin.meshfile import NamedMesh

_DIAMETER = (0.30, 0.50)  # m, from a sports car's to a bus's
_ROUND, _FLAT = 0.80, 0.45  # of a ring: its smaller diameter, and its thickness, as a share of the larger one
_TILT = np.deg2rad((5.0, 80.0))  # the axis above the horizontal
_AHEAD, _ABOVE, _ASIDE = (0.20, 0.75), (0.05, 0.65), 0.15  # its centre from the H-point, m
_NAMES = ("steering", "volant", "lenkrad")


class FoundWheel(NamedTuple):
    """A steering wheel. centre: (3,) m · axis: (3,) unit, to the driver, both in vehicle axes · diameter_m, section_m ·
    seat: number of the seat that it is before · how: by what it was found.
    """

    centre: Floats
    axis: Floats
    diameter_m: float
    section_m: float
    seat: int
    how: str


def find_wheel(meshes: Sequence[NamedMesh], seats: Sequence[FoundSeat]) -> FoundWheel | None:
    """The steering wheel before one of the seats, or None. Vehicle axes, any origin."""
    named = [mesh for mesh in meshes if any(word in mesh.name.lower() for word in _NAMES)]
    for how, pieces in (("its name", _pieces(named)), ("its shape, a ring", _pieces(meshes))):
        rings = [ring for vertices in pieces if (ring := _ring(vertices, seats, how)) is not None]
        if rings:
            return max(rings, key=lambda ring: ring.diameter_m)
    return None


def _pieces(meshes: Sequence[NamedMesh]) -> Iterator[Floats]:
    """The vertices of each connected piece."""
    for mesh in meshes:
        piece = piece_of_face(mesh.vertices, mesh.faces)
        order = np.argsort(piece, kind="stable")
        for group in np.split(order, np.flatnonzero(np.diff(piece[order])) + 1):
            if len(group) >= 24:  # a ring of fewer triangles would be no ring
                yield mesh.vertices[np.unique(mesh.faces[group])]


def _ring(vertices: Floats, seats: Sequence[FoundSeat], how: str) -> FoundWheel | None:
    """The wheel that these vertices (V, 3) are the rim of, or None."""
    if np.ptp(vertices, axis=0).max() > 1.2 * _DIAMETER[1]:
        return None
    middle = vertices.mean(axis=0)
    _, _, axes = np.linalg.svd(vertices - middle, full_matrices=False)
    local = (vertices - middle) @ axes.T
    extent = np.ptp(local, axis=0)
    middle = middle + ((local.max(axis=0) + local.min(axis=0)) / 2) @ axes
    large, small, thick = extent
    axis = axes[2] * (1.0 if axes[2][2] > 0 else -1.0)  # a driver looks down on the wheel
    tilt = np.arcsin(np.clip(axis[2], -1.0, 1.0))
    if not (_DIAMETER[0] <= large <= _DIAMETER[1] and small > _ROUND * large and thick < _FLAT * large):
        return None
    if not _TILT[0] <= tilt <= _TILT[1]:
        return None
    for number, seat in enumerate(seats):
        ahead, left, above = (middle - seat.h_point) * ((-1, -1, 1) if seat.backward else (1, 1, 1))
        faces_driver = axis[0] * (-1 if seat.backward else 1) < 0 and abs(axis[1]) < 0.35
        if _AHEAD[0] < ahead < _AHEAD[1] and _ABOVE[0] < above < _ABOVE[1] and abs(left) < _ASIDE and faces_driver:
            return FoundWheel(middle, axis, float(large), _section(vertices, middle, axis, float(large)), number, how)
    return None


def _section(vertices: Floats, middle: Floats, axis: Floats, diameter: float) -> float:
    """Thickness of the rim, m: along the axis, of what is in the outer twelfth of the radius; at most 60 mm."""
    from_middle = vertices - middle
    along = from_middle @ axis
    radius = np.linalg.norm(from_middle - along[:, None] * axis, axis=1)
    return float(np.clip(np.ptp(along[radius > 0.92 * radius.max()]), 0.015, min(0.06, 0.2 * diameter)))
