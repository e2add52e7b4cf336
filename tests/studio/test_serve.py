"""The studio's server as a process: what strangers' requests cost it, and what is left of it."""

from __future__ import annotations

import re
import signal
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc"),
]
LOADS = 300


def memory_mb(process: int) -> float:
    """Resident memory."""
    (line,) = (line for line in Path(f"/proc/{process}/status").read_text().splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


def load(address: str) -> str:
    with urllib.request.urlopen(address) as answer:
        text: str = answer.read().decode()
    return text


def visit(address: str) -> int:
    """Load the page as a browser does, with its WebSocket, until its tabs have come, and close it; characters that came."""
    from websockets.sync.client import connect

    found = re.search(r"client_id\W+([0-9a-f-]{36})", load(address))
    assert found is not None
    client = found[1]
    query = {"client_id": client, "tab_id": client, "document_id": client, "old_tab_id": "null", "next_message_id": 0}
    query |= {"implicit_handshake": "true", "EIO": 4, "transport": "websocket"}
    came = 0
    with connect(address.replace("http", "ws") + "_nicegui_ws/socket.io/?" + urlencode(query), max_size=1 << 26) as socket:
        socket.recv()
        socket.send("40")
        while came < 60_000:
            came += len(socket.recv(timeout=60))
    return came


def test_pages_that_nobody_looks_at_cost_no_memory(start: Callable[..., Any], dataset_folder: Path) -> None:
    """2.2 MB each, once; now what a request takes until it is dropped."""
    server = start(dataset_folder)
    load(server.address)
    before = memory_mb(server.process.pid)
    for _ in range(LOADS):
        load(server.address)
    assert memory_mb(server.process.pid) - before < 40


def test_pages_that_were_closed_give_their_memory_back(start: Callable[..., Any], dataset_folder: Path) -> None:
    """Once those that are open at a time have been: those that follow need no more."""
    server = start(dataset_folder)
    memory = []
    for _ in range(3):
        for _ in range(25):
            visit(server.address)
        time.sleep(12)  # a page is held for ten seconds, in which a browser may come back
        memory.append(memory_mb(server.process.pid))
    assert memory[2] - memory[1] < 12


def test_unknown_path_is_no_page(start: Callable[..., Any], dataset_folder: Path) -> None:
    server = start(dataset_folder)
    for path in ("nothing", "a/b.php?x=1", "Dataset"):
        with pytest.raises(urllib.error.HTTPError) as error:
            load(server.address + path)
        assert error.value.code == 404
        assert len(error.value.read()) < 100


def test_printed_address_opens_whatever_the_token(start: Callable[..., Any]) -> None:
    server = start("--token", "a+b&c#d%20e fü密")
    assert "cabinpose studio" in load(server.address)
    with pytest.raises(urllib.error.HTTPError, match="403"):
        load(server.address.split("?")[0])


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGINT])
def test_nothing_is_left_when_it_is_ended(
    page: Any, start: Callable[..., Any], dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: int
) -> None:
    """While a page is open that has downloaded its frames."""
    (tmp_path / "passing").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "passing"))
    monkeypatch.setattr(tempfile, "tempdir", None)
    server = start(dataset_folder)
    page.goto(server.address)
    page.get_by_role("tab", name="Label").click()
    page.get_by_text("import_export").click()
    with page.expect_download() as download:
        page.get_by_role("button", name="Download frames and labels").click()
    download.value.save_as(tmp_path / "frames.zip")
    assert list((tmp_path / "passing").glob("cabinpose-studio-*"))
    server.process.send_signal(kind)
    server.process.wait(timeout=20)
    assert not list((tmp_path / "passing").glob("cabinpose-studio-*"))
