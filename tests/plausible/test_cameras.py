"""Cameras that cannot be those of their images are refused, those that hardly can are doubted, true ones are taken in silence."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cabinpose.align import align_takes
from cabinpose.align.board import Board
from cabinpose.align.boardtake import BoardViews
from cabinpose.align.corners import corners_or_reason
from cabinpose.align.judge import Placed, believed, judge_head, judge_joints
from cabinpose.align.session import Session, placed
from cabinpose.core import (
    AlignmentError,
    Camera,
    ConfigError,
    DatasetError,
    apply,
    camera_doubts,
    camera_from,
    check_camera,
    forget_told_cameras,
)
from cabinpose.estimate import JointPredictor
from cabinpose.scene.sensor import SENSORS, Sensor
from cabinpose.signals import Facts
from cabinpose.store import Manifest, PartWriter, Source, create_dataset, import_source, open_dataset
from cabinpose.store.convert.ntu import KINECT_V2

sys.path.insert(0, str(Path(__file__).parents[1] / "store"))
sys.path.insert(0, str(Path(__file__).parents[1] / "align"))

import boards
import rig_takes
import sphere_people

F64 = np.ndarray[Any, np.dtype[np.float64]]
K = np.array([[174.0, 0, 175.5], [0, 174.0, 143.0], [0, 0, 1]])
SIZE = (352, 287)
NONE = np.zeros(5)


@pytest.fixture(autouse=True)
def told_again() -> None:
    """Warnings come once for each camera: every test begins anew."""
    forget_told_cameras()


def with_element(row: int, column: int, value: float) -> F64:
    k = K.copy()
    k[row, column] = value
    return k


CANNOT: dict[str, tuple[F64, Any, str, str]] = {
    "transposed": (K.T, NONE, "its last column 0 0 1: it is transposed", "K.T"),
    "identity": (np.eye(3), NONE, "this is the identity matrix", "in pixels of the 352x287 image"),
    "K[2,2] = 2": (with_element(2, 2, 2.0), NONE, "last row is 0 0 2, not 0 0 1", "divide the matrix by K"),
    "scaled": (2 * K, NONE, "the whole matrix was scaled", "divide the matrix by K"),
    "last row 0": (with_element(2, 2, 0.0), NONE, "last row is 0 0 0, not 0 0 1", "rows are fx 0 cx"),
    "below the diagonal": (with_element(1, 0, 3.0), NONE, r"element \[1,0\] is 3", "rows are fx 0 cx"),
    "skew": (with_element(0, 1, 9.0), NONE, "the skew, element .*: it moves pixels by 7.4 px", "without skew"),
    "NaN in K": (with_element(0, 2, np.nan), NONE, "the matrix has nan, not finite", "rows are fx 0 cx"),
    "infinite": (with_element(0, 0, np.inf), NONE, "the matrix has inf, not finite", "rows are fx 0 cx"),
    "all NaN": (np.full((3, 3), np.nan), NONE, "intrinsics are not known", "--intrinsics"),
    "fx 0": (with_element(0, 0, 0.0), NONE, "fx is 0 px", "rows are fx 0 cx"),
    "fy below 0": (with_element(1, 1, -174.0), NONE, "fy is -174 px", "as in OpenGL"),
    "millimetres": (K * [[0.01], [0.01], [1]] + [[0, 0, 173.7], [0, 0, 141.6], [0, 0, 0]], NONE, "millimetres", "in pixels"),
    "shares of the image": (np.diag((1 / 352, 1 / 287, 1)) @ K, NONE, "in widths of the image", "in pixels"),
    "a projection (3, 4)": (np.hstack([K, np.zeros((3, 1))]), NONE, r"a matrix of shape \(3, 4\)", "give .3, 3."),
    "micrometres": (np.diag((1e3, 1e3, 1)) @ K, NONE, "a field of view of 0.116", "in pixels"),
    "cx in another unit": (with_element(0, 2, 1755.0), NONE, "is far outside", "in pixels"),
    "NaN distortion": (K, np.full(5, np.nan), "distortion is nan nan nan nan nan, not finite", "0 0 0 0 0"),
    "four coefficients": (K, np.zeros(4), r"distortion of shape \(4,\)", "five coefficients"),
    "eight coefficients": (K, np.zeros(8), r"distortion of shape \(8,\)", "five coefficients"),
    "folds": (K, [-0.5, 0, 0, 0, 0], r"it folds back \d\d % of the way", "fitted to this image"),
    "folds before the border": (K, [-0.33, 0, 0, 0, 0], "it folds back 82 % of the way", "fitted to this image"),
    "of pixels": (K, [1e6, 0, 0, 0, 0], "moves rays to", "in focal lengths"),
}  # fmt: skip


@pytest.mark.parametrize("case", CANNOT)
def test_a_camera_that_cannot_be_is_refused(case: str) -> None:
    k, dist, said, hint = CANNOT[case]
    with pytest.raises(ConfigError, match=f"^mine: .*{said}") as error:
        camera_from(k, dist, *SIZE, whose="mine")
    assert hint.replace(".3, 3.", "(3, 3)") in str(error.value.hint)


HALF = np.diag((0.5, 0.5, 1.0)) @ K
HARDLY: dict[str, tuple[F64, Any, str]] = {
    "half the resolution": (HALF, NONE, r"cx 87.75 of 352 .* about 176x144 pixels, whose field of view is 91°, not 127"),
    "twice the resolution": (np.diag((2.0, 2, 1)) @ K, NONE, "an image of about 704x574 pixels"),
    "cx and cy exchanged": (K[[0, 1, 2]] + [[0, 0, -32.5], [0, 0, 32.5], [0, 0, 0]], NONE, "cx and cy are exchanged"),
    "of an image turned by 90°": (K + [[0, 0, -32.0], [0, 0, 32.0], [0, 0, 0]], NONE, "the image was turned by 90°"),
    "from the middle": (with_element(0, 2, 0.0) - [[0, 0, 0], [0, 0, 143], [0, 0, 0]], NONE, "counted from the middle"),
    "far from the middle": (with_element(0, 2, 300.0), NONE, "cx 300 of 352 columns.*cut out of larger ones"),
    "outside the image": (with_element(1, 2, 400.0), NONE, "cy 400 of 287 rows.*cut out of larger ones"),
    "focal lengths apart": (with_element(1, 1, 140.0), NONE, "fx 174 and fy 140 px differ by a factor of 1.24"),
    "narrow": (K * [[20, 1, 1], [1, 20, 1], [1, 1, 1]], NONE, "a field of view of 5.79° x 4.72° of 352x287"),
    "wide": (K * [[0.2, 1, 1], [1, 0.2, 1], [1, 1, 1]], NONE, "a field of view of 158° x 153°"),
    "many pixels without a ray": (K, [-0.28, 0, 0, 0, 0], "% of the pixels have no ray"),
    "k1 k2 k3 p1 p2": (K, [-0.13, 0.02, 0.05, 0, 0], "the order is k1 k2 p1 p2 k3"),
}  # fmt: skip


@pytest.mark.parametrize("case", HARDLY)
def test_a_camera_that_hardly_can_be_is_doubted_once(case: str) -> None:
    k, dist, said = HARDLY[case]
    with pytest.warns(UserWarning, match=f"^mine: .*{said}") as told:
        camera = camera_from(k, dist, *SIZE, whose="mine")
    assert len(told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert camera_from(k, dist, *SIZE, whose="mine") is camera
    assert len(camera_doubts(camera)) == 1


def real_cameras() -> dict[str, Camera]:
    """Presets, and calibrations of devices: Azure Kinect's narrow and wide field, Kinect v2, ITOP's whole and cut-out frames."""
    wide = (-0.2819, 0.077, 0.0, -0.0001, -0.0095)
    return {name: SENSORS[name].camera for name in SENSORS.names()} | {
        "ntu": KINECT_V2,
        "itop": Camera(320, 240, 285.714, 285.714, 160.0, 120.0),
        "itop, cut out": Camera(100, 100, 119.05, 119.05, 50.0, 50.0),
        "panoptic": Camera(512, 424, 364.85, 364.85, 249.18, 202.52),
        "azure, narrow": Camera(640, 576, 504.61, 504.73, 332.78, 348.83, (-0.3319, 0.1507, 0.0, -0.0001, -0.0416)),
        "azure, wide": Camera(1024, 1024, 504.6, 504.7, 524.78, 528.83, wide),
        "PAL pixels": Camera(720, 576, 700.0, 764.0, 359.5, 287.5),
        "wide barrel": Camera(*SIZE, 174.0, 174.0, 175.5, 143.0, (-0.35, 0.12, 0.001, -0.001, 0.0)),
    }


@pytest.mark.parametrize("name", real_cameras())
def test_true_cameras_are_taken_in_silence(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera = real_cameras()[name]
        assert camera_from(camera.k, camera.dist, camera.width, camera.height) == check_camera(camera, "mine")
        half = replace(camera, width=camera.width // 2, height=camera.height // 2, fx=camera.fx / 2, fy=camera.fy / 2,
                       cx=camera.cx / 2 - 0.25, cy=camera.cy / 2 - 0.25)  # fmt: skip
        check_camera(half, "its half")


@pytest.mark.parametrize("name", {SENSORS[name].camera: name for name in SENSORS.names()}.values())
def test_a_thousand_images_of_every_sensor_are_taken_in_silence(name: str) -> None:
    """Of any shape, cut out of the middle down to two fifths of each side, and binned by up to four."""
    camera, rng = SENSORS[name].camera, np.random.Generator(np.random.Philox(key=33))
    whole = np.array((camera.width, camera.height))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for number, share in enumerate(rng.uniform(0.4, 1, (1000, 2))):
            binned, size = (1, 2, 4)[number % 3], np.rint(share * whole)
            centre = ((camera.cx, camera.cy) - (whole - size) // 2 + 0.5) / binned - 0.5
            focal, (width, height) = (camera.fx / binned, camera.fy / binned), (size // binned).astype(int).tolist()
            check_camera(Camera(width, height, *focal, *centre.tolist(), camera.dist), "its image")


def test_cut_outs_are_refused_nowhere() -> None:
    """They may lie anywhere in the larger image: only a doubt says so."""
    for left, top in ((0, 0), (100, 60), (288, 239)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            check_camera(Camera(64, 48, 174.0, 174.0, 175.5 - left, 143.0 - top), "a cut-out")


FOLDING = (-0.18, 0.0, 0.0, 0.0, 0.0)  # 158 px from the principal point: beyond the nearest border, before the corners


def test_a_sensor_whose_lens_folds_within_its_image_is_told() -> None:
    own = SENSORS["pico_monstar_105"]
    camera = replace(own.camera, dist=FOLDING)
    with pytest.warns(UserWarning, match=r"sensor 'own': .* folds 158 px .*, 53.7° off the axis, and \d+ %") as told:
        Sensor(**dict(own) | {"name": "own", "camera": camera, "field_radius_px": None})
    assert len(told) == 1
    forget_told_cameras()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Sensor(**dict(own) | {"name": "own", "camera": camera, "field_radius_px": 157.0})
        Sensor(**dict(own) | {"name": "own", "field_radius_px": None})


def test_depths_where_the_lens_sees_nothing_are_told(model: JointPredictor, frame: dict[str, Any]) -> None:
    lens = camera_from(frame["camera_k"], FOLDING, *SIZE)
    circle = np.where(np.isfinite(lens.rays[..., 0]), frame["depth"], np.nan)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*the lens sees nothing")
        assert model(circle, lens.k, frame["amplitude"], camera_dist=lens.dist).remarks == ()
        assert model(frame["depth"], lens.k, frame["amplitude"], camera_dist=frame["camera_dist"]).remarks == ()
    with pytest.warns(UserWarning, match=r"\d+ % of the depths lie where the lens sees nothing: .* folds 158 px"):
        found = model(frame["depth"], lens.k, frame["amplitude"], camera_dist=lens.dist)
    assert "fit dist to the whole image" in found.remarks[0].lower()


WRONG_MATRICES: dict[str, Callable[[F64], F64]] = {
    "transposed": np.transpose,
    "identity": lambda k: np.eye(3),
    "K[2,2] = 2": lambda k: k + np.diag((0.0, 0, 1)),
}


@pytest.mark.parametrize("case", WRONG_MATRICES)
def test_a_model_refuses_what_is_no_camera(model: JointPredictor, frame: dict[str, Any], case: str) -> None:
    with pytest.raises(ConfigError, match=r"^camera_k: "):
        model(frame["depth"], WRONG_MATRICES[case](frame["camera_k"]), frame["amplitude"], camera_dist=frame["camera_dist"])
    with pytest.raises(ConfigError, match="not finite"):
        model(frame["depth"], frame["camera_k"], frame["amplitude"], camera_dist=np.full(5, np.nan))


def test_a_models_answer_has_the_doubts_of_its_camera_and_none_of_a_true_one(
    model: JointPredictor, frame: dict[str, Any]
) -> None:
    half = np.diag((0.5, 0.5, 1.0)) @ frame["camera_k"]
    depth, light, dist = frame["depth"], frame["amplitude"], frame["camera_dist"]
    with pytest.warns(UserWarning, match="^camera_k: cx 87.75 of 352 columns"):
        found = model(depth, half, light, camera_dist=dist)
    assert "an image of about 176x144 pixels" in found.remarks[0]
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*camera_k")
        assert model(depth, frame["camera_k"], light, camera_dist=dist).remarks == ()
        assert model(depth, half, light, camera_dist=dist).remarks == found.remarks  # in every answer, told once


def frames_with(camera_k: F64) -> tuple[Manifest, Iterator[dict[str, Any]]]:
    """A dataset of two frames and what a reader of another format gives for it, with a matrix in the last frame."""
    manifest = sphere_people.manifest(frames=2)
    made = [sphere_people.frame(i, manifest) for i in range(2)]
    return manifest, iter([made[0], made[1] | {"camera_k": camera_k}])


SMALL = sphere_people.camera_k(64, 48)


@pytest.mark.parametrize("case", WRONG_MATRICES)
def test_an_import_and_an_opened_dataset_refuse_what_is_no_camera(tmp_path: Path, case: str) -> None:
    manifest, frames = frames_with(WRONG_MATRICES[case](SMALL))
    with pytest.raises(DatasetError, match="theirs: camera_k: "):
        import_source(Source(Path("theirs"), manifest, lambda: frames), tmp_path / "imported")
    assert not (tmp_path / "imported").exists()
    manifest, frames = frames_with(WRONG_MATRICES[case](SMALL))
    with create_dataset(tmp_path / "made", manifest), PartWriter(tmp_path / "made", manifest.parts[0], manifest) as part:
        for frame in frames:
            part.append(frame)
    with pytest.raises(DatasetError, match="made: camera_k of the last frame: "):
        open_dataset(tmp_path / "made")


def test_a_true_and_an_unknown_camera_are_imported_and_opened_in_silence_and_a_doubted_one_is_in_json(
    tmp_path: Path, run: Callable[..., Any]
) -> None:
    for name, k in {"true": SMALL, "unknown": np.full((3, 3), np.nan)}.items():
        manifest, frames = frames_with(k)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            folder = import_source(Source(Path("theirs"), manifest, partial(iter, list(frames))), tmp_path / name)
            assert open_dataset(folder).sizes["frame"] == 2
    manifest, frames = frames_with(np.diag((0.5, 0.5, 1)) @ SMALL)
    with pytest.warns(UserWarning, match="^theirs: camera_k: .* an image of about 32x24 pixels") as told:
        folder = import_source(Source(Path("theirs"), manifest, lambda: frames), tmp_path / "half")
    assert len(told) == 1
    said = json.loads(run("info", folder, "--json").out)
    assert sum("an image of about 32x24 pixels" in text for text in said["warnings"]) == 1
    assert "warnings" not in json.loads(run("info", tmp_path / "true", "--json").out)


@pytest.fixture(scope="module")
def board_shown() -> BoardViews:
    """Ten views of a board as camera and optical system saw it, rendered; the board is 9 x 6 corners of squares of 0.06 m."""
    count = len(boards.POSES)
    images, corners = (tuple(f(k) for k in range(count)) for f in (boards.picture, partial(boards.corners_seen, noise=False)))
    world_from_camera = np.diag((1.0, -1.0, -1.0, 1.0))
    p_world = np.stack([apply(world_from_camera @ pose, boards.BOARD.marker_centres) for pose in boards.POSES])
    return BoardViews(boards.CAMERA, images, corners, ("",) * count, p_world, count, 0)


def believed_of(shown: BoardViews, **wrong: Any) -> list[str]:
    """What is said of the views for a board that is described wrongly."""
    board = Board(**wrong)
    views = shown if "rows" not in wrong else replace(shown, corners=tuple(corners_or_reason(i, board)[0] for i in shown.images))
    session = Session(board_take=Path("none"), pendulum_take=Path("none"))

    def place(other: Board, of_it: BoardViews) -> Placed:
        return placed(session.model_copy(update={"board": other}), of_it)

    return believed(board, views, place)[1]


@pytest.mark.slow
def test_a_board_as_described_is_believed_and_one_slightly_off_doubted(board_shown: BoardViews) -> None:
    assert believed_of(board_shown) == []
    assert "doubtful: held-out views, px" in believed_of(board_shown, square_m=0.0604)[0]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"square_m": 0.0615}, "squares of 0.0600 m in place of 0.0615"),
        ({"square_m": 0.05}, "squares of 0.0600 m in place of 0.05"),
        ({"columns": 6, "rows": 9}, "columns and rows exchanged, 9 columns and 6 rows,"),
    ],
    ids=["2.5 % too large", "0.05 m", "columns and rows exchanged"],
)
def test_a_board_described_wrongly_is_refused_with_the_cause(board_shown: BoardViews, wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(AlignmentError, match=rf"{said} give \d.\d+ px and \d.\d+ mm") as error:
        believed_of(board_shown, **wrong)
    assert said in str(error.value.hint)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"marker_radius_m": 7.0}, r"a marker's radius of 7 m.*are they millimetres \(0.007 m\)"),
        ({"square_m": 60.0}, r"squares of 60 m.*are they millimetres \(0.06 m\)"),
        ({"markers": {"a": (-110.0, 0.0, 0.0), "b": (590.0, 0.0, 0.0), "c": (0.0, 340.0, 0.0)}}, "a marker's place of 590 m"),
    ],
    ids=["marker's radius", "squares", "markers' places"],
)
def test_a_board_in_millimetres_is_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        Board(**wrong)


def test_the_heads_of_a_take_are_judged() -> None:
    assert judge_head(0.63, 0.43) == ""
    assert judge_head(1.9, 1.0) == ""  # as in its own head take
    assert "1.2 deg apart (rms), where 1.0 are usual: the calibration is of another session" in judge_head(1.2, 0.43)
    with pytest.raises(AlignmentError, match=r"11.0 deg apart \(rms\), 8 allowed") as error:
        judge_head(11.0, 0.43)
    assert "the cap" in str(error.value.hint)


def test_joints_before_the_surface_are_judged() -> None:
    assert judge_joints(0.004) == judge_joints(float("nan")) == ""
    assert "12 % of the joints lie before the measured surface, and 5 % are usual" in judge_joints(0.12)


@pytest.mark.parametrize(
    ("calibrated", "taken", "said"),
    [
        ("ours A1", "A1", ""),
        ("", "", ""),
        ("", "A1", "the calibration does not say of which camera it is, and that it is ours A1 cannot be checked"),
        ("ours A1", "", "the take does not say of which camera it is, and that it is ours A1 cannot be checked"),
    ],
    ids=["the same", "none", "an older calibration", "a camera without a serial number"],
)
def test_a_take_is_compared_with_the_calibrated_camera(tmp_path: Path, calibrated: str, taken: str, said: str) -> None:
    path = tmp_path / "take.mcap"
    rig_takes.Made(seconds=6, camera=taken).write(path)
    warned = align_takes([path], rig_takes.calibration(camera=calibrated)).warnings
    assert [text for text in warned if "camera" in text] == ([f"take.mcap: {said}"] if said else [])


def test_a_calibration_of_another_camera_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    rig_takes.Made(seconds=6, camera="B2").write(path)
    with pytest.raises(
        AlignmentError, match=r"take.mcap: the camera: the take is of the camera ours B2, the calibration of ours A1"
    ):
        align_takes([path], rig_takes.calibration(camera="ours A1"))


@pytest.mark.parametrize(
    ("calibrated", "taken", "said"),
    [
        ({"rig": "lab-A"}, {"rig": "lab-A"}, None),
        ({}, {"rig": "lab-A", "station": "0A12"}, None),
        ({"rig": "lab-A", "suit of S07": "0A12"}, {}, None),
        ({"rig": "lab-A", "suit of S07": "0A12"}, {"rig": "lab-B", "station": "0A12"}, "rig: lab-A then, lab-B now"),
        ({"rig": "lab-A", "suit of S07": "0A12"}, {"rig": "lab-A", "station": "0B34"}, "suit of S07: 0A12 then, 0B34 now"),
    ],
    ids=["the same", "an older calibration", "a take that says nothing", "another rig", "another suit"],
)
def test_a_take_is_compared_with_the_calibrated_rig_and_suit(
    tmp_path: Path, calibrated: dict[str, str], taken: dict[str, str], said: str | None
) -> None:
    path = tmp_path / "take.mcap"
    rig_takes.Made(seconds=6, **taken).write(path)
    warned = [text for text in align_takes([path], rig_takes.calibration(equipment=calibrated)).warnings if "another rig" in text]
    assert len(warned) == (said is not None)
    assert all(text.startswith("take.mcap: recorded with another rig, suit") and f"({said})" in text for text in warned)


RATE, MARKERS = "frames a second of the optical system", "markers of head"
OPTICAL = {"optical system": "10.0.0.5:801", RATE: "100", MARKERS: "front left right"}


def vicon(address: str = "10.0.0.5:801", rate_hz: float = 100.0, markers: str = "left front right") -> list[Facts]:
    """What Vicon's server says of itself, as its source records it."""
    return [
        Facts("server", {"types": [1], "address": address} if address else {"types": [1]}),
        Facts("stream", {"frame_rate_hz": rate_hz, "server_up": "z"}),
        Facts("subject head", {"id": 1, "markers": [{"name": name, "segment": "head"} for name in markers.split()]}),
    ]


@pytest.mark.parametrize(
    ("taken", "said"),
    [
        (vicon(), []),
        (vicon(""), []),
        ([], []),
        (vicon("10.0.0.6:801"), ["optical system: 10.0.0.5:801 then, 10.0.0.6:801 now"]),
        (vicon(rate_hz=200.0), ["frames a second of the optical system: 100 then, 200 now"]),
        (vicon(markers="a b c d"), ["markers of head: front left right then, a b c d now"]),
        ([Facts("stream", {"name": "optical", "source_id": "of-lab-B"})], ["optical system: 10.0.0.5:801 then, of-lab-B now"]),
    ],
    ids=["the same", "of this computer", "a take that says nothing", "another server", "another rate", "another cap", "a stream"],
)
def test_a_take_is_compared_with_the_calibrated_optical_system(tmp_path: Path, taken: list[Facts], said: list[str]) -> None:
    path = tmp_path / "take.mcap"
    rig_takes.Made(seconds=6, optical=tuple(taken)).write(path)
    warned = [text for text in align_takes([path], rig_takes.calibration(equipment=OPTICAL)).warnings if "optical system" in text]
    assert [f"({each})" in text for each, text in zip(said, warned, strict=True)] == [True] * len(said)
