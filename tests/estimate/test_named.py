"""Datasets of other places and joints are learnt together; what one of them does not label is not learnt from it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small
import sphere_people
import torch
import yaml

from cabinpose.app.cli import main
from cabinpose.app.training import stored_frames
from cabinpose.core.errors import ConfigError
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.estimate.batch import NOT_LABELLED
from cabinpose.estimate.data import StoredFrames, collate
from cabinpose.estimate.paf.measure import slot_anchors
from cabinpose.estimate.train_config import TrainConfig, as_configured
from cabinpose.estimate.training import Detector, frame_spec, read_checkpoint
from cabinpose.store import as_named

LABELLED = tuple(CABINPOSE.maps["itop"])
LACKING = tuple(joint for joint in CABINPOSE.joints if joint not in LABELLED)


def config(method: str, **settings: Any) -> TrainConfig:
    return TrainConfig(method=method, settings={**small.TINY[method], **settings}, epochs=1, batch=4, average=0.0)


def test_a_joint_is_not_labelled_where_only_others_show_it() -> None:
    run = config("compact")
    spec, whole = frame_spec(run), small.dataset(6)
    room = as_named(whole, joints={joint: joint for joint in LABELLED})
    (training, validation) = stored_frames(({"car": whole, "room": room}, {"room": room}), spec)
    at = CABINPOSE.indices(LACKING)
    for frames, first in ((training, 6), (validation, 0)):
        for i in range(6):
            kept, there = frames[first + i], [name != "" for name in room["subject"].values[i]]
            assert (kept.visibility[there][:, at] == NOT_LABELLED).all()
            assert (kept.visibility[~np.array(there)] == 0).all()  # of nobody no joint is unknown
            assert np.isnan(kept.joints[:, at]).all()
            others = [j for j in range(20) if j not in at]
            assert np.array_equal(kept.visibility[:, others], training[i].visibility[:, others])
    assert not any((training[i].visibility == NOT_LABELLED).any() for i in range(6))
    alone = stored_frames(({"room": room}, {"room": room}), spec)[0]
    assert not any((alone[i].visibility == NOT_LABELLED).any() for i in range(6))  # then they are learnt to be absent


def _head_rows(method: str, detector: Detector) -> dict[str, list[int]]:
    """The output rows, by the tensor of the bias, that answer for the driver's head or for a limb at it."""
    joints = detector.method_config.joints
    head = joints.index("head")
    if method == "compact":
        return {"votes.bias": [*range(6 * head, 6 * head + 6)]}
    if method == "yolo":
        return {"classes.bias": [head]}
    limbs = [c for c, limb in enumerate(detector.method_config.joint_set.limbs) if head in limb]
    rows = {"heat.12.bias": [head, len(joints)], "fields.12.bias": [2 * c + i for c in limbs for i in (0, 1)]}
    return rows | {"classify.second_bias": [head]}


@pytest.mark.parametrize("method", ["compact", "paf", "yolo"])
def test_the_loss_knows_nothing_of_joints_that_are_not_labelled(method: str) -> None:
    """Answers for the head may be anything in frames of people whose head is not labelled; where it is absent they are learnt."""
    run = config(method, slots=("driver",), **({"looks_px": ()} if method == "compact" else {}))
    room = as_named(small.dataset(6), joints={joint: joint for joint in CABINPOSE.joints if joint != "head"})
    detector = Detector(run)
    told = []
    for taught in (("head",), ()):
        frames = StoredFrames(room, frame_spec(run), taught=taught)
        batch = collate([frames[i] for i in range(6) if frames[i].present.any()])
        losses = []
        for shift in (0.0, 0.7):
            state = detector.network.state_dict()
            for name, rows in _head_rows(method, detector).items():
                state[name][rows] += shift
            with torch.no_grad():
                losses.append(detector.method.loss(detector.network.eval(), batch)["loss"].item())
            for name, rows in _head_rows(method, detector).items():
                state[name][rows] -= shift
        told.append(losses)
    assert told[0][1] == pytest.approx(told[0][0], abs=1e-6)
    assert abs(told[1][1] - told[1][0]) > 1e-4


def test_places_without_a_neck_have_an_anchor() -> None:
    """In the middle of the joints that are labelled; it was refused as if nobody were there."""
    run = config("paf", slots=("driver",))
    room = as_named(small.dataset(3), {"driver": "driver"}, {joint: joint for joint in LABELLED})
    frames = list(StoredFrames(room, frame_spec(run), taught=("neck",)))
    detector = Detector(run)
    anchors = slot_anchors(detector.method_config, frames)
    joints = np.concatenate([np.nanmean(f.joints[:1], axis=1)[:, :2] for f in frames if f.present[0]])
    assert anchors == {"driver": pytest.approx(joints.mean(axis=0), abs=0.06)}


def test_a_name_that_no_dataset_has_is_refused() -> None:
    run = TrainConfig(settings=small.TINY["compact"], data={"rom": {"places": {"standing": "driver"}}})
    with pytest.raises(ConfigError, match="unknown dataset in `data` 'rom'") as error:
        as_configured(run, {"some/room": small.dataset(1)})
    assert "did you mean room" in str(error.value.hint)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """People in cars, and one who stands in a room and is somebody else."""
    folder = tmp_path_factory.mktemp("mixed")
    sizes = {"width": small.SIZE[0], "height": small.SIZE[1], "frames_per_part": 8}
    car = sphere_people.write(folder / "car", sphere_people.manifest(frames=8, **sizes))
    return car, sphere_people.write(folder / "room", sphere_people.manifest(frames=8, seed=8, persons=("standing",), **sizes))


def _run(*arguments: str) -> int:
    try:
        return int(main(list(arguments)) or 0)
    except SystemExit as done:
        return int(done.code or 0)


@pytest.mark.parametrize("method", ["compact", "paf"])
def test_a_room_and_a_car_are_learnt_together(
    method: str, data: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From the command line; each name that is not there ends with exit code 2 and a hint."""
    settings = {**small.TINY[method], "slots": ["driver", "front_passenger"]}
    settings |= {name: list(value) for name, value in settings.items() if isinstance(value, tuple)}
    file = tmp_path / "run.yaml"
    splits = tmp_path / "splits.yaml"
    splits.write_text("train: {subject: [S01, S02, S03]}\nvalidate: {subject: [S04]}\n")

    def train(places: dict[str, str], joints: Any, out: str) -> int:
        names = {"room": {"places": places, "joints": joints}}
        file.write_text(yaml.safe_dump({"method": method, "settings": settings, "epochs": 1, "batch": 4, "data": names}))
        more = ("--config", str(file), "--splits", str(splits), "--out", str(tmp_path / out), "--devices", "1")
        return _run("train", *map(str, data), *more)

    ours = {joint: joint for joint in LABELLED}
    if method == "compact":
        for places, joints, words in (
            ({"standin": "driver"}, ours, "unknown place 'standin'"), ({"standing": "driver"}, {"hed": "head"}, "unknown joint"),
            ({"standing": "driver"}, {"head": "neck", "neck": "neck"}, "two joints are named neck"),
        ):  # fmt: skip
            assert train(places, joints, "refused") == 2
            said = capsys.readouterr().err
            assert words in said
            assert "hint: " in said
    assert train({"standing": "driver"}, ours, "run") == 0
    told = read_checkpoint(tmp_path / "run" / "best.ckpt")["config"]["data"]
    assert told == {"room": {"places": {"standing": "driver"}, "joints": ours}}
