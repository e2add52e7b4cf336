"""Sun and sky through windows: where the sun stands, what it lights, and what a camera makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cabinpose.core import Camera, ConfigError
from cabinpose.scene import GLAZING, MATERIAL_ID, Surface
from cabinpose.scene.sensor import SUNLIGHT, GeometryBuffers, PhysicalNoise, Sensor, simulate
from cabinpose.synth import FrameMaker, SynthConfig, exact_config
from cabinpose.synth.pictures.light import draw_light
from cabinpose.synth.sunlight import Seen, Sun, Sunlight, SunView, pane_transmission, sun_position

GLASS = {"windscreen": 0.5, "front side": 0.4, "rear": 0.2}
WINDOW = (-0.3, 0.5), (0.4, 0.8)  # x and z of the window in its left wall, y = 1
SHELF = (-0.1, 0.2), (0.3, 0.7), 0.3  # x, y and z of what hangs in the box


def test_the_sun_stands_where_almanacs_have_it() -> None:
    """Equinox and solstices at noon, sunrise in the east, and the sun in the north of the southern hemisphere."""
    for latitude, day, hour, azimuth, elevation in (
        (48.0, 81, 12.0, 180.0, 42.0), (48.0, 172, 12.0, 180.0, 65.45), (48.0, 355, 12.0, 180.0, 18.55),
        (0.0, 81, 9.0, 90.0, 45.0), (48.0, 81, 6.0, 90.0, 0.0), (48.0, 81, 18.0, 270.0, 0.0), (-30.0, 81, 12.0, 0.0, 60.0),
    ):  # fmt: skip
        found = sun_position(latitude, day, hour)
        assert np.cos(np.radians(found[0] - azimuth)) > 1 - 1e-5
        assert found[1] == pytest.approx(elevation, abs=0.2)
    east = Sunlight(latitude_deg=0.0, days=(81, 81), hours=(9.0, 9.0), heading_deg=0.0).draw(1, 1, None)
    assert east.left_deg == pytest.approx(-90.0, abs=0.2)  # ahead is north, and east is to the right
    np.testing.assert_allclose(Sun(90.0, 30.0, True, 1.0).towards, (0.0, np.sqrt(0.75), 0.5), atol=1e-12)


def test_air_takes_what_published_tables_say() -> None:
    """Kasten and Young: 37.9 air masses at the horizon; Meinel: 0.7 ** AM ** 0.678 of what is above the air."""
    low, mean, high = (Sun(0.0, e, True, 1.0).direct for e in (0.001, 41.75, 90.0))  # 1.5 air masses at 41.8 degrees
    assert mean == pytest.approx(1.0, abs=1e-3)
    assert high == pytest.approx(0.7 / 0.7**1.5**0.678, rel=1e-3)
    assert low == pytest.approx(0.7**37.9**0.678 / 0.7**1.5**0.678, rel=0.02)
    night, grey, blue = Sun(0.0, -5.0, True, 30.0), Sun(0.0, 40.0, False, 30.0), Sun(0.0, 40.0, True, 30.0)
    assert (night.direct, night.sky, grey.direct) == (0.0, 0.0, 0.0)
    assert blue.direct > grey.sky > blue.sky > 0


def box() -> Surface:
    """A closed box of 2 x 2 x 1 m with a pane in its left wall and a shelf, of quads: the floor first, then the ceiling."""
    (x0, x1), (z0, z1) = WINDOW
    corners: list[np.ndarray] = []
    materials: list[str] = []

    def quad(*points: tuple[float, float, float], material: str = "soft_trim") -> None:
        corners.append(np.array(points))
        materials.extend([material] * 2)

    quad((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), material="carpet")
    quad((-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1))
    quad((-1, -1, 0), (1, -1, 0), (1, -1, 1), (-1, -1, 1))
    for x in (-1, 1):
        quad((x, -1, 0), (x, 1, 0), (x, 1, 1), (x, -1, 1))
    for left, right, low, high in ((-1, x0, 0, 1), (x1, 1, 0, 1), (x0, x1, 0, z0), (x0, x1, z1, 1)):
        quad((left, 1, low), (right, 1, low), (right, 1, high), (left, 1, high))
    quad((x0, 1, z0), (x1, 1, z0), (x1, 1, z1), (x0, 1, z1), material="glass")
    quad(*((x, y, SHELF[2]) for x, y in zip((*SHELF[0], *SHELF[0][::-1]), np.repeat(SHELF[1], 2).tolist(), strict=True)))
    vertices = np.concatenate(corners).astype(np.float32)
    first = 4 * np.arange(len(corners), dtype=np.int32)[:, None]
    faces = np.concatenate((first + [[0, 1, 2]], first + [[0, 2, 3]]), axis=1).reshape(-1, 3).astype(np.int32)
    flat = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals = np.repeat(flat[::2] / np.linalg.norm(flat[::2], axis=1, keepdims=True), 4, axis=0).astype(np.float32)
    material = np.array([MATERIAL_ID[name] for name in materials], np.uint8)
    return Surface(vertices, normals, faces, np.zeros_like(material), material, np.zeros_like(material))


@pytest.mark.parametrize(("left_deg", "elevation_deg"), [(90.0, 30.0), (60.0, 40.0), (110.0, 50.0)])
def test_a_window_lights_the_patch_that_geometry_says(left_deg: float, elevation_deg: float) -> None:
    """A floor below one window: each point's ray to the sun meets the wall's plane inside the pane or not, and the shelf's."""
    surface = box()
    towards = Sun(left_deg, elevation_deg, True, 1.0).towards
    x, y = np.meshgrid(np.linspace(-0.98, 0.98, 99), np.linspace(-0.98, 0.98, 99))
    points = np.stack((x.ravel(), y.ravel(), np.zeros(x.size)), axis=1)
    face = np.where(points[:, 1] > points[:, 0], 1, 0)  # of the floor's two triangles
    passed = pane_transmission(surface, -5.0, GLASS, towards)
    np.testing.assert_array_equal(passed > 0, surface.material == MATERIAL_ID["glass"])
    found = SunView(1, 850).received(surface, passed, Seen(face, points, np.array((0.0, 0.0, 0.9))), towards)

    way = (1.0 - points[:, 1]) / towards[1]
    crossing = points + way[:, None] * towards
    (x0, x1), (z0, z1) = WINDOW
    margin = np.minimum.reduce((crossing[:, 0] - x0, x1 - crossing[:, 0], crossing[:, 2] - z0, z1 - crossing[:, 2]))
    above = points + SHELF[2] / towards[2] * towards
    (x0, x1), (y0, y1), _ = SHELF
    covered = np.minimum.reduce((above[:, 0] - x0, x1 - above[:, 0], above[:, 1] - y0, y1 - above[:, 1]))
    sure = (np.abs(margin) > 0.025) & (np.abs(covered) > 0.025)  # of borders: cells of the shadow map and its bias
    expected = np.where((margin > 0) & (covered < 0), GLASS["front side"] * (1 - (1 - towards[1]) ** 5) ** 2 * towards[2], 0.0)
    assert ((margin > 0) & (covered < 0) & sure).sum() > 200
    assert ((margin > 0) & (covered > 0) & sure).sum() > 20
    np.testing.assert_allclose(found[sure], expected[sure], atol=2e-3)


