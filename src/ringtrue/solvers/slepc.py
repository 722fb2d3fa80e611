"""SLEPc with MUMPS on MPI ranks, for models that outgrow one process: the ranks assemble, factor
and solve; no process holds a matrix of the whole model.
"""

from __future__ import annotations

import os
import pickle
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.eigen.eigenpairs import eigenvalue, frequencies
from ringtrue.errors import ConfigError, SolverMissing, UnsupportedError
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.parametrisation.element_derivatives import moves
from ringtrue.io.foreign.arrays import read_npy
from ringtrue.io.foreign.parsers import read_json
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest, ModesResult
from ringtrue.model.superelements import condenses
from ringtrue.reduction.basis import ProjectedSystem
from ringtrue.reduction.projected import HeldModel
from ringtrue.solvers import slepc_share
from ringtrue.solvers.runner import Running
from ringtrue.solvers.slepc_basis import BASIS, CHANGES, PROJECTED, AskedBasis, AskedChanges
from ringtrue.solvers.slepc_share import (
    ANSWER,
    LOWEST,
    QUESTION,
    SHAPES,
    Asked,
    ShareQuestion,
    failed,
    place,
    put_object,
)

PYTHON = "RINGTRUE_SLEPC_PYTHON"
WORKER = Path(__file__).with_name("slepc_worker.py")
# this ringtrue, not another that is installed; no variable reaches other hosts
SHARE = (
    f"import sys; sys.path.insert(0, {str(Path(__file__).parents[2])!r}); "
    f"from {slepc_share.__name__} import main; main()"
)
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
        A command of the user's, such as `srun -n 64`; else mpiexec next to that Python or on the
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
    _tried(python)
    return [*words, python]


@cache
def _tried(python: Path) -> None:
    """Raise SolverMissing if a Python has no slepc4py."""
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


