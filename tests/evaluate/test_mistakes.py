"""What a tired engineer does to a predictions file is named before the numbers; what a detector does by itself is not."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.api import evaluate_predictions as evaluate_file
from cabinpose.app.cli import main
from cabinpose.core import CABINPOSE, ITOP, FrameBatch, PoseBatch, PredictionsError, Visibility
from cabinpose.evaluate import Caveats, EvaluationOptions, evaluate, samples_of
from cabinpose.evaluate.mistakes import MARGIN, MISTAKES, Positions, Trial, explanations
from cabinpose.store import (
    Manifest,
    PartWriter,
    Predictions,
    blank_frame,
    create_dataset,
    open_dataset,
    read_predictions,
    write_predictions,
)

OPTIONS = EvaluationOptions(resamples=0)
WIDTH, HEIGHT, FRAMES = 320, 240, 12
K = np.array([[280.0, 0, 158], [0, 280, 121], [0, 0, 1]])
SEATS = ("driver", "front_passenger")
# A person who sits before the camera, in metres: x to their left, y down, z away from the camera, origin at the neck.
BODY = np.array([
    [0, -0.18, 0], [0, 0, 0], [0, 0.2, 0.02], [0.18, 0.04, 0], [-0.18, 0.04, 0], [0.26, 0.3, -0.05], [-0.26, 0.3, -0.05],
    [0.2, 0.38, -0.28], [-0.2, 0.38, -0.28], [0.17, 0.39, -0.36], [-0.17, 0.39, -0.36], [0, 0.52, 0], [0.09, 0.52, 0],
    [-0.09, 0.52, 0], [0.14, 0.5, -0.42], [-0.14, 0.5, -0.42], [0.15, 0.85, -0.5], [-0.15, 0.85, -0.5], [0.16, 0.92, -0.62],
    [-0.16, 0.92, -0.62],
])  # fmt: skip


def _people(rng: np.random.Generator) -> NDArray[np.float64]:
    """(FRAMES, 2, 20, 3) people of their own size and posture in every frame, turned and bent by up to half a radian."""
    joints = np.empty((FRAMES, 2, len(BODY), 3))
    for frame in range(FRAMES):
        for seat in range(2):
            turn, bend, size = *rng.uniform(-0.5, 0.5, 2), rng.uniform(0.9, 1.1)
            about_y = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
            about_x = [[1, 0, 0], [0, np.cos(bend), -np.sin(bend)], [0, np.sin(bend), np.cos(bend)]]
            posed = BODY.copy()
            posed[5:11] += rng.normal(0, 0.1, 3)  # the arms by themselves
            place = np.array([0.45 - 0.9 * seat, -0.3, 2.2]) + rng.normal(0, 0.12, 3)
            joints[frame, seat] = size * posed @ np.transpose(about_y) @ np.transpose(about_x) + place
    return joints


def _projected(joints: NDArray[np.float64]) -> NDArray[np.float64]:
    homogeneous = joints @ K.T
    return homogeneous[..., :2] / homogeneous[..., 2:]


VEHICLE_FROM_CAMERA = np.array([[0, 0, -1, 2.1], [1, 0, 0, 0.3], [0, -1, 0, 1.2], [0, 0, 0, 1.0]])


class Case(NamedTuple):
    """A dataset, its folder, and what a detector says that is off by 1 cm and 1 px."""

    folder: Path
    dataset: xr.Dataset
    good: Predictions


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    rng = np.random.default_rng(3)
    joints = _people(rng)
    folder = tmp_path_factory.mktemp("mistakes") / "cabins"
    manifest = Manifest(
        generator="test", generator_version="1", seed=3, licence="CC0-1.0", frames=FRAMES, width=WIDTH, height=HEIGHT,
        persons=SEATS, variables=(),
    )  # fmt: skip
    with create_dataset(folder, manifest), PartWriter(folder, manifest.parts[0], manifest) as part:
        for frame in joints:
            seen = {
                "joints_3d": frame.astype(np.float32), "joints_2d": _projected(frame).astype(np.float32),
                "visibility": np.full(frame.shape[:2], Visibility.VISIBLE, np.uint8), "subject": ["S1", "S2"],
                "camera_k": K, "camera_dist": np.zeros(5), "vehicle_from_camera": VEHICLE_FROM_CAMERA,
            }  # fmt: skip
            part.append(blank_frame(manifest) | seen)
    dataset = open_dataset(folder)
    shape = joints.shape[:3]
    off = rng.normal(0, 0.01, joints.shape)
    good = Predictions(
        (_projected(joints) + rng.normal(0, 1, (*shape, 2))).astype(np.float32), (joints + off).astype(np.float32),
        np.ones(shape, np.float32), np.ones(shape, np.float32), np.arange(FRAMES), SEATS, CABINPOSE.joints, "mine",
        dataset=dataset.attrs["dataset_id"],
    )  # fmt: skip
    return Case(folder, dataset, good)


Change = Callable[[Predictions], Predictions]


def _xyz(change: Callable[[NDArray[Any]], NDArray[Any]]) -> Change:
    return lambda good: replace(good, joints_3d=change(good.joints_3d).astype(np.float32))


def _uv(change: Callable[[NDArray[Any]], NDArray[Any]]) -> Change:
    return lambda good: replace(good, joints_2d=change(good.joints_2d).astype(np.float32))


def _all(change: Callable[[NDArray[Any]], NDArray[Any]]) -> Change:
    return lambda good: replace(good, **vars(good.map(change)))


def _named(joint: str) -> int:
    return CABINPOSE.joints.index(joint)


def _other_side(joint: str) -> str:
    return {"l": "r", "r": "l"}[joint[0]] + joint[1:] if joint[0] in "lr" else joint


OTHER_SIDE = [_named(_other_side(joint)) for joint in CABINPOSE.joints]
AS_TEXT = np.array(sorted(range(FRAMES), key=str))
SIZE = np.array([WIDTH, HEIGHT])
FOUND: dict[str, tuple[Change, str, str]] = {  # what was done, the space in which it shows, what is said
    "3D in mm": (_xyz(lambda x: 1000 * x), "3d", "if x, y and z are millimetres"),
    "3D in cm": (_xyz(lambda x: 100 * x), "3d", "if x, y and z are centimetres"),
    "3D in inches": (_xyz(lambda x: x / 0.0254), "3d", "if x, y and z are inches"),
    "3D in mm, y up": (_xyz(lambda x: x * [1000, -1000, 1000]), "3d", "millimetres in place of metres and y points up"),
    "y mirrored": (_xyz(lambda x: x * [1, -1, 1]), "3d", "if y points up in place of down"),
    "x mirrored": (_xyz(lambda x: x * [-1, 1, 1]), "3d", "if x points left"),
    "OpenGL's camera": (_xyz(lambda x: x * [1, -1, -1]), "3d", "if y points up and z backwards"),
    "z mirrored": (_xyz(lambda x: x * [1, 1, -1]), "3d", "if z points backwards"),
    "an image on its head, 3D": (_xyz(lambda x: x * [-1, -1, 1]), "3d", "if x points left and y up"),
    "z up, y forward": (_xyz(lambda x: np.stack((x[..., 0], x[..., 2], -x[..., 1]), -1)), "3d", "if z points up and y forward"),
    "x and y exchanged": (_xyz(lambda x: x[..., [1, 0, 2]]), "3d", "if x and y are exchanged"),
    "x and z exchanged": (_xyz(lambda x: x[..., [2, 1, 0]]), "3d", "if x and z are exchanged"),
    "the vehicle's frame": (
        _xyz(lambda x: x @ VEHICLE_FROM_CAMERA[:3, :3].T + VEHICLE_FROM_CAMERA[:3, 3]), "3d", "are of the vehicle's frame",
    ),
    "relative to the hip": (_xyz(lambda x: x - x[:, :, [_named("hip")]]), "3d", "all are given relative to their hip"),
    "z as the distance": (
        _xyz(lambda x: np.concatenate((x[..., :2], np.linalg.norm(x, axis=-1, keepdims=True)), -1)), "3d",
        "if z is the distance from the lens",
    ),
    "u, v of half the image": (_uv(lambda u: (u - 0.5) / 2), "2d", "at half its size"),
    "u, v of twice the image": (_uv(lambda u: 2 * u + 0.5), "2d", "at twice its size"),
    "u, v of a quarter": (_uv(lambda u: (u - 1.5) / 4), "2d", "at a quarter of its size"),
    "u and v exchanged": (_uv(lambda u: u[..., ::-1]), "2d", "if u and v are exchanged"),
    "u, v from 0 to 1": (_uv(lambda u: u / SIZE), "2d", "if u and v go from 0 to 1"),
    "u, v from -1 to 1": (_uv(lambda u: 2 * u / SIZE - 1), "2d", "if u and v go from -1 to 1"),
    "v from the bottom": (_uv(lambda u: np.stack((u[..., 0], HEIGHT - 1 - u[..., 1]), -1)), "2d", "if v counts from the bottom"),
    "u from the right": (_uv(lambda u: np.stack((WIDTH - 1 - u[..., 0], u[..., 1]), -1)), "2d", "if u counts from the right"),
    "an image on its head": (_uv(lambda u: SIZE - 1 - u), "2d", "if the image is turned by 180°"),
    "an image turned left": (_uv(lambda u: np.stack((u[..., 1], WIDTH - 1 - u[..., 0]), -1)), "2d", "turned by"),
    "an image turned right": (_uv(lambda u: np.stack((HEIGHT - 1 - u[..., 1], u[..., 0]), -1)), "2d", "turned by"),
    "left and right": (_all(lambda a: a[:, :, OTHER_SIDE]), "3d", "if left and right are exchanged"),
    "seats": (_all(lambda a: a[:, ::-1]), "3d", "if the seats are exchanged (driver and front_passenger"),
    "joints in another order": (_all(lambda a: np.roll(a, 1, 2)), "2d", "named in another order (head under the name neck"),
    "a frame late": (_all(lambda a: np.roll(a, 1, 0)), "3d", "if frame n is given the predictions of frame n +1"),
    "two frames early": (_all(lambda a: np.roll(a, -2, 0)), "3d", "if frame n is given the predictions of frame n -2"),
    "frames as text": (_all(lambda a: a[AS_TEXT]), "2d", "in the order of their names as text"),
    "no order at all": (_all(lambda a: a[[7, 2, 10, 4, 0, 9, 1, 11, 3, 5, 8, 6]]), "3d", "follow other frames as well as"),
}  # fmt: skip


def judged(case: Case, predictions: Predictions, options: EvaluationOptions = OPTIONS) -> Caveats:
    return samples_of(case.dataset, predictions, options)[1]


def _median_error(case: Case, predictions: Predictions, space: str) -> float:
    """Over all joints in cm or px, told by numpy alone."""
    if space == "3d":
        return 100 * float(np.median(np.linalg.norm(predictions.joints_3d - case.dataset["joints_3d"].values, axis=-1)))
    return float(np.median(np.linalg.norm(predictions.joints_2d - case.dataset["joints_2d"].values, axis=-1)))


@pytest.mark.parametrize("done", FOUND)
def test_a_mistake_is_named_with_figures(case: Case, done: str) -> None:
    change, space, said = FOUND[done]
    predictions = change(case.good)
    caveats = judged(case, predictions)
    found = {each.space: each for each in caveats.explanations}[space]
    assert said in found.words
    if found.mistakes != ("unrelated",):
        assert found.after < 3 * _median_error(case, case.good, space)
        assert found.before > MARGIN * found.after
        assert found.before == pytest.approx(_median_error(case, predictions, space), rel=1e-4)
        assert f"{found.after:.2g} {found.unit} (median, {space.upper()})" in found.words
    if space == "2d" and "if the image" in said:
        assert [each.space for each in caveats.explanations] == ["2d"]  # 3D is as it should be


@pytest.mark.slow
def test_every_row_of_the_table_is_found(case: Case) -> None:
    every = [each for change, _, _ in FOUND.values() for each in judged(case, change(case.good)).explanations]
    named = {name for each in every for name in each.mistakes}
    rest = {"frame -1", "frame +2", "frame +3", "frame -3", "frames by place"}
    assert {row.name for row in MISTAKES} - named == rest


def test_a_selection_that_counts_its_own_frames(case: Case) -> None:
    rows = [1, 3, 4, 6, 8, 9, 11]
    answers = _all(lambda a: a[rows])(case.good)
    chosen = case.dataset.isel(frame=rows)
    _, counted = samples_of(chosen, replace(answers, frame=np.arange(7)), OPTIONS)
    assert [each.mistakes for each in counted.explanations] == [("frames by place",)] * 2
    assert not samples_of(chosen, replace(answers, frame=np.array(rows)), OPTIONS)[1].explanations


def test_nothing_is_said_of_good_answers(case: Case) -> None:
    caveats = judged(case, case.good)
    assert caveats.explanations == caveats.notes == ()
    assert caveats.coverage == ""
    for match in ("oks", "distance"):
        assert not judged(case, case.good, replace(OPTIONS, match=match)).explanations


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
@pytest.mark.parametrize("space", ["2d", "3d"])
def test_nothing_is_said_of_weak_detectors(case: Case, space: str, seed: int) -> None:
    """Noise of any size, everybody's mean pose, a constant, a bias, people who are too large: no mistake explains them."""
    rng = np.random.default_rng(seed)
    name, scale = ("joints_3d", 1.0) if space == "3d" else ("joints_2d", 150.0)
    good = getattr(case.good, name)
    mean = np.broadcast_to(good.mean(axis=0), good.shape)
    weak = [good + rng.normal(0, size * scale, good.shape) for size in (0.05, 0.2, 0.5, 2, 100)]
    weak += [mean, mean + rng.normal(0, 0.05 * scale, good.shape), np.full(good.shape, 0.1), good + 0.4 * scale, 1.3 * good]
    weak += [rng.normal(0, size * scale, good.shape) for size in (0.01, 1, 1000)]
    for answers in weak:
        assert judged(case, replace(case.good, **{name: answers.astype(np.float32)})).explanations == ()


