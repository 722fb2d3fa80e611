"""Frames a second, first picture and memory of the 3D viewer in Chromium with software rendering.

    python bench/viewer.py [--quick | --full]

A square of shells in waves, its shape in motion, and a block of solids, of which the outer faces
are drawn; a computer with a graphics card draws many times more frames. It is right if what is
picked in the middle of elements, where these are in the moved state, is these elements, and the
block is drawn by its outer faces alone. The scene is made of a deck in memory. Memory is that of
all processes of the browser, less that of an empty page. Not covered: lines, test points and
sensors, which are few; other browsers.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from outcome import ROOT, Check, Report, arguments, at_least, at_most, sized

from ringtrue.decks.nastran.reader import read_deck
from ringtrue.model.model import Model
from ringtrue.study.scene import make_scene
from ringtrue.viewer.scene import (
    asset,
    model_arrays,
    shape_arrays,
    to_json,
    viewer_module,
)

sys.path.insert(0, str(ROOT / "tests" / "browser"))
import chromium

SECONDS = 6.0  # that frames are counted
PICKED = 40  # elements
PAGE = """<!doctype html><style>body { margin: 0; } .view { width: 1280px; --h: 800px; } @STYLE@</style><div id="a"></div>
<script type="application/json" id="scene">@SCENE@</script><script type="application/json" id="shape">@SHAPE@</script>
<script type="module">@MODULE@
const read = (id) => JSON.parse(document.getElementById(id).textContent), synced = (view) => view.canvas.getContext("2d").getImageData(0, 0, 1, 1);
const begin = performance.now();
window.view = mount(document.getElementById("a"), read("scene"), { wheel: "always" });
view.shapes("1", read("shape"));
view.show({ mode: "1", color: "displacement", camera: @CAMERA@ });
view.paint();
synced(view);
window.first = performance.now() - begin;
window.frames = (seconds) => new Promise((done) => {
  const paint = view.paint.bind(view);
  let count = 0;
  view.paint = (how) => { paint(how); synced(view); count++; };
  view.play();
  setTimeout(() => { view.clock.set(0); view.paint = paint; done(count / seconds); }, 1000 * seconds);
});
window.pickAt = (points) => {
  Object.assign(view.camera, { zoom: 15, at: points[points.length >> 1] });
  view.paint();
  const { matrix: M } = view.drawn, { clientWidth: w, clientHeight: h } = view.stage;
  return points.map((p) => {
    const at = [0, 1].map((c) => M[c] * p[0] + M[4 + c] * p[1] + M[8 + c] * p[2] + M[12 + c]);
    const found = view.pointer.find((at[0] + 1) / 2 * w, (1 - at[1]) / 2 * h);
    return found ? found.id : 0;
  });
};
</script>"""
TOP = {"az": -np.pi / 2, "el": np.pi / 2}


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """What a page showed.

    Attributes
    ----------
    frames : float
        A second, in motion.
    first : float, s
        From the module to the first picture.
    memory : float, MB
    wanted, picked : (n,) int64
        Elements, and what was picked in their middle.
    faces : int
        Triangles that were drawn.
    """

    frames: float
    first: float
    memory: float
    wanted: np.ndarray
    picked: np.ndarray
    faces: int


def shells(n: int) -> Model:
    """A square of n × n nodes, in waves."""
    x, y = (
        v.ravel() for v in np.meshgrid(*(2 * [np.linspace(0, 1, n)]), indexing="ij")
    )
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel() + 1
    corners = np.stack([a, a + n, a + n + 1, a + 1], axis=1)
    return deck(
        np.stack([x, y, 0.05 * np.sin(9 * x)], axis=1),
        "CQUAD4",
        corners,
        "PSHELL,1,1,.01",
    )


def solids(n: int) -> Model:
    """A cube of n × n × n nodes."""
    places = np.stack(
        np.meshgrid(*(3 * [np.linspace(0, 1, n)]), indexing="ij"), -1
    ).reshape(-1, 3)
    at = np.arange(n**3).reshape(n, n, n)[:-1, :-1, :-1].ravel() + 1
    steps = np.array([0, n * n, n * n + n, n, 1, n * n + 1, n * n + n + 1, n + 1])
    return deck(places, "CHEXA", at[:, None] + steps, "PSOLID,1,1")


def deck(
    places: np.ndarray, card: str, corners: np.ndarray, property_card: str
) -> Model:
    """The model of these nodes and elements, numbered from 1."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "d.bdf"
        with path.open("w") as out:
            out.write("BEGIN BULK\n")
            out.writelines(
                f"GRID,{k},,{x:.6f},{y:.6f},{z:.6f}\n"
                for k, (x, y, z) in enumerate(places.tolist(), 1)
            )
            for k, nodes in enumerate(corners.tolist(), 1):
                first, rest = nodes[:6], nodes[6:]
                more = "\n," + ",".join(map(str, rest)) if rest else ""
                out.write(f"{card},{k},1,{','.join(map(str, first))}{more}\n")
            out.write(f"{property_card}\nMAT1,1,2.+11,,.3,7850.\n")
        return read_deck(path)


