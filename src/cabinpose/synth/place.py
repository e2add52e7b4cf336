"""What a camera sees of an empty car from its place, and what speaks against the place."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cabinpose.core import Matrix, apply, invert
from cabinpose.scene import LABEL_ID
from cabinpose.scene.cabin import Cabin, SeatSetting
from cabinpose.scene.sensor import NoiseModel, Sensor, lens_maps, simulate
from cabinpose.synth.render import Rasteriser
from cabinpose.synth.streams import noise_rng

FEWEST_VALID = 0.5  # of the pixels
LEAST_OF_SEAT = 0.25  # of an occupant's places, from which on a seat counts as seen
# Parts that people sit on, hold and reach for.
_TOUCHED = [LABEL_ID[name] for name in ("seat", "headrest", "steering_wheel", "pedal", "console", "screen")]
_LEAST_OF_TOUCHED = 0.01  # of the pixels; below, and without a seat, a camera looks at a wall
_ROWS = 72  # of the image that is looked at, about
_WORTH_TELLING = 0.1  # share of the pixels that deliver nothing for one reason
_BEHIND_M = 0.03  # a place that is farther than the surface in its pixel by this is hidden: pixels are coarse
# Where head, shoulders, trunk and hands of an occupant are: m ahead of the torso line, to its left, up along it from the H-point.
_OCCUPANT = np.array(
    [(0.02, -0.06, 0.66), (0.02, 0.06, 0.66), (0.05, -0.2, 0.45), (0.05, 0.2, 0.45), (0.12, 0.0, 0.35), (0.12, 0.0, 0.2),
     (0.35, -0.2, 0.15), (0.35, 0.2, 0.15)]
)  # fmt: skip


@dataclass(frozen=True)
class PlaceReport:
    """What a camera sees of an empty car.

    car, view: which place · valid: share of the pixels in its image circle that deliver a depth · seats: by seat the share of the
    places of an occupant's head, shoulders, trunk and hands that are in the image, in range and behind nothing · doubts: what
    speaks against the place, in words · blind: whether it sees neither a seat nor anything that people hold or
    reach for.
    """

    car: str
    view: str
    valid: float
    seats: Mapping[str, float]
    doubts: tuple[str, ...]
    blind: bool = False

    @property
    def seen(self) -> tuple[str, ...]:
        """The seats that are seen."""
        return tuple(slot for slot, share in self.seats.items() if share >= LEAST_OF_SEAT)


def judge_place(
    cabin: Cabin,
    view: str,
    vehicle_from_camera: Matrix,
    sensor: Sensor,
    noise: NoiseModel,
    settings: Mapping[str, SeatSetting] | None = None,
) -> PlaceReport:
    """Look at an empty car from a place, with an image of about 72 rows.

    Parameters
    ----------
    cabin
        The car.
    view
        What the report calls the place.
    vehicle_from_camera
        (4, 4) where the camera is.
    sensor, noise
        What it delivers: pixels that see glass, or are out of range or too dark, are invalid.
    settings
        How the seats stand; default: as the car has them.
    """
    settings = settings or {}
    small, camera_from_vehicle = reduced(sensor), invert(vehicle_from_camera)
    surface = cabin.surface(settings)
    rendered = Rasteriser(small.camera, supersample=1).render(surface, camera_from_vehicle)
    depth = simulate(rendered.buffers, small, noise, rng=noise_rng(0, 0)).depth_m
    field = lens_maps(small, 1).field
    valid = float(np.isfinite(depth)[field].mean()) if field.any() else 0.0
    through = rendered.labels == LABEL_ID["glass"]
    near, far = sensor.range_m  # of depth, as the sensor takes it
    clean = rendered.depth_clean
    beyond = (clean > 0) & ~through & ((clean < near) | (clean > far))
    causes = {"glass": through, "nothing": clean == 0, f"what is beyond range_m {list(sensor.range_m)}": beyond}
    lost = {what: float(pixels[field].mean()) for what, pixels in causes.items()} if field.any() else {}

    backs = [seat.vehicle_from_back(cabin.setting(settings, slot)) for slot, seat in cabin.seats.items()]
    places = apply(camera_from_vehicle, np.concatenate([apply(back, _OCCUPANT) for back in backs]))
    uv = small.camera.project(places)
    looked_at = small.camera.contains(uv)
    u, v = np.rint(np.where(looked_at[:, None], uv, 0.0)).astype(int).T
    surface_z, label = clean[v, u], rendered.labels[v, u]
    hidden = (surface_z > 0) & (surface_z < places[:, 2] - _BEHIND_M)
    seen = looked_at & ~hidden & (places[:, 2] >= near) & (places[:, 2] <= far)
    seats = dict(zip(cabin.seats, seen.reshape(len(backs), -1).mean(axis=1).tolist(), strict=True))
    behind_glass = looked_at & hidden & (label == LABEL_ID["glass"])
    report = PlaceReport(cabin.name, view, valid, seats, ())
    told = []
    if behind_glass.sum() > max(seen.sum(), 1):
        told.append("it looks at the seats through glass, which a depth camera does not")
    if valid < FEWEST_VALID:
        why = ", ".join(f"{100 * share:.0f} % see {what}" for what, share in lost.items() if share >= _WORTH_TELLING)
        told.append(f"{100 * valid:.0f} % of its pixels deliver a depth{f' ({why})' if why else ''}")
    if not report.seen:
        told.append("it sees no seat")
    eye = vehicle_from_camera[:3, 3]
    outside = bool((eye < cabin.bounds[0]).any() or (eye > cabin.bounds[1]).any())
    if told and outside:  # a mesh may be no more than seats, and a place beside it a good one
        low, high = cabin.bounds.round(2).tolist()
        told.insert(0, f"it is outside of the car, which reaches from {low} to {high} m (x forward, y left, z up)")
    known = np.isin(surface.label, _TOUCHED).any()  # of own meshes nothing may be
    touched = float((np.isin(rendered.labels, _TOUCHED) & np.isfinite(depth))[field].mean()) if field.any() else 0.0
    return dataclasses.replace(report, doubts=tuple(told), blind=bool(known) and not report.seen and touched < _LEAST_OF_TOUCHED)


def reduced(sensor: Sensor) -> Sensor:
    """The same sensor with fewer and larger pixels, in about 72 rows."""
    factor = max(1, round(sensor.camera.height / _ROWS))
    radius = sensor.field_radius_px and sensor.field_radius_px / factor
    return sensor.model_copy(update={"camera": sensor.camera.binned(factor), "field_radius_px": radius})
