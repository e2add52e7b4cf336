"""Recordings in a wrong unit, order, axis or time are refused or told; the true ones beside them are not."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mvnx_file import moving_person, write_mvnx
from suit_rows import FRAMES, RATE_HZ, Poses, markers, rows_of

from cabinpose.core import CMU_UNIT_M, LENGTHS_M, MVN_JOINTS, RecordingError
from cabinpose.core.errors import CabinposeError, MocapError
from cabinpose.signals import Channels, Facts, Markers, Message, Sample, SegmentPoses
from cabinpose.store.convert import export_recording, import_recording, read_clip
from cabinpose.store.convert.bvh_write import write_bvh
from cabinpose.store.convert.c3d_write import write_c3d
from cabinpose.store.convert.rows import Row, checked
from cabinpose.store.recording import Recording, RecordingWriter, Take

CMU, MVNX, C3D = "mocap/cmu_131_01.bvh", "mocap/xsens_upper_body.mvnx", "mocap/vicon_two_subjects.c3d"


@pytest.fixture(scope="module")
def person() -> Poses:
    return moving_person(FRAMES, RATE_HZ)


@pytest.fixture(autouse=True)
def _told() -> Iterator[None]:
    """Every warning comes, as in a run of its own."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        yield


def bvh_in(path: Path, person: Poses, unit_m: float) -> Path:
    """A BVH file in a unit: `write_bvh` has centimetres."""
    write_bvh(path, rows_of(person, scale=0.01 / unit_m))
    return path


def mvnx_with(path: Path, rows: list[Row], change: Callable[[str], str] = str) -> Path:
    write_mvnx(path, rows)
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    return path


def c3d_with(path: Path, rows: list[Row], units: list[str]) -> Path:
    """A C3D file whose POINT:UNITS say something else than the mm that it is in; nothing for an empty list."""
    ezc3d = pytest.importorskip("ezc3d")
    write_c3d(path, rows)
    file = ezc3d.c3d(str(path))
    file["parameters"]["POINT"]["UNITS"]["value"] = units
    del file["data"]["meta_points"]
    file.write(str(path))
    return path


def stamped(stamp: Callable[[int], int]) -> Callable[[str], str]:
    """Other `time` for each frame of an MVNX file, without the index that corrects it and the computer's own."""
    count = iter(range(10**6))

    def change(text: str) -> str:
        return re.sub(r'time="\d+" index="\d+" ms="\d+"', lambda _: f'time="{stamp(next(count))}"', text)

    return change


def imported(path: Path, name: str, **options: Any) -> tuple[Any, list[str]]:
    """What came of an import, and what was warned of."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        made = import_recording(path, name, path.with_suffix(".mcap"), overwrite=True, **options)
    return made, [str(each.message) for each in told]


def poses_in(path: Path) -> np.ndarray:
    with Recording(path) as recording:
        return np.stack([m.position_m for _, s in recording.samples() for m in s.messages if isinstance(m, SegmentPoses)])


# ------------------------------------------------------------------------------------------------------------------- units


@pytest.mark.parametrize(
    ("unit_m", "name"), [(1.0, "m"), (0.01, "cm"), (0.001, "mm"), (0.0254, "inch"), (CMU_UNIT_M, "inch / 0.45")]
)
def test_the_unit_of_a_bvh_file_is_recognised_and_told(tmp_path: Path, person: Poses, unit_m: float, name: str) -> None:
    path = bvh_in(tmp_path / "a.bvh", person[:8], unit_m)
    made, told = imported(path, "bvh")
    assert told == []
    (body,) = made.bodies
    assert body.unit.startswith(name)
    assert "recognised by the body, whose stature is 1.7" in body.unit
    assert body.size.stature == pytest.approx(1.75, abs=0.06)
    np.testing.assert_allclose(poses_in(made.path)[:, 0], [position[0] for position, _ in person[:8]], atol=2e-5 * unit_m / 0.001)
    assert imported(path, "bvh", unit_m=unit_m)[1] == []


@pytest.mark.parametrize(("true_m", "given_m"), [(0.01, 0.001), (0.01, 1.0), (0.01, 0.0254), (0.001, 0.01), (1.0, 0.01)])
def test_a_bvh_file_beyond_a_persons_size_is_refused(tmp_path: Path, person: Poses, true_m: float, given_m: float) -> None:
    path = bvh_in(tmp_path / "a.bvh", person[:8], true_m)
    with pytest.raises(RecordingError, match=r"the stature by the lengths of limbs is .* possible are 0.45 to 2.6 m") as raised:
        imported(path, "bvh", unit_m=given_m)
    assert "unit" in str(raised.value.hint)
    assert not path.with_suffix(".mcap").exists()
    with pytest.raises(RecordingError, match="stature"):
        read_clip(path, unit_m=given_m, up="y")
    assert len(read_clip(path, unit_m=true_m, up="y")) == 8


def test_a_bvh_file_whose_size_tells_no_unit_needs_one(tmp_path: Path, person: Poses) -> None:
    """0.85 m in cm are 2.16 m in inches; 3 m in m are nobody's."""
    small = [(0.48 * position, wxyz) for position, wxyz in person[:4]]
    path = bvh_in(tmp_path / "a.bvh", small, 0.01)
    with pytest.raises(MocapError, match="BVH states no unit of length") as raised:
        imported(path, "bvh")
    assert "--unit-m" in str(raised.value.hint)
    _, told = imported(path, "bvh", unit_m=0.01)
    assert any("usual are 0.9 to 2.25 m" in each for each in told)


