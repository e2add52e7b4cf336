"""`predict` and `evaluate` of lifting models and segmentations, on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import small
import sphere_people
import xarray as xr
from PIL import Image

from cabinpose.app.cli import main
from cabinpose.core.ports import FrameBatch, PoseBatch
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import CABINPOSE, JOINTS
from cabinpose.estimate.lifter import LiftedPredictor
from cabinpose.estimate.predictor import open_model
from cabinpose.estimate.remote import open_predictor
from cabinpose.estimate.unet.config import MERGED
from cabinpose.evaluate.offline import frame_batch
from cabinpose.store import open_dataset
from cabinpose.store.class_images import read_class_images
from cabinpose.store.predictions import read_predictions

GROUPS, UPPER_BODY = CABINPOSE.groups, CABINPOSE.sets["upper body"]

FRAMES = 5


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    manifest = sphere_people.manifest(
        frames=FRAMES, frames_per_part=FRAMES, width=small.SIZE[0], height=small.SIZE[1], persons=small.PERSONS
    )
    return sphere_people.write(tmp_path_factory.mktemp("data") / "spheres", manifest)


def test_true_joints_are_lifted_and_judged_as_by_hand(
    data: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, out = str(trained["lifting"]), tmp_path / "lifted.jsonl"
    assert main(["predict", str(data), "--model", model, "--out", str(out)]) == 0
    found, dataset = read_predictions(out), open_dataset(data)
    assert (found.model, found.persons, set(found.joints)) == ("truth+lifting", small.PERSONS, set(UPPER_BODY))
    assert np.isnan(found.joints_2d).all()  # the truth is no answer
    # By hand, person by person: pinhole rays to the network, and what of it is within 10 cm.
    lifting, k = open_model(model, threads=1), dataset["camera_k"].values
    assert not dataset["camera_dist"].values.any()
    truth = dataset.sel(joint=list(UPPER_BODY))
    seen = truth["visibility"].values > Visibility.OUTSIDE_IMAGE
    errors: dict[str, list[float]] = {name: [] for name in UPPER_BODY}
    for f, p in np.ndindex(FRAMES, len(small.PERSONS)):
        uv = np.where(seen[f, p, :, None], truth["joints_2d"].values[f, p], np.nan).astype(float)
        rays = (uv - (k[f, 0, 2], k[f, 1, 2])) / (k[f, 0, 0], k[f, 1, 1])
        points = lifting.lift(rays[None])[0]
        for j in np.flatnonzero(seen[f, p]):
            errors[UPPER_BODY[j]].append(float(np.linalg.norm(points[j] - truth["joints_3d"].values[f, p, j])))
    assert main(["evaluate", str(data), "--model", model, "--resamples", "0", "--json", "--pckh", "0.5", "3"]) == 0
    direct = json.loads(capsys.readouterr().out.splitlines()[-1])["models"][0]
    assert main(["evaluate", str(data), "--predictions", str(out), "--resamples", "0", "--json", "--pckh", "0.5", "3"]) == 0
    values = json.loads(capsys.readouterr().out)["models"][0]["values"]
    assert [v["value"] for v in direct["values"]] == pytest.approx([v["value"] for v in values], abs=1e-4, nan_ok=True)
    shown = {(v["metric"], v["joints"], v["threshold"]): v["value"] for v in values if v["visibility"] == "any"}
    for group in ("All", "Head", "Shoulder", "Elbow", "Wrist", "Hip"):
        d = np.array([e for name in (UPPER_BODY if group == "All" else GROUPS[group]) for e in errors.get(name, [])])
        assert len(d) > 5
        d = np.where(np.isnan(d), np.inf, d)  # a person of too few joints
        for alpha in (0.5, 3.0):
            assert shown["PCKh", group, alpha] == pytest.approx(100 * np.mean(d <= 0.2 * alpha), abs=1e-6)
        assert shown["AUC of PCKh", group, 0.5] == pytest.approx(100 * np.mean(np.clip(1 - d / 0.1, 0, 1)), abs=1e-3)
        assert shown["MPJPE", group, None] == pytest.approx(100 * d[np.isfinite(d)].mean(), rel=1e-4)
    assert 0 < shown["PCKh", "All", 3.0] < 100


class Noisy:
    """A detector that answers with the truth and noise, by the frames' numbers."""

    name, persons, joints = "noisy", small.PERSONS[:2], JOINTS[::-1]

    def __init__(self, dataset: xr.Dataset) -> None:
        truth = dataset.sel(joint=list(self.joints), person=list(self.persons))
        shape = truth["visibility"].shape
        noise = np.random.default_rng(3).normal(0, 1, (*shape, 2))
        presence = (truth["visibility"].values > Visibility.OUTSIDE_IMAGE).astype(np.float32)
        uv = np.where(presence[..., None] > 0, truth["joints_2d"].values + noise, np.nan).astype(np.float32)
        self.all = PoseBatch(uv, truth["joints_3d"].values, presence, presence)

    def predict(self, frames: FrameBatch) -> PoseBatch:
        return self.all.map(lambda values: values[frames["frame"]])


