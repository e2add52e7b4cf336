"""Seconds that a `kill -9` costs: of work that is done again, or of samples and labels that nothing brings back.

    python tests/faults/lost.py             # all
    python tests/faults/lost.py synth train

prints a table. A command is killed at some of its calls and run again: what both runs take beyond one that is left alone is lost.
Seconds are of processor time, which what else the machine does hardly changes; of recordings they are of the samples' clock.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import outputs
from outputs import KILL, NOTHING, Command, preloaded, start, tell

COMMANDS: Mapping[str, Command] = {  # of a size at which the work is more than the start
    "synth": Command("synth scene.cars=[sedan] --frames 200 --workers 1 --out {out}/d", "d", "--resume"),
    "train": Command(
        "train {inputs}/other --splits {inputs}/splits.yaml --config {inputs}/long.yaml --devices 1 --out {out}/t",
        "t", "--resume",
    ),
    "lab": outputs.COMMANDS["lab"],
    "import": outputs.COMMANDS["import-itop"],
    "export": Command("export coco {inputs}/other --out {out}/e", "e"),
    "predict": Command("predict {inputs}/other --model {inputs}/m.onnx --out {out}/p.jsonl", "p.jsonl"),
}  # fmt: skip
LABELS = 20


def seconds(words: str, under: Path, fault: int = NOTHING, at: int = 0) -> float:
    """Processor time that a command takes until it ends, or is killed at a call."""
    with TemporaryDirectory() as folder:
        said = Path(folder) / "said"
        _, status, used = os.wait4(start(words, under, fault, at, said), 0)
        if os.waitstatus_to_exitcode(status) not in (0, outputs.CODES[fault] if fault else 0):
            raise SystemExit(f"{words}: {said.read_text()}")
    return used.ru_utime + used.ru_stime


def lost_work(command: Command, inputs: Path, work: Path) -> tuple[float, float]:
    """Seconds of a run, and the most that a kill has cost."""
    out = work / "out"
    words, place = command.words.format(inputs=inputs, out=out), out / command.out

    def run(more: str = "", fault: int = NOTHING, at: int = 0) -> float:
        return seconds(f"{words} {more}", out, fault, at)

    def fresh() -> None:
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()

    fresh()
    whole, calls, costs = run(), outputs.SHIM.count.value, []
    for at in (calls // 2, calls - 9, calls - 5):
        fresh()
        spent = run(fault=KILL, at=at)
        if place.exists() and command.again is None:
            shutil.rmtree(place)  # it refuses to go on there
        again = run(command.again or "" if place.exists() else "")
        # Neither does more than a run that is left alone: what it takes beyond that is the machine's, not the kill's.
        costs.append(min(spent, whole) + min(again, whole) - whole)
    return whole, max(costs)


def lost_labels(work: Path) -> tuple[int, int]:
    """Changes of labels that were answered when their process was killed, over all kills, and those that are not there."""
    from cabinpose.core import Visibility
    from cabinpose.store import Labels
    from cabinpose.store.labels import JointLabel, read_labels

    path, answered, lost = work / "labels.jsonl", 0, 0
    for at in range(1, 2 * LABELS):
        path.unlink(missing_ok=True)
        ours, theirs = os.pipe()
        if not (child := os.fork()):
            outputs.SHIM.count.value = 0
            outputs.SHIM.arm(work, KILL, at)
            labels = Labels(path, "id", ("driver",), ("head",))
            for n in range(LABELS):
                label = JointLabel((n, n), (0, 0, 1), Visibility.VISIBLE)
                labels.set([((n, "driver", "head"), label)], role="annotator", how="placed")
                os.write(theirs, b".")
            os._exit(0)
        os.close(theirs)
        told = len(os.fdopen(ours, "rb").read())
        os.waitpid(child, 0)
        kept = read_labels(path)[1] if path.exists() and b"\n" in path.read_bytes() else {}
        answered, lost = answered + told, lost + len(set(range(told)) - {frame for frame, _, _ in kept})
    return answered, lost


def lost_samples(work: Path, kills: int) -> tuple[float, float]:
    """Seconds of a recording before it was killed at most, and the most of these that `recover` does not bring back."""
    from test_crash import check_killed

    after = np.random.default_rng(1).uniform(1.5, 3.5, kills)
    costs = []
    for index, after_s in enumerate(after):
        folder = work / str(index)
        folder.mkdir()
        costs.append(check_killed(folder, float(after_s), {})[0])
    return float(after.max()), max(costs)


def main() -> None:
    """Measure, and print a table. What is promised is counted, in frames, epochs, samples and labels, by the rooms' tests."""
    outputs.SHIM = outputs.Shim()
    outputs.load_all()
    names = sys.argv[1:]

    def row(name: str, measure: Callable[[], tuple[float, float]], unit: str) -> None:
        if not names or name in names:
            whole, lost = measure()
            tell(name, f"{whole:.3g} {unit}", f"{lost:.2g} {unit}")

    with TemporaryDirectory() as temporary:
        inputs, work = Path(temporary) / "inputs", Path(temporary) / "work"
        outputs.make_inputs(inputs, session=False)
        (inputs / "long.yaml").write_text((inputs / "run.yaml").read_text().replace("epochs: 2", "epochs: 4"))
        work.mkdir()
        tell("", "of", "lost")
        for name, command in COMMANDS.items():
            row(name, lambda c=command: lost_work(c, inputs, work), "s")  # type: ignore[misc]
        row("record", lambda: lost_samples(work, 8), "s")
        row("labels", lambda: lost_labels(work), "changes")


if __name__ == "__main__":
    if "CABINPOSE_SHIM" in os.environ:
        main()
    else:
        sys.exit(preloaded(sys.argv[1:], captured=False, script=__file__).returncode)
