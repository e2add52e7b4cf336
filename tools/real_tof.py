"""Statistics of real ToF frames beside simulated ones, for docs/real-cameras.md: `real_tof.py DATA [--pictures FOLDER]`.

DATA holds tof/raw_cw_60mhz.npz, tof/kinect_v2_panoptic.npz and tof/azure_kinect.mkv. The simulated camera looks at what the real
frame shows: its depth with the holes filled from the nearest valid pixel, and the light that it measured, where it did. A picture
has the real depth, the simulated, and the simulated with the rule for edges.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import nnls

from cabinpose.app.adapt.facts import filled, mixed_pixels, noise_of, silhouettes
from cabinpose.app.view.draw import depth_image
from cabinpose.core.camera import Camera
from cabinpose.scene.labels import LABEL_ID
from cabinpose.scene.materials import DYES, HAIR, MATERIAL_ID, MATERIALS
from cabinpose.scene.sensor import GeometryBuffers, PhysicalNoise, Sensor, simulate
from cabinpose.scene.sensor.presets import SPEED_OF_LIGHT
from cabinpose.signals.recorded import ToFFrame
from cabinpose.store import AXES
from cabinpose.store.convert.azure_mkv import read_azure_mkv
from cabinpose.store.frames import write_png
from cabinpose.synth import FrameMaker, room_preset

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
PARTS = 3  # of a pixel's side; edges of the filled depth lie a third of a pixel beside its border, so that pixels mix
WALL = MATERIAL_ID["painted_wall"]
Row = tuple[str, float, float]  # what, theirs, ours


# ------------------------------------------------------------------------------------------------------------ statistics


def edge_rows(name: str, real: F64, ours: F64, region: Mask, *, by_distance: bool = True) -> Iterator[Row]:
    """Invalid pixels by distance to the silhouettes of the real frame, width of the ring that they make, and mixed pixels."""
    whole = filled(real)
    edge = silhouettes(whole)
    off = ndimage.distance_transform_edt(~edge)

    def ring(depth: F64) -> tuple[list[float], float, float]:
        lost = np.isnan(depth)
        shares = [float(lost[region & (off >= d) & (off < d + 1)].mean()) for d in range(4)]
        base = float(lost[region & (off >= 5) & (off < 9)].mean())
        close = region & (off < 4)
        width = float((lost[close] - base).sum()) / (edge & region).sum() * 2  # two pixels of `edge` to a step
        return shares, width, mixed_pixels(depth, whole, region)

    theirs, mine = ring(real), ring(ours)
    if by_distance:
        yield from ((f"{name}: invalid {d} px from a silhouette", theirs[0][d], mine[0][d]) for d in range(4))
    yield f"{name}: width of the invalid ring, px", theirs[1], mine[1]
    yield f"{name}: mixed pixels to a px of silhouette", theirs[2], mine[2]


# ------------------------------------------------------------------------------------------------------------- simulation


def same_scene(real: F64, camera: Camera, light: F64 | None) -> GeometryBuffers:
    """What the frame shows, as geometry: `light` (H, W) is what comes back, relative to white paint at 1 m, if it is known."""
    whole = ndimage.median_filter(filled(real), 5)
    if light is None:
        points = camera.points(ndimage.gaussian_filter(whole, 1.5))
        normals = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
        rays = points / np.linalg.norm(points, axis=-1, keepdims=True)
        cosine = np.abs(np.sum(normals * rays, axis=-1)) / np.maximum(np.linalg.norm(normals, axis=-1), 1e-12)
        cosine = np.clip(cosine, 0.3, 1.0)  # all of white paint, as walls are
    else:
        cosine = np.nan_to_num(light * (whole * camera.range_over_depth) ** 2)
    parts = [np.kron(a, np.ones((PARTS, PARTS))) for a in (whole, cosine)]
    depth, cosine = (np.pad(a, ((1, 0), (1, 0)), mode="edge")[:-1, :-1].astype(np.float32) for a in parts)
    return GeometryBuffers.dense(PARTS, depth, cosine, np.full(depth.shape, WALL, np.uint8))


def seen(scene: GeometryBuffers, sensor: Sensor, noise: PhysicalNoise) -> F64:
    """Depth (m, NaN invalid) as the simulated camera delivers it."""
    return simulate(scene, sensor, noise, rng=np.random.Generator(np.random.Philox(key=(1, 0)))).depth_m.astype(np.float64)


def fitted_signal(scene: GeometryBuffers, sensor: Sensor, noise: PhysicalNoise, where: Mask, sigma_m: float) -> Sensor:
    """The sensor with the power that gives a sigma (m) where it is said."""
    free = noise.model_copy(update={"low_amplitude": False, "range_window": False, "full_well": False})
    low, high = 1e4, 1e11
    for _ in range(24):
        middle = float(np.sqrt(low * high))
        measured = noise_of(seen(scene, sensor.model_copy(update={"signal_e_per_s": middle}), free) - scene.depth_m, where)
        low, high = (low, middle) if measured < sigma_m else (middle, high)  # in too little light nothing is measured
    return sensor.model_copy(update={"signal_e_per_s": high})


def fitted_floor(scene: GeometryBuffers, sensor: Sensor, noise: PhysicalNoise, where: Mask, share: float) -> Sensor:
    """The sensor with the least amplitude that leaves a share of some pixels invalid."""
    low, high = 1.0, 1e7
    for _ in range(24):
        middle = float(np.sqrt(low * high))
        lost = np.isnan(seen(scene, sensor.model_copy(update={"min_amplitude_e": middle}), noise)[where]).mean()
        low, high = (low, middle) if lost > share else (middle, high)
    return sensor.model_copy(update={"min_amplitude_e": low})


# ----------------------------------------------------------------------------------------------------------- three cameras


def raw_continuous_wave(data: Path) -> Iterator[Row]:
    """Four phases at 60 MHz: tap order, amplitude, wiggling, and what averaging leaves."""
    with np.load(data / "tof" / "raw_cw_60mhz.npz") as file:
        c0, c1, c2, c3 = (file[f"phase{d}_avg"].astype(np.float64) for d in (0, 90, 180, 270))
        distance, amplitude = file["dist_avg"].astype(np.float64) / 1e3, file["amp_avg"].astype(np.float64)
    period = SPEED_OF_LIGHT / (2 * 60e6)
    turns = np.arctan2(c1 - c3, c0 - c2) / (2 * np.pi) % 1.0
    bright = amplitude > np.median(amplitude)
    error = (turns * period - distance) % period
    error = (error - np.median(error[bright]) + period / 2) % period - period / 2
    other = (np.arctan2(c3 - c1, c0 - c2) / (2 * np.pi) % 1.0 * period - distance) % period
    other = (other - np.median(other[bright]) + period / 2) % period - period / 2
    print(f"raw: decoded by C90 - C270 rms {1e3 * error[bright].std():.1f} mm, by C270 - C90 {1e3 * other[bright].std():.1f} mm")
    yield "raw: half the root of the squares / amplitude", float(np.median(np.hypot(c1 - c3, c0 - c2) / 2 / amplitude)), 0.5

    bins = np.floor(turns * 64).astype(int)
    curve = np.array(
        [np.median(error[bright & (bins == k)]) if (bright & (bins == k)).sum() > 300 else np.nan for k in range(64)]
    )
    sensor = Sensor(
        name="raw", camera=Camera.from_fov(64, 64, 0.6), range_m=(0.01, 9.0), integration_s=1e-3, fps=10, frequencies_hz=(60e6,)
    )
    ranges = np.broadcast_to((np.arange(64) + 0.5) / 64 * period, (64, 64))
    flat = (ranges / sensor.camera.range_over_depth).astype(np.float32)
    scene = GeometryBuffers.dense(1, flat, np.ones_like(flat), np.full(flat.shape, WALL, np.uint8))
    triangle = PhysicalNoise(
        wiggling=1.0, shot_noise=False, read_noise=False, low_amplitude=False, range_window=False, blur=0.0, stray_light=0.0,
        ambient=0.0, full_well=False,
    )  # fmt: skip
    wiggle = (seen(scene, sensor, triangle) * sensor.camera.range_over_depth - ranges)[0]
    known = np.isfinite(curve)
    shift, best = 0, -1.0
    for k in range(16):  # a quarter of a turn: the four samples may start anywhere
        found = float(np.corrcoef(np.roll(wiggle, k)[known], curve[known])[0, 1])
        shift, best = (k, found) if found > best else (shift, best)
    share = float(np.polyfit(np.roll(wiggle, shift)[known], curve[known], 1)[0])
    print(f"raw: wiggling is {share:.2f} of a triangle's, correlation {best:.2f} over {known.sum()} of 64 bins of phase")
    yield "raw: wiggling before calibration, peak to peak, mm", float(1e3 * np.ptp(curve[known])), float(1e3 * np.ptp(wiggle))
    third = PhysicalNoise().model_copy(update={**triangle.model_dump(), "wiggling": share})
    mine = (seen(scene, sensor, third) * sensor.camera.range_over_depth - ranges)[0]
    yield f"raw: the same with wiggling {share:.2f}", float(1e3 * np.ptp(curve[known])), float(1e3 * np.ptp(mine))
    smooth = np.isfinite(distance) & ~ndimage.binary_dilation(silhouettes(distance), iterations=3)
    pattern = PhysicalNoise().model_copy(update={**triangle.model_dump(), "wiggling": 0.0, "fixed_pattern_mm": 1.6})
    level = noise_of(seen(scene, sensor, pattern) * sensor.camera.range_over_depth - ranges, np.ones(ranges.shape, bool))
    yield "raw: pixel to pixel, of the averaged frame, mm", 1e3 * noise_of(distance, smooth & bright), 1e3 * level


LEVELS = (60, 80, 120, 180, 280, 400)  # amplitudes of the Azure Kinect; above, sigma is below half of its step of 1 mm
FLOOR, SPREAD = 43.0, 0.37  # of them, below which it gives no depth; and of the logarithm of that
# How the cameras take pixels out that too few neighbours are like.
OF_KINECT = {"remove_edges": True, "edge_threshold_m": 0.15, "edge_neighbours": 8, "edge_holes": False}
OF_AZURE = {"remove_edges": True, "edge_width_px": 2, "edge_neighbours": 6, "edge_tolerance": 0.025}
KINECT_LIGHT = 8.0  # exponent of its light's cosine, by the growth of sigma off the axis


# What the Kinect v2's frame shows inside silhouettes: left, top, right and bottom of boxes (px); and the band of reflectances
# that `scene.materials` has for it, of which a tenth is taken at a time.
BLACK = next((dye.low, dye.high) for dye in DYES["cotton"] if dye.name == "carbon black")
BRIGHT = next((dye.low, dye.high) for dye in DYES["cotton"] if dye.name == "reactive")
REGIONS = {
    "black trousers at 3.4 m": (((333, 216, 363, 240), (331, 242, 340, 266), (345, 240, 357, 260)), BLACK),
    "dark hair at 2.5 m": (((277, 83, 302, 96),), HAIR["black"]),
    "bright clothes at 2.4 to 3.3 m": (((262, 130, 300, 200), (272, 245, 286, 300), (330, 165, 368, 205)), BRIGHT),
}
TURNED = 0.8  # cosine of incidence of a limb, in the mean (assumed): where depth is lost, the frame does not show it


def inside(boxes: tuple[tuple[int, int, int, int], ...], shape: tuple[int, int]) -> Mask:
    """(H, W): the pixels of boxes."""
    where = np.zeros(shape, bool)
    for left, top, right, bottom in boxes:
        where[top:bottom, left:right] = True
    return where


def painted(scene: GeometryBuffers, where: Mask, reflectance: float) -> GeometryBuffers:
    """A scene of white paint with another reflectance in some of its pixels."""
    light = np.float32(TURNED * reflectance / MATERIALS[WALL].reflectance)
    parts = np.where(where.ravel()[scene.mixed][:, None], light, scene.parts_cos_incidence)
    return replace(scene, cos_incidence=np.where(where, light, scene.cos_incidence), parts_cos_incidence=parts)


def lost_by_surface(real: F64, scene: GeometryBuffers, sensor: Sensor, noise: PhysicalNoise) -> Iterator[Row]:
    """Invalid shares of people's surfaces, with the reflectances that the generator draws for such ones."""
    for name, (boxes, (low, high)) in REGIONS.items():
        where = inside(boxes, scene.shape)
        shares = [np.isnan(seen(painted(scene, where, r), sensor, noise)[where]).mean() for r in np.linspace(low, high, 10)]
        print(f"{name}: invalid {shares[0]:.2f} at the least reflectance that is drawn, {shares[-1]:.2f} at the most")
        yield f"Kinect v2: invalid, {name}", float(np.isnan(real[where]).mean()), float(np.mean(shares))


