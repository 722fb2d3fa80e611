"""The 3D viewer in a browser: what is picked, boxed, hidden, cut off and moved is what stands there.

A plate of 4 by 2 square shells in the plane z = 0, one metre each, in two properties, a bar
at its end and a spring to the ground below; the camera looks along -z, so that places on the screen
are those of the plate.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import chromium
import numpy as np
import pytest

from ringtrue.core.testmodel import TestModel
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.study.scene import make_scene
from ringtrue.viewer.scene import (
    asset,
    model_arrays,
    sensor_arrays,
    shape_arrays,
    to_json,
    viewer_module,
)

pytestmark = pytest.mark.skipif(
    chromium.find() is None,
    reason="no Chromium on this machine: the 3D viewer is NOT tested",
)
TOP = {"az": -np.pi / 2, "el": np.pi / 2}


def plate(folder: Path) -> dict[str, Any]:
    """The scene of the plate, elements 11 to 14 and 21 to 24, with a sensor on node 1 and one on
    node 15.
    """
    nodes = [f"GRID,{1 + i + 5 * j},,{i}.,{j}.,0." for j in range(3) for i in range(5)]
    shells = [
        f"CQUAD4,{11 + i + 10 * j},{1 + j},{a},{a + 1},{a + 6},{a + 5}"
        for j in range(2)
        for i in range(4)
        for a in (1 + i + 5 * j,)
    ]
    rest = ["GRID,90,,4.,1.6,1.", "CBAR,31,3,15,90,1.,0.,0.", "CELAS2,32,1.+6,1,3"]
    cards = [
        "PSHELL,1,7,.01",
        "PSHELL,2,8,.01",
        "PBAR,3,7,1.-3,1.-6,1.-6",
        "MAT1,7,2.+11,,.3",
    ]
    deck = folder / "plate.bdf"
    deck.write_text(
        "\n".join(["BEGIN BULK", *nodes, *shells, *rest, *cards, "MAT1,8,7.+10,,.3"])
    )
    model = read_deck(deck)
    at = np.array([1, 15])
    test = TestModel(
        points=at,
        xyz=np.array([[0.0, 0.0, 0.0], [4.0, 2.0, 0.0]]),
        channels=("1+Z", "15+X"),
        at=at,
        axes=np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
        lines=np.zeros((0, 2), np.int64),
    )
    scene = make_scene(model, {})
    return {
        "model": model_arrays(scene, model),
        "sensors": sensor_arrays(test, {}, ["#d55e00"]),
    }


PAGE = """<!doctype html><style>body {{ margin: 0; }} .view {{ width: 600px; --h: 400px; border: 0 !important; }}
{style}</style><div id="a"></div><div id="b"></div><script type="module">{module}
window.scene = {scene}; window.heard = [];
window.clock = new Clock();
const chosen = {{ clock, drag: true, pick: ["element", "sensor", "node"], wheel: "always" }};
window.view = mount(document.getElementById("a"), scene, chosen);
window.other = mount(document.getElementById("b"), scene, {{ clock }});
for (const name of ["pick", "menu", "box", "drag", "camera"]) view.on(name, (e) => heard.push([name, e]));
view.show({{ camera: {top} }});
</script>"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[chromium.Page]:
    folder = tmp_path_factory.mktemp("viewer")
    text = PAGE.format(
        style=asset("viewer.css"),
        module=viewer_module(),
        scene=to_json(plate(folder)),
        top=json.dumps(TOP),
    )
    (folder / "p.html").write_text(text)
    with chromium.page(folder / "profile") as page:
        page.call("Page.navigate", url=(folder / "p.html").as_uri())
        assert page.until("window.view?.drawn !== undefined", 20)
        yield page
        assert page.complaints() == []


def where(page: chromium.Page, x: float, y: float) -> tuple[float, float]:
    """A place of the plate on the screen."""
    script = """(() => { const { matrix: M } = view.scene(600, 400, 1, 0);
      const p = [0, 1].map((c) => M[c] * %f + M[4 + c] * %f + M[12 + c]);
      return [(p[0] + 1) * 300, (1 - p[1]) * 200]; })()"""
    at = page.evaluate(script % (x, y))
    return at[0], at[1]


def drawn(
    page: chromium.Page, start: tuple[float, float], end: tuple[float, float], keys: int
) -> Any:
    """What the view says of a drag from one place of the plate to another, with keys held."""
    a, b = where(page, *start), where(page, *end)
    page.evaluate("heard.length = 0")
    page.mouse("mousePressed", a, keys)
    for s in (0.5, 1.0):
        page.mouse(
            "mouseMoved", (a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])), keys
        )
    page.mouse("mouseReleased", b, keys)
    return page.evaluate("heard.at(-1)")


def clicked(page: chromium.Page, x: float, y: float) -> Any:
    """What is picked at a place of the plate."""
    page.evaluate("heard.length = 0")
    page.mouse("mousePressed", where(page, x, y))
    page.mouse("mouseReleased", where(page, x, y))
    ((name, found),) = page.evaluate("heard")
    assert name == "pick"
    return found


