"""The initial deck and the remodelled one against the test."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ringtrue.checks.mesh import mesh_errors
from ringtrue.core.arrays import Int
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress, part, quiet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.pairing import BEYOND_THE_GATE
from ringtrue.correlation.sensor_mounting import Mending, find_mendings
from ringtrue.correlation.table import CorrelationTable
from ringtrue.decks.nastran.edit import unified_diff
from ringtrue.errors import RingtrueError
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.config import StudyConfig
from ringtrue.study.evidence import channel_mass, evidence
from ringtrue.study.expansion import expanded, on_scene
from ringtrue.study.opened import Opened
from ringtrue.study.placing import between_nodes, readings, shared_places, words
from ringtrue.study.reference import (
    Reference,
    beyond,
    elastic_table,
    fewer,
    left_out,
    reference_modes,
    rigid_table,
    settings,
)
from ringtrue.study.results import CorrelateStage, Evidence, Expansion, RemodelStep
from ringtrue.study.workbench import OWN, Workbench

_log = logging.getLogger(__name__)
SOON = 2000  # nodes of a deck up to which its mesh error is looked at without being asked


def seen(desk: Workbench, opened: Opened, progress: Progress | None = None) -> ModeSet:
    """The modes of a model at all channels of the sheet."""
    modes = opened.modes(desk.fmax, progress).modes
    there = desk.bridge(opened)
    return ModeSet(
        modes.frequencies,
        modes.damping,
        there(modes.shapes),
        there.channels,
        modes.norm,
        modes.source,
    )


def judged(
    desk: Workbench, opened: Opened, reference: Reference, fe: ModeSet, table: CorrelationTable
) -> Evidence | None:
    """What an elastic correlation rests on, with the mass of the deck at the channels; None without
    measured shapes.
    """
    if desk.config.alone:
        return None
    config = desk.config.correlate
    observation = desk.bridge(opened)
    mass = channel_mass(opened, observation, reference.elastic.channels, config, desk.fmax)
    return evidence(reference, fe, table.pairing, desk.config, mass)


def run(desk: Workbench, progress: Progress) -> CorrelateStage:
    """Correlate twice."""
    config = desk.config
    reference = reference_modes(desk.get("identify"), config)
    out = left_out(reference.elastic, config.update.left_out, config.identify.confidence)
    initial = seen(desk, desk.initial, part(progress, 0.0, 0.3))
    progress(0.3, "remodelled deck")
    remodelled = seen(desk, desk.remodelled, part(progress, 0.3, 0.6))
    tables = [elastic_table(reference, fe, config, out, initial) for fe in (initial, remodelled)]
    progress(0.6, "mass at the channels")
    told = judged(desk, desk.remodelled, reference, remodelled, tables[1])
    first = (
        evidence(reference, initial, tables[0].pairing, config) if config.remodel and told else told
    )
    files = desk.initial.model.files, desk.remodelled.model.files
    return CorrelateStage(
        reference.elastic,
        reference.elastic_std,
        reference.rigid,
        reference.rigid_std,
        out,
        tables[0],
        tables[1],
        rigid_table(reference, initial, config),
        _reasons(config),
        unified_diff([Path(f) for f in files[0]], [Path(f) for f in files[1]]),
        initial,
        remodelled,
        first,
        told,
        words(desk.placed[0]) if config.correlate.align else "",
        _history(desk, reference, out, initial, tables),
        _expanded(desk, reference, progress),
        (
            *reference.gaps,
            *fewer(config.update.left_out, out),
            *beyond(reference.elastic, desk.fmax),
            *_shared(desk),
            *_mesh(desk, tables[1]),
            *_far(tables[1]),
        ),
        desk.seats(OWN, desk.bridge(desk.initial)),
        mendings(desk, desk.initial, desk.sheet(OWN), reference.elastic, desk.fmax),
    )


def mendings(
    desk: Workbench, opened: Opened, sheet: TestModel | None, test: ModeSet, fmax: float
) -> tuple[Mending, ...]:
    """Other mountings of the sensors on a sheet that explain a test better; none without a
    sheet.
    """
    if sheet is None:
        return ()
    modes = opened.modes(fmax).modes
    given = readings(test, modes, sheet, lambda there: desk.observed(opened, there, there.channels))
    return find_mendings(given, settings(desk.config))


def _mesh(desk: Workbench, table: CorrelationTable) -> tuple[str, ...]:
    """Which modes with a partner the mesh puts off, where that is soon known."""
    opened, paired = desk.remodelled, np.unique(table.pairing.b)
    if desk.engine is not None or len(opened.model["GRID"]) > SOON:
        return ()
    try:
        errors = mesh_errors(
            opened.model, opened.modes(desk.fmax).modes.take(paired), EmbeddedSolver()
        )
    except RingtrueError as e:  # a check is no reason for a study to end
        _log.info("mesh error: %s", e)
        return ()
    more = f": with `refine = {desk.deck.refine + 1}` under [model] the study refines it first"
    return (errors.in_words(paired + 1) + more,) if errors.off.size else ()


def _far(table: CorrelationTable) -> tuple[str, ...]:
    """Pairs beyond the frequency gate, and lone test modes that it keeps from one of the deck that
    looks alike.
    """
    p = table.pairing
    lone = zip(p.unpaired_a, p.reasons_a, strict=True)
    return (*p.far(), *(f"test mode {i + 1}: {w}" for i, w in lone if BEYOND_THE_GATE in w))


def _shared(desk: Workbench) -> tuple[str, ...]:
    """What is to be said of sensors at places with several nodes, and of those between nodes."""
    config = desk.config.correlate
    test = desk.placed[1] if config.align else desk.get("identify").test
    modes = desk.initial.modes(desk.fmax).modes
    apart = shared_places(desk.initial, test, modes) if config.match == "nearest" else ()
    return (*apart, *between_nodes(desk.initial, desk.bridge(desk.initial), config.match))


def _expanded(desk: Workbench, reference: Reference, progress: Progress) -> Expansion | None:
    """The elastic test shapes on the remodelled deck, drawn where its nodes are on the scene."""
    if not (method := desk.config.correlate.expand) or desk.config.alone:
        return None
    progress(0.8, "expansion of the test shapes")
    opened, test = desk.remodelled, reference.elastic
    found = expanded(method, opened, desk.bridge(opened), test, desk.fmax, quiet)
    return Expansion(method, on_scene(found, opened, test, desk.get("model").scene), found.misfit)


def _reasons(config: StudyConfig) -> str:
    steps = [s.reason for s in config.remodel]
    return (
        steps[0]
        if len(steps) == 1
        else "; ".join(f"{i}. {reason}" for i, reason in enumerate(steps, start=1))
    )


def _history(
    desk: Workbench,
    reference: Reference,
    out: Int,
    initial: ModeSet,
    ends: Sequence[CorrelationTable],
) -> tuple[RemodelStep, ...]:
    """The initial deck and that after each step, against the test."""
    if not desk.config.remodel:
        return ()
    between = [
        elastic_table(reference, seen(desk, o), desk.config, out, initial) for o in desk.steps[1:-1]
    ]
    names = ("the initial deck", *(s.reason for s in desk.config.remodel))
    return tuple(
        RemodelStep(
            reason=n,
            pairs=len(t),
            mean_deviation=t.mean_deviation(),
            max_deviation=t.max_deviation(),
            mean_mac=t.mean_mac(),
            mean_subspace_mac=t.mean_subspace_mac(),
        )
        for n, t in zip(names, (ends[0], *between, ends[1]), strict=True)
    )
