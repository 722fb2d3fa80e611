"""From many candidates to a few parameters: a ranked proposal, with the reason for each and its
rivals.

The sets come from `subset_search`. Every member of the chosen one is tested: J without it, and with
any other candidate in its place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.core.display import number, with_error
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.errors import InputError
from ringtrue.updating.identifiability import cosines
from ringtrue.updating.problem import Problem, Residual
from ringtrue.updating.selection.localisation import Variation, variation
from ringtrue.updating.selection.selection_rules import FittedSet, largest, orthogonal
from ringtrue.updating.selection.subset_search import (
    DEFAULT_SEARCH,
    Here,
    Ranked,
    Search,
    SearchSettings,
    Subsets,
    aicc,
    criteria,
    foreseen,
    subsets,
)
from ringtrue.updating.target import Weights

INDICATORS = {
    "force": "force residual",
    "constitutive": "constitutive error",
    "energy": "strain energy change",
}


@dataclass(frozen=True, slots=True)
class ProposalRules:
    """What makes a candidate a rival, a reason or an added mass.

    Attributes
    ----------
    rival : float
        Difference of AICc below which a set is as good (Burnham and Anderson 2002, sec. 2.6).
    support : float
        Difference of AICc beyond which a set has no support (ibid.).
    promising : float
        Predicted J of a rival, in units of the proposal's, up to which it is fitted.
    tried : int
        Rivals of one member that are fitted at most.
    explains : float
        Share of the errors from which a parameter explains some of them by itself.
    gathered : float
        Local error over share of strain energy, from which on errors gather at a candidate.
    least_mass : float
        Share of the mass of the structure that is worth adding at one place.
    """

    rival: float = 2.0
    support: float = 10.0
    promising: float = 1.3
    tried: int = 6
    explains: float = 0.02
    gathered: float = 1.1
    least_mass: float = 0.01


PROPOSAL = ProposalRules()


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
        are free as well.
    worth : float
        Rise of AICc if it is left out and the others are fitted again.
    collinear : tuple of str
        Candidates of its cluster: |cosine| of the weighted sensitivities with all of them above the
        limit.
    rivals : tuple of str
        Others that do as well in its place (AICc within 2 of the proposal's).
    because : str
    lump : float
        Mass that a factor of 2 adds, in units of the deck; 0 of a factor on a field.
    """

    name: str
    index: int
    factor: float
    std: float
    worth: float
    collinear: tuple[str, ...]
    rivals: tuple[str, ...]
    because: str
    lump: float = 0.0

    @property
    def added(self) -> float:
        """The mass that it adds, in units of the deck; 0 of a factor."""
        return self.lump * (self.factor - 1)

    def digits(self) -> tuple[str, str]:
        """What is added and the error of that, else the factor and its error in per cent."""
        if self.lump:
            added, error = with_error(self.added, self.lump * self.std)
            return f"+ {added}", error
        factor, _ = with_error(self.factor, self.factor * self.std)
        return factor, f"{number(100 * self.std, 2)} %"

    def said(self) -> str:
        """Name and factor, or what is added."""
        size, error = self.digits()
        if self.lump:
            return f"{self.name}: {size.removeprefix('+ ')} ± {error}"
        return f"{self.name} x {size} (± {error})"

    @property
    def named(self) -> tuple[str, ...]:
        """It and all that the data cannot separate from it."""
        return (self.name, *self.collinear, *self.rivals)


