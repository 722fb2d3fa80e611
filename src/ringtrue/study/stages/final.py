"""The delivered decks: edited in place, read back, solved, and compared with their tests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress
from ringtrue.core.signals import FrfSet
from ringtrue.correlation.pairing import Pairing
from ringtrue.decks.nastran.editor import edit_fields, is_new
from ringtrue.model.edit import FieldChange, carried, field_changes, field_value
from ringtrue.model.model import Model
from ringtrue.study.config_sections import ConfigurationSection
from ringtrue.study.evidence import followed, frf_evidence, on_sheet, synthesised
from ringtrue.study.opened import Opened, scene_modes
from ringtrue.study.reference import Reference, elastic_table, reference_modes, rigid_table
from ringtrue.study.results import (
    ConfigurationsStage,
    ConfiguredStage,
    ConfiguredTest,
    CorrelateStage,
    DeliveredConfiguration,
    FinalStage,
    IdentifyStage,
)
from ringtrue.study.session import Session
from ringtrue.study.stages.correlate import elastic_evidence, modes_at_channels, modes_at_sheet
from ringtrue.study.stages.update import chosen_factors

SHOWN = 4  # FRFs shown before and after


def deliver(session: Session) -> tuple[Opened, tuple[str, ...], list[str]]:
    """Write the updated deck into `out/updated` and read it back."""
    parameters, factors = delivered_factors(session)
    moved = [i for i, a in enumerate(factors.tolist()) if a != 1.0]
    model = session.remodelled.model
    changes = field_changes(model, parameters.take(moved), factors[moved])
    written = edit_fields(model, changes, session.folder("updated"))
    told = [change_text(model, c) for c in changes]
    session.delivered = session.opened(written[0])
    return session.delivered, tuple(str(p) for p in written), told


def delivered_factors(session: Session) -> tuple[ParameterSet, Float]:
    """All candidates and suspensions with their factors; 1 for those not chosen."""
    parameters = session.everything
    tuned = session.get("tune").factors if session.config.suspension else {}
    springs = [tuned[p.name] for p in session.config.suspensions().parameters]
    return parameters, np.concatenate([chosen_factors(session), np.array(springs)])


def change_text(model: Model, change: FieldChange) -> str:
    """A changed field in words: file:line card id field old -> new."""
    table = model[change.card]
    row = int(table.find(np.array([change.id]))[0])
    if is_new(model, change):
        return (
            f"added: CONM2 {change.id} of {float(change.value):.6g} at GRID {int(table['G'][row])}"
        )
    place = f"{Path(model.files[int(table.file[row])]).name}:{int(table.line[row])}"
    old = float(field_value(model, change))
    return (
        f"{place} {change.card} {change.id} {change.field} {old:.6g} -> {float(change.value):.6g}"
    )


def damping_of(
    modes: ModeSet, elastic: Pairing, rigid: Pairing, reference: Reference
) -> tuple[Float, tuple[str, ...]]:
    """Damping of each FE mode: its test partner's, or interpolated over frequency."""
    zeta = np.full(len(modes), np.nan)
    source = ["interpolated"] * len(modes)
    for pairing, test, what in (
        (rigid, reference.rigid, "ambient"),
        (elastic, reference.elastic, "test"),
    ):
        for a, b in zip(pairing.a.tolist(), pairing.b.tolist(), strict=True):
            zeta[b] = test.damping[a]
            source[b] = f"{what} mode {a + 1}"
    known = np.isfinite(zeta)
    if not known.any():
        return np.full(len(modes), 0.01), ("assumed 1 %",) * len(modes)
    f = modes.frequencies
    zeta[~known] = np.interp(f[~known], f[known], zeta[known])
    return zeta, tuple(source)


