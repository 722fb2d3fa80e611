"""Damping of the delivered deck: loss factors and dashpots by region from the damping of the
identified modes.

The modes are the complex ones that the identification fitted to the FRFs around the resonances (and
to the ambient records). The FRFs themselves are the check: with shapes that are a few per cent off,
a direct fit reads an error of amplitude as damping.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.modes import ModeSet, Uncertainty, elastic
from ringtrue.core.progress import Progress
from ringtrue.correlation.table import CorrelationTable
from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.eigen.damped import complex_modes, project
from ringtrue.fem.response import coupled
from ringtrue.model.edit import field_value
from ringtrue.study.evidence import on_sheet
from ringtrue.study.opened import Opened
from ringtrue.study.reference import Reference, rigid_table
from ringtrue.study.results import (
    DampedConfiguration,
    DampedModes,
    DampedRegions,
    DampingStage,
    FinalStage,
)
from ringtrue.study.session import OWN, Session
from ringtrue.study.stages.final import change_text, deliver
from ringtrue.study.stages.final import deliver_configuration as deliver_other
from ringtrue.updating.damping import DampingFit, fit_poles, mode_damping
from ringtrue.updating.damping_regions import (
    Dampers,
    DampingRegion,
    dampers,
    default_regions,
    joined_dampers,
)

SPAN = 3.0  # half-power half-bandwidths around a resonance in which FRFs are compared
SILENT = 0.8  # standard deviation over that before the data: they say little
BEYOND = 2.0  # standard deviations from what was expected
MANY = 5  # cards or regions that are named


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """Damping ratios of test modes with a partner in the final model, (t,) each."""

    fe: Int
    names: tuple[str, ...]
    hertz: Float
    ratio: Float
    std: Float
    used: Bool
    elastic: Bool


def measured(
    reference: Reference, table: CorrelationTable, rigid: CorrelationTable, hertz: Float
) -> _Measured:
    """The rigid-body modes of the ambient test and the elastic reference modes, those with damping
    above 0.

    A test that does not tell how well it knows its damping adds nothing to the error of the shapes.

    Parameters
    ----------
    table, rigid : CorrelationTable
        Of both with the delivered deck.
    hertz : (m,) float64, Hz
        Of its modes.
    """
    low = _partners("ambient", reference.rigid, reference.rigid_std, rigid)
    high = _partners("test", reference.elastic, reference.elastic_std, table)
    fe, f, ratio, std, used = (np.concatenate(p) for p in zip(low[1:], high[1:], strict=True))
    names = low[0] + high[0]
    good = np.flatnonzero((ratio > 0) & ~np.isinf(std) & (hertz[fe] > 0))
    return _Measured(
        fe=fe[good],
        names=tuple(names[i] for i in good.tolist()),
        hertz=f[good],
        ratio=ratio[good],
        std=std[good],
        used=used[good].astype(bool),
        elastic=good >= len(low[0]),
    )


def _partners(
    what: str, modes: ModeSet, std: Uncertainty, table: CorrelationTable
) -> tuple[list[str], Int, Float, Float, Float, Bool]:
    a, b = table.pairing.a, table.pairing.b
    names = [f"{what} mode {i + 1}" for i in a.tolist()]
    return names, b, modes.frequencies[a], modes.damping[a], std.damping[a], table.used


def nothing(why: str) -> DampingStage:
    """A stage that found nothing to do."""
    return DampingStage(
        why=why, regions=None, modes=None, misfit=0.0, before="", flags=(), files=(), changes=()
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A delivered deck on its modes that move (n), and what its test says of their damping."""

    name: str
    opened: Opened
    test: _Measured
    moving: Int
    values: Float
    shapes: Float
    total: tuple[Float, Float]

    @property
    def at(self) -> Int:
        """Partner of each test mode among those that move, (t,)."""
        return np.searchsorted(self.moving, self.test.fe)


def _part(session: Session, name: str, opened: Opened, test: _Measured) -> _Part:
    modes, system = opened.modes(session.fmax).modes, opened.analysis.system
    f = modes.frequencies
    moving = np.union1d(
        np.flatnonzero(elastic(f)), test.fe
    )  # what the test tells moves, slow as it may be
    phi = np.asarray(system.local @ modes.shapes[:, moving])
    total = project(phi, system.viscous, system.structural)
    return _Part(
        name=name,
        opened=opened,
        test=test,
        moving=moving,
        values=(2 * np.pi * f[moving]) ** 2,
        shapes=modes.shapes[:, moving],
        total=total,
    )


def _others(session: Session, progress: Progress) -> list[_Part]:
    """The delivered decks of the other configurations whose tests tell damping."""
    out: list[_Part] = []
    if not session.config.configuration:
        return out
    tests, done = session.get("configurations").items, session.get("configured").items
    for section, test, found in zip(session.config.configuration, tests, done, strict=True):
        reference = Reference.of(test)
        rigid = rigid_table(reference, found.observed, session.config)
        told = measured(reference, found.table, rigid, found.observed.frequencies)
        if told.fe.size:
            progress(0.3, f"modes of the delivered deck of {section.name}")
            out.append(_part(session, section.name, deliver_other(session, section)[0], told))
    return out


