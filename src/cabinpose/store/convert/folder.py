"""Somebody's folder of frames, which a layout file describes (`layout`): depth, amplitude, classes, joints, cameras.

Nothing is guessed: what the layout does not say is not known. Frames are those of the depth images; everything else is found by
the fields of its files' names, and what is missing is an error that names it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import CABINPOSE, ITOP, Camera, ConfigError, DatasetError, Visibility, check_camera, unknown_name
from cabinpose.store.convert.camera_file import read_camera
from cabinpose.store.convert.depth_images import as_amplitude, has_depth, natural_order, step_m
from cabinpose.store.convert.format import DatasetFormat, ImportOptions
from cabinpose.store.convert.layout import (
    HINT,
    CameraKeys,
    ClassFiles,
    DepthFiles,
    FolderLayout,
    ImageFiles,
    InstanceFiles,
    JointFiles,
    MatrixFiles,
)
from cabinpose.store.convert.layout_files import Finder, Key, find, matrix, pixels, stacked, told
from cabinpose.store.convert.layout_joints import JointReader, LaidPerson, in_camera
from cabinpose.store.convert.reading import Origin, given_camera, lift_visible, make_manifest, put_camera, put_person
from cabinpose.store.schema import Manifest
from cabinpose.store.shard import ticks_of_steps
from cabinpose.store.source import UNKNOWN, Source, blank_frame
from cabinpose.store.variables import joints_variable

_ORTHOGONAL = 1e-3  # by which the rotation of a camera's place may be off


@dataclass(frozen=True, kw_only=True)
class FolderOptions(ImportOptions):
    """How a folder of frames is read."""

    layout: Path | None = None
    """The layout file (YAML), which says what the folder's files hold."""


class FolderFormat(DatasetFormat):
    """Somebody's folder of frames, which a layout file describes."""

    import_options = FolderOptions

    def read(self, path: Path, options: FolderOptions) -> Source:
        """The frames of a folder, in the order of their names.

        Raises `ConfigError` for a layout that cannot be, `DatasetError` for files that are missing, damaged or not as it says.
        """
        if not path.is_dir():
            raise DatasetError(f"{path} is no folder", hint="give the folder that the layout's patterns are relative to")
        if options.layout is None:
            raise DatasetError(f"{path}: nothing says what its files hold", hint=f"give --layout FILE; {HINT}")
        layout = FolderLayout.read(options.layout)
        folder = _LaidFolder(path, layout, options)
        manifest = folder.manifest
        if layout.camera is None and not layout.cameras and given_camera(options, folder.size) is None:
            raise ConfigError(
                f"{options.layout}: it names no camera",
                hint="give camera in it, or --camera, --intrinsics or --fov-deg",
            )
        frames = folder.keys
        note = f"{len(frames)} frames in {len(folder.sequences)} sequences"
        return Source(path, manifest, folder.frames, note, folder.outcome)


FOLDER = FolderFormat()


