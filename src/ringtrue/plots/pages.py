"""Self-contained HTML pages of figures: poles to pick, responses."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from ringtrue.core.arrays import Bool
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import FrfSet
from ringtrue.identification.common.stabilisation import StableDiagram
from ringtrue.plots.identification import pole_span, spectrum
from ringtrue.plots.signals import frf_unit
from ringtrue.plots.style import (
    FE,
    FONT,
    INK,
    QUALITATIVE,
    TEST,
    above_and_below,
    axis,
    figure,
    log_axis,
)
from ringtrue.viewer.view import script_json

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


MOST = 4000  # poles of one kind in one diagram; beyond it every n-th is drawn

_BEFORE = (
    "<p>A click on a pole picks it, a click on a mode (triangle) rejects it; a second click "
    "takes it back. "
    "Store the text below and replay it with <code>--choice FILE</code>.</p>"
)
_AFTER = (
    '<h2>Choice</h2><p><button id="copy">Copy</button> <button id="save">Save '
    "choice.toml</button></p>"
    '<pre id="choice"></pre>'
)
_SCRIPT = """
const picks = new Map(), rejects = new Map();
const number = (x) => String(Number(x.toPrecision(9)));
const text = () => {
  let out = 'automatic = true\\n';
  const entry = (kind, f, rest) => `\\n[[${kind}]]\\nfrequency = ${number(f)}\\n${rest}\\n`;
  for (const [f, order] of picks.values()) out += entry('pick', f, `order = ${order}`);
  for (const f of rejects.values()) out += entry('reject', f, 'reason = "rejected on the diagram"');
  return out;
};
const show = () => { document.getElementById('choice').textContent = text(); };
const toggle = (map, key, value) => { map.has(key) ? map.delete(key) : map.set(key, value); show(); };
for (const i of figures.keys()) {
  document.getElementById('figure-' + i).on('plotly_click', (event) => {
    const p = event.points[0];
    if (!p.customdata) return;
    const [f, order] = p.customdata;
    order > 0 ? toggle(picks, f + '@' + order, [f, order]) : toggle(rejects, String(f), f);
  });
}
document.getElementById('copy').onclick = () => navigator.clipboard.writeText(text());
document.getElementById('save').onclick = () => {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(new Blob([text()], {type: 'text/plain'}));
  link.download = 'choice.toml';
  link.click();
};
show();
"""


def picker_page(title: str, diagrams: Sequence[StableDiagram], modes: ModeSet) -> str:
    """One self-contained HTML page: a click on a pole picks it, a click on a mode rejects it, a
    second one undoes it.

    Parameters
    ----------
    title : str
    diagrams : sequence of StableDiagram
    modes : ModeSet
        The automatic modes, drawn as triangles.
    """
    drawn = [d for d in diagrams if len(d.poles)]
    figures = [("{:.4g} to {:.4g} Hz".format(*pole_span(d)), pick_figure(d, modes)) for d in drawn]
    return figure_page(
        title,
        figures,
        before=_BEFORE,
        after=_AFTER,
        script=_SCRIPT,
    )


def pick_figure(diagram: StableDiagram, modes: ModeSet) -> go.Figure:
    """Poles by model order as points that tell frequency, order, damping and standard deviation."""
    low, high = pole_span(diagram)
    fig = spectrum(diagram, (low, high), 420, points=2000)
    taken = diagram.cluster >= 0
    for name, which, color, size in (
        ("unstable pole", ~diagram.stable & ~taken, "#c9bfae", 4),
        ("stable pole", diagram.stable & ~taken, QUALITATIVE[5], 5),
        ("pole taken into a mode", taken, FE, 6),
    ):
        _poles(fig, diagram, which, name, {"color": color, "size": size})
    f = modes.band(low, high).frequencies
    top = 1.05 * float(diagram.poles.order.max(initial=1))
    mark = {"symbol": "triangle-down", "size": 11, "color": TEST}
    order = np.zeros(f.size)
    fig.add_scatter(
        x=f,
        y=np.full(f.size, top),
        mode="markers",
        marker=mark,
        name="mode",
    )
    fig.data[-1].update(
        customdata=np.stack([f, order], axis=1).tolist(),
        hovertemplate="mode, %{x:.5f} Hz<extra></extra>",
    )
    return fig


def _poles(
    fig: go.Figure, diagram: StableDiagram, which: Bool, name: str, mark: dict[str, object]
) -> None:
    at = np.flatnonzero(which)
    every = -(-at.size // MOST) or 1
    p = diagram.poles.take(at[::every])
    note = f" (one in {every} drawn)" if every > 1 else ""
    fig.add_scatter(
        x=p.frequencies,
        y=p.order,
        mode="markers",
        marker=mark,
        name=name + note,
    )
    hover_data = np.stack(
        [p.frequencies, p.order, 100 * p.damping, np.nan_to_num(p.std_frequency)], axis=1
    )
    hover = (
        "%{x:.5f} Hz ± %{customdata[3]:.1e}, order %{y}<br>damping %{customdata[2]:.3g} %<extra>"
        + name
        + "</extra>"
    )
    fig.data[-1].update(customdata=hover_data.tolist(), hovertemplate=hover)


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
