"""Cars from files: whatever axes, units and compression, the cabin comes out as it was; the rest is refused with a reason."""

from __future__ import annotations

import json
import struct
import sys
from pathlib import Path
from typing import Any

import DracoPy
import numpy as np
import pytest
import trimesh
import yaml

from cabinpose.core.errors import ConfigError, DependencyError, MeshError
from cabinpose.core.frames import apply
from cabinpose.scene.cabin import Cabin, SeatSetting, build_cabin, load_cabin
from cabinpose.scene.cabin.meshfile import read_mesh
from cabinpose.scene.labels import LABEL_ID as LABEL

# file = FILE_FROM_VEHICLE @ vehicle: glTF's axes (x left, y up, z forward), and a common z-up one that looks along -y
GLTF_FROM_VEHICLE = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
Z_UP_LOOKS_MINUS_Y = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
KEEP = ("cushion", "backrest", "headrest", "floor", "door trim", "headlining", "dashboard", "windscreen", "steering wheel rim")


@pytest.fixture(scope="module")
def sedan() -> Cabin:
    return build_cabin("sedan")


def scene_of(cabin: Cabin, rotation: np.ndarray, factor: float) -> trimesh.Scene:
    transforms = cabin.group_transforms({})
    scene = trimesh.Scene()
    for part in cabin.parts:
        if any(k in part.name for k in KEEP):
            v = apply(transforms[part.group], part.surface.vertices) @ rotation.T * factor
            mesh = trimesh.Trimesh(v, part.surface.faces, process=False)
            scene.add_geometry(mesh, geom_name=part.name.replace(" ", "_"), node_name=part.name.replace(" ", "_"))
    return scene


def description(cabin: Cabin, mesh: str, **extra: Any) -> dict[str, Any]:
    seats = {
        slot: {
            "h_point": [round(float(x), 4) for x in s.design_h_point],
            "fore_aft_mm": [-80, 150] if slot == "driver" else [0, 0],
        }
        for slot, s in cabin.seats.items()
    }
    wheel = cabin.steering_wheel
    assert wheel is not None
    return {
        "mesh": mesh,
        "seats": seats,
        "steering_wheel": {
            "centre": [float(x) for x in wheel.vehicle_from_wheel[:3, 3]],
            "axis": [float(x) for x in wheel.vehicle_from_wheel[:3, 2]],
        },
        "rules": [
            {
                "pattern": "*driver_cushion*",
                "group": "seat:driver/base",
                "label": "seat",
                "material": "seat_leather",
                "give_mm": 55,
            },
            {"pattern": "*driver_backrest*", "group": "seat:driver/back", "label": "seat", "give_mm": 50},
            {"pattern": "*steering_wheel*", "group": "wheel", "label": "steering_wheel", "material": "steering_leather"},
            {"pattern": "*windscreen*", "label": "glass", "material": "glass"},
        ],
        **extra,
    }


def write(folder: Path, content: dict[str, Any]) -> Path:
    path = folder / "car.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def same_place(loaded: Cabin, original: Cabin, tolerance: float = 2e-3) -> None:
    transforms = original.group_transforms({})
    kept = np.concatenate(
        [apply(transforms[p.group], p.surface.vertices) for p in original.parts if any(k in p.name for k in KEEP)]
    )  # fmt: skip
    assert np.allclose(loaded.bounds, np.stack((kept.min(0), kept.max(0))), atol=tolerance)
    for slot, seat in original.seats.items():
        assert np.allclose(loaded.seats[slot].h_point(SeatSetting()), seat.design_h_point, atol=tolerance)


@pytest.mark.parametrize(
    ("suffix", "rotation", "factor", "axes"),
    [
        (".glb", GLTF_FROM_VEHICLE, 1.0, {}),
        (".glb", GLTF_FROM_VEHICLE, 100.0, {}),
        (".gltf", GLTF_FROM_VEHICLE, 1.0, {}),
        (".obj", Z_UP_LOOKS_MINUS_Y, 100.0, {"front_axis": "-y"}),
        (".obj", GLTF_FROM_VEHICLE, 1000.0, {}),
        (".ply", np.eye(3), 1 / 0.0254, {}),
        (".stl", np.eye(3), 1.0, {"up_axis": "z", "front_axis": "x", "unit": "m"}),
    ],
)
def test_axes_and_units(
    tmp_path: Path, sedan: Cabin, suffix: str, rotation: np.ndarray, factor: float, axes: dict[str, str]
) -> None:
    scene = scene_of(sedan, rotation, factor)
    target = tmp_path / f"car{suffix}"
    if suffix in (".ply", ".stl"):
        scene.to_mesh().export(target)
    elif suffix == ".gltf":
        for name, data in trimesh.exchange.gltf.export_gltf(scene).items():
            (tmp_path / ("car.gltf" if name.endswith(".gltf") else name)).write_bytes(data)
    else:
        scene.export(target)
    cabin = load_cabin(
        write(tmp_path, description(sedan, target.name, **axes) | ({"rules": []} if suffix in (".ply", ".stl") else {}))
    )
    same_place(cabin, sedan)
    assert len(cabin.notes) >= (0 if axes.get("unit") else 1)


