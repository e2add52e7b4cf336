"""Things worn that are not a layer off the skin: shoes, hair that hangs or is tied up, a cap's visor, glasses.

Each is built on the person's own measures at rest and moves with one or two bones.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from cabinpose._native import body
from cabinpose.core import Bools, Floats, Ints
from cabinpose.core import reproducible as rp
from cabinpose.scene import labels, materials
from cabinpose.scene.body.chart import load_chart
from cabinpose.scene.body.coverage import borders, cap_rim_m
from cabinpose.scene.body.kinematics import RestArrays
from cabinpose.scene.body.outfit import COVERING_HAIR, GARMENTS, OVER_HAIR, Outfit
from cabinpose.scene.body.rig import BONE_INDEX
from cabinpose.scene.body.shape import load_shape_space
from cabinpose.scene.body.sheets import Accessory, closing_faces, grid_faces, outward, rigid, rod, sheet, tube

SOLE_M = {"none": 0.0, "trainers": 0.025, "leather": 0.020}
HEEL_BACK_M = 0.008  # how far a shoe reaches behind the heel


@cache
def foot_faces_hidden() -> Bools:
    """(F,) faces of the skin that lie inside a shoe."""
    c = load_chart()
    inside = (c.leg > 0.5) & (c.rest[:, 2] < c.heads["lfoot"][2] - 0.040)
    return np.asarray(inside[load_shape_space().faces].all(axis=1))


@cache
def _leg() -> Ints:
    """The vertices of both legs."""
    return np.flatnonzero(load_chart().leg > 0.5)


def shoe(skin: Floats, rest: RestArrays, side: str, kind: str) -> Accessory:
    """A shoe about the foot: rounded sections from heel to toe, each as wide and high as the foot there."""
    s = 1 if side == "l" else -1
    bone = BONE_INDEX[side + "foot"]
    frame, origin = rest.frames[bone], rest.heads[bone]
    leg = skin[_leg()]
    local = rp.matmul(leg[leg[:, 1] * s > 0] - origin, frame)
    foot = local[local[:, 2] < -0.005]
    floor = foot[:, 2].min()
    back, front = foot[:, 0].min() - HEEL_BACK_M, foot[:, 0].max() + 0.012
    length = front - back
    t = np.array([0.0, 0.02, 0.07, 0.15, 0.25, 0.38, 0.5, 0.62, 0.74, 0.85, 0.93, 0.98, 1.0])
    x = back + t * length
    low, high, top = np.empty(len(x)), np.empty(len(x)), np.empty(len(x))
    for k, at in enumerate(np.clip(x, foot[:, 0].min() + 0.01, foot[:, 0].max() - 0.012)):
        near = foot[np.abs(foot[:, 0] - at) < 0.018]
        low[k], high[k], top[k] = near[:, 1].min(), near[:, 1].max(), near[:, 2].max()
    round_off = np.sqrt(np.clip(1 - rp.power(np.clip((t - 0.72) / 0.28, 0, 1), 2.4), 0, 1)) * np.sqrt(
        np.clip(1 - rp.power(np.clip((0.16 - t) / 0.16, 0, 1), 2.4), 0, 1)
    )
    middle = np.interp(t, t, (low + high) / 2)
    half = np.maximum((high - low) / 2 + 0.007, 0.3 * (high - low).max()) * np.maximum(round_off, 0.35)
    collar = (-0.012 if kind == "trainers" else -0.022) + 0.0 * t
    upper = np.minimum(np.maximum(top + 0.008, floor + 0.030), collar)
    toe_spring = 0.012 * np.clip((t - 0.75) / 0.25, 0, 1) ** 2
    bottom = floor - SOLE_M[kind] + toe_spring
    upper = np.maximum(upper - 0.01 * np.clip((t - 0.9) / 0.1, 0, 1) ** 2, bottom + 0.03)
    # Rounded outline: flat sole, straight walls, domed top.
    outline = np.array(
        [(-0.8, 0.0), (0.8, 0.0), (0.97, 0.06), (1.0, 0.25), (0.98, 0.5), (0.88, 0.75), (0.66, 0.92), (0.3, 1.0)]
        + [(-0.3, 1.0), (-0.66, 0.92), (-0.88, 0.75), (-0.98, 0.5), (-1.0, 0.25), (-0.97, 0.06)]
    )
    sections = np.empty((len(t), len(outline), 3))
    sections[:, :, 0] = x[:, None]
    sections[:, :, 1] = middle[:, None] + half[:, None] * outline[:, 0]
    sections[:, :, 2] = bottom[:, None] + (upper - bottom)[:, None] * outline[:, 1]
    vertices, faces = tube(sections)
    part, material = "foot_left" if side == "l" else "foot_right", GARMENTS["shoes"][kind].material
    made = rigid(rp.matmul(vertices, frame.T) + origin, outward(vertices, faces), side + "foot", part, material)
    sole = vertices[faces][:, :, 2].max(axis=1) < bottom.max() + 0.012
    return Accessory(
        made.vertices, made.faces, made.bones, made.weights, made.label,
        np.where(sole, materials.MATERIAL_ID["rubber"], made.material).astype(np.uint8),
    )  # fmt: skip


def head_box(skin: Floats, eyes: Floats) -> tuple[float, float, float, float]:
    """Half width, front, back and top of the head relative to the point between the eyes, m."""
    head = skin[load_chart().head > 0.9] - eyes
    above = head[head[:, 2] > 0.035]
    return float(above[:, 1].max()), float(above[:, 0].max()), float(above[:, 0].min()), float(above[:, 2].max())


def bun(skin: Floats, eyes: Floats, *, cap: bool) -> Accessory:
    """A knot of hair at the back of the head, below a cap's rim."""
    top = head_box(skin, eyes)[3]
    radius, height = 0.034 * top / 0.116, (-0.2 if cap else 0.4) * top
    head = skin[load_chart().head > 0.9] - eyes
    back = head[(np.abs(head[:, 1]) < 0.02) & (np.abs(head[:, 2] - height) < 0.015)][:, 0].min()
    u, v = np.linspace(0.15, np.pi - 0.15, 8), np.linspace(0, 2 * np.pi, 14, endpoint=False)
    shape = np.stack([rp.sin(u)[:, None] * rp.cos(v), rp.sin(u)[:, None] * rp.sin(v), rp.cos(u)[:, None] * np.ones(14)], axis=2)
    vertices, faces = tube(shape * radius * (0.8, 1.1, 1.0) + eyes + (back - 0.5 * radius, 0.0, height))
    return rigid(vertices, outward(vertices - vertices.mean(axis=0), faces), "head", "hair", "hair")


