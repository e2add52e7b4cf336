"""Whether the joints of a dataset can be those of its images: pixels, bodies, sides and depth, on a sample of its frames."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import (
    CABINPOSE,
    ITOP,
    LIMBS_OVER_STATURE,
    OCCUPANT_SLOTS,
    OTHER_SKELETONS,
    Bools,
    Camera,
    DatasetError,
    Floats,
    Skeleton,
    Visibility,
    depth_doubt,
    known_camera,
    units_that_fit,
)
from cabinpose.store.source import UNKNOWN
from cabinpose.store.variables import joint_dimension, joints_variable

if TYPE_CHECKING:
    import xarray as xr

FRAMES: Final = 64  # that are looked at, evenly over the dataset
_LEAST: Final = 20  # joints on which a share is worth something
_OFTEN: Final = 4  # frames of a person from which lengths are known
_SURE: Final = 0.5  # of a cosine or a sine: 60° and 30°
_STRETCHED: Final = 1.25  # times as long or as short is another length
_TREND: Final = 8  # frames from which it is told how distances change over the image
_IN_FRONT_M: Final = 0.1  # is before a surface, and no noise

# What is told beyond which value, each with its reason. Generated labels come to 0 where no other figure is given; "ITOP" are the
# 4 863 labelled frames of its side view, "top" 64 of its top view, of which all joints are called visible.
LIMITS: Mapping[str, tuple[float, str]] = MappingProxyType({
    "unit_px": (2.0, "joints of a person nearer than 10 m are more than 2 px apart"),
    "outside": (0.2, "a joint that is marked as visible lies in the image"),
    "projection_px": (3.0, "joints_2d is the projection of joints_3d; float32 and labels by hand are within 3 px"),
    "own": (0.65, "a visible joint lies on its own person's pixels; 89 to 100 % do, belts and clothes aside"),
    "crossed": (0.02, "nobody turns the shoulders by 120° against the hips"),
    "seats": (0.02, "seats do not turn"),
    "behind": (0.5, "what a camera sees has z > 0"),
    "short_m": (0.4, "newborn people are 0.5 m long"),
    "tall_m": (2.4, "people are at most 2.2 m tall, and the skeletons of depth cameras up to a tenth larger"),
    "limbs": (0.2, f"bones keep their length; labels of depth cameras change it so in 4 % (ITOP), by a factor of {_STRETCHED:g}"),
    "sides": (0.02, "thighs, knees and feet point to the front that shoulders and hips have; 0.3 % do not (ITOP)"),
    "in_front": (0.25, "joints lie below the skin that the camera sees; 11 and 18 % do not (ITOP, top)"),
    "far_behind_m": (0.45, "a visible joint lies at most 0.4 m below the surface; 0.07 m are usual, 0.31 m are known (top)"),
    "along": (2.0, "z and depth run along the optical axis, not along the ray; the opposite never fits better"),
})  # fmt: skip

# Lengths over stature by our joints: a hip is `lpelvis` or `rpelvis`.
_BONES = {("pelvis" if a == "hip" else a, b): share for (a, b), share in LIMBS_OVER_STATURE.items()}
_TRUNK: Final = 0.288  # hips to shoulders; of Winter's figure as well
_FEWEST: Final = 4  # of a person's nine lengths, by which the stature is told

# Joints of other sets by ours, near enough for lengths and sides: ITOP's hands and feet end where forearms and shins do.
_THEIRS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {CABINPOSE.name: {joint: joint for joint in CABINPOSE.joints}}
    | {name: dict(table) for name, table in CABINPOSE.maps.items()}
    | {ITOP.name: {**CABINPOSE.maps[ITOP.name], "lwrist": "lhand", "rwrist": "rhand", "lankle": "lfoot", "rankle": "rfoot"}}
)


class _Labels(NamedTuple):
    """Joints of F frames and P people by our J names, NaN where their set has none.

    xyz: (F, P, J, 3) m · uv: (F, P, J, 2) px · seen: (F, P, J) whether they are visible · who: (F, P) the person in this place,
    "" for nobody.
    """

    xyz: Floats
    uv: Floats
    seen: Bools
    who: NDArray[np.str_]

    def metres(self, name: str) -> Floats:
        """(F, P, 3) of a joint; without its side, of the middle between both."""
        return _joint(self.xyz, name)

    def pixels(self, name: str) -> Floats:
        """(F, P, 2), likewise."""
        return _joint(self.uv, name)


def label_warnings(dataset: xr.Dataset) -> tuple[str, ...]:
    """What is hardly right about the joints of a dataset, in words; empty where nothing is, or where it has none.

    Parameters
    ----------
    dataset
        An opened one (`open_dataset`), or a selection of its frames, of which 64 at most are looked at.

    Raises
    ------
    DatasetError
        Where the camera of one of these frames cannot be.
    """
    frames = dataset.sizes["frame"]
    if "joints_3d" not in dataset or "joints_2d" not in dataset or not frames:
        return ()
    some = dataset.isel(frame=np.unique(np.linspace(0, frames - 1, min(frames, FRAMES)).astype(int)))
    xyz, uv = (some[name].values.astype(np.float64) for name in ("joints_3d", "joints_2d"))
    known = "visibility" in some
    seen: Bools = np.asarray(some["visibility"] == Visibility.VISIBLE if known else np.isfinite(uv).all(axis=-1), bool)
    size = (dataset.attrs["width"], dataset.attrs["height"]) if "width" in dataset.attrs else None
    with warnings.catch_warnings(action="ignore"):  # what is doubtful of a camera was said at opening
        cameras = _cameras(some, size)
    told: list[str] = []
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of means of nothing
        told += [*_pixels(uv, seen, size), *_projection(xyz, uv, seen, cameras)]
        told += [line for name, labels in _sets(some, xyz, uv, seen) for line in _bodies(name, labels)]
        ours = _by_our_names(_names(some, CABINPOSE), _Labels(xyz, uv, seen, _people(some)))
        told += [*_crossed(ours), *_seats(ours, some), *_own_pixels(ours, some), *_surface(ours, some, cameras)]
        told += _folded(some, cameras)
    return tuple(told)


def warn_of_labels(dataset: xr.Dataset, whose: str) -> None:
    """Warn of what is hardly right about the joints of a dataset; whose: what messages call it."""
    for doubt in label_warnings(dataset):
        warnings.warn(f"{whose}: {doubt}", stacklevel=2)


def _names(some: xr.Dataset, skeleton: Skeleton) -> tuple[str, ...]:
    return tuple(map(str, some[joint_dimension(skeleton.name)].values))


def _people(some: xr.Dataset) -> NDArray[np.str_]:
    """(F, P) who is there: the subject in this place; "" for nobody, and for somebody who is not known."""
    subjects = some["subject"].values.astype(str)
    places = some["person"].values.astype(str)
    there = (subjects != "") & (subjects != UNKNOWN)
    return np.where(there, np.char.add(np.char.add(subjects, " "), places), "")


def _sets(some: xr.Dataset, xyz: Floats, uv: Floats, seen: Bools) -> Iterator[tuple[str, _Labels]]:
    """Every set of joints of the dataset that has metres: its variable, and its joints by our names."""
    yield "joints_3d", _by_our_names(_names(some, CABINPOSE), _Labels(xyz, uv, seen, _people(some)))
    for skeleton in OTHER_SKELETONS:
        if (variable := joints_variable(skeleton.name)) in some:
            own = some[variable].values.astype(np.float64)
            bare = _Labels(own, np.full((*own.shape[:-1], 2), np.nan), np.zeros(own.shape[:-1], bool), _people(some))
            yield variable, _by_our_names(_names(some, skeleton), bare)


def _by_our_names(names: tuple[str, ...], theirs: _Labels) -> _Labels:
    """Joints of whichever set has most of these names, in the order of ours."""
    tables = ([(CABINPOSE.index[a], names.index(b)) for a, b in table.items() if b in names] for table in _THEIRS.values())
    here, there = np.array(max(tables, key=len), int).reshape(-1, 2).T
    shape = (*theirs.xyz.shape[:2], len(CABINPOSE.joints))
    xyz, uv, seen = np.full((*shape, 3), np.nan), np.full((*shape, 2), np.nan), np.zeros(shape, bool)
    xyz[:, :, here], uv[:, :, here], seen[:, :, here] = (a[:, :, there] for a in (theirs.xyz, theirs.uv, theirs.seen))
    return _Labels(xyz, uv, seen, theirs.who)


def _joint(points: Floats, name: str) -> Floats:
    if name in CABINPOSE.index:
        return np.asarray(points[..., CABINPOSE.index[name], :])
    return (_joint(points, "l" + name) + _joint(points, "r" + name)) / 2


def _across(points: Floats, name: str) -> Floats:
    """From the right joint of a pair to the left one."""
    return _joint(points, "l" + name) - _joint(points, "r" + name)


def _length(vectors: Floats) -> Floats:
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def _cosine(a: Floats, b: Floats) -> Floats:
    return np.asarray((a * b).sum(axis=-1) / (_length(a) * _length(b)))


# ------------------------------------------------------------------------------------------------------------ pixels


def _pixels(uv: Floats, seen: Bools, size: tuple[int, int] | None) -> Iterator[str]:
    two = np.isfinite(uv).all(axis=-1)
    if two.sum() < _LEAST:
        return
    if np.abs(uv[two]).max() <= LIMITS["unit_px"][0]:
        span = f"{uv[two].min():.2f} to {uv[two].max():.2f} px"
        yield f"joints_2d is from {span}: normalised to the image's size? {LIMITS['unit_px'][1]}"
    elif size is not None and (two & seen).sum() >= _LEAST:
        at = uv[two & seen]
        share = float(1 - ((at >= -1) & (at <= np.array(size))).all(axis=-1).mean())
        if share > LIMITS["outside"][0]:
            where = f"outside of the image ({size[0]} x {size[1]} px)"
            yield f"{100 * share:.0f} % of the visible joints lie {where}: pixels of another size? {LIMITS['outside'][1]}"


def _cameras(some: xr.Dataset, size: tuple[int, int] | None) -> list[Camera]:
    """The camera of each frame; none where one is not known. Raises DatasetError where one cannot be."""
    if size is None or "camera_k" not in some or "camera_dist" not in some:
        return []
    each = zip(some["camera_k"].values, some["camera_dist"].values, strict=True)
    cameras = [known_camera(k, dist, *size, whose="camera_k of a frame", error=DatasetError) for k, dist in each]
    return [camera for camera in cameras if camera is not None] if None not in cameras else []


def _projection(xyz: Floats, uv: Floats, seen: Bools, cameras: Sequence[Camera]) -> Iterator[str]:
    """joints_2d beside the projection of joints_3d, of the joints that are seen."""
    if not cameras:
        return
    should = np.stack([camera.project(joints) for camera, joints in zip(cameras, xyz, strict=True)])
    off = _length(should - uv)[seen]
    off = off[np.isfinite(off)]
    if len(off) >= _LEAST and (median := float(np.median(off))) > LIMITS["projection_px"][0]:
        yield f"joints_2d is {median:.3g} px (the median) from where joints_3d and camera_k have it: {LIMITS['projection_px'][1]}"


def _crossed(labels: _Labels) -> Iterator[str]:
    """People of whom shoulders and hips, both seen broad enough, point to opposite sides."""
    shoulders, hips = _across(labels.uv, "shoulder"), _across(labels.uv, "pelvis")
    trunk = _length(labels.pixels("shoulder") - labels.pixels("pelvis"))
    clear = (_length(shoulders) > 0.3 * trunk) & (_length(hips) > 0.15 * trunk)
    if told := _some(clear & (_cosine(shoulders, hips) < -_SURE), clear, "crossed"):
        yield f"in {told} the shoulders are crossed against the hips: left and right exchanged? {LIMITS['crossed'][1]}"


def _seats(labels: _Labels, some: xr.Dataset) -> Iterator[str]:
    """People in seats who face another way than most of those whom the same camera sees in the same seat of the same car."""
    up = labels.pixels("shoulder") - labels.pixels("pelvis")
    sides = []
    for name in ("shoulder", "pelvis"):
        left = _across(labels.uv, name)
        sides.append((left[..., 0] * up[..., 1] - left[..., 1] * up[..., 0]) / (_length(left) * _length(up)))
    clear = np.minimum(*map(np.abs, sides)) > _SURE
    views = np.char.add(np.char.add(some["car"].values.astype(str), " "), some["pov"].values.astype(str))
    apart, judged = np.zeros((2, *clear.shape), bool)
    for column, person in enumerate(some["person"].values):
        for view in np.unique(views[some["pov"].values != UNKNOWN]) if person in OCCUPANT_SLOTS else ():
            of = clear[:, column] & (views == view)
            turned = of & (sides[0][:, column] * np.median(sides[0][of, column]) < 0)
            if of.sum() > _OFTEN and turned.sum() < 0.2 * of.sum():
                apart[:, column] |= turned
                judged[:, column] |= of
    if told := _some(apart, judged, "seats"):
        yield f"{told} face another way than the others in their seat: left and right exchanged? {LIMITS['seats'][1]}"


def _some(wrong: Bools, judged: Bools, limit: str) -> str:
    """How many of the people judged are wrong, in words; "" for one alone, and up to the limit."""
    count, total = int(wrong.sum()), int(judged.sum())
    return f"{100 * count / total:.0f} % of the people ({count} of {total})" if count > max(1, LIMITS[limit][0] * total) else ""


# ------------------------------------------------------------------------------------------------------------ bodies


def _bodies(name: str, labels: _Labels) -> Iterator[str]:
    """What bodies say of a variable of joints in metres."""
    three = np.isfinite(labels.xyz).all(axis=-1)
    if three.sum() < _LEAST:
        return
    if (share := float((labels.xyz[three][:, 2] <= 0).mean())) > LIMITS["behind"][0]:
        yield f"{100 * share:.0f} % of {name} lie behind the camera: another frame, or z negated? {LIMITS['behind'][1]}"
    lengths = np.stack(
        [_length(labels.metres(s + a) - labels.metres(s + b)) for s in "lr" for a, b in _BONES]
        + [_length(labels.metres("shoulder") - labels.metres("pelvis"))],
        axis=-1,
    )
    yield from _statures(name, lengths, labels.who)
    yield from _limbs(name, lengths[..., :-1], labels.who)
    if told := _some(*_backward(labels), "sides"):
        yield (
            f"in {told} left and right of {name} contradict thighs, knees and feet: exchanged, or an image mirrored?"
            f" {LIMITS['sides'][1]}"
        )


def _statures(name: str, lengths: Floats, who: NDArray[np.str_]) -> Iterator[str]:
    """People who are too small or too tall by their lengths (F, P, 9); of those without a name all of a place are one."""
    known = np.isfinite(lengths)
    stature = np.where(known, lengths, 0.0).sum(axis=-1) / (known * [*_BONES.values(), *_BONES.values(), _TRUNK]).sum(axis=-1)
    stature[known.sum(axis=-1) < _FEWEST] = np.nan
    people = [stature[:, place][who[:, place] == one] for place in range(who.shape[1]) for one in np.unique(who[:, place])]
    medians = np.array([np.median(each[np.isfinite(each)]) for each in people if np.isfinite(each).any()])
    low, high = LIMITS["short_m"][0], LIMITS["tall_m"][0]
    wrong = medians[(medians < low) | (medians > high)]
    if len(wrong):
        middle = float(np.median(wrong))
        units = units_that_fit(middle, (0.7, 2.2), ("mm", "cm", "inch"))
        cause = f"{name} fits in {units[0]}" if units else "another unit or scale?"
        why = LIMITS["tall_m" if middle > high else "short_m"][1]
        yield f"{len(wrong)} of {len(medians)} people are {middle:.3g} m tall by their bones in {name}: {cause}; {why}"


def _limbs(name: str, lengths: Floats, who: NDArray[np.str_]) -> Iterator[str]:
    """Limbs (F, P, 8) that differ from the same person's other frames, or from those of the other side."""
    log = np.log(lengths)
    own = [log[who == one] for one in np.unique(who[who != ""])]
    frames = [np.abs(each - np.nanmedian(each, axis=0)).ravel() for each in own if len(each) >= _OFTEN]
    half = len(_BONES)
    cases = (
        ("the same person's in other frames", np.concatenate([*frames, np.empty(0)])),
        ("that of the other side", np.abs(log[..., :half] - log[..., half:]).ravel()),
    )
    for than, apart in cases:
        apart = apart[np.isfinite(apart)]
        share = float((apart > np.log(_STRETCHED)).mean()) if len(apart) >= _LEAST else 0.0
        if share > LIMITS["limbs"][0]:
            yield f"{100 * share:.0f} % of the limbs in {name} are a quarter longer or shorter than {than}: {LIMITS['limbs'][1]}"
            return


