"""Formats as commands: each with its own flags, those of extensions too, and the spelling of earlier releases."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cabinpose.app.cli.formats import modern, names_of
from cabinpose.core.registry import OURS
from cabinpose.store import open_dataset
from cabinpose.store.convert import FORMATS, export_dataset

Run = Callable[..., Any]
Install = Callable[..., None]  # see the fixture `extension`

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text("utf-8").split("## A format")[1]
WRITER = '''
from dataclasses import dataclass
from cabinpose.store.convert import DatasetFormat

@dataclass(frozen=True, kw_only=True)
class Options:
    """How the count is written."""

    word: str = "frames"
    """What stands behind it."""

class Count(DatasetFormat):
    """The number of frames. Nothing else."""

    export_options = Options

    def write(self, parts, folder, options, report):
        (folder / "count.txt").write_text(f"{parts[''].sizes['frame']} {options.word}")

COUNT = Count()
'''
READER = '''
import numpy as np
from cabinpose.signals import Channels
from cabinpose.store.convert import RecordingFormat

class Numbers(RecordingFormat):
    """A number a line."""

    def read(self, path, options, subjects):
        for i, line in enumerate(path.read_text().split()):
            yield "numbers", i, None, Channels(("number",), np.array([float(line)]))

NUMBERS = Numbers()
'''


@pytest.mark.parametrize("name", FORMATS.names(own=True))
def test_what_the_source_says_is_what_is_there(name: str) -> None:
    """`--help` reads sources; the options of a format are those that its methods take."""
    form, outline = FORMATS[name], FORMATS.outline(name)
    assert outline is not None
    assert ("read" in outline.methods, "write" in outline.methods) == (form.can("read"), form.can("write"))
    assert outline.summary == (type(form).__doc__ or "").partition("\n")[0]
    for method, options in (("read", form.import_options), ("write", form.export_options)):
        if method in outline.methods:
            assert options.__name__ in getattr(type(form), method).__annotations__.values()


def test_an_extension_writes_and_reads(run: Run, extension: Install, dataset_folder: Path, tmp_path: Path) -> None:
    extension("acme", {"formats": {"count": "COUNT", "numbers": "NUMBERS"}}, WRITER + READER)
    for verb, line in (
        ("export", "  count           The number of frames. Nothing else"),
        ("import", "  numbers         A number a line"),
    ):
        code, out, err = run(verb, "--help")
        assert (code, err) == (0, "")
        assert line in out.splitlines()
    code, out, _ = run("export", "count", "--help")
    assert code == 0
    assert "--word STR" in out
    assert "What stands behind it." in out
    assert "--images" not in out
    done = run("export", "count", dataset_folder, "--out", tmp_path / "out", "--word", "pictures")
    assert (done.code, done.err) == (0, "")
    assert (tmp_path / "out" / "count.txt").read_text() == "5 pictures"
    again = export_dataset(open_dataset(dataset_folder), "count", tmp_path / "again")
    assert (again / "count.txt").read_text() == "5 frames"
    (tmp_path / "a.txt").write_text("1 2 3")
    done = run("import", "numbers", tmp_path / "a.txt", "--out", tmp_path / "a.mcap", "--json")
    assert json.loads(done.out)["samples"] == {"numbers": 3}


def test_the_page_has_one(run: Run, extension: Install, dataset_folder: Path, tmp_path: Path) -> None:
    """The module that docs/extending.md shows."""
    extension("page", {"formats": {"joints": "JOINTS"}}, re.findall(r"```python\n(.*?)```", PAGE, re.S)[0])
    written = run("export", "joints", dataset_folder, "--out", tmp_path / "table", "--digits", "3")
    assert (written.code, written.err) == (0, "")
    read = run("import", "joints", tmp_path / "table" / "joints.csv", "--out", tmp_path / "again", "--licence", "CC0-1.0")
    assert read.code == 0, read.err
    before, after = open_dataset(dataset_folder), open_dataset(tmp_path / "again")
    np.testing.assert_allclose(before.joints_3d.values, after.joints_3d.values, atol=6e-4)
    assert after.attrs["licence"] == "CC0-1.0"
    assert "Joints as a table, metres in the camera frame" in run("export", "--help").out


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [
        (
            "raising",
            "raise RuntimeError('no licence')",
            "the format 'raising' of acme cannot be loaded: RuntimeError: no licence",
        ),
        ("three", "COUNT = 3", "the format 'three' of acme is not a Format, but 3"),
    ],
)
def test_a_bad_extension_breaks_nothing_else(
    run: Run, extension: Install, dataset_folder: Path, tmp_path: Path, name: str, code: str, words: str
) -> None:
    extension("acme", {"formats": {name: "COUNT"}}, code)
    with pytest.warns(UserWarning, match="acme"):
        assert name not in names_of("write")
    done = run("export", name, dataset_folder, "--out", tmp_path / name)
    assert (done.code, words in done.err) == (2, True)
    assert "hint: update or uninstall acme; everything else works without it" in done.err
    extension("good", {"formats": {f"beside-{name}": "COUNT"}}, WRITER)
    for other in (f"beside-{name}", "ply"):
        done = run("export", other, dataset_folder, "--out", tmp_path / other)
        assert done.code == 0, done.err


def test_a_name_that_is_taken(run: Run, extension: Install, dataset_folder: Path, tmp_path: Path) -> None:
    extension("acme", {"formats": {"coco": "COUNT", "twice": "COUNT"}}, WRITER)
    extension("other", {"formats": {"twice": "COUNT"}}, WRITER)
    assert FORMATS.package("coco") == OURS
    assert run("export", "coco", dataset_folder, "--out", tmp_path / "coco").code == 0
    assert (tmp_path / "coco" / "annotations").is_dir()
    done = run("export", "twice", dataset_folder, "--out", tmp_path / "twice")
    assert done.code == 2
    assert "the format 'twice' is left out: acme, other all have one of this name" in done.err
    assert "hint: uninstall one of them" in done.err


@pytest.mark.parametrize(
    ("verb", "old", "new"),
    [
        ("import", "a --format coco --out b", "coco a --out b"),
        ("import", "--format=itop a --out b --keep-invalid", "itop a --out b --keep-invalid"),
        ("import", "a --format coco --corrects d --out e --role me", "coco-labels a --corrects d --out e --role me"),
        ("import", "coco --format coco --out b", "coco coco --out b"),
        ("export", "--format sto a.mcap --out b --rate 100", "sto a.mcap --out b --rate-hz 100"),
        ("export", "a.mcap --out b --format sto --rate=100", "sto a.mcap --out b --rate-hz=100"),
        ("export", "--onnx best.ckpt --out m.onnx --half", "onnx best.ckpt --out m.onnx --half"),
    ],
)
def test_the_spelling_of_earlier_releases(recwarn: pytest.WarningsRecorder, verb: str, old: str, new: str) -> None:
    assert modern(verb, old.split()) == new.split()
    flag = "--onnx" if "--onnx" in old else "--format"
    assert str(recwarn.pop().message) == f"`{flag}` goes on working for one release; write: cabinpose {verb} {new}"
    assert modern(verb, new.split()) == new.split()
    assert not recwarn


def test_both_spellings_do_the_same(run: Run, dataset_folder: Path, tmp_path: Path) -> None:
    old = run("export", dataset_folder, "--format", "coco", "--out", tmp_path / "old", "--images", "depth16")
    new = run("export", "coco", dataset_folder, "--out", tmp_path / "new", "--images", "depth16")
    assert (old.code, new.code) == (0, 0)
    assert old.err.startswith("warning: `--format` goes on working for one release; write: cabinpose export coco ")
    written = [path for path in (tmp_path / "old").rglob("*") if path.is_file()]
    assert written
    for path in written:
        assert path.read_bytes() == (tmp_path / "new" / path.relative_to(tmp_path / "old")).read_bytes()
    assert run("export", dataset_folder, "--format").err == (
        "error: --format needs a value\nhint: cabinpose export FORMAT ... is how formats are named now\n"
    )


def test_flags_that_were_renamed(run: Run) -> None:
    done = run("emulate", "stepper", "--backlash", "0.5", "--seconds", "0.01")
    assert done.code == 0
    assert done.err.startswith("warning: --backlash is called --backlash-deg now\n")
    assert run("lab", "--rate", "0", "--out", "l").err == (
        "warning: --rate is called --rate-hz now\n"
        "error: --rate-hz: must be greater than 0, not 0.0\n"
        "hint: `cabinpose lab --help` says what each flag takes\n"
    )
