"""Colour and near-infrared pictures against closed forms, the labels of the z-buffer, and themselves."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from PIL import Image as PilImage
from render_scenes import BARREL, ball, cabin_view, people_in_cars, person, room, small_camera, surface

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError, DependencyError
from cabinpose.core.frames import invert, look_at
from cabinpose.scene.labels import LABEL_ID as LABEL
from cabinpose.scene.materials import MATERIAL_ID, MATERIALS
from cabinpose.scene.sensor import SENSORS, material_table
from cabinpose.scene.surface import Surface, merge
from cabinpose.store import open_dataset
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.frame_maker import FrameMaker
from cabinpose.synth.generate import generate
from cabinpose.synth.person_look import look_of
from cabinpose.synth.pictures.denoise import denoised
from cabinpose.synth.pictures.grid import grid_of, hits, without_panes
from cabinpose.synth.pictures.light import Light, dome_directions, draw_light
from cabinpose.synth.pictures.look import near_infrared, person_colours
from cabinpose.synth.pictures.maker import PictureMaker, develop, shaded
from cabinpose.synth.pictures.path_tracing import trace
from cabinpose.synth.pictures.settings import Images
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import own_rng

Array = NDArray[np.float64]
PINHOLE = (0.0, 0.0, 0.0, 0.0, 0.0)
PRIMARY = np.eye(3, dtype=np.float32)[[2, 0, 1]] * np.float32(0.7)  # nobody blue, the first person red, the second green
DARK = Light("night", "", np.zeros((4, 8, 3), np.float32))
GREY = Light("day", "", np.full((4, 8, 3), 0.5, np.float32))
SMALL = SENSORS["evk75023"].model_copy(update={"camera": Camera.from_fov(44, 36, np.deg2rad(90))})


@pytest.fixture
def path_tracer() -> None:
    pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'cabinpose[rgb]'")


def plane(reflectance: float) -> tuple[Surface, NDArray[np.float32]]:
    """A wall 20 m wide at x = 1 that faces the origin, and its colour."""
    mesh = trimesh.Trimesh([(1, -10, -10), (1, 10, -10), (1, 10, 10), (1, -10, 10)], [(0, 2, 1), (0, 3, 2)], process=False)
    made = surface(mesh, material="cotton")
    return made, np.full((len(made.faces), 3), reflectance, np.float32)


def traced(
    scene: Surface, colours: NDArray[np.float32], camera: Camera, world_from_camera: Array, light: Light, *, samples: int = 4,
    own: float = 0.0,
) -> Array:  # fmt: skip
    grid = grid_of(camera)
    fine = trace(scene, colours, grid.pinhole, world_from_camera, replace(light, own=own), samples=samples, seed=5)
    return grid.mean(fine)


def away_from_edges(image: NDArray[np.generic]) -> NDArray[np.bool_]:
    """(H, W) pixels all of whose eight neighbours have the same value."""
    same = np.ones(image.shape, bool)
    for down in (-1, 0, 1):
        for across in (-1, 0, 1):
            same &= np.roll(image, (down, across), (0, 1)) == image
    same[[0, -1]] = same[:, [0, -1]] = False
    return same


@pytest.mark.parametrize("dist", [PINHOLE, BARREL], ids=["pinhole", "barrel"])
def test_a_grid_sees_every_pixel_and_shares_its_area(dist: tuple[float, float, float, float, float]) -> None:
    camera = replace(small_camera(dist), cx=80.3, cy=66.9)
    grid = grid_of(camera)
    seen = np.isfinite(camera.rays).all(axis=-1)
    edge = ~away_from_edges(seen)
    assert (grid.count.reshape(seen.shape)[seen & ~edge] >= 4).all()
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    ideal = grid.mean(grid.pinhole.rays.reshape(-1, 2))
    at = camera.distort(ideal) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    inner = seen & ~edge
    assert np.abs(at - np.stack((u, v), axis=-1))[inner].max() < 0.3  # px: the mean of the samples is the pixel's centre
    assert np.abs((at - np.stack((u, v), axis=-1))[inner].mean(axis=0)).max() < 0.01


@pytest.mark.parametrize(
    ("dist", "renderer"),
    [
        (PINHOLE, "path_traced"),
        (BARREL, "raster"),
        *(pytest.param(*both, marks=pytest.mark.slow) for both in ((PINHOLE, "raster"), (BARREL, "path_traced"))),
    ],
    ids=["pinhole-path_traced", "barrel-raster", "pinhole-raster", "barrel-path_traced"],
)
def test_silhouettes_are_those_of_the_instance_image(
    dist: tuple[float, float, float, float, float], renderer: str, request: pytest.FixtureRequest
) -> None:
    """Everybody in a colour that reflects nothing of the others', so that light from one to another stays black."""
    scene, view, _ = next(people_in_cars())
    camera = replace(small_camera(dist), cx=80.3, cy=66.9)
    panes = ~without_panes(scene)
    opaque = replace(scene, faces=scene.faces[~panes], label=scene.label[~panes], material=scene.material[~panes],
                     instance=scene.instance[~panes])  # fmt: skip
    truth = Rasteriser(camera).render(opaque, view)
    colours = PRIMARY[scene.instance]
    if renderer == "path_traced":
        request.getfixturevalue("path_tracer")
        image = traced(scene, colours, camera, invert(view), DARK, own=1.0)
    else:
        grid = grid_of(camera)
        found = hits(Rasteriser(grid.pinhole, 1), scene, without_panes(scene), invert(view))
        image = grid.mean(shaded(found, colours[found.face], replace(DARK, own=1.0)))
    seen = truth.face_id >= 0
    who = np.array([1, 2, 0])[np.nan_to_num(image).argmax(axis=-1)]
    inner = seen & away_from_edges(truth.instance)
    assert inner.mean() > 0.4
    assert (truth.instance[inner] == 2).sum() > 100
    assert (who == truth.instance)[inner].mean() >= 0.999
    assert (who == truth.instance)[seen].mean() >= 0.99  # edges included


