"""ITOP's protocol on the predictions that A2J published: the numbers of the literature come out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import loadmat

from cabinpose.core.errors import DatasetError, PredictionsError
from cabinpose.core.skeleton import ITOP
from cabinpose.evaluate.itop import evaluate_itop, itop_summary
from cabinpose.evaluate.options import EvaluationOptions
from cabinpose.evaluate.report import Report
from cabinpose.store.itop import ItopReference, project, read_itop_reference, unproject

OPTIONS = EvaluationOptions(resamples=20)
RealData = Callable[[str], Path]


def number(report: Report, metric: str, space: str = "3d", threshold: float | None = None) -> float:
    found = report.value(metric, space, threshold=threshold)
    assert found is not None
    return found.value


@pytest.mark.real_data
@pytest.mark.slow
def test_a2j_scores_as_published(real_data: RealData) -> None:
    reference = read_itop_reference(real_data("itop/itop_side_keypoints3D_test.mat"))
    uvd = np.asarray(loadmat(real_data("itop/a2j_itop_side_predictions.mat"))["resultUVD"], float)
    report = evaluate_itop(reference, unproject(uvd), OPTIONS, joints_2d=uvd[..., :2], model="A2J")
    summary = itop_summary(report)
    assert summary["frames"] == 4863
    assert summary["within_10cm"] == pytest.approx(88.018, abs=0.005)
    assert summary["mean_cm"] == pytest.approx(5.85, abs=0.005)
    assert summary["pck_2d_26px"] == pytest.approx(99.16, abs=0.005)
    assert summary["mean_2d_px"] == pytest.approx(4.05, abs=0.005)
    for threshold, share in ((5, 60.3), (15, 94.5), (20, 97.1)):
        assert number(report, "PCK", threshold=threshold) == pytest.approx(share, abs=0.05)
    for metric, value, digits in (
        ("mAD", 5.85, 0.005), ("mean error of hits", 4.20, 0.005), ("median error", 4.21, 0.005),
        ("P95 of the error", 15.7, 0.05), ("P-MPJPE", 4.78, 0.005), ("left-right swaps", 0.25, 0.005),
        ("mAP@d (among detected)", 88.018, 0.005), ("mAR (detected)", 100, 0),
    ):  # fmt: skip
        assert number(report, metric) == pytest.approx(value, abs=digits), metric
    for metric in ("PCK", "MPJPE"):
        value = report.value(metric)
        assert value is not None
        assert value.low < value.value < value.high
        assert value.samples == 4863 * 15
    assert report.value("jitter") is None or report.value("jitter").samples == 0  # type: ignore[union-attr]


@pytest.mark.slow
@pytest.mark.real_data
def test_the_floor(real_data: RealData) -> None:
    """The mean pose placed at the true torso: what a method gets for knowing where the person is."""
    reference = read_itop_reference(real_data("itop/itop_side_keypoints3D_test.mat"))
    torso = reference.joints_3d[:, [ITOP.joints.index("torso")]]
    floor = torso + (reference.joints_3d - torso).mean(axis=0)
    summary = itop_summary(evaluate_itop(reference, floor, OPTIONS))
    assert summary["within_10cm"] == pytest.approx(58.2, abs=0.05)
    assert summary["mean_cm"] == pytest.approx(13.5, abs=0.05)


@pytest.mark.real_data
def test_the_64_frames_are_among_all(real_data: RealData) -> None:
    every = read_itop_reference(real_data("itop/itop_side_keypoints3D_test.mat"))
    some = read_itop_reference(real_data("itop/itop_front_64.npz"))
    assert np.allclose(every.joints_3d[some.frame], some.joints_3d, atol=1e-6)
    uvd = np.asarray(loadmat(real_data("itop/a2j_itop_side_predictions.mat"))["resultUVD"], float)[some.frame]
    with np.load(real_data("itop/itop_front_64.npz")) as arrays:
        assert np.allclose(arrays["a2j_3d"] * (1, -1, 1), unproject(uvd), atol=1e-5)


def test_invalid_frames_are_left_out(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    up = rng.normal((0, 0.5, 2.5), 0.3, (6, 15, 3)).astype(np.float16)
    with h5py.File(tmp_path / "labels.h5", "w") as file:
        file["real_world_coordinates"] = up
        file["is_valid"] = np.array([1, 0, 1, 1, 0, 1], np.uint8)
    reference = read_itop_reference(tmp_path / "labels.h5")
    assert np.allclose(reference.joints_3d, up.astype(float) * (1, -1, 1))
    predicted = reference.joints_3d + (0.03, 0, 0)
    predicted[1] = np.nan  # an invalid frame without an answer costs nothing,
    predicted[2, :5] = np.nan  # a third of a valid one's joints do
    report = evaluate_itop(reference, predicted, OPTIONS)
    assert report.frames == 4
    assert "4 valid of 6 frames" in report.notes[0]
    assert number(report, "PCK", threshold=10) == pytest.approx(100 * 55 / 60)
    assert number(report, "MPJPE") == pytest.approx(3.0, abs=1e-3)
    assert number(report, "mAR (detected)") == pytest.approx(100 * 55 / 60)


def test_projection_goes_both_ways() -> None:
    points = np.random.default_rng(1).normal((0, 0, 3), 0.4, (5, 15, 3))
    uv = project(points)
    assert np.allclose(uv[..., 0], points[..., 0] / points[..., 2] / 0.0035 + 160)
    assert np.allclose(unproject(np.concatenate((uv, points[..., 2:]), axis=-1)), points)
    assert np.isnan(project(np.array([0.0, 0.0, -1.0]))).all()


def test_other_files_and_shapes_are_refused(tmp_path: Path) -> None:
    (tmp_path / "labels.h5").write_bytes(b"no HDF5")
    for name in ("labels.h5", "absent.npz", "absent.mat"):
        with pytest.raises(DatasetError, match="ITOP reference") as caught:
            read_itop_reference(tmp_path / name)
        assert caught.value.hint
    np.savez(tmp_path / "a.npz", joints_3d=np.zeros((4, 14, 3)), frame=np.arange(4))
    with pytest.raises(DatasetError, match="shape"):
        read_itop_reference(tmp_path / "a.npz")
    reference = ItopReference(np.arange(4), np.ones((4, 15, 3)), np.ones(4, bool))
    with pytest.raises(PredictionsError, match="shape"):
        evaluate_itop(reference, np.ones((3, 15, 3)), OPTIONS)
