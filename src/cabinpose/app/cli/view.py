"""`cabinpose view`: draw a contact sheet and a page of a dataset or a recording."""

from __future__ import annotations

import os
import sys
import tempfile
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree

from cabinpose.app.cli.arguments import (
    Maybe,
    SelectsFrames,
    ThingArgument,
    is_recording,
    no_empty_folder,
    refuse_existing,
    refuse_selection,
)
from cabinpose.app.cli.output import print_json, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError


@dataclass(frozen=True, kw_only=True)
class View(SelectsFrames):
    """Make pictures of a dataset or a recording: a contact sheet (PNG) and a page (one HTML file).

    The page of a dataset browses frames; that of a recording shows time lines, rates, gaps and sample frames.
    """

    dataset: ThingArgument
    """Folder of the dataset, or a recording (.mcap)."""
    out: Maybe[Path] = None
    """Folder for contact_sheet.png and index.html; default: a temporary one, whose page is opened in the browser."""
    open: bool = True
    """Open the page where there is no --out, and a screen."""
    frames: int = 24
    """Frames on the page, spread evenly over the dataset or take."""
    rows: int = 8
    """Frames on the contact sheet."""
    overwrite: bool = False
    """Replace the pictures in the folder."""


COMMAND = View


def run(command: View) -> None:
    """Draw, and print the names of the files."""
    from cabinpose.app.cli.selection import selected
    from cabinpose.app.view.sheet import VIEW_FILES
    from cabinpose.store import open_dataset, read_manifest

    folder, frames, rows = command.dataset, command.frames, command.rows
    if frames < 1 or rows < 1:
        raise ConfigError("a view shows at least one frame", hint="give --frames and --rows of 1 or more")
    recording = is_recording(folder)
    if command.out is not None and not recording and command.out.resolve().is_relative_to(folder.resolve()):
        raise ConfigError("the pictures would lie in the dataset", hint="give another folder with --out")
    refuse_existing(command.out, *VIEW_FILES, overwrite=command.overwrite)
    with _folder(command.out) as out:
        if recording:
            refuse_selection(command, "{} is of datasets, and this is a recording")
            require("record")
            from cabinpose.app.report.recordings import write_recording_view

            with progress(frames, "moments") as report:
                write_recording_view(folder, out, frames=frames, rows=rows, report=report)
        else:
            from cabinpose.app.view.page import write_view

            manifest = read_manifest(folder)
            dataset = selected(open_dataset(folder), command)
            count = dataset.sizes["frame"]
            with progress(min(frames, count) + min(rows, count), "frames") as report:
                write_view(dataset, manifest, folder, out, frames=frames, rows=rows, report=report)
    sheet, page = (out / name for name in VIEW_FILES)
    if command.as_json:
        print_json({"contact_sheet": str(sheet), "page": str(page)})
    else:
        print(f"{sheet}\n{page}")
    if command.out is None and command.open and not command.as_json:
        _open(page)


@contextmanager
def _folder(out: Path | None) -> Iterator[Path]:
    """The folder of the pictures, a temporary one where none is given; one that is empty at an error goes."""
    if out is not None:
        with no_empty_folder(out):
            yield out
        return
    temporary = Path(tempfile.mkdtemp(prefix="cabinpose-view-"))
    try:
        yield temporary
    except BaseException:
        rmtree(temporary)
        raise


def _open(page: Path) -> None:
    """Show a page in the browser. Without a screen there is none, or one that would take the terminal."""
    screen = sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not (screen and webbrowser.open(page.resolve().as_uri())):
        print("no browser was found here: open index.html in one", file=sys.stderr)
