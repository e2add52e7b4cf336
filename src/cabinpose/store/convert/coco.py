"""COCO keypoints (cocodataset.org, data format): `annotations/person_keypoints.json` beside `images/`; of splits,
`person_keypoints_<split>.json` and `images/<split>/` each.

Written: v = 0 not labelled (absent, or outside the image; x = y = 0), 1 labelled but occluded, by
something else or by the person's own body, 2 labelled and visible. The box, area and segmentation are those of the
person's visible pixels; a person without any is left out. Where nobody's pixels are known, as in recordings, the box is that
about the labelled keypoints, and a person without any is left out. Keypoints keep our pixels: an integer is a pixel's centre.
Beyond COCO's keys, an image has its camera, car and view, a person its slot, subject and action, the category the OKS sigmas of
its joints, `info` the list of slots and the scale of the images.

Read: ours, or any with people's keypoints by name. A COCO file knows pixels, not metres: `joints_3d` is NaN, and a labelled joint
has its visibility and `joints_2d` alone. v = 0 is absent, 1 occluded, 2 visible. Keypoints are those of COCO's 17 that the
skeleton has; nose, eyes and ears are left out. Crowds (`iscrowd`), boxes without keypoints and people without a labelled joint
are no people here; an image without anybody is a frame with nobody. With `lift` visible joints have `joints_3d` (`lift_visible`).
Our own exports with images of 8 bits come back without images: steps of 16 mm of depth are too coarse for a dataset. The file
may be larger than memory: it is read element by element, and what is kept of a person are keypoints and run lengths, about 1 kB.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import CABINPOSE, LENGTHS_M, Camera, DatasetError, Visibility
from cabinpose.store.convert.format import DatasetFormat, ImportOptions, Keypoints, LabelFormat, NoOptions
from cabinpose.store.convert.pictures import PICTURES, check_kind, pictured
from cabinpose.store.convert.reading import (
    Origin,
    given_camera,
    json_elements,
    lift_visible,
    make_manifest,
    put_camera,
    read_image,
    warn_of_boxes,
)
from cabinpose.store.frames import PersonInFrame, dataset_skeleton, file_stem, people, require_variables
from cabinpose.store.schema import Manifest
from cabinpose.store.shard import ticks_of_steps
from cabinpose.store.source import UNKNOWN, Report, Source, blank_frame

if TYPE_CHECKING:
    import xarray as xr

FLAG = np.zeros(256, np.int64)  # COCO's visibility by ours
FLAG[[Visibility.OCCLUDED, Visibility.SELF_OCCLUDED]] = 1
FLAG[Visibility.VISIBLE] = 2
_STATES = np.array([Visibility.ABSENT, Visibility.OCCLUDED, Visibility.VISIBLE], np.uint8)  # by COCO's v
_OURS = {name: name for name in CABINPOSE.index} | {theirs: ours for ours, theirs in CABINPOSE.maps["coco"].items()}
_MOST_INSTANCES = 254  # of a uint8 that has 0 for nobody
_KEYS = ("info", "licenses.item", "categories.item", "images.item", "annotations.item")  # in the order in which they are read
_CAMERA = ("camera_k", "camera_dist", "vehicle_from_camera")
_IMAGE_KEYS = ("id", "file_name", "width", "height", "car", "pov", *_CAMERA)  # what is kept of an image
CocoImages = Literal["depth8", "amplitude8", "rgb", "depth16"]
_HINT = "cocodataset.org describes the format; is the file cut short, or made by something else?"


@dataclass(frozen=True, kw_only=True)
class CocoImport(ImportOptions):
    """How a COCO file is read."""

    images: Path | None = None
    """Folder of the images; default: `images` beside `annotations`, else joints only."""
    lift: bool = False
    """Give joints that are seen (v = 2) a place in space, from the depth at their pixel: what training and 3D figures need."""


@dataclass(frozen=True, kw_only=True)
class CocoExport:
    """How a COCO file is written."""

    images: CocoImages = "depth8"
    """What the pictures show, in 8 bits of grey, in colour or in 16 bits of millimetres."""

    def __post_init__(self) -> None:
        check_kind(self.images, get_args(CocoImages))


class CocoFormat(DatasetFormat):
    """COCO keypoints, with pictures."""

    import_options, export_options = CocoImport, CocoExport
    tells_splits = True

    def read(self, path: Path, options: CocoImport) -> Source:
        """The images of a COCO file, in its order, from the file or a folder with `annotations/`.

        Pixels are imported from `options.images`, or from an `images/` (or `images/<split>/`) beside `annotations/`: 16-bit
        images as depth in mm, others as rgb, those of 8 bits of our own export only where `options.images` names them. Smaller
        images than the largest are filled up to the right and below with 0. Raises `DatasetError` for a file that is no COCO,
        names no joint that the skeleton has, or contradicts itself.
        """
        file = _read_file(_annotations(path))
        everybody = [person for group in file.people.values() for person in group]
        if not file.images:
            raise DatasetError(f"{file.path} lists no image", hint=_HINT)
        persons = file.slots if file.slots and all(p.slot in file.slots for p in everybody) else ()
        if not persons:
            persons = tuple(f"person_{i + 1}" for i in range(max(map(len, file.people.values()), default=1)))
        size = max(i["width"] for i in file.images.values()), max(i["height"] for i in file.images.values())
        grey = options.images is None and file.images_kind.endswith("8")
        folder = None if grey else options.images or _images_beside(file.path)
        variables = [_kind(folder, next(iter(file.images.values())))] if folder is not None else []
        if everybody and len(persons) <= _MOST_INSTANCES and all(person.counts is not None for person in everybody):
            variables.append("instance")
        manifest = make_manifest(
            Origin("coco", path, options),
            frames=len(file.images),
            size=size,
            persons=persons,
            variables=tuple(variables),
            licence=", ".join(file.licences) or UNKNOWN,
            config={"lift": options.lift},
        )
        note = (
            f"the images are {file.images_kind}, too coarse for a dataset: joints and masks are imported without them "
            "(`export coco --images depth16` keeps the depth)"
        )
        return Source(path, manifest, lambda: _frames(file, folder, manifest, options), note if grey else "")

    def write(self, parts: Mapping[str, xr.Dataset], folder: Path, options: CocoExport, report: Report) -> None:
        """Write the frames of every split (or of "", all of them) into `folder`; `DatasetError` without images."""
        (folder / "annotations").mkdir()
        done = 0
        for name, dataset in parts.items():
            require_variables(dataset, "COCO", (PICTURES[options.images].variable,))
            content = _head(dataset, options.images)
            for frame in pictured(dataset, folder / "images" / name, options.images):
                height, width = dataset.sizes["y"], dataset.sizes["x"]
                image = {"id": int(frame["frame"]), "file_name": f"{file_stem(frame)}.png", "width": width, "height": height}
                content["images"].append({**image, **_place(frame), "license": 1})
                for person in frame_annotations(frame):
                    number = len(content["annotations"]) + 1
                    content["annotations"].append({"id": number, "image_id": image["id"], **person})
                done += 1
                report(done)
            file = "_".join(filter(None, ("person_keypoints", name))) + ".json"
            (folder / "annotations" / file).write_text(json.dumps(content), encoding="utf-8")


class CocoLabelsFormat(LabelFormat):
    """Corrected joints of an export as coco, which become labels."""

    def read(self, path: Path, _: NoOptions) -> list[Keypoints]:
        """Everybody in a COCO file, or in a folder with `annotations/`. Raises `DatasetError` as `CocoFormat.read` does."""
        file = _read_file(_annotations(path))
        found = []
        for number, group in file.people.items():
            image = file.images[number]
            for person in group:
                named = zip(file.names[person.category], person.keypoints.tolist(), strict=True)
                joints = {_OURS[name]: (round(u, 3), round(v, 3), int(flag)) for name, (u, v, flag) in named if name in _OURS}
                size = image["width"], image["height"]
                found.append(Keypoints(str(image.get("file_name", "")), size, person.slot, joints))
        return found


COCO = CocoFormat()
COCO_LABELS = CocoLabelsFormat()


class _Person(NamedTuple):
    """One annotation.

    keypoints: (K, 3) u, v px and COCO's visibility · counts: run lengths of the mask, None without · box: (4,) as it stands
    there, None without.
    """

    category: int
    keypoints: NDArray[np.float32]
    slot: str | None
    subject: str
    action: str
    mask_shape: tuple[int, int] | None
    counts: NDArray[np.int32] | None
    box: NDArray[np.float32] | None


@dataclass
class _File:
    """What a COCO file holds."""

    path: Path
    slots: tuple[str, ...] = ()
    images_kind: str = ""  # of an export of ours
    licences: list[str] = field(default_factory=list)
    names: dict[int, list[str]] = field(default_factory=dict)  # keypoints by category
    images: dict[int, dict[str, Any]] = field(default_factory=dict)
    people: dict[int, list[_Person]] = field(default_factory=lambda: defaultdict(list))  # by image


# ------------------------------------------------------------------------------------------------------------ writing


def _head(dataset: xr.Dataset, images: str) -> dict[str, Any]:
    """What a file says of all its frames, with none in it yet."""
    skeleton = dataset_skeleton(dataset)
    return {
        "info": {
            "description": f"made with {dataset.attrs['generator']} {dataset.attrs['generator_version']}",
            "version": "1.0",
            "slots": [str(name) for name in dataset["person"].values],
            "images": {"kind": images, **PICTURES[images].scale},
        },
        "licenses": [{"id": 1, "name": dataset.attrs["licence"], "url": ""}],
        "categories": [
            {
                "id": 1,
                "name": "person",
                "supercategory": "person",
                "keypoints": list(skeleton.joints),
                "skeleton": [[a + 1, b + 1] for a, b in skeleton.limbs],
                "sigmas": list(skeleton.sigma.values()),
            }
        ],
        "images": [],
        "annotations": [],
    }


def _place(frame: xr.Dataset) -> dict[str, Any]:
    """What an image says beyond COCO; the camera is left out where it is not known."""
    cameras = {name: frame[name].values for name in ("camera_k", "camera_dist", "vehicle_from_camera")}
    known = {name: values.tolist() for name, values in cameras.items() if np.isfinite(values).all()}
    words = {name: str(frame[name].values) for name in ("car", "pov", "light", "renderer") if name in frame}
    return {**words, **known}


def frame_annotations(frame: xr.Dataset) -> list[dict[str, Any]]:
    """The COCO annotations of a frame, without their numbers: everybody of whom a pixel, or else a keypoint, is labelled."""
    if "instance" not in frame:
        keypoints = [(person, _keypoints(person)) for person in people(frame)]
        return [_annotation(person, points, _box_of(points)) for person, points in keypoints if points[:, 2].any()]
    masks = [(person, frame["instance"].values == person.position + 1) for person in people(frame)]
    return [annotation(person, mask) for person, mask in masks if mask.any()]


def annotation(person: PersonInFrame, mask: NDArray[np.bool_]) -> dict[str, Any]:
    """The COCO annotation of a person whose visible pixels are `mask` (H, W)."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    left, top = int(columns[0]), int(rows[0])
    box = {
        "bbox": [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1],
        "area": int(mask.sum()),
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
    }
    return _annotation(person, _keypoints(person), box)


