"""`cabinpose serve`, and `--model grpc://...` of the other commands."""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "store"))

import sphere_people
from somebodys_server import good_answer

import cabinpose
from cabinpose.core import imports
from cabinpose.estimate.remote import open_predictor

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return sphere_people.write(tmp_path_factory.mktemp("spheres") / "dataset", sphere_people.manifest())


@pytest.mark.slow
def test_serve_answers_what_predict_finds(process: Callable[..., Any], run: Run, dataset: Path, tmp_path: Path) -> None:
    server = process("-m", "cabinpose", "serve", "--model", "in_car", "--port", "0")
    address = server.stdout.readline().strip()
    assert address.startswith("grpc://127.0.0.1:")
    for name, model in (("here", "in_car"), ("there", address), ("wire", f"{address}?shared_memory=off")):
        assert run("predict", dataset, "--model", model, "--out", tmp_path / f"{name}.jsonl").code == 0
    header, rows = (tmp_path / "here.jsonl").read_text("utf-8").split("\n", 1)
    says = json.loads(header)
    assert says.pop("joint_definition") == "anatomy"  # the protocol has no word for it
    for name in ("there", "wire"):
        theirs, its_rows = (tmp_path / f"{name}.jsonl").read_text("utf-8").split("\n", 1)
        assert (json.loads(theirs), its_rows) == (says, rows)
    done = run("evaluate", dataset, "--model", address, "--out", tmp_path / "report", "--json")
    assert done.code == 0, done.err
    report = cabinpose.evaluate_predictions(dataset, address)
    assert [m["model"] for m in json.loads(done.out)["models"]] == [report.model] == ["in_car"]
    server.send_signal(signal.SIGINT)
    assert server.wait(20) == 0
    assert "answered, 0 refused" in server.stderr.read()


@pytest.mark.parametrize(
    "kind", [signal.SIGTERM, *(pytest.param(kind, marks=pytest.mark.slow) for kind in (signal.SIGHUP, signal.SIGINT))]
)
def test_what_ends_a_server_answers_the_calls_under_way(process: Callable[..., Any], kind: signal.Signals) -> None:
    server = process("-m", "cabinpose", "serve", "--model", "room", "--port", "0")
    address = server.stdout.readline().strip()
    remotes = [open_predictor(address) for _ in range(6)]
    k = np.array([[285.7, 0, 160], [0, 285.7, 120], [0, 0, 1]])
    frames = {"depth": np.full((1, 240, 320), 2.0, np.float32), "camera_k": k, "camera_dist": np.zeros(5)}
    for remote in remotes:
        remote.predict(frames)
    begun = threading.Barrier(len(remotes) + 1)

    def ask(remote: Any) -> bool:
        begun.wait()
        return bool(remote.predict(frames).joints_3d.shape[0] == 1)

    with ThreadPoolExecutor(len(remotes)) as pool:
        answers = [pool.submit(ask, remote) for remote in remotes]
        begun.wait()
        time.sleep(0.03)
        server.send_signal(kind)
        ended = [answer.exception() for answer in answers]
    assert server.wait(20) == 0
    said = server.stderr.read()
    assert any(error is None for error in ended)
    answered = 3 * len(remotes) - sum(error is not None for error in ended)  # to connect, to warm up, and what was under way
    assert f"{answered} answered, 0 refused" in said
    assert "Traceback" not in said


def test_serve_takes_what_it_is_told(process: Callable[..., Any]) -> None:
    server = process(
        "-m", "cabinpose", "serve", "--model", "room", "--port", "0", "--name", "mine", "--seconds", "0.1", "--json"
    )  # fmt: skip
    told = json.loads(server.communicate(timeout=60)[0])
    assert told["address"].endswith("/mine")
    assert (told["answered"], told["refused"]) == (0, 0)


def test_no_time_to_serve_is_refused(run: Run) -> None:
    assert "--seconds nan is no time to serve" in run("serve", "room", "--port", "0", "--seconds", "nan").err


def test_failures_are_told_and_counted(algorithm: Any, run: Run, dataset: Path, tmp_path: Path) -> None:
    _, address = algorithm(lambda r: {} if r.id == "1" else good_answer(r))
    stopped = run("predict", dataset, "--model", address, "--out", tmp_path / "a.jsonl")
    assert stopped.code == 2
    assert stopped.err.splitlines()[-2:] == [
        f"error: {address}: frame 1: there is neither joints_2d nor joints_3d",
        "hint: on_error=skip behind the address (grpc://...?on_error=skip) goes on without such frames",
    ]
    assert not (tmp_path / "a.jsonl").exists()
    skipped = run("predict", dataset, "--model", f"{address}?on_error=skip", "--out", tmp_path / "a.jsonl")
    assert skipped.code == 0
    assert f"warning: {address}: frame 1: there is neither joints_2d nor joints_3d; it has no joints" in skipped.err
    assert "theirs: 1 frames without an answer" in skipped.err
    rows = [json.loads(line) for line in (tmp_path / "a.jsonl").read_text().splitlines()]
    assert sorted({row["frame"] for row in rows if "frame" in row}) == [0, 2, 3, 4]
    evaluated = run("evaluate", dataset, "--model", f"{address}?on_error=skip")
    assert evaluated.code == 0
    assert "theirs: 1 frames without an answer" in evaluated.err


def test_without_the_extra_the_hint_names_it(run: Run, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = imports.importlib.import_module

    def absent(name: str, package: str | None = None) -> ModuleType:
        if name.startswith("cabinpose"):
            return real(name, package)
        raise ModuleNotFoundError(f"No module named {name!r}", name=name.partition(".")[0])

    monkeypatch.setattr(imports.importlib, "import_module", absent)
    from cabinpose.app.cli import predict, serve

    for command in (
        lambda: predict.run(predict.Predict(dataset=dataset, model="grpc://pc:1/m", out=tmp_path / "a.jsonl")),
        lambda: serve.run(serve.Serve(model="in_car")),
    ):  # fmt: skip
        with pytest.raises(cabinpose.core.errors.DependencyError, match="tritonclient, which is not installed") as caught:
            command()
        assert caught.value.hint == "pip install 'cabinpose[remote]'"


def test_bench_remote_measures_all_ways() -> None:
    from benchmarks.remote import run

    made = run(frames=30, say=lambda _: None)
    ways = made["ways"]
    assert set(ways) == {"echo", "receive", "wire", "shared_memory"}
    assert all(0 < way["median_ms"] <= way["p95_ms"] for way in ways.values())
    assert made["ratio_p95"]["wire_to_echo"] == pytest.approx(ways["wire"]["p95_ms"] / ways["echo"]["p95_ms"])
    assert np.isfinite(list(made["ratio_p95"].values())).all()
