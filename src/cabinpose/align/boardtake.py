"""The views of a take in which a board is held before the camera: when it was still, as both systems saw it then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cabinpose.align.board import Board
from cabinpose.align.calibration import Names
from cabinpose.align.corners import corners_or_reason
from cabinpose.align.extrinsics import board_pose
from cabinpose.align.streams import frame_times, on_host
from cabinpose.core import AlignmentError, Camera, Matrix
from cabinpose.store.recording import MarkerSeries, Recording, marker_series, tof_frames

F64 = NDArray[np.float64]

_STILL_M = 0.002  # farther from its mean a marker of a board that is held still never is: ten times the optical noise
_AROUND_S = 0.1  # before and after a frame: more than the stamps of the two systems may differ by
_FEWEST_MARKERS = 3


@dataclass(frozen=True)
class BoardViews:
    """V views of a board: the mean amplitude (H, W) of the frames of each hold, the corners (N, 2) px in it or None and why, the
    optical markers (V, M, 3) m, NaN = not seen, and the camera as it says of itself. frames: of the take; moving: of them,
    left out.
    """

    camera: Camera
    images: tuple[F64, ...]
    corners: tuple[F64 | None, ...]
    reasons: tuple[str, ...]
    p_world: F64
    frames: int
    moving: int

    def posed(self, camera: Camera, board: Board) -> PosedViews:
        """The views whose board's corners and markers are known, with the board's pose. Raises AlignmentError for none."""
        chosen = [
            v
            for v, corners in enumerate(self.corners)
            if corners is not None and np.isfinite(self.p_world[v]).all(axis=1).sum() >= _FEWEST_MARKERS
        ]
        if not chosen:
            raise AlignmentError(
                f"no view of {len(self.corners)} has the board's corners and three of its markers",
                hint="hold the board so that the camera sees it whole, and the optical system its markers",
            )
        corners = np.stack([c for v in chosen if (c := self.corners[v]) is not None])
        poses = np.stack([board_pose(camera, each, board).camera_from_board for each in corners])
        return PosedViews(tuple(self.images[v] for v in chosen), corners, poses, self.p_world[chosen])


@dataclass(frozen=True)
class PosedViews:
    """Views with corners (V, N, 2) px, poses camera_from_board (V, 4, 4) and markers (V, M, 3) m."""

    images: tuple[F64, ...]
    corners: F64
    poses: Matrix
    p_world: F64


def board_views(recording: Recording, names: Names, board: Board) -> BoardViews:
    """The views of a board take.

    A frame counts where every marker that the optical system sees stays within 2 mm of its mean for 0.1 s before and after, so
    that the delay between the systems does not matter. Frames of one hold are averaged, which lowers the noise; a marker's
    place is the mean over the hold. Raises AlignmentError where no frame counts.
    """
    markers = marker_series(recording, names.optical, names.board)
    stamps = frame_times(recording, names.tof)
    places = _places(markers, on_host(markers), stamps, board)
    still = np.isfinite(places).all(axis=2).sum(axis=1) >= _FEWEST_MARKERS
    if not still.any():
        raise AlignmentError(
            f"{recording.path}: the board was never still before the camera while three of its markers were seen",
            hint="hold it still for half a second in each pose",
        )
    images: list[F64] = []
    counts: list[int] = []
    holds: list[list[F64]] = []
    camera: Camera | None = None
    last = -2
    for index, (_, frame) in enumerate(tof_frames(recording, names.tof)):
        if camera is None:
            if not frame.amplitude.size:
                raise AlignmentError(
                    f"{recording.path}: {names.tof} gives no amplitude image", hint="switch it on: the board is seen in it"
                )
            height, width = frame.amplitude.shape
            k = frame.camera_k
            dist = tuple(float(d) for d in frame.amplitude_dist)
            camera = Camera(width, height, k[0, 0], k[1, 1], k[0, 2], k[1, 2], dist)  # type: ignore[arg-type]
        if not still[index]:
            continue
        if last == index - 1 and holds and _same(holds[-1][0], places[index]):
            images[-1] += frame.amplitude
            counts[-1] += 1
            holds[-1].append(places[index])
        else:
            images.append(frame.amplitude.astype(np.float64))
            counts.append(1)
            holds.append([places[index]])
        last = index
    assert camera is not None
    means = tuple(image / count for image, count in zip(images, counts, strict=True))
    p_world = np.stack([_mean(np.stack(hold)) for hold in holds])
    found = [corners_or_reason(image, board) for image in means]
    return BoardViews(
        camera, means, tuple(c for c, _ in found), tuple(why for _, why in found), p_world, len(stamps), int((~still).sum())
    )


def _places(markers: MarkerSeries, optical_ns: NDArray[np.int64], stamps: NDArray[np.int64], board: Board) -> F64:
    """(T, M, 3) where the markers are at each frame, m; NaN where one is not seen or not still."""
    position = np.stack([markers.marker(name) for name in board.marker_names], axis=1)
    around = int(_AROUND_S * 1e9)
    first = np.searchsorted(optical_ns, stamps - around)
    end = np.searchsorted(optical_ns, stamps + around)
    places = np.full((len(stamps), len(board.marker_names), 3), np.nan)
    for index, (a, b) in enumerate(zip(first, end, strict=True)):
        if b - a < 2:
            continue
        mean = _mean(position[a:b])
        off = np.linalg.norm(position[a:b] - mean, axis=2)
        # one that moves says that the board does
        if not np.any(off > _STILL_M):
            places[index] = mean
    return places


def _same(one: F64, other: F64) -> bool:
    """Whether markers (M, 3) of two frames are of one hold."""
    off = np.linalg.norm(one - other, axis=1)
    return not np.any(off > _STILL_M)


def _mean(position: F64) -> F64:
    """(M, 3) mean over the first axis of what was seen; NaN where nothing was."""
    seen = np.asarray(np.isfinite(position).all(axis=2))
    count = seen.sum(axis=0)
    total = np.where(seen[..., None], position, 0.0).sum(axis=0)
    result: F64 = np.where((count > 0)[:, None], total / np.maximum(count, 1)[:, None], np.nan)
    return result
