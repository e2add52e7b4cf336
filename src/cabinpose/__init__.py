"""Body pose of people in cars, seen by a Time-of-Flight camera: data, detectors, metrics."""

__all__ = ["__version__"]


def __getattr__(name: str) -> str:
    """`__version__`, looked up when it is asked for: the look-up takes longer than all else that `import cabinpose` does."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415 - see above

    try:
        return version("cabinpose")
    except PackageNotFoundError:  # a source tree that was never installed
        return "0.0.0"
