"""A rig is checked before anything connects: keys, kinds, names, paths."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cabinpose.core.errors import ConfigError, ExtensionError
from cabinpose.record.config import kinds, load_rig, load_take, parse_rig
from cabinpose.record.sources.base import SOURCES, cameras, player_of
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
        ({"sources": {"a": {"kind": "mvn", "subjects": {0: "S1", 1: "S1"}}}}, ["sources.a.subjects", "two are called S1"]),
        ({"sources": {"a": {"kind": "vicon", "subjects": {"Anna": "S1", "Ben": "S1"}}}}, ["two are called S1"]),
        (
            {"sources": {"a": NUMBERED}, "take": {"subjects": [{"code": c, "seat": "driver"} for c in ("S1", "S2")]}},
            ["two subjects of the take sit on driver"],
        ),
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


@pytest.mark.parametrize("kind", SOURCES.names(own=True))
def test_each_kind_is_a_source_with_described_settings(kind: str) -> None:
    """Also: nothing of a vendor's is needed to build one, and none is opened by being built."""
    source_class = SOURCES[kind]
    assert source_class.Settings.model_config["extra"] == "forbid"
    assert source_class.Settings.model_config["frozen"]
    paths: dict[str, dict[str, Any]] = {
        "azure_mkv": {"path": "a.mkv"},
        "replay": {"path": "a.mcap"},
        "stepper": {"port": "a.tty"},
    }
    paths["v4l2"] = {"device": "a.video", "depth_unit_m": 0.001, "lens": {"fx": 500, "fy": 500, "cx": 320, "cy": 240}}
    paths["mt"] = {"port": "a.tty", "sensors": {"head": "03880C2A"}}
    needed = {**paths, "lsl": {"stream": "eeg"}, "genicam": {"producer": "a.cti"}, "synth": {"scenes": "a.yaml"}}
    (plan,) = parse_rig({"sources": {"a": {"kind": kind, **needed.get(kind, {})}}}).sources
    source: FrameSource = plan.build(HostClock())
    assert source.name == "a"
    assert source.counts.received == 0


# A source that has the methods, and derives from nothing of ours.
OTHER = """
from pydantic import BaseModel
from cabinpose.signals import Counts
class Settings(BaseModel):
    rate_hz: float = 1
class Source:
    Settings = Settings
    def __init__(self, name, settings, clock):
        self.name, self.settings, self.counts = name, settings, Counts()
    def check(self): return ()
    def open(self): pass
    def read(self, timeout_s): return ()
    def close(self): pass
"""


def test_other_packages_add_kinds_and_replace_none(extension: Callable[..., None]) -> None:
    extension("counting", {"sources": {"counted": "Source", "numbered": "Source"}}, OTHER)
    extension("broken", {"sources": {"lidar": "Source"}}, "import no_such_module")
    extension("no_source", {"sources": {"table": "Table"}}, "class Table: ...")
    (plan,) = parse_rig({"sources": {"a": {"kind": "counted", "rate_hz": 5}}}).sources
    assert plan.build(HostClock()).name == "a"
    with pytest.warns(UserWarning, match="'numbered' of counting is left out"):
        parse_rig({"sources": {"a": NUMBERED}})
    for kind, words in (("lidar", "of broken cannot be loaded"), ("table", "of no_source is not a DeviceSource")):
        with pytest.raises(ExtensionError, match=f"sources.a: .*{words}"):
            parse_rig({"sources": {"a": {"kind": kind}}})


def test_what_is_a_camera_and_who_plays_which_files(extension: Callable[..., None]) -> None:
    extension("playing", {"sources": {"played": "Played"}}, OTHER + "class Played(Source): plays = '.acme'\n")
    extension("broken", {"sources": {"lidar": "Source"}}, "import no_such_module")
    with pytest.warns(UserWarning, match="of broken .*; it is left out"):
        assert cameras() == ["simulated", "synth", "royale", "bta", "genicam", "orbbec", "realsense", "oak", "v4l2"]
    assert player_of(".mkv") == "azure_mkv"
    with pytest.warns(UserWarning, match="of broken"):
        assert (player_of(".acme"), player_of(".nix")) == ("played", None)
    assert player_of("") is None


def test_the_old_list_of_kinds_warns() -> None:
    with pytest.warns(DeprecationWarning, match=r"SOURCES.names\(\)"):
        assert kinds()["replay"] == "cabinpose.record.sources.replay:ReplaySource"
