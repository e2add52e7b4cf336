"""Motion profiles: how an occupant departs from the posture that was solved for the seat.

Three kinds, chosen by `kind` in a configuration: `gaussian` (a truncated normal distribution per degree of freedom),
`incremental` (every combination of steps within the range of motion) and `mocap` (a recording, retargeted). Angles are
degrees here, at the user's edge, and radians in everything that leaves this module. The one degree of freedom without
a unit, `{l,r}hand.grip` (0 open .. 1 fist), stays as it is. Each has the methods and attributes of `_Profile`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from cabinpose._native import core as native
from cabinpose.core import CMU_UNIT_M, ConfigError, Floats, Ints, MocapError, axis_rotation, unknown_name
from cabinpose.core import reproducible as rp
from cabinpose.scene.body import DOF_INDEX, DOFS, LOWER, UPPER

if TYPE_CHECKING:
    from cabinpose.store.convert import UpAxis
    from cabinpose.synth.posture.retarget import RetargetedMotion


_SPINE = tuple(i for i, dof in enumerate(DOFS) if dof.name.split(".")[0] in ("lumbar", "thorax", "neck", "head"))
_ARMS = tuple(
    i for i, dof in enumerate(DOFS) if dof.name[1:].split(".")[0] in ("clavicle", "shoulder", "elbow", "wrist")
)  # fmt: skip
_HALF_OPEN = 0.3  # the grip of hands that no recording tells of
_LIMIT_SLACK_DEG = 1e-6  # a limit written in degrees may round outwards by this much


def dof_scale(name: str) -> float:
    """What turns a user's value of this degree of freedom into ours: pi/180, or 1 for the grip."""
    return 1.0 if name.endswith(".grip") else math.pi / 180.0


def limits_deg(name: str) -> tuple[float, float]:
    """Lower and upper limit of a degree of freedom at the user's edge; ConfigError where the name is unknown."""
    if name not in DOF_INDEX:
        raise unknown_name("degree of freedom", name, list(DOF_INDEX))
    dof = DOFS[DOF_INDEX[name]]
    scale = dof_scale(name)
    return dof.lower / scale, dof.upper / scale


def check_within(name: str, angle: float, low: float, high: float, slack: float = _LIMIT_SLACK_DEG) -> None:
    """ConfigError where an angle lies outside a joint's limits, in the unit of all three."""
    if not low - slack <= angle <= high + slack:
        raise ConfigError(f"{name}: {angle:g} leaves the joint's limits", hint=f"the range of motion is {low:g} .. {high:g}")


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class GaussianAxis(_Model):
    """A normal distribution of one degree of freedom, truncated to [min_deg, max_deg]."""

    mean_deg: float | None = Field(None, description="Mean; left out: the value of the solved posture.")
    sigma_deg: float = Field(ge=0.0, description="Standard deviation before truncation.")
    min_deg: float | None = Field(None, description="Lower truncation; left out: the joint's lower limit.")
    max_deg: float | None = Field(None, description="Upper truncation; left out: the joint's upper limit.")


class IncrementalAxis(_Model):
    """The values min_deg, min_deg + step_deg, ... not above max_deg of one degree of freedom."""

    min_deg: float | None = Field(None, description="First value; left out: the joint's lower limit.")
    max_deg: float | None = Field(None, description="Bound of the last value; left out: the joint's upper limit.")
    step_deg: float = Field(gt=0.0, description="Distance between neighbouring values.")


def _checked_range(name: str, axis: GaussianAxis | IncrementalAxis) -> tuple[float, float]:
    """The axis' range (degrees), with limits filled in; ConfigError outside the limits or where min > max."""
    lower, upper = limits_deg(name)
    low = lower if axis.min_deg is None else axis.min_deg
    high = upper if axis.max_deg is None else axis.max_deg
    if low > high:
        raise ConfigError(f"{name}: min_deg {low:g} is above max_deg {high:g}", hint="swap the two")
    if low < lower - _LIMIT_SLACK_DEG or high > upper + _LIMIT_SLACK_DEG:
        raise ConfigError(
            f"{name}: the range {low:g} .. {high:g} leaves the joint's limits",
            hint=f"the range of motion is {lower:g} .. {upper:g}",
        )
    return max(low, lower), min(high, upper)