@dataclass(frozen=True, slots=True, eq=False)
class Proposal(FrozenArrays):
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
        The first candidates by other rules, to compare: orthogonal and largest sensitivities,
        single gain.
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

    def text(self) -> str:
        """The proposal in words, a line each."""
        if not self.members:
            return f"no parameter: {self.unexplained()}"
        names = ", ".join(m.name for m in self.members)
        head = f"{_number(len(self.members))}: {names}"
        lines = [
            head,
            *(
                f"{i}. {m.said()}: {m.because}"
                for i, m in enumerate(self.members, start=1)
            ),
        ]
        proposed = [m.name for m in self.members]
        rivals = [
            n
            for m in self.members
            for n in (*m.collinear, *m.rivals)
            if n not in proposed
        ]
        rivals = list(dict.fromkeys(rivals))
        if rivals:
            lines.append(
                f"the data cannot separate {_number(len(rivals))} from these: {', '.join(rivals)}"
            )
        if self.insensitive:
            lines.append(
                f"{_number(len(self.insensitive))} change nothing that was measured"
            )
        mac = (
            f"mean MAC {100 * self.mac[0]:.1f} -> {100 * self.mac[1]:.1f} %, "
            if self.seen
            else ""
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

    def left_over(self, weights: Weights) -> Weights:
        """The weights of deviations as large as the best set leaves them."""
        frequency, mac = self.discrepancy.tolist()
        return replace(weights, frequency=frequency, mac=mac)

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
    problem: Problem,
    settings: SearchSettings = DEFAULT_SEARCH,
    *,
    conflicts: Bool | None = None,
    errors: Mapping[str, Float] | None = None,
    words: Sequence[str] = (),
    progress: Progress = quiet,
) -> Proposal:
    """A ranked, explained set of parameters.

    Parameters
    ----------
    problem : Problem
        All tests and data, over all candidates; its models can be held to some of them
        (`ReducedModel`, `DenseModel`).
    settings : SearchSettings
    conflicts : (p, p) bool, optional
        Pairs that must not be proposed together: factors on the same field (`screening.conflicts`).
    errors : mapping of str to (p,) float64, optional
        Concentration of local errors on each candidate (`ElementErrors.concentration`), named among
        the reasons.
    words : sequence (p,) of str, optional
        What each candidate is.

    Raises
    ------
    InputError
        If `most` is less than 1, or no mode is paired at the start.
    """
    if settings.most < 1:
        raise InputError(
            f"propose at most {settings.most} parameters: allowed are 1 and more"
        )

    def search(
        barred: Sequence[int], known: Sequence[FittedSet], progress: Progress
    ) -> Subsets:
        plain = Search.of(problem, settings, conflicts=conflicts, barred=barred)
        return subsets(plain, progress, known)

    masses = [i for i, p in enumerate(problem.parameters.parameters) if p.lump]
    found = search(masses, (), part(progress, 0.0, 0.35 if masses else 0.7))
    barred = masses
    if masses:
        found, barred = with_masses(search, found, masses, part(progress, 0.35, 0.7))
    progress(0.7, "testing each parameter")
    return _explained(found, barred, errors or {}, words)


def _explained(
    found: Subsets,
    barred: Sequence[int],
    errors: Mapping[str, Float],
    words: Sequence[str],
) -> Proposal:
    search = found.search
    zero = found.start
    best = found.path[-1]
    p = search.problem.parameters
    single = variation(search.target, zero, p)
    reasons = _ReasonsLeftOut(search, search.point(best.x), single, errors, words)
    stds = stated_errors(search, best, reasons.end).tolist()
    mirror = mirrored(search, best, zero)
    tested = []
    for i, std in zip(best.members.tolist(), stds, strict=True):
        tested.append(_tested(best, i, std, reasons, mirror.get(i)))
    quiet_ones = np.setdiff1d(np.arange(len(p)), [*search.pool.tolist(), *barred])
    ends = (zero, found.end)
    macs = [
        np.nan if search.target.frequency_only else _mean(r.mac[r.used]) for r in ends
    ]
    deviations = [_mean(np.abs(r.frequency_error[r.used])) for r in ends]
    return Proposal(
        members=tuple(sorted(tested, key=lambda m: -m.worth)),
        sizes=np.array([c.members.size for c in found.path[:-1]]),
        criteria=found.criteria[:-1],
        insensitive=tuple(p.names[i] for i in quiet_ones),
        clusters=search.groups,
        x=best.x,
        before=deviations[0],
        after=deviations[1],
        mac=np.array(macs),
        paired=np.array([r.used.sum() for r in ends]),
        discrepancy=np.array([found.found.frequency, found.found.mac]),
        orders=_orders(search, zero, single),
    )


