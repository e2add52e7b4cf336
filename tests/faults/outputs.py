"""Every command that writes, and what may go wrong while it does: kills, refusals of the disk, signals, a second writer.

    python tests/faults/outputs.py                       # all commands and faults
    python tests/faults/outputs.py --most 8 view import-coco
    python tests/faults/outputs.py --on /dev/shm synth   # outputs on another file system than temporary files

prints a table of what came of them. Commands run in children of a process that has `shim.c` preloaded, which counts the system
calls that change what lies under the folder of outputs; `--most` bounds how many calls of a command are tried with each fault.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib
import io
import json
import mmap
import os
import pkgutil
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cabinpose
from cabinpose.core import CabinposeError, left_before

HERE = Path(__file__).parent
sys.path += [str(HERE.parent / room) for room in ("cli", "store", "estimate", "record", "cabin", "evaluate")]
NOTHING, KILL, FULL, READ_ONLY, INT, TERM, STOP, NO_LOCKS = range(8)  # as in shim.c
FAULTS = {"kill": KILL, "full disk": FULL, "read-only": READ_ONLY, "Ctrl-C": INT, "SIGTERM": TERM, "no locks": NO_LOCKS}
CODES = {KILL: -signal.SIGKILL, FULL: 2, READ_ONLY: 2, INT: 130, TERM: 143, NO_LOCKS: 0}
EVER = {READ_ONLY: (1,), NO_LOCKS: (1, 2)}  # of faults that are there from the start: their kinds, in place of calls
LIMIT_S = 300
SERVE = "--serve"
Tree = dict[str, bytes]


@dataclass(frozen=True)
class Command:
    """One way to write an output: `{inputs}` and `{out}` in its words are folders."""

    words: str
    out: str  # in the folder of outputs
    again: str | None = "--overwrite"  # what the same command is given where something is there; None: it refuses
    whole: bool = True  # a folder that is there as a whole or not at all; else each file of it is
    grows: bool = False  # a recording, which is in its file as it comes; `recover` makes a cut one whole
    varies: tuple[str, ...] = ()  # ends of names of files whose bytes differ between runs, as of times in them
    before: str = ""  # of the inputs, what stands in the output's place and is written anew there, or stays as it is


_TRAIN = "train {inputs}/dataset --splits {inputs}/splits.yaml --out {out}/t"
COMMANDS: Mapping[str, Command] = {
    "synth": Command(
        "synth scene.cars=[sedan] output.frames_per_part=1 --frames 2 --workers 1 --out {out}/d", "d", "--resume", whole=False
    ),
    "config-init": Command("config init {out}/c.yaml", "c.yaml", None),
    "car-init": Command("car init {inputs}/suv.glb --out {out}/suv.yaml", "suv.yaml"),
    "car-check": Command("car check {inputs}/seat.yaml --out {out}/c", "c", whole=False),
    "train-style": Command("train-style {inputs}/camera.npz {inputs}/dataset --steps 1 --out {out}/m.onnx", "m.onnx"),
    "upgrade": Command("upgrade {out}/d", "d", None, before="v1"),
    "view": Command("view {inputs}/dataset --rows 2 --frames 2 --out {out}/v", "v", whole=False),
    "view-recording": Command("view {inputs}/take.mcap --rows 2 --frames 2 --out {out}/v", "v", whole=False),
    **{
        f"export-{name}": Command(f"export {name} {{inputs}}/alone --out {{out}}/e", "e")
        for name in ("png-json", "coco", "yolo", "itop", "ntu", "ply")
    },
    "export-bvh": Command("export bvh {inputs}/take.mcap --subject S07 --out {out}/e.bvh", "e.bvh"),
    "export-c3d": Command("export c3d {inputs}/take.mcap --source optical --out {out}/e.c3d", "e.c3d"),
    "export-csv": Command("export csv {inputs}/take.mcap --out {out}/e", "e", whole=False),
    "export-onnx": Command("export onnx {inputs}/run/best.ckpt --out {out}/m.onnx", "m.onnx"),
    "import-coco": Command("import coco {inputs}/coco.json --out {out}/d", "d"),
    "import-itop": Command("import itop {inputs}/itop --out {out}/d", "d"),
    "import-bvh": Command("import bvh {inputs}/motion.bvh --unit-m 0.01 --out {out}/r.mcap", "r.mcap", varies=(".mcap",)),
    "train": Command(f"{_TRAIN} --config {{inputs}}/run.yaml --devices 1", "t", "--resume", whole=False, varies=("",)),
    "train-arrays": Command(f"{_TRAIN} --method walks --config {{inputs}}/walks.yaml", "t", None, whole=False, varies=("",)),
    "calibrate-confidence": Command(
        "calibrate-confidence {inputs}/other --model {inputs}/m.onnx --presence 0 --out {out}/m.onnx", "m.onnx"
    ),
    "predict": Command("predict {inputs}/dataset --model {inputs}/m.onnx --out {out}/p.jsonl", "p.jsonl"),
    "experiment": Command(
        "experiment compare --methods yolo --recipe yolo={inputs}/yolo.yaml --data {inputs}/room --test {inputs}/room"
        " {inputs}/ITOP_side --resamples 9 --out {out}/e",
        "e", "", whole=False, varies=("report.json", ".html", ".png", ".npz", ".ckpt"),
    ),
    "evaluate": Command("evaluate {inputs}/dataset --predictions {inputs}/p.jsonl --out {out}/r", "r", whole=False),
    "evaluate-mocap": Command(
        "evaluate-mocap sfe {inputs}/drive.mcap --first 0 1 --last 2 3 --resamples 9 --out {out}/r", "r", whole=False
    ),
    "record": Command("record --config {inputs}/rig.yaml --out {out}/r.mcap", "r.mcap", None, grows=True),
    "recover": Command("recover {inputs}/cut.mcap --out {out}/r.mcap", "r.mcap", None),
    "lab": Command(
        "lab --views 6 --frames-per-view 1 --pendulum-s 5.1 --seconds 1.1 --no-exercises --rate-hz 4 --out {out}/s",
        "s", None, whole=False, varies=("",),
    ),
    "calibrate": Command("calibrate {inputs}/session/session.yaml --out {out}/c.yaml", "c.yaml", varies=("",)),
    "calibrate-noise": Command(
        "calibrate-noise {inputs}/wall-0.mcap {inputs}/wall-1.mcap {inputs}/wall-2.mcap --distances 0.8 1.2 1.6 --out {out}/n",
        "n", whole=False,
    ),
    "align": Command("align {inputs}/session/drive-S01.mcap --calibration {inputs}/c.yaml --out {out}/d", "d"),
}  # fmt: skip
WARM = ("synth", "car-check", "car-init", "calibrate")  # seconds each, and no threads that a fork would lack
ONCE = {  # what they do before they write, by its module
    "cabinpose.app.car_check": "check_car",
    "cabinpose.app.view.car": "draw_car",
    "cabinpose.synth": "FrameMaker",  # of the frame in the car's picture
    "cabinpose.align": "calibrate",
    "cabinpose.scene.cabin": "draft_car_file",
}
SHARED = (  # commands that write to places of one kind
    ("synth", "import-coco", "import-itop", "export-coco", "align"),
    ("import-bvh", "recover"),
    ("train",),
    ("predict",),
    ("export-onnx",),
)
_LAB = "lab --views 12 --frames-per-view 1 --pendulum-s 8 --seconds 3 --no-exercises --rate-hz 4 --out {inputs}/session"
_INPUTS = (
    "train {inputs}/dataset --splits {inputs}/splits.yaml --out {inputs}/run --config {inputs}/run.yaml --devices 1",
    "export onnx {inputs}/run/best.ckpt --out {inputs}/m.onnx",
    "predict {inputs}/dataset --model {inputs}/m.onnx --out {inputs}/p.jsonl",
)
_SESSION = (_LAB, "calibrate {inputs}/session/session.yaml --out {inputs}/c.yaml")


def make_inputs(folder: Path, session: bool) -> None:
    """What the commands read; `session`: with a session of the laboratory, which takes longest."""
    import moving_body
    import numpy as np
    import small
    import sphere_people
    import yaml
    from car_meshes import write_car
    from recorded_things import take_samples
    from test_calibrate_noise import record
    from test_compare import real, write_room
    from test_exchange import MAKE, recording
    from test_import import coco_file, itop_folder

    from cabinpose.scene.cabin import build_cabin, draft_car_file
    from cabinpose.store.recording import Chunking, Participant, RecordingWriter, Take

    folder.mkdir()
    sphere_people.write(folder / "dataset", sphere_people.manifest(frames=6, frames_per_part=3))
    sphere_people.write(folder / "alone", sphere_people.manifest(frames=3, frames_per_part=3, persons=("driver",)))
    sphere_people.write(folder / "other", sphere_people.manifest(frames=300, frames_per_part=300, seed=8))
    with zipfile.ZipFile(HERE.parent / "store" / "version1" / "dataset.zip") as packed:
        packed.extractall(folder / "v1")
    coco_file(folder / "coco.json")
    itop_folder(folder / "itop")
    recording(folder / "take.mcap")
    MAKE["bvh"](folder / "motion.bvh")
    for index, distance in enumerate((0.8, 1.2, 1.6)):
        record(folder / f"wall-{index}.mcap", distance, count=30)
    with RecordingWriter(folder / "cut.mcap", Take(subjects=(Participant(code="S07"),)), chunking=Chunking(sync_s=0)) as writer:
        for source, sample in take_samples(12, rng=np.random.default_rng(3)):
            writer.write(source, sample)
    os.truncate(folder / "cut.mcap", int((folder / "cut.mcap").stat().st_size * 0.7))
    (folder / "rig.yaml").write_text(yaml.safe_dump({"sources": {"suit": {"kind": "numbered", "rate_hz": 400, "samples": 40}}}))
    settings = json.loads(json.dumps(small.TINY["compact"]))
    (folder / "run.yaml").write_text(yaml.safe_dump({"settings": settings, "epochs": 2, "batch": 4}))
    tiny = {"width": 64, "height": 48, "samples": 10, "features": 10, "depth": 3, "leaf_samples": 5, "slots": ["driver"]}
    (folder / "walks.yaml").write_text(yaml.safe_dump({"settings": tiny}))
    (folder / "splits.yaml").write_text("train: {subject: [S01, S02, S03]}\nvalidate: {subject: [S04]}\n")
    mesh = write_car(build_cabin("suv"), folder / "suv.glb", fused=True, factor=100.0)
    (folder / "seat.yaml").write_text(yaml.safe_dump(_one_seat(draft_car_file(mesh, folder / "seat.yaml").text)))
    body = moving_body.moving(np.zeros(60))
    moving_body.write_take(folder / "drive.mcap", {"suit": moving_body.suit_stream(np.arange(60) / 20, *body)}, "drive")
    write_room(folder / "room")
    real(folder)
    yolo = small.TINY["yolo"] | {"skeleton": "itop", "slots": ["standing"], "amplitude": False, "least": 1e-6}
    (folder / "yolo.yaml").write_text(
        yaml.safe_dump(json.loads(json.dumps({"method": "yolo", "settings": yolo, "epochs": 2, "batch": 4})))
    )
    side = np.repeat(np.eye(2, dtype=np.uint8), 32, axis=1)[np.zeros(64, int)]  # of somebody, to the left
    depth_m = 2.0 - side + np.random.default_rng(1).normal(0, 0.01, side.shape)
    np.savez(folder / "camera.npz", depth_m=depth_m, regions=side)
    for words in (*_INPUTS, *(_SESSION if session else ())):
        done = run(words.format(inputs=folder), folder)
        if done.code != 0:
            raise SystemExit(f"{words}: {done.said}")


def _one_seat(text: str) -> dict[str, Any]:
    """A car's YAML with the driver's seat alone, which takes a fifth of the time to check."""
    import yaml

    car = yaml.safe_load(text)
    car["seats"] = {"driver": car["seats"]["driver"]}
    car["rules"] = [rule for rule in car["rules"] if rule["group"].split("/")[0] in ("wheel", "seat:driver")]
    return car


# ---------------------------------------------------------------------------------------------------- one run of a command


class Shim:
    """The preloaded library, and the count that it shares with the children."""

    def __init__(self) -> None:
        self._library = ctypes.CDLL(None)
        self._memory = mmap.mmap(-1, 8)
        self.count = ctypes.c_long.from_buffer(self._memory)

    def arm(self, under: Path, fault: int, at: int) -> None:
        """Have the `at`-th call under a folder go wrong, in this process."""
        self._library.shim_arm(os.fsencode(under), ctypes.c_long(at), fault, ctypes.byref(self.count))


@dataclass(frozen=True)
class Run:
    """What a command's run has left: its exit code (or -signal), what it said on stderr, the calls that were counted."""

    code: int
    said: str
    calls: int


