"""Tests that come as FRFs or as modes: measured, or identified, by other means than ringtrue's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.errors import DataError
from ringtrue.io.frfs import read_frfs
from ringtrue.io.modes_json import read_modes, read_std
from ringtrue.signal.reciprocal import exchanged
from ringtrue.signal.setups import join_frfs
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
        raise DataError(f"{path}: frequencies without shapes; a study needs shapes, `ringtrue update` does not")
    std = Uncertainty.independent(spread, damping, np.zeros(modes.shapes.shape))
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
        hammer_uncertainty=std,
        hammer_reasons=(f"as given in {path.name}",) * len(modes),
        hammer_diagrams=(),
        synthesis_error=np.zeros((0, 0)),
        source=path.name,
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
