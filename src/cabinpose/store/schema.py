"""The dataset standard, version 2: the manifest `dataset.yaml`; `variables` has what a frame consists of.

The manifest says what a folder holds and how it was made; the parts beside it hold the frames. Both carry the
schema version: 1 is read as it was written, 2 is written, and what is unknown is refused.

The last line of the manifest is the checksum of the lines before it. Datasets made before there was one are read as well.
"""

from __future__ import annotations

import hashlib
import json
import operator
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal, overload

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from cabinpose.core import JOINTS, OCCUPANT_SLOTS, OTHER_SKELETONS, DatasetError, explained, left_before, parse_yaml
from cabinpose.store.variables import AXES, DEFAULT_VARIABLES, SCHEMA_VERSION, VARIABLES, Variable, joint_dimension

SCHEMA: Final = "cabinpose-dataset"
READABLE: Final = (1, SCHEMA_VERSION)  # versions
MANIFEST_NAME = "dataset.yaml"
_MOST_NAMES: Final = 1000  # of persons, and of joints
MOST_LISTED_PARTS: Final = 100_000  # in dataset.yaml; of more it states their number
_PART = re.compile(r"part-(\d{5}|[1-9]\d{5,})\.zarr")
CHECKSUM_PREFIX: Final = "sha256:"
_CONTENT: Final = "content"  # in the configuration of an import
SELECTION: Final = "selection"  # in the configuration of frames that were chosen of another dataset


def _is_none(value: object) -> bool:
    return value is None


