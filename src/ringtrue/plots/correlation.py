"""MAC and orthogonality matrices, frequency deviations, channels, and modes followed from model to
model.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Float
from ringtrue.correlation.frf import FrfComparison
from ringtrue.correlation.measures import CompleteCorrelation
from ringtrue.correlation.orthogonality import OrthogonalityCheck
from ringtrue.correlation.pairing import Tracks
from ringtrue.correlation.table import CorrelationTable
from ringtrue.identification.common.tracking import ModeTrack, Tracked
from ringtrue.plots.style import (
    DIVERGING,
    FE,
    FINAL,
    INITIAL,
    MUTED,
    QUALITATIVE,
    REMODELLED,
    SEQUENTIAL,
    TEST,
    above_and_below,
    axis,
    f32,
    figure,
    figure_page,
)
from ringtrue.study.results import FrfEvidence


def tracking_page(title: str, tracked: Tracked, notes: Sequence[str]) -> str:
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
    return figure_page(
        title, drawn, after=f"<h2>Notes</h2><ul>{items}</ul>" if items else ""
    )


def _series(
    fig: go.Figure, tracked: Tracked, t: ModeTrack, y: Float, std: Float, number: int
) -> None:
    """One mode over time, broken where it was not seen."""
    color = QUALITATIVE[number % 8]
    n = tracked.times.size
    value = np.full(n, np.nan)
    bar = np.full(n, np.nan)
    value[t.at], bar[t.at] = y, std
    error = {"type": "data", "array": f32(bar), "thickness": 1, "width": 2}
    mark = {"size": 5, "color": color}
    line = {"width": 1, "color": color}
    fig.add_scatter(
        x=f32(tracked.times),
        y=value,
        error_y=error,
        mode="lines+markers",
        name=f"mode {t.name}",
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
            number=i,
        )
    return fig


def dampings(tracked: Tracked) -> go.Figure:
    """Damping ratios over time with one standard deviation."""
    fig = figure(
        340, xaxis=axis("Time, h"), yaxis=axis("Damping ratio, %", rangemode="tozero")
    )
    for i, t in enumerate(tracked.tracks):
        _series(
            fig,
            tracked,
            t=t,
            y=100 * t.damping,
            std=100 * t.std_damping,
            number=i,
        )
    return fig


BAD = "#a4351c"
WORST = 12  # channels shown
TOLD = 60  # modes up to which the cells of a matrix carry numbers and gaps
OUTLINED = 300  # terms that are outlined in a matrix
LOST = 0.6  # overlap of shapes below which a mode that is followed may be another one
STAGE_COLORS = {"initial": INITIAL, "remodelled": REMODELLED, "final": FINAL}


@dataclass(frozen=True, slots=True)
class MatrixSide:
    """A side of a matrix: the label of each mode, and the title of all."""

    labels: Sequence[str]
    title: str


def matrix(
    mac: Float,
    rows: MatrixSide,
    columns: MatrixSide,
    height: int = 0,
    diagonal: bool = True,
    name: str = "MAC",
) -> go.Figure:
    """A MAC matrix in percent; `mac` (row, column) 0..1. Cells over 10 % carry their number, up to
    `TOLD` modes.

    `diagonal` False leaves out the ones of an auto-MAC; `name` is what the matrix holds.
    """
    percent = 100 * np.asarray(mac)
    size = max(percent.shape, default=1)
    look = {"type": "category", "showgrid": False, "ticks": "", "showline": False}
    look["tickfont"] = {"size": 10 if size > 12 else 11}
    fig = figure(
        height or int(np.clip(150 + 23 * percent.shape[0], 260, 720)),
        xaxis=axis(columns.title, tickangle=-90 if size > 8 else 0, **look),
        yaxis=axis(rows.title, autorange="reversed", **look),
        plot_bgcolor="#eef1f4",
        margin={"t": 12, "r": 8, "l": 50, "b": 50},
    )
    labelled = percent >= 10
    if not diagonal:
        np.fill_diagonal(labelled, False)
    few = size <= TOLD
    fig.add_heatmap(
        z=f32(percent),
        x=list(columns.labels),
        y=list(rows.labels),
        zmin=0,
        zmax=100,
        colorscale=SEQUENTIAL,
        colorbar={"thickness": 10, "outlinewidth": 0, "ticksuffix": " %"},
        hovertemplate=f"%{{y}}<br>%{{x}}<br>{name} %{{z:.1f}} %<extra></extra>",
        xgap=int(few),
        ygap=int(few),
        text=np.where(labelled, np.char.mod("%.0f", percent), "") if few else None,
        texttemplate="%{text}" if few else None,
        textfont={"size": 9 if size > 12 else 10},
    )
    return fig


def labels(frequencies: Float) -> list[str]:
    """`1: 13.42` for each mode."""
    return [
        f"{i + 1}: {round(f, 2) + 0.0:.2f}" for i, f in enumerate(frequencies.tolist())
    ]  # no -0.00


def table_matrix(table: CorrelationTable, *, subspace: bool = False) -> go.Figure:
    """The MAC matrix of a correlation, its pairs outlined, from the first column compared to just
    above the test; pairs with their subspace MAC where that is asked for.
    """
    values = table.mac
    if subspace:
        values = values.copy()
        values[table.pairing.a, table.pairing.b] = table.pairing.mac
    a, b = (f"{name} mode, Hz" for name in table.names)
    first, last = _columns(table)
    names = labels(table.all_fe_hz)[first:last]
    fig = matrix(
        values[:, first:last],
        MatrixSide(labels(table.all_test_hz), a),
        MatrixSide(names, b),
        name="subspace MAC of pairs" if subspace else "MAC",
    )
    pairs = zip(
        table.pairing.a.tolist(), (table.pairing.b - first).tolist(), strict=True
    )
    fig.layout.shapes = [_outline(i, j) for i, j in pairs]
    return fig


def _columns(table: CorrelationTable) -> tuple[int, int]:
    compared = np.flatnonzero(table.mac.any(axis=0))
    near = np.flatnonzero(table.all_fe_hz <= 1.15 * table.all_test_hz.max(initial=0.0))
    last = max(int(x.max(initial=-1)) for x in (near, table.pairing.b)) + 1
    first = int(compared[0]) if compared.size else 0
    return (first, last) if last > first else (0, table.mac.shape[1])


def _outline(row: int, column: int, color: str = TEST) -> dict[str, object]:
    edges = {"x0": column - 0.5, "x1": column + 0.5, "y0": row - 0.5, "y1": row + 0.5}
    return {"type": "rect", **edges, "line": {"width": 1.5, "color": color}}


def orthogonality(
    check: OrthogonalityCheck, table: CorrelationTable, height: int = 0
) -> go.Figure:
    """A self- or cross-orthogonality matrix; what is beyond the gate is outlined. Columns from the
    first pair on.
    """
    cross = check.kind == "cross"
    of_model = check.kind == "model"
    names = [labels(f) for f in (table.all_test_hz, table.all_fe_hz)]
    titles = [f"{name} mode, Hz" for name in table.names]
    first = int(table.pairing.b.min()) if cross and len(table) else 0
    last = int(table.pairing.b.max(initial=-1)) + 1 if cross else check.matrix.shape[1]
    values = check.matrix[:, first:last]
    down = int(of_model)
    right = int(cross or of_model)
    fig = matrix(
        values,
        MatrixSide(names[down][: values.shape[0]], titles[down]),
        MatrixSide(names[right][first:last], titles[right]),
        height=height,
        diagonal=cross,
        name="orthogonality",
    )
    fig.update_layout(
        shapes=[
            _outline(f.a, f.b - first, BAD) for f in check.verdict.failures[:OUTLINED]
        ]
    )
    return fig


def channels(c: CompleteCorrelation) -> go.Figure:
    """The worst channels by CoMAC and by eCoMAC, and the mean MAC as channels are left out one
    after the other.
    """
    spans = ([0, 0.25], [0.38, 0.63], [0.75, 1])
    fig = figure(360, showlegend=False)
    sides = (
        ("1 − CoMAC", 1 - c.by_channel.comac, FE),
        ("eCoMAC", c.by_channel.ecomac, QUALITATIVE[4]),
    )
    for n, span, (name, value, color) in zip(("", "2"), spans, sides, strict=False):
        fig.layout[f"xaxis{n}"] = axis(
            f"{name}, %",
            domain=span,
            anchor=f"y{n}",
            rangemode="tozero",
        )
        fig.layout[f"yaxis{n}"] = axis(
            anchor=f"x{n}",
            type="category",
            autorange="reversed",
            showgrid=False,
            ticks="",
        )
        worst = np.argsort(-value, kind="stable")[:WORST]
        names = [c.channels[i] for i in worst]
        fig.add_bar(
            y=names,
            x=f32(100 * value[worst]),
            orientation="h",
            marker_color=color,
        )
        fig.data[-1].update(
            xaxis=f"x{n}",
            yaxis=f"y{n}",
            hovertemplate=f"%{{y}}: {name} %{{x:.1f}} %<extra></extra>",
        )
    fig.layout.xaxis3 = axis(
        "Channel left out, one by one",
        domain=spans[2],
        anchor="y3",
        tickangle=-60,
        showgrid=False,
    )
    fig.layout.xaxis3.update(type="category", tickfont={"size": 10})
    fig.layout.yaxis3 = axis("Mean MAC, %", anchor="x3")
    x = ["none", *(c.channels[i] for i in c.by_channel.elimination.order)]
    look = {"color": TEST, "width": 1.6}
    fig.add_scatter(
        x=x,
        y=f32(100 * c.by_channel.elimination.mean_mac),
        mode="lines+markers",
        line=look,
        xaxis="x3",
        yaxis="y3",
    )
    fig.data[-1].hovertemplate = "down to %{x}: %{y:.2f} %<extra></extra>"
    fig.update_layout(margin={"t": 10})
    return fig


def followed(tracks: Tracks, table: CorrelationTable) -> go.Figure:
    """Frequencies of the final model's modes back to the initial model, followed by shape, next to
    the test's.

    A dotted stretch: the shapes have so little in common that the mode may be another one.
    """
    between = ("remodelled",) if len(tracks.index) > 2 else ()
    steps = ("initial", *between, "final", "test")
    last = len(steps) - 1
    fig = figure(
        460,
        showlegend=False,
        xaxis=axis(
            tickvals=list(range(last + 1)),
            ticktext=list(steps),
            range=[-0.12, last + 0.12],
            showgrid=False,
        ),
        yaxis=axis("Frequency, Hz"),
    )
    partner = {r.fe - 1: r for r in table.rows()}
    # from the first mode that has a partner
    for k in range(min(partner, default=0), tracks.index.shape[1]):
        f = tracks.frequencies[::-1, k]
        overlap = tracks.overlap[:0:-1, k]
        pair = partner.get(int(tracks.index[0, k]))
        color = FE if pair is not None else "#b4bec8"
        for i, certain in enumerate((overlap >= LOST).tolist()):
            line = {"width": 1.5, "color": color, "dash": "solid" if certain else "dot"}
            fig.add_scatter(
                x=[i, i + 1],
                y=f32(f[i : i + 2]),
                mode="lines",
                line=line,
                hoverinfo="skip",
            )
        numbers = tracks.index[::-1, k] + 1
        shared = ["", *(f", MAC with the step before {100 * o:.0f} %" for o in overlap)]
        text = [
            f"FE {n}: {x:.3f} Hz{s}" for n, x, s in zip(numbers, f, shared, strict=True)
        ]
        mark = {"size": 6, "color": color}
        fig.add_scatter(
            x=list(range(last)),
            y=f32(f),
            mode="markers",
            marker=mark,
            text=text,
            hovertemplate="%{text}<extra></extra>",
        )
        if pair is not None:
            look = {"width": 1.5, "color": TEST}
            ends = f32(np.array([pair.fe_hz, pair.test_hz]))
            fig.add_scatter(
                x=[last - 1, last],
                y=ends,
                mode="lines+markers",
                line=look,
                marker={"size": [0, 7], "color": TEST},
            )
            fig.data[
                -1
            ].hovertemplate = f"test {pair.test}: {pair.test_hz:.3f} Hz<extra></extra>"
    return fig


def frf_agreement(e: FrfEvidence) -> go.Figure:
    """Global shape and amplitude correlation over frequency, mean of the references, initial and
    final model.
    """
    fig = figure(
        330,
        xaxis=axis(
            domain=[0, 1],
            anchor="y",
            matches="x2",
            showticklabels=False,
        ),
        yaxis=axis("Shape, %", domain=[0.54, 1], range=[0, 102]),
        xaxis2=axis("Frequency, Hz", anchor="y2"),
        yaxis2=axis(
            "Amplitude, %",
            domain=[0, 0.46],
            anchor="x2",
            range=[0, 102],
        ),
    )
    sides: tuple[tuple[str, FrfComparison, str], ...] = (
        ("initial model", e.initial, MUTED),
        ("final model", e.final, FINAL),
    )
    for name, c, color in sides:
        line = {"width": 1.6, "color": color}
        shape, amplitude = (100 * x.mean(axis=1) for x in (c.shape, c.amplitude))
        above_and_below(
            fig,
            name,
            line,
            x=c.freqs,
            upper=shape,
            lower=amplitude,
        )
    return fig


def fdac(values: Float, lines: Float, title: str) -> go.Figure:
    """The FDAC, `values` (test line, model line) -1..1: a ridge next to the diagonal is a shift of
    frequency.
    """
    ends = [float(lines[0]), float(lines[-1])]
    fig = figure(
        400,
        xaxis=axis(
            f"{title}, Hz",
            showgrid=False,
            constrain="domain",
            range=ends,
        ),
        yaxis=axis(
            "Test, Hz",
            showgrid=False,
            scaleanchor="x",
            constrain="domain",
            range=ends,
        ),
    )
    bar = {"thickness": 10, "outlinewidth": 0, "ticksuffix": " %"}
    fig.add_heatmap(
        z=f32(100 * values),
        x=f32(lines),
        y=f32(lines),
        zmin=-100,
        zmax=100,
        colorscale=DIVERGING,
    )
    fig.data[0].update(
        colorbar=bar,
        hovertemplate="test %{y:.2f} Hz<br>model %{x:.2f} Hz<br>%{z:.0f} %<extra></extra>",
    )
    fig.add_scatter(
        x=ends,
        y=ends,
        mode="lines",
        line={"width": 0.8, "color": "#5c6b7a", "dash": "dot"},
        hoverinfo="skip",
    )
    fig.update_layout(showlegend=False, margin={"t": 12})
    return fig


def deviations(stages: Sequence[tuple[str, CorrelationTable]]) -> go.Figure:
    """Frequency deviation, MAC and subspace MAC of each test mode, one mark a stage; hollow marks
    were left out of the updating.
    """
    alone = all(t.frequency_only for _, t in stages)
    order = {r.test: r.test_hz for _, t in stages for r in t.rows()}
    names = {k: f"{k}: {order[k]:.2f}" for k in sorted(order)}
    if alone:
        modes = axis("Test mode, Hz", type="category", tickangle=-45)
        fig = figure(300, xaxis=modes, yaxis=_deviation_axis(0.0))
    else:
        fig = _with_mac()
    for x_axis in fig.select_xaxes():
        x_axis.update(categoryorder="array", categoryarray=list(names.values()))
    for size, (name, table) in zip((13, 10, 9), stages, strict=False):
        color = STAGE_COLORS.get(name, FINAL)
        rows = table.rows()
        marks = ["circle" if r.used or name != "final" else "circle-open" for r in rows]
        look = {
            "size": size,
            "color": color,
            "symbol": marks,
            "line": {"width": 2, "color": color},
        }
        x = [names[r.test] for r in rows]
        partner = [f"FE {r.fe}" for r in rows]
        drawn = {
            "x": x,
            "mode": "markers",
            "marker": look,
            "name": name,
            "text": partner,
            "legendgroup": name,
        }
        fig.add_scatter(y=f32(table.deviation_percent), **drawn)
        fig.data[
            -1
        ].hovertemplate = f"{name}, %{{text}}: %{{y:.2f}} %<extra>%{{x}} Hz</extra>"
        if alone:
            continue
        measures = (
            ("MAC", table.mac_percent, "3"),
            ("subspace MAC", table.subspace_mac_percent, "2"),
        )
        for measure, percent, at in measures:
            fig.add_scatter(
                y=f32(percent),
                xaxis=f"x{at}",
                yaxis=f"y{at}",
                showlegend=False,
                **drawn,
            )
            text = f"{name}, %{{text}}: {measure} %{{y:.1f}} %"
            fig.data[-1].hovertemplate = f"{text}<extra>%{{x}} Hz</extra>"
    return fig


def _deviation_axis(low: float) -> dict[str, Any]:
    """The axis of the frequency deviations, from `low` of the height on."""
    return axis(
        "Δf, % of the test",
        domain=[low, 1],
        zeroline=True,
        zerolinecolor="#5c6b7a",
        zerolinewidth=1,
    )


def _with_mac() -> go.Figure:
    """An empty figure of frequency deviations over MAC over subspace MAC; names of the modes stand
    at the bottom.
    """
    above: dict[str, Any] = {
        "type": "category",
        "matches": "x2",
        "showticklabels": False,
    }
    return figure(
        580,
        xaxis=axis(anchor="y", **above),
        yaxis=_deviation_axis(0.58),
        xaxis2=axis("Test mode, Hz", type="category", anchor="y2", tickangle=-45),
        yaxis2=axis("Subspace MAC, %", domain=[0, 0.24], anchor="x2"),
        xaxis3=axis(anchor="y3", **above),
        yaxis3=axis("MAC, %", domain=[0.29, 0.53], anchor="x3", matches="y2"),
    )
