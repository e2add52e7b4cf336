"""Azure Kinect recordings: the real file against its own bytes, the factory's lens against OpenCV, files made here."""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cabinpose.core.errors import RecordingError
from cabinpose.signals.recorded import Facts, SensorReadings, ToFFrame
from cabinpose.store.convert.azure_mkv import DEPTH_MODES, AzureFile, rational_lens, read_azure_mkv

av = pytest.importorskip("av")
KINECT = "tof/azure_kinect.mkv"
# A factory calibration of the shape that the device has; the numbers are near those of any.
PARAMETERS = [0.513, 0.517, 0.4928, 0.4929, 0.548, -0.021, -0.0027, 0.8897, 0.0861, -0.0139, 0, 0, -7.2e-5, 2.1e-5]


def calibration(parameters: list[float] = PARAMETERS, model: str = "BrownConrady") -> dict[str, Any]:
    intrinsics = {"ModelParameters": parameters, "ModelType": f"CALIBRATION_LensDistortionModel{model}"}
    return {"CalibrationInformation": {"Cameras": [{"Location": "CALIBRATION_CameraLocationD0", "Intrinsics": intrinsics}]}}


@pytest.mark.real_data
def test_the_real_file(real_data: Callable[[str], Path]) -> None:
    path = real_data(KINECT)
    rows = list(read_azure_mkv(path))
    assert [type(m) for _, _, m in rows] == [Facts, SensorReadings, ToFFrame]
    facts, inertial, frame = (m for _, _, m in rows)
    assert isinstance(facts, Facts)
    assert isinstance(inertial, SensorReadings)
    assert isinstance(frame, ToFFrame)
    assert facts.values["serial"] == "001514394512"
    assert facts.values["depth_mode"] == "NFOV_UNBINNED"
    assert json.dumps(facts.values)
    assert np.linalg.norm(inertial.acceleration) == pytest.approx(9.81, abs=0.1)  # at rest
    assert np.linalg.norm(inertial.angular_velocity) < 0.02
    assert frame.depth.shape == frame.amplitude.shape == (576, 640)
    valid = frame.depth > 0
    assert 0.6 < valid.mean() < 0.9
    assert 1.0 < np.median(frame.depth[valid]) * frame.depth_unit_m < 3.5  # a room
    assert rows[-1][1] == 336_277_000 + 463_945_000  # start offset and time stamp, from the file's tags
    with av.open(str(path)) as container:
        (data,) = (bytes(p) for p in container.demux(container.streams[1]) if p.size)
    for v, u in ((200, 300), (300, 320), (575, 639)):
        high, low = data[2 * (640 * v + u) : 2 * (640 * v + u) + 2]
        assert frame.depth[v, u] == 256 * high + low


@pytest.mark.real_data
def test_the_fitted_camera_meets_the_factorys_where_light_reaches(real_data: Callable[[str], Path]) -> None:
    """Points by five coefficients against points by OpenCV's eight: below a tenth of a millimetre a metre."""
    with AzureFile(real_data(KINECT)) as file:
        rows, lens, fit = list(file.rows()), file.lens, file.fit
    frame = rows[-1][2]
    assert isinstance(frame, ToFFrame)
    v, u = (places[::50] for places in np.nonzero(frame.depth))
    k = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    k1, k2, k3, k4, k5, k6 = lens.radial
    uv = np.stack((u, v), axis=-1).astype(np.float64)[:, None]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    theirs = cv2.undistortPoints(uv, k, np.array([k1, k2, lens.p1, lens.p2, k3, k4, k5, k6]), criteria=criteria)[:, 0]
    camera = fit.camera
    ours = camera.undistort((uv[:, 0] - (camera.cx, camera.cy)) / (camera.fx, camera.fy))
    error = np.linalg.norm(ours - theirs, axis=-1)
    assert np.sqrt(np.mean(error**2)) < 1e-4
    assert error.max() < 1.5e-3  # in a corner that the light hardly reaches
    assert fit.rms_px < 0.03
    assert fit.max_px < 0.2
    plain = np.linalg.norm((uv[:, 0] - (lens.cx, lens.cy)) / (lens.fx, lens.fy) - theirs, axis=-1)
    assert np.sqrt(np.mean(plain**2)) > 100 * np.sqrt(np.mean(error**2))  # without the distortion


@pytest.mark.parametrize("mode", DEPTH_MODES)
def test_the_lens_is_opencvs_rational_one(mode: str) -> None:
    lens = rational_lens(calibration(), DEPTH_MODES[mode])
    xy = np.random.default_rng(0).uniform(-0.9, 0.9, (50, 2))
    k = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    k1, k2, k3, k4, k5, k6 = lens.radial
    dist = np.array([k1, k2, lens.p1, lens.p2, k3, k4, k5, k6])
    theirs = cv2.projectPoints(np.concatenate((xy, np.ones((50, 1))), axis=1), np.zeros(3), np.zeros(3), k, dist)[0][:, 0]
    np.testing.assert_allclose(lens.distort(xy) * (lens.fx, lens.fy) + (lens.cx, lens.cy), theirs, atol=1e-9)


