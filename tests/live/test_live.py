"""Live: every frame as `predict` and `evaluate` see it, the newest one of a camera, and what goes wrong meanwhile."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import yaml

from cabinpose.app.cli import live as live_command
from cabinpose.app.live.choose import open_feed, parsed_settings
from cabinpose.app.live.feed import EveryFrame, LatestFrame, LiveFrame, batch_of
from cabinpose.app.live.run import Found, Latency, Live, _people
from cabinpose.app.models import open_detectors
from cabinpose.core.errors import CabinposeError, ConfigError, ModelError
from cabinpose.core.ports import FrameBatch, PoseBatch
from cabinpose.estimate import joint_predictor, make_smoother, packaged_models
from cabinpose.record.config import Rig, SourcePlan, parse_rig
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Counts, Sample, ToFFrame
from cabinpose.store import open_dataset
from cabinpose.store.predictions import empty_batch, read_predictions
from cabinpose.store.recording import Recording, RecordingWriter, Take, tof_frames

Run = Callable[..., Any]  # of a command, see the `run` fixture
FRAMES = 6


class Model:
    """A detector that notes what it sees, takes its time, and fails where it is told to."""

    name, persons, joints = "model", ("driver",), ("head",)

    def __init__(self, seconds: float = 0.0, fails_on: int = -1) -> None:
        self.seconds, self.fails_on, self.seen = seconds, fails_on, 0

    def predict(self, frames: FrameBatch) -> PoseBatch:
        time.sleep(self.seconds)
        self.seen += 1
        if self.seen - 1 == self.fails_on:
            raise ModelError("it cannot", hint="nothing to do")
        batch = empty_batch(len(frames["depth"]), 1, 1)
        batch.joints_2d[:] = np.nanmean(frames["depth"])
        return batch


class Camera:
    """A source of `count` frames, one each `every_s`; the depth of frame n is n + 1 steps. It hangs at the end, or ends."""

    def __init__(self, count: int, every_s: float) -> None:
        self.name, self.counts = "camera", Counts()
        self._count, self._every_s, self._next_s = count, every_s, 0.0

    def check(self) -> Sequence[str]:
        return ()

    def open(self) -> None:
        self._next_s = time.monotonic()

    def close(self) -> None:
        pass

    def read(self, timeout_s: float) -> Sequence[Sample]:
        wait = self._next_s - time.monotonic()
        time.sleep(max(min(wait, timeout_s), 0.0))
        if wait > timeout_s or self.counts.received == self._count:
            return ()
        self._next_s += self._every_s
        number = self.counts.received
        self.counts.received += 1
        return [Sample(number, HostClock().now_ns(), None, b"", (image(number),))]


def image(number: int) -> ToFFrame:
    return ToFFrame(
        np.full((4, 6), number + 1, np.uint16), 1e-4, np.zeros((0, 0), np.uint16), np.zeros((0, 0), np.uint8),
        np.diag([5.0, 5.0, 1.0]), np.zeros(5), np.zeros(5),
    )  # fmt: skip


def camera_rig(camera: Camera) -> Rig:
    base = parse_rig({"sources": {"camera": {"kind": "numbered"}}})
    plan = SourcePlan("camera", "numbered", lambda name, settings, clock: camera, base.sources[0].settings)
    return Rig(base.take, base.storage, (plan,), base.text)


# ------------------------------------------------------------------------------------------------ every frame


@pytest.mark.slow
def test_dataset_gives_what_predict_writes(run: Run, dataset_folder: Path, tmp_path: Path) -> None:
    live, predicted = tmp_path / "live.jsonl", tmp_path / "predicted.jsonl"
    assert run("live", "--source", dataset_folder, "--predictions", live).code == 0
    assert run("predict", dataset_folder, "--model", "in_car", "--out", predicted).code == 0
    assert live.read_bytes() == predicted.read_bytes()
    assert len(read_predictions(live).frame) == FRAMES


@pytest.mark.slow
@pytest.mark.parametrize("flags", [["--smooth", "one-euro"], ["--smooth", "fixed-lag", "--lag", "2"]])
def test_smoothed_joints_are_those_of_predict_however_late_they_come(run: Run, tmp_path: Path, flags: list[str]) -> None:
    two = ["scene.cars=[sedan]", "scene.sequence={frames: 4, rate_hz: 30}", "camera.sensor=pico_monstar_105/4"]
    assert run("synth", "--frames", "8", "--out", tmp_path / "data", *two).code == 0
    files = [tmp_path / f"{name}.jsonl" for name in ("live", "predict", "plain")]
    lines = run("live", tmp_path / "data", "--predictions", files[0], "--json", *flags).out.splitlines()
    assert run("predict", tmp_path / "data", "--model", "in_car", "--out", files[1], *flags).code == 0
    assert run("predict", tmp_path / "data", "--model", "in_car", "--out", files[2]).code == 0
    assert files[0].read_bytes() == files[1].read_bytes()
    smooth, plain = read_predictions(files[1]), read_predictions(files[2])
    assert [json.loads(line)["frame"] for line in lines[:-1]] == smooth.frame.tolist() == [*range(8)]
    assert smooth.model == f"in_car + {' '.join(flags[1::2])}"
    moved = np.abs(smooth.joints_3d - plain.joints_3d).max(axis=(1, 2, 3))
    assert moved[1] > 1e-4
    assert moved[5] > 1e-4
    if "one-euro" in flags:  # the first frame of each sequence has nothing before it
        assert moved[0] == moved[4] == 0.0
    stopped = run("live", tmp_path / "data", "--frames", "3", "--json", *flags).out.splitlines()
    assert [json.loads(line).get("frame") for line in stopped] == [0, 1, 2, None]


def test_a_frame_that_waits_for_later_ones_is_that_much_later() -> None:
    live = Live(_every_frame(6), [Model(seconds=0.02)], smoothers=[make_smoother("fixed-lag", 3)])
    numbers = [frame.number for frame, _ in live.run(lambda: live.frames < 6)]
    assert numbers == [*range(6)]
    latency = live.status(whole=True).latency
    assert latency is not None
    assert latency.p50 > 3 * 20


def test_a_frame_on_which_a_detector_fails_keeps_its_turn() -> None:
    live = Live(_every_frame(6), [Model(fails_on=2)], skip_errors=True, keep=True, smoothers=[make_smoother("fixed-lag", 3)])
    answers = [found[0] for _, found in live.run(lambda: live.frames < 6)]
    assert [bool(each.error) for each in answers] == [False, False, True, False, False, False]
    assert np.isnan(answers[2].poses.joints_2d).all()
    assert live.predictions(live.models[0]).frame.tolist() == [0, 1, 3, 4, 5]


def _every_frame(count: int) -> EveryFrame:
    return EveryFrame(Camera(count, 0.0), HostClock())


def test_dataset_gives_the_metrics_of_evaluate(run: Run, dataset_folder: Path) -> None:
    live = json.loads(run("live", "--source", dataset_folder, "--json").out.splitlines()[-1])["summary"]["metrics"][0]
    judged = run("evaluate", dataset_folder, "--model", "in_car", "--resamples", 0, "--json")
    assert live["values"] == json.loads(judged.out)["models"][0]["values"]
    assert live["values"]


def test_recording_gives_what_predict_finds(run: Run, dataset_folder: Path, recording: Path, tmp_path: Path) -> None:
    out, predicted = tmp_path / "live.jsonl", tmp_path / "predicted.jsonl"
    side = ["--drive-side", "left"]  # the frames are of several cars, and in one take the wheel is seen over time
    assert run("live", "--source", recording, "--predictions", out, *side).code == 0
    assert run("predict", dataset_folder, "--model", "in_car", "--out", predicted, *side).code == 0
    found, expected = read_predictions(out), read_predictions(predicted)
    for name in ("frame", "joints_2d", "joints_3d", "score", "presence"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


def test_recorded_frame_has_the_numbers_of_the_dataset(dataset_folder: Path, recording: Path) -> None:
    dataset = open_dataset(dataset_folder)
    with Recording(recording) as opened:
        batches = [batch_of(message) for _, message in tof_frames(opened, "camera")]
    assert len(batches) == FRAMES
    for row, batch in enumerate(batches):
        np.testing.assert_array_equal(batch["depth"][0], dataset["depth"][row].values)
        np.testing.assert_array_equal(batch["amplitude"][0], dataset["amplitude"][row].values)
        np.testing.assert_array_equal(batch["camera_k"][0], dataset["camera_k"].values[row])


def test_the_side_of_the_wheel_goes_with_each_frame(recording: Path, tmp_path: Path) -> None:
    """As the take of a recording or of a rig says it; `paf` and others tell seats by it."""
    path = tmp_path / "right.mcap"
    with Recording(recording) as once, RecordingWriter(path, Take(drive_side="right")) as writer:
        for _, sample in once.samples():
            writer.write("tof", sample)
    rig = {"take": {"drive_side": "right"}, "sources": {"tof": {"kind": "replay", "path": str(path), "speed": 0}}}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    for source, side in ((path, ["right"]), (tmp_path / "rig.yaml:tof", ["right"]), (recording, None)):
        feed = open_feed(str(source))
        feed.start()
        frame = next(frame for frame in feed.frames() if frame is not None)
        feed.stop()
        told = frame.batch.get("drive_side")
        assert (None if told is None else told.tolist()) == side


def test_the_camera_of_a_recording_is_found_among_its_sources(run: Run, recording: Path, tmp_path: Path) -> None:
    """One camera beside a suit is meant without being named; of two the user names one."""
    for cameras, code in ((("tof",), 0), (("left", "right"), 2)):
        path = tmp_path / f"{len(cameras)}.mcap"
        with Recording(recording) as once, RecordingWriter(path) as writer:
            for _, sample in once.samples():
                writer.write("suit", Sample(None, sample.host_ns, None, b"of a suit"))
                for camera in cameras:
                    writer.write(camera, sample)
        outcome = run("live", "--source", str(path), "--frames", "2", "--json")
        assert outcome.code == code, outcome.err
        if code:
            assert "has 2 ToF cameras" in outcome.err
            assert "2.mcap:NAME: left, right" in outcome.err
        else:
            assert json.loads(outcome.out.splitlines()[-1])["summary"]["frames"] == 2


def test_json_has_a_line_for_each_frame(run: Run, dataset_folder: Path) -> None:
    lines = [json.loads(line) for line in run("live", "--source", dataset_folder, "--frames", 2, "--json").out.splitlines()]
    assert [line.get("frame") for line in lines] == [0, 1, None]
    head = lines[0]["models"][0]["people"]["driver"]["head"]
    assert (len(head["px"]), len(head["m"])) == (2, 3)
    assert 0 <= head["presence"] <= 1
    assert lines[-1]["summary"]["frames"] == 2


def test_json_has_the_expected_error_where_it_is_known() -> None:
    ones = np.ones((1, 1, 2), np.float32)
    expected = np.array([[[0.0304, np.nan]]], np.float32)
    poses = PoseBatch(np.ones((1, 1, 2, 2), np.float32), np.ones((1, 1, 2, 3), np.float32), ones, ones, expected_error_m=expected)
    driver = _people(Found("m", poses, "", 1.0), ("driver",), ("head", "neck"))["driver"]
    assert driver["head"]["expected_error_m"] == 0.0304
    assert "expected_error_m" not in driver["neck"]


def test_frames_without_people_have_their_reason_wherever_answers_are(
    run: Run, dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = iter([("9.1 % of it is dark", "half a hand"), *[("", "")] * (FRAMES - 2), ("9.7 % of it is dark", "half a hand")] * 2)
    monkeypatch.setattr(joint_predictor, "unseen", lambda _, filled: [next(told) for _ in filled])
    monkeypatch.setattr(joint_predictor, "_MOST_CAMERAS", 0)  # no frame is tried turned, which asks again
    lines = [json.loads(line) for line in run("live", "--source", dataset_folder, "--json").out.splitlines()]
    frames = [line["models"][0] for line in lines[:-1]]
    assert [frame.get("reason", "") for frame in frames] == ["9.1 % of it is dark", *[""] * (FRAMES - 2), "9.7 % of it is dark"]
    assert [frame.get("remarks", []) for frame in frames] == [["half a hand"], *[[]] * (FRAMES - 2), ["half a hand"]]
    summary = lines[-1]["summary"]
    assert summary["unseen"] == {"in_car": {"9.1 % of it is dark": 2}}
    assert summary["remarks"] == {"in_car": ["half a hand"]}
    file = tmp_path / "p.jsonl"
    done = run("predict", dataset_folder, "--model", "in_car", "--out", file, "--json")
    assert json.loads(done.out)["unseen"] == {"9.1 % of it is dark": 2}
    assert json.loads(done.out)["remarks"] == ["half a hand"]
    assert f"2 of {FRAMES} frames: nobody can be seen: 9.1 % of it is dark" in done.err
    judged = run("evaluate", dataset_folder, "--predictions", file, "--resamples", 0)
    assert judged.out.count(f"2 of {FRAMES} frames: nobody can be seen: 9.1 % of it is dark") == 2  # above each table
    assert "half a hand" in judged.out
    told_json = json.loads(run("evaluate", dataset_folder, "--predictions", file, "--resamples", 0, "--json").out)["models"][0]
    assert told_json["caveats"]["unseen"] == {"9.1 % of it is dark": 2}
    assert told_json["caveats"]["answered"] == FRAMES


@pytest.mark.parametrize("device", [True, False])
def test_frames_of_a_recording_are_numbered_and_timed_as_predict_does(tmp_path: Path, device: bool) -> None:
    """By their order, and by the host's time where the camera had none; they arrive one by one, however many are read at once."""
    path, at = tmp_path / "take.mcap", [10**18 + n * 33_000_000 for n in range(20)]
    with RecordingWriter(path) as writer:
        for n, host_ns in enumerate(at):
            counted = (2 * n + 7, host_ns - 10**17) if device else (None, None)
            writer.write("camera", Sample(counted[0], host_ns, counted[1], b"", (image(n),)))
    model = Model(seconds=0.01)
    live = Live(open_feed(str(path)), [model], keep=True)
    frames = seen_by(live, lambda: False)
    taken = [stamp - 10**17 * device for stamp in at]
    assert [frame.taken_ns for frame in frames] == taken
    assert live.predictions(model).frame.tolist() == [*range(20)]
    assert [(int(f.batch["frame"][0]), int(f.batch["sync_ns"][0])) for f in frames] == [*enumerate(taken)]
    latency = live.status(whole=True).latency
    assert latency is not None
    assert latency.p95 < 5 * 10  # of one detection, and not of all those before it


