"""Which segment or joint of the suit stands for which one of the optical system's model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from cabinpose.core import CABINPOSE, JOINTS, AlignmentError, unknown_name


class Pair(NamedTuple):
    """One thing, under its names in the suit's and in the optical system's recording."""

    name: str
    suit: str
    optical: str


def _both(name: str, suit: str, optical: str) -> list[Pair]:
    return [Pair(s + name, side + suit, f"{s.upper()}_{optical}") for s, side in (("l", "Left"), ("r", "Right"))]


# The thesis' Table 3.1: a sensor's segment and the segment of Vicon's kinematic fit that turns with it.
SEGMENT_PAIRS: tuple[Pair, ...] = (
    Pair("head", "Head", "Head"), *_both("shoulder", "Shoulder", "Collar"), *_both("upperarm", "UpperArm", "Humerus"),
    *_both("forearm", "Forearm", "Elbow"), *_both("hand", "Hand", "Wrist"), *_both("upperleg", "UpperLeg", "Femur"),
    *_both("lowerleg", "LowerLeg", "Tibia"), *_both("foot", "Foot", "Foot"), Pair("chest", "T8", "LowerBack"),
    Pair("pelvis", "Pelvis", "Root"),
)  # fmt: skip

# By our skeleton: the joints that both systems stream, and the ends of the hands. These are the pairs of the thesis' Table 3.2,
# and the shoulders. It names the arms' joints by the segment before them, not after, and takes R_Collar for the chest.
HAND_ENDS = MappingProxyType({"lhand": "pLeftTopOfHand", "rhand": "pRightTopOfHand"})  # landmarks of MVN's hand segments
_SUIT, _OPTICAL = {**CABINPOSE.maps["mvn"], **HAND_ENDS}, CABINPOSE.maps["vicon_kinematic_fit"]
# Joints that a suit and Vicon's kinematic fit both have, by their names there.
JOINT_PAIRS: tuple[Pair, ...] = (
    *(Pair(joint, _SUIT[joint], _OPTICAL[joint]) for joint in JOINTS if joint in _SUIT and joint in _OPTICAL),
    Pair("chest", "T8", "R_Collar"),
)
PELVIS = MappingProxyType({"left": "lpelvis", "right": "rpelvis", "hip": "hip"})  # the joints that span the pelvis' frame


def present(pairs: Sequence[Pair], suit: Sequence[str], optical: Sequence[str], *, least: int = 1) -> tuple[Pair, ...]:
    """The pairs that both recordings have, of several of one name the first.

    Raises AlignmentError where fewer than `least` are left, saying what is missing and what is there.
    """
    both: dict[str, Pair] = {}
    for pair in pairs:
        if pair.suit in suit and pair.optical in optical:
            both.setdefault(pair.name, pair)
    found = tuple(both.values())
    if len(found) >= least:
        return found
    absent = [f"{p.suit} (suit)" for p in pairs if p.suit not in suit]
    absent += [f"{p.optical} (optical)" for p in pairs if p.optical not in optical]
    raise AlignmentError(
        f"{len(found)} of {len(pairs)} pairs are in both recordings, {least} needed; missing: {', '.join(dict.fromkeys(absent))}",
        hint=f"the suit gives: {', '.join(suit) or 'nothing'}; the optical system gives: {', '.join(optical) or 'nothing'}",
    )


def missing(pairs: Sequence[Pair], found: Sequence[Pair]) -> str:
    """A note on the pairs that were not recorded; empty where all were."""
    absent = dict.fromkeys(p.name for p in pairs if p.name not in {other.name for other in found})
    return f"not recorded by both systems: {', '.join(absent)}" if absent else ""


def limbs(names: Sequence[str], parents: Mapping[str, str]) -> list[tuple[int, int]]:
    """Lines of a stick figure between joints or segments (indices into `names`), over those that are not there."""
    lines = []
    for child in names:
        parent = parents.get(child)
        while parent is not None and parent not in names:
            parent = parents.get(parent)
        if parent is not None:
            lines.append((names.index(parent), names.index(child)))
    return lines


def replaced(pairs: Sequence[Pair], by: Mapping[str, str]) -> tuple[Pair, ...]:
    """The pairs with other optical names: `by` maps our names (or the suit's) to the optical system's."""
    for name in by:
        if not any(name in (p.name, p.suit) for p in pairs):
            raise unknown_name("pair", name, [p.name for p in pairs])
    return tuple(Pair(p.name, p.suit, by.get(p.name, by.get(p.suit, p.optical))) for p in pairs)
