"""Test shapes on all degrees of freedom of a deck, by the method that the study asks for."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress
from ringtrue.core.testmodel import Observation
from ringtrue.errors import ConfigError, InputError, NumericalError
from ringtrue.reduction.expand import (
    Expanded,
    expand_dynamic,
    expand_hybrid,
    expand_serep,
    expand_static,
)
from ringtrue.study.evidence import at_channels
from ringtrue.study.opened import Opened
from ringtrue.study.results import Scene
from ringtrue.study.scene import scene_modes
from ringtrue.updating.localise import NOISE


def expanded(
    method: str, opened: Opened, look: Observation, test: ModeSet, fmax: float, progress: Progress
) -> Expanded:
    """Test shapes on the free degrees of freedom of a deck.

    Parameters
    ----------
    method : {"hybrid", "serep", "guyan", "dynamic"}
    look : Observation
        From the deck to the channels of the test and maybe more.
    test : ModeSet
        Real shapes.
    fmax : float, Hz
        The modes of the deck up to here span what "serep" and, with the static shapes, "hybrid" can
        give.

    Raises
    ------
    ConfigError
        If the channels do not allow it.
    """
    system = opened.analysis.system
    observe = at_channels(opened, look, test.channels)
    y, f = np.asarray(test.shapes.real, dtype=np.float64), test.frequencies
    k, m, labels = system.stiffness, system.mass, opened.analysis.pencil.labels
    try:
        if method == "guyan":
            return expand_static(k, observe, y, labels=labels)
        if method == "dynamic":
            return expand_dynamic(k, m, observe, y, f, labels=labels, progress=progress)
        modes = np.asarray(system.local @ opened.modes(fmax).modes.shapes)
        if method == "hybrid":
            return expand_hybrid(k, m, observe, y, f, modes, noise=NOISE, labels=labels)
        # half as many as channels: with more of them noise is fitted
        return expand_serep(modes[:, : max(1, len(test.channels) // 2)], observe, y)
    except (InputError, NumericalError) as e:
        raise ConfigError(
            f"correlate.expand {method!r}: {e}; try another of hybrid, serep, guyan, dynamic"
        ) from e


def on_scene(found: Expanded, opened: Opened, test: ModeSet, scene: Scene) -> ModeSet:
    """Expanded test shapes at the scene's translations."""
    labels = opened.analysis.dofs
    assert isinstance(labels, DofSet)
    shapes: Float = np.asarray(opened.analysis.system.transform @ found.shapes)
    return scene_modes(
        ModeSet(test.frequencies, test.damping, shapes, labels, test.norm, test.source), scene
    )
