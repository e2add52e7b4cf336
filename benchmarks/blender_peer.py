"""Renders exported scenes with Blender's Cycles, for comparison. A script of its own: it runs under Blender's Python.

    python blender_peer.py SCENES_FOLDER THREADS

Every `scene-*.npz` of the folder holds vertices (V, 3) m, faces (F, 3), instance (F,), world_from_camera (4, 4, OpenCV axes)
and the pinhole (width, height, fx, fy, cx, cy). For each, depth and object-index passes are rendered on the CPU with one sample
at the pixel centre and saved as `peer-*.npz`. The last line on stdout is JSON: seconds a frame of the render call alone, by
scene, the same with the making of the meshes, and Blender's version.
"""

# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray


def prepare(width: int, height: int, threads: int) -> None:
    """An empty scene that renders depth and object index with one CPU sample."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    layer = scene.view_layers[0]
    settings = (
        (scene.render, {"engine": "CYCLES", "use_persistent_data": False, "threads_mode": "FIXED", "threads": threads}),
        (scene.render, {"resolution_x": width, "resolution_y": height, "resolution_percentage": 100, "use_file_extension": True}),
        (scene.cycles, {"device": "CPU", "samples": 1, "use_adaptive_sampling": False, "use_denoising": False, "max_bounces": 0}),
        (scene.cycles, {"pixel_filter_type": "BOX", "filter_width": 0.01}),
        (layer, {"use_pass_combined": False, "use_pass_z": True, "use_pass_object_index": True}),
    )
    for item, values in settings:
        for name, value in values.items():
            setattr(item, name, value)
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)


def outputs(folder: Path) -> None:
    """A compositor that writes both passes as float images."""
    scene = bpy.context.scene
    scene.use_nodes = True
    nodes = scene.node_tree.nodes
    nodes.clear()
    layers = nodes.new("CompositorNodeRLayers")
    file = nodes.new("CompositorNodeOutputFile")
    file.base_path = str(folder)
    file.format.file_format = "OPEN_EXR"
    file.format.color_depth = "32"
    file.file_slots.clear()
    for name, socket in (("depth-", "Depth"), ("index-", "IndexOB")):
        file.file_slots.new(name)
        scene.node_tree.links.new(layers.outputs[socket], file.inputs[name])


def place(data: dict[str, NDArray[Any]]) -> None:
    """The meshes of a scene, one object an instance, and its camera."""
    scene = bpy.context.scene
    for number in np.unique(data["instance"]):
        faces = data["faces"][data["instance"] == number]
        used, faces = np.unique(faces, return_inverse=True)
        mesh = bpy.data.meshes.new(f"instance {number}")
        mesh.vertices.add(len(used))
        mesh.vertices.foreach_set("co", data["vertices"][used].astype(np.float32).ravel())
        corners = faces.reshape(-1).astype(np.int32)
        mesh.loops.add(len(corners))
        mesh.loops.foreach_set("vertex_index", corners)
        mesh.polygons.add(len(corners) // 3)
        mesh.polygons.foreach_set("loop_start", np.arange(0, len(corners), 3, dtype=np.int32))
        mesh.update(calc_edges=True)
        item = bpy.data.objects.new(mesh.name, mesh)
        item.pass_index = int(number) + 1
        scene.collection.objects.link(item)
    width, height, fx, fy, cx, cy = (float(v) for v in data["pinhole"])
    camera = scene.camera
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = 1.0, fx / fy
    camera.data.type, camera.data.sensor_fit = "PERSP", "HORIZONTAL"
    camera.data.sensor_width = 36.0
    camera.data.lens = fx * camera.data.sensor_width / width
    camera.data.shift_x = -(cx - (width - 1) / 2) / width
    camera.data.shift_y = (cy - (height - 1) / 2) / width
    camera.data.clip_start, camera.data.clip_end = 0.01, 100.0
    matrix = data["world_from_camera"] @ np.diag([1.0, -1.0, -1.0, 1.0])  # Blender looks along -z with y up
    camera.matrix_world = matrix.T.tolist()  # assigned by columns


def image(path: Path) -> NDArray[np.float32]:
    """The first channel of a float image, top row first."""
    loaded = bpy.data.images.load(str(path), check_existing=False)
    pixels = np.empty(len(loaded.pixels), np.float32)
    loaded.pixels.foreach_get(pixels)
    width, height = loaded.size
    result = pixels.reshape(height, width, -1)[::-1, :, 0].copy()
    bpy.data.images.remove(loaded)
    return result


def main() -> None:
    """Render every scene of the folder given on the command line with the given number of threads."""
    folder, threads = Path(sys.argv[1]), int(sys.argv[2])
    seconds, with_import = [], []
    scenes = sorted(folder.glob("scene-*.npz"))
    for path in [scenes[0], *scenes]:  # the first one twice: its first rendering loads the kernels and is not counted
        data = dict(np.load(path))
        prepare(int(data["pinhole"][0]), int(data["pinhole"][1]), threads)
        outputs(folder)
        imported = time.perf_counter()
        place(data)
        bpy.context.view_layer.update()
        start = time.perf_counter()
        bpy.ops.render.render(write_still=False)
        end = time.perf_counter()
        seconds.append(end - start)
        with_import.append(end - imported)
        written = {name: next(folder.glob(f"{name}-*.exr")) for name in ("depth", "index")}
        depth, index = image(written["depth"]), image(written["index"])
        for file in written.values():
            file.unlink()
        np.savez(folder / path.name.replace("scene-", "peer-"), depth=depth, index=index)
    answer = {"blender": bpy.app.version_string, "seconds": seconds[1:], "seconds_with_import": with_import[1:]}
    sys.stdout.write(json.dumps(answer) + "\n")


if __name__ == "__main__":
    main()
