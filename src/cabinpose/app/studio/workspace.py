"""What the studio has open: a dataset with its labels and predictions, a recording, a scene."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import xarray as xr

from cabinpose.app.label.labelling import open_labels
from cabinpose.app.view import draw
from cabinpose.app.view.draw import completed
from cabinpose.core import CabinposeError, ConfigError, DatasetError
from cabinpose.evaluate import check_predictions
from cabinpose.store import (
    MANIFEST_NAME,
    Labels,
    Manifest,
    Predictions,
    dataset_id,
    labels_of,
    open_dataset,
    read_manifest,
    read_predictions,
    with_labels,
)


@dataclass
class Workspace:
    """What is open, shared by all tabs of all browsers.

    key: another word each time that a dataset is opened, part of the addresses of its images, which browsers keep ·
    proposals: name of the predictions that labelling begins with.
    """

    folder: Path | None = None
    dataset: xr.Dataset | None = None
    manifest: Manifest | None = None
    key: str = ""
    recording: Path | None = None
    scene: Path | None = None
    labels_path: Path | None = None
    role: str = "annotator"
    predictions: dict[str, Predictions] = field(default_factory=dict)
    proposals: str = ""
    _files: set[str] = field(default_factory=set)  # names of the predictions that were read from files
    _labels: Labels | None = None
    _parts: frozenset[str] = frozenset()  # those that were there then
    _seen: tuple[int, int] = (0, 0)  # when manifest and folder were changed, as they were last looked at
    _grown: int = 0

    def open(self, folder: Path, predictions: Sequence[Path] = ()) -> None:
        """Open a dataset in place of the one that is open, with predictions whose first labelling begins with.

        Raises DatasetError or PredictionsError.
        """
        parts, seen = _parts(folder), _changed(folder)  # before it is opened: one that comes meanwhile is offered
        dataset, manifest = completed(open_dataset(folder)), read_manifest(folder)
        self.close()
        self.folder, self.dataset, self.manifest, self.labels_path = folder, dataset, manifest, None
        self.key, self._parts, self._seen, self._grown = secrets.token_hex(4), parts, seen, 0
        self.predictions, self.proposals, self._files = {}, "", set()
        names = [self.add_predictions(path) for path in predictions]
        self.proposals = next(iter(names), "")

    def check(self) -> None:
        """Raise DatasetError where the dataset has vanished or is another one now: what is read then is not what is shown."""
        self.new_frames()

    def of_key(self, key: str) -> xr.Dataset | None:
        """The dataset that is open, if it is the one of this key."""
        return self.dataset if key == self.key else None

    @property
    def root(self) -> Path:
        """The folder of what was opened: paths from the browser stay in it."""
        thing = self.folder or self.recording or self.scene
        return thing.resolve().parent if thing is not None else Path.cwd()

    @property
    def labels(self) -> Labels:
        """The journal of labels, opened when it is needed first; DatasetError where another studio has it."""
        assert self.dataset is not None
        if self._labels is None:
            self._labels = open_labels(self._journal, self.dataset)
        return self._labels

    @property
    def _journal(self) -> Path:
        assert self.folder is not None
        return self.labels_path or self.folder.with_name(self.folder.name + ".labels.jsonl")

    def new_frames(self) -> int:
        """How many frames have come since the dataset was opened: those of its new parts. Costs two looks at the disk.

        Raises DatasetError where the dataset has vanished or is another one now.
        """
        assert self.folder is not None
        assert self.manifest is not None
        try:
            seen = _changed(self.folder)
        except OSError as error:
            raise DatasetError(f"{self.folder} has vanished", hint=_VANISHED) from error
        if seen != self._seen:
            if dataset_id(read_manifest(self.folder)) != dataset_id(self.manifest):
                raise DatasetError(f"{self.folder} is another dataset now", hint="end the studio and open it again")
            there = _parts(self.folder)
            if lost := self._parts - there:
                raise DatasetError(f"{self.folder} has lost {min(lost)}", hint=_VANISHED)
            new = there - self._parts
            grown = sum(plan.frames for plan in self.manifest.parts_in(self.folder) if plan.name in new)
            self._seen, self._grown = seen, grown
        return self._grown

    def trouble(self) -> CabinposeError | None:
        """Why the dataset that is open cannot be read any more, None where it is all there."""
        try:
            if self.dataset is not None:
                self.new_frames()
        except CabinposeError as error:
            return error
        return None

    def reopen(self) -> None:
        """Open the dataset again, with the frames that have come; tabs that hold it go on with what they have."""
        fresh = open_workspace(self.folder)
        self.dataset, self.manifest = fresh.dataset, fresh.manifest
        self._parts, self._seen, self._grown = fresh._parts, fresh._seen, fresh._grown

    def url(self, number: int, image: str) -> str:
        """Where the browser finds an image of the frame of a number."""
        return f"/frames/{self.key}/{number}/{image}"

    def thumbs_url(self, image: str) -> str:
        """Where the browser finds small images of frames, before their numbers."""
        return f"/thumbs/{self.key}/{image}/"

    def cloud_url(self, number: int, depth: str) -> str:
        """Where the browser finds the cloud of a depth image of the frame of a number."""
        return f"/clouds/{self.key}/{number}/{depth}"

    def corrected(self, dataset: xr.Dataset) -> xr.Dataset:
        """The dataset, as it was opened, with the labels that were set, here or in another studio that has them open.

        Raises DatasetError for a journal that cannot be read, or is of another dataset.
        """
        if self._labels is not None:
            labels = dict(self._labels.now)  # a copy: another thread may set labels meanwhile
        else:
            there = self._journal.is_file() and self._journal.stat().st_size
            labels = labels_of(self._journal, [str(dataset.attrs["dataset_id"])]) if there else {}
        return with_labels(dataset, labels) if labels else dataset

    def add_predictions(self, path: Path) -> str:
        """Open a predictions file of the dataset; the name it goes by. Raises PredictionsError."""
        assert self.dataset is not None
        assert self.folder is not None
        assert self.manifest is not None
        predictions = read_predictions(path)
        check_predictions(predictions, self.dataset, (str(self.dataset.attrs["dataset_id"]), self.folder.resolve().name))
        name = predictions.model if predictions.model not in self.predictions else f"{predictions.model} ({path.name})"
        self.predictions[name] = predictions
        self._files.add(name)
        return name

    def add_run(self, predictions: Predictions) -> str:
        """Take what a model found here, in place of what it found before but beside a file of its name; the name it goes by."""
        name = predictions.model if predictions.model not in self._files else f"{predictions.model} (run here)"
        self.predictions[name] = predictions
        return name

    def found_predictions(self) -> list[Path]:
        """Predictions files that lie beside the dataset or in it, of the first megabyte of names."""
        if self.folder is None:
            return []
        places = [self.folder.resolve().parent, self.folder.resolve()]
        return sorted(p for place in places for p in place.glob("*.jsonl") if _is_predictions(p))

    def close(self) -> None:
        """Let go of the labels."""
        if self._labels is not None:
            self._labels.close()
            self._labels = None


def open_workspace(thing: Path | None, *, labels: Path | None = None, role: str = "annotator") -> Workspace:
    """Open a dataset, a recording (.mcap) or a scene (.yaml); nothing for None. Raises ConfigError for anything else."""
    if thing is None:
        return Workspace()
    if thing.is_dir():
        if not (thing / MANIFEST_NAME).is_file():
            raise ConfigError(f"{thing} is no dataset: it has no {MANIFEST_NAME}", hint="give the folder of a dataset")
        workspace = Workspace(role=role)
        workspace.open(thing)
        workspace.labels_path = labels
        return workspace
    if not thing.is_file():
        raise ConfigError(f"there is no {thing}", hint="give a dataset, a recording (.mcap) or a scene (.yaml)")
    if thing.suffix == ".mcap":
        return Workspace(recording=thing)
    if thing.suffix in (".yaml", ".yml"):
        return Workspace(scene=thing)
    raise ConfigError(f"{thing} is nothing the studio opens", hint="give a dataset, a recording (.mcap) or a scene (.yaml)")


def depth_range(dataset: xr.Dataset, row: int) -> tuple[float, float]:
    """Near and far end of the colours for a frame's depth, m."""
    depth = dataset["depth"][row].values
    step = max(round((depth.size / _ENOUGH) ** 0.5), 1)
    return draw.depth_range(depth[::step, ::step])


_ENOUGH = 100_000  # pixels, to tell the range of their depths
_VANISHED = "bring it back to where it was, or end the studio and open another; labels are kept beside it"


def _changed(folder: Path) -> tuple[int, int]:
    """When the manifest and the folder of a dataset were changed last, ns; OSError where there is none."""
    return (folder / MANIFEST_NAME).stat().st_mtime_ns, folder.stat().st_mtime_ns


def _parts(folder: Path) -> frozenset[str]:
    """Names of the parts that are there."""
    return frozenset(path.name for path in folder.glob("part-*.zarr"))


def _is_predictions(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return b"cabinpose-predictions" in file.readline(4096)
    except OSError:
        return False
