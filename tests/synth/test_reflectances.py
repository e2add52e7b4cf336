"""What people and cars reflect in near infrared: drawn apart from their colours, by tables, and seen by the sensor as drawn."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest

from cabinpose.core import OCCUPANT_SLOTS, Camera, apply, invert, look_at
from cabinpose.scene import DYES, HAIR, LABEL_ID, MATERIAL_ID, MATERIALS, SKIN, SKIN_LIMITS, Coat, Surface, Wavelength
from cabinpose.scene.body import SUBJECTS, BodyModel, Outfit, Person, Phenotype, hair_shares
from cabinpose.scene.body.outfit import Bottom, Headwear, Top
from cabinpose.scene.sensor import GeometryBuffers, PhysicalNoise, material_table, sensor_by_name, simulate
from cabinpose.scene.things import make_thing
from cabinpose.store import AXES
from cabinpose.synth import FrameMaker, People, RandomPeople, SynthConfig
from cabinpose.synth.person_look import WORN, look_of, worn_faces
from cabinpose.synth.reflectances import Pattern, Print, Reflectances, SceneReflectance, _whole_cells
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.subjects import Subjects

LUMINANCE = np.array((0.2126, 0.7152, 0.0722))


@pytest.fixture(scope="module")
def man() -> Person:
    return BodyModel.load().person(Phenotype(), Outfit("t_shirt", "trousers", "leather", "short", headwear="cap"))


def drawn(man: Person, name: str, seed: int = 0, wavelength: Wavelength = 850) -> Mapping[str, float]:
    return Reflectances(seed, wavelength).person(name, man).reflectance


def test_garments_go_by_dye_and_not_by_colour(man: Person) -> None:
    """Of a few hundred black shirts most are bright and some are dark; some that are light to the eye are darker than these."""
    names = [f"N{k}" for k in range(250)]
    seen = np.array([LUMINANCE @ look_of(man, 0, name).colours["top"] for name in names])
    top = np.array([drawn(man, name)["top"] for name in names])
    black = seen < 0.06
    assert black.sum() > 50
    assert (top[black] > 0.4).mean() > 0.5
    assert 0.05 < (top[black] < 0.1).mean() < 0.4
    assert (top[seen > 0.06].min()) < np.median(top[black])
    assert (top[seen > 0.5] > 0.4).all(), "white cloth holds no carbon"
    assert abs(np.corrcoef(seen, top)[0, 1]) < 0.5


def test_what_is_drawn_is_in_its_tables(man: Person) -> None:
    for name in (f"N{k}" for k in range(60)):
        found, look = drawn(man, name), look_of(man, 0, name)
        assert set(found) == set(WORN)
        low, high = (min(band[k] for band in HAIR.values()) if k == 0 else max(b[1] for b in HAIR.values()) for k in (0, 1))
        assert low <= found["hair"] <= high
        assert SKIN_LIMITS[850][0] <= found["skin"] <= SKIN_LIMITS[850][1]
        for place, dyes in (("top", "cotton"), ("shoes", "leather_shoe"), ("top_print", "print")):
            eye = LUMINANCE @ look.colours[place]
            bands = [
                (max(d.low, eye) if d.to_the_eye else d.low, max(d.high, eye) if d.to_the_eye else d.high) for d in DYES[dyes]
            ]
            assert any(low - 1e-9 <= found[place] <= high + 1e-9 for low, high in bands), (name, place)


def test_skin_differs_less_than_in_colour_and_water_lowers_it_at_940(man: Person) -> None:
    names = [f"N{k}" for k in range(150)]
    near = np.array([[drawn(man, n, wavelength=w)["skin"] for n in names] for w in (850, 940)])
    seen = np.array([LUMINANCE @ look_of(man, 0, n).colours["skin"] for n in names])
    spread = [x.std() / x.mean() for x in (near[0], near[1], seen)]
    assert spread[1] < spread[0] < 0.5 * spread[2]
    assert near[1].mean() < 0.92 * near[0].mean()
    assert np.corrcoef(seen, near[0])[0, 1] > 0.5, "it is the same skin"
    light = [row.tone < 5 for row in SKIN]
    assert np.mean([r.at_940[0] / r.at_850[0] for r, pale in zip(SKIN, light, strict=True) if pale]) == pytest.approx(
        0.855, abs=0.01
    )


def test_dyed_hair_is_bright_and_black_hair_is_dark() -> None:
    """Hair of who is old is grey in near infrared, dyed or not; of who is young it goes by melanin."""
    model = BodyModel.load()
    young, old = (model.person(Phenotype(gender=1.0, age=age), Outfit()) for age in (0.45, 1.0))
    looks = {f"N{k}": look_of(old, 0, f"N{k}") for k in range(80)}
    dyed = [n for n, look in looks.items() if look.dyed and look.hair == "black" and look.grey > 0.8]
    assert len(dyed) > 5
    for name in dyed:
        assert looks[name].colours["hair"].max() < 0.02, "black to the eye"
        assert drawn(old, name)["hair"] > 0.4
        assert drawn(young, name)["hair"] <= 0.35
    assert 0.3 < np.mean([look.dyed for look in looks.values()]) < 0.7


def test_the_same_name_and_seed_give_the_same(man: Person) -> None:
    assert drawn(man, "N1") == drawn(man, "N1")
    assert drawn(man, "N1") != drawn(man, "N2")
    assert drawn(man, "N1") != drawn(man, "N1", seed=1)
    ratio = drawn(man, "N1", wavelength=940)["top"] / drawn(man, "N1")["top"]
    assert 0.99 <= ratio <= 1.11, "the same dye at both wavelengths"


def test_every_garment_has_its_triangles() -> None:
    for name in ("S01", "S02", "S13"):
        p = BodyModel.load().person(SUBJECTS[name].phenotype, SUBJECTS[name].outfit)
        look = look_of(p, 0, name)._replace(patterns={"top": "stripes", "bottom": ""})
        place = worn_faces(p, look)
        counts = {worn: int((place == k).sum()) for k, worn in enumerate(WORN)}
        for worn, part in (("top", p.outfit.top), ("bottom", p.outfit.bottom)):
            assert counts[worn] > 300, (name, worn, part)
        both = counts["top"] + counts["top_print"]
        assert 0.35 < counts["top_print"] / both < 0.65
        plain = worn_faces(p, look._replace(patterns={}))
        assert (plain == WORN.index("top")).sum() == both
        assert (counts["headwear"] > 100) == (p.outfit.headwear == "cap")
        assert (plain[p.dressed.material == MATERIAL_ID["skin"]] == WORN.index("skin")).all()


TOPS, BOTTOMS, HEADWEAR = get_args(Top), get_args(Bottom), get_args(Headwear)
EACH = [(top, BOTTOMS[k % len(BOTTOMS)], HEADWEAR[k % len(HEADWEAR)]) for k, top in enumerate(TOPS)]
# Each top with each bottom and each headwear, each bottom with each headwear.
PAIRS = [(top, bottom, HEADWEAR[(k + n) % len(HEADWEAR)]) for k, top in enumerate(TOPS) for n, bottom in enumerate(BOTTOMS)]
CLOTH = [MATERIAL_ID[name] for name in ("cotton", "denim", "wool", "synthetic_fabric")]
ON = {"top": "upper_arm", "bottom": "thigh", "headwear": "headwear"}  # where no other garment is


@pytest.mark.parametrize("made", [EACH, pytest.param(PAIRS, marks=pytest.mark.slow)], ids=["each", "pairs"])
def test_what_is_drawn_reflects_as_its_label_says(made: list[tuple[Any, Any, Any]]) -> None:
    """Of every top, bottom and headwear, whose triangles are known by the part of the body that they lie on."""
    seen = {name: np.isin(np.arange(256), [LABEL_ID[k] for k in LABEL_ID if k.startswith(part)]) for name, part in ON.items()}
    somebody, checked = BodyModel.load().person(Phenotype(gender=1.0), Outfit()), set()
    for top, bottom, headwear in made:
        outfit = Outfit(top, bottom, "trainers", "long", headwear=headwear)
        person = somebody.redressed(outfit)
        found = Reflectances(4, 850).person("N1", person)
        told = dict(zip(AXES["worn"], found.labels(outfit, 850), strict=True))
        cloth = np.isin(person.dressed.material, CLOTH) & (found.faces != 255)
        for place, name in (("top", top), ("bottom", bottom), ("headwear", headwear)):
            if name == "none":
                assert np.isnan(told[place])
            elif not (place == "bottom" and top == "coat"):  # whose tails hang over it
                codes = {WORN[k] for k in found.faces[cloth & seen[place][person.dressed.label]]}
                drawn_as = {found.reflectance[code] for code in codes if not code.endswith("_print")}
                assert drawn_as == {told[place]}, (outfit, place, codes)
                checked.add((place, name))
    assert len(checked) == 9 + 6 + 5


CAR: Mapping[str, Any] = {
    "scene": {"cars": ["sedan"], "occupancy": {"driver": 1.0, "front_passenger": 1.0}},
    "people": {"subjects": ["S01", "S02", "S09"]},
    "camera": {"sensor": {"camera": {"width": 176, "height": 144, "fov_deg": 95}}, "views": {"front_row": 1.0}},
    "noise": {
        "kind": "physical", "shot_noise": False, "read_noise": False, "flying_pixels": False, "blur": 0.0, "stray_light": 0.0,
        "ambient": 0.0, "daylight": 0.0, "wiggling": 0.0, "range_window": False, "low_amplitude": False, "full_well": False,
    },
}  # fmt: skip


def test_amplitudes_are_those_of_the_labels() -> None:
    """From amplitude, depth and incidence each person's reflectance follows, which the label states."""
    maker = FrameMaker(SynthConfig.parse(CAR), 3)
    frame, scene = maker.make(0)
    sensor = maker.config.camera.sensor_model
    rendered = maker._rasteriser.render(
        maker._reflectances.of(scene, scene.surface()).surface, np.linalg.inv(scene.world_from_camera), closed=scene.closed
    )
    ratio = sensor.camera.range_over_depth
    light = sensor.signal_e * sensor.contrast * (1 / ratio) ** (sensor.vignetting_exponent + sensor.illumination_exponent)
    r = frame["depth_clean"] * ratio
    with np.errstate(divide="ignore", invalid="ignore"):
        reflectance = frame["amplitude"] * r**2 / light / rendered.buffers.cos_incidence
    checked, start = 0, len(scene.backdrop.faces)
    for who in scene.people:
        row = OCCUPANT_SLOTS.index(who.slot)
        place = worn_faces(who.person, look_of(who.person, 3, who.subject))
        face = rendered.face_id - start
        of_body = (face >= 0) & (face < len(place))
        worn = np.where(of_body, place[np.where(of_body, face, 0)], 255)
        assert (rendered.instance[of_body] == row + 1).all()
        for name in ("top", "bottom", "hair"):
            where = (worn == WORN.index(name)) & (rendered.buffers.cos_incidence > 0.4) & (frame["amplitude"] > 30)
            if where.sum() > 60:
                told = float(np.array(frame["reflectance"])[row, AXES["worn"].index(name)])
                assert np.median(reflectance[where]) == pytest.approx(told, rel=0.03)
                checked += 1
        start += sum(len(each.faces) for each in who.surfaces)
    assert checked >= 3


