"""A parameter set updated through another solver: modes found anew at each point, by runs of its
program.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse

from ringtrue.core.progress import Progress
from ringtrue.core.testmodel import Observation
from ringtrue.model.edit import carried
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.observed import PRINTED, UNTOLD, FullModel
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.course import course_of, settled
from ringtrue.study.objective import names_of, problem_of
from ringtrue.study.results import SetResult
from ringtrue.study.stages.sensitivity import targets
from ringtrue.study.stages.together import summary
from ringtrue.study.workbench import Workbench

USUAL = 60  # runs of an updating, for the progress that is shown


def by_runs(
    desk: Workbench,
    name: str,
    members: Sequence[str],
    progress: Progress,
    u: UpdateSection | None = None,
) -> tuple[SetResult, int]:
    """Update on the full decks of all configurations; the result, and how many runs it took.

    `u` stands in for the [update] of the study. A run that fails at a trial point is a rejected
    step.

    Raises
    ------
    SolverError
        If the solver is missing, or fails at the start.
    """
    u = u or desk.config.update
    aims = targets(desk, u)
    models = [_full(desk, n, members) for n in names_of(desk)]
    problem = problem_of(desk, models, aims, u)

    def told(_fraction: float, text: str) -> None:
        runs = sum(m.ledger.runs for m in models)
        progress(runs / (runs + USUAL), f"{name}: {text}, {runs} runs of {desk.deck.solver}")

    course = course_of(u)
    course = replace(course, method=replace(course.method, step=PRINTED, gradient=UNTOLD))
    end = settled(problem, u, desk.config.study.seed, progress, course=course, told=told)
    return summary(problem, aims, name, end), sum(m.ledger.runs for m in models)


def _full(desk: Workbench, name: str, members: Sequence[str]) -> FullModel:
    """A deck over those of the parameters that it has, at the channels of its test, with all its
    modes up to fmax.
    """
    assert desk.engine is not None
    opened, look = desk.deck_of(name)
    names = desk.parameters.names
    mine = carried(opened.model, desk.parameters.take([names.index(m) for m in members]))
    channels = desk.reference(name).channels
    rows = np.array([look.channels.index(c) for c in channels], dtype=np.int64)
    with desk.engine.open(opened.model) as analysis:
        at, sign = look.dofs.align(analysis.dofs)
        matrix = sparse.csr_array(look.matrix[rows][:, at] * sign)
        seen = Observation(matrix, channels, analysis.dofs, look.unit, look.distance[rows])
    count = len(opened.modes(desk.fmax).modes)
    return FullModel(opened.model, mine, seen, ModesRequest(max(count, 1)), desk.engine)
