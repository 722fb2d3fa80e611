"""A model opened in its solver: its modes and its reduced model over parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

from ringtrue.checks.materials import mass_properties
from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.core.modes import ModeSet, elastic
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.correlation.sensor_mapping import Method, default_tolerance, observe
from ringtrue.eigen.shift import low_shift
from ringtrue.errors import NotConverged
from ringtrue.fem.assembly import moving
from ringtrue.fem.element_cards import mesh
from ringtrue.model.case_control import whole_mesh
from ringtrue.model.frames import diagonal, positions
from ringtrue.model.model import Model
from ringtrue.model.ports import (
    Analysis,
    Linearisation,
    ModalSolver,
    ModesRequest,
    ModesResult,
)
from ringtrue.reduction.basis import observed_system
from ringtrue.reduction.dense_models import (
    MatricesAtPoint,
    ProjectedModel,
    ReducingAnalysis,
    matrices_at,
)
from ringtrue.reduction.parametric import KnownModes, ReducedModel, reduced_model
from ringtrue.reduction.response import with_responses
from ringtrue.solvers.embedded import EmbeddedAnalysis, EmbeddedSolver
from ringtrue.updating.residuals.modal import Whole
from ringtrue.updating.selection.candidates import Candidate, CandidateSettings
from ringtrue.updating.selection.generation import lumped, places

ROUNDING = 1e-6  # of the size of the structure: nodes closer than this are at one place


@dataclass(eq=False)
class Opened:
    """A model and its analysis, assembled and factored when first asked for.

    Attributes
    ----------
    model : Model
    length : float
        Metres a model unit.
    engine : ModalSolver, optional
        Finds the modes in place of the embedded solver; matrices are the embedded solver's, unless
        it reduces the model itself.
    """

    model: Model
    length: float
    engine: ModalSolver | None = None

    @cached_property
    def analysis(self) -> EmbeddedAnalysis:
        """The embedded solver's view, of the whole mesh."""
        return EmbeddedSolver().open(whole_mesh(self.model))

    @cached_property
    def dofs(self) -> DofSet:
        """Those of all nodes, as `analysis` has them; no matrix is made."""
        return mesh(whole_mesh(self.model)).dofs

    @cached_property
    def _modes(self) -> dict[float, ModesResult]:
        return {}

    def extended(self, model: Model) -> Opened:
        """The same for a model with further cards that change no matrix; nothing is solved anew."""
        made = Opened(model, self.length, self.engine)
        made.__dict__ |= {"analysis": self.analysis, "_modes": self._modes}
        return made

    def modes(self, fmax: float, progress: Progress = quiet) -> ModesResult:
        """All modes below `fmax`, Hz (`ModesResult`), solved once."""
        if fmax not in self._modes:
            if self.engine is None:
                request = ModesRequest(band=(-1.0, fmax))
                self._modes[fmax] = self.analysis.modes(request, progress)
            else:
                with self.engine.open(whole_mesh(self.model)) as analysis:
                    self.modes_by(analysis, fmax)
        return self._modes[fmax]

    def modes_by(self, analysis: Analysis, fmax: float) -> ModesResult:
        """The same by an analysis of the engine that is open."""
        if fmax not in self._modes:
            self._modes[fmax] = self._outside(analysis, ModesRequest(band=(-1.0, fmax)))
        return self._modes[fmax]

    def _outside(self, analysis: Analysis, request: ModesRequest) -> ModesResult:
        """By another solver, at the degrees of freedom of the embedded one."""
        found = analysis.modes(request)
        labels = found.modes.labels
        dofs = self.dofs
        assert isinstance(labels, DofSet)
        at, sign = labels.align(dofs)
        shapes = found.modes.shapes[at] * sign[:, None]
        return replace(found, modes=replace(found.modes, shapes=shapes, labels=dofs))

    @cached_property
    def seats(self) -> tuple[Int, Float]:
        """Nodes that a sensor may sit on, (n,), and where they are, (n, 3), model unit.

        A spring of no length to the ground has two nodes at one place; a sensor there sits on the
        one that moves.
        """
        ids = self.model["GRID"].ids
        xyz = positions(self.model)
        moves = self.moves
        keep = moves.copy()
        if moves.any() and not moves.all():
            size = diagonal(xyz)
            keep[~moves] = KDTree(xyz[moves]).query(xyz[~moves])[0] > ROUNDING * size
        return (ids[keep], xyz[keep]) if keep.any() else (ids, xyz)

    @cached_property
    def near_seats(self) -> tuple[KDTree, float]:
        """The places of `seats` to look nodes up in, m, and how far a sensor may be from its node
        where nothing is said, m.
        """
        metres = self.seats[1] * self.length
        return KDTree(metres), default_tolerance(metres)

    @property
    def moves(self) -> Bool:
        """Whether any translation of a node is neither held nor without stiffness, (node,)."""
        n = len(self.model["GRID"].ids)
        if self.reduces:
            every = moving(whole_mesh(self.model), self._autospc)
        else:
            every = np.diff(self.analysis.system.transform.indptr) > 0
        return np.asarray(every[: 6 * n].reshape(n, 6)[:, :3].any(axis=1))

    @cached_property
    def _autospc(self) -> DofSet:
        """What the engine holds because nothing stiffens it."""
        for known in self._modes.values():
            return known.autospc
        assert self.engine is not None
        with self.engine.open(whole_mesh(self.model)) as analysis:
            return self._outside(analysis, ModesRequest(1)).autospc

    @cached_property
    def reduces(self) -> bool:
        """Whether the engine reduces the model, with no matrix of it in this process."""
        if self.engine is None:
            return False
        with self.engine.open(whole_mesh(self.model)) as analysis:
            return isinstance(analysis, ReducingAnalysis)

    def observation(
        self,
        test: TestModel,
        tolerance: float | None = None,
        method: Method = "nearest",
        *,
        dofs: DofSet | None = None,
    ) -> Observation:
        """The bridge to the channels of a test.

        Parameters
        ----------
        test : TestModel
        tolerance : float, m, optional
        method : str
            As in `correlate.observe`.
        dofs : DofSet, optional
            Rows of the shapes that it reads, those of the embedded solver if not given.
        """
        return observe(
            test,
            *self.seats,
            self.dofs if dofs is None else dofs,
            unit=self.length,
            tolerance=None if tolerance is None else tolerance / self.length,
            method=method,
        )


