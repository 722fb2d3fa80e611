"""Pass or fail: the gates of the trade on an orthogonality matrix, or the user's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.errors import ConfigError, InputError


@dataclass(frozen=True, slots=True)
class Gate:
    """Limits on an orthogonality matrix.

    Attributes
    ----------
    diagonal : float
        Least value of a pair, 0..1.
    off_diagonal : float
        Largest value between different modes, 0..1.
    name : str
    """

    diagonal: float = 0.9
    off_diagonal: float = 0.1
    name: str = "90 % / 10 %"

    def __post_init__(self) -> None:
        if not (0 <= self.diagonal <= 1 and 0 <= self.off_diagonal <= 1):
            raise ConfigError(
                f"gate {self.name!r}: diagonal {self.diagonal}, off-diagonal "
                f"{self.off_diagonal}: 0 to 1"
            )


MOST_TOLD = 20  # failures
DECIMALS = 9  # of an entry, by which failures are ordered
TRADE = (
    Gate()
)  # NASA-STD-5002 (1996): at least 0.9 on the diagonal and at most 0.1 off it for the target modes


@dataclass(frozen=True, slots=True)
class Failure:
    """One entry beyond its limit; modes count from 0."""

    a: int
    b: int
    value: float
    limit: float
    diagonal: bool


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a gate says of a matrix.

    Attributes
    ----------
    gate : Gate
    passed : bool
    least_diagonal : float
        NaN without a pair.
    largest_off_diagonal : float
        0 without one.
    failures : tuple of Failure
        The worst first.
    """

    gate: Gate
    passed: bool
    least_diagonal: float
    largest_off_diagonal: float
    failures: tuple[Failure, ...]

    def __str__(self) -> str:
        text = f"{'passed' if self.passed else 'failed'} {self.gate.name}"
        text += f": least diagonal {100 * self.least_diagonal:.1f} %"
        text += f", largest off-diagonal {100 * self.largest_off_diagonal:.1f} %"
        return text + (f", {len(self.failures)} entries beyond the limits" if self.failures else "")


def judge(
    matrix: Float, gate: Gate = TRADE, *, a: Any_ | None = None, b: Any_ | None = None
) -> Verdict:
    """Hold a self- or cross-orthogonality matrix against a gate.

    Parameters
    ----------
    matrix : (ma, mb) float64
        Magnitudes, 0..1 (`shapes.orthogonality`).
    gate : Gate
    a, b : (k,) int, optional
        The pairs: rows and columns of `matrix` that belong together. The matrix must be square if
        not given. Only the rows and columns that have a partner are judged.

    Raises
    ------
    InputError
        If the pairs do not fit the matrix.
    """
    rows, cols = _paired_rows(np.asarray(matrix), a, b)
    block = np.abs(np.asarray(matrix, dtype=np.float64)[np.ix_(rows, cols)])
    own, off = np.diag(block), block.copy()
    np.fill_diagonal(off, 0.0)
    found = [
        Failure(int(rows[i]), int(cols[i]), float(own[i]), gate.diagonal, True)
        for i in np.flatnonzero(own < gate.diagonal)
    ]
    found += [
        Failure(int(rows[i]), int(cols[j]), float(off[i, j]), gate.off_diagonal, False)
        for i, j in np.argwhere(off > gate.off_diagonal).tolist()
    ]
    # the farthest beyond its limit first; the halves of a symmetric matrix differ in rounding,
    # which orders nothing
    found.sort(key=lambda f: (-round(abs(f.value - f.limit), DECIMALS), f.a, f.b))
    least = float(own.min()) if own.size else float("nan")
    return Verdict(
        gate, bool(own.size) and not found, least, float(off.max(initial=0.0)), tuple(found)
    )


def _paired_rows(matrix: Any_, a: Any_ | None, b: Any_ | None) -> tuple[Int, Int]:
    if (
        matrix.ndim != 2
        or (a is None) != (b is None)
        or (a is None and matrix.shape[0] != matrix.shape[1])
    ):
        raise InputError(
            f"orthogonality {matrix.shape}: give the pairs (a and b) unless it is square"
        )
    rows = np.arange(matrix.shape[0]) if a is None else np.asarray(a, dtype=np.int64)
    cols = np.arange(matrix.shape[1]) if b is None else np.asarray(b, dtype=np.int64)
    top = (rows.max(initial=-1), cols.max(initial=-1))
    if rows.shape != cols.shape or top[0] >= matrix.shape[0] or top[1] >= matrix.shape[1]:
        raise InputError(
            f"pairs {rows.shape} and {cols.shape} up to {top} for a matrix {matrix.shape}"
        )
    return rows, cols


def verdict_json(verdict: Verdict) -> dict[str, Any]:
    """Plain values; modes count from 1."""
    return {
        "gate": verdict.gate.name,
        "passed": verdict.passed,
        "least_diagonal": verdict.least_diagonal if np.isfinite(verdict.least_diagonal) else None,
        "largest_off_diagonal": verdict.largest_off_diagonal,
        "failures": [
            {"a": f.a + 1, "b": f.b + 1, "value": f.value, "limit": f.limit, "diagonal": f.diagonal}
            for f in verdict.failures[:MOST_TOLD]
        ],
    }
