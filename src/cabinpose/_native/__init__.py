"""The compiled kernels, one module a room: `from cabinpose._native import body`.

Two builds of the same sources lie here: one for processors with AVX2, one for any. The first that runs is taken;
`CABINPOSE_SIMD=baseline` or `avx2` names one. Results are the same bytes. What pip built for this machine alone is one of them.
`CABINPOSE_NATIVE` names a folder with other builds, for instance a sanitizer's.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

_VARIABLE, _FOLDER = "CABINPOSE_SIMD", "CABINPOSE_NATIVE"
_BUILDS = ("avx2", "baseline")


def _import(build: str) -> ModuleType:
    name = f"{__name__}.{build}"
    if _FOLDER not in os.environ:
        return importlib.import_module(name)
    for path in Path(os.environ[_FOLDER]).glob(f"{build}.*"):
        spec = importlib.util.spec_from_file_location(name, path)
        if spec is not None and spec.loader is not None:
            module = sys.modules[name] = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            return module
    raise ModuleNotFoundError(f"no {build} in {os.environ[_FOLDER]}", name=name)


def _cpu_has_avx2() -> bool:
    """What Linux says of this processor: where there is no baseline build to ask, or one by zig, which always denies it."""
    return (file := Path("/proc/cpuinfo")).exists() and "avx2" in file.read_text(encoding="utf-8").split()


def _load() -> tuple[str, ModuleType]:
    wanted = os.environ.get(_VARIABLE, "")
    if wanted not in ("", *_BUILDS):
        raise ImportError(
            f"{_VARIABLE}={wanted}: no such build\nhint: use {' or '.join(_BUILDS)}, or leave it unset", name=__name__
        )
    try:
        try:
            baseline = _import("_baseline")
        except ModuleNotFoundError:  # built for one machine alone, and it has AVX2
            if wanted == "baseline" or not _cpu_has_avx2():
                raise
            return "avx2", _import("_avx2")
    except ImportError as error:
        raise ImportError(
            f"the compiled kernels of cabinpose cannot be loaded: {error}\n"
            "hint: install a wheel for this processor and Python, or build one: `pip install .` with a C++20 compiler",
            name=__name__,
        ) from error
    runs = baseline.runs_here() or _cpu_has_avx2()
    if wanted == "baseline" or not (runs or wanted):
        return "baseline", baseline
    if not runs:
        raise ImportError(f"{_VARIABLE}=avx2: this processor has no AVX2\nhint: leave {_VARIABLE} unset", name=__name__)
    try:
        return "avx2", _import("_avx2")
    except ModuleNotFoundError:  # built for a processor of another family, or for one without AVX2
        return "baseline", baseline


SIMD, _build = _load()
for _name, _room in vars(_build).items():
    if isinstance(_room, ModuleType):
        globals()[_name] = sys.modules[f"{__name__}.{_name}"] = _room
