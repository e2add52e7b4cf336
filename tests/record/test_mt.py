"""Single inertial trackers: bytes written by hand from the protocol's tables, and the emulator behind a serial line."""

from __future__ import annotations

import json
import os
import re
import socket
import struct
import time
import tty
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pydantic import ValidationError
from recorded_things import samples_until

from cabinpose.app.mocap.inputs import read_orientations
from cabinpose.core import MVN_SEGMENTS
from cabinpose.core.errors import RecordingError
from cabinpose.record.emulate.mt import MtEmulator, MtEmulatorSettings
from cabinpose.record.emulate.mvn import MvnEmulator
from cabinpose.record.emulate.mvn_motion import generated
from cabinpose.record.emulate.mvn_streamer import MvnEmulatorSettings
from cabinpose.record.sources import mt_protocol as mt
from cabinpose.record.sources.mt import MtSettings, MtSource
from cabinpose.signals import Facts, HostClock, Sample, SensorReadings

ONE = "03880C2A"
TWO = (ONE, "03880C2B")
PATIENCE_S = 20.0
until = partial(samples_until, patience_s=PATIENCE_S)
# GoToConfig, its answer and GoToMeasurement as the vendor's documentation prints them.
PRINTED = {0x30: "FA FF 30 00 D1", 0x31: "FA FF 31 00 D0", 0x10: "FA FF 10 00 F1"}


def framed(bus: int, kind: int, data: bytes) -> bytes:
    """A message, by the document's words: the sum of all bytes but the preamble has a low byte of 0."""
    body = [bus, kind, len(data), *data]
    return bytes([0xFA, *body, (256 - sum(body) % 256) % 256])


def packet(counter: int, ticks: int, *, double: bool = False) -> bytes:
    """MTData2 with known numbers, id by id from the document's table."""
    quaternion = b"\x20\x13\x20" + struct.pack(">4d", 0.5, 0.5, -0.5, 0.5)
    if not double:
        quaternion = b"\x20\x10\x10" + struct.pack(">4f", 0.5, 0.5, -0.5, 0.5)
    data = b"\x10\x20\x02" + struct.pack(">H", counter) + b"\x10\x60\x04" + struct.pack(">I", ticks) + quaternion
    data += b"\x40\x20\x0c" + struct.pack(">3f", 0.25, -0.5, 9.75) + b"\x80\x20\x0c" + struct.pack(">3f", 1, 2, 4)
    return data + b"\xc0\x20\x0c" + struct.pack(">3f", 0.5, 0, -1) + b"\xe0\x20\x04\x00\x00\x00\x03"


class Line:
    """A pseudo-terminal, and one tracker on it that answers with bytes from above."""

    def __init__(self) -> None:
        self.device, self.client = os.openpty()
        tty.setraw(self.client)
        self.port = Path(os.ttyname(self.client))

    def close(self) -> None:
        os.close(self.device)
        os.close(self.client)


@pytest.fixture
def line() -> Iterator[Line]:
    made = Line()
    yield made
    made.close()


def source_of(port: str, devices: tuple[str, ...] = (ONE,), **settings: Any) -> MtSource:
    sensors = dict(zip(("head", "hand"), devices, strict=False))
    return MtSource("trackers", MtSettings(port=Path(port), sensors=sensors, **settings), HostClock())


def readings(samples: list[Sample], name: str = "head") -> list[SensorReadings]:
    return [m for s in samples for m in s.messages if isinstance(m, SensorReadings) and m.subject == name]


def emulated(**settings: Any) -> MtEmulator:
    return MtEmulator(MtEmulatorSettings(**settings), generated("seated"))


@pytest.mark.parametrize("kind", PRINTED)
def test_messages_are_as_the_document_prints_them(kind: int) -> None:
    printed = bytes.fromhex(PRINTED[kind])
    assert mt.encode(mt.XbusMessage(0xFF, kind, b"")) == printed == framed(0xFF, kind, b"")
    assert mt.XbusSplitter().feed(printed) == [mt.XbusMessage(0xFF, kind, b"")]


def test_messages_are_found_in_any_pieces_and_among_rubbish() -> None:
    long = bytes(range(256)) * 2
    extended = bytes([0xFA, 0x01, 0x36, 0xFF, 0x02, 0x00]) + long
    extended += bytes([-sum(extended[1:]) % 256])
    whole = b"\x00\xfa\xfa" + framed(1, 0x36, packet(1, 2)) + b"rubbish" + extended
    for size in (1, 7, len(whole)):
        splitter = mt.XbusSplitter()
        found = [m for k in range(0, len(whole), size) for m in splitter.feed(whole[k : k + size])]
        assert [(m.bus, m.kind, m.data) for m in found] == [(1, 0x36, packet(1, 2)), (1, 0x36, long)]


