"""Expected errors: fitted to what is known of a law, kept in the model's file, and said by every verb that runs a model."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import small
import sphere_people
import torch
from numpy.typing import NDArray
from sklearn.isotonic import IsotonicRegression

from cabinpose.app.cli import main
from cabinpose.core.errors import ModelError
from cabinpose.estimate.expected_error import METADATA_KEY, check, cues, expected_errors, fit_expected_error
from cabinpose.estimate.export import write_copy
from cabinpose.estimate.found import Found
from cabinpose.estimate.onnx_model import OnnxModel
from cabinpose.estimate.predictor import describe_model, load_model
from cabinpose.estimate.training import load_detector
from cabinpose.store.predictions import read_predictions


def found(score: NDArray[Any], spreads: NDArray[Any] | None = None) -> Found:
    points = np.zeros((*score.shape, 3))
    return Found(points[..., :2], points, score, score, spreads)


def drawn(seed: int, count: int = 4000) -> tuple[Found, NDArray[np.float64], NDArray[np.float64]]:
    """Answers for one joint of one person, their errors, and the mean error of such answers: 2 cm at a doubt of 0."""
    rng = np.random.default_rng(seed)
    score, spread = rng.uniform(0.05, 0.95, (count, 1, 1)), rng.uniform(0.02, 0.2, (count, 1, 1))
    mean = 0.02 * ((1 - score) / score) ** 0.3 * (spread / 0.1) ** 0.8
    noise = rng.random((count, 1, 1))  # tells nothing
    return found(score, np.stack((spread, noise), axis=-1)), rng.gamma(2.0, mean / 2.0), mean


def test_the_law_is_found_again() -> None:
    said, error, _ = drawn(1)
    table = fit_expected_error(cues(said), error, ["head"])
    weights = np.array(table["head"]["weights"])
    np.testing.assert_allclose(weights[:2] / weights[1] * 0.8, (0.3, 0.8), atol=0.04)
    assert weights[2] < 0.05 * weights[1]
    fresh, _, mean = drawn(2)
    expected = expected_errors(check(table), ["head"], fresh)
    assert np.abs(expected / mean - 1).mean() < 0.1
    assert np.nanmedian(expected_errors(table, ["head", "head"][:1], found(fresh.score, fresh.spreads * 1e3))) == max(
        table["head"]["error_m"]
    )


def test_the_steps_are_an_isotonic_regression() -> None:
    """Of all errors by themselves, scikit-learn's is the same but for the width of a step."""
    said, error, _ = drawn(3)
    flat = found(said.score)
    table = fit_expected_error(cues(flat), error, ["head"])
    oracle = IsotonicRegression().fit(-said.score.ravel(), error.ravel())
    ours = expected_errors(table, ["head"], flat).ravel()
    theirs = oracle.predict(-said.score.ravel())
    assert np.abs(ours - theirs).mean() < 0.04 * theirs.mean()
    assert np.corrcoef(ours, theirs)[0, 1] > 0.97


def test_scores_on_any_scale() -> None:
    said, error, _ = drawn(4, 1000)
    one, other = (found(f(said.score)) for f in (lambda s: s, lambda s: 100 * s - 700))
    expected = [expected_errors(fit_expected_error(cues(each), error, ["head"]), ["head"], each) for each in (one, other)]
    np.testing.assert_allclose(*expected, atol=1e-9)


def test_a_cue_that_tells_nothing_gives_the_mean() -> None:
    rng = np.random.default_rng(5)
    score = rng.random((500, 1, 1))
    error = 0.05 + 0.01 * score  # the surer, the farther off
    expected = expected_errors(fit_expected_error(cues(found(score)), error, ["head"]), ["head"], found(score))
    np.testing.assert_allclose(expected, error.mean())


def test_too_few_errors_say_nothing() -> None:
    said, error, _ = drawn(6, 200)
    error[99:] = np.nan
    assert fit_expected_error(cues(said), error, ["head"]) == {}
    error[99] = 0.02
    table = fit_expected_error(cues(said), error, ["head"])
    two = Found(*(np.repeat(a, 2, axis=2) for a in (said.uv, said.joints_3d, said.score, said.presence, said.spreads)))
    two.joints_3d[0, 0, 0] = np.nan
    expected = expected_errors(table, ["head", "neck"], two)
    assert np.isnan(expected[:, :, 1]).all()
    assert np.isnan(expected[:, 0, 0]).tolist() == [True, *[False] * 199]


