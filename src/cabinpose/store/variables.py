"""The variables of the dataset standard: dimensions, type on disk, meaning, and since which version a dataset has them.

What a source does not know has the missing value of its type: NaN, "" or 0. Names of states are listed here, once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from cabinpose.core import CABINPOSE, OTHER_SKELETONS, Visibility

SCHEMA_VERSION: Final = 2  # of what is written; 1 is read as well
FIRST_OF_WORLD: Final = 64  # classes below it are those of people, but for 0
DEPTH_SCALE_M = 1e-4  # metres in one tick of a stored depth

# Names along the dimensions of what people are and do; they are coordinates of an opened dataset.
AXES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "xyz": ("x", "y", "z"),
        "uv": ("u", "v"),
        "hand": ("left", "right"),
        "eye": ("left", "right"),
        "edge": ("u_min", "v_min", "u_max", "v_max"),
        "bound": ("min", "max"),
        "worn": ("skin", "hair", "beard", "lashes", "top", "bottom", "shoes", "headwear", "glasses", "mask"),
        "body_part": ("head", "chest", "left_foot", "right_foot"),
        "hazard": ("airbag", "wheel", "dashboard"),
    }
)
# States by the variable that has them, "" where nothing is known. Belts are Euro NCAP's misuses beside what is right.
STATES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "sex": ("female", "male"),
        "occupancy": ("empty", "object", "child_seat_empty", "infant", "child_in_child_seat", "child", "adult"),
        "belt": ("correct", "none", "buckle_only", "behind_back", "lap_only", "under_arm", "harness"),
        "child_seat_facing": ("forward", "rearward", "sideways"),
        "attachment": ("isofix", "belt", "none"),
        "stance": ("sitting", "standing", "kneeling", "lying", "crouching"),
        "phone": (
            "none", "ear", "in_hand", "lap", "knee_outboard", "inboard", "wheel", "windscreen", "cluster", "dashboard_outboard",
            "mounted",
        ),
        "alertness": ("awake", "drowsy", "impaired", "microsleep", "asleep", "unresponsive"),
    }
)  # fmt: skip
BELT_OF_1: Mapping[str, str] = MappingProxyType({"worn": "correct"})  # today's names of version 1's, where they differ


@dataclass(frozen=True)
class Variable:
    """One variable of the standard: its dimensions, type on disk and meaning.

    Images are stored one frame a chunk in shards, everything else one chunk a part. since, until: the first and the last version
    of the standard that know it · always: the version from which on every dataset has it, None where a manifest says so; of no
    meaning for images, which a manifest always names.
    """

    name: str
    dims: tuple[str, ...]
    dtype: str  # numpy name, or "str"
    meaning: str
    units: str | None = None
    scale: float | None = None  # stored integer times scale = value, 0 = invalid
    coordinate: bool = False
    default: bool = True  # of an image: whether a manifest has it that names none
    since: int = 1
    until: int = SCHEMA_VERSION
    always: int | None = 1

    @property
    def is_image(self) -> bool:
        return "y" in self.dims

    def named(self, version: int) -> bool:
        """Whether a manifest of a version may name it: it knows it, and not every dataset has it."""
        if not self.since <= version <= self.until:
            return False
        return self.is_image or self.always is None or self.always > version

    @property
    def may_be_left_out(self) -> bool:
        """Whether a frame that is written may lack it, where it is not known: what came with version 2."""
        return not self.is_image and self.always == 2

    def missing(self, shape: tuple[int, ...]) -> Any:
        """The value of a frame that does not know it: NaN, 0, or empty text."""
        if self.dtype == "str":
            return np.full(shape, "", object).tolist()
        return np.full(shape, np.nan if self.dtype.startswith("float") else 0, self.dtype)

    def stored(self, version: int) -> bool:
        """Whether every dataset of a version has it."""
        return self.since <= version <= self.until and not self.named(version)


_IMAGE = ("frame", "y", "x")
_STATES = ", ".join(f"{state.value} {state.name.lower().replace('_', ' ')}" for state in Visibility)


def _depth(name: str, meaning: str, *, default: bool = True) -> Variable:
    return Variable(name, _IMAGE, "uint16", f"depth along the optical axis, {meaning}", "m", DEPTH_SCALE_M, default=default)


def joints_variable(skeleton: str) -> str:
    """The variable that holds the joints of a set: the standard's own, or one for each other set."""
    return "joints_3d" if skeleton == CABINPOSE.name else f"{skeleton}_joints_3d"


