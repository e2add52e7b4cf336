"""What is wrong with settings, in one style: paths that can be pasted, what was seen, what it must be, and what may be meant."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple, Protocol

from cabinpose.core.errors import CabinposeError, ConfigError
from cabinpose.core.synonyms import ELSEWHERE, KEYS, NAMES, alike

Place = tuple[str | int, ...]
Schema = Mapping[str, Any]
_LONGEST = 60  # characters of a value that a message shows
_MOST_KEYS = 40  # that a hint lists
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
_FOLLOWS = ("default_factory_not_called",)  # from what else is wrong
_A_LIST, _A_MAPPING = "a list", "a mapping of keys to values"
_KINDS = {
    **dict.fromkeys(("tuple_type", "list_type", "set_type", "frozen_set_type", "iterable_type"), _A_LIST),
    **dict.fromkeys(("dict_type", "mapping_type", "model_type", "model_attributes_type", "dataclass_type"), _A_MAPPING),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    "string_type": "a text",
    "path_type": "a path",
    "finite_number": "a finite number",
}
_THING_SHOULD = re.compile(r"^\w+ should ")


class Findings(Protocol):
    """The error of pydantic, which this room does without."""

    def errors(self) -> Sequence[Any]:
        """Mappings with `type`, `loc`, `msg`, `input` and maybe `ctx`."""


class _Finding(NamedTuple):
    """One finding. place: without the names of a union's members; union: where the first one is, and its member."""

    place: Place
    union: tuple[Place, str] | None
    about: Mapping[str, Any]

    @property
    def of_another_kind(self) -> bool:
        return self.about["type"] in _KINDS


def path_text(place: Place) -> str:
    """A path as it is written in KEY=VALUE: "scene.things[0].kind"."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in place).removeprefix(".")


def explained(
    error: Findings, model: Any, data: Any, *, lists: str, at: str = "", kind: type[CabinposeError] = ConfigError,
    written: Callable[[Place], str] = path_text,
) -> CabinposeError:  # fmt: skip
    """An error of ours that says all that pydantic found.

    Parameters
    ----------
    error
        What it raised.
    model
        The model of the settings, of pydantic.
    data
        What was checked: plain data.
    lists
        Where the keys are described, for the hint where nothing better is known.
    at
        Path of the settings, or the file and a colon, before the paths of the keys.
    kind
        The class of the error.
    written
        How a path is written, for settings that are flags.
    """
    found = [_finding(about, data) for about in error.errors() if about["type"] not in _FOLLOWS]
    findings = [each for group in _by_union(found) for each in _meant(group) if not _follows(each, found)]
    tell = _Tell(_schema(model), lists, at, written)
    lines = list(dict.fromkeys(tell.line(each, findings) for each in findings))
    unknown = [each for each in findings if each.about["type"] in _UNKNOWN]
    meant = [f"{path_text(each.place)}: {said}" for each in unknown if (said := tell.meant(each))] if len(unknown) > 1 else []
    hints = (hint for each in (*unknown, *findings) if (hint := tell.hint(each)))  # what was meant says more than what is lacking
    return kind(f"{at if at.endswith(': ') else ''}{'; '.join(lines)}", hint=" ".join(meant) or next(hints, lists))


def keys_alike(model: Any, word: str, value: str = "") -> tuple[str, ...]:
    """What may be meant by a key of a model that does not exist: paths, as KEY=VALUE where a value is given that suits them."""
    tell = _Tell(_schema(model), "", "", path_text)
    near = {path: tell.with_value(path, value or None) for path in alike(word, _key_paths(tell.schema))}
    # What others call otherwise may have another unit.
    return tuple(f"{path}={value}" if value and path.endswith(word) else told for path, told in near.items())


@cache
def _schema(model: Any) -> Schema:
    try:
        return model.model_json_schema()
    except RuntimeError:  # pydantic's, for a type of an extension that JSON has no word for
        return {}


def _key_paths(schema: Schema) -> Iterator[str]:
    """The paths of all keys of a JSON Schema; NAME stands for names that users give, [] for an entry of a list."""
    yield from _paths(schema, schema.get("$defs", {}), "", ())


def _paths(node: Schema, definitions: Schema, path: str, within: tuple[str, ...]) -> Iterator[str]:
    reference = node.get("$ref")
    if reference in within:
        return
    inner = (*within, reference) if reference else within
    for each in _members(node, definitions):
        for key, child in each.get("properties", {}).items():
            below = f"{path}.{key}" if path else key
            yield below
            yield from _paths(child, definitions, below, inner)
        for key, mark in (("additionalProperties", ".NAME"), ("items", "[]")):
            if isinstance(child := each.get(key), dict):
                yield from _paths(child, definitions, path + mark, inner)


def _members(node: Schema, definitions: Schema) -> Iterator[Schema]:
    """What a node of a schema is, or may be one of."""
    if reference := node.get("$ref"):
        yield from _members(definitions.get(reference.rpartition("/")[2], {}), definitions)
        return
    yield node
    for word in ("anyOf", "oneOf", "allOf"):
        for each in node.get(word, ()):
            yield from _members(each, definitions)


def _finding(about: Mapping[str, Any], data: Any) -> _Finding:
    """Place a finding in the data: what of pydantic's location is not there names a member of a union."""
    location = list(about["loc"])
    if location[-1:] == ["[key]"]:  # a name that is wrong, in place of its value
        location.pop()
    place: list[str | int] = []
    union: tuple[Place, str] | None = None
    at = data
    for number, part in enumerate(location):
        there = part in at if isinstance(at, Mapping) else isinstance(part, int) and isinstance(at, (list, tuple))
        if there or (about["type"] == "missing" and number == len(location) - 1):
            place.append(part)
            at = at[part] if there and not (isinstance(part, int) and part >= len(at)) else None
        elif union is None:
            union = (tuple(place), str(part))
    return _Finding(tuple(place), union, about)


