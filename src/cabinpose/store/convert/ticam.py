"""Reading TICaM (Katrolia et al., "TICaM: a time-of-flight in-car cabin monitoring dataset", BMVC 2021, arXiv:2103.11719).

The real images, of an Azure Kinect at the mirror of a driving simulator: `{Train,Test}_images/{Depth,IR}/<group>/<sequence>/`,
16-bit PNGs `*_DEPTH.png` (mm, clipped at 2550) and `*_IR.png`; the second word between `_` is the frame's number, 30 a second.
Beside the training images is `Train_labels/`, which may hold a folder of its own name again: in `<group>/<sequence>/` of it are
`masks_depth/*_DEPTH_classes.png`, `boxes_2d_depth.csv` (frame, class, left, top, right, bottom, …, low remission) and
`activities.csv` (id, activity, person, driver or passenger, start, end, duration; divided by commas or blanks).

Nobody's joints are labelled: they stay absent. Who is who is told by boxes and activities. The camera looks back into a car whose
wheel is on the left, so the driver is in the right half of the image.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from math import radians, tan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import LENGTHS_M, Camera, DatasetError
from cabinpose.store.convert.format import DatasetFormat
from cabinpose.store.convert.reading import (
    Origin,
    SequenceOptions,
    given_camera,
    make_manifest,
    put_camera,
    read_grey,
    read_image,
    warn_of_boxes,
)
from cabinpose.store.schema import LabelRow, Manifest
from cabinpose.store.shard import ticks_of_steps
from cabinpose.store.source import UNKNOWN, Source, blank_frame

FIELD_DEG = 105.0  # of the undistorted images, across and down (Katrolia et al. 2021, section 3)
CLIPPED_MM = 2550
_BOXES_LOOKED_AT = 64
_FARTHEST_PX = 1 << 20  # that the edge of a box may lie outside of its image
_FRAME_NS = 1e9 / 30
_PLACES = ("driver", "front_passenger")
_ROLES = {"driver": 0, "passenger": 1}
# Ids, names and colours as in `scene.labels`, where the numbers of "person" and "accessory" are kept for them.
LABELS = (
    LabelRow(id=0, name="background", rgb=0x000000, ticam=0), LabelRow(id=34, name="person", rgb=0xF0C8A0, ticam=1),
    LabelRow(id=80, name="infant_seat", rgb=0xF06EAA, ticam=15), LabelRow(id=81, name="child_seat", rgb=0xA03CC8, ticam=14),
    LabelRow(id=82, name="box", rgb=0xB98C50, ticam=4), LabelRow(id=83, name="bag", rgb=0x963232, ticam=13),
    LabelRow(id=84, name="backpack", rgb=0x3264B4, ticam=2), LabelRow(id=85, name="bottle", rgb=0xD2FF3C, ticam=5),
    LabelRow(id=87, name="book", rgb=0x78B45A, ticam=9), LabelRow(id=88, name="laptop", rgb=0x64788C, ticam=10),
    LabelRow(id=89, name="phone", rgb=0xFF7828, ticam=6), LabelRow(id=90, name="blanket", rgb=0x8CD2C8, ticam=7),
    LabelRow(id=91, name="jacket", rgb=0x3C6E5A, ticam=3), LabelRow(id=92, name="accessory", rgb=0xB4D7FF, ticam=8),
)  # fmt: skip
# TICaM's classes by their number: the name in boxes, and the name of ours
CLASSES = (
    ("background", "background"), ("person", "person"), ("backpack", "backpack"), ("winter jacket", "jacket"), ("box", "box"),
    ("water bottle", "bottle"), ("mobile phone", "phone"), ("blanket", "blanket"), ("accessory", "accessory"), ("book", "book"),
    ("laptop", "laptop"), ("laptop bag", "bag"), ("infant", "person"), ("handbag", "bag"), ("ff", "child_seat"),
    ("rf", "infant_seat"), ("child", "person"),
)  # fmt: skip
_ID = {row.name: row.id for row in LABELS}
_OURS = np.array([_ID[ours] for _, ours in CLASSES], np.uint8)
_NUMBER = {theirs: number for number, (theirs, _) in enumerate(CLASSES)}
_ADULT = _NUMBER["person"]
_HINT = "the folder may be unfinished: unpack it again, or choose others with --sequences"


class _Box(NamedTuple):
    """A box of a frame: the number of its class, and its edges, px."""

    number: int
    left: int
    top: int
    right: int
    bottom: int

    @property
    def middle(self) -> float:
        return (self.left + self.right) / 2


class _Activity(NamedTuple):
    """What somebody in a place does in the frames from start to end."""

    name: str
    person: str
    place: int
    start: int
    end: int


@dataclass(frozen=True)
class _Sequence:
    """A sequence's files by the number of their frame; no infrared or masks where the source has none."""

    name: str
    depth: Mapping[int, Path]
    infrared: Mapping[int, Path]
    masks: Mapping[int, Path]
    boxes: Mapping[int, list[_Box]]
    activities: Sequence[_Activity]