def test_nothing_enters_by_holes_and_walls_have_backs() -> None:
    """Without the pane the hole is dark, and so is the ceiling, which turns its back to the sun."""
    surface = box()
    towards = Sun(90.0, 30.0, True, 1.0).towards
    points = np.array([(0.35, 0.0, 0.0), (0.35, 0.0, 1.0)])
    seen = Seen(np.array((0, 2)), points, np.array((0.0, 0.0, 0.5)))
    passed = pane_transmission(surface, -5.0, GLASS, towards)
    view = SunView(1, 850)
    assert (view.received(surface, passed, seen, towards) > 0).tolist() == [True, False]
    whole = replace(surface, material=np.where(surface.material == MATERIAL_ID["glass"], 0, surface.material).astype(np.uint8))
    assert not view.received(whole, np.zeros(len(surface.faces)), seen, towards).any()


def test_panes_are_told_by_their_place() -> None:
    """A pane behind the front seats is a rear one; one that faces ahead a windscreen; aslant less passes, by Schlick."""
    surface = box()
    square, aslant = Sun(90.0, 0.0, True, 1.0).towards, Sun(90.0, 60.0, True, 1.0).towards
    assert pane_transmission(surface, -5.0, GLASS, square).max() == pytest.approx(GLASS["front side"])
    assert pane_transmission(surface, 5.0, GLASS, square).max() == pytest.approx(GLASS["rear"])
    assert pane_transmission(surface, -5.0, GLASS, aslant).max() == pytest.approx(GLASS["front side"] * (1 - 0.5**5) ** 2)
    turned = replace(surface, vertices=surface.vertices[:, [1, 0, 2]])
    assert pane_transmission(turned, -5.0, GLASS, square[[1, 0, 2]]).max() == pytest.approx(GLASS["windscreen"])
    assert all(sum(glass.share for glass in kinds) == pytest.approx(1.0) for kinds in GLAZING.values())


