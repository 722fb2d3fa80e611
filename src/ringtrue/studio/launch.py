"""Opens the studio: its session, its guard, its pages, the browser."""

from __future__ import annotations

import asyncio
import secrets
import socket
import threading
import webbrowser
from collections.abc import Callable
from contextvars import Context
from functools import partial
from pathlib import Path

from nicegui import app, run, ui
from starlette.responses import FileResponse

from ringtrue.errors import ConfigError
from ringtrue.studio.decks import deck_check, drawn_deck
from ringtrue.studio.guard import Guard
from ringtrue.studio.screens import SCREENS
from ringtrue.studio.screens.verdict import PAGE as REPORT
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import page, watch

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
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

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
            raise ConfigError(f"--port {port}: {e.strerror}; name another, or none") from e
        return int(probe.getsockname()[1])
