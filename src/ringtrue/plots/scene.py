"""The 3D views: model, sensors, shapes and regions, and drawings with fewer nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringtrue.core.arrays import Any_, Bool, Complex, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.paired_shapes import ShapeDifference, shape_difference
from ringtrue.correlation.table import CorrelationTable
from ringtrue.plots.style import QUALITATIVE
from ringtrue.study.opened import PairedShapes
from ringtrue.study.results import Scene
from ringtrue.study.scene import make_scene, scene_modes
from ringtrue.viewer.scene import (
    View,
    model_arrays,
    sensor_arrays,
    shape_arrays,
    test_arrays,
)

PLAIN = "#c3ccd5"
SENSORS = tuple(QUALITATIVE[k] for k in (1, 0, 2, 3))
SOFT = (
    "#9fb4c7",
    "#d8b98a",
    "#a9c3a1",
    "#c9a7b8",
    "#d9cf9c",
    "#a7cbd6",
    "#b8a692",
    "#b9c0c8",
)


def model(scene: Scene, test: TestModel | None, kinds: Mapping[str, str]) -> View:
    """The model by group with its sensors; `kinds` names the kind of a channel (hammer point,
    ...).
    """
    colors = [SOFT[i % len(SOFT)] for i in range(len(scene.groups))]
    drawn: dict[str, Any] = {"model": model_arrays(scene)}
    if test is not None:
        rest = "hammer test" if kinds else "sensors"
        drawn["sensors"] = sensor_arrays(test, kinds, SENSORS, rest)
    legend = [
        {"name": g, "color": c} for g, c in zip(scene.groups, colors, strict=True)
    ]
    return View({"scene": drawn, "colors": colors, "legend": legend})


def regions(
    scene: Scene, changed: Mapping[str, Sequence[int]], notes: Mapping[str, str]
) -> View:
    """The updated regions coloured: parameter -> groups; `notes` gives the change of each in words.

    What several parameters change has the colour of that which changes least besides it.
    """
    colors = [PLAIN] * len(scene.groups)
    alpha = [0.3] * len(scene.groups)
    own = {name: QUALITATIVE[k % len(QUALITATIVE)] for k, name in enumerate(changed)}
    for name, groups in sorted(changed.items(), key=lambda item: -len(item[1])):
        for g in groups:
            colors[g], alpha[g] = own[name], 1.0
    hidden = {name: "" if groups else ", not drawn" for name, groups in changed.items()}
    legend = [
        (name + hidden[name], color, notes.get(name, "")) for name, color in own.items()
    ]
    return painted(scene, colors, alpha, legend)


def painted(
    scene: Scene,
    colors: Sequence[str],
    alpha: Sequence[float],
    legend: Sequence[tuple[str, str, str]],
) -> View:
    """Every group in a colour of its own; `legend` holds name, colour and note of those that are
    named.
    """
    entries = [{"name": n, "color": c, "note": t} for n, c, t in legend]
    drawn = {"model": model_arrays(scene)}
    return View(
        {
            "scene": drawn,
            "colors": list(colors),
            "alpha": list(alpha),
            "legend": entries,
        }
    )


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """One selectable shape: a model shape over the skin, a test shape over the wireframe, or
    both.
    """

    stage: str
    label: str
    info: str
    fe: tuple[ModeSet, int] | None = None
    test: tuple[ModeSet, int] | None = None
    seen: tuple[ModeSet, int] | None = (
        None  # the model's shape at the channels, to bring the test to its phase
    )


def at_nodes(scene: Scene, modes: ModeSet, k: int) -> Float:
    """(node, 3) displacements of mode `k`; zero where the mode has no such degree of freedom."""
    dofs = (
        modes.labels if isinstance(modes.labels, DofSet) else DofSet.parse(modes.labels)
    )
    node = np.repeat(scene.node, 3)
    at = dofs.find(node, np.tile(np.array([1, 2, 3]), scene.node.size))
    value = np.real(modes.shapes[:, k])[at] * np.sign(dofs.direction[at])
    return np.where(at >= 0, value, 0.0).reshape(-1, 3)


def _at_points(test: TestModel, modes: ModeSet, values: Any_) -> Any_:
    """(point, 3) displacements from channel readings: each reading along its axis."""
    here = {c: i for i, c in enumerate(test.channels)}
    kept = [(k, here[c]) for k, c in enumerate(modes.channels) if c in here]
    rows = np.array([k for k, _ in kept], dtype=np.int64)
    channel = np.array([c for _, c in kept], dtype=np.int64)
    order = np.argsort(test.points)
    point = order[np.searchsorted(test.points[order], test.at[channel])]
    out = np.zeros((test.points.size, 3), dtype=values.dtype)
    np.add.at(out, point, values[rows, None] * test.axes[channel])
    return out


def _phased(shown: Shown) -> Any_:
    """The test shape turned and scaled onto the model's shape at the same channels (for drawing
    only).
    """
    assert shown.test is not None
    modes, k = shown.test
    shape = np.nan_to_num(modes.shapes[:, k])
    if shown.seen is not None:
        other, j = shown.seen
        here = {c: i for i, c in enumerate(other.channels)}
        both = [(i, here[c]) for i, c in enumerate(modes.channels) if c in here]
        a = shape[[i for i, _ in both]]
        b = other.shapes[[i for _, i in both], j]
        scale = np.vdot(a, b) / max(float(np.vdot(a, a).real), 1e-300)
        return shape * scale if abs(scale) > 0 else shape
    peak = shape[np.abs(shape).argmax()] if shape.size else 1.0
    return shape / peak if peak else shape


def at_test_points(test: TestModel, shown: Shown) -> Complex:
    """(point, 3) displacements of the test shape of what is shown, on the model's shape."""
    assert shown.test is not None
    return _at_points(test, shown.test[0], _phased(shown).astype(np.complex128))


