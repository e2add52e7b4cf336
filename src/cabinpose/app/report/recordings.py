"""The page on a recording: one HTML file without scripts, that needs no other file and no network; and a contact sheet."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cabinpose.app.report.timeline import interval_chart, timeline
from cabinpose.app.view.draw import INVALID, Image, Strokes, amplitude_image, depth_image, jpeg, resized, text
from cabinpose.core.ports import Sample
from cabinpose.core.recorded import Markers, SegmentPoses, ToFFrame
from cabinpose.store.convert.frames import write_png
from cabinpose.store.recording import Recording, SourceSurvey, Survey, survey

_HEIGHT = 200  # px of a picture
_INK, _PAPER = (210, 215, 222), (24, 26, 31)
_SIDE_M = 2.2  # what a picture of points shows


@dataclass(frozen=True)
class _Shot:
    """One sample of a source as a picture."""

    source: str
    seconds: float
    sequence: int | None
    picture: Image


def write_recording_view(path: Path, sheet: Path, page: Path, *, frames: int, rows: int, report: Callable[[int], None]) -> None:
    """Write the contact sheet (PNG) of `rows` moments and the page (HTML) of `frames`, evenly spread over the take.

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
    sheet.parent.mkdir(parents=True, exist_ok=True)  # not before the recording was read: a mistake leaves no folder
    write_png(sheet, contact_sheet(shots, rows))
    page.write_text(page_html(found, shots), encoding="utf-8")


def source_rows(found: Survey) -> list[list[str]]:
    """A head and a line for each source. missing: numbers that the file lacks; from `lost` on, what the recorder counted."""
    head = [
        "source",
        "samples",
        "first_s",
        "last_s",
        "rate/s",
        "jitter_ms",
        "gaps",
        "longest_s",
        "missing",
        "lost",
        "dropped",
        "late",
        "bad",
        "restarts",
    ]
    return [[title.replace("_", " ") for title in head], *(_source(source, found.started_ns) for source in found.sources)]


def topic_rows(found: Survey) -> list[list[str]]:
    """A head and a line for each topic."""
    rows = [["topic", "schema", "messages", "rate/s", "MB"]]
    return rows + [
        [t.topic, t.schema or "bytes", str(t.messages), f"{t.rate_hz:.1f}", f"{t.bytes / 1e6:.2f}"] for t in found.topics
    ]


def _source(source: SourceSurvey, started_ns: int) -> list[str]:
    longest = float((source.gaps[:, 1] - source.gaps[:, 0]).max()) if len(source.gaps) else 0.0
    ends = ["-" if at is None else f"{(at - started_ns) / 1e9:.2f}" for at in (source.first_ns, source.last_ns)]
    seen = [
        str(source.samples),
        *ends,
        f"{source.rate_hz:.1f}",
        f"{source.jitter_ms:.2f}",
        str(len(source.gaps)),
        f"{longest:.2f}",
    ]
    row = [source.name, *seen, str(source.missing)]
    if (status := source.status) is None:
        return row + ["?"] * 5
    late, bad = status.reordered + status.duplicate, status.malformed + status.refused
    return row + [str(count) for count in (status.lost, status.dropped, late, bad, status.restarts)]


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
    style = (files("cabinpose.app.report") / "assets" / "report.css").read_text(encoding="utf-8")
    style += (files("cabinpose.app.report") / "assets" / "recording.css").read_text(encoding="utf-8")
    take = found.take
    who = ", ".join(f"{s.code} ({s.seat.replace('_', ' ')})" if s.seat else s.code for s in take.subjects)
    said = " · ".join(filter(None, (take.action, take.car, who))) or "nothing is said of this take"
    charts = "".join(interval_chart(source, found.started_ns, found.seconds) for source in found.sources if source.samples > 1)
    body = [
        _section("At a glance", _tiles(found)),
        _section("Time line", timeline(found), "Samples that arrived, against the usual rate of their source; silences in red."),
        _section("Between arrivals", f'<div class="charts two">{charts}</div>', "Line: median; shade: shortest to longest."),
        _section("Sources", _table(source_rows(found))),
        *(_section(name, _gallery(series)) for name, series in shots.items()),
        _section("Topics", _table(topic_rows(found))),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(found.path.name)}</title><style>{style}</style></head><body>"
        f"<header><h1>{escape(found.path.name)}</h1><p>{escape(said)}</p></header><main>{''.join(body)}</main></body></html>\n"
    )


def _section(title: str, body: str, note: str = "") -> str:
    return f"<section><h2>{escape(title)}</h2>{f'<p class=note>{note}</p>' if note else ''}{body}</section>"


def _tiles(found: Survey) -> str:
    damage, statuses = found.damage, [source.status for source in found.sources if source.status is not None]
    lost, dropped = sum(s.lost for s in statuses), sum(s.dropped for s in statuses)
    broken = damage.chunks or damage.skipped_bytes
    state = "damaged" if broken else "whole" if damage.whole else "no end"
    tiles = [
        (f"{found.seconds:.1f}", "s", "length", ""),
        (f"{found.bytes / 1e6:.1f}", "MB", "size", ""),
        (str(len(found.sources)), "", "sources", ""),
        (str(sum(s.samples for s in found.sources)), "", "samples", ""),
        (str(lost), "", "lost before they came", "warn" if lost else ""),
        (str(dropped), "", "dropped by the recorder", "bad" if dropped else ""),
        (state, "", "file", "bad" if broken else "warn" if not damage.whole else ""),
    ]
    drawn = (
        f'<div class="tile {kind}"><b>{value}<small> {unit}</small></b><span>{label}</span></div>'
        for value, unit, label, kind in tiles
    )
    return f'<div class="tiles">{"".join(drawn)}</div>'


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *lines = rows
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join(
        f"<tr><th>{escape(row[0])}</th>{''.join(f'<td>{escape(cell)}</td>' for cell in row[1:])}</tr>" for row in lines
    )
    return f'<div class="scroll"><table><tr>{top}</tr>{body}</table></div>'


def _gallery(series: Sequence[_Shot]) -> str:
    figures = []
    for shot in series:
        data = base64.b64encode(jpeg(shot.picture, 85)).decode("ascii")
        caption = f"{shot.seconds:.2f} s" + ("" if shot.sequence is None else f", number {shot.sequence}")
        image = f'<img src="data:image/jpeg;base64,{data}" alt="">'
        figures.append(f"<figure>{image}<figcaption>{caption}</figcaption></figure>")
    return f'<div class="shots">{"".join(figures)}</div>'


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
        depth = np.where(frame.depth == 0, np.nan, frame.depth * frame.depth_unit_m).astype(np.float32)
        valid = depth[np.isfinite(depth)]
        near, far = np.percentile(valid, (1, 99)) if valid.size else (0.0, 1.0)
        pictures.append(depth_image(depth, float(near), float(far)))
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