class SlepcAnalysis:
    """A model on ranks that assemble it and answer until the analysis ends; see
    `ringtrue.model.ports.Analysis`.

    Shapes are files that the ranks write and this process maps.
    """

    capabilities = frozenset({"modes", "derivatives"})

    def __init__(self, model: Model, command: Sequence[str | Path], *, timeout: float) -> None:
        self.dofs = mesh(model).dofs
        self._model = model
        self._command = command
        self._timeout = timeout
        self._folder = Path(tempfile.mkdtemp(prefix="ringtrue-slepc-"))
        self._ranks: Running | None = None
        self._questions = 0
        self._done: dict[ModesRequest, ModesResult] = {}

    def modes(self, request: ModesRequest) -> ModesResult:
        """Natural modes with residuals and an inertia count.

        Raises
        ------
        SolverFailed
            If a rank fails or writes no modes.
        InputError, UnsupportedError, NumericalError
            Of the model, as of the embedded solver.
        """
        if request not in self._done:
            self._done[request] = self._modes(request)
        return self._done[request]

    def _modes(self, request: ModesRequest) -> ModesResult:
        answer = self._answer(Asked(request))
        shapes = self._written(SHAPES)
        f = frequencies(np.array(answer["values"]))
        modes = ModeSet(
            frequencies=f,
            damping=np.zeros(f.size),
            shapes=shapes.T,
            labels=self.dofs,
            norm=Norm.MASS,
            source="slepc",
        )
        node, direction = (np.array(a, dtype=np.int64) for a in answer["autospc"])
        return ModesResult(
            modes,
            np.array(answer["residuals"]),
            bool(answer["complete"]),
            str(answer["proof"]),
            autospc=DofSet(node, direction),
        )

    def derivatives(self, modes: ModeSet, parameters: ParameterSet) -> tuple[Float, Any_]:
        """∂λ/∂a (m, p) and ∂φ/∂a (dof, m, p) at a = 1 of modes of this analysis.

        Raises
        ------
        UnsupportedError
            If a parameter moves nodes, ends of beams or orientations.
        """
        return self._derivatives(modes, parameters, None)

    def observed_derivatives(
        self, modes: ModeSet, parameters: ParameterSet, readings: sparse.csr_array
    ) -> tuple[Float, Float]:
        """∂λ/∂a (m, p), and those of the shapes at channels (channel, m, p): by adjoint motions of
        the channels where these are fewer than the parameters.

        Raises
        ------
        UnsupportedError
            If a parameter moves nodes, ends of beams or orientations.
        """
        return self._derivatives(modes, parameters, readings)

    def _derivatives(
        self, modes: ModeSet, parameters: ParameterSet, readings: sparse.csr_array | None
    ) -> tuple[Float, Float]:
        if moving := [p.name for p in parameters.parameters if moves(p)]:
            raise UnsupportedError(
                f"slepc: {moving[0]} moves nodes, ends of beams or orientations; the embedded "
                "solver has derivatives of these"
            )
        lam = np.array([eigenvalue(f) for f in modes.frequencies])
        top = float(lam.max(initial=0.0)) * (1 + 1e-9)
        answer = self._answer(Asked(ModesRequest(len(modes)), parameters, top, readings))
        lowest = self._written(LOWEST)
        d_shapes = np.asarray(self._written(SHAPES)).reshape(len(parameters), len(lowest), -1)
        # signs and rotations of the given modes
        turn = np.linalg.lstsq(lowest.T, modes.shapes)[0]
        d_stiffness, d_mass = (np.array(answer[k]) for k in ("stiffness", "mass"))
        change = np.einsum("jm,pjk,km->mp", turn, d_stiffness, turn, optimize=True)
        change -= lam[:, None] * np.einsum("jm,pjk,km->mp", turn, d_mass, turn, optimize=True)
        return change, np.einsum("pjf,jm->fmp", d_shapes, turn, optimize=True)

    def reduced(
        self, parameters: ParameterSet, readings: sparse.csr_array, count: int, fmax: float
    ) -> HeldModel:
        """See `ringtrue.reduction.projected.ReducingAnalysis`.

        Raises
        ------
        UnsupportedError
            As `ringtrue.fem.parametrisation.derivatives.affine_terms`.
        """
        answer = self._answer(AskedBasis(parameters, readings, count, fmax))
        basis: ProjectedSystem = pickle.loads(self._file(PROJECTED).read_bytes())
        vectors = self._file(BASIS)

        def along(some: Sequence[Parameter], combinations: Float) -> tuple[Float, Float]:
            self._answer(AskedChanges(ParameterSet(tuple(some)), vectors, combinations))
            stiffness, mass = np.array(self._written(CHANGES))
            return stiffness, mass

        return HeldModel(
            basis=basis,
            shift=float(answer["shift"]),
            count=int(answer["count"]),
            active=tuple(range(len(parameters))),
            base=np.zeros(len(parameters)),
            along=along,
        )

    def _answer(self, asked: ShareQuestion) -> dict[str, Any]:
        """What the ranks say; arrays are in files that they have written."""
        if self._ranks is None:
            (self._folder / "model.pickle").write_bytes(pickle.dumps(self._model))
            command = (*self._command, WORKER, self._folder, sys.executable, "-c", SHARE)
            self._ranks = Running(command, self._folder, name="slepc")
        self._put(asked)
        target = self._file(ANSWER)
        errors = self._ranks.wait(target, self._timeout, but="error-*.pickle")
        if errors is not None:
            raise failed(errors.read_bytes())
        answer: dict[str, Any] = read_json(target)
        return answer

    def _file(self, what: str) -> Path:
        """A part of the last answer."""
        return place(self._folder, self._questions, what)

    def _written(self, what: str) -> Any_:
        """An array of the last answer, in a file."""
        return read_npy(self._file(what))

    def _put(self, asked: ShareQuestion | None) -> None:
        self._questions += 1
        put_object(self._file(QUESTION), asked)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._ranks is not None:
            self._put(None)
            self._ranks.end(patience=10.0)
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
        """Find the program; the ranks assemble the model when they are first asked.

        Raises
        ------
        SolverMissing
            If mpiexec, the launcher or slepc4py is not installed.
        UnsupportedError
            If the deck is condensed.
        """
        if condenses(model):
            raise UnsupportedError(
                "slepc: the deck is condensed (ASET, QSET or superelements); the embedded solver "
                "condenses as Nastran does"
            )
        return SlepcAnalysis(model, find_slepc(self.launcher, self.ranks), timeout=self.timeout)
