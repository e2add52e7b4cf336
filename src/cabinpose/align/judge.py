"""Whether what `calibrate` and `align` found can be believed: their errors against limits, and the likely cause of large ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cabinpose.align.board import Board
from cabinpose.align.boardtake import BoardViews
from cabinpose.align.corners import corners_or_reason
from cabinpose.align.extrinsics import ExtrinsicsResult
from cabinpose.align.intrinsics import IntrinsicsResult
from cabinpose.core import AlignmentError, Camera, apply

F64 = NDArray[np.float64]

# Of a calibration: beyond the first it is doubted, beyond the second refused. A virtual rig leaves what stands last.
HELD_OUT_PX: Final = 0.3, 1.0  # corners of held-out views, by the place of the camera; 0.03
LENS_PX: Final = 0.3, 1.0  # the same by the lens alone; 0.03
MARKERS_M: Final = 0.0015, 0.005  # the board's markers between both systems; 0.00004

# Of a take: the angle between the heads of suit and optical system, rms. Beyond the first, and twice that of the head take, it is
# doubted, beyond the second refused. 0.6 in the laboratory, 1.2 with a calibration of another session, 11 of caps turned by 30.
HEAD_DEG: Final = 1.0, 8.0
_WORSE_THAN_HEAD_TAKE = 2.0
FLOATING: Final = 0.05  # share of the joints before the measured surface: bodies have their joints inside; 0.004

_TRIED = 6  # views in which another board is looked for, before it is in all: not finding one takes long
_FEWEST_VIEWS = 6  # in which a board of other rows and columns is found, to be named as the cause
_SCALE_OFF = 0.002  # by which squares are another size


@dataclass(frozen=True)
class Placed:
    """What a board take gives: its views, the lens where it is fitted, the camera's place by markers and by all corners."""

    views: BoardViews
    lens: IntrinsicsResult | None
    camera: Camera
    by_markers: ExtrinsicsResult
    by_corners: ExtrinsicsResult

    @property
    def errors(self) -> tuple[tuple[str, float, float, float], ...]:
        """What is judged: in words, its size, the limits of doubt and of refusal; px, or mm."""
        lens = float("nan") if self.lens is None else self.lens.held_out_rms_px
        return (
            ("held-out views, px", self.by_corners.held_out_rms_px, *HELD_OUT_PX),
            ("held-out views of the lens, px", lens, *LENS_PX),
            ("the board's markers, mm", 1e3 * self.by_corners.rms_m, 1e3 * MARKERS_M[0], 1e3 * MARKERS_M[1]),
        )

    def beyond(self, level: int) -> list[str]:
        """The errors beyond the limit of doubt (0) or of refusal (1), with their figures."""
        return [f"{what} {size:.3g}, {limits[level]:g} allowed" for what, size, *limits in self.errors if size > limits[level]]


def believed(board: Board, views: BoardViews, place: Callable[[Board, BoardViews], Placed]) -> tuple[Placed, list[str]]:
    """What a board take gives, and what speaks against it.

    Parameters
    ----------
    board
        As the session describes it.
    views
        Of that board.
    place
        Finds lens and place of the camera by views of a board.

    Raises
    ------
    AlignmentError
        Where the take gives nothing, or errors beyond the limits. The hint names the first likely cause that brings them within:
        rows and columns exchanged or counted otherwise, squares of another size.
    """
    try:
        found = place(board, views)
        wrong = found.beyond(1)
        if not wrong:
            return found, [f"the calibration is doubtful: {'; '.join(told)}" for told in [found.beyond(0)] if told]
        error = AlignmentError(f"the calibration cannot be believed: {'; '.join(wrong)}", hint="is the board as described?")
    except AlignmentError as raised:
        error = raised
    for cause, other, seen in _causes(board, views):
        try:
            again = place(other, seen)
        except AlignmentError:
            continue
        if not again.beyond(1):
            figures = f"{again.by_corners.held_out_rms_px:.3f} px and {1e3 * again.by_corners.rms_m:.2f} mm"
            raise AlignmentError(
                f"{error}; {cause} give {figures}", hint=f"set the session's board so, if it is: {cause}"
            ) from error
    raise error


def judge_head(head_deg: float, head_take_deg: float | None) -> str:
    """What speaks against a take in which suit and optical system see the head so far apart (rms, deg); "" = nothing.

    head_take_deg: the same in the take that the head was calibrated by, None = not known. Raises AlignmentError beyond the limit.
    """
    told = f"suit and optical system see the head {head_deg:.1f} deg apart (rms)"
    if head_deg > HEAD_DEG[1]:
        raise AlignmentError(
            f"{told}, {HEAD_DEG[1]:g} allowed",
            hint="is the calibration of this session and subject? Else the cap or the head's sensor has moved: calibrate again",
        )
    usual = max(HEAD_DEG[0], _WORSE_THAN_HEAD_TAKE * (head_take_deg or 0.0))
    if head_deg <= usual:
        return ""
    return (
        f"{told}, where {usual:.1f} are usual: the calibration is of another session or subject, or the cap has moved since"
        " the head take"
    )


def judge_joints(floating: float) -> str:
    """What speaks against a take of whose joints this share lies before the measured surface; "" = nothing."""
    if not floating > FLOATING:
        return ""
    return (
        f"{100 * floating:.0f} % of the joints lie before the measured surface, and {100 * FLOATING:g} % are usual: the"
        " calibration is of another rig, or the camera has moved; look at the skeleton on the images before you trust it"
    )


def _causes(board: Board, views: BoardViews) -> Iterator[tuple[str, Board, BoardViews]]:
    """Boards that the take may be of instead, in words, with its views."""
    columns, rows = board.columns, board.rows
    others = [("columns and rows exchanged", rows, columns)]
    if sum(corners is not None for corners in views.corners) >= _FEWEST_VIEWS:
        once = board.square_m * _scale(board, views)
        twice = board.model_copy(update={"square_m": once})
        size = once * _scale(twice, views)
        if abs(size / board.square_m - 1) > _SCALE_OFF:
            cause = f"squares of {size:.4f} m in place of {board.square_m:g}"
            yield cause, board.model_copy(update={"square_m": size}), views
    else:
        others.append(("inner corners counted in place of squares", columns - 1, rows - 1))
    for told, c, r in others:
        other = board.model_copy(update={"columns": c, "rows": r})
        if min(c, r) >= 3 and sum(corners_or_reason(image, other)[0] is not None for image in views.images[:_TRIED]) > 0:
            found = [corners_or_reason(image, other) for image in views.images]
            seen = replace(views, corners=tuple(uv for uv, _ in found), reasons=tuple(why for _, why in found))
            yield f"{told}, {c} columns and {r} rows,", other, seen


def _scale(board: Board, views: BoardViews) -> float:
    """By what the squares have to be multiplied for the board to move as far in the image as its markers do in the world."""
    posed = views.posed(views.camera, board)
    middle = board.marker_centres.mean(axis=0)
    centre = np.stack([apply(pose, middle) for pose in posed.poses])
    whole = np.isfinite(posed.p_world).all(axis=(1, 2))
    a, b = centre[whole], posed.p_world[whole].mean(axis=1)
    i, j = np.triu_indices(len(a), 1)
    seen, true = (np.linalg.norm(p[i] - p[j], axis=1) for p in (a, b))
    return float(np.median(true[seen > 0] / seen[seen > 0])) if len(i) else 1.0
