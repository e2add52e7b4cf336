"""A rig: which devices are recorded, and how. A YAML file, checked before anything connects or listens.

Sources are chosen by kind, see `sources.SOURCES`. A class is imported only when a rig names its kind.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from cabinpose.core import ConfigError, ExtensionError, explained, read_yaml
from cabinpose.record.sources.base import SOURCES
from cabinpose.record.split import Limit
from cabinpose.signals import FrameSource, HostClock
from cabinpose.store.recording import Compression, Take

_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
_RESERVED = ("take",)


class Storage(BaseModel):
    """How the recording is written."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    compression: Compression = Field("none", description="of chunks: none is fastest, lz4 costs little, zstd saves most")
    queue_mb: float = Field(256.0, gt=0, le=65536, description="what may wait for the disk, of each source, MB")
    queue_s: float = Field(
        5.0, gt=0, le=600, description="and for how long, s: the death of the process costs this and flush_s at most"
    )
    chunk_mb: float = Field(4.0, gt=0, le=256, description="a chunk is closed when it is so large, MB")
    flush_s: float = Field(0.25, gt=0, le=10, description="or so old, s")
    sync_s: float = Field(
        1.0, ge=0, le=600, description="pause between requests to the disk to hold it all, s; 0 = only at the end"
    )
    split_every: str | None = Field(None, description="go on in a new file after so long or so much: 10min, 2GB; left out: never")
    min_free_mb: float = Field(512.0, ge=0, description="the take ends before the disk has less free, MB")

    @field_validator("split_every")
    @classmethod
    def _limit(cls, text: str | None) -> str | None:
        if text is not None:
            Limit.of(text)
        return text


class RigFile(BaseModel):
    """A rig's configuration as it stands in its file; what a source takes is checked by its kind."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    take: Take = Field(default_factory=Take, description="who does what, where")
    storage: Storage = Field(default_factory=Storage, description="how the recording is written")
    sources: dict[str, dict[str, Any]] = Field(
        min_length=1, description="by name: `kind`, `required` (true unless said otherwise), and what the kind takes"
    )

    @field_validator("sources")
    @classmethod
    def _names(cls, sources: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        for name in sources:
            if not _NAME.fullmatch(name) or name in _RESERVED:
                raise ValueError(f"'{name}' is no name for a source: small letters, digits, _ and -, up to 32; not 'take'")
        return sources


@dataclass(frozen=True)
class SourcePlan:
    """A source that a rig names: its class and checked settings."""

    name: str
    kind: str
    make: Any  # the class: name, settings and clock give a FrameSource
    settings: BaseModel
    required: bool = True  # a take is not well without it

    def build(self, clock: HostClock) -> FrameSource:
        """The source, not yet open."""
        source: FrameSource = self.make(self.name, self.settings, clock=clock)
        return source


@dataclass(frozen=True)
class Rig:
    """A checked rig; `text` is the file, which recordings keep."""

    take: Take
    storage: Storage
    sources: tuple[SourcePlan, ...]
    text: str


def kinds() -> dict[str, str]:
    """Where the class of each kind is. Deprecated: `record.sources.SOURCES` has names and classes."""
    warnings.warn("record.kinds() will go: use record.sources.SOURCES.names()", DeprecationWarning, stacklevel=2)
    return {kind: f"{source.__module__}:{source.__qualname__}" for kind, source in SOURCES.items()}


def load_rig(path: Path) -> Rig:
    """Read and check a rig's file.

    Parameters
    ----------
    path
        A YAML file; relative paths in it are taken from its folder.

    Raises
    ------
    ConfigError
        Naming the key, the reason and what is possible.
    DependencyError
        Where a kind of source needs what is not installed.
    """
    data = read_yaml(path, hint="docs/recording.md has a rig to start from")
    return parse_rig(data, path.read_text(encoding="utf-8"), base=path.parent)


def parse_rig(data: Any, text: str = "", *, base: Path = Path()) -> Rig:
    """Check plain data; relative paths in the settings of sources are taken from `base`."""
    file = _checked(RigFile, data)
    plans = tuple(_plan(name, dict(settings), base) for name, settings in file.sources.items())
    return Rig(_seated(file.take), file.storage, plans, text)


def load_take(path: Path) -> Take:
    """Read and check a file with a take alone. Raises ConfigError."""
    return _seated(_checked(Take, read_yaml(path, hint="docs/recording.md says what a take is")))


def _seated(take: Take) -> Take:
    """The take. Raises ConfigError for two people on one seat; recordings from before may have them."""
    seats = [subject.seat for subject in take.subjects if subject.seat is not None]
    if twice := [seat for seat in seats if seats.count(seat) > 1]:
        raise ConfigError(f"two subjects of the take sit on {twice[0]}", hint="give each a `seat` of their own")
    return take


def _plan(name: str, settings: dict[str, Any], base: Path) -> SourcePlan:
    kind = settings.pop("kind", None)
    try:
        make = SOURCES[str(kind)]
    except (ConfigError, ExtensionError) as error:
        raise type(error)(f"sources.{name}: {error}", hint=error.hint) from error
    required = settings.pop("required", True)
    if not isinstance(required, bool):
        raise ConfigError(
            f"sources.{name}.required: {required!r} is neither true nor false", hint="false: the take may end well without it"
        )
    checked = _checked(make.Settings, settings, "sources", name)
    paths = {key: base / value for key, value in checked if isinstance(value, Path) and not value.is_absolute()}
    return SourcePlan(name, str(kind), make, checked.model_copy(update=paths), required)


def _checked(model: Any, data: Any, *where: str) -> Any:
    if not isinstance(data, dict):
        raise ConfigError(
            f"{'.'.join(where) or 'what stands here'} is a mapping of keys to values",
            hint="docs/recording.md has a rig to start from",
        )
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise explained(error, model, data, at=".".join(where), lists=f"keys here: {', '.join(model.model_fields)}") from error
