"""Part affinity fields: the network as stated, its targets, and people read off maps that are drawn by closed form."""

from __future__ import annotations

from collections import Counter
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import small
import torch
from scipy import ndimage

from cabinpose.core.errors import ConfigError, DatasetError
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.estimate.data import FrameSpec, StoredFrames, collate
from cabinpose.estimate.export import write_onnx
from cabinpose.estimate.methods import METHODS
from cabinpose.estimate.paf import measure
from cabinpose.estimate.paf.assemble import find_peaks, line_scores
from cabinpose.estimate.paf.config import PafConfig
from cabinpose.estimate.paf.decode import decode, slots_of, surface_depth
from cabinpose.estimate.paf.fit import loss, targets
from cabinpose.estimate.paf.model import Paf
from cabinpose.estimate.training import Detector, TrainConfig

UPPER_BODY = CABINPOSE.sets["upper body"]

SLOTS = ("driver", "front_passenger")
CONFIG = PafConfig(
    width=176, height=144, focal=80, slots=SLOTS, skin_offset_m={},
    slot_anchors={"driver": (120.0, 40.0), "front_passenger": (50.0, 40.0)},
)  # fmt: skip
J = len(UPPER_BODY)
SHAPE = (18, 22)  # of the maps
# The upper body's joints as seen by a camera in front: the left side is to the right in the image.
BODY = {
    "head": (0, -14), "neck": (0, 0), "rshoulder": (-18, 4), "relbow": (-26, 28), "rwrist": (-14, 46), "lshoulder": (18, 4),
    "lelbow": (26, 28), "lwrist": (14, 46), "chest": (0, 24), "hip": (0, 60), "rpelvis": (-12, 66), "lpelvis": (12, 66),
    "rhand": (-6, 54), "lhand": (6, 54),
}  # fmt: skip


def person(u: float, v: float, scale: float = 1.0) -> np.ndarray:
    return np.array([BODY[name] for name in UPPER_BODY], float) * scale + (u, v)


def drawn(people: list[np.ndarray], config: PafConfig = CONFIG) -> dict[str, np.ndarray]:
    """The maps (one frame) of people (J, 2), pixel by pixel."""
    h, w = config.height // 8, config.width // 8
    heat, fields = np.zeros((J + 1, h, w)), np.zeros((2 * len(config.joint_set.limbs), h, w))
    for y in range(h):
        for x in range(w):
            at = np.array([8 * x + 3.5, 8 * y + 3.5])
            for j in range(J):
                heat[j, y, x] = max(np.exp(-((p[j] - at) ** 2).sum() / (2 * config.sigma_px**2)) for p in people)
            for c, (a, b) in enumerate(config.joint_set.limbs):
                found = []
                for p in people:
                    length = np.hypot(*(p[b] - p[a]))
                    e = (p[b] - p[a]) / length
                    along, across = (at - p[a]) @ e, abs((at - p[a]) @ np.array([-e[1], e[0]]))
                    if 0 <= along <= length and across <= config.limb_px:
                        found.append(e)
                if found:
                    fields[2 * c : 2 * c + 2, y, x] = np.mean(found, axis=0)
    heat[J] = 1 - heat[:J].max(0)
    presence = np.stack((np.full(J, -4.0), np.full(J, 4.0)), -1)
    return {"heat": heat[None], "fields": fields[None], "presence": presence[None]}


def seen(depth: float = 1.0) -> dict[str, Any]:
    return {"depth": np.full((1, 144, 176), depth, np.float32)}


def test_thirteen_limbs_tie_the_upper_body() -> None:
    assert PafConfig().joints == UPPER_BODY
    for body, joints in (("upper", 14), ("full", 20), ("itop", 15)):
        limbs = PafConfig(body=body).joint_set.limbs
        assert len(limbs) == joints - 1
        assert sorted({i for limb in limbs for i in limb}) == list(range(joints))  # with one limb less than joints: a tree


