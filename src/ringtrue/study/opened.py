"""A model opened in its solver, assembled, factored and solved when first asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.correlation.sensor_mapping import Method, observe
from ringtrue.model.frames import diagonal, positions
from ringtrue.model.model import Model
from ringtrue.model.ports import ModalSolver, ModesRequest, ModesResult
from ringtrue.solvers.embedded import EmbeddedAnalysis, EmbeddedSolver

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
        Finds the modes in place of the embedded solver; matrices are the embedded solver's in any
        case.
    """

    model: Model
    length: float
    engine: ModalSolver | None = None

    @cached_property
    def analysis(self) -> EmbeddedAnalysis:
        """The embedded solver's view."""
        return EmbeddedSolver().open(self.model)

    @cached_property
    def _modes(self) -> dict[float, ModesResult]:
        return {}

    def extended(self, model: Model) -> Opened:
        """The same for a model with further cards that change no matrix; nothing is solved anew."""
        made = Opened(model, self.length, self.engine)
        made.__dict__ |= {"analysis": self.analysis, "_modes": self._modes}
        return made

    def modes(self, fmax: float, progress: Progress | None = None) -> ModesResult:
        """All modes below `fmax`, Hz (`ModesResult`), solved once."""
        if fmax not in self._modes:
            request = ModesRequest(band=(-1.0, fmax))
            own = self.engine is None
            self._modes[fmax] = (
                self.analysis.modes(request, progress) if own else self._outside(request)
            )
        return self._modes[fmax]

    def _outside(self, request: ModesRequest) -> ModesResult:
        """By another solver, at the degrees of freedom of the embedded one."""
        assert self.engine is not None
        with self.engine.open(self.model) as analysis:
            found = analysis.modes(request)
        labels, dofs = found.modes.labels, self.analysis.dofs
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
        ids, xyz, moves = self.model["GRID"].ids, positions(self.model), self.moves
        keep = moves.copy()
        if moves.any() and not moves.all():
            size = diagonal(xyz)
            keep[~moves] = KDTree(xyz[moves]).query(xyz[~moves])[0] > ROUNDING * size
        return (ids[keep], xyz[keep]) if keep.any() else (ids, xyz)

    @property
    def moves(self) -> Bool:
        """Whether any translation of a node is neither held nor without stiffness, (node,)."""
        system, n = self.analysis.system, len(self.model["GRID"].ids)
        return np.asarray(
            (np.diff(system.transform.indptr)[: 6 * n].reshape(n, 6)[:, :3] > 0).any(axis=1)
        )

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
            self.analysis.dofs if dofs is None else dofs,
            unit=self.length,
            tolerance=None if tolerance is None else tolerance / self.length,
            method=method,
        )

    def seen(self, modes: ModeSet, test: TestModel, tolerance: float | None = None) -> ModeSet:
        """The modes at the channels."""
        shapes = self.observation(test, tolerance)(modes.shapes)
        return ModeSet(
            modes.frequencies, modes.damping, shapes, test.channels, modes.norm, modes.source
        )
