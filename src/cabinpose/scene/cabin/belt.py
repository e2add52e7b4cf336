"""A three-point belt over a posed occupant: two taut ribbons that lie on the body.

Each ribbon runs in planes through its two anchors and a point of the body (the collar bone, the front of the pelvis).
In such a plane a taut string around the trunk is the convex hull of the section between the anchors. Three parallel
planes, at the edges and the middle of the webbing, tilt the ribbon with the body.
"""

from __future__ import annotations

from functools import lru_cache

import numba as nb
import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import cross
from cabinpose.core.skeleton import INDEX
from cabinpose.scene.cabin.model import Cabin, Seat, SeatSetting, Vector
from cabinpose.scene.labels import ID as LABEL
from cabinpose.scene.materials import ID as MATERIAL
from cabinpose.scene.surface import Surface, merge

WEBBING_WIDTH = 0.047  # UN R16: at least 46 mm wide under load
WEBBING_THICKNESS = 0.0015
STEPS = 40  # cross-sections of a ribbon

# Bones by which a triangle of the skin is told to be trunk or not: ends, the piece of the bone (0 first end .. 1 second),
# and the girth of the flesh around it (m). The roots of arms and thighs belong to the trunk: the belts lie on them.
_TRUNK = (
    ("neck", "chest", 0.0, 1.0, 0.15), ("chest", "hip", 0.0, 1.0, 0.15), ("hip", "lpelvis", 0.0, 1.0, 0.14),
    ("hip", "rpelvis", 0.0, 1.0, 0.14), ("neck", "lshoulder", 0.0, 1.0, 0.08), ("neck", "rshoulder", 0.0, 1.0, 0.08),
    ("lshoulder", "lelbow", 0.0, 0.3, 0.06), ("rshoulder", "relbow", 0.0, 0.3, 0.06),
    ("lpelvis", "lknee", 0.0, 0.4, 0.085), ("rpelvis", "rknee", 0.0, 0.4, 0.085),
)  # fmt: skip
_OTHER = (
    ("lpelvis", "lknee", 0.4, 1.0, 0.085), ("rpelvis", "rknee", 0.4, 1.0, 0.085), ("neck", "head", 0.0, 1.0, 0.07),
    ("head", "head", 0.0, 1.0, 0.16), ("lshoulder", "lelbow", 0.3, 1.0, 0.055), ("rshoulder", "relbow", 0.3, 1.0, 0.055),
    ("lelbow", "lwrist", 0.0, 1.0, 0.045), ("relbow", "rwrist", 0.0, 1.0, 0.045), ("lwrist", "lhand", 0.0, 1.0, 0.05),
    ("rwrist", "rhand", 0.0, 1.0, 0.05), ("lhand", "lhand", 0.0, 1.0, 0.09), ("rhand", "rhand", 0.0, 1.0, 0.09),
    ("lknee", "lankle", 0.0, 1.0, 0.06), ("rknee", "rankle", 0.0, 1.0, 0.06),
)  # fmt: skip
_BONES = np.array([(INDEX[a], INDEX[b]) for a, b, *_ in _TRUNK + _OTHER], dtype=np.int64)
_PIECE = np.array([piece for _, _, *piece, _ in _TRUNK + _OTHER])[:, :, None]
_GIRTH = np.array([girth for *_, girth in _TRUNK + _OTHER])