@pytest.mark.parametrize(("wavelength", "share"), [(850, 1.0), (940, 0.31)])
def test_sunlight_is_electrons_by_irradiance_and_reflectance(wavelength: int, share: float) -> None:
    """On half of a wall: sigma as the closed form has it with N_ambient = N_white rho share light; 0.31 of it at 940 nm."""
    camera = Camera.from_fov(96, 72, 0.2)
    sensor = Sensor(
        name="small", camera=camera, range_m=(0.05, 10.0), integration_s=7e-4, frequencies_hz=(50e6,), min_amplitude_e=0.0,
        wavelength_nm=wavelength, vignetting_exponent=0.0, read_noise_e=0.0,
    )  # fmt: skip
    depth = np.full((72, 96), 1.0, np.float32)
    wall = GeometryBuffers.dense(1, depth, np.ones_like(depth), np.full(depth.shape, MATERIAL_ID["painted_wall"], np.uint8))
    light = np.zeros_like(depth)
    light[:, 48:] = 12.0
    noise = PhysicalNoise(ambient=0.0, stray_light=0.0, wiggling=0.0, blur=0.0, full_well=False)
    lit = replace(wall, sunlight=light)
    frames = [simulate(lit, sensor, noise, rng=np.random.Generator(np.random.Philox(key=(1, i)))).depth_m for i in range(60)]
    sigma = np.std(frames, axis=0)[:, 4:-4]
    signal, rho = sensor.signal_e * 0.75, 0.75
    expected = [
        299_792_458.0
        / (4 * np.pi * 50e6)
        * np.sqrt(signal + sensor.signal_e * rho * share * ambient)
        / (np.sqrt(2) * signal * 0.75)
        for ambient in (0.0, 12.0)
    ]
    assert sigma[:, :40].mean() == pytest.approx(expected[0], rel=0.05)
    assert sigma[:, 48:].mean() == pytest.approx(expected[1], rel=0.05)
    assert SUNLIGHT[wavelength] == share  # type: ignore[index]


def test_frames_in_the_sun_differ_only_where_light_falls() -> None:
    """The scene and its random numbers stay; lit pixels are noisier; a written scene has the sun of its frame."""
    told = "sunlight={latitude_deg: 30, hours: [9, 15], clear: 1.0}"
    plain = SynthConfig.load(None, ["scene.cars=[sedan]"])
    lit = SynthConfig.load(None, ["scene.cars=[sedan]", told])
    without, scene = FrameMaker(plain, 3).make(1)
    frame, _ = FrameMaker(lit, 3).make(1)
    np.testing.assert_array_equal(frame["labels"], without["labels"])
    np.testing.assert_array_equal(frame["depth_clean"], without["depth_clean"])
    assert not np.array_equal(frame["depth"], without["depth"], equal_nan=True)
    assert lit.sunlight is not None
    again = exact_config(lit, 3, 1)
    assert again.sunlight is not None
    assert again.sunlight.draw(3, 1, None) == lit.sunlight.draw(3, 1, None)
    np.testing.assert_array_equal(FrameMaker(again, 3).make(1)[0]["depth"], frame["depth"])
    assert scene.cabin is not None


