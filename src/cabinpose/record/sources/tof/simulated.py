"""A simulated ToF camera: the frames of a dataset, or of the generator as it makes them, at a camera's pace."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cabinpose.core import RecordingError, SourceEndedError
from cabinpose.record.emulate.base import log_line
from cabinpose.record.emulate.tof import EmulatedCamera, Frame, TofFaults
from cabinpose.record.sources.counting import FrameNumbers
from cabinpose.record.sources.tof.camera import CameraSettings, CameraSource, MalformedFrameError
from cabinpose.signals import FRAME_IMAGES, HostClock, Sample, ToFFrame
from cabinpose.store import open_dataset, read_manifest

DATASET_UNIT_M = 1e-4  # of the depth that a dataset stores
_KEPT_BYTES = 128 << 20  # frames of a dataset that small are read once, not in each loop
_IMAGES = ("depth", *FRAME_IMAGES, "camera_k", "camera_dist")


class SimulatedSettings(CameraSettings):
    """A simulated camera."""

    dataset: Path | None = Field(None, description="folder of the dataset whose frames it sees")
    faults: TofFaults = Field(default_factory=TofFaults, description="its rate, losses, delays and clock")
    loop: bool = Field(True, description="go on with the first frame after the last; otherwise the source ends")
    log: Path | None = Field(None, description="new file for what became of each frame (JSON lines), written when the take ends")


class SimulatedSource(CameraSource[SimulatedSettings]):
    """A `FrameSource` of frames as `frames()` gives them: mappings of the dataset standard's variables of one frame.

    depth: (H, W) float32 m, NaN = invalid, or uint16 in steps of 0.1 mm · amplitude, confidence: where there are any ·
    camera_k (3, 3), camera_dist (5,). `log` is the ground truth of what the camera did.
    """

    Settings: ClassVar[type[SimulatedSettings]] = SimulatedSettings

    def __init__(
        self, name: str, settings: SimulatedSettings, clock: HostClock, frames: Callable[[], Iterable[Frame]] | None = None
    ) -> None:
        super().__init__(name, settings, clock)
        self._frames = frames or self._frames_of_dataset
        self._given = frames is not None
        self._logging = False
        self._kept: list[Frame] = []
        self._numbers = FrameNumbers(self.counts)
        self.camera = EmulatedCamera(self._frames, settings.faults, clock, self._taken, settings.loop)

    def _read(self, timeout_s: float) -> Sequence[Sample]:
        """As the port says; SourceEndedError once the last frame was given."""
        ended = self.camera.ended
        samples = super()._read(0.0 if ended else timeout_s)
        if samples or not ended:
            return samples
        if (error := self.camera.error) is not None:
            raise RecordingError(f"the frames of {self.name} failed: {error}", hint=getattr(error, "hint", None)) from error
        raise SourceEndedError(f"{self.name} has given all its frames")

    def _missing(self) -> Sequence[str]:
        if not self._given:
            self._folder()
        return []

    def _folder(self) -> Path:
        folder = self.settings.dataset
        if folder is None:
            raise RecordingError(f"{self.name} has no frames to see", hint="name a dataset folder with `dataset`")
        read_manifest(folder)
        return folder

    def _connect(self) -> None:
        if not self._given:
            self._folder()
        self._begin_log()
        faults = self.settings.faults
        self._state("camera", vendor="simulated", rate_hz=faults.rate_hz, faults=faults.model_dump(exclude_defaults=True))
        self.camera.start()

    def _begin_log(self) -> None:
        """Make the file of the log; one that is there is not replaced."""
        if self.settings.log is None or self._logging:
            return
        try:
            self.settings.log.touch(exist_ok=False)
        except OSError as error:
            raise RecordingError(
                f"{self.name} cannot write {self.settings.log} ({error.strerror})", hint="name a new file with `log`"
            ) from error
        self._logging = True

    def _disconnect(self) -> None:
        self.camera.stop()
        if self.settings.log is not None and self._logging:
            lines = "".join(map(log_line, self.camera.log))
            with suppress(OSError):  # the take is over, and whole without it
                self.settings.log.write_text(lines, encoding="utf-8")

    def _alive(self) -> bool:
        return True  # `read` tells that the frames have ended; there is nothing to reach again

    def _taken(self, counter: int, device_ns: int, frame: Frame) -> None:
        self._deliver((counter, device_ns, frame))

    def _number(self, payload: tuple[int, int, Frame], host_ns: int) -> tuple[int, int | None]:
        del host_ns
        return self._numbers.number(payload[0]), payload[1]

    def _decode(self, payload: tuple[int, int, Frame]) -> ToFFrame:
        return tof_frame(payload[2])

    def _frames_of_dataset(self) -> Iterator[Mapping[str, Any]]:
        """The frames of the dataset once; from memory where all of them were kept the time before."""
        if self._kept:
            yield from self._kept
            return
        dataset = open_dataset(self._folder())
        present = dataset[[name for name in _IMAGES if name in dataset]]
        kept: list[Frame] | None = []
        room = _KEPT_BYTES
        for i in range(dataset.sizes["frame"]):
            frame = present.isel(frame=i) if "frame" in present.dims else present
            images = {str(name): frame[name].values for name in frame.data_vars}
            room -= sum(image.nbytes for image in images.values())
            if kept is not None and room >= 0:
                kept.append(images)
            else:
                kept = None
            yield images
        self._kept = kept or []


def tof_frame(frame: Mapping[str, Any]) -> ToFFrame:
    """A frame of a dataset as a camera's. Raises MalformedFrameError where it lacks depth or intrinsics."""
    try:
        depth, k = np.asarray(frame["depth"]), np.array(frame["camera_k"], dtype=np.float64)
    except KeyError as error:
        raise MalformedFrameError(f"a frame without {error}") from error
    if depth.ndim != 2 or k.shape != (3, 3):
        raise MalformedFrameError(f"depth {depth.shape}, camera_k {k.shape}")
    dist = np.array(frame.get("camera_dist", np.zeros(5)), dtype=np.float64)
    return ToFFrame(
        depth=_steps(depth),
        depth_unit_m=DATASET_UNIT_M,
        **{name: _image(frame, name, np.dtype(np.uint16), depth.shape) for name in ("amplitude", "noise", "balance")},
        confidence=_image(frame, "confidence", np.dtype(np.uint8), depth.shape),
        camera_k=k,
        camera_dist=dist,
        amplitude_dist=dist,
    )


def _steps(depth: NDArray[Any]) -> NDArray[np.uint16]:
    """Steps of a dataset's depth: floats are metres with NaN = invalid."""
    if depth.dtype == np.uint16:
        return depth
    steps = np.rint(np.nan_to_num(depth.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0) / DATASET_UNIT_M)
    return np.where((steps > 0) & (steps <= 65535), steps, 0).astype(np.uint16)


def _image(frame: Mapping[str, Any], name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    if name not in frame:
        return np.zeros((0, 0), dtype)
    image = np.asarray(frame[name])
    if image.shape != shape:
        raise MalformedFrameError(f"{name} {image.shape} beside depth {shape}")
    return image.astype(dtype)
