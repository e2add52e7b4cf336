"""Tries people in every seat of a car, one at a time, and measures what is in their way and how deep they sink in."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from cabinpose.core import CABINPOSE, Floats, apply, invert
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import SEGMENTS, SUBJECTS, BodyModel, Person, PosedBody
from cabinpose.scene.cabin import BACK_BOX, CUSHION_BOX, WHEEL_GROUP, Cabin, Seat, SeatSetting
from cabinpose.scene.contact import first_crossings
from cabinpose.synth.config import CabinScene
from cabinpose.synth.posture import SeatContext, choose_setting, draw_offset, random_action
from cabinpose.synth.posture.sampling import Doing, draw_pose, settled
from cabinpose.synth.streams import frame_rng
from cabinpose.synth.validate import SITTING, Rejection, Validator

SeatSide = Literal["base", "back"]
PEOPLE = ("S01", "S02", "S03", "S04")  # who is tried
PUSHED_M = 0.02  # from the H-point: farther away a seat has pushed somebody off; the presets leave 12 mm at most
_SKIN_STEP = 5  # every fifth point of the skin is measured
_LEVEL = 0.7  # of a normal's vertical part: cushions are more level than this, backrests less
SEAT_BOXES: Mapping[SeatSide, Floats] = {"base": CUSHION_BOX, "back": BACK_BOX}


@dataclass
class SeatTrial:
    """What came of the poses tried in one seat.

    off_m: how far from the H-point those sit who hold, that is how far the seat pushes them away ·
    rejections: why the others did not hold · where: (3,) m, vehicle frame, of each refusal by the car ·
    sunk_m: by part, and by the side of the seat, how deep trunk and thighs would lie behind its surface, at
    most, if they sat on the H-point.
    """

    tried: int = 0
    held: int = 0
    off_m: list[float] = field(default_factory=list)
    rejections: Counter[Rejection] = field(default_factory=Counter)
    where: list[Floats] = field(default_factory=list)
    sunk_m: dict[tuple[str, SeatSide], float] = field(default_factory=dict)

    @property
    def pushed_m(self) -> tuple[float, ...]:
        """How far those were pushed who hold, but not where they should sit."""
        return tuple(off for off in self.off_m if off > PUSHED_M)


def try_seats(cabin: Cabin, *, poses: int, seed: int = 0) -> dict[str, SeatTrial]:
    """People of four builds in each seat of a cabin, alone, in `poses` poses as `synth` draws them."""
    validator = Validator(cabin)
    model = BodyModel.load()
    people = [model.person(SUBJECTS[name].phenotype, SUBJECTS[name].outfit) for name in PEOPLE]
    trials = {slot: SeatTrial() for slot in cabin.seats}
    for slot, trial in trials.items():
        for number in range(poses):
            _try(trial, people[number % len(people)], cabin, cabin.seats[slot], validator, frame_rng(seed, number))
    return trials


def _try(trial: SeatTrial, person: Person, cabin: Cabin, seat: Seat, validator: Validator, rng: np.random.Generator) -> None:
    """One pose of one person, counted in `trial`."""
    scene = CabinScene()
    setting = choose_setting(person, seat, cabin, rng=rng, variation=scene.seat_variation)
    settings = {slot: s.default for slot, s in cabin.seats.items()} | {seat.slot: setting}
    offset = draw_offset(scene.people_jitter_m, np.radians(scene.people_jitter_deg), rng=rng)
    action = random_action(seat, cabin, rng=rng)
    drawn = draw_pose(SeatContext(person, seat, setting, cabin, offset), Doing(action), rng=rng)
    sits = drawn.sitter.root.copy()
    empty = validator.empty(settings, drawn.wheel_angle or 0.0)
    (pose,) = settled([drawn], (), empty.placed)
    posed = person.pose(pose.q, pose.vehicle_from_root)
    trial.tried += 1
    verdict, _ = validator.admit(empty, (seat.slot, person, posed))
    refused = verdict.rejection
    if refused is not None and refused.cause == "car" and verdict.where is not None:
        trial.where.append(verdict.where)
    elif pose.refused:
        refused = Rejection("reach", seat.slot, pose.refused, pose.held_up_by)
    off = rp.norm(pose.vehicle_from_root[:3, 3] - sits[:3, 3])
    if refused is None:
        trial.held += 1
        trial.off_m.append(off)
    else:
        trial.rejections[refused] += 1
    if off > PUSHED_M or (refused is not None and refused.cause == "car" and refused.what in SITTING):
        free = person.pose(pose.q, sits)
        _measure(trial, person, free, cabin, seat, setting, settings)


def _measure(
    trial: SeatTrial,
    person: Person,
    posed: PosedBody,
    cabin: Cabin,
    seat: Seat,
    setting: SeatSetting,
    settings: Mapping[str, SeatSetting],
) -> None:
    """How deep trunk and thighs lie behind each part's surface near the seat: along lines from the bones to the skin."""
    starts, ends = _from_bone_to_skin(person, posed)
    seat_from_vehicle = invert(seat.vehicle_from_seat(setting))
    starts, ends = apply(seat_from_vehicle, starts), apply(seat_from_vehicle, ends)
    outward = (ends - starts) / np.maximum(np.linalg.norm(ends - starts, axis=1, keepdims=True), 1e-9)
    transforms = cabin.group_transforms(settings)
    for part in cabin.parts:
        if part.group == WHEEL_GROUP:
            continue
        felt = ends + part.shell_m * outward  # an open surface is met before it is crossed
        corners = apply(rp.matmul(seat_from_vehicle, transforms[part.group]), part.surface.vertices)[part.surface.faces]
        for side, box in SEAT_BOXES.items():
            middle = corners.mean(axis=1)
            near = corners[((middle > box[0]) & (middle < box[1])).all(axis=1)]
            normal = np.cross(near[:, 1] - near[:, 0], near[:, 2] - near[:, 0])
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
            carries = (np.abs(normal[:, 2]) > _LEVEL) == (side == "base")
            share, which = first_crossings(starts, felt, near[carries])
            met = np.flatnonzero(which >= 0)
            if len(met):
                beyond = (1 - share[met, None]) * (felt - starts)[met]
                depth = float(np.abs((beyond * normal[carries][which[met]]).sum(axis=1)).max())
                trial.sunk_m[part.name, side] = max(trial.sunk_m.get((part.name, side), 0.0), depth)


def _from_bone_to_skin(person: Person, posed: PosedBody) -> tuple[Floats, Floats]:
    """(N, 3) m each, vehicle frame: points of the skin of trunk and thighs, and the place of the bone nearest to each."""
    at = {name: posed.joints[i] for name, i in CABINPOSE.index.items()}
    hips = (at["lpelvis"] + at["rpelvis"]) / 2
    bones = dict.fromkeys(("pelvis", "abdomen", "thorax"), (hips, at["chest"]))
    bones |= {side + "thigh": (at[side + "pelvis"], at[side + "knee"]) for side in "lr"}
    starts, ends = [], []
    for name, (one, other) in bones.items():
        skin = posed.skin[person.skin_segment == SEGMENTS.index(name)][::_SKIN_STEP].astype(np.float64)
        along = other - one
        share = np.clip(rp.matmul(skin - one, along) / (rp.matmul(along, along)), 0.0, 1.0)
        starts.append(one + share[:, None] * along)
        ends.append(skin)
    return np.concatenate(starts), np.concatenate(ends)
