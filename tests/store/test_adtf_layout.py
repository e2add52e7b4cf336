"""ADTF files whose streams a layout describes: images and poses as they were, through `align` to joints; and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from adtf_takes import write_adtf_take
from adtfdat_file import IndexedFileWriter

from cabinpose.core.errors import ConfigError, RecordingError
from cabinpose.signals.recorded import Channels, Sample, SegmentPoses, ToFFrame
from cabinpose.store.convert.adtf_layout import AdtfLayout, LayoutStream
from cabinpose.store.convert.adtfdat import _read, read_adtfdat
from cabinpose.store.recording import Participant, Recording, RecordingWriter, Take

NAMES = ("Pelvis", "Head")


@pytest.fixture
def take(tmp_path: Path) -> Path:
    """Five frames, suit and optical samples, of which one was not seen."""
    rng = np.random.default_rng(3)
    path = tmp_path / "take.mcap"
    with RecordingWriter(path, Take(subjects=(Participant(code="S01", seat="driver"),))) as writer:
        for k in range(5):
            at = 1_000_000_000 + k * 10_000_000
            depth = rng.integers(0, 20_000, (3, 4)).astype(np.uint16) * np.uint16(k != 1)
            k_ = np.array([[5.0, 0, 1.5], [0, 5.5, 1.0], [0, 0, 1]])
            amplitude = rng.integers(0, 65_536, (3, 4)).astype(np.uint16)
            frame = ToFFrame(depth, 0.00025, amplitude, np.zeros((0, 0), np.uint8), k_, np.arange(5) / 10, np.arange(5) / 10)
            q = rng.normal(size=(3, 4))
            q /= np.linalg.norm(q, axis=1, keepdims=True)
            p = np.eye(3) + rng.normal(size=(3, 3)) / 100
            q[2], p[2] = (np.nan, np.nan) if k == 3 else (q[2], p[2])
            suit, head = SegmentPoses("S01", NAMES, p[:2], q[:2]), SegmentPoses("head", ("head",), p[2:], q[2:])
            for n, (source, message) in enumerate((("tof", frame), ("suit", suit), ("optical", head))):
                writer.write(source, Sample(k, at + n * 1000, 77 + at + n, b"", (message,)))
    return path


@pytest.fixture
def files(take: Path, tmp_path: Path) -> tuple[Path, Path]:
    write_adtf_take(take, tmp_path / "a.adtfdat", tmp_path / "layout.yaml")
    return tmp_path / "a.adtfdat", tmp_path / "layout.yaml"


def test_a_recording_comes_back(take: Path, files: tuple[Path, Path], tmp_path: Path, run: Callable[..., Any]) -> None:
    """The bytes are made apart from the layout's reader and read by the vendor's package."""
    pytest.importorskip("adtf_file")
    done = run("import", "adtfdat", files[0], "--layout", files[1], "--out", tmp_path / "b.mcap", "--subject", "S01")
    assert done.code == 0, done.err
    with Recording(take) as one, Recording(tmp_path / "b.mcap") as two:
        ours, theirs = (
            [
                (s, x.host_ns, x.device_ns, m)
                for s, x in each.samples()
                for m in x.messages
                if isinstance(m, (ToFFrame, SegmentPoses))
            ]
            for each in (one, two)
        )
        assert two.take.codes == ("S01",)
    assert len(ours) == len(theirs) == 15
    for (source, host, device, message), (source_, host_, device_, found) in zip(ours, theirs, strict=True):
        assert (source, device, type(message)) == (source_, device_, type(found))
        assert host - ours[0][1] == host_ - theirs[0][1]
        if isinstance(message, ToFFrame):
            for name in ("depth", "depth_unit_m", "amplitude", "camera_k", "camera_dist"):
                np.testing.assert_array_equal(getattr(found, name), getattr(message, name))
        else:
            assert isinstance(found, SegmentPoses)
            assert (message.subject, message.names) == (found.subject, found.names)
            np.testing.assert_allclose(found.position_m, message.position_m, atol=1e-6)
            np.testing.assert_allclose(found.orientation_wxyz, message.orientation_wxyz, atol=1e-6)


def stream(*fields: dict[str, Any], **more: Any) -> LayoutStream:
    return LayoutStream.model_validate({"stream": "s", "subject": "S01", "fields": fields, **more})


def test_units_and_types() -> None:
    """By hand: 2 m and 655.36 m of uint32 millimetres, a distance of -1; confidence beyond 255; a channel of two."""
    size = [1, 3]
    made = stream(
        {"field": "t", "type": "tUInt32", "gives": "time", "unit": "us"},
        {"field": "z", "type": "tInt32", "size": size, "gives": "depth", "unit": 0.01},
        {"field": "c", "type": "tInt16", "size": size, "gives": "confidence"},
        {"field": "v", "type": "tFloat32", "size": 2, "gives": "channel"},
        camera={"fx": 1, "fy": 1, "cx": 0, "cy": 0},
    )
    data = np.array([7], "<u4").tobytes() + np.array([200, 65536, -1], "<i4").tobytes()
    data += np.array([300, 255, -4], "<i2").tobytes() + np.array([0.5, -2], "<f4").tobytes()
    time_ns, (frame, channels) = made.messages(data)
    assert time_ns == 7000
    assert isinstance(frame, ToFFrame)
    assert isinstance(channels, Channels)
    np.testing.assert_allclose(frame.depth_m(), [[2.0, np.nan, np.nan]], rtol=1e-6)
    assert frame.confidence.tolist() == [[255, 255, 0]]
    assert (channels.names, channels.values.tolist()) == (("v[0]", "v[1]"), [0.5, -2.0])
    floats = stream({"field": "z", "type": "tFloat64", "size": size, "gives": "depth", "unit": "m"}, camera=vars(made.camera))
    (frame,) = floats.messages(np.array([1.5, np.nan, np.inf]).tobytes())[1]
    assert isinstance(frame, ToFFrame)
    np.testing.assert_allclose(frame.depth_m(), [[1.5, np.nan, np.nan]])


Q = {"field": "q", "type": "tFloat32", "size": 4, "gives": "orientation", "of": "Head"}
P = {"field": "p", "type": "tFloat32", "size": 3, "gives": "position", "of": "Head", "unit": "m"}
Z = {"field": "z", "type": "tUInt16", "size": [2, 2], "gives": "depth", "unit": "mm"}


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ([P | {"unit": "furlong"}], "needs a unit"),
        ([P | {"size": 4}], r"size is \[segments, 3\]"),
        ([P | {"of": ["Head", "Head"], "size": [2, 3]}], "each segment once"),
        ([P, P], "two fields 'p'"),
        ([P, P | {"field": "p2"}], "position of a segment twice"),
        ([Z], "a `camera`"),
        ([Z | {"size": 4}], r"\[rows, columns\]"),
        ([P | {"type": "tFloat128"}], "type: must be one of"),
        ([Q | {"unit": "m"}], "orientation has no unit"),
        ([P | {"what": 1}], "what: unknown key"),
        ([{"field": "t", "type": "tInt64", "size": 2, "gives": "time", "unit": "s"}], "one number"),
        ([{"field": "x", "type": "tInt64", "size": 0}], "a size of"),
    ],
)
def test_layouts_that_say_nothing_of_sense_are_refused(tmp_path: Path, fields: list[dict[str, Any]], said: str) -> None:
    (tmp_path / "l.yaml").write_text(yaml.safe_dump({"streams": [{"stream": "s", "subject": "S", "fields": fields}]}))
    with pytest.raises(ConfigError, match=said) as caught:
        AdtfLayout.load(tmp_path / "l.yaml")
    assert caught.value.hint


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ([Q], "a sample has 28 bytes, the layout says 16"),
        ([P, Q | {"field": "r"}], "quaternion of norm 2"),
        ([P | {"unit": 1e5}, Q], "more than 10 km"),
    ],
)
def test_samples_that_do_not_fit_are_refused(fields: list[dict[str, Any]], said: str) -> None:
    data = np.array([1, 2, 3, 0, 2, 0, 0] if "norm" in said else [1, 2, 3, 0, 1, 0, 0], "<f4").tobytes()
    with pytest.raises(RecordingError, match=said) as caught:
        stream(*fields).messages(data)
    assert caught.value.hint


def test_files_that_do_not_fit_are_refused(files: tuple[Path, Path], tmp_path: Path, run: Callable[..., Any]) -> None:
    pytest.importorskip("adtf_file")
    path, layout = files
    whole = yaml.safe_load(layout.read_text())

    def said(change: Callable[[dict[str, Any]], None]) -> str:
        data = yaml.safe_load(yaml.safe_dump(whole))
        change(data)
        (tmp_path / "other.yaml").write_text(yaml.safe_dump(data))
        out = tmp_path / "x.mcap"
        done = run("import", "adtfdat", path, "--layout", tmp_path / "other.yaml", "--out", out, "--subject", "S01")
        assert (done.code, out.exists(), "hint:" in done.err) == (2, False, True), done.err
        return str(done.err)

    assert "has no stream 'lidar'" in said(lambda data: data["streams"][1].update(stream="lidar"))
    assert "the layout says" in said(lambda data: data["streams"][0]["fields"].pop(1))
    assert "more than 10 km" in said(lambda data: data["streams"][2].update(byte_order="big"))
    done = run("import", "adtfdat", path, "--layout", tmp_path / "none.yaml", "--out", tmp_path / "x.mcap")
    assert (done.code, "hint:" in done.err) == (2, True)


def test_a_file_that_was_cut_is_refused(files: tuple[Path, Path], tmp_path: Path) -> None:
    """Its tables stand at its end, the last of them with 96 bytes that mean nothing."""
    pytest.importorskip("adtf_file")
    path, layout = files
    data, made = path.read_bytes(), AdtfLayout.load(layout)
    for left in (1000, len(data) // 2, len(data) - 600, len(data) - 120):
        (tmp_path / "cut.adtfdat").write_bytes(data[:left])
        with pytest.raises(RecordingError, match="no whole ADTF file") as caught:
            list(read_adtfdat(tmp_path / "cut.adtfdat", made))
        assert caught.value.hint


def test_a_file_that_lost_samples_is_refused(files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    adtf_file = pytest.importorskip("adtf_file")
    create = adtf_file.create_reader

    class Short:
        def __init__(self, name: str) -> None:
            self._reader, self._left = create(name), 9
            self.streams = self._reader.streams

        def get_next_item(self) -> Any:
            self._left -= 1
            return self._reader.get_next_item() if self._left else None

    monkeypatch.setattr(adtf_file, "create_reader", Short)
    with pytest.raises(RecordingError, match=r"'\w+' ends after \d of 5"):
        list(_read(files[0], AdtfLayout.load(files[1])))


def test_streams_beside_the_layout_are_read_as_before(files: tuple[Path, Path], tmp_path: Path) -> None:
    pytest.importorskip("adtf_file")
    with (tmp_path / "b.adtfdat").open("wb") as file:
        writer = IndexedFileWriter(file)
        other, mine = writer.stream("other", "adtf/anonymous", {}), writer.stream("vicon", "adtf/anonymous", {})
        writer.sample(other, 0, b"abc")
        writer.sample(mine, 5_000, np.array([0.5, 1.0], "<f4").tobytes())
        writer.close()
    layout = {"streams": [{"stream": "vicon", "fields": [{"field": "v", "type": "float32", "size": 2, "gives": "channel"}]}]}
    rows = [
        row for row in read_adtfdat(tmp_path / "b.adtfdat", AdtfLayout.model_validate(layout)) if isinstance(row[3], Channels)
    ]
    assert [(row[0], row[1], row[2], row[3].names) for row in rows] == [("vicon", 5000, 5000, ("v[0]", "v[1]"))]
