"""What a scene consists of, for the browser's 3D view: shapes that stay, and points that follow each change."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.studio.clouds import person_colour
from cabinpose.core import OCCUPANT_SLOTS
from cabinpose.scene import LABEL_ID, MATERIAL_ID, RGB, Surface, coarse_labels, merge
from cabinpose.scene.cabin import Cabin
from cabinpose.synth import Scene

_SKIN, _SHOE = "#d9a987", "#30343a"
_CABIN = {
    "seat": "#7d8694", "trim": "#9aa0a8", "steering_wheel": "#2c2f36", "floor": "#5a5e66", "pedal": "#d0c040", "glass": "#b9d4e4",
    "wall": "#a8a8a0", "furniture": "#8c643c",
}  # fmt: skip
_WORN = {
    "skin": _SKIN, "hair": "#3a2a20", "belt_webbing": "#d03030", "leather_shoe": _SHOE, "rubber": _SHOE, "denim": "#46628c",
    "spectacle_lens": "#8fb0c0", "eye": "#e8e0da", "iris": "#4a3020", "pupil": "#101010", "mouth": "#5a1f22",
}  # fmt: skip
_HIDING = ("trim", "glass", "floor", "wall")  # what stands between the people and who looks in from outside
_GHOST, _SOLID = 0.13, 1.0  # opacity of what one looks through from outside, and of the rest
_CELL_M, _OUTERMOST_M = 0.03, 0.08  # of the columns in which the outermost is sought; what lies less below it is it as well
_FACING = 0.5  # of a face's normal along an axis that it faces
_COARSE_M = 0.06  # side of the cells in which a cabin has one vertex, where it is far away
FINE_WITHIN_M = 8.0  # from the eye to the middle of a cabin that is drawn with every triangle
MOST_FINE = 150_000  # triangles of a mesh that is drawn with every one, near by as well
_LEVELS = 32767  # of a coordinate, of both sides of the middle


class Look(NamedTuple):
    """How a group of faces is drawn."""

    colour: str
    opacity: float = _SOLID


@dataclass(frozen=True)
class Body:
    """A cabin, a person or a thing: its triangles, and the looks of their kinds (F,). cabin: one looks into it from outside."""

    surface: Surface
    kinds: NDArray[np.uint8]
    looks: tuple[Look, ...]
    cabin: bool = False

    @property
    def shape(self) -> bytes:
        """What stays as long as it only moves, as `uint32`: how many groups of faces there are, their lengths, their corners.

        Of each look the faces near by; after them, of a cabin, of each look those of a coarse form for farther away.
        """
        levels = [(self.surface.faces, self.kinds)]
        if self.cabin:
            levels.append(_coarse(self.surface, self.kinds))
            levels = levels[len(self.surface.faces) > MOST_FINE :]
        groups = [faces[kinds == kind] for faces, kinds in levels for kind in range(len(self.looks))]
        lengths = np.array([len(groups), *(group.size for group in groups)], "<u4")
        return lengths.tobytes() + np.concatenate(groups).astype("<u4").tobytes()

    @property
    def points(self) -> bytes:
        """Where the vertices are: the middle (3) and the step (1) as `float32` m, (V, 3) `int16` steps, (V, 3) `int8` normals."""
        vertices = self.surface.vertices
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        middle = (low + high) / 2
        step = np.float32(max(float((high - low).max()) / 2, 1e-6) / _LEVELS)
        steps = np.rint((vertices - middle) / step).astype("<i2")
        normals = np.rint(self.surface.normals * np.float32(127)).astype(np.int8)
        return np.array([*middle, step], "<f4").tobytes() + steps.tobytes() + normals.tobytes()


def bodies(scene: Scene) -> dict[str, Body]:
    """All that is drawn of a scene, by name: the cabin, people by their seats, things by theirs, belts of child seats."""
    result = {"cabin": _cabin(scene)}
    for person in scene.people:
        slot = OCCUPANT_SLOTS.index(person.slot) if person.slot in OCCUPANT_SLOTS else 0
        result[person.slot] = _coloured(merge(person.surfaces), "material", lambda kind, slot=slot: _of_person(kind, slot))  # type: ignore[misc]
    for number, thing in enumerate(scene.things):
        result[f"{thing.thing.kind}:{thing.slot}:{number}"] = _coloured(thing.surface(0), "label", _of_class)
    if scene.fastenings:
        result["fastenings"] = _coloured(merge(scene.fastenings), "material", lambda kind: _of_person(kind, 0))
    return result


def _of_person(material: int, slot: int) -> Look:
    return Look(next((colour for name, colour in _WORN.items() if MATERIAL_ID[name] == material), person_colour(slot)))


def _of_class(label: int) -> Look:
    """The colour that the class has in the image beside."""
    return Look(f"#{RGB.get(label, 0x999999):06x}")


def _coloured(surface: Surface, by: str, look: Callable[[int], Look]) -> Body:
    of_face = getattr(surface, by)
    names = np.flatnonzero(np.bincount(of_face, minlength=256))
    kinds = np.zeros(256, np.uint8)
    kinds[names] = np.arange(len(names))
    return Body(surface, kinds[of_face], tuple(look(name) for name in names.tolist()))


def _cabin(scene: Scene) -> Body:
    """A cabin or room that is whole, into which one looks from every side: through glass, and through what is outermost."""
    names = {LABEL_ID[name]: name for name in _CABIN}
    surface = replace(scene.backdrop, label=coarse_labels(scene.backdrop.label))
    body = _coloured(surface, "label", lambda label: Look(_CABIN[names.get(label, "trim")]))
    count = len(body.looks)
    looks = (*body.looks, *(Look(look.colour, _GHOST) for look in body.looks))
    return Body(surface, body.kinds + np.uint8(count) * _see_through(scene), looks, cabin=True)


def _see_through(scene: Scene) -> NDArray[np.bool_]:
    """Which faces (F,) of the cabin are looked through; found once for a car, whatever moves in it."""
    if scene.cabin is not None and scene.cabin in _SEE_THROUGH:
        return _SEE_THROUGH[scene.cabin]
    hiding = np.flatnonzero(np.isin(coarse_labels(scene.backdrop.label), [LABEL_ID[name] for name in _HIDING]))
    result = scene.backdrop.label == LABEL_ID["glass"]
    result[hiding] |= _outermost(scene.backdrop, hiding)
    if scene.cabin is not None:
        _SEE_THROUGH[scene.cabin] = result
    return result


_SEE_THROUGH: WeakKeyDictionary[Cabin, NDArray[np.bool_]] = WeakKeyDictionary()


def _outermost(surface: Surface, faces: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Which of some faces look outwards, along an axis that they face, with none of the others before one of their points."""
    corners = surface.vertices[surface.faces[faces]].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    middles = corners.mean(axis=1, keepdims=True)
    points = np.concatenate([middles, (corners + middles) / 2], axis=1)
    samples = np.concatenate(list(_samples(corners)))
    low = samples.min(axis=0)
    result = np.zeros(len(corners), bool)
    for axis in range(3):
        across = [other for other in range(3) if other != axis]
        cells = ((samples[:, across] - low[across]) / _CELL_M).astype(int)
        own = ((points[..., across] - low[across]) / _CELL_M).astype(int)
        for sign in (1.0, -1.0):
            reach = np.full(cells.max(axis=0) + 1, -np.inf)
            np.maximum.at(reach, (cells[:, 0], cells[:, 1]), sign * samples[:, axis])
            outer = sign * points[..., axis] > reach[own[..., 0], own[..., 1]] - _OUTERMOST_M
            result |= outer.any(axis=1) & (sign * normals[:, axis] > _FACING)
    return result


def _samples(corners: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Points on triangles (F, 3, 3), no farther from each other than a cell is wide: those of large ones, more."""
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(np.ceil(edge / (_CELL_M / 2)).astype(int), 1)
    for count in np.unique(parts).tolist():
        of_these = corners[parts == count]
        a, b = np.meshgrid(np.arange(count + 1) / count, np.arange(count + 1) / count)
        weights = np.stack([a, b, 1 - a - b], axis=-1)[a + b < 1 + 1e-9]
        yield np.einsum("wc,fcx->fwx", weights, of_these).reshape(-1, 3)


def _coarse(surface: Surface, kinds: NDArray[np.uint8]) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """The faces with one vertex for each cell, without those that are none then; of the same vertices. And their kinds."""
    cells = np.floor(surface.vertices / _COARSE_M).astype(np.int64)
    _, first, of_vertex = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    faces = first[of_vertex.reshape(-1)][surface.faces].astype(np.int32)
    a, b, c = faces.T
    whole = (a != b) & (b != c) & (a != c)
    return faces[whole], kinds[whole]
