"""The configuration of a generated dataset: plain data, checked before any work starts.

Angles are degrees and their names say so; everything else is SI. A file is YAML; relative paths in it are taken from
the folder of the file.
"""

from __future__ import annotations

import copy
import operator
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import yaml
from pydantic import Field, ValidationError, model_validator

from cabinpose.core import (
    ITOP,
    OCCUPANT_SLOTS,
    SKELETONS,
    STANDING_SLOT,
    ConfigError,
    OtherSkeletonName,
    Skeleton,
    explained,
    parse_yaml,
    read_yaml,
    unknown_name,
)
from cabinpose.scene.body import SUBJECTS
from cabinpose.scene.cabin import BeltMisuse
from cabinpose.scene.sensor import NoiseModel, PhysicalNoise, StructuredLightNoise
from cabinpose.scene.things import Attachment
from cabinpose.synth.camera import Camera
from cabinpose.synth.cars import Car, ChangedPreset, check_cars, is_car_file
from cabinpose.synth.motion.config import SequenceConfig
from cabinpose.synth.occupant import ExactSetting, ExactThing, Occupant, check_seats
from cabinpose.synth.people import Model, People, Probability, RandomPeople, Range
from cabinpose.synth.pictures.settings import Images
from cabinpose.synth.posture import ACTIONS, FREE_POSES, WITHOUT_SEAT
from cabinpose.synth.profiles import IncrementalProfile, Profile
from cabinpose.synth.style.settings import Style
from cabinpose.synth.sunlight import Sunlight, check_sunlight
from cabinpose.synth.things import (
    CLOTH,
    EMPTY_CHILD_SEATS,
    HELD,
    ON_SEATS,
    Choice,
    check_child_seats,
    check_held,
    check_loose,
    check_shares,
    cloth_labels_of,
    weights_of,
)

# Named one by one: what is added to the presets joins the datasets of those who ask for it.
_CARS = ("city_car", "hatchback", "sedan", "coupe", "suv", "van", "shuttle")


_ANYBODY = Occupant()


class Factorial(Model):
    """Every car with every person from every view, each equally often, in place of a random draw of the three.

    Frames go through them in the order of the configuration, poses fastest, then views, people and cars.
    """

    poses: int = Field(ge=1, description="Frames of each combination.")
    seat: str = Field("driver", description="Where those people sit; other seats are taken as `occupancy` says.")


