"""The skeleton: one tree of twenty joints, its pairs, groups and rigs."""

from __future__ import annotations

import pytest

from cabinpose.core.errors import CabinposeError, unknown_name
from cabinpose.core.skeleton import (
    GROUPS,
    INDEX,
    ITOP_JOINTS,
    JOINTS,
    LIMBS,
    PARENT,
    RIGS,
    SYMMETRIC_PAIRS,
    UPPER_BODY,
    indices,
    mirrored,
)


def test_order_of_the_standard() -> None:
    assert " ".join(JOINTS) == (
        "head neck chest lshoulder rshoulder lelbow relbow lwrist rwrist lhand rhand "
        "hip lpelvis rpelvis lknee rknee lankle rankle lfoot rfoot"
    )
    assert [INDEX[name] for name in JOINTS] == list(range(20))
    assert indices(["hip", "head"]) == [11, 0]


def test_parents_form_one_tree_from_the_hip() -> None:
    assert set(PARENT) == set(JOINTS) - {"hip"}
    assert len(LIMBS) == 19
    for joint in JOINTS:
        seen = []
        while joint != "hip":
            assert joint not in seen
            seen.append(joint)
            joint = PARENT[joint]


def test_mirroring() -> None:
    swap = mirrored()
    assert sorted(swap) == list(range(20))
    assert [swap[i] for i in swap] == list(range(20))
    for i, name in enumerate(JOINTS):
        twin = JOINTS[swap[i]]
        assert (name[0], twin[0]) in {("l", "r"), ("r", "l")} or name == twin
        if name in PARENT:
            assert PARENT[twin] == JOINTS[swap[INDEX[PARENT[name]]]]
    assert len(SYMMETRIC_PAIRS) == 8


def test_groups_and_upper_body_are_of_the_reports() -> None:
    members = [joint for group in GROUPS.values() for joint in group]
    assert len(members) == len(set(members)) == 14
    assert set(members) == set(UPPER_BODY)
    assert UPPER_BODY[:3] == ("head", "neck", "rshoulder")
    assert UPPER_BODY[-2:] == ("rhand", "lhand")


@pytest.mark.parametrize("rig", list(RIGS))
def test_rigs_name_each_joint_once_and_side_by_side(rig: str) -> None:
    names = RIGS[rig]
    assert set(names) <= set(JOINTS)
    assert len(set(names.values())) == len(names)
    for left, right in SYMMETRIC_PAIRS:
        assert (left in names) == (right in names)
        if left in names:
            assert names[left] != names[right]


def test_rows_of_the_design_table() -> None:
    assert RIGS["makehuman_cmu"]["lhand"] == "LeftFingerBase"
    assert RIGS["mvn"]["chest"] == "T8"
    assert "lhand" not in RIGS["mvn"]
    assert RIGS["vicon_kinematic_fit"]["rpelvis"] == "R_Femur"
    assert RIGS["plug_in_gait"]["relbow"] == "RHIJ"
    assert len(ITOP_JOINTS) == 15


def test_errors_carry_the_remedy() -> None:
    error = unknown_name("joint", "nose", ["neck", "head"])
    assert isinstance(error, CabinposeError)
    assert str(error) == "unknown joint 'nose'"
    assert error.hint == "known: head, neck"
