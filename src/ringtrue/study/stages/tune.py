"""Rigid-body tuning: the suspension to the rigid-body modes of the ambient test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress, part, quiet
from ringtrue.correlation.table import CorrelationTable
from ringtrue.errors import DataError
from ringtrue.model.ports import Linearisation, ObservedModel
from ringtrue.study.objective import target as elastic_target
from ringtrue.study.opened import AtChannels
from ringtrue.study.reference import Reference, reference_modes, rigid_settings, rigid_table
from ringtrue.study.results import (
    ConfigurationsStage,
    ConfiguredTest,
    CorrelateStage,
    TunedConfiguration,
    TuneStage,
)
from ringtrue.study.session import OWN, Session
from ringtrue.study.stages.update import chosen_factors
from ringtrue.updating.gauss_newton import update
from ringtrue.updating.identifiability import plausibility
from ringtrue.updating.problem import Configuration, Problem
from ringtrue.updating.solver import Solution, solve
from ringtrue.updating.strategy import Course, settled
from ringtrue.updating.suspension import Suspended, tune
from ringtrue.updating.target import Target, Weights, match

# a rigid-body mode on springs leaves no room for model discrepancy but the mass distribution
WEIGHTS = Weights(frequency=0.005, mac=0.1, shape=0.1)
# share of an elastic mode's strain energy in the suspension from which on its tuning is told to
# move it
STRAINED = 0.1
ALLOWED = 2.0  # standard deviations that it may be off


def target(session: Session) -> Target:
    """The rigid-body modes of the test.

    Raises
    ------
    DataError
        If there is none.
    """
    found: CorrelateStage = session.get("correlate")
    if not len(found.rigid):
        raise DataError(
            "rigid-body tuning: the test holds no rigid-body mode to tune [[suspension]] to; set "
            "correlate.rigid_below above them, or leave [[suspension]] out"
        )
    return _target(session, found)


def _target(session: Session, found: CorrelateStage | ConfiguredTest) -> Target:
    n = len(found.rigid)
    std = np.fmax(found.rigid_uncertainty.frequency / found.rigid.frequencies, 1e-4)
    gates = rigid_settings(session.config)
    return Target(
        frequencies=found.rigid.frequencies,
        shapes=found.rigid.shapes,
        std=std,
        used=np.ones(n, dtype=bool),
        weights=WEIGHTS,
        pairing=gates,
    )


def suspended(session: Session, progress: Progress) -> AtChannels:
    """The model over the suspension alone, the elastic parameters held at their updated values."""
    found: CorrelateStage = session.get("correlate")
    count = len(session.config.suspensions())
    base = np.concatenate([session.parameters.vector(chosen_factors(session)), np.zeros(count)])
    first = len(session.parameters)
    model = session.suspended(found.rigid.channels, progress)
    return model.with_parameters(range(first, first + count), base)


def tuned(active: ObservedModel, aim: Target, iterations: int, progress: Progress) -> Suspended:
    """Every pairing weighed, from the point that the nearest pairing leads to.

    Test modes that find no partner inside the gates there take no part.
    """
    near = update(active, aim, iterations=iterations)
    used = np.isin(np.arange(aim.used.size), near.residual.pairs[near.residual.used, 0])
    if not used.any():
        raise DataError(
            "rigid-body tuning: no rigid-body mode of the test has a partner in the model; look "
            "at the bounds of "
            "[[suspension]], at the directions of the channels, or at correlate.mac_gate"
        )
    return tune(active, replace(aim, used=used), start=near.x, progress=progress)


@dataclass(frozen=True, slots=True, eq=False)
class _Other:
    """Another configuration whose test holds rigid-body modes and whose deck has part of the
    suspension.
    """

    test: ConfiguredTest
    active: AtChannels
    aim: Target

    def table(self, x: Float, session: Session) -> CorrelationTable:
        """At x (p,) of its part of the suspension."""
        seen = _seen(self.active, x, self.test.rigid.channels)
        return rigid_table(Reference.of(self.test), seen, session.config)


def _others(session: Session, progress: Progress) -> tuple[_Other, ...]:
    """Elastic parameters held at their updated values."""
    if not session.config.configuration:
        return ()
    found: ConfigurationsStage = session.get("configurations")
    known = dict(zip(session.parameters.names, chosen_factors(session).tolist(), strict=True))
    out = []
    for test, model in zip(found.items, session.delivered_models(progress)[1:], strict=True):
        every, mine = model.model.system.parameters, model.parameters
        springs = range(len(mine), len(every))
        if not (len(test.rigid) and len(springs)):
            continue
        base = np.concatenate(
            [mine.vector(np.array([known[n] for n in mine.names])), np.zeros(len(springs))]
        )
        channels = session.channels(test.name)
        rows = np.array([channels.index(c) for c in test.rigid.channels], dtype=np.int64)
        out.append(
            _Other(
                test,
                AtChannels(model.model, rows).with_parameters(springs, base),
                _target(session, test),
            )
        )
    return tuple(out)


def _jointly(
    first: Configuration, start: Float, others: Sequence[_Other], iterations: int
) -> Solution:
    """Over all tests from the point that the study's own leads to."""
    every = (first, *(Configuration(o.active, o.aim, name=o.test.name) for o in others))
    far = solve(Problem(every), start=start, iterations=iterations)
    return settled(Problem(every), Course(iterations=iterations), start=far.y).solution


