"""Vicon end to end on loopback: what the emulated server shows is what the source gives, and every frame is accounted for."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import RecordingError
from cabinpose.core.skeleton import CABINPOSE
from cabinpose.record.emulate.vicon import ViconEmulator
from cabinpose.record.emulate.vicon_content import Outage, ViconEmulatorSettings
from cabinpose.record.emulate.vicon_motion import MarkerMotion, generated_motion, motion_of_c3d
from cabinpose.record.sources import vicon_protocol as vicon
from cabinpose.record.sources.vicon import ViconSettings, ViconSource
from cabinpose.record.sources.vicon_messages import FrameAccount, PacketDecoder, quaternion_wxyz
from cabinpose.record.sources.vicon_protocol import Packet, PacketSplitter, SegmentInfo, SubjectInfo, Type
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import Channels, Counts, Facts, FrameSource, Markers, Sample, SegmentPoses

PATIENCE_S = 20.0


def motion(subjects: tuple[str, ...] = ("S01", "S02"), rate_hz: float = 200.0) -> MarkerMotion:
    return generated_motion(rng=np.random.default_rng(1), rate_hz=rate_hz, seconds=0.4, subjects=subjects)


@contextmanager
def opened(emulator: ViconEmulator, clock: HostClock | None = None, **settings: object) -> Iterator[ViconSource]:
    source = ViconSource("vicon", ViconSettings(port=emulator.address[1], **settings), clock)
    source.open()
    try:
        yield source
    finally:
        source.close()


def read_until(source: ViconSource, enough: Callable[[list[Sample]], bool]) -> list[Sample]:
    samples: list[Sample] = []
    limit = time.monotonic() + PATIENCE_S
    while not enough(samples):
        assert time.monotonic() < limit, f"after {PATIENCE_S} s: {source.counts}"
        samples += source.read(0.05)
    return samples


def frames(samples: Sequence[Sample]) -> list[Sample]:
    return [sample for sample in samples if sample.sequence is not None]


def at_least(count: int) -> Callable[[list[Sample]], bool]:
    return lambda samples: len(frames(samples)) >= count


def of(sample: Sample, kind: type, subject: str | None = None) -> list:
    found = [message for message in sample.messages if isinstance(message, kind)]
    return [message for message in found if subject is None or message.subject == subject]


def test_it_is_a_source() -> None:
    source: FrameSource = ViconSource("v", ViconSettings(), HostClock())
    assert source.name == "v"
    assert ViconSource.Settings is ViconSettings


@pytest.mark.parametrize("up", ["z", "y"])
@pytest.mark.parametrize("mode", ["push", "pull"])
@pytest.mark.usefixtures("one_clock")
def test_what_is_shown_is_what_is_recorded(up: str, mode: str) -> None:
    seen = motion()
    settings = ViconEmulatorSettings(up=up, occlude_markers=0.2, occlude_segments=0.2, seed=3)
    with ViconEmulator(seen, settings) as emulator, opened(emulator, mode=mode) as source:
        samples = frames(read_until(source, at_least(40)))
    occluded = 0
    for sample in samples:
        packet = vicon.decode(vicon.payload(sample.raw))
        assert packet.frame == sample.sequence
        index = (sample.sequence - 1) % seen.frames
        truth = emulator.frame(sample.sequence)
        for identity, subject in enumerate(seen.subjects, 1):
            (poses,), (markers,) = of(sample, SegmentPoses, subject.name), of(sample, Markers, subject.name)
            assert (poses.names, markers.names) == (subject.segments, subject.markers)
            solved = np.isin(np.arange(len(poses.names)) + 1, truth.global_segments[identity]["segment"])
            np.testing.assert_allclose(poses.position_m[solved], subject.position_m[index][solved], atol=1e-9)
            turned = Rotation.from_quat(poses.orientation_wxyz[solved], scalar_first=True).as_matrix()
            np.testing.assert_allclose(turned, subject.rotation[index][solved], atol=1e-9)
            assert np.isnan(poses.position_m[~solved]).all()
            assert np.isnan(poses.orientation_wxyz[~solved]).all()
            rows = truth.labeled[truth.labeled["subject"] == identity]
            visible = np.isin(np.arange(len(markers.names)) + 1, rows["marker"])
            np.testing.assert_allclose(markers.position_m[visible], subject.marker_m[index][visible], atol=1e-9)
            assert np.isnan(markers.position_m[~visible]).all()
            assert np.isnan(markers.residual_m).all()
            occluded += int((~visible).sum() + (~solved).sum())
        (loose,) = of(sample, Markers, "")
        np.testing.assert_allclose(loose.position_m, seen.loose_m[index], atol=1e-9)
        assert loose.names == ("1", "2")
    assert 0.15 < occluded / (len(samples) * 2 * 60) < 0.25  # 20 segments and 40 markers each


@pytest.mark.usefixtures("one_clock")
def test_the_server_says_once_what_holds() -> None:
    with ViconEmulator(motion()) as emulator, opened(emulator) as source:
        samples = read_until(source, at_least(20))
    facts = {message.about: message.values for sample in samples for message in of(sample, Facts)}
    assert set(facts) == {"server", "stream", "subject S01", "subject S02"}
    assert sum(len(of(sample, Facts)) for sample in samples) == 4
    assert facts["stream"]["frame_rate_hz"] == 200.0
    assert facts["stream"]["server_up"] == "z"
    assert "address" not in facts["server"]  # of this computer
    segments = {row["name"]: row["parent"] for row in facts["subject S01"]["segments"]}
    assert segments["LowerBack"] is None
    assert segments["L_Elbow"] == "L_Humerus"
    assert {"name": "Head1", "segment": "Head"} in facts["subject S01"]["markers"]
    neutral = {row["name"]: row["position_m"] for row in facts["subject S01"]["neutral_pose"]}
    np.testing.assert_allclose(neutral["L_Tibia"], (0.0, 0.0, -0.42), atol=1e-9)  # in the thigh's frame
    assert set(CABINPOSE.maps["vicon_kinematic_fit"].values()) <= set(segments)


@pytest.mark.usefixtures("one_clock")
def test_a_server_on_another_computer_is_known_by_its_address() -> None:
    with ViconEmulator(motion(), ViconEmulatorSettings(host="127.0.0.2")) as emulator:
        with opened(emulator, host="127.0.0.2") as source:
            samples = read_until(source, at_least(2))
        assert {"address": f"127.0.0.2:{emulator.address[1]}"}.items() <= of(samples[0], Facts)[0].values.items()


@pytest.mark.usefixtures("one_clock")
def test_subjects_get_codes() -> None:
    with ViconEmulator(motion()) as emulator, opened(emulator, subjects={"S02": "P7"}) as source:
        samples = read_until(source, at_least(3))
    assert {message.subject for sample in samples for message in of(sample, Markers)} == {"S01", "P7", ""}
    assert {message.subject for sample in samples for message in of(sample, SegmentPoses)} == {"S01", "P7"}


@pytest.mark.real_data
@pytest.mark.usefixtures("one_clock")
def test_a_real_trial_is_streamed(real_data: Callable[[str], Path]) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    path = real_data("mocap/vicon_two_subjects.c3d")
    seen = motion_of_c3d(path)
    assert (seen.rate_hz, seen.frames) == (100.0, 580)
    points = ezc3d.c3d(str(path))["data"]["points"]
    with ViconEmulator(seen, ViconEmulatorSettings(rate_hz=200.0)) as emulator, opened(emulator) as source:
        samples = frames(read_until(source, at_least(30)))
    for sample in samples:
        box, person = of(sample, Markers, "boite")[0], of(sample, Markers, "Daphnee")[0]
        streamed = np.concatenate([box.position_m, person.position_m])
        np.testing.assert_allclose(streamed, points[:3, :, sample.sequence - 1].T / 1000, atol=1e-9)
    # The box is rigid: its segment carries its markers of the reference frame to where they are now.
    (box_motion,) = (subject for subject in seen.subjects if subject.name == "boite")
    first = int(np.isfinite(box_motion.marker_m).all(axis=2).sum(axis=1).argmax())
    local = box_motion.marker_m[first] - box_motion.position_m[first, 0]
    carried = (box_motion.rotation[:, 0] @ local.T).transpose(0, 2, 1) + box_motion.position_m
    assert np.nanmax(np.linalg.norm(carried - box_motion.marker_m, axis=2)) < 0.004
    poses = of(samples[-1], SegmentPoses, "boite")[0]
    assert poses.names == ("Root",)
    np.testing.assert_allclose(poses.position_m, box_motion.position_m[samples[-1].sequence - 1], atol=1e-9)


def test_time_stamps_say_what_they_are() -> None:
    settings, clock = ViconEmulatorSettings(latency_s=0.03, first_frame=1000), HostClock()
    with ViconEmulator(motion(), settings, clock) as emulator, opened(emulator, clock) as source:
        samples = frames(read_until(source, at_least(60)))
        network = source.network_s
    captured = {sent.frame: sent.captured_ns for sent in emulator.log}
    for sample in samples:
        assert sample.device_ns == (sample.sequence - 1) * 5_000_000  # 200 Hz, from the first frame on
        (channels,) = of(sample, Channels)
        values = dict(zip(channels.names, channels.values.tolist(), strict=True))
        assert values["latency_s"] == pytest.approx(0.03, abs=1e-12)
        assert values["latency Camera"] == pytest.approx(0.015, abs=1e-12)
        # Nothing arrives sooner than what the server reports after its capture; what is subtracted is never too much.
        assert sample.host_ns - round(values["latency_s"] * 1e9) >= captured[sample.sequence] - 1000
    assert samples[0].sequence >= 1000
    assert 0 < network < 1


def tracker(emulator: ViconEmulator, fate: str) -> list[int]:
    return [sent.frame for sent in emulator.log if sent.fate == fate]


def assert_exact(samples: list[Sample], source: ViconSource, emulator: ViconEmulator) -> None:
    """Between the first and the last frame that came, each is received or counted as lost, exactly once."""
    numbers = [vicon.decode(vicon.payload(sample.raw)).frame for sample in frames(samples)]
    assert numbers == [sample.sequence for sample in frames(samples)]
    span = range(numbers[0], numbers[-1] + 1)
    assert len(set(numbers)) == len(numbers) == source.counts.received
    assert source.counts.received + source.counts.lost == len(span)
    assert set(numbers) <= set(tracker(emulator, "sent"))
    assert source.counts.malformed == source.counts.duplicate == source.counts.reordered == 0


@pytest.mark.usefixtures("one_clock")
def test_dropped_frames_are_counted_exactly() -> None:
    emulator = ViconEmulator(motion(), ViconEmulatorSettings(drop=0.1, seed=4))
    with emulator, opened(emulator) as source:
        samples = read_until(source, at_least(200))
        emulator.stop()  # in order: all that was sent arrives
        while more := source.read(0.1):
            samples += more
    first, last = frames(samples)[0].sequence, frames(samples)[-1].sequence
    dropped = [frame for frame in tracker(emulator, "dropped") if first <= frame <= last]
    assert source.counts.lost == len(dropped) > 0
    assert [sample.sequence for sample in frames(samples)] == tracker(emulator, "sent")
    assert_exact(samples, source, emulator)


@pytest.mark.usefixtures("one_clock")
def test_a_server_that_dies_and_returns_loses_nothing_uncounted() -> None:
    emulator = ViconEmulator(motion(), ViconEmulatorSettings(drop=0.02))
    with emulator, opened(emulator) as source:
        samples = read_until(source, at_least(50))
        for _ in range(2):
            before = source.counts.restarts
            emulator.die()
            samples += read_until(source, lambda _: source._socket is None)
            emulator.revive()
            samples += read_until(source, lambda _, n=before: source.counts.restarts > n)
            samples += read_until(source, at_least(50))
    assert source.counts.restarts == 2
    assert source.counts.lost > 0
    assert_exact(samples, source, emulator)
    restarts = [message.values for sample in samples for message in of(sample, Facts) if message.about == "restart"]
    assert [(row["reconnected"], row["numbers"]) for row in restarts] == [(True, "continued")] * 2
    gaps = np.diff([sample.sequence for sample in frames(samples)]) - 1
    assert gaps.sum() == source.counts.lost
    assert all(row["lost"] in gaps for row in restarts)


@pytest.mark.usefixtures("one_clock")
def test_a_server_that_begins_anew_is_a_restart_and_no_loss() -> None:
    emulator = ViconEmulator(motion(), ViconEmulatorSettings(first_frame=100_000))
    with emulator, opened(emulator) as source:
        samples = read_until(source, at_least(50))
        emulator.die()
        samples += read_until(source, lambda _: source._socket is None)
        emulator.revive(anew=True)
        samples += read_until(source, lambda new: len(frames(new)) >= 10)
    assert source.counts.restarts == 1
    assert source.counts.lost == 0
    assert source.counts.received == len(frames(samples))
    sequences = [sample.sequence for sample in frames(samples)]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
    (restart,) = [message.values for sample in samples for message in of(sample, Facts) if message.about == "restart"]
    assert restart["numbers"] == "anew"
    device = [sample.device_ns for sample in frames(samples)]
    assert (np.diff(device) < 0).sum() == 1


@pytest.mark.usefixtures("one_clock")
def test_outages_come_by_themselves() -> None:
    settings = ViconEmulatorSettings(outages=(Outage(0.2, 0.3),))
    with ViconEmulator(motion(), settings) as emulator, opened(emulator) as source:
        samples = read_until(source, lambda _: source.counts.restarts == 1)
        samples += read_until(source, at_least(10))
    assert source.counts.lost > 0
    assert_exact(samples, source, emulator)


def test_several_clients_are_served_each_as_it_asks() -> None:
    with (
        ViconEmulator(motion()) as emulator,
        opened(emulator) as whole,
        opened(emulator, segments=False, unlabeled_markers=False) as markers,
        opened(emulator, mode="pull", labeled_markers=False) as slow,
    ):
        one = frames(read_until(whole, at_least(20)))
        two = frames(read_until(markers, at_least(20)))
        three = frames(read_until(slow, at_least(5)))
    assert len(one[0].messages) > len(two[0].messages)
    packet = vicon.decode(vicon.payload(two[-1].raw))
    assert packet.global_segments == {}
    assert packet.unlabeled is None
    assert packet.labeled is not None
    assert vicon.decode(vicon.payload(three[-1].raw)).labeled is None
    assert {sent.client for sent in emulator.log} == {0, 1, 2}


@pytest.mark.usefixtures("one_clock")
def test_check_says_what_is_missing() -> None:
    with ViconEmulator(motion()) as emulator:
        source = ViconSource("v", ViconSettings(port=emulator.address[1]))
        assert source.check() == []
        assert source.counts == Counts()
        named = ViconSettings(port=emulator.address[1], subjects={"S01": "S07", "Anna": "S08"})
        (problem,) = ViconSource("v", named).check()
        assert "tracks no Anna" in problem
        assert "it has: S01" in problem
    (problem,) = ViconSource("v", ViconSettings(port=emulator.address[1])).check()
    assert "refused" in problem
    empty = MarkerMotion(100.0, (), np.zeros((10, 0, 3)))
    with ViconEmulator(empty) as emulator:
        (problem,) = ViconSource("v", ViconSettings(port=emulator.address[1])).check()
    assert "no subject" in problem
    with ViconEmulator(motion(), ViconEmulatorSettings(drop=1.0)) as emulator:
        (problem,) = ViconSource("v", ViconSettings(port=emulator.address[1])).check()
    assert "no frames" in problem


@contextmanager
def server(talk: Callable[[socket.socket], None]) -> Iterator[int]:
    """A server that we did not write: one connection, one thread."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(PATIENCE_S)

        def run() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.settimeout(PATIENCE_S)
                talk(connection)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        yield listener.getsockname()[1]
        thread.join(PATIENCE_S)


