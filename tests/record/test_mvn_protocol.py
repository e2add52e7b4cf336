"""MVN's bytes and what they mean: layouts against hand-made bytes, axes against matrices, damage refused, fuzzed."""

from __future__ import annotations

import random
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cabinpose.core.skeleton import CABINPOSE, MVN_SEGMENTS
from cabinpose.record.emulate.mvn_motion import generated, offset_m
from cabinpose.record.emulate.mvn_streamer import MvnEmulatorSettings, Streamer
from cabinpose.record.sources import mvn_protocol as mvn
from cabinpose.record.sources.mvn import MvnSource
from cabinpose.record.sources.mvn_messages import (
    FINGER_SEGMENTS,
    UNITY_SEGMENTS,
    Z_UP_FROM_UNITY,
    Z_UP_FROM_Y_UP,
    Decoder,
    euler_to_wxyz,
    rotated_frame_wxyz,
)
from cabinpose.record.sources.mvn_protocol import Header, MalformedError
from cabinpose.signals.recorded import Channels, Facts, JointAngles, Markers, SegmentKinematics, SegmentPoses, SensorReadings

ALL = (1, 2, 3, 5, 20, 21, 22, 23, 24, 25)


def header_bytes(kind: str, *, items: int, payload: int, sample: int = 7, counter: int = 0x80, character: int = 0) -> bytes:
    """The 24 bytes, by the specification's table, without our packing."""
    out = b"MXTP" + kind.encode()
    out += sample.to_bytes(4, "big") + bytes([counter, items]) + (1500).to_bytes(4, "big")
    return out + bytes([character, 23, 0, 0, 0, 0]) + payload.to_bytes(2, "big")


def decode(data: bytes, decoder: Decoder | None = None) -> tuple:
    return (decoder or Decoder())(*mvn.read_datagram(data))


def test_the_bytes_that_the_thesis_reads() -> None:
    """Type 02 as others read it: position of segment j at byte 28 + 32 j, orientation at 40 + 32 j; 760 bytes in all."""
    streamer = Streamer(MvnEmulatorSettings(meta_every_s=0), generated())
    (datagram,) = streamer.sample(3)
    data = datagram.data
    assert len(data) == 760
    assert data[:24] == header_bytes("02", items=23, payload=736, sample=3)[:12] + (50).to_bytes(4, "big") + bytes(
        [0, 23, 0, 0, 0, 0, 736 >> 8, 736 & 255]
    )
    position, orientation = streamer.poses(streamer.motion.frame(0.05), 0)
    for j in range(23):
        assert struct.unpack_from(">i", data, 24 + 32 * j) == (j + 1,)
        np.testing.assert_allclose(struct.unpack_from(">3f", data, 28 + 32 * j), position[j], atol=1e-6)
        np.testing.assert_allclose(struct.unpack_from(">4f", data, 40 + 32 * j), orientation[j], atol=1e-6)


def test_header_fields() -> None:
    header = mvn.read_header(bytes.fromhex("4d585450 3032 01020304 85 17 000005dc 02 17 01 28 0000 02e0".replace(" ", "")))
    assert header == Header(2, 0x01020304, 5, True, 23, 1500, 2, 23, 1, 40, 736)
    assert mvn.build_header(header).hex() == "4d5854503032010203048517000005dc02170128000002e0"


def test_a_hand_made_pose_of_each_axis_convention() -> None:
    """Left hand a metre to the left (+y), half a metre up, 0.2 m ahead, turned 90° about the vertical: as each type has it."""
    item = struct.pack(">i", 15)
    third = 2**-0.5
    euler = header_bytes("01", items=1, payload=28) + item + struct.pack(">6f", 100, 50, 20, 0, 90, 0)  # cm; x left, y up
    zup = header_bytes("02", items=1, payload=32) + item + struct.pack(">7f", 0.2, 1, 0.5, third, 0, 0, third)
    # Unity: x right, y up, z ahead; a turn to the left is negative there.
    unity = header_bytes("05", items=1, payload=32) + struct.pack(">i7f", 17, -1, 0.5, 0.2, third, 0, -third, 0)
    for data in (euler, zup, unity):
        (pose,) = decode(data)
        assert pose.names == ("LeftHand",)
        np.testing.assert_allclose(pose.position_m, [[0.2, 1, 0.5]], atol=1e-6)
        turned = Rotation.from_quat(pose.orientation_wxyz, scalar_first=True).apply([1, 0, 0])
        np.testing.assert_allclose(turned, [[0, 1, 0]], atol=1e-6)
    points = header_bytes("03", items=1, payload=16) + struct.pack(">i3f", 256 * 15 + 4, 100, 50, 20)
    (markers,) = decode(points)
    assert markers.names == ("LeftHand.4",)
    np.testing.assert_allclose(markers.position_m, [[0.2, 1, 0.5]], atol=1e-6)


