"""Bodies of asked stature, mass and dimensions: a shape of that mass, its segments made longer or broader, joints and all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache, lru_cache
from importlib.resources import files
from typing import NamedTuple, TypeAlias, get_args

import numpy as np

from cabinpose._native import body as native
from cabinpose.core import Floats, Floats32, Ints, Ints32
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.anatomy import CENTRE
from cabinpose.scene.body.asymmetry import asymmetric
from cabinpose.scene.body.faces import with_face
from cabinpose.scene.body.measures import MeasuredRows, measure, measured_rows
from cabinpose.scene.body.phenotype import Phenotype, usual_stature_m
from cabinpose.scene.body.populations import Anthropometry
from cabinpose.scene.body.proportions import DIMENSIONS, Sex, proportions
from cabinpose.scene.body.rig import BONE_INDEX, BONES, MAIN_BONES, N_MAIN, PARENT, SIDES
from cabinpose.scene.body.shape import ShapeSpace, load_shape_space
from cabinpose.scene.body.skeleton import HEAD_OF, rest_arrays

BODY_DENSITY = 985.0  # kg/m3, whole body at mid breath (Durnin & Womersley 1974 give 1.02 to 1.07 without lung air)

VOLUMES = "volumes.npy"  # beside the body's assets

# What can be made larger, and by which shares of its logarithm each bone is: of limbs (along, across), of the trunk, neck, head,
# hands and feet (depth x, breadth y, height z). Sides are alike.
_TRUNK = ("pelvis", "spine04", "spine03", "spine02", "spine01")
_HANDLES: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "trunk": dict.fromkeys(_TRUNK, (0.0, 0.0, 1.0)),
    "thigh": {"thigh": (1.0, 0.0)},
    "shank": {"shank": (1.0, 0.0)},
    "shoulders": {"clavicle": (0.0, 1.0, 0.0), "spine01": (0.0, 0.6, 0.0), "spine02": (0.0, 0.4, 0.0)},
    "deltoids": {"clavicle": (0.0, 1.0, 0.0), "upperarm": (0.0, 1.0), "spine01": (0.0, 0.2, 0.0), "spine02": (0.0, 0.3, 0.0)},
    "hips": {"pelvis": (0.0, 1.0, 0.0), "thigh": (0.0, 0.6), "spine04": (0.0, 0.6, 0.0)},
    "buttocks": {"pelvis": (1.0, 0.0, 0.0), "thigh": (0.0, 0.6)},
    "upper arm": {"upperarm": (1.0, 0.0)},
    "forearm": {"forearm": (1.0, 0.0)},
    "hand": {"hand": (1.0, 1.0)},
    "foot": {"foot": (1.0, 0.5, 0.5)},
    "head's length": {"head": (1.0, 0.0, 0.5)},
    "head's breadth": {"head": (0.0, 1.0, 0.5)},
    # Fat where the shapes have no more of it: least on hands, feet and head, which keep their size.
    "girth": {
        **dict.fromkeys(("spine04", "spine03", "spine02"), (1.0, 0.9, 0.0)), "pelvis": (0.9, 0.5, 0.0),
        "spine01": (0.8, 0.5, 0.0), "thigh": (0.0, 0.8), "shank": (0.0, 0.5), "upperarm": (0.0, 0.7), "forearm": (0.0, 0.5),
        "neck01": (0.5, 0.5, 0.0), "neck02": (0.4, 0.4, 0.0), "neck03": (0.3, 0.3, 0.0), "clavicle": (0.4, 0.0, 0.0),
    },
}  # fmt: skip
_GIRTH = len(_HANDLES) - 1
# Where Newton's method begins: what most bodies need, whatever their size.
_USUAL = {
    "trunk": -0.05,
    "thigh": 0.11,
    "shank": -0.08,
    "deltoids": 0.1,
    "upper arm": 0.1,
    "forearm": 0.07,
    "head's breadth": 0.09,
}
# How much of a handle moves joints too, where not all of it does: the rest is flesh.
_OF_BONE = {"deltoids": 0.0, "hips": 0.2, "buttocks": 0.0, "girth": 0.0}
# Whose change a helper's skin takes on, in equal shares; of the data's bone heads, whose bone they lie on.
_HELPED = {
    "shoulder_half": ("clavicle", "upperarm"), "elbow_half": ("upperarm", "forearm"), "wrist_half": ("forearm", "hand"),
    "hip_half": ("pelvis", "thigh"), "knee_half": ("thigh", "shank"), "ankle_half": ("shank", "foot"),
    "scapula": ("clavicle",), "upperarm_twist": ("upperarm",), "forearm_near": ("forearm",), "forearm_far": ("forearm",),
    "thigh_twist": ("thigh",), "finger": ("hand",),
}  # fmt: skip
_CARRIER = {
    "shoulder": "clavicle", "lowerarm": "forearm", "wrist": "hand", "metacarpal": "hand", "finger": "hand",
    "upperleg": "thigh", "lowerleg": "shank", "toe": "foot", "eye": "head",
}  # fmt: skip
_NEXT = {"upperarm": "forearm", "forearm": "hand", "thigh": "shank", "shank": "foot"}
# Least squares of the errors' logarithms, where stature counts most, and of the handles'. The depth of the buttocks is held back:
# it would take up all by which the lengths of a leg's parts contradict each other.
_WEIGHT_OF_STATURE, _RIDGE, _RIDGE_OF_BUTTOCKS = 30.0, 2e-5, 1e-3
_STEPS = (2, 1, 1)  # for each weight that is tried
_ERROR_OF_GIRTH = 0.04  # of the mass, below which girth mends it, without another shape
_GIRTH_STEPS, _GIRTH_PER_ERROR, _MASS_ERROR = 5, 1.4, 0.005
_OFF_BEFORE = 0.04  # largest error of a measure before the last of Newton's steps, which leaves a fraction of it
_MOST = 0.6  # logarithm of the largest factor
# Genders, ages, muscles and weights at which volumes are tabulated. Much fat shows on little muscle alone.
_BUILDS = ((0.0, 1.0), (-1.0, -0.9, -0.7, -0.35, 0.0, 0.5, 1.0), (0.0, 0.5, 1.0), (0.0, 0.5, 0.75, 1.0))
_LEAST_MUSCLE, _FULL_WEIGHT = 0.1, 0.85  # muscle becomes less where the weight were above this


Shape: TypeAlias = tuple[Floats32, Floats]  # skin (V, 3) and bone heads (H, 3) at rest, m


def shape_of(phenotype: Phenotype) -> Shape:
    """The shape of a phenotype. One with a `size` gets the weight and the scaled segments with which it measures that.

    What no body can have is come near to: a segment changes by a factor of 1.82 at most.
    """
    if phenotype.size is None:
        return _shaped(phenotype)
    body, handles = _fit(phenotype)
    return scaled(load_shape_space(), _shaped(body), np.array(handles))


@lru_cache(maxsize=8192)
def _fit(phenotype: Phenotype) -> tuple[Phenotype, tuple[float, ...]]:
    """The phenotype with the muscle and weight found, and the handles' logarithms."""
    size = _size(phenotype)
    space, target = load_shape_space(), np.array([size.stature_m, *size.dimensions_m])
    muscle, weight = _build(phenotype, size.mass_kg / BODY_DENSITY / rp.power(size.stature_m, 3))
    handles = np.array([_USUAL.get(name, 0.0) for name in _HANDLES])
    for steps in _STEPS:
        body = replace(phenotype, muscle=muscle, weight=weight)
        shape = _shaped(body)
        off = _newton(space, shape, target, handles, steps)
        error = _mass_error(space, shape, handles, size)
        weight = min(max(body.weight + error / _slope(body), 0.0), 1.0)
        if abs(error) < _ERROR_OF_GIRTH or weight == body.weight:
            break
    for _ in range(_GIRTH_STEPS):  # what is left is girth
        if abs(error) < _MASS_ERROR and off < _OFF_BEFORE:
            break
        handles[_GIRTH] = min(max(handles[_GIRTH] + _GIRTH_PER_ERROR * error, -_MOST), _MOST)
        off = _newton(space, shape, target, handles, 1)
        error = _mass_error(space, shape, handles, size)
    return body, tuple(handles.tolist())


