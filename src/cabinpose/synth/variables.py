"""What a generated dataset holds: each variable, the configurations that ask for it, how it is made; and the manifest.

A variable is a row of `VARIABLES` in `store.schema`, which says its dimensions, type and meaning, and a row of `TABLE`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

import cabinpose
from cabinpose.core import ANATOMY, Camera, Floats, Skeleton, apply, invert
from cabinpose.scene import LABELS, MATERIALS, OF_THINGS, THING_LABELS, ticam_class
from cabinpose.scene.body import joints_in_body
from cabinpose.scene.sensor import SensorFrame
from cabinpose.store import OPTIONAL, Manifest, joints_variable, visible_boxes
from cabinpose.synth.config import SynthConfig, person_slots
from cabinpose.synth.distances import distance_labels
from cabinpose.synth.gaze import gaze_labels
from cabinpose.synth.person_labels import body_labels, box_labels, doing_labels, occupancy_labels
from cabinpose.synth.render import RenderedFrame
from cabinpose.synth.scene import Scene, ScenePerson
from cabinpose.synth.style.settings import STYLE_VARIABLES
from cabinpose.synth.things import CLOTH_LABELS

Frame = dict[str, Any]  # every variable of the dataset standard by its name


@dataclass(frozen=True)
class FrameFacts:
    """All that is known of a frame: what its variables are made of.

    slots: the places (P,) of the dataset · joints_3d: (P, 20, 3) m, camera frame, NaN for places where
    nobody is · reflectance: of what each person wears, by slot · rendered, sensed: the
    scene as it is and as the camera delivers it · pictures, styled: what was made beside them, by name.
    """

    config: SynthConfig
    seed: int
    slots: tuple[str, ...]
    scene: Scene
    joints_3d: Floats
    reflectance: Mapping[str, tuple[float, ...]]
    rendered: RenderedFrame
    sensed: SensorFrame
    pictures: Mapping[str, Any]
    styled: Mapping[str, Any]

    @property
    def camera(self) -> Camera:
        """The sensor's intrinsics."""
        return self.config.camera.sensor_model.camera

    @property
    def drive_side(self) -> str:
        """Where the wheel of a car is; empty where there is none, as on benches that face each other."""
        cabin = self.scene.cabin
        return "" if cabin is None or cabin.steering_wheel is None else cabin.drive_side

    def each(self, of: Callable[[ScenePerson], Any], nobody: Any = "") -> list[Any]:
        """(P,) a value of whoever is in each place; `nobody` where nobody is."""
        found = {person.slot: of(person) for person in self.scene.people}
        return [found.get(slot, nobody) for slot in self.slots]

    def joints(self, skeleton: Skeleton) -> Floats:
        """(P, J, 3) m, the joints of a set in the camera; NaN for places where nobody is."""
        camera_from_world, nobody = invert(self.scene.world_from_camera), np.full((len(skeleton.joints), 3), np.nan)
        return np.stack(self.each(lambda who: apply(camera_from_world, joints_in_body(skeleton, who.posed)), nobody))


class Made(NamedTuple):
    """A row of the table: variables that are made together.

    names: those that a configuration asks for, in the order of the manifest · make: their values by name.
    """

    names: Callable[[SynthConfig], Iterable[str]]
    make: Callable[[FrameFacts], Mapping[str, Any]]


def _one(name: str, make: Callable[[FrameFacts], Any], asked: Callable[[SynthConfig], bool] = lambda _: True) -> Made:
    """A variable that is made alone, in datasets whose configuration asks for it."""
    return Made(lambda config: (name,) if asked(config) else (), lambda facts: {name: make(facts)})


def _always(_: SynthConfig) -> Iterable[str]:
    """Of variables that every dataset has: a manifest does not name them."""
    return ("",)


def _labels(of: Callable[[Scene, tuple[str, ...]], Mapping[str, Any]]) -> Made:
    """Variables by places, of the scene alone."""
    return Made(_always, lambda facts: of(facts.scene, facts.slots))


