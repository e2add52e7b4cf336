"""Bodies of capsules and cabins of boxes, to test contact with geometry whose depths are known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from cabinpose.core.frames import Matrix
from cabinpose.core.skeleton import CABINPOSE, JOINTS
from cabinpose.scene.body.rig import SEGMENTS
from cabinpose.scene.cabin import Part
from cabinpose.scene.surface import Surface

# An upright stand with the arms out, m: far from any contact with itself.
STAND: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        "head": (0, 0, 1.6), "neck": (0, 0, 1.5), "chest": (0, 0, 1.3), "hip": (0, 0, 1.12),
        "lshoulder": (0, 0.25, 1.45), "lelbow": (0, 0.55, 1.45), "lwrist": (0, 0.8, 1.45), "lhand": (0, 0.88, 1.45),
        "lpelvis": (0, 0.12, 0.9), "lknee": (0, 0.16, 0.5), "lankle": (0, 0.16, 0.1), "lfoot": (0.15, 0.16, 0.05),
    }
)  # fmt: skip
CAPSULES = (
    ("pelvis", "hip", "hip", 0.10), ("abdomen", "hip", "hip", 0.05), ("thorax", "chest", "chest", 0.15),
    ("neck", "neck", "head", 0.06), ("head", "head", "head", 0.10),
    ("upper_arm", "shoulder", "elbow", 0.045), ("forearm", "elbow", "wrist", 0.040), ("hand", "wrist", "hand", 0.030),
    ("thigh", "pelvis", "knee", 0.075), ("shin", "knee", "ankle", 0.050), ("foot", "ankle", "foot", 0.040),
)  # fmt: skip


def surface(mesh: trimesh.Trimesh) -> Surface:
    """A `Surface` of a mesh; labels and materials play no part in contact."""
    count = np.zeros(len(mesh.faces), np.uint8)
    return Surface(
        mesh.vertices.astype(np.float32), mesh.vertex_normals.astype(np.float32), mesh.faces.astype(np.int32), count, count, count
    )


@dataclass(frozen=True)
class StubSeat:
    """A seat that only knows where its H-point is."""

    point: tuple[float, float, float]
    default: None = None

    def h_point(self, _: None) -> NDArray[np.float64]:
        """(3,) m."""
        return np.array(self.point, dtype=np.float64)


@dataclass(frozen=True)
class StubCabin:
    """Parts, and where their groups are."""

    parts: tuple[Part, ...]
    moved: Mapping[str, Matrix] = field(default_factory=dict)
    seats: Mapping[str, StubSeat] = field(default_factory=dict)

    def group_transforms(self, settings: Mapping[str, Matrix], *, wheel_angle: float = 0.0) -> Mapping[str, Matrix]:
        """The settings are the transforms; a wheel turns about its z axis."""
        result = {p.group: settings.get(p.group, np.eye(4)) for p in self.parts}
        if "wheel" in result:
            result["wheel"] = result["wheel"] @ trimesh.transformations.rotation_matrix(wheel_angle, (0, 0, 1))
        return result


@dataclass(frozen=True)
class StubPerson:
    """Faces and segments of a body of capsules."""

    skin_faces: NDArray[np.int32]
    skin_segment: NDArray[np.uint8]


@dataclass(frozen=True)
class StubPosed:
    """Skin and joints of a body of capsules."""

    skin: NDArray[np.float32]
    joints: NDArray[np.float64]


def capsule(a: NDArray[np.float64], b: NDArray[np.float64], radius: float, count: tuple[int, int] = (24, 24)) -> trimesh.Trimesh:
    """A capsule from a to b."""
    length = float(np.linalg.norm(b - a))
    if length < 1e-9:
        return trimesh.creation.icosphere(3, radius).apply_translation(a)
    mesh = trimesh.creation.capsule(length, radius, count=list(count))
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    return mesh.apply_transform(trimesh.geometry.align_vectors((0, 0, 1), b - a)).apply_translation((a + b) / 2)


def person(offset: tuple[float, float, float] = (0, 0, 0), **joints: tuple[float, float, float]) -> tuple[Any, Any]:
    """A body of capsules standing at `offset`; named joints (of the body at the origin) are put elsewhere."""
    place = dict(STAND) | {"r" + n[1:]: (p[0], -p[1], p[2]) for n, p in STAND.items() if n[0] == "l"} | joints
    at = np.zeros((len(JOINTS), 3))
    for name, p in place.items():
        at[CABINPOSE.index[name]] = np.array(p) + offset
    skins, faces, segments, start = [], [], [], 0
    for segment, a, b, radius in CAPSULES:
        for side in ("l", "r") if segment in ("upper_arm", "forearm", "hand", "thigh", "shin", "foot") else ("",):
            mesh = capsule(at[CABINPOSE.index[side + a]], at[CABINPOSE.index[side + b]], radius)
            skins.append(mesh.vertices)
            faces.append(mesh.faces + start)
            segments.append(np.full(len(mesh.vertices), SEGMENTS.index(side + segment), np.uint8))
            start += len(mesh.vertices)
    body = StubPerson(np.concatenate(faces).astype(np.int32), np.concatenate(segments))
    return body, StubPosed(np.concatenate(skins).astype(np.float32), at)
