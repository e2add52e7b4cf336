"""Where a person puts a seat: fore-aft, height and recline, chosen for the body, within the seat's ranges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cabinpose.core import CABINPOSE, Floats, Matrix, axis_rotation, transform
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import Person
from cabinpose.scene.cabin import Cabin, Seat, SeatSetting
from cabinpose.synth.posture.memory import kept_with_person
from cabinpose.synth.posture.seat_fit import fit_seat

# Preferred driving posture (Porter and Gyi 1998, "Exploring the optimum posture for driver comfort"): knee 121 deg
# and elbow 128 deg between the segments, with the spread of their 55 drivers.
_KNEE, _KNEE_SPREAD = np.radians(59.0), np.radians(10.0)
_ELBOW, _ELBOW_SPREAD = np.radians(52.0), np.radians(19.0)
# The foot against the leg: theirs were 80 to 113 deg, those of 127 drivers 85 to 113 (Wolf 2022); 90 is 0 here.
_ANKLE, _ANKLE_SPREAD = np.radians(-2.0), np.radians(7.0)
_BENT_ANKLE, _BENT_SPREAD = np.radians(12.0), np.radians(3.0)  # nobody sits so near that the ankle comes to its limit
# Who likes to sit far off likes straighter knees and elbows: so many of both spreads for one of a person's taste.
_TASTE, _TASTE_STEPS, _MOST_TASTE = 1.3, 2, 2.0  # of which whole and half ones are known, so that settings are shared
_RECLINE_SPREAD = np.radians(3.0)
_BELLY_GAP_M, _BELLY_SPREAD_M = 0.10, 0.03  # between the wheel's lower rim and the body
_THIGH_GAP_M, _THIGH_SPREAD_M = 0.050, 0.012  # between the rim and the thighs
_MOST_UNEASE = 25.0  # of thighs against the rim: nobody crawls under the wheel, where they would be free
_PALM_REACH_M = 0.075  # wrist to the rim in the hand
_HEIGHT_SPREAD_M = 0.02
_SHORT_M, _TALL_M = 1.50, 1.90  # statures that put the seat at its highest and lowest
_STEPS, _RECLINES_DEG = 21, (-6.0, -3.0, 0.0, 2.0, 4.0)
_OFFSET_SIGMAS = 2.0  # where a draw of an offset is cut
_BACK_SHARE, _ASIDE_SHARE = 0.3, 0.6  # what the backrest, and what bolsters and neighbours leave of it
_ROLL_SHARE = 0.3  # a pelvis turns more on a cushion than it tilts
_VARIATION = (0.015, 0.008, np.radians(2.0))  # sigma of fore-aft (m), height (m) and recline (rad)


# Front passengers' backrests: mean 25.4, SD 6.4 deg, 15 % above 30 (Reed 2020, UMTRI-2020-2). Against the seat's default, deg, of
# a normal number: the mean, the part of each, and what those above `_LEANS_FROM` lean back more (so shaped: assumed).
_RECLINED_DEG, _LEANS_FROM = (1.0, 4.0, 12.0), 0.9
_FULL_REAR = -0.74  # and below it the seat is at the rear end of its travel: 23 %, 92 % behind the middle (the same study)
_BACKREST_M, _KNEE_M, _RAISED_THIGH = 0.11, 0.10, 0.82  # depth of a backrest; before a knee joint; cosine of a thigh's slope
# By how much a front seat is moved forward for the knees behind it, at most: drivers move theirs less (assumed).
_MOVED_M = {"driver": 0.08, "front_passenger": 0.15}


class SeatOffset(NamedTuple):
    """How a person sits off the place that the seat gives: forward and left (m), turned to the left and to the right side (rad).

    In the seat's frame: yaw about its z, roll about its x, both through the femur heads' middle.
    """

    forward_m: float = 0.0
    left_m: float = 0.0
    yaw: float = 0.0
    roll: float = 0.0

    def applied(self, seat_from_root: Matrix) -> Matrix:
        """(4, 4) `seat_from_root` moved."""
        turn = transform(rp.matmul(axis_rotation("x", self.roll), axis_rotation("z", self.yaw)))
        turn[:3, :3] = rp.matmul(turn[:3, :3], seat_from_root[:3, :3])
        turn[:3, 3] = seat_from_root[:3, 3] + (self.forward_m, self.left_m, 0.0)
        return turn


CENTRED = SeatOffset()


def draw_offset(sigma_m: float, sigma: float, *, rng: np.random.Generator) -> SeatOffset:
    """An offset that is normal with a standard deviation ahead (m) and in yaw (rad), all draws cut at twice it.

    Less is left of it backwards, aside and in roll. Nothing is drawn where both are 0.
    """
    if sigma_m == 0.0 and sigma == 0.0:
        return CENTRED
    ahead, left, yaw, roll = (float(v) for v in np.clip(rng.standard_normal(4), -_OFFSET_SIGMAS, _OFFSET_SIGMAS))
    forward = sigma_m * (ahead if ahead > 0.0 else _BACK_SHARE * ahead)
    return SeatOffset(forward, _ASIDE_SHARE * sigma_m * left, sigma * yaw, _ROLL_SHARE * sigma * roll)


def choose_setting(
    person: Person, seat: Seat, cabin: Cabin, *, rng: np.random.Generator | None, variation: float = 0.0
) -> SeatSetting:
    """The setting at which this person would sit here: deterministic, or spread by `variation` (1: as people differ).

    A driver's legs, arms and belly decide; other seats go back with stature. `rng` is needed where variation > 0.
    """
    low, high = seat.ranges
    tallness = float(np.clip((person.stature_m - _SHORT_M) / (_TALL_M - _SHORT_M), 0.0, 1.0))
    height = high.height_m + tallness * (low.height_m - high.height_m)
    if variation > 0.0 and rng is None:
        raise ValueError("a variation of the seat needs rng")
    varied = np.zeros(3) if rng is None or variation == 0.0 else variation * rng.standard_normal(3)
    if seat.foot_support == "pedals" and cabin.steering_wheel is not None:
        taste = float(np.clip(np.round(_TASTE_STEPS * varied[0]) / _TASTE_STEPS, -_MOST_TASTE, _MOST_TASTE))
        varied[0] -= taste
        setting = _driver_setting(person, cabin, seat.slot, height, taste)
    else:
        fore_aft = float(np.interp(tallness, (0.0, 0.5, 1.0), (0.2 * high.fore_aft_m, -0.02, low.fore_aft_m)))
        setting = SeatSetting(fore_aft, 0.5 * height, seat.default.torso_angle)
    if variation > 0.0:
        change = np.asarray(_VARIATION) * varied
        setting = SeatSetting(setting.fore_aft_m + change[0], setting.height_m + change[1], setting.torso_angle + change[2])
        if seat.slot == "front_passenger":
            mean, each, more = _RECLINED_DEG
            leant = mean * variation + each * varied[2] + more * max(varied[2] - _LEANS_FROM, 0.0)
            rear = low.fore_aft_m if varied[0] < _FULL_REAR else setting.fore_aft_m
            setting = replace(setting, fore_aft_m=rear, torso_angle=seat.default.torso_angle + float(np.radians(leant)))
    recline = float(np.clip(setting.torso_angle, low.torso_angle, high.torso_angle))
    return SeatSetting(
        float(np.clip(setting.fore_aft_m, low.fore_aft_m, high.fore_aft_m)),
        float(np.clip(setting.height_m, low.height_m, high.height_m)),
        # Whole degrees where the range allows it, so that fits are shared between occupants.
        float(np.clip(np.radians(round(np.degrees(recline))), low.torso_angle, high.torso_angle)) if variation > 0.0 else recline,
    )


def with_leg_room(settings: Mapping[str, SeatSetting], people: Mapping[str, Person], cabin: Cabin) -> dict[str, SeatSetting]:
    """Front seats moved forward by what the knees of who sits behind them need, up to what their people would give.

    Parameters
    ----------
    settings
        Of all seats.
    people
        Who sits in them, by slot.
    cabin
        The car.
    """
    result = dict(settings)
    for slot, person in people.items():
        seat = cabin.seats[slot]
        before = next(
            (f for f in _MOVED_M if slot.startswith("rear") and f in cabin.seats and is_before(cabin.seats[f], seat)), None
        )
        if before is None:
            continue
        front, own = cabin.seats[before], settings[before]
        hip = float(seat.h_point(settings[slot])[0])
        slide = float(fit_seat(person, seat, settings[slot].torso_angle).seat_from_root[0, 3])
        thigh = person.segment_lengths["thigh"]
        knee = hip + slide + _RAISED_THIGH * thigh + _KNEE_M
        h_point = front.h_point(own)
        above = np.sqrt(1.0 - _RAISED_THIGH**2) * thigh + float(seat.h_point(settings[slot])[2] - h_point[2])
        back = behind(front, own) - above * float(rp.tan(own.torso_angle))
        moved = min(max(knee - back, 0.0), _MOVED_M[before])
        result[before] = replace(own, fore_aft_m=min(own.fore_aft_m + moved, max(front.ranges[1].fore_aft_m, own.fore_aft_m)))
    return result


def behind(front: Seat, setting: SeatSetting) -> float:
    """x of the back of a seat's backrest at the height of its H-point, m."""
    return float(front.h_point(setting)[0]) - front.backrest_behind_h_m - _BACKREST_M