def run(session: Session, progress: Progress) -> DampingStage:
    """Fit the regions to the modes that the updating saw, predict those left out, compare the FRFs.

    The tests of all configurations have one set of coefficients; FRFs are those of the study's own.
    """
    final: FinalStage = session.get("final")
    reference = Reference.of(session.get("correlate"))
    test = measured(reference, final.table, final.rigid, final.observed.frequencies)
    if not test.used.any():
        return nothing("no test mode with a damping ratio has a partner in the final model")
    opened = session.delivered or deliver(session)[0]
    progress(0.1, "modes of the delivered deck")
    own = _part(session, OWN, opened, test)
    parts = [own, *_others(session, progress)]
    progress(0.5, "damping of the regions")
    common, wanted = float(np.median(test.ratio[test.used])), regions(session, opened)
    mine = [wanted, *(_held(wanted, p.opened) for p in parts[1:])]
    found = [
        dampers(p.opened.model, r, values=p.values, shapes=p.shapes, total=p.total, ratio=common)
        for p, r in zip(parts, mine, strict=True)
    ]
    if not found[0].regions:
        return nothing("no region takes part in any mode")
    whole, first = joined_dampers(found), np.cumsum([0, *(p.values.size for p in parts)]).tolist()
    values = np.concatenate([p.values for p in parts])
    at = np.concatenate([p.at + k for p, k in zip(parts, first, strict=False)])
    ratio, std, use = (
        np.concatenate([getattr(p.test, n) for p in parts]) for n in ("ratio", "std", "used")
    )
    std = np.hypot(
        np.nan_to_num(std), session.config.damping.error * ratio
    )  # of modes of a file it may not be known
    fit = fit_poles(values, whole.mechanisms, ratio[use], std[use], at[use], base=whole.base)
    after = mode_damping(values, whole.mechanisms, fit, at)
    ends = np.cumsum([0, *(p.at.size for p in parts)]).tolist()
    progress(0.8, "FRFs around the resonances")
    before, words = _before(own.values, own.total, common)
    n = own.values.size
    errors = frf_errors(
        session, test, own.moving, (before, (fit.viscous[:n, :n], fit.structural[:n, :n]))
    )
    told = [
        _modes(p, common, [x[a:b] for x in after])
        for p, a, b in zip(parts, ends, ends[1:], strict=False)
    ]
    changes, files = _written(session, opened, whole, fit)
    return DampingStage(
        why="",
        regions=_regions(whole, fit),
        modes=replace(told[0], frf_before=errors[0], frf_after=errors[1]),
        misfit=fit.misfit,
        before=words,
        flags=flags(whole, fit),
        files=files,
        changes=changes,
        others=tuple(
            DampedConfiguration(p.name, m) for p, m in zip(parts[1:], told[1:], strict=True)
        ),
    )


def _modes(part: _Part, common: float, after: Sequence[Float]) -> DampedModes:
    """The paired modes of a deck; errors of FRFs are not known."""
    t, none = part.test, np.full(part.test.hertz.size, np.nan)
    before = complex_modes(part.values, *_before(part.values, part.total, common)[0]).damping[
        part.at
    ]
    return DampedModes(
        fe=t.fe,
        test=t.names,
        used=t.used,
        hertz=t.hertz,
        measured=t.ratio,
        measured_std=t.std,
        before=before,
        after=after[0],
        after_std=after[1],
        frf_before=none,
        frf_after=none,
    )


def _held(wanted: Sequence[DampingRegion], opened: Opened) -> tuple[DampingRegion, ...]:
    """Those of the regions that a deck has, as far as it has their fields."""
    model = opened.model
    there = [
        [t for t in r.targets if t.card in model and (model[t.card].ids == t.id).any()]
        for r in wanted
    ]
    return tuple(replace(r, targets=tuple(ts)) for r, ts in zip(wanted, there, strict=True) if ts)


def regions(session: Session, opened: Opened) -> tuple[DampingRegion, ...]:
    """As stated in the study; else one a material and one a group of springs."""
    stated = session.config.damping.region
    if stated:
        return tuple(r.region() for r in stated)
    return default_regions(opened.model, session.config.suspensions(), session.deck.regions)


def _before(
    values: Float, total: tuple[Float, Float], common: float
) -> tuple[tuple[Float, Float], str]:
    """ΦᵀDΦ and ΦᵀHΦ before: the deck's own damping, or one ratio for all modes where it has
    none.
    """
    if any(a.any() for a in total):
        return total, "the damping of the deck"
    viscous = np.diag(2 * common * np.sqrt(values))
    return (
        viscous,
        np.zeros_like(viscous),
    ), f"{100 * common:.2f} % for all modes, the median of the test"


