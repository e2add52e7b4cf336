"""What noise models have in common: effects that installed packages add to any of them, edges of depth, and the camera's filters.

Sources of the rule for edges: Basler's manual of the blaze (feature *Outlier Removal*: how many of the 8 neighbours have to
lie within a share of a pixel's own distance); libfreenect2's edge test of the Kinect v2 looks at the same neighbours, of which it
leaves out invalid ones. Both see decoded depth alone.
"""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from numpy.random import Generator
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, GetJsonSchemaHandler, SerializeAsAny
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from cabinpose.core import Bools, Floats32, Registry
from cabinpose.core import reproducible as rp
from cabinpose.scene.sensor.buffers import GeometryBuffers, SensorFrame
from cabinpose.scene.sensor.presets import Sensor

_EDGE_M = 0.03  # of the bilateral filter: neighbours that differ by more weigh little


class NoiseEffect(BaseModel, ABC):
    """What a package adds to the noise of a camera: subclass it with the effect's settings, all with defaults, and `apply`.

    `kind` is the name under which it is registered in the entry point group *cabinpose.noise_effects*; give it as a default.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: str = Field(description="Name of the effect.")

    @abstractmethod
    def apply(self, frame: SensorFrame, buffers: GeometryBuffers, sensor: Sensor, *, rng: Generator) -> None:
        """Change a frame in place, as the camera's own filters have not yet seen it.

        Parameters
        ----------
        frame
            What the noise model made; `invalidate` takes out pixels.
        buffers
            The true geometry of the view.
        sensor
            The camera.
        rng
            Source of the effect's noise, after the model's own; equal bits must give equal bytes.
        """


# Those of installed packages: effects of our own are settings of the noise models.
NOISE_EFFECTS: Registry[type[NoiseEffect]] = Registry("cabinpose.noise_effects", "noise effect", NoiseEffect, subclass=True)


def _of_kind(data: Any) -> Any:
    return NOISE_EFFECTS[str(data.get("kind"))].model_validate(data) if isinstance(data, Mapping) else data


class _Installed:
    """Says in a JSON schema which effects are installed."""

    def __get_pydantic_json_schema__(self, _schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        known = [handler(effect.__pydantic_core_schema__) for _, effect in NOISE_EFFECTS.items()]
        return {"oneOf": known} if known else {"not": {}}


class CameraNoise(BaseModel, ABC):
    """A noise model: its settings, and how a camera with such noise sees."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: str
    effects: tuple[Annotated[SerializeAsAny[NoiseEffect], BeforeValidator(_of_kind), _Installed()], ...] = Field(
        default=(),
        exclude_if=operator.not_,
        description="Effects of installed packages, in the order in which they act: {kind: NAME} and the effect's own settings.",
    )

    @abstractmethod
    def simulate(
        self, buffers: GeometryBuffers, sensor: Sensor, *, rng: Generator, exposures: Sequence[GeometryBuffers] = ()
    ) -> SensorFrame:
        """One frame of a camera, before effects of packages and its own filters; see `simulate` of the package."""

    def filter(self, frame: SensorFrame, buffers: GeometryBuffers, sensor: Sensor) -> None:  # noqa: ARG002
        """What the camera itself does to a frame in the end, in place: it smooths the depth as the sensor does."""
        if sensor.spatial_filter != "none":
            frame.depth_m[:] = smoothed(frame.depth_m, sensor)


class EdgeRule(CameraNoise):
    """What is an abrupt edge of depth, and whether its pixels are taken out: of noise models that know edges."""

    edge_threshold_m: float = Field(
        default=0.10, gt=0, description="Depth step that makes an abrupt edge (m); of `empirical` noise across two pixels."
    )
    edge_width_px: int = Field(
        default=1, ge=1, le=8, description="How far away the neighbours are by which edges are found (px)."
    )
    edge_tolerance: float = Field(
        default=0.05, gt=0, le=1, description="Of `remove_edges`: the same as a share of the depth; the smaller of both counts."
    )
    edge_neighbours: int = Field(
        default=7, ge=1, le=8, description="Of `remove_edges`: so many of the 8 neighbours have to be no farther off than that."
    )
    edge_holes: bool = Field(
        default=True, description="Of `remove_edges`: invalid neighbours are farther off too; off: they do not count."
    )
    remove_edges: bool = Field(
        default=False, description="Pixels with too few neighbours at their delivered depth are invalid, as cameras' filters do."
    )

    def filter(self, frame: SensorFrame, buffers: GeometryBuffers, sensor: Sensor) -> None:
        """Takes edges out, where they are to be, before anything else."""
        if self.remove_edges:
            invalidate(frame, edge_pixels(frame.depth_m, self))
        super().filter(frame, buffers, sensor)


def edge_pixels(depth: Floats32, rule: EdgeRule) -> Bools:
    """(H, W): where fewer neighbours than asked for lie near the depth (m, NaN = none); beyond the image's border it repeats."""
    reach = rule.edge_width_px
    height, width = depth.shape
    padded = np.pad(depth, reach, mode="edge")
    near = np.minimum(np.float32(rule.edge_threshold_m), np.float32(rule.edge_tolerance) * depth)
    far = np.zeros(depth.shape, np.uint8)
    for y in (0, reach, 2 * reach):
        for x in (0, reach, 2 * reach):
            if (y, x) != (reach, reach):
                off = np.abs(padded[y : y + height, x : x + width] - depth)
                far += ~(off <= near) if rule.edge_holes else off > near
    return np.asarray(far > 8 - rule.edge_neighbours)


def invalidate(frame: SensorFrame, where: Bools) -> None:
    """Make pixels (H, W) invalid, in place; their amplitude stays."""
    frame.depth_m[where] = np.nan
    frame.confidence[where] = 0
    frame.noise_m[where] = np.nan


def median_of_valid(depths: Floats32) -> Floats32:
    """(H, W) median of depths (N, H, W), without those that are NaN; NaN where the last one is."""
    ordered = np.sort(depths, axis=0)  # NaN last
    count = np.isfinite(depths).sum(axis=0)
    low, high = (
        np.take_along_axis(ordered, at[None], axis=0)[0] for at in (np.maximum(count - 1, 0) // 2, np.maximum(count, 1) // 2)
    )
    return np.where(np.isnan(depths[-1]), np.float32(np.nan), (low + high) / 2)


def smoothed(depth: Floats32, sensor: Sensor) -> Floats32:
    """Depth (H, W) through the sensor's spatial filter: of valid neighbours, and only where the pixel itself is valid."""
    size = sensor.spatial_px
    padded = np.pad(depth, size // 2, constant_values=np.nan)
    height, width = depth.shape
    beside = [padded[y : y + height, x : x + width] for y in range(size) for x in range(size)]
    if sensor.spatial_filter == "median":
        return median_of_valid(np.stack([*(b for i, b in enumerate(beside) if i != len(beside) // 2), depth]))
    total, weights = np.zeros(depth.shape, np.float32), np.zeros(depth.shape, np.float32)
    for neighbour in beside:
        weight = np.isfinite(neighbour).astype(np.float32)
        if sensor.spatial_filter == "bilateral":
            weight = np.nan_to_num(rp.exp(-0.5 * ((neighbour - depth) / np.float32(_EDGE_M)) ** 2))
        weights += weight
        total += weight * np.nan_to_num(neighbour)
    with np.errstate(invalid="ignore"):
        return np.where(np.isnan(depth), np.float32(np.nan), total / weights)
