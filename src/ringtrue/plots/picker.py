"""The page of a diagram: modes and poles are taken up by a click, their shapes move."""

from __future__ import annotations

import html
import re
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.testmodel import TestModel
from ringtrue.identification.common.diagram import IdentificationDiagram
from ringtrue.planning.geometry import relative_neighbours
from ringtrue.plots.diagram import CLASSES, POLES, auto_mac, identification_figure, pole_kinds
from ringtrue.plots.scene import modes as modes_view
from ringtrue.plots.style import axis, figure, packed
from ringtrue.viewer.encoding import asset, script_json, to_json, viewer_script

SHAPE_BYTES = 4_000_000  # of all poles in a page; beyond it those taken into modes have theirs


def picker_page(title: str, shown: IdentificationDiagram, test: TestModel | None = None) -> str:
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
        "kinds": [name for name, _, _ in POLES],
        "colors": {name: color for name, color, _ in CLASSES},
        "summary": f"Peaks of the spectrum that nothing explains: {peaks}." if peaks else "",
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
    sets = [d.poles for d in shown.diagrams]
    empty = np.empty(0)
    kind = np.concatenate([empty, *map(pole_kinds, shown.diagrams)])
    rank = np.argsort(-kind, kind="stable")
    n = len(shown.modes.channels)
    shape = np.zeros((n, 0))
    if sets and all(p.shape.shape[0] == n for p in sets):
        whole = 2 * n * kind.size <= SHAPE_BYTES
        kept = rank if whole else rank[: min(int((kind == 2).sum()), SHAPE_BYTES // (2 * n))]
        shape = np.concatenate([p.shape for p in sets], axis=1)[:, kept]
    columns = {
        "frequency": ("<f8", np.concatenate([empty, *(p.frequencies for p in sets)])),
        "order": ("<u2", np.concatenate([empty, *(p.order for p in sets)])),
        "damping": ("<f4", np.concatenate([empty, *(p.damping for p in sets)])),
        "std": ("<f4", np.concatenate([empty, *(p.std_frequency for p in sets)])),
        "kind": ("u1", kind),
    }
    out = {name: packed(values[rank], form) for name, (form, values) in columns.items()}
    return out | {"shape": packed(np.round(127 * _parts(shape)), "i1")}


def _parts(shapes: Any_) -> Float:
    """(mode, channel, 2) real and imaginary parts, the largest component 1; 0 where unknown."""
    known = np.nan_to_num(shapes.astype(np.complex128))
    top = np.argmax(np.abs(known), axis=0)[None] if known.size else np.empty((1, 0), np.int64)
    largest = np.take_along_axis(known, top, axis=0)
    turned = known / np.where(largest == 0, 1.0, largest)
    return np.stack([turned.real, turned.imag], axis=-1).transpose(1, 0, 2)


def _bars(channels: int) -> go.Figure:
    """The axes of a shape over its channels."""
    fig = figure(300, xaxis=axis("", type="category", tickangle=-90 if channels > 6 else 0))
    fig.update_layout(yaxis_range=[-1.1, 1.1], margin={"l": 40, "r": 8}, bargap=0.15)
    return fig
