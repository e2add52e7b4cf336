"""Style transfer: Gram matrices by hand, gradients, VGG-19's file, what happens to labels, the same bytes from any workers."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import ndimage
from synth_scenes import fingerprint, small_config

from cabinpose.core.errors import ConfigError, ModelError
from cabinpose.scene.labels import LABEL_ID
from cabinpose.store import open_dataset, points_m
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.generate import GenerationReport, generate
from cabinpose.synth.style.encoder import STYLE, VGG_WIDTHS, Encoder, StyleLoss, encoder_of, gram, own_encoder, shown, vgg19
from cabinpose.synth.style.fit import StyleReport, fit_style, noise_of
from cabinpose.synth.style.frame import StyleFrame, guides_of
from cabinpose.synth.style.safety import label_shift, parts_of, without_part_means
from cabinpose.synth.style.settings import LEFT, Style
from cabinpose.synth.style.stage import FrameStyler, inputs_of
from cabinpose.synth.style.transfer import Content, changed, seen, style_loss

# By torchvision's own list of layers (configuration E): where each convolution stands among `features`.
VGG_FEATURES = dict(
    zip(
        ("conv1_1", "conv1_2", "conv2_1", "conv2_2", "conv3_1", "conv3_2", "conv3_3", "conv3_4")
        + ("conv4_1", "conv4_2", "conv4_3", "conv4_4"),
        (0, 2, 5, 7, 10, 12, 14, 16, 19, 21, 23, 25),
        strict=True,
    )
)


# ------------------------------------------------------------------------------------------------------ Gram matrices


def test_gram_matrices_of_two_by_two_pixels() -> None:
    features = torch.tensor([[[[1.0, 2.0], [3.0, 4.0]], [[0.0, 1.0], [1.0, 0.0]]]])
    top = torch.tensor([[1.0, 1.0], [0.0, 0.0]])
    found = gram(features, torch.stack([torch.ones(2, 2), top, torch.zeros(2, 2)])[None])[0]
    np.testing.assert_allclose(found[0], np.array([[30.0, 5.0], [5.0, 2.0]]) / 4)  # plain, over four pixels
    np.testing.assert_allclose(found[1], np.array([[5.0, 2.0], [2.0, 1.0]]) / 2)
    np.testing.assert_array_equal(found[2], 0.0)


def test_regions_do_not_see_each_other() -> None:
    features = torch.randn(1, 3, 4, 4, generator=torch.Generator().manual_seed(1))
    guide = torch.zeros(1, 1, 8, 8)  # twice the layer's size
    guide[..., :4] = 1
    before = gram(features, guide)
    features[..., 2:] = 100.0
    np.testing.assert_array_equal(gram(features, guide), before)


def test_the_loss_has_the_gradient_of_finite_differences() -> None:
    torch.manual_seed(3)
    encoder = Encoder((2, 2, 3, 3)).double()
    depth = 1 + 0.01 * torch.randn(1, 1, 16, 16, dtype=torch.float64)
    valid = (torch.rand(1, 1, 16, 16) > 0.1).double()
    guides = torch.zeros(1, 2, 16, 16, dtype=torch.float64)
    guides[:, 0, :, :8], guides[:, 1, :, 8:] = 1, 1
    loss = StyleLoss(encoder, shown(depth, valid).detach(), guides)
    kept = {name: value.detach() for name, value in loss.content(shown(depth, valid)).items()}
    content = Content(depth.flip(3), valid, torch.cat([guides, guides], dim=1), depth)

    def of(raw: torch.Tensor) -> torch.Tensor:
        change, _ = changed(content, raw)
        found = loss(shown(content.depth + change, content.valid), guides, kept)
        return found.style + found.content

    raw = (0.1 * torch.randn(1, 2, 16, 16, dtype=torch.float64)).requires_grad_()
    (gradient,) = torch.autograd.grad(of(raw), raw)
    for _ in range(5):  # not `gradcheck`, which takes two seconds to import
        way = torch.randn(raw.shape, dtype=torch.float64)
        along = (of(raw + 1e-6 * way) - of(raw - 1e-6 * way)) / 2e-6
        assert float(along.detach()) == pytest.approx(float((gradient * way).sum()), rel=1e-4)
    change, logit = changed(content, raw)
    np.testing.assert_allclose(seen(content, change, logit).detach()[:, 2], valid[:, 0])  # nothing is lost by such small values


# -------------------------------------------------------------------------------------------------------------- VGG-19


CONFIGURATION_E = (64, 64, "M", 128, 128, "M", 256, 256, 256, 256, "M", *(512,) * 4, "M", *(512,) * 4, "M")  # Simonyan, table 1


def test_vgg19_reads_torchvisions_names(tmp_path: Path) -> None:
    generator, state, before = torch.Generator().manual_seed(2), {}, 3
    for name, number in VGG_FEATURES.items():
        width = VGG_WIDTHS[int(name[4]) - 1]
        state[f"features.{number}.weight"] = 0.02 * torch.randn(width, before, 3, 3, generator=generator)
        state[f"features.{number}.bias"] = torch.randn(width, generator=generator)
        before = width
    torch.save(state, tmp_path / "vgg19.pth")
    encoder = vgg19(tmp_path / "vgg19.pth")
    image = torch.rand(1, 3, 16, 16, generator=generator)
    seen_ = (image - torch.tensor([0.485, 0.456, 0.406]).view(3, 1, 1)) / torch.tensor([0.229, 0.224, 0.225]).view(3, 1, 1)
    for name in ("conv1_1", "conv1_2"):
        number = VGG_FEATURES[name]
        seen_ = torch.nn.functional.conv2d(
            seen_, state[f"features.{number}.weight"], state[f"features.{number}.bias"], padding=1
        ).relu()
    features = encoder(image)
    np.testing.assert_allclose(features["conv1_2"].detach(), seen_, rtol=1e-4, atol=1e-5)
    assert features["conv4_4"].shape == (1, 512, 2, 2)
    assert encoder.convolutions["conv4_4"].weight.equal(state["features.25.weight"])
    torch.save({"features.0.weight": state["features.0.weight"]}, tmp_path / "cut.pth")
    torch.save({"features.0.weight": torch.zeros(96, 3, 11, 11)}, tmp_path / "alexnet.pth")
    (tmp_path / "none.pth").write_bytes(b"nothing")
    wrong = {
        "cut": "features.0.bias is not there",
        "alexnet": r"features.0.weight is \(96, 3, 11, 11\), not \(64, 3, 3, 3\)",
        "none": "no weights that torch",
        "nope": "there are no weights",
    }
    for name, says in wrong.items():
        with pytest.raises(ModelError, match=says) as caught:
            vgg19(tmp_path / f"{name}.pth")
        assert "torchvision" in str(caught.value.hint)


def published(generator: torch.Generator) -> dict[str, torch.Tensor]:
    """A state dict with the names, order and shapes of `vgg19-dcbb9e9d.pth`: random features, and a classifier of zeros that
    share one number, so that the file has 80 and not 575 MB.
    """
    state, before, number = {}, 3, 0
    for width in CONFIGURATION_E:
        if width == "M":
            number += 1
            continue
        state[f"features.{number}.weight"] = torch.randn(width, before, 3, 3, generator=generator) * (2 / (9 * before)) ** 0.5
        state[f"features.{number}.bias"] = 0.1 * torch.randn(width, generator=generator)
        before, number = width, number + 2
    for number, (rows, columns) in {0: (4096, 512 * 7 * 7), 3: (4096, 4096), 6: (1000, 4096)}.items():
        zero = torch.zeros(1)
        state |= {f"classifier.{number}.weight": zero.expand(rows, columns), f"classifier.{number}.bias": zero.expand(rows)}
    return state


@pytest.mark.slow  # a file of 80 MB
def test_vgg19_answers_as_torchvisions_network_from_a_file_of_the_published_layout(tmp_path: Path) -> None:
    generator = torch.Generator().manual_seed(5)
    state = published(generator)
    assert sum(value.numel() for value in state.values()) == 143_667_240  # as torchvision's page has it
    torch.save(state, tmp_path / "vgg19-dcbb9e9d.pth")
    encoder = encoder_of(str(tmp_path / "vgg19-dcbb9e9d.pth"))
    layers: list[torch.nn.Module] = []
    before = 3
    for width in CONFIGURATION_E:  # torchvision's `features`, but for the average of pools, which is ours as Gatys et al. have it
        if width == "M":
            layers.append(torch.nn.AvgPool2d(2, 2))
        else:
            layers += [torch.nn.Conv2d(before, width, 3, padding=1), torch.nn.ReLU()]
            before = width
    theirs = torch.nn.Sequential(OrderedDict((str(number), layer) for number, layer in enumerate(layers)))
    theirs.load_state_dict({name.removeprefix("features."): w for name, w in state.items() if name.startswith("features.")})
    image = torch.rand(2, 3, 32, 48, generator=generator)
    value = (image - torch.tensor([0.485, 0.456, 0.406]).view(3, 1, 1)) / torch.tensor([0.229, 0.224, 0.225]).view(3, 1, 1)
    known = {number + 1: name for name, number in VGG_FEATURES.items()}  # after the ReLU
    with torch.no_grad():
        ours = encoder(image)
        for number, layer in enumerate(theirs):
            value = layer(value)
            if number in known:
                assert value.abs().mean() > 1e-3
                assert torch.equal(ours[known.pop(number)], value)
    assert not known
    assert not any(parameter.requires_grad for parameter in encoder.parameters())


def test_the_packages_encoder_tells_noise_from_noise() -> None:
    """The nearer σ and grain, the nearer the Gram matrices, in each layer of style."""
    encoder, rng = own_encoder(), np.random.default_rng(0)

    def of(sigma_m: float, grain_px: float) -> dict[str, torch.Tensor]:
        noise = ndimage.gaussian_filter(rng.standard_normal((64, 64)), grain_px)
        depth = torch.from_numpy(1 + sigma_m * noise / noise.std()).float()[None, None]
        features = encoder(shown(depth, torch.ones_like(depth)))
        return {name: gram(features[name], torch.ones(1, 1, 64, 64)) for name in STYLE}

    wanted, same, louder, coarser = of(0.006, 0.0), of(0.006, 0.0), of(0.015, 0.0), of(0.006, 1.2)
    for name, matrix in wanted.items():
        near, far, other = (float((matrix - others[name]).norm()) for others in (same, louder, coarser))
        assert near < 0.5 * min(far, other)


# -------------------------------------------------------------------------------------------------------------- labels


def test_a_frame_that_moves_is_seen_to_move() -> None:
    labels = np.full((60, 80), LABEL_ID["seat"], np.uint8)
    labels[:, 30:50] = 14  # a torso, from top to bottom
    body = labels == 14
    depth, instance = np.where(body, 0.7, 1.2).astype(np.float32), body.astype(np.uint8)
    assert label_shift(depth, depth, labels, instance) == (0.0, 0.0, 0.0)
    for pixels in (1, 3):
        moved = np.roll(depth, pixels, axis=1)
        assert label_shift(depth, moved, labels, instance).edge_px == pixels
        assert label_shift(depth.T, moved.T, labels.T, instance.T).edge_px == pixels
    assert label_shift(depth, depth - 0.004 * body, labels, instance).part_mm == pytest.approx(4.0, abs=1e-3)
    ring = ndimage.binary_dilation(body, np.ones((1, 5))) & ~ndimage.binary_erosion(body, np.ones((1, 5)))
    assert label_shift(depth, np.where(ring, np.nan, depth), labels, instance) == (0.0, 0.0, pytest.approx(ring.mean()))
    outside = ring & ~body  # two pixels, which may belong to either side
    assert label_shift(depth, np.where(outside, np.nan, depth), labels, instance).edge_px == 1.0


def test_no_part_moves_on_average() -> None:
    rng = np.random.default_rng(4)
    labels, instance = rng.integers(0, 5, (30, 40), np.uint8), rng.integers(0, 3, (30, 40), np.uint8)
    where = rng.random((30, 40)) < 0.8
    change = without_part_means(rng.normal(0.02, 0.01, (30, 40)).astype(np.float32), where, parts_of(labels, instance))
    for part in np.unique(parts_of(labels, instance)):
        assert abs(change[where & (parts_of(labels, instance) == part)].mean()) < 1e-8
    assert not change[~where].any()


# -------------------------------------------------------------------------------------------------- frames and models


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five frames without style."""
    out = tmp_path_factory.mktemp("style") / "plain"
    generate(small_config(), 5, out, seed=7, workers=1)
    return out


