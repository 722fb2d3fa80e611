"""A rank of the `slepc` solver: the distributed matrices, in a Python that has slepc4py and needs
no ringtrue.

    mpiexec -n 4 python slepc_worker.py FOLDER COMMAND ...

(without a folder: nothing but its imports) starts on each rank the command, a process with ringtrue
(`slepc_share`), which assembles a share of the elements and asks by pipe for what is to be done
with all of them: sums over the ranks, matrices, modes, solutions. All ranks are asked the same. The
eigensolver is Krylov-Schur with shift-invert (Stewart, 2001) over MUMPS' LDLᵀ, for a band with
spectrum slicing (Campos & Roman, Numer. Algorithms 60, 2012); inertia counts prove both.
"""

from __future__ import annotations

import os
import subprocess
import sys
import traceback
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

# first: it finds the MPI library that the others were built with
from mpi4py import MPI


def find_debian(root: Path) -> None:
    """Make petsc4py and slepc4py of Debian importable, which stand in folders named after version
    and architecture; those that are importable or that PETSC_DIR and SLEPC_DIR name come first.
    """
    for name in ("petsc", "slepc"):
        variable = f"{name.upper()}_DIR"
        if variable in os.environ or find_spec(f"{name}4py"):
            continue
        found = sorted(
            root.glob(f"{name}dir/{name}*/*-real/lib/python3/dist-packages/{name}4py")
        )
        if found:
            os.environ[variable] = str(found[-1].parents[3])
            sys.path.append(str(found[-1].parent))


find_debian(Path("/usr/lib"))
from petsc4py import PETSc  # noqa: E402
from slepc4py import SLEPc  # noqa: E402
from wire import make_file, receive, send, write_columns  # type: ignore[import-not-found]  # noqa: E402

MUMPS = {
    f"{p}mat_mumps_{k}": v
    for p in ("", "st_")
    for k, v in (("icntl_13", 1), ("icntl_24", 1), ("cntl_3", 1e-12))
}  # for inertia: see SLEPc's manual
COMM = MPI.COMM_WORLD
TOGETHER = 64  # columns that a factor solves for at a time
ITERATIONS = 500


def owned(n: int, rank: int) -> tuple[int, int]:
    """The first row of a rank, and that behind its last."""
    return rank * n // COMM.size, (rank + 1) * n // COMM.size


def sent(owner: Any, *columns: Any) -> list[Any]:
    """Entries (k,) of columns, each sent to the rank that owns it (k,)."""
    order = np.argsort(owner, kind="stable")
    out = np.bincount(owner, minlength=COMM.size)
    there = np.empty_like(out)
    COMM.Alltoall(out, there)
    received = []
    for column in columns:
        mine = np.empty((int(there.sum()), *column.shape[1:]), dtype=column.dtype)
        width = int(np.prod(column.shape[1:], dtype=int))
        COMM.Alltoallv(
            [np.ascontiguousarray(column[order]), out * width], [mine, there * width]
        )
        received.append(mine)
    return received


def owner_of(row: Any, n: int) -> Any:
    """The rank that owns each row."""
    return np.searchsorted(
        [owned(n, r)[1] for r in range(COMM.size)], row, side="right"
    )


def assembled(n: int, data: Any, row: Any, column: Any) -> Any:
    """The symmetric matrix (n, n) of the entries of all ranks, summed by the owners of the rows."""
    data, row, column = sent(owner_of(row, n), data, row, column)
    order = np.lexsort((column, row))
    first, last = owned(n, COMM.rank)
    row = row[order] - first
    column = column[order]
    new = np.ones(row.size, dtype=bool)
    new[1:] = (np.diff(row) != 0) | (np.diff(column) != 0)
    start = np.flatnonzero(new)
    summed = np.add.reduceat(data[order], start) if start.size else data
    ends = np.concatenate(
        [[0], np.cumsum(np.bincount(row[start], minlength=last - first))]
    )
    own = (ends.astype(PETSc.IntType), column[start].astype(PETSc.IntType), summed)
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


