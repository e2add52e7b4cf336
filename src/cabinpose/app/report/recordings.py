"""The page on a recording: one HTML file without scripts, that needs no other file and no network; and a contact sheet."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.report.charts import charts
from cabinpose.app.report.html import Html, document, el, figure, picture_uri, section, table, tiles
from cabinpose.app.report.timeline import interval_chart, timeline
from cabinpose.app.view.draw import INVALID, amplitude_image, depth_image, depth_range, resized
from cabinpose.app.view.sheet import VIEW_FILES
from cabinpose.core import write_together
from cabinpose.signals import Markers, Sample, SegmentPoses, TakenBody, ToFFrame
from cabinpose.store import Image, Strokes, png, text
from cabinpose.store.recording import Recording, SourceSurvey, Survey, survey

_HEIGHT = 200  # px of a picture
_INK, _PAPER = (210, 215, 222), (24, 26, 31)
BODY_WORDS = (0, 1, 2, 7, 8)  # columns of `body_rows` that are no numbers
_SIDE_M = 2.2  # what a picture of points shows


@dataclass(frozen=True)
class _Shot:
    """One sample of a source as a picture."""

    source: str
    seconds: float
    sequence: int | None
    picture: Image


def write_recording_view(path: Path, out: Path, *, frames: int, rows: int, report: Callable[[int], None]) -> None:
    """Write the contact sheet of `rows` moments and the page of `frames`, evenly spread over the take: `VIEW_FILES` in `out`.

    `report` is called with the number of moments drawn, up to `frames`. Raises RecordingError where the file is no recording.
    """
    found = survey(path)
    shots: dict[str, list[_Shot]] = {source.name: [] for source in found.sources}
    with Recording(path, damaged="skip") as recording:
        for done, share in enumerate(np.linspace(0, 1, frames), 1):
            for source in found.sources:
                if (shot := _shot(recording, source, float(share), found.started_ns)) is not None:
                    shots[source.name].append(shot)
            report(done)
    shots = {name: series for name, series in shots.items() if series}
    sheet, page = VIEW_FILES
    write_together(out, {page: page_html(found, shots), sheet: png(contact_sheet(shots, rows))})


def source_rows(found: Survey) -> list[list[str]]:
    """A head and a line for each source. missing: numbers that the file lacks; from `lost` on, what the recorder counted."""
    head = "source samples first_s last_s rate/s jitter_ms gaps longest_s missing lost dropped late bad restarts"
    rows = [[title.replace("_", " ") for title in head.split()]]
    for s in found.sources:
        ends = ["-" if at is None else f"{(at - found.started_ns) / 1e9:.2f}" for at in (s.first_ns, s.last_ns)]
        longest = float((s.gaps[:, 1] - s.gaps[:, 0]).max()) if len(s.gaps) else 0.0
        counts: list[int | str] = ["?"] * 5
        if (of := s.status) is not None:
            counts = [of.lost, of.dropped, of.reordered + of.duplicate, of.malformed + of.refused, of.restarts]
        rates = f"{s.rate_hz:.1f}", f"{s.jitter_ms:.2f}", len(s.gaps), f"{longest:.2f}"
        rows.append([s.name, *map(str, (s.samples, *ends, *rates, s.missing, *counts))])
    return rows


def topic_rows(found: Survey) -> list[list[str]]:
    """A head and a line for each topic."""
    rows = [["topic", "schema", "messages", "rate/s", "MB"]]
    return rows + [
        [t.topic, t.schema or "bytes", str(t.messages), f"{t.rate_hz:.1f}", f"{t.bytes / 1e6:.2f}"] for t in found.topics
    ]


def body_rows(bodies: Sequence[TakenBody]) -> list[list[str]]:
    """A head and a line for each body or thing: sizes in m, lowest: its lowest point; by which unit and axis it was read."""
    head = "source subject kind frames size_m stature_m lowest_m up unit"
    rows = [[title.replace("_", " ") for title in head.split()]]
    for b in bodies:
        sizes = ["-" if math.isnan(value) else f"{value:.2f}" for value in b.size[:3]]
        read = [f"z (file: {b.up})" if b.up not in ("", "z") else "z", f"m (file: {b.unit})" if b.unit else "m"]
        rows.append([b.source, b.subject or "-", b.kind, str(b.frames), *sizes, *read])
    return rows


def bodies_as_data(bodies: Sequence[TakenBody]) -> list[dict[str, Any]]:
    """Bodies as plain data. unit_of_file, up_of_file: null where nothing says them; what is stored has metres and z up."""
    return [
        {
            "source": b.source, "subject": b.subject, "kind": b.kind, "frames": b.frames, "size_m": b.size.size,
            "stature_m": b.size.stature, "lowest_m": b.size.lowest, "unit": "m", "up": "z", "unit_of_file": b.unit or None,
            "up_of_file": b.up or None, "doubts": [f"{doubt.words} ({doubt.hint})" for doubt in b.doubts],
        }
        for b in bodies
    ]  # fmt: skip


def contact_sheet(shots: dict[str, list[_Shot]], rows: int) -> Image:
    """(H, W, 3): a row a moment, a picture a source; one dark strip where no source gives pictures."""
    count = min(rows, max((len(series) for series in shots.values()), default=0))
    lines = []
    for i in np.linspace(0, 1, count):
        pictures = [_captioned(series[round(float(i) * (len(series) - 1))]) for series in shots.values()]
        lines.append(np.concatenate(pictures, axis=1))
    width = max((line.shape[1] for line in lines), default=320)
    padded = [np.pad(line, ((0, 6), (0, width - line.shape[1]), (0, 0)), constant_values=_PAPER[0]) for line in lines]
    return np.concatenate(padded) if padded else np.full((40, width, 3), _PAPER, np.uint8)


def page_html(found: Survey, shots: dict[str, list[_Shot]]) -> str:
    """The page on a surveyed recording."""
    take = found.take
    who = ", ".join(f"{s.code} ({s.seat.replace('_', ' ')})" if s.seat else s.code for s in take.subjects)
    summary = " · ".join(filter(None, (take.action, take.car, who))) or "nothing is said of this take"
    intervals = charts((interval_chart(s, found.started_ns, found.seconds) for s in found.sources if s.samples > 1), "two")
    note = "Samples that arrived, relative to the usual rate of their source; silences in red."
    sections = [
        section("At a glance", _glance(found)),
        section("Time line", timeline(found), note),
        section("Between arrivals", intervals, "Line: median; shade: shortest to longest."),
        section("Sources", table(source_rows(found))),
        *([section("Bodies", table(body_rows(found.bodies), words=BODY_WORDS))] if found.bodies else []),
        *(section(name, el("div", *map(_figure, series), class_="shots")) for name, series in shots.items()),
        section("Topics", table(topic_rows(found), words=(0, 1))),
    ]
    return document(found.path.name, found.path.name, summary, sections)


def _glance(found: Survey) -> Html:
    damage, statuses = found.damage, [source.status for source in found.sources if source.status is not None]
    lost, dropped = sum(s.lost for s in statuses), sum(s.dropped for s in statuses)
    broken = damage.chunks or damage.skipped_bytes
    state = "damaged" if broken else "whole" if damage.whole else "no end"
    return tiles(
        [
            (f"{found.seconds:.1f}", "s", "length", (), ""),
            (f"{found.bytes / 1e6:.1f}", "MB", "size", (), ""),
            (str(len(found.sources)), "", "sources", (), ""),
            (str(sum(s.samples for s in found.sources)), "", "samples", (), ""),
            (str(lost), "", "lost before they arrived", (), "warn" if lost else ""),
            (str(dropped), "", "dropped by the recorder", (), "bad" if dropped else ""),
            (state, "", "file", (), "bad" if broken else "" if damage.whole else "warn"),
        ]
    )


def _figure(shot: _Shot) -> Html:
    number = "" if shot.sequence is None else f", number {shot.sequence}"
    return figure(el("img", src=picture_uri(shot.picture), alt=""), f"{shot.seconds:.2f} s{number}")


def _shot(recording: Recording, source: SourceSurvey, share: float, started_ns: int) -> _Shot | None:
    """The first sample with a picture from a share of the source's samples on; None where there is none near."""
    if not source.samples:
        return None
    start = int(source.arrival_ns[min(int(share * source.samples), source.samples - 1)])
    for _, sample in recording.samples([source.name], start_ns=start, end_ns=start + _SEARCH_NS):
        if (picture := _picture(sample)) is not None:
            return _Shot(source.name, (sample.host_ns - started_ns) / 1e9, sample.sequence, picture)
    return None


