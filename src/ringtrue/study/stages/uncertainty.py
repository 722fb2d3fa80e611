"""How well the chosen parameters are known, and whether bands around the predictions hold what was
measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri, stdtrit

from ringtrue.core.arrays import Bool, Float
from ringtrue.core.iterate import Progress, part
from ringtrue.core.parameters import ParameterSet
from ringtrue.reduction.dense_models import condensed
from ringtrue.shapes import paired_mac
from ringtrue.study.objective import target, terms_of
from ringtrue.study.opened import AtChannels, frequency_error
from ringtrue.study.results import (
    FinalStage,
    FrequencyBands,
    ParameterPosterior,
    PosteriorChains,
    SetResult,
    UncertaintyStage,
)
from ringtrue.study.session import Session, StudyConfiguration
from ringtrue.study.stages.update import as_delivered, other_configurations
from ringtrue.updating.identifiability import Flag, form_flags, kept, plausibility
from ringtrue.updating.problem import Configuration, Problem
from ringtrue.updating.regularisation import left_at
from ringtrue.updating.residuals.modal import Eigenvalues, Quantity
from ringtrue.updating.selection.screening import conflicts, of_parameter
from ringtrue.updating.target import Target, Weights, spans
from ringtrue.updating.uncertainty import (
    Posterior,
    around,
    as_likelihood,
    effective_freedom,
    energy_shares,
    ensemble,
    errors_of_shapes,
    likeness,
    log_posterior,
)
from ringtrue.updating.validation import Held, folds_of, with_discrepancy


@dataclass(frozen=True, slots=True)
class SamplingSizes:
    """How much the sampling may take.

    Attributes
    ----------
    vectors : int
        Vectors of the model that is updated fold by fold and sampled.
    draws : int
        Points around the updated one whose modes it holds, besides those of each parameter by
        itself.
    fewest : int
        Used modes below which none can be left out.
    same_mac : float
        From which on modes of two solvers are the same.
    stored : int
        Draws that are stored.
    """

    vectors: int = 100
    draws: int = 12
    fewest: int = 4
    same_mac: float = 0.8
    stored: int = 400


SIZES = SamplingSizes()


def run(session: Session, progress: Progress) -> UncertaintyStage | None:
    """Discrepancy from modes left out in turn, posterior and bands; None where fewer than four
    modes were used.

    By the embedded solver in any case; None where its modes are not those that another solver has
    delivered.
    """
    c = session.own
    final: FinalStage = session.get("final")
    best = session.best
    asked = session.config.uncertainty
    seed = session.config.study.seed
    aim = target(c)
    chosen = best.factors
    factors = session.updated_factors()

    early = part(progress, 0.0, 0.4)
    every, at = as_delivered(c, session.delivered_models(early)[0], factors, early)
    model, x = as_delivered(c, every, chosen, early)
    if session.engine is not None and not _same_modes(c, model, x):
        return None
    paired = _paired(aim, model, final, x)
    count = int(paired.used.sum())
    if count < SIZES.fewest:
        return None
    small = _near(session, model, x, best.std, np.random.default_rng([seed, 6]))
    first = Configuration(small, paired, terms_of(c, small))
    others = _others(session, best, np.random.default_rng([seed, 8]), early)
    if session.config.update.sharpened:
        w = left_at(Problem((first, *others)), x)
        first, *others = (
            o.weighed(w.frequency, w.mac, w.independent) for o in (first, *others)
        )
    likely, held = with_discrepancy(
        first,
        folds_of(paired.used, min(asked.folds, count)),
        start=x,
        others=tuple(others),
        progress=part(progress, 0.4, 0.8),
    )
    found = likely.target.weights
    many = errors_of_shapes(
        replace(paired, used=np.ones_like(paired.used)), model.modes(x)
    )

    # with errors as found; those of the other configurations are taken to be like those of the
    # first
    own = Configuration(every, paired, terms_of(c, every))
    whole = (own, *other_configurations(session, factors, early))
    problem = Problem(_likelihoods(whole, found, many))
    p = problem.parameters
    point = problem.evaluate(p.vector(factors))
    freedom = _freedom(session, every, at, held, likely.target)
    slope = point.points[0].now.d_lambda
    among = around(
        problem, point, _may_be_off(session, p, best.parameters), freedom=freedom
    )
    posterior = among.take(every.parameters.at(best.parameters))
    if aim.frequency_only:
        held = replace(held, mac=np.full(held.mac.size, np.nan))
    result = UncertaintyStage(
        posterior=_parameters(posterior, asked.level),
        bands=_bands(session, among, slope, held, found),
        level=asked.level,
        discrepancy=np.array(
            [found.frequency, np.nan if aim.frequency_only else found.mac]
        ),
        assumed=np.array([aim.weights.frequency, aim.weights.mac]),
        held=held,
        flags=_flags(posterior, held, asked.level),
    )
    if not asked.samples:
        return result
    sampled = Problem(_likelihoods((likely, *others), found, many))
    chains = _sampled(session, sampled, posterior, part(progress, 0.8, 1.0))
    return replace(result, chains=chains)


def _same_modes(c: StudyConfiguration, model: AtChannels, x: Float) -> bool:
    """Whether the paired modes of the delivered deck have the same place, shape and frequency in
    the model.

    Frequencies within the error that the updating allows a model: else what fits the test is not
    what was delivered.
    """
    final: FinalStage = c.session.get("final")
    now = model.modes(x)
    at = final.table.pairing.b
    if at.size and at.max() >= now.frequencies.size:
        return False
    rows = [final.observed.channels.index(n) for n in c.reference.elastic.channels]
    mac = paired_mac(now.shapes[:, at], final.observed.shapes[rows][:, at])
    error = frequency_error(now.frequencies[at], final.observed.frequencies[at])
    return bool(
        (mac >= SIZES.same_mac).all()
        and error <= c.session.config.update.frequency_error
    )


def _others(
    session: Session, best: SetResult, rng: np.random.Generator, progress: Progress
) -> list[Configuration]:
    """The other configurations on the modes around the updated point."""
    std = dict(zip(best.parameters, best.std.tolist(), strict=True))
    out = []
    for one in other_configurations(session, best.factors, progress):
        assert isinstance(one.model, AtChannels)
        p = one.model.parameters
        x = p.vector(best.factors)
        near = _near(session, one.model, x, np.array([std[n] for n in p.names]), rng)
        out.append(replace(one, model=near))
    return out


def _may_be_off(session: Session, p: ParameterSet, chosen: Sequence[str]) -> Bool:
    """Candidates that may be off: the chosen ones, and others that were not chosen.

    Those that scale a field of a chosen one are held: it stands for them. Masses that the deck may
    not have elsewhere are held, too: that something was left out is rare.
    """
    mine = np.isin(p.names, list(chosen))
    model = session.remodelled.model
    fields = [of_parameter(model, one) for one in p.parameters]
    same = conflicts(model, fields)[:, mine].any(axis=1)
    rare = np.array([one.lump > 0 for one in p.parameters], dtype=np.bool_)
    return mine | ~(same | rare)


def _freedom(
    session: Session, every: AtChannels, x: Float, held: Held, likely: Target
) -> float:
    """Degrees of freedom that the size of the errors is known with, those of the test being known.

    Errors of form are the same in modes with similar strains and motions: few are independent.
    """
    final: FinalStage = session.get("final")
    pairing = final.table.pairing
    lam, shapes = every.model.coordinates(x)
    seen = np.isfinite(held.predicted[pairing.a]) & (pairing.b < lam.size)
    vectors = every.model.basis.vectors @ shapes[:, pairing.b[seen]]
    of_form = likely.weights.frequency**2
    share = of_form / (of_form + float(np.mean(likely.std**2)))
    opened = session.remodelled
    energies = energy_shares(opened.model, opened.analysis.system, vectors)
    return effective_freedom(likeness(energies)) / share**2


def _likelihoods(
    configurations: Sequence[Configuration], found: Weights, independent: float
) -> tuple[Configuration, ...]:
    """The same with weights that are the inverse covariance of the residuals."""
    out = []
    for c in configurations:
        c = c.weighed(found.frequency, found.mac)
        if c.target.weights.shape > 0:
            made = as_likelihood(c, found.frequency, found.mac, independent=independent)
        else:
            rest = tuple(t for t in c.terms if t.quantity is Quantity.OTHER)
            made = replace(c, terms=(Eigenvalues(found.frequency), *rest))
        out.append(made)
    return tuple(out)


def _paired(aim: Target, model: AtChannels, final: FinalStage, x: Float) -> Target:
    """The pairs of the delivered deck for good; used modes that the updating has doubted take no
    part.
    """
    now = model.linearise(x)
    pairs = np.stack([final.table.pairing.a, final.table.pairing.b], axis=1)
    pairs = pairs[pairs[:, 1] < now.frequencies.size]
    used = aim.settled(now).used & np.isin(np.arange(aim.used.size), pairs[:, 0])
    of = spans(aim.frequencies, used, pairs, now, aim.pairing)
    return replace(aim, used=used, fixed=(pairs, tuple(s.held() for s in of)))


def _near(
    session: Session, model: AtChannels, x: Float, std: Float, rng: np.random.Generator
) -> AtChannels:
    """The model on its modes around a point; as it is where more than modes was measured."""
    if session.config.residual:
        return model
    low, high = model.parameters.bounds()
    reach = np.maximum(3.0 * std, 0.1)  # three standard deviations, 10 % at least
    draws = reach * rng.standard_normal((SIZES.draws, x.size))
    steps = [np.zeros(x.size), *np.diag(reach), *np.diag(-reach), *draws]
    points = [np.clip(x + s, low, high) for s in steps]
    size = max(SIZES.vectors, 2 * model.model.count)
    return replace(model, model=condensed(model.model, points, size))


def _bands(
    session: Session, among: Posterior, slope: Float, held: Held, found: Weights
) -> FrequencyBands:
    """Where the measured frequencies are expected; `slope` is ∂λ/∂x (mode, parameter)."""
    final: FinalStage = session.get("final")
    level = session.config.uncertainty.level
    aim = target(session.own)
    pairing = final.table.pairing
    f = np.full(aim.frequencies.size, np.nan)
    f[pairing.a] = final.observed.frequencies[pairing.b]
    computed = pairing.b < slope.shape[0]
    test = pairing.a[computed]
    fe = pairing.b[computed]
    rows = slope[fe] / (8 * np.pi**2 * f[test] ** 2)[:, None] @ among.link
    parts = np.full((f.size, 3), np.nan)
    parts[test, 0] = np.sqrt(np.einsum("mp,pq,mq->m", rows, among.covariance, rows))
    parts[:, 1] = aim.std
    parts[:, 2] = np.where(np.isfinite(held.model_std), held.model_std, found.frequency)
    reach = (
        float(stdtrit(held.freedom, 0.5 + level / 2))
        * np.sqrt((parts**2).sum(axis=1))
        * f
    )
    band = np.stack([f - reach, f + reach], axis=1)
    return FrequencyBands(
        test=aim.frequencies,
        predicted=f,
        band=band,
        parts=parts,
        used=aim.used,
        inside=(band[:, 0] <= aim.frequencies) & (aim.frequencies <= band[:, 1]),
    )


def _parameters(posterior: Posterior, level: float) -> ParameterPosterior:
    p = posterior.parameters
    low, high = p.bounds()
    reach = float(ndtri(0.5 + level / 2)) * p.std()
    before = p.factors(np.maximum(-reach, low)), p.factors(np.minimum(reach, high))
    return ParameterPosterior(
        parameters=p,
        factor=p.factors(posterior.x),
        std=posterior.std,
        interval=posterior.interval(level),
        prior=np.stack(before, axis=1),
        ratio=posterior.ratio,
        moved=posterior.moved,
        correlation=posterior.correlation(),
    )


def _flags(posterior: Posterior, held: Held, level: float) -> tuple[Flag, ...]:
    """Parameters that are not plausible."""
    p = posterior.parameters
    x = posterior.x
    of_form = form_flags(
        p,
        p.factors(x),
        posterior.interval(level),
        kept(x, held.ends),
        posterior.correlation(),
    )
    return (*plausibility(p, x, posterior.ratio), *of_form)


def _sampled(
    session: Session, problem: Problem, posterior: Posterior, progress: Progress
) -> PosteriorChains:
    """Walkers from the normal approximation."""
    asked = session.config.uncertainty
    rng = np.random.default_rng([session.config.study.seed, 7])
    walkers = 2 * problem.size + 2
    steps = max(-(-asked.samples // walkers), 4)
    start = posterior.sample(walkers, rng)
    density = log_posterior(problem)
    # half as many steps again are thrown away first
    chains = ensemble(density, start, steps, rng, burn=steps // 2, progress=progress)
    p = posterior.parameters
    every = chains.flat()
    band = chains.interval(asked.level)
    return PosteriorChains(
        draws=np.stack(
            [p.factors(x) for x in every[:: -(-len(every) // SIZES.stored)]]
        ),
        sampled=np.stack([p.factors(band[:, 0]), p.factors(band[:, 1])], axis=1),
        acceptance=chains.acceptance,
        independent=chains.size,
        converged=chains.converged,
    )
