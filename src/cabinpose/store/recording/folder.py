"""The takes in a folder: whose they are, and their erasure when somebody asks for it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from cabinpose.core import RecordingError
from cabinpose.store.recording.files import read_head
from cabinpose.store.recording.scan import Scanner
from cabinpose.store.recording.take import Take


@dataclass(frozen=True)
class TakeFile:
    """A file of a folder. take: None where it cannot be told whose it is, for the reason in `problem`."""

    path: Path
    bytes: int
    started_ns: int
    take: Take | None
    problem: str = ""

    def shows(self, subject: str) -> bool:
        """Whether it is a take of a subject."""
        return self.take is not None and subject in self.take.codes

    def others(self, subject: str) -> tuple[str, ...]:
        """Who is recorded in it beside a subject."""
        return () if self.take is None else tuple(code for code in self.take.codes if code != subject)


def takes_in(folder: Path) -> list[TakeFile]:
    """Every .mcap file in a folder and the folders within, with or without its end, by path; hidden ones too, since a
    recovery that was interrupted leaves one. Raises RecordingError where there is no folder.
    """
    if not folder.is_dir():
        raise RecordingError(f"there is no folder {folder}", hint="name the folder that the takes are in")
    paths = {*folder.rglob("*.mcap"), *folder.rglob("*.mcap.*.tmp")}
    return [_file(path) for path in sorted(paths) if path.is_file()]


def erase(files: Iterable[TakeFile]) -> None:
    """Delete files. Copies elsewhere, and what a disk keeps of deleted files, are not touched. Raises RecordingError where one
    cannot be deleted, naming it; those before it are gone then.
    """
    for file in files:
        try:
            file.path.unlink()
        except OSError as error:
            raise RecordingError(
                f"{file.path} could not be deleted: {error.strerror}", hint="see to its rights, then run the same command again"
            ) from error


def _file(path: Path) -> TakeFile:
    size = path.stat().st_size
    try:
        with Scanner(path) as scanner:
            head = read_head(scanner)
    except RecordingError as error:
        return TakeFile(path, size, 0, None, str(error))
    return TakeFile(path, size, head.started_ns, head.take)
