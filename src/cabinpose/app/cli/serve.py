"""`cabinpose serve`: serve a model to other programs by the Open Inference Protocol."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from typing import Annotated

from tyro.conf import Positional, arg

from cabinpose.app.cli.arguments import Maybe, RunsModels, placed
from cabinpose.app.cli.interrupt import interrupted_by_all


@dataclass(frozen=True, kw_only=True)
class Serve(RunsModels):
    """Serve a model by the Open Inference Protocol v2 over gRPC, for `--model grpc://HOST:PORT/NAME`.

    Ctrl-C ends it, and so do SIGTERM and SIGHUP, when the calls under way are answered.

    Needs the extra `remote`. There is neither encryption nor a password.
    """

    model: Annotated[Positional[str], arg(metavar="MODEL")]
    """Name of a packaged model, an ONNX or .npz file, or the address of a model on another server."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 lets other machines in."""
    port: int = 8001
    """Port to listen on; 0 takes a free one."""
    name: Maybe[str] = None
    """What the model is called; default: its own name."""
    max_message_mb: int = 64
    """Greatest message, MB."""
    no_shared_memory: bool = False
    """Take frames over the wire alone, from this machine too."""
    seconds: Maybe[float] = None
    """How long; default: until Ctrl-C."""


COMMAND = Serve
modernised = partial(placed, flag="--model")


def run(command: Serve) -> None:
    """Print the address, serve, and say at the end how many requests there were."""
    from cabinpose.app.cli.output import print_json, printable
    from cabinpose.core import ConfigError
    from cabinpose.estimate.remote import need_protocol, open_predictor

    if not 0 <= command.port <= 65535 or not 1 <= command.max_message_mb <= 1024:
        raise ConfigError("--port is from 0 to 65535, --max-message-mb from 1 to 1024", hint="leave them out for 8001 and 64")
    if command.seconds is not None and not command.seconds > 0:  # not a number as well
        raise ConfigError(f"--seconds {command.seconds:g} is no time to serve", hint="give --seconds more than 0")
    need_protocol()
    from cabinpose.app.models import tell_drive_side
    from cabinpose.app.serve import start_server

    predictor = open_predictor(command.model)
    tell_drive_side([predictor], command.drive_side)
    server = start_server(
        predictor,
        name=command.name,
        host=command.host,
        port=command.port,
        max_message_bytes=command.max_message_mb << 20,
        shared_memory=not command.no_shared_memory,
    )
    if not command.as_json:
        print(server.address, flush=True)
        print(printable(f"try it: cabinpose predict DATASET --model {server.address} --out found.jsonl"), file=sys.stderr)
    try:
        with interrupted_by_all():
            server.wait(command.seconds)
    except KeyboardInterrupt:
        pass
    finally:
        server.stop()
    if command.as_json:
        print_json({"address": server.address, **server.counts})
    else:
        print(", ".join(f"{count} {name}" for name, count in server.counts.items()), file=sys.stderr)