def fitted_kinect(data: Path) -> tuple[F64, GeometryBuffers, Sensor, PhysicalNoise]:
    """The frame of three people in a room, the same as geometry, and the camera by it."""
    with np.load(data / "tof" / "kinect_v2_panoptic.npz") as file:
        real = np.where(file["depth_m"] > 0, file["depth_m"], np.nan).astype(np.float64)
        k = file["camera_k"]
    camera = Camera(512, 424, *(float(k[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2))))
    sensor = Sensor(
        name="kinect_v2", camera=camera, range_m=(0.5, 8.0), integration_s=1e-3, fps=30, frequencies_hz=(80e6, 16e6),
        illumination_exponent=KINECT_LIGHT,
    )  # fmt: skip
    scene = same_scene(real, camera, None)
    radius = off_axis(camera)
    rim = (radius >= 212) & (radius < 260)
    middle = radius < 150
    flat = ~ndimage.binary_dilation(silhouettes(filled(real)), iterations=4)
    noise = PhysicalNoise(low_amplitude_spread=SPREAD).model_copy(update=OF_KINECT)
    sigma = noise_of(real, middle & flat, 1e-3)
    sensor = fitted_signal(scene, sensor, PhysicalNoise(), middle & flat, sigma)
    sensor = fitted_floor(scene, sensor, noise, rim, float(np.isnan(real[rim]).mean()))
    figures = f"{sensor.signal_e:.3g} electrons, at least {sensor.min_amplitude_e:.3g}"
    print(f"kinect v2: sigma {1e3 * sigma:.2f} mm in the middle; {figures}")
    return real, scene, sensor, noise