def test_parts_follow_their_groups_and_rules(tmp_path: Path, sedan: Cabin) -> None:
    scene_of(sedan, GLTF_FROM_VEHICLE, 1.0).export(tmp_path / "car.glb")
    cabin = load_cabin(write(tmp_path, description(sedan, "car.glb")))
    cushion = next(p for p in cabin.parts if "driver_cushion" in p.name)
    assert (cushion.group, cushion.give_m, cushion.solid) == ("seat:driver/base", 0.055, True)
    glass = next(p for p in cabin.parts if "windscreen" in p.name)
    assert (glass.surface.label == LABEL["glass"]).all()
    before = cabin.surface({}).vertices
    after = cabin.surface({"driver": SeatSetting(0.1, 0.0, cabin.seats["driver"].default.torso_angle)}).vertices
    moved = np.linalg.norm(after - before, axis=1)
    driver_parts = sum(len(p.surface.vertices) for p in cabin.parts if p.group.startswith("seat:driver"))
    assert np.isclose(moved[moved > 1e-6], 0.1, atol=1e-5).all()
    assert (moved > 1e-6).sum() == driver_parts
    assert set(cabin.views) >= {"driver", "front_row"}


def test_points_in_the_files_own_coordinates(tmp_path: Path, sedan: Cabin) -> None:
    scene_of(sedan, GLTF_FROM_VEHICLE, 100.0).export(tmp_path / "car.glb")
    content = description(sedan, "car.glb", points="mesh")
    for seat in content["seats"].values():
        seat["h_point"] = [float(x) for x in GLTF_FROM_VEHICLE @ np.array(seat["h_point"]) * 100]
    for key, factor in (("centre", 100.0), ("axis", 1.0)):
        value = GLTF_FROM_VEHICLE @ np.array(content["steering_wheel"][key]) * factor
        content["steering_wheel"][key] = [float(x) for x in value]
    cabin = load_cabin(write(tmp_path, content))
    same_place(cabin, sedan)
    assert cabin.steering_wheel is not None
    assert sedan.steering_wheel is not None
    assert np.allclose(cabin.steering_wheel.vehicle_from_wheel, sedan.steering_wheel.vehicle_from_wheel, atol=1e-6)


def test_open_doubled_and_inward_surfaces(tmp_path: Path, sedan: Cabin) -> None:
    box = trimesh.creation.box((0.3, 0.3, 0.3)).apply_translation((0.2, 0, 0.6))
    opened = trimesh.Trimesh(box.vertices, box.faces[:-2], process=False)
    doubled = trimesh.Trimesh(box.vertices, np.concatenate((box.faces, box.faces[:, ::-1])), process=False)
    inward = trimesh.Trimesh(box.vertices, box.faces[:, ::-1], process=False)
    hull = trimesh.creation.box((5.0, 1.8, 1.4)).apply_translation((-1, 0, 0.6))
    scene = trimesh.Scene()
    for name, mesh in {"opened": opened, "doubled": doubled, "inward": inward, "hull": hull}.items():
        mesh.vertices = mesh.vertices @ GLTF_FROM_VEHICLE.T
        scene.add_geometry(mesh, geom_name=name, node_name=name)
    scene.export(tmp_path / "car.glb")
    cabin = load_cabin(write(tmp_path, description(sedan, "car.glb", rules=[], shell_mm=20)))
    parts = {p.name.split("/")[0]: p for p in cabin.parts}
    assert not parts["opened"].solid
    assert np.isclose(parts["opened"].shell_m, 0.02)
    assert len(parts["doubled"].surface.faces) == 12
    assert parts["inward"].solid
    turned = trimesh.Trimesh(parts["inward"].surface.vertices, parts["inward"].surface.faces, process=True)
    assert turned.volume > 0
    assert not parts["hull"].solid  # people sit in it
    assert any("shell" in n for n in cabin.notes)


