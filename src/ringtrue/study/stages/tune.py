"""Rigid-body tuning: the suspension to the rigid-body modes of the ambient test."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.iterate import Progress, part
from ringtrue.core.modes import ModeSet
from ringtrue.correlation.table import CorrelationTable
from ringtrue.errors import DataError
from ringtrue.model.ports import ObservedModel
from ringtrue.study.opened import AtChannels
from ringtrue.study.reference import rigid_settings, rigid_table
from ringtrue.study.results import TunedConfiguration, TuneStage
from ringtrue.study.session import Session, StudyConfiguration
from ringtrue.updating.identifiability import plausibility
from ringtrue.updating.problem import Configuration, Problem, single
from ringtrue.updating.solver import solve
from ringtrue.updating.strategy import Course, settled
from ringtrue.updating.suspension import Suspended, tune
from ringtrue.updating.target import Target, Weights

# a rigid-body mode on springs leaves no room for model discrepancy but the mass distribution
WEIGHTS = Weights(frequency=0.005, mac=0.1, shape=0.1)


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


def suspended(
    c: StudyConfiguration, channels: tuple[str, ...], progress: Progress
) -> AtChannels:
    """The model of a configuration over its suspension alone, the elastic parameters held at their
    updated values.
    """
    position = c.session.configurations.index(c)
    model = c.session.delivered_models(progress)[position]
    known = c.session.updated_factors()
    mine = model.parameters
    every = model.model.system.parameters
    springs = range(len(mine), len(every))
    held = mine.vector(known)
    base = np.concatenate([held, np.zeros(len(springs))])
    return AtChannels(model.model, c.rows(channels)).with_parameters(springs, base)


def tuned(
    active: ObservedModel, aim: Target, iterations: int, progress: Progress
) -> Suspended:
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


def run(session: Session, progress: Progress) -> TuneStage:
    """Tune the suspension with the elastic parameters held at their updated values.

    Every pairing of the study's own test is weighed; configurations with rigid-body modes join from
    there.
    """
    own = RigidTest.of(session.own, part(progress, 0.0, 0.6))
    early = part(progress, 0.6, 0.7)
    tests = [RigidTest.of(c, early) for c in session.others if len(c.reference.rigid)]
    # with part of the suspension
    others = [test for test in tests if len(test.model.parameters)]
    limit = session.config.update.iterations
    parameters = own.model.parameters
    found = tuned(own.model, own.target, limit, part(progress, 0.7, 1.0))
    x = found.best.x
    std = found.std
    if others:  # over all tests, from the point that the study's own leads to
        used = np.isin(np.arange(own.target.used.size), found.best.pairs[:, 0])
        first = Configuration(own.model, replace(own.target, used=used))
        more = (
            Configuration(o.model, o.target, name=o.configuration.name) for o in others
        )
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
    return TuneStage(
        before=own.table(start),
        after=own.table(end),
        factors=dict(zip(names, factors.tolist(), strict=True)),
        std=dict(zip(names, relative.tolist(), strict=True)),
        ambiguity=found.ambiguity(),
        flags=tuple(
            f.text for f in plausibility(parameters, x, std / parameters.std())
        ),
        others=tuple(
            TunedConfiguration(o.configuration.name, o.table(start), o.table(end))
            for o in others
        ),
    )
