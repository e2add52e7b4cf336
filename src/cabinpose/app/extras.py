"""Optional dependencies: present, or an error that says how to install them."""

from __future__ import annotations

from importlib.util import find_spec
from types import MappingProxyType

from cabinpose.core import DependencyError

_MODULES = MappingProxyType(
    {
        "record": ("mcap", "mcap_protobuf", "foxglove_schemas_protobuf", "cv2"),
        "train": ("torch", "lightning", "onnx"),
        "bench": ("psutil",),
        "remote": ("grpc", "tritonclient"),
        "studio": ("nicegui",),
        "cluster": ("distributed",),
    }
)


def require(*extras: str) -> None:
    """Raise DependencyError where a module that these extras install is missing.

    Parameters
    ----------
    *extras
        Names of extras of the package: "record", "train", "bench", "remote", "studio", "cluster".

    Raises
    ------
    DependencyError
        Names the missing modules and the `pip install` that adds them.
    """
    missing = [name for extra in extras for name in _MODULES[extra] if find_spec(name) is None]
    if missing:
        wanted = ",".join(extras)
        raise DependencyError(
            f"this needs the extra '{wanted}': {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} not installed",
            hint=f"pip install 'cabinpose[{wanted}]'",
        )