def test_modes_show_the_same_sensor() -> None:
    """A ray meets the full sensor, its crop and its binned crop where the modes say that they lie."""
    full, crop, binned = (
        rational_lens(calibration(), DEPTH_MODES[m]) for m in ("WFOV_UNBINNED", "NFOV_UNBINNED", "NFOV_2X2BINNED")
    )
    at = full.distort(np.array([0.3, -0.2]))
    u, v = at * (full.fx, full.fy) + (full.cx, full.cy)
    np.testing.assert_allclose(at * (crop.fx, crop.fy) + (crop.cx, crop.cy), (u - 192, v - 180))
    np.testing.assert_allclose(at * (binned.fx, binned.fy) + (binned.cx, binned.cy), ((u - 192.5) / 2, (v - 180.5) / 2))


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"CalibrationInformation": {"Cameras": []}},
        calibration([0.5] * 13),
        calibration([*PARAMETERS[:10], 0.1, 0, 0, 0]),
        calibration([float("nan"), *PARAMETERS[1:]]),
        calibration(["a", *PARAMETERS[1:]]),  # type: ignore[list-item]
    ],
    ids=["empty", "no camera", "13 numbers", "a centre of distortion", "nan", "text"],
)
def test_what_is_no_calibration_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises((ValueError, KeyError, TypeError)):
        rational_lens(wrong, DEPTH_MODES["NFOV_UNBINNED"])


def element(identity: str, *content: bytes) -> bytes:
    """An element of Matroska: its id, the length in eight bytes, its content."""
    data = b"".join(content)
    return bytes.fromhex(identity) + struct.pack(">Q", len(data) | 1 << 56) + data


def number(value: int) -> bytes:
    return struct.pack(">Q", value)


def tag(name: str, value: str) -> bytes:
    return element("67C8", element("45A3", name.encode()), element("4487", value.encode()))


def make_mkv(
    path: Path,
    images: list[tuple[str, int, bytes]],
    *,
    mode: str = "NFOV_2X2BINNED",
    attached: bytes | None = json.dumps(calibration()).encode() + b"\0",
) -> Path:
    """A recording as k4arecorder lays it out: track, time µs and bytes of each image; times are stored in microseconds."""
    names = list(dict.fromkeys(track for track, _, _ in images))
    tracks, tags = [], [tag("K4A_START_OFFSET_NS", "5000"), tag("K4A_DEVICE_SERIAL_NUMBER", "42")]
    entries = [element("7373", element("63C0"), *tags)]
    for i, name in enumerate(names, 1):
        common = (element("D7", number(i)), element("73C5", number(i)), element("536E", name.encode()))
        if name == "IMU":
            kind = (element("83", number(0x11)), element("86", b"S_K4A/IMU"))
        else:
            header = struct.pack("<IiiHH4sIiiII", 40, 320, 288, 1, 16, b"b16g", 320 * 288 * 2, 0, 0, 0, 0)
            size = element("E0", element("B0", number(320)), element("BA", number(288)))
            kind = (element("83", number(1)), element("86", b"V_MS/VFW/FOURCC"), element("63A2", header), size)
        tracks.append(element("AE", *common, *kind))
        entries.append(
            element(
                "7373", element("63C0", element("63C5", number(i))), tag(f"K4A_{name}_TRACK", "1"), tag("K4A_DEPTH_MODE", mode)
            )
        )
    file = ()
    if attached is not None:
        names_of_file = (element("466E", b"calibration.json"), element("4660", b"application/octet-stream"))
        file = (element("1941A469", element("61A7", *names_of_file, element("46AE", number(9)), element("465C", attached))),)
    clusters = []
    for name, time_us, data in images:
        head = bytes([0x80 | names.index(name) + 1, 0, 0, 0x80])
        clusters.append(element("1F43B675", element("E7", number(time_us)), element("A3", head, data)))
    info = element("1549A966", element("2AD7B1", number(1000)), element("4D80", b"test"), element("5741", b"test"))
    segment = (info, element("1654AE6B", *tracks), *file, element("1254C367", *entries), *clusters)
    path.write_bytes(element("1A45DFA3", element("4282", b"matroska")) + element("18538067", *segment))
    return path


def picture(value: int) -> bytes:
    return struct.pack(">H", value) * (320 * 288)


