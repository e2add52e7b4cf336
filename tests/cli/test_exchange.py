"""Files of other tools to recordings and back, through the commands: nothing of what a format holds is lost on the way."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from adtfdat_file import write_imu
from mvnx_file import moving_person, write_mvnx
from opensim_text import ZUP_FROM_YUP, read_sto, read_trc
from rosbag_file import bag, take
from scipy.spatial.transform import Rotation
from xdf_file import XdfStream, write_xdf

from cabinpose.core.skeleton import MVN_JOINTS, MVN_SEGMENTS
from cabinpose.signals.recorded import Channels, Facts, JointAngles, Markers, Message, Sample, SegmentPoses, ToFFrame
from cabinpose.store.convert import FORMATS, RecordingFormat
from cabinpose.store.convert.bvh import read_bvh_rows
from cabinpose.store.convert.bvh_write import write_bvh
from cabinpose.store.convert.c3d_write import write_c3d
from cabinpose.store.convert.recordings import read_entries
from cabinpose.store.recording import Chunking, Participant, Recording, RecordingWriter, Take

Run = Callable[..., Any]
Rows = list[tuple[int, int | None, Message]]
BEGAN = 1_700_000_000_000_000_000


def motion(frames: int = 12, subject: str = "S07") -> Rows:
    """A suit's frames at 60 Hz, as MVNX holds them."""
    rng = np.random.default_rng(1)
    person = moving_person(frames)
    rows: Rows = [(BEGAN, 0, Facts(subject, {"frame_rate_hz": 60.0}))]
    for i in range(frames):
        at = round(i * 1e9 / 60)
        host = BEGAN + round(at / 1e6) * 1_000_000  # the file has milliseconds
        angles = JointAngles(subject, tuple(name for name, _, _ in MVN_JOINTS), rng.normal(size=(22, 3)) * 0.1)
        poses = SegmentPoses(subject, MVN_SEGMENTS, *person[i])
        contacts = Channels((f"{subject}.foot_contact.left", f"{subject}.foot_contact.right"), np.array([i % 2.0, 1.0]))
        rows += [(host, at, message) for message in (poses, angles, contacts)]
    return rows


def markers(frames: int = 12) -> Rows:
    """An optical system's frames at 100 Hz, of one subject."""
    rng = np.random.default_rng(2)
    rows: Rows = [(0, 0, Facts("points", {"rate_hz": 100.0}))]
    for i in range(frames):
        place = (HIPS_AND_NECK_M + rng.normal(size=(3, 3)) / 100).astype(np.float32).astype(np.float64)
        place[i % 3] = np.nan if i % 4 == 0 else place[i % 3]
        residual = np.where(np.isnan(place[:, 0]), np.nan, 0.00025)
        rows.append((i * 10_000_000, i * 10_000_000, Markers("S07", ("LASI", "RASI", "C7"), place, residual)))
    return rows


HIPS_AND_NECK_M = np.array([[0.1, 0.12, 0.95], [0.1, -0.12, 0.95], [-0.05, 0.0, 1.45]])


def of(kind: type, rows: Rows) -> Rows:
    return [row for row in rows if isinstance(row[2], kind)]


def xdf_file(path: Path) -> Path:
    stamps = 100 + np.arange(20) / 50
    values = np.random.default_rng(4).normal(size=(20, 2))
    offsets = np.array([[100.0, -3.5], [100.1, -3.5], [100.3, -3.5]])
    force = XdfStream("Force plate", "Force", 50.0, ("fx", "fz"), stamps, values, offsets)
    second = replace(force, name="Second", stamps_s=stamps + 0.005, values=values + 1)
    return write_xdf(path, [force, second], begun_ns=BEGAN)


MAKE: dict[str, Callable[[Path], object]] = {
    "mvnx": lambda path: write_mvnx(path, motion()),
    "c3d": lambda path: write_c3d(path, markers()),
    "bvh": lambda path: write_bvh(path, of(SegmentPoses, motion())),
    "adtfdat": lambda path: write_imu(path, [(0.5, -1.5, k) for k in range(5)]),
    "xdf": xdf_file,
    "rosbag2": lambda path: bag(path, take()),
}
NEEDS = {"bvh": ("--unit-m", 0.01)}
UNITS = {"bvh": 0.01}


def read(path: Path, name: str, *, unit_m: float | None = None, subjects: tuple[str, ...] = ()) -> Rows:
    """What the format's reader says."""
    options = {} if unit_m is None else {"unit_m": unit_m}
    return [entry[1:] for entry in read_entries(path, name, subjects, **options)]


