"""The deck as delivered and after the stated remodelling against the test."""

from __future__ import annotations

from pathlib import Path

from ringtrue.core.modes import ModeSet
from ringtrue.io.nastran.edit import unified_diff
from ringtrue.study.opened import Opened, Progress
from ringtrue.study.reference import elastic_table, left_out, reference_modes, rigid_table
from ringtrue.study.results import CorrelateStage
from ringtrue.study.workbench import Workbench


def seen(desk: Workbench, opened: Opened) -> ModeSet:
    """The modes of a model at all channels of the sheet."""
    modes = opened.modes(desk.deck.fmax).modes
    return opened.seen(modes, desk.get("identify").test, desk.config.correlate.tolerance)


def run(desk: Workbench, progress: Progress) -> CorrelateStage:
    """Correlate twice."""
    config = desk.config
    reference = reference_modes(desk.get("identify"), config)
    out = left_out(reference.elastic, config.update.left_out, config.identify.confidence)
    initial = seen(desk, desk.initial)
    progress(0.3, "remodelled deck")
    remodelled = seen(desk, desk.remodelled)
    files = desk.initial.model.files, desk.remodelled.model.files
    return CorrelateStage(
        reference.elastic,
        reference.elastic_std,
        reference.rigid,
        reference.rigid_std,
        out,
        elastic_table(reference, initial, config, out),
        elastic_table(reference, remodelled, config, out),
        rigid_table(reference, initial, config),
        config.remodel.reason if config.remodel else "",
        unified_diff([Path(f) for f in files[0]], [Path(f) for f in files[1]]),
        initial,
        remodelled,
    )
