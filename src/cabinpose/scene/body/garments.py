"""Cloth, hair and beard as layers over the skin: the seen mesh, every vertex moved outwards.

A garment is draped on the skin's own mesh at rest: stretched over hollows, hanging from chest, arms and thighs. The refined
mesh then takes its thickness, its looseness, its folds and its hems. Cloth is never
below the skin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from cabinpose._native import body
from cabinpose.core import Bools, Floats, Floats32, Ints, Ints32
from cabinpose.core import reproducible as rp
from cabinpose.scene import labels
from cabinpose.scene.body.chart import load_chart
from cabinpose.scene.body.coverage import HEM_M, borders, bump, step
from cabinpose.scene.body.folds import around, bend_fields, blend_rows, folds, front_of_thigh, seen_chart, smooth_noise
from cabinpose.scene.body.kinematics import RestArrays
from cabinpose.scene.body.outfit import COVERING_HAIR, Garment, Outfit, worn
from cabinpose.scene.body.parts import cut_skin
from cabinpose.scene.body.rig import BONE_INDEX
from cabinpose.scene.body.shape import load_shape_space

_SWEEPS, _EVENING = 50, 8  # of the membrane; of the skin, for directions that its hollows do not turn
_LEAST_GAP_M = 0.002  # of cloth off the skin
_SECTORS = 48  # of the turn about what cloth hangs from
_LEAST_FOLD_M = 0.0002  # less is not moved
_CLEAR_M = 0.002  # about how much smoothing flattens a bump of the body
_INWARDS_M = 0.006  # smoothing moves a vertex inwards by no more than this
_LIFT_M = 0.005  # of a top off the trousers' folds: its hem shows
_BEYOND_M = 0.04  # cloth is hung as if it went on so far beyond its border: its hem is even, however coarse the mesh


@dataclass(frozen=True)
class _Cut:
    """A garment: thickness, looseness and height of folds (m) at fit 1, narrowing (m/m) below what it hangs from.

    border: of `coverage.borders`.
    """

    thickness: float
    loose: float
    folds: float
    narrowing: float
    border: str


TOPS = {
    "t_shirt": _Cut(0.003, 0.017, 0.017, 0.18, "t_shirt"),
    "long_sleeve": _Cut(0.003, 0.015, 0.017, 0.20, "long_sleeve"),
    "shirt": _Cut(0.003, 0.017, 0.017, 0.16, "jacket"),
    "jumper": _Cut(0.008, 0.016, 0.018, 0.28, "jumper"),
    "turtleneck": _Cut(0.007, 0.012, 0.016, 0.28, "jacket"),
    "hoodie": _Cut(0.007, 0.020, 0.020, 0.20, "jacket"),
    "jacket": _Cut(0.012, 0.018, 0.018, 0.12, "jacket"),
    "open_jacket": _Cut(0.010, 0.020, 0.018, 0.10, "jacket"),
    "coat": _Cut(0.014, 0.020, 0.016, 0.08, "jacket"),
}
BOTTOMS = {
    "trousers": _Cut(0.003, 0.010, 0.016, 0.08, "trousers"),
    "jeans": _Cut(0.004, 0.006, 0.014, 0.13, "jeans"),
    "shorts": _Cut(0.003, 0.020, 0.016, 0.03, "shorts"),
}
HAIR_DEPTH_M = {"bald": 0.0, "short": 0.009, "medium": 0.022, "long": 0.018, "bun": 0.010}
FULL_BEND_RAD = 1.75  # of a joint: its folds grow no further
_RIDGE_M = 0.6  # height of folds inside a fully bent joint, of those at rest
GLOVE_M, _SHIRT_M = 0.0025, 0.009  # off the skin: gloves, and what shows under an open jacket
_TUCKED_M = 0.02  # of the shirt below the fronts of an open jacket
CAP_DEPTH_M, BEARD_DEPTH_M, BROW_DEPTH_M = 0.014, 0.008, 0.0015


class Bend(NamedTuple):
    """What the flexion of a joint moves: vertices (n,) by offsets (n, 3) m at rest, all of it from an angle on, rad."""

    dof: str
    rows: Ints
    offsets: Floats32
    full_rad: float = FULL_BEND_RAD


class Region(NamedTuple):
    """Faces (F,) of one garment."""

    faces: Bools
    of: Garment


@dataclass(frozen=True)
class Layer:
    """The dressed skin at rest: every seen vertex (V + N, 3) m, and the faces that things cover, inner ones first.

    bare: the same vertices without anything worn · bends: what bent joints move.
    """

    vertices: Floats32
    bare: Floats32
    regions: tuple[Region, ...]
    bends: tuple[Bend, ...] = ()


class _Neighbours(NamedTuple):
    """Rows of a mesh's vertex graph: start (V + 1,) of each one's neighbours, near."""

    start: Ints32
    near: Ints32


@cache
def _neighbours() -> _Neighbours:
    """The skin's vertex graph."""
    space = load_shape_space()
    corner, following = space.faces.astype(np.int64), np.roll(space.faces, -1, axis=1).astype(np.int64)
    both = np.stack([corner * space.vertex_count + following, following * space.vertex_count + corner])
    vertex, near = np.divmod(np.unique(both), space.vertex_count)
    return _Neighbours(np.searchsorted(vertex, np.arange(space.vertex_count + 1)).astype(np.int32), near.astype(np.int32))


