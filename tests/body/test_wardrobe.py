"""Clothes that are cloth on their own: closed, outside of the body, where they belong, and as common as is said."""

from __future__ import annotations

import collections
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
from scipy import stats
from scipy.spatial import ConvexHull, cKDTree

from cabinpose._native import body as native
from cabinpose.scene import LABEL_ID, MATERIAL_ID
from cabinpose.scene.body import BONES, DOF_INDEX, DOFS, PLACES, SUBJECTS, BodyModel, Outfit, Phenotype, outfit
from cabinpose.scene.body.accessories import head_box
from cabinpose.scene.body.garments import layer
from cabinpose.scene.body.sheets import hull_radius
from cabinpose.scene.body.wardrobe import draped
from cabinpose.synth.people import People
from cabinpose.synth.subjects import Subjects

MAN, WOMAN = "S01", "S02"
PLAIN = Outfit("long_sleeve", "trousers", "trainers", "short")
WORN = {
    "collar": {"top": "shirt"}, "stand_collar": {"top": "turtleneck"}, "hood_down": {"top": "hoodie"},
    "hood": {"top": "hoodie", "headwear": "hood"}, "open_jacket": {"top": "open_jacket"}, "coat": {"top": "coat"},
    "scarf": {"scarf": True}, "headscarf": {"headwear": "headscarf"}, "beanie": {"headwear": "beanie"},
    "hat": {"headwear": "hat"},
    "mask": {"mask": True}, "skirt": {"bottom": "skirt"}, "long_skirt": {"bottom": "long_skirt"}, "dress": {"bottom": "dress"},
}  # fmt: skip


ABOUT_NECKS_M = {
    "collar": 0.03,
    "stand_collar": 0.025,
    "hood_down": 0.08,
    "open_jacket": 0.08,
    "coat": 0.05,
    "scarf": 0.05,
}  # off the skin
CHILDREN = [*(f"K{number:02d}" for number in range(14)), *(f"{kind}{number:02d}" for kind in "TI" for number in range(12))]


@cache
def bare(name: str):
    return BodyModel.load().person(SUBJECTS[name].phenotype, PLAIN)


@cache
def clothed(name: str, **worn):
    """Somebody in the plain outfit with these changes, who is dressed once for all tests."""
    return bare(name).redressed(replace(PLAIN, **worn))


def person(name: str, garment: str):
    return clothed(name, **WORN.get(garment, {}))


def dressed(body):
    """Cloth on its own, and the layer below it."""
    seen = layer(body.rest_skin, body.rest, body.outfit, 1.0)
    skin, middle = body.rest_skin.astype(np.float64), body.eye_centres.mean(axis=0)
    return draped(seen.vertices, seen.bare, body.rest, middle, head_box(skin, middle), body.outfit), seen


@cache
def draped_on(name: str, garment: str):
    return dressed(person(name, garment))


def pieces(name: str, garment: str):
    return draped_on(name, garment)[0]


def seated() -> np.ndarray:
    q = np.zeros(len(DOFS))
    for side in "lr":
        for axis, degrees in (("hip.flexion", 85), ("knee.flexion", 80), ("hip.abduction", 12)):
            q[DOF_INDEX[f"{side}{axis}"]] = np.radians(degrees)
    return q


@pytest.mark.parametrize("garment", WORN)
def test_every_piece_is_closed_and_turned_outwards(garment: str) -> None:
    made = pieces(WOMAN, garment)
    assert made
    for piece in made:
        mesh = trimesh.Trimesh(piece.vertices, piece.faces, process=False)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
        np.testing.assert_allclose(piece.weights.sum(axis=1), 1.0, atol=1e-9)


@pytest.mark.parametrize("age", [-1.0, -0.8, -0.6, 0.0])
def test_a_scarf_lies_round_necks_of_every_age(age: float) -> None:
    """A child's is shorter against its head: the turns lie below the chin, on skin, and not above where rays meet any."""
    body = BodyModel.load().person(Phenotype(age=age), replace(PLAIN, scarf=True))
    (upper, lower, _), _ = dressed(body)
    middle = body.eye_centres.mean(axis=0)
    mesh = trimesh.Trimesh(body.rest_skin, body.skin_faces, process=False)
    for turn in (upper, lower):
        _, distance, _ = trimesh.proximity.closest_point(mesh, turn.vertices)
        assert np.quantile(distance, 0.9) < 0.035
        assert turn.vertices[:, 2].max() < middle[2]


