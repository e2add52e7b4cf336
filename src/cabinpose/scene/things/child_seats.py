"""Child seats: a rearward-facing infant carrier, a forward-facing toddler seat, boosters with and without a back.

Each stands in a frame with x forwards along the car's cushion, z off the cushion, and the origin below where it meets the
backrest, which leans back by about ten degrees there. Outer measures stay within the fixtures that UN R16 (Annex 17, Appendix 2)
and UN R129 hold car seats against: 440 mm wide, a forward-facing seat up to 720 mm high (ISO/F3), an infant carrier as ISO/R1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.shapes import Solid, join, prism, rounded_box, slab, sweep, tube
from cabinpose.scene.things.pieces import Kind, Piece, of_design, shell

PADDING_M = 0.020  # of a child seat gives way, on which a hand or a neighbour's arm may lie
ARMREST_M = 0.049  # of a booster, from its cushion to the middle of the rests
_REST_M, _POST_M = (0.250, 0.045, 0.030), 0.055  # of an armrest, long, wide, thick; along it, of the post before it
_GUIDE_M = (0.105, 0.176, 0.017)  # the opening behind the post, above the cushion: x, y, z
_TILTED_RAD, _TILTED_ABOUT, _TILTED_BACK_M = np.radians(16.0), (0.25, 0.13), 0.045  # of a carrier in use, (x, z) m
_LINER, _SHELL = (0.0, 0.022), (0.020, 0.040)  # padding over the shell that carries it
_TODDLER_RIM = (0.370, 0.194)  # where a toddler seat's shell ends, (x, z) m: the padding before it is soft to the calves


class Sitting(NamedTuple):
    """Where a child sits in a child seat, in its frame seen from the side.

    stature_m: of the children that it holds · cushion: height (m) of the padding at x = 0, and its slope · back: x (m) of the
    padding at z = 0, and how it leans, dx/dz; None where the car's own backrest carries the back · front_m: x of the cushion's
    front edge · harness: whether it has one; else the car's belt is worn · guide_m: (x, y, z) of the opening below the left
    armrest, through which the belt's lap part runs.
    """

    stature_m: tuple[float, float]
    cushion: tuple[float, float]
    back: tuple[float, float] | None
    front_m: float
    harness: bool = False
    guide_m: tuple[float, float, float] | None = None


class Lying(NamedTuple):
    """Where an infant lies in a child seat that looks back, in its frame seen from the side.

    stature_m: of the infants that it holds, lying · back: two points (x, z) m of the padding under the back, from the hips to the
    head · bottom_m: height of the padding under the buttocks.
    """

    stature_m: tuple[float, float]
    back: tuple[tuple[float, float], tuple[float, float]]
    bottom_m: float


class BeltPath(NamedTuple):
    """Where a belt runs that holds a child seat: points of its lap and its shoulder part, (3,) m of the seat's frame.

    over: whether it runs over the shell, not through the base.
    """

    points: tuple[tuple[float, float, float], tuple[float, float, float]]
    over: bool = False


@dataclass(frozen=True)
class ChildSeat(Kind):
    """A child seat. One called `NAME_in_use` stands in place of NAME once a child sits in it.

    sitting: where a child sits, of a design; None where none does · belt_path: of the car's belt, where that or isofix holds it ·
    lying: where an infant lies, likewise.
    """

    sitting: Callable[[int], Sitting] | None = None
    belt_path: BeltPath | None = None
    lying: Callable[[int], Lying] | None = None


def _scaled(pieces: tuple[Piece, ...], scale: float) -> tuple[Piece, ...]:
    return tuple(piece._replace(solid=Solid(piece.solid.vertices * scale, piece.solid.faces)) for piece in pieces)


def _ribbon(path: list[tuple[float, float, float]], width: float) -> Solid:
    """A strap along points (x, y, z) m, flat to the x-z plane's normal."""
    half = np.array(((0.002, -width / 2), (0.002, width / 2), (-0.002, width / 2), (-0.002, -width / 2)))
    return sweep(np.array(path), half[None], up=(1.0, 0.0, 0.4))


def _hood(pivot: tuple[float, float], half_width: float, reach: float, low: float, high: float) -> Solid:
    """A sunshade: bows of cloth that turn about a pivot (x, z) m, from angle `low` to `high` (rad above the car's forward)."""

    def bows(shrink: float) -> Floats:
        turn = np.linspace(low, high, 7)[:, None]
        along = np.linspace(0.10, np.pi - 0.10, 13)[None]
        out = (reach - shrink) * rp.power(rp.sin(along), 0.8)
        across = (half_width - shrink) * rp.cos(along)
        x, z = pivot[0] + rp.cos(turn) * out, pivot[1] + rp.sin(turn) * out
        return np.stack((x, np.broadcast_to(across, x.shape), z), axis=-1)

    return slab(bows(0.0), bows(0.006)).outward()


