"""Patterns of form in the correlation of a test with a deck."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.eigen.eigenpairs import eigenvalue
from ringtrue.model.ports import Linearisation
from ringtrue.model.superelements import whole_mesh
from ringtrue.study.opened import Opened
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
)
from ringtrue.updating.target import Target, match


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
        measured=MeasuredModes(observe, shapes[:, : 0 if target.frequency_only else None], f),
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
