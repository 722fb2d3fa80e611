"""Damping by region, and the run-up of a rotor with bands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Float
from ringtrue.plots.style import (
    FINAL,
    INITIAL,
    MUTED,
    QUALITATIVE,
    TEST,
    axis,
    f32,
    figure,
    log_axis,
    rule,
)
from ringtrue.study.results import DampedModes, DampedRegions
from ringtrue.updating.prediction import RunUp

BEYOND = "#eef1f4"


def shown(unit: str) -> tuple[float, str]:
    """Factor and unit in which a quantity is shown: motions in mm."""
    return (1e3, "mm") if unit == "m" else (1.0, unit)


def run_up(
    found: RunUp, outputs: Sequence[int], names: Sequence[str], service: float
) -> go.Figure:
    """Amplitudes over speed, medians in their bands; grey: outside the validated band."""
    factor, unit = shown(found.units[outputs[0]])
    x = found.freqs
    a = found.amplitude
    low, median, high = (factor * values for values in (a.low, a.median, a.high))
    fig = figure(
        380,
        xaxis=axis("Speed, Hz", range=[0, float(x[-1])]),
        yaxis=log_axis(f"Amplitude, {unit}", dtick=1),
    )
    top = float(np.log10(max(high[list(outputs)].max(), 1e-300)))
    seen = median[list(outputs)]
    seen = seen[seen > 0]
    lowest = float(np.log10(seen.min())) if seen.size else top - 1
    # five decades below the highest amplitude
    fig.layout.yaxis.range = [max(lowest, top - 5) - 0.1, top + 0.15]
    for k, (i, name) in enumerate(zip(outputs, names, strict=True)):
        color = QUALITATIVE[k % 8]
        both = np.concatenate([high[i], low[i][::-1]])
        around = np.concatenate([x, x[::-1]])
        fig.add_scatter(
            x=f32(around),
            y=f32(both),
            fill="toself",
            fillcolor=_faint(color),
            line={"width": 0},
        )
        fig.data[-1].update(
            hoverinfo="skip",
            legendgroup=name,
            showlegend=False,
        )
        line = {"color": color, "width": 1.6}
        fig.add_scatter(
            x=f32(x),
            y=f32(median[i]),
            line=line,
            name=name,
            legendgroup=name,
        )
        fig.data[
            -1
        ].hovertemplate = f"{name}<br>%{{x:.1f}} Hz: %{{y:.3g}} {unit}<extra></extra>"
    start, end = found.validated
    fig.update_layout(
        shapes=[
            *(_beyond(a, b) for a, b in ((0.0, start), (end, float(x[-1]))) if b > a),
            rule(service),
        ],
        annotations=[_note(service, "service speed")],
    )
    return fig


def _faint(color: str) -> str:
    r, g, b = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},0.2)"


def _beyond(a: float, b: float) -> dict[str, object]:
    return rule(
        a,
        type="rect",
        x1=b,
        fillcolor=BEYOND,
        line={"width": 0},
        layer="below",
    )


def _note(x: float, text: str) -> dict[str, object]:
    font = {"size": 11, "color": MUTED}
    return {
        "x": x,
        "y": 0.99,
        "xref": "x",
        "yref": "paper",
        "text": text,
        "showarrow": False,
        "font": font,
        "xanchor": "left",
        "yanchor": "top",
        "xshift": 4,
    }


LEAST = 0.02  # % of critical: the lower end of the axis
# of the largest over the least damping ratio: above, the axis is logarithmic
DECADE = 10.0


def regions(found: DampedRegions) -> go.Figure:
    """Loss factors with one standard deviation; behind each what was expected before the data."""
    at = [i for i, n in enumerate(found.natures) if n != "dashpot"][::-1]
    names = [found.names[i] for i in at]
    fig = figure(
        96 + 24 * len(at),
        xaxis=axis("Loss factor", rangemode="nonnegative"),
        yaxis=axis(
            type="category",
            showgrid=False,
            ticks="",
            showline=False,
        ),
    )
    low = np.maximum(found.expected - found.expected_std, 0.0)[at]
    high = (found.expected + found.expected_std)[at]
    look = {"color": "#dfe5ea", "line": {"width": 0}}
    fig.add_bar(
        y=names,
        base=f32(low),
        x=f32(high - low),
        orientation="h",
        width=0.55,
        marker=look,
    )
    fig.data[-1].update(
        name="expected, ± 1 σ", hovertemplate="%{base:.3g} to %{x:.3g}<extra></extra>"
    )
    left = np.minimum(found.std, found.coefficients)[at]
    bars = {
        "type": "data",
        "array": f32(found.std[at]),
        "arrayminus": f32(left),
        "thickness": 1.6,
        "width": 4,
    }
    mark = {"size": 9, "color": FINAL}
    fig.add_scatter(
        x=f32(found.coefficients[at]),
        y=names,
        mode="markers",
        marker=mark,
        error_x=bars,
    )
    fig.data[-1].update(
        name="found, ± 1 σ", hovertemplate="%{y}: %{x:.4f}<extra></extra>"
    )
    return fig


def modes(found: DampedModes) -> go.Figure:
    """Damping ratios of the paired modes: test, before and by the regions; those left out are
    open.
    """
    order = np.argsort(found.hertz)
    x = [f"{i + 1}: {f:.2f}" for i, f in enumerate(found.hertz[order])]
    y = axis("Damping ratio, %", rangemode="tozero")
    ratios = np.stack([found.measured, found.before, found.after])
    if ratios.max(initial=0.0) > DECADE * ratios.min(initial=np.inf):
        ticks = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20]
        y |= {"type": "log", "tickvals": ticks, "minor": {"ticks": "outside"}}
    fig = figure(
        340, xaxis=axis("Mode, Hz of the test", type="category", tickangle=-60), yaxis=y
    )
    step = {"color": INITIAL, "width": 1.6, "shape": "hvh"}
    fig.add_scatter(
        x=x,
        y=f32(100 * found.before[order]),
        mode="lines",
        line=step,
        name="before",
    )
    used = found.used[order]
    for name, ratio, std, color, shape in (
        ("test", found.measured, found.measured_std, TEST, "circle"),
        ("by the regions", found.after, found.after_std, FINAL, "diamond"),
    ):
        percent = 100 * ratio[order]
        spread = 100 * std[order]
        bar = {"type": "data", "array": f32(spread), "thickness": 1.1, "width": 3}
        bar["arrayminus"] = f32(np.minimum(spread, np.maximum(percent - LEAST, 0.0)))
        symbols = [shape if u else f"{shape}-open" for u in used.tolist()]
        line = {"width": 2, "color": color}
        mark = {"size": 8, "color": color, "symbol": symbols, "line": line}
        fig.add_scatter(
            x=x,
            y=f32(percent),
            mode="markers",
            marker=mark,
            error_y=bar,
            name=name,
        )
    return fig


def errors(found: DampedModes) -> tuple[list[str], Float, Float]:
    """Names and errors, %, before and after, of the modes with FRFs."""
    at = np.flatnonzero(np.isfinite(found.frf_after))
    at = at[np.argsort(found.hertz[at])]
    names = [f"{found.hertz[i]:.2f}" for i in at]
    return names, 100 * found.frf_before[at], 100 * found.frf_after[at]


def frfs(found: DampedModes) -> go.Figure:
    """Errors of the FRFs around each mode before and after."""
    names, before, after = errors(found)
    x = [f"{i + 1}: {n}" for i, n in enumerate(names)]
    fig = figure(
        260,
        barmode="group",
        xaxis=axis("Mode, Hz of the test", type="category", tickangle=-60),
        yaxis=axis("Error of the FRFs, %", rangemode="tozero"),
    )
    fig.add_bar(
        x=x,
        y=f32(before),
        name="before",
        marker_color=INITIAL,
    )
    fig.add_bar(
        x=x,
        y=f32(after),
        name="by the regions",
        marker_color=FINAL,
    )
    return fig
