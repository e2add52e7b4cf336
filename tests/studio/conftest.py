from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cabinpose.app.cli import main

pytest.importorskip("nicegui", reason="needs the extra `studio`")
FRAMES = 6


@pytest.fixture(scope="session")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six generated frames of drivers and others, in three parts; read only."""
    folder = tmp_path_factory.mktemp("studio") / "generated"
    settings = ["scene.cars=[suv]", "output.frames_per_part=2"]
    assert main(["synth", "--out", str(folder), "--frames", str(FRAMES), "--seed", "3", *settings]) == 0
    return folder


@pytest.fixture
def dataset_folder(generated: Path, tmp_path: Path) -> Path:
    """A copy of the generated frames, to be labelled."""
    return Path(shutil.copytree(generated, tmp_path / "dataset"))


class Server:
    """A studio in a process of its own."""

    def __init__(self, *arguments: object) -> None:
        words = [sys.executable, "-m", "cabinpose", "studio", *map(str, arguments), "--port", "0"]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().strip()

    def kill(self) -> None:
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def stop(self) -> int:
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(timeout=20)


def _servers() -> Iterator[Callable[..., Server]]:
    """`start(dataset)`: a studio that is serving; it is killed at the end."""
    servers: list[Server] = []

    def begin(*arguments: object) -> Server:
        servers.append(Server(*arguments))
        return servers[-1]

    yield begin
    for server in servers:
        if server.process.poll() is None:
            server.kill()


start = pytest.fixture(name="start")(_servers)
start_for_module = pytest.fixture(name="start_for_module", scope="module")(_servers)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium; no longer than a module, for while its driver lives no test can run an event loop of its own."""
    if shutil.which("chromium") is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    from benchmarks.studio import chromium

    with playwright.sync_playwright() as driver:
        opened = chromium(driver)
        yield opened
        opened.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A browser's page; an error of a script fails the test."""
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    opened = context.new_page()
    errors: list[str] = []
    opened.on("pageerror", lambda error: errors.append(str(error)))
    opened.set_default_timeout(60_000)
    yield opened
    context.close()
    assert errors == []


@pytest.fixture(scope="session")
def predicted(generated: Path) -> Path:
    """What a packaged model finds in the generated frames; read only."""
    file = generated.with_name("generated.in_car.jsonl")
    assert main(["predict", str(generated), "--model", "in_car", "--out", str(file)]) == 0
    return file
