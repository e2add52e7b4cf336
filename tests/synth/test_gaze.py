"""Gaze and head pose: what was drawn comes back from the head, targets against the rasteriser, nothing unless asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from synth_scenes import small_config

from cabinpose.core.camera import Camera
from cabinpose.core.frames import axis_rotation, invert, look_at
from cabinpose.scene.body import SEGMENTS
from cabinpose.scene.surface import Surface
from cabinpose.store import open_dataset
from cabinpose.synth.config import SynthConfig
from cabinpose.synth.gaze import GAZE_VARIABLES, gaze_labels, line_of_sight
from cabinpose.synth.generate import generate
from cabinpose.synth.posture.gaze import HEAD_SHARE, head_rotation
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.sample import SceneSampler
from cabinpose.synth.streams import frame_rng
from cabinpose.synth.variables import build_manifest

SLOTS = ("driver", "front_passenger", "rear_left", "rear_center", "rear_right")


@pytest.mark.parametrize("heading", [0.0, np.pi])
@pytest.mark.parametrize(("yaw", "pitch", "tilt"), [(0.0, 0.0, 0.0), (0.5, -0.3, 0.2), (-1.8, 0.2, -0.1), (0.9, -0.9, 0.0)])
def test_the_line_of_sight_is_the_gaze_that_turned_the_head(yaw: float, pitch: float, tilt: float, heading: float) -> None:
    head = head_rotation(heading + HEAD_SHARE[0] * yaw, HEAD_SHARE[1] * pitch, tilt)[:3, :3]
    wanted = axis_rotation("z", heading + yaw) @ axis_rotation("y", -pitch) @ (1.0, 0.0, 0.0)
    assert line_of_sight(head, heading) == pytest.approx(wanted, abs=1e-9)


def test_the_target_is_what_the_eye_sees_in_the_middle() -> None:
    """Every part rendered by itself, from between the eyes along the gaze: the nearest in the middle is the target."""
    config = small_config(motion={"driver": {"look_mirror": 0.3, "drive": 0.3, "phone_text": 1.0}})
    sampler = SceneSampler(config, 4)
    eye = Rasteriser(Camera.from_fov(65, 65, 0.5), supersample=1)
    told = set()
    for index in range(12):
        scene = sampler.sample(index, rng=frame_rng(4, index))
        labels = gaze_labels(scene, SLOTS, target=True)
        (person,), target = scene.people, labels["gaze_target"][0]
        start = person.posed.eyes_m
        hands = person.posed.skin[np.isin(person.person.skin_segment, [SEGMENTS.index(s + "hand") for s in "lr"])]
        ahead = (hands - start) @ labels["gaze"][0]
        off = np.linalg.norm(hands - start - ahead[:, None] * labels["gaze"][0], axis=1)[ahead > 0].min()
        if target == "hand":
            assert off < 0.01  # points of the skin are closer than this
            told.add(target)
            continue
        assert off > 0.001
        camera = invert(look_at(start, start + labels["gaze"][0].astype(np.float64)))
        transforms = scene.cabin.group_transforms(scene.settings, wheel_angle=scene.wheel_angle)
        seen = {}
        for part in scene.cabin.parts:
            s, m = part.surface, transforms[part.group].astype(np.float32)
            moved = Surface(
                s.vertices @ m[:3, :3].T + m[:3, 3], s.normals @ m[:3, :3].T, s.faces, s.label, s.material, s.instance
            )  # fmt: skip
            depth = float(eye.render(moved, camera).depth_clean[32, 32])
            if depth > 0.0:
                seen[part.name] = depth
        assert target == min(seen, key=seen.__getitem__)
        told.add(target)
    assert len(told) > 2
    assert "hand" in told


def test_gaze_is_written_when_it_is_asked_for(tmp_path: Path) -> None:
    config = small_config(occupancy={"driver": 1.0, "front_passenger": 0.5}).model_dump(mode="json")
    assert "gaze" not in config["output"]
    assert not set(GAZE_VARIABLES) & set(build_manifest(SynthConfig.parse(config), 3, 0).variables)
    config["output"]["gaze"] = True
    generate(SynthConfig.parse(config), 6, tmp_path / "set", seed=1, workers=1)
    dataset = open_dataset(tmp_path / "set").load()
    there = dataset["subject"].values != ""
    looks = there & (dataset["action"].values != "sleep")
    assert (np.isfinite(dataset["gaze"].values).all(-1) == looks).all()
    assert np.linalg.norm(dataset["gaze"].values[looks], axis=-1) == pytest.approx(1.0, abs=1e-6)
    assert ((dataset["gaze_target"].values != "") == there).all()
    heads, joints = dataset["vehicle_from_head"].values[there], dataset["joints_3d"].values[there][:, 0]
    frames = np.nonzero(there)[0]
    seen = np.linalg.inv(dataset["vehicle_from_camera"].values[frames]) @ heads
    assert seen[:, :3, 3] == pytest.approx(joints, abs=1e-4)  # the joint "head" is C1
