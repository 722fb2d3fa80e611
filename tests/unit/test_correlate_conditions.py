"""Frequencies of twelve modes in ten records of three days, from known slopes."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.correlation.conditions import (
    RepeatedModes,
    condition_slopes,
    day_scatter,
    temperature_drift,
)

MODES, STATED = 12, 1e-4
DAYS = ("mon",) * 4 + ("wed",) * 2 + ("fri",) * 4
KINDS = ("quiet", "jumps", "drops", "sledge", "quiet", "jumps", "quiet", "jumps", "drops", "sledge")
WARM = np.repeat([8.0, 12.0, 15.0], [4, 2, 4])
LEVEL = np.array([0.0, 1.2, 1.6, 0.9, 0.0, 1.2, 0.1, 1.3, 1.5, 1.0])


def records(per_kelvin: float, per_decade: float, seed: int, noise: float = 1.0) -> RepeatedModes:
    """Mode 3 alone depends on the level; each mode has its own part of the drift."""
    rng = np.random.default_rng(seed)
    f = np.linspace(10.0, 40.0, MODES)
    own = per_kelvin * rng.uniform(0.3, 1.7, MODES)
    bent = np.where(np.arange(MODES) == 3, per_decade, 0.0)
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
    found = condition_slopes(records(-3e-4, -2e-3, 1))
    drift = temperature_drift(found)
    assert drift is not None
    assert drift.proven
    assert drift.per_kelvin == pytest.approx(-3e-4, abs=3 * drift.std)
    assert np.flatnonzero(found.bent).tolist() == [3]
    assert found.per_decade[3] == pytest.approx(-2e-3, abs=4 * found.per_decade_std[3])
    assert found.decades[3] == pytest.approx(1.6)


def test_chance_is_seldom_taken_for_either() -> None:
    slopes = [condition_slopes(records(0.0, 0.0, seed, noise=2.0)) for seed in range(100)]
    assert sum(s.bent.any() for s in slopes) <= 5
    assert sum(bool(d and d.proven) for d in map(temperature_drift, slopes)) <= 5
    assert np.median([s.scatter for s in slopes]) == pytest.approx(2.0, rel=0.1)


def test_without_temperatures_or_levels_nothing_is_said() -> None:
    seen = records(-3e-4, -2e-3, 1)
    unknown = RepeatedModes(
        frequency=seen.frequency,
        std=seen.std,
        level=np.full((10, MODES), np.nan),
        temperature=np.full(10, np.nan),
        place=seen.place,
    )
    found = condition_slopes(unknown)
    assert not found.bent.any()
    assert temperature_drift(found) is None


def test_days_differ_by_drift_and_scatter_of_the_same_kind_of_record() -> None:
    scatter, modes = day_scatter(records(0.0, 0.0, 2), DAYS, KINDS)
    assert modes == MODES
    assert scatter == pytest.approx(STATED, rel=0.4)  # a median of twelve modes, and records shared
    drifting, _ = day_scatter(records(-3e-4, 0.0, 2), DAYS, KINDS)
    assert drifting > 5 * scatter
    assert day_scatter(records(0.0, 0.0, 2), ("mon",) * 10, KINDS)[1] == 0
