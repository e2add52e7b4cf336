"""Detectors of body pose: networks, their training, and running what was trained.

`FrameDataset` loads torch when it is first asked for: what runs a trained model does without.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cabinpose.estimate.frame_dataset import FrameDataset

__all__ = ["FrameDataset"]


def __getattr__(name: str) -> Any:
    if name != "FrameDataset":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from cabinpose.core.optional import optional_module  # noqa: PLC0415 - see above

    optional_module("torch", purpose="FrameDataset", hint="pip install 'cabinpose[train]'")
    from cabinpose.estimate.frame_dataset import FrameDataset  # noqa: PLC0415 - see above

    return FrameDataset
