"""Sun and sky in a car: where the sun stands, and what of it falls through the windows on what a camera sees.

Sources: Cooper, "The absorption of radiation in solar stills", 1969 (declination); Kasten and Young, "Revised optical air mass
tables", 1989; Meinel and Meinel, "Applied Solar Energy", 1976 (direct light by air mass); ASTM G173-03 (the sky's light beside
it); Williams, "Casting Curved Shadows on Curved Surfaces", 1978, and Reeves et al., "Rendering Antialiased Shadows with Depth
Maps", 1987.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from cabinpose.core import Bools, Camera, ConfigError, Floats, Floats32, Ints, apply, at_rank, invert, look_at
from cabinpose.core import reproducible as rp
from cabinpose.scene import GLAZING, MATERIAL_ID, Surface, Wavelength
from cabinpose.scene.cabin import Cabin
from cabinpose.scene.sensor import PANES
from cabinpose.synth.motion.config import SequenceConfig
from cabinpose.synth.people import Model
from cabinpose.synth.render import Rasteriser, RenderedFrame, normals_at
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import own_rng, sun_rng

_Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
_Day = Annotated[int, Field(ge=1, le=366)]
_Hour = Annotated[float, Field(ge=0.0, le=24.0)]
_YEAR = 365  # days, after which the sun stands where it stood
_TILT_DEG = 23.45  # of the Earth's axis
_AIR_MASS = 1.5  # of ASTM G173-03, to which `strength` refers
# Light of a clear sky on the ground, of the direct one at that air mass: G173's 0.894 global and 0.829 direct at 37 degrees.
_SKY = 0.1
_OVERCAST = 0.25  # light of an overcast sky on the ground, of sun and sky on a clear day: assumed
_WINDOWS = 0.15  # share of the hemisphere above a surface inside that windows fill: assumed
# What the sun sees: a square of pixels about what the camera sees, from so far that its rays are parallel within half a degree.
_CELLS = 512
_AWAY = 100.0  # radii of what the camera sees
_BIAS_M = 0.012  # surfaces nearer to each other do not shade each other
_LEAST_COSINE = 0.15  # of a surface for which the slope within a cell is allowed
_BEHIND_M, _STEEP = 0.2, 0.35  # a pane this far behind the front H-points is a rear one; a windscreen's normal has so much of x


class Sunlight(Model):
    """Sun and sky over the car: by place and time, or in a direction that is given."""

    latitude_deg: float = Field(48.0, ge=-90.0, le=90.0, description="Where the car is (degrees north).")
    days: tuple[_Day, _Day] = Field(
        (1, 365),
        description="First and last day of the year, over its end where the last is the lesser; drawn for each frame.",
    )
    hours: tuple[_Hour, _Hour] = Field((8.0, 18.0), description="First and last hour of solar time; drawn for each frame.")
    heading_deg: _Degrees | None = Field(None, description="Where the car points (degrees east of north); none: anywhere.")
    towards_deg: tuple[_Degrees, Annotated[float, Field(ge=-90.0, le=90.0)]] | None = Field(
        None, description="In place of all that: the sun's direction, degrees to the left of ahead and above the horizon."
    )
    clear: float = Field(
        0.65, ge=0.0, le=1.0, description="Share of frames in which the sun is out; the sky is overcast in the rest."
    )
    strength: float = Field(
        30.0,
        ge=0.0,
        description="Direct sunlight at 850 nm and an air mass of 1.5, relative to the camera's own light at 1 m: 30 is 0.9"
        " W/m2/nm through a filter of 35 nm beside 1 W/m2.",
    )

    @model_validator(mode="after")
    def _in_order(self) -> Sunlight:
        first, last = self.hours
        if first > last:
            raise ConfigError(
                f"sunlight.hours begin at {first:g} and end at {last:g}",
                hint="give the earlier hour first; a night is two ranges, in two datasets",
            )
        return self

    def draw(self, seed: int, index: int, sequence: SequenceConfig | None) -> Sun:
        """The sun of frame `index` of a dataset, the same in all of its sequence."""
        rng = sun_rng(seed, index if sequence is None else sequence.first_of(index))
        first, last = self.days
        day = int(rng.integers(first, last + 1 + (_YEAR if last < first else 0)))
        hour, heading, clouds = rng.uniform(*self.hours), rng.uniform(0.0, 360.0), rng.random()
        if self.towards_deg is not None:
            left, elevation = self.towards_deg
        else:
            azimuth, elevation = sun_position(self.latitude_deg, day, hour)
            left = (heading if self.heading_deg is None else self.heading_deg) - azimuth
        return Sun((left + 180.0) % 360.0 - 180.0, elevation, bool(clouds < self.clear), self.strength)

    def fixed(self, seed: int, index: int, sequence: SequenceConfig | None) -> Sunlight:
        """The settings with which every frame has the sun of this one."""
        sun = self.draw(seed, index, sequence)
        return self.model_copy(update={"towards_deg": (sun.left_deg, sun.elevation_deg), "clear": float(sun.clear)})


def check_sunlight(scene: str, noise: str, light: str) -> None:
    """Raises ConfigError where kinds of scene and noise have no windows, or no light that is not the camera's own.

    light: of pictures, which have that of the sun.
    """
    if scene != "cabin" or noise != "physical":
        raise ConfigError(
            f"sunlight falls through the windows of cars on physical noise, and here are scenes of kind {scene}, noise {noise}",
            hint="leave sunlight out, or choose scene kind cabin and noise kind physical",
        )
    if light != "any":
        raise ConfigError(
            f"images.light is {light}, and sunlight says what lights the pictures as well",
            hint="leave out one of the two; sunlight.hours or sunlight.towards_deg make day and night",
        )


def sun_position(latitude_deg: float, day: float, hour: float) -> tuple[float, float]:
    """Azimuth (degrees east of north) and elevation (degrees) of the sun at a day of the year and an hour of solar time.

    day: 1 is the first of January, 366 that of the next.
    """
    declination = np.radians(_TILT_DEG) * rp.sin(2 * np.pi * (284 + day) / _YEAR)
    turn, latitude = np.radians(15.0 * (hour - 12.0)), np.radians(latitude_deg)
    east = -rp.cos(declination) * rp.sin(turn)
    north = rp.sin(declination) * rp.cos(latitude) - rp.cos(declination) * rp.sin(latitude) * rp.cos(turn)
    up = rp.sin(latitude) * rp.sin(declination) + rp.cos(latitude) * rp.cos(declination) * rp.cos(turn)
    return float(np.degrees(rp.arctan2(east, north)) % 360.0), float(np.degrees(rp.arcsin(np.clip(up, -1.0, 1.0))))


@dataclass(frozen=True)
class Sun:
    """The sun of a frame. left_deg: of ahead · elevation_deg · clear: whether it is out · strength: as in `Sunlight`."""

    left_deg: float
    elevation_deg: float
    clear: bool
    strength: float

    @property
    def towards(self) -> Floats:
        """(3,) unit, vehicle frame."""
        e, a = np.radians((self.elevation_deg, self.left_deg))
        return np.array((rp.cos(e) * rp.cos(a), rp.cos(e) * rp.sin(a), rp.sin(e)))

    @property
    def direct(self) -> float:
        """Light on a surface outside that faces the sun, in the unit of `strength`."""
        return self.strength * _through_air(self.elevation_deg) if self.clear and self.elevation_deg > 0 else 0.0

    @property
    def sky(self) -> float:
        """Light of the sky on the ground outside."""
        if self.elevation_deg <= 0:
            return 0.0
        height = float(rp.sin(np.radians(self.elevation_deg)))
        blue = _SKY * self.strength * min(1.0, 2.0 * height)
        return blue if self.clear else _OVERCAST * (blue + self.strength * _through_air(self.elevation_deg) * height)


def _through_air(elevation_deg: float) -> float:
    """Direct light at an elevation, of that at an air mass of 1.5."""
    air_mass = 1.0 / (rp.sin(np.radians(elevation_deg)) + 0.50572 * rp.power(elevation_deg + 6.07995, -1.6364))
    return float(rp.power(0.7, rp.power(air_mass, 0.678) - rp.power(_AIR_MASS, 0.678)))


class Seen(NamedTuple):
    """What a camera sees of a surface. face, points: triangles (N,), and places on them (N, 3) m · eye: (3,) m, where it is."""

    face: Ints
    points: Floats
    eye: Floats


class SunView:
    """Casts the sun through a car's windows, in one thread."""

    def __init__(self, seed: int, wavelength_nm: Wavelength) -> None:
        self._seed, self._wavelength = seed, wavelength_nm
        middle, focal = (_CELLS - 1) / 2, (_CELLS / 2 - 2) * _AWAY
        self._camera = Camera(_CELLS, _CELLS, focal, focal, middle, middle)
        self._rasteriser = Rasteriser(self._camera, 1)

    def light(self, scene: Scene, surface: Surface, sun: Sun, camera: Camera, seen: RenderedFrame) -> Floats32:
        """(H, W) light of sun and sky on what a camera sees of a car, in the unit of `Sun.strength`.

        surface: `scene.surface()` · camera, seen: what is seen of it, by which camera.
        """
        assert scene.cabin is not None
        glazing = self._glazing(scene.trim)
        light = np.full(seen.depth_clean.shape, np.float32(_WINDOWS * sun.sky * np.mean(list(glazing.values()))))
        if sun.direct > 0:
            at = np.flatnonzero(seen.face_id.reshape(-1) >= 0)
            points = apply(scene.world_from_camera, camera.points(seen.depth_clean).reshape(-1, 3)[at])
            what = Seen(seen.face_id.reshape(-1)[at].astype(int), points, scene.world_from_camera[:3, 3])
            passed = pane_transmission(surface, front_x(scene.cabin), glazing, sun.towards)
            light.reshape(-1)[at] += sun.direct * self.received(surface, passed, what, sun.towards)
        return light

    def received(self, surface: Surface, passed: Floats, seen: Seen, towards: Floats) -> Floats32:
        """(N,) sunlight on what is seen of a surface, through its panes, of that on a surface outside that faces the sun.

        passed: (F,) the share that each triangle lets through, 0 of what is no pane · towards: (3,) unit, to the sun.
        """
        if not len(seen.points):
            return np.zeros(0, np.float32)
        centre = (seen.points.min(axis=0) + seen.points.max(axis=0)) / 2
        radius = float(np.linalg.norm(seen.points - centre, axis=1).max())
        up = (0.0, -1.0, 0.0) if abs(towards[1]) < 0.9 else (-1.0, 0.0, 0.0)
        sun_from_world = invert(look_at(centre + radius * _AWAY * towards, centre, up))
        local = apply(sun_from_world, seen.points)
        uv = self._camera.project(local)
        panes = self._rasteriser.render(_part(surface, passed > 0), sun_from_world)
        column, row = np.rint(uv).astype(int).T
        pane = panes.face_id[row, column]
        lit = np.flatnonzero((pane >= 0) & (panes.depth_clean[row, column] < local[:, 2]))
        facing = rp.matmul(normals_at(surface, seen.face[lit], seen.points[lit], seen.points[lit] - seen.eye), towards)
        lit, facing = lit[facing > 0], facing[facing > 0]
        opaque = self._rasteriser.render(_part(surface, ~PANES[surface.material]), sun_from_world).depth_clean
        slope = 2.0 * radius / _CELLS * np.sqrt(2.0) / np.maximum(facing, _LEAST_COSINE)
        share = _in_front_share(opaque, uv[lit], local[lit, 2] - _BIAS_M - slope)
        received = np.zeros(len(local), np.float32)
        received[lit] = facing * share * passed[passed > 0][pane[lit]]
        return received

    def _glazing(self, car: str) -> Mapping[str, float]:
        """What the panes of a car let through, by place."""
        rng, found = own_rng(self._seed, f"glazing of {car}"), {}
        for place, kinds in GLAZING.items():
            u, rank = rng.random(2).tolist()
            kind = at_rank({kind: kind.share for kind in kinds}, u)
            low, high = kind.at_850 if self._wavelength == 850 else kind.at_940
            found[place] = low + rank * (high - low)
        return found