def disagreeing(model: ObservedModel, aim: Target, x: Float, std: Float) -> tuple[str, ...]:
    """Elastic test modes that strain the suspension and that its tuning puts off, in words.

    Springs of rubber, say, are stiffer at their frequencies; or the tuning stands for another
    error.

    Parameters
    ----------
    model : ObservedModel
        Over the suspension.
    x, std : (p,) float64
        As tuned.
    """
    then, now, out = model.linearise(0 * x), model.linearise(x), list[str]()
    before, after = (dict(match(aim, at)[0].tolist()) for at in (then, now))
    for t in sorted(before | after):  # over modes: text for people
        at, fe = (now, after[t]) if t in after else (then, before[t])
        rate = at.d_lambda[fe] / (2 * (2 * np.pi * at.frequencies[fe]) ** 2)  # ∂ ln f/∂x
        share = float(
            np.maximum(
                2 * rate * model.parameters.factors(at.x) / model.parameters.derivative(at.x), 0.0
            ).sum()
        )
        known = float(
            np.sqrt(aim.weights.frequency**2 + aim.std[t] ** 2 + ((rate * std) ** 2).sum())
        )
        was, off = (_off(aim, p, k, t) for p, k in ((then, before), (now, after)))
        if share <= STRAINED or (
            off is not None and abs(off) <= max(ALLOWED * known, abs(was or 0.0))
        ):
            continue
        told = [f"{100 * d:+.1f} % off" if d is not None else "without partner" for d in (was, off)]
        out.append(
            f"elastic test mode {t + 1} ({aim.frequencies[t]:.4g} Hz) has {100 * share:.0f} % of "
            "its strain energy in "
            f"the suspension and is {told[0]} before and {told[1]} after the tuning, where "
            f"{100 * ALLOWED * known:.1f} "
            "% was to be expected: its springs may be others at that frequency, or stand for "
            "another error"
        )
    return tuple(out)


def _off(aim: Target, at: Linearisation, partner: Mapping[int, int], t: int) -> float | None:
    """Relative deviation of the partner of a test mode; None without one."""
    return float(at.frequencies[partner[t]] / aim.frequencies[t] - 1) if t in partner else None


def _elastic(session: Session, x: Float, std: Float) -> tuple[str, ...]:
    """`disagreeing` of the study's own test."""
    first = len(session.parameters)
    base = np.concatenate([session.parameters.vector(chosen_factors(session)), np.zeros(x.size)])
    every = session.suspended(session.reference(OWN).channels, quiet)
    return disagreeing(
        every.with_parameters(range(first, first + x.size), base), elastic_target(session), x, std
    )


def run(session: Session, progress: Progress) -> TuneStage:
    """Tune the suspension with the elastic parameters held at their updated values.

    Every pairing of the study's own test is weighed; configurations with rigid-body modes join from
    there.
    """
    aim = target(session)
    active = suspended(session, part(progress, 0.0, 0.6))
    others = _others(session, part(progress, 0.6, 0.7))
    limit, parameters = session.config.update.iterations, active.parameters
    found = tuned(active, aim, limit, part(progress, 0.7, 1.0))
    x, std = found.best.x, found.std
    if others:
        used = np.isin(np.arange(aim.used.size), found.best.pairs[:, 0])
        done = _jointly(Configuration(active, replace(aim, used=used)), x, others, limit)
        x, std = done.x, done.std
    factors = parameters.factors(x)
    slope = parameters.derivative(x) / factors
    reference = reference_modes(session.get("identify"), session.config)
    channels = session.get("correlate").rigid.channels
    before, after = (
        rigid_table(reference, _seen(active, at, channels), session.config) for at in (0 * x, x)
    )
    at = dict(zip(parameters.names, x.tolist(), strict=True))
    of = [np.array([at[n] for n in o.active.parameters.names]) for o in others]
    return TuneStage(
        before=before,
        after=after,
        factors=dict(zip(parameters.names, factors.tolist(), strict=True)),
        std=dict(zip(parameters.names, (std * slope).tolist(), strict=True)),
        ambiguity=found.ambiguity(),
        flags=tuple(f.text for f in plausibility(parameters, x, std / parameters.std())),
        others=tuple(
            TunedConfiguration(o.test.name, o.table(0 * v, session), o.table(v, session))
            for o, v in zip(others, of, strict=True)
        ),
        disagreeing=_elastic(session, x, std),
    )


def _seen(active: AtChannels, x: Float, channels: tuple[str, ...]) -> ModeSet:
    point = active.modes(x)
    return ModeSet(
        point.frequencies,
        np.zeros(point.frequencies.size),
        point.shapes,
        channels,
        source="reduced",
    )
