"""The model of a study at factors that are tried: its frequencies and MAC, before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float
from ringtrue.core.display import Displayed
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.signals import FrfSet
from ringtrue.correlation.table import CorrelationTable
from ringtrue.eigen.eigenpairs import frequencies
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.model.ports import Linearisation
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.reduction.response import flexibility, with_responses
from ringtrue.study.evidence import like_measured
from ringtrue.study.model_frfs import damping_of, measured_frfs
from ringtrue.study.objective import problem_of
from ringtrue.study.opened import AtChannels
from ringtrue.study.reference import elastic_table
from ringtrue.study.results import CorrelateStage, ModelStage
from ringtrue.study.scene import translations
from ringtrue.study.session import Session
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
        rest = flexibility(self._responding, x, *rows) - (out / (lam - model.shift)) @ into.T
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
        inputs = own.rows([c.id for c in measured.inputs] if measured is not None else [])
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
            raise DataError(f"no FRF {output} / {input_} at channels of the sheet was measured")
        at = np.array([outputs.index(output)]), np.array([inputs.index(input_)])
        return every.part(np.arange(every.freqs.size), *at)

    def _point(self, factors: Mapping[str, float]) -> Float:
        names = self.parameters.names
        if wrong := [n for n in factors if n not in names]:
            raise ConfigError(f"no candidate {wrong[0]!r}{did_you_mean(wrong[0], names)}")
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
    progress : callable, optional
        Called with the fraction done and a text.

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
        raise DataError(f"{session.store.path}: no correlation in it: run the study as far")
    if not len(session.parameters):
        raise ConfigError(f"{path}: no [[candidate]] whose factor could be tried")
    return TrialModel(session, session.own.model(progress))
