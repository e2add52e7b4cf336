"""Files of points: MVN's 64 landmarks against Plug-in Gait's bones, of a body whose segments are known."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import moving_body
import numpy as np
import pytest
from moving_body import OFFSETS
from scipy.spatial.transform import Rotation

from cabinpose.app.cli.evaluate_mocap import EvaluateDfe, EvaluateDse
from cabinpose.app.mocap import compare
from cabinpose.app.mocap.inputs import PointTracks, read_motion
from cabinpose.core.errors import AlignmentError
from cabinpose.core.skeleton import CABINPOSE, MVN_SEGMENTS
from cabinpose.evaluate.mocap.dfe import PELVIS_STAGE
from cabinpose.evaluate.mocap.landmarks import CLUSTERS, segment_poses
from cabinpose.evaluate.mocap.pairs import SEGMENT_PAIRS
from cabinpose.evaluate.mocap.sfe import sfe_run
from cabinpose.evaluate.mocap.stillness import Window
from cabinpose.signals.recorded import Facts, Markers
from cabinpose.signals.rotations import angle_between, since_first
from cabinpose.store.convert.c3d_write import write_c3d

pytest.importorskip("mcap")
pytest.importorskip("ezc3d")

TURN_RAD, OFF_M = 0.1, 0.02


def landmarks() -> dict[str, tuple[str, np.ndarray]]:
    """Segment that each lies on, and where in it; the middles of those beside a joint are the joint."""
    found: dict[str, tuple[str, Any]] = {
        "pHipOrigin": ("Pelvis", (0, 0, -0.01)), "pSacrum": ("Pelvis", (-0.08, 0, 0.03)), "pL5SpinalProcess": ("L5", (0, 0, 0)),
        "pPX": ("T8", (0.1, 0, -0.1)), "pIJ": ("T8", (0, 0, 0)), "pT4SpinalProcess": ("T8", (-0.03, 0, 0.08)),
        "pT8SpinalProcess": ("T8", (-0.03, 0, 0)), "pC7SpinalProcess": ("Neck", (0, 0, 0)), "pTopOfHead": ("Head", (0, 0, 0.17)),
        "pBackOfHead": ("Head", (-0.06, 0, 0.05)),
    }  # fmt: skip
    for side, y in (("Left", 1), ("Right", -1)):
        elbow, wrist, knee, ankle, toe = (OFFSETS[side + s] for s in ("Forearm", "Hand", "LowerLeg", "Foot", "Toe"))
        for segment, name, base, x, across, z in (
            ("Pelvis", "ASI", (0, 0, 0), 0.08, 0.125, 0.09), ("Pelvis", "CSI", (0, 0, 0), 0.04, 0.12, 0.17),
            ("Pelvis", "IschialTub", (0, 0, 0), -0.06, 0.06, -0.05), ("Head", "Auricularis", (0, 0, 0), 0, 0.07, 0),
            ("Shoulder", "Acromion", OFFSETS[f"{side}UpperArm"], 0, 0, 0), ("UpperArm", "ArmLatEpicondyle", elbow, 0, 0.03, 0),
            ("UpperArm", "ArmMedEpicondyle", elbow, 0, -0.03, 0), ("Forearm", "UlnarStyloid", wrist, -0.02, 0, 0),
            ("Forearm", "RadialStyloid", wrist, 0.02, 0, 0), ("Forearm", "Olecranon", (0, 0, 0), -0.02, 0, 0),
            ("Hand", "TopOfHand", (0, 0, 0), 0, 0, -0.16), ("Hand", "Pinky", (0, 0, 0), -0.03, 0, -0.09),
            ("Hand", "BallHand", (0, 0, 0), 0, 0.03, -0.03), ("UpperLeg", "GreaterTrochanter", (0, 0, 0), 0, 0.06, -0.02),
            ("UpperLeg", "KneeLatEpicondyle", knee, 0, 0.04, 0), ("UpperLeg", "KneeMedEpicondyle", knee, 0, -0.04, 0),
            ("UpperLeg", "Patella", knee, 0.04, 0, 0), ("LowerLeg", "LatMalleolus", ankle, 0, 0.03, 0),
            ("LowerLeg", "MedMalleolus", ankle, 0, -0.03, 0), ("LowerLeg", "TibialTub", (0, 0, 0), 0.05, 0, -0.05),
            ("Foot", "FirstMetatarsal", toe, 0, -0.04, 0), ("Foot", "FifthMetatarsal", toe, 0, 0.04, 0),
            ("Foot", "HeelFoot", (0, 0, 0), -0.04, 0, -0.08), ("Foot", "HeelCenter", (0, 0, 0), 0, 0, -0.09),
        ):  # fmt: skip
            of = segment if segment in MVN_SEGMENTS else side + segment
            found[f"p{side}{name}"] = (of, np.add(base, (x, y * across, z)))
    return {name: (segment, np.asarray(at, float)) for name, (segment, at) in found.items()}


LANDMARKS = landmarks()


def placed(position: np.ndarray, orientation: np.ndarray, segment: str, offset: Any) -> np.ndarray:
    i = MVN_SEGMENTS.index(segment)
    return position[:, i] + Rotation.from_quat(orientation[:, i], scalar_first=True).apply(offset)


def plug_in_gait(position: np.ndarray, orientation: np.ndarray) -> dict[str, np.ndarray]:
    """The joints of `core.skeleton`, and the ends of the axes of the bones that turn with the suit's segments."""
    suit, gait = CABINPOSE.maps["mvn"], CABINPOSE.maps["plug_in_gait"]
    points = {gait[joint]: position[:, MVN_SEGMENTS.index(suit[joint])] for joint in gait if joint in suit}
    for side, hand in (("L", "Left"), ("R", "Right")):
        points[f"{side}HAO"] = placed(position, orientation, f"{hand}Hand", LANDMARKS[f"p{hand}TopOfHand"][1])
    bones = {"head": "HED", "chest": "TRX", "pelvis": "PEL"}
    for limb, bone in (
        ("shoulder", "CL"), ("upperarm", "HU"), ("forearm", "RA"), ("hand", "HA"), ("upperleg", "FE"), ("lowerleg", "TI"),
        ("foot", "FO"),
    ):  # fmt: skip
        bones |= {side + limb: side.upper() + bone for side in "lr"}
    for pair in SEGMENT_PAIRS:
        for end, axis in zip("ALP", np.eye(3), strict=True):
            points.setdefault(bones[pair.name] + end, placed(position, orientation, pair.suit, 0.1 * axis))
    return points