def _backward(labels: _Labels) -> tuple[Bools, Bools]:
    """(F, P) whether thighs, bent knees and feet point back, where left and right have the front; and where one tells it."""
    up = labels.metres("shoulder") - labels.metres("pelvis")
    front = np.cross(_across(labels.xyz, "shoulder") + _across(labels.xyz, "pelvis"), up)
    bends = labels.metres("knee") - (labels.metres("pelvis") + labels.metres("ankle")) / 2
    bends[_length(bends) < 0.15 * _length(up)] = np.nan  # legs are straight
    ahead = np.stack(
        [
            _cosine(front, labels.metres("knee") - labels.metres("pelvis")),
            _cosine(front, bends),
            _cosine(front, labels.metres("foot") - labels.metres("ankle")),
        ]
    )
    ahead[~(np.abs(ahead) > _SURE)] = 0.0
    return np.asarray(ahead.sum(axis=0) < 0), np.asarray(ahead.any(axis=0))


# ------------------------------------------------------------------------------------------------------------ images


def _at_joints(images: xr.DataArray, labels: _Labels) -> Floats:
    """(F, P, J) what images (F, y, x) have at the joints that are seen; NaN at others."""
    found = np.full(labels.seen.shape, np.nan)
    columns, rows = (np.where(labels.seen, np.rint(labels.uv[..., i]), -1) for i in range(2))
    inside = (columns >= 0) & (rows >= 0) & (columns < images.sizes["x"]) & (rows < images.sizes["y"])
    for i in np.flatnonzero(inside.any(axis=(1, 2))):  # one image in memory at a time
        here = inside[i]
        found[i][here] = images[i].values[rows[i][here].astype(int), columns[i][here].astype(int)]
    return found