@cache
def _seen_field(name: str) -> Floats:
    """A border's field at every seen vertex."""
    return np.concatenate([borders()[name], cut_skin().blend.of(borders()[name])])


@cache
def _mask(name: str, width: float = HEM_M) -> Floats:
    """(V + N,) 1 inside to the very border, falling off outside."""
    return step(_seen_field(name), -0.5 * width, width)


@cache
def _looseness(*, top: bool) -> Floats:
    """(V + N,) share of a garment's looseness: none where it hangs from, most where it hangs free."""
    c = seen_chart()
    trunk = 0.10 + 0.90 * step(-c.up, -0.70, 0.40)
    arm = 0.30 + 0.70 * step(c.along_arm, 0.45, 0.6) - 0.85 * step(c.along_arm, 1.75, 0.35)
    leg = 0.45 + 0.25 * bump(c.along_leg, 1.0, 0.3) + 0.45 * step(c.along_leg, 1.4, 0.6) - 0.25 * front_of_thigh()
    waist = 1.0 if top else 1 - 0.9 * step(c.up, 0.10, 0.25)
    return np.asarray((c.arm * arm + c.leg * leg + (1 - c.arm - c.leg).clip(0) * trunk) * waist)


def _relaxed(points: Floats32, share: Floats32, sweeps: int) -> Floats32:
    """The skin's vertices (V, 3), evened; share: (V,) of each step that is taken."""
    out = np.empty_like(points)
    body.relax(points, _neighbours(), share, sweeps, out)
    return out


def _refined(points: Floats32) -> tuple[Floats32, Floats32]:
    """The skin's vertices (V, 3), moved, on the seen mesh (V + N, 3), and normals: the new ones bulge as the surface does."""
    blend = blend_rows()
    shape = (len(points) + len(blend.start) - 1, 3)
    vertices, normals = np.empty(shape, np.float32), np.empty(shape, np.float32)
    body.refine(points, load_shape_space().faces, blend, vertices=vertices, normals=normals)
    return vertices, normals


def _stretched(under: Floats32, name: str, gap: float) -> Floats32:
    """A garment stretched over the skin's vertices (V, 3) m."""
    mask = _mask(name)[: len(under)].astype(np.float32)
    out = np.empty_like(under)
    body.stretch(under, load_shape_space().faces, _neighbours(), mask, gap=gap, evening=_EVENING, sweeps=_SWEEPS, out=out)
    return out


def _sectors() -> Floats:
    """(_SECTORS,) angle of each sector, rad from -pi."""
    return (np.arange(_SECTORS) / _SECTORS - 0.5) * 2 * np.pi


def _hanging(down: Floats, radius: Floats, angle: Floats, narrowing: Floats) -> Floats:
    """Radius (N,) m of cloth hanging about an axis, for points at `down` (N,) m along it, `radius` off it at `angle` rad.

    Going down, the radius shrinks by no more than `narrowing` (_SECTORS,) m/m from what stands out above.
    """
    out = np.empty(len(down))
    body.hang(down=down, radius=radius, angle=angle, narrowing=narrowing, out=out)
    return out


