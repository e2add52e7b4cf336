"""16-bit PNG images of the kinds that the thesis renders (2020, section 5.1.3), and one JSON of 2D and 3D poses per frame.

`depth/`, `depth_clean/` in millimetres (0 = invalid), `amplitude/`, `labels/` in their colours, `instance/`, `rgb/`, `nir/`,
and `pose/`; a file's name is the frame's index. `labels.json` is the table of classes, `dataset.json` says what all frames share.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import CABINPOSE, LENGTHS_M, DatasetError, Visibility, skeleton_with
from cabinpose.store.convert.format import DatasetFormat, ImportOptions, NoOptions
from cabinpose.store.convert.reading import (
    Origin,
    given_camera,
    make_manifest,
    put_camera,
    read_image,
    read_json,
)
from cabinpose.store.frames import dataset_skeleton, depth_mm, file_stem, frames, label_colours, label_table, people, write_png
from cabinpose.store.schema import Manifest
from cabinpose.store.shard import ticks_of_steps
from cabinpose.store.source import Report, Source, blank_frame
from cabinpose.store.variables import VARIABLE

if TYPE_CHECKING:
    import xarray as xr

_IMAGES = ("depth", "depth_clean", "depth_styled", "amplitude", "labels", "instance", "rgb", "nir")
_NUMBERS = ("sequence", "sync_ns", "seed")
_DAMAGED = "the export is not whole, or not of this layout; export it again"


class PngJsonFormat(DatasetFormat):
    """16-bit PNG images and a JSON of poses a frame."""

    def read(self, path: Path, options: ImportOptions) -> Source:
        """The frames of an export, in the order of their numbers, which begin at 0 again.

        Joints come to 5 digits of a metre, depth to a millimetre. Raises `DatasetError` for a folder of another layout.
        """
        folder = _Folder.open(path)
        shared = folder.shared
        stems = sorted(p.stem for p in (path / "pose").glob("*.json"))
        try:
            manifest = make_manifest(
                Origin("png-json", path, options),
                frames=len(stems),
                size=(int(shared["size"][0]), int(shared["size"][1])),
                persons=tuple(map(str, shared["persons"])),
                joints=tuple(map(str, shared["joints"])),
                variables=folder.images,
                licence=str(shared["licence"]),
                joint_definition=str(shared.get("joint_definition", "")),
                labels=folder.rows if "labels" in folder.images else (),
                config={"exported_from": str(shared["generator"])},
            )
        except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:  # pydantic's errors are ValueErrors
            raise DatasetError(f"{path}: dataset.json or labels.json is damaged ({error!r})", hint=_DAMAGED) from error
        return Source(path, manifest, lambda: _frames(folder, manifest, stems, options))

    def write(self, parts: Mapping[str, xr.Dataset], folder: Path, _: NoOptions, report: Report) -> None:
        """Write every frame into `folder`."""
        (dataset,) = parts.values()
        images = [name for name in _IMAGES if name in dataset]
        for name in [*images, "pose"]:
            (folder / name).mkdir()
        colours = label_colours(dataset) if "labels" in dataset else None
        if colours is not None:
            rows = [{**row, "rgb": f"#{row['rgb']:06x}"} for row in label_table(dataset)]
            (folder / "labels.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
        (folder / "dataset.json").write_text(json.dumps(_shared(dataset), indent=1), encoding="utf-8")
        for done, frame in enumerate(frames(dataset, images), 1):
            stem = file_stem(frame)
            for name in images:
                pixels = frame[name].values
                if name.startswith("depth"):
                    pixels = depth_mm(pixels)
                elif name == "labels" and colours is not None:
                    pixels = colours[pixels]
                write_png(folder / name / f"{stem}.png", pixels)
            (folder / "pose" / f"{stem}.json").write_text(json.dumps(pose_record(frame), indent=1), encoding="utf-8")
            report(done)


PNG_JSON = PngJsonFormat()


def _shared(dataset: xr.Dataset) -> dict[str, Any]:
    """What holds for every frame of an export."""
    return {
        "generator": f"{dataset.attrs['generator']} {dataset.attrs['generator_version']}",
        "licence": dataset.attrs["licence"],
        "size": [dataset.attrs["width"], dataset.attrs["height"]],
        "persons": [str(name) for name in dataset["person"].values],
        "joints": [str(name) for name in dataset["joint"].values],
        "joint_definition": _definition(dataset),
    }


def _definition(dataset: xr.Dataset) -> str:
    """`joint_definition` of the dataset, or what tells in its place whose joints they are; "" where nothing does."""
    stated, found = str(dataset.attrs.get("joint_definition") or ""), dataset_skeleton(dataset)
    marked = found.definition != skeleton_with(found.joints, CABINPOSE.name).definition
    return stated or (found.definition.removeprefix("those of ") if marked else "")


def pose_record(frame: xr.Dataset) -> dict[str, Any]:
    """The JSON of one frame: camera, place, and everybody with their joints in pixels and metres (camera frame)."""
    joints = [str(name) for name in frame["joint"].values]
    return {
        "frame": int(frame["frame"]),
        "car": str(frame["car"].values),
        "pov": str(frame["pov"].values),
        **{name: str(frame[name].values) for name in ("light", "renderer") if name in frame},
        **{name: int(frame[name].values) for name in _NUMBERS},
        "camera": {
            "k_px": _known(frame["camera_k"].values),
            "dist": _known(frame["camera_dist"].values),
            "vehicle_from_camera": _known(frame["vehicle_from_camera"].values),
        },
        "people": [
            {
                "slot": person.slot,
                "subject": person.subject,
                "action": person.action,
                "joints": {
                    name: {
                        "uv_px": _rounded(person.joints_2d[i], 3),
                        "xyz_m": _rounded(person.joints_3d[i], 5),
                        "visibility": Visibility(int(person.visibility[i])).name.lower(),
                    }
                    for i, name in enumerate(joints)
                },
            }
            for person in people(frame, named=True)
        ],
    }


def _known(values: NDArray[np.float64]) -> list[Any] | None:
    """An array as lists; None where it is not known."""
    return values.tolist() if np.isfinite(values).all() else None


def _rounded(values: Any, digits: int) -> list[float] | None:
    """Rounded numbers; None where one is missing, which JSON has no number for."""
    return [round(float(v), digits) for v in values] if np.isfinite(values).all() else None


@dataclass(frozen=True)
class _Folder:
    """An export: `images` are the variables that it has, `rows` its table of classes with colours as numbers."""

    path: Path
    shared: dict[str, Any]
    images: tuple[str, ...]
    rows: tuple[dict[str, Any], ...]

    @classmethod
    def open(cls, path: Path) -> _Folder:
        if not (path / "dataset.json").is_file() or not (path / "pose").is_dir():
            raise DatasetError(
                f"{path} is no export as png-json: it lacks dataset.json or pose", hint="give the folder that `export` wrote"
            )
        shared = read_json(path / "dataset.json")
        if not isinstance(shared, dict):
            raise DatasetError(f"{path / 'dataset.json'} is no object", hint=_DAMAGED)
        images = tuple(name for name in _IMAGES if (path / name).is_dir())
        rows: tuple[dict[str, Any], ...] = ()
        if "labels" in images:
            try:
                table = read_json(path / "labels.json")
                rows = tuple({"id": row["id"], "name": row["name"], "rgb": int(row["rgb"][1:], 16)} for row in table)
            except (KeyError, TypeError, ValueError) as error:
                raise DatasetError(f"{path / 'labels.json'} is no table of classes ({error!r})", hint=_DAMAGED) from error
            if len({row["rgb"] for row in rows}) < len(rows):
                raise DatasetError(
                    f"{path / 'labels.json'}: two classes share a colour", hint="their pixels cannot be told apart"
                )
            if not rows:  # every pixel is grey
                images = tuple(name for name in images if name != "labels")
        return cls(path, shared, images, rows)

    def pixels(self, name: str, stem: str, ids: dict[int, int]) -> NDArray[Any]:
        """One image of one frame as the dataset stores it."""
        file = self.path / name / f"{stem}.png"
        image = read_image(file)
        if name == "labels":
            return _classes(image, ids, file)
        expected = np.dtype(VARIABLE[name].dtype)
        if image.dtype != expected or (image.ndim == 3) != (name == "rgb"):
            raise DatasetError(f"{file} is {image.dtype} in {image.ndim} dimensions, {name} is {expected}", hint=_DAMAGED)
        return ticks_of_steps(image, LENGTHS_M["mm"]) if name.startswith("depth") else image


def _classes(image: NDArray[Any], ids: dict[int, int], file: Path) -> NDArray[np.uint8]:
    """(H, W) class ids of a picture in their colours."""
    if image.ndim != 3:
        raise DatasetError(f"{file} has no colours", hint=_DAMAGED)
    codes = (image.astype(np.int32) * (1 << 16, 1 << 8, 1)).sum(axis=-1)
    there, inverse = np.unique(codes, return_inverse=True)
    unknown = [f"#{code:06x}" for code in there.tolist() if code not in ids]
    if unknown:
        raise DatasetError(f"{file}: labels.json has no class of colour {', '.join(unknown[:5])}", hint=_DAMAGED)
    table = np.array([ids[code] for code in there.tolist()], np.uint8)
    return table[inverse].reshape(codes.shape)


def _frames(folder: _Folder, manifest: Manifest, stems: list[str], options: ImportOptions) -> Iterator[dict[str, Any]]:
    ids = {row["rgb"]: row["id"] for row in folder.rows}
    camera = given_camera(options, (manifest.width, manifest.height))
    for stem in stems:
        file = folder.path / "pose" / f"{stem}.json"
        frame = blank_frame(manifest)
        try:
            _fill(frame, read_json(file), manifest)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
            raise DatasetError(f"{file} is no pose of this export ({error!r})", hint=_DAMAGED) from error
        if camera is not None:
            put_camera(frame, camera)
        for name in folder.images:
            frame[name] = folder.pixels(name, stem, ids)
        yield frame


def _fill(frame: dict[str, Any], record: dict[str, Any], manifest: Manifest) -> None:
    """The opposite of `pose_record`."""
    frame["car"], frame["pov"] = str(record["car"]), str(record["pov"])
    for name in _NUMBERS:
        frame[name] = np.int64(record[name])
    camera = record["camera"]
    for name, key in (("camera_k", "k_px"), ("camera_dist", "dist"), ("vehicle_from_camera", "vehicle_from_camera")):
        if camera[key] is not None:
            frame[name] = np.array(camera[key], np.float64).reshape(frame[name].shape)
    for person in record["people"]:
        position = manifest.persons.index(person["slot"])
        frame["subject"][position], frame["action"][position] = str(person["subject"]), str(person["action"])
        for joint, values in person["joints"].items():
            at = position, manifest.joints.index(joint)
            frame["visibility"][at] = Visibility[values["visibility"].upper()]
            for name, key in (("joints_2d", "uv_px"), ("joints_3d", "xyz_m")):
                if values[key] is not None:
                    frame[name][at] = values[key]