def _infant(variant: int) -> tuple[Piece, ...]:
    """A carrier of 0.62 to 0.67 m, with its handle up on every other design, and a sunshade that is open or half closed."""
    tub = [(0.045, 0.330), (0.085, 0.215), (0.185, 0.135), (0.300, 0.135), (0.420, 0.195), (0.530, 0.275), (0.610, 0.380)]
    half = (0.120, 0.140, 0.165, 0.175, 0.172, 0.165, 0.140)
    wall = (0.020, 0.070, 0.130, 0.150, 0.160, 0.150, 0.060)
    handle_up = variant % 2 == 0
    turn = np.radians(78.0 if handle_up else 162.0)  # of the handle, above the car's forward: up, or put back over the feet
    pivot, reach, wide = np.array((0.330, 0.285)), 0.275 if handle_up else 0.300, 0.205
    bend = np.linspace(0.0, np.pi, 13)
    out = reach * np.clip(1.35 * rp.sin(bend), 0.0, 1.0)
    across = wide * rp.cos(bend)
    handle = np.column_stack((pivot[0] + rp.cos(turn) * out, across, pivot[1] + rp.sin(turn) * out))
    base = [(0.060, 0.0), (0.520, 0.0), (0.545, 0.060), (0.470, 0.130), (0.200, 0.105), (0.080, 0.120)]
    closed = np.radians(of_design(70.0, 112.0, variant, 3))
    pieces = (
        Piece("shell", shell(tub, half, wall, _SHELL), "hard_plastic"),
        Piece("padding", shell(tub, half, wall, _LINER), "seat_fabric", PADDING_M),
        Piece("handle", tube(handle, 0.013, 8), "hard_plastic"),
        Piece("sunshade", _hood((0.415, 0.315), 0.196, 0.285, np.radians(22.0), closed), "synthetic_fabric", PADDING_M),
        Piece("base", prism(base, -0.165, 0.165), "hard_plastic"),
    )
    return _scaled(pieces, of_design(0.91, 1.0, variant, 1))


def _infant_in_use(variant: int) -> tuple[Piece, ...]:
    """The same with an infant in it: a foot of the base is out, so that the tub lies flatter on a cushion that slopes back."""
    scale = of_design(0.91, 1.0, variant, 1)
    (x, z), back = (scale * _TILTED_ABOUT[0], scale * _TILTED_ABOUT[1]), scale * _TILTED_BACK_M

    def tilted(solid: Solid) -> Solid:
        return solid.shifted(-x, 0.0, -z).turned("y", _TILTED_RAD).shifted(x - back, 0.0, z)

    return tuple(p if p.name == "base" else p._replace(solid=tilted(p.solid)) for p in _infant(variant))


def _toddler_in_use(variant: int) -> tuple[Piece, ...]:
    """The same with a child in it, on which the harness lies then."""
    return tuple(piece for piece in _toddler(variant) if piece.name not in ("harness", "buckle"))


def _toddler(variant: int) -> tuple[Piece, ...]:
    """A seat of the sizes ISO/F2X to ISO/F3, with a harness of five points."""
    seat = [(-0.020, 0.655), (0.012, 0.520), (0.045, 0.380), (0.080, 0.260), (0.130, 0.185), (0.230, 0.165), (0.340, 0.185),
            (0.400, 0.205)]  # fmt: skip
    half = (0.125, 0.150, 0.155, 0.150, 0.150, 0.160, 0.160, 0.140)
    wall = (0.140, 0.165, 0.130, 0.080, 0.075, 0.100, 0.090, 0.030)
    carrier = [(0.010, 0.0), (0.370, 0.0), (0.400, 0.040), (0.370, 0.160), (0.230, 0.130), (0.110, 0.150), (0.030, 0.300),
               (-0.020, 0.500), (-0.060, 0.500), (-0.030, 0.200)]  # fmt: skip
    straps = [
        _ribbon([(0.036, s * 0.050, 0.475), (0.068, s * 0.052, 0.360), (0.108, s * 0.048, 0.265), (0.170, s * 0.030, 0.215),
                 (0.215, s * 0.012, 0.200)], 0.036)
        for s in (-1.0, 1.0)
    ]  # fmt: skip
    buckle = rounded_box((0.055, 0.050, 0.022), 0.008, (1, 1, 1), corner=1).shifted(0.235, 0.0, 0.196)
    headrest = rounded_box((0.030, 0.200, 0.150), 0.014, (1, 2, 2), corner=1).turned("y", -0.22).shifted(0.018, 0.0, 0.560)
    pieces = (
        Piece("shell", shell([*seat[:-1], _TODDLER_RIM], half, (*wall[:-1], 0.050), _SHELL), "hard_plastic"),
        Piece("padding", shell(seat, half, wall, _LINER), "seat_fabric", PADDING_M),
        Piece("headrest", headrest, "synthetic_fabric", PADDING_M),
        Piece("harness", join(straps), "belt_webbing", PADDING_M),
        Piece("buckle", buckle, "hard_plastic"),
        Piece("base", prism(carrier, -0.150, 0.150), "hard_plastic"),
    )
    return _scaled(pieces, of_design(0.92, 1.04, variant, 1))


