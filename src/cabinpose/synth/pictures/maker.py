"""`PictureMaker`: the colour and the near-infrared picture of a scene, through the depth camera's own lens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from cabinpose.core import Bytes, Floats, Floats32
from cabinpose.core import reproducible as rp
from cabinpose.scene import Surface
from cabinpose.scene.sensor import SUNLIGHT, Sensor, lens_maps
from cabinpose.synth.person_look import look_of
from cabinpose.synth.pictures.denoise import denoised
from cabinpose.synth.pictures.grid import FINER, Hits, grid_of, hits, without_panes
from cabinpose.synth.pictures.light import Light, LightKind, draw_light
from cabinpose.synth.pictures.look import backdrop_colours, belt_colours, person_colours, thing_colours
from cabinpose.synth.pictures.path_tracing import mitsuba, trace
from cabinpose.synth.pictures.settings import Images
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.scene import Scene
from cabinpose.synth.streams import own_rng
from cabinpose.synth.sunlight import Sun

_LUMINANCE = np.array((0.2126, 0.7152, 0.0722))
_KINDS: tuple[LightKind, ...] = ("day", "night", "garage")
_COMMON = (0.6, 0.2, 0.2)
_KEY: Mapping[LightKind, float] = MappingProxyType({"day": 0.24, "night": 0.06, "garage": 0.16})  # of what middle grey is 0.18
_SATURATED = 65535
_ROOM_LAMPS = tuple((np.array((2.0, y, 2.35)), np.array((2.2, 2.0, 1.7))) for y in (-0.9, 0.9))  # m, W/sr


class PictureMaker:
    """Makes the pictures of scenes, in one thread."""

    def __init__(self, images: Images, sensor: Sensor, seed: int) -> None:
        if images.renderer == "path_traced":
            mitsuba()
        self._images = images
        self._sensor = sensor
        self._seed = seed
        self._grid = grid_of(sensor.camera)
        self._rasteriser = Rasteriser(self._grid.pinhole, 1)
        self._colours: dict[str, Floats32] = {}

    def take(
        self, scene: Scene, surface: Surface, reflectance: Floats32, *, rng: np.random.Generator, lit: np.random.Generator,
        sun: Sun | None = None,
    ) -> dict[str, Any]:  # fmt: skip
        """The variables `rgb` (H, W, 3) and `nir` (H, W) that are asked for, and what made them.

        Parameters
        ----------
        scene
            What is there.
        surface
            `scene.surface()`.
        reflectance
            (F, 3) of it, diffuse, in near infrared.
        rng
            Draws the paths and the noise.
        lit
            Draws the light.
        sun
            That which the depth camera has, by day.
        """
        drawn = _KINDS[int(lit.choice(len(_KINDS), p=_COMMON))]
        if sun is not None:
            drawn = "day" if sun.elevation_deg > 0 else "night"
        elif self._images.light != "any":
            drawn = self._images.light
        light = draw_light(drawn, _glow(scene), rng=lit, sun=sun)
        if scene.cabin is None:
            light = replace(light, lamps=_ROOM_LAMPS)
        seeds = rng.integers(0, 2**32, 2).tolist()
        found = hits(self._rasteriser, surface, without_panes(surface), scene.world_from_camera)
        result: dict[str, Any] = {"light": f"{light.kind}: {light.words}", "renderer": self._renderer()}
        if "rgb" in self._images.variables:
            result["rgb"] = develop(self._radiance(scene, surface, self._look(scene), light, found, seeds[0]), _KEY[light.kind])
        if "nir" in self._images.variables:
            infrared = _infrared(light, SUNLIGHT[self._sensor.wavelength_nm])
            seen = self._radiance(scene, surface, reflectance, infrared, found, seeds[1])
            result["nir"] = _exposed(seen[..., 1], self._sensor, rng=rng)
        return result

    def _renderer(self) -> str:
        if self._images.renderer == "raster":
            return "raster preview"
        paths = f"{self._images.samples} paths a pixel{', denoised' if self._images.denoise else ''}"
        return f"path traced by mitsuba {mitsuba().__version__}, {paths}"

    def _look(self, scene: Scene) -> Floats32:
        """(F, 3) of the scene's surface."""
        parts = [backdrop_colours(scene.backdrop, rng=own_rng(self._seed, scene.trim))]
        for person in scene.people:
            look = look_of(person.person, self._seed, person.subject)
            parts.append(person_colours(person.person, look, rng=own_rng(self._seed, f"blotches of {person.subject}")))
            parts += [belt_colours(belt, rng=own_rng(self._seed, scene.trim)) for belt in person.surfaces[1:]]
        for thing, *_ in scene.things:
            parts.append(thing_colours(thing.surface, rng=own_rng(self._seed, f"{thing.kind} {thing.variant}")))
        parts += [belt_colours(belt, rng=own_rng(self._seed, scene.trim)) for belt in scene.fastenings]
        return np.concatenate(parts)

    def _radiance(self, scene: Scene, surface: Surface, colours: Floats32, light: Light, found: Hits, seed: int) -> Floats:
        """(H, W, 3), 0 in pixels through which the lens shows nothing."""
        hit = found.face >= 0
        albedo = np.where(hit[:, None], colours[found.face], 1.0)
        if self._images.renderer == "raster":
            return np.nan_to_num(self._grid.mean(shaded(found, albedo, light)))
        paths = max(1, -(-self._images.samples // FINER**2))
        fine = trace(surface, colours, self._grid.pinhole, scene.world_from_camera, light, samples=paths, seed=seed)
        if self._images.denoise:
            fine = denoised(fine, albedo, found, self._grid)
        return np.nan_to_num(self._grid.mean(fine))


def develop(radiance: Floats, key: float) -> Bytes:
    """A camera's exposure and tone curve: radiance (H, W, 3), linear sRGB, to (H, W, 3) uint8 sRGB.

    The exposure brings the mean of what is not far brighter than the rest, the people rather than the windows, to `key`; the
    curve is that of Reinhard et al. 2002, whose white is the brightest hundredth.
    """
    luminance = rp.matmul(radiance, _LUMINANCE)
    lit = luminance[luminance > 0]
    if not lit.size:
        return np.zeros(radiance.shape, np.uint8)
    exposed = radiance * (key / np.minimum(lit, 4.0 * np.median(lit)).mean())
    level = rp.matmul(exposed, _LUMINANCE)
    white = np.clip(np.quantile(level, 0.99), 1.5, 12.0)
    value = np.clip(exposed * ((1.0 + level / white**2) / (1.0 + level))[..., None], 0.0, 1.0)
    srgb = np.where(value <= 0.0031308, 12.92 * value, 1.055 * rp.power(value, 1 / 2.4) - 0.055)
    return np.asarray((255.0 * srgb).round(), np.uint8)


def shaded(found: Hits, albedo: Floats, light: Light) -> Floats:
    """Radiance (N, 3) of the raster preview: light from above and below and from the camera, without shadows."""
    rows = light.dome.shape[0]
    half = light.dome[: rows // 2].mean(axis=(0, 1)), light.dome[rows // 2 :].mean(axis=(0, 1))
    up = 0.5 + 0.5 * found.normal[:, 2:]
    cosine = -np.einsum("ij,ij->i", found.normal, found.direction) / np.linalg.norm(found.direction, axis=1)
    received = 0.25 * (up * half[0] + (1.0 - up) * half[1]) * (0.4 + 0.6 * cosine[:, None])
    distance = found.depth_m * np.linalg.norm(found.direction, axis=1)
    received = received + light.own * (cosine / np.maximum(distance, 0.05) ** 2)[:, None]
    return np.where(found.face[:, None] >= 0, albedo * received, light.seen(found.direction))


def _glow(scene: Scene) -> Floats | None:
    """A place before the instruments of a car, that of their light."""
    wheel = None if scene.cabin is None else scene.cabin.steering_wheel
    return None if wheel is None else np.asarray(wheel.vehicle_from_wheel[:3, 3]) + (-0.1, 0.0, 0.1)


def _infrared(light: Light, sunlight: float) -> Light:
    """The light at the camera's wavelength, in radiance of white by the camera's own light from 1 m.

    sunlight: share of that at 850 nm which sun and sky have there.
    """
    share = light.infrared * sunlight
    grey = (rp.matmul(light.dome, _LUMINANCE.astype(np.float32)) * np.float32(share))[..., None].repeat(3, axis=-1)
    sun = None if light.sun is None else (light.sun[0], np.full(3, rp.matmul(light.sun[1], _LUMINANCE) * share))
    return Light(light.kind, light.words, grey, sun, own=1.0)


def _exposed(radiance: Floats, sensor: Sensor, *, rng: np.random.Generator) -> np.ndarray:
    """Electrons (H, W) uint16 of both taps, with photon and read noise, of radiance in that of white at 1 m."""
    maps = lens_maps(sensor, 1)
    mean = np.where(maps.field, np.nan_to_num(radiance * maps.vignetting), 0.0) * sensor.signal_e
    noisy = rng.poisson(np.minimum(mean, 2.0 * _SATURATED)) + sensor.read_noise_e * rng.standard_normal(mean.shape)
    return np.asarray(np.clip(noisy.round(), 0, _SATURATED), np.uint16)