def test_axes_of_y_up_and_unity() -> None:
    assert np.linalg.det(Z_UP_FROM_Y_UP) == pytest.approx(1)
    assert np.linalg.det(Z_UP_FROM_UNITY) == pytest.approx(-1)
    np.testing.assert_array_equal(Z_UP_FROM_Y_UP @ [0, 1, 0], [0, 0, 1])  # up
    np.testing.assert_array_equal(Z_UP_FROM_UNITY @ [1, 0, 0], [0, -1, 0])  # right
    rotations = Rotation.random(50, rng=np.random.default_rng(0))
    for matrix in (Z_UP_FROM_Y_UP, Z_UP_FROM_UNITY):
        ours = rotated_frame_wxyz(rotations.as_quat(scalar_first=True), matrix)
        theirs = matrix @ rotations.as_matrix() @ matrix.T
        np.testing.assert_allclose(Rotation.from_quat(ours, scalar_first=True).as_matrix(), theirs, atol=1e-12)


def test_euler_angles_against_scipy() -> None:
    degrees = np.random.default_rng(0).uniform(-180, 180, (200, 3))
    ours = Rotation.from_quat(euler_to_wxyz(degrees), scalar_first=True)
    assert (ours * Rotation.from_euler("xyz", degrees, degrees=True).inv()).magnitude().max() < 1e-7


@pytest.mark.parametrize("motion", ["walk", "seated"])
def test_all_types_tell_the_same_pose(motion: str) -> None:
    """What goes through the bytes of types 01, 02, 03 and 05 is the motion that was streamed, in our frame."""
    settings = MvnEmulatorSettings(kinds=ALL, characters=2, props=2, fingers=True, meta_every_s=0, items_per_datagram=None)
    streamer = Streamer(settings, generated(motion))
    decoder = Decoder(subjects={1: "S01"})
    seen = set()
    for datagram in streamer.sample(17):
        header, payload = mvn.read_datagram(datagram.data)
        messages = decoder(header, payload)
        frame = streamer.motion.frame(17 / 60 + 0.37 * header.character)
        position, orientation = streamer.poses(frame, header.character)
        for message in messages:
            if isinstance(message, SegmentPoses):
                order = [MVN_SEGMENTS.index(n) for n in UNITY_SEGMENTS] if header.kind == 5 else list(range(len(position)))
                assert message.subject == ("character0", "S01")[header.character]
                np.testing.assert_allclose(message.position_m, position[order], atol=2e-6)
                turn = Rotation.from_quat(message.orientation_wxyz, scalar_first=True)
                true = Rotation.from_quat(orientation[order], scalar_first=True)
                assert (turn * true.inv()).magnitude().max() < 2e-6
                names = (*MVN_SEGMENTS, "Prop1", "Prop2", *FINGER_SEGMENTS)
                assert message.names == (UNITY_SEGMENTS if header.kind == 5 else names)
            elif isinstance(message, Markers):
                np.testing.assert_allclose(message.position_m, position[:23], atol=2e-6)
            elif isinstance(message, Channels):
                np.testing.assert_allclose(message.values, position[:23].mean(axis=0), atol=1e-6)
            elif isinstance(message, JointAngles):
                np.testing.assert_allclose(message.angles, streamer.motion.joint_angles[frame], atol=1e-6)
                assert (message.names[0], message.names[-1]) == ("jL5S1", "jLeftBallFoot")
            elif isinstance(message, SegmentKinematics) and len(message.velocity):
                np.testing.assert_allclose(message.velocity[:23], streamer.motion.velocity[frame], rtol=1e-5, atol=1e-5)
                assert message.angular_velocity.shape == (0, 3)
            elif isinstance(message, SegmentKinematics):
                np.testing.assert_allclose(message.angular_velocity[:23], streamer.motion.angular_velocity[frame], atol=1e-5)
            seen.add((header.kind, type(message).__name__))
    assert {kind for kind, _ in seen} == set(ALL)


