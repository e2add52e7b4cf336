"""What the samples of ADTF's streams hold, as a layout file of the user's says it, and their bytes as messages.

ADTF's files carry bytes; a stream's media description, where it has one, says what they are, but not which number is a depth and
which a quaternion. A layout says both, in a media description's terms: stream, field, type, size, unit.
"""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cabinpose.core import LENGTHS_M, RecordingError
from cabinpose.signals import Channels, Message, SegmentPoses, ToFFrame
from cabinpose.store.yaml_file import read_mapping, validated

F64 = NDArray[np.float64]
Gives = Literal["depth", "amplitude", "confidence", "time", "position", "orientation", "channel"]
Type = Literal[
    "tBool", "tInt8", "tUInt8", "tInt16", "tUInt16", "tInt32", "tUInt32", "tInt64", "tUInt64", "tFloat32", "tFloat64",
    "bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64",
]  # fmt: skip

_HINT = "see 'Streams of ADTF' in docs/recording.md"
_TIMES = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}
_FLOAT_UNIT_M = 0.00025  # a step of depths that are told in fractions: up to 16.4 m
_LENGTH, _IMAGES = ("depth", "position"), ("depth", "amplitude", "confidence")
_WIDTH = {"position": 3, "orientation": 4}
_UNIT_NORM = 0.01  # by which the norm of a quaternion may differ from 1
_FARTHEST_M = 1e4  # a position beyond is none
_MOST_BYTES = 1 << 30  # of a sample


class LayoutField(BaseModel):
    """A number or an array in a sample."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    field: str = Field(min_length=1, description="Its name; of channels, what they are called.")
    type: Type = Field(description="Of its numbers, as ADTF or NumPy call it.")
    size: tuple[int, ...] = Field((), description="Of an array: how many, or rows and columns.")
    gives: Gives | None = Field(None, description="What it is; left out: bytes that are passed over.")
    unit: str | float | None = Field(
        None, description="Of lengths m, dm, cm, mm, um, inch, ft or metres a step; of times s, ms, us, ns."
    )
    of: tuple[str, ...] = Field((), description="Of positions and orientations: the segments, in their order.")
    order: Literal["wxyz", "xyzw"] = Field("wxyz", description="Of an orientation's four numbers.")

    @model_validator(mode="before")
    @classmethod
    def _one_is_a_list(cls, data: Any) -> Any:
        """`size: 3` and `of: Head` are lists of one."""
        if not isinstance(data, dict):
            return data
        return data | {key: (data[key],) for key in ("size", "of") if isinstance(data.get(key), (int, str))}

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if any(n < 1 for n in self.size) or math.prod(self.size) > _MOST_BYTES:
            raise ValueError(f"'{self.field}': a size of {list(self.size)}")
        units: Any = LENGTHS_M if self.gives in _LENGTH else _TIMES if self.gives == "time" else None
        if units is not None:
            number = isinstance(self.unit, float) and self.gives in _LENGTH and 0 < self.unit < math.inf
            if self.unit not in units and not number:
                raise ValueError(f"'{self.field}' needs a unit: {', '.join(units)}, not {self.unit}")
        elif self.unit is not None and self.gives is not None and self.gives != "channel":
            raise ValueError(f"'{self.field}': {self.gives} has no unit")
        if self.gives in _IMAGES and len(self.size) != 2:
            raise ValueError(f"'{self.field}' is an image: its size is [rows, columns]")
        if self.gives == "time" and self.size:
            raise ValueError(f"'{self.field}' is a time: one number")
        width = _WIDTH.get(self.gives or "")
        if width is not None:
            sizes = [(len(self.of), width)] + [(width,)] * (len(self.of) == 1)
            if not self.of or len(set(self.of)) < len(self.of) or self.size not in sizes:
                raise ValueError(f"'{self.field}': `of` names each segment once, and the size is [segments, {width}]")
        elif self.of:
            raise ValueError(f"'{self.field}': only positions and orientations are `of` segments")
        return self

    def scale(self) -> float:
        """Metres or nanoseconds of the unit."""
        return self.unit if isinstance(self.unit, float) else {**LENGTHS_M, **_TIMES}[str(self.unit)]


class LayoutCamera(BaseModel):
    """The camera of a stream's images: px of the image as it comes, OpenCV's k1 k2 p1 p2 k3."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    fx: float = Field(gt=0, allow_inf_nan=False)
    fy: float = Field(gt=0, allow_inf_nan=False)
    cx: float = Field(allow_inf_nan=False)
    cy: float = Field(allow_inf_nan=False)
    dist: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


