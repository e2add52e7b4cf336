"""Simple mistakes that explain a model's errors: each is undone for a trial before a number is told, and none in silence.

A mistake is a row of `MISTAKES`: its name, what undoes it, in which space, and how it is said. It is named where the median error
would be at least `MARGIN` times smaller without it, and less than half of the distance of joints from the centre of their
person: garbage times 0.001 is nearer to everything, and no answer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import Skeleton
from cabinpose.evaluate.options import THESIS_HEAD_M, THESIS_HEAD_PX

Float = NDArray[np.floating]

MARGIN: Final = 3.0  # exchanging something never halved an error of a detector's own; undoing a mistake divides it by 5 to 50 000
FEWEST_JOINTS: Final = 20  # of fewer, one in a thousand tables of random answers has a row that fits by chance
PAIR_FRAMES: Final = 60  # on which two mistakes at once are tried, of which there are about a hundred pairs
UNIT: Final = MappingProxyType({"2d": ("px", 1.0), "3d": ("cm", 100.0)})
_SMALL: Final = MappingProxyType({"2d": 1.0, "3d": 0.005})  # px, m: errors that need no explanation
_FEWEST_IN_SET: Final = 3  # joints from whose distances the size of a person can be read
_NEAREST: Final = MappingProxyType({"2d": THESIS_HEAD_PX / 2, "3d": THESIS_HEAD_M / 2})  # in place of it: half a head
_BETTER: Final = 0.8  # a later row is taken where it leaves less than this share of an earlier one's error
_AT_THE_LENS_M: Final = 0.05  # a person whose joint lies nearer than this to the lens is not seen: it is the origin of the others
_LIKE_LIMBS: Final = 0.25  # limbs whose length is off by no more than this share are a body's
_MOVES: Final = 0.5  # answers that vary by this share of what the truth does are no constant
_UNRELATED: Final = 0.9  # of the distance to other frames; answers that see anything of their own frame are nearer to it
_FEWEST_FRAMES: Final = 8


class Positions(NamedTuple):
    """uv: (F, P, J, 2) px · xyz: (F, P, J, 3) m, camera frame, NaN where there is none · detail: what is said in words of it."""

    uv: Float
    xyz: Float
    detail: str = ""

    def of(self, space: str) -> Float:
        """Those in a space, 2D or 3D."""
        return self.uv if space == "2d" else self.xyz


@dataclass(frozen=True)
class Trial:
    """What mistakes are tried on: F frames of P slots and J joints, those that count in the truth and were found in the answers.

    frame: (F,) numbers · place: (F,) their positions in what is evaluated · persons, skeleton: names of slots and joints · size:
    width and height of the image, px · vehicle_from_camera: (F, 4, 4) · at: the answers on frames of other numbers; None for a
    detector that runs now, which was given these frames · by_slot: whether the people of a slot belong together; otherwise each
    predicted person is held against the nearest true one.
    """

    true: Positions
    given: Positions
    frame: NDArray[np.int64]
    place: NDArray[np.int64]
    persons: tuple[str, ...]
    skeleton: Skeleton
    size: tuple[int, int]
    vehicle_from_camera: NDArray[np.float64]
    at: Callable[[NDArray[np.int64]], Positions] | None
    by_slot: bool

    def some(self, count: int) -> Trial:
        """At most so many frames, evenly spread."""
        step = -(-len(self.frame) // count)
        if step <= 1:
            return self
        true, given = (Positions(each.uv[::step], each.xyz[::step]) for each in (self.true, self.given))
        return replace(
            self, true=true, given=given, frame=self.frame[::step], place=self.place[::step],
            vehicle_from_camera=self.vehicle_from_camera[::step],
        )  # fmt: skip


Undo = Callable[[Trial], Positions | None]


class Mistake(NamedTuple):
    """A row of the table.

    name: in `report.json` · undo: the positions without it, None where it cannot be · spaces: in which it shows · words: what is
    said after "errors fall from .. to .. if", with {detail} of the positions.
    """

    name: str
    undo: Undo
    spaces: tuple[str, ...]
    words: str


def _xyz(change: Callable[[Float], Float]) -> Undo:
    return lambda trial: trial.given._replace(xyz=change(trial.given.xyz))


def _uv(change: Callable[[Float, Float], Float]) -> Undo:
    """change: of (.., 2) px, and the image's width and height."""
    return lambda trial: trial.given._replace(uv=change(trial.given.uv, np.array(trial.size, float)))


