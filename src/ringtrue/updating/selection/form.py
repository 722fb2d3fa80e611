"""Which physical cause the deviations of a deck follow: patterns of form, compared before
parameters are proposed.

Each cause is a small model of the deviations Δ = ln(λ test / λ deck) with one or two unknowns, its
changes of λ by the deck's own matrices (`form_changes`); a normal scatter τ of unknown size is
added to the stated errors. Causes are compared with each other and with none by BIC (Schwarz 1978),
the choice among so many causes paid for (Burnham and Anderson 2002, ch. 6); differences of 6 are
strong evidence (Kass and Raftery 1995).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from ringtrue.core.arrays import Float, FrozenArrays, Int
from ringtrue.core.notes import Note
from ringtrue.updating.selection.form_changes import RECTANGLE, FormChange

PATTERNS = ("shear", "common", "supports", "property", "single")


@dataclass(frozen=True, slots=True)
class FormSettings:
    """When a pattern is named.

    Attributes
    ----------
    evidence : float
        Fall of BIC against no pattern.
    tie : float
        Difference of BIC up to which two patterns are as good.
    least : int
        Paired modes.
    floor : float
        Standard deviation of ln λ that no deck is better than.
    ratio : float
        Relative standard deviation of a loss factor that no deck is better than.
    listed : int
        Fields that a note names.
    """

    evidence: float = 6.0
    tie: float = 2.0
    least: int = 5
    floor: float = 2e-4
    ratio: float = 0.01
    listed: int = 6


@dataclass(frozen=True, slots=True)
class AmountSearch:
    """The search for amounts of causes and for the scatter.

    Attributes
    ----------
    steps, zooms : int
        Of the grids of amounts, each finer than the one before.
    sizes : int
        Of the scatter.
    unit : float
        Amount from which on a path is spread by its order.
    """

    steps: int = 41
    zooms: int = 4
    sizes: int = 60
    unit: float = 0.2


SEARCH = AmountSearch()
FORM = FormSettings()


@dataclass(frozen=True, slots=True, eq=False)
class ModeDeviations(FrozenArrays):
    """ModeDeviations of paired modes.

    Attributes
    ----------
    test, fe : (n,) int64
        Test modes and modes of the deck, from 0.
    change : (n,) float64
        ln(λ test / λ deck).
    std : (n,) float64
        Stated standard deviation; 0 where unknown.
    """

    test: Int
    fe: Int
    change: Float
    std: Float


@dataclass(frozen=True, slots=True, eq=False)
class FormPattern(FrozenArrays):
    """A cause, and what it explains.

    Attributes
    ----------
    pattern : str
        `shear`, `common`, `supports`, `property`, `single`, or `damping`.
    cause : str
        In words.
    unknowns : int
    amounts : (unknowns,) float64
        Their estimates; what they count is in `FormChange`.
    explained : float
        Share of the weighted squared deviations, ΔᵀWΔ.
    evidence : float
        Fall of BIC against no pattern; above `FormSettings.evidence` strong.
    fields : tuple of str
        Parameters to propose.
    modes : tuple of int
        Test modes, from 0, that a pattern of one mode is about.
    """

    pattern: str
    cause: str
    unknowns: int
    amounts: Float
    explained: float = np.nan
    evidence: float = np.nan
    fields: tuple[str, ...] = ()
    modes: tuple[int, ...] = ()

    @property
    def name(self) -> tuple[str, str]:
        """What distinguishes it from others, also once it was stored."""
        return self.pattern, self.cause


@dataclass(frozen=True, slots=True, eq=False)
class FormFindings:
    """Patterns of form, the best first, one of each kind.

    Attributes
    ----------
    patterns : tuple of FormPattern
        All that were compared.
    named : tuple of FormPattern
        Those that stand out: one of frequencies, and those that are as good; one of damping.
    modes : int
        Pairs that were compared.
    scatter : float
        Standard deviation of ln λ that the first pattern leaves beyond the stated errors.
    """

    patterns: tuple[FormPattern, ...] = ()
    named: tuple[FormPattern, ...] = ()
    modes: int = 0
    scatter: float = 0.0

    @property
    def notes(self) -> tuple[Note, ...]:
        """What stands out and what to do, a note each."""
        return tuple(self._note(p) for p in self.named)

    def _note(self, p: FormPattern) -> Note:
        of_damping = p.pattern == "damping"
        same = (o for o in self.patterns if (o.pattern == "damping") == of_damping)
        rivals = [o for o in same if o.name != p.name]
        more = " and more" if len(p.fields) > FORM.listed else ""
        values: Mapping[str, float | int | str] = {
            "cause": p.cause,
            "percent": 100 * p.explained,
            "modes": self.modes,
            "unknowns": f"{p.unknowns} unknown{'s' if p.unknowns > 1 else ''}",
            "evidence": p.evidence,
            "rival": rivals[0].cause if rivals else "no other",
            "rival_percent": 100 * rivals[0].explained if rivals else 0.0,
            "margin": p.evidence - (rivals[0].evidence if rivals else 0.0),
            "factor": RECTANGLE / max(float(p.amounts[0]), 1e-3),
            "fields": "; ".join(p.fields[: FORM.listed]) + more,
        }
        return Note(f"form {p.pattern}", "warning", p.cause, values)


def may_stand_out(found: ModeDeviations, settings: FormSettings = FORM) -> bool:
    """Whether a cause of one unknown that explained all would be named; if not, none is."""
    n = found.change.size
    if n < settings.least:
        return False
    fit = _Likelihood(found.change, found.std**2 + settings.floor**2)
    none, _ = fit.deviance(found.change)
    every, _ = fit.deviance(np.zeros(n))
    return bool(none - every - np.log(n) > settings.evidence)


def form_patterns(
    found: ModeDeviations,
    changes: Sequence[FormChange],
    places: Sequence[str] = (),
    settings: FormSettings = FORM,
) -> FormFindings:
    """Which cause the deviations follow, if any.

    Parameters
    ----------
    found : ModeDeviations
    changes : sequence of FormChange
        Of the same modes, (k, n) each.
    places : sequence of str, optional
        Where each mode is by itself (n): what a deviation of one mode alone points to.
    """
    n = found.change.size
    if n < settings.least:
        return FormFindings(modes=n)
    fit = _Likelihood(found.change, found.std**2 + settings.floor**2)
    none, _ = fit.deviance(found.change)
    every = [fit.of((c,)) for c in changes]
    joint = tuple(c for c in changes if c.joint)
    if len(joint) > 1:
        every.append(fit.of(joint))
    every += [
        fit.alone(j, int(found.test[j]), places[j] if places else "") for j in range(n)
    ]
    count = {p: sum(e.found.pattern == p for e in every) for p in PATTERNS}
    kinds = sum(c > 0 for c in count.values())
    best = dict[str, FormPattern]()
    scatter = {}
    for e in every:
        price = e.found.unknowns * np.log(n) + 2 * np.log(
            kinds * count[e.found.pattern]
        )
        p = e.pattern_against(float(none - e.deviance - price))
        if p.pattern not in best or p.evidence > best[p.pattern].evidence:
            best[p.pattern] = p
            scatter[p.pattern] = e.scatter
    order = sorted(best.values(), key=lambda p: -p.evidence)
    first = order[0]
    named = tuple(
        p
        for p in order
        if p.evidence > settings.evidence and p.evidence > first.evidence - settings.tie
    )
    return FormFindings(tuple(order), named, n, scatter[first.pattern])


@dataclass(frozen=True, slots=True, eq=False)
class LossFactors(FrozenArrays):
    """Damping of paired modes, test and deck.

    Attributes
    ----------
    test, std, deck : (n,) float64
        Loss factors 2ζ of the test, their standard deviations (0 where unknown), and of the deck.
    joints : (n,) float64
        Share of strain energy in joints.
    """

    test: Float
    std: Float
    deck: Float
    joints: Float


def with_damping(
    found: FormFindings, loss: LossFactors, settings: FormSettings = FORM
) -> FormFindings:
    """The same with the pattern that damping follows where frequencies follow none.

    A loss factor in common (of the material) is held against one in proportion to the energy in
    joints. Only where both the test and the deck have damping.
    """
    excess = loss.test - loss.deck
    n = excess.size
    if (
        found.named
        or n < settings.least
        or not loss.deck.any()
        or not loss.joints.any()
    ):
        return found
    # relative: a damping ratio is not known better than to some hundredths
    variance = loss.std**2 + (settings.ratio * np.median(np.abs(loss.test))) ** 2
    fit = _Likelihood(excess, variance)
    none, _ = fit.deviance(excess)
    every = []
    for cause, slope in (("material", np.ones(n)), ("joints", loss.joints)):
        top = 3 * float(np.abs(excess).max()) / float(slope.max())
        amount = np.array([-top, 0.0, top])
        path = FormChange("damping", cause, (), amount, amount[:, None] * slope)
        one = fit.of((path,))
        evidence = float(none - one.deviance) - np.log(n) - 2 * np.log(2)
        every.append(one.pattern_against(evidence))
    material, joints = every
    stands_out = joints.evidence > settings.evidence + max(material.evidence, 0.0)
    return replace(
        found,
        patterns=(*found.patterns, *sorted(every, key=lambda p: -p.evidence)),
        named=(joints,) if stands_out else (),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _CauseFit:
    """A cause at its best amounts, before its evidence is known."""

    found: FormPattern
    deviance: float
    scatter: float

    def pattern_against(self, evidence: float) -> FormPattern:
        """With its evidence."""
        return replace(self.found, evidence=evidence)


@dataclass(frozen=True, slots=True, eq=False)
class _Likelihood:
    """Maximum likelihood of normal deviations (n,), stated variances, and a scatter in common."""

    change: Float
    variance: Float

    def deviance(self, rest: Float) -> tuple[Float, Float]:
        """−2 ln L of residuals (..., n) at the best scatter, and that, (...)."""
        top = max(float(np.abs(self.change).max()), 1e-6)
        low = np.sqrt(self.variance.min()) / 10
        tau = np.concatenate(
            [[0.0], np.geomspace(min(low, top / 10), 2 * top, SEARCH.sizes)]
        )
        value = np.stack(
            [
                (rest**2 / (self.variance + t**2) + np.log(self.variance + t**2)).sum(
                    axis=-1
                )
                for t in tau.tolist()
            ]
        )
        return value.min(axis=0), tau[value.argmin(axis=0)]

    def of(self, changes: tuple[FormChange, ...]) -> _CauseFit:
        """One or more causes together, their changes of ln λ added."""
        axes = [_axis(c) for c in changes]
        paths = [
            PchipInterpolator(u, c.change)
            for (u, _), c in zip(axes, changes, strict=True)
        ]
        low = np.array([u[0] for u, _ in axes])
        high = np.array([u[-1] for u, _ in axes])
        begin, end = low, high
        best = low
        for _ in range(SEARCH.zooms):
            grids = [
                np.linspace(a, b, SEARCH.steps) for a, b in zip(begin, end, strict=True)
            ]
            parts = [path(g) for path, g in zip(paths, grids, strict=True)]
            rest = self.change - parts[0]
            if len(parts) > 1:
                rest = rest[:, None, :] - parts[1][None]
            value, _ = self.deviance(rest)
            at = np.unravel_index(int(value.argmin()), value.shape)
            best = np.array([g[i] for g, i in zip(grids, at, strict=True)])
            reach = 2 * (end - begin) / (SEARCH.steps - 1)
            begin = np.maximum(best - reach, low)
            end = np.minimum(best + reach, high)
        rest = self.change - sum(path(b) for path, b in zip(paths, best, strict=True))
        amounts = [
            unit * float(np.sinh(b))
            for b, (_, unit) in zip(best.tolist(), axes, strict=True)
        ]
        fields = tuple(dict.fromkeys(f for c in changes for f in c.fields))
        cause = " and ".join(c.cause for c in changes)
        found = FormPattern(
            changes[0].pattern, cause, len(amounts), np.array(amounts), fields=fields
        )
        return self._judged(found, rest)

    def alone(self, j: int, test: int, place: str) -> _CauseFit:
        """Mode j by itself."""
        rest = self.change.copy()
        rest[j] = 0.0
        cause = f"test mode {test + 1} alone"
        fields = (place,) if place else ()
        found = FormPattern(
            "single", cause, 1, self.change[[j]], fields=fields, modes=(test,)
        )
        return self._judged(found, rest)

    def _judged(self, found: FormPattern, rest: Float) -> _CauseFit:
        """By the residuals that it leaves."""
        value, scatter = self.deviance(rest)
        left = float((rest**2 / self.variance).sum())
        explained = 1 - left / max(
            float((self.change**2 / self.variance).sum()), 1e-300
        )
        found = replace(found, explained=explained)
        return _CauseFit(found, float(value), float(scatter))


def _axis(c: FormChange) -> tuple[Float, float]:
    """Abscissae on which a path is even, arcsinh(amount/unit), and the unit: amounts of several
    decades are spread by their order, a proportional change is left as it is.
    """
    straight = np.allclose(c.change, np.outer(c.amount, c.change[-1] / c.amount[-1]))
    unit = 1e3 * c.amount[-1] if straight else SEARCH.unit
    return np.asarray(np.arcsinh(c.amount / unit)), float(unit)
