"""ITOP's HDF5 layout (Haque et al. 2016, "Towards viewpoint invariant 3D human pose estimation"): one person a frame.

`depth_map.h5` has `id` and `data` (n, H, W) float16 m; `labels.h5` has `id`, `is_valid`, `visible_joints` (n, 15) int16,
`image_coordinates` (n, 15, 2) int16 px, `real_world_coordinates` (n, 15, 3) float16 m and `segmentation` (n, H, W) int8:
the index of the joint whose body part a pixel shows, -1 for the background. Its camera frame has y up, ours down. ITOP's
images are 320x240; other sizes keep theirs. `id` is subject and frame, "XX_YYYYY". ITOP's files do not say their intrinsics;
what is exported has them beside the depth, as `camera_k` (n, 3, 3) and `camera_dist` (n, 5), and `subjects.json`: who is who.

Reading has traps: depth is float16 with 0 for no answer, ids are bytes, and more than half of the frames of a test
set carry labels that `is_valid` says not to trust. Such a frame shows a person whom nobody has labelled, so that to a
detector it would be a wrong example; the literature leaves these frames out, and so does `read` unless told otherwise.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import CABINPOSE, ITOP, Camera, DatasetError, Visibility, camera_from, check_claim, interrupts_held
from cabinpose.store.convert.format import DatasetFormat, ImportOptions, NoOptions
from cabinpose.store.convert.itop_correct import corrected
from cabinpose.store.convert.reading import Origin, check_projection, given_camera, make_manifest, put_camera, put_person
from cabinpose.store.frames import camera_of, frames, label_table, people, require_variables
from cabinpose.store.itop import UNREADABLE, K, hdf5, read_itop_frames, read_itop_reference
from cabinpose.store.schema import LabelRow, Manifest
from cabinpose.store.source import UNKNOWN, Report, Source, blank_frame
from cabinpose.store.split import people_of

if TYPE_CHECKING:
    import xarray as xr

PERSON = "standing"  # the place of the person in a room, as `synth` calls it
_SIZE = (320, 240)
_BLOCK = 16  # frames read at a time
_NEEDED = ("id", "is_valid", "visible_joints", "real_world_coordinates")
_ID = re.compile(rb"(\d+)_(\d+)")
_UP_TO_DOWN = np.array([1.0, -1.0, 1.0])
_OURS, _THEIRS = CABINPOSE.counterparts("itop", ITOP.joints)  # where both mean the same point; all 15 are kept beside them
# Joint of ours whose visibility stands for one of ITOP's, and whose position does where the dataset has no
# `itop_joints_3d`: ITOP's hand is the palm and its foot the front of the foot.
_NEAREST = MappingProxyType(
    {"torso": "chest", "rhip": "rpelvis", "lhip": "lpelvis"} | {n: n for n in ITOP.joints if n in CABINPOSE.index}
)  # fmt: skip
# Beginning of a body part's name -> ITOP's joint; a trailing _left or _right chooses the side.
_PART_JOINT = MappingProxyType(
    {
        "head": "head", "hair": "head", "headwear": "head", "glasses": "head", "neck": "neck", "torso": "torso",
        "hip_center": "torso", "shoulder": "{}shoulder", "upper_arm": "{}shoulder", "elbow": "{}elbow", "forearm": "{}elbow",
        "wrist": "{}hand", "hand": "{}hand", "hip": "{}hip", "thigh": "{}hip", "knee": "{}knee", "shin": "{}knee",
        "ankle": "{}foot", "foot": "{}foot",
    }
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ItopImport(ImportOptions):
    """How ITOP's files are read."""

    keep_invalid: bool = False
    """Keep the frames whose labels are marked as not valid, without their joints."""
    correct: Literal["head", "torso"] | None = None
    """Move joints that lie beside the person onto it; the person grows over the depth from this joint."""
    pictures: Path | None = None
    """Folder for a PNG of every frame in which --correct moves a joint, before and after."""