def _distances(vote: NDArray[Any], depth: float, focal: float) -> NDArray[Any]:
    return np.sqrt(((vote[:2] * depth / focal) ** 2).sum(axis=0) + vote[2] ** 2)


@pytest.mark.slow
def test_spreads_of_the_network(checkpoints: dict[str, Path], tmp_path: Path) -> None:
    """The votes' standard deviation from the raw output of their layer; and how far a frame and its mirror image differ."""
    from cabinpose.estimate.export import export_onnx

    detector = load_detector(checkpoints["compact"])
    network, config = detector.network.eval(), detector.method_config
    raw: list[torch.Tensor] = []
    network.votes.register_forward_hook(lambda _module, _inputs, output: raw.append(output))
    rng = np.random.default_rng(7)
    seen = {name: rng.uniform(0.5, 2, (1, config.height, config.width)).astype(np.float32) for name in ("depth", "amplitude")}
    with torch.no_grad():
        answer = network(*(torch.from_numpy(seen[name]) for name in config.inputs))
    slots, joints = len(config.slots), len(config.joints)
    weight, u, v, z, *_ = raw[0].numpy().astype(np.float64).reshape(slots, joints, 6, -1).transpose(2, 0, 1, 3)
    rows, columns = np.divmod(np.arange(u.shape[-1]), config.width // 8)
    for s, j in ((0, 0), (slots - 1, joints - 1)):
        p = np.exp(weight[s, j]) / np.exp(weight[s, j]).sum()
        votes = np.stack((
            8 * columns + 3.5 + 8 * u[s, j], 8 * rows + 3.5 + 8 * v[s, j], 0.5 * config.max_depth_m * (1 + z[s, j])
        ))  # fmt: skip
        mean = (p * votes).sum(axis=1, keepdims=True)
        spread = np.sqrt((p * _distances(votes - mean, mean[2, 0], config.focal) ** 2).sum())
        assert answer.spreads[0, s, j].numpy() == pytest.approx(spread, rel=1e-3)
    export_onnx(checkpoints["compact"], tmp_path / "m.onnx", name="m", card={}, mirrored=True)
    export_onnx(checkpoints["compact"], tmp_path / "p.onnx", name="p", card={})
    both, plain = (OnnxModel(tmp_path / f"{name}.onnx", threads=1).outputs for name in "mp")
    image = {name: np.ascontiguousarray(array[..., ::-1]) for name, array in seen.items()}
    head = small.JOINTS.index("head")
    one, others = (plain(frame)["joints"][0, :, head].astype(np.float64) for frame in (seen, image))
    others[:, 0] = config.width - 1 - others[:, 0]
    apart = [_distances((one[0] - other)[:, None], 0.5 * (one[0] + other)[2], config.focal)[0] for other in others]
    one_side, other_side = (plain(frame)["spreads"][0, :, head, 0] for frame in (seen, image))
    spreads = both(seen)["spreads"][0, 0, head]
    # In noise, the mirror image's driver may be taken for the front passenger, as on benches that face each other.
    expected = [(0.5 * (one_side[0] + other_side[slot]), apart[slot]) for slot in (0, 1)]
    assert any(spreads == pytest.approx(pair, rel=1e-3) for pair in expected)


def test_models_of_older_versions_say_no_spreads(trained: dict[str, Path], tmp_path: Path) -> None:
    model = onnx.load(trained["compact"])
    model.graph.output.pop([output.name for output in model.graph.output].index("spreads"))
    onnx.save(model, tmp_path / "old.onnx")
    frames = np.ones((2, 48, 64), np.float32), np.diag((51.2, 51.2, 1.0)), np.full((2, 48, 64), 100, np.uint16)
    old, new = (load_model(path, threads=1)(*frames) for path in (tmp_path / "old.onnx", trained["compact"]))
    np.testing.assert_array_equal(old.joints_3d, new.joints_3d)
    assert np.isnan(old.expected_error_m).all()


@pytest.mark.parametrize(
    "table", [
        {"head": {}}, {"head": {"weights": [1], "doubt": [1, 2], "error_m": [1]}},
        {"head": {"weights": [1], "doubt": [2, 1], "error_m": [1, 2]}}, {"head": 3}, [1],
        {"head": {"weights": [1], "doubt": [1, 2], "error_m": [2, 1]}},
    ],
)  # fmt: skip
def test_damaged_tables_are_refused(table: Any, trained: dict[str, Path], tmp_path: Path) -> None:
    write_copy(load_model(trained["compact"]).model, tmp_path / "m.onnx", **{METADATA_KEY: {"joints": table}})
    with pytest.raises(ModelError, match="does not say what it is"):
        load_model(tmp_path / "m.onnx")


@pytest.mark.parametrize("kind", ["onnx", "npz"])
def test_from_the_command_line(
    kind: str, trained: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _fewest(10, monkeypatch)
    manifest = sphere_people.manifest(frames=24, frames_per_part=24, width=small.SIZE[0], height=small.SIZE[1])
    data = sphere_people.write(tmp_path / "spheres", manifest)
    model = trained["compact"] if kind == "onnx" else _walks(data, tmp_path)
    out = tmp_path / f"calibrated.{kind}"
    command = ["calibrate-confidence", str(data), "--model", str(model), "--presence", "0", "--out", str(out)]
    assert main([*command, "--json"]) == 0, capsys.readouterr().err
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert set(told["joints"]) | set(told["left_out"]) == set(load_model(out).joints)
    assert told["joints"]
    assert describe_model(out)[METADATA_KEY] == {"data": "spheres", "frames": 24, "joints": told["joints"]}
    assert main(command) == 2
    assert "--overwrite replaces it" in capsys.readouterr().err
    assert main([*command, "--overwrite"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(told["joints"]) + 2
    assert main(["predict", str(data), "--model", str(out), "--out", str(tmp_path / "p.jsonl")]) == 0
    said = read_predictions(tmp_path / "p.jsonl")
    known = np.array([name in told["joints"] for name in said.joints])
    there = np.isfinite(said.joints_3d).all(axis=-1)
    assert (np.isfinite(said.expected_error_m) == (there & known)).all()
    monkeypatch.setattr("cabinpose.evaluate.trained_ranges", lambda *_: "0-11")
    assert main([*command, "--overwrite", "--json"]) == 0
    (warning,) = json.loads(capsys.readouterr().out.splitlines()[-1])["warnings"]
    assert warning.startswith("the model was trained on 12 of these 24 frames")
    assert main(["models", str(out)]) == 0
    assert f"of {len(told['joints'])} joints, from 24 frames of spheres" in capsys.readouterr().out
    assert main([*command[:-1], str(tmp_path / "m.txt")]) == 2
    assert f"let --out end in .{kind}" in capsys.readouterr().err
    _fewest(1000, monkeypatch)
    assert main([*command, "--overwrite"]) == 2
    assert "is found 1000 times or more" in capsys.readouterr().err


def _fewest(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the module, and in the face that the command line imports it from."""
    for place in ("cabinpose.estimate", "cabinpose.estimate.expected_error"):
        monkeypatch.setattr(f"{place}.FEWEST", count)


def _walks(data: Path, folder: Path) -> Path:
    """A model of arrays, fitted to the same frames."""
    import yaml

    config = folder / "walks.yaml"
    config.write_text(yaml.safe_dump({"method": "walks", "settings": {"width": 64, "height": 48, "focal": 51.2,
                                      "slots": ["driver"], "steps": 4, "skipped": 1}, "workers": 0}))  # fmt: skip
    splits = folder / "splits.yaml"
    splits.write_text("train: {subject: [S01, S02, S03]}\nvalidate: {subject: [S04]}\n")
    arguments = ["train", str(data), "--config", str(config), "--out", str(folder / "run"), "--splits", str(splits)]
    assert main(arguments) == 0
    return folder / "run" / "best.npz"
