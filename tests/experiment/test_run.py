"""A small experiment from end to end, again, changed, and on two kinds of workers."""

from __future__ import annotations

import json
import math
import multiprocessing
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import torch
import xarray as xr
from distributed import LocalCluster

from cabinpose.app.cli.interrupt import Ended
from cabinpose.app.experiment.cells import ExperimentCell, _sides
from cabinpose.app.experiment.config import TableColumn, load
from cabinpose.app.experiment.frames import opened
from cabinpose.app.experiment.page import begin, refuse_other
from cabinpose.app.experiment.plan import ExperimentPlan, make_plan
from cabinpose.app.experiment.results import (
    Results,
    _ErrorsRead,
    _found_share,
    as_many_rows,
    cell_text,
    differences_csv,
    first_differences,
)
from cabinpose.app.experiment.schedule import _spread, make_cells
from cabinpose.app.report import raster
from cabinpose.app.training import stored_frames
from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.estimate import TrainConfig, frame_spec
from cabinpose.estimate.batch import NOT_LABELLED
from cabinpose.evaluate import ModelErrors, OverRepeats, RowDifference
from cabinpose.store import labelled_joints, open_dataset

Write = Callable[..., Path]
Run = Callable[..., Any]


def plan_of(write: Write, tmp_path: Path) -> ExperimentPlan:
    return make_plan(load(write()), "paper", tmp_path / "out", {})


def test_a_mean_error_says_how_many_joints_it_is_of() -> None:
    number = OverRepeats(4.0, 3.0, 5.0, (4.0,))
    assert cell_text(number, 87.5) == ("4.0", "3.0 to 5.0, of 87.5 % found")
    assert cell_text(number) == ("4.0", "3.0 to 5.0")
    nothing = OverRepeats(math.nan, math.nan, math.nan, (math.nan,))
    assert cell_text(nothing, 0.0) == ("none found", "")
    assert cell_text(nothing) == ("–", "")


def test_frames_that_are_worth_others_are_read_off_by_the_logarithm() -> None:
    """An error that falls by 1 cm where the frames are doubled: 10 cm at 100, 9 at 200, 8 at 400."""
    alone = ([100.0, 200.0, 400.0], [10.0, 9.0, 8.0])
    mixed = ([0.0, 100.0, 200.0, 400.0, 800.0], [10.5, 9.5, 8.5, 8.0, 7.0])
    rows = as_many_rows({"alone": alone, "mixed": mixed})
    assert rows[0] == ["", "frames", "as many of alone"]
    between = [f"{100 * 2**0.5:.0f}", f"{200 * 2**0.5:.0f}"]
    assert [row[2] for row in rows[1:]] == ["fewer than 100", *between, "400", "more than 400"]
    shares = {"alone": (alone[0], [50.0, 60.0, 70.0]), "mixed": ([10.0, 20.0, 30.0], [40.0, 65.0, 71.0])}
    assert [row[2] for row in as_many_rows(shares)[1:]] == ["fewer than 100", f"{200 * 2**0.5:.0f}", "more than 400"]
    assert len(as_many_rows({"alone": ([100.0], [3.0]), "mixed": mixed})) == 1


def test_what_is_not_sure_of_a_difference_stands_in_parentheses(write: Write, tmp_path: Path) -> None:
    away = {
        ("A", "B"): RowDifference(2.04, 0.1, 4.0),
        ("A", "C"): RowDifference(2.0, -0.1, 4.0),
        ("B", "C"): RowDifference(0, 0, 0),
    }
    pairs = away | {(b, a): RowDifference(-d.value, -d.high, -d.low) for (a, b), d in away.items()}
    results = Results({}, {}, {}, {}, {}, {"PCKh@0.5": pairs, "error cm": pairs}, {})
    ((title, rows),) = first_differences(plan_of(write, tmp_path), results)
    assert title == "PCKh@0.5"
    assert rows[0] == ["", "A", "B", "C"]
    assert rows[1] == ["A", "", "+2.0", "(+2.0)"]
    assert rows[2][:2] == ["B", "-2.0"]
    assert "error cm,B,A,-2.0400,-4.0000,-0.1000" in differences_csv(results).splitlines()


