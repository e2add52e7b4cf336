"""Whether an adapted model is better on frames that nobody has labelled: measures that need no truth, and a rule over them.

Each measure is 0 for a body that is right, and is taken of the joints that both models find: leaving out what is hard gains
nothing. Generated frames, of which the truth is known, speak beside the user's: a model that is better on those alone is taken
where the user's frames say nothing against it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.adapt.pseudo_labels import Course, is_found
from cabinpose.core import Visibility, skeleton_of, surface_depth
from cabinpose.evaluate import frame_weights, interval, weighted_sums
from cabinpose.store import Predictions, camera_of

Floats = NDArray[np.float64]
MOST_LOST: Final = 0.02  # share of the frames in which nobody is found any more that a better model may have
MARGINS: Final = {"unsteadiness": 1.0, "limbs that change their length": 1.0, "joints before the surface": 1.0}
"""mm, % and %: a model that is worse by less may be taken, since answers are off by centimetres (assumed)."""
_FLOATS_M = 0.02  # a joint so far before the surface that the camera measured is not in a body
_BLOCK = 10  # frames in a row that are drawn together: they resemble each other
_FEWEST = 3  # of such blocks that tell how much means differ by chance: of one alone they do not
_ROW = 5  # frames in a row that tell how long limbs are
_RESAMPLES = 2000


@dataclass(frozen=True)
class Compared:
    """A measure of two models on the same frames. unit · before, after: means · low, high: 95 % interval of the mean difference
    over the frames that both answer, after minus before; NaN where too few tell · frames: how many these are, then 0 · margin: by
    how much it may be worse.
    """

    unit: str
    before: float
    after: float
    low: float
    high: float
    frames: int
    margin: float = 0.0

    @property
    def said(self) -> str:
        """better, worse, slightly worse (within the margin), or no difference that the frames could tell."""
        if self.low > 0:
            return "worse" if self.high > self.margin else "slightly worse"
        return "better" if self.high < 0 else "no difference"


@dataclass(frozen=True)
class Decision:
    """What the rule says. measures: by name · found: share of the frames in which somebody is found, before and after · moved_m:
    median distance of the joints of the two models.
    """

    measures: Mapping[str, Compared]
    found: tuple[float, float]
    moved_m: float

    @property
    def adopt(self) -> bool:
        """Take the adapted model: it finds people as often, is better by one measure at least, and worse by none (by less
        than its margin it may be).
        """
        said = [each.said for each in self.measures.values()]
        return self.found[1] >= self.found[0] - MOST_LOST and "better" in said and "worse" not in said

    @property
    def words(self) -> str:
        """The decision in a sentence."""
        lost = self.found[1] < self.found[0] - MOST_LOST
        by = {kind: [name for name, each in self.measures.items() if each.said == kind] for kind in ("better", "worse")}
        if self.adopt:
            return f"take the adapted model: better by {' and '.join(by['better'])}, worse by nothing that matters"
        why = [f"people are found in {100 * self.found[1]:.0f} % of the frames instead of {100 * self.found[0]:.0f} %"] * lost
        why += [f"it is worse by {' and '.join(by['worse'])}"] * bool(by["worse"])
        why += ["it is better by nothing that can be measured here"] * (not by["better"])
        return f"leave the model as it is: {'; '.join(why)}"


def decide(
    dataset: xr.Dataset,
    before: Predictions,
    after: Predictions,
    course: Course,
    *,
    generated: Compared | None = None,
    seed: int = 0,
) -> Decision:
    """What the rule says of two models' answers on the same frames, which neither has learnt from.

    Parameters
    ----------
    dataset
        The frames, with depth.
    before, after
        The answers of both in the order of the frames.
    course
        How the frames follow each other.
    generated
        The errors of both on generated frames, see `compared_errors`.
    seed
        Of the bootstrap.
    """
    blocks, (one, other) = _block_numbers(course), common_joints(before, after)
    limbs = np.array(skeleton_of(before).limbs)
    measures = {
        "unsteadiness": _compared("mm", 1e3 * unsteadiness(one, course), 1e3 * unsteadiness(other, course), blocks, seed),
        "limbs that change their length": _compared(
            "%", 1e2 * limb_spread(one, limbs, course), 1e2 * limb_spread(other, limbs, course), blocks, seed
        ),
        "joints before the surface": _compared("%", 1e2 * floating(dataset, one), 1e2 * floating(dataset, other), blocks, seed),
    }
    measures = {name: replace(each, margin=MARGINS[name]) for name, each in measures.items()}
    if generated is not None:
        measures["errors on generated frames"] = generated
    shares = [float(np.isfinite(found_only(each)).any(axis=(1, 2, 3)).mean()) for each in (before, after)]
    moved = np.linalg.norm(other - one, axis=-1)
    return Decision(measures, (shares[0], shares[1]), float(np.nanmedian(moved)) if np.isfinite(moved).any() else np.nan)


def compared_errors(dataset: xr.Dataset, before: Predictions, after: Predictions, seed: int = 0) -> Compared:
    """Mean distances (cm) to the truth of generated frames, each alone, of the joints in the image that both models find."""
    rows = [dataset["person"].values.tolist().index(name) for name in before.persons]
    columns = [dataset["joint"].values.tolist().index(name) for name in before.joints]
    truth = dataset["joints_3d"].values[:, rows][:, :, columns].astype(np.float64)
    inside = dataset["visibility"].values[:, rows][:, :, columns] > Visibility.OUTSIDE_IMAGE
    off = [np.where(inside, np.linalg.norm(xyz - truth, axis=-1), np.nan) for xyz in common_joints(before, after)]
    one, other = (100 * _mean(each, (1, 2)) for each in off)
    return _compared("cm", one, other, np.arange(len(truth)), seed)


def _compared(unit: str, before: Floats, after: Floats, blocks: NDArray[np.int64], seed: int) -> Compared:
    both = np.isfinite(before) & np.isfinite(after)
    if not both.any():
        return Compared(unit, np.nan, np.nan, np.nan, np.nan, 0)
    sums = np.stack([np.bincount(blocks[both], each) for each in ((after - before)[both], np.ones(both.sum()))], axis=1).astype(
        np.float64
    )
    sums = sums[sums[:, 1] > 0]
    means = float(before[both].mean()), float(after[both].mean())
    if len(sums) < _FEWEST:
        return Compared(unit, *means, np.nan, np.nan, 0)
    weights = frame_weights(np.arange(len(sums)), _RESAMPLES, rng=np.random.Generator(np.random.Philox(seed)))
    drawn = weighted_sums(weights, sums)
    low, high = (float(x[0]) for x in interval(drawn[:, :1] / drawn[:, 1:]))
    return Compared(unit, *means, low, high, int(both.sum()))


def _block_numbers(course: Course) -> NDArray[np.int64]:
    """(F,) the block of each frame: at most `_BLOCK` frames of one group."""
    first = np.concatenate(([True], np.diff(course.group) != 0))
    within = np.arange(len(first)) - np.maximum.accumulate(np.where(first, np.arange(len(first)), 0))
    return np.cumsum(within % _BLOCK == 0) - 1


# ---------------------------------------------------------------------------------------------------- measures, by frame


def found_only(found: Predictions) -> Floats:
    """(F, P, J, 3) m, NaN where a joint is not found."""
    return np.where(is_found(found)[..., None], found.joints_3d, np.nan).astype(np.float64)


def common_joints(before: Predictions, after: Predictions) -> tuple[Floats, Floats]:
    """(F, P, J, 3) m of both, NaN where either does not find a joint."""
    one, other = found_only(before), found_only(after)
    return one + 0 * other, other + 0 * one


def _mean(values: Floats, axes: tuple[int, ...]) -> Floats:
    """The mean over axes without NaN; NaN where there is nothing."""
    known = np.isfinite(values)
    count = known.sum(axis=axes)
    return np.where(count > 0, np.where(known, values, 0.0).sum(axis=axes) / np.maximum(count, 1), np.nan)


def unsteadiness(xyz: Floats, course: Course) -> Floats:
    """(F,) m, how far joints are from the middle between a frame before and a frame later, on average; NaN where there is none.

    Of a body that moves evenly it is 0, of noise of standard deviation s in each coordinate about 1.95 s.
    """
    result = np.full(len(xyz), np.nan)
    inner = (np.diff(course.group)[1:] == 0) & (np.diff(course.group)[:-1] == 0)
    off = np.linalg.norm(xyz[1:-1] - 0.5 * (xyz[2:] + xyz[:-2]), axis=-1)
    result[1:-1] = np.where(inner, _mean(off, (1, 2)), np.nan)
    return result


def limb_spread(xyz: Floats, limbs: NDArray[np.int64], course: Course) -> Floats:
    """(F,) share by which limbs differ from their median length in the row of frames, on average; NaN in short rows."""
    length = np.linalg.norm(xyz[:, :, limbs[:, 0]] - xyz[:, :, limbs[:, 1]], axis=-1)
    result = np.full(len(xyz), np.nan)
    for number in np.unique(course.group):
        rows = np.flatnonzero(course.group == number)
        some = np.isfinite(length[rows]).any(axis=0)
        if len(rows) >= _ROW and some.any():
            usual = np.full(length.shape[1:], np.nan)
            usual[some] = np.nanmedian(length[rows][:, some], axis=0)
            result[rows] = _mean(np.abs(length[rows] / usual - 1), (1, 2))
    return result


def floating(dataset: xr.Dataset, xyz: Floats) -> Floats:
    """(F,) share of the joints in the image that lie before the surface that the camera measured there: no body is there."""
    width, height = int(dataset.attrs["width"]), int(dataset.attrs["height"])
    result = np.full(len(xyz), np.nan)
    for row, points in enumerate(xyz):
        frame = dataset.isel(frame=row)
        camera, depth = camera_of(frame, width, height), frame["depth"].values
        known = points[np.isfinite(points).all(axis=-1)]
        uv = camera.project(known)
        before = []
        for point, pixel in zip(known, uv, strict=True):
            if camera.contains(pixel) and np.isfinite(surface := surface_depth(depth, pixel)):
                before.append(np.linalg.norm(point) < np.linalg.norm(camera.unproject(pixel, surface)) - _FLOATS_M)
        if before:
            result[row] = np.mean(before)
    return result