def off_axis(camera: Camera) -> F64:
    """(H, W) px."""
    v, u = np.mgrid[: camera.height, : camera.width]
    return np.hypot(u - camera.cx, v - camera.cy)


def kinect_v2(data: Path) -> tuple[list[Row], list[F64]]:
    """Three people in a room."""
    real, scene, sensor, noise = fitted_kinect(data)
    radius = off_axis(sensor.camera)
    flat = ~ndimage.binary_dilation(silhouettes(filled(real)), iterations=4)
    ours = seen(scene, sensor, noise.model_copy(update={"remove_edges": False}))
    removed = seen(scene, sensor, noise)
    region = radius < 145
    rows = list(edge_rows("Kinect v2", real, ours, region, by_distance=False))
    rows += edge_rows("Kinect v2, edges out", real, removed, region)
    for low, high in ((0, 150), (150, 212), (212, 260), (260, 330)):
        ring = (radius >= low) & (radius < high)
        rows.append(
            (
                f"Kinect v2: invalid from {low} to {high} px off the axis",
                *(float(np.isnan(d[ring]).mean()) for d in (real, removed)),
            )
        )
    for low, high in ((0, 100), (100, 170), (170, 212)):
        ring = (radius >= low) & (radius < high) & flat
        of = noise_of(real, ring, 1e-3), noise_of(ours - scene.depth_m, ring)
        rows.append((f"Kinect v2: σ from {low} to {high} px off the axis, mm", *(1e3 * s for s in of)))
    rows += lost_by_surface(real, scene, sensor, noise)
    return rows, [real, ours, removed]


