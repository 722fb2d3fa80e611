"""The delivered deck: edited in place, read back, solved, and judged; damping and FRFs."""

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
from ringtrue.decks.nastran.edit import edit_fields, is_new
from ringtrue.model.edit import FieldChange, field_changes, field_value
from ringtrue.model.model import Model
from ringtrue.study.evidence import followed, frf_evidence, on_sheet, synthesised
from ringtrue.study.opened import Opened
from ringtrue.study.reference import Reference, elastic_table, reference_modes, rigid_table
from ringtrue.study.results import CorrelateStage, FinalStage, IdentifyStage
from ringtrue.study.scene import scene_modes
from ringtrue.study.stages.correlate import judged, seen
from ringtrue.study.stages.update import chosen_factors
from ringtrue.study.workbench import Workbench

SHOWN = 4  # FRFs shown before and after


def deliver(desk: Workbench) -> tuple[Opened, tuple[str, ...], list[str]]:
    """Write the updated deck into `out/updated` and read it back."""
    parameters, factors = delivered_factors(desk)
    moved = [i for i, a in enumerate(factors.tolist()) if a != 1.0]
    model = desk.remodelled.model
    changes = field_changes(model, parameters.take(moved), factors[moved])
    written = edit_fields(model, changes, desk.folder("updated"))
    told = [said(model, c) for c in changes]
    desk.delivered = desk.opened(written[0])
    return desk.delivered, tuple(str(p) for p in written), told


def delivered_factors(desk: Workbench) -> tuple[ParameterSet, Float]:
    """All candidates and suspensions with their factors; 1 for those not chosen."""
    parameters = desk.everything
    tuned = desk.get("tune").factors if desk.config.suspension else {}
    springs = [tuned[p.name] for p in desk.config.suspensions().parameters]
    return parameters, np.concatenate([chosen_factors(desk), np.array(springs)])


def said(model: Model, change: FieldChange) -> str:
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


def run(desk: Workbench, progress: Progress) -> FinalStage:
    """Deliver and judge."""
    found: IdentifyStage = desk.get("identify")
    before: CorrelateStage = desk.get("correlate")
    reference = reference_modes(found, desk.config)
    opened, files, changes = deliver(desk)
    progress(0.2, "modes of the delivered deck")
    modes = opened.modes(desk.fmax).modes
    fe = seen(desk, opened)
    table = elastic_table(reference, fe, desk.config, before.left_out, before.fe_initial)
    rigid = rigid_table(reference, fe, desk.config)
    zeta, source = damping_of(fe, table.pairing, rigid.pairing, reference)
    progress(0.5, "what the correlation rests on")
    told = judged(desk, opened, reference, fe, table)
    upto = int(table.pairing.b.max(initial=-1)) + 1
    if told is not None:
        told = replace(told, tracks=followed(fe, before.fe_remodelled, before.fe_initial, upto))
    progress(0.8, "frequency responses")
    frfs = _frfs(desk, reference, before, opened, fe, zeta)
    told = replace(told, frfs=frf_evidence(found, *frfs, desk.config)) if told and frfs else told
    return FinalStage(
        files,
        tuple(changes),
        table,
        rigid,
        scene_modes(modes, desk.get("model").scene),
        fe,
        zeta,
        source,
        *_shown(frfs),
        told,
    )


def _frfs(
    desk: Workbench,
    reference: Reference,
    before: CorrelateStage,
    opened: Opened,
    fe: ModeSet,
    zeta: Float,
) -> tuple[FrfSet, FrfSet, FrfSet] | None:
    """Measured FRFs, those of the initial and of the final model; None without measured ones."""
    found: IdentifyStage = desk.get("identify")
    low = min(1.0, 0.5 * float(reference.elastic.frequencies[0]))
    measured = on_sheet(found, low, desk.fmax)
    if measured is None:
        return None
    first, _ = damping_of(
        before.fe_initial, before.initial.pairing, before.rigid_initial.pairing, reference
    )
    models = ((desk.initial, before.fe_initial, first), (opened, fe, zeta))
    made = [
        synthesised(o, desk.bridge(o), m, z, measured, desk.deck.units, fmax=desk.fmax)
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
