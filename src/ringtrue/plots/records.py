"""Records on a screen: stacked signals, their spectra and spectrogram, hits of a hammer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Bool, Float
from ringtrue.core.signals import Channel
from ringtrue.plots.style import (
    FE,
    MUTED,
    QUALITATIVE,
    SEQUENTIAL,
    TEST,
    axis,
    f32,
    figure,
    rule,
    thinned_log,
)
from ringtrue.signal.overview import Extremes, Spectrogram
from ringtrue.study.record_views import HitSignals

KEPT, LEFT_OUT = "#0b7a75", "#c0392b"  # hits
MACHINE = "#8e4a9e"
FAULT = {"color": "#c0392b", "size": 5, "symbol": "circle"}
POINTS = 1500  # of a spectrum
MODE_LINE = {"color": TEST, "width": 1, "dash": "dot"}
MACHINE_LINE = {"color": MACHINE, "width": 1, "dash": "dash"}
SELECTED_LINE = {"color": QUALITATIVE[4], "width": 2}


@dataclass(frozen=True, slots=True)
class MarkedHit:
    """A hit as a line over the signals."""

    time: float  # s
    kept: bool


def signals(
    channels: Sequence[Channel],
    seen: Extremes,
    *,
    rate: float,
    shown: tuple[float, float],
    levels: dict[str, float] | None = None,
    hits: Sequence[MarkedHit] = (),
) -> go.Figure:
    """Signals stacked over one time axis.

    Parameters
    ----------
    channels : sequence of Channel
    seen : Extremes
        Of these channels.
    rate : float, Hz
    shown : (float, float), s
    levels : dict of str to float, optional
        Where channels are clipped, in their units.
    hits : sequence of MarkedHit
    """
    n = len(channels)
    size = int(seen.first[1] - seen.first[0]) if seen.first.size > 1 else 1
    fig = figure(120 * n + 60, xaxis=axis("Time, s", range=list(shown), anchor=f"y{n}"))
    fig.update_layout(showlegend=False, margin={"t": 12, "l": 76}, dragmode="zoom")
    gap = 0.06 / max(n - 1, 1)
    for k, c in enumerate(channels):
        top = 1 - k / n
        name = f"yaxis{k + 1}" if k else "yaxis"
        domain = [top - 1 / n + (gap if k < n - 1 else 0), top]
        label = axis(
            f"{c.id}<br>{_unit(c) or c.quantity}", domain=domain, anchor="x", nticks=4
        )
        fig.update_layout({name: label | {"exponentformat": "power"}})
        on = f"y{k + 1}" if k else "y"
        line = {"width": 1, "color": QUALITATIVE[k % 8]}
        start, step, y = _path(seen, k, size, rate)
        fig.add_scatter(
            x0=start, dx=step, y=y, yaxis=on, mode="lines", line=line, name=c.id
        )
        fig.data[-1].hovertemplate = "%{x:.6g} s: %{y:.4g}<extra>" + c.id + "</extra>"
        level = (levels or {}).get(c.id, np.inf)
        _mark_clipped(fig, seen, k, on, level=level, rate=rate)
    fig.update_layout(shapes=[*_lost(seen, size, rate), *_hit_lines(hits, shown)])
    return fig


def _path(seen: Extremes, k: int, size: int, rate: float) -> tuple[float, float, Float]:
    """One line through the extremes of each bin: its first time, its step, its values."""
    start = float(seen.first[0]) / rate
    if size == 1:
        return start, 1 / rate, f32(seen.low[k])
    both = np.stack([seen.low[k], seen.high[k]], axis=1).ravel()
    return start, 0.5 * size / rate, f32(both)


def _mark_clipped(
    fig: go.Figure, seen: Extremes, k: int, on: str, *, level: float, rate: float
) -> None:
    """Marks where a channel reaches the level at which it is clipped."""
    for y in (seen.low[k], seen.high[k]):
        at = np.flatnonzero(np.abs(y) >= (1 - 1e-6) * level)
        if at.size:
            x = seen.first[at] / rate
            fig.add_scatter(x=x, y=f32(y[at]), yaxis=on, mode="markers", marker=FAULT)
            fig.data[-1].update(
                name="clipped", hovertemplate="%{x:.6g} s: clipped<extra></extra>"
            )


def _lost(seen: Extremes, size: int, rate: float) -> list[dict[str, object]]:
    """Where samples are missing, as shaded parts."""
    lost: Bool = np.asarray(seen.lost.any(axis=0))
    edges = np.flatnonzero(
        np.diff(np.concatenate([[False], lost, [False]]).astype(np.int8))
    )
    shapes = []
    for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        x0, x1 = float(seen.first[a]) / rate, float(seen.first[b - 1] + size) / rate
        ends = {
            "x0": x0,
            "x1": x1,
            "y0": 0,
            "y1": 1,
            "yref": "paper",
            "line": {"width": 0},
        }
        shapes.append({"type": "rect", "fillcolor": LEFT_OUT, "opacity": 0.18, **ends})
    return shapes


def _hit_lines(
    hits: Sequence[MarkedHit], shown: tuple[float, float]
) -> list[dict[str, object]]:
    inside = [h for h in hits if shown[0] <= h.time <= shown[1]]
    looks = [
        {"color": KEPT if h.kept else LEFT_OUT, "width": 1.5, "dash": "dot"}
        for h in inside
    ]
    return [rule(h.time, line=look) for h, look in zip(inside, looks, strict=True)]


def spectra(
    channels: Sequence[Channel],
    freqs: Float,
    density: Float,
    *,
    modes: Float,
    machines: Float,
    selected: float | None = None,
) -> go.Figure:
    """Power spectral densities over each other; `modes` and `machines` (k,) Hz are marked."""
    units = {_unit(c) for c in channels}
    unit = f"({units.pop()})²/Hz" if len(units) == 1 else "SI²/Hz"
    fig = figure(
        300, xaxis=axis("Frequency, Hz"), yaxis=axis(f"PSD, {unit}", type="log")
    )
    fig.update_yaxes(exponentformat="power", dtick=2)
    fig.update_layout(margin={"t": 30, "l": 64}, dragmode="zoom")
    ok = freqs > 0
    top = float(freqs[-1])
    for k, c in enumerate(channels):
        x, y = thinned_log(freqs[ok], density[k][ok], POINTS)
        line = {"width": 1.1, "color": QUALITATIVE[k % 8]}
        fig.add_scatter(x=f32(x), y=f32(y), mode="lines", line=line, name=c.id)
        fig.data[-1].hovertemplate = "%{x:.5g} Hz: %{y:.3g}<extra>" + c.id + "</extra>"
    shapes = [rule(f, line=MODE_LINE) for f in modes[modes < top].tolist()]
    shapes += [rule(f, line=MACHINE_LINE) for f in machines[machines < top].tolist()]
    if selected is not None and selected < top:
        shapes.append(rule(selected, line=SELECTED_LINE))
    fig.update_layout(shapes=shapes)
    for name, line, there in (
        ("mode", MODE_LINE, modes),
        ("machine", MACHINE_LINE, machines),
    ):
        if there.size:
            fig.add_scatter(x=[None], y=[None], mode="lines", line=line, name=name)
    return fig


def spectrogram(channel: Channel, seen: Spectrogram, *, rate: float) -> go.Figure:
    """Level over time and frequency."""
    span = 60.0  # dB below the highest level
    top = float(np.nanmax(seen.level)) if np.isfinite(seen.level).any() else 0.0
    fig = figure(300, xaxis=axis("Time, s"), yaxis=axis("Frequency, Hz"))
    fig.add_heatmap(
        x=f32((seen.first + seen.freqs.size - 1) / rate),
        y=f32(seen.freqs),
        z=np.round(seen.level).clip(-32000, 32000).astype(np.int16),
        zmin=top - span,
        zmax=top,
        colorscale=[list(stop) for stop in SEQUENTIAL],
        colorbar={
            "title": {"text": f"{channel.id}<br>dB"},
            "thickness": 10,
            "len": 1.0,
        },
        hovertemplate="%{x:.5g} s, %{y:.4g} Hz: %{z:.0f} dB<extra>"
        + channel.id
        + "</extra>",
    )
    fig.update_layout(margin={"t": 30, "l": 56}, dragmode="zoom")
    return fig


def hit(
    seen: HitSignals,
    responses: Sequence[Channel],
    *,
    freqs: Float,
    coherence: Float,
    stored: tuple[Float, Float] | None = None,
) -> go.Figure:
    """Force and its spectrum above, response and coherence below.

    Parameters
    ----------
    seen : HitSignals
    responses : sequence of Channel
    freqs : (f,) float64, Hz
    coherence : (channel, f) float64
        Of the hits that are kept.
    stored : ((g,) Hz, (channel, g)), optional
        The coherence of the last run.
    """
    left, right, upper, lower = [0.0, 0.42], [0.6, 1.0], [0.58, 1.0], [0.0, 0.42]
    top = float(freqs[-1]) if freqs.size else float(seen.freqs[-1])
    fig = figure(
        460,
        xaxis=axis("Time from the peak, ms", domain=left, anchor="y"),
        yaxis=axis("Force, N", domain=upper),
        xaxis2=axis("Frequency, Hz", domain=right, anchor="y2", range=[0, top]),
        yaxis2=axis("Force spectrum, dB", domain=upper, anchor="x2", range=[-60, 5]),
        xaxis3=axis("Time from the peak, s", domain=left, anchor="y3"),
        yaxis3=axis(
            _motion(responses), domain=lower, anchor="x3", exponentformat="power"
        ),
        xaxis4=axis("Frequency, Hz", domain=right, anchor="y4", matches="x2"),
        yaxis4=axis("Coherence", domain=lower, anchor="x4", range=[0, 1.03]),
    )
    fig.update_layout(margin={"t": 30, "l": 64}, legend={"y": 1.02})
    line = {"width": 1.6, "color": FE}
    mode = "lines+markers" if seen.force_time.size < 200 else "lines"
    fig.add_scatter(
        x=f32(1000 * seen.force_time),
        y=f32(seen.force),
        mode=mode,
        line=line,
        marker={"size": 4},
    )
    fig.data[-1].update(name="force", showlegend=False)
    fig.add_scatter(
        x=f32(seen.freqs), y=f32(seen.force_level), line=line, xaxis="x2", yaxis="y2"
    )
    fig.data[-1].update(name="force", showlegend=False)
    for k, c in enumerate(responses):
        look = {"width": 1.1, "color": QUALITATIVE[k % 8]}
        bins = max(1, -(-seen.time.size // 2000))
        at, y = np.arange(0, seen.time.size, bins), seen.response[k]
        if bins > 1:  # the largest value of each bin
            whole = y[: y.size // bins * bins].reshape(-1, bins)
            y = np.take_along_axis(
                whole, np.abs(whole).argmax(axis=1)[:, None], axis=1
            )[:, 0]
            at = at[: y.size]
        fig.add_scatter(
            x=f32(seen.time[at]), y=f32(y), line=look, xaxis="x3", yaxis="y3"
        )
        fig.data[-1].update(name=c.id, legendgroup=c.id)
        under = {"xaxis": "x4", "yaxis": "y4", "legendgroup": c.id, "showlegend": False}
        if stored is not None:
            faint = look | {"dash": "dot", "width": 1}
            fig.add_scatter(
                x=f32(stored[0]), y=f32(stored[1][k]), line=faint, opacity=0.6, **under
            )
            fig.data[-1].update(name=f"{c.id}, last run")
        if freqs.size:
            fig.add_scatter(x=f32(freqs), y=f32(coherence[k]), line=look, **under)
            fig.data[-1].update(name=c.id)
    fig.update_xaxes(gridcolor=fig.layout.xaxis.gridcolor)
    if not np.isfinite(coherence).any():
        fig.add_annotation(
            text="of one hit there is no coherence",
            xref="x4 domain",
            yref="y4 domain",
            x=0.5,
            y=0.5,
            showarrow=False,
            font={"color": MUTED},
        )
    return fig


def _unit(channel: Channel) -> str:
    """As it is written in a figure."""
    return channel.unit.replace("^2", "²").replace("*", "·")


def _motion(responses: Sequence[Channel]) -> str:
    """What responses measure, with their unit."""
    kinds = {(c.quantity, _unit(c)) for c in responses}
    if len(kinds) != 1:
        return "Response"
    quantity, unit = kinds.pop()
    return f"{quantity.capitalize()}, {unit}"