# Of generated people: the classes of pixels, the place on the axis `worn` whose reflectance counts, its bounds, and what in the
# real frame is such.
LEGS = ("thigh_left", "thigh_right", "shin_left", "shin_right", "knee_left", "knee_right")
GENERATED = {
    "black trousers": (LEGS, "bottom", (0.0, 0.085), "black trousers at 3.4 m"),
    "trousers that reflect 0.085 to 0.4": (LEGS, "bottom", (0.085, 0.4), None),
    "bright trousers": (LEGS, "bottom", (0.4, 1.0), "bright clothes at 2.4 to 3.3 m"),
    "dark hair": (("hair",), "hair", (0.0, 0.15), "dark hair at 2.5 m"),
    "other hair": (("hair",), "hair", (0.15, 1.0), None),
    "head without hair": (("head_left", "head_right"), "skin", (0.0, 1.0), None),
}
METRES = ((2.0, 3.0), (3.0, 4.0))
ALIKE = 1.25  # factor by which light may differ where it counts as the same


def light_of(sensor: Sensor, depth: F64) -> F64:
    """(H, W): light that a surface at this depth (m) and pixel gets and returns, relative to the axis at 1 m."""
    off, exponent = sensor.camera.range_over_depth, sensor.vignetting_exponent + sensor.illumination_exponent
    return np.asarray(1 / off**exponent / (depth * off) ** 2)


