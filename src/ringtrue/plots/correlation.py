"""MAC matrices and frequency deviations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Float
from ringtrue.correlate.pairing import CorrelationTable
from ringtrue.plots.style import FINAL, INITIAL, REMODELLED, SEQUENTIAL, TEST, axis, f32, figure

STAGE_COLORS = {"initial": INITIAL, "remodelled": REMODELLED, "final": FINAL}


def matrix(
    mac: Float,
    rows: Sequence[str],
    columns: Sequence[str],
    row_title: str,
    column_title: str,
    height: int = 0,
    diagonal: bool = True,
) -> go.Figure:
    """A MAC matrix in percent; `mac` (row, column) 0..1. Cells over 10 % carry their number.

    `diagonal` False leaves out the ones of an auto-MAC.
    """
    percent = 100 * np.asarray(mac)
    size = max(percent.shape, default=1)
    fig = figure(
        height or int(np.clip(150 + 23 * percent.shape[0], 260, 720)),
        xaxis=axis(column_title, type="category", tickangle=-90 if size > 8 else 0, showgrid=False, ticks=""),
        yaxis=axis(row_title, type="category", autorange="reversed", showgrid=False, ticks=""),
    )
    for a in (fig.layout.xaxis, fig.layout.yaxis):
        a.update(tickfont={"size": 10 if size > 12 else 11}, showline=False)
    told = percent >= 10
    if not diagonal:
        np.fill_diagonal(told, False)
    text = np.where(told, np.char.mod("%.0f", percent), "")
    bar = {"thickness": 10, "outlinewidth": 0, "title": {"text": "MAC, %", "side": "top", "font": {"size": 11}}}
    fig.add_heatmap(
        z=f32(percent), x=list(columns), y=list(rows), zmin=0, zmax=100, colorscale=SEQUENTIAL, colorbar=bar
    )
    fig.data[0].update(xgap=1, ygap=1, text=text, texttemplate="%{text}", textfont={"size": 9 if size > 12 else 10})
    fig.data[0].hovertemplate = "%{y}<br>%{x}<br>MAC %{z:.1f} %<extra></extra>"
    fig.update_layout(plot_bgcolor="#eef1f4", margin={"t": 12, "r": 8, "l": 50, "b": 50})
    return fig


def labels(frequencies: Float) -> list[str]:
    """`1: 13.42` for each mode."""
    return [f"{i + 1}: {f:.2f}" for i, f in enumerate(frequencies.tolist())]


def table_matrix(table: CorrelationTable) -> go.Figure:
    """The MAC matrix of a correlation, its pairs outlined, from the first column compared to just above the test."""
    a, b = (f"{name} mode, Hz" for name in table.names)
    first, last = _columns(table)
    names = labels(table.all_fe_hz)[first:last]
    fig = matrix(table.mac[:, first:last], labels(table.all_test_hz), names, a, b)
    pairs = zip(table.pairing.a.tolist(), (table.pairing.b - first).tolist(), strict=True)
    fig.update_layout(shapes=[_outline(i, j) for i, j in pairs])
    return fig


def _columns(table: CorrelationTable) -> tuple[int, int]:
    compared = np.flatnonzero(table.mac.any(axis=0))
    near = np.flatnonzero(table.all_fe_hz <= 1.15 * table.all_test_hz.max(initial=0.0))
    last = max(int(x.max(initial=-1)) for x in (near, table.pairing.b)) + 1
    first = int(compared[0]) if compared.size else 0
    return (first, last) if last > first else (0, table.mac.shape[1])


def _outline(row: int, column: int) -> dict[str, object]:
    edges = {"x0": column - 0.5, "x1": column + 0.5, "y0": row - 0.5, "y1": row + 0.5}
    return {"type": "rect", **edges, "line": {"width": 1.5, "color": TEST}}


def deviations(stages: Sequence[tuple[str, CorrelationTable]]) -> go.Figure:
    """Frequency deviation of each test mode, one mark a stage; hollow marks were left out of the updating."""
    fig = figure(
        330,
        xaxis=axis("Test mode, Hz", type="category", tickangle=-45),
        yaxis=axis("(f FE − f test)/f test, %", zeroline=True, zerolinecolor="#5c6b7a", zerolinewidth=1),
    )
    order = {r.test: r.test_hz for _, t in stages for r in t.rows()}
    names = {k: f"{k}: {order[k]:.2f}" for k in sorted(order)}
    for size, (name, table) in zip((13, 10, 9), stages, strict=False):
        color = STAGE_COLORS.get(name, FINAL)
        marks = ["circle" if r.used or name != "final" else "circle-open" for r in table.rows()]
        look = {"size": size, "color": color, "symbol": marks, "line": {"width": 2, "color": color}}
        x = [names[r.test] for r in table.rows()]
        y = f32(table.deviation_percent)
        fig.add_scatter(x=x, y=y, mode="markers", marker=look, name=name)
        fig.data[-1].hovertemplate = f"{name}: %{{y:.2f}} %<extra>%{{x}} Hz</extra>"
    fig.layout.xaxis.update(categoryorder="array", categoryarray=list(names.values()))
    return fig
