"""Opens the studio: its session, its guard, its pages, the browser.

The guard lets in the browser that was given the address, and no other page or program. The address
holds a token. It is kept as a cookie, which every further request and the websocket must have; the
names of host and origin must be those of this machine, so that no page of another site reaches the
studio through the user's browser.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
import threading
import webbrowser
from collections.abc import Callable
from contextvars import Context
from functools import partial
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from nicegui import app, run, ui
from starlette.responses import FileResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ringtrue.errors import ConfigError
from ringtrue.studio.screens import SCREENS
from ringtrue.studio.screens.verdict import PAGE as REPORT
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import page, watch
from ringtrue.studio.shown import deck_check, drawn_deck

HOST = "127.0.0.1"


def serve(
    session: StudioSession,
    *,
    port: int = 0,
    browser: bool = True,
    say: Callable[[str], None],
) -> None:
    """Serve a session until the program is ended.

    Parameters
    ----------
    session : StudioSession
    port : int
        0: any that is free.
    browser : bool
        Open the page.
    say : callable
        Is given the address when it is served.

    Raises
    ------
    ConfigError
        If the port is taken.
    """
    port = _free(port)
    token = secrets.token_urlsafe(24)
    address = f"http://{HOST}:{port}/?token={token}"
    app.add_middleware(Guard, token=token, port=port)
    watch(session)
    app.get(REPORT)(lambda: FileResponse(session.path.with_name("report.html")))
    app.on_startup(partial(_prepared, session))

    async def announce() -> None:
        await _served(port)
        say(address)
        if browser:
            threading.Thread(
                target=webbrowser.open, args=(address,), daemon=True
            ).start()

    app.on_startup(announce)
    app.on_shutdown(session.work.stop)
    # not a run that reads and then writes: the studio edits what it has read
    Context().run(
        ui.run,
        lambda: page(session),
        host=HOST,
        port=port,
        title="ringtrue studio",
        favicon=Path(__file__).with_name("favicon.svg"),
        reload=False,
        show=False,
        show_welcome_message=False,
        reconnect_timeout=30.0,
        tailwind=False,  # studio.css has the classes
        gzip_middleware_factory=None,  # nothing leaves this machine
    )


async def _prepared(session: StudioSession) -> None:
    """Read what is stored, and the deck, before a page asks for it."""
    reading = asyncio.create_task(session.refresh())
    await run.io_bound(lambda: [screen.build for screen in SCREENS])
    await reading
    deck = await drawn_deck(session)
    if deck is not None:
        await deck_check(session, deck)


async def _served(port: int) -> None:
    """Wait until the port answers."""
    while True:
        try:
            _, writer = await asyncio.open_connection(HOST, port)
        except OSError:
            await asyncio.sleep(0.05)
            continue
        writer.close()
        return


def _free(port: int) -> int:
    """The port, or any that is free for 0."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as e:
            raise ConfigError(
                f"--port {port}: {e.strerror}; name another, or none"
            ) from e
        return int(probe.getsockname()[1])


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
        headers = {
            k.decode("latin-1"): v.decode("latin-1") for k, v in scope["headers"]
        }
        asked = parse_qs(scope.get("query_string", b"").decode("latin-1")).get(
            "token", [""]
        )[0]
        fresh = secrets.compare_digest(asked.encode(), self.token.encode())
        if not self._of_here(headers) or not (fresh or self._known(headers)):
            await self._refuse(scope, send)
            return

        async def with_cookie(message: Message) -> None:
            if message["type"] == "http.response.start":
                cookie = (
                    f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
                )
                more = [
                    (b"set-cookie", cookie.encode()),
                    (b"referrer-policy", b"no-referrer"),
                ]
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
        return held is not None and secrets.compare_digest(
            held.value.encode(), self.token.encode()
        )

    async def _refuse(self, scope: Scope, send: Send) -> None:
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
            return
        kind = (b"content-type", b"text/plain; charset=utf-8")
        await send({"type": "http.response.start", "status": 403, "headers": [kind]})
        await send({"type": "http.response.body", "body": REFUSED})