class LayoutStream(BaseModel):
    """A stream: its fields in the order of a sample's bytes, one after the other without gaps."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    stream: str = Field(min_length=1, description="Its name in the file.")
    source: str | None = Field(None, description="The source that it becomes; default: the stream's name.")
    subject: str = Field("", description="Whose poses they are, as the take or the session names them.")
    byte_order: Literal["little", "big"] = "little"
    camera: LayoutCamera | None = Field(None, description="Of its images.")
    fields: tuple[LayoutField, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        names, given = [each.field for each in self.fields], [each.gives for each in self.fields]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"'{self.stream}' has two fields '{name}'")
        for what in ("time", *_IMAGES):
            if sum(each == what for each in given) > 1:
                raise ValueError(f"'{self.stream}' gives {what} twice")
        images = [each.size for each in self.fields if each.gives in _IMAGES]
        if images and ("depth" not in given or self.camera is None or len(set(images)) > 1):
            raise ValueError(f"'{self.stream}' has images: they need a depth, one size and a `camera`")
        for gives in _WIDTH:
            segments = [name for each in self.fields if each.gives == gives for name in each.of]
            if len(set(segments)) < len(segments):
                raise ValueError(f"'{self.stream}' gives the {gives} of a segment twice")
        if set(_WIDTH) & set(given) and not self.subject:
            raise ValueError(f"'{self.stream}' gives poses: it needs a `subject`")
        return self

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """A sample."""
        order = self.byte_order
        return np.dtype([(each.field, np.dtype(_numpy(each.type)).newbyteorder(order), each.size) for each in self.fields])

    def messages(self, data: bytes) -> tuple[int | None, tuple[Message, ...]]:
        """The device's time (ns; None: it has none) and the messages of a sample.

        Raises
        ------
        RecordingError
            Where the sample is not what the layout says.
        """
        if len(data) != self.dtype.itemsize:
            raise RecordingError(
                f"stream '{self.stream}': a sample has {len(data)} bytes, the layout says {self.dtype.itemsize}",
                hint=f"types, sizes and order of its fields have to be the file's; bytes between them are fields, too: {_HINT}",
            )
        row = np.frombuffer(data, self.dtype)[0]
        by = {gives: [each for each in self.fields if each.gives == gives] for gives in ("time", "depth", "channel", *_WIDTH)}
        found: list[Message] = []
        if by["depth"]:
            found.append(self._frame(row))
        if by["position"] or by["orientation"]:
            found.append(self._poses(row, by["position"], by["orientation"]))
        if by["channel"]:
            names = [f"{f.field}[{i}]" if f.size else f.field for f in by["channel"] for i in range(math.prod(f.size))]
            values = np.concatenate([np.asarray(row[f.field], np.float64).ravel() for f in by["channel"]])
            found.append(Channels(tuple(names), values))
        time_ns = None
        for each in by["time"]:
            value = row[each.field]
            if not np.isfinite(value):
                raise RecordingError(f"stream '{self.stream}': '{each.field}' is {value}, no time", hint=_HINT)
            exact = np.issubdtype(value.dtype, np.integer)
            time_ns = int(value) * round(each.scale()) if exact else round(float(value) * each.scale())
        return time_ns, tuple(found)

    def _frame(self, row: Any) -> ToFFrame:
        images, unit_m = {}, _FLOAT_UNIT_M
        for each in self.fields:
            values = row[each.field]
            if each.gives == "depth":
                fractions = not np.issubdtype(values.dtype, np.integer)
                unit_m = _FLOAT_UNIT_M if fractions else each.scale()
                steps = values * (each.scale() / unit_m) if fractions else values
                most = np.iinfo(np.uint16).max
                with np.errstate(invalid="ignore"):  # NaN is no depth either
                    images["depth"] = np.where((steps > 0) & (steps < most + 0.5), np.nan_to_num(steps), 0)
            elif each.gives in _IMAGES:
                most = np.iinfo(np.uint8 if each.gives == "confidence" else np.uint16).max
                images[each.gives] = np.clip(np.nan_to_num(values, posinf=most), 0, most)
        whole = {name: np.rint(image) for name, image in images.items()}
        camera, none = self.camera, np.zeros((0, 0))
        assert camera is not None  # images have one
        k = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float64)
        dist = np.array(camera.dist)
        return ToFFrame(
            whole["depth"].astype(np.uint16), unit_m, whole.get("amplitude", none).astype(np.uint16),
            whole.get("confidence", none).astype(np.uint8), k, dist, dist.copy(),
        )  # fmt: skip

    def _poses(self, row: Any, positions: list[LayoutField], orientations: list[LayoutField]) -> SegmentPoses:
        names = tuple(dict.fromkeys(name for each in (*positions, *orientations) for name in each.of))
        place = {name: index for index, name in enumerate(names)}
        position, orientation = np.full((len(names), 3), np.nan), np.full((len(names), 4), np.nan)
        for each in positions:
            position[[place[name] for name in each.of]] = np.asarray(row[each.field], np.float64) * each.scale()
        for each in orientations:
            q: F64 = np.asarray(row[each.field], np.float64).reshape(-1, 4)
            orientation[[place[name] for name in each.of]] = q if each.order == "wxyz" else np.roll(q, 1, axis=1)
        norm = np.linalg.norm(orientation, axis=1)
        orientation[norm == 0] = np.nan  # a way to say that a segment was not seen
        with np.errstate(invalid="ignore"):
            odd, far = np.abs(norm - 1) > _UNIT_NORM, np.abs(position).max(axis=1) > _FARTHEST_M
        if (odd & (norm > 0)).any() or far.any():
            what = "a position of more than 10 km" if far.any() else f"a quaternion of norm {norm[odd & (norm > 0)][0]:.3g}"
            name = names[int(np.argmax(far if far.any() else odd & (norm > 0)))]
            raise RecordingError(
                f"stream '{self.stream}': {name} has {what}",
                hint="type, unit, order of fields and byte order of the layout are not those of the file",
            )
        return SegmentPoses(self.subject, names, position, orientation / np.linalg.norm(orientation, axis=1, keepdims=True))


class AdtfLayout(BaseModel):
    """What is in a file; streams that it does not name are read by their media description, where they have one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    streams: tuple[LayoutStream, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        names = [each.stream for each in self.streams]
        if len(set(names)) < len(names):
            raise ValueError("a stream is described twice")
        return self

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a layout file (YAML). Raises ConfigError."""
        return validated(cls, read_mapping(path, hint=_HINT), path, hint=_HINT)


def _numpy(kind: str) -> str:
    """NumPy's name of a type of ADTF's: tUInt16 is uint16."""
    return kind[1:].lower() if kind[0] == "t" else kind
