"""How far heads, chests and feet of those who sit in front are from airbag, wheel and dashboard.

Points of the bare skin are held against the triangles of the parts: of each part of the body those that are nearest to the box
around the part of the car, and some all over it. docs/dataset.md says how far this is from all of the skin.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Floats32, Ints, Matrix, apply, invert
from cabinpose.scene import Surface, merge
from cabinpose.scene.body import SEGMENTS, vertex_segments
from cabinpose.scene.cabin import STATIC_GROUP, Cabin
from cabinpose.scene.contact import WHEEL_GROUP, TriangleMesh, triangle_mesh
from cabinpose.store import AXES
from cabinpose.synth.scene import Scene, ScenePerson

_SEGMENT_OF = MappingProxyType({"head": "head", "chest": "thorax", "left_foot": "lfoot", "right_foot": "rfoot"})
_FRONT = ("driver", "front_passenger")
_AIRBAG_HALF_M = 0.20  # of the dashboard before a passenger's seat, to either side of its middle: where its airbag is, assumed
_LOOKED_AT = 400  # vertices of a part of the body, evenly taken
_NEAREST, _SPREAD = 16, 8  # of them
_OF_FEET = ("dashboard",)  # feet lie on it; how far they are from the wheel says nothing of them
_FAR_M = 3.0  # beyond every distance in a car
_CELL_M = MappingProxyType({WHEEL_GROUP: 0.03, STATIC_GROUP: 0.06})  # of search grids: the dashboard's triangles are larger


class _Hazard(NamedTuple):
    """A part of a car that people are held against. group: that it moves with · low, high: (3,) m of its box in that frame."""

    name: str
    group: str
    mesh: TriangleMesh
    low: Floats
    high: Floats


def _hazard(name: str, group: str, surface: Surface) -> _Hazard:
    mesh = triangle_mesh(surface.vertices, surface.faces, closed=False, cell_m=_CELL_M[group])
    return _Hazard(name, group, mesh, mesh.low, mesh.high)


@lru_cache(maxsize=64)
def _hazards(cabin: Cabin) -> dict[str, tuple[_Hazard, ...]]:
    """By slot. Each is made once for a car."""
    parts = {part.name: part.surface for part in cabin.parts}
    wheel, cover, board = (
        [p.surface for p in cabin.parts if p.group == WHEEL_GROUP],
        parts.get("airbag cover"),
        parts.get("dashboard"),
    )
    shared = [_hazard("wheel", WHEEL_GROUP, merge(wheel))] if wheel else []
    if board is not None:
        shared.append(_hazard("dashboard", STATIC_GROUP, board))
    found = dict.fromkeys(_FRONT, tuple(shared))
    if cover is not None:
        found["driver"] += (_hazard("airbag", WHEEL_GROUP, cover),)
    if board is not None and "front_passenger" in cabin.seats:
        beside = np.abs(board.vertices[:, 1] - cabin.seats["front_passenger"].design_h_point[1]) <= _AIRBAG_HALF_M
        before = board.faces[beside[board.faces].all(axis=1)]
        if len(before):
            found["front_passenger"] += (_hazard("airbag", STATIC_GROUP, replace(board, faces=before)),)
    return found


@lru_cache(maxsize=1)
def _rows() -> dict[str, Ints]:
    """Vertices of the skin that belong to each part of the body."""
    segment = vertex_segments()
    rows = {part: np.flatnonzero(segment == SEGMENTS.index(name)) for part, name in _SEGMENT_OF.items()}
    return {part: all_rows[:: max(1, len(all_rows) // _LOOKED_AT)] for part, all_rows in rows.items()}


def distance_labels(scene: Scene, slots: tuple[str, ...]) -> dict[str, Floats32]:
    """`distance` (P, 4, 3) m of the dataset standard; NaN of who does not sit in front, and of what a car does not have."""
    result = np.full((len(slots), len(AXES["body_part"]), len(AXES["hazard"])), np.nan, np.float32)
    if scene.cabin is not None:
        hazards = _hazards(scene.cabin)
        wheel = scene.cabin.vehicle_from_wheel(scene.wheel_angle)
        wheel_from_vehicle = None if wheel is None else invert(wheel)
        for who in scene.people:
            if who.slot in _FRONT:
                _of_person(who, hazards[who.slot], wheel_from_vehicle, out=result[slots.index(who.slot)])
    return {"distance": result}


def _of_person(who: ScenePerson, hazards: tuple[_Hazard, ...], wheel_from_vehicle: Matrix | None, *, out: Floats32) -> None:
    """Into (4, 3) m."""
    for row, part in enumerate(AXES["body_part"]):
        points = {STATIC_GROUP: who.posed.skin[_rows()[part]].astype(np.float64)}
        if wheel_from_vehicle is not None and "foot" not in part:
            points[WHEEL_GROUP] = apply(wheel_from_vehicle, points[STATIC_GROUP])
        middles = {group: each.mean(axis=0) for group, each in points.items()}
        for hazard in hazards:
            if hazard.name in _OF_FEET or "foot" not in part:
                out[row, AXES["hazard"].index(hazard.name)] = _distance(points[hazard.group], middles[hazard.group], hazard)


def _distance(points: Floats, middle: Floats, hazard: _Hazard) -> float:
    """The least distance (m) of points (N, 3) about a middle (3,), in the frame of a part of the car, from it."""
    x, y, z = (points - np.minimum(np.maximum(middle, hazard.low), hazard.high)).T
    squared = x * x + y * y + z * z
    looked_at = squared <= np.sort(squared)[_NEAREST - 1]
    looked_at[:: max(1, len(points) // _SPREAD)] = True
    chosen = points[looked_at]
    # No point is nearer to the triangles than to their box: only few of the points have to be held against them.
    x, y, z = (chosen - np.minimum(np.maximum(chosen, hazard.low), hazard.high)).T
    from_box = x * x + y * y + z * z
    first = np.argmin(from_box)
    bound = float(hazard.mesh.signed_distance(chosen[first : first + 1], _FAR_M)[0])
    nearer = from_box < bound * bound
    nearer[first] = False
    others = hazard.mesh.signed_distance(chosen[nearer], bound)
    return min([bound, *others.tolist()])
