"""What mistakes are answered: in one style, with paths that can be pasted and the name that was meant.

The lines are what people write who come from Blender, COCO, OpenCV, Ultralytics or ROS, or from another verb of ours.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from cabinpose.app.cli import VERBS, commands
from cabinpose.app.cli.complaints import COMMANDS, FLAGS, Flag
from cabinpose.core import KEYS, Registry
from cabinpose.core.findings import _key_paths
from cabinpose.core.synonyms import NAMES
from cabinpose.estimate import TrainConfig
from cabinpose.record.config import RigFile
from cabinpose.record.sources import SOURCES
from cabinpose.scene.body import SUBJECTS
from cabinpose.scene.cabin import PRESETS
from cabinpose.scene.cabin.car_file import CabinFile
from cabinpose.synth import SynthConfig

Run = Callable[..., Any]

SYNTH = "synth --frames 1 --out z "
# A line, and what its answer has to name.
ANSWERS = [
    # keys of a configuration: another place, another word, another form
    (f"{SYNTH}car=suv", "car: unknown key", "scene.cars=[suv]"),
    (f"{SYNTH}cars=suv", "scene.cars=[suv]"),
    (f"{SYNTH}vehicle=suv", "scene.cars=[suv]"),
    (f"{SYNTH}scene.cars=suv", "scene.cars: must be a list, not 'suv'", "scene.cars=[suv]"),
    (f"{SYNTH}scene.cars=[suvv]", "unknown car 'suvv'", "did you mean suv?"),
    (f"{SYNTH}scene.cars=[minivan]", "did you mean van?"),
    (f"{SYNTH}'scene.cars=[{{preset: suv,name: q,w3: 1500}}]'", "scene.cars[0].w3: unknown key", "w3_mm"),
    (f"{SYNTH}scene.car=suv", "did you mean scene.cars=[suv]?"),
    (f"{SYNTH}scene.num_cars=3", "scene.random_cars"),
    (f"{SYNTH}rhd=1", "scene.right_hand_drive"),
    (f"{SYNTH}'camera.views.mine={{position_m: [1,0,1]}}'", "camera.views.mine.look_at_m: this key is required"),
    (f"{SYNTH}'camera.views.mine={{position: [1,0,1],target: [0,0,1]}}'", "camera.views.mine.position_m"),
    (f"{SYNTH}'camera.views.mine={{fov: 90}}'", "camera.views.mine.fov: unknown key", "camera.sensor."),
    (f"{SYNTH}'camera.views.mine={{extrinsics: [1]}}'", "camera.views.mine.vehicle_from_camera"),
    (f"{SYNTH}camera.views.mine=above", "must be a number or a mapping of keys to values, not 'above'"),
    (f"{SYNTH}'camera.views.mine={{position_m: [1,2],look_at_m: [0,0,0]}}'", "camera.views.mine.position_m: too short"),
    (f"{SYNTH}camera.location=[1,0,1]", "camera.views.NAME.position_m"),
    (f"{SYNTH}camera.fov=90", "camera.fov: unknown key", "camera.sensor.camera.fov_deg"),
    (f"{SYNTH}'camera.sensor={{width: 640,fov_deg: 87}}'", "did you mean camera.sensor.camera.fov_deg?"),
    (f"{SYNTH}'camera.sensor={{camera: {{width: 64,height: 48}}}}'", "camera.sensor.camera.fx: this key is required", "fov_deg"),
    (
        f"{SYNTH}'camera.sensor={{camera: {{width: 64,fov_deg: 90}}}}'",
        "error: camera.sensor.camera.height: this key is required\n",
    ),
    (f"{SYNTH}'camera.sensor={{camera: {{width: 64,height: 48,fovy: 60}}}}'", "camera.sensor.camera.vfov"),
    (f"{SYNTH}'camera.sensor={{camera: {{width: 64,height: 48,fov_deg: 1.5}}}}'", "radians", "fov_deg: 85.94"),
    (f"{SYNTH}'camera.sensor={{camera: {{width: 64,height: 48,fov_deg: 90,fx: 32}}}}'", "fov_deg and fx say the same"),
    (
        f"{SYNTH}'camera.views.mine={{position_m: [1200,-300,900],look_at_m: [0,0,1]}}'",
        "position_m: [1200, -300, 900] is 1200 m away, so probably in millimetres",
        "places are metres: [1.2, -0.3, 0.9]",
    ),
    (
        f"{SYNTH}'camera.views.mine={{position_m: [0,0,1],look_at_m: [-90,10,50]}}'",
        "look_at_m",
        "centimetres",
        "[-0.9, 0.1, 0.5]",
    ),
    (f"{SYNTH}camera.width=640", "camera.sensor.camera.width"),
    (f"{SYNTH}camera.resolution=640", "camera.sensor.camera.width"),
    (f"{SYNTH}camera.intrinsics=[500,500]", "camera.sensor.camera"),
    (f"{SYNTH}camera.camera_matrix=[500]", "camera.sensor.camera"),
    (f"{SYNTH}camera.dist_coeffs=[0]", "camera.sensor.camera.dist"),
    (f"{SYNTH}camera.fx=500", "camera.sensor.camera.fx"),
    (f"{SYNTH}camera.clip_end=5", "camera.sensor.range_m"),
    (f"{SYNTH}camera.fps=30", "camera.sensor.fps"),
    (f"{SYNTH}camera.exposure=0.001", "camera.sensor.integration_s"),
    (f"{SYNTH}camera.jitter=0.1", "camera.jitter_m", "camera.jitter_deg"),
    (f"{SYNTH}camera.jiter_m=0.1", "did you mean camera.jitter_m?"),
    (f"{SYNTH}camera.sensor=kinect", "unknown sensor 'kinect'", "kinect_v1"),
    (f"{SYNTH}camera.camera_info=/topic", "camera.sensor.camera"),
    (
        f"{SYNTH}'scene.occupants={{rear_left: {{years: 5}}}}'",
        "scene.occupants.rear_left.years: unknown key",
        "people.own.NAME.years",
    ),
    (f"{SYNTH}'occupants={{rear_left: {{years: 5}}}}'", "did you mean scene.occupants?"),
    (f"{SYNTH}scene.driver.action=drive", "scene.occupants"),
    (f"{SYNTH}scene.occupants.driver.action=driives", "unknown action 'driives'", "did you mean drive?"),
    (f"{SYNTH}scene.occupants.driver.action=texting", "phone_text"),
    (f"{SYNTH}scene.occupants.passenger.action=read", "unknown seat 'passenger'", "did you mean front_passenger?"),
    (f"{SYNTH}scene.occupants.driver.gender=female", "people.own.NAME.gender"),
    (f"{SYNTH}scene.occupants.driver.belted=maybe", "scene.occupants.driver.belted: must be true or false, not 'maybe'"),
    (f"{SYNTH}'scene.attachments={{isofixx: 1}}'", "must be one of isofix, belt, not 'isofixx'", "did you mean isofix?"),
    (
        f"{SYNTH}'people.own={{bob: {{mesh: x.glb}}}}'",
        "bob.mesh: unknown key",
        "years, stature_cm",
        "cabinpose car init",
    ),
    (f"{SYNTH}'people.own={{bob: {{age: 5}}}}'", "people.own.bob.years"),
    (f"{SYNTH}'people.own={{bob: {{sex: f}}}}'", "people.own.bob.gender"),
    (f"{SYNTH}'people.own={{bob: {{betas: [0]}}}}'", "gender, years, stature_cm"),
    (f"{SYNTH}people.own={{bob:{{years:5}}}}", "people.own.bob.years:5: unknown key", "a blank follows the colon"),
    (f"{SYNTH}'people.own={{bob: {{years: 200}}}}'", "people.own.bob.years: must be less than or equal to 80, not 200"),
    (f"{SYNTH}'people.own={{bob: {{gender: man}}}}'", "people.own.bob.gender: must be", "'man'"),
    (f"{SYNTH}people.num_people=5", "people.random.count"),
    (f"{SYNTH}subjects=[S01]", "people.subjects"),
    (f"{SYNTH}people.subjects=S01", "people.subjects=[S01]"),
    (f"{SYNTH}people.subjects=[S99]", "unknown subject 'S99'", "S01"),
    (f"{SYNTH}noise=0.01", "noise: must be a mapping of keys to values, not 0.01"),
    (f"{SYNTH}noise.kind=gaussian", "noise.kind: must be one of physical, empirical, structured_light, not 'gaussian'"),
    (f"{SYNTH}rgb=true", "images.variables"),
    (f"{SYNTH}images.engine=CYCLES", "images.renderer"),
    (f"{SYNTH}images.renderer=cycles", "images.renderer: must be one of", "raster"),
    (f"{SYNTH}images.spp=64", "images.samples"),
    (f"{SYNTH}output.keypoints=coco", "output.skeletons"),
    (f"{SYNTH}output.bbox=true", "cabinpose export coco"),
    (f"{SYNTH}seed=3", "--seed"),
    (f"{SYNTH}frames=3", "--frames"),
    (f"{SYNTH}epochs=3", "cabinpose train"),
    (f"{SYNTH}scene.kind=cabbin", "scene.kind: must be one of cabin, room, not 'cabbin'"),
    (f"{SYNTH}nothing.at.all=1", "nothing: unknown key", "keys here: version, scene, people"),
    ("config check t.yaml scene.cars=suv", "scene.cars: must be a list", "scene.cars=[suv]"),
    (
        "config check bad.yaml",
        "scene.occupant: did you mean scene.occupants",
        "camera.views.NAME.position_m?",
    ),
    ("config check broken.yaml", "broken.yaml is not YAML that can be read: line 2, column 3"),
    (f"{SYNTH}scene=room", "did you mean scene.kind=room?"),
    (f"{SYNTH}camera=evk75123", "keys of camera: sensor, views"),
    (f"{SYNTH}scene.occupants.driver=S03", "keys of scene.occupants.driver: subject, action"),
    (f"{SYNTH}scene.kind=room scene.cars=[suv]", "scene.cars: unknown key", "keys of scene: kind, rooms, facing_deg"),
    (f"{SYNTH}scene.occupancy={{pilot:1}}", "a blank follows the colon: pilot: 1"),
    (f"{SYNTH}images.variables=[color]", "did you mean rgb?"),
    (f"{SYNTH}'people.random.ranges.age={{low: 20, high: 40}}'", "keys of people.random.ranges.age: min, max"),
    ("record rig.yaml --check", "sources: this key is required; cameras: unknown key", "did you mean sources?"),
    # words of commands
    ("generate --frames 3", "there is no command 'generate'", "cabinpose synth"),
    ("render", "cabinpose synth"),
    ("list", "cabinpose models", "cabinpose info"),
    ("val d", "cabinpose evaluate"),
    ("detect d", "cabinpose predict"),
    ("track d", "cabinpose predict"),
    ("convert d", "cabinpose export", "cabinpose import"),
    ("show d", "cabinpose view"),
    ("rosbag play", "cabinpose import"),
    ("gui", "cabinpose studio"),
    ("webcam", "cabinpose live"),
    ("benchmark", "cabinpose bench"),
    ("calibrate_noise w", "cabinpose calibrate-noise"),
    ("Synth", "cabinpose synth"),
    ("config validate t.yaml", "did you mean check?"),
    ("config checc t.yaml", "did you mean check?"),
    ("config", "init, check, frame, views, schema"),
    ("car t.glb", "init, check"),
    ("bench gpu", "synth, detect, record"),
    # flags
    ("synth", "`cabinpose synth` needs --out PATH", "Folder of the dataset"),
    ("synth --frames 1.5 --out z", "--frames must be a whole number, not '1.5'"),
    ("synth --frames ten --out z", "--frames must be a whole number, not 'ten'"),
    ("synth --frames --out z", "--frames needs a whole number"),
    ("synth -n 5 -o z", "there is no flag -n", "--frames"),
    ("synth --output z", "there is no flag --output", "--out"),
    ("synth --num-frames 3 --out z", "--frames"),
    ("synth --frames 3 --out z --force", "--overwrite"),
    ("synth --frames 3 --out z --imgsz 640", "there is no flag --imgsz", "camera.sensor.camera.width"),
    ("synth --frames 3 --out z --car suv", "there is no flag --car", "scene.cars=[suv]"),
    ("synth --frames 3 --out z --fov 90", "camera.sensor"),
    ("synth --frames 3 --out z --gender female", "people.own.NAME.gender=female"),
    ("info d --json=true", "--json takes no value"),
    ("synth --frames 3 --out z suv", "'suv' says nothing of the configuration", "KEY=VALUE"),
    ("synth --frames 3 --out z t.yaml u.yaml", "one configuration"),
    ("evaluate family found.jsonl", "--predictions found.jsonl"),
    ("evaluate d found.jsonl", "--predictions found.jsonl"),
    ("evaluate d --gt x", "--labels"),
    ("evaluate d --model in_car --head thesi", "--head must be one of thesis, true, not 'thesi'", "did you mean thesis?"),
    ("predict d in_car --out f.jsonl", "--model in_car"),
    ("predict d --weights in_car --out f.jsonl", "--model"),
    ("predict --source d --model in_car --out f.jsonl", "cabinpose predict DATASET"),
    ("predict d --model in_car --conf 0.5 --out f.jsonl", "cabinpose evaluate --presence 0.5"),
    ("predict d --model in_car --device 0 --out f.jsonl", "--devices"),
    ("predict d --model in_car", "`cabinpose predict` needs --out PATH"),
    ("train d --out run --method yolov8", "unknown method 'yolov8'", "did you mean yolo?"),
    ("train d --out run --epochs 3", "--config: epochs: 3"),
    ("train d --out run --lr 0.001", "learning_rate"),
    ("train d --out run --batch-size 16", "--config: batch"),
    ("train d --out run --device 0", "--devices"),
    ("train d --out run --config run.yaml", "run.yaml: lr0: unknown key", "did you mean learning_rate?"),
    ("view d out", "--out out"),
    ("view", "`cabinpose view` needs DATASET|RECORDING", "Folder of the dataset"),
    ("info", "`cabinpose info` needs DATASET|RECORDING"),
    ("serve", "`cabinpose serve` needs MODEL"),
    ("serve in_car --port http", "--port must be a whole number, not 'http'"),
    ("live family", "unknown source 'family'", "a dataset"),
    ("record", "`cabinpose record` needs RIG"),
    ("record nope.yaml --check", "cannot read nope.yaml"),
    ("export cocojson d --out z", "unknown format 'cocojson'", "did you mean coco?"),
    ("export yolov8 d --out z", "did you mean yolo?"),
    ("export d --out z", "export FORMAT d"),
    ("export d coco --out z", "cabinpose export coco d --out z"),
    ("predict d --model incar --out f.jsonl", "did you mean in_car?"),
    ("synth --frames 3 --out z --scene.cars suv", "scene.cars=suv"),
    ("export coco d", "`cabinpose export coco` needs --out PATH"),
    ("export coco d --out z --frame-id 3", "there is no flag --frame-id"),
    ("import rosbag my.bag --out z.mcap", "did you mean rosbag2?"),
    ("emulate xsens", "did you mean mvn?"),
    ("car check car.gltf", "car.gltf is a mesh", "cabinpose car init car.gltf"),
    ("car check car.yaml", "car.yaml: seats.driver.position: unknown key", "seats.driver.h_point"),
    ("car init t.glb", "`cabinpose car init` needs --out PATH"),
]
# Words of libraries and of our classes, which say nothing to who writes a configuration.
FOREIGN = re.compile(
    r"[Ii]nput should|[Ff]ield required|pydantic|constrained|valid (tuple|dict|list|integer|number)|NoneType|<class|[╭│╰]"
    r"|\b(CameraPose|ExactCameraPose|OwnPerson|CabinScene|RoomScene|ChangedPreset|PhysicalNoise|Occupant|SynthConfig|TrainConfig)\b"
)


@pytest.fixture(scope="module")
def workplace(dataset_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the dataset `d`, and files to make mistakes with; read only."""
    folder = tmp_path_factory.mktemp("answers")
    (folder / "d").symlink_to(dataset_folder)
    for name in ("t.yaml", "u.yaml"):
        (folder / name).write_text("version: 1\n", encoding="utf-8")
    (folder / "bad.yaml").write_text("scene: {occupant: 1}\ncamera: {pos: [1, 2, 3]}\n", encoding="utf-8")
    (folder / "broken.yaml").write_text("a: [1\n b: 2", encoding="utf-8")
    (folder / "rig.yaml").write_text("cameras: {}\n", encoding="utf-8")
    (folder / "run.yaml").write_text("lr0: 0.01\n", encoding="utf-8")
    (folder / "nobody.yaml").write_text("train: {subject: [S99]}\nvalidate: {subject: [S98]}\n", encoding="utf-8")
    (folder / "found.jsonl").touch()
    (folder / "t.glb").touch()
    (folder / "car.gltf").write_text('{"asset": {"version": "2.0"}}', encoding="utf-8")
    (folder / "car.yaml").write_text(
        "mesh: t.glb\nseats: {driver: {h_point: [0, 0, 0], position: [0, 0, 0]}}\n", encoding="utf-8"
    )
    return folder


