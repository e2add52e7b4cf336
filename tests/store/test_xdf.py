"""XDF: streams come as messages; clocks of senders are put right as `pyxdf` does it; damage is told."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from xdf_file import XdfStream, write_xdf

from cabinpose.core.errors import RecordingError
from cabinpose.signals.recorded import Channels, Facts
from cabinpose.store.convert.rows import Entry
from cabinpose.store.convert.xdf import read_xdf

pyxdf = pytest.importorskip("pyxdf")
FIRST = b"\x01\x00\x00\x00\x04\x28\x00\x00\x00"  # stream 1: 40 samples, their number in four bytes
START_NS = 1_700_000_000_000_000_000


def streams(count: int = 2500) -> list[XdfStream]:
    rng = np.random.default_rng(2)
    stamps = 1000.0 + np.arange(count) / 100
    numbers = XdfStream("force plate", "Force", 100.0, ("x", "y"), stamps, rng.normal(size=(count, 2)))
    text = [[f"marker {i} äöü"] for i in range(3)]
    return [numbers, XdfStream("events", "Markers", 0.0, ("label",), np.array([1001.0, 1002.5, 1003.0]), text)]


def of(source: str, rows: list[Entry]) -> list[Entry]:
    return [row for row in rows if row[0] == source]


def test_the_streams_come_by_time(tmp_path: Path) -> None:
    path = write_xdf(tmp_path / "take.xdf", streams(), begun_ns=START_NS)
    rows = list(read_xdf(path))
    assert [row[1] for row in rows] == sorted(row[1] for row in rows)
    _, host_ns, device_ns, about = of("force plate", rows)[0]
    assert (host_ns, device_ns) == (START_NS, None)
    assert about == Facts("stream", {"name": "force plate", "type": "Force", "rate_hz": 100.0, "channels": ["x", "y"]})
    numbers = of("force plate", rows)[1:]
    theirs, _ = pyxdf.load_xdf(str(path), synchronize_clocks=False, dejitter_timestamps=False)
    for (_, host_ns, device_ns, message), stamp, values in zip(
        numbers, theirs[0]["time_stamps"], theirs[0]["time_series"], strict=True
    ):
        assert abs(host_ns - START_NS - (stamp - 1000.0) * 1e9) < 2
        assert device_ns == round(stamp * 1e9)
        assert isinstance(message, Channels)
        assert message.names == ("x", "y")
        np.testing.assert_array_equal(message.values, values)
    first = of("events", rows)[1]
    assert first == ("events", START_NS + 1_000_000_000, 1_001_000_000_000, Facts("events", {"label": "marker 0 äöü"}))


def test_a_senders_clock_is_put_right_as_pyxdf_does(tmp_path: Path) -> None:
    """A sender 500 s behind, whose clock runs 100 ppm fast: the same events, seen by both, have the same host time."""
    true = 1000.0 + np.arange(3000) / 10
    sender = (true - 500.0) * 1.0001
    measured = np.arange(true[0], true[-1], 5.0)
    at = (measured - 500.0) * 1.0001
    plain = XdfStream("plain", "", 10.0, ("v",), true, np.zeros((3000, 1)))
    shifted = XdfStream("shifted", "", 10.0, ("v",), sender, np.zeros((3000, 1)), np.stack((at, measured - at), 1))
    path = write_xdf(tmp_path / "take.xdf", [plain, shifted], begun_ns=START_NS)
    rows = list(read_xdf(path))
    one, other = (np.array([row[1] for row in of(name, rows)[1:]]) for name in ("plain", "shifted"))
    np.testing.assert_allclose(other - one, 0, atol=2000)  # ns
    theirs, _ = pyxdf.load_xdf(str(path), synchronize_clocks=True, dejitter_timestamps=False)
    np.testing.assert_allclose((other - START_NS) / 1e9 + 1000.0, theirs[1]["time_stamps"], atol=1e-4)
    assert len(of("shifted", rows)[0][3].values["clock_offsets_s"]) == len(at)  # type: ignore[union-attr]


def test_the_same_name_twice_and_channels_without_labels(tmp_path: Path) -> None:
    stream = XdfStream("a", "", 0.0, ("", "x", "x"), np.array([1.0]), np.ones((1, 3)))
    rows = list(read_xdf(write_xdf(tmp_path / "take.xdf", [stream, stream])))
    assert [row[0] for row in rows] == ["a", "a", "a-2", "a-2"]
    message = rows[1][3]
    assert isinstance(message, Channels)
    assert (message.names, rows[1][1]) == (("channel0", "x", "x_2"), 0)


@pytest.mark.parametrize("data", [b"", b"XDF:", b"RIFF" * 100, b"XDF:\x01\x10\x02\x00\x01"])
def test_what_is_no_file_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "take.xdf"
    path.write_bytes(data)
    with pytest.raises(RecordingError):
        list(read_xdf(path))
    with pytest.raises(RecordingError, match="cannot read"):
        list(read_xdf(tmp_path / "nowhere.xdf"))


def test_a_file_that_was_cut_gives_what_it_holds(tmp_path: Path) -> None:
    path = write_xdf(tmp_path / "take.xdf", streams())
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.warns(UserWarning, match="was not closed"):
        list(read_xdf(path))
    assert 900 < len(of("force plate", list(read_xdf(path)))) < 2500


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda data: data[: len(data) // 2], "is damaged at byte|no end of the stream"),
        (lambda data: data.replace(FIRST, FIRST[:4] + b"\x07" + FIRST[5:]), "what could not be read is left out"),
        (lambda data: data.replace(b"<sample_count>3<", b"<sample_count>5<"), "gives 3 of the 5 samples of the stream 'events'"),
        (lambda data: data[:-51] + b"\x80" + data[-50:], "damaged at byte"),
    ],
)  # fmt: skip
def test_what_was_left_out_is_told(tmp_path: Path, damage: Callable[[bytes], bytes], told: str) -> None:
    path = write_xdf(tmp_path / "take.xdf", streams(40))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        list(read_xdf(path))
    sound = path.read_bytes()
    path.write_bytes(damage(sound))
    assert path.read_bytes() != sound
    with pytest.warns(UserWarning, match=told):
        list(read_xdf(path))


@pytest.mark.slow
def test_no_sample_is_lost_in_silence(tmp_path: Path) -> None:
    """Of files with any byte flipped: as many samples as were written, a warning, or an error."""
    path = write_xdf(tmp_path / "take.xdf", streams(10))
    sound = path.read_bytes()
    count = len(list(read_xdf(path)))
    rng = np.random.default_rng(1)
    for at in rng.choice(len(sound), 150, replace=False):
        path.write_bytes(sound[:at] + bytes([sound[at] ^ 1 << int(rng.integers(8))]) + sound[at + 1 :])
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always", UserWarning)
            try:
                found = len(list(read_xdf(path)))
            except RecordingError:
                continue
        assert found == count or told, at