def _own_pixels(labels: _Labels, some: xr.Dataset) -> Iterator[str]:
    """Visible joints beside the pixels of their person."""
    if "instance" not in some:
        return
    whose = _at_joints(some["instance"], labels)
    known = np.isfinite(whose)
    own = whose == np.arange(1, whose.shape[1] + 1)[:, None]
    if known.sum() >= _LEAST and (share := float(own[known].mean())) < LIMITS["own"][0]:
        what = f"{100 * share:.0f} % of the visible joints lie on pixels of their person"
        yield f"only {what}: joints of other frames or people, or u and v exchanged? {LIMITS['own'][1]}"


def _surface(labels: _Labels, some: xr.Dataset, cameras: Sequence[Camera]) -> Iterator[str]:
    """joints_3d beside the depth that is measured where they are seen; that of the geometry, if there is one, does not wrap."""
    image = next((name for name in ("depth_clean", "depth") if name in some), None)
    if image is None:
        return
    depth, z = _at_joints(some[image], labels), labels.xyz[..., 2]
    known = np.isfinite(depth) & np.isfinite(z)
    if known.sum() < _LEAST:
        return
    gap = (z - depth)[known]
    middle, front = float(np.median(gap)), float((gap < -_IN_FRONT_M).mean())
    ratio = float(np.median(depth[known] / z[known]))
    cause = f"{image} of other frames?" if 0.5 < ratio < 2 else f"it is {ratio:.2g} times as far: another unit, or out of range?"
    if middle > LIMITS["far_behind_m"][0]:
        yield f"visible joints lie {middle:.2f} m (the median) behind the surface in {image}: {cause} {LIMITS['far_behind_m'][1]}"
    elif front > LIMITS["in_front"][0]:
        what = f"{100 * front:.0f} % of the visible joints lie more than {_IN_FRONT_M:g} m before the surface in {image}"
        yield f"{what}: {cause} {LIMITS['in_front'][1]}"
    elif cameras and known.any(axis=(1, 2)).sum() >= _TREND:
        yield from _along(image, labels, depth, known, cameras)