def draco_glb(path: Path, mesh: trimesh.Trimesh, *, damaged: bool = False) -> None:
    """A minimal Draco-compressed GLB, put together by hand from the extension's specification."""
    data = DracoPy.encode(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32), quantization_bits=14)
    data = bytes(len(data)) if damaged else data
    data += b"\0" * (-len(data) % 4)
    v = mesh.vertices
    extension = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": "cabin"}],
        "meshes": [{"name": "cabin", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "extensions": extension}]}],
        "accessors": [
            {"componentType": 5126, "type": "VEC3", "count": len(v), "min": v.min(0).tolist(), "max": v.max(0).tolist()},
            {"componentType": 5125, "type": "SCALAR", "count": mesh.faces.size},
        ],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": len(data)}], "buffers": [{"byteLength": len(data)}],
        "extensionsUsed": list(extension), "extensionsRequired": list(extension),
    }  # fmt: skip
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)


def test_draco_is_decoded(tmp_path: Path, sedan: Cabin) -> None:
    draco_glb(tmp_path / "car.glb", scene_of(sedan, GLTF_FROM_VEHICLE, 1.0).to_mesh())
    cabin = load_cabin(write(tmp_path, description(sedan, "car.glb", rules=[])))
    same_place(cabin, sedan)


def test_damaged_draco_is_refused(tmp_path: Path, sedan: Cabin) -> None:
    draco_glb(tmp_path / "car.glb", scene_of(sedan, GLTF_FROM_VEHICLE, 1.0).to_mesh(), damaged=True)
    with pytest.raises(MeshError, match="cannot be decoded"):
        load_cabin(write(tmp_path, description(sedan, "car.glb", rules=[])))


def test_draco_without_its_decoder_is_refused(tmp_path: Path, sedan: Cabin, monkeypatch: pytest.MonkeyPatch) -> None:
    draco_glb(tmp_path / "car.glb", scene_of(sedan, GLTF_FROM_VEHICLE, 1.0).to_mesh())
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(DependencyError, match="Draco"):
        load_cabin(write(tmp_path, description(sedan, "car.glb", rules=[])))


def box_file(path: Path, size: tuple[float, float, float], vertices: np.ndarray | None = None) -> None:
    mesh = trimesh.creation.box(size)
    if vertices is not None:
        mesh = trimesh.Trimesh(vertices, mesh.faces, process=False, validate=False)
    mesh.export(path)


def bad_missing(folder: Path) -> dict[str, Any]:
    return {"mesh": "nowhere.glb"}


def bad_suffix(folder: Path) -> dict[str, Any]:
    (folder / "car.max").write_bytes(b"x")
    return {"mesh": "car.max"}


def bad_bytes(folder: Path) -> dict[str, Any]:
    (folder / "car.glb").write_bytes(b"This is only some text.")
    return {"mesh": "car.glb"}


def bad_cut(folder: Path) -> dict[str, Any]:
    box_file(folder / "whole.glb", (3, 1.2, 1.6))
    (folder / "car.glb").write_bytes((folder / "whole.glb").read_bytes()[:-40])
    return {"mesh": "car.glb"}


def bad_empty(folder: Path) -> dict[str, Any]:
    (folder / "car.obj").write_text("# nothing\n")
    return {"mesh": "car.obj"}


def bad_nan(folder: Path) -> dict[str, Any]:
    v = trimesh.creation.box((3, 1.6, 1.2)).vertices.copy()
    v[2, 1] = np.nan
    box_file(folder / "car.ply", (3, 1.6, 1.2), v)
    return {"mesh": "car.ply"}


def bad_flat(folder: Path) -> dict[str, Any]:
    box_file(folder / "car.ply", (3, 1.6, 0.0))
    return {"mesh": "car.ply", "up_axis": "z"}


def bad_unit(folder: Path) -> dict[str, Any]:
    box_file(folder / "car.ply", (300, 160, 120))
    return {"mesh": "car.ply", "unit": "m"}


def bad_size(folder: Path) -> dict[str, Any]:
    box_file(folder / "car.ply", (0.03, 0.016, 0.012))
    return {"mesh": "car.ply"}


def bad_up(folder: Path) -> dict[str, Any]:
    box_file(folder / "car.ply", (3, 1.5, 1.5))
    return {"mesh": "car.ply"}