def is_before(front: Seat, seat: Seat) -> bool:
    """Whether somebody in a seat has the back of a front seat before the knees."""
    same_way = rp.cos(front.facing_yaw - seat.facing_yaw) > 0.0
    return same_way and float(front.design_h_point[1] * seat.design_h_point[1]) > 0.0


@kept_with_person
def _driver_setting(person: Person, cabin: Cabin, slot: str, height: float, taste: float) -> SeatSetting:
    """The least discomfort over fore-aft, height and recline, in closed form in side view.

    taste: how much farther off than most a person likes to sit, in standard deviations.
    """
    seat, wheel = cabin.seats[slot], cabin.steering_wheel
    assert wheel is not None  # the caller saw to it
    low, high = seat.ranges
    pad = cabin.pedals["accelerator"]
    rest, lengths = person.rest, person.segment_lengths
    thigh, shin = lengths["thigh"], lengths["shin"]
    arm, forearm = lengths["upper_arm"], lengths["forearm"]
    sole = rest.soles[1]
    ball = rest.joint_offset[CABINPOSE.index["rfoot"], 0] - sole[0, 3]
    # The ankle of a foot that lies on the pad with its heel on the floor.
    along, out = pad[:3, 0], pad[:3, 2]
    pad_angle = float(rp.arctan2(along[2], along[0]))
    heel = pad[:3, 3] - (pad[2, 3] - seat.floor_z) / along[2] * along
    ankle = heel - sole[0, 3] * along - sole[2, 3] * out
    slack = max(0.0, ball - 0.23)  # very long feet bring the ankle back
    ankle = ankle - slack * along * (1.0, 0.0, 0.0)
    grip = 0.5 * (wheel.grip_point(np.pi / 2) + wheel.grip_point(-np.pi / 2))
    rim_bottom = wheel.grip_point(np.pi)
    fore_aft = np.linspace(low.fore_aft_m, high.fore_aft_m, _STEPS)
    heights = np.unique((low.height_m, height))
    place = np.stack([g.reshape(-1) for g in np.meshgrid(heights, fore_aft, indexing="ij")], axis=1)  # (P, 2) height, fore-aft
    h_points = seat.h_point(SeatSetting()) + place[:, 1:] * seat.vehicle_from_seat(seat.default)[:3, 0]
    h_points[:, 2] += place[:, 0]

    # Trunk and thighs as the default's fit has them, turned about the hips by how much farther a backrest leans.
    fit = fit_seat(person, seat, seat.default.torso_angle)
    at_hip = fit.seat_from_root[:3, 3]
    hip = h_points + at_hip
    leg = rp.hypot(*(ankle - hip)[:, [0, 2]].T)
    knee = _flexion(thigh, shin, leg)
    dorsiflexion = pad_angle - 0.5 * np.pi + _shin_angle(hip, ankle, thigh, shin, leg)
    thigh_gap = _under_rim(hip, ankle, thigh, shin, rim_bottom, float(fit.thigh_top.max())) - wheel.rim_section_m
    beside = wheel.rim_radius_m - 0.5 * abs(fit.shoulders[0, 1] - fit.shoulders[1, 1])
    common = (
        ((knee - _KNEE) / _KNEE_SPREAD + _TASTE * taste) ** 2
        + ((dorsiflexion - _ANKLE) / _ANKLE_SPREAD + _TASTE * taste) ** 2
        + (np.maximum(dorsiflexion - _BENT_ANKLE, 0.0) / _BENT_SPREAD) ** 2
        + ((place[:, 0] - height) / _HEIGHT_SPREAD_M) ** 2
        + (np.maximum(leg - 0.985 * (thigh + shin), 0.0) / 0.01) ** 2
        + np.minimum((np.maximum(_THIGH_GAP_M - thigh_gap, 0.0) / _THIGH_SPREAD_M) ** 2, _MOST_UNEASE)
    )

    reclines = np.unique(np.clip(seat.default.torso_angle + np.radians(_RECLINES_DEG), low.torso_angle, high.torso_angle))
    unease = ((reclines - seat.default.torso_angle) / _RECLINE_SPREAD) ** 2
    turns = np.stack([axis_rotation("y", float(angle)) for angle in seat.default.torso_angle - reclines])
    shoulder = at_hip + rp.matmul(turns, fit.shoulders.mean(axis=0) - at_hip)  # (R, 3) of R reclines
    ahead, above = np.moveaxis((grip - h_points)[None] - shoulder[:, None], -1, 0)[[0, 2]]  # (R, P)
    elbow = _flexion(arm, forearm, rp.hypot(rp.hypot(ahead, above), beside) - _PALM_REACH_M)
    front = at_hip + rp.matmul(fit.front - at_hip, turns.transpose(0, 2, 1))  # (R, N, 3)
    gap = np.empty((len(reclines), len(place)))
    for seat_height in heights:
        at = place[:, 0] == seat_height
        level = np.abs(front[..., 2] + h_points[at][0, 2] - rim_bottom[2]) < 0.06
        belly = np.where(level, front[..., 0], -np.inf).max(axis=1, keepdims=True)
        gap[:, at] = np.where(np.isfinite(belly), rim_bottom[0] - h_points[at, 0] - belly, 1.0)
    cost = (
        common
        + ((elbow - _ELBOW) / _ELBOW_SPREAD + _TASTE * taste) ** 2
        + unease[:, None]
        + (np.maximum(_BELLY_GAP_M - gap, 0.0) / _BELLY_SPREAD_M) ** 2
    )
    recline, n = np.unravel_index(np.argmin(cost), cost.shape)
    return SeatSetting(float(place[n, 1]), float(place[n, 0]), float(reclines[recline]))


