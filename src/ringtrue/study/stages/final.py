"""The delivered decks: edited in place, read back, solved, and compared with their tests."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ringtrue.core.iterate import Progress
from ringtrue.core.parameters import ParameterSet, is_matrix
from ringtrue.core.signals import FrfSet
from ringtrue.decks.nastran.editor import edit_fields, is_new
from ringtrue.model.edit import FieldChange, carried, field_changes, field_value
from ringtrue.model.model import Model
from ringtrue.study.evidence import ModelModes, followed, frf_evidence
from ringtrue.study.opened import Opened
from ringtrue.study.reference import elastic_table, rigid_table
from ringtrue.study.results import (
    ComparedFrfs,
    ConfiguredStage,
    DeliveredConfiguration,
    FinalStage,
    IdentifyStage,
)
from ringtrue.study.scene import scene_modes
from ringtrue.study.session import Session, StudyConfiguration
from ringtrue.study.stages.correlate import elastic_evidence
from ringtrue.study.synthesis import (
    damping_of,
    initial_modes,
    measured_frfs,
    model_frfs,
)


@dataclass(frozen=True, slots=True, eq=False)
class DeliveredDeck:
    """A deck with its updated fields, read back; its files and the changes in words."""

    opened: Opened
    files: tuple[str, ...]
    changes: tuple[str, ...]


def deliver(c: StudyConfiguration) -> DeliveredDeck:
    """Write what was found into the deck of a configuration and read it back."""
    factors = c.session.factors()
    model = c.deck.model
    every = ParameterSet(
        tuple(p for p in c.session.everything.parameters if factors[p.name] != 1.0)
    )
    mine = every if c.section is None else carried(model, every)
    changes = field_changes(model, mine, np.array([factors[n] for n in mine.names]))
    written = edit_fields(model, changes, c.updated_folder)
    return DeliveredDeck(
        c.session.opened(written[0]),
        tuple(str(p) for p in written),
        tuple(change_text(model, change) for change in changes),
    )


def delivered(c: StudyConfiguration) -> DeliveredDeck:
    """`deliver`, once a run."""
    decks = c.session.delivered
    if c.name not in decks:
        decks[c.name] = deliver(c)
    found: DeliveredDeck = decks[c.name]
    return found


def change_text(model: Model, change: FieldChange) -> str:
    """A changed field in words: file:line card id field old -> new."""
    table = model[change.card]
    row = int(table.find(np.array([change.id]))[0])
    new = float(change.value)
    if is_new(model, change):
        return f"added: CONM2 {change.id} of {new:.6g} at GRID {int(table['G'][row])}"
    place = f"{Path(model.files[int(table.file[row])]).name}:{int(table.line[row])}"
    if is_matrix(change.card, change.field):
        return f"{place} DMIG {change.id} ({table['NAME'][row]}): all terms times {new:.6g}"
    old = float(field_value(model, change))
    return f"{place} {change.card} {change.id} {change.field} {old:.6g} -> {new:.6g}"


def deliver_final(session: Session, progress: Progress) -> FinalStage:
    """Deliver the deck of the study and compare it with its test."""
    c = session.own
    before = session.get("correlate")
    reference = c.reference
    done = deliver(c)
    session.delivered[c.name] = done
    opened = done.opened
    progress(0.2, "modes of the delivered deck")
    modes = opened.modes(session.fmax).modes
    fe = c.modes(opened)
    table = elastic_table(reference, fe, session.config, before.fe_initial)
    rigid = rigid_table(reference, fe, session.config)
    zeta, source = damping_of(fe, table.pairing, rigid.pairing, reference)
    progress(0.5, "what the correlation rests on")
    rests_on = elastic_evidence(session, opened, reference, fe, table)
    if rests_on is not None:
        count = int(table.pairing.b.max(initial=-1)) + 1
        remodelled = () if before.remodelling is None else (before.fe_remodelled,)
        tracks = followed((fe, *remodelled, before.fe_initial), count)
        rests_on = replace(rests_on, tracks=tracks)
    progress(0.8, "frequency responses")
    frfs = _frfs(c, ModelModes(opened, fe, zeta))
    if frfs is not None and rests_on is not None:
        found: IdentifyStage = session.get("identify")
        rests_on = replace(rests_on, frfs=frf_evidence(found, *frfs, session.config))
    return FinalStage(
        files=done.files,
        changes=done.changes,
        table=table,
        rigid=rigid,
        modes=scene_modes(modes, session.get("model").scene),
        observed=fe,
        damping=zeta,
        damping_from=source,
        evidence=rests_on,
        frfs=None if frfs is None else _at_driving_points(*frfs),
    )


def _frfs(
    c: StudyConfiguration, final: ModelModes
) -> tuple[FrfSet, FrfSet, FrfSet] | None:
    """Measured FRFs, those of the initial and of the final model; None without measured ones."""
    measured = measured_frfs(c)
    if measured is None:
        return None
    one, two = (model_frfs(c, m, measured) for m in (initial_modes(c), final))
    return measured, one, two


def _at_driving_points(test: FrfSet, initial: FrfSet, final: FrfSet) -> ComparedFrfs:
    own = {j: i for i, j in test.driving_points()}
    # at an excitation point without a sensor, the response that is largest
    largest = np.abs(test.data).max(axis=0).argmax(axis=0).tolist()
    at = [(own.get(j, i), j) for j, i in enumerate(largest)]
    one, two, three = (
        np.stack([x.data[:, i, j] for i, j in at], axis=1)
        for x in (test, initial, final)
    )
    names = tuple(f"{test.outputs[i].id} / {test.inputs[j].id}" for i, j in at)
    return ComparedFrfs(test.freqs, names, one, two, three)


def deliver_configurations(session: Session, progress: Progress) -> ConfiguredStage:
    """Deliver the decks of the other configurations and compare them with their tests."""
    items = []
    for i, c in enumerate(session.others):
        progress(i / len(session.others), f"delivered deck of {c.name}")
        done = deliver(c)
        fe = c.modes(done.opened)
        table = elastic_table(c.reference, fe, session.config)
        items.append(
            DeliveredConfiguration(c.name, done.files, done.changes, table, fe)
        )
    return ConfiguredStage(tuple(items))