def test_a_bvh_file_with_another_axis_up_is_doubted(tmp_path: Path, person: Poses) -> None:
    path = bvh_in(tmp_path / "a.bvh", person[:8], 0.01)
    assert imported(path, "bvh")[1] == []
    (told,) = imported(path, "bvh", up="z")[1]
    assert "shoulders and head lie along -x from the hips" in told


@pytest.mark.parametrize(
    ("scale", "said"), [(1000.0, "if mm were read as m"), (100.0, "if cm were read as m"), (0.001, "if m were read as mm")]
)
def test_mvnx_positions_in_another_unit_are_refused(tmp_path: Path, person: Poses, scale: float, said: str) -> None:
    assert imported(mvnx_with(tmp_path / "true.mvnx", rows_of(person)), "mvnx")[1] == []
    with pytest.raises(RecordingError, match="the stature by the lengths of limbs is") as raised:
        imported(mvnx_with(tmp_path / "a.mvnx", rows_of(person, scale=scale)), "mvnx")
    assert said in str(raised.value)


@pytest.mark.parametrize(
    ("units", "said"),
    [(["m"], "if mm were read as m"), (["cm"], "if mm were read as cm"), (["in"], "stature")],
)
def test_c3d_with_another_unit_than_its_points_is_refused(tmp_path: Path, person: Poses, units: list[str], said: str) -> None:
    made, told = imported(c3d_with(tmp_path / "true.c3d", markers(person[:8]), ["mm"]), "c3d")
    assert told == []
    assert made.bodies[0].unit == "mm: POINT:UNITS"
    with pytest.raises(RecordingError, match="stature") as raised:
        imported(c3d_with(tmp_path / "a.c3d", markers(person[:8]), units), "c3d")
    assert said in str(raised.value)


def test_c3d_without_a_unit_is_recognised_and_told(tmp_path: Path, person: Poses) -> None:
    for scale, name in ((1.0, "mm"), (0.1, "cm"), (0.001, "m")):
        made, told = imported(c3d_with(tmp_path / f"{name}.c3d", markers(person[:8], scale), []), "c3d")
        assert "does not say its unit of length" in told[0]
        assert f"{name}: recognised by the body" in told[0]
        assert made.bodies[0].size.stature == pytest.approx(1.75, abs=0.06)


def test_markers_of_a_thing_that_are_too_far_or_too_fast_are_refused() -> None:
    """Names that tell nothing: a cap of four markers, 12 cm wide, 1.041 m from the origin."""
    cap = np.array([[0.0, 0, 0], [0.12, 0, 0], [0, 0.1, 0], [0, 0, 0.08]]) + (1.041, 0, 0)

    def taken(scale: float, away: float = 0.0, step_m: float = 0.001) -> list[Row]:
        return [
            (at, at, Markers("cap", tuple("abcd"), scale * cap + away + (step_m * i, 0, 0), np.zeros(4)))
            for i, at in ((i, i * 10_000_000) for i in range(30))
        ]

    def judged(rows: list[Row]) -> None:
        list(checked(Path("cap"), (("optical", *row) for row in rows)))

    judged(taken(1.0))
    with pytest.raises(RecordingError, match=r"its size is 156 m, .* if cm were read as m or mm were read as m"):
        judged(taken(1000.0))
    with pytest.raises(RecordingError, match="m from the origin: no optical system sees as far"):
        judged(taken(1.0, away=1000.0))
    with pytest.raises(RecordingError, match="points move at 100 m/s"):
        judged(taken(1.0, step_m=1.0))


