"""What the viewer draws, and how it travels: a model, a test and sensors as arrays.

They go as text in a page or as a block of bytes; a whole view, as a page of its own or in a
notebook.

viewer.js says what each array holds. `decode` and `unpack` of geometry.js read both forms: an array
is `{"f4": base64}` in the text, and `{"f4": [offset, count]}` in the head of a block. The sources
of the viewer are joined to one ES module.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import InputError, UnsupportedError
from ringtrue.io.files import atomic_write
from ringtrue.model.model import Model
from ringtrue.study.results import Scene

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
    whole = {
        name: np.round(a * (32767 / peak)).astype(np.int16) for name, a in parts.items()
    }
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
        # an array of the viewer begins at a multiple of its kind
        raw += bytes(-len(raw) % 4)
        pieces.append(raw)
        size += len(raw)
        return [at, a.size]

    head = json.dumps(
        _mapped(payload, place), separators=(",", ":"), allow_nan=False
    ).encode()
    return b"".join([len(head).to_bytes(4, "little"), head, *pieces])


def _mapped(value: Any, write: Callable[[Any_], Any]) -> Any:
    """The structure with each array as what `write` makes of it, under its kind."""
    if isinstance(value, np.ndarray):
        if value.dtype.name not in KINDS:
            raise InputError(
                f"array of {value.dtype.name}: the viewer reads {', '.join(KINDS)}"
            )
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


def model_arrays(scene: Scene, model: Model | None = None) -> dict[str, Any]:
    """The drawing of a model.

    Parameters
    ----------
    scene : Scene
    model : Model, optional
        Gives each element its property and material numbers.

    Returns
    -------
    dict
        `points`, `node_id`, `triangles`, `lines`; `face_element`, `line_element`: the positions of
        their elements in `element_id`, `group`, `property` and `material`; `groups`: names.
    """
    of_face = scene.triangle_element
    of_line = scene.line_element
    if not of_face.size + of_line.size:  # not known: each group is one
        of_face, of_line = scene.triangle_group, scene.line_group
    every = np.concatenate([of_face, of_line])
    group = np.concatenate([scene.triangle_group, scene.line_group])
    element, first, at = np.unique(every, return_index=True, return_inverse=True)
    out = {
        "points": f4(scene.xyz),
        "node_id": u4(scene.node),
        "triangles": u4(scene.triangles),
        "face_element": u4(at[: len(of_face)]),
        "lines": u4(scene.lines),
        "line_element": u4(at[len(of_face) :]),
        "element_id": u4(element),
        "group": u2(group[first]),
        "groups": list(scene.groups),
    }
    if model is None:
        return out
    prop, material = _cards(model, element)
    return out | {"property": u4(prop), "material": u4(material)}


def _cards(model: Model, elements: Int) -> tuple[Int, Int]:
    """Property and material numbers of elements (e,); 0 where there is none, or one a ply."""
    prop = np.zeros(elements.size, dtype=np.int64)
    material = np.zeros(elements.size, dtype=np.int64)
    tables = model.tables.values()
    for table in (t for t in tables if t.card.startswith("C") and "EID" in t.columns):
        row = table.find(elements)
        for name, out in (("PID", prop), ("MID", material)):
            if name in table.columns:
                out[row >= 0] = table[name][row[row >= 0]]
    for table in (t for t in tables if t.card.startswith("P") and "PID" in t.columns):
        name = "MID1" if table.card == "PSHELL" else "MID"
        if isinstance(table.columns.get(name), np.ndarray):
            row = np.where(prop > 0, table.find(prop), -1)
            material[row >= 0] = table[name][row[row >= 0]]
    return prop, material


def test_arrays(test: TestModel) -> dict[str, Any]:
    """The measurement points of a test and the lines between them."""
    order = np.argsort(test.points)
    at: Int = np.zeros((0, 2), dtype=np.int64)
    if test.lines.size:
        at = order[np.searchsorted(test.points[order], test.lines)]
    names = [f"{p} {g}".strip() for p, g in zip(test.points, test.groups, strict=True)]
    return {"points": f4(test.xyz), "lines": u4(at), "names": names}


def sensor_arrays(
    test: TestModel,
    kinds: Mapping[str, str],
    colors: Sequence[str],
    rest: str = "sensors",
) -> dict[str, Any]:
    """The channels of a test as arrows.

    Parameters
    ----------
    test : TestModel
    kinds : mapping of str to str
        What some channels are used for.
    colors : sequence of str
        Of the kinds in their alphabetic order, over again where there are more.
    rest : str
        The kind of all other channels.
    """
    kind = [kinds.get(c, rest) for c in test.channels]
    color = {name: colors[i % len(colors)] for i, name in enumerate(sorted(set(kind)))}
    order = sorted(range(len(kind)), key=lambda k: kind[k])
    return {
        "points": f4(test.channel_xyz()[order]),
        "directions": f4(test.axes[order]),
        "names": [test.channels[k] for k in order],
        "colors": [color[kind[k]] for k in order],
        "kinds": [kind[k] for k in order],
    }


_WIDGET = """
function render({ model, el }) {
  const box = document.createElement("div");
  box.style.setProperty("--h", `${model.get("height")}px`);
  el.append(box);
  const theme = document.body.dataset.jpThemeLight === "false" ? "dark" : "light";
  const { view } = figure(box, unpack(model.get("drawn")), { theme });
  const shown = () => view.show(model.get("state"));
  const found = (key) => (value) => { model.set(key, value); model.save_changes(); };
  view.show({ theme });
  shown();
  model.on("change:state", shown);
  view.on("pick", found("picked"));
  view.on("box", found("boxed"));
  return () => view.destroy();
}
export default { render };
"""
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
            raise UnsupportedError(
                "a widget needs anywidget: pip install 'ringtrue[notebook]'"
            )
        return _widget_class()(drawn=to_block(self.payload), height=HEIGHT)

    def _repr_mimebundle_(
        self, include: Any = None, exclude: Any = None
    ) -> dict[str, Any]:
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


@cache
def _widget_class() -> Any:
    """The viewer in notebooks: an anywidget that has the viewer's one module."""
    import anywidget  # an extra
    import traitlets

    class ViewerWidget(anywidget.AnyWidget):
        """A view as a widget.

        Attributes
        ----------
        drawn : bytes
            What `figure` of figure.js draws, as a block.
        state : dict
            What is shown, in the names and values of `view.show` of viewer.js.
        picked, boxed : dict
            What was clicked on, and what was inside a rectangle drawn with Ctrl.
        height : int
            Of the drawing, pixels.
        """

        _esm: ClassVar[str] = viewer_module() + _WIDGET
        _css: ClassVar[str] = asset("viewer.css")
        drawn = traitlets.Bytes().tag(sync=True)
        state = traitlets.Dict().tag(sync=True)
        picked = traitlets.Dict(allow_none=True, default_value=None).tag(sync=True)
        boxed = traitlets.Dict(allow_none=True, default_value=None).tag(sync=True)
        height = traitlets.Int().tag(sync=True)

    return ViewerWidget
