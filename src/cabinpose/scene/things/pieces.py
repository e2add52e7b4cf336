"""What things are made of: closed solids with a material, and the shells, lids and turned bodies they have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cabinpose.core import Floats, Registry
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.shapes import Solid, loft, rounded_box, slab, smooth_curve
from cabinpose.scene.labels import THING_LABELS

# Half of a shell's section, from its middle to the rim of its wall: across and up as shares of its half width and wall.
_SECTION = np.array(((0.0, 0.0), (0.32, 0.01), (0.60, 0.04), (0.80, 0.14), (0.92, 0.36), (0.98, 0.68), (1.0, 1.0)))


class Piece(NamedTuple):
    """One closed solid of a thing; give_m: how deep it may be pressed in (0: hard)."""

    name: str
    solid: Solid
    material: str
    give_m: float = 0.0


@dataclass(frozen=True)
class Kind:
    """A kind of thing, and all that is known of it.

    Parameters
    ----------
    label
        The class of its pixels, one of those of things that there are: ids are a standard of datasets.
    make
        The pieces of a design (0, 1, ...), in the frame of `Thing`; None for `Cloth`.
    on_seat
        How it is put on a seat: on its underside, on its side, or against the backrest; None for what is not.
    on_lap
        Whether it lies across two thighs.
    held_at
        Names of the places at which hands hold it, of `cabinpose.synth.posture.PLACES`.

    Raises
    ------
    ValueError
        For a class that does not exist.
    """

    label: str
    make: Callable[[int], tuple[Piece, ...]] | None = None
    on_seat: Literal["stands", "lies", "leans"] | None = None
    on_lap: bool = False
    held_at: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = [label.name for label in THING_LABELS]
        if self.label not in known:
            raise ValueError(f"no class of things is called '{self.label}': {', '.join(known)}")


# Those of other packages are brought where they are asked for by name.
THINGS: Registry[Kind] = Registry("cabinpose.things", "thing", Kind)


def shell(
    profile: Sequence[tuple[float, float]],
    half_width: ArrayLike,
    wall: ArrayLike,
    layer: tuple[float, float],
    *,
    stations: int = 15,
) -> Solid:
    """A layer of a tub: a curve through `profile` (x, z) m, seen from the side, with walls that rise on both sides of it.

    half_width, wall: of what is inside the tub, m, one value or one for each point of the profile; walls rise to the left of
    the way along it · layer: from where to where outwards, m.
    """
    points = np.asarray(profile, dtype=np.float64)
    rows = [np.broadcast_to(np.asarray(v, dtype=np.float64), len(points)) for v in (half_width, wall)]
    curve = smooth_curve(np.column_stack((points, *rows)), stations)
    path, half, high = curve[:, :2], curve[:, 2], np.maximum(curve[:, 3], 0.004)
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.column_stack((-tangent[:, 1], tangent[:, 0]))  # to the left of the way along the profile
    section = np.concatenate((_SECTION[:0:-1] * (-1.0, 1.0), _SECTION))

    def grid(outside: float) -> Floats:
        across = section[:, 0] * (half[:, None] + outside)
        up = section[:, 1] * (high[:, None] + outside) - outside
        return np.stack((path[:, :1] + up * normal[:, :1], across, path[:, 1:] + up * normal[:, 1:]), axis=-1)

    return slab(grid(layer[0]), grid(layer[1])).outward()


def turned_body(outline: Sequence[tuple[float, float]], sides: int = 20) -> Solid:
    """A body turned about z, of (radius, height) m from its bottom to its top."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    rings = [np.column_stack((r * rp.cos(angle), r * rp.sin(angle), np.full(sides, z))) for r, z in outline]
    return loft(np.stack(rings))


def standing_box(size: Sequence[float], radius: float = 0.004) -> Solid:
    """A box of full `size` (m) on z = 0, its edges rounded."""
    return rounded_box(size, radius, (2, 2, 2), corner=1).shifted(0.0, 0.0, size[2] / 2.0)


def of_design(low: float, high: float, variant: int, step: int) -> float:
    """A measure of a design between `low` and `high`: an even spread over the designs, another one for each `step`."""
    return low + (high - low) * ((0.38 + 0.618034 * (variant * step + step)) % 1.0)