def test_the_network_is_the_stated_one() -> None:
    config = PafConfig(slots=SLOTS)
    network = Paf(config)
    convolutions = [(m.in_channels, m.out_channels, m.kernel_size[0]) for m in network.features if isinstance(m, torch.nn.Conv2d)]
    sizes = [64, 64, 128, 128, 256, 256, 256, 256, 512, 512, 256, 128]
    assert convolutions == [(a, b, 3) for a, b in zip([1, *sizes[:-1]], sizes, strict=True)]
    assert sum(isinstance(m, torch.nn.MaxPool2d) for m in network.features) == 3
    for branch, hidden, last in ((network.fields, 512, 26), (network.heat, 512, 15), (network.presence, 256, 14)):
        layers = [(m.out_channels, m.kernel_size[0]) for m in branch if isinstance(m, torch.nn.Conv2d)]
        assert layers == [(128, 3)] * 3 + [(hidden, 1), (last, 1)]
    cells = (352 // 8) * (288 // 8)
    assert network.classify.first.shape == (14, cells, 100)
    assert network.classify.second.shape == (14, 100, 2)
    assert config.view.focal == pytest.approx(139)
    assert PafConfig(width=176, height=144).view.focal == pytest.approx(69.5)
    assert PafConfig(focal=None).view.focal == 160  # as models have it that were trained before


def test_what_runs_has_the_tables_layers(trained: dict[str, Path]) -> None:
    """Norms are folded into the convolutions of an exported model."""
    kinds = Counter(node.op_type for node in onnx.load(trained["paf"]).graph.node)
    assert kinds["Conv"] == 12 + 3 * 5
    assert kinds["MaxPool"] == 3
    assert kinds["BatchNormalization"] == 0


def test_the_presence_branch_has_the_labels_of_ae2(tmp_path: Path) -> None:
    """Without the branch, and with two and three labels: network, exported model, loss and decoding."""
    base = {"width": 64, "height": 48, "focal": 51.2, "channels": 0.05, "slots": small.PERSONS}
    frames = StoredFrames(small.dataset(3), FrameSpec(PafConfig(**base).view, small.PERSONS, joints=UPPER_BODY))
    batch = collate([frames[i] for i in range(3)])
    batch.visibility[:, :, UPPER_BODY.index("neck")] = 1
    states = np.where(batch.present.numpy()[..., None], batch.visibility.numpy(), 0).max(axis=1)
    assert {1, 2, 4} <= set(np.unique(states))  # outside, occluded and visible
    for labels in (0, 2, 3):
        detector = Detector(TrainConfig(method="paf", settings=base | {"presence_labels": labels}))
        write_onnx(detector.eval(), tmp_path / f"{labels}.onnx", name="paf", card={})
        maps = detector.network(batch.depth)
        assert maps.presence.shape == (3, J, labels or 2)
        terms = loss(detector.network, batch)
        assert ("presence" in terms) is (labels > 0)
        logits = maps.presence.detach().double().numpy()
        p = np.exp(logits) / np.exp(logits).sum(-1, keepdims=True)
        if labels:
            truth = np.where(states < 2, 0, 1) + (states == 4) * (labels == 3)
            entropy = -np.log(np.take_along_axis(p, truth[..., None], -1)).sum() / labels / 3
            assert terms["presence"].item() == pytest.approx(entropy, rel=1e-5)
        found = decode(drawn([person(122, 38)]) | {"presence": logits[:1]}, CONFIG.model_copy(
            update={"presence_labels": labels, "presence": 0.0, "min_joints": 1}
        ), seen())  # fmt: skip
        np.testing.assert_allclose(found.presence[0, 0], 1 - p[0, :, 0] if labels else 1.0, rtol=1e-6)


@pytest.mark.parametrize(("what", "channels"), [("depth", 1), ("cloud", 3), ("amplitude", 1)])
def test_inputs_are_scaled_as_stated(what: str, channels: int) -> None:
    config = PafConfig(width=32, height=16, focal=20, input=what, channels=0.05)
    network = Paf(config)
    image = torch.full((1, 16, 32), 250.0 if what == "amplitude" else 0.9)
    image[0, 0, 0] = 0.0
    image[0, 0, 1] = 5000.0
    x = network.scaled(image)
    assert x.shape == (1, channels, 16, 32)
    assert x[0, -1, 8, 16] == pytest.approx(127.5)
    assert (x[0, :, 0, 0] == 0).all()
    assert x[0, -1, 0, 1] == 255
    if what == "cloud":
        u, v = 20, 3
        assert x[0, 0, v, u] == pytest.approx(((u - 15.5) / 20 * 0.9 + 1.5) / 3 * 255, rel=1e-5)
        assert x[0, 1, v, u] == pytest.approx(((v - 7.5) / 20 * 0.9 + 1.5) / 3 * 255, rel=1e-5)


def test_stages_refine_and_all_of_them_learn() -> None:
    config = PafConfig(width=32, height=16, channels=0.05, stages=3, slots=small.PERSONS)
    torch.manual_seed(0)
    network = Paf(config)
    maps = network(torch.rand(2, 16, 32))
    assert len(maps.stages) == 3
    assert maps.fields is maps.stages[-1][0]
    spec = FrameSpec(config.view, small.PERSONS, joints=config.joints)
    frames = StoredFrames(small.dataset(2), spec)
    loss(network, collate([frames[0], frames[1]]))["loss"].backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for name, p in network.named_parameters() if "4.weight" in name)


