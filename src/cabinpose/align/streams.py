"""The times of a recording's sources on one axis: the host's, without the part of the latency that varies."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from cabinpose.align.calibration import Names
from cabinpose.align.clocks import host_from_device
from cabinpose.core import AlignmentError, RecordingError
from cabinpose.signals import Facts, ToFFrame
from cabinpose.store.recording import MarkerSeries, Recording, SegmentSeries

F64 = NDArray[np.float64]
Times = NDArray[np.int64]
_FIRST_SAMPLES = 2000  # in which a suit says what it is: some seconds of all its messages


def frame_times(recording: Recording, source: str) -> Times:
    """(T,) stamps of a camera's frames on the host's axis, in the order of the recording.

    Raises RecordingError for a source that was not recorded, AlignmentError where it gave no frame or its clock cannot be told.
    """
    if source not in recording.sources:
        raise RecordingError(
            f"{recording.path} has no source '{source}'", hint=f"it has: {', '.join(recording.sources) or 'none'}"
        )
    places = [place for place, _, _, _ in recording.records([source]) if place.topic == "depth"]
    if not places:
        raise AlignmentError(f"{source} gave no frame", hint="look at the take with `cabinpose info`")
    host = np.array([place.host_ns for place in places], np.int64)
    device = np.array([place.device_ns for place in places if place.device_ns is not None], np.int64)
    if len(device) < len(host):
        return host
    return host_from_device(device, host, source)(device)


def on_host(series: SegmentSeries | MarkerSeries) -> Times:
    """(T,) stamps of a source's samples on the host's axis."""
    if not series.device_clock:
        return series.host_ns
    return host_from_device(series.device_ns, series.host_ns, series.source)(series.device_ns)


def camera_identity(recording: Recording, source: str) -> str:
    """Vendor, model and serial number of a camera, as it stated them before its first frame; "" where it has no serial number."""
    for _, sample in recording.samples([source]):
        for message in sample.messages:
            if isinstance(message, Facts) and message.about == "camera":
                serial = message.values.get("serial") or message.values.get("id")
                named = (message.values.get("vendor"), message.values.get("model"), serial)
                return " ".join(str(part) for part in named if part) if serial else ""
            if isinstance(message, ToFFrame):
                return ""
    return ""


def equipment(recording: Recording, names: Names, suits: Mapping[str, str]) -> dict[str, str]:
    """What a take says of its rig beside the camera; what is not said is left out.

    Its name for the rig; of each suit the station (MVN's XMID); of the optical system the address of its server (Vicon) or the id
    of its stream (LSL), its rate, and the markers of the object on the head.

    suits: source of each subject's, by code.
    """
    told = {"rig": recording.take.rig} if recording.take.rig else {}
    told |= _optical_system(_first_facts(recording, names.optical), names.head_object)
    for code, source in suits.items():
        stations = (str(fact.values["xmid"]) for fact in _first_facts(recording, source) if fact.values.get("xmid"))
        if station := next(stations, ""):
            told[f"suit of {code}"] = station
    return told


def _first_facts(recording: Recording, source: str) -> Iterator[Facts]:
    """What a source says of itself at the beginning of a take; nothing where it was not recorded."""
    samples = islice(recording.samples([source]), _FIRST_SAMPLES) if source in recording.sources else ()
    return (message for _, sample in samples for message in sample.messages if isinstance(message, Facts))


def _optical_system(facts: Iterable[Facts], head_object: str) -> dict[str, str]:
    """What an optical system says of itself, by what it is called in `equipment`; the first that is said of each."""
    told: dict[str, str] = {}
    for about, values in ((fact.about, fact.values) for fact in facts):
        if about == "server" and (address := str(values.get("address") or "")):
            told.setdefault("optical system", address)
        elif about == "stream":
            if stream := str(values.get("source_id") or ""):
                told.setdefault("optical system", stream)
            if isinstance(rate := values.get("frame_rate_hz") or values.get("rate_hz"), int | float):
                told.setdefault("frames a second of the optical system", f"{rate:.6g}")
        elif about == f"subject {head_object}" and isinstance(markers := values.get("markers"), list):
            named = (str(each.get("name")) for each in markers if isinstance(each, Mapping))
            told.setdefault(f"markers of {head_object}", " ".join(sorted(named)))
    return told


@contextmanager
def naming(recording: Recording, step: str) -> Iterator[None]:
    """Put the recording's name and the step before what an AlignmentError within the block says."""
    try:
        yield
    except AlignmentError as error:
        raise type(error)(f"{recording.path}: {step}: {error}", hint=error.hint) from error


def seconds(time_ns: Times, origin_ns: int) -> F64:
    """(T,) s since the origin: floats, whose digits an epoch would eat."""
    return (time_ns - origin_ns) / 1e9
