"""A survey as rows of text, for the terminal and the page alike."""

from __future__ import annotations

from cabinpose.store.recording import SourceSurvey, Survey


def source_rows(found: Survey) -> list[list[str]]:
    """A head and a line for each source. missing: numbers that the file lacks; from `lost` on, what the recorder counted."""
    head = [
        "source", "samples", "first s", "last s", "rate/s", "jitter ms", "gaps", "longest s", "missing", "lost", "dropped",
        "late", "bad", "restarts",
    ]  # fmt: skip
    return [head, *(_source(source, found.started_ns) for source in found.sources)]


def topic_rows(found: Survey) -> list[list[str]]:
    """A head and a line for each topic."""
    rows = [["topic", "schema", "messages", "rate/s", "MB"]]
    return rows + [
        [t.topic, t.schema or "bytes", str(t.messages), f"{t.rate_hz:.1f}", f"{t.bytes / 1e6:.2f}"] for t in found.topics
    ]


def _source(source: SourceSurvey, started_ns: int) -> list[str]:
    longest = float((source.gaps[:, 1] - source.gaps[:, 0]).max()) if len(source.gaps) else 0.0
    ends = ["-" if at is None else f"{(at - started_ns) / 1e9:.2f}" for at in (source.first_ns, source.last_ns)]
    row = [
        source.name, str(source.samples), *ends, f"{source.rate_hz:.1f}", f"{source.jitter_ms:.2f}", str(len(source.gaps)),
        f"{longest:.2f}", str(source.missing),
    ]  # fmt: skip
    if (status := source.status) is None:
        return row + ["?"] * 5
    late, bad = status.reordered + status.duplicate, status.malformed + status.refused
    return row + [str(count) for count in (status.lost, status.dropped, late, bad, status.restarts)]
