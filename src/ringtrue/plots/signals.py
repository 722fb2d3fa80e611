"""Records, spectra and frequency response functions, in the report and on screens: there any output
and input of test and models, and their FRAC over the channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.channels import FORCES, LINEAR
from ringtrue.core.signals import FrfSet
from ringtrue.correlation.frf import FrfComparison
from ringtrue.plots.style import (
    FINAL,
    INITIAL,
    QUALITATIVE,
    SEQUENTIAL,
    TEST,
    WIDE,
    above_and_below,
    axis,
    f32,
    figure,
    figure_page,
    joined,
    log_axis,
    rule,
    thinned,
    thinned_log,
)
from ringtrue.study.results import ComparedFrfs, RecordPreview

# of a driving point at resonance, degrees
PHASE = {"(m/s²)/N": 90, "(m/s)/N": 0, "m/N": -90}
_FRF_UNITS = {"accelerance": "(m/s²)/N", "mobility": "(m/s)/N", "receptance": "m/N"}


def frf_unit(data: FrfSet) -> str:
    """Of its values; of transmissibilities 1."""
    if not all(c.quantity in FORCES for c in data.inputs):
        return "1"
    turns = any(c.quantity in LINEAR for c in (*data.outputs, *data.inputs))
    return "SI" if turns else _FRF_UNITS[data.kind]


def record(preview: RecordPreview, unit: str) -> go.Figure:
    """Time previews on the left, power spectral densities on the right; `unit` of the channels,
    empty if mixed.
    """
    unit = unit or "SI unit"
    ok = preview.freqs > 0
    # the rest are not forces
    names = preview.channels[:1] if unit == "N" else preview.channels
    fig = figure(
        250,
        showlegend=True,
        xaxis=axis("Time, s", domain=[0, 0.41]),
        yaxis=axis(unit, exponentformat="power"),
        xaxis2=axis(
            "Frequency, Hz",
            type="log",
            domain=[0.59, 1],
            anchor="y2",
            dtick=1,
        ),
        yaxis2=log_axis(
            f"PSD, {unit if unit.isalpha() else f'({unit})'}²/Hz",
            anchor="x2",
            dtick=2,
            **_decades(preview.psd[: len(names)][:, ok]),
        ),
    )
    for i, name in enumerate(names):
        line = {"width": 0.9, "color": QUALITATIVE[i % 8]}
        x = f32(preview.time)
        y = f32(preview.signal[i])
        fig.add_scatter(
            x=x,
            y=y,
            name=name,
            line=line,
            legendgroup=name,
            opacity=0.85,
        )
        x, y = (f32(a) for a in thinned_log(preview.freqs[ok], preview.psd[i][ok], 500))
        fig.add_scatter(
            x=x,
            y=y,
            line=line,
            xaxis="x2",
            yaxis="y2",
            legendgroup=name,
            showlegend=False,
            name=name,
        )
    return fig


def _decades(psd: Float) -> dict[str, list[float]]:
    """A range of at most ten decades below the peak: the roll-off of a filter is not what the
    reader looks for.
    """
    if not psd.size or not psd.max() > 0:
        return {}
    top = float(np.log10(psd.max()))
    low = float(np.log10(max(psd[psd > 0].min(), 10 ** (top - 10))))
    return {"range": [low - 0.3, top + 0.4]}


def frfs(data: FrfSet, cmif: Float, marks: Float, top: float = np.inf) -> go.Figure:
    """Imaginary parts of all FRFs over one another, the CMIF below, up to `top` Hz; `marks` (m,) Hz
    are modes.
    """
    shown = data.freqs <= top
    fig = figure(
        560,
        xaxis=axis(
            domain=[0, 1],
            anchor="y",
            matches="x2",
            showticklabels=False,
        ),
        yaxis=axis(f"Im H, {frf_unit(data)}", domain=[0.5, 1], exponentformat="power"),
        xaxis2=axis("Frequency, Hz", anchor="y2"),
        yaxis2=log_axis(
            f"CMIF, {frf_unit(data)}",
            domain=[0, 0.44],
            anchor="x2",
            dtick=1,
        ),
    )
    for j, c in enumerate(data.inputs):
        at, imaginary = thinned(data.data[shown, :, j].imag.T, 600)
        x, y = joined(data.freqs[shown][at], imaginary)
        line = {"width": 0.6, "color": QUALITATIVE[j % 8]}
        fig.add_scatter(
            x=x,
            y=y,
            line=line,
            opacity=0.65,
            name=f"force at {c.id}" if c.quantity == "force" else c.id,
            hoverinfo="skip",
        )
        fig.data[-1].meta = {"overlay": data.data.shape[1]}
    for j in range(cmif.shape[1]):
        at, y = thinned(cmif[shown, j][None], 1500)
        line = {"width": 1.4 if j == 0 else 1.0, "color": QUALITATIVE[j % 8]}
        x = f32(data.freqs[shown][at])
        fig.add_scatter(
            x=x,
            y=f32(y[0]),
            line=line,
            xaxis="x2",
            yaxis="y2",
            name=f"σ{j + 1}",
            showlegend=False,
        )
    faint = {"width": 0.8, "color": "#8b97a3", "dash": "dot"}
    fig.update_layout(
        shapes=[
            rule(f, 0.44, xref="x2", line=faint) for f in marks[marks <= top].tolist()
        ]
    )
    return fig


def frf_pair(frfs: ComparedFrfs, k: int, unit: str) -> go.Figure:
    """One measured FRF with the model's before and after, modulus and phase."""
    middle = PHASE.get(unit, 0)
    fig = _modulus_and_phase(
        300,
        unit,
        [middle - 180, middle, middle + 180],
        title={
            "text": frfs.channels[k],
            "x": 0.99,
            "xanchor": "right",
            "y": 0.97,
            "font": {"size": 13},
        },
    )
    low = middle - 180
    for name, h, color, width in (
        ("initial model", frfs.initial, INITIAL, 1.2),
        ("test", frfs.test, TEST, 1.2),
        ("final model", frfs.final, FINAL, 1.6),
    ):
        line = {"color": color, "width": width}
        modulus = np.maximum(np.abs(h[:, k]), 1e-300)
        phase = (np.degrees(np.angle(h[:, k])) - low) % 360 + low
        above_and_below(fig, name, line, x=frfs.freqs, upper=modulus, lower=phase)
    return fig


