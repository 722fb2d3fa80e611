"""How well the chosen parameters are known, and whether bands around the predictions hold what was
measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri, stdtrit

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress, part
from ringtrue.reduction.parametric import condensed
from ringtrue.shapes.mac import paired_mac
from ringtrue.study.objective import target, terms_of
from ringtrue.study.opened import AtChannels, frequency_error
from ringtrue.study.results import (
    FinalStage,
    FrequencyBands,
    ParameterPosterior,
    PosteriorChains,
    SetResult,
    UncertaintyStage,
    UpdateStage,
)
from ringtrue.study.session import OWN, Session
from ringtrue.study.stages.update_set import as_delivered, other_configurations
from ringtrue.updating.identifiability import form_flags, kept, plausibility
from ringtrue.updating.problem import Configuration, Problem
from ringtrue.updating.regularisation import left_at
from ringtrue.updating.residuals.modal import Eigenvalues, Weighted
from ringtrue.updating.selection.screening import conflicts, of_parameter
from ringtrue.updating.target import Target, Weights, spans
from ringtrue.updating.uncertainty import (
    Chains,
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

SMALL = 100  # vectors of the model that is updated fold by fold and sampled
# points around the updated one whose modes it holds, beside those of each parameter by itself
DRAWS = 12
REACH, LEAST_REACH = 3.0, 0.1  # how far these points lie apart: standard deviations, and x
FEWEST = 4  # used modes below which none can be left out
ALIKE = 0.8  # MAC from which on modes of two solvers are the same
KEPT = 400  # draws that are stored
BURN = 0.5  # steps that are thrown away, over those kept


def run(session: Session, progress: Progress) -> UncertaintyStage | None:
    """Discrepancy from modes left out in turn, posterior and bands; None where fewer than four
    modes were used.

    By the embedded solver in any case; None where its modes are not those that another solver has
    delivered.
    """
    done: UpdateStage = session.get("update")
    final: FinalStage = session.get("final")
    best, asked, aim = done.sets[done.chosen], session.config.uncertainty, target(session)
    factor = dict(zip(best.parameters, best.factor.tolist(), strict=True))
    whole = dict.fromkeys(session.parameters.names, 1.0) | factor

    early = part(progress, 0.0, 0.4)
    every, at = as_delivered(
        session, session.delivered_models(early)[0], whole, final.observed.frequencies, early
    )
    model, x = as_delivered(session, every, factor, final.observed.frequencies, early)
    if session.engine is not None and not _same(session, model, final, x):
        return None
    paired = _paired(aim, model, final, x)
    count = int(paired.used.sum())
    if count < FEWEST:
        return None
    small = _near(
        session, model, x, best.std, np.random.default_rng([session.config.study.seed, 6])
    )
    first = Configuration(small, paired, terms_of(session, OWN, small, session.config.update))
    others = _others(
        session, best, rng=np.random.default_rng([session.config.study.seed, 8]), progress=progress
    )
    if session.config.update.sharpened:
        w = left_at(Problem((first, *others)), x)
        first, others = _weighed(first, w), tuple(_weighed(c, w) for c in others)
    likely, held = with_discrepancy(
        first,
        folds_of(paired.used, min(asked.folds, count)),
        start=x,
        others=others,
        progress=part(progress, 0.4, 0.8),
    )
    full = (
        Configuration(every, paired, terms_of(session, OWN, every, session.config.update)),
        *_whole(session, best, whole, early),
    )
    freedom = _freedom(session, every, x=at, final=final, held=held, likely=likely.target)
    many = errors_of_shapes(replace(paired, used=np.ones_like(paired.used)), model.modes(x))
    among, slope = _posterior(
        session,
        full,
        found=likely.target.weights,
        factor=whole,
        chosen=best.parameters,
        freedom=freedom,
        independent=many,
    )
    posterior = among.take([every.parameters.names.index(n) for n in best.parameters])
    told = _result(
        posterior,
        among,
        aim=aim,
        likely=likely.target,
        slope=slope,
        final=final,
        held=held,
        level=asked.level,
    )
    if not asked.samples:
        return told
    rng = np.random.default_rng([session.config.study.seed, 7])
    w = likely.target.weights
    problem = Problem(
        tuple(_likelihood(c.weighed(w.frequency, w.mac), many) for c in (likely, *others))
    )
    chains = _sampled(problem, posterior, asked.samples, rng, part(progress, 0.8, 1.0))
    return _with_draws(told, chains, posterior.parameters)


def _weighed(c: Configuration, w: Weights) -> Configuration:
    return c.weighed(w.frequency, w.mac, w.independent)


def _same(session: Session, model: AtChannels, final: FinalStage, x: Float) -> bool:
    """Whether the paired modes of the delivered deck have the same place, shape and frequency in
    the model.

    Frequencies within the error that the updating allows a model: else what fits the test is not
    what was delivered.
    """
    now, at = model.modes(x), final.table.pairing.b
    if at.size and at.max() >= now.frequencies.size:
        return False
    rows = [final.observed.channels.index(c) for c in session.reference(OWN).channels]
    like = paired_mac(now.shapes[:, at], final.observed.shapes[rows][:, at]) >= ALIKE
    error = frequency_error(now.frequencies[at], final.observed.frequencies[at])
    return bool(like.all() and error <= session.config.update.frequency_error)


def _others(
    session: Session, best: SetResult, rng: np.random.Generator, progress: Progress
) -> tuple[Configuration, ...]:
    """The other configurations on the modes around the updated point."""
    std, out = dict(zip(best.parameters, best.std.tolist(), strict=True)), []
    for c in other_configurations(session, best, progress):
        assert isinstance(c.model, AtChannels)
        p = c.model.parameters
        factor = np.array([best.factor[best.parameters.index(n)] for n in p.names])
        near = _near(session, c.model, p.vector(factor), np.array([std[n] for n in p.names]), rng)
        out.append(replace(c, model=near))
    return tuple(out)


def _whole(
    session: Session, best: SetResult, factor: Mapping[str, float], progress: Progress
) -> tuple[Configuration, ...]:
    """The other configurations over all candidates."""
    return other_configurations(
        session,
        replace(best, parameters=tuple(factor), factor=np.array(list(factor.values()))),
        progress,
    )


def _posterior(
    session: Session,
    configurations: tuple[Configuration, ...],
    found: Weights,
    factor: Mapping[str, float],
    chosen: Sequence[str],
    freedom: float,
    independent: float,
) -> tuple[Posterior, Float]:
    """About the delivered point, with errors as found, where the candidates that were not chosen
    may be off, too.

    Those that scale a field of a chosen one are held: it stands for them. Masses that the deck may
    lack elsewhere are held, too: that something was left out is rare. The errors of the other
    configurations are taken to be like those of the first, the deck of the study.

    Returns
    -------
    posterior : Posterior
        Of all candidates.
    slope : (m, p) float64
        ∂λ/∂x of the modes of the first.
    """
    problem = Problem(
        tuple(
            _likelihood(c.weighed(found.frequency, found.mac), independent) for c in configurations
        )
    )
    p, model = problem.parameters, session.remodelled.model
    at = problem.evaluate(p.vector(np.array([factor[n] for n in p.names])))
    mine = np.isin(p.names, list(chosen))
    same = conflicts(model, [of_parameter(model, one) for one in p.parameters])[:, mine].any(axis=1)
    rare = np.array([one.lump > 0 for one in p.parameters], dtype=np.bool_)
    return around(problem, at, mine | ~(same | rare), freedom=freedom), at.points[0].now.d_lambda


def _freedom(
    session: Session, every: AtChannels, x: Float, final: FinalStage, held: Held, likely: Target
) -> float:
    """Degrees of freedom that the size of the errors is known with, those of the test being known.

    Errors of form are alike in modes that strain and move alike: few are independent.
    """
    pairing, (lam, shapes) = final.table.pairing, every.model.coordinates(x)
    seen = np.isfinite(held.predicted[pairing.a]) & (pairing.b < lam.size)
    vectors = every.model.basis.vectors @ shapes[:, pairing.b[seen]]
    of_form = likely.weights.frequency**2
    share = of_form / (of_form + float(np.mean(likely.std**2)))
    opened = session.remodelled
    return (
        effective_freedom(likeness(energy_shares(opened.model, opened.analysis.system, vectors)))
        / share**2
    )


def _likelihood(found: Configuration, independent: float) -> Configuration:
    """The same with weights that are the inverse covariance of the residuals."""
    w = found.target.weights
    if w.shape > 0:
        return as_likelihood(found, w.frequency, w.mac, independent=independent)
    rest = tuple(t for t in found.terms if isinstance(t, Weighted))
    return replace(found, terms=(Eigenvalues(w.frequency), *rest))


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
    reach = np.maximum(REACH * std, LEAST_REACH)
    steps = [
        np.zeros(x.size),
        *np.diag(reach),
        *np.diag(-reach),
        *(reach * rng.standard_normal((DRAWS, x.size))),
    ]
    size = max(SMALL, 2 * model.model.count)
    return replace(
        model, model=condensed(model.model, [np.clip(x + s, low, high) for s in steps], size)
    )


def _result(
    posterior: Posterior,
    among: Posterior,
    aim: Target,
    likely: Target,
    slope: Float,
    final: FinalStage,
    held: Held,
    level: float,
) -> UncertaintyStage:
    p, pairing = posterior.parameters, final.table.pairing
    f = np.full(aim.frequencies.size, np.nan)
    f[pairing.a] = final.observed.frequencies[pairing.b]
    computed = pairing.b < slope.shape[0]
    rows = (
        slope[pairing.b[computed]]
        / (8 * np.pi**2 * f[pairing.a[computed]] ** 2)[:, None]
        @ among.link
    )
    parts = np.full((f.size, 3), np.nan)
    parts[pairing.a[computed], 0] = np.sqrt(np.einsum("mp,pq,mq->m", rows, among.covariance, rows))
    parts[:, 1], parts[:, 2] = (
        aim.std,
        np.where(np.isfinite(held.model_std), held.model_std, likely.weights.frequency),
    )
    reach = float(stdtrit(held.freedom, 0.5 + level / 2)) * np.sqrt((parts**2).sum(axis=1)) * f
    band = np.stack([f - reach, f + reach], axis=1)
    factor, interval = p.factors(posterior.x), posterior.interval(level)
    flags = plausibility(p, posterior.x, posterior.ratio) + form_flags(
        p, factor, interval, kept(posterior.x, held.ends), posterior.correlation()
    )
    if aim.lent:
        held = replace(held, mac=np.full(held.mac.size, np.nan))
    known = ParameterPosterior(
        parameters=p,
        factor=factor,
        std=posterior.std,
        interval=interval,
        prior=_prior(p, level),
        ratio=posterior.ratio,
        moved=posterior.moved,
        correlation=posterior.correlation(),
    )
    bands = FrequencyBands(
        test=aim.frequencies,
        predicted=f,
        band=band,
        parts=parts,
        used=aim.used,
        inside=(band[:, 0] <= aim.frequencies) & (aim.frequencies <= band[:, 1]),
    )
    errors = likely.weights.frequency, np.nan if aim.lent else likely.weights.mac
    return UncertaintyStage(
        posterior=known,
        bands=bands,
        level=level,
        discrepancy=np.array(errors),
        assumed=np.array([aim.weights.frequency, aim.weights.mac]),
        held=held,
        flags=tuple(flags),
    )


def _prior(p: ParameterSet, level: float) -> Float:
    """Intervals of the factors before the test, cut at the bounds, (p, 2)."""
    low, high = p.bounds()
    reach = float(ndtri(0.5 + level / 2)) * p.std()
    return np.stack(
        [p.factors(np.maximum(-reach, low)), p.factors(np.minimum(reach, high))], axis=1
    )


def _sampled(
    problem: Problem,
    posterior: Posterior,
    samples: int,
    rng: np.random.Generator,
    progress: Progress,
) -> Chains:
    """Walkers from the normal approximation."""
    walkers = 2 * problem.size + 2
    steps = max(-(-samples // walkers), 4)
    start = posterior.sample(walkers, rng)
    return ensemble(
        log_posterior(problem), start, steps, rng, burn=int(BURN * steps), progress=progress
    )


def _with_draws(told: UncertaintyStage, chains: Chains, p: ParameterSet) -> UncertaintyStage:
    every = chains.flat()
    band = chains.interval(told.level)
    samples = PosteriorChains(
        draws=np.stack([p.factors(x) for x in every[:: -(-len(every) // KEPT)]]),
        sampled=np.stack([p.factors(band[:, 0]), p.factors(band[:, 1])], axis=1),
        acceptance=chains.acceptance,
        independent=chains.size,
        converged=chains.converged,
    )
    return replace(told, chains=samples)
