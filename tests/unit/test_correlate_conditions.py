"""Frequencies of twelve modes in ten records of three days, from known slopes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ringtrue.correlation.conditions import RepeatedModes, condition_slopes, day_scatter

MODES, STATED = 12, 1e-4
DAYS = ("mon",) * 4 + ("wed",) * 2 + ("fri",) * 4
KINDS = (
    "quiet",
    "jumps",
    "drops",
    "sledge",
    "quiet",
    "jumps",
    "quiet",
    "jumps",
    "drops",
    "sledge",
)
WARM = np.repeat([8.0, 12.0, 15.0], [4, 2, 4])
LEVEL = np.array([0.0, 1.2, 1.6, 0.9, 0.0, 1.2, 0.1, 1.3, 1.5, 1.0])


def records(
    per_kelvin: float, per_decade: float, seed: int, noise: float = 1.0
) -> RepeatedModes:
    """Each mode has its own part of both, mode 3 none of the dependence on the level."""
    rng = np.random.default_rng(seed)
    f = np.linspace(10.0, 40.0, MODES)
    own = per_kelvin * rng.uniform(0.3, 1.7, MODES)
    bent = np.where(
        np.arange(MODES) == 3, 0.0, per_decade * rng.uniform(0.3, 1.7, MODES)
    )
    off = np.outer(WARM - 8.0, own) + np.outer(LEVEL, bent)
    frequency = f * np.exp(off + noise * STATED * rng.standard_normal((10, MODES)))
    frequency[4, 7] = np.nan  # not found
    return RepeatedModes(
        frequency=frequency,
        std=np.broadcast_to(STATED * f, frequency.shape),
        level=10 ** (LEVEL[:, None] - 7.0 + np.zeros(MODES)),
        temperature=WARM,
        place=np.zeros(10, dtype=np.int64),
    )


def test_drift_and_dependence_on_the_level_are_found_and_kept_apart() -> None:
    found = condition_slopes(records(-3e-4, -5e-4, 1))
    for common, wanted in ((found.drift, -3e-4), (found.dependence, -5e-4)):
        assert common is not None
        assert common.proven
        assert common.modes == MODES
        assert common.value == pytest.approx(wanted, abs=3 * common.std)
    assert found.bent.sum() >= 8
    assert not found.bent[3]
    np.testing.assert_allclose(found.decades, 1.6)


def test_chance_is_seldom_taken_for_either() -> None:
    slopes = [
        condition_slopes(records(0.0, 0.0, seed, noise=2.0)) for seed in range(100)
    ]
    for name in ("drift", "dependence"):
        assert sum(getattr(s, name).proven for s in slopes) <= 5
    assert np.median([s.scatter for s in slopes]) == pytest.approx(2.0, rel=0.1)


def test_a_record_that_reads_one_mode_wrong_proves_nothing() -> None:
    seen = records(0.0, 0.0, 4)
    wrong = seen.frequency.copy()
    wrong[0, 5] *= 1.006
    found = condition_slopes(replace(seen, frequency=wrong))
    assert not found.bent[5]
    assert found.dependence is not None
    assert not found.dependence.proven


def test_without_temperatures_or_levels_nothing_is_said() -> None:
    seen = records(-3e-4, -2e-3, 1)
    unknown = replace(
        seen, level=np.full((10, MODES), np.nan), temperature=np.full(10, np.nan)
    )
    found = condition_slopes(unknown)
    assert not found.bent.any()
    assert found.drift is found.dependence is None


def test_days_differ_by_drift_and_scatter_of_the_same_kind_of_record() -> None:
    scatter, modes = day_scatter(records(0.0, 0.0, 2), DAYS, KINDS)
    assert modes == MODES
    # a median of twelve modes, and records shared
    assert scatter == pytest.approx(STATED, rel=0.4)
    drifting, _ = day_scatter(records(-3e-4, 0.0, 2), DAYS, KINDS)
    assert drifting > 5 * scatter
    assert day_scatter(records(0.0, 0.0, 2), ("mon",) * 10, KINDS)[1] == 0
