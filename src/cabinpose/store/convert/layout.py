"""The layout of somebody's folder of frames: a YAML file that says which files hold what, and how; see `folder`.

Names of files are patterns, relative to the folder: `{field}` stands for one of `FIELDS`, `{field:expression}` for what fits an
expression of `re`, `*` for anything within a name, `**/` for any folders.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from cabinpose.core import CABINPOSE, ITOP, JOINTS, NTU_JOINTS, ConfigError, Distortion, Skeleton, Visibility, unknown_name
from cabinpose.store.convert.depth_images import step_m
from cabinpose.store.schema import LabelRow
from cabinpose.store.yaml_file import read_mapping, validated

HINT = "docs/own-folder.md lists the keys of a layout"
FIELDS = ("subject", "action", "car", "pov", "sequence", "place", "frame")
"""What a name of a file, or a row of a table, may say of a frame; `frame` is a number, `place` is of the people in it."""
_FIELD = r"\{(\w+)(?::((?:[^{}]|\{[^{}]*\})+))?\}"
_PIECES = re.compile(rf"{_FIELD}|(\*\*/)|(\*)|(\?)")
_ORDERS: Mapping[str, tuple[str, ...]] = MappingProxyType({"kinect_v2": NTU_JOINTS, "itop": ITOP.joints})

FieldName = Literal["subject", "action", "car", "pov", "sequence", "place", "frame"]
ImageDim = Literal["frame", "y", "x"]
JointDim = Literal["frame", "person", "joint", "axis"]
Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
StateName = Literal["absent", "outside_image", "occluded", "self_occluded", "visible"]


def _pattern(text: str) -> str:
    path = PurePosixPath(text)
    if path.is_absolute() or ".." in path.parts or not text:
        raise ConfigError(f"{text!r} leads out of the folder", hint="name files relative to the folder that is imported")
    for name, expression in re.findall(_FIELD, text):
        if name not in FIELDS:
            raise unknown_name("field of a name", name, FIELDS)
        try:
            re.compile(expression)
        except re.error as error:
            raise ConfigError(
                f"{text!r}: {expression!r} is no expression: {error}", hint="write {frame}, or {frame:[0-9]+}"
            ) from error
    return text


Pattern = Annotated[str, AfterValidator(_pattern)]


def _unit(value: str | float) -> str | float:
    step_m(str(value))
    return value


Unit = Annotated[str | float, AfterValidator(_unit)]
Row = Annotated[tuple[float, ...], Field(min_length=4, max_length=4)]
Matrix = Annotated[tuple[Row, ...], Field(min_length=3, max_length=4)]


class LayoutKeys(BaseModel):
    """Base of all keys: frozen, unknown ones refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Files(LayoutKeys):
    """Files, and what is read of each."""

    files: Pattern = Field(description="Pattern of their names: {subject}/{frame}.png.")
    variable: str = Field("", description="The array in an NPZ, a MAT or a JSON file, by names between /; NPY has one.")
    first_frame: int = Field(0, description="Number of the first frame in a file of several.")

    @property
    def fields(self) -> tuple[str, ...]:
        """The fields that the pattern has."""
        return tuple(dict.fromkeys(name for name, _ in re.findall(_FIELD, self.files)))

    @cached_property
    def glob(self) -> str:
        """The pattern as `Path.glob` takes it."""
        return re.sub(_FIELD, "*", self.files)

    @cached_property
    def regex(self) -> re.Pattern[str]:
        """The pattern as an expression of the whole relative path, with a group a field; a field that comes again is the same."""
        found, at, seen = "", 0, set()
        for piece in _PIECES.finditer(self.files):
            found += re.escape(self.files[at : piece.start()])
            name, expression, folders, anything, _ = piece.groups()
            if name:
                what = expression or (r"\d+" if name == "frame" else "[^/]+?")
                found += f"(?P={name})" if name in seen else f"(?P<{name}>{what})"
                seen.add(name)
            else:
                found += "(?:.*/)?" if folders else "[^/]*" if anything else "[^/]"
            at = piece.end()
        return re.compile(found + re.escape(self.files[at:]))


class ArrayFiles(Files):
    """Files that may hold arrays of several dimensions."""

    dims: tuple[JointDim | ImageDim, ...] | None

    @property
    def axes_there(self) -> tuple[str, ...]:
        """The dimensions of an array: as the layout says, or the usual ones, with frames where no name tells them."""
        return self.dims or tuple(name for name in self._usual if name != "frame" or "frame" not in self.fields)

    _usual: ClassVar[tuple[str, ...]]