def _cushion(high: float) -> tuple[Piece, ...]:
    """What a child sits on, with rests on posts, behind which the belt runs below them."""
    cushion = rounded_box((0.400, 0.380, high), (0.050, 0.045, 0.035), (4, 4, 1), corner=2).shifted(0.235, 0.0, high / 2.0)
    rests = [
        piece.shifted(0.215, s * 0.190, high)
        for s in (-1.0, 1.0)
        for piece in (
            rounded_box(_REST_M, 0.014, (3, 1, 1), corner=1).shifted(z=ARMREST_M),
            rounded_box((_POST_M, 0.040, 0.070), 0.014, (1, 1, 1), corner=1).shifted(0.5 * (_REST_M[0] - _POST_M), 0.0, 0.022),
        )
    ]
    return (Piece("cushion", cushion, "seat_fabric", PADDING_M), Piece("armrests", join(rests), "hard_plastic"))


def _booster_cushion(variant: int) -> tuple[Piece, ...]:
    """A cushion alone, for the tallest children (UN R129: from 1.25 m)."""
    return _scaled(_cushion(of_design(0.090, 0.120, variant, 2)), of_design(0.95, 1.02, variant, 1))


def _booster(variant: int) -> tuple[Piece, ...]:
    """A cushion of 0.10 to 0.14 m with a back whose wings stand beside shoulders and head."""
    high = of_design(0.100, 0.140, variant, 2)
    lift = high - 0.12
    back = [(-0.048, 0.640), (-0.026, 0.560), (0.000, 0.450), (0.028, 0.330), (0.055, 0.200), (0.070, 0.120 + lift)]
    half = (0.120, 0.140, 0.170, 0.160, 0.160, 0.160)
    wall = (0.120, 0.150, 0.130, 0.070, 0.050, 0.030)
    pieces = (
        *_cushion(high),
        Piece("back", shell(back, half, wall, _SHELL), "hard_plastic"),
        Piece("padding", shell(back, half, wall, _LINER), "seat_fabric", PADDING_M),
    )
    return _scaled(pieces, of_design(0.93, 1.0, variant, 1))


def _in_booster(variant: int) -> Sitting:
    scale, high = of_design(0.93, 1.0, variant, 1), of_design(0.100, 0.140, variant, 2)
    return Sitting((1.00, 1.25), (scale * high, 0.0), (scale * 0.099, -0.22), scale * 0.430, guide_m=_guide(scale, high))


def _guide(scale: float, high: float) -> tuple[float, float, float]:
    return scale * _GUIDE_M[0], scale * _GUIDE_M[1], scale * (high + _GUIDE_M[2])


def _on_booster_cushion(variant: int) -> Sitting:
    scale, high = of_design(0.95, 1.02, variant, 1), of_design(0.090, 0.120, variant, 2)
    return Sitting((1.20, 1.50), (scale * high, 0.0), None, scale * 0.430, guide_m=_guide(scale, high))


def _in_toddler(variant: int) -> Sitting:
    scale = of_design(0.92, 1.04, variant, 1)
    return Sitting((0.70, 1.05), (scale * 0.130, 0.15), (scale * 0.135, -0.236), scale * 0.41, harness=True)


def _in_infant(variant: int) -> Lying:
    scale = of_design(0.91, 1.0, variant, 1)

    def tilted(x: float, z: float) -> tuple[float, float]:
        ahead, up = x - _TILTED_ABOUT[0], z - _TILTED_ABOUT[1]
        sine, cosine = float(rp.sin(_TILTED_RAD)), float(rp.cos(_TILTED_RAD))
        return (
            scale * (_TILTED_ABOUT[0] - _TILTED_BACK_M + cosine * ahead + sine * up),
            scale * (_TILTED_ABOUT[1] - sine * ahead + cosine * up),
        )

    return Lying((0.45, 0.76), (tilted(0.340, 0.155), tilted(0.600, 0.368)), tilted(0.24, 0.135)[1])


_IN_CARRIER = BeltPath(((0.330, 0.0, 0.28), (0.610, 0.0, 0.36)), over=True)
_IN_TODDLER = BeltPath(((0.120, 0.0, 0.13), (0.000, 0.0, 0.40)))
# Classes by the words of SVIRO: an infant seat looks back, a child seat forward.
CHILD_SEATS: Mapping[str, ChildSeat] = MappingProxyType(
    {
        "infant": ChildSeat("infant_seat", _infant, belt_path=_IN_CARRIER, lying=_in_infant),
        "toddler": ChildSeat("child_seat", _toddler, sitting=_in_toddler, belt_path=_IN_TODDLER),
        "booster": ChildSeat("child_seat", _booster, sitting=_in_booster),
        "booster_cushion": ChildSeat("child_seat", _booster_cushion, sitting=_on_booster_cushion),
        "infant_in_use": ChildSeat("infant_seat", _infant_in_use, belt_path=_IN_CARRIER, lying=_in_infant),
        "toddler_in_use": ChildSeat("child_seat", _toddler_in_use, sitting=_in_toddler, belt_path=_IN_TODDLER),
    }
)
CHILD_SEAT_LABELS = frozenset(kind.label for kind in CHILD_SEATS.values())
