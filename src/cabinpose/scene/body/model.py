"""`BodyModel`, `Person` and `PosedBody`: from numbers to posed, clothed people."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import cache, cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from cabinpose._native import body as native
from cabinpose.core import Bytes, ConfigError, Floats, Floats32, Ints32, Matrix
from cabinpose.core import reproducible as rp
from cabinpose.scene.body.accessories import HEEL_BACK_M, SOLE_M
from cabinpose.scene.body.chart import load_chart, vertex_segments
from cabinpose.scene.body.dress import Dressed, dress
from cabinpose.scene.body.faces import Face
from cabinpose.scene.body.fitting import BODY_DENSITY, shape_of, volume
from cabinpose.scene.body.kinematics import RestArrays, main_frames
from cabinpose.scene.body.measures import measure, measured_rows
from cabinpose.scene.body.outfit import Outfit
from cabinpose.scene.body.phenotype import Phenotype
from cabinpose.scene.body.proportions import DIMENSIONS
from cabinpose.scene.body.rig import BONE_INDEX, BONES, DOF_INDEX, DOFS, N_MAIN
from cabinpose.scene.body.shape import ShapeSpace, load_shape_space
from cabinpose.scene.body.skeleton import CLOSING, rest_arrays, rig_points
from cabinpose.scene.surface import Surface

FINGER_COUNTS = (5, 6, 16)  # numbers of a hand, as `Person.pose` takes its fingers


class Build:
    """Stands for what a person's outfits have in common, shape and soles: a key for what is kept of it."""