def belt_surface(
    skin: NDArray[np.float32],
    skin_faces: NDArray[np.int32],
    joints: NDArray[np.float64],
    seat: Seat,
    setting: SeatSetting,
    cabin: Cabin,
    *,
    gap_m: float = 0.004,
) -> Surface:
    """The belt of a seat over its occupant, vehicle frame, class seat_belt, instance 0.

    skin: (V, 3) the posed body, or whatever the belt lies on (a clothed surface), m · skin_faces: (F, 3) ·
    joints: (20, 3) of the same pose · gap_m: clearance of the webbing from the surface. Raises ConfigError for a
    seat that has no belt or is not in the cabin.
    """
    if seat.slot not in cabin.seats:
        raise ConfigError(f"cabin '{cabin.name}' has no seat '{seat.slot}'", hint=f"its seats: {', '.join(cabin.seats)}")
    anchors = seat.belt_anchors(setting)
    if anchors is None:
        raise ConfigError(f"seat '{seat.slot}' of cabin '{cabin.name}' has no belt", hint="leave the belt out for this seat")
    at = {name: joints[i] for name, i in INDEX.items()}
    frame = seat.vehicle_from_seat(setting)[:3, :3]
    pelvis = 0.5 * (at["lpelvis"] + at["rpelvis"])
    up = at["chest"] - pelvis
    up = up / np.linalg.norm(up)
    across = at["lpelvis"] - at["rpelvis"]
    ahead = cross(across, up)
    ahead = ahead / np.linalg.norm(ahead)
    size = float(np.linalg.norm(at["neck"] - pelvis)) / 0.52  # against an adult's trunk
    near = min(("lshoulder", "rshoulder"), key=lambda name: float(np.linalg.norm(at[name] - anchors.upper)))
    collar = 0.52 * at["neck"] + 0.48 * at[near] + 0.03 * size * ahead
    front_of_pelvis = pelvis + size * (0.10 * ahead + 0.065 * up)
    vertices = np.ascontiguousarray(skin, dtype=np.float32)
    faces = np.ascontiguousarray(skin_faces, dtype=np.int32)
    ends = joints[_BONES]
    bones = ends[:, :1] + _PIECE * (ends[:, 1:] - ends[:, :1])  # (bones, 2, 3)
    ribbons = (
        (anchors.upper, collar, anchors.buckle, 0.4 * ahead + 0.6 * frame[:, 0]),
        (anchors.outer_lap, front_of_pelvis, anchors.buckle, ahead + up),
    )
    return merge([_ribbon(vertices, faces, bones, start, by, end, front, gap_m) for start, by, end, front in ribbons])


def _ribbon(
    skin: NDArray[np.float32], faces: NDArray[np.int32], bones: NDArray[np.float64],
    start: Vector, through: Vector, end: Vector, front: Vector, gap: float,
) -> Surface:  # fmt: skip
    """One ribbon from `start` to `end` (3,) in the plane with `through`, on the side of the body that `front` points to."""
    x = (end - start) / np.linalg.norm(end - start)
    y = (through - start) - x * float((through - start) @ x)
    y = y / np.linalg.norm(y)
    normal = cross(x, y)
    toward = np.array([front @ x, front @ y])
    axes = np.stack((x, y, normal))
    goal = np.array([float((end - start) @ x), 0.0])
    offsets = np.array([-0.5, 0.0, 0.5]) * WEBBING_WIDTH
    lines = _lines(skin, faces, bones, _GIRTH, len(_TRUNK), axes, start, offsets, goal, toward, STEPS, gap)
    middle = start + offsets[None, :, None] * normal + lines @ axes[:2]  # (STEPS, 3, 3)
    along = np.empty_like(middle)
    along[1:-1], along[0], along[-1] = middle[2:] - middle[:-2], middle[1] - middle[0], middle[-1] - middle[-2]
    over = _cross(along, middle[:, 2:] - middle[:, :1])
    over /= np.maximum(np.sqrt(np.sum(over * over, axis=-1, keepdims=True)), 1e-12)
    half = STEPS // 2
    inside = start + 0.5 * (end - start)  # the string bends around the body, away from the chord of its anchors
    flip = float((middle[half, 1] - inside) @ over[half, 1]) < 0
    if flip:
        over = -over
    outer = middle + WEBBING_THICKNESS * over
    topology = _ribbon_faces(flip)
    return Surface(
        np.concatenate((outer.reshape(-1, 3), middle.reshape(-1, 3))).astype(np.float32),
        np.concatenate((over.reshape(-1, 3), -over.reshape(-1, 3))).astype(np.float32),
        topology,
        np.full(len(topology), LABEL["seat_belt"], np.uint8),
        np.full(len(topology), MATERIAL["belt_webbing"], np.uint8),
        np.zeros(len(topology), np.uint8),
    )


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(
        (
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ),
        axis=-1,
    )


@lru_cache(maxsize=2)
def _ribbon_faces(flip: bool) -> NDArray[np.int32]:
    """Triangles of a closed ribbon whose outer grid (STEPS, 3) comes before its inner one."""
    index = np.arange(STEPS * 3).reshape(STEPS, 3)
    quads = np.stack((index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]), axis=-1).reshape(-1, 4)
    rim = np.concatenate((index[0, :], index[1:, -1], index[-1, -2::-1], index[-2:0:-1, 0]))
    side = np.stack((rim, np.roll(rim, -1), np.roll(rim, -1) + STEPS * 3, rim + STEPS * 3), axis=-1)
    quads = np.concatenate((quads, quads[:, ::-1] + STEPS * 3, side))
    faces = np.concatenate((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]])).astype(np.int32)
    return np.ascontiguousarray(faces[:, ::-1] if flip else faces)


