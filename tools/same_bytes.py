"""Does the tree still make what a commit made, byte by byte? `python tools/same_bytes.py REF [JOB ...]`

Builds the commit REF beside the tree (in `build/same_bytes`, where its results stay, too), lets both make the same things, and
compares every file: datasets (plain, full car, things, children, room, sequence, pictures), a session of the virtual laboratory
with its recordings, what `calibrate`, `align` and `evaluate-mocap` make of it, exports, imports, predictions, reports, and
trained weights of ten steps. Prints each file that differs and ends with 1 if there is one. JOB names some of the jobs (`--list`)
in place of all.

Checkpoints are compared weight by weight, since they hold names of classes; of text, what tells the time, how long something
took and the paths of folders are left out.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CACHE = ROOT / "build" / "same_bytes"
FULL = "{driver: 1, front_passenger: 1, rear_left: 1, rear_center: 1, rear_right: 1}"
MOVING = "{frames: 6, rate_hz: 15, activities: [steer, drink, check_mirror]}"
LEARN = {
    "compact": "settings: {width: 48, height: 48, focal: 22, slots: [driver, front_passenger]}",
    "paf": "settings: {width: 96, height: 80, focal: 44}",
    "lifting": "",
    "unet": "",
    "yolo": "",
    "dpm": "settings: {slots: [driver]}",
    "walks": "settings: {slots: [driver]}",
}
# Sums of libraries keep their order only in one thread: OpenCV's calibration of a lens differs in its tenth digit otherwise.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": "1"}
Job = Callable[[Path], Iterator[list[object]]]


def datasets(made: Path) -> Iterator[list[object]]:
    """Generated datasets of every kind."""
    out = made / "datasets"
    examples = ROOT / "docs" / "examples"
    yield ["synth", "--frames", 12, "--seed", 1, "--out", out / "plain"]
    yield ["synth", "--frames", 3, "--seed", 2, "--out", out / "full", f"scene.occupancy={FULL}", "scene.cars=[suv]"]
    yield ["synth", "--frames", 4, "--seed", 3, "--out", out / "things", "--config", examples / "things.yaml"]
    yield ["synth", "--frames", 4, "--seed", 4, "--out", out / "children", "--config", examples / "children.yaml"]
    yield ["synth", "--frames", 3, "--seed", 5, "--out", out / "room", "scene={kind: room}"]
    yield ["synth", "--frames", 6, "--seed", 6, "--out", out / "sequence", f"scene.sequence={MOVING}"]
    yield ["synth", "--frames", 2, "--seed", 7, "--out", out / "multipath", "noise.multipath=true", "scene.cars=[sedan]"]
    yield ["synth", "--frames", 2, "--seed", 8, "--out", out / "empirical", "noise={kind: empirical}", "camera.sensor=evk75123"]


def laboratory(made: Path) -> Iterator[list[object]]:
    """A session of the virtual laboratory, calibrated, aligned and judged."""
    lab = made / "lab"
    yield ["lab", "--out", lab / "session", "--seconds", 4, "--views", 12, "--seed", 1]
    yield ["calibrate", lab / "session" / "session.yaml", "--out", lab / "calibration.yaml"]
    drive, exercises, board = (lab / "session" / f"{take}.mcap" for take in ("drive-S01", "exercises-S01", "board"))
    yield ["align", drive, "--calibration", lab / "calibration.yaml", "--out", lab / "aligned", "--report", lab / "aligned.html"]
    for evaluation in ("dse", "dfe"):
        yield ["evaluate-mocap", evaluation, exercises, "--out", lab / evaluation, "--resamples", 50]
    yield ["export", drive, "--format", "csv", "--out", lab / "csv"]
    yield ["export", exercises, "--format", "bvh", "--source", "suit", "--out", lab / "take.bvh"]
    yield ["export", exercises, "--format", "sto", "--source", "suit", "--rate", 240, "--out", lab / "take.sto"]
    for form in ("c3d", "trc"):
        yield ["export", board, "--format", form, "--source", "optical", "--rate", 100, "--out", lab / f"board.{form}"]
    yield ["import", lab / "board.c3d", "--format", "c3d", "--out", lab / "c3d.mcap"]
    yield ["import", lab / "take.bvh", "--format", "bvh", "--out", lab / "bvh.mcap"]
    yield ["view", drive, "--out", lab / "view"]


def exchange(made: Path) -> Iterator[list[object]]:
    """A dataset in every other format and back."""
    for form in ("png-json", "coco", "yolo", "itop", "ntu", "ply"):
        whole = made / "datasets" / ("room" if form == "itop" else "plain")  # ITOP's layout holds one person a frame
        yield ["export", whole, "--format", form, "--out", made / "exchange" / form]
    for form in ("png-json", "coco", "itop", "ntu"):
        yield ["import", made / "exchange" / form, "--format", form, "--out", made / "exchange" / f"{form}-back"]


def models(made: Path) -> Iterator[list[object]]:
    """Ten steps of each method, its exported model, and what that finds."""
    plain, out = made / "datasets" / "plain", made / "models"
    out.mkdir(exist_ok=True)
    for method, settings in LEARN.items():
        config = out / f"{method}.yaml"
        config.write_text(f"method: {method}\nepochs: 5\nbatch: 4\nseed: 1\n{settings}\n", encoding="utf-8")
        yield ["train", plain, "--config", config, "--out", out / method]
        for checkpoint in (out / method).glob("best.ckpt"):
            yield ["export", "--onnx", checkpoint, "--out", out / f"{method}.onnx"]


def reports(made: Path) -> Iterator[list[object]]:
    """Predictions, reports and pages."""
    plain, out = made / "datasets" / "plain", made / "reports"
    for model in ("in_car", "parts"):
        yield ["predict", plain, "--model", model, "--out", out / f"{model}.{'zarr' if model == 'parts' else 'jsonl'}"]
    yield ["evaluate", plain, "--model", "in_car", "paf", "--out", out / "in_car", "--resamples", 50]
    yield ["evaluate", plain, "--model", "parts", "--out", out / "parts", "--resamples", 50]
    yield ["view", plain, "--out", out / "view"]


JOBS: dict[str, Job] = {job.__name__: job for job in (datasets, laboratory, exchange, models, reports)}


def make(jobs: list[str], made: Path, tree: Path) -> None:
    """Let the package of a tree make what the jobs name; a command that fails leaves its last words as a file."""
    import cabinpose
    from cabinpose.app.cli import main

    if not Path(cabinpose.__file__).is_relative_to(tree):  # or a tree would be held against itself
        raise RuntimeError(f"{cabinpose.__file__} is not of {tree}")
    for job in jobs:
        (made / job).mkdir(parents=True, exist_ok=True)
        for number, command in enumerate(JOBS[job](made)):
            try:
                code = main([str(word) for word in command])
            except SystemExit as end:
                code = end.code if isinstance(end.code, int) else 1
            if code:
                print("failed:", *command, file=sys.stderr)
                (made / job / f"failed-{number}").write_text(f"{command[0]} {code}\n", encoding="utf-8")


# What differs between two runs of one commit.
_NOISE = (
    (rb'"(?:created|started|written|finished)[a-z_]*": "[^"]*"', b""),
    (rb"(?:created|started|written)[a-z_]*: .*", b""),
    (rb"[0-9.]+ (?:frames|steps|poses)/s", b""),
)


def digests(made: Path) -> dict[str, str]:
    """Of every file, by its path: of checkpoints one for each weight, of text one without what may differ."""
    found = {}
    for path in sorted(p for p in made.rglob("*") if p.is_file()):
        name = str(path.relative_to(made))
        if path.suffix == ".ckpt":
            import torch

            kept = torch.load(path, map_location="cpu", weights_only=False)["state_dict"]
            found |= {f"{name}:{key}": hashlib.sha256(value.numpy().tobytes()).hexdigest() for key, value in kept.items()}
            continue
        data = path.read_bytes()
        if b"\0" not in data:
            data = data.replace(str(made).encode(), b"")
            for pattern, instead in _NOISE:
                data = re.sub(pattern, instead, data)
        found[name] = hashlib.sha256(data).hexdigest()
    return found


def build(ref: str, folder: Path) -> dict[str, str]:
    """Check a commit out and build its kernels, once; the environment in which a process sees its package."""
    tree, native, site = folder / "tree", folder / "native", folder / "site"
    if not (folder / "built").exists():
        shutil.rmtree(folder, ignore_errors=True)
        tree.mkdir(parents=True)
        archive = subprocess.run(["git", "archive", ref], cwd=ROOT, check=True, capture_output=True).stdout
        subprocess.run(["tar", "-x", "-C", str(tree)], input=archive, check=True)
        tools = Path(sys.executable).parent
        options = ["-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release", f"-DCMAKE_MAKE_PROGRAM={tools / 'ninja'}"]
        options += [f"-DPython_EXECUTABLE={sys.executable}"]
        options += [f"-D{word}" for word in _compiler(tree, tools.parent)]
        subprocess.run([tools / "cmake", "-S", tree, "-B", native, *options], check=True, stdout=subprocess.DEVNULL)
        subprocess.run([tools / "cmake", "--build", native], check=True, stdout=subprocess.DEVNULL)
        project = tomllib.loads((tree / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        info = site / f"cabinpose-{project['version']}.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: cabinpose\nVersion: {project['version']}\n", encoding="utf-8"
        )
        rows = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in of.items()) for group, of in project["entry-points"].items()]
        (info / "entry_points.txt").write_text("\n".join(rows), encoding="utf-8")
        (folder / "built").touch()
    # Python is started without `site`: an editable installation would put its own package before all others.
    return {"PYTHONPATH": os.pathsep.join(map(str, (tree / "src", site, *sys.path[1:]))), "CABINPOSE_NATIVE": str(native)}


def _compiler(tree: Path, environment: Path) -> list[str]:
    told = subprocess.run([tree / "tools" / "compiler.sh", environment], check=True, capture_output=True, text=True)
    return told.stdout.split()


def _made(jobs: list[str], folder: Path, tree: Path, environment: dict[str, str]) -> dict[str, str]:
    """The digests of what the package of a tree makes in an environment, in a folder that is emptied first."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    options = ["-S"] if environment else []
    command = [sys.executable, *options, __file__, "--make", str(folder), "--tree", str(tree), *jobs]
    log = folder.with_suffix(".log")
    with log.open("w", encoding="utf-8") as told:
        subprocess.run(command, check=True, env=os.environ | ONE_THREAD | environment, stdout=told, stderr=told)
    return digests(folder)


