"""Sets of joints: each law holds for every set, and for what is left of it when joints are taken out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cabinpose.core import skeleton as module
from cabinpose.core.errors import CabinposeError, ConfigError, unknown_name
from cabinpose.core.skeleton import (
    CABINPOSE,
    ITOP,
    JOINTS,
    NTU_JOINTS,
    OTHER_SKELETONS,
    SKELETONS,
    Skeleton,
    skeleton_of,
    skeleton_with,
)

ALL = pytest.mark.parametrize("whole", SKELETONS.values(), ids=list(SKELETONS))
subsets = st.sampled_from(list(SKELETONS.values())).flatmap(
    lambda whole: st.tuples(st.just(whole), st.lists(st.sampled_from(whole.joints), unique=True, min_size=1).map(tuple))
)


def test_order_of_the_standard() -> None:
    assert " ".join(JOINTS) == (
        "head neck chest lshoulder rshoulder lelbow relbow lwrist rwrist lhand rhand "
        "hip lpelvis rpelvis lknee rknee lankle rankle lfoot rfoot"
    )
    assert CABINPOSE.joints == JOINTS
    assert CABINPOSE.indices(["hip", "head"]) == [11, 0]
    assert next(iter(SKELETONS)) == "cabinpose"
    assert len(ITOP.joints) == 15


@ALL
def test_parents_form_one_tree(whole: Skeleton) -> None:
    (root,) = set(whole.joints) - set(whole.parent)
    assert set(whole.parent) < set(whole.joints)
    assert len(whole.limbs) == len(whole.joints) - 1
    for joint in whole.joints:
        seen = []
        while joint != root:
            assert joint not in seen
            seen.append(joint)
            joint = whole.parent[joint]


@ALL
def test_the_tree_is_the_same_on_both_sides(whole: Skeleton) -> None:
    twin = {joint: whole.joints[i] for joint, i in zip(whole.joints, whole.mirror, strict=True)}
    assert all(whole.parent[twin[child]] == twin[parent] for child, parent in whole.parent.items())
    assert {twin[joint] for joint in whole.joints if joint[0] == "l"} == {joint for joint in whole.joints if joint[0] == "r"}
    for table in (whole.sigma, whole.skin_m, whole.reach_m):
        assert all(table[twin[joint]] == value for joint, value in table.items())


@ALL
def test_what_is_said_of_joints_is_said_of_all_in_their_order(whole: Skeleton) -> None:
    assert tuple(whole.sigma) == tuple(whole.skin_m) == whole.joints
    assert tuple(whole.reach_m) in {(), whole.joints}
    assert whole.definition
    assert whole.spine[0] == "neck"
    assert len(whole.spine) > 1
    members = [joint for group in whole.groups.values() for joint in group]
    assert len(members) == len(set(members))
    for names in (members, whole.spine, whole.head or (), *whole.sets.values()):
        assert set(names) <= set(whole.joints)


@ALL
def test_maps_name_each_joint_once_and_side_by_side(whole: Skeleton) -> None:
    for names in whole.maps.values():
        assert set(names) <= set(whole.joints)
        assert len(set(names.values())) == len(names)
        for left, right in whole.pairs:
            assert (whole.joints[left] in names) == (whole.joints[right] in names)


def test_names_and_definitions_tell_sets_apart() -> None:
    assert len({each.definition for each in SKELETONS.values()}) == len(SKELETONS)
    assert tuple(SKELETONS.values())[1:] == OTHER_SKELETONS
    theirs = ITOP.marked_by("those of ITOP's annotators")
    assert theirs.joints == ITOP.joints
    assert theirs != ITOP
    assert theirs.marked_by(ITOP.definition) == ITOP
    assert hash(theirs.marked_by(ITOP.definition)) == hash(ITOP)
    assert ITOP.subset(ITOP.joints) == ITOP
    assert ITOP.subset(ITOP.joints[::-1]) != ITOP


@given(subsets)
def test_a_mirror_image_mirrored_is_what_it_was(chosen: tuple[Skeleton, tuple[str, ...]]) -> None:
    whole, joints = chosen
    part = whole.subset(joints)
    mirror = np.array(part.mirror)
    assert sorted(mirror) == list(range(len(joints)))
    assert (mirror[mirror] == np.arange(len(joints))).all()
    for i, j in enumerate(part.mirror):
        assert joints[j] == joints[i] or (joints[j][1:] == joints[i][1:] and {joints[i][0], joints[j][0]} == {"l", "r"})
    assert {tuple(sorted((i, j))) for i, j in enumerate(part.mirror) if i != j} == {tuple(sorted(pair)) for pair in part.pairs}


@given(subsets)
def test_a_subset_knows_of_its_joints_what_the_whole_knows(chosen: tuple[Skeleton, tuple[str, ...]]) -> None:
    whole, joints = chosen
    part = whole.subset(joints)
    assert (part.joints, part.definition) == (joints, whole.definition)
    assert [part.index[joint] for joint in joints] == list(range(len(joints)))
    limbs = [(whole.joints[a], whole.joints[b]) for a, b in whole.limbs]
    assert [(joints[a], joints[b]) for a, b in part.limbs] == [limb for limb in limbs if set(limb) <= set(joints)]
    for name, members in whole.groups.items():
        assert part.groups.get(name, ()) == tuple(joint for joint in members if joint in joints)
    assert all(part.groups.values())
    for name in ("sigma", "skin_m", "reach_m"):
        table: Mapping[str, float] = getattr(part, name)
        assert table == {joint: getattr(whole, name)[joint] for joint in joints if joint in getattr(whole, name)}
        assert tuple(table) in {(), joints}
    assert (part.head is None) == (whole.head is None or not set(whole.head) <= set(joints))
    again = part.subset(joints)
    assert all(getattr(again, each.name) == getattr(part, each.name) for each in fields(Skeleton))


def test_a_set_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        CABINPOSE.parent["head"] = "hip"  # type: ignore[index]
    with pytest.raises(ConfigError, match="unknown joint of ITOP 'chest'"):
        ITOP.subset(["chest"])


def test_groups_and_upper_body_are_of_the_reports() -> None:
    members = [joint for group in CABINPOSE.groups.values() for joint in group]
    upper = CABINPOSE.sets["upper body"]
    assert len(members) == len(set(members)) == 14
    assert set(members) == set(upper)
    assert upper[:3] == ("head", "neck", "rshoulder")
    assert upper[-2:] == ("rhand", "lhand")


def test_rows_of_the_design_table() -> None:
    maps = CABINPOSE.maps
    assert maps["makehuman_cmu"]["lhand"] == "LeftFingerBase"
    assert maps["mvn"]["chest"] == "T8"
    assert "lhand" not in maps["mvn"]
    assert maps["vicon_kinematic_fit"]["rpelvis"] == "R_Femur"
    assert maps["plug_in_gait"]["relbow"] == "RHIJ"


def test_sets_are_mapped_by_a_table_or_not_at_all() -> None:
    ours, theirs = CABINPOSE.counterparts("itop", ITOP.joints)
    assert len(ours) == 10
    assert all(CABINPOSE.maps["itop"][JOINTS[i]] == ITOP.joints[j] for i, j in zip(ours, theirs, strict=True))
    ours, theirs = CABINPOSE.counterparts("kinect_v2", NTU_JOINTS[:4])
    assert [JOINTS[i] for i in ours] == ["chest", "hip"]
    assert [NTU_JOINTS[j] for j in theirs] == ["SpineMid", "SpineBase"]
    none, _ = CABINPOSE.counterparts("kinect_v2", ())
    assert none.shape == (0,)
    with pytest.raises(ConfigError, match="no table says which joints of itop those of kinect_v2 are") as caught:
        ITOP.counterparts("kinect_v2", NTU_JOINTS)
    assert caught.value.hint == "known tables: none"


class _Model:
    def __init__(self, joints: tuple[str, ...], **named: str) -> None:
        self.joints = joints
        self.__dict__.update(named)


def test_the_set_of_a_model() -> None:
    """What it names, or else the first that has all its joints; a set that nobody has defined is names alone."""
    assert skeleton_of(_Model(("head", "neck"))) == CABINPOSE.subset(("head", "neck"))
    assert skeleton_of(_Model(("head", "neck"), skeleton="itop")) == ITOP.subset(("head", "neck"))
    assert skeleton_of(_Model(ITOP.joints)) == ITOP
    for model in (_Model(("nose",)), _Model(("torso",), skeleton="cabinpose")):
        assert skeleton_of(model).name == "unknown"
        assert (skeleton_of(model).joints, skeleton_of(model).limbs) == (model.joints, ())
    assert skeleton_with(("head",), "coco").name == "coco"
    assert skeleton_with(("head",), "coco") not in {CABINPOSE.subset(("head",)), ITOP.subset(("head",))}


@pytest.mark.parametrize("name", list(module._OLD))
def test_old_names_say_what_stands_for_them(name: str) -> None:
    with pytest.warns(DeprecationWarning, match=rf"cabinpose\.core\.skeleton\.{name} is .* now"):
        getattr(module, name)


def test_old_names_are_what_they_were() -> None:
    with pytest.warns(DeprecationWarning, match="now"):
        old = {name: getattr(module, name) for name in module._OLD}
    assert [old["INDEX"][name] for name in JOINTS] == list(range(20))
    assert old["LIMBS"][0] == ("neck", "head")
    assert old["SYMMETRIC_PAIRS"][0] == ("lshoulder", "rshoulder")
    assert old["index_pairs"](("neck", "head")) == ((0, 1),)
    assert old["indices"](["hip"]) == [11]
    assert old["mirrored"]()[3] == 4
    assert old["OKS_SIGMA"]["knee"] == old["oks_sigma"]("lknee") == 0.087
    assert old["oks_sigma"]("torso") == 0.107
    assert "itop" not in old["RIGS"]
    with pytest.raises(ConfigError, match="unknown joint 'nose'"):
        old["oks_sigma"]("nose")
    with pytest.raises(AttributeError, match="no attribute 'NOSES'"):
        module.NOSES  # noqa: B018 - it is asked for


def test_errors_carry_the_remedy() -> None:
    error = unknown_name("joint", "nose", ["neck", "head"])
    assert isinstance(error, CabinposeError)
    assert str(error) == "unknown joint 'nose'"
    assert error.hint == "known: head, neck"