@nb.njit(cache=True, nogil=True)
def _sections(skin, faces, bones, girth, trunk, axes, origin, offsets):  # type: ignore[no-untyped-def]
    """(K, N, 2) points and (K,) their counts: where planes `offsets` (K,) along axes[2] cut the trunk's triangles."""
    n0, n1, n2 = axes[2]
    shift = n0 * origin[0] + n1 * origin[1] + n2 * origin[2]
    signed = np.empty(len(skin), np.float32)
    for i in range(len(skin)):
        signed[i] = n0 * skin[i, 0] + n1 * skin[i, 1] + n2 * skin[i, 2] - shift
    lowest, highest = offsets.min(), offsets.max()
    points = np.empty((len(offsets), 4096, 2))
    counts = np.zeros(len(offsets), np.int64)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        da, db, dc = signed[a], signed[b], signed[c]
        low, high = min(da, db, dc), max(da, db, dc)
        if high <= lowest or low > highest:
            continue
        cut = False
        for row in range(len(offsets)):
            cut = cut or (low <= offsets[row] < high)
        if not cut:
            continue
        x, y, z = (
            (skin[a, 0] + skin[b, 0] + skin[c, 0]) / 3,
            (skin[a, 1] + skin[b, 1] + skin[c, 1]) / 3,
            (skin[a, 2] + skin[b, 2] + skin[c, 2]) / 3,
        )
        of_trunk, of_other = np.inf, np.inf
        for m in range(len(bones)):
            near = _square_to_segment(x, y, z, bones[m, 0], bones[m, 1]) / (girth[m] * girth[m])
            if m < trunk:
                of_trunk = min(of_trunk, near)
            else:
                of_other = min(of_other, near)
            if of_other < of_trunk and m >= trunk:
                break
        if of_other < of_trunk:
            continue
        for row in range(len(offsets)):
            for i, j in ((a, b), (b, c), (c, a)):
                di, dj = signed[i] - offsets[row], signed[j] - offsets[row]
                if (di > 0) != (dj > 0) and counts[row] < points.shape[1]:
                    s = di / (di - dj)
                    u = v = 0.0
                    for k in range(3):
                        q = skin[i, k] + s * (skin[j, k] - skin[i, k]) - origin[k]
                        u += q * axes[0, k]
                        v += q * axes[1, k]
                    points[row, counts[row], 0], points[row, counts[row], 1] = u, v
                    counts[row] += 1
    return points, counts


