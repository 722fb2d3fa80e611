"""Test against test, and decks against tests: of the study and of other configurations."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.checks.mesh import mesh_errors
from ringtrue.core.arrays import Int
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress, part, quiet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.measures import complete
from ringtrue.correlation.pairing import pair_modes
from ringtrue.correlation.sensor_mounting import Mending, find_mendings
from ringtrue.correlation.table import CorrelationTable, correlation_table
from ringtrue.decks.nastran.editor import unified_diff
from ringtrue.errors import ConfigError, InputError, RingtrueError, about
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.model.edit import apply_factors, carried, field_value
from ringtrue.model.model import Model
from ringtrue.shapes.mac import auto_mac
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.config import StudyConfig
from ringtrue.study.config_sections import ConfigurationSection, TestSection
from ringtrue.study.evidence import channel_mass, evidence, expanded, on_scene
from ringtrue.study.opened import Opened
from ringtrue.study.placing import alignment_text, between_nodes, readings, seats, shared_places
from ringtrue.study.reference import (
    Reference,
    beyond,
    elastic_edge,
    elastic_table,
    fewer,
    left_out,
    reference_modes,
    reference_of_file,
    rigid_table,
    settings,
    without_gaps,
)
from ringtrue.study.results import (
    CompareStage,
    ConfigurationsStage,
    ConfiguredTest,
    CorrelateStage,
    Evidence,
    Expansion,
    IdentifyStage,
    RemodelStep,
)
from ringtrue.study.session import OWN, Session
from ringtrue.study.stages import identify
from ringtrue.study.supplied import modes_by_sheet


def compare_tests(session: Session, progress: Progress) -> CompareStage | None:
    """Pair the elastic modes of the two tests on their common channels; None if one is missing or
    none is common.
    """
    found: IdentifyStage = session.get("identify")
    if found.hammer is None or found.hammer_uncertainty is None or not len(found.ambient):
        return None
    edge = elastic_edge(found.ambient.frequencies, session.config)
    every = ((found.ambient, found.ambient_uncertainty), (found.hammer, found.hammer_uncertainty))
    (ambient, u), (hammer, v) = (
        without_gaps(m, std, np.flatnonzero(m.frequencies >= edge)) for m, std in every
    )
    common = [c for c in ambient.channels if c in set(hammer.channels)]
    if not common:
        return None
    a, b = ambient.rows(common), hammer.rows(common)
    names = ("ambient", "hammer")
    gates = replace(settings(session.config), reach=1.0)  # of one structure
    pairing = pair_modes(a, b, gates, names=names)
    measures = complete(a, b, pairing, std_a=u.frequency, std_b=v.frequency, settings=gates)
    return CompareStage(
        correlation_table(a, b, pairing, std_hz=u.frequency, names=names),
        Evidence(measures, auto_mac(a.shapes)),
    )


_log = logging.getLogger(__name__)
SOON = 2000  # nodes of a deck up to which its mesh error is looked at without being asked


def modes_at_sheet(session: Session, opened: Opened, progress: Progress | None = None) -> ModeSet:
    """The modes of a model at all channels of the sheet."""
    modes = opened.modes(session.fmax, progress).modes
    there = session.bridge(opened)
    return ModeSet(
        frequencies=modes.frequencies,
        damping=modes.damping,
        shapes=there(modes.shapes),
        labels=there.channels,
        norm=modes.norm,
        source=modes.source,
    )


def elastic_evidence(
    session: Session, opened: Opened, reference: Reference, fe: ModeSet, table: CorrelationTable
) -> Evidence | None:
    """What an elastic correlation rests on, with the mass of the deck at the channels; None without
    measured shapes.
    """
    if session.config.frequency_only:
        return None
    config = session.config.correlate
    observation = session.bridge(opened)
    mass = channel_mass(opened, observation, reference.elastic.channels, config, session.fmax)
    return evidence(reference, fe, table.pairing, session.config, mass)


def correlate(session: Session, progress: Progress) -> CorrelateStage:
    """Correlate twice."""
    config = session.config
    reference = reference_modes(session.get("identify"), config)
    out = left_out(reference.elastic, config.update.left_out, config.identify.confidence)
    initial = modes_at_sheet(session, session.initial, part(progress, 0.0, 0.3))
    progress(0.3, "remodelled deck")
    remodelled = modes_at_sheet(session, session.remodelled, part(progress, 0.3, 0.6))
    tables = [elastic_table(reference, fe, config, out, initial) for fe in (initial, remodelled)]
    progress(0.6, "mass at the channels")
    told = elastic_evidence(session, session.remodelled, reference, remodelled, tables[1])
    first = (
        evidence(reference, initial, tables[0].pairing, config) if config.remodel and told else told
    )
    files = session.initial.model.files, session.remodelled.model.files
    return CorrelateStage(
        reference=reference.elastic,
        reference_uncertainty=reference.elastic_std,
        rigid=reference.rigid,
        rigid_uncertainty=reference.rigid_std,
        left_out=out,
        initial=tables[0],
        remodelled=tables[1],
        rigid_initial=rigid_table(reference, initial, config),
        remodelling=_remodel_reasons(config),
        diff=unified_diff([Path(f) for f in files[0]], [Path(f) for f in files[1]]),
        fe_initial=initial,
        fe_remodelled=remodelled,
        evidence_initial=first,
        evidence=told,
        placed=alignment_text(session.placed[0]) if config.correlate.align else "",
        history=_history(session, reference, out, initial, tables),
        expanded=_expanded(session, reference, progress),
        gaps=(
            *reference.gaps,
            *fewer(config.update.left_out, out),
            *beyond(reference.elastic, session.fmax),
            *_shared_places(session),
            *_mesh(session, tables[1]),
            *_beyond_gate(tables[1]),
        ),
        seats=session.seats(OWN, session.bridge(session.initial)),
        mendings=mendings(
            session, session.initial, session.sheet(OWN), reference.elastic, session.fmax
        ),
    )


def mendings(
    session: Session, opened: Opened, sheet: TestModel | None, test: ModeSet, fmax: float
) -> tuple[Mending, ...]:
    """Other mountings of the sensors on a sheet that explain a test better; none without a
    sheet.
    """
    if sheet is None:
        return ()
    modes = opened.modes(fmax).modes
    given = readings(
        test, modes, sheet, lambda there: session.observed(opened, there, there.channels)
    )
    return find_mendings(given, settings(session.config))


def _mesh(session: Session, table: CorrelationTable) -> tuple[str, ...]:
    """Which modes with a partner the mesh puts off, where that is soon known."""
    opened, paired = session.remodelled, np.unique(table.pairing.b)
    if session.engine is not None or len(opened.model["GRID"]) > SOON:
        return ()
    try:
        errors = mesh_errors(
            opened.model, opened.modes(session.fmax).modes.take(paired), EmbeddedSolver()
        )
    except RingtrueError as e:  # a check is no reason for a study to end
        _log.info("mesh error: %s", e)
        return ()
    more = f": with `refine = {session.deck.refine + 1}` under [model] the study refines it first"
    return (errors.in_words(paired + 1) + more,) if errors.off.size else ()


def _beyond_gate(table: CorrelationTable) -> tuple[str, ...]:
    """Pairs beyond the frequency gate, and unpaired test modes that it keeps from one of the deck
    that looks alike.
    """
    p = table.pairing
    unpaired = zip(p.unpaired_a, p.reasons_a, p.gated_a, strict=True)
    return (*p.far(), *(f"test mode {i + 1}: {why}" for i, why, gated in unpaired if gated))


def _shared_places(session: Session) -> tuple[str, ...]:
    """What is to be said of sensors at places with several nodes, and of those between nodes."""
    config = session.config.correlate
    test = session.placed[1] if config.align else session.get("identify").test
    modes = session.initial.modes(session.fmax).modes
    apart = shared_places(session.initial, test, modes) if config.match == "nearest" else ()
    return (*apart, *between_nodes(session.initial, session.bridge(session.initial), config.match))


def _expanded(session: Session, reference: Reference, progress: Progress) -> Expansion | None:
    """The elastic test shapes on the remodelled deck, drawn where its nodes are on the scene."""
    if not (method := session.config.correlate.expand) or session.config.frequency_only:
        return None
    progress(0.8, "expansion of the test shapes")
    opened, test = session.remodelled, reference.elastic
    found = expanded(
        method, opened, look=session.bridge(opened), test=test, fmax=session.fmax, progress=quiet
    )
    return Expansion(
        method, on_scene(found, opened, test, session.get("model").scene), found.misfit
    )


def _remodel_reasons(config: StudyConfig) -> str:
    steps = [s.reason for s in config.remodel]
    return (
        steps[0]
        if len(steps) == 1
        else "; ".join(f"{i}. {reason}" for i, reason in enumerate(steps, start=1))
    )


def _history(
    session: Session,
    reference: Reference,
    out: Int,
    initial: ModeSet,
    ends: Sequence[CorrelationTable],
) -> tuple[RemodelStep, ...]:
    """The initial deck and that after each step, against the test."""
    if not session.config.remodel:
        return ()
    between = [
        elastic_table(reference, modes_at_sheet(session, o), session.config, out, initial)
        for o in session.steps[1:-1]
    ]
    names = ("the initial deck", *(s.reason for s in session.config.remodel))
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


SAME = 1e-6  # relative difference of a field that is none


def correlate_configurations(session: Session, progress: Progress) -> ConfigurationsStage:
    """Identify or read the modes of each configuration, and correlate its deck with them."""
    items, n = [], len(session.config.configuration)
    for i, section in enumerate(session.config.configuration):
        told = part(progress, i / n, (i + 1) / n)
        told(0.0, f"configuration {section.name}")
        items.append(_correlated(session, section, told))
    return ConfigurationsStage(tuple(items))


def configuration_files(session: Session) -> list[Path]:
    """All inputs of the stage beside the deck of the study."""
    out: list[Path] = []
    for c in session.config.configuration:
        names = (c.cards, c.sheet, c.log, c.modes, c.lines, c.choice)
        out += [session.base / f for f in names if f]
        out += [Path(f) for f in session.configured(c).model.files] if c.deck else []
        out += identify.files(_with_test_of(session, c)) if c.log else []
    return list(dict.fromkeys(out))


def _with_test_of(session: Session, section: ConfigurationSection) -> Session:
    """The same study with the test of a configuration in place of its own."""
    test = TestSection(sheet=str(section.sheet), log=str(section.log), lines=section.lines)
    choice = session.config.identify.model_copy(update={"choice": section.choice})
    config = session.config.model_copy(update={"test": test, "identify": choice})
    return Session(config, session.base, session.out, session.store)


def _correlated(
    session: Session, section: ConfigurationSection, progress: Progress
) -> ConfiguredTest:
    opened = session.configured(section)
    parameters = ParameterSet(
        (*session.config.candidates().parameters, *session.config.suspensions().parameters)
    )
    mine = carried(opened.model, parameters)
    _check_parameters(section, opened.model, parameters, mine)
    reference, test, source = _test_modes(session, section, part(progress, 0.0, 0.7))
    progress(0.8, f"modes of the deck of {section.name}")
    fe = modes_at_channels(session, opened, test, reference.elastic)
    out = left_out(reference.elastic, section.left_out, session.config.identify.confidence)
    return ConfiguredTest(
        name=section.name,
        files=tuple(opened.model.files),
        source=source,
        test=test,
        reference=reference.elastic,
        reference_uncertainty=reference.elastic_std,
        rigid=reference.rigid,
        rigid_uncertainty=reference.rigid_std,
        left_out=out,
        initial=elastic_table(reference, fe, session.config, out),
        fe_initial=fe,
        carried=mine.names,
        notes=_field_differences(session.remodelled.model, opened.model, parameters, mine),
        seats=() if test is None else seats(session.observed(opened, test, test.channels), test),
        mendings=mendings(
            session, opened, test, reference.elastic, session.up_to(reference.elastic.frequencies)
        ),
    )


def _test_modes(
    session: Session, section: ConfigurationSection, progress: Progress
) -> tuple[Reference, TestModel | None, str]:
    """The test modes, the sheet, and where they come from in alignment_text."""
    if section.modes is not None:
        path = session.base / section.modes
        found = reference_of_file(path, session.config)
        test = read_sensor_sheet(session.base / section.sheet).model if section.sheet else None
        source = f"{len(found.elastic)} modes of {path.name}"
        if test is not None:
            elastic, told = modes_by_sheet(found.elastic, test, path)
            rigid, _ = modes_by_sheet(found.rigid, test, path)
            found = replace(found, elastic=elastic, rigid=rigid)
            source = "; ".join((source, *told))
        return found, test, source
    at = _with_test_of(session, section)
    with about(session.base / str(section.log)):
        done = identify.run(at, progress)
        found = reference_modes(done, at.config)
    return found, done.test, f"{len(found.elastic)} modes of {len(done.records)} records"


def modes_at_channels(
    session: Session, opened: Opened, test: TestModel | None, reference: ModeSet
) -> ModeSet:
    """The modes of a deck at the channels of the test modes of a configuration."""
    modes = opened.modes(session.up_to(reference.frequencies)).modes
    look = session.observed(opened, test, reference.channels if test is None else test.channels)
    there = ModeSet(
        frequencies=modes.frequencies,
        damping=modes.damping,
        shapes=look(modes.shapes),
        labels=look.channels,
        norm=modes.norm,
        source=modes.source,
    )
    return there.rows(list(reference.channels))


def _check_parameters(
    section: ConfigurationSection, model: Model, every: ParameterSet, mine: ParameterSet
) -> None:
    """A deck that carries no candidate, or one that cannot be scaled, is found before the work."""
    if len(every) and not len(mine):
        fields = ", ".join(
            sorted({f"{t.card} {t.id}" for p in every.parameters for t in p.targets})
        )
        raise ConfigError(
            f"configuration {section.name}: its deck has no card of a candidate ({fields})"
        )
    try:
        apply_factors(model, mine, np.ones(len(mine)))
    except InputError as e:
        raise ConfigError(f"configuration {section.name}: {e}") from e


def _field_differences(
    base: Model, model: Model, every: ParameterSet, mine: ParameterSet
) -> tuple[str, ...]:
    """Fields of candidates that its deck lacks, or has with another value than the deck of the
    study.
    """
    out, have = [], {p.name: len(p.targets) for p in mine.parameters}
    for p in every.parameters:
        if not (count := have.get(p.name, 0)):
            out.append(f"its deck has no field of {p.name}, which does not act here")
        elif count < len(p.targets):
            out.append(f"its deck has {count} of the {len(p.targets)} fields of {p.name}")
    for t in (t for p in mine.parameters for t in p.targets):
        here, there = float(field_value(model, t)), float(field_value(base, t))
        if abs(here - there) > SAME * abs(there):
            out.append(
                f"{t.card} {t.id} {t.field} is {here:.6g} here and {there:.6g} in the deck of "
                "the study"
            )
    return tuple(out)