class ImageFiles(ArrayFiles):
    """Images: PNG, TIFF, or arrays of NPY, NPZ or MAT, which may be stacks."""

    _usual = ("frame", "y", "x")
    dims: tuple[ImageDim, ...] | None = Field(
        None, description="Dimensions of an array; left out: y, x, or frame, y, x where no name tells the frame."
    )

    @model_validator(mode="after")
    def _dims(self) -> Self:
        _check_dims(self, ("y", "x"))
        return self


class DepthFiles(ImageFiles):
    """Images of depth; NaN, 0 and the most that an integer can be are invalid."""

    unit: Unit = Field(description="m, cm, mm, or the metres of one step.")
    invalid: tuple[float, ...] = Field((), description="Further values that are no depth.")
    along: Literal["axis", "ray"] = Field("axis", description="axis: z of the camera; ray: the distance from it.")


class AmplitudeFiles(ImageFiles):
    """Images of the active light's amplitude."""

    scale: float = Field(1.0, gt=0, description="Factor on the values, which are rounded and end at 65535.")


class ClassRow(LabelRow):
    """A class of pixels: their value in the files, and what it becomes."""

    value: int = Field(description="Value of its pixels in the files.")


class ClassFiles(ImageFiles):
    """Images of classes."""

    classes: tuple[ClassRow, ...] = Field(min_length=1, description="What each value becomes; ids below 64 are people's parts.")

    @model_validator(mode="after")
    def _apart(self) -> Self:
        told: dict[int, ClassRow] = {}
        values = [row.value for row in self.classes]
        for row in self.classes:
            if values.count(row.value) > 1 or told.setdefault(row.id, row).name != row.name:
                raise ConfigError(
                    f"labels.classes: value {row.value}, id {row.id} are there twice", hint="a value is one class, an id one name"
                )
        return self


class InstanceFiles(ImageFiles):
    """Images of whose pixel it is."""

    people: Mapping[int, str] = Field({}, description="Places by the value of their pixels; left out: 1 the first place, ...")


class RowValues(LayoutKeys):
    """Where a row has its values: columns of CSV, names between / of JSON; {joint} stands for a joint's name."""

    frame: str = Field("", description="Number of the frame.")
    subject: str = Field("", description="Who it is.")
    action: str = Field("", description="What the person does.")
    car: str = Field("", description="The car.")
    pov: str = Field("", description="The camera's place.")
    sequence: str = Field("", description="The sequence.")
    place: str = Field("", description="Place of the person.")
    joint: str = Field("", description="Name of the joint, where a row is one joint.")
    visibility: str = Field("", description="State of a joint.")
    xyz: str = Field("", description="JSON: the numbers of a joint; without {joint} those of all in `order`.")
    x: str = Field("", description="x, or u of pixels.")
    y: str = Field("", description="y, or v of pixels.")
    z: str = Field("", description="z; of pixels the depth, where it is there.")

    @model_validator(mode="after")
    def _numbers(self) -> Self:
        if bool(self.xyz) == bool(self.x and self.y):
            raise ConfigError("values: a joint's numbers are under xyz, or under x and y", hint="give one of the two")
        if not self.joint and self.x and "{joint}" not in self.x:
            raise ConfigError(
                "values: nothing tells whose joint a number is", hint="write {joint} in x, y and z, or name the column `joint`"
            )
        return self


