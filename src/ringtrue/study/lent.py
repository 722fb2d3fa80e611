"""A test that tells frequencies alone: its modes take the shapes of the deck's modes that they pair
with.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.assignment import Locks
from ringtrue.correlation.pairing import PairingSettings, pair_modes
from ringtrue.errors import DataError
from ringtrue.study.opened import Opened
from ringtrue.study.placing import mesh_points


@dataclass(frozen=True, slots=True, eq=False)
class Lent:
    """The modes of a test without channels, with the shapes of their partners in a deck at some of
    its nodes.

    The shapes say which mode of the model a frequency belongs to while parameters change; they are
    no measurement.

    Attributes
    ----------
    modes : ModeSet
        All of the test; NaN where a mode has no partner.
    points : TestModel
        The nodes, as channels.
    taken : tuple (m,) of str
        Which mode of the deck each is taken for, or why none.
    notes : tuple of str
        The pairs, those in doubt, and modes without partner.
    """

    modes: ModeSet
    points: TestModel
    taken: tuple[str, ...]
    notes: tuple[str, ...]


def lent(test: ModeSet, opened: Opened, gates: PairingSettings, locks: Locks) -> Lent:
    """Pair frequencies with modes of the deck as it came, and give them their shapes.

    Raises
    ------
    DataError
        If no mode has a partner.
    """
    modes = opened.modes(
        (1 + gates.frequency_gate) * float(test.frequencies.max(initial=0.0))
    ).modes
    pairing = pair_modes(test, modes.rows(()), gates, locks=locks)
    if not pairing.a.size:
        raise DataError(
            f"{test.source}: no mode of the deck within {100 * gates.frequency_gate:.3g} % of "
            "one of the test"
        )
    points = mesh_points(opened)
    look = opened.observation(points, np.inf)
    shapes = np.full((len(points.channels), len(test)), np.nan)
    shapes[:, pairing.a] = look(modes.shapes[:, pairing.b])
    pairs = list(zip(pairing.a.tolist(), pairing.b.tolist(), strict=True))
    said = dict(zip(pairing.unpaired_a.tolist(), pairing.reasons_a, strict=True))
    said |= {i: f"taken for mode {j + 1} of the deck, by frequency" for i, j in pairs}
    listed = ", ".join(f"{i + 1} for {j + 1}" for i, j in pairs)
    lone = (f"mode {i + 1} is not used: {said[i]}" for i in pairing.unpaired_a.tolist())
    doubts = pairing.doubts()
    decide = (
        ("`lock` and `forbid` under [correlate] decide which mode a frequency is",)
        if doubts
        else ()
    )
    return Lent(
        replace(test, shapes=shapes, labels=points.channels, norm=Norm.LENT),
        points,
        tuple(said[i] for i in range(len(test))),
        (f"no shapes: mode {listed} of the deck, by frequency", *doubts, *decide, *lone),
    )