def _mean(x: Float) -> float:
    """NaN where no mode has a partner."""
    return float(x.mean()) if x.size else float("nan")


def _tested(
    best: FittedSet,
    index: int,
    std: float,
    reasons: _ReasonsLeftOut,
    mirror: int | None,
) -> Proposed:
    """Leave one member out, then put others in its place; the data cannot separate it from its
    mirror image.
    """
    search = reasons.search
    end = reasons.end
    p = search.problem.parameters
    stay = [m for m in best.members.tolist() if m != index]
    without = FittedSet(np.zeros(0, dtype=np.int64), np.zeros(best.x.size), 0.0)
    if stay:
        without = search.fit(stay, best.without([index]))
    r = search.point(without.x)
    twins = np.flatnonzero(search.groups == search.groups[index])
    free = np.setdiff1d(search.free(stay), twins)
    # what is collinear with another member is barred from the search, but may be what is wrong in
    # place of this one
    barred = search.pool[~search.conflicts[np.ix_(search.pool, stay)].any(axis=1)]
    barred = np.setdiff1d(barred, np.concatenate([free, twins, best.members]))
    # where modes are lost without it, the linearisation with it knows more
    lost = r.used.sum() < end.used.sum()
    here = Here.of(end, best.x, [index]) if lost else Here.of(r, without.x)
    start = here.x.copy()
    start[index] = 0.0
    tried = []
    for some in (free, barred):
        ranked = search.best(here, stay, some)
        likely = [o for j, o in ranked if j < PROPOSAL.promising * best.value]
        for members in likely[: PROPOSAL.tried]:
            x = _at_minimum(search, here, members) if lost else start
            tried.append(search.fit(members, x))
    values = aicc(
        search, [best, replace(without, members=np.array(stay, dtype=np.int64)), *tried]
    )
    rise = values - values[0]
    rivals = [t for t, d in zip(tried, rise[2:], strict=True) if d < PROPOSAL.rival]
    if mirror is not None:
        twins = np.append(twins, mirror)
    member = Proposed(
        name=p.names[index],
        index=index,
        factor=float(p.take([index]).factors(best.x[[index]])[0]),
        std=std,
        worth=float(rise[1]),
        collinear=tuple(p.names[i] for i in np.setdiff1d(twins, best.members)),
        rivals=tuple(p.names[t.members[-1]] for t in rivals),
        because="",
        lump=p.parameters[index].lump,
    )
    return replace(member, because=reasons.of(member, r))


def _at_minimum(search: Search, here: Here, members: Sequence[int]) -> Float:
    """x (p,) with the members at the minimum of the linearised J; at 0 a new one may leave modes
    without a partner.
    """
    i = list(members)
    g = here.at.slope[:, i]
    load = g.T @ (here.value + g @ here.x[i])
    x = here.x.copy()
    x[i] = np.linalg.solve(g.T @ g + np.diag(search.prior[i] ** -2), load)
    return np.clip(x, *search.problem.parameters.bounds())