def _signs(x: int, y: int, z: int) -> Undo:
    return _xyz(lambda xyz: xyz * np.array([x, y, z]))


def _of_range(xyz: Float) -> Float:
    """Points whose z is the distance from the lens."""
    square = xyz[..., 2] ** 2 - xyz[..., 0] ** 2 - xyz[..., 1] ** 2
    return np.concatenate((xyz[..., :2], np.sqrt(np.where(square > 0, square, np.nan))[..., None]), axis=-1)


def _of_vehicle(trial: Trial) -> Positions | None:
    pose = trial.vehicle_from_camera
    if not np.isfinite(pose).all() or np.allclose(pose, np.eye(4)):
        return None
    return trial.given._replace(xyz=(trial.given.xyz - pose[:, None, None, :3, 3]) @ pose[:, None, :3, :3])


def _of_root(trial: Trial) -> Positions | None:
    """Each person moved to where it is, if one joint of all answers lies at the origin."""
    if not trial.by_slot:
        return None
    xyz = trial.given.xyz
    away = [_median(np.linalg.norm(xyz[:, :, joint], axis=-1)) for joint in range(xyz.shape[2])]
    root = int(np.argmin(away))
    if away[root] >= _AT_THE_LENS_M:
        return None
    moved = xyz - xyz[:, :, [root]] + trial.true.xyz[:, :, [root]]
    return trial.given._replace(xyz=moved, detail=trial.skeleton.joints[root])


def _turned(uv: Float, size: Float, axis: int) -> Float:
    """Positions that count from the other side along one axis, 0 = u, 1 = v."""
    flipped = uv.copy()
    flipped[..., axis] = size[axis] - 1 - uv[..., axis]
    return flipped


def _sides(trial: Trial) -> Positions:
    mirror = list(trial.skeleton.mirror)
    return Positions(trial.given.uv[:, :, mirror], trial.given.xyz[:, :, mirror])


def _frames_off(by: int) -> Undo:
    return lambda trial: None if trial.at is None else trial.at(trial.frame + by)


def _by_place(trial: Trial) -> Positions | None:
    return None if trial.at is None or (trial.place == trial.frame).all() else trial.at(trial.place)


def _by_text(trial: Trial) -> Positions | None:
    """Answers that were read from files in the order of their names: 0, 1, 10, 11, 2."""
    if trial.at is None:
        return None
    count = int(trial.frame.max()) + 1
    order = np.empty(count, np.int64)
    order[sorted(range(count), key=str)] = np.arange(count)
    return trial.at(order[trial.frame])


def _costs(given: Float, true: Float) -> Float:
    """(N, N) median distance between each of the true N, down, and each of the given N, across; (F, N, M, D) each."""
    every = range(true.shape[1])
    return np.array([[_median(np.linalg.norm(given[:, there] - true[:, here], axis=-1)) for there in every] for here in every])


def _best_order(cost: Float) -> NDArray[np.int64] | None:
    """Which column belongs to each row, by the least sum; None where it is as it is."""
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - it imports for a second

    known = np.isfinite(cost)
    if not known.any():
        return None
    order = linear_sum_assignment(np.where(known, cost, 10 * cost[known].max() + 1))[1].astype(np.int64)
    return None if (order == np.arange(len(cost))).all() else order


def _seats(trial: Trial) -> Positions | None:
    """The seats in the order in which the answers fit best."""
    if not trial.by_slot or len(trial.persons) < 2:
        return None
    space = "3d" if np.isfinite(trial.given.xyz).any() else "2d"
    order = _best_order(_costs(trial.given.of(space), trial.true.of(space)))
    if order is None:
        return None
    moved = [name for here, name in enumerate(trial.persons) if order[here] != here]
    told = (" and " if len(moved) == 2 else ", ").join(moved)
    return Positions(trial.given.uv[:, order], trial.given.xyz[:, order], told)


