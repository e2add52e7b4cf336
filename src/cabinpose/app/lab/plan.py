"""What is recorded in the virtual laboratory, and the names of its files."""

from __future__ import annotations

from typing import Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

SESSION, RIG = "session.yaml", "rig.yaml"
BOARD, PENDULUM = "board.mcap", "pendulum.mcap"
PAIR = "together.mcap"
RIG_TAKES, PERSON_TAKES = 2, 4


class Plan(BaseModel):
    """What is recorded in the laboratory."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    views: int = Field(50, ge=6, description="Poses of the checkerboard.")
    frames_per_view: int = Field(3, ge=1, description="Frames of the camera in each, which are averaged.")
    pendulum_s: float = Field(25.0, gt=5, description="Length of the pendulum's take, s.")
    seconds: float = Field(20.0, gt=1, description="Length of the driver's take, s.")
    rate_hz: float | None = Field(None, gt=0, description="Frames per second of the camera in it; default: the rig's.")
    exercises: bool = Field(True, description="Record movements in each anatomical plane outside the car as well.")
    together: bool = Field(False, description="Record the first two subjects in one car as well, each in a suit of their own.")
    car: str = Field("sedan", description="Name of a preset car.")
    subjects: tuple[str, ...] = Field(("S01",), min_length=1, description="People who are recorded, one after the other.")
    seed: int = Field(0, ge=0, description="Seed of all random numbers.")

    @model_validator(mode="after")
    def _has_people(self) -> Self:
        if len(set(self.subjects)) < len(self.subjects):
            raise ValueError("a subject is named twice")
        if self.together and len(self.subjects) < 2:
            raise ValueError("together needs two subjects")
        return self

    @property
    def steps(self) -> int:
        """Takes of the session."""
        return RIG_TAKES + PERSON_TAKES * len(self.subjects) + self.together


def head_take(subject: str) -> str:
    """Name of the recording of a subject's turning head."""
    return f"head-{subject}.mcap"


def pose_take(subject: str) -> str:
    """Name of the recording of a subject's N-pose."""
    return f"pose-{subject}.mcap"


def drive_take(subject: str) -> str:
    """Name of the recording of a subject who drives."""
    return f"drive-{subject}.mcap"


def exercise_take(subject: str) -> str:
    """Name of the recording of a subject's movements outside the car."""
    return f"exercises-{subject}.mcap"