def test_who_does_not_greet_is_no_server() -> None:
    done = threading.Event()
    with server(lambda _: done.wait(PATIENCE_S)) as port:
        source = ViconSource("v", ViconSettings(port=port, connect_timeout_s=0.3), HostClock())
        with pytest.raises(RecordingError, match="greet") as raised:
            source.open()
        assert raised.value.hint
        done.set()


def test_a_host_that_does_not_exist_is_an_error() -> None:
    source = ViconSource("v", ViconSettings(host="no host"), HostClock())
    with pytest.raises(RecordingError, match="no host"):
        source.open()
    with pytest.raises(RecordingError, match="not open"):
        source.read(0.0)


def test_malformed_packets_are_counted_and_kept() -> None:
    subject = SubjectInfo(1, "S", (SegmentInfo(0, 1, "Root"),))
    good = [Packet(frame=i) for i in range(4)]
    good[0].subjects, good[0].period = [subject], 1_350_000
    broken = bytearray(vicon.encode(Packet(frame=4, latency=(("a", 0.0),))))
    broken[-13:-9] = struct.pack("<I", 1 << 30)
    heard: list[Packet] = []

    def talk(connection: socket.socket) -> None:
        connection.sendall(vicon.encode(Packet(enums=frozenset({1, 2, 5, 9}))))
        splitter = PacketSplitter()
        while not any(packet.streaming is not None for packet in heard):
            heard.extend(vicon.decode(vicon.payload(raw)) for raw in splitter.feed(connection.recv(1000)))
        stream = b"".join(vicon.encode(packet) for packet in good)
        connection.sendall(stream + bytes(broken) + b"noise" * 9 + vicon.encode(Packet(frame=7)))
        connection.shutdown(socket.SHUT_WR)
        connection.recv(1000)

    with server(talk) as port:
        source = ViconSource("v", ViconSettings(port=port), HostClock())
        source.open()
        samples = read_until(source, lambda new: any(sample.sequence == 7 for sample in new))
        source.close()
    assert heard[0].enums == {1, 2, 5, 9}  # what we want, of what it has
    assert heard[1].streaming is True
    assert [sample.sequence for sample in frames(samples)] == [0, 1, 2, 3, 4, 7]
    assert source.counts == Counts(received=5, lost=2, malformed=2)  # the frame 4 is not lost; the noise may have been 5 and 6
    (kept,) = [sample for sample in samples if sample.sequence == 4]
    assert (kept.raw, kept.messages) == (bytes(broken), ())