def truncated_normal(mean: Floats, sigma: Floats, lower: Floats, upper: Floats, *, rng: np.random.Generator) -> Floats:
    """Draw from normal distributions truncated to [lower, upper], by inversion: one uniform number per element.

    Where sigma is 0 the result is the mean, moved into the range. Inverting through the nearer tail keeps precision
    when the range lies many sigmas from the mean.
    """
    uniform = rng.random(mean.shape)
    safe = np.where(sigma > 0, sigma, 1.0)
    a, b = (lower - mean) / safe, (upper - mean) / safe
    flip = a + b > 0  # more mass below: work with the mirrored distribution, whose cdf does not round to 1
    a, b = np.where(flip, -b, a), np.where(flip, -a, b)
    u = np.where(flip, 1.0 - uniform, uniform)
    low, high, z = np.empty((3, *mean.shape))
    native.normal_cdf(a, low)
    native.normal_cdf(b, high)
    native.normal_quantile(np.clip(low + u * (high - low), np.finfo(float).tiny, None), z)
    z = np.where(flip, -z, z)
    return np.clip(np.where(sigma > 0, mean + safe * z, mean), lower, upper)


@dataclass(frozen=True, eq=False)
class _GaussianTable:
    """index: (K,) degrees of freedom · mean (NaN: the posture's), sigma, lower, upper: (K,) each, in our units."""

    index: Ints
    mean: Floats
    sigma: Floats
    lower: Floats
    upper: Floats


class Recorded(NamedTuple):
    """One frame of a recording: q (D,) rad, and the root's rotation (3, 3) where x is the first pose's heading."""

    q: Floats
    root: Floats


class _Profile(_Model):
    """Interface of a motion profile.

    may_skip: whether a frame without a valid scene is skipped; otherwise it ends the run.
    """

    may_skip: ClassVar[bool] = False

    @property
    def held(self) -> tuple[str, ...]:
        """Degrees of freedom that the solver must not change: they keep the value that `apply` sets."""
        return ()

    @property
    def followed(self) -> tuple[str, ...]:
        """Degrees of freedom that the solver keeps near the value that `apply` sets, as far as car and body allow."""
        return ()

    def preflight(self) -> None:
        """Raise now, before any work starts, the error that would end every frame."""

    def apply(self, q: Floats, *, index: int, rng: np.random.Generator) -> Floats:
        """A copy of the posture q (D,) rad with this profile's degrees of freedom set, for frame `index`."""
        raise NotImplementedError

    def whole_body(self, index: int) -> Recorded | None:
        """The whole pose of a standing person for frame `index`; None where the profile changes a given pose by `apply`."""
        return None


class GaussianProfile(_Profile):
    """Every named degree of freedom is drawn from its own truncated normal distribution; the others stay."""

    kind: Literal["gaussian"] = "gaussian"
    axes: Mapping[str, GaussianAxis] = Field(default_factory=dict, description="By degree of freedom, e.g. lelbow.flexion.")

    @field_validator("axes")
    @classmethod
    def _check(cls, axes: Mapping[str, GaussianAxis]) -> Mapping[str, GaussianAxis]:
        for name, axis in axes.items():
            low, high = _checked_range(name, axis)
            if axis.mean_deg is not None and not low - _LIMIT_SLACK_DEG <= axis.mean_deg <= high + _LIMIT_SLACK_DEG:
                raise ConfigError(
                    f"{name}: the mean {axis.mean_deg:g} lies outside {low:g} .. {high:g}", hint="choose a mean within the range"
                )
        return axes

    @cached_property
    def _table(self) -> _GaussianTable:
        names = sorted(self.axes, key=DOF_INDEX.__getitem__)
        scale = np.array([dof_scale(n) for n in names])
        rows = []
        for name in names:
            axis = self.axes[name]
            mean = math.nan if axis.mean_deg is None else axis.mean_deg
            rows.append((mean, axis.sigma_deg, *_checked_range(name, axis)))
        values = np.array(rows, dtype=np.float64).reshape(-1, 4).T * scale
        return _GaussianTable(np.array([DOF_INDEX[n] for n in names], dtype=np.int64), *values)

    @property
    def held(self) -> tuple[str, ...]:
        return tuple(self.axes)

    def apply(self, q: Floats, *, index: int, rng: np.random.Generator) -> Floats:
        """A copy of q in which each named degree of freedom is drawn from its truncated normal distribution."""
        t = self._table
        result = q.copy()
        mean = np.where(np.isnan(t.mean), q[t.index], t.mean)
        result[t.index] = truncated_normal(mean, t.sigma, t.lower, t.upper, rng=rng)
        return result


