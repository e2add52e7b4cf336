"""COCO keypoints that were exported, corrected in another tool and come back: the joints that differ become labels.

A tool such as CVAT keeps the names of the images, which are the numbers of their frames, and the keypoints, but neither the
slots of the people nor what labels an export held. So people are told by where they are, and a joint that is where it was at
any time, in the dataset or in the journal, is no correction: labels that were set since the export stay.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cabinpose.app.label.labelling import Labelling, nowhere
from cabinpose.core import DatasetError, Visibility
from cabinpose.store import JointLabel, Key
from cabinpose.store.convert import FLAG, Keypoints

MOVED_PX = 0.01  # Datumaro, which CVAT exports with, rounds to 0.01 px, our export to 0.001
_FAR_PX = 1e4  # stands for the distance of people who have no joint in common
_STATE = {0: Visibility.ABSENT, 1: Visibility.OCCLUDED, 2: Visibility.VISIBLE}
_HINT = "give the COCO file of an export of this dataset"


class Corrections(NamedTuple):
    """What a file corrects.

    frames: how many frames it changes · earlier: joints left because they are as they were before a later label ·
    unknown: people left because nobody of their frame is theirs.
    """

    changes: list[tuple[Key, JointLabel | None]]
    frames: int
    earlier: int
    unknown: int

    def notes(self) -> list[str]:
        """What was left, and why, for the user."""
        told = {
            "joints are as they were before a later label, which stays": self.earlier,
            "people are nobody of their frame and are left out; an attribute `slot` names the seat": self.unknown,
        }
        return [f"{count} {words}" for words, count in told.items() if count]


def corrections(labelling: Labelling, path: Path, people: Sequence[Keypoints]) -> Corrections:
    """What the people in a file say otherwise than the dataset and its labels ever did.

    Raises DatasetError for a file of another dataset.
    """
    earlier: dict[Key, list[JointLabel | None]] = defaultdict(list)
    for change in labelling.labels.history:
        earlier[change.frame, change.person, change.joint].append(change.label)
    by_image: dict[int, list[Keypoints]] = defaultdict(list)
    for each in people:
        by_image[_row(labelling, each, path)].append(each)
    changes: list[tuple[Key, JointLabel | None]] = []
    same = known = back = unknown = 0
    for row, people in by_image.items():
        number = int(labelling.numbers[row])
        for person, each in zip(_persons(labelling, row, people), people, strict=True):
            if person is None:
                unknown += 1
                continue
            for joint, keypoint in each.joints.items():
                if joint not in labelling.columns:
                    continue
                key = number, person, joint
                held = labelling.held(row, person, joint)
                now = labelling.labels.get(*key) or held
                known += _flag(now) > 0
                if _same(now, keypoint):
                    same += _flag(now) > 0
                elif any(_same(label or held, keypoint) for label in (held, *earlier[key])):
                    back += 1
                    same += _flag(now) > 0
                else:
                    changes.append((key, _label(labelling, row, joint, now, keypoint)))
    if known and not same:
        raise DatasetError(f"not one keypoint of {path} is where this dataset has it", hint=_HINT)
    return Corrections(changes, len({key[0] for key, _ in changes}), back, unknown)


def _row(labelling: Labelling, person: Keypoints, path: Path) -> int:
    """The row of the frame that an image is of, by its name; some tools put folders before it."""
    stem = Path(person.image).stem
    number = int(stem) if stem.isdecimal() else -1
    if not labelling.has_frame(number):
        raise DatasetError(f"{path}: the image '{person.image}' is no frame of this dataset", hint=_HINT)
    size = labelling.dataset.sizes["x"], labelling.dataset.sizes["y"]
    if person.size != size:
        width, height = person.size
        raise DatasetError(f"{path}: '{person.image}' has {width}x{height} pixels, the frames {size[0]}x{size[1]}", hint=_HINT)
    return labelling.row(number)


def _persons(labelling: Labelling, row: int, people: Sequence[Keypoints]) -> list[str | None]:
    """Who of the frame each of some people is: by the slot where the file tells it, else by where they are."""
    found = [each.slot if each.slot in labelling.persons else None for each in people]
    if None not in found:
        return found
    known = {person: _places(labelling, row, person) for person in labelling.persons if person not in found}
    there = [person for person, places in known.items() if places]
    asked = [i for i, person in enumerate(found) if person is None]
    if asked and there:
        from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - half a second, which a studio begins without

        apart = np.array([[_apart(people[i], known[person]) for person in there] for i in asked])
        for i, person in zip(*linear_sum_assignment(apart), strict=True):
            if apart[i, person] < _FAR_PX:
                found[asked[i]] = there[person]
    new = [i for i in asked if found[i] is None]
    free = [person for person in labelling.persons if person not in found and not known.get(person)]
    if len(new) == len(free) == 1:  # nobody else it can be
        found[new[0]] = free[0]
    return found


def _places(labelling: Labelling, row: int, person: str) -> dict[str, tuple[float, float]]:
    """Where the person's joints are held to be, in px."""
    number = int(labelling.numbers[row])
    labels = {j: labelling.labels.get(number, person, j) or labelling.held(row, person, j) for j in labelling.columns}
    return {joint: label.uv for joint, label in labels.items() if label is not None and _flag(label)}


def _apart(person: Keypoints, places: Mapping[str, tuple[float, float]]) -> float:
    """Median distance, px, of joints that both have."""
    both = [joint for joint, (_, _, flag) in person.joints.items() if flag and joint in places]
    if not both:
        return _FAR_PX
    return float(np.median([np.hypot(*np.subtract(person.joints[joint][:2], places[joint])) for joint in both]))


def _flag(label: JointLabel | None) -> int:
    return 0 if label is None or not np.isfinite(label.uv).all() else int(FLAG[label.visibility])


def _same(label: JointLabel | None, keypoint: tuple[float, float, int]) -> bool:
    """Whether a keypoint says what a label says; one that is not labelled has no place."""
    u, v, flag = keypoint
    if label is None or _flag(label) != flag or not flag:
        return _flag(label) == flag
    return bool(np.abs(np.subtract(label.uv, (u, v))).max() <= MOVED_PX)


def _label(labelling: Labelling, row: int, joint: str, now: JointLabel | None, keypoint: tuple[float, float, int]) -> JointLabel:
    u, v, flag = keypoint
    if flag == 0:
        return nowhere()
    state = now.visibility if now is not None and _flag(now) == flag else _STATE[flag]
    if now is not None and _flag(now) and _same(now, (u, v, _flag(now))):
        return replace(now, visibility=state)
    return labelling.moved(row, joint, (u, v), now, state)
