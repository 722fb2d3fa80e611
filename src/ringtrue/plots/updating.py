"""Localisation, parameter sets, convergence, and how well the parameters are known."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Float
from ringtrue.plots.scene import painted
from ringtrue.plots.style import (
    DIVERGING,
    FE,
    FINAL,
    INITIAL,
    MUTED,
    QUALITATIVE,
    TEST,
    axis,
    f32,
    figure,
    rule,
)
from ringtrue.study.results import (
    LocaliseStage,
    Scene,
    SensitivityStage,
    SetResult,
    UncertaintyStage,
)
from ringtrue.viewer.scene import View


def sensitivity(
    stage: SensitivityStage, values: Float, name: str, modes: Float
) -> go.Figure:
    """Heat map of one (mode, candidate) table; `modes` (mode,) Hz, `name` with its unit."""
    peak = float(np.nanmax(np.abs(values), initial=1e-12))
    y = [f"{i + 1}: {f:.2f} Hz" for i, f in zip(stage.fe_modes, modes, strict=True)]
    fig = figure(
        120 + 17 * len(y) + 90,
        xaxis=axis(
            tickangle=-45,
            side="bottom",
            showgrid=False,
            showline=False,
            ticks="",
        ),
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
    return {
        "dtick": step,
        "tick0": 0,
        "range": [-0.03 * count - 0.2, count - 0.8 + 0.03 * count],
    }


def convergence(sets: tuple[SetResult, ...], chosen: int) -> go.Figure:
    """Objective, mean |Δf| and mean subspace MAC by iteration for every set."""
    seen = any(np.isfinite(s.history.subspace_mac).any() for s in sets)
    thirds = (
        ([0, 0.25], [0.375, 0.625], [0.75, 1.0]) if seen else ([0, 0.44], [0.56, 1.0])
    )
    titles = (
        "Objective J, relative to the start",
        "Mean |Δf|, %",
        "Mean subspace MAC, %",
    )
    fig = figure(300)
    longest = max((s.history.objective.size for s in sets), default=1)
    numbers = ("", "2", "3")
    for n, domain, title in zip(numbers, thirds, titles, strict=False):
        fig.layout[f"xaxis{n}"] = axis(
            "Iteration", domain=domain, anchor=f"y{n}", **_whole(longest, 7)
        )
        fig.layout[f"yaxis{n}"] = axis(title, anchor=f"x{n}")
    fig.layout.yaxis.update(
        type="log",
        exponentformat="power",
        dtick=1,
        tickfont={"size": 10},
    )
    for i, s in enumerate(sets):
        look = {"color": QUALITATIVE[i % 8], "width": 2.6 if i == chosen else 1.4}
        name = s.name + (" (chosen)" if i == chosen else "")
        h = s.history
        start = float(h.objective[0]) if h.objective.size else 0.0
        curves = (
            h.objective / (start if start > 0 else 1.0),
            h.deviation,
            h.subspace_mac,
        )
        for n, y, _ in zip(numbers, curves, thirds, strict=False):
            x = np.arange(y.size)
            fig.add_scatter(
                x=x,
                y=f32(y),
                line=look,
                mode="lines+markers",
                marker={"size": 5},
                name=name,
            )
            fig.data[-1].update(
                xaxis=f"x{n}",
                yaxis=f"y{n}",
                legendgroup=name,
                showlegend=not n,
            )
    return fig


def factor_ticks(low: float, high: float) -> list[float]:
    """Round factors from `low` to `high`: equal steps within a factor of two, else 1, 2, 3, 5, 7 of
    each decade.
    """
    if high > 2 * low:
        return [m * 10.0**k for k in range(-3, 4) for m in (1, 2, 3, 5, 7)]
    step = next(
        s
        for s in (m * 10.0**k for k in range(-4, 4) for m in (1, 2, 5))
        if high - low <= 8 * s
    )
    return [k * step for k in range(int(np.ceil(low / step)), int(high / step) + 1)]


def path(result: SetResult) -> go.Figure:
    """Factors of the parameters by iteration, with one standard deviation at the end."""
    path = result.history.path
    spread = path[-1] * result.std
    reach = np.nan_to_num(spread)
    shown = np.concatenate([path.ravel(), path[-1] - reach, path[-1] + reach])
    ticks = factor_ticks(
        max(shown.min(initial=1.0), 1e-3), float(shown.max(initial=1.0))
    )
    fig = figure(
        320,
        xaxis=axis("Iteration", **_whole(len(path), 18)),
        yaxis=axis("Updated / initial", type="log"),
    )
    fig.layout.yaxis.update(tickvals=ticks, ticktext=[f"{t:.6g}" for t in ticks])
    fig.add_hline(1, line={"color": MUTED, "width": 1})
    for j, name in enumerate(result.parameters):
        bar = np.zeros(len(path))
        bar[-1] = spread[j]
        fig.add_scatter(
            x=np.arange(bar.size),
            y=f32(path[:, j]),
            name=name,
            mode="lines+markers",
            marker={"size": 5, "symbol": j % 6},
            line={"color": QUALITATIVE[j % 8], "width": 1.8},
            error_y={"type": "data", "array": f32(bar), "thickness": 1.2, "width": 5},
        )
    return fig


# regions with a bar, and in the key of the model
BARS = 40
TOLD = 8
COLD = "#d9e0e6"
WARM = "#e9a95f"
HOT = "#a8320a"
# times the share of strain energy: an error that is spread evenly, and the end of the colours
EVEN = 1.0
MOST = 4.0


def color(value: float) -> str:
    """Grey up to an even spread, then from amber to red."""
    if not np.isfinite(value) or value <= EVEN:
        return _mix(
            COLD, WARM, max((np.nan_to_num(value) - 0.5) / (EVEN - 0.5), 0.0) * 0.35
        )
    t = min((value - EVEN) / (MOST - EVEN), 1.0)
    return _mix(WARM, HOT, t)


def _mix(a: str, b: str, t: float) -> str:
    one, two = (np.array([int(c[i : i + 2], 16) for i in (1, 3, 5)]) for c in (a, b))
    return "#" + "".join(f"{int(x):02x}" for x in np.round(one + t * (two - one)))


def regions(stage: LocaliseStage) -> go.Figure:
    """Bars of the concentration of error by region, the largest on top; `BARS` at most."""
    found = stage.indicators
    value = found.concentration
    order = np.argsort(np.nan_to_num(value), kind="stable")
    order = order[np.isfinite(value[order])][-BARS:]
    names = [found.regions[i] for i in order]
    fig = figure(
        max(220, 70 + 19 * len(order)),
        xaxis=axis("Share of error over share of strain energy", rangemode="tozero"),
        yaxis=axis(
            "",
            type="category",
            showgrid=False,
            ticks="",
            tickfont={"size": 11},
        ),
    )
    marker = {
        "color": [color(x) for x in value[order].tolist()],
        "line": {"width": 0.5, "color": MUTED},
    }
    extra = 100 * np.stack([found.constitutive[order], found.strain[order]], axis=1)
    fig.add_bar(
        x=f32(value[order]),
        y=names,
        orientation="h",
        marker=marker,
        customdata=f32(extra),
        showlegend=False,
    )
    fig.data[0].hovertemplate = (
        "%{y}: %{x:.2f}<br>%{customdata[0]:.1f} % of the error, %{customdata[1]:.1f} % of "
        "the strain energy<extra></extra>"
    )
    fig.update_layout(margin={"t": 10}, shapes=[rule(EVEN)])
    return fig


def view(scene: Scene, stage: LocaliseStage) -> View:
    """The model with its regions in the colours of `regions`, whose bars name them; `TOLD` in the
    key.
    """
    found = stage.indicators
    value = dict(zip(found.regions, found.concentration.tolist(), strict=True))
    shown = [value.get(g, np.nan) for g in scene.groups]
    strong = sorted(
        (g for g in scene.groups if value.get(g, 0.0) > EVEN), key=lambda g: -value[g]
    )
    legend = [(g, color(value[g]), f"{value[g]:.1f} ×") for g in strong[:TOLD]]
    alpha = [1.0 if x > EVEN else 0.35 for x in shown]
    return painted(scene, [color(x) for x in shown], alpha, legend)


def sizes(stage: LocaliseStage) -> go.Figure:
    """The criterion of the best set of each size; the least is the proposal before its members are
    tested.
    """
    p = stage.proposal
    fig = figure(
        260, xaxis=axis("Parameters", dtick=1), yaxis=axis("AICc + price of the search")
    )
    best = int(np.argmin(p.criteria))
    marks = {
        "size": 8,
        "color": [TEST if i == best else FE for i in range(p.sizes.size)],
    }
    fig.add_scatter(
        x=p.sizes,
        y=f32(p.criteria),
        mode="lines+markers",
        line={"color": FE, "width": 1.4},
        marker=marks,
    )
    fig.update_layout(margin={"t": 10}, showlegend=False)
    return fig


TICKS = [0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 7, 10, 20, 50]


def parameters(stage: UncertaintyStage) -> go.Figure:
    """Intervals of the factors: prior, posterior and, where sampled, the draws."""
    names = list(stage.posterior.parameters.names)
    fig = figure(
        90 + 42 * len(names),
        xaxis=axis(
            "Updated / initial",
            type="log",
            tickvals=TICKS,
            ticktext=[f"{t:g}" for t in TICKS],
        ),
        yaxis=axis(
            "",
            autorange="reversed",
            showgrid=False,
            ticks="",
            tickvals=list(range(len(names))),
            ticktext=names,
        ),
    )
    rows = np.arange(len(names), dtype=np.float64)
    percent = f"{100 * stage.level:g} %"
    for low_high, at, width, color, name in (
        (stage.posterior.prior, rows, 3, INITIAL, f"before the test, {percent}"),
        (stage.posterior.interval, rows, 9, FINAL, f"after it, {percent}"),
        (stage.chains.sampled, rows + 0.22, 3, QUALITATIVE[3], f"sampled, {percent}"),
    ):
        if len(low_high):
            # horizontal strokes as one broken line
            gap = np.full((len(at), 1), np.nan)
            x, y = (np.concatenate([low_high, gap], axis=1).ravel(), np.repeat(at, 3))
            fig.add_scatter(
                x=f32(x),
                y=f32(y),
                mode="lines",
                name=name,
                line={"width": width, "color": color},
            )
            fig.data[-1].update(hoverinfo="skip")
    marks = {"symbol": "line-ns", "size": 15, "line": {"width": 2.5, "color": TEST}}
    fig.add_scatter(
        x=f32(stage.posterior.factor),
        y=rows,
        mode="markers",
        marker=marks,
        name="final",
        text=names,
    )
    fig.data[-1].hovertemplate = "%{text}: × %{x:.3f}<extra></extra>"
    fig.update_layout(shapes=[rule(1)])
    drawn = np.concatenate([[1.0], *(np.ravel(t.x) for t in fig.data)]).astype(
        np.float64
    )
    low, high = np.log10([np.nanmin(drawn), np.nanmax(drawn)])
    room = 0.04 * (high - low) + 0.01
    fig.update_xaxes(range=[low - room, high + room])  # strokes end inside
    return fig


def correlation(stage: UncertaintyStage) -> go.Figure:
    """Correlation of the parameters after the test."""
    names = list(stage.posterior.parameters.names)
    fig = figure(
        130 + 30 * len(names),
        xaxis=axis(
            "",
            tickangle=-45,
            showgrid=False,
            showline=False,
            ticks="",
        ),
        yaxis=axis(
            "",
            autorange="reversed",
            showgrid=False,
            showline=False,
            ticks="",
        ),
    )
    bar = {"thickness": 10, "outlinewidth": 0}
    fig.add_heatmap(
        z=f32(stage.posterior.correlation),
        x=names,
        y=names,
        zmin=-1,
        zmax=1,
        colorscale=DIVERGING,
        colorbar=bar,
    )
    fig.data[0].update(
        xgap=1,
        ygap=1,
        texttemplate="%{z:.2f}",
        textfont={"size": 10},
    )
    fig.data[0].hovertemplate = "%{y}, %{x}: %{z:.2f}<extra></extra>"
    fig.update_layout(margin={"t": 10})
    return fig


def bands(stage: UncertaintyStage) -> go.Figure:
    """Deviation of each prediction from the measurement, with the band that should reach to
    zero.
    """
    fig = figure(
        350,
        xaxis=axis("Test mode, Hz", type="category", tickangle=-45),
        yaxis=axis(
            "(f FE − f test)/f test, %",
            zeroline=True,
            zerolinecolor="#5c6b7a",
            zerolinewidth=1,
        ),
    )
    b = stage.bands
    there = np.isfinite(b.predicted)
    names = np.array([f"{i + 1}: {f:.2f}" for i, f in enumerate(b.test)])
    deviation = 100 * (b.predicted / b.test - 1)
    reach = 100 * (b.band[:, 1] - b.predicted) / b.test
    for name, which, color, symbol in (
        ("used in the updating", b.used, FE, "circle"),
        ("left out of it", ~b.used, TEST, "diamond-open"),
    ):
        at = there & which
        marker = {
            "size": 9,
            "symbol": symbol,
            "color": color,
            "line": {"width": 2, "color": color},
        }
        error = {
            "type": "data",
            "array": f32(reach[at]),
            "thickness": 1.4,
            "width": 5,
            "color": color,
        }
        fig.add_scatter(
            x=names[at].tolist(),
            y=f32(deviation[at]),
            mode="markers",
            marker=marker,
            error_y=error,
        )
        fig.data[-1].update(name=name, customdata=f32(reach[at]))
        fig.data[
            -1
        ].hovertemplate = "%{x} Hz: %{y:.2f} ± %{customdata:.2f} %<extra></extra>"
    fig.layout.xaxis.update(categoryorder="array", categoryarray=names[there].tolist())
    return fig
