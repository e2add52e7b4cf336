"""Joint angles, symmetry and frames, measured on the posed skeleton."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from cabinpose.core.frames import invert, is_rigid, transform
from cabinpose.core.skeleton import CABINPOSE, JOINTS
from cabinpose.scene.body import DOF_INDEX, DOFS, SEGMENTS, SUBJECTS, BodyModel, Person
from cabinpose.scene.body.rig import BONE_INDEX, LOWER, UPPER
from cabinpose.scene.body.shape import load_shape_space

NAMES = ("S01", "S03", "S05", "S08")


def person(name: str) -> Person:
    return BodyModel.load().person(*SUBJECTS[name])


def pose(**degrees: float) -> np.ndarray:
    q = np.zeros(len(DOFS))
    for name, value in degrees.items():
        q[DOF_INDEX[name.replace("_", ".", 1)]] = np.radians(value)
    return q


def random_pose(seed: int) -> np.ndarray:
    return np.random.Generator(np.random.Philox(seed)).uniform(LOWER, UPPER)


def test_required_names_limits_and_sources() -> None:
    central = [f"{j}.{a}" for j in ("lumbar", "thorax", "neck", "head") for a in ("flexion", "lateral", "rotation")]
    sided = [
        "clavicle.elevation", "clavicle.protraction", "shoulder.flexion", "shoulder.abduction", "shoulder.rotation",
        "elbow.flexion", "elbow.pronation", "wrist.flexion", "wrist.radial", "hand.grip", "hip.flexion", "hip.abduction",
        "hip.rotation", "knee.flexion", "ankle.dorsiflexion", "ankle.inversion",
    ]  # fmt: skip
    assert {d.name for d in DOFS} == set(central) | {s + n for s in "lr" for n in sided}
    for dof in DOFS:
        assert dof.lower <= 0 <= dof.upper
        assert dof.source
    for name in sided:
        left, right = (DOFS[DOF_INDEX[s + name]] for s in "lr")
        assert left[1:] == right[1:]


@pytest.mark.parametrize("name", NAMES)
def test_zero_pose_stands_upright_with_palms_to_the_thighs(name: str) -> None:
    body = person(name).pose(np.zeros(len(DOFS)), np.eye(4))
    j = dict(zip(JOINTS, body.joints, strict=True))
    assert_allclose((j["lpelvis"] + j["rpelvis"]) / 2, 0, atol=1e-9)
    for a, b in (("lshoulder", "lelbow"), ("lelbow", "lwrist"), ("lpelvis", "lknee"), ("lknee", "lankle")):
        line = j[a] - j[b]
        assert_allclose(line / np.linalg.norm(line), (0, 0, 1), atol=1e-9)
    assert_allclose(body.palms["l"][:3, 2], (0, -1, 0), atol=1e-9)
    assert_allclose(body.palms["r"][:3, 2], (0, 1, 0), atol=1e-9)
    assert body.eyes_m[0] > j["head"][0]  # looks forward
    sole = body.soles["l"]
    assert_allclose(sole[:3, :3], np.eye(3), atol=1e-9)
    lowest = body.surface(1).vertices[:, 2].min()
    assert sole[2, 3] == pytest.approx(lowest, abs=2e-3)


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("side", ["l", "r"])
def test_flexion_is_the_angle_between_segments(name: str, side: str) -> None:
    body = person(name)
    for near, joint, far, dof in (
        ("shoulder", "elbow", "wrist", "elbow_flexion"),
        ("pelvis", "knee", "ankle", "knee_flexion"),
    ):
        for angle in (0.0, 30.0, 90.0, 135.0):
            q = random_pose(3)
            q[DOF_INDEX[side + dof.replace("_", ".")]] = np.radians(angle)
            p = body.joints(q, np.eye(4))
            a, b, c = (p[CABINPOSE.index[side + n]] for n in (near, joint, far))
            assert _angle(b - a, c - b) == pytest.approx(angle, abs=1e-5)


@pytest.mark.parametrize("side", ["l", "r"])
def test_directions_of_motion(side: str) -> None:
    """Signs, each by what the joint does in words."""
    body = person("S01")
    out = 1.0 if side == "l" else -1.0
    rest = body.joints(np.zeros(len(DOFS)), np.eye(4))

    def moved(joint: str, **degrees: float) -> np.ndarray:
        return (body.joints(pose(**{side + k: v for k, v in degrees.items()}), np.eye(4)) - rest)[CABINPOSE.index[side + joint]]

    assert moved("wrist", shoulder_flexion=30)[0] > 0.1
    assert moved("wrist", shoulder_abduction=30)[1] * out > 0.1
    assert moved("wrist", elbow_flexion=60)[0] > 0.1
    assert moved("wrist", shoulder_rotation=40, elbow_flexion=90)[1] * out < -0.05
    assert moved("shoulder", clavicle_elevation=20)[2] > 0.02
    assert moved("shoulder", clavicle_protraction=20)[0] > 0.02
    assert moved("ankle", hip_flexion=30)[0] > 0.1
    assert moved("ankle", hip_abduction=30)[1] * out > 0.1
    assert moved("ankle", knee_flexion=60)[0] < -0.1
    assert moved("ankle", hip_rotation=30, knee_flexion=90)[1] * out > 0.05  # the shin behind swings outwards
    assert moved("foot", ankle_dorsiflexion=15)[2] > 0.01
    inverted = body.pose(pose(**{side + "ankle_inversion": 20}), np.eye(4)).soles[side][:3, 2]
    assert inverted[1] * out > 0.3  # the sole looks to the middle, its opposite outwards
    palm = body.pose(pose(**{side + "elbow_pronation": 60}), np.eye(4)).palms[side][:3, 2]
    assert palm[0] < -0.8
    assert body.pose(pose(**{side + "wrist_flexion": 40}), np.eye(4)).palms[side][1, 0] * out < -0.5
    assert (
        body.pose(pose(**{side + "wrist_radial": 15}), np.eye(4)).palms[side][0, 0]
        > body.pose(np.zeros(len(DOFS)), np.eye(4)).palms[side][0, 0] + 0.2
    )


def test_trunk_directions() -> None:
    body = person("S01")
    rest = body.joints(np.zeros(len(DOFS)), np.eye(4))
    for joint in ("lumbar", "thorax", "neck"):
        assert (body.joints(pose(**{joint + "_flexion": 20}), np.eye(4)) - rest)[CABINPOSE.index["head"], 0] > 0.005
        assert (body.joints(pose(**{joint + "_lateral": 20}), np.eye(4)) - rest)[CABINPOSE.index["head"], 1] > 0.005
    assert body.pose(pose(head_rotation=30), np.eye(4)).eyes_m[1] > 0.02


@pytest.mark.parametrize("seed", range(4))
def test_spine_shares_add_up(seed: int) -> None:
    """Thorax against pelvis and head against thorax are exactly the given rotations, however they are spread."""
    q = random_pose(seed)
    bones = person("S02").pose(q, np.eye(4)).bones

    def given(*joints: str) -> Rotation:
        total = Rotation.identity()
        for joint in joints:
            f, l, r = (q[DOF_INDEX[f"{joint}.{a}"]] for a in ("flexion", "lateral", "rotation"))
            total = total * Rotation.from_euler("YXZ", [f, -l, r])
        return total

    thorax, head = (bones[BONE_INDEX[b], :3, :3] for b in ("spine01", "head"))
    assert_allclose(thorax, given("lumbar", "thorax").as_matrix(), atol=1e-12)
    assert_allclose(thorax.T @ head, given("neck", "head").as_matrix(), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("side", ["l", "r"])
def test_joint_coordinates_are_recovered_from_the_bones(seed: int, side: str) -> None:
    q = random_pose(seed)
    bones = person("S03").pose(q, np.eye(4)).bones[:, :3, :3]
    s = 1 if side == "l" else -1

    def relative(near: str, far: str) -> Rotation:
        return Rotation.from_matrix(bones[BONE_INDEX[near]].T @ bones[BONE_INDEX[far]])

    def values(*names: str) -> list[float]:
        return [q[DOF_INDEX[side + n]] for n in names]

    f, a, r = values("shoulder.flexion", "shoulder.abduction", "shoulder.rotation")
    expected = Rotation.from_euler("YXZ", [-f, s * a, -s * r])
    assert_allclose(relative("spine01", side + "upperarm").as_matrix(), expected.as_matrix(), atol=1e-12)
    f, a, r = values("hip.flexion", "hip.abduction", "hip.rotation")
    expected = Rotation.from_euler("YXZ", [-f, s * a, -s * r])
    assert_allclose(relative("pelvis", side + "thigh").as_matrix(), expected.as_matrix(), atol=1e-12)
    p, w, d = values("elbow.pronation", "wrist.flexion", "wrist.radial")
    expected = Rotation.from_euler("ZXY", [-s * p, -s * w, -d])
    assert_allclose(relative(side + "forearm", side + "hand").as_matrix(), expected.as_matrix(), atol=1e-12)
    d, i = values("ankle.dorsiflexion", "ankle.inversion")
    expected = Rotation.from_euler("YX", [-d, -s * i])
    assert_allclose(relative(side + "shank", side + "foot").as_matrix(), expected.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(2))
def test_mirrored_pose_gives_the_mirrored_body(name: str, seed: int) -> None:
    body, q = BodyModel.load().person(replace(SUBJECTS[name].phenotype, face=0)), random_pose(seed)
    one = body.pose(q, np.eye(4))
    other_side = {"l": "r", "r": "l"}
    order = [DOF_INDEX.get(other_side.get(dof.name[0], "") + dof.name[1:], i) for i, dof in enumerate(DOFS)]
    turned_round = {f"{j}.{a}" for j in ("lumbar", "thorax", "neck", "head") for a in ("lateral", "rotation")}
    sign = [-1.0 if dof.name in turned_round else 1.0 for dof in DOFS]
    other = body.pose(q[order] * sign, np.eye(4))
    flip = np.array([1, -1, 1])
    assert_allclose(other.joints, (one.joints * flip)[list(CABINPOSE.mirror)], atol=2e-6)
    assert_allclose(other.skin, (one.skin * flip.astype(np.float32))[load_shape_space().mirror], atol=5e-5)


def test_root_moves_everything_rigidly() -> None:
    q, body = random_pose(7), person("S04")
    move = transform(Rotation.from_euler("zyx", [0.4, -0.3, 0.2]), (1.2, -0.4, 0.7))
    still, moved = body.pose(q, np.eye(4)), body.pose(q, move)
    assert_allclose(moved.skin, still.skin @ move[:3, :3].T.astype(np.float32) + move[:3, 3], atol=1e-5)
    assert_allclose(moved.joints, still.joints @ move[:3, :3].T + move[:3, 3], atol=1e-12)
    assert_allclose(invert(move) @ moved.bones, still.bones, atol=1e-12)
    assert_allclose(body.joints(q, move), moved.joints, atol=0)
    for frame in (*moved.palms.values(), *moved.soles.values(), *moved.bones):
        assert is_rigid(frame)
    with pytest.raises(ValueError, match="shape"):
        body.pose(np.zeros(3), move)


def test_a_part_of_the_skin_is_the_skin_there() -> None:
    q, body = random_pose(3), person("S02")
    root = transform(Rotation.from_euler("zyx", [0.4, -0.3, 0.2]), (1.2, -0.4, 0.7))
    rows = np.random.Generator(np.random.Philox(1)).permutation(len(body.rest_skin))[:500]
    assert_allclose(body.skin_part(rows)(q, root), body.pose(q, root).skin[rows], atol=1e-6)


def rim_grip(body: Person) -> float:
    """`hand.grip` at which the fingers touch a rim of 30 mm on the palm frame's y axis, by bisection."""
    fingers = [BONE_INDEX[f"lfinger{f}_{k}"] for f in range(2, 6) for k in (1, 2, 3)]
    curls = np.isin(load_shape_space().bone_index[:, 0], fingers)
    low, high, q = 0.0, 1.0, np.zeros(len(DOFS))
    for _ in range(8):
        q[DOF_INDEX["lhand.grip"]] = grip = (low + high) / 2
        posed = body.pose(q, np.eye(4))
        local = (posed.skin[curls] - posed.palms["l"][:3, 3]) @ posed.palms["l"][:3, :3]
        free = np.hypot(local[:, 0], local[:, 2]).min() > 0.015 - 0.003  # by which a finger's flesh gives way
        low, high = (grip, high) if free else (low, grip)
    return low


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("side", ["l", "r"])
def test_hand_closes_around_a_rim(name: str, side: str) -> None:
    """A rim of 30 mm on the palm's y axis: palm and fingers touch it, neither enters it deeper than flesh gives."""
    body = person(name)
    q = np.zeros(len(DOFS))
    q[DOF_INDEX[side + "hand.grip"]] = grip = rim_grip(body)
    posed = body.pose(q, np.eye(4))
    frame = posed.palms[side]
    local = (posed.skin - frame[:3, 3]) @ frame[:3, :3]
    near = (np.abs(local[:, 1]) < 0.035) & (np.linalg.norm(local, axis=1) < 0.08)
    radius = np.hypot(local[near, 0], local[near, 2])
    angle = np.degrees(np.arctan2(local[near, 2], local[near, 0]))
    assert 0.2 < grip < 0.7
    assert 0.015 - 0.005 < radius.min() < 0.016
    # Skin within 30 mm of the axis surrounds it: the largest gap in direction is less than a half turn.
    around = np.sort(angle[radius < 0.030])
    assert np.diff(np.concatenate([around, around[:1] + 360])).max() < 150


def test_fist_is_tighter_than_a_grip() -> None:
    body = person("S01")
    spans = []
    for grip in (0.0, 0.5, 1.0):
        q = np.zeros(len(DOFS))
        q[DOF_INDEX["lhand.grip"]] = grip
        posed = body.pose(q, np.eye(4))
        hand = posed.skin[body.skin_segment == SEGMENTS.index("lhand")]
        spans.append(((hand - posed.palms["l"][:3, 3]) @ posed.palms["l"][:3, :3])[:, 0].max())
    assert spans[0] > spans[1] > spans[2]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_pose_that_is_not_finite_is_refused(value: float) -> None:
    q = pose()
    q[DOF_INDEX["lhand.grip"]] = value
    with pytest.raises(ValueError, match=r"q is not finite: lhand\.grip"):
        person("S01").pose(q, np.eye(4))


@pytest.mark.parametrize("shape", [(2, 15), (2, 7), (1, 16), (3, 5), (32,)])
def test_fingers_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected 2 rows of 5, 6 or 16"):
        person("S01").pose(pose(), np.eye(4), np.zeros(shape))
