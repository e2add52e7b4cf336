"""What differs between the user's frames and those that a model was trained for, row by row, with what it means in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cabinpose.app.adapt.facts import CameraFacts
from cabinpose.app.adapt.pseudo_labels import is_found
from cabinpose.core import Bools as Mask
from cabinpose.core import Camera
from cabinpose.estimate import BRIGHTER, FAINTER, USUAL_LIGHT, JointPredictor, usual_errors
from cabinpose.store import Predictions

_NEARER, _FARTHER = 0.6, 1.6  # median depth over the reference's, beyond which people are in another place
_HOLES = 0.15  # more pixels without a depth
_NOISIER = 2.0  # times the noise between neighbours
NOBODY = 0.1  # share of the frames without anybody
UNSURE = 1.5  # times the expected error of the frames that the model was calibrated on


class Row(NamedTuple):
    """A line of the table: what it is, of the user's frames, of the reference, and what it means; "" where nothing stands out."""

    what: str
    theirs: str
    reference: str
    note: str


@dataclass(frozen=True)
class AnswerFacts:
    """How a model answers on frames. nobody: share of them in which nobody is found · joints: found of a person on average ·
    error_m: median expected error of the joints found, m, NaN where it is not known · usual_m: the same where it was calibrated.
    """

    nobody: float
    joints: float
    error_m: float
    usual_m: float


def answers_of(found: Predictions, model: JointPredictor) -> AnswerFacts:
    """How a model answers, in numbers."""
    there = is_found(found)
    people: Mask = np.any(there, axis=2)
    expected = found.expected_error_m[there & np.isfinite(found.expected_error_m)]
    usual = usual_errors(model.model.expected_error, model.joints)
    return AnswerFacts(
        1 - float(people.any(axis=1).mean()),
        float(there.sum(axis=2)[people].mean()) if people.any() else 0.0,
        float(np.median(expected)) if expected.size else math.nan,
        float(np.nanmedian(usual)) if np.isfinite(usual).any() else math.nan,
    )


def differences(model: JointPredictor, theirs: CameraFacts, reference: CameraFacts | None, answers: AnswerFacts) -> list[Row]:
    """The rows of the table; reference: None where nothing is known of what the model was trained for."""
    view = model.config.view
    rows = [_camera(theirs, reference, view.shown(theirs.camera), "; ".join(view.doubts(theirs.camera)))]
    rows += _depths(theirs, reference, view.max_depth_m)
    rows += _noise(theirs, reference)
    if "amplitude" in model.images:
        rows.append(_light(theirs.light))
    few = f"nobody is found in {_percent(answers.nobody)} of the frames" if answers.nobody > NOBODY else ""
    rows.append(Row("frames in which nobody is found", _percent(answers.nobody), "", few))
    rows.append(Row("joints found of a person", f"{answers.joints:.1f} of {len(model.joints)}", "", ""))
    if math.isfinite(answers.error_m):
        share = answers.error_m / answers.usual_m
        note = f"{share:.1f} times as much as on the frames it was calibrated on" if share > UNSURE else ""
        rows.append(Row("expected error, median", f"{100 * answers.error_m:.1f} cm", f"{100 * answers.usual_m:.1f} cm", note))
    return rows


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _number(value: float, form: str, factor: float = 1.0) -> str:
    return f"{factor * value:{form}}" if math.isfinite(value) else "–"


def fields_deg(camera: Camera) -> tuple[float, float]:
    """The field of view of a camera's middle row and column, degrees, with distortion; NaN where there is no ray."""
    u, v = (camera.width - 0.5, camera.height - 0.5)
    ends = np.array([(-0.5, camera.cy), (u, camera.cy), (camera.cx, -0.5), (camera.cx, v)])
    xy = camera.undistort((ends - (camera.cx, camera.cy)) / (camera.fx, camera.fy))
    angles = np.degrees(np.arctan(xy))
    return float(angles[1, 0] - angles[0, 0]), float(angles[3, 1] - angles[2, 1])


def _camera(theirs: CameraFacts, reference: CameraFacts | None, shown: float, doubts: str) -> Row:
    def words(facts: CameraFacts) -> str:
        across, down = fields_deg(facts.camera)
        return f"{facts.camera.width} × {facts.camera.height} px, {across:.0f}° × {down:.0f}°"

    cut = f"{_percent(1 - shown)} of the image lie outside of the model's view" if shown < 1 - _HOLES else ""
    told = "; ".join(filter(None, (doubts, cut if not doubts else "")))
    return Row("camera", words(theirs), words(reference) if reference else "–", told)


def _depths(theirs: CameraFacts, reference: CameraFacts | None, farthest_m: float) -> list[Row]:
    def span(facts: CameraFacts) -> str:
        return f"{facts.depth_m[1]:.2f} ({facts.depth_m[0]:.2f} to {facts.depth_m[2]:.2f})"

    share = theirs.depth_m[1] / reference.depth_m[1] if reference else 1.0
    note = f"everything is {share:.1f} times as far" if share > _FARTHER else ""
    note = f"everything is {1 / share:.1f} times as near" if share < _NEARER else note
    if theirs.depth_m[1] > farthest_m:
        note = f"half of what is seen lies beyond the {farthest_m:g} m that the model looks"
    more = theirs.invalid - (reference.invalid if reference else theirs.invalid)
    holes = f"{_percent(more)} more of the pixels have none" if more > _HOLES else ""
    return [
        Row("depth: median (5 to 95 %), m", span(theirs), span(reference) if reference else "–", note),
        Row("pixels without a depth", _percent(theirs.invalid), _percent(reference.invalid) if reference else "–", holes),
    ]


def _noise(theirs: CameraFacts, reference: CameraFacts | None) -> list[Row]:
    ratio = theirs.noise_m / reference.noise_m if reference else 1.0
    noisy = f"{ratio:.1f} times the noise" if ratio > _NOISIER else ""
    smooth = "smoothed: the camera filters over pixels" if ratio < 1 / _NOISIER else ""
    edges = theirs.mixed / reference.mixed if reference else 1.0
    cut = "the camera takes mixed pixels out" if edges < 1 / _NOISIER else "more mixed pixels" if edges > _NOISIER else ""
    still = theirs.still_m
    over = (
        "–"
        if not len(still)
        else f"{1e3 * still[0, 1]:.1f} at {still[0, 0]:.2f} m, {1e3 * still[-1, 1]:.1f} at {still[-1, 0]:.2f} m"
    )
    unknown = "" if len(still) else "no rows of frames in which something stands still"
    return [
        Row(
            "noise between neighbours, mm", _number(theirs.noise_m, ".1f", 1e3),
            _number(reference.noise_m, ".1f", 1e3) if reference else "–", noisy or smooth,
        ),
        Row("noise over time, mm", over, "–", unknown),
        Row(
            "mixed pixels to a px of silhouette", _number(theirs.mixed, ".2f"),
            _number(reference.mixed, ".2f") if reference else "–", cut,
        ),
    ]  # fmt: skip


def _light(light: float) -> Row:
    note = "the model wants amplitudes, and there are none" if not math.isfinite(light) else ""
    if light > BRIGHTER * USUAL_LIGHT or light < USUAL_LIGHT / FAINTER:
        note = f"joints will be far off: scale the amplitudes by {USUAL_LIGHT / light:.2g}"
    return Row("amplitude × depth², median", _number(light, ".0f"), f"{USUAL_LIGHT:.0f}", note)
