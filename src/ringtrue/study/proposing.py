"""Parameters proposed from a deck and the modes of a test, without a study: what `ringtrue
localise` does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ringtrue.checks.mass import mass_properties
from ringtrue.core.arrays import Float, Int
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress, part, quiet
from ringtrue.core.testmodel import Observation
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.reduction.condense import condensed
from ringtrue.reduction.parametric import ReducedModel, modes_of
from ringtrue.study.opened import Opened
from ringtrue.updating.candidates import Candidate, CandidateSettings, membership
from ringtrue.updating.effects import Dropped, effective, reduced_candidates
from ringtrue.updating.generate import generate
from ringtrue.updating.identifiable import ALIKE
from ringtrue.updating.localise import reduced_errors
from ringtrue.updating.lumps import lumped, places
from ringtrue.updating.objective import Target, Weights, match
from ringtrue.updating.pool import SMALL, conflicts, drawn, passed_over
from ringtrue.updating.proposal import Proposal, propose
from ringtrue.updating.screening import LEADING, screened

EXTRA = 1.5  # modes of the model, as a multiple of those of the test


@dataclass(frozen=True, slots=True, eq=False)
class Proposed:
    """A proposal, and what it was chosen from.

    Attributes
    ----------
    proposal : Proposal
    model : Model
        The deck, with places for masses that it may lack.
    candidates : tuple of Candidate
        That were looked at closely.
    dropped : tuple of Dropped
        That change no mode.
    screened : tuple of str
        That were not looked at closely.
    made : int
        All that were made from the deck.
    """

    proposal: Proposal
    model: Model
    candidates: tuple[Candidate, ...]
    dropped: tuple[Dropped, ...]
    screened: tuple[str, ...]
    made: int


def directly_proposed(
    opened: Opened,
    test: ModeSet,
    bridge: Observation,
    settings: CandidateSettings,
    pool: int,
    most: int,
    progress: Progress = quiet,
) -> Proposed:
    """Which of the candidates made from a deck the modes of a test ask for.

    Parameters
    ----------
    opened : Opened
    test : ModeSet
        Real shapes at the channels of `bridge`; those at 0 Hz or below are left out. Of lent shapes
        (`study.lent`) frequencies alone are compared.
    bridge : Observation
    settings : CandidateSettings
    pool, most : int
        Candidates that are looked at closely, and parameters that are proposed, at most.
    """
    model, analysis, every = opened.model, opened.analysis, generate(opened.model, settings)
    if "lump" in settings.kinds:
        model, more = with_lumps(opened, lump_places(opened, bridge), settings)
        every += more
    test = test.take(np.flatnonzero(test.frequencies > 0))
    weights, used = Weights(shape=0.0) if test.lent else Weights(), np.ones(len(test), dtype=bool)
    aim = Target(test.frequencies, test.shapes, np.zeros(len(test)), used, weights, lent=test.lent)
    count = _beyond(len(test))
    modes = analysis.eigen(ModesRequest(modes_of(count)), part(progress, 0.0, 0.1))
    progress(0.1, f"energies of {len(every)} candidates")
    moved, lost = effective(model, analysis.system, every, modes.values, modes.vectors)

    def reduced_to(some: tuple[Candidate, ...], progress: Progress = quiet) -> ReducedModel:
        return reduced_candidates(
            model,
            analysis.system,
            some,
            bridge,
            count,
            pencil=analysis.pencil,
            modes=modes,
            progress=progress,
        )

    def small(whole: ReducedModel, some: tuple[Candidate, ...]) -> ReducedModel:
        points = drawn(whole.parameters, conflicts(model, some), np.random.default_rng(0))
        return condensed(whole, points, max(SMALL, 2 * whole.count))

    def look(some: tuple[Candidate, ...]) -> tuple[ReducedModel, ReducedModel]:
        whole = reduced_to(some)
        return small(replace(whole, count=min(whole.count, _beyond(LEADING))), some), whole

    progress(0.15, f"what {len(moved)} candidates explain")
    keep = screened(
        model,
        analysis.system,
        moved,
        aim,
        sparse.csr_array(bridge.matrix @ analysis.system.transform),
        (modes.values, modes.vectors),
        look,
        pool=pool,
        most=most,
        alike=ALIKE,
        progress=part(progress, 0.15, 0.4),
    )
    reduced = reduced_to(keep, part(progress, 0.4, 0.55))
    progress(0.55, "error indicators")
    found = propose(
        small(reduced, keep),
        aim,
        most=most,
        apart=conflicts(model, keep),
        errors=_errors(opened, reduced, aim, keep),
        words=[c.what for c in keep],
        passed_over=passed_over(moved, keep),
        progress=part(progress, 0.55, 1.0),
    )
    names = {c.name for c in keep}
    return Proposed(
        found, model, keep, lost, tuple(c.name for c in moved if c.name not in names), len(every)
    )


def _beyond(modes: int) -> int:
    """Modes of the model to compare so many of a test with."""
    return int(EXTRA * modes) + 4


def with_lumps(
    opened: Opened, nodes: Int, settings: CandidateSettings
) -> tuple[Model, tuple[Candidate, ...]]:
    """The deck with places for masses that it may lack at nodes, ids (k,), and these as candidates
    (`update.lumps`).
    """
    mass = mass_properties(opened.analysis.system).mass
    return lumped(
        opened.model, nodes, mass / opened.model.param("WTMASS", 1.0), settings.of(opened.model)
    )


def lump_places(opened: Opened, bridge: Observation) -> Int:
    """Nodes that cover the structure, those of the channels among them, ids (k,) int64."""
    seen = opened.analysis.dofs.node[np.unique(sparse.coo_array(bridge.matrix).col)]
    return places(opened.model, opened.moves, seen)


def _errors(
    opened: Opened, reduced: ReducedModel, aim: Target, keep: tuple[Candidate, ...]
) -> dict[str, Float]:
    """Concentration of the local errors on each candidate."""
    pairs, _, _ = match(aim, reduced.modes(np.zeros(len(keep))))
    if not len(pairs) or aim.lent:
        return {}
    f, shapes = aim.frequencies[pairs[:, 0]], aim.shapes[:, pairs[:, 0]]
    rows = np.arange(len(reduced.basis.observe))
    found, _ = reduced_errors(
        opened.model, opened.analysis.system, reduced, rows, f, shapes, pairs[:, 1]
    )
    return dict(found.concentration(membership(opened.model, keep)))
