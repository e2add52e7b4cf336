"""Somebody's folder of frames: three that are laid out in different ways come back as the dataset that they were made of."""

from __future__ import annotations

import copy
import csv
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import xarray as xr
import yaml
from PIL import Image
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from cabinpose.core import CABINPOSE, JOINTS, ConfigError, DatasetError, Visibility
from cabinpose.store import PartWriter, create_dataset, dataset_skeleton, open_dataset, read_manifest
from cabinpose.store.convert import open_source
from cabinpose.store.source import import_source

PLACES = ("driver", "front_passenger")
SEQUENCES = 3
FRAMES = 4  # of a sequence
VEHICLE_FROM_CAMERA = np.eye(4)
VEHICLE_FROM_CAMERA[:3, :3] = Rotation.from_euler("zyx", (-90, 15, -80), degrees=True).as_matrix()
VEHICLE_FROM_CAMERA[:3, 3] = 1.1, -0.2, 1.3
STATES = {state: state.name.lower() for state in Visibility}
LABELS = [
    {"id": 0, "name": "background", "rgb": 0x000000},
    {"id": 14, "name": "torso_left", "rgb": 0x00FAAA},
    {"id": 29, "name": "head_left", "rgb": 0xAA55AA},
    {"id": 71, "name": "wall", "rgb": 0xA0A8A0},
]
CLASSES = {0: 0, 14: 3, 29: 7, 71: 200}  # values of pixels in the files, by ours
Layout = dict[str, Any]


class Frames(dict[str, np.ndarray]):
    """The variables of the source by name: xarray's indexing takes too long for every number of a file."""


@pytest.fixture(scope="module")
def frames(source: xr.Dataset) -> Frames:
    return Frames({name: source[name].values for name in source.variables})


