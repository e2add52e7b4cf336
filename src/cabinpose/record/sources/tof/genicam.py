"""ToF cameras that speak GenICam (Basler blaze, Lucid Helios2, Vzense ...) through harvesters and the vendor's GenTL producer.

A buffer holds components, told apart by their data format: Coord3D_C16 or Coord3D_C32f (depth), Coord3D_ABC32f, _ABC16,
_ABCY16 (points, the last with the intensity), Mono8 and Mono16 (amplitude), Confidence8 and Confidence16; a second Mono image
is a confidence. Steps, offsets, unit and the mark of invalid pixels are read from the features of the standard (SFNC
Scan3d...), the intrinsics from those of the standard or of Lucid (Calib...), or else fitted to points.

The exposure is ExposureTime or, where a camera has a choice of few, ExposureTimeSelector (Exp1000Us); the rate is
AcquisitionFrameRate. Filters are features by their vendor's names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cabinpose.core import Camera, RecordingError, metres_of, optional_module
from cabinpose.record.sources.counting import FrameNumbers
from cabinpose.record.sources.tof.camera import (
    MalformedFrameError,
    depth_image,
    frame_of,
    rays_of_points,
    shaped,
)
from cabinpose.record.sources.tof.setup import AdjustableSource, CameraSetup, Control, FilterValue, RefusedError
from cabinpose.signals import HostClock, ToFFrame

_WHERE = "pip install harvesters, and name the camera vendor's GenTL producer (.cti) with `producer`"
_EXPOSURE = re.compile(r"Exp(\d+(?:_\d+)?)Us")
_COORDINATES = re.compile(r"Coord3D_(C|ABC|ABCY)(8|16s?|32f)$")
_BLOCK_IDS = 65535  # of GigE Vision 1: 16 bits of which 0 is no id
_MOST_COMPONENTS = 16
# What is recorded of a camera's set-up, where it has it: the standard's names, Basler's blaze, Lucid's Helios2.
_SETTINGS = (
    "AcquisitionFrameRate", "ExposureTime", "OperatingMode", "SpatialFilter", "TemporalFilter", "TemporalFilterStrength",
    "OutlierRemoval", "ConfidenceThreshold", "AmbiguityFilter", "Scan3dOperatingMode", "ExposureTimeSelector", "Scan3dHDRMode",
    "Scan3dImageAccumulation", "Scan3dSpatialFilterEnable", "Scan3dFlyingPixelsRemovalEnable", "Scan3dConfidenceThresholdMin",
)  # fmt: skip


class GenicamSettings(CameraSetup):
    """A camera that speaks GenICam."""

    cannot: ClassVar = {
        "modulation_hz": "the standard has no feature for it: set the vendor's own with `features`, such as OperatingMode"
    }
    producer: Path = Field(description="the vendor's GenTL producer, a .cti file")
    serial: str | None = Field(None, description="serial number, where several are connected")
    features: dict[str, FilterValue] = Field(
        default_factory=dict, description="features to set before the frames start, in this order, such as PixelFormat"
    )


@dataclass(frozen=True, slots=True)
class _Image:
    """A component, copied."""

    data_format: str
    width: int
    height: int
    values: NDArray[Any]


@dataclass(frozen=True, slots=True)
class _Buffer:
    """A frame, copied."""

    counter: int | None
    stamp_ns: int | None
    images: tuple[_Image, ...]


@dataclass(frozen=True)
class _Scale:
    """From transmitted coordinates A, B, C to metres: value * scale + offset; `invalid` marks a pixel without depth."""

    scale_m: tuple[float, float, float]
    offset_m: tuple[float, float, float]
    invalid: float | None


class GenicamSource(AdjustableSource[GenicamSettings]):
    """A `FrameSource` of a GenICam camera."""

    Settings: ClassVar = GenicamSettings

    def __init__(self, name: str, settings: GenicamSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        self._nodes: Any = None
        self._harvester: Any = None
        self._acquirer: Any = None
        self._errors: tuple[type[Exception], ...] = (RuntimeError, OSError, ValueError, IndexError)
        self._numbers = FrameNumbers(self.counts)
        self._block_turns = 0
        self._last_block = 0
        self._scale = _Scale((0.001,) * 3, (0.0,) * 3, 0.0)
        self._stated: Camera | None = None
        self._failed = False

    def _missing(self) -> Sequence[str]:
        harvester, _ = self._load()
        harvester.reset()
        return []

    def _load(self) -> tuple[Any, Any]:
        """A harvester that knows the camera, and the key to it. Raises DependencyError or RecordingError."""
        core = optional_module("harvesters.core", purpose="a GenICam camera", hint=_WHERE)
        gentl = optional_module("genicam.gentl", purpose="a GenICam camera", hint=_WHERE)
        self._errors = (gentl.GenericException, RuntimeError, OSError, ValueError, IndexError)
        producer = self.settings.producer
        if not producer.is_file():
            raise RecordingError(
                f"the GenTL producer {producer} does not exist", hint="install the vendor's SDK; it brings a .cti"
            )
        harvester = core.Harvester()
        try:
            harvester.add_file(str(producer))
            harvester.update()
            serials = [str(getattr(info, "serial_number", "")) for info in harvester.device_info_list]
        except self._errors as error:
            harvester.reset()
            raise RecordingError(f"{producer.name}: {error}", hint="is it the producer of this camera?") from error
        wanted = self.settings.serial
        if not serials or (wanted is not None and wanted not in serials):
            harvester.reset()
            hint = f"found: {', '.join(serials)}" if serials else "check its power, cable and network"
            raise RecordingError(f"no GenICam camera {wanted or ''} is connected".replace("  ", " "), hint=hint)
        return harvester, None if wanted is None else {"serial_number": wanted}

    def _connect(self) -> None:
        harvester, key = self._load()
        acquirer: Any = None
        errors: tuple[type[Exception], ...] = (*self._errors, AttributeError, RecordingError)
        try:
            acquirer = harvester.create(key)
            nodes = self._nodes = acquirer.remote_device.node_map
            self._set_up()
            self._scale, self._stated = _scale(nodes), _lens(nodes)
            acquirer.start()
        except errors as error:
            if acquirer is not None:
                acquirer.destroy()
            harvester.reset()
            if isinstance(error, RecordingError):  # a value that was refused
                raise
            raise RecordingError(f"the camera refuses to start: {error}", hint="check the values in `features`") from error
        self._harvester, self._acquirer, self._failed = harvester, acquirer, False
        self._state(
            "camera",
            **{k: _value(nodes, n) for k, n in (("vendor", "DeviceVendorName"), ("model", "DeviceModelName"))},
            serial=_value(nodes, "DeviceSerialNumber"),
            pixel_format=_value(nodes, "PixelFormat"),
            unit_m=self._scale.scale_m[2],
            settings={name: value for name in _SETTINGS if (value := _value(nodes, name)) is not None},
        )

    def _controls(self) -> Iterator[Control]:
        settings, nodes = self.settings, self._nodes
        for key, features in (("features", settings.features), ("filters", settings.filters)):
            for name, value in features.items():
                yield Control(f"{key}.{name}", value, partial(self._put, name), partial(_plain, nodes, name))
        yield Control("integration_us", settings.integration_us, self._expose, partial(_exposure, nodes))
        yield Control("frame_rate_hz", settings.frame_rate_hz, self._pace, partial(_plain, nodes, "AcquisitionFrameRate"))

    def _put(self, name: str, value: Any) -> None:
        errors: tuple[type[Exception], ...] = (*self._errors, AttributeError, TypeError)
        try:
            getattr(self._nodes, name).value = value
        except errors as error:
            raise RefusedError(str(error) or f"{name} cannot be set") from error

    def _expose(self, value: float) -> None:
        if _value(self._nodes, "ExposureAuto") is not None:
            self._put("ExposureAuto", "Off")
        choices = _choices(self._nodes)
        if not choices:
            self._put("ExposureTime", value)
        elif value in choices:
            self._put("ExposureTimeSelector", choices[value])
        else:
            raise RefusedError(f"the camera has {', '.join(f'{time:g}' for time in sorted(choices))}")

    def _pace(self, value: float) -> None:
        if _value(self._nodes, "AcquisitionFrameRateEnable") is not None:
            self._put("AcquisitionFrameRateEnable", True)
        self._put("AcquisitionFrameRate", value)

    def _remedy(self, names: Sequence[str]) -> str:
        wrong = [name for name in names if name.startswith("features.")]
        return f"check the names and values in `features`: {', '.join(wrong)}" if wrong else super()._remedy(names)

    def _disconnect(self) -> None:
        acquirer, harvester = self._acquirer, self._harvester
        self._acquirer = self._harvester = None
        for step in (acquirer.stop, acquirer.destroy, harvester.reset) if acquirer is not None else ():
            try:
                step()
            except self._errors:  # a camera that was unplugged
                continue

    def _alive(self) -> bool:
        return self._acquirer is not None and not self._failed and bool(self._acquirer.is_acquiring())

    def _wait(self, timeout_s: float) -> None:
        """Harvesters is asked for frames: the first within the time, then what has come meanwhile."""
        wait = timeout_s
        for _ in range(self.settings.queue_frames):
            if self._acquirer is None:
                self._clock.sleep(wait)
                return
            try:
                buffer = self._acquirer.try_fetch(timeout=max(wait, 1e-3))
                if buffer is None:
                    return
                with buffer:
                    payload = self._copied(buffer)
            except self._errors:
                self._failed = True
                return
            else:
                self._deliver(payload)
            wait = 0.0

    def _copied(self, buffer: Any) -> _Buffer:
        """A buffer, copied; without images where the network lost a part of it."""
        images: list[_Image] = []
        whole = not bool(getattr(buffer, "is_incomplete", False))
        for component in list(buffer.payload.components)[:_MOST_COMPONENTS] if whole else []:
            if component is None or component.data is None:  # a format that harvesters does not know
                continue
            try:
                width, height = int(component.width), int(component.height)
            except (TypeError, ValueError, OverflowError):  # not numbers: the size then fits no image, and the frame is malformed
                width = height = 0
            images.append(_Image(str(component.data_format), width, height, np.array(component.data)))
        return _Buffer(_quantity(buffer, "frame_id"), _quantity(buffer, "timestamp_ns"), tuple(images))

    def _number(self, payload: _Buffer, host_ns: int) -> tuple[int, int | None]:
        del host_ns
        if payload.counter is None:
            return self._numbers.forward(), payload.stamp_ns
        counter = payload.counter
        if self._last_block - counter > _BLOCK_IDS // 2 and self._last_block <= _BLOCK_IDS:
            self._block_turns += 1
        self._last_block = counter
        return self._numbers.number(counter + self._block_turns * _BLOCK_IDS), payload.stamp_ns

    def _reached_again(self) -> None:
        self._numbers.reached_again()
        self._block_turns = self._last_block = 0

    def _decode(self, payload: _Buffer) -> ToFFrame:
        found = [(match, image) for image in payload.images if (match := _COORDINATES.match(image.data_format))]
        if not found:
            raise MalformedFrameError(f"no depth among {[image.data_format for image in payload.images]}")
        match, image = found[0]
        channels = len(match[1])
        values = shaped(image.values, image.width, image.height, channels)
        c = values if channels == 1 else values[..., 2]
        valid = np.isfinite(c) if self._scale.invalid is None else np.isfinite(c) & (c != self._scale.invalid)
        mono = [i for i in payload.images if i.data_format in {"Mono8", "Mono16"}]
        confidence = next((i for i in payload.images if i.data_format in {"Confidence8", "Confidence16"}), None)
        if confidence is None and len(mono) > 1:
            confidence = mono[1]
        amplitude: NDArray[Any] | None = None
        if channels == 4:
            amplitude = values[..., 3]
        elif mono:
            amplitude = shaped(mono[0].values, mono[0].width, mono[0].height)
        sure = None if confidence is None else shaped(confidence.values, confidence.width, confidence.height)
        camera = self._lens(image.width, image.height, lambda: self._rays(values, valid), self._stated)
        scale, offset = self._scale.scale_m[2], self._scale.offset_m[2]
        if match[2] == "16" and offset == 0.0:  # the camera's own steps, without loss
            depth, unit = np.where(valid, c, 0).astype(np.uint16), scale
        else:
            unit = self.settings.depth_unit_m
            depth = depth_image(c.astype(np.float64) * scale + offset, valid, unit)
        return frame_of(camera, depth, unit, amplitude=amplitude, confidence=sure)

    def _rays(self, values: NDArray[Any], valid: NDArray[np.bool_]) -> NDArray[np.float64] | None:
        """The rays of an image of points; None where it has depth alone."""
        if values.ndim == 2:
            return None
        points = values[..., :3].astype(np.float64) * self._scale.scale_m + self._scale.offset_m
        return rays_of_points(points, valid & (points[..., 2] > 0))


def _quantity(buffer: Any, name: str) -> int | None:
    """A number that the producer may not know."""
    try:
        value = getattr(buffer, name)
    except Exception:  # noqa: BLE001 - producers raise whatever their vendor chose for what they do not know
        return None
    return None if value is None else int(value)


def _value(nodes: Any, name: str) -> Any:
    """The value of a feature; None where the camera does not have it or does not tell."""
    try:
        return getattr(nodes, name).value
    except Exception:  # noqa: BLE001 - as above
        return None


def _plain(nodes: Any, name: str) -> FilterValue | None:
    """The value of a feature as plain data; None where the camera does not tell."""
    value = _value(nodes, name)
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def _choices(nodes: Any) -> dict[float, str]:
    """The exposures that a camera has, µs, by the entries of ExposureTimeSelector; none where it takes any time."""
    try:
        entries = [str(entry) for entry in nodes.ExposureTimeSelector.symbolics]
    except Exception:  # noqa: BLE001 - as above
        return {}
    found = ((entry, _EXPOSURE.fullmatch(entry)) for entry in entries)
    return {float(match[1].replace("_", ".")): entry for entry, match in found if match}


def _exposure(nodes: Any) -> FilterValue | None:
    """What the camera exposes a phase for, µs; None where it does not tell."""
    names = {entry: time for time, entry in _choices(nodes).items()}
    return names.get(str(_value(nodes, "ExposureTimeSelector"))) if names else _plain(nodes, "ExposureTime")


def _selected(nodes: Any, selector: str, entry: str, name: str) -> Any:
    """The value of a feature for an entry of its selector."""
    try:
        getattr(nodes, selector).value = entry
    except Exception:  # noqa: BLE001 - as above
        return None
    return _value(nodes, name)


def _scale(nodes: Any) -> _Scale:
    """Steps and offsets of the three coordinates, from the features of the standard; millimetres without offset otherwise."""
    unit = metres_of(str(_value(nodes, "Scan3dDistanceUnit"))) or 0.001
    scales, offsets = [], []
    for letter in "ABC":
        selected = [_selected(nodes, "Scan3dCoordinateSelector", f"Coordinate{letter}", n) for n in _SCALE_FEATURES]
        scales.append(unit * float(1.0 if selected[0] is None else selected[0]))
        offsets.append(unit * float(selected[1] or 0.0))
    flagged = _value(nodes, "Scan3dInvalidDataFlag")
    mark = _value(nodes, "Scan3dInvalidDataValue")
    invalid = None if flagged is False else float(mark or 0.0)
    return _Scale((scales[0], scales[1], scales[2]), (offsets[0], offsets[1], offsets[2]), invalid)


_SCALE_FEATURES = ("Scan3dCoordinateScale", "Scan3dCoordinateOffset")


def _lens(nodes: Any) -> Camera | None:
    """The intrinsics that the camera states: Lucid's Calib..., else the standard's Scan3d... (of undistorted images)."""
    lucid = [_value(nodes, f"Calib{n}") for n in ("FocalLengthX", "FocalLengthY", "OpticalCenterX", "OpticalCenterY")]
    if None not in lucid and lucid[0]:
        names = ("CalibLensDistortionValueSelector", "CalibLensDistortionValue")
        k1, k2, p1, p2, k3 = (float(_selected(nodes, names[0], f"Value{i}", names[1]) or 0.0) for i in range(5))
        return Camera(1, 1, float(lucid[0]), float(lucid[1]), float(lucid[2]), float(lucid[3]), (k1, k2, p1, p2, k3))
    f, u, v = (_value(nodes, f"Scan3d{n}") for n in ("FocalLength", "PrincipalPointU", "PrincipalPointV"))
    if f and u is not None and v is not None:
        return Camera(1, 1, float(f), float(f), float(u), float(v))
    return None
