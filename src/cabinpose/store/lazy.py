"""Arrays that read a dataset's parts when they are indexed, for xarray's lazy variables (no dask needed)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from cabinpose.core.camera import Camera
from cabinpose.core.errors import DatasetError
from cabinpose.store.schema import PartPlan, Variable


class PartsArray(BackendArray):
    """One variable over all parts of a folder, decoded: depths are float32 metres with NaN where invalid."""

    def __init__(self, folder: Path, plans: Sequence[PartPlan], variable: Variable, frame_shape: tuple[int, ...]) -> None:
        self._folder = folder
        self._names = tuple(plan.name for plan in plans)
        self._starts = np.cumsum([0] + [plan.frames for plan in plans])
        self._variable = variable
        self._open: dict[int, zarr.Array[Any]] = {}
        self.shape = (int(self._starts[-1]), *frame_shape)
        if variable.dtype == "str":
            self.dtype = np.dtype(object)
        else:
            self.dtype = np.dtype("float32" if variable.scale is not None else variable.dtype)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_open": {}}

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def lazy(self, attrs: dict[str, Any]) -> xr.Variable:
        """An xarray variable over this array; all but images are kept in memory once they were read whole."""
        data: Any = indexing.LazilyIndexedArray(self)
        if not self._variable.is_image:
            data = indexing.MemoryCachedArray(indexing.CopyOnWriteArray(data))  # type: ignore[no-untyped-call]
        return xr.Variable(self._variable.dims, data, attrs)

    def _read(self, key: tuple[Any, ...]) -> NDArray[Any]:
        first, rest = key[0], key[1:]
        if isinstance(first, (int, np.integer)):
            return self._decoded(self._part_values(int(np.searchsorted(self._starts, first, "right")) - 1, int(first), rest))
        frames = np.arange(self.shape[0])[first]
        owners = np.searchsorted(self._starts, frames, "right") - 1
        pieces, start = [], 0
        for stop in (*(np.flatnonzero(np.diff(owners)) + 1), len(frames)):  # runs of frames of one part, in the order asked
            if stop > start:
                pieces.append(self._part_values(int(owners[start]), frames[start:stop], rest))
            start = stop
        if not pieces:
            nothing = np.empty((0, *self.shape[1:]), self.dtype)
            return nothing[(slice(None), *np.ix_(*[np.arange(n)[k] for n, k in zip(self.shape[1:], rest, strict=True)]))]
        return self._decoded(pieces[0] if len(pieces) == 1 else np.concatenate(pieces))

    def _part_values(self, part: int, frames: int | NDArray[np.int64], rest: tuple[Any, ...]) -> NDArray[Any]:
        """Raw values of frames (indices into the whole dataset) of one part."""
        local: Any = frames - self._starts[part]
        if isinstance(local, np.ndarray) and (np.diff(local) == 1).all():
            local = slice(int(local[0]), int(local[-1]) + 1)
        name = self._names[part]
        try:
            if part not in self._open:
                self._open[part] = zarr.open_array(self._folder / name / self._variable.name, mode="r")
            return np.asarray(self._open[part].oindex[(local, *rest)])
        except (OSError, ValueError, RuntimeError, KeyError) as error:
            raise DatasetError(
                f"{name} is damaged: cannot read {self._variable.name} ({error})",
                hint=f"delete {self._folder / name} and run the command that made it with --resume",
            ) from error

    def _decoded(self, raw: NDArray[Any]) -> NDArray[Any]:
        if self._variable.scale is not None:
            values = raw.astype(np.float32)
            values *= np.float32(self._variable.scale)
            return np.where(raw == 0, np.float32(np.nan), values)
        return raw.astype(self.dtype, copy=False)


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
    """The point cloud (frame, y, x, xyz) of a dataset or a selection of it, lazily.

    float32 metres in the camera frame, NaN where invalid. `variable` names the depth that is
    unprojected. A frame taken out (`ds.isel(frame=3)`) has points (y, x, xyz).
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


@lru_cache(maxsize=64)
def _rays(k: bytes, dist: bytes, width: int, height: int) -> NDArray[np.float32]:
    """(height, width, 2) normalised coordinates of a camera given by its raw float64 intrinsics."""
    (fx, _, cx), (_, fy, cy), _ = np.frombuffer(k).reshape(3, 3).tolist()
    k1, k2, p1, p2, k3 = np.frombuffer(dist).tolist()
    return Camera(width, height, fx, fy, cx, cy, (k1, k2, p1, p2, k3)).rays.astype(np.float32)
