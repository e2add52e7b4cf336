"""A calibration and aligned joints held against the laboratory's truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cabinpose.align import Aligned, Calibration
from cabinpose.app.lab.rig import Source, VirtualRig
from cabinpose.app.lab.takes import Truth
from cabinpose.core import JOINTS, AlignmentError, Matrix, invert

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class CalibrationError:
    """What is wrong with a calibration: found less true.

    camera_mm, camera_deg: of camera_from_world, distance of the two cameras and angle between them · focal_percent: of fx ·
    tof_delay_ms: of the camera against the optical system · head_mm, head_deg: of object_from_head.
    """

    camera_mm: float
    camera_deg: float
    focal_percent: float
    tof_delay_ms: float
    head_mm: float
    head_deg: float


@dataclass(frozen=True)
class JointError:
    """Distances of aligned joints (F, 20) from the true ones, m, and px where these are in the image, else NaN; suit_delay_ms:
    found less true.
    """

    error_m: F64
    error_px: F64
    suit_delay_ms: float

    def by_joint(self) -> dict[str, float]:
        """Mean distance of each joint, cm."""
        return {joint: float(100 * self.error_m[:, j].mean()) for j, joint in enumerate(JOINTS)}

    @property
    def mean_cm(self) -> float:
        """Over all joints and frames."""
        return float(100 * self.error_m.mean())

    @property
    def median_cm(self) -> float:
        """Over all joints and frames."""
        return float(100 * np.median(self.error_m))


def calibration_error(calibration: Calibration, rig: VirtualRig, truth: Truth, subject: str) -> CalibrationError:
    """Hold a calibration against the truth.

    On the host's axis a device's stamps are late by the floor of its latency, so that the delay of two devices is the
    difference of theirs.
    """
    camera = _between(calibration.extrinsics.matrix, rig.camera_from_world)
    head = _between(calibration.head(subject).matrix, truth.object_from_head)
    true_delay = rig.optical.latency_s - rig.tof.latency_s
    return CalibrationError(
        camera_mm=camera[0],
        camera_deg=camera[1],
        focal_percent=100 * (calibration.intrinsics.fx / rig.tof_sensor.camera.fx - 1),
        tof_delay_ms=1000 * (calibration.tof_to_optical.offset_s - true_delay),
        head_mm=head[0],
        head_deg=head[1],
    )


def joint_error(aligned: Aligned, rig: VirtualRig, truth: Truth, *, suit: Source = "suit") -> JointError:
    """Hold aligned joints against the true ones, frame by frame. Raises AlignmentError for frames that are not the truth's."""
    late_ns = round(rig.tof.latency_s * 1e9)
    same = len(aligned.frame_ns) == len(truth.tof_ns)
    if not same or np.abs(aligned.frame_ns - truth.tof_ns - late_ns).max() > 0.5e9 / rig.tof.rate_hz:
        raise AlignmentError("the take is not the one that the truth is of", hint="give the folder as the laboratory wrote it")
    kept = aligned.kept
    true = truth.joints_3d[kept]
    camera = rig.tof_sensor.camera
    reference = aligned.delay.reference_s
    # of the suit's stamps to the optical system's, where the estimate's own drift does not count
    found = float(aligned.delay.to_b(reference) - reference)
    uv = camera.project(true)
    apart = np.linalg.norm(camera.project(aligned.joints[kept]) - uv, axis=2)
    return JointError(
        error_m=np.linalg.norm(aligned.joints[kept] - true, axis=2),
        error_px=np.where(camera.contains(uv), apart, np.nan),
        suit_delay_ms=1000 * (found - (rig.optical.latency_s - rig.clock(suit).settings.latency_s)),
    )


def _between(found: Matrix, true: Matrix) -> tuple[float, float]:
    """Distance of the origins (mm) and angle (deg) between a_from_b found and true, as seen from b."""
    off = invert(found) @ true
    sine = np.linalg.norm([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2
    angle = np.degrees(np.arctan2(sine, (np.trace(off[:3, :3]) - 1) / 2))
    return float(1000 * np.linalg.norm(off[:3, 3])), float(angle)
