"""A recording written as an ADTF file, and the layout that says what is in it: as of a rig whose recorder is ADTF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from adtfdat_file import IndexedFileWriter

from cabinpose.signals.recorded import Facts, SegmentPoses, ToFFrame
from cabinpose.store.recording import Recording


def write_adtf_take(take: Path, path: Path, layout: Path) -> None:
    """Streams without media descriptions: `camera` (float mm, big-endian), `mvn` (cm, xyzw, segment by segment), `vicon`."""
    with Recording(take) as recording, path.open("wb") as file:
        writer = IndexedFileWriter(file)
        rows = [(source, sample, message) for source, sample in recording.samples() for message in sample.messages]
        begun = rows[0][1].host_ns
        ids = {source: writer.stream(name, "adtf/anonymous", {}) for source, name in NAMES.items()}
        for source, sample, message in rows:
            head = np.array([sample.device_ns or 0], "<i8").tobytes()
            if isinstance(message, ToFFrame):
                mm = (message.depth_m().astype(np.float64) * 1e3).astype(">f4")
                amplitude = message.amplitude.astype(">u2").tobytes()
                data = np.array([sample.device_ns or 0], ">i8").tobytes() + b"\1\2" + mm.tobytes() + amplitude
            elif isinstance(message, SegmentPoses) and source == "suit":
                q = np.roll(message.orientation_wxyz, -1, axis=1)
                data = head + np.hstack((message.position_m * 100, q)).astype("<f4").tobytes()
            elif isinstance(message, SegmentPoses):
                data = head + message.position_m.astype("<f8").tobytes() + message.orientation_wxyz.astype("<f8").tobytes()
            else:
                continue
            writer.sample(ids[source], sample.host_ns - begun, data)
        writer.close()
    layout.write_text(yaml.safe_dump({"streams": layout_of(rows)}, sort_keys=False), encoding="utf-8")


NAMES = {"tof": "camera", "suit": "mvn", "optical": "vicon"}


def layout_of(rows: list) -> list[dict]:
    """The streams' layout, by the first message of each; what a camera says of itself is none."""
    first = {source: message for source, _, message in reversed(rows) if not isinstance(message, Facts)}
    stamp = {"field": "stamp", "type": "tInt64", "gives": "time", "unit": "ns"}
    tof, suit, optical = first["tof"], first["suit"], first["optical"]
    size, k = list(tof.depth.shape), tof.camera_k
    segments = []
    for name in suit.names:
        segments += [
            {"field": f"{name}_p", "type": "tFloat32", "size": 3, "gives": "position", "unit": "cm", "of": name},
            {"field": f"{name}_q", "type": "tFloat32", "size": 4, "gives": "orientation", "of": name, "order": "xyzw"},
        ]
    names = list(optical.names)
    return [
        {
            "stream": "camera", "source": "tof", "byte_order": "big",
            "camera": {"fx": float(k[0, 0]), "fy": float(k[1, 1]), "cx": float(k[0, 2]), "cy": float(k[1, 2]),
                       "dist": tof.camera_dist.tolist()},
            "fields": [
                stamp, {"field": "reserved", "type": "tUInt8", "size": 2},
                {"field": "z", "type": "tFloat32", "size": size, "gives": "depth", "unit": "mm"},
                {"field": "ir", "type": "tUInt16", "size": size, "gives": "amplitude"},
            ],
        },
        {"stream": "mvn", "source": "suit", "subject": suit.subject, "fields": [stamp, *segments]},
        {
            "stream": "vicon", "source": "optical", "subject": optical.subject,
            "fields": [
                stamp,
                {"field": "p", "type": "float64", "size": [len(names), 3], "gives": "position", "unit": "m", "of": names},
                {"field": "q", "type": "float64", "size": [len(names), 4], "gives": "orientation", "of": names},
            ],
        },
    ]  # fmt: skip
