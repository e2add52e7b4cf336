"""Detectors of colour and of amplitude alone: what they see, learn from and are refused for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small
import sphere_people
import torch
import xarray as xr

from cabinpose.app.cli import main
from cabinpose.app.training import generated_frames
from cabinpose.core import ConfigError, DatasetError, FrameBatch
from cabinpose.estimate.augment import AugmentConfig, Mirror, augment
from cabinpose.estimate.batch import Batch, ray_tensor
from cabinpose.estimate.data import StoredFrames, collate, mirrored_labels
from cabinpose.estimate.export import export_onnx
from cabinpose.estimate.found import mirrored_slots
from cabinpose.estimate.joint_predictor import JointPredictor
from cabinpose.estimate.methods import METHODS
from cabinpose.estimate.predictor import describe_model, load_model
from cabinpose.estimate.train_config import Machines, TrainConfig
from cabinpose.estimate.training import fit, frame_spec
from cabinpose.evaluate.offline import frame_batch
from cabinpose.synth.config import SynthConfig


def coloured(count: int = 6) -> xr.Dataset:
    """Frames of sphere people whose red is the class, green the amplitude, blue where something is."""
    dataset = small.dataset(count)
    channels = dataset["labels"], dataset["amplitude"].clip(max=255), 255 * (dataset["depth"] > 0)
    rgb = np.stack([channel.values.astype(np.uint8) for channel in channels], axis=-1)
    return dataset.assign(rgb=(("frame", "y", "x", "channel"), rgb))


def config(method: str, image: str, **changes: Any) -> TrainConfig:
    settings = small.TINY[method] | {"input": image} | ({"looks_px": [4.0]} if method == "compact" else {})
    return TrainConfig(**({"method": method, "settings": settings, "epochs": 1, "batch": 3, "average": 0.5} | changes))


def batch_of(c: TrainConfig) -> Batch:
    frames = StoredFrames(coloured(), frame_spec(c))
    return collate([frames[i] for i in range(3)])


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Compact models of an epoch, of colour and of amplitude alone."""
    folder, made = tmp_path_factory.mktemp("colour"), {}
    for image in ("rgb", "amplitude"):
        c = config("compact", image)
        frames = StoredFrames(coloured(), frame_spec(c))
        best = fit(c, frames, frames, folder / image, machines=Machines(1))
        made[image] = folder / f"{image}.onnx"
        export_onnx(best, made[image], name=image, card={}, mirrored=True, half=True)
    return made


def test_a_view_sees_the_colour_of_the_pixels_whose_depth_it_sees() -> None:
    spec = frame_spec(config("compact", "rgb"))
    kept = StoredFrames(coloured(), spec._replace(amplitude=True, labels=True))[0]
    assert kept.rgb.shape == (3, *kept.depth.shape)
    np.testing.assert_array_equal(kept.rgb[0], kept.labels)
    np.testing.assert_array_equal(kept.rgb[1], np.minimum(kept.amplitude, 255))
    np.testing.assert_array_equal(kept.rgb[2] > 0, kept.depth > 0)
    assert StoredFrames(coloured(), spec._replace(rgb=False))[0].rgb.size == 0


def test_colour_is_moved_mirrored_and_hidden_as_amplitude_is() -> None:
    spec = frame_spec(config("compact", "rgb"))
    frames = StoredFrames(coloured(), spec._replace(amplitude=True))
    batch = collate([frames[i % 6] for i in range(12)])
    batch = batch._replace(rgb=torch.stack([batch.amplitude.clamp(max=255)] * 3, 1), amplitude=batch.amplitude.clamp(max=255))
    slots = list(small.PERSONS)
    mirror = Mirror(
        METHODS["compact"].settings({}).joint_set.mirror, mirrored_slots(slots),
        torch.from_numpy(mirrored_labels()),
    )  # fmt: skip
    generator = torch.Generator().manual_seed(3)
    varied = augment(
        batch, AugmentConfig(gain=1.0, occluder=0.5), ray_tensor(spec.view), spec.view.focal, mirror, generator=generator
    )
    for channel in varied.rgb.unbind(1):
        torch.testing.assert_close(channel, varied.amplitude)
    assert not torch.equal(varied.rgb, batch.rgb)
    brighter = augment(batch, AugmentConfig(), ray_tensor(spec.view), spec.view.focal, mirror, generator=generator).rgb
    assert brighter.max() <= 255


@pytest.mark.parametrize("method", ["compact", "yolo", "paf"])
def test_the_loss_hangs_on_the_colour_and_on_no_other_image(method: str) -> None:
    c = config(method, "rgb")
    chosen = METHODS[method]
    settings = chosen.settings(c.settings)
    torch.manual_seed(1)
    network = chosen.network(settings)  # type: ignore[attr-defined]
    batch = batch_of(c)
    batch = batch._replace(rgb=batch.rgb.requires_grad_())
    chosen.loss(network, batch)["loss"].backward()  # type: ignore[attr-defined]
    assert all(batch.rgb.grad[:, channel].abs().sum() > 0 for channel in range(3))
    assert settings.inputs == ("rgb",)
    assert batch.amplitude is None