def test_numbers_of_every_format() -> None:
    fixed12 = {0x2011: struct.pack(">4i", 1 << 19, -(1 << 20), 3 << 20, 0)}
    fixed16 = {0x2016: struct.pack(">IhIhIhIh", 1 << 31, 0, 0, -1, 0, 3, 0, 0)}  # 16.32, world: north, east, down
    for of in (fixed12, fixed16):
        np.testing.assert_array_equal(mt.numbers(of, mt.QUATERNION, 4), [[0.5, -1, 3, 0]])
    for double in (False, True):
        of = mt.packets(packet(7, 9, double=double))
        np.testing.assert_array_equal(mt.numbers(of, mt.QUATERNION, 4), [[0.5, 0.5, -0.5, 0.5]])
        assert (mt.whole_number(of, mt.PACKET_COUNTER), mt.whole_number(of, mt.TIME_FINE)) == (7, 9)
    with pytest.raises(ValueError, match="cut off"):
        mt.packets(packet(1, 1)[:-1])


def test_a_tracker_of_hand_written_bytes(line: Line) -> None:
    """Its counter wraps and loses two packets, one message has a wrong checksum: counted, and the rest is right."""
    told = b"\x10\x20\xff\xff\x20\x10\x00\x64"
    source = source_of(str(line.port))
    configured = framed(0xFF, 0x31, b"")  # before the take, and when it ends
    replies = iter(
        [configured, framed(0xFF, 1, bytes.fromhex(ONE)), framed(0xFF, 0xC1, told), framed(0xFF, 0x11, b""), configured]
    )
    source._line.send = lambda _: os.write(line.device, next(replies))  # type: ignore[method-assign, assignment]
    source.open()
    damaged = bytearray(framed(0xFF, 0x36, packet(2, 70)))
    damaged[20] ^= 1
    sent = [framed(0xFF, 0x36, packet(c, t)) for c, t in ((65534, 10), (65535, 20), (0, 30))]
    os.write(line.device, b"".join(sent) + bytes(damaged) + framed(0xFF, 0x36, packet(3, 60)))
    samples = [s for s in until(source, lambda found: len(readings(found)) == 4) if s.device_ns is not None]
    assert [s.sequence for s in samples] == [0, 1, 2, 5]
    assert [s.device_ns for s in samples] == [1_000_000, 2_000_000, 3_000_000, 6_000_000]
    assert (source.counts.lost, source.counts.malformed, source.counts.received) == (2, 1, 4)
    assert samples[0].raw == sent[0]
    (reading,) = samples[0].messages
    assert isinstance(reading, SensorReadings)
    np.testing.assert_array_equal(reading.orientation_wxyz, [[0.5, 0.5, -0.5, 0.5]])
    np.testing.assert_array_equal(reading.acceleration, [[0.25, -0.5, 9.75]])
    np.testing.assert_array_equal(reading.angular_velocity, [[1, 2, 4]])
    np.testing.assert_array_equal(reading.magnetic_field, [[0.5, 0, -1]])
    source.close()


@pytest.mark.parametrize("devices", [(ONE,), TWO])
def test_trackers_give_what_their_segments_do(devices: tuple[str, ...]) -> None:
    motion = generated("seated")
    with emulated(devices=devices, segments=("Head", "RightHand")) as emulator:
        source = source_of(emulator.port, devices)
        source.open()
        samples = until(source, lambda found: len(readings(found)) >= 20 and source.counts.received >= 20 * len(devices))
        source.close()
    for name, segment in list(zip(("head", "hand"), ("Head", "RightHand"), strict=True))[: len(devices)]:
        for number, reading in enumerate(readings(samples, name)):
            true = motion.orientation_wxyz[motion.frame(number / 100), MVN_SEGMENTS.index(segment)]
            np.testing.assert_allclose(reading.orientation_wxyz[0], true, atol=1e-6)
    facts = {m.about: m.values for s in samples for m in s.messages if isinstance(m, Facts) and "device_id" in m.values}
    assert facts["head"]["device_id"] == ONE
    assert facts["head"]["outputs_hz"]["0x2010"] == 100  # type: ignore[index]
    assert source.counts.lost == 0


class Late(MtEmulator):
    """Lists its trackers only when it is asked a second time."""

    def _answer(self, question: mt.XbusMessage) -> mt.XbusMessage:
        time.sleep(0.35 if question.kind == mt.INIT_BUS else 0)
        return super()._answer(question)


