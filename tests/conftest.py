"""Fixtures that every room's tests share."""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import invalidate_caches
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import pytest

from cabinpose.app.cli import main
from cabinpose.core import registry
from cabinpose.store.convert import apart

REAL_DATA = "CABINPOSE_REAL_DATA"
_COMPILED = ("ezc3d", "pyxdf", "adtf_file")  # what these readers import when they read

# Workers of pytest fill the cores: a library's threads beside them only wait, and those of torch and OpenBLAS burn a core
# while they do. Libraries read this once, when they are loaded.
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """What is collected stays until the end: the garbage collector need not walk through it, while it grows or later.

    Nor through the rest every 700 objects: in command lines' tests that is a fifth of the processor time.
    """
    gc.set_threshold(20_000, 20, 20)
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(autouse=True, scope="session")
def one_thread() -> Iterator[None]:
    """The same for what asks for as many threads as there are cores, ONNX Runtime's among them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "cpu_count", lambda: 1)
        yield


@pytest.fixture(autouse=True, scope="session")
def readers_apart() -> Iterator[None]:
    """Readers of damaged files are forked off a small server: of this process, which has imported everything, a copy takes 0.2 s.

    `test_apart` forks, as users do.
    """
    if not sys.platform.startswith("linux"):
        yield
        return
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload([f"cabinpose.store.convert.{reader}" for reader in ("adtfdat", "c3d", "xdf")] + list(_COMPILED))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(apart, "multiprocessing", SimpleNamespace(get_context=lambda _: server))
        yield


@pytest.fixture
def real_data() -> Callable[[str], Path]:
    """`real_data("mocap/cmu_131_01.bvh")` is the file's path; skips without the variable, fails where a file is missing."""

    def find(name: str) -> Path:
        root = os.environ.get(REAL_DATA)
        if not root:
            pytest.skip(f"needs real data: set {REAL_DATA} to the folder that holds it ({name})")
        path = Path(root) / name
        if not path.exists():
            pytest.fail(f"{REAL_DATA} is set, but {path} does not exist", pytrace=False)
        return path

    return find


@pytest.fixture
def extension(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Installs, for one test, a package that offers things: `extension("acme", {"sources": {"a": "A"}}, "class A: ...")`.

    Its module has the package's name; `requires` are lines of its metadata.
    """
    folder = tmp_path / "extensions"
    folder.mkdir()
    modules = []

    def install(package: str, offers: Mapping[str, Mapping[str, str]], code: str, requires: Sequence[str] = ()) -> None:
        modules.append(package)
        (folder / f"{package}.py").write_text(code, encoding="utf-8")
        info = folder / f"{package}-1.0.dist-info"
        info.mkdir()
        needs = "".join(f"Requires-Dist: {each}\n" for each in requires)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n{needs}", encoding="utf-8")
        groups = (
            f"[cabinpose.{kind}]\n" + "".join(f"{name} = {package}:{thing}\n" for name, thing in things.items())
            for kind, things in offers.items()
        )
        (info / "entry_points.txt").write_text("".join(groups), encoding="utf-8")
        forget()

    def forget() -> None:
        """Nothing that was loaded under a name outlives the package that offered it, nor hides one that is installed now."""
        invalidate_caches()
        modules = [vars(module) for name, module in sys.modules.items() if name.startswith("cabinpose.")]
        for one in (*chain.from_iterable(names.values() for names in modules), *gc.get_objects()):  # the frozen, the others
            if type(one) is registry.Registry:
                one._loaded.clear()
        registry._installed.cache_clear()
        registry._offers.cache_clear()

    monkeypatch.syspath_prepend(folder)
    yield install
    monkeypatch.undo()
    forget()
    for module in modules:
        sys.modules.pop(module, None)


class Outcome(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """`run("info", folder)`: exit code, stdout and stderr of a command."""

    def call(*arguments: object) -> Outcome:
        try:
            code = main([str(a) for a in arguments])
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return call
