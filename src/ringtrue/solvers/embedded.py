"""The embedded solver: assembly and eigensolution in this process, one pencil behind all
answers.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from types import TracebackType
from typing import Literal, Self

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Complex, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import Progress
from ringtrue.core.signals import FrfKind
from ringtrue.eigen import damped
from ringtrue.eigen.damped import DynamicStiffness
from ringtrue.eigen.derivatives import MatrixDerivatives, eigenvector_derivatives
from ringtrue.eigen.eigenpairs import EigenModes, eigenvalue, residual_vectors, rounding
from ringtrue.eigen.engines import Method
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import RESIDUAL_LIMIT, Pencil
from ringtrue.errors import InputError, SingularModel
from ringtrue.fem.assembly import System, assemble, refuse_held
from ringtrue.fem.massless_rotations import without_massless_rotations
from ringtrue.fem.parametrisation.derivatives import system_derivatives
from ringtrue.fem.response import coupled, direct
from ringtrue.fem.response import frf as superpose
from ringtrue.model.case_control import ModalDamping
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest, ModesResult

STILL = 12  # modes that do not oscillate, for which the basis of complex modes is widened
LOCAL = 200  # DOFs with dashpots, up to which each gets a residual vector
ROUNDING = 1e-12  # of a row of the damping: less than that is no dashpot beside Rayleigh damping
NOT_HELD = (
    "no displacements balance the loads: the model is not held against rigid-body motion "
    "(SPC, springs)"
)
BLURRED = 1e-3  # share of λ by which the rounding of the stiffness may move a mode without a word
BUFFER = 4  # modes above the requested ones that derivatives converge on


class EmbeddedAnalysis:
    """An assembled model; see `ringtrue.model.ports.Analysis`.

    Attributes
    ----------
    system : System
        K, M, damping and the transformation from free to full basic-frame DOFs.
    pencil : Pencil
    spins : DofSet or None
        DOFs of the system that are held, see `fem.massless_rotations`.
    progress : callable or None
        Told of each answer for which no other is named.
    """

    capabilities = frozenset({"modes", "derivatives", "frf", "static", "complex_modes"})

    def __init__(
        self,
        model: Model,
        system: System,
        *,
        spins: DofSet | None = None,
        method: Method = "auto",
        progress: Progress | None = None,
    ) -> None:
        self.model, self.system, self.spins, self.progress = model, system, spins, progress
        self.dofs: DofSet = system.dofs
        self.pencil = Pencil(system.stiffness, system.mass, method=method, labels=self._labels)
        self._lowest: tuple[int, EigenModes] | None = (
            None  # how many were asked for, and what was found
        )

    def _labels(self, rows: Int) -> list[str]:
        free = self.system.free
        return list(DofSet(free.node[rows], free.direction[rows]).labels())

    def eigen(self, request: ModesRequest, progress: Progress | None = None) -> EigenModes:
        """Modes in the free DOFs: the lowest `count` (and a few above), or the band.

        They follow from the model and the request alone, to the last bit, whatever was solved
        before.
        """
        told = progress or self.progress
        if request.band is not None:
            return solve_modes(self.pencil, band=request.band, progress=told)
        if self._lowest is None or self._lowest[0] != request.count:
            found = solve_modes(self.pencil, request.count + BUFFER, progress=told)
            self._lowest = (request.count, found)
        return self._lowest[1]

    def modes(self, request: ModesRequest, progress: Progress | None = None) -> ModesResult:
        """Natural modes; those asked for and no more."""
        found = self.eigen(request, progress)
        n = found.values.size if request.band is not None else min(request.count, found.values.size)
        modes = ModeSet(
            found.frequencies[:n],
            np.zeros(n),
            self.system.transform @ found.vectors[:, :n],
            self.dofs,
            Norm.MASS,
            "embedded",
        )
        proof = found.proof + self._blurred(found, request.band[1] if request.band else 0.0)
        autospc = self.system.autospc
        return ModesResult(
            modes, found.residuals[:n], found.complete, proof, found.orthogonality, autospc
        )

    def _blurred(self, found: EigenModes, highest: float) -> str:
        """A word on a stiffness so large that its rounding moves modes."""
        share, mode, row = rounding(self.system.stiffness, found, highest)
        if share < BLURRED:
            return ""
        at = " ".join(self._labels(np.array([row])))
        return (
            f"; the stiffness at {at} is so large that its rounding may move mode {mode + 1} by "
            f"{50 * share:.2g} %: "
            "give less (1000 times what is beside it is stiff enough) or RBE2"
        )

    def slopes(self, parameters: ParameterSet) -> Sequence[MatrixDerivatives]:
        """∂K/∂a, ∂M/∂a and the derivatives of the damping at a = 1, in the free DOFs."""
        return system_derivatives(self.model, parameters.parameters, self.system)

    def derivatives(self, modes: ModeSet, parameters: ParameterSet) -> tuple[Float, Any_]:
        """∂λ/∂a (m, p) and ∂φ/∂a (dof, m, p) at a = 1 of modes of this model."""
        slopes = self.slopes(parameters)
        phi = np.asarray(self.system.local @ modes.shapes)
        top = float(modes.frequencies.max(initial=0.0))
        lowest = self._lowest_up_to(top, len(modes))
        turn = lowest.vectors.T @ (self.system.mass @ phi)  # signs and rotations of the given modes
        count = int(np.flatnonzero(np.abs(turn).max(axis=1) > 1e-3).max(initial=-1)) + 1
        d_phi = eigenvector_derivatives(
            self.pencil, lowest, slopes, count=count, progress=self.progress
        )
        d_phi = np.einsum("fnp,nm->fmp", d_phi, turn[:count])
        lam = np.array([eigenvalue(f) for f in modes.frequencies])
        columns = [
            np.einsum("fm,fm->m", phi, s.stiffness @ phi - (s.mass @ phi) * lam) for s in slopes
        ]
        d_lambda = np.stack(columns, axis=1) if columns else np.zeros((len(modes), 0))
        full = (self.system.transform @ d_phi.reshape(phi.shape[0], -1)).reshape(
            -1, len(modes), len(slopes)
        )
        for i, s in enumerate(slopes):  # over parameters, of which few move nodes
            if s.transform is not None:
                full[:, :, i] += s.transform @ phi
        return d_lambda, full

    def _lowest_up_to(self, top: float, count: int) -> EigenModes:
        """All modes from the lowest to well above `top` Hz."""
        while True:
            lowest = self.eigen(ModesRequest(count))
            above = int((lowest.frequencies > top * (1 + 1e-6)).sum())
            if above >= min(BUFFER, lowest.values.size) or lowest.values.size < count:
                return lowest
            count = max(lowest.values.size + BUFFER, int(1.3 * count))

    def static(self, loads: Any_) -> Float:
        """Displacements (dof, k) under loads (dof, k) or (dof,), basic frame.

        Raises
        ------
        SingularModel
            If the model is not held: no displacements balance the loads.
        """
        if self.spins:
            raise SingularModel(
                list(self.spins.labels()), "a motion has neither stiffness nor mass (a mechanism)"
            )
        loads = np.asarray(loads, dtype=np.float64).reshape(len(self.dofs), -1)
        loads = self.system.transform.T @ loads
        moved = self.pencil.at(0.0).solve(loads)
        rest = np.abs(self.system.stiffness @ moved - loads).max(axis=0, initial=0.0)
        if not (rest <= RESIDUAL_LIMIT * np.abs(loads).max(axis=0, initial=0.0)).all():
            raise SingularModel(self._labels(np.argsort(-np.abs(moved).max(axis=1))[:6]), NOT_HELD)
        return np.asarray(self.system.transform @ moved)

    @property
    def has_damping(self) -> bool:
        """Whether the model has damping of its own."""
        return bool(self.system.viscous.count_nonzero() or self.system.structural.count_nonzero())

    @cached_property
    def dynamic(self) -> DynamicStiffness:
        """s²M + sD + K + iH with the model's damping."""
        a = self.system
        return DynamicStiffness(
            a.stiffness, a.mass, a.viscous, a.structural, method=self.pencil.method
        )

    def complex_modes(self, request: ModesRequest) -> ModeSet:
        """Complex modes in unit modal A, see `damped_modes`; those without oscillation are left
        out.
        """
        return self.damped_modes(request).modes

    def damped_modes(
        self,
        request: ModesRequest,
        *,
        extra: float = 1.5,
        problem: Literal["projected", "full"] = "projected",
    ) -> ModesResult:
        """Complex modes with their residuals ‖Q(s)φ‖ relative to the sum of its terms.

        Parameters
        ----------
        request : ModesRequest
            The lowest `count`, or all with |s|/2π in the band.
        extra : float
            Projected: times as many real modes make the basis, with the static answers to the
            dampers.
        problem : {"projected", "full"}
            The full quadratic problem costs a complex factorisation more, and holds for any
            damping.
        """
        if problem not in ("projected", "full"):
            raise InputError(f"problem {problem!r}; allowed are projected, full")
        real, found = self._projected(request, extra)
        keep = np.arange(min(request.count, found.poles.size))
        if request.band is not None:
            keep = np.flatnonzero(
                (found.frequencies >= request.band[0]) & (found.frequencies <= request.band[1])
            )
        poles, shapes = found.poles[keep], real @ found.shapes[:, keep]
        proof = f"projected on {real.shape[1]} real modes and static answers"
        residuals = self.dynamic.residuals(poles, shapes)
        if problem == "full":
            poles, shapes, residuals, proof = self._full(request, np.abs(poles))
        modes = ModeSet(
            np.abs(poles) / (2 * np.pi),
            -poles.real / np.abs(poles),
            np.asarray(self.system.transform @ shapes),
            self.dofs,
            Norm.MODAL_A,
            "embedded, complex",
        )
        return ModesResult(modes, residuals, problem == "full", proof, autospc=self.system.autospc)

    def _projected(self, request: ModesRequest, extra: float) -> tuple[Float, damped.ComplexModes]:
        """Real modes and residual vectors of the dampers (f, n), and the complex modes in them."""
        count = request.count
        if request.band is not None:
            count = (
                int((self.eigen(ModesRequest(request.count)).frequencies <= request.band[1]).sum())
                or 1
            )
            while (
                self.eigen(ModesRequest(count)).frequencies[-1] <= request.band[1]
                and count < self.pencil.size
            ):
                count *= 2
        size = int(np.ceil(extra * count)) + 2
        while True:
            real = self.eigen(ModesRequest(min(size, self.pencil.size)))
            values, vectors = real.values, real.vectors
            loads = self._damper_loads()
            if loads.shape[1]:
                values, vectors = residual_vectors(self.pencil, real, loads)
            d, h = damped.project(vectors, self.system.viscous, self.system.structural)
            found = damped.complex_modes(
                values, d, h, top=float(np.abs(real.values).max(initial=0.0))
            )
            missing = (
                count - found.poles.size
            )  # rigid-body motions and what is damped too much to oscillate
            if missing <= 0 or size >= min(self.pencil.size, extra * count + STILL):
                return vectors, found
            size += missing

    def _damper_loads(self) -> Float:
        """Unit loads (f, k) along the DOFs that dashpots touch, none if they are too many to be
        local.
        """
        a, (alpha, beta) = self.system, self.system.rayleigh
        dashpots = a.viscous - alpha * a.mass - beta * a.stiffness if alpha or beta else a.viscous
        size, whole = (np.asarray(abs(A).sum(axis=1)).ravel() for A in (dashpots, a.viscous))
        touched = np.flatnonzero(size > ROUNDING * whole)
        loads = np.zeros((self.pencil.size, touched.size if touched.size <= LOCAL else 0))
        loads[touched[: loads.shape[1]], np.arange(loads.shape[1])] = 1.0
        return loads

    def _full(self, request: ModesRequest, near: Float) -> tuple[Complex, Complex, Float, str]:
        """Poles, shapes (f, m), residuals and a word on the search; `near` are the moduli from the
        projection.
        """
        top = (
            2 * np.pi * request.band[1]
            if request.band is not None
            else 1.02 * float(near.max(initial=1.0))
        )
        for _ in range(4):
            found = damped.full_modes(self.dynamic, top, expected=max(near.size, 4))
            f = found.modes.frequencies
            keep = np.arange(min(request.count, f.size))
            if request.band is not None:
                keep = np.flatnonzero(f >= request.band[0])
            if request.band is not None or f.size >= min(request.count, near.size):
                break
            top *= 1.3  # the projection put them too low
        proof = f"all poles of the {self.pencil.size} DOFs were computed"
        if np.isfinite(found.radius):
            circle = f"{found.radius:.6g} rad/s of {found.shift:.6g} rad/s"
            proof = f"all poles within {circle}, by Arnoldi on the full problem"
        return found.modes.poles[keep], found.modes.shapes[:, keep], found.residuals[keep], proof

    def frf(
        self,
        outputs: DofSet,
        inputs: DofSet,
        freqs: Float,
        request: ModesRequest,
        *,
        damping: float | Float | ModalDamping | None = 0.0,
        kind: FrfKind = "receptance",
        residual: bool = True,
    ) -> Complex:
        """Frequency responses (freq, out, in) complex128 by modal superposition.

        With the model's own damping the modes are coupled, and the residual vectors of inputs,
        outputs and dashpots stand beside them: as exact as the direct solution well above the band
        of the modes, too.

        Parameters
        ----------
        outputs, inputs : DofSet
            Signed; a negative direction turns the sign.
        freqs : (freq,) float64, Hz
        request : ModesRequest
            The lowest `count` modes; a band means all modes up to its upper end.
        damping : float or (m,) float64, ModalDamping or None
            Modal damping ratios in place of the model's own damping; None: the model's own, modes
            coupled; a `ModalDamping` stands beside the model's own.
        residual : bool
            Add the residual flexibility of the modes above, exact at the shift (near 0 Hz).
        """
        if request.band is not None:
            request = ModesRequest(band=(-1.0, request.band[1]))
        modes = self.eigen(request)
        out, into = self._rows(outputs), self._rows(inputs)
        if damping is None or isinstance(damping, ModalDamping):
            return self._coupled_frf(modes, (out, into), freqs, kind, residual, damping)
        zeta = np.broadcast_to(np.asarray(damping, dtype=np.float64), modes.values.shape)
        a, b = out @ modes.vectors, into @ modes.vectors
        rest = None
        if residual:
            flexible = out @ self.pencil.at(modes.shift).solve(into.T.toarray())
            rest = np.asarray(flexible - (a / (modes.values - modes.shift)) @ b.T)
        return superpose(freqs, modes.frequencies, zeta, a, b, kind, residual=rest)

    def _coupled_frf(
        self,
        modes: EigenModes,
        ends: tuple[sparse.csr_array, sparse.csr_array],
        freqs: Float,
        kind: FrfKind,
        residual: bool,
        modal: ModalDamping | None,
    ) -> Complex:
        out, into = ends
        values, vectors = modes.values, modes.vectors
        if residual:
            loads = np.hstack([into.T.toarray(), out.T.toarray(), self._damper_loads()])
            values, vectors = residual_vectors(self.pencil, modes, loads)
        d, h = damped.project(vectors, self.system.viscous, self.system.structural)
        if modal is not None:
            w = np.sqrt(values.clip(min=0.0))
            loss = 2 * modal.at(w / (2 * np.pi)) * w
            d, h = (d, h + np.diag(loss * w)) if modal.structural else (d + np.diag(loss), h)
        return coupled(freqs, values, d, h, out @ vectors, into @ vectors, kind=kind)

    def frf_direct(
        self, outputs: DofSet, inputs: DofSet, freqs: Float, *, kind: FrfKind = "receptance"
    ) -> Complex:
        """Frequency responses (freq, out, in) complex128 of the full model with its own damping, a
        solve a line.

        Parameters
        ----------
        outputs, inputs : DofSet
            Signed; a negative direction turns the sign.
        freqs : (freq,) float64, Hz

        Raises
        ------
        SingularModel
            If an undamped mode stands at one of the frequencies.
        """
        rows = self._rows(outputs), self._rows(inputs)
        return direct(self.dynamic, freqs, *rows, kind=kind, progress=self.progress)

    def _rows(self, dofs: DofSet) -> sparse.csr_array:
        index, sign = self.dofs.align(dofs)
        return sparse.csr_array(sparse.diags_array(sign) @ self.system.transform[index])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.pencil.close()
        if "dynamic" in self.__dict__:
            self.dynamic.close()


class EmbeddedSolver:
    """`with EmbeddedSolver().open(model) as analysis: analysis.modes(ModesRequest(20))`.

    Parameters
    ----------
    method : {"auto", "pardiso", "rslab", "superlu", "dense"}
        The factorisation.
    progress : callable, optional
        Called with (share done, what).
    """

    name = "embedded"

    def __init__(self, *, method: Method = "auto", progress: Progress | None = None) -> None:
        self.method, self.progress = method, progress

    def open(self, model: Model, parameters: Sequence[ParameterSet] = ()) -> EmbeddedAnalysis:
        """Assemble the model; `parameters` need no preparation here.

        Raises
        ------
        InputError
            If nothing is free to move.
        """
        system, spins = without_massless_rotations(model, assemble(model))
        refuse_held(system)
        return EmbeddedAnalysis(
            model, system, spins=spins, method=self.method, progress=self.progress
        )
