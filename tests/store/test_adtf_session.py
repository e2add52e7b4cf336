"""A drive of the laboratory that ADTF recorded: `import adtfdat`, `align`, `evaluate` as commands, against the truth."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from adtf_takes import write_adtf_take

from cabinpose.app.lab.laboratory import load_truth, record_session
from cabinpose.app.lab.plan import SESSION, Plan, drive_take
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import JOINTS
from cabinpose.store import Predictions, open_dataset, write_predictions
from cabinpose.store.predictions import empty_batch

pytestmark = pytest.mark.slow
PLAN = Plan(views=12, frames_per_view=1, pendulum_s=8, seconds=8, rate_hz=2, exercises=False, seed=4)


def test_what_adtf_recorded_is_aligned_within_two_centimetres(tmp_path: Path, run: Callable[..., Any]) -> None:
    """The rig has all its errors; the suit's pose is corrected by the N-pose, as calibrated."""
    pytest.importorskip("adtf_file", reason="the vendor's package `adtf` is not installed")
    lab = tmp_path / "lab"
    record_session(lab, VirtualRig(), PLAN)
    write_adtf_take(lab / drive_take("S01"), tmp_path / "drive.adtfdat", tmp_path / "layout.yaml")
    (tmp_path / "take.yaml").write_text("action: drive\ncar: sedan\nsubjects:\n- {code: S01, seat: driver}\n")
    for words in (
        ("import", "adtfdat", tmp_path / "drive.adtfdat", "--layout", tmp_path / "layout.yaml", "--take", tmp_path / "take.yaml",
         "--out", tmp_path / "drive.mcap"),
        ("calibrate", lab / SESSION, "--out", tmp_path / "rig.yaml"),
        ("align", tmp_path / "drive.mcap", "--calibration", tmp_path / "rig.yaml", "--out", tmp_path / "data"),
    ):  # fmt: skip
        done = run(*words)
        assert done.code == 0, done.err
    # the lab's truth as predictions, so that `evaluate` tells how far the aligned joints are from it
    truth = load_truth(lab, "S01")
    data = open_dataset(tmp_path / "data")
    persons = tuple(data["person"].values.tolist())
    place = persons.index("driver")
    found = data["joints_3d"].values[:, place]
    late_s = (data["sync_ns"].values - data["sync_ns"].values[0]) / 1e9
    frames = np.rint(late_s * PLAN.rate_hz).astype(int)
    first = len(truth.tof_ns) - 1 - frames[-1] if len(found) < len(truth.tof_ns) else 0
    error_cm = 100 * np.linalg.norm(found - truth.joints_3d[first + frames], axis=2)
    assert len(found) >= 10
    assert error_cm.mean() < 2.0
    xyz = np.full((len(found), len(persons), len(JOINTS), 3), np.nan, np.float32)
    xyz[:, place] = truth.joints_3d[first + frames]
    batch = replace(
        empty_batch(len(found), len(persons), len(JOINTS)), joints_3d=xyz, presence=np.isfinite(xyz[..., 0]).astype(np.float32)
    )
    told = Predictions(**vars(batch), frame=np.arange(len(found)), persons=persons, joints=JOINTS, model="truth")
    write_predictions(tmp_path / "truth.jsonl", told)
    done = run("evaluate", tmp_path / "data", "--predictions", tmp_path / "truth.jsonl", "--json")
    assert done.code == 0, done.err
    rows = json.loads(done.out)["models"][0]["values"]
    told_cm, *_ = [row["value"] for row in rows if (row["metric"], row["space"], row["joints"]) == ("MPJPE", "3d", "All")]
    seen = data["visibility"].values[:, place] > Visibility.OUTSIDE_IMAGE
    assert told_cm == pytest.approx(error_cm[seen].mean(), abs=0.02)  # `evaluate` counts joints in the image
    assert told_cm < 2.0
