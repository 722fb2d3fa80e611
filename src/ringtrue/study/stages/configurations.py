"""Other configurations of the structure, each with its deck and its test: correlated before the
updating.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress, part
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError, InputError, about
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.model.edit import apply_factors, carried, field_value
from ringtrue.model.model import Model
from ringtrue.study.config import ConfigurationSection, TestSection
from ringtrue.study.naming import modes_by_sheet
from ringtrue.study.opened import Opened
from ringtrue.study.reference import (
    Reference,
    elastic_table,
    left_out,
    reference_modes,
    reference_of_file,
)
from ringtrue.study.results import ConfigurationsStage, ConfiguredTest
from ringtrue.study.seats import seats
from ringtrue.study.stages import identify
from ringtrue.study.stages.correlate import mendings
from ringtrue.study.workbench import Workbench

SAME = 1e-6  # relative difference of a field that is none


def run(desk: Workbench, progress: Progress) -> ConfigurationsStage:
    """Identify or read the modes of each configuration, and correlate its deck with them."""
    items, n = [], len(desk.config.configuration)
    for i, section in enumerate(desk.config.configuration):
        told = part(progress, i / n, (i + 1) / n)
        told(0.0, f"configuration {section.name}")
        items.append(_one(desk, section, told))
    return ConfigurationsStage(tuple(items))


def files(desk: Workbench) -> list[Path]:
    """All inputs of the stage beside the deck of the study."""
    out: list[Path] = []
    for c in desk.config.configuration:
        names = (c.cards, c.sheet, c.log, c.modes, c.lines, c.choice)
        out += [desk.base / f for f in names if f]
        out += [Path(f) for f in desk.configured(c).model.files] if c.deck else []
        out += identify.files(_at_test(desk, c)) if c.log else []
    return list(dict.fromkeys(out))


def _at_test(desk: Workbench, section: ConfigurationSection) -> Workbench:
    """The same study with the test of a configuration in place of its own."""
    test = TestSection(sheet=str(section.sheet), log=str(section.log), lines=section.lines)
    choice = desk.config.identify.model_copy(update={"choice": section.choice})
    config = desk.config.model_copy(update={"test": test, "identify": choice})
    return Workbench(config, desk.base, desk.out, desk.store)


def _one(desk: Workbench, section: ConfigurationSection, progress: Progress) -> ConfiguredTest:
    opened = desk.configured(section)
    parameters = ParameterSet(
        (*desk.config.candidates().parameters, *desk.config.suspensions().parameters)
    )
    mine = carried(opened.model, parameters)
    _check(section, opened.model, parameters, mine)
    reference, test, source = _reference(desk, section, part(progress, 0.0, 0.7))
    progress(0.8, f"modes of the deck of {section.name}")
    fe = seen(desk, opened, test, reference.elastic)
    out = left_out(reference.elastic, section.left_out, desk.config.identify.confidence)
    return ConfiguredTest(
        section.name,
        tuple(opened.model.files),
        source,
        test,
        reference.elastic,
        reference.elastic_std,
        reference.rigid,
        reference.rigid_std,
        out,
        elastic_table(reference, fe, desk.config, out),
        fe,
        mine.names,
        _notes(desk.remodelled.model, opened.model, parameters, mine),
        () if test is None else seats(desk.observed(opened, test, test.channels), test),
        mendings(desk, opened, test, reference.elastic, desk.up_to(reference.elastic.frequencies)),
    )


def _reference(
    desk: Workbench, section: ConfigurationSection, progress: Progress
) -> tuple[Reference, TestModel | None, str]:
    """The test modes, the sheet, and where they come from in words."""
    if section.modes is not None:
        path = desk.base / section.modes
        found = reference_of_file(path, desk.config)
        test = read_sensor_sheet(desk.base / section.sheet).model if section.sheet else None
        source = f"{len(found.elastic)} modes of {path.name}"
        if test is not None:
            elastic, told = modes_by_sheet(found.elastic, test, path)
            rigid, _ = modes_by_sheet(found.rigid, test, path)
            found = replace(found, elastic=elastic, rigid=rigid)
            source = "; ".join((source, *told))
        return found, test, source
    at = _at_test(desk, section)
    with about(desk.base / str(section.log)):
        done = identify.run(at, progress)
        found = reference_modes(done, at.config)
    return found, done.test, f"{len(found.elastic)} modes of {len(done.records)} records"


def seen(desk: Workbench, opened: Opened, test: TestModel | None, reference: ModeSet) -> ModeSet:
    """The modes of a deck at the channels of the test modes of a configuration."""
    modes = opened.modes(desk.up_to(reference.frequencies)).modes
    look = desk.observed(opened, test, reference.channels if test is None else test.channels)
    there = ModeSet(
        modes.frequencies,
        modes.damping,
        look(modes.shapes),
        look.channels,
        modes.norm,
        modes.source,
    )
    return there.rows(list(reference.channels))


def _check(
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


def _notes(base: Model, model: Model, every: ParameterSet, mine: ParameterSet) -> tuple[str, ...]:
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