class ItopFormat(DatasetFormat):
    """ITOP's HDF5 files of one person a frame, and frames of it as .npz, which are read alone."""

    import_options = ItopImport

    def read(self, path: Path, options: ItopImport) -> Source:
        """The frames of a set (either of its files), of all sets in a folder, one `sequence` a set, or of a .npz file.

        Raises `DatasetError` for files that are damaged, lack a dataset, contradict each other, or have another geometry, and
        for a folder of pictures that is not empty.
        """
        correction = _Correction(options)
        if path.suffix == ".npz":
            return _of_npz(path, options, correction)
        pairs = [_open(depth, labels, options) for depth, labels in _pairs(path)]
        if len({pair.size for pair in pairs}) > 1:
            raise DatasetError(f"the sets of {path} have images of different sizes", hint="import them one by one")
        segmented = all(pair.segmented for pair in pairs)
        images = ("depth", "labels", "instance") if segmented else ("depth",)
        manifest = make_manifest(
            Origin("itop", path, options),
            frames=sum(len(pair.frames) for pair in pairs),
            size=pairs[0].size,
            persons=(PERSON,),
            variables=(*images, "itop_joints_3d"),
            labels=label_rows() if segmented else (),
            config={"keep_invalid": options.keep_invalid} | correction.config,
        )

        def all_frames() -> Iterator[dict[str, Any]]:
            correction.moved.clear()
            for sequence, pair in enumerate(pairs):
                yield from _frames(pair, sequence, manifest, options, correction)

        return Source(path, manifest, all_frames, outcome=correction.told)

    def write(self, parts: Mapping[str, xr.Dataset], folder: Path, _: NoOptions, report: Report) -> None:
        """Write every frame into `folder`; `DatasetError` where a frame shows more than one person.

        The dataset has to have depth, classes and instances.
        """
        (dataset,) = parts.values()
        require_variables(dataset, "ITOP's layout", ("depth", "labels", "instance"))
        count, (height, width) = dataset.sizes["frame"], dataset["depth"].shape[1:]
        segmentation_of = segmentation_table(dataset)
        numbers = _numbers(dataset)
        (folder / "subjects.json").write_text(json.dumps({n: s for s, n in numbers.items()}, indent=1), "utf-8")
        h5py = hdf5()
        with (
            interrupts_held() as due,  # one that goes through HDF5 as it writes ends the process
            _Written(folder / "depth_map.h5") as depth_bytes,
            _Written(folder / "labels.h5") as label_bytes,
            h5py.File(depth_bytes, "w") as depth_file,
            h5py.File(label_bytes, "w") as label_file,
        ):
            # Equal datasets give equal bytes: no times in the files, and not LZF, whose output depends on stale memory.
            image = {"shape": (count, height, width), "chunks": (1, height, width), "track_times": False}
            image |= {"compression": "gzip", "compression_opts": 1, "shuffle": True}
            data = depth_file.create_dataset("data", dtype="f2", **image)
            segmentation = label_file.create_dataset("segmentation", dtype="i1", **image)
            ids = np.zeros(count, f"S{max(8, len(f'{len(numbers):02d}_{count:05d}'))}")
            valid = np.zeros(count, np.uint8)
            visible = np.zeros((count, 15), np.int16)
            uv = np.zeros((count, 15, 2), np.int16)
            xyz = np.zeros((count, 15, 3), np.float16)
            for i, frame in enumerate(frames(dataset, ("depth", "labels", "instance"))):
                persons = people(frame)
                if len(persons) > 1:
                    raise DatasetError(
                        f"frame {int(frame['frame'])} shows {len(persons)} people, ITOP's layout holds one",
                        hint="select frames with one person (for example with a scene of kind room), or export as coco",
                    )
                data[i] = np.nan_to_num(frame["depth"].values).astype(np.float16)
                ids[i] = f"{0:02d}_{i:05d}".encode()
                segmentation[i] = -1
                if persons:
                    person = persons[0]
                    ids[i] = f"{numbers[person.subject]}_{i:05d}".encode()
                    joints = itop_joints(frame, person.position)
                    valid[i] = np.isfinite(joints).all()
                    visible[i] = (
                        person.visibility[[CABINPOSE.index[_NEAREST[name]] for name in ITOP.joints]] == Visibility.VISIBLE
                    )
                    uv[i] = np.rint(np.nan_to_num(camera_of(frame, width, height).project(joints))).astype(np.int16)
                    xyz[i] = np.nan_to_num(joints * (1, -1, 1))
                    mine = frame["instance"].values == person.position + 1
                    segmentation[i] = np.where(mine, segmentation_of[frame["labels"].values], -1)
                depth_bytes.check()
                label_bytes.check()
                due()
                report(i + 1)
            small = {
                "id": ids, "is_valid": valid, "visible_joints": visible, "image_coordinates": uv, "real_world_coordinates": xyz,
            }  # fmt: skip
            intrinsics = {name: dataset[name].values for name in ("camera_k", "camera_dist")}
            for name, values in ({"id": ids} | intrinsics).items():
                depth_file.create_dataset(name, data=values, track_times=False)
            for name, values in small.items():
                label_file.create_dataset(name, data=values, track_times=False)


