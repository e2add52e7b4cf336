"""ADTF files: what the vendor's reader decodes comes as channels; damage is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from adtfdat_file import IndexedFileWriter, write_imu

from cabinpose.core.errors import RecordingError
from cabinpose.signals.recorded import Channels, Facts
from cabinpose.store.convert.adtfdat import read_adtfdat

pytest.importorskip("adtf_file")


def test_described_samples_are_channels(tmp_path: Path) -> None:
    rows = list(read_adtfdat(write_imu(tmp_path / "a.adtfdat", [(0.5, -1.5, 7), (0.25, 2.0, 8)])))
    assert [row[0] for row in rows] == ["imu", "video", "imu", "imu"]
    assert [row[1:3] for row in rows] == [(5_000_000, None)] * 2 + [(5_000_000, 5_000_000), (15_000_000, 15_000_000)]
    about = rows[0][3]
    assert isinstance(about, Facts)
    assert (about.values["meta_type"], about.values["samples"]) == ("adtf/default", 2)
    for row, values in zip(rows[2:], ([0.5, -1.5, 7], [0.25, 2.0, 8]), strict=True):
        assert isinstance(row[3], Channels)
        assert row[3].names == ("acc[0]", "acc[1]", "n")
        np.testing.assert_array_equal(row[3].values, values)


def test_files_without_described_samples(tmp_path: Path) -> None:
    rows = list(read_adtfdat(write_imu(tmp_path / "a.adtfdat", [])))
    assert [(row[0], row[1], type(row[3])) for row in rows] == [("imu", 0, Facts), ("video", 0, Facts)]
    path = tmp_path / "empty.adtfdat"
    with path.open("wb") as file:
        IndexedFileWriter(file).close()
    assert list(read_adtfdat(path)) == []


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "take.adtfdat"
    with pytest.raises(RecordingError, match="does not exist"):
        list(read_adtfdat(path))
    path.write_bytes(b"IFHD" + bytes(100))
    with pytest.raises(RecordingError, match="no whole ADTF file"):
        list(read_adtfdat(path))
