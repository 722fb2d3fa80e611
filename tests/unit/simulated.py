"""A page of the studio without a browser, and a study that takes no time."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Awaitable, Callable
from pathlib import Path

from nicegui.testing import User
from nicegui.testing.user_simulation import user_simulation

from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import page, watch

STUDY = """\
# a study
[study]
title = "Tower" # its name

[model]
deck = "tower.bdf"

[correlate] # limits
mac_gate = 0.6
"""


def written(folder: Path, text: str = STUDY) -> StudioSession:
    """The session of a study with a deck of three floors."""
    (folder / "tower.bdf").write_text(DECK)
    (folder / "study.toml").write_text(text)
    return StudioSession(folder / "study.toml")


DECK = """\
SOL 103
CEND
SPC = 1
BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,0.,0.,3.
CELAS1,11,1,1,1,2,1
PELAS,1,1000.
CONM2,22,2,,1.
SPC1,1,123456,1
SPC1,1,23456,2
ENDDATA
"""


def visit(
    session: StudioSession,
    scenario: Callable[[User], Awaitable[None]],
    address: str = "/",
) -> None:
    """Open a page of a session as a user who then does something."""

    async def run() -> None:
        async with user_simulation(root=lambda: page(session)) as user:
            watch(session)
            await session.refresh()
            client = await user.open(address)
            try:
                await scenario(user)
            finally:
                # its outbox may miss that it is cancelled (asyncio.wait_for of Python 3.11 does,
                # when something is sent at that moment), and would be waited for without end
                client.outbox.stop()

    asyncio.run(run())


def opened(ran: Path, tmp_path: Path) -> StudioSession:
    """A copy of it that a test may change."""
    folder = tmp_path / "frame"
    shutil.copytree(ran, folder)
    return StudioSession(folder / "study.toml")


def on(
    screen: str, session: StudioSession, scenario: Callable[[User], Awaitable[None]]
) -> None:
    """Open a screen as a user who then does something."""
    visit(session, scenario, f"/{screen}")
