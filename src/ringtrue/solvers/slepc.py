"""SLEPc with MUMPS on MPI ranks, for models that outgrow one process: the ranks assemble, factor
and solve; no process holds a matrix of the whole model.

For reduced models each rank makes the terms of its own elements and holds its rows of the basis, in
a file of all.
"""

from __future__ import annotations

import os
import pickle
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.eigen.eigenpairs import eigenvalue, frequencies
from ringtrue.eigen.shift import shift_below
from ringtrue.errors import ConfigError, SolverMissing, UnsupportedError
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.mesh import applied
from ringtrue.fem.parametrisation.derivatives import by_owner, share_terms
from ringtrue.fem.parametrisation.element_derivatives import element_derivatives, moves
from ringtrue.io.foreign.parsers import read_json, read_npy
from ringtrue.model.case_control import condenses
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest, ModesResult
from ringtrue.reduction.basis import (
    AffineSystem,
    ProjectedSystem,
    StaticSensitivities,
    project,
)
from ringtrue.reduction.dense_models import HeldModel
from ringtrue.reduction.parametric import basis_vectors, modes_of
from ringtrue.solvers import slepc_share
from ringtrue.solvers.runner import Running
from ringtrue.solvers.slepc_share import (
    ANSWER,
    LOWEST,
    QUESTION,
    SHAPES,
    Asked,
    ShareOfModel,
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
        where = (
            f"in the folder of {python} or on the PATH"
            if not launcher
            else "on the PATH"
        )
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
        raise SolverMissing(
            f"slepc: {python} cannot be started ({e.strerror}); {_INSTALL}"
        ) from e
    if tried.returncode:
        why = tried.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
        raise SolverMissing(
            f"slepc: {python} has no working slepc4py ({''.join(why)}); {_INSTALL}"
        )


class SlepcAnalysis:
    """A model on ranks that assemble it and answer until the analysis ends; see
    `ringtrue.model.ports.Analysis`.

    Shapes are files that the ranks write and this process maps.
    """

    capabilities = frozenset({"modes", "derivatives"})

    def __init__(
        self, model: Model, command: Sequence[str | Path], *, timeout: float
    ) -> None:
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

    def derivatives(
        self, modes: ModeSet, parameters: ParameterSet
    ) -> tuple[Float, Any_]:
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
        self,
        modes: ModeSet,
        parameters: ParameterSet,
        readings: sparse.csr_array | None,
    ) -> tuple[Float, Float]:
        if moving := [p.name for p in parameters.parameters if moves(p)]:
            raise UnsupportedError(
                f"slepc: {moving[0]} moves nodes, ends of beams or orientations; the embedded "
                "solver has derivatives of these"
            )
        lam = np.array([eigenvalue(f) for f in modes.frequencies])
        top = float(lam.max(initial=0.0)) * (1 + 1e-9)
        answer = self._answer(
            Asked(ModesRequest(len(modes)), parameters, top, readings)
        )
        lowest = self._written(LOWEST)
        d_shapes = np.asarray(self._written(SHAPES)).reshape(
            len(parameters), len(lowest), -1
        )
        # signs and rotations of the given modes
        turn = np.linalg.lstsq(lowest.T, modes.shapes)[0]
        d_stiffness, d_mass = (np.array(answer[k]) for k in ("stiffness", "mass"))
        change = np.einsum("jm,pjk,km->mp", turn, d_stiffness, turn, optimize=True)
        change -= lam[:, None] * np.einsum(
            "jm,pjk,km->mp", turn, d_mass, turn, optimize=True
        )
        return change, np.einsum("pjf,jm->fmp", d_shapes, turn, optimize=True)

    def reduced(
        self,
        parameters: ParameterSet,
        readings: sparse.csr_array,
        count: int,
        fmax: float,
    ) -> HeldModel:
        """See `ringtrue.reduction.dense_models.ReducingAnalysis`.

        Raises
        ------
        UnsupportedError
            As `ringtrue.fem.parametrisation.derivatives.affine_terms`.
        """
        answer = self._answer(AskedBasis(parameters, readings, count, fmax))
        basis: ProjectedSystem = pickle.loads(self._file(PROJECTED).read_bytes())
        vectors = self._file(BASIS)

        def along(
            some: Sequence[Parameter], combinations: Float
        ) -> tuple[Float, Float]:
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
            command = (
                *self._command,
                WORKER,
                self._folder,
                sys.executable,
                "-c",
                SHARE,
            )
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
        self,
        *,
        ranks: int | None = None,
        launcher: str = "",
        timeout: float = 24 * 3600.0,
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

    def open(
        self, model: Model, parameters: Sequence[ParameterSet] = ()
    ) -> SlepcAnalysis:
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
        return SlepcAnalysis(
            model, find_slepc(self.launcher, self.ranks), timeout=self.timeout
        )


