"""Runs that ended in a traceback, or learnt something else than was asked for, without a word."""

from __future__ import annotations

import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import small
import torch
from lightning.pytorch.callbacks import Callback

from cabinpose.app import training as app_training
from cabinpose.app.cli import main
from cabinpose.app.cli import train as cli_train
from cabinpose.core.errors import ConfigError, DatasetError, ModelError
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.estimate import training
from cabinpose.estimate.data import GeneratedFrames, Kept, StoredFrames, collate
from cabinpose.estimate.paf.fit import presence_of
from cabinpose.estimate.train_config import Machines, Observers, Start, TrainConfig
from cabinpose.estimate.training import Detector, begin_with, fit, frame_spec
from cabinpose.estimate.walks.config import WalksConfig
from cabinpose.estimate.walks.fit import fit as fit_walks
from cabinpose.store import as_named
from cabinpose.synth import SynthConfig
from cabinpose.synth.style.settings import Style

ONE = Machines(1)
CROWD = {"people": {"subjects": [], "random": {"count": 20}}}


def config(method: str, **changes: Any) -> TrainConfig:
    return TrainConfig(**({"method": method, "settings": small.TINY[method], "epochs": 1, "batch": 4, "average": 0.0} | changes))


def frames(c: TrainConfig, count: int = 4) -> StoredFrames:
    return StoredFrames(small.dataset(count), frame_spec(c))


def emptied(kept: Kept) -> Kept:
    return kept._replace(present=np.zeros_like(kept.present), labels=np.zeros_like(kept.labels))


@pytest.mark.parametrize("method", ["compact", "lifting", "unet"])
def test_a_validation_that_judges_nothing_is_refused_before_training(method: str, tmp_path: Path) -> None:
    c = config(method)
    some = frames(c)
    nobody = [emptied(some[i]) for i in range(2)]
    with pytest.raises(DatasetError, match=r"no validation frame shows what val_\w+ is of") as caught:
        fit(c, some, nobody, tmp_path / "run", machines=ONE)  # type: ignore[arg-type]
    assert "best_by" in caught.value.hint
    assert not (tmp_path / "run").exists()
    if method == "lifting":  # the last frame alone is enough, and the loss needs none
        fit(c, some, [*nobody, some[0]], tmp_path / "run", machines=ONE)  # type: ignore[arg-type]
        loss = config(method, best_by="loss")
        assert fit(loss, some, nobody, tmp_path / "loss", machines=ONE).exists()  # type: ignore[arg-type]


def test_walks_name_a_joint_that_is_never_known() -> None:
    c = TrainConfig(method="walks", settings={"width": 64, "height": 48, "focal": 51.2, "slots": ("driver",)})
    some, head = frames(c), CABINPOSE.index["head"]
    kept = [some[i] for i in range(4)]
    for frame in kept:
        frame.joints[:, head] = np.nan
    with pytest.raises(DatasetError, match=r"nobody's head is known") as caught:
        fit_walks(WalksConfig.model_validate(c.settings), kept, lambda *_: None, seed=1, mirrored=False)
    assert caught.value.hint


