"""Joint centres against published anatomy that they were not worked out from."""

from __future__ import annotations

import numpy as np
import pytest

from cabinpose.core import CABINPOSE, JOINTS, RIG, has_joint_map, told_as
from cabinpose.scene.body import DOF_INDEX, DOFS, SUBJECTS, BodyModel, Person, Phenotype, load_population

MODEL = BodyModel.load()


def upright(person: Person) -> dict[str, np.ndarray]:
    return dict(zip(JOINTS, person.pose(np.zeros(len(DOFS)), np.eye(4)).joints, strict=True))


def adults(sex: str, count: int = 30) -> list[Person]:
    rng = np.random.Generator(np.random.Philox(7))
    sizes = [load_population("ansur").draw(rng=rng, sex=sex) for _ in range(count)]
    return [MODEL.person(Phenotype.of_size(size, rng=rng)) for size in sizes]


# Over stature, men and women: de Leva 1996 (men's thigh for both: the women's contradicts ANSUR II); ANSUR II's epicondyle to
# malleolus and radiale to stylion; 160 mm between femur heads (Skeletal Radiology 2010).
@pytest.mark.parametrize(
    ("sex", "thigh", "shank", "upper_arm", "forearm", "hips"),
    [("male", 0.2425, 0.2384, 0.1618, 0.1525, 0.0911), ("female", 0.2425, 0.2475, 0.1586, 0.1482, 0.0983)],
)
def test_lengths_between_joints(sex: str, thigh: float, shank: float, upper_arm: float, forearm: float, hips: float) -> None:
    found = []
    for person in adults(sex):
        at = upright(person)
        pairs = (("pelvis", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
        lengths = [np.linalg.norm(at["l" + a] - at["l" + b]) for a, b in pairs]
        found.append([*lengths, np.linalg.norm(at["lpelvis"] - at["rpelvis"])] / np.float64(person.stature_m))
    np.testing.assert_allclose(np.mean(found, axis=0), (thigh, shank, upper_arm, forearm, hips), rtol=0.04)


def test_femur_heads_are_hardly_farther_apart_in_tall_people() -> None:
    """145 to 185 mm in adults, whatever the stature."""
    people = [*adults("male", 20), *adults("female", 20)]
    apart = np.array([np.linalg.norm(at["lpelvis"] - at["rpelvis"]) for at in map(upright, people)])
    statures = np.array([person.stature_m for person in people])
    assert 0.140 < apart.min() < apart.max() < 0.185
    assert 0.0 < np.polyfit(statures, apart, 1)[0] < 0.07  # 0.092 were it in proportion


def test_joints_lie_within_the_body_and_apart_from_the_skin() -> None:
    """Knuckles lie within the hand, hips in the flesh; each at least as deep as bones are thick there."""
    import trimesh

    deep = {
        "pelvis": 0.05,
        "shoulder": 0.02,
        "knee": 0.02,
        "elbow": 0.015,
        "wrist": 0.01,
        "hand": 0.005,
        "ankle": 0.015,
        "foot": 0.005,
    }
    for name in ("S01", "S02", "S05", "ansur_female_p50", "nhanes_male_p95"):
        person = MODEL.person(*SUBJECTS[name])
        rest = person.rest
        at = rest.heads[rest.joint_bone] + np.einsum("jik,jk->ji", rest.frames[rest.joint_bone], rest.joint_offset)
        mesh = trimesh.Trimesh(person.rest_skin, person.skin_faces, process=False)
        depth = dict(zip(JOINTS, trimesh.proximity.signed_distance(mesh, at), strict=True))
        for joint, least in deep.items():
            assert depth["l" + joint] > least, (name, joint)
        assert min(depth[joint] for joint in ("head", "neck", "chest", "hip")) > 0.02, name


@pytest.mark.parametrize("name", ["S01", "S02", "S05"])
def test_sitting_takes_no_volume_from_hips_and_shoulders(name: str) -> None:
    """Flesh is not lost where joints bend: at most 2.5 % of the body with hips or shoulders at right angles and beyond."""
    person = MODEL.person(*SUBJECTS[name])

    def volume(**angles: float) -> float:
        q = np.zeros(len(DOFS))
        for axis, degrees in angles.items():
            q[[DOF_INDEX[side + axis.replace("_", ".")] for side in "lr"]] = np.radians(degrees)
        skin = person.pose(q, np.eye(4)).skin.astype(np.float64)
        a, b, c = (skin[person.skin_faces[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    still = volume()
    for angles in ({"hip_flexion": 90.0}, {"hip_flexion": 110.0}, {"shoulder_abduction": 90.0}, {"shoulder_flexion": 90.0}):
        assert volume(**angles) > (1 - 0.025) * still, angles


def test_joints_of_the_rig_are_told_as_anatomy_has_them() -> None:
    """Within 1.2 cm in the mean, of people and postures that the table was not found on; the rig's alone are 3 cm off."""
    rng = np.random.Generator(np.random.Philox(5))
    people = [MODEL.person(*SUBJECTS[name]) for name in ("S01", "S02", "S04", "S08", "S11")]
    before, after, back = [], [], []
    for person in people:
        q = np.zeros(len(DOFS))
        for side in "lr":
            for axis, low, high in (("hip.flexion", 60, 90), ("knee.flexion", 40, 90), ("shoulder.flexion", 0, 60)):
                q[DOF_INDEX[side + axis]] = np.radians(rng.uniform(low, high))
        body = person.pose(q, np.eye(4))
        told = told_as(body.rig_joints, JOINTS, RIG, CABINPOSE)
        before.append(np.linalg.norm(body.rig_joints - body.joints, axis=1))
        after.append(np.linalg.norm(told - body.joints, axis=1))
        back.append(np.linalg.norm(told_as(body.joints, JOINTS, CABINPOSE, RIG) - body.rig_joints, axis=1))
    assert np.mean(before) > 0.02
    assert np.mean(after) < 0.012
    assert np.mean(back) < 0.015


def test_what_a_table_names_and_is_not_there_leaves_a_joint_where_it_is() -> None:
    points = np.random.Generator(np.random.Philox(1)).random((2, 20, 3))
    unknown = points.copy()
    unknown[1, CABINPOSE.index["rknee"]] = np.nan
    told, whole = (told_as(each, JOINTS, RIG, CABINPOSE) for each in (unknown, points))
    np.testing.assert_allclose(told[0], whole[0])
    np.testing.assert_allclose(
        told[1, CABINPOSE.index["rpelvis"]], points[1, CABINPOSE.index["rpelvis"]]
    )  # its table has the knee
    np.testing.assert_allclose(told[1, CABINPOSE.index["lpelvis"]], whole[1, CABINPOSE.index["lpelvis"]])
    assert np.isnan(told[1, CABINPOSE.index["rknee"]]).all()
    alone = told_as(points[:, :2], JOINTS[:2], RIG, CABINPOSE)  # head and neck, without a chest
    np.testing.assert_allclose(alone, points[:, :2])
    assert told_as(points, JOINTS, RIG, RIG) is points


def test_a_shift_of_all_joints_stays_one() -> None:
    points = np.random.Generator(np.random.Philox(2)).random((20, 3))
    for of, to in ((RIG, CABINPOSE), (CABINPOSE, RIG)):
        np.testing.assert_allclose(told_as(points + 2.0, JOINTS, of, to), told_as(points, JOINTS, of, to) + 2.0)
        mirror = list(CABINPOSE.mirror)
        flipped = (points * (-1, 1, 1))[mirror]
        np.testing.assert_allclose(told_as(flipped, JOINTS, of, to), (told_as(points, JOINTS, of, to) * (-1, 1, 1))[mirror])


def test_definitions_without_a_table_are_refused() -> None:
    annotated = CABINPOSE.marked_by("those of annotators")
    assert not has_joint_map(annotated, CABINPOSE)
    with pytest.raises(ValueError, match="annotators"):
        told_as(np.zeros((20, 3)), JOINTS, annotated, CABINPOSE)
