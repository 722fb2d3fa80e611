"""From many candidates to a few parameters: a ranked proposal, with the reason for each and its rivals.

1. Candidates to which the residuals are not sensitive are left out.
2. Sets of growing size: the best addition by the bounded minimum of the linearised J, confirmed by a short updating
   with new linearisations, then exchange of members while J falls. Of a cluster that the data cannot tell apart one
   member stands for all.
3. The size is that of the lowest AICc, less the members that AICc gives no support. What the best model of this form
   leaves as residual replaces the assumed model discrepancy, and the search is done once more with it.
4. Every member is put to the test: J without it, and with any other candidate in its place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ringtrue.core.arrays import Float, Int, freeze_fields
from ringtrue.errors import InputError, NumericalError
from ringtrue.update.choose import GAIN, Candidates, Choice, largest, orthogonal, predicted, short_update
from ringtrue.update.identifiable import ALIKE, clusters, identifiability
from ringtrue.update.localise import Variation, variation
from ringtrue.update.objective import Residual, Target, comparable_criteria, residual
from ringtrue.update.sparse import lasso_path

TRIALS = 2  # promising sets that are fitted in one round
SENSITIVE = 0.05  # least effect of one prior standard deviation, in standard deviations of the residual
POOL = 12  # candidates for an addition or exchange whose bounded prediction is computed
RIVAL = 2.0  # difference of AICc below which a model is as good (Burnham and Anderson 2002, section 2.6)
TIGHT, LOOSE = 0.05, 3.0  # limits of the discrepancy found, in units of the assumed one
WORTH_A_LOOK, LOOKS = 1.3, 6  # predicted J of a rival, in units of the proposal's; most that are fitted
LATER = 2  # sizes beyond the best one that are looked at
SHOWN = 10  # candidates of another rule
Progress = Callable[[float, str], None]


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
        Posterior standard deviation of x, the other proposed ones free.
    worth : float
        Rise of AICc if it is left out and the others are fitted again.
    alike : tuple of str
        Candidates of its cluster: |cosine| of the weighted sensitivities with all of them above the limit.
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
        AICc of the best set of each size.
    insensitive : tuple of str
        Candidates that the residuals do not depend on.
    clusters : (p,) int64
        Of all candidates.
    x : (p,) float64
        At the end of the short updating.
    before, after : float
        Mean |Δf|/f of the used pairs.
    mac : (2,) float64
        Mean MAC of the used pairs before and after.
    discrepancy : (2,) float64
        Relative frequency and 1 − MAC that the best set leaves: the weights of the second search.
    orders : mapping of str to tuple of str
        The first candidates by other rules, to compare: LASSO, orthogonal and largest sensitivities, single gain.
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
    discrepancy: Float
    orders: Mapping[str, tuple[str, ...]]

    def __post_init__(self) -> None:
        f = np.float64
        freeze_fields(self, sizes=np.int64, criteria=f, clusters=np.int64, x=f, mac=f, discrepancy=f)

    def text(self) -> str:
        """The proposal in words, a line each."""
        if not self.members:
            return "no parameter: the model as it is explains the test as well as any change of it"
        names = ", ".join(m.name for m in self.members)
        head = f"{_number(len(self.members))}: {names}"
        lines = [head, *(f"{i}. {m.name}: {m.because}" for i, m in enumerate(self.members, start=1))]
        told = [m.name for m in self.members]
        lost = [n for m in self.members for n in (*m.alike, *m.rivals) if n not in told]
        lost = list(dict.fromkeys(lost))
        if lost:
            lines.append(f"{_number(len(lost))} cannot be told from these: {', '.join(lost)}")
        if self.insensitive:
            lines.append(f"{_number(len(self.insensitive))} change nothing that was measured")
        lines.append(
            f"mean |Δf| {100 * self.before:.2f} -> {100 * self.after:.2f} %, "
            f"mean MAC {100 * self.mac[0]:.1f} -> {100 * self.mac[1]:.1f} %"
        )
        return "\n".join(lines)


def _number(n: int) -> str:
    return f"{n} candidate" if n == 1 else f"{n} candidates"


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """The candidates, what they aim at, and which of them may enter."""

    model: Candidates
    target: Target
    pool: Int
    groups: Int
    low: Float
    high: Float
    prior: Float
    seen: dict[bytes, Residual] = field(default_factory=dict)

    @classmethod
    def of(cls, model: Candidates, target: Target, alike: float) -> _Search:
        p = model.parameters
        low, high = p.bounds()
        start = residual(target, model.linearise(np.zeros(len(p))))
        sensitive = start.slope * p.std()
        pool = np.flatnonzero(np.linalg.norm(sensitive, axis=0) >= SENSITIVE)
        return cls(model, target, pool, clusters(sensitive, alike), low, high, p.std())

    def point(self, x: Float) -> Residual:
        """Residuals and sensitivities to all candidates at x, computed once."""
        key = x.tobytes()
        if key not in self.seen:
            self.seen[key] = residual(self.target, self.model.linearise(x))
        return self.seen[key]

    def fit(self, members: Sequence[int], x: Float) -> Choice:
        """A short updating from x, or from the nominal model where x cannot be solved."""
        try:
            return short_update(self.model, self.target, members, np.clip(x, self.low, self.high))
        except NumericalError:
            return short_update(self.model, self.target, members, np.zeros(x.size))

    def free(self, members: Sequence[int]) -> Int:
        """Candidates of clusters that no member stands for."""
        return self.pool[~np.isin(self.groups[self.pool], self.groups[list(members)])]

    def ahead(self, r: Residual, x: Float, at: Sequence[int], base: Float) -> float:
        """J at the bounded minimum over `at`, linearised at x; `base` is the residual at x with others put to 0."""
        i = list(at)
        g, w = r.slope[:, i], self.prior[i] ** -2
        load = base + g @ x[i]
        y = np.linalg.solve(g.T @ g + np.diag(w), g.T @ load)
        if (y >= self.low[i]).all() and (y <= self.high[i]).all():
            return float(np.sum((load - g @ y) ** 2) + w @ y**2)
        return predicted(g, base, x[i], w, self.low[i], self.high[i])

    def best(
        self, r: Residual, x: Float, stay: Sequence[int], free: Int, value: Float
    ) -> list[tuple[float, list[int]]]:
        """Sets `stay` + one of `free`, by predicted J; a cheap bound chooses the `POOL` that are looked at."""
        i = list(stay)
        g = r.slope * self.prior
        rest = value + r.slope[:, i] @ x[i]
        q = np.linalg.qr(np.concatenate([g[:, i], np.eye(len(i))]))[0] if i else np.zeros((g.shape[0], 0))
        pad = np.zeros((len(i), free.size))
        column = np.concatenate([g[:, free], pad]) if i else g[:, free]
        column = column - q @ (q.T @ column)
        left = np.concatenate([rest, np.zeros(len(i))])
        left = left - q @ (q.T @ left)
        gain = (column.T @ left) ** 2 / (np.sum(column**2, axis=0) + 1)
        few = free[np.argsort(-gain, kind="stable")[:POOL]]
        return sorted((self.ahead(r, x, [*i, c], value), [*i, c]) for c in few.tolist())


def propose(
    model: Candidates,
    target: Target,
    *,
    most: int = 8,
    alike: float = ALIKE,
    errors: Mapping[str, Float] | None = None,
    words: Sequence[str] = (),
    progress: Progress | None = None,
) -> Proposal:
    """A ranked, explained set of parameters.

    Parameters
    ----------
    model : Candidates
        An `ObservedModel` over all candidates that can be held to some of them (`ReducedModel`, `DenseModel`).
    most : int
        Most parameters that are proposed.
    alike : float
        |cosine| from which on the data cannot tell two candidates apart.
    errors : mapping of str to (p,) float64, optional
        Concentration of local errors on each candidate (`ElementErrors.concentration`), told among the reasons.
    words : sequence (p,) of str, optional
        What each candidate is.

    Raises
    ------
    InputError
        If `most` is less than 1, or no mode is paired at the start.
    """
    told = progress or (lambda _f, _t: None)
    if most < 1:
        raise InputError(f"propose at most {most} parameters: allowed are 1 and more")
    search = _Search.of(model, target, alike)
    start = search.point(np.zeros(len(model.parameters)))
    if not start.used.any():
        raise InputError("no mode of the model is paired with one of the test: nothing can be localised from them")
    path = _path(search, most, lambda f, t: told(0.4 * f, t))
    found = _discrepancy(search, path)
    sharp = replace(target, weights=replace(target.weights, frequency=float(found[0]), mac=float(found[1])))
    search = _Search.of(model, sharp, alike)
    path = _path(search, most, lambda f, t: told(0.4 + 0.4 * f, t), path)
    path.append(_pruned(search, path[int(np.argmin(_criteria(search, path)))]))
    criteria = _criteria(search, path)
    told(0.8, "testing each parameter")
    return _explained(search, path, criteria, found, errors or {}, words)


def _path(search: _Search, most: int, told: Progress, before: Sequence[Choice] = ()) -> list[Choice]:
    """The best set found of each size from 0 on; those of an earlier search are tried, too."""
    p = len(search.model.parameters)
    none = Choice(np.zeros(0, dtype=np.int64), np.zeros(p), np.inf)
    path = [none]
    for k in range(1, most + 1):
        now, r = path[-1], search.point(path[-1].x)
        free = search.free(now.members.tolist())
        if not free.size or 2 * int(r.used.sum()) <= k + 3:  # AICc needs more data than parameters
            break
        options = search.best(r, now.x, now.members.tolist(), free, r.value)[:TRIALS]
        tried = [search.fit(at, now.x) for _, at in options]
        tried += [search.fit(c.members.tolist(), c.x) for c in before if c.members.size == k]
        best = _exchanged(search, min(tried, key=lambda c: c.value))
        path.append(best)
        if k >= LATER and np.argmin(_criteria(search, path)) <= k - LATER:  # two more parameters did not pay
            break
        told(k / most, f"{k} parameters: {', '.join(search.model.parameters.names[i] for i in best.members.tolist())}")
    return path


def _exchanged(search: _Search, now: Choice) -> Choice:
    """Exchange one member at a time while J falls."""
    for _ in range(now.members.size if now.members.size > 1 else 0):
        r = search.point(now.x)
        options: list[tuple[float, list[int]]] = []
        for out in now.members.tolist():
            stay = [m for m in now.members.tolist() if m != out]
            free = np.setdiff1d(search.free(stay), [out])
            options += search.best(r, now.x, stay, free, r.value + r.slope[:, out] * now.x[out])[:TRIALS]
        options = sorted(o for o in options if o[0] < (1 - GAIN) * now.value)[:TRIALS]
        tried = [search.fit(at, np.where(np.isin(np.arange(now.x.size), at), now.x, 0.0)) for _, at in options]
        better = min(tried, key=lambda c: c.value, default=now)
        if not better.value < (1 - GAIN) * now.value:
            return now
        now = better
    return now


def _pruned(search: _Search, now: Choice) -> Choice:
    """Leave out members, the least first, without whom AICc is no higher."""
    while now.members.size > 1:
        all_ = now.members.tolist()
        fewer = [
            search.fit([m for m in all_ if m != out], np.where(np.arange(now.x.size) == out, 0.0, now.x))
            for out in all_
        ]
        value = _criteria(search, [now, *fewer])
        best = int(np.argmin(value[1:]))
        if value[1 + best] > value[0]:
            return now
        now = fewer[best]
    return now


def _criteria(search: _Search, path: Sequence[Choice]) -> Float:
    """AICc of each set of the path, all over the test modes that at least one of them pairs."""
    return comparable_criteria(
        search.target,
        [search.point(c.x) for c in path],
        [c.x[c.members] for c in path],
        [search.prior[c.members] for c in path],
    )


def _discrepancy(search: _Search, path: Sequence[Choice]) -> Float:
    """Relative frequency and 1 − MAC that the best set of any size leaves, (2,).

    Variances are over the data that the parameters have left over.
    """
    w, left = search.target.weights, []
    for c in path:
        r = search.point(c.x)
        n = int(r.used.sum())
        spent = 2 * n / max(2 * n - c.members.size, 1)
        left.append([np.mean(r.frequency_error[r.used] ** 2) * spent, np.mean(1 - r.mac[r.used]) * spent])
    f2, m = np.array(left)[int(np.argmin([a / w.frequency**2 + b / w.mac for a, b in left]))]
    f = np.clip(np.sqrt(f2), TIGHT * w.frequency, LOOSE * w.frequency)
    return np.array([f, np.clip(m, TIGHT**2 * w.mac, LOOSE * w.mac)])


def _explained(
    search: _Search,
    path: Sequence[Choice],
    criteria: Float,
    found: Float,
    errors: Mapping[str, Float],
    words: Sequence[str],
) -> Proposal:
    p = search.model.parameters
    best = path[-1]
    zero, end = search.point(np.zeros(len(p))), search.point(best.x)
    alone = variation(search.target, zero, search.prior, search.low, search.high)
    members = tuple(
        sorted(
            (_tested(search, best, end, i, alone, errors, words) for i in best.members.tolist()),
            key=lambda m: -m.worth,
        )
    )
    quiet = np.setdiff1d(np.arange(len(p)), search.pool)
    return Proposal(
        members,
        np.array([c.members.size for c in path[:-1]]),
        criteria[:-1],
        tuple(p.names[i] for i in quiet.tolist()),
        search.groups,
        best.x,
        float(np.abs(zero.frequency_error[zero.used]).mean()),
        float(np.abs(end.frequency_error[end.used]).mean()),
        np.array([zero.mac[zero.used].mean(), end.mac[end.used].mean()]),
        found,
        _orders(search, zero, alone),
    )


def _tested(
    search: _Search,
    best: Choice,
    end: Residual,
    index: int,
    alone: Variation,
    errors: Mapping[str, Float],
    words: Sequence[str],
) -> Proposed:
    """Leave one member out, then put others in its place."""
    names = search.model.parameters.names
    stay = [m for m in best.members.tolist() if m != index]
    without = search.fit(stay, np.where(np.arange(best.x.size) == index, 0.0, best.x)) if stay else None
    x = without.x if without is not None else np.zeros(best.x.size)
    r = search.point(x)
    free = np.setdiff1d(search.free(stay), np.flatnonzero(search.groups == search.groups[index]))
    options = [at for j, at in search.best(r, x, stay, free, r.value) if j < WORTH_A_LOOK * best.value]
    tried = [search.fit(at, x) for at in options[:LOOKS]]
    sets = [best, Choice(np.array(stay, dtype=np.int64), x, 0.0), *tried]
    rise = (c := _criteria(search, sets)) - c[0]
    rivals = tuple(names[t.members[-1]] for t, d in zip(tried, rise[2:].tolist(), strict=True) if d < RIVAL)
    twins = np.flatnonzero((search.groups == search.groups[index]) & (np.arange(best.x.size) != index))
    at = best.members.tolist()
    std = identifiability(end.slope[:, at] * search.prior[at]).together[at.index(index)] * search.prior[index]
    factor = float(search.model.parameters.take([index]).factors(best.x[[index]])[0])
    p = Proposed(
        names[index],
        index,
        factor,
        float(std),
        float(rise[1]),
        tuple(names[i] for i in twins.tolist()),
        rivals,
        "",
    )
    return replace(p, because=_because(p, search, end, r, alone, errors, words))


def _because(
    p: Proposed,
    search: _Search,
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
    wall = min(x - low[i], high[i] - x) < 1e-9
    parts.append(f"factor {p.factor:.3g} (± {100 * p.std:.1f} %){', at its bound' if wall else ''}")
    f0, f1 = (100 * float(np.abs(r.frequency_error[r.used]).mean()) for r in (end, without))
    parts.append(f"without it AICc rises by {p.worth:.1f} and mean |Δf| is {f1:.2f} instead of {f0:.2f} %")
    parts.append(
        f"by itself it explains {100 * alone.frequency[i]:.0f} % of the squared frequency errors"
        f" and {100 * alone.mac[i]:.0f} % of 1 − MAC"
    )
    strong = [f"{name} {value[i]:.1f}" for name, value in errors.items() if value[i] > 1]
    if strong:
        parts.append(f"local errors there are above average for its strain energy ({', '.join(strong)} times)")
    if p.alike:
        parts.append(f"the data cannot tell it from {_some(p.alike)}")
    if p.rivals:
        parts.append(f"as good in its place: {_some(p.rivals)}")
    return "; ".join(parts)


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:6])
    return shown if len(names) <= 6 else f"{shown} and {len(names) - 6} more"


def _orders(search: _Search, zero: Residual, alone: Variation) -> dict[str, tuple[str, ...]]:
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
