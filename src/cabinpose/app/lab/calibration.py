"""The calibration takes of a virtual rig: a board shown to camera and optical system, a pendulum before them.

A take is drawn first, then written: what was drawn is the truth that the recording is judged by.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from cabinpose.align import Board
from cabinpose.app.lab.markers import marker_samples
from cabinpose.app.lab.pendulum import Swing, swing
from cabinpose.app.lab.raycast import PrimitiveScene
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.app.lab.targets import as_message, board_scene, pendulum_scene, plate_size, see
from cabinpose.app.lab.writing import samples, write_recording
from cabinpose.core import Camera, Matrix, SceneError, apply, invert, transform
from cabinpose.signals import Sample
from cabinpose.store.recording import Take

F64 = NDArray[np.float64]
Times = NDArray[np.int64]

BOARD_SUBJECT, PENDULUM_SUBJECT, PENDULUM_MARKER = "board", "pendulum", "pendulum"
_DISTANCES_M = (0.6, 1.6)
_TILT_DEG, _TURN_DEG = 38.0, 20.0
_INCIDENCE_DEG = 55.0  # of the line of sight on the board, at most
_BORDER_PX = 4.0
_SQUARE_PX = 5.0  # side of the smallest square in the image
_TRIES = 600
_GOLDEN = (5**0.5 - 1) / 2
_CELLS = 3  # views are spread over 3 x 3 parts of the image


@dataclass(frozen=True)
class BoardTake:
    """A board held still in N poses, one after the other, and moved smoothly from each to the next.

    world_from_board (N, 4, 4) · held_ns (N, 2): true times between which it is still · start_s, end_s: of the take, after the
    rig's start.
    """

    board: Board
    world_from_board: F64
    held_ns: Times
    start_s: float
    end_s: float

    def poses(self, true_ns: Times) -> F64:
        """(T, 4, 4) world_from_board at true times (T,)."""
        centre = np.array((*_centre(self.board), 0.0))
        at = (true_ns - self.held_ns[0, 0]) / 1e9
        knots = ((self.held_ns - self.held_ns[0, 0]) / 1e9).ravel()
        turns = Rotation.from_matrix(self.world_from_board[:, :3, :3])
        places = _moved(self.world_from_board, centre[None])[:, 0]
        at = np.clip(at, 0.0, knots[-1])
        # Progress through the views, with no speed where the board is held.
        progress = PchipInterpolator(knots, np.repeat(np.arange(len(places)), 2).astype(np.float64))(at)
        result = np.tile(np.eye(4), (len(at), 1, 1))
        if len(places) == 1:
            result[:] = self.world_from_board[0]
            return result
        result[:, :3, :3] = Slerp(np.arange(len(places)), turns)(progress).as_matrix()
        between = np.stack([np.interp(progress, np.arange(len(places)), places[:, axis]) for axis in range(3)], axis=-1)
        result[:, :3, 3] = between - (result[:, :3, :3] @ centre)
        return result


def _centre(board: Board) -> tuple[float, float]:
    x0, y0, x1, y1 = plate_size(board)
    return (x0 + x1) / 2, (y0 + y1) / 2


def board_take(
    rig: VirtualRig,
    *,
    views: int = 50,
    board: Board | None = None,
    hold_s: float = 0.6,
    move_s: float = 0.4,
    start_s: float = 0.0,
    rng: Generator,
) -> BoardTake:
    """Draw a board take: `views` poses at 0.6 to 1.6 m before the camera, all over its image, tilted up to 38 degrees.

    Corners and markers are in the image and inside the lens' field in every one. Raises SceneError where the camera sees no such
    pose.
    """
    board = board or Board()
    world_from_camera = invert(rig.camera_from_world)
    poses = np.stack([world_from_camera @ _pose(rig, board, view, views, rng=rng) for view in range(views)])
    begins_s = start_s + 0.3 + np.arange(views) * (hold_s + move_s)
    held = rig.start_ns + np.rint(np.stack((begins_s, begins_s + hold_s), axis=-1) * 1e9).astype(np.int64)
    return BoardTake(board, poses, held, start_s, float(begins_s[-1] + hold_s + 0.3))


def _pose(rig: VirtualRig, board: Board, view: int, views: int, *, rng: Generator) -> Matrix:
    """camera_from_board of one view: parts of the image and distances in turn, all else at random."""
    sensor = rig.tof_sensor
    camera = sensor.camera
    x0, y0, x1, y1 = plate_size(board)
    rim = np.array([(x, y, 0.0) for x in (x0, x1) for y in (y0, y1)])
    points = np.concatenate((board.marker_centres, board.corners, rim))
    cell = np.array((view % _CELLS, view // _CELLS % _CELLS))
    near, far = _DISTANCES_M
    distance = near * (far / near) ** ((view * _GOLDEN + rng.uniform() / views) % 1.0)  # spread evenly, in no order
    for attempt in range(_TRIES):
        ease = attempt / _TRIES  # a near board fits the middle of the image only: with each try the place moves there
        share = (cell + rng.uniform(size=2)) / _CELLS
        uv = (1 - ease) * share + ease * 0.5
        centre = camera.unproject(uv * (camera.width - 1, camera.height - 1), distance)
        tilt, about = np.radians(_TILT_DEG) * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
        turn = Rotation.from_rotvec((tilt * np.cos(about), tilt * np.sin(about), 0.0))
        turn = turn * Rotation.from_rotvec((0.0, 0.0, np.radians(_TURN_DEG) * rng.uniform(-1, 1)))
        pose = transform(turn)
        pose[:3, 3] = centre - turn.apply((*_centre(board), 0.0))
        if _in_view(sensor.field_radius_px, camera, apply(pose, points)) and _is_legible(camera, pose, board, centre):
            return pose
    raise SceneError(
        f"the board does not fit the image of {rig.sensor} at {near} to {far} m",
        hint="take a camera with a wider field of view, or a smaller board",
    )


def _in_view(field_px: float | None, camera: Camera, p_camera: F64) -> bool:
    """Whether points (N, 3) lie in the image, inside the lens' field, not too near its border."""
    uv = camera.project(p_camera)
    inside = (uv >= _BORDER_PX).all() and (uv <= (camera.width - 1 - _BORDER_PX, camera.height - 1 - _BORDER_PX)).all()
    if not inside:  # also where a point is behind the camera, and NaN
        return False
    return field_px is None or bool((np.hypot(*(uv - (camera.cx, camera.cy)).T) < field_px - _BORDER_PX).all())


