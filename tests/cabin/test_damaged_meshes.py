"""Damaged meshes end in words, before memory is asked for what they claim."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cabinpose.core.errors import MeshError
from cabinpose.scene.cabin.car_draft import draft_car_file
from cabinpose.scene.cabin.meshfile import read_mesh


def car_like(path: Path) -> Path:
    """A box of the size of a car."""
    trimesh.Trimesh(*_box(), process=False).export(path)
    return path


def _box() -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box((1.8, 1.3, 4.2))
    return np.asarray(box.vertices), np.asarray(box.faces)


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
@pytest.mark.parametrize("index", [200, -1, 1 << 31])
def test_triangles_of_vertices_that_are_not_there(tmp_path: Path, suffix: str, index: int) -> None:
    path = car_like(tmp_path / f"car{suffix}")
    data = path.read_bytes()
    faces = _box()[1][0]
    known = [faces.astype(kind).tobytes() for kind in ("<i4", "<u4", "<u2")]
    at = next(data.rindex(pattern) for pattern in known if pattern in data)
    size = 2 if known[2] in data and known[0] not in data else 4
    value = (index & ((1 << 8 * size) - 1)).to_bytes(size, "little")
    path.write_bytes(data[:at] + value + data[at + size :])
    with pytest.raises(MeshError, match=r"triangles of vertices that it lacks|cannot be read"):
        draft_car_file(path, tmp_path / "car.yaml", up_axis="y", front_axis="z", unit="m")


def test_counts_are_held_against_the_file(tmp_path: Path) -> None:
    path = car_like(tmp_path / "car.ply")
    path.write_bytes(path.read_bytes().replace(b"element vertex 8", b"element vertex 800000000"))
    with pytest.raises(MeshError, match="claims 800000012 elements, more than it has bytes"):
        read_mesh(path)
    path = car_like(tmp_path / "car.glb")
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + length])
    document["accessors"][0]["count"] = 10**10
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + data[20 + length :]
    path.write_bytes(data[:8] + struct.pack("<I", 12 + len(body)) + body)
    with pytest.raises(MeshError, match=r"claims 100000000.. elements"):
        read_mesh(path)
