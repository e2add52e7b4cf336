"""The dimensions that define a cabin, under the codes of SAE J1100 (Motor Vehicle Dimensions).

Millimetres and degrees here, as on an engineer's sheet; everything built from them is in metres and radians. The
limits are those of class A vehicles (SAE J1100, J4004: seat heights of 127 to 405 mm, and somewhat beyond for
shuttles), the defaults those of a mid-size sedan.
"""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from cabinpose.core import ConfigError, explained


def _dimension(code: str, default: float, low: float, high: float, meaning: str) -> Any:
    """A field with its code, its limits and the standard that defines it."""
    return Field(default, ge=low, le=high, description=f"{code}: {meaning} [SAE J1100]", json_schema_extra={"code": code})


SeatStyle = Literal["compact", "comfort", "sport", "captain", "plus2", "bench"]
DashStyle = Literal["simple", "wave", "tier", "driver", "upright", "none"]
ConsoleStyle = Literal["none", "low", "tunnel", "high"]
DoorStyle = Literal["plain", "pocket", "sweep", "sport", "upright", "wall"]


class DimensionFields(BaseModel):
    """Dimensions of a cabin and the styles of its parts."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)

    name: str = Field("custom", description="What the cabin is called in a dataset.")
    layout: Literal["rows", "facing"] = Field("rows", description="Two forward rows, or two benches that face each other.")

    # First row
    h30_mm: float = _dimension("H30-1", 260, 120, 470, "seat height: H-point above the heel point")
    l53_mm: float = _dimension("L53-1", 840, 600, 980, "heel point to H-point, horizontally")
    w20_mm: float = _dimension("W20-1", 365, 280, 480, "H-point to the centre line")
    a40_deg: float = _dimension("A40-1", 25, 8, 35, "torso angle from the vertical")
    a27_deg: float = _dimension("A27-1", 14, 4, 24, "cushion angle from the horizontal")
    h61_mm: float = _dimension("H61-1", 985, 880, 1250, "effective head room: H-point to headlining, 8 deg rearward, + 102 mm")
    w3_mm: float = _dimension("W3-1", 1440, 1200, 1900, "shoulder room between the door trims")
    l23_fore_mm: float = _dimension("L23 fore", 150, 0, 260, "travel of the H-point forward of the design position")
    l23_aft_mm: float = _dimension("L23 aft", 80, 0, 200, "travel of the H-point behind the design position")
    h58_mm: float = _dimension("H58", 50, 0, 100, "vertical travel of the H-point, half up and half down")

    # Second row
    l50_mm: float = _dimension("L50-2", 850, 640, 1900, "couple distance: front H-point to second H-point")
    h30_2_mm: float = _dimension("H30-2", 290, 180, 470, "seat height of the second row above its heel point")
    w20_2_mm: float = _dimension("W20-2", 360, 250, 560, "outer second H-point to the centre line")
    a40_2_deg: float = _dimension("A40-2", 26, 8, 35, "torso angle of the second row")
    a27_2_deg: float = _dimension("A27-2", 15, 4, 24, "cushion angle of the second row")
    h61_2_mm: float = _dimension("H61-2", 960, 840, 1250, "effective head room of the second row")
    w3_2_mm: float = _dimension("W3-2", 1420, 1180, 1900, "shoulder room of the second row")
    rear_places: Literal[2, 3] = Field(3, description="Places in the second row.")

    # Steering
    w9_mm: float = _dimension("W9", 370, 320, 460, "outer diameter of the steering wheel")
    a18_deg: float = _dimension("A18", 25, 12, 50, "plane of the steering wheel from the vertical")
    l11_mm: float = _dimension("L11", 410, 250, 560, "heel point to the wheel's centre, horizontally")
    h17_mm: float = _dimension("H17", 660, 540, 860, "heel point to the wheel's centre, vertically")
    clutch: bool = Field(False, description="Three pedals instead of two.")

    # Openings and roof
    h25_mm: float = _dimension("H25-1", 455, 250, 560, "belt height: H-point to the lower edge of the side glass")
    a121_1_deg: float = _dimension("A121-1", 61, 5, 68, "windscreen slope from the vertical")
    a121_2_deg: float = _dimension("A121-2", 62, 0, 76, "backlight slope from the vertical")
    a122_deg: float = _dimension("A122-1", 20, 0, 30, "tumblehome: side glass from the vertical")
    header_mm: float = Field(440, ge=250, le=800, description="Windscreen header ahead of the front H-point, horizontally.")
    tail_mm: float = Field(430, ge=300, le=900, description="Rear edge of the roof behind the rear H-point, horizontally.")
    roof_drop_mm: float = Field(60, ge=0, le=200, description="Fall of the headlining from rear head to its rear edge.")
    b_pillar_mm: float = Field(230, ge=60, le=800, description="B-pillar at the belt line behind the front H-point.")
    tunnel_mm: float = Field(90, ge=0, le=220, description="Height of the floor tunnel.")

    seat_style: SeatStyle = Field("comfort", description="Shape of the front seats.")
    rear_style: SeatStyle = Field("bench", description="Shape of the rear seats.")
    dash_style: DashStyle = Field("wave", description="Shape of the dashboard.")
    console_style: ConsoleStyle = Field("low", description="Shape of the centre console.")
    door_style: DoorStyle = Field("sweep", description="Shape of the door trim.")
    leather: bool = Field(False, description="Seats covered in leather instead of fabric.")
    centre_headrest: bool = Field(True, description="A headrest on the middle place of the second row.")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        """Dimensions that exclude each other."""
        rows, behind_wheel = self.layout == "rows", self.l53_mm - self.l11_mm
        for wrong, words, hint in (
            (
                2 * self.w20_mm + 460 > self.w3_mm + 40,
                f"two seats at W20 = {self.w20_mm:g} mm do not fit a shoulder room W3 of {self.w3_mm:g} mm",
                "W3 must be at least 2 W20 + 420 mm",
            ),
            (
                2 * self.w20_2_mm + 420 > self.w3_2_mm,
                f"two rear seats at W20-2 = {self.w20_2_mm:g} mm do not fit a shoulder room W3-2 of {self.w3_2_mm:g} mm",
                "W3-2 must be at least 2 W20-2 + 420 mm",
            ),
            (
                rows and behind_wheel < 300,
                f"the wheel (L11 = {self.l11_mm:g} mm) is within {behind_wheel:g} mm of the H-point",
                "L53 - L11 must be at least 300 mm",
            ),
            (
                not rows and self.l50_mm < 1150,
                f"facing benches {self.l50_mm:g} mm apart leave no knee room",
                "L50 must be at least 1150 mm",
            ),
            (
                rows and self.l50_mm > 1300,
                f"a couple distance L50 of {self.l50_mm:g} mm is too long",
                "L50 must be at most 1300 mm",
            ),
            (
                self.h25_mm + 250 > self.h61_mm - 102,
                f"belt height H25 = {self.h25_mm:g} mm leaves no side glass under a head room H61 of {self.h61_mm:g} mm",
                "H25 must be at most H61 - 352 mm",
            ),
            (rows and self.dash_style == "none", "two forward rows have a dashboard", "choose another dash_style than none"),
        ):
            if wrong:
                raise ConfigError(f"car '{self.name}': {words}", hint=hint)
        return self


class CabinDimensions(DimensionFields):
    """Dimensions of a cabin and the styles of its parts; raises `ConfigError` where a value cannot be."""

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise explained(error, type(self), values, lists=f"known: {', '.join(CabinDimensions.model_fields)}") from None