def hanging_hair(skin: Floats, eyes: Floats, neck: Floats, *, cap: bool) -> Accessory:
    """Long hair: from inside the hair on the head, or a cap's rim, round its back and down to below the shoulders.

    It lies on the head and hangs straight down from where that is widest, thick in the middle and thin along its borders.
    """
    half, _, back, top = head_box(skin, eyes)
    middle_x, size = back * 0.5, top / 0.116
    columns, rows = 30, 14
    angle = np.linspace(np.radians(64), np.radians(296), columns)
    behind = rp.sin(np.linspace(0, np.pi, columns)) ** 2
    drop = np.linspace(0, 1, rows)[:, None]
    ends = neck[2] - eyes[2] - 0.03 - 0.07 * behind + 0.012 * rp.sin(5.3 * angle) * rp.sin(2.1 * angle + 1.0)
    begins = size * cap_rim_m((middle_x + half * rp.cos(angle)) / size) if cap else np.full(columns, 0.45 * top)
    z = begins + drop * (ends - begins)
    head = skin[(load_chart().head > 0.5) & (borders()["ears"] < 0)] - eyes - (middle_x, 0, 0)
    turn = np.broadcast_to((angle + np.pi) % (2 * np.pi) - np.pi, z.shape)
    radius = np.empty(len(head) + z.size)
    body.hang(
        down=np.concatenate([-head[:, 2], -z.ravel()]),
        radius=np.concatenate([rp.hypot(head[:, 0], head[:, 1]), np.zeros(z.size)]),
        angle=np.concatenate([rp.arctan2(head[:, 1], head[:, 0]), turn.ravel()]),
        narrowing=np.full(48, 0.12),
        out=radius,
    )
    strands = 0.003 * rp.sin(17 * angle + 2 * rp.sin(5 * angle)) * drop
    outer = radius[len(head) :].reshape(z.shape) + 0.010 + 0.014 * np.minimum(4 * drop, 1) + strands
    thick = 0.004 + 0.022 * behind * np.minimum(4 * drop, 1)
    sheets = [
        np.stack([middle_x + r * rp.cos(angle) - 0.010 * drop, r * rp.sin(angle), z], axis=2) + eyes
        for r in (outer, outer - thick)
    ]
    vertices, faces = sheet(sheets[0], sheets[1])
    weight_neck = np.tile(np.repeat(0.8 * np.clip(drop[:, 0] * 1.6 - 0.6, 0, 1), columns), 2)
    count = len(faces)
    return Accessory(
        vertices, outward(vertices - vertices.mean(axis=0), faces), ("head", "spine01"),
        np.stack([1 - weight_neck, weight_neck], axis=1), np.full(count, labels.LABEL_ID["hair"], np.uint8),
        np.full(count, materials.MATERIAL_ID["hair"], np.uint8),
    )  # fmt: skip


