"""One way to write an output: it is made beside its place, and takes its name when it is whole.

Beside an output `NAME` lies, while it is made, a hidden folder `.NAME.tmp`: what is new in it, the lock of its writer on it, and,
between the two renames that replace a folder, what was there before. A process that is killed leaves the hidden folder; the next
writer of the same output puts back what was there before, and removes the rest.
"""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from hashlib import sha256
from pathlib import Path

from cabinpose.core.errors import CabinposeError, OutputError

FULL_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Numbers of errors: a full disk, a quota, or a limit of the size of files."""
_REFUSED = (
    errno.EACCES, errno.EPERM, errno.EROFS, errno.EIO, errno.ENAMETOOLONG, errno.ENOTDIR, errno.EISDIR, errno.ELOOP, errno.EBUSY,
    errno.EXDEV, errno.EEXIST,
)  # fmt: skip
_NAME_BYTES = 255  # of most file systems
_OLD = "before"
_NEW = "new"


def unwritable(path: Path, error: OSError, kind: type[CabinposeError] = OutputError) -> CabinposeError:
    """What to tell of an output that the system refuses."""
    if error.errno in FULL_DISK:
        return kind(f"no space left while writing {path}", hint="free some disk space, then run the same command again")
    if error.errno == errno.ENAMETOOLONG:
        return kind(f"cannot write {path}: the name is too long", hint="give a shorter one")
    if error.errno == errno.EXDEV:  # a folder of a lower layer, as of a container's image, or under a quota of its own
        return kind(
            f"cannot replace {path} as a whole: its file system moves the folder no more", hint="remove it first, or give another"
        )
    return kind(f"cannot write {path}: {error.strerror or error}", hint="give a place in a folder that you may write to")


@contextmanager
def output_errors(path: Path, kind: type[CabinposeError] = OutputError, *, told: Path | None = None) -> Iterator[None]:
    """Turn what the system refuses in writing `path` into an error that says so; one of reading another file stays.

    told: the name in the error, where `path` is in a folder that takes its place when it is whole.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in FULL_DISK and not (error.errno in _REFUSED and _is_of(error, path)):
            raise
        raise unwritable(told or path, error, kind) from error


def is_refused(error: OSError) -> bool:
    """Whether the system refuses to write or read, which a user can mend; anything else is a defect."""
    return error.errno in (*FULL_DISK, *_REFUSED)


def _is_of(error: OSError, path: Path) -> bool:
    if error.filename is None:
        return True
    named, real = Path(os.path.realpath(os.fsdecode(error.filename))), _real(path)
    return named == real or stage_of(real) in (named, *named.parents) or real in named.parents or named in real.parents


def _real(path: Path) -> Path:
    """Where a symbolic link leads to, be it there or not."""
    return Path(os.path.realpath(path))


def stage_of(path: Path) -> Path:
    """The hidden folder in which an output is made; the name is as long as names may be."""
    name = f".{path.name}.tmp"
    return path.with_name(name if len(os.fsencode(name)) <= _NAME_BYTES else f".{sha256(os.fsencode(name)).hexdigest()[:32]}.tmp")


def left_before(path: Path) -> Path | None:
    """What was at `path` before a writer was killed as it replaced it; None where there is no such thing."""
    old = stage_of(_real(path)) / _OLD
    return old if old.exists() and not path.exists() else None


def check_output(path: Path, kind: type[CabinposeError] = OutputError, *, parents: bool = True) -> None:
    """Try, before the work, whether `path` can be written: something is made beside it, or in it, and removed.

    Raises `kind` where the system refuses. parents: folders above that are missing will be made with the output; else they
    are refused too.
    """
    real = _real(path)
    try:
        there = real if real.is_dir() else real.parent  # OSError of a name that is too long
        if not parents and not there.exists():
            raise _no_folder(path, there, kind)
        while not there.exists():
            there = there.parent
        if not there.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, f"{there} is no folder")
        _try(there)
    except OSError as error:
        raise unwritable(path, error, kind) from error


def _no_folder(path: Path, folder: Path, kind: type[CabinposeError]) -> CabinposeError:
    return kind(f"cannot write {path}: there is no folder {folder}", hint="make the folder first, or give another")


def _try(folder: Path) -> None:
    """Make a file in a folder and remove it; where the system can, one without a name."""
    if hasattr(os, "O_TMPFILE"):
        try:
            os.close(os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o600))
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL, errno.ENOENT):
                raise
        else:
            return
    tried = folder / f".{os.getpid()}.try.tmp"
    tried.mkdir()
    tried.rmdir()


@contextmanager
def whole_file(path: Path, *, kind: type[CabinposeError] = OutputError, told: Path | None = None) -> Iterator[Path]:
    """The name of a file to make, which takes the place of `path` when the block ends without an error, else is removed.

    Parameters
    ----------
    path
        The file, in a folder that exists. Where it is a link, what the link leads to.
    kind
        The error for an output that cannot be written, or that another process writes.
    told
        The name in that error, as in `output_errors`.
    """
    real = _real(path)
    with output_errors(path, kind, told=told), _staged(told or path, real, kind) as stage:
        new = stage / (path.name if path.name != _OLD else _NEW)  # with its suffix, which some libraries ask for
        yield new
        _sync(new)
        new.replace(real)
        _sync(real.parent)