def frf_errors(
    session: Session, test: _Measured, moving: Int, damped: tuple[tuple[Float, Float], ...]
) -> list[Float]:
    """‖H − H_test‖/‖H_test‖ over all FRFs around each test mode, (t,) for each damping; NaN where
    there is no FRF.

    Paired modes stand at the frequency of the test: what is compared is damping and shape.
    """
    final: FinalStage = session.get("final")
    frfs = on_sheet(session.get("identify"), 0.0, session.fmax)
    if frfs is None:
        return [np.full(test.hertz.size, np.nan) for _ in damped]
    at = {c: i for i, c in enumerate(final.observed.channels)}
    phi_out, phi_in = (
        final.observed.shapes[[at[c.id] for c in side]][:, moving]
        for side in (frfs.outputs, frfs.inputs)
    )
    hertz = final.observed.frequencies.copy()
    hertz[test.fe] = test.hertz
    values = (2 * np.pi * hertz[moving]) ** 2
    near = (
        np.abs(frfs.freqs[:, None] - test.hertz) <= SPAN * test.ratio * test.hertz
    )  # (line, mode)
    near[:, ~test.elastic] = (
        False  # rigid-body modes are seen by the ambient test, not by the hammer
    )
    lines = np.flatnonzero(near.any(axis=1))
    data = frfs.data[lines] * session.unit.kilograms
    window = (
        2 * frfs.window_decay * np.eye(moving.size)
    )  # an exponential window damps every mode alike
    return [
        _relative(
            coupled(
                frfs.freqs[lines],
                values,
                viscous=d + window,
                structural=h,
                phi_out=phi_out,
                phi_in=phi_in,
                kind=frfs.kind,
            ),
            data,
            near[lines],
        )
        for d, h in damped
    ]


def _relative(model: Complex, data: Complex, near: Bool) -> Float:
    """Norm of the difference over that of the data, (t,), over the lines near (l, t) each mode."""
    wrong, size = ((np.abs(x) ** 2).sum(axis=(1, 2)) @ near for x in (model - data, data))
    return np.asarray(
        np.sqrt(np.divide(wrong, size, out=np.full(size.shape, np.nan), where=size > 0))
    )


def _regions(found: Dampers, fit: DampingFit) -> DampedRegions:
    expected, spread = np.array([(m.prior, m.std) for m in found.mechanisms]).T
    shrink = np.minimum(
        spread / fit.std, 1.0
    )  # a model that misfits takes nothing away from what was known
    return DampedRegions(
        names=fit.names,
        targets=tuple(_words(r) for r in found.regions),
        natures=tuple(r.nature for r in found.regions),
        coefficients=fit.coefficients,
        covariance=fit.covariance * np.outer(shrink, shrink),
        expected=expected,
        expected_std=spread,
    )


def _words(region: DampingRegion) -> str:
    """The targets as study.toml has them, fields of one card together."""
    cards: dict[str, list[str]] = {}
    for t in region.targets:
        cards.setdefault(f"{t.card} {t.id}", []).append(t.field)
    text = [f"{card} {','.join(fields)}" for card, fields in cards.items()]
    return "; ".join(text if len(text) <= MANY else [*text[:MANY], f"{len(text) - MANY} more"])


def flags(found: Dampers, fit: DampingFit) -> tuple[str, ...]:
    """What an engineer should look at: upper bounds reached, and coefficients far from what was
    expected.
    """
    out = []
    for m, c, at in zip(
        found.mechanisms, fit.coefficients.tolist(), fit.at_bound.tolist(), strict=True
    ):
        away = (c - m.prior) / m.std
        if at and c > (m.lower + m.upper) / 2:
            out.append(
                f"{m.name}: {c:.3g} is at its upper bound; dissipation that no region has may be "
                "lumped here"
            )
        elif away > BEYOND:
            out.append(
                f"{m.name}: {c:.3g} is {away:.1f} standard deviations above the expected "
                f"{m.prior:.2g}"
            )
    lost = [
        m.name
        for m, s in zip(found.mechanisms, fit.std.tolist(), strict=True)
        if s > SILENT * m.std
    ]
    if lost:
        more = f" and {len(lost) - MANY} more" if len(lost) > MANY + 1 else ""
        named = ", ".join(lost[:MANY] if more else lost) + more
        out.append(f"the test says little about {named}: their values are those expected, or zero")
    return tuple(out)


def _written(
    session: Session, opened: Opened, found: Dampers, fit: DampingFit
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The changed fields, and the files of a copy of the delivered deck with them; none unless
    asked for.
    """
    if not session.config.damping.write:
        return (), ()
    every = [
        c
        for r, v in zip(found.regions, fit.coefficients.tolist(), strict=True)
        for c in r.changes(v)
    ]
    changes = [
        c for c in every if c.value != np.nan_to_num(field_value(opened.model, c))
    ]  # a blank is 0
    files = edit_fields(opened.model, changes, session.folder("damped"))
    return tuple(change_text(opened.model, c) for c in changes), tuple(str(f) for f in files)
