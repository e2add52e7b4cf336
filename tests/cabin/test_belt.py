"""The belt lies on the body, outside of it, and hangs from its anchors."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cabinpose.core.errors import ConfigError
from cabinpose.core.frames import axis_rotation
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.body import DOF_INDEX, DOFS, SUBJECTS, BodyModel, Outfit
from cabinpose.scene.cabin import PRESETS, Cabin, Wearer, belt_surface, build_cabin
from cabinpose.scene.labels import LABEL_ID as LABEL
from cabinpose.scene.surface import Surface

INDEX = CABINPOSE.index


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


def labels_of(skin: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The classes of the dummy's pieces."""
    pieces = [len(piece.faces) for piece in trimesh.Trimesh(skin, faces, process=False).split()]
    limbs = [f"{part}_{side}" for part in ("upper_arm", "forearm", "thigh") for side in ("left", "right")]
    return np.repeat([LABEL[name] for name in ("torso_left", "head_left", *limbs)], pieces).astype(np.uint8)


@pytest.mark.parametrize(("name", "scale"), [*((name, 1.0) for name in PRESETS), ("sedan", 0.75)])
def test_belt_lies_on_the_trunk_and_not_in_it(name: str, scale: float) -> None:
    cabin = build_cabin(name)
    for slot in ("driver", "rear_right"):
        seat = cabin.seats[slot]
        skin, faces, joints = dummy(cabin, slot, scale)
        belt = Wearer(skin, faces, labels_of(skin, faces), joints).belt(seat, seat.default, cabin)
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


