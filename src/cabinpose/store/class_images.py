"""A segmentation's answers on a dataset: a Zarr group with a class for every pixel of every frame, which any tool can write.

Arrays: `labels` (frame, y, x) uint8, 0 = nobody, else 1 + the position of the part in the attribute `parts`; `frame` (frame,)
int64, the frames' numbers in the dataset, rising. Attributes of the group: `format`, `version`, `model`, `dataset`, and `parts`,
a list of name and ids, the dataset's classes that belong to the part.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import zarr
from numpy.typing import NDArray

from cabinpose.core import FrameBatch, Part, PredictionsError, whole_folder

SUFFIX: Final = ".zarr"
FORMAT: Final = "cabinpose-class-images"
VERSION: Final = 1
_CHUNK = 16  # frames
_LARGEST_CHUNK = 1 << 28  # bytes, which are in memory at once
_DESCRIBED = "docs/evaluation.md describes the format"
_AGAIN = "the file may be cut short; write it again"


@dataclass(frozen=True)
class ClassImages:
    """The answers of one segmentation; fulfils `core.ports.Segmenter`.

    labels: (F, H, W), read when asked for · frame: (F,) numbers, rising · dataset: its id or the name of its folder, or None.
    """

    labels: Any
    frame: NDArray[np.int64]
    parts: tuple[Part, ...]
    name: str
    dataset: str | None

    def segment(self, frames: FrameBatch) -> NDArray[np.uint8]:
        """The label images (N, H, W) of frames by their numbers; a frame without an answer shows nobody."""
        shape = frames["depth"].shape
        if shape[1:] != self.labels.shape[1:]:
            own, theirs = ("x".join(map(str, s[:0:-1])) for s in (self.labels.shape, shape))
            raise PredictionsError(f"{self.name}: label images of {own} pixels, frames of {theirs}", hint=_DESCRIBED)
        result = np.zeros(shape, np.uint8)
        at = np.searchsorted(self.frame, frames["frame"])
        for image, number, place in zip(result, frames["frame"], at.tolist(), strict=True):
            if place < len(self.frame) and self.frame[place] == number:
                try:
                    image[...] = self.labels[place]
                except Exception as error:  # of codecs
                    raise PredictionsError(f"{self.name}: frame {number} cannot be read: {error}", hint=_AGAIN) from error
        if result.max(initial=0) > len(self.parts):
            raise PredictionsError(
                f"{self.name}: a pixel of class {result.max()}, of {len(self.parts)} parts", hint="write 0 where there is no part"
            )
        return result


def check_new_class_images(path: Path, *, overwrite: bool) -> None:
    """Raise `PredictionsError` unless label images may be written under this name."""
    if path.suffix != SUFFIX:
        raise PredictionsError(f"{path.name} is no name for label images", hint=f"let it end in {SUFFIX}")
    if path.exists() and not overwrite:
        raise PredictionsError(f"{path} exists", hint="--overwrite replaces it, or give another name")


def write_class_images(
    path: Path, batches: Iterable[NDArray[np.uint8]], frame: NDArray[np.int64], parts: Sequence[Part], *, model: str,
    dataset: str | None = None, overwrite: bool = False,
) -> None:  # fmt: skip
    """Write label images, batches (N, H, W) of the frames numbered `frame` (F,) in their order; they appear when they are whole.

    Raises `PredictionsError` as `check_new_class_images` does.
    """
    check_new_class_images(path, overwrite=overwrite)
    with whole_folder(path, kind=PredictionsError) as temporary:
        group = zarr.open_group(temporary, mode="w", zarr_format=3)
        described: list[Any] = [{"name": part.name, "ids": list(part.ids)} for part in parts]
        group.attrs.update({"format": FORMAT, "version": VERSION, "model": model, "dataset": dataset, "parts": described})
        group.create_array("frame", data=frame.astype(np.int64), dimension_names=("frame",))
        labels, start = None, 0
        for batch in batches:
            if labels is None:
                size = batch.shape[1:]
                labels = group.create_array(
                    "labels", shape=(len(frame), *size), chunks=(_CHUNK, *size), dtype="uint8",
                    dimension_names=("frame", "y", "x"),
                )  # fmt: skip
            labels[start : start + len(batch)] = batch
            start += len(batch)


def read_class_images(path: Path) -> ClassImages:
    """Open label images; `PredictionsError` says what is wrong with them."""
    try:
        group = zarr.open_group(path, mode="r")
        attrs: dict[str, Any] = dict(group.attrs)
        if attrs.get("format") != FORMAT or attrs.get("version") != VERSION:
            raise PredictionsError(f"{path} holds no label images of version {VERSION}", hint=_DESCRIBED)
        parts = tuple(Part(str(part["name"]), tuple(map(int, part["ids"]))) for part in attrs["parts"])
        labels, frame = group["labels"], np.asarray(group["frame"], np.int64)
        if not isinstance(labels, zarr.Array):
            raise TypeError("labels are no array")
        name, dataset = str(attrs["model"]), attrs.get("dataset")
    except PredictionsError:
        raise
    except Exception as error:  # of zarr, its codecs and types
        raise PredictionsError(f"{path} holds no label images that can be read: {error}", hint=_DESCRIBED) from error
    in_range = all(0 < number < 256 for part in parts for number in part.ids)
    if (
        labels.ndim != 3
        or labels.shape[0] != len(frame)
        or labels.dtype != np.uint8
        or (np.diff(frame) <= 0).any()
        or not in_range
        or math.prod(labels.chunks) > _LARGEST_CHUNK
    ):
        raise PredictionsError(
            f"{path}: {len(frame)} numbers of frames and labels {labels.shape} {labels.dtype} do not fit", hint=_DESCRIBED
        )
    return ClassImages(labels, frame, parts, name, dataset)
