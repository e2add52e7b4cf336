"""MVNX: the real file against an independent reading, round trips, versions, and files that mean harm."""

from __future__ import annotations

import dataclasses
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from mvnx_file import write_mvnx
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import RecordingError
from cabinpose.core.skeleton import CABINPOSE, MVN_JOINTS, MVN_SEGMENTS
from cabinpose.signals.recorded import (
    Channels,
    Facts,
    JointAngles,
    Message,
    SegmentKinematics,
    SegmentPoses,
    SensorReadings,
)
from cabinpose.store.convert.mvnx import read_mvnx
from cabinpose.store.convert.rows import Row

REAL = "mocap/xsens_upper_body.mvnx"
JOINTS = tuple(name for name, _, _ in MVN_JOINTS)


def of(rows: list[Row], kind: type[Message]) -> list[Message]:
    return [message for _, _, message in rows if isinstance(message, kind)]


def rows_of_a_take(frames: int = 5, rate_hz: float = 60.0) -> list[Row]:
    """Everything that MVNX holds, random."""
    rng = np.random.default_rng(1)
    sensors = ("Pelvis", "T8", "RightForearm")
    about = {
        "mvn": {"version": "2023"},
        "mvnx_subject": {"label": 'x < & " y'},
        "frame_rate_hz": rate_hz,
        "sensors": list(sensors),
    }
    point = {"segment": "RightForearm", "point": 1, "name": "jRightElbow", "offset": [0.0, 0.25, -1e-7]}
    rows: list[Row] = [(10**18, 0, Facts("S.01", about)), (10**18, 0, Facts("S.01", {"points": [point]}))]
    turns = Rotation.random(23, rng=rng).as_quat(scalar_first=True)
    calibration = {"calibration": "tpose", "segments": list(MVN_SEGMENTS)}
    calibration |= {"position": rng.normal(size=(23, 3)).tolist(), "orientation_wxyz": turns.tolist()}
    rows.append((10**18, 0, Facts("S.01", calibration)))
    contacts = tuple(f"S.01.foot_contact.{side}Foot_{end}" for side in ("Left", "Right") for end in ("Heel", "Toe"))
    centre = tuple(f"S.01.centre_of_mass.{axis}" for axis in "xyz")
    for i in range(frames):
        turn = Rotation.random(23, rng=rng).as_quat(scalar_first=True)
        messages: list[Message] = [
            SegmentPoses("S.01", MVN_SEGMENTS, rng.normal(size=(23, 3)), turn),
            SegmentKinematics("S.01", MVN_SEGMENTS, *rng.normal(size=(4, 23, 3))),
            SensorReadings("S.01", sensors, turn[:3], *rng.normal(size=(3, 3, 3))),
            JointAngles("S.01", (*JOINTS, *(f"{j}.xzy" for j in JOINTS), "T8_Head"), rng.normal(size=(45, 3))),
            Channels((*contacts, *centre), np.array([0.0, 1, 1, 0, *rng.normal(size=3)])),
        ]
        at = round(i * 1e9 / rate_hz)
        rows += [(10**18 + at // 10**6 * 10**6, at, message) for message in messages]
    return rows


def same(a: Message, b: Message, atol: float = 1e-9) -> None:
    assert type(a) is type(b)
    for each in dataclasses.fields(a):
        left, right = getattr(a, each.name), getattr(b, each.name)
        if isinstance(left, np.ndarray):
            np.testing.assert_allclose(left, right, atol=atol, err_msg=each.name)
        else:
            assert left == right


def test_round_trip_of_everything(tmp_path: Path) -> None:
    rows = rows_of_a_take()
    again = list(read_mvnx(write_mvnx(tmp_path / "take.mvnx", rows), subjects=["S.01"]))
    assert [(type(m), device) for _, device, m in again] == [(type(m), device) for _, device, m in rows]
    for (host, _, a), (host_again, _, b) in zip(rows, again, strict=True):
        assert abs(host - host_again) <= 500_000
        if isinstance(a, Facts):
            continue
        same(a, b)
    facts = {key: value for m in of(again, Facts) for key, value in m.values.items()}
    assert facts["mvnx_subject"]["label"] == 'x < & " y'
    assert (facts["frame_rate_hz"], facts["sensors"]) == (60, ["Pelvis", "T8", "RightForearm"])
    assert facts["points"] == rows[1][2].values["points"]
    np.testing.assert_array_equal(facts["position"], rows[2][2].values["position"])


def test_gaps_stay_gaps(tmp_path: Path) -> None:
    """Frames that are missing leave their numbers out, so that the others keep their exact times."""
    rows = [row for row in rows_of_a_take(20) if row[1] not in {round(n * 1e9 / 60) for n in (3, 4, 11)}]
    path = write_mvnx(tmp_path / "take.mvnx", rows)
    assert [device for _, device, m in read_mvnx(path) if isinstance(m, SegmentPoses)] == [
        round(n * 1e9 / 60) for n in range(20) if n not in (3, 4, 11)
    ]


def test_the_real_file_against_another_reader(real_data: Callable[[str], Path]) -> None:
    rows = list(read_mvnx(real_data(REAL)))
    space = "{http://www.xsens.com/mvn/mvnx}"
    frames = list(ET.parse(real_data(REAL)).getroot().iter(f"{space}frame"))
    normal = [f for f in frames if f.get("type") == "normal"]
    assert len(normal) == 112
    poses, moved, sensors, angles, channels = (
        of(rows, kind) for kind in (SegmentPoses, SegmentKinematics, SensorReadings, JointAngles, Channels)
    )

    def numbers(frame: ET.Element, name: str) -> np.ndarray:
        return np.array([float(x) for x in frame.find(space + name).text.split()])

    for i, frame in enumerate(normal):
        np.testing.assert_array_equal(poses[i].position_m.ravel(), numbers(frame, "position"))
        np.testing.assert_array_equal(poses[i].orientation_wxyz.ravel(), numbers(frame, "orientation"))
        np.testing.assert_array_equal(moved[i].angular_velocity.ravel(), numbers(frame, "angularVelocity"))
        np.testing.assert_array_equal(sensors[i].orientation_wxyz.ravel(), numbers(frame, "sensorOrientation"))
        free = [
            Rotation.from_quat([*q[1:], q[0]]).as_matrix() @ a - [0, 0, 9.80665]
            for q, a in zip(sensors[i].orientation_wxyz, sensors[i].acceleration, strict=True)
        ]
        np.testing.assert_allclose(np.ravel(free), numbers(frame, "sensorFreeAcceleration"), atol=1e-9)
        np.testing.assert_allclose(np.degrees(angles[i].angles[:22]).ravel(), numbers(frame, "jointAngle"), atol=1e-9)
        np.testing.assert_allclose(np.degrees(angles[i].angles[44:]).ravel(), numbers(frame, "jointAngleErgo"), atol=1e-9)
        np.testing.assert_array_equal(channels[i].values[:4], numbers(frame, "footContacts"))
        np.testing.assert_array_equal(channels[i].values[4:], numbers(frame, "centerOfMass"))
    times = [(host, device) for host, device, m in rows if isinstance(m, SegmentPoses)]
    assert [host // 10**6 for host, _ in times] == [int(f.get("ms")) for f in normal]
    assert np.allclose([device / 1e6 for _, device in times], [int(f.get("time")) for f in normal], atol=1.001)
    assert np.ptp(np.diff([device for _, device in times])) <= 1  # evenly spaced: sharper than the file's milliseconds
    kinds = [m.values["calibration"] for m in of(rows, Facts) if "calibration" in m.values]
    assert kinds == ["identity", "tpose", "tpose-isb"]
    assert (sensors[0].names[5], poses[0].names) == ("RightForearm", MVN_SEGMENTS)


def test_our_joints_are_the_origins_of_their_segments(real_data: Callable[[str], Path]) -> None:
    """Each row of the table of joints: the segment's origin is the joint between it and its parent, by the file's own points."""
    rows = list(read_mvnx(real_data(REAL)))
    (points,) = [m.values["points"] for m in of(rows, Facts) if "points" in m.values]
    offset = {(p["segment"], p["name"]): p["offset"] for p in points}
    for name, _, child in MVN_JOINTS:
        assert offset[child, name] == [0, 0, 0]
    joint = {child: name for name, _, child in MVN_JOINTS}
    spine = {"head": "jC1Head", "neck": "jT1C7", "chest": "jT9T8", "hip": "jL5S1"}
    arms = {"lshoulder": "jLeftShoulder", "relbow": "jRightElbow", "lwrist": "jLeftWrist"}
    legs = {"rpelvis": "jRightHip", "lknee": "jLeftKnee", "rankle": "jRightAnkle", "lfoot": "jLeftBallFoot"}
    for ours, theirs in (spine | arms | legs).items():
        assert joint[CABINPOSE.maps["mvn"][ours]] == theirs


def test_the_real_file_goes_round(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    rows = list(read_mvnx(real_data(REAL)))
    again = list(read_mvnx(write_mvnx(tmp_path / "again.mvnx", rows)))
    assert len(again) == len(rows)
    for (_, device, a), (_, device_again, b) in zip(rows, again, strict=True):
        assert device == device_again
        if not isinstance(a, Facts):
            same(a, b)


def small(frames: str, *, version: int = 3, before: str = "", header: str = "") -> bytes:
    names = "".join(f'<segment label="{n.replace("Forearm", "ForeArm")}" id="{i}"/>' for i, n in enumerate(MVN_SEGMENTS, 1))
    text = f'{before}<mvnx version="{version}"><subject label="A" frameRate="120"><segments>{names}</segments>{header}<frames>'
    return (text + frames + "</frames></subject></mvnx>").encode()


def frame(inner: str = "", **attributes: str) -> str:
    given = "".join(f' {k}="{v}"' for k, v in {"type": "normal", "time": "0", "index": "0", **attributes}.items())
    return f"<frame{given}>{inner}</frame>"


POSE = f"<orientation>{'1 0 0 0 ' * 23}</orientation><position>{'0 0 1 ' * 23}</position>"


def written(folder: Path, data: bytes) -> Path:
    path = folder / "a.mvnx"
    path.write_bytes(data)
    return path


def test_version_3_gives_what_sensors_felt(tmp_path: Path) -> None:
    inner = POSE + "<sensorAcceleration>0 0 9.81</sensorAcceleration><sensorAngularVelocity>1 2 3</sensorAngularVelocity>"
    data = small(frame(inner), header='<sensors><sensor label="RightForeArm"/></sensors>')
    (readings,) = of(list(read_mvnx(written(tmp_path, data))), SensorReadings)
    assert readings.names == ("RightForearm",)
    np.testing.assert_array_equal(readings.acceleration, [[0, 0, 9.81]])
    np.testing.assert_array_equal(readings.angular_velocity, [[1, 2, 3]])
    assert readings.orientation_wxyz.shape == (0, 4)


def test_what_is_not_read_is_named(tmp_path: Path) -> None:
    data = small(
        frame(POSE + "<marker>take it</marker><orientationFingersLeft>1</orientationFingersLeft>") + frame(POSE, index="1")
    )
    rows = list(read_mvnx(written(tmp_path, data)))
    assert [m.values["not_read"] for m in of(rows, Facts) if "not_read" in m.values] == [["marker", "orientationFingersLeft"]]
    assert len(of(rows, SegmentPoses)) == 2


def test_two_subjects_and_prefixes(tmp_path: Path) -> None:
    one = small(frame(POSE)).decode().removeprefix('<mvnx version="3">').removesuffix("</mvnx>")
    two = one.replace("<", "<m:").replace("<m:/", "</m:")
    rows = list(read_mvnx(written(tmp_path, f'<mvnx xmlns:m="x">{one}{two}</mvnx>'.encode()), subjects=["S01"]))
    assert [m.subject for m in of(rows, SegmentPoses)] == ["S01", "character1"]


def test_entities_are_refused(tmp_path: Path) -> None:
    bomb = '<!DOCTYPE mvnx [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;">]>'
    with pytest.raises(RecordingError, match="declares an entity") as caught:
        list(read_mvnx(written(tmp_path, small(frame("<position>&b;</position>"), before=bomb))))
    assert caught.value.hint
    outside = '<!DOCTYPE mvnx [<!ENTITY a SYSTEM "file:///etc/passwd">]>'
    with pytest.raises(RecordingError, match="declares an entity"):
        list(read_mvnx(written(tmp_path, small(frame("<position>&a;</position>"), before=outside))))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "no whole MVNX"),
        (b"BVH", "no whole MVNX"),
        (b"<html></html>", "<html>, not <mvnx>"),
        (b"<mvnx></mvnx>", "holds no subject"),
        (b"<mvnx><frame/></mvnx>", "outside a subject"),
        (small(frame("<position>1 2 3</position>")), "3 numbers for 23 things"),
        (small(frame("<position>a b c</position>")), "could not convert"),
        (small(frame(POSE, time="nan")), "nan where a number"),
        (small(frame("<centerOfMass>1 2</centerOfMass>")), "centerOfMass of 2"),
        (small(frame("<a>" * 40 + "</a>" * 40)), "nested more than"),
        (small(frame("<a/>" * 300)), "more than 256 elements"),
        (small(frame("<position>" + "1 " * (1 << 20) + "</position>")), "characters"),
    ],
)
def test_damage_is_told(tmp_path: Path, data: bytes, message: str) -> None:
    with pytest.raises(RecordingError, match=message) as caught:
        list(read_mvnx(written(tmp_path, data)))
    assert caught.value.hint


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot read"):
        list(read_mvnx(tmp_path / "none.mvnx"))


def test_what_precedes_the_damage_is_read(tmp_path: Path) -> None:
    path = write_mvnx(tmp_path / "a.mvnx", rows_of_a_take(200))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    poses = []
    with pytest.raises(RecordingError, match="after frame"):
        poses += [row for row in read_mvnx(path) if isinstance(row[2], SegmentPoses) and not poses.append(row)]
    assert 80 < len(poses) < 120


@pytest.mark.slow
def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    peaks = []
    for frames in (60, 600):
        path = write_mvnx(tmp_path / f"{frames}.mvnx", rows_of_a_take(frames))
        tracemalloc.start()
        assert sum(isinstance(m, SegmentPoses) for _, _, m in read_mvnx(path)) == frames
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.3 * peaks[0]
