"""What legs do: a driver's at the pedals, a passenger's on the floor, drawn back, stretched or crossed; each leg for itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats
from cabinpose.scene.cabin import Cabin, Seat
from cabinpose.synth.posture.context import SeatContext
from cabinpose.synth.posture.feet import FootPlan, default_plans, drives
from cabinpose.synth.posture.neighbours import LOW_TUNNEL_M, tunnel_m
from cabinpose.synth.streams import own_rng

_ON_CUSHION = math.radians(54.0)  # lean of a shin at which the thigh stays on the cushion of a low seat
_OVER_TUNNEL_M = 0.10  # feet of a middle seat stand on both sides of the tunnel
_KNEES_IN_M = 0.02  # of a child, against those of somebody on a wide cushion
# By how much the knees of a child in a child seat differ at most (assumed): closer, and of one leg to the inside and the outside.
_CLOSER_M, _KNEE_IN, _KNEE_OUT = 0.01, math.radians(3.0), math.radians(1.0)


class LegStance(NamedTuple):
    """How a passenger's feet stand. share: of passengers with room for it · leans: rad, the farthest of the shin of the one foot
    and of the other · forward: m, of each from where it would rest · across: m, of each past the middle, None: not crossed.
    """

    share: float
    leans: tuple[float, float]
    forward: tuple[float, float] = (0.0, 0.0)
    across: float | None = None


_BACK = math.radians(21.0)
# Feet drawn back raise the front of 40 % of thighs, 5 % cross their legs (Reed 2020, UMTRI-2020-2), of whom more are drawn
# than find room; how both divide is assumed.
STANCES: Mapping[str, LegStance] = MappingProxyType(
    {
        "resting": LegStance(0.49, (_ON_CUSHION, _ON_CUSHION)),
        "drawn back": LegStance(0.14, (_BACK, _BACK)),
        "one drawn back": LegStance(0.15, (_BACK, _ON_CUSHION)),
        "one stretched": LegStance(0.11, (_ON_CUSHION, _ON_CUSHION), (0.07, -0.07)),
        "ankles crossed": LegStance(0.11, (_ON_CUSHION, math.radians(30.0)), (0.02, -0.08), 0.05),
    }
)
_ROOMY = frozenset({"ankles crossed"})  # not behind another seat, nor beside or opposite somebody
_APART, _TOGETHER = 0.20, 0.15  # shares of knees apart and of knees together (assumed)
_KNEES_APART_M, _KNEES_TOGETHER_M = 0.05, 0.03
_FORWARD_SIGMA_M, _OUT_SIGMA_M, _BOTH_SIGMA_M = 0.030, 0.014, 0.02
_KNEE_SIGMA, _TOE_SIGMA = math.radians(6.0), math.radians(4.0)
# Drivers (assumed): shares of the foot on the brake, of the left one on the floor, on the clutch, of a left knee that leans out.
_BRAKING, _OFF_REST, _ON_CLUTCH, _LEANING = 0.25, 0.15, 0.05, 0.15
_LEANING_OUT, _LEFT_SIGMA, _RIGHT_SIGMA = math.radians(14.0), math.radians(6.0), math.radians(4.0)
_BEHIND_REST_M = (-0.10, 0.03)  # of a heel from the footrest's: mean and sigma


def leg_plans(seated: SeatContext, *, rng: np.random.Generator) -> tuple[FootPlan, FootPlan]:
    """What the left and the right foot do; those of a child hang over the cushion of its seat."""
    chance, both = float(rng.random()), _BOTH_SIGMA_M * float(rng.standard_normal())
    apart = max(0.02 * float(rng.standard_normal()), -0.02)
    draws = rng.standard_normal((2, 2))
    more = own_rng(int(chance * 2**53), "legs")  # of their own, so that what is drawn next stays as it was
    shares, knees = more.random(3), more.standard_normal(2)
    seat, cabin = seated.seat, seated.cabin
    if drives(seat, cabin):
        return _at_pedals(seat, cabin, chance, float(shares[0]), np.clip(np.stack((knees, draws[0])), -2.0, 2.0))
    if abs(float(seat.design_h_point[1])) < 0.05 and tunnel_m(cabin) > LOW_TUNNEL_M:
        apart += _OVER_TUNNEL_M
    elif shares[0] < _APART:
        apart += _KNEES_APART_M + 0.02 * abs(float(draws[0, 1]))
    elif shares[0] > 1.0 - _TOGETHER:
        apart = -_KNEES_TOGETHER_M
    stance = _legs(seated, chance)
    first = 0 if shares[1] < 0.5 else 1
    plans = []
    for side in (0, 1):
        turn = 0 if side == first else 1
        plans.append(
            FootPlan(
                None,
                both + stance.forward[turn] + _FORWARD_SIGMA_M * float(draws[side, 0]),
                apart + _OUT_SIGMA_M * float(draws[side, 1]),
                math.radians(7.0) + _TOE_SIGMA * float(draws[side, 1]),
                _KNEE_SIGMA * float(knees[side]),
                stance.leans[turn],
                stance.across,
            )
        )
    if seated.on is None:
        return plans[0], plans[1]
    rests = seated.on.thing.sitting is not None and not seated.on.thing.sitting.harness
    return _hanging(plans[0], rests), _hanging(plans[1], rests)


def _legs(seated: SeatContext, chance: float) -> LegStance:
    """The stance that a number between 0 and 1 stands for: those that need room count where nobody and no seat takes it."""
    beside = seated.neighbours
    free = not (seated.seat.slot.startswith("rear") or any(beside.close) or beside.faced) and seated.on is None
    known = [stance for name, stance in STANCES.items() if free or name not in _ROOMY]
    rest = chance * sum(stance.share for stance in known)
    for stance in known:
        rest -= stance.share
        if rest < 0.0:
            return stance
    return known[0]


def _at_pedals(seat: Seat, cabin: Cabin, chance: float, left: float, draws: Floats) -> tuple[FootPlan, FootPlan]:
    """A driver's feet: the right one on accelerator or brake, the left one on its rest, the floor behind it or the clutch.

    chance, left: between 0 and 1 · draws: (2, 2) normal numbers, the knees' first.
    """
    rest, right = default_plans(seat, cabin)
    if chance < _BRAKING and "brake" in cabin.pedals:
        right = FootPlan("brake")
    right = right._replace(knee_out=_RIGHT_SIGMA * float(draws[0, 1]))
    out = _LEFT_SIGMA * float(draws[0, 0]) + (_LEANING_OUT if left < _LEANING else 0.0)
    if left > 1.0 - _ON_CLUTCH and "clutch" in cabin.pedals:
        return FootPlan("clutch", knee_out=out), right
    if rest.pedal is None or left > 1.0 - _ON_CLUTCH - _OFF_REST:
        mean, sigma = _BEHIND_REST_M
        return FootPlan(None, mean + sigma * float(draws[1, 0]), 0.02 + 0.015 * float(draws[1, 1]), knee_out=out), right
    return rest._replace(knee_out=out), right


def _hanging(plan: FootPlan, rests: bool) -> FootPlan:
    """The foot of a child whose shins hang over a cushion: not drawn back into it, the knees between the `rests` or walls."""
    out, knee_out = min(max(plan.out, -_CLOSER_M), 0.0), min(max(plan.knee_out, -_KNEE_IN), _KNEE_OUT)
    return plan._replace(forward=max(plan.forward, 0.0), out=out - _KNEES_IN_M if rests else out, knee_out=knee_out)
