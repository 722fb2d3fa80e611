"""Stabilisation diagrams as a page on which poles are picked and modes rejected: it writes the
choice as TOML.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Bool
from ringtrue.core.modes import ModeSet
from ringtrue.identification.common.poles import StableDiagram
from ringtrue.plots.identification import pole_span
from ringtrue.plots.page import figure_page
from ringtrue.plots.style import FE, QUALITATIVE, TEST, axis, f32, figure

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
    return figure_page(title, figures, before=_BEFORE, after=_AFTER, script=_SCRIPT)


def pick_figure(diagram: StableDiagram, modes: ModeSet) -> go.Figure:
    """Poles by model order as points that tell frequency, order, damping and standard deviation."""
    low, high = pole_span(diagram)
    fig = figure(
        420,
        xaxis=axis("Frequency, Hz", range=[low, high]),
        yaxis=axis("Model order", rangemode="tozero"),
        yaxis2=axis("Spectrum, dB", overlaying="y", side="right", showgrid=False),
    )
    inside = np.flatnonzero((diagram.freqs >= low) & (diagram.freqs <= high))
    inside = inside[:: max(1, inside.size // 2000)]
    grey = {"width": 1, "color": "#b4bec8"}
    x, y = f32(diagram.freqs[inside]), f32(diagram.level[inside])
    fig.add_scatter(x=x, y=y, yaxis="y2", line=grey, name="spectrum", hoverinfo="skip")
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
    fig.add_scatter(x=f, y=np.full(f.size, top), mode="markers", marker=mark, name="mode")
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
    fig.add_scatter(x=p.frequencies, y=p.order, mode="markers", marker=mark, name=name + note)
    told = np.stack(
        [p.frequencies, p.order, 100 * p.damping, np.nan_to_num(p.std_frequency)], axis=1
    )
    hover = (
        "%{x:.5f} Hz ± %{customdata[3]:.1e}, order %{y}<br>damping %{customdata[2]:.3g} %<extra>"
        + name
        + "</extra>"
    )
    fig.data[-1].update(customdata=told.tolist(), hovertemplate=hover)