def _is_legible(camera: Camera, camera_from_board: Matrix, board: Board, centre: F64) -> bool:
    """Whether the camera sees the board at no grazing angle, and its squares large enough to tell their corners apart."""
    cosine = camera_from_board[:3, 2] @ centre / np.linalg.norm(centre)
    uv = camera.project(apply(camera_from_board, board.corners)).reshape(board.rows, board.columns, 2)
    side = min(np.linalg.norm(np.diff(uv, axis=axis), axis=-1).min() for axis in (0, 1))
    return bool(cosine > np.cos(np.radians(_INCIDENCE_DEG)) and side > _SQUARE_PX)


def write_board_take(path: Path, rig: VirtualRig, truth: BoardTake, *, frames_per_view: int = 1, rng: Generator) -> None:
    """Write `truth` as camera and optical system see it: sources `tof` and `optical`, subject `board`.

    The operator triggers the camera while the board is held: `frames_per_view` frames in the middle of that. The optical system
    streams all the time. Raises RecordingError where the file exists.
    """
    optical = rig.clock("optical").ticks(rig.optical.rate_hz, truth.start_s, truth.end_s)
    markers = _moved(truth.poses(optical), truth.board.marker_centres)
    frames = _while_held(rig, truth, frames_per_view)
    poses = truth.poses(frames)
    streams = {
        "optical": marker_samples(rig, optical, BOARD_SUBJECT, truth.board.marker_names, markers, rng=rng),
        "tof": _tof_samples(rig, frames, lambda k: board_scene(rig, truth.board, poses[k]), rng=rng),
    }
    write_recording(path, rig, Take(action="board"), streams, start_s=truth.start_s)