@pytest.fixture(scope="module")
def style(plain: Path) -> Path:
    """A style frame with coarse noise of 10 mm, of the scene of the first frame."""
    frame = open_dataset(plain).isel(frame=0)
    noise = ndimage.gaussian_filter(np.random.default_rng(1).standard_normal(frame["depth"].shape), 0.7)
    human = guides_of(frame["labels"].values, np.ones(noise.shape, np.float32))[1]
    path = plain.parent / "camera.npz"
    np.savez(path, depth_m=frame["depth_clean"].values + 0.01 * noise / noise.std(), regions=human.astype(np.uint8))
    return path


@pytest.fixture(scope="module")
def model(plain: Path, style: Path) -> tuple[Path, StyleReport]:
    """A model that was hardly trained."""
    out = plain.parent / "camera.onnx"
    steps: list[int] = []
    found = fit_style(
        StyleFrame.read(style), open_dataset(plain), out, steps=2, seed=1, vgg19=None, report=lambda step, _: steps.append(step)
    )
    assert steps == [1, 2]
    assert found.frames == 1
    return out, found


def styled(out: Path, workers: int, **settings: object) -> GenerationReport:
    config = small_config().model_copy(update={"style": Style.model_validate(settings)})
    return generate(config, 2, out, seed=7, workers=workers)


