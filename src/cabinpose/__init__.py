"""Body pose of people in cars, seen by a Time-of-Flight camera: data, detectors, metrics."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cabinpose.app.api import (
        evaluate_predictions,
        generate,
        load_model,
        open,  # noqa: A004 - as in api.py
        open_dataset,
        open_predictions,
        open_recording,
        sample,
    )

    __version__: str

__all__ = [
    "__version__", "evaluate_predictions", "generate", "load_model", "open", "open_dataset", "open_predictions", "open_recording",
    "sample",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """`__version__` and what `app.api` offers, looked up when it is asked for: so `import cabinpose` takes no time."""
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415 - see above

        try:
            return version("cabinpose")
        except PackageNotFoundError:  # a source tree that was never installed
            return "0.0.0"
    if name in __all__:
        from cabinpose.app import api  # noqa: PLC0415 - see above

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
