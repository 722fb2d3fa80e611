"""Models in memory for the element tests: tables with the defaults of the cards, and small
meshes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import eigh

from ringtrue.core.arrays import Float, Int
from ringtrue.fem.assembly import System, assemble
from ringtrue.model.cards import columns
from ringtrue.model.model import CaseControl, Model, Ragged, Table, table


def _defaults(card: str) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for spec in columns(card):
        if not spec.blank and not spec.tail:
            out |= ({spec.other: spec.other_default} if spec.other else {}) | {
                spec.name: spec.default
            }
    return out


def ragged(*rows: Any) -> Ragged:
    """Rows of different length."""
    return Ragged(
        np.concatenate([np.asarray(r) for r in rows]),
        np.cumsum([0, *(len(r) for r in rows)]),
    )


def cards(card: str, **given: Any) -> Table:
    """A table of `card`; scalars are repeated, fields that are not given take their defaults."""
    n = max(len(v) for v in given.values() if isinstance(v, list | np.ndarray | Ragged))
    full = _defaults(card) | given
    names = [k for k in full if k in _defaults(card)] + [
        k for k in full if k not in _defaults(card)
    ]
    made = {
        k: full[k]
        if isinstance(full[k], Ragged | list | np.ndarray)
        else np.full(n, full[k])
        for k in names
    }
    return table(card, **made)


def grid(xyz: Float, **given: Any) -> Table:
    """GRID 1.. at xyz (n, 3)."""
    x = np.asarray(xyz, dtype=float)
    return cards(
        "GRID", ID=np.arange(1, len(x) + 1), X1=x[:, 0], X2=x[:, 1], X3=x[:, 2], **given
    )


def model(*tables: Table, spc: int = 0, mpc: int = 0, **params: Any) -> Model:
    """A model of these tables."""
    return Model({t.card: t for t in tables}, params, CaseControl(spc=spc, mpc=mpc))


def steel(E: float = 2e11, nu: float = 0.3, rho: float = 8000.0, **more: Any) -> Table:
    """MAT1 1."""
    return cards("MAT1", MID=[1], E=E, NU=nu, RHO=rho, **more)


def spc(ids: Int, components: str, sid: int = 1) -> Table:
    """SPC1 of nodes."""
    return cards("SPC1", SID=[sid], C=components, G=ragged(ids))


def square(n: int, a: float, b: float, across: int = 0) -> tuple[Float, Int]:
    """Nodes (., 3) and quads, 1-based, of an a x b plate with n elements along x and `across` (or
    n) along y.
    """
    across = across or n
    x, y = np.meshgrid(
        np.linspace(0, a, n + 1), np.linspace(0, b, across + 1), indexing="ij"
    )
    xyz = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    i = np.arange(len(xyz)).reshape(n + 1, across + 1)
    quads = np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(
        -1, 4
    )
    return xyz, quads + 1


def shells(quads: Int, **columns: Any) -> Table:
    """CQUAD4 1.. with PSHELL 1."""
    g = {f"G{i + 1}": quads[:, i] for i in range(4)}
    return cards("CQUAD4", EID=np.arange(1, len(quads) + 1), PID=1, **g, **columns)


def triangles(quads: Int, **columns: Any) -> Table:
    """CTRIA3 1..: each quad cut along its first diagonal."""
    t = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    g = {f"G{i + 1}": t[:, i] for i in range(3)}
    return cards("CTRIA3", EID=np.arange(1, len(t) + 1) + 100000, PID=1, **g, **columns)


def pshell(t: float, **columns: Any) -> Table:
    """PSHELL 1 of MAT1 1."""
    return cards("PSHELL", PID=[1], MID1=1, T=t, MID2=1, MID3=1, **columns)


def frequencies(system: System, count: int) -> Float:
    """The lowest natural frequencies, Hz, dense; massless DOFs are condensed out."""
    K, M = system.stiffness.toarray(), system.mass.toarray()
    heavy = np.abs(M).sum(axis=1) > 0
    a, o = np.flatnonzero(heavy), np.flatnonzero(~heavy)
    if o.size:
        K = K[np.ix_(a, a)] - K[np.ix_(a, o)] @ np.linalg.solve(
            K[np.ix_(o, o)], K[np.ix_(o, a)]
        )
        M = M[np.ix_(a, a)]
    lam = eigh(K, M, eigvals_only=True, subset_by_index=(0, min(count, a.size) - 1))
    return np.sign(lam) * np.sqrt(np.abs(lam)) / (2 * np.pi)


def modes(m: Model, count: int) -> Float:
    """Frequencies of a model."""
    return frequencies(assemble(m), count)