def test_from_end_to_end(write: Write, run: Run, tmp_path: Path) -> None:
    """Made once; a second run makes nothing; a row more makes its own cells; the page is made again from what is there."""
    words = ("--scale", "paper", "--out", tmp_path / "out", "--workers", 1, "--resamples", 50, "--json")
    first = run("experiment", "run", write(), *words)
    assert first.code == 0, first.err
    told = json.loads(first.out)
    assert (told["cells"], told["made"]) == (5, 5)  # three people, a training, a test
    page = Path(told["page"])
    text = page.read_text()
    assert "real is a stand-in, generated, for recordings of three people" in text
    assert "published 13.47" in text
    assert all(f"<title>{name}</title>" in text for name in ("R1", "Head", "Wrist"))  # lines of the charts
    charts = {f"{name}.{kind}" for name in ("accuracy-T", "joints-T-R1", "training-R1") for kind in ("png", "svg")}
    files = {"index.html", "table.md", "table.csv", "differences.csv", "report.json", "experiment.json"} | charts
    sheets = {p.name for p in page.parent.iterdir()} - files
    assert files <= {p.name for p in page.parent.iterdir()}
    assert sheets <= {f"frames-T-{kind}.png" for kind in ("good-frames", "one-joint-fails", "a-body-fails")}
    assert sheets  # frames are good, or something in them fails: here nobody has learnt much
    assert ET.parse(page.parent / "accuracy-T.svg").getroot().tag.endswith("svg")
    numbers = json.loads((page.parent / "report.json").read_text())["numbers"]
    assert 0.0 <= numbers["R1: PCKh@0.5"]["value"] <= 100.0
    errors = next(each for each in plan_of(write, tmp_path).tested.values())[0].errors()[0].error_m
    share = 100 * np.isfinite(errors).sum() / (~np.isnan(errors)).sum()
    told = "none found" if share == 0 else f"of {share:.1f} % found"
    assert told in text
    assert told in (page.parent / "table.md").read_text()
    assert f",{share:.4f}," in (page.parent / "table.csv").read_text()
    assert "13.47" in (page.parent / "table.md").read_text()
    records = {path: path.read_bytes() for path in (tmp_path / "out").rglob("cell.json")}
    assert len(records) == 5

    stamp, began = page.stat().st_mtime_ns, time.process_time()
    again = run("experiment", "run", write(), *words)
    assert time.process_time() - began < 5.0
    assert json.loads(again.out)["made"] == 0
    assert page.stat().st_mtime_ns == stamp
    assert {path: path.read_bytes() for path in (tmp_path / "out").rglob("cell.json")} == records

    last = next((tmp_path / "out" / "trained").glob("*/last.ckpt"))
    model = last.with_name("model.onnx")
    weights, stamp = model.read_bytes(), last.stat().st_mtime_ns
    last.with_name("cell.json").unlink()  # as a run that was killed before its end
    resumed = run("experiment", "run", write(), *words)
    assert json.loads(resumed.out)["made"] == 1
    assert json.loads(last.with_name("cell.json").read_text())["resumed"]
    assert (model.read_bytes(), last.stat().st_mtime_ns) == (weights, stamp)

    page.unlink()
    moved = page.parents[2].rename(tmp_path / "moved") / "small" / "paper"
    record = next(moved.parents[1].glob("tested/*/cell.json"))
    record.write_text(json.dumps(json.loads(record.read_text()) | {"code": "older"}))
    remade = run("experiment", "report", moved, "--resamples", 50)
    assert remade.code == 0, remade.err
    text = (moved / "index.html").read_text()
    assert "published 13.47" in text
    assert "made by another state of the code than this one: R1 on T<" in text

    (tmp_path / "more").mkdir()
    other = write(name="more/small.yaml")
    done = run("experiment", "run", other, "--scale", "paper", "--out", moved.parents[1])
    assert (done.code, "has the page of another file" in done.err) == (2, True), done.err
    asked = json.loads((moved / "experiment.json").read_text())
    refuse_other(moved, asked)
    with pytest.raises(ConfigError, match="has the page of another --data"):
        refuse_other(moved, asked | {"data": {"real": "my-cars"}})