@pytest.mark.parametrize("long", [True, False])
def test_trackers_give_what_sensors_feel(long: bool) -> None:
    """68 and 44 bytes: in both, the acceleration is the sensor's own, with gravity, by matrices from the motion."""
    settings = MvnEmulatorSettings(kinds=(23,), meta_every_s=0, long_trackers=long)
    streamer = Streamer(settings, generated("walk"))
    (datagram,) = streamer.sample(30)
    assert len(datagram.data) == 24 + 17 * (68 if long else 44)
    (readings,) = decode(datagram.data)
    assert isinstance(readings, SensorReadings)
    assert readings.names[:3] == ("Pelvis", "T8", "Head")
    frame = streamer.motion.frame(0.5)
    for i, name in enumerate(readings.names):
        j = MVN_SEGMENTS.index(name)
        world_from_sensor = Rotation.from_quat(readings.orientation_wxyz[i], scalar_first=True).as_matrix()
        expected = world_from_sensor.T @ (streamer.motion.acceleration[frame, j] + [0, 0, 9.80665])
        np.testing.assert_allclose(readings.acceleration[i], expected, atol=1e-4)
        np.testing.assert_allclose(world_from_sensor @ readings.magnetic_field[i], [0.4, 0, -0.9], atol=1e-5)
    assert readings.angular_velocity.shape == ((17, 3) if long else (0, 3))


def test_the_motion_is_consistent() -> None:
    """Segment lengths stay, feet stay above the floor, and velocities are the derivatives of the poses."""
    motion = generated("walk")
    at = {name: motion.position_m[:, i] for i, name in enumerate(MVN_SEGMENTS)}
    for name, parent in (("LeftForearm", "LeftUpperArm"), ("RightFoot", "RightLowerLeg"), ("Head", "Neck")):
        np.testing.assert_allclose(np.linalg.norm(at[name] - at[parent], axis=1), np.linalg.norm(offset_m(name)), atol=1e-9)
    assert at["Head"][:, 2].min() > 1.4
    assert (at["RightHand"][:, 1] < at["LeftHand"][:, 1]).all()
    assert at["RightLowerLeg"][:, 0].max() > 0.2  # the knee comes forward
    turn = Rotation.from_quat(motion.orientation_wxyz[10, 16], scalar_first=True)
    after = Rotation.from_quat(motion.orientation_wxyz[11, 16], scalar_first=True)
    step = (after * turn.inv()).as_rotvec() * motion.rate_hz
    np.testing.assert_allclose(step, (motion.angular_velocity[10, 16] + motion.angular_velocity[11, 16]) / 2, atol=0.02)


def test_metres_and_centimetres() -> None:
    """By the size of the body, whatever its height: upper-body recordings have the pelvis at 0. A setting overrules."""
    for motion, lift in (("walk", 0.0), ("seated", -0.45)):
        for centimetres in (False, True):
            streamer = Streamer(MvnEmulatorSettings(meta_every_s=0, centimetres=centimetres), generated(motion))
            object.__setattr__(streamer.motion, "position_m", streamer.motion.position_m + [0, 0, lift])
            (datagram,) = streamer.sample(0)
            decoder = Decoder()
            facts, pose = decode(datagram.data, decoder)
            assert facts.values == {"position_unit": "cm" if centimetres else "m", "position_unit_from": "size of the body"}
            np.testing.assert_allclose(pose.position_m, streamer.poses(0, 0)[0], atol=1e-5)
            assert len(decode(datagram.data, decoder)) == 1  # settled once
            forced, pose = decode(datagram.data, Decoder(position_unit="m"))
            assert forced.values["position_unit_from"] == "setting"
            np.testing.assert_allclose(
                pose.position_m, streamer.poses(0, 0)[0] * (100 if centimetres else 1), rtol=1e-5, atol=1e-5
            )


