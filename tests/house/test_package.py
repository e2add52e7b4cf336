"""The package as a whole: importing it does nothing else, and its promises about torch and the console script hold."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import entry_points, requires
from pathlib import Path

import pytest

import cabinpose


def test_import_has_no_side_effects(tmp_path: Path) -> None:
    """No output, no file, no heavy library: `import cabinpose` is a version number."""
    code = "import sys; before = set(sys.modules); import cabinpose; print(*{m.split('.')[0] for m in set(sys.modules) - before})"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True, text=True)
    loaded = set(done.stdout.split())
    assert not loaded & {"numpy", "xarray", "dask", "cv2", "torch"}
    assert done.stderr == ""
    assert list(tmp_path.iterdir()) == []


# What one kind of work needs and generating in one process does not.
_ELSEWHERE = {
    "DracoPy", "cv2", "dask", "distributed", "h5py", "llvmlite", "networkx", "numba", "onnxruntime", "pandas", "rich", "scipy",
    "torch", "trimesh", "tyro", "xarray", "zarr",
}  # fmt: skip


def _loaded(code: str) -> set[str]:
    """The modules in a fresh process after `code`."""
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print(*sys.modules, file=sys.stderr)"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return set(done.stderr.split())


def test_the_generator_loads_what_it_uses() -> None:
    assert not _loaded("import cabinpose.synth.generate") & _ELSEWHERE


def test_generating_in_one_process_loads_what_it_uses(tmp_path: Path) -> None:
    """The whole way to a dataset on disk, cars and rooms alike."""
    code = """
from pathlib import Path
from cabinpose.synth.config import SynthConfig, room_preset
from cabinpose.synth.generate import generate
for config in (SynthConfig(), room_preset()):
    generate(config, 1, Path({folder!r}) / config.scene.kind, workers=1)
"""
    assert not _loaded(code.format(folder=str(tmp_path))) & _ELSEWHERE


def test_models_here_load_nothing_of_models_on_servers() -> None:
    assert not {m for m in _loaded("import cabinpose.app.cli.predict") if m.split(".")[0] in {"grpc", "tritonclient"}}


def test_base_install_has_no_torch() -> None:
    base = [line for line in requires("cabinpose") or [] if "extra ==" not in line]
    assert base
    assert not any(line.startswith(("torch", "lightning", "mitsuba", "viser")) for line in base)


def test_console_script_exists() -> None:
    (script,) = entry_points(group="console_scripts", name="cabinpose")
    assert script.value == "cabinpose.app.cli:main"


def test_version_is_the_installed_one() -> None:
    assert cabinpose.__version__.count(".") == 2
    assert cabinpose.__version__ != "0.0.0"


_WITHOUT_EXTRAS = """
import importlib.metadata as metadata, re, sys
from importlib.machinery import PathFinder

def required(by_extra):
    of_kind = [r for r in metadata.requires("cabinpose") if ("extra ==" in r) == by_extra]
    return {re.split(r"[^A-Za-z0-9_.-]", r)[0].lower() for r in of_kind} - {"cabinpose"}

blocked = set()  # the top modules of what only extras bring
for distribution in metadata.distributions():
    if distribution.metadata["Name"].lower() in required(True) - required(False):
        files = [f for f in distribution.files or () if f.suffix in (".py", ".so") and ".." not in f.parts]
        blocked |= {f.parts[0].split(".")[0] for f in files}

class WithoutExtras(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in blocked else super().find_spec(name, path, target)

assert {"torch", "cv2", "mcap", "h5py", "pyarrow"} <= blocked, blocked
sys.meta_path[sys.meta_path.index(PathFinder)] = WithoutExtras
from cabinpose.app.cli import main
for line in sys.argv[1:]:
    code = main(line.split())
    assert code == 0, (line, code)
"""


@pytest.mark.slow
def test_a_base_install_generates_looks_predicts_judges_and_exports(tmp_path: Path) -> None:
    """With everything blocked that only extras bring."""
    commands = (
        "synth --frames 2 --out data scene.cars=[suv]",
        "info data",
        "view data --out view --frames 1 --rows 1",
        "predict data --model in_car --out found.jsonl",
        "evaluate data --predictions found.jsonl --resamples 0",
        "export data --format coco --out coco",
        "config check kept.yaml",
    )
    (tmp_path / "kept.yaml").write_text("scene: {cars: [suv]}\n", "utf-8")
    done = subprocess.run(
        [sys.executable, "-c", _WITHOUT_EXTRAS, *commands], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["coco", "data", "found.jsonl", "kept.yaml", "view"]
