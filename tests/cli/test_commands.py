"""The command line: exit codes, what goes to stdout and what to stderr, errors with their hint."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

from cabinpose.app.cli import VERBS, output
from cabinpose.store import open_dataset
from cabinpose.synth.config import SynthConfig, room_preset

Run = Callable[..., Any]


def test_help_names_every_verb(run: Run) -> None:
    code, out, err = run("--help")
    assert code == 0
    assert all(f"\n  {verb} " in out for verb in VERBS)
    assert err == ""
    assert run() == (code, out, err)


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help(run: Run, verb: str) -> None:
    code, out, _ = run(verb, "--help")
    assert code == 0
    assert f"usage: cabinpose {verb}" in out


LOADED = "import sys\nfrom cabinpose.app.cli import VERBS, main, verb_module\n{}\nprint(*sys.modules, file=sys.stderr)"


@pytest.mark.parametrize(("code", "tyro"), [("main(['--help'])", False), ("[verb_module(verb) for verb in VERBS]", True)])
def test_help_loads_nothing_heavy(code: str, tyro: bool) -> None:
    """The list of verbs loads no library; the module of a verb, which its help needs, only tyro and settings."""
    done = subprocess.run([sys.executable, "-c", LOADED.format(code)], check=True, capture_output=True, text=True)
    modules = set(done.stderr.split())
    assert not {"numpy", "xarray", "zarr", "dask", "cv2", "scipy", "pydantic", "rich", "typeguard", "yaml", "PIL"} & modules
    assert ("tyro" in modules) == tyro
    rooms = {name.split(".")[1] for name in modules if name.startswith("cabinpose.")}
    settings = {"evaluate", "evaluate.options"} if tyro else set()
    assert {name for name in modules if name.startswith("cabinpose.evaluate")} == {f"cabinpose.{name}" for name in settings}
    assert rooms - {"evaluate"} == {"app", "core"}


@pytest.mark.parametrize("words", [["export", "coco"], ["import", "itop"], ["import", "azure-mkv"], ["emulate", "mvn"]])
def test_help_of_a_choice_loads_nothing_slow(words: list[str]) -> None:
    """Its module, with numpy and pydantic, is imported for the options; what only work needs would double the time of help."""
    code = f"try:\n    main({[*words, '--help']})\nexcept SystemExit:\n    pass"
    done = subprocess.run([sys.executable, "-c", LOADED.format(code)], check=True, capture_output=True, text=True)
    assert "tyro" in done.stderr.split()
    slow = {"xarray", "pandas", "zarr", "dask", "h5py", "numcodecs", "scipy.spatial", "scipy.ndimage", "scipy.optimize"}
    assert not slow & set(done.stderr.split())


def test_benchmarks_are_of_a_checkout(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("cabinpose.__file__", str(tmp_path / "lib" / "site-packages" / "cabinpose" / "__init__.py"))
    assert run("bench", "synth") == (
        2,
        "",
        (
            "error: the benchmarks are part of a checkout of cabinpose, not of the installed package\n"
            "hint: clone the repository, then `make bench`, or `.venv/bin/cabinpose bench` there\n"
        ),
    )


@pytest.mark.parametrize(
    "arguments",
    [
        ("synth", "--config", "a", "--frames", "1", "--out", "b", "--frame-rate", "3"),
        ("synth", "--config", "a", "--frames", "many", "--out", "b"),
        ("info",),
        ("inform", "x"),
        ("config",),
    ],
)
def test_wrong_usage_exits_with_2(run: Run, arguments: tuple[str, ...]) -> None:
    code, out, err = run(*arguments)
    assert code == 2
    assert out == ""
    assert err


def test_errors_carry_one_hint(run: Run, tmp_path: Path) -> None:
    code, out, err = run("info", tmp_path)
    assert (code, out) == (2, "")
    assert err.splitlines() == [
        f"error: {tmp_path} holds no dataset: dataset.yaml is missing",
        "hint: give the folder that holds dataset.yaml",
    ]


def test_info(run: Run, dataset_folder: Path) -> None:
    code, out, err = run("info", dataset_folder)
    assert (code, err) == (0, "")
    for words in (
        "5 in 3 of 3 parts",
        "64x48",
        "sedan 2, van 2, coupe 1",
        "driver 3, front_row 2",
        "driver 5, front_passenger 3",
    ):
        assert words in out
    assert "35.7 % of 14 poses; rejected: car 6, self 3" in out


def test_info_json_is_one_object(run: Run, dataset_folder: Path) -> None:
    code, out, err = run("info", dataset_folder, "--json", "--verify")
    assert (code, err) == (0, "")
    assert out.count("\n") == 1
    data = json.loads(out)
    assert data["frames"] == 5
    assert data["by_subject"] == {"S01": 3, "S02": 2, "S03": 2, "S04": 2}
    assert data["by_people"] == {"1": 2, "2": 2, "3": 1}
    assert data["acceptance"] == pytest.approx(5 / 14)
    assert sum(data["depth_histogram"]) == pytest.approx(1, abs=1e-4)
    assert data["verified"] is True


def test_info_counts_missing_parts(run: Run, spheres: ModuleType, tmp_path: Path) -> None:
    import shutil

    spheres.write(tmp_path, spheres.manifest())
    shutil.rmtree(tmp_path / "part-00001.zarr")
    code, out, _ = run("info", tmp_path)
    assert code == 0
    assert "3 in 2 of 3 parts of 5 planned: go on with --resume" in out


def test_info_verify_finds_a_flipped_bit(run: Run, spheres: ModuleType, tmp_path: Path) -> None:
    spheres.write(tmp_path, spheres.manifest())
    shard = tmp_path / "part-00001.zarr" / "confidence" / "c" / "0" / "0" / "0"
    data = bytearray(shard.read_bytes())
    data[100] ^= 1
    shard.write_bytes(data)
    code, _, err = run("info", tmp_path, "--verify")
    assert code == 2
    assert "part-00001.zarr is damaged: cannot read confidence" in err


@pytest.mark.parametrize("scene", ["cabin", "room"])
def test_config_init_is_the_default(run: Run, tmp_path: Path, scene: str) -> None:
    path = tmp_path / "scene.yaml"
    code, out, _ = run("config", "init", path, "--scene", scene)
    assert (code, out) == (0, "")
    assert SynthConfig.load(path) == (room_preset() if scene == "room" else SynthConfig())
    assert "# " in path.read_text()
    assert run("config", "init", "--scene", scene)[1] == path.read_text()
    code, out, _ = run("config", "check", path)
    assert code == 0
    assert "is valid" in out
    code, _, err = run("config", "init", path)
    assert code == 2
    assert "exists" in err


@pytest.mark.slow
def test_config_check_counts_the_random_cars(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    for cars, said in (
        ("[]", "cabin, cars 40 drawn at random\n"),
        ("[suv, van]", "cabin, cars suv, van and 40 drawn at random\n"),
    ):
        path.write_text(f"scene: {{kind: cabin, cars: {cars}, random_cars: 40}}\n")
        assert said in run("config", "check", path)[1]


def test_config_check_names_the_key(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("camera:\n  jiter_m: 0.1\n")
    code, out, err = run("config", "check", path)
    assert (code, out) == (2, "")
    assert "camera.jiter_m: unknown key" in err
    assert "hint: did you mean camera.jitter_m" in err
    assert run("config", "check", tmp_path / "absent.yaml")[0] == 2


def test_config_schema_is_json(run: Run) -> None:
    code, out, _ = run("config", "schema")
    assert code == 0
    assert set(SynthConfig.model_fields) == set(json.loads(out)["properties"])


def test_export(run: Run, dataset_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "coco"
    code, text, _ = run("export", "coco", "--out", out, dataset_folder, "--json")
    assert code == 0
    assert json.loads(text) == {"out": str(out), "format": "coco", "frames": 5}
    assert (out / "annotations" / "person_keypoints.json").exists()
    code, _, err = run("export", "coco", "--out", out, dataset_folder)
    assert code == 2
    assert "hint: --overwrite" in err
    code, _, err = run("export", "coc", "--out", tmp_path / "x", dataset_folder)
    assert code == 2
    assert "hint: did you mean coco? known: bvh, c3d, coco, csv, dataset, itop, ntu, onnx, ply, png-json, sto, trc, yolo" in err


def test_export_of_a_split(run: Run, dataset_folder: Path, tmp_path: Path) -> None:
    splits = tmp_path / "splits.yaml"
    splits.write_text("train: {car: [sedan, van]}\ntest: {car: [coupe]}\n")
    out = tmp_path / "ply"
    code, _, _ = run("export", "ply", "--out", out, dataset_folder, "--splits", splits, "--split", "test")
    assert code == 0
    assert [p.name for p in out.iterdir()] == ["00000002.ply"]
    code, _, err = run("export", "ply", "--out", out, dataset_folder, "--splits", splits)
    assert code == 2
    assert "--split NAME" in err
    code, _, err = run("export", "ply", "--out", out, dataset_folder, "--splits", splits, "--split", "val")
    assert code == 2
    assert "known: test, train" in err


def test_an_export_replaces_no_dataset(run: Run, dataset_folder: Path, tmp_path: Path) -> None:
    data = shutil.copytree(dataset_folder, tmp_path / "data" / "my")
    (tmp_path / "data" / "thesis.txt").write_text("x")
    held = sorted((tmp_path / "data").rglob("*"))
    for source in (data, dataset_folder):
        code, _, err = run("export", "coco", source, "--out", tmp_path / "data", "--overwrite")
        assert (code, "never replaces" in err, "hint: " in err) == (2, True, True)
    deep = shutil.copytree(dataset_folder, tmp_path / "deep" / "a" / "b")
    assert run("export", "coco", deep, "--out", tmp_path / "deep", "--overwrite").code == 2
    assert sorted((tmp_path / "data").rglob("*")) == held
    splits = tmp_path / "splits.yaml"
    splits.write_text("a: {car: [sedan]}\nb: {car: [van]}\n")
    own = tmp_path / "coco"
    own.mkdir()
    (own / "thesis.txt").write_text("x")
    code, _, err = run("export", "coco", dataset_folder, "--out", own, "--overwrite")
    assert (code, "holds thesis.txt" in err, [path.name for path in own.iterdir()]) == (2, True, ["thesis.txt"])
    for more in ([], ["--overwrite"]):  # its own are exports, which may be made again
        assert run("export", "dataset", data, "--out", tmp_path / "own", "--splits", splits, *more).code == 0


def test_folds_are_those_of_the_whole_dataset(run: Run, dataset_folder: Path, tmp_path: Path) -> None:
    """Of coupe, sedan and van the second of two folds is sedan; of sedan alone the first would be."""
    splits, words = tmp_path / "splits.yaml", ("--select", "car=sedan", "--where", "frame < 5")
    splits.write_text("a: {sequence: [0], car/2: [2]}\nb: {sequence: [0], car/2: [1]}\n")
    code, _, err = run("export", "coco", dataset_folder, "--out", tmp_path / "all", "--splits", splits, *words)
    assert (code, "no frame of split 'b' has all that is selected" in err) == (2, True)
    out = tmp_path / "one"
    assert run("export", "coco", dataset_folder, "--out", out, "--splits", splits, "--split", "a", *words).code == 0
    assert sorted(path.name for path in out.rglob("*.png")) == ["00000000.png", "00000003.png"]
    code, _, err = run("info", dataset_folder, "--select", "car=sedan", "car=van")
    assert (code, err.splitlines()[-2:]) == (2, ["error: --select: car is named twice", "hint: write car=sedan,van"])


def test_synth_refuses_before_any_work(run: Run, dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    generate = import_module("cabinpose.synth.generate")  # the face has a function of this name
    monkeypatch.setattr(generate, "preflight", lambda *_, **__: None)  # the scene is not the subject, and takes seconds
    config = tmp_path / "scene.yaml"
    config.write_text("version: 1\n")
    before = open_dataset(dataset_folder).sizes["frame"]
    cases = [
        (("--workers", "2", "--scheduler", "tcp://x:1"), "one of --workers and --scheduler"),
        (("--resume", "--overwrite"), "one of --resume and --overwrite"),
        ((), "--resume goes on with it"),
        (("--resume",), "resume with the same configuration"),
        (("--frames", "0"), "at least 1 frame"),
    ]
    for flags, hint in cases:
        arguments = ["synth", "--config", config, "--out", dataset_folder, *flags]
        code, out, err = run(*arguments, *(() if "--frames" in flags else ("--frames", "5")))
        assert (code, out) == (2, ""), err
        assert hint in err
    assert open_dataset(dataset_folder).sizes["frame"] == before


def test_progress_is_silent_for_short_work_and_speaks_for_long(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr(output, "QUIET_S", 2.0)
    monkeypatch.setattr(output.time, "monotonic", lambda: now[0])
    with output.progress(1000, "frames", start=200) as report:
        for seconds, done in ((1.0, 300), (1.5, 350), (2.5, 450), (3.0, 500), (13.0, 900)):
            now[0] = 100.0 + seconds
            report(done, "7 rejected")
        now[0] += 50.0  # without another frame
        report(900, "7 rejected")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        "450/1000 frames, 100.0 frames/s, 6 s left, 7 rejected",
        "900/1000 frames, 53.8 frames/s, 2 s left, 7 rejected",
        "900/1000 frames, 11.1 frames/s, 7 rejected",
    ]


def test_work_in_which_nothing_is_counted_is_told_of_again_and_again(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, seconds in (("LOG_EVERY_S", 0.3), ("QUIET_S", 0.1), ("_BEAT_S", 0.02)):
        monkeypatch.setattr(output, name, seconds)
    with output.progress() as report:
        report.phase("calibrating")
        time.sleep(1.5)
    assert set(capsys.readouterr().err.splitlines()) >= {"0 s, calibrating", "1 s, calibrating"}


def test_bench_passes_its_flags_on(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, object] = {}

    def measure(*, say: Callable[[str], None], **flags: object) -> dict[str, object]:
        seen.update(flags)
        say("warming up")
        return {"frames_per_s": 123.4, "stages_ms": {"render": 5.0}}

    monkeypatch.setattr("benchmarks.synth.run", measure)
    code, out, err = run("bench", "synth", "--frames", "10", "--skip-blender", "--json")
    assert (code, err) == (0, "warming up\n")
    assert json.loads(out) == {"frames_per_s": 123.4, "stages_ms": {"render": 5.0}}
    assert seen == {"frames": 10, "repeats": 5, "workers": 2, "skip_blender": True, "memory_frames": 0}
    assert run("bench", "synth").out.splitlines() == ["frames_per_s      123.4", "stages_ms.render  5.0"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("live --frames 0", "--frames 0 measures nothing"), ("remote --frames -1", "--frames -1 measures nothing"),
        ("record --rate-mb 0", "--rate-mb 0 measures nothing"), ("record --folder nowhere", "there is no folder nowhere"),
        ("lab --views 1", "views: must be greater than or equal to 6"),
    ],
)  # fmt: skip
def test_a_bench_of_nothing_is_refused(words: str, told: str, run: Run) -> None:
    code, out, err = run("bench", *words.split())
    assert (code, out) == (2, "")
    assert told in err
    assert "hint:" in err


def test_bench_detect_passes_its_flags_on(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, object] = {}
    stages = {"input": 0.25, "network": 3.5, "decode": 0.25}
    ours = {"frames_per_s": 240.0, "aim": 60.0, "p50_ms": 4.0, "p95_ms": 5.0, "stages_ms": stages, "frames_per_s_batch": 300.0}
    opened = {"import_s": 0.5, "load_s": 0.125, "above_runtime_mb": 55.0}
    peer = {"frames_per_s": 20.0, "p50_ms": 50.0, "p95_ms": 60.0, "stages_ms": {"network": 50.0}}
    result = {
        "models": {"compact_fresh": ours | opened | {"peers_take": {"other": 12.5}}}, "peers": {"other": peer},
        "frames": 9, "repeats": 3, "cores": 2, "load_average": {"before": [0.1, 0, 0], "after": [0.9, 0, 0]},
        "runtime": {"onnxruntime": "1.31.1", "intra_op_num_threads": 2},
    }  # fmt: skip

    def measure(*, say: Callable[[str], None], **flags: object) -> dict[str, object]:
        seen.update(flags)
        say("warming up")
        return result

    monkeypatch.setattr("benchmarks.detect.run", measure)
    code, out, err = run(
        "bench", "detect", "--model", "a.onnx", "b.onnx", "--peer", "x=x.onnx", "--frames", "9", "--skip-peers", "--json"
    )
    assert (code, err) == (0, "warming up\n")
    assert json.loads(out) == result
    assert seen == {
        "model": ("a.onnx", "b.onnx"), "peer": ("x=x.onnx",), "frames": 9, "repeats": 3, "threads": 2, "skip": ("peers",),
    }  # fmt: skip
    head, compact, other, last = run("bench", "detect").out.splitlines()
    assert head.split("  ")[-1].strip() == "other takes"
    numbers = ["240.0", "60.0", "4.00", "5.00", "0.25", "3.50", "0.25", "300.0", "0.50", "0.12", "55", "12.5", "x"]
    assert compact.split() == ["compact_fresh", *numbers]
    assert other.split() == ["other", "20.0", "50.00", "60.00", "50.00"]
    assert last.endswith("2 threads of 2 cores; load 0.1 before, 0.9 after")


def test_version_and_interrupt(run: Run, monkeypatch: pytest.MonkeyPatch, dataset_folder: Path) -> None:
    import cabinpose
    from cabinpose.app.view import summary

    assert run("--version") == (0, f"{cabinpose.__version__}\n", "")

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(summary, "summarise", interrupt)
    assert run("info", dataset_folder) == (130, "", "interrupted\n")


@pytest.mark.slow
def test_synth_says_why_hardly_any_pose_holds(run: Run, tmp_path: Path) -> None:
    """An upper arm that goes down through the chest, at every turn of it: no frame is found, and all are left out."""
    axes = {
        "lshoulder.flexion": {"min_deg": 0.0, "max_deg": 0.0, "step_deg": 1.0},
        "lshoulder.abduction": {"min_deg": -45.0, "max_deg": -45.0, "step_deg": 1.0},
        "lshoulder.rotation": {"min_deg": 0.0, "max_deg": 15.0, "step_deg": 1.0},
    }
    config = {
        "scene": {
            "kind": "cabin",
            "cars": ["hatchback"],
            "occupancy": {"driver": 1.0},
            "profile": {"kind": "incremental", "axes": axes},
        },
        "limits": {"poses_per_person": 4, "scenes_per_frame": 2},
    }
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    done = run("synth", "--config", path, "--frames", "16", "--out", tmp_path / "none", "--workers", "1")
    assert done.code == 2  # nothing is left to write
    (line,) = [line for line in done.err.splitlines() if line.startswith("only ")]
    assert line.startswith("only 0.0 % of the poses hold: ")
    assert "driver: lupper_arm in torso" in line


def test_an_override_without_a_value(run: Run, tmp_path: Path) -> None:
    done = run("synth", "scene.cars", "--frames", "1", "--out", tmp_path / "x")
    assert done.code == 2
    assert "'scene.cars'" in done.err
    assert "hint: write KEY=VALUE" in done.err


def test_ctrl_c_ends_in_one_line_and_leaves_nothing_in_the_way(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "cabinpose", "synth", "--frames", "5000", "--workers", "2", "--out", str(tmp_path / "d")]
    process = subprocess.Popen([*command, "scene.cars=[hatchback]"], stderr=subprocess.PIPE, text=True)
    try:
        while not (tmp_path / "d" / "dataset.yaml").exists() and process.poll() is None:
            time.sleep(0.05)
        time.sleep(1.0)  # in the middle of the first part
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert err.splitlines()[-1] == "interrupted"
    assert "Traceback" not in err
    assert "Exception" not in err
    assert not (tmp_path / "d").exists()
