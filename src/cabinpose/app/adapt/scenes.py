"""Scenes to learn from that the user's camera could have seen: its lens, its place where it is known, its noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cabinpose.app.adapt.facts import CameraFacts
from cabinpose.core import OCCUPANT_SLOTS, ConfigError
from cabinpose.scene.sensor import NoiseModel, PhysicalNoise, Sensor
from cabinpose.synth import (
    CabinScene,
    Camera,
    ExactCameraPose,
    FrameMaker,
    People,
    RandomPeople,
    SynthConfig,
)

TRIED: Final = 12  # frames that tell how noisy the sensor is as it stands
_CARS = ("city_car", "sedan", "suv", "van", "shuttle")  # those of the packaged models' training
_FRONT = ("driver", "front_row", "mirror", "roof_console", "cluster", "a_pillar", "display")
_TAKEN = 0.9  # share of the frames in which somebody drives
_OTHERS, _SELDOM = 0.5, 0.15  # and in which somebody sits in another place of the model, and in one that it does not know
_POSES = 4  # places of the camera that are told apart
_EDGES_OUT = 0.5  # of the mixed pixels of a camera without a filter: fewer, and the camera takes them out
_CIRCLE = 0.95  # of the way to the farthest corner: depths that end before end with the lens' image circle
_WEAKEST, _STRONGEST = 0.02, 50.0  # power of the fitted light over the preset's


class NoiseSource(NamedTuple):
    """What noise the scenes have. factor: of the light's power, fitted · words: where the noise is from."""

    factor: float
    words: str


def their_scenes(
    theirs: CameraFacts, reference: CameraFacts, slots: Sequence[str], *, base: SynthConfig | None = None,
    measured: SynthConfig | None = None, poses: NDArray[np.float64] | None = None, people: int = 100,
) -> SynthConfig:  # fmt: skip
    """The configuration of scenes that the user's camera could have seen.

    Parameters
    ----------
    theirs, reference
        What the user's frames are like, and those of a camera without a filter of mixed pixels.
    slots
        Places of the model.
    base
        Scenes of the user's: all but sensor and noise are taken from there.
    measured
        What `calibrate-noise` wrote; its sensor and noise are taken, with the lens of the frames.
    poses
        (N, 4, 4) vehicle_from_camera of frames; NaN where the place is not known.
    people
        How many random people there are.

    Raises
    ------
    ConfigError
        For a model of other places than those in cars.
    """
    if not set(slots) <= set(OCCUPANT_SLOTS):
        raise ConfigError(
            f"scenes are of people in cars, and the model looks at {', '.join(slots)}",
            hint="leave out --train: the report needs no scenes",
        )
    noise: NoiseModel = PhysicalNoise(remove_edges=bool(theirs.mixed < _EDGES_OUT * reference.mixed))
    low, high = theirs.depth_m[0], theirs.depth_m[2]
    lens = theirs.camera
    corner = np.hypot(max(lens.cx, lens.width - lens.cx), max(lens.cy, lens.height - lens.cy))
    field = theirs.field_px if theirs.field_px < _CIRCLE * corner else None
    sensor = Sensor(name="their_camera", camera=lens, range_m=(0.5 * low, 2 * high), field_radius_px=field)
    if measured is not None:
        noise = measured.noise
        if "sensor" in measured.camera.model_fields_set:  # not where the law of walls alone was fitted
            sensor = measured.camera.sensor_model.model_copy(update={"camera": lens, "field_radius_px": field})
    if base is not None:
        camera = base.camera.model_copy(update={"sensor": sensor})
        return base.model_copy(update={"camera": camera, "noise": noise})
    occupancy = dict.fromkeys(OCCUPANT_SLOTS, _SELDOM) | dict.fromkeys(slots, _OTHERS) | {"driver": _TAKEN}
    views: dict[str, Any] = {**_places(poses)} or dict.fromkeys(
        _FRONT + ("rear",) * any(slot.startswith("rear") for slot in slots), 1.0
    )
    return SynthConfig(
        scene=CabinScene(cars=_CARS, right_hand_drive=0.0, occupancy=occupancy, belted=0.85, in_hand=0.3),
        people=People(subjects=(), random=RandomPeople(count=people)),
        camera=Camera(sensor=sensor, views=views, jitter_m=0.03, jitter_deg=3.0),
        noise=noise,
    )


