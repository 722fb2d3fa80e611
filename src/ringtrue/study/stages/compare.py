"""Ambient against hammer modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.progress import Progress
from ringtrue.correlation.measures import complete
from ringtrue.correlation.pairing import pair_modes
from ringtrue.correlation.table import correlation_table
from ringtrue.shapes.mac import auto_mac
from ringtrue.study.reference import elastic_edge, settings, without_gaps
from ringtrue.study.results import CompareStage, Evidence, IdentifyStage
from ringtrue.study.workbench import Workbench


def run(desk: Workbench, progress: Progress) -> CompareStage | None:
    """Pair the elastic modes of the two tests on their common channels; None if one is missing or
    none is common.
    """
    found: IdentifyStage = desk.get("identify")
    if found.hammer is None or found.hammer_uncertainty is None or not len(found.ambient):
        return None
    edge = elastic_edge(found.ambient.frequencies, desk.config)
    every = ((found.ambient, found.ambient_uncertainty), (found.hammer, found.hammer_uncertainty))
    (ambient, u), (hammer, v) = (
        without_gaps(m, std, np.flatnonzero(m.frequencies >= edge)) for m, std in every
    )
    common = [c for c in ambient.channels if c in set(hammer.channels)]
    if not common:
        return None
    a, b = ambient.rows(common), hammer.rows(common)
    names = ("ambient", "hammer")
    gates = replace(settings(desk.config), reach=1.0)  # of one structure
    pairing = pair_modes(a, b, gates, names=names)
    measures = complete(a, b, pairing, std_a=u.frequency, std_b=v.frequency, settings=gates)
    return CompareStage(
        correlation_table(a, b, pairing, std_hz=u.frequency, names=names),
        Evidence(measures, auto_mac(a.shapes)),
    )
