"""Messages, samples and recordings for the tests; hypothesis strategies of everything that a source may say."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cabinpose.signals import FrameSource
from cabinpose.signals.recorded import (
    Channels,
    Facts,
    JointAngles,
    Markers,
    Message,
    Sample,
    SegmentKinematics,
    SegmentPoses,
    SensorReadings,
    ToFFrame,
)

WORDS = st.text(st.characters(exclude_categories=("Cs",)), max_size=8)  # any Unicode text, "/" and line ends among it
NAMES = st.lists(WORDS, max_size=4).map(tuple)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | WORDS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=3),
    max_leaves=6,
)


def floats(*shape: int) -> st.SearchStrategy[np.ndarray]:
    """Any doubles: -0.0, subnormal, infinite, not a number."""
    return hnp.arrays(np.float64, shape, elements=st.floats(allow_nan=True, allow_infinity=True))


@st.composite
def tables(draw: Any, kind: type, widths: dict[str, int], *, subject: bool = True, optional: bool = False) -> Any:
    names = draw(NAMES)
    arrays = {}
    for name, width in widths.items():
        rows = 0 if optional and draw(st.booleans()) else len(names)
        arrays[name] = draw(floats(rows, width) if width else floats(rows))
    return kind(draw(WORDS), names, **arrays) if subject else kind(names, **arrays)


@st.composite
def frames(draw: Any) -> ToFFrame:
    shape = draw(st.tuples(st.integers(1, 5), st.integers(1, 5)))
    amplitude = shape if draw(st.booleans()) else (0, 0)
    confidence = shape if draw(st.booleans()) else (0, 0)
    depth = (0, 0) if amplitude != (0, 0) and draw(st.booleans()) else shape
    return ToFFrame(
        depth=draw(hnp.arrays(np.uint16, depth)),
        depth_unit_m=draw(st.floats(1e-6, 1.0)),
        amplitude=draw(hnp.arrays(np.uint16, amplitude)),
        confidence=draw(hnp.arrays(np.uint8, confidence)),
        camera_k=draw(floats(3, 3)),
        camera_dist=draw(floats(5)),
        amplitude_dist=draw(floats(5)),
        noise=draw(hnp.arrays(np.uint16, amplitude)),
        balance=draw(hnp.arrays(np.uint16, confidence)),
    )


MESSAGES: dict[str, st.SearchStrategy[Message]] = {
    "SegmentPoses": tables(SegmentPoses, {"position_m": 3, "orientation_wxyz": 4}),
    "SegmentKinematics": tables(
        SegmentKinematics,
        {"velocity": 3, "acceleration": 3, "angular_velocity": 3, "angular_acceleration": 3},
        optional=True,
    ),
    "SensorReadings": tables(
        SensorReadings,
        {"orientation_wxyz": 4, "acceleration": 3, "angular_velocity": 3, "magnetic_field": 3},
        optional=True,
    ),
    "JointAngles": tables(JointAngles, {"angles": 3}),
    "Markers": tables(Markers, {"position_m": 3, "residual_m": 0}),
    "ToFFrame": frames(),
    "Channels": tables(Channels, {"values": 0}, subject=False),
    "Facts": st.builds(Facts, WORDS, st.dictionaries(WORDS, JSON, max_size=3)),
}
INT64 = st.integers(-(1 << 63), (1 << 63) - 1)
SAMPLES = st.builds(
    Sample,
    sequence=st.none() | st.integers(-(1 << 40), 1 << 40),
    host_ns=st.integers(0, (1 << 63) - 1),
    device_ns=st.none() | INT64,
    raw=st.binary(max_size=40),
    messages=st.lists(st.one_of(*MESSAGES.values()), max_size=3).map(tuple),
)


def bits(value: Any) -> Any:
    """Something that is equal for two values if, and only if, they are bit by bit the same; all NaN are one."""
    if isinstance(value, Sample):
        return (value.sequence, value.host_ns, value.device_ns, value.raw, tuple(map(bits, value.messages)))
    if isinstance(value, np.ndarray):
        same_nan = np.where(np.isnan(value), np.nan, value) if value.dtype.kind == "f" else value
        return (value.dtype.str, value.shape, np.ascontiguousarray(same_nan).tobytes())
    if hasattr(value, "__dataclass_fields__"):
        return (type(value).__name__, *(bits(getattr(value, field.name)) for field in fields(value)))
    if isinstance(value, float):
        return np.float64(value).tobytes()
    if isinstance(value, dict):
        return {key: bits(item) for key, item in value.items()}
    return [bits(item) for item in value] if isinstance(value, (list, tuple)) else (type(value).__name__, value)


def tof_frame(*, rng: np.random.Generator, width: int = 32, height: int = 24) -> ToFFrame:
    """A frame as a camera might give it."""
    return ToFFrame(
        depth=rng.integers(0, 40000, (height, width), dtype=np.uint16),
        depth_unit_m=1e-4,
        amplitude=rng.integers(0, 4000, (height, width), dtype=np.uint16),
        confidence=rng.integers(0, 255, (height, width), dtype=np.uint8),
        camera_k=np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]]),
        camera_dist=np.array([0.1, -0.2, 0.001, 0.002, 0.05]),
        amplitude_dist=np.zeros(5),
    )


def poses(*, rng: np.random.Generator, subject: str = "S07") -> SegmentPoses:
    """Three segments, one of them not seen."""
    position = rng.normal(size=(3, 3))
    position[2] = np.nan
    return SegmentPoses(subject, ("Pelvis", "L5", "Head"), position, rng.normal(size=(3, 4)))


def markers(*, rng: np.random.Generator) -> Markers:
    """Two markers, one of them occluded."""
    return Markers("S07", ("LFHD", "RFHD"), np.array([rng.normal(size=3), [np.nan] * 3]), np.array([0.001, np.nan]))


def take_samples(count: int, *, rng: np.random.Generator) -> list[tuple[str, Sample]]:
    """Samples of three sources in turn."""
    samples = []
    for i in range(count):
        time = 1_700_000_000_000_000_000 + i * 1_000_000
        message, source = [(poses(rng=rng), "suit"), (markers(rng=rng), "optical"), (tof_frame(rng=rng), "tof")][i % 3]
        raw = b"" if source == "tof" else rng.bytes(20)
        samples.append((source, Sample(100 + i // 3, time, 5_000 + i, raw, (message,))))
    return samples


def samples_until(source: FrameSource, enough: Callable[[list[Sample]], bool], *, patience_s: float) -> list[Sample]:
    """The samples of a source that is open, up to those that are enough; an AssertionError where they do not come."""
    samples: list[Sample] = []
    end = time.monotonic() + patience_s
    while not enough(samples):
        assert time.monotonic() < end, "the samples did not come"
        samples += source.read(0.1)
    return samples