# largest relative error of a frequency of the reduced model that is accepted
CLOSE = 2e-3
ROUNDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class PairedShapes:
    """The two mode sets of a correlation, and where they are drawn.

    Attributes
    ----------
    test, fe : ModeSet
        At the common channels.
    points : TestModel
        Where the channels are on the model.
    opened : Opened
    modes : ModeSet
        Of the model at all its degrees of freedom.
    """

    test: ModeSet
    fe: ModeSet
    points: TestModel
    opened: Opened
    modes: ModeSet


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedAtChannels:
    """A projected model at some rows of its channels.

    Attributes
    ----------
    model : ProjectedModel
    rows : (channel,) int64
        Those that test modes are compared at.
    """

    model: ProjectedModel
    rows: Int

    @property
    def parameters(self) -> ParameterSet:
        """The active parameters."""
        return self.model.parameters

    def with_parameters(self, active: Sequence[int], base: Float | None = None) -> Self:
        """The same with other active parameters, by position among all; a short `base` is filled up
        with zeros.
        """
        if base is not None:
            base = np.concatenate(
                [base, np.zeros(len(self.model.basis.parameters) - base.size)]
            )
        return replace(self, model=self.model.with_parameters(active, base))

    def whole(self) -> Whole:
        """All modes of the basis at all channels."""
        every = replace(
            self,
            model=self.model.whole(),
            rows=np.arange(self.model.basis.observe.shape[0]),
        )
        return Whole(every, self.rows, self.model.count)

    def matrices(self, x: Float) -> MatricesAtPoint:
        """Small matrices at x, at all channels."""
        return matrices_at(self.model, x)

    def _pick(self, point: Linearisation) -> Linearisation:
        return replace(
            point, shapes=point.shapes[self.rows], d_shapes=point.d_shapes[self.rows]
        )

    def linearise(self, x: Float) -> Linearisation:
        """Modes and sensitivities at x."""
        return self._pick(self.model.linearise(x))

    def modes(self, x: Float) -> Linearisation:
        """Modes at x."""
        return self._pick(self.model.modes(x))