def test_late_answers_and_a_late_reader_lose_nothing() -> None:
    with Late(MtEmulatorSettings(devices=TWO), generated("seated")) as emulator:
        source = source_of(emulator.port, TWO)
        source.open()
        time.sleep(1.5)  # a busy computer: 26 kB have come, and a pseudo-terminal holds 19
        samples = until(source, lambda _: source.counts.received >= 400)
        source.close()
    numbers = [s.sequence for s in samples if s.sequence is not None]
    assert numbers == list(range(len(numbers)))
    assert (source.counts.lost, emulator.lost) == (0, 0)


def test_one_of_two_can_be_wanted() -> None:
    with emulated(devices=TWO, segments=("Head", "RightHand")) as emulator:
        source = source_of(emulator.port, (TWO[1],))
        source.open()
        samples = until(source, lambda found: len(readings(found)) >= 5)
        source.close()
    assert {m.subject for s in samples for m in s.messages if isinstance(m, SensorReadings)} == {"head"}
    assert {s.raw[1] for s in samples if s.raw} == {2}  # the second bus id


def test_losses_and_damage_are_counted() -> None:
    with emulated(devices=TWO, loss=0.1, damage=0.1, start_counter=65500) as emulator:
        source = source_of(emulator.port, TWO, rate_hz=400)
        source.open()
        samples = until(source, lambda _: source.counts.received > 300)
        source.close()
    numbers = [s.sequence for s in samples if s.sequence is not None]
    assert numbers == sorted(set(numbers))
    assert source.counts.lost == numbers[-1] + 1 - len(numbers) > 20
    assert 0.7 < source.counts.malformed / max(source.counts.received * 0.1 / 0.81 * 0.9, 1) < 1.4


def test_a_tracker_that_stops_is_told() -> None:
    with emulated(devices=TWO, stop_after_s=0.1) as emulator:
        source = source_of(emulator.port, TWO)
        source.open()
        told = Facts("hand", {"silent": True})
        until(source, lambda found: any(told in s.messages for s in found))
        source.close()


@pytest.mark.parametrize(
    ("emulator", "settings", "message"),
    [
        ({"devices": TWO}, {"devices": ("DEADBEEF",)}, r"no tracker DEADBEEF \(head\) \(there: 03880C2A, 03880C2B"),
        ({}, {"devices": ("DEADBEEF",)}, r"no tracker DEADBEEF \(head\) \(there: 03880C2A;"),
        ({"greatest_rate_hz": 60}, {}, "at 60 Hz, not 100"),
        ({"mute": True}, {"answer_s": 0.4}, "no answer within 0.4 s to message 0x30"),
    ],
)
def test_what_is_wrong_is_named(emulator: dict[str, Any], settings: dict[str, Any], message: str) -> None:
    with emulated(**emulator) as playing:
        source = source_of(playing.port, **settings)
        with pytest.raises(RecordingError) as caught:
            source.open()
        source.close()
    assert re.search(message, caught.value.in_one_line()), caught.value.in_one_line()


def test_settings_that_cannot_be() -> None:
    with pytest.raises(ValidationError, match="is no device id"):
        MtSettings(port=Path("x"), sensors={"head": "3880C2A"})
    with pytest.raises(ValidationError, match="stands twice"):
        MtSettings(port=Path("x"), sensors={"head": ONE, "hand": ONE})


def test_trackers_beside_a_suit_in_one_take(tmp_path: Path, run: Callable[..., Any]) -> None:
    """What a single tracker measures is read as a sensor of the suit's is."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    path = tmp_path / "take.mcap"
    with emulated() as emulator, MvnEmulator(MvnEmulatorSettings(port=port, kinds=(2, 23)), generated("seated")):
        tracker = {"kind": "mt", "port": emulator.port, "sensors": {"forehead": ONE}}
        rig = {"sources": {"suit": {"kind": "mvn", "host": "127.0.0.1", "port": port}, "tracker": tracker}}
        (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
        done = run("record", "--config", tmp_path / "rig.yaml", "--duration", "1.2", "--out", path)
    assert done.code == 0, done.err
    told = json.loads(run("info", path, "--json").out)["sources"]
    assert all(told[name]["samples"] > 30 for name in ("suit", "tracker"))
    for name in ("forehead", "Head"):
        time_s, turned, _ = read_orientations(path, name, source="tracker" if name == "forehead" else "suit")
        assert len(time_s) > 30
        np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1, atol=1e-6)
