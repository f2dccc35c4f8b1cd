"""Who may see the page: programs on this machine, or anyone with the token; never a script of another site."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import re
from pathlib import Path
from urllib.parse import parse_qs

from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from documents.files import read_regular
from imaging.errors import ConfigurationError


async def read_body(request: Request, longest: int) -> bytes:
    """The body of a request.

    Raises HTTPException if it has more than `longest` bytes, or the client hung up before its end.
    """
    body = b""
    try:
        async for chunk in request.stream():
            body += chunk
            if len(body) > longest:
                raise HTTPException(413, "too long\n")
    except ClientDisconnect:
        raise HTTPException(400, "incomplete\n") from None
    return body


COOKIE = "autoexpose_page"
LEAST_TOKEN = 16
"""Characters. A token is never typed, so it can be long enough not to be guessed."""

_MOST_TOKEN_BYTES = 1 << 12
_COOKIE_AGE_S = 30 * 24 * 3600
_LONGEST_FORM = 4096
_HOST = re.compile(r"(?:(?P<name>[A-Za-z0-9._-]+)|\[(?P<address>[0-9A-Fa-f:.]+)\])(?::[0-9]{1,5})?")
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; base-uri 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cache-Control": "no-cache",
}


def is_loopback(host: str | None) -> bool:
    """Whether a name or address is this machine's own; any name other than `localhost` may belong to anyone."""
    try:
        return host == "localhost" or ipaddress.ip_address(host or "").is_loopback
    except ValueError:
        return False


def read_token(file: Path) -> str:
    """The token in a file; raises ConfigurationError if it cannot be read, or is short enough to guess."""
    create = f"create one: openssl rand -hex 32 > {file}"
    try:
        token = read_regular(file, _MOST_TOKEN_BYTES).decode("utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not text"
        raise ConfigurationError(f"--token-file {file} cannot be read: {reason}; {create}") from error
    if len(token) < LEAST_TOKEN:
        raise ConfigurationError(f"--token-file {file} has fewer than {LEAST_TOKEN} characters; {create}")
    return token


class Key:
    """A token, and the cookie that stands for it in a browser."""

    def __init__(self, token: str) -> None:
        self._token = token.encode()
        self._cookie = hmac.new(self._token, b"autoexpose page", hashlib.sha256).hexdigest()

    def fits(self, token: str) -> bool:
        """Whether this is the token, compared in constant time."""
        return hmac.compare_digest(token.encode(), self._token)

    def opens(self, connection: HTTPConnection) -> bool:
        """Whether a request carries the token or its cookie."""
        scheme, _, token = connection.headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer" and self.fits(token.strip()):
            return True
        return hmac.compare_digest(connection.cookies.get(COOKIE, "").encode(), self._cookie.encode())

    async def log_in(self, request: Request) -> Response:
        """Answer the login form, with a cookie for the right token."""
        body = await read_body(request, _LONGEST_FORM)
        (token,) = parse_qs(body.decode("utf-8", "replace")).get("token", [""])[:1]
        if not self.fits(token.strip()):
            return RedirectResponse("/login?wrong", 303)
        response = RedirectResponse("/", 303)
        secure = request.scope["scheme"] == "https"
        response.set_cookie(COOKIE, self._cookie, _COOKIE_AGE_S, httponly=True, samesite="strict", secure=secure)
        return response


class Access:
    """Passes a request on to `app`, or refuses it.

    Without a key the page answers to loopback names only. A site whose name suddenly resolves to 127.0.0.1 (DNS
    rebinding) is refused by its name; a web socket that a script of another site opens is refused by its origin.
    """

    def __init__(self, app: ASGIApp, key: Key | None) -> None:
        self._app = app
        self._key = key

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """The ASGI application."""
        if scope["type"] == "lifespan":
            return await self._app(scope, receive, send)
        answer = self.refusal(HTTPConnection(scope))

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        if answer is None:
            return await self._app(scope, receive, send_with_headers)
        if scope["type"] == "websocket":
            return await send({"type": "websocket.close", "code": 1008, "reason": "refused"})
        return await answer(scope, receive, send_with_headers)

    def refusal(self, connection: HTTPConnection) -> Response | None:
        """The answer that refuses a request; None if the request is allowed."""
        host = connection.headers.get("host", "")
        origin = connection.headers.get("origin")
        changes = connection.scope["type"] == "websocket" or connection.scope["method"] != "GET"
        if changes and origin is not None and origin.partition("://")[2] != host:
            return PlainTextResponse(f"refused: requested by a page of {origin}, another site\n", 403)
        if self._key is None:
            if not is_loopback(_name_of(host)):
                return PlainTextResponse(
                    "refused: without a token this page answers to 127.0.0.1 and localhost only\n", 403
                )
            return None
        if self._key.opens(connection) or connection.scope["path"].startswith(("/static/", "/login")):
            return None
        if "text/html" in connection.headers.get("accept", ""):
            return RedirectResponse("/login", 303)
        return PlainTextResponse("a token is needed\n", 401, {"WWW-Authenticate": "Bearer"})


def _name_of(host: str) -> str | None:
    """The name or address in a Host header; None if it is malformed or holds anything else that a URL may."""
    found = _HOST.fullmatch(host)
    return None if found is None else (found["name"] or found["address"]).lower()
