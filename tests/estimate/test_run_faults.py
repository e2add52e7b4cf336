"""Runs that ended in a traceback, or learnt something else than was asked for, without a word."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import small

from cabinpose.app import training
from cabinpose.app.cli import main
from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.estimate.data import Kept, StoredFrames
from cabinpose.estimate.train_config import Machines, TrainConfig
from cabinpose.estimate.training import fit, frame_spec
from cabinpose.estimate.walks.config import WalksConfig
from cabinpose.estimate.walks.fit import fit as fit_walks
from cabinpose.synth import SynthConfig
from cabinpose.synth.style.settings import Style

ONE = Machines(1)
CROWD = {"people": {"subjects": [], "random": {"count": 20}}}


def config(method: str, **changes: object) -> TrainConfig:
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
        training.generated_frames(scenes, spec, 4, 1)
    assert "style" in caught.value.hint
    monkeypatch.setattr(training, "preflight", lambda *_, **__: None)  # reads the style's model
    styled = scenes.model_copy(update={"style": Style(by="style.onnx")})
    for image, made in (("depth_styled", True), ("depth", False)):
        for side in training.generated_frames(styled, spec._replace(depth_image=image), 4, 1):
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
        training.generated_frames(SynthConfig(), spec, 4, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        training.generated_frames(SynthConfig.parse(CROWD), spec, 4, 1)