@dataclass(frozen=True, slots=True, eq=False)
class _ReasonsLeftOut:
    """Why a parameter is proposed.

    Attributes
    ----------
    search : Search
    end : Residual
        At the end, with all members.
    single : Variation
        What each candidate explains by itself.
    errors : mapping of str to (p,) float64
        Concentration of local errors.
    words : sequence (p,) of str
        What each candidate is; may be empty.
    """

    search: Search
    end: Residual
    single: Variation
    errors: Mapping[str, Float]
    words: Sequence[str]

    def of(self, p: Proposed, without: Residual) -> str:
        """In one line; `without` are the residuals of the fit without it."""
        i = p.index
        every = self.search.problem.parameters
        parts = [self.words[i]] if self.words else []
        low, high = every.bounds()
        x = float(every.take([i]).vector(np.array([p.factor]))[0])
        if min(x - low[i], high[i] - x) < 1e-9:
            parts.append("at its bound")
        parts.append(
            f"without it AICc rises by {p.worth:.1f} and {self._loss(without)}"
        )
        shares = {
            "the squared frequency errors": self.single.frequency[i],
            "1 − MAC": self.single.mac[i],
        }
        explained = [
            f"{100 * share:.0f} % of {what}"
            for what, share in shares.items()
            if share > PROPOSAL.explains
        ]
        little = "little: it helps together with the others"
        parts.append(f"by itself it explains {' and '.join(explained) or little}")
        strong = [
            f"{INDICATORS.get(name, name)} {value[i]:.1f}"
            for name, value in self.errors.items()
            if value[i] > PROPOSAL.gathered
        ]
        if strong:
            parts.append(
                "local errors gather there, for its share of strain energy "
                f"({', '.join(strong)} times average)"
            )
        if p.collinear:
            parts.append(f"the data cannot separate it from {_some(p.collinear)}")
        if p.rivals:
            parts.append(f"as good in its place: {_some(p.rivals)}")
        return "; ".join(parts)

    def _loss(self, without: Residual) -> str:
        """What a fit loses without a member."""
        end = self.end
        shapes = not self.search.target.frequency_only
        lost = int(end.used.sum()) - int(without.used.sum())
        if lost > 0:
            return f"{lost} of {int(end.used.sum())} modes are too far off to count as paired"
        figures = {
            "mean |Δf|": [
                100 * _mean(np.abs(r.frequency_error[r.used])) for r in (end, without)
            ]
        }
        if shapes:
            figures["mean 1 − MAC"] = [
                100 * _mean(1 - r.mac[r.used]) for r in (end, without)
            ]
        for name, (a, b) in figures.items():
            if f"{a:.2f}" != f"{b:.2f}":
                return f"{name} is {b:.2f} instead of {a:.2f} %"
        same = "neither Δf nor MAC changes" if shapes else "Δf does not change"
        return f"{same} by 0.01 %"


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:6])
    return shown if len(names) <= 6 else f"{shown} and {len(names) - 6} more"


def _orders(
    search: Search, zero: Residual, single: Variation
) -> dict[str, tuple[str, ...]]:
    """The first ten candidates by simpler rules, one a cluster."""
    g = zero.slope * search.prior
    orders = {
        "orthogonal sensitivities": orthogonal(g, min(g.shape)),
        "largest sensitivities": largest(g, g.shape[1]),
        "single gain": np.argsort(-single.gain, kind="stable"),
    }
    names = search.problem.parameters.names
    out = {}
    for rule, order in orders.items():
        _, first = np.unique(search.groups[order], return_index=True)
        out[rule] = tuple(names[i] for i in order[np.sort(first)][:10])
    return out


def stated_errors(search: Search, best: FittedSet, end: Residual) -> Float:
    """Standard deviation (k,) of x of each member: what all other candidates may be off by widens
    it.

    Those that scale a field of a member are held: it stands for them. So are masses that the deck
    may lack elsewhere: that something was left out is rare. Of A⁻¹ + ddᵀ, d the step to the common
    minimum: `uncertainty.around`.
    """
    members = best.members.tolist()
    held = search.conflicts[members].any(axis=0)
    held[[*search.masses.tolist(), *members]] = True
    every = [*members, *np.flatnonzero(~held).tolist()]
    prior = search.prior[every]
    g = end.slope[:, every] * prior
    inverse = np.linalg.inv(g.T @ g + np.eye(len(every)))
    step = inverse @ (g.T @ end.value - best.x[every] / prior)
    return (np.sqrt(np.diag(inverse) + step**2) * prior)[: len(members)]


