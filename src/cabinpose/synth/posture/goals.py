"""From places of hands and feet to what the solver seeks: a person's tasks, and how stiffly the rest of the body follows."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from cabinpose.core import Floats, Ints32, Matrix, invert
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import BONE_INDEX, DOF_INDEX, DOFS, LOWER, UPPER, Person
from cabinpose.scene.cabin import Seat
from cabinpose.synth.posture.context import Trunk
from cabinpose.synth.posture.feet import LEG_STIFFNESS, FootGoal
from cabinpose.synth.posture.frames import frames
from cabinpose.synth.posture.hands import LimbTask
from cabinpose.synth.posture.solver import Goals, Sitter, solve

TASKS = ("lhand", "rhand", "lfoot", "rfoot", "head")
# Weights of departing from the comfortable posture, 1/rad, against those of 1 m: a trunk that follows its hands and gives way.
_OF_JOINT = {"lumbar": 0.2, "thorax": 0.2, "neck": 0.05, "head": 0.04, "head.flexion": 0.09, "lclavicle": 0.08, "rclavicle": 0.08}
_STIFFNESS = np.array([_OF_JOINT.get(dof.name, _OF_JOINT.get(dof.name.split(".")[0], 0.0)) for dof in DOFS])
_ROOT_WEIGHT = np.array([10.0, 4.0, 20.0, 1.5, 1.5, 1.0])  # a pelvis hardly leaves its cushion, and slides and turns before
_STANDING_LEG = np.radians((8.0, 4.0, 0.0, 12.0, 4.0, 0.0))
_ON_GROUND = np.array([4.0, 4.0, 4.0, 0.04, 0.05, 0.04])
_ARM_STIFFER = 2.0  # than for an arm that follows its hand alone
_ON_PLACE = np.array([5.0, 5.0, 5.0, 0.02, 0.02, 0.02])
_DRAGGED_ARM = 0.004
_IN_REACH_M = 0.01
_ON_WAY, _HELD_LIMB = 0.08, 0.03  # 1/rad, of leaving the straight way between two poses: free limbs, and those at their places
_LOOSELY = 0.03  # m/rad
_STILLER = 12.0  # a trunk on the way, so that arms give way to what is there
_STAYS = np.array([20.0, 20.0, 20.0, 0.5, 0.5, 0.5])
_UPPER_BODY = [i for i, dof in enumerate(DOFS) if dof.name.split(".")[0] in _OF_JOINT]
_ON_GAZE = np.array([0.0, 0.0, 0.0, 0.5, 0.5, 0.5])
_ARM = tuple(DOF_INDEX[s + "shoulder.flexion"] for s in "lr")
_LEG = tuple(DOF_INDEX[s + "hip.flexion"] for s in "lr")


class HandGoal(NamedTuple):
    """Where a palm goes: its task, the bone that carries the target ("": the vehicle), whether it is closed around the wheel."""

    task: LimbTask
    carried_by: str = ""
    holds_wheel: bool = False


def sitter(trunk: Trunk, hands: tuple[HandGoal, HandGoal], feet: tuple[FootGoal, FootGoal], head: Matrix) -> Sitter:
    """The solver's input for one person, from the goals of hands, feet and head.

    Parameters
    ----------
    trunk
        Who sits where, with a comfortable trunk; arms and legs are taken from the tasks.
    hands, feet
        Each one's goal.
    head
        `vehicle_from_head`, (4, 4).
    """
    person, seat = trunk.seated.person, trunk.seated.seat
    q, stiffness = trunk.q.copy(), _STIFFNESS.copy()
    rows: list[tuple[str, Matrix, str, Matrix, Floats]] = []
    for side, (task, base, _) in enumerate(hands):
        arm = slice(_ARM[side], _ARM[side] + 7)
        q[arm], stiffness[arm] = task.prior, _ARM_STIFFER * task.stiffness
        target = rp.matmul(invert(trunk.skeleton.bone(base)), task.target) if base else task.target
        weight = np.concatenate((task.position_weight, task.rotation_weight))
        rows.append(("lr"[side] + "hand", person.rest.palms[side], base, target, weight))
    for side, foot in enumerate(feet):
        leg = slice(_LEG[side], _LEG[side] + 6)
        q[leg], stiffness[leg] = foot.prior, foot.stiffness
        rows.append(("lr"[side] + "foot", foot.tool, "", foot.target, foot.weight))
    rows.append(("head", np.eye(4), "", head, _ON_GAZE))
    q = np.clip(q, LOWER, UPPER)
    goals = Goals(q, stiffness, LOWER, UPPER, trunk.root, _ROOT_WEIGHT, *_arrays(rows))
    holds = hands[0].holds_wheel, hands[1].holds_wheel
    middle, crossed = float(seat.design_h_point[1]), _crossed(trunk.root, feet[0].target, feet[1].target)
    return Sitter(person, seat.slot, goals, q.copy(), trunk.root.copy(), holds, middle=middle, crossed=crossed)


def _crossed(root: Matrix, left: Matrix, right: Matrix) -> bool:
    """Whether the left foot's place is to the right of the right one's, as `vehicle_from_root` (4, 4) faces."""
    return bool(rp.matmul(root[:3, 1], left[:3, 3] - right[:3, 3]) < 0.0)


def given(person: Person, seat: Seat, q: Floats, root: Matrix) -> Sitter:
    """Somebody who stays as they are: q (D,) rad, root `vehicle_from_root` (4, 4)."""
    goals = Goals(q, np.zeros(len(DOFS)), q, q, root, np.zeros(6), *_arrays([("head", np.eye(4), "", np.eye(4), np.zeros(6))]))
    return Sitter(person, seat.slot, goals, q.copy(), root.copy(), stand="fixed", middle=float(seat.design_h_point[1]))


def between(
    person: Person, seat: Seat, q: Floats, root: Matrix, palms: tuple[Matrix | None, Matrix | None],
    soles: tuple[Matrix, Matrix], holds: tuple[bool, bool],
) -> Sitter:  # fmt: skip
    """Somebody on the way from one pose to another, near q (D,) rad and root `vehicle_from_root` (4, 4), soles at their places.

    palms: `vehicle_from_palm` (4, 4) of hands that have a place, None for those that have none · holds: which of them are closed
    around the wheel.
    """
    stiffness = np.where(_STIFFNESS > 0.0, _STILLER * _STIFFNESS, _ON_WAY)
    rows: list[tuple[str, Matrix, str, Matrix, Floats]] = []
    for side, palm in enumerate(palms):
        if palm is not None:
            stiffness[_ARM[side] : _ARM[side] + 7] = _HELD_LIMB
            rows.append(("lr"[side] + "hand", person.rest.palms[side], "", palm, _STAYS))
    for side, sole in enumerate(soles):
        stiffness[_LEG[side] : _LEG[side] + 6] = _HELD_LIMB
        rows.append(("lr"[side] + "foot", person.rest.soles[side], "", sole, _STAYS))
    goals = Goals(q, stiffness, LOWER, UPPER, root, _ROOT_WEIGHT, *_arrays(rows))
    middle, crossed = float(seat.design_h_point[1]), _crossed(root, soles[0], soles[1])
    return Sitter(person, seat.slot, goals, q.copy(), root.copy(), holds, "settled", middle, crossed)


def staying(chosen: Sitter, q: Floats, root: Matrix, side: int, holds: tuple[bool, bool]) -> Sitter:
    """The same person who moves one arm (0 left, 1 right) and the head as chosen, and the rest as little as that allows.

    q (D,) rad, root `vehicle_from_root` (4, 4): where the person is · holds: which hands are closed around the wheel there.
    """
    goals, q, mine, grip = chosen.goals, q.copy(), _ARM[side], DOF_INDEX["lr"[side] + "hand.grip"]
    posed = chosen.person.pose(q, root)
    q[grip] = chosen.q[grip]
    posture, stiffness, target, weight = (v.copy() for v in (q, goals.stiffness, goals.target, goals.weight))
    base = goals.base.copy()
    posture[mine : mine + 7] = goals.posture[mine : mine + 7]
    for row, place in ((1 - side, posed.palms["rl"[side]]), (2, posed.soles["l"]), (3, posed.soles["r"])):
        target[row], weight[row], base[row] = place, _STAYS, -1
    for first, count in ((_ARM[1 - side], 7), (_LEG[0], 6), (_LEG[1], 6)):
        stiffness[first : first + count] = _HELD_LIMB
    goals = goals._replace(posture=posture, stiffness=stiffness, root=root, target=target, weight=weight, base=base)
    stay = holds[0] and side != 0, holds[1] and side != 1
    return chosen._replace(goals=goals, q=q, root=root.copy(), holds=stay)


def turning_freely(who: Sitter, hands: Iterable[int]) -> Sitter:
    """The same person of `between`, both of whose palms have a place: these `hands` (0 left, 1 right) turn as they like."""
    weight = who.goals.weight.copy()
    weight[list(hands), 3:] = _LOOSELY
    return who._replace(goals=who.goals._replace(weight=weight))


def holding(chosen: Sitter, palms: tuple[Matrix | None, Matrix | None]) -> Sitter:
    """The same person with hands that hold on: `vehicle_from_palm` (4, 4) of each, None of a hand that goes where it was to."""
    target, weight, base = chosen.goals.target.copy(), chosen.goals.weight.copy(), chosen.goals.base.copy()
    for row, palm in enumerate(palms):
        if palm is not None:
            target[row], weight[row], base[row] = palm, _STAYS, -1
    return chosen._replace(goals=chosen.goals._replace(target=target, weight=weight, base=base))


def as_recorded(chosen: Sitter, posture: Floats, upper_body: list[int], weight: float) -> Sitter:
    """The same person with an upper body as near to `posture` (D,) rad as car and body allow, by `weight` (1/rad)."""
    stiffness, tasks = chosen.goals.stiffness.copy(), chosen.goals.weight.copy()
    stiffness[upper_body] = weight
    tasks[[TASKS.index("lhand"), TASKS.index("rhand"), TASKS.index("head")]] = 0.0
    goals = chosen.goals._replace(posture=posture, stiffness=stiffness, weight=tasks)
    return chosen._replace(goals=goals, q=posture.copy())


def stand_on(person: Person, q: Floats, root: Matrix, feet: list[tuple[int, Matrix]]) -> None:
    """Bring soles to the floor by their legs alone, in place of q (D,) rad. feet: side and floor_from_sole (4, 4) of each."""
    rows: list[tuple[str, Matrix, str, Matrix, Floats]] = []
    posture, stiffness, lower, upper = q.copy(), np.zeros(len(q)), q.copy(), q.copy()
    for side, target in feet:
        leg = slice(_LEG[side], _LEG[side] + 6)
        posture[leg], stiffness[leg], lower[leg], upper[leg] = _STANDING_LEG, LEG_STIFFNESS, LOWER[leg], UPPER[leg]
        rows.append(("lr"[side] + "foot", person.rest.soles[side], "", target, _ON_GROUND))
    goals = Goals(posture, stiffness, lower, upper, root, np.full(6, 1e3), *_arrays(rows))
    q[:] = at_goals(Sitter(person, "", goals, posture, root))


def turn_head(person: Person, q: Floats, root: Matrix, head: Matrix) -> None:
    """Turn neck and head alone towards `vehicle_from_head` (4, 4), in place of q (D,) rad."""
    free = [i for i, dof in enumerate(DOFS) if dof.name.startswith(("neck.", "head."))]
    lower, upper, posture, stiffness = q.copy(), q.copy(), np.zeros(len(q)), np.zeros(len(q))
    lower[free], upper[free], stiffness[free] = LOWER[free], UPPER[free], _STIFFNESS[free]
    rows = [("head", np.eye(4), "", head, _ON_GAZE)]
    goals = Goals(posture, stiffness, lower, upper, root, np.full(6, 1e3), *_arrays(rows))
    q[:] = at_goals(Sitter(person, "", goals, q, root))


def hand_to(
    person: Person, q: Floats, root: Matrix, side: int, place: Floats, *, bounds: tuple[Floats, Floats] = (LOWER, UPPER)
) -> Floats:
    """The posture q (D,) rad with a palm (0 left, 1 right) brought to `place` (3,) m, vehicle frame.

    Its arm alone goes there; where it is too short, the trunk bends after it, the other hand stays and the head looks where it
    looked. The palm keeps its direction as far as the arm likes. `bounds` (2 times (D,) rad) hold; whatever is in the way
    is not seen.
    """
    alone = _hand_to(person, q, root, side, place, bounds, leaning=False)
    missed = rp.norm(frames(alone, person.rest, root).palms[side][:3, 3] - place)
    return alone if missed < _IN_REACH_M else _hand_to(person, q, root, side, place, bounds, leaning=True)


def _hand_to(
    person: Person, q: Floats, root: Matrix, side: int, place: Floats, bounds: tuple[Floats, Floats], *, leaning: bool
) -> Floats:
    free = np.zeros(len(q), bool)
    stiffness = np.zeros(len(q))
    if leaning:
        free[_UPPER_BODY] = True
        stiffness[_UPPER_BODY] = _STIFFNESS[_UPPER_BODY]
    arms = [slice(_ARM[s], _ARM[s] + 7) for s in ((0, 1) if leaning else (side,))]
    for arm in arms:
        free[arm], stiffness[arm] = True, _DRAGGED_ARM
    posed = frames(q, person.rest, root)
    target = posed.palms[side].copy()
    target[:3, 3] = place
    rows = [("lr"[side] + "hand", person.rest.palms[side], "", target, _ON_PLACE)]
    if leaning:
        other = "rl"[side]
        rows.append((other + "hand", person.rest.palms[1 - side], "", posed.palms[1 - side], _STAYS))
        rows.append(("head", np.eye(4), "", posed.bone("head"), _ON_GAZE))
    lower, upper = np.where(free, bounds[0], q), np.where(free, bounds[1], q)
    goals = Goals(q, stiffness, lower, upper, root, np.full(6, 1e3), *_arrays(rows))
    return at_goals(Sitter(person, "", goals, q.copy(), root))


def at_goals(who: Sitter) -> Floats:
    """The posture (D,) rad that somebody's goals lead to when nothing is in the way."""
    alone = who._replace(q=np.clip(who.q, who.goals.lower, who.goals.upper), root=who.root.copy())
    solve([alone], None, free=True)
    return alone.q


def _arrays(rows: list[tuple[str, Matrix, str, Matrix, Floats]]) -> tuple[Ints32, Floats, Ints32, Floats, Floats]:
    """bone, tool, base, target and weight of `Goals` from rows of (bone, tool, base or "", target, weight)."""
    return (
        np.array([BONE_INDEX[bone] for bone, *_ in rows], np.int32),
        np.stack([row[1] for row in rows]),
        np.array([BONE_INDEX[row[2]] if row[2] else -1 for row in rows], np.int32),
        np.stack([row[3] for row in rows]),
        np.stack([row[4] for row in rows]),
    )