class _LaidFolder:
    """A folder with its layout, as it is read."""

    def __init__(self, root: Path, layout: FolderLayout, options: FolderOptions) -> None:
        self._root, self._layout, self._options = root, layout, options
        self._files: dict[str, Finder] = {}
        for name in ("amplitude", "labels", "instance"):
            if (files := getattr(layout, name)) is not None:
                self._files[name] = Finder(root, files, name)
        self._joints = JointReader(root, layout, layout.joints) if layout.joints is not None else None
        self._cameras = {
            pov: _Camera(root, keys, "camera" if not pov else f"cameras.{pov}")
            for pov, keys in (layout.cameras or ({"": layout.camera} if layout.camera else {})).items()
        }

    @cached_property
    def keys(self) -> list[tuple[Key, Path]]:
        """The frames, in order: their fields and the file of their depth."""
        found: list[tuple[Key, Path]] = []
        for key, path in find(self._root, self._layout.depth, "depth"):
            several = stacked(self._layout.depth, path)
            numbers = [key.get("frame", self._layout.depth.first_frame)] if several is None else several
            found += [(dict(self._layout.fields) | dict(key) | {"frame": int(number)}, path) for number in numbers]
        apart: dict[tuple[Any, ...], Path] = {}
        for key, path in found:
            if (other := apart.setdefault(tuple(key.values()), path)) is not path:
                raise DatasetError(
                    f"{other} and {path} are both of {told(key)}", hint="tell them apart by a field in depth.files"
                )
        return sorted(found, key=lambda each: (*map(natural_order, self._sequence(each[0])), each[0]["frame"]))

    @cached_property
    def sequences(self) -> dict[tuple[str, ...], int]:
        """Numbers of the sequences, by the fields that tell them apart: those of `sequence` where it alone does, else from 0."""
        apart = list(dict.fromkeys(self._sequence(key) for key, _ in self.keys))
        own = [str(key["sequence"]) for key, _ in self.keys if "sequence" in key]
        if own and all(each.isdecimal() for each in own) and len({int(each) for each in own}) == len(apart):
            return {self._sequence(key): int(str(key["sequence"])) for key, _ in self.keys}
        return {each: number for number, each in enumerate(apart)}

    def _sequence(self, key: Key) -> tuple[str, ...]:
        return tuple(str(value) for name, value in key.items() if name != "frame")

    @cached_property
    def size(self) -> tuple[int, int]:
        """(width, height) of the images."""
        key, path = self.keys[0]
        first = pixels(self._layout.depth, path, int(key["frame"]))
        return first.shape[1], first.shape[0]

    @cached_property
    def manifest(self) -> Manifest:
        layout = self._layout
        joints = layout.joints
        other = joints_variable(ITOP.name) if joints is not None and joints.skeleton is ITOP else ""
        labels = layout.labels.classes if layout.labels is not None else ()
        rows = {row.id: {k: v for k, v in row.model_dump().items() if k != "value"} for row in labels}
        return make_manifest(
            Origin("folder", self._root, self._options), frames=len(self.keys), size=self.size, persons=layout.places,
            variables=("depth", *self._files, *((other,) if other else ())), licence=layout.licence, labels=tuple(rows.values()),
            joint_definition="" if joints is None or other else joints.definition,
            config={
                "layout": layout.model_dump(mode="json", exclude_defaults=True),
                "sequences": {"/".join(name): number for name, number in self.sequences.items()},
            },
        )  # fmt: skip

    def frames(self) -> Iterator[dict[str, Any]]:
        """The frames, one in memory at a time."""
        for key, path in self.keys:
            frame = blank_frame(self.manifest)
            frame["sequence"] = np.int64(self.sequences[self._sequence(key)])
            if self._layout.rate_hz is not None:
                frame["sync_ns"] = np.int64(round(int(key["frame"]) * 1e9 / self._layout.rate_hz))
            frame["car"], frame["pov"] = (self._called(name, key.get(name, UNKNOWN)) for name in ("car", "pov"))
            camera, place = self._camera(key)
            put_camera(frame, camera)
            self._put_images(frame, key, path, camera)
            if place is not None and place.kept:
                frame["vehicle_from_camera"] = place.world_from_camera
            self._put_people(frame, key, camera, place)
            if key is self.keys[-1][0] and self._joints is not None and len(self._joints.never_known) == len(self._joints.joints):
                raise DatasetError(
                    f"{self._root}: no frame has anybody's joints",
                    hint="look at joints.names, joints.match and joints.first_frame",
                )
            yield frame

    def outcome(self) -> str:
        """What is to be said of the frames that were read."""
        spec, joints = self._layout.joints, self._joints
        if spec is None or joints is None:
            return ""
        notes: list[str] = []
        if joints.unmatched:
            notes.append(f"{joints.unmatched} of {len(self.keys)} frames have nobody's joints: they are taken for empty")
        if spec.names and joints.never_known:
            notes.append(f"joints.names: nobody has a {' or '.join(joints.never_known)}")
        return "; ".join(notes)

    def _called(self, name: str, value: str | int) -> str:
        names = self._layout.call.get(name, {})  # type: ignore[call-overload]  # its keys are names of fields
        return str(names.get(str(value), value))

    def _camera(self, key: Key) -> tuple[Camera, _CameraPlace | None]:
        """The camera of a frame, and where it is in the world of the joints, if the layout says that."""
        given = given_camera(self._options, self.size)
        keys = self._cameras.get("") or self._cameras.get(str(key.get("pov")))
        if keys is None:
            if given is None:
                raise DatasetError(
                    f"the layout has no camera of the pov {key.get('pov')!r}", hint=f"cameras has: {', '.join(self._cameras)}"
                )
            return given, None
        return given or keys.intrinsics(key, self.size), keys.place(key)

    def _put_images(self, frame: dict[str, Any], key: Key, path: Path, camera: Camera) -> None:
        layout, number = self._layout, int(key["frame"])
        frame["depth"] = _depth(layout.depth, self._sized(layout.depth, path, number), camera)
        for name, finder in self._files.items():
            files: ImageFiles = getattr(layout, name)
            image = self._sized(files, file := finder.one(key), number)
            if isinstance(files, ClassFiles):
                frame[name] = _mapped(image, {row.value: row.id for row in files.classes}, file, "labels.classes")
            elif isinstance(files, InstanceFiles):
                places = {value: 1 + layout.places.index(place) for value, place in files.people.items()}
                frame[name] = _mapped(
                    image, {0: 0} | (places or {1 + n: 1 + n for n in range(len(layout.places))}), file, "instance.people"
                )
            else:
                frame[name] = as_amplitude(image * layout.amplitude.scale if layout.amplitude is not None else image)

    def _sized(self, files: ImageFiles, path: Path, number: int) -> NDArray[Any]:
        image = pixels(files, path, number)
        if image.shape != self.size[::-1]:
            wrong = f"{path} has {image.shape[1]}x{image.shape[0]} pixels, not {self.size[0]}x{self.size[1]}"
            raise DatasetError(wrong, hint="all images of a source have one size; `dims` says which dimension of an array is y")
        return image

    def _put_people(self, frame: dict[str, Any], key: Key, camera: Camera, place: _CameraPlace | None) -> None:
        layout, spec = self._layout, self._layout.joints
        if self._joints is None or spec is None:
            nobody = np.empty((0, 3))
            people = [LaidPerson("", "", "", nobody)] if {"subject", "action"} & key.keys() else []
        else:
            people = self._joints.people(key)
        taken: set[int] = set()
        for number, person in enumerate(people):
            at = self._place(person, key, number)
            if at in taken:
                raise DatasetError(
                    f"two people are in the place {layout.places[at]} of {told(key)}", hint="look at joints.values.place"
                )
            taken.add(at)
            for name in ("subject", "action"):
                frame[name][at] = self._called(name, getattr(person, name) or key.get(name, UNKNOWN))
            if self._joints is not None and spec is not None:
                self._put_joints(frame, at, person, spec, (camera, place))
        if spec is not None and spec.lift:
            lift_visible(frame, self.manifest)

    def _place(self, person: LaidPerson, key: Key, number: int) -> int:
        """Somebody's row on the person axis: by the place's name, else by the order of people."""
        places = self._layout.places
        name = person.place or str(key.get("place", ""))
        name = self._called("place", name) if name else ""
        if name in places:
            return places.index(name)
        if name and not name.isdecimal():
            error = unknown_name("place", name, places)
            raise DatasetError(
                f"{told(key)}: {error}", hint=f"name it in `places`, or change it by `call: {{place: ...}}`; {error.hint}"
            )
        at = int(name) if name and not key.get("place") else number
        if at >= len(places):
            raise DatasetError(
                f"{told(key)} has {at + 1} people, and the layout {len(places)} places", hint="name all of `places`"
            )
        return at

    def _put_joints(
        self, frame: dict[str, Any], at: int, person: LaidPerson, spec: JointFiles, seen: tuple[Camera, _CameraPlace | None]
    ) -> None:
        assert self._joints is not None
        camera, place = seen
        xyz = in_camera(spec, person.xyz, camera, place.camera_from_world if place is not None else None)
        joints, states = self._joints.joints, person.states
        if spec.skeleton is ITOP:
            known = np.where((states > Visibility.ABSENT)[:, None], xyz, np.nan)
            frame[joints_variable(ITOP.name)][at, joints] = known
            ours, theirs = CABINPOSE.counterparts(ITOP.name, [ITOP.joints[i] for i in joints])
            joints, xyz, states = ours, xyz[theirs], states[theirs]
            person.xyz = person.xyz[theirs]
        put_person(frame, at, camera, joints, xyz, states)
        if spec.space == "image":
            flat = (states > Visibility.ABSENT) & ~np.isfinite(xyz).all(axis=1)
            uv = person.xyz[flat, :2] - spec.first_pixel
            frame["joints_2d"][at, joints[flat]] = uv
            frame["visibility"][at, joints[flat]] = np.where(camera.contains(uv), states[flat], Visibility.OUTSIDE_IMAGE)