# ------------------------------------------------------------------------------------------------------------- orientations


@pytest.mark.parametrize("norm", [0.0, 3.0, 0.9])
def test_quaternions_of_another_length_are_refused(tmp_path: Path, person: Poses, norm: float) -> None:
    with pytest.raises(RecordingError, match="quaternions have another length than 1"):
        imported(mvnx_with(tmp_path / "a.mvnx", rows_of(person, norm=norm)), "mvnx")


def test_quaternions_in_xyzw_order_are_refused(tmp_path: Path, person: Poses) -> None:
    """Still, too, and by positions alone, of segments whose axes nothing is known of."""
    xyzw = (1, 2, 3, 0)
    with pytest.raises(RecordingError, match="quaternions are xyzw, and were read as wxyz"):
        imported(mvnx_with(tmp_path / "a.mvnx", rows_of(person, order=xyzw)), "mvnx")
    still = [person[0]] * 20
    assert imported(mvnx_with(tmp_path / "still.mvnx", rows_of(still)), "mvnx")[1] == []
    with pytest.raises(RecordingError, match="the pelvis, spine and legs lie across the axes"):
        imported(mvnx_with(tmp_path / "a.mvnx", rows_of(still, order=xyzw)), "mvnx")

    def renamed(rows: list[Row]) -> Iterator[tuple[str, int, int | None, Message]]:
        """As Vicon's segments are, whose parents facts state."""
        segments = [{"name": f"my {child}", "parent": f"my {parent}"} for _, parent, child in MVN_JOINTS]
        yield "vicon", 0, 0, Facts("subject S07", {"segments": segments})
        for host, device, m in rows:
            if isinstance(m, SegmentPoses):
                yield (
                    "vicon",
                    host,
                    device,
                    SegmentPoses("S07", tuple(f"my {n}" for n in m.names), m.position_m, m.orientation_wxyz),
                )

    list(checked(Path("true"), renamed(rows_of(person))))
    with pytest.raises(RecordingError, match=r"segments move by .* quaternions are xyzw, and were read as wxyz"):
        list(checked(Path("wrong"), renamed(rows_of(person, order=xyzw))))


def recording_of(path: Path, rows: list[Row]) -> Path:
    """A recording made before anything was checked."""
    with RecordingWriter(path, Take(), started_ns=0) as writer:
        for host, device, message in rows:
            assert not writer.write("suit", Sample(None, host, device, b"", (message,)))
    return path


@pytest.mark.parametrize("norm", [0.0, 3.0])
@pytest.mark.parametrize("form", ["bvh", "sto"])
def test_exports_of_what_is_no_rotation_end_in_words(tmp_path: Path, person: Poses, form: str, norm: float) -> None:
    true = recording_of(tmp_path / "true.mcap", rows_of(person[:4]))
    assert "nan" not in export_recording(true, form, tmp_path / f"true.{form}")[0].read_text()
    wrong = recording_of(tmp_path / "a.mcap", rows_of(person[:4], norm=norm))
    with pytest.raises(RecordingError, match=rf"92 of 92\) of the quaternions have another length than 1, such as {norm:g}"):
        export_recording(wrong, form, tmp_path / f"a.{form}")
    assert not (tmp_path / f"a.{form}").exists()


# ------------------------------------------------------------------------------------------------------------------- stamps


