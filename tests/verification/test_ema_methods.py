"""Hammer tests of a known structure: reciprocity, force levels, disagreeing batches.

A chain of masses and springs with modal or local dashpots; FRFs are exact sums of its modes, with
white noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eig

from ringtrue.core.modes import ModalModel, ModeSet, Norm, Uncertainty
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.errors import InputError
from ringtrue.identification.common.tracking import level_dependence
from ringtrue.identification.frf.local_fits import identify_batches, with_local_fits
from ringtrue.identification.frf.pipeline import HammerModes, identify_hammer
from ringtrue.identification.frf.residues import driving_pairs
from ringtrue.shapes import mac, paired_mac
from ringtrue.signal.frf_sets import join_frfs

MASS = np.array([1.0, 1.2, 0.9, 1.1, 1.0, 0.8, 1.0, 1.1])
N = MASS.size


def chain(extra: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M, K of eight masses between walls, modes from about 5 to 28 Hz, and C: 0.1 %
    stiffness-proportional.
    """
    m = np.diag(MASS + (0 if extra is None else extra))
    k = 8e3 * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    return m, k, 2e-4 * k


def poles(m: np.ndarray, k: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poles and shapes of unit modal A, Im > 0, ascending."""
    zero = np.zeros((N, N))
    a, b = np.block([[c, m], [m, zero]]), np.block([[k, zero], [zero, -m]])
    s, v = eig(-b, a)
    at = np.flatnonzero(s.imag > 0)
    at = at[np.argsort(s[at].imag)]
    x = v[:, at]
    return s[at], x[:N] / np.sqrt(np.einsum("ik,ij,jk->k", x, a, x))


def frfs(
    system: tuple[np.ndarray, np.ndarray, np.ndarray],
    rng: np.random.Generator,
    outputs: tuple[int, ...] = tuple(range(N)),
    level: float = 0.005,
) -> FrfSet:
    """Accelerances for hits at the first and the third mass."""
    refs, freqs = [0, 2], np.linspace(1.0, 40.0, 1200)
    s, phi = poles(*system)
    at = np.asarray(outputs)
    model = ModalModel(
        s,
        phi[at],
        phi[refs].T,
        np.zeros((at.size, 2)),
        np.zeros((at.size, 2)),
        tuple(Channel(f"{i + 1}+X") for i in outputs),
        tuple(Channel(f"{i + 1}+X") for i in refs),
    )
    h = model.synthesise(freqs)
    sigma = level * np.sqrt(np.mean(np.abs(h) ** 2, axis=0)) / np.sqrt(2)
    h = h + sigma * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
    coherence = 1 / (1 + 4 * 2 * sigma**2 / np.abs(h) ** 2)  # of the mean of four
    return FrfSet(h, freqs, model.outputs, model.inputs, coherence, np.full(2, 4.0))


def reciprocity(model: ModalModel) -> np.ndarray:
    """MAC of shapes and participations at the points both struck and measured."""
    points = driving_pairs(model)
    return paired_mac(points.shapes(model.shapes), model.participation.T[points.input])


def test_reciprocity_of_a_symmetric_structure() -> None:
    model = identify_hammer(
        frfs(chain(), np.random.default_rng(3)), HammerModes(3.0, 35.0)
    ).model
    assert reciprocity(model).min() > 0.99
    wrong = replace(model, participation=model.participation * [1.0, -1.0])
    assert reciprocity(wrong).min() < 0.9


def results(
    f: np.ndarray, z: np.ndarray, order: np.ndarray
) -> tuple[ModeSet, Uncertainty]:
    n = f.size + 1
    labels = tuple(f"{i + 1}+X" for i in range(n))
    modes = ModeSet(f[order], z[order], np.eye(n)[:, order], labels)
    return modes, Uncertainty.independent(
        1e-4 * modes.frequencies, 1e-2 * modes.damping, np.zeros((n, f.size))
    )


def test_level_dependence_tells_a_softening_mode_from_linear_ones() -> None:
    """One mode falls by 1 % in frequency for each factor e of the force, another gains damping with
    its square root.
    """
    rng, levels = np.random.default_rng(4), np.array([4.0, 1.0, 2.0, 8.0])
    found = []
    for force in levels:
        f, z = np.array([10.0, 20.0, 30.0]), np.full(3, 0.01)
        f[1] *= force**-0.01
        z[2] *= force**0.5
        noise = rng.standard_normal((2, 3))
        found.append(
            results(
                f * (1 + 1e-4 * noise[0]), z * (1 + 1e-2 * noise[1]), rng.permutation(3)
            )
        )
    table = level_dependence(levels, found)
    np.testing.assert_array_equal(table.levels, np.sort(levels))
    at = np.argsort(table.frequency[0])
    np.testing.assert_array_equal(table.linear[at], [True, False, False])
    np.testing.assert_allclose(table.slope_frequency[at], [0, -0.01, 0], atol=3e-4)
    np.testing.assert_allclose(table.slope_damping[at], [0, 0, 0.5], atol=0.03)
    assert np.isfinite(table.frequency).all()
    with pytest.raises(InputError, match="two or more"):
        level_dependence([1.0], found[:1])


def test_a_linear_structure_is_rarely_called_nonlinear_however_many_modes_it_has() -> (
    None
):
    """One in a hundred structures, not modes: of 200 with ten modes each, less than six."""
    rng, f, z = np.random.default_rng(6), np.arange(5.0, 15.0), np.full(10, 0.01)
    called = 0
    for _ in range(200):
        noise = rng.standard_normal((3, 2, 10))
        found = [
            results(f * (1 + 1e-4 * x[0]), z * (1 + 1e-2 * x[1]), np.arange(10))
            for x in noise
        ]
        called += not level_dependence([1.0, 2.0, 4.0], found).linear.all()
    assert called < 6


def test_batches_loaded_by_moved_sensors() -> None:
    """Sensors of 3 % of a mass at the measured points shift the modes differently: a chi-square
    test sees it.
    """
    rng = np.random.default_rng(5)
    sets = [(0, 2, 3, 4), (0, 2, 5, 6), (0, 1, 2, 7)]
    extra = [0.03 * np.isin(np.arange(N), s) for s in sets]
    loaded = [frfs(chain(e), rng, s) for e, s in zip(extra, sets, strict=True)]
    fit = identify_batches(loaded, HammerModes(3.0, 35.0))
    assert len(fit.modes) == N
    for b, e in enumerate(extra):
        true = np.abs(poles(*chain(e))[0]) / (2 * np.pi)
        np.testing.assert_allclose(fit.frequency[b], true, rtol=1e-3)
    assert (fit.chance < 1e-6).sum() >= N - 1
    phi = poles(*chain(np.mean(extra, axis=0)))[1][
        [int(c.split("+")[0]) - 1 for c in fit.modes.channels]
    ]
    assert np.diag(mac(fit.modes.shapes, phi)).min() > 0.98
    assert fit.modes.norm is Norm.MASS
    same = identify_batches(
        [frfs(chain(), rng, s) for s in sets], HammerModes(3.0, 35.0)
    )
    assert np.median(same.chance) > 0.02
    settings = HammerModes(3.0, 35.0)
    joint = identify_hammer(join_frfs(loaded), settings)
    apart = with_local_fits(joint, loaded, settings)
    assert len(apart.modes) == N
    assert "the batches disagree" in apart.notes[-1]
    assert len(apart.modes.channels) == N
    alike = [frfs(chain(), rng, s) for s in sets]
    result = identify_hammer(join_frfs(alike), settings)
    assert with_local_fits(result, alike, settings) is result
    other = replace(loaded[0], inputs=loaded[0].inputs[::-1])
    with pytest.raises(InputError, match="same inputs"):
        identify_batches([loaded[0], other])


def test_batches_loaded_by_heavy_sensors_keep_their_modes() -> None:
    """Sensors of a tenth of a mass shift modes by many of their bandwidths (ζ of 0.08 to 0.44 %
    here).
    """
    rng = np.random.default_rng(6)
    sets = [(0, 2, 3, 4), (0, 2, 5, 6), (0, 1, 2, 7)]
    extra = [0.1 * np.isin(np.arange(N), s) for s in sets]
    systems = [(m, k, c / 4) for m, k, c in map(chain, extra)]
    loaded = [frfs(x, rng, s, level=1e-3) for x, s in zip(systems, sets, strict=True)]
    fit = identify_batches(loaded, HammerModes(3.0, 35.0))
    for b, x in enumerate(systems):
        np.testing.assert_allclose(
            fit.frequency[b], np.abs(poles(*x)[0]) / (2 * np.pi), rtol=1e-3
        )