def _depth(files: DepthFiles, image: NDArray[Any], camera: Camera) -> NDArray[np.uint16]:
    """(H, W) ticks of depth along the optical axis."""
    valid = has_depth(image) & ~np.isin(image, files.invalid)
    steps = np.where(valid, image, 0)
    if files.along == "ray":
        steps = steps / camera.range_over_depth
    return ticks_of_steps(steps, step_m(str(files.unit)))


def _mapped(image: NDArray[Any], table: dict[int, int], path: Path, key: str) -> NDArray[np.uint8]:
    """(H, W) what values of pixels become."""
    there, inverse = np.unique(image, return_inverse=True)
    if unknown := [value for value in there.tolist() if value not in table]:
        raise DatasetError(
            f"{path} has pixels of {unknown[0]:g}", hint=f"{key} of the layout says what values are; it lacks this one"
        )
    return np.array([table[value] for value in there.tolist()], np.uint8)[inverse].reshape(image.shape)


@dataclass(frozen=True)
class _CameraPlace:
    """Where a camera is. kept: the world is the vehicle's frame."""

    world_from_camera: NDArray[np.floating]
    camera_from_world: NDArray[np.floating]
    kept: bool


class _Camera:
    """A camera of a layout."""

    def __init__(self, root: Path, keys: CameraKeys, what: str) -> None:
        self._keys, self._what, self._root = keys, what, root
        self._file = Finder(root, MatrixFiles(files=keys.file), f"{what}.file") if keys.file else None
        given = keys.world_from_camera if keys.world_from_camera is not None else keys.camera_from_world
        self._poses = Finder(root, given, f"{what}.pose") if isinstance(given, MatrixFiles) else None

    def intrinsics(self, key: Key, size: tuple[int, int]) -> Camera:
        if self._file is not None:
            return read_camera(self._file.one(key), size)
        keys = self._keys
        fx, fy, cx, cy = (value or 0.0 for value in (keys.fx, keys.fy, keys.cx, keys.cy))
        return check_camera(Camera(*size, fx, fy, cx, cy, keys.dist), self._what)

    def place(self, key: Key) -> _CameraPlace | None:
        """Where the camera is in the world; None where the layout does not say."""
        keys = self._keys
        given = keys.world_from_camera if keys.world_from_camera is not None else keys.camera_from_world
        if given is None:
            return None
        rows = (
            matrix(self._poses.one(key), given.variable)
            if isinstance(given, MatrixFiles) and self._poses
            else np.array(given, np.float64)
        )
        whole = np.eye(4)
        whole[: len(rows)] = rows
        whole[:3, 3] *= step_m(str(keys.unit))
        if not np.allclose(whole[:3, :3] @ whole[:3, :3].T, np.eye(3), atol=_ORTHOGONAL) or np.linalg.det(whole[:3, :3]) < 0:
            raise ConfigError(
                f"{self._what}: the matrix turns by no rotation", hint="its first three columns are those of a right-handed frame"
            )
        other, kept = np.linalg.inv(whole), keys.world == "vehicle"
        return _CameraPlace(other, whole, kept) if keys.world_from_camera is None else _CameraPlace(whole, other, kept)
