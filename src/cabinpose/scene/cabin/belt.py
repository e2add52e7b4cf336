"""A three-point belt over a posed occupant: two taut ribbons that lie on the body.

Each ribbon runs in planes through its two anchors and a point of the body: the collar bone, the front of the pelvis.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from cabinpose._native import cabin as native
from cabinpose.core.arrays import Floats, Floats32, Ints32
from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import cross
from cabinpose.core.skeleton import INDEX
from cabinpose.scene.cabin.model import Cabin, Seat, SeatSetting, Vector
from cabinpose.scene.cabin.shapes import slab_faces
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
    skin: Floats32, skin_faces: Ints32, joints: Floats, seat: Seat, setting: SeatSetting, cabin: Cabin, *, gap_m: float = 0.004
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
    skin: Floats32, faces: Ints32, bones: Floats,
    start: Vector, through: Vector, end: Vector, front: Vector, gap: float,
) -> Surface:  # fmt: skip
    """One ribbon from `start` to `end` (3,) in the plane with `through`, on the side of the body that `front` points to."""
    course = np.array((start, through, end, front), dtype=np.float64)
    vertices, normals = np.empty((2, STEPS, 3, 3), np.float32), np.empty((2, STEPS, 3, 3), np.float32)
    trunk, webbing = (bones, _GIRTH, len(_TRUNK)), (WEBBING_WIDTH, WEBBING_THICKNESS, gap)
    topology = _ribbon_faces(native.belt_ribbon(skin, faces, trunk, course, webbing, vertices, normals))
    return Surface(
        vertices.reshape(-1, 3),
        normals.reshape(-1, 3),
        topology,
        np.full(len(topology), LABEL["seat_belt"], np.uint8),
        np.full(len(topology), MATERIAL["belt_webbing"], np.uint8),
        np.zeros(len(topology), np.uint8),
    )


@lru_cache(maxsize=2)
def _ribbon_faces(flip: bool) -> Ints32:
    """Triangles of a closed ribbon whose outer grid (STEPS, 3) comes before its inner one."""
    faces = slab_faces(STEPS, 3)
    return np.ascontiguousarray(faces[:, ::-1] if flip else faces)
