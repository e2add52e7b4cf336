"""Labels of an aligned recording: the suit's wrists and hips, without a class or an instance for any pixel."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from cabinpose.app.label.labelling import Labelling
from cabinpose.app.studio.exchange import zipped
from cabinpose.app.studio.workspace import open_workspace
from cabinpose.core.pose import Visibility
from cabinpose.store import open_dataset, read_manifest
from cabinpose.store.labels import read_labels
from cabinpose.store.source import Source, blank_frame, import_source
from cabinpose.store.variables import DEPTH_SCALE_M

SUIT = ("rwrist", "lwrist", "hip", "rpelvis", "lpelvis")


@pytest.fixture
def recorded(generated: Path, tmp_path: Path) -> Path:
    """The generated frames as `align` would have written them: images of the camera and joints, one take, nothing else."""
    made = open_dataset(generated)
    manifest = read_manifest(generated).model_copy(
        update={"generator": "cabinpose.align", "variables": ("depth", "amplitude", "confidence"), "labels": (), "materials": ()}
    )

    def frames() -> Iterator[dict[str, Any]]:
        for row in range(manifest.frames):
            one = made.isel(frame=row).load()
            frame = blank_frame(manifest) | {name: one[name].values for name in ("amplitude", "confidence")}
            frame["depth"] = np.rint(np.nan_to_num(one["depth"].values) / DEPTH_SCALE_M).astype(np.uint16)
            for name in ("joints_2d", "joints_3d", "visibility", "camera_k", "camera_dist"):
                frame[name] = one[name].values
            frame["subject"], frame["action"] = made["subject"].values[0].tolist(), one["action"].values.tolist()
            yield frame

    return import_source(Source(generated, manifest, frames), tmp_path / "recorded")


def test_wrists_and_hips_of_the_suit_are_corrected(recorded: Path) -> None:
    """Those five alone are asked for, accepted and interpolated; a frame is done with them."""
    workspace = open_workspace(recorded)
    labelling = Labelling(workspace.dataset, workspace.labels, workspace.role)
    labelling.joints = labelling.sets["wrists and hips"]
    assert labelling.joints == SUIT
    assert labelling.people(0)[0] == "driver"
    assert [shown.origin for shown in labelling.shown(0, "driver")] == ["dataset"] * 5
    for row in (0, 4):
        assert labelling.accept(row, "driver") == 5
        assert labelling.done(row, "driver")
    before = next(shown.label for shown in labelling.shown(2, "driver") if shown.joint == "hip")
    assert before is not None
    placed = labelling.place(2, "driver", "hip", before.uv[0] - 4, before.uv[1])
    assert np.isfinite(placed.xyz).all()
    assert labelling.interpolate(2, "driver") == 3
    assert {joint for _, _, joint in workspace.labels.now} == set(SUIT)
    assert labelling.key_frames("driver") == [0, 1, 2, 3, 4]
    kept = workspace.labels.get(int(labelling.numbers[2]), "driver", "hip")
    assert kept == placed  # what a person placed is not interpolated over
    workspace.close()


def test_recording_goes_to_cvat_and_back(recorded: Path, run: Callable[..., Any], tmp_path: Path) -> None:
    """Nobody's pixels are known: the box is that about the keypoints; only the joint that was moved becomes a label."""
    assert run("export", "coco", recorded, "--out", tmp_path / "coco").code == 0
    path = tmp_path / "coco" / "annotations" / "person_keypoints.json"
    coco = json.loads(path.read_text())
    dataset = open_dataset(recorded)
    there = (dataset["visibility"].values > Visibility.OUTSIDE_IMAGE).any(axis=2)
    assert len(coco["annotations"]) == there.sum()
    for person in coco["annotations"]:
        points = np.array(person["keypoints"]).reshape(-1, 3)
        left, top, width, height = person["bbox"]
        low, high = points[points[:, 2] > 0, :2].min(axis=0), points[points[:, 2] > 0, :2].max(axis=0)
        np.testing.assert_allclose([left, top, left + width, top + height], [*low, *high], atol=0.002)
    (driver,) = (a for a in coco["annotations"] if (a["image_id"], a["slot"]) == (3, "driver"))
    wrist = coco["categories"][0]["keypoints"].index("lwrist")
    measured = ndimage.minimum_filter(np.isfinite(dataset["depth"].values[3]), 7, mode="constant")
    v, u = np.argwhere(measured)[0]
    driver["keypoints"][3 * wrist : 3 * wrist + 3] = [float(u), float(v), 2]
    for person in coco["annotations"]:
        del person["slot"]
    path.write_text(json.dumps(coco))
    journal = tmp_path / "recorded.labels.jsonl"
    assert run("import", "coco-labels", path, "--corrects", recorded, "--out", journal).code == 0
    ((key, label),) = read_labels(journal)[1].items()
    assert key == (3, "driver", "lwrist")
    assert (label.uv, label.visibility) == ((u, v), Visibility.VISIBLE)
    surface = dataset["depth"].values[3, v - 2 : v + 3, u - 2 : u + 3].mean()
    assert label.xyz[2] == pytest.approx(surface, abs=0.15)  # near the surface there


def test_studio_gives_everybody_of_a_recording(recorded: Path, tmp_path: Path) -> None:
    """As the command line does, though it fills in images of nobody for the eye."""
    workspace = open_workspace(recorded)
    assert workspace.dataset is not None
    assert not workspace.dataset["instance"].values.any()
    with zipfile.ZipFile(zipped(workspace, workspace.dataset, tmp_path)) as archive:
        coco = json.loads(archive.read("annotations/person_keypoints.json"))
    there = (workspace.dataset["visibility"].values > Visibility.OUTSIDE_IMAGE).any(axis=2)
    assert len(coco["annotations"]) == there.sum()