def test_the_emulator_answers_as_the_sdks_client_expects() -> None:
    """The order of the SDK's client: it may ask before it has said what it wants, and change its mind between frames."""
    emulator = ViconEmulator(motion(("S",)), ViconEmulatorSettings(first_frame=5))
    with emulator, socket.create_connection(emulator.address, PATIENCE_S) as client:
        splitter, packets = PacketSplitter(), []

        def next_packet() -> Packet:
            while not packets:
                packets.extend(splitter.feed(client.recv(1 << 16)))
            return vicon.decode(vicon.payload(packets.pop(0)))

        offered = next_packet().enums
        assert offered is not None
        assert {1, 2, 5, 6, 7, 8, 9, 26, 28, 36, 37, 39, 42, 100004} <= offered
        assert not {100001, 100002} & offered
        client.sendall(vicon.encode(Packet(streaming=False)))
        client.sendall(vicon.encode(Packet(enums=frozenset({1, 2, 5, 100004}))))
        one = next_packet()
        assert (one.period, one.subjects[0].name, one.global_segments) == (675_000, "S", {})
        assert one.contents is not None
        assert one.contents.counts == {1: 1, 2: 1, 5: 1}
        client.sendall(vicon.encode(Packet(ping=77)))
        assert next_packet().ping == 77
        client.sendall(vicon.encode(Packet(enums=frozenset({1, 2, 5, 8, 9, 28, 36, 37, 39, 100004}))))
        client.sendall(vicon.encode(Packet(streaming=False)))
        two = next_packet()
        assert two.subjects == one.subjects  # statics again, since the set has changed
        assert (two.y_up, two.rates) == (False, {"Camera": 200.0})
        assert two.frame is not None
        assert two.frame > one.frame >= 5
        client.sendall(vicon.encode(Packet(streaming=False)))
        three = next_packet()
        assert (three.period, three.subjects) == (None, [])
        assert three.contents is not None
        assert three.contents.unchanged == {1, 2, 28, 37}
        # Global poses follow from the local ones along the parents, as the SDK works them out.
        parents = {segment.segment: segment.parent for segment in two.subjects[0].segments}
        local, world = ({int(r["segment"]): r for r in rows[1]} for rows in (three.local_segments, three.global_segments))
        for segment, parent in parents.items():
            turn, move = local[segment]["rotation"].reshape(3, 3), local[segment]["translation"]
            if parent:
                above = world[parent]["rotation"].reshape(3, 3)
                turn, move = above @ turn, above @ move + world[parent]["translation"]
            np.testing.assert_allclose(turn.ravel(), world[segment]["rotation"], atol=1e-9)
            np.testing.assert_allclose(move, world[segment]["translation"], atol=1e-6)
        client.sendall(b"no packet" * 3)
        client.sendall(vicon.encode(Packet(ping=78)))
        assert next_packet().ping == 78
    assert emulator.malformed == 1


