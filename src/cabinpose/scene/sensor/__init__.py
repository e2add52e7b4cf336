"""Depth cameras: presets, placement, and the noise models that turn rendered geometry into what a camera delivers."""

from cabinpose.scene.sensor.buffers import GeometryBuffers, SensorFrame
from cabinpose.scene.sensor.empirical import EmpiricalNoise
from cabinpose.scene.sensor.filters import median_of_valid
from cabinpose.scene.sensor.physical import NO_EFFECTS, PhysicalNoise, sample_times
from cabinpose.scene.sensor.placement import jittered, place_camera
from cabinpose.scene.sensor.presets import SENSORS, Sensor, sensor_by_name
from cabinpose.scene.sensor.simulate import NoiseModel, simulate
from cabinpose.scene.sensor.structured_light import StructuredLightNoise

__all__ = [
    "NO_EFFECTS",
    "SENSORS",
    "EmpiricalNoise",
    "GeometryBuffers",
    "NoiseModel",
    "PhysicalNoise",
    "Sensor",
    "SensorFrame",
    "StructuredLightNoise",
    "jittered",
    "median_of_valid",
    "place_camera",
    "sample_times",
    "sensor_by_name",
    "simulate",
]