def _by_union(found: Sequence[_Finding]) -> Iterable[list[_Finding]]:
    """Findings of one union together."""
    groups: dict[Any, list[_Finding]] = {}
    for number, each in enumerate(found):
        groups.setdefault(each.union[0] if each.union else number, []).append(each)
    return groups.values()


def _meant(group: Sequence[_Finding]) -> Sequence[_Finding]:
    """Of what may be several things, the findings on the one that is likely meant: it is of the kind, and knows most keys."""
    members: dict[str, list[_Finding]] = {}
    for each in group:
        members.setdefault(each.union[1] if each.union else "", []).append(each)
    if len(members) < 2:
        return group
    where = group[0].union[0] if group[0].union else ()
    fits = [m for m in members.values() if not any(each.of_another_kind and each.place == where for each in m)]
    return min(fits, key=lambda m: sum(each.about["type"] in _UNKNOWN for each in m)) if fits else group


def _follows(finding: _Finding, found: Sequence[_Finding]) -> bool:
    """Whether a list is too short for pydantic because entries of it are wrong, which is told already."""
    place = finding.place
    within = any(len(each.place) > len(place) and each.place[: len(place)] == place for each in found)
    return within and finding.about["type"] == "too_short"


def _lacks_blank(finding: _Finding) -> bool:
    """Whether a key swallowed its value, as in {years:5}."""
    return bool(finding.place) and ":" in str(finding.place[-1]) and finding.about["input"] is None


