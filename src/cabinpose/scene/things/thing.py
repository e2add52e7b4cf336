"""A thing: closed parts in a frame of its own, and the distance field by which people and cars feel it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Floats, Floats32, Matrix, distinct_rows, unknown_name
from cabinpose.scene.cabin.model import Part
from cabinpose.scene.cabin.shading import to_surface
from cabinpose.scene.contact.field import FINE_STEP_M, STEP_M, GroupField, balls_of, group_field
from cabinpose.scene.contact.triangles import sampled_surface
from cabinpose.scene.surface import Surface, merge
from cabinpose.scene.things.child_seats import CHILD_SEAT_LABELS, CHILD_SEATS, ChildSeat, Lying, Sitting
from cabinpose.scene.things.clutter import thing_kind
from cabinpose.scene.things.objects import OBJECTS
from cabinpose.scene.things.pieces import Piece

VARIANTS = 4  # designs of each kind, of different sizes
_POINTS_A_SIDE = 14  # by which a thing feels what is around it, along its longest side
_CROWDED = 4.0  # of points nearer to each other than this share of that one is enough
_SMALL_M = 0.12  # a thing thinner than this has a finer field


class Cloud(NamedTuple):
    """Points (N, 3) m that are held against a distance field, and the balls around them: see `balls_of`."""

    points: Floats32
    balls: Floats

    @staticmethod
    def of(points: NDArray[np.floating]) -> Cloud:
        """Of points in an order in which neighbours are near each other."""
        sampled = np.ascontiguousarray(points, np.float32)
        return Cloud(sampled, balls_of(sampled))


@dataclass(frozen=True, eq=False)
class Thing:
    """One design of a kind of thing, in its own frame: x forward as it stands on a seat, z up, origin on its underside.

    kind: its name, of `THINGS` · variant: the design, 0 to `VARIANTS` - 1 · label: the class of its pixels · pieces: closed
    solids with their materials · sitting, lying: where a child sits or an infant lies in a child seat, else None.
    """

    kind: str
    variant: int
    label: str
    pieces: tuple[Piece, ...]
    sitting: Sitting | None = None
    lying: Lying | None = None

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """The pieces as parts that are felt and seen, in the thing's frame."""
        return tuple(
            Part(f"{self.kind} {piece.name}", to_surface(piece.solid, self.label, piece.material), self.kind, piece.give_m)
            for piece in self.pieces
        )

    @cached_property
    def surface(self) -> Surface:
        """What is seen of it, instance 0."""
        return merge([part.surface for part in self.parts])

    @cached_property
    def field(self) -> GroupField:
        """The clearance to its parts."""
        extent = np.ptp(self.surface.vertices, axis=0).min()
        return group_field(self.kind, self.parts, step=FINE_STEP_M if extent < _SMALL_M else STEP_M)

    @cached_property
    def cloud(self) -> Cloud:
        """Points over its surface, about a fourteenth of its longest side from each other."""
        apart = float(np.ptp(self.box, axis=0).max()) / _POINTS_A_SIDE
        seen = (part.surface for part in self.parts)
        points = np.concatenate([sampled_surface(s.vertices[s.faces].astype(np.float64), apart) for s in seen])
        # Long thin triangles have more than are needed.
        first, _ = distinct_rows(np.floor(points * (_CROWDED / apart)))
        return Cloud.of(points[np.sort(first)])

    @property
    def box(self) -> Floats32:
        """(2, 3) m, opposite corners around it."""
        return np.stack((self.surface.vertices.min(axis=0), self.surface.vertices.max(axis=0)))


@cache
def make_thing(kind: str, variant: int) -> Thing:
    """The design of this number of a kind of thing; the same object on every call. Raises ConfigError for an unknown kind."""
    design = variant % VARIANTS
    row = thing_kind(kind)
    if row.make is None:
        raise unknown_name("thing", kind, [name for name, each in {**CHILD_SEATS, **OBJECTS}.items() if each.make is not None])
    sitting = row.sitting(design) if isinstance(row, ChildSeat) and row.sitting is not None else None
    lying = row.lying(design) if isinstance(row, ChildSeat) and row.lying is not None else None
    return Thing(kind, design, row.label, row.make(design), sitting, lying)


Attachment = Literal["isofix", "belt"]


class PlacedThing(NamedTuple):
    """A thing somewhere in a car: on the seat `slot`, on the lap of whoever sits there, in a hand of theirs, or about in the car.

    attachment: what fastens a child seat, where that is said.
    """

    thing: Thing
    vehicle_from_thing: Matrix
    slot: str
    at: Literal["seat", "lap", "hand", "car"]
    attachment: Attachment | None = None

    def group(self) -> tuple[GroupField, Matrix]:
        """The field with its name here, and where it is. What somebody sits on counts as part of the seat."""
        own = self.thing.label in CHILD_SEAT_LABELS
        name = f"seat:{self.slot}/{self.thing.kind}" if own else f"{self.slot} {self.thing.kind}"
        return replace(self.thing.field, name=name), self.vehicle_from_thing

    def surface(self, instance: int) -> Surface:
        """What is seen of it, vehicle frame; instance: whose it is."""
        seen = self.thing.surface.moved(self.vehicle_from_thing)
        return replace(seen, instance=np.full(len(seen.faces), instance, np.uint8))
