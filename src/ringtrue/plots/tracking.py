"""Modes through time, and against what changes them."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Float
from ringtrue.identification.environment import EnvironmentFit
from ringtrue.identification.tracking import ModeTrack, Tracked
from ringtrue.plots.pages import figure_page
from ringtrue.plots.style import INITIAL, QUALITATIVE, TEST, axis, f32, figure

Units = Mapping[str, str]


def tracking_page(
    title: str,
    tracked: Tracked,
    fits: Mapping[str, EnvironmentFit],
    regressors: Mapping[str, Float],
    notes: Sequence[str] = (),
) -> str:
    """A self-contained page: all modes through time, then each with what its environment explains
    of it.

    Parameters
    ----------
    title : str
    tracked : Tracked
    fits : mapping of the name of a mode to its EnvironmentFit
    regressors : mapping of str to (k,) float64, for every stretch
    notes : sequence of str
    """
    drawn = [
        ("Frequencies through time", frequencies(tracked)),
        ("Damping through time", dampings(tracked)),
    ]
    drawn += [
        (f"Mode {t.name}", mode(tracked, t, fits[t.name], regressors))
        for t in tracked.tracks
        if t.name in fits
    ]
    told = "".join(f"<li>{html.escape(n)}</li>" for n in notes)
    return figure_page(title, drawn, after=f"<h2>Notes</h2><ul>{told}</ul>" if told else "")


def _series(
    fig: go.Figure, tracked: Tracked, t: ModeTrack, y: Float, std: Float, color: str, name: str
) -> None:
    """One mode over time, broken where it was not seen."""
    n = tracked.times.size
    value, bar = np.full(n, np.nan), np.full(n, np.nan)
    value[t.at], bar[t.at] = y, std
    error = {"type": "data", "array": f32(bar), "thickness": 1, "width": 2}
    mark, line = {"size": 5, "color": color}, {"width": 1, "color": color}
    fig.add_scatter(
        x=f32(tracked.times),
        y=value,
        error_y=error,
        mode="lines+markers",
        name=name,
        marker=mark,
        line=line,
    )


def frequencies(tracked: Tracked) -> go.Figure:
    """Frequencies over time with one standard deviation."""
    fig = figure(460, xaxis=axis("Time, h"), yaxis=axis("Frequency, Hz"))
    for i, t in enumerate(tracked.tracks):
        _series(fig, tracked, t, t.frequency, t.std_frequency, QUALITATIVE[i % 8], f"mode {t.name}")
    return fig


def dampings(tracked: Tracked) -> go.Figure:
    """Damping ratios over time with one standard deviation."""
    fig = figure(340, xaxis=axis("Time, h"), yaxis=axis("Damping ratio, %", rangemode="tozero"))
    for i, t in enumerate(tracked.tracks):
        _series(
            fig,
            tracked,
            t,
            100 * t.damping,
            100 * t.std_damping,
            QUALITATIVE[i % 8],
            f"mode {t.name}",
        )
    return fig


def mode(
    tracked: Tracked, t: ModeTrack, fit: EnvironmentFit, regressors: Mapping[str, Float]
) -> go.Figure:
    """One mode: as found and corrected over time, with outliers and changes; on the right over each
    regressor.
    """
    columns = 1 + len(fit.names)
    edges = np.linspace(0, 1, columns + 1)
    gap = 0.04 if columns > 1 else 0.0
    fig = figure(
        320, xaxis=axis("Time, h", domain=[0, edges[1] - gap]), yaxis=axis("Frequency, Hz")
    )
    _series(fig, tracked, t, t.frequency, t.std_frequency, INITIAL, "found")
    time = f32(tracked.times[t.at])
    if fit.names:
        mark = {"size": 5, "color": TEST}
        fig.add_scatter(x=time, y=fit.corrected, mode="markers", marker=mark, name="corrected")
    if fit.outlier.any():
        mark = {"size": 10, "symbol": "circle-open", "color": "#b00020"}
        x, y = time[fit.outlier], t.frequency[fit.outlier]
        fig.add_scatter(x=x, y=y, mode="markers", marker=mark, name="outlier")
    for change in fit.changes:
        fig.add_vline(x=float(time[change.at]), line={"dash": "dot", "color": "#b00020"})
    for j, name in enumerate(fit.names):
        k = str(j + 2)
        place = {
            "domain": [float(edges[j + 1]) + gap / 2, float(edges[j + 2]) - gap / 2],
            "anchor": f"y{k}",
        }
        fig.update_layout(
            {f"xaxis{k}": axis(name, **place), f"yaxis{k}": axis("", anchor=f"x{k}", matches="y")}
        )
        x = regressors[name][t.at]
        mark = {"size": 5, "color": INITIAL}
        axes = {"xaxis": f"x{k}", "yaxis": f"y{k}", "showlegend": False}
        fig.add_scatter(x=f32(x), y=t.frequency, mode="markers", marker=mark, name=name, **axes)
        if np.isfinite(fit.slope[j]) and np.isfinite(x).any():
            ends = np.array([np.nanmin(x), np.nanmax(x)])
            y = fit.reference + fit.slope[j] * (ends - fit.centre[j])
            fig.add_scatter(
                x=ends, y=y, mode="lines", line={"color": TEST, "width": 1.5}, name="fit", **axes
            )
    return fig