def test_joints_are_lifted_from_a_model_and_from_its_predictions_alike(
    data: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset, model = open_dataset(data), str(trained["lifting"])
    noisy = Noisy(dataset)
    for name, opens in (("open_predictor", open_predictor), ("open_model", open_model)):
        monkeypatch.setattr(f"cabinpose.app.models.{name}", lambda model, o=opens: noisy if model == "noisy" else o(model))
    assert main(["predict", str(data), "--model", "noisy", "--out", str(tmp_path / "base.jsonl")]) == 0
    for source, out in (("noisy", "a.jsonl"), (str(tmp_path / "base.jsonl"), "b.jsonl")):
        assert main(["predict", str(data), "--model", model, "--from", source, "--out", str(tmp_path / out)]) == 0
    first, second = read_predictions(tmp_path / "a.jsonl"), read_predictions(tmp_path / "b.jsonl")
    assert first.model == second.model == "noisy+lifting"
    np.testing.assert_array_equal(first.joints_2d, second.joints_2d)
    np.testing.assert_allclose(first.joints_3d, second.joints_3d, atol=1e-5)
    frames = frame_batch(dataset, slice(0, FRAMES))
    expected = LiftedPredictor(noisy, open_model(model)).predict(frames).joints_3d
    np.testing.assert_allclose(first.joints_3d, expected[first.frame], atol=1e-4)
    upper = [JOINTS[::-1].index(name) for name in UPPER_BODY]
    moved = np.linalg.norm(expected - noisy.all.joints_3d, axis=-1)
    assert np.nanmin(moved[..., upper]) > 1e-3
    assert np.nanmax(np.delete(moved, upper, axis=-1)) == 0  # legs are not lifted
    out = tmp_path / "page"
    assert main(["evaluate", str(data), "--model", "noisy", model, "--from", "noisy", "--resamples", "0", "--out", str(out)]) == 0
    assert [r["model"] for r in json.loads((out / "report.json").read_text())["models"]] == ["noisy", "noisy+lifting"]
    capsys.readouterr()


def test_a_page_on_lifted_joints_shows_them_from_the_side(data: Path, trained: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "page"
    assert main(["evaluate", str(data), "--model", str(trained["lifting"]), "--resamples", "0", "--out", str(out)]) == 0
    page = (out / "index.html").read_text()
    wide = f'viewBox="0 0 {2 * small.SIZE[0]} {small.SIZE[1]}" class="frame"'
    assert page.count(wide) >= FRAMES
    drawn = page[page.index(wide) :].split("</svg>")[0]
    assert 'fill="#ff9f1c"' in drawn
    assert (out / "boxes.png").exists()


def test_parts_are_written_and_judged(
    data: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, out, page = str(trained["unet"]), tmp_path / "said.zarr", tmp_path / "page"
    assert main(["predict", str(data), "--model", model, "--out", str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out)
    images, dataset = read_class_images(out), open_dataset(data)
    segmenter = open_model(model, threads=1)
    np.testing.assert_array_equal(images.labels[:], segmenter.segment(frame_batch(dataset, slice(0, FRAMES))))
    assert (images.name, images.parts) == ("unet", segmenter.parts)
    assert main(["evaluate", str(data), "--predictions", str(out), "--out", str(page), "--json", "--resamples", "10"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record == json.loads((page / "report.json").read_text())
    assert main(["evaluate", str(data), "--model", model, "--json", "--resamples", "10"]) == 0
    assert json.loads(capsys.readouterr().out)["models"] == record["models"]
    [report] = record["models"]
    assert report["classes"] == ["nobody", *(part.name for part in MERGED)]
    assert sum(map(sum, report["confusion"])) == FRAMES * small.SIZE[0] * small.SIZE[1]
    html = (page / "index.html").read_text()
    assert html.count("<figure>") == len(report["typical"]) + len(report["worst"]) > 0
    with Image.open(page / "parts.png") as sheet:
        assert sheet.width == 3 * small.SIZE[0] + 16
    assert main(["evaluate", str(data), "--model", model, "--resamples", "0"]) == 0
    table = capsys.readouterr().out
    assert "mean IoU parts" in table
    assert "IoU forearm_left" in table


@pytest.mark.parametrize(
    ("line", "error", "hint"),
    [
        ("predict {d} --model {compact} --from truth --out x.jsonl", "no model lifts", "leave out --from"),
        ("predict {d} --model {unet} --out x.jsonl", "unet finds body parts, which are images", ".zarr"),
        ("predict {d} --model {compact} --out x.zarr", "compact finds joints", ".jsonl or .parquet"),
        ("evaluate {d} --model {unet} {compact}", "joints and body parts are evaluated apart", "once for each"),
        ("live --source {d} --model {unet}", "is a model of unet", "`cabinpose predict` and `evaluate` run it"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(
    data: Path, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch, line: str, error: str, hint: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(line.format(d=data, **trained).split()) == 2
    said = capsys.readouterr().err
    assert error in said
    assert hint in said.splitlines()[-1]
    assert not list(tmp_path.iterdir())
