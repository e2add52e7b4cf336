"""What verbs that look at frames take for them, beside a dataset: depth images, a recording, a bag, a COCO folder.

They become a dataset for the time of the command, by the format that `cabinpose import` has for them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import DatasetPath, Maybe, PrintsJson
from cabinpose.app.cli.output import printable, progress
from cabinpose.core import ConfigError

FramesArgument = Annotated[Positional[DatasetPath], arg(metavar="DATASET|FRAMES", help=(
    "Folder of a dataset, or `sample`; frames that are no dataset yet: depth images (PNG, TIFF, NPY; one or a folder), a "
    "recording (.mcap), a bag of ROS 2, a file of Azure Kinect's recorder (.mkv), a COCO folder."
))]  # fmt: skip
_PLAYED = {".mkv": "azure-mkv", ".db3": "rosbag2"}  # files of cameras' and robots' recorders, by suffix


@dataclass(frozen=True, kw_only=True)
class ReadsFrames(PrintsJson):
    """Flags of the verbs that take frames which are no dataset."""

    camera: Maybe[Path] = None
    """Of depth images: the camera's calibration (a file of OpenCV, ROS, Open3D or RealSense)."""
    intrinsics: Maybe[tuple[float, float, float, float]] = None
    """Of depth images, in place of --camera: fx fy cx cy in px."""
    fov_deg: Maybe[float] = None
    """Of depth images, in place of --camera: the horizontal field of view."""
    unit: Maybe[str] = None
    """Of depth images: m, cm, mm, or the metres of one step; default: recognised, and told."""

    def said(self) -> dict[str, object]:
        """What was given of them, by the formats' names."""
        given = {"camera": self.camera, "intrinsics": self.intrinsics, "fov_deg": self.fov_deg, "unit": self.unit}
        return {name: value for name, value in given.items() if value is not None}


@contextmanager
def as_dataset(path: Path, command: ReadsFrames) -> Iterator[Path]:
    """The folder of a dataset of the frames: `path` itself, or a temporary one, which goes at the end of the block.

    Raises ConfigError for a flag that says nothing of these frames, and what readers of the format raise.
    """
    said, form = command.said(), _format_of(path)
    if form is None:
        if said and (path / "dataset.yaml").exists():  # what is no dataset either, its reader says
            flag = f"--{next(iter(said)).replace('_', '-')}"
            raise ConfigError(f"{flag} says nothing of a dataset, which knows it", hint=f"leave out {flag}")
        yield path
        return
    from cabinpose.store import import_source
    from cabinpose.store.convert import import_recording, open_source

    with TemporaryDirectory(prefix="cabinpose-frames-") as folder:
        if form in _PLAYED.values():
            import_recording(path, form, taken := Path(folder, f"{path.stem}.mcap"))
            source = open_source(taken, "recording", **said)
        else:
            source = open_source(path, form, **said)
        print(printable(source.note or f"{path} is read as {form}"), file=sys.stderr)
        with progress(source.manifest.frames, "frames read") as report:
            made = import_source(source, Path(folder, path.name or "frames"), report=report)
        yield made


def _format_of(path: Path) -> str | None:
    """The format, by what is there; None of a dataset, and of what is none of these, which its reader says."""
    if (path / "dataset.yaml").exists() or not path.exists():
        return None
    if path.suffix == ".mcap":
        return "recording"
    if path.suffix in _PLAYED:
        return _PLAYED[path.suffix]
    if (path / "metadata.yaml").exists():
        return "rosbag2"
    if (path / "annotations").is_dir() or path.suffix == ".json":
        return "coco"
    from cabinpose.store.convert import DEPTH_SUFFIXES

    files = [path, *(file for folder in (path, path / "depth") if folder.is_dir() for file in folder.iterdir())]
    return "depth-images" if any(file.suffix in DEPTH_SUFFIXES for file in files) else None
