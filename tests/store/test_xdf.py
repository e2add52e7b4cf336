"""XDF: what is written is read by pyxdf, an independent reader; clocks of senders are put right; damage is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cabinpose.core.errors import RecordingError
from cabinpose.core.recorded import Channels, Facts
from cabinpose.store.convert.rows import Row
from cabinpose.store.convert.xdf import XdfStream, read_xdf, stream_of_rows, write_xdf

pyxdf = pytest.importorskip("pyxdf")
START_NS = 1_700_000_000_000_000_000


def streams(count: int = 2500) -> list[XdfStream]:
    rng = np.random.default_rng(2)
    stamps = 1000.0 + np.arange(count) / 100
    numbers = XdfStream("force plate", "Force", 100.0, ("x", "y"), stamps, rng.normal(size=(count, 2)), start_ns=START_NS)
    text = [[f"marker {i} äöü"] for i in range(3)]
    return [numbers, XdfStream("events", "Markers", 0.0, ("label",), np.array([1001.0, 1002.5, 1003.0]), text, start_ns=START_NS)]


def test_pyxdf_reads_what_is_written(tmp_path: Path) -> None:
    path = write_xdf(tmp_path / "take.xdf", streams())
    found, header = pyxdf.load_xdf(str(path), synchronize_clocks=False, dejitter_timestamps=False)
    assert header["info"]["version"] == ["1.0"]
    numbers, text = streams()
    np.testing.assert_array_equal(found[0]["time_series"], numbers.values)
    np.testing.assert_array_equal(found[0]["time_stamps"], numbers.stamps_s)
    assert found[0]["footer"]["info"]["sample_count"] == ["2500"]
    assert found[1]["time_series"] == text.values
    assert found[1]["info"]["type"] == ["Markers"]
    with pytest.raises(RecordingError, match="exists"):
        write_xdf(path, streams())


def test_the_streams_come_back(tmp_path: Path) -> None:
    found = read_xdf(write_xdf(tmp_path / "take.xdf", streams()))
    assert list(found) == ["force plate", "events"]
    rows = list(found["force plate"].rows())
    assert len(rows) == 2501
    host_ns, device_ns, message = rows[1]
    assert (host_ns, device_ns) == (START_NS, 1_000_000_000_000)
    assert isinstance(message, Channels)
    assert message.names == ("x", "y")
    np.testing.assert_array_equal(message.values, streams()[0].values[0])
    assert isinstance(rows[0][2], Facts)
    assert rows[0][2].values["rate_hz"] == 100.0
    _, first, *_ = found["events"].rows()
    assert first == (START_NS + 1_000_000_000, 1_001_000_000_000, Facts("events", {"label": "marker 0 äöü"}))
    again = stream_of_rows("force plate", rows, type_="Force", rate_hz=100.0)
    np.testing.assert_array_equal(again.values, streams()[0].values)
    np.testing.assert_allclose(again.stamps_s, streams()[0].stamps_s, atol=1e-9)
    with pytest.raises(RecordingError, match="no channels"):
        stream_of_rows("events", list(found["events"].rows()))
    changed: list[Row] = [(0, 0, Channels(("a",), np.zeros(1))), (1, 1, Channels(("b",), np.zeros(1)))]
    with pytest.raises(RecordingError, match="change"):
        stream_of_rows("x", changed)


def test_a_senders_clock_is_put_right_as_pyxdf_does(tmp_path: Path) -> None:
    """A sender 500 s behind, whose clock runs 100 ppm fast: the same events, seen by both, have the same host time."""
    true = 1000.0 + np.arange(3000) / 10
    sender = (true - 500.0) * 1.0001
    measured = np.arange(true[0], true[-1], 5.0)
    at = (measured - 500.0) * 1.0001
    plain = XdfStream("plain", "", 10.0, ("v",), true, np.zeros((3000, 1)), start_ns=START_NS)
    shifted = XdfStream("shifted", "", 10.0, ("v",), sender, np.zeros((3000, 1)), np.stack((at, measured - at), 1), START_NS)
    path = write_xdf(tmp_path / "take.xdf", [plain, shifted])
    found = read_xdf(path)
    one, other = (np.array([host for host, _, m in found[n].rows() if isinstance(m, Channels)]) for n in ("plain", "shifted"))
    np.testing.assert_allclose(other - one, 0, atol=2000)  # ns
    theirs, _ = pyxdf.load_xdf(str(path), synchronize_clocks=True, dejitter_timestamps=False)
    np.testing.assert_allclose(found["shifted"].recorder_s(sender), theirs[1]["time_stamps"], atol=1e-4)


def test_the_same_name_twice_and_channels_without_labels(tmp_path: Path) -> None:
    stream = XdfStream("a", "", 0.0, ("", "x", "x"), np.array([1.0]), np.ones((1, 3)))
    found = read_xdf(write_xdf(tmp_path / "take.xdf", [stream, stream]))
    assert list(found) == ["a", "a-2"]
    assert found["a"].labels == ("channel0", "x", "x_2")
    assert not found["a"].start_ns


@pytest.mark.parametrize("data", [b"", b"XDF:", b"RIFF" * 100, b"XDF:\x01\x10\x02\x00\x01"])
def test_what_is_no_file_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "take.xdf"
    path.write_bytes(data)
    with pytest.raises(RecordingError):
        read_xdf(path)
    with pytest.raises(RecordingError, match="cannot read"):
        read_xdf(tmp_path / "nowhere.xdf")


def test_a_file_that_was_cut_gives_what_it_holds(tmp_path: Path) -> None:
    path = write_xdf(tmp_path / "take.xdf", streams())
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    found: dict[str, Any] = read_xdf(path)
    assert 900 < len(found["force plate"].stamps_s) < 2500