def in_rooms(data: Path, frames: int) -> Iterator[tuple[str, ...]]:
    """Invalid shares of generated people before that camera, edges left out.

    By what they reflect, by distance, and where as much light is received as by such a surface in the real frame.
    """
    real, _, sensor, noise = fitted_kinect(data)
    asked = room_preset()
    maker = FrameMaker(asked.model_copy(update={"camera": asked.camera.model_copy(update={"sensor": sensor}), "noise": noise}), 1)
    middle = off_axis(sensor.camera) < 212
    alike = {like: inside(boxes, real.shape) for like, (boxes, _) in REGIONS.items()}
    light = {like: float(np.median(light_of(sensor, filled(real))[where])) for like, where in alike.items()}
    lost = {name: np.zeros((len(METRES) + 1, 2), int) for name in GENERATED}
    for number in range(frames):
        frame, _ = maker.make(number)
        depth = frame["depth_clean"]
        flat = middle & (frame["instance"] > 0) & ~ndimage.binary_dilation(silhouettes(depth), iterations=3)
        for name, (labels, place, band, like) in GENERATED.items():
            if not band[0] <= frame["reflectance"][0, AXES["worn"].index(place)] < band[1]:
                continue
            where = flat & np.isin(frame["labels"], [LABEL_ID[label] for label in labels])
            of = [where & (depth >= near) & (depth < far) for near, far in METRES]
            if like is not None:
                factor = light_of(sensor, np.where(where, depth, 1.0)) / light[like]
                of.append(where & (factor < ALIKE) & (factor > 1 / ALIKE))
            for count, some in zip(lost[name], of, strict=False):
                count += int(np.isnan(frame["depth"][some]).sum()), int(some.sum())
    for name, (_, _, _, like) in GENERATED.items():
        theirs = f"{np.isnan(real[alike[like]]).mean():.3g}" if like else ""
        yield name, theirs, *(f"{bad / of:.3g}" if of > 200 else "" for bad, of in lost[name])