# ------------------------------------------------------------------------------------------------ the newest frame


def seen_by(live: Live, until: Callable[[], bool]) -> list[LiveFrame]:
    live.feed.start()
    try:
        return [frame for frame, _ in live.run(lambda: not until())]
    finally:
        live.feed.stop()


def test_slow_detector_sees_the_newest_frames() -> None:
    camera = Camera(40, 0.01)
    live = Live(LatestFrame(camera_rig(camera)), [Model(seconds=0.055)])
    frames = seen_by(live, lambda: camera.counts.received == 40 and live.feed.status().passed_over + live.frames == 40)
    numbers = [frame.number for frame in frames]
    assert numbers == sorted(set(numbers))  # each once, in order
    assert numbers[-1] == 39  # the last one is never left out
    status = live.status(whole=True)
    assert status.frames + status.feed.passed_over == 40  # every frame is looked at or counted
    assert status.feed.passed_over >= 20


def test_a_camera_that_does_not_count_is_counted() -> None:
    camera = Camera(6, 0.01)
    counted, camera.read = camera.read, lambda wait: [replace(each, sequence=None) for each in counted(wait)]  # type: ignore[method-assign]
    live = Live(LatestFrame(camera_rig(camera)), [Model()])
    frames = seen_by(live, lambda: camera.counts.received == 6 and live.feed.status().passed_over + live.frames == 6)
    assert frames[-1].number == 5
    assert [frame.number for frame in frames] == sorted({frame.number for frame in frames})
    assert all(frame.batch["frame"].tolist() == [frame.number] for frame in frames)


