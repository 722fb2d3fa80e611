"""The one driver of all iterations: it owns the limit and the verdict, and reports the progress.

Progress of long work is a callable of the share done, 0 to 1, and of the work under way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite
from typing import Generic, Protocol, TypeVar

from ringtrue.errors import ConfigError

Progress = Callable[[float, str], None]


def quiet(fraction: float, text: str) -> None:
    """No progress."""


def part(progress: Progress, begin: float, end: float) -> Progress:
    """Progress of the part of a job that takes it from `begin` to `end`."""
    return lambda fraction, text: progress(begin + (end - begin) * fraction, text)


class IterationText(str):
    """What progress says of an iteration, with its state, and values by name for who draws them."""

    state: object = None
    values: Mapping[str, float] = {}


class Outcome(StrEnum):
    """The verdict of a driver loop; the text teaches."""

    CONVERGED = "converged: the gradient or step is below its tolerance"
    STALLED = "stalled: no step lowers the objective; the start or the bounds may be the reason"
    MAX_ITERATIONS = (
        "stopped at the iteration limit: raise it, or look at the history for "
        "oscillation"
    )
    NOT_FINITE = "stopped: the objective is not finite"

    @property
    def ok(self) -> bool:
        """Whether the result can be used as a solution."""
        return self is Outcome.CONVERGED

    @property
    def verdict(self) -> str:
        """Converged, stalled or stopped."""
        if self in (Outcome.CONVERGED, Outcome.STALLED):
            return self.name.lower()
        return "stopped"


S = TypeVar("S")


class Algorithm(Protocol[S]):
    """A frozen value with the rules of one method; the state `S` is frozen too."""

    def init(self) -> S:
        """The state at the start."""
        ...

    def step(self, state: S) -> S:
        """The next state."""
        ...

    def terminate(self, state: S) -> Outcome | None:
        """A verdict, or None to go on."""
        ...

    def merit(self, state: S) -> float:
        """The value that is being lowered; a value that is not finite ends the iteration."""
        ...


@dataclass(frozen=True, slots=True)
class Iteration(Generic[S]):
    """All states, the start included, and how it ended."""

    states: tuple[S, ...]
    outcome: Outcome

    @property
    def last(self) -> S:
        """The final state."""
        return self.states[-1]


def iterate(
    algorithm: Algorithm[S], *, limit: int, progress: Progress = quiet
) -> Iteration[S]:
    """Run `algorithm` until it terminates, at most `limit` steps.

    Raises
    ------
    ConfigError
        If `limit` is below 1.
    """
    if limit < 1:
        raise ConfigError(f"iteration limit {limit}: allowed are 1 and more")
    states = [algorithm.init()]
    while True:
        value = algorithm.merit(states[-1])
        if not isfinite(value):
            return Iteration(tuple(states), Outcome.NOT_FINITE)
        if (verdict := algorithm.terminate(states[-1])) is not None:
            return Iteration(tuple(states), verdict)
        if len(states) > limit:
            return Iteration(tuple(states), Outcome.MAX_ITERATIONS)
        said = IterationText(f"iteration {len(states) - 1}: {value:.6g}")
        said.state = states[-1]
        progress((len(states) - 1) / limit, said)
        states.append(algorithm.step(states[-1]))