def test_a_click_picks_what_stands_there(page: chromium.Page) -> None:
    shell = clicked(page, 2.5, 1.5)
    assert (shell["kind"], shell["id"], shell["group"]) == ("element", 23, "property 2")
    assert (shell["property"], shell["material"]) == (2, 8)
    node = clicked(page, 3.03, 1.02)
    assert (node["kind"], node["id"]) == ("node", 9)
    assert clicked(page, 4.1, 2.0)["id"] == "15+X"
    assert clicked(page, 2.0, 2.4) is None


def test_a_rectangle_has_what_is_seen_inside(page: chromium.Page) -> None:
    name, found = drawn(page, (0.9, 0.4), (2.2, 2.3), keys=2)  # with Ctrl
    assert name == "box"
    assert sorted(found["element"]) == [11, 12, 13, 21, 22, 23]
    assert sorted(found["node"]) == [7, 8, 12, 13]
    assert found["sensor"] == []
    page.evaluate("view.show({hide: {element: [12], property: [2]}})")
    _, found = drawn(page, (-0.4, -0.4), (4.3, 2.4), keys=2)
    assert sorted(found["element"]) == [11, 13, 14, 31, 32]
    assert sorted(found["sensor"]) == ["1+Z", "15+X"]
    page.evaluate("view.show({hide: null})")


@pytest.mark.parametrize(
    "what", ["{element: [22]}", "{material: [8]}", "{group: ['property 2']}"]
)
def test_the_rest_of_what_is_isolated_is_not_there(
    page: chromium.Page, what: str
) -> None:
    page.evaluate(f"view.show({{isolate: {what}}})")
    assert clicked(page, 1.5, 1.5)["id"] == 22
    assert clicked(page, 1.5, 0.5) is None
    page.evaluate("view.show({isolate: null})")
    assert clicked(page, 1.5, 0.5)["id"] == 12


def test_a_plane_cuts_off_what_lies_beyond(page: chromium.Page) -> None:
    page.evaluate("view.show({clip: {normal: [1, 0, 0], offset: 1.4}})")
    assert clicked(page, 1.3, 0.5)["id"] == 12
    assert clicked(page, 1.7, 0.5) is None
    page.evaluate("view.show({clip: null})")


def test_a_sensor_is_moved_to_the_node_where_it_is_dropped(page: chromium.Page) -> None:
    name, moved = drawn(page, (4.1, 2.0), (2.1, 1.05), keys=0)
    assert name == "drag"
    assert moved == {"kind": "sensor", "id": "15+X", "node": 8, "point": [2, 1, 0]}
    assert clicked(page, 2.12, 1.0)["id"] == "15+X"


def test_views_move_on_one_clock_and_are_coloured_by_fields(
    page: chromium.Page,
) -> None:
    """Both views at the largest deflection of a shape that lifts one edge; then a field."""
    # the bar's upper end
    shape = shape_arrays(np.outer(np.arange(16) == 15, [0.0, 0.0, 2.0]))
    image = "[view, other].map((v) => v.canvas.toDataURL())"
    page.evaluate(
        f"for (const v of [view, other]) {{ v.shapes('1', {to_json(shape)}); }}; 0"
    )
    page.evaluate(
        "for (const v of [view, other]) v.show({mode: '1', camera: {az: -1, el: 0.4}}); 0"
    )
    still = page.evaluate(
        f"new Promise((done) => setTimeout(() => done({image}), 300))"
    )
    page.evaluate("clock.play()")
    assert page.until(f"{image}.every((v, k) => v !== {json.dumps(still)}[k])")
    page.evaluate("clock.set(Math.PI)")
    assert page.evaluate("[view, other].map((v) => v.clock.phase)") == [np.pi, np.pi]
    values = {"of": "element", "ids": [11, 24], "values": [1, 3], "unit": "Hz"}
    page.evaluate(f"view.field('f', {json.dumps(values)}); view.show({{field: 'f'}})")
    assert page.evaluate("view.scale.innerText.split('\\n')") == ["f, Hz", "1", "3"]
    page.evaluate(
        "view.show({labels: {node: [90], sensor: ['1+Z']}, field: null, theme: 'dark'})"
    )
    assert page.evaluate("[...view.marks.children].map((e) => e.textContent)") == [
        "90",
        "1+Z",
    ]
    png = page.evaluate("view.snapshot().then((b) => b.type)")
    page.evaluate("other.destroy()")
    assert (png, page.evaluate("document.getElementById('b').children.length")) == (
        "image/png",
        0,
    )


def test_without_webgl_the_view_says_what_it_needs(page: chromium.Page) -> None:
    page.call(
        "Page.addScriptToEvaluateOnNewDocument",
        source="HTMLCanvasElement.prototype.getContext = () => null;",
    )
    page.call("Page.reload")
    said = "document.querySelector('.info')?.textContent ?? ''"
    assert page.until(f"({said}).includes('WebGL 2')", 20)
    page.evaluate("view.show({isolate: {element: [11]}, clip: null}); view.fly(); 0")
