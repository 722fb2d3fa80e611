"""A 3D view: what the viewer draws, as a page of its own or in a notebook."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ringtrue.errors import UnsupportedError
from ringtrue.io.files import atomic_write
from ringtrue.viewer.encoding import asset, script_json, to_json, viewer_script

HEIGHT = 480  # of the drawing on a page of its own, pixels


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One 3D figure.

    A notebook shows it; `write_html` makes a page that opens offline.

    Attributes
    ----------
    payload : dict
        What `figure` of figure.js draws: text, numbers and arrays.
    """

    payload: dict[str, Any]

    def write_html(self, path: str | Path) -> Path:
        """Write the view as a page of its own.

        Raises
        ------
        DataError
            If the file cannot be written.
        """
        target = Path(path)
        with atomic_write(target) as part:
            part.write_text(self._page(), encoding="utf-8")
        return target

    def widget(self) -> Any:
        """The view as a widget of a notebook: `state` changes what is shown, `picked` has what was
        clicked on.

        Raises
        ------
        UnsupportedError
            If anywidget is not installed.
        """
        if find_spec("anywidget") is None:
            raise UnsupportedError("a widget needs anywidget: pip install 'ringtrue[notebook]'")
        from ringtrue.viewer.widget import ViewerWidget  # anywidget is an extra

        return ViewerWidget(self.payload, HEIGHT)

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, Any]:
        """The widget where anywidget is installed, without the page, which holds the same again."""
        if find_spec("anywidget") is None:
            return {}
        bundle, _ = self.widget()._repr_mimebundle_(include=include, exclude=exclude)
        return {**bundle, "text/html": "<i>3D view: run this cell to see it.</i>"}

    def _repr_html_(self) -> str:
        # 130: of the bar above and the legend below it, pixels
        frame = f'width="100%" height="{HEIGHT + 130}" style="border:0"'
        return f'<iframe srcdoc="{escape(self._page())}" {frame}></iframe>'

    def _page(self) -> str:
        parts = {
            "@HEIGHT@": str(HEIGHT),
            "@STYLE@": asset("viewer.css"),
            "@SCRIPT@": viewer_script(),
            "@DATA@": script_json(to_json(self.payload)),
        }
        page = asset("view.html")
        for place, text in parts.items():
            page = page.replace(place, text)
        return page
