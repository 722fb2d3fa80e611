"""The diagram of an identification: the whole band in one view; damping of its modes over frequency
and amplitude, expected and found standard deviations.

On its page modes and poles are taken up by a click, and their shapes move.
"""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.display import plus_minus
from ringtrue.core.modes import ModeSet, Uncertainty, elastic
from ringtrue.core.testmodel import TestModel
from ringtrue.identification.ambient.decay_backbone import Backbone
from ringtrue.identification.common.diagram import IdentificationDiagram
from ringtrue.identification.common.stabilisation import StableDiagram
from ringtrue.planning.geometry import relative_neighbours
from ringtrue.plots.correlation import MatrixSide, labels, matrix
from ringtrue.plots.scene import modes as modes_view
from ringtrue.plots.style import (
    FE,
    FINAL,
    MUTED,
    QUALITATIVE,
    TEST,
    WIDE,
    axis,
    f32,
    figure,
    hertz,
    packed,
    thinned_log,
)
from ringtrue.viewer.scene import asset, script_json, to_json, viewer_script

# kinds of poles: name, colour, size and symbol of the mark; those of other estimators first
POLES = (
    ("pole by pLSCF", "#b5916f", 5, "x-thin-open"),
    ("pole by SSI-data", "#a8b8c8", 5, "cross-thin-open"),
    ("unstable pole", "#d3cbbd", 4, "circle"),
    ("stable pole", QUALITATIVE[5], 4, "circle"),
    ("pole of a candidate mode", FE, 5, "circle"),
)
OTHERS = ("pLSCF", "SSI-data")
CANDIDATE = len(POLES) - 1
# classes of modes: name, colour, symbol; open where it is not reported
CLASSES = (
    ("natural", TEST, "triangle-down"),
    ("doubtful", "#b07800", "triangle-down"),
    ("harmonic", "#8e4a9e", "diamond"),
)
GLYPHS = {"natural": "▼", "doubtful": "▽", "harmonic": "◇"}  # of the classes, in texts
LINE = {"symbol": "line-ns-open", "size": 12, "color": "#8e4a9e", "line": {"width": 2}}
PEAK = {"symbol": "circle-open", "size": 6, "color": MUTED, "line": {"width": 1.2}}
# of the first, second and third singular value
SPECTRUM = ("#8d9aa7", "#b4bec8", "#d2d9df")
COLUMNS = 500  # poles of one order nearer than a column of the whole band are one mark
MOST = 4000  # marks of one kind of poles
POINTS = 1500  # of a singular value


def pole_kinds(diagram: StableDiagram) -> Int:
    """(k,) position in `POLES` of each pole, those of other estimators at last."""
    own = len(OTHERS) + np.where(diagram.cluster >= 0, 2, diagram.stable)
    others = [np.full(len(p), OTHERS.index(p.method)) for p in diagram.others]
    return np.concatenate([own, *others])


def _every_pole(diagram: StableDiagram) -> Float:
    """(4, k) frequency, Hz, order, damping and standard deviation of the frequency, Hz, of each
    pole, those of other estimators at last.
    """
    sets = (diagram.poles, *diagram.others)
    rows = [[p.frequencies, p.order, p.damping, p.std_frequency] for p in sets]
    return np.hstack([np.stack(row) for row in rows])


def identification_figure(
    shown: IdentificationDiagram, *, most: int = MOST, height: int = 700
) -> go.Figure:
    """Poles over frequency and order with three singular values behind and the modes on top;
    below, damping over frequency.

    Parameters
    ----------
    shown : IdentificationDiagram
    most : int
        Marks of one kind of poles; 0 leaves their traces empty, for a page that fills them.
    height : int
        Pixels.
    """
    low, high = shown.span
    top = max((int(d.poles.order.max(initial=1)) for d in shown.diagrams), default=1)
    fig = _axes(shown, top, height)
    for k, color in reversed(tuple(enumerate(SPECTRUM))):
        x, y = thinned_log(*shown.singular_value(k), POINTS)
        if x.size:
            name = "singular values" if k == 0 else f"singular value {k + 1}"
            line = {"width": 1, "color": color}
            look = {
                "showlegend": k == 0,
                "legendgroup": "spectrum",
                "hoverinfo": "skip",
            }
            fig.add_scatter(
                x=f32(x),
                y=f32(y),
                yaxis="y2",
                mode="lines",
                line=line,
                name=name,
                **look,
            )
    for k, (name, color, size, symbol) in enumerate(POLES):
        every = _of_kind(shown, k)
        if not every.size:
            continue
        frequency, order, damping = (
            _drawn(shown, every, most) if most else (np.empty(0),) * 3
        )
        for y, on, large in ((order, "y", size), (100 * damping, "y3", size - 1)):
            fig.add_scatter(
                x=frequency,
                y=f32(y),
                yaxis=on,
                mode="markers",
                marker={"color": color, "size": large, "symbol": symbol},
                name=name,
                legendgroup=name,
                showlegend=on == "y",
                hoverinfo="skip",
            )
    _add_beyond(fig, shown)
    _add_account(fig, shown, top)
    _add_modes(fig, shown, top)
    fig.update_xaxes(
        range=[np.log10(low), np.log10(high)] if _wide(shown) else [low, high]
    )
    return fig