def wait_for_frame(emulator: ViconEmulator, number: int) -> None:
    limit = time.monotonic() + PATIENCE_S
    while emulator._newest is None or emulator._newest[0] < number:
        assert time.monotonic() < limit
        time.sleep(0.005)


def test_the_emulator_answers_the_sdks_pre_fetch_mode() -> None:
    """The client asks for the next frame once, and again after each; it may do so before it has said what it wants."""
    with ViconEmulator(motion(("S",))) as emulator, socket.create_connection(emulator.address, PATIENCE_S) as client:
        splitter, packets = PacketSplitter(), []

        def next_packet() -> Packet:
            while not packets:
                packets.extend(splitter.feed(client.recv(1 << 16)))
            return vicon.decode(vicon.payload(packets.pop(0)))

        assert next_packet().enums is not None
        client.sendall(vicon.encode(Packet(next_frames=1)))
        client.sendall(vicon.encode(Packet(enums=frozenset({5, 42}))))
        numbers = [next_packet().frame]
        wait_for_frame(emulator, numbers[0] + 10)  # none of which it asks for
        client.sendall(vicon.encode(Packet(ping=1)))
        assert next_packet().ping == 1
        client.sendall(vicon.encode(Packet(next_frames=1)))
        numbers.append(next_packet().frame)
        client.sendall(vicon.encode(Packet(next_frames=3)))
        numbers += [next_packet().frame for _ in range(3)]
        wait_for_frame(emulator, numbers[-1] + 10)
        client.sendall(vicon.encode(Packet(ping=2)))
        assert next_packet().ping == 2
    assert numbers[0] >= 1
    assert numbers[1] > numbers[0] + 10, "the next one, not one that was captured before it asked"
    assert (np.diff(numbers[2:]) == 1).all()


