"""pmd cameras (pico flexx, pico monstar, flexx2) through Royale's Python layer, `roypy`.

Royale delivers points in metres that are free of the lens' distortion, in the order of the sensor's pixels, and an
amplitude image of the same pixels, which is not. Its newer versions give `DepthData.coordinates`, float32 (N, 4) x y z and
confidence 0..1, and `DepthData.amplitudes`, uint16; the older ones points x y z noise grey confidence (0..255), `npoints()`.
Time stamps are microseconds; Royale counts no frames, so losses are seen from the time between them.

The exposure can be set within the limits of the use case, and is read from the frames; the frame rate is a whole number, up to
the use case's. Filters are `FilterLevel` (Off, Full, Legacy ...) and Royale's processing parameters, which need access level 2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cabinpose.core import Camera, RecordingError, optional_module, pixel_error
from cabinpose.record.sources.counting import FrameNumbers, FramePeriod
from cabinpose.record.sources.tof.camera import depth_image, frame_of, rays_of_points, shaped
from cabinpose.record.sources.tof.setup import AdjustableSource, CameraSetup, Control, RefusedError
from cabinpose.signals import HostClock, ToFFrame

_WHERE = "it comes with pmd's Royale SDK, from pmd or the camera's seller: put the SDK's python folder on PYTHONPATH"
_POINTS_TO_COMPARE = 1000


class RoyaleSettings(CameraSetup):
    """A camera of pmd."""

    cannot: ClassVar = {"modulation_hz": "Royale sets it with the use case: choose one with `use_case`"}
    serial: str | None = Field(None, description="the camera's id, where several are connected")
    use_case: str | None = Field(None, description="operation mode, such as MODE_9_15FPS_700; otherwise the camera's own")


@dataclass(frozen=True, slots=True)
class _Points:
    """A frame of either layout: points (N, 3) m, confidence (N,) 0..1, amplitude (N,), device time µs; where it tells
    them, noise (N,) m and how long each phase was exposed, µs.
    """

    width: int
    height: int
    points: NDArray[np.floating]
    confidence: NDArray[np.floating]
    amplitude: NDArray[np.generic]
    stamp_us: int
    noise: NDArray[np.floating] | None = None
    exposures_us: tuple[int, ...] = ()


class RoyaleSource(AdjustableSource[RoyaleSettings]):
    """A `FrameSource` of a camera of pmd."""

    Settings: ClassVar = RoyaleSettings

    def __init__(self, name: str, settings: RoyaleSettings, clock: HostClock) -> None:
        super().__init__(name, settings, clock)
        self._camera: Any = None
        self._roypy: Any = None
        self._listener: Any = None
        self._numbers = FrameNumbers(self.counts)
        self._period = FramePeriod()
        self._stated: dict[str, float] = {}
        self._exposures_us: tuple[int, ...] = ()
        self._distorted: bool | None = None  # whether the points lie on the distorted rays of the lens; measured

    def _missing(self) -> Sequence[str]:
        roypy = _roypy()
        return (
            [] if self._chosen(roypy.CameraManager()) else ["no pmd camera is connected (connect it, and check its USB rights)"]
        )

    def _chosen(self, manager: Any) -> str | None:
        ids = _strings(manager.getConnectedCameraList())
        wanted = self.settings.serial
        if wanted is not None and wanted not in ids:
            raise RecordingError(f"no pmd camera {wanted} is connected", hint=f"connected: {', '.join(ids) or 'none'}")
        return wanted or (ids[0] if ids else None)

    def _connect(self) -> None:
        roypy = _roypy()
        manager = roypy.CameraManager()
        chosen = self._chosen(manager)
        if chosen is None:
            raise RecordingError("no pmd camera is connected", hint="connect it, and check its USB rights")
        try:
            camera = manager.createCamera(chosen)
            camera.initialize()
            use_cases = _strings(camera.getUseCases())
            wanted = self.settings.use_case
            if wanted is not None:
                if wanted not in use_cases:
                    raise RecordingError(f"camera {chosen} has no use case {wanted}", hint=f"known: {', '.join(use_cases)}")
                camera.setUseCase(wanted)
            self._camera, self._roypy = camera, roypy
            self._set_up()
            lens = camera.getLensParameters()
            self._stated = {key: float(lens[key]) for key in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")}
            rate = float(camera.getFrameRate()) if hasattr(camera, "getFrameRate") else 0.0
            self._period = FramePeriod(round(1e9 / rate) if rate > 0 else None)
            self._listener = self._make_listener(roypy)
            camera.registerDataListener(self._listener)
            camera.startCapture()
        except RecordingError:
            self._camera = None
            raise
        except (RuntimeError, SystemError, KeyError, IndexError) as error:  # how SWIG says that a call failed
            self._camera = None
            raise RecordingError(f"camera {chosen}: {error}", hint="is another program using it?") from error
        facts = {"id": chosen, "use_case": wanted or _current(camera), "use_cases": use_cases, "frame_rate_hz": rate or None}
        self._state("camera", vendor="pmd", **facts, lens=dict(self._stated))

    def _controls(self) -> Iterator[Control]:
        settings, camera = self.settings, self._camera
        told = partial(_told, camera)
        yield Control("integration_us", settings.integration_us, self._expose, lambda: None)  # frames tell what it is

        def put_rate(value: float) -> None:
            _take(camera, "setFrameRate", round(value))

        yield Control("frame_rate_hz", settings.frame_rate_hz, put_rate, lambda: told("getFrameRate"))
        for name, value in settings.filters.items():
            if name == "FilterLevel":
                level = "Off" if value is False else value  # as YAML reads Off
                yield Control("filters.FilterLevel", level, self._filter, self._filter_level)
            else:
                put = partial(self._parameter, name)
                yield Control(f"filters.{name}", value, put, partial(self._parameter_now, name))

    def _expose(self, value: float) -> None:
        """Expose by hand, within the limits of the use case."""
        limits = _told(self._camera, "getExposureLimits")
        if limits is not None and not limits.first <= value <= limits.second:
            raise RefusedError(f"the use case takes {limits.first} to {limits.second}")
        _take(self._camera, "setExposureMode", self._roypy.ExposureMode_MANUAL, 0)
        _take(self._camera, "setExposureTime", round(value), 0)

    def _filter(self, level: Any) -> None:
        number = getattr(self._roypy, f"FilterLevel_{level}", None)
        if number is None:
            known = sorted(name.removeprefix("FilterLevel_") for name in dir(self._roypy) if name.startswith("FilterLevel_"))
            raise RefusedError(f"this version of Royale knows {', '.join(known) or 'no filter levels'}")
        _take(self._camera, "setFilterLevel", number, 0)

    def _filter_level(self) -> str | None:
        number = _told(self._camera, "getFilterLevel", 0)
        names = (name for name in dir(self._roypy) if name.startswith("FilterLevel_"))
        return next((n.removeprefix("FilterLevel_") for n in names if getattr(self._roypy, n) == number), None)

    def _parameter(self, name: str, value: Any) -> None:
        there = _told(self._camera, "getProcessingParameters", 0)
        if there is not None and name not in there:
            raise RefusedError(f"the camera's parameters are {', '.join(sorted(there))}")
        if there is not None and isinstance(there[name], float):
            value = float(value)  # Royale tells whole numbers and others apart
        _take(self._camera, "setProcessingParameters", {name: value}, 0)

    def _parameter_now(self, name: str) -> Any:
        return (_told(self._camera, "getProcessingParameters", 0) or {}).get(name)

    def _make_listener(self, roypy: Any) -> Any:
        """Royale calls `onNewData` on a thread of its own, and frees the frame when it returns."""
        source = self

        class Listener(roypy.IDepthDataListener):  # type: ignore[misc]  # a class of the SDK, known when it is loaded
            def onNewData(self, data: Any) -> None:  # noqa: N802 - Royale's name
                source._arrived(data)

        return Listener()

    def _arrived(self, data: Any) -> None:
        try:
            payload = _copied(data)
        except (RuntimeError, ValueError, IndexError, TypeError, AttributeError, OverflowError):  # MalformedFrameError among them
            self.counts.malformed += 1
            return
        self._deliver(payload)

    def _disconnect(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            for stop in (camera.stopCapture, camera.unregisterDataListener):
                try:
                    stop()
                except (RuntimeError, SystemError):  # a camera that was pulled out cannot be stopped
                    continue
        self._listener = None

    def _alive(self) -> bool:
        camera = self._camera
        try:
            return camera is not None and bool(camera.isConnected())
        except (RuntimeError, SystemError):
            return False

    def _number(self, payload: _Points, host_ns: int) -> tuple[int, int | None]:
        del host_ns  # microseconds in 64 bits do not wrap
        device_ns = payload.stamp_us * 1000
        lost = self._period.lost_before(device_ns)
        if lost is None:
            self.counts.restarts += 1
        return self._numbers.forward(lost or 0), device_ns

    def _reached_again(self) -> None:
        self._period = FramePeriod()

    def _decode(self, payload: _Points) -> ToFFrame:
        width, height = payload.width, payload.height
        if payload.exposures_us != self._exposures_us:
            self._exposures_us = payload.exposures_us
            self._state("exposure", phases_us=list(payload.exposures_us))
            if payload.exposures_us:
                self._has("integration_us", max(payload.exposures_us))  # a phase that is read for the grey image is shorter
        points = shaped(payload.points, width, height, 3)
        confidence = shaped(payload.confidence, width, height)
        valid = (confidence > 0) & (points[..., 2] > 0)
        lens = self._stated
        dist = (lens["k1"], lens["k2"], lens["p1"], lens["p2"], lens["k3"])
        stated = Camera(width, height, lens["fx"], lens["fy"], lens["cx"], lens["cy"], dist)
        camera = self._lens(width, height, lambda: None, stated)
        bent = self._lies_on_lens(camera, points, valid)
        unit = self.settings.depth_unit_m
        amplitude = shaped(payload.amplitude, width, height)
        depth = depth_image(points[..., 2], valid, unit)
        noise = None if payload.noise is None else shaped(payload.noise, width, height)
        frame = frame_of(camera, depth, unit, amplitude=amplitude, confidence=confidence, noise_m=noise)
        return frame if bent else replace(frame, camera_dist=np.zeros(5))

    def _lies_on_lens(self, camera: Camera, points: NDArray[np.floating], valid: NDArray[np.bool_]) -> bool:
        """Whether a pixel's depth belongs to its ray through the lens, measured once on the points themselves.

        The points are free of distortion. In the order of the sensor's pixels, they lie on rays that the lens bends; a version
        that resamples them to a straight grid would not. The frames say which.
        """
        if self._distorted is None and np.count_nonzero(valid) >= _POINTS_TO_COMPARE:
            rays = rays_of_points(points, valid)
            bent, straight = pixel_error(camera, rays), pixel_error(replace(camera, dist=(0.0,) * 5), rays)
            self._distorted = bent <= straight
            self._state("depth_grid", distorted=self._distorted, error_px=bent, error_px_if_undistorted=straight)
        return self._distorted is not False


def _roypy() -> Any:
    """`roypy` as a module, or within a package of that name."""
    found = optional_module("roypy", purpose="a pmd camera", hint=_WHERE)
    if hasattr(found, "CameraManager"):
        return found
    return optional_module("roypy.roypy", purpose="a pmd camera", hint=_WHERE)


def _take(camera: Any, method: str, *values: Any) -> None:
    """Call a method that sets something. Raises RefusedError."""
    try:
        getattr(camera, method)(*values)
    except AttributeError as error:
        raise RefusedError(f"this version of Royale has no {method}") from error
    except (RuntimeError, SystemError, ValueError, TypeError, OverflowError) as error:  # how SWIG says that a call failed
        raise RefusedError(str(error) or method) from error


def _told(camera: Any, method: str, *values: Any) -> Any:
    """What a method tells; None where this version or this camera does not."""
    try:
        return getattr(camera, method)(*values)
    except (AttributeError, RuntimeError, SystemError, TypeError):
        return None


def _strings(vector: Any) -> list[str]:
    """A list of strings as SWIG wraps it."""
    return [str(vector[i]) for i in range(len(vector))]


def _current(camera: Any) -> str:
    """The use case that is set, where this version of Royale tells."""
    try:
        return str(camera.getCurrentUseCase())
    except (AttributeError, TypeError, RuntimeError):
        return ""


def _copied(data: Any) -> _Points:
    """A frame of either layout, copied."""
    width, height = int(data.width), int(data.height)
    exposures = tuple(int(t) for t in getattr(data, "exposureTimes", ()))
    coordinates = getattr(data, "coordinates", None)
    if coordinates is not None:
        values = np.array(shaped(np.asarray(coordinates, dtype=np.float32), width, height, 4)).reshape(-1, 4)
        with np.errstate(invalid="ignore", over="ignore"):
            amplitude = np.array(data.amplitudes, dtype=np.uint16).ravel()
        return _Points(width, height, values[:, :3], values[:, 3], amplitude, int(data.timeStamp), None, exposures)
    values = np.array(shaped(_old_points(data), width, height, 6)).reshape(-1, 6)
    grey = np.clip(np.nan_to_num(values[:, 4]), 0, 65535).astype(np.uint16)
    return _Points(width, height, values[:, :3], values[:, 5] / 255, grey, int(data.timeStamp), values[:, 3], exposures)


def _old_points(data: Any) -> NDArray[np.float64]:
    """(N, 6) of the older layout; point by point where `roypy` was built without numpy."""
    try:
        return np.asarray(data.npoints(), dtype=np.float64)
    except (AttributeError, RuntimeError):
        return np.array(
            [(p.x, p.y, p.z, p.noise, p.grayValue, p.depthConfidence) for p in data.points()], dtype=np.float64
        ).reshape(-1, 6)
