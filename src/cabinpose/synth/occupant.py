"""The keys of a configuration about one person in a seat, and the exact seats, poses and things that `config frame` writes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, field_validator, model_validator

from cabinpose.core import OCCUPANT_SLOTS, ConfigError, is_rigid, unknown_name
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import FINGER_COUNTS, Face, load_faces
from cabinpose.scene.cabin import BeltWear, SeatSetting
from cabinpose.scene.things import Attachment, Cloth, Clutter, PlacedThing, make_thing, thing_kind
from cabinpose.synth.people import Model, Probability
from cabinpose.synth.posture import ACTIONS
from cabinpose.synth.profiles import Profile, check_within, dof_scale, limits_deg, standing

_UNIT_SLACK = 1e-6
_LIMIT_SLACK = 1e-9  # rad; a pose at a joint's limit may be beyond it by the last bits


def _rigid(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    if len(rows) != 4 or not is_rigid(np.array(rows)):
        raise ValueError("Input should be a rigid transform: 4 rows of 4 numbers, the last 0 0 0 1")
    return rows


Matrix4 = Annotated[tuple[tuple[float, float, float, float], ...], AfterValidator(_rigid)]


class ExactFace(Model):
    """What somebody's face does, to the last bit."""

    gaze: tuple[float, float, float] = Field((1.0, 0.0, 0.0), description="Unit vector of the line of sight: ahead, left, up.")
    lids: tuple[Probability, Probability] = Field((1.0, 1.0), description="Opening of the left and right eye, 0 to 1.")
    expression: str = Field("neutral", min_length=1, description="Its name, as it is labelled.")
    units: Mapping[str, Probability] = Field({}, description="Shares of face units, e.g. jawOpen: 0.4.")

    @field_validator("gaze")
    @classmethod
    def _unit(cls, gaze: tuple[float, float, float]) -> tuple[float, float, float]:
        if abs(rp.norm(np.array(gaze)) - 1.0) > _UNIT_SLACK:
            raise ValueError("Input should be a unit vector")
        return gaze

    @field_validator("units")
    @classmethod
    def _named(cls, units: Mapping[str, float]) -> Mapping[str, float]:
        for name in units:
            if name not in (known := load_faces().units):
                raise unknown_name("face unit", name, sorted(known))
        return units

    @property
    def face(self) -> Face:
        """The face."""
        return Face(self.gaze, self.lids, self.expression, tuple(self.units.items()))


class ExactSetting(Model):
    """How a seat is set, to the last bit."""

    fore_aft_m: float = Field(description="How the seat is set, from its design position.")
    height_m: float
    torso_angle_rad: float

    @property
    def setting(self) -> SeatSetting:
        """The setting."""
        return SeatSetting(self.fore_aft_m, self.height_m, self.torso_angle_rad)


class ExactTongue(Model):
    """Where the tongue of a belt is, to the last bit, that is not plugged in yet."""

    at_m: tuple[float, float, float] = Field(description="In the vehicle's frame.")
    how: Literal["loose", "drawn"] = Field(description="Beside the seat or on its way to the hand, or in the hand.")


class ExactPose(ExactSetting):
    """How somebody sits, to the last bit, as `cabinpose config frame` writes it: nothing of it is solved, all of it is judged."""

    vehicle_from_root: Matrix4 = Field(description="The pelvis frame; its origin lies between the femur heads.")
    angles_rad: Mapping[str, float] = Field(description="By joint axis, e.g. lelbow.flexion (grips: 0..1); left out: 0.")
    wheel_angle_rad: float | None = Field(None, description="How a driver's wheel is turned, + left.")
    fingers: tuple[tuple[float | None, ...], ...] | None = Field(
        None,
        exclude_if=lambda fingers: fingers is None,
        description="Of the left and the right hand: curl of each finger, or each phalanx, thumb first, and how far they are"
        " closed (0..1), where they do not follow the grip.",
    )

    face: ExactFace | None = Field(None, exclude_if=lambda face: face is None, description="What it does; left out: drawn.")
    tongue: ExactTongue | None = Field(
        None,
        exclude_if=lambda tongue: tongue is None,
        description="The belt's, of who buckles up; left out: worn, or not to be seen.",
    )

    @field_validator("angles_rad")
    @classmethod
    def _within(cls, angles: Mapping[str, float]) -> Mapping[str, float]:
        for name, angle in angles.items():
            low, high = (limit * dof_scale(name) for limit in limits_deg(name))
            check_within(name, angle, low, high, _LIMIT_SLACK)
        return angles

    @field_validator("fingers")
    @classmethod
    def _of_two_hands(cls, fingers: tuple[tuple[float | None, ...], ...] | None) -> tuple[tuple[float | None, ...], ...] | None:
        if fingers is None:
            return None
        counts = [len(hand) for hand in fingers]
        if len(counts) != 2 or counts[0] != counts[1] or counts[0] not in FINGER_COUNTS:
            raise ConfigError(
                f"fingers of {' and '.join(map(str, counts)) or 'no'} numbers",
                hint="give two hands, the left one first, as many numbers each: 5 fingers; 5 and how far they are closed;"
                " or 15 phalanges and how far they are closed",
            )
        return fingers