def _keypoints(person: PersonInFrame) -> NDArray[np.float64]:
    """(J, 3) u, v and COCO's visibility; 0 where a joint is not labelled."""
    flags = FLAG[person.visibility]
    return np.column_stack((np.where(flags[:, None] > 0, person.joints_2d, 0.0), flags))


def _box_of(points: NDArray[np.float64]) -> dict[str, Any]:
    """What COCO asks for beside the keypoints (J, 3), of somebody whose pixels are not known."""
    known = points[points[:, 2] > 0, :2]
    (left, top), (width, height) = known.min(axis=0).tolist(), np.ptp(known, axis=0).tolist()
    return {"bbox": [round(x, 3) for x in (left, top, width, height)], "area": round(width * height, 3), "segmentation": []}


def _annotation(person: PersonInFrame, points: NDArray[np.float64], box: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "category_id": 1,
        "iscrowd": 0,
        **box,
        "num_keypoints": int((points[:, 2] > 0).sum()),
        "keypoints": [x for u, v, flag in points.tolist() for x in (round(u, 3), round(v, 3), int(flag))],
        "subject": person.subject,
        "slot": person.slot,
        "action": person.action,
    }


def run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """COCO's uncompressed run lengths of a mask (H, W): column by column, beginning with a run of zeros."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    edges = [0, *changes.tolist(), flat.size]
    lengths = [b - a for a, b in pairwise(edges)]
    return [0, *lengths] if flat[0] else lengths


# ------------------------------------------------------------------------------------------------------------ reading


def _annotations(path: Path) -> Path:
    if path.is_file():
        return path
    found = sorted((path / "annotations").glob("person_keypoints*.json")) or sorted(path.glob("person_keypoints*.json"))
    if len(found) != 1:
        names = ", ".join(file.name for file in found) or "none"
        raise DatasetError(f"{path} has {len(found)} files person_keypoints*.json: {names}", hint="give one file of annotations")
    return found[0]


def _images_beside(annotations: Path) -> Path | None:
    images = annotations.parent.parent / "images"
    split = images / annotations.stem.removeprefix("person_keypoints").removeprefix("_")
    folder = split if split.is_dir() else images
    return folder if annotations.parent.name == "annotations" and folder.is_dir() else None


def _read_file(path: Path) -> _File:
    file = _File(path)
    for key, element in json_elements(path, _KEYS, hint=_HINT):
        try:
            if key == "images.item":
                _add_image(file, element)
            elif key == "annotations.item":
                _add_person(file, element)
            elif key == "categories.item" and element.get("keypoints"):
                file.names[int(element["id"])] = [str(name) for name in element["keypoints"]]
            elif key == "licenses.item":
                file.licences.append(str(element["name"]))
            elif key == "info" and isinstance(element, dict):
                file.slots = tuple(map(str, element.get("slots", ())))
                file.images_kind = str(element.get("images", {}).get("kind", ""))
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
            what = element.get("id") if isinstance(element, dict) else element
            raise DatasetError(f"{path}: {key.removesuffix('.item')} {what} is not COCO's ({error!r})", hint=_HINT) from error
    if not file.names:
        raise DatasetError(f"{path} has no category with keypoints", hint="give a file of keypoints, not of boxes or captions")
    _check_people(file)
    return file


def _add_image(file: _File, element: Mapping[str, Any]) -> None:
    number = int(element["id"])
    if number in file.images:
        raise ValueError("the id is there twice")
    if not all(isinstance(element[name], int) and element[name] > 0 for name in ("width", "height")):
        raise ValueError("an image has a width and a height in pixels")
    file.images[number] = {name: element[name] for name in _IMAGE_KEYS if name in element}


def _add_person(file: _File, element: Mapping[str, Any]) -> None:
    if element.get("iscrowd") or not element.get("keypoints"):
        return
    keypoints = np.array(element["keypoints"], np.float32).reshape(-1, 3)
    if not np.isin(keypoints[:, 2], (0, 1, 2)).all() or not np.isfinite(keypoints).all():
        raise ValueError("a keypoint is u, v and a visibility of 0, 1 or 2")
    if not keypoints[:, 2].any():
        return
    mask = element.get("segmentation")
    counts, shape = None, None
    if isinstance(mask, dict) and isinstance(mask["counts"], list):  # polygons and compressed run lengths are left out
        counts, shape = np.array(mask["counts"], np.int32), (int(mask["size"][0]), int(mask["size"][1]))
        if counts.min(initial=0) < 0 or counts.sum() != shape[0] * shape[1]:
            raise ValueError("the run lengths do not fill the mask")
    file.people[int(element["image_id"])].append(
        _Person(
            int(element["category_id"]),
            keypoints,
            _slot(element),
            str(element.get("subject", UNKNOWN)),
            str(element.get("action", UNKNOWN)),
            shape,
            counts,
            _box(element.get("bbox")),
        )
    )


def _box(given: Any) -> NDArray[np.float32] | None:
    """Four finite numbers; nothing else of a box is read, and one that is none is as good as no box."""
    numbers = given if isinstance(given, list) and all(isinstance(each, int | float) for each in given) else []
    box = np.array(numbers, np.float32)
    return box if box.shape == (4,) and np.isfinite(box).all() else None


def _slot(element: Mapping[str, Any]) -> str | None:
    """Our exports' key, or the attribute that other tools keep of a person."""
    attributes = element.get("attributes")
    slot = element.get("slot", attributes.get("slot") if isinstance(attributes, dict) else None)
    return None if slot is None else str(slot)