def joint_dimension(skeleton: str) -> str:
    """The dimension along which they lie there."""
    return "joint" if skeleton == CABINPOSE.name else f"{skeleton}_joint"


def _of(variable: str) -> str:
    """The states of a variable in words."""
    return ", ".join(STATES[variable])


def _person(name: str, dtype: str, meaning: str, units: str | None = None) -> Variable:
    """Something of each place, which every dataset from version 2 on has."""
    return Variable(name, ("frame", "person"), dtype, meaning, units, coordinate=True, since=2, always=2)


def _state(name: str, meaning: str) -> Variable:
    return _person(name, "str", meaning.format(_of(name)))


def _more(name: str, axis: str, dtype: str, meaning: str, units: str | None = None) -> Variable:
    """Several values of each place, likewise."""
    return Variable(name, ("frame", "person", axis), dtype, meaning, units, since=2, always=2)


VARIABLES: tuple[Variable, ...] = (
    _depth("depth", "as the sensor delivers it"),
    _depth("depth_clean", "of the geometry"),
    _depth("depth_styled", "style-transferred", default=False),
    Variable("amplitude", _IMAGE, "uint16", "amplitude of the active infrared light"),
    Variable("confidence", _IMAGE, "uint8", "the sensor's confidence"),
    Variable("noise", _IMAGE, "uint16", "the sensor's own sigma of its depth, 0 = unknown", "um", default=False),
    Variable("balance", _IMAGE, "uint16", "balance image of Bluetechnix' kits, in the camera's unit", default=False),
    Variable("labels", _IMAGE, "uint8", "class of the pixel"),
    Variable("instance", _IMAGE, "uint8", "0 = nobody, else 1 + position of the person"),
    Variable("rgb", (*_IMAGE, "channel"), "uint8", "colour image, sRGB", default=False),
    Variable("nir", _IMAGE, "uint16", "near-infrared image: electrons by active and ambient light", default=False),
    Variable("joints_3d", ("frame", "person", "joint", "xyz"), "float32", "joints in the camera frame", "m"),
    Variable("joints_2d", ("frame", "person", "joint", "uv"), "float32", "projection of joints_3d", "px"),
    Variable("visibility", ("frame", "person", "joint"), "uint8", f"state of the joint: {_STATES}"),
    *(
        Variable(
            joints_variable(each.name), ("frame", "person", joint_dimension(each.name), "xyz"), "float32",
            f"{each.title}'s joints in the camera frame (OpenCV axes)", "m", always=None,
        )
        for each in OTHER_SKELETONS
    ),
    Variable(
        "head_residual", ("frame", "person"), "float32", "angle between the heads of suit and optical system", "rad",
        always=None,
    ),
    Variable(
        "joint_shift", ("frame", "person", "joint"), "float32", "distance by which depth moved the joint that the suit gave", "m",
        always=None,
    ),
    Variable(
        "gaze", ("frame", "person", "xyz"), "float32", "unit vector of the line of sight, vehicle frame; NaN = none",
        always=2
    ),
    Variable(
        "vehicle_from_head", ("frame", "person", "row", "column"), "float64",
        "head pose: x to the front of the face, y left, origin at C1 (m)", always=2,
    ),
    Variable("camera_k", ("frame", "k_row", "k_column"), "float64", "matrix of intrinsics", "px"),
    Variable("camera_dist", ("frame", "dist_coefficient"), "float64", "distortion k1 k2 p1 p2 k3 (OpenCV)"),
    Variable("vehicle_from_camera", ("frame", "row", "column"), "float64", "extrinsics; translation in metres"),
    Variable("sync_ns", ("frame",), "int64", "time on the common clock", "ns", coordinate=True),
    Variable("sequence", ("frame",), "int64", "sequence that the frame belongs to", coordinate=True),
    Variable("seed", ("frame",), "int64", "seed of the frame's generator, beside the frame's index", coordinate=True),
    Variable("subject", ("frame", "person"), "str", "who it is; empty = nobody in this place", coordinate=True),
    Variable("action", ("frame", "person"), "str", "what the person does; empty = nobody in this place", coordinate=True),
    Variable(
        "things", ("frame", "person"), "str", "what is brought along in this place: child seats and objects, divided by commas",
        coordinate=True, always=2,
    ),
    Variable(
        "belt", ("frame", "person"), "str",
        f"how the seat belt is used: {_of('belt')} (version 1: worn for correct); empty = nobody, or not known",
        coordinate=True, always=2,
    ),
    Variable("child", ("frame", "person"), "uint8", "1 = younger than twelve years", coordinate=True, until=1, always=None),
    Variable("child_seat", ("frame", "person"), "str", "empty, taken; nothing = none", coordinate=True, until=1, always=None),
    Variable(
        "attachment", ("frame", "person"), "str",
        f"what holds the child seat: {_of('attachment')}; empty = there is none, or it is not known",
        coordinate=True, always=2,
    ),
    Variable(
        "gaze_target", ("frame", "person"), "str", "what the line of sight meets first; empty = nobody in this place",
        coordinate=True, always=2,
    ),
    _state("sex", "of the person: {}; empty = nobody, or not known"),
    _person("age", "float32", "since birth", "year"),
    _person("stature", "float32", "standing, without shoes", "m"),
    _person("mass", "float32", "of the body, without clothes", "kg"),
    _person("population", "str", "whose percentiles follow: a population of cabinpose; empty = there is none"),
    _person("stature_percentile", "float32", "share of the population, of this sex and age, who are less tall", "percent"),
    _person("mass_percentile", "float32", "likewise who are lighter", "percent"),
    _state("occupancy", "what is in the place: {}; empty text = not known"),
    _person("child_seat_kind", "str", "infant, toddler, booster, …, a name of things; empty = there is none"),
    _state("child_seat_facing", "which way the child in it looks: {}; empty = there is none, or it is not known"),
    _state("stance", "{}; empty = nobody, or not known"),
    _state("alertness", "{}; empty = nobody, or not known"),
    _person("expression", "str", "neutral, talking, smiling, yawning, …; empty = nobody, or not known"),
    _state("phone", "where the telephone of this person is: {}; empty = nobody, or not known"),
    _person("seat_track", "float32", "how far the seat stands ahead of its design position, along its own forward", "m"),
    _person("seat_height", "float32", "how far it stands above it", "m"),
    _person("seat_recline", "float32", "torso angle of its back from the vertical, + rearward (SAE J1100: A40)", "rad"),
    Variable("wheel_angle", ("frame",), "float32", "how the steering wheel is turned, + left", "rad", coordinate=True, since=2,
             always=2),
    _more("in_hand", "hand", "str", "what the hand holds: steering_wheel, nothing or a name of things; empty = not known"),
    _more("hand_clock", "hand", "float32", "where on the rim of the wheel the hand is, 12 at the top, 3 at the right of who sits"
          " behind it, whatever the wheel's turn", "hour"),
    _more("eyelid_opening", "eye", "float32", "0 closed to 1 open"),
    _more("outfit", "worn", "str", "what is worn there, none, or nothing where it is not known"),
    _more("reflectance", "worn", "float32", "diffuse reflectance there at the wavelength of the active light"),
    _more("box_2d", "edge", "float32", "about the visible pixels of the person; an integer is the middle of a pixel", "px"),
    Variable("box_3d", ("frame", "person", "bound", "xyz"), "float32", "about the dressed person, along the axes of the vehicle",
             "m", since=2, always=2),
    Variable("distance", ("frame", "person", "body_part", "hazard"), "float32", "from the surface of a part of the person to"
             " that of a part of the car", "m", since=2, always=2),
    Variable("car", ("frame",), "str", "the cabin or room", coordinate=True),
    Variable("drive_side", ("frame",), "str", "where the wheel is: left, right; empty = there is none, or it is not known",
             coordinate=True, always=None),
    Variable("pov", ("frame",), "str", "the camera's place", coordinate=True),
    Variable("light", ("frame",), "str", "the light of rgb and nir", coordinate=True, always=None),
    Variable("renderer", ("frame",), "str", "what made rgb and nir", coordinate=True, always=None),
    Variable("style", ("frame",), "str", "the style of depth_styled, or that the depth was left as it was", coordinate=True,
             always=None),
    Variable("style_edge_px", ("frame",), "float32", "styling moved 95 of 100 depth edges at labels' borders no farther", "px",
             always=None),
    Variable("style_part_mm", ("frame",), "float32", "the most that styling moved the mean depth of a part", "mm", always=None),
    Variable("style_lost", ("frame",), "float32", "share of the valid pixels that styling made invalid", always=None),
)  # fmt: skip
VARIABLE = {variable.name: variable for variable in VARIABLES}
OPTIONAL = tuple(v.name for v in VARIABLES if v.named(SCHEMA_VERSION))  # a manifest chooses among these
DEFAULT_VARIABLES = tuple(v.name for v in VARIABLES if v.is_image and v.default)
