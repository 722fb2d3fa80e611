"""The 3D viewer in a notebook: a widget whose data is what the view draws."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import chromium
import pytest

import ringtrue as rt
from ringtrue.viewer.scene import script_json

pytest.importorskip("anywidget", reason="the extra `notebook` is not installed")
WIDGET = "application/vnd.jupyter.widget-view+json"


def test_a_cell_that_ends_with_a_plot_shows_the_viewer(tmp_path: Path) -> None:
    """Run by a kernel, as Jupyter does: the output of the cell is the widget, and its state has the
    module and the block of bytes; a mode pair is shown likewise.
    """
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip(
        "nbclient", reason="the extra `test` is not installed"
    )
    cells = [
        "import ringtrue as rt\nfe = rt.solve_modes(rt.read_deck(rt.example_deck()), band=(0, 100))\nfe.plot()",
        "names = ['2+X', '3+X']\ntest = rt.modes_of_test([2.2, 6.4], fe.at(names).shapes[:, :2], names)\n"
        "rt.correlate(test, fe).plot(shapes=True)",
    ]
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(c) for c in cells])
    client = nbclient.NotebookClient(
        book, kernel_name="python3", store_widget_state=True
    )
    done = client.execute()
    outputs = [cell.outputs[-1]["data"] for cell in done.cells]
    assert all(WIDGET in data and len(data["text/html"]) < 100 for data in outputs)
    states = done.metadata["widgets"]["application/vnd.jupyter.widget-state+json"][
        "state"
    ]
    for data, modes in zip(outputs, (3, 2), strict=True):
        held = states[data[WIDGET]["model_id"]]
        (block,) = [b for b in held["buffers"] if b["path"] == ["drawn"]]
        raw = base64.b64decode(block["data"])
        head = json.loads(raw[4 : 4 + int.from_bytes(raw[:4], "little")])
        assert len(head["modes"]) == modes
        assert "export default { render }" in held["state"]["_esm"]


@pytest.mark.skipif(
    chromium.find() is None, reason="no Chromium: the widget is NOT tested"
)
def test_the_widget_is_drawn_and_follows_its_state(tmp_path: Path) -> None:
    """Its module in a browser, with a model as anywidget gives it."""
    fe = rt.solve_modes(rt.read_deck(rt.example_deck(), units="SI"), band=(0, 100))
    widget = fe.plot().widget()
    page_text = f"""<!doctype html><style>{widget._css}</style><div id="cell"></div>
      <script type="module">
      const bytes = Uint8Array.from(atob("{base64.b64encode(widget.drawn).decode()}"), (c) => c.charCodeAt(0));
      const values = {{ drawn: new DataView(bytes.buffer), height: 300, state: {{}}, picked: null, boxed: null }}, heard = {{}};
      window.model = {{ get: (k) => values[k], set: (k, v) => {{ values[k] = v; }}, save_changes: () => {{ window.saved = values.picked; }},
        on: (name, f) => {{ heard[name] = f; }}, change: (state) => {{ values.state = state; heard["change:state"](); }} }};
      const source = URL.createObjectURL(new Blob([{script_json(json.dumps(widget._esm))}], {{ type: "text/javascript" }}));
      const {{ default: widget }} = await import(source);
      window.end = widget.render({{ model, el: document.getElementById("cell") }});
      </script>"""
    path = tmp_path / "cell.html"
    path.write_text(page_text)
    image = "document.querySelector('.stage canvas').toDataURL().slice(-4000)"
    with chromium.page(tmp_path / "profile") as page:
        page.call("Page.navigate", url=path.as_uri())
        assert page.until(
            "window.end !== undefined && document.querySelector('.stage canvas').width > 0",
            30,
        )
        assert (
            page.evaluate("document.querySelectorAll('select')[1].options[0].text")
            == "mode 1: 2.24 Hz"
        )
        page.evaluate("document.querySelector('.bar button:nth-of-type(3)').click()")
        first = page.evaluate(image)
        page.evaluate("model.change({camera: {az: 0.2}, theme: 'dark'})")
        assert page.until(f"({image}) !== {json.dumps(first)}", 30)
        at = page.evaluate(
            "(({left, top, width, height}) => [left + width / 2, top + height / 2])"
            "(document.querySelector('.stage canvas').getBoundingClientRect())"
        )
        for kind in ("mousePressed", "mouseReleased"):
            page.mouse(kind, at)
        assert page.until("window.saved?.kind === 'element'", 30)
        page.evaluate("end()")
        assert page.complaints() == []