def mirrored(search: Search, best: FittedSet, zero: Residual) -> dict[int, int]:
    """The candidate most collinear with each member at the deck, where all of these together do as
    well.

    Of a symmetric structure the frequencies do not separate an error from its mirror image. One of
    two members in the place of its image is not as good.
    """
    members = best.members.tolist()
    like = cosines(zero.slope * search.prior)[members]
    others = np.setdiff1d(search.pool, members)
    like[:, np.setdiff1d(np.arange(best.x.size), others)] = 0.0
    near = like.max(axis=1, initial=0.0) > search.settings.collinear
    image = np.where(near, like.argmax(axis=1), members)
    same = (image == members).all() or np.unique(image).size < image.size
    if same or search.conflicts[np.ix_(image, image)].any():
        return {}
    x = np.zeros(best.x.size)
    x[image] = best.x[members]
    value, other = aicc(search, [best, search.fit(image.tolist(), x)])
    if other - value >= PROPOSAL.rival:
        return {}
    return dict(zip(members, image.tolist(), strict=True))


def with_masses(
    search: Callable[[Sequence[int], Sequence[FittedSet], Progress], Subsets],
    own: Subsets,
    masses: list[int],
    progress: Progress,
) -> tuple[Subsets, list[int]]:
    """The sets with added masses where the one without has no support compared with them, else
    `own`; and which masses were barred.

    Parameters
    ----------
    search : callable (barred, known, progress) -> Subsets
        Without those barred, and with sets that are known among those that compete.
    own : Subsets
        With all masses barred.
    masses : list of int
        Positions of these among the candidates.
    """
    known = _better(own, masses)
    barred: list[int] = []
    likely = [i for c in known for i in c.members.tolist() if i in masses]
    while likely:
        allowed = [c for c in known if not np.isin(c.members, barred).any()]
        found = search(barred, [own.path[-1], *allowed], progress)
        solid, small = _by_size(found.search, found.path[-1])
        if not small:
            sets = [found.search.refitted(own.path[-1]), found.path[-1]]
            without, with_them = criteria(found.search, sets).tolist()
            return (
                (found, barred)
                if without - with_them > PROPOSAL.support
                else (own, masses)
            )
        likely = [i for i in {*likely, *solid} if i not in small]
        barred = [i for i in masses if i not in likely]
    return own, masses


def _better(own: Subsets, masses: list[int]) -> list[FittedSet]:
    """Sets with masses that are better than the best without: grown by the linearised J at points
    of the path.
    """
    search = own.search
    best = own.path[-1]
    able = np.array(
        [i for i in masses if search.size[i] >= search.settings.sensitive], dtype=int
    )
    free = np.append(search.pool, able)
    tried = []
    for c in {c.x.tobytes(): c for c in (own.path[0], *own.path[-2:])}.values():
        if not search.point(c.x).used.any():
            continue
        grown = [o for i in able.tolist() for o in _grown(search, c, [i], free)]
        for _, at in sorted(grown)[:4]:
            fitted = search.fit(at, c.only(at))
            if not _by_size(search, fitted)[1]:
                tried.append(fitted)
    tried.sort(key=lambda c: -c.value)
    # the best of each set
    tried = list({tuple(sorted(c.members)): c for c in tried}.values())
    least, *every = criteria(search, [best, *tried]).tolist()
    return [c for c, value in zip(tried, every, strict=True) if value < least]


def _grown(search: Search, at: FittedSet, members: list[int], free: Int) -> Ranked:
    """Sets of up to six by the linearised J at a point, one member more each time: the criterion
    foreseen, and members.
    """
    r = search.point(at.x)
    here = Here(r, np.zeros(at.x.size), r.value + r.slope @ at.x)
    value = search.predicted(here, members)
    out = [(foreseen(search, r, members, value), members)]
    while len(members) < 6:
        barred = np.isin(search.groups[free], search.groups[members])
        barred |= search.conflicts[free][:, members].any(axis=1)
        if barred.all():
            break
        value, members = search.best(here, members, free[~barred])[0]
        out.append((foreseen(search, r, members, value), members))
    return out


def _by_size(search: Search, c: FittedSet) -> tuple[list[int], list[int]]:
    """Masses of a set that are large enough, and those that are not: what is so small takes the
    part of some other error.
    """
    added = np.abs(search.problem.parameters.factors(c.x) - 1)
    every = np.intersect1d(c.members, search.masses)
    enough = added[every] >= PROPOSAL.least_mass
    return every[enough].tolist(), every[~enough].tolist()