def _size(phenotype: Phenotype) -> Anthropometry:
    assert phenotype.size is not None
    return phenotype.size


def volume(skin: Floats32, faces: Ints32) -> float:
    """Volume (m3) inside a closed skin (V, 3), by the divergence theorem."""
    x, y, z = (np.ascontiguousarray(skin[:, k], np.float64)[faces.T] for k in range(3))
    six = sum(rp.matmul(a[0], b[1] * c[2] - c[1] * b[2]) for a, b, c in ((x, y, z), (y, z, x), (z, x, y)))
    return float(six) / 6.0


def _mass_error(space: ShapeSpace, shape: Shape, handles: Floats, asked: Anthropometry) -> float:
    """Logarithm of the mass asked over that of a shape so scaled."""
    return float(rp.log(asked.mass_kg / (volume(scaled(space, shape, handles)[0], space.faces) * BODY_DENSITY)))


def _shaped(phenotype: Phenotype) -> Shape:
    """The shape before it is scaled by segments."""
    space = load_shape_space()
    skin, heads = space.shape(phenotype)
    if phenotype.asymmetry:
        skin, heads = asymmetric(skin, heads, space.heads, phenotype.asymmetry)
    if phenotype.face:
        skin = with_face(skin, heads, space.heads, phenotype.face)
    if phenotype.stature_m is None:
        return skin, heads
    scale = phenotype.stature_m / float(np.ptp(skin[:, 2]))
    return skin * np.float32(scale), heads * scale


