"""Where a model is wrong: errors by region, and the support of a proposal by its size."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from ringtrue.plots.scene import View, painted
from ringtrue.plots.style import FE, MUTED, TEST, axis, f32, figure
from ringtrue.study.results import LocaliseStage, Scene

BARS, TOLD = 40, 8  # regions with a bar, and in the key of the model
COLD, WARM, HOT = "#d9e0e6", "#e9a95f", "#a8320a"
EVEN, MOST = (
    1.0,
    4.0,
)  # times the share of strain energy: an error that is spread evenly, and the end of the colours


def color(value: float) -> str:
    """Grey up to an even spread, then from amber to red."""
    if not np.isfinite(value) or value <= EVEN:
        return _mix(COLD, WARM, max((np.nan_to_num(value) - 0.5) / (EVEN - 0.5), 0.0) * 0.35)
    t = min((value - EVEN) / (MOST - EVEN), 1.0)
    return _mix(WARM, HOT, t)


def _mix(a: str, b: str, t: float) -> str:
    one, two = (np.array([int(c[i : i + 2], 16) for i in (1, 3, 5)]) for c in (a, b))
    return "#" + "".join(f"{int(x):02x}" for x in np.round(one + t * (two - one)))


def regions(stage: LocaliseStage) -> go.Figure:
    """Bars of the concentration of error by region, the largest on top; `BARS` at most."""
    value = stage.concentration
    order = [
        i for i in np.argsort(np.nan_to_num(value), kind="stable").tolist() if np.isfinite(value[i])
    ][-BARS:]
    names = [stage.regions[i] for i in order]
    fig = figure(
        max(220, 70 + 19 * len(order)),
        xaxis=axis("Share of error over share of strain energy", rangemode="tozero"),
        yaxis=axis("", type="category", showgrid=False, ticks="", tickfont={"size": 11}),
    )
    marker = {
        "color": [color(float(value[i])) for i in order],
        "line": {"width": 0.5, "color": MUTED},
    }
    extra = np.stack([100 * stage.constitutive[order], 100 * stage.strain[order]], axis=1)
    fig.add_bar(
        x=f32(value[order]),
        y=names,
        orientation="h",
        marker=marker,
        customdata=f32(extra),
        showlegend=False,
    )
    fig.data[
        0
    ].hovertemplate = (
        "%{y}: %{x:.2f}<br>%{customdata[0]:.1f} % of the error, %{customdata[1]:.1f} % of "
    )
    fig.data[0].hovertemplate += "the strain energy<extra></extra>"
    fig.update_layout(margin={"t": 10}, shapes=[_line(EVEN)])
    return fig


def _line(x: float) -> dict[str, object]:
    look = {"color": MUTED, "width": 1, "dash": "dot"}
    return {"type": "line", "x0": x, "x1": x, "yref": "paper", "y0": 0, "y1": 1, "line": look}


def view(scene: Scene, stage: LocaliseStage) -> View:
    """The model with its regions in the colours of `regions`, whose bars name them; `TOLD` in the
    key.
    """
    value = dict(zip(stage.regions, stage.concentration.tolist(), strict=True))
    found = [value.get(g, np.nan) for g in scene.groups]
    strong = sorted((g for g in scene.groups if value.get(g, 0.0) > EVEN), key=lambda g: -value[g])
    legend = [(g, color(value[g]), f"{value[g]:.1f} ×") for g in strong[:TOLD]]
    return painted(
        scene, [color(x) for x in found], [1.0 if x > EVEN else 0.35 for x in found], legend
    )


def sizes(stage: LocaliseStage) -> go.Figure:
    """The criterion of the best set of each size; the least is the proposal before its members are
    tested.
    """
    p = stage.proposal
    fig = figure(260, xaxis=axis("Parameters", dtick=1), yaxis=axis("AICc + price of the search"))
    best = int(np.argmin(p.criteria))
    marks = {"size": 8, "color": [TEST if i == best else FE for i in range(p.sizes.size)]}
    fig.add_scatter(
        x=p.sizes,
        y=f32(p.criteria),
        mode="lines+markers",
        line={"color": FE, "width": 1.4},
        marker=marks,
    )
    fig.update_layout(margin={"t": 10}, showlegend=False)
    return fig
