"""A dataset folder as one lazy `xarray.Dataset`, whose arrays read the parts when they are indexed (no dask needed).

A module of its own, so that writing a dataset does not import xarray.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from cabinpose.core import DatasetError, camera_from, known_camera
from cabinpose.store.part_facts import PartFacts, check_parts
from cabinpose.store.schema import MANIFEST_NAME, Manifest, PartPlan, dataset_id, read_manifest, variable_attributes
from cabinpose.store.shard import read_frames, read_whole
from cabinpose.store.variables import AXES, BELT_OF_1, Variable
from cabinpose.store.zarr_metadata import dimension_labels


def open_dataset(folder: Path | str, *, missing: Literal["warn", "raise", "ignore"] = "warn") -> xr.Dataset:
    """All complete parts of a folder as one lazy dataset; depths are float32 metres with NaN where invalid.

    Images are read frame by frame when they are asked for and not kept; `ds.chunk({"frame": 100})` makes dask arrays
    of them.

    Parameters
    ----------
    folder
        The folder of a dataset.
    missing
        Whether missing parts raise a `UserWarning`, a `DatasetError` or nothing; unfinished ones are ignored.

    Returns
    -------
    xarray.Dataset
        The variables of the dataset standard; `frame` holds the frames' indices, so that gaps show.

    Raises
    ------
    DatasetError
        For a folder without a complete part, and for a part that is damaged, by its name.
    """
    path = Path(folder)
    manifest = read_manifest(path)
    plans = manifest.parts_in(path)
    absent = len(manifest.parts) - len(plans)
    if not plans:
        raise DatasetError(f"{path} has no complete part yet", hint="generate it with `cabinpose synth --resume`")
    if absent and missing != "ignore":
        message = f"{path} lacks {absent} of {len(manifest.parts)} parts"
        if missing == "raise":
            raise DatasetError(message, hint="complete it with `cabinpose synth --resume`")
        warnings.warn(message, stacklevel=2)
    return dataset_of_parts(path, manifest, plans, check_parts(path, plans, manifest))


def dataset_of_parts(path: Path, manifest: Manifest, plans: Sequence[PartPlan], facts: list[PartFacts]) -> xr.Dataset:
    """`open_dataset` of the folder of a manifest, of some parts that were checked, whose facts these are."""
    if manifest.checksum is None and any(part.checksum is not None for part in facts):
        raise DatasetError(
            f"{path / MANIFEST_NAME} has lost its checksum, its last line", hint="restore the file as it was written"
        )
    frames = {plan.name: part.frames for plan, part in zip(plans, facts, strict=True)}
    variables = {
        v.name: PartsArray(path, frames, v, manifest.frame_shape(v), [part.crcs(v.name) for part in facts]).lazy(
            variable_attributes(manifest, v)
        )
        for v in manifest.stored
    }
    coordinates: dict[str, Any] = {
        "frame": np.concatenate([_indices(plan, part) for plan, part in zip(plans, facts, strict=True)]),
        **{name: list(labels) for name, labels in dimension_labels(manifest).items()},
    }
    dims = {dim for v in manifest.stored for dim in v.dims}
    coordinates |= {axis: list(names) for axis, names in AXES.items() if axis in dims}
    dataset = xr.Dataset(variables, coordinates, _dataset_attributes(manifest, facts))
    dataset.encoding["source"] = str(path)  # as xarray's own readers note it
    _check_cameras(path, variables, manifest)
    return dataset.set_coords([v.name for v in manifest.stored if v.coordinate])


def _check_cameras(path: Path, variables: Mapping[str, xr.Variable], manifest: Manifest) -> None:
    """Raise DatasetError where the camera of the first or the last frame cannot be; reading all takes long in many parts."""
    ends = [0, variables["camera_k"].shape[0] - 1]
    k, dist = (variables[name][ends].values for name in ("camera_k", "camera_dist"))
    for row, its_k, its_dist in zip(ends, k, dist, strict=True):
        whose = f"{path}: camera_k of the {'last' if row else 'first'} frame"
        known_camera(its_k, its_dist, manifest.width, manifest.height, whose=whose, error=DatasetError)


def _indices(plan: PartPlan, part: PartFacts) -> NDArray[np.int64]:
    """The indices of the frames that a part holds."""
    planned = np.arange(plan.first, plan.first + plan.frames, dtype=np.int64)
    return planned[~np.isin(planned, part.skipped)]


def _dataset_attributes(manifest: Manifest, parts: list[PartFacts]) -> dict[str, Any]:
    """What holds for all frames, and the parts' counts of proposed and rejected scenes added up.

    frames_id: equal where frames of one number are the same frame; "" in datasets made before parts named theirs.
    """
    rejections: Counter[str] = Counter()
    for part in parts:
        rejections.update(part.rejections)
    counted = rejections or any(part.proposals is not None for part in parts)  # of what was generated alone
    names = ("schema_version", "generator", "generator_version", "seed", "licence", "width", "height", "joint_definition")
    unbound = sum(part.dataset is None for part in parts)
    return {name: getattr(manifest, name) for name in names} | {
        "dataset_id": dataset_id(manifest),
        "frames_id": "" if unbound else manifest.content or manifest.parts_belong_to,
        "planned_frames": manifest.frames,
        "parts_without_checksum": sum(part.checksum is None for part in parts),
        "parts_without_dataset": unbound,
        "skipped_frames": sum(len(part.skipped) for part in parts),
        "proposals": sum(part.frames if part.proposals is None else part.proposals for part in parts) if counted else 0,
        "rejections": dict(sorted(rejections.items())),
    }


class PartsArray(BackendArray):
    """One variable over all parts of a folder, decoded: depths are float32 metres with NaN where invalid."""

    def __init__(
        self, folder: Path, frames: Mapping[str, int], variable: Variable, frame_shape: tuple[int, ...], crcs: Sequence[bytes]
    ) -> None:
        """`frames`: how many frames each part holds, by the part's name, in order · crcs: `PartFacts.crcs` of each."""
        self._folder, self._crcs = folder, crcs
        self._names = tuple(frames)
        self._starts = np.cumsum([0, *frames.values()])
        self._variable = variable
        self._latest: tuple[int, NDArray[Any]] = -1, np.empty(0)  # the part whose small values were read last
        self.shape = (int(self._starts[-1]), *frame_shape)
        if variable.dtype == "str":
            self.dtype = np.dtype(object)
        else:
            self.dtype = np.dtype("float32" if variable.scale is not None else variable.dtype)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def lazy(self, attrs: dict[str, Any]) -> xr.Variable:
        """An xarray variable over this array; all but images are kept in memory once they were read whole."""
        data: Any = indexing.LazilyIndexedArray(self)
        if not self._variable.is_image:
            data = indexing.MemoryCachedArray(indexing.CopyOnWriteArray(data))  # type: ignore[no-untyped-call]
        return xr.Variable(self._variable.dims, data, attrs)

    def _read(self, key: tuple[Any, ...]) -> NDArray[Any]:
        rows_asked, rest = key[0], key[1:]
        single = isinstance(rows_asked, (int, np.integer))
        frames = np.atleast_1d(np.arange(self.shape[0])[rows_asked])
        owners = np.searchsorted(self._starts, frames, "right") - 1
        order = np.argsort(owners, kind="stable")
        stored = np.dtype(object if self._variable.dtype == "str" else self._variable.dtype)
        values = np.empty((len(frames), *self.shape[1:]), stored)
        first = np.flatnonzero(np.diff(owners[order], prepend=-1)).tolist()  # where each part's frames begin
        for begin, end in pairwise([*first, len(order)]):
            rows = order[begin:end]
            part = int(owners[rows[0]])
            values[rows] = self._part_values(part, frames[rows] - self._starts[part])
        for axis in range(len(rest), 0, -1):  # from the last, so that axes taken out do not move the others
            values = values[(*[slice(None)] * axis, rest[axis - 1])]
        return self._decoded(values.squeeze(0) if single else values)

    def _part_values(self, part: int, frames: NDArray[np.int64]) -> NDArray[Any]:
        """Raw values of some frames (indices into the part) of one part."""
        name, variable, crcs = self._names[part], self._variable, self._crcs[part]
        path = f"{self._folder}/{name}/{variable.name}/c"
        try:
            if variable.is_image:
                return read_frames(Path(path), frames, self.shape[1:], np.dtype(variable.dtype), crcs)
            if self._latest[0] != part:
                shape = int(self._starts[part + 1] - self._starts[part]), *self.shape[1:]
                self._latest = part, read_whole(path, shape, variable.dtype, crcs)
            values: NDArray[Any] = self._latest[1][frames]
            return values
        except (OSError, ValueError, RuntimeError) as error:
            raise DatasetError(
                f"{name} is damaged: cannot read {variable.name} ({error})",
                hint=f"delete {self._folder / name} and run the command that made it with --resume",
            ) from error

    def _decoded(self, raw: NDArray[Any]) -> NDArray[Any]:
        if self._variable.name == "belt":  # version 1 has other names
            return np.vectorize(lambda state: BELT_OF_1.get(state, state), otypes=[object])(raw)
        if self._variable.scale is not None:
            metres: NDArray[np.float32] = _metres(self._variable.scale)[raw]
            return metres
        return raw


