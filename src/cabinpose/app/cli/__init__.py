"""The command line: `cabinpose <verb>`. Data on stdout, everything else on stderr, exit code 2 for what a user can mend."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module
from typing import TextIO

from cabinpose.app.cli.output import printable

_OF_DATASETS = ("info", "view", "export", "evaluate", "train", "predict")  # the dataset is what stands behind them


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code: 0 done, 1 done and not well, 2 a mistake the user can mend, 130 interrupted."""
    import tyro

    import cabinpose
    from cabinpose.app.cli.commands import RUNNERS, STYLE, VERBS, command_line
    from cabinpose.core.errors import CabinposeError

    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments == ["--version"]:
        print(cabinpose.__version__)
        return 0
    if arguments and not arguments[0].startswith("-") and arguments[0] not in VERBS:
        close = get_close_matches(arguments[0], VERBS, n=1)
        print(f"error: there is no command '{arguments[0]}'", file=sys.stderr)
        print("hint: " + (f"did you mean {close[0]}? " if close else "") + "`cabinpose --help` lists them", file=sys.stderr)
        return 2
    if arguments and arguments[0] in _OF_DATASETS and any(w == "--data" or w.startswith("--data=") for w in arguments):
        print("error: there is no flag --data", file=sys.stderr)
        print(f"hint: the dataset is given behind the verb: cabinpose {arguments[0]} DATASET", file=sys.stderr)
        return 2
    try:
        command = tyro.cli(
            command_line, prog="cabinpose", description=cabinpose.__doc__, args=arguments or ["--help"], config=STYLE
        )
        with warnings.catch_warnings():
            warnings.showwarning = _print_warning
            code: int | None = import_module(f"{__name__}.{RUNNERS[type(command)]}").run(command)
            return code or 0
    except CabinposeError as error:
        print(f"error: {printable(error)}", file=sys.stderr)
        if error.hint:
            print(f"hint: {printable(error.hint)}", file=sys.stderr)
        return 2
    except ImportError as error:
        if error.name != "cabinpose._native":
            raise
        print(f"error: {error}", file=sys.stderr)  # it ends with its hint
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of stdout has gone, for example `head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _print_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """What the package warns of in one line; of other libraries, which warn by other categories, as Python has it."""
    text = (
        f"warning: {printable(message)}\n"
        if category is UserWarning
        else warnings.formatwarning(message, category, filename, lineno, line)
    )
    (file or sys.stderr).write(text)