def test_targets_are_drawn_maps() -> None:
    config = PafConfig(width=64, height=48, focal=51.2, slots=small.PERSONS)
    frames = StoredFrames(small.dataset(3), FrameSpec(config.view, small.PERSONS, joints=config.joints))
    batch = collate([frames[2]])
    batch = batch._replace(visibility=torch.where(batch.visibility > 0, 4, 0).to(torch.uint8))
    people = [p for p in batch.joints[0, :, :, :2].double().numpy() if np.isfinite(p).all()]
    assert len(people) == 3
    heat, fields = targets(batch, config, 6, 8)
    expected = drawn(people, config)
    np.testing.assert_allclose(heat[0].numpy(), expected["heat"][0], atol=1e-5)
    np.testing.assert_allclose(fields[0].numpy(), expected["fields"][0], atol=1e-5)


def test_joints_out_of_the_image_leave_no_target() -> None:
    config = PafConfig(width=64, height=48, focal=51.2, slots=small.PERSONS)
    frames = StoredFrames(small.dataset(1), FrameSpec(config.view, small.PERSONS, joints=config.joints))
    batch = collate([frames[0]])
    states = batch.visibility.clone()
    states[:, :, UPPER_BODY.index("neck")] = 1
    heat, fields = targets(batch._replace(visibility=states), config, 6, 8)
    assert (heat[0, UPPER_BODY.index("neck")] == 0).all()
    touching = [c for c, limb in enumerate(config.joint_set.limbs) if UPPER_BODY.index("neck") in limb]
    assert len(touching) == 4
    assert all((fields[0, 2 * c : 2 * c + 2] == 0).all() for c in touching)
    assert (fields != 0).any()


def test_the_loss_is_the_thesis_sum() -> None:
    config = PafConfig(width=32, height=16, focal=25.6, channels=0.05, slots=small.PERSONS)
    torch.manual_seed(1)
    network = Paf(config).eval()
    frames = StoredFrames(small.dataset(2), FrameSpec(config.view, small.PERSONS, joints=config.joints))
    batch = collate([frames[0], frames[1]])
    terms = loss(network, batch)
    maps = network(batch.depth)
    heat, fields = targets(batch, config, 2, 4)
    there = (batch.present[..., None] & (batch.visibility > 1)).any(1).numpy()
    logits = maps.presence.detach().double().numpy()
    p = np.exp(logits) / np.exp(logits).sum(-1, keepdims=True)
    entropy = -np.log(np.where(there, p[..., 1], p[..., 0])).sum() / 2
    expected = 0.5 * (((maps.heat - heat) ** 2).sum() + ((maps.fields - fields) ** 2).sum()) / 2
    assert terms["presence"].item() == pytest.approx(entropy / 2, rel=1e-5)
    assert terms["loss"].item() == pytest.approx(expected.item() + entropy / 2, rel=1e-5)


def test_a_gaussian_peak_is_found_within_the_pixel() -> None:
    y, x = np.mgrid[:12, :16]
    for centre in ((5.3, 4.8), (7.0, 6.49), (2.51, 9.2)):
        heat = 0.8 * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / 2)
        (peaks,) = find_peaks(heat[None], 0.1, 5)
        assert len(peaks.height) == 1
        np.testing.assert_allclose(peaks.xy[0], centre, atol=1e-6)


def test_peaks_are_the_local_maxima() -> None:
    maps = np.stack([ndimage.gaussian_filter(np.random.default_rng(seed).random((18, 22)), 1.0) for seed in range(20)])
    maps[3] = 0.2  # a map without any
    every, two = find_peaks(maps, 0.5, 1000), find_peaks(maps, 0.5, 2)
    assert len(every) == len(two) == 20
    for number, (heat, all_, best) in enumerate(zip(maps, every, two, strict=True)):
        greatest = heat == ndimage.maximum_filter(heat, 3, mode="constant", cval=-1)
        expected = sorted(heat[greatest & (heat > 0.5)], reverse=True)
        assert len(expected) > 3 or number == 3
        np.testing.assert_array_equal(all_.height, expected)
        np.testing.assert_array_equal(best.height, expected[:2])
        cells = np.round(all_.xy).astype(int)
        assert all(abs(heat[v, u] - height) < 0.1 for (u, v), height in zip(cells, all_.height, strict=True))


