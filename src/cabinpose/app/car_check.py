"""The check of a user's own car: its YAML compared with its mesh, poses tried in its seats, rules to add."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cabinpose.core import ConfigError, Matrix, apply, invert
from cabinpose.scene import LABELS, MATERIALS
from cabinpose.scene.cabin import (
    COMMON_RULES,
    Cabin,
    CabinFile,
    Measure,
    Part,
    Rule,
    Seat,
    file_from_vehicle,
    load_cabin,
    measured,
    read_car_file,
)
from cabinpose.scene.contact import FLESH_M, first_crossings, sampled_surface
from cabinpose.synth import SEAT_BOXES, SITTING, SeatSide, SeatTrial, try_seats

Floats = NDArray[np.float64]
POSES = 12  # tried in each seat
_STEP_MM = 5.0  # a suggested `give_mm` is rounded up to a multiple of this
_FOAM_MM = 90.0  # thickest foam; where more is needed, the H-point is wrong
_CUSHION_OFF_M, _CUSHION_DEEP_M = 0.03, 0.30
_FLOOR_OFF_M = 0.05
_REACH_M = 0.85  # from the shoulder to the wheel's hub: the longest arm with a bent elbow
_SHOULDER = np.array((0.0, 0.0, 0.48))  # from the H-point along the back, m
_HEAD = np.array((0.0, 0.0, 0.62))
_OPEN_DIRECTIONS = 0.40  # of a sphere about the head: windows without glass are about 0.3 of it
_BINS = (12, 24)  # in the sine of the elevation and in the azimuth: about 15 degrees each
_OFTEN = 2  # poses refused for trunk or thighs, or pushed away, in one seat, before a rule is suggested
_ROUNDS = 3  # of deepening rules: with softer seats people sink deeper
_HARD = ("glass", "floor", "pedal", "steering_wheel")  # labels of what no rule should soften


@dataclass(frozen=True)
class CarReport:
    """What was found of a car.

    unnamed: meshes that no rule but the last names · trials: by slot · advice: what is wrong with points rather than with rules ·
    rules: to add before the others · mended: the trials with them, None where there are none · sizes: of the car ·
    refused: why `synth` refuses it, None where it does not; no pose was tried then.
    """

    spec: CabinFile
    cabin: Cabin
    unnamed: tuple[str, ...]
    warnings: tuple[str, ...]
    trials: Mapping[str, SeatTrial]
    advice: tuple[str, ...]
    rules: tuple[Rule, ...]
    mended: Mapping[str, SeatTrial] | None
    sizes: tuple[Measure, ...]
    refused: ConfigError | None


def check_car(path: Path) -> CarReport:
    """Load the car of a YAML file as `synth` would, and try people in its seats.

    Raises ConfigError, MeshError or DependencyError as `load_cabin` does.
    """
    spec = read_car_file(path)
    cabin, refused = _loaded(path, spec)
    trials = mended = {} if refused else try_seats(cabin, poses=POSES)
    rules: list[Rule] = []
    advice: tuple[str, ...] = ()
    changed, softer = spec, cabin
    for _ in range(0 if refused else _ROUNDS):
        more, advice = _remedies(changed, softer, mended, file_from_vehicle(path, spec))
        if not more:
            break
        rules = _merged((*more, *rules))
        changed = spec.model_copy(update={"rules": (*rules, *spec.rules)})
        softer = load_cabin(path, changed)
        mended = try_seats(softer, poses=POSES)
    if _held(mended) <= _held(trials):  # softer seats are not what it takes
        rules = []
    named = [rule for rule in (*spec.rules, *COMMON_RULES[:-1]) if rule.within is None]
    unnamed = {part.name for part in cabin.parts if not part.mesh and not any(rule.names(part.name) for rule in named)}
    return CarReport(
        spec,
        cabin,
        tuple(sorted(unnamed)),
        (*cabin.warnings, *_misplaced(cabin)),
        trials,
        advice,
        tuple(rules),
        mended if rules else None,
        tuple(measured(cabin)),
        refused,
    )


def _loaded(path: Path, spec: CabinFile) -> tuple[Cabin, ConfigError | None]:
    """The car, and why its sizes have it refused, so that these can be drawn."""
    try:
        return load_cabin(path, spec), None
    except ConfigError as error:
        return load_cabin(path, spec, refuse=False), error


def _held(trials: Mapping[str, SeatTrial]) -> int:
    """Number of poses that hold without being pushed off their seat."""
    return sum(trial.held - len(trial.pushed_m) for trial in trials.values())


def kind_of(part: Part) -> str:
    """How a part is classified, in words."""
    give = f", gives {1000 * part.give_m:.0f} mm" if part.give_m else ""
    body = "solid" if part.solid else f"open, felt within {1000 * part.shell_m:.0f} mm"
    return f"{label_of(part)}, {material_of(part)}, moves with {part.group}{give}, {body}"


def label_of(part: Part) -> str:
    """The name of the pixel class of a part."""
    return next(x.name for x in LABELS if x.id == part.surface.label[0])


def material_of(part: Part) -> str:
    """The name of the material of a part."""
    return next(m.name for m in MATERIALS if m.id == part.surface.material[0])


def triangles_of(cabin: Cabin) -> Floats:
    """(F, 3, 3) m, vehicle frame: a car with its seats at their defaults."""
    surface = cabin.surface()
    return surface.vertices.astype(np.float64)[surface.faces]


def _misplaced(cabin: Cabin) -> Iterator[str]:
    """Points and lengths of the YAML that the mesh contradicts, in words."""
    triangles = triangles_of(cabin)
    for slot, seat in cabin.seats.items():
        h, heel = seat.h_point(seat.default), seat.heel_point(seat.default)
        below = _down(triangles, h, _CUSHION_DEEP_M)
        if below is None:
            yield (
                f"{slot}: there is no cushion within {1000 * _CUSHION_DEEP_M:.0f} mm below its H-point {point_text(h)}"
                " (it lies beside the seat, or inside it)"
            )
        elif abs(below - seat.cushion_below_h_m) > _CUSHION_OFF_M:
            yield (
                f"{slot}: the mesh is {1000 * below:.0f} mm below the H-point, the YAML says cushion_below_h_mm:"
                f" {1000 * seat.cushion_below_h_m:.0f}; move the h_point by {1000 * (seat.cushion_below_h_m - below):+.0f} mm"
                " in height, or correct cushion_below_h_mm"
            )
        floor = _down(triangles, heel + (0.0, 0.0, 0.10), 0.10 + 0.30)
        if floor is None:
            yield f"{slot}: there is no floor under the heels at {point_text(heel)}; correct heel_point, or the origin"
        elif abs(floor - 0.10) > _FLOOR_OFF_M:
            yield f"{slot}: the floor is {1000 * (0.10 - floor):+.0f} mm from the heels at {point_text(heel)}; correct heel_point"
    yield from _wheel_misplaced(cabin)
    driver = next(iter(cabin.seats.values()))
    missing = open_directions(triangles, apply(driver.vehicle_from_back(driver.default), _HEAD))
    if missing > _OPEN_DIRECTIONS:
        yield (
            f"seen from the head of the {driver.slot}, {100 * missing:.0f} % of all directions meet no surface (windows without"
            " glass: some 30 %): much of the car's shell is missing, and people may reach through it"
        )


def _wheel_misplaced(cabin: Cabin) -> Iterator[str]:
    wheel, driver = cabin.steering_wheel, cabin.seats.get("driver")
    if wheel is None or driver is None:
        return
    shoulder = apply(driver.vehicle_from_back(driver.default), _SHOULDER)
    to_driver = shoulder - wheel.vehicle_from_wheel[:3, 3]
    away = float(np.linalg.norm(to_driver))
    if away > _REACH_M:
        yield f"the wheel is {away:.2f} m from the driver's shoulders, out of reach; correct its centre or the h_point"
    if float(wheel.vehicle_from_wheel[:3, 2] @ to_driver) < 0.3 * away:
        yield "the wheel's axis does not point to the driver; turn it round: from the hub to the driver"


def _down(triangles: Floats, start: Floats, length: float) -> float | None:
    """How far below a point (3,) the first surface is, m; None where there is none within `length`."""
    share, _ = first_crossings(start[None], (start - (0.0, 0.0, length))[None], triangles)
    return float(share[0]) * length if math.isfinite(share[0]) else None


def open_directions(triangles: Floats, eye: Floats) -> float:
    """The share of all directions from a point (3,) m that meet none of the triangles (F, 3, 3) m."""
    way = sampled_surface(triangles, 0.05) - eye
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    row = np.minimum(((way[:, 2] + 1) / 2 * _BINS[0]).astype(int), _BINS[0] - 1)
    column = ((np.arctan2(way[:, 1], way[:, 0]) / (2 * np.pi) % 1.0) * _BINS[1]).astype(int) % _BINS[1]
    return 1.0 - len(np.unique(row * _BINS[1] + column)) / (_BINS[0] * _BINS[1])


def _remedies(
    spec: CabinFile, cabin: Cabin, trials: Mapping[str, SeatTrial], to_file: Matrix
) -> tuple[list[Rule], tuple[str, ...]]:
    """Rules that give way as deep as people sink in, and advice where no foam is as deep."""
    rules: list[Rule] = []
    advice: list[str] = []
    parts = {part.name: part for part in cabin.parts}
    for slot, trial in trials.items():
        too_deep = sum(n for r, n in trial.rejections.items() if r.cause == "car" and r.what in SITTING)
        if too_deep + len(trial.pushed_m) < _OFTEN:
            continue
        for (name, side), sunk in trial.sunk_m.items():
            part = parts[name]
            need = _STEP_MM * math.ceil(1000 * (sunk - FLESH_M) / _STEP_MM)
            if sunk - FLESH_M <= part.give_m or label_of(part) in _HARD:
                continue
            if need > _FOAM_MM:
                advice.append(
                    f"{slot}: people lie {1000 * sunk:.0f} mm deep in {name}, and no foam gives so much:"
                    f" move the h_point {'up' if side == 'base' else 'forward'}, or see whether a part is in the wrong place"
                )
                continue
            rules.append(_rule(spec, cabin, cabin.seats[slot], part, side, need, to_file))
    return rules, tuple(advice)


def _rule(spec: CabinFile, cabin: Cabin, seat: Seat, part: Part, side: SeatSide, give_mm: float, to_file: Matrix) -> Rule:
    """The rule that makes a part give way under somebody: for its whole mesh, or for the box of the seat where it is more."""
    if part.mesh:
        known = next(r for r in spec.rules if r.within is not None and r.names(part.mesh) and r.group == part.group)
        return known.model_copy(update={"give_mm": give_mm})
    pattern = part.name.replace("[", "[[]")
    if _share_within(part, cabin, seat) > 0.5:
        return Rule(pattern=pattern, label=label_of(part), material=material_of(part), give_mm=give_mm, group=part.group)
    corners = apply(seat.vehicle_from_seat(seat.default), SEAT_BOXES[side])
    floor = np.array((-np.inf, -np.inf, seat.floor_z + 0.03))
    low, high = np.maximum(corners.min(axis=0), floor), corners.max(axis=0)
    digits = 3 - round(np.log10(np.linalg.norm(to_file[:3, 0])))
    one, other = apply(to_file, np.stack((low, high))).round(max(digits, 0)).tolist()
    group = f"seat:{seat.slot}/{side}"
    return Rule(pattern=pattern, within=(one, other), label="seat", material="seat_fabric", give_mm=give_mm, group=group)


def _merged(rules: Sequence[Rule]) -> list[Rule]:
    """One rule for each place, with the greatest give that was asked of it."""
    result: dict[tuple[object, ...], Rule] = {}
    for rule in rules:
        key = (rule.pattern, rule.within)
        if key not in result or result[key].give_mm < rule.give_mm:
            result[key] = rule
    return list(result.values())


def _share_within(part: Part, cabin: Cabin, seat: Seat) -> float:
    """The share of a part's surface that is in the boxes of a seat's cushion and backrest."""
    vehicle_from_part = cabin.group_transforms({})[part.group]
    corners = apply(invert(seat.vehicle_from_seat(seat.default)) @ vehicle_from_part, part.surface.vertices)[part.surface.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    middle = corners.mean(axis=1)
    inside = np.any([((middle >= low) & (middle <= high)).all(axis=1) for low, high in SEAT_BOXES.values()], axis=0)
    return float(area[inside].sum() / area.sum())


def point_text(point: Floats) -> str:
    """A point (3,) as text with two decimals, never "-0.00"."""
    return "[" + ", ".join(f"{round(float(x), 2) + 0.0:.2f}" for x in point) + "]"
