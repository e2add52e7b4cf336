"""Grid regression: the loss of one cell by hand, overlaps by counting, and boxes that are drawn for true joints found again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small
import torch
from numpy.typing import NDArray

from cabinpose.estimate.batch import Batch
from cabinpose.estimate.data import FrameSpec, StoredFrames, collate
from cabinpose.estimate.yolo.config import YoloConfig
from cabinpose.estimate.yolo.fit import Truths, box_iou, grid_loss, loss, responsible, surface_depth, truths
from cabinpose.estimate.yolo.method import METHOD
from cabinpose.estimate.yolo.model import Grid, Yolo

# One place, 20 joints, a grid of 4 x 4 cells of 8 px.
CONFIG = YoloConfig(width=32, height=32, focal=40, cell_px=8, slots=("driver",), box_m=0.4, least=0.1)
CELLS = 16


def encoded(batch: Batch, config: YoloConfig) -> dict[str, NDArray[np.float64]]:
    """What a perfect network would answer, joint by joint; the second box of a cell is of the second joint in it."""
    n, h, w = len(batch.joints), config.height // config.cell_px, config.width // config.cell_px
    boxes = np.zeros((n, config.boxes, 6, h, w))
    classes = np.zeros((n, len(config.slots) * len(config.joints), h, w))
    for i in range(n):
        for s in range(len(config.slots)):
            for j in range(len(config.joints)):
                u, v, z = batch.joints[i, s, j].double().numpy()
                if not (batch.present[i, s] and batch.visibility[i, s, j] > 1):
                    continue
                column, row = int((u + 0.5) // config.cell_px), int((v + 0.5) // config.cell_px)
                b = int(boxes[i, 0, 4, row, column] > 0)
                side = config.focal * config.box_m / z
                patch = batch.depth[i, max(round(v) - 2, 0) : round(v) + 3, max(round(u) - 2, 0) : round(u) + 3].double()
                skin = float(np.median(patch[patch > 0])) if (patch > 0).any() else 0.0
                x, y = (u + 0.5) / config.cell_px - column, (v + 0.5) / config.cell_px - row
                roots = (side / config.width) ** 0.5, (side / config.height) ** 0.5
                boxes[i, b, :, row, column] = x, y, *roots, 1, (z - skin) / 0.1
                classes[i, s * len(config.joints) + j, row, column] = 1
    return {"boxes": boxes, "classes": classes}


def spheres(config: YoloConfig, count: int = 3) -> Batch:
    frames = StoredFrames(small.dataset(count), FrameSpec(config.view, config.slots, joints=config.joints))
    return collate([frames[i] for i in range(count)])


def scattered(config: YoloConfig) -> Batch:
    """Three frames of joints that lie anywhere in the view, 5 cm behind a rough surface; some are absent, and one person is."""
    rng = np.random.default_rng(1)
    shape = (3, len(config.slots), len(config.joints))
    uvz = rng.uniform((0, 0, 0.8), (config.width - 1, config.height - 1, 2.5), (*shape, 3))
    depth = rng.uniform(0.8, 2.5, (3, config.height, config.width))
    visibility, present = rng.choice([0, 2, 4], shape), np.array([[True, True, False], [True, True, True], [True, False, True]])
    uvz[visibility == 0] = np.nan
    tensors = (torch.from_numpy(a.astype(t)) for a, t in ((depth, "f4"), (uvz, "f4"), (visibility, "u1"), (present, "?")))
    return Batch(*tensors)


def test_what_is_encoded_is_decoded() -> None:
    config = YoloConfig(width=64, height=48, focal=51.2, slots=small.PERSONS)
    batch = scattered(config)
    known = (batch.present[..., None] & (batch.visibility > 1)).numpy()
    truth = batch.joints.double().numpy()
    place = (truth[..., :2] + 0.5) // config.cell_px
    flat = np.where(known, place[..., 1] * 100 + place[..., 0], -1 - np.arange(known[0].size).reshape(known[0].shape))
    alone = np.array([[[np.sum(frame == cell) == 1 for cell in slot] for slot in frame] for frame in flat]) & known
    found = METHOD.decode(encoded(batch, config), config, {"depth": batch.depth.numpy()})
    assert alone.sum() > 20
    np.testing.assert_allclose(found.uv[alone], truth[alone][:, :2], atol=1e-5)
    np.testing.assert_allclose(found.joints_3d[alone], config.view.from_view(truth)[alone], atol=1e-5)
    assert np.isnan(found.uv[~known]).all()
    assert (found.presence[~known] == 0).all()
    assert (found.presence[known] == 1).all()
    together = known & ~alone  # joints of one cell share its best box: off by less than a cell
    assert np.abs(found.uv[together] - truth[together][:, :2]).max() < config.cell_px


def test_the_best_box_of_a_class_wins_and_the_least_score_decides() -> None:
    boxes, classes = np.zeros((1, 2, 6, 4, 4)), np.zeros((1, 20, 4, 4))
    boxes[0, 0, :, 1, 2] = 0.5, 0.25, 0.5, 0.5, 0.9, 0.0
    boxes[0, 1, :, 3, 0] = 0.25, 0.5, 0.5, 0.5, 0.8, 2.0
    classes[0, 4, 1, 2], classes[0, 4, 3, 0] = 0.5, 0.6  # 0.45 against 0.48
    classes[0, 7, 1, 2] = 0.1  # 0.09
    depth = np.full((1, 32, 32), 1.5)
    found = METHOD.decode({"boxes": boxes, "classes": classes}, CONFIG, {"depth": depth})
    np.testing.assert_allclose(found.uv[0, 0, 4], (1.5, 27.5))
    assert found.score[0, 0, 4] == pytest.approx(0.48)
    assert found.joints_3d[0, 0, 4, 2] == pytest.approx(1.7)  # 2 dm behind the surface
    assert np.isnan(found.uv[0, 0, 7]).all()
    assert found.presence[0, 0, 7] == pytest.approx(0.45)
    nothing = METHOD.decode({"boxes": boxes, "classes": classes}, CONFIG, {"depth": 0 * depth})
    assert nothing.joints_3d[0, 0, 4, 2] == pytest.approx(40 * 0.4 / (0.25 * 32))  # as large as a joint's box at 2 m


def test_overlaps_are_shares_of_pixels() -> None:
    """On whole numbers areas are counts of unit squares."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        drawn = []
        for _ in range(2):
            low = rng.integers(0, 12, 2)
            high = low + rng.integers(1, 8, 2)
            mask = np.zeros((20, 20), bool)
            mask[low[1] : high[1], low[0] : high[0]] = True
            drawn.append((mask, torch.tensor([*(low + high) / 2, *(high - low)])))
        (a, box_a), (b, box_b) = drawn
        assert float(box_iou(box_a, box_b)) == pytest.approx((a & b).sum() / (a | b).sum())


