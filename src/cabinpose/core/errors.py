"""The error family of the package.

Every error that a user can mend derives from `CabinposeError` and carries the remedy in `hint`. The command
line prints the message and one `hint:` line and exits with 2; anything else is a defect and keeps its traceback.
"""

from __future__ import annotations

from cabinpose.core.synonyms import NAMES, alike


class CabinposeError(Exception):
    """Base of all errors a user can mend; `hint` says what to do about it."""

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        super().__init__(message)
        self.hint = hint

    def in_one_line(self) -> str:
        """The message, with the remedy in brackets where there is one."""
        return f"{self} ({self.hint})" if self.hint else str(self)


class ConfigError(CabinposeError):
    """A configuration value is unknown, out of range or contradicts another one."""


class AssetError(CabinposeError):
    """A packaged asset is missing or damaged."""


class MeshError(CabinposeError):
    """A mesh file cannot be read, or is not fit for its purpose."""


class MocapError(CabinposeError):
    """A motion-capture file cannot be read or lacks what retargeting needs."""


class SceneError(CabinposeError):
    """No valid scene exists, or none was found, for the given configuration."""


class DatasetError(CabinposeError):
    """A dataset folder is damaged, incomplete, of another version or would be overwritten."""


class PredictionsError(CabinposeError):
    """A predictions file cannot be read, or does not fit the dataset that it is held against."""


class ModelError(CabinposeError):
    """A model file is missing, damaged, or of another method or network."""


class RemoteError(CabinposeError):
    """An algorithm's server cannot be reached, fails, or answers what the table of tensors does not allow."""


class RecordingError(CabinposeError):
    """A device cannot be reached, or a recording is damaged, incomplete, of another version or would be overwritten."""


class SourceEndedError(RecordingError):
    """A source has given all that it ever will."""


class AlignmentError(CabinposeError):
    """Data do not determine what is asked of them: a delay, a calibration or a transform."""


class UndeterminedError(AlignmentError):
    """Data that agree with each other say too little for a number of their own; another source of it may do."""


class OutputError(CabinposeError):
    """An output cannot be written, or another process is writing it."""


class DependencyError(CabinposeError):
    """An optional dependency (an extra) is needed and not installed."""


class ExtensionError(CabinposeError):
    """What an installed extension offers cannot be used; the message names its package, and everything else works."""


def unknown_name(kind: str, name: str, known: list[str] | tuple[str, ...]) -> ConfigError:
    """A `ConfigError` for a name that does not exist, listing the ones that do, and before them what may be meant."""
    near = alike(name, known, NAMES)
    meant = f"did you mean {' or '.join(near)}? " if near else ""
    return ConfigError(f"unknown {kind} '{name}'", hint=f"{meant}known: {', '.join(sorted(known))}")