@pytest.mark.parametrize(("line", "names"), [(line, names) for line, *names in ANSWERS])
def test_a_mistake_is_answered(run: Run, workplace: Path, monkeypatch: pytest.MonkeyPatch, line: str, names: list[str]) -> None:
    monkeypatch.chdir(workplace)
    before = sorted(workplace.iterdir())
    code, out, err = run(*shlex.split(line))
    assert (code, out) == (2, "")
    assert re.fullmatch(r"error: [^\n]+\nhint: [^\n]+\n", err), err
    for name in names:
        assert name in err
    assert not FOREIGN.search(err), err
    assert sorted(workplace.iterdir()) == before


def test_the_right_lines_beside_them_are_taken(run: Run, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(workplace)
    assert "usage: cabinpose synth" in run("help", "synth").out
    assert run("help").out == run("--help").out
    monkeypatch.setattr("cabinpose.estimate.packaged_models", dict)
    assert run("models", "list") == (*run("models")[:2], "`cabinpose models` alone lists them\n")
    made: list[Any] = []
    monkeypatch.setattr("cabinpose.app.cli.config._check", lambda _, config: made.append(config))
    assert run("config", "check", "t.yaml", "scene.cars=[suv]").code == 0
    assert made[0].scene.cars == ("suv",)


@pytest.mark.parametrize(
    ("verb", "flag", "value", "field"),
    [("live", "--source", "d", "source"), ("serve", "--model", "in_car", "model"), ("record", "--config", "r.yaml", "config")],
)
def test_what_a_verb_is_about_stands_behind_it_or_behind_its_flag(verb: str, flag: str, value: str, field: str) -> None:
    module = import_module(f"cabinpose.app.cli.{verb}")
    told = [["--json", flag, value], ["--json", f"{flag}={value}"], ["--json", value], [value, "--json"]]
    for words in told:
        made = commands.parsed(verb, module.COMMAND, module.modernised(words), "")
        assert str(getattr(made, field)) == value
        assert made.as_json


def test_a_configuration_may_stand_without_its_flag(run: Run, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(workplace)
    loaded: list[Any] = []

    def load(path: Path | None, changes: Any) -> Any:
        loaded.append((path, list(changes)))
        raise KeyboardInterrupt

    monkeypatch.setattr(SynthConfig, "load", load)
    for line in (f"{SYNTH}t.yaml people.asymmetric=true", f"{SYNTH}people.asymmetric=true --config t.yaml"):
        assert run(*line.split()).code == 130
    assert loaded == [(Path("t.yaml"), ["people.asymmetric=true"])] * 2


def test_what_cannot_be_trained_is_told_before_torch_is_loaded(workplace: Path) -> None:
    """In a process of its own: here other tests may have loaded it."""
    lines = ("--method yolov8", "--config run.yaml", "--epochs 3", "--logger tensorbord", "--splits nobody.yaml")
    code = f"""
import sys
from cabinpose.app.cli import main
codes = [main(f"train d --out run {{line}}".split()) for line in {lines}]
assert (codes, "torch" in sys.modules, "lightning" in sys.modules) == ([2] * 5, False, False)
"""
    subprocess.run([sys.executable, "-c", code], cwd=workplace, check=True)


def test_parquet_without_its_library_is_refused_before_the_model_runs(
    run: Run, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(workplace)
    monkeypatch.setattr("cabinpose.store.predictions.find_spec", lambda _: None)
    monkeypatch.setattr("cabinpose.app.models.opened_models", lambda *_: pytest.fail("the model was loaded"))
    for line in ("predict d --model in_car --out p.parquet", "live d --model in_car --predictions p.parquet"):
        code, out, err = run(*line.split())
        assert (code, out) == (2, "")
        assert err == (
            "error: Parquet needs pyarrow, which is not installed\n"
            'hint: pip install "cabinpose[parquet]", or use JSON lines (.jsonl)\n'
        )
        assert not Path("p.parquet").exists()


def test_every_flag_is_known_to_who_explains_it(run: Run, helps: list[tuple[str, ...]]) -> None:
    """What is read of the fields of commands is what tyro's own help says of them; and no command answers in a box."""
    every = set[str]()
    for verb in helps:
        told = set(re.findall(r"^[│ ] (--[a-z][\w-]*)", run(*verb, "--help").out, re.M)) - {"--help"}
        known = {flag.name for field in commands._RULE.fields if (flag := Flag.of(field)) is not None and not flag.positional}
        assert told == known, verb
        every |= told
        code, out, err = run(*verb, "--no-such-flag")
        assert (code, out) == (2, "")
        assert err.startswith("error: there is no flag --no-such-flag\nhint: "), verb
    assert {flag for flags in FLAGS.values() for flag in flags} <= every


def test_synonyms_stand_for_what_exists() -> None:
    assert {name.split()[0] for names in COMMANDS.values() for name in names} <= {*VERBS, "--version"}
    models = [SynthConfig, TrainConfig, CabinFile, RigFile, *(source.Settings for _, source in SOURCES.items())]
    paths = {f".{path}" for model in models for path in _key_paths(model.model_json_schema())}
    ends = {end for each in KEYS.values() for end in each} - {"kind"}  # `kind` is of any source
    assert {end for end in ends if not any(path.endswith(f".{end}") for path in paths)} == set()
    chosen = {*PRESETS, *SUBJECTS, "front_passenger", "rear_left", "rear_center", "rear_right", "parts", "rgb", "nir"}
    for kind in ("actions", "sensors", "things", "sources", "formats", "methods"):
        chosen |= set(Registry(f"cabinpose.{kind}", kind, object).names())
    assert {name for names in NAMES.values() for name in names} <= chosen
