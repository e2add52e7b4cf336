"""How the words behind `cabinpose VERB` become a command: by tyro, from dataclasses and from the models of settings."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, make_dataclass, replace
from inspect import isclass, isfunction
from typing import Annotated, Any, get_args, get_origin

import tyro
from tyro.conf import DisallowNone, FlagCreatePairsOff, OmitArgPrefixes, OmitSubcommandPrefixes, SuppressFixed, arg
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

from cabinpose.app.cli.arguments import READS
from cabinpose.core import CabinposeError, ConfigError


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
        name, *words = words
        prog, chosen = f"{prog} {name}", command.command(name)
    elif isfunction(command):
        chosen = command()
    try:
        config = (DisallowNone, FlagCreatePairsOff, OmitSubcommandPrefixes, SuppressFixed)
        description = None if isclass(chosen) else about
        return tyro.cli(chosen, prog=prog, description=description, args=words, config=config, registry=READS)
    except ConfigError as error:
        error.hint = error.hint or f"`{prog} --help` says what each flag takes"
        raise
    except SystemExit as left:
        if left.code == 2 and isinstance(command, Choices):
            for flag in dict.fromkeys(word.partition("=")[0] for word in words if word.startswith("--")):
                if (having := command.having(flag)) and name not in having:
                    print(f"hint: {flag} is of {', '.join(having)}", file=sys.stderr)
        raise


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
        return replace(found, fields=tuple(map(_as_flag, found.fields)), instantiate=_checked(found.instantiate))


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


READS.struct_rule(_Rule())


def _checked(make: Callable[..., Any]) -> Callable[..., Any]:
    """What makes settings, with the errors of pydantic as ours."""

    def made(**values: Any) -> Any:
        try:
            return make(**values)
        except ValueError as error:
            if not hasattr(error, "errors"):
                raise
            first = error.errors()[0]
            reason = first["msg"].removeprefix("Value error, ")
            reason = reason[:1].lower() + reason[1:]
            if first["loc"]:
                flag = str(first["loc"][0]).replace("_", "-")
                reason = f"--{flag}: {reason}, not {first['input']}"
            raise ConfigError(reason) from error

    made.__doc__ = make.__doc__
    return made
