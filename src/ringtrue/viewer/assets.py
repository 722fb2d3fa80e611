"""The files of the viewer, and its one ES module joined of its sources."""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files

SOURCES = (
    "clock",
    "geometry",
    "gpu",
    "parts",
    "picture",
    "pointer",
    "viewer",
    "figure",
)  # each after what it imports
_IMPORT = re.compile(r'^import [^\n]* from "\./[^\n]*";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export ((?:function|const|class) (\w+))", re.MULTILINE)
# "<" could end the element or begin a comment; the two separators end a line in older scripts. JSON
# has all of them in its strings alone, where their escapes are the same text.
_ESCAPES = str.maketrans({"<": "\\u003c", "\u2028": "\\u2028", "\u2029": "\\u2029"})


@cache
def asset(name: str) -> str:
    """The text of a file of the viewer."""
    return (files("ringtrue.viewer") / name).read_text(encoding="utf-8")


@cache
def viewer_module() -> str:
    """The viewer as one ES module, for notebooks and the studio."""
    text, names = _joined()
    return f"{text}\nexport {{ {', '.join(names)} }};\n"


@cache
def viewer_script() -> str:
    """The viewer as a script that defines `ringtrueViewer`, for pages that open offline."""
    text, names = _joined()
    inside = f'"use strict";\n{text}\nreturn {{ {", ".join(names)} }};'
    return f"const ringtrueViewer = (() => {{\n{inside}\n}})();\n"


def _joined() -> tuple[str, list[str]]:
    """The sources in one, and the names that they export."""
    text = "\n".join(_IMPORT.sub("", asset(f"{name}.js")) for name in SOURCES)
    return _EXPORT.sub(r"\1", text), [name for _, name in _EXPORT.findall(text)]


def script_json(text: str) -> str:
    r"""The same JSON without what HTML reads.

    >>> script_json('["<!--", "</script>"]')
    '["\\u003c!--", "\\u003c/script>"]'
    """
    return text.translate(_ESCAPES)