def _newton(space: ShapeSpace, shape: Shape, target: Floats, handles: Floats, steps: int) -> float:
    """Change `handles` by Newton's steps towards the measures asked; the largest error before the last, as a logarithm."""
    jacobian, gain = _gain()
    error = np.zeros(0)
    for _ in range(steps):
        error = rp.log(target / _measured(space, shape, handles))
        handles[:_GIRTH] = np.clip(rp.matmul(gain, error + rp.matmul(jacobian, handles[:_GIRTH])), -_MOST, _MOST)
    return float(abs(error).max())


def _measured(space: ShapeSpace, shape: Shape, handles: Floats) -> Floats:
    """Stature and dimensions (m) of a shape so scaled."""
    rows = measured_rows()
    skin, heads = scaled(space, shape, handles, rows)
    rest, origin = rest_arrays(skin[rows.region["soles"]].astype(np.float64), heads, space.heads)
    return measure((skin - origin).astype(np.float32), rest)


@cache
def _gain() -> tuple[Floats, Floats]:
    """How logarithms of measures change with handles (M, N), on the average adult, and what inverts it (N, M)."""
    space, step = load_shape_space(), 0.02
    shape = _shaped(Phenotype(weight=0.7, muscle=0.3, stature_m=1.7))
    still = _measured(space, shape, np.zeros(len(_HANDLES)))
    moved = [_measured(space, shape, step * row) for row in np.eye(len(_HANDLES))[:_GIRTH]]
    jacobian = np.stack([rp.log(one / still) / step for one in moved], axis=1)
    weighted = jacobian.T * np.array([_WEIGHT_OF_STATURE, *np.ones(len(still) - 1)])
    ridge = [_RIDGE_OF_BUTTOCKS if name == "buttocks" else _RIDGE for name in list(_HANDLES)[:_GIRTH]]
    return jacobian, rp.solve(rp.matmul(weighted, jacobian) + np.diag(ridge), weighted)


class _Frame(NamedTuple):
    """Which main bone's change each bone's skin (B, 2) and each bone head (H,) takes on, and the factors' logarithms by handle.

    share: (23, 3, handles) of depth, breadth and height, of limbs across (twice) and along.
    """

    carriers: Ints
    heads: Ints
    share: Floats


@cache
def _frame(names: tuple[str, ...]) -> _Frame:
    """Of the data's bone heads by their names."""

    def index(side: str, bone: str) -> int:
        return BONE_INDEX[bone if bone in BONE_INDEX else side + bone]

    carriers = []
    for name in BONES:
        side, stem = _parted(name)
        both = _HELPED.get(stem.rstrip("_0123456789") if stem.startswith("finger") else stem, (stem,))
        carriers.append((index(side, both[0]), index(side, both[-1])))
    heads = []
    for name in names:
        side, stem = _parted(name.removesuffix(CENTRE))
        stem = "pelvis" if stem in ("root", "spine05") else stem if not side else stem.rstrip("_0123456789")
        heads.append(index(side, _CARRIER.get(stem, stem)))
    share = np.zeros((N_MAIN, 3, len(_HANDLES)))
    for k, bones in enumerate(_HANDLES.values()):
        for bone, factors in bones.items():
            of_axes = factors if len(factors) == 3 else (factors[1], factors[1], factors[0])
            for side in ("",) if bone in BONE_INDEX else SIDES:
                share[index(side, bone), :, k] = of_axes
    return _Frame(np.array(carriers), np.array(heads), share)


def _parted(name: str) -> tuple[str, str]:
    """Side and stem of the name of a bone or bone head."""
    if name in ("root", "pelvis", "head") or name.startswith(("spine", "neck")):
        return "", name
    return name[0], name[1:]


