"""How far heads, chests and feet of those who sit in front are from airbag, wheel and dashboard.

Points of the bare skin are held against the triangles of the parts: of each part of the body those that are nearest to the box
around the part of the car, and some all over it. docs/dataset.md says how far this is from all of the skin.
"""

from __future__ import annotations

import math
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from cabinpose.core import Floats, Floats32, Ints, apply, invert
from cabinpose.scene import merge
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
_FIRST = 1  # points that say how far the others need be looked for


@lru_cache(maxsize=64)
def _hazards(cabin: Cabin) -> dict[tuple[str, str], tuple[str, TriangleMesh]]:
    """By slot and name of a hazard: the group of parts that it moves with, and its triangles there."""
    parts = {part.name: part.surface for part in cabin.parts}
    wheel = [part.surface for part in cabin.parts if part.group == WHEEL_GROUP]
    found = {}
    for slot in _FRONT:
        if wheel:
            whole = merge(wheel)
            found[slot, "wheel"] = WHEEL_GROUP, triangle_mesh(whole.vertices, whole.faces, closed=False)
        if "airbag cover" in parts and slot == "driver":
            cover = parts["airbag cover"]
            found[slot, "airbag"] = WHEEL_GROUP, triangle_mesh(cover.vertices, cover.faces, closed=False)
        if "dashboard" in parts:
            board = parts["dashboard"]
            found[slot, "dashboard"] = STATIC_GROUP, triangle_mesh(board.vertices, board.faces, closed=False)
            if slot == "front_passenger" and slot in cabin.seats:
                beside = np.abs(board.vertices[:, 1] - cabin.seats[slot].design_h_point[1]) <= _AIRBAG_HALF_M
                before = board.faces[beside[board.faces].all(axis=1)]
                if len(before):
                    found[slot, "airbag"] = STATIC_GROUP, triangle_mesh(board.vertices, before, closed=False)
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
        vehicle_from = scene.cabin.group_transforms(scene.settings, wheel_angle=scene.wheel_angle)
        frames = {group: invert(vehicle_from[group]) for group in {group for group, _ in hazards.values()}}
        for who in scene.people:
            if who.slot in _FRONT:
                result[slots.index(who.slot)] = _of_person(who, hazards, frames)
    return {"distance": result}


def _of_person(who: ScenePerson, hazards: dict[tuple[str, str], tuple[str, TriangleMesh]], frames: dict[str, Floats]) -> Floats:
    """(4, 3) m."""
    skin = who.posed.skin
    rows = []
    for part in AXES["body_part"]:
        points = skin[_rows()[part]].astype(np.float64)
        of_slot = [hazards.get((who.slot, name)) if name in _OF_FEET or "foot" not in part else None for name in AXES["hazard"]]
        rows.append([math.nan if found is None else _distance(points, *found, frames) for found in of_slot])
    return np.array(rows)


def _distance(points: Floats, group: str, mesh: TriangleMesh, frames: dict[str, Floats]) -> float:
    """The least distance (m) of points (N, 3), vehicle frame, from a part of the car."""
    local = apply(frames[group], points)
    middle = local.mean(axis=0)
    off = local - np.clip(middle, mesh.low, mesh.high)
    squared = off[:, 0] * off[:, 0] + off[:, 1] * off[:, 1] + off[:, 2] * off[:, 2]
    nearest = np.argsort(squared, kind="stable")[:_NEAREST]
    chosen = local[np.concatenate((nearest, np.arange(0, len(local), max(1, len(local) // _SPREAD))))]
    bound = float(mesh.signed_distance(chosen[:_FIRST], _FAR_M).min())
    return max(0.0, float(mesh.signed_distance(chosen[_FIRST:], bound).min()))
