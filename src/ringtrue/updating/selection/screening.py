"""Which of many candidates are looked at closely: seen from the deck, then from where a first
choice of them leads.

The slopes at a deck that is far off tell little of some candidates. So the set that is chosen among
those that explain most from there only leads nearer, and all are weighed again with the modes found
there (iterated screening: Fan and Lv 2008, sec. 4.1). Of many modes the lowest lead: those of a
dense band find partners only once these are right.

Candidates held against the modes: what no mode strains or moves cannot be found from modes, and
is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import zip_longest
from typing import Any, Protocol, TypeVar

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.fem.assembly import System
from ringtrue.fem.mesh import union
from ringtrue.fem.parametrisation.changed_model import rows_of, within
from ringtrue.fem.parametrisation.derivatives import (
    congruent,
    matrices_kept,
    quadratic_forms,
)
from ringtrue.model.model import Model
from ringtrue.model.ports import Linearisation
from ringtrue.reduction.dense_models import HeldModel
from ringtrue.reduction.expansion import ShapeReadings, expand_reduced
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.updating.problem import (
    Configuration,
    KnownPoint,
    Problem,
    residual_at,
    single,
)
from ringtrue.updating.selection.candidates import (
    Candidate,
    Kind,
    counted,
    membership,
    parameters,
)
from ringtrue.updating.selection.localisation import EXPANSION_MISFIT
from ringtrue.updating.selection.selection_rules import Candidates, falling
from ringtrue.updating.selection.subset_search import (
    DEFAULT_SEARCH,
    Search,
    SearchSettings,
    subsets,
)
from ringtrue.updating.target import Target
from ringtrue.updating.uncertainty import errors_of_shapes

NEAR = 16  # modes of the model along which the force residual of a test mode is taken
# Weights of a misfit over those of an updating: what candidates explain is small compared with the
# discrepancy that an updating assumes.
SHARP = 0.3


@dataclass(frozen=True, slots=True)
class Dropped:
    """A candidate that is left out, and why."""

    name: str
    reason: str


def effective(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    values: Float,
    vectors: Float,
) -> tuple[tuple[Candidate, ...], tuple[Dropped, ...]]:
    """Those candidates that change one of the modes, and those that do not.

    Of a candidate that no mode strains or moves, ∂K φ = ∂M φ = 0: neither frequency nor shape
    depends on it.

    Parameters
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64, unit modal mass
    """
    return effective_by(
        candidates, *effects(model, system, candidates, values, vectors)
    )


def effective_by(
    candidates: Sequence[Candidate], strain: Float, kinetic: Float
) -> tuple[tuple[Candidate, ...], tuple[Dropped, ...]]:
    """`effective` where the `effects` (m, p) are known."""
    most = (np.abs(strain) + np.abs(kinetic)).max(axis=0, initial=0.0)
    keep = []
    lost = []
    for c, size in zip(candidates, most, strict=True):
        if size > SIZES.effective:
            keep.append(c)
        else:
            why = f"no mode has more than {size:.1e} of its energy in {c.what}"
            lost.append(Dropped(c.name, why))
    return tuple(keep), tuple(lost)


def effects(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    values: Float,
    vectors: Float,
) -> tuple[Float, Float]:
    """φᵀ(∂K/∂x)φ/λ and φᵀ(∂M/∂x)φ of each mode and candidate, (m, p) each; ∂ ln f/∂x is half their
    difference.

    Parameters
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64, unit modal mass
    """
    dk, dm = quadratic_forms(model, [c.parameter for c in candidates], system, vectors)
    return relative_effects(values, dk), dm


def relative_effects(values: Float, d_stiffness: Float) -> Float:
    """φᵀ(∂K/∂x)φ/λ from φᵀ(∂K/∂x)φ, (m, p); no λ is next to 0."""
    lam = np.maximum(np.abs(values), 1e-6 * np.abs(values).max(initial=1e-300))
    return np.asarray(d_stiffness / lam[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class SeenModes:
    """Modes of a model, of unit modal mass, on all its degrees of freedom and at the channels.

    Attributes
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64
    readings : (channel, m) float64
    """

    values: Float
    vectors: Float
    readings: Float


# weighted misfit (n,), and −∂misfit/∂x in units of the prior (n, p)
Misfit = tuple[Float, Float]


def misfits(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    modes: SeenModes,
    aim: Target,
) -> tuple[Misfit, Misfit]:
    """What the test finds wrong near the model and far from it, and what each candidate adds.

    Near: deviations of the modes that are paired, the residual of an updating. Nothing is expanded,
    and noise of the shapes is separated from errors that candidates could make, but modes far off
    have no part in it. Derivatives of shapes along the modes nearest to each (Fox and Kapoor 1968).

    Far: what the test's modes leave of the model's equation of motion, φ_kᵀ(K − ω²M)u of each used
    test mode, u being its shape expanded in the modes of the model, along the modes φ_k nearest to
    it: linear in the parameters, without a pairing and without a solution. Weighted by `SHARP`
    times the errors that shape and frequency are assumed to keep (`Weights`). Fissette,
    Stavrinidis and Ibrahim (1988).
    """
    chosen = parameters(candidates)
    changes = congruent(model, chosen.parameters, system, modes.vectors)
    return misfits_by(chosen, changes, modes, aim)


def misfits_by(
    chosen: ParameterSet,
    changes: Iterable[tuple[int, Float, Float]],
    modes: SeenModes,
    aim: Target,
) -> tuple[Misfit, Misfit]:
    """`misfits` where the changes of K and M along the modes are known, as `congruent` gives
    them.
    """
    kinds = _paired(chosen, modes, aim), _force(chosen, modes, aim)
    found = [np.zeros((2, *kind.near.shape, len(chosen))) for kind in kinds]
    for i, *both in changes:
        for kind, out in zip(kinds, found, strict=True):
            for total, change in zip(out, both, strict=True):
                if change.size:
                    total[:, :, i] += np.take_along_axis(change @ kind.u, kind.near, 0)
    return kinds[0].made(*found[0]), kinds[1].made(*found[1])


@dataclass(frozen=True, slots=True, eq=False)
class _Kind:
    """A kind of misfit before the candidates are asked.

    Attributes
    ----------
    near : (k, n) int64
        Modes φ_k of the model that each vector v is taken along.
    u : (m, n) float64
        The vectors v in the modes.
    made : callable (φ_kᵀ∂Kv, φ_kᵀ∂Mv), (k, n, p) each -> Misfit
    """

    near: Int
    u: Float
    made: Callable[[Float, Float], Misfit]


def _force(chosen: ParameterSet, modes: SeenModes, aim: Target) -> _Kind:
    values = modes.values
    f = aim.frequencies[aim.used]
    shapes = aim.shapes[:, aim.used]
    omega2 = (2 * np.pi * f) ** 2
    energy = np.diag(np.abs(values) + omega2.min())
    own = np.diag(values), np.eye(values.size)
    u = expand_reduced(
        *own, energy, ShapeReadings(modes.readings, shapes, f, EXPANSION_MISFIT)
    ).shapes
    u = u / np.maximum(np.linalg.norm(u, axis=0), 1e-300)
    gap = values[:, None] - omega2
    near = np.argsort(np.abs(gap), axis=0, kind="stable")[:NEAR]
    gap = np.take_along_axis(gap, near, 0)
    along = np.take_along_axis(u, near, 0)
    of_frequency = (
        2 * np.hypot(SHARP * aim.weights.frequency, aim.std[aim.used]) * omega2
    )
    sigma = np.hypot(SHARP * np.sqrt(aim.weights.mac) * gap, of_frequency)

    def made(dk: Float, dm: Float) -> Misfit:
        slopes = (omega2[:, None] * dm - dk) / sigma[:, :, None]
        return (gap * along / sigma).ravel(), slopes.reshape(
            gap.size, len(chosen)
        ) * chosen.std()

    return _Kind(near, u, made)


def _paired(chosen: ParameterSet, modes: SeenModes, aim: Target) -> _Kind:
    values = modes.values
    far = np.abs(values - values[:, None])
    np.fill_diagonal(far, -1.0)  # the first is the mode itself
    near = np.argsort(far, axis=0, kind="stable")[:NEAR]
    gap = values - values[near]
    # modes as close only rotate into each other
    distinct = np.abs(gap) > 1e-6 * np.abs(values)
    w = aim.weights

    def made(dk: Float, dm: Float) -> Misfit:
        slope = dk - values[:, None] * dm
        gaps = np.where(distinct, gap, 1.0)[:, :, None]
        share = np.where(distinct[:, :, None], slope / gaps, 0.0)
        share[0] = -dm[0] / 2
        d_shapes = modes.readings[:, near].transpose(2, 0, 1) @ share.transpose(1, 0, 2)
        now = Linearisation(
            x=np.zeros(len(chosen)),
            frequencies=np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi),
            shapes=modes.readings,
            d_lambda=slope[0],
            d_shapes=np.moveaxis(d_shapes, 0, 1),
        )
        sharp = replace(
            w,
            frequency=SHARP * w.frequency,
            mac=SHARP**2 * w.mac,
            independent=errors_of_shapes(aim, now),
        )
        known = Configuration(KnownPoint(chosen, now), replace(aim, weights=sharp))
        r = residual_at(Problem((known,)), now.x)
        return r.value, r.slope * chosen.std()

    return _Kind(near, np.eye(values.size), made)


@dataclass(frozen=True, slots=True)
class ScreeningSizes:
    """How much the screening of candidates may take.

    Attributes
    ----------
    modes : int
        Modes at most by which the first choice is made.
    vectors : int
        Vectors of the model that a proposal searches with.
    draws : int
        Points of the prior whose modes it holds, with those of each candidate by itself.
    matrices : int
        Matrices that those acting on one element may keep of all theirs: they take the memory.
    effective : float
        Share of a mode's energy from which on a candidate changes it.
    elements : int
        Elements of a deck of which 100 matrices each are little: up to there it is counted what
        is kept.
    """

    modes: int = 60
    vectors: int = 160
    draws: int = 20
    matrices: int = 100
    effective: float = 1e-5
    elements: int = 1000


SIZES = ScreeningSizes()

Kept = Callable[..., int | None]
KIND: dict[str, Kind] = {
    **dict.fromkeys(("MAT1", "MAT2", "MAT8", "MAT9"), "material"),
    **dict.fromkeys(
        ("PBUSH", "PBUSH1D", "PFAST", "PGAP", "PELAS", "CELAS2", "CELAS4"), "spring"
    ),
    **dict.fromkeys(("CONM2", "PMASS", "CMASS2", "CMASS4"), "mass"),
}
MASS_ONLY = {"RHO", "NSM", "NSMB", "M", "I11", "I21", "I22", "I31", "I32", "I33"}


class OtherData(Protocol):
    """What was measured beyond the modes, over all candidates."""

    def misfit(
        self, at: ReducedModel | None, x: Float, which: Sequence[int], aim: Target
    ) -> Misfit:
        """As those of `misfits`, at x (k,) of a model over the candidates `which`; of the deck
        without a model.
        """

    def problem(self, search: Any, aim: Target) -> Problem:
        """Modes and data of a model that is searched with."""


@dataclass(frozen=True, slots=True, eq=False)
class ScreenedDeck:
    """A deck as its candidates are screened.

    Attributes
    ----------
    model : Model
    system : System
    candidates : tuple of Candidate
        All that change a mode.
    observe : (channel, f) csr float64
        Readings of the channels of the test by the free degrees of freedom.
    values, vectors : (m,), (f, m) float64
        λ, (rad/s)², and shapes of unit modal mass.
    data : OtherData, optional
        What else was measured: it counts with the modes, and a candidate that it alone sees is
        seen.
    """

    model: Model
    system: System
    candidates: tuple[Candidate, ...]
    observe: sparse.csr_array
    values: Float
    vectors: Float
    data: OtherData | None = None

    def misfits(self, modes: tuple[Float, Float], aim: Target) -> tuple[Misfit, ...]:
        """`misfits` of all candidates with modes (λ, vectors) of the deck or of a model of
        it.
        """
        seen = SeenModes(*modes, self.observe @ modes[1])
        return misfits(self.model, self.system, self.candidates, seen, aim)

    def left(
        self, at: ReducedModel | None, x: Float, which: Sequence[int], aim: Target
    ) -> tuple[Misfit, ...]:
        """See `Screening`; what else was measured is a part of each misfit."""
        modes = (self.values, self.vectors) if at is None else at.vectors(x)
        found = self.misfits(modes, aim)
        if self.data is None:
            return found
        more, slopes = self.data.misfit(at, x, which, aim)
        return tuple(
            (np.append(r, more), np.concatenate([g, slopes])) for r, g in found
        )

    def problem(self, search: Candidates, aim: Target) -> Problem:
        """See `Screening`."""
        return (
            single(search, aim) if self.data is None else self.data.problem(search, aim)
        )


@dataclass(frozen=True, slots=True, eq=False)
class HeldDeck:
    """The same where other processes hold the matrices.

    Attributes
    ----------
    model : Model
    candidates : tuple of Candidate
    start : HeldModel
        The deck without a parameter.
    rows : (channel,) int64
        Of the test, among the channels of the held models.
    """

    model: Model
    candidates: tuple[Candidate, ...]
    start: HeldModel
    rows: Int

    def effective(self) -> tuple[HeldDeck, tuple[Dropped, ...]]:
        """With those candidates that change one of the modes; those that do not."""
        values, y = self.start.vectors(np.zeros(0))
        changes = self.start.along([c.parameter for c in self.candidates], y)
        dk, dm = (np.einsum("pmm->mp", a) for a in changes)
        some, lost = effective_by(self.candidates, relative_effects(values, dk), dm)
        return replace(self, candidates=some), lost

    def left(
        self, at: HeldModel | None, x: Float, which: Sequence[int], aim: Target
    ) -> tuple[Misfit, ...]:
        """See `Screening`."""
        model = self.start if at is None else at
        values, y = model.coordinates(x)
        chosen = parameters(self.candidates)
        seen = SeenModes(
            values, model.basis.vectors @ y, model.basis.observe[self.rows] @ y
        )
        changes = model.along(chosen.parameters, seen.vectors)
        return misfits_by(
            chosen, zip(range(len(chosen)), *changes, strict=True), seen, aim
        )

    def problem(self, search: Candidates, aim: Target) -> Problem:
        """See `Screening`."""
        return single(search, aim)


Looked = TypeVar("Looked", contravariant=True)


class Screening(Protocol[Looked]):
    """A deck whose candidates are screened."""

    @property
    def model(self) -> Model: ...

    @property
    def candidates(self) -> tuple[Candidate, ...]: ...

    def left(
        self, at: Looked | None, x: Float, which: Sequence[int], aim: Target
    ) -> tuple[Misfit, ...]:
        """`misfits` of all candidates at the deck, or at x of a model over some of them, by
        position.
        """
        ...

    def problem(self, search: Candidates, aim: Target) -> Problem:
        """The objective over some of the candidates."""
        ...


def screened(
    deck: Screening[Looked],
    aim: Target,
    look: Callable[[tuple[Candidate, ...]], tuple[Candidates, Looked]],
    pool: int,
    *,
    settings: SearchSettings,
    progress: Progress = quiet,
) -> tuple[Candidate, ...]:
    """Up to `pool` of the candidates, in their order.

    Parameters
    ----------
    deck : ScreenedDeck or HeldDeck
    aim : Target
    look : callable (candidates) -> (model to search with, model whose modes the deck looks at)
        The first needs modes for the `SIZES.modes` lowest of the test only.
    pool : int
        Candidates that are kept.
    settings : SearchSettings
        Of the first choice.
    """
    candidates = deck.candidates
    kept = counted_once(deck.model)
    start = deck.left(None, np.zeros(0), (), aim)
    at = close(deck.model, candidates, start, pool, kept=kept)
    some = tuple(candidates[i] for i in at)
    if len(some) == len(candidates):
        return some
    search, whole = look(some)
    low = aim.lowest(SIZES.modes)
    problem = deck.problem(search, low)
    far = replace(settings, passed_over=passed_over(candidates, some))
    found = subsets(
        Search.of(problem, far, conflicts=conflicts(deck.model, some)), progress
    )
    best = found.path[-1]
    groups = found.search.groups
    if not best.members.size:
        return some
    x = np.zeros(len(candidates))
    x[at] = best.x / search.parameters.std()
    stay = at[np.isin(groups, groups[best.members])].tolist()
    near = [(r + g @ x, g) for r, g in deck.left(whole, best.x, at.tolist(), aim)]
    last = close(deck.model, candidates, near, pool, stay=stay, kept=kept)
    return tuple(candidates[i] for i in last)


def close(
    model: Model,
    candidates: Sequence[Candidate],
    misfits: Sequence[Misfit],
    most: int,
    *,
    stay: Sequence[int] = (),
    kept: Kept | None = None,
) -> Int:
    """The candidates that are looked at closely, ascending: of those that can be written as sums
    the first that explain.

    Half as many lumps are added: those that explain most among all, and they crowd none of
    the deck's own out.

    Parameters
    ----------
    misfits : sequence of (misfit (n,), slopes (n, p))
        As in `explaining`; the first of each in turn.
    stay : sequence of int
        Come before all others.
    kept : callable, optional
        As of `tractable`.
    """
    mass = np.array([c.kind == "lump" for c in candidates], dtype=np.bool_)
    own = np.flatnonzero(~mass)
    first = [i for i in _in_turn(misfits, own, 2 * most, stay) if not mass[i]][
        : 2 * most
    ]
    near = tractable(model, [candidates[i] for i in first], most, kept)
    out = [first[i] for i in near]
    if mass.any():
        every = _in_turn(misfits, np.arange(mass.size), 2 * most, stay)
        out += [i for i in every if mass[i]][: most // 2]
    return np.sort(np.array(out, dtype=np.int64))


def _in_turn(
    misfits: Sequence[Misfit], some: Int, most: int, stay: Sequence[int]
) -> list[int]:
    """Those that stay, then of some candidates the first that explain each misfit in turn."""
    orders = [
        some[explaining(r, slopes[:, some], most)].tolist() for r, slopes in misfits
    ]
    out = list(stay)
    for turn in zip_longest(*orders):
        out += [i for i in turn if i is not None]
    return list(dict.fromkeys(out))


def passed_over(candidates: Sequence[Candidate], kept: Sequence[Candidate]) -> int:
    """How many of the candidates are not kept; lumps, of which there are always as many, do not
    count.
    """
    many, few = (sum(c.kind != "lump" for c in some) for some in (candidates, kept))
    return many - few


def explaining(misfit: Float, slopes: Float, most: int) -> Int:
    """Candidates in the order of how much of the misfit each explains with those before free, (k,).

    Forward selection on the score statistic with a prior, (gᵀC⁻¹r)²/(1 + gᵀC⁻¹g) with C = I + Σ ggᵀ
    over those chosen: the fall of the linearised J. Rao (1948). With each come up to two that do
    nearly as well in its place. Where no candidate explains more than noise, the rest are those of
    which the data know most, those chosen given, gᵀC⁻¹g: greedy on ln det(I + GᵀG). Those without
    effect are left out.

    Parameters
    ----------
    misfit : (n,) float64
        Weighted.
    slopes : (n, p) float64
        Weighted, in units of the prior.
    """
    g = np.asarray(slopes, dtype=np.float64)
    inner = g.T @ g  # gᵀC⁻¹g
    rest = g.T @ np.asarray(misfit, dtype=np.float64)  # gᵀC⁻¹r
    chosen: list[int] = []
    out: list[int] = []
    for _ in range(g.shape[1]):
        information = np.asarray(np.round(np.diag(inner), 12), dtype=np.float64)
        information[chosen] = 0.0
        fall = rest**2 * (information > 0) / (1 + information)
        explains = fall.max(initial=0.0) > DEFAULT_SEARCH.noise
        best = int(falling(fall if explains else information)[0])
        if len(out) >= most or information[best] <= 0:
            break
        out.append(best)
        if explains:
            # up to two that may be meant in its place: 0.7 of the fall
            order = falling(fall)
            near = order[(fall[order] > 0.7 * fall[best]) & ~np.isin(order, out)]
            out += near[:2].tolist()
        chosen.append(best)
        mine = inner[:, best] / (1 + information[best])
        rest = rest - mine * rest[best]
        inner = inner - np.outer(mine, inner[best])
    return np.array(list(dict.fromkeys(out))[:most], dtype=np.int64)


def counted_once(model: Model) -> Kept:
    """How many matrices parameters keep of an element together (`matrices_kept`), up to
    `SIZES.matrices`, remembered.
    """
    return cache(partial(matrices_kept, model, most=SIZES.matrices))


def tractable(
    model: Model, candidates: Sequence[Candidate], most: int, kept: Kept | None = None
) -> Int:
    """The first whose matrices can be written as sums, in order, also where several act on the same
    elements.

    How many these keep together is at most the product of those of each; what it is is counted in
    small decks only.

    Parameters
    ----------
    kept : callable, optional
        `counted_once`, where they are asked for again.
    """
    count = kept or counted_once(model)
    members = membership(model, candidates)
    out = list[int]()
    # matrices of each element that those before may ask for
    held = np.zeros(members.shape[1], dtype=np.int64)
    for i, c in enumerate(candidates):
        mine = members[[i]].indices
        own = count(c.parameter)
        if own is None:
            continue
        # at most the product of those of each, the nominal one counted
        both = (1 + own) * (1 + held[mine])
        if own and both.max(initial=0) > SIZES.matrices:
            if members.shape[1] > SIZES.elements:
                continue
            pool = [
                candidates[k].parameter
                for k in out
                if np.isin(members[[k]].indices, mine).any()
            ]
            found = count(*pool, c.parameter)
            if found is None:
                continue
            both = np.minimum(both, 1 + found)
        held[mine] = both - 1
        out.append(i)
        if len(out) == most:
            break
    return np.array(out, dtype=np.int64)


def of_parameter(model: Model, parameter: Parameter) -> Candidate:
    """A parameter that was given as a candidate: its elements and, in words, what it changes."""
    rows = union(
        within(model, rows_of(model, t), t.elements) for t in parameter.targets
    )
    ids = [i for card, at in rows.items() for i in model[card].ids[at].tolist()]
    ids += [i for s in parameter.substructures for i in s.elements]
    elements = tuple(sorted(set(ids)))
    fields: dict[str, list[str]] = {}
    for t in parameter.targets:
        fields.setdefault(f"{t.card} {t.id}", []).append(t.field)
    named = ", ".join(f"{card} {','.join(f)}" for card, f in fields.items())
    what = f"{named} of {counted(rows)}" if rows else named
    if not what:
        what = f"matrices of {len(elements)} elements"
    kind = (
        KIND.get(parameter.targets[0].card, "property")
        if parameter.targets
        else "region"
    )
    return Candidate(parameter, kind, what, elements)


def conflicts(model: Model, candidates: Sequence[Candidate]) -> Bool:
    """Pairs (p, p) that scale the same field of an element, or one of them its stiffness as a
    whole.
    """
    members = membership(model, candidates)
    overlap = (members @ members.T).toarray() > 0
    fields = [{t.field for t in c.parameter.targets} for c in candidates]
    family = [
        {t.card.startswith("MAT") for t in c.parameter.targets} for c in candidates
    ]
    stiff = [any(f not in MASS_ONLY for f in fs) or not fs for fs in fields]
    out = np.zeros(overlap.shape, dtype=np.bool_)
    # over candidates, not elements
    for i, j in np.argwhere(np.triu(overlap, 1)).tolist():
        same = bool(fields[i] & fields[j]) and family[i] == family[j]
        whole = stiff[i] and stiff[j] and not (fields[i] and fields[j])
        out[i, j] = out[j, i] = same or whole
    return out


def drawn(p: ParameterSet, separate: Bool, rng: np.random.Generator) -> list[Float]:
    """Where a search will look: nominal, each candidate by itself, draws of the prior without two
    that stay separate.
    """
    (low, high), std = p.bounds(), p.std()
    points = [np.zeros(len(p)), *np.diag(std), *np.diag(-std)]
    for x in std * rng.standard_normal((SIZES.draws, len(p))):
        taken = np.zeros(len(p), dtype=np.bool_)
        for i in rng.permutation(len(p)):  # over candidates
            taken[i] = not (separate[i] & taken).any()
        points.append(np.where(taken, x, 0.0))
    return [np.clip(x, low, high) for x in points]