@nb.njit(cache=True, nogil=True, inline="always")
def _square_to_segment(x, y, z, a, b):  # type: ignore[no-untyped-def]
    """Squared distance of a point from a segment, m2."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    px, py, pz = x - a[0], y - a[1], z - a[2]
    length = ux * ux + uy * uy + uz * uz
    t = 0.0 if length == 0 else min(max((px * ux + py * uy + pz * uz) / length, 0.0), 1.0)
    dx, dy, dz = px - t * ux, py - t * uy, pz - t * uz
    return dx * dx + dy * dy + dz * dz


@nb.njit(cache=True, nogil=True)
def _hull(points):  # type: ignore[no-untyped-def]
    """The convex hull of (N, 2) points, counter-clockwise (Andrew's monotone chain)."""
    n = len(points)
    if n < 3:
        return points.copy()
    order = np.argsort(points[:, 0], kind="mergesort")
    chain = np.empty((2 * n + 2, 2))
    k = 0
    for step in range(2):
        first = k
        for r in range(n):
            p = points[order[r if step == 0 else n - 1 - r]]
            while k >= first + 2:
                q, o = chain[k - 1], chain[k - 2]
                if (q[0] - o[0]) * (p[1] - o[1]) - (q[1] - o[1]) * (p[0] - o[0]) <= 0:
                    k -= 1
                else:
                    break
            chain[k] = p
            k += 1
        k -= 1  # the last point of a chain starts the other
    return chain[:k].copy()


@nb.njit(cache=True, nogil=True)
def _lines(skin, faces, bones, girth, trunk, axes, start, offsets, goal, front, steps, gap):  # type: ignore[no-untyped-def]
    """(steps, K, 2): strings in K parallel planes, `offsets` (K,) along axes[2]; stations share their angle.

    Seen from the middle of the chord a convex string turns one way, so an angle names one point of each string; the
    stations are even in length along the middle one.
    """
    result = np.empty((steps, len(offsets), 2))
    angles = np.empty(steps)
    points, counts = _sections(skin, faces, bones, girth, trunk, axes, start, offsets)
    middle = len(offsets) // 2
    for turn in range(len(offsets)):
        row = middle if turn == 0 else (turn - 1 if turn <= middle else turn)
        path = _taut(points[row, : counts[row]], goal, front, gap)
        if turn == 0:
            line = _resample(path, steps)
            for i in range(steps):
                angles[i] = _angle(line[i], goal)
                result[i, row] = line[i]
            continue
        k = 0
        for i in range(steps):
            while k < len(path) - 2 and _angle(path[k + 1], goal) > angles[i]:
                k += 1
            low, high = _angle(path[k], goal), _angle(path[k + 1], goal)
            t = 0.0
            if low > high:  # where the ray at this angle meets the piece: bisection keeps it free of singular cases
                a, b = 0.0, 1.0
                for _ in range(24):
                    t = 0.5 * (a + b)
                    if _angle(path[k] + t * (path[k + 1] - path[k]), goal) > angles[i]:
                        a = t
                    else:
                        b = t
            result[i, row] = path[k] + t * (path[k + 1] - path[k])
        result[0, row], result[-1, row] = path[0], path[-1]
    for i in range(steps):  # webbing tilts at most so far: rows that lie deeper are lifted from the body
        radius = np.sqrt((result[i, :, 0] - 0.5 * goal[0]) ** 2 + result[i, :, 1] ** 2)
        for row in range(len(offsets)):
            floor = radius.max() - 0.45 * abs(offsets[-1] - offsets[0])
            if radius[row] < floor:
                result[i, row, 0] = 0.5 * goal[0] + (result[i, row, 0] - 0.5 * goal[0]) * floor / radius[row]
                result[i, row, 1] *= floor / radius[row]
    return result


@nb.njit(cache=True, nogil=True)
def _angle(p, goal):  # type: ignore[no-untyped-def]
    """Angle of a point seen from the middle of the chord (0, 0)-goal, rad: pi at the start, 0 at the goal, either way round."""
    return abs(np.arctan2(p[1], p[0] - 0.5 * goal[0]))


@nb.njit(cache=True, nogil=True)
def _taut(section, goal, front, gap):  # type: ignore[no-untyped-def]
    """(N, 2): a string from (0, 0) to `goal` around the section on its `front` side, `gap` clear of it.

    From an anchor within the hull (a buckle pressed into a hip) the string goes straight to the nearest corner.
    """
    ring = _hull(section)
    n = len(ring)
    cloud = np.empty((8 * n + 2, 2))
    for i in range(n):  # the hull grown by the gap: eight points around each of its corners
        for k in range(8):
            cloud[8 * i + k, 0] = ring[i, 0] + 1.08 * gap * np.cos(0.25 * np.pi * k)
            cloud[8 * i + k, 1] = ring[i, 1] + 1.08 * gap * np.sin(0.25 * np.pi * k)
    cloud[8 * n, 0] = cloud[8 * n, 1] = 0.0
    cloud[8 * n + 1] = goal
    ring = _hull(cloud)
    m = len(ring)
    i0 = i1 = 0
    for i in range(m):
        if np.sum(ring[i] ** 2) < np.sum(ring[i0] ** 2):
            i0 = i
        if np.sum((ring[i] - goal) ** 2) < np.sum((ring[i1] - goal) ** 2):
            i1 = i
    chord = np.zeros((2, 2))
    chord[1] = goal
    best, reach = chord, -1e9
    for way in (1, -1):
        count = ((i1 - i0) * way) % m + 1
        score = -1e8
        for k in range(count):
            p = ring[(i0 + way * k) % m]
            score = max(score, p[0] * front[0] + p[1] * front[1])
        if score > reach:
            reach = score
            best = np.empty((count + 2, 2))
            best[0], best[-1] = chord[0], chord[1]
            for k in range(count):
                best[k + 1] = ring[(i0 + way * k) % m]
    return best


@nb.njit(cache=True, nogil=True)
def _resample(path, steps):  # type: ignore[no-untyped-def]
    """(steps, 2) points at even arc length along a polyline (N, 2)."""
    n = len(path)
    along = np.zeros(n)
    for i in range(1, n):
        along[i] = along[i - 1] + np.sqrt(np.sum((path[i] - path[i - 1]) ** 2))
    result = np.empty((steps, 2))
    k = 0
    for s in range(steps):
        target = along[-1] * s / (steps - 1)
        while k < n - 2 and along[k + 1] < target:
            k += 1
        span = along[k + 1] - along[k] if n > 1 else 0.0
        t = min(max((target - along[k]) / span, 0.0), 1.0) if span > 0 else 0.0
        result[s] = path[k] + t * (path[min(k + 1, n - 1)] - path[k])
    return result
