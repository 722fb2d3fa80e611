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
from ringtrue.core.iterate import Progress
from ringtrue.core.modes import ModeSet, elastic
from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.eigen.damped import complex_modes, project
from ringtrue.fem.response import CoupledModes, coupled
from ringtrue.model.edit import field_value
from ringtrue.study.evidence import on_sheet
from ringtrue.study.opened import Opened
from ringtrue.study.reference import rigid_table
from ringtrue.study.results import (
    DampedConfiguration,
    DampedModes,
    DampedRegions,
    DampingStage,
    FinalStage,
)
from ringtrue.study.session import Session, StudyConfiguration
from ringtrue.study.stages.final import change_text, delivered
from ringtrue.updating.damping import DampingFit, fit_poles, mode_damping
from ringtrue.updating.damping_regions import (
    Dampers,
    DampingRegion,
    dampers,
    default_regions,
    joined_dampers,
)


@dataclass(frozen=True, slots=True)
class ComparedDamping:
    """What is said of the damping of a region.

    Attributes
    ----------
    span : float
        Half-power half-bandwidths around a resonance in which FRFs are compared.
    unknown : float
        Standard deviation over that before the data: they say little.
    far : float
        Standard deviations from what was expected.
    named : int
        Cards or regions that are named.
    worse : float
        Probability by chance below which FRFs are called worse (signed-rank test).
    """

    span: float = 3.0
    unknown: float = 0.8
    far: float = 2.0
    named: int = 5
    worse: float = 0.05


COMPARED = ComparedDamping()


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredDamping:
    """Damping ratios of test modes with a partner in the final model, (t,) each."""

    fe: Int
    names: tuple[str, ...]
    hertz: Float
    ratio: Float
    std: Float
    used: Bool
    elastic: Bool

    @classmethod
    def of(cls, c: StudyConfiguration) -> MeasuredDamping:
        """Of the rigid-body and the elastic reference modes, those with damping above 0.

        A test without standard deviations of its damping adds nothing to the error of the shapes.
        """
        final = c.final
        reference = c.reference
        rigid = rigid_table(reference, final.observed, c.session.config)
        kinds = (
            ("ambient", reference.rigid, reference.rigid_std, rigid),
            ("test", reference.elastic, reference.elastic_std, final.table),
        )
        names: list[str] = []
        columns = []
        for what, modes, uncertainty, table in kinds:
            a = table.pairing.a
            names += [f"{what} mode {i + 1}" for i in a.tolist()]
            columns.append(
                (
                    table.pairing.b,
                    modes.frequencies[a],
                    modes.damping[a],
                    uncertainty.damping[a],
                    table.used,
                )
            )
        fe, hertz, ratio, std, used = map(np.concatenate, zip(*columns, strict=True))
        moving = final.observed.frequencies[fe] > 0
        good = np.flatnonzero((ratio > 0) & ~np.isinf(std) & moving)
        return cls(
            fe=fe[good],
            names=tuple(names[i] for i in good.tolist()),
            hertz=hertz[good],
            ratio=ratio[good],
            std=std[good],
            used=used[good].astype(bool),
            elastic=good >= len(rigid),
        )


def nothing(why: str) -> DampingStage:
    """A stage that found nothing to do."""
    return DampingStage(
        why=why,
        regions=None,
        modes=None,
        misfit=0.0,
        before="",
        flags=(),
        files=(),
        changes=(),
    )


@dataclass(frozen=True, slots=True, eq=False)
class DampedDeck:
    """A delivered deck on its modes that move (n), and what its test says of their damping.

    Attributes
    ----------
    name : str
    opened : Opened
    test : MeasuredDamping
    moving : (n,) int64
    values : (n,) float64
        λ.
    shapes : (dof, n) float64
    total : two (n, n) float64
        ΦᵀDΦ and ΦᵀHΦ of the deck.
    """

    name: str
    opened: Opened
    test: MeasuredDamping
    moving: Int
    values: Float
    shapes: Float
    total: tuple[Float, Float]

    @classmethod
    def of(
        cls, name: str, opened: Opened, modes: ModeSet, test: MeasuredDamping
    ) -> DampedDeck:
        """Of a deck with all its modes in the range of the test."""
        system = opened.analysis.system
        f = modes.frequencies
        # what is paired with a test mode moves, slow as it may be
        moving = np.union1d(np.flatnonzero(elastic(f)), test.fe)
        shapes = modes.shapes[:, moving]
        return cls(
            name=name,
            opened=opened,
            test=test,
            moving=moving,
            values=(2 * np.pi * f[moving]) ** 2,
            shapes=shapes,
            total=project(
                np.asarray(system.local @ shapes), system.viscous, system.structural
            ),
        )

    @property
    def at(self) -> Int:
        """Partner of each test mode among those that move, (t,)."""
        return np.searchsorted(self.moving, self.test.fe)

    def before(self, common: float) -> tuple[Float, Float]:
        """ΦᵀDΦ and ΦᵀHΦ before: the deck's own damping, or one ratio for all modes where it has
        none.
        """
        if any(a.any() for a in self.total):
            return self.total
        viscous = np.diag(2 * common * np.sqrt(self.values))
        return viscous, np.zeros_like(viscous)


