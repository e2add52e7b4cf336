"""A source of live frames from what was typed: a dataset, a recording, a rig, a file of a camera, or a kind of camera."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml

from cabinpose.app.live.feed import DatasetFeed, EveryFrame, Feed, LatestFrame
from cabinpose.core import ConfigError, read_yaml, unknown_name
from cabinpose.record import Rig, parse_rig
from cabinpose.record.sources import SOURCES, cameras, is_camera, player_of
from cabinpose.signals import HostClock
from cabinpose.store import MANIFEST_NAME, open_dataset
from cabinpose.store.recording import Recording

_RIGS = (".yaml", ".yml")
_SOURCES = "give a dataset, a recording (.mcap), a rig (.yaml), a file of a camera (such as .mkv), or a kind of camera"


def open_feed(
    source: str, settings: Mapping[str, Any] | None = None, *, realtime: bool = False, out: Path | None = None,
    within: Path | None = None,
) -> Feed:  # fmt: skip
    """What gives the frames of a source; nothing is connected yet.

    Parameters
    ----------
    source
        Folder of a dataset · recording, as FILE.mcap or FILE.mcap:NAME · rig, as RIG.yaml or RIG.yaml:NAME · file of a kind
        that `plays` it, as FILE.mkv · kind of camera.
    settings
        Settings of the source, beside or in place of the rig's; keys as a rig has them.
    realtime
        Play datasets and recordings at their own pace and drop what comes meanwhile, as a camera would.
    out
        Recording to write (.mcap) of what a device says.
    within
        Folder that the source and all paths among its settings have to be in; default: any.

    Raises
    ------
    ConfigError
        For a source that is not there, an unknown kind or setting, a path elsewhere, and a recording of what is recorded already.
    """
    given: dict[str, Any] = dict(settings or {})
    path, name = _split(source)
    if path is not None:
        _check_within(path, within)
    if out is not None and path is not None and path.suffix not in _RIGS:
        raise ConfigError(f"{path} is recorded already", hint="leave out --record, or name a camera")

    def latest(rig: Rig, out: Path | None = None) -> LatestFrame:
        for value in _paths(rig.sources[0].settings.model_dump()):
            _check_within(value, within)
        return LatestFrame(rig, out)

    if path is None:
        if source not in SOURCES or not is_camera(SOURCES[source]):
            error = unknown_name("source", source, ())
            raise ConfigError(f"{error}", hint=f"{_SOURCES}: {', '.join(sorted(cameras()))}")
        return latest(_rig(source, source, given), out)
    if path.is_dir():
        if not realtime:
            _nothing_set(given, path)
            return DatasetFeed(path)
        dataset = open_dataset(path)
        seen = {"dataset": str(path.absolute()), "loop": False, "faults": _pace(dataset)}
        feed: Feed = latest(_rig("dataset", "simulated", _changed(seen, given)))
        feed.drive_side = _drive_side(dataset)
        return feed
    if path.suffix == ".mcap":
        with Recording(path) as recording:
            if name in recording.sources and name not in recording.cameras:
                raise ConfigError(f"{name} of {path} is no camera", hint=f"its cameras: {', '.join(recording.cameras) or 'none'}")
            drive_side = recording.take.drive_side or ""
        # At the pace of the detectors, a frame without a time of its camera was taken when it was recorded, not read.
        played = {"path": str(path.absolute()), "source": name, "speed": float(realtime), "host_time": not realtime} | given
        rig = _rig("replay", "replay", played)
        clock = HostClock()
        feed = latest(rig) if realtime else EveryFrame(rig.sources[0].build(clock), clock)
        feed.drive_side = drive_side
        return feed
    if path.suffix not in _RIGS and (kind := player_of(path.suffix)):
        return latest(_rig(kind, kind, {"path": str(path.absolute())} | given))
    return latest(_one_of(path, name, given), out)


def parsed_settings(words: Sequence[str]) -> dict[str, Any]:
    """Settings from KEY=VALUE words; KEY may be dotted, VALUE is YAML. Raises ConfigError."""
    settings: dict[str, Any] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or not key:
            raise ConfigError(f"'{word}' sets nothing", hint="write --set KEY=VALUE, such as --set use_case=MODE_9_5FPS_2000")
        *parents, last = key.split(".")
        inner = settings
        for parent in parents:
            inner = inner.setdefault(parent, {})
            if not isinstance(inner, dict):
                raise ConfigError(f"'{word}' sets a part of what is set whole before", hint="leave one of them out")
        if isinstance(inner.get(last), dict):
            raise ConfigError(f"'{word}' sets whole what is set in part before", hint="leave one of them out")
        try:
            inner[last] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise ConfigError(f"the value of {key} cannot be read: {value}", hint="write it as YAML, in quotes") from error
    return settings


def _split(source: str) -> tuple[Path | None, str | None]:
    """The file and the name of the source within it; None for a word that is no file."""
    path = Path(source)
    if path.is_dir() and not (path / MANIFEST_NAME).is_file():
        raise ConfigError(f"{path} is no dataset: it has no {MANIFEST_NAME}", hint=_SOURCES)
    if path.exists():
        return path, None
    front, colon, name = source.rpartition(":")
    if colon and Path(front).is_file():
        return Path(front), name
    if path.suffix or "/" in source:
        raise ConfigError(f"there is no file {source}", hint=_SOURCES)
    return None, None


def _rig(name: str, kind: str, settings: Mapping[str, Any]) -> Rig:
    """A rig of one source; its text is what a rig file of it would say."""
    data = {"sources": {name: {"kind": kind, **settings}}}
    return parse_rig(data, yaml.safe_dump(data, sort_keys=False), base=Path.cwd())


def _one_of(path: Path, name: str | None, settings: Mapping[str, Any]) -> Rig:
    """The rig of a file with one of its sources alone, settings replaced by what was given."""
    data = read_yaml(path, hint="docs/recording.md has a rig to start from")
    sources = data.get("sources") if isinstance(data, dict) else None
    if not isinstance(sources, dict) or not sources:
        raise ConfigError(f"{path} names no sources", hint="docs/recording.md has a rig to start from")
    there = [str(n) for n, s in sources.items() if not isinstance(s, dict) or _may_be_camera(s.get("kind"))]
    if name is None:
        if len(there) != 1:
            raise ConfigError(f"{path} has {len(there)} cameras", hint=f"name one: {path}:NAME of {', '.join(there or sources)}")
        name = there[0]
    if name not in sources:
        error = unknown_name("source", name, [str(n) for n in sources])
        raise ConfigError(f"{path}: {error}", hint=error.hint)
    if name not in there and not getattr(SOURCES[sources[name]["kind"]], "plays", ""):  # a recording may be of a camera
        raise ConfigError(f"{name} of {path} is no camera", hint=f"its cameras: {', '.join(there) or 'none'}")
    of = sources[name]
    kept = data | {"sources": {name: _changed(of, settings) if isinstance(of, dict) else of}}
    return parse_rig(kept, yaml.safe_dump(kept, sort_keys=False), base=path.parent)


def _changed(settings: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with those that were given in place of them, also within such as have keys of their own."""
    both = {
        key: _changed(settings[key], value) if isinstance(value, dict) and isinstance(settings.get(key), dict) else value
        for key, value in given.items()
    }
    return {**settings, **both}