@pytest.mark.slow
def test_pictures_have_the_same_sun() -> None:
    """Its direction, and of white ground the radiance that sun and sky give beside the camera's own light."""
    sun = Sun(70.0, 35.0, True, 30.0)
    light = draw_light("day", None, rng=np.random.default_rng(1), sun=sun)
    assert light.sun is not None
    np.testing.assert_allclose(light.sun[0], sun.towards)
    other = draw_light("day", None, rng=np.random.default_rng(1), sun=replace(sun, strength=60.0))
    assert other.infrared == pytest.approx(2 * light.infrared)
    assert draw_light("day", None, rng=np.random.default_rng(1), sun=replace(sun, clear=False)).sun is None


def test_sequences_keep_their_sun() -> None:
    config = SynthConfig.load(None, ["scene.sequence={frames: 5}"])
    suns = [Sunlight().draw(1, i, config.scene.sequence) for i in range(10)]
    assert len(set(suns[:5])) == len(set(suns[5:])) == 1
    assert suns[0] != suns[5]


@pytest.mark.parametrize("other", ["scene.kind=room", "noise.kind=empirical"])
def test_only_cars_have_windows_and_only_physical_noise_ambient_light(other: str) -> None:
    with pytest.raises(ConfigError, match="sunlight"):
        SynthConfig.load(None, [other, "sunlight={}"])


@pytest.mark.parametrize(
    ("key", "value", "what"),
    [
        ("days", [0, 100], "days"), ("days", [1, 1000], "days"), ("hours", [-5, 18], "hours"), ("hours", [8, 80], "hours"),
        ("hours", [18, 8], "begin at 18"),
    ],
)  # fmt: skip
def test_days_and_hours_are_those_of_a_year_and_a_day(key: str, value: list[float], what: str) -> None:
    with pytest.raises(ConfigError, match=what):
        SynthConfig.parse({"sunlight": {key: value}})


def test_days_go_over_the_end_of_the_year() -> None:
    """November to January, at noon in the north: never higher than on the first and the last day, on both sides of the end."""
    light = Sunlight(latitude_deg=48.0, days=(310, 20), hours=(12.0, 12.0))
    found = [light.draw(5, index, None).elevation_deg for index in range(200)]
    highest = max(sun_position(48.0, day, 12.0)[1] for day in (310, 20))
    assert max(found) <= highest + 1e-9
    assert min(found) == pytest.approx(sun_position(48.0, 355, 12.0)[1], abs=0.05)  # the solstice is among them
    januaries = [sun_position(48.0, day, 12.0)[1] for day in range(1, 21)]
    assert sum(any(abs(e - january) < 1e-9 for january in januaries) for e in found) > 20
    assert len({round(e, 9) for e in found}) > 50


def test_pictures_have_no_other_light_than_the_sun() -> None:
    SynthConfig.parse({"sunlight": {}, "images": {}})
    SynthConfig.parse({"images": {"light": "garage"}})
    with pytest.raises(ConfigError, match=r"images\.light is garage") as refused:
        SynthConfig.parse({"sunlight": {}, "images": {"light": "garage"}})
    assert "leave out one" in (refused.value.hint or "")


def test_a_camera_that_sees_nothing_receives_nothing() -> None:
    surface, towards = box(), Sun(90.0, 30.0, True, 1.0).towards
    nothing = Seen(np.zeros(0, int), np.zeros((0, 3)), np.zeros(3))
    found = SunView(1, 850).received(surface, pane_transmission(surface, -5.0, GLASS, towards), nothing, towards)
    assert found.shape == (0,)
