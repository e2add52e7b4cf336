"""The command line: `cabinpose VERB`. Data goes to stdout, everything else to stderr; exit code 2 for mistakes a user can mend.

Each verb is a module of this folder (see `verb_module`). Its top level imports only the standard library, tyro and light
modules of this package, so that `--help` is quick; `run` imports what the work needs.
"""

from __future__ import annotations

import errno
import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from keyword import iskeyword
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TextIO

from cabinpose.app.cli.interrupt import Ended, interruptions
from cabinpose.app.cli.output import TOLD, printable

GROUPS = MappingProxyType(
    {
        "datasets": ("synth", "train-style", "config", "car", "info", "view", "export", "import", "upgrade"),
        "detectors": ("train", "adapt", "models", "calibrate-confidence", "predict", "evaluate", "experiment", "live", "serve"),
        "recordings": (
            "record",
            "recover",
            "forget",
            "emulate",
            "lab",
            "calibrate",
            "calibrate-noise",
            "align",
            "evaluate-mocap",
        ),
        "the browser": ("studio",),
        "this machine": ("bench",),
    }
)
VERBS = tuple(verb for verbs in GROUPS.values() for verb in verbs)


def _module_name(verb: str) -> str:
    name = verb.replace("-", "_")
    return f"{name}_" if iskeyword(name) else name


def verb_module(verb: str) -> ModuleType:
    """The module of a verb.

    Its first line is "`cabinpose VERB`: what it does." `COMMAND` is the type that tyro makes from the words behind the verb: a
    dataclass, several from `one_of`, a function that gives one, or `Choices`. `modernised(words)`, where there is one, gives
    words of an earlier release in today's spelling. `run(command)` does the work and returns the exit code, None for 0.
    """
    return import_module(f"{__name__}.{_module_name(verb)}")


def _summary(verb: str) -> str:
    """What a verb does, from the first line of its module: importing all of them would take longer than all the rest."""
    with Path(__file__).with_name(f"{_module_name(verb)}.py").open(encoding="utf-8") as file:
        return file.readline().partition(": ")[2].strip().strip('."')


def _help() -> str:
    import cabinpose

    lines = ["usage: cabinpose VERB ...", "       cabinpose VERB --help", "       cabinpose --version", ""]
    lines.append(cabinpose.__doc__ or "")
    for group, verbs in GROUPS.items():
        lines += ["", f"{group}:", *(f"  {verb:<15} {_summary(verb)}" for verb in verbs)]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    argv
        The words behind `cabinpose`; default: those of this process.

    Returns
    -------
    int
        The exit code: 0 done, 1 done with a problem, 2 a mistake that the user can mend, 130 interrupted, 143 asked to end.
    """
    from cabinpose.core import CabinposeError

    closed = _open_stdout()
    arguments = list(sys.argv[1:] if argv is None else argv)
    verb, rest = (arguments[0], arguments[1:]) if arguments else ("--help", [])
    try:
        with interruptions():
            return _done(verb, rest)
    except CabinposeError as error:
        print(f"error: {printable(error)}", file=sys.stderr)
        if error.hint:
            print(f"hint: {printable(error.hint)}", file=sys.stderr)
        return 2
    except ImportError as error:
        if error.name != "cabinpose._native":
            raise
        print(f"error: {error}", file=sys.stderr)  # the message ends with its own hint
        return 2
    except Ended:
        print("ended", file=sys.stderr)
        return 143
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of stdout has gone, for example `head`
        _silence()
    except OSError as error:
        from cabinpose.core import FULL_DISK, is_refused

        refused = error.errno in FULL_DISK or (closed and error.errno == errno.EBADF)
        if error.filename is None and (refused or _stdout_refuses()):
            _silence()
            print(f"error: cannot write to standard output: {error.strerror}", file=sys.stderr)
            return 1
        if not is_refused(error) or error.filename is None:
            raise
        print(f"error: cannot read or write {printable(error.filename)}: {error.strerror}", file=sys.stderr)
        print("hint: check what you may do there, and the space of the disk", file=sys.stderr)
        return 2
    return 0


def _done(verb: str, rest: list[str]) -> int:
    """Run a command that ends without an exception; its exit code."""
    import cabinpose
    from cabinpose.core import CabinposeError

    if verb == "help":  # of a command, as git has it
        verb, rest = (rest[0], ["--help"]) if rest else ("--help", [])
    if verb in ("-h", "--help", "--version"):
        print(cabinpose.__version__ if verb == "--version" else _help(), flush=True)
        return 0
    if verb not in VERBS:
        from cabinpose.app.cli.complaints import unknown_command

        raise unknown_command(verb, VERBS)
    from cabinpose.app.cli.commands import parsed

    module = verb_module(verb)
    with warnings.catch_warnings():
        warnings.showwarning = _print_warning
        TOLD.clear()
        words = module.modernised(rest) if hasattr(module, "modernised") else rest
        flags = [word.partition("=")[0] for word in words if word.startswith("--")]
        if twice := next((flag for flag in flags if flags.count(flag) > 1), None):  # the last one alone would count
            raise CabinposeError(f"{twice} is given twice", hint=f"give all its values behind one: {twice} A B")
        command = parsed(verb, module.COMMAND, words, _summary(verb))
        from cabinpose.core import check_output, forget_told_cameras

        forget_told_cameras()

        for name in ("out", "report"):  # before the work, which would be lost
            if isinstance(path := getattr(command, name, None), Path):
                check_output(path)
        code: int | None = module.run(command)
        sys.stdout.flush()
        return code or 0


def _stdout_refuses() -> bool:
    try:
        sys.stdout.flush()
    except OSError:
        return True
    return False


def _silence() -> None:
    """Nothing more goes to stdout, nor the rest of it at the end of the process."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _open_stdout() -> bool:
    """Whether stdout is closed; it becomes one that refuses, as no file that is opened later may get its number."""
    closed = sys.stdout is None
    if closed:
        descriptor = os.open(os.devnull, os.O_RDONLY)
        if descriptor != 1:
            os.dup2(descriptor, 1)
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115 - it lives as long as the process
    return closed


def _print_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, file: TextIO | None = None,
    line: str | None = None,
) -> None:  # fmt: skip
    """Print a warning of this package in one line, and one of another library, which has another category, as Python does."""
    ours = category is UserWarning
    if ours:
        TOLD.append(printable(message))
    text = f"warning: {printable(message)}\n" if ours else warnings.formatwarning(message, category, filename, lineno, line)
    (file or sys.stderr).write(text)
