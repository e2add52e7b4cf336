"""`cabinpose calibrate`: find where a rig's camera stands and how late its stamps are."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from math import degrees, hypot
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import PrintsJson, refuse_inputs
from cabinpose.app.cli.output import print_json, print_rows, printable, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError, check_output

if TYPE_CHECKING:
    from cabinpose.align import Calibrated


@dataclass(frozen=True, kw_only=True)
class Calibrate(PrintsJson):
    """Find the camera's place in a rig, the delay of its time stamps, and how the suit's head relates to the optical system's.

    From recordings of a checkerboard with markers, of a swinging marker, and of each subject's turning head.
    """

    session: Annotated[Positional[Path], arg(metavar="SESSION")]
    """YAML file that names the recordings and the board."""
    out: Path
    """Calibration to write (YAML)."""
    overwrite: bool = False
    """Replace the calibration file."""


COMMAND = Calibrate


def run(command: Calibrate) -> None:
    """Calibrate, write the file, and say how far each step can be trusted."""
    require("record")
    from cabinpose.align import Session, calibrate

    if command.out.exists() and not command.overwrite:
        raise ConfigError(f"{command.out} exists", hint="--overwrite replaces it, or give another file with --out")
    session = Session.load(command.session)
    refuse_inputs("--out", command.out, command.session, *session.recordings)
    check_output(command.out, parents=False)
    with progress() as report:
        report.phase("calibrating")
        found = calibrate(session)
    found.calibration.save(command.out)
    if command.as_json:
        told = {"warnings": found.warnings} if found.warnings else {}
        print_json({"out": str(command.out), **told, **found.calibration.model_dump(mode="json", exclude={"names"})})
        return
    print_rows(_rows(found, command.out))
    rejected = [why for why in found.views.reasons if why]
    if rejected:
        print(f"{len(rejected)} views without a board, the first: {printable(rejected[0])}", file=sys.stderr)
    for warning in found.warnings:
        print(printable(warning), file=sys.stderr)
    print(f"align a take with: cabinpose align TAKE.mcap --calibration {command.out} --out DATASET", file=sys.stderr)


def _rows(found: Calibrated, out: Path) -> list[tuple[str, str]]:
    lens, place, delay = found.calibration.intrinsics, found.calibration.extrinsics, found.calibration.tof_to_optical
    rows = [("calibration", str(out))]
    if found.lens is not None:
        rows.append(
            ("lens", f"fx {lens.fx:.2f} px, {lens.views} views, {lens.rms_px:.3f} px, held-out views {lens.held_out_px:.3f} px")
        )
    else:
        rows.append(("lens", f"fx {lens.fx:.2f} px, as the camera says"))
    by_markers = found.by_markers
    deviation = f"+-{1000 * (place.sd_m or 0):.2f} mm, +-{degrees(place.sd_rad or 0):.3f} deg"
    rows += [
        ("camera's place", f"{place.views} views, {deviation}; held-out views {place.held_out_px or 0:.3f} px"),
        *((f"  {name}", f"{1000 * value:.2f} mm from the board") for name, value in place.marker_rms_m.items()),
        ("  by markers alone", f"{1000 * by_markers.rms_m:.2f} mm, held-out views {1000 * by_markers.held_out_rms_m:.2f} mm"),
        ("camera's delay", _delay(delay.offset_s, delay.interval_s, delay.correlation)),
    ]
    for code, (turn, offset, late) in found.heads.items():
        turned = "/".join(f"{degrees(angle):.0f}" for angle in turn.turned_rad)
        rows.append((f"head of {code}", f"{degrees(turn.rms_rad):.2f} deg between the systems, turned by {turned} deg"))
        rows.append(("  suit's delay", _delay(late.offset_s, late.interval_s, late.correlation)))
        rows.append(("  C1 in the head object", f"{', '.join(f'{1000 * x:.0f}' for x in offset.offset)} mm, {offset.method}"))
        if (tracker := found.calibration.heads[code].tracker) is not None:
            told = f"{1000 * (tracker.rms_m or 0):.1f} mm, {degrees(tracker.rms_rad or 0):.2f} deg from the optical system"
            rows.append((f"  {tracker.source}", told))
        if (pose := found.calibration.heads[code].pose_correction) is not None:
            size = {name: 1000 * hypot(*shift) for name, shift in pose.shifts_m.items()}
            worst = max(size, key=size.__getitem__)
            rows.append(("  initial pose", f"by {pose.truth}: points moved by up to {size[worst]:.0f} mm ({worst})"))
    return rows


def _delay(offset_s: float, interval_s: tuple[float, float] | None, correlation: float | None) -> str:
    told = f"{1000 * offset_s:+.2f} ms"
    if interval_s is not None:
        told += f" ({1000 * interval_s[0]:+.2f} to {1000 * interval_s[1]:+.2f})"
    return told if correlation is None else f"{told}, r = {correlation:.4f}"
