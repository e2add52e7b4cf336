"""Reads a car's mesh file (glTF, GLB, OBJ, STL, PLY) into named triangle meshes in metres, vehicle axes.

Up axis, front axis and unit are as given, or detected with a note that says why; a file that could be misread is refused.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import trimesh

from cabinpose.core import DependencyError, Floats, Ints32, MeshError, optional_module
from cabinpose.core import reproducible as rp
from cabinpose.scene.cabin.sizes import UNITS

AXES = {f"{sign}{axis}": (-1.0 if sign else 1.0) * np.eye(3)[i] for i, axis in enumerate("xyz") for sign in ("", "-")}
SUFFIXES = (".glb", ".gltf", ".obj", ".stl", ".ply")
MAX_TRIANGLES = 1_000_000
_ELEMENTS = 100 * MAX_TRIANGLES  # of all arrays of a file: vertices, normals, several textures' coordinates
_HEAD = 1 << 16  # bytes in which a PLY says what follows
_LENGTH = (1.2, 8.0)  # longest side of an interior or a whole car, m
_HEIGHT = (0.9, 2.2)  # shortest side; the range is narrower than inch / cm, so that only one unit fits
_UNREADABLE = {
    "EXT_meshopt_compression": "its vertices are compressed with meshopt",
    "KHR_meshopt_compression": "its vertices are compressed with meshopt",
    "KHR_mesh_quantization": "its vertices are quantised integers",
}


@dataclass(frozen=True)
class NamedMesh:
    """vertices (V, 3) float64 m, vehicle axes; faces (F, 3) int32; name "node/geometry/material", for patterns."""

    name: str
    vertices: Floats
    faces: Ints32


@dataclass(frozen=True)
class MeshFile:
    """The meshes of a file, `vehicle_from_mesh` (4x4 with scale), and how unit and axes were found."""

    meshes: tuple[NamedMesh, ...]
    vehicle_from_mesh: Floats
    notes: tuple[str, ...]

    @property
    def front_axis(self) -> str:
        """The axis of the file that is taken for the car's front."""
        return axis_name(self.vehicle_from_mesh[0, :3])

    @property
    def unit(self) -> str:
        """The unit that a length of the file is nearest to."""
        factor = float(np.abs(self.vehicle_from_mesh[0, :3]).max())
        return min(UNITS, key=lambda name: max(UNITS[name] / factor, factor / UNITS[name]))


