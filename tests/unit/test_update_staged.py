"""FRFs with sharp peaks from a deck that is far off: nine masses on a row of springs (as in
`test_update_residuals`), three stiffnesses 30 to 50 % off, 0.3 % of damping.

Peaks as narrow as that do not overlap: with all data from the start J has a minimum for each peak
that the model lays over a wrong one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_update_residuals import row

from ringtrue.study.config_update import UpdateSection
from ringtrue.study.objective import Minimisation, course_of
from ringtrue.updating.problem import Configuration, Problem, held_to
from ringtrue.updating.residuals.frf import Frf
from ringtrue.updating.residuals.modal import Frequencies, Mac, Point, Weighted, point
from ringtrue.updating.strategy import settled
from ringtrue.updating.target import Target
from ringtrue.updating.validation import misfits

TRUTH = np.array([-0.45, 0.4, 0.3, 0.0])
MEASURED = 4  # modes; the FRFs have all nine
RECORD = np.linspace(1.0, 60.0, 3000)
QUIET = UpdateSection(discrepancy="assumed")


def at(x: np.ndarray) -> Point:
    model = row()
    now = model.linearise(x)
    count = MEASURED
    target = Target(
        now.frequencies[:count],
        now.shapes[:, :count],
        np.zeros(count),
        np.ones(count, dtype=bool),
    )
    return point(model, now, target)


def frf(lines: int = 60) -> Frf:
    """Accelerances of the truth at three masses, one of them excited, over all modes."""
    some = np.array([0, 4, 8])
    blank = Frf(
        RECORD, np.ones((RECORD.size, 3, 1)), some, some[:1], damping=0.003, std=0.1
    )
    data = blank.response(at(TRUTH))[0]
    chosen = np.linspace(0, RECORD.size - 1, lines).round().astype(int)
    return replace(
        blank, freqs=RECORD[chosen], measured=data[chosen], record=(RECORD, data)
    )


def problem(residual: Frf) -> Problem:
    terms = (
        Frequencies(0.01, "log"),
        Mac(0.05),
        Weighted(residual, 1 / residual.freqs.size),
    )
    whole = Problem((Configuration(row(), at(TRUTH).target, terms),))
    return held_to(whole, whole.parameters.names[:3])


def test_broad_peaks_are_those_of_the_model_at_complex_frequencies() -> None:
    """The Poisson mean of measured lines is the transfer function beside the imaginary axis, but
    for what lies beyond the ends of the record: of order `width` where these are a factor away.
    """
    for width in (0.1, 0.03, 0.01):
        broad = frf().broadened(width)
        assert broad.decay == width
        expected = broad.response(at(TRUTH))[0]
        inside = (broad.freqs > 5) & (broad.freqs < 50)
        error = np.abs(broad.measured - expected).max(axis=(1, 2))
        size = np.abs(expected).max(axis=(1, 2))
        assert (error < 2 * width * size)[inside].all()
        assert (np.abs(frf().measured - expected).max(axis=(1, 2)) > error)[
            inside
        ].mean() > 0.9
    alone = replace(frf(), record=None)
    assert alone.broadened(0.1) is alone


def test_modes_first_reach_what_all_at_once_does_not() -> None:
    whole = problem(frf())
    at_once = settled(whole, course_of(QUIET), start=np.zeros(3)).solution
    assert at_once.outcome.ok
    assert at_once.cost > 100
    run = Minimisation(QUIET, 0).run(whole, lambda *_: None)
    assert run.solution.outcome.ok
    np.testing.assert_allclose(run.solution.y, TRUTH[:3], atol=2e-3)  # the prior pulls
    assert run.solution.cost < 2
    assert run.path[0].y.tolist() == [0, 0, 0]
    # the whole J at every point of the way
    assert run.path[0].cost == pytest.approx(whole.evaluate(np.zeros(3)).cost)


def test_an_end_in_a_wrong_minimum_is_a_misfit_and_the_right_one_is_none() -> None:
    whole = problem(frf())
    wrong = settled(whole, course_of(QUIET), start=np.zeros(3)).solution.y
    found = misfits(whole, whole.evaluate(wrong))
    assert [m.kind for m in found] == [
        "frequencies",
        "shapes",
        "data besides the modes",
    ]
    for m in found:
        assert m.chi_square > m.limit
        assert m.ratio > 1
        assert m.worst
    assert misfits(whole, whole.evaluate(TRUTH[:3])) == ()


def test_one_kind_in_a_thousand_is_called_unfit_by_chance() -> None:
    """Modes off by normal errors as stated: 1 of 300 draws at most, where 0.3 are expected."""
    model = row()
    exact = at(np.zeros(4)).target
    rng = np.random.default_rng(0)
    called = 0
    for _ in range(300):
        off = np.exp(0.01 * rng.standard_normal(MEASURED))
        aim = replace(exact, frequencies=exact.frequencies * off)
        one = Problem((Configuration(model, aim, (Frequencies(0.01, "log"),)),))
        none = held_to(one, one.parameters.names[:1])
        called += bool(misfits(none, none.evaluate(np.zeros(1))))
    assert called <= 1
    aim = replace(exact, frequencies=exact.frequencies * np.array([1, 1, 1.06, 1]))
    one = Problem((Configuration(model, aim, (Frequencies(0.01, "log"),)),))
    (found,) = misfits(one, one.evaluate(np.zeros(4)))
    assert found.kind == "frequencies"
    assert found.worst == ("test mode 3",)
