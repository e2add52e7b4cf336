"""What `calibrate` finds and `align` uses, as a YAML file: lens, place and delay of the camera, and each subject's head."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from cabinpose.align.suit import HANDS_M, Triple
from cabinpose.core import AlignmentError, Camera, Matrix, check_camera, is_rigid, write_whole
from cabinpose.store import read_mapping, validated

Row = tuple[float, float, float, float]
Rows = tuple[Row, Row, Row, Row]


def _rigid(rows: Rows) -> Rows:
    if not is_rigid(np.array(rows), atol=1e-5):
        raise ValueError("not a rigid transform: a right-handed rotation and a translation in metres, last row 0 0 0 1")
    return rows


Rigid = Annotated[Rows, AfterValidator(_rigid)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Intrinsics(_Model):
    """The camera's lens."""

    width: Annotated[int, Field(ge=1)]
    height: Annotated[int, Field(ge=1)]
    fx: Annotated[float, Field(gt=0)]
    fy: Annotated[float, Field(gt=0)]
    cx: float
    cy: float
    dist: Annotated[tuple[float, float, float, float, float], Field(description="k1 k2 p1 p2 k3 (OpenCV)")] = (0.0,) * 5
    source: Annotated[str, Field(description="checkerboard, or camera: what the camera says of itself")] = "camera"
    views: Annotated[int, Field(ge=0, description="of the checkerboard")] = 0
    rms_px: Annotated[float | None, Field(description="reprojection error of the views fitted")] = None
    held_out_px: Annotated[float | None, Field(description="reprojection error of views that were held out")] = None

    def model_post_init(self, context: object, /) -> None:
        """Refuses what no lens is."""
        del context
        check_camera(self.camera, "intrinsics")

    @property
    def camera(self) -> Camera:
        """The camera model."""
        return Camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy, self.dist)


class Extrinsics(_Model):
    """Where the camera stands in the optical system's world."""

    camera_from_world: Rigid
    views: Annotated[int, Field(ge=0)] = 0
    rms_m: Annotated[float | None, Field(description="distance between markers seen by both systems")] = None
    held_out_m: Annotated[float | None, Field(description="the same by markers alone, on views that were held out")] = None
    held_out_px: Annotated[float | None, Field(description="of corners in the image, on views that were held out")] = None
    marker_rms_m: Annotated[dict[str, float], Field(description="by marker")] = Field(default_factory=dict)
    sd_m: Annotated[float | None, Field(description="standard deviation of the translation")] = None
    sd_rad: Annotated[float | None, Field(description="standard deviation of the rotation")] = None

    @property
    def matrix(self) -> Matrix:
        """camera_from_world (4, 4)."""
        return np.array(self.camera_from_world)


class KnownDelay(_Model):
    """Stamps of one event: the second source's less the first's, on the host's axis, s."""

    offset_s: float
    interval_s: Annotated[tuple[float, float] | None, Field(description="95 % confidence interval")] = None
    correlation: float | None = None


class PoseCorrection(_Model):
    """What the suit's own calibration got wrong, as `cabinpose.align.posture` finds it."""

    truth: Annotated[Literal["n-pose", "optical"], Field(description="of the pose that was held")]
    shifts_m: Annotated[
        dict[str, Triple], Field(description="what is added to a point's place, in the axes of the segment that carries it, m")
    ]

    def of_points(self, points: Sequence[str]) -> NDArray[np.float64]:
        """(P, 3) m: the shifts of named points; 0 for those that have none."""
        return np.array([self.shifts_m.get(name, (0.0, 0.0, 0.0)) for name in points])


class HeadTracker(_Model):
    """A mobile tracker on the head in place of the optical system: how the two relate, from the head take, which has both."""

    source: Annotated[str, Field(description="of its poses; subject and segment are named as the optical ones")]
    world_from_tracker: Rigid
    body_from_object: Rigid
    tracker_to_optical: Annotated[KnownDelay, Field(description="stamps of the optical system less the tracker's")]
    rms_m: Annotated[float | None, Field(description="distance between what both say of the head object")] = None
    rms_rad: Annotated[float | None, Field(description="and the angle")] = None


class Head(_Model):
    """A subject: where the suit's head segment sits in the optical head object, and what the suit lacks."""

    suit: Annotated[str | None, Field(description="source of this subject's suit; left out: that of `names`")] = None
    head_object: Annotated[str | None, Field(description="the optical subject on this head; left out: that of `names`")] = None
    object_from_head: Rigid
    residual_rad: Annotated[float | None, Field(description="rms angle between the two systems' heads")] = None
    suit_to_optical: Annotated[
        KnownDelay | None, Field(description="stamps of the optical system less the suit's, in the head take")
    ] = None
    offset: Annotated[str, Field(description="measured, or fitted from the turning head")] = "measured"
    hands_m: Annotated[tuple[Triple, Triple], Field(description="finger bases in the left and right hand segment, m")] = HANDS_M
    pose_correction: Annotated[PoseCorrection | None, Field(description="where a pose was recorded")] = None
    tracker: Annotated[
        HeadTracker | None, Field(description="what gives the head in the takes; left out: the optical system")
    ] = None

    @property
    def matrix(self) -> Matrix:
        """object_from_head (4, 4)."""
        return np.array(self.object_from_head)