@pytest.fixture(scope="module")
def source(spheres: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    """Twelve frames in three sequences, of two places; a sequence is of one car, view and action."""
    count = SEQUENCES * FRAMES
    manifest = spheres.manifest(
        frames=count, frames_per_part=count, persons=PLACES, variables=("depth", "amplitude", "labels", "instance"),
        joint_definition="anatomy",
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("source") / "dataset"
    with create_dataset(folder, manifest) as writer:
        for plan in writer.missing():
            with PartWriter(folder, plan, manifest) as part:
                for index in range(count):
                    part.append(_frame(spheres.frame(index, manifest), index))
    return open_dataset(folder).load()


def _frame(frame: dict[str, Any], index: int) -> dict[str, Any]:
    sequence, number = divmod(index, FRAMES)
    frame |= {"sequence": 4 + sequence, "car": ("coupe", "sedan", "van")[sequence], "pov": ("top", "side")[sequence % 2]}
    frame |= {"seed": 0, "sync_ns": round(number * 1e9 / 15), "vehicle_from_camera": VEHICLE_FROM_CAMERA}
    frame["subject"] = [f"S0{1 + sequence}" if place == 0 else "S09" for place in range(len(PLACES))]
    if not np.isfinite(frame["joints_3d"][1]).any():
        frame["subject"][1] = ""
    frame["action"] = [("drive", "sleep")[place] if name else "" for place, name in enumerate(frame["subject"])]
    for name in ("depth_clean", "confidence"):
        del frame[name]
    return frame


def written(folder: Path, layout: Layout, *, beside: str = "layout.yaml") -> Path:
    path = folder.parent / beside
    path.write_text(yaml.safe_dump(layout))
    return path


def imported(folder: Path, layout: Layout, **options: Any) -> xr.Dataset:
    source = open_source(folder, "folder", layout=written(folder, layout), **options)
    return open_dataset(import_source(source, folder.parent / "out"))


def put(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, pixels) if path.suffix == ".npy" else Image.fromarray(pixels).save(path)


INTRINSICS = {"fx": 51.2, "fy": 51.2, "cx": 31.5, "cy": 23.5}


# ------------------------------------------------------------- PNG in folders of people and actions, a JSON a frame


def folder_of_pngs(frames: Frames, folder: Path) -> Layout:
    table = np.zeros(256, np.uint8)
    table[list(CLASSES)] = list(CLASSES.values())
    for index, subjects in enumerate(frames["subject"].tolist()):
        where, number = folder / subjects[0] / f"a0{1 + index // FRAMES}", index % FRAMES
        put(where / "depth" / f"{number:04d}.png", np.rint(np.nan_to_num(frames["depth"][index]) * 1000).astype(np.uint16))
        put(where / "ir" / f"{number:04d}.png", frames["amplitude"][index])
        put(where / "mask" / f"{number:04d}_classes.png", table[frames["labels"][index]])
        put(where / "mask" / f"{number:04d}_who.png", frames["instance"][index] * np.uint8(10))
        people = [_json_person(frames, index, place) for place, subject in enumerate(subjects) if subject]
        (where / "pose").mkdir(exist_ok=True)
        (where / "pose" / f"{number}.json").write_text(json.dumps({"meta": {"who": "me"}, "people": people}))
        (where / "calibration.json").write_text(json.dumps(INTRINSICS | {"width": 64, "height": 48}))
    return {
        "licence": "ours",
        "depth": {"files": "{subject}/{action}/depth/{frame}.png", "unit": "mm"},
        "amplitude": {"files": "{subject}/{action}/ir/{frame}.png"},
        "labels": {
            "files": "{subject}/{action}/mask/{frame}_classes.png",
            "classes": [{"value": CLASSES[row["id"]], **row} for row in LABELS],
        },
        "instance": {
            "files": "{subject}/{action}/mask/{frame}_who.png",
            "people": {10: "driver", 20: "front_passenger"},
        },
        "joints": {
            "files": "{subject}/{action}/pose/{frame}.json",
            "definition": "anatomy",
            "rows": "people",
            "values": {
                "place": "seat",
                "subject": "who",
                "action": "does",
                "xyz": "joints/{joint}/xyz",
                "visibility": "joints/{joint}/seen",
            },
            "states": {name: name for name in STATES.values()},
        },
        "camera": {"file": "{subject}/{action}/calibration.json"},
        "places": list(PLACES),
        "call": {"place": {"left": "driver", "right": "front_passenger"}, "action": {"a": "drive"}},
        "rate_hz": 15,
    }


def _json_person(frames: Frames, index: int, place: int) -> dict[str, Any]:
    at = index, place
    joints = {
        name: {"xyz": xyz if np.isfinite(xyz).all() else None, "seen": STATES[Visibility(seen)]}
        for name, xyz, seen in zip(
            JOINTS, frames["joints_3d"][at].astype(float).tolist(), frames["visibility"][at].tolist(), strict=True
        )
    }
    does = {"drive": "a", "sleep": "sleep"}[frames["action"][at]]
    return {"seat": ("left", "right")[place], "who": str(frames["subject"][at]), "does": does, "joints": joints}


# ------------------------------------------------------------------------- NPY stacks of sequences, one CSV of everything


def folder_of_stacks(frames: Frames, folder: Path) -> Layout:
    """y up and centimetres; frames count from 1, and everybody's joints are rows of one table."""
    names = {joint: f"J_{joint.upper()}" for joint in JOINTS}
    folder.mkdir(parents=True)
    with (folder / "all joints.csv").open("w", newline="") as file:
        table = csv.writer(file, delimiter=";")
        table.writerow(["take", "image", "seat", "person", "task", "marker", "X", "Y", "Z", "quality"])
        for index, subjects in enumerate(frames["subject"].tolist()):
            take, image = 4 + index // FRAMES, 1 + index % FRAMES
            for place, subject in enumerate(subjects):
                xyz = frames["joints_3d"][index, place].astype(float) * (100, -100, -100)
                states = frames["visibility"][index, place].astype(float).tolist()
                for joint, (x, y, z), state in zip(names.values(), xyz.tolist(), states, strict=True) if subject else ():
                    table.writerow([take, image, PLACES[place], subject, frames["action"][index, place], joint, x, y, z, state])
    for sequence in range(SEQUENCES):
        some = slice(sequence * FRAMES, (sequence + 1) * FRAMES)
        where = folder / frames["car"][some][0] / frames["pov"][some][0]
        put(where / f"take{4 + sequence}.npy", np.moveaxis(frames["depth"][some], 0, 2))
        put(where / f"take{4 + sequence}-amplitude.npy", frames["amplitude"][some])
    return {
        "depth": {"files": "{car}/{pov}/take{sequence:[0-9]+}.npy", "unit": "m", "dims": ["y", "x", "frame"], "first_frame": 1},
        "amplitude": {"files": "{car}/{pov}/take{sequence}-amplitude.npy", "first_frame": 1},
        "joints": {
            "files": "*.csv",
            "definition": "anatomy",
            "names": names,
            "unit": "cm",
            "axes": ["x", "-y", "-z"],
            "values": {
                "sequence": "take",
                "frame": "image",
                "place": "seat",
                "subject": "person",
                "action": "task",
                "joint": "marker",
                "x": "X",
                "y": "Y",
                "z": "Z",
                "visibility": "quality",
            },
            "states": {int(state): name for state, name in STATES.items()},
        },
        "cameras": {"top": INTRINSICS, "side": INTRINSICS},
        "places": list(PLACES),
    }


# ------------------------------------------------------------- flat TIFFs of distances, MAT in the vehicle's frame


def folder_of_mats(frames: Frames, folder: Path) -> Layout:
    """Distances along the ray in mm, joints of 12 names per take in the vehicle's frame, poses as text."""
    v, u = np.mgrid[:48, :64]
    factor = np.sqrt(((u - 31.5) / 51.2) ** 2 + ((v - 23.5) / 51.2) ** 2 + 1)
    for index, depth in enumerate(frames["depth"]):
        stem = f"take{4 + index // FRAMES}_{frames['car'][index]}_{frames['pov'][index]}_{index % FRAMES:02d}"
        put(folder / f"{stem}.tif", np.where(np.isnan(depth), -9.0, depth * factor * 1000).astype(np.float32))
    vehicle = frames["joints_3d"].astype(float) @ VEHICLE_FROM_CAMERA[:3, :3].T + VEHICLE_FROM_CAMERA[:3, 3]
    for sequence in range(SEQUENCES):
        some = slice(sequence * FRAMES, (sequence + 1) * FRAMES)
        xyz, state = np.nan_to_num(vehicle[some][..., KEPT, :]), frames["visibility"][some][..., KEPT]
        savemat(
            folder / f"take{4 + sequence}.mat", {"out": {"pose": xyz.transpose(3, 2, 0, 1), "seen": state.transpose(2, 0, 1)}}
        )
    for pov in ("top", "side"):
        np.savetxt(folder / f"pose-{pov}.txt", VEHICLE_FROM_CAMERA[:3] * (1, 1, 1, 1000), fmt="%.17g")
    return {
        "depth": {"files": "take{sequence}_{car}_{pov}_{frame}.tif", "unit": "mm", "along": "ray"},
        "joints": {
            "files": "take{sequence}.mat",
            "variable": "out/pose",
            "visibility": "out/seen",
            "dims": ["axis", "joint", "frame", "person"],
            "definition": "kinect_v2",
            "order": [CABINPOSE.maps["kinect_v2"][JOINTS[number]] for number in KEPT],
            "names": {JOINTS[number]: CABINPOSE.maps["kinect_v2"][JOINTS[number]] for number in KEPT},
            "space": "world",
            "zero_is_missing": True,
            "states": {int(state): name for state, name in STATES.items()},
        },
        "camera": INTRINSICS | {"world_from_camera": {"files": "pose-{pov}.txt"}, "unit": "mm", "world": "vehicle"},
        "places": list(PLACES),
        "rate_hz": 15,
    }


KEPT = [number for number, joint in enumerate(JOINTS) if joint in CABINPOSE.maps["kinect_v2"]][3:15]


WAYS: dict[str, Callable[[Frames, Path], Layout]] = {
    "PNG and JSON": folder_of_pngs,
    "NPY and CSV": folder_of_stacks,
    "TIFF and MAT": folder_of_mats,
}


def assert_same_joints(found: xr.Dataset, source: xr.Dataset, kept: list[int], atol: float = 1e-6) -> None:
    absent = [number for number in range(len(JOINTS)) if number not in kept]
    np.testing.assert_array_equal(found.visibility[..., kept].values, source.visibility[..., kept].values)
    np.testing.assert_allclose(found.joints_3d[..., kept, :].values, source.joints_3d[..., kept, :].values, atol=atol)
    np.testing.assert_allclose(found.joints_2d[..., kept, :].values, source.joints_2d[..., kept, :].values, atol=1e-3)
    assert not found.visibility[..., absent].values.any()
    assert np.isnan(found.joints_3d[..., absent, :].values).all()


@pytest.mark.parametrize("way", WAYS)
def test_a_folder_comes_back_as_the_dataset_that_it_was_made_of(
    way: str, source: xr.Dataset, frames: Frames, tmp_path: Path
) -> None:
    found = imported(tmp_path / "frames", WAYS[way](frames, tmp_path / "frames"))
    of_pngs, of_mats = way == "PNG and JSON", way == "TIFF and MAT"
    np.testing.assert_array_equal(found.depth.isnull(), source.depth.isnull())
    np.testing.assert_allclose(found.depth, source.depth, atol=0.00056 if of_pngs else 0.00011 if of_mats else 1e-7)
    assert_same_joints(found, source, KEPT if of_mats else list(range(len(JOINTS))))
    np.testing.assert_allclose(found.camera_k, source.camera_k, rtol=1e-12)
    assert found.person.values.tolist() == list(PLACES)
    exact = {
        "PNG and JSON": ["amplitude", "labels", "instance", "subject", "action", "sync_ns"],
        "NPY and CSV": ["amplitude", "subject", "action", "car", "pov", "sequence"],
        "TIFF and MAT": ["car", "pov", "sequence", "sync_ns"],
    }
    for name in exact[way]:
        np.testing.assert_array_equal(found[name].values, source[name].values, err_msg=name)
    if of_pngs:
        assert found.labels.attrs == source.labels.attrs
        assert found.sequence.values.tolist() == [0] * 4 + [1] * 4 + [2] * 4
    if of_mats:
        np.testing.assert_allclose(found.vehicle_from_camera, source.vehicle_from_camera, atol=1e-12)
        assert (found.subject.values != "").tolist() == (source.subject.values != "").tolist()
        assert dataset_skeleton(found) == dataset_skeleton(source).marked_by("those of kinect_v2")
    else:
        assert dataset_skeleton(found) == dataset_skeleton(source) == CABINPOSE


def folder_of_pixels(frames: Frames, folder: Path, *, z: bool) -> Layout:
    """One person's joints as MATLAB's pixels, a row a frame, wide."""
    layout = folder_of_stacks(frames, folder)
    with (folder / "all joints.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["take", "image", *(f"{joint}_{axis}" for joint in JOINTS for axis in "uvz")])
        for index, (uv, xyz) in enumerate(zip(frames["joints_2d"][:, 0], frames["joints_3d"][:, 0].astype(float), strict=True)):
            numbers = np.concatenate((uv.astype(float) + 1, xyz[:, 2:] * 1000), axis=1).ravel()
            table.writerow([4 + index // FRAMES, 1 + index % FRAMES, *np.where(np.isfinite(numbers), numbers, None)])
    values = {"sequence": "take", "frame": "image", "x": "{joint}_u", "y": "{joint}_v"} | ({"z": "{joint}_z"} if z else {})
    spec = {"files": "*.csv", "definition": "coco", "names": {joint: joint for joint in JOINTS}, "values": values}
    return layout | {"joints": spec | {"space": "image", "first_pixel": 1, "unit": "mm"}}


@pytest.mark.parametrize("z", [True, False], ids=["with depth", "without"])
def test_pixels_count_as_matlab_counts_them(z: bool, source: xr.Dataset, frames: Frames, tmp_path: Path) -> None:
    found = imported(tmp_path / "frames", folder_of_pixels(frames, tmp_path / "frames", z=z))
    there = source.visibility[:, 0].values > 0
    np.testing.assert_allclose(found.joints_2d[:, 0].values[there], source.joints_2d[:, 0].values[there], atol=2e-4)
    if z:
        np.testing.assert_allclose(found.joints_3d[:, 0].values[there], source.joints_3d[:, 0].values[there], atol=1e-5)
    else:
        assert np.isnan(found.joints_3d.values).all()
    outside = source.visibility[:, 0].values == Visibility.OUTSIDE_IMAGE
    assert (found.visibility[:, 0].values[outside] == Visibility.OUTSIDE_IMAGE).all()


def test_pixels_are_lifted_by_the_image(frames: Frames, tmp_path: Path) -> None:
    layout = folder_of_pixels(frames, tmp_path / "frames", z=False)
    layout["joints"]["lift"] = True
    found = imported(tmp_path / "frames", layout)
    seen = found.visibility[:, 0].values == Visibility.VISIBLE
    assert np.isfinite(found.joints_3d[:, 0].values[seen]).mean() > 0.9


@pytest.mark.parametrize("missing", [np.nan, 0.0])
@pytest.mark.parametrize("lift", [False, True])
def test_joints_whose_depth_is_not_known_keep_their_pixels(
    lift: bool, missing: float, source: xr.Dataset, frames: Frames, tmp_path: Path
) -> None:
    some = np.arange(len(JOINTS)) % 2 == 0
    xyz = np.where(some[:, None], frames["joints_3d"] + np.float32(0.3), missing)  # other than the image says
    layout = folder_of_pixels(Frames(frames | {"joints_3d": xyz}), tmp_path / "frames", z=True)
    layout["joints"]["lift"] = lift
    found = imported(tmp_path / "frames", layout)
    there = source.visibility[:, 0].values > 0
    np.testing.assert_allclose(found.joints_2d[:, 0].values[there], source.joints_2d[:, 0].values[there], atol=2e-4)
    np.testing.assert_allclose(found.joints_3d[:, 0].values[there & some, 2], xyz[:, 0][there & some, 2], atol=1e-5)
    seen = found.visibility[:, 0].values == Visibility.VISIBLE
    assert np.isfinite(found.joints_3d[:, 0].values[seen & ~some]).any() == lift


def test_itops_joints_are_kept_beside_ours(frames: Frames, tmp_path: Path) -> None:
    layout = folder_of_stacks(frames, tmp_path / "frames")
    xyz = np.random.default_rng(1).uniform((-0.2, -0.2, 1.0), (0.2, 0.2, 2.0), (SEQUENCES * FRAMES, 15, 3))
    for sequence in range(SEQUENCES):
        np.save(tmp_path / "frames" / f"itop{4 + sequence}.npy", xyz[sequence * FRAMES : (sequence + 1) * FRAMES])
    layout["joints"] = {"files": "itop{sequence}.npy", "definition": "itop", "first_frame": 1}
    found = imported(tmp_path / "frames", layout)
    np.testing.assert_allclose(found.itop_joints_3d[:, 0].values, xyz, atol=1e-6)
    ours, theirs = CABINPOSE.counterparts("itop", list(dataset_skeleton(found, "itop").joints))
    np.testing.assert_allclose(found.joints_3d[:, 0, ours].values, xyz[:, theirs], atol=1e-6)


def test_a_camera_of_the_users_stands_in(frames: Frames, tmp_path: Path) -> None:
    layout = folder_of_stacks(frames, tmp_path / "frames")
    del layout["cameras"]
    found = imported(tmp_path / "frames", layout, intrinsics=(50.0, 51.0, 31.0, 23.0))
    np.testing.assert_array_equal(found.camera_k[5], [[50, 0, 31], [0, 51, 23], [0, 0, 1]])
    with pytest.raises(ConfigError, match="it names no camera") as error:
        open_source(tmp_path / "frames", "folder", layout=tmp_path / "layout.yaml")
    assert "--fov-deg" in str(error.value.hint)


def changed(layout: Layout, path: str, value: Any) -> Layout:
    """A layout with a key of another value; None: without it."""
    result = copy.deepcopy(layout)
    *before, last = path.split(".")
    at = result
    for name in before:
        at = at[name]
    at.pop(last, None) if value is None else at.__setitem__(last, value)
    return result


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("dept", {}, "layout.yaml: dept: "),
        ("depth.unit", None, "depth.unit"),
        ("depth.unit", "parsec", "no unit of depth: parsec"),
        ("depth.files", "/etc/{frame}.png", "leads out of the folder"),
        ("depth.files", "../{frame}.png", "leads out of the folder"),
        ("depth.files", "{subjct}/{frame}.png", "unknown field of a name 'subjct'"),
        ("depth.files", "{subject}/{action}/{frame:[}.png", "is no expression"),
        ("depth.files", "{subject}/{action}/{frame}.jpg", r"no file \{subject\}/\{action\}/\{frame\}.jpg"),
        ("amplitude.files", "{car}/ir/{frame}.png", "depth.files has no {car}"),
        ("amplitude.files", "{subject}/*/ir/{frame}.png", None),
        ("joints.definition", None, "joints.definition"),
        ("joints.names", {"nose": "nose"}, "unknown joint of cabinpose 'nose'"),
        ("joints.axes", ["x", "x", "z"], "are no axes"),
        ("joints.space", "world", "nothing says where the camera is"),
        ("joints.values", {"x": "a", "y": "b"}, "nothing tells whose joint"),
        ("joints.values", {"place": "seat"}, "under xyz, or under x and y"),
        ("joints.values.xyz", "joint/{joint}/xyz", "has no 'joint/rfoot/xyz'"),
        ("joints.values.place", "chair", "has no 'chair'"),
        ("joints.rows", "persons", "has nothing under 'persons'"),
        ("joints.states", {"visible": "visible"}, "the state 'self_occluded' of a joint is not in the layout"),
        ("joints.match", ["car"], "car is not both in values and in depth.files"),
        ("joints.lift", True, "positions in space need none"),
        ("joints.first_frame", 1, "first_frame: it says nothing here"),  # of rows
        ("joints.visibility", "state", "visibility: it says nothing here"),
        ("joints.first_pixel", 1, "first_pixel: it says nothing here"),  # of positions in space
        ("joints.values.visibility", None, "states: it says nothing here"),
        ("places", ["driver"], "unknown place 'front_passenger'"),
        ("call", {}, "unknown place 'left'"),
        ("instance.people", {10: "driver"}, "has pixels of 20"),
        ("labels.classes", [{"value": 0, "id": 0, "name": "background", "rgb": 0}], "has pixels of 3"),
        ("cameras", {"top": {"file": "x.json"}}, "camera and cameras say the same"),
        ("camera", {"fx": 1.0}, "fx, fy, cx and cy"),
        ("camera", {"file": "none.json"}, "no file none.json"),
        ("fields", {"subject": "S01"}, "fields.subject: depth.files has it"),
    ],
)
def test_what_a_layout_cannot_say(
    path: str, value: Any, said: str | None, laid_pngs: tuple[Path, Layout], tmp_path: Path
) -> None:
    folder, layout = laid_pngs
    file = tmp_path / "layout.yaml"
    file.write_text(yaml.safe_dump(changed(layout, path, value)))
    if said is None:
        open_source(folder, "folder", layout=file)
        return
    with pytest.raises((ConfigError, DatasetError), match=said) as error:
        import_source(open_source(folder, "folder", layout=file), tmp_path / "out")
    assert error.value.hint
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def laid_pngs(frames: Frames, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Layout]:
    folder = tmp_path_factory.mktemp("laid") / "frames"
    return folder, folder_of_pngs(frames, folder)


def remove(path: Path) -> None:
    path.unlink()


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


def second(path: Path) -> None:
    path.with_name(f"0{path.name}").write_bytes(path.read_bytes())


def of_another_size(path: Path) -> None:
    Image.fromarray(np.zeros((4, 6), np.uint16)).save(path)


def coloured(path: Path) -> None:
    Image.fromarray(np.arange(48 * 64 * 3, dtype=np.uint32).reshape(48, 64, 3).astype(np.uint8)).save(path)


@pytest.mark.parametrize(
    ("file", "damage", "said"),
    [
        ("S02/a02/ir/0002.png", remove, "no file .*ir.* of subject S02, action a02, frame 2"),
        ("S02/a02/pose/2.json", remove, "no file .*pose.* of subject S02, action a02, frame 2"),
        ("S02/a02/pose/2.json", cut, "cannot read"),
        ("S02/a02/ir/0002.png", cut, "is no whole image"),
        ("S02/a02/depth/0002.png", second, "are both of subject S02, action a02, frame 2"),
        ("S02/a02/ir/0002.png", second, "are both of subject S02, action a02, frame 2"),
        ("S02/a02/depth/0002.png", of_another_size, "has 6x4 pixels, not 64x48"),
        ("S02/a02/ir/0002.png", coloured, "is in colours"),
    ],
)
def test_files_that_are_missing_or_damaged_are_named(
    file: str, damage: Callable[[Path], None], said: str, laid_pngs: tuple[Path, Layout], tmp_path: Path
) -> None:
    import shutil

    folder = Path(shutil.copytree(laid_pngs[0], tmp_path / "frames"))
    damage(folder / file)
    with pytest.raises(DatasetError, match=said) as error:
        imported(folder, laid_pngs[1])
    assert error.value.hint
    assert not (tmp_path / "out").exists()


def test_a_state_of_null_is_none(laid_pngs: tuple[Path, Layout], tmp_path: Path) -> None:
    import shutil

    folder = Path(shutil.copytree(laid_pngs[0], tmp_path / "frames"))
    path = folder / "S02" / "a02" / "pose" / "2.json"
    content = json.loads(path.read_text())
    content["people"][0]["joints"]["rwrist"]["seen"] = None
    path.write_text(json.dumps(content))
    states = imported(folder, laid_pngs[1]).visibility[FRAMES + 2, 0].values
    assert np.flatnonzero(states == Visibility.ABSENT).tolist() == [CABINPOSE.index["rwrist"]]


def test_frames_without_a_row_are_empty_and_counted(frames: Frames, tmp_path: Path) -> None:
    layout = folder_of_stacks(frames, tmp_path / "frames")
    table = tmp_path / "frames" / "all joints.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join(line for line in lines if not line.startswith("5;")))
    opened = open_source(tmp_path / "frames", "folder", layout=written(tmp_path / "frames", layout))
    found = open_dataset(import_source(opened, tmp_path / "out"))
    assert opened.outcome() == "4 of 12 frames have nobody's joints: they are taken for empty"
    assert (found.subject.values[4:8] == "").all()
    table.write_text("\n".join([*lines, lines[1]]))
    with pytest.raises(DatasetError, match=r"all joints.csv, row 4,1: J_HEAD of one person comes a second time"):
        import_source(open_source(tmp_path / "frames", "folder", layout=tmp_path / "layout.yaml"), tmp_path / "none")
    table.write_text("\n".join(lines).replace("J_HEAD", "HEAD"))
    opened = open_source(tmp_path / "frames", "folder", layout=tmp_path / "layout.yaml")
    import_source(opened, tmp_path / "headless")
    assert opened.outcome() == "joints.names: nobody has a J_HEAD"
    table.write_text("\n".join(lines).replace("J_", "K_"))
    with pytest.raises(DatasetError, match="no frame has anybody's joints") as error:
        import_source(open_source(tmp_path / "frames", "folder", layout=tmp_path / "layout.yaml"), tmp_path / "none")
    assert "joints.names" in str(error.value.hint)
    table.write_text(lines[0])
    with pytest.raises(DatasetError, match="no frame has anybody's joints"):
        import_source(open_source(tmp_path / "frames", "folder", layout=tmp_path / "layout.yaml"), tmp_path / "none")
    assert read_manifest(tmp_path / "out").config["layout"]["joints"]["unit"] == "cm"
