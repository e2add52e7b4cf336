"""Outputs are whole or absent: killed at each system call that changes the disk, refused by it, or written twice at once."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from cabinpose.core import (
    OutputError,
    check_output,
    interrupts_held,
    make_folder,
    whole_file,
    whole_folder,
    write_together,
    write_whole,
)

_KILLED = """
import os, sys
from pathlib import Path
from cabinpose.core import whole_folder, write_whole
left = int(sys.argv[1])
def counted(call):
    def wrapped(*given, **named):
        global left
        left -= 1
        if left == 0:
            os._exit(137)
        return call(*given, **named)
    return wrapped
for name in ("rename", "replace", "mkdir", "rmdir", "unlink", "fsync", "write"):
    setattr(os, name, counted(getattr(os, name)))
out = Path(sys.argv[3])
if sys.argv[2] == "file":
    write_whole(out, "new")
else:
    with whole_folder(out) as folder:
        folder.mkdir()
        (folder / "a").write_text("new")
"""


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_kill_at_each_call_leaves_the_old_or_the_new(tmp_path: Path, kind: str) -> None:
    out = tmp_path / "out"
    inside = out if kind == "file" else out / "a"
    (out.mkdir() if kind == "folder" else None)
    for at in range(1, 40):
        inside.write_text("old")
        done = subprocess.run([sys.executable, "-c", _KILLED, str(at), kind, str(out)], check=False)
        if kind == "folder" and not out.exists():  # between the two renames: the next writer puts the old one back
            with pytest.raises(ValueError, match="stop"), whole_folder(out):
                raise ValueError("stop")
        assert inside.read_text() in ("old", "new")
        if done.returncode == 0:
            break
    assert at > 3
    assert inside.read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_two_writers(tmp_path: Path) -> None:
    with whole_folder(tmp_path / "out") as first:
        first.mkdir()
        with pytest.raises(OutputError, match="another process is writing"), whole_folder(tmp_path / "out"):
            pass
        with pytest.raises(OutputError, match="another process is writing"):
            write_whole(tmp_path / "out", "x")
    assert (tmp_path / "out").is_dir()


def test_a_full_disk_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_together(tmp_path / "out", {"a": "old", "b": "old"})

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="no space left") as error:
        write_together(tmp_path / "out", {"a": "new", "b": "new"})
    assert "--resume" not in str(error.value.hint)
    with pytest.raises(OutputError, match="no space left"):
        write_together(tmp_path / "none", {"a": "new"})
    assert not (tmp_path / "none").exists()
    assert {path.name: path.read_text() for path in (tmp_path / "out").iterdir()} == {"a": "old", "b": "old"}


def test_a_folder_that_cannot_be_moved_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As one of a lower layer of an overlay, which in a container all of the image are."""
    old = tmp_path / "out"
    old.mkdir()
    (old / "a").write_text("old")
    rename = Path.rename

    def refuse(self: Path, target: Path) -> Path:
        if self == old:
            raise OSError(errno.EXDEV, os.strerror(errno.EXDEV), str(self), None, str(target))
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(OutputError, match=r"cannot replace .*out as a whole") as error, whole_folder(old) as new:
        new.mkdir()
    assert error.value.hint == "remove it first, or give another"
    assert (old / "a").read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOENT])
@pytest.mark.parametrize("write", [lambda path: write_whole(path, "new"), make_folder])
def test_a_name_that_the_file_system_does_not_take(
    write: Callable[[Path], None], number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As FAT and exFAT do of a colon: the kernel says the first, drivers of FUSE the second."""
    mkdir = os.mkdir

    def refuse(path: Path, mode: int = 0o777) -> None:
        if ":" in os.fspath(path):
            raise OSError(number, os.strerror(number), path)
        mkdir(path, mode)

    monkeypatch.setattr(os, "mkdir", refuse)
    write(tmp_path / "out")
    with pytest.raises(OutputError, match="out:2: its file system takes no such name"):
        write(tmp_path / "out:2")


def test_names_as_long_as_may_be_and_links(tmp_path: Path) -> None:
    write_whole(tmp_path / ("n" * 255), "x")
    for write in (check_output, lambda path: write_whole(path, "x")):
        with pytest.raises(OutputError, match="too long"):
            write(tmp_path / ("n" * 256))
    (tmp_path / "link").symlink_to("target")
    with whole_file(tmp_path / "link") as partial:
        partial.write_text("x")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == "x"
    with pytest.raises(OutputError, match="no folder"):
        write_whole(tmp_path / "nowhere" / "x", "x")
    with pytest.raises(OutputError, match="no folder"):
        check_output(tmp_path / "nowhere" / "x", parents=False)
    assert not (tmp_path / "nowhere").exists()


def test_what_refuses_is_told_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = os.open

    def read_only(path: str, flags: int, *more: int) -> int:
        if flags & os.O_WRONLY:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), path)
        return before(path, flags, *more)

    check_output(tmp_path / "out")
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(os, "open", read_only)
    with pytest.raises(OutputError, match="Read-only"):
        check_output(tmp_path / "out")


def test_the_first_of_several_files_is_written_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order, before = [], Path.replace
    monkeypatch.setattr(Path, "replace", lambda self, to: (order.append(Path(to).name), before(self, to))[1])
    write_together(tmp_path, {"index.html": "page", "report.json": b"{}"})
    assert order == ["report.json", "index.html"]


def test_a_file_may_have_the_name_of_what_is_kept(tmp_path: Path) -> None:
    with suppress(KeyboardInterrupt), whole_file(tmp_path / "before") as partial:
        partial.write_text("half")
        os.kill(os.getpid(), signal.SIGINT)
    assert not list(tmp_path.iterdir())


def test_a_mounted_disk_and_what_an_earlier_version_left(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="mounted"), whole_folder(Path("/proc")):
        pass
    (tmp_path / ".out.tmp").write_text("of an earlier version")
    write_whole(tmp_path / "out", "new")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.fixture
def own_handler() -> Iterator[None]:
    """Ctrl-C as Python has it, whatever a test before has left."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("own_handler")
def test_interrupts_wait() -> None:
    reached = []
    with suppress(KeyboardInterrupt):
        with interrupts_held():
            os.kill(os.getpid(), signal.SIGINT)
            reached.append("the end of the block")
        reached.append("behind it")
    with suppress(KeyboardInterrupt), interrupts_held() as due:
        os.kill(os.getpid(), signal.SIGINT)
        due()
        reached.append("behind what was due")
    assert reached == ["the end of the block"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
