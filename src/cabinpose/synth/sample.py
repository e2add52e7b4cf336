"""Scenes drawn at random and kept only when they are possible.

A scene is drawn in two rings. The inner one poses a person, again and again until the pose holds against the body
itself, the people already seated and the car. Where that fails for too long the outer ring draws everything anew
(car, seats, people); where that fails too the run ends with an error that names the cause. `posing` keeps the inner ring.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from cabinpose._native import cabin as native
from cabinpose.core import STANDING_SLOT, ConfigError, Floats, Matrix, axis_rotation, transform
from cabinpose.scene import ROOM_VIEWS, Room, furnish_room, place_room_camera
from cabinpose.scene.body import Person, PosedBody
from cabinpose.scene.cabin import BeltWear, Cabin, SeatSetting, belt_surface, harness_surface
from cabinpose.scene.sensor import jittered, place_camera
from cabinpose.scene.things import PlacedThing
from cabinpose.synth.camera import CameraPose, ExactCameraPose
from cabinpose.synth.cars import is_car_file, place_name
from cabinpose.synth.casting import Cast, Casting
from cabinpose.synth.config import CabinScene, RoomScene, SynthConfig
from cabinpose.synth.draping import draped
from cabinpose.synth.motion.config import SequenceConfig
from cabinpose.synth.motion.film import Film, make_film
from cabinpose.synth.motion.sequences import DrawGoals
from cabinpose.synth.occupant import Occupant
from cabinpose.synth.once import cached_once
from cabinpose.synth.plan import Plan, person_slots, room_rng
from cabinpose.synth.posing import pose_people
from cabinpose.synth.posture import draw_offset, random_action
from cabinpose.synth.posture.actions import ACTIONS, IN_CHILD_SEAT
from cabinpose.synth.posture.context import SeatContext
from cabinpose.synth.posture.grasps import Hold
from cabinpose.synth.posture.neighbours import neighbours_of
from cabinpose.synth.posture.places import Reach
from cabinpose.synth.posture.sampling import Doing, Drawn, OccupantPose, Prescribed, draw_pose
from cabinpose.synth.preflight import LENS_M
from cabinpose.synth.profiles import MocapProfile
from cabinpose.synth.restraints import belt_guide, fastening, restrained, straps
from cabinpose.synth.scene import ImpossibleSceneError, Scene, ScenePerson
from cabinpose.synth.standing import sample_standing
from cabinpose.synth.streams import sequence_rng, weighted
from cabinpose.synth.things import Blocked, SeatThings, bring_along, drawn, is_cloth
from cabinpose.synth.validate import Rejection, Seated, Validator, Verdict

_CAMERA_DRAWS = 5  # until a scene is given up in which somebody is before the lens
_ANYBODY = Occupant()
_SAME_M = 1e-3  # what moves less while samples are exposed stands still: each is half of it off, a tenth of a pixel at 1 m
_FACE_M = 0.08  # nothing alive is nearer to a lens than this


class SceneSampler:
    """Draws the scenes of one dataset. Holds the bodies, cabins and rooms used last, a bounded number of each."""

    def __init__(self, config: SynthConfig, seed: int, *, like: SceneSampler | None = None) -> None:
        """like: a sampler whose people, cars and rooms are taken over as far as configuration and seed make the same ones."""
        self._config = config
        self._seed = seed
        self._plan = Plan(config, seed)
        self._casting: Casting = Casting(config, seed, self._plan, like=None if like is None else like._casting)
        self._slots = person_slots(config)
        self._bodies = Validator(None)
        self._room = cached_once(64)(self._make_room)
        self._seat_things = cached_once(20)(SeatThings)
        self._film = cached_once(64)(self._make_film)
        if like is not None and like._seed == seed:
            self._room = like._room

    def sample(self, index: int, *, rng: np.random.Generator) -> Scene:
        """The scene of frame `index`. Raises SceneError where none is found within the configured limits."""
        scene = self._config.scene
        if isinstance(scene, CabinScene) and scene.sequence is not None:
            return self._moving(scene, scene.sequence, index)
        causes: Counter[Rejection] = Counter()
        tried: list[str] = []
        proposals = 0
        for _ in range(self._config.limits.scenes_per_frame):
            if isinstance(scene, CabinScene):
                found, draws = self._seated(scene, index, causes, tried, rng)
            else:
                found, draws = self._standing(scene, index, causes, tried, rng)
            proposals += draws
            if found is not None:
                return replace(found, proposals=proposals, rejections=causes)
        own_car = next(filter(is_car_file, self._plan.cars), "")
        raise ImpossibleSceneError(index, proposals, causes, tried, own_car)

    def _make_room(self, number: int) -> Room:
        return furnish_room(rng=room_rng(self._seed, number))

    def _seated(
        self, scene: CabinScene, index: int, causes: Counter[Rejection], tried: list[str], rng: np.random.Generator
    ) -> tuple[Scene | None, int]:
        """One draw of the outer ring: a scene in a car, or None, and the number of poses it took."""
        cast = self._casting.cast(scene, index, rng=rng)
        cabin, settings = cast.cabin, dict(cast.settings)
        tried.append(f"{place_name(cast.car)} ({', '.join(f'{name} as {slot}' for slot, name in cast.names.items())})")

        def draw(slot: str) -> Drawn:
            return self._draw(scene, index, cast.people, cabin, slot, settings[slot], rng, on=child_seats.get(slot))

        def bring(slot: str, pose: OccupantPose, posed: PosedBody, seated: Seated) -> tuple[Rejection | None, Seated]:
            return bring_along(cast.brought.objects.get(slot), slot, pose, posed, cast.validator, seated, rng=rng)

        things = self._things(scene, cast, settings, rng)
        if isinstance(things, Blocked):
            causes[things.rejection] += 1
            return None, 1
        child_seats = {thing.slot: thing for thing in things if thing.thing.sitting}
        limit = self._config.limits.poses_per_person
        posed, draws = pose_people(
            cast.people, cabin, cast.validator, settings, draw, poses_per_person=limit, causes=causes, given=cast.given,
            things=things, bring=bring if cast.brought.objects or scene.brings_things else None,
        )  # fmt: skip
        if posed is None:
            return None, draws
        cast = cast._replace(settings=settings)
        people_in = [cast.person(slot, pose.action, body) for slot, (pose, body) in posed.poses.items()]
        seated = posed.seated
        view = self._free_camera(cabin, index, lambda: people_in, seated, rng)
        if view is None:
            causes[Rejection("camera")] += len(people_in)
            return None, draws
        return self._assembled(scene, cast, people_in, seated.wheel_angle, *view, rng, seated.things), draws

    def _free_camera(
        self, cabin: Cabin, index: int, people: Callable[[], Iterable[ScenePerson]], seated: Seated, rng: np.random.Generator
    ) -> tuple[str, Matrix] | None:
        """A view and its camera that nobody comes before; None where none is found."""
        for _ in range(_CAMERA_DRAWS):
            pov, camera = self._cabin_camera(cabin, index, rng)
            if not _blocked(camera[:3, 3], people(), seated):
                return pov, camera
        return None

    def plan_sequence(self, number: int) -> None:
        """Plan a sequence before its first frame is asked for."""
        self._film(number)

    def exposed(self, index: int, scene: Scene, times_s: Floats) -> list[Scene]:
        """The scene of frame `index` of a sequence at some times (S,) s before and after its own.

        Times between which nothing moves by more than `_SAME_M` share one scene, at their mean; where nothing moves at all, it is
        the given one.
        """
        car = self._config.scene
        assert isinstance(car, CabinScene)
        assert car.sequence is not None
        number, frame = divmod(index, car.sequence.frames)
        time_s = frame / car.sequence.rate_hz
        moved = self._film(number).moved_m(time_s + float(times_s[0]), time_s + float(times_s[-1]))
        moments = np.array_split(times_s, min(max(1, math.ceil(moved / _SAME_M)), len(times_s)))
        if len(moments) == 1:
            return [scene] * len(times_s)
        return [
            shown
            for moment in moments
            for shown in [self._moving(car, car.sequence, index, float(moment.mean()))] * len(moment)
        ]  # fmt: skip

    def _moving(self, scene: CabinScene, sequence: SequenceConfig, index: int, later_s: float = 0.0) -> Scene:
        """Frame `index` of the dataset as a frame of its sequence, or what is to be seen so much later."""
        number, frame = divmod(index, sequence.frames)
        film, time_s = self._film(number), frame / sequence.rate_hz + later_s
        rng = sequence_rng(self._seed, number * sequence.frames, 0)  # the same belts in all frames
        people = film.people(time_s)
        wheel_angle, things = film.wheel_angle(time_s), film.things_with(people, time_s)
        shown = self._assembled(scene, film.cast, people, wheel_angle, film.pov, film.camera, rng, things)
        counts = (film.proposals, film.rejections) if frame == 0 else (0, {})
        return replace(shown, proposals=counts[0], rejections=counts[1], sequence=number, sync_ns=round(1e9 * time_s))

    def _make_film(self, number: int) -> Film:
        """Sequence `number`. Raises SceneError where no scene is found in which everybody has a way."""
        scene = self._config.scene
        assert isinstance(scene, CabinScene)
        assert scene.sequence is not None
        first = number * scene.sequence.frames
        began_s = first / scene.sequence.rate_hz

        def of_profile(slot: str, time_s: float) -> int:
            profile = scene.profile_of(slot)
            return round((began_s + time_s) * profile.rate_hz) if isinstance(profile, MocapProfile) else first

        def goals(cast: Cast) -> DrawGoals:
            return lambda slot, action, wheel_angle, carried, reach, on, time_s, rng: self._draw(
                scene, of_profile(slot, time_s), cast.people, cast.cabin, slot, cast.settings[slot], rng,
                action=action, wheel_angle=wheel_angle, carried=carried, reach=reach, on=on,
            )  # fmt: skip

        def furnished(*, rng: np.random.Generator) -> tuple[Cast, tuple[PlacedThing, ...] | Blocked]:
            cast = self._casting.cast(scene, first, rng=rng)
            settings = dict(cast.settings)
            things = self._things(scene, cast, settings, rng)
            return cast._replace(settings=settings), things

        return make_film(
            number, scene.sequence, self._seed, lambda rng: furnished(rng=rng), goals,
            lambda cast, people, empty, rng: self._free_camera(cast.cabin, first, people, empty, rng),
            weights=scene.weights, recorded=scene.recorded, in_hand=scene.in_hand,
            poses_per_person=self._config.limits.poses_per_person,
        )  # fmt: skip

    def as_given(self, index: int, *, rng: np.random.Generator) -> tuple[Scene, tuple[Verdict, ...]]:
        """The people who have whole poses in frame `index`, and why it does not hold, the first reason for each of them.

        Where it holds, and everybody has a pose, it is the scene of `sample`. Raises ConfigError for scenes in rooms.
        """
        scene = self._config.scene
        if not isinstance(scene, CabinScene):
            raise ConfigError("only scenes in cars have given poses", hint="give a scene of people in a car")
        cast = self._casting.cast(scene, index, rng=rng)
        wheel = next((pose.wheel_angle for pose in cast.given.values() if pose.wheel_angle is not None), 0.0)
        things, verdicts, people_in = self._things(scene, cast, dict(cast.settings), rng), list[Verdict](), []
        if isinstance(things, Blocked):
            verdicts.append(Verdict(things.rejection))
            things = ()
        seated = cast.validator.empty(cast.settings, wheel, things)
        for slot, pose in cast.given.items():
            body = cast.people[slot].pose(pose.q, pose.vehicle_from_root, pose.fingers)
            people_in.append(cast.person(slot, pose.action, body))
            verdict, seated = cast.validator.admit(seated, (slot, cast.people[slot], body))
            verdicts.append(verdict)
        pov, camera = self._cabin_camera(cast.cabin, index, rng)
        if _blocked(camera[:3, 3], people_in, seated):
            verdicts.append(Verdict(Rejection("camera"), where=camera[:3, 3]))
        shown = self._assembled(scene, cast, people_in, wheel, pov, camera, rng, seated.things)
        return shown, tuple(verdict for verdict in verdicts if not verdict.ok)

    def _things(
        self, scene: CabinScene, cast: Cast, settings: dict[str, SeatSetting], rng: np.random.Generator
    ) -> tuple[PlacedThing, ...] | Blocked:
        """What stands on the seats; may move empty ones, in place of their settings."""
        if scene.things:
            return tuple(thing.placed for thing in scene.things if not is_cloth(thing.kind))
        if not any(cast.brought) or cast.validator.contact is None:
            return ()
        found = self._seat_things(cast.cabin, cast.validator.contact).place(cast.brought, tuple(cast.people), settings, rng=rng)
        if isinstance(found, Blocked):
            return found
        return tuple(restrained(thing, scene.attachments, taken=thing.slot in cast.people, rng=rng) for thing in found)

    def _assembled(
        self,
        scene: CabinScene,
        cast: Cast,
        people: Sequence[ScenePerson],
        wheel_angle: float,
        pov: str,
        camera: Matrix,
        rng: np.random.Generator,
        things: tuple[PlacedThing, ...] = (),
    ) -> Scene:
        """The scene of posed people, who are dressed and belted here, with child seats belted to the car."""
        on = {thing.slot: thing for thing in things if thing.thing.sitting}
        dressed = tuple(self._dressed(p, scene, cast.cabin, cast.settings, on.get(p.slot), rng) for p in people)
        fastenings = tuple(fastening(t, cast.cabin, cast.settings[t.slot]) for t in things if t.attachment == "belt")
        backdrop = cast.cabin.surface(cast.settings, wheel_angle=wheel_angle)
        for slot, (kind, variant) in cast.soft.items():
            who = next((p for p in dressed if p.slot == slot), None)
            below = ((), None) if who is None else (who.surfaces, who.posed)
            cloth = draped(kind, variant, slot, cast.cabin, cast.settings[slot], below[1], below[0])
            things = things if cloth is None else (*things, cloth)
        place = place_name(cast.car)
        return Scene(
            backdrop, dressed, camera, place, pov, cast.cabin, cast.settings, wheel_angle, things=things, fastenings=fastenings
        )  # fmt: skip

    def _draw(
        self,
        scene: CabinScene,
        index: int,
        people: Mapping[str, Person],
        cabin: Cabin,
        slot: str,
        setting: SeatSetting,
        rng: np.random.Generator,
        *,
        action: str | None = None,
        wheel_angle: float | None = None,
        carried: Hold | None = None,
        reach: Reach | None = None,
        on: PlacedThing | None = None,
    ) -> Drawn:
        """Somebody's goals; action, wheel_angle, carried, reach: given, see `Doing`; on: their child seat."""
        seat = cabin.seats[slot]
        neighbours = neighbours_of(people[slot], slot, cabin, {s: p for s, p in people.items() if s != slot}, rng=rng)
        occupant = scene.occupants.get(slot, _ANYBODY)
        weights = {occupant.action: 1.0} if occupant.action is not None else scene.motion.get(slot, on and IN_CHILD_SEAT)
        if action is None:
            action = weighted(weights, rng=rng) if weights else random_action(
                seat, cabin, rng=rng, neighbours=neighbours, in_hand=scene.in_hand > 0.0
            )  # fmt: skip
        offset = draw_offset(scene.people_jitter_m, np.radians(scene.people_jitter_deg), rng=rng)
        seated = SeatContext(people[slot], seat, setting, cabin, offset, neighbours, on)
        in_hand = scene.sequence is None and _in_hand(scene, action, rng)
        prescribed = Prescribed(scene.profile_of(slot), occupant.initial, index)
        return draw_pose(seated, Doing(action, wheel_angle, in_hand, carried, reach), prescribed, rng=rng)

    def _cabin_camera(self, cabin: Cabin, index: int, rng: np.random.Generator) -> tuple[str, Matrix]:
        """The view's name and `vehicle_from_camera`, jittered."""
        camera, cell = self._config.camera, self._plan.cell(index)
        name = cell.view if cell is not None else weighted(camera.weights, rng=rng)
        jitter = {"translation_jitter": camera.jitter_m, "rotation_jitter": np.radians(camera.jitter_deg)}
        own = camera.views[name]
        if isinstance(own, ExactCameraPose):
            return name, jittered(np.array(own.vehicle_from_camera), **jitter, rng=rng)
        if isinstance(own, CameraPose):
            upright = place_camera(own.position_m, own.look_at_m, rng=rng)
            rolled = upright @ transform(axis_rotation("z", math.radians(own.roll_deg)))
            return name, jittered(rolled, **jitter, rng=rng)
        view = cabin.view(name)
        return name, place_camera(view.eye, view.target, **jitter, rng=rng)

    def _dressed(
        self,
        person: ScenePerson,
        scene: CabinScene,
        cabin: Cabin,
        settings: Mapping[str, SeatSetting],
        on: PlacedThing | None,
        rng: np.random.Generator,
    ) -> ScenePerson:
        """The person with clothes on, and with the belt over them for the configured share of people; on: their child seat."""
        seat, given = cabin.seats[person.slot], scene.occupants.get(person.slot, _ANYBODY)
        clothed = person.posed.surface(1 + self._slots.index(person.slot))
        how: BeltWear | Literal["none"] = "worn" if rng.random() < scene.belted else "none"
        misused = drawn(scene.belt_misuse, rng=rng) if scene.belt_misuse else None
        if given.belt is not None:
            how = given.belt
        elif given.belted is not None:
            how = "worn" if given.belted else "none"
        elif how == "worn" and misused is not None:
            how = misused
        body = clothed.vertices, clothed.faces, person.posed.joints
        if on is not None and on.thing.sitting is not None and on.thing.sitting.harness:
            harness = harness_surface(*body, *straps(on, person.posed), labels=clothed.label)
            return replace(person, surfaces=(clothed, harness), belt="harness")
        if seat.belt is None or how == "none":
            return replace(person, surfaces=(clothed,))
        guide = None if on is None else belt_guide(on, person.posed, seat.belt.upper)
        belt = belt_surface(*body, seat, settings[person.slot], cabin, labels=clothed.label, worn=how, guide=guide)
        return replace(person, surfaces=(clothed, belt), belt=how)

    def _standing(
        self, scene: RoomScene, index: int, causes: Counter[Rejection], tried: list[str], rng: np.random.Generator
    ) -> tuple[Scene | None, int]:
        """One draw of the outer ring: a person in a room, or None, and the number of poses it took."""
        number = self._plan.room(rng=rng)
        room = self._room(number)
        (subject,) = self._plan.people(index, 1, rng=rng)
        person = self._casting.person(subject)
        tried.append(f"room {number} ({subject})")
        weights = {name: weight for name, weight in self._config.camera.weights.items() if name in ROOM_VIEWS}
        view = weighted(weights or {"room": 1.0}, rng=rng)
        camera, spot = place_room_camera(view, room, rng=rng)
        # People face the camera of the view `room`, which in its other views stands for whatever they look at.
        heading = np.arctan2(-spot[1], -spot[0]) + np.radians(scene.facing_deg) * rng.standard_normal()
        for proposals in range(1, self._config.limits.poses_per_person + 1):
            pose = sample_standing(person, scene.profile, index=index, rng=rng)
            world_from_root = transform(axis_rotation("z", heading), spot) @ pose.floor_from_root
            posed = person.pose(pose.q, world_from_root)
            verdict = self._bodies.check([(STANDING_SLOT, person, posed)], {})
            if verdict.rejection is None:
                somebody = ScenePerson(STANDING_SLOT, subject, pose.action, person, posed, (posed.surface(1),))
                return Scene(room.surface, (somebody,), camera, f"room_{number:03d}", view), proposals
            causes[verdict.rejection] += 1
        return None, self._config.limits.poses_per_person


def _in_hand(scene: CabinScene, action: str, rng: np.random.Generator) -> bool:
    """Whether somebody who does this has something in the hand."""
    how = ACTIONS[action].in_hand
    return how == "always" or (scene.in_hand > 0.0 and how == "sometimes" and rng.random() < scene.in_hand)


def _blocked(eye: Floats, people: Iterable[ScenePerson], seated: Seated) -> bool:
    """Whether a camera's place lies inside the cabin's parts, or nearer to a person than a lens can be."""
    if seated.placed is not None and seated.placed.clearance(eye[None])[0] < LENS_M:
        return True
    return any(native.any_nearer(p.posed.skin, eye.astype(np.float32), _FACE_M) for p in people)
