"""Differences between the sides of a body, against the published spreads and the symmetric body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.body import DOFS, SUBJECTS, BodyModel, Person
from cabinpose.scene.body.chart import load_chart
from cabinpose.scene.body.rig import BONE_INDEX

PHENOTYPE, OUTFIT = SUBJECTS["S01"]
ARM, LEG = ("shoulder", "elbow", "wrist"), ("pelvis", "knee", "ankle")


def person(number: int) -> Person:
    return BodyModel.load().person(replace(PHENOTYPE, asymmetry=number), OUTFIT)


def joints(body: Person) -> np.ndarray:
    return body.joints(np.zeros(len(DOFS)), np.eye(4))


def length_m(at: np.ndarray, side: str, chain: tuple[str, ...]) -> float:
    points = at[[CABINPOSE.index[side + name] for name in chain]]
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


@pytest.fixture(scope="module")
def crowd() -> list[Person]:
    return [person(number) for number in range(1, 81)]


@pytest.mark.slow
def test_sides_differ_as_those_of_people_do(crowd: list[Person]) -> None:
    """Legs as in Knutson 2005 (5.2 mm, SD 4.1, whichever is longer), arms 1 % longer on the right."""
    at = [joints(body) for body in crowd]
    legs = np.array([length_m(j, "r", LEG) - length_m(j, "l", LEG) for j in at])
    arms = np.array([length_m(j, "r", ARM) / length_m(j, "l", ARM) - 1 for j in at])
    assert np.abs(legs).mean() == pytest.approx(0.0052, abs=0.0010)
    assert np.abs(legs).std() == pytest.approx(0.0041, abs=0.0010)
    assert 0.3 < (legs > 0).mean() < 0.6
    assert arms.mean() == pytest.approx(0.009, abs=0.003)
    assert 0.003 < arms.std() < 0.012
    assert np.abs(arms).max() < 0.04


def test_the_body_stays_a_body(crowd: list[Person]) -> None:
    """Stature, volume and the places of joints in their limbs stay; without a pattern both sides are equal."""
    plain, c = person(0), load_chart()
    before = joints(plain)
    for side, sign in (("l", 1), ("r", -1)):
        assert before[CABINPOSE.index[side + "wrist"], 1] * sign > 0
    assert np.abs(before[CABINPOSE.index["lwrist"]] * (1, -1, 1) - before[CABINPOSE.index["rwrist"]]).max() < 1e-6
    for body in crowd[:12]:
        at = joints(body)
        assert np.abs(at - before).max() > 0.002
        assert body.stature_m == pytest.approx(plain.stature_m, abs=1e-6)
        assert body.volume_m3 == pytest.approx(plain.volume_m3, rel=0.02)
        for side, sign in (("l", 1), ("r", -1)):
            # Of the mesh at rest: the heads of elbow and knee against the skin around them.
            for bone, along, share in (("forearm", c.along_arm, c.arm), ("shank", c.along_leg, c.leg)):
                ring = (np.abs(along - 1) < 0.15) & (share > 0.9) & (c.side == sign)
                off = [b.rest_skin[ring].mean(axis=0) - b.rest.heads[BONE_INDEX[side + bone]] for b in (body, plain)]
                assert np.abs(off[0] - off[1]).max() < 0.003


def test_a_pattern_is_one_body() -> None:
    assert person(7).rest_skin.tobytes() == person(7).rest_skin.tobytes()
    assert person(7).rest_skin.tobytes() != person(8).rest_skin.tobytes()
