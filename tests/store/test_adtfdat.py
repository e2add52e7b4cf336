"""ADTF files: the vendor's own reader accepts and decodes what is written here, and every message comes back."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from cabinpose.core.errors import RecordingError
from cabinpose.core.ports import Sample
from cabinpose.core.recorded import (
    Channels,
    Facts,
    JointAngles,
    Markers,
    Message,
    SegmentKinematics,
    SegmentPoses,
    SensorReadings,
    ToFFrame,
)
from cabinpose.store.convert.adtfdat import read_adtfdat, write_adtfdat
from cabinpose.store.convert.adtfdat_write import IndexedFileWriter

adtf_file = pytest.importorskip("adtf_file")
BEGIN = 1_700_000_000_123_456_789
NONE3, NONE4 = np.zeros((0, 3)), np.zeros((0, 4))


def messages(rng: np.random.Generator, index: int) -> tuple[Message, ...]:
    two = rng.normal(size=(2, 3))
    two[0, 0] = np.nan
    loose = rng.normal(size=(index % 3, 3))
    image = rng.integers(0, 65536, (3, 4), dtype=np.uint16)
    return (
        SegmentPoses("S01", ('Pelvis "<&>', "Füße"), two, rng.normal(size=(2, 4))),
        SegmentKinematics("S01", ("a", "b"), two, two + 1, NONE3, NONE3),
        SensorReadings("S01", ("left",), rng.normal(size=(1, 4)), two[:1], NONE3, two[1:]),
        JointAngles("S01", ("jKnee",), two[:1]),
        Markers("S01", ("LASI", "RASI"), two, np.array([np.nan, 0.001])),
        Markers("", tuple(str(i) for i in range(len(loose))), loose, np.full(len(loose), np.nan)),
        Channels(("force",), rng.normal(size=1)),
        Facts("weather", {"text": "ü", "n": [1, 2.5, None]}),
        ToFFrame(image, 0.001, image + 1, np.zeros((0, 0), np.uint8), np.eye(3) * index, np.arange(5.0), np.zeros(5)),
    )


def samples() -> Iterator[tuple[str, Sample]]:
    rng = np.random.default_rng(0)
    for i in range(6):
        yield "suit", Sample(i, BEGIN + i * 10_000_001, None if i == 3 else i * 77, b"", messages(rng, i))


def same(one: Message, other: Message) -> None:
    assert type(one) is type(other)
    for each in fields(one):
        a, b = getattr(one, each.name), getattr(other, each.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b)
            assert (a.shape, a.dtype) == (b.shape, b.dtype)
        else:
            assert a == b


def test_every_message_comes_back(tmp_path: Path) -> None:
    path = write_adtfdat(tmp_path / "take.adtfdat", samples())
    rows = list(read_adtfdat(path))
    about = [row for row in rows if isinstance(row[4], Facts) and row[4].about == "adtf stream"]
    assert len(about) == 9
    found = rows[len(about) :]
    expected = [(s.host_ns, s.device_ns, s.sequence, m) for _, s in samples() for m in s.messages]
    assert len(found) == len(expected) == 54
    for (source, *stamps, message), (*true_stamps, true) in zip(found, expected, strict=True):
        assert (source, stamps) == ("suit", true_stamps)
        same(message, true)
    with pytest.raises(RecordingError, match="exists"):
        write_adtfdat(path, samples())


def test_the_vendors_reader_decodes_the_structures(tmp_path: Path) -> None:
    reader = adtf_file.create_reader(str(write_adtfdat(tmp_path / "take.adtfdat", samples())))
    assert reader.description == "cabinpose recording"
    streams = {stream.name: stream for stream in reader.streams}
    poses = streams["suit.poses"]
    assert (poses.item_count, poses.initial_type.meta_type) == (6, "adtf/default")
    assert poses.timestamp_of_last_item.total_seconds() == pytest.approx(0.050, abs=1e-5)
    decoder = adtf_file.SampleDecoder(poses.initial_type)
    truth = iter(samples())
    while (item := reader.get_next_item()) is not None:
        if item.stream_id == poses.stream_id:
            decoded = decoder.decode(item.sample)
            _, sample = next(truth)
            assert decoded.host_ns == sample.host_ns
            assert decoded.sequence == sample.sequence
            np.testing.assert_array_equal(decoded.position_m, sample.messages[0].position_m.ravel())  # type: ignore[union-attr]
    assert next(truth, None) is None


def test_the_vendors_reader_seeks(tmp_path: Path) -> None:
    path = tmp_path / "many.adtfdat"
    with path.open("wb") as file:
        writer = IndexedFileWriter(file)
        ids = [writer.stream(f"s{i}", "adtf/anonymous", {}) for i in range(3)]
        for i in range(300):
            writer.sample(ids[i % 3], i * 1_000_000, struct.pack("<I", i) + bytes(i % 17))
        writer.close()
    reader = adtf_file.create_seekablereader(str(path))
    for stream_id, index in ((1, 0), (2, 50), (3, 99)):
        reader.seek_to(reader.get_item_index_for_stream_item_index(stream_id, index))
        item = reader.get_next_item()
        assert item.stream_id == stream_id
        assert bytes(item.sample.buffer)[:4] == struct.pack("<I", 3 * index + stream_id - 1)


def test_files_of_others_give_their_numbers(tmp_path: Path) -> None:
    element = '<element alignment="1" arraysize="{}" byteorder="LE" bytepos="{}" name="{}" type="{}"/>'
    ddl = (
        '<?xml version="1.0" encoding="iso-8859-1" standalone="no"?><adtf:ddl xmlns:adtf="adtf"><header>'
        "<language_version>4.00</language_version><author>x</author><date_creation>20200101</date_creation>"
        "<date_change>20200101</date_change><description>d</description></header><units/><datatypes>"
        '<datatype description="predefined" name="tFloat32" size="32"/>'
        '<datatype description="predefined" name="tInt16" size="16"/>'
        f'</datatypes><enums/><structs><struct alignment="1" name="Imu" version="1">{element.format(2, 0, "acc", "tFloat32")}'
        f"{element.format(1, 8, 'n', 'tInt16')}</struct></structs><streams/></adtf:ddl>"
    )
    path = tmp_path / "other.adtfdat"
    with path.open("wb") as file:
        writer = IndexedFileWriter(file)
        properties = {
            "md_struct": ("cString", "Imu"),
            "md_definitions": ("cString", ddl),
            "md_data_serialized": ("tBool", "false"),
        }
        imu, video = writer.stream("imu", "adtf/default", properties), writer.stream("video", "adtf/anonymous", {})
        writer.sample(imu, 5_000_000, struct.pack("<2fh", 0.5, -1.5, 7))
        writer.sample(video, 6_000_000, b"not described")
        writer.close()
    rows = list(read_adtfdat(path))
    assert [row[0] for row in rows] == ["imu", "video", "imu"]
    _, host_ns, device_ns, sequence, message = rows[-1]
    assert (host_ns, device_ns, sequence) == (5_000_000, 5_000_000, None)
    assert isinstance(message, Channels)
    assert message.names == ("acc[0]", "acc[1]", "n")
    np.testing.assert_array_equal(message.values, [0.5, -1.5, 7])


def test_too_many_streams_and_damaged_files(tmp_path: Path) -> None:
    def many() -> Iterator[tuple[str, Sample]]:
        for i in range(600):
            yield "a", Sample(i, i, None, b"", (Channels((f"c{i}",), np.zeros(1)),))

    path = tmp_path / "take.adtfdat"
    with pytest.raises(RecordingError, match="cannot hold stream 512"):
        write_adtfdat(path, many())
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(RecordingError, match="does not exist"):
        list(read_adtfdat(path))
    path.write_bytes(b"IFHD" + bytes(100))
    with pytest.raises(RecordingError, match="no whole ADTF file"):
        list(read_adtfdat(path))
    path.unlink()
    assert list(read_adtfdat(write_adtfdat(path, ()))) == []
