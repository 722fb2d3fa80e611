"""Colours, fonts and the common layout of all figures, and self-contained HTML pages of them."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from ringtrue.core.arrays import Any_, Float
from ringtrue.viewer.scene import script_json

FONT = (
    "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
)
INK = "#1c2733"
MUTED = "#5c6b7a"
GRID = "#e3e8ed"
PAPER = "#ffffff"
TEST = "#d55e00"
FE = "#24527a"
INITIAL = "#9aa5b1"
REMODELLED = "#e0a526"
FINAL = "#0b7a75"
# Okabe and Ito (2008), ordered for use on white: distinguishable under all common colour blindness.
QUALITATIVE = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#7a5c3e",
    "#5c6b7a",
)
WIDE = 20  # highest over lowest frequency, from where on an axis is logarithmic
SEQUENTIAL = (
    (0.0, "#ffffff"),
    (0.25, "#d5e5ee"),
    (0.5, "#86b6cc"),
    (0.75, "#2f7ba3"),
    (1.0, "#0d3b5c"),
)
DIVERGING = (
    (0.0, "#8c4a00"),
    (0.25, "#e3a458"),
    (0.5, "#f7f7f5"),
    (0.75, "#7fa9cf"),
    (1.0, "#1d4f86"),
)


def axis(title: str = "", **more: Any) -> dict[str, Any]:
    """An axis with the house look."""
    look = {
        "title": {"text": title, "standoff": 8, "font": {"size": 12, "color": MUTED}},
        "gridcolor": GRID,
        "zeroline": False,
        "linecolor": "#aab4be",
        "ticks": "outside",
        "ticklen": 4,
        "tickcolor": "#aab4be",
        "showline": True,
        "automargin": True,
    }
    return look | more


def log_axis(title: str = "", **more: Any) -> dict[str, Any]:
    """A logarithmic axis with powers of ten."""
    return (
        axis(
            title,
            type="log",
            exponentformat="power",
            tickfont={"size": 10},
        )
        | more
    )


def hertz() -> dict[str, Any]:
    """A logarithmic axis of frequencies with 1, 2 and 5 of each decade written out."""
    values = [m * 10.0**k for k in range(-3, 6) for m in (1, 2, 5)]
    return axis(
        "Frequency, Hz",
        type="log",
        tickvals=values,
        ticktext=[f"{v:g}" for v in values],
    )


def figure(height: int = 340, **layout: Any) -> go.Figure:
    """An empty figure in the house look; width is left to the page."""
    base = {
        "template": {},
        "height": height,
        "autosize": True,
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": PAPER,
        "plot_bgcolor": PAPER,
        "margin": {"l": 56, "r": 16, "t": 34, "b": 44},
        "hoverlabel": {"font": {"family": FONT, "size": 12}},
        "legend": {
            "orientation": "h",
            "x": 0,
            "y": 1.0,
            "yanchor": "bottom",
            "xanchor": "left",
            "font": {"size": 12},
            "bgcolor": "rgba(255,255,255,0)",
        },
        "colorway": list(QUALITATIVE),
        "xaxis": axis(),
        "yaxis": axis(),
    }
    # an update of the layout takes ten times as long
    return go.Figure(layout=base | layout)


def f32(a: Any_) -> Any_:
    """Single precision: what a drawing needs, at half the size."""
    return np.asarray(a, dtype=np.float32)


def packed(a: Any_, kind: str) -> str:
    """An array as base64 of numbers of one kind, such as `<f4`."""
    return base64.b64encode(np.ascontiguousarray(a, dtype=kind).tobytes()).decode(
        "ascii"
    )


def joined(x: Float, y: Float) -> tuple[Any_, Any_]:
    """Many curves `y` (curve, k) over one `x` (k,) as one broken line: a single path draws
    quickly.
    """
    rows = y.shape[0]
    gap = np.full((rows, 1), np.nan)
    xs = np.concatenate([np.broadcast_to(x, y.shape), gap], axis=1)
    return f32(xs.ravel()), f32(np.concatenate([y, gap], axis=1).ravel())


def rule(x: float, top: float = 1.0, **more: Any) -> dict[str, Any]:
    """A dotted vertical line through a figure, up to `top` of its height."""
    line = {"color": MUTED, "width": 1, "dash": "dot"}
    ends = {"x0": x, "x1": x, "y0": 0, "y1": top}
    return {"type": "line", "yref": "paper", **ends, "line": line} | more


def above_and_below(
    fig: go.Figure,
    name: str,
    look: dict[str, Any],
    x: Float,
    upper: Float,
    lower: Float,
) -> None:
    """A curve in the upper and one in the lower half of a figure, under one name."""
    drawn = {"x": f32(x), "name": name, "line": look, "legendgroup": name}
    fig.add_scatter(y=f32(upper), **drawn)
    fig.add_scatter(
        y=f32(lower),
        xaxis="x2",
        yaxis="y2",
        showlegend=False,
        **drawn,
    )


def ticks(x: Float, low: Float, high: Float) -> tuple[Any_, Any_]:
    """Short vertical strokes at `x` (k,) from `low` to `high` (k,) as one broken line."""
    nan = np.full(x.shape, np.nan)
    return f32(np.stack([x, x, nan], 1).ravel()), f32(
        np.stack([low, high, nan], 1).ravel()
    )


def thinned_log(x: Float, y: Float, bins: int) -> tuple[Any_, Any_]:
    """One curve over a logarithmic axis, `x` (k,) > 0 ascending: the largest `y` in each of about
    `bins` equal bins.
    """
    if x.size <= bins:
        return x, y
    place = np.floor(np.log(x / x[0]) / np.log(x[-1] / x[0]) * bins)
    order = np.lexsort((-y, place))
    first = np.unique(place[order], return_index=True)[1]
    at = np.sort(order[first])
    return x[at], y[at]


def thinned(y: Float, bins: int) -> tuple[Any_, Any_]:
    """Positions (b,) and values (curve, b) of the largest |y| in each of at most `bins` equal bins:
    peaks stay.
    """
    curves, k = y.shape
    step = max(1, -(-k // bins))
    whole = k // step * step
    block = y[:, :whole].reshape(curves, -1, step)
    at = np.abs(block).argmax(axis=2)
    return np.arange(0, whole, step) + step // 2, np.take_along_axis(
        block, at[:, :, None], 2
    )[:, :, 0]


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
        f'<h2>{html.escape(h)}</h2><div id="figure-{i}"></div>'
        for i, (h, _) in enumerate(figures)
    )
    name = html.escape(title)
    return (
        '<!doctype html><html lang="en"><head><meta '
        f'charset="utf-8"><title>{name}</title><style>{_PAGE_STYLE}</style>'
        f"<script>{get_plotlyjs()}</script></head><body><h1>{name}</h1>{before}{divs}{after}"
        f"<script>const figures = {script_json(specs)};{_DRAW}{script}</script></body></html>\n"
    )