def _pictures(config: SynthConfig) -> Iterable[str]:
    return () if config.images is None else (*config.images.variables, "light", "renderer")


def _micrometres(facts: FrameFacts) -> np.ndarray:
    """Sigma (H, W) m, NaN or infinite where there is none, as 16 bits of micrometres; 0 is unknown."""
    return np.minimum(np.nan_to_num(np.rint(facts.sensed.noise_m * 1e6), posinf=0.0), 65535.0).astype(np.uint16)


TABLE: tuple[Made, ...] = (
    _one("depth", lambda facts: facts.sensed.depth_m),
    _one("depth_clean", lambda facts: facts.rendered.depth_clean),
    _one("amplitude", lambda facts: facts.sensed.amplitude),
    _one("confidence", lambda facts: facts.sensed.confidence),
    _one("labels", lambda facts: facts.rendered.labels),
    _one("instance", lambda facts: facts.rendered.instance),
    Made(_pictures, lambda facts: facts.pictures),
    Made(lambda config: STYLE_VARIABLES if config.style else (), lambda facts: facts.styled),
    _one("noise", _micrometres, lambda config: config.output.noise),
    Made(
        lambda config: [joints_variable(each.name) for each in config.skeletons],
        lambda facts: {joints_variable(each.name): facts.joints(each) for each in facts.config.skeletons},
    ),
    Made(_always, lambda facts: body_labels(facts.scene, facts.slots, facts.reflectance)),
    _labels(occupancy_labels),
    _labels(doing_labels),
    Made(_always, lambda facts: gaze_labels(facts.scene, facts.slots, target=facts.config.output.gaze)),
    _labels(distance_labels),
    _labels(box_labels),
    _one("box_2d", lambda facts: visible_boxes(facts.rendered.labels, facts.rendered.instance, len(facts.slots))),
    _one("joints_3d", lambda facts: facts.joints_3d),
    _one("joints_2d", lambda facts: facts.camera.project(facts.joints_3d)),
    _one("visibility", lambda facts: facts.rendered.visibility),
    _one("camera_k", lambda facts: facts.camera.k),
    _one("camera_dist", lambda facts: np.array(facts.camera.dist)),
    _one("vehicle_from_camera", lambda facts: facts.scene.world_from_camera),
    _one("sync_ns", lambda facts: facts.scene.sync_ns),
    _one("sequence", lambda facts: facts.scene.sequence),
    _one("seed", lambda facts: facts.seed),
    _one("subject", lambda facts: facts.each(lambda person: person.subject)),
    _one("action", lambda facts: facts.each(lambda person: person.action)),
    _one("car", lambda facts: facts.scene.place),
    _one("drive_side", lambda facts: facts.drive_side, lambda config: config.output.drive_side),
    _one("pov", lambda facts: facts.scene.pov),
)


def build_manifest(config: SynthConfig, frames: int, seed: int) -> Manifest:
    """What `dataset.yaml` says of a run."""
    camera = config.camera.sensor_model.camera
    things, absent = config.scene.brings_things, CLOTH_LABELS - config.scene.cloth_labels
    return Manifest(
        generator="cabinpose.synth",
        generator_version=cabinpose.__version__,
        config=config.model_dump(mode="json"),
        seed=seed,
        frames=frames,
        frames_per_part=config.output.frames_per_part,
        width=camera.width,
        height=camera.height,
        persons=person_slots(config),
        joint_definition=ANATOMY,
        licence=config.output.licence,
        labels=[label._asdict() | {"ticam": ticam_class(label)} for label in LABELS if label.name not in absent]
        if things
        else [label._asdict() for label in LABELS if label not in THING_LABELS],
        materials=[
            {"id": m.id, "name": m.name, "reflectance": m.at(config.camera.sensor_model.wavelength_nm)}
            for m in MATERIALS
            if things or m not in OF_THINGS
        ],
        variables=[name for row in TABLE for name in row.names(config) if name in OPTIONAL],  # what not every dataset has
    )