def _folded(some: xr.Dataset, cameras: Sequence[Camera]) -> Iterable[str]:
    """The lens of the first frame beside its depth."""
    return filter(None, [depth_doubt(cameras[0], some["depth"][0].values)] if cameras and "depth" in some else [])


def _along(image: str, labels: _Labels, depth: Floats, known: Bools, cameras: Sequence[Camera]) -> Iterator[str]:
    """Whether z or depth fit much better if they run along the ray."""
    focal = np.array([(camera.fx, camera.fy) for camera in cameras])[:, None, None]
    centre = np.array([(camera.cx, camera.cy) for camera in cameras])[:, None, None]
    bent = (labels.uv - centre) / focal
    rays = np.stack([camera.undistort(xy) for camera, xy in zip(cameras, bent, strict=True)])
    stretch, z = np.sqrt(1 + (rays**2).sum(axis=-1)), labels.xyz[..., 2]
    below = np.array([CABINPOSE.skin_m[joint] for joint in CABINPOSE.joints])

    def apart(z: Floats, depth: Floats) -> float:
        return float(np.nanmedian(np.abs(z - depth - below)[known]))

    now = apart(z, depth)
    for what, then in (("z of joints_3d is", apart(z / stretch, depth)), (f"{image} is", apart(z, depth / stretch))):
        if now > LIMITS["along"][0] * then:
            fits = f"joints lie {100 * now:.1f} cm (the median) from where {image} has them, and {100 * then:.1f} cm if"
            yield f"{fits} {what} the distance from the lens: {LIMITS['along'][1]}"
            return