def test_a_recording_played_as_a_camera_is_numbered_as_predict_does(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    with RecordingWriter(path) as writer:
        for n in range(20):
            writer.write("camera", Sample(2 * n + 7, 10**18 + n * 10_000_000, None, b"", (image(n),)))
    frames = seen_by(Live(open_feed(str(path), realtime=True), [Model(seconds=0.025)]), lambda: False)
    depths = [round(float(frame.batch["depth"][0, 0, 0]) * 1e4) - 1 for frame in frames]  # that of frame n is n + 1 steps
    assert [frame.number for frame in frames] == depths
    assert len(depths) < 20  # some were left out


def test_a_number_that_comes_twice_stands_once_in_the_predictions() -> None:
    camera = Camera(4, 0.0)
    counted, camera.read = camera.read, lambda wait: [replace(each, sequence=7) for each in counted(wait)]  # type: ignore[method-assign]
    model = Model(seconds=0.02)
    live = Live(LatestFrame(camera_rig(camera)), [model], keep=True)
    assert len(seen_by(live, lambda: live.frames == 2 or camera.counts.received == 4)) <= 4
    assert live.predictions(model).frame.tolist() == [7]


def test_a_dataset_plays_at_its_own_pace(dataset_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sequences of three and two frames at 20 Hz, all with the wheel on the right; what is set goes before."""
    stamps, of = [0, 50, 100, 0, 50], [0, 0, 0, 1, 1]
    told = {"sync_ns": np.array(stamps) * 10**6, "sequence": np.array(of), "drive_side": np.array(["right"] * 5, object)}
    dataset = xr.Dataset({name: ("frame", values) for name, values in told.items()})
    monkeypatch.setattr("cabinpose.app.live.choose.open_dataset", lambda _: dataset)
    for words, rate, loss in (([], 20.0, 0.0), (["faults.loss=0.1"], 20.0, 0.1), (["faults.rate_hz=7"], 7.0, 0.0)):
        feed = open_feed(str(dataset_folder), parsed_settings(words), realtime=True)
        assert isinstance(feed, LatestFrame)
        faults = feed._rig.sources[0].settings.faults  # type: ignore[attr-defined]
        assert (faults.rate_hz, faults.loss, feed.drive_side) == (rate, loss, "right")
    monkeypatch.undo()
    feed = open_feed(str(dataset_folder), realtime=True)  # of frames that do not follow each other
    assert isinstance(feed, LatestFrame)
    assert (feed._rig.sources[0].settings.faults.rate_hz, feed.drive_side) == (15.0, "")  # type: ignore[attr-defined]


@pytest.mark.parametrize(("fails_on", "kept"), [(2, [0, 1]), (0, None)])
def test_what_was_found_before_an_error_is_written(
    run: Run, dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails_on: int, kept: list[int] | None
) -> None:
    monkeypatch.setattr("cabinpose.app.models.open_detectors", lambda *_: [Model(fails_on=fails_on)])
    out = tmp_path / "found.jsonl"
    outcome = run("live", dataset_folder, "--predictions", out)
    assert outcome.code == 2
    assert "it cannot" in outcome.err
    assert (read_predictions(out).frame.tolist() if out.exists() else None) == kept
    assert (str(out) in outcome.err) is (kept is not None)


def test_frames_are_recorded_meanwhile(tmp_path: Path) -> None:
    camera, out = Camera(20, 0.01), tmp_path / "out.mcap"
    live = Live(LatestFrame(camera_rig(camera), out), [Model(seconds=0.05)])
    frames = seen_by(live, lambda: camera.counts.received == 20)
    assert len(frames) < 20
    with Recording(out) as recording:
        depths = [message.depth[0, 0] for _, message in tof_frames(recording, "camera")]
    assert depths == list(range(1, 21))  # all of them, not only those that the detector saw


def test_camera_that_falls_silent_is_told(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = Camera(5, 0.01)
    monkeypatch.setattr("cabinpose.app.models.open_detectors", lambda *_: [Model()])
    monkeypatch.setattr("cabinpose.app.live.choose.open_feed", lambda *_, **__: LatestFrame(camera_rig(camera)))
    outcome = run("live", "--source", "simulated", "--duration", 4)
    assert outcome.code == 1
    assert "simulated fell silent: no data for" in outcome.err
    assert " frames, " in outcome.out


def test_asking_waits_no_longer_than_it_must() -> None:
    camera = Camera(0, 1.0)
    live = Live(LatestFrame(camera_rig(camera)), [Model()])
    asked = threading.Event()
    threading.Timer(0.3, asked.set).start()
    assert seen_by(live, asked.is_set) == []


# ------------------------------------------------------------------------------------------------ what goes wrong


@pytest.mark.parametrize(
    ("kind", "camera", "package", "remedy"),
    [
        ("orbbec", "an Orbbec camera", "pyorbbecsdk", "pip install 'cabinpose[orbbec]'"),
        (
            "realsense",
            "a RealSense camera",
            "pyrealsense2",
            "pip install 'cabinpose[realsense]'; on Linux it needs libusb-1.0 too",
        ),
        ("oak", "an OAK camera", "depthai", "pip install 'cabinpose[oak]'"),
    ],
)
def test_an_sdk_that_is_not_installed_is_named_with_the_remedy(
    run: Run, monkeypatch: pytest.MonkeyPatch, kind: str, camera: str, package: str, remedy: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setenv("DEPTHAI_LEVEL", "off")  # a source sets it, for good
    monkeypatch.setattr("cabinpose.app.models.open_detectors", lambda *_: [Model()])
    outcome = run("live", "--source", kind)
    assert outcome.code == 2
    assert outcome.err == f"error: {camera} needs the Python package {package}, which is not installed\nhint: {remedy}\n"


def test_failing_detector_ends_the_run_or_is_counted(dataset_folder: Path) -> None:
    live = Live(open_feed(str(dataset_folder)), [Model(fails_on=2)])
    with pytest.raises(CabinposeError, match="it cannot"):
        list(live.run())
    model = Model(fails_on=2)
    live = Live(open_feed(str(dataset_folder)), [model], skip_errors=True, keep=True)
    errors = [found[0].error for _, found in live.run()]
    assert [bool(error) for error in errors] == [number == 2 for number in range(FRAMES)]
    assert live.status().failed == {"model": 1}
    (cause,) = live.status().causes["model"]
    assert "it cannot" in cause
    assert live.predictions(model).frame.tolist() == [0, 1, 3, 4, 5]


def test_failures_are_counted_by_their_cause(dataset_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Messages that differ in numbers are one; beyond twenty the others are."""
    live = Live(open_feed(str(dataset_folder)), [Model()], skip_errors=True)
    answers = live._answers["model"]
    for i in range(7):
        answers.count(f"frame {i}: no answer after {i / 2} s")
    answers.count("the server is gone")
    assert live.status().causes == {"model": {"frame 0: no answer after 0.0 s": 7, "the server is gone": 1}}
    assert live.status().failed == {"model": 8}
    live_command._print(live.status())
    assert (
        "model failed 7 times: frame 0: no answer after 0.0 s\nmodel failed 1 times: the server is gone"
        in capsys.readouterr().err
    )
    for letter in "abcdefghijklmnopqrstuvwxyz":
        answers.count(f"cause {letter}")
    assert live.status().causes["model"]["other causes"] == 8


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--source", "nix"), "unknown source 'nix'"),
        (("--source", "mvn"), "unknown source 'mvn'"),
        (("--source", "nix.mcap"), "there is no file nix.mcap"),
        (("--source", "."), "no dataset"),
        (("--source", "{dataset}", "--record", "x.mcap"), "is recorded already"),
        (("--source", "simulated", "--record", "x"), "no name of a recording"),
        (("--source", "simulated", "--record", "{dataset}/none/x.mcap"), "there is no folder"),
        (("--source", "{dataset}", "--set", "loop=true"), "loop cannot be set"),
        (("--source", "{recording}:other"), "unknown source of the recording 'other'"),
        (("--source", "{dataset}", "--duration", "nan"), "--duration nan is nothing to look at"),
        (("--source", "{dataset}", "--frames", "0"), "--frames 0 is nothing to look at"),
        (("--source", "{dataset}", "--model", "in_car", "in_car"), "each model is named once"),
        (("--source", "simulated", "--set", "dataset"), "sets nothing"),
        (("--source", "simulated"), "has no frames to see"),
        (("--source", "{dataset}", "--lag", "2"), "--lag says nothing without --smooth"),
        (("--source", "{dataset}", "--smooth", "kalman"), "unknown smoother 'kalman'"),
        (("--source", "{dataset}", "--smooth", "one-euro", "--lag", "2"), "one-euro answers at once"),
    ],
)
def test_bad_input(run: Run, dataset_folder: Path, recording: Path, arguments: Sequence[str], message: str) -> None:
    words = [word.format(dataset=dataset_folder, recording=recording) for word in arguments]
    outcome = run("live", *words)
    assert outcome.code == 2
    assert message in outcome.err
    assert outcome.err.count("hint:") == 1


