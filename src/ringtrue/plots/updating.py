"""Sensitivities, convergence and parameters."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Float
from ringtrue.plots.style import DIVERGING, MUTED, QUALITATIVE, axis, f32, figure
from ringtrue.study.results import SensitivityStage, SetResult


def sensitivity(stage: SensitivityStage, values: Float, name: str, modes: Float) -> go.Figure:
    """Heat map of one (mode, candidate) table; `modes` (mode,) Hz, `name` with its unit."""
    peak = float(np.nanmax(np.abs(values), initial=1e-12))
    y = [
        f"{i + 1}: {f:.2f} Hz" for i, f in zip(stage.fe_modes.tolist(), modes.tolist(), strict=True)
    ]
    fig = figure(
        120 + 17 * len(y) + 90,
        xaxis=axis(tickangle=-45, side="bottom", showgrid=False, showline=False, ticks=""),
        yaxis=axis(
            "FE mode",
            autorange="reversed",
            showgrid=False,
            showline=False,
            ticks="",
            tickfont={"size": 11},
        ),
    )
    bar = {
        "title": {"text": name, "side": "top", "font": {"size": 11}},
        "thickness": 12,
        "outlinewidth": 0,
    }
    fig.add_heatmap(
        z=f32(values),
        x=list(stage.names),
        y=y,
        zmin=-peak,
        zmax=peak,
        colorscale=DIVERGING,
        colorbar=bar,
        xgap=1,
        ygap=1,
    )
    fig.data[0].hovertemplate = "mode %{y}<br>%{x}<br>%{z:.3f}<extra></extra>"
    fig.layout.margin.t = 10
    return fig


def _whole(count: int, most: int) -> dict[str, object]:
    """An axis of `count` iterations with at most about `most` whole ticks."""
    step = next((d for d in (1, 2, 5, 10, 20, 50) if count <= d * most), 100)
    return {"dtick": step, "tick0": 0, "range": [-0.03 * count - 0.2, count - 0.8 + 0.03 * count]}


def convergence(sets: tuple[SetResult, ...], chosen: int) -> go.Figure:
    """Objective, mean |Δf| and mean subspace MAC by iteration for every set."""
    seen = any(np.isfinite(s.subspace_mac).any() for s in sets)
    thirds = ([0, 0.25], [0.375, 0.625], [0.75, 1.0]) if seen else ([0, 0.44], [0.56, 1.0])
    titles = ("Objective J, relative to the start", "Mean |Δf|, %", "Mean subspace MAC, %")[
        : len(thirds)
    ]
    fig = figure(300)
    longest = max((s.objective.size for s in sets), default=1)
    for k, (domain, title) in enumerate(zip(thirds, titles, strict=True), start=1):
        n = "" if k == 1 else str(k)
        fig.layout[f"xaxis{n}"] = axis(
            "Iteration", domain=domain, anchor=f"y{n}", **_whole(longest, 7)
        )
        fig.layout[f"yaxis{n}"] = axis(title, anchor=f"x{n}")
    fig.layout.yaxis.update(type="log", exponentformat="power", dtick=1, tickfont={"size": 10})
    for i, s in enumerate(sets):
        look = {"color": QUALITATIVE[i % 8], "width": 2.6 if i == chosen else 1.4}
        name = s.name + (" (chosen)" if i == chosen else "")
        start = s.objective[0] if s.objective.size and s.objective[0] > 0 else 1.0
        for k, y in enumerate(
            (s.objective / start, s.deviation, s.subspace_mac)[: len(thirds)], start=1
        ):
            n = "" if k == 1 else str(k)
            x = np.arange(y.size)
            fig.add_scatter(
                x=x, y=f32(y), line=look, mode="lines+markers", marker={"size": 5}, name=name
            )
            fig.data[-1].update(xaxis=f"x{n}", yaxis=f"y{n}", legendgroup=name, showlegend=k == 1)
    return fig


def factor_ticks(low: float, high: float) -> list[float]:
    """Round factors from `low` to `high`: equal steps within a factor of two, else 1, 2, 3, 5, 7 of
    each decade.
    """
    if high > 2 * low:
        return [m * 10.0**k for k in range(-3, 4) for m in (1, 2, 3, 5, 7)]
    step = next(
        s for s in (m * 10.0**k for k in range(-4, 4) for m in (1, 2, 5)) if high - low <= 8 * s
    )
    return [k * step for k in range(int(np.ceil(low / step)), int(high / step) + 1)]


def path(result: SetResult) -> go.Figure:
    """Factors of the parameters by iteration, with one standard deviation at the end."""
    end, spread = result.path[-1], np.nan_to_num(result.path[-1] * result.std)
    shown = np.concatenate([result.path.ravel(), end - spread, end + spread])
    ticks = factor_ticks(max(float(shown.min(initial=1.0)), 1e-3), float(shown.max(initial=1.0)))
    fig = figure(
        320,
        xaxis=axis("Iteration", **_whole(result.path.shape[0], 18)),
        yaxis=axis("Updated / initial", type="log"),
    )
    fig.layout.yaxis.update(tickvals=ticks, ticktext=[f"{t:.6g}" for t in ticks])
    one = {
        "type": "line",
        "xref": "paper",
        "x0": 0,
        "x1": 1,
        "y0": 1,
        "y1": 1,
        "line": {"color": MUTED, "width": 1},
    }
    fig.update_layout(shapes=[one])
    for j, name in enumerate(result.parameters):
        bar = np.zeros(result.path.shape[0])
        bar[-1] = result.path[-1, j] * result.std[j]
        fig.add_scatter(
            x=np.arange(bar.size),
            y=f32(result.path[:, j]),
            name=name,
            mode="lines+markers",
            marker={"size": 5, "symbol": j % 6},
            line={"color": QUALITATIVE[j % 8], "width": 1.8},
            error_y={"type": "data", "array": f32(bar), "thickness": 1.2, "width": 5},
        )
    return fig