@pytest.mark.parametrize(
    "child", [pytest.param(child, marks=[pytest.mark.slow] if i % 3 else []) for i, child in enumerate(CHILDREN)]
)
def test_children_wear_what_is_about_the_neck(child: str) -> None:
    """All of it is near the bare body and below the eyes, however short the neck."""
    phenotype, _ = Subjects(People(), 0).body(child)
    plain = BodyModel.load().person(phenotype, PLAIN)
    for garment, far in ABOUT_NECKS_M.items():
        body = plain.redressed(replace(PLAIN, **WORN[garment]))
        made, seen = dressed(body)
        skin, eyes = cKDTree(seen.bare), body.eye_centres[:, 2].min()
        for piece in made[:1] if garment == "coat" else made:  # its skirt hangs off the thighs
            assert np.quantile(skin.query(piece.vertices)[0], 0.97) < far, garment
            assert piece.vertices[:, 2].max() < eyes - 0.01, garment


@pytest.mark.parametrize("name", ["S02", "S04", "S08", "S10", "S17"])
@pytest.mark.parametrize("garment", ["collar", "coat", "open_jacket"])
def test_collars_and_fronts_end_on_the_cloth(name: str, garment: str) -> None:
    """On the shoulders of anybody a collar's leaf is no brim, and the upper edge of an open jacket's fronts no slab."""
    made, seen = draped_on(name, garment)
    cloth, columns = cKDTree(seen.vertices), 41
    assert cloth.query(made[0].vertices[8 * columns : 9 * columns])[0].max() < 0.016
    if garment == "open_jacket":
        for front in made[-2:]:
            assert cloth.query(front.vertices[:10])[0].max() < 0.018


def test_a_ball_rolls_as_far_as_its_closest_form_says() -> None:
    """To the bit as numpy has it: the parabola in place of the ball's cap, the first of points that are as far out."""
    rng = np.random.default_rng(5)
    points = rng.normal(0.0, 0.1, (501, 3))
    points[400:] = points[:101]
    origin, direction = rng.normal(0.0, 0.02, (6, 7, 3)), rng.normal(size=(6, 7, 3))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    away = points - origin[..., None, :]
    x, y, z = np.moveaxis(away * direction[..., None, :], -1, 0)
    along = x + y + z
    x, y, z = np.moveaxis(away * away, -1, 0)
    beside = x + y + z - along * along
    for ball in (0.03, 0.004):
        height = np.where(along > 0, along - 0.5 * beside / ball, -1.0) - 10.0 * (beside > ball * ball)
        radius, touched = np.empty((6, 7)), np.empty((6, 7), np.int64)
        native.roll_ball(points, origin=origin, direction=direction, ball=ball, radius=radius, touched=touched)
        np.testing.assert_array_equal(touched, height.argmax(axis=2))
        np.testing.assert_array_equal(radius, height.max(axis=2))
    assert (radius < 0.0).any()


