"""The package as a whole: importing it does nothing else, and its promises about torch and the console script hold."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import entry_points, requires
from pathlib import Path

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
