"""What the laboratory's camera sees, against closed forms, distance fields and OpenCV's detectors."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cabinpose.align.board import Board
from cabinpose.app.lab.raycast import Plate, PrimitiveScene, cast
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.app.lab.targets import as_message, board_scene, pendulum_scene, see
from cabinpose.core.frames import apply, invert, transform
from cabinpose.scene.materials import MATERIAL_ID, MATERIALS
from cabinpose.scene.sensor import GeometryBuffers, sensor_by_name

F64 = NDArray[np.float64]
SENSOR = sensor_by_name("pico_monstar_105/4")
CAMERA = SENSOR.camera
NOTHING = np.zeros((0, 5)), np.zeros((0, 8)), np.zeros((0, 5))
WALL = np.array([[0.1, -0.2, 1.0, 2.0, 0.5]]) / np.sqrt(1.05) ** np.array([1, 1, 1, 1, 0])


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=(seed, 0)))


def light(buffers: GeometryBuffers) -> F64:
    """(H, W) reflectance x cosine of incidence, mean over each pixel."""
    result = buffers.cos_incidence.astype(np.float64).copy()
    result.ravel()[buffers.mixed] = buffers.parts_cos_incidence.mean(axis=1)
    return result * MATERIALS[MATERIAL_ID["painted_wall"]].reflectance


def centroid(image: F64) -> F64:
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array(((image * u).sum(), (image * v).sum())) / image.sum()


def camera_from_board(
    distance: float, turn: tuple[float, float, float], board: Board, aside: tuple[float, float] = (0, 0)
) -> F64:
    pose = transform(Rotation.from_rotvec(turn))
    pose[:3, 3] = np.array((*aside, distance)) - pose[:3, :3] @ board.corners.mean(axis=0)
    return pose


def dense_sphere(centre: F64, radius: float, gain: float, rays: int = 40) -> tuple[F64, NDArray[np.intp]]:
    """Light of a sphere in the 12 x 12 pixels about its image, by rays x rays regular rays in each; the first pixel (v, u)."""
    u0, v0 = np.rint(CAMERA.project(centre)).astype(int) - 6
    fine = (np.arange(12 * rays) + 0.5) / rays - 0.5
    uv = np.stack(np.meshgrid(fine + u0, fine + v0), axis=-1)
    xy = CAMERA.undistort((uv - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy))
    d = np.concatenate((xy, np.ones_like(xy[..., :1])), axis=-1)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    # the cosine of incidence on a sphere at distance b of a ray that passes its centre at distance a: sqrt(1 - (a / R)^2)
    passing = centre @ centre - (d @ centre) ** 2
    cosine = gain * np.sqrt(np.maximum(1 - passing / radius**2, 0))
    return cosine.reshape(12, rays, 12, rays).mean(axis=(1, 3)), np.array((v0, u0))


@pytest.mark.parametrize("shift", [(0.31, 0.47), (60.5, -80.75)])
@pytest.mark.parametrize("radius", [0.007, 0.0125])
def test_a_sphere_lights_the_pixels_as_dense_rays_say(shift: tuple[float, float], radius: float) -> None:
    z = 1.1
    centre = np.array(((shift[0] + 0.5) * z / CAMERA.fx, shift[1] * z / CAMERA.fy, z))
    seen = light(cast(PrimitiveScene(*NOTHING[:2], np.array([[*centre, radius, 3.0]])), SENSOR))
    dense, (v0, u0) = dense_sphere(centre, radius, 3.0)
    assert seen.sum() == pytest.approx(seen[v0 : v0 + 12, u0 : u0 + 12].sum())
    assert np.abs(seen[v0 : v0 + 12, u0 : u0 + 12] - dense).max() < 0.04
    assert np.abs(centroid(seen) - centroid(dense) - (u0, v0)).max() < 0.003
    # Pixels of a spot this small pull its centroid towards their middles, by less than this.
    assert np.abs(centroid(seen) - CAMERA.project(centre)).max() < 0.025


@pytest.mark.parametrize("radius", [0.007, 0.0125])
def test_a_sphere_is_as_bright_as_it_is_large(radius: float) -> None:
    seen = light(cast(PrimitiveScene(*NOTHING[:2], np.array([[0.002, 0.001, 1.1, radius, 3.0]])), SENSOR))
    # a disc of radius a px, whose brightness falls as sqrt(1 - rho^2) from the middle: 2/3 of it in the mean
    a = CAMERA.fx * radius / 1.1
    assert seen.sum() == pytest.approx(3.0 * np.pi * a * a * 2 / 3, rel=0.004)


def test_a_sphere_in_the_corner_of_the_image_is_found_there_too() -> None:
    centre = np.array((0.55, -0.45, 0.8))
    seen = light(cast(PrimitiveScene(*NOTHING[:2], np.array([[*centre, 0.0125, 1.0]])), SENSOR))
    # the image of a sphere off the axis is an ellipse, whose middle is farther out than that of the sphere
    assert np.abs(centroid(seen) - CAMERA.project(centre)).max() < 0.03


def test_the_light_of_a_plate_is_that_of_its_area() -> None:
    z, side = 1.3, 0.05
    plate = Plate(
        transform(translation=(-0.043, -0.021, z)),
        (-0.03, -0.04, 0.21, 0.13),
        (0.0, 0.0, 4, 2, side),
        reflectances=(0.8, 0.1, 0.3),
    )
    seen = light(cast(PrimitiveScene(*NOTHING, plate), SENSOR))
    # the centre of the image is as good as undistorted; the cosine of incidence is that of the ray
    rays = CAMERA.rays
    per_m2 = np.zeros_like(seen)
    per_m2[1:-1, 1:-1] = (
        1
        / np.abs(
            np.gradient(rays[..., 0], axis=1) * np.gradient(rays[..., 1], axis=0)
            - np.gradient(rays[..., 0], axis=0) * np.gradient(rays[..., 1], axis=1)
        )[1:-1, 1:-1]
    )
    total = (seen / np.where(per_m2 > 0, per_m2, np.inf) * CAMERA.range_over_depth).sum() * z * z
    black = 4 * side * side  # four of the eight squares
    assert total == pytest.approx(0.8 * (0.24 * 0.17 - black) + 0.1 * black, rel=0.002)


def test_rays_meet_what_a_distance_field_says() -> None:
    capsules = np.array([[-0.3, 0.1, 1.0, 0.2, -0.2, 1.6, 0.12, 0.5], [0.4, 0.5, 0.9, 0.42, -0.4, 1.0, 0.05, 0.5]])
    spheres = np.array([[0.1, 0.1, 0.9, 0.08, 1.0], [-0.5, 0.3, 1.5, 0.2, 1.0]])
    buffers = cast(PrimitiveScene(WALL, capsules, spheres), SENSOR)
    v, u = np.mgrid[0:287:9, 0:352:9].reshape(2, -1)
    direction = np.concatenate((CAMERA.rays[v, u], np.ones((len(v), 1))), axis=-1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)

    def field(p: F64) -> F64:
        distances = [WALL[0, 3] - p @ WALL[0, :3]]
        for c in capsules:
            axis = c[3:6] - c[:3]
            s = np.clip((p - c[:3]) @ axis / (axis @ axis), 0, 1)
            distances.append(np.linalg.norm(p - c[:3] - s[:, None] * axis, axis=-1) - c[6])
        distances += [np.linalg.norm(p - s[:3], axis=-1) - s[3] for s in spheres]
        return np.min(distances, axis=0)

    reached = np.zeros(len(v))
    for _ in range(250):
        reached += field(direction * reached[:, None])
    seen = buffers.depth_m[v, u] / direction[:, 2]
    p = direction * reached[:, None]
    step = 1e-5
    normal = np.stack([field(p + step * e) - field(p - step * e) for e in np.eye(3)], axis=-1) / (2 * step)
    there = np.abs(field(p)) < 1e-6  # a ray that grazes a body has not arrived yet
    assert there.mean() > 0.97
    assert np.abs(seen - reached)[there].max() < 1e-5
    cosine = buffers.cos_incidence[v, u] * MATERIALS[MATERIAL_ID["painted_wall"]].reflectance
    of_wall = np.abs(WALL[0, 3] - p @ WALL[0, :3]) < 1e-5
    of_capsule = np.min([np.abs(field(p))], axis=0) < 1e-6
    reflectance = np.where(of_wall, 0.5, np.where(_nearest_is_a_sphere(p, spheres), 1.0, 0.5))
    expected = reflectance * np.abs(np.sum(normal * direction, axis=-1))
    assert np.abs(cosine - expected)[there & of_capsule].max() < 1e-3


def _nearest_is_a_sphere(p: F64, spheres: F64) -> NDArray[np.bool_]:
    return np.min([np.abs(np.linalg.norm(p - s[:3], axis=-1) - s[3]) for s in spheres], axis=0) < 1e-5


def test_a_thin_string_takes_its_share_of_each_pixel() -> None:
    z, radius = 1.0, 0.0008
    string = np.array([[0.013, -0.1, z, 0.017, 0.1, z, radius, 1.0]])
    seen = light(cast(PrimitiveScene(WALL[:0], string, NOTHING[2]), SENSOR))
    rows = seen[130:156].sum(axis=1)  # the mean of sqrt(1 - x^2) over a chord is pi / 4
    assert np.abs(rows / (np.pi / 4 * 2 * radius * CAMERA.fx / z) - 1).max() < 0.1
    assert abs(rows.mean() / (np.pi / 4 * 2 * radius * CAMERA.fx / z) - 1) < 0.02


def test_depth_is_that_of_the_plane() -> None:
    rig, board = VirtualRig.exact(), Board()
    pose = camera_from_board(1.0, (0.4, -0.3, 0.1), board)
    frame = see(rig, board_scene(rig, board, invert(rig.camera_from_world) @ pose), rng=rng())
    x, y = np.rint(CAMERA.project(apply(pose, board.corners + (0.03, 0.03, 0)))).astype(int).T  # the middles of squares
    rays = np.concatenate((CAMERA.rays[y, x], np.ones((len(x), 1))), axis=-1)
    expected = pose[:3, 2] @ pose[:3, 3] / (rays @ pose[:3, 2])
    assert np.nanmax(np.abs(frame.depth_m[y, x] - expected)) < 3e-4
    assert np.isfinite(frame.depth_m[y, x]).mean() > 0.9


@pytest.mark.parametrize(
    ("distance", "turn", "aside"),
    [(0.8, (0.3, 0.2, 0.1), (0, 0)), (1.2, (-0.4, 0.3, -0.2), (0.25, 0.1)), (1.0, (0, 0, 0), (-0.2, 0))],
)
def test_corners_are_found_where_they_project_to(distance: float, turn: tuple, aside: tuple) -> None:
    rig, board = VirtualRig.exact(), Board()
    pose = camera_from_board(distance, turn, board, aside)
    amplitude = see(rig, board_scene(rig, board, invert(rig.camera_from_world) @ pose), rng=rng()).amplitude
    expected = CAMERA.project(apply(pose, board.corners))
    grey = np.clip(amplitude * (255 / np.percentile(amplitude, 95)), 0, 255).astype(np.uint8)
    found, corners = cv2.findChessboardCornersSB(cv2.resize(grey, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC), (9, 6))
    assert found
    uv = (corners.reshape(-1, 2) + 0.5) / 4 - 0.5
    off = min(
        (order - expected for order in (uv, uv[::-1])), key=np.linalg.norm
    )  # OpenCV does not tell a board from its half turn
    assert np.sqrt((off**2).mean()) < 0.05
    assert np.abs(off.mean(axis=0)).max() < 0.02


def test_the_square_before_the_first_corner_is_black() -> None:
    rig, board = VirtualRig.exact(), Board()
    pose = camera_from_board(0.8, (0.1, 0, 0), board)
    amplitude = see(rig, board_scene(rig, board, invert(rig.camera_from_world) @ pose), rng=rng()).amplitude
    first, second = np.rint(CAMERA.project(apply(pose, board.corners[0] + [(-0.03, -0.03, 0), (0.03, -0.03, 0)]))).astype(int)
    assert amplitude[first[1], first[0]] < 0.2 * amplitude[second[1], second[0]]


def test_markers_are_the_brightest_and_lie_on_the_board() -> None:
    rig, board = VirtualRig(), Board()
    pose = camera_from_board(1.0, (0.2, 0.3, 0.1), board)
    frame = see(rig, board_scene(rig, board, invert(rig.camera_from_world) @ pose), rng=rng())
    amplitude = frame.amplitude.astype(np.float64)
    found = []
    for _ in board.markers:
        v, u = np.unravel_index(np.argmax(amplitude), amplitude.shape)
        window = np.s_[v - 5 : v + 6, u - 5 : u + 6]
        above = np.maximum(amplitude[window] - 0.3 * amplitude[v, u], 0)
        found.append(centroid(above) + (u - 5, v - 5))
        amplitude[window] = 0
    expected = CAMERA.project(apply(pose, board.marker_centres))
    away = np.linalg.norm(np.array(found)[:, None] - expected, axis=-1)
    assert sorted(away.argmin(axis=1)) == [0, 1, 2, 3]
    assert away.min(axis=1).max() < 0.15


def test_the_operator_covers_neither_corners_nor_markers() -> None:
    rig, board = VirtualRig.exact(), Board()
    world_from_camera = invert(rig.camera_from_world)
    for turn in ((0.6, 0.0, 0.3), (-0.6, 0.2, 0.0), (0.2, 0.6, -0.3), (0.0, -0.6, 0.2)):
        pose = camera_from_board(1.3, turn, board, (-0.1, 0.35))
        scene = board_scene(rig, board, world_from_camera @ pose)
        assert len(scene.capsules) >= 4, "there is somebody"
        alone = replace(scene, capsules=scene.capsules[:0])
        seen, free = (light(cast(s.seen_from(rig.camera_from_world), SENSOR)) for s in (scene, alone))
        assert (seen != free).sum() > 500
        points = np.concatenate((board.corners, board.marker_centres))
        u, v = np.rint(CAMERA.project(apply(pose, points))).astype(int).T
        for du in (-1, 0, 1):
            for dv in (-1, 0, 1):
                assert (seen[v + dv, u + du] == free[v + dv, u + du]).all()


def test_a_marker_close_by_saturates() -> None:
    rig = VirtualRig(sensor="pico_monstar_105/1", tof={"rate_hz": 5})
    world_from_camera = invert(rig.camera_from_world)
    scenes = [
        pendulum_scene(rig, apply(world_from_camera, (0, -0.4, z)), apply(world_from_camera, (0, 0, z))) for z in (0.5, 2.0)
    ]
    near, far = (see(rig, scene, rng=rng()).amplitude for scene in scenes)
    assert far.max() < 65535
    assert near.max() == 65535


def test_noise_is_switched_and_drawn_from_the_generator() -> None:
    scene = pendulum_scene(VirtualRig(), (0.9, 0.0, 1.7), (0.85, 0.1, 1.1))
    once, again, other = (see(VirtualRig(), scene, rng=rng(seed)) for seed in (1, 1, 2))
    assert (once.amplitude == again.amplitude).all()
    assert np.array_equal(once.depth_m, again.depth_m, equal_nan=True)
    assert (once.amplitude != other.amplitude).any()
    exact = [see(VirtualRig.exact(), scene, rng=rng(seed)).amplitude for seed in (1, 2)]
    assert (exact[0] == exact[1]).all()
    flat = np.s_[200:220, 150:200]
    assert np.std(once.amplitude[flat] - exact[0][flat].astype(float)) > 2


def test_a_frame_as_the_recorder_gets_it() -> None:
    rig = VirtualRig()
    frame = see(rig, pendulum_scene(rig, (0.9, 0.0, 1.7), (0.85, 0.1, 1.1)), rng=rng())
    message = as_message(rig, frame)
    assert message.depth.shape == message.amplitude.shape == message.confidence.shape == (287, 352)
    assert (message.amplitude == frame.amplitude).all()
    metres = np.where(message.depth > 0, message.depth * message.depth_unit_m, np.nan)
    assert np.nanmax(np.abs(metres - frame.depth_m)) <= 0.51e-4
    assert np.array_equal(message.camera_k, CAMERA.k)
    assert tuple(message.amplitude_dist) == CAMERA.dist
