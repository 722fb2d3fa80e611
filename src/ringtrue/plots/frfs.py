"""FRFs on a screen: any output and input of test and models, and their FRAC over the channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Complex, Float
from ringtrue.correlation.frf import FrfComparison
from ringtrue.plots.diagram import WIDE
from ringtrue.plots.signals import PHASE
from ringtrue.plots.style import (
    FINAL,
    INITIAL,
    QUALITATIVE,
    SEQUENTIAL,
    TEST,
    axis,
    f32,
    figure,
    log_axis,
    rule,
)

FIT = QUALITATIVE[3]
LOOKS = {
    "initial model": {"color": INITIAL, "width": 1.3},
    "test": {"color": TEST, "width": 1.4},
    "fit of the test": {"color": FIT, "width": 1.4, "dash": "dash"},
    "final model": {"color": FINAL, "width": 1.6},
    "trial": {"color": FINAL, "width": 1.6},
}
MODE = {"color": "#8b97a3", "width": 0.8, "dash": "dot"}
SELECTED = {"color": QUALITATIVE[4], "width": 2}
OUTSIDE = {"type": "rect", "yref": "paper", "y0": 0, "y1": 1, "fillcolor": "#8b97a3"}


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One FRF.

    Attributes
    ----------
    name : str
        A key of `LOOKS`.
    freqs : (f,) float64, Hz
    value : (f,) complex128
    """

    name: str
    freqs: Float
    value: Complex


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """What is marked over the frequencies, Hz.

    Attributes
    ----------
    modes : (m,) float64
    band : (float, float), optional
        Outside of it nothing is compared.
    selected : float, optional
    """

    modes: Float
    band: tuple[float, float] | None = None
    selected: float | None = None


def frf(curves: Sequence[Curve], unit: str, marks: Marks, *, parts: bool = False) -> go.Figure:
    """FRFs over each other: magnitude and phase, or real and imaginary part if `parts`."""
    middle = PHASE.get(unit, 0)
    ticks = [middle - 180, middle, middle + 180]
    upper = {"domain": [0.5, 1] if parts else [0.34, 1]}
    lower = {"domain": [0, 0.46] if parts else [0, 0.29], "anchor": "x2"}
    top = max((float(c.freqs[-1]) for c in curves), default=1.0)
    shown = min(top, 1.25 * marks.band[1]) if marks.band else top
    fig = figure(
        520,
        xaxis=axis(anchor="y", matches="x2", showticklabels=False),
        yaxis=axis(f"Re H, {unit}", **upper)
        if parts
        else log_axis(f"|H|, {unit}", dtick=1, **upper),
        xaxis2=axis("Frequency, Hz", anchor="y2", range=[0, shown]),
        yaxis2=axis(f"Im H, {unit}", **lower)
        if parts
        else axis("Phase, °", tickvals=ticks, range=[ticks[0] - 10, ticks[-1] + 10], **lower),
        margin={"l": 72, "r": 16, "t": 30, "b": 44},
        hovermode="closest",
        dragmode="zoom",
        shapes=_marked(marks, top),
    )
    for name, look in LOOKS.items():
        for c in (c for c in curves if c.name == name):
            if parts:
                one, two = c.value.real, c.value.imag
            else:
                one = np.maximum(np.abs(c.value), 1e-300)
                two = (np.degrees(np.angle(c.value)) - ticks[0]) % 360 + ticks[0]
            shared = {"x": f32(c.freqs), "mode": "lines", "line": look, "legendgroup": name}
            hover = "%{x:.5g} Hz: %{y:.4g}<extra>" + name + "</extra>"
            fig.add_scatter(y=f32(one), name=name, hovertemplate=hover, **shared)
            fig.add_scatter(
                y=f32(two),
                name=name,
                hovertemplate=hover,
                xaxis="x2",
                yaxis="y2",
                showlegend=False,
                **shared,
            )
    return fig


def _marked(marks: Marks, top: float) -> list[dict[str, object]]:
    """Modes as lines, the selected one stronger, and what is outside of the band shaded."""
    shapes = [rule(f, xref="x2", line=MODE) for f in marks.modes[marks.modes < top].tolist()]
    if marks.selected is not None and marks.selected < top:
        shapes.append(rule(marks.selected, xref="x2", line=SELECTED))
    for x0, x1 in ((0.0, marks.band[0]), (marks.band[1], top)) if marks.band else ():
        if x1 > x0:
            ends = {"x0": x0, "x1": x1, "xref": "x2", "line": {"width": 0}, "opacity": 0.12}
            shapes.append(OUTSIDE | ends)
    return shapes


def frac_map(found: FrfComparison, selected: tuple[str, str] | None = None) -> go.Figure:
    """FRAC of each FRF, outputs along and inputs up; `selected` (output, input) is framed."""
    fig = figure(
        110 + 24 * len(found.inputs),
        xaxis=axis("", type="category", tickangle=-60, showgrid=False),
        yaxis=axis("", type="category", showgrid=False),
    )
    fig.add_heatmap(
        z=f32(found.frac.T),
        x=list(found.outputs),
        y=list(found.inputs),
        zmin=0,
        zmax=1,
        xgap=1,
        ygap=1,
        colorscale=[list(stop) for stop in SEQUENTIAL],
        colorbar={"thickness": 10, "len": 1.1, "tickvals": [0, 0.5, 1]},
        hovertemplate="%{x} / %{y}: FRAC %{z:.3f}<extra></extra>",
    )
    fig.update_layout(margin={"l": 60, "r": 10, "t": 6, "b": 52})
    if selected is not None and selected[0] in found.outputs and selected[1] in found.inputs:
        x, y = found.outputs.index(selected[0]), found.inputs.index(selected[1])
        line = {"color": QUALITATIVE[4], "width": 2.5}
        fig.add_shape(
            type="rect", x0=x - 0.5, x1=x + 0.5, y0=y - 0.5, y1=y + 0.5, line=line, fillcolor=None
        )
    return fig


def fitted(
    freqs: Sequence[Float],
    measured: Sequence[Float],
    fit: Sequence[Float],
    *,
    span: tuple[float, float],
) -> go.Figure:
    """Measured levels and what the modes explain, dB, a curve a band, over the axis of the diagram
    with this span, Hz.
    """
    wide = span[0] > 0 and span[1] / span[0] > WIDE
    across = axis("Frequency, Hz", range=[np.log10(f) if wide else f for f in span])
    across |= {"type": "log", "dtick": "D2", "tickformat": "~g"} if wide else {}
    fig = figure(260, xaxis=across, yaxis=axis("Level, dB", nticks=6))
    for name, look, levels in (
        ("measured", LOOKS["test"], measured),
        ("modes as they are chosen", {"color": FIT, "width": 1.6, "dash": "dash"}, fit),
    ):
        for k, (x, y) in enumerate(zip(freqs, levels, strict=True)):
            fig.add_scatter(x=f32(x), y=f32(y), mode="lines", line=look, name=name)
            fig.data[-1].update(legendgroup=name, showlegend=k == 0)
            fig.data[-1].hovertemplate = "%{x:.5g} Hz: %{y:.1f} dB<extra>" + name + "</extra>"
    fig.update_layout(margin={"t": 26, "l": 56, "r": 60, "b": 40})
    return fig