@pytest.mark.slow
def test_styled_datasets_are_the_same_bytes_and_change_nothing_else(
    plain: Path, model: tuple[Path, StyleReport], tmp_path: Path
) -> None:
    report = styled(tmp_path / "one", 1, by=str(model[0]))
    styled(tmp_path / "two", 2, by=str(model[0]))
    assert fingerprint(tmp_path / "one") == fingerprint(tmp_path / "two")
    before, after = open_dataset(plain).isel(frame=slice(2)), open_dataset(tmp_path / "one")
    for name in ("depth", "depth_clean", "amplitude", "labels", "joints_3d"):
        np.testing.assert_array_equal(before[name].values, after[name].values)
    assert report.label_shift["edge_px"] == after["style_edge_px"].values.max()
    assert set(report.content["styles"]) == set(after["style"].values) == {after["style"].values[0]}
    assert str(after["style"].values[0]).startswith("camera ")
    assert 0 < after["style_part_mm"].values.max() < 0.1  # what rounding leaves
    change = np.abs(after["depth_styled"].values - after["depth"].values)
    assert 0.0001 < np.nanmean(change) < np.nanmax(change) < 0.2
    np.testing.assert_allclose(points_m(after, "depth_styled").values[..., 2], after["depth_styled"].values, atol=1e-6)


