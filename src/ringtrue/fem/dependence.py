"""K and M as functions of all parameters together: fixed matrices times functions of the factors.

They are taken apart at the nominal model (an anchored decomposition; Rabitz and Alış 1999, sec. 3): what each parameter
does by itself, and, where several act on the same elements, what they do together beyond that, as E and T of a shell.
Three and more are looked at where any two of them do something together.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, lru_cache, partial
from typing import Any, Literal

import numpy as np
from scipy import linalg, sparse

from ringtrue.core.arrays import Any_, Bool, Float
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.core.progress import Progress, part, quiet
from ringtrue.errors import DeckError, UnsupportedError
from ringtrue.fem.assembly import System, full_matrices, reduced
from ringtrue.fem.functions import AffineTerm, Basis, Chebyshev, Function, Powers, power
from ringtrue.fem.kinds import batches
from ringtrue.fem.mesh import Matrices, Mesh, mesh
from ringtrue.fem.powers import CHECK, Group, Pair, built, cubic, groups_of, size
from ringtrue.fem.rows import Rows, common, union
from ringtrue.model.model import Model

NODES = (6, 12, 24, 48)  # of a function that is no polynomial; more where fewer do not hold
COARSE = 9  # functions of two parameters, that more may join
SAMPLE = 40  # elements of a kind that tell its functions
AT_ONCE = 16  # sets whose samples are evaluated together
HELD = 200_000  # element matrices of samples that are kept
KEPT = 5000  # elements of which the matrices at all points fit into memory
RANK, HOLDS, NOISE = 1e-12, 1e-9, 1e-12  # relative: functions kept, error allowed, no such part below
INVALID = (DeckError, np.linalg.LinAlgError, ValueError)  # of factors that a section does not allow
MARGIN = 1.05  # by which the range of a series exceeds the bounds
Form = Literal["powers", "series", "rough"]
Members = Sequence[tuple[Group, Basis]]
Set = tuple[Members, Rows]  # groups that act on the same elements, and the rows of these
At = Callable[[tuple[float, ...]], Any]  # factors of the groups -> K and M of elements, as arrays or sparse


def affine_terms(
    model: Model,
    parameters: ParameterSet,
    system: System,
    *,
    progress: Progress | None = None,
) -> tuple[AffineTerm, ...]:
    """The parts of K(a) = K(1) + Σ g_t(a) K_t, M likewise, in the free degrees of freedom.

    What is a polynomial of degree three or less in each factor is exact; the rest (the sections of beams with shear,
    Poisson's ratio) is a Chebyshev series in ln a over the bounds, to 1e-9 of the largest entry. Only the affected
    elements are computed.

    Raises
    ------
    UnsupportedError
        If a parameter moves nodes, or the matrices are no smooth function of it between its bounds.
    InputError
        If a target or element is not in the model.
    """
    m, every, out, sets = mesh(model), list[tuple[Group, Basis]](), list[AffineTerm](), list[Set]()
    told = part(progress, 0.0, 0.5)
    for i, p in enumerate(parameters.parameters):
        told(i / len(parameters), f"derivatives: {p.name}")
        sums: dict[int, list[Pair]] = {}
        for g in groups_of(model, i, p):
            parts = _alone(m, g)
            every.append((g, _basis(g, parts)))
            if parts is None:
                sets.append((every[-1:], g.rows))
            for exponent, pair in (parts or {}).items():
                sums.setdefault(exponent, []).append(pair)
        out += [_term(power(i, e), _total(sums[e]), system) for e in sorted(sums)]
    pairs = list(_pairs(every))
    alone, two = _joint(m, sets, system, quiet), _joint(m, [s for _, s in pairs], system, part(progress, 0.5, 0.7))
    met = [at for (at, _), found in zip(pairs, two, strict=True) if found]
    larger = _joint(m, list(_larger(every, met)), system, part(progress, 0.7, 1.0))
    return (*out, *itertools.chain(*alone, *two, *larger))


def form(model: Model, parameter: Parameter, system: System) -> Form:
    """How K and M depend on a parameter, tried on a sample of its elements; "rough": `affine_terms` has no parts.

    Raises
    ------
    InputError
        If a target or element is not in the model.
    """
    m = mesh(model)
    try:
        some = [replace(g, rows=_few(g.rows)) for g in groups_of(model, 0, parameter)]
        alone = [_alone(m, g) for g in some]
        sets = [([(g, _series(g, NODES[0]))], g.rows) for g, parts in zip(some, alone, strict=True) if parts is None]
        series = any(_joint(m, [one], system, quiet)[0] for one in sets)
    except UnsupportedError:
        return "rough"
    return "series" if series else "powers" if any(alone) else "rough"


def together(model: Model, first: Parameter, second: Parameter) -> Literal["", "coarse", "fine"]:
    """What two parameters do beyond each by itself: nothing, or a coarse or a fine series, tried on a sample."""
    m = mesh(model)
    groups = [g for i, p in enumerate((first, second)) for g in groups_of(model, i, p)]
    every = [(g, _basis(g, _alone(m, replace(g, rows=_few(g.rows))))) for g in groups]
    sets = [(some, _samples(m, [(some, rows)])[0]) for _, (some, rows) in _pairs(every)]
    meet = [(some, sample) for some, sample in sets if _beyond(sample, some)]
    return "" if not meet else "coarse" if all(_coarse(*one) for one in meet) else "fine"


def _coarse(some: Members, sample: At) -> bool:
    which = tuple(g.which for g, _ in some)
    for bases in itertools.islice(_tries(some), 2):
        functions, nodes = _functions(sample, which, bases)
        fitted = _fitted(sample, functions, nodes, _noise(sample, some), _checks(bases))
        if len(functions) <= COARSE and fitted is not None:
            return True
    return False


def _alone(m: Mesh, g: Group) -> dict[int, Pair] | None:
    """The parts of a polynomial; None if it is none."""
    try:
        some = cubic(m, replace(g, rows=_few(g.rows)))  # most that are none are found on a sample
        if set(some) == {1}:
            with suppress(UnsupportedError):  # other elements may have higher powers
                return cubic(m, g, linear=True)
        return cubic(m, g)
    except UnsupportedError:
        return None


def _few(rows: Rows) -> Rows:
    """A sample of the rows of each card."""
    return {card: at[np.unique(np.linspace(0, at.size - 1, SAMPLE).astype(int))] for card, at in rows.items()}


def _total(pairs: Sequence[Pair]) -> Pair:
    K, M = pairs[0]
    for k, mass in pairs[1:]:
        K, M = sparse.csr_array(K + k), sparse.csr_array(M + mass)
    return K, M


def _term(function: Function, pair: Pair, system: System) -> AffineTerm:
    return AffineTerm(function, reduced(system.transform, pair[0]), reduced(system.transform, pair[1]))


def _series(g: Group, n: int) -> Chebyshev:
    return Chebyshev(g.parameter.lower / MARGIN, g.parameter.upper * MARGIN, n)


def _pairs(every: Members) -> Iterator[tuple[tuple[int, int], Set]]:
    """Groups of two parameters that act on the same elements, and which they are."""
    near = _overlap([g for g, _ in every])
    for i, j in np.argwhere(np.triu(near, 1)).tolist():
        first, second = every[i][0], every[j][0]
        if first.which != second.which and (both := common(first.rows, second.rows)):
            yield (i, j), ([every[i], every[j]], both)


def _larger(every: Members, pairs: Sequence[tuple[int, int]]) -> Iterator[Set]:
    """Groups of three and more, any two of which do something together: `pairs`."""
    near = np.zeros((len(every), len(every)), dtype=np.bool_)
    for i, j in pairs:
        near[i, j] = near[j, i] = True
    sets: list[tuple[tuple[int, ...], Rows]] = [((i, j), common(every[i][0].rows, every[j][0].rows)) for i, j in pairs]
    while sets:
        larger: list[tuple[tuple[int, ...], Rows]] = []
        for at, rows in sets:
            for j in np.flatnonzero(near[list(at)].all(axis=0)).tolist():
                if j > at[-1] and (both := common(rows, every[j][0].rows)):
                    larger.append(((*at, j), both))
                    yield [every[i] for i in (*at, j)], both
        sets = larger


def _overlap(groups: Sequence[Group]) -> Bool:
    """Which groups have elements in common, (g, g)."""
    cards = {card: i for i, card in enumerate(sorted({card for g in groups for card in g.rows}))}
    wide = 1 + max((int(at.max(initial=0)) for g in groups for at in g.rows.values()), default=0)
    of, at = np.hstack(
        [np.empty((2, 0), dtype=np.int64)]
        + [
            np.stack([np.full(at.size, i), cards[c] * wide + at])
            for i, g in enumerate(groups)
            for c, at in g.rows.items()
        ]
    )
    member = sparse.csr_array((np.ones(of.size), (of, at)), shape=(len(groups), len(cards) * wide))
    return np.asarray((member @ member.T).toarray() > 0.0)


def _joint(m: Mesh, sets: Sequence[Set], system: System, progress: Progress) -> list[list[AffineTerm]]:
    """What the groups of each set do together, beyond what fewer of them do; empty where that is nothing."""
    found: dict[int, list[AffineTerm]] = {}
    for some in _apart(m.model, sets):
        progress(len(found) / len(sets), "derivatives: parameters on the same elements")
        for i, sample in zip(some, _samples(m, [sets[i] for i in some]), strict=True):
            found[i] = _terms(m, *sets[i], sample, system)
    return [found[i] for i in range(len(sets))]


def _apart(model: Model, sets: Sequence[Set]) -> Iterator[list[int]]:
    """Sets at whose factors the kernels can be called once: of like bases, and none feels the fields of another."""
    made: dict[object, list[tuple[list[int], dict[str, Bool]]]] = {}
    for i, (some, _) in enumerate(sets):
        like = made.setdefault(tuple((b, g.parameter.lower, g.parameter.upper, g.matrix) for g, b in some), [])
        reach = [(c, at) for g, _ in some for c, at in g.reach.items()]
        scaled = any(g.matrix for g, _ in some)  # a factor on matrices holds for all that are built
        for batch, taken in [] if scaled else like:
            if len(batch) < AT_ONCE and not any(taken[c][at].any() for c, at in reach if c in taken):
                break
        else:
            batch, taken = list[int](), dict[str, Bool]()
            like.append((batch, taken))
        batch.append(i)
        for c, at in reach:
            taken.setdefault(c, np.zeros(len(model[c]), dtype=bool))[at] = True
    yield from (batch for like in made.values() for batch, _ in like)


def _samples(m: Mesh, sets: Sequence[Set]) -> list[At]:
    """K and M of a few elements of each set, end to end, as functions of the factors of its groups."""
    few = [_few(rows) for _, rows in sets]
    rows = union(few)
    places = [[np.isin(there, some.get(c, ())) for c, _, there in batches(m.model, rows)] for some in few]
    side_by_side = zip(*([g for g, _ in some] for some, _ in sets), strict=True)
    groups = [replace(like[0], targets=tuple(t for g in like for t in g.targets)) for like in side_by_side]

    @lru_cache(maxsize=HELD // max(sum(at.size for at in rows.values()), 1))
    def every(a: tuple[float, ...]) -> list[list[Float]]:
        made = built(m, groups, rows, a)
        return [[_ends(made, name, pick) for name in ("stiffness", "mass")] for pick in places]

    def sample(k: int, a: tuple[float, ...]) -> list[Float]:
        try:
            return every(a)[k]
        except INVALID:
            if len(sets) == 1:
                raise
        found: list[Float] = _samples(m, [sets[k]])[0](a)  # it may be another set that does not allow them
        return found

    return [partial(sample, k) for k in range(len(sets))]


def _ends(parts: Sequence[Matrices], name: str, picks: Sequence[Bool]) -> Float:
    """Matrices of some elements end to end."""
    return np.concatenate([getattr(p, name)[pick].ravel() for p, pick in zip(parts, picks, strict=True)])


def _terms(m: Mesh, some: Members, rows: Rows, sample: At, system: System) -> list[AffineTerm]:
    """What the groups do together, beyond what fewer of them do; `sample` is of a few of the rows.

    Raises
    ------
    UnsupportedError
        If no series holds.
    """
    groups = [g for g, _ in some]

    def every(a: tuple[float, ...]) -> Pair:
        return full_matrices(m, built(m, groups, rows, a))

    whole = cache(every) if sum(at.size for at in rows.values()) < KEPT else every

    noise = _noise(sample, some)
    try:
        if not _beyond(sample, some):
            return []
        with np.errstate(all="ignore"):  # a pole between the bounds is found by what does not hold
            for bases in _tries(some):
                functions, nodes = _functions(sample, tuple(g.which for g in groups), bases)
                checks = _checks(bases)
                if _fitted(sample, functions, nodes, noise, checks) is None:
                    continue
                if (parts := _fitted(whole, functions, nodes, noise, checks[:1])) is not None:
                    return [_term(f, p, system) for f, p in zip(functions, parts, strict=True)]
    except INVALID as e:
        raise UnsupportedError(_rough(groups)) from e
    raise UnsupportedError(_rough(groups))


def _noise(sample: At, some: Members) -> list[float]:
    """What of K and of M is rounding."""
    return [NOISE * size(x) for x in sample((1.0,) * len(some))]


def _beyond(sample: At, some: Members) -> bool:
    """Whether the groups do more together than fewer of them."""
    found = _together(sample, tuple(g.parameter.upper**0.4 for g, _ in some))
    return any(size(x) > limit for x, limit in zip(found, _noise(sample, some), strict=True))


def _basis(g: Group, parts: dict[int, Pair] | None) -> Basis:
    """Powers where a polynomial was found, else the coarsest series."""
    return _series(g, NODES[0]) if parts is None else Powers(tuple(parts) or (1,))


def _tries(some: Members) -> Iterator[tuple[Basis, ...]]:
    """Bases to try in turn: powers where one parameter has them by itself, finer and finer series, series alone."""
    own = tuple(b for _, b in some)
    powers = [isinstance(b, Powers) for b in own]
    if all(powers):
        yield own
    else:
        for n in NODES:
            yield tuple(b if p else _series(g, n) for p, (g, b) in zip(powers, some, strict=True))
    if any(powers):
        yield tuple(_series(g, NODES[2]) for g, _ in some)


def _together(at: At, a: tuple[float, ...]) -> list[Any_]:
    """Mixed difference of K and M: the sum over each factor at its value and, with the other sign, at 1."""
    total: list[Any_] = []
    for on in itertools.product((True, False), repeat=len(a)):
        sign = (-1.0) ** (len(on) - sum(on))
        parts = [sign * x for x in at(tuple(x if o else 1.0 for x, o in zip(a, on, strict=True)))]
        total = [x + y for x, y in zip(total, parts, strict=True)] if total else parts
    return total


def _functions(
    sample: At, which: tuple[int, ...], bases: tuple[Basis, ...]
) -> tuple[list[Function], list[tuple[float, ...]]]:
    """Functions that span what the sample does, and as many points that tell them apart."""
    grid = [tuple(float(x) for x in at) for at in itertools.product(*(b.nodes for b in bases))]
    found = [_together(sample, a) for a in grid]
    both = [np.array([pair[i] for pair in found]) for i in range(2)]
    data = np.hstack([x / max(size(x), 1e-300) for x in both])
    tensor, shape = np.ones((1, 1)), list[int]()
    for b in bases:
        values = np.array([b(float(x))[0] for x in b.nodes])
        tensor, shape = np.kron(tensor, values), [*shape, values.shape[1]]
    if all(isinstance(b, Powers) for b in bases):
        there = np.abs(linalg.solve(tensor, data)).max(axis=1, initial=0.0) > NOISE
        weights = np.eye(len(grid))[:, there]
    else:
        u, s, _ = linalg.svd(data, full_matrices=False)
        kept = min(int((s > RANK * s[0]).sum()), tensor.shape[1])  # more cannot be told apart: a finer series is tried
        weights = linalg.lstsq(tensor, u[:, :kept])[0]
    seen = tensor @ weights
    _, _, order = linalg.qr(seen.T, mode="economic", pivoting=True)
    functions = [Function(which, bases, w.reshape(shape)) for w in weights.T]
    return functions, [grid[i] for i in order[: len(functions)].tolist()]


def _parts(
    at: At, functions: Sequence[Function], nodes: Sequence[tuple[float, ...]], noise: Sequence[float]
) -> list[tuple[Any, Any]]:
    """K and M that go with each function; what is below `noise` is 0."""
    pairs = [_together(at, a) for a in nodes]

    def sums(i: int, row: Float) -> Any:
        total = sum(c * pair[i] for c, pair in zip(row.tolist(), pairs, strict=True))
        return total if size(total) > noise[i] else total * 0

    values = np.array([[f.value(a) for f in functions] for a in nodes])
    return [(sums(0, row), sums(1, row)) for row in np.linalg.inv(values)]


def _fitted(
    at: At,
    functions: Sequence[Function],
    nodes: Sequence[tuple[float, ...]],
    noise: Sequence[float],
    points: Sequence[tuple[float, ...]],
) -> list[tuple[Any, Any]] | None:
    """The K and M that go with each function; None where they do not hold at the points."""
    parts = _parts(at, functions, nodes, noise)
    return parts if all(_miss(at, functions, parts, a) < HOLDS for a in points) else None


def _checks(bases: tuple[Basis, ...]) -> list[tuple[float, ...]]:
    """Points off the grid at which the series must hold."""

    def inside(b: Basis, share: float) -> float:
        return CHECK + share if isinstance(b, Powers) else b.lower * (b.upper / b.lower) ** share

    return [tuple(inside(b, abs(s - 0.07 * i)) for i, b in enumerate(bases)) for s in (0.41, 0.13, 0.87)]


def _miss(at: At, functions: Sequence[Function], parts: Sequence[tuple[Any, Any]], a: tuple[float, ...]) -> float:
    """Error at a point relative to the largest entry of the elements' K or M there."""
    worst = 0.0
    for true, there, fixed in zip(_together(at, a), at(a), zip(*parts, strict=True), strict=True):
        found = sum(f.value(a) * p for f, p in zip(functions, fixed, strict=True))
        worst = max(worst, size(true - found) / max(size(there), 1e-300))
    return worst


def _rough(groups: Sequence[Group]) -> str:
    names = " and ".join(
        f"{g.parameter.name} ({g.fields}, {g.parameter.lower:g} to {g.parameter.upper:g})" for g in groups
    )
    return (
        f"parameter {names}: the matrices are no smooth function of it between its bounds; narrow the bounds, or "
        "update with a solver that is run anew at each point"
    )
