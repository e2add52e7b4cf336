"""The correction by depth against bodies whose skin and skeleton are known, seen with a skeleton that is wrong by known turns."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from cabinpose.align.flesh import REGIONS, Flesh, flesh_of
from cabinpose.align.suit import CARRIER, JOINT_POINTS, POINTS
from cabinpose.align.surface_fit import FittedMoment, SurfacePoints, fit_surface, fitted_frames, surface_cloud
from cabinpose.core import CABINPOSE, Camera
from cabinpose.scene.body import BONE_INDEX, DOF_INDEX, DOFS, BodyModel, Phenotype

# The bone of the packaged body that begins where a segment of the suit does, and turns with it.
TRUNK = {
    "Pelvis": "pelvis", "L5": "spine04", "L3": "spine03", "T12": "spine02", "T8": "spine01", "Neck": "neck02", "Head": "head",
}  # fmt: skip
LIMBS = {
    "Shoulder": "clavicle", "UpperArm": "upperarm", "Forearm": "forearm", "Hand": "hand", "UpperLeg": "thigh",
    "LowerLeg": "shank", "Foot": "foot", "Toe": "foot", "hand": "hand",
}  # fmt: skip
JOINTS_AT = {"L5": "hip", "Neck": "neck", "LeftToe": "lfoot", "RightToe": "rfoot", "lhand": "lhand", "rhand": "rhand"}
HEAD, FRAMES = POINTS.index("Head"), 3
ARM = CABINPOSE.indices(["lelbow", "lwrist", "lhand"])


def bone(point: str) -> int:
    if point in TRUNK:
        return BONE_INDEX[TRUNK[point]]
    limb = next(name for end, name in LIMBS.items() if point.endswith(end))
    return BONE_INDEX[point[0].lower() + limb]


@cache
def seated() -> tuple[np.ndarray, tuple[tuple[np.ndarray, np.ndarray], ...]]:
    """Points (T, 25, 4, 4) in the camera of somebody heavier and rounder than the flesh, who sits 0.9 m before it and moves the
    arms; and the skin that it sees, with normals.
    """
    person = BodyModel.load().person(Phenotype(gender=0.1, muscle=0.5, weight=0.8, height=0.45, stature_m=1.78))
    looks = np.array(((0.0, 1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.35), (-1.0, 0.0, 0.0, 0.9), (0.0, 0.0, 0.0, 1.0)))  # from vehicle
    upright = np.zeros(len(DOFS))
    for side in "lr":
        upright[DOF_INDEX[side + "shoulder.abduction"]] = np.pi / 2
    rest = person.pose(upright, np.eye(4)).bones[:, :3, :3]
    poses, seen = [], []
    for frame in range(FRAMES):
        q = np.zeros(len(DOFS))
        for side, bent in (("l", 1.0 + 0.15 * frame), ("r", 1.3 - 0.15 * frame)):
            q[DOF_INDEX[side + "hip.flexion"]] = q[DOF_INDEX[side + "knee.flexion"]] = 1.4
            q[DOF_INDEX[side + "shoulder.flexion"]], q[DOF_INDEX[side + "elbow.flexion"]] = 0.5, bent
        body = person.pose(q, np.eye(4))
        pose = np.tile(np.eye(4), (len(POINTS), 1, 1))
        for k, name in enumerate(POINTS):
            at = body.bones[bone(name)]
            pose[k, :3, :3], pose[k, :3, 3] = at[:3, :3] @ rest[bone(name)].T, at[:3, 3]
            if name in JOINTS_AT:
                pose[k, :3, 3] = body.joints[CABINPOSE.index[JOINTS_AT[name]]]
        poses.append(looks @ pose)
        skin = body.skin @ looks[:3, :3].T + looks[:3, 3]
        corners = skin[person.skin_faces]
        normals = np.zeros_like(skin)
        for corner in person.skin_faces.T:
            np.add.at(normals, corner, np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        facing = np.flatnonzero(np.einsum("vi,vi->v", normals, skin) < -0.2 * np.linalg.norm(skin, axis=1))[::4]
        seen.append((skin[facing], normals[facing]))
    return np.array(poses), tuple(seen)


def clouds(keep=lambda points: np.ones(len(points), bool), clutter: np.ndarray | None = None):
    for frame, (points, normals) in enumerate(seated()[1]):
        kept = keep(points)
        points, normals = points[kept], normals[kept]
        if clutter is not None:
            points = np.concatenate((points, clutter))
            normals = np.concatenate((normals, -clutter / np.linalg.norm(clutter, axis=1)[:, None]))
        yield frame, SurfacePoints(points, normals)


def turned(points: np.ndarray, **turns_deg: tuple[float, float, float]) -> np.ndarray:
    """What a suit says whose segments are turned by these rotation vectors in their own axes, forward from the head."""
    offsets = np.einsum("tpji,tpj->tpi", points[:, CARRIER][..., :3, :3], points[..., :3, 3] - points[:, CARRIER][..., :3, 3])
    said = points.copy()
    for name, turn in turns_deg.items():
        each = [POINTS.index(name), *([POINTS.index(name[0].lower() + "hand")] if name.endswith("Hand") else [])]
        said[:, each, :3, :3] = said[:, each, :3, :3] @ Rotation.from_rotvec(turn, degrees=True).as_matrix()
    for k in range(1, len(POINTS)):
        said[:, k, :3, 3] = said[:, CARRIER[k], :3, 3] + np.einsum("tij,tj->ti", said[:, CARRIER[k], :3, :3], offsets[:, k])
    said[..., :3, 3] += (points[:, HEAD, :3, 3] - said[:, HEAD, :3, 3])[:, None]
    return said


def errors(said: np.ndarray, shift: np.ndarray | float = 0.0) -> np.ndarray:
    """(20,) m by joint."""
    joints, truth = (points[:, JOINT_POINTS][..., :3, 3] for points in (said, seated()[0]))
    return np.linalg.norm(joints + shift - truth, axis=2).mean(axis=0)


WRONG = {"LeftUpperArm": (0.0, 0.0, 4.0), "LeftForearm": (2.0, 0.0, 3.0)}


def test_a_turned_arm_comes_back_and_a_true_one_stays():
    said = turned(seated()[0], **WRONG)
    assert errors(said)[ARM].mean() > 0.02
    fitted = errors(said, fit_surface(said, clouds(), pose_corrected=False))
    assert fitted[ARM].mean() < 0.5 * errors(said)[ARM].mean()
    others = [j for j in range(len(JOINT_POINTS)) if j not in ARM]
    assert fitted[others].max() < 0.02


def test_where_nothing_is_seen_the_suits_pose_stays():
    said = turned(seated()[0], **WRONG)
    nothing = fit_surface(said, clouds(lambda points: np.zeros(len(points), bool)), pose_corrected=True)
    assert np.abs(nothing).max() == 0.0
    far = fit_surface(
        said, clouds(lambda points: np.zeros(len(points), bool), clutter=np.full((50, 3), 3.0)), pose_corrected=True
    )
    assert np.abs(far).max() == 0.0
    said[1] = np.nan  # a moment without a pose
    assert np.abs(fit_surface(said, clouds(), pose_corrected=True)[1]).max() == 0.0
    assert fit_surface(said, [], pose_corrected=True).shape == (FRAMES, 20, 3)


def test_an_arm_that_is_hidden_hangs_on_as_the_suit_has_it():
    said = turned(seated()[0], **WRONG)
    elbow = said[:, JOINT_POINTS[ARM[0]], :3, 3].mean(axis=0)
    shoulder = CABINPOSE.index["lshoulder"]
    shift = fit_surface(said, clouds(lambda points: np.linalg.norm(points - elbow, axis=1) > 0.5), pose_corrected=True)
    assert np.linalg.norm(shift[:, ARM] - shift[:, [shoulder]], axis=2).max() < 0.003


def test_things_about_the_person_do_no_harm():
    said = turned(seated()[0], **WRONG)
    rng = np.random.default_rng(1)
    clutter = rng.uniform((-0.6, -0.5, 0.4), (0.6, 0.5, 1.2), (600, 3))
    wall = np.stack(
        (*(x.ravel() for x in np.meshgrid(np.linspace(-0.7, 0.7, 30), np.linspace(-0.6, 0.6, 30))), np.full(900, 1.05)), 1
    )
    hurt = errors(said, fit_surface(said, clouds(clutter=np.concatenate((clutter, wall))), pose_corrected=False))
    assert hurt[ARM].mean() < 0.7 * errors(said)[ARM].mean()


def test_points_move_with_the_unknowns_as_forward_kinematics_has_it():
    points, seen = seated()
    by_unknowns = FittedMoment.of(points[0], np.zeros(23), SurfacePoints(*seen[0])).by_unknowns
    small = 1e-4
    for name, axis in (("LeftUpperArm", 0), ("T8", 1), ("L5", 2), ("RightHand", 1)):
        vector = np.degrees(small) * np.eye(3)[axis]
        moved = (turned(points[:1], **{name: vector})[0] - points[0])[:, :3, 3] / small
        assert np.abs(by_unknowns[..., 3 * POINTS.index(name) + axis] - moved).max() < 1e-3


def test_the_skin_moves_with_the_unknowns_as_finite_differences_have_it():
    points, seen = seated()
    whole = flesh_of(points)
    flesh = Flesh(*(values[::40] for values in (whole.local, whole.normal, whole.weight, whole.region)))
    moment = FittedMoment.of(points[0], np.linspace(0.1, 1.5, 23), SurfacePoints(*seen[0]))
    every = np.arange(len(flesh.region))
    across = np.random.default_rng(2).normal(size=(len(every), 3))
    still = np.zeros(2 * 69 + len(POINTS) + len(REGIONS))
    rows = moment.rows(flesh, every, across, moment.skin(flesh, still)[1])
    small = 1e-6
    for unknown in range(len(still)):
        step = small * np.eye(len(still))[unknown]
        moved = (moment.skin(flesh, step)[0] - moment.skin(flesh, -step)[0]) / (2 * small)
        assert np.abs(rows[:, unknown] - np.einsum("vi,vi->v", across, moved)).max() < 1e-6


def test_the_flesh_lies_about_the_segments_of_another_body():
    points, seen = seated()
    flesh = flesh_of(points)
    skin, normals = flesh.posed(points[0, :23, :3, :3], points[0, :23, :3, 3])
    limb = np.isin(flesh.region, (3, 4, 6, 7))
    facing = limb & (np.einsum("vi,vi->v", normals, skin) < -0.3 * np.linalg.norm(skin, axis=1))
    there, outwards = seen[0]
    nearest = KDTree(there).query(skin[facing])[1]
    apart = np.einsum("vi,vi->v", skin[facing] - there[nearest], outwards[nearest])
    assert facing.sum() > 300
    assert np.median(np.abs(apart)) < 0.01
    assert np.median(np.einsum("vi,vi->v", normals[facing], outwards[nearest])) > 0.95
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-12


def test_a_sphere_before_a_wall_gives_its_points_and_normals():
    camera = Camera(120, 90, 90.0, 90.0, 59.5, 44.5)
    row, column = np.mgrid[0:90, 0:120]
    ray = np.stack(((column - 59.5) / 90, (row - 44.5) / 90, np.ones((90, 120))), axis=-1)
    centre, radius = np.array((0.0, 0.0, 1.0)), 0.25
    b, a = ray @ centre, (ray**2).sum(axis=-1)
    inside = b**2 - a * (centre @ centre - radius**2)
    depth = np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) / a, 1.5)
    depth[:10] = np.nan
    cloud = surface_cloud(camera, depth)
    from_centre = cloud.points - centre
    on_sphere = np.linalg.norm(from_centre, axis=1) < 1.02 * radius
    assert on_sphere.sum() > 20
    cosine = np.einsum("pi,pi->p", from_centre[on_sphere] / radius, cloud.normals[on_sphere])
    assert np.median(cosine) > 0.99
    assert cosine.min() > 0.9
    on_wall = np.abs(cloud.points[:, 2] - 1.5) < 1e-6
    assert (on_wall | on_sphere).all()
    assert cloud.normals[on_wall][:, 2] == pytest.approx(-1.0)


def test_few_frames_of_a_long_take_are_fitted_evenly():
    kept = np.ones(1000, bool)
    kept[:100] = False
    chosen = fitted_frames(kept)
    assert len(chosen) == 16
    assert (chosen[0], chosen[-1]) == (100, 999)
    assert np.ptp(np.diff(chosen)) <= 1
    assert fitted_frames(kept[:103]).tolist() == [100, 101, 102]
