"""Whether recorded positions, orientations and time stamps can be those of people: unit, axes, order of quaternions, rates.

What is here looks at numbers alone. Readers of files raise what cannot be and warn of what hardly can, `info` says it.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from cabinpose.core import CMU_UNIT_M, LENGTHS_M, LIMBS_OVER_STATURE, MVN_JOINTS, units_that_fit
from cabinpose.signals.recorded import F64
from cabinpose.signals.rotations import conjugate, product

# What is said beyond which values, each with its reason: lengths in m, speeds in m/s, rates in Hz, `late` in s and as a share of
# the frames, `missing` as one, `unrigid` over a bone's length, `rate` over the declared one, `trunk` and `bones` as cosines.
LIMITS: Mapping[str, tuple[float, float, str]] = MappingProxyType({
    "stature": (0.45, 2.6, "newborn children are 0.5 m long, the tallest people 2.5 m"),
    "usual_stature": (0.9, 2.25, "a child of three years is 0.95 m tall, one of 100 000 men 2.2 m"),
    "body": (0.3, 3.2, "from hip to head are 0.3 m in a child, from finger to finger of stretched arms 2.5 m in the tallest"),
    "thing": (0.004, 20.0, "markers are farther apart than they are wide, and what carries them is no house"),
    "known_unit": (1.0, 2.1, "nearly all people from five years on, and no two units have a ratio below 2.2"),
    "far": (0.0, 100.0, "no optical system sees as far"),
    "speed": (0.0, 30.0, "a thrower's hand has 20 m/s for an instant"),
    "norm": (0.99, 1.01, "a rotation's quaternion has length 1; single precision and rounded text are far within 0.01"),
    "trunk": (-1.0, 0.85, "who does not lie has the shoulders above the hips"),
    "unrigid": (0.0, 0.15, "a joint stays where it is in the segment that it hangs on, to 2 % of a bone's length in suits"),
    "bones": (0.5, 1.0, "thighs hang from the pelvis and the spine stands on it, as the suit's axes say"),
    "rate": (0.9, 1.1, "clocks agree to 0.0001 of what is declared"),
    "rate_hz": (0.5, 20_000.0, "frames a second: people move meanwhile, and no motion capture is faster"),
    "late": (1.0, 0.02, "packets of a network overtake each other by less than a second, and seldom"),
    "missing": (0.0, 0.02, "a frame that was lost here and there hides nothing"),
})  # fmt: skip

# What joints, or the segments that begin there, are called without their side; of two that are there the first.
_JOINTS: Final = {
    "hip": ("upleg", "upperleg", "thigh", "femur", "hip"),
    "knee": ("lowerleg", "leg", "shin", "calf", "tibia", "knee", "kne"),
    "ankle": ("foot", "ankle", "ank"),
    "shoulder": ("upperarm", "uparm", "arm", "humerus", "shldr", "sho", "shoulder"),
    "elbow": ("forearm", "lowerarm", "radius", "elbow", "elb"),
    "wrist": ("hand", "wrist", "wra"),
}
_SIDE = re.compile(r"(left|right|[lr])_?(\w+?)|(\w+?)_?(left|right|[lr])")
_LEAST_LIMBS = 2  # kinds, from which the stature is known
_LEAST_POINTS = 15  # of a body without names that tell
_SHORT_M = 0.02  # bones below say nothing of orientations
# Parts of usual names: Plug-in Gait's LFHD and RASI, Qualisys' HeadL and RHeelBack, BTS' "r should" and "l mall"
_UPPER = re.compile(r"head|neck|should|sho(?![a-z])|acro|clav|[lr][fb]hd|(?<![a-z0-9])c7(?![0-9])", re.I)
_LOWER = re.compile(
    r"toe|ankle|ank(?![a-z])|foot|(?<!w)heel|hee(?![a-z])|mall|(?<!l)met|calc|asi(?![a-z])|asis|psi|pelvi|sacr|waist|hip|mt\d",
    re.I,
)
_HIPS = re.compile(r"asi(?![a-z])|asis|psi|pelvi|sacr|waist|hip", re.I)
_BONE = re.compile(r"fib|tib|fem|rad|uln|hum|met|m[ct](\d|head)", re.I)  # each has a head, or ends at the shoulder
_MOST = 0.8  # of the frames
# How the axes of MVN's segments lie in a body that stands: x to the front, y to the left, z up.
_MVN_BONES: Mapping[tuple[str, str], tuple[float, float, float]] = MappingProxyType(
    {("Pelvis", "L5"): (0.0, 0.0, 1.0), ("T8", "Neck"): (0.0, 0.0, 1.0)}
    | {("Pelvis", f"{side}UpperLeg"): (0.0, y, 0.0) for side, y in (("Left", 1.0), ("Right", -1.0))}
    | {(f"{side}UpperLeg", f"{side}LowerLeg"): (0.0, 0.0, -1.0) for side in ("Left", "Right")}
)
_PREFIXES: Final = (1e3, 1e6, 1e9, 1e-3, 1e-6, 1e-9)  # between units of time
# Other readings of four numbers: where w, x, y, z stand in them, and the signs.
_READINGS: Final = {
    "wxyz": ((0, 1, 2, 3), (1.0, 1.0, 1.0, 1.0)),
    "xyzw": ((3, 0, 1, 2), (1.0, 1.0, 1.0, 1.0)),
    "wxyz, from the world to the segment": ((0, 1, 2, 3), (1.0, -1.0, -1.0, -1.0)),
    "xyzw, from the world to the segment": ((3, 0, 1, 2), (1.0, -1.0, -1.0, -1.0)),
}


class Doubt(NamedTuple):
    """What was seen and why it is not right, and what to try. impossible: it cannot be, in place of: it hardly can."""

    words: str
    hint: str
    impossible: bool


class BodyTrack(NamedTuple):
    """Points of somebody or something over F frames that are looked at.

    position_m (F, P, 3), NaN = not seen · orientation_wxyz (F, P, 4), None where points have none · parents: of segments, by
    name · speed_m_s: of points, at the moments that are looked at, the 95th of a hundred; NaN where it is not known.
    """

    names: tuple[str, ...]
    position_m: F64
    orientation_wxyz: F64 | None = None
    parents: Mapping[str, str] = MappingProxyType({})
    speed_m_s: float = float("nan")


class BodySize(NamedTuple):
    """What positions tell of a body, in the unit that they are in; NaN where they do not.

    size: the greatest distance between two points, in the middle of the frames · stature: by the lengths of limbs ·
    lowest: the height of the lowest point · is_body: whether names or the number of points are those of a body.
    """

    size: float
    stature: float
    lowest: float
    is_body: bool


def body_size(track: BodyTrack) -> BodySize:
    """The sizes of a body in the unit of its positions."""
    position = track.position_m
    spans = [_span(frame[np.isfinite(frame).all(axis=1)]) for frame in position]
    upper, lower = trunk_columns(track.names)
    stature = _stature(track.names, position)
    heights = position[..., 2][np.isfinite(position[..., 2])]
    return BodySize(
        size=_median(spans),
        stature=stature,
        lowest=float(heights.min()) if heights.size else float("nan"),
        is_body=bool(np.isfinite(stature) or (upper and lower) or len(track.names) >= _LEAST_POINTS),
    )


def recognised_unit(track: BodyTrack, units: Collection[str] = ("m", "cm", "mm", "inch")) -> tuple[float, str] | None:
    """Metres of the unit that positions of a body are in, and what tells it; None where no unit, or no single one, does.

    Parameters
    ----------
    track
        Positions in the file's unit.
    units
        Those that come into question, of `LENGTHS_M`; the CMU database's is tried as well where all are.
    """
    size = body_size(track)
    if not size.is_body:
        return None
    what, length = ("stature", size.stature) if np.isfinite(size.stature) else ("size", size.size)
    low, high, _ = LIMITS["known_unit"]
    fitting = [(LENGTHS_M[name], name) for name in units_that_fit(length, (low, high), units)]
    if low <= length * CMU_UNIT_M <= high:
        fitting.append((CMU_UNIT_M, "inch / 0.45, as in the CMU database"))
    if len(fitting) != 1:
        return None
    metres, name = fitting[0]
    return metres, f"{name}: recognised by the body, whose {what} is {length * metres:.2f} m then"


def trunk_columns(names: Sequence[str]) -> tuple[list[int], list[int]]:
    """Where points of head, neck and shoulders stand among names, and those of hips and feet."""
    upper = [i for i, name in enumerate(names) if _UPPER.search(name) and not _BONE.search(name)]
    return upper, [i for i, name in enumerate(names) if _LOWER.search(name) and i not in upper]


def body_doubts(track: BodyTrack) -> Iterator[Doubt]:
    """What speaks against positions and orientations in metres, with z up."""
    if not len(track.position_m):
        return
    yield from _size_doubts(track)
    yield from _axis_doubts(track)
    if track.orientation_wxyz is not None:
        yield from _orientation_doubts(track, track.orientation_wxyz)


def rotation_doubt(wxyz: F64) -> Doubt | None:
    """What speaks against quaternions (..., 4) by their lengths; None where nothing does. Those that are not known are NaN."""
    norm = np.linalg.norm(wxyz, axis=-1)
    norm = norm[np.isfinite(norm)]
    low, high, why = LIMITS["norm"]
    odd = norm[(norm < low) | (norm > high)]
    if not odd.size:
        return None
    return Doubt(
        f"{100 * odd.size / norm.size:.3g} % ({odd.size} of {norm.size}) of the quaternions have another length than 1, such as"
        f" {odd[0]:.3g}: {why}",
        "record or export it again from where it comes; a segment whose orientation is not known has none, or nan",
        impossible=True,
    )


def stamp_doubts(time_ns: Sequence[int], declared_hz: float | None) -> Iterator[Doubt]:
    """What speaks against the time stamps of frames, in the order in which they came.

    Parameters
    ----------
    time_ns
        (F,) ns.
    declared_hz
        Frames a second that the file or the device states; None where it does not.
    """
    time = np.asarray(time_ns, np.int64)
    steps = np.diff(time)
    if len(steps) < 2:
        return
    said = "" if declared_hz is None else f", where {declared_hz:.6g} frames a second are declared"
    equal, back = int((steps == 0).sum()), int((steps < 0).sum())
    late_s, late, _ = LIMITS["late"]
    if equal:
        yield Doubt(
            f"{equal} of {len(time)} frames have the time stamp of the one before{said}: the first of equal ones counts",
            "export it again with a time for each frame",
            impossible=2 * equal > len(steps),
        )
    if back > late * len(steps) or steps.min() < -1e9 * late_s:
        yield Doubt(
            f"{back} of {len(time)} frames have a time stamp before that of the frame before them",
            "frames are taken in the order of their times; a clock that was set back makes two takes of one: cut it there",
            impossible=2 * back > len(steps),
        )
    forward = steps[steps > 0]
    if 2 * len(forward) > len(steps):
        yield from _rate_doubts(float(np.median(forward)), time, declared_hz)


def _rate_doubts(step_ns: float, time: np.ndarray, declared_hz: float | None) -> Iterator[Doubt]:
    rate = 1e9 / step_ns
    low, high, why = LIMITS["rate_hz"]
    if declared_hz:
        ratio = declared_hz / rate
        scale = next((f for f in _PREFIXES if 0.8 < ratio / f < 1.25), None)
        if scale is not None:
            yield Doubt(
                f"time stamps give {rate:.4g} frames a second, and {declared_hz:.6g} are declared: they are"
                f" {f'{scale:g} times too large' if scale > 1 else f'{1 / scale:g} times too small'}, so in another unit"
                f" ({'µs for ms' if scale > 1 else 's for ms'}, for one) than the format's",
                "write the stamps in the unit of the format",
                impossible=True,
            )
            return
        if not LIMITS["rate"][0] <= ratio <= LIMITS["rate"][1]:
            yield Doubt(
                f"time stamps give {rate:.6g} frames a second, and {declared_hz:.6g} are declared",
                "stamps are believed; check which of the two is right",
                impossible=False,
            )
    if not low <= rate <= high:
        yield Doubt(
            f"time stamps give {rate:.3g} frames a second, possible are {low:g} to {high:g} ({why})",
            "check the unit of the stamps, or of the frame time: seconds in BVH",
            impossible=True,
        )
        return
    expected = round((int(time.max()) - int(time.min())) / step_ns) + 1
    missing = 1 - len(np.unique(time)) / max(expected, 1)
    if missing > LIMITS["missing"][1]:
        yield Doubt(
            f"{expected - len(np.unique(time))} of {expected} frames are missing between the first and the last",
            "what lies in a gap is not known; cut the take where it is whole",
            impossible=False,
        )


def _size_doubts(track: BodyTrack) -> Iterator[Doubt]:
    size = body_size(track)
    what, length, limit = ("its size", size.size, "body" if size.is_body else "thing")
    if np.isfinite(size.stature):
        what, length, limit = "the stature by the lengths of limbs", size.stature, "stature"
    low, high, why = LIMITS[limit]
    usual = LIMITS["usual_stature"] if limit == "stature" else LIMITS[limit]
    if np.isfinite(length) and not (low <= length <= high and usual[0] <= length <= usual[1]):
        possible = not low <= length <= high
        shown = (low, high, why) if possible else usual
        yield Doubt(
            f"{what} is {length:.3g} m, and {'possible' if possible else 'usual'} are {shown[0]:g} to {shown[1]:g} m"
            f" ({shown[2]}){_other_unit(length, usual)}",
            "check the unit of length",
            impossible=possible,
        )
        return
    places = track.position_m[np.isfinite(track.position_m).all(axis=2)]
    if track.orientation_wxyz is None and len(places) and (far := _median(np.linalg.norm(places, axis=1))) > LIMITS["far"][1]:
        yield Doubt(f"markers are {far:.4g} m from the origin: {LIMITS['far'][2]}", "check the unit of length", impossible=True)
    if track.speed_m_s > LIMITS["speed"][1]:
        yield Doubt(
            f"points move at {track.speed_m_s:.3g} m/s, and bodies at {LIMITS['speed'][1]:g} at the most ({LIMITS['speed'][2]})",
            "check the unit of length, and that of the time stamps",
            impossible=True,
        )


def _other_unit(length_m: float, usual: tuple[float, float, str]) -> str:
    """Which confusions of two units would explain a length that is usual then; "" where none would."""
    low, high, _ = usual
    units = ("m", "cm", "mm", "inch")
    found = [
        f"{one} were read as {other}" for one in units for other in units
        if one != other and low <= length_m * LENGTHS_M[one] / LENGTHS_M[other] <= high
    ]  # fmt: skip
    return f"; it would be usual if {' or '.join(found)}" if found else ""


def _axis_doubts(track: BodyTrack) -> Iterator[Doubt]:
    upper, lower = trunk_columns(track.names)
    hips = [column for column in lower if _HIPS.search(track.names[column])]  # who sits has the feet ahead
    if not upper or not hips:
        return
    with np.errstate(all="ignore"):
        top, bottom = (_mean_of_seen(track.position_m[:, columns]) for columns in (upper, hips))
        trunk = (top - bottom) / np.linalg.norm(top - bottom, axis=1, keepdims=True)
    trunk = trunk[np.isfinite(trunk).all(axis=1)]
    if not len(trunk):
        return
    for axis, along in (("x", trunk[:, 0]), ("-x", -trunk[:, 0]), ("y", trunk[:, 1]), ("-y", -trunk[:, 1]), ("-z", -trunk[:, 2])):
        share = float((along > LIMITS["trunk"][1]).mean())
        if share > _MOST:
            yield Doubt(
                f"in {100 * share:.0f} % of the frames shoulders and head lie along {axis} from the hips, and z is up:"
                f" {LIMITS['trunk'][2]}",
                "if nobody lies there, another axis of the file is up (bvh, c3d: --up)",
                impossible=False,
            )


def _orientation_doubts(track: BodyTrack, wxyz: F64) -> Iterator[Doubt]:
    if (doubt := rotation_doubt(wxyz)) is not None:
        yield doubt
    elif np.isfinite(wxyz).all(axis=-1).any():
        yield from _order_doubts(track, wxyz)


def _order_doubts(track: BodyTrack, wxyz: F64) -> Iterator[Doubt]:
    """Whether orientations are read as they are meant: what hangs on a segment lies at one place of its own frame."""
    parents = track.parents or {child: parent for _, parent, child in MVN_JOINTS}
    at = {name: i for i, name in enumerate(track.names)}
    pairs = [(parents[name], name) for name in track.names if parents.get(name) in at]
    bones = {pair: track.position_m[:, at[pair[1]]] - track.position_m[:, at[pair[0]]] for pair in pairs}
    bones = {pair: bone for pair, bone in bones.items() if _median(np.linalg.norm(bone, axis=1)) > _SHORT_M}
    if not bones:
        return
    moved: dict[str, float] = {}
    aligned: dict[str, float] = {}
    for reading, (order, signs) in _READINGS.items():
        local = {
            (parent, name): _in_segment(wxyz[:, at[parent]][:, order] * signs, bone) for (parent, name), bone in bones.items()
        }
        moved[reading] = _median([_unrigid(each) for each in local.values()])
        turns = [_median(_along(local[pair], axis)) for pair, axis in _MVN_BONES.items() if pair in local]
        aligned[reading] = float(np.mean(turns)) if turns else float("nan")
    limit, least = LIMITS["unrigid"][1], LIMITS["bones"][0]
    better = [r for r in moved if moved[r] < min(limit, moved["wxyz"] / 2 + 1e-6) and not aligned[r] < least]
    if not (moved["wxyz"] > limit or (better and aligned["wxyz"] < least)):  # others call segments so that have other axes
        return
    if moved["wxyz"] > limit:
        seen = f"segments move by {100 * moved['wxyz']:.0f} % of a bone's length in the frames of those that they hang on"
    else:
        seen = f"the pelvis, spine and legs lie across the axes of their segments (cosine {aligned['wxyz']:.2f})"
    cause = f": quaternions are {better[0]}, and were read as wxyz" if better else ""
    yield Doubt(
        f"orientations contradict positions: {seen}{cause}",
        "write quaternions as w x y z, from the segment to the world" if better else "export it again",
        impossible=bool(better),
    )


def _in_segment(wxyz: F64, vectors: F64) -> F64:
    """Vectors (F, 3) of the world in the frame of a segment."""
    pure = np.concatenate((np.zeros((len(vectors), 1)), vectors), axis=1)
    return product(product(conjugate(wxyz), pure), wxyz)[:, 1:]


def _unrigid(local: F64) -> float:
    """How far a joint (F, 3) moves in its segment, over its distance; NaN where it is never known."""
    seen = local[np.isfinite(local).all(axis=1)]
    if not len(seen):
        return float("nan")
    away = np.linalg.norm(seen - np.median(seen, axis=0), axis=1)
    return float(np.median(away) / np.median(np.linalg.norm(seen, axis=1)))


def _along(local: F64, axis: Sequence[float]) -> F64:
    with np.errstate(all="ignore"):
        return np.asarray(local @ np.asarray(axis) / np.linalg.norm(local, axis=1))


def _span(points: F64) -> float:
    """The greatest distance between two points (P, 3); NaN where there are fewer."""
    if len(points) < 2:
        return float("nan")
    return float(max(np.linalg.norm(points[i + 1 :] - points[i], axis=1).max() for i in range(len(points) - 1)))


def _stature(names: Sequence[str], position: F64) -> float:
    """By the lengths of the limbs that names tell; NaN where there are too few."""
    found = {(side, joint): column for side in "lr" for joint, column in _joints_of(names, side)}
    statures: dict[tuple[str, str], list[float]] = {}
    for side in "lr":
        for limb, share in LIMBS_OVER_STATURE.items():
            ends = [found.get((side, joint)) for joint in limb]
            if None not in ends:
                length = _median(np.linalg.norm(position[:, ends[0]] - position[:, ends[1]], axis=1))
                if np.isfinite(length) and length > 0:
                    statures.setdefault(limb, []).append(length / share)
    if len(statures) < _LEAST_LIMBS:
        return float("nan")
    return _median([_median(of_limb) for of_limb in statures.values()])


def _joints_of(names: Sequence[str], side: str) -> Iterator[tuple[str, int]]:
    """The joints of a side that names tell, and where they stand."""
    plain: dict[str, int] = {}
    for column, name in enumerate(names):
        word = re.sub(r"[^a-z0-9]+", "_", name.rpartition(":")[2].lower()).strip("_")
        match = _SIDE.fullmatch(word)
        if match and (match[1] or match[4])[0] == side:
            plain.setdefault((match[2] or match[3]).replace("_", ""), column)
    for joint, words in _JOINTS.items():
        if there := [plain[word] for word in words if word in plain]:
            yield joint, there[0]


def _mean_of_seen(points: F64) -> F64:
    """(F, 3) the mean of points (F, P, 3) that are seen."""
    seen = np.isfinite(points).all(axis=2, keepdims=True)
    return np.where(seen, points, 0.0).sum(axis=1) / seen.sum(axis=1)


def _median(values: Sequence[float] | F64) -> float:
    """Of what is finite; NaN where nothing is."""
    array = np.asarray(values, np.float64)
    array = array[np.isfinite(array)]
    return float(np.median(array)) if array.size else float("nan")