class Person:
    """One person: a shape and an outfit, ready to be posed. Made by `BodyModel.person`."""

    def __init__(self, space: ShapeSpace, phenotype: Phenotype, outfit: Outfit) -> None:
        self.phenotype = phenotype
        self.outfit = outfit
        self._space = space
        skin, heads = shape_of(phenotype)
        self.rest, origin = rest_arrays(skin.astype(np.float64), heads, space.heads)
        self.rest.soles[:, :3, 3] -= _under_soles(outfit)
        self.rest_skin: Floats32 = (skin - origin).astype(np.float32)
        self._rig_points = rig_points(heads - origin, space.heads, self.rest)
        self.eye_centres: Floats = heads[[space.heads["leye"], space.heads["reye"]]] - origin  # (2, 3) m, of left and right
        self.eyes_rest: Floats = (heads[space.heads["leye"]] + heads[space.heads["reye"]]) / 2 - origin
        self.stature_m = phenotype.size.stature_m if phenotype.size else float(np.ptp(skin[:, 2]))
        self.build = Build()
        self._shod = {outfit.shoes: (self.rest, self.build)}  # of all outfits

    def redressed(self, outfit: Outfit) -> Person:
        """The same person in another outfit; what is known of the shape is shared."""
        other = copy(self)
        other.outfit = outfit
        other.__dict__.pop("dressed", None)
        if outfit.shoes not in self._shod:
            soles = self.rest.soles.copy()
            soles[:, :3, 3] += _under_soles(self.outfit) - _under_soles(outfit)
            self._shod.setdefault(outfit.shoes, (self.rest._replace(soles=soles), Build()))
        other.rest, other.build = self._shod[outfit.shoes]
        return other

    @property
    def skin_faces(self) -> Ints32:
        """(Fs, 3): the closed bare skin, counter-clockwise seen from outside."""
        return self._space.faces

    @property
    def skin_segment(self) -> Bytes:
        """(Vs,) index into `SEGMENTS`."""
        return vertex_segments()

    @cached_property
    def volume_m3(self) -> float:
        """Of the bare body at rest (divergence theorem)."""
        return volume(self.rest_skin, self.skin_faces)

    @property
    def mass_kg(self) -> float:
        return self.volume_m3 * BODY_DENSITY

    @cached_property
    def segment_lengths(self) -> MappingProxyType[str, float]:
        """Joint to joint, m: upper_arm, forearm, thigh, shin; of the left side."""
        o = self.rest.offsets
        length = {
            name: rp.norm(o[BONE_INDEX[child]])
            for name, child in (("upper_arm", "lforearm"), ("forearm", "lhand"), ("thigh", "lshank"), ("shin", "lfoot"))
        }
        return MappingProxyType(length)

    @cached_property
    def dimensions_m(self) -> MappingProxyType[str, float]:
        """Stature and `DIMENSIONS` by name, m, measured on the bare mesh, standing and sitting upright."""
        values = measure(self.rest_skin[measured_rows().vertex], self.rest)
        return MappingProxyType(dict(zip(("stature", *DIMENSIONS), values.tolist(), strict=True)))

    @cached_property
    def dressed(self) -> Dressed:
        """The surface the camera sees, at rest."""
        size = self.stature_m / float(np.ptp(load_chart().rest[:, 2]))
        return dress(self._space, self.rest_skin, self.rest, self.eye_centres, self.outfit, size)

    def joints(self, q: Floats, vehicle_from_root: Matrix) -> Floats:
        """(20, 3) joints of `core.skeleton.JOINTS`, vehicle frame, m: kinematics only, no skinning."""
        rotation, position = main_frames(checked(q), self.rest, vehicle_from_root)
        out = np.empty_like(self.rest.joint_offset)
        native.joint_positions(self.rest, rotation, position, out)
        return out

    def skin_part(self, rows: NDArray[np.integer], fingers: Floats | None = None) -> Callable[[Floats, Matrix], Floats]:
        """What gives (q, vehicle_from_root) -> (R, 3) m, `pose(..., fingers).skin[rows]`, without the rest of the skin."""
        index, weight, rest = self.skin_weights(rows)
        rest = rest[None]

        def posed(q: Floats, vehicle_from_root: Matrix) -> Floats:
            transforms, out = np.empty((len(BONES), 3, 4)), np.empty_like(rest)
            bones = _with_fingers(self.rest, q, fingers)
            native.skin_transforms(checked(q), bones, *main_frames(q, self.rest, vehicle_from_root), transforms)
            native.skin_layers(transforms, index, weight, rest, out)
            return out[0].astype(np.float64)

        return posed

    def skin_weights(self, rows: NDArray[np.integer]) -> tuple[Bytes, Floats32, Floats32]:
        """Of vertices of the skin (R,): bones (R, K) of `rig.BONES`, their weights (R, K), places at rest (R, 3) m."""
        return self._space.bone_index[rows], self._space.bone_weight[rows], self.rest_skin[rows]

    @property
    def leading_bone(self) -> Bytes:
        """(Vs,) the bone of `rig.BONES` that each vertex of the skin follows most."""
        most = self._space.bone_weight.argmax(axis=1)
        return np.asarray(self._space.bone_index[np.arange(len(most)), most])

    def pose(self, q: Floats, vehicle_from_root: Matrix, fingers: Floats | None = None) -> PosedBody:
        """The person in a pose: q (D,) rad in the order of `DOFS`, root = pelvis frame at the H-point.

        fingers: (2, 5) curl of the left and right hand's fingers, thumb first, where they do not follow the grip (NaN: they do);
        or (2, 6), with how far the fingers are closed up, 0 spread to 1 side by side; or (2, 16), the same of each phalanx.
        """
        return PosedBody(self, checked(q), np.ascontiguousarray(vehicle_from_root, np.float64), fingers)


def checked(q: Floats) -> Floats:
    """q as (D,) float64; ValueError for another shape, and for what is not finite: the kernels read past their tables by it."""
    result = np.ascontiguousarray(q, np.float64)
    if result.shape != (len(DOFS),):
        raise ValueError(f"q has shape {result.shape}, expected ({len(DOFS)},)")
    if not np.isfinite(result).all():
        raise ValueError(f"q is not finite: {', '.join(DOFS[d].name for d in np.flatnonzero(~np.isfinite(result)))}")
    return result


