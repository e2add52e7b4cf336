"""What a complete part says of itself, held against its files and against the manifest before any frame is read."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from cabinpose.core import DatasetError
from cabinpose.store.schema import MANIFEST_NAME, Manifest, PartPlan, check_version, checksum
from cabinpose.store.shard import check_last_chunks, file_bytes, read_whole
from cabinpose.store.zarr_metadata import ZarrArray, describes, dimension_labels, zarr_arrays

_Count = Annotated[int, Field(ge=0)]
_ANOTHER_IMPORT = "put the parts of this import back, or import again"
_MADE_BY = ("generator", "generator_version", "seed")


class PartFacts(BaseModel):
    """The attributes of a part's `zarr.json` that readers use.

    chunk_crc32c: by the name of an array the checksums that its chunks end with, in order, in hexadecimal; so that a chunk of
    another part is noticed when it is read · checksum, dataset: None where the part was written before there was one · dataset:
    what the manifest calls `parts_belong_to` · after: the checksum of the part before it, in datasets whose manifest does not
    decide what the frames are.
    """

    model_config = ConfigDict(extra="ignore", frozen=True, defer_build=True)

    first_frame: _Count
    frames: _Count
    skipped: tuple[_Count, ...]
    file_sizes: dict[str, _Count]
    chunk_crc32c: dict[str, Annotated[str, Field(pattern="^([0-9a-f]{8})+$")]] = Field(default_factory=dict)
    proposals: _Count | None = None
    rejections: dict[str, _Count] = Field(default_factory=dict)
    checksum: str | None = None
    dataset: str | None = None
    after: str | None = None
    generator: str | None = None
    generator_version: str | None = None
    seed: int | None = None

    def crcs(self, array: str) -> bytes:
        """The checksums of an array's chunks as they stand at their ends; b"" in parts that do not state them."""
        return bytes.fromhex(self.chunk_crc32c.get(array, ""))


def check_parts(folder: Path, plans: Sequence[PartPlan], manifest: Manifest) -> list[PartFacts]:
    """The facts of the complete parts of a folder, each by `check_part`, and whether each follows the one that it was made after.

    Raises `DatasetError` as `check_part` does, and where one of two neighbours was put there from another import.
    """
    arrays = lru_cache(partial(zarr_arrays, manifest))  # most parts hold as many frames
    facts = [check_part(folder / plan.name, plan, manifest, arrays) for plan in plans]
    for number in range(1, len(plans)):
        before, plan, after = plans[number - 1], plans[number], facts[number].after
        if before.index + 1 == plan.index and after is not None and after != facts[number - 1].checksum:
            raise DatasetError(
                f"{before.name} and {plan.name} in {folder} do not belong together: {plan.name} was made after a part whose "
                f"checksum is {after}, that of {before.name} is {facts[number - 1].checksum}",
                hint=_ANOTHER_IMPORT,
            )
    whole = bool(plans) and plans[-1].index + 1 == manifest.part_count
    if whole and manifest.content is not None and facts[-1].checksum != manifest.content:
        raise DatasetError(
            f"the parts in {folder} are of another import with the same settings: {MANIFEST_NAME} says that the last part's"
            f" checksum is {manifest.content}, that of {plans[-1].name} is {facts[-1].checksum}",
            hint=_ANOTHER_IMPORT,
        )
    return facts


