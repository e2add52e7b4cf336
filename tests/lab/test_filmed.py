"""Sequences of the generator as the laboratory records them: its motion, its images, and labels that err as a rig does."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.app.lab import filmed, takes
from cabinpose.app.lab.filmed import _LEAD_S, FilmedMotion, FilmedSession, FilmedSubject, _Films, record_films, recorded_share
from cabinpose.app.lab.rig import VirtualRig
from cabinpose.core import CABINPOSE
from cabinpose.core.errors import SceneError
from cabinpose.scene.body import BONE_INDEX
from cabinpose.store import open_dataset
from cabinpose.synth import SynthConfig

PLAIN: dict[str, Any] = {
    "scene": {
        "cars": ["sedan"], "right_hand_drive": 0.0, "occupancy": {"driver": 1.0}, "clutter": 0.0,
        "sequence": {"frames": 12, "rate_hz": 5.0, "activities": ["check_mirror", "operate"]},
    },
    "people": {"driver_years": 0, "subjects": [], "own": {"P1": {"gender": "male", "stature_cm": 178}}},
    "camera": {"sensor": "pico_monstar_105", "views": {"driver": 1.0}, "jitter_m": 0.0, "jitter_deg": 0.0},
}  # fmt: skip


def session(rig: VirtualRig | None = None, frames: int = 12, **changes: Any) -> FilmedSession:
    scenes = SynthConfig.parse({**PLAIN, **changes})
    return FilmedSession(subjects={"P1": FilmedSubject(scenes=scenes, seed=3, frames=frames)}, rig=rig or VirtualRig(), views=12)


def test_a_subject_does_one_activity_a_take_until_there_are_enough_frames() -> None:
    takes = session(frames=40).takes()  # 44 with those that may be lost: four takes of twelve
    assert [(t.activity, t.number) for t in takes] == [("check_mirror", 0), ("operate", 0), ("check_mirror", 1), ("operate", 1)]


def test_takes_that_are_there_are_recorded(tmp_path: Path) -> None:
    (made := tmp_path / "recordings").mkdir()
    assert recorded_share(session(frames=40), made) == 0.0
    for name in ("board.mcap", "take-0000-P1.mcap", "take-0002-P1.mcap", "take-0003-P2.mcap"):  # the last is somebody else's
        (made / name).touch()
    assert recorded_share(session(frames=40), made) == 0.5


def test_a_take_is_the_film_after_turns_of_the_head() -> None:
    films = _Films(made := session())
    film = films.film(made.takes()[0])
    motion = FilmedMotion(film, "driver")
    at = np.array([0.0, 0.4])
    for later in at:
        (person,) = film.people(float(later))
        assert motion.joints(_LEAD_S + later)[0] == pytest.approx(person.posed.joints, abs=1e-5)
        assert motion.body(_LEAD_S + float(later)).skin == pytest.approx(person.posed.skin, abs=1e-6)
    time = np.arange(0.0, _LEAD_S, 1 / 60)
    joints = motion.joints(time)
    trunk = [CABINPOSE.index[name] for name in ("hip", "chest", "lwrist")]
    assert np.ptp(joints[:, trunk], axis=0).max() < 0.02  # breathing
    facing = np.degrees(Rotation.from_matrix(motion.bones(time)[0][:, BONE_INDEX["head"]]).as_euler("ZYX", degrees=False))
    assert np.ptp(facing, axis=0).min() > 10.0  # about every axis
    assert motion.duration_s == pytest.approx(_LEAD_S + 11 / 5.0 + 0.4)


@pytest.mark.parametrize(("jitter_m", "written"), [(0.0, 3), (0.02, 2)])
def test_a_camera_that_moves_between_takes_is_refused(
    jitter_m: float, written: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first take says where it is; the third is another sequence of its activity, before which cameras are placed anew."""
    takes: list[Path] = []
    monkeypatch.setattr(filmed, "_calibration_takes", lambda *_: None)
    monkeypatch.setattr(filmed, "_write_take", lambda path, *_, **__: takes.append(path))
    monkeypatch.setattr(filmed.Session, "load", lambda _: pytest.fail("no take was refused"))
    rig = session(frames=30, camera={**PLAIN["camera"], "jitter_m": jitter_m})
    refused = pytest.raises(SceneError, match="the camera of a rig stays where it is")
    with refused if jitter_m else pytest.raises(pytest.fail.Exception, match="no take was refused"):
        record_films(rig, tmp_path / "recordings", tmp_path / "dataset")
    assert len(takes) == written


@pytest.mark.parametrize(("seen", "refused"), [(0, True), (4, False)])
def test_a_cap_under_the_roof_is_told_before_the_takes(
    seen: int, refused: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of twenty looks at five markers `seen` have three."""
    found = np.zeros((20, 5), bool)
    found[:seen, :3] = True
    monkeypatch.setattr(takes, "calibrate_head", lambda *_, **__: SimpleNamespace(duration_s=1.0))
    monkeypatch.setattr(takes, "_write", lambda *_, **__: [SimpleNamespace(object_seen=found)])
    actor: Any = SimpleNamespace(code="P1", stage=SimpleNamespace(car="hatchback"))
    told = pytest.raises(SceneError, match="does not see the cap of P1: the roof of hatchback") if refused else nullcontext()
    with told:
        takes.write_head_take(tmp_path / "head.mcap", VirtualRig(), actor, rng=np.random.default_rng(1))


@pytest.mark.slow
def test_images_are_the_generators_and_labels_those_of_a_suit(tmp_path: Path) -> None:
    """Without an error of the rig labels are true; with its errors they are off by centimetres, and images are the same."""
    off = {}
    films = _Films(session())
    generated = [[films.images(take)(k) for k in range(12)] for take in session().takes()]
    for name, rig in (("exact", VirtualRig().noise_free()), ("worn", VirtualRig())):
        made = session(rig, frames=12)
        record_films(made, tmp_path / name / "recordings", tmp_path / name / "dataset")
        dataset = open_dataset(tmp_path / name / "dataset")
        errors = []
        for number, take in enumerate(made.takes()):
            part = dataset.isel(frame=dataset["sequence"].values == number)
            assert set(part["action"].sel(person="driver").values.tolist()) == {take.activity}
            for k in range(part.sizes["frame"]):
                frame = generated[number][k]
                seen = part["depth"].values[k]
                assert np.nan_to_num(seen) == pytest.approx(np.nan_to_num(frame["depth"]), abs=6e-5)
                true = frame["joints_3d"][np.isfinite(frame["joints_3d"]).any(axis=(1, 2))][0]
                errors.append(np.linalg.norm(part["joints_3d"].sel(person="driver").values[k] - true, axis=-1))
        assert len(errors) >= 12
        assert set(dataset["subject"].sel(person="driver").values.tolist()) == {"P1"}
        off[name] = np.mean(errors)
    assert off["exact"] < 0.002
    assert 0.005 < off["worn"] < 0.04
    paths = sorted((tmp_path / "worn" / "recordings").glob("take-*.mcap"))
    stamp = paths[0].stat().st_mtime_ns
    whole = paths[1].read_bytes()
    paths[1].unlink()  # as if it had been interrupted
    record_films(made, tmp_path / "worn" / "recordings", tmp_path / "again")
    assert paths[0].stat().st_mtime_ns == stamp
    assert paths[1].read_bytes() == whole
