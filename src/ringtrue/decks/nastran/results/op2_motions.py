"""Motions of nodes in an OP2 file: real modes, static deflections, frequency responses.

A data block of motions has records in pairs. In SORT1 there is a pair for each mode, case or
frequency: what it is, and the motion of all nodes. In SORT2 there is a pair for each node: its
number, and its motion in all modes, cases or frequencies. Which of the two, and what the values
are, stand in the first words (MSC Nastran and NX Nastran DMAP Programmer's Guide, data block OUG):
approach code · 10 + device, sort code · 1000 + table code. The sort code is the sum of 1 for
complex values, 2 for SORT2 and 4 for results of random analysis.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ringtrue.core.arrays import Any_, Bool, Float, Int
from ringtrue.decks.nastran.results.op2 import Op2Table, read_tables
from ringtrue.decks.nastran.results.recorded import (
    RecordedDeflections,
    RecordedModes,
    RecordedResponses,
    deflections,
    gathered,
    motions,
    responses,
)
from ringtrue.errors import DataError, about
from ringtrue.io.foreign.door import door

_APPROACHES = {
    1: "statics",
    2: "modes",
    5: "frequency response",
    6: "transient response",
    8: "buckling",
    9: "complex modes",
    10: "nonlinear statics",
}
_QUANTITIES = {
    1: "displacements",
    6: "eigenvalues",
    7: "eigenvectors",
    10: "velocities",
    11: "accelerations",
}
_SCALAR = 2  # type of a scalar point; extra and modal points have larger ones
_POLAR = 3  # format code of magnitude and phase
_REAL = 8  # words a node: key, type, six numbers
_COMPLEX = 14  # the same with twelve
# the largest number of a set; as an integer every real above 1e-35 is larger
_MOST = 99_999_999
# The names are whole: ROUGV1 (motion relative to a moved base), BOPHIGF (of a fluid), LAMAF and
# GEOM1EX are others. Blocks in SORT2 end with 2.
_LAMA = frozenset({"LAMA", "LAMAS"})
_GEOMETRY = frozenset({"GEOM1", "GEOM1S", "GEOM1N"})
_IN_BASIC = frozenset({"BOUGV1", "BOUGV2", "BOPHIG", "BOPHG2"})  # PARAM,OUGCORD,BASIC
_SHAPES = (
    frozenset({"OUG1", "OUG2", "OUGV1", "OUGV2", "OPHIG", "OPHG1", "OPHG2", "OPHIG2"})
    | _IN_BASIC
)
_RESPONSES = _SHAPES | {"OVG1", "OVG2", "OAG1", "OAG2"}


Pair = tuple[bytes, bytes]  # what a record is, and the record


@dataclass(frozen=True, slots=True)
class _Identity:
    """What the first words of a data block of motions say."""

    approach: str
    quantity: str
    by_node: bool
    width: int

    @property
    def continuous(self) -> bool:
        """Whether its rows are known by a real, the frequency."""
        return self.approach == "frequency response"

    @property
    def words(self) -> str:
        """Such as "complex displacements of frequency response, SORT2"."""
        form = "" if self.width == _REAL else "complex "
        by = ", SORT2" if self.by_node else ""
        return f"{form}{self.quantity} of {self.approach}{by}"


def _identity(table: Op2Table) -> _Identity | None:
    """Of a table of motions; None of another, and of results of random analysis."""
    if len(table.records) < 2 or not table.records[1].blocks:
        return None
    words = table.ints(table.records[1].blocks[0])  # without a copy of the whole table
    if words.size < 10:
        return None
    sort, code = divmod(int(words[1]), 1000)
    approach = _APPROACHES.get(int(words[0]) // 10)
    quantity = _QUANTITIES.get(code)
    if approach is None or quantity is None or sort > 3:
        return None
    return _Identity(approach, quantity, sort >= 2, int(words[9]))


def described(table: Op2Table) -> str:
    """What a table of motions holds by its codes, " (displacements of statics)"; "" of another."""
    if not table.name.lstrip("BRT").startswith(("OUG", "OPH", "OVG", "OAG")):
        return ""
    found = _identity(table)
    return "" if found is None else f" ({found.words})"


@dataclass(frozen=True, slots=True, eq=False)
class _Moved:
    """The motion of all nodes in one mode, case or at one frequency.

    Attributes
    ----------
    key : int or float
        Number of the mode or case, or the frequency in Hz.
    case : int
        Of the subcase.
    eigenvalue : float
        NaN where the table does not say.
    nodes : (n,) int64
    scalar : (n,) bool
    motion : (n, 6) float64 or complex128
    """

    key: float
    case: int
    eigenvalue: float
    nodes: Int
    scalar: Bool
    motion: Any_

    @property
    def row(self) -> tuple[Int, Bool, Any_]:
        return self.nodes, self.scalar, self.motion


def _moved(table: Op2Table, found: _Identity) -> Iterator[_Moved]:
    """What a table holds, a mode, case or frequency after the other, whichever way it is sorted."""
    data = table.bodies()
    pairs = list(zip(data[::2], data[1::2], strict=True))
    if found.by_node:
        cases: dict[int, list[Pair]] = {}
        for pair in pairs:
            cases.setdefault(int(table.ints(pair[0])[3]), []).append(pair)
        for mine in cases.values():
            yield from _of_nodes(table, found, mine)
        return
    for ident, body in pairs:
        words = table.ints(ident)
        reals = table.floats(ident)
        kind, motion = _points(table, words, body)
        keep = kind <= _SCALAR
        value = float(reals[5]) if found.approach == "modes" else np.nan
        yield _Moved(
            key=float(table.decimals(reals[4:5])[0])
            if found.continuous
            else int(words[4]),
            case=int(words[3]),
            eigenvalue=value,
            nodes=table.ints(body).reshape(-1, found.width)[keep, 0] // 10,
            scalar=kind[keep] == _SCALAR,
            motion=motion[keep],
        )


def _of_nodes(
    table: Op2Table, found: _Identity, pairs: Sequence[Pair]
) -> Iterator[_Moved]:
    """What a subcase in SORT2 holds: the records of each node, put together by mode, case or
    frequency.
    """
    lengths = {(len(ident), len(body)) for ident, body in pairs}
    whole = b"".join(body for _, body in pairs)
    idents = table.ints(b"".join(ident for ident, _ in pairs)).reshape(len(pairs), -1)
    if len(lengths) == 1:
        kind, motion = _points(table, idents[0], whole)
        keys = _keys(table, found, whole).reshape(len(pairs), -1)
    if len(lengths) > 1 or (keys != keys[0]).any():
        raise DataError(
            f"table {table.name}: its nodes are not all given at the same rows of "
            f"{found.approach}: the file is cut off or damaged"
        )
    kind = kind.reshape(keys.shape)[:, 0]
    motion = motion.reshape(*keys.shape, 6)
    keep = kind <= _SCALAR
    for k, key in enumerate(keys[0].tolist()):
        yield _Moved(
            key=key,
            case=int(idents[0, 3]),
            eigenvalue=np.nan,
            nodes=idents[keep, 4] // 10,
            scalar=kind[keep] == _SCALAR,
            motion=motion[keep, k],
        )


def _keys(table: Op2Table, found: _Identity, body: bytes) -> Any_:
    """The first word of each row in SORT2: a frequency, else a number, which some write as a
    real.
    """
    reals = table.decimals(table.floats(body)[:: found.width])
    if found.continuous:
        return reals
    whole = table.ints(body)[:: found.width]
    written = (whole > 0) & (whole <= _MOST)
    return np.where(
        written, whole, np.rint(np.where(written, 0.0, reals)).astype(np.int64)
    )


def _points(table: Op2Table, words: Int, body: bytes) -> tuple[Int, Any_]:
    """Types of points (n,), and motion (n, 6), real or complex, of the rows of a record.

    Parameters
    ----------
    words : (k,) int64
        What the record is.
    """
    width = int(words[9])
    if width not in (_REAL, _COMPLEX) or not body or len(body) % (width * table.word):
        raise DataError(
            f"table {table.name}: a record of {len(body)} bytes is not of {width} words a node"
        )
    kind = table.ints(body).reshape(-1, width)[:, 1]
    values = table.floats(body).reshape(-1, width)[:, 2:]
    motion: NDArray[Any] = values.copy()
    if width == _COMPLEX and int(words[8]) == _POLAR:
        motion = values[:, :6] * np.exp(1j * np.deg2rad(values[:, 6:]))
    elif width == _COMPLEX:
        motion = values[:, :6] + 1j * values[:, 6:]
    motion[kind == _SCALAR, 1:] = 0.0
    return kind, motion


def read_op2(path: str | Path) -> RecordedModes:
    """Modes of an OP2 file: the first table of real eigenvectors, with LAMA's eigenvalues and modal
    masses.

    Tables are known by their names (OUG1, OUGV1, OPHIG, OPHG1; BOUGV1, BOPHIG in the basic frame;
    of SORT2 those that end with 2) and their codes.

    Raises
    ------
    DataError
        If the file is damaged or holds no real modes.
    """
    lama: tuple[Float, Float] | None = None
    shapes: list[Op2Table] = []
    frames: dict[int, int] = {}
    others: list[str] = []
    held: dict[str, str] = {}
    for table in read_tables(path):
        held[table.name] = held.get(table.name) or described(table)
        if table.name in _LAMA:
            lama = lama or _lama(table)
        elif table.name in _GEOMETRY:
            frames |= _frames(table)
        elif _holds(table, "modes", "eigenvectors") and table.name not in _SHAPES:
            others.append(table.name)
        elif _holds(table, "modes", "eigenvectors"):
            if shapes and shapes[0].name in _IN_BASIC and table.name not in _IN_BASIC:
                shapes = []
            # MYSTRAN writes a table for each mode
            if not shapes or shapes[0].name == table.name:
                shapes.append(table)
    if not shapes:
        but = ""
        if others:
            named = ", ".join(dict.fromkeys(others))
            but = f" but those of {named}, which are not of the whole structure"
        raise DataError(
            f"{path}: no real eigenvectors in a table {', '.join(sorted(_SHAPES))}{but}; the file "
            f"holds {', '.join(name + what for name, what in held.items()) or 'nothing'}; "
            "ask for DISPLACEMENT(PLOT) = ALL and PARAM,POST,-1"
        )
    with about(path), door(path, "OP2 file"):
        return _gather(shapes, lama, frames)


def _gather(
    shapes: list[Op2Table], lama: tuple[Float, Float] | None, frames: dict[int, int]
) -> RecordedModes:
    found: list[_Moved] = []
    for table in shapes:
        for moved in _moved(table, _known(table)):
            if found and moved.key <= found[-1].key:  # the next subcase
                break
            found.append(moved)
    modes = np.array([m.key for m in found], dtype=np.int64)
    lam = np.array([m.eigenvalue for m in found])
    mass = np.full(len(found), np.nan)
    if (
        lama is not None
        and modes.size
        and modes.max() <= lama[0].size
        and modes.min() > 0
    ):
        lam = lama[0][modes - 1]
        mass = lama[1][modes - 1]
    if np.isnan(lam).any():
        raise DataError(
            f"table {shapes[0].name} is in SORT2, which has no eigenvalues, and the file has no "
            "LAMA of these modes: ask for SORT1"
        )
    rows = [m.row for m in found]
    if shapes[0].name in _IN_BASIC:
        frames = dict.fromkeys(rows[0][0].tolist(), 0) if rows else {}
    return gathered(lam, mass, rows, frames)


def read_op2_deflections(path: str | Path) -> RecordedDeflections | None:
    """Displacements of the static subcases of an OP2 file; None of a file without.

    In SORT2 a case is known by its load set.

    Raises
    ------
    DataError
        If the file is damaged, or the subcases are given at different nodes.
    """
    cases: list[int] = []
    rows = []
    frames: dict[int, int] = {}
    basic = False
    with about(path), door(path, "OP2 file"):
        for table in read_tables(path, lambda name: name in _GEOMETRY | _SHAPES):
            if table.name in _GEOMETRY:
                frames |= _frames(table)
            elif _holds(table, "statics", "displacements"):
                basic = table.name in _IN_BASIC
                found = _known(table)
                for moved in _moved(table, found):
                    cases.append(int(moved.key) if found.by_node else moved.case)
                    rows.append(moved.row)
        if not rows:
            return None
        if basic:
            frames = dict.fromkeys(rows[0][0].tolist(), 0)
        m = motions(rows, frames)
    return deflections(m, tuple(cases))


def read_op2_responses(path: str | Path) -> tuple[RecordedResponses, ...]:
    """Displacements, velocities and accelerations of frequency responses, of each subcase.

    Raises
    ------
    DataError
        If the file is damaged, or one subcase is given at different nodes.
    """
    frames: dict[int, int] = {}
    found: dict[tuple[int, str], list[_Moved]] = {}
    basic: set[tuple[int, str]] = set()
    with about(path), door(path, "OP2 file"):
        for table in read_tables(path, lambda name: name in _GEOMETRY | _RESPONSES):
            known = _identity(table)
            if table.name in _GEOMETRY:
                frames |= _frames(table)
            elif known is not None and known.continuous:
                for moved in _moved(table, known):
                    of = (moved.case, known.quantity)
                    found.setdefault(of, []).append(moved)
                    basic |= {of} if table.name in _IN_BASIC else set()
        out = []
        for (case, quantity), rows in found.items():
            own = (
                dict.fromkeys(rows[0].nodes.tolist(), 0)
                if (case, quantity) in basic
                else frames
            )
            m = motions([r.row for r in rows], own)
            out.append(responses(m, np.array([r.key for r in rows]), quantity, case))
    return tuple(out)


def _holds(table: Op2Table, approach: str, quantity: str) -> bool:
    """Whether a table says that it holds such real motions."""
    found = _identity(table) if len(table.records) > 2 else None
    if found is None or found.width != _REAL:
        return False
    return (found.approach, found.quantity) == (approach, quantity)


def _known(table: Op2Table) -> _Identity:
    """The identity of a table that is known to have one."""
    found = _identity(table)
    assert found is not None
    return found


def _lama(table: Op2Table) -> tuple[Float, Float] | None:
    """Eigenvalues and modal masses; words: mode, order, λ, ω, f, mass, stiffness."""
    data = table.bodies()
    if len(data) < 2 or len(data[1]) % (7 * table.word):
        return None
    known = _identity(table)
    if known is None or (known.approach, known.quantity) != ("modes", "eigenvalues"):
        return None
    rows = table.floats(data[1]).reshape(-1, 7)
    return rows[:, 2], rows[:, 5]


def _frames(table: Op2Table) -> dict[int, int]:
    """The displacement frame of each GRID; coordinates are single or (in newer files) double
    precision.
    """
    for data in table.bodies():
        words = table.ints(data)
        if tuple(words[:2].tolist()) == (4501, 45):  # GRID
            body = words[3:]
            double = table.word == 4 and words[2] not in (1, 0) and body.size % 11 == 0
            width, cd = (11, 8) if double else (8, 5)
            if body.size % width == 0:
                rows = body.reshape(-1, width)
                return dict(zip(rows[:, 0].tolist(), rows[:, cd].tolist(), strict=True))
    return {}