def _check_people(file: _File) -> None:
    """What can be told of people only when all of the file is known."""
    lost = sorted(file.people.keys() - file.images.keys())
    if lost:
        raise DatasetError(f"{file.path}: annotations are of the image {lost[0]}, which is not listed", hint=_HINT)
    human = {category for category, names in file.names.items() if any(name in _OURS for name in names)}
    if not human:
        names = ", ".join(name for names in file.names.values() for name in names)
        raise DatasetError(f"{file.path}: none of the keypoints {names} is a joint of ours", hint=f"known: {', '.join(_OURS)}")
    for image, group in file.people.items():
        for person in group:
            expected = len(file.names.get(person.category, ()))
            if len(person.keypoints) != expected:
                raise DatasetError(
                    f"{file.path}: somebody in image {image} has {len(person.keypoints)} keypoints, the category {expected}",
                    hint=_HINT,
                )
        slots = [person.slot for person in group if person.slot is not None]
        if len(set(slots)) < len(slots):
            raise DatasetError(f"{file.path}: two people of image {image} are in one slot", hint="give each a slot of its own")
        group[:] = [person for person in group if person.category in human]  # animals have keypoints too
    boxed = [person for group in file.people.values() for person in group if person.box is not None]
    known = [person.keypoints[person.keypoints[:, 2] > 0, :2] for person in boxed]
    spans = np.array([[*points.min(axis=0), *points.max(axis=0)] for points in known]).reshape(-1, 4)
    warn_of_boxes(file.path, "x, y, width, height", np.array([person.box for person in boxed]).reshape(-1, 4), spans)


