"""NTU RGB+D's skeletons: files made by hand, our own export, and the axes of Kinect v2."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from cabinpose.core.errors import DatasetError
from cabinpose.core.pose import Visibility
from cabinpose.core.skeleton import CABINPOSE, NTU_JOINTS
from cabinpose.store import open_dataset
from cabinpose.store.convert import export_dataset, open_source
from cabinpose.store.convert.ntu import KINECT_V2
from cabinpose.store.source import import_source

NAME = "S001C002P003R001A013"
FX, CX, CY = 365.456, 254.878, 205.395  # of the mirrored image, as the files have it


def imported(path: Path, out: Path, **options: Any) -> xr.Dataset:
    return open_dataset(import_source(open_source(path, "ntu", **options), out))


def facing(shift: float = 0.0) -> np.ndarray:
    """(25, 3) in Kinect's camera space: somebody who faces the sensor. The sensor's left, where x grows, is his right."""
    heights = {"Head": 0.7, "SpineShoulder": 0.5, "Shoulder": 0.45, "Foot": -0.9, "Ankle": -0.8}
    joints = np.zeros((25, 3))
    for i, name in enumerate(NTU_JOINTS):
        side = -0.2 if name.endswith("Left") else 0.2 if name.endswith("Right") else 0.0
        joints[i] = (shift + side, heights.get(name.removesuffix("Left").removesuffix("Right"), 0.01 * i), 3)
    return joints


def body(who: int, joints: np.ndarray, states: list[int] | None = None) -> str:
    lines = [f"7205759403793{who} 0 1 1 1 1 0 0.02764709 0.05745083 2", "25"]
    for (x, y, z), state in zip(joints, states or [2] * 25, strict=True):
        u, v = CX + FX * x / z, CY - FX * y / z
        lines.append(f"{x:.7g} {y:.7g} {z:.7g} {u:.4f} {v:.4f} 1036.2 519.1 -0.2 0.05 0.96 -0.12 {state}")
    return "\n".join(lines)


def skeleton(frames: list[list[str]]) -> str:
    return "\n".join([str(len(frames)), *(line for bodies in frames for line in (str(len(bodies)), *bodies))]) + "\n"


def by_hand(folder: Path, name: str = NAME) -> Path:
    """Four frames: one body, two, none, and the second of the two alone."""
    folder.mkdir(exist_ok=True)
    states = [0, 1, *[2] * 23]
    a, b = facing(), facing(0.8)
    path = folder / f"{name}.skeleton"
    path.write_text(skeleton([[body(1, a, states)], [body(1, a), body(2, b)], [], [body(2, b)]]))
    return path


def test_by_hand(tmp_path: Path) -> None:
    ds = imported(by_hand(tmp_path / "ntu"), tmp_path / "out")
    assert dict(ds.sizes) | {"frame": 4, "person": 2} == dict(ds.sizes)
    assert (ds.attrs["width"], ds.attrs["height"]) == (512, 424)
    # a body keeps its place while it is tracked; after a frame with nobody places are given anew
    assert (ds.subject.values == "P003").tolist() == [[True, False], [True, True], [False, False], [True, False]]
    assert set(ds.action.values.ravel()) == {"A013", ""}
    assert (set(ds.car.values), set(ds.pov.values)) == ({"S001"}, {"C002"})
    assert ds.sync_ns.values.tolist() == [0, 33333333, 66666667, 100000000]
    first = ds.isel(frame=0, person=0)
    states = dict(zip(ds.joint.values.tolist(), first.visibility.values.tolist(), strict=True))
    assert states["hip"] == Visibility.ABSENT  # SpineBase: not tracked
    assert np.isnan(first.joints_3d.sel(joint="hip")).all()
    assert states["chest"] == Visibility.OCCLUDED  # SpineMid: inferred
    assert states["lwrist"] == Visibility.VISIBLE
    assert {name for name, state in states.items() if not state} == {"head", "hip"}
    second = ds.isel(frame=1, person=1)
    for ours, theirs in CABINPOSE.maps["kinect_v2"].items():
        x, y, z = facing(0.8)[NTU_JOINTS.index(theirs)]
        np.testing.assert_allclose(second.joints_3d.sel(joint=ours), (-x, -y, z), atol=1e-6)
        np.testing.assert_allclose(ds.joints_3d.sel(joint=ours)[3, 0], (-x, -y, z), atol=1e-6)


def test_handedness(tmp_path: Path) -> None:
    """Right stays right: who faces the camera has his right shoulder at the left of the image, as in ITOP and everywhere.

    Kinect mirrors its image (and x points to its own left): flipping y alone would put it at the right.
    """
    ds = imported(by_hand(tmp_path / "ntu"), tmp_path / "out")
    at = {name: ds.joints_3d.sel(joint=name)[1, 0].values.astype(float) for name in ds.joint.values if name != "head"}
    assert at["rshoulder"][0] < 0 < at["lshoulder"][0]
    assert ds.joints_2d.sel(joint="rshoulder")[1, 0, 0] < ds.joints_2d.sel(joint="lshoulder")[1, 0, 0]
    assert at["neck"][1] < at["lfoot"][1]  # y down
    # the front of the body: across (his left to right) x up points backwards in a right-handed frame, away from the camera
    across, up = at["rshoulder"] - at["lshoulder"], at["neck"] - at["lfoot"]
    assert np.cross(across, up)[2] > 0
    # pixels are those of the file, mirrored back
    x, y, z = facing()[NTU_JOINTS.index("WristLeft")]
    file_u, file_v = CX + FX * x / z, CY - FX * y / z
    np.testing.assert_allclose(ds.joints_2d.sel(joint="lwrist")[1, 0], (511 - file_u, file_v), atol=0.1)  # up to distortion


def test_real_lines_fit_the_nominal_camera() -> None:
    """Two joints of a published example of NTU RGB+D (S001C001P001R001A001): depth pixels within a few px."""
    for x, y, z, u, v in (
        (0.2181153, 0.1725972, 3.785547, 277.419, 191.8218),
        (0.2323292, 0.4326636, 3.714767, 279.2439, 165.8569),
    ):
        px = KINECT_V2.project((-x, -y, z))
        assert np.hypot(511 - px[0] - u, px[1] - v) < 5


def depth_maps(folder: Path, kind: str = "MDepth", frames: int = 4) -> Path:
    """Maps of 3 m in which the body's left hand is a spot nearer by 5 cm, where the file's depthX and depthY say it is."""
    folder.mkdir()
    x, y, z = facing()[NTU_JOINTS.index("HandLeft")]
    u, v = round(CX + FX * x / z), round(CY - FX * y / z)
    for i in range(frames):
        image = np.full((424, 512), 3000 + i, np.uint16)
        image[:, :20] = 0  # the left edge of the mirrored image
        image[v - 3 : v + 4, u - 3 : u + 4] = 2950
        Image.fromarray(image).save(folder / f"{kind}-{i + 1:08d}.png")
    return folder


def test_depth_maps(tmp_path: Path) -> None:
    """A joint's depth lies at the joint's pixel: the maps are unmirrored like the joints."""
    by_hand(tmp_path / "ntu")
    depth_maps(tmp_path / "ntu" / NAME)
    ds = imported(tmp_path / "ntu", tmp_path / "out")
    u, v = ds.joints_2d.sel(joint="lhand")[1, 0].values.round().astype(int)
    depth = ds.depth[1].values
    assert depth[v, u] == pytest.approx(2.95)
    assert depth[v, 511 - u] == pytest.approx(3.001)
    assert np.isnan(depth[:, -20:]).all()
    assert not np.isnan(depth[:, :-20]).any()
    ds = imported(tmp_path / "ntu", tmp_path / "some", every=3)
    assert ds.sync_ns.values.tolist() == [0, 100000000]
    assert ds.depth.values[:, 0, 0].tolist() == pytest.approx([3.0, 3.003])


def test_depth_maps_elsewhere_and_unmasked(tmp_path: Path) -> None:
    skeletons = by_hand(tmp_path / "skeletons").parent
    by_hand(skeletons, NAME.replace("A013", "A014"))
    (tmp_path / "maps").mkdir()
    depth_maps(tmp_path / "maps" / NAME, "Depth")
    assert open_source(skeletons, "ntu").manifest.variables == ()
    with pytest.raises(DatasetError, match="A014 does not exist") as error:
        open_source(skeletons, "ntu", images=tmp_path / "maps")
    assert "--sequences" in str(error.value.hint)
    ds = imported(skeletons, tmp_path / "out", images=tmp_path / "maps", sequences=("*A013",))
    assert ds.depth.shape == (4, 424, 512)


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda folder: (folder / "MDepth-00000003.png").unlink(), "cannot read the image .*MDepth-00000003.png"),
        (
            lambda folder: Image.new("I;16", (512, 400)).save(folder / "MDepth-00000003.png"),
            "MDepth-00000003.png has 512x400 pixels, not 512x424",
        ),
        (lambda folder: Image.new("L", (512, 424)).save(folder / "MDepth-00000003.png"), "no grey image of 16 bits"),
    ],
)
def test_damaged_depth_maps(tmp_path: Path, harm: Callable[[Path], Any], message: str) -> None:
    by_hand(tmp_path / "ntu")
    harm(depth_maps(tmp_path / "ntu" / NAME))
    with pytest.raises(DatasetError, match=message):
        imported(tmp_path / "ntu", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_joints_outside_the_image(tmp_path: Path) -> None:
    joints = facing()
    joints[NTU_JOINTS.index("HandLeft")] = (-3.0, 0.0, 3.0)
    joints[NTU_JOINTS.index("HandRight")] = (np.nan, 0.0, 3.0)
    path = tmp_path / f"{NAME}.skeleton"
    path.write_text(skeleton([[body(1, joints)]]))
    ds = imported(path, tmp_path / "out")
    assert ds.visibility.sel(joint="lhand").item() == Visibility.OUTSIDE_IMAGE
    assert ds.visibility.sel(joint="rhand").item() == Visibility.ABSENT


def test_places_follow_bodies(tmp_path: Path) -> None:
    """Order in the file does not matter, nor who comes and goes; two bodies of one id are two bodies."""
    a, b, c = (body(i, facing(0.1 * i)) for i in (1, 2, 3))
    path = tmp_path / f"{NAME}.skeleton"
    path.write_text(skeleton([[a, b], [b, a], [b], [b, c], [c, c]]))
    ds = imported(path, tmp_path / "out")
    x = np.round(-ds.joints_3d.sel(joint="neck", xyz="x").values / 0.1)
    np.testing.assert_array_equal(x, [[1, 2], [1, 2], [np.nan, 2], [3, 2], [3, 3]])


def test_a_folder(tmp_path: Path) -> None:
    by_hand(tmp_path / "ntu")
    by_hand(tmp_path / "ntu", "S001C001P001R001A001")
    (tmp_path / "ntu" / "S001C001P001R002A001.skeleton").write_text("0\n")  # NTU has files of no frames
    ds = imported(tmp_path / "ntu", tmp_path / "out")
    assert ds.sequence.values.tolist() == [0] * 4 + [2] * 4
    assert ds.subject.values[[0, 4], 0].tolist() == ["P001", "P003"]
    empty = tmp_path / "S001C001P001R002A002.skeleton"
    empty.write_text("0\n")
    with pytest.raises(DatasetError, match="holds no frame"):
        imported(empty, tmp_path / "none")


def lines(change: Callable[[list[str]], Any]) -> Callable[[str], str]:
    def apply(text: str) -> str:
        rows = text.split("\n")
        change(rows)
        return "\n".join(rows)

    return apply


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda text: text[: len(text) // 2], r"skeleton:\d+: (the file ends too early|\d+ fields)"),
        (lines(lambda rows: rows.__delitem__(slice(40, None))), "skeleton:41: the file ends too early"),
        (lambda text: "", "skeleton:1: the file ends too early"),
        (lambda text: "many\n" + text, "skeleton:1: 'many' is no number of things"),
        (lambda text: text + "1\n", "more than the frames"),
        (lines(lambda rows: rows.__setitem__(3, "24")), "skeleton:4: a body has 25 joints"),
        (lines(lambda rows: rows.__setitem__(5, "1 2 3")), "skeleton:6: 3 fields where 12 belong"),
        (lines(lambda rows: rows.__setitem__(5, " ".join(["x"] * 12))), "something that is no number"),
        (lines(lambda rows: rows.__setitem__(5, " ".join(["7"] * 12))), "trackingState other than"),
        (lines(lambda rows: rows.__setitem__(2, "1 2")), "skeleton:3: 2 fields where 10 belong"),
        (lambda text: "\x00\xff" * 100, "skeleton:1: "),
    ],
)
def test_damaged_files(tmp_path: Path, damage: Callable[[str], str], message: str) -> None:
    path = by_hand(tmp_path / "ntu")
    path.write_text(damage(path.read_text()))
    with pytest.raises(DatasetError, match=message) as error:
        imported(path, tmp_path / "out")
    assert error.value.hint
    assert [p.name for p in tmp_path.iterdir()] == ["ntu"]


def test_files_that_do_not_fit(tmp_path: Path) -> None:
    joints = facing()
    path = tmp_path / f"{NAME}.skeleton"
    path.write_text(skeleton([[body(1, joints).replace(" 3 ", " 3000 ")]]))  # not metres
    with pytest.raises(DatasetError, match="px from the projection"):
        imported(path, tmp_path / "out")
    path.rename(tmp_path / "walk.skeleton")
    with pytest.raises(DatasetError, match="is no name of NTU") as error:
        imported(tmp_path / "walk.skeleton", tmp_path / "out")
    assert "S001C002P003R001A013" in str(error.value.hint)
    assert [p.name for p in tmp_path.iterdir()] == ["walk.skeleton"]


def test_round_trip(spheres: ModuleType, tmp_path: Path) -> None:
    before = open_dataset(spheres.write(tmp_path / "a", spheres.manifest(frames=12, frames_per_part=12)))
    out = export_dataset(before, "ntu", tmp_path / "exported")
    names = json.loads((out / "names.json").read_text())
    files = sorted(p.stem for p in out.glob("*.skeleton"))
    after = imported(out, tmp_path / "b")
    assert after.sizes["frame"] == 12
    # frames come in the order of the files' names: find each by its place, view, first person and what he does
    columns = [np.array(list(CABINPOSE.maps["kinect_v2"])), "joints_3d", "visibility"]
    key = [
        tuple(
            str(v) for v in (before.car[i].item(), before.pov[i].item(), before.subject[i, 0].item(), before.action[i, 0].item())
        )
        for i in range(12)
    ]
    code = [
        tuple(
            names[c[0]][c]
            for c in (after.car[i].item(), after.pov[i].item(), after.subject[i, 0].item(), after.action[i, 0].item())
        )
        for i in range(12)
    ]
    assert len(set(key)) == len(files) == 12  # every frame of the sphere people shows somebody else
    for i in range(12):
        j = code.index(key[i])
        people = int((before.subject[i].values != "").sum())
        assert (after.subject[j].values != "").sum() == people
        want, got = (ds.sel(joint=columns[0]) for ds in (before, after))
        np.testing.assert_array_equal(got.joints_3d[j].values[:people], want.joints_3d[i].values[:people])
        seen = want.visibility[i].values[:people]
        inside = KINECT_V2.contains(KINECT_V2.project(want.joints_3d[i].values[:people]))
        expected = np.where(seen == 4, Visibility.VISIBLE, Visibility.OCCLUDED)
        np.testing.assert_array_equal(got.visibility[j].values[:people], np.where(inside, expected, Visibility.OUTSIDE_IMAGE))
    assert (after.visibility.sel(joint="head").values == 0).all()
    again = export_dataset(after, "ntu", tmp_path / "again")
    for stem in files:  # joints are as they were; the numbers of setups and people begin anew in the same order
        first, second = ((folder / f"{stem}.skeleton").read_text() for folder in (out, again))
        states = [[line.rsplit(" ", 1)[0] for line in text.split("\n")] for text in (first, second)]
        assert states[0] == states[1]


def test_exported_files_are_whole(spheres: ModuleType, dataset_folder: Path, tmp_path: Path) -> None:
    """An independent reading of what is written: counts, fields, y up, x to the sensor's left."""
    before = open_dataset(dataset_folder)
    seen: list[int] = []
    out = export_dataset(before, "ntu", tmp_path / "out", report=seen.append)
    assert seen == [1, 2, 3, 4, 5]
    names = json.loads((out / "names.json").read_text())
    assert set(names["S"].values()) == set(spheres.CARS)
    for path in out.glob("*.skeleton"):
        rows = path.read_text().split("\n")
        assert rows.pop() == ""
        assert rows[0] == "1"
        bodies = int(rows[1])
        assert len(rows) == 2 + 27 * bodies
        place = {letter: names[letter][path.stem[at : at + 4]] for letter, at in (("S", 0), ("C", 4), ("P", 8))}
        i = next(i for i in range(5) if (before.car[i], before.pov[i], before.subject[i, 0]) == tuple(place.values()))
        for p in range(bodies):
            block = rows[2 + 27 * p : 29 + 27 * p]
            assert (len(block[0].split()), block[1]) == (10, "25")
            table = np.array([row.split() for row in block[2:]], float)
            assert table.shape == (25, 12)
            elbow = before.joints_3d.sel(joint="relbow")[i, p].values
            got = table[NTU_JOINTS.index("ElbowRight")]
            np.testing.assert_allclose(got[:3], elbow * (-1, -1, 1), atol=1e-7)
            np.testing.assert_allclose(got[3:5], (CX + FX * got[0] / got[2], CY - FX * got[1] / got[2]), atol=1.5)
            assert not table[NTU_JOINTS.index("ThumbLeft")].any()
