"""A source judged while it runs, by the rules that imports and `info` go by: its camera, its bodies, their stamps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from cabinpose.core import camera_objections, depth_doubt
from cabinpose.signals.recorded import Facts, Markers, Sample, SegmentPoses, ToFFrame
from cabinpose.signals.take_check import TakeCheck

WINDOW_S: Final = 5.0  # of bodies that are judged together


class LiveCheck:
    """Looks at the samples of one source as they come; what speaks against a camera or a body is said once."""

    def __init__(self) -> None:
        self._check = TakeCheck()
        self._camera: tuple[bytes, bytes, tuple[int, ...]] | None = None  # the last one that was looked at
        self._began_ns: int | None = None  # the window
        self._timed = True  # whether bodies have stamps of their device
        self._told: set[tuple[str, str] | str] = set()

    def look(self, sample: Sample) -> list[str]:
        """What is to be said now that a sample has come: what was seen, why it cannot or hardly can be, what to try."""
        told: list[str] = []
        for message in sample.messages:
            if isinstance(message, ToFFrame):
                told += self._of_camera(message)
            elif isinstance(message, Facts):
                self._check.told("", message)
            elif isinstance(message, SegmentPoses | Markers) and _is_whole(message):
                self._began_ns = sample.host_ns if self._began_ns is None else self._began_ns
                self._timed &= sample.device_ns is not None
                self._check.add("", sample.host_ns if sample.device_ns is None else sample.device_ns, message)
        if self._began_ns is not None and sample.host_ns - self._began_ns >= 1e9 * WINDOW_S:
            told += self.judged()
        return told

    def judged(self) -> list[str]:
        """What there is to say of the bodies since the last time; to be asked at the end of a take.

        Stamps and speeds are judged by the device's clock alone: what arrives over a network comes in bursts.
        """
        check, self._check, self._began_ns = self._check, self._check.renewed(), None
        told = []
        for body in check.bodies(stamps=self._timed):
            if body.doubts and (body.kind, body.subject) not in self._told:
                self._told.add((body.kind, body.subject))
                whose = f"{body.subject}: " if body.subject else ""
                told += [f"{whose}{doubt.words} ({doubt.hint})" for doubt in body.doubts]
        return told

    def _of_camera(self, frame: ToFFrame) -> Iterator[str]:
        """The camera of the first frame, and of each in which it is another one."""
        camera = frame.camera_k.tobytes(), frame.camera_dist.tobytes(), frame.depth.shape
        if camera == self._camera or not frame.depth.size:
            return
        self._camera = camera
        height, width = frame.depth.shape
        known, told = camera_objections(frame.camera_k, frame.camera_dist, width, height)
        if known is not None and (folded := depth_doubt(known, frame.depth_m())):
            told = (*told, folded)
        for words in told:
            if words not in self._told:
                self._told.add(words)
                yield f"the camera that it states: {words}"


def _is_whole(message: SegmentPoses | Markers) -> bool:
    """Whether the arrays fit the names: of others the writer says so."""
    count = len(message.names)
    turned = not isinstance(message, SegmentPoses) or np.shape(message.orientation_wxyz) == (count, 4)
    return count > 0 and np.shape(message.position_m) == (count, 3) and turned
