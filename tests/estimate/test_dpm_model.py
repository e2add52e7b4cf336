"""The deformable parts as a method: what is measured on frames, people in their slots, depths, files that do not fit."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small
import yaml
from numpy.typing import NDArray

from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.estimate.data import Kept, StoredFrames
from cabinpose.estimate.dpm.config import DpmConfig
from cabinpose.estimate.dpm.find import Person, check, find, located, slots_of, surface_near
from cabinpose.estimate.dpm.fit import fit, level_depths, people_of, without_people
from cabinpose.estimate.dpm.hog import levels
from cabinpose.estimate.dpm.parts import Parts, Placement
from cabinpose.estimate.methods import METHODS
from cabinpose.estimate.training import TrainConfig, frame_spec
from cabinpose.store import open_dataset
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.generate import generate

RECIPES = Path(__file__).resolve().parents[2] / "docs" / "models"

SETTINGS = {
    "width": 64, "height": 48, "focal": 51.2, "slots": small.PERSONS, "pixel_m": 0.04, "cell_px": 2, "filter_cells": 3,
    "mixtures": 2, "limb_parts": False, "rounds": 3, "negatives": 1.0,
}  # fmt: skip
CONFIG = TrainConfig(method="dpm", settings=SETTINGS)
DPM = DpmConfig(**SETTINGS)
Arrays = dict[str, NDArray[Any]]


def quiet(*_: object) -> None:
    """Nobody is told."""


@pytest.fixture(scope="module")
def frames() -> list[Kept]:
    stored = StoredFrames(small.dataset(14), frame_spec(CONFIG))
    return [stored[i] for i in range(14)]


@pytest.fixture(scope="module")
def arrays(frames: list[Kept]) -> Arrays:
    told: list[tuple[int, int, str]] = []
    made = fit(DPM, frames[:12], lambda *what: told.append(what), seed=CONFIG.seed)
    assert told[-1][:2] == (told[-1][1],) * 2
    assert told[-1][2] == "round 3 of 3"
    check(made, DPM)
    return made


def seen(frames: list[Kept]) -> Arrays:
    return {"depth": np.stack([f.depth for f in frames]) * np.float32(1e-4)}


def test_people_it_has_not_seen_are_found_in_their_slots(frames: list[Kept], arrays: Arrays) -> None:
    found = find(arrays, DPM, seen(frames[12:]))
    for n, frame in enumerate(frames[12:]):  # one person, then two
        truth = DPM.view.from_view(frame.joints)
        error = np.linalg.norm(found.joints_3d[n] - truth, axis=-1)
        assert np.median(error[frame.present]) < 0.05
        assert np.nanmax(error) < 0.12
        there = found.presence[n].max(axis=1) > 0.5
        np.testing.assert_array_equal(there, frame.present)
    empty = find(arrays, DPM, {"depth": np.full((1, 48, 64), 2.5, np.float32)})
    assert np.isnan(empty.joints_3d).all()
    assert not empty.presence.any()


@pytest.mark.slow
def test_the_same_frames_and_seed_give_the_same_model(frames: list[Kept], arrays: Arrays) -> None:
    again = fit(DPM, frames[:12], quiet, seed=CONFIG.seed)
    assert all(np.array_equal(again[name], values, equal_nan=True) for name, values in arrays.items())
    assert all(values.dtype == np.float32 for values in arrays.values())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: {n: v for n, v in a.items() if n != "skin"}, "skin"),
        (lambda a: a | {"weights": a["weights"][:, :1]}, "weights is float32"),
        (lambda a: a | {"levels": np.zeros(0, np.float32)}, "levels"),
        (lambda a: a | {"levels": -a["levels"]}, "above zero"),
        (lambda a: a | {"anchor": a["anchor"] * np.nan}, "no numbers"),
        (lambda a: a | {"slots": a["slots"].astype(str)}, "slots is"),
    ],
)
def test_arrays_that_do_not_fit_are_told(change: Any, words: str, arrays: Arrays) -> None:
    with pytest.raises((KeyError, ValueError), match=words):
        check(change(arrays), DPM)


def test_a_filter_has_a_middle() -> None:
    with pytest.raises(ConfigError, match="filter_cells: a filter has a cell in its middle"):
        METHODS["dpm"].settings({"filter_cells": 4})


def test_frames_without_people_teach_nothing(frames: list[Kept]) -> None:
    nobody = [f._replace(present=np.zeros_like(f.present)) for f in frames[:3]]
    with pytest.raises(DatasetError, match="0 people are seen") as caught:
        fit(DPM, nobody, quiet, seed=CONFIG.seed)
    assert caught.value.hint


def test_levels_are_a_step_apart_and_cover_everybody() -> None:
    z = np.geomspace(1.5, 4.0, 400)
    depths = level_depths(DPM, z)
    ratios = depths[1:] / depths[:-1]
    assert ratios.max() <= DPM.level_step + 1e-9
    np.testing.assert_allclose(ratios, ratios[0])
    assert np.abs(np.log(z[4:-4, None] / depths)).min(axis=1).max() <= 0.5 * np.log(ratios[0]) + 1e-3
    assert len(level_depths(DPM, np.full(9, 2.0))) == 1


def test_people_are_cut_out_and_the_rest_stays(frames: list[Kept]) -> None:
    frame = frames[2]  # three people
    depth = frame.depth * np.float32(1e-4)
    cut = without_people(DPM, depth, people_of(DPM, [frame]).point)
    body, wall = (depth > 0) & (depth < 2.0), depth > 2.3
    assert body.mean() > 0.1
    assert (cut[body] > 0).mean() < 0.02
    np.testing.assert_array_equal(cut[wall], depth[wall])


def test_slots_get_the_people_whose_roots_are_nearest_in_sum() -> None:
    rng = np.random.Generator(np.random.Philox(key=(1, 0)))
    anchors = rng.normal(size=(4, 3))
    anchors[1] = np.nan  # nobody was ever there
    for count in (1, 2, 3):
        roots = rng.normal(size=(count, 3))
        pairs = slots_of(roots, anchors)
        least = min(
            sum(np.linalg.norm(roots[p] - anchors[s]) for p, s in enumerate(order)) for order in permutations((0, 2, 3), count)
        )
        assert sum(np.linalg.norm(roots[p] - anchors[s]) for p, s in pairs) == pytest.approx(least)
    assert slots_of(np.zeros((0, 3)), anchors) == []
    assert slots_of(rng.normal(size=(1, 3)), np.full((1, 3), np.nan)) == [(0, 0)]


def flat_model() -> tuple[Parts, Person]:
    """Everybody stands in a plane: each part 10 cm behind the skin, no part before another."""
    count = len(DPM.tree.parent)
    pair = np.full((count, 2, 2), 0.01)
    pair[..., 0] = 0.0
    skin = pair + (0.1, 0.0)
    none = np.zeros((count, 2, 2))
    parts = Parts(none.astype(np.float32), none, none + 1, none, pair, skin, np.array([2.0]), np.zeros((3, 3)))
    (level,) = levels(DPM, parts.levels)
    uv = np.column_stack((np.linspace(5, 60, count), np.full(count, 20.0)))
    placed = Placement(1.0, np.zeros((count, 2), np.int64), np.zeros(count, np.int64))
    return parts, Person(placed, level, level.cells(uv))


def test_a_part_is_behind_its_skin_and_not_behind_what_hides_it() -> None:
    parts, person = flat_model()
    depth = np.full((48, 64), 2.15, np.float32)
    np.testing.assert_allclose(located(parts, DPM, person, depth)[:, 2], 2.25, atol=1e-6)
    uv = np.round(located(parts, DPM, person, depth)[:, :2]).astype(int)
    hidden = depth.copy()
    for part in (0, 5):  # the root too
        u, v = uv[part]
        hidden[v - 2 : v + 3, u - 2 : u + 3] = 1.8
    hidden[:, uv[-1, 0] - 2 :] = 0.0  # and one where nothing was measured
    np.testing.assert_allclose(located(parts, DPM, person, hidden)[:, 2], 2.25, atol=1e-6)
    nearer = depth.copy()
    u, v = uv[7]
    nearer[v - 2 : v + 3, u - 2 : u + 3] += 0.04  # leans back, as far as its type does: half is believed
    off = located(parts, DPM, person, nearer)[:, 2] - 2.25
    assert 0.015 < off[7] < 0.03
    assert np.abs(np.delete(off, [7, *np.flatnonzero(DPM.tree.parent == 7)])).max() < 1e-6
    nothing = located(parts, DPM, person, np.zeros_like(depth))
    np.testing.assert_allclose(nothing[:, 2], 2.0)  # the level's depth


def test_parts_are_moved_to_where_they_are() -> None:
    parts, person = flat_model()
    depth = np.full((48, 64), 2.0, np.float32)
    before = located(parts, DPM, person, depth)
    after = located(parts._replace(shift=parts.shift + (1.0, -0.5)), DPM, person, depth)
    np.testing.assert_allclose(after[:, :2] - before[:, :2], np.array([[1.0, -0.5]] * len(before)) / person.level.scale)


def test_a_surface_is_the_median_of_what_is_near() -> None:
    depth = np.zeros((9, 9), np.float32)
    depth[3:6, 3:6] = [[1.0, 1.1, 1.2], [1.3, 1.4, 3.0], [3.1, 3.2, 0.5]]
    assert surface_near(depth, np.array((4.0, 4.0)), 1.2, 0.3) == pytest.approx(1.2)
    assert np.isnan(surface_near(depth, np.array((4.0, 4.0)), 2.0, 0.3))
    assert np.isnan(surface_near(depth, np.array((-40.0, 4.0)), 1.2, 0.3))


@pytest.mark.slow
def test_a_little_training_finds_generated_people(tmp_path: Path) -> None:
    """90 frames of the recipe and two rounds, 40 others from another seed: half of the recipe's effort has to do."""
    recipe = yaml.safe_load((RECIPES / "dpm.yaml").read_text("utf-8"))
    config = TrainConfig(method="dpm", settings=recipe["settings"] | {"rounds": 2})
    settings, made = DpmConfig(**config.settings), []
    for seed, count in ((3, 90), (4, 40)):
        folder = tmp_path / str(seed)
        generate(SynthConfig.load(RECIPES / "room-scenes.yaml"), count, folder, seed=seed, workers=1)
        stored = StoredFrames(open_dataset(folder), frame_spec(config))
        made.append([stored[i] for i in range(count)])
    found = find(fit(settings, made[0], quiet, seed=config.seed), settings, seen(made[1]))
    truth = settings.view.from_view(np.stack([f.joints for f in made[1]]))
    assert (np.linalg.norm(found.joints_3d - truth, axis=-1) < 0.1).mean() > 0.5


def test_amplitudes_are_read_where_they_are_asked_for() -> None:
    settings = SETTINGS | {"input": "amplitude", "slots": small.PERSONS[:1], "rounds": 1}
    config = TrainConfig(method="dpm", settings=settings)
    stored = StoredFrames(small.dataset(8), frame_spec(config))
    frames, dpm = [stored[i] for i in range(8)], DpmConfig(**settings)
    made = fit(dpm, frames, quiet, seed=config.seed)
    images = seen(frames[:1])
    with pytest.raises(ValueError, match="amplitudes"):
        find(made, dpm, images)
    found = find(made, dpm, images | {"amplitude": frames[0].amplitude[None].astype(np.float32)})
    error = np.linalg.norm(found.joints_3d[0, 0] - dpm.view.from_view(frames[0].joints[0]), axis=-1)
    assert np.median(error) < 0.05
