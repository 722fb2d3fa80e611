"""Tests that come as FRFs or as modes: measured, or identified, by other means than ringtrue's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import DataError
from ringtrue.io.modes_json import read_modes, read_std
from ringtrue.study.config import StudyConfig
from ringtrue.study.lent import lent
from ringtrue.study.naming import modes_by_sheet, without_channels
from ringtrue.study.opened import Opened
from ringtrue.study.reference import locks, settings
from ringtrue.study.results import IdentifyStage

NO_MODES = ModeSet(np.zeros(0), np.zeros(0), np.zeros((0, 0)), ())
NOT_KNOWN = Uncertainty.independent(np.zeros(0), np.zeros(0), np.zeros((0, 0)))


def supplied_modes(path: Path, sheet: TestModel, lost: Sequence[str]) -> IdentifyStage:
    """The modes of a file as those of a test, without the channels `lost`; standard deviations
    where the file has them.

    Raises
    ------
    DataError
        If it holds no mode or no shapes, or a channel is not on the sensor sheet.
    """
    modes, (spread, damping) = read_modes(path), read_std(path)
    modes, notes = modes_by_sheet(without_channels(modes, lost), sheet, path)
    if not len(modes):
        raise DataError(f"{path}: no mode in the file")
    if not modes.channels:
        raise DataError(
            f"{path}: frequencies without shapes: leave `sheet` out of [test], and they are "
            "compared alone"
        )
    why = (f"as given in {path.name}",) * len(modes)
    return replace(_stage(path, sheet, modes, why, (spread, damping)), frf_notes=notes)


def supplied_frequencies(path: Path, opened: Opened, config: StudyConfig) -> IdentifyStage:
    """Frequencies alone as a test: they take the shapes of modes of the deck, and are no test of
    these.

    Raises
    ------
    DataError
        If the file holds no mode or shapes, or no mode has a partner in the deck.
    """
    modes, std = read_modes(path), read_std(path)
    if not len(modes):
        raise DataError(f"{path}: no mode in the file")
    if modes.channels:
        raise DataError(
            f"{path}: has shapes; give the `sheet` of [test] that says where its channels are"
        )
    found = lent(modes, opened, settings(config), locks(config))
    return replace(_stage(path, found.points, found.modes, found.taken, std), frf_notes=found.notes)


def _stage(
    path: Path, sheet: TestModel, modes: ModeSet, why: tuple[str, ...], std: tuple[Float, Float]
) -> IdentifyStage:
    return IdentifyStage(
        test=sheet,
        records=(),
        ambient_records=(),
        ambient=NO_MODES,
        ambient_uncertainty=NOT_KNOWN,
        ambient_reasons=(),
        frfs=None,
        cmif=np.zeros((0, 0)),
        rejected_hits=(),
        hammer=modes,
        hammer_uncertainty=Uncertainty.independent(*std, np.zeros(modes.shapes.shape)),
        hammer_reasons=why,
        hammer_diagrams=(),
        synthesis_error=np.zeros((0, 0)),
        source=f"file {path.name}",
    )
