"""From many candidates to a few parameters: a ranked proposal, with the reason for each and its
rivals.

The sets come from `subsets`. Every member of the chosen one is put to the test: J without it, and
with any other candidate in its place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.core.progress import Progress, part
from ringtrue.errors import InputError
from ringtrue.updating.gauss_newton import Residual
from ringtrue.updating.identifiability import ALIKE, cosines
from ringtrue.updating.problem import Problem
from ringtrue.updating.selection.localisation import Variation, variation
from ringtrue.updating.selection.selection_rules import (
    Candidates,
    Choice,
    largest,
    lasso_path,
    orthogonal,
)
from ringtrue.updating.selection.subset_search import (
    SENSITIVE,
    Search,
    Subsets,
    aicc,
    criteria,
    foreseen,
    subsets,
)
from ringtrue.updating.target import Target

WORTH_A_LOOK, LOOKS = (
    1.3,
    6,
)  # predicted J of a rival, in units of the proposal's; most that are fitted
LITTLE = 0.02  # share of the errors below which a parameter explains nothing by itself
GATHERED = 1.1  # times its share of strain energy, from which on errors gather at a candidate
KINDS = {
    "force": "force residual",
    "constitutive": "constitutive error",
    "energy": "strain energy change",
}
SHOWN = 10  # candidates of another rule
# difference of AICc below which a model is as good (Burnham and Anderson 2002, section 2.6)
RIVAL = 2.0
LEAST = 0.01  # of the mass of the structure that is worth telling as lacking at one place
FITTED, MOST = 4, 6  # sets that are fitted at a point, and their largest size
# difference of AICc beyond which a model has none (Burnham and Anderson 2002, section 2.6)
SUPPORT = 10.0


@dataclass(frozen=True, slots=True)
class Proposed:
    """One parameter of the proposal.

    Attributes
    ----------
    name : str
    index : int
        Position among the candidates.
    factor : float
        Where the short updating took it.
    std : float
        Standard deviation of x about where the short updating took it, all candidates that may
        stand beside free.
    worth : float
        Rise of AICc if it is left out and the others are fitted again.
    alike : tuple of str
        Candidates of its cluster: |cosine| of the weighted sensitivities with all of them above the
        limit.
    rivals : tuple of str
        Others that do as well in its place (AICc within 2 of the proposal's).
    because : str
    """

    name: str
    index: int
    factor: float
    std: float
    worth: float
    alike: tuple[str, ...]
    rivals: tuple[str, ...]
    because: str
    lump: float = 0.0

    @property
    def added(self) -> float:
        """The mass that it adds, in units of the deck; 0 of a factor."""
        return self.lump * (self.factor - 1)

    def said(self) -> str:
        """Name and factor, or what is added."""
        if self.lump:
            return f"{self.name}: {self.added:.3g} ± {self.lump * self.std:.2g}"
        return f"{self.name} x {self.factor:.3g} (± {100 * self.std:.1f} %)"

    @property
    def named(self) -> tuple[str, ...]:
        """It and all that cannot be told from it."""
        return (self.name, *self.alike, *self.rivals)


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """What to update, in the order of worth.

    Attributes
    ----------
    members : tuple of Proposed
    sizes : (k,) int64
        Numbers of parameters that were tried.
    criteria : (k,) float64
        AICc of the best set of each size, plus twice the logarithm of the number of sets of that
        size.
    insensitive : tuple of str
        Candidates that the residuals do not depend on.
    clusters : (p,) int64
        Of all candidates.
    x : (p,) float64
        At the end of the short updating.
    before, after : float
        Mean |Δf|/f of the used pairs inside the gates.
    mac : (2,) float64
        Mean MAC of these before and after; NaN where no shapes were measured.
    paired : (2,) int64
        How many they are before and after.
    discrepancy : (2,) float64
        Relative frequency and 1 − MAC that the best set leaves: the weights of the search.
    orders : mapping of str to tuple of str
        The first candidates by other rules, to compare: LASSO, orthogonal and largest
        sensitivities, single gain.
    """

    members: tuple[Proposed, ...]
    sizes: Int
    criteria: Float
    insensitive: tuple[str, ...]
    clusters: Int
    x: Float
    before: float
    after: float
    mac: Float
    paired: Int
    discrepancy: Float
    orders: Mapping[str, tuple[str, ...]]

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(
            self,
            sizes=np.int64,
            criteria=f,
            clusters=np.int64,
            x=f,
            mac=f,
            paired=np.int64,
            discrepancy=f,
        )

    def text(self) -> str:
        """The proposal in words, a line each."""
        if not self.members:
            return f"no parameter: {self.unexplained()}"
        names = ", ".join(m.name for m in self.members)
        head = f"{_number(len(self.members))}: {names}"
        lines = [
            head,
            *(f"{i}. {m.said()}: {m.because}" for i, m in enumerate(self.members, start=1)),
        ]
        told = [m.name for m in self.members]
        lost = [n for m in self.members for n in (*m.alike, *m.rivals) if n not in told]
        lost = list(dict.fromkeys(lost))
        if lost:
            lines.append(f"{_number(len(lost))} cannot be told from these: {', '.join(lost)}")
        if self.insensitive:
            lines.append(f"{_number(len(self.insensitive))} change nothing that was measured")
        mac = (
            f"mean MAC {100 * self.mac[0]:.1f} -> {100 * self.mac[1]:.1f} %, " if self.seen else ""
        )
        lines.append(
            f"mean |Δf| {100 * self.before:.2f} -> {100 * self.after:.2f} %, {mac}"
            f"pairs {self.paired[0]} -> {self.paired[1]}"
        )
        return "\n".join(lines)

    @property
    def seen(self) -> bool:
        """Whether shapes were measured."""
        return bool(np.isfinite(self.mac[0]))

    def unexplained(self) -> str:
        """Why nothing is proposed, in words."""
        stays = f"mean |Δf| {100 * self.before:.2f} %" + (
            f", mean MAC {100 * self.mac[0]:.1f} %" if self.seen else ""
        )
        if self.before <= self.discrepancy[0]:
            return f"the model as it is ({stays}) explains the test as well as any change of it"
        return (
            f"no change of a candidate explains what is left ({stays}): look for a part, "
            "joint or mesh that is another"
        )


def _number(n: int) -> str:
    return f"{n} candidate" if n == 1 else f"{n} candidates"


def propose(
    model: Candidates,
    target: Target,
    *,
    most: int = 8,
    alike: float = ALIKE,
    apart: Bool | None = None,
    errors: Mapping[str, Float] | None = None,
    words: Sequence[str] = (),
    problem: Problem | None = None,
    passed_over: int = 0,
    progress: Progress | None = None,
) -> Proposal:
    """A ranked, explained set of parameters.

    Parameters
    ----------
    model : Candidates
        An `ObservedModel` over all candidates that can be held to some of them (`ReducedModel`,
        `DenseModel`).
    most : int
        Most parameters that are proposed.
    alike : float
        |cosine| from which on the data cannot tell two candidates apart.
    apart : (p, p) bool, optional
        Pairs that must not be proposed together: factors on the same field (`screening.conflicts`).
    errors : mapping of str to (p,) float64, optional
        Concentration of local errors on each candidate (`ElementErrors.concentration`), told among
        the reasons.
    words : sequence (p,) of str, optional
        What each candidate is.
    problem : Problem, optional
        Other tests and what was measured beside modes, too: all of them, the first being `model`
        and `target`.
    passed_over : int
        Candidates that were left out since they explain less of the same test: the choice was among
        these, too.

    Raises
    ------
    InputError
        If `most` is less than 1, or no mode is paired at the start.
    """
    told = progress or (lambda _f, _t: None)
    if most < 1:
        raise InputError(f"propose at most {most} parameters: allowed are 1 and more")

    def search(barred: Sequence[int], known: Sequence[Choice], told: Progress) -> Subsets:
        return subsets(model, target, most, alike, apart, told, problem, passed_over, barred, known)

    barred = [i for i, p in enumerate(model.parameters.parameters) if p.lump]
    found = search(barred, (), part(told, 0.0, 0.35 if barred else 0.7))
    if barred:
        found, barred = with_lumps(search, found, barred, part(told, 0.35, 0.7))
    told(0.7, "testing each parameter")
    return _explained(found, barred, errors or {}, words)


def _explained(
    found: Subsets, faint: Sequence[int], errors: Mapping[str, Float], words: Sequence[str]
) -> Proposal:
    search, zero, best = found.search, found.start, found.path[-1]
    p = search.model.parameters
    end = search.point(best.x)
    alone = variation(search.target, zero, search.prior, search.low, search.high)
    stds = dict(zip(best.members.tolist(), stated_errors(search, best, end).tolist(), strict=True))
    image = mirrored(search, best, zero)
    tested = [
        _tested(search, best, end, i, std, alone, errors, words, image.get(i))
        for i, std in stds.items()
    ]
    quiet = np.setdiff1d(np.arange(len(p)), [*search.pool.tolist(), *faint])
    return Proposal(
        tuple(sorted(tested, key=lambda m: -m.worth)),
        np.array([c.members.size for c in found.path[:-1]]),
        found.criteria[:-1],
        tuple(p.names[i] for i in quiet.tolist()),
        search.groups,
        best.x,
        _mean(np.abs(zero.frequency_error[zero.used])),
        _mean(np.abs(found.end.frequency_error[found.end.used])),
        np.array(
            [np.nan if search.target.lent else _mean(r.mac[r.used]) for r in (zero, found.end)]
        ),
        np.array([r.used.sum() for r in (zero, found.end)]),
        np.array([found.found.frequency, found.found.mac]),
        _orders(search, zero, alone),
    )


def _mean(x: Float) -> float:
    """NaN where no mode has a partner."""
    return float(x.mean()) if x.size else float("nan")


def _tested(
    search: Search,
    best: Choice,
    end: Residual,
    index: int,
    std: float,
    alone: Variation,
    errors: Mapping[str, Float],
    words: Sequence[str],
    image: int | None = None,
) -> Proposed:
    """Leave one member out, then put others in its place; it cannot be told from its mirror
    image.
    """
    names = search.model.parameters.names
    stay = [m for m in best.members.tolist() if m != index]
    without = (
        search.fit(stay, np.where(np.arange(best.x.size) == index, 0.0, best.x)) if stay else None
    )
    x = without.x if without is not None else np.zeros(best.x.size)
    r = search.point(x)
    twins = np.flatnonzero(search.groups == search.groups[index])
    free = np.setdiff1d(search.free(stay), twins)
    # what acts like another member is barred from the search, but may be what is wrong in place of
    # this one
    barred = search.pool[~search.apart[np.ix_(search.pool, stay)].any(axis=1)]
    barred = np.setdiff1d(barred, np.concatenate([free, twins, best.members]))
    # where modes are lost without it, the linearisation with it knows more
    lost = r.used.sum() < end.used.sum()
    at, from_x = (end, best.x) if lost else (r, x)
    base = end.value + end.slope[:, index] * best.x[index] if lost else r.value
    ahead = [search.best(at, from_x, stay, some, base) for some in (free, barred)]
    options = [
        o for part in ahead for o in [o for j, o in part if j < WORTH_A_LOOK * best.value][:LOOKS]
    ]
    start = np.where(np.arange(x.size) == index, 0.0, from_x)
    tried = [
        search.fit(o, _foreseen(search, at, start, o, base) if lost else start) for o in options
    ]
    sets = [best, Choice(np.array(stay, dtype=np.int64), x, 0.0), *tried]
    rise = (c := aicc(search, sets)) - c[0]
    rivals = tuple(
        names[t.members[-1]] for t, d in zip(tried, rise[2:].tolist(), strict=True) if d < RIVAL
    )
    twins = np.setdiff1d(twins if image is None else [*twins.tolist(), image], best.members)
    factor = float(search.model.parameters.take([index]).factors(best.x[[index]])[0])
    p = Proposed(
        names[index],
        index,
        factor,
        std,
        float(rise[1]),
        tuple(names[i] for i in twins.tolist()),
        rivals,
        "",
        search.model.parameters.parameters[index].lump,
    )
    return replace(p, because=_because(p, search, end, r, alone, errors, words))


def _foreseen(search: Search, r: Residual, x: Float, members: Sequence[int], base: Float) -> Float:
    """x (p,) with the members at the minimum of the linearised J; at 0 a new one may leave modes
    without a partner.
    """
    i = list(members)
    g = r.slope[:, i]
    out = x.copy()
    out[i] = np.linalg.solve(g.T @ g + np.diag(search.prior[i] ** -2), g.T @ (base + g @ x[i]))
    return np.clip(out, search.low, search.high)


def _because(
    p: Proposed,
    search: Search,
    end: Residual,
    without: Residual,
    alone: Variation,
    errors: Mapping[str, Float],
    words: Sequence[str],
) -> str:
    """The reason for a parameter, in one line."""
    i = p.index
    parts = [words[i]] if words else []
    low, high = search.model.parameters.bounds()
    x = float(search.model.parameters.take([i]).vector(np.array([p.factor]))[0])
    if min(x - low[i], high[i] - x) < 1e-9:
        parts.append("at its bound")
    parts.append(
        f"without it AICc rises by {p.worth:.1f} and {_loss(end, without, search.target.lent)}"
    )
    shares = ((alone.frequency[i], "the squared frequency errors"), (alone.mac[i], "1 − MAC"))
    explained = [f"{100 * share:.0f} % of {what}" for share, what in shares if share > LITTLE]
    parts.append(
        f"by itself it explains {' and '.join(explained) or 'little: it helps beside the others'}"
    )
    strong = [
        f"{KINDS.get(name, name)} {value[i]:.1f}"
        for name, value in errors.items()
        if value[i] > GATHERED
    ]
    if strong:
        parts.append(
            f"local errors gather there, for its share of strain energy ({', '.join(strong)} "
            "times average)"
        )
    if p.alike:
        parts.append(f"the data cannot tell it from {_some(p.alike)}")
    if p.rivals:
        parts.append(f"as good in its place: {_some(p.rivals)}")
    return "; ".join(parts)


def _loss(end: Residual, without: Residual, lent: bool) -> str:
    """What a fit loses without a member; shapes that are `lent` tell nothing."""
    lost = int(end.used.sum()) - int(without.used.sum())
    if lost > 0:
        return f"{lost} of {int(end.used.sum())} modes are too far off to count as paired"
    both = (end, without)
    told = {
        "mean |Δf|": [f"{100 * _mean(np.abs(r.frequency_error[r.used])):.2f}" for r in both],
        "mean 1 − MAC": [f"{100 * _mean(1 - r.mac[r.used]):.2f}" for r in both],
    }
    if lent:
        told.pop("mean 1 − MAC")
    changed = (f"{name} is {b} instead of {a} %" for name, (a, b) in told.items() if a != b)
    return next(
        changed, f"{'Δf does not change' if lent else 'neither Δf nor MAC changes'} by 0.01 %"
    )


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:6])
    return shown if len(names) <= 6 else f"{shown} and {len(names) - 6} more"


def _orders(search: Search, zero: Residual, alone: Variation) -> dict[str, tuple[str, ...]]:
    """The first candidates by simpler rules, one a cluster."""
    g = zero.slope * search.prior
    path = lasso_path(g, zero.value, search.low / search.prior, search.high / search.prior)
    orders = {
        "LASSO": path.order(),
        "orthogonal sensitivities": orthogonal(g, min(g.shape)),
        "largest sensitivities": largest(g, g.shape[1]),
        "single gain": np.argsort(-alone.gain, kind="stable"),
    }
    names = search.model.parameters.names
    out = {}
    for rule, order in orders.items():
        _, first = np.unique(search.groups[order], return_index=True)
        out[rule] = tuple(names[i] for i in order[np.sort(first)][:SHOWN].tolist())
    return out


def stated_errors(search: Search, best: Choice, end: Residual) -> Float:
    """Standard deviation (k,) of x of each member: what all other candidates may be off by widens
    it.

    Those that scale a field of a member are held: it stands for them. Masses that the deck may lack
    elsewhere are, too: that something was left out is rare. Of A⁻¹ + ddᵀ, d the step to the common
    minimum: `uncertainty.around`.
    """
    members = best.members.tolist()
    beside = ~search.apart[members].any(axis=0) & ~np.isin(
        np.arange(best.x.size), [*search.lumps, *members]
    )
    every = [*members, *np.flatnonzero(beside).tolist()]
    g, x = end.slope[:, every] * search.prior[every], best.x[every] / search.prior[every]
    inverse = np.linalg.inv(g.T @ g + np.eye(len(every)))
    square = np.diag(inverse) + (inverse @ (g.T @ end.value - x)) ** 2
    return np.asarray((np.sqrt(square) * search.prior[every])[: len(members)])


def mirrored(search: Search, best: Choice, zero: Residual) -> dict[int, int]:
    """Of each member what is most alike to it at the deck, where all of these together do as well.

    Of a symmetric structure the frequencies do not tell an error from its mirror image. One of two
    members in the place of its image is not as good.
    """
    members = best.members.tolist()
    like = cosines(zero.slope * search.prior)[members]
    like[:, np.setdiff1d(np.arange(best.x.size), np.setdiff1d(search.pool, members))] = 0.0
    image = np.where(like.max(axis=1, initial=0.0) > search.alike, like.argmax(axis=1), members)
    if (
        (image == members).all()
        or np.unique(image).size < image.size
        or search.apart[np.ix_(image, image)].any()
    ):
        return {}
    x = np.zeros(best.x.size)
    x[image] = best.x[members]
    rise = aicc(search, [best, search.fit(image.tolist(), x)])
    return dict(zip(members, image.tolist(), strict=True)) if rise[1] - rise[0] < RIVAL else {}


def with_lumps(
    search: Callable[[Sequence[int], Sequence[Choice], Progress], Subsets],
    own: Subsets,
    lumps: list[int],
    told: Progress,
) -> tuple[Subsets, list[int]]:
    """The sets with lumps where the one without has no support beside them, else `own`; and which
    were barred.

    Parameters
    ----------
    search : callable (barred, known, told) -> Subsets
        Without those barred, and with sets that are known among those that compete.
    own : Subsets
        With all lumps barred.
    lumps : list of int
        Positions of these among the candidates.
    """
    known, barred = _better(own, lumps), list[int]()
    likely = [i for c in known for i in c.members.tolist() if i in lumps]
    while likely:
        found = search(
            barred,
            [own.path[-1], *(c for c in known if not np.isin(c.members, barred).any())],
            told,
        )
        solid, faint = _by_size(found.search, found.path[-1])
        if not faint:
            sets = [found.search.refitted(own.path[-1]), found.path[-1]]
            without, with_them = criteria(found.search, sets).tolist()
            return (found, barred) if without - with_them > SUPPORT else (own, lumps)
        likely = [i for i in {*likely, *solid} if i not in faint]
        barred = [i for i in lumps if i not in likely]
    return own, lumps


def _better(own: Subsets, lumps: list[int]) -> list[Choice]:
    """Sets with lumps that are better than the best without: grown by the linearised J at points of
    the path.
    """
    search, best, tried = own.search, own.path[-1], list[Choice]()
    able = np.array([i for i in lumps if search.size[i] >= SENSITIVE], dtype=np.int64)
    for c in {c.x.tobytes(): c for c in (own.path[0], *own.path[-2:])}.values():
        r = search.point(c.x)
        if not r.used.any():
            continue
        grown = [
            o for i in able.tolist() for o in _grown(search, c, [i], np.append(search.pool, able))
        ]
        for _, at in sorted(grown)[:FITTED]:
            tried.append(search.fit(at, np.where(np.isin(np.arange(c.x.size), at), c.x, 0.0)))
    tried = [c for c in tried if not _by_size(search, c)[1]]
    tried = [
        *{tuple(sorted(c.members)): c for c in sorted(tried, key=lambda c: -c.value)}.values()
    ]  # one a set
    least, *every = criteria(search, [best, *tried]).tolist()
    return [c for c, value in zip(tried, every, strict=True) if value < least]


def _grown(
    search: Search, at: Choice, members: list[int], free: Int
) -> list[tuple[float, list[int]]]:
    """Sets by the linearised J at a point, one member more each time: the criterion foreseen, and
    members.
    """
    r, nominal, out = search.point(at.x), np.zeros(at.x.size), list[tuple[float, list[int]]]()
    base = r.value + r.slope @ at.x
    value = search.ahead(r, nominal, members, base)
    while True:
        out.append((foreseen(search, r, members, value), members))
        if len(members) >= MOST:
            return out
        barred = np.isin(search.groups[free], search.groups[members]) | search.apart[free][
            :, members
        ].any(axis=1)
        more = free[~barred]
        if not more.size:
            return out
        value, members = search.best(r, nominal, members, more, base)[0]


def _by_size(search: Search, c: Choice) -> tuple[list[int], list[int]]:
    """Lumps of a set of at least `LEAST`, and those below: what is so small takes the part of some
    other error.
    """
    added = search.model.parameters.factors(c.x) - 1
    every = [i for i in c.members.tolist() if i in search.lumps]
    return [i for i in every if abs(added[i]) >= LEAST], [i for i in every if abs(added[i]) < LEAST]