def test_depth_and_infrared_of_one_moment_make_a_frame(tmp_path: Path) -> None:
    images = [
        ("DEPTH", 0, picture(1000)), ("IR", 0, picture(7)),
        ("DEPTH", 66_000, picture(1001)),  # its infrared image was dropped
        ("IR", 133_000, picture(9)), ("DEPTH", 133_000, picture(1002)[:-2]),  # damaged
        ("IR", 200_000, picture(11)), ("DEPTH", 200_000, picture(1003)),
    ]  # fmt: skip
    with AzureFile(make_mkv(tmp_path / "take.mkv", images)) as file:
        rows = list(file.rows())
        assert file.malformed == 1
    frames = [(device_ns, m) for _, device_ns, m in rows if isinstance(m, ToFFrame)]
    assert [t for t, _ in frames] == [5_000, 66_005_000, 133_005_000, 200_005_000]
    seen = [tuple(int(image[0, 0]) if image.size else None for image in (m.depth, m.amplitude)) for _, m in frames]
    assert seen == [(1000, 7), (1001, None), (None, 9), (1003, 11)]


def test_inertial_readings(tmp_path: Path) -> None:
    good = struct.pack("<Q3fQ3f", 2_000_005_000, 1, 2, 3, 2_000_005_000, 0.1, 0.2, 0.3)
    images = [("DEPTH", 0, picture(1)), ("IMU", 10_000, good), ("IMU", 20_000, good * 2), ("IMU", 30_000, good[:-1])]
    bad = struct.pack("<Q3fQ3f", 1, float("nan"), 2, 3, 1, 0, 0, 0)
    with AzureFile(make_mkv(tmp_path / "take.mkv", [*images, ("IMU", 40_000, bad)])) as file:
        found = [(t, m) for _, t, m in file.rows() if isinstance(m, SensorReadings)]
        assert file.malformed == 2
    assert len(found) == 3
    assert found[0][0] == 2_000_005_000
    np.testing.assert_allclose(found[0][1].acceleration, [[1, 2, 3]])
    np.testing.assert_allclose(found[0][1].angular_velocity, [[0.1, 0.2, 0.3]], rtol=1e-6)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "take.mkv"
    with pytest.raises(RecordingError, match="cannot read"):
        AzureFile(path)
    path.write_bytes(b"\x1a\x45\xdf\xa3" + b"\0" * 100)
    with pytest.raises(RecordingError):
        AzureFile(path)
    depth = [("DEPTH", i * 66_000, picture(i + 1)) for i in range(5)]
    with pytest.raises(RecordingError, match="neither depth nor infrared"):
        AzureFile(make_mkv(path, [("COLOR", 0, picture(1))]))
    with pytest.raises(RecordingError, match=r"calibration is damaged: 'calibration.json'"):
        AzureFile(make_mkv(path, depth, attached=None))
    for attached in (b"{", b"[]", b"{}", json.dumps(calibration([1.0])).encode(), b" " * (1 << 20) + b"{}"):
        with pytest.raises(RecordingError, match="calibration is damaged"):
            AzureFile(make_mkv(path, depth, attached=attached))
    with pytest.raises(RecordingError, match="unknown depth mode"):
        AzureFile(make_mkv(path, depth, mode="HUGE"))
    data = make_mkv(path, depth).read_bytes()
    path.write_bytes(data[: -320 * 288 * 3])
    with pytest.warns(UserWarning, match="is damaged, and what could not be read is left out: File ended prematurely"):
        frames = [m for _, _, m in read_azure_mkv(path) if isinstance(m, ToFFrame)]
    assert [int(m.depth[0, 0]) for m in frames] == [1, 2, 3]  # what the cut file holds whole


def test_what_is_left_out_of_a_file_is_told(tmp_path: Path) -> None:
    path = tmp_path / "take.mkv"
    images = [(track, 1000 * i, picture(i)) for i in range(3) for track in ("DEPTH", "IR")]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        list(read_azure_mkv(make_mkv(path, images)))
    with pytest.warns(UserWarning, match="has 1 frames with depth or infrared alone"):
        list(read_azure_mkv(make_mkv(path, images[:-1])))
    with pytest.warns(UserWarning, match="has 1 packets that are no images"):
        list(read_azure_mkv(make_mkv(path, [*images, ("DEPTH", 3000, b"short")])))


def test_a_recording_without_depth_is_infrared_alone(tmp_path: Path) -> None:
    images = [("IR", 0, picture(3))]
    with AzureFile(make_mkv(tmp_path / "take.mkv", images, mode="PASSIVE_IR")) as file:
        assert (file.mode.width, file.mode.height) == (1024, 1024)
        assert [type(m) for _, _, m in file.rows()] == [Facts]  # an image of another size is left out
        assert file.malformed == 1