class _Tell:
    """The words for findings on settings of one model."""

    def __init__(self, schema: Schema, lists: str, at: str, written: Callable[[Place], str]) -> None:
        self.schema, self._definitions = schema, schema.get("$defs", {})
        self._lists, self._at, self._written = lists, at, written

    def line(self, finding: _Finding, findings: Sequence[_Finding]) -> str:
        """What is wrong, after the path of the key; with all that a union may be, where it is none of it."""
        about, place = finding.about, finding.place
        context = about.get("ctx", {})
        match about["type"]:
            case kind if kind in _UNKNOWN:
                said = "unknown key"
            case "missing" if place and isinstance(place[-1], int):
                place, said = place[:-1], f"too short, entry {place[-1]} is missing"
            case "missing" | "missing_argument":
                said = "this key is required"
            case "union_tag_not_found":
                place, said = (*place, str(context["discriminator"]).strip("'")), "this key is required"
            case "union_tag_invalid":
                place = (*place, str(context["discriminator"]).strip("'"))
                said = f"must be one of {_plain(context['expected_tags'])}, not {context['tag']!r}"
            case "literal_error" | "enum":
                said = f"must be one of {_plain(context['expected'])}, not {_shown(about['input'])}"
            case kind if kind in _KINDS:
                others = [_KINDS[each.about["type"]] for each in findings if each.of_another_kind and each.place == place]
                said = f"must be {' or '.join(dict.fromkeys(others))}, not {_shown(about['input'])}"
            case kind:
                said = _said(about["msg"])
                if not kind.endswith(("too_long", "too_short")) and not isinstance(about["input"], (Mapping, list, tuple)):
                    said += f", not {_shown(about['input'])}"
        path = self._written(place)
        where = path if self._at.endswith(": ") else ".".join(filter(None, (self._at, path)))
        return f"{where}: {said}" if where else said

    def hint(self, finding: _Finding) -> str:
        """What to try; empty where the schema says nothing of it."""
        about, place = finding.about, finding.place
        if about["type"] in _UNKNOWN:
            return self._of_unknown(finding)
        if _lacks_blank(finding):
            return self.meant(finding)
        if about["type"] in ("literal_error", "enum"):
            near = alike(str(about["input"]), _plain(about["ctx"]["expected"]).split(", "), NAMES)
            return f"did you mean {_any_of(near)}?" if near else ""
        if _KINDS.get(about["type"]) == _A_LIST and isinstance(about["input"], (str, int, float)):
            return f"a list is written in brackets: {self._written(place)}=[{about['input']}]"
        if about["type"] == "missing" and place and isinstance(place[-1], str):
            told = next((node["description"] for node in self._nodes(place) if "description" in node), "")
            keys = self._keys(place[:-1])
            return f"{place[-1]}: {told}" if told else f"keys here: {', '.join(keys)}" if keys else ""
        keys = self._keys(place) if _KINDS.get(about["type"]) == _A_MAPPING else []
        if "kind" in keys and about["input"] in self._choices((*place, "kind")):
            return f"did you mean {path_text(place)}.kind={about['input']}?"
        told = next((node["description"] for node in self._nodes(place) if "description" in node), "")
        if told and place:
            return f"{self._written(place)}: {told}"
        return f"keys of {path_text(place)}: {', '.join(keys)}" if 0 < len(keys) <= _MOST_KEYS else ""

    def _of_unknown(self, finding: _Finding) -> str:
        """What may be meant by a key, and the keys beside it."""
        said = self.meant(finding)
        *parent, _ = finding.place
        keys, above = self._keys(tuple(parent), finding.union), path_text(tuple(parent))
        if keys and len(keys) <= _MOST_KEYS:
            joint = " " if said.endswith("?") else "; " if said else ""
            said += f"{joint}keys {f'of {above}' if above else 'here'}: {', '.join(keys)}"
        return said or self._lists

    def meant(self, finding: _Finding) -> str:
        """What may be meant by a key, or where else it is told; empty where nothing is like it."""
        *parent, word = finding.place
        value, above = finding.about["input"], path_text(tuple(parent))
        if _lacks_blank(finding):
            return f"in YAML a blank follows the colon: {str(word).replace(':', ': ', 1)}"
        paths = [self._concrete(path, parent) for path in _key_paths(self.schema)]
        near = alike(str(word), [path for path in paths if path != path_text(finding.place)], KEYS, within=above)
        beside = any(path.rpartition(".")[0] == above for path in near)
        said = [f"did you mean {_any_of([self.with_value(path, value) for path in near])}?"] if near else []
        said += [told] if not beside and (told := ELSEWHERE.get(str(word).lower())) else []
        return " ".join(said)

    def _choices(self, place: Place) -> list[object]:
        """The values that a key can have, where they are listed."""
        nodes = (member for node in self._nodes(place) for member in _members(node, self._definitions))
        return [value for node in nodes for value in (*node.get("enum", ()), *([node["const"]] if "const" in node else ()))]

    def with_value(self, path: str, value: object) -> str:
        """A path, with the value as a list where the key takes one and somebody gave one thing."""
        nodes = self._nodes(path.split(".")) if "[]" not in path and isinstance(value, (str, int, float)) else ()
        lists = any(each.get("type") == "array" for node in nodes for each in _members(node, self._definitions))
        return f"{path}=[{value}]" if lists else path

    @staticmethod
    def _concrete(path: str, place: Sequence[str | int]) -> str:
        """A path of the schema with the names that the user gave, as far as it leads through the same mappings."""
        keys = path.split(".")
        for number, (key, said) in enumerate(zip(keys, place, strict=False)):
            if key == "NAME":
                keys[number] = str(said)
            elif key != said:
                break
        return ".".join(keys)

    def _nodes(self, place: Sequence[str | int], union: tuple[Place, str] | None = None) -> list[Schema]:
        """The nodes of the schema at a place, with what the parent says of it; of a union that its data name, that member."""
        nodes: list[Schema] = [self.schema]
        for number, key in enumerate((*place, None)):
            if union and tuple(place[:number]) == union[0]:
                named = [node.get("discriminator", {}).get("mapping", {}).get(union[1]) for node in nodes]
                nodes = [{"$ref": name} if name else node for name, node in zip(named, nodes, strict=True)]
            if key is None:
                break
            below: list[Schema] = []
            for each in (member for node in nodes for member in _members(node, self._definitions)):
                child = each.get("properties", {}).get(key)
                child = child or each.get("items" if isinstance(key, int) else "additionalProperties")
                below += [child] if isinstance(child, dict) else []
            nodes = below
        return nodes

    def _keys(self, place: Place, union: tuple[Place, str] | None = None) -> list[str]:
        """The keys of the mapping at a place."""
        nodes = (member for node in self._nodes(place, union) for member in _members(node, self._definitions))
        return list(dict.fromkeys(key for node in nodes for key in node.get("properties", {})))


def _said(message: str) -> str:
    """The words of a validator, or those of pydantic for a value."""
    words = _THING_SHOULD.sub("must ", message.removeprefix("Value error, ").replace(" after validation", ""))
    return words[:1].lower() + words[1:]


def _plain(names: str) -> str:
    """Names as pydantic lists them, "'a', 'b' or 'c'", with commas alone."""
    return names.replace("' or '", "', '").replace("'", "")


def _any_of(names: Sequence[str]) -> str:
    return " or ".join(names)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
