"""A body of MVN's segments that stands, moves and turns, in exact numbers: what the suit's evaluations are tried on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from cabinpose.core.skeleton import MVN_JOINTS, MVN_SEGMENTS
from cabinpose.evaluate.mocap.pairs import JOINT_PAIRS, SEGMENT_PAIRS
from cabinpose.signals.recorded import Message, Sample, SegmentPoses, SensorReadings
from cabinpose.store.recording import Participant, RecordingWriter, Take

# Offsets of a segment's origin from its parent's, m; x forward, y left, z up, standing in an N-pose.
OFFSETS = {
    "L5": (0, 0, 0.10), "L3": (0, 0, 0.10), "T12": (0, 0, 0.09), "T8": (0, 0, 0.09), "Neck": (0.01, 0, 0.13),
    "Head": (0.02, 0, 0.09),
    "RightShoulder": (0, -0.03, 0.10), "RightUpperArm": (0, -0.14, 0), "RightForearm": (0, -0.01, -0.29),
    "RightHand": (0.01, 0, -0.25),
    "LeftShoulder": (0, 0.03, 0.10), "LeftUpperArm": (0, 0.14, 0), "LeftForearm": (0, 0.01, -0.29), "LeftHand": (0.01, 0, -0.25),
    "RightUpperLeg": (0, -0.09, -0.01), "RightLowerLeg": (0.01, 0, -0.42), "RightFoot": (-0.01, 0, -0.41),
    "RightToe": (0.14, 0, -0.07),
    "LeftUpperLeg": (0, 0.09, -0.01), "LeftLowerLeg": (0.01, 0, -0.42), "LeftFoot": (-0.01, 0, -0.41),
    "LeftToe": (0.14, 0, -0.07),
}  # fmt: skip
PARENT = {child: parent for _, parent, child in MVN_JOINTS}


def quaternions(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat(scalar_first=True)


def moving(time_s: np.ndarray, *, amplitude: float = 0.5, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Positions (T, 23, 3) and orientations (T, 23, 4): every joint swings smoothly about an axis of its own, from the N-pose."""
    rng = np.random.default_rng(seed)
    pose: dict[str, Rotation] = {}
    place: dict[str, np.ndarray] = {}
    for name in MVN_SEGMENTS:
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        swing = amplitude * np.sin(2 * np.pi * rng.uniform(0.2, 0.5) * time_s)
        local = Rotation.from_rotvec(swing[:, None] * axis)
        if name == "Pelvis":
            pose[name] = local
            place[name] = np.stack((0.1 * np.sin(time_s), 0.2 * np.sin(0.7 * time_s), np.full(len(time_s), 0.95)), axis=1)
        else:
            parent = PARENT[name]
            pose[name] = pose[parent] * local
            place[name] = place[parent] + pose[parent].apply(np.array(OFFSETS[name], float))
    return np.stack([place[n] for n in MVN_SEGMENTS], axis=1), np.stack([quaternions(pose[n]) for n in MVN_SEGMENTS], axis=1)


def turned(heading_rad: float, shift: tuple[float, float, float], position: np.ndarray, orientation: np.ndarray) -> tuple:
    """The same body in a world turned about the vertical and shifted."""
    world = Rotation.from_rotvec((0, 0, heading_rad))
    flat = (world * Rotation.from_quat(orientation.reshape(-1, 4), scalar_first=True)).as_quat(scalar_first=True)
    return world.apply(position.reshape(-1, 3)).reshape(position.shape) + shift, flat.reshape(orientation.shape)


# An optical model of the same body: what turns with a segment of its, and what lies where that begins. Not always the same one:
# its head begins at the neck.
TURNS = {p.optical: p.suit for p in SEGMENT_PAIRS}
PLACES = {p.optical: p.suit for p in JOINT_PAIRS if p.suit in MVN_SEGMENTS and p.optical != "R_Collar"}
STREAMED = {p.name: MVN_SEGMENTS.index(p.suit) for p in JOINT_PAIRS if p.suit in MVN_SEGMENTS}  # joints, and their columns
OPTICAL = tuple(dict.fromkeys((*TURNS, *PLACES)))
BEGAN_NS = 1_700_000_000_000_000_000


def write_take(path: Path, streams: Mapping[str, list[tuple[float, Message]]], action: str = "reach") -> Path:
    """A recording of sources, each with messages at host times (s); the devices' clocks are the host's."""
    rows = sorted(((at, source, message) for source, some in streams.items() for at, message in some), key=lambda row: row[0])
    counts = dict.fromkeys(streams, 0)
    with RecordingWriter(path, Take(action=action, subjects=(Participant(code="S01", seat="driver"),))) as writer:
        for at, source, message in rows:
            counts[source] += 1
            host_ns = BEGAN_NS + round(at * 1e9)
            writer.write(
                source, Sample(sequence=counts[source], host_ns=host_ns, device_ns=host_ns, raw=b"", messages=(message,))
            )
    return path


def suit_stream(time_s: np.ndarray, position: np.ndarray, orientation: np.ndarray) -> list[tuple[float, Message]]:
    rows = zip(time_s.tolist(), position, orientation, strict=True)
    return [(at, SegmentPoses("S01", MVN_SEGMENTS, p, q)) for at, p, q in rows]


def optical_stream(time_s: np.ndarray, position: np.ndarray, orientation: np.ndarray) -> list[tuple[float, Message]]:
    placed, turned = np.full((len(time_s), len(OPTICAL), 3), np.nan), np.full((len(time_s), len(OPTICAL), 4), np.nan)
    for i, name in enumerate(OPTICAL):
        if name in PLACES:
            placed[:, i] = position[:, MVN_SEGMENTS.index(PLACES[name])]
        if name in TURNS:
            turned[:, i] = orientation[:, MVN_SEGMENTS.index(TURNS[name])]
    return [(at, SegmentPoses("S01", OPTICAL, p, q)) for at, p, q in zip(time_s.tolist(), placed, turned, strict=True)]


def sensor_stream(time_s: np.ndarray, orientation: np.ndarray) -> list[tuple[float, Message]]:
    nothing = np.zeros((0, 3))
    return [
        (at, SensorReadings("S01", ("sensor",), q[None], nothing, nothing, nothing))
        for at, q in zip(time_s.tolist(), orientation, strict=True)
    ]
