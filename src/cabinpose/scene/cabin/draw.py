"""Cars drawn at random: dimensions between those of a low sports car and of a tall van.

The seat height H30 says most about a car's package (Macey and Wardle, "H-Point: The Fundamentals of Car Design and Packaging"):
the higher people sit, the shorter the way from the heel to the H-point, the more upright the torso, the higher and flatter the
steering wheel and the steeper the windscreen. So the height is drawn first, the dimensions that follow it scatter around a line
from the low car to the tall one, and the others are drawn evenly from what production cars have.
"""

from __future__ import annotations

from typing import NamedTuple, get_args

import numpy as np

from cabinpose.scene.cabin.dimensions import CabinDimensions, ConsoleStyle, DoorStyle

_H30_MM = (175.0, 400.0)
_CUT = 2.0  # standard deviations
_FRONT_SEATS = ("compact", "comfort", "sport", "captain")
_REAR_SEATS = ("bench", "captain", "plus2")
_DASHES = ("simple", "wave", "tier", "driver", "upright")


class _Line(NamedTuple):
    """A dimension in the lowest and in the tallest car, and its standard deviation around the line between them."""

    low: float
    tall: float
    sigma: float


_WITH_HEIGHT = {
    "l53_mm": _Line(905, 755, 18),
    "a40_deg": _Line(26.5, 19, 1.2),
    "a27_deg": _Line(17, 11, 0.8),
    "h61_mm": _Line(955, 1055, 14),
    "a18_deg": _Line(21, 36, 2),
    "l11_mm": _Line(440, 350, 10),
    "h17_mm": _Line(605, 735, 10),
    "a121_1_deg": _Line(63, 47, 2.5),
    "a122_deg": _Line(24, 8, 2),
    "roof_drop_mm": _Line(90, 15, 10),
    "tunnel_mm": _Line(140, 10, 30),
}
_EVENLY = {
    "w20_mm": (325.0, 430.0),
    "l50_mm": (790.0, 1000.0),
    "w9_mm": (355.0, 405.0),
    "h25_mm": (430.0, 480.0),
    "a121_2_deg": (10.0, 74.0),
    "header_mm": (415.0, 460.0),
    "tail_mm": (330.0, 560.0),
    "b_pillar_mm": (220.0, 430.0),
}
_SHOULDERS_MM = (635.0, 750.0)  # W3 beyond the two H-points
_SECOND_ROW = {  # what it has more than the first
    "h30_2_mm": (10.0, 50.0),
    "w20_2_mm": (-60.0, 10.0),
    "a40_2_deg": (-1.0, 2.5),
    "h61_2_mm": (-45.0, -10.0),
    "w3_2_mm": (-60.0, 20.0),
}
_SPORT_MM = 230.0  # H30 below which only a sports seat has its shell under the cushion
_CAPTAIN_MM, _CAPTAIN_2_MM = 270.0, 260.0  # H30-1 and H30-2 below which the column of a captain's chair stands in its cushion
_THREE_PLACES_MM = 340.0  # W20-2 that leaves room for somebody in the middle
_LIMITS = {
    code: (field["minimum"], field["maximum"])
    for code, field in CabinDimensions.model_json_schema()["properties"].items()
    if "minimum" in field
}


def random_dimensions(name: str, *, rng: np.random.Generator) -> CabinDimensions:
    """Dimensions of a car with two rows, called `name`."""
    t = rng.random()
    values: dict[str, float] = {"h30_mm": _H30_MM[0] + t * (_H30_MM[1] - _H30_MM[0])}
    for code, line in _WITH_HEIGHT.items():
        scatter = float(np.clip(rng.standard_normal(), -_CUT, _CUT)) * line.sigma
        values[code] = line.low + t * (line.tall - line.low) + scatter
    values |= {code: rng.uniform(*bounds) for code, bounds in _EVENLY.items()}
    values["w3_mm"] = 2 * values["w20_mm"] + rng.uniform(*_SHOULDERS_MM)
    for code, bounds in _SECOND_ROW.items():
        values[code] = values[code.replace("_2_", "_")] + rng.uniform(*bounds)
    seat = rng.choice(_FRONT_SEATS).item()
    clutch, leather = bool(rng.random() < 0.5), bool(rng.random() < 0.5)
    rear = rng.choice(_REAR_SEATS).item()
    if values["h30_mm"] < _SPORT_MM:
        seat = "sport"
    elif seat == "captain" and values["h30_mm"] < _CAPTAIN_MM:
        seat = "comfort"
    if rear == "captain" and values["h30_2_mm"] < _CAPTAIN_2_MM:
        rear = "bench"
    return CabinDimensions(
        name=name,
        **{code: round(float(np.clip(value, *_LIMITS[code])), 1) for code, value in values.items()},
        rear_places=3 if values["w20_2_mm"] >= _THREE_PLACES_MM else 2,
        clutch=clutch,
        leather=leather,
        seat_style=seat,
        rear_style=rear,
        dash_style=rng.choice(_DASHES).item(),
        console_style=rng.choice(get_args(ConsoleStyle)).item(),
        door_style=rng.choice([style for style in get_args(DoorStyle) if style != "wall"]).item(),
    )
