"""Reading COCO keypoints (cocodataset.org, data format): ours, or any with people's keypoints by name.

A COCO file knows pixels, not metres: `joints_3d` is NaN, and a labelled joint has its visibility and `joints_2d` alone.
v = 0 is absent, 1 occluded, 2 visible. Keypoints are taken as pixels of ours (an integer is a pixel's centre), those of
COCO's 17 that the skeleton has; nose, eyes and ears are left out. Crowds (`iscrowd`), boxes without keypoints and people
without a labelled joint are no people here; an image without anybody is a frame with nobody.

Our own exports with images of 8 bits come back without images: steps of 16 mm of depth are too coarse for a dataset.

The file may be larger than memory: it is read element by element. What is kept of a person are keypoints and run lengths,
about 1 kB.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import ijson
import numpy as np
from numpy.typing import NDArray

from cabinpose.core import CABINPOSE, Camera, DatasetError, Visibility
from cabinpose.store.convert.reading import ImportOptions, depth_ticks_of_mm, make_manifest, put_camera, read_image
from cabinpose.store.schema import Manifest
from cabinpose.store.source import UNKNOWN, Source, blank_frame

_STATES = np.array([Visibility.ABSENT, Visibility.OCCLUDED, Visibility.VISIBLE], np.uint8)  # by COCO's v
_OURS = {name: name for name in CABINPOSE.index} | {theirs: ours for ours, theirs in CABINPOSE.maps["coco"].items()}
_MOST_INSTANCES = 254  # of a uint8 that has 0 for nobody
_CAMERA = ("camera_k", "camera_dist", "vehicle_from_camera")
_IMAGE_KEYS = ("id", "file_name", "width", "height", "car", "pov", *_CAMERA)  # what is kept of an image
_HINT = "cocodataset.org describes the format; is the file cut short, or made by something else?"


class _Person(NamedTuple):
    """One annotation. keypoints: (K, 3) u, v px and COCO's visibility · counts: run lengths of the mask, None without."""

    category: int
    keypoints: NDArray[np.float32]
    slot: str | None
    subject: str
    action: str
    mask_shape: tuple[int, int] | None
    counts: NDArray[np.int32] | None


class Keypoints(NamedTuple):
    """Somebody in an image of a COCO file.

    image: name of its file · size: (width, height) px · slot: as our exports tell it, None where the file does not ·
    joints: those labelled or told absent, by our names: u, v px and COCO's visibility.
    """

    image: str
    size: tuple[int, int]
    slot: str | None
    joints: dict[str, tuple[float, float, int]]


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


def read(path: Path, options: ImportOptions) -> Source:
    """The images of a COCO file, in its order, from the file or a folder with `annotations/`.

    Pixels are imported from `options.images`, or from an `images/` (or `images/<split>/`) beside `annotations/`: 16-bit images as
    depth in mm, others as rgb, those of 8 bits of our own export only where `options.images` names them. Smaller images than the
    largest are filled up to the right and below with 0. Raises `DatasetError` for a file that is no COCO, names no joint that
    the skeleton has, or contradicts itself.
    """
    file = _read_file(_annotations(path))
    people = [person for group in file.people.values() for person in group]
    if not file.images:
        raise DatasetError(f"{file.path} lists no image", hint=_HINT)
    persons = file.slots if file.slots and all(p.slot in file.slots for p in people) else ()
    if not persons:
        persons = tuple(f"person_{i + 1}" for i in range(max(map(len, file.people.values()), default=1)))
    size = max(i["width"] for i in file.images.values()), max(i["height"] for i in file.images.values())
    grey = options.images is None and file.images_kind.endswith("8")
    folder = None if grey else options.images or _images_beside(file.path)
    variables = [_kind(folder, next(iter(file.images.values())))] if folder is not None else []
    if people and len(persons) <= _MOST_INSTANCES and all(person.counts is not None for person in people):
        variables.append("instance")
    manifest = make_manifest(
        "coco",
        path,
        options,
        frames=len(file.images),
        size=size,
        persons=persons,
        variables=tuple(variables),
        licence=", ".join(file.licences) or UNKNOWN,
    )
    note = (
        f"the images are {file.images_kind}, too coarse for a dataset: joints and masks are imported without them "
        "(`export --images depth16` keeps the depth)"
    )
    return Source(path, manifest, lambda: _frames(file, folder, manifest, options), note if grey else "")


def read_keypoints(path: Path) -> list[Keypoints]:
    """Everybody in a COCO file, or in a folder with `annotations/`. Raises `DatasetError` as `read` does."""
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


# ------------------------------------------------------------------------------------------------------ annotations


def _read_file(path: Path) -> _File:
    file = _File(path)
    for key, element in _elements(path):
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
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            what = element.get("id") if isinstance(element, dict) else element
            raise DatasetError(f"{path}: {key.removesuffix('.item')} {what} is not COCO's ({error!r})", hint=_HINT) from error
    if not file.names:
        raise DatasetError(f"{path} has no category with keypoints", hint="give a file of keypoints, not of boxes or captions")
    _check_people(file)
    return file


def _elements(path: Path) -> Iterator[tuple[str, Any]]:
    """The elements of the lists of a COCO file, one in memory at a time, with what `ijson` calls their prefix."""
    try:
        with path.open("rb") as file:
            for key in ("info", "licenses.item", "categories.item", "images.item", "annotations.item"):
                file.seek(0)
                for element in ijson.items(file, key, use_float=True):
                    yield key, element
    except (OSError, ijson.JSONError) as error:
        raise DatasetError(
            f"{path} is no whole JSON object ({str(error).splitlines()[0].strip()})",
            hint="it may be cut short; copy it again, or give another file",
        ) from error


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
        )
    )


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


# ----------------------------------------------------------------------------------------------------------- frames


def _frames(file: _File, folder: Path | None, manifest: Manifest, options: ImportOptions) -> Iterator[dict[str, Any]]:
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
        yield frame


def _put_camera(frame: dict[str, Any], image: Mapping[str, Any], manifest: Manifest, options: ImportOptions, path: Path) -> None:
    """The user's camera, or the one that our own export wrote."""
    camera: Camera | None = options.camera(manifest.width, manifest.height)
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
        return depth_ticks_of_mm(pixels)
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