def test_one_cell_by_hand() -> None:
    """Box 0 lies on the joint's box, box 1 beside it: equation 3, term by term."""
    boxes = torch.zeros((1, 2, 6, 4, 4))
    boxes[0, 0, :, 1, 2] = torch.tensor([0.5, 0.75, 0.5, 0.5, 0.7, 0.4])  # 8 px wide and high: one cell
    boxes[0, 1, :, 1, 2] = torch.tensor([3.5, 0.5, 0.5, 0.5, 0.2, 0.0])
    boxes[0, 1, 4, 0, 0] = -0.1
    classes = torch.zeros((1, 20, 4, 4))
    classes[0, 3, 1, 2], classes[0, 5, 1, 2], classes[0, 5, 0, 0] = 0.6, 0.3, 9.0
    known = torch.zeros((1, 20), dtype=torch.bool)
    known[0, 3] = True
    cell = torch.full((1, 20), 6)
    box = torch.tensor([0.5, 0.25, 0.25, 0.25]).expand(1, 20, 4)
    true = Truths(known, cell, box, torch.full((1, 20), 0.9), torch.ones_like(known))
    terms = {name: float(value) for name, value in grid_loss(Grid(boxes, classes), true, CONFIG).items()}
    overlap = 0.5 / 1.5  # two squares of one cell, half a cell apart
    assert terms.pop("place") == pytest.approx(5 * 0.5**2)
    assert terms.pop("size") == pytest.approx(0)
    assert terms.pop("confidence") == pytest.approx((0.7 - overlap) ** 2)
    assert terms.pop("empty") == pytest.approx(0.5 * (0.2**2 + 0.1**2))
    assert terms.pop("classes") == pytest.approx(0.4**2 + 0.3**2)
    assert terms.pop("offset") == pytest.approx(5 * 0.5**2)
    assert terms.pop("loss") == pytest.approx(1.25 + (0.7 - overlap) ** 2 + 0.025 + 0.25 + 1.25)
    assert not terms