class TicamFormat(DatasetFormat):
    """TICaM: depth, infrared, masks and activities in a simulator."""

    import_options = SequenceOptions

    def read(self, path: Path, options: SequenceOptions) -> Source:
        """The frames of `Train_images` or `Test_images`, or of a folder that holds one of the two.

        `labels`, `instance`, `things` and `occupancy` are there where the labels lie beside the images. Raises `DatasetError` for
        folders that lack something, frames without one of their images, and images of another size.
        """
        images, labels = _folders(path)
        names = sorted(f"{folder.parent.name}/{folder.name}" for folder in (images / "Depth").glob("*/*") if folder.is_dir())
        sequences = [_open(images, labels, name, options.every) for name in options.chosen(images, names)]
        infrared, labelled = bool(sequences and sequences[0].infrared), labels is not None
        size = (0, 0)
        if sequences:
            first = read_image(next(iter(sequences[0].depth.values())))
            size = (first.shape[1], first.shape[0])
        manifest = make_manifest(
            Origin("ticam", path, options),
            frames=sum(len(sequence.depth) for sequence in sequences),
            size=size,
            persons=_PLACES,
            variables=("depth", *("amplitude",) * infrared, *("labels", "instance") * labelled),
            labels=LABELS if labelled else (),
            config={"sequences": [sequence.name for sequence in sequences], "every": options.every},
        )
        focal = size[0] / 2 / tan(radians(FIELD_DEG / 2))
        camera = given_camera(options, size) or Camera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)

        def frames() -> Iterator[dict[str, Any]]:
            if labels is not None:
                _check_boxes(labels, sequences, size)
            for number, sequence in enumerate(sequences):
                for index in sequence.depth:
                    frame = blank_frame(manifest)
                    frame["sequence"], frame["sync_ns"] = np.int64(number), np.int64(round(index * _FRAME_NS))
                    frame["car"], frame["pov"] = "simulator", "mirror"
                    put_camera(frame, camera)
                    _put_images(frame, sequence, index, size)
                    if labelled:
                        _put_people(frame, sequence, index, manifest)
                    yield frame

        note = "" if labelled else f"{images.name} has no labels beside it: depth and infrared alone"
        return Source(path, manifest, frames, note)


TICAM = TicamFormat()


def _folders(path: Path) -> tuple[Path, Path | None]:
    """The folder of the images, and that of the labels where there is one."""
    found = [path] if (path / "Depth").is_dir() else sorted(p.parent for p in path.glob("*_images/Depth"))
    if len(found) != 1:
        several = f"{' and '.join(p.name for p in found)}, of which one makes a dataset" if found else "no images of TICaM"
        raise DatasetError(f"{path} holds {several}", hint="give Train_images or Test_images, the folder that holds Depth")
    labels = found[0].parent / found[0].name.replace("_images", "_labels")
    return found[0], labels if labels != found[0] and labels.is_dir() else None


def _open(images: Path, labels: Path | None, name: str, every: int) -> _Sequence:
    """The files of one sequence, of which every frame has all."""
    depth, infrared, masks = _numbered(images / "Depth" / name, "DEPTH"), {}, {}
    boxes: dict[int, list[_Box]] = {}
    activities: list[_Activity] = []
    if (images / "IR").is_dir():
        infrared = _same(_numbered(images / "IR" / name, "IR"), depth, images / "IR" / name)
    if labels is not None:
        folder = next((f / name for f in (labels, *sorted(labels.iterdir())) if (f / name).is_dir()), labels / name)
        masks = _same(_numbered(folder / "masks_depth", "DEPTH_classes"), depth, folder / "masks_depth")
        boxes = _boxes(folder / "boxes_2d_depth.csv")
        activities = _activities(folder / "activities.csv")
    taken = {number: depth[number] for number in sorted(depth)[::every]}
    return _Sequence(name, taken, infrared, masks, boxes, activities)


