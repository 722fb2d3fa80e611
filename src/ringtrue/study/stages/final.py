"""The delivered deck: edited in place, read back, solved, and judged; damping and FRFs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.pairing import Pairing
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.signals import FrfSet
from ringtrue.fem.response import frf
from ringtrue.io.nastran.edit import edit_fields
from ringtrue.io.nastran.reader import read_deck
from ringtrue.model.edit import FieldChange, field_changes
from ringtrue.model.model import Model
from ringtrue.study.opened import Opened, Progress
from ringtrue.study.reference import Reference, elastic_table, reference_modes, rigid_table
from ringtrue.study.results import CorrelateStage, FinalStage, IdentifyStage
from ringtrue.study.scene import scene_modes
from ringtrue.study.stages.correlate import seen
from ringtrue.study.stages.update import chosen_factors
from ringtrue.study.workbench import Workbench

SHOWN = 4  # FRFs shown before and after
MASS = {"SI": 1.0, "mm-t-s": 1e3}


def deliver(desk: Workbench) -> tuple[Opened, tuple[str, ...], list[str]]:
    """Write the updated deck into `out/updated` and read it back."""
    parameters = ParameterSet(desk.config.candidates().parameters + desk.config.suspensions().parameters)
    tuned = desk.get("tune").factors if desk.config.suspension else {}
    springs = [tuned[p.name] for p in desk.config.suspensions().parameters]
    factors = np.concatenate([chosen_factors(desk), np.array(springs)])
    moved = [i for i, a in enumerate(factors.tolist()) if a != 1.0]
    model = desk.remodelled.model
    changes = field_changes(model, parameters.take(moved), factors[moved])
    written = edit_fields(model, changes, desk.out / "updated")
    said = [_said(model, c) for c in changes]
    return Opened(read_deck(written[0]), desk.length), tuple(str(p) for p in written), said


def _said(model: Model, change: FieldChange) -> str:
    table = model[change.card]
    row = int(table.find(np.array([change.id]))[0])
    place = f"{Path(model.files[int(table.file[row])]).name}:{int(table.line[row])}"
    old = float(table[change.field][row])
    return f"{place} {change.card} {change.id} {change.field} {old:.6g} -> {float(change.value):.6g}"


def damping_of(modes: ModeSet, elastic: Pairing, rigid: Pairing, reference: Reference) -> tuple[Float, tuple[str, ...]]:
    """Damping of each FE mode: its test partner's, or interpolated over frequency."""
    zeta = np.full(len(modes), np.nan)
    source = ["interpolated"] * len(modes)
    for pairing, test, what in ((rigid, reference.rigid, "ambient"), (elastic, reference.elastic, "test")):
        for a, b in zip(pairing.a.tolist(), pairing.b.tolist(), strict=True):
            zeta[b] = test.damping[a]
            source[b] = f"{what} mode {a + 1}"
    known = np.isfinite(zeta)
    if not known.any():
        return np.full(len(modes), 0.01), ("assumed 1 %",) * len(modes)
    f = modes.frequencies
    zeta[~known] = np.interp(f[~known], f[known], zeta[known])
    return zeta, tuple(source)


def responses(
    fe: ModeSet, zeta: Float, frfs: FrfSet, pairs: list[tuple[int, int]], freqs: Float, mass: float
) -> Complex:
    """Accelerances (f, k) of a model at (output, input) pairs of a measured set."""
    at = {c: i for i, c in enumerate(fe.channels)}
    out = [at[frfs.outputs[i].id] for i, _ in pairs]
    into = [at[frfs.inputs[j].id] for _, j in pairs]
    h = frf(freqs, fe.frequencies, zeta, fe.shapes[out], fe.shapes[into], frfs.kind) / mass
    return np.asarray(np.stack([h[:, k, k] for k in range(len(pairs))], axis=1), dtype=np.complex128)


def run(desk: Workbench, progress: Progress) -> FinalStage:
    """Deliver and judge."""
    found: IdentifyStage = desk.get("identify")
    before: CorrelateStage = desk.get("correlate")
    reference = reference_modes(found, desk.config)
    opened, files, changes = deliver(desk)
    progress(0.2, "modes of the delivered deck")
    modes = opened.modes(desk.deck.fmax).modes
    fe = seen(desk, opened)
    table = elastic_table(reference, fe, desk.config, before.left_out)
    rigid = rigid_table(reference, fe, desk.config)
    zeta, source = damping_of(fe, table.pairing, rigid.pairing, reference)
    shown = _responses(desk, found.frfs, before.fe_initial, fe, zeta)
    return FinalStage(
        files,
        tuple(changes),
        table,
        rigid,
        scene_modes(modes, desk.get("model").scene),
        fe,
        zeta,
        source,
        *shown,
    )


def _responses(
    desk: Workbench, frfs: FrfSet | None, initial: ModeSet, final: ModeSet, zeta: Float
) -> tuple[Float, tuple[str, ...], Complex, Complex, Complex]:
    if frfs is None:
        none = np.zeros((0, 0), dtype=np.complex128)
        return np.zeros(0), (), none, none, none
    keep = (frfs.freqs > 1.0) & (frfs.freqs < desk.deck.fmax)
    seen = set(final.channels)
    rest = [(0, j) for j, c in enumerate(frfs.inputs) if c.id in seen]  # a hammer point without a sensor on the sheet
    pairs = [(i, j) for i, j in frfs.driving_points() if frfs.inputs[j].id in seen][:SHOWN] or rest[:1]
    if not pairs:
        return _responses(desk, None, initial, final, zeta)
    mass = MASS[desk.deck.units]
    freqs = frfs.freqs[keep]
    mean = np.full(len(initial), float(np.median(zeta)))
    measured = np.stack([frfs.data[keep, i, j] for i, j in pairs], axis=1)
    names = tuple(f"{frfs.outputs[i].id} / {frfs.inputs[j].id}" for i, j in pairs)
    return (
        freqs,
        names,
        measured,
        responses(initial, mean, frfs, pairs, freqs, mass),
        responses(final, zeta, frfs, pairs, freqs, mass),
    )