def difference_at_points(
    test: TestModel, shape: tuple[ModeSet, int], seen: tuple[ModeSet, int]
) -> tuple[ShapeDifference, Complex]:
    """The difference of a test mode and an FE mode, from 0, and as (point, 3) displacements."""
    found = shape_difference(*shape, *seen)
    return found, np.asarray(_at_points(test, found.modes, found.modes.shapes[:, 0]))


def _mode(scene: Scene | None, test: TestModel | None, shown: Shown) -> dict[str, Any]:
    out: dict[str, Any] = {
        "stage": shown.stage,
        "label": shown.label,
        "info": shown.info,
    }
    if scene is not None and shown.fe is not None:
        out["fe"] = shape_arrays(at_nodes(scene, *shown.fe))
    elif test is not None and shown.seen is not None:
        seen, j = shown.seen
        out["wire"] = shape_arrays(np.real(_at_points(test, seen, seen.shapes[:, j])))
    if test is not None and shown.test is not None:
        points = at_test_points(test, shown)
        out["test"] = shape_arrays(points.real, points.imag)
    return out


def modes(scene: Scene | None, test: TestModel | None, shown: Sequence[Shown]) -> View:
    """Mode shapes: the test's wireframe over the model's skin, to be animated."""
    drawn: dict[str, Any] = {}
    if scene is not None:
        drawn["model"] = model_arrays(scene)
    if test is not None:
        drawn["test"] = test_arrays(test)
    return View({"scene": drawn, "modes": [_mode(scene, test, s) for s in shown]})


def model_modes(scene: Scene, shapes: ModeSet) -> View:
    """The mode shapes of a model in motion."""
    labels = _numbered(shapes)
    return modes(
        scene,
        None,
        [Shown("model", s, s, fe=(shapes, k)) for k, s in enumerate(labels)],
    )