BASIS = "basis.npy"  # (r, free)
PROJECTED = "projected.pickle"
CHANGES = "changes.npy"  # (2, p, m, m)


@dataclass(frozen=True, slots=True, eq=False)
class AskedBasis:
    """A reduced model.

    Attributes
    ----------
    parameters : ParameterSet
    readings : (channel, full) csr float64
    count : int
        Modes that it returns, the lowest.
    fmax : float, Hz
        Up to which these are.
    """

    parameters: ParameterSet
    readings: sparse.csr_array
    count: int
    fmax: float

    def answer(self, own: ShareOfModel, at: Callable[[str], Path]) -> dict[str, Any]:
        """Write the basis and what is projected on it; the shift, and how many modes there are."""
        own.find_lowest(modes_of(self.count), shift_below(own.first_shift, self.fmax))
        count = min(self.count, own.values.size)
        none = sparse.csr_array((own.cols.size,) * 2)
        terms = share_terms(
            own.model, self.parameters, own.transform[:, own.cols], share=own.share
        )
        part = AffineSystem(none, none, self.parameters, terms, none[:0])
        vectors = _vectors(own, part, modes_of(self.count), count)
        own.write_rows(at(BASIS), vectors)
        projected = self._projected(own, part, vectors, read_npy(at(BASIS)))
        if own.share.number == 0:
            put_object(at(PROJECTED), projected)
        return {"shift": own.shift, "count": count}

    def _projected(
        self, own: ShareOfModel, part: AffineSystem, rows: Float, every: Any_
    ) -> ProjectedSystem:
        """Sums over all shares: K and M by the rows of the vectors, terms by their elements.

        Parameters
        ----------
        part : AffineSystem
            The terms of the share.
        rows : (own, r) float64
            Of the vectors.
        every : (r, free) float64
            The vectors.
        """
        terms = project(part, every[:, own.cols].T).terms
        seen = sparse.csr_array(self.readings @ own.transform)
        at = np.unique(seen.indices)
        return ProjectedSystem(
            parameters=self.parameters,
            vectors=np.eye(rows.shape[1]),
            stiffness=_symmetric(own.inner(rows, rows, 1.0, 0.0)),
            mass=_symmetric(own.inner(rows, rows, 0.0, 1.0)),
            terms=tuple(
                (f, own.share.summed(k), own.share.summed(m)) for f, k, m in terms
            ),
            observe=np.asarray(seen[:, at] @ every[:, at].T),
        )


def _symmetric(a: Float) -> Float:
    return (a + a.T) / 2


def _vectors(own: ShareOfModel, part: AffineSystem, most: int, count: int) -> Float:
    """The rows (own, r) of the basis: at most so many modes, and the static sensitivities of the
    lowest `count`.
    """
    values = own.values[:most]
    modes = own.modes_found[: values.size]

    def respond(load: Float, _progress: Progress) -> Float:
        at = np.flatnonzero(load.any(axis=1))
        loads = own.cols[at], load[at]
        return own.rank("responses", *loads, modes=values.size)[1][0]

    sensitivities = StaticSensitivities(
        values=values[:count],
        shapes=modes[:count, own.cols].T,
        shift=own.shift,
        respond=respond,
        inner=lambda a, b: own.inner(a, b, 1.0, -own.shift),
    )
    terms = [t for i in range(len(part.parameters)) for t in part.terms_of(i)]
    first, last = own.share.span(own.size)
    rows = modes[:, first:last].T / np.sqrt(values - own.shift)
    return basis_vectors(rows, sensitivities, terms)


@dataclass(frozen=True, slots=True, eq=False)
class AskedChanges:
    """∂K/∂a and ∂M/∂a along vectors.

    Attributes
    ----------
    parameters : ParameterSet
    basis : Path
        The file of the vectors.
    along : (r, m) float64
        Combinations of these.
    """

    parameters: ParameterSet
    basis: Path
    along: Float

    def answer(self, own: ShareOfModel, at: Callable[[str], Path]) -> dict[str, Any]:
        """Write the sums over the elements of all shares."""
        x = own.full(self.basis, self.along)
        m = x.shape[1]
        total = np.zeros((2, len(self.parameters), m, m))
        for piece in element_derivatives(
            own.model, self.parameters.parameters, own.share
        ):
            for i, rows in by_owner(piece):
                there = x[own.where[piece.dofs[rows]]]
                flat = there.reshape(-1, m)
                for k, a in enumerate((piece.stiffness[rows], piece.mass[rows])):
                    total[k, i] += flat.T @ applied(a, there).reshape(-1, m)
        total = own.share.summed(total)
        if own.share.number == 0:
            np.save(at(CHANGES), total)
        return {}
