"""A recording made from formulas: a head that turns, a body that hangs from it, three devices with clocks of their own."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from cabinpose.align.calibration import Calibration, Extrinsics, Head, Intrinsics, KnownDelay, rows
from cabinpose.core.camera import Camera
from cabinpose.core.frames import apply, invert, look_at, transform
from cabinpose.core.skeleton import CABINPOSE, JOINTS, MVN_SEGMENTS
from cabinpose.signals.clock import ClockMap
from cabinpose.signals.recorded import Facts, Message, Sample, SegmentPoses, ToFFrame
from cabinpose.store.recording import Chunking, Participant, RecordingWriter, Take

START_NS = 1_750_000_000_000_000_000
CAMERA = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)
CAMERA_FROM_WORLD = invert(look_at((0.0, 0.0, 1.2), (1.0, 0.1, 1.0)))
OBJECT_FROM_HEAD = transform(Rotation.from_euler("xyz", (20, -15, 30), degrees=True), (-0.06, 0.01, -0.1))
SUIT_FROM_WORLD = transform(Rotation.from_euler("z", 75, degrees=True), (4.0, -2.0, 0.3))
LATENCY_S = {"tof": 0.040, "optical": 0.010, "suit": 0.025, "suit2": 0.061}
RATE_HZ = {"tof": 20.0, "optical": 100.0, "suit": 60.0, "suit2": 60.0}
CLOCKS = {"tof": ClockMap(-START_NS + 5_000_000_000, 2e-5, START_NS), "optical": ClockMap(-START_NS, -1e-5, START_NS),
          "suit": ClockMap(-START_NS + 777_000_000, 4e-5, START_NS),
          "suit2": ClockMap(-START_NS + 123_000_000, -3e-5, START_NS)}  # fmt: skip


def head_in_world(time_s: np.ndarray) -> np.ndarray:
    """(T, 4, 4): looking about with several rhythms, the skull base swaying by centimetres."""
    t = time_s[:, None]
    turn = np.concatenate(
        (0.3 * np.sin(1.1 * t + 0.4 * np.sin(0.5 * t)), 0.4 * np.sin(0.7 * t + 1), 0.6 * np.sin(0.9 * t + np.sin(0.37 * t))),
        axis=1,
    )
    result = np.tile(np.eye(4), (len(time_s), 1, 1))
    result[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix()
    result[:, :3, 3] = (1.0, 0.1, 1.1) + 0.03 * np.concatenate((np.sin(t), np.cos(0.8 * t), np.sin(0.6 * t)), axis=1)
    return result


def segments_in_world(time_s: np.ndarray) -> np.ndarray:
    """(T, 23, 4, 4): the head, and all else at fixed places below it, the hands waving."""
    head = head_in_world(time_s)
    rng = np.random.default_rng(1)
    places = rng.uniform((-0.1, -0.3, -0.7), (0.2, 0.3, -0.1), (len(MVN_SEGMENTS), 3))
    turns = Rotation.random(len(MVN_SEGMENTS), rng=rng).as_matrix()
    result = np.tile(np.eye(4), (len(time_s), len(MVN_SEGMENTS), 1, 1))
    result[..., :3, :3] = turns
    result[..., :3, 3] = places + (1.0, 0.1, 1.1)
    for hand in ("LeftHand", "RightHand"):
        result[:, MVN_SEGMENTS.index(hand), :3, 3] += 0.1 * np.sin(np.outer(time_s, (1.3, 0.9, 0.7)))
    result[:, MVN_SEGMENTS.index("Head")] = head
    return result


def joints_in_camera(time_s: np.ndarray, hands_m: tuple = ((0.0, 0.085, 0.0), (0.0, -0.085, 0.0))) -> np.ndarray:
    """(T, 20, 3): the truth."""
    segments = segments_in_world(time_s)
    joints = np.full((len(time_s), len(JOINTS), 3), np.nan)
    for joint, theirs in CABINPOSE.maps["mvn"].items():
        joints[:, CABINPOSE.index[joint]] = segments[:, MVN_SEGMENTS.index(theirs), :3, 3]
    for joint, theirs, hand in (("lhand", "LeftHand", hands_m[0]), ("rhand", "RightHand", hands_m[1])):
        pose = segments[:, MVN_SEGMENTS.index(theirs)]
        joints[:, CABINPOSE.index[joint]] = pose[:, :3, :3] @ np.array(hand) + pose[:, :3, 3]
    return apply(CAMERA_FROM_WORLD, joints)


LATER_S, BESIDE = 3.7, np.array((0.1, -0.6, 0.0))  # the second person does what the first one does, later and elsewhere


def second_in_world(time_s: np.ndarray) -> np.ndarray:
    """(T, 23, 4, 4): segments of the second person."""
    result = segments_in_world(time_s + LATER_S)
    result[..., :3, 3] += BESIDE
    return result


def second_in_camera(time_s: np.ndarray) -> np.ndarray:
    """(T, 20, 3): the truth of the second person."""
    return joints_in_camera(time_s + LATER_S) + CAMERA_FROM_WORLD[:3, :3] @ BESIDE


@dataclass
class Made:
    """How a take is made; what each source leaves out."""

    seconds: float = 14.0
    jitter_s: float = 0.002
    optical_gap: tuple[float, float] | None = None
    suit_until_s: float = np.inf
    suit_still: bool = False
    codes: tuple[str, ...] = ("S07",)
    camera: str = ""  # serial number
    rig: str = ""
    station: str = ""  # of the suit, as MVN's meta data say it
    optical: tuple[Facts, ...] = ()  # what the optical system says of itself
    second: str = ""  # the source of a second person's suit
    host: dict[str, str] = field(default_factory=dict)
    car: str = "sedan"
    seat: str | None = "driver"
    drive_side: Literal["left", "right"] | None = None
    sources: tuple[str, ...] = ("tof", "optical", "suit")
    depth_m: float = 0.0
    amplitude: bool = True
    seed: int = 5
    true_s: dict[str, np.ndarray] = field(default_factory=dict)

    def write(self, path: Path) -> np.ndarray:
        """Write the recording and return the true times (F,) of the camera's frames, s."""
        rng = np.random.default_rng(self.seed)
        samples: list[tuple[str, Sample]] = []
        for source in (*self.sources, *({self.second} - {"", *self.sources})):
            time = np.arange(0.0, self.seconds, 1 / RATE_HZ[source]) + 0.0003 * len(source)
            if source.startswith("suit"):
                time = time[time < self.suit_until_s]
            self.true_s[source] = time
            true_ns = START_NS + np.rint(time * 1e9).astype(np.int64)
            late = LATENCY_S[source] + rng.exponential(max(self.jitter_s, 1e-12), len(time))
            host = np.maximum.accumulate(true_ns + np.rint(late * 1e9).astype(np.int64))
            device = CLOCKS[source](true_ns)
            for k, messages in enumerate(self._messages(source, time)):
                samples.append((source, Sample(k, int(host[k]), int(device[k]), b"", messages)))
        samples.sort(key=lambda row: row[1].host_ns)
        seats = (self.seat, "front_passenger" if self.seat else None)
        people = tuple(Participant(code=code, seat=seat) for code, seat in zip(self.codes, seats, strict=False))
        take = Take(action="reach", car=self.car, drive_side=self.drive_side, rig=self.rig, subjects=people)
        with RecordingWriter(path, take, host=self.host, chunking=Chunking(flush_s=np.inf, sync_s=0.0)) as writer:
            for source, sample in samples:
                writer.write(source, sample)
        return self.true_s.get("tof", np.zeros(0))

    def _messages(self, source: str, time: np.ndarray) -> list[tuple[Message, ...]]:
        if source == "tof":
            depth = np.full((CAMERA.height, CAMERA.width), round(self.depth_m * 1e4), np.uint16)
            amplitude = depth if self.amplitude else np.zeros((0, 0), np.uint16)
            frame = ToFFrame(depth, 1e-4, amplitude, np.zeros((0, 0), np.uint8), CAMERA.k, np.zeros(5), np.zeros(5))
            named = ((Facts("camera", {"vendor": "ours", "serial": self.camera}), frame),) if self.camera else ((frame,),)
            return [*named, *[(frame,)] * (len(time) - 1)]
        if source == "optical":
            heads = [("head", *self._hidden(time, *_split(head_in_world(time) @ invert(OBJECT_FROM_HEAD))))]
            if self.second:
                second = second_in_world(time)[:, MVN_SEGMENTS.index("Head")]
                heads.append(("head2", *_split(second @ invert(OBJECT_FROM_HEAD))))
            poses = [
                tuple(SegmentPoses(name, ("head",), p[k, None], q[k, None]) for name, p, q in heads) for k in range(len(time))
            ]
            return [(*self.optical, *poses[0]), *poses[1:]]
        suits = []
        if source == "suit":
            moved = SUIT_FROM_WORLD @ segments_in_world(np.zeros_like(time) if self.suit_still else time)
            suits.append(("S07", *_split(moved)))
        if source == self.second:
            suits.append(("S08", *_split(SUIT_FROM_WORLD @ second_in_world(time))))
        poses = [tuple(SegmentPoses(code, MVN_SEGMENTS, p[k], q[k]) for code, p, q in suits) for k in range(len(time))]
        if self.station:
            poses[0] = (Facts("S07", {"xmid": self.station}), *poses[0])
        return poses

    def _hidden(self, time: np.ndarray, position: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self.optical_gap is not None:
            gone = (time > self.optical_gap[0]) & (time < self.optical_gap[1])
            position[gone], turn[gone] = np.nan, np.nan
        return position, turn


def _split(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    turn = Rotation.from_matrix(poses[..., :3, :3].reshape(-1, 3, 3)).as_quat(scalar_first=True)
    return poses[..., :3, 3].copy(), turn.reshape(*poses.shape[:-2], 4)


def calibration(**changes: object) -> Calibration:
    """The true calibration of these recordings."""
    camera = {"width": CAMERA.width, "height": CAMERA.height, "fx": CAMERA.fx, "fy": CAMERA.fy, "cx": CAMERA.cx, "cy": CAMERA.cy}
    values: dict[str, object] = {
        "intrinsics": Intrinsics(**camera),
        "extrinsics": Extrinsics(camera_from_world=rows(CAMERA_FROM_WORLD)),
        "tof_to_optical": KnownDelay(offset_s=LATENCY_S["optical"] - LATENCY_S["tof"]),
        "heads": {"S07": Head(object_from_head=rows(OBJECT_FROM_HEAD))},
    }
    return Calibration(**(values | changes))
