"""The screen of correlation."""

from __future__ import annotations

from nicegui import ui

from ringtrue.studio.session import StudioSession


def build(session: StudioSession) -> None:
    """Fill the page."""
    ui.label("correlation")
