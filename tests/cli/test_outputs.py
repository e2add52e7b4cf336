"""An output that cannot be written is told before the work, by every command that has one; names and links; a full stdout."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cabinpose.app.cli import VERBS
from cabinpose.app.cli.interrupt import Ended, interruptions

Run = Callable[..., Any]

WRITES = {
    "synth": "synth --frames 1 --out {out}",
    "train-style": "train-style no.yaml no --out {out}",
    "config": "config init {out}",
    "car": "car init no.glb --out {out}",
    "car, the check": "car check no.yaml --out {out}",
    "view": "view no --out {out}",
    "export": "export coco no --out {out}",
    "export, a recording": "export csv no.mcap --out {out}",
    "export, a model": "export onnx no.ckpt --out {out}",
    "import": "import coco no.json --out {out}",
    "import, a recording": "import bvh no.bvh --out {out}",
    "train": "train no --out {out}",
    "adapt": "adapt no.onnx no --out {out}",
    "calibrate-confidence": "calibrate-confidence no --model no.onnx --out {out}",
    "predict": "predict no --model no.onnx --out {out}",
    "evaluate": "evaluate no --model no.onnx --out {out}",
    "experiment": "experiment compare --test no --out {out}",
    "experiment, a file": "experiment run no.yaml --out {out}",
    "live": "live --source no --model in_car --predictions {out}",
    "record": "record --config no.yaml --out {out}",
    "recover": "recover no.mcap --out {out}",
    "lab": "lab --out {out}",
    "calibrate": "calibrate no.yaml --out {out}",
    "calibrate-noise": "calibrate-noise no.mcap --out {out}",
    "align": "align no.mcap --calibration no.yaml --out {out}",
    "align, the report": "align no.mcap --calibration no.yaml --out d --report {out}",
    "evaluate-mocap": "evaluate-mocap sse roll=no.mcap --out {out}",
}
NONE = {
    "info",
    "models",
    "serve",
    "forget",
    "emulate",
    "studio",
    "bench",
    "upgrade",
}  # these write nothing, or what no --out names


def test_every_command_is_in_the_table() -> None:
    assert {name.partition(",")[0] for name in WRITES} | NONE == set(VERBS)


@pytest.mark.parametrize("name", WRITES)
def test_it_is_told_before_the_work(name: str, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The inputs are missing, and are not looked for."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("in the way of a folder")
    done = run(*WRITES[name].format(out=tmp_path / "file" / "out").split())
    assert done.code == 2, done.err
    assert f"cannot write {tmp_path / 'file' / 'out'}: " in done.err
    assert "hint: " in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    "verb", ["export coco {inputs} --out {out}", "view {inputs} --rows 1 --frames 1 --out {out}", "config init {out}"]
)
def test_long_names_and_links_that_lead_nowhere(verb: str, dataset_folder: Path, run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "outputs"
    folder.mkdir()
    for name in ("n" * 250, "n" * 255):
        assert run(*verb.format(inputs=dataset_folder, out=folder / name).split()).code == 0
        assert [path.name for path in folder.glob("*")] == [name]
        (folder / name).rename(tmp_path / name[1:])
    done = run(*verb.format(inputs=dataset_folder, out=folder / ("n" * 256)).split())
    assert done.code == 2
    assert "the name is too long" in done.err
    (folder / "link").symlink_to("target")
    assert run(*verb.format(inputs=dataset_folder, out=folder / "link").split()).code == 0
    assert (folder / "link").is_symlink()
    assert (folder / "target").exists()


@pytest.mark.parametrize("verb", [pytest.param("models --json", marks=pytest.mark.slow), "--version", "config schema"])
def test_a_standard_output_that_is_full_or_closed(verb: str) -> None:
    start = [sys.executable, "-m", "cabinpose", *verb.split()]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(start, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, f"error: cannot write to standard output: {os.strerror(28)}\n")
    closed = subprocess.run(start, preexec_fn=lambda: os.close(1), stderr=subprocess.PIPE, text=True, check=False)
    assert (closed.returncode, closed.stderr) == (1, f"error: cannot write to standard output: {os.strerror(9)}\n")


@pytest.mark.parametrize(("kind", "becomes"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Ended)])
def test_what_a_library_makes_of_an_interrupt(kind: signal.Signals, becomes: type[BaseException]) -> None:
    """An extension module that is interrupted while it is loaded is an ImportError."""
    raised: list[type[BaseException]] = []
    try:
        with interruptions():
            try:
                os.kill(os.getpid(), kind)
            except KeyboardInterrupt:
                raise ImportError("initialization failed") from None
    except BaseException as error:  # noqa: BLE001 - pytest.raises lets a KeyboardInterrupt of another kind through
        raised.append(type(error))
    assert raised == [becomes]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


_INTERRUPTED_IN_AN_IMPORT = """
import importlib.abc, os, sys
class Now(importlib.abc.MetaPathFinder):
    def find_spec(self, name, *_):
        if name == "cabinpose.app.cli.output":
            os.kill(os.getpid(), {kind})
sys.meta_path.insert(0, Now())
from cabinpose.__main__ import main
sys.argv[1:] = ["--version"]
sys.exit(main())
"""


@pytest.mark.parametrize(("kind", "code", "words"), [(signal.SIGINT, 130, "interrupted\n"), (signal.SIGTERM, 143, "ended\n")])
def test_an_interrupt_while_the_program_is_loaded(kind: signal.Signals, code: int, words: str) -> None:
    start = [sys.executable, "-c", _INTERRUPTED_IN_AN_IMPORT.format(kind=int(kind))]
    done = subprocess.run(start, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", words)
    ignoring = subprocess.run(
        start, capture_output=True, text=True, check=True, preexec_fn=lambda: signal.signal(kind, signal.SIG_IGN)
    )
    assert ignoring.stderr == ""