def _wide(shown: IdentificationDiagram) -> bool:
    low, high = shown.span
    return low > 0 and high / low > WIDE


def _axes(shown: IdentificationDiagram, top: int, height: int) -> go.Figure:
    """Orders and spectrum in the upper panel, damping in the lower one."""
    frequency = axis(
        "Frequency, Hz", anchor="y3", minor={"ticks": "outside", "ticklen": 2}
    )
    if _wide(shown):
        frequency |= {"type": "log", "dtick": "D2", "tickformat": "~g"}
    upper = np.nan_to_num(shown.modes.damping) + np.nan_to_num(
        shown.uncertainty.damping
    )
    # and of the poles that modes are made of
    highest = 100 * float(
        np.hstack([0.0, upper, np.nan_to_num(_of_kind(shown, CANDIDATE)[2])]).max()
    )
    order = axis("Model order", domain=[0.34, 1.0], range=[0, 1.14 * top], nticks=8)
    level = axis(
        "Singular values, dB", overlaying="y", side="right", showgrid=False, nticks=6
    )
    level["tickmode"] = "auto"
    ratio = axis(
        "Damping, %", domain=[0.0, 0.28], range=[0, 1.15 * highest or 5.0], nticks=5
    )
    fig = figure(height, xaxis=frequency, yaxis=order, yaxis2=level, yaxis3=ratio)
    fig.update_layout(hovermode="closest", margin={"r": 60, "t": 84})
    return fig


def _add_beyond(fig: go.Figure, shown: IdentificationDiagram) -> None:
    """The poles that lie above the panel of damping, on its edge."""
    edge = fig.layout.yaxis3.range[1]
    own = range(len(OTHERS), len(POLES))
    every = np.hstack([_of_kind(shown, k) for k in own])
    f, _, damping = every[:, 100 * every[2] > edge]
    at = _apart(f, 0 * f, shown)
    fig.add_scatter(
        x=f[at],
        y=[0.95 * edge] * at.size,
        yaxis="y3",
        mode="markers",
        marker={"symbol": "triangle-up-open", "size": 6, "color": MUTED},
        name="pole above the axis",
        showlegend=False,
        text=[f"{100 * x:.3g}" for x in damping[at]],
        hovertemplate="%{x:.5g} Hz, damping %{text} %<extra>%{fullData.name}</extra>",
    )


