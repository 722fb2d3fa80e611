"""What each of many candidates does to what was measured beside the modes, before one reduced model
holds them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from ringtrue.checks.mass import unconstrained
from ringtrue.core.arrays import Float, Int
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.progress import quiet
from ringtrue.fem.assembly import System, assemble
from ringtrue.fem.parametrisation.derivatives import congruent
from ringtrue.fem.parametrisation.polynomials import AffineTerm, power
from ringtrue.model.model import Model
from ringtrue.reduction.affine import AffineSystem
from ringtrue.reduction.flexible import responding, with_responses
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.study.measured import flexible
from ringtrue.study.objective import data_of, on_parameters, terms_of
from ringtrue.study.parametric import AtChannels
from ringtrue.study.workbench import OWN, Workbench
from ringtrue.updating.candidates import Candidate, parameters
from ringtrue.updating.dense import DenseModel
from ringtrue.updating.objective import Target
from ringtrue.updating.residuals import Point, Weighted
from ringtrue.updating.residuals_static import RigidMass
from ringtrue.updating.several import Configuration, Problem


@dataclass(frozen=True, eq=False)
class Beside:
    """The [[residual]]s of the study's own deck, as a screening of candidates sees them.

    Attributes
    ----------
    desk : Workbench
    candidates : tuple of Candidate
        All that are screened.
    start : ReducedModel
        The deck without a parameter, with the responses to unit loads at the touched channels.
    """

    desk: Workbench
    candidates: tuple[Candidate, ...]
    start: ReducedModel

    @classmethod
    def of(cls, desk: Workbench, candidates: tuple[Candidate, ...]) -> Beside:
        """On the deck as it is.

        Raises
        ------
        DataError
            As `objective.data_of`.
        """
        deck = desk.apart(ParameterSet(()), quiet)
        data_of(desk, OWN, deck)
        bare = cls(desk, candidates, deck.model)
        return replace(bare, start=bare.loaded(deck).model)

    @cached_property
    def chosen(self) -> ParameterSet:
        """All candidates."""
        return parameters(self.candidates)

    @cached_property
    def touched(self) -> Int:
        """Channels that were struck or pulled, and those whose deflections were read."""
        at = {c: i for i, c in enumerate(self.desk.channels(OWN))}
        read = [at[c] for m in self.desk.measured(OWN) if m.statics is not None for c in m.outputs]
        return np.unique([*self.desk.loaded(OWN), *read]).astype(np.int64)

    @cached_property
    def mass(self) -> tuple[Float, Float]:
        """The rigid-body mass (6, 6) of the deck about the origin, and its slopes (p, 6, 6) to the
        factors.
        """
        free = unconstrained(self.desk.remodelled.model)
        system = assemble(free)
        r = system.rigid_body()
        return np.asarray(r.T @ (system.mass @ r)), _projected(free, self.chosen, system, r)[1]

    def strained(self) -> tuple[Float, Float]:
        """λ and vectors of the deck in which a candidate must have a part to be seen: modes and
        responses.
        """
        return responding(self.start, self.touched, np.zeros(0))

    def loaded(self, model: AtChannels) -> AtChannels:
        """With the responses to unit loads at the touched channels in its basis."""
        loads = self.desk.loaded(OWN)
        more, read = (
            flexible(model.model, self.desk.measured(OWN), loads),
            np.setdiff1d(self.touched, loads),
        )
        if read.size:
            more, _ = with_responses(more, read, np.zeros(len(more.parameters)))
        return replace(model, model=more, loaded=loads)

    def problem(self, search: AtChannels, aim: Target) -> Problem:
        """Modes and data, over some of the candidates."""
        return Problem(
            (Configuration(search, aim, terms_of(self.desk, OWN, search, self.desk.config.update)),)
        )

    def misfit(
        self, at: ReducedModel | None, x: Float, which: Sequence[int], aim: Target
    ) -> tuple[Float, Float]:
        """Weighted deviations (n,) at a point, and what each candidate does to them in units of its
        prior, (n, p).

        Along the modes there and the responses to unit loads at the touched channels (Fox and
        Kapoor 1968).

        Parameters
        ----------
        at : ReducedModel, optional
            Over some of the candidates; the deck as it is if not given.
        x : (k,) float64
            Of those.
        which : sequence of int
            Their positions among all.
        """
        model, deck, p = at or self.start, self.desk.remodelled, len(self.chosen)
        lam, vectors = responding(model, self.touched, x)
        dk, dm = _projected(deck.model, self.chosen, deck.analysis.system, vectors)
        dense = DenseModel(
            np.diag(lam),
            np.eye(lam.size),
            dk,
            dm,
            model.system.observe @ vectors,
            self.chosen,
            lam.size,
        )
        now = dense.linearise(np.zeros(p))
        none = np.zeros((0, 2), dtype=np.int64)
        here = Point(dense, now, aim, none, (), none, np.zeros(0), now)
        everything = np.zeros(p)
        everything[list(which)] = x
        data = on_parameters(self.desk, OWN, lambda: self._rigid(everything), tuple(range(p)))
        blocks = [Weighted(d.term, d.weight)(here) for d in data]
        slopes = np.concatenate([b.slope for b in blocks]) * self.chosen.std()
        return np.concatenate([b.value for b in blocks]), slopes

    def _rigid(self, x: Float) -> RigidMass:
        """About x (p,), linear in the factors."""
        mass, slopes = self.mass
        none, here = (
            sparse.csr_array((6, 6)),
            mass + np.tensordot(self.chosen.factors(x) - 1, slopes, axes=1),
        )
        terms = tuple(AffineTerm(power(i), none, sparse.csr_array(s)) for i, s in enumerate(slopes))
        return RigidMass(
            AffineSystem(none, sparse.csr_array(here), self.chosen, terms, none), np.eye(6)
        )


def _projected(
    model: Model, chosen: ParameterSet, system: System, vectors: Float
) -> tuple[Float, Float]:
    """∂K/∂a and ∂M/∂a of each parameter along vectors (f, r), (p, r, r) each."""
    r = vectors.shape[1]
    out = np.zeros((2, len(chosen), r, r))
    for i, *both in congruent(model, chosen.parameters, system, vectors):
        for total, change in zip(out, both, strict=True):
            if change.size:
                total[i] += change
    return out[0], out[1]
