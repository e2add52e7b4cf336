"""Standing people and recorded motions: feet on the floor, limits, statistics near the real ones, the same gesture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cabinpose.core import CMU_UNIT_M
from cabinpose.core.errors import MocapError
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.body import DOFS, SUBJECTS, BodyModel
from cabinpose.scene.cabin import build_cabin
from cabinpose.scene.contact import ContactField
from cabinpose.store.convert.clip import read_clip
from cabinpose.synth.posture import Prescribed, SeatContext, choose_setting, sample_pose
from cabinpose.synth.posture.retarget import retarget
from cabinpose.synth.profiles import GaussianProfile, MocapProfile
from cabinpose.synth.standing import sample_standing

LOWER, UPPER = (np.array([getattr(d, k) for d in DOFS]) for k in ("lower", "upper"))
CMU = "mocap/cmu_131_01.bvh"


def test_feet_on_the_floor_within_limits() -> None:
    model = BodyModel.load()
    for k, subject in enumerate(list(SUBJECTS.values())[:6]):
        person = model.person(*subject)
        for i in range(20):
            pose = sample_standing(person, rng=np.random.default_rng([k, i]))
            assert np.all(pose.q >= LOWER)
            assert np.all(pose.q <= UPPER)
            soles = person.pose(pose.q, pose.floor_from_root).soles
            low = min(s[2, 3] for s in soles.values())
            assert -0.02 < low < 0.02
            if pose.action != "lift_leg":
                assert max(s[2, 3] for s in soles.values()) < 0.06
            same = sample_standing(person, rng=np.random.default_rng([k, i]))
            assert same.q.tobytes() == pose.q.tobytes()


def test_a_profile_moves_it_and_the_feet_stay_down() -> None:
    person = BodyModel.load().person(*SUBJECTS["S02"])
    profile = GaussianProfile.model_validate({"axes": {"lknee.flexion": {"mean_deg": 60, "sigma_deg": 10}}})
    for i in range(10):
        pose = sample_standing(person, profile, rng=np.random.default_rng(i))
        soles = person.pose(pose.q, pose.floor_from_root).soles.values()
        assert min(s[2, 3] + f * s[2, 0] for s in soles for f in (0.0, 0.16, 0.22)) == pytest.approx(0.002, abs=1e-9)


def arms_raised(joints: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(N, 2) angle (deg) between each upper arm and the downward trunk axis; joints (N, 20, 3)."""
    result = []
    for side in "lr":
        arm = joints[:, CABINPOSE.index[side + "elbow"]] - joints[:, CABINPOSE.index[side + "shoulder"]]
        arm /= np.linalg.norm(arm, axis=1, keepdims=True)
        result.append(np.degrees(np.arccos(np.clip(-(arm * up).sum(axis=1), -1, 1))))
    return np.stack(result, axis=1)


def test_arms_are_raised_about_as_often_as_in_itop(real_data: Callable[[str], Path]) -> None:
    import scipy.io

    real = scipy.io.loadmat(real_data("itop/itop_side_keypoints3D_test.mat"))["keypoints3D"].astype(float)
    joints = np.zeros((len(real), 20, 3))
    for ours, theirs in (("lshoulder", 3), ("rshoulder", 2), ("lelbow", 5), ("relbow", 4)):
        joints[:, CABINPOSE.index[ours]] = real[:, theirs]
    up = real[:, 1] - real[:, 9:11].mean(axis=1)
    theirs_raised = arms_raised(joints, up / np.linalg.norm(up, axis=1, keepdims=True)) > 45

    person = BodyModel.load().person(*SUBJECTS["S01"])
    rng = np.random.default_rng(4)
    poses = [sample_standing(person, rng=rng) for _ in range(600)]
    joints = np.array([person.joints(p.q, p.floor_from_root) for p in poses])
    up = joints[:, CABINPOSE.index["neck"]] - joints[:, [CABINPOSE.index["lpelvis"], CABINPOSE.index["rpelvis"]]].mean(axis=1)
    ours_raised = arms_raised(joints, up / np.linalg.norm(up, axis=1, keepdims=True)) > 45
    for count in (0, 1, 2):
        a, b = ((r.sum(axis=1) == count).mean() for r in (theirs_raised, ours_raised))
        assert a == pytest.approx(b, abs=0.09), count


