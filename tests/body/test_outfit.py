"""What the camera sees: labels, materials, clothes over skin."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh
from scipy.interpolate import griddata

from cabinpose.scene import labels, materials
from cabinpose.scene.body import DOFS, SEGMENTS, SUBJECTS, BodyModel, Outfit, Phenotype, garments
from cabinpose.scene.body.accessories import accessories, bun, hanging_hair
from cabinpose.scene.body.chart import load_chart, vertex_segments
from cabinpose.scene.body.coverage import borders
from cabinpose.scene.body.folds import seen_chart
from cabinpose.scene.body.garments import BOTTOMS, TOPS, Layer, layer
from cabinpose.scene.body.parts import cut_skin
from cabinpose.scene.body.rig import BONE_INDEX
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
        return middle[surface.label == labels.LABEL_ID[name]].mean(axis=0)

    chain = ["head", "shoulder", "upper_arm", "elbow", "forearm", "wrist", "hand"]
    for upper, lower in itertools.pairwise(chain):
        assert centre(upper + "_left")[2] > centre(lower + "_left")[2]
    chain = ["torso", "hip", "thigh", "knee", "shin", "ankle", "foot"]
    for upper, lower in itertools.pairwise(chain):
        assert centre(upper + "_left")[2] > centre(lower + "_left")[2]
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    for label in labels.BODY_PARTS:
        if label.name.endswith("_left"):
            left, right = (surface.label == labels.LABEL_ID[label.name.replace("left", s)] for s in ("left", "right"))
            assert middle[left][:, 1].mean() > 0 > middle[right][:, 1].mean()
            assert mesh.area_faces[left].sum() == pytest.approx(mesh.area_faces[right].sum(), rel=0.02)
    for name, (low, high) in AREA_SHARE.items():
        part = (surface.label == labels.LABEL_ID[name + "_left"]) | (surface.label == labels.LABEL_ID[name + "_right"])
        assert low < mesh.area_faces[part].sum() / mesh.area < high


def test_labels_are_in_one_piece() -> None:
    """Each part is one patch of skin (scraps of a few faces aside)."""
    rest = BodyModel.load().person(Phenotype()).rest_skin
    cut = cut_skin()
    mesh = trimesh.Trimesh(np.concatenate([rest, cut.blend.of(rest)]), cut.faces, process=False)
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
    mesh = trimesh.Trimesh(np.concatenate([body.rest_skin, cut.blend.of(body.rest_skin)]), cut.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(whole.volume, rel=1e-6)
    assert mesh.area == pytest.approx(whole.area, rel=1e-6)
    assert len(cut.faces) < 2 * len(load_shape_space().faces)
    np.testing.assert_allclose(cut.bone_weight.sum(axis=1), 1, atol=1e-5)


def test_segments_partition_the_skin() -> None:
    segments = vertex_segments()
    assert set(np.unique(segments)) == set(range(len(SEGMENTS)))
    rest = load_chart().rest
    for name in ("upper_arm", "forearm", "hand", "thigh", "shin", "foot"):
        assert (rest[segments == SEGMENTS.index("l" + name), 1] >= 0).all()


def worn_by(name: str) -> tuple[Layer, object]:
    phenotype, outfit = SUBJECTS[name]
    body = BodyModel.load().person(phenotype, outfit)
    return layer(body.rest_skin, body.rest, outfit, body.stature_m / 1.8), body


def under(outfit: Outfit) -> np.ndarray:
    """(V + N,) bool: seen vertices that cloth covers."""
    fields = [borders()[cut.border] for name in (outfit.top, outfit.bottom) if (cut := {**TOPS, **BOTTOMS}.get(name))]
    field = np.max(fields, axis=0)
    return np.concatenate([field, cut_skin().blend.of(field)]) > 0


@pytest.mark.parametrize("name", ["S01", "S02", "S04", "S05", "S08", "S10", "S11", "S12", "S14"])
def test_clothes_never_lie_below_the_skin(name: str) -> None:
    """Against the whole bare body, by rays' parity and the nearest point."""
    worn, body = worn_by(name)
    mesh = trimesh.Trimesh(body.rest_skin, body.skin_faces, process=False)
    covered = np.flatnonzero(under(body.outfit))
    inside = covered[mesh.contains(worn.vertices[covered].astype(np.float64))]
    if len(inside):
        _, depth, _ = trimesh.proximity.closest_point(mesh, worn.vertices[inside].astype(np.float64))
        c = seen_chart()
        facing = (c.up[inside] < -0.1) & (np.abs(c.rest[inside, 1]) < 0.03) | (np.abs(c.rest[inside, 1]) > 0.15) & (
            c.up[inside] > 0.6
        )
        assert depth[~facing].max(initial=0) < 0.001  # the facets' own height
        assert depth.max() < 0.004  # between the thighs and in the armpits skin faces skin
    assert np.linalg.norm(worn.vertices - worn.bare, axis=1).max() < 0.13


