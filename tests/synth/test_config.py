"""Configurations: round trips, and every refusal with its reason."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import yaml

from cabinpose.core.errors import ConfigError
from cabinpose.scene.sensor import SENSORS
from cabinpose.synth.config import CabinScene, SynthConfig, room_preset
from cabinpose.synth.people import People
from cabinpose.synth.preflight import available_memory, preflight
from cabinpose.synth.streams import frame_rng

SET = {"fore_aft_m": 0.0, "height_m": 0.0, "torso_angle_rad": 0.4}
POSE = SET | {"vehicle_from_root": np.eye(4).tolist(), "angles_rad": {}, "tongue": {"at_m": [0.0, 0.0, 0.0], "how": "loose"}}


def refused(data: object) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        SynthConfig.parse(data)
    assert caught.value.hint
    return caught.value


@pytest.mark.parametrize("config", [SynthConfig(), room_preset()])
def test_yaml_round_trip(config: SynthConfig, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False), encoding="utf-8")
    assert SynthConfig.load(path) == config


def test_a_preset_or_a_person_that_is_added_joins_no_default_dataset() -> None:
    """The defaults are names, not whatever the tables hold: datasets of a configuration that says nothing stay what they are."""
    assert CabinScene().cars == ("city_car", "hatchback", "sedan", "coupe", "suv", "van", "shuttle")
    assert People().subjects == tuple(f"S{number:02d}" for number in range(1, 19))


def test_an_empty_file_means_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("", encoding="utf-8")
    assert SynthConfig.load(path) == SynthConfig()


def test_overrides_are_put_in_place_of_what_a_file_says(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("scene: {cars: [sedan], occupancy: {driver: 1.0}}\nlimits: {poses_per_person: 3}", encoding="utf-8")
    config = SynthConfig.load(path, ("scene.cars=[suv, van]", "scene.occupancy.driver=0.5", "camera.sensor=evk75123"))
    assert config.scene.kind == "cabin"
    assert config.scene.cars == ("suv", "van")
    assert config.scene.occupancy == {"driver": 0.5}
    assert config.camera.sensor == "evk75123"
    assert config.limits.poses_per_person == 3
    assert SynthConfig.load(None) == SynthConfig()
    alone = SynthConfig.load(None, ("scene.occupancy.rear_center=0",)).scene
    assert alone.kind == "cabin"
    assert alone.occupancy == SynthConfig().scene.model_dump()["occupancy"] | {"rear_center": 0.0}
    for others in ("scene.occupants.driver.belted=true", "scene.factorial.poses=1"):
        beside = SynthConfig.load(None, ("scene.occupancy.rear_left=1", others)).scene
        assert beside.kind == "cabin"
        assert beside.occupancy == {"rear_left": 1.0}
    path.write_text("scene: {occupants: {driver: {}}}", encoding="utf-8")
    assert SynthConfig.load(path, ("scene.occupancy.rear_left=1",)).scene.model_dump()["occupancy"] == {"rear_left": 1.0}
    assert SynthConfig.load(None, ("scene={kind: room, rooms: 3}", "camera.views={room: 1.0}")).scene.kind == "room"


@pytest.mark.parametrize("override", ["scene.cars", "=1", "scene..cars=1", "scene.cars=[suv", "version.of=2", "scene.cras=[suv]"])
def test_overrides_that_say_nothing_are_refused(override: str) -> None:
    with pytest.raises(ConfigError) as caught:
        SynthConfig.load(None, (override, "version=1", override))
    assert caught.value.hint


def test_paths_in_overrides_are_taken_from_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    config = SynthConfig.load(None, ("scene.cars=[mine.yaml]",))
    assert config.scene.kind == "cabin"
    assert config.scene.cars == (str((tmp_path / "mine.yaml").resolve()),)


def test_unknown_key_names_its_path_and_close_matches() -> None:
    error = refused({"camera": {"sensr": "kinect_v1"}})
    assert "camera.sensr" in str(error)
    assert "sensor" in str(error.hint)


@pytest.mark.parametrize(
    ("data", "word"),
    [
        ({"camera": {"sensor": "kinect_v9"}}, "kinect_v9"),
        ({"camera": {"sensor": {"name": "mine", "range_m": [2.0, 1.0]}}}, "camera.sensor"),
        ({"camera": {"sensor": "kinect_v1"}}, "physical"),
        ({"camera": {"views": {"driver": 0.0}}}, "view"),
        ({"camera": {"supersample": 9}}, "supersample"),
        ({"people": {"subjects": ["S99"]}}, "S99"),
        ({"people": {"subjects": []}}, "nobody"),
        ({"people": {"random": {"ranges": {"age": {"min": 0.9, "max": 0.1}}}}}, "above"),
        ({"people": {"random": {"ranges": {"age": {"min": 0.0, "max": 7.0}}}}}, "age"),
        ({"people": {"random": {"ranges": {"shoe": {"min": 0.0, "max": 1.0}}}}}, "shoe"),
        ({"scene": {"kind": "cabin", "cars": ["tank"]}}, "tank"),
        ({"scene": {"kind": "cabin", "occupancy": {"roof": 1.0}}}, "roof"),
        ({"scene": {"kind": "cabin", "occupancy": {"driver": 0.0}}}, "occupancy"),
        ({"scene": {"kind": "cabin", "motion": {"driver": {"moonwalk": 1.0}}}}, "moonwalk"),
        ({"scene": {"kind": "cabin", "seats": {"roof": SET}}}, "roof"),
        ({"scene": {"kind": "cabin", "seats": {"driver": SET}, "occupants": {"driver": {"pose": POSE}}}}, "scene.seats"),
        ({"scene": {"kind": "cabin", "occupants": {"driver": {"belted": True, "pose": POSE}}}}, "tongue"),
        *(
            ({"scene": {"kind": "cabin", "occupants": {"driver": {"pose": POSE | {"fingers": fingers}}}}}, "fingers of ")
            for fingers in ([[0.1] * 15] * 2, [[0.1] * 7] * 2, [[0.1] * 5], [[0.1] * 5, [0.1] * 6], [])
        ),
        ({"scene": {"kind": "cabin", "occupants": {"driver": {"belt": "under_arm", "pose": POSE}}}}, "tongue"),
        ({"scene": {"kind": "boat"}}, "boat"),
        ({"noise": {"kind": "perlin"}}, "perlin"),
        ({"limits": {"poses_per_person": 0}}, "poses_per_person"),
        ([1, 2], "mapping"),
    ],
)
def test_refusals(data: object, word: str) -> None:
    assert word in str(refused(data))


def test_profile_outside_the_range_of_motion() -> None:
    axes = {"lelbow.flexion": {"sigma_deg": 5.0, "min_deg": -90.0}}
    error = refused({"scene": {"kind": "cabin", "profile": {"kind": "gaussian", "axes": axes}}})
    assert "lelbow.flexion" in str(error)


def test_missing_and_broken_files(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot read"):
        SynthConfig.load(tmp_path / "nowhere.yaml")
    broken = tmp_path / "broken.yaml"
    broken.write_text("scene: [", encoding="utf-8")
    with pytest.raises(ConfigError, match="not YAML"):
        SynthConfig.load(broken)


def test_paths_are_taken_from_the_files_folder(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("scene: {kind: cabin, cars: [mine.yaml, sedan]}", encoding="utf-8")
    config = SynthConfig.load(path)
    assert config.scene.kind == "cabin"
    assert config.scene.cars == (str((tmp_path / "mine.yaml").resolve()), "sedan")


def test_a_preset_of_a_sensor_with_fields_changed() -> None:
    changed = {"preset": "evk75123", "integration_s": 3e-4, "second_integration_s": 1e-4, "fps": 15}
    config = SynthConfig.parse({"camera": {"sensor": changed}})
    base = SENSORS["evk75123"]
    assert config.camera.sensor_model == base.model_copy(update={k: v for k, v in changed.items() if k != "preset"})
    assert SynthConfig.parse(config.model_dump(mode="json")) == config
    lens = {"preset": "evk75123", "camera": {"width": 640, "height": 480, "fov_deg": 90}}
    assert SynthConfig.parse({"camera": {"sensor": lens}}).camera.sensor_model.field_radius_px is None
    assert SynthConfig.parse({"camera": {"sensor": lens | {"field_radius_px": 300}}}).camera.sensor_model.field_radius_px == 300
    with pytest.raises(ConfigError, match=r"^unknown field of a sensor 'integration_time_us'$") as caught:
        SynthConfig.parse({"camera": {"sensor": {"preset": "evk75123", "integration_time_us": 300}}})
    assert "integration_s" in str(caught.value.hint)
    with pytest.raises(ConfigError, match=r"^unknown sensor 'evk7'$"):
        SynthConfig.parse({"camera": {"sensor": {"preset": "evk7"}}})
    with pytest.raises(ConfigError, match=r"^camera\.sensor\.fps: must be greater than 0, not -1$"):
        SynthConfig.parse({"camera": {"sensor": {"preset": "evk75123", "fps": -1}}})


def test_people_move_while_a_frame_is_exposed_for_physical_noise_alone() -> None:
    scene = {"sequence": {"exposure_motion": True}}
    with pytest.raises(ConfigError, match="noise 'empirical' has no correlation samples"):
        SynthConfig.parse({"scene": scene, "noise": {"kind": "empirical"}})


def test_a_filter_over_time_needs_frames_that_follow_each_other() -> None:
    camera = {"sensor": {"preset": "evk75123", "temporal_median": 5}}
    with pytest.raises(ConfigError, match="takes the median of 5 frames, and each is a scene of its own"):
        SynthConfig.parse({"camera": camera})
    assert SynthConfig.parse({"camera": camera, "scene": {"sequence": {}}}).camera.sensor_model.temporal_median == 5


def test_an_own_sensor() -> None:
    own = SynthConfig().camera.sensor_model.model_copy(update={"name": "mine", "range_m": (0.2, 3.0)})
    config = SynthConfig.parse({"camera": {"sensor": own.model_dump(mode="json")}})
    assert config.camera.sensor_model == own
    assert SynthConfig.model_validate_json(config.model_dump_json()) == config


def test_frame_generators_differ_and_repeat() -> None:
    draws = {key: frame_rng(*key).random(4).tobytes() for key in [(0, 0), (0, 1), (1, 0), (1, 1)]}
    assert len(set(draws.values())) == 4
    assert draws[0, 1] == frame_rng(0, 1).random(4).tobytes()
    assert frame_rng(0, 2**64 - 1).random() != np.float64(0)


def test_images_that_need_more_memory_than_there_is_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the peaks in MB of `cabinpose synth --workers N scene.cars=[coupe]`, two frames a worker, on x86-64."""
    peaks = {(1000, 800, 4, 1): 878, (1000, 800, 4, 2): 1108, (2000, 1500, 1, 1): 611, (2000, 1500, 1, 2): 975,
             (2000, 1500, 2, 1): 1067, (2000, 1500, 2, 2): 1422, (2000, 1500, 2, 3): 1854}  # fmt: skip
    for (width, height, samples, workers), peak in peaks.items():
        focal = 0.5 * width
        camera = {"width": width, "height": height, "fx": focal, "fy": focal, "cx": width / 2, "cy": height / 2}
        sensor = {"preset": "evk75023", "camera": camera}
        config = SynthConfig.parse({"scene": {"cars": ["coupe"]}, "camera": {"sensor": sensor, "supersample": samples}})
        monkeypatch.setattr(import_module("cabinpose.synth.preflight"), "available_memory", lambda peak=peak: 1.15e6 * peak)
        preflight(config, frames=1, workers=workers)
        monkeypatch.setattr(import_module("cabinpose.synth.preflight"), "available_memory", lambda peak=peak: 0.9e6 * peak)
        with pytest.raises(ConfigError, match=f"{width}x{height} px, with {samples**2} samples in each and {workers}") as error:
            preflight(config, frames=1, workers=workers)
        assert all(word in (error.value.hint or "") for word in ("pixels", "camera.supersample", "--workers"))


def test_available_memory_is_what_the_kernel_says() -> None:
    psutil = pytest.importorskip("psutil")
    assert available_memory() == pytest.approx(psutil.virtual_memory().available, rel=0.1)
