"""Joint centres where anatomy has them: by how much they lie off the bone heads of the body data, which were made to be animated.

Shares of the stature, forward, outward and up, of four bodies: a man, a woman, a child of ten and one of three; people between
them have shares between theirs. They were worked out on the mean body of each from published values, and are held against others
in `tests/body/test_anatomy.py`; `docs/joints.md` has both, joint by joint.

hip: between 3.2 mm above the trochanterion (ANSUR II, Snyder 1977; de Leva 1996) and 0.530 of the stature (Drillis and Contini);
forward between the data's and Harrington 2007 behind the skin over the ASIS, with 9.7 mm of skin (Mantovani 2016) and a pelvis
tilted by 10 deg (assumed), held against buttock-knee length; apart as femur heads are in CT (160 mm, Skeletal Radiology 2010), of
children a tenth of the stature (Hara 2016). knee: so that knee height and buttock-knee length, sitting, split into thigh and
shank as published. ankle: height of the lateral malleolus (ANSUR II) and 4 mm. shoulder: 0.88 of the biacromial breadth apart,
midway between what is published. spine: C7/T1 and T12/L1 by Reed 1999 off the skin over C7 and T12, levels between them in
proportion of the column's parts; L5/S1 by Dumas 2007 off the hips. head: the occipital condyles, behind and below the tragion
(Reed 1999; assumed).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from cabinpose.core import Floats

_Share: TypeAlias = tuple[float, float, float]
# By bone head of the data: man, woman, ten, three. `root` is our hip, L5/S1.
_SHARES: Mapping[str, tuple[_Share, _Share, _Share, _Share]] = MappingProxyType(
    {
        "upperleg01": ((0.0200, 0.0, -0.0105), (0.0125, 0.0, -0.0010), (0.0, 0.0, -0.0015), (0.0, 0.0, -0.0396)),
        "lowerleg01": ((0.0, 0.0, -0.0010), (0.0, 0.0, 0.0050), (0.0, 0.0, -0.0060), (0.0, 0.0, 0.0)),
        "foot": ((0.0, 0.0, 0.0), (0.0, 0.0, -0.0055), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        "upperarm01": ((0.0, -0.0084, 0.0), (0.0, 0.0010, 0.0040), (0.0, -0.0043, 0.0), (0.0, 0.0040, 0.0)),
        "spine04": ((0.0165, 0.0, 0.0), (0.0140, 0.0, 0.0), (0.0135, 0.0, 0.0), (0.0140, 0.0, 0.0)),
        "spine03": ((0.0130, 0.0, 0.0), (0.0168, 0.0, 0.0), (0.0175, 0.0, 0.0), (0.0110, 0.0, 0.0)),
        "spine02": ((0.0140, 0.0, -0.0009), (0.0127, 0.0, 0.0093), (0.0110, 0.0, 0.0), (0.0047, 0.0, 0.0)),
        "spine01": ((0.0226, 0.0, -0.0048), (0.0, 0.0, -0.0107), (0.0220, 0.0, 0.0), (0.0090, 0.0, 0.0)),
        "neck01": ((0.0153, 0.0, -0.0152), (0.0181, 0.0, -0.0031), (0.0160, 0.0, -0.0060), (0.0160, 0.0, -0.0060)),
        "neck02": ((0.0080, 0.0, -0.0100), (0.0090, 0.0, -0.0025), (0.0080, 0.0, -0.0040), (0.0080, 0.0, -0.0040)),
        "neck03": ((0.0, 0.0, -0.0050), (0.0, 0.0, -0.0020), (0.0, 0.0, -0.0020), (0.0, 0.0, -0.0020)),
        "head": ((-0.0080, 0.0, 0.0), (-0.0105, 0.0, -0.0015), (-0.0080, 0.0, 0.0), (-0.0080, 0.0, 0.0)),
        "root": ((-0.0174, 0.0, 0.0239), (-0.0244, 0.0, 0.0480), (-0.0250, 0.0, 0.0330), (-0.0260, 0.0, 0.0060)),
        "toe3_1": ((-0.0059, 0.0, 0.0), (-0.0045, 0.0, 0.0), (-0.0065, 0.0, 0.0), (-0.0096, 0.0, 0.0)),
    }
)  # fmt: skip
_CHILD_AGES = (-0.7, 0.0, 0.5)  # `Phenotype.age` of three, ten and of adults
# Metres between the femur heads: of adults 160 at 1.70 m and hardly more with stature; of children, in proportion to it.
_APART_M = ((0.1, 0.0), (0.04, 0.092))  # (per metre of stature, and m), the lesser of the two
CENTRE = "_centre"  # ends the name of a joint centre, after that of the bone head that it lies off
KNUCKLE = 0.82  # of the way from the wrist to the finger's base, where the third knuckle is: 0.459 of the hand (de Leva 1996)


def hips_apart_m(stature_m: float) -> float:
    """Metres between the centres of the femur heads."""
    return min(slope * stature_m + start for slope, start in _APART_M)


def centre_names(named: Mapping[str, int]) -> dict[str, int]:
    """The names of `joint_centres`, which follow the bone heads that are named."""
    names = [name for name in sorted(named, key=named.__getitem__) if _stem(name) in _SHARES]
    return {name + CENTRE: len(named) + i for i, name in enumerate(names)}


def _stem(name: str) -> str:
    """The name without its side."""
    return name[1:] if name[0] in "lr" and name[1:] in _SHARES else name


def joint_centres(heads: Floats, named: Mapping[str, int], build: tuple[float, float], size: tuple[float, float]) -> Floats:
    """Joint centres (C, 3), in the order of `centre_names`, of a body at rest, x forward, y left, z up.

    heads: (H, 3) m, bone heads of the body data, named (centres may be among the names) · build: `Phenotype.gender` and `age` ·
    size: stature of the body as it stands there, and the one that it is scaled to, m.
    """
    gender, age = build
    adult = float(np.interp(age, _CHILD_AGES, (0.0, 0.0, 1.0)))
    ten = float(np.interp(age, _CHILD_AGES, (0.0, 1.0, 0.0)))
    weight = np.array([adult * (1.0 - gender), adult * gender, ten, 1.0 - adult - ten])
    centres = {}
    for centre in named:
        if centre.endswith(CENTRE):
            name = centre.removesuffix(CENTRE)
            stem = _stem(name)
            side = 0.0 if stem == name else 1.0 if name[0] == "l" else -1.0
            off = (np.array(_SHARES[stem]) * weight[:, None]).sum(axis=0) * size[0]
            centres[name] = heads[named[name]] + off * (1.0, side, 1.0)
    left, right = centres["lupperleg01"], centres["rupperleg01"]
    middle, apart = (left[1] + right[1]) / 2, hips_apart_m(size[1]) * size[0] / size[1]
    left[1], right[1] = middle + apart / 2, middle - apart / 2
    return np.stack([*centres.values()])
