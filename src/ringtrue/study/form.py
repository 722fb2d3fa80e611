"""Errors of form: which physical cause the deviations of a test from a deck follow, and what such
causes would do to an updated deck.

`form_of` looks for patterns in the correlation. For the effects of causes, modes are computed of
the deck with a finer mesh, coupled mass, shear flexibility, lumped mass that is spread, and joints
that give.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.optimize import linear_sum_assignment

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.testmodel import Observation
from ringtrue.eigen.eigenpairs import eigenvalue
from ringtrue.errors import RingtrueError
from ringtrue.fem.assembly import Sum, reduced
from ringtrue.fem.element_cards import ELEMENTS, mesh, pieces
from ringtrue.fem.members import end_springs, on_springs
from ringtrue.model.case_control import whole_mesh
from ringtrue.model.model import Model, stacked
from ringtrue.model.ports import Linearisation, ModesRequest
from ringtrue.model.refine import LINES, NODES, refined
from ringtrue.shapes import unit
from ringtrue.solvers.embedded import EmbeddedAnalysis
from ringtrue.study.opened import Opened
from ringtrue.updating.form_uncertainty import CauseEffect
from ringtrue.updating.problem import Evaluated, Problem
from ringtrue.updating.selection.form import (
    FormFindings,
    LossFactors,
    ModeDeviations,
    form_patterns,
    may_stand_out,
    with_damping,
)
from ringtrue.updating.selection.form_changes import (
    DeckModes,
    FormChange,
    MeasuredModes,
    form_changes,
    loss_factors,
    softer,
)
from ringtrue.updating.selection.generation import connectivity
from ringtrue.updating.target import Target, match
from ringtrue.updating.uncertainty import energy_shares


def form_of(
    opened: Opened,
    modes: ModeSet,
    test: ModeSet,
    std: Uncertainty | None,
    target: Target,
    observe: sparse.csr_array,
) -> FormFindings:
    """Which physical cause the deviations of a test from a deck follow, if any.

    Parameters
    ----------
    opened : Opened
        The deck.
    modes : ModeSet
        Of the deck, at its full degrees of freedom: the lowest, as many as can be paired or more.
    test : ModeSet
    std : Uncertainty, optional
        Of these modes; NaN or None where unknown.
    target : Target
        The same modes; those that are used are compared.
    observe : (channel, full) csr float64
        Readings of the channels of `target` by the motion of all degrees of freedom.
    """
    system = opened.analysis.system
    values = np.array([eigenvalue(f) for f in modes.frequencies])
    now = Linearisation.of_modes(np.zeros(0), modes.frequencies, observe @ modes.shapes)
    pairs, _, _ = match(target, now)
    pairs = pairs[target.used[pairs[:, 0]] & (values[pairs[:, 1]] > 0)]
    at, fe = pairs.T
    f = test.frequencies[at]
    shapes = target.shapes[:, at]
    deck = DeckModes(
        model=whole_mesh(opened.model),
        system=system,
        values=values,
        vectors=np.asarray(system.local @ modes.shapes),
        at=fe,
        measured=MeasuredModes(
            observe, shapes[:, : 0 if target.frequency_only else None], f
        ),
    )
    unknown = np.zeros(len(test))
    frequency = unknown if std is None else np.nan_to_num(std.frequency)
    found = ModeDeviations(
        test=at,
        fe=fe,
        change=np.log((2 * np.pi * f) ** 2 / values[fe]),
        # structural damping raises λ by 2ζ², viscous does not
        std=np.hypot(2 * frequency[at] / f, 2 * np.nan_to_num(test.damping[at]) ** 2),
    )
    patterns = FormFindings(modes=at.size)
    if may_stand_out(found):
        changes = form_changes(deck)
        patterns = form_patterns(found, changes, _places(changes))
    ratio = test.damping[at]
    known = ratio > 0
    if not known.any():
        return patterns
    loss, joints = loss_factors(deck)
    damping = unknown if std is None else np.nan_to_num(std.damping)
    both = LossFactors(
        test=2 * ratio[known],
        std=2 * damping[at][known],
        deck=loss[known],
        joints=joints[known],
    )
    return with_damping(patterns, both)


def _places(changes: tuple[FormChange, ...]) -> tuple[str, ...]:
    """The property that each mode has more energy in than the others have."""
    own = [c for c in changes if c.pattern == "property"]
    if not own:
        return ()
    share: Float = np.abs(np.stack([c.change[-1] for c in own])) / np.array(
        [c.amount[-1] for c in own]
    ).reshape(-1, 1)
    n = share.shape[1]
    others = (share.sum(axis=1, keepdims=True) - share) / max(n - 1, 1)
    return tuple(own[i].cause for i in (share - others).argmax(axis=0).tolist())


@dataclass(frozen=True, slots=True)
class ChangedDecks:
    """How changed decks are solved and compared.

    Attributes
    ----------
    largest : int
        Free degrees of freedom up to which that is done.
    more : int
        Modes beyond those of the deck.
    reach : float
        Relative distance of a frequency at which a mode is less likely the same.
    still : float
        Change of a datum, in its standard deviations, that is rounding.
    """

    largest: int = 50_000
    more: int = 6
    reach: float = 0.2
    still: float = 1e-9


DECKS = ChangedDecks()
Bridge = Callable[[Opened], Observation]
# changed decks, none where it has no place for a cause
Edit = Callable[[Opened], list[Opened]]


@dataclass(frozen=True, slots=True)
class _Known:
    """Modes at one point, as an observed model."""

    parameters: ParameterSet
    now: Linearisation

    def linearise(self, x: Float) -> Linearisation:
        """The same at all points."""
        return self.now

    def modes(self, x: Float) -> Linearisation:
        """The same at all points."""
        return self.now


@dataclass(frozen=True, slots=True, eq=False)
class UpdatedDeck:
    """An updated deck with the problem that it solves.

    Attributes
    ----------
    opened : Opened
    problem : Problem
        Of one configuration.
    at : Evaluated
        Its end.
    bridge : callable
        From an opened deck to the channels of the test.
    """

    opened: Opened
    problem: Problem
    at: Evaluated
    bridge: Bridge

    def effects(self) -> tuple[CauseEffect, ...]:
        """Of each cause that the deck has a place for; none of a large deck."""
        if self.opened.analysis.system.stiffness.shape[0] > DECKS.largest:
            return ()
        start = self._seen(self.opened)
        value = self._value(start)
        out = []
        every = (
            (cause, deck, std)
            for cause, edit, std in CAUSES
            for deck in edit(self.opened)
        )
        for cause, changed, std in every:
            try:
                now = self._seen(changed)
            except RingtrueError:  # a changed deck that has no modes is no cause
                continue
            residual = value - self._value(now)
            if float(np.abs(residual).max(initial=0.0)) > DECKS.still:
                out.append(CauseEffect(cause, residual, self._modes(start, now), std))
        return tuple(out)

    def field(self) -> Float:
        """Covariance of errors of form of the partners of the test modes, (m, m)."""
        now = self.at.points[0].now
        found = self.opened.analysis.eigen(
            ModesRequest(now.frequencies.size + DECKS.more)
        )
        test, fe = self.at.points[0].every.T
        of = np.abs(found.frequencies[:, None] - now.frequencies[fe]).argmin(axis=0)
        system = self.opened.analysis.system
        shares = energy_shares(self.opened.model, system, found.vectors[:, of])
        whole = np.zeros(
            (shares.shape[0], self.problem.configurations[0].target.used.size)
        )
        whole[:, test] = shares
        covariance = whole.T @ whole
        return np.asarray(covariance / np.diag(covariance)[test].mean())

    def _seen(self, opened: Opened) -> Linearisation:
        """The modes of a changed deck in the order of those that they have come from."""
        base = self.at.points[0].now
        count = base.frequencies.size
        found = opened.analysis.modes(ModesRequest(count + DECKS.more)).modes
        seen = self.bridge(opened)(found.shapes)
        mac = (unit(base.shapes).T @ unit(seen)) ** 2
        f = np.maximum(found.frequencies, 1e-6)
        away = np.log(f / np.maximum(base.frequencies, 1e-6)[:, None]) / DECKS.reach
        rows, of = linear_sum_assignment(-mac * np.exp(-(away**2)))
        order = np.arange(count)
        order[rows] = of
        still = np.zeros((count, 0))
        shapes = seen[:, order]
        none = np.zeros((*shapes.shape, 0))
        return Linearisation(base.x, found.frequencies[order], shapes, still, none)

    def _value(self, now: Linearisation) -> Float:
        """Weighted residuals with these modes."""
        only = self.problem.configurations[0]
        known = replace(only, model=_Known(only.model.parameters, now))
        problem = replace(self.problem, configurations=(known,))
        return problem.evaluate(self.at.y, slopes=False).value

    def _modes(self, start: Linearisation, now: Linearisation) -> Float:
        """Change of ln λ of the partner of each test mode, (m,)."""
        out = np.zeros(self.problem.configurations[0].target.used.size)
        test, fe = self.at.points[0].every.T
        out[test] = 2 * np.log(now.frequencies[fe] / start.frequencies[fe])
        return out


def _edited(edit: Callable[[Model], Model | None]) -> Edit:
    """Of an opened deck, by its cards."""

    def changed(opened: Opened) -> list[Opened]:
        model = edit(opened.model)
        return [] if model is None else [Opened(model, opened.length)]

    return changed


def _finer(model: Model) -> Model | None:
    """With its mesh refined once; None where that is not possible."""
    try:
        changed = refined(model)
    except RingtrueError:
        return None
    return changed if len(changed["GRID"]) > len(model["GRID"]) else None


def _coupled(model: Model) -> Model | None:
    """With coupled masses of elements, or lumped where they are coupled."""
    now = model.param("COUPMASS", -1)
    return replace(model, params={**model.params, "COUPMASS": -1 if now > 0 else 1})


def _flexible(*cards: str) -> Edit:
    """With the shear flexibility of rectangular sections in some properties."""

    def edit(model: Model) -> Model | None:
        some = [c for c in cards if c in model and len(model[c])]
        return softer(model, some, 1.0) if some else None

    return _edited(edit)


def _spread(opened: Opened) -> list[Opened]:
    """With half of each point mass on the nodes that elements join to its own: all elements, or
    those of one property, which joins half of the masses or more.
    """
    model = opened.model
    if "CONM2" not in model or not len(model["CONM2"]):
        return []
    cards = [c for c in NODES if c in model and c in ELEMENTS]
    if not cards:
        return []
    touch = connectivity(model, cards)
    pid = np.concatenate([model[c]["PID"] for c in cards])
    carry = np.isin(model["GRID"].ids, model["CONM2"]["G"])
    every = [touch]
    kinds = np.unique(pid).tolist()
    for own in (touch[pid == p] for p in kinds if len(kinds) > 1):
        if 2 * np.count_nonzero(own[:, carry].sum(axis=0)) >= np.count_nonzero(carry):
            every.append(own)
    changed = (_with_spread_masses(model, sparse.csr_array(x.T @ x)) for x in every)
    return [Opened(deck, opened.length) for deck in changed if deck is not None]


def _with_spread_masses(model: Model, near: sparse.csr_array) -> Model | None:
    """With half of each point mass on nodes that are near (n, n) to its own."""
    masses = model["CONM2"]
    place = {n: i for i, n in enumerate(model["GRID"].ids.tolist())}
    rows = []
    nodes = []
    share = []
    ids = model["GRID"].ids
    for i, g in enumerate(masses["G"].tolist()):
        around = near[[place[g]]].indices if g in place else np.zeros(0, dtype=np.int64)
        around = around[ids[around] != g]
        rows += [i] * around.size
        nodes += ids[around].tolist()
        share += [0.5 / max(around.size, 1)] * around.size
    if not rows:
        return None
    at = np.array(rows)
    more = masses.take(at)
    more = more.with_column("EID", masses.ids.max() + 1 + np.arange(at.size))
    more = more.with_column("G", np.array(nodes)).with_column(
        "M", masses["M"][at] * share
    )
    kept = np.where(np.isin(np.arange(len(masses)), at), 0.5, 1.0)
    less = masses.with_column("M", masses["M"] * kept)
    return replace(model, tables={**model.tables, "CONM2": stacked(less, more)})


def _soft_joints(rigid: float) -> Edit:
    """With members of bars on springs about all axes at both ends, of `rigid` EI/L."""

    def edit(opened: Opened) -> list[Opened]:
        model = whole_mesh(opened.model)
        m = mesh(model)
        there = {
            c: np.arange(len(model[c])) for c in LINES if c in model and len(model[c])
        }
        if not there:
            return []
        springs = end_springs(m, there, rigid)
        if not np.isfinite(springs).any():
            return []
        change = Sum(m.size)
        first = 0
        for _, at, part in pieces(m, there):
            own = np.repeat(springs[first : first + at.size], 3, axis=1)
            first += at.size
            change.add(part.dofs, on_springs(part.stiffness, own) - part.stiffness)
        system = opened.analysis.system
        soft = system.stiffness + reduced(system.transform, change.total())
        changed = Opened(opened.model, opened.length)
        changed.__dict__["analysis"] = EmbeddedAnalysis(
            model, replace(system, stiffness=sparse.csr_array(soft))
        )
        return [changed]

    return edit


# in words, the change, and the standard deviation of its amount before the test; the error of a
# mesh is 4/3 of what refining it once changes (Richardson 1911); Eurocode 3 calls joints rigid from
# 25 EI/L on, and from 8 EI/L on in a braced frame (EN 1993-1-8, 5.2.2.5)
CAUSES: tuple[tuple[str, Edit, float], ...] = (
    ("a finer mesh", _edited(_finer), 4 / 3),
    ("coupled mass", _edited(_coupled), 1.0),
    ("shear flexibility of bars", _flexible("PBAR", "PBEAM"), 1.0),
    ("transverse shear flexibility of plates", _flexible("PSHELL"), 1.5),
    ("point masses that are spread", _spread, 1.0),
    ("joints that give", _soft_joints(25.0), 1.0),
    ("joints that give", _soft_joints(8.0), 1.0),
)
