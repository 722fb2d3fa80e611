"""The plan of a study at points that are tried: what they see and miss, before anything runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.display import Displayed
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError, DataError
from ringtrue.planning.exciters import LEAST_REACH, reached
from ringtrue.planning.sensors import worst_sensor_loss
from ringtrue.shapes import auto_mac, worst_off_diagonal
from ringtrue.study.config_sections import PlanSection
from ringtrue.study.planned_test import PlanProblem
from ringtrue.study.reference import elastic_edge
from ringtrue.study.session import Session
from ringtrue.study.stages.plan import plan_problem


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
        return np.asarray(self.reach < LEAST_REACH)

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
        return TrialPlan(plan_problem(self._problem.session, settings, stored=True), self._edge)

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
            raise ConfigError(f"{lost[0]}: no candidate of the plan; it is held, excluded or named")
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
        raise DataError(f"{session.store.path}: no modes of the deck in it: run the study as far")
    problem = plan_problem(session, plan, stored=True)
    return TrialPlan(problem, elastic_edge(problem.frequencies, session.config))
