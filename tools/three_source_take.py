"""A take of three emulated sources on a bad day, and its account: every sample that was sent is in the file, or counted as lost.

    python tools/three_source_take.py DATASET --out FOLDER --seconds 300

A suit (MVN over UDP: datagrams lost and late, and once its process is stopped and goes on), an optical system (Vicon over TCP:
frames that never come, and once its process is killed and returns, its count having gone on) and a ToF camera (the frames of
DATASET, with losses and stalls) are recorded by `cabinpose record`. What the emulators wrote of what they sent is then held
against the recording. Prints one JSON object, with the recorder's memory (Linux); exits with 1 where an account does not come
out.

A sample is *sent* when its sender counted it, whether or not anybody listened. What precedes the first sample that came, or
follows the last, no receiver can know of: `outside`.
"""

from __future__ import annotations

import argparse
import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from cabinpose.record.sources import mvn_protocol, vicon_protocol
from cabinpose.store.recording import Recording
from cabinpose.store.recording.schemas import RAW

PATIENCE_S = 120.0  # for a process to begin, or to end
MVN_KINDS = (2, 23)
SOURCES = ("suit", "optical", "tof")


@dataclass(frozen=True)
class Plan:
    """What is recorded, for how long, and what goes wrong. Rates are samples a second; loss and late are shares."""

    dataset: Path
    out: Path
    seconds: float
    dead_s: float = 3.0
    loss: float = 0.01
    late: float = 0.02
    suit_hz: float = 60.0
    optical_hz: float = 100.0
    tof_hz: float = 30.0
    compression: str = "none"
    seed: int = 1
    memory_every_s: float = 10.0


@dataclass
class Sent:
    """What a sender counted: the keys of its samples in streams of rising numbers, and those that nobody was there to hear of."""

    streams: dict[Any, set[int]] = field(default_factory=dict)
    logged: int = 0


def take(plan: Plan) -> dict[str, Any]:
    """Record as planned into `plan.out`, a new folder, and give the accounts. RuntimeError where a process fails."""
    plan.out.mkdir(parents=True)
    with ExitStack() as stack:
        run = _Run(plan, stack)
        told, memory = run.record()
    accounts = dict(zip(SOURCES, accounts_of(plan, told["sources"]), strict=True))
    return {
        "seconds": told["seconds"],
        "bytes": told["bytes"],
        "exact": all(account["exact"] for account in accounts.values()),
        "sources": accounts,
        "counts": {name: {k: v for k, v in told["sources"][name].items() if isinstance(v, int)} for name in SOURCES},
        "memory_mb": _memory(memory),
    }