@contextmanager
def whole_folder(path: Path, *, kind: type[CabinposeError] = OutputError) -> Iterator[Path]:
    """As `whole_file`, of a folder: the name of one to make. What is at `path` stays until the new one is whole and on disk."""
    real = _real(path)
    if os.path.ismount(real):
        raise kind(f"{path} is where a disk is mounted, which cannot be replaced as a whole", hint="give a folder in it")
    with output_errors(path, kind), _staged(path, real, kind) as stage:
        held = lock(real, path, kind) if real.is_dir() else None  # who writes in place, as synth does, holds the folder itself
        try:
            new = stage / _NEW
            yield new
            for made in (*new.rglob("*"), new):
                _sync(made)
            if real.exists():
                real.rename(stage / _OLD)
            try:
                new.rename(real)
            except BaseException:
                _put_back(stage, real)
                raise
            _sync(real.parent)
        finally:
            if held is not None:
                os.close(held)


def make_folder(path: Path, kind: type[CabinposeError] = OutputError) -> None:
    """Make a folder for outputs, and those above it, unless it is there. Where it is a link, what the link leads to."""
    with output_errors(path, kind):
        _make(_real(path), path, kind, parents=True)


def _make(folder: Path, told: Path, kind: type[CabinposeError], *, parents: bool = False) -> None:
    try:
        folder.mkdir(parents=parents, exist_ok=True)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOENT):  # as FAT and exFAT refuse a colon
            raise
        raise kind(f"cannot write {told}: its file system takes no such name", hint="give one of letters and digits") from error


def write_whole(path: Path, content: str | bytes, *, kind: type[CabinposeError] = OutputError, told: Path | None = None) -> None:
    """Write a text, as UTF-8, or bytes; the file takes its name when it is whole. told: as in `output_errors`."""
    with whole_file(path, kind=kind, told=told) as partial:
        _fill(partial, content)


def write_together(folder: Path, contents: Mapping[str, str | bytes], *, kind: type[CabinposeError] = OutputError) -> None:
    """Write files of one folder, by their names; none takes its name before all are whole and on disk.

    They take their names one after another, from the last to the first. A kill in between leaves new ones beside old ones, each
    whole; so the first is the one that readers open, which stays the old one until all others are there.
    """
    made = not folder.exists()
    make_folder(folder, kind)
    with ExitStack() as stack:
        if made:
            stack.callback(_remove_empty, folder)
        for name, content in contents.items():
            partial = stack.enter_context(whole_file(folder / name, kind=kind))
            _fill(partial, content)
            _sync(partial)


def _fill(file: Path, content: str | bytes) -> None:
    file.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def lock(folder: Path, told: Path, kind: type[CabinposeError]) -> int:
    """A descriptor that holds a folder for its writer until it is closed; `kind` where another process holds it."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        _hold(descriptor, told, kind)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def refuse_other_writer(path: Path, kind: type[CabinposeError]) -> None:
    """Raise `kind` where a process is about to replace `path` as a whole."""
    stage = stage_of(_real(path))
    if stage.is_dir():
        os.close(lock(stage, path, kind))


def _hold(descriptor: int, told: Path, kind: type[CabinposeError]) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise kind(
            f"another process is writing to {told}", hint="wait until it has finished, or give another place with --out"
        ) from None
    except OSError:
        return  # a file system without locks


@contextmanager
def interrupts_held() -> Iterator[Callable[[], None]]:
    """Ctrl-C and SIGTERM wait until the end of the block, or until what it is given is called.

    For what an exception from anywhere would leave half done: cleaning up, and libraries that crash when one goes through them.
    """
    asked: list[int] = []
    main = threading.current_thread() is threading.main_thread()  # no other thread is interrupted, or may say who is
    handlers = {kind: signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM)} if main else {}
    before = {kind: handler for kind, handler in handlers.items() if callable(handler)}

    def due() -> None:
        if asked:
            kind = signal.Signals(asked.pop(0))
            before[kind](kind, None)

    for kind in before:
        signal.signal(kind, lambda number, _: asked.append(number))
    try:
        yield due
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
        due()


@contextmanager
def _staged(path: Path, real: Path, kind: type[CabinposeError]) -> Iterator[Path]:
    stage = stage_of(real)
    if not stage.parent.exists():
        raise _no_folder(path, stage.parent, kind)
    held = None
    try:
        with interrupts_held():
            held = _locked(stage, path, kind)
            _put_back(stage, real)
            _emptied(stage)
        yield stage
    finally:
        if held is not None:
            with interrupts_held():
                _put_back(stage, real)
                shutil.rmtree(stage, ignore_errors=True)
                os.close(held)


def _locked(stage: Path, told: Path, kind: type[CabinposeError]) -> int:
    """Make the folder and lock it; again where the writer before has removed it in between."""
    while True:
        if stage.is_file():
            stage.unlink()  # of an earlier version
        _make(stage, told, kind)
        with suppress(FileNotFoundError):
            held = lock(stage, told, kind)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(held), stage.stat()):
                    return held
            os.close(held)


def _put_back(stage: Path, real: Path) -> None:
    if (stage / _OLD).exists() and not real.exists():
        (stage / _OLD).rename(real)


def _emptied(stage: Path) -> None:
    for left in stage.iterdir():
        if left.is_dir():
            shutil.rmtree(left)
        else:
            left.unlink()


def _sync(path: Path) -> None:
    """Have the disk hold a file, or the names in a folder where the file system can."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EBADF, errno.ENOTSUP):
            raise
    finally:
        os.close(descriptor)