def test_what_is_asked_for_last_is_what_report_shows(tmp_path: Path) -> None:
    """Also where a page of the file before a row was added is there, and the run of the new one never ends."""
    for experiment in ({"title": "one row"}, {"title": "two rows"}):
        begin(tmp_path, {"file": "a.yaml", "experiment": experiment})
    assert json.loads((tmp_path / "experiment.json").read_text())["experiment"] == {"title": "two rows"}


@pytest.mark.slow
def test_a_kill_loses_the_epoch_under_way_at_most(
    write: Write, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After kill -9 no whole epoch is trained again, and the model is the one that would have been."""
    epochs, drawn = 6, list[int]()
    words = ("experiment", "run", write({"scales": {"paper": {"steps": 10 * epochs, "epochs": epochs}}}), "--scale", "paper")
    command = [sys.executable, "-m", "cabinpose", *map(str, words), "--out", str(tmp_path / "killed"), "--workers", "1"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        while process.poll() is None and sum(len(path.read_text().splitlines()) for path in metrics(tmp_path / "killed")) < 3:
            time.sleep(0.01)
        process.kill()
    assert process.returncode == -signal.SIGKILL
    (last,) = (tmp_path / "killed" / "trained").glob("*/last.ckpt")
    whole = torch.load(last, weights_only=False)["epoch"] + 1
    assert whole >= 1
    assert not last.with_name("cell.json").exists()
    plan = make_plan(load(Path(words[2])), "paper", tmp_path / "killed", {})
    shares = [cell.made_share for cell in plan.cells]
    assert shares[:3] == [1.0, 1.0, 1.0]  # three people, a training, a test
    assert shares[3] * epochs in (pytest.approx(whole), pytest.approx(whole + 1))  # killed between its table and its checkpoint
    assert shares[4] == 0.0
    shown = run("experiment", "report", tmp_path / "killed" / "small" / "paper")
    assert (shown.code, "1 of 5 cells are not made" in shown.out or "2 of 5 cells are not made" in shown.out) == (0, True), (
        shown.err
    )
    for name in ("data", "made"):
        shutil.copytree(tmp_path / "killed" / name, tmp_path / "undisturbed" / name)
    monkeypatch.setattr(raster, "write_curves", lambda *_: drawn.append(1))  # once an epoch
    assert run(*words, "--out", tmp_path / "killed", "--workers", 1).code == 0
    assert len(drawn) == epochs - whole
    assert run(*words, "--out", tmp_path / "undisturbed", "--workers", 1).code == 0
    assert len(drawn) == 2 * epochs - whole
    tables: list[Any] = []
    models: list[dict[str, Any]] = []
    for name in ("killed", "undisturbed"):
        (table,) = metrics(tmp_path / name)
        (model,) = (tmp_path / name / "trained").glob("*/last.ckpt")
        tables.append(np.loadtxt(table, delimiter=",", skiprows=1))
        models.append(torch.load(model, weights_only=False)["state_dict"])
    np.testing.assert_allclose(*tables, rtol=1e-5)  # of validation, sums in float32 whose order depends on where arrays lie
    assert all(torch.equal(models[0][key], models[1][key]) for key in models[1])


def metrics(out: Path) -> list[Path]:
    return list(out.glob("trained/*/log/metrics.csv"))


TEST_FRAMES: dict[str, tuple[Callable[[xr.Dataset], xr.Dataset], str, str]] = {
    "no amplitude": (lambda data: data.drop_vars("amplitude"), "has no amplitude", "amplitude: false"),
    "no joints": (lambda data: data.assign(visibility=0 * data["visibility"]), "nobody whose joints are known", ""),
    "no place": (
        lambda data: data.assign_coords(person=["rear_left", *data["person"].values[1:]]),
        "has no place driver",
        "slots",
    ),
}


def test_frames_of_a_test_that_cannot_be_judged_are_refused_before_training(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = make_plan(load(write()), "paper", tmp_path / "out", {})
    make_cells(made.made, 1, lambda *_: None)
    made.check_frames(made.cells)
    for changed, error, hint in TEST_FRAMES.values():

        def of_test(part: Any, drawn: Any, settings: Any, changed: Any = changed) -> dict[str, xr.Dataset]:
            found = opened(part, drawn, settings)
            return {name: changed(data) for name, data in found.items()} if part.subject == ("P3",) else found

        monkeypatch.setattr("cabinpose.app.experiment.plan.opened", of_test)
        with pytest.raises(DatasetError, match=f"^test T: real/P3: .*{error}") as raised:
            made.check_frames(made.cells)
        assert hint in str(raised.value.hint)


def test_numbers_are_of_the_repeats_that_are_there() -> None:
    cells: Any = [SimpleNamespace(key=key, done=key != "b", errors=lambda key=key: key) for key in "abc"]
    assert list(_ErrorsRead().runs(cells)) == ["a", "c"]


def test_a_mean_error_says_over_which_joints_it_is() -> None:
    """By hand: from the root it is over joints but the root, of people whose root was found."""
    names = ("hips", "head", "neck")
    metres = np.array([[0.1, 0.1, np.inf], [np.inf, 0.1, np.nan]])
    relative = np.array([[np.nan, 0.2, np.nan], [np.nan, np.nan, np.nan]])
    errors = ModelErrors(
        np.arange(2), np.arange(2), metres * 100, metres, relative, np.ones(2), np.ones(2), metres * np.nan,
        np.zeros((0, 0, 0), np.int64),
    )  # fmt: skip
    mean, from_root = (
        TableColumn(title="A", test="T", measure=measure, space="3d") for measure in ("mean_error", "root_relative_error")
    )
    assert _found_share([(errors, names)], mean, "hips") == pytest.approx(100 * 3 / 5)
    assert _found_share([(errors, names)], from_root, "hips") == pytest.approx(100 * 1 / 3)
    whole = errors._replace(relative_m=np.array([[np.nan, 0.2, 0.1], [np.nan, 0.2, np.nan]]))
    assert _found_share([(errors, names), (whole, names)], from_root, "hips") == pytest.approx((100 / 3 + 100) / 2)


@pytest.mark.slow
def test_frames_that_a_folder_shares_are_refused(write: Write, run: Run, tmp_path: Path) -> None:
    """The user's folder in place of the stand-in shows who is in it: whoever is tested must not be learnt from."""
    plan = make_plan(load(write()), "paper", tmp_path / "out", {})
    make_cells(plan.made[:1], 1, lambda *_: None)
    folder = plan.made[0].piece.folder  # of P1 alone
    everybody: dict[str, Any] = {"R1": {"train": [{"data": "real"}], "validation": [{"data": "real"}], "may_share": ["subject"]}}
    tests: dict[str, Any] = {"T": {"frames": [{"data": "real"}], "may_share": ["car"]}}
    file = write({"trainings": everybody, "tests": tests})
    words = ("--scale", "paper", "--out", tmp_path / "more", "--data", f"real={folder}")
    done = run("experiment", "run", file, *words)
    assert (done.code, "share the subject P1" in done.err) == (2, True), done.err
    tests["T"]["may_share"].append("subject")
    everybody["R1"]["validation"][0]["frames"] = 1
    done = run("experiment", "run", write({"trainings": everybody, "tests": tests}), *words)
    assert (done.code, "share the frame" in done.err) == (2, True), done.err
    assert not list((tmp_path / "more").rglob("last.ckpt"))
    told = run("experiment", "show", write({"trainings": everybody, "tests": tests}), *words, "--json")
    counts = {each["cell"]: each["frames"] for each in json.loads(told.out)["cells"]}
    assert counts == {"R1": 4, "R1 on T": 4}
    everybody["R1"]["train"][0]["action"] = ["dance"]
    done = run("experiment", "show", write({"trainings": everybody, "tests": tests}), *words)
    assert (done.code, "training R1: real has no action 'dance'" in done.err) == (2, True), done.err
    del everybody["R1"]["train"][0]["action"]
    repeated = write({"trainings": everybody, "tests": tests, "scales": {"paper": {"repeats": 2}}})
    for only in ("R1.1", "R1.2"):
        done = run("experiment", "run", repeated, *words, "--only", only)
        assert (done.code, "share the frame" in done.err) == (2, True), done.err


def test_rooms_and_cars_are_mixed_and_so_are_kinds_of_depth(write: Write, tmp_path: Path) -> None:
    """A person who stands is taken for the driver, and the depth of a part may be another image than that of the others."""
    room = {"scene": {"kind": "room", "rooms": 1}, "people": {"subjects": [], "random": {"count": 2}},
            "camera": {"sensor": "kinect_v1", "views": {"room": 1.0}}, "noise": {"kind": "structured_light"}}  # fmt: skip
    named = ("head", "neck", "lshoulder", "rshoulder", "lelbow")
    parts = [
        {"data": "real", "subject": ["P1"], "frames": 2, "depth": "depth_clean"},
        {"data": "rooms", "frames": 3, "places": {"standing": "driver"}, "joints": {f"itop.{joint}": joint for joint in named}},
    ]
    file = write({
        "recipe": {"settings": {"max_depth_m": 5.0}}, "data": {"rooms": {"synth": room, "frames": 3}},
        "trainings": {"R1": {"train": parts}},
    })  # fmt: skip
    plan = make_plan(load(file), "paper", tmp_path / "out", {})
    make_cells(plan.made, 1, lambda *_: None)
    cell = plan.trained["R1"][0]
    learnt, judged = cell.drawn()
    sides = (_sides(cell.train, learnt, cell.settings), _sides(cell.validation, judged, cell.settings))
    assert {name: part.sizes["frame"] for name, part in sides[0].items()} == {"real/P1": 2, "rooms": 3}
    car, rooms = sides[0].values()
    source = open_dataset(cell.train[0].pieces[0].folder).isel(frame=learnt[0][0][1])
    np.testing.assert_array_equal(car["depth"].values, source["depth_clean"].values)
    assert not np.array_equal(source["depth"].values, source["depth_clean"].values)
    assert rooms["person"].values.tolist() == ["driver"]
    assert set(labelled_joints(rooms)) == set(named)
    training, _ = stored_frames(sides, frame_spec(TrainConfig.model_validate(cell.recipe)))
    frames = [training[i] for i in range(5)]
    assert all(frame.present.tolist() == [True] for frame in frames)
    far = [float(np.nanmean(frame.joints[0, :, 2])) for frame in frames]
    assert [int((frame.visibility[0] == NOT_LABELLED).sum()) for frame in frames] == [0, 0, 15, 15, 15]
    assert max(far[:2]) < 1.5 < min(far[2:])  # m: a car's driver, somebody across a room


def test_draws_are_the_same_nested_and_apart(write: Write, tmp_path: Path) -> None:
    plan = make_plan(load(write()), "paper", tmp_path / "out", {})
    make_cells(plan.made[:1], 1, lambda *_: None)
    folder = plan.made[0].piece.folder

    def drawn(learnt: int, judged: int) -> list[list[int]]:
        rows = {"R1": {"train": [{"data": "real", "frames": learnt}], "validation": [{"data": "real", "frames": judged}],
                       "may_share": ["subject"]}}  # fmt: skip
        file = write({"trainings": rows, "tests": {"T": {"frames": [{"data": "real"}], "may_share": ["car", "subject"]}}})
        cell = make_plan(load(file), "paper", tmp_path / "out", {"real": folder}).trained["R1"][0]
        return [[int(i) for each in side for _, positions in each for i in positions] for side in cell.drawn()]

    assert open_dataset(folder).sizes["frame"] == 4
    assert not plan.made[0].record["resumed"]
    (plan.made[0].folder / "cell.json").unlink()
    assert plan.made[0].make()["resumed"]  # its frames lie beside its record
    few, more = drawn(1, 1), drawn(3, 1)
    assert set(few[0]) < set(more[0])
    assert few[1] == more[1]
    assert sorted(more[0] + more[1]) == [0, 1, 2, 3]
    with pytest.raises(ConfigError, match="4 frames of real are asked for at this scale, and the selection has 3"):
        drawn(4, 1)


@dataclass(frozen=True)
class Note(ExperimentCell):
    """A cell that notes which of those that it needs were there."""

    before: tuple[Path, ...] = ()

    @property
    def frame_count(self) -> int:
        return 0

    def _made(self) -> dict[str, Any]:
        return {"there": [path.exists() for path in self.before]}


def test_a_cluster_makes_each_cell_after_those_that_it_needs(tmp_path: Path) -> None:
    names = ["a", "b", "c", "d"]
    needs = {"a": (), "b": (), "c": ("a", "b"), "d": ("c",)}
    cells = [Note(n, n, tmp_path / n, needs[n], 0.0, tuple(tmp_path / other / "cell.json" for other in needs[n])) for n in names]
    made: list[str] = []
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp://", host="127.0.0.1", dashboard_address=None,
        silence_logs="ERROR",
    ) as cluster:  # fmt: skip
        make_cells(cells, cluster.scheduler_address, lambda cell, _: made.append(cell.name))
    assert sorted(made) == names
    assert made.index("c") > max(made.index("a"), made.index("b"))
    assert all(all(cell.record["there"]) for cell in cells)
    make_cells(cells, 1, lambda cell, _: made.append(cell.name))
    assert len(made) == 4


