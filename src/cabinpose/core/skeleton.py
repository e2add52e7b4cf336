"""The skeleton of 20 joints, its groups and pairs, and the maps to other rigs.

Names: head = C1 (skull base), neck = C7, chest = T8, hip = L5 (root), lpelvis/rpelvis = the femur heads.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

from cabinpose.core.errors import unknown_name

JOINTS: tuple[str, ...] = (
    "head", "neck", "chest", "lshoulder", "rshoulder", "lelbow", "relbow", "lwrist", "rwrist", "lhand", "rhand",
    "hip", "lpelvis", "rpelvis", "lknee", "rknee", "lankle", "rankle", "lfoot", "rfoot",
)  # fmt: skip
INDEX = MappingProxyType({name: i for i, name in enumerate(JOINTS)})

PARENT = MappingProxyType(
    {
        "head": "neck", "neck": "chest", "chest": "hip",
        "lshoulder": "neck", "lelbow": "lshoulder", "lwrist": "lelbow", "lhand": "lwrist",
        "rshoulder": "neck", "relbow": "rshoulder", "rwrist": "relbow", "rhand": "rwrist",
        "lpelvis": "hip", "lknee": "lpelvis", "lankle": "lknee", "lfoot": "lankle",
        "rpelvis": "hip", "rknee": "rpelvis", "rankle": "rknee", "rfoot": "rankle",
    }
)  # fmt: skip
LIMBS: tuple[tuple[str, str], ...] = tuple((parent, child) for child, parent in PARENT.items())

SYMMETRIC_PAIRS: tuple[tuple[str, str], ...] = tuple((n, "r" + n[1:]) for n in JOINTS if n[0] == "l")

# How far the surface of a joint's own part may be from the joint (m): the greatest half-thickness of the part seen from
# anywhere, for a heavy adult in winter clothes, rounded up.
_REACH_M = {
    "head": 0.25, "neck": 0.25, "chest": 0.40, "hip": 0.40, "shoulder": 0.22, "elbow": 0.15, "wrist": 0.12, "hand": 0.12,
    "pelvis": 0.30, "knee": 0.18, "ankle": 0.15, "foot": 0.15,
}  # fmt: skip
REACH_M = MappingProxyType({joint: _REACH_M[joint if joint in _REACH_M else joint[1:]] for joint in JOINTS})

# OKS falloff sigma by stem of a joint's name (without l or r). Shoulder to ankle: COCO (cocodataset.org, keypoint evaluation).
# Head and neck: CrowdPose (Li et al. 2019). Feet: COCO-WholeBody's toes (Jin et al. 2020). The trunk has none published: COCO's
# hip, the loosest; hands: COCO's wrist.
OKS_SIGMA = MappingProxyType(
    {
        "head": 0.079, "neck": 0.079, "chest": 0.107, "torso": 0.107, "hip": 0.107, "pelvis": 0.107, "shoulder": 0.079,
        "elbow": 0.072, "wrist": 0.062, "hand": 0.062, "knee": 0.087, "ankle": 0.089, "foot": 0.068,
    }
)  # fmt: skip

# The groups of the reports (the thesis' five, and a hand group beside them).
GROUPS = MappingProxyType(
    {
        "Head": ("head", "neck"),
        "Shoulder": ("lshoulder", "rshoulder", "chest"),
        "Elbow": ("lelbow", "relbow"),
        "Wrist": ("lwrist", "rwrist"),
        "Hip": ("hip", "lpelvis", "rpelvis"),
        "Hand": ("lhand", "rhand"),
    }
)

UPPER_BODY: tuple[str, ...] = (
    "head", "neck", "rshoulder", "relbow", "rwrist", "lshoulder", "lelbow", "lwrist",
    "chest", "hip", "rpelvis", "lpelvis", "rhand", "lhand",
)  # fmt: skip


def _sided(centre: dict[str, str], sided: dict[str, str], left: str, right: str) -> MappingProxyType[str, str]:
    names = dict(centre)
    for joint, theirs in sided.items():
        names["l" + joint] = theirs.format(left)
        names["r" + joint] = theirs.format(right)
    return MappingProxyType({j: names[j] for j in JOINTS if j in names})


# Ours -> theirs. MVN streams a segment's origin, which is its proximal joint.
RIGS = MappingProxyType(
    {
        "makehuman_cmu": _sided(
            {"head": "Head", "neck": "Neck", "chest": "Spine1", "hip": "Hips"},
            {
                "shoulder": "{}Arm", "elbow": "{}ForeArm", "wrist": "{}Hand", "hand": "{}FingerBase",
                "pelvis": "{}UpLeg", "knee": "{}Leg", "ankle": "{}Foot", "foot": "{}ToeBase",
            },
            "Left", "Right",
        ),
        "mvn": _sided(
            {"head": "Head", "neck": "Neck", "chest": "T8", "hip": "L5"},
            {
                "shoulder": "{}UpperArm", "elbow": "{}Forearm", "wrist": "{}Hand",
                "pelvis": "{}UpperLeg", "knee": "{}LowerLeg", "ankle": "{}Foot", "foot": "{}Toe",
            },
            "Left", "Right",
        ),
        "vicon_kinematic_fit": _sided(
            {"head": "Head_End", "neck": "Head", "chest": "LowerBack_L_Collar", "hip": "LowerBack"},
            {
                "shoulder": "{}_Humerus", "elbow": "{}_Elbow", "wrist": "{}_Wrist", "hand": "{}_Wrist_End",
                "pelvis": "{}_Femur", "knee": "{}_Tibia", "ankle": "{}_Foot", "foot": "{}_Toe",
            },
            "L", "R",
        ),
        "plug_in_gait": _sided(
            {"head": "HEDO", "chest": "TRXO", "hip": "PELO"},
            {
                "shoulder": "{}CJ", "elbow": "{}HIJ", "wrist": "{}RAO", "hand": "{}HAO",
                "pelvis": "{}FEP", "knee": "{}FEO", "ankle": "{}TIO", "foot": "{}FOO",
            },
            "L", "R",
        ),
        # The trunk's are the nearest to ours: SpineShoulder lies between the shoulders, SpineBase between the hips. Kinect's Head
        # is the middle of the head and its Neck lies below the skull base: neither is our head.
        "kinect_v2": _sided(
            {"neck": "SpineShoulder", "chest": "SpineMid", "hip": "SpineBase"},
            {
                "shoulder": "Shoulder{}", "elbow": "Elbow{}", "wrist": "Wrist{}", "hand": "Hand{}",
                "pelvis": "Hip{}", "knee": "Knee{}", "ankle": "Ankle{}", "foot": "Foot{}",
            },
            "Left", "Right",
        ),
        "coco": _sided(  # a face's keypoints (nose, eyes, ears) are none of ours
            {},
            {
                "shoulder": "{}_shoulder", "elbow": "{}_elbow", "wrist": "{}_wrist", "pelvis": "{}_hip", "knee": "{}_knee",
                "ankle": "{}_ankle",
            },
            "left", "right",
        ),
    }
)  # fmt: skip

# Xsens MVN's 23 body segments in the order of their ids (id = index + 1; network streaming protocol, revision N, table 1) and the
# 22 joints between them in MVNX's order: name, parent, child. A segment's origin, which is what MVN streams, is the joint to
# its parent (the pelvis': midway between the hips), so that `RIGS["mvn"]` names a joint of ours by its distal segment.
MVN_SEGMENTS: tuple[str, ...] = (
    "Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head", "RightShoulder", "RightUpperArm", "RightForearm", "RightHand",
    "LeftShoulder", "LeftUpperArm", "LeftForearm", "LeftHand", "RightUpperLeg", "RightLowerLeg", "RightFoot", "RightToe",
    "LeftUpperLeg", "LeftLowerLeg", "LeftFoot", "LeftToe",
)  # fmt: skip
MVN_JOINTS: tuple[tuple[str, str, str], ...] = (
    ("jL5S1", "Pelvis", "L5"), ("jL4L3", "L5", "L3"), ("jL1T12", "L3", "T12"), ("jT9T8", "T12", "T8"), ("jT1C7", "T8", "Neck"),
    ("jC1Head", "Neck", "Head"),
    *(
        (f"j{side}{joint}", "T8" if parent == "T8" else side + parent, side + child)
        for side in ("Right", "Left")
        for joint, parent, child in (
            ("T4Shoulder", "T8", "Shoulder"), ("Shoulder", "Shoulder", "UpperArm"), ("Elbow", "UpperArm", "Forearm"),
            ("Wrist", "Forearm", "Hand"),
        )
    ),
    *(
        (f"j{side}{joint}", "Pelvis" if parent == "Pelvis" else side + parent, side + child)
        for side in ("Right", "Left")
        for joint, parent, child in (
            ("Hip", "Pelvis", "UpperLeg"), ("Knee", "UpperLeg", "LowerLeg"), ("Ankle", "LowerLeg", "Foot"),
            ("BallFoot", "Foot", "Toe"),
        )
    ),
)  # fmt: skip

# The 25 joints of Kinect v2, in the order of NTU RGB+D's files (Shahroudy et al. 2016, Fig. 1; Kinect SDK 2.0, JointType).
NTU_JOINTS: tuple[str, ...] = (
    "SpineBase", "SpineMid", "Neck", "Head", "ShoulderLeft", "ElbowLeft", "WristLeft", "HandLeft", "ShoulderRight",
    "ElbowRight", "WristRight", "HandRight", "HipLeft", "KneeLeft", "AnkleLeft", "FootLeft", "HipRight", "KneeRight",
    "AnkleRight", "FootRight", "SpineShoulder", "HandTipLeft", "ThumbLeft", "HandTipRight", "ThumbRight",
)  # fmt: skip

# ITOP's 15 joints in its order (right before left) and the joint of ours that each stands for. ITOP's head is the
# middle of the head and its torso the middle of the trunk: `synth` places them on the body, not on a joint of ours.
ITOP_JOINTS: tuple[str, ...] = (
    "head", "neck", "rshoulder", "lshoulder", "relbow", "lelbow", "rhand", "lhand", "torso",
    "rhip", "lhip", "rknee", "lknee", "rfoot", "lfoot",
)  # fmt: skip
# Parent and child: the tree that ties them.
ITOP_LIMBS: tuple[tuple[str, str], ...] = (
    ("neck", "head"), ("neck", "rshoulder"), ("neck", "lshoulder"), ("rshoulder", "relbow"), ("lshoulder", "lelbow"),
    ("relbow", "rhand"), ("lelbow", "lhand"), ("neck", "torso"), ("torso", "rhip"), ("torso", "lhip"), ("rhip", "rknee"),
    ("lhip", "lknee"), ("rknee", "rfoot"), ("lknee", "lfoot"),
)  # fmt: skip


def index_pairs(joints: Sequence[str], pairs: Sequence[tuple[str, str]] = LIMBS) -> tuple[tuple[int, int], ...]:
    """Pairs of joints (default: limbs, parent and child) as positions in `joints`; those that have both ends there."""
    at = {name: i for i, name in enumerate(joints)}
    return tuple((at[a], at[b]) for a, b in pairs if a in at and b in at)


def indices(names: Sequence[str]) -> list[int]:
    """Positions of joints in `JOINTS`."""
    return [INDEX[name] for name in names]


def oks_sigma(joint: str) -> float:
    """The OKS falloff of a joint of ours or of ITOP's; `ConfigError` for an unknown one."""
    for name in (joint, joint[1:]):
        if name in OKS_SIGMA:
            return OKS_SIGMA[name]
    raise unknown_name("joint", joint, list(OKS_SIGMA))


def mirrored() -> list[int]:
    """The permutation of `JOINTS` that swaps left and right."""
    swap = dict(SYMMETRIC_PAIRS) | {r: left for left, r in SYMMETRIC_PAIRS}
    return [INDEX[swap.get(name, name)] for name in JOINTS]