def test_twice_as_good_is_no_mistake(case: Case) -> None:
    """Left and right exchanged beneath so much noise that the errors would only be halved."""
    rng = np.random.default_rng(0)
    weak = _xyz(lambda x: x + rng.normal(0, 0.07, x.shape))(case.good)
    crossed = _all(lambda a: a[:, :, OTHER_SIDE])(weak)
    assert 1.8 < _median_error(case, crossed, "3d") / _median_error(case, weak, "3d") < 3
    assert [each.space for each in judged(case, crossed).explanations] == ["2d"]


def test_people_without_seats(case: Case) -> None:
    """Matched by the assignment, as for methods that know no seats: held against the nearest person."""
    options = replace(OPTIONS, match="distance")
    exchanged = _all(lambda a: a[:, ::-1])(case.good)
    assert not judged(case, exchanged, options).explanations
    found = judged(case, _xyz(lambda x: 1000 * x)(exchanged), options).explanations
    assert [each.mistakes for each in found] == [("mm",)]


def test_people_who_sit_elsewhere_cannot_be_compared(case: Case) -> None:
    """Where nobody is in the seat that the answer is of, there is no error to fall: said so."""
    alone = case.dataset.copy()
    alone["visibility"] = alone["visibility"].where(alone["person"] == "driver", 0).astype(np.uint8)
    for name in ("joints_2d", "joints_3d"):
        alone[name] = alone[name].where(alone["person"] == "driver")
    moved = _all(lambda a: np.where(np.arange(2).reshape(1, 2, *[1] * (a.ndim - 2)) == 1, a[:, ::-1], np.nan))(case.good)
    [found, _] = evaluate(alone, moved, OPTIONS).caveats.explanations
    assert "0 joints can be compared as they are, and 240, " in found.words
    assert np.isinf(found.before)
    told = evaluate(alone, moved, OPTIONS).to_dict()["caveats"]["explanations"][0]
    assert set(told) == {"mistakes", "space", "before", "after", "unit", "words"}


