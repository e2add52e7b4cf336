"""A sequence: one car, its people in motion, one camera."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cabinpose.core import Matrix, SceneError
from cabinpose.scene.things import PlacedThing
from cabinpose.synth.cars import place_name
from cabinpose.synth.motion.config import SequenceConfig
from cabinpose.synth.motion.sequences import DrawGoals, plan_tracks
from cabinpose.synth.motion.track import Track
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.streams import frame_rng
from cabinpose.synth.things import Blocked
from cabinpose.synth.validate import Rejection, Seated, most_common

if TYPE_CHECKING:  # which imports this module
    from cabinpose.synth.casting import Cast
    from cabinpose.synth.scene import ScenePerson

# By which a gaze is ahead of the head: both start within tens of milliseconds of each other in natural tasks (Herst, Epelboim,
# Steinman 2001, Vision Research 41), but a saccade is over long before the head has turned.
EYES_LEAD_S = 0.15
_SCENES = 8  # drawn for a sequence until the run ends
# A view and its camera before which none of the people comes, in the car with nobody in it; None where none is found.
FreeCamera = Callable[["Cast", Callable[[], "Iterable[ScenePerson]"], Seated, np.random.Generator], "tuple[str, Matrix] | None"]


class Film(NamedTuple):
    """A planned sequence: the cast, the tracks of people by slot, what stands on the seats, the view and its camera."""

    cast: Cast
    tracks: Mapping[str, Track]
    things: tuple[PlacedThing, ...]
    sequence: SequenceConfig
    pov: str
    camera: Matrix
    proposals: int
    rejections: Mapping[Rejection, int]

    def people(self, time_s: float) -> list[ScenePerson]:
        """Everybody at a time, not yet dressed."""
        result = []
        for slot, track in self.tracks.items():
            person, coming = self.cast.people[slot], track.at(time_s + EYES_LEAD_S)
            somebody = self.cast.person(slot, track.activity(time_s), track.body(person, track.at(time_s), time_s))
            head = frames(coming.q, person.rest, coming.root).bone("head")[:3, :3]
            result.append(replace(somebody, coming_head=head))
        return result

    def things_with(self, people: Iterable[ScenePerson], time_s: float) -> tuple[PlacedThing, ...]:
        """What stands on the seats, and what these people hold at a time."""
        return (*self.things, *(thing for p in people for thing in self.tracks[p.slot].held(p.slot, p.posed, time_s)))

    def everybody(self) -> Iterator[ScenePerson]:
        """Everybody in every frame."""
        for frame in range(self.sequence.frames):
            yield from self.people(frame / self.sequence.rate_hz)

    def moved_m(self, start_s: float, end_s: float) -> float:
        """How far anything is at one time from where it was at another, m."""
        before, after = self.people(start_s), self.people(end_s)
        ways = [float(np.linalg.norm(b.posed.skin - a.posed.skin, axis=1).max()) for a, b in zip(before, after, strict=True)]
        wheel = self.cast.cabin.steering_wheel
        if wheel is not None:
            ways.append(wheel.rim_radius_m * abs(self.wheel_angle(end_s) - self.wheel_angle(start_s)))
        return max(ways)

    def wheel_angle(self, time_s: float) -> float:
        """How the wheel is turned, rad."""
        driver = self.tracks.get("driver")
        return driver.at(time_s).wheel_angle if driver is not None and self.cast.cabin.steering_wheel is not None else 0.0


def make_film(
    number: int,
    sequence: SequenceConfig,
    seed: int,
    draw_cast: Callable[[np.random.Generator], tuple[Cast, tuple[PlacedThing, ...] | Blocked]],
    goals: Callable[[Cast], DrawGoals],
    free_camera: FreeCamera,
    *,
    weights: Mapping[str, Mapping[str, float]],
    recorded: Collection[str],
    in_hand: float,
    poses_per_person: int,
) -> Film:
    """Plan a sequence.

    Parameters
    ----------
    number, sequence, seed
        Which one of a dataset, and how long; all randomness comes from its first frame.
    draw_cast, goals, free_camera
        Draw who is in which car with what on its seats, what people seek, and the camera.
    weights, recorded, in_hand, poses_per_person
        See `plan_tracks`.

    Raises
    ------
    SceneError
        Where no scene is found in which everybody has a way.
    """
    first = number * sequence.frames
    rng = frame_rng(seed, first)
    causes: Counter[Rejection] = Counter()
    tried, proposals = list[str](), 0
    for attempt in range(_SCENES):
        cast, things = draw_cast(rng)
        tried.append(f"{place_name(cast.car)} ({', '.join(f'{name} as {slot}' for slot, name in cast.names.items())})")
        if isinstance(things, Blocked):
            causes[things.rejection] += 1
            continue
        tracks, draws = plan_tracks(
            sequence, cast.people, cast.cabin, cast.validator, cast.settings, goals(cast), weights,
            recorded=recorded, things=things, in_hand=in_hand, seed=seed, first=first, attempt=attempt,
            poses_per_person=poses_per_person, causes=causes,
        )  # fmt: skip
        proposals += draws
        if tracks is None:
            continue
        film = Film(cast, tracks, things, sequence, "", np.eye(4), proposals, causes)
        empty = cast.validator.empty(cast.settings, film.wheel_angle(0.0), things)
        view = free_camera(cast, film.everybody, empty, rng)
        if view is not None:
            return film._replace(pov=view[0], camera=view[1])
        causes[Rejection("camera")] += len(tracks)
    raise SceneError(
        f"sequence {number}: no way without collision was found for everybody: {most_common(causes, 4)}."
        f" Tried: {'; '.join(tried[:3])}",
        hint="choose other activities with scene.sequence.activities, take away an occupant, or make the sequence longer",
    )
