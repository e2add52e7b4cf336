"""`cabinpose synth`: generate a dataset and report what it took."""

from __future__ import annotations

import dataclasses
import sys

from cabinpose.app.cli.commands import Synth
from cabinpose.app.cli.output import listed, print_json, print_rows, progress
from cabinpose.core.errors import ConfigError
from cabinpose.store import read_manifest
from cabinpose.store.schema import MANIFEST_NAME
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.generate import Progress, generate
from cabinpose.synth.validate import most_common

_FEW_POSES, _HARDLY_ANY = 100, 0.05  # from so many poses on it is told why so few of them hold


def run(command: Synth) -> None:
    """Generate with a progress bar; the report goes to stdout."""
    if command.workers is not None and command.scheduler is not None:
        raise ConfigError(
            "--workers are threads of this process, --scheduler is a cluster elsewhere",
            hint="give one of --workers and --scheduler",
        )
    config = SynthConfig.load(command.config, command.overrides)
    frames = config.frames_or_all(command.frames)
    with progress(frames, "frames", start=_frames_there(command)) as report:
        told = _FEW_POSES

        def show(state: Progress) -> None:
            nonlocal told
            if state.phase != "posing":
                report.phase(state.phase)
                return
            accepted = state.proposals - sum(state.rejections.values())
            report(state.frames_done, f"{accepted} poses accepted, {state.proposals - accepted} rejected")
            if state.proposals >= told and accepted < _HARDLY_ANY * state.proposals:
                told = 4 * state.proposals
                share = 100.0 * accepted / state.proposals
                print(f"only {share:.1f} % of the poses hold: {most_common(state.rejections, 3)}", file=sys.stderr)

        result = generate(
            config,
            frames,
            command.out,
            seed=command.seed,
            workers=command.workers,
            scheduler=command.scheduler,
            resume=command.resume,
            overwrite=command.overwrite,
            progress=show,
        )
    if command.as_json:
        print_json(dataclasses.asdict(result))
        return
    causes = ", ".join(f"{count} {cause}" for cause, count in sorted(result.rejections.items()) if count) or "none"
    print_rows(
        [
            ("dataset", f"{command.out} ({result.frames_total} frames, {result.frames} made now)"),
            ("speed", f"{result.frames_per_s:.1f} frames/s, {result.seconds:.1f} s"),
            ("acceptance", f"{100 * result.acceptance:.1f} % of {result.proposals} poses; rejected: {causes}"),
            ("ms a frame", ", ".join(f"{name} {ms:.2f}" for name, ms in result.stages_ms.items()) or "nothing was left to make"),
            *((name, listed(counts, most=8)) for name, counts in result.content.items() if counts),
        ]
    )
    print(f"look at it with: cabinpose view {command.out} --out {command.out}-view", file=sys.stderr)


def _frames_there(command: Synth) -> int:
    """Frames that a resumed run finds on disk."""
    if not command.resume or not (command.out / MANIFEST_NAME).exists():
        return 0
    return sum(plan.frames for plan in read_manifest(command.out).parts if (command.out / plan.name).is_dir())
