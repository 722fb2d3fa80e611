"""Where no study stands yet: the files that are there, and a study.toml of some of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from nicegui import run, ui

import ringtrue as rt
from ringtrue.errors import ConfigError, RingtrueError
from ringtrue.studio import edits
from ringtrue.studio.edits import Change
from ringtrue.studio.session import StudioSession
from ringtrue.studio.shell import copy_command, fact, heading, inspector

MOST_FILES = 200  # that are looked into
ROLES = {  # of a study.toml: what inspection calls it, and what is asked for
    "deck": ("deck", "Deck"),
    "sheet": ("sensors", "Sensor sheet"),
    "log": ("log", "Log of the crew"),
    "frfs": ("FRFs", "FRFs"),
    "modes": ("modes", "Modes"),
}


def new_study(chosen: Mapping[str, str]) -> Change:
    """The text of a study of some files, by their roles.

    Raises
    ------
    ConfigError
        If there is a text already.
    """

    def change(text: str) -> str:
        if text:
            raise ConfigError("study.toml is there already")
        for role, name in chosen.items():
            section = "model" if role == "deck" else "test"
            value = [name] if role == "frfs" else name
            text = edits.put((section, role), value)(text)
        return text

    return change


def candidates(folder: Path) -> dict[str, list[str]]:
    """Files of a folder and those below it by what inspection finds in them, seen from there."""
    found: dict[str, list[str]] = {}
    files = [*folder.glob("*.*"), *folder.glob("*/*.*")]
    for path in sorted(p for p in files if p.is_file() and not p.name.startswith("."))[
        :MOST_FILES
    ]:
        try:
            parts = rt.inspect_file(path).parts
        except RingtrueError:
            continue
        for kind in {part.kind for part in parts}:
            found.setdefault(kind, []).append(path.relative_to(folder).as_posix())
    return found


async def build(session: StudioSession) -> None:
    """Fill the page."""
    with ui.column().classes("w-full max-w-2xl p-6 gap-3"):
        ui.label("A new study").classes("text-xl")
        ui.label(f"It begins as {session.path}, from files in its folder.").classes(
            "opacity-70"
        )
        spinner = ui.spinner()
        found = await run.io_bound(candidates, session.path.parent)
        if spinner.is_deleted:  # the page was left meanwhile
            return
        spinner.delete()
        chosen: dict[str, str] = {}
        for role, (kind, label) in ROLES.items():
            names = (found or {}).get(kind, [])
            given = session.source.name if session.source is not None else ""
            first = given if given in names else names[0] if len(names) == 1 else ""
            chosen[role] = first

            def choose(value: str, role: str = role) -> None:
                chosen[role] = value

            ui.select(
                {"": "none", **{n: n for n in names}},
                label=label,
                value=first,
                on_change=lambda e, c=choose: c(e.value),
            ).classes("w-full").props("dense outlined").mark(f"begin-{role}")

        def begin() -> None:
            session.edit("begun", new_study({r: n for r, n in chosen.items() if n}))

        ui.button("Begin the study", icon="add", on_click=begin).props(
            "no-caps unelevated"
        ).mark("begin")
    if session.source is not None:
        with inspector():
            _source(session.source)


def _source(path: Path) -> None:
    """What was opened, and the commands that take it as it is."""
    contents = rt.inspect_file(path)
    heading(contents.format)
    fact("File", path.name)
    for part in contents.parts:
        fact("Holds", part.kind)
        for command in part.commands:
            with ui.row().classes("w-full items-center no-wrap"):
                ui.label(command).classes("rt-mono ellipsis grow")
                copy_command(command)