def test_a_client_that_does_not_read_loses_frames_in_the_log_not_memory() -> None:
    seen = generated_motion(rng=np.random.default_rng(2), rate_hz=2000.0, seconds=0.1, subjects=tuple("ABCDEFGHIJ"))
    with ViconEmulator(seen) as emulator:
        source = ViconSource("v", ViconSettings(port=emulator.address[1]), HostClock())
        source.open()
        limit = time.monotonic() + PATIENCE_S
        while not tracker(emulator, "refused"):
            assert time.monotonic() < limit
            time.sleep(0.05)
        refused = len(tracker(emulator, "refused"))
        samples = read_until(source, lambda _: source.counts.lost >= refused)
        source.close()
    assert_exact(samples, source, emulator)


def test_the_emulators_address_must_be_free() -> None:
    with ViconEmulator(motion()) as emulator, pytest.raises(RecordingError) as raised:
        ViconEmulator(motion(), ViconEmulatorSettings(port=emulator.address[1])).start()
    assert "port" in (raised.value.hint or "")


def test_the_command(run: Callable[..., Any], tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    taken: list[Sample] = []
    over = threading.Event()

    def take() -> None:
        source = ViconSource("vicon", ViconSettings(port=port))
        while not over.is_set():  # until the command has begun to listen
            with contextlib.suppress(RecordingError):
                source.open()
                break
        while not over.is_set():
            taken.extend(source.read(0.05))
        source.close()

    thread = threading.Thread(target=take)
    thread.start()
    flags = ("--port", port, "--seconds", "2", "--rate-hz", "50", "--subjects", "2", "--drop", "0.1", "--json")
    code, out, err = run("emulate", "vicon", *flags, "--log", tmp_path / "sent.jsonl")
    over.set()
    thread.join(PATIENCE_S)
    assert code == 0
    assert f"streaming generated at 50 Hz, tcp 127.0.0.1:{port}" in err
    summary = json.loads(out)
    assert summary["clients"] == 1
    assert summary["refused"] == 0
    log = [json.loads(line) for line in (tmp_path / "sent.jsonl").read_text().splitlines()]
    sent = [line["frame"] for line in log if line["fate"] == "sent"]
    assert len(sent) == summary["sent"] > 0
    assert len(log) - len(sent) == summary["dropped"] > 0
    received = [sample.sequence for sample in frames(taken)]
    assert received == sent[: len(received)]
    assert received
    assert {"S01", "S02"} <= {message.subject for sample in taken for message in of(sample, Markers)}


def test_the_commands_mistakes(run: Callable[..., Any], tmp_path: Path) -> None:
    for flags, words in (
        (("--drop", "2"), "--drop: must be less than or equal to 1, not 2.0"),
        (("--motion", "dance"), "unknown motion 'dance'"),
        (("--motion", tmp_path / "none.c3d"), "does not exist"),
        (("--log", tmp_path), "cannot write"),
    ):
        code, out, err = run("emulate", "vicon", "--port", "0", *flags)
        assert (code, out) == (2, "")
        assert words in err
        assert "hint:" in err


# ------------------------------------------------------------------------------------------------------- the account


def account(numbers: list[int], rate_hz: float = 100.0) -> tuple[Counts, list]:
    counts = Counts()
    frame_account = FrameAccount(counts)
    return counts, [frame_account.arrive(number, 10_000_000 * i, rate_hz) for i, number in enumerate(numbers)]


def test_the_counter_wraps_without_loss() -> None:
    counts, arrivals = account([0xFFFFFFFE, 0xFFFFFFFF, 0, 2])
    assert counts.lost == 1
    assert [arrival.frame - 0xFFFFFFFE for arrival in arrivals] == [0, 1, 2, 4]
    assert [arrival.sequence - 0xFFFFFFFE for arrival in arrivals] == [0, 1, 2, 4]


def test_a_leap_that_time_does_not_explain_is_a_new_beginning() -> None:
    counts, arrivals = account([10, 5_000_000, 5_000_001, 3])
    assert counts.lost == 0
    assert [arrival.anew for arrival in arrivals] == [False, True, False, True]
    assert [arrival.sequence for arrival in arrivals] == [10, 11, 12, 13]


def test_the_same_frame_twice_is_a_duplicate() -> None:
    counts, arrivals = account([1, 2, 2, 3])
    assert counts == Counts(duplicate=1)
    assert [arrival.sequence for arrival in arrivals] == [1, 2, None, 3]


# ------------------------------------------------------------------------------------------------------- the meaning


def test_markers_of_unknown_subjects_are_not_lost() -> None:
    decoder = PacketDecoder()
    rows = np.zeros(2, vicon.LABELED)
    rows["subject"], rows["marker"], rows["position"] = (9, 1), (4, 2), [(1000, 0, 0), (2000, 0, 0)]
    decoder.statics(Packet(subjects=[SubjectInfo(1, "S", (), ((2, "C7"),))]))
    unknown, known = decoder.labeled(Packet(labeled=rows))
    assert (unknown.subject, unknown.names, unknown.position_m.tolist()) == ("", ("9/4",), [[1.0, 0.0, 0.0]])
    assert (known.subject, known.names, known.position_m.tolist()) == ("S", ("C7",), [[2.0, 0.0, 0.0]])


def test_subjects_that_leave_are_forgotten() -> None:
    decoder = PacketDecoder()
    decoder.statics(Packet(subjects=[SubjectInfo(1, "S")]))
    unchanged = vicon.Contents({Type.SUBJECT_INFO: 0}, frozenset({Type.SUBJECT_INFO}))
    decoder.statics(Packet(contents=unchanged))
    assert decoder.subjects == ("S",)
    decoder.statics(Packet(contents=vicon.Contents({Type.SUBJECT_INFO: 0})))
    assert decoder.subjects == ()


def test_orientations_of_a_server_with_y_up_are_the_sdks() -> None:
    """Its axis mapping is T R Tᵀ: a turn about the server's vertical axis is one about ours, and no turn is none."""
    decoder = PacketDecoder(up="y")
    info = SubjectInfo(1, "S", tuple(SegmentInfo(0, i, f"s{i}") for i in (1, 2, 3)))
    turns = [(0.0, 0.0, 0.0), (0.0, 0.3, 0.0), (0.1, 0.0, 0.2)]  # about x, y and z of the server
    rows = np.zeros(3, vicon.SEGMENT)
    rows["segment"], rows["rotation"] = (1, 2, 3), Rotation.from_rotvec(turns).as_matrix().reshape(-1, 9)
    rows["translation"][1] = (1000, 2000, 3000)
    (facts,) = decoder.statics(Packet(subjects=[info], neutral={1: rows}))
    (poses,) = decoder.poses(Packet(global_segments={1: rows}))
    expected = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.3), (0.1, -0.2, 0.0)]
    found = Rotation.from_quat(poses.orientation_wxyz, scalar_first=True).as_rotvec()
    np.testing.assert_allclose(found, expected, atol=1e-12)
    neutral = facts.values["neutral_pose"]
    in_facts = Rotation.from_matrix([np.reshape(row["rotation_row_major"], (3, 3)) for row in neutral]).as_rotvec()
    np.testing.assert_allclose(in_facts, expected, atol=1e-12)
    assert neutral[1]["position_m"] == poses.position_m[1].tolist() == [1.0, -3.0, 2.0]