class CabinScene(Model):
    """People in cars."""

    kind: Literal["cabin"] = "cabin"
    cars: tuple[Car, ...] = Field(
        _CARS,
        description="Presets, also with dimensions changed ({preset: suv, name: wide_suv, w3_mm: 1600}), paths to YAML files of"
        " own car meshes, or random cars by name (C0007).",
    )
    random_cars: int = Field(
        0, ge=0, le=10_000, description="Cars drawn at random for the dataset beside them: C0000, C0001, ..."
    )
    right_hand_drive: Probability = Field(0.15, description="Share with the wheel on the right, of the cars that have one.")
    occupants: Mapping[str, Occupant] = Field(
        {}, description="By seat: who sits there and does what. Such seats are always taken, others as `occupancy` says."
    )
    occupancy: Mapping[str, Probability] = Field(
        {"driver": 0.95, "front_passenger": 0.5, "rear_left": 0.15, "rear_center": 0.05, "rear_right": 0.15},
        description="How likely each seat is taken, where the car has it; at least one always is."
        " Left out beside `occupants` or `factorial`: no others.",
    )
    factorial: Factorial | None = Field(None, description="Every car with every person from every view, each equally often.")
    motion: Mapping[str, Mapping[str, Probability]] = Field(
        {}, description="Weights of the actions by seat; left out: every action that makes sense there, by its usual weight."
    )
    profile: Profile | None = Field(None, description="A motion profile for everyone, in place of the actions' own.")
    sequence: SequenceConfig | None = Field(
        None,
        exclude_if=lambda value: value is None,
        description="Frames that follow each other; left out: every frame is a scene of its own.",
    )
    seat_variation: float = Field(
        1.0, ge=0.0, le=3.0, description="How much people differ in setting their seat; 0: each seat as its person's body asks."
    )
    people_jitter_m: float = Field(
        0.015,
        ge=0.0,
        le=0.1,
        description="How far pelvises are ahead of their place (back 0.3, aside 0.6 of it): standard deviation, cut at twice it.",
    )
    people_jitter_deg: float = Field(
        3.0, ge=0.0, le=20.0, description="How far they are turned about the seat's vertical, and tilted by 0.3 of it: likewise."
    )
    belted: Probability = Field(0.9, description="Share of occupants who wear the seat belt.")
    child_seats: Mapping[str, Choice] = Field(
        {},
        exclude_if=operator.not_,
        description=f"By seat: {', '.join(EMPTY_CHILD_SEATS)}, any (of the first three), or how likely each is."
        " Occupants who are named for the seat sit in it; the others are empty, but for `children`.",
    )
    children: Probability = Field(
        0.0, exclude_if=operator.not_, description="Share of toddler seats and boosters in which a child of 3 to 11 years sits."
    )
    infants: Probability = Field(
        0.0, exclude_if=operator.not_, description="Share of infant carriers in which an infant of up to a year lies."
    )
    toddlers: Probability = Field(
        0.0, exclude_if=operator.not_, description="Share of the children in toddler seats who are 9 months to 3 years old."
    )
    loose_children: Mapping[str, Choice] = Field(
        {},
        exclude_if=operator.not_,
        description=f"By seat: how likely a child without a seat is there: {', '.join(WITHOUT_SEAT)}, or any.",
    )
    attachments: Mapping[Attachment, Probability] = Field(
        {},
        exclude_if=operator.not_,
        description="How likely infant carriers and toddler seats are held by isofix and by belt; left out: neither is said.",
    )
    belt_misuse: Mapping[BeltMisuse, Probability] = Field(
        {}, exclude_if=operator.not_, description="Share of those who wear the belt who do so behind_back and under_arm."
    )
    objects: Mapping[str, Choice] = Field(
        {},
        exclude_if=operator.not_,
        description=f"By seat: {', '.join(ON_SEATS)}, any (of these), {', '.join(CLOTH)}, or how likely each is, on the seat or"
        " on the lap of whoever sits there.",
    )
    clutter: float = Field(
        1.0, ge=0.0, le=10.0, description="How much lies about, not in sequences nor beside `things`: 1 is usual, 0 nothing."
    )
    in_hand: Probability = Field(
        0.0,
        exclude_if=operator.not_,
        description="Share of people on the telephone who have one in the hand; above 0 people also drink and read, which always"
        " have something in the hand. In sequences: share of those who do any of this.",
    )
    held: tuple[str, ...] = Field(
        (),
        exclude_if=operator.not_,
        description=f"What hands hold, at the places where they hold it; left out: {', '.join(HELD)}.",
    )
    seats: Mapping[str, ExactSetting] = Field(
        {}, exclude_if=operator.not_, description="How seats are set, taken or empty, where the car has them; they stay there."
    )
    things: tuple[ExactThing, ...] = Field(
        (), exclude_if=operator.not_, description="Child seats and objects to the last bit, in place of drawn ones."
    )

    @property
    def car_names(self) -> tuple[str, ...]:
        """Every car, those that are named first; own meshes go by their paths."""
        named = tuple(car.name if isinstance(car, ChangedPreset) else car for car in self.cars)
        return (*named, *(car for i in range(self.random_cars) if (car := f"C{i:04d}") not in named))

    @property
    def tells_restraints(self) -> bool:
        """Whether frames say how people and child seats are held, and who is a child."""
        young = self.children or self.infants or self.toddlers or self.loose_children
        return bool(
            young
            or self.belt_misuse
            or self.attachments
            or any(o.belt or o.action in FREE_POSES for o in self.occupants.values())
        )

    @property
    def cloth_labels(self) -> frozenset[str]:
        """The classes of what may be draped over seats and laps."""
        named = {kind for choice in self.objects.values() for kind in weights_of(choice, ())} | {t.kind for t in self.things}
        return cloth_labels_of(named | ({"hung_jacket"} if self.lies_about else set()))

    @property
    def lies_about(self) -> bool:
        """Whether something may lie about."""
        return self.clutter > 0.0 and self.sequence is None and not self.things

    @property
    def brings_things(self) -> bool:
        """Whether there may be child seats or objects."""
        named = {action for weights in self.motion.values() for action in weights} | {o.action for o in self.occupants.values()}
        # In sequences hands are empty without `in_hand`.
        by_action = self.sequence is None and any(name and ACTIONS[name].in_hand == "always" for name in named)
        return bool(self.child_seats or self.objects or self.things or self.in_hand or self.lies_about or by_action)

    @model_validator(mode="before")
    @classmethod
    def _no_others(cls, data: Any) -> Any:
        if isinstance(data, dict) and "occupancy" not in data and (data.get("occupants") or data.get("factorial")):
            return {**data, "occupancy": {}}
        return data

    @property
    def always_taken(self) -> tuple[str, ...]:
        """The seats in which somebody sits in every frame."""
        return tuple(dict.fromkeys((*self.occupants, *([self.factorial.seat] if self.factorial else ()))))

    def occupant(self, slot: str) -> Occupant:
        """What is asked of whoever sits in a seat."""
        return self.occupants.get(slot, _ANYBODY)

    def profile_of(self, slot: str) -> Profile | None:
        """The motion profile of whoever sits in a seat."""
        return self.occupant(slot).profile or self.profile

    @property
    def recorded(self) -> tuple[str, ...]:
        """The seats of those whom recordings move."""
        return tuple(slot for slot in OCCUPANT_SLOTS if (profile := self.profile_of(slot)) and profile.kind == "mocap")

    @property
    def weights(self) -> Mapping[str, Mapping[str, float]]:
        """The weights of the actions by seat, where they are not the usual ones."""
        return {**self.motion, **{slot: {o.action: 1.0} for slot, o in self.occupants.items() if o.action is not None}}

    @property
    def _still(self) -> str:
        """What of this scene holds for single frames only."""
        occupants = self.occupants.values()
        asked = {
            "scene.factorial": self.factorial,
            "scene.infants": self.infants,
            "scene.loose_children": self.loose_children,
            "profile but mocap": any(p and p.kind != "mocap" for p in (self.profile, *(o.profile for o in occupants))),
            "initial_pose_deg": any(o.initial_pose_deg for o in occupants),
            "pose": any(o.pose for o in occupants),
            "scene.things": self.things,
        }
        return next((name for name, value in asked.items() if value), "")

    @model_validator(mode="after")
    def _known(self) -> CabinScene:
        check_cars(self.cars, self.random_cars)
        for slot in (*self.occupancy, *self.motion, *self.seats, *self.always_taken):
            if slot not in OCCUPANT_SLOTS:
                raise unknown_name("seat", slot, list(OCCUPANT_SLOTS))
        if self.factorial is not None and (somebody := self.occupants.get(self.factorial.seat)) and somebody.subject:
            raise ConfigError(
                f"people take turns in the {self.factorial.seat} seat of a factorial dataset, where {somebody.subject} is to sit",
                hint="leave out the occupant's subject, or give factorial.seat another seat",
            )
        if self.factorial is not None and "incremental" in {p.kind for p in map(self.profile_of, OCCUPANT_SLOTS) if p}:
            raise ConfigError(
                "frames of a factorial dataset go through its combinations, and not through those of an incremental profile",
                hint="leave out scene.factorial, or choose profile kind gaussian or mocap",
            )
        check_child_seats(self.child_seats, self.always_taken, self.objects)
        check_loose(self.loose_children, (*self.always_taken, *self.child_seats))
        check_held(self.held)
        check_seats(self.seats, self.occupants)
        check_shares("attachments", self.attachments)
        check_shares("belt_misuse", self.belt_misuse)
        if not any(self.occupancy.values()) and not self.always_taken:
            raise ConfigError("every seat's occupancy is 0", hint="give at least one seat a probability above 0")
        if self.sequence is not None and self._still:
            raise ConfigError(f"people in motion have no {self._still}", hint="leave it out, or leave out scene.sequence")
        if self.clutter not in {0.0, CabinScene.model_fields["clutter"].default} and not self.lies_about:
            other = "sequence" if self.sequence is not None else "things"
            raise ConfigError(
                f"clutter is {self.clutter:g}, and nothing lies about beside scene.{other}",
                hint=f"leave out scene.clutter, or leave out scene.{other}",
            )
        if self.sequence is not None and "hand_over" in (self.sequence.activities or ()) and not self.in_hand:
            raise ConfigError("nobody has anything in the hand to hand over", hint="give scene.in_hand, such as 1.0")
        for weights in self.motion.values():
            for action in weights:
                _ = ACTIONS[action]  # ConfigError for one that does not exist, ExtensionError for one that cannot be loaded
            if not any(weights.values()):
                raise ConfigError("no action has a weight above 0", hint="give at least one action a weight")
        return self