def test_joints_of_one_cell_answer_by_different_boxes() -> None:
    known = torch.tensor([[True, True, True, True, False]])
    cell = torch.tensor([[7, 7, 2, 7, 7]])
    overlap = torch.tensor([[[0.1, 0.6], [0.2, 0.9], [0.3, 0.1], [0.9, 0.9], [0.9, 0.9]]])
    answering, which, taken = responsible(
        Truths(known, cell, torch.zeros((1, 5, 4)), torch.zeros((1, 5)), torch.ones_like(known)), overlap, CELLS
    )
    assert answering.tolist() == [[True, True, True, False, False]]  # two boxes a cell
    assert which[0, :3].tolist() == [1, 0, 0]  # the first takes the better one, the second what is left
    assert [tuple(at) for at in taken.nonzero().tolist()] == [(0, 0, 2), (0, 0, 7), (0, 1, 7)]


def test_targets_are_those_drawn() -> None:
    config = YoloConfig(width=64, height=48, focal=51.2, slots=small.PERSONS)
    batch = spheres(config)
    true, drawn = truths(batch, config), encoded(batch, config)
    w = config.width // config.cell_px
    held = drawn["classes"].reshape(len(batch.joints), -1, 12 * w)
    for n, t in true.known.nonzero().tolist():
        cell = int(true.cell[n, t])
        assert held[n, t, cell] == 1
        boxes = drawn["boxes"].reshape(len(batch.joints), 2, 6, -1)[n, :, :, cell]
        roots = np.array([*true.box[n, t, :2], *true.box[n, t, 2:].sqrt()])
        assert np.abs(boxes[:, :4] - roots).max(axis=1).min() < 1e-4 or (held[n, :, cell].sum() > 2)
        if torch.isfinite(true.offset[n, t]) and held[n, :, cell].sum() == 1:
            assert boxes[0, 5] == pytest.approx(float(true.offset[n, t]), abs=0.05)
    assert true.known.sum() == held.sum()
    assert torch.isfinite(true.offset).sum() > 10


def test_the_surface_is_that_of_decoding() -> None:
    from cabinpose.estimate.paf.decode import surface_depth as decoded

    rng = np.random.default_rng(2)
    depth = np.tile(1.0 + np.arange(20)[:, None], (2, 1, 30)).astype(np.float32)
    depth[:, :, ::7] = 0  # whole columns: where rows are of odd number, no median lies between two of them
    uv = rng.uniform(-3, 33, (2, 40, 2))
    ours = surface_depth(torch.from_numpy(depth), torch.from_numpy(uv)).numpy()
    theirs = decoded(depth, uv)
    both = np.isfinite(theirs) & (theirs == np.round(theirs))
    assert both.sum() > 30
    np.testing.assert_array_equal(ours[both], theirs[both])


@pytest.mark.parametrize("cell_px", [4, 8])
def test_everything_learns(cell_px: Any) -> None:
    config = YoloConfig(**small.TINY["yolo"], cell_px=cell_px)
    torch.manual_seed(0)
    network = Yolo(config)
    batch = spheres(config, 2)
    grid = network(batch.depth, torch.ones_like(batch.depth))
    assert grid.boxes.shape == (2, 2, 6, 48 // cell_px, 64 // cell_px)
    assert grid.classes.shape == (2, 60, 48 // cell_px, 64 // cell_px)
    loss(network, batch._replace(amplitude=torch.ones_like(batch.depth)))["loss"].backward()
    assert all(p.grad is not None and bool(torch.isfinite(p.grad).all()) for p in network.parameters())
    assert all(p.grad.abs().sum() > 0 for name, p in network.named_parameters() if p.grad is not None and "weight" in name)