def motion(places: np.ndarray) -> np.ndarray:
    """A shape (node, 3) that lifts one corner."""
    lift = places[:, 0] * places[:, 1]
    return np.stack([0 * lift, 0 * lift, lift], axis=1)


def shown(model: Model, folder: Path) -> tuple[Drawn, float]:
    """The model in a browser, and the seconds that its scene took."""
    begin = time.process_time()
    scene = make_scene(model, {})
    arrays = model_arrays(scene, model)
    seconds = time.process_time() - begin
    shape = motion(scene.xyz)
    parts = {
        "@STYLE@": asset("viewer.css"),
        "@MODULE@": viewer_module(),
        "@SCENE@": to_json({"model": arrays}),
        "@SHAPE@": to_json(shape_arrays(shape)),
        "@CAMERA@": json.dumps(TOP),
    }
    text = PAGE
    for place, part in parts.items():
        text = text.replace(place, part)
    path = folder / "page.html"
    path.write_text(text)
    wanted, middle = top_elements(arrays, scene.xyz)
    with chromium.page(folder / "profile") as page:
        before = memory()
        page.call("Page.navigate", url=path.as_uri())
        assert page.until("window.first !== undefined"), page.complaints()
        frames = page.evaluate(f"frames({SECONDS})")
        used = memory() - before
        picked = page.evaluate(f"pickAt({json.dumps(middle.tolist())})")
        first = page.evaluate("first") / 1000
        assert page.complaints() == []
    faces = len(arrays["face_element"])
    return Drawn(frames, first, used, wanted, np.array(picked), faces), seconds


def top_elements(
    arrays: dict[str, Any], places: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Elements that are seen from above near the middle, and that of a face of each when it has
    moved.
    """
    corners = places[arrays["triangles"]]
    lowest = corners[:, :, 2].min(axis=1)
    inside = np.abs(corners.mean(axis=1) - 0.5)[:, :2].max(axis=1) < 0.02
    above = np.flatnonzero(
        inside & (lowest > 0.999 if places[:, 2].max() > 0.5 else lowest > -1.0)
    )
    few = above[np.linspace(0, above.size - 1, PICKED).astype(int)]
    size = np.linalg.norm(np.ptp(places, axis=0)) / 2
    moved = corners[few] + 0.09 * size * motion(corners[few].reshape(-1, 3)).reshape(
        -1, 3, 3
    )
    return arrays["element_id"][arrays["face_element"][few]], moved.mean(axis=1)


def memory() -> float:
    """Resident memory of the browsers that this process has begun, MB."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parents[int(entry.name)] = int(
                    (entry / "stat").read_text().rsplit(")", 1)[1].split()[1]
                )
            except OSError:
                continue  # it has ended
    family = {os.getpid()}
    while more := {p for p, parent in parents.items() if parent in family} - family:
        family |= more
    pages = 0
    for child in family - {os.getpid()}:
        try:
            pages += int(Path(f"/proc/{child}/statm").read_text().split()[1])
        except OSError:
            continue
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def checks(drawn: Drawn, faces: int) -> list[Check]:
    """Each element is picked in its middle, the skin has so many faces, and the picture moves."""
    right = float((drawn.picked == drawn.wanted).mean()) * 100
    return [
        at_least("elements picked in their middle", right, 100.0, "%"),
        at_most("faces drawn besides those of the skin", abs(drawn.faces - faces), 0),
        at_least("frames drawn", drawn.frames * SECONDS, 2),
    ]


def main() -> None:
    """Run the cases."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    cases = [
        ("shells of 50,176 nodes", shells, 224, 2 * 223**2),
        ("solids of 300,763 nodes", solids, 67, 12 * 66**2),
        ("shells of 300,304 nodes", shells, 548, 2 * 547**2),
    ]
    for name, build, n, faces in sized(options, cases[:1], cases, cases):
        model = build(n)
        with tempfile.TemporaryDirectory() as folder:
            drawn, seconds = shown(model, Path(folder))
        cost = {
            "frames/s": drawn.frames,
            "s to the first picture": drawn.first,
            "MB": drawn.memory,
            "s to make the scene": seconds,
        }
        report.row(f"{name} in motion", cost, checks(drawn, faces))
    report.end()


if __name__ == "__main__":
    main()
