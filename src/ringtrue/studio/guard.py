"""Who may talk to the studio: the browser that was given its address, and no other page or program.

The address holds a token. It is kept as a cookie, which every further request and the websocket
must have; the names of host and origin must be those of this machine, so that no page of
another site reaches the studio through the user's browser.
"""

from __future__ import annotations

import secrets
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from starlette.types import ASGIApp, Message, Receive, Scope, Send

HOSTS = ("127.0.0.1", "localhost")
REFUSED = b"ringtrue studio: open the address that it printed; it holds the token that is needed\n"


class Guard:
    """Refuses what has no token, or comes from another host or origin.

    Parameters
    ----------
    app : ASGI application
    token : str
    port : int
    """

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self.app = app
        self.token = token
        self.cookie = f"ringtrue-studio-{port}"
        self.hosts = {f"{host}:{port}" for host in HOSTS}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {k.decode("latin-1"): v.decode("latin-1") for k, v in scope["headers"]}
        asked = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        fresh = secrets.compare_digest(asked.encode(), self.token.encode())
        if not self._of_here(headers) or not (fresh or self._known(headers)):
            await self._refuse(scope, send)
            return

        async def with_cookie(message: Message) -> None:
            if message["type"] == "http.response.start":
                cookie = f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
                more = [(b"set-cookie", cookie.encode()), (b"referrer-policy", b"no-referrer")]
                message = {**message, "headers": [*message.get("headers", []), *more]}
            await send(message)

        http = fresh and scope["type"] == "http"
        await self.app(scope, receive, with_cookie if http else send)

    def _of_here(self, headers: dict[str, str]) -> bool:
        """Whether host and origin, where one is named, are this studio."""
        origin = headers.get("origin")
        own = origin is None or urlsplit(origin).netloc in self.hosts
        return headers.get("host") in self.hosts and own

    def _known(self, headers: dict[str, str]) -> bool:
        """Whether the cookie holds the token."""
        try:
            held = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            return False
        return held is not None and secrets.compare_digest(held.value.encode(), self.token.encode())

    async def _refuse(self, scope: Scope, send: Send) -> None:
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
            return
        kind = (b"content-type", b"text/plain; charset=utf-8")
        await send({"type": "http.response.start", "status": 403, "headers": [kind]})
        await send({"type": "http.response.body", "body": REFUSED})