class _Run:
    """The processes of a take; they are gone when the stack is left."""

    def __init__(self, plan: Plan, stack: ExitStack) -> None:
        self.plan, self._stack = plan, stack
        self._memory: list[tuple[float, float]] = []

    def record(self) -> tuple[dict[str, Any], list[tuple[float, float]]]:
        """What `cabinpose record` told, and the recorder's memory (s, MB)."""
        plan = self.plan
        optical, port = self._optical(0, "optical-1", 1)
        counting_since = time.monotonic()
        suit_port = _free_port()
        self._rig(suit_port, port)
        recorder = self._start("recorder", "record", "--config", plan.out / "rig.yaml", "--out", plan.out / "take.mcap", "--json")
        _until(lambda: _size(plan.out / "take.mcap") > 1 << 14, recorder, "the recorder")
        began = time.monotonic()
        suit = self._suit(suit_port)
        self._watch(recorder, began, 0.3 * plan.seconds)
        optical.kill()
        optical.wait()
        self._watch(recorder, began, 0.3 * plan.seconds + plan.dead_s)
        # Its count has gone on meanwhile, as the frames of cameras do; the process began to count a little after it was started.
        number = 1 + int((time.monotonic() - counting_since) * plan.optical_hz)
        optical, _ = self._optical(port, "optical-2", number, began + plan.seconds - time.monotonic())
        self._watch(recorder, began, max(0.6 * plan.seconds, time.monotonic() - began))
        suit.send_signal(signal.SIGSTOP)
        self._watch(recorder, began, time.monotonic() - began + plan.dead_s)
        suit.send_signal(signal.SIGCONT)
        self._watch(recorder, began, plan.seconds)
        for process in (suit, optical):
            process.wait(PATIENCE_S)
        self._watch(recorder, began, time.monotonic() - began + 1.0)
        recorder.send_signal(signal.SIGTERM)
        recorder.wait(PATIENCE_S)
        said = (plan.out / "recorder.out").read_text(encoding="utf-8")
        if recorder.returncode != 0 or not said:
            raise RuntimeError(f"the recorder ended with {recorder.returncode}: {(plan.out / 'recorder.err').read_text()}")
        return json.loads(said), self._memory

    def _rig(self, suit_port: int, optical_port: int) -> None:
        plan = self.plan
        faults = {
            "rate_hz": plan.tof_hz, "loss": plan.loss, "jitter_s": 0.003, "stall_every_s": 0.4 * plan.seconds,
            "stall_s": plan.dead_s, "clock_drift_ppm": 40.0, "seed": plan.seed,
        }  # fmt: skip
        rig = {
            "take": {"action": "trial", "subjects": [{"code": "S01"}]},
            "sources": {
                "suit": {"kind": "mvn", "port": suit_port, "required": False},  # both end before the recorder does
                "optical": {"kind": "vicon", "port": optical_port, "required": False},
                "tof": {
                    "kind": "simulated", "dataset": str(plan.dataset.resolve()), "log": "tof.jsonl", "queue_frames": 64,
                    "faults": faults,
                },
            },
            "storage": {"compression": plan.compression},
        }  # fmt: skip
        (plan.out / "rig.yaml").write_text(yaml.safe_dump(rig), encoding="utf-8")

    def _optical(self, port: int, name: str, first: int, seconds: float | None = None) -> tuple[subprocess.Popen[bytes], int]:
        """An optical system that listens, and its port."""
        plan = self.plan
        arguments = ["--port", port, "--rate-hz", plan.optical_hz, "--drop", plan.loss, "--first-frame", first]
        arguments += ["--seed", plan.seed, "--log", plan.out / f"{name}.jsonl"]
        arguments += () if seconds is None else ("--seconds", max(seconds, 0.1))
        process = self._start(name, "emulate", "vicon", *arguments)
        said = plan.out / f"{name}.err"
        _until(lambda: "streaming" in said.read_text(encoding="utf-8"), process, name)
        return process, int(said.read_text(encoding="utf-8").rsplit(":", 1)[1])

    def _suit(self, port: int) -> subprocess.Popen[bytes]:
        plan = self.plan
        flags = ["--port", port, "--kinds", *MVN_KINDS, "--rate-hz", plan.suit_hz, "--loss", plan.loss, "--reorder", plan.late]
        flags += ["--seconds", plan.seconds, "--seed", plan.seed, "--log", plan.out / "suit.jsonl"]
        return self._start("suit", "emulate", "mvn", *flags)

    def _start(self, name: str, *arguments: object) -> subprocess.Popen[bytes]:
        out, err = (self._stack.enter_context((self.plan.out / f"{name}.{end}").open("wb")) for end in ("out", "err"))
        process = subprocess.Popen([sys.executable, "-m", "cabinpose", *map(str, arguments)], stdout=out, stderr=err)
        self._stack.callback(_end, process)
        return process

    def _watch(self, recorder: subprocess.Popen[bytes], began: float, until_s: float) -> None:
        """Let time pass, up to `until_s` after the beginning, and look at the recorder."""
        while (now := time.monotonic() - began) < until_s:
            if recorder.poll() is not None:
                raise RuntimeError(f"the recorder ended early: {(self.plan.out / 'recorder.err').read_text()}")
            if not self._memory or now - self._memory[-1][0] >= self.plan.memory_every_s:
                self._memory.append((now, _resident_mb(recorder.pid)))
            time.sleep(min(0.2, until_s - now))


# ------------------------------------------------------------------------------------------------------------ accounts


