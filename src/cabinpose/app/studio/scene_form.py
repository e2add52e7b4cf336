"""Every key of the scene's configuration as a field: what it may be, its unit, range and description. Without any UI."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import Any, Literal

from cabinpose.core import OCCUPANT_SLOTS
from cabinpose.scene.body import DEFAULT_RANGES, DOF_INDEX, DOFS, POPULATIONS, SUBJECTS, load_faces
from cabinpose.scene.cabin import PRESET_DIMENSIONS, PRESETS, PRODUCT_VIEWS, VIEWS_OF_ALL
from cabinpose.scene.sensor import SENSORS
from cabinpose.synth import SynthConfig, limits_deg, things_for
from cabinpose.synth.posture import ACTIONS

Path = tuple[str | int, ...]
_UNITS = (
    ("_e_per_s", "e⁻/s"), ("_mm_per_m2", "mm/m²"), ("_mm_per_m", "mm/m"), ("_mm", "mm"), ("_cm", "cm"), ("_m", "m"),
    ("_px", "px"), ("_deg", "°"), ("_rad", "rad"), ("_s", "s"), ("_hz", "Hz"), ("_kg", "kg"), ("_e", "e⁻"), ("years", "years"),
)  # fmt: skip
_PLAIN_UNITS = {"fps": "1/s", "width": "px", "height": "px", "fx": "px", "fy": "px", "cx": "px", "cy": "px"}  # of `sensor`
_AXES = ("axes", "initial_pose_deg", "angles_rad")
_JOINTS = frozenset(dof.name.partition(".")[0] for dof in DOFS)
_NAMED = ("own", "views", "frequencies_hz")  # whose entries have names of the user's own
_COORDINATES = ("x", "y", "z")
_LEFT_OUT = "left out"
_THINGS: Mapping[str | int, Literal["child seat", "object"]] = MappingProxyType(
    {"child_seats": "child seat", "objects": "object"}
)
_TITLES = {
    "CameraPose": "own pose", "ExactCameraPose": "matrix", "Sensor": "own sensor", "ExactPose": "whole pose",
    "ExactFace": "face", "RandomPeople": "random people", "Factorial": "factorial",
}  # fmt: skip


@dataclass(frozen=True)
class Field:
    """One key of the configuration, with those within.

    kind: group, mapping, list, names (any of `choices`, or others; what is no name is a child), number, integer, flag, choice,
    text or nothing · value: as plain data, None where it is left out · low, high: bounds, None: none · above: whether `low`
    itself is excluded · choices: values it may have, or keys a mapping may get, or usual ones of these · optional: whether it
    may be left out · options, option: what it can be in place of this, and what it is · fresh: what each of these starts from ·
    entry: what a new entry starts from · code: of SAE J1100, where it is a dimension that the standard defines.
    """

    path: Path
    kind: str
    value: Any = None
    unit: str = ""
    description: str = ""
    low: float | None = None
    high: float | None = None
    above: bool = False
    choices: tuple[str, ...] = ()
    optional: bool = False
    options: tuple[str, ...] = ()
    option: str = ""
    fresh: Mapping[str, Any] | None = None
    entry: Any = None
    children: tuple[Field, ...] = ()
    code: str = ""

    @property
    def name(self) -> str:
        """The last part of the path, as it is written."""
        last = self.path[-1] if self.path else "scene"
        if isinstance(last, int) and isinstance(self.value, dict) and self.value.get("name"):
            return str(self.value["name"])
        return _COORDINATES[last] if isinstance(last, int) and str(self.path[-2]).endswith("_m") and last < 3 else str(last)

    @property
    def words(self) -> str:
        """The name in words, with the code where there is one; names that somebody gave as they are."""
        if self.code:  # "H30-1: seat height: H-point above the heel point [SAE J1100]"
            return f"{self.description.split(': ', 1)[1].partition(':')[0].partition(' [')[0]} ({self.code})"
        if self.name in DOF_INDEX:
            return axis_words(self.name)
        if not self.path or isinstance(self.path[-1], int) or (self.path[-2:-1] and self.path[-2] in _NAMED):
            return self.name
        unit = next((suffix for suffix, _ in _UNITS if self.name.endswith(suffix) and suffix.startswith("_")), "")
        return self.name.removesuffix(unit).replace("_", " ") if unit else self.name.replace("_", " ")

    @property
    def range_words(self) -> str:
        """The range with its unit, in words; "" for none."""
        unit = f" {self.unit}" if self.unit else ""
        if self.low is None and self.high is None:
            return self.unit
        if self.high is None:
            return f"{'above' if self.above else 'from'} {self.low:.6g}{unit}"
        return f"{'' if self.low is None else f'{self.low:.6g} '}to {self.high:.6g}{unit}"

    def walk(self) -> Iterator[Field]:
        """The field and all within."""
        yield self
        for child in self.children:
            yield from child.walk()


def axis_words(axis: str) -> str:
    """A joint axis in words: left elbow flexion."""
    joint, _, motion = axis.partition(".")
    sides = {"l": "left", "r": "right"}
    return f"{sides[joint[0]]} {joint[1:]} {motion}" if joint[0] in sides and "r" + joint[1:] in _JOINTS else f"{joint} {motion}"


def form(data: Mapping[str, Any], *, starts: Mapping[str, Any] | None = None, cars: Sequence[str] = ()) -> Field:
    """The fields of a configuration that is given as plain data, whether it is valid or not.

    starts: what models start from where somebody chooses them, by their names ("CameraPose"); others start from their defaults ·
    cars: names that are offered for `scene.cars` beside the presets.
    """
    return _Builder(data, starts or {}, (*PRESETS, *cars)).field((), schema(), dict(data))


def with_changed_preset(cars: Sequence[Any], preset: str) -> tuple[list[Any], int]:
    """The cars with a preset whose dimensions can be changed, in the place of the preset or at the end; and where it is."""
    called = {car["name"] if isinstance(car, dict) and "name" in car else str(car) for car in cars}
    name = next(n for n in (f"my_{preset}", *(f"my_{preset}_{i}" for i in range(2, len(cars) + 3))) if n not in called)
    at = cars.index(preset) if preset in cars else len(cars)
    return [*cars[:at], {"preset": preset, "name": name}, *cars[at + 1 :]], at


@cache
def schema() -> dict[str, Any]:
    """The JSON schema of the configuration."""
    return SynthConfig.model_json_schema()


class _Builder:
    def __init__(self, data: Mapping[str, Any], starts: Mapping[str, Any], cars: tuple[str, ...]) -> None:
        self._starts, self._cars = starts, cars
        people = data.get("people")
        own = people.get("own") if isinstance(people, dict) else None
        self._subjects = (*SUBJECTS, *(own if isinstance(own, dict) else ()))

    def field(self, path: Path, given: Mapping[str, Any], value: Any, description: str = "") -> Field:
        """The field of a schema's part, and those within."""
        if "code" in given:
            return replace(self.field(path, {k: v for k, v in given.items() if k != "code"}, value), code=given["code"])
        part = _resolved(given)
        description = given.get("description") or description or part.get("description", "").split("\n")[0]
        variants = _variants(part)
        plain = [each for name, each in variants.items() if name != _LEFT_OUT and "properties" not in _resolved(each)]
        if len(variants) == 2 and _LEFT_OUT in variants and plain:
            return replace(self._plain(path, _resolved(plain[0]), value, description), optional=True)
        if len(variants) > 1:
            option = next((name for name, each in variants.items() if _fits(each, value)), next(iter(variants)))
            fresh = {name: self._start(each) for name, each in variants.items()}
            chosen = self.field(path, variants[option], value, description)
            return replace(chosen, options=tuple(variants), option=option, fresh=fresh)
        (only,) = variants.values()
        part = _resolved(only)
        if "properties" in part:
            held = value if isinstance(value, dict) else {}
            base = PRESET_DIMENSIONS.get(str(held.get("preset"))) if part.get("title") == "ChangedPreset" else None
            held = (base.model_dump() if base is not None else {}) | held
            children = tuple(
                self.field((*path, name), each, held[name] if name in held else self._start(each, entire=False))
                for name, each in part["properties"].items()
                if "const" not in each and each.get("items") != {"not": {}}  # effects of noise, where none is installed
            )
            return Field(path, "group", value, description=description, children=children)
        if isinstance(part.get("additionalProperties"), dict):
            inner, held = part["additionalProperties"], value if isinstance(value, dict) else {}
            children = tuple(self.field((*path, name), inner, each) for name, each in held.items())
            entry = self._start(inner)
            return Field(
                path, "mapping", value, description=description, choices=self._keys(path), children=children, entry=entry
            )
        if part.get("type") == "array":
            return self._list(path, part, value, description)
        return self._plain(path, part, value, description)

    def _list(self, path: Path, part: Mapping[str, Any], value: Any, description: str) -> Field:
        held = list(value) if isinstance(value, (list, tuple)) else []
        if "prefixItems" in part:
            unit = _unit(path)
            children = tuple(
                self.field((*path, i), each, held[i] if i < len(held) else 0.0, "") for i, each in enumerate(part["prefixItems"])
            )
            return Field(path, "group", held, unit, description, children=children)
        variants = _variants(part["items"])
        if any(_resolved(each).get("type") == "string" for each in variants.values()):
            other = next((each for each in variants.values() if "properties" in _resolved(each)), {})
            children = tuple(self.field((*path, i), other, each) for i, each in enumerate(held) if isinstance(each, dict))
            return Field(path, "names", held, description=description, choices=self._values(path), children=children)
        children = tuple(self.field((*path, i), part["items"], each) for i, each in enumerate(held))
        return Field(path, "list", held, description=description, children=children, entry=self._start(part["items"]))

    def _plain(self, path: Path, part: Mapping[str, Any], value: Any, description: str) -> Field:
        kind = part.get("type", "null")
        if "enum" in part:
            return Field(path, "choice", value, description=description, choices=tuple(part["enum"]))
        if kind == "string":
            choices = self._values(path)
            return Field(path, "text", value, description=description, choices=choices)
        if kind == "boolean":
            return Field(path, "flag", value, description=description)
        if kind == "null":
            return Field(path, "nothing", None, description=description)
        low, high = part.get("minimum", part.get("exclusiveMinimum")), part.get("maximum", part.get("exclusiveMaximum"))
        axis = next((str(name) for name in path if name in DOF_INDEX), None)
        unit = _unit(path)
        if axis is not None and path[-1] not in ("sigma_deg", "step_deg"):
            dof = DOFS[DOF_INDEX[axis]]
            low, high = (dof.lower, dof.upper) if "angles_rad" in path else limits_deg(axis)
        if axis is not None and axis.endswith(".grip"):
            unit = ""
        return Field(path, kind, value, unit, description, low, high, above="exclusiveMinimum" in part)

    def _start(self, given: Mapping[str, Any], *, entire: bool = True) -> Any:
        """What something starts from: its default, or the least that is asked for. entire: not None where there is more."""
        part = _resolved(given)
        if part.get("title") in self._starts:
            return self._starts[part["title"]]
        if "default" in given and not (entire and given["default"] is None):
            return given["default"]
        if not entire and "anyOf" in part and any(each.get("type") == "null" for each in part["anyOf"]):
            return None
        if "const" in part:
            return part["const"]
        if "anyOf" in part or "oneOf" in part:
            return self._start(next(iter(_variants(part).values())))
        if "properties" in part:
            names = {"kind", *part.get("required", ())}
            return {name: self._start(each) for name, each in part["properties"].items() if name in names}
        if "prefixItems" in part:
            return [self._start(each) for each in part["prefixItems"]]
        simple = {"array": [], "object": {}, "string": part.get("enum", [""])[0], "boolean": True, "null": None}
        if part.get("type") in simple:
            return simple[part["type"]]
        return part.get("minimum", 1.0 if "exclusiveMinimum" in part else min(0.0, part.get("maximum", 0.0)))

    def _keys(self, path: Path) -> tuple[str, ...]:
        """Keys that a mapping may get; () for names of the user's own."""
        last = str(path[-1])
        if last in _AXES:
            return tuple(DOF_INDEX)
        if last in ("occupants", "occupancy", "motion", "seats", *_THINGS):
            return OCCUPANT_SLOTS
        if path[-2:-1] and path[-2] in _THINGS:
            return things_for(_THINGS[path[-2]])[1:]
        if path[:2] == ("scene", "motion"):
            return ACTIONS.names()
        return {
            "views": (*VIEWS_OF_ALL, *PRODUCT_VIEWS),
            "units": tuple(load_faces().units),
            "ranges": ("years", "stature_cm", "mass_kg", *DEFAULT_RANGES),
        }.get(last, ())

    def _values(self, path: Path) -> tuple[str, ...]:
        """Usual values of a text; () for none."""
        if path[-2:-1] and path[-2] in _THINGS:
            return things_for(_THINGS[path[-2]])
        known = {
            "cars": self._cars, "preset": PRESETS, "subjects": tuple(SUBJECTS), "subject": self._subjects,
            "sensor": SENSORS.names(), "action": ACTIONS.names(), "seat": OCCUPANT_SLOTS, "population": (*POPULATIONS, "evenly"),
        }  # fmt: skip
        return tuple(known.get(str(path[-1]), ()))


