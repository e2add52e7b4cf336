"""Imports that happen when somebody asks: of optional packages, and of public names that have moved."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Mapping
from typing import Any

from cabinpose.core.errors import DependencyError


def optional_module(name: str, *, purpose: str, hint: str) -> Any:
    """The module `name`; raises DependencyError that says what needs it, why it cannot be imported and how to install it."""
    try:
        return importlib.import_module(name)
    except (ImportError, OSError, RuntimeError) as error:  # pylsl says with a RuntimeError that its library is not there
        top = name.partition(".")[0]
        absent = isinstance(error, ModuleNotFoundError) and error.name in {top, name}
        why = "is not installed" if absent else f"cannot be loaded: {error}"
        raise DependencyError(f"{purpose} needs the Python package {top}, which {why}", hint=hint) from error


def moved(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """`__getattr__` of a module from which public names have moved (see docs/upgrading.md).

    Parameters
    ----------
    module
        Its `__name__`.
    names
        By old name the new one with its module, "cabinpose.signals.Sample".
    """

    def get(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        place, _, new = names[name].rpartition(".")
        warnings.warn(f"{module}.{name} is {names[name]} now", DeprecationWarning, stacklevel=2)
        return getattr(importlib.import_module(place), new)

    return get
