"""Tests that come as FRFs or as modes: measured, or identified, by other means than ringtrue's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.errors import DataError, did_you_mean
from ringtrue.io.frfs import read_frfs
from ringtrue.io.modes_json import read_frequency_std, read_modes
from ringtrue.signal.frf import join_frfs
from ringtrue.signal.reciprocal import exchanged
from ringtrue.study.results import IdentifyStage

NO_MODES = ModeSet(np.zeros(0), np.zeros(0), np.zeros((0, 0)), ())
NOT_KNOWN = Uncertainty.independent(np.zeros(0), np.zeros(0), np.zeros((0, 0)))


def supplied_frfs(paths: Sequence[Path], sheet: TestModel) -> FrfSet | None:
    """The FRFs of all files as one set, with the responses at the many points; None without a file.

    Raises
    ------
    DataError
        If the files do not fit together, or a response is not on the sensor sheet.
    """
    if not paths:
        return None
    frfs, _ = exchanged(join_frfs([read_frfs(p) for p in paths]))
    _on_sheet([c.id for c in frfs.outputs], sheet, paths[0])
    return frfs


def supplied_modes(path: Path, sheet: TestModel) -> IdentifyStage:
    """The modes of a file as those of a test; shapes as they are, standard deviations where the file has them.

    Raises
    ------
    DataError
        If it holds no mode, or a channel is not on the sensor sheet.
    """
    modes, spread = read_modes(path), read_frequency_std(path)
    _on_sheet(modes.channels, sheet, path)
    if not len(modes):
        raise DataError(f"{path}: no mode in the file")
    none = np.full(len(modes), np.nan)
    std = Uncertainty.independent(np.nan_to_num(spread, nan=0.0), none, np.zeros(modes.shapes.shape))
    no_line, empty = np.zeros((0, 0)), ()
    return IdentifyStage(
        sheet,
        empty,
        empty,
        NO_MODES,
        NOT_KNOWN,
        empty,
        None,
        no_line,
        empty,
        modes,
        std,
        (f"as given in {path.name}",) * len(modes),
        empty,
        None,
        no_line,
        empty,
        path.name,
    )


def _on_sheet(channels: Sequence[str], sheet: TestModel, path: Path) -> None:
    known = set(sheet.channels)
    if lost := [c for c in channels if c not in known]:
        more = f" and {len(lost) - 8} more" if len(lost) > 8 else ""
        near = did_you_mean(lost[0], sheet.channels)
        raise DataError(f"{path}: channel {' '.join(lost[:8])}{more} is not on the sensor sheet{near}")