@pytest.mark.usefixtures("path_tracer")
@pytest.mark.parametrize("dist", [PINHOLE, BARREL], ids=["pinhole", "barrel"])
def test_edges_lie_where_the_lens_images_them_to_a_part_of_a_pixel(dist: tuple[float, float, float, float, float]) -> None:
    """Black balls before a white sky: what is missing of a pixel's light is the share of it that they cover."""
    camera = Camera(80, 60, 40.0, 43.0, 35.3, 22.9, dist)
    balls = merge([ball((1, 0.1, -0.1), 0.2), ball((1, -0.4, 0), 0.1)])
    pose = look_at((0, 0, 0), (1, 0, 0))
    sky = replace(GREY, dome=2 * GREY.dome)
    covered = 1.0 - traced(balls, np.zeros((len(balls.faces), 3), np.float32), camera, pose, sky, samples=64)[..., 0]
    fine = Rasteriser(camera.scaled(8)).render(balls, invert(pose)).face_id >= 0
    truth = fine.reshape(60, 8, 80, 8).mean(axis=(1, 3))
    edge = (truth > 0) & (truth < 1)
    assert np.nanmean(np.abs(covered - truth)[edge]) < 0.1  # samples of half a pixel count to one pixel whole
    assert np.nanmax(np.abs(covered - truth)[~edge]) < 0.15
    places = np.argwhere(np.ones(truth.shape))
    middle = [(places * x.reshape(-1, 1)).sum(axis=0) / x.sum() for x in (np.nan_to_num(covered), truth)]
    assert np.abs(middle[0] - middle[1]).max() < 0.02  # px


@pytest.mark.usefixtures("path_tracer")
def test_a_wall_by_a_light_at_the_camera_has_the_radiance_of_the_law() -> None:
    """Lambert: rho cos / r^2 in units of white at 1 m."""
    wall, colour = plane(0.6)
    camera = small_camera()
    image = traced(wall, colour, camera, look_at((0, 0, 0), (1, 0, 0)), DARK, own=2.0)
    r = camera.range_over_depth  # the wall is at depth 1
    np.testing.assert_allclose(image, (0.6 * 2.0 / r**3)[..., None].repeat(3, axis=-1), rtol=0.02)
    assert np.abs(image[..., 1] * r**3 / 1.2 - 1).mean() < 0.002


