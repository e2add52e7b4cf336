"""A rig is checked before anything connects: keys, kinds, names, paths."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from cabinpose.core.errors import ConfigError
from cabinpose.record import config
from cabinpose.record.config import KINDS, load_rig, load_take, parse_rig
from cabinpose.signals.clock import HostClock
from cabinpose.signals.recorded import FrameSource

NUMBERED = {"kind": "numbered"}


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"sources": {"a": {"kind": "numbered", "rate": 5}}}, ["sources.a.rate: unknown key", "rate_hz"]),
        ({"sources": {"a": {"kind": "numbered", "rate_hz": -5}}}, ["sources.a.rate_hz", "greater than 0"]),
        ({"sources": {"a": {"kind": "nummered"}}}, ["unknown kind of source 'nummered'", "numbered"]),
        ({"sources": {"a": {}}}, ["unknown kind of source 'None'"]),
        ({"sources": {}}, ["sources: "]),
        ({"sources": {"a": NUMBERED}, "tke": {}}, ["tke: unknown key", "take"]),
        ({"sources": {"a": NUMBERED}, "storage": {"compresion": "lz4"}}, ["storage.compresion: unknown key"]),
        ({"sources": {"a/b": NUMBERED}}, ["'a/b' is no name"]),
        ({"sources": {"take": NUMBERED}}, ["'take' is no name"]),
        ({"sources": {"a": NUMBERED}, "take": {"subjects": [{"code": "Anna"}]}}, ["a code has a digit"]),
        ({"sources": {"a": NUMBERED}, "take": {"subjects": [{"code": "S1", "seat": "roof"}]}}, ["rear_left"]),
        ([], ["mapping"]),
        ({"sources": {"a": [1]}}, ["sources.a"]),
    ],
)
def test_mistakes_are_named(data: Any, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_rig(data)
    assert caught.value.hint
    for word in words:
        assert word in f"{caught.value} {caught.value.hint}"


def test_files_that_are_no_rig(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("sources: [")
    for load in (load_rig, load_take):
        for name in ("a.yaml", "missing.yaml"):
            with pytest.raises(ConfigError) as caught:
                load(tmp_path / name)
            assert caught.value.hint


def test_paths_are_taken_from_the_rigs_folder(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("sources: {old: {kind: replay, path: takes/a.mcap}}")
    (plan,) = load_rig(tmp_path / "rig.yaml").sources
    assert plan.settings.model_dump()["path"] == tmp_path / "takes" / "a.mcap"
    absolute = tmp_path / "b.mcap"
    (plan,) = parse_rig({"sources": {"old": {"kind": "replay", "path": str(absolute)}}}, base=Path("elsewhere")).sources
    assert plan.settings.model_dump()["path"] == absolute


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_a_source_with_described_settings(kind: str) -> None:
    """Also: nothing of a vendor's is needed to build one, and none is opened by being built."""
    module, _, name = KINDS[kind].partition(":")
    source_class = getattr(import_module(module), name)
    assert source_class.Settings.model_config["extra"] == "forbid"
    assert source_class.Settings.model_config["frozen"]
    paths = {"azure_mkv": {"path": "a.mkv"}, "replay": {"path": "a.mcap"}, "stepper": {"port": "a.tty"}}
    needed = {**paths, "lsl": {"stream": "eeg"}, "genicam": {"producer": "a.cti"}}
    (plan,) = parse_rig({"sources": {"a": {"kind": kind, **needed.get(kind, {})}}}).sources
    source: FrameSource = plan.build(HostClock())
    assert source.name == "a"
    assert source.counts.received == 0


def test_other_packages_add_kinds_and_replace_none(monkeypatch: pytest.MonkeyPatch) -> None:
    added = [
        EntryPoint("counting", "cabinpose.record.sources.numbered:NumberedSource", config.ENTRY_POINTS),
        EntryPoint("replay", "cabinpose.record.sources.numbered:NumberedSource", config.ENTRY_POINTS),
        EntryPoint("broken", "no_such_module:Source", config.ENTRY_POINTS),
    ]
    monkeypatch.setattr(config, "entry_points", lambda group: added if group == "cabinpose.sources" else [])
    (plan,) = parse_rig({"sources": {"a": {"kind": "counting", "rate_hz": 5}}}).sources
    assert plan.build(HostClock()).name == "a"
    assert config.kinds()["replay"] == KINDS["replay"]
    with pytest.raises(ConfigError, match="no_such_module"):
        parse_rig({"sources": {"a": {"kind": "broken"}}})