def test_what_is_no_rotation_is_nan() -> None:
    good = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    bad = [good * 1.1, np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan), np.full((3, 3), 1e308), np.zeros((3, 3))]
    found = quaternion_wxyz(np.array([good, *bad]))
    assert np.isnan(found[1:]).all()
    np.testing.assert_allclose(Rotation.from_quat(found[0], scalar_first=True).as_matrix(), good, atol=1e-12)


def test_rotations_are_scipys_half_turns_too() -> None:
    rng = np.random.default_rng(0)
    half_turns = np.array([(np.pi, 0, 0), (0, np.pi, 0), (0, 0, np.pi), (0, 0, 0), np.array((1, 1, 1)) * np.pi / np.sqrt(3)])
    matrix = np.concatenate([Rotation.random(200, rng=rng).as_matrix(), Rotation.from_rotvec(half_turns).as_matrix()])
    found = quaternion_wxyz(matrix)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(Rotation.from_quat(found, scalar_first=True).as_matrix(), matrix, atol=1e-12)


def test_what_is_known_better_than_the_server() -> None:
    rows = np.zeros(1, vicon.UNLABELED)
    rows["position"] = (1000, 2000, 3000)
    (markers,) = PacketDecoder(up="y").unlabeled(Packet(unlabeled=rows))
    assert markers.position_m.tolist() == [[1.0, -3.0, 2.0]]
