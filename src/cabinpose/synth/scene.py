"""A scene as it was drawn: the car or room, its people and things, and the camera that looks at them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from cabinpose.core import OCCUPANT_SLOTS, Floats, Matrix, SceneError
from cabinpose.scene import Surface, merge
from cabinpose.scene.body import CHILD_YEARS, Face, Person, PosedBody
from cabinpose.scene.cabin import BeltWear, Cabin, SeatSetting
from cabinpose.scene.things import PlacedThing
from cabinpose.synth.validate import Rejection, most_common, sits_too_deep


class Tongue(NamedTuple):
    """The tongue of the belt of somebody who buckles up: where it is, (3,) m, vehicle frame, and how.

    how: beside the seat or on its way to the hand ("loose"), in the hand ("drawn"), in the buckle ("plugged").
    """

    at: Floats
    how: Literal["loose", "drawn", "plugged"]


@dataclass(frozen=True)
class ScenePerson:
    """Somebody in a scene: which slot, who, doing what, the posed body, and what is seen of it (its seat belt included).

    belt: how it is worn, "harness" in a child seat that has one · coming_head: (3, 3) the rotation that a moving head is about to
    have, which the eyes have reached; None where it stays · face: what it does · tongue: the belt's, of who buckles up in the
    sequence, until then nobody wears it.
    """

    slot: str
    subject: str
    action: str
    person: Person
    posed: PosedBody
    surfaces: tuple[Surface, ...] = ()
    belt: BeltWear | Literal["none", "harness"] = "none"
    coming_head: Floats | None = None
    face: Face = field(default_factory=Face)
    tongue: Tongue | None = None

    @property
    def child(self) -> bool:
        """Whether it is one, of less than twelve years."""
        return self.person.phenotype.years < CHILD_YEARS


@dataclass(frozen=True)
class Scene:
    """A valid scene. Its frame is the vehicle's, or the room's world frame.

    backdrop: cabin or room (instance 0) · people · world_from_camera (4, 4) · place: car or room · pov: the view ·
    sequence, sync_ns: the sequence that it belongs to, and the time since its start; 0 where it is a scene of its own ·
    cabin, settings, wheel_angle: the car, how its seats are set and its wheel turned (rad); None, empty and 0 in a room ·
    proposals, judged, rejections: what was tried for it, see `Attempts` · things: child seats and objects ·
    fastenings: the belts that hold child seats · trimmed_as: the preset whose trim a changed one keeps, else "".
    """

    backdrop: Surface
    people: tuple[ScenePerson, ...]
    world_from_camera: Matrix
    place: str
    pov: str
    cabin: Cabin | None = None
    settings: Mapping[str, SeatSetting] = field(default_factory=dict)
    wheel_angle: float = 0.0
    proposals: int = 0
    judged: int = 0
    rejections: Mapping[Rejection, int] = field(default_factory=dict)
    things: tuple[PlacedThing, ...] = ()
    fastenings: tuple[Surface, ...] = ()
    sequence: int = 0
    sync_ns: int = 0
    trimmed_as: str = ""

    @property
    def trim(self) -> str:
        """The car or room by whose name colours and dyes are drawn."""
        return self.trimmed_as or self.place

    @property
    def closed(self) -> bool:
        """Whether every part is closed, as people and the presets' parts are; a user's own mesh may be open."""
        return self.cabin is not None and all(part.solid for part in self.cabin.parts)

    def surface(self) -> Surface:
        """Everything that can be seen, in the scene's frame."""
        things = [thing.surface(self._instance(thing)) for thing in self.things]
        people = (surface for person in self.people for surface in person.surfaces)
        return merge([self.backdrop, *people, *things, *self.fastenings])

    @staticmethod
    def _instance(thing: PlacedThing) -> int:
        """Of whoever holds a thing or has it on the lap; 0 for what is on a seat or lies about."""
        return 0 if thing.at in ("seat", "car") else 1 + OCCUPANT_SLOTS.index(thing.slot)


class Tried(NamedTuple):
    """An activity of a sequence that somebody tried: the seat's slot, and what was against it first; "" where it was done."""

    slot: str
    activity: str
    against: str = ""


@dataclass
class Attempts:
    """What was tried to find a scene. scenes: those drawn, in words · proposals: poses, and activities of sequences ·
    judged: poses, and ways of sequences, of which it was said whether they hold · rejections: those that do not, and why ·
    tried: activities of sequences, and how they ended.
    """

    scenes: list[str] = field(default_factory=list)
    proposals: int = 0
    judged: int = 0
    rejections: Counter[Rejection] = field(default_factory=Counter)
    tried: Counter[Tried] = field(default_factory=Counter)
    last_refused: Rejection | None = None

    def judge(self, refused: Rejection | None) -> None:
        """Count a pose or way that was judged, and what is against it; None: it holds."""
        self.judged += 1
        if refused is not None:
            self.rejections[refused] += 1
            self.last_refused = refused


class ImpossibleSceneError(SceneError):
    """No valid scene was found for a frame. own_car: the YAML of a user's own car that was among those tried."""

    def __init__(self, index: int, attempts: Attempts, own_car: str = "") -> None:
        scenes, rejections = Counter(attempts.scenes).most_common(), attempts.rejections
        among = "; ".join(scene for scene, _ in scenes[:3]) + (f" and {len(scenes) - 3} more" if len(scenes) > 3 else "")
        super().__init__(
            f"frame {index}: none of {attempts.proposals} poses made a valid scene: {most_common(rejections, 4)}. Tried: {among}",
            hint=f"people sink into what they sit on: `cabinpose car check {own_car}` says which give_mm it needs"
            if own_car and sits_too_deep(rejections)
            else f"`cabinpose car check {own_car}` says seat by seat what is in the way"
            if own_car
            else "narrow the motion, take away an occupant or a car, or raise limits.poses_per_person",
        )
        self.attempts = attempts

    def __reduce__(self) -> tuple[Any, ...]:  # across process borders, where the other arguments are not needed
        return SceneError, (str(self),), {"hint": self.hint}
