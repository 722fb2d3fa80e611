"""What the viewer draws, as arrays: a model, a test, sensors (viewer.js says what each holds)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.core.testmodel import TestModel
from ringtrue.model.model import Model
from ringtrue.study.results import Scene
from ringtrue.viewer.encoding import f4, u2, u4


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
    test: TestModel, kinds: Mapping[str, str], colors: Sequence[str], rest: str = "sensors"
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
