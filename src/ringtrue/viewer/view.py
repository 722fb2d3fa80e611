"""A 3D view: the data that the viewer draws, as a page of its own or in a notebook."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from ringtrue.io.files import atomic_write

HEIGHT = 480  # of the drawing on a page of its own, pixels
# "<" could end the element or begin a comment; the two separators end a line in older scripts. JSON
# has all of them in its strings alone, where their escapes are the same text.
_ESCAPES = str.maketrans({"<": "\\u003c", "\u2028": "\\u2028", "\u2029": "\\u2029"})


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One 3D figure.

    A notebook shows it; `write_html` makes a page that opens offline.

    Attributes
    ----------
    payload : dict
        What `viewer.js` draws, ready for JSON.
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

    def _repr_html_(self) -> str:
        # 130: of the bar above and the legend below it, pixels
        frame = f'width="100%" height="{HEIGHT + 130}" style="border:0"'
        return f'<iframe srcdoc="{escape(self._page())}" {frame}></iframe>'

    def _page(self) -> str:
        data = json.dumps(self.payload, separators=(",", ":"), allow_nan=False)
        parts = {
            "@HEIGHT@": str(HEIGHT),
            "@STYLE@": asset("viewer.css"),
            "@SCRIPT@": asset("viewer.js"),
            "@DATA@": script_json(data),
        }
        page = asset("view.html")
        for place, text in parts.items():
            page = page.replace(place, text)
        return page


def script_json(text: str) -> str:
    r"""The same JSON without what HTML reads.

    >>> script_json('["<!--", "</script>"]')
    '["\\u003c!--", "\\u003c/script>"]'
    """
    return text.translate(_ESCAPES)


@cache
def asset(name: str) -> str:
    """The text of a file of the viewer."""
    return (files("ringtrue.viewer") / name).read_text(encoding="utf-8")