def _joints(trial: Trial) -> Positions | None:
    """The joints in the order in which the answers fit best."""
    few = trial.some(PAIR_FRAMES)
    space = "3d" if np.isfinite(trial.given.xyz).any() else "2d"
    order = _best_order(_costs(few.given.of(space).swapaxes(1, 2), few.true.of(space).swapaxes(1, 2)))
    if order is None:
        return None
    names = trial.skeleton.joints
    told = [f"{name} under the name {names[there]}" for name, there in zip(names, order, strict=True) if name != names[there]]
    more = f" and {len(told) - 3} more" if len(told) > 3 else ""
    return Positions(trial.given.uv[:, :, order], trial.given.xyz[:, :, order], ", ".join(told[:3]) + more)


_2D, _3D, _BOTH = ("2d",), ("3d",), ("2d", "3d")

_PIXELS = "in place of pixels"
_LIKE_OPENGL = "y points up and z backwards (OpenGL's camera) in place of down and forward"
_BY_PLACE = "the predictions' frames count those that are evaluated, from 0, in place of naming their numbers"

# In the order in which two of them are undone: which frame, then lengths and axes, then who and what.
MISTAKES: Final[tuple[Mistake, ...]] = (
    *(
        Mistake(f"frame {by:+d}", _frames_off(by), _BOTH, f"frame n is given the predictions of frame n {by:+d}")
        for by in (1, -1, 2, -2, 3, -3)
    ),
    Mistake("frames by place", _by_place, _BOTH, _BY_PLACE),
    Mistake("frames by name", _by_text, _BOTH, "the frames were counted in the order of their names as text (0, 1, 10, 11, 2)"),
    Mistake("mm", _xyz(lambda xyz: xyz / 1000), _3D, "x, y and z are millimetres in place of metres"),
    Mistake("cm", _xyz(lambda xyz: xyz / 100), _3D, "x, y and z are centimetres in place of metres"),
    Mistake("inch", _xyz(lambda xyz: xyz * 0.0254), _3D, "x, y and z are inches in place of metres"),
    Mistake("y mirrored", _signs(1, -1, 1), _3D, "y points up in place of down"),
    Mistake("x mirrored", _signs(-1, 1, 1), _3D, "x points left in place of right"),
    Mistake("y and z mirrored", _signs(1, -1, -1), _3D, _LIKE_OPENGL),
    Mistake("z mirrored", _signs(1, 1, -1), _3D, "z points backwards in place of forward"),
    Mistake("x and y mirrored", _signs(-1, -1, 1), _3D, "x points left and y up (an image that is turned by 180°)"),
    Mistake("x and y swapped", _xyz(lambda xyz: xyz[..., [1, 0, 2]]), _3D, "x and y are exchanged"),
    Mistake("x and z swapped", _xyz(lambda xyz: xyz[..., [2, 1, 0]]), _3D, "x and z are exchanged"),
    Mistake("z up", _xyz(lambda xyz: xyz[..., [0, 2, 1]] * np.array([1, -1, 1])), _3D, "z points up and y forward"),
    Mistake("vehicle frame", _of_vehicle, _3D, "x, y and z are of the vehicle's frame in place of the camera's"),
    Mistake("root", _of_root, _3D, "each person is moved to where it is: all are given relative to their {detail}"),
    Mistake("range", _xyz(_of_range), _3D, "z is the distance from the lens in place of that along the optical axis"),
    Mistake("half", _uv(lambda uv, _: 2 * uv + 0.5), _2D, "u and v are of the image at half its size"),
    Mistake("double", _uv(lambda uv, _: (uv - 0.5) / 2), _2D, "u and v are of the image at twice its size"),
    Mistake("quarter", _uv(lambda uv, _: 4 * uv + 1.5), _2D, "u and v are of the image at a quarter of its size"),
    Mistake("normalised", _uv(lambda uv, size: uv * size), _2D, f"u and v go from 0 to 1 {_PIXELS}"),
    Mistake("normalised from -1", _uv(lambda uv, size: (uv + 1) / 2 * size), _2D, f"u and v go from -1 to 1 {_PIXELS}"),
    Mistake("u and v swapped", _uv(lambda uv, _: uv[..., ::-1]), _2D, "u and v are exchanged"),
    Mistake("v mirrored", _uv(lambda uv, size: _turned(uv, size, 1)), _2D, "v counts from the bottom in place of the top"),
    Mistake("u mirrored", _uv(lambda uv, size: _turned(uv, size, 0)), _2D, "u counts from the right in place of the left"),
    Mistake("turned by 180°", _uv(lambda uv, size: size - 1 - uv), _2D, "the image is turned by 180°"),
    Mistake("turned by 90°", _uv(lambda uv, size: _turned(uv[..., ::-1], size, 1)), _2D, "the image is turned by 90°"),
    Mistake("turned by -90°", _uv(lambda uv, size: _turned(uv[..., ::-1], size, 0)), _2D, "the image is turned by -90°"),
    Mistake("sides", _sides, _BOTH, "left and right are exchanged"),
    Mistake("seats", _seats, _BOTH, "the seats are exchanged ({detail}; see --drive-side)"),
    Mistake("joints", _joints, _BOTH, "the joints are named in another order ({detail})"),
)