@pytest.mark.slow
@pytest.mark.usefixtures("path_tracer")
def test_a_wall_under_an_even_sky_has_its_reflectance_of_the_skys_radiance() -> None:
    wall, colour = plane(0.6)
    image = traced(wall, colour, small_camera(), look_at((0, 0, 0), (1, 0, 0)), GREY, samples=16)
    assert abs(image.mean() / (0.6 * 0.5) - 1) < 0.005
    opaque = replace(wall, material=np.full_like(wall.material, 14))  # the same as a pane: the sky behind it
    np.testing.assert_allclose(traced(opaque, colour, small_camera(), look_at((0, 0, 0), (1, 0, 0)), GREY), 0.5, rtol=1e-5)


@pytest.mark.usefixtures("path_tracer")
def test_the_sun_lights_a_wall_by_the_cosine_from_where_it_stands() -> None:
    wall, colour = plane(0.5)
    for towards in (np.array((-1.0, 0, 0)), np.array((-0.6, 0.0, 0.8)), np.array((0.6, 0.0, 0.8))):
        light = replace(DARK, sun=(towards, np.array((3.0, 2.0, 1.0))))
        image = traced(wall, colour, small_camera(), look_at((0, 0, 0), (1, 0, 0)), light)
        expected = 0.5 / np.pi * np.array((3.0, 2.0, 1.0)) * max(-towards[0], 0.0)
        np.testing.assert_allclose(image, np.broadcast_to(expected, image.shape), rtol=1e-4, atol=1e-7)


@pytest.mark.usefixtures("path_tracer")
def test_the_dome_stands_as_it_is_painted_for_both_renderers() -> None:
    """Its colour is a smooth function of the direction, looked up where rays go."""
    directions = dome_directions(64, 128)
    light = replace(DARK, dome=(0.5 + 0.5 * directions).astype(np.float32))
    far = ball((0, 0, -50.0), 0.1)
    camera = small_camera()
    for target in ((1, 0, 0), (0, 1, 0), (-1, -1, 0.3)):
        pose = look_at((0, 0, 0), target)
        rays = np.concatenate((camera.rays, np.ones((*camera.rays.shape[:2], 1))), axis=-1) @ pose[:3, :3].T
        expected = 0.5 + 0.5 * rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        seen = traced(far, np.ones((len(far.faces), 3), np.float32), camera, pose, light)
        np.testing.assert_allclose(seen, expected, atol=0.01)
        np.testing.assert_allclose(light.seen(rays), expected, atol=0.04)


@pytest.mark.slow
def test_denoising_keeps_light_colours_and_edges_and_takes_noise_away() -> None:
    camera = small_camera(BARREL)
    grid = grid_of(camera)
    scene = merge([room(subdivide=2), person(1)])
    pose = invert(cabin_view())
    found = hits(Rasteriser(grid.pinhole, 1), scene, without_panes(scene), pose)
    rng = np.random.default_rng(2)
    albedo = rng.uniform(0.2, 0.8, (len(scene.faces), 3))[found.face]
    clean = albedo * np.where(scene.instance[found.face] > 0, 2.0, 1.0)[:, None]
    noisy = clean * rng.gamma(1.0, 1.0, (len(clean), 1))
    before, after, truth = (grid.mean(x) for x in (noisy, denoised(noisy, albedo, found, grid), clean))
    lit = truth > 0
    error = [np.sqrt(np.nanmean(((x - truth) / np.where(lit, truth, 1))[lit] ** 2)) for x in (before, after)]
    assert error[0] > 0.3
    assert error[1] < 0.35 * error[0]
    assert abs(np.nansum(after) / np.nansum(truth) - 1) < 0.02
    untouched = denoised(clean, albedo, found, grid)
    assert np.isclose(grid.mean(untouched), truth, rtol=1e-6)[lit].mean() > 0.9999


