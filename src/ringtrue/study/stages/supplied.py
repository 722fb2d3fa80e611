"""Tests that come as FRFs or as modes: measured, or identified, by other means than ringtrue's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.errors import DataError
from ringtrue.io.frfs import read_frfs
from ringtrue.io.modes_json import read_modes, read_std
from ringtrue.signal.reciprocal import exchanged
from ringtrue.signal.setups import join_frfs
from ringtrue.study.config import StudyConfig
from ringtrue.study.lent import lent
from ringtrue.study.opened import Opened
from ringtrue.study.reference import locks, settings
from ringtrue.study.results import IdentifyStage

NO_MODES = ModeSet(np.zeros(0), np.zeros(0), np.zeros((0, 0)), ())
NOT_KNOWN = Uncertainty.independent(np.zeros(0), np.zeros(0), np.zeros((0, 0)))


def supplied_frfs(paths: Sequence[Path], sheet: TestModel, lost: Sequence[str]) -> FrfSet | None:
    """The FRFs of all files without the channels `lost` as one set, responses at the many points; None without a file.

    Raises
    ------
    DataError
        If the files do not fit together, or a response is not on the sensor sheet.
    """
    if not paths:
        return None
    found = [read_frfs(p, lost) for p in paths]
    frfs, _ = exchanged(found[0] if len(found) == 1 else join_frfs(found))
    on_sheet([c.id for c in frfs.outputs], sheet, paths[0])
    return frfs


def supplied_modes(path: Path, sheet: TestModel, lost: Sequence[str]) -> IdentifyStage:
    """The modes of a file as those of a test, without the channels `lost`; standard deviations where the file has them.

    Raises
    ------
    DataError
        If it holds no mode or no shapes, or a channel is not on the sensor sheet.
    """
    modes, (spread, damping) = read_modes(path), read_std(path)
    modes = modes.rows([c for c in modes.channels if c not in set(lost)]) if lost else modes
    on_sheet(modes.channels, sheet, path)
    if not len(modes):
        raise DataError(f"{path}: no mode in the file")
    if not modes.channels:
        raise DataError(f"{path}: frequencies without shapes: leave `sheet` out of [test], and they are compared alone")
    why = (f"as given in {path.name}",) * len(modes)
    return _stage(path, sheet, modes, why, (spread, damping))


def supplied_frequencies(path: Path, opened: Opened, config: StudyConfig) -> IdentifyStage:
    """Frequencies alone as a test: they take the shapes of modes of the deck, and are no test of these.

    Raises
    ------
    DataError
        If the file holds no mode or shapes, or no mode has a partner in the deck.
    """
    modes, std = read_modes(path), read_std(path)
    if not len(modes):
        raise DataError(f"{path}: no mode in the file")
    if modes.channels:
        raise DataError(f"{path}: has shapes; give the `sheet` of [test] that says where its channels are")
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


def on_sheet(channels: Sequence[str], sheet: TestModel, path: Path) -> None:
    """Refuse channels that have no place on the sensor sheet.

    Raises
    ------
    DataError
    """
    known = set(sheet.channels)
    if lost := [c for c in channels if c not in known]:
        more = f" and {len(lost) - 8} more" if len(lost) > 8 else ""
        there = " ".join(sheet.channels[:8]) + (" ..." if len(sheet.channels) > 8 else "")
        raise DataError(
            f"{path}: channel {' '.join(lost[:8])}{more} is not on the sensor sheet. It has {there}; its column "
            "`channel` names them as the record does"
        )
