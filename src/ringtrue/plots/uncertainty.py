"""Parameters before and after the test, and predicted frequencies with their bands."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from ringtrue.plots.style import (
    DIVERGING,
    FE,
    FINAL,
    INITIAL,
    MUTED,
    QUALITATIVE,
    TEST,
    axis,
    f32,
    figure,
)
from ringtrue.study.results import UncertaintyStage

TICKS = [0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 7, 10, 20, 50]


def parameters(stage: UncertaintyStage) -> go.Figure:
    """Intervals of the factors: prior, posterior and, where sampled, the draws."""
    names = list(stage.parameters.names)
    fig = figure(
        90 + 42 * len(names),
        xaxis=axis(
            "Updated / initial", type="log", tickvals=TICKS, ticktext=[f"{t:g}" for t in TICKS]
        ),
        yaxis=axis(
            "",
            autorange="reversed",
            showgrid=False,
            ticks="",
            tickvals=list(range(len(names))),
            ticktext=names,
        ),
    )
    rows = np.arange(len(names), dtype=np.float64)
    percent = f"{100 * stage.level:g} %"
    for low_high, at, width, color, name in (
        (stage.prior, rows, 3, INITIAL, f"before the test, {percent}"),
        (stage.interval, rows, 9, FINAL, f"after it, {percent}"),
        (stage.sampled, rows + 0.22, 3, QUALITATIVE[3], f"sampled, {percent}"),
    ):
        if len(low_high):
            x, y = _strokes(low_high, at)
            fig.add_scatter(
                x=f32(x), y=f32(y), mode="lines", name=name, line={"width": width, "color": color}
            )
            fig.data[-1].update(hoverinfo="skip")
    marks = {"symbol": "line-ns", "size": 15, "line": {"width": 2.5, "color": TEST}}
    fig.add_scatter(
        x=f32(stage.factor), y=rows, mode="markers", marker=marks, name="final", text=names
    )
    fig.data[-1].hovertemplate = "%{text}: × %{x:.3f}<extra></extra>"
    look = {"color": MUTED, "width": 1, "dash": "dot"}
    fig.update_layout(
        shapes=[{"type": "line", "x0": 1, "x1": 1, "yref": "paper", "y0": 0, "y1": 1, "line": look}]
    )
    return fig


def _strokes(low_high: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal strokes as one broken line."""
    gap = np.full((len(at), 1), np.nan)
    return np.concatenate([low_high, gap], axis=1).ravel(), np.repeat(at, 3)


def correlation(stage: UncertaintyStage) -> go.Figure:
    """Correlation of the parameters after the test."""
    names = list(stage.parameters.names)
    fig = figure(
        130 + 30 * len(names),
        xaxis=axis("", tickangle=-45, showgrid=False, showline=False, ticks=""),
        yaxis=axis("", autorange="reversed", showgrid=False, showline=False, ticks=""),
    )
    bar = {"thickness": 10, "outlinewidth": 0}
    fig.add_heatmap(
        z=f32(stage.correlation),
        x=names,
        y=names,
        zmin=-1,
        zmax=1,
        colorscale=DIVERGING,
        colorbar=bar,
    )
    fig.data[0].update(xgap=1, ygap=1, texttemplate="%{z:.2f}", textfont={"size": 10})
    fig.data[0].hovertemplate = "%{y}, %{x}: %{z:.2f}<extra></extra>"
    fig.update_layout(margin={"t": 10})
    return fig


def bands(stage: UncertaintyStage) -> go.Figure:
    """Deviation of each prediction from the measurement, with the band that should reach to
    zero.
    """
    fig = figure(
        350,
        xaxis=axis("Test mode, Hz", type="category", tickangle=-45),
        yaxis=axis(
            "(f FE − f test)/f test, %", zeroline=True, zerolinecolor="#5c6b7a", zerolinewidth=1
        ),
    )
    there = np.isfinite(stage.predicted)
    names = np.array([f"{i + 1}: {f:.2f}" for i, f in enumerate(stage.test.tolist())])
    deviation = 100 * (stage.predicted / stage.test - 1)
    reach = 100 * (stage.band[:, 1] - stage.predicted) / stage.test
    for name, which, color, symbol in (
        ("used in the updating", stage.used, FE, "circle"),
        ("left out of it", ~stage.used, TEST, "diamond-open"),
    ):
        at = there & which
        marker = {"size": 9, "symbol": symbol, "color": color, "line": {"width": 2, "color": color}}
        error = {
            "type": "data",
            "array": f32(reach[at]),
            "thickness": 1.4,
            "width": 5,
            "color": color,
        }
        fig.add_scatter(
            x=names[at].tolist(), y=f32(deviation[at]), mode="markers", marker=marker, error_y=error
        )
        fig.data[-1].update(name=name, customdata=f32(reach[at]))
        fig.data[-1].hovertemplate = "%{x} Hz: %{y:.2f} ± %{customdata:.2f} %<extra></extra>"
    fig.layout.xaxis.update(categoryorder="array", categoryarray=names[there].tolist())
    return fig
