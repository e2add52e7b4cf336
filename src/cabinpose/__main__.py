"""The program: `cabinpose`, and `python -m cabinpose` where scripts are not on the path."""

from __future__ import annotations

import os
import signal
import sys

_TOLD = {signal.SIGINT: b"interrupted\n", signal.SIGTERM: b"ended\n"}  # as the command line tells, once it is loaded


def _leave(kind: int, _: object) -> None:
    """End at once: nothing is begun yet, and an exception in the middle of an import would come out as one of another kind."""
    os.write(2, _TOLD[signal.Signals(kind)])
    os._exit(128 + kind)


def main() -> int:
    """Run the command line; its exit code. Ctrl-C and SIGTERM end it while it is loaded as they do later."""
    usual = {kind: signal.getsignal(kind) for kind in _TOLD}
    heeded = {kind: handler for kind, handler in usual.items() if handler is not signal.SIG_IGN}
    for kind in heeded:
        signal.signal(kind, _leave)
    from cabinpose.app.cli import main as run  # noqa: PLC0415 - see above

    for kind, handler in heeded.items():
        signal.signal(kind, handler)
    return run()


if __name__ == "__main__":
    sys.exit(main())