def test_camera_of_a_rig_and_settings_over_it(dataset_folder: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        f"sources:\n  tof: {{kind: simulated, dataset: {dataset_folder}}}\n  suit: {{kind: mvn, port: 9763}}\n", encoding="utf-8"
    )
    feed = open_feed(str(rig), parsed_settings(["faults.rate_hz=100", "loop=false"]))
    assert feed.name == "tof"  # the only camera
    live = Live(feed, [Model()])
    assert 1 <= len(seen_by(live, lambda: False)) <= FRAMES
    with pytest.raises(ConfigError, match="unknown source 'other'"):
        open_feed(f"{rig}:other")
    with pytest.raises(ConfigError, match=r"suit of .* is no camera") as caught:
        open_feed(f"{rig}:suit")
    assert caught.value.hint == "its cameras: tof"


def test_a_setting_takes_the_place_of_one_of_the_rig_alone(dataset_folder: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yml"
    rig.write_text(f"sources:\n  tof: {{kind: simulated, dataset: {dataset_folder}, faults: {{rate_hz: 20, loss: 0.3}}}}\n")
    feed = open_feed(str(rig), parsed_settings(["faults.rate_hz=100"]), out=tmp_path / "out.mcap")
    assert isinstance(feed, LatestFrame)
    settings: Any = feed._rig.sources[0].settings
    assert (settings.faults.rate_hz, settings.faults.loss) == (100.0, 0.3)


def test_a_source_that_is_no_mapping_is_told(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text("sources: {tof: simulated}\n")
    with pytest.raises(ConfigError, match=r"sources\.tof"):
        open_feed(f"{rig}:tof")


def test_the_sample_is_a_dataset(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cabinpose.app.models.open_detectors", lambda *_: [Model()])
    done = run("live", "sample", "--frames", "2", "--json")
    assert [json.loads(line).get("frame") for line in done.out.splitlines()] == [0, 1, None]


def test_models_of_one_name_are_told_apart(tmp_path: Path) -> None:
    copy = tmp_path / "copy.onnx"
    copy.write_bytes(packaged_models()["in_car"].read_bytes())
    models = open_detectors(["in_car", str(copy), "room"])
    assert [model.name for model in models] == ["in_car (in_car)", f"in_car ({copy})", "room"]
    live = Live(_every_frame(1), models)
    assert [*live.status().models] == [model.name for model in models]


def test_frames_that_a_server_did_not_answer_are_among_the_failed() -> None:
    model = Model()
    model.failed = 2  # type: ignore[attr-defined]  # as a `RemotePredictor` counts them that goes on
    assert Live(_every_frame(1), [model]).status().failed == {"model": 2}


EXTENSION = """
from pathlib import Path
from typing import ClassVar
from cabinpose.record.sources.tof import SimulatedSettings, SimulatedSource
class Settings(SimulatedSettings):
    path: Path | None = None
class Source(SimulatedSource):
    Settings: ClassVar = Settings
class Player(Source):
    plays = ".acme"
"""


def test_cameras_and_files_of_other_packages(extension: Callable[..., None], dataset_folder: Path, tmp_path: Path) -> None:
    extension("acme", {"sources": {"acme": "Source", "acme-file": "Player"}}, EXTENSION)
    extension("broken", {"sources": {"lidar": "Source"}}, "import no_such_module")
    settings = {"dataset": str(dataset_folder), "faults": {"rate_hz": 100}, "loop": False}
    assert open_feed("acme", settings).name == "acme"
    (tmp_path / "a.acme").touch()
    feed = open_feed(str(tmp_path / "a.acme"), settings)
    assert feed.name == "acme-file"
    assert 1 <= len(seen_by(Live(feed, [Model()]), lambda: False)) <= FRAMES
    with pytest.warns(UserWarning, match="of broken .* it is left out"), pytest.raises(ConfigError) as caught:
        open_feed("nix")
    assert "acme, bta" in str(caught.value.hint)
    assert "acme-file" not in str(caught.value.hint)


@pytest.mark.parametrize("words", [["a=1", "a.b=2"], ["a.b=2", "a=1"], ["=1"], ["a=[1"]])
def test_settings_that_say_nothing(words: list[str]) -> None:
    with pytest.raises(ConfigError):
        parsed_settings(words)


def test_percentiles() -> None:
    values: list[Any] = list(range(1, 101))
    latency = Latency.of(values)
    assert latency is not None
    assert (latency.p50, latency.p95, latency.p99) == pytest.approx((50.5, 95.05, 99.01))
    assert Latency.of([]) is None


def test_paths_from_elsewhere_are_refused_where_a_folder_bounds_them(dataset_folder: Path, tmp_path: Path) -> None:
    root = dataset_folder.parent
    open_feed(str(dataset_folder), within=root)
    for source, settings in (
        (str(dataset_folder), {}),
        ("simulated", {"dataset": str(dataset_folder)}),
        ("simulated", {"dataset": f"{tmp_path}/../{root.name}"}),
        ("synth", {"scenes": "/etc/passwd"}),
    ):
        with pytest.raises(ConfigError, match="lies outside of"):
            open_feed(source, settings, realtime=True, within=tmp_path)
