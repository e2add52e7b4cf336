"""C3D files of strangers: without subjects, cut off, and with parameters that an export keeps or names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cabinpose.core.errors import MocapError
from cabinpose.signals.recorded import Channels, Facts, Markers
from cabinpose.store.convert.c3d import read_c3d
from cabinpose.store.convert.c3d_write import write_c3d
from cabinpose.store.convert.recordings import export_recording, import_recording
from cabinpose.store.recording import Participant, Take

ezc3d = pytest.importorskip("ezc3d")
pytestmark = pytest.mark.filterwarnings("error")

CORNERS = np.array([[[0.0], [400.0], [400.0], [0.0]], [[5.0], [5.0], [5.0], [5.0]], [[0.0], [0.0], [600.0], [600.0]]])


def stranger(path: Path, frames: int = 8, labels: tuple[str, ...] = ("neck", "toe", "*3"), **groups: dict[str, Any]) -> Path:
    """A file whose y is up: by default markers of nobody, and more groups of parameters where they are given."""
    file = ezc3d.c3d()
    points = np.ones((4, len(labels), frames))
    points[:3] = np.array([[100.0, 1360, 50], [100, 45, 60], [500, 700, -300]])[: len(labels)].T[..., None] + np.arange(frames)
    file["data"]["points"] = points
    file["parameters"]["POINT"]["RATE"]["value"] = [50.0]
    file["data"]["analogs"] = np.arange(4.0 * frames).reshape(1, 2, 2 * frames)
    file["parameters"]["ANALOG"]["RATE"]["value"] = [100.0]
    point = {"LABELS": list(labels), "UNITS": ["mm"], "X_SCREEN": ["+X"], "Y_SCREEN": ["+Y"]}
    for group, members in {"POINT": point, "ANALOG": {"LABELS": ["fx", "fz"]}, **groups}.items():
        for name, value in members.items():
            file.add_parameter(group, name, value)
            if name == "CHANNEL":  # the library makes floats of integers
                file["parameters"][group][name].update(type=2, value=np.array(value))
    file.write(str(path))
    return path


def taken(*codes: str) -> Take:
    return Take(subjects=tuple(Participant(code=code) for code in codes))


def markers(path: Path) -> list[Markers]:
    return [message for _, _, message in read_c3d(path) if isinstance(message, Markers)]


def test_a_file_that_names_nobody_is_the_subjects(tmp_path: Path) -> None:
    path, take = stranger(tmp_path / "a.c3d"), tmp_path / "a.mcap"
    import_recording(path, "c3d", take, take=taken("S07"))
    for name in ("trc", "c3d"):
        export_recording(take, name, tmp_path / f"of.{name}", subject="S07")
    assert "neck\t\t\ttoe\t\t\n" in (tmp_path / "of.trc").read_text()
    assert {(m.subject, m.names) for m in markers(tmp_path / "of.c3d")} == {("S07", ("neck", "toe"))}


def test_several_codes_for_a_file_that_names_nobody(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="does not say whose its markers are, and 2 subjects are given") as raised:
        read_c3d(stranger(tmp_path / "a.c3d"), subjects=["S07", "S08"])
    assert raised.value.hint


def test_codes_come_in_the_order_of_the_file(tmp_path: Path) -> None:
    path = stranger(tmp_path / "a.c3d", labels=("B:neck", "A:toe", "*3"))
    rows = read_c3d(path, subjects=["S07", "S08"])
    assert {(m.subject, m.names) for _, _, m in rows if isinstance(m, Markers)} == {
        ("S07", ("neck",)), ("S08", ("toe",)), ("", ("3",))
    }  # fmt: skip


@pytest.mark.parametrize(
    ("codes", "told"),
    [(("S07",), "has no code for A, who keep their names"), (("S07", "S08", "S09"), "has 2 subjects: of S09 there is nothing")],
)
def test_too_few_and_too_many_codes_are_told(codes: tuple[str, ...], told: str, tmp_path: Path) -> None:
    path = stranger(tmp_path / "a.c3d", labels=("B:neck", "A:toe", "*3"))
    with pytest.warns(UserWarning, match=told):
        rows = list(read_c3d(path, subjects=codes))
    assert {m.subject for _, _, m in rows if isinstance(m, Markers)} == {"S07", codes[1] if codes[1:] else "A", ""}


def test_the_longest_prefix_tells_whose_a_marker_is(tmp_path: Path) -> None:
    labels = {"LABEL_PREFIXES": ["S1", "S10"], "NAMES": ["one", "ten"]}
    path = stranger(tmp_path / "a.c3d", labels=("S1neck", "S10toe", "*3"), SUBJECTS=labels)
    found = {(m.subject, m.names) for _, _, m in read_c3d(path) if isinstance(m, Markers)}
    assert found == {("one", ("neck",)), ("ten", ("toe",)), ("", ("3",))}


@pytest.mark.parametrize("name", ["trc", "c3d"])
@pytest.mark.parametrize(
    ("codes", "message", "hint"),
    [
        ((), "there are no markers of S09: nobody is named in the recording", "import the file again with --subject CODE"),
        (("S07",), "there are no markers of S09", "there are of: S07"),
    ],
)
def test_a_subject_that_is_not_there(tmp_path: Path, name: str, codes: tuple[str, ...], message: str, hint: str) -> None:
    take = tmp_path / "a.mcap"
    import_recording(stranger(tmp_path / "a.c3d"), "c3d", take, take=taken(*codes))
    with pytest.raises(MocapError) as raised:
        export_recording(take, name, tmp_path / "b", subject="S09")
    assert str(raised.value) == message
    assert hint in str(raised.value.hint)
    assert not (tmp_path / "b").exists()


GROUPS: dict[str, dict[str, Any]] = {
    "FORCE_PLATFORM": {
        "USED": 1, "TYPE": 2, "ZERO": [1, 0], "CORNERS": CORNERS, "ORIGIN": np.array([[0.0], [0.0], [-40.0]]),
        "CHANNEL": np.array([[1.0], [2], [1], [2], [1], [2]]),
    },
    "MANUFACTURER": {"COMPANY": ["Acme"], "VERSION": [2, 4]},
    "SEG": {"MARKER_DIAMETER": [14.0]},
    "PROCESSING": {"Bodymass": [71.5], "unknown": [float("nan")]},
    "TRIAL": {"CAMERA_RATE": [50.0], "ACTUAL_START_FIELD": [1, 0], "ACTUAL_END_FIELD": [8, 0], "Y_DIRECTION": [3]},
}  # fmt: skip


def parameters(path: Path) -> Any:
    return ezc3d.c3d(str(path))["parameters"]


def test_parameters_go_round(tmp_path: Path) -> None:
    path, take = stranger(tmp_path / "a.c3d", **GROUPS), tmp_path / "a.mcap"
    import_recording(path, "c3d", take)
    export_recording(take, "c3d", tmp_path / "b.c3d")
    again = parameters(tmp_path / "b.c3d")
    platform = again["FORCE_PLATFORM"]
    assert (platform["USED"]["value"].tolist(), platform["TYPE"]["value"].tolist()) == ([1], [2])
    assert platform["CHANNEL"]["value"].tolist() == [[1], [2], [1], [2], [1], [2]]
    assert platform["CHANNEL"]["type"] == 2  # an integer
    np.testing.assert_allclose(platform["ORIGIN"]["value"], [[0], [0], [-40]])
    # y up became z up: x stays, z becomes -y
    x, y, z = CORNERS
    np.testing.assert_allclose(platform["CORNERS"]["value"], [x, -z, y], atol=1e-5)
    assert again["MANUFACTURER"]["COMPANY"]["value"] == ["Acme"]
    assert again["MANUFACTURER"]["VERSION"]["value"].tolist() == [2, 4]
    assert again["SEG"]["MARKER_DIAMETER"]["value"].tolist() == [14.0]
    assert again["PROCESSING"]["Bodymass"]["value"].tolist() == [71.5]
    assert set(again["TRIAL"]) - {"__METADATA__"} == {"CAMERA_RATE"}


def test_what_an_export_leaves_out_is_named(tmp_path: Path) -> None:
    """People's names, whatever is not known, and platforms whose channels are not there."""
    groups = {**GROUPS, "SUBJECTS": {"NAMES": ["Anna"]}, "ANALYSIS": {"USED": [0]}, "CLINIC": {"CASE": ["12"]}}
    rows = list(read_c3d(stranger(tmp_path / "a.c3d", **groups)))
    with pytest.warns(UserWarning, match="left out: SUBJECTS, CLINIC$") as told:
        write_c3d(tmp_path / "b.c3d", rows)
    assert len(told) == 1
    assert "Anna" not in str({group: list(members) for group, members in parameters(tmp_path / "b.c3d").items()})
    without = [row for row in rows if not isinstance(row[2], Channels)]
    with pytest.warns(UserWarning, match="left out: FORCE_PLATFORM, SUBJECTS, CLINIC$"):
        write_c3d(tmp_path / "c.c3d", without)
    assert parameters(tmp_path / "c.c3d")["FORCE_PLATFORM"]["USED"]["value"].tolist() == [0]


