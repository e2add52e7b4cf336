"""Minimum-jerk timing, and how fast human joints move.

References
----------
Flash, Hogan, "The coordination of arm movements", Journal of Neuroscience 5(7), 1985.
Fleisig, Nicholls, Elliott, Escamilla, "Kinematics used by world class tennis players to produce high-velocity serves", Sports
Biomechanics 2(1), 2003: mean peaks of trunk, upper arm, elbow and wrist.
Grossman, Leigh, Abel, Lanska, Thurston, "Frequency and velocity of rotational head perturbations during locomotion",
Experimental Brain Research 70, 1988: 780 degrees/s of vigorous voluntary head rotation.
"""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from cabinpose.core import Floats
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import DOFS

PEAK = 1.875  # greatest speed over mean speed
# By joint, degrees/s: the trunk's tilt; half of the head's for neck and head; the upper arm's rotation of the slower sex. No
# peaks of seated legs were found: they keep below the pelvis' 440.
_FASTEST_DEG = MappingProxyType(
    {
        "lumbar": 280.0, "thorax": 280.0, "neck": 390.0, "head": 390.0, "clavicle": 280.0, "shoulder": 1370.0, "elbow": 1510.0,
        "wrist": 1950.0, "hip": 440.0, "knee": 440.0, "ankle": 440.0,
    }
)  # fmt: skip
FASTEST_GRIP = 10.0  # from open to fist and back, 1/s


def _fastest(name: str) -> float:
    joint = name.split(".")[0]
    if joint.endswith("hand"):
        return FASTEST_GRIP
    return float(np.radians(_FASTEST_DEG.get(joint) or _FASTEST_DEG[joint[1:]]))


FASTEST: Floats = np.array([_fastest(dof.name) for dof in DOFS])  # (D,) rad/s
FASTEST.flags.writeable = False


def progress(share: Floats) -> Floats:
    """How far a movement is, 0..1, after a share of its duration (any shape; held at the ends)."""
    t = np.clip(share, 0.0, 1.0)
    return np.asarray(rp.power(t, 3) * (10.0 + t * (6.0 * t - 15.0)))


def progress_rate(share: Floats) -> Floats:
    """The derivative of `progress`."""
    t = np.clip(share, 0.0, 1.0)
    return np.asarray(30.0 * (t * (1.0 - t)) ** 2)