class LabelRow(BaseModel):
    """A pixel class: id, name and sRGB colour 0xRRGGBB; ticam: the class of TICaM's masks, where there are things."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    id: Annotated[int, Field(ge=0, le=255)]
    name: Annotated[str, Field(pattern=r"^\S+$")]
    rgb: Annotated[int, Field(ge=0, le=0xFFFFFF)]
    ticam: Annotated[int | None, Field(ge=0, le=16, exclude_if=_is_none)] = None


@dataclass(frozen=True)
class PartPlan:
    """Which frames belong to which part: the frames [first, first + frames)."""

    index: int
    first: int
    frames: int

    @property
    def name(self) -> str:
        return f"part-{self.index:05d}.zarr"


class PartPlans(Sequence[PartPlan]):
    """The plans of parts, in order, each made when it is asked for: those of a billion frames take no memory."""

    def __init__(self, frames: int, frames_per_part: int, without: Sequence[int] = ()) -> None:
        """without: numbers of the parts that are left out, ascending."""
        self._frames, self._size = frames, frames_per_part
        self._gaps = np.array(without, np.int64) - np.arange(len(without))  # how many parts stay before each that is left out
        self._count = -(-frames // frames_per_part) - len(without)

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, number: int) -> PartPlan: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[PartPlan]: ...

    def __getitem__(self, number: int | slice) -> PartPlan | Sequence[PartPlan]:
        if isinstance(number, slice):
            return [self[n] for n in range(*number.indices(self._count))]
        place = number + self._count if number < 0 else number
        if not 0 <= place < self._count:
            raise IndexError(number)
        index = place + int(np.searchsorted(self._gaps, place, side="right")) if len(self._gaps) else place
        return PartPlan(index, index * self._size, min(self._size, self._frames - index * self._size))

    def without(self, numbers: Sequence[int]) -> PartPlans:
        """All but those of these numbers, ascending."""
        return PartPlans(self._frames, self._size, numbers)

    @property
    def frames(self) -> int:
        """How many frames they have together."""
        return self._size * (self._count - 1) + self[-1].frames if self._count else 0


class Manifest(BaseModel):
    """What `dataset.yaml` says. Frozen; raises `DatasetError` through `from_mapping`, else pydantic's error.

    checksum: as the file states it; None where it was written before there was one, and in a manifest that is not of a file.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    schema_name: Literal["cabinpose-dataset"] = Field(default=SCHEMA, alias="schema")
    schema_version: Literal[1, 2] = SCHEMA_VERSION
    generator: str
    generator_version: str
    seed: int
    licence: str
    frames: Annotated[int, Field(ge=1)]
    frames_per_part: Annotated[int, Field(ge=1)] = 100
    width: Annotated[int, Field(ge=1)]
    height: Annotated[int, Field(ge=1)]
    persons: Annotated[tuple[str, ...], Field(min_length=1, max_length=_MOST_NAMES)] = OCCUPANT_SLOTS
    joints: Annotated[tuple[str, ...], Field(min_length=1, max_length=_MOST_NAMES)] = JOINTS
    # `ANATOMY`; "" = as what made it placed them then, which older datasets do not say.
    joint_definition: Annotated[str, Field(max_length=_MOST_NAMES, exclude_if=operator.not_)] = ""
    variables: tuple[str, ...] = DEFAULT_VARIABLES
    labels: tuple[LabelRow, ...] = ()
    materials: tuple[dict[str, Any], ...] = ()
    config: dict[str, Any] = Field(default_factory=dict)
    # The id of the dataset of version 1 that it was, which predictions and labels go on naming it by.
    upgraded_from: Annotated[str, Field(max_length=_MOST_NAMES, exclude_if=operator.not_)] = ""
    checksum: str | None = Field(default=None, exclude=True)

    @model_validator(mode="after")
    def _check_names(self) -> Manifest:
        known = [each.name for each in VARIABLES if each.named(self.schema_version)]
        unknown = sorted(set(self.variables) - set(known))
        if unknown:
            raise ValueError(f"unknown variables: {', '.join(unknown)} (known: {', '.join(known)})")
        for what in ("persons", "joints", "variables"):
            names = getattr(self, what)
            if len(set(names)) != len(names):
                raise ValueError(f"{what} names one entry twice")
        for key in ("id", "name"):
            values = [getattr(row, key) for row in self.labels]
            if len(set(values)) != len(values):
                raise ValueError(f"two labels share one {key}")
        return self

    @classmethod
    def from_mapping(cls, data: Any, source: Path | str) -> Manifest:
        """The manifest that `data` (read from `source`) describes; `DatasetError` if it is none, or of another version."""
        if not isinstance(data, Mapping) or data.get("schema") != SCHEMA:
            raise DatasetError(f"{source} is not the manifest of a dataset", hint=f"it should say `schema: {SCHEMA}`")
        check_version(data.get("schema_version"), source)
        values = {key: value for key, value in data.items() if key != "parts"}
        try:
            manifest = cls.model_validate(values)
        except ValidationError as error:
            raise DatasetError(str(explained(error, cls, values, at=f"{source}: ", lists="")), hint=_RESTORE) from error
        listed = data.get("parts")
        # The number first: a damaged count of frames must not make a list of millions.
        count = manifest.part_count
        if not (
            len(listed) == count and listed == manifest.listed_parts()
            if isinstance(listed, list)
            else count > MOST_LISTED_PARTS and listed == count
        ):
            raise DatasetError(f"{source}: its parts are not those of {manifest.frames} frames", hint=_RESTORE)
        return manifest

    def to_mapping(self) -> dict[str, Any]:
        """Plain data in the order of the file, the derived list of parts at its end, or of very many their number."""
        data = self.model_dump(mode="json", by_alias=True)
        data["parts"] = self.listed_parts() if self.part_count <= MOST_LISTED_PARTS else self.part_count
        return data

    def listed_parts(self) -> list[dict[str, Any]]:
        """The parts as plain data, in order."""
        return [{"name": p.name, "first": p.first, "frames": p.frames} for p in self.parts]

    @cached_property
    def parts_belong_to(self) -> str:
        """What each part names its dataset by: a checksum of the manifest without what may change while the parts stay the same.

        That is the number of frames, which `--resume` raises, the licence, what it was upgraded from, and the content of an
        import, which is known when its parts are written. A field that is added to the manifest has to be left out where it has
        its default, or the parts of older datasets are taken for another dataset's.
        """
        data = self.model_dump(
            mode="json", by_alias=True,
            exclude={"frames": True, "licence": True, "upgraded_from": True, "config": {_CONTENT}},
        )  # fmt: skip
        return checksum(json.dumps(data, sort_keys=True))

    @property
    def content(self) -> str | None:
        """The checksum of the last part of a dataset whose manifest does not decide what its frames are; with those that each
        part names, it holds all their bytes. None in datasets that are generated, and in those written before there was one.
        """
        return self.config.get(_CONTENT)

    @property
    def selection(self) -> dict[str, Any]:
        """Of frames that were chosen of another dataset: `of` its id, its `name`, the `frames` by their numbers there, `by` what
        they were chosen, their `split`, and its own selection `before`. Else empty.
        """
        found = self.config.get(SELECTION)
        return found if isinstance(found, dict) else {}

    @property
    def own_config(self) -> dict[str, Any]:
        """What whoever made the frames was configured with, without what was noted when they were written."""
        return {key: value for key, value in self.config.items() if key not in (_CONTENT, SELECTION)}

    def with_content(self, last: str) -> Manifest:
        """The manifest once the last part is written; last: its checksum."""
        return self.model_copy(update={"config": self.config | {_CONTENT: last}})

    @property
    def part_count(self) -> int:
        """How many parts there are when the dataset is complete."""
        return -(-self.frames // self.frames_per_part)

    @cached_property
    def parts(self) -> PartPlans:
        """All parts, in order."""
        return PartPlans(self.frames, self.frames_per_part)

    def parts_in(self, folder: Path) -> list[PartPlan]:
        """Those that stand in a folder under their final name, in order."""
        entries = folder.iterdir() if folder.is_dir() else ()
        numbers = sorted(int(found[1]) for entry in entries if (found := _PART.fullmatch(entry.name)))
        plans = (self.parts[number] for number in numbers if number < self.part_count)
        return [plan for plan in plans if (folder / plan.name).is_dir()]

    @cached_property
    def stored(self) -> tuple[Variable, ...]:
        """The variables that every frame of this dataset has, in the standard's order."""
        return tuple(v for v in VARIABLES if v.stored(self.schema_version) or v.name in self.variables)

    def frame_shape(self, variable: Variable) -> tuple[int, ...]:
        """Shape of one frame of a variable."""
        return tuple(self._sizes[dim] for dim in variable.dims[1:])

    @cached_property
    def _sizes(self) -> dict[str, int]:
        return {
            "y": self.height, "x": self.width, "channel": 3, "person": len(self.persons), "joint": len(self.joints),
            "k_row": 3, "k_column": 3, "dist_coefficient": 5, "row": 4, "column": 4,
            **{axis: len(names) for axis, names in AXES.items()},
        } | {joint_dimension(each.name): len(each.joints) for each in OTHER_SKELETONS}  # fmt: skip


def check_version(found: object, source: Path | str) -> None:
    """Raise `DatasetError` for a version of the standard that this program does not read."""
    if found not in READABLE:
        raise DatasetError(
            f"{source} has schema version {found}, this program reads versions {' and '.join(map(str, READABLE))}",
            hint="read it with the version of cabinpose that wrote it, or upgrade cabinpose",
        )


def label_attributes(manifest: Manifest) -> dict[str, Any]:
    """The table of classes as attributes of `labels`: CF's flag_values and flag_meanings, and colours 0xRRGGBB."""
    rows = manifest.labels
    if not rows:
        return {}
    return {
        "flag_values": tuple(row.id for row in rows),
        "flag_meanings": " ".join(row.name for row in rows),
        "flag_rgb": tuple(row.rgb for row in rows),
        **({} if any(row.ticam is None for row in rows) else {"flag_ticam": tuple(row.ticam for row in rows)}),
    }


def variable_attributes(manifest: Manifest, variable: Variable) -> dict[str, Any]:
    """What a variable's attributes say of its values as they are read: meaning, unit, classes."""
    attrs: dict[str, Any] = {"long_name": variable.meaning}
    if variable.units is not None:
        attrs["units"] = variable.units
    return attrs | (label_attributes(manifest) if variable.name == "labels" else {})


class _Dumper(yaml.SafeDumper):
    """Safe YAML without anchors, so that equal values read as values."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002 - the signature is PyYAML's
        return True


_RESTORE = "restore the file as it was written"


def manifest_yaml(manifest: Manifest) -> str:
    """The text of `dataset.yaml` before its checksum: same manifest, same bytes."""
    return yaml.dump(
        manifest.to_mapping(), Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True
    )


def checksum(text: str) -> str:
    """What `dataset.yaml` and the parts state of their own content."""
    return CHECKSUM_PREFIX + hashlib.sha256(text.encode()).hexdigest()[:16]


def dataset_id(manifest: Manifest) -> str:
    """What predictions and labels name their dataset by: the checksum of `dataset.yaml`, before it was upgraded."""
    return manifest.upgraded_from or checksum(manifest_yaml(manifest))


def with_checksum_line(text: str) -> str:
    """The whole of `dataset.yaml`, of what `manifest_yaml` gives."""
    return f"{text}checksum: {checksum(text)}\n"


def read_manifest(folder: Path | str) -> Manifest:
    """The manifest of a dataset folder; `DatasetError` if there is none, it cannot be read or its checksum is wrong."""
    path = Path(folder) / MANIFEST_NAME
    try:
        text = path.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError):
        if not Path(folder).exists():
            if (old := left_before(Path(folder))) is not None:
                raise DatasetError(f"a writer of {folder} was ended while it replaced it", hint=f"mv {old} {folder}") from None
            raise DatasetError(f"{folder} does not exist", hint="give the folder of a dataset") from None
        raise DatasetError(
            f"{folder} holds no dataset: {MANIFEST_NAME} is missing", hint="give the folder that holds dataset.yaml"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"cannot read {path}: {error}", hint="check the folder and its permissions") from error
    content, line, stated = text.rpartition("\nchecksum: ")
    if line and stated.rstrip() != (right := checksum(content + "\n")):
        raise DatasetError(
            f"{path} was changed or damaged: the checksum of its content is {right}, its last line says {stated[:40].rstrip()}",
            hint=f"{_RESTORE}; after a change of the licence on purpose, write the first of the two checksums into the last line",
        )
    if line and not text.endswith("\n"):
        raise DatasetError(f"{path} is cut off: its last line has no end", hint=_RESTORE)
    try:
        data = parse_yaml(text)
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date or a number that cannot be
        raise DatasetError(f"{path} is not YAML: {error}", hint=_RESTORE) from error
    return Manifest.from_mapping(data, path)
