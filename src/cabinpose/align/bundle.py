"""camera_from_world from every pixel at once: bundle adjustment of the camera and of the board's poses.

The optical system knows where the board is, and so where each of its corners is. In a view, the markers alone give depth by a
plane whose tilt a few pixels decide; all corners of all views against their known places leave six numbers to thousands of
pixels. What the optical system says of the board is noisy as well: so the board's pose in each view is free, held by its
markers as seen by both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.align.board import Board
from cabinpose.align.extrinsics import ExtrinsicsResult, skew, world_from_boards
from cabinpose.core import AlignmentError, Camera, Matrix, apply, rotation_vector

F64 = NDArray[np.float64]

_HUBER = 2.5  # of the noise: where a residual stops counting by its square
_ROUNDS = 60
_STEP_M = 1e-6  # of the numeric derivative of the projection
_LEAST_PX, _LEAST_M = 1e-4, 1e-6  # noise that is assumed at least: exact data have none


@dataclass(frozen=True)
class BoardSightings:
    """V views of a board by both systems: corners (V, N, 2) and markers (V, M, 2) px in the image, markers (V, M, 3) m in the
    optical world; NaN = not seen.
    """

    board: Board
    corners: F64
    marker_uv: F64
    p_world: F64

    def taken(self, views: NDArray[np.intp] | NDArray[np.bool_]) -> BoardSightings:
        """Some of the views."""
        return BoardSightings(self.board, self.corners[views], self.marker_uv[views], self.p_world[views])

    @property
    def points(self) -> F64:
        """(N + M, 3) corners and markers in the board frame."""
        return np.concatenate((self.board.corners, self.board.marker_centres))

    @property
    def pixels(self) -> F64:
        """(V, N + M, 2)."""
        return np.concatenate((self.corners, self.marker_uv), axis=1)


def refine_camera_from_world(
    camera: Camera, sightings: BoardSightings, start: ExtrinsicsResult, *, lens: bool = False, rounds: int = 3
) -> ExtrinsicsResult:
    """camera_from_world that fits corners, markers in the image and markers in the world best.

    A view counts where its corners and at least three markers in the world are known; pairs that `start` left
    out stay out. Minimised: Huber's loss of the distances of corners and of markers in the image, and of the optical markers from
    the board, each over its own noise, over camera_from_world and a pose of the board per view. The three noises are found from
    the residuals, `rounds` times. lens: fit the camera's intrinsics along with it, starting from `camera`; the optical
    system's lengths decide on focal length and principal point what the boards' own perspective leaves open, but its errors of
    scale go into them as well. Raises AlignmentError where fewer than three views are left.
    """
    left_out = ~start.used & np.isfinite(start.residual_m)
    world = np.where(left_out[..., None], np.nan, sightings.p_world)
    boards = world_from_boards(world, sightings.board)
    good = np.asarray(np.isfinite(boards).all(axis=(1, 2)) & np.isfinite(sightings.corners).all(axis=(1, 2)))
    if good.sum() < 3:
        raise AlignmentError(
            f"{good.sum()} views have all corners and three markers, 3 needed", hint="record more views of the board"
        )
    kept = replace(sightings, p_world=world).taken(good)
    state = _State(start.camera_from_world, boards[good], camera, lens)
    noise = _Noise(0.1, 0.2, 0.0005)
    for _ in range(rounds):
        state, normal, cost = _solve(kept, state, noise)
        noise = _noise(kept, state, noise)
    state, normal, cost = _solve(kept, state, noise)
    residual = np.full(start.residual_m.shape, np.nan)
    pixel, place = _residuals(kept, state)
    residual[good] = np.linalg.norm(place, axis=-1)
    # Held out: every view once, its board placed by the optical system alone.
    out_px = []
    for group in np.array_split(np.arange(len(kept.p_world)), min(len(kept.p_world), 10)):
        rest = np.setdiff1d(np.arange(len(kept.p_world)), group)
        if len(rest) < 3:
            continue
        other, _, _ = _solve(kept.taken(rest), replace(state, boards=state.boards[rest]), noise)
        blind = replace(other, boards=boards[good][group])
        out_px.append(_residuals(kept.taken(group), blind)[0][:, : len(kept.board.corners)])
    rms = np.sqrt(np.nanmean(np.sum(place**2, axis=-1)))
    return replace(
        start,
        camera_from_world=state.camera_from_world,
        residual_m=residual,
        used=np.isfinite(residual),
        rms_m=float(rms),
        held_out_rms_m=float("nan"),
        covariance=np.asarray(np.linalg.inv(normal)[:6, :6] * cost, np.float64),
        method="corners",
        rms_px=float(np.sqrt(np.mean(np.sum(pixel[:, : len(kept.board.corners)] ** 2, axis=-1)))),
        held_out_rms_px=float(np.sqrt(np.mean(np.sum(np.concatenate(out_px) ** 2, axis=-1)))) if out_px else float("nan"),
        sigma_px=noise.corner_px,
        sigma_m=noise.place_m,
        camera=state.camera,
    )


class _Noise(NamedTuple):
    """Standard deviations of one coordinate."""

    corner_px: float
    mark_px: float  # a saturated disc of few pixels, several times less certain than a corner
    place_m: float  # of the optical system's markers, with how well they sit on the board

    def pixels(self, sightings: BoardSightings) -> F64:
        """(N + M,) for corners and markers in the image."""
        return np.repeat((self.corner_px, self.mark_px), (sightings.corners.shape[1], sightings.marker_uv.shape[1]))


@dataclass(frozen=True)
class _State:
    camera_from_world: Matrix
    boards: F64  # (V, 4, 4) world_from_board
    camera: Camera
    lens: bool  # whether the camera is free


def _places(sightings: BoardSightings, state: _State) -> F64:
    """(V, N + M, 3) all points of the board in the world."""
    points = sightings.points
    return np.asarray(np.einsum("vij,nj->vni", state.boards[:, :3, :3], points) + state.boards[:, None, :3, 3])


def _residuals(sightings: BoardSightings, state: _State) -> tuple[F64, F64]:
    """Pixels seen less predicted (V, N + M, 2), and markers in the world less those of the board (V, M, 3)."""
    places = _places(sightings, state)
    predicted = state.camera.project(apply(state.camera_from_world, places), folded=True)
    return sightings.pixels - predicted, sightings.p_world - places[:, len(sightings.board.corners) :]


def _huber(length: F64, sigma: F64 | float) -> F64:
    """Weights of Huber's loss; 0 for what is missing."""
    scaled = np.where(np.isfinite(length), length, np.inf) / sigma
    return np.where(scaled <= _HUBER, 1.0, _HUBER / np.maximum(scaled, _HUBER))


