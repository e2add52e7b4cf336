"""The packaged asset and the shapes it holds: vertices and bone heads of any phenotype, numpy only."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import numpy as np

from cabinpose._native import body as native
from cabinpose.core import AssetError, Bytes, Floats, Floats32, Ints32
from cabinpose.scene.body.anatomy import centre_names, joint_centres
from cabinpose.scene.body.phenotype import Phenotype
from cabinpose.scene.body.rig import BONES

ASSET, YOUNGER = "body.npz", "younger.npz"
_BABY_AGE, _NEWBORN_AGE = -0.9, -1.0  # that the two changes of `YOUNGER` lead to


@dataclass(frozen=True)
class ShapeSpace:
    """Shapes of all people: `mean` and `basis` (rank, N, 3) over skin vertices, then bone heads.

    Anny's shape is multilinear in the phenotypes between the corners of a grid (2 genders, 3 ages, 3 muscles, 3 weights,
    2 heights, 2 proportions); `coefficients` (216, rank) are those of the corners. faces: (F, 3) · bone_index,
    bone_weight: (V, 8), strongest first · mirror: (V,) each vertex's image on the other side ·
    younger: (N, 3) what makes a baby of a child of ten, of which those in between have a share, as in MakeHuman · newborn: (N, 3)
    likewise, a newborn of a baby · heads: by name, the bone heads of the data, then the joint centres that lie off them
    (`anatomy`).
    """

    mean: Floats32
    basis: Floats32
    coefficients: Floats
    faces: Ints32
    vertex_count: int
    bone_index: Bytes
    bone_weight: Floats32
    mirror: Ints32
    younger: Floats32
    newborn: Floats32
    heads: MappingProxyType[str, int]
    provenance: str

    def shape(self, phenotype: Phenotype) -> tuple[Floats32, Floats]:
        """Skin (V, 3) float32, and `heads` (H, 3) float64 at rest, m, Anny's origin, x forward, y left, z up."""
        weights = np.ones(1)
        p = phenotype
        age = max(p.age, 0.0)
        for value, anchors in ((p.gender, 2), (age, 3), (p.muscle, 3), (p.weight, 3), (p.height, 2), (p.proportions, 2)):
            weights = np.multiply.outer(weights, _hat(value, anchors)).ravel()
        points = np.empty_like(self.mean)
        native.blend_shapes(self.mean, self.basis, (weights[:, None] * self.coefficients).sum(axis=0), points)
        if p.age < 0.0:
            points += np.float32(min(p.age / _BABY_AGE, 1.0)) * self.younger
        if p.age < _BABY_AGE:
            points += np.float32((p.age - _BABY_AGE) / (_NEWBORN_AGE - _BABY_AGE)) * self.newborn
        skin, heads = points[: self.vertex_count], points[self.vertex_count :].astype(np.float64)
        size = float(np.ptp(skin[:, 2]))
        centres = joint_centres(heads, self.heads, (p.gender, p.age), (size, p.stature_m or size))
        return skin, np.concatenate([heads, centres])


def _hat(value: float, anchors: int) -> Floats:
    """Linear interpolation weights of `value` on anchors evenly spaced from 0 to 1."""
    return np.maximum(0.0, 1.0 - np.abs(value * (anchors - 1) - np.arange(anchors)))


@cache
def load_shape_space() -> ShapeSpace:
    """The packaged assets, read once per process. Raises AssetError where it is missing, damaged or of another rig."""
    folder, asset = files("cabinpose.scene.body") / "assets", dict[str, Any]()
    try:
        for file in (YOUNGER, ASSET):
            with (folder / file).open("rb") as stream, np.load(stream) as data:
                asset |= {name: data[name] for name in data.files}
        if tuple(asset["bones"].tolist()) != BONES:
            raise AssetError(f"{ASSET} is of another rig", hint="write it anew with tools/export_body.py")
        named = {str(name): i for i, name in enumerate(asset["heads"])}
        weight = asset["bone_weight"].astype(np.float32) / np.float32(65535)
        return ShapeSpace(
            asset["mean"],
            asset["basis"].astype(np.float32) * asset["basis_unit"][:, None, None],
            asset["coefficients"].astype(np.float64),
            asset["faces"],
            int(asset["vertex_count"]),
            asset["bone_index"],
            weight,
            asset["mirror"],
            (asset["change"] * asset["step"]).astype(np.float32),
            (asset["newborn"] * asset["step"]).astype(np.float32),
            MappingProxyType(named | centre_names(named)),
            str(asset["provenance"]),
        )
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise AssetError(f"the body asset {ASSET} cannot be read: {error}", hint="install the package again") from error
