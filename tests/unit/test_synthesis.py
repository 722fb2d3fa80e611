"""What given poles explain: of FRFs and of spectra of known systems; poles after a choice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import small_study

import ringtrue as rt
from ringtrue.core.choice import Choice, Merge, Pick, Reject
from ringtrue.errors import DataError
from ringtrue.identification.common.manual_selection import current_poles
from ringtrue.study.synthesis import (
    FrfFit,
    compared,
    fit_poles,
    fit_spectrum,
    fitted_spectra,
    single,
    summed,
    weighted_lines,
)


def poles_of(f: np.ndarray, zeta: float) -> np.ndarray:
    return 2 * np.pi * f * (-zeta + 1j * np.sqrt(1 - zeta**2))


def test_frfs_of_their_own_poles_are_explained_and_of_fewer_are_not() -> None:
    lines = np.arange(1.0, 12.0, 0.05)
    responses = ["2+X", "3+X", "4+X"]
    h = rt.frf(
        rt.example_deck(),
        lines,
        forces=["4+X", "2+X"],
        responses=responses,
        damping=0.01,
    )
    f = rt.solve_modes(rt.read_deck(rt.example_deck())).frequencies
    ready = weighted_lines(h)
    size = np.linalg.norm(h.data)
    whole = fit_poles(h, ready, poles_of(f, 0.01))
    assert np.linalg.norm(whole.data - h.data) < 1e-6 * size
    less = fit_poles(h, ready, poles_of(f[[0, 2]], 0.01))
    near = np.abs(lines - f[1]) < 0.2
    assert np.linalg.norm((less.data - h.data)[near]) > 0.5 * np.linalg.norm(
        h.data[near]
    )
    assert np.isnan(whole.coherence).all()


def test_a_spectrum_of_decays_is_explained() -> None:
    """White forces on two modes: S = |Σ r/(iω − λ)|² summed, which is a sum of half spectra."""
    freqs = np.arange(0.5, 10.0, 0.01)
    poles = poles_of(np.array([2.0, 6.0]), 0.01)
    s = 2j * np.pi * freqs[:, None]
    h = 1 / ((s - poles) * (s - poles.conj()))
    power = (np.abs(h) ** 2 * [1.0, 20.0]).sum(axis=1) + 1e-9
    fitted = fit_spectrum(freqs, power, poles)
    np.testing.assert_allclose(fitted, power, rtol=1e-6)
    alone = fit_spectrum(freqs, power, poles[:1])
    at = int(np.argmin(np.abs(freqs - 6.0)))
    assert alone[at] < 0.1 * power[at]


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> rt.api.studies.Study:
    folder: Path = tmp_path_factory.mktemp("study")
    path = small_study.write_study(folder, small_study.FULL)
    rt.run_study(path, until="final")
    return rt.open_study(folder)


def test_poles_follow_the_choice_before_it_is_replayed(
    study: rt.api.studies.Study,
) -> None:
    found = study.stage("identify").hammer
    f = found.modes.frequencies
    sets = [d.poles for d in found.diagrams]
    k = int(np.argmin(np.abs(sets[-1].frequencies - f[-1])))
    pick = Pick(float(sets[-1].frequencies[k]), int(sets[-1].order[k]))

    def left(choice: Choice | None) -> np.ndarray:
        return np.sort(np.abs(current_poles(found.modes, sets, choice))) / (2 * np.pi)

    np.testing.assert_allclose(left(None), f, rtol=1e-12)
    np.testing.assert_allclose(left(Choice((Pick(float(f[0])),))), f, rtol=1e-12)
    np.testing.assert_allclose(
        left(Choice(rejects=(Reject(float(f[2]), "x"),))), np.delete(f, 2)
    )
    assert left(Choice((Pick(float(f[0])), pick), automatic=False)).size == 2
    replaced = left(Choice((pick,)))
    assert replaced.size == f.size
    there = np.concatenate([p.frequencies[p.order == pick.order] for p in sets])
    assert np.abs(there / replaced[-1] - 1).min() < 1e-12
    assert left(Choice(merges=(Merge((float(f[0]), float(f[1]))),))).size == f.size - 1
    with pytest.raises(DataError, match="pick at 3000 Hz"):
        left(Choice((Pick(3000.0, 5),)))


def test_what_is_shown_below_the_diagram(study: rt.api.studies.Study) -> None:
    stage = study.stage("identify")
    fit = FrfFit.of(stage.hammer, stage.frfs)
    fitted = fit.at(stage.hammer, None)
    band = (fit.frfs.freqs > 1.0) & (fit.frfs.freqs < 20.0)
    every = summed(fit.frfs, fitted)
    assert np.abs(every.fitted - every.measured)[band].max() < 1.0  # dB
    gone = Choice(rejects=(Reject(float(stage.hammer.modes.frequencies[3]), "x"),))
    worse = summed(fit.frfs, fit.at(stage.hammer, gone))
    assert np.abs(worse.fitted - worse.measured)[band].max() > 3.0
    one = single(fit.frfs, fitted, "303+X", "303+X")
    assert np.median(np.abs(one.fitted - one.measured)[band]) < 0.1
    (record,) = stage.ambient_records
    for part in fitted_spectra(record, None):
        # dB: scatter of Welch
        assert np.sqrt(np.mean((part.fitted - part.measured) ** 2)) < 1.5


def test_frfs_of_both_decks(study: rt.api.studies.Study) -> None:
    """As the stored study has them at the driving points."""
    stage, final = study.stage("identify"), study.stage("final")
    for of, stored in (("initial", final.frfs.initial), ("final", final.frfs.final)):
        found = study.model_frfs(of)
        at = found.driving_points()
        mine = np.stack([found.data[:, i, j] for i, j in at], axis=1)
        np.testing.assert_allclose(
            mine, stored, rtol=1e-6, atol=1e-9 * np.abs(stored).max()
        )
        comparison, band = compared(stage, study.run.config, found)
        assert band == (1.0, 20.0)
        wanted = getattr(final.evidence.frfs, of).frac
        np.testing.assert_allclose(comparison.frac, wanted, rtol=1e-6)
