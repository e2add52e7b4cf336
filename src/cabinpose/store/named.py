"""Places and joints of a dataset by other names, so that one of a room and one of a car are learnt together and judged alike."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.core import CABINPOSE, SKELETONS, ConfigError, DatasetError, Skeleton, Visibility, unknown_name
from cabinpose.store.frames import camera_of
from cabinpose.store.variables import joint_dimension, joints_variable

JointNames: TypeAlias = Mapping[str, str] | str
"""Joints of a dataset by the names that they get: {lhip: lpelvis}, {itop.head: head}; or the set that they are taken of: itop."""
_NONE: Mapping[str, str] = MappingProxyType({})


def as_named(
    dataset: xr.Dataset, places: Mapping[str, str] = _NONE, joints: JointNames = _NONE, *, skeleton: str | None = None,
    slots: Sequence[str] = (),
) -> xr.Dataset:  # fmt: skip
    """A dataset with its places and joints by other names; those that are not named go.

    The joints of all frames are read, images are not.

    Parameters
    ----------
    dataset
        An open dataset, or a selection of it.
    places
        New names by place: {"standing": "driver"}; {}: places stay as they are.
    joints
        New names by joint; those that are not named are then of nobody. A joint is that of the first set that has one of this
        name, the standard's own before others; "itop.head" is that of ITOP. The name of a set alone takes the joints that are the
        same point in both sets by the table of `Skeleton.maps`. {}: joints stay as they are.
    skeleton
        The set that the new names are of; default: the first that has them all.
    slots
        Where places are named, those that there have to be: nobody is in the ones that are not named.

    Returns
    -------
    xarray.Dataset
        With all joints of the set, NaN and `ABSENT` where they are not named. Of joints that were another set's nothing says what
        hides them: those in the image count as visible.

    Raises
    ------
    ConfigError
        For unknown places and joints, new places that are none of the `slots` where one of these lacks, two of one name, and sets
        between which there is no table.
    DatasetError
        For a joint that nobody in the dataset has.
    """
    renamed = _with_places(dataset, places, slots) if places else dataset
    renamed = _with_joints(renamed, joints, skeleton) if joints else renamed
    renamed.encoding = dict(dataset.encoding)  # the folder that splits name it by
    return renamed


def labelled_joints(dataset: xr.Dataset, skeleton: str = CABINPOSE.name) -> tuple[str, ...]:
    """The joints of a set that anybody in a dataset has; of the others it says neither where they are nor that there are none."""
    dimension = joint_dimension(skeleton)
    if joints_variable(skeleton) not in dataset:
        return ()
    if skeleton == CABINPOSE.name:
        known = dataset["visibility"].values > Visibility.ABSENT
    else:
        known = np.isfinite(dataset[joints_variable(skeleton)].values).all(axis=-1)
    return tuple(map(str, dataset[dimension].values[known.any(axis=(0, 1))]))


def projected(dataset: xr.Dataset, points: NDArray[np.floating]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Pixels and states of joints that come without: visible in the image, for nothing says what hides them, or outside it.

    Parameters
    ----------
    dataset
        F frames with their cameras.
    points
        (F, P, J, 3) m, camera frame, NaN = absent.

    Returns
    -------
    joints_2d, visibility
        (F, P, J, 2) px, and (F, P, J) `Visibility`.

    Raises
    ------
    DatasetError
        For a camera that is not known.
    """
    width, height = int(dataset.attrs["width"]), int(dataset.attrs["height"])
    cameras = [camera_of(dataset.isel(frame=i), width, height) for i in range(len(points))]
    uv = np.stack([camera.project(each) for camera, each in zip(cameras, points, strict=True)])
    inside = np.stack([camera.contains(each) for camera, each in zip(cameras, uv, strict=True)])
    known = np.isfinite(points).all(axis=-1)
    states = np.where(known, np.where(inside, Visibility.VISIBLE, Visibility.OUTSIDE_IMAGE), Visibility.ABSENT)
    return uv.astype(np.float32), states.astype(np.uint8)


def _with_places(dataset: xr.Dataset, places: Mapping[str, str], slots: Sequence[str]) -> xr.Dataset:
    persons = [str(name) for name in dataset["person"].values]
    for place in places:
        if place not in persons:
            raise unknown_name("place", place, persons)
    _refuse_twice("places", places.values())
    rows = [persons.index(place) for place in places]
    whole = dataset.drop_vars("instance", errors="ignore")  # which counts people by their rows
    named = whole.isel(person=rows).assign_coords(person=list(places.values()))
    lacking = [slot for slot in slots if slot not in places.values()]
    if not lacking:
        return named
    for place, name in places.items():
        if name not in (place, *slots):  # a place of another method; where one of this method's is lacking, a mistake
            raise unknown_name("place of the method", name, list(slots))
    missing = {
        str(name): np.nan if each.dtype.kind == "f" else 0 if each.dtype.kind in "iub" else ""
        for name, each in named.variables.items()
    }
    return named.reindex(person=[*places.values(), *lacking], fill_value=missing)