def test_workers_of_several_threads_are_refused(tmp_path: Path) -> None:
    with (
        LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, protocol="tcp://", host="127.0.0.1", dashboard_address=None,
        ) as cluster,
        pytest.raises(ConfigError, match="makes several cells at a time") as caught,
    ):  # fmt: skip
        make_cells([Note("a", "a", tmp_path / "a", (), 0.0)], cluster.scheduler_address, lambda *_: None)
    assert "--nthreads 1" in caught.value.hint


@pytest.mark.slow
def test_a_rows_tests_come_before_the_next_row_also_of_several_workers() -> None:
    """Who interrupts a long run has the numbers of what was trained."""
    handed = list[str]()

    class AtOnce(Executor):
        def submit(self, _: Any, cell: Any) -> Future[dict[str, Any]]:  # type: ignore[override]
            handed.append(cell.name)
            future = Future[dict[str, Any]]()
            future.set_result({})
            return future

    needs = {"A": (), "A on T": ("A",), "B": (), "B on T": ("B",), "C": (), "C on T": ("C",)}
    cells: Any = [SimpleNamespace(name=name, key=name, needs=of) for name, of in needs.items()]
    _spread(cells, AtOnce(), lambda *_: None, at_once=2)
    assert handed == ["A", "B", "A on T", "B on T", "C", "C on T"]


@dataclass(frozen=True)
class Asleep(Note):
    """A cell that takes ten minutes but for one that is called `soon`."""

    def _made(self) -> dict[str, Any]:
        if self.name != "soon":
            (self.folder / "begun").touch()
            time.sleep(600)
        while not (self.folder.parent / "late" / "begun").exists():
            time.sleep(0.05)
        return {}


@pytest.mark.slow
def test_cells_under_way_end_with_the_process_that_asked_for_them(tmp_path: Path) -> None:
    """Who ends it by its process id alone, as a job's scheduler does, does not wait for a training."""

    def told(*_: Any) -> None:
        raise Ended

    cells = [Asleep(name, name, tmp_path / name, (), 0.0) for name in ("soon", "late")]
    began = time.monotonic()
    with pytest.raises(Ended):
        make_cells(cells, 2, told)
    assert time.monotonic() - began < 120
    assert multiprocessing.active_children() == []
    assert not cells[1].done


def test_no_scheduler(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no Dask scheduler answers"):
        make_cells([Note("a", "a", tmp_path / "a", (), 0.0)], "tcp://127.0.0.1:1", lambda *_: None)
