"""The keys of a configuration that make sequences of its frames."""

from __future__ import annotations

import operator

from pydantic import Field, field_validator

from cabinpose.synth.motion.activities import program_of
from cabinpose.synth.people import Model


class SequenceConfig(Model):
    """Frames that follow each other: the same people in the same car, in motion, seen by the same camera."""

    frames: int = Field(90, ge=2, le=10_000, description="Frames of one sequence.")
    rate_hz: float = Field(30.0, gt=0.0, le=1000.0, description="Frames a second.")
    activities: tuple[str, ...] | None = Field(
        None, min_length=1, description="What people do, as far as it makes sense in their seats; left out: anything."
    )

    exposure_motion: bool = Field(
        False,
        exclude_if=operator.not_,
        description="People move on while the camera exposes its correlation samples, one after the other: motion artefacts.",
    )

    def first_of(self, index: int) -> int:
        """The frame with which the sequence of a frame begins."""
        return index // self.frames * self.frames

    @field_validator("activities")
    @classmethod
    def _known(cls, names: tuple[str, ...] | None) -> tuple[str, ...] | None:
        for name in names or ():
            program_of(name)
        return names
