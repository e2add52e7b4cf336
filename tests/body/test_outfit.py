"""What the camera sees: labels, materials, clothes over skin."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh

from cabinpose.scene import labels, materials
from cabinpose.scene.body import DOFS, SEGMENTS, SUBJECTS, BodyModel, Outfit, Phenotype
from cabinpose.scene.body.accessories import accessories
from cabinpose.scene.body.chart import load_chart, vertex_segments
from cabinpose.scene.body.garments import ear_mask, layer
from cabinpose.scene.body.parts import cut_skin
from cabinpose.scene.body.shape import load_shape_space

BARE = Outfit("none", "none", "none", "bald")
AREA_SHARE = {"torso": (0.1, 0.35), "thigh": (0.1, 0.3), "head": (0.04, 0.15), "hand": (0.02, 0.1), "foot": (0.02, 0.1)}


def surface_of(outfit: Outfit, phenotype: Phenotype | None = None):
    return BodyModel.load().person(phenotype or Phenotype(stature_m=1.7), outfit).pose(np.zeros(len(DOFS)), np.eye(4)).surface(3)


def test_every_part_is_there_and_in_its_place() -> None:
    surface = surface_of(BARE)
    present = {labels.LABELS[[l.id for l in labels.LABELS].index(i)].name for i in np.unique(surface.label)}
    assert present == {l.name for l in labels.BODY_PARTS} - {"hair", "headwear", "glasses"}
    middle = surface.vertices[surface.faces].mean(axis=1)

    def centre(name: str) -> np.ndarray:
        return middle[surface.label == labels.ID[name]].mean(axis=0)

    chain = ["head", "shoulder", "upper_arm", "elbow", "forearm", "wrist", "hand"]
    for upper, lower in itertools.pairwise(chain):
        assert centre(upper + "_left")[2] > centre(lower + "_left")[2]
    chain = ["torso", "hip", "thigh", "knee", "shin", "ankle", "foot"]
    for upper, lower in itertools.pairwise(chain):
        assert centre(upper + "_left")[2] > centre(lower + "_left")[2]
    for label in labels.BODY_PARTS:
        if label.name.endswith("_left"):
            left, right = (surface.label == labels.ID[label.name.replace("left", s)] for s in ("left", "right"))
            assert middle[left][:, 1].mean() > 0 > middle[right][:, 1].mean()
            assert abs(int(left.sum()) - int(right.sum())) <= 4
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    for name, (low, high) in AREA_SHARE.items():
        part = (surface.label == labels.ID[name + "_left"]) | (surface.label == labels.ID[name + "_right"])
        assert low < mesh.area_faces[part].sum() / mesh.area < high


def test_labels_are_in_one_piece() -> None:
    """Each part is one patch of skin (scraps of a few faces aside)."""
    rest = BodyModel.load().person(Phenotype()).rest_skin
    cut = cut_skin()
    mesh = trimesh.Trimesh(np.concatenate([rest, cut.blend @ rest]), cut.faces, process=False)
    label = cut.label
    for value in np.unique(label):
        part = label == value
        inside = part[mesh.face_adjacency].all(axis=1)
        pieces = trimesh.graph.connected_components(mesh.face_adjacency[inside], nodes=np.flatnonzero(part))
        assert max(len(p) for p in pieces) > 0.95 * part.sum(), value


def test_cutting_keeps_the_skin() -> None:
    """The cut skin is the same closed surface: volume, area, weights that sum to 1, and no slivers."""
    body = BodyModel.load().person(Phenotype())
    cut = cut_skin()
    whole = trimesh.Trimesh(body.rest_skin, body.skin_faces, process=False)
    mesh = trimesh.Trimesh(np.concatenate([body.rest_skin, cut.blend @ body.rest_skin]), cut.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(whole.volume, rel=1e-6)
    assert mesh.area == pytest.approx(whole.area, rel=1e-6)
    assert len(cut.faces) < 1.25 * len(load_shape_space().faces)
    np.testing.assert_allclose(cut.bone_weight.sum(axis=1), 1, atol=1e-5)


def test_segments_partition_the_skin() -> None:
    segments = vertex_segments()
    assert set(np.unique(segments)) == set(range(len(SEGMENTS)))
    rest = load_chart().rest
    for name in ("upper_arm", "forearm", "hand", "thigh", "shin", "foot"):
        assert (rest[segments == SEGMENTS.index("l" + name), 1] >= 0).all()


@pytest.mark.parametrize("name", SUBJECTS)
def test_clothes_never_lie_below_the_skin(name: str) -> None:
    phenotype, outfit = SUBJECTS[name]
    body = BodyModel.load().person(phenotype, outfit)
    worn = layer(body.rest_skin, outfit, body.stature_m / 1.8)
    mesh = trimesh.Trimesh(body.rest_skin, body.skin_faces, process=False)
    off = np.einsum("ij,ij->i", worn.vertices - body.rest_skin, mesh.vertex_normals)
    if outfit.hair in ("medium", "long"):
        off = off[~ear_mask()]  # pressed flat under the hair
    assert off.min() > -1e-4
    assert off.max() < 0.09


def test_surface_is_consistent() -> None:
    outfit = Outfit("jacket", "jeans", "trainers", "long", beard=True, cap=True, glasses=True)
    surface = surface_of(outfit)
    assert surface.vertices.dtype == np.float32
    assert surface.faces.dtype == np.int32
    assert surface.faces.max() < len(surface.vertices)
    assert len(surface.label) == len(surface.material) == len(surface.instance) == len(surface.faces)
    assert set(np.unique(surface.instance)) == {3}
    used = np.unique(surface.faces)
    assert np.allclose(np.linalg.norm(surface.normals[used], axis=1), 1, atol=1e-4)
    for name in ("hair", "headwear", "glasses"):
        assert (surface.label == labels.ID[name]).any()
    for name in ("skin", "hair", "synthetic_fabric", "denim", "spectacle_lens", "rubber"):
        assert (surface.material == materials.ID[name]).any()
    assert np.unique(surface.label).max() <= labels.LAST_BODY_ID


@pytest.mark.parametrize("hair", ["long", "bun"])
def test_accessories_are_closed_and_turned_outwards(hair: str) -> None:
    outfit = Outfit(hair=hair, cap=True, glasses=True)  # type: ignore[arg-type]
    body = BodyModel.load().person(Phenotype(), outfit)
    for part in accessories(body.rest_skin.astype(np.float64), body.rest, body.eyes_rest, outfit):
        mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
        assert mesh.is_winding_consistent
        if part.material[0] != materials.ID["spectacle_lens"]:  # a lens is a sheet
            assert mesh.is_watertight
            assert mesh.volume > 0


def test_glasses_and_cap_sit_on_the_head() -> None:
    body = BodyModel.load().person(Phenotype(stature_m=1.7), Outfit(cap=True, glasses=True))
    posed = body.pose(np.zeros(len(DOFS)), np.eye(4))
    surface = posed.surface(1)
    at = surface.vertices[surface.faces].mean(axis=1)
    lens = at[surface.material == materials.ID["spectacle_lens"]].mean(axis=0)
    assert 0.005 < lens[0] - posed.eyes_m[0] < 0.04
    assert np.abs(lens[1:] - posed.eyes_m[1:]).max() < 0.01
    assert at[surface.label == labels.ID["headwear"]][:, 2].max() > posed.skin[:, 2].max()


def test_random_outfits_differ_and_are_seeded() -> None:
    rng = np.random.Generator(np.random.Philox(5))
    outfits = [Outfit.random(rng=rng) for _ in range(50)]
    again = np.random.Generator(np.random.Philox(5))
    assert outfits == [Outfit.random(rng=again) for _ in range(50)]
    assert len({o.top for o in outfits}) == 4
    assert len({o.hair for o in outfits}) == 5
    assert len({o.folds for o in outfits}) > 45


def test_same_person_is_the_same_bytes() -> None:
    one, two = (surface_of(SUBJECTS["S13"].outfit, SUBJECTS["S13"].phenotype) for _ in range(2))
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.normals.tobytes() == two.normals.tobytes()
