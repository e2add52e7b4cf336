"""Packages that are imported only when somebody asks for what they do."""

from __future__ import annotations

import importlib
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
