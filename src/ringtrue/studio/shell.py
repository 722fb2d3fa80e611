"""The frame around the screens: stages on the left, work in the middle, inspector on the right."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote, unquote
from weakref import WeakKeyDictionary
from zlib import crc32

from nicegui import Client, Event, app, ui
from nicegui.events import GenericEventArguments, KeyEventArguments

# a page names its modules when it is loaded, also where its first screen has no 3D view
import ringtrue.studio.viewer_element  # noqa: F401
from ringtrue.errors import RingtrueError
from ringtrue.studio import theme
from ringtrue.studio.screens import BEGIN, SCREENS, Screen
from ringtrue.studio.session import StudioSession
from ringtrue.studio.tour import Tour

log = logging.getLogger(__name__)
LOOK_S = 1.0  # between two looks at the files

KEYS = {  # key of the keyboard -> what a screen can do
    "ArrowRight": "next",
    "n": "next",
    "ArrowLeft": "previous",
    "p": "previous",
    "a": "accept",
    "Enter": "accept",
    "r": "reject",
    "Delete": "reject",
    " ": "play",
}
KEY_WORDS = (
    "n or →: next; p or ←: previous; a or Enter: accept; r or Delete: reject; blank: play; "
    "Ctrl-Z: undo; Ctrl-Y: redo"
)
HERE = """document.querySelectorAll('.rt-screen').forEach(
  (e) => e.classList.toggle('rt-here', e.dataset.screen === '%s'))"""
STANDING = {  # of a stage: icon and colour
    "done": ("check_circle", "positive"),
    "stale": ("update", "warning"),
    "missing": ("radio_button_unchecked", "grey"),
    "problem": ("error", "negative"),
}


@dataclass(eq=False)
class Frame:
    """What a screen fills besides the middle of the page.

    Attributes
    ----------
    inspector : element
        The column on the right; cleared when the screen changes.
    pages : element
        What holds the screen; None while the first one is built.
    screen : str
        The one that is shown.
    keys : dict
        What `next`, `previous`, `accept`, `reject` and `play` do.
    """

    inspector: ui.column
    pages: ui.sub_pages | None = None
    screen: str = ""
    keys: dict[str, Callable[[], object]] = field(default_factory=dict)
    _followed: list[tuple[Event[Any], Callable[..., object]]] = field(
        default_factory=list
    )

    def follow(self, callback: Callable[..., object], *events: Event[Any]) -> None:
        """Call a function when one of some events happens, as long as the screen is shown."""
        for event in events:
            event.subscribe(callback)
            self._followed.append((event, callback))

    def rebuild(self) -> None:
        """Build the screen anew."""
        if self.pages is not None:
            self.pages.refresh()

    def reset(self) -> None:
        """Empty, for another screen."""
        for event, callback in self._followed:
            event.unsubscribe(callback)
        self._followed.clear()
        self.inspector.clear()
        self.keys.clear()


# plotly gives up a zoom that changes nothing by a promise that is rejected without a reason
QUIET = (
    "addEventListener('unhandledrejection', (e) => e.reason === undefined "
    "&& e.preventDefault())"
)
_FRAMES: WeakKeyDictionary[Client, Frame] = WeakKeyDictionary()


def frame() -> Frame:
    """The frame of the page that is being built or clicked."""
    return _FRAMES[ui.context.client]


@contextmanager
def inspector() -> Iterator[None]:
    """Fill the inspector anew."""
    column = frame().inspector
    column.clear()
    with column:
        yield


def heading(text: str) -> None:
    """The head of a part of a screen."""
    ui.label(text).classes("rt-head mt-2")


def fact(name: str, value: str = "") -> ui.label:
    """A name and its value on a line; gives the value, to be changed."""
    with ui.row().classes("w-full items-baseline justify-between no-wrap gap-3"):
        ui.label(name).classes("text-sm opacity-70")
        return ui.label(value).classes("text-sm rt-value text-right")


def table(names: Mapping[str, str], rows: list[dict[str, object]]) -> ui.table:
    """A table; `names` has the label of each column, a row needs an `id`."""
    columns = [
        {"name": key, "label": label, "field": key, "align": "left"}
        for key, label in names.items()
    ]
    return (
        ui.table(rows=rows, columns=columns, row_key="id")
        .props("dense flat hide-bottom :rows-per-page-options=[0]")
        .classes("w-full")
    )


# Plotly looks 20 times a second for what is under the pointer, and a quick click would mean what
# was there before: what is there is asked for after its next look.
UNDER = """() => setTimeout(() => {
  const point = getHtmlElement(@PLOT@)._hoverdata?.[0];
  if (point) emit({ x: point.x, y: point.y, customdata: point.customdata });
}, 60)"""


def on_click(
    plot: ui.plotly, clicked: Callable[[GenericEventArguments], None]
) -> ui.plotly:
    """Say which point of a plot was clicked: `args` of the event have its x, y and customdata."""
    script = UNDER.replace("@PLOT@", str(plot.id))
    return plot.on("plotly_click", clicked, js_handler=script)


SELECT = "dense options-dense outlined"  # how a list to choose from looks


def output_select(
    session: StudioSession, outputs: Sequence[str], value: str
) -> ui.select:
    """The output of an FRF; all screens follow."""
    return (
        ui.select(
            list(outputs),
            value=value,
            label="output",
            with_input=True,
            on_change=lambda e: session.select(channel=e.value or ""),
        )
        .props(SELECT)
        .classes("w-36")
    )


def channels_select(
    label: str,
    ids: Sequence[str],
    value: Sequence[str],
    changed: Callable[..., object],
    most: int,
) -> ui.select:
    """Several channels, at most so many."""
    return ui.select(
        list(ids), value=list(value), multiple=True, label=label, on_change=changed
    ).props(f"{SELECT} use-chips max-values={most}")


def nothing_yet(session: StudioSession, text: str, until: str) -> None:
    """What a screen shows in place of results that are not stored, with what makes them; the screen
    is built anew when they are there.
    """

    def stored() -> object:
        return session.stage(until) if until else session.study

    before = stored()

    def look() -> None:
        if stored() is not before:
            frame().rebuild()

    frame().follow(look, session.on_results)
    with ui.column().classes("w-full items-center q-pa-xl gap-2"):
        ui.icon("hourglass_empty").classes("text-4xl opacity-40")
        ui.label(text)
        run_button(session, until)


def run_button(session: StudioSession, until: str, text: str = "") -> None:
    """Run the study up to a stage, and the command that does."""
    with ui.row().classes("items-center no-wrap gap-1"):
        ui.button(
            text or f"Run up to {until}",
            icon="play_arrow",
            on_click=lambda: session.run_stages(until),
        ).props("dense no-caps no-wrap unelevated").mark(f"run-{until}")
        copy_command(session.work.command(until))


def ask_reason(title: str, done: Callable[[str], object]) -> None:
    """A dialog for a written reason, which is not given without one."""
    with ui.dialog() as dialog, ui.card().classes("w-96"):
        ui.label(title).classes("text-base")
        reason = ui.input("Reason").classes("w-full").props("autofocus").mark("reason")

        def accept() -> None:
            if (reason.value or "").strip():
                dialog.close()
                done(reason.value)

        reason.on("keydown.enter", accept)
        with ui.row().classes("w-full justify-end"):
            ui.button("Cancel", on_click=dialog.close).props("flat no-caps")
            ui.button("Write", on_click=accept).props("no-caps unelevated").mark(
                "write"
            )
    dialog.open()


def diff_view(text: str) -> None:
    """A unified diff, added and removed lines marked."""
    with ui.column().classes("rt-mono rt-diff w-full gap-0"):
        for line in text.splitlines():
            kind = {"+": "rt-add", "-": "rt-del"}.get(line[:1], "")
            head = line.startswith(("+++", "---", "@@"))
            ui.label(line or " ").classes("opacity-60" if head else kind).classes(
                "w-full"
            )


def copy_command(command: str) -> None:
    """Copy the command that does the same without the studio."""
    ui.button(icon="content_copy", on_click=lambda: _copy(command)).props(
        "flat dense round size=sm"
    ).tooltip(f"Copy as command: {command}").mark("copy-command")


def _copy(text: str) -> None:
    # a page without the focus may not write; no exception of the page then
    ui.run_javascript(
        f"navigator.clipboard?.writeText({json.dumps(text)}).catch(console.info)"
    )
    ui.notify(f"copied: {text}", timeout=2000)


def watch(session: StudioSession) -> None:
    """See what changes outside, and say what goes wrong, as long as the program runs."""
    app.on_exception(_say_exception)
    app.timer(LOOK_S, session.look)


def _say_exception(error: Exception) -> None:
    """One clear message; what no one has foreseen is logged with its traceback."""
    refused = isinstance(error, RingtrueError)
    text = str(error)
    if not refused:
        log.error("a fault of ringtrue", exc_info=error)
        text = f"This is a fault of ringtrue: {type(error).__name__}: {error}"
    try:
        ui.notify(
            text,
            type="warning" if refused else "negative",
            multi_line=True,
            timeout=8000,
            actions=[{"label": "Close", "color": "white"}],
        )
    except RuntimeError:  # no page is concerned
        log.warning("%s", text)


def page(session: StudioSession) -> None:
    """The page of a session, with all its screens."""
    theme.apply()
    _keep(session)
    ui.add_head_html(f"<script>{QUIET}</script>")
    asked = ui.context.client.sub_pages_router.current_path.partition("?")[0].strip("/")
    if any(s.figures for s in SCREENS if s.name == asked):
        ui.add_body_html('<script>import("nicegui-plotly")</script>')
    dark = ui.dark_mode(session.dark)
    session.on_theme.subscribe(lambda: dark.set_value(session.dark))
    session.on_documents.subscribe(lambda words: ui.notify(words, timeout=2500))
    tour = Tour(session)
    _header(session, tour)
    with (
        ui.left_drawer(value=True, bordered=True)
        .props("width=216 breakpoint=0")
        .classes("rt-rail p-2 gap-1")
    ):
        rail = ui.column().classes("rt-tour-rail w-full gap-1")
    with (
        ui.right_drawer(value=True, bordered=True)
        .props("width=320 breakpoint=0")
        .classes("p-3")
    ):
        column = ui.column().classes("w-full gap-1")
    frame_ = _FRAMES[ui.context.client] = Frame(column)
    ui.keyboard(
        on_key=lambda e: _key(session, frame_, e),
        ignore=["input", "textarea", "select"],
    )
    _rail(session, rail)

    def shown(screen: Screen) -> Callable[[], object]:
        def build() -> object:
            frame_.reset()
            frame_.screen = screen.name
            ui.run_javascript(HERE % screen.name)
            if session.config is not None:
                return screen.build(session)
            frame_.follow(frame_.rebuild, session.on_documents)
            if session.problem:
                ui.label(session.problem).classes("p-6 whitespace-pre-wrap").mark(
                    "problem"
                )
                return None
            return BEGIN.build(session)

        return build

    routes = {f"/{s.name}": shown(s) for s in SCREENS} | {"/": shown(SCREENS[0])}
    frame_.pages = ui.sub_pages(routes).classes("w-full")
    ui.timer(0.5, tour.first_time, once=True)


def _keep(session: StudioSession) -> None:
    """Theme and selection in a cookie of the browser, from where the next studio has them: the
    cookie is of this study, and, other than the browser's storage, of any port.
    """
    name = f"ringtrue-studio-{crc32(str(session.path.resolve()).encode()):08x}"
    request = ui.context.client.request
    session.restore(unquote(request.cookies.get(name, "")))

    def keep() -> None:
        ui.run_javascript(
            f"document.cookie = '{name}={quote(session.kept)}; path=/; max-age=31536000; "
            "samesite=strict'"
        )

    for event in (session.on_theme, session.on_selection):
        event.subscribe(keep, expect_args=False)


def _header(session: StudioSession, tour: Tour) -> None:
    with ui.header(bordered=True).classes(
        "items-center py-0 px-3 gap-2 h-12 bg-primary"
    ):
        ui.label("ringtrue").classes("text-base font-semibold")
        title = ui.label().classes("text-sm opacity-80 ellipsis")

        def named() -> None:
            config = session.config
            title.text = (
                config.study.title if config is not None else str(session.path.parent)
            )

        named()
        session.on_documents.subscribe(named)
        ui.space()
        bar = "flat round dense color=white"
        ui.button(icon="undo", on_click=session.undo).props(bar).tooltip(
            "Undo, Ctrl-Z"
        ).mark("undo")
        ui.button(icon="redo", on_click=session.redo).props(bar).tooltip(
            "Redo, Ctrl-Y"
        ).mark("redo")
        ui.button(icon="history", on_click=lambda: _history(session)).props(
            bar
        ).tooltip("What was changed").classes("rt-tour-history").mark("history")
        ui.button(icon="tour", on_click=tour.begin).props(bar).tooltip("Tour").mark(
            "tour-begin"
        )
        ui.button(
            icon="dark_mode", on_click=lambda: session.set_dark(not session.dark)
        ).props(bar).tooltip("Dark or light").mark("theme")
        ui.button(icon="keyboard").props(bar).tooltip(KEY_WORDS)


def _rail(session: StudioSession, rail: ui.column) -> None:
    """Screens with the state of their stages, and the run; changed in place, so that no click falls
    on what is drawn anew.
    """
    standings: dict[str, ui.row] = {}
    with rail:
        for screen in SCREENS:
            with (
                ui.item(on_click=lambda s=screen: ui.navigate.to(f"/{s.name}"))
                .classes(
                    f"rt-screen rt-tour-screen-{screen.name} w-full rounded-borders"
                )
                .props(f"dense clickable data-screen={screen.name}")
                .mark(f"screen-{screen.name}")
            ):
                with ui.item_section().props("avatar").classes("min-w-0 pr-2"):
                    ui.icon(screen.icon).classes("text-lg")
                with ui.item_section():
                    ui.item_label(screen.title)
                with ui.item_section().props("side"):
                    standings[screen.name] = ui.row().classes("gap-0 no-wrap")
        problem = ui.label().classes("text-negative text-xs q-mt-sm").mark("problem")
        ui.separator()
        run = _run_panel(session)
    drawn: dict[str, list[tuple[str, str]]] = {}

    def entries() -> None:
        for screen in SCREENS:
            stages = [s for s in session.stages if s.name in screen.stages]
            looks: list[tuple[str, str]] = [
                (
                    "problem" if s.problem else s.standing,
                    s.problem or f"{s.title}: {s.standing}",
                )
                for s in stages
            ]
            if drawn.get(screen.name) == looks:
                continue
            drawn[screen.name] = looks
            standings[screen.name].clear()
            with standings[screen.name]:
                for standing, words in looks:
                    icon, color = STANDING[standing]
                    ui.icon(icon, color=color).classes("text-sm").tooltip(words)
        problem.text = session.problem
        problem.set_visibility(bool(session.problem))
        run()

    entries()
    for event in (session.on_results, session.on_documents):
        event.subscribe(entries, expect_args=False)
    session.on_work.subscribe(run)


def _run_panel(session: StudioSession) -> Callable[[], None]:
    """The run: how far it is, what ends it, what begins it; gives what shows it as it is now."""
    heading("Run")
    bar = ui.linear_progress(show_value=False).props("instant-feedback")
    words = ui.label().classes("text-xs").mark("run-state")
    stop = ui.button("Stop", icon="stop", on_click=session.work.stop).props(
        "dense flat no-caps"
    )
    with ui.row().classes("items-center no-wrap gap-1") as idle:
        begin = ui.button(
            "Run the study", icon="play_arrow", on_click=lambda: session.run_stages()
        ).props("dense flat no-caps no-wrap")
        begin.classes("rt-tour-run").mark("run")
        copy_command(session.work.command())

    def show() -> None:
        job = session.work.job
        running = session.work.running
        bar.set_visibility(running)
        stop.set_visibility(running)
        idle.set_visibility(not running)
        begin.set_enabled(session.config is not None)
        words.set_visibility(job is not None)
        if job is None:
            return
        bar.value = job.fraction
        stop.set_enabled(job.state == "running")
        said = job.lines[-1] if job.lines else "starting"
        words.text = said if running else job.error or job.state
        words.classes(**{"add" if job.error else "remove": "text-negative"})

    show()
    return show


def _history(session: StudioSession) -> None:
    """What was changed, newest first, as diffs."""
    documents = session.documents
    with ui.dialog() as dialog, ui.card().classes("max-w-full").style("width:720px"):
        ui.label("What was changed").classes("text-lg")
        if not documents.steps:
            ui.label("Nothing yet.")
        for i, step in reversed(list(enumerate(documents.steps))[-40:]):
            undone = i >= documents.done
            with ui.expansion(step.words + (" (undone)" if undone else "")).classes(
                "w-full" + (" opacity-60" if undone else "")
            ):
                diff_view(step.diff())
    dialog.open()


def _key(session: StudioSession, frame_: Frame, event: KeyEventArguments) -> None:
    if not event.action.keydown:
        return
    name = str(event.key)
    if event.modifiers.ctrl or event.modifiers.meta:
        if name.lower() == "z":
            session.undo()
        elif name.lower() == "y":
            session.redo()
        return
    does = frame_.keys.get(KEYS.get(name, ""))
    if does is not None:
        does()