def _pace(dataset: xr.Dataset) -> dict[str, float]:
    """Frames a second of a dataset of sequences, among the faults of a simulated camera; none where no frame follows another."""
    at, of = (dataset[name].values for name in ("sync_ns", "sequence"))
    steps = np.diff(at)[(np.diff(of) == 0) & (np.diff(at) > 0)]
    return {"rate_hz": min(float(1e9 / np.median(steps)), 1000.0)} if steps.size else {}


def _drive_side(dataset: xr.Dataset) -> str:
    """Where the wheel is in all frames of a dataset; "" where it does not say so."""
    sides = set(dataset["drive_side"].values.tolist()) if "drive_side" in dataset else set()
    return str(sides.pop()) if len(sides) == 1 else ""


def _may_be_camera(kind: object) -> bool:
    """Whether a kind is that of a camera, or none at all, which is told when the rig is checked."""
    return not isinstance(kind, str) or kind not in SOURCES or is_camera(SOURCES[kind])


def _check_within(path: Path, folder: Path | None) -> None:
    if folder is not None and not path.resolve().is_relative_to(folder.resolve()):
        raise ConfigError(f"{path} lies outside of {folder}", hint="paths from the browser stay in the folder that was opened")


def _paths(settings: Any) -> Iterator[Path]:
    """All paths among settings as plain data."""
    if isinstance(settings, Path):
        yield settings
    elif isinstance(settings, dict):
        for value in settings.values():
            yield from _paths(value)


def _nothing_set(settings: Mapping[str, Any], path: Path) -> None:
    if settings:
        raise ConfigError(
            f"{path} is read as it is: {', '.join(settings)} cannot be set", hint="--realtime plays it as a simulated camera"
        )
