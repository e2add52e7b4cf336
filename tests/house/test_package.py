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
    assert not loaded & {"numpy", "numba", "xarray", "dask", "cv2", "torch"}
    assert done.stderr == ""
    assert list(tmp_path.iterdir()) == []


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
