"""Azure Kinect recordings (.mkv), as `k4arecorder` writes them, through PyAV.

Tracks: DEPTH and IR, big-endian uint16, depth in millimetres; IMU, blocks of 40 bytes; COLOR, which is left out. The
factory calibration is an attached JSON file: intrinsics in units of the sensor's width and height (1024x1024), of which a depth
mode shows a part, maybe binned. Time stamps are microseconds since the recording's start, which K4A_START_OFFSET_NS puts on the
device's clock. Source of the layout: the Azure Kinect Sensor SDK's record library and its `intrinsic_transformation.c` (MIT).

The lens model is rational, (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶): five coefficients cannot say it. A camera
of five is fitted to the rays of the mode's field of illumination; the facts say what is left, and keep the factory's numbers.
"""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import RationalLens, RecordingError, fit_lens, optional_module
from cabinpose.signals import Facts, Message, SensorReadings, ToFFrame
from cabinpose.store.convert.format import RecordingFormat
from cabinpose.store.convert.rows import Entry, Row, epoch_ns

DEPTH_UNIT_M = 0.001
_LARGEST_CALIBRATION = 1 << 20
_MOST_WAITING = 32  # images without their partner, in a file whose time goes back
_IMU = struct.Struct("<Q3fQ3f")  # acceleration's time ns, m/s², angular velocity's time ns, rad/s


@dataclass(frozen=True)
class DepthMode:
    """The part of the sensor that a depth mode shows: binning, its first column and row (binned px), width and height.

    field: radius x²+y² = field² (normalised) of the rays that its illumination reaches, by its field of view.
    """

    binning: int
    left: int
    top: int
    width: int
    height: int
    field: float


# The depth camera's modes by their names in a file.
DEPTH_MODES: Mapping[str, DepthMode] = {
    "NFOV_2X2BINNED": DepthMode(2, 96, 90, 320, 288, 1.0),
    "NFOV_UNBINNED": DepthMode(1, 192, 180, 640, 576, 1.0),
    "WFOV_2X2BINNED": DepthMode(2, 0, 0, 512, 512, 1.74),
    "WFOV_UNBINNED": DepthMode(1, 0, 0, 1024, 1024, 1.74),
    "PASSIVE_IR": DepthMode(1, 0, 0, 1024, 1024, 1.74),
}
_SENSOR = 1024