def factored(K: Any, M: Any, cut: float) -> Any:
    """A MUMPS factor of K − cut M."""
    A = K.copy()
    A.axpy(-cut, M, structure=PETSc.Mat.Structure.DIFFERENT)
    A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    ksp = PETSc.KSP().create(PETSc.COMM_WORLD)
    ksp.setOperators(A)
    # the solver holds it; nothing that PETSc has made ends with its Python object
    A.destroy()
    cholesky(ksp)
    ksp.setUp()
    return ksp


def below(ksp: Any) -> int:
    """Number of eigenvalues under a shift: the negative pivots of its LDLᵀ (Sylvester)."""
    return int(ksp.getPC().getFactorMatrix().getInertia()[0])


def below_cut(K: Any, M: Any, cut: float) -> int:
    """Number of eigenvalues under `cut`; its factor is not kept."""
    ksp = factored(K, M, cut)
    count = below(ksp)
    ksp.destroy()
    return count


class OwnedRows:
    """The rows that this rank owns of the matrices and of the modes that were found last.

    Attributes
    ----------
    K, M : Mat
    values : (n,) float64
        All that were found, ascending.
    vectors : (rows, n) float64
        Of unit modal mass.
    factor : KSP
        Of K − σM, from the solution for the modes.
    solution : EPS or None
        That owns the factor.
    """

    factor: Any = None
    solution: Any = None

    def matrices(self, n: int, *entries: Any) -> None:
        """Assemble K and M (n, n) of entries (data, row, column) of both."""
        self.size = n
        self.K = assembled(n, *entries[:3])
        self.M = assembled(n, *entries[3:])

    def lowest(self, count: int, shift: float) -> dict[str, Any]:
        """The lowest modes, and whether counts agree."""
        n = self.size
        eps = solver(self.K, self.M, shift)
        eps.setTarget(shift)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        eps.setDimensions(min(count + 4, n))  # a few above those asked for
        eps.solve()
        values = np.sort([eps.getEigenvalue(i).real for i in range(eps.getConverged())])
        if values.size < 2:
            self.keep(eps, eps.getST().getKSP())
            return {
                "complete": False,
                "proof": "too few eigenvalues converged to count any",
            }
        upper = values[min(max(min(count, values.size), 2) - 1, values.size - 2) :]
        gap = int(np.argmax(np.diff(upper)))
        cut = 0.5 * (upper[gap] + upper[gap + 1])
        found = int((values < cut).sum())
        factor = eps.getST().getKSP()
        there = below_cut(self.K, self.M, cut) - below(factor)
        if found != there:
            eps.destroy()
            return self.band(shift, cut)
        self.keep(eps, factor)
        proof = (
            f"{there} eigenvalues below {cut:.6g} (rad/s)^2 by inertia, {found} found"
        )
        return {"complete": True, "proof": proof}

    def band(self, low: float, high: float) -> dict[str, Any]:
        """All modes of low <= λ <= high, and whether counts agree."""
        eps = solver(self.K, self.M, low)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.ALL)
        eps.setInterval(low, high)
        eps.setKrylovSchurDetectZeros(True)
        eps.solve()
        found = eps.getConverged()
        there = below_cut(self.K, self.M, high)
        factor = factored(self.K, self.M, low)
        there -= below(factor)
        self.keep(eps, factor)
        proof = (
            f"{there} eigenvalues from {low:.6g} to {high:.6g} (rad/s)^2 by "
            f"inertia, {found} found"
        )
        return {"complete": found == there, "proof": proof}

    def keep(self, eps: Any, factor: Any) -> None:
        """Take over what was found: Rayleigh quotients, unit modal mass, the largest component
        positive.
        """
        count = eps.getConverged()
        values = np.array([eps.getEigenvalue(i).real for i in range(count)])
        if self.solution is not None:
            self.factor.destroy()
            self.solution.destroy()
        self.solution = eps
        x = self.K.createVecRight()
        vectors = np.empty((x.getLocalSize(), count), order="F")
        for k, i in enumerate(np.argsort(values, kind="stable").tolist()):
            eps.getEigenvector(i, x)
            vectors[:, k] = x.getArray()
        x.destroy()
        mass = self.times(self.M, vectors)
        vectors *= self.signs(vectors) / np.sqrt(dots(vectors, mass))
        values = dots(vectors, self.times(self.K, vectors))
        order = np.argsort(values, kind="stable")
        self.values = values[order]
        self.vectors = vectors[:, order]
        self.factor = factor

    def signs(self, x: Any) -> Any:
        """1 or -1 for each column: the sign of its component of the largest size."""
        at = np.abs(x).argmax(axis=0) if len(x) else np.zeros(x.shape[1], dtype=int)
        top = x[at, np.arange(at.size)] if len(x) else np.zeros(at.size)
        every = np.array(COMM.allgather(top)).reshape(COMM.size, -1)
        whole = every[np.abs(every).argmax(axis=0), np.arange(every.shape[1])]
        return np.where(whole < 0, -1.0, 1.0)

    def times(self, A: Any, x: Any) -> Any:
        """A times columns (rows, k)."""
        if not x.shape[1]:
            return x
        given = self.dense(x)
        made = A.matMult(given)
        return taken(made, given)

    def solved(self, x: Any) -> Any:
        """(K − σM)⁻¹ times columns (rows, k)."""
        given = self.dense(x)
        made = self.dense(np.zeros_like(x))
        self.factor.getPC().getFactorMatrix().matSolve(given, made)
        return taken(made, given)

    def combined(self, x: Any, stiffness: float, mass: float) -> Any:
        """(k K + m M) times columns (rows, n), for two factors k and m."""
        pairs = [(f, A) for f, A in ((stiffness, self.K), (mass, self.M)) if f]
        return sum(f * self.times(A, x) for f, A in pairs)

    def responses(self, row: Any, loads: Any, modes: int) -> Any:
        """Static responses (rows, k) of K − σM to loads of all ranks on some rows (l, k), both free
        of the lowest modes.
        """
        row, loads = sent(owner_of(row, self.size), row, loads)
        first, last = owned(self.size, COMM.rank)
        phi = self.vectors[:, :modes]
        mass = self.times(self.M, phi)
        out = np.empty((last - first, loads.shape[1]))
        for at in range(0, loads.shape[1], TOGETHER):
            cut = slice(at, at + TOGETHER)
            r = np.zeros((last - first, loads[:, cut].shape[1]))
            np.add.at(r, row - first, loads[:, cut])
            y = self.solved(r - mass @ summed(phi.T @ r))
            out[:, cut] = y - phi @ summed(mass.T @ y)
        return out

    def dense(self, x: Any) -> Any:
        """Columns (rows, k) as a matrix of all ranks."""
        size = ((len(x), self.size), (None, x.shape[1]))
        made = PETSc.Mat().createDense(
            size, array=np.asfortranarray(x), comm=PETSc.COMM_WORLD
        )
        made.assemble()
        return made

    def residuals(self, count: int) -> Any:
        """‖Kφ − λMφ‖ / ‖Kφ‖ of the lowest modes, of rigid-body modes relative to ‖diag(K) φ‖."""
        phi = self.vectors[:, :count]
        k = self.times(self.K, phi)
        rest = k - self.times(self.M, phi) * self.values[:count]
        d = self.K.getDiagonal().getArray()[:, None] * phi
        rest, size, whole = (np.sqrt(dots(a, a)) for a in (rest, k, d))
        return rest / np.where(size > 1e-8 * whole, size, np.maximum(whole, 1e-300))

    def write(self, path: str, columns: Any) -> None:
        """Columns (rows, k) as rows of a file (k, n), of which each rank writes its part."""
        if COMM.rank == 0:
            make_file(path, (columns.shape[1], self.size))
        COMM.Barrier()
        write_columns(path, owned(self.size, COMM.rank)[0], columns.T)
        COMM.Barrier()

    def columns(self, lam: Any, row: Any, loads: Any, tolerance: float) -> Any:
        """z (rows, k) of (K − λM) z = r in the M-orthogonal complement of the modes, for λ (k,) and
        loads r of all ranks on some rows (l, k); TOGETHER at a time.
        """
        row, loads = sent(owner_of(row, self.size), row, loads)
        first, last = owned(self.size, COMM.rank)
        mass = self.times(self.M, self.vectors)
        z = np.empty((last - first, lam.size))
        for at in range(0, lam.size, TOGETHER):
            cut = slice(at, at + TOGETHER)
            r = np.zeros((last - first, lam[cut].size))
            np.add.at(r, row - first, loads[:, cut])
            z[:, cut] = self.complement(lam[cut], r, mass, tolerance)
        return z

    def complement(self, lam: Any, r: Any, mass: Any, tolerance: float) -> Any:
        """z (rows, k) for loads r (rows, k), which are overwritten; `mass` is M times the modes.

        Conjugate gradients, preconditioned by the factor of K − σM: in the complement of all modes
        up to λ both are positive definite, and their quotient lies between that at the next mode
        and 1.

        Raises
        ------
        ArithmeticError
            If the modes that are known do not reach beyond λ.
        """
        phi = self.vectors
        r -= mass @ summed(phi.T @ r)
        limit = tolerance**2 * dots(r, r)
        z = np.zeros_like(r)
        y = self.solved(r)
        y -= phi @ summed(mass.T @ y)
        p = y.copy()
        rho = dots(r, y)
        live = np.flatnonzero(rho > 0)
        if not live.size:
            return z
        for _ in range(ITERATIONS):
            q = (
                self.times(self.K, p[:, live])
                - self.times(self.M, p[:, live]) * lam[live]
            )
            q -= mass @ summed(phi.T @ q)
            energy = dots(p[:, live], q)
            if (energy <= 0).any():
                break
            step = rho[live] / energy
            z[:, live] += step * p[:, live]
            r[:, live] -= step * q
            live = live[dots(r[:, live], r[:, live]) > limit[live]]
            if not live.size:
                return z
            y = self.solved(r[:, live])
            y -= phi @ summed(mass.T @ y)
            now = dots(r[:, live], y)
            p[:, live] = y + now / rho[live] * p[:, live]
            rho[live] = now
        raise ArithmeticError("derivatives of modes did not converge")


