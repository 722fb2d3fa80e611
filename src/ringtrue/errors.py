"""The tree of errors. Each message says what, where, the value got, the values allowed, what to
try.

RingtrueError
├── InputError(ValueError)             the caller's input is wrong: exit status 2
│   ├── DeckError                      a deck: path, line, card, field
│   ├── DataError                      a measurement file or record
│   └── ConfigError                    study.toml or an option
├── UnsupportedError(NotImplementedError)
│   └── UnsupportedCard                a card that carries stiffness, mass or constraint
├── NumericalError(ArithmeticError)
│   ├── SingularModel                  names the degrees of freedom
│   ├── OutOfMemory                    foreseen: nothing was begun
│   └── NotConverged                   carries the outcome
└── SolverError(RuntimeError)
    ├── SolverMissing
    └── SolverFailed
"""

from __future__ import annotations

import copyreg
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches


class RingtrueError(Exception):
    """Base of every error that ringtrue raises on purpose."""

    def __reduce__(self) -> tuple[object, ...]:
        """As it is, whatever it was made from: it may come from another process."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class InputError(RingtrueError, ValueError):
    """The input is wrong; nothing was computed or written."""


class DeckError(InputError):
    """A deck is wrong at a known place."""

    def __init__(
        self,
        message: str,
        *,
        path: object = None,
        line: int | None = None,
        card: str = "",
        field: str = "",
    ) -> None:
        self.path = path
        self.line = line
        self.card = card
        self.field = field
        place = f"{path}:{line}: " if line else f"{path}: " if path else ""
        what = " ".join(x for x in (card, f"field {field}" if field else "") if x)
        super().__init__(f"{place}{what + ': ' if what else ''}{message}")


class DataError(InputError):
    """A measurement file or record is wrong."""


class ConfigError(InputError):
    """A setting is wrong."""


class UnsupportedError(RingtrueError, NotImplementedError):
    """A valid input that ringtrue cannot treat."""


class UnsupportedCard(UnsupportedError):
    """A card that carries stiffness, mass or constraint and is not supported."""

    def __init__(
        self, card: str, *, path: object = None, line: int | None = None, why: str = ""
    ) -> None:
        self.card = card
        self.path = path
        self.line = line
        self.why = why
        place = f"{path}:{line}: " if line else ""
        super().__init__(f"{place}{card} is not supported{': ' + why if why else ''}")


class NumericalError(RingtrueError, ArithmeticError):
    """A computation failed on valid input."""


class SingularModel(NumericalError):
    """The stiffness is singular; `dofs` names where."""

    def __init__(self, dofs: Sequence[str], why: str) -> None:
        self.dofs = tuple(dofs)
        shown = " ".join(self.dofs[:12]) + (
            f" and {len(self.dofs) - 12} more" if len(self.dofs) > 12 else ""
        )
        super().__init__(f"the model is singular at {shown or 'unknown DOFs'}: {why}")


class OutOfMemory(NumericalError, MemoryError):
    """A step needs more memory than there is: `needed` and `available`, bytes (0 if unknown)."""

    def __init__(self, message: str, *, needed: int = 0, available: int = 0) -> None:
        self.needed = needed
        self.available = available
        super().__init__(message)


class NotConverged(NumericalError):
    """An iteration ended without converging; `outcome` says how."""

    def __init__(self, message: str, outcome: object = None) -> None:
        self.outcome = outcome
        super().__init__(message)


class SolverError(RingtrueError, RuntimeError):
    """An external solver could not do its work."""


class SolverMissing(SolverError):
    """An external solver or optional package is not installed."""


class SolverFailed(SolverError):
    """An external solver ran and failed; the message ends with the tail of its log."""


@contextmanager
def about(path: object) -> Iterator[None]:
    """Input errors raised within name the file that they are about."""
    try:
        yield
    except (DataError, ConfigError) as e:
        if str(path) in str(e):
            raise
        raise type(e)(f"{path}: {e}") from e


def did_you_mean(got: str, allowed: Iterable[str]) -> str:
    """A clause that lists the allowed names and the nearest one, in any case, or one that begins
    so.

    >>> did_you_mean("dir", ["direction", "point"])
    "; did you mean 'direction'? Allowed: direction, point"
    >>> did_you_mean("si", ["SI", "mm-t-s"])
    "; did you mean 'SI'? Allowed: SI, mm-t-s"
    """
    names = sorted(allowed)
    plain = {n.lower(): n for n in names}
    begun = [n for n in plain if got and n.startswith(got.lower())]
    near = get_close_matches(got.lower(), plain, n=1) or begun
    hint = f"; did you mean {plain[near[0]]!r}?" if near else ";"
    return f"{hint} Allowed: {', '.join(names)}"