class AzureFile:
    """An open recording: its calibration, and its messages in the order of the file.

    `malformed` counts packets left out, `alone` frames of depth or infrared without the other; `said` is what FFmpeg tells of
    damage, which it goes past.

    Raises DependencyError without PyAV, RecordingError where the file is no recording of depth or infrared.
    """

    def __init__(self, path: Path) -> None:
        av = optional_module("av", purpose="an Azure Kinect recording", hint="pip install av")
        self.path = path
        self.malformed = self.alone = 0
        self.said: list[str] = []
        self._av = av
        self._created_ns = 0  # where the file does not tell
        try:
            with self._listening():
                self._container = av.open(str(path))
        except (OSError, ValueError, av.FFmpegError) as error:
            raise RecordingError(f"cannot read {path}: {error}", hint="an Azure Kinect recording is a Matroska file") from error
        try:
            self._tracks = {key: stream for stream in self._container.streams for key in _TRACKS if _is_track(stream, key)}
            if "DEPTH" not in self._tracks and "IR" not in self._tracks:
                raise RecordingError(f"{path} has neither depth nor infrared", hint="record with a depth mode")
            self.tags = {str(k): str(v) for k, v in self._container.metadata.items()}
            self._start_ns = _whole(self.tags.get("K4A_START_OFFSET_NS"), 0)
            with suppress(ValueError):
                self._created_ns = epoch_ns(self.tags.get("creation_time", ""))
            mode = next((m for m in self._modes() if m in DEPTH_MODES), None)
            if mode is None:
                raise RecordingError(f"{path}: unknown depth mode", hint=f"known: {', '.join(DEPTH_MODES)}")
            self.mode = DEPTH_MODES[mode]
            self.calibration = self._calibration()
            self.lens = rational_lens(self.calibration, self.mode)
            self.fit = fit_lens(self.lens, self.mode.width, self.mode.height, self.mode.field)
        except (RecordingError, ValueError, KeyError, TypeError, IndexError, OverflowError, RecursionError) as error:
            self.close()
            if isinstance(error, RecordingError):
                raise
            raise RecordingError(f"{path}: its calibration is damaged: {error}", hint="copy the file again") from error

    def close(self) -> None:
        """Close the file."""
        self._container.close()

    def __enter__(self) -> AzureFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def facts(self) -> Facts:
        """The camera: its serial, mode, the factory's calibration, and how well the fitted camera meets it."""
        return Facts(
            "camera",
            {
                "vendor": "Azure Kinect",
                "serial": self.tags.get("K4A_DEVICE_SERIAL_NUMBER", ""),
                "tags": self.tags,
                "depth_mode": next(name for name, mode in DEPTH_MODES.items() if mode is self.mode),
                "fit_rms_px": self.fit.rms_px,
                "fit_max_px": self.fit.max_px,
                "fit_field": self.mode.field,
                "calibration": self.calibration,
            },
        )

    def rows(self) -> Iterator[Row]:
        """Facts, then frames and inertial readings. Depth and infrared of one time stamp make one frame.

        host_ns: the file's creation time, whole seconds, and the time since its start · device_ns: the device's clock.
        """
        yield self._created_ns, self._start_ns, self.facts()
        waiting: dict[int, dict[str, NDArray[np.uint16]]] = {}
        keys = {stream.index: key for key, stream in self._tracks.items()}
        wanted = {key for key in ("DEPTH", "IR") if key in self._tracks}
        try:
            for packet in self._packets():
                if not packet.size or packet.pts is None:
                    continue  # the end of a track
                since_ns = round(packet.pts * packet.time_base * 1_000_000_000)
                key, data = keys[packet.stream.index], bytes(packet)
                if key == "IMU":
                    yield from self._inertial(data)
                elif (image := self._image(data)) is not None:
                    waiting.setdefault(since_ns, {})[key] = image
                    many = len(waiting) > _MOST_WAITING
                    for time_ns in sorted(t for t, images in waiting.items() if many or t < since_ns or wanted <= images.keys()):
                        self.alone += not wanted <= waiting[time_ns].keys()
                        yield self._stamped(time_ns, self._frame(waiting.pop(time_ns)))
        except self._av.FFmpegError as error:
            raise RecordingError(f"{self.path} is damaged: {error}", hint="what precedes the damage was read") from error
        self.alone += sum(not wanted <= images.keys() for images in waiting.values())
        for time_ns in sorted(waiting):
            yield self._stamped(time_ns, self._frame(waiting[time_ns]))

    def _packets(self) -> Iterator[Any]:
        """The packets of all tracks."""
        packets = self._container.demux(list(self._tracks.values()))
        while True:
            with self._listening():
                packet = next(packets, None)
            if packet is None:
                return
            yield packet

    @contextmanager
    def _listening(self) -> Iterator[None]:
        """Keep in `said` what FFmpeg calls an error within the block: it goes on after most."""
        log = self._av.logging
        before = log.get_level(), log.get_skip_repeated()
        log.set_level(log.ERROR)
        log.set_skip_repeated(False)  # of the file before, too
        try:
            with log.Capture() as told:
                yield
        finally:
            log.set_level(before[0])
            log.set_skip_repeated(before[1])
            self.said += [text.strip() for _, _, text in told]

    def _stamped(self, since_ns: int, message: Message) -> Row:
        return self._created_ns + since_ns, self._start_ns + since_ns, message

    def _modes(self) -> list[str]:
        modes = [str(stream.metadata.get("K4A_DEPTH_MODE", "")) for stream in self._tracks.values()]
        return [*modes, "PASSIVE_IR"] if "DEPTH" not in self._tracks else modes

    def _calibration(self) -> dict[str, Any]:
        for stream in self._container.streams:
            if stream.type == "attachment" and stream.metadata.get("filename") == "calibration.json":
                data = bytes(stream.data or b"")
                if len(data) > _LARGEST_CALIBRATION:
                    raise ValueError(f"{len(data)} bytes")
                return dict(json.loads(data.rstrip(b"\0")))
        raise KeyError("calibration.json")

    def _image(self, data: bytes) -> NDArray[np.uint16] | None:
        width, height = self.mode.width, self.mode.height
        if len(data) != 2 * width * height:
            self.malformed += 1
            return None
        return np.frombuffer(data, ">u2").reshape(height, width).astype(np.uint16)

    def _frame(self, images: Mapping[str, NDArray[np.uint16]]) -> ToFFrame:
        none = np.zeros((0, 0), np.uint16)
        camera, dist = self.fit.camera, np.array(self.fit.camera.dist)
        return ToFFrame(
            depth=images.get("DEPTH", none),
            depth_unit_m=DEPTH_UNIT_M,
            amplitude=images.get("IR", none),
            confidence=np.zeros((0, 0), np.uint8),
            camera_k=camera.k,
            camera_dist=dist,
            amplitude_dist=dist,
        )

    def _inertial(self, data: bytes) -> Iterator[Row]:
        """Acceleration and angular velocity, in the frame of the inertial sensor."""
        if len(data) % _IMU.size:
            self.malformed += 1
            return
        for values in _IMU.iter_unpack(data):
            if not np.isfinite(values).all():
                self.malformed += 1
                continue
            device_ns = int(values[0])
            reading = SensorReadings(
                "", ("imu",), np.zeros((0, 4)), np.array([values[1:4]]), np.array([values[5:8]]), np.zeros((0, 3))
            )
            yield self._created_ns + device_ns - self._start_ns, device_ns, reading


