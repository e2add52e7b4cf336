"""Everyday objects on seats, on laps and in hands. Each stands on z = 0 about the origin, the way it is put down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.shapes import Solid, join, rounded_box, smoothstep, tube
from cabinpose.scene.things.pieces import Kind, Piece, of_design, standing_box, turned_body

CLOTH_M = 0.020  # cloth of a bag with what is soft in it gives way by this


def _box(variant: int) -> tuple[Piece, ...]:
    size = (of_design(0.16, 0.34, variant, 1), of_design(0.20, 0.38, variant, 2), of_design(0.11, 0.26, variant, 3))
    tape = rounded_box((size[0] + 0.002, 0.05, 0.001), 0.0004, (1, 1, 1), corner=1).shifted(0.0, 0.0, size[2] + 0.0002)
    return (Piece("carton", standing_box(size, 0.003), "cardboard"), Piece("tape", tape, "hard_plastic"))


def _bag(variant: int) -> tuple[Piece, ...]:
    """A handbag: narrower at its top, with two handles."""
    deep, wide, high = of_design(0.10, 0.15, variant, 1), of_design(0.26, 0.36, variant, 2), of_design(0.20, 0.28, variant, 3)

    def bend(p: Floats) -> Floats:
        x, y, z = p.T
        top = smoothstep(z, 0.0, high)
        belly = 1.0 + 0.12 * rp.sin(np.pi * np.clip(z / high, 0.0, 1.0)) * (1.0 - (2.0 * y / wide) ** 2)
        return np.stack((x * (1.0 - 0.62 * top) * belly, y * (1.0 - 0.14 * top), z), axis=-1)

    box = rounded_box((deep, wide, high), (0.030, 0.040, 0.025), (3, 6, 6), corner=2).shifted(0.0, 0.0, high / 2.0)
    arc = np.linspace(0.0, np.pi, 11)
    handles = [
        tube(
            np.column_stack((np.full(11, s * 0.12 * deep), 0.26 * wide * rp.cos(arc), high - 0.012 + 0.13 * rp.sin(arc))),
            0.006,
            6,
        )
        for s in (-1.0, 1.0)
    ]
    return (Piece("body", box.deformed(bend), "seat_leather", CLOTH_M), Piece("handles", join(handles), "seat_leather", CLOTH_M))


def _backpack(variant: int) -> tuple[Piece, ...]:
    """A backpack that stands: a rounded body with a pocket before it, a loop on top and two straps behind."""
    deep, wide, high = of_design(0.15, 0.19, variant, 1), of_design(0.27, 0.32, variant, 2), of_design(0.36, 0.46, variant, 3)

    def bend(p: Floats) -> Floats:
        x, y, z = p.T
        top = smoothstep(z, 0.55 * high, high)
        return np.stack((x * (1.0 - 0.35 * top) - 0.02 * top, y * (1.0 - 0.18 * top), z), axis=-1)

    body = rounded_box((deep, wide, high), (0.06, 0.08, 0.07), (3, 4, 6), corner=2).shifted(0.0, 0.0, high / 2.0).deformed(bend)
    pocket = rounded_box((0.07, 0.74 * wide, 0.42 * high), (0.03, 0.05, 0.05), (1, 3, 3), corner=2)
    arc = np.linspace(0.0, np.pi, 9)
    loop = tube(np.column_stack((np.full(9, -0.3 * deep), 0.035 * rp.cos(arc), high - 0.012 + 0.045 * rp.sin(arc))), 0.007, 6)
    straps = [
        tube([(-0.42 * deep, s * 0.075, 0.92 * high), (-0.56 * deep, s * 0.085, 0.72 * high),
              (-0.60 * deep, s * 0.10, 0.45 * high), (-0.45 * deep, s * 0.12, 0.14 * high)], 0.011, 6)
        for s in (-1.0, 1.0)
    ]  # fmt: skip
    return (
        Piece("body", body, "synthetic_fabric", CLOTH_M),
        Piece("pocket", pocket.shifted(0.5 * deep, 0.0, 0.27 * high), "synthetic_fabric", CLOTH_M),
        Piece("straps", join([loop, *straps]), "belt_webbing", CLOTH_M),
    )


def _bottle(variant: int) -> tuple[Piece, ...]:
    """A bottle of 0.5 to 0.75 l with its cap, of steel or of plastic."""
    radius, high = of_design(0.031, 0.036, variant, 1), of_design(0.20, 0.25, variant, 2)
    outline = [(0.6 * radius, 0.0), (0.95 * radius, 0.004), (radius, 0.015), (radius, 0.62 * high), (0.92 * radius, 0.70 * high),
               (0.55 * radius, 0.82 * high), (0.014, 0.86 * high), (0.013, 0.90 * high)]  # fmt: skip
    cap = [(0.0155, 0.885 * high), (0.0165, 0.89 * high), (0.0165, high - 0.002), (0.0145, high)]
    material = "metal" if variant % 2 else "hard_plastic"
    return (Piece("body", turned_body(outline), material), Piece("cap", turned_body(cap), "hard_plastic"))


def _cup(variant: int) -> tuple[Piece, ...]:
    """A paper cup with its lid."""
    low, top, high = of_design(0.028, 0.031, variant, 1), of_design(0.038, 0.042, variant, 1), of_design(0.095, 0.145, variant, 2)
    outline = [(low - 0.002, 0.0), (low, 0.002), (0.5 * (low + top), 0.5 * high), (top, high), (top - 0.001, high + 0.001)]
    lid = [(top + 0.002, high - 0.004), (top + 0.003, high), (top + 0.002, high + 0.004), (top - 0.006, high + 0.006),
           (top - 0.008, high + 0.014), (top - 0.012, high + 0.015)]  # fmt: skip
    return (Piece("body", turned_body(outline), "paper"), Piece("lid", turned_body(lid), "hard_plastic"))


def _book(variant: int) -> tuple[Piece, ...]:
    """A book that lies shut."""
    wide, high, thick = of_design(0.12, 0.15, variant, 1), of_design(0.19, 0.23, variant, 2), of_design(0.014, 0.032, variant, 3)
    block = standing_box((wide - 0.006, high - 0.006, thick - 0.004), 0.002).shifted(-0.001, 0.0, 0.002)
    boards = [rounded_box((wide, high, 0.003), 0.001, (1, 1, 1), corner=1).shifted(0.0, 0.0, z) for z in (0.0015, thick - 0.0015)]
    spine = rounded_box((0.003, high, thick), 0.001, (1, 1, 1), corner=1).shifted(-0.5 * wide + 0.0015, 0.0, 0.5 * thick)
    return (Piece("pages", block, "paper"), Piece("cover", join([*boards, spine]), "cardboard"))


def _open_book(variant: int) -> tuple[Piece, ...]:
    """A book that lies open on its back, its spine along y."""
    wide, high, thick = of_design(0.11, 0.14, variant, 1), of_design(0.18, 0.22, variant, 2), of_design(0.006, 0.014, variant, 3)
    rise = np.radians(of_design(12.0, 24.0, variant, 4))

    def half(size: tuple[float, float, float], s: float, above: float) -> Solid:
        lying = rounded_box(size, 0.001, (2, 2, 1), corner=1).shifted(s * size[0] / 2.0, 0.0, above + size[2] / 2.0)
        return lying.turned("y", -s * rise)

    pages = [half((wide - 0.004, high - 0.006, thick), s, 0.002) for s in (-1.0, 1.0)]
    covers = [half((wide, high, 0.0025), s, 0.0) for s in (-1.0, 1.0)]
    return (Piece("pages", join(pages), "paper"), Piece("cover", join(covers), "cardboard"))


def _laptop(variant: int) -> tuple[Piece, ...]:
    """A laptop of 13 to 16 inches, open: its screen faces back, to whoever has it on the lap."""
    deep, wide = of_design(0.21, 0.25, variant, 1), of_design(0.30, 0.36, variant, 1)
    opened = np.radians(of_design(12.0, 28.0, variant, 2))  # of the screen, beyond upright
    base = standing_box((deep, wide, 0.014), 0.004)
    keys = rounded_box((0.42 * deep, 0.86 * wide, 0.003), 0.001, (1, 1, 1), corner=1).shifted(0.12 * deep, 0.0, 0.0145)
    screen = standing_box((0.006, wide, deep), 0.003).turned("y", opened).shifted(0.5 * deep - 0.006, 0.0, 0.008)
    return (Piece("base", base, "metal"), Piece("keys", keys, "hard_plastic"), Piece("screen", screen, "hard_plastic"))


def _phone(variant: int) -> tuple[Piece, ...]:
    """A telephone that lies on its back, its top to y."""
    wide, high = of_design(0.068, 0.076, variant, 1), of_design(0.142, 0.160, variant, 1)
    body = rounded_box((wide, high, 0.008), (0.010, 0.010, 0.003), (3, 5, 1), corner=2).shifted(0.0, 0.0, 0.004)
    screen = rounded_box((wide - 0.006, high - 0.006, 0.0008), 0.0003, (1, 1, 1), corner=1).shifted(0.0, 0.0, 0.0079)
    return (Piece("body", body, "metal"), Piece("screen", screen, "hard_plastic"))


def _sandwich(variant: int) -> tuple[Piece, ...]:
    """A filled roll in paper, of which the upper end stands out; it reflects as cardboard does (assumed)."""
    radius, high = of_design(0.026, 0.032, variant, 1), of_design(0.15, 0.20, variant, 2)
    roll = [(0.4 * radius, 0.3 * high), (0.94 * radius, 0.32 * high), (0.96 * radius, 0.85 * high), (0.75 * radius, 0.96 * high),
            (0.3 * radius, high)]  # fmt: skip
    wrap = [(0.5 * radius, 0.0), (0.92 * radius, 0.006), (radius, 0.03), (1.02 * radius, 0.62 * high)]
    return (Piece("roll", turned_body(roll), "cardboard", CLOTH_M), Piece("wrap", turned_body(wrap), "paper", CLOTH_M))


def _apple(variant: int) -> tuple[Piece, ...]:
    """An apple; it reflects as wood does (assumed)."""
    radius = of_design(0.034, 0.041, variant, 1)
    angles = np.radians((-80.0, -55.0, -25.0, 5.0, 35.0, 60.0, 80.0))
    outline = [(radius * float(rp.cos(a)), radius * (1.0 + 0.92 * float(rp.sin(a)))) for a in angles]
    return (Piece("flesh", turned_body(outline), "wood"),)


@dataclass(frozen=True)
class Cloth(Kind):
    """What is draped over a seat or a lap once everybody sits, and is made where it lies.

    half_m, thick_m: between which half its width and its thickness are, of its designs · material: of `scene.materials` ·
    sleeves: whether it has some, that lie folded over it.
    """

    half_m: tuple[float, float] = (0.20, 0.30)
    thick_m: tuple[float, float] = (0.006, 0.012)
    material: str = "wool"
    sleeves: bool = False


# Objects that lie on seats and laps or are held, by name.
OBJECTS: Mapping[str, Kind] = MappingProxyType(
    {
        "box": Kind("box", _box, "stands", on_lap=True),
        "bag": Kind("bag", _bag, "leans", on_lap=True),
        "backpack": Kind("backpack", _backpack, "leans", on_lap=True),
        "bottle": Kind("bottle", _bottle, "lies", held_at=("drink", "give")),
        "cup": Kind("cup", _cup, "lies", held_at=("drink",)),
        "book": Kind("book", _book, "stands", on_lap=True),
        "laptop": Kind("laptop", _laptop, "stands", on_lap=True),
        "phone": Kind("phone", _phone, "stands", held_at=("ear", "chest")),
        "open_book": Kind("book", _open_book, held_at=("book",)),  # a book that is read
        "sandwich": Kind("food", _sandwich, held_at=("bite",)),
        "apple": Kind("food", _apple, held_at=("bite",)),
        "blanket": Cloth("blanket"),
        "jacket": Cloth("jacket", half_m=(0.17, 0.22), thick_m=(0.016, 0.016), material="synthetic_fabric", sleeves=True),
    }
)