@pytest.mark.parametrize("renderer", ["path_traced", "raster"])
def test_near_infrared_counts_the_electrons_of_the_sensor_model(renderer: Any, request: pytest.FixtureRequest) -> None:
    if renderer == "path_traced":
        request.getfixturevalue("path_tracer")
    wall, _ = plane(1.0)
    scene = Scene(wall, (), look_at((0, 0, 0), (1, 0, 0)), "somewhere", "view")
    maker = PictureMaker(Images(variables=("nir",), renderer=renderer, samples=16, light="night"), SMALL, 0)
    cotton = MATERIALS[MATERIAL_ID["cotton"]].reflectance
    rng = np.random.default_rng(0)
    taken = maker.take(scene, wall, np.full((len(wall.faces), 3), cotton, np.float32), rng=rng, lit=rng)
    assert set(taken) == {"nir", "light", "renderer"}
    assert taken["nir"].dtype == np.uint16
    r = SMALL.camera.range_over_depth
    vignetting = (1 / r) ** SMALL.vignetting_exponent
    expected = cotton * SMALL.signal_e / r**3 * vignetting
    ratio = taken["nir"] / expected
    assert abs(ratio.mean() - 1) < 0.01
    assert 0.3 < (ratio.std() / np.sqrt((1 / expected).mean())) < 3  # photon noise


def test_reflectances_of_the_near_infrared_are_the_sensors() -> None:
    scene = merge([room(), person(1)])
    table = {m.id: m.reflectance for m in MATERIALS}
    found = near_infrared(scene, material_table(True, False, 0.0, 0.0))[:, 1]
    np.testing.assert_allclose(found, [table[m] for m in scene.material.tolist()])


def test_people_keep_their_looks_and_differ() -> None:
    from cabinpose.scene.body import SUBJECTS, BodyModel

    model = BodyModel.load()
    people = {name: model.person(s.phenotype, s.outfit) for name, s in list(SUBJECTS.items())[:3]}
    looks = {name: person_colours(p, look_of(p, 4, name), rng=own_rng(4, name)) for name, p in people.items()}
    for name, p in people.items():
        np.testing.assert_array_equal(looks[name], person_colours(p, look_of(p, 4, name), rng=own_rng(4, name)))
        assert looks[name].shape == (len(p.dressed.faces), 3)
        assert 0 <= looks[name].min() <= looks[name].max() <= 0.9
    skins = [np.median(looks[n][(p.dressed.material == 1)], axis=0) for n, p in people.items()]
    assert all(np.abs(a - b).max() > 0.01 for k, a in enumerate(skins) for b in skins[k + 1 :])


@pytest.mark.parametrize("number", range(3))
def test_eyes_lips_and_mouths_have_colours_of_what_they_are(number: int) -> None:
    """Whites of eyes are brighter than irises, those than pupils; lips are redder than skin, mouths red, brows as hair."""
    from cabinpose.scene.body import SUBJECTS, BodyModel

    p = BodyModel.load().person(*SUBJECTS["S02"])
    colours = person_colours(p, look_of(p, number, "x"), rng=own_rng(number, "x"))
    of = {m.name: colours[p.dressed.material == m.id] for m in MATERIALS}
    eye, iris, pupil, mouth = (np.median(of[name], axis=0) for name in ("eye", "iris", "pupil", "mouth"))
    assert eye.min() > 1.2 * iris.max()
    assert iris.max() > 2.0 * pupil.max()
    assert mouth[0] > 2.0 * mouth[1:].max()
    lips, skin = (np.median(colours[(p.dressed.material == 1) & (p.dressed.is_lip == lip)], axis=0) for lip in (True, False))
    assert lips[0] / lips[1] > 1.2 * skin[0] / skin[1]
    hair = of["hair"] / np.median(of["hair"], axis=0)
    assert np.ptp(hair, axis=0).max() < 0.11  # brows and the head's


