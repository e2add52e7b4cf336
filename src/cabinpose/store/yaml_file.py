"""Settings in YAML files, with errors that name the key."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from cabinpose.core import CabinposeError, ConfigError, explained, read_yaml

Model = TypeVar("Model", bound=BaseModel)


def read_mapping(path: Path, *, hint: str, error: type[CabinposeError] = ConfigError) -> dict[str, Any]:
    """The mapping in a YAML file; an empty file is an empty one. Raises `error` with the hint where there is none."""
    data = read_yaml(path, hint=hint, error=error)
    if data is not None and not isinstance(data, dict):
        raise error(f"{path} is no mapping of keys to values", hint=hint)
    return data or {}


def validated(
    model: type[Model], data: dict[str, Any], path: Path | None, *, hint: str, error: type[CabinposeError] = ConfigError
) -> Model:
    """The data of a file as a model. Raises `error`, with the hint, that names the first key that does not fit."""
    try:
        return model.model_validate(data)
    except ValidationError as problem:
        raise explained(problem, model, data, at=f"{path}: " if path else "", lists=hint, kind=error) from problem
