"""A test that tells frequencies alone: its modes take the shapes of the deck's modes that they pair with."""

from __future__ import annotations

from dataclasses import replace

from ringtrue.core.arrays import Int
from ringtrue.core.modes import ModeSet
from ringtrue.correlate.assign import Locks
from ringtrue.correlate.observe import at_dofs
from ringtrue.correlate.pairing import pair_modes
from ringtrue.errors import DataError
from ringtrue.study.config import StudyConfig
from ringtrue.study.opened import Opened
from ringtrue.study.placing import mesh_points
from ringtrue.study.reference import positions, settings

ALONE = ("eigenvalues", "frequencies")  # residuals that need no shapes


def lent(test: ModeSet, opened: Opened, config: StudyConfig) -> tuple[ModeSet, Int, tuple[str, ...]]:
    """The modes of a test without channels, with the shapes of their partners in the deck at some of its nodes.

    The shapes say which mode of the model a frequency belongs to while parameters change; they are no measurement.

    Parameters
    ----------
    test : ModeSet
        Frequencies without channels.
    opened : Opened
        The deck as it came.
    config : StudyConfig
        Gates, and `lock` and `forbid` of [correlate].

    Returns
    -------
    modes : ModeSet
        Those that have a partner.
    at : (k,) int64
        Their positions in the test.
    notes : tuple of str
        Which mode of the deck each is taken for, and why others have none.

    Raises
    ------
    DataError
        If no mode has a partner.
    """
    gates = settings(config)
    modes = opened.modes((1 + gates.frequency_gate) * float(test.frequencies.max(initial=0.0))).modes
    locks = Locks(positions(config.correlate.lock), positions(config.correlate.forbid))
    pairing = pair_modes(test, modes.rows(()), gates, locks=locks)
    if not pairing.a.size:
        raise DataError(
            f"{test.source}: no mode of the deck within {100 * gates.frequency_gate:.3g} % of one of the test"
        )
    look = at_dofs(mesh_points(opened).channels, opened.analysis.dofs)
    found = replace(test.take(pairing.a), shapes=look(modes.shapes[:, pairing.b]), labels=look.channels)
    taken = ", ".join(f"{i + 1} for {j + 1}" for i, j in zip(pairing.a.tolist(), pairing.b.tolist(), strict=True))
    lone = (f"mode {i + 1} is not used: {why}" for i, why in zip(pairing.lone_a.tolist(), pairing.why_a, strict=True))
    return found, pairing.a, (f"no shapes: mode {taken} of the deck, by frequency", *lone)


def compared_alone(config: StudyConfig) -> StudyConfig:
    """The study without what needs shapes: frequencies alone are compared, and no sheet places channels."""
    kinds = [k for k in config.update.residuals if k in ALONE] or ["frequencies"]
    return config.model_copy(update={"test": None, "update": config.update.model_copy(update={"residuals": kinds})})