def test_what_would_leave_its_labels_stays_as_it_was(model: tuple[Path, StyleReport], tmp_path: Path) -> None:
    report = styled(tmp_path / "held", 1, by=str(model[0]), most_part_mm=1e-9)
    data = open_dataset(tmp_path / "held")
    assert report.content["styles"] == {LEFT: 2}
    np.testing.assert_array_equal(data["depth_styled"].values, data["depth"].values)
    assert (data["style_part_mm"].values > 1e-9).all()  # of what was refused


@pytest.mark.slow
def test_an_optimised_frame_has_the_noise_of_the_style(plain: Path, style: Path) -> None:
    """In a crop of a frame with finer and more noise than the style's, σ and grain move towards the style's; the loss falls."""
    frame = open_dataset(plain).isel(frame=1)
    crop = {name: frame[name].values[100:200, 100:228] for name in ("depth", "depth_clean", "labels", "instance")}
    crop["depth"] = crop["depth_clean"] + np.random.default_rng(2).normal(0, 0.015, crop["depth"].shape).astype(np.float32)
    after = FrameStyler(Style(by=str(style), steps=60)).take(**crop, rng=np.random.default_rng(3))
    inside = guides_of(crop["labels"], crop["depth_clean"])[:2].max(axis=0) > 0
    wanted, was, now = (
        noise_of(depth, where > 0)
        for depth, where in (
            (StyleFrame.read(style).depth_m, StyleFrame.read(style).guides[0]),
            (crop["depth"], inside),
            (after["depth_styled"], inside),
        )
    )
    loss = style_loss(StyleFrame.read(style), own_encoder())
    guides = guides_of(crop["labels"], crop["depth_clean"])
    before, later = (
        Content.of(inputs_of(depth, guides, rng=np.random.default_rng(3))) for depth in (crop["depth"], after["depth_styled"])
    )
    losses = [float(loss(c.shown(), before.regions(), loss.content(c.shown())).style) for c in (before, later)]
    assert losses[1] < 0.5 * losses[0]
    assert abs(now.sigma_mm - wanted.sigma_mm) < 0.8 * abs(was.sigma_mm - wanted.sigma_mm)
    assert abs(now.grain - wanted.grain) < 0.8 * abs(was.grain - wanted.grain)