def test_scenes_without_styled_depth_are_refused_and_those_with_it_make_it(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = SynthConfig.parse(CROWD)
    spec = frame_spec(TrainConfig(method="compact", depth="depth_styled"))
    with pytest.raises(ConfigError, match="the scenes have no depth_styled") as caught:
        app_training.generated_frames(scenes, spec, 4, 1)
    assert "style" in caught.value.hint
    monkeypatch.setattr(app_training, "preflight", lambda *_, **__: None)  # reads the style's model
    styled = scenes.model_copy(update={"style": Style(by="style.onnx")})
    for image, made in (("depth_styled", True), ("depth", False)):
        for side in app_training.generated_frames(styled, spec._replace(depth_image=image), 4, 1):
            assert vars(side._make)["_pictures"] is made


@pytest.mark.parametrize(
    ("words", "flag"),
    [
        (["--synth", "scene.yaml", "--splits", "splits.yaml"], "--splits"),
        (["--synth", "scene.yaml", "--val", "0.2"], "--val"),
        (["sample", "--frames", "5"], "--frames"),
    ],
)
def test_flags_that_would_do_nothing_are_refused(
    words: list[str], flag: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", *words, "--out", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert f"{flag} is of" in error
    assert f"hint: leave out {flag}" in error


def test_named_people_in_both_sides_of_generated_frames_are_told() -> None:
    spec = frame_spec(TrainConfig(method="compact"))
    with pytest.warns(UserWarning, match="S01, S02, S03, S04, S05 and 13 more are learnt from and validate"):
        app_training.generated_frames(SynthConfig(), spec, 4, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        app_training.generated_frames(SynthConfig.parse(CROWD), spec, 4, 1)


class Stop(Callback):
    """Ends a run after an epoch."""

    def __init__(self, epoch: int) -> None:
        self._epoch = epoch

    def on_train_epoch_end(self, trainer: Any, module: Any) -> None:
        trainer.should_stop = trainer.should_stop or trainer.current_epoch == self._epoch


class Rates(Callback):
    """The rate after each step."""

    def __init__(self) -> None:
        self.seen: list[float] = []

    def on_train_batch_end(self, trainer: Any, *_: Any) -> None:
        self.seen.append(trainer.optimizers[0].param_groups[0]["lr"])


def test_a_run_in_a_folder_that_was_moved_keeps_its_best_epoch(tmp_path: Path) -> None:
    c = config("lifting", epochs=3)
    some = frames(c)
    fit(c, some, some, tmp_path / "run", machines=ONE, observers=Observers(callbacks=(Stop(epoch=1),)))
    last = torch.load(tmp_path / "run" / "last.ckpt", weights_only=True)
    state = next(s for s in last["callbacks"].values() if s.get("monitor") == "val_auc")
    assert (last["epoch"], Path(state["best_model_path"]).name) == (1, "best.ckpt")
    state["best_model_score"] = state["kth_value"] = torch.tensor(1e6)  # no epoch is as good
    state["best_k_models"] = dict.fromkeys(state["best_k_models"], state["kth_value"])
    torch.save(last, tmp_path / "run" / "last.ckpt")
    moved = (tmp_path / "run").rename(tmp_path / "moved")
    before = (moved / "best.ckpt").read_bytes()
    assert fit(c, some, some, moved, start=Start(resume=True), machines=ONE) == moved / "best.ckpt"
    assert torch.load(moved / "last.ckpt", weights_only=True)["epoch"] == 2
    assert (moved / "best.ckpt").read_bytes() == before
    assert not list(tmp_path.glob("run*"))


def test_one_cycle_of_frames_that_processes_make_ends_with_the_run(tmp_path: Path) -> None:
    """Six frames, four to a batch: three processes make a short batch each, of which Lightning takes two."""
    c = config("compact", workers=3, epochs=2)
    made = [GeneratedFrames(small.frame, count, frame_spec(c), small.PERSONS) for count in (6, 2)]
    rates = Rates()
    fit(c, *made, tmp_path, machines=ONE, observers=Observers(callbacks=(rates,)))
    assert len(rates.seen) == 2 * 2
    assert rates.seen[-2] == pytest.approx(c.learning_rate / 25 / 1e4, rel=1e-6)  # of the last step: where one cycle ends


@pytest.mark.parametrize("method", ["compact", "yolo"])
def test_channels_that_attention_cannot_share_are_refused(method: str) -> None:
    with pytest.raises(ConfigError, match="multiple of 4"):
        config(method, settings={"channels": (8, 16, 32, 30)})


def test_a_run_begins_with_no_network_of_another_image(tmp_path: Path) -> None:
    c = config("paf")
    torch.save(
        {"hyper_parameters": {"config": c.model_dump(mode="json")}, "state_dict": Detector(c).state_dict()},
        tmp_path / "best.ckpt",
    )
    begin_with(Detector(c), tmp_path / "best.ckpt", [])
    with pytest.raises(ModelError, match="of another network: input"):
        begin_with(Detector(config("paf", settings={**small.TINY["paf"], "input": "amplitude"})), tmp_path / "best.ckpt", [])


def test_depths_that_training_cannot_keep_are_refused() -> None:
    """A kept depth has 16 bits: 7 m became 0.446 m."""
    with pytest.raises(ConfigError, match=r"max_depth_m 7 is beyond 6\.5 m"):
        frame_spec(TrainConfig(method="compact", settings={"max_depth_m": 7.0}))
    c = config("compact", settings={**small.TINY["compact"], "max_depth_m": 6.5})
    far = small.dataset(1)
    far["depth"][:] = 6.5
    assert collate([StoredFrames(far, frame_spec(c))[0]]).depth.max() == pytest.approx(6.5)


@pytest.mark.parametrize(
    ("places", "wrong"),
    [
        ({"driver": "driverr"}, "driverr"),
        ({"driver": "rear_left", "rear_left": "driver"}, ""),  # of a method with fewer places: none of its own lacks
        ({"driver": "driver", "rear_left": "rear_left"}, ""),  # by its own name
    ],
)
def test_a_new_place_that_the_method_does_not_have_is_refused(places: dict[str, str], wrong: str) -> None:
    slots = ("driver", "front_passenger") if places["driver"] == "driver" else ("driver",)
    if wrong:
        with pytest.raises(ConfigError, match=f"unknown place of the method '{wrong}'") as caught:
            as_named(small.dataset(1), places, slots=slots)
        assert "did you mean driver?" in caught.value.hint
    else:
        assert set(slots) <= set(as_named(small.dataset(1), places, slots=slots)["person"].values)
    assert list(as_named(small.dataset(1), places)["person"].values) == list(places.values())


def test_people_in_places_that_go_are_on_one_side_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = small.dataset(8)
    who = made["subject"].values
    who[:] = ""
    who[:4, 0], who[4:, 0], who[2:6, 1] = "A", "B", "P"
    monkeypatch.setattr("cabinpose.store.open_dataset", lambda _: made)
    run = config(
        "lifting", settings={**small.TINY["lifting"], "slots": ["driver"]}, data={"car": {"places": {"driver": "driver"}}}
    )
    sides = cli_train._sides(cli_train.Train(out=tmp_path, datasets=(Path("car"),)), run, helps=True)
    seen = [set(who[side["car"]["frame"].values].ravel()) - {""} for side in sides]
    assert all(seen)
    assert not seen[0] & seen[1]
    assert all(list(side["car"]["person"].values) == ["driver"] for side in sides)


@pytest.mark.parametrize("method", ["paf", "yolo"])
def test_a_hidden_joint_of_unknown_depth_is_not_learnt_to_be_absent(method: str) -> None:
    c = config(method)
    made, head = small.dataset(3), CABINPOSE.index["head"]
    made["joints_3d"][:, :, head] = np.nan
    made["visibility"][:, :, head] = np.where(made["subject"] != "", 2, 0)
    some = StoredFrames(made, frame_spec(c))
    batch = collate([some[i] for i in range(3) if some[i].present.all()])
    detector = Detector(c)
    at = detector.method_config.joints.index("head")
    weights = detector.network.state_dict()
    rows = weights["heat.12.bias"][at : at + 1] if method == "paf" else weights["classes.bias"][at :: len(CABINPOSE.joints)]
    with torch.no_grad():
        before = detector.method.loss(detector.network.eval(), batch)["loss"].item()
        rows += 0.7
        assert detector.method.loss(detector.network, batch)["loss"].item() == pytest.approx(before, abs=1e-6)
    if method == "paf":
        assert [presence_of(batch, labels)[:, at].unique().tolist() for labels in (2, 3)] == [[1], [1]]


def test_another_callback_may_stop_a_run_in_its_epoch(tmp_path: Path) -> None:
    class StopAtOnce(Callback):
        def on_train_batch_end(self, trainer: Any, *_: Any) -> None:
            trainer.should_stop = True

    c = config("lifting", epochs=3)
    run = fit(c, frames(c), frames(c), tmp_path, machines=ONE, observers=Observers(callbacks=(StopAtOnce(),)))
    assert torch.load(run.with_name("last.ckpt"), weights_only=True)["epoch"] == 0


@pytest.mark.parametrize(("count", "devices", "dropped"), [(6, 1, True), (6, 2, False), (8, 2, True)])
def test_no_device_goes_without_a_batch(count: int, devices: int, dropped: bool) -> None:
    c = config("lifting")
    data = training._Frames(c, frames(c, count), frames(c, 1))
    data.trainer = SimpleNamespace(current_epoch=0, world_size=devices)  # type: ignore[assignment]
    assert data.train_dataloader().drop_last is dropped


def test_a_run_does_not_go_on_with_other_frames(tmp_path: Path) -> None:
    """As with another --learn of `adapt`, or with another dataset of as many frames; of a run of before nobody knows."""
    c = config("lifting", epochs=2)
    mine, other = (StoredFrames(small.dataset(4).assign_attrs(frames_id=name), frame_spec(c)) for name in ("mine", "other"))
    fit(c, mine, mine, tmp_path, machines=ONE, observers=Observers(callbacks=(Stop(epoch=0),)))
    last = tmp_path / "last.ckpt"
    for frames_ in (frames(c, 6), other):
        with pytest.raises(ModelError, match="begun with other training frames") as caught:
            fit(c, frames_, mine, tmp_path, start=Start(resume=True), machines=ONE)
        assert caught.value.hint
    known = torch.load(last, weights_only=True)
    assert known.pop("training_frames") == {"count": 4, "mine": "0-3"}
    torch.save(known, last)
    fit(c, other, mine, tmp_path, start=Start(resume=True), machines=ONE)
    assert torch.load(last, weights_only=True)["epoch"] == 1
