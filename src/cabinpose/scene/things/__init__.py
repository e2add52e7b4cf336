"""Things that people bring into a car: child seats, and what lies on seats and laps or is held in a hand."""

from cabinpose.scene.things.child_seats import CHILD_SEATS
from cabinpose.scene.things.objects import OBJECTS
from cabinpose.scene.things.thing import PlacedThing, Thing, make_thing

__all__ = ["CHILD_SEATS", "OBJECTS", "PlacedThing", "Thing", "make_thing"]
