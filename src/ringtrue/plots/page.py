"""One self-contained HTML page of figures."""

from __future__ import annotations

import html
from collections.abc import Sequence

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from ringtrue.plots.embedded import script_json
from ringtrue.plots.style import FONT, INK

_STYLE = (
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
        f'charset="utf-8"><title>{name}</title><style>{_STYLE}</style>'
        f"<script>{get_plotlyjs()}</script></head><body><h1>{name}</h1>{before}{divs}{after}"
        f"<script>const figures = {script_json(specs)};{_DRAW}{script}</script></body></html>\n"
    )