def test_a_unit_that_is_set_holds_without_poses() -> None:
    """A stream of centres of mass and velocities alone, which tell no size."""
    for datagram in Streamer(MvnEmulatorSettings(meta_every_s=0, centimetres=True, kinds=(21, 24)), generated("walk")).sample(5):
        (set_,), (unknown,) = (decode(datagram.data, Decoder(position_unit=unit)) for unit in ("cm", "auto"))
        for name in ("values", "velocity", "acceleration"):
            if hasattr(set_, name):
                np.testing.assert_allclose(100 * getattr(set_, name), getattr(unknown, name), atol=1e-12)


def test_an_object_takes_the_others_unit() -> None:
    decoder = Decoder()
    (body,) = Streamer(MvnEmulatorSettings(meta_every_s=0, centimetres=True), generated()).sample(0)
    header = Header(2, 0, 0, True, 1, 0, 9, 1, 0, 0, 0)
    fields = {"id": np.array([1]), "position": np.array([[100.0, 0, 0]]), "orientation_wxyz": np.array([[1.0, 0, 0, 0]])}
    (data,) = mvn.build_sample(header, mvn.build_items(2, fields))
    assert decode(data, decoder)[0].names == ("Object",)  # nothing known yet: as it is, and no word on it
    decode(body.data, decoder)
    facts, pose = decode(data, decoder)
    assert facts.values == {"position_unit": "cm", "position_unit_from": "unit of the others"}
    np.testing.assert_allclose(pose.position_m, [[1, 0, 0]])


def test_old_headers_and_missing_segments() -> None:
    """Before 2019 headers count no segments and have no payload size; then ids name the items."""
    item = struct.pack(">i7f", 7, 0, 0, 1, 1, 0, 0, 0) + struct.pack(">i7f", 42, 0, 0, 1, 1, 0, 0, 0)
    old = bytearray(header_bytes("02", items=2, payload=0))
    old[17] = 0
    (pose,) = decode(bytes(old) + item)
    assert pose.names == ("Head", "Segment42")


def test_facts_of_a_character() -> None:
    datagrams = list(Streamer(MvnEmulatorSettings(kinds=(3, 25)), generated()).sample(0))
    decoder = Decoder()
    meta, origins, points, markers, code = [decode(d.data, decoder)[0] for d in datagrams]
    assert meta == Facts("character0", {"name": "Character 0", "xmid": "00000000", "color": "E96417"})
    assert list(origins.values["segment_origins"]) == list(MVN_SEGMENTS)
    assert len(points.values["points"]) == 23
    assert markers.names[14] == "jLeftHand"  # by the names that the scale told
    assert code == Facts("character0", {"time_code": "00:00:00.000"})
    assert set(CABINPOSE.maps["mvn"].values()) <= set(MVN_SEGMENTS)


def test_a_time_code_without_its_length() -> None:
    assert mvn.read_time_code(b"12:34:56.789") == "12:34:56.789" == mvn.read_time_code(mvn.build_text("12:34:56.789"))


def test_a_centre_of_mass_of_newer_releases() -> None:
    (channels,) = decode(header_bytes("24", items=1, payload=36) + struct.pack(">9f", *range(9)))
    assert channels.names[0] == "character0.centre_of_mass.x"
    np.testing.assert_array_equal(channels.values, [0, 1, 2])


def test_meta_with_colons_and_unknown_tags() -> None:
    text = "name:a:b\nnew: c \nnothing\n"
    assert mvn.read_meta(mvn.build_text(text)) == {"name": "a:b", "new": "c"}


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"MXTP02",
        b"MXTP99" + bytes(18),
        b"XXTP02" + bytes(18),
        header_bytes("02", items=23, payload=736) + bytes(735),
        header_bytes("02", items=23, payload=736) + bytes(737),
        header_bytes("02", items=0, payload=0),
        header_bytes("02", items=22, payload=736) + bytes(736),
        header_bytes("23", items=2, payload=112) + bytes(112),  # one of 44 and one of 68
        header_bytes("24", items=1, payload=8) + bytes(8),
        header_bytes("24", items=1, payload=12) + bytes(36),
        header_bytes("24", items=1, payload=36) + bytes(12),
        header_bytes("25", items=1, payload=12) + b"12-34-56.789",
        header_bytes("25", items=1, payload=12) + "１２:34:56.7".encode()[:12],
        header_bytes("25", items=1, payload=16) + struct.pack(">i", -1) + b"12:34:56.789",
        header_bytes("12", items=1, payload=4) + struct.pack(">i", 2**31 - 1),
        header_bytes("12", items=1, payload=6) + struct.pack(">i", 2) + b"\xff\xfe",
        header_bytes("13", items=1, payload=4) + struct.pack(">I", 2**32 - 1),
        header_bytes("13", items=1, payload=8) + struct.pack(">II", 0, 2**31),
        header_bytes("13", items=1, payload=9) + bytes(9),
        header_bytes("13", items=1, payload=20) + struct.pack(">Ii3f", 1, 0, 0, 0, float("nan")),
    ],
)
def test_what_contradicts_itself_is_refused(data: bytes) -> None:
    with pytest.raises(MalformedError):
        decode(data)


