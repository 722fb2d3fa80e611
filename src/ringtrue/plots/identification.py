"""Stabilisation diagrams, damping, expected and found standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Any_, Bool, Float
from ringtrue.core.modes import ModeSet, Uncertainty, elastic
from ringtrue.identification.ambient.decay_backbone import Backbone
from ringtrue.identification.common.stabilisation import StableDiagram
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
    ticks,
)

# What the colours of a stabilisation diagram mean.
POLE_COLORS = (
    ("spectrum", "#b4bec8"),
    ("unstable pole", "#d3cbbd"),
    ("stable pole", QUALITATIVE[5]),
    ("pole taken into a mode", FE),
    ("mode", TEST),
)
LIMIT = 3000  # strokes of one kind in one diagram; beyond it every n-th is drawn


def _strokes(
    diagram: StableDiagram, chosen: Bool, span: tuple[float, float]
) -> tuple[Any_, Any_, str]:
    f = diagram.poles.frequencies
    order = diagram.poles.order.astype(np.float64)
    at = np.flatnonzero(chosen & (f >= span[0]) & (f <= span[1]))
    every = -(-at.size // LIMIT) or 1
    at = at[::every]
    step = float(np.diff(diagram.poles.orders).min(initial=2))
    x, y = ticks(f[at], order[at] - 0.42 * step, order[at] + 0.42 * step)
    return x, y, f" (one in {every} drawn)" if every > 1 else ""


def pole_span(diagram: StableDiagram) -> tuple[float, float]:
    """Where the poles of a diagram lie, with a margin, Hz."""
    f = diagram.poles.frequencies if diagram.poles.frequencies.size else diagram.freqs
    low = float(f.min(initial=np.inf))
    high = float(f.max(initial=0.0))
    if low > high:
        return 0.0, 1.0
    margin = max(0.06 * (high - low), 0.03 * high) or 1.0  # poles of one mode lie within a hair
    return max(low - margin, 0.0), high + margin


def spectrum(
    diagram: StableDiagram, span: tuple[float, float], height: int, points: int
) -> go.Figure:
    """The axes of a stabilisation diagram, with the spectrum behind."""
    fig = figure(
        height,
        xaxis=axis("Frequency, Hz", range=list(span)),
        yaxis=axis("Model order", rangemode="tozero"),
        yaxis2=axis(
            "Spectrum, dB",
            overlaying="y",
            side="right",
            showgrid=False,
            tickmode="auto",
            nticks=5,
        ),
    )
    inside = np.flatnonzero((diagram.freqs >= span[0]) & (diagram.freqs <= span[1]))
    inside = inside[:: max(1, inside.size // points)]
    grey = {"width": 1, "color": "#b4bec8"}
    x = f32(diagram.freqs[inside])
    y = f32(diagram.level[inside])
    fig.add_scatter(
        x=x,
        y=y,
        yaxis="y2",
        line=grey,
        name="spectrum",
        hoverinfo="skip",
    )
    return fig


def stabilisation(diagram: StableDiagram, modes: ModeSet) -> go.Figure:
    """Poles by model order over the spectrum; the modes as marks. Drawn where there are poles."""
    span = pole_span(diagram)
    in_mode = diagram.cluster >= 0
    fig = spectrum(diagram, span, 240, points=1000)
    fig.update_layout(showlegend=False, margin={"r": 60, "t": 10})
    for name, chosen, color, width in (
        ("unstable", ~diagram.stable & ~in_mode, "#d3cbbd", 1.0),
        ("stable", diagram.stable & ~in_mode, QUALITATIVE[5], 1.6),
        ("in a mode", in_mode, FE, 2.0),
    ):
        x, y, note = _strokes(diagram, chosen, span)
        line = {"width": width, "color": color}
        fig.add_scatter(
            x=x,
            y=y,
            mode="lines",
            line=line,
            name=name + note,
            hoverinfo="skip",
        )
    top = float(diagram.poles.order.max(initial=1))
    f = modes.band(*span).frequencies
    mark = {"symbol": "triangle-down", "size": 8, "color": TEST}
    hover = "%{x:.3f} Hz<extra>mode</extra>"
    fig.add_scatter(
        x=f32(f),
        y=np.full(f.shape, top * 1.05),
        mode="markers",
        marker=mark,
        name="mode",
    )
    fig.data[-1].hovertemplate = hover
    return fig


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