def visor(skin: Floats, eyes: Floats) -> Accessory:
    """The visor of a cap: a bent plate over the brow."""
    half, front, _, top = head_box(skin, eyes)
    size = top / 0.116
    across, out = np.linspace(-1, 1, 15), np.linspace(0, 1, 5)
    reach = 0.072 * size * np.sqrt(1 - 0.75 * across**2)
    base_x = front + 0.012 - (1 - np.sqrt(1 - (0.92 * across) ** 2)) * half * 0.85
    x = base_x + out[:, None] * reach
    y = np.broadcast_to(across * (half + 0.004), x.shape)
    z = 0.052 * size - 0.020 * across**2 - 0.012 * out[:, None] + np.zeros_like(x)
    above = np.stack([x, y, z], axis=2) + eyes
    below = above - (0, 0, 0.005)
    vertices, faces = sheet(above, below)
    of = GARMENTS["headwear"]["cap"]
    return rigid(vertices, outward(vertices - vertices.mean(axis=0), faces), "head", of.label, of.material, of.coat)


def glasses(skin: Floats, eyes: Floats, *, sun: bool) -> list[Accessory]:
    """Two framed lenses before the eyes and their temples: lenses let infrared through, frames do not, nor do dark lenses."""
    half, _, _, top = head_box(skin, eyes)
    size = top / 0.116
    face = skin[load_chart().head > 0.9] - eyes
    bridge = face[(np.abs(face[:, 1]) < 0.008) & (np.abs(face[:, 2]) < 0.012)][:, 0].max()
    x = bridge + 0.004
    grown = 1.18 if sun else 1.0  # dark ones cover more of the face
    lens_w, lens_h, centre = 0.025 * size * grown, 0.019 * size * grown**2, 0.032 * size
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    outline = np.stack(
        [
            np.sign(rp.cos(turn)) * rp.power(np.abs(rp.cos(turn)), 0.7),
            np.sign(rp.sin(turn)) * rp.power(np.abs(rp.sin(turn)), 0.7),
        ],
        axis=1,
    )
    parts = []
    for s in (1.0, -1.0):
        rim = np.stack(
            [x - 0.004 * np.abs(outline[:, 0] + 0.5 * s), s * centre + lens_w * outline[:, 0], lens_h * outline[:, 1] - 0.003],
            axis=1,
        )
        middle = rim.mean(axis=0) + (0.002, 0, 0)
        j = np.arange(24)
        lens = np.stack([j, (j + 1) % 24, np.full(24, 24)], axis=1).astype(np.int32)
        glass = GARMENTS["glasses"]["sun" if sun else "clear"].material
        parts.append(rigid(np.concatenate([rim, middle[None]]) + eyes, lens, "head", "glasses", glass))
        section = ((0.0, 0.0018), (0.0032, 0.0018), (0.0032, -0.0018), (0.0, -0.0018))
        ring = np.stack([_ring(rim, middle, grow, shift) for grow, shift in section]).reshape(-1, 3)
        faces = np.concatenate([grid_faces(4, 24, closed=True), closing_faces(4, 24)])
        parts.append(rigid(ring + eyes, outward(ring, faces), "head", "glasses", "hard_plastic"))
        ear_x, ear_y = -0.088 * size, half + 0.004
        parts.append(
            rod(np.array([x - 0.003, s * (centre + lens_w), 0.006]) + eyes, np.array([ear_x, s * ear_y, 0.004]) + eyes, 0.002)
        )
    parts.append(rod(np.array([x, centre - lens_w, 0.004]) + eyes, np.array([x, lens_w - centre, 0.004]) + eyes, 0.0016))
    return parts


def _ring(rim: Floats, middle: Floats, grow: float, shift: float) -> Floats:
    away = rim - middle
    return np.asarray(rim + away / np.linalg.norm(away, axis=1)[:, None] * grow + (shift, 0, 0))


def accessories(skin: Floats, rest: RestArrays, eyes: Floats, outfit: Outfit) -> list[Accessory]:
    """All of an outfit, for the bare skin (V, 3) at rest, m, root axes."""
    made: list[Accessory] = []
    if outfit.shoes != "none":
        made += [shoe(skin, rest, side, outfit.shoes) for side in "lr"]
    capped, covered = outfit.headwear in OVER_HAIR, outfit.headwear in COVERING_HAIR
    if outfit.hair == "bun" and not covered:
        made.append(bun(skin, eyes, cap=capped))
    if outfit.hair == "long" and not covered:
        made.append(hanging_hair(skin, eyes, rest.heads[BONE_INDEX["neck01"]], cap=capped))
    if outfit.headwear == "cap":
        made.append(visor(skin, eyes))
    if outfit.glasses != "none":
        made += glasses(skin, eyes, sun=outfit.glasses == "sun")
    return made
