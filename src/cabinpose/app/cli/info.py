"""`cabinpose info`: what a dataset or a recording holds."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

from cabinpose.app.cli.arguments import is_recording, refuse_selection
from cabinpose.app.cli.commands import Info
from cabinpose.app.cli.output import listed, print_json, print_rows, progress
from cabinpose.app.cli.recording_info import recording_info, takes_of
from cabinpose.core.errors import ConfigError

if TYPE_CHECKING:
    from cabinpose.app.view.summary import DatasetSummary


def run(command: Info) -> None:
    """Print the summary; with `verify`, after every frame was read."""
    if command.subject is not None:
        if (command.dataset / "dataset.yaml").exists():
            raise ConfigError(
                f"{command.dataset} is a dataset, and --subject lists recordings",
                hint=f"count its frames with --select subject={command.subject}",
            )
        refuse_selection(command, "{} is of datasets, and --subject lists recordings")
        takes_of(command.dataset, command.subject, as_json=command.as_json)
    elif is_recording(command.dataset):
        refuse_selection(command, "{} is of datasets, and this is a recording")
        recording_info(command.dataset, as_json=command.as_json)
    else:
        _dataset_info(command)


def _dataset_info(command: Info) -> None:
    from cabinpose.app.cli.selection import selected
    from cabinpose.app.view.summary import summarise
    from cabinpose.store import open_dataset, read_manifest

    manifest = read_manifest(command.dataset)
    dataset = open_dataset(command.dataset, missing="ignore")
    chosen = selected(dataset, command)
    count = chosen.sizes["frame"]
    if command.verify:
        with progress(count, "frames") as report:
            for i in range(count):
                chosen.isel(frame=i).load()
                report(i + 1)
    summary = summarise(dataset, manifest, command.dataset, chosen)
    without = dataset.attrs["parts_without_checksum"]
    if command.as_json:
        checks = {"verified": command.verify, "checksum": manifest.checksum, "parts_without_checksum": without}
        print_json(dataclasses.asdict(summary) | checks)
        return
    print_rows(summary_rows(summary))
    if command.verify:
        print(f"{count} frames were read; all checksums are right")
        if without or manifest.checksum is None:
            where = ["dataset.yaml"] * (manifest.checksum is None) + [f"{without} of {summary.parts} parts"] * bool(without)
            print(f"{' and '.join(where)} were written without a checksum of names and settings: nothing vouches for these")


def summary_rows(summary: DatasetSummary) -> list[tuple[str, str]]:
    """Names and values for people to read."""
    s = summary
    whole = "" if s.parts == s.planned_parts else f" of {s.planned_frames} planned: go on with --resume"
    chosen = "" if s.selected == s.frames else f"; {s.selected} selected, counted below"
    joints = sum(s.visibility.values())
    rows = [
        ("dataset", s.folder),
        ("made by", f"{s.generator}, seed {s.seed}, licence {s.licence}"),
        ("frames", f"{s.frames} in {s.parts} of {s.planned_parts} parts{whole}{chosen}"),
        ("size", f"{s.bytes_on_disk / 1e6:.1f} MB, {s.bytes_on_disk / max(s.frames, 1) / 1e3:.0f} kB a frame"),
        ("image", f"{s.width}x{s.height}, {_valid(s.valid_pixels)}"),
        ("variables", ", ".join(s.variables)),
        ("depth", _quantiles(s.depth_histogram)),
        ("cars", listed(s.by_car, most=12)),
        ("views", listed(s.by_pov)),
        ("people a frame", ", ".join(f"{n} in {_frames(count)}" for n, count in s.by_people.items())),
        ("seats", listed({seat: count for seat, count in s.by_seat.items() if count})),
        ("subjects", listed(s.by_subject, most=12)),
        ("actions", listed(s.by_action, most=12)),
        ("joints", ", ".join(f"{name.replace('_', ' ')} {100 * n / max(joints, 1):.1f} %" for name, n in s.visibility.items())),
    ]
    if s.proposals:  # poses were drawn
        rejected = listed(s.rejections) or "none"
        rows.append(("acceptance", f"{100 * s.acceptance:.1f} % of {s.proposals} poses; rejected: {rejected}"))
    return rows


def _frames(count: int) -> str:
    return "1 frame" if count == 1 else f"{count} frames"


def _valid(share: float) -> str:
    return "no depth" if math.isnan(share) else f"{100 * share:.1f} % of the pixels valid"


def _quantiles(histogram: tuple[float, ...]) -> str:
    """5, 50 and 95 per cent of the depths, as well as bins tell."""
    if not histogram:
        return "no valid pixel"
    import numpy as np

    from cabinpose.app.view.summary import BIN_M

    low, middle, high = np.searchsorted(np.cumsum(histogram), (0.05, 0.5, 0.95)) * BIN_M
    return f"median {middle:.2f} m, 90 % within {low:.2f} m to {high + BIN_M:.2f} m"
