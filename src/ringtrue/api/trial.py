"""The model of a study at factors that are tried: its frequencies and MAC, before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.display import Displayed
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.parameters import ParameterSet
from ringtrue.correlation.table import CorrelationTable
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.model.ports import Linearisation
from ringtrue.study.config import read_config
from ringtrue.study.opened import AtChannels
from ringtrue.study.reference import elastic_table
from ringtrue.study.results import CorrelateStage
from ringtrue.study.session import Session
from ringtrue.study.store import Store

STORE = "study.h5"


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


@dataclass(frozen=True, eq=False)
class TrialModel:
    """The reduced model of a study over its candidates: a trial takes milliseconds.

    Attributes
    ----------
    parameters : ParameterSet
        The candidates.
    """

    parameters: ParameterSet
    _session: Session
    _model: AtChannels

    def at(self, factors: Mapping[str, float]) -> Trial:
        """The model at factors by the names of candidates; the others have 1.

        Raises
        ------
        ConfigError
            If there is no such candidate, or a factor is outside of its bounds.
        """
        x = self._point(factors)
        return self._trial(self._model.modes(x))

    def full(self, factors: Mapping[str, float]) -> Trial:
        """The same by a full solution, which takes as long as the modes of the deck."""
        _, truth = self._model.enrich(self._point(factors))
        return self._trial(truth)

    def error(self, factors: Mapping[str, float]) -> float:
        """An estimate of the largest relative frequency error of `at`."""
        return self._model.model.error(self._point(factors))

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
    session = Session(read_config(path), path.parent, path.parent, Store(path.with_name(STORE)))
    if "correlate" not in session.store.stages():
        raise DataError(f"{session.store.path}: no correlation in it: run the study as far")
    if not len(session.parameters):
        raise ConfigError(f"{path}: no [[candidate]] whose factor could be tried")
    return TrialModel(session.parameters, session, session.own.model(progress))
