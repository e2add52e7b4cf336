"""A first YAML for an unknown car mesh: axes, unit, origin, seats and steering wheel as found, the rest commented out."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from cabinpose.core import OCCUPANT_SLOTS, Floats, Matrix, MeshError, apply
from cabinpose.scene.cabin.find_seats import FoundSeat, find_seats
from cabinpose.scene.cabin.find_wheel import FoundWheel, find_wheel
from cabinpose.scene.cabin.meshfile import MeshFile, NamedMesh, axis_name, read_mesh
from cabinpose.scene.cabin.seats import BACK_BOX, BACK_GIVE, CUSHION_BOX, CUSHION_GIVE
from cabinpose.scene.cabin.sizes import UNITS, Measure, SeatPoints, between_points, extents, judged

_ROW_M = 0.35  # seats whose H-points are nearer along the car stand in one row
_REAR_HEEL_M = 0.44  # a rear sitter's heels ahead of the H-point


class Draft(NamedTuple):
    """text: YAML · seats: by slot, and wheel (None: none was found), vehicle frame · notes: what was found, and how ·
    sizes: of the car · warnings: sizes that a car hardly has.
    """

    text: str
    seats: Mapping[str, FoundSeat]
    wheel: FoundWheel | None
    notes: tuple[str, ...]
    sizes: tuple[Measure, ...]
    warnings: tuple[str, ...]


def draft_car_file(mesh: Path, out: Path, *, up_axis: str = "auto", front_axis: str = "auto", unit: str = "auto") -> Draft:
    """The text of a YAML at `out` for a mesh file.

    Parameters
    ----------
    mesh
        The mesh file, of whatever axes and unit.
    out
        Path of the YAML, to which the mesh's path in it is relative. Nothing is written.
    up_axis, front_axis, unit
        As in the YAML, where they are known.

    Returns
    -------
    Draft

    Raises
    ------
    MeshError
        For a mesh that cannot be read, that has sizes that no car has, or in which nothing is shaped like a seat.
    """
    file, found, how = _turned_to_front(mesh, up_axis, front_axis, unit)
    wheel = find_wheel(file.meshes, found)
    slots, left_out = _slots(found, wheel)
    front = slots["driver"]
    everything = np.concatenate([m.vertices for m in file.meshes])
    sides = [s.h_point[1] for s in (front, slots.get("front_passenger")) if s is not None]
    middle = float(np.mean(sides) if len(sides) == 2 else (everything[:, 1].max() + everything[:, 1].min()) / 2)
    forward = -1.0 if front.backward else 1.0
    height = float(front.h_point[2]) - front.floor_z
    origin: Floats = np.array((front.h_point[0] + forward * _heel_ahead(height), middle, front.floor_z))
    slots = {slot: _moved(seat, -origin) for slot, seat in slots.items()}
    if wheel is not None:
        wheel = wheel._replace(centre=wheel.centre - origin)
    notes = [*file.notes, *how, *left_out]
    sizes, warnings = _sizes(mesh, file, everything - origin, slots, wheel)
    text = "".join(
        f"{line}\n"
        for line in (
            *_file_lines(mesh, out, file, apply(np.asarray(np.linalg.inv(file.vehicle_from_mesh), np.float64), origin), notes),
            f"drive_side: {'right' if slots['driver'].h_point[1] < 0 else 'left'}  # "
            + ("the wheel is there" if wheel is not None else "no steering wheel was found: check it"),
            "",
            "seats:  # H-points by lines through cushion and backrest, good to some centimetres: measure them where it counts",
            *(line for slot, seat in slots.items() for line in _seat_lines(slot, seat)),
            "",
            *_wheel_lines(wheel, slots["driver"]),
            "",
            *_pedal_lines(slots["driver"]),
            "",
            "rules:  # the first that fits counts; `within` takes what lies in a box, whatever the mesh is called",
            *_rule_lines(slots, wheel),
            '  # - {pattern: "*outer*skin*", hide: true}  # what nobody sees from inside',
            "",
            "# views:  # without them a free place is looked for before the seats",
            "#   driver: {eye: [-0.1, 0.0, 1.1], target: [-0.8, 0.35, 0.55]}",
        )
    )
    return Draft(text, slots, wheel, tuple(notes), sizes, warnings)


def _sizes(
    mesh: Path, file: MeshFile, vertices: Floats, seats: Mapping[str, FoundSeat], wheel: FoundWheel | None
) -> tuple[tuple[Measure, ...], tuple[str, ...]]:
    """The sizes of what was found, and what a car hardly has; MeshError for what none has."""
    places = {slot: SeatPoints(seat.h_point, _heel(slot, seat), seat.backward) for slot, seat in seats.items()}
    hub = None if wheel is None else wheel.centre
    found = [*extents(vertices.min(axis=0), vertices.max(axis=0)), *between_points(places, hub)]
    verdict = judged(found, places, steered=wheel is not None, unit=file.unit, front=file.front_axis)
    if verdict.errors:
        raise MeshError(f"{mesh}: {'; '.join(verdict.errors)}", hint=verdict.hint)
    return tuple(found), verdict.said


def _turned_to_front(mesh: Path, up: str, front: str, unit: str) -> tuple[MeshFile, list[FoundSeat], list[str]]:
    """The file with its front where most seats look, its seats, and how the front was found where the file's own was not it."""
    file = read_mesh(mesh, up_axis=up, front_axis=front, unit=unit)
    _sizes(mesh, file, np.concatenate([m.vertices for m in file.meshes]), {}, None)
    found = _seats_of(file.meshes)
    if front != "auto":
        return _with_seats(mesh, file, found, [])
    up_name, first = axis_name(file.vehicle_from_mesh[2, :3]), axis_name(file.vehicle_from_mesh[0, :3])
    best = (_forward(found), file, found, list[str]())
    # With seats only the opposite front is tried, without any the two across.
    turned = [a for a in _axes_beside(up_name) if a != first and (a.strip("-") == first.strip("-")) == bool(found)]
    if best[0] <= 0:
        for axis in turned:
            other = read_mesh(mesh, up_axis=up_name, front_axis=axis, unit=unit)
            seats = _seats_of(other.meshes)
            note = f"front axis {axis}: the seats look that way, not to {first}"
            best = max(best, (_forward(seats), other, seats, [note]), key=lambda each: each[0])
    return _with_seats(mesh, *best[1:])