def by_phalanx(fingers: Floats) -> Floats:
    """(2, 16) fingers as `Person.pose` takes them: curl of each phalanx, thumb first, from the knuckle on; how far closed up.

    Raises ValueError where a hand has other than 5, 6 or 16 of them.
    """
    if fingers.ndim != 2 or fingers.shape[0] != 2 or fingers.shape[1] not in FINGER_COUNTS:
        raise ValueError(f"fingers have shape {fingers.shape}, expected 2 rows of 5, 6 or 16")
    if fingers.shape[1] == 16:
        return fingers
    closed = fingers[:, 5:] if fingers.shape[1] == 6 else np.full((2, 1), np.nan)
    return np.concatenate((np.repeat(fingers[:, :5], 3, axis=1), closed), axis=1)


def every_finger(q: Floats, fingers: Floats | None) -> Floats:
    """(2, 16) fingers of a pose, those that follow the grip as they do; fingers as `Person.pose` takes them."""
    grip = q[[DOF_INDEX["lhand.grip"], DOF_INDEX["rhand.grip"]], None]
    by_grip = np.concatenate((np.repeat(grip, 15, axis=1), CLOSING * grip), axis=1)
    if fingers is None:
        return by_grip
    known = by_phalanx(fingers)
    by_grip[:, 15] = CLOSING * np.nanmean(np.where(np.isnan(known), by_grip, known)[:, 3:15], axis=1)
    return np.where(np.isnan(known), by_grip, known)


def _with_fingers(rest: RestArrays, q: Floats, fingers: Floats | None) -> RestArrays:
    """The skeleton with fingers that bend as `Person.pose` takes them: the kernel curls each by its hand's grip."""
    if fingers is None:
        return rest
    fingers = by_phalanx(fingers)
    grips = np.maximum(q[[DOF_INDEX["lhand.grip"], DOF_INDEX["rhand.grip"]], None], 1e-6)
    share = np.where(np.isnan(fingers), 1.0, fingers / grips)
    curl = rest.finger_curl.reshape(2, 15) * share[:, :15]
    closing_up = np.flatnonzero(~np.isnan(fingers[:, 15]))
    if not len(closing_up):
        return rest._replace(finger_curl=curl.reshape(-1))
    turns = (rest.finger_axes.reshape(2, 15, 3) * curl[..., None]).reshape(2, 5, 3, 3)
    for side in closing_up:  # knuckles turn about the hand's y axis, not in step with the curl
        across = rest.frames[BONE_INDEX["lr"[side] + "hand"]][:, 1]
        closing = (
            rp.matmul(rest.finger_axes.reshape(2, 5, 3, 3)[side, 1:, 0], across) * rest.finger_curl.reshape(2, 5, 3)[side, 1:, 0]
        )
        turns[side, 1:, 0] += ((share[side, 15] / CLOSING - share[side, 3:15:3]) * closing)[:, None] * across
    flat = turns.reshape(-1, 3)
    angle = np.linalg.norm(flat, axis=1)
    return rest._replace(finger_axes=flat / np.maximum(angle, 1e-12)[:, None], finger_curl=angle)