class RoomScene(Model):
    """One person standing and moving freely in a room."""

    kind: Literal["room"] = "room"
    rooms: int = Field(64, ge=1, description="Different rooms, drawn once for the dataset.")
    facing_deg: float = Field(35.0, ge=0.0, description="Standard deviation of the person's turn away from the camera.")
    profile: Profile | None = Field(None, description="A motion profile in place of the free standing poses.")
    # What a car alone has.
    sequence: ClassVar[None] = None
    brings_things: ClassVar[bool] = False
    tells_restraints: ClassVar[bool] = False
    cloth_labels: ClassVar[frozenset[str]] = frozenset()


class Output(Model):
    """What is written and how it is cut."""

    frames_per_part: int = Field(100, ge=1, le=1000)
    gaze: bool = Field(False, exclude_if=lambda value: not value, description="Write what everybody's gaze meets first as well.")
    drive_side: bool = Field(False, exclude_if=operator.not_, description="Write the side of the wheel of each frame as well.")
    noise: bool = Field(
        False,
        exclude_if=operator.not_,
        description="Write the sensor's own sigma of its depth as well, as a Monstar's noise image.",
    )
    skeletons: tuple[OtherSkeletonName, ...] | None = Field(
        None,
        exclude_if=lambda value: value is None,
        description="Sets of joints that are written beside the standard's own; by default ITOP's in a room, else none.",
    )
    licence: str = Field("CC0-1.0", description="Licence of the generated data (SPDX identifier).")