def test_a_plateau_is_one_peak() -> None:
    heat = np.zeros((1, 5, 6))
    heat[0, 2, 2:4] = 0.7
    assert find_peaks(heat, 0.1, 9)[0].xy.tolist() == [[2.5, 2.0]]


def test_a_line_integral_is_the_mean_of_the_field_along_it() -> None:
    fields = np.random.default_rng(0).normal(size=(3, 2, 18, 22))
    a = np.array([[2.3, 4.1], [8.0, 9.0], [2.3, 4.1], [8.0, 9.0], [0.0, 17.0], [21.0, 0.0]])
    b = np.array([[15.2, 12.6], [3.0, 1.5], [20.9, 16.2], [15.2, 12.6], [21.0, 0.0], [0.0, 0.0]])
    limb = np.array([0, 2, 1, 1, 0, 2])
    score, share = line_scores(fields, limb, a, b)
    for p in range(len(limb)):
        points = a[p] + (b[p] - a[p]) * np.linspace(0, 1, 10)[:, None]
        values = np.stack([ndimage.map_coordinates(f, points.T[::-1], order=1, mode="nearest") for f in fields[limb[p]]], -1)
        dots = values @ (b[p] - a[p]) / np.linalg.norm(b[p] - a[p])
        assert score[p] == pytest.approx(dots.mean())
        assert share[p] == pytest.approx((dots > 0).mean())


def test_two_people_come_out_as_two_in_their_places() -> None:
    driver, passenger = person(122.3, 38.6), person(51.8, 41.2, 0.9)
    for people in ([driver, passenger], [passenger, driver]):
        found = decode(drawn(people), CONFIG, seen())
        np.testing.assert_allclose(found.uv[0], [driver, passenger], atol=0.6)
        np.testing.assert_allclose(found.presence[0], 1 / (1 + np.exp(-8.0)))


def test_an_arm_over_the_other_person_stays_with_its_owner() -> None:
    driver, passenger = person(118, 38), person(56, 40)
    reach = [UPPER_BODY.index(name) for name in ("relbow", "rwrist", "rhand")]
    driver[reach] = [(92, 56), (78, 66), (72, 74)]  # before the passenger's arm
    found = decode(drawn([driver, passenger]), CONFIG, seen())
    np.testing.assert_allclose(found.uv[0, 0, reach], driver[reach], atol=1.0)
    np.testing.assert_allclose(found.uv[0, 1], passenger, atol=1.5)


def test_a_lone_person_takes_the_nearest_place() -> None:
    found = decode(drawn([person(60, 45)]), CONFIG, seen())
    assert np.isnan(found.uv[0, 0]).all()
    assert np.isfinite(found.uv[0, 1]).all()
    assert (found.presence[0, 0] == 0).all()


def test_one_place_takes_the_greatest_peaks() -> None:
    config = CONFIG.model_copy(update={"slots": ("driver",)})
    maps = drawn([person(122, 38)])
    maps["fields"][:] = 0  # one person needs no fields
    found = decode(maps, config, seen())
    np.testing.assert_allclose(found.uv[0, 0], person(122, 38), atol=0.6)


def test_absent_joints_are_suppressed() -> None:
    maps = drawn([person(122, 38), person(50, 40)])
    hand = UPPER_BODY.index("lhand")
    maps["presence"][0, hand] = (0.1, 0.0)
    found = decode(maps, CONFIG, seen())
    assert np.isnan(found.uv[0, :, hand]).all()
    assert (found.presence[0, :, hand] == 0).all()
    others = [j for j in range(J) if j != hand]
    assert np.isfinite(found.uv[0][:, others]).all()