def bad_axes(folder: Path) -> dict[str, Any]:
    box_file(folder / "car.ply", (3, 1.6, 1.2))
    return {"mesh": "car.ply", "up_axis": "z", "front_axis": "-z"}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (bad_missing, "no mesh file"), (bad_suffix, "not read"), (bad_bytes, "not a GLB"), (bad_cut, "cannot be read"),
        (bad_empty, "no triangles|cannot be read"), (bad_nan, "not numbers"), (bad_flat, "flat"), (bad_unit, "no car"),
        (bad_size, "no unit"), (bad_up, "which axis is up"), (bad_axes, "one line"),
    ],
)  # fmt: skip
def test_bad_meshes_are_refused_with_the_reason(tmp_path: Path, make: Any, message: str) -> None:
    content = make(tmp_path) | {"seats": {"driver": {"h_point": [0.0, 0.0, 0.0]}}}
    with pytest.raises(MeshError, match=message) as error:
        load_cabin(write(tmp_path, content))
    assert error.value.hint


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("../secret.bin", "outside its folder"), ("%2e%2e/secret.bin", "outside its folder"), ("/dev/zero", "outside its folder"),
        ("link.bin", "outside its folder"), ("parts", "not there"), ("absent.bin", "not there"),
    ],
)  # fmt: skip
def test_a_mesh_reads_no_file_outside_its_folder(tmp_path: Path, uri: str, message: str) -> None:
    folder = tmp_path / "car"
    (folder / "parts").mkdir(parents=True)
    (tmp_path / "secret.bin").write_bytes(bytes(64))
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    (folder / "car.gltf").write_text(json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": uri, "byteLength": 64}]}))
    content = {"mesh": "car.gltf", "seats": {"driver": {"h_point": [0.0, 0.0, 0.0]}}}
    with pytest.raises(MeshError, match=message) as error:
        load_cabin(write(folder, content))
    assert uri in str(error.value)
    assert error.value.hint


def test_a_mesh_reads_the_files_in_its_folder(tmp_path: Path) -> None:
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(trimesh.creation.box((1.2, 1.6, 3.0))))
    (tmp_path / "my parts").mkdir()
    document = json.loads(files.pop("model.gltf"))
    for buffer in document["buffers"]:
        (tmp_path / "my parts" / buffer["uri"]).write_bytes(files[buffer["uri"]])
        buffer["uri"] = f"my%20parts/{buffer['uri']}"
    (tmp_path / "car.gltf").write_text(json.dumps(document))
    (mesh,) = read_mesh(tmp_path / "car.gltf", unit="m").meshes
    assert len(mesh.faces) == 12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seats": {"driver": {"h_point": [9.0, 0, 0]}}}, "outside the mesh"),
        ({"seats": {"dickey": {"h_point": [0, 0, 0]}}}, "dickey"),
        ({"seat": {}}, "seat"),
        ({"seats": {"driver": {"h_point": [0, 0, 0], "fore_aft_mm": [50, -50]}}}, "fore_aft_mm"),
        ({"rules": [{"pattern": "*", "material": "velvet"}]}, "velvet"),
        ({"rules": [{"pattern": "*", "group": "wheel"}]}, "wheel"),
    ],
)
def test_bad_descriptions_are_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    box_file(tmp_path / "car.ply", (3, 1.6, 1.2))
    content = {"mesh": "car.ply", "seats": {"driver": {"h_point": [0.0, 0.0, 0.0]}}} | change
    with pytest.raises(ConfigError, match=message) as error:
        load_cabin(write(tmp_path, content))
    assert error.value.hint


def test_yaml_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot read"):
        load_cabin(tmp_path / "none.yaml")
    (tmp_path / "car.yaml").write_text("[1, 2", encoding="utf-8")
    with pytest.raises(ConfigError, match="not YAML"):
        load_cabin(tmp_path / "car.yaml")


@pytest.mark.parametrize("word", ["o", "g"])
@pytest.mark.parametrize("materials", [False, True])
def test_objects_of_an_obj_file_stay_apart(tmp_path: Path, word: str, materials: bool) -> None:
    """Objects and groups are meshes with their names, whether or not they have materials."""
    lines, boxes = (
        ["mtllib car.mtl"] * materials,
        {"Seat_Driver": (0.5, 0.5, 0.6), "Door": (1.5, 0.1, 1.0), "Body": (4.0, 1.7, 1.4)},
    )
    for number, (name, size) in enumerate(boxes.items()):
        box = trimesh.creation.box(size)
        lines += [f"{word} {name}", *(f"v {x} {y} {z}" for x, y, z in box.vertices), *[f"usemtl grey{number % 2}"] * materials]
        lines += [f"f {a} {b} {c}" for a, b, c in box.faces + 8 * number + 1]
    (tmp_path / "car.obj").write_text("\n".join(lines) + "\n")
    (tmp_path / "car.mtl").write_text("newmtl grey0\nKd 0.5 0.5 0.5\nnewmtl grey1\nKd 0.4 0.4 0.4\n")
    found = {m.name: np.ptp(m.vertices, axis=0) for m in read_mesh(tmp_path / "car.obj", up_axis="z", front_axis="x").meshes}
    assert len(found) == 3
    for name, size in boxes.items():
        (mesh,) = (mesh for mesh in found if mesh.startswith(name))
        assert found[mesh] == pytest.approx(size)