class JointFiles(ArrayFiles):
    """Joints: rows of CSV or JSON (`values`), or arrays of NPY, NPZ, MAT or JSON (`dims`)."""

    _usual = ("frame", "joint", "axis")
    definition: str = Field(
        min_length=1,
        max_length=200,
        description="Whose joints: anatomy, plug_in_gait, kinect_v2, coco, itop, mvn, or words.",
    )
    names: Mapping[str, str | int] = Field({}, description="Our joints by their names there, or positions from 0.")
    order: tuple[str, ...] = Field((), description="Names along the joints of an array.")
    space: Literal["camera", "world", "image"] = Field("camera", description="What positions are in; image: px.")
    unit: Unit = Field("m", description="Of positions, and of a pixel's depth.")
    axes: tuple[Axis, Axis, Axis] = Field(("x", "y", "z"), description="Which of theirs ours are: [x, -y, -z] where y is up.")
    first_pixel: float = Field(0.0, description="Coordinate of the middle of the first pixel: 0, 0.5, or 1 as MATLAB counts.")
    zero_is_missing: bool = Field(False, description="Whether a joint of zeros is one that is not known.")
    dims: tuple[JointDim, ...] | None = Field(
        None, description="Dimensions of an array; left out: joint, axis, before them frame where no name tells the frame."
    )
    rows: str = Field("", description="JSON: the list of rows, by names between /; left out: the file is the list, or one row.")
    values: RowValues | None = Field(None, description="Where a row has its values.")
    visibility: str = Field("", description="Of arrays: the variable that has the states of joints.")
    states: Mapping[str, StateName] = Field({}, description="Our states by what the files say: {0: absent, 2: visible}.")
    lift: bool = Field(False, description="Of pixels without depth: whether visible joints get one of the image.")
    match: tuple[FieldName, ...] | None = Field(None, description="Fields that tie a row to a frame; left out: all of both.")
    may_lack: bool = Field(False, description="Whether frames may have no file of joints: nobody is there.")

    @model_validator(mode="before")
    @classmethod
    def _words(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("states"), dict):  # YAML reads 0 and yes as what they are
            data = data | {"states": {str(key): value for key, value in data["states"].items()}}
        return data

    @model_validator(mode="after")
    def _joints(self) -> Self:
        for name in self.names:
            if name not in self.skeleton.joints:
                raise unknown_name(f"joint of {self.skeleton.title}", name, self.skeleton.joints)
        _check_dims(self, ("joint", "axis"))
        if sorted(axis[-1] for axis in self.axes) != ["x", "y", "z"]:
            raise ConfigError(f"axes: {', '.join(self.axes)} are no axes", hint="each of x, y and z once, with - if turned")
        if self.lift and self.space != "image":
            raise ConfigError("lift: positions in space need none", hint="leave lift out, or say space: image")
        self._heeded()
        return self

    def _heeded(self) -> None:
        """Raise ConfigError for keys that say nothing beside others."""
        rows, image = self.values is not None, self.space == "image"
        stated = self.visibility or (self.values is not None and self.values.visibility)
        for names, heeded, hint in (
            (("variable", "visibility", "first_frame", "dims"), not rows, "rows say by `values` where frames and states stand"),
            (("rows",), rows, "say by `values` where a row has its values"),
            (("states",), bool(stated), "say where states stand: `visibility` of arrays, values.visibility of rows"),
            (("axes",), not image, "pixels have none"),
            (("first_pixel",), image, "positions in space have none; or say space: image"),
        ):
            told = [name for name in names if getattr(self, name) != type(self).model_fields[name].get_default()]
            if told and not heeded:
                raise ConfigError(f"{told[0]}: it says nothing here", hint=hint)

    @property
    def skeleton(self) -> Skeleton:
        """The set that they are of: ITOP's, or ours."""
        return ITOP if self.definition == ITOP.name else CABINPOSE

    @property
    def there(self) -> tuple[str, ...]:
        """Names along the joints of an array, as far as they are known."""
        return self.order or _ORDERS.get(self.definition, ())

    @property
    def called(self) -> Mapping[str, str | int]:
        """What the files call our joints: what the layout says, the definition's table, or as we do."""
        if self.names:
            return self.names
        table = CABINPOSE.maps.get(self.definition)
        if table is None or self.skeleton is ITOP or (self.order and set(self.order) <= set(JOINTS)):
            return {joint: joint for joint in self.skeleton.joints}
        return table


class MatrixFiles(Files):
    """A file that holds the matrix of a camera's place: NPY, NPZ, MAT, JSON, or numbers as text."""


class CameraKeys(LayoutKeys):
    """A camera: numbers, or a calibration's file; and its place, where joints are in a world."""

    file: Pattern | None = Field(None, description="A calibration of OpenCV, ROS, Open3D or RealSense, or numbers by name.")
    fx: float | None = Field(None, gt=0, description="Focal length (px).")
    fy: float | None = Field(None, gt=0, description="Focal length (px).")
    cx: float | None = Field(None, description="Principal point (px); an integer is a pixel's middle.")
    cy: float | None = Field(None, description="Principal point (px).")
    dist: Distortion = Field((0.0, 0.0, 0.0, 0.0, 0.0), description="OpenCV's k1 k2 p1 p2 k3.")
    world_from_camera: Matrix | MatrixFiles | None = Field(None, description="Rows of the matrix (3 or 4 of 4), or its file.")
    camera_from_world: Matrix | MatrixFiles | None = Field(None, description="The other way round.")
    unit: Unit = Field("m", description="Of the matrix' translation.")
    world: Literal["lab", "vehicle"] = Field("lab", description="vehicle: the world is ISO 8855's frame, and the matrix is kept.")

    @model_validator(mode="after")
    def _whole(self) -> Self:
        told = [name for name in ("fx", "fy", "cx", "cy") if getattr(self, name) is not None]
        if (len(told) == 4) == (self.file is not None) or len(told) % 4:
            raise ConfigError("a camera is a file, or fx, fy, cx and cy", hint="give one of the two, the four of them together")
        if self.world_from_camera is not None and self.camera_from_world is not None:
            raise ConfigError("world_from_camera and camera_from_world say the same", hint="give one of them")
        return self


