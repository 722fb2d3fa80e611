"""Modes through time."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Float
from ringtrue.identification.common.tracking import ModeTrack, Tracked
from ringtrue.plots.pages import figure_page
from ringtrue.plots.style import QUALITATIVE, axis, f32, figure


def tracking_page(
    title: str,
    tracked: Tracked,
    notes: Sequence[str] = (),
) -> str:
    """A self-contained page: frequencies and damping ratios of all modes through time.

    Parameters
    ----------
    title : str
    tracked : Tracked
    notes : sequence of str
    """
    drawn = [
        ("Frequencies through time", frequencies(tracked)),
        ("Damping through time", dampings(tracked)),
    ]
    items = "".join(f"<li>{html.escape(n)}</li>" for n in notes)
    return figure_page(title, drawn, after=f"<h2>Notes</h2><ul>{items}</ul>" if items else "")


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
        _series(
            fig,
            tracked,
            t=t,
            y=t.frequency,
            std=t.std_frequency,
            color=QUALITATIVE[i % 8],
            name=f"mode {t.name}",
        )
    return fig


def dampings(tracked: Tracked) -> go.Figure:
    """Damping ratios over time with one standard deviation."""
    fig = figure(340, xaxis=axis("Time, h"), yaxis=axis("Damping ratio, %", rangemode="tozero"))
    for i, t in enumerate(tracked.tracks):
        _series(
            fig,
            tracked,
            t=t,
            y=100 * t.damping,
            std=100 * t.std_damping,
            color=QUALITATIVE[i % 8],
            name=f"mode {t.name}",
        )
    return fig