def standing(angles_deg: Mapping[str, float]) -> GaussianProfile:
    """A profile that holds each of these degrees of freedom at its angle; ConfigError outside the joint's limits."""
    for name, angle in angles_deg.items():
        check_within(name, angle, *limits_deg(name))
    return GaussianProfile(axes={name: GaussianAxis(mean_deg=angle, sigma_deg=0.0) for name, angle in angles_deg.items()})


class IncrementalProfile(_Profile):
    """Every combination of the axes' values, in lexicographic order: the axis named last varies fastest."""

    may_skip: ClassVar[bool] = True
    kind: Literal["incremental"] = "incremental"
    axes: Mapping[str, IncrementalAxis] = Field(min_length=1, description="By degree of freedom, e.g. lelbow.flexion.")

    @field_validator("axes")
    @classmethod
    def _check(cls, axes: Mapping[str, IncrementalAxis]) -> Mapping[str, IncrementalAxis]:
        for name, axis in axes.items():
            _checked_range(name, axis)
        return axes

    @cached_property
    def values(self) -> dict[str, tuple[float, ...]]:
        """The values of every axis (rad), in the order of the configuration."""
        result = {}
        for name, axis in self.axes.items():
            low, high = _checked_range(name, axis)
            steps = math.floor((high - low) / axis.step_deg + 1e-9)  # the slack keeps 0 .. 0.3 by 0.1 at four values
            result[name] = tuple(min(low + axis.step_deg * k, high) * dof_scale(name) for k in range(steps + 1))
        return result

    @cached_property
    def count(self) -> int:
        """The number of combinations."""
        return math.prod(len(v) for v in self.values.values())

    def combination(self, index: int) -> dict[str, float]:
        """Combination `index` (0 .. count - 1) as value (rad) by degree of freedom, without walking through the others."""
        if not 0 <= index < self.count:
            raise ConfigError(
                f"combination {index} does not exist: the profile has {self.count}",
                hint="ask for at most that many frames, or make a step smaller",
            )
        result = {}
        for name, values in reversed(self.values.items()):
            index, k = divmod(index, len(values))
            result[name] = values[k]
        return dict(reversed(result.items()))

    @property
    def held(self) -> tuple[str, ...]:
        return tuple(self.axes)

    def apply(self, q: Floats, *, index: int, rng: np.random.Generator) -> Floats:
        """Combination `index`; ConfigError where it does not exist."""
        result = q.copy()
        for name, value in self.combination(index).items():
            result[DOF_INDEX[name]] = value
        return result


