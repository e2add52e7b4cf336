"""`cabinpose synth`: generate a dataset of people in cars, or of one person in a room."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from cabinpose.app.cli.arguments import Maybe, PrintsJson, several, workers_of
from cabinpose.app.cli.output import listed, print_json, print_rows, progress
from cabinpose.core import ConfigError

if TYPE_CHECKING:
    from cabinpose.synth import Existing, Progress

_FEW_POSES, _HARDLY_ANY = 100, 0.05  # after so many poses, an acceptance below this is explained on stderr


@dataclass(frozen=True, kw_only=True)
class Synth(PrintsJson):
    """Generate a dataset: people in cars, or one person in a room, seen by a Time-of-Flight camera.

    The same configuration and seed give the same bytes, with any number of workers.
    """

    out: Path
    """Folder of the dataset."""
    frames: Maybe[int] = None
    """Number of frames; default: all combinations, if the configuration has a finite number of them."""
    overrides: Annotated[Positional[tuple[str, ...]], several("[KEY=VALUE ...]")] = ()
    """Changes to the configuration, such as scene.cars=[suv] or camera.sensor=evk75123; its file may stand among them."""
    config: Maybe[Path] = None
    """Configuration (YAML), as `cabinpose config init` writes it; default: people in all seven cars."""
    style: Maybe[Path] = None
    """Model of a camera's look (.onnx of `cabinpose train-style`) or a style frame (.npz): adds depth_styled."""
    workers: Maybe[int] = None
    """Threads; default: one per core."""
    scheduler: Maybe[str] = None
    """Address of a running Dask cluster that makes the parts; exclusive with --workers."""
    seed: int = 0
    """Seed of all random numbers."""
    resume: bool = False
    """Continue an interrupted run of the same configuration."""
    overwrite: bool = False
    """Replace the dataset in the folder."""


COMMAND = Synth


def run(command: Synth) -> None:
    """Generate with a progress bar, then report speed, acceptance and content."""
    from cabinpose.synth import SynthConfig, generate

    workers = workers_of(command.workers, command.scheduler, "threads of this process")
    if command.resume and command.overwrite:
        raise ConfigError("a dataset is either resumed or overwritten", hint="give one of --resume and --overwrite")
    styled = () if command.style is None else (f"style.by={json.dumps(str(command.style.resolve()))}",)
    file, changes = _file_and_changes(command)
    config = SynthConfig.load(file, (*changes, *styled))
    frames = config.frames_or_all(command.frames)
    if config.camera.taken:
        print(f"camera.sensor: not given, taken as in a Pico Monstar with even light: {config.camera.taken}", file=sys.stderr)
    judged = "poses" if config.scene.sequence is None else "poses and ways"
    with progress(frames, "frames", start=_frames_there(command)) as report:
        warn_at = _FEW_POSES

        def show(state: Progress) -> None:
            nonlocal warn_at
            if state.phase != "posing":
                report.phase(state.phase)
                return
            accepted = state.judged - sum(state.rejections.values())
            report(state.frames_done, f"{accepted} {judged} accepted, {state.judged - accepted} rejected")
            if state.judged >= warn_at and accepted < _HARDLY_ANY * state.judged:
                warn_at = 4 * state.judged
                _warn_of_rejections(state, accepted)

        existing: Existing = "resume" if command.resume else "overwrite" if command.overwrite else "refuse"
        result = generate(config, frames, command.out, seed=command.seed, workers=workers, existing=existing, progress=show)
    if command.as_json:
        print_json(dataclasses.asdict(result))
        return
    causes = ", ".join(f"{count} {cause}" for cause, count in sorted(result.rejections.items()) if count) or "none"
    print_rows(
        [
            ("dataset", f"{command.out} ({result.frames_total} frames, {result.frames} made now)"),
            ("speed", f"{result.frames_per_s:.1f} frames/s, {result.seconds:.1f} s"),
            ("acceptance", f"{100 * result.acceptance:.1f} % of {result.judged} {judged}; rejected: {causes}"),
            ("ms a frame", ", ".join(f"{name} {ms:.2f}" for name, ms in result.stages_ms.items()) or "nothing was left to make"),
            *((name, listed(counts, most=8)) for name, counts in result.content.items() if counts),
            *([("styling moved", _shift(result.label_shift))] if result.label_shift else ()),
        ]
    )
    print(f"look at it with: cabinpose view {command.out} --out {command.out}-view", file=sys.stderr)


def _file_and_changes(command: Synth) -> tuple[Path | None, list[str]]:
    """The file of the configuration, which may stand without its flag, and the changes to it."""
    files = [Path(word) for word in command.overrides if "=" not in word and word.endswith((".yaml", ".yml"))]
    if len(files) + (command.config is not None) > 1:
        raise ConfigError("a dataset has one configuration", hint="give one file; KEY=VALUE changes what it says")
    changes = [word for word in command.overrides if Path(word) not in files]
    return next(iter(files), command.config), changes


def _shift(moved: Mapping[str, float]) -> str:
    return f"edges at labels' borders by {moved['edge_px']:.2f} px at most, mean depths of parts by {moved['part_mm']:.2f} mm"


def _warn_of_rejections(state: Progress, accepted: int) -> None:
    from cabinpose.synth import most_common

    causes = most_common(state.rejections, 3)
    print(f"only {100.0 * accepted / state.judged:.1f} % of the poses hold: {causes}", file=sys.stderr)


def _frames_there(command: Synth) -> int:
    """Frames that a resumed run finds on disk."""
    from cabinpose.store import MANIFEST_NAME, read_manifest

    if not command.resume or not (command.out / MANIFEST_NAME).exists():
        return 0
    return sum(plan.frames for plan in read_manifest(command.out).parts_in(command.out))