class ExactThing(Model):
    """Where a child seat or an object is, to the last bit, as `cabinpose config frame` writes it."""

    kind: str
    variant: int = Field(ge=0, description="Which design of its kind.")
    slot: str = Field("", description="The seat on which it is, or of whose occupant it is; of what lies about none.")
    where: Literal["seat", "lap", "hand", "car"]
    vehicle_from_thing: Matrix4
    attachment: Attachment | None = Field(None, exclude_if=lambda value: value is None)

    @property
    def placed(self) -> PlacedThing:
        """The thing where it is."""
        thing = make_thing(self.kind, self.variant)
        return PlacedThing(thing, np.array(self.vehicle_from_thing), self.slot, self.where, self.attachment)

    @model_validator(mode="after")
    def _known(self) -> ExactThing:
        kind = thing_kind(self.kind)  # ConfigError for one that does not exist, ExtensionError for one that cannot be loaded
        if isinstance(kind, Clutter) and self.where != "car":
            raise ConfigError(f"{self.kind} lies about and is on no {self.where}", hint="give it where: car, and no slot")
        if isinstance(kind, Cloth) and self.where == "car":
            raise ConfigError(f"{self.kind} is draped over seats and laps", hint="give it where: seat or lap, and a slot")
        if self.where != "car" and self.slot not in OCCUPANT_SLOTS:
            raise unknown_name("seat", self.slot, OCCUPANT_SLOTS)
        return self


class Occupant(Model):
    """Who sits in a seat, and does what; what is left out is drawn as for anybody."""

    subject: str | None = Field(None, description="Named, own or random person (S03, anna, R0007).")
    action: str | None = Field(None, description="The one thing that this person does.")
    profile: Profile | None = Field(None, description="This person's motion profile, in place of the scene's.")
    initial_pose_deg: Mapping[str, float] = Field(
        {},
        description="Joint axes that stand at an angle, e.g. lelbow.flexion: 40 (grips: 0..1), unless the profile moves them;"
        " the rest of the body is solved around them.",
    )
    belted: bool | None = Field(None, description="Whether the seat belt is worn.")
    belt: BeltWear | Literal["none"] | None = Field(
        None, exclude_if=lambda value: value is None, description="How it is worn, in place of `belted`."
    )
    outfit: int | None = Field(
        None,
        ge=0,
        exclude_if=lambda number: number is None,
        description="The number of the subject's outfit, from 0; left out: drawn.",
    )
    pose: ExactPose | None = Field(None, description="A whole pose, in place of a solved one.")

    @field_validator("initial_pose_deg")
    @classmethod
    def _within(cls, pose: Mapping[str, float]) -> Mapping[str, float]:
        standing(pose)
        return pose

    @cached_property
    def initial(self) -> Profile | None:
        """The profile that holds the initial pose; None where there is none."""
        return standing(self.initial_pose_deg) if self.initial_pose_deg else None

    @model_validator(mode="after")
    def _one_way(self) -> Occupant:
        if self.pose is not None and (self.profile is not None or self.initial_pose_deg):
            raise ConfigError(
                "a whole pose leaves nothing to a profile or an initial pose", hint="leave `pose` or the others out"
            )
        if self.belted is not None and self.belt is not None:
            raise ConfigError("belted and belt say the same of a person", hint="give one of the two")
        if self.outfit is not None and self.subject is None:
            raise ConfigError("an outfit's number is one of a subject's", hint="give subject as well, or leave outfit out")
        if self.pose is not None and self.pose.tongue is not None and (self.belted or self.belt not in (None, "none")):
            raise ConfigError(
                "a belt whose tongue is not plugged in is not worn", hint="leave out pose.tongue, or give belted: false"
            )
        if self.action is not None and self.pose is None:
            _ = ACTIONS[self.action]  # likewise
        return self


def check_seats(seats: Mapping[str, ExactSetting], occupants: Mapping[str, Occupant]) -> None:
    """Raises ConfigError for a seat whose setting is given twice."""
    for slot in seats:
        if (occupant := occupants.get(slot)) is not None and occupant.pose is not None:
            raise ConfigError(
                f"scene.seats and the whole pose in scene.occupants.{slot} both say how the seat is set",
                hint=f"leave {slot} out of scene.seats",
            )