class PosedBody:
    """A person in a pose, vehicle frame. Skin, clothes and frames are computed here, once."""

    def __init__(self, person: Person, q: Floats, vehicle_from_root: Matrix, fingers: Floats | None = None) -> None:
        self.person = person
        self.q = q
        self.fingers = fingers
        self.vehicle_from_root = vehicle_from_root
        self._rotation, self._position = np.empty((N_MAIN, 3, 3)), np.empty((N_MAIN, 3))
        self._vehicle_from_mesh, self.joints = np.empty((len(BONES), 3, 4)), np.empty_like(person.rest.joint_offset)
        palms, soles = np.empty((2, 4, 4)), np.empty((2, 4, 4))
        rest = _with_fingers(person.rest, q, fingers)
        native.pose(
            q, rest, vehicle_from_root, self._rotation, self._position, self._vehicle_from_mesh, self.joints,
            palms=palms, soles=soles,
        )  # fmt: skip
        self.palms = {"l": palms[0], "r": palms[1]}
        self.soles = {"l": soles[0], "r": soles[1]}
        self.skin: Floats32 = self._skinned(person.rest_skin, person._space.bone_index, person._space.bone_weight)

    def _skinned(self, rest: Floats32, index: Bytes, weight: Floats32) -> Floats32:
        out = np.empty((1, len(rest), 3), np.float32)
        native.skin_layers(self._vehicle_from_mesh, index, weight, rest[None], out)
        return out[0]

    @cached_property
    def bones(self) -> Floats:
        """(73, 4, 4) vehicle_from_bone of `rig.BONES`; helpers and fingers have the axes of the mesh at rest."""
        result = np.tile(np.eye(4), (len(self._vehicle_from_mesh), 1, 1))
        result[:N_MAIN, :3, :3] = self._rotation
        result[N_MAIN:, :3, :3] = self._vehicle_from_mesh[N_MAIN:, :, :3]
        result[:, :3, 3] = np.einsum("bij,bj->bi", self._vehicle_from_mesh[:, :, :3], self.person.rest.heads)
        result[:, :3, 3] += self._vehicle_from_mesh[:, :, 3]
        return result

    @cached_property
    def rig_joints(self) -> Floats:
        """(20, 3) joints of `core.RIG`: where versions up to 0.2 had them, carried by today's bones."""
        bones = zip(*self.person._rig_points, strict=True)
        return np.stack([self._position[b] + rp.matmul(self._rotation[b], offset) for b, offset in bones])

    @property
    def eyes_m(self) -> Floats:
        """(3,) the point between the eyes."""
        head = self._vehicle_from_mesh[BONE_INDEX["head"]]
        return np.asarray(rp.matmul(head[:, :3], self.person.eyes_rest) + head[:, 3])

    def surface(self, instance: int, face: Face | None = None) -> Surface:
        """What the camera sees: clothed, with hair and accessories. instance: 1 + occupant slot.

        face: what it does; by default the eyes are open and look ahead.
        """
        d, rest = self.person.dressed, self.person.dressed.bent(self.q)
        if face is not None:
            d.face_rig.move(rest, face)
        vertices = self._skinned(rest, d.bone_index, d.bone_weight)
        normals = np.empty_like(vertices)
        native.vertex_normals(vertices, d.faces, normals)
        return Surface(vertices, normals, d.faces, d.label, d.material, np.full(len(d.faces), instance, np.uint8))


class BodyModel:
    """The parametric body; `BodyModel.load()` reads the packaged asset once per process."""

    def __init__(self, space: ShapeSpace) -> None:
        self._space = space

    @classmethod
    def load(cls) -> BodyModel:
        """The model of the packaged asset, the same object on every call. Raises AssetError."""
        return _loaded()

    @property
    def provenance(self) -> str:
        """Where the asset is from, with versions and licences."""
        return self._space.provenance

    def person(self, phenotype: Phenotype, outfit: Outfit | None = None) -> Person:
        """A person of this shape in this outfit (default: `Outfit()`). Deterministic."""
        return Person(self._space, phenotype, outfit or Outfit())

    def with_mass(self, phenotype: Phenotype, mass_kg: float) -> Phenotype:
        """The phenotype with the `weight` at which the bare body has this mass (within 0.1 kg); ConfigError where none has."""
        weights = np.linspace(0.0, 1.0, 11)
        masses = [self.person(replace(phenotype, weight=weight)).mass_kg for weight in weights.tolist()]
        if not masses[0] <= mass_kg <= masses[-1]:
            raise ConfigError(
                f"no body of this age, stature and build weighs {mass_kg:g} kg",
                hint=f"with muscle {phenotype.muscle:g} from {math.ceil(masses[0])} to {math.floor(masses[-1])} kg",
            )
        return replace(phenotype, weight=float(np.interp(mass_kg, masses, weights)))


def _under_soles(outfit: Outfit) -> Floats:
    """(3,) m by which shoes bring the soles back and down."""
    return np.array((HEEL_BACK_M, 0.0, SOLE_M[outfit.shoes]) if outfit.shoes != "none" else (0.0, 0.0, 0.0))


@cache
def _loaded() -> BodyModel:
    return BodyModel(load_shape_space())
