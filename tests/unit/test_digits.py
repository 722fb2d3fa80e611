"""Numbers with errors: two digits of the error, and the value to the same place; standard
deviations that no repetition bears out.
"""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.core.display import number, plus_minus, standard_deviations, with_error
from ringtrue.correlation.pairing import Pairing
from ringtrue.correlation.table import (
    CorrelationTable,
    repeatability,
    table_significance,
)

NAN = float("nan")


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [
        (1.32698, 0.0229, ("1.327", "0.023")),
        (13.50129483, 0.000676, ("13.50129", "0.00068")),
        (0.0141, 0.00021, ("0.01410", "0.00021")),  # a damping ratio, %
        (0.09996, 0.00997, ("0.100", "0.010")),  # the error rounds up to the next power
        (9.9996, 0.013, ("10.000", "0.013")),
        (1216565476.2, 172409653.0, ("1.22 × 10⁹", "1.7 × 10⁸")),
        (1234.5, 123.0, ("1230", "120")),
        (-0.4567, 0.031, ("−0.457", "0.031")),
        (0.0004, 0.031, ("0", "0.031")),
        (4.26865, NAN, ("4.269", "–")),
        (4.26865, 0.0, ("4.269", "0")),
        (NAN, 0.1, ("–", "0.10")),
    ],
)
def test_a_value_ends_where_its_error_ends(
    value: float, std: float, shown: tuple[str, str]
) -> None:
    assert with_error(value, std) == shown


def test_a_value_without_a_known_error_stands_alone() -> None:
    assert plus_minus(1.32698, 0.0229) == "1.327 ± 0.023"
    assert plus_minus(1.32698, NAN) == "1.327"
    assert number(0.0141, 3) == "0.0141"


def test_no_deviation_is_hundreds_of_thousands_of_standard_deviations() -> None:
    assert standard_deviations(323486.0) == "> 100"
    assert standard_deviations(12.34) == "12"
    assert standard_deviations(0.512) == "0.51"
    assert standard_deviations(NAN) == "–"


def table(first: np.ndarray, second: np.ndarray, std: float) -> CorrelationTable:
    at = np.arange(first.size)
    none = at[:0]
    of_pairs = (np.ones(at.size), np.zeros(at.size), np.zeros(at.size, dtype=bool))
    pairing = Pairing(at, at, *of_pairs, none, (), none, ())
    stds = np.full(at.size, std)
    used = np.ones(at.size, dtype=bool)
    return CorrelationTable(
        pairing, first, second, stds, used, np.eye(at.size), first, second
    )


def test_repetition_is_found_from_two_tests_and_one_wrong_pair_does_not_matter() -> (
    None
):
    """Two tests, each with 0.05 % of scatter: the spread of 2000 differences tells it to 3 %."""
    rng = np.random.default_rng(3)
    true = np.linspace(5.0, 50.0, 2000)
    one, two = (true * (1 + 5e-4 * rng.standard_normal(true.size)) for _ in range(2))
    two[7] *= 1.2
    assert repeatability(table(one, two, 1e-6)) == pytest.approx(5e-4, rel=0.05)
    assert np.isnan(repeatability(table(one[:0], two[:0], 1e-6)))


def test_no_standard_deviation_is_below_that_of_repetition() -> None:
    test = np.array([10.0, 20.0])
    model = 1.01 * test
    stated = table(test, model, 1e-6)
    assert table_significance(stated).z.min() > 9e4
    assert table_significance(stated, 1e-3).z == pytest.approx([10.0, 10.0])
    assert table_significance(table(test, model, 0.1), 1e-3).std == pytest.approx(
        [0.1, 0.1]
    )
    assert table_significance(table(test, model, NAN), 1e-3).z == pytest.approx(
        [10.0, 10.0]
    )
    assert np.isnan(table_significance(table(test, model, NAN)).z).all()
