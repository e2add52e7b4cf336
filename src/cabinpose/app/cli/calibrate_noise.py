"""`cabinpose calibrate-noise`: fit the noise of a camera to frames of a flat wall."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional

from cabinpose.app.cli.arguments import Maybe, PrintsJson, is_recording, refuse_existing, several
from cabinpose.app.cli.output import print_json, print_rows, print_table, progress
from cabinpose.app.extras import require
from cabinpose.core import ConfigError, DatasetError, RecordingError, write_together

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cabinpose.core import Camera
    from cabinpose.scene.sensor import EmpiricalFit, Estimate, PhysicalFit, Sensor, Wall

    Frames = Iterator[tuple[NDArray[Any], NDArray[Any] | None]]

_SAME_LENS = 0.01  # of the focal length, by which intrinsics of one camera may differ
_LOOKED, _FILLED = 20, 0.1  # frames in which the step of the depth is looked for, and the share of pixels that they need
_FILES = ("empirical.yaml", "physical.yaml", "fit.json", "index.html")


@dataclass(frozen=True, kw_only=True)
class CalibrateNoise(PrintsJson):
    """Fit the noise of a camera to frames of a flat, matt wall at three or more distances, about a hundred frames of each.

    Writes configurations for `synth` with the measured law (empirical.yaml) and with the figures of the sensor's pixels
    (physical.yaml), the fit with its residuals (fit.json) and a page (index.html).
    """

    walls: Annotated[Positional[tuple[Path, ...]], several("DATASET|RECORDING [DATASET|RECORDING ...]")]
    """Recordings or datasets of the wall: one for each distance, or with frames of several."""
    out: Path
    """Folder of the results."""
    sensor: Annotated[Maybe[str], several("NAME|FILE")] = None
    """Preset, or configuration (YAML) whose camera.sensor it is: its modulation frequencies, integration time and contrast.
    Without it the measured law alone is fitted."""
    distances: Annotated[tuple[float, ...], several("M [M ...]")] = ()
    """Measured distance of each file's wall along the optical axis, m; default: of the plane through its depths."""
    reflectance: float = 0.75
    """Of the wall, at the camera's wavelength."""
    dark: bool = False
    """There was no other light: noise that is not of the signal is read noise, not ambient light."""
    source: Maybe[str] = None
    """Camera of the recordings, if they have several."""
    overwrite: bool = False
    """Replace the results in the folder."""


COMMAND = CalibrateNoise


def run(command: CalibrateNoise) -> None:
    """Read the walls, fit, write the results and print them."""
    from cabinpose.scene.sensor import check_distances, fit_empirical, fit_physical

    if not command.walls:
        raise ConfigError("there is no wall to look at", hint="name recordings or datasets of a flat wall")
    if command.distances and len(command.distances) != len(command.walls):
        raise ConfigError(
            f"{len(command.distances)} distances for {len(command.walls)} files", hint="give one distance for each file, in order"
        )
    if not 0 < command.reflectance <= 1 or not all(distance > 0 for distance in command.distances):
        raise ConfigError(
            "distances and the wall's reflectance are positive, and that is 1 at most",
            hint="give distances in metres, reflectance as 0..1",
        )
    refuse_existing(command.out, *_FILES, overwrite=command.overwrite)
    sensor = None if command.sensor is None else _sensor(command.sensor)
    walls: list[Wall] = []
    with progress(len(command.walls), "files") as report:
        for index, path in enumerate(command.walls):
            report(index, path.name)
            walls += _walls(path, command, sensor, command.distances[index] if command.distances else None)
    walls.sort(key=lambda wall: wall.distance_m)
    check_distances(walls)
    _check_one_camera(walls)
    empirical, physical, filters = fit_empirical(walls), None, []
    if sensor is not None:
        bare = sensor.unfiltered()
        filters = [name for name, value in sensor if value != getattr(bare, name)]
        sensor = _as_recorded(bare, walls[0].camera)
        if sensor.principle == "time_of_flight":
            physical = fit_physical(walls, sensor, reflectance=command.reflectance, dark=command.dark)
            sensor = physical.sensor
    fit = _plain(walls, empirical, physical)
    _write(command.out, walls, sensor, empirical, physical, fit)
    if command.as_json:
        print_json({"out": str(command.out), **fit})
        return
    print_table(_rows(fit["walls"]), words=(0,))
    print()
    print_rows((name, _told(e)) for name, e in {**empirical.parameters, **(physical.parameters if physical else {})}.items())
    if physical is None:
        print("without a ToF camera's --sensor the figures of its pixels are not fitted", file=sys.stderr)
    for name in filters:
        print(f"{name} of --sensor is left out: the walls have been through it", file=sys.stderr)
    best = command.out / ("empirical.yaml" if physical is None else "physical.yaml")
    print(f"generate with it: cabinpose synth --config {best} --frames 10 --out DATASET", file=sys.stderr)