_SEARCH_NS = 200_000_000


def _picture(sample: Sample) -> Image | None:
    for message in sample.messages:
        if isinstance(message, ToFFrame):
            return _frame(message)
        if isinstance(message, (SegmentPoses, Markers)) and np.isfinite(message.position_m).all(axis=1).any():
            return _points(message.position_m)
    return None


def _frame(frame: ToFFrame) -> Image:
    """Depth and amplitude beside each other, as high as a picture is."""
    pictures = []
    if frame.depth.size:
        depth = frame.depth_m()
        pictures.append(depth_image(depth, *depth_range(depth)))
    if frame.amplitude.size:
        pictures.append(amplitude_image(frame.amplitude, float(np.percentile(frame.amplitude, 99.5))))
    if not pictures:
        return np.full((_HEIGHT, _HEIGHT, 3), INVALID, np.uint8)
    sized = [resized(p, (round(p.shape[1] * _HEIGHT / p.shape[0]), _HEIGHT)) for p in pictures]
    return np.concatenate(sized, axis=1).astype(np.uint8)


def _points(position_m: NDArray[np.float64]) -> Image:
    """Points seen from two sides, along x and along y of their world, z up, about their middle."""
    seen = position_m[np.isfinite(position_m).all(axis=1)]
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    extent = max(float((seen.max(axis=0) - seen.min(axis=0)).max()) * 1.15, _SIDE_M / 4)
    views = []
    for axis in (1, 0):
        view = np.full((_HEIGHT, _HEIGHT, 3), _PAPER, np.uint8)
        u = (seen[:, axis] - middle[axis]) / extent + 0.5
        v = 0.5 - (seen[:, 2] - middle[2]) / extent
        with Strokes(view) as strokes:
            for at in np.stack((u, v), axis=1) * _HEIGHT:
                strokes.dot(at, 3.0, _INK)
        views.append(view)
    return np.concatenate(views, axis=1)


def _captioned(shot: _Shot) -> Image:
    strip = np.full((22, shot.picture.shape[1], 3), _PAPER, np.uint8)
    text(strip, f"{shot.source}  {shot.seconds:.2f} s", (6, 15), _INK, 12)
    gap = np.full((_HEIGHT + 22, 6, 3), _PAPER, np.uint8)
    return np.concatenate([np.concatenate([strip, shot.picture]), gap], axis=1)
