"""`cabinpose experiment compare`: its equations by hand, and a small comparison that is interrupted, resumed and refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import small
import sphere_people
import yaml

from cabinpose.app.compare import of_joints, recipe
from cabinpose.app.report.comparison import METRICS, joint_rows, table_rows
from cabinpose.core.errors import ConfigError
from cabinpose.core.skeleton import ITOP
from cabinpose.estimate.methods import METHODS
from cabinpose.evaluate.itop import evaluate_itop
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.store import PartWriter, create_dataset
from cabinpose.store.itop import ItopReference

Run = Callable[..., Any]


def test_the_equations_on_five_joints_by_hand() -> None:
    """Two hits, one joint that is missed, one that is found 30 cm away, one that is found where none is; ten that are nowhere."""
    true, found = np.full((1, 15, 3), np.nan), np.full((1, 15, 3), np.nan)
    for name, error in (("head", 0.03), ("neck", 0.04), ("rshoulder", None), ("lshoulder", 0.30), ("torso", None)):
        at = ITOP.joints.index(name)
        here = np.array([0.1 * at, 0.2, 2.5])
        if name != "torso":
            true[0, at] = here
        if name != "rshoulder":
            found[0, at] = here + (0, error or 0.0, 0)
    report = evaluate_itop(ItopReference(np.arange(1), true, np.ones(1, bool)), found, EvaluationOptions(resamples=0), model="m")
    rows = table_rows({"m": report}, {"m": {"poses_per_s": 12.3, "bytes": 5_000_000}})
    assert rows == [
        ["", "m"],
        ["mAD cm", "12.33"],  # (3 + 4 + 30) / 3: the joints that were found
        ["mAD10cm cm", "3.50"],
        ["mAP10cm %", "66.67"],  # head 1/1, neck 1/1, torso 0/1; the far shoulder is no false positive
        ["mAR %", "50.00"],  # head and neck of four true joints
        ["mAP10cm %, among detected", "66.67"],  # head and neck of the three true joints that were found
        ["mAR %, detected", "75.00"],
        ["all joints within 10 cm, %", "50.00"],
        ["poses/s of CPU time", "12"],
        ["size, MB", "5.00"],
    ]
    joints = dict(row for row in joint_rows({"m": report})[1:])
    assert joints["head"] == "3.00, 100.00"
    assert joints["rshoulder"] == "–, 0.00"
    assert joints["lshoulder"] == "30.00, 0.00"
    assert joints["torso"] == joints["lfoot"] == "–, –"
    assert len(METRICS) == 7


def test_every_method_of_joints_has_a_small_recipe() -> None:
    for name in of_joints():
        config = recipe(name, None, None)
        settings = METHODS[name].settings(config.settings)
        assert (settings.joints, settings.slots, config.epochs) == (ITOP.joints, ("standing",), 20)
        assert (settings.view.max_depth_m, settings.inputs) == (6, ("depth",))
    assert recipe("yolo", None, 3).epochs == 3
    with pytest.raises(ConfigError, match="does not find joints") as caught:
        recipe("unet", None, None)
    assert "yolo" in str(caught.value.hint)


def write_room(folder: Path) -> Path:
    """Eight frames of a sphere person with ITOP's joints, the last one far outside of the image."""
    unused = ("amplitude", "confidence", "depth_clean", "instance", "labels")
    manifest = sphere_people.manifest(
        frames=8,
        frames_per_part=8,
        width=small.SIZE[0],
        height=small.SIZE[1],
        persons=("standing",),
        variables=("depth", "itop_joints_3d"),
    )
    with create_dataset(folder, manifest), PartWriter(folder, manifest.parts[0], manifest) as part:
        for index in range(8):
            made = {name: value for name, value in sphere_people.frame(index, manifest).items() if name not in unused}
            joints = np.array(made["joints_3d"][:, :15])
            joints[:, 14] += (5, 0, 0)
            part.append(made | {"itop_joints_3d": joints, "subject": [f"S{index % 4}"]})
    return folder


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_room(tmp_path_factory.mktemp("compare") / "room")


def real(folder: Path) -> tuple[Path, Path]:
    """Two frames as ITOP's own files have them, and as the scaled crops of a .npz."""
    up = np.tile(np.linspace((-0.2, 0.6, 2.5), (0.2, -0.6, 2.5), 15), (2, 1, 1))
    crop = np.tile(np.linspace(0.8, 0.9, 100, dtype="f4"), (2, 100, 1))  # a wall, of many depths: one or two fit any scale
    image = np.full((2, 240, 320), 3.5, "f2")
    crop[:, 20:, 30:70], image[:, 60:, 110:210] = 0.55, 2.5  # and somebody before it: before a bare wall there is nobody
    np.savez(folder / "crops.npz", depth01=crop, joints_3d=up, frame=np.arange(2))
    files = folder / "ITOP_side"
    files.mkdir()
    ids = np.array([b"00_00000", b"00_00001"])
    with h5py.File(files / "a_depth_map.h5", "w") as file:
        file["id"], file["data"] = ids, image
    with h5py.File(files / "a_labels.h5", "w") as file:
        file["id"], file["is_valid"], file["visible_joints"] = ids, np.ones(2), np.ones((2, 15))
        file["real_world_coordinates"] = up.astype("f2")
    return folder / "crops.npz", files