def _hung(points: Floats32, name: str, rest: RestArrays, narrowing: float, *, top: bool) -> Floats32:
    """The garment (V, 3) m, wider where it hangs from the chest, or about each limb."""
    c = load_chart()
    mask = step(_seen_field(name)[: len(points)], -_BEYOND_M, 0.5 * _BEYOND_M)
    out = points.astype(np.float64)
    limb, along, weight = (
        (("upperarm", "forearm", "hand"), c.along_arm, c.arm) if top else (("thigh", "shank", "foot"), c.along_leg, c.leg)
    )
    for side, sign in (("l", 1.0), ("r", -1.0)):
        heads = rest.heads[[BONE_INDEX[side + bone] for bone in limb]]
        inside = np.flatnonzero((mask > 0) & (weight > 0.5) & (sign * c.rest[:, 1] > 0))
        at = along[inside].clip(0, 2)
        k = np.minimum(at.astype(int), 1)
        bone = heads[k + 1] - heads[k]
        off = out[inside] - heads[k] - (at - k)[:, None] * bone
        axis = bone / np.linalg.norm(bone, axis=1)[:, None]
        off -= np.einsum("ij,ij->i", off, axis)[:, None] * axis
        radius = np.linalg.norm(off, axis=1)
        length = np.linalg.norm(heads[1:] - heads[:-1], axis=1)
        below = np.cumsum([0.0, *length])[k] + (at - k) * length[k]
        # On who sits, cloth lies on the thighs and hangs below them.
        fall = np.full(_SECTORS, 0.20) if top else narrowing + 0.12 * (1 + rp.cos(_sectors()))
        target = _hanging(below, radius, around(off, heads[2] - heads[0]), fall)
        share = mask[inside] * step(weight[inside], 0.75, 0.5) * step(at, 0.25, 0.5)
        out[inside] += off * (share * np.maximum(target / radius - 1, 0))[:, None]
    if top:
        inside = np.flatnonzero((mask > 0) & (c.arm < 0.3) & (c.neck < 0.3))
        off = out[inside, :2] - (np.median(out[inside, 0]), 0.0)
        radius = rp.hypot(*off.T)
        fall = narrowing * (1.6 - 0.6 * rp.cos(_sectors()))  # most before the chest, less down the back
        target = _hanging(-out[inside, 2], radius, rp.arctan2(off[:, 1], off[:, 0]), fall)
        # Also inwards: the table is even, however fine the mesh is where the skin has a small feature.
        share = mask[inside] * step(-c.up[inside], -0.86, 0.16) * step(-c.arm[inside], -0.10, 0.2)
        out[inside, :2] += off * (share * np.maximum(target + _CLEAR_M - radius, -_INWARDS_M) / radius)[:, None]
    return out.astype(np.float32)


def layer(skin: Floats32, rest: RestArrays, outfit: Outfit, size: float) -> Layer:
    """The skin (V, 3) at rest, dressed. size: stature over that of the average adult."""
    cut = cut_skin()
    bare, _ = _refined(skin)
    regions: list[Region] = []
    wears = worn(outfit)
    if outfit.shoes != "none":
        regions.append(Region(cut.inside["socks"], wears["socks"]))
    if outfit.headwear in COVERING_HAIR:
        outfit = replace(outfit, hair="bald" if outfit.hair == "bald" else "short")
    evened = np.max(
        [_mask("scalp")[: len(skin)] * (outfit.hair != "bald"), _mask("cap")[: len(skin)] * (outfit.headwear == "cap")], axis=0
    )
    folded = np.zeros((2, len(bare)))  # height that folds may gain, and what they stand off their mean
    draped, depth = _relaxed(skin, np.float32(0.6) * evened.astype(np.float32), _EVENING), np.zeros(len(bare))
    head, (moved, normals) = draped, _refined(draped)
    if outfit.gloves:
        depth = GLOVE_M * seen_chart().arm * step(seen_chart().along_arm, 1.88, 0.04)
        hand = [labels.LABEL_ID[f"{part}_{side}"] for part in ("wrist", "hand") for side in ("left", "right")]
        regions.append(Region(np.isin(cut.label, hand), wears["gloves"]))
    for place, name, cuts in (("bottom", outfit.bottom, BOTTOMS), ("top", outfit.top, TOPS)):
        if name not in cuts:
            continue
        cloth, top, border = cuts[name], cuts is TOPS, cuts[name].border
        mask = _mask(border)
        slack = 0.25 + 0.75 * outfit.fit
        if top and outfit.bottom in BOTTOMS:  # the waistband does not show through
            hidden = np.where(mask > 0, step(_seen_field(outfit.bottom), 0.06, 0.08), 1.0)
            draped = skin + (draped - skin) * hidden[: len(skin), None].astype(np.float32)
            depth *= hidden
        hung = _hung(
            _stretched(draped, border, cloth.thickness), border, rest, cloth.narrowing * (1.4 - 0.8 * outfit.fit), top=top
        )
        where = np.flatnonzero(mask > 0)
        height = np.zeros(len(bare))
        height[where] = (
            cloth.folds * (0.5 + 0.5 * outfit.fit) * folds(where, borders()[border] > -0.05, outfit.folds, top=top, size=size)
        )
        folded = np.where(mask > 0.5, [np.full(len(bare), _RIDGE_M * cloth.folds), height - height[where].mean()], folded)
        own = cloth.loose * slack * _looseness(top=top) + height
        below = np.where(depth > 0, depth + _LIFT_M * step(depth, 0.003, 0.006), 0)
        outer = mask * np.maximum(own + cloth.thickness, below)
        regions.append(Region(cut.inside[border], wears[place]))
        if name == "open_jacket":  # between its fronts shows what is worn under it
            gap = opening() + _TUCKED_M * step(-seen_chart().up, -0.78, 0.1)  # its border lies under the fronts
            outer += step(gap, -0.01, 0.02) * (np.minimum(outer, _SHIRT_M) - outer)
            shirt = cut.inside[border] & (gap[cut.faces].mean(axis=1) > 0.0)
            regions.append(Region(shirt, wears["inner"]))
        depth = np.maximum(depth, outer)
        share = mask.astype(np.float32)[:, None]
        draped = draped + share[: len(skin)] * (hung - draped)
        there, facing = _refined(hung)
        moved += share * (there - moved)
        normals += share * (facing - normals)
    bends = _bends(folded, normals)
    depth += _hair(outfit, regions)
    moved += normals * (depth.astype(np.float32) / np.maximum(np.linalg.norm(normals, axis=1), 1e-6))[:, None]
    if outfit.hair in ("medium", "long"):  # ears vanish under the hair
        flat, normals = _refined(_relaxed(head, (borders()["ears"] > -0.003).astype(np.float32), 5 * _EVENING))
        covered = _seen_field("ears") > -0.003
        moved[covered] = flat[covered] + normals[covered] * np.float32(0.4 * HAIR_DEPTH_M[outfit.hair])
        lifted = ~covered
    else:
        lifted = np.ones(len(bare), bool)
    # Never below the skin, seen along directions that no navel or nipple turns.
    clothed = np.zeros(len(skin))
    for name in (outfit.bottom, outfit.top):
        if cut_of := {**BOTTOMS, **TOPS}.get(name):
            clothed = np.maximum(clothed, _mask(cut_of.border)[: len(skin)])
    _, outwards = _refined(_relaxed(skin, np.float32(0.7) * clothed.astype(np.float32), _EVENING))
    least = np.minimum(0.5 * depth, _LEAST_GAP_M).astype(np.float32)
    lack = np.where(lifted, least - np.einsum("ij,ij->i", moved - bare, outwards), 0)
    moved += outwards * np.maximum(lack, 0.0)[:, None]
    return Layer(moved.astype(np.float32), bare, tuple(regions), bends)