class Limits(Model):
    """When the search for a valid scene ends."""

    poses_per_person: int = Field(8, ge=1, description="Poses tried for a person before the whole scene is drawn anew.")
    scenes_per_frame: int = Field(
        60, ge=1, description="Scenes drawn for a frame before the run ends with an error; for a sequence always 100."
    )


class SynthConfig(Model):
    """Everything that a generated dataset depends on, beside its seed and number of frames."""

    version: Literal[1] = 1
    scene: Annotated[CabinScene | RoomScene, Field(discriminator="kind")] = CabinScene()
    people: People = People()
    camera: Camera = Camera()
    noise: NoiseModel = PhysicalNoise()
    # Left out of what is written where there is none, so that datasets without pictures stay what they were.
    images: Images | None = Field(
        None, exclude_if=lambda images: images is None, description="Colour and near-infrared pictures beside the depth."
    )
    style: Style | None = Field(
        None, exclude_if=lambda style: style is None, description="Depth with the look of a real camera's beside the depth."
    )
    sunlight: Sunlight | None = Field(None, exclude_if=operator.not_, description="Sun and sky through the windows of cars.")
    output: Output = Output()
    limits: Limits = Limits()

    @model_validator(mode="after")
    def _noise_suits_the_sensor(self) -> SynthConfig:
        sensor = self.camera.sensor_model
        if isinstance(self.noise, PhysicalNoise) and sensor.principle != "time_of_flight":
            raise ConfigError(
                f"noise 'physical' describes Time-of-Flight, sensor '{sensor.name}' is none",
                hint="choose noise kind structured_light or empirical",
            )
        if self.sunlight is not None:
            check_sunlight(self.scene.kind, self.noise.kind, self.images.light if self.images else "any")
        sequence = self.scene.sequence
        if sequence is None and sensor.temporal_median > 1:
            raise ConfigError(
                f"sensor '{sensor.name}' takes the median of {sensor.temporal_median} frames, and each is a scene of its own",
                hint="ask for a sequence with scene.sequence, or leave out temporal_median",
            )
        if sequence is not None and sequence.exposure_motion and not isinstance(self.noise, PhysicalNoise):
            raise ConfigError(
                f"noise '{self.noise.kind}' has no correlation samples between which people could move",
                hint="choose noise kind physical, or leave out scene.sequence.exposure_motion",
            )
        return self

    @model_validator(mode="after")
    def _known_occupants(self) -> SynthConfig:
        named = [o.subject for o in self.scene.occupants.values() if o.subject] if isinstance(self.scene, CabinScene) else []
        for name in named:
            if not self.people.knows(name):
                raise unknown_name("subject", name, [*SUBJECTS, *self.people.own, *(["R0000 .."] if self.people.random else [])])
        if len(set(named)) < len(named):
            raise ConfigError("one person sits in two seats", hint="name different subjects in scene.occupants")
        if isinstance(self.scene, CabinScene) and self.scene.factorial is not None:
            for name in (name for name in named if name in self.people.names):
                raise ConfigError(
                    f"{name} takes turns in the {self.scene.factorial.seat} seat of a factorial dataset, and has another one",
                    hint=f"name somebody else in scene.occupants, or give people.subjects without {name}",
                )
        return self

    @property
    def skeletons(self) -> tuple[Skeleton, ...]:
        """The sets of joints that are written beside the standard's own."""
        names = self.output.skeletons
        if names is None:
            names = (ITOP.name,) if self.scene.kind == "room" else ()
        return tuple(SKELETONS[name] for name in dict.fromkeys(names))

    @property
    def profiles(self) -> tuple[Profile, ...]:
        """Every motion profile that a frame may follow."""
        own = [o.profile for o in self.scene.occupants.values()] if isinstance(self.scene, CabinScene) else []
        return tuple(profile for profile in (self.scene.profile, *own) if profile is not None)

    @property
    def may_skip(self) -> bool:
        """Whether frames that no scene allows are left out."""
        return any(profile.may_skip for profile in self.profiles)

    @property
    def frames(self) -> int | None:
        """The number of frames that go through all that is to be combined; None where everything is drawn at random."""
        if isinstance(self.scene, CabinScene) and self.scene.factorial is not None:
            cars, people, views = len(self.scene.car_names), len(self.people.names), len(self.camera.weights)
            return cars * people * views * self.scene.factorial.poses
        return min((profile.count for profile in self.profiles if isinstance(profile, IncrementalProfile)), default=None)

    def frames_or_all(self, frames: int | None) -> int:
        """The number of frames that is asked for, or else that of all combinations; ConfigError where there is neither."""
        wanted = self.frames if frames is None else frames
        if wanted is None:
            raise ConfigError("it is not said how many frames", hint="give --frames N; scenes are drawn at random without end")
        return wanted

    @classmethod
    def load(cls, path: Path | None, overrides: Sequence[str] = ()) -> SynthConfig:
        """Read and check a YAML file (None: all defaults); ConfigError names the key, the reason and the remedy.

        overrides: "KEY=VALUE", such as "scene.cars=[suv]", in place of what the file says; the value is YAML.
        """
        data: Any = {}
        if path is not None:
            data = read_yaml(path, hint="`cabinpose config init` writes a file to start from") or {}
            if isinstance(data, dict):
                data = _with_paths(data, path.parent)
        return cls.parse(_overridden(data, overrides))

    @classmethod
    def parse(cls, data: Any, *, base: Path = Path()) -> SynthConfig:
        """Check plain data; relative paths of car meshes and recordings are resolved against `base`.

        A scene without a `kind` is a cabin, noise without one is physical.
        """
        if not isinstance(data, dict):
            raise ConfigError("a configuration is a mapping of keys to values", hint="`cabinpose config schema` lists the keys")
        kinds = {"scene": "cabin", "noise": "physical"}
        data = {key: {"kind": kinds[key]} | v if key in kinds and isinstance(v, dict) else v for key, v in data.items()}
        data = _with_paths(data, base)
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise explained(error, cls, data, lists="`cabinpose config schema` lists what each key takes") from error


