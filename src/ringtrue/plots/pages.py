"""Self-contained HTML pages of figures: any ones, and responses."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from ringtrue.core.signals import FrfSet
from ringtrue.plots.signals import frf_unit
from ringtrue.plots.style import (
    FONT,
    INK,
    QUALITATIVE,
    above_and_below,
    axis,
    figure,
    log_axis,
)
from ringtrue.viewer.encoding import script_json

_PAGE_STYLE = (
    f"body{{font-family:{FONT};color:{INK};max-width:80rem;margin:1rem auto;padding:0 1rem}}"
    "pre{background:#f4f6f8;padding:.8rem;white-space:pre-wrap}h2{font-size:1rem;margin:1rem 0 0}"
)
_DRAW = """
for (const [i, spec] of figures.entries())
  Plotly.newPlot('figure-' + i, spec.data, spec.layout, {responsive: true, displaylogo: false});
"""


def figure_page(
    title: str,
    figures: Sequence[tuple[str, go.Figure]],
    *,
    before: str = "",
    after: str = "",
    script: str = "",
) -> str:
    """The page: a title, the figures each under its own heading, and the script library inside.

    Parameters
    ----------
    title : str
    figures : sequence of (heading, figure)
        Drawn into the elements `figure-0`, `figure-1`, ...
    before, after : str
        HTML above and below the figures.
    script : str
        Runs after the figures are drawn.
    """
    specs = "[" + ",".join(str(f.to_json()) for _, f in figures) + "]"
    divs = "".join(
        f'<h2>{html.escape(h)}</h2><div id="figure-{i}"></div>' for i, (h, _) in enumerate(figures)
    )
    name = html.escape(title)
    return (
        '<!doctype html><html lang="en"><head><meta '
        f'charset="utf-8"><title>{name}</title><style>{_PAGE_STYLE}</style>'
        f"<script>{get_plotlyjs()}</script></head><body><h1>{name}</h1>{before}{divs}{after}"
        f"<script>const figures = {script_json(specs)};{_DRAW}{script}</script></body></html>\n"
    )


def frf_page(title: str, data: FrfSet) -> str:
    """A self-contained page: a figure a force, with the responses to it over one another."""
    drawn = [(f"Force at {c.id}", responses(data, j)) for j, c in enumerate(data.inputs)]
    return figure_page(f"{title}: {data.kind}", drawn)


def responses(data: FrfSet, column: int) -> go.Figure:
    """Modulus above and phase below of all responses to one force."""
    fig = figure(
        520,
        showlegend=True,
        xaxis=axis(
            anchor="y",
            matches="x2",
            showticklabels=False,
        ),
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
    for i, c in enumerate(data.outputs):
        h = data.data[:, i, column]
        line = {"width": 1.3, "color": QUALITATIVE[i % 8]}
        size = np.where(h == 0, np.nan, np.abs(h))
        phase = np.degrees(np.angle(h))
        above_and_below(
            fig,
            c.id,
            line,
            x=data.freqs,
            upper=size,
            lower=phase,
        )
    return fig
