"""The sequences of a dataset as films: one car, its people in motion, one camera."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, SceneError
from cabinpose.scene.cabin import hanging_tongue
from cabinpose.scene.things import PlacedThing
from cabinpose.synth.car_scenes import CarScenes
from cabinpose.synth.casting import Cast
from cabinpose.synth.motion.config import SequenceConfig
from cabinpose.synth.motion.sequences import SequenceDraw, plan_tracks
from cabinpose.synth.motion.track import Track
from cabinpose.synth.once import cached_once
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.scene import Attempts, Scene, ScenePerson
from cabinpose.synth.streams import frame_rng, sequence_rng
from cabinpose.synth.validate import Rejection, most_common
from cabinpose.synth.viewpoint import Viewpoint

# By which a gaze is ahead of the head: both start within tens of milliseconds of each other in natural tasks (Herst, Epelboim,
# Steinman 2001, Vision Research 41), but a saccade is over long before the head has turned.
EYES_LEAD_S = 0.15
_SCENES = (
    100  # drawn for a sequence until the run ends; who reaches past a camera on the dashboard is right before it in nine of ten
)
_SAME_M = 1e-3  # what moves less while samples are exposed stands still: each is half of it off, a tenth of a pixel at 1 m


class Film(NamedTuple):
    """A planned sequence: the cast, with what stands on the seats, the tracks of people by slot, and what was tried for it.

    viewpoint: the camera's, once one is found before which nobody comes.
    """

    cast: Cast
    tracks: Mapping[str, Track]
    sequence: SequenceConfig
    attempts: Attempts
    viewpoint: Viewpoint = Viewpoint("", np.eye(4))

    def people(self, time_s: float) -> list[ScenePerson]:
        """Everybody at a time, not yet dressed."""
        result = []
        for slot, track in self.tracks.items():
            person, coming = self.cast.people[slot], track.at(time_s + EYES_LEAD_S)
            somebody = self.cast.person(slot, track.activity(time_s), track.body(person, track.at(time_s), time_s))
            head = frames(coming.q, person.rest, coming.root).bone("head")[:3, :3]
            tongue = track.tongue(somebody.posed, time_s, self._tongue_ends(slot)) if track.buckling else None
            result.append(replace(somebody, coming_head=head, tongue=tongue))
        return result

    def _tongue_ends(self, slot: str) -> tuple[Floats, Floats]:
        """(3,) m each: where the tongue of a seat's belt hangs, and its buckle."""
        seat, setting = self.cast.cabin.seats[slot], self.cast.settings[slot]
        anchors = seat.belt_anchors(setting)
        assert anchors is not None  # of who buckles up
        return hanging_tongue(seat, setting, self.cast.cabin), anchors.buckle

    def things_with(self, people: Iterable[ScenePerson], time_s: float) -> tuple[PlacedThing, ...]:
        """What stands on the seats, and what these people hold at a time."""
        return (*self.cast.things, *(thing for p in people for thing in self.tracks[p.slot].held(p.slot, p.posed, time_s)))

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


class Films:
    """The sequences of a dataset, each planned once: sequence n is its frames n * frames .. (n + 1) * frames - 1."""

    def __init__(self, scenes: CarScenes, sequence: SequenceConfig, seed: int) -> None:
        """sequence: that of the scenes' configuration."""
        self._scenes, self._sequence, self._seed = scenes, sequence, seed
        self.film = cached_once(64)(self._make_film)

    def scene(self, index: int, later_s: float = 0.0) -> Scene:
        """Frame `index` of the dataset as a frame of its sequence, or what is to be seen so much later."""
        number, frame = divmod(index, self._sequence.frames)
        film, time_s = self.film(number), frame / self._sequence.rate_hz + later_s
        rng = sequence_rng(self._seed, number * self._sequence.frames, 0)  # the same belts in all frames
        people = self._scenes.with_faces(film.cast, film.people(time_s), number * self._sequence.frames)
        things = film.things_with(people, time_s)
        shown = self._scenes.assembled(film.cast, people, film.wheel_angle(time_s), things, film.viewpoint, rng=rng)
        counted = film.attempts if frame == 0 else Attempts()
        return replace(
            shown, proposals=counted.proposals, judged=counted.judged, rejections=counted.rejections, sequence=number,
            sync_ns=round(1e9 * time_s),
        )  # fmt: skip

    def exposed(self, index: int, scene: Scene, times_s: Floats) -> Sequence[Scene]:
        """The scene of frame `index` at some times (S,) s before and after its own.

        Times between which nothing moves by more than `_SAME_M` share one scene, at their mean; where nothing moves at all, it is
        the given one.
        """
        number, frame = divmod(index, self._sequence.frames)
        time_s = frame / self._sequence.rate_hz
        moved = self.film(number).moved_m(time_s + float(times_s[0]), time_s + float(times_s[-1]))
        moments = np.array_split(times_s, min(max(1, math.ceil(moved / _SAME_M)), len(times_s)))
        if len(moments) == 1:
            return [scene] * len(times_s)
        return [
            shown for moment in moments for shown in [self.scene(index, float(moment.mean()))] * len(moment)
        ]  # fmt: skip

    def _make_film(self, number: int) -> Film:
        """Sequence `number`. Raises SceneError where no scene is found in which everybody has a way."""
        first = number * self._sequence.frames
        rng = frame_rng(self._seed, first)
        attempts = Attempts()
        for attempt in range(_SCENES):
            cast = self._scenes.furnished_cast(first, attempts, rng=rng)
            if cast is None:
                continue
            tracks = plan_tracks(cast, self._scenes.posing, SequenceDraw(self._sequence, self._seed, first, attempt), attempts)
            if tracks is None:
                continue
            film = Film(cast, tracks, self._sequence, attempts)
            empty = cast.validator.empty(cast.settings, film.wheel_angle(0.0), cast.things)
            viewpoint = self._scenes.free_viewpoint(cast, first, film.everybody, empty, rng=rng)
            if viewpoint is not None:
                return film._replace(viewpoint=viewpoint)
            attempts.rejections[Rejection("camera")] += len(tracks)
        raise SceneError(
            f"sequence {number}: no way without collision was found for everybody: {most_common(attempts.rejections, 4)}."
            f" Tried: {'; '.join(attempts.scenes[:3])}",
            hint="choose other activities with scene.sequence.activities, take away an occupant, or make the sequence longer",
        )