def scaled(space: ShapeSpace, shape: Shape, handles: Floats, rows: MeasuredRows | None = None) -> Shape:
    """Skin (V, 3) and bone heads (H, 3), m, with segments made larger by `handles` (14,), blended as in skinning.

    rows: of the skin those alone.
    """
    skin, heads = shape
    index, weight = space.bone_index, space.bone_weight
    if rows is not None:
        skin, index, weight = skin[rows.vertex], rows.bone_index, rows.bone_weight
    frame = _frame(tuple(space.heads))
    of_bone = np.array([_OF_BONE.get(name, 1.0) for name in _HANDLES])
    factors, apart = (rp.exp(rp.matmul(frame.share, h)) for h in (handles, handles * of_bone))
    at = {name: heads[i] for name, i in space.heads.items()}
    linear, own, moved = np.empty((N_MAIN, 3, 3)), np.empty((N_MAIN, 3)), np.empty((N_MAIN, 3))
    for b, name in enumerate(MAIN_BONES):
        side, stem = _parted(name)
        own[b] = moved[b] = at["root" if stem == "pelvis" else side + HEAD_OF.get(stem, stem)]
        linear[b] = np.diag(factors[b])
        if stem in _NEXT:
            axis = at[side + HEAD_OF[_NEXT[stem]]] - own[b]
            axis = axis / rp.norm(axis)
            linear[b] = np.eye(3) * factors[b, 0] + (factors[b, 2] - factors[b, 0]) * axis[:, None] * axis
        if name in PARENT:
            parent = BONE_INDEX[PARENT[name]]
            carries = linear[parent] if _parted(PARENT[name])[1] in _NEXT else np.diag(apart[parent])
            moved[b] = moved[parent] + rp.matmul(carries, own[b] - own[parent])
    affine = np.concatenate([linear, (moved - (linear * own[:, None]).sum(axis=2))[:, :, None]], axis=2)
    out = np.empty_like(skin)[None]
    native.skin_layers((affine[frame.carriers[:, 0]] + affine[frame.carriers[:, 1]]) / 2, index, weight, skin[None], out)
    of_heads = affine[frame.heads]
    return out[0], (of_heads[:, :, :3] * heads[:, None]).sum(axis=2) + of_heads[:, :, 3]


@cache
def _volumes() -> Floats:
    """Logarithm of volume over stature cubed of fitted bodies at the points of `_BUILDS`, as `tabulate_volumes` wrote it."""
    with (files("cabinpose.scene.body") / "assets" / VOLUMES).open("rb") as stream:
        return np.asarray(np.load(stream), np.float64)


def tabulate_volumes(only: tuple[int, ...] = ()) -> Floats:
    """Those logarithms, worked out anew: what `VOLUMES` holds, or at `only` of it. Dimensions are those usual for the mass."""
    space = load_shape_space()
    table = np.empty(tuple(map(len, _BUILDS)))
    for at in np.ndindex(table.shape):
        if at[: len(only)] != only:
            continue
        gender, age, muscle, weight = (values[i] for values, i in zip(_BUILDS, at, strict=True))
        stature, sex = usual_stature_m(gender, age)[0], get_args(Sex)[int(gender)]
        body = Phenotype(gender, age, muscle, weight, 0.45, 0.3, stature)
        shape, handles = _shaped(body), np.zeros(len(_HANDLES))
        for _ in range(4):  # the dimensions of this mass, which changes a little with them
            mass = volume(scaled(space, shape, handles)[0], space.faces) * BODY_DENSITY
            usual = proportions().dimensions_m(sex, body.years, (stature, mass), np.zeros(len(DIMENSIONS)))
            _newton(space, shape, np.array([stature, *usual]), handles, 2)
        table[at] = mass / BODY_DENSITY / rp.power(stature, 3)
    return np.asarray(rp.log(table[only]))


def _log_volumes(phenotype: Phenotype, muscle: float) -> Floats:
    """Of a phenotype with other muscle, at each of the table's weights."""
    table = _volumes()
    for value, values in zip((phenotype.gender, phenotype.age, muscle), _BUILDS[:3], strict=True):
        after = min(max(int(np.searchsorted(values, value)), 1), len(values) - 1)
        share = (value - values[after - 1]) / (values[after] - values[after - 1])
        table = (1.0 - share) * table[after - 1] + share * table[after]
    return table


def _build(phenotype: Phenotype, volume_of_stature: float) -> tuple[float, float]:
    """Muscle, at most the phenotype's, and weight with which a body has a volume over its stature cubed, or comes near to it."""
    wanted, weights = float(rp.log(volume_of_stature)), np.array(_BUILDS[3])
    for muscle in np.linspace(phenotype.muscle, min(phenotype.muscle, _LEAST_MUSCLE), 6).tolist():
        volumes = _log_volumes(phenotype, muscle)
        if wanted <= np.interp(_FULL_WEIGHT, weights, volumes):
            break
    return muscle, float(np.interp(wanted, volumes, weights))


def _slope(phenotype: Phenotype) -> float:
    """How the logarithm of the volume changes with weight."""
    volumes, weights = _log_volumes(phenotype, phenotype.muscle), np.array(_BUILDS[3])
    k = min(int(np.searchsorted(weights, phenotype.weight, side="right")), len(weights) - 1)
    return float((volumes[k] - volumes[k - 1]) / (weights[k] - weights[k - 1]))
