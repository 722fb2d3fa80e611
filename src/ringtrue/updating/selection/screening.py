"""Which of many candidates are looked at closely: seen from the deck, then from where a first
choice of them leads.

The slopes at a deck that is far off tell little of some candidates. So the set that is chosen among
those that explain most from there only leads nearer, and all are weighed again with the modes found
there (iterated screening: Fan and Lv 2008, sec. 4.1). Of many modes the lowest lead: those of a
dense band find partners only once these are right.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import zip_longest
from typing import Any, Protocol

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.core.progress import Progress
from ringtrue.fem.assembly import System
from ringtrue.fem.mesh import union
from ringtrue.fem.parametrisation.affine import matrices_kept
from ringtrue.fem.parametrisation.changed_model import rows_of, within
from ringtrue.model.model import Model
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.updating.problem import Problem
from ringtrue.updating.selection.candidates import Candidate, Kind, counted, membership
from ringtrue.updating.selection.effects import misfits
from ringtrue.updating.selection.selection_rules import NOISE, Candidates, falling
from ringtrue.updating.selection.subset_search import subsets
from ringtrue.updating.target import Target

LEADING = 60  # modes at most by which the first choice is made
Look = Callable[[tuple[Candidate, ...]], tuple[Candidates, ReducedModel]]
Kept = Callable[..., int | None]
KIND: dict[str, Kind] = {
    **dict.fromkeys(("MAT1", "MAT2", "MAT8", "MAT9"), "material"),
    **dict.fromkeys(("PBUSH", "PBUSH1D", "PFAST", "PGAP", "PELAS", "CELAS2", "CELAS4"), "spring"),
    **dict.fromkeys(("CONM2", "PMASS", "CMASS2", "CMASS4"), "mass"),
}
MASS_ONLY = {"RHO", "NSM", "NSMB", "M", "I11", "I21", "I22", "I31", "I32", "I33"}
SMALL = 160  # vectors of the model that a proposal searches with
DRAWS = 20  # points of the prior whose modes it holds, beside those of each candidate by itself
MATE, MATES = (
    0.7,
    2,
)  # share of the best fall of J from which on a candidate may be meant in place of the best
TOGETHER = (
    100  # matrices that those acting on one element may keep of all theirs: they take the memory
)
# elements of a deck of which 100 matrices each are little: up to there it is counted what is kept
FEW = 1000


class Beside(Protocol):
    """What was measured beside the modes, over all candidates."""

    def misfit(
        self, at: ReducedModel | None, x: Float, which: Sequence[int], aim: Target
    ) -> tuple[Float, Float]:
        """As those of `misfits`, at x (k,) of a model over the candidates `which`; of the deck
        without a model.
        """

    def problem(self, search: Any, aim: Target) -> Problem:
        """Modes and data of a model that is searched with."""


def screened(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    aim: Target,
    observe: sparse.csr_array,
    modes: tuple[Float, Float],
    look: Look,
    *,
    pool: int,
    most: int,
    alike: float,
    progress: Progress,
    beside: Beside | None = None,
) -> tuple[Candidate, ...]:
    """Up to `pool` of the candidates, in their order.

    Parameters
    ----------
    candidates : sequence of Candidate
        All that change a mode.
    aim : Target
    observe : (channel, f) csr float64
        Readings of the channels of the test by the free degrees of freedom.
    modes : (m,), (f, m) float64
        λ, (rad/s)², and shapes of unit modal mass of the deck.
    look : callable (candidates) -> (model to search with, model whose modes are in the free degrees
    of freedom)
        The first needs modes for the `LEADING` lowest of the test only.
    pool, most : int
        Candidates that are kept, and parameters of the first choice.
    alike : float
        |cosine| from which on two candidates are one to the data.
    beside : Beside, optional
        What else was measured: it counts with the modes, and a candidate that it alone sees is
        seen.
    """

    def seen(
        modes: tuple[Float, Float], at: ReducedModel | None, x: Float, which: Sequence[int]
    ) -> tuple[tuple[Float, Float], ...]:
        found = misfits(model, system, candidates, *modes, observe @ modes[1], aim)
        if beside is None:
            return found
        more, slopes = beside.misfit(at, x, which, aim)
        return tuple((np.append(r, more), np.concatenate([g, slopes])) for r, g in found)

    kept = counted_once(model)
    at = close(model, candidates, seen(modes, None, np.zeros(0), ()), pool, kept=kept)
    some = tuple(candidates[i] for i in at.tolist())
    if len(some) == len(candidates):
        return some
    search, whole = look(some)
    low = aim.lowest(LEADING)
    problem = None if beside is None else beside.problem(search, low)
    far = passed_over(candidates, some)
    found = subsets(search, low, most, alike, conflicts(model, some), progress, problem, far)
    best, groups = found.path[-1], found.search.groups
    if not best.members.size:
        return some
    x = np.zeros(len(candidates))
    x[at] = best.x / whole.parameters.std()
    stay = at[np.isin(groups, groups[best.members])]
    near = [(r + g @ x, g) for r, g in seen(whole.vectors(best.x), whole, best.x, at.tolist())]
    return tuple(
        candidates[i] for i in close(model, candidates, near, pool, stay=stay.tolist(), kept=kept)
    )


def close(
    model: Model,
    candidates: Sequence[Candidate],
    misfits: Sequence[tuple[Float, Float]],
    most: int,
    *,
    stay: Sequence[int] = (),
    kept: Kept | None = None,
) -> Int:
    """The candidates that are looked at closely, ascending: of those that can be taken apart the
    first that explain.

    Half as many lumps come beside them: those that explain most among all, and they crowd none of
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
    lump = np.array([c.kind == "lump" for c in candidates], dtype=np.bool_)
    own = np.flatnonzero(~lump)
    first = [i for i in _in_turn(misfits, own, 2 * most, stay) if not lump[i]][: 2 * most]
    near = np.array(first, dtype=np.int64)[
        tractable(model, [candidates[i] for i in first], most, kept)
    ]
    added = (
        [i for i in _in_turn(misfits, np.arange(lump.size), 2 * most, stay) if lump[i]]
        if lump.any()
        else []
    )
    return np.sort(np.append(near, np.array(added[: most // 2], dtype=np.int64)))


def _in_turn(
    misfits: Sequence[tuple[Float, Float]], some: Int, most: int, stay: Sequence[int]
) -> list[int]:
    """Those that stay, then of some candidates the first that explain each misfit in turn."""
    orders = [
        some[explaining(misfit, slopes[:, some], most)].tolist() for misfit, slopes in misfits
    ]
    return list(
        dict.fromkeys([*stay, *(i for turn in zip_longest(*orders) for i in turn if i is not None)])
    )


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
    which the data tell most beside those chosen, gᵀC⁻¹g: greedy on ln det(I + GᵀG). Those without
    effect are left out.

    Parameters
    ----------
    misfit : (n,) float64
        Weighted.
    slopes : (n, p) float64
        Weighted, in units of the prior.
    """
    g, r = np.asarray(slopes, dtype=np.float64), np.asarray(misfit, dtype=np.float64)
    chosen, out, both, rest = list[int](), list[int](), g.T @ g, g.T @ r  # gᵀC⁻¹g and gᵀC⁻¹r
    for _ in range(g.shape[1]):
        told = np.asarray(np.round(np.diag(both), 12), dtype=np.float64)
        told[chosen] = 0.0
        fall = rest**2 * (told > 0) / (1 + told)
        some = fall.max(initial=0.0) > NOISE
        best = int(falling(fall if some else told)[0])
        if len(out) >= most or told[best] <= 0:
            break
        order = falling(fall)
        mates = (
            order[(fall[order] > MATE * fall[best]) & ~np.isin(order, [*out, best])][:MATES]
            if some
            else order[:0]
        )
        out += [i for i in (best, *mates.tolist()) if i not in out]
        chosen.append(best)
        mine = both[:, best] / (1 + told[best])
        rest = rest - mine * rest[best]
        both = both - np.outer(mine, both[best])
    return np.array(out[:most], dtype=np.int64)


def counted_once(model: Model) -> Kept:
    """How many matrices parameters keep of an element together (`matrices_kept`), up to `TOGETHER`,
    remembered.
    """
    return cache(partial(matrices_kept, model, most=TOGETHER))


def tractable(
    model: Model, candidates: Sequence[Candidate], most: int, kept: Kept | None = None
) -> Int:
    """The first whose matrices can be taken apart, in order, also where several act on the same
    elements.

    How many these keep together is at most the product of those of each; what it is is counted in
    small decks only.

    Parameters
    ----------
    kept : callable, optional
        `counted_once`, where they are asked for again.
    """
    count = kept or counted_once(model)
    members, out = membership(model, candidates), list[int]()
    held = np.zeros(
        members.shape[1], dtype=np.int64
    )  # matrices of each element that those before may ask for
    for i, c in enumerate(candidates):
        mine, own = members[[i]].indices, count(c.parameter)
        if own is None:
            continue
        both = (1 + own) * (
            1 + held[mine]
        )  # at most the product of those of each, the nominal one counted
        if own and both.max(initial=0) > TOGETHER:
            if members.shape[1] > FEW:
                continue
            beside = [
                candidates[k].parameter for k in out if np.isin(members[[k]].indices, mine).any()
            ]
            found = count(*beside, c.parameter)
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
    rows = union(within(model, rows_of(model, t), t.elements) for t in parameter.targets)
    ids = [i for card, at in rows.items() for i in model[card].ids[at].tolist()]
    ids += [i for s in parameter.substructures for i in s.elements]
    elements = tuple(sorted(set(ids)))
    fields: dict[str, list[str]] = {}
    for t in parameter.targets:
        fields.setdefault(f"{t.card} {t.id}", []).append(t.field)
    named = ", ".join(f"{card} {','.join(f)}" for card, f in fields.items())
    what = f"{named} of {counted(rows)}" if rows else f"matrices of {len(elements)} elements"
    kind = KIND.get(parameter.targets[0].card, "property") if parameter.targets else "region"
    return Candidate(parameter, kind, what, elements)


def conflicts(model: Model, candidates: Sequence[Candidate]) -> Bool:
    """Pairs (p, p) that scale the same field of an element, or one of them its stiffness as a
    whole.
    """
    members = membership(model, candidates)
    overlap = (members @ members.T).toarray() > 0
    fields = [{t.field for t in c.parameter.targets} for c in candidates]
    family = [{t.card.startswith("MAT") for t in c.parameter.targets} for c in candidates]
    stiff = [any(f not in MASS_ONLY for f in fs) or not fs for fs in fields]
    out = np.zeros(overlap.shape, dtype=np.bool_)
    for i, j in np.argwhere(np.triu(overlap, 1)).tolist():  # over candidates, not elements
        same = bool(fields[i] & fields[j]) and family[i] == family[j]
        whole = stiff[i] and stiff[j] and not (fields[i] and fields[j])
        out[i, j] = out[j, i] = same or whole
    return out


def drawn(p: ParameterSet, apart: Bool, rng: np.random.Generator) -> list[Float]:
    """Where a search will look: nominal, each candidate by itself, draws of the prior without two
    that stay apart.
    """
    (low, high), std = p.bounds(), p.std()
    points = [np.zeros(len(p)), *np.diag(std), *np.diag(-std)]
    for x in std * rng.standard_normal((DRAWS, len(p))):
        taken = np.zeros(len(p), dtype=np.bool_)
        for i in rng.permutation(len(p)).tolist():  # over candidates
            taken[i] = not (apart[i] & taken).any()
        points.append(np.where(taken, x, 0.0))
    return [np.clip(x, low, high) for x in points]