def person_slots(config: SynthConfig) -> tuple[str, ...]:
    """The entries of a dataset's `person` coordinate."""
    return (STANDING_SLOT,) if config.scene.kind == "room" else OCCUPANT_SLOTS


def room_preset() -> SynthConfig:
    """One person standing in a room before a Kinect-class camera, in ITOP's geometry: adults, as its subjects are."""
    adults = {"age": Range(min=0.45, max=0.85), "stature_cm": Range(min=160.0, max=195.0)}
    return SynthConfig(
        scene=RoomScene(),
        people=People(subjects=(), random=RandomPeople(count=300, ranges=adults)),
        camera=Camera(sensor="kinect_v1", views={"room": 1.0}, jitter_m=0.0, jitter_deg=0.0),
        noise=StructuredLightNoise(fill_px=5),
    )


def _overridden(data: Any, overrides: Sequence[str]) -> Any:
    """A copy of plain data with "KEY=VALUE" put in; keys of keys are parted by dots.

    Of a mapping by name that the data lack, such as `scene.occupancy`, the other names keep their defaults; beside occupants or
    a factorial the other seats are empty.
    """
    result = copy.deepcopy(data)
    scene = data.get("scene") if isinstance(data, dict) else None
    some = isinstance(scene, dict) and (scene.get("occupants") or scene.get("factorial"))
    some = some or any(override.strip().startswith(("scene.occupants", "scene.factorial")) for override in overrides)
    defaults = {"occupancy": {} if some else CabinScene().occupancy, "views": Camera().views}
    for override in overrides:
        keys, equals, text = override.partition("=")
        keys = keys.strip()
        try:
            value = parse_yaml(text)
        except yaml.YAMLError:
            equals = ""
        if not equals or not all(keys.split(".")):
            raise ConfigError(f"'{override}' says nothing of the configuration", hint="write KEY=VALUE, such as scene.cars=[suv]")
        *path, last = keys.split(".")
        at = result
        for depth, key in enumerate(path):
            at = at.setdefault(key, dict(defaults.get(key, {}))) if isinstance(at, dict) else None
            if not isinstance(at, dict):
                where = ".".join(path[: depth + 1])
                raise ConfigError(f"'{override}': {where} has no keys", hint="`cabinpose config schema` lists the keys")
        at[last] = value
    return result


