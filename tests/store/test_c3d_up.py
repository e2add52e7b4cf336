"""Which axis of a C3D file is up: files written by ezc3d whose POINT:Y_SCREEN is right, wrong or missing."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cabinpose.signals.recorded import Facts, Markers
from cabinpose.store.convert.c3d import read_c3d
from cabinpose.store.convert.c3d_up import WORLD_FROM_UP

ezc3d = pytest.importorskip("ezc3d")

STANDING = {"Neck": (0.1, 0.2, 1.36), "LShoulderTop": (0.1, 0.4, 1.3), "LAnkleOut": (0.1, 0.3, 0.1), "LToeTip": (0.3, 0.3, 0.045)}
# Rump and feet lie before the shoulders, and below: hips at 0.3 m, feet at the pedals
SEATED = {"C7": (0.0, 0.4, 0.85), "L_SHO": (0.05, 0.6, 0.8), "LASI": (0.3, 0.45, 0.35), "LHEE": (0.9, 0.5, 0.05)}
PROPS = {"a": (-0.5, -0.3, 0.2), "b": (0.4, 0.8, 1.4), "c": (0.0, -0.7, 0.01)}


def file_of(path: Path, world_m: dict[str, tuple[float, float, float]], up: str, says: str | None) -> Path:
    """Ten frames of markers that stand in the world as given, in a file with the axis `up` pointing up that says something."""
    file = ezc3d.c3d()
    points = np.ones((4, len(world_m), 10))
    in_file = np.array(list(world_m.values())) @ WORLD_FROM_UP[up]  # the inverse of what the reader does
    points[:3] = in_file.T[..., None] * 1000
    file["data"]["points"] = points
    file["parameters"]["POINT"]["RATE"]["value"] = [50.0]
    words = {"LABELS": list(world_m), "UNITS": ["mm"], **({} if says is None else {"X_SCREEN": ["+X"], "Y_SCREEN": [says]})}
    for name, value in words.items():
        file.add_parameter("POINT", name, value)
    file.write(str(path))
    return path


def heights(path: Path, **options: object) -> tuple[dict[str, float], dict[str, object]]:
    """The height of each marker, m, and the facts on points."""
    rows = [message for _, _, message in read_c3d(path, **options)]
    markers = next(m for m in rows if isinstance(m, Markers))
    facts = next(m for m in rows if isinstance(m, Facts) and m.about == "points")
    return dict(zip(markers.names, markers.position_m[:, 2].tolist(), strict=True)), dict(facts.values)


def expected(world_m: dict[str, tuple[float, float, float]]) -> dict[str, float]:
    return {name: pytest.approx(at[2], abs=1e-6) for name, at in world_m.items()}


@pytest.mark.parametrize("world_m", [STANDING, SEATED])
@pytest.mark.parametrize(
    ("up", "says"), [("z", "-Z"), ("z", "+Y"), ("y", "+Z"), ("y", "-Y"), ("x", "+Z"), ("-z", "+Z"), ("y", None)]
)
def test_names_outweigh_what_the_file_says(tmp_path: Path, world_m: dict, up: str, says: str | None) -> None:
    path = file_of(tmp_path / "a.c3d", world_m, up, says)
    with pytest.warns(UserWarning, match=rf"is read with {up} up.*--up") as told:
        found, facts = heights(path)
    assert len(told) == 1
    assert found == expected(world_m)
    assert (facts["up"], facts["up_because"]) == (up, "shoulders or head above hips or feet")


@pytest.mark.parametrize("world_m", [STANDING, SEATED])
@pytest.mark.parametrize(("up", "says"), [("z", "+Z"), ("y", "+Y"), ("-z", "-Z"), ("x", "X"), ("z", None)])
def test_a_file_that_is_right_is_read_without_a_word(tmp_path: Path, world_m: dict, up: str, says: str | None) -> None:
    path = file_of(tmp_path / "a.c3d", world_m, up, says)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert heights(path)[0] == expected(world_m)


@pytest.mark.parametrize(("up", "says"), [("z", "-Z"), ("y", "-Y"), ("y", None)])
def test_without_names_the_floor_tells(tmp_path: Path, up: str, says: str | None) -> None:
    path = file_of(tmp_path / "a.c3d", PROPS, up, says)
    with pytest.warns(UserWarning, match="all markers above the floor"):
        assert heights(path)[0] == expected(PROPS)


def test_what_nothing_tells_is_assumed_aloud(tmp_path: Path) -> None:
    path = file_of(tmp_path / "a.c3d", PROPS, "z", None)
    with pytest.warns(UserWarning, match="does not say which axis is up: z is assumed"):
        found, facts = heights(path)
    assert found == expected(PROPS)
    assert facts["up_because"] == "assumed: nothing tells it"


def test_a_floor_below_two_axes_tells_nothing(tmp_path: Path) -> None:
    corner = {name: (x, abs(y), z) for name, (x, y, z) in PROPS.items()}
    with pytest.warns(UserWarning, match="z is assumed"):
        assert heights(file_of(tmp_path / "a.c3d", corner, "z", None))[0] == expected(corner)


@pytest.mark.parametrize("says", ["+X", "-X", "+Y", "+Z"])
def test_without_names_a_plain_axis_is_believed(tmp_path: Path, says: str) -> None:
    up = says.lower().removeprefix("+")
    assert heights(file_of(tmp_path / "a.c3d", PROPS, up, says))[0] == expected(PROPS)


@pytest.mark.parametrize("up", list(WORLD_FROM_UP))
def test_the_axis_that_is_given_is_taken(tmp_path: Path, up: str) -> None:
    path = file_of(tmp_path / "a.c3d", STANDING, up, "nonsense")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found, facts = heights(path, up=up)
    assert found == expected(STANDING)
    assert (facts["up"], facts["up_because"]) == (up, "given")


@pytest.mark.parametrize("name", ["wheel", "fibula head", "MTHEAD5", "shoe", "XC78"])
def test_names_that_only_look_like_a_shoulder_or_a_heel_tell_nothing(tmp_path: Path, name: str) -> None:
    """Each stands where a shoulder or a heel would turn the person over."""
    low = {name: (0.0, 0.0, 1.5), "neck": (0.0, 0.0, 0.1)} if name == "wheel" else {name: (0.0, 0.0, 0.1), "toe": (0.0, 0.0, 1.5)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert heights(file_of(tmp_path / "a.c3d", low, "z", "+Z"))[0] == expected(low)


@pytest.mark.real_data
@pytest.mark.parametrize("says", ["-Z", "+Y", "-X"])
def test_a_real_file_with_a_wrong_axis_stays_upright(real_data: Callable[[str], Path], tmp_path: Path, says: str) -> None:
    path = tmp_path / "said.c3d"
    # A parameter's text is found by the name before it; two characters are replaced by two
    whole = real_data("mocap/vicon_two_subjects.c3d").read_bytes()
    start = whole.index(b"Y_SCREEN")
    at = whole.index(b"+Z", start)
    path.write_bytes(whole[:at] + says.encode() + whole[at + 2 :])
    assert ezc3d.c3d(str(path))["parameters"]["POINT"]["Y_SCREEN"]["value"] == [says]
    with pytest.warns(UserWarning, match="is read with z up"):
        rows = [m for _, _, m in read_c3d(path) if isinstance(m, Markers) and m.subject == "Daphnee"]
    at_m = dict(zip(rows[0].names, rows[0].position_m[:, 2].tolist(), strict=True))
    assert 0.3 < at_m["ACRO_tip"] - at_m["ASISr"] < 0.7
