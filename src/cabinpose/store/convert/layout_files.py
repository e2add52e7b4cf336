"""The files that a layout names: which there are, by the fields of their names, and the arrays and matrices in them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import DatasetError
from cabinpose.store.convert.apart import items_apart
from cabinpose.store.convert.depth_images import natural_order, npy_array
from cabinpose.store.convert.layout import ArrayFiles, Files, ImageFiles
from cabinpose.store.convert.reading import read_image, read_json

Key = Mapping[str, str | int]
"""Fields of a frame or of a file; `frame` is a number."""
_PICTURES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
_ARRAYS = (".npy", ".npz", ".mat", ".json")


class FoundFile(NamedTuple):
    """A file, and the fields of its name."""

    key: Key
    path: Path


def as_number(text: Any) -> int:
    """The number of a frame, of a name or a table. Raises ValueError for what is none."""
    number = float(text)
    if number != int(number):
        raise ValueError(f"{text!r} is no number of a frame")
    return int(number)


def told(key: Key) -> str:
    """Fields in words."""
    return ", ".join(f"{name} {value}" for name, value in key.items()) or "all frames"


def find(root: Path, files: Files, what: str) -> list[FoundFile]:
    """The files of a pattern, in the order of their names. Raises DatasetError where there are none."""
    found = []
    for path in sorted(root.glob(files.glob), key=lambda path: natural_order(path.relative_to(root).as_posix())):
        match = files.regex.fullmatch(path.relative_to(root).as_posix())
        if match is not None and path.is_file():
            key = {name: int(value) if name == "frame" else value for name, value in match.groupdict().items()}
            found.append(FoundFile(key, path))
    if not found:
        raise DatasetError(
            f"{root} has no file {files.files}", hint=f"{what}.files of the layout is relative to that folder; look what it holds"
        )
    return found


class Finder:
    """Finds the file of a frame by the fields of its name."""

    def __init__(self, root: Path, files: Files, what: str, *, several: str = "") -> None:
        """several: a field by which a frame may have several files. Raises DatasetError for none, and for two of one frame."""
        self._files, self._root, self._by = files, root, tuple(name for name in files.fields if name != several)
        self._found: dict[tuple[str | int, ...], list[FoundFile]] = {}
        for each in find(root, files, what):
            others = self._found.setdefault(tuple(each.key[name] for name in self._by), [])
            if others and not (several and several in files.fields):
                raise DatasetError(
                    f"{others[0].path} and {each.path} are both of {told(each.key)}",
                    hint=f"tell them apart in {what}.files by one of its fields",
                )
            others.append(each)

    def of(self, key: Key) -> list[FoundFile]:
        """The files of a frame; none where there are none."""
        return self._found.get(tuple(key[name] for name in self._by), [])

    def one(self, key: Key) -> Path:
        """The file of a frame. Raises DatasetError where there is none."""
        if not (found := self.of(key)):
            raise DatasetError(
                f"{self._root} has no file {self._files.files} of {told({name: key[name] for name in self._by})}",
                hint="every frame that depth.files finds has to have one; copy what is missing, or take its depth away",
            )
        return found[0].path


def stacked(files: ImageFiles, path: Path) -> range | None:
    """The numbers of the frames in a file; None where it is one image."""
    if path.suffix.lower() in _PICTURES or "frame" not in files.axes_there:
        return None
    shape = _shaped(array(path, files.variable), files, path).shape
    return range(files.first_frame, files.first_frame + shape[files.axes_there.index("frame")])


def pixels(files: ImageFiles, path: Path, frame: int) -> NDArray[Any]:
    """(H, W) the image of a frame in a file. Raises DatasetError for a file without it."""
    if path.suffix.lower() in _PICTURES:
        image = read_image(path, floats=True)
        if image.ndim == 3 and (image == image[..., :1]).all():  # saved as grey in colours
            image = image[..., 0]
        if image.ndim != 2:
            raise DatasetError(f"{path} is in colours", hint="a layout's images have one number a pixel")
        return image
    return of_frame(array(path, files.variable), files, ("y", "x"), path, frame)


def of_frame(values: NDArray[Any], files: ArrayFiles, wanted: Sequence[str], path: Path, frame: int) -> NDArray[Any]:
    """What an array has of a frame, with the dimensions `wanted`; those that it lacks are of 1. Raises DatasetError."""
    values, dims = _shaped(values, files, path), list(files.axes_there)
    if "frame" in dims:
        at, count = frame - files.first_frame, values.shape[dims.index("frame")]
        if not 0 <= at < count:
            raise DatasetError(
                f"{path} has {count} frames, and not number {frame}",
                hint=f"`first_frame` says the number of the first one, now {files.first_frame}",
            )
        values = np.take(values, at, axis=dims.index("frame"))
        dims.remove("frame")
    values = np.transpose(values, [dims.index(name) for name in wanted if name in dims])
    return np.expand_dims(values, [n for n, name in enumerate(wanted) if name not in dims])


def _shaped(values: NDArray[Any], files: ArrayFiles, path: Path) -> NDArray[Any]:
    dims = files.axes_there
    if path.suffix.lower() == ".mat" and values.ndim < len(dims):  # MATLAB drops the last dimensions where they are 1
        values = values.reshape(values.shape + (1,) * (len(dims) - values.ndim))
    if values.ndim != len(dims):
        raise DatasetError(
            f"{path} has the shape {values.shape}", hint=f"say in `dims` what that is; it is taken to be {', '.join(dims)}"
        )
    return values


def array(path: Path, variable: str) -> NDArray[Any]:
    """The numbers of an NPY, NPZ, MAT or JSON file. Raises DatasetError."""
    return _array(path, variable, path.stat().st_mtime_ns)


@lru_cache(maxsize=8)  # frames of one file follow each other
def _array(path: Path, variable: str, _changed_ns: int) -> NDArray[Any]:
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return npy_array(path, most_dims=4)
    if suffix not in _ARRAYS:
        raise DatasetError(f"{path} is none of {', '.join((*_PICTURES, *_ARRAYS))}", hint="name other files in the layout")
    values = np.asarray(_variable(path, variable))
    if values.dtype.kind not in "uifb" or not 0 < values.ndim <= 4 or 0 in values.shape:
        raise DatasetError(
            f"{path}: {variable or 'it'} holds {values.dtype} of the shape {values.shape}",
            hint="`variable` of the layout names an array of numbers, within others by /",
        )
    return values


def _variable(path: Path, variable: str) -> Any:
    """What a file has under names between /."""
    data: Any = read_json(path) if path.suffix.lower() == ".json" else _loaded(path)
    if not variable and isinstance(data, dict) and len(data) == 1:
        return next(iter(data.values()))
    try:
        return within(data, variable)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        known = ", ".join(map(str, data)) if isinstance(data, dict) else "a list"
        raise DatasetError(f"{path} has no variable '{variable}'", hint=f"it has: {known[:300]}") from error


def within(data: Any, names: str) -> Any:
    """What plain data has under names between /, in lists by position. Raises KeyError, IndexError, TypeError or ValueError."""
    for name in names.split("/") if names else ():
        data = data[int(name)] if isinstance(data, list) else data[name]
        if isinstance(data, np.ndarray) and data.size == 1 and data.dtype.kind in "OV":  # a struct of MATLAB
            data = data.ravel()[0]
    return data


def _loaded(path: Path) -> dict[str, Any]:
    """The variables of an NPZ or a MAT file."""
    try:
        if path.suffix.lower() == ".npz":
            with np.load(path, allow_pickle=False) as file:
                return {name: file[name] for name in file.files}
        return dict(items_apart(_of_mat, path))  # scipy's reader may crash on a damaged file
    except DatasetError:
        raise
    except Exception as error:  # damaged files fail in every way there is
        raise DatasetError(f"{path} is no whole file: {error}", hint="it may be cut short; copy it again") from error


def _of_mat(path: Path) -> Iterator[tuple[str, Any]]:
    """The variables of a MAT file, of its versions before 7.3."""
    from scipy.io import loadmat  # noqa: PLC0415 - for those who have such files

    try:
        yield from ((name, value) for name, value in loadmat(path).items() if not name.startswith("__"))
    except NotImplementedError as error:  # scipy's word for version 7.3
        raise DatasetError(f"{path} is a MAT file of version 7.3", hint="save it with -v7 in MATLAB") from error


def matrix(path: Path, variable: str) -> NDArray[np.float64]:
    """(3 or 4, 4) a matrix of a file, of numbers as text as well. Raises DatasetError."""
    if path.suffix.lower() in _ARRAYS:
        values = np.asarray(array(path, variable), np.float64)
    else:
        try:
            values = np.loadtxt(path, delimiter="," if "," in path.read_text(encoding="utf-8", errors="replace") else None)
        except (OSError, ValueError) as error:
            raise DatasetError(
                f"{path} holds no matrix: {error}", hint="write its rows, numbers between blanks or commas"
            ) from error
    if values.shape not in ((3, 4), (4, 4)):
        raise DatasetError(f"{path} holds a matrix of the shape {values.shape}", hint="its rows are R and t: 3 or 4 of 4")
    return values
