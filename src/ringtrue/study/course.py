"""How an updating goes about it, and where it starts, as [update] says."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.progress import Progress
from ringtrue.study.config_update import UpdateSection
from ringtrue.update.multistart import latin_hypercube, multi_start
from ringtrue.update.settle import Course
from ringtrue.update.several import Problem
from ringtrue.update.trust import Method, Solution, solve, staged

BEST = 3  # of several starts, that go on to the end


def course_of(u: UpdateSection, method: Method | None = None) -> Course:
    """As asked for; a trust region where nothing is said."""
    method = method or Method(u.step if "step" in u.model_fields_set else "trust-region")
    weighed = u.discrepancy if u.discrepancy != "found" or u.sharpened else "assumed"
    return Course(method, u.iterations, "given" if u.prior == "study" else u.prior, weighed)


def begun(
    problem: Problem,
    u: UpdateSection,
    course: Course,
    seed: int,
    progress: Progress,
    told: Progress | None = None,
    checkpoint: Path | None = None,
) -> Solution:
    """Where the gates lead: from the best end of several starts, after sets that grow stage by stage, or the deck."""
    start, limit = _start(problem, u, course.method, seed, progress), course.iterations
    return solve(problem, course.method, start=start, iterations=limit, checkpoint=checkpoint, progress=told)


def _start(problem: Problem, u: UpdateSection, method: Method, seed: int, progress: Progress) -> Float:
    members = problem.parameters.names
    start: Float = np.zeros(problem.size)
    if u.starts > 1:
        more = latin_hypercube(problem.parameters, u.starts - 1, np.random.default_rng([seed, 9]))
        rows, limits = problem.inequalities()
        more = more[(more @ rows.T <= limits).all(axis=1)]
        found = multi_start(problem, np.vstack([start, more]), method, iterations=u.iterations, finish=BEST)
        start = np.array(found.best.y)
    grown = [[n for n in stage if n in members] for stage in u.stages]
    grown = [g for g in grown if g and len(g) < len(members)]
    if grown and u.starts == 1:
        start = np.array(staged(problem, grown, method, iterations=u.iterations, progress=progress)[-1].x)
    return start