class FolderLayout(LayoutKeys):
    """A layout file."""

    licence: str = Field("unknown", description="Licence of the data.")
    depth: DepthFiles = Field(description="Images of depth: they say what frames there are.")
    amplitude: AmplitudeFiles | None = Field(None, description="Images of amplitude.")
    labels: ClassFiles | None = Field(None, description="Images of classes.")
    instance: InstanceFiles | None = Field(None, description="Images of whose pixel it is.")
    joints: JointFiles | None = Field(None, description="Joints.")
    camera: CameraKeys | None = Field(None, description="The camera; left out: --camera, --intrinsics or --fov-deg.")
    cameras: Mapping[str, CameraKeys] = Field({}, description="Several, by pov.")
    places: tuple[str, ...] = Field(("person_1",), min_length=1, description="Places of people, in their order.")
    fields: Mapping[FieldName, str] = Field({}, description="What holds of all frames: {car: sedan, subject: S01}.")
    call: Mapping[FieldName, Mapping[str, str]] = Field({}, description="Names that change: {action: {a01: drive}}.")
    rate_hz: float | None = Field(None, gt=0, description="Frames a second, by which they get times.")

    @model_validator(mode="after")
    def _ties(self) -> Self:
        if self.camera is not None and self.cameras:
            raise ConfigError("camera and cameras say the same", hint="give one of them")
        known = {*self.frame_fields, *self.fields}
        if self.cameras and "pov" not in known:
            raise ConfigError("cameras: nothing tells a frame's pov", hint="write {pov} in depth.files, or give it in fields")
        if twice := [name for name in self.fields if name in self.depth.fields]:
            raise ConfigError(f"fields.{twice[0]}: depth.files has it", hint="leave it out")
        for key in ("amplitude", "labels", "instance", "joints"):
            files: Files | None = getattr(self, key)
            more = set(files.fields) - known - ({"place"} if key == "joints" else set()) if files is not None else ()
            if more:
                raise ConfigError(
                    f"{key}.files: depth.files has no {{{', '.join(sorted(more))}}} to find them by",
                    hint="use its fields, and * for what else stands in a name",
                )
        places = self.instance.people.values() if self.instance is not None else ()
        for place in places:
            if place not in self.places:
                raise unknown_name("place", place, self.places)
        return self

    @property
    def frame_fields(self) -> tuple[str, ...]:
        """What tells frames apart: the fields of depth, and the number in a stack."""
        return tuple(dict.fromkeys((*self.depth.fields, "frame")))

    @classmethod
    def read(cls, path: Path) -> FolderLayout:
        """The layout of a file. Raises ConfigError that names the file and the key."""
        data = read_mapping(path, hint=HINT)
        try:
            return validated(cls, data, path, hint=HINT)
        except ConfigError as error:
            told = str(error)
            raise ConfigError(told if told.startswith(str(path)) else f"{path}: {told}", hint=error.hint) from error


def _check_dims(files: ArrayFiles, least: tuple[str, ...]) -> None:
    """Raise ConfigError for dimensions that cannot be those of an array."""
    dims = files.axes_there
    if len(set(dims)) < len(dims) or not set(least) <= set(dims) or ("frame" in dims and "frame" in files.fields):
        raise ConfigError(
            f"dims: {', '.join(dims)} are not those of {files.files}",
            hint=f"name {' and '.join(least)} once, and frame where a file has several",
        )


def turned(axes: tuple[Axis, Axis, Axis]) -> NDArray[np.float64]:
    """(3, 3) ours from theirs."""
    matrix = np.zeros((3, 3))
    for row, axis in enumerate(axes):
        matrix[row, "xyz".index(axis[-1])] = -1.0 if axis[0] == "-" else 1.0
    return matrix


def state_of(name: StateName) -> Visibility:
    """The state of a joint by its name in files."""
    return Visibility[name.upper()]
