"""How an updating goes about it, and where it starts, as [update] says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.progress import Progress
from ringtrue.study.config_update import UpdateSection
from ringtrue.updating.multistart import global_search, latin_hypercube, multi_start
from ringtrue.updating.problem import Problem
from ringtrue.updating.solver import Method, Solution, solve, staged
from ringtrue.updating.strategy import Course, Settled
from ringtrue.updating.strategy import settled as settled_from

BEST = 3  # of several starts, that go on to the end
STARTS = 8  # where one leaves modes without partner


def course_of(u: UpdateSection) -> Course:
    """As [update] asks for."""
    weighed = u.discrepancy if u.discrepancy != "found" or u.sharpened else "assumed"
    return Course(Method(u.step), u.iterations, "given" if u.prior == "study" else u.prior, weighed)


def further(u: UpdateSection) -> UpdateSection | None:
    """[update] from several starts, for an end that leaves used modes without partner; None where
    none are asked for.

    Modes that change places between the deck and the structure make minima in which each is paired
    with its neighbour, and some without partner.
    """
    enough = u.starts >= STARTS or u.search == "global"
    return None if u.step == "published" or enough else u.otherwise({"starts": STARTS})


def settled(
    problem: Problem,
    u: UpdateSection,
    seed: int,
    progress: Progress,
    *,
    start: Float | None = None,
    course: Course | None = None,
    told: Progress | None = None,
    checkpoint: Path | None = None,
) -> Settled:
    """The end of an updating from a start that the gates have led to, or from where they lead."""
    course = course or course_of(u)
    if start is not None:
        return settled_from(problem, course, start=start, progress=told)
    rough = begun(problem, u, course, seed, progress, told, checkpoint)
    end = settled_from(problem, course, start=rough.y, progress=told)
    return replace(end, path=(*rough.history, *end.path[1:]))


def begun(
    problem: Problem,
    u: UpdateSection,
    course: Course,
    seed: int,
    progress: Progress,
    told: Progress | None = None,
    checkpoint: Path | None = None,
) -> Solution:
    """Where the gates lead: from a global search, the best end of several starts, sets that grow,
    or the deck.
    """
    method, limit = course.method, course.iterations
    if u.search == "global":
        return global_search(problem, np.random.default_rng([seed, 9]), method, progress=progress)
    if u.starts > 1:
        more = latin_hypercube(problem.parameters, u.starts - 1, np.random.default_rng([seed, 9]))
        starts = np.vstack([np.zeros(problem.size), more])
        return multi_start(
            problem, starts, method, iterations=limit, finish=BEST, progress=progress
        ).best
    start = _grown(problem, u, method, progress)
    return solve(
        problem, method, start=start, iterations=limit, checkpoint=checkpoint, progress=told
    )


def _grown(problem: Problem, u: UpdateSection, method: Method, progress: Progress) -> Float:
    """Where the sets of [update] stages end, (q,); the deck where none is smaller than the
    whole.
    """
    members = problem.parameters.names
    grown = [[n for n in stage if n in members] for stage in u.stages]
    grown = [g for g in grown if g and len(g) < len(members)]
    if not grown:
        return np.zeros(problem.size)
    return np.array(
        staged(problem, grown, method, iterations=u.iterations, progress=progress)[-1].x
    )