@dataclass(frozen=True, slots=True, eq=False)
class FittedRegions:
    """Damping of regions, fitted to the tests of some decks.

    Attributes
    ----------
    dampers : Dampers
        Of all decks side by side.
    fit : DampingFit
    common : float
        Median damping ratio of the first test.
    after, after_std : (t,) float64
        Damping ratios of the test modes of all decks by the fit.
    """

    dampers: Dampers
    fit: DampingFit
    common: float
    after: Float
    after_std: Float


def fit_regions(
    decks: Sequence[DampedDeck], wanted: Sequence[DampingRegion], error: float
) -> FittedRegions | None:
    """Regions with one set of coefficients for all decks, fitted to the test modes that are used;
    None if no region takes part in any mode.

    Parameters
    ----------
    decks : sequence of DampedDeck
        The first one has all the regions.
    wanted : sequence of DampingRegion
    error : float
        Relative error of a ratio that the best model keeps, added to that of the test.
    """
    first = decks[0].test
    common = float(np.median(first.ratio[first.used]))
    found = []
    for deck in decks:
        there = wanted if deck is decks[0] else _present(wanted, deck.opened)
        model = deck.opened.model
        found.append(
            dampers(
                model, there, deck.values, deck.shapes, total=deck.total, ratio=common
            )
        )
    if not found[0].regions:
        return None
    whole = joined_dampers(found)
    values = np.concatenate([deck.values for deck in decks])
    start = np.cumsum([0, *(deck.values.size for deck in decks)]).tolist()
    at = np.concatenate([deck.at + k for deck, k in zip(decks, start, strict=False)])
    ratio = np.concatenate([deck.test.ratio for deck in decks])
    std = np.concatenate([deck.test.std for deck in decks])
    use = np.concatenate([deck.test.used for deck in decks])
    # of modes of a file the standard deviation may not be known
    std = np.hypot(np.nan_to_num(std), error * ratio)
    fit = fit_poles(
        values, whole.mechanisms, ratio[use], std[use], at[use], base=whole.base
    )
    after, after_std = mode_damping(values, whole.mechanisms, fit, at)
    return FittedRegions(whole, fit, common, after, after_std)


def run(session: Session, progress: Progress) -> DampingStage:
    """Fit the regions to the modes that the updating saw, predict those left out, compare the FRFs.

    The tests of all configurations have one set of coefficients; FRFs are those of the study's own.
    """
    progress(0.1, "modes of the delivered decks")
    decks = []
    for c in session.configurations:
        test = MeasuredDamping.of(c)
        if c is session.own and not test.used.any():
            return nothing(
                "no test mode with a damping ratio has a partner in the final model"
            )
        if test.fe.size:
            opened = delivered(c).opened
            decks.append(
                DampedDeck.of(c.name, opened, opened.modes(session.fmax).modes, test)
            )
    progress(0.5, "damping of the regions")
    own = decks[0]
    found = fit_regions(
        decks, regions(session, own.opened), session.config.damping.error
    )
    if found is None:
        return nothing("no region takes part in any mode")
    progress(0.8, "FRFs around the resonances")
    n = own.values.size
    fitted = found.fit.viscous[:n, :n], found.fit.structural[:n, :n]
    errors = frf_errors(
        session, own.test, own.moving, (own.before(found.common), fitted)
    )
    modes = []
    start = 0
    for deck in decks:
        mine = slice(start, start + deck.at.size)
        start += deck.at.size
        modes.append(
            _modes(deck, found.common, found.after[mine], found.after_std[mine])
        )
    before = "the damping of the deck"
    if not any(a.any() for a in own.total):
        before = f"{100 * found.common:.2f} % for all modes, the median of the test"
    why = refusal(errors[0], errors[1], found.after_std[: own.at.size] / own.test.ratio)
    changes: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    if not why:
        changes, files = _written(session, own.opened, found.dampers, found.fit)
    return DampingStage(
        why=why,
        regions=_regions(found.dampers, found.fit),
        modes=replace(modes[0], frf_before=errors[0], frf_after=errors[1]),
        misfit=found.fit.misfit,
        before=before,
        flags=flags(found.dampers, found.fit),
        files=files,
        changes=changes,
        others=tuple(
            DampedConfiguration(deck.name, m)
            for deck, m in zip(decks[1:], modes[1:], strict=True)
        ),
    )


def _modes(
    deck: DampedDeck, common: float, after: Float, after_std: Float
) -> DampedModes:
    """The paired modes of a deck; errors of FRFs are not known."""
    t = deck.test
    unknown = np.full(t.hertz.size, np.nan)
    before = complex_modes(deck.values, *deck.before(common)).damping[deck.at]
    return DampedModes(
        fe=t.fe,
        test=t.names,
        used=t.used,
        hertz=t.hertz,
        measured=t.ratio,
        measured_std=t.std,
        before=before,
        after=after,
        after_std=after_std,
        frf_before=unknown,
        frf_after=unknown,
    )