def test_depth_is_the_skins_and_the_offset() -> None:
    config = CONFIG.model_copy(update={"skin_offset_m": {"neck": 0.05}})
    people = [person(122, 38), person(50, 40)]
    scene = seen(1.2)
    scene["depth"][0, :, :88] = 0.9
    head = UPPER_BODY.index("head")
    u, v = np.round(people[0][head]).astype(int)
    scene["depth"][0, v - 2 : v + 3, u - 2 : u + 3] = 0.0  # nothing measured there
    found = decode(drawn(people), config, scene)
    neck = UPPER_BODY.index("neck")
    for slot, surface in ((0, 1.2), (1, 0.9)):
        z = surface + 0.05
        expected = [(found.uv[0, slot, neck, 0] - 87.5) / 80 * z, (found.uv[0, slot, neck, 1] - 71.5) / 80 * z, z]
        np.testing.assert_allclose(found.joints_3d[0, slot, neck], expected, atol=1e-6)
    assert found.joints_3d[0, 0, UPPER_BODY.index("relbow"), 2] == pytest.approx(1.2 + 0.04)  # half an elbow, by default
    assert np.isnan(found.joints_3d[0, 0, head]).all()
    assert np.isfinite(found.uv[0, 0, head]).all()


def test_surface_depth_is_the_median_around() -> None:
    depth = np.random.default_rng(1).uniform(0.5, 2, (1, 20, 30)) * (np.random.default_rng(2).random((1, 20, 30)) > 0.4)
    uv = np.array([[[10.4, 7.6], [0.2, 19.3], [40.0, 3.0], [np.nan, np.nan]]])
    got = surface_depth(depth, uv)[0]
    first, corner = depth[0, 6:11, 8:13], depth[0, 17:20, 0:3]
    assert got[0] == np.median(first[first > 0])
    assert got[1] == np.median(corner[corner > 0])
    assert np.isnan(got[2:]).all()


def test_people_fill_places_to_the_least_distance() -> None:
    slots = ("driver", "front_passenger", "rear_left", "rear_right")
    rng = np.random.default_rng(8)
    anchors = {slot: tuple(rng.uniform(0, 100, 2)) for slot in slots[:3]}  # nobody ever sat at the fourth
    config = PafConfig(slots=slots, slot_anchors=anchors)
    uv = rng.uniform(0, 100, (3, J, 2))
    pairs = slots_of(uv, np.array([1.0, 3.0, 2.0]), config)
    neck = UPPER_BODY.index("neck")

    def cost(order: tuple[int, ...]) -> float:
        return sum(np.linalg.norm(uv[p, neck] - anchors[slots[s]]) for s, p in enumerate(order))

    best = min(permutations(range(3)), key=cost)
    assert sorted((s, p) for p, s in pairs) == list(enumerate(best))
    unanchored = slots_of(uv, np.array([1.0, 3.0, 2.0]), PafConfig(slots=slots[:2]))
    assert unanchored == [(1, 0), (2, 1)]


def test_open_settings_are_measured() -> None:
    config = PafConfig(width=64, height=48, focal=51.2, slots=small.PERSONS)
    frames = StoredFrames(small.dataset(24), FrameSpec(config.view, small.PERSONS, joints=config.joints))
    kept = [frames[i] for i in range(24)]
    filled = measure.measured(config, kept)
    neck = UPPER_BODY.index("neck")
    for s, slot in enumerate(small.PERSONS):
        uv = [k.joints[s, neck, :2] for k in kept if k.present[s]]
        np.testing.assert_allclose(filled.slot_anchors[slot], np.mean(uv, axis=0), atol=0.051)
    assert "chest" not in filled.skin_offset_m  # the spheres' states never call it visible
    # The second joint lies on the torso's axis, 0.35 m above its centre, in the head of radius 0.12 m around -0.38 m: the skin
    # is sqrt(0.12² - 0.03²) in front of the axis.
    assert filled.skin_offset_m["neck"] == pytest.approx(0.11, abs=0.03)
    given = config.model_copy(update={"slot_anchors": {"driver": (1.0, 2.0)}, "skin_offset_m": {"neck": 0.5}})
    assert measure.measured(given, kept) == given


def test_nobody_to_measure_is_refused() -> None:
    config = PafConfig(width=64, height=48, slots=("driver",))
    with pytest.raises(DatasetError, match="nobody"):
        measure.slot_anchors(config, [])


@pytest.mark.parametrize("values", [{"width": 65}, {"stages": 0}, {"slot_anchors": {}}, {"input": "nir"}, {"unknown": 1}])
def test_settings_that_make_no_sense_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(values))) as caught:
        METHODS["paf"].settings(values)
    assert caught.value.hint