def main() -> int:
    """Print what differs; 1 if something does."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("ref", nargs="?", help="the commit to compare with")
    parser.add_argument("jobs", nargs="*", help="jobs, with those that they need; default: all")
    parser.add_argument("--list", action="store_true", help="list the jobs")
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--tree", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.make is not None:  # the process that does it: `ref` is the first job
        make([given.ref, *given.jobs], given.make, given.tree)
        return 0
    if given.list or given.ref is None:
        print(*(f"{name}: {job.__doc__}" for name, job in JOBS.items()), sep="\n")
        return 0
    if unknown := set(given.jobs) - JOBS.keys():
        parser.error(f"no such job: {', '.join(sorted(unknown))}; --list lists them")
    wanted = given.jobs or list(JOBS)
    jobs = [name for name in JOBS if name in wanted or (name == "datasets" and set(wanted) - {"laboratory"})]
    commit = subprocess.run(["git", "rev-parse", given.ref], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()
    folder = CACHE / commit
    environment = build(commit, folder)
    kept = folder / f"{'-'.join(jobs)}.json"
    if not kept.exists():
        kept.write_text(json.dumps(_made(jobs, folder / "made", folder / "tree", environment), indent=1), encoding="utf-8")
    before = json.loads(kept.read_text(encoding="utf-8"))
    now = _made(jobs, CACHE / "tree", ROOT / "src", {})
    for name in sorted(before.keys() | now.keys()):
        if before.get(name) != now.get(name):
            print(f"{name}: {'new' if name not in before else 'gone' if name not in now else 'differs'}")
    failed = [name for name in now if Path(name).name.startswith("failed-")]
    if failed:
        print(f"what failed: grep -B3 ^failed: {(CACHE / 'tree.log').relative_to(ROOT)}", file=sys.stderr)
    differ = before != now
    print(
        f"{len(before)} files of {given.ref}, {'not ' if differ else ''}the same; {len(failed)} commands failed", file=sys.stderr
    )
    return int(differ or bool(failed))


if __name__ == "__main__":
    sys.exit(main())