def _cost(sightings: BoardSightings, state: _State, noise: _Noise) -> float:
    pixel, place = _residuals(sightings, state)
    total = 0.0
    for residual, sigma in ((pixel, noise.pixels(sightings)), (place, noise.place_m)):
        scaled = np.linalg.norm(residual, axis=-1) / sigma
        loss = np.where(scaled <= _HUBER, 0.5 * scaled**2, _HUBER * (scaled - 0.5 * _HUBER))
        total += float(np.nansum(loss))
    return total


def _solve(sightings: BoardSightings, state: _State, noise: _Noise) -> tuple[_State, F64, float]:
    """Levenberg-Marquardt; the state, the information on camera_from_world (and the lens), and the cost per degree of freedom."""
    damping, cost = 1e-6, _cost(sightings, state, noise)
    size = 15 if state.lens else 6
    reduced = np.eye(size)
    for _ in range(_ROUNDS):
        head, rest, both, pull_head, pull_rest = _normal(sightings, state, noise)
        reduced, _ = _schur(head, rest, both, pull_head, pull_rest)
        damp = 1 + damping
        step, per_view = _step(head * _damped(size, damp), rest * _damped(6, damp), both, pull_head, pull_rest)
        tried = _moved(state, step, per_view)
        after = _cost(sightings, tried, noise)
        if after <= cost:
            small = max(np.abs(step[:6]).max(), np.abs(per_view).max()) < 1e-10 or cost - after < 1e-9 * cost
            state, cost, damping = tried, after, max(damping / 10, 1e-12)
            if small:
                break
        else:
            damping = max(damping * 10, 1e-9)
            if damping > 1e6:
                break
    pixel, place = _residuals(sightings, state)
    numbers = np.isfinite(pixel).sum() + np.isfinite(place).sum() - size - 6 * len(state.boards)
    return state, reduced, 2 * cost / max(float(numbers), 1.0)


def _damped(size: int, factor: float) -> F64:
    return np.ones((size, size)) + (factor - 1) * np.eye(size)


def _normal(sightings: BoardSightings, state: _State, noise: _Noise) -> tuple[F64, F64, F64, F64, F64]:
    """Normal equations of small motions: exp(x) camera_from_world, exp(y) world_from_board per view."""
    places = _places(sightings, state)
    p_camera = apply(state.camera_from_world, places)
    by_point = _derivative(state.camera, p_camera)  # (V, K, 2, 3)
    pixel, place = _residuals(sightings, state)
    sigma = noise.pixels(sightings)
    weight = _huber(np.linalg.norm(pixel, axis=-1), sigma) / sigma**2
    pixel = np.where(weight[..., None] > 0, np.nan_to_num(pixel), 0.0)
    head_j = np.concatenate((-by_point @ skew(p_camera), by_point), axis=-1)  # (V, K, 2, 6)
    if state.lens:
        head_j = np.concatenate((head_j, _by_lens(state.camera, p_camera)), axis=-1)  # (V, K, 2, 15)
    by_place = by_point @ state.camera_from_world[:3, :3]
    view_j = np.concatenate((-by_place @ skew(places), by_place), axis=-1)
    head = np.einsum("vkia,vk,vkib->ab", head_j, weight, head_j)
    both = np.einsum("vkia,vk,vkib->vab", head_j, weight, view_j)
    rest = np.einsum("vkia,vk,vkib->vab", view_j, weight, view_j)
    pull_head = np.einsum("vkia,vk,vki->a", head_j, weight, pixel)
    pull_rest = np.einsum("vkia,vk,vki->va", view_j, weight, pixel)
    marks = places[:, len(sightings.board.corners) :]
    weight = _huber(np.linalg.norm(place, axis=-1), noise.place_m) / noise.place_m**2
    place = np.where(weight[..., None] > 0, np.nan_to_num(place), 0.0)
    mark_j = np.concatenate((-skew(marks), np.broadcast_to(np.eye(3), (*marks.shape, 3))), axis=-1)
    rest = rest + np.einsum("vkia,vk,vkib->vab", mark_j, weight, mark_j)
    pull_rest = pull_rest + np.einsum("vkia,vk,vki->va", mark_j, weight, place)
    return head, rest, both, pull_head, pull_rest