class Wrong:
    """A detector whose unit is millimetres."""

    name, persons, joints = "in mm", SEATS, CABINPOSE.joints

    def __init__(self, answers: Predictions) -> None:
        self._answers, self._next = answers, 0

    def predict(self, frames: FrameBatch) -> PoseBatch:
        count = len(frames["depth"])
        self._next += count
        batch = self._answers.take(np.arange(self._next - count, self._next))
        return replace(batch, joints_3d=1000 * batch.joints_3d)


def test_a_detector_that_runs(case: Case) -> None:
    seen = case.dataset.assign(depth=(("frame", "y", "x"), np.ones((FRAMES, 4, 4), np.float32)))
    report = evaluate(seen, Wrong(case.good), OPTIONS)
    assert [each.mistakes for each in report.caveats.explanations] == [("mm",)]
    assert (report.caveats.identity, report.caveats.answered) == ("run", FRAMES)


# ------------------------------------------------------------------------------------------------------- the file


def _file(
    case: Case, path: Path, change: Callable[[dict[str, Any], list[dict[str, Any]]], Iterable[dict[str, Any]] | None]
) -> Path:
    """The good predictions as JSON lines, its header and rows changed."""
    header, *rows, _ = map(json.loads, write_predictions(path, case.good, overwrite=True).read_text().splitlines())
    rows = list(change(header, rows) or rows)
    path.write_text("".join(json.dumps(line) + "\n" for line in (header, *rows, {"rows": len(rows)})))
    return path


