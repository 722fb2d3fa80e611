"""Frequency responses of a model: modulus and phase of each."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.signals import FrfSet
from ringtrue.plots.page import figure_page
from ringtrue.plots.signals import frf_unit
from ringtrue.plots.style import QUALITATIVE, axis, f32, figure, log_axis


def frf_page(title: str, data: FrfSet) -> str:
    """A self-contained page: a figure a force, with the responses to it over one another."""
    drawn = [(f"Force at {c.id}", responses(data, j)) for j, c in enumerate(data.inputs)]
    return figure_page(f"{title}: {data.kind}", drawn)


def responses(data: FrfSet, column: int) -> go.Figure:
    """Modulus above and phase below of all responses to one force."""
    fig = figure(
        520,
        showlegend=True,
        xaxis=axis(anchor="y", matches="x2", showticklabels=False),
        yaxis=log_axis(f"|H|, {frf_unit(data)}", domain=[0.36, 1], dtick=1),
        xaxis2=axis("Frequency, Hz", anchor="y2"),
        yaxis2=axis(
            "Phase, °",
            domain=[0, 0.28],
            anchor="x2",
            tickvals=[-180, -90, 0, 90, 180],
            range=[-190, 190],
        ),
    )
    x = f32(data.freqs)
    for i, c in enumerate(data.outputs):
        h, line = data.data[:, i, column], {"width": 1.3, "color": QUALITATIVE[i % 8]}
        size = np.where(h == 0, np.nan, np.abs(h))
        fig.add_scatter(x=x, y=f32(size), name=c.id, line=line, legendgroup=c.id)
        y = f32(np.degrees(np.angle(h)))
        fig.add_scatter(
            x=x,
            y=y,
            name=c.id,
            line=line,
            legendgroup=c.id,
            showlegend=False,
            xaxis="x2",
            yaxis="y2",
        )
    return fig
