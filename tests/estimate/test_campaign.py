"""The campaign of the packaged models: tables, frozen test frames that no training sees, pieces that go on, what is shipped."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import campaign
import numpy as np
import pytest
import small
import xarray as xr
import yaml
from campaign import RECIPES, Campaign, Deadline, FrameSet, OutOfTimeError, Rows, Table, blind_frames

from cabinpose.core import ConfigError
from cabinpose.estimate import load_model, read_train_config
from cabinpose.estimate.export import export_onnx
from cabinpose.estimate.predictor import describe_model, packaged_models
from cabinpose.synth import SynthConfig

TABLE = Table.model_validate(yaml.safe_load((RECIPES / "campaign.yaml").read_text("utf-8")))
ROWS = Rows.model_validate(yaml.safe_load((RECIPES / "test-frames.yaml").read_text("utf-8"))).rows


def scenes(frames: Any) -> SynthConfig:
    return SynthConfig.load(RECIPES / frames.scenes, frames.set)


def people_and_cars(frames: Any) -> set[str]:
    """Whom and what a set of frames may show: names alone of what is itself in every dataset, with the seed what is drawn."""
    config = scenes(frames)
    named = {*config.people.subjects, *config.people.own}
    named |= {f"{frames.seed} {i}" for i in range(config.people.random.count if config.people.random else 0)}
    if config.scene.kind != "cabin":
        return named
    cars = {car if isinstance(car, str) else car.name for car in config.scene.cars}
    return named | cars | {f"{frames.seed} C{i}" for i in range(config.scene.random_cars)}


def test_no_training_sees_people_cars_or_seeds_of_the_frozen_frames() -> None:
    frozen = {name: row for name, row in ROWS.items() if row.scenes}
    seen = {name: people_and_cars(row) for name, row in frozen.items()}
    assert "S01" in seen["plain"]
    assert "coupe" in seen["plain"]
    for name, frames in TABLE.frames.items():
        learnt = people_and_cars(frames)
        assert learnt
        for row, shown in seen.items():
            assert not learnt & shown, (name, row)
    seeds = [frames.seed for frames in TABLE.frames.values()]
    assert len(set(seeds)) == len(seeds)
    assert not {*seeds} & {row.seed for row in ROWS.values()}


def test_every_packaged_model_has_its_recipe_frames_and_rows() -> None:
    assert set(TABLE.models) == set(packaged_models())
    for name, plan in TABLE.models.items():
        config = read_train_config(RECIPES / plan.config, None)
        described = describe_model(packaged_models()[name])
        if plan.init:  # the recipe is that of the file's network
            known = described["settings"]
            assert {key: config.settings[key] for key in known} == known
        assert plan.mirrored == described["mirrored"]
        for frames in [plan.validate_, *(frames for each in plan.rounds for frames in each.frames)]:
            assert scenes(TABLE.frames[frames])
        assert plan.validate_ not in {frames for each in plan.rounds for frames in each.frames}
        first = next(row for row in ROWS.values() if name in row.models)
        assert not first.blind
        assert not first.empty


@pytest.mark.parametrize("kind", ["nan", "wall", "hand"])
def test_nobody_is_found_in_blind_frames(kind: str) -> None:
    frames = blind_frames(kind, 6, rng=np.random.Generator(np.random.Philox(key=1)))
    depth = frames["depth"]
    assert depth.shape[0] == 6
    assert np.isnan(depth).all() == (kind == "nan")
    if kind == "hand":
        assert (np.median(depth[::2], axis=(1, 2)) < 0.15).all()
    with pytest.warns(UserWarning, match="cannot see anybody"):
        found = load_model("in_car").predict(frames)
    blind = np.array([bool(reason) for reason in found.reason])
    assert blind[::2].all()
    assert (found.presence[blind] == 0).all()


def opened(folder: Path) -> xr.Dataset:
    """Eight frames of people who are called after the folder."""
    data = small.dataset(8).assign_coords({name: ("frame", np.zeros(8, np.int64)) for name in ("sequence", "sync_ns")})
    data = data.assign_attrs(width=small.SIZE[0], height=small.SIZE[1])
    data["vehicle_from_camera"] = (("frame", "row", "column"), np.tile(np.eye(4), (8, 1, 1)))
    others = np.where(data["subject"].values == "", "", np.char.add(folder.name, data["subject"].values.astype(str)))
    return data.assign_coords(subject=(("frame", "person"), others))


@pytest.fixture
def tiny(tmp_path: Path, checkpoints: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> Campaign:
    """A campaign of two rounds over frames of sphere people in memory."""
    recipes, package = tmp_path / "recipes", tmp_path / "package"
    recipes.mkdir()
    package.mkdir()
    recipe = {"method": "compact", "settings": small.TINY["compact"] | {"slots": list(small.PERSONS)}, "batch": 4, "average": 0.0}
    table = {
        "version": 1,
        "frames": {name: {"scenes": "none.yaml", "frames": 8, "seed": 5} for name in ("some", "held")},
        "models": {"tiny": {
            "config": "tiny.yaml", "validate": "held", "mirrored": False,
            "rounds": [{"frames": ["some"], "epochs": e, "learning_rate": 0.01, "seed": s} for e, s in ((2, 1), (1, 2))],
        }},
    }  # fmt: skip
    rows = {"version": 1, "rows": {
        "plain": {"models": ["tiny"], "scenes": "none.yaml", "frames": 8, "seed": 6},
        "blind": {"models": ["tiny"], "blind": "nan", "frames": 2, "seed": 7},
    }}  # fmt: skip
    card = {"summary": "spheres", "trained": "for the tests.", "figures": {}, "tested on": "", "command": ""}
    files = {"campaign.yaml": table, "test-frames.yaml": rows, "tiny.yaml": recipe, "tiny-card.yaml": card}
    for name, data in files.items():
        (recipes / name).write_text(yaml.safe_dump(json.loads(json.dumps(data)), sort_keys=False), "utf-8")
    export_onnx(checkpoints["compact"], package / "tiny.onnx", name="tiny", card=card)

    monkeypatch.setattr(campaign, "open_dataset", opened)
    monkeypatch.setattr(Campaign, "made", lambda _self, name, *_: Path(name))
    monkeypatch.setattr(Campaign, "_calibrate", lambda *_: None)
    return Campaign("tiny", tmp_path / "kept", recipes=recipes, package=package)


def test_a_run_stops_before_an_epoch_that_does_not_fit_and_goes_on(tiny: Campaign, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ConfigError, match="nothing of tiny is trained"):
        tiny.ship()
    assert not tiny.run(0.0)
    assert "round 1, 0 of 2 epochs: an epoch takes" in capsys.readouterr().out
    told = Deadline.on_train_batch_end
    try:
        Deadline.on_train_batch_end = lambda _self, trainer, *_: _out_of_time(trainer.current_epoch)  # type: ignore[assignment]
        assert not tiny.run(10.0)
    finally:
        Deadline.on_train_batch_end = told  # type: ignore[method-assign]
    assert "round 1, 1 of 2 epochs" in capsys.readouterr().out
    assert tiny.run(10.0)
    assert [len((tiny.folder / "tiny" / f"round-{i}" / "log" / "metrics.csv").read_text().splitlines()) for i in (1, 2)] == [3, 2]
    assert tiny.run(0.0)  # there is nothing left to do


def _out_of_time(epoch: int) -> None:
    if epoch == 1:
        raise OutOfTimeError("for the test")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:a frame in which tiny cannot see anybody")
def test_better_weights_alone_are_shipped_with_their_card(tiny: Campaign) -> None:
    assert tiny.run(10.0)
    packaged, card = tiny.package / "tiny.onnx", tiny.recipes / "tiny-card.yaml"
    before = packaged.read_bytes(), card.read_bytes()
    better = tiny.ship()
    told = json.loads((tiny.folder / "tiny" / "figures.json").read_text("utf-8"))
    assert told["decides"] == "plain, AUC 2D"
    assert better == (told["after"]["plain"]["AUC 2D"] > told["before"]["plain"]["AUC 2D"])
    assert told["after"]["blind"] == {"false people": 0.0}
    assert set(campaign.FIGURES) <= told["after"]["plain"].keys()
    if not better:
        assert (packaged.read_bytes(), card.read_bytes()) == before
        tiny.ship(anyway=True)
    written = yaml.safe_load(card.read_text("utf-8"))
    assert describe_model(packaged)["card"] == written
    assert "2 epochs over some (learning rate 0.01, seed 1); 1 epochs over some" in written["trained"]
    assert f"AUC 2D {told['after']['plain']['AUC 2D']:.1f}" in written["figures"]["plain"]
    shipped = packaged.read_bytes()
    assert not tiny.ship()  # the same weights are no better
    assert packaged.read_bytes() == shipped


@pytest.mark.parametrize("model", ["lift", "parts"])
def test_models_that_answer_otherwise_have_a_figure_that_decides(model: str) -> None:
    figures = campaign._figures(opened(Path("some")), packaged_models()[model], ROWS["everyone"])
    assert campaign.DECIDES[1 if model == "lift" else 2] in figures


@pytest.mark.slow
def test_frames_whose_making_was_cut_short_are_made_to_their_end(tmp_path: Path) -> None:
    made = Campaign("in_car", tmp_path)
    some = FrameSet(scenes="in-car-scenes.yaml", frames=3, seed=5, set=("output.frames_per_part=1",))
    with pytest.raises(OutOfTimeError, match="some is not whole yet"):
        made.made("some", some, "frames", Deadline(0.03))
    assert campaign.open_dataset(made.made("some", some, "frames", Deadline(5))).sizes["frame"] == 3
