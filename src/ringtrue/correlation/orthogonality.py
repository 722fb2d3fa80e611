"""Orthogonality of paired modes over a mass, and whether it passes the gates of the trade or the
user's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float, FrozenArrays, Int
from ringtrue.core.modes import ModeSet
from ringtrue.errors import ConfigError
from ringtrue.shapes import (
    auto_mac,
    cross_orthogonality,
    pseudo_inverse,
    read_orthogonality,
    self_orthogonality,
    unit,
)


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


# NASA-STD-5002 (1996): at least 0.9 on the diagonal and at most 0.1 off it for the target modes
TRADE = Gate()


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
        return text + (
            f", {len(self.failures)} entries beyond the limits" if self.failures else ""
        )


def judge(matrix: Float, gate: Gate, rows: Int, columns: Int) -> Verdict:
    """Hold a self- or cross-orthogonality matrix against a gate.

    Parameters
    ----------
    matrix : (ma, mb) float64
        Magnitudes, 0..1 (`shapes`).
    gate : Gate
    rows, columns : (k,) int64
        The pairs, which belong together. Only they are judged.
    """
    off = np.abs(matrix[np.ix_(rows, columns)])
    own = np.diag(off).copy()
    np.fill_diagonal(off, 0.0)
    low = [
        (i, i, own[i], gate.diagonal)
        for i in np.flatnonzero(own < gate.diagonal).tolist()
    ]
    high = [
        (i, j, off[i, j], gate.off_diagonal)
        for i, j in np.argwhere(off > gate.off_diagonal).tolist()
    ]
    found = [
        Failure(int(rows[i]), int(columns[j]), float(value), limit, diagonal=i == j)
        for i, j, value, limit in low + high
    ]
    # the farthest beyond its limit first; the halves of a symmetric matrix differ in rounding,
    # which orders nothing
    # 9: of an entry, by which failures are ordered
    found.sort(key=lambda f: (-round(abs(f.value - f.limit), 9), f.a, f.b))
    return Verdict(
        gate=gate,
        passed=bool(own.size) and not found,
        least_diagonal=float(own.min()) if own.size else float("nan"),
        largest_off_diagonal=float(off.max(initial=0.0)),
        failures=tuple(found),
    )


def verdict_json(verdict: Verdict) -> dict[str, Any]:
    """Plain values; modes count from 1."""
    return {
        "gate": verdict.gate.name,
        "passed": verdict.passed,
        "least_diagonal": verdict.least_diagonal
        if np.isfinite(verdict.least_diagonal)
        else None,
        "largest_off_diagonal": verdict.largest_off_diagonal,
        "failures": [
            asdict(f) | {"a": f.a + 1, "b": f.b + 1} for f in verdict.failures[:20]
        ],
    }


Mass = Any_ | sparse.csr_array
Lift = Callable[[ModeSet], Any_]
CheckKind = Literal["model", "self", "cross"]
READ = 0.02  # error of a reading over the RMS of its mode, as of ordinary tests


@dataclass(frozen=True, slots=True, eq=False)
class OrthogonalityCheck(FrozenArrays):
    """An orthogonality matrix and what the gate says of it.

    Attributes
    ----------
    name : str
    matrix : (ma, mb) float64, 0..1
    verdict : Verdict
    kind : {"model", "self", "cross"}
        B with itself as read with 2 % error, which says whether the mass is fit to judge by; A with
        itself; A with B.
    mass : str
        What the mass is called.
    """

    name: str
    matrix: Float
    verdict: Verdict
    kind: CheckKind
    mass: str


@dataclass(frozen=True, slots=True, eq=False)
class PairedSets:
    """Two mode sets and their pairs.

    Attributes
    ----------
    a, b : ModeSet
        At the same channels.
    rows, columns : (k,) int64
        The pairs.
    turn : (mb, mb) float64 or complex128
        Turns close modes of B as the pairing did (`turning`).
    """

    a: ModeSet
    b: ModeSet
    rows: Int
    columns: Int
    turn: Any_

    @property
    def compared(self) -> Int:
        """The modes of B up to the last that has a partner."""
        return np.arange(int(self.columns.max(initial=-1)) + 1)

    def checks(
        self, model: Float, own: Float, cross: tuple[str, Float], gate: Gate, mass: str
    ) -> tuple[OrthogonalityCheck, ...]:
        """Checks of the matrices of B as read, of A with itself, and (name, matrix) of A with B."""
        read = f"modes of the model read with {100 * READ:g} % error"
        compared = self.compared
        kinds: tuple[tuple[CheckKind, str, Float, Int, Int], ...] = (
            ("model", read, model, compared, compared),
            ("self", "self-orthogonality", own, self.rows, self.rows),
            ("cross", *cross, self.rows, self.columns),
        )
        return tuple(
            OrthogonalityCheck(
                f"{name}, {mass} mass", x, judge(x, gate, *pairs), kind, mass
            )
            for kind, name, x, *pairs in kinds
        )


@dataclass(frozen=True, slots=True, eq=False)
class OrthogonalityTest:
    """How the orthogonality of shapes is judged.

    Attributes
    ----------
    gate : Gate
    mass : (channel, channel) float64, optional
        Of the structure at the channels (`reduction.static`); without it that which mass-normalised
        shapes give.
    name : str
        What the mass is called in the checks.
    lift : callable, ModeSet -> (n, m), optional
        Coordinates of shapes that the mass is over, where these are not channels (Craig-Bampton).
    """

    gate: Gate = TRADE
    mass: Mass | None = None
    name: str = "given"
    lift: Lift | None = None


def over_mass(
    pairs: PairedSets, mass: Mass, gate: Gate, *, name: str, lift: Lift | None = None
) -> tuple[OrthogonalityCheck, ...]:
    """Orthogonality of B as read, of A, and of A with B over a mass; `lift` gives the coordinates
    of shapes that the mass is over, where these are not the channels.
    """
    compared = pairs.compared
    one, two = (m.shapes if lift is None else lift(m) for m in (pairs.a, pairs.b))
    model = _read(pairs.b.take(compared), two[:, compared], mass, lift)
    own = self_orthogonality(one, mass)
    cross = cross_orthogonality(one, two @ pairs.turn, mass)
    return pairs.checks(model, own, ("cross-orthogonality", cross), gate, name)


def _read(b: ModeSet, coordinates: Any_, mass: Mass, lift: Lift | None) -> Float:
    """Modes with themselves over a mass, read with the errors of an ordinary test."""
    error = READ * np.sqrt((np.abs(b.shapes) ** 2).mean(axis=0))
    if lift is None:
        return read_orthogonality(coordinates, mass, error)
    n = len(b.channels)
    out = np.zeros((len(b), len(b)))
    # tens, each lifted at its own frequency
    for j, f in enumerate(b.frequencies.tolist()):
        readings = ModeSet(
            frequencies=np.full(n, f),
            damping=np.zeros(n),
            shapes=np.eye(n),
            labels=b.channels,
            norm=b.norm,
            source=b.source,
        )
        one = np.where(np.arange(len(b)) == j, error, 0.0)
        out[:, j] = read_orthogonality(coordinates, mass, one, lift(readings))[:, j]
    return out


def over_serep_mass(pairs: PairedSets, gate: Gate) -> tuple[OrthogonalityCheck, ...]:
    """The same over the mass that mass-normalised real shapes of B give at the channels.

    Raises
    ------
    InputError
        If the channels cannot distinguish the shapes of B, or they are complex.
    """
    b = pairs.b
    back = pseudo_inverse(b.shapes)
    coordinates = back @ pairs.a.shapes
    one = np.eye(len(b))
    error = READ * np.sqrt((b.shapes**2).mean(axis=0))
    compared = np.ix_(pairs.compared, pairs.compared)
    model = read_orthogonality(one, one, error, back)[compared]
    own = auto_mac(coordinates) ** 0.5
    cross = np.abs(unit(pairs.turn.conj().T @ coordinates)).T
    return pairs.checks(
        model, own, ("pseudo-orthogonality (POC)", cross), gate, "SEREP"
    )