def test_the_dyes_of_car_and_things_are_on_these_alone() -> None:
    """A toddler seat of plastic and cloth in a car of both: each surface reflects as the dye that was drawn for it, in a band."""
    scene_of = {"cars": ["sedan"], "occupancy": {"driver": 1.0}, "child_seats": {"rear_left": "toddler"}, "clutter": 0}
    maker = FrameMaker(SynthConfig.parse({"scene": scene_of}), 0)
    _, scene = maker.make(0)
    surface = scene.surface()
    found = maker._reflectances.of(scene, surface)
    reflects = material_table(True, True, 0.0, 0.0, 850, found.coats)[found.surface.material, 0]
    of_car = np.arange(len(surface.faces)) < len(scene.backdrop.faces)
    ((thing, *_),) = scene.things
    start = len(surface.faces) - len(thing.surface.faces) - sum(len(each.faces) for each in scene.fastenings)
    of_thing = np.zeros(len(surface.faces), bool)
    of_thing[start : start + len(thing.surface.faces)] = True
    dyed = [name for name in DYES if (thing.surface.material == MATERIAL_ID.get(name, 0)).any()]
    assert "hard_plastic" in dyed
    for name in dyed:
        here = of_thing & (surface.material == MATERIAL_ID[name])
        values = {float(value) for value in reflects[here]}
        assert len(values) == 1
        assert any(d.low - 1e-6 <= min(values) <= max(d.high, 0.9 * d.to_the_eye) for d in DYES[name])
    plastic = surface.material == MATERIAL_ID["hard_plastic"]
    assert len(set(reflects[of_car & plastic])) == 1
    assert set(reflects[of_car & plastic]) != set(reflects[of_thing & plastic])
    undyed = ~np.isin(surface.material, [MATERIAL_ID.get(name, 0) for name in DYES])
    table = {material.id: material.reflectance for material in MATERIALS}
    np.testing.assert_allclose(reflects[of_thing & undyed], [table[m] for m in surface.material[of_thing & undyed]], rtol=1e-6)


