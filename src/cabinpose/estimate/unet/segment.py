"""The segmentation as it runs: a class for every pixel of a camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import FrameBatch, Part
from cabinpose.estimate.onnx_model import OnnxModel, cameras_of, slices, view_inputs


class OnnxSegmenter(OnnxModel):
    """A segmentation in an ONNX file that `cabinpose export --onnx` wrote."""

    task = "parts"

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts: the number n of a label image is `parts[n - 1]`."""
        return tuple(self.config.parts)

    def segment(self, frames: FrameBatch) -> NDArray[np.uint8]:
        """Label images (N, H, W) in the frames' own pixels: 0 = nobody, or outside the model's view, else 1 + the position of the
        part.
        """
        return np.concatenate([self._segment(frames, which) for which in slices(len(frames["depth"]))])

    def _segment(self, frames: FrameBatch, which: slice) -> NDArray[np.uint8]:
        cameras = cameras_of(frames, which)
        classes: NDArray[np.uint8] = self.run(view_inputs(frames, which, cameras, self.config.view, amplitude=False))
        result = np.zeros(frames["depth"][which].shape, np.uint8)
        for image, own, camera in zip(result, classes, cameras, strict=True):
            image[...] = self.config.view.to_source(own, camera)
        return result