class PointsArray(BackendArray):
    """(frame, y, x, xyz) float32 metres in the camera frame, computed from a depth variable as it is indexed."""

    def __init__(self, depth: xr.Variable, camera_k: xr.Variable, camera_dist: xr.Variable) -> None:
        self._depth, self._k, self._dist = depth, camera_k, camera_dist
        self.shape = (*depth.shape, 3)
        self.dtype = np.dtype(np.float32)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._compute)

    def _compute(self, key: tuple[Any, ...]) -> NDArray[np.float32]:
        first = key[0]
        single = isinstance(first, (int, np.integer))
        frames = slice(first, first + 1) if single else first
        depth = np.asarray(self._depth[frames].values, np.float32)
        intrinsics = zip(self._k[frames].values, self._dist[frames].values, strict=True)
        points = np.empty((*depth.shape, 3), np.float32)
        for i, (k, dist) in enumerate(intrinsics):
            points[i, ..., :2] = _rays(k.tobytes(), dist.tobytes(), depth.shape[2], depth.shape[1]) * depth[i, ..., None]
        points[..., 2] = depth
        return points[(0 if single else slice(None), *key[1:])]


def points_m(dataset: xr.Dataset, variable: str = "depth") -> xr.DataArray:
    """The point cloud of a dataset or a selection of it, computed as it is indexed.

    Parameters
    ----------
    dataset
        A dataset, or one frame of it (`ds.isel(frame=3)`).
    variable
        The depth that is unprojected.

    Returns
    -------
    xarray.DataArray
        (frame, y, x, xyz), of one frame (y, x, xyz): float32 metres in the camera frame, NaN where invalid.

    Raises
    ------
    DatasetError
        Where the dataset lacks the variable, or does not know its camera.
    """
    if variable not in dataset:
        known = [str(name) for name in dataset.data_vars if str(name).startswith("depth")]
        raise DatasetError(f"the dataset has no variable '{variable}'", hint=f"known: {', '.join(known)}")
    depth = dataset[variable]
    if "frame" not in depth.dims:
        whole = dataset[[variable, "camera_k", "camera_dist"]].expand_dims("frame")
        return points_m(whole, variable).isel(frame=0)
    variables = (depth.variable, dataset["camera_k"].variable, dataset["camera_dist"].variable)
    lazy = xr.Variable((*depth.dims, "xyz"), indexing.LazilyIndexedArray(PointsArray(*variables)), {"units": "m"})
    return xr.DataArray(lazy, coords={"frame": depth["frame"], "xyz": ["x", "y", "z"]}, name="points")


@lru_cache
def _metres(scale: float) -> NDArray[np.float32]:
    """(65536,) metres of every stored depth: a table look-up is the quickest way to NaN at 0."""
    table = np.arange(65536, dtype=np.float32) * np.float32(scale)
    table[0] = np.nan
    return table


@lru_cache(maxsize=64)
def _rays(k: bytes, dist: bytes, width: int, height: int) -> NDArray[np.float32]:
    """(height, width, 2) normalised coordinates of a camera given by its raw float64 intrinsics."""
    camera = camera_from(np.frombuffer(k).reshape(3, 3), np.frombuffer(dist), width, height, error=DatasetError)
    return camera.rays.astype(np.float32)
