"""The journal of labels: what holds, what is kept through crashes and full disks, who may write."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from cabinpose.core.errors import DatasetError
from cabinpose.core.pose import Visibility
from cabinpose.store import open_dataset
from cabinpose.store.labels import JointLabel, Labels, read_labels, with_labels

PERSONS, JOINTS = ("driver", "front_passenger"), ("head", "neck")
HEAD = (3, "driver", "head")
A = JointLabel((10.0, 20.5), (0.1, 0.2, 0.9), Visibility.VISIBLE)
B = JointLabel((11.0, 21.5), (np.nan, np.nan, np.nan), Visibility.OCCLUDED)


def opened(path: Path) -> Labels:
    return Labels(path, "id", PERSONS, JOINTS)


def test_last_change_holds_and_history_stays(tmp_path: Path) -> None:
    path = tmp_path / "labels.jsonl"
    labels = opened(path)
    labels.set([(HEAD, A)], role="annotator", how="placed")
    labels.set([(HEAD, B)], role="reviewer", how="placed")
    assert labels.get(*HEAD) is B
    labels.close()
    again = opened(path)
    held = again.get(*HEAD)
    assert held is not None
    assert (held.uv, held.visibility) == (B.uv, B.visibility)
    assert np.isnan(held.xyz).all()
    assert [(c.role, c.how) for c in again.history] == [("annotator", "placed"), ("reviewer", "placed")]
    again.set([(HEAD, None)], role="annotator", how="undone")
    again.close()
    assert read_labels(path)[1] == {}


def test_line_cut_short_by_a_crash_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "labels.jsonl"
    labels = opened(path)
    labels.set([(HEAD, A)], role="annotator", how="placed")
    labels.close()
    whole = path.read_bytes()
    for cut in range(1, len(whole.splitlines(keepends=True)[-1]), 30):
        path.write_bytes(whole[:-cut])
        labels = opened(path)
        assert labels.history == []
        labels.set([(HEAD, B)], role="annotator", how="placed")
        labels.close()
        assert read_labels(path)[1][HEAD].uv == B.uv


def test_nothing_is_lost_when_the_process_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "labels.jsonl"
    writer = (
        "from cabinpose.store.labels import *\nfrom cabinpose.core.pose import Visibility\nimport sys, pathlib\n"
        "labels = Labels(pathlib.Path(sys.argv[1]), 'id', ('driver',), ('head',))\n"
        "for n in range(10**6):\n"
        "    labels.set([((n, 'driver', 'head'), JointLabel((n, n), (0, 0, 1), Visibility.VISIBLE))], role='a', how='placed')\n"
        "    print(n, flush=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", writer, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for _ in range(20):
        process.stdout.readline()
    os.kill(process.pid, signal.SIGKILL)
    told = 20 + len(process.stdout.read().split())
    process.wait()
    labels = opened_as(path)
    assert {key[0] for key in labels} >= set(range(told - 1))  # all that it said it had set, but maybe a number cut in half


def opened_as(path: Path) -> dict[tuple[int, str, str], JointLabel]:
    labels = Labels(path, "id", ("driver",), ("head",))  # the lock went with the process
    labels.close()
    return read_labels(path)[1]


def test_second_writer_is_told(tmp_path: Path) -> None:
    labels = opened(tmp_path / "labels.jsonl")
    with pytest.raises(DatasetError, match="open in another studio"):
        opened(tmp_path / "labels.jsonl")
    labels.close()
    opened(tmp_path / "labels.jsonl").close()


def test_a_file_system_without_locks_keeps_labels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr("fcntl.flock", refused)
    labels, other = opened(tmp_path / "labels.jsonl"), opened(tmp_path / "labels.jsonl")
    labels.set([(HEAD, A)], role="annotator", how="placed")
    with pytest.raises(DatasetError, match="was changed by another program"):
        other.set([(HEAD, B)], role="annotator", how="placed")
    assert read_labels(labels.path)[1][HEAD].uv == A.uv


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_full_disk_keeps_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    labels = opened(tmp_path / "labels.jsonl")
    labels.set([(HEAD, A)], role="annotator", how="placed")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("cabinpose.store.labels.os.fsync", full)
        with pytest.raises(DatasetError, match="No space left"):
            labels.set([(HEAD, B)], role="annotator", how="placed")
    assert labels.get(*HEAD) is A
    labels.close()
    assert read_labels(tmp_path / "labels.jsonl")[1][HEAD] == A


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}\n", "no labels of this version"),
        ("nonsense\n", "1: not a line of JSON"),
        ('{"format": "cabinpose-labels", "version": 1, "dataset": "other"}\n', "of another dataset"),
        ('{"format": "cabinpose-labels", "version": 1, "dataset": "id"}\n{"frame": 1}\n', "2: no label"),
        ('{"format": "cabinpose-labels", "version": 1, "dataset": "id"}\n[1]\n', "2: not a line of JSON"),
    ],
)
def test_damaged_journal_is_refused_and_left_as_it_is(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "labels.jsonl"
    path.write_text(text)
    with pytest.raises(DatasetError, match=message):
        opened(path)
    assert path.read_text() == text


def test_unknown_joint_writes_nothing(tmp_path: Path) -> None:
    labels = opened(tmp_path / "labels.jsonl")
    with pytest.raises(DatasetError, match="no tail of driver"):
        labels.set([(HEAD, A), ((3, "driver", "tail"), A)], role="annotator", how="placed")
    assert labels.history == []
    labels.close()
    assert len((tmp_path / "labels.jsonl").read_text().splitlines()) == 1


def test_labels_take_the_place_of_the_dataset_s_joints(dataset_folder: Path) -> None:
    dataset = open_dataset(dataset_folder)
    frame = int(dataset["frame"][1])
    changed = with_labels(dataset, {(frame, "driver", "neck"): A, (10**9, "driver", "neck"): B})
    at = {"frame": 1, "person": 0, "joint": [str(n) for n in dataset["joint"].values].index("neck")}
    assert changed["joints_2d"].isel(at).values.tolist() == pytest.approx(A.uv)
    assert changed["joints_3d"].isel(at).values.tolist() == pytest.approx(A.xyz)
    assert int(changed["visibility"].isel(at)) == A.visibility
    for name in ("joints_2d", "joints_3d", "visibility"):
        same = np.isclose(changed[name].values, dataset[name].values, equal_nan=True)
        assert (~same).sum() <= 3  # of one joint
        assert changed[name].dtype == dataset[name].dtype


def test_times_are_utc(tmp_path: Path) -> None:
    labels = opened(tmp_path / "labels.jsonl")
    labels.set([(HEAD, A)], role="annotator", how="placed")
    labels.close()
    row = json.loads((tmp_path / "labels.jsonl").read_text().splitlines()[1])
    assert row["time"].endswith("+00:00")
    assert row["time"][:4] == time.strftime("%Y", time.gmtime())
