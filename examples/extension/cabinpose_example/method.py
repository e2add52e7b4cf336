"""A detector: it answers with the mean pose of the training frames, whatever it sees."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from cabinpose.estimate import ArrayMethod, Found, ViewSettings


class MeanSettings(ViewSettings):
    """The view that frames are resampled to, the places and the joints."""

    skeleton: Literal["cabinpose", "itop"] = "cabinpose"


class MeanMethod(ArrayMethod[MeanSettings]):
    """Fitted in one go; its model is an .npz file."""

    name = "mean"
    task = "joints"
    settings_type = MeanSettings

    def fit(self, settings: MeanSettings, frames: Sequence[Any], augment: Any, progress: Any, *, seed: int) -> dict[str, Any]:
        """Mean u, v (px in the view) and z (m) of every joint of every place."""
        joints = [np.where(frame.present[:, None, None], frame.joints, np.nan) for frame in frames]
        progress(1, 1, "the mean")
        return {"joints": np.nanmean(joints, axis=0)}

    def find(self, arrays: Any, settings: MeanSettings, seen: Any) -> Found:
        """The same answer for all N frames."""
        uvz = np.repeat(arrays["joints"][None].astype(np.float64), len(seen["depth"]), axis=0)
        sure = np.ones(uvz.shape[:-1])
        return Found(uvz[..., :2], settings.view.from_view(uvz), score=sure, presence=sure)

    def check(self, arrays: Any, settings: MeanSettings) -> None:
        """Refuse arrays that do not fit the settings."""
        if arrays["joints"].shape != (len(settings.slots), len(settings.joints), 3):
            raise ValueError("joints of another skeleton")


MEAN = MeanMethod()
