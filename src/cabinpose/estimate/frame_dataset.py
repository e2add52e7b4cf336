"""A dataset's frames for a network of one's own: variables of the standard as torch tensors, one dictionary a frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
import xarray as xr
from torch import Tensor
from torch.utils.data import Dataset

from cabinpose.core import DatasetError, unknown_name
from cabinpose.store import open_dataset

_IMAGE = ("frame", "y", "x")


class FrameDataset(Dataset[Any]):
    """The frames of a dataset folder, or of a selection of it, for `torch.utils.data.DataLoader`.

    Images are read from disk when a frame is asked for; everything else is read once and stays in memory. Values, units and
    dtypes are those of the xarray dataset: depth is float32 metres with NaN where invalid, amplitude uint16. Worker processes
    may be forked or spawned.
    """

    def __init__(
        self,
        data: Path | str | xr.Dataset,
        variables: Sequence[str] = ("depth", "amplitude", "camera_k", "joints_3d", "visibility"),
        transform: Callable[[dict[str, Tensor]], Any] | None = None,
    ) -> None:
        """
        Parameters
        ----------
        data
            The folder of a dataset, or an open one (a selection of it as well).
        variables
            Names of numeric variables and coordinates that every frame has, "frame" (its index) among them.
        transform
            Called with the dictionary of a frame, in the worker; what it returns is the sample. A spawned worker needs one that
            can be pickled: a function of a module, no lambda.

        Raises
        ------
        DatasetError
            For a dataset without frames.
        ConfigError
            For a variable that is not there, or that is no number.
        """
        dataset = data if isinstance(data, xr.Dataset) else open_dataset(data)
        if not dataset.sizes.get("frame"):
            raise DatasetError("there is no frame in the dataset", hint="look at the selection, and at `cabinpose info`")
        known = [str(name) for name, v in dataset.variables.items() if v.dims[:1] == ("frame",) and v.dtype.kind in "biuf"]
        for name in variables:
            if name not in known:
                raise unknown_name("variable", name, known)
        self._frames = int(dataset.sizes["frame"])
        self._images = {name: dataset.variables[name] for name in variables if dataset.variables[name].dims[:3] == _IMAGE}
        self._small = {name: torch.tensor(dataset.variables[name].values) for name in variables if name not in self._images}
        self._variables, self._transform = tuple(variables), transform

    def __len__(self) -> int:
        return self._frames

    def __getitem__(self, index: int) -> Any:
        sample = {
            name: torch.from_numpy(self._images[name][index].values) if name in self._images else self._small[name][index]
            for name in self._variables
        }
        return sample if self._transform is None else self._transform(sample)