def test_garments_have_one_colour_each() -> None:
    from cabinpose.scene.body import PLACES, BodyModel, Outfit, Phenotype

    p = BodyModel.load().person(Phenotype(), Outfit(top="t_shirt", bottom="trousers"))  # both cotton
    look = look_of(p, 0, "x")._replace(patterns={})
    colours = person_colours(p, look, rng=own_rng(0, "x"))
    cotton = p.dressed.material == 3
    is_top = p.dressed.worn == PLACES.index("top")
    top, rest = colours[cotton & is_top], colours[cotton & ~is_top]
    assert min(len(top), len(rest)) > 500
    assert np.ptp(top / top.mean(axis=0), axis=0).max() < 0.11
    assert np.abs(np.median(top, axis=0) - np.median(rest, axis=0)).max() > 0.02


@pytest.mark.parametrize("kind", ["day", "night", "garage"])
def test_lights_are_drawn_from_the_seed(kind: Any) -> None:
    first, again, other = (draw_light(kind, np.zeros(3), rng=np.random.default_rng(s)) for s in (1, 1, 2))
    assert first.kind == kind
    np.testing.assert_array_equal(first.dome, again.dome)
    assert (first.dome != other.dome).any()
    assert 0 <= first.dome.min() <= first.dome.max() < 1e3


def test_developing_follows_srgb_and_keeps_order() -> None:
    ramp = np.repeat(np.linspace(0, 1, 256)[None, :, None], 3, axis=-1)
    seen = develop(ramp, 0.2)
    assert (np.diff(seen[0, :, 0].astype(int)) >= 0).all()
    assert seen[0, 0, 0] == 0
    assert seen[0, -1, 0] > 150
    np.testing.assert_array_equal(develop(7.0 * ramp, 0.2), seen)
    assert not develop(np.zeros((2, 2, 3)), 0.2).any()


def _config(**images: Any) -> SynthConfig:
    sensor = SMALL.model_dump(mode="json")
    return SynthConfig.parse({"camera": {"sensor": sensor}, "images": images, "output": {"frames_per_part": 2}})


