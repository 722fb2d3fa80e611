"""A first look around: a few steps, each pointing at a part of the page; shown once on the worked
example, closed at any time.
"""

from __future__ import annotations

from nicegui import ui

from ringtrue.studio.screens import SCREENS
from ringtrue.studio.session import StudioSession

SEEN = "ringtrue-tour-seen"  # in the storage of the browser
STEPS = (  # what is pointed at: the mark of an element; screen; text
    (
        "rail",
        "model",
        "The screens follow a study from the deck to the report. The signs next to them say which "
        "stages are done, out of date or missing.",
    ),
    (
        "screen-poles",
        "poles",
        "Poles: click a pole to pick it, or select a mode and confirm, reject or merge it. Its "
        "evidence and its shape are on the right.",
    ),
    (
        "screen-correlation",
        "correlation",
        "Correlation: click a cell of the matrix to see both shapes. Lock or forbid a pair with a "
        "reason.",
    ),
    (
        "screen-update",
        "update",
        "Update: drag a factor. Frequencies, MAC, the shape, the FRF and J follow. Then press "
        "Update to run the updating.",
    ),
    (
        "history",
        "",
        "Each click changes a few lines of study.toml, choice.toml or the sensor sheet. Here they "
        "are listed; Ctrl-Z takes the last one back.",
    ),
    (
        "run",
        "",
        "This runs all stages that are missing or out of date. The button next to it copies the "
        "command that does the same.",
    ),
)
PLACED = """(() => {
  const card = document.querySelector('.rt-tour'), at = document.querySelector('.rt-tour-%s');
  document.querySelectorAll('.rt-pointed').forEach((e) => e.classList.remove('rt-pointed'));
  if (!card || !at) return;
  at.classList.add('rt-pointed');
  const box = at.getBoundingClientRect(), own = card.getBoundingClientRect();
  const wide = window.innerWidth - own.width - 12, high = window.innerHeight - own.height - 12;
  card.style.left = Math.max(12, Math.min(box.right + 14, wide)) + 'px';
  card.style.top = Math.max(56, Math.min(box.top < 56 ? box.bottom + 14 : box.top, high)) + 'px';
})()"""
CLEARED = """
document.querySelectorAll('.rt-pointed').forEach((e) => e.classList.remove('rt-pointed'));
localStorage.setItem('%s', 'yes');"""


class Tour:
    """The tour of one page.

    Parameters
    ----------
    session : StudioSession
    """

    def __init__(self, session: StudioSession) -> None:
        self.session = session
        self.at = 0
        with ui.card().classes("rt-tour w-80 gap-2").mark("tour") as self.card:
            self.text = ui.label().classes("text-sm")
            with ui.row().classes("w-full items-center no-wrap gap-1"):
                self.count = ui.label().classes("text-xs opacity-70")
                ui.space()
                ui.button("Close", on_click=self.close).props(
                    "flat dense no-caps"
                ).classes("rt-tour-close").mark("tour-close")
                self.forward = (
                    ui.button("Next", on_click=self.next)
                    .props("dense no-caps unelevated")
                    .mark("tour-next")
                )
        self.card.set_visibility(False)

    def begin(self) -> None:
        """Show the first step."""
        self.at = 0
        self.card.set_visibility(True)
        self._show()

    def next(self) -> None:
        """Show the next step; close after the last one."""
        self.at += 1
        if self.at == len(STEPS):
            self.close()
        else:
            self._show()

    def close(self) -> None:
        """Close it; this browser does not begin it by itself again."""
        self.card.set_visibility(False)
        ui.run_javascript(CLEARED % SEEN)

    async def first_time(self) -> None:
        """Begin where the worked example is open in a browser that has not seen the tour."""
        if not self.session.example:
            return
        await ui.context.client.connected()
        if (
            await ui.run_javascript(f"localStorage.getItem('{SEEN}')", timeout=10.0)
            is None
        ):
            self.begin()

    def _show(self) -> None:
        mark, screen, text = STEPS[self.at]
        if screen in {s.name for s in SCREENS}:
            ui.navigate.to(f"/{screen}")
        self.text.text = text
        self.count.text = f"{self.at + 1} of {len(STEPS)}"
        self.forward.text = "Done" if self.at + 1 == len(STEPS) else "Next"
        ui.timer(0.2, lambda: ui.run_javascript(PLACED % mark), once=True)
