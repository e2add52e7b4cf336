"""Files of recorded motion: the reader that a suffix asks for, and the messages of one subject among those of several."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import RecordingError
from cabinpose.signals import Markers, SegmentPoses, SensorReadings
from cabinpose.store.convert.bvh import read_bvh_rows
from cabinpose.store.convert.c3d import read_c3d
from cabinpose.store.convert.mvnx import read_mvnx
from cabinpose.store.convert.rows import Row, checked
from cabinpose.store.recording import Recording

_READERS: Mapping[str, Callable[[Path], Iterator[Row]]] = MappingProxyType(
    {".mvnx": read_mvnx, ".c3d": read_c3d, ".bvh": read_bvh_rows}
)
M = TypeVar("M", SegmentPoses, Markers, SensorReadings)


def motion_rows(path: Path, source: str | None = None) -> Iterator[Row]:
    """The messages of a recording (.mcap; of one source, None: of all), or of an MVNX, C3D or BVH file.

    Files are judged by `rows.checked`. Raises RecordingError for another file and for a source that is not there, RecordingError
    or MocapError for a damaged one.
    """
    suffix = path.suffix.lower()
    if suffix != ".mcap" and suffix not in _READERS:
        raise RecordingError(f"{path} is no motion that can be read", hint=f"files: .mcap, {', '.join(_READERS)}")
    if not path.exists():
        raise RecordingError(f"{path} does not exist", hint="give a recording (.mcap), or an MVNX, C3D or BVH file")
    if suffix != ".mcap":
        entries = ((suffix, *row) for row in _READERS[suffix](path))
        yield from (entry[1:] for entry in checked(path, entries))
        return
    with Recording(path) as recording:
        if source is not None and source not in recording.sources:
            raise RecordingError(f"{path} has no source '{source}'", hint=f"it has: {', '.join(recording.sources) or 'none'}")
        for _, sample in recording.samples(None if source is None else [source]):
            for message in sample.messages:
                yield sample.host_ns, sample.device_ns, message


def of_one_subject(
    path: Path, timed: Iterable[tuple[int, M]], subject: str | None, what: str
) -> tuple[NDArray[np.int64], list[M]]:
    """Times (F,) ns and messages of a subject (None: the only one that has a name, or else the only one), all of the same points.

    what: what the messages are, for the error. Raises RecordingError where nobody or several could be meant.
    """
    timed = list(timed)
    subjects = tuple(dict.fromkeys(m.subject for _, m in timed))
    named = [name for name in subjects if name] or list(subjects)
    if subject is None and len(named) == 1:
        subject = named[0]
    mine = [(ns, m) for ns, m in timed if m.subject == subject]
    if not mine:
        wrong = f"{what} of several subjects" if subject is None and subjects else f"no {what}"
        wrong += f" of '{subject}'" if subject else ""
        hint = f"choose the subject, of: {', '.join(map(repr, subjects))}" if subjects else f"give a file that has {what}"
        raise RecordingError(f"{path} has {wrong}", hint=hint)
    same = [(ns, m) for ns, m in mine if m.names == mine[0][1].names]
    return np.array([ns for ns, _ in same], np.int64), [m for _, m in same]