@pytest.fixture(scope="module")
def pictured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames of seed 7 with both pictures as previews, made by one worker; read only."""
    folder = tmp_path_factory.mktemp("pictured") / "data"
    generate(_config(variables=["rgb", "nir"], renderer="raster", samples=4), 3, folder, workers=1, seed=7)
    return folder


@pytest.mark.parametrize("renderer", [pytest.param("path_traced", marks=pytest.mark.slow), "raster"])
def test_datasets_have_the_same_bytes_whatever_the_workers(renderer: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    config = _config(variables=["rgb", "nir"], renderer=renderer, samples=4)
    if renderer == "path_traced":
        request.getfixturevalue("path_tracer")
        generate(config, 3, one := tmp_path / "1", workers=1, seed=7)
    else:
        one = request.getfixturevalue("pictured")
    generate(config, 3, two := tmp_path / "2", workers=2, seed=7)
    files = [{p.relative_to(out): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()} for out in (one, two)]
    assert files[0] == files[1]
    dataset = open_dataset(one)
    assert dataset.rgb.shape == (3, 36, 44, 3)
    assert dataset.nir.shape == (3, 36, 44)
    assert min(dataset.rgb.values.std(), dataset.nir.values.std()) > 10
    said = set(dataset.renderer.values.tolist())
    assert said == {"raster preview"} if renderer == "raster" else "mitsuba" in said.pop()
    assert all(text.split(":")[0] in {"day", "night", "garage"} for text in dataset.light.values.tolist())


def test_pictures_change_nothing_else(pictured: Path, tmp_path: Path) -> None:
    without = _config().model_copy(update={"images": None})
    generate(without, 3, tmp_path / "without", workers=1, seed=7)
    assert "images" not in without.model_dump()
    assert "images" not in (tmp_path / "without" / "dataset.yaml").read_text()
    seen, plain = open_dataset(pictured), open_dataset(tmp_path / "without")
    assert not {"rgb", "nir", "light", "renderer"} & set(plain.variables)
    for name in plain.variables:
        np.testing.assert_array_equal(seen[name].values, plain[name].values)


@pytest.mark.slow
def test_things_have_colours_of_their_own(tmp_path: Path) -> None:
    """A cardboard box is brown: red before green before blue, in every pixel of it."""
    scene = {"cars": ["sedan"], "occupants": {"driver": {"subject": "S03"}}, "objects": {"rear_center": {"box": 1.0}}}
    config = SynthConfig.parse({"scene": scene, "camera": {"views": {"rear": 1.0}}, "images": {"renderer": "raster"}})
    generate(config, 1, tmp_path / "data", workers=1)
    frame = open_dataset(tmp_path / "data").isel(frame=0)
    box = frame["labels"].values == LABEL["box"]
    assert box.sum() > 100
    red, green, blue = np.moveaxis(frame["rgb"].values[box].astype(int), -1, 0)
    assert (red > green).mean() > 0.9
    assert (green > blue).mean() > 0.9


def test_view_and_exports_show_the_pictures_and_say_what_made_them(pictured: Path, tmp_path: Path) -> None:
    from cabinpose.app.cli import main

    data = pictured
    for command in (
        f"view {data} --out {tmp_path / 'view'}",
        f"export {data} --format png-json --out {tmp_path / 'png'}",
        f"export {data} --format coco --images rgb --out {tmp_path / 'coco'}",
    ):
        assert not main(command.split())
    dataset = open_dataset(data)
    first = next(iter(sorted((tmp_path / "coco" / "images").iterdir())))
    np.testing.assert_array_equal(np.asarray(PilImage.open(first)), dataset.rgb[0].values)
    for name in ("rgb", "nir"):
        written = np.asarray(PilImage.open(next(iter(sorted((tmp_path / "png" / name).iterdir())))))
        np.testing.assert_array_equal(written, dataset[name][0].values)
    told = json.loads((tmp_path / "coco" / "annotations" / "person_keypoints.json").read_text())["images"][0]
    pose = json.loads(next(iter(sorted((tmp_path / "png" / "pose").iterdir()))).read_text())
    page = (tmp_path / "view" / "index.html").read_text()
    assert told["renderer"] == pose["renderer"] == "raster preview"
    assert told["light"] == pose["light"] == dataset.light[0].item()
    assert '"renderer":"raster preview"' in page
    sheet = np.asarray(PilImage.open(tmp_path / "view" / "contact_sheet.png"))
    panel = dataset.rgb[0].values.repeat(6, axis=0).repeat(6, axis=1)
    assert _contains(sheet, panel)


def _contains(sheet: NDArray[np.uint8], panel: NDArray[np.uint8]) -> bool:
    places = np.argwhere((sheet == panel[0, 0]).all(axis=-1))
    return any(np.array_equal(sheet[y : y + panel.shape[0], x : x + panel.shape[1]], panel) for y, x in places.tolist())


def test_path_tracing_without_mitsuba_stops_before_it_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from cabinpose.app.cli import main

    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(DependencyError, match="mitsuba"):
        PictureMaker(Images(), SMALL, 0)
    with pytest.raises(SystemExit) as stopped:
        raise SystemExit(main(["synth", "--frames", "1", "--out", str(tmp_path / "out"), "images={}"]))
    said = capsys.readouterr().err
    assert stopped.value.code == 2
    assert "mitsuba" in said
    assert "pip install 'cabinpose[rgb]'" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "images", [{"variables": ["rgb", "rgb"]}, {"variables": []}, {"variables": ["red"]}, {"renderer": "blender"}, {"samples": 0},
               {"light": "dusk"}, {"spp": 4}],
)  # fmt: skip
def test_what_cannot_be_is_refused(images: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        SynthConfig.parse({"images": images})


@pytest.mark.slow
def test_a_sequence_is_in_one_light() -> None:
    sequence, sensor = {"frames": 2, "rate_hz": 10, "activities": ["rest_lap"]}, SMALL.model_dump(mode="json")
    scene = {"cars": ["sedan"], "occupancy": {"driver": 1.0}, "sequence": sequence}
    images = {"variables": ["rgb"], "renderer": "raster", "light": "day"}
    config = SynthConfig.parse({"scene": scene, "camera": {"sensor": sensor}, "images": images})
    maker = FrameMaker(config, 2)
    (first, _), (second, _), (third, _) = (maker.make(index) for index in range(3))
    assert first["light"] == second["light"]
    assert first["light"] != third["light"]
