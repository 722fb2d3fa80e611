"""SLEPc with MUMPS under mpiexec, for models that outgrow one process; the matrices go over by
files.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.parameters import ParameterSet
from ringtrue.eigen.eigenpairs import eigenvalue, frequencies, polish
from ringtrue.eigen.shift import start_shift, suitable_shift
from ringtrue.errors import ConfigError, SolverFailed, SolverMissing, UnsupportedError
from ringtrue.fem.assembly import System, assemble, refuse_held
from ringtrue.fem.massless_rotations import without_massless_rotations
from ringtrue.io.foreign.arrays import read_npy
from ringtrue.io.foreign.parsers import read_json
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest, ModesResult
from ringtrue.solvers.runner import run_program, tail

PYTHON = "RINGTRUE_SLEPC_PYTHON"
WORKER = Path(__file__).with_name("slepc_worker.py")
_INSTALL = (
    "install it with `pip install dolfinx-solver-real mpich` in a Python >= 3.12 or with Debian's "
    f"python3-slepc4py-real, and set {PYTHON} to that Python (/usr/bin/python3)"
)


def find_slepc(launcher: str = "", ranks: int = 1) -> list[str | Path]:
    """The command line that starts the Python with slepc4py (RINGTRUE_SLEPC_PYTHON, else this one)
    on all ranks.

    Parameters
    ----------
    launcher : str
        A command of the user's, such as `srun -n 64`; else mpiexec beside that Python or on the
        PATH.
    ranks : int
        Of that mpiexec.

    Raises
    ------
    SolverMissing
        Saying how to install it.
    """
    python = Path(os.environ.get(PYTHON, sys.executable))
    own = python.with_name("mpiexec")
    words: list[str | Path] = list(shlex.split(launcher))
    if not words:
        words = [own if own.is_file() else "mpiexec", "-n", str(ranks)]
    if shutil.which(words[0]) is None:
        where = f"in the folder of {python} or on the PATH" if not launcher else "on the PATH"
        raise SolverMissing(f"slepc: no {Path(words[0]).name} {where}; {_INSTALL}")
    try:
        tried = subprocess.run(
            [python, WORKER],
            capture_output=True,
            stdin=subprocess.DEVNULL,
            timeout=120,
            check=False,
        )
    except OSError as e:
        raise SolverMissing(f"slepc: {python} cannot be started ({e.strerror}); {_INSTALL}") from e
    if tried.returncode:
        why = tried.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
        raise SolverMissing(f"slepc: {python} has no working slepc4py ({''.join(why)}); {_INSTALL}")
    return [*words, python]


class SlepcAnalysis:
    """An assembled model, solved by ranks of their own; see `ringtrue.model.ports.Analysis`."""

    capabilities = frozenset({"modes"})

    def __init__(
        self,
        system: System,
        command: Sequence[str | Path],
        *,
        timeout: float,
    ):
        self.system = system
        self.dofs = system.dofs
        self._command = command
        self._timeout = timeout
        self._folder = Path(tempfile.mkdtemp(prefix="ringtrue-slepc-"))
        for name, matrix in (("K", system.stiffness), ("M", system.mass)):
            # plain arrays that each rank can map and read its rows of
            for part, values in (
                ("p", matrix.indptr.astype(np.int64)),
                ("i", matrix.indices),
                ("x", matrix.data),
            ):
                np.save(self._folder / f"{name}_{part}.npy", values)
        self._shift = start_shift(system.stiffness, system.mass)
        self._done: dict[ModesRequest, ModesResult] = {}

    def modes(self, request: ModesRequest) -> ModesResult:
        """Natural modes with residuals and an inertia count.

        Raises
        ------
        SolverFailed
            If a rank fails or writes no modes.
        """
        if request not in self._done:
            self._done[request] = self._modes(request)
        return self._done[request]

    def _modes(self, request: ModesRequest) -> ModesResult:
        values, vectors, residuals, result = self._solve(request)
        # a shift much nearer to zero than the first elastic mode loses digits
        if (residuals > 1e-7).any():
            self._shift = -suitable_shift(values)
            values, vectors, residuals, result = self._solve(request)
        shapes = self.system.transform @ vectors
        f = frequencies(values)
        modes = ModeSet(
            frequencies=f,
            damping=np.zeros(f.size),
            shapes=shapes,
            labels=self.dofs,
            norm=Norm.MASS,
            source="slepc",
        )
        return ModesResult(modes, residuals, bool(result["complete"]), str(result["proof"]))

    def _solve(self, request: ModesRequest) -> tuple[Float, Float, Float, dict[str, object]]:
        band = None
        if request.band is not None:
            low, high = (eigenvalue(f) for f in request.band)
            band = (self._shift if low <= 0 else low, high)
        count = min(request.count, self.system.stiffness.shape[0])
        job = {"count": count, "band": band, "shift": self._shift}
        (self._folder / "job.json").write_text(json.dumps(job))
        (self._folder / "result.json").unlink(missing_ok=True)
        done = run_program(
            [*self._command, WORKER, self._folder],
            self._folder,
            name="slepc",
            timeout=self._timeout,
        )
        if done.status or not (self._folder / "result.json").is_file():
            raise SolverFailed(f"slepc ended with exit status {done.status}{tail(done.log)}")
        result = read_json(self._folder / "result.json")
        values = np.array(read_npy(self._folder / "values.npy"))
        vectors = np.array(read_npy(self._folder / "vectors.npy")).T
        if not values.size:
            return values, vectors.reshape(self.system.stiffness.shape[0], 0), np.empty(0), result
        values, vectors, residuals, _ = polish(
            self.system.stiffness, self.system.mass, values, vectors
        )
        return values, vectors, residuals, result

    def derivatives(self, modes: ModeSet, parameters: ParameterSet) -> tuple[Float, Any_]:
        """Not offered.

        Raises
        ------
        UnsupportedError
            Always; `capabilities` says so beforehand.
        """
        raise UnsupportedError("slepc gives no derivatives; use the embedded solver")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)


class SlepcSolver:
    """`with SlepcSolver(ranks=4).open(model) as analysis: analysis.modes(ModesRequest(20))`.

    Parameters
    ----------
    ranks : int
        MPI processes; 1 if not given.
    launcher : str
        In place of ranks: what starts them, such as `srun -n 64` or `mpiexec --hostfile h -n 8`.
    timeout : float, s
    """

    name = "slepc"

    def __init__(
        self, *, ranks: int | None = None, launcher: str = "", timeout: float = 24 * 3600.0
    ) -> None:
        if ranks is not None and launcher:
            raise ConfigError(
                f"slepc: {ranks} ranks and the launcher {launcher!r}; the launcher says how many: "
                "leave one of the two out"
            )
        if ranks is not None and ranks < 1:
            raise ConfigError(f"slepc: {ranks} ranks; at least 1")
        self.ranks = ranks or 1
        self.launcher = launcher
        self.timeout = timeout

    def open(self, model: Model, parameters: Sequence[ParameterSet] = ()) -> SlepcAnalysis:
        """Assemble the model and hand its matrices over.

        Raises
        ------
        SolverMissing
            If mpiexec, the launcher or slepc4py is not installed.
        InputError
            If nothing is free to move.
        """
        command = find_slepc(self.launcher, self.ranks)
        system, _ = without_massless_rotations(model, assemble(model))
        refuse_held(system)
        return SlepcAnalysis(system, command, timeout=self.timeout)
