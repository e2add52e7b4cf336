"""The belt lies on the body, outside of it, and hangs from its anchors."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cabinpose.core.errors import ConfigError
from cabinpose.core.skeleton import INDEX
from cabinpose.scene.cabin import PRESETS, Cabin, belt_surface, build_cabin
from cabinpose.scene.labels import ID as LABEL


def dummy(cabin: Cabin, slot: str, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Skin, faces and joints of a seated dummy: an ellipsoid for a trunk, one for a head, capsules for arms and legs."""
    seat = cabin.seats[slot]
    pose = seat.vehicle_from_back(seat.default)
    at = {
        "hip": (0.0, 0, 0.10), "lpelvis": (0, 0.085, 0), "rpelvis": (0, -0.085, 0), "chest": (-0.02, 0, 0.34),
        "neck": (0.0, 0, 0.52), "head": (0.06, 0, 0.60), "lshoulder": (0, 0.18, 0.46), "rshoulder": (0, -0.18, 0.46),
        "lelbow": (0.12, 0.26, 0.22), "relbow": (0.12, -0.26, 0.22), "lwrist": (0.35, 0.22, 0.20), "rwrist": (0.35, -0.22, 0.20),
        "lhand": (0.43, 0.20, 0.2), "rhand": (0.43, -0.20, 0.2), "lknee": (0.40, 0.12, -0.02), "rknee": (0.40, -0.12, -0.02),
        "lankle": (0.42, 0.12, -0.42), "rankle": (0.42, -0.12, -0.42), "lfoot": (0.55, 0.12, -0.4), "rfoot": (0.55, -0.12, -0.4),
    }  # fmt: skip
    joints = np.zeros((20, 3))
    for name, p in at.items():
        joints[INDEX[name]] = scale * np.array(p)
    trunk = trimesh.creation.icosphere(4)
    trunk.apply_scale((0.125, 0.185, 0.37))
    trunk.apply_translation((0.01, 0, 0.24))
    pieces = [trunk, trimesh.creation.icosphere(3, 0.1).apply_translation((0.06, 0, 0.68))]
    for a, b, r in (("lshoulder", "lelbow", 0.05), ("rshoulder", "relbow", 0.05), ("lelbow", "lwrist", 0.04),
                    ("relbow", "rwrist", 0.04), ("lpelvis", "lknee", 0.08), ("rpelvis", "rknee", 0.08)):  # fmt: skip
        length = float(np.linalg.norm(np.subtract(at[b], at[a])))
        limb = trimesh.creation.capsule(length, r, count=(24, 24))
        limb.apply_transform(trimesh.geometry.align_vectors((0, 0, 1), np.subtract(at[b], at[a])))
        pieces.append(limb.apply_translation(at[a]))
    body = trimesh.util.concatenate(pieces)
    vertices = scale * np.asarray(body.vertices)
    move = lambda p: p @ pose[:3, :3].T + pose[:3, 3]  # noqa: E731
    return move(vertices).astype(np.float32), body.faces.astype(np.int32), move(joints)


@pytest.mark.parametrize(("name", "scale"), [*((name, 1.0) for name in PRESETS), ("sedan", 0.75)])
def test_belt_lies_on_the_trunk_and_not_in_it(name: str, scale: float) -> None:
    cabin = build_cabin(name)
    for slot in ("driver", "rear_right"):
        seat = cabin.seats[slot]
        skin, faces, joints = dummy(cabin, slot, scale)
        belt = belt_surface(skin, faces, joints, seat, seat.default, cabin)
        closed = trimesh.Trimesh(belt.vertices.astype(float), belt.faces, process=True)
        assert closed.is_watertight
        assert closed.volume > 0
        assert (belt.label == LABEL["seat_belt"]).all()
        assert np.isfinite(belt.normals).all()
        trunk = trimesh.Trimesh(skin.astype(float), faces, process=False).split()[0]
        depth = trimesh.proximity.signed_distance(trunk, belt.vertices[::3].astype(float))
        anchored = np.min(
            [np.linalg.norm(belt.vertices[::3] - p, axis=1) for p in (seat.belt.buckle, seat.belt.outer_lap)], axis=0
        )  # type: ignore[union-attr]
        assert depth[anchored > 0.05].max() < 5e-3, slot  # the skin of an armpit may count as arm
        body = trimesh.Trimesh(skin.astype(float), faces, process=False)
        clearance = trimesh.proximity.closest_point(body, belt.vertices[::3].astype(float))[1]
        assert (clearance < 0.012).mean() > 0.15, slot  # and it touches: no string through the air
        for anchor in (seat.belt.upper, seat.belt.buckle, seat.belt.outer_lap):  # type: ignore[union-attr]
            assert np.linalg.norm(belt.vertices - anchor, axis=1).min() < 0.04


def test_a_seat_of_another_cabin_is_refused() -> None:
    sedan, coupe = build_cabin("sedan"), build_cabin("coupe")
    seat = sedan.seats["rear_center"]
    with pytest.raises(ConfigError, match="rear_center"):
        belt_surface(*dummy(sedan, "rear_center"), seat, seat.default, coupe)