class Names(_Model):
    """What the sources of the recordings are called, and what they call things."""

    suit: str = "suit"
    optical: str = "optical"
    tof: str = "tof"
    head_object: Annotated[str, Field(description="the optical system's subject on the head")] = "head"
    tracker: Annotated[
        str | None, Field(description="source of a mobile tracker that gives the head in the takes in place of `optical`")
    ] = None
    head_segment: Annotated[str, Field(description="its segment")] = "head"
    board: Annotated[str, Field(description="the optical system's subject of the board's markers")] = "board"
    pendulum: Annotated[str, Field(description="its subject and marker that swings")] = "pendulum"


class Calibration(_Model):
    """A rig's calibration."""

    version: Literal[1] = 1
    names: Names = Field(default_factory=Names)
    intrinsics: Intrinsics
    extrinsics: Extrinsics
    tof_to_optical: Annotated[KnownDelay, Field(description="stamps of the optical system less those of the camera")]
    host: Annotated[dict[str, str], Field(description="the computer that recorded the pendulum, and its network")] = Field(
        default_factory=dict
    )
    camera: Annotated[str, Field(description="vendor, model and serial number, where the camera states them")] = ""
    equipment: Annotated[
        dict[str, str], Field(description="what the takes say of the rig: its name, the station of each suit, the optical system")
    ] = Field(default_factory=dict)
    heads: Annotated[dict[str, Head], Field(description="by subject code")] = Field(default_factory=dict)
    vehicle_from_world: Annotated[Rigid | None, Field(description="where the car stands, if known")] = None

    def head(self, subject: str) -> Head:
        """The head of a subject. Raises AlignmentError for one who was not calibrated."""
        if subject not in self.heads:
            raise AlignmentError(
                f"the calibration knows no subject {subject}",
                hint=f"calibrate with a take of their head turning; known: {', '.join(self.heads) or 'none'}",
            )
        return self.heads[subject]

    def check_camera(self, camera: str) -> str:
        """What speaks against a take by what its camera is called (`camera_identity`); "" = nothing.

        Raises AlignmentError where it is another camera than the calibrated one.
        """
        if self.camera == camera:
            return ""
        if self.camera and camera:
            raise AlignmentError(
                f"the take is of the camera {camera}, the calibration of {self.camera}",
                hint="name the calibration of this rig with --calibration, or calibrate it",
            )
        unknown, known = ("take", self.camera) if self.camera else ("calibration", camera)
        return f"the {unknown} does not say of which camera it is, and that it is {known} cannot be checked"

    def differences(self, host: Mapping[str, str]) -> list[str]:
        """What a take's computer and network (`Recording.head.host`) are other than when the camera's delay was measured."""
        if not host or not self.host:
            return []
        changed = [
            f"{fact}: {self.host.get(fact, 'none')} then, {host.get(fact, 'none')} now"
            for fact in sorted(self.host.keys() | host.keys())
            if self.host.get(fact) != host.get(fact)
        ]
        told = "not recorded as the pendulum was, so that the delays may differ; record the calibration takes again"
        return [f"{told} ({'; '.join(changed)})"] if changed else []

    def suits(self, codes: Iterable[str]) -> dict[str, str]:
        """Source of the suit of each of some subjects, by code; of those who are calibrated."""
        return {code: self.heads[code].suit or self.names.suit for code in codes if code in self.heads}

    def save(self, path: Path) -> None:
        """Write the file; an existing one is replaced as a whole."""
        text = yaml.safe_dump(
            self.model_dump(mode="json", exclude_none=True), sort_keys=False, default_flow_style=None, width=120
        )
        write_whole(path, text)

    @classmethod
    def load(cls, path: Path) -> Calibration:
        """The calibration in a file. Raises AlignmentError where it is none."""
        hint = "`cabinpose calibrate` writes it; docs/alignment.md lists its keys"
        return validated(cls, read_mapping(path, hint=hint, error=AlignmentError), path, hint=hint, error=AlignmentError)


def other_equipment(calibrated: Mapping[str, str], told: Mapping[str, str]) -> list[str]:
    """What a take says of its rig, suits and optical system (`streams.equipment`) that is other than what the calibration knows.

    What either does not know is no difference.
    """
    both = sorted(calibrated.keys() & told.keys())
    changed = [f"{what}: {calibrated[what]} then, {told[what]} now" for what in both if calibrated[what] != told[what]]
    how = "recorded with another rig, suit or optical system than was calibrated, or after a change: name its own calibration"
    return [f"{how} ({'; '.join(changed)})"] if changed else []


def rows(matrix: NDArray[np.float64]) -> Rows:
    """A (4, 4) matrix as plain numbers."""
    return tuple(tuple(float(x) for x in row) for row in matrix)  # type: ignore[return-value]