def _flexion(upper: float, lower: float, distance: Floats) -> Floats:
    """Flexion (N,) rad of the hinge between two segments whose ends are `distance` (N,) apart; 0 where it is too far."""
    cosine = (upper * upper + lower * lower - distance * distance) / (2 * upper * lower)
    return np.asarray(np.pi - rp.arccos(np.clip(cosine, -1.0, 1.0)))


def _shin_angle(hip: Floats, ankle: Floats, thigh: float, shin: float, leg: Floats) -> Floats:
    """How far (N,) rad a shin falls forward from the knee, below the horizontal, in side view; hips (N, 3), `leg` (N,) m long."""
    x, z = (ankle - hip)[:, [0, 2]].T
    at_ankle = rp.arccos(np.clip((shin * shin + leg * leg - thigh * thigh) / (2 * shin * leg), -1.0, 1.0))
    return np.asarray(at_ankle - rp.arctan2(z, x))


def _under_rim(hip: Floats, ankle: Floats, thigh: float, shin: float, rim: Floats, top: float) -> Floats:
    """Height (N,) m of a point of the rim above the skin of a thigh, in side view: the knee from hips (N, 3), upwards."""
    x, z = (ankle - hip)[:, [0, 2]].T
    reach = np.minimum(rp.hypot(x, z), thigh + shin - 1e-6)
    at_hip = rp.arccos(np.clip((thigh * thigh + reach * reach - shin * shin) / (2 * thigh * reach), -1.0, 1.0))
    angle = rp.arctan2(z, x) + at_hip  # of the femur, above the horizontal
    along = np.clip((rim[0] - hip[:, 0]) / np.maximum(rp.cos(angle), 0.2), 0.0, thigh)
    return np.asarray(rim[2] - hip[:, 2] - along * rp.sin(angle) - top * rp.cos(angle))
