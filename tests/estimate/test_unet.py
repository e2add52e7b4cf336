"""Segmentation of body parts: classes, loss, metrics, and label images in the camera's own pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import small
import torch

from cabinpose.core.camera import Camera
from cabinpose.core.errors import ConfigError, ModelError
from cabinpose.core.segmentation import class_table, confusion, intersection_over_union
from cabinpose.estimate.data import StoredFrames, collate, mirrored_labels
from cabinpose.estimate.predictor import load_model, open_model
from cabinpose.estimate.training import TrainConfig, frame_spec
from cabinpose.estimate.unet import fit
from cabinpose.estimate.unet.config import ALL, MERGED, UnetConfig
from cabinpose.estimate.unet.method import METHOD
from cabinpose.estimate.unet.model import Segments, Unet
from cabinpose.scene.labels import BODY_PARTS, FIRST_BODY_ID, LABELS, LAST_BODY_ID

CONFIG = UnetConfig(**small.TINY["unet"])


@pytest.mark.parametrize("parts", [MERGED, ALL])
def test_every_body_class_is_in_one_part_and_the_world_in_none(parts: tuple) -> None:
    ids = sorted(number for part in parts for number in part.ids)
    assert ids == [label.id for label in BODY_PARTS]
    table = class_table(parts)
    for label in LABELS:
        if FIRST_BODY_ID <= label.id <= LAST_BODY_ID:
            assert label.id in parts[table[label.id] - 1].ids
        else:
            assert table[label.id] == 0
    assert len(parts) == (8 if parts is MERGED else 33)


def test_merged_parts_mirror_as_their_classes_do() -> None:
    mirror, table = mirrored_labels(), class_table(MERGED)
    names = ["nobody", *(part.name for part in MERGED)]
    for label in BODY_PARTS:
        own, other = names[table[label.id]], names[table[mirror[label.id]]]
        assert other == own.replace("_left", "_?").replace("_right", "_left").replace("_?", "_right")


def test_confusion_and_iou_are_counted() -> None:
    rng = np.random.default_rng(0)
    truth, said = rng.integers(0, 4, (2, 9, 11)), rng.integers(0, 3, (2, 9, 11))
    truth[truth == 3] = 0
    counts = confusion(truth, said, 5)
    for i in range(5):
        for j in range(5):
            assert counts[i, j] == ((truth == i) & (said == j)).sum()
    iou = intersection_over_union(counts)
    for c in range(3):
        assert iou[c] == ((truth == c) & (said == c)).sum() / ((truth == c) | (said == c)).sum()
    assert np.isnan(iou[3:]).all()


def test_decoding_takes_the_likeliest_part_of_people() -> None:
    parts = np.zeros((1, 8, 2, 2))
    parts[0, 2, 0, 0] = parts[0, 7, 0, 1] = parts[0, 4, 1, 0] = 1.0
    person = np.array([[[2.0, 0.1], [-0.1, -3.0]]])
    assert METHOD.decode({"person": person, "parts": parts}, CONFIG, {}).tolist() == [[[3, 8], [0, 0]]]


def test_the_loss_is_cross_entropy_of_both_stages() -> None:
    frames = StoredFrames(small.dataset(2), frame_spec(TrainConfig(method="unet", settings=small.TINY["unet"])))
    batch = collate([frames[0], frames[1]])
    torch.manual_seed(0)
    person, parts = torch.randn(2, 48, 64), torch.randn(2, 8, 48, 64)

    class Fixed(torch.nn.Module):
        config = CONFIG.model_copy(update={"dice": 0.5})

        def forward(self, depth: torch.Tensor) -> Segments:
            return Segments(person, parts)

    terms = fit.loss(Fixed(), batch)  # type: ignore[arg-type]
    classes = class_table(MERGED)[batch.labels.numpy()]
    there = classes > 0
    p = 1 / (1 + np.exp(-person.double().numpy()))
    assert terms["person"].item() == pytest.approx(-np.log(np.where(there, p, 1 - p)).mean(), rel=1e-5)
    q = np.exp(parts.double().numpy())
    q /= q.sum(1, keepdims=True)
    own = np.take_along_axis(q, np.maximum(classes.astype(int) - 1, 0)[:, None], 1)[:, 0]
    assert terms["parts"].item() == pytest.approx(-np.log(own[there]).mean(), rel=1e-5)
    dice = [2 * (p * there).sum() / (p + there).sum()]
    for c in range(1, 9):
        if (classes == c).any():
            said = q[:, c - 1] * there
            dice.append(2 * (said * (classes == c)).sum() / (said + (classes == c)).sum())
    assert len(dice) == 3  # person, head, torso
    assert terms["dice"].item() == pytest.approx(1 - np.mean(dice), rel=1e-5)
    total = terms["person"] + terms["parts"] + 0.5 * terms["dice"]
    assert terms["loss"].item() == pytest.approx(total.item())


def test_the_second_stage_sees_the_masked_cloud() -> None:
    torch.manual_seed(0)
    network = Unet(CONFIG).eval()
    depth = torch.rand(1, 48, 64) + 0.5
    seen = []
    network.parts.register_forward_pre_hook(lambda module, args: seen.append(args[0]))
    said = network(depth)
    assert said.parts.shape == (1, 8, 48, 64)
    torch.testing.assert_close(seen[0], network.cloud(depth) * torch.sigmoid(said.person)[:, None])


def test_the_cloud_is_normalised() -> None:
    network = Unet(CONFIG)
    depth = torch.zeros(1, 48, 64)
    depth[0, 10, 40] = 1.5
    cloud = network.cloud(depth)[0]
    x, y = (40 - 31.5) / 51.2 * 1.5, (10 - 23.5) / 51.2 * 1.5
    np.testing.assert_allclose(cloud[:, 10, 40].numpy(), [(x + 1.5) / 3, (y + 1.5) / 3, 0.5], rtol=1e-5)
    depth[0, 10, 40] = 0
    assert (network.cloud(depth) == 0).all()


def test_sizes_that_cannot_be_halved_are_refused() -> None:
    with pytest.raises(ConfigError, match="16 divides"):
        METHOD.settings({"width": 72, "height": 48, "levels": 4})


def test_label_images_come_in_the_cameras_pixels(trained: dict[str, Path]) -> None:
    segmenter = open_model(trained["unet"], threads=1)
    view = segmenter.config.view
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 2, (3, 48, 64)).astype(np.float32)
    own = segmenter.segment({"depth": depth, "camera_k": view.camera.k, "camera_dist": np.zeros(5)})
    expected = segmenter.model.run({"depth": depth})
    assert np.array_equal(own, expected)
    assert own.dtype == np.uint8
    double = Camera(128, 96, 2 * view.focal, 2 * view.focal, 63.5, 47.5)
    large = depth.repeat(2, 1).repeat(2, 2)  # the same view with twice the pixels
    said = segmenter.segment({"depth": large, "camera_k": double.k, "camera_dist": np.zeros(5)})
    assert np.array_equal(said, expected.repeat(2, 1).repeat(2, 2))
    assert [part.name for part in segmenter.parts] == [part.name for part in MERGED]


def test_no_frames_give_no_labels(trained: dict[str, Path]) -> None:
    segmenter = open_model(trained["unet"], threads=1)
    none = segmenter.segment({"depth": np.zeros((0, 20, 30), np.float32), "camera_k": np.eye(3), "camera_dist": np.zeros(5)})
    assert none.shape == (0, 20, 30)


def test_a_segmentation_is_no_predictor(trained: dict[str, Path]) -> None:
    with pytest.raises(ModelError, match="model of unet") as caught:
        load_model(trained["unet"])
    assert "open_model" in caught.value.hint