class MocapProfile(_Profile):
    """A recorded motion, retargeted: its upper body onto the seated posture, or the whole body where one stands."""

    kind: Literal["mocap"] = "mocap"
    path: str = Field(description="BVH (names of the CMU database), MVNX, C3D with Plug-in Gait's bones, or a suit's recording.")
    subject: str | None = Field(None, description="Whose motion, where the file tells of several people.")
    unit_m: float = Field(CMU_UNIT_M, gt=0.0, description="Metres of a BVH file's length unit; CMU: inches times 0.45.")
    up: Literal["y", "z"] = Field("y", description="A BVH file's vertical axis.")
    start_s: float = Field(0.0, ge=0.0, description="Where in the recording to begin.")
    end_s: float | None = Field(None, gt=0.0, description="Where to end; left out: at its end.")
    rate_hz: float = Field(30.0, gt=0.0, description="Poses taken from a second of the recording.")

    @model_validator(mode="after")
    def _check(self) -> MocapProfile:
        if self.end_s is not None and self.end_s <= self.start_s:
            raise ConfigError(f"mocap: end_s {self.end_s:g} is not after start_s {self.start_s:g}", hint="choose a later end")
        return self

    @property
    def followed(self) -> tuple[str, ...]:
        return _UPPER_BODY

    @cached_property
    def count(self) -> int:
        """The number of poses taken from the recording before it is repeated; MocapError where there is none."""
        motion, frame_s, _ = self._motion
        last = len(motion.q) - 1 if self.end_s is None else min(round(self.end_s / frame_s), len(motion.q) - 1)
        if last < self._first:
            raise MocapError(
                f"the motion begins at {self.start_s:g} s, but {self.path} ends after {len(motion.q) * frame_s:.2f} s",
                hint="choose an earlier start_s",
            )
        return int((last - self._first) / self._step) + 1

    def preflight(self) -> None:
        """MocapError for a file that is missing, broken, not retargetable or too short."""
        self.whole_body(0)

    def apply(self, q: Floats, *, index: int, rng: np.random.Generator) -> Floats:
        """The recording's upper body on a seated posture, from its start again after its end.

        Arms are taken as they are, against the chest. The spine keeps the seat's posture and adds the recording's departure
        from its own median, so that a dancer's upright back does not leave the backrest.
        """
        motion, _, middle = self._motion
        recorded, result = motion.q[self._frame(index)], q.copy()
        arms, spine = list(_ARMS), list(_SPINE)
        result[arms] = recorded[arms]
        result[spine] += recorded[spine] - middle[spine]
        for side in "lr":
            result[DOF_INDEX[side + "hand.grip"]] = _HALF_OPEN
        return np.clip(result, LOWER, UPPER)

    def whole_body(self, index: int) -> Recorded:
        """Pose `index` of the recording, from its start again after its end; headings count from the first pose's."""
        motion, _, _ = self._motion
        frame = self._frame(index)
        heading = rp.arctan2(motion.root[self._first, 1, 0], motion.root[self._first, 0, 0])
        return Recorded(motion.q[frame].copy(), rp.matmul(axis_rotation("z", -heading), motion.root[frame]))

    @property
    def _motion(self) -> tuple[RetargetedMotion, float, Floats]:
        return _recorded_motion(self.path, self.unit_m, self.up, self.subject)

    @property
    def _first(self) -> int:
        return round(self.start_s / self._motion[1])

    @property
    def poses_per_s(self) -> float:
        """How many poses a second of the recording has, 1/s: of one slower than `rate_hz` each of its own."""
        return min(self.rate_hz, 1.0 / self._motion[1])

    @property
    def _step(self) -> float:
        return max(1.0 / (self.rate_hz * self._motion[1]), 1.0)

    def _frame(self, index: int) -> int:
        return self._first + round((index % self.count) * self._step)


_UPPER_BODY = tuple(dof.name for dof in DOFS if not dof.name[1:].startswith(("hip", "knee", "ankle")))


@lru_cache(maxsize=8)
def _recorded_motion(path: str, unit_m: float, up: UpAxis, subject: str | None) -> tuple[RetargetedMotion, float, Floats]:
    """A file's retargeted motion, the seconds between frames, and the middle of its spine's angles."""
    from cabinpose.store.convert import read_clip  # noqa: PLC0415 - scipy's rotations, for recordings alone
    from cabinpose.synth.posture.retarget import retarget  # noqa: PLC0415 - likewise

    clip = read_clip(path, unit_m=unit_m, up=up, subject=subject)
    motion = retarget(clip)
    return motion, clip.frame_s, np.median(motion.q, axis=0)


Profile = Annotated[GaussianProfile | IncrementalProfile | MocapProfile, Field(discriminator="kind")]