def read_mesh(
    path: Path, *, up_axis: str = "auto", front_axis: str = "auto", unit: str = "auto", scale: float = 1.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> MeshFile:  # fmt: skip
    """The file's meshes in the vehicle frame.

    Parameters
    ----------
    path
        The mesh file.
    up_axis, front_axis
        'x', '-x', 'y' ... or 'auto'.
    unit
        m, cm, mm, inch or 'auto'.
    scale
        Factor on top of the unit.
    origin
        The vehicle's origin in the file's own coordinates.

    Raises
    ------
    MeshError
        For a file that is missing, broken, empty, flat, not finite, or not of the size of a car.
    DependencyError
        For Draco compression without DracoPy.
    """
    raw = _read(path)
    points = np.concatenate([m.vertices for m in raw])
    extent = points.max(axis=0) - points.min(axis=0)
    notes: list[str] = []
    is_gltf = path.suffix.lower() in (".glb", ".gltf")
    up = AXES[_up_axis(path, up_axis, extent, is_gltf, notes)]
    front = AXES[_front_axis(path, front_axis, up, extent, is_gltf, notes)]
    if abs(float(rp.matmul(up, front))) > 0.5:
        raise MeshError(
            f"{path}: up axis '{up_axis}' and front axis '{front_axis}' are one line", hint="choose two different axes"
        )
    factor = _unit(path, unit, extent, scale, notes)
    rotation = np.stack((front, np.cross(up, front), up))
    matrix = np.eye(4)
    matrix[:3, :3] = factor * rotation
    matrix[:3, 3] = rp.matmul(-factor * rotation, np.asarray(origin, dtype=np.float64))
    meshes = tuple(NamedMesh(m.name, rp.matmul(m.vertices, matrix[:3, :3].T) + matrix[:3, 3], m.faces) for m in raw)
    return MeshFile(meshes, matrix, tuple(notes))


def axis_name(direction: Floats) -> str:
    """The axis (3,) that points most that way, such as -x."""
    axis = int(np.argmax(np.abs(direction)))
    return f"{'-' if direction[axis] < 0 else ''}{'xyz'[axis]}"


def _up_axis(path: Path, given: str, extent: Floats, is_gltf: bool, notes: list[str]) -> str:
    if given != "auto":
        return _known_axis(path, given)
    if is_gltf:
        notes.append("up axis y: glTF says so")
        return "y"
    order = np.argsort(extent, kind="stable")
    low, middle = extent[order[0]], extent[order[1]]
    axis = "xyz"[order[0]]
    if low > 0.92 * middle:
        raise MeshError(
            f"{path}: which axis is up cannot be told from its extents {_sizes(extent)}",
            hint="set up_axis to x, y or z in the YAML",
        )
    notes.append(f"up axis {axis}: a car is lowest that way, extents {_sizes(extent)}")
    return axis


def _front_axis(path: Path, given: str, up: Floats, extent: Floats, is_gltf: bool, notes: list[str]) -> str:
    if given != "auto":
        return _known_axis(path, given)
    if is_gltf and abs(up[1]) > 0.5:
        notes.append("front axis z: glTF assets face +z")
        return "z"
    flat = np.where(np.abs(up) > 0.5, -1.0, extent)
    axis = "xyz"[int(np.argmax(flat))]
    notes.append(f"front axis {axis}: a car is longest that way (set front_axis to -{axis} if it looks backwards)")
    return axis


def _known_axis(path: Path, name: str) -> str:
    if name not in AXES:
        raise MeshError(f"{path}: unknown axis '{name}'", hint=f"known: auto, {', '.join(AXES)}")
    return name


def _unit(path: Path, given: str, extent: Floats, scale: float, notes: list[str]) -> float:
    """Metres per unit of the file."""
    low, high = float(extent.min()), float(extent.max())
    fitting = [
        name for name, f in UNITS.items()
        if _LENGTH[0] <= high * f * scale <= _LENGTH[1] and _HEIGHT[0] <= low * f * scale <= _HEIGHT[1]
    ]  # fmt: skip
    if given == "auto":
        if len(fitting) != 1:
            raise MeshError(
                f"{path}: no unit makes a car of its extents {_sizes(extent)}",
                hint=f"set unit to one of {', '.join(UNITS)}, or scale",
            )
        notes.append(f"unit {fitting[0]}: only so are its extents {_sizes(extent)} those of a car")
        return UNITS[fitting[0]] * scale
    if given not in UNITS:
        raise MeshError(f"{path}: unknown unit '{given}'", hint=f"known: auto, {', '.join(UNITS)}")
    factor = UNITS[given] * scale
    if not 0.5 * _LENGTH[0] <= high * factor <= 2 * _LENGTH[1]:
        better = f"unit {fitting[0]} would fit" if fitting else "check unit and scale"
        raise MeshError(f"{path}: in '{given}' it is {high * factor:.4g} m long, which is no car", hint=better)
    return factor


def _sizes(extent: Floats) -> str:
    return " x ".join(f"{e:.4g}" for e in extent)


def _read(path: Path) -> list[NamedMesh]:
    if path.suffix.lower() not in SUFFIXES:
        raise MeshError(f"{path}: a mesh of this kind is not read", hint=f"convert it to one of {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise MeshError(f"there is no mesh file {path}", hint="the path in the YAML counts from the YAML's folder")
    try:
        kind = path.suffix.lower()
        if kind == ".ply":
            _check_ply(path)
        # trimesh makes one mesh of all of an OBJ file that is of one material, and names it after the first object
        apart: dict[str, Any] = _apart(path) if kind == ".obj" else {}
        is_gltf = kind in (".glb", ".gltf")
        meshes = _meshes_of(path, _gltf_scene(path) if is_gltf else trimesh.load_scene(path, process=False, **apart))
    except (MeshError, DependencyError):
        raise
    except Exception as error:  # readers of foreign files fail in every way there is
        raise MeshError(f"{path} cannot be read: {error}", hint="open it in a mesh viewer and export it anew") from error
    count = sum(len(m.faces) for m in meshes)
    if count == 0:
        raise MeshError(f"{path} holds no triangles", hint="export faces, not points, lines or an empty scene")
    if count > MAX_TRIANGLES:
        raise MeshError(f"{path} holds {count} triangles, more than {MAX_TRIANGLES}", hint="decimate it to some 100 000 first")
    points = np.concatenate([m.vertices for m in meshes])
    if float(np.ptp(points, axis=0).min()) <= 1e-9 * float(np.ptp(points, axis=0).max()):
        raise MeshError(f"{path} is flat: all vertices lie in a plane or a point", hint="export the whole cabin")
    return meshes


def _apart(path: Path) -> dict[str, Any]:
    """How trimesh takes an OBJ apart: by objects, or by groups where there are none; groups cut through closed objects."""
    with path.open(encoding="utf-8", errors="replace") as file:
        named = any(line.startswith("o ") for line in file)
    return {"split_objects": named, "split_groups": not named}


def _meshes_of(path: Path, scene: trimesh.Scene) -> list[NamedMesh]:
    """The triangle meshes of a scene, in its own frame."""
    meshes = []
    names = _steady_names(scene)
    for node in scene.graph.nodes_geometry:
        matrix, key = scene.graph[node]
        geometry = scene.geometry[key]
        if not isinstance(geometry, trimesh.Trimesh) or len(geometry.faces) == 0:
            continue
        material = getattr(getattr(geometry.visual, "material", None), "name", None) or ""
        vertices = rp.matmul(np.asarray(geometry.vertices, dtype=np.float64), matrix[:3, :3].T) + matrix[:3, 3]
        if geometry.faces.min() < 0 or geometry.faces.max() >= len(vertices):
            wrong = f"{path}: mesh '{key}' has triangles of vertices that it lacks"
            raise MeshError(wrong, hint="the file is damaged: copy or export it again")
        faces = np.asarray(geometry.faces, dtype=np.int32)
        if rp.matmul(np.cross(matrix[0, :3], matrix[1, :3]), matrix[2, :3]) < 0:
            faces = np.ascontiguousarray(faces[:, ::-1])
        name = f"{names[node]}/{key}/{material}"
        if not np.isfinite(vertices).all():
            bad = int((~np.isfinite(vertices)).any(axis=1).sum())
            raise MeshError(f"{path}: mesh '{name}' has {bad} vertices that are not numbers", hint="repair the export")
        if not np.asarray(geometry.vertices).any():  # what trimesh leaves where it cannot decompress
            raise MeshError(f"{path}: the vertices of mesh '{name}' cannot be decoded", hint="export it without compression")
        meshes.append(NamedMesh(name, vertices, faces))
    return meshes


def _steady_names(scene: trimesh.Scene) -> dict[str, str]:
    """Names of the nodes with triangles, by trimesh's, which gives those of a mesh with several materials six random characters.

    In their place stands the number of the part.
    """
    parents, counts = scene.graph.transforms.parents, Counter[str]()
    names = {}
    for node in scene.graph.nodes_geometry:
        owner = str(parents.get(node, ""))
        if re.fullmatch(rf"{re.escape(owner)}_[0-9a-f]{{6}}", node):
            counts[owner] += 1
            names[node] = f"{owner}_{counts[owner]}"
        else:
            names[node] = node
    return names


def _check_ply(path: Path) -> None:
    """Raise MeshError where a PLY's head claims more elements than the file has bytes: memory is asked for by it."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    claimed = [int(count) for count in re.findall(rb"^element\s+\S+\s+(\d{1,18})\s*$", head, re.M)]
    if sum(claimed) > path.stat().st_size:
        raise MeshError(f"{path} claims {sum(claimed)} elements, more than it has bytes", hint="copy or export it again")


def _gltf_scene(path: Path) -> trimesh.Scene:
    """The scene of a glTF or GLB file; of the files that it names only its buffers are read."""
    data = path.read_bytes()
    if path.suffix.lower() == ".glb":
        if data[:4] != b"glTF":
            raise MeshError(f"{path} is not a GLB file", hint="its first four bytes should be 'glTF'")
        data = data[20 : 20 + int.from_bytes(data[12:16], "little")]  # the first chunk; after its length comes its type
    document = json.loads(data)
    counts = [accessor.get("count", 0) for accessor in document.get("accessors", [])]
    if sum(counts) > _ELEMENTS:
        raise MeshError(
            f"{path} claims {sum(counts)} elements", hint="it is damaged, or to be decimated to some 100 000 triangles"
        )
    used = set(document.get("extensionsUsed", [])) | set(document.get("extensionsRequired", []))
    for extension, why in _UNREADABLE.items():
        if extension in used:
            raise MeshError(f"{path} uses {extension}: {why}, which is not read", hint="export it without, or with Draco")
    if "KHR_draco_mesh_compression" in used:  # trimesh would read zeros without the decoder
        optional_module("DracoPy", purpose=f"{path}, which is Draco-compressed,", hint="pip install 'cabinpose[draco]'")
    named = [b["uri"] for b in document.get("buffers", []) if not b.get("uri", "data:").startswith("data:")]
    with path.open("rb") as file:
        beside = {uri: _beside(path, uri).read_bytes() for uri in named}
        return trimesh.load_scene(file, file_type=path.suffix[1:].lower(), resolver=beside)


def _beside(path: Path, uri: str) -> Path:
    """The file that a mesh names, refused outside of the mesh's folder: a downloaded mesh must not make us read private files
    or an endless device.
    """
    folder, found = path.parent.resolve(), (path.parent / unquote(uri)).resolve()
    if not found.is_relative_to(folder):
        raise MeshError(f"{path} names the file '{uri}', which is outside its folder", hint="copy it there, or export a .glb")
    if not found.is_file():
        raise MeshError(f"{path} names the file '{uri}', which is not there", hint="copy all files of the export into one folder")
    return found
