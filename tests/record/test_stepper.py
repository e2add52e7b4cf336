"""A motor that turns a sensor in steps: what the emulator's shaft really did is held against what is recorded and evaluated."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from cabinpose.core.errors import ConfigError, RecordingError, SourceEndedError
from cabinpose.record.config import parse_rig
from cabinpose.record.emulate.mt import MtEmulator, MtEmulatorSettings
from cabinpose.record.emulate.mvn import MvnEmulator
from cabinpose.record.emulate.mvn_motion import SuitMotion
from cabinpose.record.emulate.mvn_streamer import _MOUNT_WXYZ, MvnEmulatorSettings
from cabinpose.record.emulate.stepper import StepperEmulator, StepperEmulatorSettings
from cabinpose.record.sources.stepper import StepperSettings, StepperSource
from cabinpose.signals.clock import HostClock
from cabinpose.store.recording import Recording, survey

# answer_s: emulator and recorder are threads of one busy process
QUICK: dict[str, Any] = {"steps": 3, "dwell_s": 0.2, "settle_s": 0.05, "speed_deg_s": 360.0, "answer_s": 2.0}
DIALECTS = ("grbl", "marlin")


def until(reached: Callable[[], bool]) -> None:
    """Wait for what another thread or process does, a minute at most."""
    limit = time.monotonic() + 60
    while not reached() and time.monotonic() < limit:
        time.sleep(0.01)


def source_of(emulator: StepperEmulator, **settings: Any) -> StepperSource:
    dialect = emulator.settings.dialect
    return StepperSource("motor", StepperSettings(port=emulator.port, dialect=dialect, **QUICK | settings), clock=HostClock())


def played(emulator: StepperEmulator, **settings: Any) -> dict[int, tuple[float, float]]:
    """The angle that the controller reports at each standstill, and that of the shaft."""
    found = {}
    source = source_of(emulator, **settings)
    source.open()
    try:
        while True:
            for sample in source.read(0.1):
                degrees, step = sample.messages[0].values
                if step >= 0:
                    found[int(step)] = (float(degrees), emulator.true_deg)
    except SourceEndedError:
        return found
    finally:
        source.close()


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("turn", [11.25, -11.25])
def test_the_shaft_is_where_the_source_says(dialect: str, turn: float) -> None:
    with StepperEmulator(StepperEmulatorSettings(dialect=dialect)) as emulator:
        found = played(emulator, step_deg=turn, home=True, steps_per_deg=80 / 9)
        assert list(found) == [0, 1, 2, 3]
        for step, (said, true) in found.items():
            assert said == pytest.approx(step * turn, abs=0.005)  # M114 has two digits
            assert true == pytest.approx(step * turn, abs=1e-9)
        assert emulator.true_deg == 0  # it went back
        assert emulator.stops == 0


def test_play_and_missed_steps_stay_unknown_to_the_controller() -> None:
    settings = StepperEmulatorSettings(backlash_deg=1.0, miss_every=3, miss_deg=0.5)
    with StepperEmulator(settings) as emulator:
        found = played(emulator, steps=4, back=True)
    said, true = np.array(list(found.values())).T
    np.testing.assert_allclose(said, [0, 11.25, 22.5, 33.75, 45, 33.75, 22.5, 11.25, 0], atol=1e-9)
    np.testing.assert_allclose(true - said, [0, 0, 0, -0.5, -0.5, 0.5, 1, 1, 1], atol=1e-9)


@pytest.mark.parametrize("dialect", ["grbl", pytest.param("marlin", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("error", "answers 'error:9' to G1 X22.5"),
        ("alarm", "answers 'ALARM:1' to G1 X22.5"),
        ("hang", "no answer within 2 s to 'G1 X22.5"),
        ("drop", "the line to the controller is lost"),
        ("garbage", "what comes is no text"),
    ],
)
def test_a_fault_ends_the_take_and_stops_the_motor(
    tmp_path: Path, run: Callable[..., Any], dialect: str, fault: str, said: str
) -> None:
    with StepperEmulator(StepperEmulatorSettings(dialect=dialect, fault=fault, fault_at=2)) as emulator:
        motor = {"kind": "stepper", "port": emulator.port, "dialect": dialect, **QUICK}
        (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"sources": {"motor": motor, "suit": {"kind": "numbered"}}}))
        done = run("record", "--config", tmp_path / "rig.yaml", "--out", tmp_path / "a.mcap")
        assert done.code == 2
        assert said in done.err
        assert "hint:" in done.err
        assert emulator.moves == 2  # nobody opened it again, to turn on
        own = fault in ("error", "alarm")  # the controller itself stops then
        expected = own + (0 if fault == "drop" else 2 if dialect == "grbl" else 1)
        until(lambda: emulator.stops >= expected)  # what the source sent last may not have been read yet
        assert emulator.stops == expected
    assert not survey(tmp_path / "a.mcap").damage.any


def test_ctrl_c_stops_the_motor_in_the_middle_of_a_move(tmp_path: Path) -> None:
    with StepperEmulator(StepperEmulatorSettings()) as emulator:
        motor = {"kind": "stepper", "port": emulator.port, **QUICK, "step_deg": 360.0, "steps": 1, "speed_deg_s": 9.0}
        (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"sources": {"motor": motor}}))
        command = [sys.executable, "-m", "cabinpose", "record", "--config", tmp_path / "rig.yaml", "--out", tmp_path / "a.mcap"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            until(lambda: emulator.true_deg >= 2.0)
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=60)
        assert process.returncode == 0
        assert emulator.stops >= 1
        stood = emulator.true_deg
        assert 2.0 <= stood < 200
        time.sleep(0.3)
        assert emulator.true_deg == stood


def test_nothing_turns_before_the_take_begins(tmp_path: Path, run: Callable[..., Any]) -> None:
    with StepperEmulator(StepperEmulatorSettings()) as emulator:
        motor = {"kind": "stepper", "port": emulator.port, **QUICK}
        rig = tmp_path / "rig.yaml"
        rig.write_text(yaml.safe_dump({"sources": {"motor": motor, "old": {"kind": "replay", "path": "gone.mcap"}}}))
        checked = run("record", "--config", rig, "--check", "--json")
        assert json.loads(checked.out)["findings"]["motor"] == []
        assert run("record", "--config", rig, "--out", tmp_path / "a.mcap").code == 2
        assert (emulator.moves, emulator.true_deg) == (0, 0.0)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"fault": "hang", "fault_at": 0}, "no answer within 2 s to a question for its state"),
        pytest.param({"fault": "garbage", "fault_at": 0}, "what comes is no text within 2 s", marks=pytest.mark.slow),
    ],
)
def test_a_controller_that_nobody_understands_is_not_begun_with(settings: dict[str, Any], said: str) -> None:
    with StepperEmulator(StepperEmulatorSettings(**settings)) as emulator:
        assert said in source_of(emulator).check()[0]
        with pytest.raises(RecordingError, match=said):
            source_of(emulator).open()


def test_what_a_rig_cannot_ask_for(tmp_path: Path) -> None:
    def rig(**settings: Any) -> Any:
        return parse_rig({"sources": {"motor": {"kind": "stepper", "port": "tty", **settings}}}, base=tmp_path).sources[0]

    with pytest.raises(ConfigError, match=r"36 steps of 11.25° lead to 405°, beyond limits_deg"):
        rig(steps=36)
    assert rig(steps=36, limits_deg=(0, 405)).settings.angles_deg[-1] == 405
    with pytest.raises(RecordingError, match="as a serial line") as missing:
        rig().build(HostClock()).open()
    assert "No such file" in str(missing.value)
    (tmp_path / "tty").write_text("")
    with pytest.raises(RecordingError, match="as a serial line"):
        rig().build(HostClock()).open()
    with pytest.raises(RecordingError, match="no serial line runs at 12345 baud"):
        rig(baud=12345).build(HostClock()).open()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mvn", "mt"])
def test_sse_finds_what_the_shaft_and_the_sensor_did(tmp_path: Path, run: Callable[..., Any], kind: str) -> None:
    """A suit's sensor, or a single one, on the shaft, whose own error is 2° sin θ; the truth is what the emulated shaft did."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    still = SuitMotion(60.0, np.zeros((3, 23, 3)), np.tile((1.0, 0, 0, 0), (3, 23, 1)))
    mount = Rotation.from_quat(_MOUNT_WXYZ if kind == "mvn" else (1, 0, 0, 0), scalar_first=True)  # of the emulated sensor
    over, truth = threading.Event(), []
    with StepperEmulator(StepperEmulatorSettings(backlash_deg=1.0, miss_every=3, miss_deg=0.5)) as emulator:

        def carry() -> None:
            while not over.wait(0.002):
                true = np.radians(emulator.true_deg)
                sensor = Rotation.from_rotvec((0, 0, true + np.radians(2) * np.sin(true)))
                still.orientation_wxyz[:] = (sensor * mount.inv()).as_quat(scalar_first=True)
                truth.append(np.degrees(true))

        motor = {"kind": "stepper", "port": emulator.port, **QUICK, "steps": 4, "back": True, "dwell_s": 0.7, "settle_s": 0.3}
        suit = {
            "mvn": lambda: MvnEmulator(MvnEmulatorSettings(port=port, kinds=(2, 23)), still),
            "mt": lambda: MtEmulator(MtEmulatorSettings(), still),
        }[kind]()
        suit.start()
        sensor = {"kind": "mvn", "host": "127.0.0.1", "port": port}
        if isinstance(suit, MtEmulator):
            sensor = {"kind": "mt", "port": suit.port, "sensors": {"Head": "03880C2A"}}
        (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"sources": {"motor": motor, "suit": sensor}}))
        threading.Thread(target=carry, daemon=True).start()
        done = run("record", "--config", tmp_path / "rig.yaml", "--out", tmp_path / "yaw.mcap")
        suit.stop()
        over.set()
    assert done.code == 0, done.err
    with Recording(tmp_path / "yaw.mcap") as recording:
        assert set(recording.sources) == {"motor", "suit"}
    judged = run("evaluate-mocap", "sse", f"yaw={tmp_path / 'yaw.mcap'}", "--sensor", "Head", "--samples", "10", "--json")
    assert judged.code == 0, judged.err
    record = json.loads(judged.out)
    ((steps, samples),) = [re.findall(r"\d+", note.removeprefix("yaw:")) for note in record["notes"]]
    assert int(steps) == 9
    assert 72 <= int(samples) <= 90  # ten a step, fewer where a busy machine comes late
    asked = np.array([0, 11.25, 22.5, 33.75, 45, 33.75, 22.5, 11.25, 0])
    true = asked + [0, 0, 0, -0.5, -0.5, 0.5, 1, 1, 1]  # by the play and the two missed moves
    assert all(np.abs(np.array(truth) - angle).min() < 1e-9 for angle in true)
    error = np.abs(true + 2 * np.sin(np.radians(true)) - asked)
    (row,) = [s for s in record["summaries"] if s["measure"] == "error about the axis"]
    assert row["mean"] == pytest.approx(error.mean(), abs=2e-4)  # single precision of the stream
    assert row["maximum"] == pytest.approx(error.max(), abs=2e-4)
