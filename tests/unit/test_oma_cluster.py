"""Clusters, shapes' uncertainty and merging, on made-up poles."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.lib.stride_tricks import as_strided

from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.errors import ConfigError, InputError
from ringtrue.identification.ambient.confidence import (
    all_clear,
    confidence,
    evidence,
    weakest,
)
from ringtrue.identification.ambient.pipeline import AmbientSettings, bands_for
from ringtrue.identification.ambient.record_bands import bands_of_use
from ringtrue.identification.ambient.spectral_bins import CandidateModes
from ringtrue.identification.ambient.ssi_cov import (
    SsiCov,
    decompose,
    hankel_gram,
    squared_hankel,
)
from ringtrue.identification.common.merging import merge_modes
from ringtrue.identification.common.stabilisation import cluster_poles, least_deviations
from ringtrue.identification.common.uncertainty import (
    frequency_damping,
    hankel,
    perturb,
)
from ringtrue.shapes import mac
from ringtrue.signal.transients import NONE, Events


def test_close_pair_with_unlike_shapes_stays_apart():
    rng = np.random.default_rng(1)
    order = np.tile(np.arange(2, 42, 2), 2)
    f = np.repeat([1.85, 1.90], 20) * (1 + 0.002 * rng.standard_normal(40))
    psi = np.repeat(
        np.array([[1.0, 1, 0], [1, -1, 0.3]]).T, 20, axis=1
    ) + 0.02 * rng.standard_normal((3, 40))
    label = cluster_poles(2 * np.pi * f * (-0.01 + 1j), psi.astype(complex), order)
    assert len(set(label[:20])) == len(set(label[20:])) == 1
    assert label[0] != label[20]


def test_a_cluster_holds_one_pole_of_an_order():
    pole = 2j * np.pi * np.array([1.0, 1.001, 1.0, 1.03])
    label = cluster_poles(pole, np.ones((2, 4), complex), np.array([2, 4, 6, 6]))
    assert label.tolist() == [0, 0, 0, -1]


def test_bands_overlap_and_reach_the_lowest_frequency():
    bands = bands_for(200.0, 3600.0, AmbientSettings(fmin=0.2))
    assert bands[-1].low == 0.2
    for above, below in pairwise(bands):
        assert below.high > 1.2 * above.low
    assert bands_for(200.0, 600.0, AmbientSettings(fmin=0.5, fmax=10.0))[0].rate < 40.0
    with pytest.raises(ConfigError, match="is empty"):
        bands_for(10.0, 600.0, AmbientSettings(fmin=8.0))


def test_bands_without_longer_lags_are_left_out():
    bands = bands_for(64.0, 400.0, AmbientSettings())
    assert [band.rate for band in bands] == [64.0, 16.0, 4.0, 1.0]
    assert bands_of_use(bands, 4000.0, NONE, 50) == bands
    assert bands_of_use(bands, 48.0, NONE, 50) == bands
    # lags of a thirtieth of 40 s at most, and no longer ones at 16 Hz
    (only,) = bands_of_use(bands, 40.0, NONE, 50)
    assert (only.rate, only.low, only.high) == (64.0, bands[-1].low, bands[0].high)


def test_bands_reach_from_one_event_to_the_next_only_below_its_lines():
    bands = bands_for(64.0, 400.0, AmbientSettings())
    struck = np.zeros(1600, dtype=np.bool_)
    struck[10::20] = True  # every 5 s
    times = 0.25 * np.flatnonzero(struck)
    events = Events(struck, 0.25, times.size, level=20.0, share=0.9, times=times)
    first, slow = bands_of_use(bands, 4000.0, events, 50)
    assert (first.rate, first.low, first.high) == (64.0, 0.2, bands[0].high)
    assert (slow.rate, slow.low, slow.high) == (1.0, bands[-1].low, 0.2)
    # lags of 1.6 s, impacts every 2.5 s
    often = replace(events, window=0.125, times=times / 2)
    assert bands_of_use(bands, 4000.0, often, 50) == bands
    assert bands_of_use(bands, 4000.0, replace(events, share=0.1), 50) == bands


@pytest.mark.parametrize(
    ("shape", "rows", "order"),
    [((80, 4, 3), 40, 6), ((40, 30, 3), 20, 25), ((20, 40, 1), 10, 10)],
)
def test_leading_triplets_are_those_of_the_full_decomposition(
    shape: tuple[int, int, int], rows: int, order: int
):
    h = hankel(
        np.random.default_rng(2).standard_normal(shape), rows
    )  # wide, tall, and tall of the full order
    u, s, v = decompose(h, order)
    want = np.linalg.svd(h, compute_uv=False)
    assert s == pytest.approx(want[:order], rel=1e-9)
    assert h @ v == pytest.approx(u * s, abs=1e-9)


def test_perturbations_are_those_of_the_hankel_matrices_of_the_blocks():
    rng = np.random.default_rng(9)
    rows, ch, n = 8, 3, 5
    dr = rng.standard_normal((6, 2 * rows, ch, 2))
    u, vs = (
        np.linalg.qr(rng.standard_normal((rows * ch, n)))[0],
        rng.standard_normal((rows * 2, n)),
    )
    q = np.linalg.qr(u[:-ch])[0]
    p = perturb(dr, rows, u, vs, q)
    t = np.stack([hankel(x, rows) @ vs for x in dr])
    want = {
        "up": q.T @ t[:, :-ch],
        "down": q.T @ t[:, ch:],
        "output": t[:, :ch],
        "inner": u.T @ t,
    }
    for name, value in want.items():
        assert getattr(p, name) == pytest.approx(value, abs=1e-5 * np.abs(t).max()), (
            name
        )


def test_deviation_of_a_pole_is_its_derivative():
    pole, d = np.array([-0.3 + 20j]), np.array([[1e-6 - 2e-6j]])
    df, dz = frequency_damping(pole, d)
    moved = pole + d[:, 0]
    assert df[0, 0] == pytest.approx(
        (np.abs(moved) - np.abs(pole))[0] / (2 * np.pi), rel=1e-4
    )
    assert dz[0, 0] == pytest.approx(
        (-moved.real / np.abs(moved) + pole.real / np.abs(pole))[0], rel=1e-4
    )


def test_settings_are_checked():
    with pytest.raises(ConfigError, match="block_rows"):
        SsiCov(block_rows=1, order_max=8)
    with pytest.raises(ConfigError, match="fmin < fmax"):
        AmbientSettings(fmin=5.0, fmax=2.0)


def _record(
    at: list[int], f: list[float], std: float, factor: complex, seed: int
) -> tuple[ModeSet, Uncertainty]:
    rng = np.random.default_rng(seed)
    truth = np.cos(np.outer(np.arange(8), [0.3, 0.9]))
    shapes = truth[at] * factor + 1e-3 * abs(factor) * rng.standard_normal((len(at), 2))
    modes = ModeSet(
        np.array(f),
        np.array([0.01, 0.02]),
        shapes.astype(complex),
        tuple(f"{i}+X" for i in at),
    )
    u = Uncertainty.independent(
        np.full(2, std), np.full(2, 1e-3), np.full((len(at), 2), 1e-3 * abs(factor))
    )
    return modes, u


def test_shapes_of_roving_records_are_glued_on_the_common_channels():
    a = (*_record([0, 1, 2, 3], [1.0, 3.0], 0.01, 1.0, 1), "first")
    b = (*_record([0, 1, 4, 5], [1.002, 3.01], 0.01, -2.0j, 2), "second")
    c = (*_record([0, 1, 6, 7], [0.998, 2.99], 0.01, 0.5, 3), "third")
    m = merge_modes([a, b, c])
    truth = np.cos(np.outer(np.arange(8), [0.3, 0.9]))
    rows = [m.modes.channels.index(f"{i}+X") for i in range(8)]
    for k in range(2):
        got = m.modes.shapes[rows, k]
        like = abs(np.vdot(got, truth[:, k])) ** 2 / (
            np.vdot(got, got).real * (truth[:, k] ** 2).sum()
        )
        assert like > 0.99999
    assert m.modes.frequencies == pytest.approx([1.0, 3.0], abs=0.005)
    assert m.uncertainty.frequency == pytest.approx(0.01 / np.sqrt(3), rel=0.01)
    assert [len(p) for p in m.provenance] == [3, 3]


def test_a_single_record_keeps_its_deviations() -> None:
    f = np.array([1.1, 2.3, 3.7])
    shape = np.eye(3, dtype=complex) + 0.1
    modes = ModeSet(f, 0.013 + 0 * f, shape, ("1", "2", "3"))
    std = Uncertainty.independent(1.7e-4 * f, 1.3e-3 + 0 * f, np.full((3, 3), 0.01))
    merged = merge_modes([(modes, std, "only")])
    assert merged.uncertainty.frequency == pytest.approx(std.frequency, rel=1e-12)
    assert merged.uncertainty.damping == pytest.approx(std.damping, rel=1e-12)


def test_weights_and_outliers():
    a = (*_record([0, 1, 2], [1.0, 3.0], 0.001, 1.0, 1), "good")
    b = (*_record([0, 1, 2], [1.001, 3.001], 0.002, 1.0, 2), "fair")
    c = (*_record([0, 1, 2], [1.03, 3.0], 0.002, 1.0, 3), "warm")
    m = merge_modes([a, b, c])
    assert m.modes.frequencies[0] == pytest.approx((1.0 * 4 + 1.001) / 5, abs=1e-9)
    assert [x.record for p in m.provenance for x in p if x.outlier] == ["warm"]


def test_a_mode_of_one_record_is_kept_and_no_records_are_refused():
    a = (*_record([0, 1, 2], [1.0, 3.0], 0.01, 1.0, 1), "a")
    b = (*_record([0, 1, 2], [1.0, 7.0], 0.01, 1.0, 2), "b")
    assert merge_modes([a, b]).modes.frequencies == pytest.approx(
        [1.0, 3.0, 7.0], abs=0.01
    )
    with pytest.raises(InputError, match="no record"):
        merge_modes([])


@pytest.mark.parametrize("wrong", [[0, -1, 2], [2, 1, 0]], ids=["turned", "exchanged"])
def test_a_common_channel_that_is_wrong_in_one_record_is_undone_and_said(wrong):
    rng = np.random.default_rng(4)
    truth = rng.standard_normal((9, 4))
    records = []
    for k, own in enumerate(([3, 4], [5, 6], [7, 8])):
        at = [0, 1, 2, *own]
        shapes = truth[at] + 0.01 * rng.standard_normal((5, 4))
        if k == 1:
            shapes[:3] = np.sign(np.array(wrong) + 0.5)[:, None] * shapes[np.abs(wrong)]
        modes = ModeSet(
            np.arange(1.0, 5.0),
            np.full(4, 0.01),
            shapes.astype(complex),
            tuple(f"{i}+X" for i in at),
        )
        std = Uncertainty.independent(
            np.full(4, 0.01), np.full(4, 1e-3), np.full((5, 4), 0.01)
        )
        records.append((modes, std, f"r{k}"))
    m = merge_modes(records)
    assert len(m.modes) == 4
    assert len(m.notes) == 1
    assert "of r1 look" in m.notes[0]
    rows = [m.modes.channels.index(f"{i}+X") for i in range(9)]
    assert np.diag(mac(m.modes.shapes[rows], truth.astype(complex))).min() > 0.99
    assert merge_modes([records[0], records[2]]).notes == ()


def test_two_poor_shapes_are_no_exchanged_channels():
    """On a symmetric structure the exchange of its ends is seen in no mode but two that one record
    shows poorly.
    """
    rng = np.random.default_rng(5)
    half = rng.standard_normal((2, 8))
    truth = np.stack(
        [half[0], half[1] * ([1, 0] * 4), half[0] * ([1, -1] * 4)]
    )  # symmetric and antisymmetric
    records = []
    for k in range(3):
        shapes = truth + 0.005 * rng.standard_normal((3, 8))
        if k == 1:
            shapes[:, 6:] = np.array([[1.0, 1.0], [0.4, 0.4], [0.2, -0.2]])
        else:
            shapes[:, 6:] = np.array([[0.2, -0.2], [0.4, 0.4], [1.0, 1.0]])
        modes = ModeSet(
            np.arange(1.0, 9.0),
            np.full(8, 0.01),
            shapes.astype(complex),
            ("0+X", "1+X", "2+X"),
        )
        std = Uncertainty.independent(
            np.full(8, 0.01), np.full(8, 1e-3), np.full((3, 8), 0.01)
        )
        records.append((modes, std, f"r{k}"))
    assert merge_modes(records).notes == ()


@pytest.mark.parametrize("rows", [7, 12])
def test_the_gram_matrix_of_a_hankel_matrix_by_convolution_and_along_its_diagonals(
    rows: int,
):
    r = np.random.default_rng(8).standard_normal((2 * rows, 3, 2))
    h = hankel(r, rows)
    assert squared_hankel(h, 3, 2) == pytest.approx(h.T @ h, rel=1e-12, abs=1e-12)
    assert hankel_gram(r, rows) @ np.eye(2 * rows) == pytest.approx(
        h.T @ h, rel=1e-12, abs=1e-12
    )


def test_hankel_of_one_channel():
    """Axes of length one may have any strides."""
    r = as_strided(np.arange(20.0), (20, 1, 1), (8, 8000, 8000), writeable=False)
    lag = np.arange(5)
    assert np.array_equal(hankel(r, 5), 1 + lag[:, None] + lag)


def candidate(orders: int, spread: float, collinear: float = 1.0) -> CandidateModes:
    """One candidate of 1.6 Hz and 1 %, that some of 40 orders show; its damping scatters by a
    multiple of what 1000 s allow.
    """
    pole = 2 * np.pi * 1.6 * (-0.01 + 1j)
    _, least = least_deviations(np.array([1.6]), np.array([0.01]), 1000.0)
    shape = np.array([[1.0], [0.5j * np.sqrt(1 - collinear)], [-0.7], [0.3]])
    return CandidateModes(
        pole=np.array([pole]),
        deviation=np.array([[-abs(pole) * spread * least[0]]]),
        shape=shape.astype(np.complex128),
        shape_deviation=np.zeros((1, 4, 1), np.complex128),
        orders=np.array([[orders, 40]]),
        strength=np.array([9.0]),
        mpc=np.array([collinear]),
        label=np.zeros(20, np.int64),
        stable=np.ones(20, np.bool_),
        refined=np.zeros(1, np.bool_),
        gain=np.array([20.0]),
        agreement=np.full((1, 2), 0.95),
    )


def test_the_confidence_falls_with_each_kind_of_evidence():
    clear = confidence(candidate(38, 1.1), 1000.0)[0]
    assert clear > 0.95
    assert confidence(candidate(4, 1.1), 1000.0)[0] < 0.3 * clear
    assert confidence(candidate(38, 8.0), 1000.0)[0] < 0.6 * clear
    assert confidence(candidate(38, 1.1, 0.3), 1000.0)[0] < clear
    without = replace(candidate(38, 1.1), gain=np.array([-20.0]))
    assert confidence(without, 1000.0)[0] < clear
    alone = replace(candidate(38, 1.1), agreement=np.full((1, 2), 0.05))
    assert confidence(alone, 1000.0)[0] < clear
    assert weakest(evidence(alone, 1000.0)) == ("candidate estimators",)


def test_the_weakest_evidence_is_named():
    assert weakest(evidence(candidate(4, 1.1), 1000.0)) == ("candidate orders",)
    assert weakest(evidence(candidate(38, 8.0), 1000.0)) == ("candidate scatter",)


@pytest.mark.parametrize(
    ("orders", "spread", "done"), [(38, 1.1, True), (12, 1.5, False), (1, 20.0, True)]
)
def test_a_mode_in_doubt_asks_for_all_orders(orders: int, spread: float, done: bool):
    assert all_clear(candidate(orders, spread), 1000.0) == done
