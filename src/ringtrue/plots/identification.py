"""Stabilisation diagrams, damping, expected and found standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet, Uncertainty, elastic
from ringtrue.identification.ambient.decay_backbone import Backbone
from ringtrue.plots.style import (
    FE,
    FINAL,
    MUTED,
    QUALITATIVE,
    TEST,
    axis,
    f32,
    figure,
    hertz,
)


def damping(
    sets: list[tuple[str, ModeSet, Uncertainty | None]], used: tuple[Float, Float] | None
) -> go.Figure:
    """Damping ratios over frequency with one standard deviation; `used` (f, ζ) is what the elastic
    modes carry.
    """
    x = hertz()
    fig = figure(320, xaxis=x, yaxis=axis("Damping ratio, %", rangemode="tozero"))
    for i, (name, modes, std) in enumerate(sets):
        color = (TEST, QUALITATIVE[0])[i % 2]
        bar = None
        if std:
            bar = {"type": "data", "array": f32(100 * std.damping), "thickness": 1, "width": 3}
        mark = {"size": 8, "color": color, "symbol": ("circle", "diamond")[i % 2]}
        f = f32(modes.frequencies)
        y = f32(100 * modes.damping)
        fig.add_scatter(
            x=f,
            y=y,
            error_y=bar,
            mode="markers",
            marker=mark,
            name=name,
        )
    if used is not None:
        mark = {
            "size": 9,
            "color": FINAL,
            "symbol": "line-ew-open",
            "line": {"width": 2, "color": FINAL},
        }
        f, y = (f32(x[elastic(used[0])]) for x in (used[0], 100 * used[1]))
        fig.add_scatter(
            x=f,
            y=y,
            mode="markers",
            marker=mark,
            name="carried by the final model",
        )
    return fig


def precision(modes: ModeSet, std: Float, expected: Float) -> go.Figure:
    """Relative standard deviation of each target frequency as planned; `std`, `expected` (target,)
    relative.
    """
    fig = figure(
        280,
        barmode="group",
        xaxis=axis("Mode, Hz", type="category", tickangle=-60),
        yaxis=axis("Standard deviation, %"),
    )
    fig.layout.yaxis.update(type="log", dtick=1)
    names = [f"{f:.2f}" for f in modes.frequencies]
    fig.add_bar(
        x=names,
        y=f32(100 * std),
        name="frequency",
        marker_color=FE,
    )
    fig.add_bar(
        x=names,
        y=f32(100 * expected),
        name="damping",
        marker_color=MUTED,
    )
    return fig


def verified(rows: Sequence[Mapping[str, float]]) -> go.Figure:
    """Standard deviations of the ambient modes over frequency: planned as lines, found as marks;
    `rows` in percent.
    """
    x = hertz()
    fig = figure(430, xaxis=x, yaxis=axis("Standard deviation, %", type="log", dtick=1))
    f = f32(np.array([r["frequency_hz"] for r in rows]))
    for name, color in (("frequency", FE), ("damping", QUALITATIVE[4])):
        planned, found = (
            f32(np.array([r[f"{k}_{name}"] for r in rows])) for k in ("planned", "found")
        )
        line = {"width": 1.6, "color": color}
        fig.add_scatter(
            x=f,
            y=planned,
            mode="lines",
            line=line,
            name=f"{name}, planned",
        )
        fig.add_scatter(
            x=f,
            y=found,
            mode="markers",
            marker={"size": 7, "color": color},
            name="found",
        )
        fig.data[-1].hovertemplate = f"%{{x:.3f}} Hz: {name} %{{y:.2g}} %<extra></extra>"
    return fig


def backbone(found: Backbone) -> go.Figure:
    """Frequency and damping ratio of a mode over its amplitude: measured as marks, fitted as
    lines.
    """
    left = axis("Frequency, Hz", domain=[0.55, 1.0])
    right = axis("Damping ratio, %", domain=[0.0, 0.42], anchor="x")
    fig = figure(360, xaxis=axis("Amplitude", type="log", anchor="y2"), yaxis=left, yaxis2=right)
    fig.update_layout(showlegend=False)
    for name, points, curve, factor, on in (
        ("frequency", found.frequency, found.fit_frequency, 1, "y"),
        ("damping", found.damping, found.fit_damping, 100, "y2"),
    ):
        x = f32(found.amplitude)
        mark = {"size": 5, "color": TEST}
        fig.add_scatter(
            x=x, y=f32(factor * points), yaxis=on, mode="markers", marker=mark, name=name
        )
        line = {"width": 2, "color": FE}
        x = f32(found.fit_amplitude)
        fig.add_scatter(x=x, y=f32(factor * curve), yaxis=on, mode="lines", line=line, name="fit")
    return fig