def _with_seats(
    mesh: Path, file: MeshFile, found: list[FoundSeat], how: list[str]
) -> tuple[MeshFile, list[FoundSeat], list[str]]:
    if not found:
        raise MeshError(
            f"{mesh}: nothing in it is shaped like a seat ({'; '.join(file.notes) or 'axes and unit as given'})",
            hint="check --up-axis, --front-axis and --unit, and take out figures that sit there;"
            " or write the YAML by hand: docs/own-car.md",
        )
    return file, found, how


def _seats_of(meshes: Sequence[NamedMesh]) -> list[FoundSeat]:
    return find_seats(np.concatenate([m.vertices[m.faces] for m in meshes]))


def _forward(seats: Sequence[FoundSeat]) -> int:
    """How many more seats look forward than backward."""
    return sum(-1 if seat.backward else 1 for seat in seats)


def _axes_beside(up: str) -> list[str]:
    return [sign + axis for axis in "xyz" if axis != up.strip("-") for sign in ("", "-")]


def _heel_ahead(seat_height: float) -> float:
    """From a driver's H-point forward to the heel by the seat height, m: a line through the seven presets' L53 and H30."""
    return 1.025 - 0.69 * seat_height


def _slots(found: Sequence[FoundSeat], wheel: FoundWheel | None) -> tuple[dict[str, FoundSeat], list[str]]:
    """The seats by slot, in the standard's order, and notes on those that have none."""
    rows: list[list[FoundSeat]] = []
    for seat in sorted(found, key=lambda s: -s.h_point[0]):
        if rows and abs(rows[-1][0].h_point[0] - seat.h_point[0]) < _ROW_M and rows[-1][0].backward == seat.backward:
            rows[-1].append(seat)
        else:
            rows.append([seat])
    first = 0
    if wheel is not None:
        first = next(i for i, row in enumerate(rows) if any(seat is found[wheel.seat] for seat in row))
    front = sorted(rows[first], key=lambda s: -s.h_point[1])
    driver = found[wheel.seat] if wheel is not None else front[0]
    slots = {"driver": driver}
    others = [seat for seat in front if seat is not driver]
    if others:
        slots["front_passenger"] = max(others, key=lambda s: abs(s.h_point[1] - driver.h_point[1]))
    if first + 1 < len(rows):
        rear = sorted(rows[first + 1], key=lambda s: -s.h_point[1])
        names = {1: ("rear_center",), 2: ("rear_left", "rear_right")}.get(len(rear), ("rear_left", "rear_center", "rear_right"))
        slots |= dict(zip(names, rear, strict=False))
    named = {id(seat) for seat in slots.values()}
    spare = [seat for seat in found if id(seat) not in named]
    notes = [f"left out: what is like a seat at {np.round(s.h_point, 2).tolist()} m; there are five slots" for s in spare]
    return {slot: slots[slot] for slot in OCCUPANT_SLOTS if slot in slots}, notes


def _moved(seat: FoundSeat, by: Floats) -> FoundSeat:
    return seat._replace(h_point=seat.h_point + by, floor_z=seat.floor_z + float(by[2]))


def _file_lines(mesh: Path, out: Path, file: MeshFile, origin: Floats, notes: Sequence[str]) -> Iterator[str]:
    """The head of the YAML: what the file is, and how that was found."""
    matrix: Matrix = file.vehicle_from_mesh
    unit = file.unit

    def why(*words: str) -> str:
        said = next((note.partition(": ")[2] for word in words for note in reversed(notes) if note.startswith(word)), "as given")
        return f"  # {said}"

    yield "# Made by `cabinpose car init`. Every key: docs/own-car.md. Then: cabinpose car check " + out.name
    yield f"mesh: {_scalar(os.path.relpath(mesh, out.parent))}"
    yield f"up_axis: {axis_name(matrix[2, :3])}{why('up axis')}"
    yield f"front_axis: {file.front_axis}{why('front axis')}"
    yield f"unit: {unit}{why('unit')}"
    digits = max(0, 4 + round(np.log10(UNITS[unit])))
    yield f"origin: {_list(origin, digits)}  # in the mesh's own axes and unit: floor, centre line, under the driver's heel"
    yield "# All points below are in the vehicle frame: metres from that origin, x forward, y left, z up."