def _with_joints(dataset: xr.Dataset, joints: JointNames, skeleton: str | None) -> xr.Dataset:
    names = _same_joints(joints, skeleton or CABINPOSE.name) if isinstance(joints, str) else joints
    _refuse_twice("joints", names.values())
    target = _target(names.values(), skeleton)
    sources = {ours: _source(dataset, theirs) for theirs, ours in names.items()}
    _refuse_nobodys(dataset, sources.values())
    dimension, count = joint_dimension(target.name), len(target.joints)
    points = np.full((dataset.sizes["frame"], dataset.sizes["person"], count, 3), np.nan, np.float32)
    own: dict[int, int] = {}  # columns of the same variables as before, by their new ones
    for of in {of for of, _ in sources.values()}:
        there = list(map(str, dataset[joint_dimension(of)].values))
        columns = {target.index[ours]: there.index(joint) for ours, (each, joint) in sources.items() if each == of}
        points[:, :, list(columns)] = dataset[joints_variable(of)].values[:, :, list(columns.values())]
        own |= columns if of == target.name else {}
    rest = dataset.drop_dims(dimension, errors="ignore").assign_coords({dimension: list(target.joints)})
    if target.name != CABINPOSE.name:
        return rest.assign({joints_variable(target.name): (("frame", "person", dimension, "xyz"), points)})
    arrays = {
        str(name): (each.dims, _moved(each.values, count, own), each.attrs)
        for name, each in dataset.data_vars.items()
        if dimension in each.dims
    }
    arrays["joints_3d"][1][:] = points
    if foreign := [ours for ours, (of, _) in sources.items() if of != target.name]:
        at = target.indices(foreign)
        uv, states = projected(dataset, points[:, :, at])
        arrays["joints_2d"][1][:, :, at], arrays["visibility"][1][:, :, at] = uv, states
        # They are no longer where the dataset says that its joints are.
        rest = rest.assign_attrs(joint_definition=", ".join(dict.fromkeys(sources[ours][0] for ours in foreign)))
    return rest.assign(arrays)


def _moved(values: NDArray[Any], count: int, columns: Mapping[int, int]) -> NDArray[Any]:
    """(F, P, count, ...) of an array (F, P, J, ...), of which some joints are columns of it and the others NaN or 0."""
    missing = np.nan if values.dtype.kind == "f" else 0
    result = np.full((*values.shape[:2], count, *values.shape[3:]), missing, values.dtype)
    result[:, :, list(columns)] = values[:, :, list(columns.values())]
    return result


def _same_joints(of: str, to: str) -> dict[str, str]:
    """By joint of one set the joint of another that is the same point."""
    if of not in SKELETONS:
        raise unknown_name("set of joints", of, list(SKELETONS))
    if of == to:
        return {f"{of}.{joint}": joint for joint in SKELETONS[of].joints}
    other = of if to == CABINPOSE.name else to
    if CABINPOSE.name not in (of, to) or other not in CABINPOSE.maps:
        raise ConfigError(f"no table says which joints of {to} those of {of} are", hint="name them, as in {itop.head: head}")
    pairs = CABINPOSE.maps[other].items()
    return {f"{of}.{theirs}": ours for ours, theirs in pairs} if of == other else {f"{of}.{a}": b for a, b in pairs}


def _target(names: Iterable[str], skeleton: str | None) -> Skeleton:
    """The set that joints are named of."""
    wanted = tuple(names)
    fitting = (each for each in SKELETONS.values() if set(wanted) <= set(each.joints))
    found = SKELETONS[skeleton] if skeleton is not None else next(fitting, CABINPOSE)
    for name in wanted:
        if name not in found.index:
            raise unknown_name(f"joint of {found.title}", name, found.joints)
    return found


def _source(dataset: xr.Dataset, name: str) -> tuple[str, str]:
    """The set and the joint that a name means."""
    dimensions = {each: joint_dimension(each) for each in SKELETONS}
    there = {each: list(map(str, dataset[name].values)) for each, name in dimensions.items() if name in dataset.coords}
    of, _, joint = name.rpartition(".")
    if of and of not in there:
        raise unknown_name("set of joints in the dataset", of, list(there))
    for each in [of] if of else there:
        if joint in there[each]:
            return each, joint
    known = [joint if each == CABINPOSE.name else f"{each}.{joint}" for each, names in there.items() for joint in names]
    raise unknown_name("joint of the dataset", name, known)


def _refuse_nobodys(dataset: xr.Dataset, sources: Iterable[tuple[str, str]]) -> None:
    """Raise DatasetError for a joint that nobody has."""
    chosen = tuple(sources)
    known = {of: labelled_joints(dataset, of) for of, _ in chosen}
    for of, joint in chosen:
        if joint not in known[of]:
            others = [
                f"{each.name}.{joint}" for each in SKELETONS.values()
                if each.name != of and joint in each.index and joint in labelled_joints(dataset, each.name)
            ]  # fmt: skip
            hint = f"another set has one: {', '.join(others)}" if others else f"somebody has: {', '.join(known[of]) or 'none'}"
            raise DatasetError(f"nobody in the dataset has the joint {joint} of the set {of}", hint=hint)


def _refuse_twice(what: str, names: Iterable[str]) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise ConfigError(f"two {what} are named {name}", hint="give each a name of its own")
