"""The bench of live runs: the time around the network, from the camera's frame to joints in its image."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks import Say
from cabinpose.app.live.feed import batch_of
from cabinpose.estimate.onnx_model import OnnxModel
from cabinpose.estimate.predictor import load_model
from cabinpose.record.sources.tof.simulated import tof_frame
from cabinpose.synth import FrameMaker
from cabinpose.synth.config import SynthConfig

_DIFFERENT = 20  # frames that are generated; they come again and again
_WARM = 10


def run(*, frames: int, threads: int, say: Say) -> dict[str, Any]:
    """Frames of 352x287 as a camera gives them, through `in_car`.

    Parameters
    ----------
    frames
        Frames of the timed run.
    threads
        Threads of ONNX Runtime.
    say
        Called with what is being measured.

    Returns
    -------
    dict
        network_ms, own_ms: median and p95 of the time in the network, and of everything else from the frame to its joints ·
        ratio_p95: own over network.
    """
    say("generating frames")
    maker = FrameMaker(SynthConfig(), 0)
    images = [tof_frame(maker.make(index)[0]) for index in range(_DIFFERENT)]
    predictor = load_model("in_car", threads=threads)
    model = predictor.model
    assert isinstance(model, OnnxModel)
    outputs, inside = model.outputs, [0.0]

    def timed(seen: Any) -> Any:
        began = time.perf_counter()
        result = outputs(seen)
        inside[0] = time.perf_counter() - began
        return result

    model.outputs = timed  # type: ignore[method-assign]
    say(f"{frames} frames")
    network, own = [], []
    for number in range(_WARM + frames):
        began = time.perf_counter()
        predictor.predict(batch_of(images[number % len(images)]))
        if number >= _WARM:
            network.append(1e3 * inside[0])
            own.append(1e3 * (time.perf_counter() - began) - 1e3 * inside[0])
    figures: dict[str, Any] = {
        name: dict(zip(("median", "p95"), np.percentile(values, (50, 95)).tolist(), strict=True))
        for name, values in (("network_ms", network), ("own_ms", own))
    }
    return figures | {"ratio_p95": figures["own_ms"]["p95"] / figures["network_ms"]["p95"]}