def test_noise_is_measured_without_the_scene() -> None:
    rng, y = np.random.default_rng(6), np.mgrid[:200, :200][0]
    fine = rng.standard_normal((200, 200))
    coarse = ndimage.gaussian_filter(fine, 1.0)
    everywhere = np.ones((200, 200), bool)
    kept = (1 - 1 / 25) ** 0.5  # of white noise, less its mean over 5 x 5
    found = noise_of(1 + 0.002 * y + 0.005 * fine, everywhere)
    assert found.sigma_mm == pytest.approx(5 * kept, rel=0.03)
    assert found.grain == pytest.approx(-1 / 24, abs=0.02)
    assert noise_of(1 + 0.002 * y + 0.005 * coarse, everywhere).grain > 0.3


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"regions": np.zeros((64, 64), np.uint8)}, "has no depth"),
        ({"depth_m": np.ones((64, 64))}, "has no masks"),
        ({"depth_m": np.ones((64, 64)), "regions": np.zeros((64, 63), np.uint8)}, "regions are not"),
        ({"depth_m": np.ones((64, 64)), "regions": np.full((64, 64), 3, np.uint8)}, "regions are not"),
        ({"depth_m": np.ones((64, 64), np.uint16), "regions": np.zeros((64, 64), np.uint8)}, "no image of metres"),
        ({"depth_m": np.zeros((64, 64)), "regions": np.zeros((64, 64), np.uint8)}, "fewer than a tenth"),
        ({"depth_m": np.full((64, 64), 1800.0), "regions": np.zeros((64, 64), np.uint8)}, "half of its depths are beyond 50"),
        ({"depth_m": np.ones((64, 64)), "regions": np.full((64, 64), 255, np.uint8)}, "all of it is 255"),
    ],
)
def test_a_style_frame_without_masks_is_an_error(tmp_path: Path, arrays: dict[str, np.ndarray], says: str) -> None:
    np.savez(tmp_path / "camera.npz", **arrays)
    with pytest.raises(ConfigError, match=says) as caught:
        StyleFrame.read(tmp_path / "camera.npz")
    assert caught.value.hint


