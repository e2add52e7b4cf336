"""What is chosen by name: the package's own and what installed extensions add.

Each kind of thing has an entry point group, `cabinpose.<kind>`, in which the package registers its own like anybody else. Names
are listed from the metadata of installed packages; a thing is imported when it is first asked for.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from cabinpose.core.errors import CabinposeError, ConfigError, ExtensionError, unknown_name

if TYPE_CHECKING:
    from importlib.metadata import Distribution, EntryPoint

T = TypeVar("T")
OURS = "cabinpose"
_HINT = "update or uninstall {}; everything else works without it"


class Outline(NamedTuple):
    """The class of a thing, as its source has it: the first line of its docstring, names of its bases and of its methods."""

    summary: str
    bases: tuple[str, ...]
    methods: frozenset[str]


class Registry(Generic[T]):
    """The things of one kind by name.

    Parameters
    ----------
    group
        The entry point group, "cabinpose.formats".
    kind
        What one is called in messages, "format".
    expected
        The type of one, or of which one is a subclass where `subclass` is set.
    named
        Whether a thing has a `name`, which has to be that of its entry point.

    Notes
    -----
    An entry point names the thing itself, or a table (a mapping) that has it under the entry point's name. The order is that of
    our metadata, then other packages' by name. Where another package uses a name of ours, ours stays; where two others use the
    same name, neither is taken. `conflicts` says so, and who asks for such a name is told.
    """

    def __init__(self, group: str, kind: str, expected: type[Any], *, subclass: bool = False, named: bool = False) -> None:
        self.group, self.kind = group, kind
        self._expected, self._subclass, self._named = expected, subclass, named
        self._loaded: dict[str, T] = {}

    def names(self, *, own: bool = False) -> tuple[str, ...]:
        """All names, without importing anything; `own`: the package's alone."""
        offers = _offers(self.group)
        return tuple(name for name, entries in offers.items() if not own or _package(entries[0]) == OURS)

    def __iter__(self) -> Iterator[str]:
        """The names, as those of a mapping."""
        return iter(self.names())

    def __contains__(self, name: object) -> bool:
        return name in _offers(self.group)

    def __getitem__(self, name: str) -> T:
        """The thing of this name.

        Raises
        ------
        ConfigError
            For a name that does not exist; lists the ones that do.
        ExtensionError
            Where another package's cannot be loaded, is of another type, wants another version of this package, or where two
            packages use the name. The message names the package.
        """
        if name not in self._loaded:
            if name not in self:
                raise unknown_name(self.kind, name, self.names())
            entry, *others = _offers(self.group)[name]
            if others and _package(entry) != OURS:
                raise ExtensionError(self._taken(name), hint="uninstall one of them")
            if others:
                warnings.warn(self._taken(name), stacklevel=2)
            self._loaded[name] = self._load(entry)
        return self._loaded[name]

    def items(self) -> Iterator[tuple[str, T]]:
        """Names and things, one after another; what cannot be loaded is left out, with a warning."""
        for name in self.names():
            try:
                found = self[name]
            except CabinposeError as error:
                warnings.warn(f"{error.in_one_line()}; it is left out", stacklevel=2)
            else:
                yield name, found

    def outline(self, name: str) -> Outline | None:
        """The class of a thing, read from its module's source without importing it, for lists such as those of `--help`.

        None where the source does not have the class itself, or `NAME = Class(...)` and the class beside it.
        """
        if name not in self:
            raise unknown_name(self.kind, name, self.names())
        return _outline(_offers(self.group)[name][0])

    def package(self, name: str) -> str:
        """The distribution that offers the thing of this name; ConfigError for a name that does not exist."""
        if name not in self:
            raise unknown_name(self.kind, name, self.names())
        return _package(_offers(self.group)[name][0])

    def conflicts(self) -> tuple[str, ...]:
        """A sentence for each name that more than one package uses."""
        return tuple(self._taken(name) for name, entries in _offers(self.group).items() if len(entries) > 1)

    def _taken(self, name: str) -> str:
        first, *others = (_package(entry) for entry in _offers(self.group)[name])
        if first == OURS:
            return f"the {self.kind} '{name}' of {', '.join(others)} is left out: {OURS} has one of this name"
        return f"the {self.kind} '{name}' is left out: {first}, {', '.join(others)} all have one of this name"

    def _load(self, entry: EntryPoint) -> T:
        package = _package(entry)
        if package != OURS:
            _check_version(entry)
        try:
            found = entry.load()
        except CabinposeError:  # for instance a missing extra: says itself what to do
            raise
        except Exception as error:
            if package == OURS:
                raise
            what = f"the {self.kind} '{entry.name}' of {package} cannot be loaded: {type(error).__name__}: {error}"
            raise ExtensionError(what, hint=_HINT.format(package)) from error
        if isinstance(found, Mapping) and not self._fits(found):
            found = found.get(entry.name)
        if not self._fits(found):
            what = f"the {self.kind} '{entry.name}' of {package} is not a {self._expected.__name__}, but {found!r:.80}"
            raise ExtensionError(what, hint=_HINT.format(package))
        if self._named and found.name != entry.name:
            what = f"the {self.kind} '{entry.name}' of {package} calls itself '{found.name}'"
            raise ExtensionError(what, hint=_HINT.format(package))
        return found

    def _fits(self, found: object) -> bool:
        if self._subclass:
            return isinstance(found, type) and issubclass(found, self._expected)
        return isinstance(found, self._expected)


