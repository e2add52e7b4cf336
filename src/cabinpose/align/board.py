"""The calibration target that camera and optical system both see: a checkerboard with retro-reflective markers on it."""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

Triple = tuple[float, float, float]


# Of what a board can have, m: what is held before a camera is a metre or two, and markers are spheres of 3 to 25 mm.
_LARGEST_SQUARE_M, _LARGEST_RADIUS_M, _FARTHEST_MARKER_M = 0.5, 0.05, 3.0


def refuse_larger(what: str, size_m: float, most_m: float, whose: str) -> None:
    """Raise ValueError for a length beyond what it can be, which is what millimetres for metres give."""
    if size_m > most_m:
        raise ValueError(
            f"{what} of {size_m:g} m, and no {whose} has more than {most_m:g} m: are they millimetres ({size_m / 1000:g} m)?"
        )


class Board(BaseModel):
    """A checkerboard. Board frame: origin in the first inner corner, x along a row, y along a column, z into the board.

    A viewer before the board, who sees x to the right and y downwards, looks along z (as OpenCV's object points have it).
    The first inner corner is the one whose square towards (-x, -y) is black. An odd number of corners one way and an even
    one the other tell the board from itself turned by half a turn.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    columns: Annotated[int, Field(ge=3, description="inner corners along x")] = 9
    rows: Annotated[int, Field(ge=3, description="inner corners along y")] = 6
    square_m: Annotated[float, Field(gt=0, description="side of a square")] = 0.06
    markers: Annotated[
        dict[str, Triple], Field(description="the optical system's names of the markers; their centres in the board frame, m")
    ] = {
        "board1": (-0.11, -0.10, -0.007),
        "board2": (0.59, -0.10, -0.007),
        "board3": (0.59, 0.40, -0.007),
        "board4": (-0.11, 0.34, -0.007),
    }
    marker_radius_m: Annotated[float, Field(gt=0, description="radius of a marker's sphere")] = 0.007

    @model_validator(mode="after")
    def _tells_its_turns(self) -> Self:
        refuse_larger("squares", self.square_m, _LARGEST_SQUARE_M, "board")
        refuse_larger("a marker's radius", self.marker_radius_m, _LARGEST_RADIUS_M, "board")
        refuse_larger("a marker's place", float(np.abs(self.marker_centres).max(initial=0.0)), _FARTHEST_MARKER_M, "board")
        if (self.columns + self.rows) % 2 == 0:
            raise ValueError("one of columns and rows has to be odd, the other even: such a board looks different upside down")
        return self

    @property
    def corners(self) -> NDArray[np.float64]:
        """(rows * columns, 3) inner corners in the board frame, row by row, m."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return np.stack((x, y, np.zeros_like(x)), axis=-1).reshape(-1, 3) * self.square_m

    @property
    def marker_names(self) -> tuple[str, ...]:
        return tuple(self.markers)

    @property
    def marker_centres(self) -> NDArray[np.float64]:
        """(M, 3) in the board frame, m, in the order of `marker_names`."""
        return np.array(list(self.markers.values()), np.float64).reshape(-1, 3)