@pytest.mark.parametrize("name", [MAN, WOMAN])
@pytest.mark.parametrize("garment", ["headscarf", "hood", "beanie", "hat", "mask", "skirt", "long_skirt", "coat"])
def test_cloth_is_not_below_the_skin(name: str, garment: str) -> None:
    """Its outer side against the whole bare body, by rays' parity and the nearest point."""
    body = person(name, garment)
    mesh = trimesh.Trimesh(body.rest_skin, body.skin_faces, process=False)
    cloth = max(pieces(name, garment), key=lambda piece: len(piece.vertices)).vertices
    outer = cloth[: len(cloth) // 2]
    inside = outer[mesh.contains(outer)]
    if len(inside):
        _, depth, _ = trimesh.proximity.closest_point(mesh, inside)
        assert depth.max() < 0.004
    _, off, _ = trimesh.proximity.closest_point(mesh, outer)
    assert np.percentile(off, 50) < 0.07  # and it is worn, not hung up beside


def test_a_hull_is_that_of_its_points() -> None:
    """Against scipy's convex hull of two thighs, along rays from between them."""
    points = np.concatenate([np.random.default_rng(3).normal((0.0, y), (0.05, 0.04), (300, 2)) for y in (-0.09, 0.09)])
    normal, offset = np.split(ConvexHull(points).equations, [2], axis=1)
    angle = np.linspace(0.0, 6.2, 50)
    along = normal @ np.stack([np.cos(angle), np.sin(angle)])
    exact = np.where(along > 1e-9, -offset / np.maximum(along, 1e-9), np.inf).min(axis=0)
    assert (hull_radius(points, angle) / exact - 1.0).clip(0).max() < 0.04  # by 48 tangents, from outside
    assert (hull_radius(points, angle) >= exact - 1e-9).all()


@pytest.mark.parametrize("name", [MAN, WOMAN])
@pytest.mark.parametrize("garment", ["skirt", "long_skirt", "dress"])
def test_a_skirt_spans_the_lap(name: str, garment: str) -> None:
    """From thigh to thigh of who sits with the legs apart all that is seen from above is cloth, at the thighs' height; of
    trousers there is none in the middle.
    """
    met = {}
    for worn in (garment, "trousers"):
        body = person(name, worn)
        posed = body.pose(seated(), np.eye(4))
        surface, knees = posed.surface(1), posed.bones[[BONES.index(side + "shank") for side in "lr"], :3, 3]
        across = np.linspace(0.75, -0.75, 9)[:, None] * (knees[0] - knees[1]) / 2 * (0.0, 1.0, 0.0)
        above = 0.7 * knees.mean(axis=0) * (1.0, 0.0, 0.0) + across + (0.0, 0.0, 1.0)
        mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
        face = mesh.ray.intersects_first(above, np.tile((0.0, 0.0, -1.0), (9, 1)))
        height = np.where(face >= 0, mesh.triangles_center[face][:, 2], -1.0)
        met[worn] = height, [PLACES[body.dressed.worn[f]] for f in face]
    height, place = met[garment]
    assert set(place) == {"bottom"}
    assert height.min() > height[[0, -1]].min() - 0.05
    assert met["trousers"][0][4] < height[4] - 0.06


@pytest.mark.parametrize("name", [MAN, WOMAN])
@pytest.mark.parametrize("garment", ["skirt", "dress"])
def test_a_skirt_lies_on_the_thighs_of_who_sits(name: str, garment: str) -> None:
    """Straight above the middle of each bare thigh the cloth is near, and outside."""
    body = person(name, garment)
    posed = body.pose(seated(), np.eye(4))
    surface = posed.surface(1)
    heads = posed.bones[[BONES.index(side + bone) for bone in ("thigh", "shank") for side in "lr"], :3, 3]
    above = 0.5 * (heads[:2] + heads[2:]) + (0.0, 0.0, 1.0)
    places = np.array([PLACES[k] for k in body.dressed.worn])
    cloth = trimesh.Trimesh(surface.vertices, surface.faces[places == "bottom"], process=False)
    skin = trimesh.Trimesh(posed.skin, body.skin_faces, process=False)
    down = np.tile((0.0, 0.0, -1.0), (2, 1))
    tops = []
    for mesh in (cloth, skin):
        at, ray, _ = mesh.ray.intersects_location(above, down)
        tops.append([at[ray == k, 2].max() for k in range(2)])
    gap = np.subtract(*tops)
    assert gap.min() > 0.0
    assert gap.max() < 0.03


@pytest.mark.parametrize("headwear", ["headscarf", "hood"])
def test_no_collar_comes_through_what_covers_the_neck(headwear: str) -> None:
    """Whatever the top: beside the headwear there is no more cloth than with a top that has no collar."""
    body = person(WOMAN, "")
    skin, middle = body.rest_skin.astype(np.float64), body.eye_centres.mean(axis=0)
    made = []
    for top in ("long_sleeve", "shirt", "turtleneck", "hoodie"):
        worn = replace(PLAIN, top=top, headwear=headwear)
        seen = layer(body.rest_skin, body.rest, worn, 1.0)
        made.append(len(draped(seen.vertices, seen.bare, body.rest, middle, head_box(skin, middle), worn)))
    assert made == [1, 1, 1, 1]


@pytest.mark.parametrize("name", [MAN, WOMAN, "S05"])
def test_a_mask_covers_mouth_and_nose(name: str) -> None:
    """And neither eye: what a ray from before the face meets first."""
    body = clothed(name, mask=True)
    dressed, eyes = body.dressed, body.eye_centres
    mesh = trimesh.Trimesh(dressed.rest, dressed.faces, process=False)
    lips = dressed.rest[dressed.faces[dressed.is_lip]].mean(axis=(0, 1))
    skin = body.rest_skin
    front = (np.abs(skin[:, 1]) < 0.01) & (skin[:, 2] > lips[2] + 0.01) & (skin[:, 2] < eyes[0, 2] - 0.02)
    face = skin[front]
    nose = face[face[:, 0].argmax()]
    points = np.stack([lips, nose, *eyes])
    start = points * (0.0, 1.0, 1.0) + (1.0, 0.0, 0.0)
    met = mesh.ray.intersects_first(start, np.tile((-1.0, 0.0, 0.0), (4, 1)))
    assert [PLACES[dressed.worn[face]] for face in met] == ["mask", "mask", "", ""]


def test_contact_sees_the_bare_body() -> None:
    """The verdict on a pose is that of the skin, whatever is worn over it: no garment changes how often poses hold."""
    skins = {person(WOMAN, garment).pose(seated(), np.eye(4)).skin.tobytes() for garment in ("", *WORN)}
    assert len(skins) == 1


@pytest.mark.parametrize("garment", ["hood", "coat", "long_skirt", "scarf"])
def test_clothes_are_the_same_bytes(garment: str) -> None:
    one, two = (BodyModel.load().person(SUBJECTS[WOMAN].phenotype, replace(PLAIN, **WORN[garment])).dressed for _ in range(2))
    assert one.rest.tobytes() == two.rest.tobytes()
    assert one.bone_weight.tobytes() == two.bone_weight.tobytes()


@pytest.mark.parametrize("gender", [0.0, 1.0])
def test_outfits_are_as_common_as_said(gender: float) -> None:
    rng = np.random.Generator(np.random.Philox(11))
    count = 6000
    drawn = [Outfit.random(rng=rng, gender=gender) for _ in range(count)]
    basic = {"t_shirt": 3 / 9, "long_sleeve": 2 / 9, "jumper": 2 / 9, "jacket": 2 / 9}
    tops: collections.Counter[str] = collections.Counter()
    for season, share in (("cold", outfit.COLD), ("warm", 1 - outfit.COLD)):
        for top, often in basic.items():
            for kind, part in outfit.TOP_CUTS[season].get(top, {top: 1.0}).items():
                tops[kind] += share * often * part
    seen = collections.Counter(each.top for each in drawn)
    assert set(seen) == set(tops)
    assert stats.chisquare([seen[kind] for kind in tops], [count * tops[kind] for kind in tops]).pvalue > 0.001
    hangs = 1 - outfit.HOOD_UP - gender * outfit.HEADSCARF  # of hoods: over them nobody has a scarf
    no_scarf = {
        season: gender * outfit.HEADSCARF + 2 / 9 * outfit.TOP_CUTS[season]["jumper"]["hoodie"] * hangs
        for season in ("cold", "warm")
    }
    assert not any(each.scarf and each.top == "hoodie" and each.headwear != "hood" for each in drawn)
    hanging = sum(each.bottom in outfit.HANGING_SHARES for each in drawn)
    assert stats.binomtest(hanging, count, gender * sum(outfit.HANGING_SHARES.values())).pvalue > 0.001
    for number, name in enumerate(("scarf", "gloves", "mask"), start=1):
        share = sum(
            often * outfit.SMALL_SHARES[season][number] * (1 - no_scarf[season] if name == "scarf" else 1.0)
            for season, often in (("cold", outfit.COLD), ("warm", 1 - outfit.COLD))
        )
        assert stats.binomtest(sum(getattr(each, name) for each in drawn), count, share).pvalue > 0.001, name
    beanies = (
        outfit.COLD * outfit.HEADWEAR_SHARES["cold"]["beanie"] + (1 - outfit.COLD) * outfit.HEADWEAR_SHARES["warm"]["beanie"]
    )
    assert stats.binomtest(sum(each.headwear == "beanie" for each in drawn), count, beanies).pvalue > 0.001


TURNS_DEG = {
    "ahead": {}, "left": {"neck.rotation": 35, "head.rotation": 35}, "right": {"neck.rotation": -35, "head.rotation": -35},
    "bent": {"neck.flexion": 20, "head.flexion": 10}, "bent and turned": {"neck.flexion": 25, "neck.rotation": 30},
}  # fmt: skip


def posed_neck(name: str, turn: str, **worn):
    """A seated person who holds the head so: the posed body, its surface, and the place in `PLACES` of each triangle."""
    body = clothed(name, **worn)
    q = seated()
    for axis, degrees in TURNS_DEG[turn].items():
        q[DOF_INDEX[axis]] = np.radians(degrees)
    posed = body.pose(q, np.eye(4))
    return posed, posed.surface(1), np.array([PLACES[k] for k in body.dressed.worn])


def bare_rays(name: str, turn: str, top: str) -> tuple[int, int]:
    """Of rays from above, beside and behind the neck, where a collar meets its top: how many meet skin, and how many are sent."""
    posed, surface, _ = posed_neck(name, turn, top=top)
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    skin = surface.material == MATERIAL_ID["skin"]
    root = posed.bones[BONES.index("neck01"), :3, 3]
    angle = np.concatenate([side * np.radians(np.linspace(65.0, 150.0, 18)) for side in (1, -1)])
    round_it = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    start = np.concatenate([root + round_it * reach + (0.0, 0.0, 0.5) for reach in (0.070, 0.078, 0.086, 0.095)])
    met = mesh.ray.intersects_first(start, np.tile((0.0, 0.0, -1.0), (len(start), 1)))
    on_neck = met >= 0
    labels = surface.label[met[on_neck]]
    head = np.isin(labels, [LABEL_ID[part] for part in ("head_left", "head_right")])
    return int((skin[met[on_neck]] & ~head).sum()), int((~head).sum())


@pytest.mark.parametrize("turn", TURNS_DEG)
@pytest.mark.parametrize("top", ["shirt", "turtleneck", "coat"])
@pytest.mark.parametrize("name", [MAN, WOMAN, "S07"])
def test_no_neck_shows_between_a_collar_and_its_top(name: str, top: str, turn: str) -> None:
    """Seen from above, beside and behind the neck, skin is nowhere outside of the collar, however the head is held."""
    bare, sent = bare_rays(name, turn, top)
    assert sent > 40
    assert bare == 0


@pytest.mark.parametrize("name", [MAN, WOMAN, "S05", "S07"])
def test_the_shirt_under_an_open_jacket_shows_between_its_fronts_alone(name: str) -> None:
    """From before the chest: in each row the shirt is one stretch, and none of it is seen through a front."""
    posed, surface, places = posed_neck(name, "ahead", top="open_jacket")
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    chest, hip = (posed.bones[BONES.index(bone), :3, 3] for bone in ("spine01", "pelvis"))
    rows = 0
    for share in np.linspace(0.25, 0.85, 13):
        middle = hip + share * (chest - hip)
        across = np.linspace(-0.17, 0.17, 120)
        start = np.stack([np.full(120, middle[0] + 1.0), middle[1] + across, np.full(120, middle[2])], axis=1)
        met = mesh.ray.intersects_first(start, np.tile((-1.0, 0.0, 0.0), (120, 1)))
        shirt = (met >= 0) & (places[met] == "inner")
        assert np.count_nonzero(np.diff(shirt.astype(int)) == 1) == 1
        rows += 1
    assert rows == 13
