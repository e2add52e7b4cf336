"""Sets of joints, `Skeleton`: ours of 20 and ITOP's of 15, and the tables that say which joints of other formats they are.

A set is a row of `SKELETONS`. How its joints lie in a body is said in `scene.body.joints`; nothing else names joints, but what
needs a body's anatomy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, TypeAlias
from warnings import warn

import numpy as np
from numpy.typing import NDArray

from cabinpose.core.errors import ConfigError, unknown_name


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A set of joints: their names in the order of arrays, the tree that ties them, and whose definition of each joint it is.

    Two sets are equal where their joints and their definition are: the same names from another source are another set.
    Positions are those of `joints`.

    name: by which files and settings call it · title: by which texts do · definition: where its joints lie, and who says so ·
    joints: (J,) names; those of a left and a right side are one name after l and r · parent: of each joint but the root, in the
    order of the limbs · spine: joints along it, from the neck down · groups: joints by group of the reports · sigma: falloff of
    OKS · skin_m: from the skin that a camera in front sees to the joint, of an adult of medium size · reach_m: how far the
    surface of a joint's own part may be from the joint, empty where the set has no states of visibility · head: the ends of the
    head segment, None where one of them is not in the set · sets: named choices of joints · maps: by other set or format the
    joints that are the same there, ours -> theirs.
    """

    name: str
    title: str
    definition: str
    joints: tuple[str, ...]
    parent: Mapping[str, str]
    spine: tuple[str, ...]
    groups: Mapping[str, tuple[str, ...]]
    sigma: Mapping[str, float]
    skin_m: Mapping[str, float]
    reach_m: Mapping[str, float] = field(default_factory=dict)
    head: tuple[str, str] | None = ("head", "neck")
    sets: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    maps: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for each in fields(self):
            if isinstance(value := getattr(self, each.name), dict):
                object.__setattr__(self, each.name, MappingProxyType(value))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Skeleton) and (self.joints, self.definition) == (other.joints, other.definition)

    def __hash__(self) -> int:
        return hash((self.joints, self.definition))

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Positions by name."""
        return MappingProxyType({joint: i for i, joint in enumerate(self.joints)})

    @cached_property
    def root(self) -> str | None:
        """The joint that all others hang from; None where the set has several without a parent."""
        roots = [joint for joint in self.joints if joint not in self.parent]
        return roots[0] if len(roots) == 1 else None

    @cached_property
    def limbs(self) -> tuple[tuple[int, int], ...]:
        """(L, 2) positions of parent and child."""
        return tuple((self.index[parent], self.index[child]) for child, parent in self.parent.items())

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """(P, 2) positions of the left and the right joint."""
        sided = ((joint, "r" + joint[1:]) for joint in self.joints if joint[0] == "l")
        return tuple((self.index[left], self.index[right]) for left, right in sided if right in self.index)

    @cached_property
    def mirror(self) -> tuple[int, ...]:
        """(J,) positions of the mirror joints; a joint whose partner is not in the set is its own."""
        other = dict(self.pairs) | {right: left for left, right in self.pairs}
        return tuple(other.get(i, i) for i in range(len(self.joints)))

    def indices(self, joints: Sequence[str]) -> list[int]:
        """Positions of some joints."""
        return [self.index[joint] for joint in joints]

    def subset(self, joints: Sequence[str]) -> Skeleton:
        """Some of the joints, in the order given, with what is known of them. ConfigError for a joint that is not in the set."""
        for joint in joints:
            if joint not in self.index:
                raise unknown_name(f"joint of {self.title}", joint, self.joints)
        chosen = set(joints)

        def some(sets: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
            left = {name: tuple(joint for joint in members if joint in chosen) for name, members in sets.items()}
            return {name: members for name, members in left.items() if members}

        def of(table: Mapping[str, Any]) -> dict[str, Any]:
            return {joint: table[joint] for joint in joints if joint in table}

        return replace(
            self, joints=tuple(joints), spine=tuple(joint for joint in self.spine if joint in chosen),
            parent={child: parent for child, parent in self.parent.items() if {child, parent} <= chosen},
            groups=some(self.groups), sets=some(self.sets),
            sigma=of(self.sigma), skin_m=of(self.skin_m), reach_m=of(self.reach_m),
            head=self.head if self.head is not None and chosen.issuperset(self.head) else None,
            maps={other: of(table) for other, table in self.maps.items()},
        )  # fmt: skip

    def counterparts(self, other: str, names: Sequence[str]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """What another set or a format calls these joints, by the stated table: positions here, and there among its `names`.

        Raises
        ------
        ConfigError
            Where there is no table: sets are not mixed.
        """
        if other not in self.maps:
            known = ", ".join(self.maps) or "none"
            raise ConfigError(f"no table says which joints of {self.name} those of {other} are", hint=f"known tables: {known}")
        there = {name: i for i, name in enumerate(names)}
        both = [(self.index[ours], there[theirs]) for ours, theirs in self.maps[other].items() if theirs in there]
        here, theirs = np.array(both, np.int64).reshape(-1, 2).T
        return here, theirs

    def marked_by(self, source: str) -> Skeleton:
        """The same names as somebody else places them: another set."""
        return replace(self, definition=source)


def _by_joint(joints: Sequence[str], table: Mapping[str, float]) -> dict[str, float]:
    """A table by joint, of one in which a joint of two sides may stand without its side."""
    return {joint: table[joint if joint in table else joint[1:]] for joint in joints}


# The order of the dataset standard's arrays; it stays within a version of the standard.
JOINTS: tuple[str, ...] = (
    "head", "neck", "chest", "lshoulder", "rshoulder", "lelbow", "relbow", "lwrist", "rwrist", "lhand", "rhand",
    "hip", "lpelvis", "rpelvis", "lknee", "rknee", "lankle", "rankle", "lfoot", "rfoot",
)  # fmt: skip
_ITOP_JOINTS = (
    "head", "neck", "rshoulder", "lshoulder", "relbow", "lelbow", "rhand", "lhand", "torso",
    "rhip", "lhip", "rknee", "lknee", "rfoot", "lfoot",
)  # fmt: skip

# OKS falloff sigma. Shoulder to ankle: COCO (cocodataset.org, keypoint evaluation). Head and neck: CrowdPose (Li et al. 2019).
# Feet: COCO-WholeBody's toes (Jin et al. 2020). The trunk has none published: COCO's hip, the loosest; hands: COCO's wrist.
_SIGMA = {
    "head": 0.079, "neck": 0.079, "chest": 0.107, "torso": 0.107, "hip": 0.107, "pelvis": 0.107, "shoulder": 0.079,
    "elbow": 0.072, "wrist": 0.062, "hand": 0.062, "knee": 0.087, "ankle": 0.089, "foot": 0.068,
}  # fmt: skip
# Half the depth of the body at the joint, m.
_SKIN_M = {
    "head": 0.09, "neck": 0.06, "chest": 0.11, "torso": 0.11, "hip": 0.11, "pelvis": 0.09, "shoulder": 0.06, "elbow": 0.04,
    "wrist": 0.025, "hand": 0.015, "knee": 0.06, "ankle": 0.04, "foot": 0.03,
}  # fmt: skip
# The greatest half-thickness of the joint's own part seen from anywhere, for a heavy adult in winter clothes, rounded up, m.
_REACH_M = {
    "head": 0.25, "neck": 0.25, "chest": 0.40, "hip": 0.40, "shoulder": 0.22, "elbow": 0.15, "wrist": 0.12, "hand": 0.12,
    "pelvis": 0.30, "knee": 0.18, "ankle": 0.15, "foot": 0.15,
}  # fmt: skip

# Joints of ours and those that are the same in other sets and formats. MVN streams a segment's origin, which is its proximal
# joint. Of Kinect the trunk's are the nearest to ours: SpineShoulder lies between the shoulders, SpineBase between the hips; its
# Head is the middle of the head and its Neck lies below the skull base: neither is our head. Of COCO a face's keypoints (nose,
# eyes, ears) are none of ours. ITOP's head is the middle of the head, its neck lies between the shoulders, its torso is no joint,
# and its foot lies somewhere between our ankle and foot: none of them is ours.
_SIDES = {
    "makehuman_cmu": ("Left", "Right"), "mvn": ("Left", "Right"), "vicon_kinematic_fit": ("L", "R"), "plug_in_gait": ("L", "R"),
    "kinect_v2": ("Left", "Right"), "coco": ("left", "right"), "itop": ("l", "r"),
}  # fmt: skip
_SAME = {
    "head": ("Head", "Head", "Head_End", "HEDO", "", "", ""),
    "neck": ("Neck", "Neck", "Head", "", "SpineShoulder", "", ""),
    "chest": ("Spine1", "T8", "LowerBack_L_Collar", "TRXO", "SpineMid", "", ""),
    "hip": ("Hips", "L5", "LowerBack", "PELO", "SpineBase", "", ""),
    "shoulder": ("{}Arm", "{}UpperArm", "{}_Humerus", "{}CJ", "Shoulder{}", "{}_shoulder", "{}shoulder"),
    "elbow": ("{}ForeArm", "{}Forearm", "{}_Elbow", "{}HIJ", "Elbow{}", "{}_elbow", "{}elbow"),
    "wrist": ("{}Hand", "{}Hand", "{}_Wrist", "{}RAO", "Wrist{}", "{}_wrist", ""),
    "hand": ("{}FingerBase", "", "{}_Wrist_End", "{}HAO", "Hand{}", "", "{}hand"),
    "pelvis": ("{}UpLeg", "{}UpperLeg", "{}_Femur", "{}FEP", "Hip{}", "{}_hip", "{}hip"),
    "knee": ("{}Leg", "{}LowerLeg", "{}_Tibia", "{}FEO", "Knee{}", "{}_knee", "{}knee"),
    "ankle": ("{}Foot", "{}Foot", "{}_Foot", "{}TIO", "Ankle{}", "{}_ankle", ""),
    "foot": ("{}ToeBase", "{}Toe", "{}_Toe", "{}FOO", "Foot{}", "", ""),
}


def _same_in(other: str) -> dict[str, str]:
    """The column of another set or format, by joint of ours."""
    column, (left, right) = list(_SIDES).index(other), _SIDES[other]
    names = {joint: _SAME[joint if joint in _SAME else joint[1:]][column] for joint in JOINTS}
    return {joint: name.format(left if joint[0] == "l" else right) for joint, name in names.items() if name}


CABINPOSE = Skeleton(  # ours of 20 joints
    name="cabinpose",
    title="cabinpose",
    definition="joint centres as anatomy has them (docs/joints.md): head = C1 at the skull base, neck = C7/T1, chest = T8,"
    " hip = L5/S1, lpelvis and rpelvis = the femur heads, lhand and rhand = the third knuckles, lfoot and rfoot = the balls of"
    " the feet",
    joints=JOINTS,
    parent={
        "head": "neck", "neck": "chest", "chest": "hip",
        "lshoulder": "neck", "lelbow": "lshoulder", "lwrist": "lelbow", "lhand": "lwrist",
        "rshoulder": "neck", "relbow": "rshoulder", "rwrist": "relbow", "rhand": "rwrist",
        "lpelvis": "hip", "lknee": "lpelvis", "lankle": "lknee", "lfoot": "lankle",
        "rpelvis": "hip", "rknee": "rpelvis", "rankle": "rknee", "rfoot": "rankle",
    },
    spine=("neck", "chest", "hip"),
    groups={  # the thesis' five, and a hand group beside them
        "Head": ("head", "neck"), "Shoulder": ("lshoulder", "rshoulder", "chest"), "Elbow": ("lelbow", "relbow"),
        "Wrist": ("lwrist", "rwrist"), "Hip": ("hip", "lpelvis", "rpelvis"), "Hand": ("lhand", "rhand"),
    },
    sigma=_by_joint(JOINTS, _SIGMA),
    skin_m=_by_joint(JOINTS, _SKIN_M),
    reach_m=_by_joint(JOINTS, _REACH_M),
    sets={
        "upper body": (
            "head", "neck", "rshoulder", "relbow", "rwrist", "lshoulder", "lelbow", "lwrist",
            "chest", "hip", "rpelvis", "lpelvis", "rhand", "lhand",
        ),
        "wrists and hips": ("rwrist", "lwrist", "hip", "rpelvis", "lpelvis"),
    },
    maps={other: _same_in(other) for other in _SIDES},
)  # fmt: skip

ITOP = Skeleton(  # ITOP's 15
    name="itop",
    title="ITOP",
    definition="ITOP's (Haque et al. 2016) on a body: head = the middle of the head, neck midway between the shoulders, torso"
    " midway between neck and hips, lfoot and rfoot = the ankles",
    joints=_ITOP_JOINTS,
    parent={
        "head": "neck", "rshoulder": "neck", "lshoulder": "neck", "relbow": "rshoulder", "lelbow": "lshoulder",
        "rhand": "relbow", "lhand": "lelbow", "torso": "neck", "rhip": "torso", "lhip": "torso", "rknee": "rhip",
        "lknee": "lhip", "rfoot": "rknee", "lfoot": "lknee",
    },
    spine=("neck", "torso"),
    groups={
        "Head": ("head", "neck"), "Shoulder": ("lshoulder", "rshoulder"), "Elbow": ("lelbow", "relbow"),
        "Hand": ("lhand", "rhand"), "Torso": ("torso",), "Hip": ("lhip", "rhip"), "Knee": ("lknee", "rknee"),
        "Foot": ("lfoot", "rfoot"),
    },
    sigma=_by_joint(_ITOP_JOINTS, _SIGMA),
    skin_m=_by_joint(_ITOP_JOINTS, _SKIN_M | {"hip": _SKIN_M["pelvis"]}),
)  # fmt: skip

ANATOMY = "anatomy"  # by which files call the definition of our joints; those that name none have `RIG`'s
# Ours as versions up to 0.2 placed them: datasets, predictions and models of theirs do not say so.
RIG = replace(
    CABINPOSE, name="rig", title="cabinpose up to 0.2",
    definition="bone heads of the MakeHuman CMU rig, as versions up to 0.2 have them: head = the skull base, neck = C7,"
    " chest = T8, hip, lpelvis and rpelvis 2 to 6 cm from where anatomy has L5/S1 and the femur heads, lhand and rhand in the"
    " carpus",
    maps={},
)  # fmt: skip

# Ours as Plug-in Gait makes them of markers (tools/plug_in_gait.py measures how far off they are).
PLUG_IN_GAIT = replace(
    CABINPOSE, name="plug_in_gait", title="Plug-in Gait",
    definition="Plug-in Gait's: lpelvis and rpelvis by Davis 1991, shoulders, elbows, hands, knees and ankles by the chord"
    " function, hip midway between the hips, head = the middle of the front head markers, chest = the thorax' origin at the"
    " suprasternal notch, lfoot and rfoot = the toe markers, no neck",
    maps={},
)  # fmt: skip
# By what `joint_definition` of files says: whose joints of ours they hold.
JOINT_DEFINITIONS: MappingProxyType[str, Skeleton] = MappingProxyType({ANATOMY: CABINPOSE, PLUG_IN_GAIT.name: PLUG_IN_GAIT})

# The sets by name; the first is that of the dataset standard's own joints, the others' are variables of their own.
SKELETONS: MappingProxyType[str, Skeleton] = MappingProxyType({each.name: each for each in (CABINPOSE, ITOP, RIG)})
OTHER_SKELETONS = tuple(each for each in SKELETONS.values() if each != CABINPOSE)  # but ours
if TYPE_CHECKING:
    SkeletonName: TypeAlias = str  # one of `SKELETONS`, as settings name it
    OtherSkeletonName: TypeAlias = str  # one of `OTHER_SKELETONS`
else:  # what settings may say
    SkeletonName, OtherSkeletonName = Literal[tuple(SKELETONS)], Literal[tuple(each.name for each in OTHER_SKELETONS)]
UNKNOWN_SET = "unknown"  # the name of joints that are of none


def skeleton_with(joints: Sequence[str], name: str | None = None) -> Skeleton:
    """Some joints as a set: of the one called `name`, or else of the first that has them all.

    Where there is none, a set of bare names that belongs to nothing: no limbs, no groups, no OKS.
    """
    for each in SKELETONS.values():
        if name in (None, each.name) and set(joints) <= set(each.joints):
            return each.subset(joints)
    unknown = UNKNOWN_SET if name is None or name in SKELETONS else name
    return Skeleton(unknown, unknown, "not stated", tuple(joints), {}, (), {}, {}, {}, head=None)


def skeleton_of(model: Any) -> Skeleton:
    """The joints of a detector or of a predictions file as a set: of the one that it names, or else by their names."""
    return skeleton_with(model.joints, getattr(model, "skeleton", None))


# Xsens MVN's 23 body segments in the order of their ids (id = index + 1; network streaming protocol, revision N, table 1) and the
# 22 joints between them in MVNX's order: name, parent, child. A segment's origin, which is what MVN streams, is the joint to
# its parent (the pelvis': midway between the hips), so that the map "mvn" names a joint of ours by its distal segment.
MVN_SEGMENTS: tuple[str, ...] = (
    "Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head", "RightShoulder", "RightUpperArm", "RightForearm", "RightHand",
    "LeftShoulder", "LeftUpperArm", "LeftForearm", "LeftHand", "RightUpperLeg", "RightLowerLeg", "RightFoot", "RightToe",
    "LeftUpperLeg", "LeftLowerLeg", "LeftFoot", "LeftToe",
)  # fmt: skip
# Joints of MVN's segments: name, segment that it hangs on, segment that hangs on it.
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


def _oks_sigma(joint: str) -> float:
    for each in SKELETONS.values():
        if joint in each.sigma:
            return each.sigma[joint]
    raise unknown_name("joint", joint, JOINTS)


LIMBS_OVER_STATURE: Mapping[tuple[str, str], float] = MappingProxyType(
    {("shoulder", "elbow"): 0.186, ("elbow", "wrist"): 0.146, ("hip", "knee"): 0.245, ("knee", "ankle"): 0.246}
)
"""Lengths of limbs between joints, by their words in anatomy, over the stature (Winter, Biomechanics and Motor Control of Human
Movement, 4th ed. 2009, figure 4.1, after Drillis and Contini)."""


def _limb_names(skeleton: Skeleton) -> tuple[tuple[str, str], ...]:
    return tuple((parent, child) for child, parent in skeleton.parent.items())


def _index_pairs(joints: Sequence[str], pairs: Sequence[tuple[str, str]] = _limb_names(CABINPOSE)) -> tuple[tuple[int, int], ...]:
    at = {name: i for i, name in enumerate(joints)}
    return tuple((at[a], at[b]) for a, b in pairs if a in at and b in at)


# Names of version 0.2, which go with the version after the next one (docs/upgrading.md): what stands for each now, and its value.
_OLD: dict[str, tuple[str, Any]] = {
    "INDEX": ("CABINPOSE.index", CABINPOSE.index),
    "PARENT": ("CABINPOSE.parent", CABINPOSE.parent),
    "LIMBS": ("CABINPOSE.parent by name, CABINPOSE.limbs by position", _limb_names(CABINPOSE)),
    "SYMMETRIC_PAIRS": ("CABINPOSE.pairs, by position", tuple((JOINTS[a], JOINTS[b]) for a, b in CABINPOSE.pairs)),
    "REACH_M": ("CABINPOSE.reach_m", CABINPOSE.reach_m),
    "OKS_SIGMA": ("CABINPOSE.sigma, by joint", MappingProxyType(_SIGMA)),
    "GROUPS": ("CABINPOSE.groups", CABINPOSE.groups),
    "UPPER_BODY": ("CABINPOSE.sets['upper body']", CABINPOSE.sets["upper body"]),
    "RIGS": ("CABINPOSE.maps", MappingProxyType({name: table for name, table in CABINPOSE.maps.items() if name != "itop"})),
    "ITOP_JOINTS": ("ITOP.joints", ITOP.joints),
    "ITOP_LIMBS": ("ITOP.parent by name, ITOP.limbs by position", _limb_names(ITOP)),
    "index_pairs": ("Skeleton.subset(joints).limbs", _index_pairs),
    "indices": ("CABINPOSE.indices", CABINPOSE.indices),
    "oks_sigma": ("CABINPOSE.sigma", _oks_sigma),
    "mirrored": ("CABINPOSE.mirror", lambda: list(CABINPOSE.mirror)),
}

if not TYPE_CHECKING:  # so that a checker of types knows that a name is no longer there

    def __getattr__(name: str) -> Any:
        if name not in _OLD:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        new, value = _OLD[name]
        warn(f"{__name__}.{name} is {new} now", DeprecationWarning, stacklevel=2)
        return value