@pytest.mark.parametrize("cut_bytes", [1, 64, 65, 3 * 64])
def test_the_whole_frames_of_a_file_that_is_cut_off(tmp_path: Path, cut_bytes: int) -> None:
    path = stranger(tmp_path / "a.c3d")
    frame_bytes = (3 * 4 + 2 * 2) * 4
    assert frame_bytes == 64
    whole = list(read_c3d(path))
    start = int(parameters(path)["POINT"]["DATA_START"]["value"][0] - 1) * 512
    path.write_bytes(path.read_bytes()[: start + 8 * 64 - cut_bytes])
    lost = -(-cut_bytes // 64)
    with pytest.raises(MocapError, match=f"of 8 frames that its header claims, {8 - lost} are whole") as raised:
        read_c3d(path)
    assert "--keep-whole-frames" in str(raised.value.hint)
    with pytest.warns(UserWarning, match=f"is cut off: {8 - lost} of 8 frames are taken, {lost} are lost"):
        rows = list(read_c3d(path, whole_frames=True))
    facts = next(m.values for _, _, m in rows if isinstance(m, Facts) and m.about == "points")
    assert (facts["frames"], facts["frames_lost"]) == (8 - lost, lost)
    for kind, values in ((Markers, "position_m"), (Channels, "values")):
        expected = [getattr(m, values) for _, _, m in whole if isinstance(m, kind)]
        found = [getattr(m, values) for _, _, m in rows if isinstance(m, kind)]
        assert len(found) == len(expected) // 8 * (8 - lost)
        np.testing.assert_array_equal(np.concatenate(found), np.concatenate(expected[: len(found)]))


def test_a_file_without_a_whole_frame_is_refused(tmp_path: Path) -> None:
    path = stranger(tmp_path / "a.c3d")
    start = int(parameters(path)["POINT"]["DATA_START"]["value"][0] - 1) * 512
    whole = path.read_bytes()
    for size, message in ((start + 63, "0 are whole"), (start - 100, "before its first frame")):
        path.write_bytes(whole[:size])
        with pytest.raises(MocapError, match=message):
            read_c3d(path, whole_frames=True)


@pytest.mark.real_data
def test_a_real_file_that_is_cut_off(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    path = tmp_path / "cut.c3d"
    path.write_bytes(real_data("mocap/vicon_two_subjects.c3d").read_bytes()[:-1_000_000])
    with pytest.warns(UserWarning, match=r"is cut off: 3\d\d of 580 frames are taken"):
        rows = list(read_c3d(path, whole_frames=True))
    assert max(time for _, time, m in rows if isinstance(m, Markers)) < 4_000_000_000
