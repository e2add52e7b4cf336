"""Names of the rig: bones, degrees of freedom with their limits, skin segments.

Frames. Every main bone has an anatomical frame, x forward, y left, z up in the zero pose, for both sides, so a rotation is
written once for the left and mirrored for the right (M = diag(1, -1, 1)). Zero pose: upright stand, legs and arms
straight down, palms to the thighs, looking forward. Limb frames have z along the line joint to joint (shoulder-elbow,
elbow-wrist, wrist-third knuckle, hip-knee, knee-ankle) and y along the elbow's or knee's axis of flexion, both measured
on the person's own bones; trunk, neck, head and clavicle frames are those of the upright body.

Angles are joint coordinates after Grood & Suntay 1983 as used by the ISB (Wu et al. 2002 for spine, hip and ankle; Wu et
al. 2005 for arm and hand): about a fixed axis of the near segment, a floating axis, the long axis of the far one. With
s = +1 left, -1 right:

    lumbar, thorax, neck, head  Ry(flexion) Rx(-lateral) Rz(rotation)            lateral, rotation: + to the left
    clavicle                    Rz(-s protraction) Rx(s elevation)               about the sternoclavicular joint
    shoulder                    Ry(-flexion) Rx(s abduction) Rz(-s rotation)     humerus against thorax, internal rotation +
    elbow                       Ry(-flexion) Rz(-s pronation)
    wrist                       Rx(-s flexion) Ry(-radial)
    hip                         Ry(-flexion) Rx(s abduction) Rz(-s rotation)     internal rotation +
    knee                        Ry(flexion)
    ankle                       Ry(-dorsiflexion) Rx(-s inversion)

The ISB's humerus uses a Y-X-Y sequence, which is singular with the arm at the side; this Y-X-Z one is singular only with
the arm straight out at 90 deg of abduction. Shoulder angles are thoracohumeral: moving the clavicle carries the arm
along, it does not turn it. Raising the arm by beta lifts the clavicle as well, by
0.2 rad (1 - cos beta): 11 deg at 90 deg, after Inman 1944.
Lumbar, thorax and neck angles are spread over several vertebrae in shares of one rotation, so that
their sum is exactly the given angle.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

import numpy as np

SIDES = ("l", "r")
_TRUNK = ("pelvis", "spine04", "spine03", "spine02", "spine01", "neck01", "neck02", "neck03", "head")
_LIMBS = ("clavicle", "upperarm", "forearm", "hand", "thigh", "shank", "foot")
_HELPERS = (
    "scapula", "shoulder_half", "upperarm_twist", "elbow_half", "forearm_near", "forearm_far", "wrist_half",
    "hip_half", "thigh_twist", "knee_half", "ankle_half",
)  # fmt: skip
_FINGERS = tuple(f"finger{finger}_{phalanx}" for finger in range(1, 6) for phalanx in range(1, 4))

MAIN_BONES: tuple[str, ...] = _TRUNK + tuple(s + b for s in SIDES for b in _LIMBS)
HELPER_BONES: tuple[str, ...] = tuple(s + b for s in SIDES for b in _HELPERS)
FINGER_BONES: tuple[str, ...] = tuple(s + b for s in SIDES for b in _FINGERS)
BONES: tuple[str, ...] = MAIN_BONES + HELPER_BONES + FINGER_BONES
BONE_INDEX = MappingProxyType({name: i for i, name in enumerate(BONES)})
N_MAIN = len(MAIN_BONES)

PARENT = MappingProxyType(
    {
        "spine04": "pelvis", "spine03": "spine04", "spine02": "spine03", "spine01": "spine02",
        "neck01": "spine01", "neck02": "neck01", "neck03": "neck02", "head": "neck03",
    }
    | {
        s + child: (s + parent if parent not in _TRUNK else parent)
        for s in SIDES
        for child, parent in (
            ("clavicle", "spine01"), ("upperarm", "clavicle"), ("forearm", "upperarm"), ("hand", "forearm"),
            ("thigh", "pelvis"), ("shank", "thigh"), ("foot", "shank"),
        )
    }
)  # fmt: skip

# Skin segments of the contact tests.
SEGMENTS: tuple[str, ...] = (
    "pelvis", "abdomen", "thorax", "neck", "head",
    "lupper_arm", "lforearm", "lhand", "lthigh", "lshin", "lfoot",
    "rupper_arm", "rforearm", "rhand", "rthigh", "rshin", "rfoot",
)  # fmt: skip


class Dof(NamedTuple):
    """One axis of one joint: its name, its range of motion (rad; `hand.grip` has no unit) and where the range is from."""

    name: str
    lower: float
    upper: float
    source: str


_AAOS = "AAOS 1965, in Norkin & White, Measurement of Joint Motion, 5th ed. 2016"
_WP = "White & Panjabi, Clinical Biomechanics of the Spine, 2nd ed. 1990"
_KAP = "Kapandji, The Physiology of the Joints, 6th ed. 2007"
_CENTRAL = (
    ("lumbar.flexion", -25, 60, _AAOS + " (thoracolumbar, lumbar part)"), ("lumbar.lateral", -25, 25, _AAOS),
    ("lumbar.rotation", -10, 10, _WP), ("thorax.flexion", -20, 30, _WP), ("thorax.lateral", -20, 20, _WP),
    ("thorax.rotation", -35, 35, _WP), ("neck.flexion", -45, 40, _WP + ", C2-C7"), ("neck.lateral", -37, 37, _WP + ", C2-C7"),
    ("neck.rotation", -40, 40, _WP + ", C2-C7"), ("head.flexion", -20, 15, _WP + ", C0-C2"),
    ("head.lateral", -8, 8, _WP + ", C0-C2"), ("head.rotation", -40, 40, _WP + ", C0-C2"),
)  # fmt: skip
_SIDED = (
    ("clavicle.elevation", -10, 40, _KAP), ("clavicle.protraction", -25, 30, _KAP),
    ("shoulder.flexion", -60, 180, _AAOS), ("shoulder.abduction", -45, 180, _AAOS + "; adduction before the trunk: " + _KAP),
    ("shoulder.rotation", -90, 70, _AAOS + " (external 90, internal 70)"),
    ("elbow.flexion", 0, 150, _AAOS), ("elbow.pronation", -80, 80, _AAOS),
    ("wrist.flexion", -70, 80, _AAOS), ("wrist.radial", -30, 20, _AAOS + " (ulnar 30)"),
    ("hand.grip", 0, 1, "0 open, 1 fist; full curl is 90, 100, 70 deg at MCP, PIP, DIP: " + _AAOS),
    ("hip.flexion", -20, 120, _AAOS), ("hip.abduction", -30, 45, _AAOS), ("hip.rotation", -45, 45, _AAOS),
    ("knee.flexion", 0, 140, _AAOS + "; Boone & Azen 1979"),
    ("ankle.dorsiflexion", -50, 20, _AAOS), ("ankle.inversion", -15, 35, _AAOS),
)  # fmt: skip


def _dof(name: str, lower: float, upper: float, source: str) -> Dof:
    scale = 1.0 if name.endswith("grip") else np.pi / 180
    return Dof(name, lower * scale, upper * scale, source)


# The degrees of freedom of the body, trunk first, with their limits and where those are from.
DOFS: tuple[Dof, ...] = tuple(_dof(*row) for row in _CENTRAL) + tuple(
    _dof(s + name, lower, upper, source) for s in SIDES for name, lower, upper, source in _SIDED
)
DOF_INDEX = MappingProxyType({dof.name: i for i, dof in enumerate(DOFS)})  # by name
LOWER = np.array([dof.lower for dof in DOFS])
UPPER = np.array([dof.upper for dof in DOFS])
LOWER.flags.writeable = UPPER.flags.writeable = False