def pair_modes_view(table: CorrelationTable, shapes: PairedShapes) -> View:
    """The mode pairs of a correlation in motion, the test over the model."""
    scene = make_scene(shapes.opened.model, {}, shapes.opened.length)
    skin = scene_modes(shapes.modes, scene)
    shown = [
        Shown(
            "pairs",
            f"test {r.test} · FE {r.fe}: {r.test_hz:.4g} Hz",
            f"test {r.test_hz:.4g} Hz, FE {r.fe_hz:.4g} Hz, Δf {r.deviation_percent:+.2f} %, "
            f"MAC {r.mac_percent:.1f} %",
            fe=(skin, r.fe - 1),
            test=(shapes.test, r.test - 1),
            seen=(shapes.fe, r.fe - 1),
        )
        for r in table.rows()
    ]
    return modes(scene, shapes.points, shown)


def test_modes(test: TestModel, shapes: ModeSet) -> View:
    """The mode shapes of a test in motion, on the wireframe of its sensor sheet."""
    labels = _numbered(shapes)
    return modes(
        None,
        test,
        [Shown("test", s, s, test=(shapes, k)) for k, s in enumerate(labels)],
    )


def _numbered(shapes: ModeSet) -> list[str]:
    return [f"mode {k + 1}: {f:.4g} Hz" for k, f in enumerate(shapes.frequencies)]


def channel_kinds(references: Sequence[str], ambient: Sequence[str]) -> dict[str, str]:
    """What a channel is used for: hammer point, ambient and hammer test, or hammer test only (the
    rest).
    """
    kinds = dict.fromkeys(ambient, "ambient and hammer tests")
    return kinds | dict.fromkeys(references, "hammer reference")


HALVINGS = 24  # of the size of a cell


def thinned(scene: Scene, most: int) -> Scene:
    """The scene with at most `most` of its nodes, itself where it has no more.

    Vertex clustering (Rossignac, Borrel 1993): the nodes of a cubic cell become the one nearest to
    their mean; triangles and lines that collapse or come twice go. Cells are as small as `most`
    allows.
    """
    if scene.node.size <= most:
        return scene
    cell = _cells(scene, most)
    count = int(cell.max()) + 1
    size = np.bincount(cell, minlength=count)
    mean = (
        np.stack([np.bincount(cell, x, count) for x in scene.xyz.T], axis=1)
        / size[:, None]
    )
    order = np.lexsort((np.linalg.norm(scene.xyz - mean[cell], axis=1), cell))
    first = np.sort(order[np.r_[True, np.diff(cell[order]) > 0]])
    at = np.empty(count, dtype=np.int64)
    at[cell[first]] = np.arange(count)
    seat = at[cell]
    triangles = seat[scene.triangles]
    lines = seat[scene.lines]
    t = _kept_corners(triangles, np.zeros(len(triangles), dtype=np.bool_))
    k = _kept_corners(lines, np.asarray(scene.lines[:, 0] == scene.lines[:, 1]))
    return replace(
        scene,
        node=scene.node[first],
        xyz=scene.xyz[first],
        triangles=triangles[t],
        triangle_group=scene.triangle_group[t],
        lines=lines[k],
        line_group=scene.line_group[k],
    )


def _cells(scene: Scene, most: int) -> Int:
    """The number (n,) of each node's cell, of the smallest cells that are at most `most`."""
    corner = scene.xyz.min(axis=0)
    large = float(np.ptp(scene.xyz, axis=0).max()) * (1 + 1e-9)
    best = np.zeros(scene.node.size, dtype=np.int64)
    small = 0.0
    for _ in range(HALVINGS):
        size = (small + large) / 2
        step = ((scene.xyz - corner) // size).astype(np.int64)
        top = step.max(axis=0) + 1
        _, cell = np.unique(
            (step[:, 0] * top[1] + step[:, 1]) * top[2] + step[:, 2],
            return_inverse=True,
        )
        if int(cell.max()) < most:
            best = cell
            large = size
        else:
            small = size
    return best


def _kept_corners(corners: Int, point: Bool) -> Int:
    """Positions of what has not collapsed, or was a point from the start, each once."""
    key = np.sort(corners, axis=1)
    whole = np.all(np.diff(key, axis=1) > 0, axis=1) | point
    at = np.flatnonzero(whole)
    _, first = np.unique(key[at], axis=0, return_index=True)
    return at[np.sort(first)]
