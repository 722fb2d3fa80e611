"""How the viewer and what it draws travel: its sources as one ES module, arrays as text in a page
or as a block of bytes.

`decode` and `unpack` of geometry.js read both: an array is `{"f4": base64}` in the text, and
`{"f4": [offset, count]}` in the head of a block.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.errors import InputError

KINDS = {"float32": "f4", "uint32": "u4", "uint16": "u2", "int16": "i2", "uint8": "u1"}


def f4(a: Any_) -> NDArray[np.float32]:
    """Single precision, in the order of its rows."""
    return np.ascontiguousarray(a, dtype=np.float32)


def u4(a: Int) -> NDArray[np.uint32]:
    """Counts and numbers."""
    return np.ascontiguousarray(a, dtype=np.uint32)


def u2(a: Int) -> NDArray[np.uint16]:
    """Counts below 65,536."""
    return np.ascontiguousarray(a, dtype=np.uint16)


def shape_arrays(real: Float, imag: Float | None = None) -> dict[str, Any]:
    """A shape (node, 3) as 16-bit parts of its largest component; 0 where it is not known.

    Returns
    -------
    dict
        `peak`, the largest component; `real` and `imag` (node, 3) int16, `imag` only where given.
    """
    parts = {"real": np.nan_to_num(real)}
    if imag is not None:
        parts["imag"] = np.nan_to_num(imag)
    peak = max(float(np.abs(a).max(initial=0.0)) for a in parts.values()) or 1.0
    whole = {name: np.round(a * (32767 / peak)).astype(np.int16) for name, a in parts.items()}
    return {"peak": peak, **whole}


def to_json(payload: Any) -> str:
    """The structure as JSON, its arrays as base64.

    >>> to_json({"a": np.array([1, 2], dtype=np.uint16), "b": [1.5]})
    '{"a":{"u2":"AQACAA=="},"b":[1.5]}'
    """
    written = _mapped(payload, lambda a: base64.b64encode(a.tobytes()).decode("ascii"))
    return json.dumps(written, separators=(",", ":"), allow_nan=False)


def to_block(payload: Any) -> bytes:
    """The structure as a block of bytes: the length of its head (uint32, little endian), the head
    as JSON, then the arrays.
    """
    pieces: list[bytes] = []
    size = 0

    def place(a: Any_) -> list[int]:
        nonlocal size
        at = size
        raw = a.tobytes()
        raw += bytes(-len(raw) % 4)  # an array of the viewer begins at a multiple of its kind
        pieces.append(raw)
        size += len(raw)
        return [at, a.size]

    head = json.dumps(_mapped(payload, place), separators=(",", ":"), allow_nan=False).encode()
    return b"".join([len(head).to_bytes(4, "little"), head, *pieces])


def _mapped(value: Any, write: Callable[[Any_], Any]) -> Any:
    """The structure with each array as what `write` makes of it, under its kind."""
    if isinstance(value, np.ndarray):
        if value.dtype.name not in KINDS:
            raise InputError(f"array of {value.dtype.name}: the viewer reads {', '.join(KINDS)}")
        little = value.astype(value.dtype.newbyteorder("<"), copy=False)
        return {KINDS[value.dtype.name]: write(np.ascontiguousarray(little))}
    if isinstance(value, Mapping):
        return {name: _mapped(v, write) for name, v in value.items()}
    if isinstance(value, list | tuple):
        return [_mapped(v, write) for v in value]
    return value


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