def check_part(path: Path, plan: PartPlan, manifest: Manifest, arrays_of: Callable[[int], tuple[ZarrArray, ...]]) -> PartFacts:
    """The facts of a complete part, after comparing its checksum, file sizes, arrays and names with what they should be.

    arrays_of: those of a part that holds so many frames. Of each file the checksum of its last chunk is held against the part's;
    all are compared when they are read. Raises `DatasetError` naming the part and the file where something is missing, damaged or
    not as the manifest says.
    """
    hint = f"delete {path} and run the command that made it with --resume"
    facts, arrays = _read(path, hint)
    if facts.dataset is not None and facts.dataset != manifest.parts_belong_to:
        raise _another_datasets(path, facts, manifest)
    if (facts.first_frame, facts.frames + len(facts.skipped)) != (plan.first, plan.frames):
        raise DatasetError(f"{path.name} does not hold the frames that {MANIFEST_NAME} says", hint=hint)
    folder = str(path)
    for name, size in facts.file_sizes.items():
        try:
            found = os.stat(f"{folder}/{name}").st_size  # noqa: PTH116 - a third of the time of `Path.stat`
        except (OSError, ValueError):  # ValueError: no name that a file can have
            raise DatasetError(f"{path.name} is damaged: {name} is missing", hint=hint) from None
        if found != size:
            raise DatasetError(f"{path.name} is damaged: {name} has {found} bytes instead of {size}", hint=hint)
    for array in arrays_of(facts.frames):
        try:
            own = file_bytes(f"{folder}/{array.name}/zarr.json").decode()
            agrees = _parsed(own) == arrays.get(array.name)
        except (OSError, ValueError, RecursionError) as error:
            raise DatasetError(f"{path.name} is damaged: {array.name}/zarr.json cannot be read", hint=hint) from error
        if not agrees:
            raise DatasetError(f"{path.name} is damaged: {array.name}/zarr.json does not agree with zarr.json", hint=hint)
        if not _describes(own, array):
            raise _disagrees(path, f"the shape, type or classes of {array.name}")
        try:
            check_last_chunks(f"{folder}/{array.name}/c", len(array.dims), facts.crcs(array.name), image=array.is_image)
        except (OSError, ValueError) as error:
            raise DatasetError(f"{path.name} is damaged: {array.name} is {error}", hint=hint) from error
    skipped = set(facts.skipped)
    numbers = tuple(number for number in range(plan.first, plan.first + plan.frames) if number not in skipped)
    expected = {name: (labels, "str") for name, labels in dimension_labels(manifest).items()} | {"frame": (numbers, "int64")}
    for name, (values, kind) in expected.items():
        try:
            stored = tuple(read_whole(f"{folder}/{name}/c", (len(values),), kind, facts.crcs(name)).tolist())
        except (OSError, ValueError, RuntimeError) as error:
            raise DatasetError(f"{path.name} is damaged: cannot read {name} ({error})", hint=hint) from error
        if stored != values:
            raise _disagrees(path, f"the {'numbers' if name == 'frame' else 'names'} of {name}")
    return facts


@lru_cache(maxsize=256)
def _parsed(text: str) -> Any:
    """What a `zarr.json` of an array says, which is the same in most parts."""
    return json.loads(text)


@lru_cache(maxsize=256)
def _describes(text: str, array: ZarrArray) -> bool:
    return describes(_parsed(text), array)


def _read(path: Path, hint: str) -> tuple[PartFacts, dict[str, Any]]:
    """What a part's own `zarr.json` says of the part and of its arrays."""
    try:
        text = (path / "zarr.json").read_text(encoding="utf-8")
        group = json.loads(text)
        check_version(group["attributes"]["schema_version"], path.name)
        facts = PartFacts.model_validate(group["attributes"])
        arrays: dict[str, Any] = dict(group["consolidated_metadata"]["metadata"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise DatasetError(f"{path.name} is damaged: its zarr.json cannot be read", hint=hint) from error
    if facts.checksum is not None and checksum(text.replace(facts.checksum, "", 1)) != facts.checksum:
        raise DatasetError(f"{path.name} is damaged: its zarr.json does not have the checksum that it states", hint=hint)
    return facts, arrays


def _another_datasets(path: Path, facts: PartFacts, manifest: Manifest) -> DatasetError:
    both = [(name.replace("_", " "), getattr(facts, name), getattr(manifest, name)) for name in _MADE_BY]
    differing = [f"its {name} is {own!r}, {MANIFEST_NAME} says {stated!r}" for name, own, stated in both if own != stated]
    what = "; ".join(differing) or f"generator and seed are those of {MANIFEST_NAME}, its configuration is another"
    ids = f"it names {facts.dataset}, the parts of this one {manifest.parts_belong_to}"
    return DatasetError(
        f"{path} is a part of another dataset: {what} ({ids})",
        hint=f"move it back to where it came from, then run the command that made this dataset with --resume; "
        f"if {MANIFEST_NAME} was changed, restore it as it was written",
    )


def _disagrees(path: Path, what: str) -> DatasetError:
    return DatasetError(
        f"{path.name} and {MANIFEST_NAME} do not agree on {what}",
        hint=f"restore {MANIFEST_NAME} as it was written; if the part is of another dataset, delete it",
    )
