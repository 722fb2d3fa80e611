"""Drawings of results, registered for their `.plot()`; `core.display` imports this on first use."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from ringtrue.core.display import drawing
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import FrfSet, TimeHistory
from ringtrue.correlation.table import CorrelationTable
from ringtrue.identification.ambient.decay_backbone import Backbone
from ringtrue.identification.common.diagram import IdentificationDiagram
from ringtrue.plots.correlation import table_matrix
from ringtrue.plots.diagram import backbone, identification_figure
from ringtrue.plots.signals import responses
from ringtrue.plots.style import figure

MOST_CHANNELS = 12  # of a record in one figure
MOST_SAMPLES = 4000  # of a channel in one figure


@drawing(CorrelationTable)
def mac_matrix(table: CorrelationTable) -> go.Figure:
    """The MAC of all combinations."""
    return table_matrix(table)


@drawing(IdentificationDiagram)
def identification(shown: IdentificationDiagram) -> go.Figure:
    """Poles, spectrum, modes of each class and their damping over the whole band."""
    return identification_figure(shown)


@drawing(Backbone)
def backbone_curves(found: Backbone) -> go.Figure:
    """Frequency and damping ratio over amplitude."""
    return backbone(found)


@drawing(FrfSet)
def frf_curves(frfs: FrfSet) -> go.Figure:
    """Modulus and phase of the responses to the first force."""
    return responses(frfs, 0)


@drawing(ModeSet)
def mode_shapes(modes: ModeSet) -> go.Figure:
    """The real part of each shape over its channels, a line a mode."""
    drawn = figure()
    for k, f in enumerate(modes.frequencies):
        shape = modes.shapes[:, k].real
        largest = np.abs(shape).max(initial=0.0) or 1.0
        drawn.add_scatter(
            x=list(modes.channels),
            y=shape / largest,
            name=f"{k + 1}: {f:.4g} Hz",
        )
    return drawn


@drawing(TimeHistory)
def signals(record: TimeHistory) -> go.Figure:
    """The first channels over time, s."""
    drawn = figure()
    step = max(1, record.data.shape[1] // MOST_SAMPLES)
    time = np.arange(0, record.data.shape[1], step) / record.rate
    for channel, samples in zip(
        record.channels[:MOST_CHANNELS], record.data, strict=False
    ):
        drawn.add_scatter(
            x=time,
            y=samples[::step],
            name=f"{channel.id} [{channel.unit}]",
        )
    return drawn