def test_covers_of_things_are_black_to_some_cameras_and_bright_to_others() -> None:
    """Over seeds, child seats' cloth takes the shares of its dyes."""
    thing = make_thing("toddler", 0)
    cloth = MATERIAL_ID["seat_fabric"]
    found = [
        {coat.material: coat.reflectance for coat in Reflectances(seed, 850)._draw_thing(thing)}[cloth] for seed in range(200)
    ]
    assert 0.1 < np.mean(np.array(found) < 0.09) < 0.4
    assert np.mean(np.array(found) > 0.34) > 0.5


def test_prints_have_borders_as_fine_as_pixels() -> None:
    """A striped cloth, half as wide and shifted as it is worn: each pixel goes by its place at rest, whole triangles too."""
    across, up = np.meshgrid(np.linspace(0.4, -0.4, 21), np.linspace(-0.3, 0.3, 31))
    corners = np.stack((np.ones(across.size), across.ravel(), up.ravel()), axis=1).astype(np.float32)
    first = (21 * np.arange(30)[:, None] + np.arange(20)).reshape(-1, 1)
    faces = np.concatenate((first + [[0, 1, 22]], first + [[0, 22, 21]])).astype(np.int32)
    cloth, code = 66, 71
    none, material = np.zeros(len(faces), np.uint8), np.where(np.arange(len(faces)) % 2, cloth, code).astype(np.uint8)
    surface = Surface(corners, np.tile(np.array((-1, 0, 0), np.float32), (len(corners), 1)), faces, none, material, none)
    rest = corners * (1.0, 0.5, 0.5) + (0.0, 0.0, 0.013)
    pattern = Pattern("top", "stripes", _whole_cells("stripes", rest[faces]), rest[faces])
    assert 0.1 < (pattern.faces > -100).mean() < 0.9, "some are in one stripe"
    found = SceneReflectance(surface, (), {}, (Print(cloth, code, 0, pattern),))
    assert (found.plain.material == cloth).all()
    camera = Camera.from_fov(120, 100, 1.0)
    world_from_camera = look_at((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    seen = Rasteriser(camera, 2).render(found.plain, invert(world_from_camera))
    buffers = found.printed(seen, camera, world_from_camera)
    points = apply(world_from_camera, camera.points(seen.depth_clean).reshape(-1, 3)).reshape(100, 120, 3)
    height = points[..., 2] * 0.5 + 0.013
    sure = (seen.face_id >= 0) & (np.abs(height / 0.04 - np.rint(height / 0.04)) > 0.01)
    expected = np.where(np.floor(height / 0.04) % 2 == 1, code, cloth)
    assert sure.sum() > 3000
    np.testing.assert_array_equal(buffers.material[sure], expected[sure])
    pixels = buffers.material.reshape(-1)[buffers.mixed]
    assert np.isin(code, buffers.parts_material)
    assert ((buffers.parts_material == pixels[:, None]) | ~np.isin(buffers.parts_material, (cloth, code))).all(
        where=(pixels > 0)[:, None]
    )


def test_coats_stand_in_place_of_materials_and_wavelengths_choose_columns() -> None:
    plain = material_table(True, True, 0.1, 1.0)
    assert plain[MATERIAL_ID["skin"], 0] == pytest.approx(0.543)
    assert material_table(True, True, 0.1, 1.0, 940)[MATERIAL_ID["skin"], 0] == pytest.approx(0.469)
    coated = material_table(True, True, 0.1, 1.0, 850, (Coat(70, MATERIAL_ID["seat_leather"], 0.06), Coat(8, 8, 0.4)))
    assert coated[70].tolist() == pytest.approx([0.06, 0.04 / (4 * 0.32**2), 0.006, 1 / 0.32**2])
    assert coated[8, 0] == pytest.approx(0.4)
    others = np.delete(np.arange(256), (8, 70))
    np.testing.assert_array_equal(coated[others], plain[others])
    assert all(m.id < 64 for m in MATERIALS)


@pytest.mark.parametrize("name", ["hard_plastic", "leather_shoe", "metal"])
def test_smooth_surfaces_shine_where_they_face_the_camera(name: str) -> None:
    """The kernel's lobe against Beckmann's facets of Walter et al. (2007), which it follows to first order."""
    sensor = sensor_by_name("pico_monstar_105/4").model_copy(update={"vignetting_exponent": 0.0, "illumination_exponent": 0.0})
    material = MATERIALS[[m.name for m in MATERIALS].index(name)]
    alpha, fresnel = material.roughness, 0.64 if name == "metal" else 0.04
    assert alpha is not None
    shape = (sensor.camera.height, sensor.camera.width)
    angle = np.linspace(0, 0.3 * alpha, shape[1])
    cosine = np.broadcast_to(np.cos(angle), shape).astype(np.float32)
    depth = (2.0 / sensor.camera.range_over_depth).astype(np.float32)
    scene = GeometryBuffers.dense(1, depth, cosine, np.full(shape, material.id, np.uint8))
    quiet = PhysicalNoise().model_copy(update={k: v for k, v in CAR["noise"].items() if k != "kind"})
    bright = sensor.model_copy(update={"signal_e_per_s": 6e7})
    seen = simulate(scene, bright, quiet, rng=np.random.default_rng(0)).amplitude[140].astype(float)
    facets = np.exp(-(np.tan(angle) ** 2) / alpha**2) / (np.pi * alpha**2 * np.cos(angle) ** 4)
    white = np.pi * fresnel * facets / (4 * np.cos(angle))  # of the light of a white surface
    expected = (material.reflectance * np.cos(angle) + white) * bright.signal_e * bright.contrast / 4.0
    ok = seen > 0
    assert ok.sum() > 200
    np.testing.assert_allclose(seen[ok], expected[ok], rtol=0.03)


def test_what_is_in_rooms_is_of_its_material() -> None:
    found = Reflectances(0, 850)
    surface = SimpleNamespace(faces=np.zeros((5, 3), np.int32), material=np.full(5, MATERIAL_ID["painted_wall"], np.uint8))
    scene: Any = SimpleNamespace(cabin=None, things=(), people=(), backdrop=surface, place="room")
    whole = Surface(*np.zeros((2, 1, 3), np.float32), surface.faces, *np.repeat(surface.material[None], 3, axis=0))
    assert found.of(scene, whole).coats == ()
    np.testing.assert_array_equal(found.of(scene, whole).surface.material, surface.material)


def test_hair_is_worn_by_sex_and_age() -> None:
    """Of a crowd, against the shares themselves and what sets them apart: long hair is women's, baldness old men's."""
    crowd = Subjects(People(subjects=(), random=RandomPeople(count=600)), 2)
    bodies = [crowd.body(f"R{k:04d}") for k in range(600)]
    men = [(p, o) for p, o in bodies if p.gender < 0.5]
    women = [(p, o) for p, o in bodies if p.gender > 0.5]

    def share(people: list[tuple[Phenotype, Outfit]], *styles: str) -> float:
        return float(np.mean([o.hair in styles for _, o in people]))

    assert share(men, "short") > 0.55
    assert share(women, "short") < 0.3
    assert share(women, "long", "bun") > 0.35 > 0.15 > share(men, "long", "bun")
    assert share(women, "bald") == 0.0
    old = [(p, o) for p, o in men if p.years > 60]
    expected = float(np.mean([hair_shares(p.gender, p.years)["bald"] for p, _ in old]))
    assert share(old, "bald") == pytest.approx(expected, abs=3 * np.sqrt(expected * (1 - expected) / len(old)))
    assert sum(hair_shares(0.3, 50.0).values()) == pytest.approx(1.0)