ITOP_FORMAT = ItopFormat()


# ------------------------------------------------------------------------------------------------------------ writing


def _numbers(dataset: xr.Dataset) -> dict[str, str]:
    """The number of everybody in the dataset's folder, by name, so that parts that are exported one by one tell people apart."""
    from cabinpose.store.lazy import open_dataset  # noqa: PLC0415 - xarray, for those who write

    folder = dataset.encoding.get("source")
    names = people_of(dataset) | (set() if folder is None else people_of(open_dataset(folder, missing="ignore")))
    return {name: f"{number:02d}" for number, name in enumerate(sorted(names))}


def itop_joints(frame: xr.Dataset, position: int) -> NDArray[np.float64]:
    """(15, 3) ITOP's joints in our camera frame: as the dataset has them, or the nearest of ours.

    Without `itop_joints_3d`, the torso is put midway between chest and hip; head stays at the skull base.
    """
    if "itop_joints_3d" in frame:
        return np.asarray(frame["itop_joints_3d"].values[position], np.float64)
    ours = np.asarray(frame["joints_3d"].values[position], np.float64)
    joints = ours[[CABINPOSE.index[_NEAREST[name]] for name in ITOP.joints]]
    joints[ITOP.joints.index("torso")] = (ours[CABINPOSE.index["chest"]] + ours[CABINPOSE.index["hip"]]) / 2
    return joints


def segmentation_table(dataset: xr.Dataset) -> NDArray[np.int8]:
    """(256,) ITOP's joint index by our class id, -1 for everything that is no part of a person."""
    table = np.full(256, -1, np.int8)
    for row in label_table(dataset):
        stem, _, side = row["name"].rpartition("_")
        joint = _PART_JOINT.get(row["name"]) or (_PART_JOINT.get(stem) if side in ("left", "right") else None)
        if joint is not None:
            table[row["id"]] = ITOP.joints.index(joint.format(side[:1]))
    return table


# ------------------------------------------------------------------------------------------------------------ reading


@dataclass(frozen=True)
class _Pair:
    """One set: its two files, the frames to import, and whether it has what is optional."""

    depth: Path
    labels: Path
    frames: NDArray[np.int64]
    size: tuple[int, int]
    segmented: bool
    pov: str


