"""Cost of derivatives in units of the eigensolution that they follow, on a curved shell strip of
51k DOFs.

    python bench/derivatives.py [--quick | --full]

Derivatives of eigenvalues are right if they are the differences of two eigensolutions, and those
from element products if they are those from sparse matrices; of eigenvectors if they fulfil their
equations. `--full`: eigenvector derivatives to 50 parameters, too.

Not covered: solids, FRFs and complex modes, memory of several processes.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from outcome import Check, Report, arguments, at_most, sized

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
from eigen_shell import shell

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import CardField, Parameter
from ringtrue.eigen.derivatives import MatrixDerivatives, eigenvector_derivatives
from ringtrue.eigen.eigenpairs import EigenModes
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import Pencil
from ringtrue.fem.assembly import assemble
from ringtrue.fem.parametrisation.derivatives import quadratic_forms, system_derivatives
from ringtrue.model.model import Model

MODES, BUFFER, RIGID = 30, 4, 6
Result = TypeVar("Result")
UNIT = "eigensolutions"
TOLERANCE = 1e-6  # of the residuals of eigenvector derivatives
RESIDUAL_MOST = 1.5e-6  # what is asked for, taken from another norm
STEP = 1e-3  # of the factor, for differences
DIFFERENCE_MOST = 1e-4  # the square of the step, where modes are close
ROUNDING = 1e-6  # of the lowest eigenvalues of a thin shell


def timed(work: Callable[[], Result]) -> tuple[Result, float]:
    """The result and the seconds of processor time."""
    start = time.process_time()
    return work(), time.process_time() - start


def moduli(model: Model, groups: int) -> list[Parameter]:
    """Young's modulus and thickness of element sets, no more of them than elements: each is a
    parameter of its own.
    """
    quads = model["CQUAD4"]
    made = []
    for g, rows in enumerate(
        np.array_split(np.arange(len(quads)), min(groups, len(quads)))
    ):
        pid = int(quads["PID"][rows[0]])
        same = tuple(quads.ids[rows[quads["PID"][rows] == pid]].tolist())
        made.append(Parameter(f"E{g}", (CardField("MAT1", pid, "E", same),)))
        made.append(Parameter(f"t{g}", (CardField("PSHELL", pid, "T", same),)))
    return made


def residual(
    pencil: Pencil, modes: EigenModes, slope: MatrixDerivatives, d: Float
) -> float:
    """Largest relative residual of the elastic modes' equations, 2-norm."""
    phi, lam = modes.vectors[:, :MODES], modes.values[:MODES]
    load = slope.stiffness @ phi - (slope.mass @ phi) * lam
    rest = pencil.stiffness @ d - (pencil.mass @ d) * lam + load
    rest -= (pencil.mass @ phi) * np.einsum("fm,fm->m", phi, load)
    elastic = lam > 1e-6 * lam[-1]
    return float(
        (np.linalg.norm(rest, axis=0) / np.linalg.norm(load, axis=0))[elastic].max()
    )


def eigenvalue_derivatives(modes: EigenModes, slopes: list[MatrixDerivatives]) -> Float:
    """(m, p) φᵀ(K' − λM')φ of all modes and parameters."""
    phi = modes.vectors
    columns = [
        np.einsum("fm,fm->m", phi, s.stiffness @ phi - (s.mass @ phi) * modes.values)
        for s in slopes
    ]
    return np.stack(columns, axis=1)


def difference(pencil: Pencil, slope: MatrixDerivatives) -> Float:
    """(m,) derivative of the eigenvalues from two eigensolutions; the matrices are linear in the
    parameter.
    """
    ends = []
    for h in (-STEP, STEP):
        moved = Pencil(
            pencil.stiffness + h * slope.stiffness, pencil.mass + h * slope.mass
        )
        ends.append(solve_modes(moved, MODES + BUFFER).values[:MODES])
    return np.asarray((ends[1] - ends[0]) / (2 * STEP))


def apart(a: Float, b: Float) -> float:
    """Largest difference of two derivatives of the elastic modes over the largest derivative."""
    return float(np.abs(a[RIGID:] - b[RIGID:]).max() / np.abs(b[RIGID:]).max())


def by_differences(values: Float, expected: Float) -> Check:
    """Relative derivatives of eigenvalues to one parameter against differences."""
    return at_most(
        "off differences of eigensolutions by", apart(values, expected), DIFFERENCE_MOST
    )


def by_products(values: Float, expected: Float) -> Check:
    """Derivatives of eigenvalues from element products against those from sparse matrices."""
    return at_most(
        "off those from sparse matrices by", apart(values, expected), ROUNDING
    )


def main() -> None:
    """Run and state."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    nx, ny = sized(options, (34, 22), (112, 74), (112, 74))
    model = shell(nx, ny, regions=25)
    system = assemble(model)
    pencil = Pencil(system.stiffness, system.mass)
    runs = [timed(lambda: solve_modes(pencil, MODES + BUFFER)) for _ in range(3)]
    modes = runs[0][0]
    unit = min(t for _, t in runs)
    # the factor that the modes came from; the inertia count has moved it
    pencil.at(modes.shift)
    phi = modes.vectors[:, :MODES]
    where = f"shell of {pencil.size / 1000:.0f}k DOFs, {MODES} modes"

    fifty = moduli(model, 25)
    slopes, t_slopes = timed(lambda: system_derivatives(model, fifty, system))
    values, t_values = timed(lambda: eigenvalue_derivatives(modes, slopes)[:MODES])
    lam = modes.values[:MODES]
    check = by_differences(values[:, 0] / lam, difference(pencil, slopes[0]) / lam)
    cost = {UNIT: (t_slopes + t_values) / unit, "s a solution": unit}
    report.row(
        f"{where}: eigenvalues by {len(fifty)} parameters, sparse matrices",
        cost,
        [check],
    )

    products, t = timed(lambda: quadratic_forms(model, fifty, system, phi))
    k, m = products
    relative = (k - lam[:, None] * m) / lam[:, None]
    check = by_products(relative, values / lam[:, None])
    report.row(
        f"{where}: eigenvalues by {len(fifty)} parameters, element products",
        {UNIT: t / unit},
        [check],
    )

    for count in sized(options, (6,), (6,), (6, 50)):
        pages = os.times().system
        made, t = timed(
            lambda n=count: eigenvector_derivatives(
                pencil, modes, slopes[:n], count=MODES, tolerance=TOLERANCE
            )
        )
        pages = os.times().system - pages
        worst = max(
            residual(pencil, modes, slopes[i], made[:, :, i])
            for i in range(0, count, 5)
        )
        cost = {UNIT: t / unit, "of it the system, for fresh memory": pages / unit}
        check = at_most("residual", worst, RESIDUAL_MOST)
        report.row(f"{where}: eigenvectors by {count} parameters", cost, [check])

    report.end()


if __name__ == "__main__":
    main()
