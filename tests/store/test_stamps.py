"""Exports of recordings whose stamps are rounded, or begin anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cabinpose.core import ConfigError, MocapError, RecordingError
from cabinpose.signals import Markers, Sample, SegmentPoses
from cabinpose.store.convert import export_recording
from cabinpose.store.convert.table import period_ns
from cabinpose.store.recording import RecordingWriter

STARTED_NS = 1_700_000_000_000_000_000
FORMATS = ("bvh", "sto", "c3d", "trc")


def recorded(path: Path, device_ns: np.ndarray) -> Path:
    """A suit's two segments and an optical system's marker, all of one device's stamps, which arrive 10 ms apart."""
    turned = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    with RecordingWriter(path, started_ns=STARTED_NS) as writer:
        for i, stamp in enumerate(device_ns.tolist()):
            at = np.array([[0.0, 0.0, 1.0], [0.0, 0.001 * i, 1.1]])
            poses = SegmentPoses("S1", ("Pelvis", "L5"), at, turned)
            marker = Markers("S1", ("LASI",), at[:1], np.zeros(1))
            writer.write("suit", Sample(i, STARTED_NS + i * 10_000_000, stamp, b"", (poses,)))
            writer.write("optical", Sample(i, STARTED_NS + i * 10_000_000, stamp, b"", (marker,)))
    return path


def test_the_rate_of_stamps_in_whole_milliseconds_is_that_of_the_device(tmp_path: Path) -> None:
    """MVN's of 60 Hz are 16 and 17 ms apart."""
    take = recorded(tmp_path / "take.mcap", np.rint(np.arange(600) * 1000 / 60).astype(np.int64) * 1_000_000)
    export_recording(take, "sto", tmp_path / "a.sto", sources=("suit",))
    export_recording(take, "trc", tmp_path / "a.trc", sources=("optical",))
    export_recording(take, "bvh", tmp_path / "a.bvh", sources=("suit",))
    told = dict(line.split("=") for line in (tmp_path / "a.sto").read_text().splitlines() if line.count("=") == 1)
    assert float(told["DataRate"]) == pytest.approx(60, rel=1e-4)
    rate, _, frames = (tmp_path / "a.trc").read_text().splitlines()[2].split("\t")[:3]
    assert (float(rate), int(frames)) == (pytest.approx(60, rel=1e-4), 600)
    (frame_s,) = [line.split()[-1] for line in (tmp_path / "a.bvh").read_text().splitlines() if line.startswith("Frame Time")]
    assert float(frame_s) == pytest.approx(1 / 60, rel=1e-4)


def test_lost_samples_leave_the_rate_as_it_is() -> None:
    numbers = np.delete(np.arange(60 * 240), np.random.default_rng(1).integers(0, 60 * 240, 144))
    stamps = np.rint(numbers * 1000 / 240).astype(np.int64) * 1_000_000
    assert 1e9 / period_ns(stamps.tolist()) == pytest.approx(240, rel=5e-6)
    away = np.concatenate((stamps, stamps + 10**12))  # a gap that nobody counts
    assert 1e9 / period_ns(away.tolist()) == pytest.approx(240, rel=5e-6)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("second", [150, 300])  # samples: shorter than what the device gave before, and longer
def test_what_a_device_says_after_a_new_start_is_not_mixed_with_what_it_said_before(
    name: str, second: int, tmp_path: Path
) -> None:
    stamps = np.concatenate((np.arange(200), np.arange(second))) * 10_000_000
    take, source = recorded(tmp_path / "take.mcap", stamps), ("suit" if name in ("bvh", "sto") else "optical",)
    out = tmp_path / f"out.{name}"
    with pytest.raises((MocapError, RecordingError), match="the device was started anew within") as error:
        export_recording(take, name, out, sources=source)
    assert "--span" in str(error.value.hint)
    assert not out.exists()
    export_recording(take, name, out, sources=source, span_s=(0.0, 1.995))
    export_recording(take, name, out, sources=source, span_s=(1.995, 60.0), overwrite=True)
    with pytest.raises(ConfigError, match="5 to 2 s is no span"):
        export_recording(take, name, out, sources=source, span_s=(5.0, 2.0), overwrite=True)
