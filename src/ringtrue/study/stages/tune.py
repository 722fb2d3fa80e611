"""Rigid-body tuning: the suspension to the rigid-body modes of the ambient test."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.core.modes import ModeSet
from ringtrue.correlation.table import CorrelationTable
from ringtrue.errors import DataError
from ringtrue.model.ports import Linearisation, ObservedModel
from ringtrue.study.objective import target as elastic_target
from ringtrue.study.opened import AtChannels
from ringtrue.study.reference import rigid_settings, rigid_table
from ringtrue.study.results import TunedConfiguration, TuneStage
from ringtrue.study.session import Session, StudyConfiguration
from ringtrue.updating.identifiability import plausibility
from ringtrue.updating.problem import Configuration, Problem, single
from ringtrue.updating.solver import solve
from ringtrue.updating.strategy import Course, settled
from ringtrue.updating.suspension import Suspended, tune
from ringtrue.updating.target import Target, Weights, match

# a rigid-body mode on springs leaves no room for model discrepancy but the mass distribution
WEIGHTS = Weights(frequency=0.005, mac=0.1, shape=0.1)
# share of an elastic mode's strain energy in the suspension from which on its tuning is expected to
# move it
STRAINED = 0.1


def target(c: StudyConfiguration) -> Target:
    """The rigid-body modes of a test.

    Raises
    ------
    DataError
        If there is none.
    """
    rigid = c.reference.rigid
    if not len(rigid):
        raise DataError(
            "rigid-body tuning: the test holds no rigid-body mode to tune [[suspension]] to; set "
            "correlate.rigid_below above them, or leave [[suspension]] out"
        )
    return Target(
        frequencies=rigid.frequencies,
        shapes=rigid.shapes,
        std=np.fmax(c.reference.rigid_std.frequency / rigid.frequencies, 1e-4),
        used=np.ones(len(rigid), dtype=bool),
        weights=WEIGHTS,
        pairing=rigid_settings(c.session.config),
    )


def suspended(c: StudyConfiguration, channels: tuple[str, ...], progress: Progress) -> AtChannels:
    """The model of a configuration over its suspension alone, the elastic parameters held at their
    updated values.
    """
    position = c.session.configurations.index(c)
    model = c.session.delivered_models(progress)[position]
    known = c.session.updated_factors()
    mine = model.parameters
    every = model.model.system.parameters
    springs = range(len(mine), len(every))
    held = mine.vector(np.array([known[n] for n in mine.names]))
    base = np.concatenate([held, np.zeros(len(springs))])
    return AtChannels(model.model, c.rows(channels)).with_parameters(springs, base)


def tuned(active: ObservedModel, aim: Target, iterations: int, progress: Progress) -> Suspended:
    """Every pairing weighed, from the point that the nearest pairing leads to.

    Test modes that find no partner inside the gates there take no part.
    """
    near = solve(single(active, aim), iterations=iterations)
    used = np.isin(np.arange(aim.used.size), near.end.points[0].pairs[:, 0])
    if not used.any():
        raise DataError(
            "rigid-body tuning: no rigid-body mode of the test has a partner in the model; look "
            "at the bounds of "
            "[[suspension]], at the directions of the channels, or at correlate.mac_gate"
        )
    return tune(active, replace(aim, used=used), start=near.x, progress=progress)


@dataclass(frozen=True, slots=True, eq=False)
class RigidTest:
    """A configuration over its suspension, and the rigid-body modes of its test."""

    configuration: StudyConfiguration
    model: AtChannels
    target: Target

    @classmethod
    def of(cls, c: StudyConfiguration, progress: Progress) -> RigidTest:
        """With its elastic parameters at their updated values."""
        model = suspended(c, c.reference.rigid.channels, progress)
        return cls(c, model, target(c))

    def table(self, x: dict[str, float]) -> CorrelationTable:
        """At x of the suspension."""
        point = self.model.modes(np.array([x[n] for n in self.model.parameters.names]))
        reference = self.configuration.reference
        seen = ModeSet(
            point.frequencies,
            np.zeros(point.frequencies.size),
            point.shapes,
            reference.rigid.channels,
            source="reduced",
        )
        return rigid_table(reference, seen, self.configuration.session.config)


def _others(session: Session, progress: Progress) -> list[RigidTest]:
    """Further configurations whose test holds rigid-body modes and whose deck has part of the
    suspension.
    """
    with_modes = [c for c in session.others if len(c.reference.rigid)]
    tests = [RigidTest.of(c, progress) for c in with_modes]
    return [t for t in tests if len(t.model.parameters)]


def disagreeing(model: ObservedModel, aim: Target, x: Float, std: Float) -> tuple[str, ...]:
    """Elastic test modes that strain the suspension and that its tuning puts off, in words.

    Springs of rubber, for example, are stiffer at their frequencies; or the tuning stands for
    another error.

    Parameters
    ----------
    model : ObservedModel
        Over the suspension.
    x, std : (p,) float64
        As tuned.
    """
    p = model.parameters
    then = model.linearise(0 * x)
    now = model.linearise(x)
    before, after = (dict(match(aim, at)[0].tolist()) for at in (then, now))
    out = []
    for t in sorted(before | after):  # over modes: text for people
        at, fe = (now, after[t]) if t in after else (then, before[t])
        rate = at.d_lambda[fe] / (2 * (2 * np.pi * at.frequencies[fe]) ** 2)  # ∂ ln f/∂x
        shares = 2 * rate * p.factors(at.x) / p.derivative(at.x)
        share = float(np.maximum(shares, 0.0).sum())
        variance = aim.weights.frequency**2 + aim.std[t] ** 2 + ((rate * std) ** 2).sum()
        allowed = 2.0 * float(np.sqrt(variance))  # standard deviations that it may be off
        was = _deviation(aim, then, t, before.get(t))
        off = _deviation(aim, now, t, after.get(t))
        if share <= STRAINED or (off is not None and abs(off) <= max(allowed, abs(was or 0.0))):
            continue
        states = [
            f"{100 * d:+.1f} % off" if d is not None else "without partner" for d in (was, off)
        ]
        out.append(
            f"elastic test mode {t + 1} ({aim.frequencies[t]:.4g} Hz) has {100 * share:.0f} % of "
            "its strain energy in "
            f"the suspension and is {states[0]} before and {states[1]} after the tuning, where "
            f"{100 * allowed:.1f} "
            "% was to be expected: its springs may be others at that frequency, or stand for "
            "another error"
        )
    return tuple(out)


def _deviation(aim: Target, at: Linearisation, test: int, partner: int | None) -> float | None:
    """Relative deviation of the partner of a test mode; None without one."""
    if partner is None:
        return None
    return float(at.frequencies[partner] / aim.frequencies[test] - 1)


def run(session: Session, progress: Progress) -> TuneStage:
    """Tune the suspension with the elastic parameters held at their updated values.

    Every pairing of the study's own test is weighed; configurations with rigid-body modes join from
    there.
    """
    own = RigidTest.of(session.own, part(progress, 0.0, 0.6))
    others = _others(session, part(progress, 0.6, 0.7))
    limit = session.config.update.iterations
    parameters = own.model.parameters
    found = tuned(own.model, own.target, limit, part(progress, 0.7, 1.0))
    x = found.best.x
    std = found.std
    if others:  # over all tests, from the point that the study's own leads to
        used = np.isin(np.arange(own.target.used.size), found.best.pairs[:, 0])
        first = Configuration(own.model, replace(own.target, used=used))
        more = (Configuration(o.model, o.target, name=o.configuration.name) for o in others)
        problem = Problem((first, *more))
        far = solve(problem, start=x, iterations=limit)
        done = settled(problem, Course(iterations=limit), start=far.y).solution
        x = done.x
        std = done.std
    factors = parameters.factors(x)
    relative = std * parameters.derivative(x) / factors
    names = parameters.names
    start = dict.fromkeys(names, 0.0)
    end = dict(zip(names, x.tolist(), strict=True))
    elastic = suspended(session.own, session.own.reference.elastic.channels, quiet)
    return TuneStage(
        before=own.table(start),
        after=own.table(end),
        factors=dict(zip(names, factors.tolist(), strict=True)),
        std=dict(zip(names, relative.tolist(), strict=True)),
        ambiguity=found.ambiguity(),
        flags=tuple(f.text for f in plausibility(parameters, x, std / parameters.std())),
        others=tuple(
            TunedConfiguration(o.configuration.name, o.table(start), o.table(end)) for o in others
        ),
        disagreeing=disagreeing(elastic, elastic_target(session.own), x, std),
    )
