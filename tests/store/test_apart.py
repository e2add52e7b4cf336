"""Work in a process of its own: its items, its errors, and its death."""

from __future__ import annotations

import multiprocessing
import os
import threading
from pathlib import Path

import pytest
from apart_subject import lines

from cabinpose.core.errors import MocapError
from cabinpose.store.convert import apart
from cabinpose.store.convert.apart import CrashedError, items_apart


@pytest.fixture(autouse=True)
def _forked_as_for_users(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside no threads, of which pytest-timeout's, which only waits, is none."""
    monkeypatch.setattr(apart, "multiprocessing", multiprocessing)
    watchdogs = "pytest_timeout"
    monkeypatch.setattr(threading, "active_count", lambda: sum(not t.name.startswith(watchdogs) for t in threading.enumerate()))


def made(path: Path, *words: str) -> Path:
    path.write_text("\n".join(words))
    return path


@pytest.mark.parametrize("threads", [False, True])
def test_items_come_in_order_from_another_process(tmp_path: Path, threads: bool) -> None:
    words = [str(i) for i in range(200)]
    stop = threading.Event()
    other = threading.Thread(target=stop.wait)
    if threads:  # then the process is not forked
        other.start()
    found = list(items_apart(lines, made(tmp_path / "a", *words)))
    stop.set()
    assert [word for _, word in found] == words
    assert os.getpid() not in {process for process, _ in found}


@pytest.mark.parametrize(
    ("word", "error", "message"),
    [
        ("crash", CrashedError, "ended with -6"),
        ("spin", CrashedError, "ended with -24"),
        ("swell", RuntimeError, "MemoryError"),
        ("fail", RuntimeError, "KeyError: 'a defect'"),
        ("refuse", MocapError, "refused"),
    ],
)
def test_its_end_is_an_error(
    tmp_path: Path, word: str, error: type[Exception], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "_PROCESSOR_S", 1)
    with pytest.raises(error, match=message) as raised:
        list(items_apart(lines, made(tmp_path / "a", "first", word, "never")))
    if isinstance(raised.value, MocapError):
        assert raised.value.hint == "mend it"


def test_it_ends_with_its_reader(tmp_path: Path) -> None:
    found = items_apart(lines, made(tmp_path / "a", *["word"] * 10_000, "spin"))
    process, _ = next(found)
    found.close()  # type: ignore[attr-defined]
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
