"""The studio's server: one web application on one port."""

from __future__ import annotations

import ctypes
import secrets
import socket
import sys
from collections.abc import Callable

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import PlainTextResponse
from nicegui import app as nicegui_app
from nicegui import ui

from cabinpose.app.studio.access import Guard, in_address
from cabinpose.app.studio.canvas import input_routes
from cabinpose.app.studio.clouds import cloud_routes
from cabinpose.app.studio.page import shared_by, studio_page
from cabinpose.app.studio.pictures import image_routes
from cabinpose.app.studio.thumbs import thumb_routes
from cabinpose.app.studio.workspace import Workspace
from cabinpose.core import ConfigError

LOOPBACK = ("127.0.0.1", "localhost", "::1")
_M_ARENA_MAX = -8  # of glibc's malloc.h
CONNECT_S = 30.0  # within which a browser that has loaded the page opens its WebSocket


def serve(
    workspace: Workspace, *, host: str = "127.0.0.1", port: int = 0, token: str | None = None,
    ready: Callable[[str], None] = print,
) -> None:  # fmt: skip
    """Serve until Ctrl-C. `ready` is given the address once it can be opened; port 0 takes a free one.

    Raises ConfigError for an address beyond this machine without a token, a token that no browser can bring, and a port that is
    taken.
    """
    if token is not None and (not token.strip() or not token.isprintable()):
        raise ConfigError("the token is empty, or has characters that cannot be printed", hint="give letters and digits")
    if host not in LOOPBACK and not token:
        raise ConfigError(
            f"{host} is open to other machines", hint="give --token, which their browsers then need, or leave out --host"
        )
    _few_heaps()
    listening = _bound(host, port)
    address = f"http://{host}:{listening.getsockname()[1]}/" + (f"?token={in_address(token)}" if token else "")
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
    app.include_router(thumb_routes(workspace.of_key))
    app.include_router(input_routes())
    shared = shared_by(workspace)
    for each in shared:
        app.include_router(each.routes())
        nicegui_app.on_shutdown(each.stop)

    @ui.page("/")
    async def page(request: Request) -> None:
        """Build the page once somebody looks at it: whoever loads it without a WebSocket leaves nothing behind."""
        await ui.context.client.connected(timeout=CONNECT_S)
        studio_page(workspace, shared, dict(request.query_params), str(ui.context.client.tab_id)[:36])

    nicegui_app.add_exception_handler(404, _not_found)
    ui.run_with(
        app, title="cabinpose studio", dark=None, tailwind=False, show_welcome_message=False, reconnect_timeout=10.0,
        storage_secret=secrets.token_hex(),
    )  # fmt: skip
    app.add_middleware(Guard, token=token)
    return app


def _few_heaps() -> None:
    """Let threads share two heaps, where the C library is glibc.

    It has up to eight a processor, and what one has let go no other fills: memory grows with each thread that answers.
    """
    if (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)) is not None:
        mallopt(_M_ARENA_MAX, 2)


def _not_found(request: Request, _: Exception) -> PlainTextResponse:
    """Of a path that is none: no page, which NiceGUI's own answer would be."""
    return PlainTextResponse(f"There is no {request.url.path} in this studio.\n", 404)


def _bound(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
    except (OSError, OverflowError) as error:  # the latter of a number that is no port
        listening.close()
        why = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"{host}:{port} cannot be listened on ({why})", hint="give another --port, or 0") from error
    listening.listen()  # who opens the address at once waits for the first answer instead of being refused
    return listening
