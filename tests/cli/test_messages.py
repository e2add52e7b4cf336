"""What the command line says, word for word: the mistakes of the first hour, and that every verb chooses frames alike."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cabinpose.app.cli import VERBS
from cabinpose.scene.sensor import Sensor

Run = Callable[..., Any]

HEADER = '{"format": "cabinpose-predictions", "version": 1, "model": "m", "joints": ["head"], "persons": ["driver"]}'
ROW = '{"frame": 0, "person": "driver", "joint": "head", "u": 1, "v": 2}'


@pytest.fixture
def here(dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder but for the dataset `d` and some files that are none."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "d").symlink_to(dataset_folder)
    (tmp_path / "scene.yaml").write_text("version: 1\n", encoding="utf-8")
    (tmp_path / "two.jsonl").write_text(f'{HEADER}\n{ROW} {ROW}\n{{"rows": 2}}\n', encoding="utf-8")
    (tmp_path / "splits.yaml").write_text("train: {car: [sedan, van]}\ntest: {car: [coupe]}\n", encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("line", "error", "hint"),
    [
        ("synt --frames 1", "there is no command 'synt'", "did you mean `cabinpose synth`? `cabinpose --help` lists them"),
        (
            "synth --frames 1 --out o scene.child_seats.rear_left=booster scene.occupants.rear_left.subject=S01",
            "S01 is 1.75 m tall: a booster holds children of 1.00 to 1.25 m",
            "leave the child seat out, or name a child",
        ),
        ("frobnicate", "there is no command 'frobnicate'", "`cabinpose --help` lists them"),
        (
            "predict --data d --model in_car --out f.jsonl",
            "there is no flag --data",
            "the dataset follows the verb: cabinpose predict DATASET",
        ),
        (
            "evaluate --data=d --model in_car",
            "there is no flag --data",
            "the dataset follows the verb: cabinpose evaluate DATASET",
        ),
        (
            "evaluate d --model in_car --model=room",
            "--model is given twice",
            "give all its values behind one: --model A B",
        ),
        (
            "experiment compare --out o --test d --methods yolo --model yolo=room",
            "d has no joints of ITOP",
            "test on scenes in a room, or on ITOP's files",
        ),
        (
            "train --config c.yaml --data d e",
            "there is no flag --data",
            "the dataset follows the verb: cabinpose train DATASET",
        ),
        (
            "export onnx scene.yaml --out x.onnx",
            "scene.yaml is no checkpoint of `cabinpose train`, or it is cut short",
            "give best.ckpt or last.ckpt of a run",
        ),
        (
            "export onnx nope.ckpt --out x.onnx",
            "cannot read nope.ckpt: No such file or directory",
            "give best.ckpt or last.ckpt of a run",
        ),
        (
            "lab --seconds -2 --out l",
            "--seconds: must be greater than 1, not -2.0",
            "`cabinpose lab --help` says what each flag takes",
        ),
        (
            "lab --rate-hz 0 --out l",
            "--rate-hz: must be greater than 0, not 0.0",
            "`cabinpose lab --help` says what each flag takes",
        ),
        ("predict d --model in_car --out q.csv", "q.csv is no name of a predictions file", "let it end in .jsonl or .parquet"),
        ("predict d --model in_car --out two.jsonl", "two.jsonl exists", "--overwrite replaces it, or give another name"),
        (
            "predict d --model nope --out f.jsonl",
            "there is no model nope",
            "give an ONNX file, or a packaged model (five_seats, in_car, lift, paf, parts, room, room_top)",
        ),
        (
            "predict d --model grpc://pc --out f.jsonl",
            "grpc://pc is no address of a model",
            "write grpc://HOST:PORT/MODEL",
        ),
        (
            "evaluate d --model grpc://pc:1/m?on_error=go",
            "on_error cannot be 'go'",
            "on_error is stop or skip",
        ),
        (
            "serve --model in_car --port 70000",
            "--port is from 0 to 65535, --max-message-mb from 1 to 1024",
            "leave them out for 8001 and 64",
        ),
        (
            "train-style scene.yaml d --out x.onnx",
            "scene.yaml is no style frame",
            "write it with numpy.savez(PATH, depth_m=..., regions=...): see docs/style.md",
        ),
        (
            "train-style nope.npz d --out x.onnx",
            "cannot read nope.npz: No such file or directory",
            "write it with numpy.savez(PATH, depth_m=..., regions=...): see docs/style.md",
        ),
        ("train-style nope.npz d --out x", "x is no name of a model", "let it end in .onnx"),
        ("predict nope --model in_car --out f.jsonl", "nope does not exist", "give the folder of a dataset"),
        ("info nope.mcap", "the recording nope.mcap does not exist", "give the path of a recording"),
        ("view nope.mcap --out v", "the recording nope.mcap does not exist", "give the path of a recording"),
        ("view d --out d", "the pictures would lie in the dataset", "give another folder with --out"),
        ("view d --out d/part-00000.zarr/view", "the pictures would lie in the dataset", "give another folder with --out"),
        (
            "info scene.yaml",
            "scene.yaml is neither a dataset nor a recording",
            "give the folder that holds dataset.yaml, or a recording (.mcap)",
        ),
        (
            "view scene.yaml --out v",
            "scene.yaml is neither a dataset nor a recording",
            "give the folder that holds dataset.yaml, or a recording (.mcap)",
        ),
        (
            "export csv scene.yaml --out t",
            "scene.yaml is neither a dataset nor a recording",
            "give the folder that holds dataset.yaml, or a recording (.mcap)",
        ),
        ("info nope", "nope does not exist", "give the folder of a dataset"),
        ("info d --subject S01", "d is a dataset, and --subject lists recordings", "count its frames with --select subject=S01"),
        (
            "evaluate d --predictions two.jsonl",
            "two.jsonl:2: the line goes on after its JSON object",
            "write one object a line; docs/evaluation.md describes the format",
        ),
        (
            "import coco two.jsonl --out z",
            "two.jsonl is no whole JSON object (parse error: trailing garbage)",
            "it may be cut short; copy it again, or give another file",
        ),
        ("import coco-labels x --out z.jsonl --corrects nope", "nope does not exist", "give the folder of a dataset"),
        ("import", "`cabinpose import` needs a format", "`cabinpose import --help` lists them"),
        ("emulate tof", "unknown device 'tof'", "known: mt, mvn, stepper, vicon"),
        (
            "lab --together --out l",
            "together needs two subjects",
            "`cabinpose lab --help` says what each flag takes",
        ),
        ("evaluate d", "there is nothing to evaluate", "give DATASET with --predictions or --model, or --itop-npz with --model"),
        (
            "train d --synth scene.yaml --out run",
            "a detector learns from datasets or from generated scenes",
            "give DATASET or --synth, not both",
        ),
        (
            "export nope d --out z",
            "unknown format 'nope'",
            "known: bvh, c3d, coco, csv, dataset, itop, ntu, onnx, ply, png-json, sto, trc, yolo",
        ),
        (
            "export yolo d --splits splits.yaml --split test --out z",
            "yolo needs the splits train and val, not test",
            "name them train and val (or validate) in the file of --splits, and leave out --split",
        ),
        (
            "synth --frames 1 --out z camera.sensor.preset=evk75123 camera.sensor.integration_time_us=300",
            "unknown field of a sensor 'integration_time_us'",
            f"did you mean integration_s? known: {', '.join(sorted(Sensor.model_fields))}",
        ),
        (
            "synth --frames 1 --out z camera.sensor.preset=evk75123 camera.sensor.second_integration_s=0.002",
            "sensor 'evk75123': the second integration, 0.002 s, is not the shorter one",
            "give second_integration_s below integration_s, 0.001",
        ),
        (
            "synth --frames 1 --out z camera.sensor.preset=evk75123 camera.sensor.temporal_median=5",
            "sensor 'evk75123' takes the median of 5 frames, and each is a scene of its own",
            "ask for a sequence with scene.sequence, or leave out temporal_median",
        ),
        (
            "synth --frames 1 --out z scene.sequence.exposure_motion=true noise.kind=empirical",
            "noise 'empirical' has no correlation samples between which people could move",
            "choose noise kind physical, or leave out scene.sequence.exposure_motion",
        ),
    ],
)
def test_mistakes_of_the_first_hour(run: Run, here: Path, line: str, error: str, hint: str) -> None:
    before = sorted(path.name for path in here.iterdir())
    assert run(*line.split()) == (2, "", f"error: {error}\nhint: {hint}\n")
    assert sorted(path.name for path in here.iterdir()) == before


def test_what_a_yaml_file_is_not_is_said_without_the_extra(run: Run, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cabinpose.app.extras.find_spec", lambda _: None)  # a base install
    assert run("info", "scene.yaml").err.startswith("error: scene.yaml is neither a dataset nor a recording\n")


def test_predict_refuses_a_name_before_it_runs_the_model(run: Run, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cabinpose.estimate.remote.open_predictor", lambda _: pytest.fail("the model was loaded"))
    assert run("predict", "d", "--model", "in_car", "--out", "q.csv").code == 2


def test_a_model_that_looks_elsewhere_is_remarked(run: Run, here: Path) -> None:
    assert run("predict", "d", "--model", "room", "--out", "f.jsonl").err == (
        "the model room looks at standing, and the dataset has driver, front_passenger, rear_left, rear_center, rear_right: "
        "`evaluate` cannot score what it finds\n"
        "score it with: cabinpose evaluate d --predictions f.jsonl\n"
    )


def test_info_says_how_many_people_a_frame_has(run: Run, here: Path) -> None:
    lines = run("info", "d").out.splitlines()
    assert "people a frame  1 in 2 frames, 2 in 2 frames, 3 in 1 frame" in lines
    lines = run("info", "d", "--select", "car=sedan", "--verify").out.splitlines()
    assert "frames          5 in 3 of 3 parts; 2 selected, counted below" in lines
    assert "cars            sedan 2" in lines
    assert lines[-1] == "2 frames were read; all checksums are right"


def test_no_help_shows_an_empty_default(run: Run, helps: list[tuple[str, ...]]) -> None:
    verbs = helps
    assert {verb[0] for verb in verbs} == set(VERBS)
    assert {("bench", "lab"), ("evaluate-mocap", "dfe"), ("config", "init"), ("import", "coco"), ("emulate", "mvn")} <= set(verbs)
    for verb in verbs:
        text = " ".join(run(*verb, "--help").out.split())
        assert f"usage: cabinpose {' '.join(verb)}" in text
        assert "(default: )" not in text, verb
        assert "None" not in text, verb
        assert "{None}" not in text, verb
        assert "(default: True)" not in text, verb  # of a flag --no-NAME, which says that it switches off
        assert text.count("(default: on)") == text.count("Switch off: ")
    for verb, flag in (
        (("lab",), "--no-exercises"),
        (("align",), "--no-pose-correction"),
        (("emulate", "mvn"), "--no-long-trackers"),
    ):
        assert re.search(rf"{flag}[ │]+Switch off: ", " ".join(run(*verb, "--help").out.split())), flag


def test_a_reader_that_leaves_gets_no_traceback() -> None:
    """As of `cabinpose evaluate --help | head -1`."""
    command = [sys.executable, "-m", "cabinpose", "evaluate", "--help"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()  # before anything is printed
        assert process.stderr.read() == ""


CHOICES = [
    (("--select", "car=sedan,van", "pov=driver"), 3),
    (("--select", "car/2=1"), 3),  # of coupe, sedan, van: the first and the third
    (("--splits", "splits.yaml", "--split", "test"), 1),
]


@pytest.mark.parametrize(("flags", "count"), CHOICES)
def test_every_verb_chooses_frames_alike(run: Run, here: Path, flags: tuple[str, ...], count: int) -> None:
    assert json.loads(run("info", "d", "--json", *flags).out)["selected"] == count
    assert json.loads(run("export", "ply", "d", "--out", "clouds", "--json", *flags).out)["frames"] == count
    assert len(list(Path("clouds").glob("*.ply"))) == count
    found = json.loads(run("predict", "d", "--model", "in_car", "--out", "f.jsonl", "--json", *flags).out)
    assert found["frames"] == count
    judged = run("evaluate", "d", "--predictions", "f.jsonl", "--resamples", "0", "--json", *flags)
    assert json.loads(judged.out)["frames"] == count
    assert run("view", "d", "--out", "v", "--frames", "1", "--rows", "1", *flags).code == 0
    assert f'"frames":{count},' in Path("v/index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "verb", ["info d", "view d --out v", "predict d --model in_car --out f.jsonl", "evaluate d --model in_car"]
)
@pytest.mark.parametrize(
    ("flags", "error", "hint"),
    [
        (
            "--select car=coupe pov=driver",
            "no frame has all that is selected",
            "`cabinpose info` counts the frames by coordinate",
        ),
        ("--select colour=red", "unknown coordinate 'colour'", "known: action, car, pov, sequence, subject"),
        ("--select car/9=4", "the dataset has no car/9 4", "it has: 1, 2, 3"),
        ("--select car/2=3", "--select: car/2 has no fold 3", "folds are counted from 1"),
        ("--select car/2=one", "'car/2=one': folds are numbers", "write --select car/2=1,2"),
        ("--split test", "a split needs its file and its name", "give both --splits FILE and --split NAME"),
    ],
)
def test_selections_fail_alike(run: Run, here: Path, verb: str, flags: str, error: str, hint: str) -> None:
    assert run(*verb.split(), *flags.split()) == (2, "", f"error: {error}\nhint: {hint}\n")


def test_export_of_all_splits(run: Run, here: Path) -> None:
    Path("some.yaml").write_text("train: {car: [sedan]}\nval: {car: [coupe]}\n")
    done = run("export", "coco", "d", "--splits", "some.yaml", "--out", "c")
    assert done == (0, "c: 3 frames as coco: train 2, val 1\n", "2 frames belong to no split and are left out\n")
    one = run("export", "coco", "d", "--splits", "some.yaml", "--split", "val", "--out", "one", "--json")
    assert json.loads(one.out) == {"out": "one", "format": "coco", "frames": 1, "splits": {"val": 1}}
    assert [path.name for path in Path("one/annotations").iterdir()] == ["person_keypoints_val.json"]
    held = run("export", "yolo", "d", "--out", "y")
    assert held == (0, "y: 4 frames as yolo: train 3, val 1\n", "1 frames belong to no split and are left out\n")


def test_an_import_of_grey_images_says_what_is_missing(run: Run, here: Path) -> None:
    assert run("export", "coco", "d", "--out", "c").code == 0
    assert run("import", "coco", "c", "--out", "z").err == (
        "the images are depth8, too coarse for a dataset: joints and masks are imported without them "
        "(`export coco --images depth16` keeps the depth)\n"
        "see what it holds with: cabinpose info z\n"
    )