def _resolved(part: Mapping[str, Any]) -> Mapping[str, Any]:
    while "$ref" in part:
        part = schema()["$defs"][part["$ref"].removeprefix("#/$defs/")]
    return part


def _variants(part: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """What something may be, by name; one entry for what is not a union."""
    result: dict[str, Mapping[str, Any]] = {}
    for each in part.get("anyOf") or part.get("oneOf") or [part]:
        inner = _resolved(each)
        if "oneOf" in inner or "anyOf" in inner:
            result |= _variants(inner)
            continue
        kind = inner.get("properties", {}).get("kind", {}).get("const")
        names = {"null": _LEFT_OUT, "number": "a number", "string": "one of" if "enum" in inner else "by name"}
        title = str(inner.get("title", ""))
        result[kind or names.get(str(inner.get("type")), _TITLES.get(title, title))] = each
    return result


def _fits(given: Mapping[str, Any], value: Any) -> bool:
    part = _resolved(given)
    if isinstance(value, dict):
        names = part.get("properties", {})
        if "kind" in names and "kind" in value:
            return bool(names["kind"].get("const") == value["kind"])
        return bool(names) and set(value) <= set(names)
    types = {"null": type(None), "boolean": bool, "string": str, "array": (list, tuple), "number": (int, float), "integer": int}
    return isinstance(value, types.get(part.get("type", ""), ()))  # type: ignore[arg-type]


def _unit(path: Path) -> str:
    name = next((str(part) for part in reversed(path) if isinstance(part, str) and part not in DOF_INDEX), "")
    if name in _PLAIN_UNITS and "sensor" in path:
        return _PLAIN_UNITS[name]
    return next((unit for suffix, unit in _UNITS if name.endswith(suffix)), "")