def _told(found: Estimate) -> str:
    return f"{found.value:.4g}  ({found.low:.4g} to {found.high:.4g})"


def _rows(walls: list[dict[str, Any]]) -> list[list[str]]:
    """A head and a line for each wall."""
    rows = [[name.replace("_", " ") for name in walls[0]]]
    return rows + [[f"{v:.2f}" if isinstance(v, float) else str(v) for v in wall.values()] for wall in walls]


def _sensor(name: str) -> Sensor:
    from cabinpose.scene.sensor import sensor_by_name
    from cabinpose.synth import SynthConfig

    if name.endswith((".yaml", ".yml")):
        return SynthConfig.load(Path(name)).camera.sensor_model
    return sensor_by_name(name)


def _as_recorded(sensor: Sensor, camera: Camera) -> Sensor:
    """A sensor with the lens of the walls, without what belongs to another lens."""
    lens: dict[str, Any] = {"camera": camera}
    if (camera.width, camera.height) != (sensor.camera.width, sensor.camera.height):
        lens["field_radius_px"] = None
    return sensor.model_copy(update=lens)


def _check_one_camera(walls: list[Wall]) -> None:
    """ConfigError for walls of cameras whose lenses differ."""
    import numpy as np

    first = walls[0]
    for wall in walls:
        one, other = first.camera, wall.camera
        if (one.width, one.height) != (other.width, other.height) or np.abs(one.k - other.k).max() > _SAME_LENS * one.fx:
            told = " and ".join(f"{c.width}x{c.height} px, fx {c.fx:.1f}" for c in (one, other))
            raise ConfigError(f"{first.name} and {wall.name} are of two cameras: {told}", hint="calibrate each by itself")


def _walls(path: Path, command: CalibrateNoise, sensor: Sensor | None, distance_m: float | None) -> list[Wall]:
    from cabinpose.scene.sensor import walls_of_frames

    if is_recording(path):
        require("record")
        camera, step_m, frames = _of_recording(path, command.source)
    else:
        camera, step_m, frames = _of_dataset(path)
    if camera is None and sensor is None:
        raise ConfigError(f"{path} does not know its camera's intrinsics", hint="--sensor names the camera")
    name = path.stem if is_recording(path) else path.name
    return walls_of_frames(frames, camera or sensor.camera, name=name, step_m=step_m, distance_m=distance_m)  # type: ignore[union-attr]


def _camera(k: NDArray[Any], dist: NDArray[Any], shape: tuple[int, ...]) -> Camera | None:
    import numpy as np

    from cabinpose.core import camera_from

    if not (np.isfinite(k).all() and k[0, 0] > 0):
        return None
    return camera_from(k, np.nan_to_num(dist), shape[1], shape[0])