def azure_kinect(data: Path) -> tuple[list[Row], list[F64]]:
    """A mug before a room; the light that the camera measured."""
    path = data / "tof" / "azure_kinect.mkv"
    frame = next(message for _, _, message in read_azure_mkv(path) if isinstance(message, ToFFrame))
    real, light = frame.depth_m().astype(np.float64), frame.amplitude.astype(np.float64)
    k, dist = frame.camera_k, frame.camera_dist
    focal = (float(k[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    camera = Camera(640, 576, *focal, tuple(float(x) for x in dist))  # type: ignore[arg-type]
    field = ndimage.binary_erosion(ndimage.binary_fill_holes(ndimage.binary_opening(light > 20, iterations=2)), iterations=6)
    sensor = Sensor(
        name="azure", camera=camera, range_m=(0.1, 6.0), integration_s=1e-3, fps=30, frequencies_hz=(200e6, 160e6),
        vignetting_exponent=0.0,
    )  # fmt: skip
    saturated = light > 60000
    scene = same_scene(real, camera, light / 1000 / MATERIALS[WALL].reflectance)
    flat = field & ~ndimage.binary_dilation(silhouettes(filled(real)), iterations=4) & ~saturated
    noise = PhysicalNoise(stray_light=0.0, low_amplitude_spread=SPREAD)
    levels = [(low, flat & (light >= low) & (light < high)) for low, high in pairwise(LEVELS)]
    # Of the law of `scene.sensor.noise_fit`, 2 x^2 rho^2 = (g / K) x + g^2 s^2: the unit of the amplitude and the read noise.
    x = np.array([np.median(light[some]) for _, some in levels])
    rho = np.array([noise_of(real, some, 1e-3) for _, some in levels])
    rho *= 4 * np.pi * float(np.linalg.norm(sensor.frequencies_hz)) / SPEED_OF_LIGHT
    y = 2 * (x * rho) ** 2
    slope, rest = nnls(np.stack((x, np.ones_like(x)), axis=1) / y[:, None], np.ones_like(y))[0]
    unit = slope * sensor.contrast
    figures = {"signal_e_per_s": 1e6 / (unit * sensor.contrast), "read_noise_e": float(np.sqrt(rest)) / unit}
    sensor = sensor.model_copy(update={**figures, "min_amplitude_e": FLOOR / unit, "full_well_e": 60000 / unit})
    print(f"azure: {unit:.3g} units an electron, read noise {sensor.read_noise_e:.3g} electrons")
    ours = seen(scene, sensor, noise)
    removed = seen(scene, sensor, noise.model_copy(update=OF_AZURE))
    rows = list(edge_rows("Azure Kinect", real, ours, field & ~saturated, by_distance=False))
    rows += edge_rows("Azure Kinect, edges out", real, removed, field & ~saturated)
    for low, some in levels:
        of = noise_of(real, some, 1e-3), noise_of(ours - scene.depth_m, some)
        rows.append((f"Azure Kinect: σ at amplitudes from {low}, mm", *(1e3 * s for s in of)))
    for low, high in ((20, 40), (40, 60), (60, 80), (80, 120)):
        some = field & (light >= low) & (light < high) & ~ndimage.binary_dilation(silhouettes(filled(real)), iterations=4)
        rows.append(
            (
                f"Azure Kinect: invalid at amplitudes {low} to {high}",
                *(float(np.isnan(d[some]).mean()) for d in (real, removed)),
            )
        )
    rows.append(
        (
            "Azure Kinect: invalid at saturated amplitude",
            *(float(np.isnan(d[saturated & field]).mean()) for d in (real, removed)),
        )
    )
    return rows, [real, ours, removed]


def main() -> None:
    """Print the table, and draw where it is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--frames", type=int, default=600, help="of generated people in rooms")
    told = parser.parse_args()
    rows = list(raw_continuous_wave(told.data))
    for camera in (kinect_v2, azure_kinect):
        some, images = camera(told.data)
        rows += some
        if told.pictures is not None:
            told.pictures.mkdir(parents=True, exist_ok=True)
            far = float(np.nanpercentile(images[0], 99))
            row = [depth_image(depth.astype(np.float32), 0.0, far) for depth in images]
            write_png(told.pictures / f"{camera.__name__}.png", np.concatenate(row, axis=1))
    print("\n| statistic | real | simulated | ratio |\n|---|---|---|---|")
    for what, theirs, ours in rows:
        print(f"| {what} | {theirs:.3g} | {ours:.3g} | {ours / theirs if theirs else np.nan:.2f} |")
    print("\n| surface | real | generated, 2 to 3 m | 3 to 4 m | in the frame's light |\n|---|---|---|---|---|")
    for cells in in_rooms(told.data, told.frames):
        print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