def _while_held(rig: VirtualRig, truth: BoardTake, frames: int) -> Times:
    """True times of the camera's frames nearest to the middle of each hold. Raises SceneError where a hold has not so many."""
    ticks = rig.clock("tof").ticks(rig.tof.rate_hz, truth.start_s, truth.end_s)
    chosen = []
    for begin, end in truth.held_ns.tolist():
        held = ticks[(ticks >= begin) & (ticks <= end)]
        if len(held) < frames:
            raise SceneError(
                f"the camera takes {len(held)} frames while the board is held, not {frames}", hint="hold it longer, or take fewer"
            )
        middle = np.argsort(np.abs(held - (begin + end) // 2), kind="stable")[:frames]
        chosen.append(np.sort(held[middle]))
    return np.concatenate(chosen)


@dataclass(frozen=True)
class PendulumTake:
    """A pendulum before the camera: pivot (3,) in the world, m; heading (rad) about z of what `swing` calls forwards."""

    swing: Swing
    pivot: F64
    heading: float
    start_ns: int
    start_s: float
    end_s: float

    def marker(self, true_ns: Times) -> F64:
        """(T, 3) centre of the marker at true times (T,), world, m."""
        turned = Rotation.from_euler("z", self.heading).apply(self.swing((true_ns - self.start_ns) / 1e9))
        return self.pivot + turned


def pendulum_take(
    rig: VirtualRig,
    *,
    duration_s: float = 25.0,
    distance_m: float = 1.0,
    length_m: float = 0.65,
    start_s: float = 0.0,
    rng: Generator,
) -> PendulumTake:
    """Draw a pendulum take: the marker rests on the camera's axis, `distance_m` before it, and swings mostly across the image."""
    world_from_camera = invert(rig.camera_from_world)
    rest = apply(world_from_camera, (0.0, 0.0, distance_m))
    across = world_from_camera[:3, 0]
    heading = float(np.arctan2(across[1], across[0])) + rng.choice((-1.0, 1.0)) * rng.uniform(0.2, 0.5)
    motion = swing(duration_s, length_m=length_m, rng=rng)
    start_ns = rig.start_ns + round(start_s * 1e9)
    return PendulumTake(motion, rest + (0.0, 0.0, length_m), heading, start_ns, start_s, start_s + duration_s)


def write_pendulum_take(path: Path, rig: VirtualRig, truth: PendulumTake, *, rng: Generator) -> None:
    """Write `truth` as camera and optical system see it: sources `tof` and `optical`, subject `pendulum`, marker `pendulum`.

    Raises RecordingError where the file exists.
    """
    optical = rig.clock("optical").ticks(rig.optical.rate_hz, truth.start_s, truth.end_s)
    frames = rig.clock("tof").ticks(rig.tof.rate_hz, truth.start_s, truth.end_s)
    places = truth.marker(frames)
    streams = {
        "optical": marker_samples(rig, optical, PENDULUM_SUBJECT, (PENDULUM_MARKER,), truth.marker(optical)[:, None], rng=rng),
        "tof": _tof_samples(rig, frames, lambda k: pendulum_scene(rig, truth.pivot, places[k]), rng=rng),
    }
    write_recording(path, rig, Take(action="pendulum"), streams, start_s=truth.start_s)


def _tof_samples(rig: VirtualRig, true_ns: Times, scene: Callable[[int], PrimitiveScene], *, rng: Generator) -> Iterator[Sample]:
    """The camera's samples of the scenes `scene(k)` at the true times (T,), made one by one while they are taken."""
    clock = rig.clock("tof")
    arrivals = clock.arrivals(true_ns, rng=rng)
    return samples(clock, true_ns, arrivals, lambda k: (as_message(rig, see(rig, scene(k), rng=rng)),))


def _moved(a_from_b: F64, p_b: F64) -> F64:
    """(T, M, 3) points (M, 3) by T transforms (T, 4, 4)."""
    return np.einsum("tij,mj->tmi", a_from_b[:, :3, :3], p_b) + a_from_b[:, None, :3, 3]