def test_who_stands_is_aligned_as_measured_in_profile() -> None:
    """Woodhull et al. 1985 (Eur J Appl Physiol 54:109): fifteen people, cm ahead of the ankle, symmetrical standing."""
    ahead, knees = [], []
    for k, subject in enumerate(list(SUBJECTS.values())[:3]):
        person, rng = BodyModel.load().person(*subject), np.random.default_rng(k)
        for pose in (sample_standing(person, rng=rng) for _ in range(90)):
            if pose.action == "arms_hang":
                joints = person.joints(pose.q, pose.floor_from_root)
                at = {n: joints[[CABINPOSE.index[s + n] for s in "lr"]] for n in ("ankle", "knee", "pelvis", "shoulder")}
                at["head"] = joints[[CABINPOSE.index["head"]]]
                ahead.append([100 * float(at[n][:, 0].mean() - at["ankle"][:, 0].mean()) for n in at])
                thigh, shin = at["pelvis"] - at["knee"], at["knee"] - at["ankle"]
                cosines = (thigh * shin).sum(axis=1) / np.linalg.norm(thigh, axis=1) / np.linalg.norm(shin, axis=1)
                knees += np.degrees(np.arccos(np.clip(cosines, -1, 1))).tolist()
    assert len(ahead) > 25
    _, knee, hip, shoulder, head = np.mean(ahead, axis=0)
    assert knee == pytest.approx(3.8, abs=2.5)
    assert hip == pytest.approx(6.2, abs=0.6)
    assert shoulder == pytest.approx(3.8, abs=2.5)
    assert head == pytest.approx(5.9, abs=2.5)  # theirs is the ear
    assert np.median(knees) < 10


def directions(points: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    segments = (
        ("arm", "shoulder", "elbow"), ("forearm", "elbow", "wrist"), ("thigh", "pelvis", "knee"), ("shin", "knee", "ankle"),
    )  # fmt: skip
    limbs = {s + name: (s + a, s + b) for s in "lr" for name, a, b in segments}
    return {k: (points[b] - points[a]) / np.linalg.norm(points[b] - points[a]) for k, (a, b) in limbs.items()}


def test_the_retargeted_recording_makes_the_same_gesture(real_data: Callable[[str], Path]) -> None:
    """Limb directions of the recorded skeleton and of ours agree in every tenth frame, but where a limit cuts in."""
    clip = read_clip(real_data(CMU), unit_m=CMU_UNIT_M, up="y")
    motion = retarget(clip)
    person = BodyModel.load().person(*SUBJECTS["S01"])
    names = {"shoulder": "Shoulder", "elbow": "Elbow", "wrist": "Wrist", "pelvis": "Hip", "knee": "Knee", "ankle": "Ankle"}
    errors: dict[str, list[float]] = {}
    for f in range(0, len(clip), 10):
        root = np.eye(4)
        root[:3, :3] = motion.root[f]
        joints = person.joints(motion.q[f], root)
        ours = directions({s + n: joints[CABINPOSE.index[s + n]] for s in "lr" for n in names})
        theirs = directions(
            {
                s + n: clip.positions[f, clip.names.index(side + m)]
                for s, side in (("l", "Left"), ("r", "Right"))
                for n, m in names.items()
            }
        )
        for limb, d in ours.items():
            errors.setdefault(limb, []).append(float(np.degrees(np.arccos(np.clip(d @ theirs[limb], -1, 1)))))
    for limb, angles in errors.items():
        assert np.median(angles) < 3.0, limb
        assert np.percentile(angles, 90) < 25.0, limb
    assert np.all(motion.q >= LOWER)
    assert np.all(motion.q <= UPPER)
    # Angles may change branch near a singularity, the pose may not: no joint jumps from one frame to the next (120 Hz).
    root = np.eye(4)
    walk = np.array([person.joints(q, root) for q in motion.q])
    assert np.linalg.norm(np.diff(walk, axis=0), axis=2).max() < 0.15


def test_mocap_on_a_seat_and_in_a_room(real_data: Callable[[str], Path]) -> None:
    profile = MocapProfile(path=str(real_data(CMU)), rate_hz=30)
    person = BodyModel.load().person(*SUBJECTS["S01"])
    assert profile.count == pytest.approx(994 / 4, abs=1)
    cabin = build_cabin("sedan")
    seat = cabin.seats["rear_right"]
    setting = choose_setting(person, seat, cabin, rng=None)
    field, settings = ContactField(cabin), {s: each.default for s, each in cabin.seats.items()} | {seat.slot: setting}
    seated, standing, free = [], [], []
    for i in range(0, 240, 20):
        pose = sample_pose(
            SeatContext(person, seat, setting, cabin), "rest_lap", Prescribed(profile, index=i),
            car=lambda angle: field.at(settings, angle), rng=np.random.default_rng(0),
        )  # fmt: skip
        assert pose.action == "mocap"
        assert np.all(pose.q >= LOWER)
        assert np.all(pose.q <= UPPER)
        seated.append(pose.q)
        palms = person.pose(pose.q, pose.vehicle_from_root).palms
        free.append(field.clearance(np.stack([p[:3, 3] for p in palms.values()]), settings, 0.0).min())
        standing.append(sample_standing(person, profile, index=i, rng=np.random.default_rng(0)).q)
    assert np.ptp(np.array(seated), axis=0).max() > 1.0
    assert min(free) > -0.005  # no palm is in the seat or in the door, but for what a search leaves
    again = sample_standing(person, profile, index=profile.count, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(again.q, standing[0])  # it begins anew
    late = MocapProfile(path=str(real_data(CMU)), start_s=100)
    with pytest.raises(MocapError, match="ends after"):
        sample_standing(person, late, rng=np.random.default_rng(0))