@pytest.mark.parametrize(("key", "value"), [("steps", 20), ("vgg19", "vgg19.pth")])
def test_what_is_of_an_optimisation_is_refused_beside_a_model(key: str, value: object) -> None:
    Style.model_validate({"by": "camera.npz", key: value})
    with pytest.raises(ConfigError, match=f"style.{key} says nothing of a model") as caught:
        Style.model_validate({"by": "camera.onnx", key: value})
    assert caught.value.hint


def test_a_model_over_a_file_that_optimises_is_told_how(tmp_path: Path) -> None:
    """Settings of the command line replace single keys of the file; the hint is what replaces them all."""
    file = tmp_path / "scene.yaml"
    file.write_text("style: {by: camera.npz, steps: 20}\n")
    with pytest.raises(ConfigError, match=r"style\.steps says nothing of a model") as caught:
        SynthConfig.load(file, ["style.by=/camera.onnx"])
    assert "'style={by: /camera.onnx}'" in str(caught.value.hint)
    assert SynthConfig.load(file, ["style={by: /camera.onnx}"]).style == Style(by="/camera.onnx")


def test_a_seed_that_is_none_is_refused_before_training(plain: Path, style: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="seed -1"):
        fit_style(
            StyleFrame.read(style), open_dataset(plain), tmp_path / "m.onnx", steps=1, seed=-1, vgg19=None, report=lambda *_: None
        )


def test_edges_are_a_region_of_their_own() -> None:
    depth = np.full((40, 40), 1.5, np.float32)
    depth[:, :20] = 0.8
    guides = guides_of(np.full((40, 40), LABEL_ID["seat"], np.uint8), depth)
    np.testing.assert_array_equal(np.flatnonzero(guides[3, 20]), range(17, 23))
    np.testing.assert_array_equal(guides.sum(axis=0), 1.0)
    assert not guides[1:3].any()


@pytest.mark.slow
@pytest.mark.real_data
def test_frames_take_the_look_of_a_kinect(plain: Path, real_data: Callable[[str], Path], tmp_path: Path) -> None:
    """A wall's noise: less, and coarser from pixel to pixel, as the Kinect's filter leaves it; a ring is lost at silhouettes."""
    with np.load(real_data("tof/kinect_v2_panoptic.npz")) as file:
        depth = file["depth_m"]
    y, x = np.mgrid[: depth.shape[0], : depth.shape[1]]
    regions = np.where(np.hypot(x - 256, y - 212) > 175, 255, 0).astype(np.uint8)
    np.savez(tmp_path / "kinect.npz", depth_m=depth, regions=regions)
    frame = open_dataset(plain).isel(frame=1)
    images = {name: frame[name].values for name in ("depth", "depth_clean", "labels", "instance")}
    after = FrameStyler(Style(by=str(tmp_path / "kinect.npz"), steps=60)).take(**images, rng=np.random.default_rng(3))
    car = guides_of(images["labels"], images["depth_clean"])[0] > 0
    style = StyleFrame.read(tmp_path / "kinect.npz")
    wanted = noise_of(np.where(style.valid, style.depth_m, np.nan), style.guides[0] > 0)
    was, now = noise_of(images["depth"], car), noise_of(after["depth_styled"], car)
    assert abs(now.sigma_mm - wanted.sigma_mm) < 0.9 * abs(was.sigma_mm - wanted.sigma_mm)
    assert now.grain > was.grain
    assert 0.002 < after["style_lost"] < 0.1