def test_scaling_is_as_stated() -> None:
    """rgb from 0..255 to -1..1, amplitude as its logarithm, 0 at exp(5) and without light; part affinity fields take 0..255."""
    settings = METHODS["compact"].settings(config("compact", "rgb").settings)
    network = METHODS["compact"].network(settings)  # type: ignore[attr-defined]
    picture = torch.tensor([0.0, 127.5, 255.0]).reshape(1, 3, 1, 1).expand(1, 3, 48, 64)
    assert network.channels(picture)[0, :, 0, 0].tolist() == [-1.0, 0.0, 1.0]
    settings = METHODS["compact"].settings(config("compact", "amplitude").settings)
    light = torch.zeros(1, 48, 64)
    light[0, 0, 0], light[0, 0, 1] = float(np.exp(5.0) - 1), 0.0
    lit, logarithm = METHODS["compact"].network(settings).channels(light)[0]  # type: ignore[attr-defined]
    assert lit[0, :2].tolist() == [1.0, 0.0]
    assert logarithm[0, :2].tolist() == pytest.approx([0.0, 0.0], abs=1e-6)
    paf = METHODS["paf"].network(METHODS["paf"].settings(config("paf", "rgb").settings))  # type: ignore[attr-defined]
    assert torch.equal(paf.scaled(picture), picture)


@pytest.mark.parametrize("image", ["rgb", "amplitude"])
def test_a_model_answers_from_its_image_alone(image: str, models: dict[str, Path]) -> None:
    model, dataset = load_model(models[image]), coloured()
    assert describe_model(models[image])["inputs"] == [image]
    assert model.images == (image,)
    batch = frame_batch(dataset, slice(0, 6), model.images)
    found = model.predict(batch)
    alone = {name: batch[name] for name in (image, "camera_k", "camera_dist")}  # type: ignore[literal-required]
    np.testing.assert_array_equal(model.predict(FrameBatch(**alone)).joints_3d, found.joints_3d)
    one = frame_batch(dataset, slice(5, 6), model.images)
    np.testing.assert_allclose(model.predict(one).joints_3d, found.joints_3d[5:], atol=1e-5)
    called = model(
        np.nan_to_num(one["depth"][0]), one["camera_k"][0], one["amplitude"][0], camera_dist=one["camera_dist"][0],
        rgb=dataset["rgb"].values[5],
    )  # fmt: skip
    np.testing.assert_allclose(called.joints_3d, found.joints_3d[5], atol=1e-5)
    darker = dict(batch) | {image: batch[image] // 2}  # type: ignore[literal-required]
    assert not np.array_equal(model.predict(darker).joints_3d, found.joints_3d)  # type: ignore[arg-type]


def test_what_has_no_colour_is_refused_before_the_first_frame(
    models: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    size = {"width": small.SIZE[0], "height": small.SIZE[1], "persons": small.PERSONS}
    data = str(sphere_people.write(tmp_path / "spheres", sphere_people.manifest(frames=8, frames_per_part=8, **size)))
    monkeypatch.setattr(JointPredictor, "predict", lambda *_: pytest.fail("it looked at a frame"))
    model, out = str(models["rgb"]), tmp_path / "out"
    recipe = tmp_path / "rgb.yaml"
    recipe.write_text("method: compact\nsettings: {input: rgb, slots: [driver]}\n")
    for words in (
        ["predict", data, "--model", model, "--out", f"{out}.jsonl"],
        ["evaluate", data, "--model", model],
        ["live", "--source", data, "--model", model],
        ["live", "--source", "simulated", "--set", f"dataset={data}", "--model", model, "--frames", "2"],
        ["train", data, "--config", str(recipe), "--out", str(out)],
    ):
        assert main(words) == 2, words
        error = capsys.readouterr().err
        assert "rgb" in error, error
        assert error.count("hint:") == 1, error
    assert not out.exists()
    scenes = SynthConfig.parse({"images": {"variables": ["nir"], "renderer": "raster"}})
    spec = frame_spec(TrainConfig(method="compact", settings={"input": "rgb", "slots": small.PERSONS}))
    with pytest.raises(ConfigError, match="the scenes have no rgb"):
        generated_frames(scenes, spec, 10, 1)
    with pytest.raises(DatasetError, match="no rgb") as caught:
        StoredFrames(small.dataset(2), spec)
    assert "images={variables: [rgb]}" in caught.value.hint
    with pytest.raises(ConfigError, match="rgb of shape"):
        load_model(model)(np.ones((48, 64)), np.eye(3), rgb=np.zeros((24, 64, 3)))