@dataclass(frozen=True)
class Explanation:
    """A mistake that explains the errors in one space.

    mistakes: names of rows of `MISTAKES`, or "unrelated" · before, after: median error as the answers are, and without the
    mistake, in `unit`; before is infinite where fewer than half as many joints can be compared · words: all of it, a sentence.
    """

    mistakes: tuple[str, ...]
    space: str
    before: float
    after: float
    unit: str
    words: str


def explanations(trial: Trial) -> tuple[Explanation, ...]:
    """The mistake, or the two, that best explain the errors, for each space in which one does.

    Parameters
    ----------
    trial
        Truth and answers.

    Returns
    -------
    tuple of Explanation
        3D before 2D.
    """
    found = []
    for space in ("3d", "2d"):
        if not np.isfinite(trial.given.of(space)).any():
            continue
        best = _best(trial, space, [(row,) for row in MISTAKES if space in row.spaces])
        if best is None and _median(_errors(trial, trial.given, space)) > _near(trial, space):
            best = _best(trial.some(PAIR_FRAMES), space, _pairs(space)) or _unrelated(trial, space)
        if best is not None:
            found.append(best)
    return tuple(found)


def _pairs(space: str) -> list[tuple[Mistake, ...]]:
    """Two mistakes at once that can be told from the answers alone."""
    alone = [row for row in MISTAKES if row.undo not in (_by_place, _by_text, _joints) and not row.name.startswith("frame")]
    return [pair for pair in combinations(alone, 2) if all(space in row.spaces for row in pair)]


def _best(trial: Trial, space: str, rows: Sequence[tuple[Mistake, ...]]) -> Explanation | None:
    given, near = _errors(trial, trial.given, space), _near(trial, space)
    best: tuple[float, NDArray[np.floating], tuple[Mistake, ...], str] | None = None
    for row in rows:
        changed, details = trial, []
        for mistake in row:
            positions = mistake.undo(changed)
            if positions is None:
                break
            details.append(mistake.words.format(detail=positions.detail))
            changed = replace(changed, given=positions)
        else:
            errors = _errors(trial, changed.given, space)
            before, after = _compared(given, errors)
            if before >= max(MARGIN * after, _SMALL[space]) and after < near and (best is None or after < _BETTER * best[0]):
                best = after, errors, row, " and ".join(details)
    if best is None:
        return None
    _, errors, row, condition = best
    unit, per = UNIT[space]
    before = _median(given) * per if np.isfinite(_compared(given, errors)[0]) else np.inf
    after = _median(errors) * per
    if np.isfinite(before):
        words = f"errors fall from {_told(before)} to {_told(after)} {unit} (median, {space.upper()}) if {condition}"
    else:
        words = (
            f"{len(given)} joints can be compared as they are, and {len(errors)}, {_told(after)} {unit} off (median, "
            f"{space.upper()}), if {condition}"
        )
    return Explanation(tuple(each.name for each in row), space, before, after, unit, words)