def _numbered(folder: Path, kind: str) -> dict[int, Path]:
    """The images of a kind in a folder, by the number of their frame."""
    if not folder.is_dir():
        raise DatasetError(f"{folder} does not exist", hint=_HINT)
    found: dict[int, Path] = {}
    for file in sorted(folder.glob(f"*_{kind}.png")):
        number = file.stem.split("_")[1]
        if not number.isdecimal() or int(number) in found:
            wrong = f"the number of a frame that {found[int(number)].name} has" if number.isdecimal() else "no number of a frame"
            raise DatasetError(f"{file} has {wrong}", hint="TICaM's names have it as the second word between _")
        found[int(number)] = file
    if not found:
        raise DatasetError(f"{folder} holds no *_{kind}.png", hint=_HINT)
    return found


def _same(files: dict[int, Path], depth: Mapping[int, Path], folder: Path) -> dict[int, Path]:
    lacking, more = sorted(depth.keys() - files.keys()), sorted(files.keys() - depth.keys())
    if lacking:
        raise DatasetError(f"{folder} lacks frame {lacking[0]}, which Depth has", hint=_HINT)
    if more:
        raise DatasetError(f"{folder} has frame {more[0]}, which Depth lacks", hint=_HINT)
    return files


def _rows(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Where a row is, and its fields; the first row has the names."""
    try:
        rows = list(csv.reader(path.read_text(encoding="utf-8", errors="replace").splitlines()))
    except (OSError, csv.Error) as error:
        raise DatasetError(f"cannot read {path}: {error}", hint=_HINT) from error
    for line, row in enumerate(rows[1:], 2):
        fields = row[0].split() if len(row) == 1 else [field.strip() for field in row]
        if fields:
            yield f"{path}:{line}", fields


def _boxes(path: Path) -> dict[int, list[_Box]]:
    found: dict[int, list[_Box]] = {}
    for where, fields in _rows(path):
        try:
            left, top, right, bottom = edges = [int(field) for field in fields[2:6]]
            if max(map(abs, edges)) > _FARTHEST_PX:
                raise ValueError("no edge of an image")
            box = _Box(_NUMBER[fields[1].lower()], left, top, right, bottom)
            found.setdefault(int(fields[0]), []).append(box)
        except (ValueError, KeyError, IndexError) as error:
            wrong = f"{where}: {', '.join(fields)} is no box"
            raise DatasetError(wrong, hint="frame, class, left, top, right, bottom, with TICaM's classes") from error
    return found


def _activities(path: Path) -> list[_Activity]:
    """Not every sequence has them."""
    found: list[_Activity] = []
    for where, fields in _rows(path) if path.exists() else ():
        try:
            *name, person, role, start, end, _ = fields[1:]  # divided by blanks, a name may be several words
            found.append(_Activity(" ".join(name), person, _ROLES[role.lower()], int(start), int(end)))
        except (ValueError, KeyError) as error:
            wrong = f"{where}: {', '.join(fields)} is no activity"
            raise DatasetError(wrong, hint="id, activity, person, driver or passenger, start, end, duration") from error
    return found


# ----------------------------------------------------------------------------------------------------------- frames


def _put_images(frame: dict[str, Any], sequence: _Sequence, index: int, size: tuple[int, int]) -> None:
    depth_mm = read_grey(sequence.depth[index], np.uint16, size)
    frame["depth"] = ticks_of_steps(np.where(depth_mm < CLIPPED_MM, depth_mm, 0).astype(np.uint16), LENGTHS_M["mm"])
    if sequence.infrared:
        frame["amplitude"] = read_grey(sequence.infrared[index], np.uint16, size)
    if sequence.masks:
        mask = read_grey(sequence.masks[index], np.uint8, size)
        if mask.max() >= len(CLASSES):
            wrong = f"{sequence.masks[index]} has the class {mask.max()}"
            raise DatasetError(wrong, hint=f"TICaM's are 0 to {len(CLASSES) - 1}; give the masks of classes, not of instances")
        frame["labels"] = _OURS[mask]


def _put_people(frame: dict[str, Any], sequence: _Sequence, index: int, manifest: Manifest) -> None:
    """Who is there and does what, whose pixels are whose, and what is in each place."""
    boxes = sequence.boxes.get(index, [])
    people = [box for box in boxes if CLASSES[box.number][1] == "person"]
    places = _places(people, sequence.activities, manifest.width)
    frame["instance"] = _instances(frame["labels"] == _ID["person"], people, places)
    for place in range(len(_PLACES)):
        mine = [box for box, p in zip(people, places, strict=True) if p == place]
        does = [a for a in sequence.activities if a.place == place and a.start <= index <= a.end]
        who = {a.person for a in sequence.activities if a.place == place}
        if does:
            latest = max(does, key=lambda activity: activity.start)
            frame["subject"][place], frame["action"][place] = latest.person, latest.name
        elif mine:
            frame["subject"][place], frame["action"][place] = who.pop() if len(who) == 1 else UNKNOWN, UNKNOWN
        beside = {CLASSES[b.number][1] for b in boxes if b not in people and _side(b, manifest.width) == place}
        frame["things"][place] = ",".join(sorted(beside))
        frame["occupancy"][place] = _occupancy(mine, beside)


def _occupancy(mine: Sequence[_Box], beside: set[str]) -> str:
    """The state of a place by the boxes of people in it and the classes of what else is there; "infant" as TICaM has it."""
    seat = bool(beside & {"infant_seat", "child_seat"})
    if not mine:
        return "child_seat_empty" if seat else "object" if beside else "empty"
    numbers = {box.number for box in mine}
    if _ADULT in numbers:
        return "adult"
    return "infant" if numbers == {_NUMBER["infant"]} else "child_in_child_seat" if seat else "child"


def _check_boxes(labels: Path, sequences: Sequence[_Sequence], size: tuple[int, int]) -> None:
    """Warn where boxes of people who are alone are not about their pixels."""
    with_people = (
        (sequence.masks[index], [box for box in sequence.boxes.get(index, ()) if CLASSES[box.number][1] == "person"])
        for sequence in sequences
        for index in sequence.depth
    )
    boxes: list[tuple[int, ...]] = []
    edges: list[tuple[int, ...]] = []
    for file, people in islice((each for each in with_people if len(each[1]) == 1), _BOXES_LOOKED_AT):
        v, u = np.nonzero(_OURS[read_grey(file, np.uint8, size).clip(0, len(CLASSES) - 1)] == _ID["person"])
        if len(v):
            boxes.append(people[0][1:])
            edges.append((u.min(), v.min(), u.max(), v.max()))
    warn_of_boxes(labels, "left, top, right, bottom", np.array(boxes).reshape(-1, 4), np.array(edges).reshape(-1, 4))


def _side(box: _Box, width: int) -> int:
    return 0 if 2 * box.middle > width - 1 else 1


def _places(people: list[_Box], activities: Sequence[_Activity], width: int) -> list[int]:
    """The place of each person: by the side of the image, of two adults by who is further right.

    An adult who is alone is the one that the activities are of, wherever he leans.
    """
    places = [_side(box, width) for box in people]
    adults = sorted((box.middle, i) for i, box in enumerate(people) if box.number == _ADULT)
    active = {activity.place for activity in activities}
    if len(adults) == 2:
        places[adults[0][1]], places[adults[1][1]] = 1, 0
    elif len(adults) == 1 and len(active) == 1:
        places[adults[0][1]] = next(iter(active))
    return places


def _instances(person: NDArray[np.bool_], people: list[_Box], places: list[int]) -> NDArray[np.uint8]:
    """(H, W) 1 + the place of whose box a person's pixel lies in, or nearest to; 0 elsewhere."""
    result = np.zeros(person.shape, np.uint8)
    if not people:
        return result
    edges = np.array(people, np.float64)[:, 1:]
    v, u = np.nonzero(person)
    middle, half = (edges[:, :2] + edges[:, 2:]) / 2, np.maximum((edges[:, 2:] - edges[:, :2]) / 2, 0.5)
    outside = np.abs(np.stack((u, v), axis=-1)[:, None] - middle) / half  # (pixel, box, 2): 1 = on an edge
    result[v, u] = 1 + np.array(places)[outside.max(axis=-1).argmin(axis=1)]
    return result
