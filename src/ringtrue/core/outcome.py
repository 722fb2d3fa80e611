"""How an iteration ended."""

from __future__ import annotations

from enum import StrEnum


class Outcome(StrEnum):
    """The verdict of a driver loop; the text teaches."""

    CONVERGED = "converged: the gradient or step is below its tolerance"
    STALLED = "stalled: no step lowers the objective; the start or the bounds may be the reason"
    MAX_ITERATIONS = (
        "stopped at the iteration limit: raise it, or look at the history for oscillation"
    )
    NOT_FINITE = "stopped: the objective is not finite"

    @property
    def ok(self) -> bool:
        """Whether the result can be used as a solution."""
        return self is Outcome.CONVERGED
