"""How the matrices depend on a parameter: exact polynomial parts, and exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Int
from ringtrue.core.parameters import Parameter
from ringtrue.errors import InputError, UnsupportedError, did_you_mean
from ringtrue.fem.assembly import System, full_matrices, reduced
from ringtrue.fem.kinds import affected, batches
from ringtrue.fem.mesh import Mesh, mesh
from ringtrue.model.model import Model

STEP = 1e-40  # of the complex step; nothing is subtracted, so it costs no digits
CHECK = 1.37  # a factor at which the polynomial must hold
EXACT, NOISE = 1e-10, 1e-13  # relative: not polynomial above, no such power below
_PLACES = """X1 X2 X3 W1A W2A W3A W1B W2B W3B S S1 S2 S3 N1A N2A N1B N2B M1A M2A M1B M2B"""
_GEOMETRY = frozenset(_PLACES.split())
_BOTH_ENDS = {"A": "AB", "I1": "I1B", "I2": "I2B", "I12": "I12B", "J": "JB", "NSM": "NSMB"}


@dataclass(frozen=True, slots=True, eq=False)
class PowerTerm:
    """The part a^power of K(a) and M(a): stiffness and mass (f, f) csr float64."""

    power: int
    stiffness: sparse.csr_array
    mass: sparse.csr_array


def scaled(model: Model, parameter: Parameter, factor: float | complex) -> Model:
    """A copy of the model with the parameter's fields times `factor` (complex for a complex step).

    A PBEAM whose end B equals its end A keeps that.

    Raises
    ------
    InputError
        If a card, id or field is absent, blank or not a real number.
    """
    tables = dict(model.tables)
    for t in parameter.targets:
        where = f"parameter {parameter.name}: {t.card} {t.id} {t.field}"
        if t.card not in tables or tables[t.card].find(np.array([t.id]))[0] < 0:
            raise InputError(f"{where}: no such card in the model")
        table, row = tables[t.card], int(tables[t.card].find(np.array([t.id]))[0])
        if t.field not in table.columns:
            raise InputError(f"{where}: no such field{did_you_mean(t.field, table.columns)}")
        old = table[t.field]
        if old.dtype.kind not in "fc" or np.isnan(old[row]):
            raise InputError(
                f"{where}: must hold a real number, got {'a blank' if old.dtype.kind in 'fc' else old[row]}"
            )
        twin = _BOTH_ENDS.get(t.field) if t.card == "PBEAM" else None
        fields = [t.field, twin] if twin and table[twin][row] == old[row] else [t.field]
        for name in fields:
            column = table[name].astype(np.result_type(table[name], type(factor)))
            column[row] = column[row] * factor
            table = table.with_column(name, column)
        tables[t.card] = table
    return replace(model, tables=tables)


def _targets(parameter: Parameter) -> dict[str, Int]:
    cards = {t.card for t in parameter.targets}
    return {c: np.array([t.id for t in parameter.targets if t.card == c]) for c in sorted(cards)}


def _sample(m: Mesh, rows: dict[str, Int], parameter: Parameter, a: complex) -> list[sparse.csr_array]:
    """Full K and M of the affected elements at the factor a."""
    there = replace(m, model=scaled(m.model, parameter, a))
    parts = [build(there, card, at) for card, build, at in batches(there.model, rows)]
    return list(full_matrices(there, parts))


def _size(A: sparse.csr_array) -> float:
    return float(np.abs(A.data).max(initial=0.0))


def _powers(at: dict[complex, sparse.csr_array]) -> list[sparse.csr_array]:
    """c0..c3 of a cubic from its values at 1, -1, i: perfectly conditioned."""
    even, odd = (at[1] + at[-1]) / 2, (at[1] - at[-1]) / 2
    P, Q = at[1j].real, at[1j].imag
    return [(even + P) / 2, (odd + Q) / 2, (even - P) / 2, (odd - Q) / 2]


def terms(model: Model, parameter: Parameter, system: System) -> tuple[PowerTerm, ...]:
    """The parts of K(a) = K0 + Σ a^power K_power, M likewise, for a common factor a on the parameter's targets.

    The kernels are evaluated at a = 1, -1, i, which gives the coefficients of a cubic without loss of digits, and
    at one further point, which proves that it is one. Only the affected elements are computed.

    Raises
    ------
    UnsupportedError
        If the dependence is not a polynomial of degree three or less.
    InputError
        If a target is not in the model.
    """
    _refuse_geometry(parameter)
    m = mesh(model)
    rows = affected(model, _targets(parameter))
    with np.errstate(all="ignore"):  # a rational dependence may have its pole at one of the points; it is refused
        samples: dict[complex, list[sparse.csr_array]] = {a: _sample(m, rows, parameter, a) for a in (1, -1, 1j, CHECK)}
    parts = []
    for which in range(2):
        at = {a: s[which] for a, s in samples.items()}
        c = _powers(at)
        miss = _size(c[0] + CHECK * c[1] + CHECK**2 * c[2] + CHECK**3 * c[3] - at[CHECK])
        if not miss <= EXACT * _size(at[CHECK]):
            raise UnsupportedError(_not_polynomial(parameter))
        parts.append(c)
    scale = [_size(s) for s in samples[1]]
    found = []
    for power in (1, 2, 3):
        here = [c[power] if _size(c[power]) > NOISE * s else c[power] * 0 for c, s in zip(parts, scale, strict=True)]
        if any(_size(A) for A in here):
            K, M = (reduced(system.transform, A) for A in here)
            found.append(PowerTerm(power, K, M))
    return tuple(found)


def _not_polynomial(parameter: Parameter) -> str:
    fields = ", ".join(sorted({f"{t.card} {t.field}" for t in parameter.targets}))
    return (
        f"parameter {parameter.name} ({fields}): the matrices are not a cubic polynomial of it; "
        "use its derivative (matrix_derivatives) or another field"
    )


def matrix_derivatives(model: Model, parameter: Parameter, system: System) -> tuple[sparse.csr_array, sparse.csr_array]:
    """∂K/∂a and ∂M/∂a at a = 1, (f, f) csr, by a complex step through the kernels (Squire and Trapp 1998).

    Raises
    ------
    UnsupportedError
        If a target is a place or direction, through which no complex step passes.
    InputError
        If a target is not in the model.
    """
    _refuse_geometry(parameter)
    m = mesh(model)
    rows = affected(model, _targets(parameter))
    K, M = (_imaginary(A) for A in _sample(m, rows, parameter, 1 + 1j * STEP))
    return reduced(system.transform, K), reduced(system.transform, M)


def _imaginary(A: sparse.csr_array) -> sparse.csr_array:
    return sparse.csr_array((A.data.imag / STEP, A.indices, A.indptr), shape=A.shape)


def _refuse_geometry(parameter: Parameter) -> None:
    bad = [f"{t.card} {t.field}" for t in parameter.targets if t.field in _GEOMETRY or t.card == "GRID"]
    if bad:
        raise UnsupportedError(
            f"parameter {parameter.name}: {bad[0]} is a place or direction, not a section or material"
        )
