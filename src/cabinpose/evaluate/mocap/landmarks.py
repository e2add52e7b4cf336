"""Segments from points: what MVN's landmarks and Plug-in Gait's bones in C3D files say of the segments that both systems stream.

A segment's turn is that of its rigid cluster of points since the first frame in which all are seen (Kabsch), so that no axes have
to be agreed upon. Its position is its joint: the middle between the landmarks on both sides of it, where there are two; else the
nearest landmark, whose constant distance from the joint shows in errors of position, not of displacement.

References
----------
Names: MVN User Manual, 12.3.1 (64 landmarks); Vicon Plug-in Gait Reference Guide (a bone is given by its origin O and the ends of
its axes, A, L and P). Femur heads: Bell, Pedersen and Brand 1990, 14 % of the distance of the front spines of the pelvis inwards
from each; taken about MVN's own middle of both, `pHipOrigin`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cabinpose.core import CABINPOSE, JOINTS, AlignmentError
from cabinpose.signals import kabsch

F64 = NDArray[np.float64]


# Weights of the points that give a segment's position; of several rows of one segment, the first whose points are there counts.
Position = tuple[str, Mapping[str, float]]
# The points that turn with a segment.
Cluster = tuple[str, tuple[str, ...]]


def _middle(*names: str) -> dict[str, float]:
    return dict.fromkeys(names, 1 / len(names))


def _suit_positions(side: str, other: str) -> tuple[Position, ...]:
    p = f"p{side}"
    return (
        (f"{side}UpperArm", {f"{p}Acromion": 1.0}),
        (f"{side}Forearm", _middle(f"{p}ArmLatEpicondyle", f"{p}ArmMedEpicondyle")),
        (f"{side}Hand", _middle(f"{p}UlnarStyloid", f"{p}RadialStyloid")),
        (f"{side}UpperLeg", {"pHipOrigin": 1.0, f"{p}ASI": 0.36, f"p{other}ASI": -0.36}),
        (f"{side}LowerLeg", _middle(f"{p}KneeLatEpicondyle", f"{p}KneeMedEpicondyle")),
        (f"{side}Foot", _middle(f"{p}LatMalleolus", f"{p}MedMalleolus")),
        (f"{side}Toe", _middle(f"{p}FirstMetatarsal", f"{p}FifthMetatarsal")),
    )


def _suit_clusters(side: str) -> tuple[Cluster, ...]:
    """Those of a side; not the upper arm, which has two landmarks of its own and the shoulder one."""
    p = f"p{side}"
    return (
        (f"{side}Forearm", (f"{p}UlnarStyloid", f"{p}RadialStyloid", f"{p}Olecranon")),
        (f"{side}Hand", (f"{p}TopOfHand", f"{p}Pinky", f"{p}BallHand")),
        (f"{side}UpperLeg", (f"{p}GreaterTrochanter", f"{p}KneeLatEpicondyle", f"{p}KneeMedEpicondyle", f"{p}Patella")),
        (f"{side}LowerLeg", (f"{p}LatMalleolus", f"{p}MedMalleolus", f"{p}TibialTub")),
        (f"{side}Foot", (f"{p}HeelFoot", f"{p}FirstMetatarsal", f"{p}FifthMetatarsal", f"{p}HeelCenter")),
    )


_FIT, _GAIT = CABINPOSE.maps["vicon_kinematic_fit"], CABINPOSE.maps["plug_in_gait"]
POSITIONS: tuple[Position, ...] = (
    ("Head", _middle("pLeftAuricularis", "pRightAuricularis")), ("Neck", {"pC7SpinalProcess": 1.0}), ("T8", {"pIJ": 1.0}),
    ("L5", {"pL5SpinalProcess": 1.0}), ("Pelvis", {"pHipOrigin": 1.0}), *_suit_positions("Left", "Right"),
    *_suit_positions("Right", "Left"),
    *((_FIT[joint], {_GAIT[joint]: 1.0}) for joint in JOINTS if joint in _FIT and joint in _GAIT), ("Root", {"PELO": 1.0}),
    # where a file has the bones alone: clavicle, humerus and hand begin at these joints
    *((f"{side}_{segment}", {side + point: 1.0})
      for side in "LR" for segment, point in (("Humerus", "CLO"), ("Elbow", "HUO"), ("Wrist_End", "HNO"))),
)  # fmt: skip
CLUSTERS: tuple[Cluster, ...] = (
    ("Head", ("pTopOfHead", "pLeftAuricularis", "pRightAuricularis", "pBackOfHead")),
    ("T8", ("pPX", "pIJ", "pT4SpinalProcess", "pT8SpinalProcess")),
    ("Pelvis", ("pLeftASI", "pRightASI", "pLeftCSI", "pRightCSI", "pLeftIschialTub", "pRightIschialTub", "pSacrum")),
    *_suit_clusters("Left"), *_suit_clusters("Right"),
    *((segment, tuple(bone + end for end in "OALP")) for segment, bone in (
        ("Head", "HED"), ("LowerBack", "TRX"), ("Root", "PEL"),
        *((f"{side}_{segment}", side + bone) for side in "LR" for segment, bone in (
            ("Collar", "CL"), ("Humerus", "HU"), ("Elbow", "RA"), ("Wrist", "HN"), ("Wrist", "HA"), ("Femur", "FE"),
            ("Tibia", "TI"), ("Foot", "FO"),
        )),
    )),
)  # fmt: skip


def segment_poses(position_m: F64, names: Sequence[str]) -> tuple[tuple[str, ...], F64, F64]:
    """The segments that points (T, N, 3) m give: names (S,), positions (T, S, 3) m, orientations (T, S, 4) wxyz; NaN: not known.

    Orientations are turns in the world since the first frame in which a segment's cluster is seen.
    """
    index = {name: i for i, name in enumerate(names)}
    placed: dict[str, F64] = {}
    for segment, weights in POSITIONS:
        if segment not in placed and all(name in index for name in weights):
            placed[segment] = np.einsum("n,tnk->tk", list(weights.values()), position_m[:, [index[name] for name in weights]])
    turned: dict[str, F64] = {}
    for segment, points in CLUSTERS:
        cluster = [index[name] for name in points if name in index]
        if segment not in turned and len(cluster) >= 3:
            turned[segment] = _turns(position_m[:, cluster])
    found = tuple(dict.fromkeys((*placed, *turned)))
    position, orientation = (np.full((len(position_m), len(found), size), np.nan) for size in (3, 4))
    for i, segment in enumerate(found):
        position[:, i], orientation[:, i] = placed.get(segment, np.nan), turned.get(segment, np.nan)
    return found, position, orientation


def _turns(cluster_m: F64) -> F64:
    """(T, 4) turns of a cluster (T, N, 3) since the first whole frame; NaN where it is not whole, or its points lie on a line."""
    turned = np.full((len(cluster_m), 4), np.nan)
    whole = np.flatnonzero(np.isfinite(cluster_m).all(axis=(1, 2)))
    if len(whole):
        seen = cluster_m[whole]
        try:
            fitted = kabsch(seen, np.broadcast_to(seen[0], seen.shape))
        except AlignmentError:
            return turned
        turned[whole] = Rotation.from_matrix(fitted[:, :3, :3]).as_quat(scalar_first=True)
    return turned
