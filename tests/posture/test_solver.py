"""The whole-body solver: against forward kinematics and scipy, within bounds, out of walls, out of each other."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cabinpose.core.frames import apply, invert, transform
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.scene.body import DOFS, SEGMENTS, SUBJECTS, BodyModel, Person
from cabinpose.scene.body.rig import LOWER, UPPER
from cabinpose.scene.cabin import build_cabin
from cabinpose.scene.contact import ContactField
from cabinpose.scene.contact.pairs import SOLIDS
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.posture.samples import samples_of
from cabinpose.synth.posture.seat_fit import fit_seat
from cabinpose.synth.posture.solver import Goals, Sitter, solve
from cabinpose.synth.validate import Validator

Array = NDArray[np.float64]
HANDS = (12, 19)  # bones of the left and the right hand
FEET = (15, 22)


@pytest.fixture(scope="module")
def person() -> Person:
    return BodyModel.load().person(*SUBJECTS["S01"])


def goals_of(
    person: Person, q: Array, root: Array, posture: Array, stiffness: float, tasks: tuple[int, ...] = (0, 1, 2, 3)
) -> Goals:
    """Palms and soles where the posture q has them; the trunk and the pelvis free within reason."""
    there = frames(q, person.rest, root)
    tools = np.concatenate((person.rest.palms, person.rest.soles))[list(tasks)]
    targets = np.concatenate((there.palms, there.soles))[list(tasks)]
    weight = np.tile([5.0, 5.0, 5.0, 1.0, 1.0, 1.0], (len(tasks), 1))
    return Goals(
        posture, np.full(len(q), stiffness), LOWER, UPPER, root, np.full(6, 10.0),
        np.array([(*HANDS, *FEET)[t] for t in tasks], np.int32), tools, np.full(len(tasks), -1, np.int32), targets, weight,
    )  # fmt: skip


def random_posture(rng: np.random.Generator, share: float) -> Array:
    """Between the middle of every range and its ends."""
    middle, half = (LOWER + UPPER) / 2, (UPPER - LOWER) / 2
    return np.asarray(middle + share * half * rng.uniform(-1.0, 1.0, len(middle)))


def test_what_a_posture_reaches_is_found_again(person: Person) -> None:
    rng = np.random.default_rng(1)
    for _ in range(8):
        goal, root = random_posture(rng, 0.5), transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-1, 1, 3))
        start = np.clip(goal + rng.normal(0.0, 0.3, len(goal)), LOWER, UPPER)
        sitter = Sitter(person, "", goals_of(person, goal, root, start, 1e-4), start.copy(), root.copy())
        (left,) = solve([sitter], None, free=True)
        assert left.missed[:, 0].max() < 2e-3
        assert left.missed[:, 1].max() < 2e-2
        there, wanted = frames(sitter.q, person.rest, sitter.root), frames(goal, person.rest, root)
        assert np.linalg.norm(there.palms[:, :3, 3] - wanted.palms[:, :3, 3], axis=1) == pytest.approx(
            left.missed[:2, 0], abs=1e-12
        )


def test_the_least_cost_is_scipys(person: Person) -> None:
    """Targets out of reach, so that tasks, comfort and pelvis fight: the balance is that of an independent solver."""
    rng = np.random.default_rng(2)
    q, root = random_posture(rng, 0.3), np.eye(4)
    goals = goals_of(person, q, root, q, 0.2, (0, 1))
    goals.target[:, :3, 3] += (0.25, 0.0, 0.1)

    def residuals(x: Array) -> Array:
        placed = transform(Rotation.from_rotvec(x[3:6]).as_matrix(), x[:3])
        there = frames(np.ascontiguousarray(x[6:]), person.rest, placed)
        rows = [goals.stiffness * (x[6:] - goals.posture), 10.0 * x[:3], 10.0 * x[3:6]]
        for side in (0, 1):
            error = invert(goals.target[side]) @ there.palms[side]
            turn = Rotation.from_matrix(error[:3, :3]).as_rotvec()
            rows += [goals.weight[side, :3] * error[:3, 3], goals.weight[side, 3:] * turn]
        return np.concatenate(rows)

    low, high = np.concatenate((np.full(6, -1.0), LOWER)), np.concatenate((np.full(6, 1.0), UPPER))
    best = least_squares(residuals, np.concatenate((np.zeros(6), q)), bounds=(low - 1e-9, high + 1e-9))
    sitter = Sitter(person, "", goals, q.copy(), root.copy())
    solve([sitter], None, free=True)
    ours = np.concatenate((sitter.root[:3, 3], Rotation.from_matrix(sitter.root[:3, :3]).as_rotvec(), sitter.q))
    assert (residuals(ours) ** 2).sum() < 1.05 * 2 * best.cost
    assert (residuals(ours) ** 2).sum() > 0.5 * 2 * best.cost  # and it is a balance: nothing is free
    assert best.cost > 0.01


def test_bounds_hold_whatever_is_sought(person: Person) -> None:
    rng = np.random.default_rng(3)
    for _ in range(6):
        q, root = random_posture(rng, 0.9), np.eye(4)
        goals = goals_of(person, q, root, q, 0.01)
        goals.target[:, :3, 3] += rng.normal(0.0, 0.5, (4, 3))
        sitter = Sitter(person, "", goals, q.copy(), root.copy())
        (left,) = solve([sitter], None)
        assert (sitter.q >= LOWER).all()
        assert (sitter.q <= UPPER).all()
        assert sitter.root[:3, :3] @ sitter.root[:3, :3].T == pytest.approx(np.eye(3), abs=1e-9)
        assert np.isfinite(left.missed).all()


def test_a_hand_that_seeks_a_place_in_the_door_stays_inside(person: Person) -> None:
    cabin = build_cabin("sedan")
    seat = cabin.seats["rear_left"]
    fit = fit_seat(person, seat, seat.default.torso_angle)
    root = seat.vehicle_from_seat(seat.default) @ fit.seat_from_root
    q = fit.q.copy()
    placed = ContactField(cabin).at({s: each.default for s, each in cabin.seats.items()}, 0.0)
    inside = 0
    for aside in ((0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (-0.02, 0.0, 0.0), (0.0, 0.02, 0.0), (0.0, -0.02, 0.0), (0.0, 0.0, 0.05)):
        goals = goals_of(person, q, root, q, 0.05, (0,))
        goals.target[0, :3, 3] = seat.h_point(seat.default) + (0.1, 0.42, 0.3) + np.array(aside)
        goals.weight[0, 3:] = 0.0
        deepest = {}
        for free in (True, False):
            sitter = Sitter(person, "rear_left", goals, q.copy(), root.copy(), middle=float(seat.design_h_point[1]))
            (left,) = solve([sitter], placed, free=free)
            skin = person.pose(sitter.q, sitter.root).skin[person.skin_segment == SEGMENTS.index("lhand")]
            deepest[free] = float(placed.clearance(skin).min())
            if free:
                assert left.missed[0, 0] < 0.01
        assert deepest[True] < -0.015
        inside += deepest[False] > -0.008
    assert inside >= 5  # a search may end before it


def test_people_who_sit_too_close_give_way(person: Person) -> None:
    """Two standing 15 cm too close: apart they go, both of them, and the one who is fixed does not."""
    q = np.zeros(len(LOWER))
    for name in ("lshoulder.abduction", "rshoulder.abduction"):
        q[[i for i, dof in enumerate(DOFS) if dof.name == name]] = 0.15
    roots = [transform(np.eye(3), (0.0, y, 0.0)) for y in (0.2, -0.2)]
    for stand in ("fresh", "fixed"):
        goals = [goals_of(person, q, root, q, 0.3, (2, 3))._replace(root_weight=np.full(6, 2.0)) for root in roots]
        sitters = [
            Sitter(person, "", g, q.copy(), r.copy(), middle=float(r[1, 3]), stand=s)  # type: ignore[arg-type]
            for g, r, s in zip(goals, roots, ("fresh", stand), strict=True)
        ]
        solve(sitters, None)
        bodies = [(f"p{k}", person, person.pose(s.q, s.root)) for k, s in enumerate(sitters)]
        assert Validator(None).check(bodies, {}).cause != "person"
        moved = [float(np.abs(s.root - r).max() + np.abs(s.q - q).max()) for s, r in zip(sitters, roots, strict=True)]
        assert moved[0] > 0.01
        assert (moved[1] > 0.01) == (stand == "fresh")


def test_samples_cover_every_solid(person: Person) -> None:
    samples = samples_of(person)
    assert len(samples.rows) == len(SOLIDS)
    assert np.linalg.norm(samples.normal, axis=1) == pytest.approx(1.0, abs=1e-5)
    for first, end in samples.rows:
        heads = range(first, first + (end - first + 3) // 4)
        around = [n for head in heads for n in range(*samples.around[head])]
        assert sorted([*heads, *around]) == list(range(first, end))
        for head in heads:
            away = np.linalg.norm(samples.rest[slice(*samples.around[head])] - samples.rest[head], axis=1)
            assert (away <= samples.reach[head]).all()
            assert samples.reach[head] < 0.2
    wrist = person.joints(np.zeros(len(LOWER)), np.eye(4))[CABINPOSE.index["lwrist"]]
    hand = samples.rest[slice(*samples.rows[SOLIDS.index("lhand")])]
    assert np.linalg.norm(apply(np.eye(4), hand) - wrist, axis=1).min() < 0.6