def _with_paths(data: dict[str, Any], base: Path) -> dict[str, Any]:
    """A copy in which the paths of own cars, recordings and styles are absolute."""
    if isinstance(style := data.get("style"), dict):
        paths = {key: str((base / style[key]).resolve()) for key in ("by", "vgg19") if isinstance(style.get(key), str)}
        data = {**data, "style": {**style, **paths}}
    people: Any = data.get("people")
    crowd = people.get("random") if isinstance(people, dict) else None
    if isinstance(crowd, dict) and str(crowd.get("population")).lower().endswith(".csv"):
        crowd = {**crowd, "population": str((base / crowd["population"]).resolve())}
        data = {**data, "people": {**people, "random": crowd}}
    scene = data.get("scene")
    if not isinstance(scene, dict):
        return data
    scene = dict(scene)
    if isinstance(scene.get("cars"), list):
        scene["cars"] = [str((base / c).resolve()) if isinstance(c, str) and is_car_file(c) else c for c in scene["cars"]]
    _with_path(scene, base)
    if isinstance(scene.get("occupants"), dict):
        scene["occupants"] = {slot: dict(o) if isinstance(o, dict) else o for slot, o in scene["occupants"].items()}
        for occupant in scene["occupants"].values():
            _with_path(occupant, base)
    return {**data, "scene": scene}


def _with_path(owner: Any, base: Path) -> None:
    """Make the path of a motion profile's recording absolute, in place of what the owner of the profile says."""
    profile = owner.get("profile") if isinstance(owner, dict) else None
    if isinstance(profile, dict) and isinstance(profile.get("path"), str):
        owner["profile"] = {**profile, "path": str((base / profile["path"]).resolve())}