def in_recording(path: Path) -> Rows:
    with Recording(path) as recording:
        return [(s.host_ns, s.device_ns, m) for _, s in recording.samples() for m in s.messages]


def same(one: Any, other: Any, atol: float = 0.0) -> None:
    assert type(one) is type(other)
    for each in fields(one):
        a, b = getattr(one, each.name), getattr(other, each.name)
        if each.name == "orientation_wxyz" and len(a):  # q and -q are one rotation
            a = a * np.sign((a * b).sum(axis=1, keepdims=True))
        if isinstance(a, np.ndarray):
            np.testing.assert_allclose(a, b, rtol=0, atol=atol)
        elif each.name != "values":
            assert a == b


def same_rows(ours: Rows, theirs: Rows, atol: float = 0.0, kinds: tuple[type, ...] = ()) -> None:
    if kinds:
        ours, theirs = ([row for row in rows if isinstance(row[2], kinds)] for rows in (ours, theirs))
    assert len(ours) == len(theirs) > 0
    for (host, device, message), (true_host, true_device, true) in zip(ours, theirs, strict=True):
        assert abs(host - true_host) <= 1000
        assert device == true_device
        same(message, true, atol)


def of_recordings(can: str) -> tuple[str, ...]:
    return tuple(name for name, form in FORMATS.items() if isinstance(form, RecordingFormat) and form.can(can))


def test_every_format_of_recordings_is_tried() -> None:
    assert set(MAKE) == set(of_recordings("read")) - {"azure-mkv"}
    assert of_recordings("write") == ("c3d", "bvh", "trc", "sto", "csv")


@pytest.mark.parametrize("name", sorted(MAKE))
def test_file_recording_file(run: Run, tmp_path: Path, name: str) -> None:
    if name == "adtfdat":
        pytest.importorskip("adtf_file")
    first, take, again = tmp_path / f"first.{name}", tmp_path / "take.mcap", tmp_path / f"again.{name}"
    MAKE[name](first)
    code, out, err = run("import", name, first, "--out", take, "--subject", "S07", *NEEDS.get(name, ()), "--json")
    assert code == 0, err
    told = json.loads(out)
    assert told["refused"] == 0
    with Recording(take) as recording:
        assert recording.take == Take(subjects=(Participant(code="S07"),))
        assert set(told["samples"]) == set(recording.sources)
    # What the reader says is in the recording, bit by bit.
    same_rows(in_recording(take), read(first, name, unit_m=UNITS.get(name), subjects=("S07",)))
    again_take = tmp_path / "again.mcap"
    assert run("import", name, first, "--out", again_take, "--subject", "S07", *NEEDS.get(name, ())).code == 0
    assert again_take.read_bytes() == take.read_bytes()  # same file, same bytes
    if name in of_recordings("write"):
        code, out, err = run("export", name, take, "--out", again)
        assert code == 0, err
        ours, theirs = (read(path, name, unit_m=UNITS.get(name), subjects=("S07",)) for path in (again, first))
        kinds = (SegmentPoses, JointAngles, Markers, Channels)
        same_rows(ours, theirs, atol=2e-6, kinds=kinds)  # single precision, or text of six decimals of a millimetre or degree
    made = {first.name, take.name, again_take.name} | ({again.name} if name in of_recordings("write") else set())
    assert {p.name for p in tmp_path.iterdir()} == made


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "file", "source"),
    [
        ("mvnx", "mocap/xsens_upper_body.mvnx", "suit"),
        pytest.param("c3d", "mocap/vicon_two_subjects.c3d", "optical", marks=pytest.mark.slow),
        ("bvh", "mocap/cmu_131_01.bvh", "motion"), ("azure-mkv", "tof/azure_kinect.mkv", "tof"),
    ],
)  # fmt: skip
def test_real_files(run: Run, real_data: Callable[[str], Path], tmp_path: Path, name: str, file: str, source: str) -> None:
    path, take = real_data(file), tmp_path / "take.mcap"
    done = run("import", name, path, "--out", take, "--action", "walk", "--car", "lab")
    assert done.code == 0, done.err
    rows = read(path, name)
    same_rows(in_recording(take), rows)
    with Recording(take) as recording:
        assert (recording.sources, recording.take.action, recording.take.car) == ((source,), "walk", "lab")
    if name not in of_recordings("write"):
        return
    again = tmp_path / f"again.{name}"
    done = run("export", name, take, "--out", again)
    assert done.code == 0, done.err
    kinds = (SegmentPoses, JointAngles, Markers, Channels)
    same_rows(read(again, name, unit_m=UNITS.get(name)), rows, atol=2e-4 if name == "bvh" else 1e-5, kinds=kinds)