def leaning(cabin: Cabin, slot: str, lean: tuple[str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The dummy turned about an axis through its hips."""
    skin, faces, joints = dummy(cabin, slot)
    turn = axis_rotation(lean[0], np.radians(lean[1]))
    hips = 0.5 * (joints[INDEX["lpelvis"]] + joints[INDEX["rpelvis"]])
    return ((skin - hips) @ turn.T + hips).astype(np.float32), faces, (joints - hips) @ turn.T + hips


def pressing_bends(belt: Surface, body: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Where the strings of a belt bend towards the chord of their ends: how much (rad), and how far from the body (m)."""
    bends, gaps = [], []
    for ribbon in belt.vertices.astype(float).reshape(-1, 2, 40, 3, 3)[:, 1]:
        distance = trimesh.proximity.closest_point(body, ribbon.reshape(-1, 3))[1].reshape(40, 3)
        near = np.minimum(np.minimum(distance[:-2], distance[1:-1]), distance[2:]).min(axis=1)
        start, end = ribbon[0].mean(axis=0), ribbon[-1].mean(axis=0)
        chord = (end - start) / np.linalg.norm(end - start)
        for string in np.moveaxis(ribbon, 1, 0):
            along = np.diff(string, axis=0)
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            out = string[1:-1] - start
            out -= (out @ chord)[:, None] * chord
            bends.append(-((along[1:] - along[:-1]) * out).sum(axis=1) / np.maximum(np.linalg.norm(out, axis=1), 1e-9))
            gaps.append(near)
    return np.concatenate(bends), np.concatenate(gaps)


LEANS = [("x", 0.0), ("x", 35.0), ("x", -35.0), ("z", 50.0), ("z", -50.0), ("y", 30.0)]


@pytest.mark.parametrize("lean", LEANS)
def test_a_belt_is_straight_wherever_it_does_not_press_and_stays_in_front(lean: tuple[str, float]) -> None:
    """A taut string on a body is a geodesic: in the air it is straight, so it bends towards the body only where it touches."""
    cabin = build_cabin("sedan")
    for slot in ("driver", "front_passenger"):
        seat = cabin.seats[slot]
        skin, faces, joints = leaning(cabin, slot, lean)
        belt = Wearer(skin, faces, labels_of(skin, faces), joints).belt(seat, seat.default, cabin)
        bend, gap = pressing_bends(belt, trimesh.Trimesh(skin.astype(float), faces, process=False))
        assert (bend > 0.05).sum() > 10
        assert gap[bend > 0.05].max() < 0.016
        at = {name: joints[i] for name, i in INDEX.items()}
        ahead = np.cross(at["lpelvis"] - at["rpelvis"], at["chest"] - at["hip"])
        across = belt.vertices[:240].reshape(2, 40, 3, 3)[1, 14:24, 1]  # the part before the trunk
        assert ((across - at["chest"]) @ ahead > 0.0).all()
        sides = at["lshoulder"] - at["rshoulder"]
        beyond = np.abs((across - 0.5 * (at["lshoulder"] + at["rshoulder"])) @ sides) / (sides @ sides)
        assert beyond.max() < 0.66  # never outside an arm


@pytest.mark.parametrize(("axis", "first"), [("z", -50.0), ("x", -30.0)])
def test_a_belt_follows_who_leans_until_the_other_shoulder_is_nearer_to_its_anchor(axis: str, first: float) -> None:
    """Step by step it moves with the body, and by no more than a few times as far; the nearer shoulder changes on the way."""
    cabin = build_cabin("sedan")
    seat = cabin.seats["driver"]
    labels = labels_of(*dummy(cabin, "driver")[:2])
    skins, belts, nearer = [], [], set()
    for angle in np.arange(first, first + 21.0, 2.0):
        skin, faces, joints = leaning(cabin, "driver", (axis, float(angle)))
        belt = Wearer(skin, faces, labels, joints).belt(seat, seat.default, cabin)
        skins.append(skin)
        belts.append(belt.vertices[:240].reshape(2, 40, 3, 3)[1, :, 1])
        nearer.add(min(("lshoulder", "rshoulder"), key=lambda s: np.linalg.norm(joints[INDEX[s]] - seat.belt.upper)))
    assert len(nearer) == 2
    moved, followed = (np.linalg.norm(np.diff(v, axis=0), axis=2).max(axis=1) for v in (skins, belts))
    assert (followed / moved).max() < 8.0


def test_an_arm_before_the_chest_moves_no_belt() -> None:
    cabin = build_cabin("sedan")
    seat = cabin.seats["driver"]
    skin, faces, joints = dummy(cabin, "driver")
    labels = labels_of(skin, faces)
    moved, at = skin.copy(), joints.copy()
    forearms = np.unique(faces[np.isin(labels, [LABEL["forearm_left"], LABEL["forearm_right"]])])
    nearer = 0.5 * (joints[INDEX["chest"]] + joints[INDEX["hip"]]) - joints[[INDEX["lwrist"], INDEX["rwrist"]]].mean(axis=0)
    moved[forearms] += (0.8 * nearer).astype(np.float32)
    for name in ("lwrist", "rwrist", "lhand", "rhand"):
        at[INDEX[name]] += 0.8 * nearer
    still, after = (Wearer(v, faces, labels, j).belt(seat, seat.default, cabin) for v, j in ((skin, joints), (moved, at)))
    np.testing.assert_array_equal(still.vertices, after.vertices)
    body = trimesh.Trimesh(skin.astype(float), faces, process=False)
    clearance = trimesh.proximity.closest_point(body, still.vertices[::3].astype(float))[1]
    assert (clearance < 0.012).mean() > 0.15


def test_a_belt_behind_the_back_and_one_under_the_arm() -> None:
    cabin = build_cabin("sedan")
    seat = cabin.seats["driver"]
    skin, faces, joints = dummy(cabin, "driver")
    wearer = Wearer(skin, faces, labels_of(skin, faces), joints)
    at = {name: joints[i] for name, i in INDEX.items()}
    ahead = np.cross(at["lpelvis"] - at["rpelvis"], at["chest"] - at["hip"])
    ahead, up = (v / np.linalg.norm(v) for v in (ahead, at["neck"] - at["hip"]))
    behind = wearer.belt(seat, seat.default, cabin, worn="behind_back").vertices[:-240]
    trunk = np.abs((behind - at["hip"]) @ up - 0.25) < 0.12
    assert trunk.any()
    assert ((behind[trunk] - at["chest"]) @ ahead < 0.0).all()
    under = wearer.belt(seat, seat.default, cabin, worn="under_arm").vertices[240:480]
    before = (under - at["chest"]) @ ahead > 0.05
    assert before.sum() > 60
    assert ((under[before] - at["lshoulder"]) @ up).max() < -0.05
    worn = wearer.belt(seat, seat.default, cabin).vertices[:240]
    assert ((worn[(worn - at["chest"]) @ ahead > 0.05] - at["lshoulder"]) @ up).max() > 0.0


def test_the_names_of_0_2_go_on_working_and_warn() -> None:
    cabin = build_cabin("sedan")
    seat = cabin.seats["driver"]
    skin, faces, joints = dummy(cabin, "driver")
    labels = labels_of(skin, faces)
    with pytest.warns(DeprecationWarning, match="Wearer"):
        before = belt_surface(skin, faces, joints, seat, seat.default, cabin, labels=labels, gap_m=0.006)
    now = Wearer(skin, faces, labels, joints).belt(seat, seat.default, cabin, gap_m=0.006)
    np.testing.assert_array_equal(before.vertices, now.vertices)


def test_a_seat_of_another_cabin_is_refused() -> None:
    sedan, coupe = build_cabin("sedan"), build_cabin("coupe")
    seat = sedan.seats["rear_center"]
    skin, faces, joints = dummy(sedan, "rear_center")
    with pytest.raises(ConfigError, match="rear_center"):
        Wearer(skin, faces, labels_of(skin, faces), joints).belt(seat, seat.default, coupe)


@pytest.mark.parametrize("bottom", ["jeans", "skirt", "dress"])
@pytest.mark.parametrize("flexion", [80.0, 100.0])
def test_a_lap_belt_lies_over_what_is_worn_on_raised_thighs(bottom: str, flexion: float) -> None:
    """From outside of its middle, along its plane, no ray meets trunk or thigh: all of that is below it."""
    cabin = build_cabin("sedan")
    seat = cabin.seats["front_passenger"]
    anchors = seat.belt_anchors(seat.default)
    assert anchors is not None
    q = np.zeros(len(DOFS))
    for side in "lr":
        for axis, degrees in (("hip.flexion", flexion), ("knee.flexion", 70.0), ("hip.abduction", 8.0)):
            q[DOF_INDEX[f"{side}{axis}"]] = np.radians(degrees)
    person = BodyModel.load().person(SUBJECTS["S02"].phenotype, Outfit("t_shirt", bottom))
    body = person.pose(q, seat.vehicle_from_back(seat.default))
    seen = body.surface(1)
    belt = Wearer.of(seen, body.joints).belt(seat, seat.default, cabin)
    lap = belt.vertices[-240:].reshape(2, 40, 3, 3)[0, 6:34].astype(float)
    chord = (anchors.buckle - anchors.outer_lap) / np.linalg.norm(anchors.buckle - anchors.outer_lap)
    out = lap[14, 1] - anchors.outer_lap
    out -= (out @ chord) * chord
    lain_on = np.isin(seen.label, [code for name, code in LABEL.items() if name.startswith(("torso", "hip", "thigh"))])
    cloth = trimesh.Trimesh(seen.vertices, seen.faces[lain_on], process=False)
    points = lap.reshape(-1, 3) + 0.001 * out / np.linalg.norm(out)
    assert not cloth.ray.intersects_any(points, np.tile(out, (len(points), 1))).any()


@pytest.mark.parametrize(
    ("name", "bottom", "ahead_m"),
    [
        ("S02", "jeans", 0.14),
        ("S02", "skirt", 0.2),
        ("S02", "jeans", 0.2),
        ("S05", "long_skirt", 0.14),
        ("S05", "long_skirt", 0.2),
    ],
)
def test_the_belt_of_who_has_slid_down_goes_through_no_thigh(name: str, bottom: str, ahead_m: float) -> None:
    """Slumped, before the backrest: none of the part before the chest is in the body, by signed distances to the skin."""
    cabin = build_cabin("sedan")
    seat = cabin.seats["front_passenger"]
    q = np.zeros(len(DOFS))
    q[DOF_INDEX["lumbar.flexion"]] = np.radians(12.0)
    for side in "lr":
        for axis, degrees in (
            ("hip.flexion", 77.0),
            ("knee.flexion", 60.0),
            ("hip.abduction", 8.0),
            ("shoulder.abduction", 25.0),
        ):
            q[DOF_INDEX[f"{side}{axis}"]] = np.radians(degrees)
    person = BodyModel.load().person(SUBJECTS[name].phenotype, Outfit("t_shirt", bottom))
    place = seat.vehicle_from_back(seat.default).copy()
    place[0, 3] += ahead_m
    place[:3, :3] = axis_rotation("y", np.radians(-15.0)) @ place[:3, :3]
    body = person.pose(q, place)
    belt = Wearer.of(body.surface(1), body.joints).belt(seat, seat.default, cabin)
    chest = belt.vertices[:240].reshape(2, 40, 3, 3)[0, 12:, 1]
    skin = trimesh.Trimesh(body.skin, person.skin_faces, process=False)
    assert trimesh.proximity.signed_distance(skin, chest.astype(float)).max() < 0.004
