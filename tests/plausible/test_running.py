"""Sources are judged while they are recorded: what they are doubted for is told once and kept with the take."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mvnx_file import moving_person
from suit_rows import FRAMES, RATE_HZ, Poses, markers, rows_of

from cabinpose.record import check, parse_rig
from cabinpose.scene.sensor import SENSORS
from cabinpose.signals import HostClock, LiveCheck, Sample, ToFFrame
from cabinpose.store.convert.rows import Row
from cabinpose.store.recording import Chunking, Recording, RecordingWriter, survey

sys.path.insert(0, str(Path(__file__).parents[1] / "align"))

import rig_takes

CAMERA = SENSORS["pico_monstar_105"].camera
SECONDS = 11  # two windows, and the rest
Rows = Callable[[Poses], list[Row]]


@pytest.fixture(scope="module")
def person() -> Poses:
    return moving_person(FRAMES, RATE_HZ)


def played(rows: list[Row], change: Callable[[int], int] = int, *, device: bool = True) -> list[Sample]:
    """Rows of a second as samples of sixteen: again and again, with the device's stamps changed, or without."""
    samples = [Sample(None, 0, None, b"", (rows[0][2],))]
    for i in range(SECONDS * FRAMES):
        at = round(i * 1e9 / RATE_HZ)
        samples.append(Sample(i, at, change(at) if device else None, b"", (rows[1 + i % FRAMES][2],)))
    return samples


def told(samples: list[Sample]) -> list[str]:
    looks = LiveCheck()
    return [words for sample in samples for words in looks.look(sample)] + looks.judged()


@pytest.mark.parametrize(
    ("right", "rows", "change", "said"),
    [
        (rows_of, lambda person: rows_of(person, norm=3.0), int, " of the quaternions have another length than 1"),
        (rows_of, lambda person: rows_of(person, order=(1, 2, 3, 0)), int, "S07: orientations contradict positions"),
        (rows_of, lambda person: rows_of(person, scale=1000.0), int, "mm were read as m"),
        (markers, lambda person: markers(person, 1000.0), int, "mm were read as m"),
        (rows_of, rows_of, lambda at: at // 1000, "1000 times too small"),
        (rows_of, rows_of, lambda at: 0, "have the time stamp of the one before"),
    ],
    ids=["norm", "xyzw", "mm", "markers-mm", "stamps-us", "stamps-equal"],
)
def test_a_suit_is_judged_while_it_runs(person: Poses, right: Rows, rows: Rows, change: Callable[[int], int], said: str) -> None:
    words = told(played(rows(person), change))
    assert sum(said in each for each in words) == 1, words
    assert told(played(right(person))) == []


def test_arrival_is_no_stamp(person: Poses) -> None:
    """What has no stamps of its device comes in bursts, and is judged by its places alone."""
    bursts = [replace(each, host_ns=each.host_ns // 10**9 * 10**9) for each in played(rows_of(person), device=False)]
    assert told(bursts) == []
    assert len(told([replace(each, device_ns=each.host_ns) for each in bursts])) > 0


def frame_of(k: np.ndarray, dist: Any = CAMERA.dist, count: int = 1) -> list[Sample]:
    depth = np.full((CAMERA.height, CAMERA.width), 4000, np.uint16)
    none = np.zeros((0, 0), np.uint8)
    frame = ToFFrame(depth, 0.00025, none.astype(np.uint16), none, k, np.array(dist, float), np.array(dist, float))
    return [Sample(i, i * 50_000_000, i * 50_000_000, b"", (frame,)) for i in range(count)]


WRONG: dict[str, tuple[list[Sample], str]] = {
    "transposed": (frame_of(CAMERA.k.T), "it is transposed"),
    "half the resolution": (frame_of(np.diag((0.5, 0.5, 1.0)) @ CAMERA.k, count=3), "an image of about 176x144 pixels"),
    "distortion is NaN": (frame_of(CAMERA.k, [np.nan] * 5), "not finite"),
    "folds before its depths end": (frame_of(CAMERA.k, [-0.18, 0, 0, 0, 0]), "of the depths lie where the lens sees nothing"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_camera_is_judged_at_its_first_frame(case: str) -> None:
    samples, said = WRONG[case]
    (words,) = told(samples)
    assert words.startswith("the camera that it states: ")
    assert said in words
    assert told(frame_of(CAMERA.k, count=3)) == []


def written(path: Path, samples: list[Sample]) -> Path:
    with RecordingWriter(path, chunking=Chunking(sync_s=0)) as writer:
        for sample in samples:
            writer.write("tof", sample)
    return path


def rig_of(path: Path, recording: Path) -> Path:
    path.write_text(json.dumps({"sources": {"tof": {"kind": "replay", "path": str(recording), "speed": 0}}}))
    return path


def test_doubts_are_warned_of_kept_with_the_take_and_shown_by_info(run: Callable[..., Any], tmp_path: Path) -> None:
    pytest.importorskip("rich")
    for name, samples in {"right": frame_of(CAMERA.k, count=3), "wrong": frame_of(CAMERA.k.T, count=3)}.items():
        rig = rig_of(tmp_path / f"{name}.yaml", written(tmp_path / f"{name}.mcap", samples))
        made = run("record", rig, "--out", tmp_path / f"{name}_again.mcap", "--json")
        assert made.code == 0
        shown = run("info", tmp_path / f"{name}_again.mcap")
        doubts = survey(tmp_path / f"{name}_again.mcap").sources[0].doubts
        if name == "right":
            assert (made.err, shown.err, doubts) == ("", "", ())
            continue
        assert made.err.count("warning: tof: the camera that it states: the matrix' last row is 175.5 143 1") == 1
        assert json.loads(made.out)["warnings"][0].startswith("tof: the camera that it states: ")
        assert shown.err.count("it is transposed") == 1
        assert "as was said while it was recorded" in shown.err
        with Recording(tmp_path / "wrong_again.mcap") as recording:
            frames = [s for _, s in recording.samples() if isinstance(s.messages[0], ToFFrame)]
        assert len(frames) == 3  # as they came


def test_the_check_before_a_take_says_what_a_camera_states(tmp_path: Path) -> None:
    for samples, said in ((frame_of(CAMERA.k), ""), (frame_of(CAMERA.k.T), "it is transposed")):
        path = written(tmp_path / f"{len(said)}.mcap", samples)
        rig = parse_rig({"sources": {"tof": {"kind": "replay", "path": str(path), "speed": 0}}})
        problems = check(rig, None, HostClock())[-1].problems
        assert [said in each for each in problems] == ([True] if said else [])


def test_nothing_is_said_of_a_take_of_the_virtual_rig(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    rig_takes.Made(seconds=6).write(path)
    looks: dict[str, LiveCheck] = {}
    with Recording(path) as recording:
        samples = list(recording.samples())
    words = [each for source, sample in samples for each in looks.setdefault(source, LiveCheck()).look(sample)]
    assert words + [each for look in looks.values() for each in look.judged()] == []
