"""A recorded motion as a clip: what retargeting needs, from BVH, MVNX, C3D (Plug-in Gait's bones) and recordings of a suit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import scipy
from numpy.typing import NDArray

from cabinpose.core import MVN_JOINTS, MVN_SEGMENTS, MocapError
from cabinpose.signals import F64, BodyTrack, Markers, SegmentPoses, body_doubts
from cabinpose.store.convert.bvh import UpAxis, read_bvh
from cabinpose.store.convert.motion_files import M, motion_rows, of_one_subject
from cabinpose.store.convert.rows import say_doubts

_PARENT = {child: parent for _, parent, child in MVN_JOINTS}
_LOOK = 64  # frames of a BVH file that are judged
_GAP_S = 0.1  # without a whole frame, at the most


@dataclass(frozen=True)
class Clip:
    """A motion in the world frame (z up, m).

    rotations: (F, J, 3, 3) world_from_joint · positions: (F, J, 3) m · rest_positions: (J, 3) m, the skeleton with all rotations
    zero (it stands upright and looks along +x) and its root in the origin · frame_s: seconds from frame to frame.
    """

    names: tuple[str, ...]
    rotations: F64
    positions: F64
    rest_positions: F64
    frame_s: float

    def __len__(self) -> int:
        return len(self.positions)


def read_clip(path: str | Path, *, unit_m: float, up: UpAxis, subject: str | None = None) -> Clip:
    """The motion of one person in a file.

    Parameters
    ----------
    path
        A BVH file, an MVNX file, a C3D file with the bones of Plug-in Gait, or a recording (.mcap) of an MVN suit.
    unit_m, up
        Of a BVH file: metres of its unit of length, and its vertical axis.
    subject
        Whose motion; None: that of the only one.

    Raises
    ------
    RecordingError
        Where the file is missing or of another kind, tells of nobody or of several, cannot be of a person (its unit, for one), or
        an MVNX file or a recording is damaged.
    MocapError
        Where a BVH or C3D file is damaged, or the motion has gaps.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".bvh":
        bvh = read_bvh(path, unit_m=unit_m, up=up)
        rotations, positions, rest = bvh.kinematics()
        names = tuple(j.name for j in bvh.joints)
        some = BodyTrack(names, positions[:: max(1, len(positions) // _LOOK)])
        say_doubts(path, ((f"unit_m {bvh.unit_m:.4g}, up {up}", doubt) for doubt in body_doubts(some)))
        return Clip(names, rotations, positions, rest, bvh.frame_s)
    if suffix == ".c3d":
        time_ns, markers = of_one_subject(path, _timed(path, Markers, "PELO"), subject, "bones of Plug-in Gait")
        return _clip(path, time_ns, *_bones(path, markers))
    time_ns, poses = of_one_subject(path, _timed(path, SegmentPoses, "Pelvis"), subject, "segments of a suit")
    return _clip(path, time_ns, *_segments(poses))


def _timed(path: Path, kind: type[M], needed: str) -> list[tuple[int, M]]:
    """Times on the device's clock, where it has one, and messages of a kind that have the needed point among theirs."""
    return [
        (host_ns if device_ns is None else device_ns, message)
        for host_ns, device_ns, message in motion_rows(path)
        if isinstance(message, kind) and needed in message.names
    ]


def _segments(messages: Sequence[SegmentPoses]) -> tuple[dict[str, F64], dict[str, F64]]:
    """Positions (F, 3) and rotations (F, 3, 3) of MVN's segments."""
    names = messages[0].names
    position, wxyz = np.stack([m.position_m for m in messages]), np.stack([m.orientation_wxyz for m in messages])
    known = np.linalg.norm(wxyz, axis=2) > 0  # False for NaN
    rotation = np.full((*known.shape, 3, 3), np.nan)
    rotation[known] = scipy.spatial.transform.Rotation.from_quat(wxyz[known], scalar_first=True).as_matrix()
    of = {name: i for i, name in enumerate(names) if name in MVN_SEGMENTS}
    return {n: position[:, i] for n, i in of.items()}, {n: rotation[:, i] for n, i in of.items()}


# Segments of MVN by Plug-in Gait's points: the joint at which they begin, and the bone that turns with them.
_BONES = MappingProxyType(
    {"Pelvis": ("PELO", "PEL"), "T8": ("TRXO", "TRX"), "Head": ("HEDO", "HED")}
    | {
        f"{side}{segment}": (side[0] + joint, side[0] + bone)
        for side in ("Left", "Right")
        for segment, joint, bone in (
            ("UpperArm", "CLO", "HU"), ("Forearm", "HUO", "RA"), ("Hand", "RAO", "HN"), ("UpperLeg", "FEP", "FE"),
            ("LowerLeg", "FEO", "TI"), ("Foot", "TIO", "FO"), ("Toe", "FOO", "FO"),
        )
    }
)  # fmt: skip


def _bones(path: Path, messages: Sequence[Markers]) -> tuple[dict[str, F64], dict[str, F64]]:
    """Positions (F, 3) and rotations (F, 3, 3) of MVN's segments from bones: origin, ends of the axes to front, left and top."""
    names = messages[0].names
    lacking = sorted({p for joint, bone in _BONES.values() for p in (joint, *(bone + end for end in "OALP"))} - set(names))
    if lacking:
        raise MocapError(
            f"{path.name} has no point {', '.join(lacking[:4])}", hint="export the C3D with the bones of Plug-in Gait"
        )
    position = np.stack([m.position_m for m in messages])
    at = {name: position[:, i] for i, name in enumerate(names)}
    turned = {}
    for segment, (_, bone) in _BONES.items():
        axes = np.stack([at[bone + end] - at[bone + "O"] for end in "ALP"], axis=-1)
        turned[segment] = axes / np.linalg.norm(axes, axis=-2, keepdims=True)
    return {segment: at[joint] for segment, (joint, _) in _BONES.items()}, turned


def _clip(path: Path, time_ns: NDArray[np.int64], placed: Mapping[str, F64], turned: Mapping[str, F64]) -> Clip:
    """At equal steps of time, the frame nearest to each; a gap of more than a tenth of a second is an error."""
    names = tuple(name for name in MVN_SEGMENTS if name in placed)
    positions, rotations = np.stack([placed[n] for n in names], axis=1), np.stack([turned[n] for n in names], axis=1)
    whole = np.isfinite(positions).all(axis=(1, 2)) & np.isfinite(rotations).all(axis=(1, 2, 3))
    time_s, positions, rotations = 1e-9 * (time_ns[whole] - time_ns[0]), positions[whole], rotations[whole]
    gap_s = float(np.diff(time_s).max(initial=0.0))
    if len(time_s) < 2 or gap_s > _GAP_S:
        raise MocapError(
            f"{path.name} has a gap of {gap_s:.2f} s in its motion, or no whole frame",
            hint="cut the file to where every segment is seen",
        )
    frame_s = float(np.median(np.diff(time_s)))
    wanted = np.arange(time_s[0], time_s[-1] + 0.5 * frame_s, frame_s)
    after = np.clip(np.searchsorted(time_s, wanted), 1, len(time_s) - 1)
    nearest = np.where(wanted - time_s[after - 1] < time_s[after] - wanted, after - 1, after)
    positions, rotations = positions[nearest], rotations[nearest]
    rest = dict[str, F64]()
    for name in names:  # parents come first
        parent = _PARENT.get(name)
        while parent is not None and parent not in names:
            parent = _PARENT.get(parent)
        if parent is None:
            rest[name] = np.zeros(3)
            continue
        k, p = names.index(name), names.index(parent)
        offset = np.swapaxes(rotations[:, p], 1, 2) @ (positions[:, k] - positions[:, p])[:, :, None]
        rest[name] = rest[parent] + np.median(offset[:, :, 0], axis=0)
    return Clip(names, rotations, positions, np.stack(list(rest.values())), frame_s)
