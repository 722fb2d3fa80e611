"""Figures as JSON; many curves over one abscissa in a sixth of the room."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Any_


def figure_json(figure: go.Figure) -> str:
    """The JSON of a figure; traces whose `meta` says `overlay: n` (see plots.style.joined) are
    packed.

    The page unfolds them: the abscissa is stored once, ordinates as 16-bit parts of the largest.
    """
    text = str(figure.to_json())
    marked = [
        i for i, t in enumerate(figure.data) if isinstance(t.meta, dict) and "overlay" in t.meta
    ]
    if not marked:
        return text
    spec = json.loads(text)
    for i in marked:
        trace = figure.data[i]
        spec["data"][i] |= _packed(
            np.asarray(trace.x), np.asarray(trace.y), int(trace.meta["overlay"])
        )
    return json.dumps(spec, separators=(",", ":"), allow_nan=False)


def _packed(x: Any_, y: Any_, curves: int) -> dict[str, Any]:
    rows = np.nan_to_num(y.reshape(curves, -1)[:, :-1])
    peak = float(np.abs(rows).max(initial=0.0)) or 1.0
    meta = {
        "x": _base64(x.reshape(curves, -1)[0, :-1], "<f4"),
        "q": _base64(np.round(rows * (32767 / peak)), "<i2"),
        "peak": peak,
    }
    return {"x": [], "y": [], "meta": meta}


def _base64(a: Any_, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(a, dtype=kind).tobytes()).decode("ascii")
