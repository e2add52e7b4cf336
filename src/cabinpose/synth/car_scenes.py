"""Scenes of people in cars, one job after the other: cast, furnish, pose, camera, dress."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np

from cabinpose.scene.things import PlacedThing
from cabinpose.synth.cars import ChangedPreset, place_name
from cabinpose.synth.casting import Cast, Casting
from cabinpose.synth.clutter import LyingAbout
from cabinpose.synth.config import CabinScene, SynthConfig
from cabinpose.synth.faces import with_faces
from cabinpose.synth.furnishing import Furnishing
from cabinpose.synth.plan import Plan
from cabinpose.synth.posing import Posing
from cabinpose.synth.restraints import dressed
from cabinpose.synth.scene import Attempts, Scene, ScenePerson
from cabinpose.synth.streams import clutter_rng
from cabinpose.synth.things import Blocked
from cabinpose.synth.validate import Rejection, Seated, Verdict
from cabinpose.synth.viewpoint import Viewpoint, draw_viewpoint, free_viewpoint


class CarScenes:
    """Draws scenes in the cars of one dataset; motion plans its sequences by the same jobs."""

    def __init__(self, scene: CabinScene, config: SynthConfig, plan: Plan) -> None:
        """scene: that of the configuration."""
        self.scene = scene
        self.posing = Posing(scene, config.limits.poses_per_person)
        exact = {slot: occupant.pose.face for slot, occupant in scene.occupants.items() if occupant.pose is not None}
        self._faces = {slot: face.face for slot, face in exact.items() if face is not None}
        self._presets = {car.name: car.preset for car in scene.cars if isinstance(car, ChangedPreset)}
        self._casting, self._furnishing = Casting(scene, plan), Furnishing(scene)
        self._lying = LyingAbout(scene.clutter)
        self._camera, self._plan = config.camera, plan

    def draw(self, index: int, attempts: Attempts, *, rng: np.random.Generator) -> Scene | None:
        """A scene of frame `index`; None where somebody finds no valid pose, or a thing or the camera no place."""
        cast = self.furnished_cast(index, attempts, rng=rng)
        if cast is None:
            attempts.proposals += 1
            return None
        goals = partial(self.posing.goals, cast, index=index, rng=rng)
        posed = self.posing.pose(cast, goals, partial(self._furnishing.bring, cast, rng=rng), attempts)
        if posed is None:
            return None
        people = [cast.person(slot, pose.action, body) for slot, (pose, body) in posed.poses.items()]
        people = self.with_faces(cast, people, index)
        viewpoint = self.free_viewpoint(cast, index, lambda: people, posed.seated, rng=rng)
        if viewpoint is None:
            attempts.rejections[Rejection("camera")] += len(people)
            return None
        things = posed.seated.things
        if self.scene.lies_about:
            bodies, eye = [who.posed for who in people], viewpoint.vehicle_from_camera[:3, 3]
            things += self._lying.about(cast, bodies, posed.seated, eye, rng=clutter_rng(self._plan.seed, index))
        return self.assembled(cast, people, posed.seated.wheel_angle, things, viewpoint, rng=rng)

    def with_faces(self, cast: Cast, people: Iterable[ScenePerson], number: int) -> list[ScenePerson]:
        """The people with what their faces do; number: of the frame, or of the first of a sequence."""
        return with_faces(people, self._faces, cast.cabin, seed=self._plan.seed, number=number)

    def furnished_cast(self, index: int, attempts: Attempts, *, rng: np.random.Generator) -> Cast | None:
        """Who sits in which car, with what is on its seats; None where a thing finds no place."""
        cast = self._casting.cast(index, rng=rng)
        attempts.scenes.append(str(cast))
        furnished = self._furnishing.furnish(cast, rng=rng)
        if isinstance(furnished, Blocked):
            attempts.judge(furnished.rejection)
            return None
        return furnished

    def free_viewpoint(
        self, cast: Cast, index: int, people: Callable[[], Iterable[ScenePerson]], seated: Seated, *, rng: np.random.Generator
    ) -> Viewpoint | None:
        """A camera that nobody comes before; None where none is found."""
        return free_viewpoint(lambda: self._viewpoint(cast, index, rng), people, seated)

    def _viewpoint(self, cast: Cast, index: int, rng: np.random.Generator) -> Viewpoint:
        cell = self._plan.cell(index)
        return draw_viewpoint(self._camera, cast.cabin, None if cell is None else cell.view, rng=rng)

    def assembled(
        self, cast: Cast, people: Iterable[ScenePerson], wheel_angle: float, things: Sequence[PlacedThing],
        viewpoint: Viewpoint, *, rng: np.random.Generator,
    ) -> Scene:  # fmt: skip
        """The scene of posed people, who are dressed and belted here.

        things: on the seats, in hands and on laps · wheel_angle: rad.
        """
        seen = tuple(dressed(self.scene, cast, person, rng=rng) for person in people)
        return Scene(
            backdrop=cast.cabin.surface(cast.settings, wheel_angle=wheel_angle),
            people=seen,
            world_from_camera=viewpoint.vehicle_from_camera,
            place=place_name(cast.car),
            trimmed_as=self._presets.get(cast.car, ""),
            pov=viewpoint.view,
            cabin=cast.cabin,
            settings=cast.settings,
            wheel_angle=wheel_angle,
            things=(*things, *self._furnishing.drape(cast, seen)),
            fastenings=self._furnishing.fasten(cast),
        )

    def as_given(self, index: int, *, rng: np.random.Generator) -> tuple[Scene, tuple[Verdict, ...]]:
        """The people who have whole poses in frame `index`, and why it does not hold, the first reason for each of them.

        Where it holds, and everybody has a pose, it is the scene of `draw`.
        """
        cast, verdicts, people = self._casting.cast(index, rng=rng), list[Verdict](), []
        furnished = self._furnishing.furnish(cast, rng=rng)
        if isinstance(furnished, Blocked):
            verdicts.append(Verdict(furnished.rejection))
        else:
            cast = furnished
        wheel_angle = next((pose.wheel_angle for pose in cast.given.values() if pose.wheel_angle is not None), 0.0)
        seated = cast.validator.empty(cast.settings, wheel_angle, cast.things)
        for slot, pose in cast.given.items():
            body = cast.people[slot].pose(pose.q, pose.vehicle_from_root, pose.fingers)
            people.append(cast.person(slot, pose.action, body))
            verdict, seated = cast.validator.admit(seated, (slot, cast.people[slot], body))
            verdicts.append(verdict)
        viewpoint = self._viewpoint(cast, index, rng)
        if viewpoint.blocked(people, seated):
            verdicts.append(Verdict(Rejection("camera"), where=viewpoint.vehicle_from_camera[:3, 3]))
        people = self.with_faces(cast, people, index)
        shown = self.assembled(cast, people, wheel_angle, seated.things, viewpoint, rng=rng)
        return shown, tuple(verdict for verdict in verdicts if not verdict.ok)