def _places(poses: NDArray[np.float64] | None) -> dict[str, ExactCameraPose]:
    """The places that frames say, at most `_POSES`, evenly spread over those that are known."""
    known = poses[np.isfinite(poses).all(axis=(1, 2))] if poses is not None else np.zeros((0, 4, 4))
    different = known[np.unique(known.round(3), axis=0, return_index=True)[1]] if len(known) else known
    rows = np.unique(np.linspace(0, len(different) - 1, min(_POSES, len(different))).astype(int)) if len(different) else ()
    return {f"theirs_{n + 1}": ExactCameraPose(vehicle_from_camera=different[row].tolist()) for n, row in enumerate(rows)}


def with_fitted_noise(config: SynthConfig, theirs: CameraFacts, seed: int) -> tuple[SynthConfig, NoiseSource]:
    """The scenes with so much light that what stands still is as noisy as in the user's frames.

    Shot noise: the variance of the depth goes with the inverse of the power. Thresholds of the amplitude and the full well go
    with it, so that the same pixels have a depth. Where nothing stands still in rows of frames, the noise stays what it is.
    """
    if config.noise.kind != "physical" or not len(theirs.still_m):
        why = "the measured law" if config.noise.kind != "physical" else "nothing stands still in rows of frames: the preset's"
        return config, NoiseSource(1.0, f"{config.noise.kind}, {why}")
    told = config.model_copy(update={"output": config.output.model_copy(update={"noise": True})})
    maker = FrameMaker(told, seed)
    depth, sigma = (np.concatenate(each) for each in zip(*(_sigma(maker.make(i)[0]) for i in range(TRIED)), strict=True))
    borders = np.concatenate(([0.0], (theirs.still_m[1:, 0] + theirs.still_m[:-1, 0]) / 2, [np.inf]))
    ratios = [
        float(np.median(sigma[some])) / at[1]
        for at, near, far in zip(theirs.still_m, borders[:-1], borders[1:], strict=True)
        if at[1] > 0 and (some := (depth >= near) & (depth < far)).sum() > 100
    ]
    if not ratios:
        return config, NoiseSource(1.0, "physical, generated frames have no depths where theirs have: the preset's")
    factor = float(np.clip(np.median(ratios) ** 2, _WEAKEST, _STRONGEST))
    sensor = config.camera.sensor_model
    fields = {name: factor * getattr(sensor, name) for name in ("signal_e_per_s", "min_amplitude_e", "full_well_e")}
    camera = config.camera.model_copy(update={"sensor": sensor.model_copy(update=fields)})
    words = f"physical, fitted to what stands still in the frames: {factor:.2g} times the light of the preset"
    return config.model_copy(update={"camera": camera}), NoiseSource(factor, words)


def _sigma(frame: dict[str, NDArray[np.float32]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depths and the sensor's own standard deviations of them, m, of the pixels that have both."""
    known = np.isfinite(frame["depth"]) & (frame["noise"] > 0)
    return frame["depth"][known].astype(np.float64), 1e-6 * frame["noise"][known].astype(np.float64)


def in_their_light(dataset: xr.Dataset, theirs: CameraFacts, ours: CameraFacts) -> xr.Dataset:
    """Generated frames with the amplitudes in the unit of the user's camera; as they are where either has none."""
    if not np.isfinite(theirs.light) or not np.isfinite(ours.light) or ours.light <= 0:
        return dataset
    most = np.iinfo(np.uint16).max
    scaled = np.minimum(dataset["amplitude"].values * (theirs.light / ours.light), most).round().astype(np.uint16)
    return dataset.assign(amplitude=(dataset["amplitude"].dims, scaled))
