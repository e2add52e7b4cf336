"""Answers of a detector with their names: what they are in words, as a table, drawn into an image."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import ConfigError, PoseBatch, optional_module, skeleton_of

if TYPE_CHECKING:
    import pandas as pd

PRESENT = 0.5  # probability from which on a joint counts as being in the image
_WIDE_PX = 640  # a picture is enlarged by a whole number to about this width: joints of a ToF image lie close together
_DARK, _ABSENT = (16, 18, 22), (150, 156, 166)
_UNITS = {"u": "px", "v": "px", "x": "m", "y": "m", "z": "m", "expected_error_m": "m"}


class _Who(NamedTuple):
    """One person in words. frames: in how many there is a joint · joints: on average in those · away_m: median distance of the
    head, or of all joints where none is known, from the camera · error_m: median of the expected errors; NaN: not known.
    """

    person: str
    frames: int
    joints: float
    away_m: float
    error_m: float


class NamedPoses(PoseBatch):
    """A `PoseBatch` that knows whose joints it holds. persons: (P,) slots · joints: (J,) names · model: who answered ·
    skeleton: the set that the joints are of.
    """

    persons: tuple[str, ...]
    joints: tuple[str, ...]
    model: str
    skeleton: str

    @property
    def numbers(self) -> NDArray[np.int64]:
        """(F,) the numbers of the frames; of one frame's answer (1,) zero."""
        return np.arange(len(self._stacked("score")), dtype=np.int64)

    def __repr__(self) -> str:
        lines = [f"{type(self).__name__} of {self.model}: {', '.join(self._facts())}"]
        lines += [f"  {who.person}: {self._words(who)}" for who in self._people()]
        return "\n".join([*lines, *(f"  nobody can be seen in {n}: {why}" for why, n in self.unseen.items())])

    def _repr_html_(self) -> str:
        """The same as a table, in notebooks."""
        from html import escape  # noqa: PLC0415 - half a megabyte, for notebooks alone

        rows = "".join(f"<tr><th>{escape(who.person)}</th><td>{escape(self._words(who))}</td></tr>" for who in self._people())
        told = "".join(f"<p>nobody can be seen in {n}: {escape(why)}</p>" for why, n in self.unseen.items())
        return f"<b>{escape(self.model)}</b>: {escape(', '.join(self._facts()))}<table>{rows}</table>{told}"

    def to_dataframe(self) -> pd.DataFrame:
        """The answers as a table, a row for each frame, person and joint.

        Returns
        -------
        pandas.DataFrame
            Columns frame, person, joint, u, v (px), x, y, z (m, camera frame), score, presence (0..1), expected_error_m (m), as
            in predictions files; NaN where there is no answer. `attrs` has the units.

        Raises
        ------
        DependencyError
            Where pandas is not installed.
        """
        pandas = optional_module("pandas", purpose="to_dataframe", hint="pip install pandas")
        frames, people, joints = self._stacked("score").shape
        columns: dict[str, Any] = {
            "frame": np.repeat(self.numbers, people * joints),
            "person": np.tile(np.repeat(np.array(self.persons, object), joints), frames),
            "joint": np.tile(np.array(self.joints, object), frames * people),
        }
        for names, array in (("uv", "joints_2d"), ("xyz", "joints_3d")):
            values = self._stacked(array).reshape(-1, len(names))
            columns |= {name: values[:, k] for k, name in enumerate(names)}
        columns |= {name: self._stacked(name).ravel() for name in ("score", "presence", "expected_error_m")}
        table: pd.DataFrame = pandas.DataFrame(columns)
        table.attrs = dict(_UNITS)
        return table

    def draw(
        self, image: NDArray[Any], *, frame: int | None = None, least: float = PRESENT, scale: int | None = None
    ) -> NDArray[np.uint8]:
        """A picture of a frame with the skeletons of who is there, and the names of all.

        Parameters
        ----------
        image
            (H, W, 3) uint8 sRGB, or (H, W) numbers, such as depth or amplitude, drawn in grey between their 1 and 99 %
            quantiles; of the size of the frames that were looked at.
        frame
            Which one of many, by its number.
        least
            Presence from which on a joint is drawn, and its person counts as being there.
        scale
            Pixels of the picture for each of the image, along both axes; default: about 640 across.

        Returns
        -------
        (scale H, scale W, 3) uint8
            A new picture. People have the colours of the package's other pictures, those who are not there are named in grey.

        Raises
        ------
        ConfigError
            For an image of another shape, or a frame that is not there.
        """
        from cabinpose.store.strokes import PERSON_COLOUR, Strokes, text  # noqa: PLC0415 - Pillow, for pictures alone

        at, plain = self._position(frame), _rgb(image)
        factor = scale or max(1, round(_WIDE_PX / plain.shape[1]))
        picture = np.ascontiguousarray(plain.repeat(factor, axis=0).repeat(factor, axis=1))
        presence, uv = self._stacked("presence")[at], (self._stacked("joints_2d")[at].astype(np.float64) + 0.5) * factor - 0.5
        near = (np.abs(np.nan_to_num(uv)) < 8 * max(picture.shape)).all(axis=-1)  # a line to what is farther takes long
        there = np.isfinite(uv).all(axis=-1) & near & (presence >= least)
        colours = [PERSON_COLOUR[p % len(PERSON_COLOUR)] if there[p].any() else _ABSENT for p in range(len(self.persons))]
        thick, limbs = max(picture.shape[1] / 320, 1.0), skeleton_of(self).limbs
        with Strokes(picture) as strokes:
            for points, seen, colour in zip(uv, there, colours, strict=True):
                for tint, width in ((_DARK, 2.2 * thick), (colour, 1.2 * thick)):
                    for a, b in limbs:
                        if seen[a] and seen[b]:
                            strokes.line(points[a], points[b], tint, width)
            for points, seen, colour in zip(uv, there, colours, strict=True):  # over the lines of all
                for point in points[seen]:
                    strokes.dot(point, 2.0 * thick + 1.0, _DARK)
                    strokes.dot(point, 2.0 * thick, colour)
        size = max(round(4.5 * thick), 9)
        surest = np.nan_to_num(presence).max(axis=1)
        words = [
            f"{name} {sure:.2f}{'' if drawn else ': not there'}"
            for name, sure, drawn in zip(self.persons, surest, there.any(axis=1), strict=True)
        ]
        width = round(0.62 * size * max(map(len, words), default=0)) + size
        shade = picture[: round(1.5 * size * len(words)) + size // 2, :width]
        shade[...] = shade // 3
        for row, (name, colour) in enumerate(zip(words, colours, strict=True), 1):
            text(picture, name, (size // 2, round(1.5 * size * row)), colour, size)
        return picture

    # ------------------------------------------------------------------------------------------------- for those above

    def _stacked(self, name: str) -> NDArray[Any]:
        """An array with an axis of frames, if it be one frame."""
        array: NDArray[Any] = getattr(self, name)
        return array if self.score.ndim > 2 else array[None]

    def _position(self, frame: int | None) -> int:
        """Where a frame is, by its number."""
        numbers = self.numbers
        if frame is None and len(numbers) == 1:
            return 0
        if frame is None:
            raise ConfigError(
                f"these are the answers on {len(numbers)} frames", hint=f"say which: frame={numbers[0] if len(numbers) else 0}"
            )
        found = np.flatnonzero(numbers == frame)
        if not len(found):
            raise ConfigError(f"there is no answer on frame {frame}", hint=f"numbers of frames: {_ranges(numbers)}")
        return int(found[0])

    def _facts(self) -> list[str]:
        count = len(self.numbers)
        frames = "one frame" if self.score.ndim == 2 else f"{count} frame{'s' if count != 1 else ''}"
        inside = np.isfinite(self.joints_3d).any()
        return [
            frames,
            f"{len(self.persons)} people x {len(self.joints)} joints ({self.skeleton})",
            "joints_2d in px",
            "joints_3d in m, camera frame" if inside else "no joints_3d",
        ]

    def _people(self) -> Iterator[_Who]:
        presence, space = self._stacked("presence") >= PRESENT, self._stacked("joints_3d").astype(np.float64)
        place = np.isfinite(self._stacked("joints_2d")).all(axis=-1) | np.isfinite(space).all(axis=-1)
        there, errors = presence & place, self._stacked("expected_error_m")
        distance = np.sqrt((space**2).sum(axis=-1))
        head = self.joints.index("head") if "head" in self.joints else None
        for p, person in enumerate(self.persons):
            frames = there[:, p].any(axis=1)
            joints = float(there[:, p].sum(axis=1)[frames].mean()) if frames.any() else 0.0
            heads = distance[:, p, head][there[:, p, head]] if head is not None else distance[:0, p, 0]
            away = heads if np.isfinite(heads).any() else distance[:, p][there[:, p]]
            yield _Who(person, int(frames.sum()), joints, _median(away), _median(errors[:, p][there[:, p]]))

    def _words(self, who: _Who) -> str:
        if not who.frames:
            return "not there"
        count = len(self.numbers)
        told = [] if self.score.ndim == 2 else [f"in {who.frames} of {count}"]
        told.append(f"{who.joints:.3g} of {len(self.joints)} joints in the image")
        if np.isfinite(who.away_m):
            told.append(f"{who.away_m:.2f} m away")
        if np.isfinite(who.error_m):
            told.append(f"expected error {100 * who.error_m:.1f} cm")
        return ", ".join(told)


@dataclass(frozen=True, repr=False)
class FoundPeople(NamedPoses):
    """What a model says of one frame (arrays without the axis F) or of many.

    persons: (P,) slots · joints: (J,) names · model: its name · skeleton: the set of the joints · size: width and height of the
    frames that it was given, px.
    """

    persons: tuple[str, ...] = field(kw_only=True)
    joints: tuple[str, ...] = field(kw_only=True)
    model: str = field(kw_only=True)
    skeleton: str = field(kw_only=True)
    size: tuple[int, int] = field(kw_only=True)

    def draw(
        self, image: NDArray[Any], *, frame: int | None = None, least: float = PRESENT, scale: int | None = None
    ) -> NDArray[np.uint8]:
        """See `NamedPoses.draw`; ConfigError also for an image of another size than the frames'."""
        height, width = np.shape(image)[:2] if np.ndim(image) > 1 else (0, 0)
        if (width, height) != self.size:
            raise ConfigError(
                f"an image of shape {np.shape(image)} is not of the frames' size, {self.size[0]}x{self.size[1]} px",
                hint="give (H, W) or (H, W, 3) of the frame itself; `scale` makes the picture larger",
            )
        return super().draw(image, frame=frame, least=least, scale=scale)


def _rgb(image: NDArray[Any]) -> NDArray[np.uint8]:
    """(H, W, 3) of colours, or of numbers in grey."""
    values = np.asarray(image)
    if values.ndim == 3 and values.shape[2] == 3 and values.dtype == np.uint8 and values.size:
        return values
    if values.ndim != 2 or not values.size or values.dtype.kind not in "biuf":
        raise ConfigError(
            f"{values.dtype} of shape {values.shape} is no image to draw into",
            hint="give (H, W, 3) uint8, or (H, W) such as depth",
        )
    known = np.isfinite(values) & (values != 0)
    low, high = np.quantile(values[known], (0.01, 0.99)).tolist() if known.any() else (0.0, 1.0)
    share = np.clip((np.where(known, values, low).astype(np.float64) - low) / max(high - low, 1e-9), 0.0, 1.0)
    grey = np.where(known, 30 + 210 * np.sqrt(share), 0).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def _median(values: NDArray[Any]) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def _ranges(numbers: NDArray[np.int64]) -> str:
    return f"{numbers.min()} to {numbers.max()}" if len(numbers) else "there are none"
