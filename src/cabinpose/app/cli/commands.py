"""How the words behind `cabinpose VERB` become a command: by tyro, from dataclasses and from the models of settings."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import MISSING, dataclass, field, make_dataclass, replace
from inspect import isclass, isfunction
from typing import Annotated, Any, Union, get_args, get_origin

import tyro
from tyro.conf import DisallowNone, FlagCreatePairsOff, OmitArgPrefixes, OmitSubcommandPrefixes, SuppressFixed, arg
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

from cabinpose.app.cli.arguments import READS
from cabinpose.core import CabinposeError, ConfigError, explained


@dataclass(frozen=True)
class Choices:
    """`COMMAND` of a verb whose first word says what may follow, such as `export coco`. Only what it names is imported.

    kind: what the first word is, "format" · listed: summaries by name, under headings · command: the command of a name; raises
    ConfigError for an unknown one · having: the names that have a flag, for those who give it to another one.
    """

    kind: str
    listed: Callable[[], Mapping[str, Mapping[str, str]]]
    command: Callable[[str], type]
    having: Callable[[str], Sequence[str]] = lambda _: ()

    def names(self) -> tuple[str, ...]:
        """All that the first word can be."""
        return tuple(name for summaries in self.listed().values() for name in summaries)

    def help(self, verb: str, about: str) -> str:
        """What `cabinpose VERB --help` prints."""
        usage = f"cabinpose {verb} {self.kind.upper()}"
        lines = [f"usage: {usage} ...", f"       {usage} --help", "", about]
        for heading, summaries in self.listed().items():
            lines += ["", f"{heading}:", *(f"  {name:<15} {summary.removesuffix('.')}" for name, summary in summaries.items())]
        return "\n".join(lines)


def parsed(verb: str, command: Any, words: Sequence[str], about: str) -> Any:
    """The command that words say, or an exit of the process, after help or a complaint.

    Parameters
    ----------
    verb
        The word before them.
    command
        `COMMAND` of its module: a type, several of them from `one_of`, a function that gives the type, or `Choices`.
    words
        The words.
    about
        What the verb does.
    """
    prog, chosen = f"cabinpose {verb}", command
    if isinstance(command, Choices):
        if not words:
            raise CabinposeError(f"`{prog}` needs a {command.kind}", hint=f"`{prog} --help` lists them")
        if words[0] in ("-h", "--help"):
            print(command.help(verb, about))
            raise SystemExit(0)
        name, *rest = words
        try:
            prog, chosen = f"{prog} {name}", command.command(name)
        except ConfigError as error:
            from cabinpose.app.cli.complaints import misplaced

            meant = misplaced(prog, command.kind, command.names(), words)
            error.hint = meant if meant and not meant.endswith("; ") else f"{meant}{error.hint}"
            raise
        words = rest
    else:
        chosen = command() if isfunction(command) else command
        if (inner := _inner(chosen)) and not (words and words[0] in ("-h", "--help")):
            prog, chosen, words = _chosen(prog, inner, words)
    said = io.StringIO()
    _RULE.fields.clear()
    try:
        config = (DisallowNone, FlagCreatePairsOff, OmitSubcommandPrefixes, SuppressFixed)
        description = None if isclass(chosen) else about
        with redirect_stderr(said):
            return tyro.cli(chosen, prog=prog, description=description, args=words, config=config, registry=READS)
    except ConfigError as error:
        error.hint = error.hint or f"`{prog} --help` says what each flag takes"
        raise
    except SystemExit as left:
        if left.code == 2:
            from cabinpose.app.cli.complaints import complaint

            having = command.having if isinstance(command, Choices) else lambda _: ()
            if wrong := complaint(prog, _RULE.fields, words, having):
                raise wrong from None
        sys.stderr.write(said.getvalue())  # of tyro itself
        raise


def _inner(command: Any) -> dict[str, Any]:
    """The verbs of a verb, by name; none where the command is one."""
    inner = {}
    for each in get_args(command) if get_origin(command) is Union else ():
        kind, mark = get_args(each)
        inner[mark.name] = kind
    return inner


def _chosen(prog: str, inner: Mapping[str, Any], words: Sequence[str]) -> tuple[str, Any, Sequence[str]]:
    """The one that the first word names, and the words behind it."""
    if not words or words[0] not in inner:
        from cabinpose.app.cli.complaints import unknown_inner

        raise unknown_inner(prog, tuple(inner), words[0] if words else "")
    return f"{prog} {words[0]}", inner[words[0]], words[1:]


def with_settings(command: type, name: str, settings: type, default: Any = None, **about: Any) -> type:
    """A command, with the fields of a model of settings among its flags, as its field `settings`.

    Parameters
    ----------
    command
        A dataclass.
    name
        The heading of their flags.
    settings
        A dataclass or pydantic model.
    default
        The settings from which flags depart; None: those of the model.
    **about
        Attributes of the class, `__doc__` among them.
    """
    flags = Annotated[settings, arg(name=name), OmitArgPrefixes]  # type: ignore[valid-type]  # known when it runs
    given = field(default=MISSING if default is None else default)
    fields = [("settings", flags, given)]
    return make_dataclass(command.__name__, fields, bases=(command,), frozen=True, kw_only=True, namespace=about)


class _Rule:
    """Tyro's own rules for dataclasses and pydantic models, but that help shows no empty default and errors are ours."""

    def __init__(self) -> None:
        self._asking = False
        self.fields: list[StructFieldSpec] = []  # of what was asked for since the list was emptied

    def __call__(self, info: StructTypeInfo) -> StructConstructorSpec | None:
        if self._asking:  # this rule is asked too
            return None
        self._asking = True
        try:
            found = ConstructorRegistry.get_struct_spec(info)
        finally:
            self._asking = False
        if not isinstance(found, StructConstructorSpec):
            return None
        self.fields += found.fields
        return replace(found, fields=tuple(map(_as_flag, found.fields)), instantiate=_checked(found.instantiate, info.type))


def _as_flag(field: StructFieldSpec) -> StructFieldSpec:
    """A field whose help shows no empty default, and says of what is on that the flag, --no-NAME, switches it off."""
    if field.default is True:
        about = (field.helptext() if callable(field.helptext) else field.helptext) or ""
        return replace(field, type=_hinted(field.type, "(default: on)"), helptext=f"Switch off: {about[:1].lower()}{about[1:]}")
    return replace(field, type=_hinted(field.type, "")) if field.default in (None, ()) else field


def _hinted(annotation: Any, default: str) -> Any:
    """A type whose help shows this of its default, unless it says itself what to show."""
    kind, *more = get_args(annotation) if get_origin(annotation) is Annotated else (annotation,)
    return Annotated[(kind, arg(help_behavior_hint=default), *more)]


_RULE = _Rule()
READS.struct_rule(_RULE)


def _flag(place: Sequence[str | int]) -> str:
    """The flag of a key of settings."""
    return f"--{'-'.join(map(str, place)).replace('_', '-')}" if place else ""


def _checked(make: Callable[..., Any], model: Any) -> Callable[..., Any]:
    """What makes settings, with the errors of pydantic as ours."""

    def made(**values: Any) -> Any:
        try:
            return make(**values)
        except ValueError as error:
            if not hasattr(error, "errors"):
                raise
            raise ConfigError(str(explained(error, model, values, lists="", written=_flag))) from error

    made.__doc__ = make.__doc__
    return made
