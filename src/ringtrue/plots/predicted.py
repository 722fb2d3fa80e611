"""Run-up of a rotor with bands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Float
from ringtrue.plots.style import MUTED, QUALITATIVE, axis, f32, figure, log_axis
from ringtrue.updating.prediction import RunUp

DECADES = 5  # below the highest amplitude
BEYOND = "#eef1f4"


def shown(unit: str) -> tuple[float, str]:
    """Factor and unit in which a quantity is shown: motions in mm."""
    return (1e3, "mm") if unit == "m" else (1.0, unit)


def run_up(found: RunUp, outputs: Sequence[int], names: Sequence[str], service: float) -> go.Figure:
    """Amplitudes over speed, medians in their bands; grey: outside the validated band."""
    factor, unit = shown(found.units[outputs[0]])
    x, a = found.freqs, found.amplitude
    low, median, high = (factor * values for values in (a.low, a.median, a.high))
    fig = figure(
        380,
        xaxis=axis("Speed, Hz", range=[0, float(x[-1])]),
        yaxis=log_axis(f"Amplitude, {unit}", dtick=1),
    )
    fig.layout.yaxis.range = _range(median[list(outputs)], high[list(outputs)])
    for k, (i, name) in enumerate(zip(outputs, names, strict=True)):
        color = QUALITATIVE[k % 8]
        both = np.concatenate([high[i], low[i][::-1]])
        around = np.concatenate([x, x[::-1]])
        fig.add_scatter(
            x=f32(around), y=f32(both), fill="toself", fillcolor=_faint(color), line={"width": 0}
        )
        fig.data[-1].update(hoverinfo="skip", legendgroup=name, showlegend=False)
        line = {"color": color, "width": 1.6}
        fig.add_scatter(x=f32(x), y=f32(median[i]), line=line, name=name, legendgroup=name)
        fig.data[-1].hovertemplate = f"{name}<br>%{{x:.1f}} Hz: %{{y:.3g}} {unit}<extra></extra>"
    start, end = found.validated
    fig.update_layout(
        shapes=[
            *(_beyond(a, b) for a, b in ((0.0, start), (end, float(x[-1]))) if b > a),
            _mark(service),
        ],
        annotations=[_note(service, "service speed")],
    )
    return fig


def _range(median: Float, high: Float) -> list[float]:
    top = float(np.log10(max(high.max(), 1e-300)))
    seen = median[median > 0]
    low = float(np.log10(seen.min())) if seen.size else top - 1
    return [max(low, top - DECADES) - 0.1, top + 0.15]


def _faint(color: str) -> str:
    r, g, b = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},0.2)"


def _beyond(a: float, b: float) -> dict[str, object]:
    look = {"fillcolor": BEYOND, "line": {"width": 0}, "layer": "below"}
    return {
        "type": "rect",
        "xref": "x",
        "yref": "paper",
        "x0": a,
        "x1": b,
        "y0": 0,
        "y1": 1,
        **look,
    }


def _mark(x: float) -> dict[str, object]:
    line = {"color": MUTED, "width": 1, "dash": "dot"}
    return {
        "type": "line",
        "xref": "x",
        "yref": "paper",
        "x0": x,
        "x1": x,
        "y0": 0,
        "y1": 1,
        "line": line,
    }


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