def _present(
    wanted: Sequence[DampingRegion], opened: Opened
) -> tuple[DampingRegion, ...]:
    """Those of the regions that a deck has, as far as it has their fields."""
    model = opened.model
    out = []
    for r in wanted:
        targets = tuple(
            t
            for t in r.targets
            if t.card in model and (model[t.card].ids == t.id).any()
        )
        if targets:
            out.append(replace(r, targets=targets))
    return tuple(out)


def regions(session: Session, opened: Opened) -> tuple[DampingRegion, ...]:
    """As stated in the study; else one a material and one a group of springs."""
    stated = session.config.damping.region
    if stated:
        return tuple(r.region() for r in stated)
    return default_regions(
        opened.model, session.config.suspensions(), session.deck.regions
    )


def frf_errors(
    session: Session,
    test: MeasuredDamping,
    moving: Int,
    damped: tuple[tuple[Float, Float], ...],
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
    width = COMPARED.span * test.ratio * test.hertz
    near = np.abs(frfs.freqs[:, None] - test.hertz) <= width  # (line, mode)
    # the ambient test sees rigid-body modes, the hammer does not
    near[:, ~test.elastic] = False
    lines = np.flatnonzero(near.any(axis=1))
    data = frfs.data[lines] * session.unit.kilograms
    # an exponential window damps every mode by as much
    window = 2 * frfs.window_decay * np.eye(moving.size)
    out = []
    for d, h in damped:
        model = coupled(
            frfs.freqs[lines],
            CoupledModes(values, d + window, h),
            phi_out=phi_out,
            phi_in=phi_in,
            kind=frfs.kind,
        )
        wrong = _power(model - data) @ near[lines]
        size = _power(data) @ near[lines]
        unknown = np.full(size.shape, np.nan)
        out.append(np.sqrt(np.divide(wrong, size, out=unknown, where=size > 0)))
    return out


def refusal(before: Float, after: Float, known: Float) -> str:
    """Why damping by region is refused: FRFs around the resonances are worse with it, by more than
    the errors of its ratios explain.

    An error of a ratio by δ changes the FRF of its mode by δ/√2 around the resonance (norm over all
    lines).

    Parameters
    ----------
    before, after : (t,) float64
        Relative errors of the FRFs around each test mode; NaN where there is none.
    known : (t,) float64
        Relative standard deviations of the ratios by region.

    Returns
    -------
    str
        Empty where they are not worse (Wilcoxon 1945, signed ranks of the modes).
    """
    from scipy.stats import wilcoxon  # slow to import, and few commands need it

    there = np.isfinite(before) & np.isfinite(after)
    one, two = before[there], after[there]
    explained = np.hypot(one, known[there] / np.sqrt(2))
    if not np.any(two > explained):
        return ""
    if wilcoxon(two, explained, alternative="greater").pvalue >= COMPARED.worse:
        return ""
    first, last = (100 * float(np.sqrt(np.mean(x**2))) for x in (one, two))
    return (
        f"with it the measured FRFs around the resonances deviate by {last:.1f} %, without it by "
        f"{first:.1f} %; predictions take the damping ratios of the test"
    )


def _power(data: Complex) -> Float:
    """Of all FRFs at each line, (l,)."""
    return np.asarray((np.abs(data) ** 2).sum(axis=(1, 2)))


def _regions(found: Dampers, fit: DampingFit) -> DampedRegions:
    expected, spread = np.array([(m.prior, m.std) for m in found.mechanisms]).T
    # a model that misfits takes nothing away from what was known
    shrink = np.minimum(spread / fit.std, 1.0)
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
    return "; ".join(
        text
        if len(text) <= COMPARED.named
        else [*text[: COMPARED.named], f"{len(text) - COMPARED.named} more"]
    )


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
        elif away > COMPARED.far:
            out.append(
                f"{m.name}: {c:.3g} is {away:.1f} standard deviations above the expected "
                f"{m.prior:.2g}"
            )
    lost = [
        m.name
        for m, s in zip(found.mechanisms, fit.std.tolist(), strict=True)
        if s > COMPARED.unknown * m.std
    ]
    if lost:
        more = (
            f" and {len(lost) - COMPARED.named} more"
            if len(lost) > COMPARED.named + 1
            else ""
        )
        named = ", ".join(lost[: COMPARED.named] if more else lost) + more
        out.append(
            f"the test says little about {named}: their values are those expected, or zero"
        )
    return tuple(out)


def _written(
    session: Session, opened: Opened, found: Dampers, fit: DampingFit
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The changed fields, and the files of a copy of the delivered deck with them; none unless
    asked for.
    """
    if not session.config.damping.write:
        return (), ()
    values = zip(found.regions, fit.coefficients.tolist(), strict=True)
    every = [c for r, v in values for c in r.changes(v)]
    # a blank is 0
    changes = [
        c for c in every if c.value != np.nan_to_num(field_value(opened.model, c))
    ]
    files = edit_fields(opened.model, changes, session.folder("damped"))
    return tuple(change_text(opened.model, c) for c in changes), tuple(
        str(f) for f in files
    )
