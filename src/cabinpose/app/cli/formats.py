"""What `cabinpose import` and `export` share: a command a format, with that format's options alone."""

from __future__ import annotations

import shlex
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from typing import Any, Literal

from cabinpose.app.cli.commands import Choices, with_settings
from cabinpose.core import CabinposeError, ConfigError, unknown_name

Method = Literal["read", "write"]


def choices(method: Method, commands: Mapping[str, type]) -> Choices:
    """The formats of a verb; commands: by the heading of formats, dataclasses whose flags come before the format's own."""

    def command(name: str) -> type:
        from cabinpose.store.convert import FORMATS

        if name not in FORMATS:
            raise unknown_name("format", name, names_of(method))
        form = FORMATS[name]
        if not form.can(method):
            verb = "read" if method == "read" else "written"
            raise ConfigError(f"the format '{name}' cannot be {verb}", hint=f"those that can: {', '.join(names_of(method))}")
        about = {"form": form, "format": name, "__doc__": type(form).__doc__}
        return with_settings(commands[form.heading], name, form.options(method), **about)

    def having(flag: str) -> list[str]:
        found = []
        for name in names_of(method):
            with suppress(CabinposeError):  # of an extension, or whose package is missing
                made: Any = command(name)
                known = {each.name for each in (*fields(made), *fields(made.form.options(method)))}
                if flag.removeprefix("--").replace("-", "_") in known:
                    found.append(name)
        return found

    return Choices("format", lambda: listed(method), command, having)


def listed(method: Method) -> dict[str, dict[str, str]]:
    """What there is to say of the formats that are read or written, by heading and name, read from their sources."""
    from cabinpose.store.convert import FORMATS, Format

    headings = {kind.__name__: kind.heading for kind in Format.__subclasses__()}
    found: dict[str, dict[str, str]] = {heading: {} for heading in headings.values()}
    for name in FORMATS.names():
        outline = FORMATS.outline(name)
        heading = next((headings[base] for base in outline.bases if base in headings), None) if outline is not None else None
        if outline is not None and heading is not None:
            if method in outline.methods:
                found[heading][name] = outline.summary
            continue
        try:  # its class is not beside it
            form = FORMATS[name]
        except CabinposeError as error:
            warnings.warn(f"{error.in_one_line()}; it is left out", stacklevel=2)
            continue
        if form.can(method):
            found[form.heading][name] = (type(form).__doc__ or "").partition("\n")[0]
    return {heading: summaries for heading, summaries in found.items() if summaries}


def names_of(method: Method, heading: str | None = None) -> list[str]:
    """The formats that are read or written, of all headings or of one."""
    return [name for title, summaries in listed(method).items() if heading in (None, title) for name in summaries]


def modern(verb: str, words: Sequence[str]) -> list[str]:
    """The words in today's spelling: `import coco SOURCE` for `import SOURCE --format coco`, `export onnx` for `export --onnx`.

    What is told with a warning goes on working for one release.
    """
    flags = [word.partition("=")[0] for word in words]
    flag = next((flag for flag in ("--format", "--onnx") if flag in flags), None)
    if flag is None:
        return list(words)
    at = flags.index(flag)
    value, end = words[at].partition("=")[2], at + 1
    if not value:
        value, end = words[end] if end < len(words) else "", end + 1
    if not value:
        raise ConfigError(f"{flag} needs a value", hint=f"cabinpose {verb} FORMAT ... is how formats are named now")
    rest = [*words[:at], *words[end:]]
    if flag == "--onnx":
        now = ["onnx", value, *rest]
    else:
        now = ["coco-labels" if value == "coco" and "--corrects" in flags else value, *rest]
    now = [f"--rate-hz{word.removeprefix('--rate')}" if word.partition("=")[0] == "--rate" else word for word in now]
    told = f"`{flag}` goes on working for one release; write: cabinpose {verb} {shlex.join(now)}"
    warnings.warn(told, stacklevel=2)
    return now