SHIM: Shim


def start(words: str, under: Path, fault: int, at: int, said: Path) -> int:
    """Run a command in a child with a fault at a call; its process id."""
    SHIM.count.value = 0
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        os.dup2(out, 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        signal.alarm(LIMIT_S)
        SHIM.arm(under, fault, at)
        from cabinpose.app.cli import main

        code = int(main(shlex.split(words)) or 0)
        SHIM.arm(under, NOTHING, 0)
    except SystemExit as left:
        code = int(left.code or 0)
    except BaseException:  # noqa: BLE001 - as the interpreter does
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def run(words: str, under: Path, fault: int = NOTHING, at: int = 0) -> Run:
    """Run a command to its end."""
    with TemporaryDirectory() as folder:
        said = Path(folder) / "said"
        child = start(words, under, fault, at, said)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return Run(code, said.read_text(errors="replace") if said.exists() else "", SHIM.count.value)


def tree(path: Path) -> Tree:
    """The files at a path by their names, but for hidden ones."""
    if path.is_file():
        return {"": path.read_bytes()}
    names = (file.relative_to(path) for file in sorted(path.rglob("*")) if file.is_file())
    return {str(name): (path / name).read_bytes() for name in names if not any(part.startswith(".") for part in name.parts)}


def left(folder: Path, *, empty: bool = True) -> list[str]:
    """The hidden files and folders that a run has left; empty ones as well?"""
    hidden = (path for path in folder.rglob("*") if path.name.startswith("."))
    return sorted(str(path.relative_to(folder)) for path in hidden if empty or path.is_file() or any(path.iterdir()))


# ------------------------------------------------------------------------------------------------------ what came of a fault


class Trial:
    """A command with its inputs, its outcome without a fault, and how a fault's outcome differs from what is promised."""

    def __init__(self, command: Command, inputs: Path, work: Path) -> None:
        self.command, self.inputs, self.out = command, inputs, work / "out"
        self.words = command.words.format(inputs=inputs, out=self.out)
        self.before = tree(inputs / command.before) if command.before else {}
        self.place = self.out / command.out
        self._fresh()
        done = run(self.words, self.out)
        if done.code != 0 or left(self.out):
            raise RuntimeError(f"{self.words}: {done.code} {done.said} {left(self.out)}")
        self.calls, self.sound = done.calls, tree(self.place)
        self.first = work / "first"
        shutil.rmtree(self.first, ignore_errors=True)
        shutil.copytree(self.out, self.first)

    def _fresh(self, old: bool = False) -> None:
        shutil.rmtree(self.out, ignore_errors=True)
        if old:
            shutil.copytree(self.first, self.out)
        else:
            self.out.mkdir(parents=True)
            if self.command.before:
                shutil.copytree(self.inputs / self.command.before, self.place)

    def _differs(self, name: str, content: bytes) -> bool:
        """Whether a file is neither as without a fault nor, where its bytes vary, whole."""
        if any(name.endswith(end) for end in self.command.varies) or (not name and self.command.varies):
            return not whole(f"{self.place}/{name}".rstrip("/"), content)
        return self.sound.get(name) != content

    def problems(self, fault: int, at: int, *, old: bool) -> Iterator[str]:
        """What is not as promised when the `at`-th call goes wrong; `old`: where an earlier output is replaced."""
        self._fresh(old)
        again = f" {self.command.again}"
        done = run(self.words + (again if old else ""), self.out, fault, at)
        if done.code not in (0, CODES[fault]):
            yield f"exit code {done.code}"
        if "Traceback" in done.said:
            yield "traceback"
        if done.code == 2 and "hint:" not in done.said:
            yield "no hint"
        if done.code == 2 and not re.search("no space left|Read-only|cannot", done.said):
            yield "wrong words"
        if ".tmp" in done.said:
            yield "names a hidden folder"
        if fault != KILL and done.code and (hidden := left(self.out)):
            yield f"left {hidden[0]}"
        found = tree(self.place)
        if self.before and found == self.before and done.code:
            found = self.sound  # as good: nothing was changed
        if (old or self.before) and not found and (fault != KILL or left_before(self.place) is None):
            yield "lost"
        if not self.command.grows and any(self._differs(name, content) for name, content in found.items()):
            yield "half a file"
        if done.code == 0 and found.keys() != self.sound.keys():
            yield "not all of it"
        if self.command.whole and found and found.keys() != self.sound.keys():
            yield "half a folder"
        if fault == KILL:
            yield from self._again(bool(found) or old)

    def _again(self, there: bool) -> Iterator[str]:
        """What is not as promised of the same command after a kill: it ends, with the same outcome, and leaves nothing."""
        there = there or self.place.exists()
        if self.before and tree(self.place) != self.sound:
            there = False  # not done yet
        if there and self.command.again is None:
            return
        done = run(f"{self.words} {self.command.again if there else ''}", self.out)
        if done.code != 0:
            yield f"again: exit code {done.code} ({done.said.strip().splitlines()[:1]})"
            return
        found = {} if self.command.grows else tree(self.place)
        if found and (found.keys() != self.sound.keys() or any(self._differs(*file) for file in found.items())):
            yield "again: another outcome"
        if hidden := left(self.out, empty=False):  # of an output that is not written again
            yield f"again: left {hidden[0]}"


def whole(name: str, content: bytes) -> bool:
    """Whether a file's end is there, by its kind."""
    if name.endswith(".mcap"):
        return content.endswith(b"\x89MCAP0\r\n")
    if name.endswith((".ckpt", ".npz")):
        return b"PK\x05\x06" in content[-1024:]
    if name.endswith(".png"):
        return content.endswith(b"IEND\xaeB`\x82")
    return content.endswith((b"\n", b"</html>"))


def chosen(calls: int, most: int) -> list[int]:
    """Numbers of calls, evenly over all of them, the first and the last among them; of one alone the middle."""
    if calls <= most:
        return list(range(1, calls + 1))
    if most == 1:
        return [(calls + 1) // 2]
    return sorted({round(1 + k * (calls - 1) / (most - 1)) for k in range(most)})


def beside(first: Trial, second: Command) -> Iterator[str]:
    """What is not as promised where a second command writes to the place of the first one, which is stopped in the middle."""
    shutil.rmtree(first.out, ignore_errors=True)
    first.out.mkdir()
    words = second.words.replace(f"{{out}}/{second.out}", str(first.place)).format(inputs=first.inputs)
    with TemporaryDirectory() as folder:
        child = start(first.words, first.out, STOP, first.calls // 2, Path(folder) / "said")
        if not os.WIFSTOPPED(os.waitpid(child, os.WUNTRACED)[1]):
            yield "not stopped"
            return
        there = tree(first.out)
        done = run(f"{words} {second.again or ''}", first.out)
        if done.code != 2 or "Traceback" in done.said or not re.search("another process is writing|holds a dataset", done.said):
            yield f"the second: exit code {done.code}: {' '.join(done.said.split())[:100]}"
        if tree(first.out) != there:
            yield "the second changed something"
        os.kill(child, signal.SIGCONT)
        if (code := os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])) != 0:
            yield f"the first: exit code {code}"
    found = tree(first.place)
    if found.keys() != first.sound.keys() or any(first._differs(name, content) for name, content in found.items()):
        yield "the first: another outcome"


def _stood_for(fault: int, at: int, old: bool) -> bool:
    """Whether another kind on the same way through the code stands for this one: the two signals, the two refusals of locks."""
    return (fault in (INT, TERM) and (fault == TERM) != old) or (fault == NO_LOCKS and (at == 2) != old)


def tried(name: str, trial: Trial, most: int, faults: Sequence[str], halves: bool) -> dict[str, tuple[int, Counter[str]]]:
    """For each fault the number of runs, and the problems that were found with how often."""
    result = {}
    ways = (False,) if trial.command.again is None else (False, True)
    for label in faults:
        fault, problems, runs = FAULTS[label], Counter[str](), 0
        for old in ways:
            for at in EVER.get(fault) or chosen(trial.calls + 2 * old, most):
                if halves and len(ways) == 2 and _stood_for(fault, at, old):
                    continue
                runs += 1
                for problem in trial.problems(fault, at, old=old):
                    problems[problem] += 1
                    sys.stderr.write(f"{name}, {label} at call {at}{', replacing' if old else ''}: {problem}\n")
        result[label] = runs, problems
    return result


def load_all() -> None:
    """Import every module, once for all children."""
    for module in pkgutil.walk_packages(cabinpose.__path__, "cabinpose."):
        if not module.name.endswith("__main__"):
            with suppress(ImportError, CabinposeError):  # of an extra that is not installed
                importlib.import_module(module.name)


def once(module: str, name: str) -> None:
    """Have a function that writes nothing keep what it gives, for the children of this process as well."""
    home, kept = importlib.import_module(module), dict[str, Any]()
    function = getattr(home, name)

    def keeping(*words: Any, **more: Any) -> Any:
        key = repr((words, more))
        if key not in kept:
            kept[key] = function(*words, **more)
        return kept[key]

    setattr(home, name, keeping)


def warm_up(names: Sequence[str], inputs: Path, out: Path) -> None:
    """Run commands in this process, whose caches its children have then: what comes before the writing takes seconds of each.

    out: the folder in which they are tried, which what they keep may be of.
    """
    from cabinpose.app.cli import main

    for command in (COMMANDS[name] for name in WARM if name in names):
        out.mkdir()
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as said:
            if main(shlex.split(command.words.format(inputs=inputs, out=out))):
                raise SystemExit(f"{command.words}: {said.getvalue()}")
        shutil.rmtree(out)


def tell(*cells: str) -> None:
    """Print a row of the table."""
    sys.stdout.write(f"| {' | '.join(cells)} |\n")
    sys.stdout.flush()


def main(words: Sequence[str]) -> int:
    """Try commands, and print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("commands", nargs="*")
    parser.add_argument("--most", type=int, default=1000)
    parser.add_argument("--faults", nargs="*", choices=list(FAULTS), default=list(FAULTS))
    parser.add_argument(
        "--halves",
        action="store_true",
        help="Ctrl-C and one refusal of locks for new outputs, SIGTERM and the other for old ones",
    )
    parser.add_argument("--inputs", type=Path, help="a folder of inputs that an earlier run made, or is to make")
    parser.add_argument("--on", type=Path, help="a folder of another file system, to make the outputs in")
    given = parser.parse_args(words)
    names = given.commands or list(COMMANDS)
    failed = False
    with TemporaryDirectory() as temporary, TemporaryDirectory(dir=given.on) as work:
        inputs = given.inputs or Path(temporary) / "inputs"
        if not inputs.exists():
            make_inputs(inputs, session=bool({"calibrate", "align"} & set(names)))
        warm_up(names, inputs, Path(work) / "out")
        tell("command", "calls", *given.faults, "s")
        trials: dict[str, Trial] = {}
        for name in names:
            began = time.monotonic()
            try:
                trial = trials[name] = Trial(COMMANDS[name], inputs, Path(work))
            except RuntimeError as error:
                failed = True
                sys.stderr.write(f"{error}\n")
                continue
            found = tried(name, trial, given.most, given.faults, given.halves)
            cells = (f"{runs}: " + (", ".join(f"{p} {n}" for p, n in bad.items()) or "held") for runs, bad in found.values())
            tell(name, str(trial.calls), *cells, f"{time.monotonic() - began:.0f}")
            failed |= any(bad for _, bad in found.values())
        for first, second in ((a, b) for group in SHARED for a in group for b in group if {a, b} <= trials.keys()):
            bad = list(beside(trials[first], COMMANDS[second]))
            tell(f"{second} into what {first} writes", ", ".join(bad) or "held")
            failed |= bool(bad)
    return int(failed)


@contextmanager
def shimmed() -> Iterator[dict[str, str]]:
    """The environment of a process that has the shim, which is built first, beneath it."""
    with TemporaryDirectory() as folder:
        library = Path(folder) / "shim.so"
        subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(HERE / "shim.c"), "-ldl"], check=True)
        yield os.environ | {"LD_PRELOAD": str(library), "CABINPOSE_SHIM": "1", "OMP_NUM_THREADS": "1"}


def preloaded(words: Sequence[str], *, captured: bool = True, script: str = __file__) -> subprocess.CompletedProcess[str]:
    """Run this module, or another one of this folder, with the shim."""
    with shimmed() as environment:
        return subprocess.run([sys.executable, script, *words], env=environment, check=False, text=True, capture_output=captured)


@contextmanager
def serving() -> Iterator[Callable[..., tuple[bool, str]]]:
    """`tried("--most", "2", "view")`: whether all held, and what was said, by one process that has loaded everything."""
    with shimmed() as environment:
        words = [sys.executable, __file__, SERVE]
        with subprocess.Popen(
            words, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as process:
            asked, told = process.stdin, process.stdout
            assert asked is not None
            assert told is not None

            def tried(*words: str) -> tuple[bool, str]:
                asked.write(f"{shlex.join(words)}\n")
                asked.flush()
                said = ""
                for line in told:
                    if line.startswith(SERVE):
                        return line == f"{SERVE} 0\n", said
                    said += line
                return False, said

            try:
                yield tried
            finally:
                process.kill()


def run_here() -> int:
    """Try what the command line says, or what comes on standard input, line by line."""
    global SHIM
    SHIM = Shim()
    load_all()
    for module, name in ONCE.items():
        once(module, name)
    if sys.argv[1:] != [SERVE]:
        return main(sys.argv[1:])
    for line in sys.stdin:
        try:
            code = main(shlex.split(line))
        except Exception:  # noqa: BLE001 - one request's, as an interpreter of its own would tell it
            traceback.print_exc()
            code = 1
        sys.stdout.write(f"{SERVE} {code}\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(run_here() if "CABINPOSE_SHIM" in os.environ else preloaded(sys.argv[1:], captured=False).returncode)