def _bends(folded: Floats, normals: Floats32) -> tuple[Bend, ...]:
    """Of cloth: folded (2, V + N) m, height of new folds, and of those at rest over their mean · normals (V + N, 3)."""
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-6)[:, None]
    made = []
    for dof, fields in bend_fields().items():
        move = fields.ridges * folded[0] - fields.taut * folded[1]
        rows = np.flatnonzero(np.abs(move) > _LEAST_FOLD_M)
        made.append(Bend(dof, rows, (unit[rows] * move[rows, None]).astype(np.float32)))
    return tuple(made)


def half_opening(up: Floats) -> Floats:
    """From the middle to the edge of an open jacket's front, m on the average adult; up: of the chart."""
    return np.asarray(np.interp(up, (0.0, 0.5, 0.85, 1.05), (0.085, 0.062, 0.050, 0.034)))


@cache
def opening() -> Floats:
    """(V + N,) m from the edges of an open jacket's fronts, positive between them."""
    c = seen_chart()
    return np.asarray(np.where((c.rest[:, 0] > 0.0) & (c.arm < 0.3), half_opening(c.up) - np.abs(c.rest[:, 1]), -0.1))


def _hair(outfit: Outfit, regions: list[Region]) -> Floats:
    """Depth (V + N,) m of hair, beard and cap; their regions are appended."""
    inside, wears = cut_skin().inside, worn(outfit)
    depth = np.zeros(len(_seen_field("scalp")))
    if outfit.hair != "bald":
        name = "scalp_and_ears" if outfit.hair in ("medium", "long") else "scalp"
        rng = np.random.Generator(np.random.Philox(key=2 * outfit.folds + 977))
        strands = smooth_noise(np.array([0.06]), borders()[name] > -0.02, 1.0, rng=rng)[:, 0]
        depth = HAIR_DEPTH_M[outfit.hair] * step(_seen_field(name), 0.010, 0.020) * (0.9 + 0.2 * strands)
        regions.append(Region(inside[name], wears["hair"]))
    depth = np.maximum(depth, BROW_DEPTH_M * step(_seen_field("brows"), 0.001, 0.003))
    regions.append(Region(inside["brows"], wears["brows"]))
    if outfit.beard:
        depth = np.maximum(depth, BEARD_DEPTH_M * step(_seen_field("beard"), 0.004, 0.016))
        regions.append(Region(inside["beard"], wears["beard"]))
    if outfit.headwear == "cap":
        field, rim = _seen_field("cap"), CAP_DEPTH_M * _mask("cap")
        flat = depth * step(-field, 0.01, 0.02)  # hair lies flat under a cap and next to its rim
        depth = np.where(field > 0, CAP_DEPTH_M + 0.25 * depth, np.maximum(rim, flat))
        regions.append(Region(inside["cap"], wears["headwear"]))
    return depth
