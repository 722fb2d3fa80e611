"""Test against test, and decks against tests: of the study and of other configurations."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.checks.mesh import mesh_errors
from ringtrue.core.iterate import Progress, part
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import CardField, ParameterSet, is_matrix
from ringtrue.core.side_by_side import side_by_side
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.channel_faults import rigid_suspects
from ringtrue.correlation.measures import complete
from ringtrue.correlation.pairing import pair_modes
from ringtrue.correlation.sensor_mounting import find_mendings
from ringtrue.correlation.table import CorrelationTable, correlation_table
from ringtrue.decks.nastran.editor import unified_diff
from ringtrue.errors import ConfigError, InputError, RingtrueError, about
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.model.edit import apply_factors, carried, field_value, resolve_target
from ringtrue.model.model import Model
from ringtrue.shapes import auto_mac
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.config_sections import ConfigurationSection, TestSection
from ringtrue.study.evidence import channel_mass, evidence, expanded, on_scene
from ringtrue.study.opened import Opened
from ringtrue.study.placing import (
    alignment_text,
    between_nodes,
    readings,
    seats,
    shared_places,
)
from ringtrue.study.reference import (
    beyond,
    elastic_edge,
    elastic_table,
    fewer,
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
    ReferenceModes,
    Remodelling,
    RemodelStep,
    SensorPlacement,
)
from ringtrue.study.session import Session, StudyConfiguration
from ringtrue.study.stages import identify
from ringtrue.study.supplied import modes_by_sheet

_log = logging.getLogger(__name__)

SMALL_DECK_NODES = 2000  # up to which the mesh error is looked at without being asked


def compare_tests(session: Session, progress: Progress) -> CompareStage | None:
    """Pair the elastic modes of the two tests on their common channels; None if one is missing or
    none is common.
    """
    found: IdentifyStage = session.get("identify")
    if found.hammer is None or not len(found.ambient):
        return None
    edge = elastic_edge(found.ambient.modes.frequencies, session.config)
    (ambient, u), (hammer, v) = (
        without_gaps(x, np.flatnonzero(x.modes.frequencies >= edge))
        for x in (found.ambient, found.hammer)
    )
    common = [c for c in ambient.channels if c in set(hammer.channels)]
    if not common:
        return None
    a = ambient.rows(common)
    b = hammer.rows(common)
    names = ("ambient", "hammer")
    gates = replace(settings(session.config), reach=1.0)  # of one structure
    pairing = pair_modes(a, b, gates, names=names)
    measures = complete(a, b, pairing, std=(u.frequency, v.frequency), settings=gates)
    return CompareStage(
        correlation_table(a, b, pairing, std_hz=u.frequency, names=names),
        Evidence(measures, auto_mac(a.shapes)),
    )


def elastic_evidence(
    session: Session,
    opened: Opened,
    reference: ReferenceModes,
    fe: ModeSet,
    table: CorrelationTable,
) -> Evidence | None:
    """What an elastic correlation rests on, with the mass of the deck at the channels; None without
    measured shapes.
    """
    if session.config.frequency_only:
        return None
    channels = reference.elastic.channels
    test: TestModel = session.get("identify").test
    look = session.observed(opened, test, test.channels)
    mass = channel_mass(opened, look, channels, session.config.correlate, session.fmax)
    return evidence(reference, fe, table.pairing, session.config, mass)


def correlate(session: Session, progress: Progress) -> CorrelateStage:
    """Correlate the initial and the remodelled deck."""
    config = session.config
    found: IdentifyStage = session.get("identify")
    reference = reference_modes(found, config)
    test = reference.elastic
    initial = session.seen(session.initial, found.test, test, part(progress, 0.0, 0.3))
    progress(0.3, "remodelled deck")
    remodelled = session.seen(
        session.remodelled, found.test, test, part(progress, 0.3, 0.6)
    )
    before, after = (
        elastic_table(reference, fe, config, initial) for fe in (initial, remodelled)
    )
    progress(0.6, "mass at the channels")
    last = elastic_evidence(session, session.remodelled, reference, remodelled, after)
    first = last
    if config.remodel and last is not None:
        first = evidence(reference, initial, before.pairing, config)
    sheet = None if config.frequency_only else found.test
    rigid = rigid_table(reference, initial, config)
    sensors = sensor_placement(session, session.initial, sheet, test)
    # of modes that the deck has as well: no part that hangs softly
    if sheet is not None:
        soft = reference.rigid.take(rigid.pairing.a)
        sensors = replace(sensors, rigid=rigid_suspects(soft, sheet))
    # the frequency gate keeps some from a similar mode of the deck
    pairing = after.pairing
    unpaired = zip(pairing.unpaired_a, pairing.reasons_a, pairing.gated_a, strict=True)
    notes = (
        *reference.gaps,
        *fewer(config.update.left_out, reference.left_out),
        *beyond(test, session.fmax),
        *_shared_places(session, found.test),
        *_mesh(session, after),
        *after.pairing.far(),
        *(f"test mode {i + 1}: {why}" for i, why, gated in unpaired if gated),
    )
    return CorrelateStage(
        reference=reference,
        initial=before,
        remodelled=after,
        rigid_initial=rigid,
        fe_initial=initial,
        fe_remodelled=remodelled,
        evidence_initial=first,
        evidence=last,
        remodelling=_remodelling(session, reference, initial),
        sensors=sensors,
        expanded=_expanded(session, reference, progress),
        notes=notes,
    )


def sensor_placement(
    session: Session, opened: Opened, sheet: TestModel | None, test: ModeSet
) -> SensorPlacement:
    """Where the sensors of a sheet are read on a deck, and mountings of them that explain the test
    better.
    """
    if sheet is None:
        return SensorPlacement()
    modes = opened.modes(session.up_to(test)).modes
    placement = ""
    if session.config.correlate.align:
        placement = alignment_text(session.alignment(sheet, opened))
    given = readings(
        test,
        modes,
        sheet,
        lambda there: session.observed(opened, there, there.channels),
    )
    return SensorPlacement(
        seats=seats(session.observed(opened, sheet, sheet.channels), sheet),
        mendings=find_mendings(given, settings(session.config)),
        alignment=placement,
    )


def _mesh(session: Session, table: CorrelationTable) -> tuple[str, ...]:
    """Which paired modes the mesh puts off, where that is soon known."""
    opened = session.remodelled
    paired = np.unique(table.pairing.b)
    if session.engine is not None or len(opened.model["GRID"]) > SMALL_DECK_NODES:
        return ()
    modes = opened.modes(session.fmax).modes.take(paired)
    try:
        errors = mesh_errors(opened.model, modes, EmbeddedSolver())
    except RingtrueError as e:  # a check is no reason for a study to end
        _log.info("mesh error: %s", e)
        return ()
    more = f": with `refine = {session.deck.refine + 1}` under [model] the study refines it first"
    return (errors.in_words(paired + 1) + more,) if errors.off.size else ()


def _shared_places(session: Session, sheet: TestModel) -> tuple[str, ...]:
    """Notes on sensors at places with several nodes, and on those between nodes."""
    config = session.config.correlate
    opened = session.initial
    between = between_nodes(
        opened, session.observed(opened, sheet, sheet.channels), config.match
    )
    if config.match != "nearest":
        return between
    test = session.alignment(sheet, opened).move(sheet) if config.align else sheet
    return (*shared_places(opened, test, opened.modes(session.fmax).modes), *between)


def _expanded(
    session: Session, reference: ReferenceModes, progress: Progress
) -> Expansion | None:
    """The elastic test shapes on the remodelled deck, drawn where its nodes are on the scene."""
    method = session.config.correlate.expand
    if not method or session.config.frequency_only:
        return None
    progress(0.8, "expansion of the test shapes")
    opened = session.remodelled
    test = reference.elastic
    sheet: TestModel = session.get("identify").test
    look = session.observed(opened, sheet, sheet.channels)
    found = expanded(method, opened, look=look, test=test, fmax=session.fmax)
    scene = session.get("model").scene
    return Expansion(method, on_scene(found, opened, test, scene), found.misfit)


def _remodelling(
    session: Session, reference: ReferenceModes, initial: ModeSet
) -> Remodelling | None:
    """The stated change of the deck, each step against the test."""
    reasons = [s.reason for s in session.config.remodel]
    if not reasons:
        return None
    sheet: TestModel = session.get("identify").test
    history = []
    for opened, reason in zip(
        session.steps, ("the initial deck", *reasons), strict=True
    ):
        fe = session.seen(opened, sheet, reference.elastic)
        table = elastic_table(reference, fe, session.config, initial)
        history.append(
            RemodelStep(
                reason=reason,
                pairs=len(table),
                mean_deviation=table.mean_deviation(),
                max_deviation=table.max_deviation(),
                mean_mac=table.mean_mac(),
                mean_subspace_mac=table.mean_subspace_mac(),
            )
        )
    numbered = [f"{i}. {reason}" for i, reason in enumerate(reasons, start=1)]
    before = session.initial.model.files
    after = session.remodelled.model.files
    return Remodelling(
        reason=reasons[0] if len(reasons) == 1 else "; ".join(numbered),
        diff=unified_diff([Path(f) for f in before], [Path(f) for f in after]),
        history=tuple(history),
    )


def correlate_configurations(
    session: Session, progress: Progress
) -> ConfigurationsStage:
    """Identify or read the modes of each configuration, side by side where there are workers, and
    correlate its deck with them.
    """
    tests = {}
    for c in session.others:
        assert c.section is not None
        _check_parameters(c)
        one = _with_test_of(session, c.section)
        tests[f"configuration {c.name}"] = (one, c.section)
    found = side_by_side(_test_modes, tests, session.config.study.workers, progress)
    each = zip(session.others, found, strict=True)
    return ConfigurationsStage(tuple(_correlated(c, *test) for c, test in each))


def configuration_files(session: Session) -> list[Path]:
    """All inputs of the stage besides the deck of the study."""
    out: list[Path] = []
    for c in session.others:
        s = c.section
        assert s is not None
        names = (s.cards, s.sheet, s.log, s.modes, s.lines, s.choice)
        out += [session.base / f for f in names if f]
        out += [Path(f) for f in c.deck.model.files] if s.deck else []
        out += identify.files(_with_test_of(session, s)) if s.log else []
    return list(dict.fromkeys(out))


def _with_test_of(session: Session, section: ConfigurationSection) -> Session:
    """The same study with the test of a configuration in place of its own."""
    test = None
    if section.log is not None:
        test = TestSection(
            sheet=str(section.sheet), log=section.log, lines=section.lines
        )
    choice = session.config.identify.model_copy(update={"choice": section.choice})
    update = session.config.update.model_copy(update={"left_out": section.left_out})
    changed = {"test": test, "identify": choice, "update": update}
    config = session.config.model_copy(update=changed)
    return Session(config, session.base, session.out, session.store)


def _parameters(c: StudyConfiguration) -> tuple[ParameterSet, ParameterSet]:
    """All candidates and suspensions, and those that the deck of a configuration has."""
    config = c.session.config
    every = ParameterSet(
        (*config.candidates().parameters, *config.suspensions().parameters)
    )
    return every, carried(c.deck.model, every)


def _correlated(
    c: StudyConfiguration,
    reference: ReferenceModes,
    test: TestModel | None,
    source: str,
) -> ConfiguredTest:
    session = c.session
    every, mine = _parameters(c)
    fe = session.seen(c.deck, test, reference.elastic)
    return ConfiguredTest(
        name=c.name,
        files=tuple(c.deck.model.files),
        source=source,
        test=test,
        reference=reference,
        initial=elastic_table(reference, fe, session.config),
        fe_initial=fe,
        carried=mine.names,
        sensors=sensor_placement(session, c.deck, test, reference.elastic),
        notes=_field_differences(session.remodelled.model, c.deck.model, every, mine),
    )


def _test_modes(
    tested: tuple[Session, ConfigurationSection], progress: Progress
) -> tuple[ReferenceModes, TestModel | None, str]:
    """The test modes of a configuration, the sheet, and where they come from in words."""
    at, section = tested
    if section.log is not None:
        with about(at.base / section.log):
            done = identify.run(at, progress)
            found = reference_modes(done, at.config)
        return (
            found,
            done.test,
            f"{len(found.elastic)} modes of {len(done.records)} records",
        )
    path = at.base / str(section.modes)
    found = reference_of_file(path, at.config)
    source = f"{len(found.elastic)} modes of {path.name}"
    if section.sheet is None:
        return found, None, source
    test = read_sensor_sheet(at.base / section.sheet).model
    elastic, notes = modes_by_sheet(found.elastic, test, path)
    rigid, _ = modes_by_sheet(found.rigid, test, path)
    return (
        replace(found, elastic=elastic, rigid=rigid),
        test,
        "; ".join((source, *notes)),
    )


def _check_parameters(c: StudyConfiguration) -> None:
    """A deck that carries no candidate, or one that cannot be scaled, is found before the work."""
    every, mine = _parameters(c)
    if len(every) and not len(mine):
        cards = sorted(
            {f"{t.card} {t.id}" for p in every.parameters for t in p.targets}
        )
        raise ConfigError(
            f"configuration {c.name}: its deck has no card of a candidate ({', '.join(cards)})"
        )
    try:
        apply_factors(c.deck.model, mine, np.ones(len(mine)))
    except InputError as e:
        raise ConfigError(f"configuration {c.name}: {e}") from e


def _other_terms(base: Model, model: Model, target: CardField) -> list[str]:
    """What a matrix is in a deck that has other terms than the deck of the study."""
    here, there = (
        deck["DMIG"].take(resolve_target(deck, target)) for deck in (model, base)
    )
    a = here.ragged(target.field).values
    b = there.ragged(target.field).values
    if a.size == b.size and np.allclose(a, b, rtol=1e-6, atol=0.0):
        return []
    return [
        f"DMIG {target.id} is {here['NAME'][0]} here, with other terms than {there['NAME'][0]} in "
        "the deck of the study"
    ]


def _field_differences(
    base: Model, model: Model, every: ParameterSet, mine: ParameterSet
) -> tuple[str, ...]:
    """Fields of candidates that a deck does not have, or has with another value than the deck of
    the study.
    """
    out = []
    have = {p.name: len(p.targets) for p in mine.parameters}
    for p in every.parameters:
        count = have.get(p.name, 0)
        if not count:
            out.append(f"its deck has no field of {p.name}, which does not act here")
        elif count < len(p.targets):
            out.append(
                f"its deck has {count} of the {len(p.targets)} fields of {p.name}"
            )
    for t in (t for p in mine.parameters for t in p.targets):
        if is_matrix(t.card, t.field):
            out += _other_terms(base, model, t)
            continue
        here = float(field_value(model, t))
        there = float(field_value(base, t))
        # 1e-6: relative difference of two fields that are the same
        if abs(here - there) > 1e-6 * abs(there):
            out.append(
                f"{t.card} {t.id} {t.field} is {here:.6g} here and {there:.6g} in the deck of "
                "the study"
            )
    return tuple(out)
