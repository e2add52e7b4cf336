"""What lies about in cars: keys, glasses, wallets, paper, tissues, a telephone in its holder, a jacket on a hook.

Each is made as `objects` are, but for the telephone in a holder and the jacket, whose origin is where they are held. What is too
small for a class of its own has that of the part of the car it lies on. Sizes are assumed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.shapes import join, rounded_box, slab, smoothstep, tube
from cabinpose.scene.things.objects import CLOTH_M
from cabinpose.scene.things.pieces import THINGS, Kind, Piece, of_design, standing_box


class Clutter(NamedTuple):
    """A kind of what lies about: the class of its pixels, and the pieces of a design."""

    label: str
    make: Callable[[int], tuple[Piece, ...]]


def _ring(radius: float, sides: int = 12) -> Floats:
    turn = np.linspace(0.0, 2.0 * np.pi, sides)
    return np.column_stack((radius * rp.cos(turn), radius * rp.sin(turn), np.full(sides, 0.003)))


def _keys(variant: int) -> tuple[Piece, ...]:
    """A key with its remote control, and two more on a ring."""
    long = of_design(0.062, 0.078, variant, 1)
    remote = standing_box((long, 0.036, 0.014), 0.006)
    blades = [
        standing_box((0.052, 0.009, 0.002), 0.0008).shifted(0.030).turned("z", turn).shifted(0.5 * long + 0.012)
        for turn in (-0.6, 0.5)
    ]
    ring = tube(_ring(0.014), 0.0015, 5).shifted(0.5 * long + 0.012)
    return (Piece("remote", remote, "hard_plastic"), Piece("blades", join([*blades, ring]), "metal"))


def _sunglasses(variant: int) -> tuple[Piece, ...]:
    """Folded sunglasses that lie on their temples."""
    wide, high = of_design(0.132, 0.146, variant, 1), of_design(0.038, 0.050, variant, 2)
    lenses = [
        rounded_box((0.003, 0.42 * wide, high), (0.001, 0.014, 0.014), (1, 2, 2), corner=1).shifted(
            0.0, s * 0.25 * wide, high / 2
        )
        for s in (-1.0, 1.0)
    ]
    bridge = standing_box((0.004, wide, 0.005), 0.0015).shifted(0.0, 0.0, 0.72 * high)
    temples = [
        tube([(0.006 + 0.004 * n, s * 0.49 * wide, 0.6 * high), (0.014 + 0.004 * n, -s * 0.42 * wide, 0.006)], 0.0022, 5)
        for n, s in enumerate((-1.0, 1.0))
    ]
    return (Piece("lenses", join(lenses), "hard_plastic"), Piece("frame", join([bridge, *temples]), "hard_plastic"))


def _wallet(variant: int) -> tuple[Piece, ...]:
    size = (of_design(0.085, 0.10, variant, 1), of_design(0.105, 0.19, variant, 2), of_design(0.014, 0.026, variant, 3))
    return (Piece("leather", standing_box(size, 0.005), "seat_leather"),)


def _ticket(variant: int) -> tuple[Piece, ...]:
    """A parking ticket or disc."""
    return (Piece("paper", standing_box((of_design(0.08, 0.15, variant, 1), 0.10, 0.0012), 0.0004), "paper"),)


def _papers(variant: int) -> tuple[Piece, ...]:
    """Some sheets that do not lie quite even."""
    wide, high = 0.21, 0.297
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 9) * wide, np.linspace(-0.5, 0.5, 11) * high, indexing="ij")
    phase, curl = of_design(0.0, 3.0, variant, 1), of_design(0.004, 0.012, variant, 2)
    z = curl * (1.0 + rp.sin(11.0 * x + 6.0 * y + phase)) * 0.5
    sheet = slab(np.stack((x, y, z), axis=-1), np.stack((x, y, z + 0.0015), axis=-1)).outward()
    return (Piece("sheets", sheet, "paper"),)


def _tissues(variant: int) -> tuple[Piece, ...]:
    """A box of tissues, one of them half out."""
    size = (of_design(0.11, 0.13, variant, 1), of_design(0.20, 0.24, variant, 2), of_design(0.06, 0.10, variant, 3))
    x, t = np.meshgrid(np.linspace(-1.0, 1.0, 7), np.linspace(0.0, 1.0, 5), indexing="ij")
    y = 0.045 * x * (1.0 - 0.35 * t)
    bent = 0.012 * rp.sin(3.0 * x + 2.0 * t)
    z = size[2] - 0.004 + 0.055 * t
    tissue = slab(np.stack((bent, y, z), axis=-1), np.stack((bent + 0.0015, y, z), axis=-1)).outward()
    return (Piece("carton", standing_box(size, 0.003), "cardboard"), Piece("tissue", tissue, "paper"))


def _held_phone(
    variant: int, arm: list[tuple[float, float, float]], foot: tuple[float, float, float], *, turns: bool = True
) -> tuple[Piece, ...]:
    """A telephone that stands upright and looks back (-x), its middle in the origin, in claws at the end of an arm.

    turns: some designs hold it across. Claws, arm and foot are as dark as rubber, whatever the telephone is.
    """
    wide, high = of_design(0.068, 0.076, variant, 1), of_design(0.142, 0.160, variant, 1)
    if turns and variant % 3 == 1:
        wide, high = high, wide
    body = rounded_box((0.008, wide, high), (0.003, 0.009, 0.009), (1, 2, 3), corner=1)
    screen = rounded_box((0.001, wide - 0.006, high - 0.006), 0.0004, (1, 1, 1), corner=1).shifted(-0.0038)
    plate = rounded_box((0.012, min(wide, 0.05), 0.06), 0.004, (1, 1, 1), corner=1).shifted(0.009)
    claws = [
        rounded_box((0.016, 0.006, 0.030), 0.002, (1, 1, 1), corner=1).shifted(0.002, s * (0.5 * wide + 0.003)) for s in (-1, 1)
    ]
    base = rounded_box(foot, 0.006, (1, 1, 1), corner=1).shifted(*arm[-1])
    parts = [plate, *claws, tube(arm, 0.006, 6), base]
    return (Piece("body", body, "metal"), Piece("screen", screen, "hard_plastic"), Piece("holder", join(parts), "rubber"))


def _phone_at_vent(variant: int) -> tuple[Piece, ...]:
    """Upright: beside a vent there is no room for one across."""
    arm = [(0.012, 0.0, 0.0), (0.030, 0.0, -0.01), (0.044, 0.0, -0.02)]
    return _held_phone(variant, arm, (0.010, 0.030, 0.020), turns=False)


def _phone_on_dash(variant: int) -> tuple[Piece, ...]:
    """The arm ends in a foot 0.11 m below the middle of the telephone."""
    return _held_phone(variant, [(0.012, 0.0, 0.0), (0.040, 0.0, -0.05), (0.045, 0.0, -0.105)], (0.07, 0.07, 0.012))


def _phone_on_screen(variant: int) -> tuple[Piece, ...]:
    """The arm ends in a cup 0.10 m ahead of it, at the windscreen."""
    return _held_phone(variant, [(0.012, 0.0, 0.0), (0.05, 0.0, 0.012), (0.095, 0.0, 0.03)], (0.014, 0.055, 0.055))


def _pouch(variant: int) -> tuple[Piece, ...]:
    """A small bag with a zip along its top."""
    deep, wide, high = of_design(0.08, 0.12, variant, 1), of_design(0.17, 0.24, variant, 2), of_design(0.09, 0.14, variant, 3)

    def bend(p: Floats) -> Floats:
        x, y, z = p.T
        top = smoothstep(z, 0.15 * high, high)
        return np.stack((x * (1.0 - 0.75 * top), y * (1.0 - 0.10 * top), z), axis=-1)

    body = rounded_box((deep, wide, high), (0.030, 0.035, 0.020), (3, 5, 5), corner=2).shifted(0.0, 0.0, 0.5 * high)
    slide = tube([(0.0, -0.42 * wide, high), (0.0, 0.0, high + 0.001), (0.0, 0.42 * wide, high)], 0.0025, 5)
    return (Piece("body", body.deformed(bend), "seat_leather", CLOTH_M), Piece("zip", slide, "metal"))


def _hung_jacket(variant: int) -> tuple[Piece, ...]:
    """A jacket on a hanger, which hangs from the origin, its sides to x, one sleeve to the inside of the car (-y)."""
    wide, long, thick = of_design(0.36, 0.41, variant, 1), of_design(0.54, 0.62, variant, 2), of_design(0.05, 0.07, variant, 3)
    s, t = np.meshgrid(np.linspace(-1.0, 1.0, 13), np.linspace(0.0, 1.0, 13), indexing="ij")
    shoulder = 0.085 * s * s * (1.0 - smoothstep(t, 0.0, 0.5))
    x = 0.5 * wide * s * (1.0 - 0.10 * rp.sin(np.pi * t)) + 0.006 * rp.sin(9.0 * t + 4.0 * s)
    z = -0.07 - shoulder - (long - 0.07) * t
    fold = 0.007 * rp.sin(10.0 * s + 2.0 * t + of_design(0.0, 3.0, variant, 4))
    half = 0.5 * thick * np.sqrt(np.clip(1.0 - 0.92 * s * s, 0.05, 1.0)) * (0.45 + 0.55 * smoothstep(t, 0.0, 0.25))
    cloth = slab(np.stack((x, half + fold, z), axis=-1), np.stack((x, fold - half, z), axis=-1)).outward()
    sleeves = [
        tube([(e * 0.44 * wide, -0.012, -0.16), (e * 0.47 * wide, -0.022, -0.34), (e * 0.45 * wide, -0.03, 0.08 - long)],
             [0.044, 0.040, 0.034], 10)
        for e in (-1.0, 1.0)
    ]  # fmt: skip
    hook = tube([(0.0, 0.0, 0.0), (0.0, 0.004, -0.03), (0.0, 0.0, -0.08)], 0.003, 5)
    return (Piece("cloth", join([cloth, *sleeves]), "wool", 0.02), Piece("hanger", hook, "metal"))


CLUTTER: Mapping[str, Clutter] = MappingProxyType(
    {
        "keys": Clutter("console", _keys),
        "sunglasses": Clutter("dashboard", _sunglasses),
        "wallet": Clutter("console", _wallet),
        "ticket": Clutter("dashboard", _ticket),
        "papers": Clutter("book", _papers),
        "tissues": Clutter("box", _tissues),
        "phone_at_vent": Clutter("phone", _phone_at_vent),
        "phone_on_dash": Clutter("phone", _phone_on_dash),
        "phone_on_screen": Clutter("phone", _phone_on_screen),
        "pouch": Clutter("bag", _pouch),
        "hung_jacket": Clutter("jacket", _hung_jacket),
    }
)
"""What lies about and is brought by nobody, by name; bottles, cups, bags and books are as in `OBJECTS`."""


def thing_kind(name: str) -> Kind | Clutter:
    """All that is known of a kind of thing, brought or lying about. Raises ConfigError for one that does not exist."""
    return CLUTTER.get(name) or THINGS[name]