def _set(**values: Any) -> Callable[[dict[str, Any], list[dict[str, Any]]], None]:
    """Every row with some columns changed: a value, or a function of the row."""

    def change(_: dict[str, Any], rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row.update({name: value(row) if callable(value) else value for name, value in values.items()})

    return change


def _first(count: int, **values: Any) -> Callable[[dict[str, Any], list[dict[str, Any]]], None]:
    return lambda header, rows: _set(**values)(header, rows[:count])


REFUSED: dict[str, tuple[Callable[..., Any], str]] = {
    "presence in per cent": (_set(presence=97.0), "presence is a probability, not 97"),
    "presence as a logit": (_first(5, presence=-2.5), "presence is a probability, not -2.5"),
    "NaN for a coordinate": (_first(1, u=float("nan")), "u is nan"),
    "infinity for a score": (_first(1, score=float("inf")), "score is inf"),
    "text for a number": (_first(1, x="1.2 m"), "column x holds something that is no number"),
    "0, 0, 0 for not found": (_first(4, x=0.0, y=0.0, z=0.0), "x, y, z are all 0, as in 4 of 480 rows"),
    "-1, -1 for not found": (_first(7, u=-1.0, v=-1.0), "u, v are all -1, as in 7 of 480 rows"),
    "0, 0 for not found": (_first(7, u=0, v=0), "u, v are all 0, as in 7 of 480 rows"),
    "frames as text": (_first(1, frame="0"), "is no frame number"),
    "frames from another count": (_set(frame=lambda row: row["frame"] + 100), "the dataset has no frame 100"),
    "stamps for frames": (_set(frame=lambda row: 1_700_000_000_000 + row["frame"]), "the dataset has no frame 17000"),
    "a joint's name of another set": (lambda header, _: header["joints"].__setitem__(0, "nose"), "unknown joint 'head'"),
    "seats by number": (_set(person=lambda row: SEATS.index(row["person"])), "unknown person 0"),
    "expected errors below 0": (_set(expected_error_m=-0.1), "expected_error_m is below 0"),
    "z left out": (lambda _, rows: [row.pop("z") for row in rows] and None, "has some of x, y, z"),
    "a frame twice": (lambda _, rows: [*rows, rows[0]], "has 2 rows"),
    "another dataset's": (lambda header, _: header.update(dataset="sha256:0123456789abcdef"), "are of the dataset 'sha256:0123"),
    "another folder's": (lambda header, _: header.update(dataset="other-cabins"), "are of the dataset 'other-cabins'"),
}


@pytest.mark.parametrize("done", REFUSED)
def test_what_cannot_be_is_refused(case: Case, done: str, tmp_path: Path) -> None:
    change, said = REFUSED[done]
    with pytest.raises(PredictionsError) as caught:
        evaluate_file(case.folder, _file(case, tmp_path / "wrong.jsonl", change), options=OPTIONS)
    assert said in str(caught.value)
    assert caught.value.hint


def test_what_is_right_is_not_refused(case: Case, tmp_path: Path) -> None:
    assert evaluate_file(case.folder, _file(case, tmp_path / "right.jsonl", lambda *_: None), options=OPTIONS).notes == ()


NOTED: dict[str, tuple[Callable[..., Any], str]] = {
    "a presence that is no probability": (_set(presence=0.03), "no joint has a presence of 0.5 or more (the highest is 0.03)"),
    "a score for some": (lambda _, rows: [row.pop("score") for row in rows[:9]] and None, "score is left out in 9 of 480 rows"),
    "expected errors in cm": (_set(expected_error_m=2.3), "the median of expected_error_m is 2.3 m"),
    "another image's pixels": (_set(u=lambda row: row["u"] + 900), "100 % of the positions u, v lie outside of the image"),
    "behind the camera": (_set(z=lambda row: -row["z"]), "100 % of the positions x, y, z lie behind the camera"),
    "one answer for all": (
        lambda _, rows: [rows[i % 40] | {"frame": row["frame"]} for i, row in enumerate(rows)], "are the same in all 12",
    ),
    "half of the frames": (lambda _, rows: [row for row in rows if row["frame"] % 2], "6 of 12 frames are not in the"),
}  # fmt: skip


@pytest.mark.parametrize("done", NOTED)
def test_what_stands_out_is_noted(case: Case, done: str, tmp_path: Path) -> None:
    change, said = NOTED[done]
    report = evaluate_file(case.folder, _file(case, tmp_path / "odd.jsonl", change), options=OPTIONS)
    assert any(said in note for note in report.notes), report.notes


def test_a_corner_is_a_position(case: Case, tmp_path: Path) -> None:
    read_predictions(_file(case, tmp_path / "corner.jsonl", _first(2, u=0, v=0)))


# --------------------------------------------------------------------------------------- what stands beside the numbers


def test_the_command_says_it_before_the_numbers(case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    half = replace(_xyz(lambda x: 1000 * x)(case.good), dataset=None)
    half = replace(_all(lambda a: a[:9])(half), frame=np.arange(9))
    path, out = write_predictions(tmp_path / "half.jsonl", half), tmp_path / "out"
    assert main(["evaluate", str(case.folder), "--predictions", str(path), "--out", str(out), "--resamples", "0"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "if x, y and z are millimetres" in lines[0]
    assert lines[1:3] == ["(the numbers below are of the answers as they are)", "mine on cabins: 12 frames, 24 people"]
    coverage = "answers for 9 of 12 frames; the predictions name no dataset: that they are of this one is not checked"
    assert lines.count(coverage) == 2  # above each table
    page = (out / "index.html").read_text()
    assert f"<b>{lines[0]}</b>" in page
    assert page.count(f"mine: {coverage}") == 7  # each section with figures; a dataset without depth has no pictures of frames
    [told] = json.loads((out / "report.json").read_text())["models"]
    assert told["caveats"]["identity"] == "unchecked"
    assert (told["caveats"]["answered"], told["caveats"]["frames"]) == (9, 12)
    assert told["caveats"]["explanations"][0]["mistakes"] == ["mm"]
    assert told["caveats"]["explanations"][0]["words"] == lines[0]


def test_identity(case: Case) -> None:
    assert judged(case, case.good).identity == "id"
    assert "name no dataset" in judged(case, replace(case.good, dataset=None)).coverage
    assert "not its id" in judged(case, replace(case.good, dataset="cabins")).coverage


@pytest.mark.real_data
def test_on_real_people(real_data: Callable[[str], Path]) -> None:
    """A2J's published answers on ITOP: nothing is said of them, and three mistakes with them are named."""
    with np.load(real_data("itop/itop_front_64.npz")) as arrays:
        true, given = (arrays[name].astype(np.float64)[:, None] * (1, -1, 1) for name in ("joints_3d", "a2j_3d"))
    frames, mirror = np.arange(len(true)), list(ITOP.mirror)
    none = np.full((*true.shape[:-1], 2), np.nan)
    made = Trial(
        Positions(none, true), Positions(none, given), frames, frames, ("person",), ITOP, (320, 240),
        np.broadcast_to(np.eye(4), (len(true), 4, 4)), None, True,
    )  # fmt: skip
    assert explanations(made) == ()
    wrong = {"mm": 1000 * given, "y mirrored": given * [1, -1, 1], "sides": given[:, :, mirror]}
    for name, answers in wrong.items():
        assert [each.mistakes for each in explanations(replace(made, given=Positions(none, answers)))] == [(name,)]


def elsewhere(case: Case, predictions: Predictions, options: EvaluationOptions = OPTIONS) -> tuple[float, list[str]]:
    report = evaluate(case.dataset, predictions, options)
    (share,) = (v.value for v in report.values if v.metric == "people found in another's place")
    return share, [note for note in report.notes if "another's place" in note]


def test_seats_exchanged_in_some_frames_are_counted_and_named(case: Case) -> None:
    """Too few frames for a mistake of the file; an overlay of joints without names looks right."""
    swapped = np.arange(FRAMES)[:, None, None, None] % 5 == 3  # frames 3 and 8
    share, notes = elsewhere(
        case, _all(lambda a: np.where(swapped if a.ndim == 4 else swapped[..., 0], a[:, ::-1], a))(case.good)
    )
    assert share == pytest.approx(100 * 4 / 24)
    assert notes == ["4 of 24 people were found, but in another's place (frames 3, 8): their joints count as wrong"]
    assert elsewhere(case, case.good) == (0.0, [])


def test_an_answer_that_is_of_its_own_person_is_not_of_who_is_behind(case: Case) -> None:
    """Both are seen at nearly the same pixels; the one behind has no answer."""
    truth = case.dataset.joints_2d.values
    hidden = case.dataset.assign(joints_2d=(case.dataset.joints_2d.dims, truth[:, [0, 0]]))
    alone = _all(
        lambda a: np.where((np.arange(2) == 1)[:, None, None] if a.ndim == 4 else (np.arange(2) == 1)[:, None], np.nan, a)
    )
    only_driver = alone(replace(case.good, joints_2d=truth.astype(np.float32)))
    only_driver = replace(only_driver, presence=np.nan_to_num(only_driver.presence), score=np.nan_to_num(only_driver.score))
    assert elsewhere(case._replace(dataset=hidden), only_driver) == (0.0, [])


def test_who_is_matched_by_the_assignment_is_in_nobodys_place(case: Case) -> None:
    swapped = _all(lambda a: a[:, ::-1])(case.good)
    assert elsewhere(case, swapped, replace(OPTIONS, match="oks"))[0] == 0.0
    assert elsewhere(case, swapped)[0] == 100.0
