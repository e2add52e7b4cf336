"""Who did what in a take, and where. Codes only, no names: the label of a recording must not be personal data."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator

from cabinpose.core import OCCUPANT_SLOTS, DriveSide

_CODE = re.compile(r"(?=.*\d)[A-Za-z0-9][A-Za-z0-9_.-]{0,31}")
_WORDS = re.compile(r"[A-Za-z0-9][A-Za-z0-9_. /-]{0,63}")


def _code(value: str) -> str:
    if not _CODE.fullmatch(value):
        raise ValueError("a code has a digit and no blank (S07), so that no name passes for one; up to 32 letters, digits, _ . -")
    return value


def _words(value: str) -> str:
    if value and not _WORDS.fullmatch(value):
        raise ValueError("it begins with a letter or a digit; at most 64 letters, digits, blanks, _ . / -")
    return value


Code = Annotated[str, AfterValidator(_code)]
Words = Annotated[str, AfterValidator(_words)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Participant(_Model):
    """One person in a take."""

    code: Code = Field(description="Subject code; who it stands for is kept elsewhere. It has a digit: S07.")
    seat: str | None = Field(None, description=f"Where: {', '.join(OCCUPANT_SLOTS)}; left out where there are no seats.")
    consent: Words = Field("", description="Reference of the consent under which this was recorded.")

    @field_validator("seat")
    @classmethod
    def _known(cls, seat: str | None) -> str | None:
        if seat is not None and seat not in OCCUPANT_SLOTS:
            raise ValueError(f"a seat is one of {', '.join(OCCUPANT_SLOTS)}")
        return seat


class Take(_Model):
    """Who did what, where. No personal names anywhere."""

    action: Words = Field("", description="What is done, as a short word: reach, drive.")
    car: Words = Field("", description="The car or mock-up.")
    drive_side: DriveSide | None = Field(
        None, exclude_if=lambda side: side is None, description="Side of the wheel in the car; left out where it is not known."
    )
    rig: Words = Field(
        "", exclude_if=lambda name: not name,
        description="The rig as it stands; another word once something is moved or exchanged, for it to be calibrated again.",
    )  # fmt: skip
    subjects: tuple[Participant, ...] = Field((), description="The people recorded.")

    @field_validator("subjects")
    @classmethod
    def _once(cls, subjects: tuple[Participant, ...]) -> tuple[Participant, ...]:
        codes = [subject.code for subject in subjects]
        if len(set(codes)) < len(codes):
            raise ValueError("a subject is named twice")
        return subjects

    @property
    def codes(self) -> tuple[str, ...]:
        """Codes of the subjects."""
        return tuple(subject.code for subject in self.subjects)

    def as_metadata(self) -> dict[str, str]:
        """Text for an MCAP metadata record; several subjects' values are separated by commas, in one order."""
        return {
            "subject": ",".join(self.codes),
            "seat": ",".join(subject.seat or "" for subject in self.subjects),
            "consent": ",".join(subject.consent for subject in self.subjects),
            "action": self.action,
            "car": self.car,
            **({} if self.drive_side is None else {"drive_side": self.drive_side}),
            **({"rig": self.rig} if self.rig else {}),
        }

    @classmethod
    def from_metadata(cls, values: Mapping[str, str]) -> Take:
        """The take of a metadata record. Raises ValueError (pydantic's) where it is none."""
        columns = [values.get(key, "").split(",") for key in ("subject", "seat", "consent")]
        subjects: list[dict[str, Any]] = [
            {"code": code, "seat": seat or None, "consent": consent} for code, seat, consent in zip(*columns, strict=True) if code
        ]
        about = {key: values.get(key, "") for key in ("action", "car", "rig")}
        return cls.model_validate({**about, "drive_side": values.get("drive_side"), "subjects": subjects})
