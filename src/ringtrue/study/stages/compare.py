"""Ambient against hammer modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.correlate.complete import complete
from ringtrue.correlate.pairing import pair_modes
from ringtrue.correlate.table import correlation_table
from ringtrue.shapes.mac import auto_mac
from ringtrue.study.reference import elastic_edge, measured_part, settings
from ringtrue.study.results import CompareStage, Evidence, IdentifyStage
from ringtrue.study.workbench import Workbench


def run(desk: Workbench, progress: Progress) -> CompareStage | None:
    """Pair the elastic modes of the two tests on their common channels; None if one is missing or none is common."""
    found: IdentifyStage = desk.get("identify")
    if found.hammer is None or found.hammer_uncertainty is None or not len(found.ambient):
        return None
    edge = elastic_edge(found.ambient.frequencies, desk.config)
    ambient, std = _elastic(found.ambient, found.ambient_uncertainty, edge)
    hammer, std_hammer = _elastic(found.hammer, found.hammer_uncertainty, edge)
    common = [c for c in ambient.channels if c in set(hammer.channels)]
    if not common:
        return None
    a, b = ambient.rows(common), hammer.rows(common)
    names = ("ambient", "hammer")
    gates = replace(settings(desk.config), reach=1.0)  # of one structure
    pairing = pair_modes(a, b, gates, names=names)
    measures = complete(a, b, pairing, std_a=std, std_b=std_hammer, settings=gates)
    return CompareStage(
        correlation_table(a, b, pairing, std_hz=std, names=names), Evidence(measures, auto_mac(a.shapes))
    )


def _elastic(modes: ModeSet, std: Uncertainty, edge: float) -> tuple[ModeSet, Float]:
    """The modes above the edge that have no gap, at the channels where they have none, and their scatter, Hz."""
    high = np.flatnonzero(modes.frequencies >= edge)
    at, channels = measured_part(modes.take(high))
    return modes.take(high[at]).rows(channels), std.frequency[high[at]]
