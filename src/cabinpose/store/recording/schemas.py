"""What is on a recording's topics: names, encodings, schemas. `docs/recording.md` has the table for people.

A message that Foxglove has a schema for is protobuf with that schema; everything else is JSON with a JSON Schema. In JSON a
number that is not known (NaN) is null, and an infinite one the string "Infinity" or "-Infinity", as in protobuf's JSON.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap_protobuf.schema import build_file_descriptor_set

from cabinpose.signals import ARRAYS, TOPICS, Channels, Facts, JointAngles, Markers, SegmentKinematics, SensorReadings

RAW = "raw"
HOST_ONLY = "_host"
"""Suffix of `raw` and `facts` where the sample has no time of its device, so that a topic keeps to one clock."""
RAW_ENCODING = "octet-stream"
FACTS = TOPICS[Facts]
STATUS = "status"
TAKE_TOPIC = "take"
TAKE_METADATA = "cabinpose.take"
HOST_METADATA = "cabinpose.host"
RIG_ATTACHMENT = "rig.yaml"
FORMAT = "1"
"""Version of what is described here; in the take's metadata record as `format`."""


@dataclass(frozen=True)
class SourceStatus:
    """What became of what a source's device sent, so far; `final`: the last of this take.

    received, lost, reordered, duplicate, malformed, restarts: of `core.ports.Counts`, and the restarts that the recorder made
    · written: samples in the file · dropped, dropped_bytes: samples that the recorder had no room for · refused: decoded
    messages that could not be written; the raw bytes were · queue_bytes: waiting · state: connecting, recording, waiting,
    retrying, ended or stopped · error: the last one, or "" · first_ns, last_ns: arrival of its first and last data, host time;
    None: there are none · silent: it has sent nothing for longer than it usually does.
    """

    source: str
    kind: str
    state: str
    received: int = 0
    lost: int = 0
    reordered: int = 0
    duplicate: int = 0
    malformed: int = 0
    restarts: int = 0
    written: int = 0
    dropped: int = 0
    dropped_bytes: int = 0
    refused: int = 0
    queue_bytes: int = 0
    error: str = ""
    final: bool = False
    first_ns: int | None = None
    last_ns: int | None = None
    silent: bool = False


_NUMBER: Mapping[str, Any] = MappingProxyType({"type": ["number", "null", "string"]})


def _array(width: int, what: str) -> dict[str, Any]:
    """Rows of `width` numbers, or for 0 plain numbers."""
    row = {"type": "array", "items": dict(_NUMBER), "minItems": width, "maxItems": width} if width else dict(_NUMBER)
    return {"type": "array", "description": what, "items": row}


def _object(title: str, description: str, **properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        "description": description,
        "type": "object",
        "properties": properties,
        "required": list(properties),
    }


def _table(kind: type[Any], description: str, *arrays: str) -> dict[str, Any]:
    """The schema of a message with one row of numbers a name; arrays: what is in each of them, in their order."""
    properties = {} if kind is Channels else {"subject": _SUBJECT}
    named = zip(ARRAYS[kind].items(), arrays, strict=True)
    columns = {name: _array(width, what) for (name, width), what in named}
    return _object(f"cabinpose.{kind.__name__}", description, **properties, names=_NAMES, **columns)


def _text(what: str) -> dict[str, Any]:
    return {"type": "string", "description": what}


def _count(what: str) -> dict[str, Any]:
    return {"type": "integer", "description": what}


def _time(what: str) -> dict[str, Any]:
    return {"type": ["integer", "null"], "description": f"ns, host time, of {what}; null = none came"}


_SUBJECT = _text("whose; a code, not a name")
_NAMES = {"type": "array", "items": {"type": "string"}, "description": "the device's own names"}
_WORLD = "in the device's world, z up"

JSON_SCHEMAS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "cabinpose.SegmentKinematics": _table(
            SegmentKinematics, f"Motion of body segments {_WORLD}; empty where the device does not give it.",
            "m/s", "m/s²", "rad/s", "rad/s²",
        ),
        "cabinpose.SensorReadings": _table(
            SensorReadings, "Single inertial sensors; empty where the device does not give it.",
            f"quaternions w x y z, {_WORLD}", "m/s²", "rad/s", "arbitrary unit",
        ),
        "cabinpose.JointAngles": _table(
            JointAngles, "Angles about the three axes that the device defines for each joint.", "rad"
        ),
        "cabinpose.Markers": _table(Markers, f"Optical markers {_WORLD}; null = occluded.", "m", "m; null = unknown"),
        "cabinpose.Channels": _table(Channels, "One value of each channel of a generic stream.", "as streamed"),
        "cabinpose.Facts": _object(
            "cabinpose.Facts", "What a device says of itself or its subject.",
            about=_text("of whom or what"), values={"type": "object", "description": "plain data"},
        ),
        "cabinpose.SourceStatus": _object(
            "cabinpose.SourceStatus", "What became of what a source's device sent, so far.",
            source=_text("name in the rig"), kind=_text("kind in the rig"), state=_text("what it is doing"),
            received=_count("arrived"), lost=_count("known from gaps in the device's count"), reordered=_count("late"),
            duplicate=_count("came twice"), malformed=_count("could not be read"), restarts=_count("went away and returned"),
            written=_count("samples in this file"), dropped=_count("samples the recorder had no room for"),
            dropped_bytes=_count("of these"), refused=_count("decoded messages that could not be written"),
            queue_bytes=_count("waiting to be written"), error=_text("the last one"),
            final={"type": "boolean", "description": "the last of this take"},
            first_ns=_time("its first data"), last_ns=_time("its last data"),
            silent={"type": "boolean", "description": "it has sent nothing for longer than it usually does"},
        ),
        "cabinpose.Take": _object(
            "cabinpose.Take", "Who did what, where; codes only, no personal names.",
            action=_text("what is done"), car=_text("the car or mock-up"),
            drive_side=_text("side of the wheel, left or right; left out where it is not known"),
            subjects={"type": "array", "items": {"type": "object"}, "description": "code, seat, consent of each"},
        ) | {"required": ["action", "car", "subjects"]},
    }
)  # fmt: skip

PROTOBUF_SCHEMAS: Mapping[str, Any] = MappingProxyType(
    {
        kind.DESCRIPTOR.full_name: kind  # the generated classes have no common typed base with DESCRIPTOR
        for kind in (RawImage, CameraCalibration, FrameTransforms, PointCloud)
    }
)


@cache
def schema_record(name: str) -> tuple[str, str, bytes]:
    """Message encoding, schema encoding and schema data of a schema's name."""
    if name in PROTOBUF_SCHEMAS:
        return "protobuf", "protobuf", build_file_descriptor_set(PROTOBUF_SCHEMAS[name]).SerializeToString()
    return "json", "jsonschema", json.dumps(JSON_SCHEMAS[name]).encode()
