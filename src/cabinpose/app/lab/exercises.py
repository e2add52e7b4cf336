"""Movements outside the car: the neutral pose, then arms, trunk and legs in each anatomical plane, then the neutral pose again.

The planes and their order are the thesis' (2020, sections 3.2.3 and 3.2.4): what the errors of suit and optical model are told
apart by.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cabinpose.app.lab.motion import F64, KeyedMotion, Window
from cabinpose.core import Matrix, transform
from cabinpose.scene.body import DOF_INDEX, DOFS, LOWER, UPPER, Person
from cabinpose.synth.posture import GROUND_M

PLANES = ("coronal", "sagittal", "transversal")
NEUTRAL_S = 3.0
_SWING_S, _HOLD_S = 1.0, 0.2
_SPREAD = 0.06  # of an amplitude, one sigma: nobody repeats a movement exactly
ARMS_OFF_DEG = 6.0  # hands hang beside the thighs, not in them

_Turns = dict[str, float]  # degrees by degree of freedom; l/r: both sides where a name begins with "*"
# What is done in each plane: the far ends of each movement, one after the other and back; degrees added to the neutral pose.
_MOVEMENTS: dict[str, tuple[_Turns, ...]] = {
    "coronal": (
        {"*shoulder.abduction": 80.0}, {"lumbar.lateral": 15.0, "thorax.lateral": 12.0, "neck.lateral": 10.0},
        {"lumbar.lateral": -15.0, "thorax.lateral": -12.0, "neck.lateral": -10.0}, {"lhip.abduction": 30.0},
        {"rhip.abduction": 30.0},
    ),
    "sagittal": (
        {"*shoulder.flexion": 85.0}, {"*elbow.flexion": 95.0},
        {"lumbar.flexion": 25.0, "thorax.flexion": 12.0, "neck.flexion": 15.0},
        {"lhip.flexion": 65.0, "lknee.flexion": 75.0}, {"rhip.flexion": 65.0, "rknee.flexion": 75.0},
    ),
    "transversal": (
        {"lumbar.rotation": 8.0, "thorax.rotation": 28.0}, {"lumbar.rotation": -8.0, "thorax.rotation": -28.0},
        {"neck.rotation": 30.0, "head.rotation": 20.0}, {"neck.rotation": -30.0, "head.rotation": -20.0},
        {"*elbow.flexion": 85.0, "*shoulder.rotation": -45.0}, {"lhip.rotation": 30.0}, {"rhip.rotation": 30.0},
    ),
}  # fmt: skip


def neutral_pose() -> F64:
    """q (D,) rad of the N-pose: upright, arms hanging beside the thighs."""
    q = np.zeros(len(DOFS))
    for side in "lr":
        q[DOF_INDEX[side + "shoulder.abduction"]] = np.radians(ARMS_OFF_DEG)
    return q


def exercises(
    person: Person, *, at_m: tuple[float, float] = (0.0, 0.0), heading: float = 0.0, rng: np.random.Generator
) -> KeyedMotion:
    """The movements of a person who stands at (x, y) m of a room's floor (z = 0) and looks along `heading` (rad about z).

    Windows: neutral_first, coronal, sagittal, transversal, neutral_last. The pelvis stays where it is.
    """
    neutral, root = neutral_pose(), _standing(person, at_m, heading)
    keys, arrive, leave, names = [neutral], [0.0], [NEUTRAL_S], ["neutral"]
    windows = [Window("neutral_first", 0.0, NEUTRAL_S)]
    for plane in PLANES:
        begun = leave[-1]
        for turns in _MOVEMENTS[plane]:
            for q, hold in ((_turned(neutral, turns, rng), _HOLD_S), (neutral, _HOLD_S)):
                keys.append(q)
                arrive.append(leave[-1] + _SWING_S * float(rng.uniform(0.9, 1.2)))
                leave.append(arrive[-1] + hold)
                names.append(plane if q is not neutral else "neutral")
        windows.append(Window(plane, begun, leave[-1]))
    leave[-1] += NEUTRAL_S
    windows.append(Window("neutral_last", leave[-1] - NEUTRAL_S, leave[-1]))
    return KeyedMotion(
        person, np.array(arrive), np.array(leave), np.stack(keys), np.tile(root, (len(keys), 1, 1)), np.zeros(len(keys)),
        tuple(names), tuple(windows),
    )  # fmt: skip


def stand(person: Person, seconds: float, *, at_m: tuple[float, float] = (0.0, 0.0), heading: float = 0.0) -> KeyedMotion:
    """Somebody who stands in the N-pose; the rest as `exercises`."""
    root = _standing(person, at_m, heading)
    return KeyedMotion(person, np.zeros(1), np.array([seconds]), neutral_pose()[None], root[None], np.zeros(1), ("neutral",))


def _standing(person: Person, at_m: tuple[float, float], heading: float) -> Matrix:
    """room_from_root (4, 4) of somebody in the N-pose whose soles are on the floor."""
    lowest = min(float(sole[2, 3]) for sole in person.pose(neutral_pose(), np.eye(4)).soles.values())
    return transform(Rotation.from_euler("z", heading), (*at_m, GROUND_M - lowest))


def _turned(neutral: F64, turns: _Turns, rng: np.random.Generator) -> F64:
    q = neutral.copy()
    for name, degrees in turns.items():
        sides = [side + name[1:] for side in "lr"] if name.startswith("*") else [name]
        for dof in sides:
            q[DOF_INDEX[dof]] += np.radians(degrees) * (1.0 + _SPREAD * float(np.clip(rng.standard_normal(), -2.0, 2.0)))
    return np.clip(q, LOWER, UPPER)