def read_azure_mkv(path: Path) -> Iterator[Row]:
    """The messages of a recording: facts on the camera, frames, inertial readings.

    Raises DependencyError or RecordingError; warns of damage that was gone past, and of what was left out.
    """
    with AzureFile(path) as file:
        yield from file.rows()
        notes = {
            f"is damaged, and what could not be read is left out: {'; '.join(dict.fromkeys(file.said))}": len(file.said),
            f"has {file.malformed} packets that are no images or readings of its mode; they are left out": file.malformed,
            f"has {file.alone} frames with depth or infrared alone": file.alone,
        }
        for note, count in notes.items():
            if count:
                warnings.warn(f"{path} {note}", stacklevel=2)


@dataclass(frozen=True, kw_only=True)
class AzureMkvImport:
    """How a recording of an Azure Kinect is read."""

    name: str = "tof"
    """Name of the source."""


class AzureMkvFormat(RecordingFormat):
    """Recordings of an Azure Kinect."""

    import_options = AzureMkvImport

    def read(self, path: Path, options: AzureMkvImport, _: Sequence[str]) -> Iterator[Entry]:
        """As `read_azure_mkv`."""
        return ((options.name, *row) for row in read_azure_mkv(path))


AZURE_MKV = AzureMkvFormat()


def rational_lens(calibration: Mapping[str, Any], mode: DepthMode) -> RationalLens:
    """The depth camera's lens in pixels of a mode. Raises ValueError, KeyError or TypeError for what is no calibration."""
    cameras = calibration["CalibrationInformation"]["Cameras"]
    camera = next(c for c in [*cameras, None] if c is None or c["Location"] == "CALIBRATION_CameraLocationD0")
    if camera is None:
        raise KeyError("CALIBRATION_CameraLocationD0")
    intrinsics = camera["Intrinsics"]
    values = [float(v) for v in intrinsics["ModelParameters"]]
    if len(values) != 14 or not np.isfinite(values).all() or values[10] or values[11]:
        raise ValueError(f"lens parameters {values}")
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = values
    size = _SENSOR / mode.binning
    return RationalLens(
        fx * size,
        fy * size,
        cx * size - mode.left - 0.5,  # the factory counts from the edge of the first pixel, we from its centre
        cy * size - mode.top - 0.5,
        (k1, k2, k3, k4, k5, k6),
        p1,
        p2,
        1.0 if "Rational6KT" in str(intrinsics.get("ModelType")) else 2.0,
    )


_TRACKS = ("DEPTH", "IR", "IMU")


def _is_track(stream: Any, key: str) -> bool:
    """Tracks are named by a tag; recordings of other programs by their title alone."""
    tags = stream.metadata
    return f"K4A_{key}_TRACK" in tags or tags.get("title") == key


def _whole(text: str | None, default: int) -> int:
    try:
        return default if text is None else int(text)
    except ValueError:
        return default