@dataclass(frozen=True, slots=True, eq=False)
class AtChannels(ProjectedAtChannels):
    """A reduced model at some rows of its channels.

    Attributes
    ----------
    loaded : (l,) int64
        Those whose static responses the basis holds at every point where the full model is solved.
    """

    model: ReducedModel
    loaded: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def enrich(
        self, x: Float, *, sensitivities: bool = False
    ) -> tuple[AtChannels, Linearisation]:
        """The model with its full modes at x, and these; static responses of the loaded channels,
        too.
        """
        better, truth = self.model.enrich(x, sensitivities=sensitivities)
        if self.loaded.size:
            better, _ = with_responses(better, self.loaded, x)
        return replace(self, model=better), self._pick(truth)


def build(
    opened: Opened,
    parameters: ParameterSet,
    observation: Observation,
    fmax: float,
    progress: Progress,
) -> ReducedModel:
    """Assemble, differentiate and project: all modes below `fmax` with every parameter."""
    system = opened.analysis.system
    early = part(progress, 0.0, 0.4)
    affine = observed_system(
        opened.model, system, parameters, observation, progress=early
    )
    count = len(opened.modes(fmax).modes)
    late = part(progress, 0.4, 1.0)
    pencil = opened.analysis.pencil
    known = KnownModes(pencil, shift=low_shift(pencil, fmax))
    return reduced_model(affine, count, known=known, progress=late)


def verified(model: AtChannels, x: Float) -> tuple[AtChannels, float]:
    """The model enriched by a full solution at x, and the largest relative error it had there.

    Of a frequency, or of the flexibility between the loaded channels.
    """
    before = model.model.modes(x)
    better, truth = model.model.enrich(x)
    error = frequency_error(before.frequencies, truth.frequencies)
    soft = 0.0
    if model.loaded.size:
        better, soft = with_responses(better, model.loaded, x)
    return replace(model, model=better), max(error, soft)


def frequency_error(found: Float, truth: Float) -> float:
    """Largest relative error of the elastic frequencies that a reduced and a full model have in
    common.
    """
    n = min(found.size, truth.size)
    moving = elastic(truth)[:n]
    return float(np.abs(found[:n][moving] / truth[:n][moving] - 1).max(initial=0.0))


def not_verified(error: float) -> NotConverged:
    """The error of a reduced model that does not follow the full one."""
    return NotConverged(
        f"the reduced model is off by {100 * error:.2g} % after {ROUNDS} enrichments (allowed "
        f"{100 * CLOSE:.2g} %): "
        "tighten the bounds of the parameters"
    )


def with_lumps(
    opened: Opened, nodes: Int, settings: CandidateSettings
) -> tuple[Model, tuple[Candidate, ...]]:
    """The deck with places for masses that it may lack at nodes (k,), and these as candidates."""
    mass = mass_properties(opened.analysis.system).mass
    return lumped(
        opened.model,
        nodes,
        mass / opened.model.param("WTMASS", 1.0),
        settings.of(opened.model),
    )


def lump_places(opened: Opened, bridge: Observation) -> Int:
    """Nodes that cover the structure, those of the channels among them, ids (k,) int64."""
    seen = opened.analysis.dofs.node[np.unique(sparse.coo_array(bridge.matrix).col)]
    return places(opened.model, opened.moves, seen)