def _seat_lines(slot: str, seat: FoundSeat) -> Iterator[str]:
    h = seat.h_point
    yield f"  {slot}:  # fits the shape of a seat by {100 * seat.score:.0f} %"
    yield f"    h_point: {_list(h)}"
    yield f"    heel_point: {_list(_heel(slot, seat))}  # on the floor"
    if seat.backward:
        yield "    facing: backward"
    yield f"    torso_angle_deg: {np.clip(np.degrees(seat.torso_angle), 0, 60):.0f}"
    yield f"    cushion_angle_deg: {np.clip(np.degrees(seat.cushion_angle), 0, 35):.0f}"
    if slot in OCCUPANT_SLOTS[:2]:
        yield "    # fore_aft_mm: [-80, 150]  # travel of an adjustable seat"


def _heel(slot: str, seat: FoundSeat) -> Floats:
    """(3,) m, on the floor before the seat."""
    x, y, z = seat.h_point
    ahead = _heel_ahead(float(z) - seat.floor_z) if slot in OCCUPANT_SLOTS[:2] else _REAR_HEEL_M
    return np.array((x - ahead if seat.backward else x + ahead, y, seat.floor_z))


def _wheel_lines(wheel: FoundWheel | None, driver: FoundSeat) -> Iterator[str]:
    off = "# " if wheel is None else ""
    how = f"found by {wheel.how}" if wheel is not None else "not found: an example for this driver"
    ahead = -0.42 if driver.backward else 0.42
    centre = wheel.centre if wheel is not None else driver.h_point + (ahead, 0.0, 0.39)
    axis = wheel.axis if wheel is not None else np.array((-np.sign(ahead) * 0.9, 0.0, 0.43))
    yield f"{off}steering_wheel:  # {how}"
    yield f"{off}  centre: {_list(centre)}"
    yield f"{off}  axis: {_list(axis)}  # from the hub to the driver"
    yield f"{off}  diameter_mm: {1000 * wheel.diameter_m if wheel is not None else 370:.0f}"
    yield f"{off}  section_mm: {1000 * wheel.section_m if wheel is not None else 33:.0f}"


def _pedal_lines(driver: FoundSeat) -> Iterator[str]:
    y = float(driver.h_point[1])
    yield "# pedals:  # not looked for: an example for this driver, where the ball of the foot touches"
    yield f"#   accelerator: {{point: {_list((0.09, y - 0.12, 0.17))}}}"
    yield f"#   brake: {{point: {_list((0.06, y + 0.02, 0.18))}}}"


def _rule_lines(slots: Mapping[str, FoundSeat], wheel: FoundWheel | None) -> Iterator[str]:
    """Boxes about the seats' parts and the wheel."""
    if wheel is not None:
        half = 0.5 * wheel.diameter_m * np.sqrt(np.maximum(1 - wheel.axis**2, 0.0)) + 0.03
        yield _rule(
            "the steering wheel", wheel.centre - half, wheel.centre + half, "wheel", "steering_wheel", "steering_leather", 0
        )
    for slot, seat in slots.items():
        turn = np.array((-1.0, 1.0, 1.0)) if seat.backward else np.ones(3)
        narrow = np.array((1.0, min(1.0, seat.width_m / np.ptp(CUSHION_BOX[:, 1])), 1.0))
        for part, group, box, give in (("cushion", "base", CUSHION_BOX, CUSHION_GIVE), ("backrest", "back", BACK_BOX, BACK_GIVE)):
            corners = seat.h_point + box * narrow * turn
            low = np.maximum(corners.min(axis=0), (-np.inf, -np.inf, seat.floor_z + 0.03))
            yield _rule(
                f"{slot}: {part}", low, corners.max(axis=0), f"seat:{slot}/{group}", "seat", "seat_fabric", round(1000 * give)
            )


def _rule(what: str, low: Floats, high: Floats, group: str, label: str, material: str, give_mm: int) -> str:
    give = f", give_mm: {give_mm}" if give_mm else ""
    box = f"[{_list(low, 2)}, {_list(high, 2)}]"
    return f'  - {{pattern: "*", within: {box}, group: "{group}", label: {label}, material: {material}{give}}}  # {what}'


def _scalar(text: str) -> str:
    """Text as YAML, in quotes where it would be read as something else, such as a comment."""
    return yaml.safe_dump(text, width=10_000, allow_unicode=True).removesuffix("...\n").strip()


def _list(values: Sequence[float] | Floats, digits: int = 3) -> str:
    return "[" + ", ".join(f"{round(float(v), digits) + 0.0:g}" for v in values) + "]"