@cache
def _installed() -> Any:
    """Entry points of all groups: asked for by group, each would be looked for in all packages again, which takes 20 ms.

    Of a type that Python 3.12 has changed; both have `select`.
    """
    from importlib.metadata import entry_points  # noqa: PLC0415 - what `--help` does without

    return entry_points()


@cache
def _offers(group: str) -> dict[str, list[EntryPoint]]:
    """Entry points by name: ours first, then by package."""
    entries = _installed().select(group=group)
    ours = {entry.name: [entry] for entry in entries if _package(entry) == OURS}
    others = [entry for entry in entries if _package(entry) != OURS]
    for entry in sorted(others, key=lambda entry: (_package(entry), entry.name)):
        ours.setdefault(entry.name, []).append(entry)
    return ours


def _package(entry: EntryPoint) -> str:
    """The distribution of an entry point; what stands in this package is its own, without a look at metadata."""
    if entry.module.partition(".")[0] == OURS:
        return OURS
    return _name(entry.dist) if entry.dist is not None else "an unnamed package"


@cache
def _name(package: Distribution) -> str:
    """Its name, for which the file of its metadata is read."""
    return package.name


def _outline(entry: EntryPoint) -> Outline | None:
    import ast  # noqa: PLC0415 - 5 ms, for lists alone

    try:
        tree = ast.parse(_source_file(entry.module).read_bytes())
    except (OSError, SyntaxError):
        return None
    classes: dict[str, ast.ClassDef] = {}
    for node in tree.body:
        match node:
            case ast.ClassDef(name=name):
                classes[name] = node
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Call(func=ast.Name(id=kind))) if kind in classes:
                classes[name] = classes[kind]
    made = classes.get(entry.attr)
    if made is None:
        return None
    summary = (ast.get_docstring(made) or "").partition("\n")[0]
    methods = frozenset(node.name for node in made.body if isinstance(node, ast.FunctionDef))
    return Outline(summary, tuple(base.id for base in made.bases if isinstance(base, ast.Name)), methods)


def _source_file(module: str) -> Path:
    """The file of a module that is not imported, nor are the packages above it."""
    from importlib.util import find_spec  # noqa: PLC0415 - as above

    package, *inner = module.split(".")
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise FileNotFoundError(module)
    return Path(spec.origin).parent.joinpath(*inner).with_suffix(".py") if inner else Path(spec.origin)


def _check_version(entry: EntryPoint) -> None:
    """Raise ExtensionError where the package of an entry point requires another version of this one."""
    from importlib.metadata import version  # noqa: PLC0415 - see above

    from packaging.requirements import Requirement  # noqa: PLC0415 - for extensions alone

    here = version(OURS)
    for text in entry.dist.requires or () if entry.dist is not None else ():
        wanted = Requirement(text)
        marked = wanted.marker is not None and not wanted.marker.evaluate({"extra": ""})
        if wanted.name.lower() == OURS and not marked and not wanted.specifier.contains(here, prereleases=True):
            what = f"{_package(entry)} is built for {OURS} {wanted.specifier}; this is {here}"
            raise ExtensionError(what, hint=_HINT.format(_package(entry)))


def one_of(registry: Registry[T], name: str) -> str:
    """`name`, for validators of settings; ValueError lists the names that exist."""
    if name not in registry:
        error: ConfigError = unknown_name(registry.kind, name, registry.names())
        raise ValueError(f"{error}; {error.hint}")
    return name