def front_x(cabin: Cabin) -> float:
    """x (m) of the foremost H-point of a car as it is built; panes well behind it are rear ones."""
    return max((float(seat.design_h_point[0]) for seat in cabin.seats.values()), default=0.0)


def pane_transmission(surface: Surface, x: float, glazing: Mapping[str, float], towards: Floats) -> Floats:
    """(F,) of every triangle: what it lets through of light from the sun; 0 where it is no pane.

    x: as `front_x` says · glazing: what panes let through that light meets squarely, by the places of `GLAZING`.
    Off the pane's normal its two faces reflect more: Schlick's form of Fresnel's law.
    """
    panes = np.asarray(surface.material == MATERIAL_ID["glass"])
    a, b, c = (surface.vertices[surface.faces[panes, k]].astype(np.float64) for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    middle = ((a + b + c) / 3)[:, 0]
    ahead = np.abs(normal[:, 0]) > _STEEP
    squarely = np.where(middle < x - _BEHIND_M, glazing["rear"], np.where(ahead, glazing["windscreen"], glazing["front side"]))
    aslant = 1.0 - np.minimum(np.abs(rp.matmul(normal, towards)), 1.0)
    passed = np.zeros(len(surface.faces))
    passed[panes] = squarely * (1.0 - rp.power(aslant, 5.0)) ** 2
    return passed


def _in_front_share(depth: Floats32, uv: Floats, z: Floats) -> Floats:
    """(N,) how much of the four cells about places (N, 2) has nothing nearer than z (m); bilinear, a depth of 0 is nothing."""
    column, row = np.floor(uv).astype(int).T
    right, down = (uv - np.floor(uv)).T
    share = np.zeros(len(uv))
    for y, of_row in ((0, 1.0 - down), (1, down)):
        for x, of_column in ((0, 1.0 - right), (1, right)):
            found = depth[row + y, column + x]
            share += of_row * of_column * ((found == 0) | (found > z))
    return share


def _part(surface: Surface, which: Bools) -> Surface:
    """Some of a surface's triangles (F,)."""
    of_faces = {name: np.ascontiguousarray(getattr(surface, name)[which]) for name in ("faces", "label", "material", "instance")}
    return replace(surface, **of_faces)