def accounts_of(plan: Plan, counts: Mapping[str, Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """The account of each of `SOURCES`, from the logs, the file and what the recorder counted."""
    found = _in_file(plan.out / "take.mcap")
    sent = {"suit": _suit_sent(plan.out), "optical": _optical_sent(plan.out), "tof": _tof_sent(plan.out)}
    for name in SOURCES:
        yield account(sent[name], found[name], counts[name])


def account(sent: Sent, found: list[tuple[Any, int, int]], counts: Mapping[str, Any]) -> dict[str, Any]:
    """Each sample sent, by what became of it. found: stream, number and sequence of each sample in the file.

    `exact`: what is missing between the first and the last sample that came is what was counted as lost or dropped, and is
    as many gaps in the sequence; nothing is in the file twice, or was not sent. What was dropped after the last sample in the
    file (`dropped_at_end`) is outside, though it is counted.
    """
    numbers: dict[Any, set[int]] = {}
    for stream, number, _ in found:
        numbers.setdefault(stream, set()).add(number)
    missing = outside = foreign = 0
    for stream, every in sent.streams.items():
        here = numbers.get(stream, set())
        first, last = min(here, default=1), max(here, default=0)
        inside = {n for n in every if first <= n <= last}
        missing += len(inside - here)
        outside += len(every - inside)
        foreign += len(here - every)
    unique = sum(map(len, numbers.values()))
    sequences = {sequence for _, _, sequence in found}
    gaps = max(sequences, default=0) - min(sequences, default=1) + 1 - len(sequences)
    total = sum(map(len, sent.streams.values()))
    at_end = counts["lost"] + counts["dropped"] - missing
    exact = missing == gaps and 0 <= at_end <= min(counts["dropped"], outside) and not foreign and len(found) == unique > 0
    return {
        "sent": total, "in_file": unique, "missing": missing, "counted_lost": counts["lost"], "dropped": counts["dropped"],
        "dropped_at_end": at_end, "gaps_in_sequence": gaps, "outside": outside, "nobody_listened": total - sent.logged,
        "exact": exact,
    }  # fmt: skip


def _in_file(path: Path) -> dict[str, list[tuple[Any, int, int]]]:
    """Stream, number and sequence of the samples of each source, from their bytes as they came (ToF: the camera's time)."""
    found: dict[str, list[tuple[Any, int, int]]] = {name: [] for name in SOURCES}
    with Recording(path) as recording:
        for place, _, _, data in recording.records():
            if place.topic != RAW or place.sequence is None:
                continue
            key: tuple[Any, int | None]
            if place.source == "suit":
                header = mvn_protocol.read_header(bytes(data))
                key = (header.kind, header.character), header.sample
            elif place.source == "optical":
                key = 0, vicon_protocol.decode(vicon_protocol.payload(bytes(data))).frame
            else:
                key = 0, place.device_ns
            found[place.source].append((key[0], -1 if key[1] is None else key[1], place.sequence))
    return found


def _suit_sent(folder: Path) -> Sent:
    """Samples of each type of each character; each is one datagram here."""
    sent = Sent()
    for line in _lines(folder / "suit.jsonl"):
        if line["kind"] in mvn_protocol.COUNTED:
            sent.streams.setdefault((line["kind"], line["character"]), set()).add(line["counter"])
            sent.logged += 1
    return sent


def _optical_sent(folder: Path) -> Sent:
    """Frames by their number: the server counts on where no client is there to be logged."""
    logged = {line["frame"] for name in ("optical-1", "optical-2") for line in _lines(folder / f"{name}.jsonl")}
    return Sent({0: set(range(min(logged), max(logged) + 1))}, len(logged))


def _tof_sent(folder: Path) -> Sent:
    """Frames by the camera's time."""
    times = {line["device_ns"] for line in _lines(folder / "tof.jsonl")}
    return Sent({0: times}, len(times))


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    with path.open(encoding="utf-8") as file:
        for line in file:
            if line.endswith("\n"):  # a killed process may have been writing one
                yield json.loads(line)


# ----------------------------------------------------------------------------------------------------------- processes


def _memory(samples: list[tuple[float, float]]) -> dict[str, Any]:
    after = [mb for at, mb in samples if at >= 300.0] or [mb for _, mb in samples[1:]] or [0.0]
    values = [mb for _, mb in samples] or [0.0]
    return {"start": values[0], "later": after[0], "end": values[-1], "largest": max(values), "samples": len(values)}


def _resident_mb(pid: int) -> float:
    try:
        text = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1e3 for line in text.splitlines() if line.startswith("VmRSS")), 0.0)


def _until(ready: Callable[[], bool], process: subprocess.Popen[bytes], what: str) -> None:
    limit = time.monotonic() + PATIENCE_S
    while not ready():
        if process.poll() is not None or time.monotonic() > limit:
            raise RuntimeError(f"{what} does not begin")
        time.sleep(0.02)


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait()


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def main() -> int:
    """Record, print the accounts; 1 where one does not come out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, help="dataset whose frames the ToF camera sees")
    parser.add_argument("--out", type=Path, required=True, help="new folder for the take and the logs")
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--dead", type=float, default=5.0, help="how long the sources are away, s")
    parser.add_argument("--compression", default="none", choices=("none", "lz4", "zstd"))
    parser.add_argument("--delete", action="store_true", help="delete the recording afterwards")
    args = parser.parse_args()
    plan = Plan(args.dataset, args.out, args.seconds, dead_s=args.dead, compression=args.compression)
    result = take(plan)
    if args.delete:
        (plan.out / "take.mcap").unlink()
    print(json.dumps(result, indent=1))
    return 0 if result["exact"] else 1


if __name__ == "__main__":
    sys.exit(main())
