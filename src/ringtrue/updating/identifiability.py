"""What the data know of each parameter, and which they cannot distinguish.

Sensitivities are weighted and in units of the prior standard deviation
(`selection_rules.weighted_sensitivities`): GᵀG is the information of the data, the unit matrix
that of the prior. Collinearity by hierarchical clustering of the columns; Cramér-Rao bounds; the
directions of the parameter space that the data do not see.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import linalg
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform
from scipy.special import ndtri

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.errors import InputError


@dataclass(frozen=True, slots=True)
class CollinearityLimits:
    """When the data cannot distinguish parameters.

    Attributes
    ----------
    cosine : float
        Least |cosine| of two weighted sensitivity columns.
    decimals : int
        Decimals, of the largest, to which effects are compared: rounding must not choose.
    share : float
        What the data say of a parameter besides the others, from which on they share a change
        out between them; below it the prior alone does.
    blind : float
        Singular value, in units of the prior, below which the prior says more of a direction
        than the data.
    """

    cosine: float = 0.95
    decimals: int = 9
    share: float = 0.01
    blind: float = 1.0


COLLINEARITY = CollinearityLimits()


@dataclass(frozen=True, slots=True)
class FlagLimits:
    """When a change of a parameter is flagged.

    Attributes
    ----------
    edge : float
        Distance from a bound, of the range between the bounds.
    beyond : float
        Prior standard deviations.
    silent : float
        Posterior over prior standard deviation: the data said nothing.
    slight : float
        Change of a factor that needs no proof.
    tied : float
        |correlation| from which on two parameters are known together, not each by itself.
    kept : float
        Share of a change that should be there whatever modes are left out.
    """

    edge: float = 0.01
    beyond: float = 2.0
    silent: float = 0.9
    slight: float = 0.05
    tied: float = 0.9
    kept: float = 0.5


FLAGS = FlagLimits()

Kind = Literal["bound", "prior", "silent", "form"]


@dataclass(frozen=True, slots=True, eq=False)
class Identifiability(FrozenArrays):
    """Standard deviations of x in units of the prior's.

    Attributes
    ----------
    alone : (p,) float64
        Posterior, all others known: the best that the data can do.
    together : (p,) float64
        Posterior, all candidates free.
    """

    alone: Float
    together: Float


def identifiability(sensitivities: Float) -> Identifiability:
    """Cramér-Rao bounds with the prior.

    Parameters
    ----------
    sensitivities : (r, p) float64
    """
    g = _columns(sensitivities)
    # the left vectors of many residuals would be (r, r)
    _, s, vt = linalg.svd(g, full_matrices=g.shape[0] < g.shape[1])
    share = np.ones(len(vt))
    share[: s.size] = 1 / (1 + s**2)
    together = np.sqrt(share @ vt**2)
    return Identifiability(1 / np.sqrt(1 + np.sum(g**2, axis=0)), together)


def cosines(sensitivities: Float) -> Float:
    """|cosine| of all pairs of columns, (p, p); 0 with a column of zeros."""
    g = _columns(sensitivities)
    size = np.linalg.norm(g, axis=0)
    unit = g / np.where(size > 0, size, 1.0)
    return np.minimum(np.abs(unit.T @ unit), 1.0)


def clusters(sensitivities: Float, limit: float = COLLINEARITY.cosine) -> Int:
    """The cluster of each parameter, (p,) int64, numbered from 0 in the order of their first
    members.

    By complete linkage: no two with a |cosine| below `limit` are in one cluster. A column of zeros
    stands alone.

    Raises
    ------
    InputError
        Unless 0 < limit <= 1.
    """
    if not 0 < limit <= 1:
        raise InputError(f"clusters: limit {limit} must be above 0 and at most 1")
    cosine = cosines(sensitivities)
    if len(cosine) < 2:
        return np.zeros(len(cosine), dtype=np.int64)
    distance = squareform(np.maximum(1 - (cosine + cosine.T) / 2, 0.0), checks=False)
    raw = fcluster(
        linkage(distance, "complete"), 1 - limit + 1e-12, criterion="distance"
    )
    _, first, number = np.unique(raw, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number].astype(np.int64)


def told_apart(
    sensitivities: Float, order: Sequence[int]
) -> tuple[Int, dict[int, Int]]:
    """Which parameters of a set the data can distinguish, and which are to be held at nominal as
    they cannot.

    One after the other a parameter is kept unless those kept before it do the same: what they leave
    of its column is below `COLLINEARITY.share`, so that the prior alone would share a change out
    between them.
    One of which the data tell less than its prior by itself is kept: that holds it.

    Parameters
    ----------
    sensitivities : (r, p) float64
        Weighted, in units of the prior.
    order : sequence of int
        All parameters, those first that are to stand for others.

    Returns
    -------
    kept : (k,) int64
        Ascending.
    held : dict of int to (j,) int64
        Of each parameter that is not kept those that stand for it, the one most like it first.
    """
    g = _columns(sensitivities)
    size = np.linalg.norm(g, axis=0)
    cosine = cosines(g)
    kept = list[int]()
    held = dict[int, Int]()
    span = np.zeros((len(g), 0))
    for i in order:
        own = g[:, i] - span @ (span.T @ g[:, i])
        own = own - span @ (span.T @ own)  # twice is enough (Kahan and Parlett)
        rest = float(np.linalg.norm(own))
        if size[i] >= COLLINEARITY.blind and rest < COLLINEARITY.share:
            near = sorted(kept, key=lambda j: -cosine[i, j])
            same = [j for j in near if cosine[i, j] > COLLINEARITY.cosine]
            held[i] = np.array(same or near, dtype=np.int64)
            continue
        kept.append(i)
        if rest > np.finfo(float).eps * size[i]:
            span = np.column_stack([span, own / rest])
    return np.sort(np.array(kept, dtype=np.int64)), held


def stood_for(
    sensitivities: Float, names: Sequence[str], first: Sequence[str] = ()
) -> dict[str, tuple[str, ...]]:
    """Parameters that are held at nominal by `told_apart`, with those that stand for them.

    Parameters
    ----------
    sensitivities : (r, p) float64
        Weighted, in units of the prior.
    names : sequence of str
        Of the parameters.
    first : sequence of str
        These stand for others; of the rest those of the largest effect, and of equal ones the
        first.
    """
    rank = {name: i for i, name in enumerate(first)}
    norm = np.linalg.norm(sensitivities, axis=0)
    largest = max(norm.max(initial=0.0), 1e-300)
    size = np.round(norm / largest, COLLINEARITY.decimals).tolist()

    def turn(i: int) -> tuple[int, float]:
        return rank.get(names[i], len(rank)), -size[i]

    _, held = told_apart(sensitivities, sorted(range(len(names)), key=turn))
    return {names[i]: tuple(names[j] for j in by) for i, by in held.items()}


def _columns(sensitivities: Float) -> Float:
    g = np.asarray(sensitivities, dtype=np.float64)
    if g.ndim != 2 or not np.isfinite(g).all():
        raise InputError(
            f"sensitivities {g.shape}: must be a finite (residual, parameter) array"
        )
    return g


@dataclass(frozen=True, slots=True)
class Flag:
    """A parameter that needs an engineer's eye.

    Attributes
    ----------
    parameter : str
    kind : {"bound", "prior", "silent", "form"}
        At a bound; changed by more than two prior standard deviations; moved though the data do not
        determine it; not proven, so that it may take up an error of the model's form.
    factor : float
    text : str
    """

    parameter: str
    kind: Kind
    factor: float
    text: str


def plausibility(
    parameters: ParameterSet, x: Float, ratio: Float | None = None
) -> tuple[Flag, ...]:
    """Flags of updated parameters, in their order; none if all is plausible.

    Parameters
    ----------
    parameters : ParameterSet
    x : (p,) float64
    ratio : (p,) float64, optional
        Posterior over prior standard deviation.
    """
    x = np.asarray(x, dtype=np.float64)
    ratios = np.zeros(x.size) if ratio is None else np.asarray(ratio, dtype=np.float64)
    if x.shape != (len(parameters),) or ratios.shape != x.shape:
        raise InputError(
            f"x {x.shape} and ratio {ratios.shape} for {len(parameters)} parameters"
        )
    low, high = parameters.bounds()
    margin = FLAGS.edge * (high - low)
    away = x / parameters.std()
    a = parameters.factors(x)
    flags: list[Flag] = []
    for i, p in enumerate(parameters.parameters):  # over parameters: text for people
        said = _said(p, a[i])
        found: dict[Kind, str] = {}
        below = x[i] <= low[i] + margin[i]
        if below or x[i] >= high[i] - margin[i]:
            side, end = ("lower", p.lower) if below else ("upper", p.upper)
            where = f"its {side} bound {_found(p, end)}"
            found["bound"] = f"{said} is at {where}; the error may lie elsewhere"
        far = abs(away[i])
        if far > FLAGS.beyond:
            found["prior"] = (
                f"{said} is {far:.1f} prior standard deviations from the nominal value"
            )
        if ratios[i] > FLAGS.silent and far > 0.25:
            open_ = f"posterior/prior {ratios[i]:.2f}"
            found["silent"] = f"{said}, but the data do not determine it ({open_})"
        flags += [Flag(p.name, kind, float(a[i]), text) for kind, text in found.items()]
    return tuple(flags)


def kept(x: Float, ends: Float) -> Float:
    """Least share of each change that is there with any fold of modes left out, (p,); below 0 it
    turns round.

    Parameters
    ----------
    x : (p,) float64
    ends : (fold, p) float64
        The same without each fold.
    """
    if not len(ends):
        return np.full(x.size, np.nan)
    return np.asarray((ends / np.where(x == 0.0, 1.0, x)).min(axis=0))


def unproven(
    parameters: ParameterSet, factor: Float, interval: Float, share: Float
) -> Bool:
    """Changes (p,) that the test does not prove: the interval of the factor holds 1, or few modes
    carry the change.

    Slight changes of what the deck has need no proof; masses that it lacks do, however light.

    Such a parameter may take up an error of form, or of a region that is no candidate.

    Parameters
    ----------
    factor : (p,) float64
    interval : (p, 2) float64
        Where the candidates that were not updated may be off, too (`uncertainty.around`).
    share : (p,) float64
        Of `kept`.
    """
    open_ = (interval[:, 0] <= 1) & (interval[:, 1] >= 1)
    slight = np.array([0.0 if p.lump else FLAGS.slight for p in parameters.parameters])
    return (np.abs(factor - 1) > slight) & (open_ | (share < FLAGS.kept))


def _found(p: Parameter, *factors: float) -> str:
    """Factors in words, `0.8 to 1.2`; of a mass that the deck lacks what is added."""
    return " to ".join(
        f"{p.lump * max(a - 1, 0.0) if p.lump else a:.3g}" for a in factors
    )


def _said(p: Parameter, factor: float) -> str:
    return f"{p.name}: {'mass' if p.lump else 'factor'} {_found(p, factor)}"


def form_flags(
    parameters: ParameterSet,
    factor: Float,
    interval: Float,
    share: Float,
    correlation: Float,
) -> tuple[Flag, ...]:
    """A flag for each change that is `unproven`; with others that the test knows only together with
    it, these instead.

    Parameters
    ----------
    factor, interval, share
        As in `unproven`.
    correlation : (p, p) float64
        Of x, posterior.
    """
    flags: list[Flag] = []
    # over parameters: text for people
    for i in np.flatnonzero(unproven(parameters, factor, interval, share)).tolist():
        low, high = interval[i].tolist()
        open_ = low <= 1 <= high
        p = parameters.parameters[i]
        why = []
        if open_:
            why.append(
                f"its interval, {_found(p, low, high)}, holds {'none' if p.lump else 1}"
            )
        if share[i] < FLAGS.kept:
            turned = (
                "turns round" if share[i] < 0 else f"shrinks to {100 * share[i]:.0f} %"
            )
            why.append(f"its change {turned} when some of the modes are left out")
        near = np.setdiff1d(np.flatnonzero(np.abs(correlation[i]) > FLAGS.tied), [i])
        tied = [parameters.names[j] for j in near]
        whence = "it may take up an error of the model's form"
        if open_ and tied:
            whence = (
                f"the test knows it and {', '.join(tied)} together, not each by itself"
            )
        text = f"{_said(p, factor[i])}, but {' and '.join(why)}; {whence}"
        flags.append(Flag(p.name, "form", float(factor[i]), text))
    return tuple(flags)


def least_proven(x: Float, std: Float, level: float) -> int | None:
    """The parameter that is the fewest standard deviations off nominal of those whose interval
    holds it; None where no interval does.

    Its change moves all data together by less than their errors: what these say of it is in its
    standard deviation.

    Parameters
    ----------
    x, std : (p,) float64
        Changes from nominal and their standard deviations.
    level : float
        Probability of the interval.
    """
    ratio = np.abs(x) / np.maximum(std, 1e-300)
    if not ratio.size or ratio.min() > ndtri(0.5 + level / 2):
        return None
    return int(ratio.argmin())