def recording(path: Path, *more: tuple[str, Sample]) -> Path:
    """A suit of two people, late by one frame, an optical system and a camera."""
    rows = motion() + motion(subject="S08")
    order = sorted(range(len(rows)), key=lambda i: (rows[i][0], i))
    order[20], order[23] = order[23], order[20]
    image = np.full((2, 3), 7, np.uint16)
    frame = ToFFrame(image, 0.001, image, np.zeros((0, 0), np.uint8), np.eye(3), np.zeros(5), np.zeros(5))
    with RecordingWriter(path, Take(), started_ns=BEGAN, chunking=Chunking(sync_s=0)) as writer:
        for i in order:
            writer.write("suit", Sample(i, rows[i][0], rows[i][1], b"", (rows[i][2],)))
        for host_ns, device_ns, message in markers():
            writer.write("optical", Sample(None, BEGAN + host_ns, device_ns, b"", (message,)))
        writer.write("tof", Sample(0, BEGAN, 5, b"", (frame,)))
        for source, sample in more:
            writer.write(source, sample)
    return path


def test_one_subject_of_several_and_late_messages(run: Run, tmp_path: Path) -> None:
    take = recording(tmp_path / "take.mcap")
    done = run("export", "sto", take, "--out", tmp_path / "a.sto")
    assert done.code == 2
    assert "S07, S08" in done.err
    assert "--subject" in done.err
    done = run("export", "sto", take, "--out", tmp_path / "a.sto", "--subject", "S08", "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["files"] == [str(tmp_path / "a.sto")]
    _, times, found = read_sto(tmp_path / "a.sto")
    poses = of(SegmentPoses, motion(subject="S08"))
    np.testing.assert_allclose(times, [row[1] / 1e9 for row in poses], atol=1e-3)
    for quaternions, (_, _, message) in zip(found, poses, strict=True):
        ours, theirs = (Rotation.from_quat(q, scalar_first=True) for q in (message.orientation_wxyz, quaternions))
        upright = Rotation.from_matrix(ZUP_FROM_YUP)
        assert (ours.inv() * upright * theirs).magnitude().max() < 1e-6
    done = run("export", "bvh", take, "--out", tmp_path / "a.bvh", "--subject", "S07")
    assert done.code == 0, done.err
    assert len(of(SegmentPoses, list(read_bvh_rows(tmp_path / "a.bvh")))) == 12


def test_a_span_a_rate_and_angles(run: Run, tmp_path: Path) -> None:
    take = recording(tmp_path / "take.mcap")
    done = run("export", "trc", take, "--out", tmp_path / "a.trc", "--span", "0.02", "0.06", "--rate-hz", "100")
    assert done.code == 0, done.err
    assert read_trc(tmp_path / "a.trc")[1].tolist() == pytest.approx([0.02, 0.03, 0.04, 0.05])
    done = run("export", "sto", take, "--out", tmp_path / "a.sto", "--subject", "S07", "--angles")
    assert done.code == 0, done.err
    assert read_sto(tmp_path / "a.sto")[2].shape == (12, 22 * 3)


def test_tables_of_chosen_sources(run: Run, tmp_path: Path) -> None:
    take = recording(tmp_path / "take.mcap")
    done = run("export", "csv", take, "--out", tmp_path / "csv", "--source", "optical", "tof")
    assert done.code == 0, done.err
    assert {p.name for p in (tmp_path / "csv").iterdir()} == {"optical.markers.csv", "optical.facts.csv", "tof.frames.csv"}
    assert "is not empty" in run("export", "csv", take, "--out", tmp_path / "csv").err
    assert run("export", "csv", take, "--out", tmp_path / "csv", "--overwrite").code == 0
    assert (tmp_path / "csv" / "suit.poses.csv").exists()


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, a folder, an MVNX file that was cut off after whole frames, a BVH file without motion; read only."""
    folder = tmp_path_factory.mktemp("inputs")
    recording(folder / "take.mcap")
    (folder / "folder").mkdir()
    write_mvnx(folder / "a.mvnx", motion())
    (folder / "a.mvnx").write_bytes((folder / "a.mvnx").read_bytes()[:-300])
    (folder / "a.bvh").write_text("HIERARCHY\n")
    return folder


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("export", "coco", "take.mcap", "--out", "x"), "recordings go to c3d, bvh, trc, sto, csv"),
        (("export", "fbx", "take.mcap", "--out", "x"), "known: bvh"),
        (("export", "c3d", "folder", "--out", "x"), "datasets go to dataset, png-json"),
        (("export", "coco", "folder", "--out", "x", "--source", "suit"), "hint: --source is of c3d, bvh, trc, sto, csv"),
        (("export", "c3d", "take.mcap", "--out", "x", "--split", "a"), "hint: --split is of dataset, png-json"),
        (("export", "csv", "take.mcap", "--out", "x", "--subject", "S07"), "hint: --subject is of c3d, bvh, trc, sto"),
        (("export", "bvh", "take.mcap", "--out", "x", "--rate-hz", "60"), "hint: --rate-hz is of c3d, trc, sto"),
        (("export", "trc", "take.mcap", "--out", "x", "--rate-hz", "-1"), "more than 0"),
        (("export", "trc", "take.mcap", "--out", "x", "--angles"), "hint: --angles is of sto"),
        (("export", "c3d", "take.mcap", "--out", "x", "--source", "plate"), "it has: optical, suit, tof"),
        (("export", "c3d", "take.mcap", "--out", "x", "--source", "tof"), "sources that have some: optical"),
        (("export", "c3d", "take.mcap", "--out", "take.mcap", "--overwrite"), "the recording itself"),
        (("export", "c3d", "gone.mcap", "--out", "x"), "gone.mcap"),
        (("export", "mvnx", "take.mcap", "--out", "x"), "cannot be written"),
        (("import", "trc", "a.mvnx", "--out", "x.mcap"), "cannot be read"),
        (("import", "mvnx", "a.mvnx", "--out", "x"), "--out FILE.mcap"),
        (("import", "mvnx", "a.mvnx", "--out", "take.mcap"), "take.mcap exists"),
        (("import", "fbx", "a.mvnx", "--out", "x.mcap"), "known: adtfdat"),
        (("import", "coco", "a.mvnx", "--out", "x.mcap"), "recordings are made of mvnx"),
        (("import", "coco", "a.mvnx", "--out", "x", "--subject", "S07"), "hint: --subject is of mvnx, c3d, bvh"),
        (("import", "mvnx", "a.mvnx", "--out", "x.mcap", "--keep-invalid"), "hint: --keep-invalid is of itop"),
        (("import", "mvnx", "a.mvnx", "--out", "x.mcap", "--up", "z"), "hint: --up is of c3d, bvh"),
        (("import", "mvnx", "a.mvnx", "--out", "x.mcap", "--topic", "/d"), "hint: --topic is of rosbag2"),
        (("import", "mvnx", "a.mvnx", "--out", "x.mcap", "--every", "2"), "hint: --every is of ntu, ticam"),
        (("import", "mvnx", "a.mvnx", "--out", "x.mcap", "--subject", "Anna"), "--subject: a code has a digit"),
        (("import", "bvh", "a.bvh", "--out", "x.mcap", "--begun", "noon"), "2026-11-21"),
        (("import", "bvh", "a.bvh", "--out", "x.mcap"), "MOTION"),
        (("import", "bvh", "gone does not exist", "--out", "x.mcap"), "gone"),
        (("import", "mvnx", "a.mvnx", "--out", "x.mcap"), "no whole MVNX"),
        (("import", "mvnx", "a.mvnx", "--out", "nowhere/x.mcap"), "nowhere"),
    ],
)
def test_mistakes(
    run: Run, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(shutil.copytree(inputs, tmp_path, dirs_exist_ok=True))
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert "hint: " in err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.bvh", "a.mvnx", "folder", "take.mcap"]
    assert (tmp_path / "take.mcap").read_bytes() == (inputs / "take.mcap").read_bytes()


def test_overwriting_keeps_what_was_there_until_the_new_is_whole(run: Run, tmp_path: Path) -> None:
    take = recording(tmp_path / "take.mcap")
    before = take.read_bytes()
    (tmp_path / "cut.mvnx").write_text("<mvnx>")
    assert run("import", "mvnx", tmp_path / "cut.mvnx", "--out", take, "--overwrite").code == 2
    assert take.read_bytes() == before
    write_mvnx(tmp_path / "a.mvnx", motion())
    done = run("import", "mvnx", tmp_path / "a.mvnx", "--out", take, "--overwrite", "--name", "left")
    assert done.code == 0, done.err
    with Recording(take) as made:
        assert made.sources == ("left",)
    done = run("export", "bvh", take, "--out", tmp_path / "a.bvh")
    assert done.code == 0, done.err
    assert "exists" in run("export", "bvh", take, "--out", tmp_path / "a.bvh").err
    assert run("export", "bvh", take, "--out", tmp_path / "a.bvh", "--overwrite").code == 0


def test_take_files_and_times_of_day(run: Run, tmp_path: Path) -> None:
    write_bvh(tmp_path / "a.bvh", of(SegmentPoses, motion()))
    (tmp_path / "take.yaml").write_text("action: reach\nsubjects: [{code: S09, seat: driver, consent: C-3}]\n")
    flags = ("--out", tmp_path / "take.mcap", "--take", tmp_path / "take.yaml")
    done = run("import", "bvh", tmp_path / "a.bvh", *flags, "--begun", "2023-11-14T23:13:20+01:00")
    assert done.code == 0, done.err
    with Recording(tmp_path / "take.mcap") as made:
        assert made.take.subjects == (Participant(code="S09", seat="driver", consent="C-3"),)
        assert made.head.started_ns == BEGAN
    assert {row[2].subject for row in of(SegmentPoses, in_recording(tmp_path / "take.mcap"))} == {"S09"}  # type: ignore[union-attr]
    assert "take.yaml already" in run("import", "bvh", tmp_path / "a.bvh", *flags, "--action", "x").err


def test_files_of_others_get_names_and_times(run: Run, tmp_path: Path) -> None:
    xdf_file(tmp_path / "a.xdf")
    assert run("import", "xdf", tmp_path / "a.xdf", "--out", tmp_path / "take.mcap").code == 0
    with Recording(tmp_path / "take.mcap") as made:
        assert made.sources == ("force-plate", "second")
        hosts = [sample.host_ns for _, sample in made.samples()]
    assert hosts == sorted(hosts)
    assert hosts[0] == BEGAN


def test_a_c3d_file_whose_axis_is_wrong_and_whose_end_is_missing(run: Run, tmp_path: Path) -> None:
    names = ("head", "toe")
    at = np.array([[0.0, 0.1, 1.6], [0.0, 0.1, 0.05]])
    rows: Rows = [(k * 10**7, k * 10**7, Markers("", names, at, np.zeros(2))) for k in range(300)]
    path, take = write_c3d(tmp_path / "a.c3d", rows), tmp_path / "a.mcap"
    whole = path.read_bytes()
    wrong = whole.replace(b"+Z", b"-Z", 1)
    path.write_bytes(wrong[: len(wrong) - 2048])
    arguments = ("import", "c3d", path, "--out", take, "--overwrite", "--subject", "S07")
    refused = run(*arguments)
    assert refused.code == 2
    assert "--keep-whole-frames" in refused.err
    done = run(*arguments, "--keep-whole-frames")
    assert done.code == 0, done.err
    assert "warning: " in done.err
    assert "frames are taken" in done.err
    assert "POINT:Y_SCREEN says -z; if that is wrong, import it with --up" in done.err
    facts = next(m for _, _, m in in_recording(take) if isinstance(m, Facts) and m.about == "points")
    assert (facts.values["up"], facts.values["up_because"]) == ("z", "shoulders or head above hips or feet")
    path.write_bytes(whole)
    for up, height in (("-z", -1.6), ("y", 0.1)):
        assert run(*arguments, f"--up={up}").code == 0
        found = next(m for _, _, m in in_recording(take) if isinstance(m, Markers))
        assert found.subject == "S07"
        assert found.position_m[0, 2] == pytest.approx(height, abs=1e-6)
    write_bvh(tmp_path / "a.bvh", of(SegmentPoses, motion()))
    sideways = run("import", "bvh", tmp_path / "a.bvh", "--out", tmp_path / "b.mcap", "--up", "x")
    assert (sideways.code, "must be one of" in sideways.err) == (2, True)


def test_names_from_files_do_not_command_the_terminal(run: Run, tmp_path: Path) -> None:
    evil = "s\x1b[31mu\x9bi\rt\n"
    with RecordingWriter(tmp_path / "take.mcap") as writer:
        writer.write(evil, Sample(0, BEGAN, None, b"", (Channels((evil,), np.ones(1)),)))
        writer.write("other", Sample(0, BEGAN, None, b"", (Markers(evil, ("a",), np.ones((1, 3)), np.zeros(1)),)))
    shown = run("info", tmp_path / "take.mcap")
    assert shown.code == 0, shown.err
    assert "s[31muit" in shown.out
    refused = run("export", "trc", tmp_path / "take.mcap", "--out", tmp_path / "a.trc", "--subject", "S1")
    assert "s[31muit" in refused.err
    warned = run("export", "trc", tmp_path / "take.mcap", "--out", tmp_path / "a.trc", "--source", "nobody")
    assert "it has: " in warned.err
    for text in (shown.out, shown.err, refused.err, warned.err):
        assert all(character.isprintable() or character == "\n" for character in text)