class _Correction:
    """What an import does to labels, as its options say. moved: (15,) m of each frame, NaN where no person was found."""

    def __init__(self, options: ItopImport) -> None:
        if options.pictures is not None and options.correct is None:
            raise DatasetError("--pictures shows what --correct does", hint="give --correct head, or leave out --pictures")
        self._seed = options.correct
        self._draw = None
        if options.pictures is not None:
            from cabinpose.store.convert.itop_pictures import CorrectionPictures  # noqa: PLC0415 - pictures are seldom asked for

            self._draw = CorrectionPictures(options.pictures)
        self.moved: list[NDArray[np.float64]] = []

    @property
    def config(self) -> dict[str, str]:
        """What the manifest says of it."""
        return {} if self._seed is None else {"correct": self._seed}

    def joints(self, name: str, depth: NDArray[Any], world: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
        """The joints (15, 3) of a frame, m in our camera frame, corrected where that is asked for; name: of its picture."""
        if self._seed is None:
            return world
        after = corrected(depth, world, camera, self._seed)
        self.moved.append(after.moved_m if after.mask is not None else np.full(len(ITOP.joints), np.nan))
        if self._draw is not None:
            self._draw(name, depth, world, after, camera)
        return after.joints_3d

    def told(self) -> str:
        """How many labels were moved, and how far, in words; empty where none was to be."""
        if self._seed is None:
            return ""
        apart = np.array(self.moved).reshape(-1, len(ITOP.joints))
        far = 100 * apart[apart > 0]
        lost = int(np.isnan(apart).any(axis=1).sum())
        text = f"{len(far)} of {apart.size} joints were moved"
        if len(far):
            text += f", by {np.median(far):.1f} cm in the median and {far.max():.1f} cm at most"
        return text + (f"; frames that show nobody where their labels are, and keep them: {lost}" if lost else "")


def _of_npz(path: Path, options: ItopImport, correction: _Correction) -> Source:
    """The frames of a .npz, see `read_itop_frames`; whose they are and which joints are hidden it does not say."""
    batch, reference = read_itop_frames(path), read_itop_reference(path)
    count, height, width = batch["depth"].shape
    if len(reference.joints_3d) != count:
        raise DatasetError(f"{path} has {count} frames and joints of {len(reference.joints_3d)}", hint="is it whole?")
    camera = given_camera(options, (width, height))
    if camera is None:
        camera = camera_from(batch["camera_k"], np.zeros(5), width, height, whose=f"{path}: camera_k", error=DatasetError)
    pov = _pov(path)
    manifest = make_manifest(
        Origin("itop", path, options), frames=count, size=(width, height), persons=(PERSON,),
        variables=("depth", "itop_joints_3d"), config=correction.config,
    )  # fmt: skip

    def all_frames() -> Iterator[dict[str, Any]]:
        correction.moved.clear()
        for index, (depth, world) in enumerate(zip(batch["depth"], reference.joints_3d, strict=True)):
            frame = blank_frame(manifest)
            frame["pov"], frame["car"], frame["depth"] = pov, "room", depth
            frame["subject"], frame["action"] = [UNKNOWN], [UNKNOWN]
            put_camera(frame, camera)
            placed = correction.joints(f"{index:08d}", depth, world, camera)
            frame["itop_joints_3d"][0] = placed
            put_person(frame, 0, camera, _OURS, placed[_THEIRS], np.full(len(_THEIRS), Visibility.VISIBLE))
            yield frame

    note = "the file does not say which joints are hidden: all count as visible; who is shown is not known"
    return Source(path, manifest, all_frames, note=note, outcome=correction.told)


def _pov(path: Path) -> str:
    """The view that a file's name speaks of."""
    return next((view for view in ("side", "top") if view in path.name.lower()), UNKNOWN)


def label_rows() -> tuple[LabelRow, ...]:
    """The classes of ITOP's segmentation: background, then the parts in the order of its joints."""
    rows = [LabelRow(id=0, name="background", rgb=0x000000)]
    for i, joint in enumerate(ITOP.joints, 1):
        side = {"r": "_right", "l": "_left"}.get(joint[0], "")
        rgb = (90 * i % 256) << 16 | (150 * i % 256) << 8 | (60 + 40 * i) % 256  # told apart at a glance
        rows.append(LabelRow(id=i, name=joint[1:] + side if side else joint, rgb=rgb))
    return tuple(rows)


def _pairs(path: Path) -> list[tuple[Path, Path]]:
    """(depth, labels) files of a file's set, or of the sets in a folder, by name."""
    if path.is_dir():
        found = sorted(path.glob("*labels.h5")) + sorted(path.glob("*depth_map.h5"))
        stems = sorted({_stem(file) for file in found})
        if not stems:
            packed = ": unpack its .h5.gz first" if any(path.glob("*.h5.gz")) else ""
            raise DatasetError(f"{path} holds no set of ITOP{packed}", hint="give the folder of *_depth_map.h5 and *_labels.h5")
        folder = path
    else:
        stems, folder = [_stem(path)], path.parent
    pairs = [(folder / f"{stem}depth_map.h5", folder / f"{stem}labels.h5") for stem in stems]
    for file in (file for pair in pairs for file in pair):
        if not file.is_file():
            raise DatasetError(f"{file} does not exist", hint="a set of ITOP is a depth_map.h5 and a labels.h5 side by side")
    return pairs


def _stem(file: Path) -> str:
    for end in ("depth_map.h5", "labels.h5"):
        if file.name.endswith(end):
            return file.name.removesuffix(end)
    raise DatasetError(
        f"{file} is no file of ITOP", hint="give a *_depth_map.h5 or *_labels.h5 (not the point clouds), their folder, or a .npz"
    )


class _Written(FileIO):
    """A file for HDF5 to write: what the disk refuses is kept until it is asked for, since HDF5 ends the process over it."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self._refused: OSError | None = None

    def write(self, content: Any, /) -> int:
        """Write all, or nothing more once the disk has refused."""
        left = memoryview(content).cast("B")
        try:
            while left and self._refused is None:
                left = left[super().write(left) :]
        except OSError as error:
            self._refused = error
        return memoryview(content).nbytes

    def check(self) -> None:
        """Raise what the disk has refused."""
        if self._refused is not None:
            raise self._refused

    def close(self) -> None:
        """Close the file; raise what the disk has refused."""
        super().close()
        self.check()


@contextmanager
def _h5(path: Path) -> Iterator[Any]:
    """An HDF5 file whose damage is a `DatasetError`."""
    try:
        with hdf5().File(path) as file:
            yield file
    except UNREADABLE as error:
        raise DatasetError(f"{path} is damaged: {error}", hint="it may be cut short; copy or unpack it again") from error


def _open(depth_path: Path, labels_path: Path, options: ItopImport) -> _Pair:
    """Check one set, and choose its frames."""
    with _h5(depth_path) as depth, _h5(labels_path) as labels:
        for file, path, names in ((labels, labels_path, _NEEDED), (depth, depth_path, ("data",))):
            missing = [name for name in names if name not in file]
            if missing:
                there = ", ".join(file) or "nothing"
                raise DatasetError(
                    f"{path} lacks the dataset {', '.join(missing)}", hint=f"it has {there}; is it a file of ITOP?"
                )
        check_claim(labels_path, sum(labels[name].nbytes for name in _NEEDED))
        data, count = depth["data"], len(labels["id"])
        check_claim(depth_path, max(data.nbytes // max(len(data), 1), math.prod(data.chunks or (0,)) * data.dtype.itemsize))
        if data.ndim != 3 or len(data) != count:
            raise DatasetError(
                f"{depth_path} has depth of the shape {data.shape}, {labels_path.name} labels of {count} frames",
                hint="give the two files of one set",
            )
        shapes = {"visible_joints": (count, 15), "real_world_coordinates": (count, 15, 3), "is_valid": (count,)}
        optional = {"segmentation": data.shape, "image_coordinates": (count, 15, 2)}
        for name, shape in (shapes | optional).items():
            if name in labels and labels[name].shape != shape:
                raise DatasetError(f"{labels_path}: {name} has the shape {labels[name].shape}, not {shape}", hint="is it ITOP's?")
        if "id" in depth and not np.array_equal(depth["id"][...], labels["id"][...]):
            raise DatasetError(
                f"{depth_path.name} and {labels_path.name} have different ids", hint="give the two files of one set"
            )
        size = (data.shape[2], data.shape[1])
        valid = labels["is_valid"][...].astype(bool)
        if given_camera(options, size) is None and "camera_k" not in depth and size != _SIZE:
            raise DatasetError(
                f"{depth_path}: the intrinsics of images of {size[0]}x{size[1]} are not known",
                hint="give them with --intrinsics or --camera",
            )
        if "image_coordinates" in labels:
            _check_axes(depth, labels, labels_path, np.flatnonzero(valid), size, options)
        frames = np.arange(count) if options.keep_invalid else np.flatnonzero(valid)
        return _Pair(depth_path, labels_path, frames.astype(np.int64), size, "segmentation" in labels, _pov(labels_path))


def _check_axes(
    depth: Any, labels: Any, path: Path, valid: NDArray[np.int64], size: tuple[int, int], options: ItopImport
) -> None:
    """Both kinds of labels have to tell the same: a file with y down, or in mm, does not."""
    some = valid[:: max(1, len(valid) // 100)]
    if not len(some):
        return
    world = labels["real_world_coordinates"][some, ...].astype(np.float64) * _UP_TO_DOWN
    given = labels["image_coordinates"][some, ...].astype(np.float64)
    projected = np.stack(
        [_camera(depth, i, size, options).project(joints) for i, joints in zip(some.tolist(), world, strict=True)]
    )
    hint = "ITOP's are in metres with y up, x = (u - 160) z 0.0035; for another camera give --intrinsics"
    check_projection(path, ("image_coordinates", "real_world_coordinates"), projected, given, hint=hint)


def _camera(depth: Any, index: int, size: tuple[int, int], options: ItopImport) -> Camera:
    """The user's camera, or the one in the file, or ITOP's."""
    given = given_camera(options, size)
    if given is not None:
        return given
    k = depth["camera_k"][index] if "camera_k" in depth else K
    dist = depth["camera_dist"][index] if "camera_dist" in depth else np.zeros(5)
    return camera_from(k, dist, *size, whose=f"frame {index}: camera_k", error=DatasetError)


def _frames(
    pair: _Pair, sequence: int, manifest: Manifest, options: ItopImport, correction: _Correction
) -> Iterator[dict[str, Any]]:
    """The frames of a set."""
    with _h5(pair.depth) as depth, _h5(pair.labels) as labels:
        small = {name: labels[name][...] for name in _NEEDED}
        for start in range(0, len(small["id"]), _BLOCK):
            mine = pair.frames[(pair.frames >= start) & (pair.frames < start + _BLOCK)]
            if not len(mine):
                continue
            images = depth["data"][start : start + _BLOCK]
            parts = labels["segmentation"][start : start + _BLOCK] if "labels" in manifest.variables else None
            for index in mine.tolist():
                frame = blank_frame(manifest)
                frame["sequence"], frame["pov"], frame["car"] = np.int64(sequence), pair.pov, "room"
                frame["depth"] = images[index - start].astype(np.float32)
                if parts is not None:
                    frame["labels"], frame["instance"] = _classes(parts[index - start], index, pair.labels)
                camera = _camera(depth, index, pair.size, options)
                put_camera(frame, camera)
                own = {name: values[index] for name, values in small.items()}
                world = own["real_world_coordinates"].astype(np.float64) * _UP_TO_DOWN
                if own["is_valid"]:
                    world = correction.joints(f"{sequence}-{index:08d}", frame["depth"], world, camera)
                _put_labels(frame, own, world, camera, pair.labels)
                yield frame


def _put_labels(frame: dict[str, Any], labels: dict[str, Any], world: NDArray[np.float64], camera: Camera, path: Path) -> None:
    """Fill in a frame's labels; world: (15, 3) m in our camera frame."""
    match = _ID.fullmatch(labels["id"] if isinstance(labels["id"], bytes) else str(labels["id"]).encode())
    if match is None:
        raise DatasetError(f"{path}: the id {labels['id']!r} is none of ITOP's", hint="ids are subject and frame, as 05_00123")
    frame["subject"], frame["action"] = [match[1].decode()], [UNKNOWN]
    if not labels["is_valid"]:
        return
    # Nothing but the person stands in front of an ITOP camera: what is hidden is hidden by the body itself.
    states = np.where(labels["visible_joints"] > 0, Visibility.VISIBLE, Visibility.SELF_OCCLUDED)
    frame["itop_joints_3d"][0] = world
    put_person(frame, 0, camera, _OURS, world[_THEIRS], states[_THEIRS])


def _classes(segmentation: NDArray[np.integer], index: int, path: Path) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Class ids and instances (H, W) of a segmentation of joints' indices, -1 for the background."""
    if segmentation.min() < -1 or segmentation.max() >= len(ITOP.joints):
        raise DatasetError(
            f"{path}: frame {index} has the segments {segmentation.min()} to {segmentation.max()}", hint="ITOP's are -1 to 14"
        )
    return (segmentation + 1).astype(np.uint8), (segmentation >= 0).astype(np.uint8)