def _told(error: float) -> str:
    return f"{error:.0f}" if error >= 100 else f"{error:.2g}"


def _near(trial: Trial, space: str) -> float:
    """How near answers lie that are some: half of the median distance of true joints from the centre of their person."""
    true = trial.true.of(space)
    if true.shape[2] < _FEWEST_IN_SET:
        return _NEAREST[space]
    known = np.isfinite(true).all(axis=-1, keepdims=True)
    centre = np.where(known, true, 0).sum(axis=2, keepdims=True) / np.maximum(known.sum(axis=2, keepdims=True), 1)
    return _median(np.linalg.norm(true - centre, axis=-1)) / 2


def _errors(trial: Trial, given: Positions, space: str) -> Float:
    """Distances to the truth of the joints that both have, in one row."""
    true, found = trial.true.of(space), given.of(space)
    if trial.by_slot:
        distance = np.linalg.norm(found - true, axis=-1)
    else:
        every = np.linalg.norm(found[:, :, None] - true[:, None], axis=-1)  # (F, P, T, J)
        known = np.isfinite(every)
        sums, counts = np.where(known, every, 0).sum(axis=-1), known.sum(axis=-1)
        mean = np.where(counts > 0, sums / np.maximum(counts, 1), np.inf)
        distance = np.take_along_axis(every, mean.argmin(axis=-1)[..., None, None], axis=2)
    return distance[np.isfinite(distance)]


def _compared(before: Float, after: Float) -> tuple[float, float]:
    """The medians over as many joints as either has: what cannot be compared is infinitely far, and too few joints are."""
    most = max(len(before), len(after))
    if most < FEWEST_JOINTS:
        return np.inf, np.inf
    middle = most // 2
    first, second = (float(np.partition(each, middle)[middle]) if len(each) > middle else np.inf for each in (before, after))
    return first, second


def _median(values: Float) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.inf


def _unrelated(trial: Trial, space: str) -> Explanation | None:
    """Answers that are bodies and move, and follow other frames as well as their own."""
    frames = len(trial.frame)
    if frames < _FEWEST_FRAMES or not trial.by_slot or not _like_bodies(trial, space):
        return None
    given, true = (_without_mean(each.of(space)) for each in (trial.given, trial.true))
    if _median(np.linalg.norm(given, axis=-1)) < _MOVES * _median(np.linalg.norm(true, axis=-1)):
        return None
    own = np.linalg.norm(given - true, axis=-1)
    steps = sorted({frames // 2, frames // 3, 2 * frames // 3, frames // 4} - {0})
    others = np.stack([np.linalg.norm(np.roll(given, step, axis=0) - true, axis=-1) for step in steps])
    unit, per = UNIT[space]
    before, after = _median(own) * per, _median(others) * per
    if np.isfinite(own).sum() < FEWEST_JOINTS or not np.isfinite(before + after) or before < _UNRELATED * after:
        return None
    words = (
        f"the answers follow other frames as well as their own (off by {_told(after)} and {_told(before)} {unit}, each joint's "
        f"median taken out, {space.upper()}): are they of another dataset, or in another order?"
    )
    return Explanation(("unrelated",), space, before, after, unit, words)


def _without_mean(positions: Float) -> Float:
    """(F, P, J, D) less each joint's median over the frames."""
    known = np.asarray(np.isfinite(positions).all(axis=-1).any(axis=0))[None, ..., None]
    return positions - np.nanmedian(np.where(known, positions, 0), axis=0, keepdims=True)


def _like_bodies(trial: Trial, space: str) -> bool:
    """Whether most limbs of the answers are about as long as in the truth."""
    off = [np.inf]
    for a, b in trial.skeleton.limbs:
        given, true = (
            np.linalg.norm(each[:, :, a] - each[:, :, b], axis=-1) for each in (trial.given.of(space), trial.true.of(space))
        )
        off.append(_median(np.abs(given / np.where(true > 0, true, np.nan) - 1)))
    return float(np.median(off)) <= _LIKE_LIMBS