def _of_recording(path: Path, source: str | None) -> tuple[Camera | None, float, Frames]:
    """Intrinsics, step of the depth (m) and frames of the camera of a recording."""
    from cabinpose.core import unknown_name
    from cabinpose.store.recording import Recording, tof_frames

    with Recording(path) as recording:
        cameras = recording.cameras
        if source is not None and source not in cameras:
            raise unknown_name("camera", source, cameras)
        if not cameras or (source is None and len(cameras) > 1):
            raise RecordingError(
                f"{path} has {len(cameras) or 'no'} ToF camera{'s' if len(cameras) > 1 else ''}",
                hint=f"--source names one of them: {', '.join(cameras)}"
                if cameras
                else "record the wall with `cabinpose record`",
            )
        chosen = source or cameras[0]
        _, first = next(tof_frames(recording, chosen))
    camera = _camera(first.camera_k, first.camera_dist, first.depth.shape)

    def frames() -> Frames:
        with Recording(path) as recording:
            for _, frame in tof_frames(recording, chosen):
                yield frame.depth_m(), frame.amplitude if frame.amplitude.size else None

    return camera, first.depth_unit_m, frames()


def _of_dataset(folder: Path) -> tuple[Camera | None, float, Frames]:
    """The same of a dataset."""
    from cabinpose.app.adapt.facts import step_of
    from cabinpose.store import DEPTH_SCALE_M, open_dataset

    data = open_dataset(folder)
    if "depth" not in data:
        raise DatasetError(f"{folder} has no depth", hint="give a dataset with depth images of a wall")
    shape, k = data["depth"].shape[1:], data["camera_k"].values
    if (abs(k - k[0]) > _SAME_LENS * k[0, 0, 0]).any():
        raise DatasetError(f"{folder} has frames of several cameras", hint="give a dataset of one camera")
    camera = _camera(k[0], data["camera_dist"][0].values, shape)
    amplitudes = data.get("amplitude")
    pairs = ((data["depth"][i].values, None if amplitudes is None else amplitudes[i].values) for i in range(data.sizes["frame"]))
    looked = (data["depth"][i].values for i in range(0, data.sizes["frame"], max(data.sizes["frame"] // _LOOKED, 1)))
    steps = filter(None, (step_of(depth) for depth in looked if (depth > 0).mean() > _FILLED))
    step_m = max(min(steps, default=0.0), DEPTH_SCALE_M)  # of images that were imported that of their own unit
    return camera, step_m, pairs


def _plain(walls: list[Wall], empirical: EmpiricalFit, physical: PhysicalFit | None) -> dict[str, Any]:
    """The fit as plain data."""
    listed = []
    for k, wall in enumerate(walls):
        row: dict[str, Any] = {"name": wall.name, "distance_m": wall.distance_m, "frames": wall.frames}
        row |= {"pixels": int(wall.used.sum()), "bias_mm": 1e3 * wall.bias_m, "flatness_mm": 1e3 * wall.flatness_m}
        row |= {"sigma_mm": 1e3 * float(empirical.sigma_m[k]), "empirical_mm": 1e3 * float(empirical.fitted_m[k])}
        listed.append(row if physical is None else row | {"physical_mm": 1e3 * float(physical.fitted_m[k])})
    fits = {"empirical": empirical} | ({"physical": physical} if physical is not None else {})
    return {"walls": listed, **{kind: {name: asdict(e) for name, e in fit.parameters.items()} for kind, fit in fits.items()}}


def _write(
    out: Path,
    walls: list[Wall],
    sensor: Sensor | None,
    empirical: EmpiricalFit,
    physical: PhysicalFit | None,
    fit: dict[str, Any],
) -> None:
    import yaml

    from cabinpose.app.finite import finite
    from cabinpose.app.report.noise import noise_page

    camera = {} if sensor is None else {"camera": {"sensor": sensor.model_dump(mode="json", exclude_none=True)}}
    texts = {"fit.json": json.dumps(finite(fit), allow_nan=False, indent=2) + "\n"}
    for kind, found in (("empirical", empirical), ("physical", physical)):
        if found is not None:
            configuration = {**camera, "noise": found.noise.model_dump(mode="json")}
            text = yaml.safe_dump(configuration, sort_keys=False, default_flow_style=None, width=130)
            texts[f"{kind}.yaml"] = f"# by `cabinpose calibrate-noise`, of {len(walls)} walls\n{text}"
    texts["index.html"] = noise_page(walls, empirical, physical)
    write_together(out, {name: texts[name] for name in reversed(_FILES) if name in texts})
    for name in set(_FILES) - texts.keys():
        (out / name).unlink(missing_ok=True)  # of an earlier fit
