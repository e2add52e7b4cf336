"""What labelling does, apart from how it looks: place, mark, accept, copy, interpolate, undo; what is unsure or suspicious."""

from __future__ import annotations

import secrets
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Literal, NamedTuple, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.align import visibility
from cabinpose.core import CABINPOSE, JOINTS, Camera, DatasetError, Predictor, Visibility, images_of, surface_depth
from cabinpose.evaluate import frame_batch
from cabinpose.store import Change, JointLabel, Key, Labels, Predictions, camera_of

Origin = Literal["label", "dataset", "proposal", "none"]
PRESENT = 0.5  # a joint that a model finds less probable is not proposed
FAR_PX = 20.0  # a label so far from what a model sees there is suspicious: PCKh's threshold is 13 px for a whole head of 26
LONG = 0.25  # and one whose bone differs so much, as a share, from the same bone of the subject in other frames
_LIMBS = tuple((parent, child) for child, parent in CABINPOSE.parent.items())
_LIMBS_OF = {joint: [limb for limb in _LIMBS if joint in limb] for joint in JOINTS}
_FEWEST = 3  # other frames that tell how long a bone usually is
_REMEMBERED = 512  # frames of proposals kept


@dataclass(frozen=True)
class Shown:
    """A joint as the tab shows it: what holds, and where that comes from."""

    joint: str
    label: JointLabel | None
    origin: Origin
    doubt: str = ""


