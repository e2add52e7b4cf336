"""The frames of a recording's camera as a dataset without labels: to look at, to predict, or to label in the studio."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from cabinpose.core import OCCUPANT_SLOTS, STANDING_SLOT, ConfigError, DatasetError, RecordingError, camera_from
from cabinpose.signals import FRAME_IMAGES
from cabinpose.store.convert.format import DatasetFormat, ImportOptions
from cabinpose.store.convert.reading import Origin, given_camera, make_manifest, put_camera
from cabinpose.store.recording import Recording, Take, tof_frames
from cabinpose.store.schema import Manifest
from cabinpose.store.shard import ticks_of_steps
from cabinpose.store.source import UNKNOWN, Source, blank_frame


@dataclass(frozen=True, kw_only=True)
class RecordedFrameOptions(ImportOptions):
    """How a recording's frames are read."""

    source: str | None = None
    """Name of the camera; default: the only one."""


class RecordedFrameFormat(DatasetFormat):
    """A camera's frames of a recording (.mcap), without labels."""

    import_options = RecordedFrameOptions

    def read(self, path: Path, options: RecordedFrameOptions) -> Source:
        """The frames in the order of their arrival; `sync_ns` is the camera's own time where it has one, else that of arrival.

        Raises `DatasetError` for what is no recording or has no such camera, and for frames of several sizes; `ConfigError` where
        none of several cameras is chosen.
        """
        try:
            with Recording(path) as recording:
                name = _camera_name(path, recording, options.source)
                take = recording.take
                count, first = 0, None
                for _, image in tof_frames(recording, name):
                    count, first = count + 1, first or image
        except RecordingError as error:
            raise DatasetError(str(error), hint=error.hint) from error
        if first is None:
            raise DatasetError(f"{path}: {name} gave no frame", hint="`cabinpose info` lists what a recording holds")
        height, width = first.depth.shape
        seats = bool(take.car) or any(subject.seat in OCCUPANT_SLOTS for subject in take.subjects)
        manifest = make_manifest(
            Origin("recording", path, options), frames=count, size=(width, height),
            persons=OCCUPANT_SLOTS if seats else (STANDING_SLOT,),
            variables=(
                "depth", *(each for each in FRAME_IMAGES if getattr(first, each).shape == first.depth.shape),
                *("drive_side",) * bool(take.drive_side),
            ),
            config={"camera": name},
        )  # fmt: skip
        return Source(path, manifest, partial(_frames, path, name, take, manifest, options))


RECORDED_FRAMES = RecordedFrameFormat()


def _camera_name(path: Path, recording: Recording, asked: str | None) -> str:
    """The camera that is asked for, or the only one."""
    there = recording.cameras
    if not there or asked not in (None, *there):
        what = f"no camera '{asked}'" if asked is not None else "no camera"
        raise DatasetError(f"{path} has {what}", hint=f"its cameras: {', '.join(there) or 'none'}")
    if asked is None and len(there) > 1:
        raise ConfigError(f"{path} has several cameras", hint=f"choose one with --source: {', '.join(there)}")
    return asked or there[0]


def _frames(path: Path, name: str, take: Take, manifest: Manifest, options: RecordedFrameOptions) -> Iterator[dict[str, Any]]:
    """The frames, one in memory at a time."""
    size = (manifest.width, manifest.height)
    given = given_camera(options, size)
    with Recording(path) as recording:
        for sample, image in tof_frames(recording, name):
            if image.depth.shape != size[::-1]:
                wrong = f"{path}: a frame has {image.depth.shape[1]}x{image.depth.shape[0]} pixels, not {size[0]}x{size[1]}"
                raise DatasetError(wrong, hint="the camera changed its mode; a dataset has one size")
            frame = blank_frame(manifest)
            frame["depth"] = ticks_of_steps(image.depth, image.depth_unit_m)
            for each in FRAME_IMAGES:
                if each in manifest.variables:
                    frame[each] = getattr(image, each)
            whose = f"{path}: camera_k"
            put_camera(frame, given or camera_from(image.camera_k, image.camera_dist, *size, whose=whose, error=DatasetError))
            frame["sync_ns"] = sample.host_ns if sample.device_ns is None else sample.device_ns
            frame["sequence"], frame["car"] = 0, take.car or UNKNOWN
            if "drive_side" in manifest.variables:
                frame["drive_side"] = take.drive_side
            yield frame