def _drawn(
    shown: IdentificationDiagram, every: Float, most: int
) -> tuple[Float, Float, Float]:
    """Frequency, order and damping of poles (3, k), as many as can be distinguished."""
    f, order, damping = every
    at = _apart(f, order, shown)
    at = at[:: -(-at.size // most) or 1]
    return f32(f[at]), f32(order[at]), f32(damping[at])


def _of_kind(shown: IdentificationDiagram, kind: int) -> Float:
    """Frequency, order and damping (3, k) of all poles of a kind."""
    sets = [_every_pole(d)[:3, pole_kinds(d) == kind] for d in shown.diagrams]
    return np.hstack([np.empty((3, 0)), *sets])


def _apart(f: Float, order: Float, shown: IdentificationDiagram) -> Int:
    """Positions of the poles that a mark does not hide."""
    low, high = shown.span
    place = (
        np.log(np.maximum(f, low) / low) / np.log(high / low)
        if _wide(shown)
        else f / high
    )
    cells = np.stack([np.floor(COLUMNS * place), order])
    _, first = np.unique(cells, axis=1, return_index=True)
    return np.sort(first)


def _add_account(fig: go.Figure, shown: IdentificationDiagram, top: int) -> None:
    """Lines of machines below the orders, unexplained peaks above them."""
    peaks = shown.account.unexplained
    lines = shown.account.lines
    said = [
        f"{p.frequency:.5g} Hz<br>{p.prominence:.0f} dB in singular value {p.value}"
        for p in peaks
    ]
    at = np.array([p.frequency for p in peaks])
    for name, f, text, look, height in (
        ("line of a machine", lines, [f"{f:.5g} Hz" for f in lines], LINE, 0.02),
        ("unexplained peak", at, said, PEAK, 1.11),
    ):
        if len(f):
            fig.add_scatter(
                x=f,
                y=np.full(len(f), height * top),
                mode="markers",
                marker=look,
                name=name,
                text=text,
                hovertemplate="%{text}<extra>" + name + "</extra>",
            )


def _add_modes(fig: go.Figure, shown: IdentificationDiagram, top: int) -> None:
    """The modes of each class: above the orders, and with deviations in the panel of damping."""
    text = mode_texts(shown)
    for name, color, symbol in CLASSES:
        at = [k for k, own in enumerate(shown.classes) if own == name]
        if not at:
            continue
        form = symbol if name == "natural" else f"{symbol}-open"
        mark = {
            "symbol": [form] * len(at),
            "size": 11,
            "color": color,
            "line": {"width": 1.5, "color": color},
        }
        std = 100 * shown.uncertainty.damping[at]
        bar = {
            "array": f32(np.nan_to_num(std)),
            "thickness": 1,
            "width": 3,
            "color": color,
        }
        # the legend keeps it where single marks change
        sample = {**mark, "symbol": form}
        look = {"name": f"{name} mode", "legendgroup": name, "marker": sample}
        fig.add_scatter(x=[None], y=[None], mode="markers", **look)
        ratio = 100 * shown.modes.damping[at]
        for y, on, bars in (
            (np.full(len(at), 1.06 * top), "y", None),
            (ratio, "y3", bar),
        ):
            fig.add_scatter(
                x=shown.modes.frequencies[at],
                y=f32(y),
                yaxis=on,
                error_y=bars,
                mode="markers",
                marker=mark if on == "y" else mark | {"size": 8},
                name=f"{name} mode",
                legendgroup=name,
                showlegend=False,
                customdata=at,
                text=[text[k] for k in at],
                hovertemplate="%{text}<extra></extra>",
            )


def mode_texts(shown: IdentificationDiagram) -> list[str]:
    """What a mark of each mode says on hover."""
    out = []
    modes = shown.modes
    std = shown.uncertainty
    for k, (kind, remark, mpc) in enumerate(
        zip(shown.classes, shown.remarks, shown.mpc, strict=True)
    ):
        damping = 100 * float(modes.damping[k])
        spread = 100 * float(std.damping[k])
        lines = [
            f"<b>{kind} mode</b>",
            f"{plus_minus(float(modes.frequencies[k]), float(std.frequency[k]), 5)} Hz",
            f"damping {plus_minus(damping, spread, 3)} %",
            f"MPC {_known(mpc, '.2f')}, confidence {modes.confidence[k]:.2f}",
            *([remark] if remark else []),
        ]
        out.append("<br>".join(lines))
    return out


def _known(x: float, form: str) -> str:
    return format(x, form) if np.isfinite(x) else "unknown"


def auto_mac(shown: IdentificationDiagram, height: int = 0) -> go.Figure:
    """The MAC among the modes of all classes."""
    # natural modes have their numbers, as in the tables; the rest are counted by themselves
    natural = np.array([kind == "natural" for kind in shown.classes])
    numbered = iter(labels(shown.modes.frequencies[natural]))
    rest = iter(labels(shown.modes.frequencies[~natural]))
    names = [
        next(numbered) if kind == "natural" else f"{GLYPHS[kind]} {next(rest)}"
        for kind in shown.classes
    ]
    side = MatrixSide(names, "Mode, Hz")
    return matrix(shown.auto_mac, side, side, height=height, diagonal=False)


def damping(
    sets: list[tuple[str, ModeSet, Uncertainty | None]],
    used: tuple[Float, Float] | None,
) -> go.Figure:
    """Damping ratios over frequency with one standard deviation; `used` (f, ζ) is what the elastic
    modes carry.
    """
    x = hertz()
    fig = figure(320, xaxis=x, yaxis=axis("Damping ratio, %", rangemode="tozero"))
    for i, (name, modes, std) in enumerate(sets):
        color = (TEST, QUALITATIVE[0])[i % 2]
        bar = None
        if std:
            bar = {
                "type": "data",
                "array": f32(100 * std.damping),
                "thickness": 1,
                "width": 3,
            }
        mark = {"size": 8, "color": color, "symbol": ("circle", "diamond")[i % 2]}
        f = f32(modes.frequencies)
        y = f32(100 * modes.damping)
        fig.add_scatter(
            x=f,
            y=y,
            error_y=bar,
            mode="markers",
            marker=mark,
            name=name,
        )
    if used is not None:
        mark = {
            "size": 9,
            "color": FINAL,
            "symbol": "line-ew-open",
            "line": {"width": 2, "color": FINAL},
        }
        f, y = (f32(x[elastic(used[0])]) for x in (used[0], 100 * used[1]))
        fig.add_scatter(
            x=f,
            y=y,
            mode="markers",
            marker=mark,
            name="carried by the final model",
        )
    return fig


def precision(modes: ModeSet, std: Float, expected: Float) -> go.Figure:
    """Relative standard deviation of each target frequency as planned; `std`, `expected` (target,)
    relative.
    """
    fig = figure(
        280,
        barmode="group",
        xaxis=axis("Mode, Hz", type="category", tickangle=-60),
        yaxis=axis("Standard deviation, %"),
    )
    fig.layout.yaxis.update(type="log", dtick=1)
    names = [f"{f:.2f}" for f in modes.frequencies]
    fig.add_bar(
        x=names,
        y=f32(100 * std),
        name="frequency",
        marker_color=FE,
    )
    fig.add_bar(
        x=names,
        y=f32(100 * expected),
        name="damping",
        marker_color=MUTED,
    )
    return fig


def verified(rows: Sequence[Mapping[str, float]]) -> go.Figure:
    """Standard deviations of the ambient modes over frequency: planned as lines, found as marks;
    `rows` in percent.
    """
    x = hertz()
    fig = figure(430, xaxis=x, yaxis=axis("Standard deviation, %", type="log", dtick=1))
    f = f32(np.array([r["frequency_hz"] for r in rows]))
    for name, color in (("frequency", FE), ("damping", QUALITATIVE[4])):
        planned, found = (
            f32(np.array([r[f"{k}_{name}"] for r in rows]))
            for k in ("planned", "found")
        )
        line = {"width": 1.6, "color": color}
        fig.add_scatter(
            x=f,
            y=planned,
            mode="lines",
            line=line,
            name=f"{name}, planned",
        )
        fig.add_scatter(
            x=f,
            y=found,
            mode="markers",
            marker={"size": 7, "color": color},
            name="found",
        )
        fig.data[
            -1
        ].hovertemplate = f"%{{x:.3f}} Hz: {name} %{{y:.2g}} %<extra></extra>"
    return fig


def backbone(found: Backbone) -> go.Figure:
    """Frequency and damping ratio of a mode over its amplitude: measured as marks, fitted as
    lines.
    """
    left = axis("Frequency, Hz", domain=[0.55, 1.0])
    right = axis("Damping ratio, %", domain=[0.0, 0.42], anchor="x")
    fig = figure(
        360, xaxis=axis("Amplitude", type="log", anchor="y2"), yaxis=left, yaxis2=right
    )
    fig.update_layout(showlegend=False)
    for name, points, curve, factor, on in (
        ("frequency", found.frequency, found.fit_frequency, 1, "y"),
        ("damping", found.damping, found.fit_damping, 100, "y2"),
    ):
        x = f32(found.amplitude)
        mark = {"size": 5, "color": TEST}
        fig.add_scatter(
            x=x,
            y=f32(factor * points),
            yaxis=on,
            mode="markers",
            marker=mark,
            name=name,
        )
        line = {"width": 2, "color": FE}
        x = f32(found.fit_amplitude)
        fig.add_scatter(
            x=x, y=f32(factor * curve), yaxis=on, mode="lines", line=line, name="fit"
        )
    return fig


# of all poles in a page; beyond it those taken into modes have theirs
SHAPE_BYTES = 4_000_000


def picker_page(
    title: str, shown: IdentificationDiagram, test: TestModel | None = None
) -> str:
    """One self-contained HTML page: the diagram of the whole band, on which a click takes modes and
    poles up, a second one takes them out.

    Parameters
    ----------
    title : str
    shown : IdentificationDiagram
    test : TestModel, optional
        Where the channels are, for shapes in motion; bars over the channels without it.
    """
    parts = {
        "@TITLE@": html.escape(title),
        "@STYLE@": asset("viewer.css") + asset("diagram.css"),
        "@PLOTLY@": get_plotlyjs(),
        "@VIEWER@": viewer_script(),
        "@SCRIPT@": asset("diagram.js"),
        "@DATA@": script_json(_picker_data(shown, test)),
    }
    return re.sub("@[A-Z]+@", lambda place: parts[str(place[0])], asset("diagram.html"))


def _picker_data(shown: IdentificationDiagram, test: TestModel | None) -> str:
    """What the script of the page reads, as JSON."""
    peaks = len(shown.account.unexplained)
    channels = shown.modes.channels
    data = {
        "kinds": [name for name, *_ in POLES],
        "others": len(OTHERS),
        "colors": {name: color for name, color, _ in CLASSES},
        "summary": f"Peaks of the spectrum that nothing explains: {peaks}."
        if peaks
        else "",
        "modes": _mode_rows(shown),
        "channels": channels,
        "shape": packed(_parts(shown.modes.shapes), "<f4"),
        "poles": _packed_poles(shown),
    }
    if test is not None and set(channels) & set(test.channels):
        if not test.lines.size:  # the sheet gives none to draw
            lines = test.points[relative_neighbours(test.xyz, test.groups)]
            test = replace(test, lines=lines)
        place = {int(p): k for k, p in enumerate(test.points)}
        index, sign = test.find(channels, forces=False)
        data |= {
            "view": modes_view(None, test, []).payload,
            "geometry": {
                "point": [place[int(test.at[i])] if i >= 0 else -1 for i in index],
                "axes": (sign[:, None] * test.axes[index]).round(6).tolist(),
            },
        }
    figures = [
        identification_figure(shown, most=0),
        auto_mac(shown, height=340),
        _bars(len(channels)),
    ]
    drawn = ",".join(str(f.to_json()) for f in figures)
    text = to_json(data)
    return f'{text[:-1]},"figures":[{drawn}]}}'


def _mode_rows(shown: IdentificationDiagram) -> list[dict[str, object]]:
    columns = {
        "f": shown.modes.frequencies,
        "std_f": shown.uncertainty.frequency,
        "damping": shown.modes.damping,
        "std_damping": shown.uncertainty.damping,
        "mpc": shown.mpc,
        "confidence": shown.modes.confidence,
    }
    rows: list[dict[str, object]] = []
    for k, (kind, remark) in enumerate(zip(shown.classes, shown.remarks, strict=True)):
        values = {name: float(column[k]) for name, column in columns.items()}
        numbers = {name: x if np.isfinite(x) else None for name, x in values.items()}
        rows.append({**numbers, "class": kind, "remark": remark})
    return rows


def _packed_poles(shown: IdentificationDiagram) -> dict[str, str]:
    """The poles of all bands, those taken into modes first: these have their shapes in any case."""
    kind = np.concatenate([np.empty(0), *map(pole_kinds, shown.diagrams)])
    rank = np.argsort(-kind, kind="stable")
    frequency, order, damping, std = np.hstack(
        [np.empty((4, 0)), *map(_every_pole, shown.diagrams)]
    )
    sets = [p for d in shown.diagrams for p in (d.poles, *d.others)]
    n = len(shown.modes.channels)
    shape = np.zeros((n, 0))
    if sets and all(p.shape.shape[0] == n for p in sets):
        whole = 2 * n * kind.size <= SHAPE_BYTES
        taken = int((kind == CANDIDATE).sum())
        kept = rank if whole else rank[: min(taken, SHAPE_BYTES // (2 * n))]
        shape = np.concatenate([p.shape for p in sets], axis=1)[:, kept]
    columns = {
        "frequency": ("<f8", frequency),
        "order": ("<u2", order),
        "damping": ("<f4", damping),
        "std": ("<f4", std),
        "kind": ("u1", kind),
    }
    out = {name: packed(values[rank], form) for name, (form, values) in columns.items()}
    return out | {"shape": packed(np.round(127 * _parts(shape)), "i1")}


def _parts(shapes: Any_) -> Float:
    """(mode, channel, 2) real and imaginary parts, the largest component 1; 0 where unknown."""
    known = np.nan_to_num(shapes.astype(np.complex128))
    top = (
        np.argmax(np.abs(known), axis=0)[None]
        if known.size
        else np.empty((1, 0), np.int64)
    )
    largest = np.take_along_axis(known, top, axis=0)
    turned = known / np.where(largest == 0, 1.0, largest)
    return np.stack([turned.real, turned.imag], axis=-1).transpose(1, 0, 2)


def _bars(channels: int) -> go.Figure:
    """The axes of a shape over its channels."""
    fig = figure(
        300, xaxis=axis("", type="category", tickangle=-90 if channels > 6 else 0)
    )
    fig.update_layout(yaxis_range=[-1.1, 1.1], margin={"l": 40, "r": 8}, bargap=0.15)
    return fig