def trunk_front() -> np.ndarray:
    """(V,) bool: belly and breast of the skin's own vertices, inside every top."""
    c = load_chart()
    return (c.arm < 0.05) & (c.leg < 0.05) & (c.up > 0.2) & (c.up < 0.8) & (c.rest[:, 0] > 0.03)


def unevenness(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) 1/m: mean curvature by the umbrella's normal part over the mean squared edge."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    a, b = np.concatenate([mesh.edges_unique, mesh.edges_unique[:, ::-1]]).T
    count = np.bincount(a, minlength=len(vertices))
    way = mesh.vertices[b] - mesh.vertices[a]
    mean = np.stack([np.bincount(a, way[:, i], len(vertices)) for i in range(3)], axis=1) / count[:, None]
    square = np.bincount(a, (way**2).sum(axis=1), len(vertices)) / count
    return np.einsum("ij,ij->i", mean, mesh.vertex_normals) / square * 2


@pytest.mark.parametrize("name", ["S01", "S02", "S04", "S11", "S12"])
def test_cloth_bridges_what_skin_shows(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without its folds, cloth on belly and breast is flatter than the skin below, in hollows above all."""
    monkeypatch.setattr(garments, "folds", lambda where, *_, **__: np.zeros(len(where)))
    worn, body = worn_by(name)
    front = trunk_front()
    skin = unevenness(body.rest_skin, body.skin_faces)[front]
    cloth = unevenness(worn.vertices[: len(body.rest_skin)], body.skin_faces)[front]
    assert np.sqrt((cloth**2).mean()) < 0.85 * np.sqrt((skin**2).mean())
    assert cloth.clip(0).mean() < 0.6 * skin.clip(0).mean()


def fold_heights(name: str, monkeypatch: pytest.MonkeyPatch) -> tuple[np.ndarray, np.ndarray]:
    """Height (V + N,) m that folds add, and which vertices cloth covers."""
    worn, body = worn_by(name)
    with monkeypatch.context() as patched:
        patched.setattr(garments, "folds", lambda where, *_, **__: np.zeros(len(where)))
        plain, _ = worn_by(name)
    return np.linalg.norm(worn.vertices - plain.vertices, axis=1), under(body.outfit)


@pytest.mark.parametrize("name", ["S01", "S02", "S04", "S12"])
def test_folds_are_seen_by_the_sensor(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folds are 5 to 15 mm high, none where nothing is worn, and they vary over 3.5 to 12 cm."""
    height, cloth = fold_heights(name, monkeypatch)
    assert height[~cloth & (seen_chart().head > 0.5)].max() == 0
    assert 0.005 < np.percentile(height[cloth], 95) < 0.015
    assert height.max() < 0.020
    p = seen_chart().rest
    belly = cloth & (p[:, 0] > 0.03) & (seen_chart().arm < 0.05) & (p[:, 2] > 0.06) & (p[:, 2] < 0.33)
    y, z = np.meshgrid(np.arange(-0.08, 0.081, 0.02), np.arange(0.09, 0.30, 0.005), indexing="ij")
    profile = griddata(p[belly][:, 1:], height[belly], (y, z), method="linear")
    assert np.isfinite(profile).all()
    profile -= profile.mean(axis=1, keepdims=True)
    power = (np.abs(np.fft.rfft(profile * np.hanning(profile.shape[1]), axis=1)) ** 2).sum(axis=0)
    wavelength = 1 / np.maximum(np.fft.rfftfreq(profile.shape[1], 0.005), 1e-9)
    assert profile.std() > 0.001
    assert power[(wavelength > 0.035) & (wavelength < 0.12)].sum() > 0.25 * power.sum()


def test_folds_follow_their_seed() -> None:
    body = BodyModel.load().person(Phenotype())
    one, same, other = (layer(body.rest_skin, body.rest, Outfit(folds=k), 1.0).vertices for k in (1, 1, 2))
    assert one.tobytes() == same.tobytes()
    assert np.abs(one - other).max() > 0.004


def test_tops_end_above_the_trousers() -> None:
    """At its hem a top stands off what the trousers alone would show."""
    body = BodyModel.load().person(Phenotype())
    both, trousers = (layer(body.rest_skin, body.rest, Outfit(top=top), 1.0) for top in ("t_shirt", "none"))  # type: ignore[arg-type]
    field = borders()["t_shirt"]
    hem = (field > 0) & (field < 0.02) & (load_chart().arm < 0.05) & (load_chart().up < 0.2)
    assert hem.sum() > 20
    off = np.linalg.norm(both.vertices - both.bare, axis=1) - np.linalg.norm(trousers.vertices - trousers.bare, axis=1)
    assert np.percentile(off[: len(field)][hem], 20) > 0.003


@pytest.mark.parametrize("name", ["beard", "scalp", "cap", "t_shirt"])
def test_borders_of_materials_run_smoothly(name: str) -> None:
    """Nearly all of a border's edges lie on the line where its field is 0, not along the mesh as it was."""
    cut, field = cut_skin(), borders()[name]
    edge = field + garments.HEM_M if name in ("t_shirt", "cap") else field
    value = np.concatenate([edge, cut.blend.of(edge)])
    pairs = np.sort(np.stack([cut.faces, np.roll(cut.faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    inside = np.repeat(cut.inside[name], 3)
    key = pairs[:, 0].astype(np.int64) * len(value) + pairs[:, 1]
    order = np.argsort(key, kind="stable")
    first, second = order[::2], order[1::2]
    border = first[inside[first] != inside[second]]
    assert len(border) > 40
    assert (np.abs(value[pairs[border]]).max(axis=1) < 0.005).mean() > 0.95


def test_surface_is_consistent() -> None:
    outfit = Outfit("jacket", "jeans", "trainers", "long", beard=True, headwear="cap", glasses="clear")
    surface = surface_of(outfit)
    assert surface.vertices.dtype == np.float32
    assert surface.faces.dtype == np.int32
    assert surface.faces.max() < len(surface.vertices)
    assert len(surface.label) == len(surface.material) == len(surface.instance) == len(surface.faces)
    assert set(np.unique(surface.instance)) == {3}
    used = np.unique(surface.faces)
    assert np.allclose(np.linalg.norm(surface.normals[used], axis=1), 1, atol=1e-4)
    for name in ("hair", "headwear", "glasses"):
        assert (surface.label == labels.LABEL_ID[name]).any()
    for name in ("skin", "hair", "synthetic_fabric", "denim", "spectacle_lens", "rubber"):
        assert (surface.material == materials.MATERIAL_ID[name]).any()
    assert np.unique(surface.label).max() <= labels.LAST_BODY_ID


@pytest.mark.parametrize("hair", ["long", "bun"])
def test_accessories_are_closed_and_turned_outwards(hair: str) -> None:
    outfit = Outfit(hair=hair, headwear="cap", glasses="clear")  # type: ignore[arg-type]
    body = BodyModel.load().person(Phenotype(), outfit)
    for part in accessories(body.rest_skin.astype(np.float64), body.rest, body.eyes_rest, outfit):
        mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
        assert mesh.is_winding_consistent
        if part.material[0] != materials.MATERIAL_ID["spectacle_lens"]:  # a lens is a sheet
            assert mesh.is_watertight
            assert mesh.volume > 0


@pytest.mark.parametrize(("name", "cap"), [("S02", False), ("S05", True), ("S09", False), ("S11", True)])
def test_hair_sits_on_its_head(name: str, *, cap: bool) -> None:
    """A knot grows out of the head, below a cap; long hair begins inside the hair on the head and covers the back of it."""
    body = BodyModel.load().person(SUBJECTS[name].phenotype, Outfit(hair="bun", headwear="cap" if cap else "none"))
    skin, eyes = body.rest_skin.astype(np.float64), body.eyes_rest
    mesh = trimesh.Trimesh(body.rest_skin, body.skin_faces, process=False)
    knot = bun(skin, eyes, cap=cap).vertices
    off = -trimesh.proximity.signed_distance(mesh, knot)
    assert (off < garments.HAIR_DEPTH_M["bun"]).mean() > 0.15
    assert 0.035 < off.max() < 0.06
    if cap:
        assert knot[off > 0.01, 2].max() < eyes[2] + 0.012  # where the rim is, behind
    hair = hanging_hair(skin, eyes, body.rest.heads[BONE_INDEX["neck01"]], cap=cap)
    first = hair.vertices[:30]  # the outer sheet's upper border
    _, away, _ = trimesh.proximity.closest_point(mesh, first)
    assert away.max() < garments.HAIR_DEPTH_M["long"]
    above_neck = (skin[:, 2] > eyes[2] - 0.06) & (skin[:, 2] < eyes[2]) & (load_chart().head > 0.9) & (borders()["ears"] < 0)
    back = skin[above_neck & (skin[:, 0] < eyes[0] - 0.13)]
    assert len(back) > 20
    assert trimesh.Trimesh(hair.vertices, hair.faces).bounding_box.contains(back).all()


def test_glasses_and_cap_sit_on_the_head() -> None:
    body = BodyModel.load().person(Phenotype(stature_m=1.7), Outfit(headwear="cap", glasses="clear"))
    posed = body.pose(np.zeros(len(DOFS)), np.eye(4))
    surface = posed.surface(1)
    at = surface.vertices[surface.faces].mean(axis=1)
    lens = at[surface.material == materials.MATERIAL_ID["spectacle_lens"]].mean(axis=0)
    assert 0.005 < lens[0] - posed.eyes_m[0] < 0.04
    assert np.abs(lens[1:] - posed.eyes_m[1:]).max() < 0.01
    assert at[surface.label == labels.LABEL_ID["headwear"]][:, 2].max() > posed.skin[:, 2].max()


def test_random_outfits_differ_and_are_seeded() -> None:
    rng = np.random.Generator(np.random.Philox(5))
    outfits = [Outfit.random(rng=rng) for _ in range(50)]
    again = np.random.Generator(np.random.Philox(5))
    assert outfits == [Outfit.random(rng=again) for _ in range(50)]
    assert len({o.top for o in outfits}) > 6
    assert len({o.hair for o in outfits}) == 5
    assert len({o.folds for o in outfits}) > 45


def test_same_person_is_the_same_bytes() -> None:
    one, two = (surface_of(SUBJECTS["S13"].outfit, SUBJECTS["S13"].phenotype) for _ in range(2))
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.normals.tobytes() == two.normals.tobytes()
