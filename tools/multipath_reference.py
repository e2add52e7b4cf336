"""Error of range by multipath, traced and by the model: `multipath_reference.py scenes|trace|compare FOLDER`, `frames CONFIG`.

`scenes` writes what there is to FOLDER: corners of walls, and views of a car. `trace` lets mitransient follow light through it,
all bounces, and needs no cabinpose: run it where mitsuba 3.9 and mitransient 1.3 are, with DRJIT_LIBLLVM_PATH naming LLVM 19.
`compare` prints the table of docs/sensor-model.md, draws its picture into FOLDER, and with `--keep FILE` stores what tests
compare. `frames` prints how large it is in frames of a configuration, without noise, beside what scattered light moves.

Light is a projector in the camera's place, so that it falls on what the camera sees and nothing else; surfaces are Lambertian.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

SIZE, FOV = (176, 144), 1.5  # px, rad across
FREQUENCIES = (80e6, 60e6)
SPEED_OF_LIGHT = 299_792_458.0
BOUNCES = 8
ALBEDOS = (0.3, 0.5, 0.8)
PICTURED = ("corner3_5", "door", "footwell")


def corner(walls: int, albedo: float, half: float = 1.5) -> dict[str, Any]:
    """Squares that meet at right angles in the origin: two walls, and a floor; the camera looks into them from 1 m."""
    from cabinpose.core.frames import look_at

    corners, faces = [], []
    for axis in range(walls):
        u, v = np.eye(3)[(axis + 1) % 3] * 2 * half, np.eye(3)[(axis + 2) % 3] * 2 * half
        start = np.zeros(3) if walls == 3 else np.array((0.0, 0.0, -half))
        faces += [np.array((0, 1, 2)) + 4 * axis, np.array((0, 2, 3)) + 4 * axis]
        corners += [start, start + u, start + u + v, start + v]
    eye = np.array((0.75, 0.65, 0.6 if walls == 3 else 0.1))
    vertices = np.array(corners, np.float32)
    normals = np.repeat(np.eye(3, dtype=np.float32)[:walls], 4, axis=0)
    return {
        "vertices": vertices, "normals": normals, "faces": np.array(faces, np.int32),
        "reflectance": np.full(2 * walls, albedo, np.float32), "world_from_camera": look_at(eye, (0.05, 0.0, 0.05)),
    }  # fmt: skip


def cars() -> dict[str, dict[str, Any]]:
    """A footwell without people, and a driver beside the door."""
    from cabinpose.core.frames import look_at
    from cabinpose.scene.sensor.optics import material_table
    from cabinpose.synth import FrameMaker
    from cabinpose.synth.config import SynthConfig

    table = material_table(True, True, 0.0, 0.0)[:, 0]
    occupancy = {"driver": 1.0, "front_passenger": 0.0, "rear_left": 0.0, "rear_center": 0.0, "rear_right": 0.0}
    config = SynthConfig.model_validate({
        "version": 1,
        "scene": {"kind": "cabin", "cars": ["sedan"], "occupancy": occupancy},
        "camera": {"sensor": "pico_monstar_105/4", "views": {"driver": 1.0}},
    })  # fmt: skip
    scene = FrameMaker(config, 1).make(3)[1]
    found = {}
    for name, surface, world_from_camera in (
        ("footwell", scene.backdrop, look_at((-0.6, -0.2, 0.9), (0.0, -0.55, 0.15))),
        ("door", scene.surface(), look_at((-0.45, -0.3, 0.95), (-0.75, 0.6, 0.6))),
        ("driver", scene.surface(), scene.world_from_camera),
    ):
        found[name] = {
            "vertices": surface.vertices, "normals": surface.normals, "faces": surface.faces, "label": surface.label,
            "reflectance": table[surface.material], "material": surface.material, "world_from_camera": world_from_camera,
        }  # fmt: skip
    return found


def trace(folder: Path, paths: int) -> None:
    """Phasors (H, W, F) of direct and of all light, by mitransient."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_mono")
    import mitransient as mitr

    film = {"width": SIZE[0], "height": SIZE[1], "rfilter": {"type": "box"}, "type": "phasor_hdr_film"}
    for file in sorted(folder.glob("scene_*.npz")):
        given = np.load(file)
        properties = mi.Properties()
        colour = {"type": "mesh_attribute", "name": "face_colour"}
        properties["finish"] = mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": colour}})
        mesh = mi.Mesh("surface", len(given["vertices"]), len(given["faces"]), has_vertex_normals=True, props=properties)
        mesh.add_attribute("face_colour", 1, given["reflectance"])
        values = mi.traverse(mesh)
        values["vertex_positions"], values["vertex_normals"] = given["vertices"].reshape(-1), given["normals"].reshape(-1)
        values["faces"] = given["faces"].reshape(-1).astype(np.uint32)
        values.update()
        # Mitsuba's cameras look along z with x to the left and y up.
        view = {
            "to_world": mi.ScalarTransform4f(given["world_from_camera"] @ np.diag((-1.0, -1.0, 1.0, 1.0))),
            "fov": float(np.degrees(FOV)), "fov_axis": "x",
        }  # fmt: skip
        white = mi.Bitmap(np.ones((SIZE[1], SIZE[0], 1), np.float32))
        scene = mi.load_dict({
            "type": "scene", "surface": mesh,
            "light": {"type": "projector", "irradiance": {"type": "bitmap", "bitmap": white, "raw": True}, **view},
            "camera": {"type": "perspective", "near_clip": 1e-4, "film": film, **view},
        })  # fmt: skip
        scene.sensors()[0].film().frequencies = mitr.utils.ArrayXf([mi.Float(f / SPEED_OF_LIGHT) for f in FREQUENCIES])
        result = {}
        for name, depth in (("direct", 2), ("all", 2 + BOUNCES)):
            integrator = mi.load_dict({"type": "transient_path", "max_depth": depth, "rr_depth": 64})
            total = 0.0
            for seed in range(paths // 64):
                image = np.array(integrator.render(scene, seed=seed, spp=64)[1], np.float64)
                total = total + (image[..., 0] - 1j * image[..., 1]) / (paths // 64)
            result[name] = total.astype(np.complex64)
        np.savez(file.with_name(file.name.replace("scene", "light")), **result)
        print(file.name, result["all"].shape, flush=True)


def scenes(folder: Path) -> None:
    """Writes what `trace` and `compare` read."""
    folder.mkdir(parents=True, exist_ok=True)
    corners = {f"corner{walls}_{round(10 * albedo)}": corner(walls, albedo) for walls in (2, 3) for albedo in ALBEDOS}
    for name, scene in (corners | cars()).items():
        np.savez(folder / f"scene_{name}.npz", **scene)


def sensor() -> Any:
    """The camera and the projector of `trace`."""
    from cabinpose.core.camera import Camera
    from cabinpose.scene.sensor import Sensor

    return Sensor(
        name="reference", camera=Camera.from_fov(*SIZE, FOV), range_m=(0.05, 10.0), integration_s=7e-4, fps=15,
        frequencies_hz=FREQUENCIES, illumination_exponent=-3.0,
    )  # fmt: skip


def ours(scene: Any, unseen: float) -> tuple[Any, Any]:
    """Error of range by multipath (H, W) in m, and the buffers of the view."""
    from cabinpose.core.frames import invert
    from cabinpose.scene.materials import MATERIAL_ID
    from cabinpose.scene.sensor.indirect import indirect_light
    from cabinpose.scene.sensor.optics import material_table
    from cabinpose.scene.surface import Surface
    from cabinpose.synth.render import Rasteriser

    camera, table = sensor().camera, material_table(True, True, 0.0, 0.0).copy()
    none = np.zeros(len(scene["faces"]), np.uint8)
    material = scene["material"] if "material" in scene else none + np.uint8(MATERIAL_ID["painted_wall"])
    if "material" not in scene:
        table[MATERIAL_ID["painted_wall"], 0] = scene["reflectance"][0]
    surface = Surface(scene["vertices"], scene["normals"], scene["faces"], none, material, none)
    buffers = Rasteriser(camera, 2).render(surface, invert(scene["world_from_camera"])).buffers
    light = indirect_light(buffers, sensor(), table, np.array(FREQUENCIES), falloff=True, unseen=unseen)
    ranges = buffers.depth_m * camera.range_over_depth
    with np.errstate(divide="ignore", invalid="ignore"):
        energy = table[buffers.material, 0] * buffers.cos_incidence / ranges**2
    direct = [energy * np.exp(4j * np.pi * f / SPEED_OF_LIGHT * ranges) for f in FREQUENCIES]
    every = [phasor + light[:, 1 + 2 * k] + 1j * light[:, 2 + 2 * k] for k, phasor in enumerate(direct)]
    return range_error(np.stack(direct, -1), np.stack(every, -1)), buffers


def range_error(direct: Any, every: Any) -> Any:
    """Error of range (m) from phasors (H, W, F): the mean of both frequencies that a camera takes."""
    f = np.array(FREQUENCIES)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.angle(every / direct) * SPEED_OF_LIGHT / (4 * np.pi * f) @ (f**2 / np.sum(f**2))


def blocks(image: Any) -> Any:
    """Medians of 4 x 4 pixels (H / 4, W / 4): less noise of the paths, and less to store."""
    parts = image.reshape(SIZE[1] // 4, 4, SIZE[0] // 4, 4).swapaxes(1, 2).reshape(SIZE[1] // 4, SIZE[0] // 4, 16)
    return np.median(parts, axis=-1)  # NaN where a pixel is


def compare(folder: Path, keep: Path | None) -> None:
    """Prints RMS errors, and draws reference, ours and their difference."""
    from cabinpose.app.view.draw import depth_image
    from cabinpose.scene.materials import MATERIAL_ID
    from cabinpose.store.frames import write_png

    kept, rows = {}, []
    print("| scene | reference: mm rms | ours | difference | reference: median, p95 | ours |")
    print("|---|---:|---:|---:|---|---|")
    for file in sorted(folder.glob("scene_*.npz")):
        name, scene = file.stem.removeprefix("scene_"), np.load(file)
        light = np.load(file.with_name(f"light_{name}.npz"))
        theirs = 1e3 * range_error(light["direct"], light["all"])
        error, buffers = ours(scene, 0.15 if "material" in scene else 0.0)
        error *= 1e3
        seen = (
            np.isfinite(theirs) & np.isfinite(error) & ~np.isin(buffers.material, (MATERIAL_ID["nothing"], MATERIAL_ID["glass"]))
        )
        seen.flat[buffers.mixed] = False
        images = [np.where(seen, image, np.nan).astype(np.float32) for image in (theirs, error, error - theirs)]
        means = [blocks(image) for image in images[:2]]
        if "material" not in scene:
            kept[name] = means[0].astype(np.float16)
        a, b = (image[np.isfinite(image)] for image in means)
        rms = [float(np.sqrt(np.mean(x**2))) for x in (a, b, b - a)]
        spread = [", ".join(f"{q:.0f}" for q in np.percentile(x, (50, 95))) for x in (a, b)]
        print(f"| {name} | {rms[0]:.1f} | {rms[1]:.1f} | {rms[2] / rms[0]:.0%} | {spread[0]} | {spread[1]} |")
        if name in PICTURED:
            top = float(np.percentile(a, 98))
            drawn = [depth_image(image, low, top) for image, low in zip(images, (0.0, 0.0, -top), strict=True)]
            rows.append(np.concatenate(drawn, axis=1))
    write_png(folder / "multipath.png", np.concatenate(rows))
    if keep is not None:
        np.savez_compressed(keep, **kept)


PIXELS = {
    "head, neck": ("neck", "head_left", "head_right"),
    "torso, shoulders": ("torso_left", "torso_right", "shoulder_left", "shoulder_right", "hip_left", "hip_right", "hip_center"),
    "arms": tuple(f"{part}_{side}" for part in ("upper_arm", "elbow", "forearm", "wrist") for side in ("left", "right")),
    "hands": ("hand_left", "hand_right"),
    "legs, feet": tuple(f"{part}_{side}" for part in ("thigh", "knee", "shin", "ankle", "foot") for side in ("left", "right")),
    "seats": ("seat",), "trim": ("trim",), "floor": ("floor",),
}  # fmt: skip


def in_frames(path: Path, frames: int) -> None:
    """Prints medians and 95 % of the errors of range (mm), unsigned, by what pixels show."""
    from cabinpose.scene import LABEL_ID
    from cabinpose.scene.sensor import NO_EFFECTS
    from cabinpose.synth import FrameMaker, SynthConfig

    config, none = SynthConfig.load(path), {"reflectance": True, "incidence": True, "vignetting": True, "glass": True}
    changes: tuple[dict[str, Any], ...] = ({}, {"multipath": True}, {"lens_scatter": 0.02})
    noises = [NO_EFFECTS.model_copy(update={**none, "wrapping": True, "circular_field": True, **change}) for change in changes]
    makers = [FrameMaker(config.model_copy(update={"noise": noise}), 1) for noise in noises]
    factor = config.camera.sensor_model.camera.range_over_depth
    errors: dict[str, list[Any]] = {name: [] for name in PIXELS}
    for number in range(frames):
        plain, *changed = (maker.make(number)[0] for maker in makers)
        for name, labels in PIXELS.items():
            where = np.isin(plain["labels"], [LABEL_ID[label] for label in labels]) & np.isfinite(plain["depth"])
            errors[name].append(1e3 * np.abs([((frame["depth"] - plain["depth"]) * factor)[where] for frame in changed]))
    print("| | multipath: median | p95 | scattered light: median | p95 |\n|---|---:|---:|---:|---:|")
    for name, parts in errors.items():
        quantiles = np.nanpercentile(np.concatenate(parts, axis=1), (50, 95), axis=1).T.ravel()
        print(f"| {name} | {' | '.join(f'{q:.1f}' if q < 9.5 else f'{q:.0f}' for q in quantiles)} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["scenes", "trace", "compare", "frames"])
    parser.add_argument("folder", type=Path, help="frames: a configuration")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--paths", type=int, default=1024, help="trace: through a pixel")
    parser.add_argument("--keep", type=Path, help="compare: where to store the reference's errors in the corners (mm)")
    args = parser.parse_args()
    if args.what == "scenes":
        scenes(args.folder)
    elif args.what == "trace":
        trace(args.folder, args.paths)
    elif args.what == "frames":
        in_frames(args.folder, args.frames)
    else:
        compare(args.folder, args.keep)
