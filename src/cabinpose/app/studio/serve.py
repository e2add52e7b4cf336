"""The studio's server: one web application on one port."""

from __future__ import annotations

import secrets
import socket
import sys
from collections.abc import Callable

import uvicorn
from fastapi import FastAPI
from nicegui import app as nicegui_app
from nicegui import ui

from cabinpose.app.studio.access import Guard
from cabinpose.app.studio.clouds import cloud_routes
from cabinpose.app.studio.page import shared_by, studio_page
from cabinpose.app.studio.pictures import image_routes
from cabinpose.app.studio.workspace import Workspace
from cabinpose.core import ConfigError

LOOPBACK = ("127.0.0.1", "localhost", "::1")


def serve(
    workspace: Workspace, *, host: str = "127.0.0.1", port: int = 0, token: str | None = None,
    ready: Callable[[str], None] = print,
) -> None:  # fmt: skip
    """Serve until Ctrl-C. `ready` is given the address once it can be opened; port 0 takes a free one.

    Raises ConfigError for an address beyond this machine without a token, and a port that is taken.
    """
    if host not in LOOPBACK and not token:
        raise ConfigError(
            f"{host} is open to other machines", hint="give --token, which their browsers then need, or leave out --host"
        )
    listening = _bound(host, port)
    address = f"http://{host}:{listening.getsockname()[1]}/" + (f"?token={token}" if token else "")
    server = uvicorn.Server(uvicorn.Config(application(workspace, token), log_level="warning", ws_max_size=1 << 24))
    ready(address)
    sys.stdout.flush()
    try:
        server.run(sockets=[listening])
    finally:
        workspace.close()


def application(workspace: Workspace, token: str | None = None) -> FastAPI:
    """The web application of a workspace."""
    app = FastAPI(openapi_url=None)
    app.include_router(image_routes(workspace.of_key))
    app.include_router(cloud_routes(workspace.of_key))
    shared = shared_by(workspace)
    for each in shared:
        app.include_router(each.routes())
        nicegui_app.on_shutdown(each.stop)
    ui.run_with(
        app, root=lambda: studio_page(workspace, shared), title="cabinpose studio", dark=None, tailwind=False,
        show_welcome_message=False, reconnect_timeout=10.0, storage_secret=secrets.token_hex(),
    )  # fmt: skip
    app.add_middleware(Guard, token=token)
    return app


def _bound(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
    except OSError as error:
        listening.close()
        raise ConfigError(f"{host}:{port} cannot be listened on ({error.strerror})", hint="give another --port, or 0") from error
    listening.listen()  # who opens the address at once waits for the first answer instead of being refused
    return listening
