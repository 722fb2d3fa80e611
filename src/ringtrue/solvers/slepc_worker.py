"""The part of the `slepc` solver that runs under mpiexec, in a Python that has slepc4py and needs
no ringtrue.

    mpiexec -n 4 python slepc_worker.py FOLDER

(without a folder: nothing but its imports) reads `job.json` and the rows of K and M that each rank
owns, and writes `values.npy`, `vectors.npy` (mode, dof) and `result.json`. The eigensolver is
Krylov-Schur with shift-invert (Stewart, 2001) over MUMPS' LDLᵀ, for a band with spectrum slicing
(Campos & Roman, Numer. Algorithms 60, 2012); inertia counts prove both.
"""

from __future__ import annotations

import json
import os
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI  # first: it finds the MPI library that the others were built with


def find_debian(root: Path) -> None:
    """Make petsc4py and slepc4py of Debian importable, which stand in folders named after version
    and architecture; those that are importable or that PETSC_DIR and SLEPC_DIR name come first.
    """
    for name in ("petsc", "slepc"):
        variable = f"{name.upper()}_DIR"
        if variable in os.environ or find_spec(f"{name}4py"):
            continue
        found = sorted(root.glob(f"{name}dir/{name}*/*-real/lib/python3/dist-packages/{name}4py"))
        if found:
            os.environ[variable] = str(found[-1].parents[3])
            sys.path.append(str(found[-1].parent))


find_debian(Path("/usr/lib"))
from petsc4py import PETSc  # noqa: E402
from slepc4py import SLEPc  # noqa: E402

MUMPS = {
    f"{p}mat_mumps_{k}": v
    for p in ("", "st_")
    for k, v in (("icntl_13", 1), ("icntl_24", 1), ("cntl_3", 1e-12))
}  # for inertia: see SLEPc's manual


def load(folder: Path, name: str) -> Any:
    """The rows of a symmetric matrix that this rank owns."""
    indptr, indices, data = (
        np.load(folder / f"{name}_{part}.npy", mmap_mode="r") for part in ("p", "i", "x")
    )
    n = indptr.size - 1
    rank = MPI.COMM_WORLD.rank
    size = MPI.COMM_WORLD.size
    first = rank * n // size
    last = (rank + 1) * n // size
    a = int(indptr[first])
    b = int(indptr[last])
    rows = (indptr[first : last + 1] - a).astype(PETSc.IntType)
    own = (rows, indices[a:b].astype(PETSc.IntType), np.array(data[a:b]))
    matrix = PETSc.Mat().createAIJ(
        ((last - first, n), (last - first, n)), csr=own, comm=PETSc.COMM_WORLD
    )
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return matrix


def solver(K: Any, M: Any, shift: float) -> Any:
    """Krylov-Schur for K φ = λ M φ with a MUMPS factor of K − shift M."""
    eps = SLEPc.EPS().create(PETSc.COMM_WORLD)
    eps.setOperators(K, M)
    eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    eps.setType(SLEPc.EPS.Type.KRYLOVSCHUR)
    eps.setTolerances(1e-10, 500)
    st = eps.getST()
    st.setType(SLEPc.ST.Type.SINVERT)
    st.setShift(shift)
    cholesky(st.getKSP())
    return eps


def cholesky(ksp: Any) -> None:
    """A direct solution by MUMPS."""
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.CHOLESKY)
    ksp.getPC().setFactorSolverType("mumps")


def below(K: Any, M: Any, cut: float) -> int:
    """Number of eigenvalues under `cut`: the negative pivots of LDLᵀ (Sylvester)."""
    A = K.copy()
    A.axpy(-cut, M, structure=PETSc.Mat.Structure.DIFFERENT)
    A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    ksp = PETSc.KSP().create(PETSc.COMM_WORLD)
    ksp.setOperators(A)
    cholesky(ksp)
    ksp.setUp()
    return int(ksp.getPC().getFactorMatrix().getInertia()[0])


def lowest(K: Any, M: Any, count: int, shift: float) -> tuple[Any, int, bool, str]:
    """The solver with the lowest modes, how many to take, and whether counts agree."""
    n = K.getSize()[0]
    eps = solver(K, M, shift)
    eps.setTarget(shift)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    eps.setDimensions(min(count + 4, n))  # a few above those asked for
    eps.solve()
    values = np.sort([eps.getEigenvalue(i).real for i in range(eps.getConverged())])
    count = min(count, values.size)
    if values.size < 2:
        return eps, count, False, "too few eigenvalues converged to count any"
    upper = values[min(max(count, 2) - 1, values.size - 2) :]
    gap = int(np.argmax(np.diff(upper)))
    cut = 0.5 * (upper[gap] + upper[gap + 1])
    found = int((values < cut).sum())
    there = below(K, M, cut) - below(K, M, shift)
    if found != there:
        eps.destroy()
        eps, taken, _, proof = band(K, M, shift, cut)
        return eps, min(count, taken), taken == there, proof
    proof = f"{there} eigenvalues below {cut:.6g} (rad/s)^2 by inertia, {found} found"
    return eps, count, True, proof


def band(K: Any, M: Any, low: float, high: float) -> tuple[Any, int, bool, str]:
    """The solver with all modes of low <= λ <= high."""
    eps = solver(K, M, low)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.ALL)
    eps.setInterval(low, high)
    eps.setKrylovSchurDetectZeros(True)
    eps.solve()
    found = eps.getConverged()
    there = below(K, M, high) - below(K, M, low)
    proof = f"{there} eigenvalues from {low:.6g} to {high:.6g} (rad/s)^2 by inertia, {found} found"
    return eps, found, found == there, proof


def gathered(eps: Any, K: Any, count: int) -> tuple[Any, Any]:
    """The lowest `count` values and vectors (mode, dof); on the first rank."""
    values = np.array([eps.getEigenvalue(i).real for i in range(eps.getConverged())])
    order = np.argsort(values, kind="stable")[:count]
    vector = K.createVecRight()
    scatter, whole = PETSc.Scatter.toZero(vector)
    vectors = np.empty((order.size, whole.getLocalSize()))
    for k, i in enumerate(order.tolist()):
        eps.getEigenvector(i, vector)
        scatter.scatter(vector, whole, mode=PETSc.ScatterMode.FORWARD)
        vectors[k] = whole.getArray()
    return values[order], vectors


def main(folder: Path) -> None:
    """Solve the job of a folder."""
    job = json.loads((folder / "job.json").read_text())
    options = PETSc.Options()
    for name, value in MUMPS.items():
        options[name] = value
    K = load(folder, "K")
    M = load(folder, "M")
    if job["band"] is None:
        eps, count, complete, proof = lowest(K, M, job["count"], job["shift"])
    else:
        eps, count, complete, proof = band(K, M, *job["band"])
    values, vectors = gathered(eps, K, count)
    if MPI.COMM_WORLD.rank == 0:
        np.save(folder / "values.npy", values)
        np.save(folder / "vectors.npy", vectors)
        result = {
            "complete": bool(complete),
            "proof": f"{proof} (SLEPc, {MPI.COMM_WORLD.size} ranks)",
        }
        (folder / "result.json").write_text(json.dumps(result))


if __name__ == "__main__" and len(sys.argv) > 1:
    main(Path(sys.argv[1]))