def _joint_sets(known: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Which joints can be labelled, by name, in the order along the skeleton; the first is what one begins with."""
    sets = {name: tuple(joint for joint in joints if joint in known) for name, joints in CABINPOSE.sets.items()}
    upper = sets.pop("upper body")
    sets = {"upper body": upper, "all joints": (*upper, *(n for n in known if n not in upper)), **sets}
    return {name: joints for name, joints in sets.items() if joints}


def open_labels(path: Path, dataset: xr.Dataset) -> Labels:
    """The journal of a dataset's labels; DatasetError where another process has it, or it is of another dataset."""
    persons, joints = ([str(n) for n in dataset[name].values] for name in ("person", "joint"))
    return Labels(path, str(dataset.attrs["dataset_id"]), persons, joints)


class Undone(NamedTuple):
    """What an undo did: how many joints are as they were before, and how many stay, since somebody else has set them later."""

    joints: int
    kept: int


class _Truth(NamedTuple):
    """What the dataset says of a frame: (P, J, 2) px, (P, J, 3) m, (P, J), ()."""

    joints_2d: NDArray[np.float32]
    joints_3d: NDArray[np.float32]
    visibility: NDArray[np.uint8]
    sequence: NDArray[np.integer]


class _Step(NamedTuple):
    """What was changed at once: from where to where it stands in the history, and its time."""

    begin: int
    end: int
    time: str


class Labelling:
    """Labels of one dataset in work. Rows are positions in the dataset; frames are told by their numbers.

    labels: the dataset's journal · role: who labels, as the journal shall say · check: raises DatasetError where the dataset is
    no longer the one that is labelled · session: whose changes undo takes back, another one than all others by default.
    """

    def __init__(
        self,
        dataset: xr.Dataset,
        labels: Labels,
        role: str = "annotator",
        check: Callable[[], object] = lambda: None,
        session: str | None = None,
    ) -> None:
        self.dataset, self.labels, self.role, self._check = dataset, labels, role, check
        self._session = session or secrets.token_hex(4)
        known = [str(name) for name in self.dataset["joint"].values]
        self.sets = _joint_sets(known)
        self.joints = next(iter(self.sets.values()))
        self.columns = {name: i for i, name in enumerate(known)}
        self.persons = tuple(str(name) for name in self.dataset["person"].values)
        self.numbers: NDArray[np.int64] = self.dataset["frame"].values.astype(np.int64)
        self._rows = {number: row for row, number in enumerate(self.numbers.tolist())}
        self._truth = lru_cache(_REMEMBERED)(self._read_truth)  # of many frames all of it takes a second to read
        self._bones: defaultdict[tuple[str, str, str], dict[int, float]] = defaultdict(dict)  # see `_measured_bones`
        self._measured = 0  # changes of the journal that they hold
        self._kept: set[str] = set()  # times of changes all of whose joints somebody else has set since
        self.model: Predictor | Predictions | None = None
        self._uses = 0  # of models and joints, which a thread that began before does not answer for
        self._proposed = lru_cache(_REMEMBERED)(self._propose)

    # ------------------------------------------------------------------------------------------------ what holds

    def shown(self, row: int, person: str) -> list[Shown]:
        """The person's joints in a frame: labels, else what the model proposes, else what the dataset holds."""
        proposals = self.proposals(row).get(person, {})
        doubts = self.doubts(row, person)
        return [self._one(row, person, joint, proposals, doubts) for joint in self.joints]

    def _one(self, row: int, person: str, joint: str, proposals: dict[str, JointLabel], doubts: dict[str, str]) -> Shown:
        label = self.labels.get(int(self.numbers[row]), person, joint)
        if label is not None:
            return Shown(joint, label, "label", doubts.get(joint, ""))
        if joint in proposals:
            return Shown(joint, proposals[joint], "proposal")
        held = self.held(row, person, joint)
        return Shown(joint, held, "dataset" if held is not None else "none")

    def held(self, row: int, person: str, joint: str) -> JointLabel | None:
        """What the dataset says of a joint; of one outside the image its place in it may be unknown."""
        at = self.persons.index(person), self.columns[joint]
        truth = self._truth(row)
        state = Visibility(int(truth.visibility[at]))
        if state == Visibility.ABSENT or (state > Visibility.OUTSIDE_IMAGE and not np.isfinite(truth.joints_2d[at]).all()):
            return None
        (u, v), (x, y, z) = truth.joints_2d[at].tolist(), truth.joints_3d[at].tolist()
        return JointLabel((u, v), (x, y, z), state)

    def _read_truth(self, row: int) -> _Truth:
        return _Truth(*(self.dataset[name][row].values for name in _Truth._fields))

    def has_frame(self, number: int) -> bool:
        """Whether the dataset has a frame of this number."""
        return number in self._rows

    def row(self, number: int) -> int:
        """The row of the frame of a number."""
        return self._rows[number]

    def people(self, row: int) -> list[str]:
        """Who is in a frame, by the dataset or by a label."""
        number = int(self.numbers[row])
        held = np.any(self._truth(row).visibility > Visibility.ABSENT, axis=1)
        labelled = {person for frame, person, _ in self.labels.now if frame == number}
        return [person for person, there in zip(self.persons, held, strict=True) if there or person in labelled]

    def done(self, row: int, person: str) -> bool:
        """Whether every joint of a person has its label in this frame."""
        return all((int(self.numbers[row]), person, joint) in self.labels for joint in self.joints)

    def key_frames(self, person: str) -> list[int]:
        """Rows in which the person is labelled whole."""
        counts = Counter(frame for frame, who, joint in self.labels.now if who == person and joint in self.joints)
        return sorted(self._rows[frame] for frame, count in counts.items() if count == len(self.joints) and frame in self._rows)

    # ------------------------------------------------------------------------------------------------ changes

    def place(self, row: int, person: str, joint: str, u: float, v: float) -> JointLabel:
        """Put a joint at a pixel; in 3D as far behind the measured surface as it was held to be, else at its usual depth.

        Beside the image it is outside of it, however it was seen before.
        """
        now = self._one(row, person, joint, self.proposals(row).get(person, {}), {}).label
        state = now.visibility if now is not None and now.visibility > Visibility.OUTSIDE_IMAGE else Visibility.VISIBLE
        label = self.moved(row, joint, (u, v), now, state)
        self._set([((int(self.numbers[row]), person, joint), label)], "placed")
        return label

    def moved(self, row: int, joint: str, uv: tuple[float, float], now: JointLabel | None, state: Visibility) -> JointLabel:
        """The label of a joint at another pixel than now, see `place`."""
        seen = state if self._camera(row).contains(np.array(uv)) else Visibility.OUTSIDE_IMAGE
        return JointLabel(uv, self._lifted(self._frame(row), joint, uv, now), seen)

    def take_in(self, changes: Sequence[tuple[Key, JointLabel | None]]) -> None:
        """Make labels of what came from elsewhere; one step of undo."""
        if changes:
            self._set(changes, "imported")

    def mark(self, row: int, person: str, joint: str, state: Visibility) -> None:
        """Say how a joint is seen; absent: the person has no such joint here, and it loses its place.

        Raises DatasetError for one that has no place in the image and shall be in it.
        """
        now = self._one(row, person, joint, self.proposals(row).get(person, {}), {}).label
        if state > Visibility.OUTSIDE_IMAGE and (now is None or not self._camera(row).contains(np.array(now.uv))):
            raise DatasetError(f"{joint} has no place in the image", hint="place it there first")
        label = nowhere(state) if now is None or state == Visibility.ABSENT else replace(now, visibility=state)
        self._set([((int(self.numbers[row]), person, joint), label)], "marked")

    def accept(self, row: int, person: str) -> int:
        """Take everything that is shown of a person as it is; the number of joints that became labels."""
        number = int(self.numbers[row])
        changes = [
            ((number, person, shown.joint), shown.label or nowhere())
            for shown in self.shown(row, person)
            if shown.origin != "label"
        ]
        if changes:
            self._set(changes, "accepted")
        return len(changes)

    def copy(self, row: int, person: str) -> bool:
        """Take the labels of the last labelled frame before this one; False where there is none."""
        before = [key for key in self.key_frames(person) if key < row]
        if not before:
            return False
        source, number = int(self.numbers[before[-1]]), int(self.numbers[row])
        copied = [(joint, self.labels.get(source, person, joint)) for joint in self.joints]
        self._set([((number, person, joint), label) for joint, label in copied if label is not None], "copied")
        return True

    def interpolate(self, row: int, person: str) -> int:
        """Label the frames between the labelled ones on both sides of this row, joints on straight lines in 3D, else in 2D.

        Only within a sequence of one person in one car, seen by one camera; a joint that has a place in one of both frames alone
        gets none. The number of frames that were labelled.
        """
        keys = self.key_frames(person)
        before, after = [k for k in keys if k <= row], [k for k in keys if k > row]
        if not before or not after or not self._is_one_motion(slice(before[-1], after[0] + 1), person):
            return 0
        first, last = before[-1], after[0]
        changes: list[tuple[Key, JointLabel | None]] = []
        for between in range(first + 1, last):
            share = (between - first) / (last - first)
            camera = self._camera(between)
            for joint in self.joints:
                a, b = (self.labels.get(int(self.numbers[k]), person, joint) for k in (first, last))
                if a is None or b is None:
                    continue
                key, label = (int(self.numbers[between]), person, joint), _between(a, b, share, camera)
                if key not in self.labels and label is not None:
                    changes.append((key, label))
        if changes:
            self._set(changes, "interpolated")
        return last - first - 1

    def _is_one_motion(self, rows: slice, person: str) -> bool:
        """Whether frames may show somebody who moves: scenes of their own are of one sequence as well, but of several people."""
        at = self.persons.index(person)
        columns = (self.dataset[name].values[rows] for name in ("sequence", "car", "pov", "subject"))
        each = (column if column.ndim == 1 else column[:, at] for column in columns)
        return all(len(set(values.tolist()) - {""}) <= 1 for values in each)

    def check(self) -> None:
        """Raise DatasetError where a change could not be kept: the dataset or the journal is another one, or gone."""
        self._check()
        self.labels.check()

    def undo(self) -> Undone | None:
        """Take the last change of this session back, but for joints that another one has set since; None: there is none.

        After those of this session come the ones that this role made before the journal was opened, newest first.
        """
        step = next((step for step in reversed(self._steps()) if step.time not in self._kept), None)
        if step is None:
            return None
        history = self.labels.history
        later = history[step.end :]
        others = {change.key for position, change in enumerate(later, step.end) if not self._is_ours(position, change)}
        keys = [change.key for change in history[step.begin : step.end]]
        back = dict.fromkeys((key for key in keys if key not in others), cast("JointLabel | None", None))
        back |= {change.key: change.label for change in history[: step.begin] if change.key in back}
        if back:
            self._set(list(back.items()), "undone", step.time)
        else:
            self._kept.add(step.time)
        return Undone(len(back), len(keys) - len(back))

    def _steps(self) -> list[_Step]:
        """What can be undone, oldest first."""
        steps: list[_Step] = []
        end = 0
        for time, group in groupby(self.labels.history, lambda change: change.time):
            changes = list(group)
            begin, end, first = end, end + len(changes), changes[0]
            if first.how != "undone":
                if self._is_ours(begin, first):
                    steps.append(_Step(begin, end, time))
            elif first.undoes:
                steps = [step for step in steps if step.time != first.undoes]
            elif steps and self._is_ours(begin, first):  # of a journal whose undoes do not say what they take back
                steps.pop()
        return steps

    def _is_ours(self, position: int, change: Change) -> bool:
        """Whether a change, at its position in the history, is of this session or of this role before the journal was opened."""
        return change.session == self._session or (position < self.labels.begun and change.role == self.role)

    def _set(self, changes: Sequence[tuple[Key, JointLabel | None]], how: str, undoes: str = "") -> None:
        self.check()
        self.labels.set(changes, role=self.role, how=how, session=self._session, undoes=undoes)

    # ------------------------------------------------------------------------------------------------ proposals

    def use(self, model: Predictor | Predictions | None) -> None:
        """Take proposals from a detector, from a predictions file, or from nothing."""
        self.model, self._uses = model, self._uses + 1
        self._proposed.cache_clear()

    def proposals(self, row: int) -> dict[str, dict[str, JointLabel]]:
        """What the model sees in a frame, by person and joint; empty without a model."""
        return {} if self.model is None else self._proposed(row, self._uses)[0]

    def unsure(self, rows: Sequence[int]) -> list[int]:
        """Rows, the one whose least sure joint is least sure first; a frame in which somebody is not found comes before all."""
        return sorted(rows, key=lambda row: self._proposed(row, self._uses)[1]) if self.model is not None else list(rows)

    def _propose(self, row: int, _uses: int) -> tuple[dict[str, dict[str, JointLabel]], float]:
        model = self.model
        if model is None:  # taken away while a thread asks
            return {}, -1.0
        if isinstance(model, Predictions):
            batch = model.take(self.numbers[row : row + 1])
        else:
            batch = model.predict(frame_batch(self.dataset, slice(row, row + 1), images_of(model)))
        frame, found, least = self._frame(row), {}, 1.0
        camera, depth = self._camera(row), frame["depth"].values
        for slot, person in enumerate(model.persons):
            if person not in self.persons:
                continue
            wanted = [(j, joint) for j, joint in enumerate(model.joints) if joint in self.joints]
            sure = {joint: float(batch.presence[0, slot, j]) for j, joint in wanted}
            xyz = {joint: batch.joints_3d[0, slot, j].astype(float) for j, joint in wanted}
            states = _states(camera, depth, xyz)
            joints = {
                joint: JointLabel(tuple(batch.joints_2d[0, slot, j].tolist()), tuple(xyz[joint].tolist()), states[joint])
                for j, joint in wanted
                if sure[joint] >= PRESENT and np.isfinite(batch.joints_2d[0, slot, j]).all()
            }
            if joints:
                found[person] = joints
                least = min(least, *(abs(p - PRESENT) for p in sure.values()))  # one that is surely not there is sure
        somebody = np.any(self._truth(row).visibility > Visibility.OUTSIDE_IMAGE, axis=1)
        missed = any(there and person not in found for there, person in zip(somebody, self.persons, strict=True))
        return found, -1.0 if missed else least

    # ------------------------------------------------------------------------------------------------ doubts

    def doubts(self, row: int, person: str) -> dict[str, str]:
        """Why labels are suspicious, by joint: far from what the model sees, or on a bone of an unusual length."""
        number = int(self.numbers[row])
        proposals = self.proposals(row).get(person, {})
        why: dict[str, str] = {}
        bones = self._measured_bones()
        for joint in self.joints:
            label = self.labels.get(number, person, joint)
            if label is None or label.visibility <= Visibility.OUTSIDE_IMAGE:
                continue
            if joint in proposals:
                apart = float(np.hypot(*np.subtract(label.uv, proposals[joint].uv)))
                if apart > FAR_PX:
                    why[joint] = f"{apart:.0f} px from what the model sees"
        for parent, child in _LIMBS:
            lengths = bones[person, parent, child]
            length = lengths.get(number)
            if length is None or len(lengths) <= _FEWEST:
                continue
            usual = float(np.median([other for frame, other in lengths.items() if frame != number]))
            if abs(length / usual - 1) > LONG:
                why.setdefault(child, f"{parent} to {child} is {100 * length:.0f} cm, usually {100 * usual:.0f}")
        return why

    def _measured_bones(self) -> Mapping[tuple[str, str, str], dict[int, float]]:
        """Lengths (m) of each person's labelled bones (person, parent, child) by the number of the frame.

        Only those of joints that were changed since are measured again.
        """
        new = self.labels.history[self._measured :]
        self._measured += len(new)
        for frame, person, (parent, child) in {(c.frame, c.person, limb) for c in new for limb in _LIMBS_OF.get(c.joint, ())}:
            length = self._bone(frame, person, parent, child)
            if length is None:
                self._bones[person, parent, child].pop(frame, None)
            else:
                self._bones[person, parent, child][frame] = length
        return self._bones

    def _bone(self, number: int, person: str, parent: str, child: str) -> float | None:
        a, b = self.labels.get(number, person, parent), self.labels.get(number, person, child)
        if a is None or b is None:
            return None
        length = float(np.linalg.norm(np.subtract(a.xyz, b.xyz)))
        return length if np.isfinite(length) else None

    # ------------------------------------------------------------------------------------------------ frames

    @lru_cache(8)  # noqa: B019 - as long-lived as the studio
    def _frame(self, row: int) -> xr.Dataset:
        return self.dataset[["depth", "camera_k", "camera_dist"]].isel(frame=row).load()

    def _camera(self, row: int) -> Camera:
        frame = self._frame(row)
        height, width = frame["depth"].shape
        return camera_of(frame, width, height)

    def _lifted(
        self, frame: xr.Dataset, joint: str, uv: tuple[float, float], now: JointLabel | None
    ) -> tuple[float, float, float]:
        """A joint's point from the surface at its pixel: as far behind it as it was before, where that is known and possible."""
        depth = frame["depth"].values
        height, width = depth.shape
        camera = camera_of(frame, width, height)
        if not camera.contains(np.array(uv)):
            return (float("nan"),) * 3
        surface = surface_depth(depth, np.array(uv))
        behind = CABINPOSE.reach_m.get(joint, 0.0) / _USUAL
        if now is not None and np.isfinite(now.xyz).all() and camera.contains(np.array(now.uv)):
            held = now.xyz[2] - surface_depth(depth, np.array(now.uv))
            if np.isnan(surface):  # nothing was measured here: it stays as far away as it was
                return tuple(camera.unproject(np.array(uv), np.array(now.xyz[2])).tolist())
            if 0.0 <= held <= CABINPOSE.reach_m.get(joint, 0.0):
                behind = held
        x, y, z = camera.unproject(np.array(uv), np.array(surface + behind)).tolist()
        return x, y, z


_USUAL = 3.0  # `reach_m` is the greatest depth of a joint below the surface of a heavy body; the usual one is about a third of it


def nowhere(state: Visibility = Visibility.ABSENT) -> JointLabel:
    """Of a joint without a place."""
    return JointLabel((np.nan, np.nan), (np.nan, np.nan, np.nan), state)


def _states(camera: Camera, depth: NDArray[np.float32], xyz: dict[str, NDArray[np.float64]]) -> dict[str, Visibility]:
    """How each of some joints is seen, told from the depth; visible for joints that are none of ours."""
    points = np.array([xyz.get(joint, np.full(3, np.nan)) for joint in JOINTS])
    states, _ = visibility(camera, depth, points)
    told = dict(zip(JOINTS, states.tolist(), strict=True))
    return {joint: Visibility(told.get(joint) or Visibility.VISIBLE) for joint in xyz}


def _between(a: JointLabel, b: JointLabel, share: float, camera: Camera) -> JointLabel | None:
    """A label on the way from one to another, seen as the nearer one; None where only one of them has a place."""
    near, far = (a, b) if share < 0.5 else (b, a)
    state = near.visibility
    xyz = (1 - share) * np.array(a.xyz) + share * np.array(b.xyz)
    uv = camera.project(xyz) if np.isfinite(xyz).all() else (1 - share) * np.array(a.uv) + share * np.array(b.uv)
    if state > Visibility.OUTSIDE_IMAGE and not camera.contains(uv):
        if not np.isfinite(uv).all():
            return None
        state = Visibility.OUTSIDE_IMAGE
    elif state == Visibility.OUTSIDE_IMAGE and camera.contains(uv):
        state = far.visibility
    (u, v), (x, y, z) = uv.tolist(), xyz.tolist()
    return JointLabel((u, v), (x, y, z), state)
