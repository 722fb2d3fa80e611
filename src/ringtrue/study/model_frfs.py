"""FRFs of the decks of a study where and as those of its test are."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import FrfSet
from ringtrue.correlation.frf import FrfComparison, compare_frfs
from ringtrue.correlation.pairing import Pairing
from ringtrue.study.config import StudyConfig
from ringtrue.study.evidence import ModelModes, frf_band, on_sheet, synthesised
from ringtrue.study.results import CorrelateStage, FinalStage, IdentifyStage, ReferenceModes
from ringtrue.study.session import StudyConfiguration

ASSUMED_DAMPING = 0.01  # where no test mode with a ratio is paired


def damping_of(
    modes: ModeSet, elastic: Pairing, rigid: Pairing, reference: ReferenceModes
) -> tuple[Float, tuple[str, ...]]:
    """Damping of each FE mode: its test partner's, or interpolated over frequency."""
    zeta = np.full(len(modes), np.nan)
    source = ["interpolated"] * len(modes)
    for pairing, test, what in (
        (rigid, reference.rigid, "ambient"),
        (elastic, reference.elastic, "test"),
    ):
        for a, b in zip(pairing.a.tolist(), pairing.b.tolist(), strict=True):
            zeta[b] = test.damping[a]
            source[b] = f"{what} mode {a + 1}"
    known = np.isfinite(zeta)
    if not known.any():
        assumed = f"assumed {100 * ASSUMED_DAMPING:g} %"
        return np.full(len(modes), ASSUMED_DAMPING), (assumed,) * len(modes)
    f = modes.frequencies
    zeta[~known] = np.interp(f[~known], f[known], zeta[known])
    return zeta, tuple(source)


def measured_frfs(c: StudyConfiguration) -> FrfSet | None:
    """The FRFs of the test at channels on the sheet, in the range of the model; None where there
    are none.
    """
    first = float(c.reference.elastic.frequencies[0])
    low = min(1.0, 0.5 * first)
    return on_sheet(c.session.get("identify"), low, c.session.fmax)


def initial_modes(c: StudyConfiguration) -> ModelModes:
    """The initial deck with its modes, and damping from the test modes that they pair with."""
    before: CorrelateStage = c.session.get("correlate")
    modes = before.fe_initial
    pairings = before.initial.pairing, before.rigid_initial.pairing
    zeta, _ = damping_of(modes, *pairings, c.reference)
    return ModelModes(c.session.initial, modes, zeta)


def final_modes(c: StudyConfiguration, stage: FinalStage) -> ModelModes:
    """The delivered deck, read back, with its stored modes."""
    folder = c.updated_folder
    parts = Path(stage.files[0]).parts  # stored as seen from where the study was run
    deck = folder.joinpath(*parts[parts.index(folder.name) + 1 :])
    return ModelModes(c.session.opened(deck), stage.observed, stage.damping)


def compared(
    found: IdentifyStage, config: StudyConfig, model: FrfSet
) -> tuple[FrfComparison, tuple[float, float]] | None:
    """All measures of the FRFs of a deck against the test, and the band where they are compared;
    None without modes or lines there.
    """
    band = frf_band(found, config)
    measured = on_sheet(found, *band) if band is not None else None
    if band is None or measured is None:
        return None
    return compare_frfs(measured, model), band


def model_frfs(c: StudyConfiguration, model: ModelModes, measured: FrfSet) -> FrfSet:
    """The FRFs of a deck at the outputs, inputs and lines of measured ones."""
    session = c.session
    return synthesised(model, c.observed(model.opened), measured, session.unit, session.fmax)
