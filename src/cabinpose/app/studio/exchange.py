"""COCO keypoints out of the Label tab and, corrected in CVAT, back into it."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Callable
from pathlib import Path

import xarray as xr
from fastapi import APIRouter
from nicegui import run, ui
from nicegui.events import UploadEventArguments

from cabinpose.app.label.corrections import Corrections, corrections
from cabinpose.app.label.labelling import Labelling
from cabinpose.app.studio.workspace import Workspace
from cabinpose.core import CabinposeError
from cabinpose.store.convert import COCO_LABELS, NoOptions, export_dataset

MOST_FRAMES = 2000  # of a download: about 100 MB, made in a minute
MOST_BYTES = 64_000_000  # of an upload: the annotations of some ten thousand frames


class Passing:
    """Where files of browsers lie for a while: one folder of the studio, made when it is needed first, gone with the studio."""

    def __init__(self, _: Workspace) -> None:
        self._all: tempfile.TemporaryDirectory[str] | None = None

    def folder(self) -> Path:
        """A new folder; who asks for it removes it."""
        if self._all is None:
            self._all = tempfile.TemporaryDirectory(prefix="cabinpose-studio-")
        return Path(tempfile.mkdtemp(dir=self._all.name))

    def routes(self) -> APIRouter:
        """None: a page's downloads have addresses of their own."""
        return APIRouter()

    def stop(self) -> None:
        """Remove what lies there."""
        if self._all is not None:
            self._all.cleanup()


class Exchange:
    """A button whose dialog gives and takes COCO files."""

    def __init__(self, workspace: Workspace, labelling: Labelling, passing: Passing, changed: Callable[[], None]) -> None:
        """changed: called when labels came in."""
        assert workspace.folder is not None
        self._name = workspace.folder.resolve().name
        self._workspace, self._labelling, self._passing, self._changed = workspace, labelling, passing, changed
        self._given: Path | None = None  # the folder of this page's download
        taken = weakref.WeakMethod(self._take)  # FastAPI keeps the address of an upload, and so its handler, for good
        with ui.dialog() as self._dialog, ui.card().style("width: 420px"):
            ui.label("COCO keypoints, for CVAT and back").style("font-weight: 600")
            self._download = ui.button("Download frames and labels", icon="download", on_click=self._give)
            self._download.props("outline no-caps").classes("w-full")
            ui.label("Corrected there, its file of annotations (.json) comes back: joints that were changed become labels.")
            upload = ui.upload(
                label="Take a corrected file", auto_upload=True, max_file_size=MOST_BYTES,
                on_upload=lambda event: take(event) if (take := taken()) is not None else None,
            )  # fmt: skip
            upload.props("accept=.json flat bordered").classes("w-full").mark("corrected")
            upload.on("rejected", lambda: ui.notify(_TOO_MUCH, type="negative"))
        ui.button(icon="import_export", on_click=self._dialog.open).props("flat round dense").tooltip("COCO, for CVAT and back")

    async def _give(self) -> None:
        frames = self._labelling.dataset.sizes["frame"]
        if frames > MOST_FRAMES:
            line = f"cabinpose export coco {self._workspace.folder} --labels {self._labelling.labels.path} --out FOLDER"
            ui.notify(f"{frames} frames are too many for a download: {line}", multi_line=True, timeout=15_000)
            return
        if self._given is None:
            self._given = given = self._passing.folder()
            ui.context.client.on_delete(lambda: shutil.rmtree(given, ignore_errors=True))
        self._download.disable()
        try:
            if made := await run.io_bound(zipped, self._workspace, self._labelling.dataset, self._given):
                ui.download.file(made, f"{self._name}-coco.zip")
        except CabinposeError as error:
            ui.notify(error.in_one_line(), type="negative", multi_line=True)
        finally:
            self._download.enable()

    async def _take(self, event: UploadEventArguments) -> None:
        if event.file.size() > MOST_BYTES:  # the browser's own check can be got round
            ui.notify(_TOO_MUCH, type="negative")
            return
        folder = self._passing.folder()
        path = folder / "corrected.json"
        try:
            await event.file.save(path)
            found = await run.io_bound(_corrections, self._labelling, path)
            if found is None:
                return
            self._labelling.take_in(found.changes)
        except CabinposeError as error:
            ui.notify(error.in_one_line().replace(str(path), event.file.name), type="negative", multi_line=True, timeout=10_000)
            return
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        told = "; ".join([f"{len(found.changes)} joints corrected in {found.frames} frames", *found.notes()])
        ui.notify(told, type="positive", multi_line=True)
        self._changed()


def _corrections(labelling: Labelling, path: Path) -> Corrections:
    return corrections(labelling, path, COCO_LABELS.read(path, NoOptions()))


def zipped(workspace: Workspace, dataset: xr.Dataset, folder: Path) -> Path:
    """The zip, in a folder, of a COCO export of all frames with the labels that hold."""
    assert workspace.manifest is not None
    workspace.check()
    stored = {variable.name for variable in workspace.manifest.stored}
    filled = [name for name in ("labels", "instance") if name not in stored]  # for the eye, by `completed`
    export = export_dataset(workspace.corrected(dataset).drop_vars(filled), "coco", folder / "coco", overwrite=True)
    return Path(shutil.make_archive(str(export), "zip", export))


_TOO_MUCH = f"a file of annotations (.json) of at most {MOST_BYTES // 1_000_000} MB is taken"