def write(path: Path, points: dict[str, np.ndarray], rate_hz: float, subject: str) -> Path:
    names, nothing = tuple(points), np.zeros(len(points))
    times = [round(i * 1e9 / rate_hz) for i in range(len(points[names[0]]))]
    rows = [
        (ns, ns, Markers(subject, names, p, nothing)) for ns, p in zip(times, np.stack(list(points.values()), 1), strict=True)
    ]
    return write_c3d(path, rows, rate_hz=rate_hz)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Both start at one trigger; the suit's world is turned, its left lower leg turns by up to 0.1 rad too far, its left elbow is
    20 mm too high.
    """
    folder = tmp_path_factory.mktemp("points")
    suit_s, optical_s = np.arange(0, 6, 1 / 60), np.arange(0, 6, 1 / 100)
    position, orientation = moving_body.moving(suit_s, amplitude=0.3)
    leg = MVN_SEGMENTS.index("LeftLowerLeg")
    slip = Rotation.from_rotvec(TURN_RAD * np.sin(suit_s)[:, None] * (1.0, 0.0, 0.0))
    orientation[:, leg] = (Rotation.from_quat(orientation[:, leg], scalar_first=True) * slip).as_quat(scalar_first=True)
    position, orientation = moving_body.turned(0.6, (1, 2, 0), position, orientation)
    points = {name: placed(position, orientation, *at) for name, at in LANDMARKS.items()}
    for name in ("pLeftArmLatEpicondyle", "pLeftArmMedEpicondyle"):
        points[name] += (0, 0, OFF_M)
    suit = write(folder / "suit.c3d", points, 60.0, "S01")
    return suit, write(folder / "optical.c3d", plug_in_gait(*moving_body.moving(optical_s, amplitude=0.3)), 100.0, "P1")


def medians(summaries: Any, measure: str) -> dict[str, float]:
    return {s["name"]: s["median"] for s in summaries if s["measure"] == measure}


def test_dse_of_two_files(run: Callable[..., Any], files: tuple[Path, Path]) -> None:
    done = run("evaluate-mocap", "dse", f"coronal={files[0]},{files[1]}", "--resamples", "0", "--json")
    assert done.code == 0, done.err
    record = json.loads(done.out)
    found = medians(record["summaries"], "angle between the turns")
    slip = np.degrees(TURN_RAD * np.median(np.abs(np.sin(np.arange(0, 6, 1 / 60)))))
    assert found.pop("llowerleg") == pytest.approx(slip, abs=0.05)
    # All but the upper arms and shoulders, of which too few landmarks turn with them.
    assert len(found) == 1 + 12
    assert max(value for name, value in found.items() if name != "All") < 0.1
    assert "suit +0.0 ms after the optical system, as given; measured: suit" in record["notes"][0]
    assert record["notes"][1].endswith(": lshoulder, rshoulder, lupperarm, rupperarm")
    assert record["headings"][0]["heading_deg"] == pytest.approx(-np.degrees(0.6), abs=0.5)


@pytest.fixture(scope="module")
def motions(files: tuple[Path, Path]) -> dict[Path, PointTracks]:
    return {path: read_motion(path, origin_ns=0) for path in files}


@pytest.fixture
def pair(motions: dict[Path, PointTracks], files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """Both files, which are read once: each time takes seconds."""
    monkeypatch.setattr(compare, "read_motion", lambda path, **_: motions[path])
    return Path(f"{files[0]},{files[1]}")


def test_dfe_of_two_files(pair: Path) -> None:
    (run,), notes = compare.dfe_runs(pair, "", EvaluateDfe(rate=20.0))
    error = dict(zip(run.names, 1e3 * np.nanmedian(run.position_error_m(PELVIS_STAGE), axis=0), strict=True))
    assert notes[1].endswith(": neck")  # which Plug-in Gait does not have
    assert len(error) == 19
    assert error.pop("lelbow") == pytest.approx(1e3 * OFF_M, abs=0.5)
    assert error.pop("lankle") > 5  # at the end of the leg that turns too far
    assert max(error.values()) < 1


def test_a_given_delay_is_taken(pair: Path) -> None:
    (run,), notes = compare.dse_runs(pair, "", EvaluateDse(delay_ms=100.0))
    assert "suit +100.0 ms" in notes[0]
    assert np.degrees(np.nanmedian(run.geodesic_rad[:, run.names.index("rhand")])) > 1


def test_a_landmark_has_a_pelvis_for_sfe(motions: dict[Path, PointTracks], files: tuple[Path, Path]) -> None:
    suit = motions[files[0]]
    first, last = Window("first", 0, 0.05), Window("last", 5, 5.1)
    run = sfe_run(suit.time_s, suit.position_m, suit.orientations(), suit.names, (first, last))
    assert np.isfinite(run.error_m[:, run.names.index("LeftHand")]).all()


@pytest.mark.parametrize(("suit", "optical", "absent"), [(0, 0, "L_Collar"), (1, 1, "LeftShoulder"), (1, 0, "Pelvis")])
def test_files_of_one_system_or_in_the_wrong_order(
    pair: Path, files: tuple[Path, Path], suit: int, optical: int, absent: str
) -> None:
    with pytest.raises(AlignmentError, match=rf"1 of 17 pairs are in both recordings, 2 needed; missing: .*{absent}") as caught:
        compare.dse_runs(Path(f"{files[suit]},{files[optical]}"), "", EvaluateDse())
    there = ("pLeftTopOfHand", "LFEO")
    assert f"the suit gives: {'p' if suit == 0 else 'H'}" in str(caught.value.hint)
    assert all(there[which] in str(caught.value.hint) for which in (suit, optical))


def test_other_points_are_named(motions: dict[Path, PointTracks], files: tuple[Path, Path]) -> None:
    plain = replace(motions[files[0]], names=("LASI", "RASI"), position_m=np.zeros((9, 2, 3)), orientation_wxyz=None, points=0)
    with pytest.raises(AlignmentError, match=r"suit\.c3d has points alone, and none of MVN's landmarks") as caught:
        plain.known("orientation")
    assert caught.value.hint == "it has: LASI, RASI"


def test_a_cluster_that_is_hidden_or_on_a_line_has_no_turn() -> None:
    names = ("pLeftUlnarStyloid", "pLeftRadialStyloid", "pLeftOlecranon")
    position = np.random.default_rng(1).normal(size=(1, 3, 3)).repeat(4, axis=0)
    position[1, 2] = np.nan
    found, placed_m, turned = segment_poses(position, names)
    assert found == ("LeftHand", "LeftForearm")
    assert np.isfinite(turned[:, 1]).all(axis=-1).tolist() == [True, False, True, True]
    np.testing.assert_allclose(placed_m[:, 0], position[:, :2].mean(axis=1))
    line = np.arange(3.0)[:, None] * (1.0, 2.0, 3.0)
    assert np.isnan(segment_poses(np.stack([line, line]), names)[2]).all()


@pytest.mark.real_data
def test_landmarks_of_a_real_suit_turn_as_its_segments(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    """MVNX holds both the segments and where the landmarks lie in them."""
    from cabinpose.store.convert.mvnx import read_mvnx

    path = real_data("mocap/xsens_upper_body.mvnx")
    motion = read_motion(path)
    told = next(m.values["points"] for _, _, m in read_mvnx(path) if isinstance(m, Facts) and "points" in m.values)
    points: dict[str, np.ndarray] = {}
    for point in told:
        if point["name"].startswith("p") and point["segment"] in motion.names:
            i = motion.names.index(point["segment"])
            turn = Rotation.from_quat(motion.orientation_wxyz[:, i], scalar_first=True)
            points.setdefault(point["name"], motion.position_m[:, i] + turn.apply(point["offset"]))
    assert {name for segment, cluster in CLUSTERS if segment in MVN_SEGMENTS[:1] for name in cluster} <= set(points)
    found, position, turned = segment_poses(np.stack(list(points.values()), axis=1), tuple(points))
    for i, segment in enumerate(found):
        own = since_first(motion.orientation_wxyz[:, [motion.names.index(segment)]])[:, 0]
        if np.isfinite(turned[:, i]).any():
            assert angle_between(turned[:, i], own).max() < 1e-5
        apart = np.linalg.norm(position[:, i] - motion.position_m[:, motion.names.index(segment)], axis=1)
        if segment.endswith(("Forearm", "Hand", "LowerLeg", "Foot")):  # joints with a landmark on both sides
            assert apart.max() < 0.008
        elif segment.endswith("UpperLeg"):
            assert apart.max() < 0.015
    hand = motion.names.index("pLeftTopOfHand")
    np.testing.assert_allclose(motion.position_m[:, hand], points["pLeftTopOfHand"], atol=1e-6)