def test_groups_do_not_cut_an_object_of_an_obj_file(tmp_path: Path) -> None:
    """A group lasts over the next object, and often covers a part of one: a seat of two groups is one closed mesh."""
    box = trimesh.creation.box((4.0, 1.7, 1.4))
    faces = [f"f {a} {b} {c}" for a, b, c in box.faces + 1]
    lines = ["o cushion", *(f"v {x} {y} {z}" for x, y, z in box.vertices), "g upper", *faces[:6], "g lower", *faces[6:]]
    (tmp_path / "car.obj").write_text("\n".join(lines) + "\n")
    (mesh,) = read_mesh(tmp_path / "car.obj", up_axis="z", front_axis="x").meshes
    assert (mesh.name.split("/")[0], len(mesh.faces)) == ("cushion", 12)


def test_parts_of_a_mesh_are_called_the_same_at_every_reading(tmp_path: Path) -> None:
    """A node with several materials has several parts, which trimesh gives random names."""
    box = trimesh.creation.box((4.0, 1.6, 1.3))
    files = trimesh.Scene({"body": box, "glass": box.copy(), "seat": box.copy()}).export(file_type="gltf")
    document = json.loads(files["model.gltf"])
    one, two, three = (mesh["primitives"] for mesh in document["meshes"])
    one += [*two, *three]
    document["meshes"] = document["meshes"][:1]
    document["nodes"], document["scenes"] = [{"name": "body", "mesh": 0}], [{"nodes": [0]}]
    files["model.gltf"] = json.dumps(document).encode()
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    named = [[mesh.name for mesh in read_mesh(tmp_path / "model.gltf", up_axis="z", front_axis="x").meshes] for _ in range(3)]
    assert [name.split("/")[0] for name in named[0]] == ["body_1", "body_2", "body_3"]
    assert named[1:] == named[:1] * 2


def whole(cabin: Cabin, folder: Path) -> dict[str, Any]:
    """What describes a car whose mesh is written beside it."""
    scene_of(cabin, GLTF_FROM_VEHICLE, 1.0).export(folder / "car.glb")
    return description(cabin, "car.glb")


@pytest.mark.parametrize(
    ("kept", "of"), [(("driver", "front_passenger"), "the front passenger"), (("driver",), "the centre line")]
)
def test_a_driver_on_the_other_side_is_refused(sedan: Cabin, tmp_path: Path, kept: tuple[str, ...], of: str) -> None:
    """Datasets would say that the wheel is there, and models would exchange the front row by it."""
    told = whole(sedan, tmp_path)
    told["seats"] = {slot: seat for slot, seat in told["seats"].items() if slot in kept}
    assert load_cabin(write(tmp_path, told)).drive_side == "left"
    with pytest.raises(ConfigError, match=f"drive_side is right, and the driver's .* to the left of {of}") as caught:
        load_cabin(write(tmp_path, told | {"drive_side": "right"}))
    assert "drive_side: left" in str(caught.value.hint)


def test_a_rule_that_takes_nothing_is_told(sedan: Cabin, tmp_path: Path) -> None:
    told = whole(sedan, tmp_path)
    far = {"pattern": "*", "within": [[9.0, 9.0, 9.0], [10.0, 10.0, 10.0]], "label": "seat"}
    told["rules"] += [{"pattern": "*cushoin*", "hide": True}, far, {"pattern": "*headlining*", "hide": True}]
    warnings = [words for words in load_cabin(write(tmp_path, told)).warnings if words.startswith("the rule")]
    assert [words.split("'")[1] for words in warnings] == ["*cushoin*", "*"]
    assert "in its box" in warnings[1]


def test_a_view_of_its_own_eye_is_refused(sedan: Cabin, tmp_path: Path) -> None:
    told = whole(sedan, tmp_path) | {"views": {"driver": {"eye": [-0.4, 0, 0.9], "target": [-0.4, 0, 0.9]}}}
    with pytest.raises(ConfigError, match="the view driver coincide"):
        load_cabin(write(tmp_path, told))