def _schur(head: F64, rest: F64, both: F64, pull_head: F64, pull_rest: F64) -> tuple[F64, F64]:
    """The views' poses eliminated: (6, 6) and (6,), or 15."""
    inverse = np.linalg.inv(rest)
    reduced = head - np.einsum("vab,vbc,vdc->ad", both, inverse, both)
    pull = pull_head - np.einsum("vab,vbc,vc->a", both, inverse, pull_rest)
    return np.asarray(reduced, np.float64), np.asarray(pull, np.float64)


def _step(head: F64, rest: F64, both: F64, pull_head: F64, pull_rest: F64) -> tuple[F64, F64]:
    reduced, pull = _schur(head, rest, both, pull_head, pull_rest)
    step = np.linalg.solve(reduced, pull)
    left = pull_rest - np.einsum("vab,a->vb", both, step)
    return np.asarray(step, np.float64), np.linalg.solve(rest, left[..., None])[..., 0]


def _derivative(camera: Camera, p_camera: F64) -> F64:
    """(..., 2, 3) of the pixel by the point, by central differences."""
    columns = []
    for d in np.eye(3) * _STEP_M:
        ahead, behind = (camera.project(p_camera + sign * d, folded=True) for sign in (1, -1))
        columns.append((ahead - behind) / (2 * _STEP_M))
    return np.nan_to_num(np.stack(columns, axis=-1))


def _lens(camera: Camera) -> F64:
    return np.array((camera.fx, camera.fy, camera.cx, camera.cy, *camera.dist))


def _with_lens(camera: Camera, numbers: F64) -> Camera:
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = numbers.tolist()
    return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, dist=(k1, k2, p1, p2, k3))


def _by_lens(camera: Camera, p_camera: F64) -> F64:
    """(..., 2, 9) of the pixel by (fx, fy, cx, cy, k1, k2, p1, p2, k3), by central differences."""
    numbers = _lens(camera)
    columns = []
    for d in np.diag(np.where(np.arange(9) < 4, 1e-3, 1e-6)):
        ahead, behind = (_with_lens(camera, numbers + sign * d).project(p_camera, folded=True) for sign in (1, -1))
        columns.append((ahead - behind) / (2 * d.sum()))
    return np.nan_to_num(np.stack(columns, axis=-1))


def _moved(state: _State, step: F64, per_view: F64) -> _State:
    boards = np.stack([_nudge(x) @ b for x, b in zip(per_view, state.boards, strict=True)])
    camera = _with_lens(state.camera, _lens(state.camera) + step[6:]) if state.lens else state.camera
    return replace(state, camera_from_world=_nudge(step[:6]) @ state.camera_from_world, boards=boards, camera=camera)


def _nudge(x: F64) -> Matrix:
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rotation_vector(x[:3]), x[3:]
    return result


def _noise(sightings: BoardSightings, state: _State, before: _Noise) -> _Noise:
    """The noise that the residuals show: Huber's sums over what the fit left free.

    Each view's six numbers are shared out between corners and optical markers by how much each says of them; the markers in the
    image, few and less certain than corners, take next to none.
    """
    pixel, place = _residuals(sightings, state)
    _, rest, _, _, _ = _normal(sightings, state, before)
    count = len(sightings.board.corners)
    marks = _places(sightings, state)[:, count:]
    jacobian = np.concatenate((-skew(marks), np.broadcast_to(np.eye(3), (*marks.shape, 3))), axis=-1)
    seen = np.isfinite(place).all(axis=-1)
    mine = np.einsum("vkia,vk,vkib->vab", jacobian, seen / before.place_m**2, jacobian)
    taken = float(np.einsum("vab,vba->", mine, np.linalg.inv(rest)))
    corner, mark = pixel[:, :count], pixel[:, count:]
    out = []
    for residual, sigma, used, least in (
        (corner, before.corner_px, 6 * len(rest) - taken + (15 if state.lens else 6), _LEAST_PX),
        (mark, before.mark_px, 0.0, _LEAST_PX),
        (place, before.place_m, taken, _LEAST_M),
    ):
        weight = _huber(np.linalg.norm(residual, axis=-1), sigma)
        free = max(float(np.isfinite(residual).sum()) - used, 1.0)
        out.append(max(float(np.sqrt(np.nansum(weight * np.sum(residual**2, axis=-1)) / free)), least))
    return _Noise(*out)