def deliver_final(session: Session, progress: Progress) -> FinalStage:
    """Deliver and judge."""
    found: IdentifyStage = session.get("identify")
    before: CorrelateStage = session.get("correlate")
    reference = reference_modes(found, session.config)
    opened, files, changes = deliver(session)
    progress(0.2, "modes of the delivered deck")
    modes = opened.modes(session.fmax).modes
    fe = modes_at_sheet(session, opened)
    table = elastic_table(reference, fe, session.config, before.left_out, before.fe_initial)
    rigid = rigid_table(reference, fe, session.config)
    zeta, source = damping_of(fe, table.pairing, rigid.pairing, reference)
    progress(0.5, "what the correlation rests on")
    told = elastic_evidence(session, opened, reference, fe, table)
    upto = int(table.pairing.b.max(initial=-1)) + 1
    if told is not None:
        told = replace(told, tracks=followed(fe, before.fe_remodelled, before.fe_initial, upto))
    progress(0.8, "frequency responses")
    frfs = _frfs(session, reference, before=before, opened=opened, fe=fe, zeta=zeta)
    told = replace(told, frfs=frf_evidence(found, *frfs, session.config)) if told and frfs else told
    return FinalStage(
        files,
        tuple(changes),
        table,
        rigid,
        scene_modes(modes, session.get("model").scene),
        fe,
        zeta,
        source,
        *_shown(frfs),
        told,
    )


def _frfs(
    session: Session,
    reference: Reference,
    before: CorrelateStage,
    opened: Opened,
    fe: ModeSet,
    zeta: Float,
) -> tuple[FrfSet, FrfSet, FrfSet] | None:
    """Measured FRFs, those of the initial and of the final model; None without measured ones."""
    found: IdentifyStage = session.get("identify")
    low = min(1.0, 0.5 * float(reference.elastic.frequencies[0]))
    measured = on_sheet(found, low, session.fmax)
    if measured is None:
        return None
    first, _ = damping_of(
        before.fe_initial, before.initial.pairing, before.rigid_initial.pairing, reference
    )
    models = ((session.initial, before.fe_initial, first), (opened, fe, zeta))
    made = [
        synthesised(
            o,
            session.bridge(o),
            fe=m,
            zeta=z,
            measured=measured,
            units=session.deck.units,
            fmax=session.fmax,
        )
        for o, m, z in models
    ]
    return measured, made[0], made[1]


def _shown(
    frfs: tuple[FrfSet, FrfSet, FrfSet] | None,
) -> tuple[Float, tuple[str, ...], Complex, Complex, Complex]:
    """Lines, names and the FRFs (line, k) at driving points, of test, initial and final model."""
    if frfs is None:
        none = np.zeros((0, 0), dtype=np.complex128)
        return np.zeros(0), (), none, none, none
    test = frfs[0]
    at = test.driving_points()[:SHOWN] or [(0, 0)]  # a hammer point without a sensor
    names = tuple(f"{test.outputs[i].id} / {test.inputs[j].id}" for i, j in at)
    one, two, three = (np.stack([x.data[:, i, j] for i, j in at], axis=1) for x in frfs)
    return test.freqs, names, one, two, three


def deliver_configurations(session: Session, progress: Progress) -> ConfiguredStage:
    """Deliver and judge each."""
    found: ConfigurationsStage = session.get("configurations")
    items, n = [], len(found.items)
    for i, (section, item) in enumerate(
        zip(session.config.configuration, found.items, strict=True)
    ):
        progress(i / n, f"delivered deck of {section.name}")
        items.append(_delivered(session, section, item))
    return ConfiguredStage(tuple(items))


def deliver_configuration(
    session: Session, section: ConfigurationSection
) -> tuple[Opened, tuple[str, ...], tuple[str, ...]]:
    """The deck with what was found, read back; its files, and the changed fields."""
    parameters, factors = delivered_factors(session)
    model = session.configured(section).model
    mine = carried(model, parameters)
    at = np.array([parameters.names.index(n) for n in mine.names], dtype=np.int64)
    moved = [i for i, a in enumerate(factors[at].tolist()) if a != 1.0]
    changes = field_changes(model, mine.take(moved), factors[at][moved])
    written = edit_fields(
        model, changes, session.folder("configurations") / section.name / "updated"
    )
    return (
        session.opened(written[0]),
        tuple(str(p) for p in written),
        tuple(change_text(model, c) for c in changes),
    )


def _delivered(
    session: Session, section: ConfigurationSection, item: ConfiguredTest
) -> DeliveredConfiguration:
    opened, files, told = deliver_configuration(session, section)
    fe = modes_at_channels(session, opened, item.test, item.reference)
    table = elastic_table(Reference.of(item), fe, session.config, item.left_out)
    return DeliveredConfiguration(section.name, files, told, table, fe)