@pytest.mark.slow
def test_a_comparison_and_what_is_not_done_again(room: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = small.TINY["yolo"] | {"skeleton": "itop", "slots": ["standing"], "amplitude": False, "least": 1e-6}
    config = tmp_path / "yolo.yaml"
    config.write_text(yaml.safe_dump(json.loads(json.dumps({"method": "yolo", "settings": settings, "batch": 4}))))
    out, (crops, files) = tmp_path / "out", real(tmp_path)
    arguments: list[object] = ["experiment", "compare", "--out", out, "--data", room, "--recipe", f"yolo={config}", "--epochs", 1]
    arguments += ["--resamples", 0, "--test", room, crops, files, "--correct", "head"]
    first = run(*arguments, "--methods", "yolo")
    assert first.code == 0, first.err
    assert "room: 8 frames" in first.out
    assert "crops: 2 frames" in first.out
    assert "ITOP_side-head: 2 frames" in first.out
    assert first.out.count("not ITOP's labels") == 2
    report = json.loads((out / "report.json").read_text())
    assert report["models"] == ["yolo: trained for 1 epochs on room"]
    facts = report["tests"]["room"]["yolo"]
    assert facts["poses_per_s"] > 0
    assert facts["bytes"] == (out / "models" / "yolo" / "model.onnx").stat().st_size
    assert all(v["samples"] == 0 for v in facts["report"]["values"] if v["joints"] == "lfoot" and v["metric"] == "PCK")  # absent
    for page in ("index.html", "room/index.html", "crops/index.html"):
        assert "yolo" in (out / page).read_text("utf-8")
    assert (out / "room" / "boxes.png").read_bytes().startswith(b"\x89PNG")
    with np.load(out / "found" / "room" / "yolo.npz") as found:
        assert found["joints_3d"].shape == (8, 15, 3)

    def never(*_: object, **__: object) -> None:
        raise AssertionError("it is there already")

    with monkeypatch.context() as patch:
        patch.setattr("cabinpose.estimate.training.fit", never)
        patch.setattr("cabinpose.app.compare.import_source", never)
        patch.setattr("cabinpose.estimate.joint_predictor.JointPredictor.predict", never)
        assert run(*arguments, "--methods", "yolo").out == first.out
    kept = out / "found" / "room" / "yolo.npz"
    kept.write_bytes(kept.read_bytes()[:300])  # a damaged one is made again
    assert run(*arguments, "--methods", "yolo").code == 0
    assert len(np.load(kept)["joints_3d"]) == 8
    beside = run(*arguments, "--methods", "yolo,paf", "--model", f"paf={out / 'models' / 'yolo' / 'model.onnx'}", "--json")
    again = json.loads(beside.out.splitlines()[-1])["tests"]["room"]
    assert again["yolo"]["report"]["values"] == again["paf"]["report"]["values"]
    refused = run(*[a if a != 1 else 2 for a in arguments], "--methods", "yolo")
    assert refused.code == 2
    assert "was trained by another recipe" in refused.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--methods", "yolo,yolo"], "names no method, or one twice"),
        (["--methods", "yola"], "yola"),
        (["--methods", "paf"], "nothing to train paf on"),
        (["--methods", "paf", "--model", "paf"], "--model paf names no file"),
        (["--methods", "paf", "--model", "yolo=x"], "yolo"),
        (["--methods", "compact", "--model", "compact=in_car"], "does not find ITOP's joints"),
        (["--methods", "compact", "--model", "compact=nothing.onnx"], "there is no model"),
    ],
)
def test_mistakes(words: list[str], said: str, room: Path, tmp_path: Path, run: Run) -> None:
    code, _, err = run("experiment", "compare", "--out", tmp_path / "out", "--test", room, *words)
    assert code == 2
    assert said in err
    assert "hint: " in err


def test_a_test_needs_itops_joints(tmp_path: Path, run: Run) -> None:
    manifest = sphere_people.manifest(frames=1, frames_per_part=1, persons=("driver",))
    folder = sphere_people.write(tmp_path / "car", manifest)
    code, _, err = run(
        "experiment", "compare", "--out", tmp_path / "out", "--test", folder, "--model", "yolo=room", "--methods", "yolo"
    )
    assert code == 2
    assert "has no joints of ITOP" in err
