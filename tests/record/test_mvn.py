"""MVN over sockets on loopback: UDP and TCP, the kernel's buffer, a sender that dies and returns, the command."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cabinpose.core.errors import RecordingError
from cabinpose.record.emulate.mvn import MvnEmulator, Sent
from cabinpose.record.emulate.mvn_motion import generated, recorded
from cabinpose.record.emulate.mvn_streamer import MvnEmulatorSettings, Streamer
from cabinpose.record.sources import mvn_protocol as mvn
from cabinpose.record.sources.mvn import MvnSettings, MvnSource
from cabinpose.signals.recorded import FrameSource, Sample, SegmentPoses
from cabinpose.store.convert.mvnx import read_mvnx

MOTION = generated("seated")
PATIENCE_S = 120.0  # of a busy machine


def drain(source: MvnSource, done: Callable[[], bool], quiet_s: float = 0.3) -> list[Sample]:
    """Read until it is done and nothing more comes."""
    samples: list[Sample] = []
    limit = time.monotonic() + PATIENCE_S
    while time.monotonic() < limit:
        came = source.read(quiet_s)
        samples += came
        if not came and done():
            return samples
    pytest.fail("the stream does not end")


def over(emulator: MvnEmulator) -> bool:
    return emulator.join(0)


def test_it_is_a_source() -> None:
    source: FrameSource = MvnSource("suit", MvnSettings(port=0))
    assert source.name == "suit"


def test_udp_end_to_end_against_the_emulators_log() -> None:
    source = MvnSource("suit", MvnSettings(port=0))
    source.open()
    log: list[Sent] = []
    settings = MvnEmulatorSettings(
        port=source.address[1], rate_hz=400, kinds=(2, 23), characters=2, loss=0.02, duplicate=0.02, reorder=0.05, seed=3,
        items_per_datagram=12,
    )  # fmt: skip
    emulator = MvnEmulator(settings, MOTION, samples=300, log=log.append)
    emulator.start()
    samples = drain(source, lambda: over(emulator))
    source.close()
    emulator.stop()
    assert len(samples) == sum(sent.copies for sent in log)
    whole: dict[tuple[int, int, int], int] = {}
    for sent in log:
        if sent.kind in mvn.COUNTED:
            key = (sent.kind, sent.character, sent.counter)
            whole[key] = whole.get(key, 0) + (sent.copies == 0)
    received = sum(lost == 0 for lost in whole.values())
    assert source.counts.received == received
    ends = sum(
        any(s.copies for s in log if (s.kind, s.character, s.counter) == (k, c, n))
        for k in (2, 23)
        for c in (0, 1)
        for n in (0, 299)
    )
    assert ends == 8  # with this seed something arrives of each first and last sample: nothing is unknowable
    assert source.counts.lost == len(whole) - received
    assert (source.counts.malformed, source.counts.restarts, source.kernel_drops) == (0, 0, 0)
    poses = [s for s in samples if any(isinstance(m, SegmentPoses) for m in s.messages)]
    assert all(s.host_ns >= 0 and s.sequence is not None and s.device_ns % 10**6 == 0 for s in poses)
    sent_ns = {(s.character, s.counter): s.sent_ns for s in log if s.kind == 2 and s.piece == 1 and s.copies == 1 and not s.late}
    for sample in poses:
        header = mvn.read_header(sample.raw)
        at = sent_ns.get((header.character, header.sample))
        if at is not None and header.piece == 1:
            assert -2e6 < sample.host_ns - at < PATIENCE_S * 1e9


def test_clock_offset_drift_and_latency_are_seen() -> None:
    source = MvnSource("suit", MvnSettings(port=0))
    source.open()
    log: list[Sent] = []
    settings = MvnEmulatorSettings(
        port=source.address[1], rate_hz=100, latency_s=0.05, clock_offset_s=3, clock_drift_ppm=50_000, meta_every_s=0
    )
    emulator = MvnEmulator(settings, MOTION, samples=50, log=log.append)
    emulator.start()
    samples = drain(source, lambda: over(emulator))
    source.close()
    assert [s.device_ns // 10**6 for s in samples] == [round(3000 + n * 10 * 1.05) for n in range(50)]
    assert all(sent.sent_ns - sent.sampled_ns >= 50_000_000 for sent in log)


@pytest.mark.parametrize("transport", ["tcp", "connect"])
def test_tcp_in_both_directions_and_a_return(transport: str) -> None:
    """Over TCP nothing is lost while it lasts; a connection that breaks is waited for, and is one restart."""
    listening = MvnEmulator(MvnEmulatorSettings(transport="listen", port=0, rate_hz=500, kinds=(2, 20)), MOTION, samples=100)
    if transport == "tcp":
        source = MvnSource("suit", MvnSettings(port=0, transport="tcp"))
        source.open()
        lives = [
            MvnEmulator(
                MvnEmulatorSettings(transport="tcp", port=source.address[1], rate_hz=500, kinds=(2, 20)), MOTION, samples=100
            )
            for _ in range(2)
        ]
        samples = []
        for life in lives:
            life.start()
            samples += drain(source, lambda life=life: over(life))
    else:
        listening.start()
        port = listening.address[1]
        source = MvnSource("suit", MvnSettings(port=port, transport="connect"))
        source.open()
        samples = drain(source, lambda: over(listening))
        again = MvnEmulator(MvnEmulatorSettings(transport="listen", port=port, rate_hz=500, kinds=(2, 20)), MOTION, samples=100)
        again.start()
        samples += drain(source, lambda: over(again))
    source.close()
    assert (source.counts.received, source.counts.lost, source.counts.malformed, source.counts.restarts) == (400, 0, 0, 1)
    assert sum(any(isinstance(m, SegmentPoses) for m in s.messages) for s in samples) == 200


def test_a_stream_cut_anywhere_gives_the_same_datagrams() -> None:
    """TCP delivers in chunks of any size; rubbish between datagrams is skipped and counted."""
    datagrams = [d.data for n in range(20) for d in Streamer(MvnEmulatorSettings(kinds=(2, 12 + 8)), MOTION).sample(n)]
    for size in (1, 7, 760, 100_000):
        source, stream, cut = MvnSource("suit"), b"".join(datagrams), []
        for at in range(0, len(stream), size):
            cut += source._cut(stream[at : at + size])
        assert cut == datagrams
    source = MvnSource("suit")
    cut = source._cut(b"rubbish" + datagrams[0] + b"MXTP99 more rubbish, longer than a header" + datagrams[1])
    samples = [source.take(data, 0) for data in cut]
    assert b"".join(cut) == b"rubbish" + datagrams[0] + b"MXTP99 more rubbish, longer than a header" + datagrams[1]
    assert source.counts.malformed == 2
    assert sum(bool(s.messages) for s in samples) == 2


def test_a_hostile_stream_does_not_fill_memory() -> None:
    source = MvnSource("suit")
    header = mvn.build_header(mvn.Header(2, 0, 0, True, 23, 0, 0, 23, 0, 0, 0xFFFF))
    for _ in range(100):
        source._cut(header + bytes(30_000))
        assert len(source._waiting) <= 1 << 18
    for _ in range(100):
        source._cut(bytes(30_000))
    assert len(source._waiting) < 24


def test_the_kernels_drops_are_counted() -> None:
    """A buffer that overflows: what the kernel dropped is known from the kernel, and from the gaps, and they agree."""
    source = MvnSource("suit", MvnSettings(port=0, receive_buffer=16_384))
    source.open()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(source.address)
        streamer = Streamer(MvnEmulatorSettings(meta_every_s=0), MOTION)
        datagrams = [d.data for n in range(401) for d in streamer.sample(n)]
        for data in datagrams[:400]:
            sender.send(data)
        drain(source, lambda: True, 0.05)
        sender.send(datagrams[400])
        drain(source, lambda: True, 0.05)
    source.close()
    assert source.counts.lost > 100
    assert source.counts.received + source.counts.lost == 401
    assert source.kernel_drops == source.counts.lost


def test_arrival_is_the_kernels_not_the_readers() -> None:
    """What waited in the buffer is stamped with its arrival."""
    source = MvnSource("suit", MvnSettings(port=0))
    source.open()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        (datagram,) = Streamer(MvnEmulatorSettings(meta_every_s=0), MOTION).sample(0)
        sender.sendto(datagram.data, source.address)
    time.sleep(0.2)
    (sample,) = source.read(1.0)
    assert source._clock.now_ns() - sample.host_ns > 190_000_000
    source.close()


def test_reading_waits_no_longer_than_it_may() -> None:
    source = MvnSource("suit", MvnSettings(port=0))
    source.open()
    began = time.monotonic()
    assert source.read(0.05) == []
    assert source.read(0) == []
    assert time.monotonic() - began < PATIENCE_S
    source.close()
    source.close()
    with pytest.raises(RecordingError, match="not open"):
        source.read(0)


def test_it_listens_on_loopback_unless_told_otherwise() -> None:
    source = MvnSource("suit", MvnSettings(port=0))
    source.open()
    assert source.address[0] == "127.0.0.1"
    source.close()
    assert MvnEmulatorSettings().host == "127.0.0.1"


def test_what_keeps_it_from_opening_is_told() -> None:
    holder = MvnSource("suit", MvnSettings(port=0))
    holder.open()
    second = MvnSource("other", MvnSettings(port=holder.address[1]))
    with pytest.raises(RecordingError, match="cannot listen on") as caught:
        second.open()
    assert "another program" in str(caught.value.hint)
    assert "cannot listen on" in second.check()[0]
    holder.close()
    with pytest.raises(RecordingError, match="cannot connect to"):
        MvnSource("suit", MvnSettings(port=1, transport="connect")).open()
    assert "cannot connect to" in MvnSource("suit", MvnSettings(port=1, transport="connect")).check()[0]
    with pytest.raises(RecordingError, match="cannot listen on"):
        MvnSource("suit", MvnSettings(host="192.0.2.1", port=0)).open()


@pytest.mark.usefixtures("one_clock")
def test_the_check_before_a_take() -> None:
    """Silence is told with the remedy; a stream that runs is fine; a buffer that the system does not grant is told."""
    probe = MvnSource("suit", MvnSettings(port=0))
    probe.open()
    port = probe.address[1]
    probe.close()
    source = MvnSource("suit", MvnSettings(port=port))
    (silent,) = source.check()
    assert f"nothing arrives on 127.0.0.1:{port}" in silent
    emulator = MvnEmulator(MvnEmulatorSettings(port=port, rate_hz=100), MOTION)
    emulator.start()
    limit = time.monotonic() + PATIENCE_S
    while source.check():  # a busy machine may let the first pass in silence
        assert time.monotonic() < limit
    (small,) = MvnSource("suit", MvnSettings(port=port, receive_buffer=1 << 30)).check()
    assert "of 1073741824 bytes of buffer" in small
    emulator.stop()


def test_a_motion_from_a_file(real_data: Callable[[str], Path]) -> None:
    """The real recording streamed: what arrives is what the file holds."""
    path = real_data("mocap/xsens_upper_body.mvnx")
    motion = recorded(read_mvnx(path))
    assert (len(motion), round(motion.rate_hz)) == (112, 60)
    streamer = Streamer(MvnEmulatorSettings(meta_every_s=0), motion)
    source = MvnSource("suit")
    for n in range(112):
        (datagram,) = streamer.sample(n)
        (*_, pose) = source.take(datagram.data, 0).messages
        assert abs(pose.position_m - motion.position_m[n]).max() < 1e-6
    assert source.counts.received == 112
    with pytest.raises(RecordingError, match="fewer than three"):
        recorded([])


def test_the_command(run: Callable[..., Any], tmp_path: Path) -> None:
    source = MvnSource("suit", MvnSettings(port=0))
    source.open()
    flags = ("--port", source.address[1], "--seconds", "0.5", "--rate-hz", "100", "--kinds", "2", "23", "--loss", "0.1", "--json")
    code, out, err = run("emulate", "mvn", *flags, "--log", tmp_path / "sent.jsonl")
    assert code == 0
    assert f"streaming seated at 100 Hz, udp 127.0.0.1:{source.address[1]}" in err
    sent = json.loads(out)
    assert (sent["samples"], sent["datagrams"]) == (50, 103)
    log = [json.loads(line) for line in (tmp_path / "sent.jsonl").read_text().splitlines()]
    assert len(log) == 103
    assert sum(line["copies"] == 0 for line in log) == sent["lost"] > 0
    samples = drain(source, lambda: True)
    source.close()
    assert len(samples) == 103 - sent["lost"]


def test_the_commands_mistakes(run: Callable[..., Any], tmp_path: Path) -> None:
    for flags, words in (
        (("--loss", "2"), "--loss: must be less than or equal to 1, not 2.0"),
        (("--transport", "tcp", "--loss", "0.1"), "tcp neither loses"),
        (("--motion", "dance"), "unknown motion 'dance'"),
        (("--motion", str(tmp_path / "none.mvnx")), "does not exist"),
        (("--transport", "tcp", "--port", "1"), "cannot stream to"),
        (("--log", str(tmp_path)), "cannot write"),
    ):
        code, out, err = run("emulate", "mvn", *flags)
        assert (code, out) == (2, "")
        assert words in err
        assert "hint:" in err