def test_samples_are_cut_and_joined() -> None:
    fields = {"id": np.arange(1, 64), "position": np.ones((63, 3)), "orientation_wxyz": np.ones((63, 4))}
    header = Header(2, 5, 0, True, 63, 0, 0, 23, 0, 40, 0)
    pieces = mvn.build_sample(header, mvn.build_items(2, fields), pieces_of=40)
    read = [mvn.read_datagram(piece) for piece in pieces]
    assert [(h.piece, h.last, h.items, h.payload) for h, _ in read] == [(0, False, 40, 1280), (1, True, 23, 736)]
    assert b"".join(payload for _, payload in read) == mvn.build_items(2, fields)
    with pytest.raises(ValueError, match="does not fit"):
        mvn.build_sample(header._replace(items=200), bytes(200 * 32), pieces_of=1)


# ------------------------------------------------------------------------------------------------------------------ fuzz
_STREAM = [
    d.data
    for number in range(3)
    for d in Streamer(
        MvnEmulatorSettings(kinds=ALL, characters=2, props=1, fingers=True, items_per_datagram=30), generated()
    ).sample(number)
]


@pytest.mark.slow
def test_thirty_thousand_mutations() -> None:
    """As below, without hypothesis' care, so that it is many; the stream's framing too."""
    draw = random.Random(1)
    source = MvnSource("suit")
    now = 0
    with np.errstate(invalid="ignore", over="ignore"):
        for i in range(30_000):
            data = bytearray(draw.choice(_STREAM))
            match draw.randrange(8):
                case 0:
                    data = data[: draw.randrange(len(data) + 1)]
                case 1:
                    data = data[:24] + draw.choice(_STREAM)[24:]
                case 2:
                    at = draw.randrange(len(data))
                    data[at:at] = draw.randbytes(draw.randrange(1, 9))
                case _:
                    for _ in range(draw.choice((1, 1, 2, 4, 16))):
                        at = draw.randrange(len(data) if draw.random() < 0.5 else 28)
                        data[at] = draw.choice((0, 1, 127, 128, 255, draw.randrange(256)))
            now += draw.choice((0, 10**5, 10**6, 3 * 10**9)) if draw.random() < 0.3 else 10**5
            assert source.take(bytes(data), now).raw == data
            if i % 10 == 0:
                source._cut(bytes(data))
    source.close()
    assert source.counts.malformed > 15_000
    assert source.counts.received > 1_500


@given(st.binary(max_size=2000))
def test_any_bytes_are_taken(data: bytes) -> None:
    source = MvnSource("suit")
    sample = source.take(data, 0)
    assert sample.raw == data
    assert source.counts.malformed == (sample.device_ns is None)


@given(st.data())
def test_mutated_datagrams_are_counted_not_raised(data: st.DataObject) -> None:
    """Bytes flipped, cut, doubled and swapped anywhere: each is a sample with its bytes, and at most counted."""
    source = MvnSource("suit")
    now = 0
    for _ in range(data.draw(st.integers(1, 12))):
        original = bytearray(data.draw(st.sampled_from(_STREAM)))
        for _ in range(data.draw(st.integers(0, 4))):
            at = data.draw(st.integers(0, len(original) - 1) | st.integers(0, 30))
            original[at] = data.draw(st.integers(0, 255))
        mutated = bytes(original[: data.draw(st.integers(0, len(original)) | st.just(len(original)))])
        now += data.draw(st.sampled_from([0, 1_000_000, 2_000_000_000]))
        sample = source.take(mutated, now)
        assert sample.raw == mutated
    source.close()
    assert min(vars(source.counts).values()) >= 0
