"""Optional dependencies: present, or an error that says how to get them."""

from __future__ import annotations

from importlib.util import find_spec

from cabinpose.core.errors import DependencyError


def require(*modules: str, extra: str) -> None:
    """Raises DependencyError where one of the modules of an extra is not installed."""
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        one = "is" if len(missing) == 1 else "are"
        raise DependencyError(
            f"this needs the extra '{extra}': {', '.join(missing)} {one} not installed", hint=f"pip install 'cabinpose[{extra}]'"
        )
