"""A format: joints of every frame as a table of comma-separated values, and back."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cabinpose.core import Visibility
from cabinpose.store import Source, blank_frame
from cabinpose.store.convert import DatasetFormat, ImportOptions, Origin, make_manifest


@dataclass(frozen=True, kw_only=True)
class JointsExport:
    """How a table of joints is written."""

    digits: int = 4
    """Digits after the point of a metre."""


class JointsFormat(DatasetFormat):
    """Joints as a table, metres in the camera frame."""

    export_options = JointsExport

    def write(self, parts: Any, folder: Path, options: JointsExport, report: Any) -> None:
        """joints.csv, a row for each person in each frame."""
        (dataset,) = parts.values()
        with (folder / "joints.csv").open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["frame", "person", *(f"{joint}_{axis}" for joint in dataset["joint"].values for axis in "xyz")])
            for done, frame in enumerate(dataset["joints_3d"], 1):
                for person in frame:
                    values = (f"{value:.{options.digits}f}" for value in person.values.ravel())
                    rows.writerow([int(frame["frame"]), str(person["person"].values), *values])
                report(done)

    def read(self, path: Path, options: ImportOptions) -> Source:
        """A dataset of joints without images."""
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        numbers, persons = list(dict.fromkeys(row["frame"] for row in rows)), tuple(dict.fromkeys(row["person"] for row in rows))
        made = make_manifest(Origin("joints", path, options), frames=len(numbers), size=(1, 1), persons=persons, variables=())

        def frames() -> Iterator[dict[str, Any]]:
            for number in numbers:
                frame = blank_frame(made)
                for row in (row for row in rows if row["frame"] == number):
                    xyz = np.array([[float(row[f"{joint}_{axis}"]) for axis in "xyz"] for joint in made.joints])
                    place, known = persons.index(row["person"]), np.isfinite(xyz).all(axis=1)
                    frame["subject"][place], frame["joints_3d"][place] = "unknown", xyz
                    frame["visibility"][place] = np.where(known, Visibility.OCCLUDED, Visibility.ABSENT)
                yield frame

        return Source(path, made, frames)


JOINTS = JointsFormat()
