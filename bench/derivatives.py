"""Cost of derivatives in units of the eigensolution that they follow, on a curved shell strip (50k DOFs by default).

    OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 python bench/derivatives.py [--nx 112 --ny 74] [--many]

Not covered: solids, free-free models with many rigid bodies, FRFs and complex modes, memory of several processes.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
from eigen_shell import shell

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import Parameter, Target
from ringtrue.eigen.derivatives import Slope, eigenvalue_derivatives, eigenvector_derivatives
from ringtrue.eigen.factor import Pencil
from ringtrue.eigen.problem import EigenModes
from ringtrue.eigen.responses import adjoint, mac_gradient
from ringtrue.eigen.solve import solve_modes
from ringtrue.fem.assembly import assemble
from ringtrue.fem.derivatives import bilinear, system_derivatives
from ringtrue.model.model import Model

MODES, BUFFER = 30, 4


def timed(work: Callable[[], object]) -> tuple[object, float]:
    """The result and the seconds of processor time."""
    start = time.process_time()
    return work(), time.process_time() - start


def moduli(model: Model, groups: int) -> list[Parameter]:
    """Young's modulus and thickness of element sets, no more of them than elements: each is a parameter of its own."""
    quads = model["CQUAD4"]
    made = []
    for g, rows in enumerate(np.array_split(np.arange(len(quads)), min(groups, len(quads)))):
        pid = int(quads["PID"][rows[0]])
        same = tuple(quads.ids[rows[quads["PID"][rows] == pid]].tolist())
        made.append(Parameter(f"E{g}", (Target("MAT1", pid, "E", same),)))
        made.append(Parameter(f"t{g}", (Target("PSHELL", pid, "T", same),)))
    return made


def residual(pencil: Pencil, modes: EigenModes, slope: Slope, d: Float) -> float:
    """Largest relative residual of the elastic modes' equations, 2-norm."""
    phi, lam = modes.vectors[:, :MODES], modes.values[:MODES]
    load = slope.stiffness @ phi - (slope.mass @ phi) * lam
    rest = pencil.stiffness @ d - (pencil.mass @ d) * lam + load
    rest -= (pencil.mass @ phi) * np.einsum("fm,fm->m", phi, load)
    elastic = lam > 1e-6 * lam[-1]
    return float((np.linalg.norm(rest, axis=0) / np.linalg.norm(load, axis=0))[elastic].max())


def jacobian(model: Model, parameters: list[Parameter], modes: EigenModes, pencil: Pencil, system: object) -> Float:
    """Frequencies' eigenvalues and MAC (2, m, p) by adjoint vectors and element products."""
    rng = np.random.default_rng(0)
    phi = modes.vectors[:, :MODES]
    seen = rng.choice(pencil.size, min(120, pencil.size), replace=False)
    gradient = np.zeros_like(phi)
    gradient[seen] = mac_gradient(phi[seen] + 0.01 * np.abs(phi[seen]).max(axis=0), phi[seen])[1]
    a = adjoint(pencil, modes, gradient, tolerance=1e-6)
    k, m = bilinear(model, parameters, system, np.stack([a.shapes, a.force, a.mass]), a.shapes)  # type: ignore[arg-type]
    return np.stack([k[0] - a.values[:, None] * m[0], a.from_products(k[1], m[1:])])


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--nx", type=int, default=112)
    options.add_argument("--ny", type=int, default=74)
    options.add_argument("--many", action="store_true", help="eigenvector derivatives to 50 parameters, too")
    args = options.parse_args()
    model = shell(args.nx, args.ny, regions=25)
    system = assemble(model)
    pencil = Pencil(system.stiffness, system.mass)
    runs = [timed(lambda: solve_modes(pencil, MODES + BUFFER)) for _ in range(3)]
    modes, unit = runs[0][0], min(t for _, t in runs)
    assert isinstance(modes, EigenModes)
    pencil.at(modes.shift)  # the factor that the modes came from; the inertia count has moved it
    print(f"{pencil.size} DOFs, {MODES} modes; unit: one eigensolution, {unit:.2f} s of processor time")
    fifty = moduli(model, 25)
    slopes, t = timed(lambda: system_derivatives(model, fifty, system))
    assert isinstance(slopes, list)
    _, t2 = timed(lambda: eigenvalue_derivatives(modes, slopes))
    made, values = t / unit, t2 / unit
    print(f"dK/dp, dM/dp as sparse matrices, {len(fifty)} parameters: {made:.3f}; eigenvalues from them: {values:.3f}")
    phi = modes.vectors[:, :MODES]
    _, t = timed(lambda: bilinear(model, fifty, system, phi[None], phi))
    print(f"eigenvalues {MODES} x {len(fifty)} from element products, all told (limit 0.1): {t / unit:.3f}")
    thousand = moduli(model, 500)
    _, t = timed(lambda: jacobian(model, thousand, modes, pencil, system))
    print(f"frequencies and MAC, {MODES} x {len(thousand)} by adjoints (limit 1): {t / unit:.2f}")
    for count, limit in ((6, 1), (50, 5)) if args.many else ((6, 1),):
        pages = os.times().system
        count = min(count, len(slopes))
        d, t = timed(lambda n=count: eigenvector_derivatives(pencil, modes, slopes[:n], count=MODES, tolerance=1e-6))
        pages = os.times().system - pages
        worst = max(residual(pencil, modes, slopes[i], np.asarray(d)[:, :, i]) for i in range(0, count, 5))
        print(
            f"eigenvectors {MODES} x {count} (limit {limit}): {t / unit:.2f}, of it the system, for fresh memory, "
            f"{pages / unit:.2f}; largest relative residual {worst:.1e}"
        )


if __name__ == "__main__":
    main()
