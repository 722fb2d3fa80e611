"""Records, spectra and frequency response functions."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.arrays import Float
from ringtrue.core.channels import FORCES, LINEAR
from ringtrue.core.signals import FrfSet
from ringtrue.plots.style import (
    FINAL,
    INITIAL,
    QUALITATIVE,
    TEST,
    above_and_below,
    axis,
    f32,
    figure,
    joined,
    log_axis,
    rule,
    thinned,
    thinned_log,
)
from ringtrue.study.results import ComparedFrfs, RecordPreview

PHASE = {"(m/s²)/N": 90, "(m/s)/N": 0, "m/N": -90}  # of a driving point at resonance, degrees
_FRF_UNITS = {"accelerance": "(m/s²)/N", "mobility": "(m/s)/N", "receptance": "m/N"}


def frf_unit(data: FrfSet) -> str:
    """Of its values; of transmissibilities 1."""
    if not all(c.quantity in FORCES for c in data.inputs):
        return "1"
    turns = any(c.quantity in LINEAR for c in (*data.outputs, *data.inputs))
    return "SI" if turns else _FRF_UNITS[data.kind]


def record(preview: RecordPreview, unit: str) -> go.Figure:
    """Time previews on the left, power spectral densities on the right; `unit` of the channels,
    empty if mixed.
    """
    unit = unit or "SI unit"
    ok = preview.freqs > 0
    names = preview.channels[:1] if unit == "N" else preview.channels  # the rest are not forces
    fig = figure(
        250,
        showlegend=True,
        xaxis=axis("Time, s", domain=[0, 0.41]),
        yaxis=axis(unit, exponentformat="power"),
        xaxis2=axis(
            "Frequency, Hz",
            type="log",
            domain=[0.59, 1],
            anchor="y2",
            dtick=1,
        ),
        yaxis2=log_axis(
            f"PSD, {unit if unit.isalpha() else f'({unit})'}²/Hz",
            anchor="x2",
            dtick=2,
            **_decades(preview.psd[: len(names)][:, ok]),
        ),
    )
    for i, name in enumerate(names):
        line = {"width": 0.9, "color": QUALITATIVE[i % 8]}
        x = f32(preview.time)
        y = f32(preview.signal[i])
        fig.add_scatter(
            x=x,
            y=y,
            name=name,
            line=line,
            legendgroup=name,
            opacity=0.85,
        )
        x, y = (f32(a) for a in thinned_log(preview.freqs[ok], preview.psd[i][ok], 500))
        fig.add_scatter(
            x=x,
            y=y,
            line=line,
            xaxis="x2",
            yaxis="y2",
            legendgroup=name,
            showlegend=False,
            name=name,
        )
    return fig


def _decades(psd: Float) -> dict[str, list[float]]:
    """A range of at most ten decades below the peak: the roll-off of a filter is not what the
    reader looks for.
    """
    if not psd.size or not psd.max() > 0:
        return {}
    top = float(np.log10(psd.max()))
    low = float(np.log10(max(psd[psd > 0].min(), 10 ** (top - 10))))
    return {"range": [low - 0.3, top + 0.4]}


def frfs(data: FrfSet, cmif: Float, marks: Float, top: float = np.inf) -> go.Figure:
    """Imaginary parts of all FRFs over one another, the CMIF below, up to `top` Hz; `marks` (m,) Hz
    are modes.
    """
    shown = data.freqs <= top
    fig = figure(
        560,
        xaxis=axis(
            domain=[0, 1],
            anchor="y",
            matches="x2",
            showticklabels=False,
        ),
        yaxis=axis(f"Im H, {frf_unit(data)}", domain=[0.5, 1], exponentformat="power"),
        xaxis2=axis("Frequency, Hz", anchor="y2"),
        yaxis2=log_axis(
            f"CMIF, {frf_unit(data)}",
            domain=[0, 0.44],
            anchor="x2",
            dtick=1,
        ),
    )
    for j, c in enumerate(data.inputs):
        at, imaginary = thinned(data.data[shown, :, j].imag.T, 600)
        x, y = joined(data.freqs[shown][at], imaginary)
        line = {"width": 0.6, "color": QUALITATIVE[j % 8]}
        fig.add_scatter(
            x=x,
            y=y,
            line=line,
            opacity=0.65,
            name=f"force at {c.id}" if c.quantity == "force" else c.id,
            hoverinfo="skip",
        )
        fig.data[-1].meta = {"overlay": data.data.shape[1]}
    for j in range(cmif.shape[1]):
        at, y = thinned(cmif[shown, j][None], 1500)
        line = {"width": 1.4 if j == 0 else 1.0, "color": QUALITATIVE[j % 8]}
        x = f32(data.freqs[shown][at])
        fig.add_scatter(
            x=x,
            y=f32(y[0]),
            line=line,
            xaxis="x2",
            yaxis="y2",
            name=f"σ{j + 1}",
            showlegend=False,
        )
    faint = {"width": 0.8, "color": "#8b97a3", "dash": "dot"}
    fig.update_layout(
        shapes=[rule(f, 0.44, xref="x2", line=faint) for f in marks[marks <= top].tolist()]
    )
    return fig


def frf_pair(frfs: ComparedFrfs, k: int, unit: str) -> go.Figure:
    """One measured FRF with the model's before and after, modulus and phase."""
    middle = PHASE.get(unit, 0)
    ticks = [middle - 180, middle, middle + 180]
    fig = figure(
        300,
        title={
            "text": frfs.channels[k],
            "x": 0.99,
            "xanchor": "right",
            "y": 0.97,
            "font": {"size": 13},
        },
        xaxis=axis(
            anchor="y",
            matches="x2",
            showticklabels=False,
        ),
        yaxis=log_axis(f"|H|, {unit}", domain=[0.36, 1], dtick=1),
        xaxis2=axis("Frequency, Hz", anchor="y2"),
        yaxis2=axis(
            "Phase, °",
            domain=[0, 0.28],
            anchor="x2",
            tickvals=ticks,
            range=[ticks[0] - 10, ticks[-1] + 10],
        ),
    )
    for name, h, color, width in (
        ("initial model", frfs.initial, INITIAL, 1.2),
        ("test", frfs.test, TEST, 1.2),
        ("final model", frfs.final, FINAL, 1.6),
    ):
        line = {"color": color, "width": width}
        modulus = np.maximum(np.abs(h[:, k]), 1e-300)
        phase = (np.degrees(np.angle(h[:, k])) - ticks[0]) % 360 + ticks[0]
        above_and_below(
            fig,
            name,
            line,
            x=frfs.freqs,
            upper=modulus,
            lower=phase,
        )
    return fig