def taken(made: Any, given: Any) -> Any:
    """The rows (rows, k) of a dense matrix that this rank owns; it and what it was made of end."""
    rows = np.array(made.getDenseArray(), order="F")
    made.destroy()
    given.destroy()
    return rows


def summed(a: Any) -> Any:
    """The sum over all ranks."""
    out = np.empty(a.shape)
    COMM.Allreduce(np.ascontiguousarray(a), out)
    return out


def dots(a: Any, b: Any) -> Any:
    """Products (k,) of columns (rows, k) of all ranks."""
    return summed(np.einsum("ij,ij->j", a, b))


def answered(
    rank: OwnedRows, asked: dict[str, Any], arrays: list[Any]
) -> tuple[dict[str, Any], Any]:
    """Values and arrays that answer a request."""
    what = asked["do"]
    if what == "sum":
        return {}, (summed(arrays[0]),)
    if what == "gather":
        return {}, (np.concatenate(COMM.allgather(arrays[0])),)
    if what == "matrices":
        rank.matrices(asked["size"], *arrays)
        return {}, ()
    if what == "modes":
        if asked["band"] is None:
            answer = rank.lowest(asked["count"], asked["shift"])
            count = min(asked["count"], rank.values.size)
        else:
            answer = rank.band(*asked["band"])
            count = rank.values.size
        answer["proof"] += f" (SLEPc, {COMM.size} ranks)"
        rank.write(asked["path"], rank.vectors)
        return answer, (rank.values, rank.residuals(count))
    if what == "times":
        return {}, (rank.combined(arrays[0], asked["stiffness"], asked["mass"]),)
    if what == "responses":
        return {}, (rank.responses(arrays[0], arrays[1], asked["modes"]),)
    lam, row, loads = arrays
    rank.write(asked["path"], rank.columns(lam, row, loads, asked["tolerance"]))
    return {}, ()


def main(folder: str, command: list[str]) -> None:
    """Answer what the share asks for until it ends."""
    options = PETSc.Options()
    for name, value in MUMPS.items():
        options[name] = value
    child = subprocess.Popen(
        [*command, folder, str(COMM.rank), str(COMM.size)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert child.stdin is not None
    assert child.stdout is not None
    rank = OwnedRows()
    while (message := receive(child.stdout)) is not None:
        send(child.stdin, *answered(rank, *message))
    status = child.wait()
    if status:
        COMM.Abort(status)


if __name__ == "__main__" and len(sys.argv) > 1:
    try:
        main(sys.argv[1], sys.argv[2:])
    except BaseException:  # the other ranks would wait for this one
        traceback.print_exc()
        COMM.Abort(1)