@pytest.mark.parametrize(
    ("stamp", "said"),
    [
        (lambda i: 1000 * (1000 * i // 60), "and 60 are declared: they are 1000 times too large, so in another unit"),
        (lambda i: i // 60, "frames have the time stamp of the one before"),
        (lambda i: 0, "59 of 60 frames have the time stamp of the one before, where 60 frames a second are declared"),
        (lambda i: 10_000 - 1000 * i // 60, "59 of 60 frames have a time stamp before that of the frame before them"),
    ],
    ids=("µs for ms", "s for ms", "all equal", "backwards"),
)
def test_stamps_that_cannot_be_are_refused(tmp_path: Path, person: Poses, stamp: Callable[[int], int], said: str) -> None:
    true = mvnx_with(tmp_path / "true.mvnx", rows_of(person), stamped(lambda i: round(1000 * i / 60)))
    assert imported(true, "mvnx")[1] == []
    with pytest.raises(RecordingError, match=said):
        imported(mvnx_with(tmp_path / "a.mvnx", rows_of(person), stamped(stamp)), "mvnx")


@pytest.mark.parametrize(
    ("stamp", "rate_hz", "said"),
    [
        (lambda i: round(1000 * (i - (i % 15 == 14)) / 60), 60.0, "4 of 60 frames have the time stamp of the one before"),
        (lambda i: round(1000 * (i % 30) / 60) + 5000 * (i < 30), 60.0, "1 of 60 frames have a time stamp before"),
        (lambda i: round(1000 * i / 60), 100.0, "time stamps give 58.8235 frames a second, and 100 are declared"),
        (lambda i: round(1000 * (i + 30 * (i > 30)) / 60), 60.0, "frames are missing between the first and the last"),
    ],
    ids=("four equal", "a clock set back", "another rate", "a gap"),
)
def test_stamps_that_hardly_can_be_are_told(
    tmp_path: Path, person: Poses, stamp: Callable[[int], int], rate_hz: float, said: str
) -> None:
    _, told = imported(mvnx_with(tmp_path / "a.mvnx", rows_of(person, rate_hz=rate_hz), stamped(stamp)), "mvnx")
    assert any(said in each for each in told), told


def test_a_body_without_limbs_is_judged_by_its_size() -> None:
    """Hips and neck alone: 0.52 m apart."""
    for scale, wrong in ((1.0, False), (0.001, True), (1000.0, True)):
        points = scale * np.array([[0.1, 0.1, 0.95], [0.0, 0.0, 1.45]])
        entries = [("optical", 0, 0, Markers("S07", ("LASI", "C7"), points, np.zeros(2)))]
        if wrong:
            with pytest.raises(RecordingError, match=r"its size is .* possible are 0.3 to 3.2 m .* were read as"):
                list(checked(Path("hips"), entries))
        else:
            assert list(checked(Path("hips"), entries)) == entries


def test_equal_stamps_count_alike_everywhere(tmp_path: Path, person: Poses) -> None:
    """Four frames of one stamp are four samples, and in every series and table the first of them."""
    from cabinpose.app.mocap.inputs import read_motion
    from cabinpose.store.recording import segment_series, survey

    path = mvnx_with(tmp_path / "a.mvnx", rows_of(person, rate_hz=50.0), stamped(lambda i: 20 * max(i - 3, 0)))
    made, told = imported(path, "mvnx")
    assert any("3 of 60 frames have the time stamp of the one before" in each for each in told)
    assert made.samples == {"suit": 60}
    found = survey(made.path)
    assert (found.sources[0].samples, found.bodies[0].frames) == (60, 60)
    assert any("3 of 60 frames" in doubt.words for doubt in found.bodies[0].doubts)
    with Recording(made.path) as recording:
        series = segment_series(recording, "suit")
    kept = np.stack([person[i][0] for i in (0, *range(4, 60))])
    np.testing.assert_allclose(series.position_m, kept, atol=1e-6)
    with pytest.warns(UserWarning, match="the first of equal ones counts"):
        np.testing.assert_allclose(read_motion(path).position_m[:, :23], kept, atol=1e-6)
    text = export_recording(made.path, "bvh", tmp_path / "a.bvh")[0].read_text()
    assert "Frames: 57" in text
    table = export_recording(made.path, "sto", tmp_path / "a.sto")[0].read_text().split("endheader\n")[1]
    assert len(table.splitlines()) == 58


def test_a_frame_time_in_milliseconds_is_refused(tmp_path: Path, person: Poses) -> None:
    path = bvh_in(tmp_path / "a.bvh", person[:8], 0.01)
    path.write_text(re.sub(r"Frame Time: \S+", "Frame Time: 16.67", path.read_text()))
    with pytest.raises(RecordingError, match=r"time stamps give 0.06 frames a second, possible are 0.5") as raised:
        imported(path, "bvh")
    assert "seconds in BVH" in str(raised.value.hint)


def test_a_stream_in_another_unit_of_time_is_refused() -> None:
    """As XDF's, whose streams state their rate."""

    def stream(step_ns: int) -> list[tuple[str, int, int | None, Message]]:
        facts = Facts("stream", {"rate_hz": 50.0})
        return [("force", 0, 0, facts), *(("force", i * step_ns, i * step_ns, Channels(("fz",), np.zeros(1))) for i in range(50))]

    list(checked(Path("true.xdf"), stream(20_000_000)))
    with pytest.raises(RecordingError, match=r"force: time stamps give 0.05 frames a second, and 50 are declared"):
        list(checked(Path("wrong.xdf"), stream(20_000_000_000)))


# ------------------------------------------------------------------------------------------------------------ what is told


def test_import_and_info_state_unit_axes_and_stature(run: Callable[..., Any], tmp_path: Path, person: Poses) -> None:
    path, take = bvh_in(tmp_path / "a.bvh", person[:8], 0.0254), tmp_path / "take.mcap"
    done = run("import", "bvh", path, "--out", take, "--subject", "S07", "--json")
    assert done.code == 0, done.err
    for told in (json.loads(done.out), json.loads(run("info", take, "--json").out)):
        (body,) = told["bodies"]
        assert (body["subject"], body["unit"], body["up"], body["up_of_file"], body["doubts"]) == ("S07", "m", "z", "y", [])
        assert body["unit_of_file"].startswith("inch: recognised by the body, whose stature is 1.7")
        assert body["stature_m"] == pytest.approx(1.75, abs=0.06)
        assert "warnings" not in told
    shown = run("info", take).out
    assert "z (file: y)" in shown
    assert "m (file: inch: recognised" in shown


def test_info_doubts_what_was_recorded_before(run: Callable[..., Any], tmp_path: Path, person: Poses) -> None:
    assert run("info", recording_of(tmp_path / "true.mcap", rows_of(person))).err == ""
    done = run("info", recording_of(tmp_path / "a.mcap", rows_of(person, scale=1000.0, norm=3.0)), "--json")
    assert done.code == 0
    assert ["stature" in each or "another length than 1" in each for each in json.loads(done.out)["warnings"]] == [True, True]


# --------------------------------------------------------------------------------------------------------------- real files


def scaled_bvh(text: str, factor: float, frames: int) -> str:
    head, motion = text.split("MOTION")
    head = re.sub(
        r"(OFFSET)\s+(\S+)\s+(\S+)\s+(\S+)", lambda m: " ".join([m[1], *(f"{float(m[k]) * factor:.6f}" for k in (2, 3, 4))]), head
    )
    lines = motion.strip().splitlines()
    rows = [line.split() for line in lines[2 : 2 + frames]]
    rows = [[*(f"{float(x) * factor:.6f}" for x in row[:3]), *row[3:]] for row in rows]
    return "\n".join([head + "MOTION", f"Frames: {frames}", lines[1], *(" ".join(row) for row in rows)]) + "\n"


@pytest.mark.real_data
@pytest.mark.parametrize(("file", "form"), [(CMU, "bvh"), (MVNX, "mvnx"), pytest.param(C3D, "c3d", marks=pytest.mark.slow)])
def test_nothing_is_said_of_real_recordings(real_data: Callable[[str], Path], tmp_path: Path, file: str, form: str) -> None:
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        made = import_recording(real_data(file), form, tmp_path / "take.mcap")
    assert [str(each.message) for each in told] == []
    assert all(body.doubts == () for body in made.bodies)


@pytest.mark.real_data
@pytest.mark.parametrize("name", ["m", "cm", "mm", "inch"])
def test_a_real_bvh_file_in_any_unit(real_data: Callable[[str], Path], tmp_path: Path, name: str) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(scaled_bvh(real_data(CMU).read_text(), CMU_UNIT_M / LENGTHS_M[name], frames=20))
    made, told = imported(path, "bvh")
    assert told == []
    assert made.bodies[0].unit.startswith(f"{name}: recognised")
    with pytest.raises(CabinposeError, match=r"stature|size"):
        imported(path, "bvh", unit_m=10 * LENGTHS_M[name])


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("element", "change", "said"),
    [
        ("position", lambda v: v * 1000, "if mm were read as m"),
        ("orientation", lambda v: v * 0, "another length than 1"),
        ("orientation", lambda v: v * 3, "another length than 1"),
        ("orientation", lambda v: np.roll(v.reshape(-1, 4), -1, axis=1).ravel(), "quaternions are xyzw"),
    ],
    ids=("mm", "norm 0", "norm 3", "xyzw"),
)
def test_a_real_mvnx_file_made_wrong_is_refused(
    real_data: Callable[[str], Path], tmp_path: Path, element: str, change: Callable[[np.ndarray], np.ndarray], said: str
) -> None:
    def changed(match: re.Match[str]) -> str:
        return f"<{element}>{' '.join(f'{x:.6f}' for x in change(np.array(match[1].split(), float)))}</{element}>"

    path = tmp_path / "a.mvnx"
    path.write_text(re.sub(rf"<{element}>([^<]+)</{element}>", changed, real_data(MVNX).read_text()))
    with pytest.raises(RecordingError, match=said):
        imported(path, "mvnx")
