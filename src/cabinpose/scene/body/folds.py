"""Folds of cloth: trains of waves where and as bodies make them, at rest.

Compression wrinkles lie across (waist, elbow, hollow of the knee, trousers on the shoe), drag lines run out from the armpit
and the crotch, cloth that hangs falls in folds along. Each train waves, and comes and goes over a hand's breadth or two.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from cabinpose._native import body
from cabinpose.core import Bools, Floats, Floats32, Ints, Ints32
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.chart import Chart, load_chart
from cabinpose.scene.body.coverage import ARM_M, LEG_M, bump, step
from cabinpose.scene.body.parts import cut_skin

_BREAST = (0.107, 0.372)  # y and z (m) of its apex on the average adult: cloth is taut there
_BEND_M = 0.05  # between the folds inside a bent joint: two edges of the mesh
_SWAY_M, _PATCH_M = 0.16, 0.20  # wavelengths of the noise that bends a train, and of that which lets it come and go


class BlendRows(NamedTuple):
    """N vertices as weighted sums of others: start (N + 1,) of each row of parent and weight."""

    start: Ints32
    parent: Ints32
    weight: Floats32


class _Trains(NamedTuple):
    """Trains of waves on N vertices: phase (T, N) rad and strength (T, N), 0 .. 1, of each.

    length: (T,) by which a person's phases are multiplied · start: (T,) rad.
    """

    phase: Floats
    strength: Floats
    length: Floats
    start: Floats


@cache
def blend_rows() -> BlendRows:
    """`CutSkin.blend` as rows."""
    blend = cut_skin().blend
    needed = blend.weights != 0
    starts = np.concatenate([[0], np.cumsum(np.count_nonzero(needed, axis=1))])
    return BlendRows(starts.astype(np.int32), blend.parents[needed], blend.weights[needed].astype(np.float32))


def smooth_noise(wavelengths: Floats, where: Bools, size: float, *, rng: np.random.Generator) -> Floats:
    """Band-limited noise (V + N, F), about -1 .. 1: one field for each of `wavelengths` (F,) m, at every seen vertex.

    It is worked out on the skin's vertices `where` (V,), 0 elsewhere, and linear between: for wavelengths of several of
    the skin's edges. size: of the person, of an average adult's.
    """
    direction = rng.standard_normal((len(wavelengths), 4, 3))
    direction /= np.linalg.norm(direction, axis=2)[:, :, None]
    length = wavelengths[:, None] * rng.uniform(0.8, 1.5, direction.shape[:2])
    phases = rng.uniform(0, 2 * np.pi, length.shape)
    waves, blend = direction * (2 * np.pi / length)[:, :, None], blend_rows()
    out = np.empty((len(where) + len(blend.start) - 1, len(wavelengths)))
    body.fill_noise(load_chart().rest * size, np.flatnonzero(where), waves, phases, blend, out)
    return out


@cache
def seen_chart() -> Chart:
    """The chart at every vertex that is seen (V + N,)."""
    c, blend = load_chart(), cut_skin().blend

    def extended(values: Floats) -> Floats:
        return np.concatenate([values, blend.of(values)])

    return Chart(
        extended(c.rest), extended(c.side), extended(c.arm), extended(c.leg), extended(c.neck), extended(c.head),
        extended(c.along_arm), extended(c.along_leg), extended(c.up), c.heads,
    )  # fmt: skip


def around(points: Floats, axis: Floats) -> Floats:
    """Angle (N,) rad of points (N, 3) about an axis (direction (3,)) through the origin, 0 at the front."""
    axis = axis / rp.norm(axis)
    front = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    front /= rp.norm(front)
    return np.asarray(rp.arctan2(rp.matmul(points, np.cross(axis, front)), rp.matmul(points, front)))


@cache
def _mirrored() -> tuple[Floats, Floats, Floats]:
    """Points (N, 3) with all limbs on the left, and angles about the arm and the leg."""
    c = seen_chart()
    p = c.rest * np.where(c.rest[:, 1:2] < 0, (1.0, -1.0, 1.0), (1.0, 1.0, 1.0))
    shoulder, hip = c.heads["lupperarm01"], c.heads["lupperleg01"]
    arm = np.where(c.along_arm < 1, around(p - shoulder, c.heads["llowerarm01"] - shoulder), 0.0)
    lower = c.heads["llowerarm01"]
    arm = np.where(c.along_arm < 1, arm, around(p - lower, c.heads["lwrist"] - lower))
    return p, arm, around(p - hip, c.heads["lfoot"] - hip)


@cache
def front_of_thigh() -> Floats:
    """(V + N,) 1 where cloth is taut on who sits, falling off to the sides and to hip and knee."""
    c, (_, _, about_leg) = seen_chart(), _mirrored()
    return np.asarray(c.leg * (0.5 + 0.5 * rp.cos(about_leg)) * bump(c.along_leg, 0.6, 0.45))


@cache
def _trains(*, top: bool) -> tuple[Floats, Floats]:
    """Phase (T, N) rad and strength (T, N), 0 .. 1, of a top's or a bottom's trains."""
    c, turn = seen_chart(), 2 * np.pi
    p, about_arm, about_leg = _mirrored()
    front = step(p[:, 0], 0.0, 0.12)
    trunk = (1 - c.arm) * (1 - c.leg)
    if top:
        armpit = c.heads["lupperarm01"] - (0.0, 0.02, 0.07)
        off = p - armpit
        down = step(-c.up, -0.62, 0.35)
        arm, inner = c.arm, 0.6 + 0.4 * rp.cos(about_arm)
        taut = 1 - 0.9 * step(p[:, 0], 0.05, 0.06) * bump(rp.hypot(p[:, 1] - _BREAST[0], p[:, 2] - _BREAST[1]), 0.0, 0.065)
        trunk = (1 - c.arm) * taut
        made = [
            (turn * (p[:, 2] + 0.15 * p[:, 1]) / 0.050, trunk * bump(c.up, 0.20, 0.15)),
            (turn * (p[:, 2] - 0.6 * p[:, 1]) / 0.068, trunk * 0.7 * bump(c.up, 0.42, 0.16)),
            (
                13 * rp.arctan2(off[:, 2], -off[:, 1]) + 2 * front,
                taut * bump(rp.hypot(off[:, 1], off[:, 2]), 0.11, 0.07) * step(-off[:, 2], -0.04, 0.1),
            ),
            (14 * rp.arctan2(c.rest[:, 1], c.rest[:, 0]), trunk * down * 0.9),
            (turn * c.along_arm * ARM_M / 0.042 + 1.2 * rp.sin(about_arm), arm * 0.7 * inner * bump(c.along_arm, 1.0, 0.25)),
            (turn * c.along_arm * ARM_M / 0.060 + 3 * about_arm, arm * 0.5 * step(c.along_arm, 0.3, 0.4)),
            (turn * c.along_arm * ARM_M / 0.040 + 2 * about_arm, arm * 0.5 * bump(c.along_arm, 1.78, 0.22)),
        ]
    else:
        leg = np.maximum(c.leg, step(-c.up, -0.12, 0.15) * (1 - c.arm)) * (1 - 0.7 * front_of_thigh())
        behind = 0.5 - 0.5 * rp.cos(about_leg)
        crotch = p - (0.03, 0.0, -0.09)
        made = [
            (11 * rp.arctan2(crotch[:, 2], crotch[:, 1]), front * leg * bump(rp.hypot(crotch[:, 1], crotch[:, 2]), 0.12, 0.07)),
            (turn * (p[:, 2] - 0.5 * p[:, 1]) / 0.050, leg * 0.8 * bump(c.along_leg, 0.12, 0.16)),
            (turn * c.along_leg * LEG_M / 0.075 + 3 * about_leg, leg * 0.6 * bump(c.along_leg, 0.5, 0.4)),
            (turn * c.along_leg * LEG_M / 0.058 + about_leg, leg * (0.3 + 0.7 * behind) * bump(c.along_leg, 1.0, 0.18)),
            (turn * c.along_leg * LEG_M / 0.085 + 2 * about_leg, leg * 0.7 * bump(c.along_leg, 1.45, 0.35)),
            (turn * c.along_leg * LEG_M / 0.060 + 2 * about_leg, leg * bump(c.along_leg, 1.86, 0.15)),
        ]
    return np.array([phase for phase, _ in made]), np.array([strength for _, strength in made])


def folds(where: Ints, worn: Bools, seed: int, *, top: bool, size: float) -> Floats:
    """Height of the folds, 0 .. 0.8 about 0.4, of a top or a bottom at the seen vertices `where` (N,), fixed by the seed.

    worn: (V,) the skin's vertices under it and next to it · size: stature over that of the average adult, for folds as
    long on a child as on its parents.
    """
    rng = np.random.Generator(np.random.Philox(key=2 * seed + top))
    phase, strength = _trains(top=top)
    noise = smooth_noise(np.array([_SWAY_M] * 3 + [_PATCH_M] * len(phase)), worn, size, rng=rng)
    length = size * rng.uniform(0.9, 1.15, len(phase))
    start = rng.uniform(0, 2 * np.pi, len(phase))
    height = np.empty(len(where))
    body.raise_folds(_Trains(phase, strength, length, start), noise, where, height)
    return height


class BendFields(NamedTuple):
    """What a bent joint does to cloth about it, at every seen vertex (V + N,), 0 .. 1.

    ridges: folds across its inner side · taut: how smooth it is drawn on its outer side.
    """

    ridges: Floats
    taut: Floats


@cache
def bend_fields() -> dict[str, BendFields]:
    """By the degree of freedom of `rig.DOFS`, of both sides, whose flexion it is."""
    c, (_, about_arm, about_leg) = seen_chart(), _mirrored()
    front = 0.5 + 0.5 * rp.cos(about_leg)
    made = {}
    for joint, along, inner, weight, metres, at in (
        ("elbow", c.along_arm, 0.5 + 0.5 * rp.cos(about_arm), c.arm, ARM_M, 1.0),
        ("hip", c.along_leg, front, c.leg, LEG_M, 0.10),
        ("knee", c.along_leg, 1 - front, c.leg, LEG_M, 1.0),
    ):
        near = weight * bump(along, at, 0.09 / metres)
        wave = 0.5 + 0.5 * rp.cos(2 * np.pi * (along - at) * metres / _BEND_M)
        for side, sign in (("l", 1.0), ("r", -1.0)):
            own = near * (c.rest[:, 1] * sign > 0)
            made[f"{side}{joint}.flexion"] = BendFields(own * inner * inner * wave, own * step(0.5 - inner, 0.0, 0.5))
    return made