# ----------------------------------------------------------------------------------------------------------- frames


def _frames(file: _File, folder: Path | None, manifest: Manifest, options: CocoImport) -> Iterator[dict[str, Any]]:
    columns = {
        category: np.array([(i, CABINPOSE.index[_OURS[name]]) for i, name in enumerate(names) if name in _OURS]).T
        for category, names in file.names.items()
        if any(name in _OURS for name in names)
    }
    by_slot, masks = manifest.persons == file.slots, "instance" in manifest.variables
    for number, image in file.images.items():
        frame = blank_frame(manifest)
        frame["car"], frame["pov"] = str(image.get("car", UNKNOWN)), str(image.get("pov", UNKNOWN))
        _put_camera(frame, image, manifest, options, file.path)
        if folder is not None:
            kind = manifest.variables[0]
            frame[kind] = _padded(_pixels(folder, image, kind), manifest)
        if masks:
            frame["instance"] = np.zeros((manifest.height, manifest.width), np.uint8)
        for i, person in enumerate(file.people.get(number, ())):
            position = manifest.persons.index(person.slot) if by_slot and person.slot is not None else i
            frame["subject"][position], frame["action"][position] = person.subject, person.action
            theirs, ours = columns[person.category]
            labelled = person.keypoints[theirs, 2] > 0
            frame["visibility"][position, ours] = _STATES[person.keypoints[theirs, 2].astype(np.int64)]
            frame["joints_2d"][position, ours[labelled]] = person.keypoints[theirs[labelled], :2]
            if masks:
                frame["instance"][_mask(person, image, file.path)] = position + 1
        if options.lift:
            lift_visible(frame, manifest)
        yield frame


