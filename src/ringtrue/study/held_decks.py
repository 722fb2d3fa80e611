"""Decks that the processes of the study's solver hold and reduce: no matrix of a whole deck is in
this process.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np

from ringtrue.core.iterate import Progress
from ringtrue.core.parameters import ParameterSet
from ringtrue.model.superelements import whole_mesh
from ringtrue.reduction.projected import HeldModel, ReducingAnalysis
from ringtrue.study.opened import ProjectedAtChannels
from ringtrue.study.session import Session, StudyConfiguration


@dataclass(frozen=True, slots=True, eq=False)
class HeldDecks:
    """The decks of all configurations, as long as they are open.

    Attributes
    ----------
    solver : str
        Its name.
    analyses : tuple of ReducingAnalysis
        In the order of the configurations.
    """

    solver: str
    analyses: tuple[ReducingAnalysis, ...]

    def reduced(
        self, c: StudyConfiguration, parameters: ParameterSet, progress: Progress
    ) -> HeldModel:
        """The reduced model of a configuration at all its channels, as
        `StudyConfiguration.reduced`.
        """
        progress(0.0, f"reduced model by {self.solver}")
        fmax = c.session.up_to(c.reference.elastic)
        analysis = self.analyses[c.session.configurations.index(c)]
        count = len(c.deck.modes_by(analysis, fmax).modes)
        return analysis.reduced(parameters, c.seen.matrix, count, fmax)

    def model(self, c: StudyConfiguration, progress: Progress) -> ProjectedAtChannels:
        """The reduced model over the candidates that its deck has, as
        `StudyConfiguration.model`.
        """
        every, count = c.parameters()
        model = self.reduced(c, every, progress)
        seen = ProjectedAtChannels(model, c.rows(c.reference.elastic.channels))
        return seen.with_parameters(range(count), np.zeros(len(every)))


@contextmanager
def held_decks(session: Session) -> Iterator[HeldDecks | None]:
    """The decks of a study in its solver; None where that does not reduce them."""
    engine = session.engine
    if engine is None or not session.remodelled.reduces:
        yield None
        return
    with ExitStack() as open_ones:
        analyses = [
            open_ones.enter_context(engine.open(whole_mesh(c.deck.model)))
            for c in session.configurations
        ]
        reducing = tuple(a for a in analyses if isinstance(a, ReducingAnalysis))
        yield HeldDecks(engine.name, reducing)
