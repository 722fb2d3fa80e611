"""The embedded solver: assembly and eigensolution in this process, one pencil behind all
answers.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Self

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Any_, Complex, Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.signals import FrfKind
from ringtrue.eigen import damped
from ringtrue.eigen.damped import DynamicStiffness
from ringtrue.eigen.derivatives import MatrixDerivatives, eigenvector_derivatives
from ringtrue.eigen.eigenpairs import EigenModes, eigenvalue, residual_vectors, rounding
from ringtrue.eigen.modes import solve_modes
from ringtrue.eigen.pencil import RESIDUAL_LIMIT, Pencil
from ringtrue.errors import SingularModel, UnsupportedError
from ringtrue.fem.assembly import System, refuse_held
from ringtrue.fem.parametrisation.derivatives import system_derivatives
from ringtrue.fem.response import CoupledModes, coupled, direct
from ringtrue.fem.response import frf as superpose
from ringtrue.model.case_control import ModalDamping
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest, ModesResult
from ringtrue.reduction.components import condensed, free_system

NOT_HELD = (
    "no displacements balance the loads: the model is not held against rigid-body motion "
    "(SPC, springs)"
)
BUFFER = 4  # modes above the requested ones that derivatives converge on


class EmbeddedAnalysis:
    """An assembled model; see `ringtrue.model.ports.Analysis`.

    Attributes
    ----------
    system : System
        K, M, damping and the transformation from free to full basic-frame DOFs; condensed where the
        deck says so.
    whole : System
        The same before it is condensed.
    pencil : Pencil
    spins : DofSet or None
        DOFs of the system that are held, see `fem.massless_rotations`.
    progress : callable or None
        Of all answers for which no other is given.
    """

    capabilities = frozenset({"modes", "derivatives", "frf", "static", "complex_modes"})

    def __init__(
        self,
        model: Model,
        system: System,
        *,
        whole: System | None = None,
        spins: DofSet | None = None,
        progress: Progress = quiet,
    ) -> None:
        self.model = model
        self.system = system
        self.whole = system if whole is None else whole
        self.spins = spins
        self.progress = progress
        self.dofs: DofSet = system.dofs
        self.pencil = Pencil(system.stiffness, system.mass, labels=system.free.named)
        # how many were asked for, and what was found
        self._lowest: tuple[int, EigenModes] | None = None

    @cached_property
    def _whole_pencil(self) -> Pencil:
        """That of the system before it is condensed."""
        a = self.whole
        if a is self.system:
            return self.pencil
        return Pencil(a.stiffness, a.mass, labels=a.free.named)

    def eigen(
        self, request: ModesRequest, progress: Progress | None = None
    ) -> EigenModes:
        """Modes in the free DOFs: the lowest `count` (and a few above), or the band.

        They follow from the model and the request alone, to the last bit, whatever was solved
        before.
        """
        progress = progress or self.progress
        if request.band is not None:
            return solve_modes(self.pencil, band=request.band, progress=progress)
        if self._lowest is None or self._lowest[0] != request.count:
            found = solve_modes(self.pencil, request.count + BUFFER, progress=progress)
            self._lowest = (request.count, found)
        return self._lowest[1]

    def modes(
        self, request: ModesRequest, progress: Progress | None = None
    ) -> ModesResult:
        """Natural modes; those asked for and no more. Without a `progress`, that of the solver."""
        found = self.eigen(request, progress)
        n = found.values.size
        highest = 0.0
        if request.band is None:
            n = min(request.count, n)
        else:
            highest = request.band[1]
        modes = ModeSet(
            frequencies=found.frequencies[:n],
            damping=np.zeros(n),
            shapes=self.system.transform @ found.vectors[:, :n],
            labels=self.dofs,
            norm=Norm.MASS,
            source="embedded",
        )
        return ModesResult(
            modes,
            found.residuals[:n],
            found.complete,
            found.proof + self._rounding_note(found, highest),
            orthogonality=found.orthogonality,
            autospc=self.system.autospc,
        )

    def _rounding_note(self, found: EigenModes, highest: float) -> str:
        """Names a stiffness so large that its rounding moves modes; "" without one."""
        share, mode, row = rounding(self.system.stiffness, found, highest)
        if share < 1e-3:  # of λ
            return ""
        at = " ".join(self.system.free.named(np.array([row])))
        return (
            f"; the stiffness at {at} is so large that its rounding may move mode {mode + 1} by "
            f"{50 * share:.2g} %: give less (1000 times its neighbours is stiff enough) or RBE2"
        )

    def slopes(self, parameters: ParameterSet) -> Sequence[MatrixDerivatives]:
        """∂K/∂a and ∂M/∂a at a = 1, in the free DOFs.

        Raises
        ------
        UnsupportedError
            Of a condensed system, whose coordinates change with the parameters.
        """
        if self.whole is not self.system:
            raise UnsupportedError(
                "derivatives of a condensed model: take the whole mesh (whole_mesh(model))"
            )
        return system_derivatives(self.model, parameters.parameters, self.system)

    def derivatives(
        self, modes: ModeSet, parameters: ParameterSet
    ) -> tuple[Float, Any_]:
        """∂λ/∂a (m, p) and ∂φ/∂a (dof, m, p) at a = 1 of modes of this model."""
        slopes = self.slopes(parameters)
        phi = np.asarray(self.system.local @ modes.shapes)
        top = float(modes.frequencies.max(initial=0.0))
        lowest = self._lowest_up_to(top, len(modes))
        # signs and rotations of the given modes
        turn = lowest.vectors.T @ (self.system.mass @ phi)
        count = int(np.flatnonzero(np.abs(turn).max(axis=1) > 1e-3).max(initial=-1)) + 1
        d_phi = eigenvector_derivatives(
            self.pencil, lowest, slopes, count=count, progress=self.progress
        )
        d_phi = np.einsum("fnp,nm->fmp", d_phi, turn[:count])
        d_full = self.system.transform @ d_phi.reshape(phi.shape[0], -1)
        d_full = d_full.reshape(-1, len(modes), len(slopes))
        lam = np.array([eigenvalue(f) for f in modes.frequencies])
        d_lambda = np.zeros((len(modes), len(slopes)))
        for i, s in enumerate(slopes):  # over parameters
            change = s.stiffness @ phi - (s.mass @ phi) * lam
            d_lambda[:, i] = np.einsum("fm,fm->m", phi, change)
            if s.transform is not None:  # the parameter moves nodes
                d_full[:, :, i] += s.transform @ phi
        return d_lambda, d_full

    def _lowest_up_to(self, top: float, count: int) -> EigenModes:
        """All modes from the lowest to well above `top` Hz."""
        while True:
            lowest = self.eigen(ModesRequest(count))
            above = int((lowest.frequencies > top * (1 + 1e-6)).sum())
            if above >= min(BUFFER, lowest.values.size) or lowest.values.size < count:
                return lowest
            count = max(lowest.values.size + BUFFER, int(1.3 * count))

    def static(self, loads: Any_) -> Float:
        """Displacements (dof, k) under loads (dof, k) or (dof,), basic frame: of the whole mesh, as
        Nastran recovers them.

        Raises
        ------
        SingularModel
            If the model is not held: no displacements balance the loads.
        """
        if self.spins:
            raise SingularModel(
                list(self.spins.labels()),
                "a motion has neither stiffness nor mass (a mechanism)",
            )
        loads = np.asarray(loads, dtype=np.float64).reshape(len(self.dofs), -1)
        loads = self.whole.transform.T @ loads
        moved = self._whole_pencil.at(0.0).solve(loads)
        rest = np.abs(self.whole.stiffness @ moved - loads).max(axis=0, initial=0.0)
        if not (rest <= RESIDUAL_LIMIT * np.abs(loads).max(axis=0, initial=0.0)).all():
            most = np.argsort(-np.abs(moved).max(axis=1))[:6]
            raise SingularModel(self.whole.free.named(most), NOT_HELD)
        return self.whole.transform @ moved

    @property
    def has_damping(self) -> bool:
        """Whether the model has damping of its own."""
        return bool(
            self.system.viscous.count_nonzero()
            or self.system.structural.count_nonzero()
        )

    @cached_property
    def dynamic(self) -> DynamicStiffness:
        """s²M + sD + K + iH with the model's damping."""
        a = self.system
        return DynamicStiffness(a.stiffness, a.mass, a.viscous, a.structural)

    def complex_modes(self, request: ModesRequest) -> ModesResult:
        """Complex modes of the full quadratic problem, in unit modal A, with their residuals
        ‖Q(s)φ‖ relative to the sum of its terms; those without oscillation are left out.

        Parameters
        ----------
        request : ModesRequest
            The lowest `count`, or all with |s|/2π in the band.
        """
        near = self._projected(request)
        if request.band is None:
            near = near[: request.count]
        else:
            hz = near / (2 * np.pi)
            near = near[(hz >= request.band[0]) & (hz <= request.band[1])]
        poles, shapes, residuals, proof = self._full(request, near)
        modes = ModeSet(
            frequencies=np.abs(poles) / (2 * np.pi),
            damping=-poles.real / np.abs(poles),
            shapes=np.asarray(self.system.transform @ shapes),
            labels=self.dofs,
            norm=Norm.MODAL_A,
            source="embedded, complex",
        )
        return ModesResult(
            modes,
            residuals,
            complete=True,
            proof=proof,
            autospc=self.system.autospc,
        )

    def _projected(self, request: ModesRequest) -> Float:
        """Moduli |s| (m,) of the complex modes in the space of half as many real modes more and of
        the static answers to the dampers.
        """
        count = request.count
        if request.band is not None:
            high = request.band[1]
            count = (
                int((self.eigen(ModesRequest(count)).frequencies <= high).sum()) or 1
            )
            while count < self.pencil.size:
                if self.eigen(ModesRequest(count)).frequencies[-1] > high:
                    break
                count *= 2
        size = int(np.ceil(1.5 * count)) + 2
        # 12 modes more may not oscillate
        largest = min(self.pencil.size, 1.5 * count + 12)
        loads = self._damper_loads()
        while True:
            real = self.eigen(ModesRequest(min(size, self.pencil.size)))
            values = real.values
            vectors = real.vectors
            if loads.shape[1]:
                values, vectors = residual_vectors(self.pencil, real, loads)
            d, h = damped.project(vectors, self.system.viscous, self.system.structural)
            top = float(np.abs(real.values).max(initial=0.0))
            found = damped.complex_modes(values, d, h, top=top)
            # rigid-body motions do not oscillate, nor does what is damped above critical
            missing = count - found.poles.size
            if missing <= 0 or size >= largest:
                return np.abs(found.poles)
            size += missing

    def _damper_loads(self) -> Float:
        """Unit loads (f, k) along the DOFs with dashpots, none if they are more than 200."""
        a, (alpha, beta) = self.system, self.system.rayleigh
        dashpots = a.viscous
        if alpha or beta:
            dashpots = a.viscous - alpha * a.mass - beta * a.stiffness
        size, whole = (
            np.asarray(abs(A).sum(axis=1)).ravel() for A in (dashpots, a.viscous)
        )
        # less is the rounding of Rayleigh damping
        at = np.flatnonzero(size > 1e-12 * whole)
        if at.size > 200:
            at = at[:0]
        loads = np.zeros((self.pencil.size, at.size))
        loads[at, np.arange(at.size)] = 1.0
        return loads

    def _full(
        self, request: ModesRequest, near: Float
    ) -> tuple[Complex, Complex, Float, str]:
        """Poles, shapes (f, m), residuals and what was searched; `near` are the moduli from the
        projection.
        """
        expected = max(near.size, 4)
        if request.band is not None:
            found = damped.full_modes(
                self.dynamic, 2 * np.pi * request.band[1], expected=expected
            )
            keep = np.flatnonzero(found.modes.frequencies >= request.band[0])
        else:
            top = 1.02 * float(near.max(initial=1.0))
            for _ in range(4):
                found = damped.full_modes(self.dynamic, top, expected=expected)
                count = found.modes.frequencies.size
                if count >= min(request.count, near.size):
                    break
                top *= 1.3  # the projection put them too low
            keep = np.arange(min(request.count, count))
        proof = f"all poles of the {self.pencil.size} DOFs were computed"
        if np.isfinite(found.radius):
            circle = f"{found.radius:.6g} rad/s of {found.shift:.6g} rad/s"
            proof = f"all poles within {circle}, by Arnoldi on the full problem"
        return (
            found.modes.poles[keep],
            found.modes.shapes[:, keep],
            found.residuals[keep],
            proof,
        )

    def frf(
        self,
        outputs: DofSet,
        inputs: DofSet,
        freqs: Float,
        request: ModesRequest,
        *,
        damping: float | Float | ModalDamping | None = 0.0,
        kind: FrfKind = "receptance",
    ) -> Complex:
        """Frequency responses (freq, out, in) complex128 by modal superposition.

        The residual flexibility of the modes above is added, exact at the shift (near 0 Hz). With
        the model's own damping the modes are coupled, and residual vectors of inputs, outputs and
        dashpots are added: as exact as the direct solution well above the band of the modes, too.

        Parameters
        ----------
        outputs, inputs : DofSet
            Signed; a negative direction turns the sign.
        freqs : (freq,) float64, Hz
        request : ModesRequest
            The lowest `count` modes; a band means all modes up to its upper end.
        damping : float or (m,) float64, ModalDamping or None
            Modal damping ratios in place of the model's own damping; None: the model's own, modes
            coupled; a `ModalDamping` is added to the model's own.
        """
        if request.band is not None:
            request = ModesRequest(band=(-1.0, request.band[1]))
        modes = self.eigen(request)
        out = self._rows(outputs)
        into = self._rows(inputs)
        if damping is None or isinstance(damping, ModalDamping):
            loads = np.hstack([into.T.toarray(), out.T.toarray(), self._damper_loads()])
            values, vectors, d, h = self._coupled(modes, loads, damping)
            ends = out @ vectors, into @ vectors
            return coupled(freqs, CoupledModes(values, d, h), *ends, kind=kind)
        zeta = np.broadcast_to(
            np.asarray(damping, dtype=np.float64), modes.values.shape
        )
        a = out @ modes.vectors
        b = into @ modes.vectors
        flexible = out @ self.pencil.at(modes.shift).solve(into.T.toarray())
        rest = np.asarray(flexible - (a / (modes.values - modes.shift)) @ b.T)
        return superpose(freqs, modes.frequencies, zeta, a, b, kind=kind, residual=rest)

    def _coupled(
        self, modes: EigenModes, loads: Float, modal: ModalDamping | None
    ) -> tuple[Float, Float, Float, Float]:
        """λ, vectors, and the viscous and structural damping of the modes and of the residual
        vectors of loads.
        """
        values, vectors = residual_vectors(self.pencil, modes, loads)
        d, h = damped.project(vectors, self.system.viscous, self.system.structural)
        if modal is not None:
            w = np.sqrt(values.clip(min=0.0))
            loss = 2 * modal.at(w / (2 * np.pi)) * w
            if modal.structural:
                h = h + np.diag(loss * w)
            else:
                d = d + np.diag(loss)
        return values, vectors, d, h

    def frf_direct(
        self,
        outputs: DofSet,
        inputs: DofSet,
        freqs: Float,
        *,
        kind: FrfKind = "receptance",
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

    def __exit__(self, *error: object) -> None:
        self.pencil.close()
        if "_whole_pencil" in self.__dict__:
            self._whole_pencil.close()
        if "dynamic" in self.__dict__:
            self.dynamic.close()


class EmbeddedSolver:
    """`with EmbeddedSolver().open(model) as analysis: analysis.modes(ModesRequest(20))`.

    Parameters
    ----------
    progress : callable (fraction, text)
    """

    name = "embedded"

    def __init__(self, *, progress: Progress = quiet) -> None:
        self.progress = progress

    def open(
        self, model: Model, parameters: Sequence[ParameterSet] = ()
    ) -> EmbeddedAnalysis:
        """Assemble the model; `parameters` need no preparation here.

        Raises
        ------
        InputError
            If nothing is free to move.
        """
        whole, spins = free_system(model)
        refuse_held(whole)
        return EmbeddedAnalysis(
            model,
            condensed(model, whole),
            whole=whole,
            spins=spins,
            progress=self.progress,
        )
