"""Who may use the studio: this machine's own browser, or who knows the token."""

from __future__ import annotations

import hmac
from http.cookies import SimpleCookie
from typing import Any
from urllib.parse import parse_qs, quote, unquote, urlsplit

from starlette.types import ASGIApp, Receive, Scope, Send

COOKIE = "cabinpose-studio"
_LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
_POLICY = (b"content-security-policy", b"frame-ancestors 'self'")


class Guard:
    """Middleware that answers 403 to whoever may not look.

    Without a token, only requests to this machine by its own name pass: a page from elsewhere, which a name server points here,
    carries another host, and a script of it another origin. With a token, it has to come once as `?token=`, see `in_address`, and
    is then kept in a cookie.
    """

    def __init__(self, app: ASGIApp, token: str | None) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request pass, or end it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        query = scope.get("query_string", b"").decode("latin-1").replace("+", "%2B")  # a plus that somebody typed is no blank
        given = parse_qs(query).get("token", [""])[0]
        if not self._allowed(headers, given):
            await _refuse(scope, send)
            return

        async def marked(message: Any) -> None:
            if message["type"] == "http.response.start":
                message.setdefault("headers", []).append(_POLICY)
                if self._token is not None and given:
                    cookie = f"{COOKIE}={in_address(given)}; HttpOnly; SameSite=Strict; Path=/".encode()
                    message["headers"].append((b"set-cookie", cookie))
            await send(message)

        await self._app(scope, receive, marked)

    def _allowed(self, headers: dict[str, str], given: str) -> bool:
        host = headers.get("host", "")
        origin = headers.get("origin")
        if origin is not None and _host_of(origin) != host:
            return False
        if self._token is None:
            return host.rsplit(":", 1)[0] in _LOOPBACK or host in _LOOPBACK
        kept = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        known = given or (unquote(kept.value) if kept is not None else "")
        return hmac.compare_digest(known.encode(), self._token.encode())


def in_address(token: str) -> str:
    """The token as it stands in an address or a cookie: ASCII, whatever its letters."""
    return quote(token, safe="")


def _host_of(origin: str) -> str | None:
    try:
        return urlsplit(origin).netloc
    except ValueError:  # half an IPv6 address
        return None


async def _refuse(scope: Scope, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 4403})
        return
    await send({"type": "http.response.start", "status": 403, "headers": [(b"content-type", b"text/plain")]})
    await send({"type": "http.response.body", "body": b"This studio needs the address that it printed when it started.\n"})