def _put_camera(frame: dict[str, Any], image: Mapping[str, Any], manifest: Manifest, options: ImportOptions, path: Path) -> None:
    """The user's camera, or the one that our own export wrote."""
    camera: Camera | None = given_camera(options, (manifest.width, manifest.height))
    if camera is not None:
        put_camera(frame, camera)
        return
    for name in _CAMERA:
        if name in image:
            values = np.array(image[name], np.float64)
            if values.shape != frame[name].shape:
                raise DatasetError(f"{path}: image {image['id']} has {name} of the shape {values.shape}", hint=_HINT)
            frame[name] = values


def _kind(folder: Path, image: Mapping[str, Any]) -> str:
    """The variable that a folder of images becomes, as its first image tells."""
    return "depth" if _read(folder, image).dtype == np.uint16 else "rgb"


def _read(folder: Path, image: Mapping[str, Any]) -> NDArray[Any]:
    if not isinstance(image.get("file_name"), str):
        raise DatasetError(f"image {image['id']} has no file_name", hint=_HINT)
    return read_image(folder / image["file_name"])


def _pixels(folder: Path, image: Mapping[str, Any], kind: str) -> NDArray[Any]:
    """(H, W) ticks of depth or (H, W, 3) colours of one image."""
    pixels = _read(folder, image)
    if pixels.shape[:2] != (image["height"], image["width"]):
        raise DatasetError(
            f"{image['file_name']} has {pixels.shape[1]}x{pixels.shape[0]} pixels, not {image['width']}x{image['height']}",
            hint=_HINT,
        )
    if (pixels.dtype == np.uint16) != (kind == "depth") or (kind == "depth" and pixels.ndim != 2):
        raise DatasetError(f"{image['file_name']} is no image of {kind}, as the first one is", hint="import them apart")
    if kind == "depth":
        return ticks_of_steps(pixels, LENGTHS_M["mm"])
    return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=-1)


def _padded(pixels: NDArray[Any], manifest: Manifest) -> NDArray[Any]:
    height, width = pixels.shape[:2]
    fill = ((0, manifest.height - height), (0, manifest.width - width)) + ((0, 0),) * (pixels.ndim - 2)
    return np.pad(pixels, fill)


def _mask(person: _Person, image: Mapping[str, Any], path: Path) -> tuple[NDArray[np.int64], ...]:
    """(rows, columns) of somebody's pixels."""
    if person.counts is None or person.mask_shape != (image["height"], image["width"]):
        raise DatasetError(f"{path}: a mask of image {image['id']} has the size {person.mask_shape}", hint=_HINT)
    flat = np.repeat(np.arange(len(person.counts)) % 2 == 1, person.counts)
    return tuple(flat.reshape(person.mask_shape, order="F").nonzero())
