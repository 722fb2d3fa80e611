"""What is tried before anything runs: factors of a study's model, and points of its test plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.display import Displayed
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.signals import FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.table import CorrelationTable
from ringtrue.eigen.eigenpairs import frequencies
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.model.ports import Linearisation
from ringtrue.planning.exciters import LEAST_REACH, reached
from ringtrue.planning.sensors import worst_sensor_loss
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.reduction.response import flexibility, with_responses
from ringtrue.shapes import auto_mac, worst_off_diagonal
from ringtrue.study.config_sections import PlanSection
from ringtrue.study.evidence import like_measured
from ringtrue.study.objective import problem_of
from ringtrue.study.opened import AtChannels
from ringtrue.study.planned_test import PlanProblem
from ringtrue.study.reference import elastic_edge, elastic_table
from ringtrue.study.results import CorrelateStage, ModelStage
from ringtrue.study.scene import translations
from ringtrue.study.session import Session
from ringtrue.study.stages.plan import plan_problem
from ringtrue.study.synthesis import damping_of, measured_frfs
from ringtrue.updating.problem import Problem


@dataclass(frozen=True, eq=False)
class Trial(Displayed):
    """The model of a study at some factors, against the test.

    Attributes
    ----------
    factors : (p,) float64
        Of all candidates.
    modes : ModeSet
        At the channels of the test.
    pairs : CorrelationTable
        Its `mac` holds all combinations.
    """

    UNITS: ClassVar[Mapping[str, str]] = {}

    factors: Float
    modes: ModeSet
    pairs: CorrelationTable


class TrialModel:
    """The reduced model of a study over its candidates: a trial takes milliseconds.

    Attributes
    ----------
    parameters : ParameterSet
        The candidates.
    """

    def __init__(self, session: Session, model: AtChannels) -> None:
        self.parameters: ParameterSet = session.parameters
        self._session = session
        self._model = model
        self._last: tuple[bytes, Trial] | None = None

    def at(self, factors: Mapping[str, float]) -> Trial:
        """The model at factors by the names of candidates; the others have 1.

        Raises
        ------
        ConfigError
            If there is no such candidate, or a factor is outside of its bounds.
        """
        x = self._point(factors)
        if self._last is None or self._last[0] != x.tobytes():
            self._last = x.tobytes(), self._trial(self._model.modes(x))
        return self._last[1]

    def full(self, factors: Mapping[str, float]) -> Trial:
        """The same by a full solution, which takes as long as the modes of the deck."""
        _, truth = self._model.enrich(self._point(factors))
        return self._trial(truth)

    def error(self, factors: Mapping[str, float]) -> float:
        """An estimate of the largest relative frequency error of `at`."""
        return self._model.model.error(self._point(factors))

    def objective(self, factors: Mapping[str, float]) -> float:
        """J: the objective of the updating over all candidates, with the settings of [update]."""
        return self._problem.cost(self._point(factors))

    def shape(self, factors: Mapping[str, float], mode: int) -> ModeSet:
        """One mode, from 0, at the translations of the nodes that are drawn, X Y Z node by node."""
        lam, y = self._model.model.coordinates(self._point(factors))
        if not 0 <= mode < lam.size:
            raise ConfigError(f"mode {mode}: allowed are 0 to {lam.size - 1}")
        vectors, labels = self._drawn
        return ModeSet(
            frequencies=frequencies(lam[[mode]]),
            damping=np.zeros(1),
            shapes=vectors @ y[:, [mode]],
            labels=labels,
            norm=Norm.MASS,
            source="reduced model",
        )

    def frf(self, factors: Mapping[str, float], output: str, input_: str) -> FrfSet:
        """One FRF at the lines of those measured: the modes with the damping of the test modes that
        they pair with, and the flexibility of the modes above.

        Raises
        ------
        DataError
            If the test has no such FRF at channels of its sheet.
        """
        measured = self._measured(output, input_)
        model = self._model.model
        x = self._point(factors)
        lam, y = model.coordinates(x)
        rows = [self._session.own.rows([c]) for c in (output, input_)]
        out, into = (model.basis.observe[r] @ y for r in rows)
        rest = (
            flexibility(self._responding, x, *rows)
            - (out / (lam - model.shift)) @ into.T
        )
        stored: CorrelateStage = self._session.get("correlate")
        trial = self.at(factors)
        pairings = trial.pairs.pairing, stored.rigid_initial.pairing
        damping, _ = damping_of(trial.modes, *pairings, stored.reference)
        modes = replace(trial.modes, damping=damping)
        return like_measured(measured, modes, (out, into), rest, self._session.unit)

    @cached_property
    def _drawn(self) -> tuple[Float, DofSet]:
        """The basis at the translations of the nodes that are drawn, and their labels."""
        analysis = self._session.own.deck.analysis
        stage: ModelStage = self._session.get("model")
        labels = translations(stage.scene)
        at, sign = analysis.dofs.align(labels)
        rows = sparse.csr_array(analysis.system.transform)[at]
        rows = sparse.csr_array(rows.multiply(sign[:, None]))
        return np.asarray(rows @ self._model.model.basis.vectors), labels

    @cached_property
    def _responding(self) -> ReducedModel:
        """The reduced model with the static responses to what was excited in its basis."""
        own = self._session.own
        measured = measured_frfs(own)
        inputs = own.rows(
            [c.id for c in measured.inputs] if measured is not None else []
        )
        nominal = np.zeros(len(self.parameters))
        return with_responses(self._model.model, inputs, nominal)[0]

    @cached_property
    def _problem(self) -> Problem:
        """What the updating minimises, over all candidates."""
        return problem_of(self._session, self._session.models(quiet))

    def _measured(self, output: str, input_: str) -> FrfSet:
        """One of the FRFs of the test."""
        every = measured_frfs(self._session.own)
        outputs = [c.id for c in every.outputs] if every is not None else []
        inputs = [c.id for c in every.inputs] if every is not None else []
        if every is None or output not in outputs or input_ not in inputs:
            raise DataError(
                f"no FRF {output} / {input_} at channels of the sheet was measured"
            )
        at = np.array([outputs.index(output)]), np.array([inputs.index(input_)])
        return every.part(np.arange(every.freqs.size), *at)

    def _point(self, factors: Mapping[str, float]) -> Float:
        names = self.parameters.names
        if wrong := [n for n in factors if n not in names]:
            raise ConfigError(
                f"no candidate {wrong[0]!r}{did_you_mean(wrong[0], names)}"
            )
        for p in self.parameters.parameters:
            if not p.lower <= factors.get(p.name, 1.0) <= p.upper:
                raise ConfigError(
                    f"factor {factors[p.name]:g} of {p.name}: allowed are {p.lower:g} to "
                    f"{p.upper:g}, its bounds"
                )
        return self.parameters.vector(dict.fromkeys(names, 1.0) | dict(factors))

    def _trial(self, point: Linearisation) -> Trial:
        stored: CorrelateStage = self._session.get("correlate")
        reference = stored.reference
        modes = ModeSet(
            frequencies=point.frequencies,
            damping=np.zeros(point.frequencies.size),
            shapes=point.shapes,
            labels=reference.elastic.channels,
            norm=Norm.MASS,
            source="reduced model",
        )
        table = elastic_table(reference, modes, self._session.config, stored.fe_initial)
        return Trial(self.parameters.factors(point.x), modes, table)


def trial_model(study: str | Path, *, progress: Progress = quiet) -> TrialModel:
    """The reduced model of a study over its candidates, at the channels of its test.

    Its settings are those of study.toml now, its test modes those of the stored correlation.

    Parameters
    ----------
    study : str or Path
        `study.toml` of a study that has been run to its correlation.
    progress : callable (fraction, text)

    Raises
    ------
    ConfigError
        If the study has no deck or no candidate.
    DataError
        If it was not run as far.
    """
    path = Path(study)
    session = Session.of(path)
    if "correlate" not in session.store.stages():
        raise DataError(
            f"{session.store.path}: no correlation in it: run the study as far"
        )
    if not len(session.parameters):
        raise ConfigError(f"{path}: no [[candidate]] whose factor could be tried")
    return TrialModel(session, session.own.model(progress))


@dataclass(frozen=True, eq=False)
class PlanTrial(Displayed):
    """What some measuring points see of the target modes.

    Attributes
    ----------
    test : TestModel
        The points and their channels.
    modes : (t,) int64
        Target modes by their number in the deck, from 1.
    frequencies : (t,) float64, Hz
    auto_mac : (t, t) float64
        Of the target modes at the channels.
    references : tuple of str
        Excitation points among these, as a plan would choose them.
    reach : (t,) float64
        Share of the best driving-point residue of each target mode.
    left_by_loss : float
        Share of information left when the worst point fails.
    """

    UNITS: ClassVar[Mapping[str, str]] = {"frequencies": "Hz"}

    test: TestModel
    modes: Int
    frequencies: Float
    auto_mac: Float
    references: tuple[str, ...]
    reach: Float
    left_by_loss: float

    @property
    def worst_auto_mac(self) -> float:
        """Largest MAC between two target modes."""
        return worst_off_diagonal(self.auto_mac)

    @property
    def worst_pair(self) -> tuple[int, int]:
        """The two modes of largest auto-MAC; twice the same where there is one."""
        if self.modes.size < 2:
            return (int(self.modes[0]),) * 2
        above = np.triu(self.auto_mac, 1)
        a, b = np.unravel_index(int(np.argmax(above)), above.shape)
        return int(self.modes[a]), int(self.modes[b])

    @property
    def missed(self) -> Bool:
        """Which target modes no excitation point excites well, (t,)."""
        return self.reach < LEAST_REACH

    @property
    def worst_excited(self) -> int:
        """The mode that the excitation points excite worst."""
        return int(self.modes[int(np.argmin(self.reach))])


@dataclass(frozen=True, eq=False)
class TrialPlan:
    """The candidates of a plan; a trial of some of them takes milliseconds."""

    _problem: PlanProblem
    _edge: float

    @cached_property
    def _targets(self) -> Int:
        return self._problem.targets(self._edge)[0].modes

    @property
    def nodes(self) -> Int:
        """Candidate nodes (n,)."""
        return self._problem.able.nodes

    def under(self, settings: PlanSection) -> TrialPlan:
        """The same deck under other settings, such as other regions that are left out.

        Raises
        ------
        ConfigError
            If no candidate is left, or a fixed node is not in the deck.
        """
        return TrialPlan(
            plan_problem(self._problem.session, settings, stored=True), self._edge
        )

    def at(self, points: Sequence[int | str]) -> PlanTrial:
        """What some points see.

        Parameters
        ----------
        points : sequence of int or str
            Nodes, with all directions of a sensor there, or single channels such as `101+Z`.

        Raises
        ------
        ConfigError
            If one is no candidate of the plan, or there is none.
        """
        able = self._problem.able
        chosen = self._chosen(points)
        targets = self._targets
        seen = self._problem.shapes[chosen][:, :, targets]
        rows = seen.reshape(-1, targets.size)
        found = self._problem.excitation(chosen, targets)
        labels = able.labels(chosen)
        return PlanTrial(
            test=able.test_model(chosen),
            modes=targets + 1,
            frequencies=self._problem.frequencies[targets],
            auto_mac=auto_mac(rows),
            references=tuple(labels[i] for i in found.tolist()),
            reach=reached(rows, found),
            left_by_loss=worst_sensor_loss(seen, 1).left if chosen.size > 1 else 0.0,
        )

    def _chosen(self, points: Sequence[int | str]) -> Int:
        """Positions of the sensors that are meant."""
        able = self._problem.able
        if not points:
            raise ConfigError("no measuring point: name one at least")
        nodes = [p for p in points if not isinstance(p, str)]
        lost: list[int | str] = np.setdiff1d(nodes, able.node).tolist()
        channels = [p for p in points if isinstance(p, str)]
        labels = able.labels(np.arange(able.at.size)) if channels else ()
        sensor = {c: k // able.each for k, c in enumerate(labels)}
        lost += [c for c in channels if c not in sensor]
        if lost:
            raise ConfigError(
                f"{lost[0]}: no candidate of the plan; it is held, excluded or named"
            )
        named = np.array([sensor[c] for c in channels], dtype=np.int64)
        return np.union1d(np.flatnonzero(np.isin(able.node, nodes)), named)


def trial_plan(study: str | Path) -> TrialPlan:
    """The candidates of the plan of a study, to try points before the plan is made.

    Its settings are those of study.toml now, its modes those that are stored of the deck.

    Parameters
    ----------
    study : str or Path
        `study.toml` of a study that has been run to its modes.

    Raises
    ------
    ConfigError
        If the study has no [plan].
    DataError
        If it was not run as far.
    """
    path = Path(study)
    session = Session.of(path)
    plan = session.config.plan
    if plan is None:
        raise ConfigError(f"{path}: no [plan] whose points could be tried")
    if "model" not in session.store.stages():
        raise DataError(
            f"{session.store.path}: no modes of the deck in it: run the study as far"
        )
    problem = plan_problem(session, plan, stored=True)
    return TrialPlan(problem, elastic_edge(problem.frequencies, session.config))