def frf_page(title: str, data: FrfSet) -> str:
    """A self-contained page: a figure a force, with the responses to it over one another."""
    drawn = [
        (f"Force at {c.id}", responses(data, j)) for j, c in enumerate(data.inputs)
    ]
    return figure_page(f"{title}: {data.kind}", drawn)


def responses(data: FrfSet, column: int) -> go.Figure:
    """Modulus above and phase below of all responses to one force."""
    fig = _modulus_and_phase(
        520, frf_unit(data), [-180, -90, 0, 90, 180], showlegend=True
    )
    for i, c in enumerate(data.outputs):
        h = data.data[:, i, column]
        line = {"width": 1.3, "color": QUALITATIVE[i % 8]}
        size = np.where(h == 0, np.nan, np.abs(h))
        phase = np.degrees(np.angle(h))
        above_and_below(fig, c.id, line, x=data.freqs, upper=size, lower=phase)
    return fig


def _modulus_and_phase(
    height: int, unit: str, ticks: list[int], **layout: Any
) -> go.Figure:
    """A figure for the moduli of FRFs above and their phases, with ticks in degrees, below."""
    return figure(
        height,
        xaxis=axis(anchor="y", matches="x2", showticklabels=False),
        yaxis=log_axis(f"|H|, {unit}", domain=[0.36, 1], dtick=1),
        xaxis2=axis("Frequency, Hz", anchor="y2"),
        yaxis2=axis(
            "Phase, °",
            domain=[0, 0.28],
            anchor="x2",
            tickvals=ticks,
            range=[ticks[0] - 10, ticks[-1] + 10],
        ),
        **layout,
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


def frf(
    curves: Sequence[Curve], unit: str, marks: Marks, *, parts: bool = False
) -> go.Figure:
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
        else axis(
            "Phase, °", tickvals=ticks, range=[ticks[0] - 10, ticks[-1] + 10], **lower
        ),
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
            shared = {
                "x": f32(c.freqs),
                "mode": "lines",
                "line": look,
                "legendgroup": name,
            }
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
    shapes = [
        rule(f, xref="x2", line=MODE) for f in marks.modes[marks.modes < top].tolist()
    ]
    if marks.selected is not None and marks.selected < top:
        shapes.append(rule(marks.selected, xref="x2", line=SELECTED))
    for x0, x1 in ((0.0, marks.band[0]), (marks.band[1], top)) if marks.band else ():
        if x1 > x0:
            ends = {
                "x0": x0,
                "x1": x1,
                "xref": "x2",
                "line": {"width": 0},
                "opacity": 0.12,
            }
            shapes.append(OUTSIDE | ends)
    return shapes


def frac_map(
    found: FrfComparison, selected: tuple[str, str] | None = None
) -> go.Figure:
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
    if (
        selected is not None
        and selected[0] in found.outputs
        and selected[1] in found.inputs
    ):
        x, y = found.outputs.index(selected[0]), found.inputs.index(selected[1])
        line = {"color": QUALITATIVE[4], "width": 2.5}
        fig.add_shape(
            type="rect",
            x0=x - 0.5,
            x1=x + 0.5,
            y0=y - 0.5,
            y1=y + 0.5,
            line=line,
            fillcolor=None,
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
            fig.data[-1].hovertemplate = (
                "%{x:.5g} Hz: %{y:.1f} dB<extra>" + name + "</extra>"
            )
    fig.update_layout(margin={"t": 26, "l": 56, "r": 60, "b": 40})
    return fig
